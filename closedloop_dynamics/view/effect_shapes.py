# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Shapes of effects: springs, cables and contact surfaces, in the page's coordinates."""


import numpy as np

from ..effects.body_contact import BodyContact
from ..effects.cable import Cable
from ..effects.contact import Contact
from ..mechanism.rotations import direction, in_three, turned

# Pieces of a circle, and of a piece of a spline.
CIRCLE, SPLINE = 48, 4
# Half the length of a line, in radii of its roller.
SHORT = 6.0


def effect_lines(mechanism, effects, rows, heights, above):
    """
    Return the springs and cables, with their ends.

    ``rows`` and ``heights`` are by body: its number, -1 for the ground, and its layer above the
    plane [m]; lines are ``above`` the higher of two layers [m]. Of each: kind, name, ends (number
    of a body, place in its frame [m]), of a cable radii, and under ``anchor`` the key of the
    effect that the last end follows; in space the axis of the pulleys, with the body that it is
    fixed in.
    """
    found = []
    points = {point.name: point for point in mechanism.points}

    def ends(names):
        bodies = [points[name].body for name in names]
        height = max(map(heights.get, bodies)) + above
        return [[rows[body], [*points[name].position, height][:3]]
                for body, name in zip(bodies, names)]

    for name, record in effects.items():
        if isinstance(record, Cable):
            ropes = {'kind': 'cable', 'name': name, 'ends': ends(record.points),
                     'radii': list(record.radii or ())}
            if record.axis is not None:
                # The body of the first pulley.
                first = next(k for k, radius in enumerate(record.radii) if radius)
                ropes['axis'] = [ropes['ends'][first][0], list(record.axis)]
            found.append(ropes)
        elif record.DRAWN_AS_SPRING and record.point_a is not None:
            line = {'kind': 'spring', 'name': name, 'ends': ends(
                [name for name in (record.point_a, record.point_b) if name is not None])}
            if record.point_b is None:
                height = line['ends'][0][1][2]
                line['ends'].append([-1, [*record.anchor, height][:3]])
                line['anchor'] = 'anchor'
            found.append(line)
    return found


def surfaces(effects):
    """Return the lines and planes that contacts press on: place, and normal to the free side."""
    return [{'name': name, 'place': in_three(record.origin).tolist(), 'normal': list(
        record.normal or in_three(face_normal(record)).tolist())}
        for name, record in effects.items() if isinstance(record, Contact)]


def wires(mechanism, effects, rows, heights, above):
    """Return outlines of rollers and of their counterparts, in their bodies' frames."""
    points, found = {point.name: point for point in mechanism.points}, []
    for name, record in effects.items():
        if not isinstance(record, BodyContact):
            continue
        if not mechanism.planar:
            found += [{'name': name, 'body': rows[points[point].body],
                       'places': (ring + points[point].position).tolist()}
                      for point, some in ((record.point, _ball(record.radius)),
                                          (record.other, rings_of(record))) for ring in some]
            continue
        rolling = _line(record) if record.shape == 'face' else circle(record.radius)
        for point, places in ((record.point, rolling), (record.other, outline_of(record))):
            if len(places):
                body = points[point].body
                found.append({'name': name, 'body': rows[body], 'places': [
                    [*place, heights[body] + above]
                    for place in (places + points[point].position).tolist()]})
    return found


def outline_of(contact):
    """Return the line, circle or curve about the other point of a contact, shape (n, 2) [m]."""
    if contact.shape == 'line':
        return _line(contact)
    if contact.shape == 'circle':
        return circle(contact.other_radius)
    pieces = np.array(contact.pieces)
    powers = (np.arange(SPLINE) / SPLINE)[:, None] ** np.arange(4)
    places = np.stack([pieces[:, :4] @ powers.T, pieces[:, 4:] @ powers.T], axis=-1).reshape(-1, 2)
    end = pieces[-1].reshape(2, 4).sum(axis=1)
    return np.vstack([places, end])


def _line(contact):
    """Return a short part of the endless line of a contact about its point, shape (2, 2) [m]."""
    angle = contact.angle or 0.0
    half = SHORT * (contact.radius or 1.0)
    if contact.pieces:
        half = np.abs(np.array(contact.pieces)[:, [0, 4]]).max()
    along = half * direction(angle)
    return np.array([-along, along])


def rings_of(contact):
    """
    Return lines of the plane, sphere or cylinder of a body contact about its point [m].

    They are arrays of shape (n, 3). How large a plane is, and how long a cylinder, is not given:
    they are drawn short.
    """
    if contact.shape == 'sphere':
        return _ball(contact.other_radius)
    along = np.array(contact.normal or contact.axis)
    across = np.linalg.svd(along[np.newaxis])[2][1:]
    if contact.shape == 'plane':
        half = SHORT * (contact.radius or 1.0)
        return [half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) @ across]
    ring = circle(contact.other_radius) @ across
    return [ring + share * contact.other_radius * along for share in (-1.0, 0.0, 1.0)]


def _ball(radius):
    """Return three circles of a ball."""
    return [circle(radius) @ np.delete(np.eye(3), k, axis=0) for k in range(3) if radius]


def normal_of(contact, place, outline=None):
    """
    Return the direction in which a body contact pushes its roller, in the other body.

    ``place``, shape (2,) or (3,), is the roller's centre from the other point on [m], along the
    other body's axes; ``outline``, of a curve, is by ``outline_of``.
    """
    if contact.shape == 'plane':
        return np.array(contact.normal)
    if contact.shape == 'line':
        return face_normal(contact)
    if contact.shape != 'curve':
        out = -place if contact.hollow else place
        if contact.axis is not None:
            out = out - (out @ contact.axis) * np.array(contact.axis)
        return out / (np.linalg.norm(out) or 1.0)
    starts, along = outline[:-1], np.diff(outline, axis=0)
    share = np.clip(np.sum((place - starts) * along, axis=1) / np.sum(along ** 2, axis=1), 0, 1)
    away = place - starts - share[:, None] * along
    nearest = int(np.argmin(np.sum(away ** 2, axis=1)))
    # The free side is on the left.
    x, y = along[nearest] / np.linalg.norm(along[nearest])
    return np.array([-y, x])


def face_normal(contact):
    """Return the normal of a line or face to its free side, in its body, shape (2,)."""
    return turned(contact.angle or 0.0, np.array([0.0, 1.0]))


def circle(radius):
    """Return a closed circle, shape (n, 2) [m]; without a radius no places."""
    if not radius:
        return np.zeros((0, 2))
    angles = 2.0 * np.pi * np.arange(CIRCLE + 1) / CIRCLE
    return radius * direction(angles)
