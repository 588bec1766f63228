# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols, for code that is generated for a whole scene.

The same laws as those of the engine (``joint_laws.cpp``, ``point_laws.cpp``), of effects that are
smooth functions of the state. A row of the table of effects tells whose parameters they take.

"""

from functools import partial

import numpy as np

from .registry import effect_type
from .table import (
    DATA, EXTERNAL_FORCE, FIRST, JOINT_DAMPING, JOINT_SPRING, POINT_SPRING, SECOND, SPATIAL_FORCE,
    SPATIAL_POINT_SPRING, SPATIAL_TRACED, TRACED)
from .traced_effect import COLUMNS, COMPONENT, FIRST_COORDINATE, JOINT, MEASURED, PARAMETERS
from ..core.codegen.expression_graph import chosen, replayed, square_root
from ..core.codegen.vectors import add, dot, in_space, scale, subtract, ZERO

# Why other effects have no law here, by the name of their type.
_REASONS = {
    'joint_friction': 'dry friction jumps where a joint comes to rest',
    'tendon_friction': 'dry friction jumps where a tendon comes to rest',
    'tendon_inertia': 'it acts on accelerations',
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
    Return which effects have no law here, and why.

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
        kind = effect_type(effects.records[name])
        if not effects.enabled[name]:
            continue
        if element.kind in (TRACED, SPATIAL_TRACED):
            law = effects.records[name].traced
            reason = ('it has an event' if law.gap is not None else
                      'it follows the time' if law.follows_time else
                      'it has states of its own' if law.states else None)
            if reason is not None:
                found[name] = f'{kind}: {reason}'
        elif element.kind not in LAWS:
            found[name] = f'{kind}: {_REASONS.get(kind, "only the engine has its law")}'
    return found


def act(table, forces, laws=None):
    """
    Let effects act.

    Parameters
    ----------
    table : EffectTable or None
        Its kinds and indices are read; numbers are the forces' symbols.
    forces : core.codegen.scene_routines.Forces
        What they do is added there.
    laws : dict of int to traced_effect.Tracing, optional
        Laws of users, by rows; where their points are is no input.

    """
    if table is None:
        return
    for row in np.flatnonzero(table.enabled):
        if laws and row in laws:
            _of_user(forces, laws[row], entries_of(table, row), forces.numbers(row))
        else:
            LAWS[table.kind[row]](forces, *table.index[row, [FIRST, SECOND]], forces.numbers(row))


def entries_of(table, row):
    """Return what a law of users measures, shape (coordinates, COLUMNS)."""
    begin, count = table.index[row, DATA] + COLUMNS, table.index[row, FIRST]
    return table.data[begin:begin + COLUMNS * count].reshape(count, COLUMNS)


def _of_user(forces, law, entries, values):
    measured, pushes = FIRST_COORDINATE * [None], []
    for kind, first, second, *places in entries.tolist():
        first, second = int(first), int(second)
        if kind == JOINT:
            measured += [forces.coordinate(first), forces.rate(first)]
            pushes.append(partial(forces.twist, first))
        elif kind == COMPONENT:
            offset = forces.turned(first, places[:3])
            measured += [each[second] for each in forces.place(first, offset)]
            pushes.append(partial(_push_along, forces, second, first, offset))
        else:
            offsets, direction, length, rate = _line(
                forces, (first, second), (places[:3], places[3:]))
            measured += [length, rate]
            pushes.append(partial(_push_apart, forces, (first, second), offsets, direction))
    inputs = {PARAMETERS: values, MEASURED: measured}
    results = replayed(law.graph, law.results, lambda source, place: inputs[source][place])
    for push, force in zip(pushes, results):
        push(force)
    forces.store(results[len(entries) + len(law.states)])


def _push_along(forces, axis, body, offset, force):
    forces.push(body, offset, tuple(force if k == axis else 0.0 for k in range(3)))


def _push_apart(forces, bodies, offsets, direction, force):
    for body, offset, sign in zip(bodies, offsets, (-1.0, 1.0)):
        forces.push(body, offset, scale(direction, sign * force))


def _line(forces, bodies, places):
    """Return offsets of two points, the direction from one to the other, length and its rate."""
    offsets = [forces.turned(body, place) for body, place in zip(bodies, places)]
    (place_a, rate_a), (place_b, rate_b) = map(forces.place, bodies, offsets)
    gap = subtract(place_b, place_a)
    length = square_root(dot(gap, gap))
    # Where the points meet the gap is zero, and so is the force.
    direction = scale(gap, 1.0 / chosen(length > 0.0, length, 1.0))
    return offsets, direction, length, dot(direction, subtract(rate_b, rate_a))


def _joint_damping(forces, joint, _, values):
    forces.twist(joint, -(values[0] * forces.rate(joint)))


def _joint_spring(forces, joint, _, values):
    stretch = forces.coordinate(joint) - values[1]
    forces.twist(joint, -(values[0] * stretch))
    forces.store(0.5 * (values[0] * (stretch * stretch)))


def _point_spring(size):
    def law(forces, first, second, values):
        stiffness, damping, free = values[:3]
        bodies = first, second
        offsets, direction, length, rate = _line(
            forces, bodies, (values[3:3 + size], values[3 + size:3 + 2 * size]))
        stretch = length - free
        _push_apart(forces, bodies, offsets, direction, -(stiffness * stretch + damping * rate))
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
