# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols, of those that are functions of coordinates and rates without jumps.

For all code that is generated for a whole scene (the evaluation that the engine runs, derivatives
and C), and for each law by itself (``law_code``). Where such a law has a corner, as where an end
stop is reached, its derivative is that of the branch that the engine takes there.

A law takes the forces (``core.codegen.scene_routines.Forces``), the first and the second index of
its row of the table of effects, the row's numbers, and the numbers of its entries; of a force
table in the place of these a function that returns force and energy at a stroke.
"""

from . import bushing, fluid_drag
from .table import (
    BUSHING, END_STOP, EXTERNAL_FORCE, FLUID_DRAG, JOINT_DAMPING, JOINT_FORCE_TABLE, JOINT_SPRING,
    ORIENTATION_SPRING, POINT_FORCE_TABLE, POINT_SPRING, SPATIAL_BUSHING, SPATIAL_FLUID_DRAG,
    SPATIAL_FORCE, SPATIAL_FORCE_TABLE, SPATIAL_POINT_SPRING, TENDON)
from ..core.codegen.expression_graph import arctangent, chosen, larger, smaller, square_root
from ..core.codegen.vectors import add, cross, dot, in_space, scale, subtract, ZERO

# asin(x) / x in powers of x^2, good to rounding where that is below the limit.
_ARC, _SMALL = (1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152, 63 / 2816), 1e-3


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
    forces.read(torque)


def _joint_spring(forces, joint, _, values, __):
    stretch = forces.coordinate(joint) - values[1]
    torque = -(values[0] * stretch)
    forces.twist(joint, torque)
    forces.store(0.5 * (values[0] * (stretch * stretch)))
    forces.read(torque)


def _orientation_spring(forces, parent, child, values, constants):
    axes, others = ([forces.turned(body, constants[n + 3 * k:n + 3 * k + 3]) for k in range(3)]
                    for body, n in ((parent, 0), (child, 9)))
    turn = _turn([[dot(axis, other) for other in others] for axis in axes])
    moment = ZERO
    for axis, component in zip(axes, turn):
        moment = subtract(moment, scale(axis, values[0] * component))
    forces.push(child, ZERO, ZERO, moment)
    forces.push(parent, ZERO, ZERO, scale(moment, -1.0))
    square = dot(turn, turn)
    forces.store(0.5 * (values[0] * square))
    forces.read(values[0] * square_root(square))


def _turn(matrix):
    """Return the angle phi of a rotation, 0 to pi, times its axis a."""
    # a sin phi, from the antisymmetric part.
    sines = [0.5 * (matrix[(k + 2) % 3][(k + 1) % 3] - matrix[(k + 1) % 3][(k + 2) % 3])
             for k in range(3)]
    cosine = 0.5 * (matrix[0][0] + matrix[1][1] + matrix[2][2] - 1.0)
    square = dot(sines, sines)
    sine = square_root(square)
    angle, series = arctangent(sine, cosine), 0.0
    # phi / sin phi: where that is small, its series, as the root has no derivative at zero.
    for coefficient in reversed(_ARC):
        series = coefficient + square * series
    near = scale(sines, chosen(square < _SMALL, series, angle / sine))
    # Beyond a right angle: the longest column of a a^T (1 - cos phi), the symmetric part.
    columns = [[0.5 * (matrix[i][k] + matrix[k][i]) - (cosine if i == k else 0.0)
                for i in range(3)] for k in range(3)]
    longest, most = columns[0], columns[0][0]
    for k in (1, 2):
        longer, most = columns[k][k] > most, larger(most, columns[k][k])
        longest = [chosen(longer, one, other) for one, other in zip(columns[k], longest)]
    factor = angle / square_root(dot(longest, longest))
    far = scale(longest, chosen(dot(longest, sines) < 0.0, -factor, factor))
    return [chosen(cosine > 0.0, *one) for one in zip(near, far)]


def _joint_force_table(forces, joint, _, values, table):
    stroke, rate = forces.coordinate(joint), forces.rate(joint)
    force, energy = table(stroke)
    loss = values[0] * rate
    forces.twist(joint, force - loss)
    forces.store(-energy)
    forces.flow(loss * rate)
    forces.read(force - loss, stroke)


def _point_force_table(size):
    def law(forces, first, second, values, table):
        bodies = first, second
        offsets, direction, length, rate = line_between(
            forces, bodies, (values[1:1 + size], values[1 + size:1 + 2 * size]))
        force, energy = table(length)
        tension = force + values[0] * rate
        push_apart(forces, bodies, offsets, direction, -tension)
        forces.store(energy)
        forces.flow(values[0] * rate * rate)
        forces.read(chosen(length > 0.0, tension, 0.0), length)
    return law


def _point_spring(size):
    def law(forces, first, second, values, _):
        stiffness, damping, free = values[:3]
        bodies = first, second
        offsets, direction, length, rate = line_between(
            forces, bodies, (values[3:3 + size], values[3 + size:3 + 2 * size]))
        stretch = length - free
        tension = stiffness * stretch + damping * rate
        push_apart(forces, bodies, offsets, direction, -tension)
        forces.store(0.5 * (stiffness * (stretch * stretch)))
        forces.flow(damping * rate * rate)
        forces.read(chosen(length > 0.0, tension, 0.0), length)
    return law


def _external_force(forces, body, _, values, __):
    _constant(forces, body, values[:2], values[2:4], (0.0, 0.0, values[4]), values[5])


def _spatial_force(forces, body, _, values, __):
    _constant(forces, body, values[:3], values[3:6], tuple(values[6:9]), values[9])


def push_along(forces, size, body, values, force):
    """
    Apply a prescribed force [N] at a point of a body, in space (3) or the plane (2).

    ``body`` is its row; ``values``: numbers of the effect: from the third on the point, the
    direction, and whether this is of the body's axes (positive). Returns the power.
    """
    offset = forces.turned(body, values[2:2 + size])
    direction = _turned(
        forces, body, in_space(values[2 + size:2 + 2 * size]), values[2 + 2 * size])
    forces.push(body, offset, scale(direction, force))
    return force * dot(direction, forces.place(body, offset)[1])


def _turned(forces, body, vector, turns):
    return tuple(x if one is x else chosen(turns > 0.0, x, one) for x, one in zip(
        forces.turned(body, vector), vector))


def _constant(forces, body, point, force, moment, turns):
    """Apply a force and a moment, of a body's axes where ``turns`` is positive."""
    offset, force = forces.turned(body, point), in_space(force)
    force, moment = (_turned(forces, body, vector, turns) for vector in (force, moment))
    moment = add(moment, ZERO)
    forces.push(body, offset, force, moment)
    power = dot(force, forces.place(body, offset)[1]) + dot(moment, forces.spin(body))
    forces.flow(power)
    forces.read(power)


def _end_stop(forces, joint, _, values, __):
    stiffness, lower, upper, damping = values[:4]
    above, below = forces.coordinate(joint) - upper, lower - forces.coordinate(joint)
    low = below > above
    sign, depth = chosen(low, -1.0, 1.0), chosen(low, below, above)
    rate = sign * forces.rate(joint)
    depth = chosen(forces.touches(-depth, -rate), depth, 0.0)
    elastic = stiffness * depth
    push = elastic * larger(1.0 + damping * rate, 0.0)
    forces.twist(joint, -(sign * push))
    forces.store(0.5 * elastic * depth)
    forces.flow((push - elastic) * rate)
    forces.read(-(sign * push), depth)


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
    force, moment = _drag(forces, body, values[:2], in_space(values[10:12]), (
        (axis, values[4], values[6], 0.0, 0.0),
        ((-axis[1], axis[0]), values[5], values[7], 0.0, 0.0),
        ((0.0, 0.0, 1.0), 0.0, 0.0, *values[8:10])))
    forces.read(square_root(dot(force, force)), moment[2])


def _spatial_fluid_drag(forces, body, _, values, constants):
    forces.read(*(square_root(dot(one, one)) for one in _drag(
        forces, body, values[:3], tuple(values[3:6]), [
            (constants[n:n + 3], *constants[n + 3:n + fluid_drag.COLUMNS])
            for n in range(0, 3 * fluid_drag.COLUMNS, fluid_drag.COLUMNS)])))


def _drag(forces, body, point, flow, entries):
    """
    Apply a fluid's drag along axes of a body and about them, with two coefficients of each.

    Returns force and moment.
    """
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
    return force, moment


def _bushing(forces, first, second, values, constants):
    axis, (stiffness_1, stiffness_2, damping_1, damping_2) = tuple(values[3:5]), constants[4:8]
    turn = forces.angle(second) - forces.angle(first) - values[2]
    spin = subtract(forces.spin(second), forces.spin(first))[2]
    moment = 0.0, 0.0, -(values[0] * turn + values[1] * spin)
    forces.store(0.5 * (values[0] * (turn * turn)))
    lost, along = _hold(forces, (first, second), (constants[:2], constants[2:4]), (
        (forces.turned(first, axis), stiffness_1, damping_1),
        (forces.turned(first, (-axis[1], axis[0])), stiffness_2, damping_2)), moment)
    forces.flow(lost + values[1] * spin * spin)
    forces.read(*along, moment[2])


def _spatial_bushing(forces, first, second, values, constants):
    turning, axes, moment = subtract(forces.spin(second), forces.spin(first)), [], ZERO
    lost = 0.0
    for k, (share, loss) in enumerate(zip(values[:3], values[3:6])):
        axis, other = (forces.turned(body, constants[n + 3 * k:n + 3 * k + 3])
                       for body, n in ((first, bushing.AXES_A), (second, bushing.AXES_B)))
        axes.append((axis, constants[bushing.ALONG + k], constants[bushing.LOSS + k]))
        spin = dot(axis, turning)
        moment = add(moment, subtract(scale(cross(other, axis), share),
                                      scale(axis, loss * spin)))
        lost = lost + loss * spin * spin
        forces.store(share * (1.0 - dot(axis, other)))
    more, along = _hold(forces, (first, second), (constants[:3], constants[3:6]), axes, moment)
    forces.flow(lost + more)
    forces.read(*along, square_root(dot(moment, moment)))


def _hold(forces, bodies, places, axes, moment):
    """
    Join points of two bodies by springs and dampers along axes of the first; and a moment.

    Returns the power dissipated by the dampers [W], and the force along each axis [N].
    """
    start, end = (forces.turned(body, place) for body, place in zip(bodies, places))
    (place_a, _), (place_b, rate_b) = (
        forces.place(body, offset) for body, offset in zip(bodies, (start, end)))
    apart, force = subtract(place_b, place_a), ZERO
    # Relative to the first body's point that coincides with the second point, so as to include
    # the rotation of the axes.
    lever = add(start, apart)
    rate, lost, along = subtract(rate_b, forces.place(bodies[0], lever)[1]), 0.0, []
    for axis, stiffness, damping in axes:
        stretch, speed = dot(axis, apart), dot(axis, rate)
        pull = stiffness * stretch + damping * speed
        along.append(-pull)
        force = subtract(force, scale(axis, pull))
        lost = lost + damping * speed * speed
        forces.store(0.5 * stiffness * (stretch * stretch))
    forces.push(bodies[1], end, force, moment)
    forces.push(bodies[0], lever, scale(force, -1.0), scale(moment, -1.0))
    return lost, along


LAWS = {BUSHING: _bushing, END_STOP: _end_stop, EXTERNAL_FORCE: _external_force,
        FLUID_DRAG: _fluid_drag, JOINT_DAMPING: _joint_damping,
        JOINT_FORCE_TABLE: _joint_force_table, JOINT_SPRING: _joint_spring,
        ORIENTATION_SPRING: _orientation_spring, POINT_FORCE_TABLE: _point_force_table(2),
        POINT_SPRING: _point_spring(2), SPATIAL_BUSHING: _spatial_bushing,
        SPATIAL_FLUID_DRAG: _spatial_fluid_drag, SPATIAL_FORCE: _spatial_force,
        SPATIAL_FORCE_TABLE: _point_force_table(3), SPATIAL_POINT_SPRING: _point_spring(3),
        TENDON: _tendon}
FORCE_TABLES = JOINT_FORCE_TABLE, POINT_FORCE_TABLE, SPATIAL_FORCE_TABLE
