# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols as the engine runs them, within the evaluation of their scene.

Those without jumps (``smooth_laws``), contacts (``contact_laws``), and here those of what follows
the time, of dry friction, drives and cables. Those ``ALONE`` are compiled by themselves, too
(``law_code``). What is searched for (the piece of a course that is its turn, whether a contact is
there) the engine has found before: it is a load.
"""

import math
from types import SimpleNamespace

import numpy as np

from . import cable, contact_laws, course, force_table, smooth_laws, traced_effect, user_laws
from .actuator import FADING
from .smooth_laws import push_along
from .table import (
    ACROSS_B, ACTUATOR, AXIS, CABLE, CUT_VALUE_COLUMNS, DATA, ENTRIES, entries_of, FIRST, FOLLOWED,
    IN_PLANE, JOINT_FRICTION, NODE_COLUMNS, POINT_A, POINT_B, PRESCRIBED_FORCE,
    PRESCRIBED_MOTION, PRESCRIBED_TORQUE, PRESENT_COLUMNS, RATE_ONLY, ROW_A, ROW_B, SCALE, SECOND,
    SIDE_A, SIDE_B, SLIDES, SPATIAL_PRESCRIBED_FORCE, SPATIAL_TRACED, STATE, TENDON, TRACED,
    TRIAL_COLUMNS, VALUE_COLUMNS, ZERO)
from ..core.codegen import function_table as calls
from ..core.codegen.expression_graph import (
    arctangent, chosen, cosine, exponential, larger, sine, smaller, square_root)
from ..core.codegen.vectors import dot, scale, subtract

_CUT_COLUMNS = {'POINT_A': POINT_A, 'POINT_B': POINT_B, 'AXIS': AXIS, 'SIDE_A': SIDE_A,
                'SIDE_B': SIDE_B, 'ACROSS_B': ACROSS_B, 'SCALE': SCALE, 'ZERO': ZERO}
# As of ``engine/sticking.hpp`` [rad/s; m/s].
REST = 1e-6
USER_LAWS = TRACED, SPATIAL_TRACED
COURSES = (PRESCRIBED_TORQUE, PRESCRIBED_FORCE, SPATIAL_PRESCRIBED_FORCE, PRESCRIBED_MOTION)


def _arms(table, row):
    """Return the joints that an effect has moment arms for."""
    count = int(table.index[row, ENTRIES]) - (2 if table.kind[row] == TENDON else 0)
    return entries_of(table, row)[:2 * count:2].astype(int).tolist()


def joints_of(table, row):
    """Return the joints that an effect acts in."""
    return _arms(table, row) or [int(table.index[row, FIRST])]


def shape(table, row):
    """Return which terms of a law are there."""
    kind, values = table.kind[row], table.values[row]
    if kind in COURSES:
        if values[1] == 1.0:
            return 'expression',
        pieces = entries_of(table, row)
        pieces = pieces[:course.COLUMNS * table.index[row, ENTRIES]].reshape(-1, course.COLUMNS)
        return bool(pieces[:, 5:7].any()), bool(pieces[:, 7].any())
    if kind in (TENDON, JOINT_FRICTION):
        # Whether friction is larger at rest, and whether it is decided there.
        return (*_arms(table, row), bool(values[1] > 1.0)) if kind == JOINT_FRICTION else (
            *_arms(table, row),)
    if kind == ACTUATOR:
        return bool(values[2] > 0.0),
    if kind in contact_laws.LAWS:
        return contact_laws.known_power(values[7]),
    if kind == CABLE:
        entries = entries_of(table, row).reshape(-1, cable.COLUMNS)
        return (*entries[:, 0].tolist(), *(entries[:, 3] != 0.0).tolist(),
                *np.sign(entries[:, 3]).tolist())
    if kind in USER_LAWS:
        measured = user_laws.measured_entries(table, row)
        return (law_of(table, row).arithmetic,
                *measured[:, :user_laws.STRUCTURE].ravel().tolist())
    return ()


def law_of(table, row):
    """Return the law of a user in a row; None of one that another process has traced."""
    return traced_effect.laws.get(int(table.index[row, SECOND]))


class LiveLaws:
    """
    The laws of a scene, for ``core.codegen.live_scene.LiveTrace``.

    Parameters
    ----------
    table : EffectTable
        Its structure counts, not its numbers.
    at_rest : int
        As of ``LiveTrace``: which joints under dry friction may be at rest.

    """

    def __init__(self, table, at_rest=calls.EVALUATION):
        self._table, self.states, self.at_rest = table, len(table.states), at_rest
        self.columns = {calls.VALUES: VALUE_COLUMNS, calls.PRESENT: PRESENT_COLUMNS,
                        calls.GAPS: NODE_COLUMNS, calls.TRIALS: TRIAL_COLUMNS, calls.SIDES: 1,
                        calls.CUT_VALUES: CUT_VALUE_COLUMNS}
        self.cuts = [SimpleNamespace(
            slides=bool(row[SLIDES]), in_plane=bool(row[IN_PLANE]), row_a=int(row[ROW_A]),
            row_b=int(row[ROW_B]), followed=int(row[FOLLOWED]), rate_only=bool(row[RATE_ONLY]),
            columns=_CUT_COLUMNS) for row in table.cuts.index]

    def motions(self, trace):
        """Return value, rate and acceleration of prescribed motions by row and column."""
        table, found = self._table, {}
        for row in np.flatnonzero(table.kind == PRESCRIBED_MOTION).tolist():
            value, rate, change = _course(
                trace, row, int(table.index[row, STATE]), shape(table, row))
            offset = trace.at(calls.VALUES, row, 2)
            place = int(table.index[row, FIRST]), int(table.values[row, 3])
            found[place] = offset + value, rate, change
        return found

    def act(self, forces):
        """Apply all effects."""
        table = self._table
        for row, kind in enumerate(table.kind.tolist()):
            forces.row, forces.first = row, int(table.index[row, STATE])
            forces.begin, forces.count = table.index[row, [DATA, ENTRIES]].tolist()
            forces.shape, values = shape(table, row), forces.numbers(row)
            if kind in OF_A_ROW:
                OF_A_ROW[kind](forces, table, row, values)
            else:
                ALONE[kind](forces, *table.index[row, [FIRST, SECOND]].tolist(), values,
                            self._constants(forces, row))

    def _constants(self, forces, row):
        """Return what a law takes of entries: symbols, but for those that count or name."""
        table, kind = self._table, self._table.kind[row]
        found = numbers_of_entries(forces, kind, len(entries_of(table, row)))
        if kind != TENDON:
            return found
        joints = _arms(table, row)
        found[:2 * len(joints):2] = joints
        return [float(len(joints)), *table.values[row, :2].tolist(), *found]


def numbers_of_entries(forces, kind, count):
    """
    Return the numbers of an effect's entries, as its law takes them.

    Parameters
    ----------
    forces : core.codegen.live_scene.LiveForces
        Whose turn is the effect's.
    kind : int
        Of the effect.
    count : int
        Of these numbers.

    Returns
    -------
    list of Symbol, or callable
        Of a force table the function that looks up force and energy at a stroke.

    """
    if kind in smooth_laws.FORCE_TABLES:
        return lambda stroke: forces.call_engine(
            calls.LOOK_UP, force_table.COLUMNS, 0.0, stroke, results=1)
    return [forces.entry(k) for k in range(count)]


def _course(trace, row, first, terms):
    """
    Return the value of a course at the time in the first state, its rate and its change.

    Where its terms are not known, only the value is that of an expression, too.
    """
    present = [trace.at(calls.PRESENT, row, n) for n in range(PRESENT_COLUMNS)]
    if terms == ('expression',):
        return present[3:6]
    high, turns = terms or (True, True)
    c = present[3:]
    u = trace.state(first) - present[1] - present[2]
    last = c[3] + u * (c[4] + u * c[5]) if high else c[3]
    value = c[0] + u * (c[1] + u * (c[2] + u * last))
    rate = c[1] + u * (2.0 * c[2] + 3.0 * u * c[3])
    change = 2.0 * c[2] + 6.0 * u * c[3]
    if high:
        rate = rate + u * u * u * (4.0 * c[4] + 5.0 * u * c[5])
        change = change + u * u * (12.0 * c[4] + 20.0 * u * c[5])
    if turns:
        size, turning = c[6], c[7]
        angle = turning * u + c[8]
        value = value + size * sine(angle)
        rate = rate + size * turning * cosine(angle)
        change = change - size * turning * turning * sine(angle)
    if terms is None:
        value = chosen(trace.at(calls.VALUES, row, 1) > 0.5, c[0], value)
    return value, rate, change


def _present(forces):
    """Return the value of the course of the effect whose turn it is, its rate and its change."""
    return _course(forces.trace, forces.row, forces.first, forces.shape)


def _prescribed_torque(forces, joint, _, __, ___):
    torque = _present(forces)[0]
    forces.twist(joint, torque)
    power = torque * forces.rate(joint)
    forces.flow(1.0, 0.0, power)
    forces.read(torque, power)


def _prescribed_force(size):
    def law(forces, body, _, values, __):
        force = _present(forces)[0]
        power = push_along(forces, size, body, values, force)
        forces.flow(1.0, 0.0, power)
        forces.read(force, power)
    return law


def _prescribed_motion(forces, table, row, _):
    rate = _present(forces)[1]
    forces.flow(1.0, 0.0)
    forces.driven.append((forces.first + 2, int(table.index[row, SECOND]), rate))


def _along(table, row, trace):
    """Return joints and moment arms of the sum along which an effect acts."""
    begin, joints = int(table.index[row, DATA]), _arms(table, row)
    return [(joint, trace.entry(begin + 2 * k + 1)) for k, joint in enumerate(joints)] or [
        (int(table.index[row, FIRST]), 1.0)]


def _joint_friction(forces, table, row, values):
    arms = _along(table, row, forces.trace)
    rate = sum(forces.rate(joint) * arm for joint, arm in arms)
    most = values[0] + values[3] * forces.state(1)
    if table.values[row, 1] > 1.0:
        ratio = rate / values[2]
        most = most * (1.0 + (values[1] - 1.0) * exponential(-(ratio * ratio)))
    direction = forces.state(0)
    slides = abs(direction) > 0.5
    if forces.trace.laws.at_rest != calls.EVALUATION:
        # One that breaks away within a step goes on as one that slides.
        breaks_away = abs(rate) > REST
        direction = chosen(slides, direction, rate)
        # Where loops and motions hold it, no response decides.
        limit = chosen(values[4] > 0.0, 0.0, most)
        forces.resting.append((chosen(slides, 0.0, chosen(breaks_away, 0.0, limit)), arms))
        sliding = chosen(direction < 0.0, most, -most)
        torque = chosen(slides, sliding, chosen(breaks_away, sliding, 0.0))
    else:
        # At rest other forces follow from accelerations.
        bool(slides)
        torque = chosen(direction < 0.0, most, -most)
    for joint, arm in arms:
        forces.twist(joint, torque * arm)
    forces.flow(0.0, 0.0, -(torque * rate))


def _law(forces, table, row, values):
    width = traced_effect.COLUMNS
    entries = [[*one[:user_laws.STRUCTURE], *(
        forces.entry(width * k + n) for n in range(user_laws.STRUCTURE, width))]
        for k, one in enumerate(user_laws.measured_entries(table, row).tolist(), 1)]
    law = law_of(table, row)
    clock = int(law.follows_time)
    user_laws.apply(forces, law, entries, values, forces.state(0) if clock else None, [
        forces.state(clock + n) for n in range(len(law.states))])


def _actuator(forces, joint, _, values, __):
    limit, rate, given = values[0], forces.rate(joint), forces.command(joint)

    def limited(torque):
        return larger(-limit, smaller(limit, torque))

    torque = command = limited(given)
    lags, = forces.shape or (values[2] > 0.0,)
    if lags is not False:
        torque = forces.state(0)
        forces.flow(chosen(lags, (command - torque) / values[2], 0.0))
        # A limit may have been lowered since.
        torque = chosen(lags, limited(torque), command)
    speed = abs(rate)
    fading = torque * larger(0.0, 1.0 - speed / values[1]) / FADING
    torque = chosen(torque * rate > 0.0, chosen(
        speed > (1.0 - FADING) * values[1], fading, torque), torque)
    forces.twist(joint, torque - given)
    forces.flow(torque * rate, first=1)
    forces.read(torque)


def _cable(forces, table, row, values):
    begin, entries = int(table.index[row, DATA]), entries_of(table, row).reshape(-1, cable.COLUMNS)
    bodies = entries[:, 0].astype(int).tolist()
    numbers = [[forces.trace.entry(begin + cable.COLUMNS * k + n) for n in range(cable.COLUMNS)]
               for k in range(len(entries))]
    radii = [one[3] if known != 0.0 else 0.0 for one, known in zip(numbers, entries[:, 3])]
    offsets = [forces.turned(body, one[1:3]) for body, one in zip(bodies, numbers)]
    places, velocities = zip(*map(forces.place, bodies, offsets))
    length, wound, rate, ways, directions = 0.0, 0.0, 0.0, [], []
    for k in range(len(bodies) - 1):
        apart = subtract(places[k + 1], places[k])
        # From center to center the way goes along the tangent, and across by what radii differ.
        between, across = dot(apart, apart), radii[k + 1] - radii[k]
        straight = square_root(larger(0.0, between - across * across))
        ways.append((straight * apart[0] + across * apart[1],
                     straight * apart[1] - across * apart[0], 0.0))
        directions.append(scale(ways[k], 1.0 / chosen(between > 0.0, between, 1.0)))
        length = length + straight
        rate = rate + dot(directions[k], subtract(velocities[k + 1], velocities[k]))
        if k > 0 and entries[k, 3] != 0.0:
            before, after = ways[k - 1:]
            turn = before[0] * after[1] - before[1] * after[0]
            turn = -turn if entries[k, 3] < 0.0 else turn
            # A quarter turn from -180 to 180 degrees: -90 to 270.
            length = length + abs(radii[k]) * (0.25 * math.tau)
            wound = wound + abs(radii[k]) * arctangent(-dot(before, after), turn)
    stretch = length - values[1] + wound
    elastic = values[0] * forces.pressed(stretch, rate)
    tension = elastic * larger(0.0, 1.0 + values[2] * rate)
    forces.flow((tension - elastic) * rate)
    for k, direction in enumerate(directions):
        pull = scale(direction, tension)
        forces.push(bodies[k], offsets[k], pull)
        forces.push(bodies[k + 1], offsets[k + 1], scale(pull, -1.0))


# Laws that read nothing of their row but symbols, and those whose structure is the row's.
ALONE = {**smooth_laws.LAWS, **contact_laws.LAWS, ACTUATOR: _actuator,
         PRESCRIBED_FORCE: _prescribed_force(2), PRESCRIBED_TORQUE: _prescribed_torque,
         SPATIAL_PRESCRIBED_FORCE: _prescribed_force(3)}
OF_A_ROW = {CABLE: _cable, JOINT_FRICTION: _joint_friction, PRESCRIBED_MOTION: _prescribed_motion,
            SPATIAL_TRACED: _law, TRACED: _law}
LAWS = {**ALONE, **OF_A_ROW}
