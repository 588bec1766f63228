# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of contacts on symbols, for the evaluation of a scene that the engine runs.

The same as those of the engine (``contact_laws.cpp``, ``body_contact_laws.cpp``). Whether a
contact acts the engine has decided before: it is a load. Where on a curve it acts the engine is
asked. A law takes the forces (``core.codegen.live_scene.LiveForces``), the table of effects, its
row there and the row's numbers.
"""

from . import curve
from .table import (
    CIRCLE_CONTACT, CONTACT, CURVE_CONTACT, DATA, ENTRIES, FACE_CONTACT, FIRST, LINE_CONTACT,
    SECOND, SPATIAL_BODY_CONTACT, SPATIAL_CONTACT)
from ..core.codegen import function_table as calls
from ..core.codegen.expression_graph import chosen, larger, square_root
from ..core.codegen.vectors import add, dot, in_space, scale, subtract


def known_power(exponent):
    """Return an exponent of the depth that has code of its own; zero for any other."""
    return exponent if exponent in (1.0, 1.5) else 0.0


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
    elastic = _elastic_force(values[6], values[7], known_power(table.values[row, 7]), gap)
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


def _pieces(table, row):
    """Return where the pieces of a curve begin, and how many numbers they are."""
    return int(table.index[row, DATA]), curve.COLUMNS * int(table.index[row, ENTRIES])


def _curve_contact(forces, table, row, values):
    bodies = _bodies(table, row)
    center, apart = _centers(forces, table, row, values)
    in_body = _seen_from(forces, bodies[1], apart)
    forces.pass_by((*in_body, 0.0), _speed_apart(forces, bodies, center))
    distance, x, y = forces.call_engine(
        calls.NEAREST, *_pieces(table, row), values[5], *in_body, results=2)
    _press(forces, table, row, values, center, forces.turned(bodies[1], (x, y)), distance)


def _face_contact(forces, table, row, values):
    a, b = _bodies(table, row)
    # The face is a line of the first body; its normal points away from that.
    line = forces.turned(a, (values[5], values[11]))
    out = -line[1], line[0], 0.0
    deepest = forces.call_engine(calls.FURTHEST, *_pieces(table, row), 0.0, *(
        -one for one in _seen_from(forces, b, out)), results=1)
    other, _ = forces.place(b, forces.turned(b, values[2:4]))
    place = add(other, forces.turned(b, deepest))
    roller, _ = forces.place(a, forces.turned(a, values[:2]))
    _press(forces, table, row, values, place, scale(out, -1.0), dot(out, subtract(place, roller)))


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
    # ``store_path`` of a plane is never called.
    forces.pass_by(apart, _speed_apart(forces, bodies, center))
    place = subtract(center, scale(out, values[4]))
    velocity = _velocity(forces, bodies, place)
    rate = -dot(out, velocity)
    sliding, slip = _sliding(velocity, rate, out)
    normal, along = _contact(
        forces, table, row, values, distance - values[4], rate, slip)
    _push_both(forces, bodies, place, _contact_force(out, normal, along, sliding, slip))


LAWS = {CIRCLE_CONTACT: _circle_contact, CONTACT: _point_contact, CURVE_CONTACT: _curve_contact,
        FACE_CONTACT: _face_contact, LINE_CONTACT: _line_contact,
        SPATIAL_BODY_CONTACT: _spatial_body_contact, SPATIAL_CONTACT: _spatial_point_contact}
