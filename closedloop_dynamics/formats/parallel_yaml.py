# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The YAML file beside a URDF that describes its loops.

``closed_loop`` lists pairs of frames and ``type`` how each is held together, '6d' (nothing moves)
or '3d' (a ball); ``name_mot`` names the joints that are driven; ``joint_name`` and ``joint_type``
replace joints of the URDF: SPHERICAL, UJOINT_XY (a universal joint about x, then y), FIXED.
"""

from os.path import commonprefix

import numpy as np

from .model import Connection
from .pose import IDENTITY
from ..mechanism.checks import list_of, one_of, text
from ..mechanism.document import Document
from ..mechanism.fields import at, FieldError, mapping, shown
from ..mechanism.mechanism import (
    FIXED, MechanismError, REVOLUTE, SPHERICAL, UNIVERSAL)

KEYS = ('closed_loop', 'type'), ('name_mot', 'joint_name', 'joint_type')
HELD = {'6d': FIXED, '3d': SPHERICAL}
_AXES = dict(zip('XYZ', np.eye(3)))
TYPES = ('SPHERICAL', 'FIXED', *(
    f'UJOINT_{first}{second}' for first in 'XYZ' for second in 'XYZ' if first != second))


def add_parallel_yaml(model):
    """
    Add the loops of a YAML file beside a URDF file, if there is one of its name, to its model.

    Raises MechanismError with file, line and key.
    """
    path = model.path.with_suffix('.yaml')
    if not path.is_file():
        return
    document = Document(path, MechanismError)
    if not isinstance(document.data, dict) or 'closed_loop' not in document.data:
        return
    with document.errors():
        data = mapping(document.data, *KEYS)
        _replace_joints(model, data)
        single = [joint.name for joint in model.joints.values()
                  if 'spherical' in joint.name and joint.type == REVOLUTE]
        if single:
            model.ignored[f'the names of {len(single)} joint(s), {single[0]} the first'] = (
                f'called spherical, but revolute: no joint_name of {path.name} has them')
        _close(model, data, path)
        if 'name_mot' in data:
            drives = _names(model, data, 'name_mot')
            for joint in model.joints.values():
                joint.actuated = joint.name in drives


def _names(model, data, key):
    """Return a list of names of joints."""
    with at(key):
        return list_of(one_of(tuple(model.joints), 'one of the joints'))(data.get(key, ()))


def _replace_joints(model, data):
    names = _names(model, data, 'joint_name')
    with at('joint_type'):
        types = list_of(one_of(TYPES))(data.get('joint_type', ()))
        if len(types) != len(names):
            raise FieldError(f'{len(names)} types, one for each of joint_name', f'{len(types)}')
    for name, kind in zip(names, types):
        joint = model.joints[name]
        joint.lower = joint.upper = None
        if kind.startswith('UJOINT'):
            joint.type = UNIVERSAL
            joint.axis, joint.child_axis = (_AXES[letter] for letter in kind[-2:])
        else:
            joint.type, joint.axis = (SPHERICAL if kind == 'SPHERICAL' else FIXED), None


def _close(model, data, path):
    """Add the joints that close loops."""
    frames = {name: (joint.child, IDENTITY) for name, joint in model.joints.items()
              if not joint.closes}
    with at('closed_loop'):
        pairs = list_of(list_of(text))(data['closed_loop'])
    with at('type'):
        types = list_of(text)(data['type'])
        if len(types) != len(pairs):
            raise FieldError(f'{len(pairs)} types, one for each of closed_loop', f'{len(types)}')
    for number, (pair, kind) in enumerate(zip(pairs, types)):
        with at('type', number):
            held = HELD[one_of(tuple(HELD))(kind.lower())]
        with at('closed_loop', number):
            if len(pair) != 2:
                raise FieldError('two frames', shown(pair))
            ends = []
            for place, frame in enumerate(pair):
                with at(place):
                    if frame not in model.links:
                        one_of((*model.links, *frames), 'one of the links and joints')(frame)
                    ends.append((frame, IDENTITY) if frame in model.links else frames[frame])
        name = commonprefix(pair).rstrip('_') or f'loop_{number + 1}'
        while name in model.joints:
            name += f'_{number + 1}'
        model.add(Connection(
            name, held, ends[0][0], ends[1][0], f'{path}: closed_loop[{number}]',
            ends[0][1], ends[1][1], closes=True))
