# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Loops of a model that its file does not have, from a section ``loops`` of a scene.

    loops:
      pin: {type: revolute, between: [coupler_tip, rocker_tip], axis: [0, 1, 0]}

Two links or frames of the file are to coincide, or ``points`` on them, except for what a joint of
the type leaves free. The axis is given in both frames.
"""

import numpy as np

from .model import Connection
from .pose import unturned
from ..mechanism.checks import direction, list_of, listed, name, one_of, vector3
from ..mechanism.fields import at, FieldError, mapping, shown
from ..mechanism.mechanism import (
    CYLINDRICAL, GROUND, PLANAR, PRISMATIC, REVOLUTE, SPATIAL_CUT_JOINT_EQUATIONS, UNIVERSAL)

KEYS = ('type', 'between'), ('axis', 'second_axis', 'points')
WITH_AXIS = (REVOLUTE, PRISMATIC, CYLINDRICAL, PLANAR, UNIVERSAL)


def add_loops(model, section):
    """
    Add loops, keys of each by its name, to a model as its reader left it, in place.

    Raises FieldError.
    """
    for key, values in mapping(section).items():
        with at(key):
            name(key)
            if key in model.joints:
                raise FieldError('a name that no joint of the model has', shown(key))
            model.add(_loop(model, key, values))


def _loop(model, key, values):
    mapping(values, *KEYS)
    with at('type'):
        kind = one_of(tuple(SPATIAL_CUT_JOINT_EQUATIONS))(values['type'])
    for axis, types in (('axis', WITH_AXIS), ('second_axis', (UNIVERSAL,))):
        if (axis in values) != (kind in types):
            with at(axis):
                raise FieldError(f'{"this" if kind in types else "no such"} key of a {kind} joint',
                                 shown(values.get(axis)))
    places = [(0.0, 0.0, 0.0)] * 2
    with at('points'):
        if 'points' in values:
            places = _two(list_of(vector3)(values['points']))
    ends = []
    with at('between'):
        for number, frame in enumerate(_two(listed(values['between']))):
            with at(number):
                one_of((GROUND, *model.links, *model.frames), 'one of the links and frames')(frame)
                link, pose = model.frame(frame, key)
                ends.append((link, pose @ unturned(places[number])))
    axes = {}
    for axis, field in (('axis', 'axis'), ('second_axis', 'child_axis')):
        if axis in values:
            with at(axis):
                axes[field] = np.array(direction(values[axis]))
    (parent, in_parent), (child, in_child) = ends
    return Connection(key, kind, parent, child, f'loops.{key}', in_parent, in_child, closes=True,
                      **axes)


def _two(items):
    if len(items) != 2:
        raise FieldError('a list of 2', f'one of {len(items)}')
    return items
