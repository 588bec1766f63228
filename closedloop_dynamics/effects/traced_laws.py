# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols, for code that is generated for a whole scene.

The same laws as those of the engine (``joint_laws.cpp``, ``point_laws.cpp``, ...), of effects that
are functions of coordinates and rates without jumps. Where such a law has a corner, as where an
end stop is reached, its derivative is that of the branch that the engine takes there. A row of the
table of effects tells whose parameters they take; the numbers of its entries are constants of the
code.

"""

from functools import partial

import numpy as np

from . import force_table
from .registry import effect_type
from .table import (
    BUSHING, DATA, END_STOP, ENTRIES, EXTERNAL_FORCE, FIRST, FLUID_DRAG, JOINT_DAMPING,
    JOINT_FORCE_TABLE, JOINT_SPRING, ORIENTATION_SPRING, POINT_FORCE_TABLE, POINT_SPRING, SECOND,
    SPATIAL_BUSHING, SPATIAL_FLUID_DRAG, SPATIAL_FORCE, SPATIAL_FORCE_TABLE, SPATIAL_POINT_SPRING,
    SPATIAL_TRACED, STATE, TENDON, TRACED)
from .traced_effect import COLUMNS, COMPONENT, FIRST_COORDINATE, JOINT, MEASURED, PARAMETERS
from ..core.codegen.expression_graph import (
    arctangent, chosen, larger, replayed, smaller, square_root)
from ..core.codegen.vectors import add, cross, dot, in_space, scale, subtract, ZERO

# Why other effects have no law here, by the name of their type.
_REASONS = {
    'joint_friction': 'dry friction jumps where a joint comes to rest',
    'tendon_friction': 'dry friction jumps where a tendon comes to rest',
    'tendon_inertia': 'it acts on accelerations',
    'contact': 'its friction jumps with the sliding, and contacts begin within a step',
    'body_contact': 'which parts of the outlines touch is searched for',
    'cable': 'it slackens, and winds round pulleys',
    'actuator': 'its torque has limits and a state of its own',
    'prescribed_motion': 'it follows the time',
    'prescribed_force': 'it follows the time',
    'rotor': 'at a joint that closes a loop it acts on accelerations'}

# asin(x) / x in powers of x^2, good to rounding where that is below the limit.
_ARC, _SMALL = (1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152, 63 / 2816), 1e-3


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
    Apply effects.

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
        forces.row, forces.first = int(row), int(table.index[row, STATE])
        if laws and row in laws:
            _of_user(forces, laws[row], entries_of(table, row), forces.numbers(row))
        else:
            LAWS[table.kind[row]](forces, *table.index[row, [FIRST, SECOND]], forces.numbers(row),
                                  constants_of(table, row))


def constants_of(table, row):
    """
    Return the numbers of a row's entries, which are constants of the code.

    Parameters
    ----------
    table : EffectTable
        Of a scene.
    row : int
        Of an effect.

    Returns
    -------
    list of float
        Of a tendon behind how many joints and coefficients there are, of which kind.

    """
    begin, *after = (int(first) for first in table.index[row:row + 2, DATA])
    found = table.data[begin:after[0] if after else len(table.data)].tolist()
    if table.kind[row] != TENDON:
        return found
    return [float(table.index[row, ENTRIES] - 2), *table.values[row, :2].tolist(), *found]


def entries_of(table, row):
    """Return the coordinates that a user's law measures, shape (coordinates, COLUMNS)."""
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
            offsets, direction, length, rate = line_between(
                forces, (first, second), (places[:3], places[3:]))
            measured += [length, rate]
            pushes.append(partial(push_apart, forces, (first, second), offsets, direction))
    inputs = {PARAMETERS: values, MEASURED: measured}
    results = replayed(law.graph, law.results, lambda source, place: inputs[source][place])
    for push, force in zip(pushes, results):
        push(force)
    # Behind forces and the rates of states the energy, and what is lost of it, where that is told.
    stored, lost = results[len(entries) + len(law.states):][:2]
    forces.store(stored)
    rates = measured[FIRST_COORDINATE + 1::2]
    forces.flow(lost if law.energy is not None or law.dissipation is not None else dot(
        results[:len(rates)], rates))


def _push_along(forces, axis, body, offset, force):
    forces.push(body, offset, tuple(force if k == axis else 0.0 for k in range(3)))


def push_apart(forces, bodies, offsets, direction, force):
    """Push two bodies apart, along the line between two of their points."""
    for body, offset, sign in zip(bodies, offsets, (-1.0, 1.0)):
        forces.push(body, offset, scale(direction, sign * force))


def line_between(forces, bodies, places):
    """Return offsets of two points, the direction from one to the other, length and its rate."""
    offsets = [forces.turned(body, place) for body, place in zip(bodies, places)]
    (place_a, rate_a), (place_b, rate_b) = map(forces.place, bodies, offsets)
    gap = subtract(place_b, place_a)
    length = square_root(dot(gap, gap))
    # Where the points meet the gap is zero, and so is the force.
    direction = scale(gap, 1.0 / chosen(length > 0.0, length, 1.0))
    return offsets, direction, length, dot(direction, subtract(rate_b, rate_a))


def _joint_damping(forces, joint, _, values, __):
    torque = -(values[0] * forces.rate(joint))
    forces.twist(joint, torque)
    forces.flow(-(torque * forces.rate(joint)))


def _joint_spring(forces, joint, _, values, __):
    stretch = forces.coordinate(joint) - values[1]
    forces.twist(joint, -(values[0] * stretch))
    forces.store(0.5 * (values[0] * (stretch * stretch)))


def _orientation_spring(forces, parent, child, values, constants):
    axes, others = ([forces.turned(body, constants[n + 3 * k:n + 3 * k + 3]) for k in range(3)]
                    for body, n in ((parent, 0), (child, 9)))
    turned = [[dot(axis, other) for other in others] for axis in axes]
    # The axis of the turn by the angle phi, times sin phi.
    sines = [0.5 * (turned[(k + 2) % 3][(k + 1) % 3] - turned[(k + 1) % 3][(k + 2) % 3])
             for k in range(3)]
    cosine = 0.5 * (turned[0][0] + turned[1][1] + turned[2][2] - 1.0)
    square = dot(sines, sines)
    sine = square_root(square)
    # phi / sin phi: where that is small, its series, as the root has no derivative at zero.
    whole = arctangent(sine, cosine) / sine
    series = 0.0
    for coefficient in reversed(_ARC):
        series = coefficient + square * series
    ratio = chosen(cosine > 0.0, chosen(square < _SMALL, series, whole), whole)
    moment = scale(_along(axes, sines), -(values[0] * ratio))
    forces.push(child, ZERO, ZERO, moment)
    forces.push(parent, ZERO, ZERO, scale(moment, -1.0))
    forces.store(0.5 * (values[0] * (ratio * ratio * square)))


def _along(axes, components):
    """Return a vector of its components along three axes."""
    found = ZERO
    for axis, one in zip(axes, components):
        found = add(found, scale(axis, one))
    return found


def _look_up(constants, stroke):
    """Return force and energy at a stroke: of the last piece of a table that begins before it."""
    pieces = [constants[n:n + force_table.COLUMNS]
              for n in range(0, len(constants), force_table.COLUMNS)]
    start, a, b, c, d, energy = pieces[0]
    for piece in pieces[1:]:
        begun = stroke >= piece[0]
        start, a, b, c, d, energy = (
            chosen(begun, one, before) if one != before else before
            for one, before in zip(piece, (start, a, b, c, d, energy)))
    u = stroke - start
    return (a + u * (b + u * (c + u * d)),
            energy + u * (a + u * (b / 2.0 + u * (c / 3.0 + u * d / 4.0))))


def _joint_force_table(forces, joint, _, values, constants):
    force, energy = _look_up(constants, forces.coordinate(joint))
    loss = values[0] * forces.rate(joint)
    forces.twist(joint, force - loss)
    forces.store(-energy)
    forces.flow(loss * forces.rate(joint))


def _point_force_table(size):
    def law(forces, first, second, values, constants):
        bodies = first, second
        offsets, direction, length, rate = line_between(
            forces, bodies, (values[1:1 + size], values[1 + size:1 + 2 * size]))
        force, energy = _look_up(constants, length)
        push_apart(forces, bodies, offsets, direction, -(force + values[0] * rate))
        forces.store(energy)
        forces.flow(values[0] * rate * rate)
    return law


def _point_spring(size):
    def law(forces, first, second, values, _):
        stiffness, damping, free = values[:3]
        bodies = first, second
        offsets, direction, length, rate = line_between(
            forces, bodies, (values[3:3 + size], values[3 + size:3 + 2 * size]))
        stretch = length - free
        push_apart(forces, bodies, offsets, direction, -(stiffness * stretch + damping * rate))
        forces.store(0.5 * (stiffness * (stretch * stretch)))
        forces.flow(damping * rate * rate)
    return law


def _external_force(forces, body, _, values, __):
    _constant(forces, body, values[:2], values[2:4], (0.0, 0.0, values[4]), values[5])


def _spatial_force(forces, body, _, values, __):
    _constant(forces, body, values[:3], values[3:6], tuple(values[6:9]), values[9])


def _constant(forces, body, point, force, moment, turns):
    """Apply a force and a moment, of a body's axes where ``turns`` is positive."""
    offset, force = forces.turned(body, point), in_space(force)
    turned = turns > 0.0
    force, moment = (
        tuple(x if one is x else chosen(turned, x, one) for x, one in zip(
            forces.turned(body, vector), vector)) for vector in (force, moment))
    moment = add(moment, ZERO)
    forces.push(body, offset, force, moment)
    forces.flow(dot(force, forces.place(body, offset)[1]) + dot(moment, forces.spin(body)))


def _end_stop(forces, joint, _, values, __):
    stiffness, lower, upper, damping = values[:4]
    above, below = forces.coordinate(joint) - upper, lower - forces.coordinate(joint)
    low = below > above
    sign, depth = chosen(low, -1.0, 1.0), chosen(low, below, above)
    rate = sign * forces.rate(joint)
    elastic = stiffness * chosen(forces.touches(-depth, -rate), depth, 0.0)
    push = elastic * larger(1.0 + damping * rate, 0.0)
    forces.twist(joint, -(sign * push))
    forces.store(0.5 * elastic * depth)
    forces.flow((push - elastic) * rate)


def _tendon(forces, _, __, values, constants):
    joints, springs, _ = (int(count) for count in constants[:3])
    numbers, coefficients = constants[3:3 + 2 * joints], constants[3 + 2 * joints:]
    arms = [(int(joint), arm) for joint, arm in zip(numbers[::2], numbers[1::2])]
    length = sum(arm * forces.coordinate(joint) for joint, arm in arms)
    rate = sum(arm * forces.rate(joint) for joint, arm in arms)
    stretch = length - larger(values[2], smaller(values[3], length))
    tension, stored, power = 0.0, 0.0, stretch
    for exponent, stiffness in enumerate(coefficients[:springs], start=2):
        tension = tension + stiffness * power
        power = power * stretch
        stored = stored + stiffness / exponent * power
    power, viscous = rate, 0.0
    for damping in coefficients[springs:]:
        viscous = viscous + damping * power
        power = power * abs(rate)
    for joint, arm in arms:
        forces.twist(joint, -(arm * (tension + viscous)))
    forces.store(stored)
    forces.flow(viscous * rate)


def _fluid_drag(forces, body, _, values, __):
    axis = tuple(values[2:4])
    _drag(forces, body, values[:2], in_space(values[10:12]), (
        (axis, values[4], values[6], 0.0, 0.0),
        ((-axis[1], axis[0]), values[5], values[7], 0.0, 0.0),
        ((0.0, 0.0, 1.0), 0.0, 0.0, *values[8:10])))


def _spatial_fluid_drag(forces, body, _, values, constants):
    _drag(forces, body, values[:3], tuple(values[3:6]), [
        (constants[n:n + 3], *constants[n + 3:n + 7]) for n in (0, 7, 14)])


def _drag(forces, body, point, flow, entries):
    """Apply a fluid's drag along axes of a body and about them, with two coefficients of each."""
    offset = forces.turned(body, point)
    velocity, spin = subtract(forces.place(body, offset)[1], flow), forces.spin(body)
    force, moment = ZERO, ZERO
    for direction, *coefficients in entries:
        axis = forces.turned(body, direction)
        along, about = (
            -((linear + quadratic * abs(speed)) * speed) for linear, quadratic, speed in (
                (*coefficients[:2], dot(axis, velocity)), (*coefficients[2:], dot(axis, spin))))
        force, moment = add(force, scale(axis, along)), add(moment, scale(axis, about))
    forces.push(body, offset, force, moment)
    forces.flow(-dot(force, velocity) - dot(moment, spin), dot(force, flow))


def _bushing(forces, first, second, values, constants):
    axis, (stiffness_1, stiffness_2, damping_1, damping_2) = tuple(values[3:5]), constants[4:]
    turn = forces.angle(second) - forces.angle(first) - values[2]
    spin = subtract(forces.spin(second), forces.spin(first))[2]
    moment = 0.0, 0.0, -(values[0] * turn + values[1] * spin)
    forces.store(0.5 * (values[0] * (turn * turn)))
    lost = _hold(forces, (first, second), (constants[:2], constants[2:4]), (
        (forces.turned(first, axis), stiffness_1, damping_1),
        (forces.turned(first, (-axis[1], axis[0])), stiffness_2, damping_2)), moment)
    forces.flow(lost + values[1] * spin * spin)


def _spatial_bushing(forces, first, second, values, constants):
    turning, along, moment = subtract(forces.spin(second), forces.spin(first)), [], ZERO
    lost = 0.0
    for k, (share, loss) in enumerate(zip(values[:3], values[3:6])):
        axis, other = (forces.turned(body, constants[n + 3 * k:n + 3 * k + 3])
                       for body, n in ((first, 6), (second, 15)))
        along.append((axis, constants[24 + k], constants[27 + k]))
        spin = dot(axis, turning)
        moment = add(moment, subtract(scale(cross(other, axis), share),
                                      scale(axis, loss * spin)))
        lost = lost + loss * spin * spin
        forces.store(share * (1.0 - dot(axis, other)))
    forces.flow(lost + _hold(
        forces, (first, second), (constants[:3], constants[3:6]), along, moment))


def _hold(forces, bodies, places, axes, moment):
    """
    Join points of two bodies by springs and dampers along axes of the first; and a moment.

    Returns what the dampers dissipate [W].
    """
    start, end = (forces.turned(body, place) for body, place in zip(bodies, places))
    (place_a, _), (place_b, rate_b) = (
        forces.place(body, offset) for body, offset in zip(bodies, (start, end)))
    apart, force = subtract(place_b, place_a), ZERO
    # Against what of the first body would be at the second point: so the axes' turning is seen.
    lever = add(start, apart)
    rate, lost = subtract(rate_b, forces.place(bodies[0], lever)[1]), 0.0
    for axis, stiffness, damping in axes:
        along, speed = dot(axis, apart), dot(axis, rate)
        force = subtract(force, scale(axis, stiffness * along + damping * speed))
        lost = lost + damping * speed * speed
        forces.store(0.5 * stiffness * (along * along))
    forces.push(bodies[1], end, force, moment)
    forces.push(bodies[0], lever, scale(force, -1.0), scale(moment, -1.0))
    return lost


LAWS = {BUSHING: _bushing, END_STOP: _end_stop, EXTERNAL_FORCE: _external_force,
        FLUID_DRAG: _fluid_drag, JOINT_DAMPING: _joint_damping,
        JOINT_FORCE_TABLE: _joint_force_table, JOINT_SPRING: _joint_spring,
        ORIENTATION_SPRING: _orientation_spring, POINT_FORCE_TABLE: _point_force_table(2),
        POINT_SPRING: _point_spring(2), SPATIAL_BUSHING: _spatial_bushing,
        SPATIAL_FLUID_DRAG: _spatial_fluid_drag, SPATIAL_FORCE: _spatial_force,
        SPATIAL_FORCE_TABLE: _point_force_table(3), SPATIAL_POINT_SPRING: _point_spring(3),
        TENDON: _tendon}
