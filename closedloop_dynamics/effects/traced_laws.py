# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols, for code that is generated for a whole scene.

The same laws as those of the engine (``joint_laws.cpp``, ``point_laws.cpp``), of effects that are
smooth functions of the state. A row of the table of effects tells whose parameters they take.

"""

import numpy as np

from .registry import effect_type
from .table import (
    EXTERNAL_FORCE, FIRST, JOINT_DAMPING, JOINT_SPRING, POINT_SPRING, SECOND, SPATIAL_FORCE,
    SPATIAL_POINT_SPRING)
from ..core.codegen.expression_graph import chosen, square_root
from ..core.codegen.vectors import add, dot, in_space, scale, subtract, ZERO

# Why other effects have no law here, by the name of their type.
_REASONS = {
    'joint_friction': 'dry friction jumps where a joint comes to rest',
    'end_stop': 'it begins and ends within a step',
    'contact': 'it begins and ends within a step',
    'body_contact': 'it begins and ends within a step',
    'cable': 'it slackens, and winds round pulleys',
    'actuator': 'its torque has limits and a state of its own',
    'prescribed_motion': 'it follows the time',
    'prescribed_force': 'it follows the time',
    'force_table': 'it is a table',
    'rotor': 'at a joint that closes a loop it acts on accelerations'}


def refused(effects):
    """
    Tell which effects have no law here, and why.

    Parameters
    ----------
    effects : EffectSet
        Of a scene.

    Returns
    -------
    dict of str to str
        Reasons by the names of effects that are switched on.

    """
    found = {}
    for name, element in effects.by_name.items():
        if effects.enabled[name] and element.kind not in LAWS:
            kind = effect_type(effects.records[name])
            found[name] = f'{kind}: {_REASONS.get(kind, "only the engine has its law")}'
    return found


def act(table, forces):
    """
    Let effects act.

    Parameters
    ----------
    table : EffectTable or None
        Its kinds and indices are read; numbers are the forces' symbols.
    forces : core.codegen.scene_routines.Forces
        What they do is added there.

    """
    if table is None:
        return
    for row in np.flatnonzero(table.enabled):
        LAWS[table.kind[row]](forces, *table.index[row, [FIRST, SECOND]], forces.numbers(row))


def _joint_damping(forces, joint, _, values):
    forces.twist(joint, -(values[0] * forces.rate(joint)))


def _joint_spring(forces, joint, _, values):
    stretch = forces.coordinate(joint) - values[1]
    forces.twist(joint, -(values[0] * stretch))
    forces.store(0.5 * (values[0] * (stretch * stretch)))


def _point_spring(size):
    def law(forces, first, second, values):
        stiffness, damping, free = values[:3]
        offsets = [forces.turned(body, values[at:at + size])
                   for body, at in ((first, 3), (second, 3 + size))]
        (place_a, rate_a), (place_b, rate_b) = (
            forces.place(body, offset) for body, offset in zip((first, second), offsets))
        gap = subtract(place_b, place_a)
        length = square_root(dot(gap, gap))
        # Where the points meet the gap is zero, and so is the force.
        direction = scale(gap, 1.0 / chosen(length > 0.0, length, 1.0))
        stretch = length - free
        tension = stiffness * stretch + damping * dot(direction, subtract(rate_b, rate_a))
        force = scale(direction, tension)
        forces.push(first, offsets[0], force)
        forces.push(second, offsets[1], tuple(0.0 - x for x in force))
        forces.store(0.5 * (stiffness * (stretch * stretch)))
    return law


def _external_force(forces, body, _, values):
    _constant(forces, body, values[:2], values[2:4], (0.0, 0.0, values[4]), values[5])


def _spatial_force(forces, body, _, values):
    _constant(forces, body, values[:3], values[3:6], tuple(values[6:9]), values[9])


def _constant(forces, body, point, force, moment, turns):
    """Apply a force and a moment, of a body's axes where ``turns`` is positive."""
    offset, force = forces.turned(body, point), in_space(force)
    turned = turns > 0.0
    force, moment = (
        tuple(x if one is x else chosen(turned, x, one) for x, one in zip(
            forces.turned(body, vector), vector)) for vector in (force, moment))
    forces.push(body, offset, force, add(moment, ZERO))


LAWS = {JOINT_DAMPING: _joint_damping, JOINT_SPRING: _joint_spring,
        POINT_SPRING: _point_spring(2), SPATIAL_POINT_SPRING: _point_spring(3),
        EXTERNAL_FORCE: _external_force, SPATIAL_FORCE: _spatial_force}
