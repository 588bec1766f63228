# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Outlines of cams and Geneva wheels, from the numbers that a designer has.

``outline: {geneva: {slots: 5, distance: 100 mm}}`` and ``outline: {cam: {base: 40 mm, motion:
[...]}}`` of a contact stand for the points x and y of its curve. The roller, or the pin, is that
of the contact.
"""

import math

import numpy as np

from ..mechanism.checks import listed, not_negative, number, one_of, positive
from ..mechanism.fields import at, FieldError, mapping, shown

# Points of a cam's outline, and of a half circle of a slot or an arc between two of them.
CAM_POINTS, ARC_POINTS = 180, 9
# Fewer slots leave no wheel.
LEAST_SLOTS = 3


def _cycloid(u):
    return u - np.sin(2.0 * math.pi * u) / (2.0 * math.pi)


def _polynomial(u):
    return u ** 3 * (10.0 - 15.0 * u + 6.0 * u ** 2)


def _modified_sine(u):
    # Norton, Cam Design and Manufacturing Handbook: accelerations of a sine of a short period at
    # both ends, of a long one between.
    whole = 4.0 + math.pi
    return np.where(
        u < 0.125, (math.pi * u - 0.25 * np.sin(4.0 * math.pi * u)) / whole, np.where(
            u < 0.875, (2.0 + math.pi * u - 2.25 * np.sin(
                (4.0 * math.pi * u + math.pi) / 3.0)) / whole,
            (4.0 + math.pi * u - 0.25 * np.sin(4.0 * math.pi * u)) / whole))


# Share of the lift by share of the angle.
LAWS = {'cycloid': _cycloid, '3-4-5': _polynomial, 'modified_sine': _modified_sine}


def lift(motion, angle):
    """
    Return the lift of a cam's follower at angles of the cam, shape (n,) [m].

    ``motion`` is a list of pieces, each with its angle ``over`` [rad], all of them a whole turn: a
    rise or fall ``to`` a lift [m] by a ``law``, or a dwell, with neither. FieldError.
    """
    angle = np.asarray(angle, dtype=float) % (2.0 * math.pi)
    pieces, begin, found = [], 0.0, np.zeros(len(angle))
    for index, piece in enumerate(listed(motion, 'a list of rises, falls and dwells')):
        with at(index):
            mapping(piece, ('over',), ('to', 'law'))
            with at('over'):
                over = positive(piece['over'])
            with at('to'):
                to = not_negative(piece['to']) if 'to' in piece else None
            with at('law'):
                law = one_of(tuple(LAWS))(piece.get('law', 'cycloid'))
            if to is None and 'law' in piece:
                raise FieldError('a lift to rise or fall to, with a law', 'none', path=('to',))
            pieces.append((begin, over, to, LAWS[law]))
            begin += over
    if not abs(begin - 2.0 * math.pi) < 1e-9:
        raise FieldError('pieces that are a whole turn together, 2 pi', shown(begin))
    height = next((to for *_, to, _ in reversed(pieces) if to is not None), 0.0)
    for begin, over, to, law in pieces:
        inside = (angle >= begin) & (angle <= begin + over)
        end = height if to is None else to
        found[inside] = height + (end - height) * law((angle[inside] - begin) / over)
        height = end
    return found


def outline(radius, value):
    """
    Return the keys of a contact that an ``outline`` stands for.

    ``radius`` is that of the roller [m]. FieldError.
    """
    mapping(value, (), SHAPES)
    if len(value) != 1:
        raise FieldError(f'one of {", ".join(SHAPES)}', shown(list(value)))
    (kind, keys), = value.items()
    make, required, checks = SHAPES[kind]
    with at(kind):
        mapping(keys, required, [key for key in checks if key not in required])
        given = {}
        for key, one in keys.items():
            with at(key):
                given[key] = checks[key](one)
        x, y = make(radius, **given)
    return {'x': x.tolist(), 'y': y.tolist(),
            **({'interpolation': 'linear'} if kind == 'geneva' else {})}


def _slots(value):
    if isinstance(value, bool) or value != int(number(value)) or value < LEAST_SLOTS:
        raise FieldError(f'a whole number from {LEAST_SLOTS} on', shown(value))
    return int(value)


def cam(radius, base, motion, points=CAM_POINTS):
    """
    Return x and y of a cam's outline [m], shape (points,) each.

    The centre of a roller of a ``radius`` goes along a line through the cam's axis: ``base``
    circle, radius and ``lift`` away from it. The lift begins on the cam's x axis; seen from a cam
    that turns counter-clockwise its follower goes round clockwise.
    """
    angle = np.arange(points) * 2.0 * math.pi / points
    ahead = 1e-5
    with at('motion'):
        away = base + radius + lift(motion, angle)
    slope = (lift(motion, angle + ahead) - lift(motion, angle - ahead)) / (2.0 * ahead)
    way = -angle
    # Along the path of the roller's centre, then to its right: towards the axis.
    along = np.array([-slope * np.cos(way) - away * np.sin(way),
                      -slope * np.sin(way) + away * np.cos(way)])
    along /= np.linalg.norm(along, axis=0)
    return np.array([away * np.cos(way) - radius * along[1],
                     away * np.sin(way) + radius * along[0]])


def geneva(radius, slots, distance, clearance=0.0, tip=None):
    """
    Return x and y of the outline of a Geneva wheel [m].

    Its pin, of a ``radius``, enters slots along their axes: it is ``distance`` sin(pi / slots)
    away from the driver's axis, which is that far from the wheel's. One slot is along x. ``tip``:
    width of the wheel's edge beside a slot, where the arc about the driver's locking disc ends.
    """
    half = math.pi / slots
    crank, outer, wide = distance * math.sin(half), distance * math.cos(half), radius + clearance
    tip = 0.5 * radius if tip is None else tip
    lock = crank - wide - tip
    if not lock > 0.0:
        raise FieldError(f'a pin and tips that leave room for a locking disc, {crank:.4g} m from '
                         'the axis of the driver', f'{wide + tip:.4g} m of them')
    bottom = distance - crank + clearance - radius / 3.0
    if not bottom > wide:
        raise FieldError('slots that end before the axis of the wheel',
                         f'slots to {bottom - wide:.4g} m from it')
    turns = np.linspace(-0.5, 0.5, ARC_POINTS) * math.pi
    slot = np.column_stack([bottom - wide * np.cos(turns), wide * np.sin(turns)])
    # About the axis of the driver, from the edge beside this slot to that beside the next.
    sweep = np.linspace(-0.5 * math.pi, 2.0 * half - 1.5 * math.pi, ARC_POINTS)
    arc = np.array([outer, crank]) + lock * np.column_stack([np.cos(sweep), np.sin(sweep)])
    piece = np.vstack([[[outer, -wide]], slot, [[outer, wide]], arc])
    angles = 2.0 * half * np.arange(slots)
    return np.hstack([[np.cos(a) * piece[:, 0] - np.sin(a) * piece[:, 1],
                       np.sin(a) * piece[:, 0] + np.cos(a) * piece[:, 1]] for a in angles])


# Kind of an outline -> the function of it, the keys that it needs, and the checks of all.
SHAPES = {
    'cam': (cam, ('base', 'motion'), {'base': positive, 'motion': lambda value: value}),
    'geneva': (geneva, ('slots', 'distance'), {
        'slots': _slots, 'distance': positive, 'clearance': not_negative, 'tip': not_negative})}
