# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols as the engine runs them, within the evaluation of their scene.

Those of ``traced_laws`` and, with jumps, those of effects that begin and cease within a run. What
is searched for (the piece of a course that is its turn, whether a contact is there) the engine has
found before: it is a load. A scene with an effect that has no law here is evaluated in parts, its
effects by the engine's own laws, and so is any while one of them is switched off, several joints
under dry friction are at rest, or friction feels the reaction in its joint.

"""

import math
from types import SimpleNamespace

import numpy as np

from . import cable, course, curve, force_table
from .actuator import FADING
from .table import (
    ACROSS_B, ACTUATOR, AXIS, CABLE, CIRCLE_CONTACT, CONTACT, CURVE_CONTACT, CUT_VALUE_COLUMNS,
    DATA, END_STOP, ENTRIES, FACE_CONTACT, FIRST, FOLLOWED, IN_PLANE, JOINT_FORCE_TABLE,
    JOINT_FRICTION, JOINT_SPRING, LINE_CONTACT, NODE_COLUMNS, ORIENTATION_SPRING, POINT_A,
    POINT_B, POINT_FORCE_TABLE, PRESCRIBED_FORCE, PRESCRIBED_MOTION, PRESCRIBED_TORQUE,
    PRESENT_COLUMNS, RATE_ONLY, ROW_A, ROW_B, SCALE, SECOND, SIDE_A, SIDE_B, SLIDES,
    SPATIAL_BODY_CONTACT, SPATIAL_CONTACT, SPATIAL_FORCE_TABLE, SPATIAL_PRESCRIBED_FORCE, STATE,
    TENDON, TRIAL_COLUMNS, VALUE_COLUMNS, ZERO)
from .traced_laws import LAWS as TRACED_LAWS, line_between, push_apart
from ..core.codegen import function_table as calls
from ..core.codegen.expression_graph import (
    arctangent, chosen, cosine, exponential, larger, sine, smaller, square_root)
from ..core.codegen.live_scene import address_of_scene
from ..core.codegen.machine_code import LANES, SCALAR
from ..core.codegen.vectors import add, dot, in_space, scale, subtract
from ..core.types import BALL, DOF, TYPE
from ..engine import native

# In scenes with the other ones laws of the engine act.
SMOOTH = {kind: law for kind, law in TRACED_LAWS.items() if kind != ORIENTATION_SPRING}
# Columns of EffectTable.values that only the code may depend on, of an effect's kind.
_CONSTANT = {TENDON: (0, 1), PRESCRIBED_MOTION: (3,)}
_CUT_COLUMNS = {'POINT_A': POINT_A, 'POINT_B': POINT_B, 'AXIS': AXIS, 'SIDE_A': SIDE_A,
                'SIDE_B': SIDE_B, 'ACROSS_B': ACROSS_B, 'SCALE': SCALE, 'ZERO': ZERO}
# As of ``engine/sticking.hpp`` [rad/s; m/s].
REST = 1e-6
_COURSES = (PRESCRIBED_TORQUE, PRESCRIBED_FORCE, SPATIAL_PRESCRIBED_FORCE, PRESCRIBED_MOTION)


def structure(model, table):
    """
    Return the key of the code of a scene, beside its mechanism.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    table : EffectTable
        Its effects.

    Returns
    -------
    tuple or None
        None where an effect has no law here.

    """
    kinds = table.kind.tolist()
    balls = set(model.tree[model.tree[:, TYPE] == BALL, DOF].tolist())
    for row, kind in enumerate(kinds):
        if kind not in LAWS or (kind in _IN_JOINTS and balls & set(_joints(table, row))):
            return None
    rows = tuple((kind, *table.index[row, [STATE, FIRST, SECOND, DATA, ENTRIES]].tolist(),
                  *table.values[row, list(_CONSTANT.get(kind, ()))].tolist(),
                  *_shape(table, row)) for row, kind in enumerate(kinds))
    return rows, len(table.states), table.cuts.index.tobytes()


def _entries(table, row):
    begin = table.index[row, DATA]
    after = table.index[row + 1, DATA] if row + 1 < len(table.index) else len(table.data)
    return table.data[begin:after]


def _arms(table, row):
    """Return the joints that an effect has moment arms for."""
    count = int(table.index[row, ENTRIES]) - (2 if table.kind[row] == TENDON else 0)
    return _entries(table, row)[:2 * count:2].astype(int).tolist()


def _joints(table, row):
    return _arms(table, row) or [int(table.index[row, FIRST])]


def _shape(table, row):
    """Return which terms of a law are there."""
    kind, values = table.kind[row], table.values[row]
    if kind in _COURSES:
        if values[1] == 1.0:
            return 'expression',
        pieces = _entries(table, row)
        pieces = pieces[:course.COLUMNS * table.index[row, ENTRIES]].reshape(-1, course.COLUMNS)
        return bool(pieces[:, 5:7].any()), bool(pieces[:, 7].any())
    if kind in (TENDON, JOINT_FRICTION):
        # Whether friction is larger at rest, and whether it is decided there.
        return (*_arms(table, row), bool(values[1] > 1.0)) if kind == JOINT_FRICTION else (
            *_arms(table, row),)
    if kind == ACTUATOR:
        return bool(values[2] > 0.0),
    if kind in _TOUCHING:
        return _power(values[7]),
    if kind == CABLE:
        entries = _entries(table, row).reshape(-1, cable.COLUMNS)
        return (*entries[:, 0].tolist(), *(entries[:, 3] != 0.0).tolist(),
                *np.sign(entries[:, 3]).tolist())
    return ()


def _power(exponent):
    return exponent if exponent in (1.0, 1.5) else 0.0


# Structures of the code behind addresses.
_known = {}


def link(model, table, functions, scene=None):
    """
    Give a function table the evaluation of a scene, if there is one.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    table : EffectTable
        Its effects.
    functions : ndarray of int
        The function table.
    scene : tuple, optional
        Structure that the effects had when code was generated; where they have another one now,
        there is no evaluation until they have this one again.

    """
    key = structure(model, table)
    functions[list(calls.OF_SCENE)] = 0
    if key is not None and scene in (None, key):
        for place, address in _addresses(model, table, key).items():
            functions[place] = address
        _known[int(functions[calls.EVALUATION])] = key
    functions[list(calls.FUNCTIONS)] = list(map(native.library_function, calls.FUNCTIONS))
    table.code.fits[0] = functions[calls.EVALUATION] != 0


def known_structure(functions):
    """Return the structure that the evaluation of a scene has in a function table; or None."""
    return _known.get(int(functions[calls.EVALUATION]))


def update(model, table, functions, scene):
    """Record whether the evaluation of a scene still is that of its effects; see ``link``."""
    known, present = known_structure(functions), structure(model, table)
    if known is None and scene is not None and present == scene:
        link(model, table, functions, scene)
    else:
        table.code.fits[0] = known is not None and known == present


def fit_lanes(table):
    """
    Return whether states with these effects may be evaluated in the lanes of a vector.

    Not where time ends steps, commands pass through drives, lists of numbers are searched or
    cables are watched: each lane would do that by itself.
    """
    return bool(table.code.fits[0] and table.enabled.all() and not table.loaded[0]
                and not len(table.cuts.index) and not np.isin(table.kind, _NOT_IN_LANES).any())


def addresses_in_lanes(model, tables):
    """
    Return the addresses of the evaluations of a scene in the lanes of a vector.

    Parameters
    ----------
    model : Model
        Constant arrays of one of the mechanisms.
    tables : sequence of EffectTable
        That ``fit_lanes``, one for each lane.

    Returns
    -------
    dict of int to int, or None
        By places of the function table. None where they are not of one structure.

    """
    first = tables[0]
    key = structure(model, first)
    if any(structure(model, table) != key for table in tables if table is not first):
        return None
    return _addresses(model, first, key, LANES)


def _addresses(model, table, key, form=SCALAR):
    """Return the addresses of the evaluations of a scene by place of the function table."""
    found = {calls.EVALUATION: address_of_scene(model, key, lambda: LiveLaws(table), form)}
    # Motions and cut joints would have parts in what responds to friction.
    if JOINT_FRICTION in table.kind and PRESCRIBED_MOTION not in table.kind and not len(
            table.cuts.index):
        found[calls.AT_REST] = address_of_scene(
            model, (*key, 'at rest'), lambda: LiveLaws(table, at_rest=True), form)
    return found


class LiveLaws:
    """
    The laws of a scene, for ``core.codegen.live_scene.LiveTrace``.

    Parameters
    ----------
    table : EffectTable
        Its structure counts, not its numbers.
    at_rest : bool
        Whether one joint under dry friction may be at rest; all slide otherwise.

    """

    def __init__(self, table, at_rest=False):
        """Keep the table."""
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
            value, rate, change = _course(trace, table, row)
            offset = trace.at(calls.VALUES, row, 2)
            place = int(table.index[row, FIRST]), int(table.values[row, 3])
            found[place] = offset + value, rate, change
        return found

    def act(self, forces):
        """Apply all effects."""
        table = self._table
        for row, kind in enumerate(table.kind.tolist()):
            forces.row, forces.first = row, int(table.index[row, STATE])
            law = LAWS[kind]
            if law is SMOOTH.get(kind):
                law(forces, *table.index[row, [FIRST, SECOND]].tolist(), forces.numbers(row),
                    self._constants(forces.trace, row))
            else:
                law(forces, table, row, forces.numbers(row))

    def _constants(self, trace, row):
        """Return the numbers of a row's entries: symbols, but for those that count or name."""
        table = self._table
        begin, count = int(table.index[row, DATA]), len(_entries(table, row))
        found = [trace.entry(begin + k) for k in range(count)]
        if table.kind[row] != TENDON:
            return found
        joints = _arms(table, row)
        found[:2 * len(joints):2] = joints
        return [float(len(joints)), *table.values[row, :2].tolist(), *found]


def _course(trace, table, row):
    """Return the value of a course at the time in the first state, its rate and its change."""
    present = [trace.at(calls.PRESENT, row, n) for n in range(PRESENT_COLUMNS)]
    shape = _shape(table, row)
    if shape == ('expression',):
        return present[3:6]
    high, turns = shape
    c = present[3:]
    u = trace.state(int(table.index[row, STATE])) - present[1] - present[2]
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
    return value, rate, change


def _prescribed_torque(forces, table, row, _):
    joint = int(table.index[row, FIRST])
    torque = _course(forces.trace, table, row)[0]
    forces.twist(joint, torque)
    forces.flow(1.0, 0.0, torque * forces.rate(joint))


def _prescribed_force(size):
    def law(forces, table, row, values):
        body = int(table.index[row, FIRST])
        offset, direction = forces.turned(body, values[2:2 + size]), in_space(
            values[2 + size:2 + 2 * size])
        turns = values[2 + 2 * size] > 0.5
        direction = tuple(one if one is own else chosen(turns, own, one) for own, one in zip(
            forces.turned(body, direction[:size]), direction))
        force = _course(forces.trace, table, row)[0]
        forces.push(body, offset, scale(direction, force))
        forces.flow(1.0, 0.0, force * dot(direction, forces.place(body, offset)[1]))
    return law


def _prescribed_motion(forces, table, row, _):
    rate = _course(forces.trace, table, row)[1]
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
    if forces.trace.laws.at_rest:
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


def _actuator(forces, table, row, values):
    joint, limit = int(table.index[row, FIRST]), values[0]
    rate, given = forces.rate(joint), forces.command(joint)

    def limited(torque):
        return larger(-limit, smaller(limit, torque))

    torque = command = limited(given)
    if table.values[row, 2] > 0.0:
        torque = forces.state(0)
        forces.flow((command - torque) / values[2])
        # A limit may have been lowered since.
        torque = limited(torque)
    speed = abs(rate)
    fading = torque * larger(0.0, 1.0 - speed / values[1]) / FADING
    torque = chosen(torque * rate > 0.0, chosen(
        speed > (1.0 - FADING) * values[1], fading, torque), torque)
    forces.twist(joint, torque - given)
    forces.flow(torque * rate, first=1)


def _elastic_force(stiffness, exponent, power, gap):
    """Return the elastic force of a contact, a pull beyond its end; see ``engine/forces.cpp``."""
    depth = abs(gap)
    if power == 1.0:
        return -(stiffness * gap)
    force = stiffness * (depth * square_root(depth)) if power == 1.5 else (
        stiffness * depth ** exponent)
    return chosen(gap > 0.0, -force, force)


def _contact(forces, table, row, values, gap, rate, slip):
    """
    Return forces of a contact, zero where there is none, that push apart and along the sliding.

    ``rate``: of approach; ``slip``: of what slides along.
    """
    inside = forces.touches(gap, -rate)
    sign = slip / square_root(slip * slip + values[10] * values[10])
    elastic = _elastic_force(values[6], values[7], _power(table.values[row, 7]), gap)
    normal = elastic * larger(0.0, 1.0 + values[8] * rate)
    along = -(values[9] * normal * sign)
    if table.kind[row] in (CONTACT, SPATIAL_CONTACT):
        along = along + values[11] * gap * sign
    normal, elastic, along = (chosen(inside, one, 0.0) for one in (normal, elastic, along))
    forces.flow((normal - elastic) * rate - along * slip)
    return normal, along


def _point_contact(forces, table, row, values):
    body = int(table.index[row, FIRST])
    offset = forces.turned(body, values[:2])
    x, y = values[4:6]
    place, velocity = forces.place(body, offset)
    apart = subtract(place, in_space(values[2:4]))
    depth = y * apart[0] - x * apart[1]
    rate = y * velocity[0] - x * velocity[1]
    normal, along = _contact(
        forces, table, row, values, -depth, rate, x * velocity[0] + y * velocity[1])
    forces.push(body, offset, (along * x - normal * y, along * y + normal * x, 0.0))


def _sliding(velocity, rate, out):
    """Return the sliding part of a velocity, and its speed."""
    sliding = add(velocity, scale(out, rate))
    return sliding, square_root(dot(sliding, sliding))


def _contact_force(out, normal, along, sliding, slip):
    drag = chosen(slip > 0.0, along / chosen(slip > 0.0, slip, 1.0), 0.0)
    return add(scale(out, normal), scale(sliding, drag))


def _spatial_point_contact(forces, table, row, values):
    body = int(table.index[row, FIRST])
    offset, out = forces.turned(body, values[:3]), tuple(values[3:6])
    place, velocity = forces.place(body, offset)
    depth, rate = values[12] - dot(out, place), -dot(out, velocity)
    sliding, slip = _sliding(velocity, rate, out)
    normal, along = _contact(forces, table, row, values, -depth, rate, slip)
    forces.push(body, offset, _contact_force(out, normal, along, sliding, slip))


def _bodies(table, row):
    return table.index[row, [FIRST, SECOND]].tolist()


def _velocity(forces, bodies, place):
    """Return the velocity of one body at a place in the world as seen from another."""
    return subtract(*(forces.place(body, subtract(place, forces.origin(body)))[1]
                      for body in bodies))


def _push_both(forces, bodies, place, force):
    for body, push in zip(bodies, (force, scale(force, -1.0))):
        forces.push(body, subtract(place, forces.origin(body)), push)


def _press(forces, table, row, values, center, out, distance):
    """Press two bodies apart, in the plane; as ``press`` of ``engine/body_contact_laws.cpp``."""
    bodies, radius = _bodies(table, row), values[4]
    place = subtract(center, scale(out, radius))
    velocity = _velocity(forces, bodies, place)
    rate, slip = -dot(out, velocity), out[1] * velocity[0] - out[0] * velocity[1]
    normal, along = _contact(forces, table, row, values, distance - radius, rate, slip)
    _push_both(forces, bodies, place, (
        normal * out[0] + along * out[1], normal * out[1] - along * out[0], 0.0))


def _centers(forces, table, row, values):
    """Return the center of the roller, and from the named point of the other body to it."""
    a, b = _bodies(table, row)
    center, _ = forces.place(a, forces.turned(a, values[:2]))
    return center, subtract(center, forces.place(b, forces.turned(b, values[2:4]))[0])


def _line_contact(forces, table, row, values):
    center, apart = _centers(forces, table, row, values)
    line = forces.turned(_bodies(table, row)[1], (values[5], values[11]))
    _press(forces, table, row, values, center, (-line[1], line[0], 0.0),
           line[0] * apart[1] - line[1] * apart[0])


def _speed_apart(forces, bodies, center):
    velocity = _velocity(forces, bodies, center)
    return square_root(dot(velocity, velocity))


def _circle_contact(forces, table, row, values):
    center, apart = _centers(forces, table, row, values)
    between, side = square_root(dot(apart, apart)), values[11]
    forces.pass_by(apart, _speed_apart(forces, _bodies(table, row), center))
    # Where the centers meet there is no direction, and no force.
    out = scale(apart, side / chosen(between > 0.0, between, 1.0))
    _press(forces, table, row, values, center, out, side * (between - values[5]))


def _seen_from(forces, body, vector):
    """Return a vector of the plane in the axes of a body."""
    cosine, sine, _ = forces.turned(body, (1.0, 0.0))
    return cosine * vector[0] + sine * vector[1], cosine * vector[1] - sine * vector[0]


def _pieces(columns, table, row):
    """Return where the pieces of a curve or table begin, and how many numbers they are."""
    return int(table.index[row, DATA]), columns * int(table.index[row, ENTRIES])


def _curve_contact(forces, table, row, values):
    bodies = _bodies(table, row)
    center, apart = _centers(forces, table, row, values)
    in_body = _seen_from(forces, bodies[1], apart)
    forces.pass_by((*in_body, 0.0), _speed_apart(forces, bodies, center))
    distance, x, y = forces.ask(
        calls.NEAREST, *_pieces(curve.COLUMNS, table, row), values[5], *in_body, results=2)
    _press(forces, table, row, values, center, forces.turned(bodies[1], (x, y)), distance)


def _face_contact(forces, table, row, values):
    a, b = _bodies(table, row)
    # The face is a line of the first body; its normal points away from that.
    line = forces.turned(a, (values[5], values[11]))
    out = -line[1], line[0], 0.0
    deepest = forces.ask(calls.FURTHEST, *_pieces(curve.COLUMNS, table, row), 0.0, *(
        -one for one in _seen_from(forces, b, out)), results=1)
    other, _ = forces.place(b, forces.turned(b, values[2:4]))
    place = add(other, forces.turned(b, deepest))
    roller, _ = forces.place(a, forces.turned(a, values[:2]))
    _press(forces, table, row, values, place, scale(out, -1.0), dot(out, subtract(place, roller)))


def _look_up(forces, table, row, stroke):
    return forces.ask(calls.LOOK_UP, *_pieces(force_table.COLUMNS, table, row), 0.0, stroke)


def _joint_force_table(forces, table, row, values):
    joint = int(table.index[row, FIRST])
    rate = forces.rate(joint)
    force, = _look_up(forces, table, row, forces.coordinate(joint))
    loss = values[0] * rate
    forces.twist(joint, force - loss)
    forces.flow(loss * rate)


def _point_force_table(size):
    def law(forces, table, row, values):
        bodies = _bodies(table, row)
        offsets, direction, length, rate = line_between(
            forces, bodies, (values[1:1 + size], values[1 + size:1 + 2 * size]))
        force, = _look_up(forces, table, row, length)
        push_apart(forces, bodies, offsets, direction, -(force + values[0] * rate))
        forces.flow(values[0] * rate * rate)
    return law


def _spatial_body_contact(forces, table, row, values):
    bodies, (a, b) = _bodies(table, row), _bodies(table, row)
    begin = int(table.index[row, DATA])
    data = [forces.trace.entry(begin + k) for k in range(11)]
    center, _ = forces.place(a, forces.turned(a, data[:3]))
    direction = forces.turned(b, data[6:9])
    apart = subtract(center, forces.place(b, forces.turned(b, data[3:6]))[0])
    height = dot(direction, apart)
    # What lies along a cylinder's axis does not count.
    apart = subtract(apart, scale(direction, data[10] * height))
    between, flat, side = square_root(dot(apart, apart)), data[9] > 0.5, values[11]
    unit = scale(apart, side / chosen(between > 0.0, between, 1.0))
    out = tuple(chosen(flat, along, one) for along, one in zip(direction, unit))
    distance = chosen(flat, height, side * (between - values[5]))
    # ``store_path`` of a plane is never asked for.
    forces.pass_by(apart, _speed_apart(forces, bodies, center))
    place = subtract(center, scale(out, values[4]))
    velocity = _velocity(forces, bodies, place)
    rate = -dot(out, velocity)
    sliding, slip = _sliding(velocity, rate, out)
    normal, along = _contact(
        forces, table, row, values, distance - values[4], rate, slip)
    _push_both(forces, bodies, place, _contact_force(out, normal, along, sliding, slip))


def _cable(forces, table, row, values):
    begin, entries = int(table.index[row, DATA]), _entries(table, row).reshape(-1, cable.COLUMNS)
    bodies = entries[:, 0].astype(int).tolist()
    numbers = [[forces.trace.entry(begin + cable.COLUMNS * k + n) for n in range(cable.COLUMNS)]
               for k in range(len(entries))]
    radii = [one[3] if known != 0.0 else 0.0 for one, known in zip(numbers, entries[:, 3])]
    offsets = [forces.turned(body, one[1:3]) for body, one in zip(bodies, numbers)]
    places, velocities = zip(*map(forces.place, bodies, offsets))
    length, rate, directions = 0.0, 0.0, []
    for k in range(len(bodies) - 1):
        apart = subtract(places[k + 1], places[k])
        # From center to center the way goes along the tangent, and across by what radii differ.
        between, across = dot(apart, apart), radii[k + 1] - radii[k]
        straight = square_root(larger(0.0, between - across * across))
        share = 1.0 / chosen(between > 0.0, between, 1.0)
        along, beside = straight * share, across * share
        directions.append((along * apart[0] + beside * apart[1],
                           along * apart[1] - beside * apart[0], 0.0))
        length = length + straight
        rate = rate + dot(directions[k], subtract(velocities[k + 1], velocities[k]))
        if k > 0 and entries[k, 3] != 0.0:
            before, after = directions[k - 1:]
            turn = arctangent(before[0] * after[1] - before[1] * after[0], dot(before, after))
            turn = -turn if entries[k, 3] < 0.0 else turn
            turn = chosen(turn < -0.25 * math.tau, turn + math.tau, turn)
            length = length + abs(radii[k]) * turn
    stretch = length - values[1]
    elastic = values[0] * chosen(forces.touches(-stretch, -rate), stretch, 0.0)
    tension = elastic * larger(0.0, 1.0 + values[2] * rate)
    forces.flow((tension - elastic) * rate)
    for k, direction in enumerate(directions):
        pull = scale(direction, tension)
        forces.push(bodies[k], offsets[k], pull)
        forces.push(bodies[k + 1], offsets[k + 1], scale(pull, -1.0))


LAWS = {**SMOOTH, ACTUATOR: _actuator, CABLE: _cable, CIRCLE_CONTACT: _circle_contact,
        CONTACT: _point_contact, CURVE_CONTACT: _curve_contact, FACE_CONTACT: _face_contact,
        JOINT_FORCE_TABLE: _joint_force_table, JOINT_FRICTION: _joint_friction,
        LINE_CONTACT: _line_contact, POINT_FORCE_TABLE: _point_force_table(2),
        PRESCRIBED_FORCE: _prescribed_force(2), PRESCRIBED_MOTION: _prescribed_motion,
        PRESCRIBED_TORQUE: _prescribed_torque, SPATIAL_BODY_CONTACT: _spatial_body_contact,
        SPATIAL_CONTACT: _spatial_point_contact, SPATIAL_FORCE_TABLE: _point_force_table(3),
        SPATIAL_PRESCRIBED_FORCE: _prescribed_force(3)}
_IN_JOINTS = (ACTUATOR, END_STOP, JOINT_FORCE_TABLE, JOINT_FRICTION, JOINT_SPRING, TENDON)
_NOT_IN_LANES = (*_COURSES, ACTUATOR, CABLE, CURVE_CONTACT, FACE_CONTACT, JOINT_FORCE_TABLE,
                 POINT_FORCE_TABLE, SPATIAL_FORCE_TABLE)
_TOUCHING = (CONTACT, SPATIAL_CONTACT, LINE_CONTACT, CIRCLE_CONTACT, CURVE_CONTACT, FACE_CONTACT,
             SPATIAL_BODY_CONTACT)
