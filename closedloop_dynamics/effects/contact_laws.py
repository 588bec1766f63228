# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of contacts on symbols, for what the engine runs: a whole scene, or each law by itself.

Whether a contact acts the engine has decided before: it is a load. The engine finds where on a
curve it acts. A law takes what a smooth one does (``smooth_laws``), the forces as
``core.codegen.live_scene.LiveForces``.
"""

from . import curve
from .body_contact import DIRECTION, FLAT, PLACE_B, ROUND
from .table import (
    CIRCLE_CONTACT, CONTACT, CURVE_CONTACT, FACE_CONTACT, LINE_CONTACT, SPATIAL_BODY_CONTACT,
    SPATIAL_CONTACT)
from ..core.codegen import function_table as calls
from ..core.codegen.expression_graph import chosen, larger, square_root
from ..core.codegen.vectors import add, dot, in_space, scale, subtract


def known_power(exponent):
    """Return an exponent of the depth that has code of its own; zero for any other."""
    return exponent if exponent in (1.0, 1.5) else 0.0


def _elastic_force(stiffness, exponent, power, gap):
    """
    Return the elastic force k d^n of a contact.

    Beyond its end, until the step is cut there, a contact pulls: so the motion is smooth, and the
    end is located to rounding.
    """
    depth = abs(gap)
    if power == 1.0:
        return -(stiffness * gap)
    force = stiffness * (depth * square_root(depth)) if power == 1.5 else (
        stiffness * depth ** exponent)
    return chosen(gap > 0.0, -force, force)


def _contact(forces, values, gap, rate, slip, scraping=None):
    """
    Return forces of a contact, zero where there is none, that push apart and along the sliding.

    ``rate``: of approach; ``slip``: of what slides along; ``scraping``: force per depth [N/m].
    """
    inside = forces.touches(gap, -rate)
    sign = slip / square_root(slip * slip + values[10] * values[10])
    power, = forces.shape or (0.0,)
    elastic = chosen(inside, _elastic_force(values[6], values[7], power, gap), 0.0)
    normal = elastic * larger(0.0, 1.0 + values[8] * rate)
    along = friction = -(values[9] * normal * sign)
    depth = chosen(inside, -gap, 0.0)
    last = chosen(inside, slip, 0.0)
    if scraping is not None:
        last = -(scraping * depth * sign)
        along = friction + last
    forces.flow((normal - elastic) * rate - along * slip)
    forces.store(elastic * depth / (values[7] + 1.0))
    forces.read(depth, normal, friction, last)
    return normal, along


def _point_contact(forces, body, _, values, __):
    offset = forces.turned(body, values[:2])
    x, y = values[4:6]
    place, velocity = forces.place(body, offset)
    apart = subtract(place, in_space(values[2:4]))
    depth = y * apart[0] - x * apart[1]
    rate = y * velocity[0] - x * velocity[1]
    normal, along = _contact(
        forces, values, -depth, rate, x * velocity[0] + y * velocity[1], values[11])
    forces.push(body, offset, (along * x - normal * y, along * y + normal * x, 0.0))


def _sliding(velocity, rate, out):
    """Return the sliding part of a velocity, and its speed."""
    sliding = add(velocity, scale(out, rate))
    return sliding, square_root(dot(sliding, sliding))


def _contact_force(out, normal, along, sliding, slip):
    drag = chosen(slip > 0.0, along / chosen(slip > 0.0, slip, 1.0), 0.0)
    return add(scale(out, normal), scale(sliding, drag))


def _spatial_point_contact(forces, body, _, values, __):
    offset, out = forces.turned(body, values[:3]), tuple(values[3:6])
    place, velocity = forces.place(body, offset)
    depth, rate = values[12] - dot(out, place), -dot(out, velocity)
    sliding, slip = _sliding(velocity, rate, out)
    normal, along = _contact(forces, values, -depth, rate, slip, values[11])
    forces.push(body, offset, _contact_force(out, normal, along, sliding, slip))


def _velocity(forces, bodies, place):
    """Return the velocity of one body at a place in the world as seen from another."""
    return subtract(*(forces.place(body, subtract(place, forces.origin(body)))[1]
                      for body in bodies))


def _push_both(forces, bodies, place, force):
    for body, push in zip(bodies, (force, scale(force, -1.0))):
        forces.push(body, subtract(place, forces.origin(body)), push)


def _press(forces, bodies, values, center, out, distance):
    """
    Press two bodies apart, in the plane.

    ``center``: of the roller; ``out``: the normal, towards that; ``distance``: of the center from
    the line or curve, less than zero beyond it [m].
    """
    radius = values[4]
    place = subtract(center, scale(out, radius))
    velocity = _velocity(forces, bodies, place)
    rate, slip = -dot(out, velocity), out[1] * velocity[0] - out[0] * velocity[1]
    normal, along = _contact(forces, values, distance - radius, rate, slip)
    _push_both(forces, bodies, place, (
        normal * out[0] + along * out[1], normal * out[1] - along * out[0], 0.0))


def _centers(forces, a, b, values):
    """Return the center of the roller, and from the named point of the other body to it."""
    center, _ = forces.place(a, forces.turned(a, values[:2]))
    return center, subtract(center, forces.place(b, forces.turned(b, values[2:4]))[0])


def _line_contact(forces, a, b, values, _):
    center, apart = _centers(forces, a, b, values)
    line = forces.turned(b, (values[5], values[11]))
    _press(forces, (a, b), values, center, (-line[1], line[0], 0.0),
           line[0] * apart[1] - line[1] * apart[0])


def _speed_apart(forces, bodies, center):
    velocity = _velocity(forces, bodies, center)
    return square_root(dot(velocity, velocity))


def _circle_contact(forces, a, b, values, _):
    center, apart = _centers(forces, a, b, values)
    between, side = square_root(dot(apart, apart)), values[11]
    forces.pass_by(apart, _speed_apart(forces, (a, b), center))
    # Where the centers meet there is no direction, and no force.
    out = scale(apart, side / chosen(between > 0.0, between, 1.0))
    _press(forces, (a, b), values, center, out, side * (between - values[5]))


def _seen_from(forces, body, vector):
    """Return a vector of the plane in the axes of a body."""
    cosine, sine, _ = forces.turned(body, (1.0, 0.0))
    return cosine * vector[0] + sine * vector[1], cosine * vector[1] - sine * vector[0]


def _curve_contact(forces, a, b, values, _):
    center, apart = _centers(forces, a, b, values)
    in_body = _seen_from(forces, b, apart)
    forces.pass_by((*in_body, 0.0), _speed_apart(forces, (a, b), center))
    distance, x, y = forces.call_engine(
        calls.NEAREST, curve.COLUMNS, values[5], *in_body, results=2)
    _press(forces, (a, b), values, center, forces.turned(b, (x, y)), distance)


def _face_contact(forces, a, b, values, _):
    # The face is a line of the first body; its normal points away from that.
    line = forces.turned(a, (values[5], values[11]))
    out = -line[1], line[0], 0.0
    deepest = forces.call_engine(calls.FURTHEST, curve.COLUMNS, 0.0, *(
        -one for one in _seen_from(forces, b, out)), results=1)
    other, _ = forces.place(b, forces.turned(b, values[2:4]))
    place = add(other, forces.turned(b, deepest))
    roller, _ = forces.place(a, forces.turned(a, values[:2]))
    _press(forces, (a, b), values, place, scale(out, -1.0), dot(out, subtract(place, roller)))


def _spatial_body_contact(forces, a, b, values, data):
    bodies = a, b
    center, _ = forces.place(a, forces.turned(a, data[:3]))
    direction = forces.turned(b, data[DIRECTION:DIRECTION + 3])
    apart = subtract(center, forces.place(b, forces.turned(b, data[PLACE_B:PLACE_B + 3]))[0])
    height = dot(direction, apart)
    # What lies along a cylinder's axis does not count.
    apart = subtract(apart, scale(direction, data[ROUND] * height))
    between, flat, side = square_root(dot(apart, apart)), data[FLAT] > 0.5, values[11]
    unit = scale(apart, side / chosen(between > 0.0, between, 1.0))
    out = tuple(chosen(flat, along, one) for along, one in zip(direction, unit))
    distance = chosen(flat, height, side * (between - values[5]))
    forces.pass_by(apart, _speed_apart(forces, bodies, center))
    place = subtract(center, scale(out, values[4]))
    velocity = _velocity(forces, bodies, place)
    rate = -dot(out, velocity)
    sliding, slip = _sliding(velocity, rate, out)
    normal, along = _contact(forces, values, distance - values[4], rate, slip)
    _push_both(forces, bodies, place, _contact_force(out, normal, along, sliding, slip))


LAWS = {CIRCLE_CONTACT: _circle_contact, CONTACT: _point_contact, CURVE_CONTACT: _curve_contact,
        FACE_CONTACT: _face_contact, LINE_CONTACT: _line_contact,
        SPATIAL_BODY_CONTACT: _spatial_body_contact, SPATIAL_CONTACT: _spatial_point_contact}
