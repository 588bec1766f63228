# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Wheels, racks and belts, and their outlines.

Which of them a mechanism has: ``transmissions``.
"""

from typing import NamedTuple

import numpy as np

from ..mechanism.rotations import direction

GEAR, RING, BEVEL, PULLEY = 'gear', 'ring', 'bevel', 'pulley'
# A tooth, in modules: above and below the pitch circle; in angular pitches: half its width at
# the tip, on the pitch circle and at the root.
ABOVE, BELOW, WIDTHS = 1.0, 1.25, (0.11, 0.24, 0.36)
# Outside a ring, and below the teeth of a rack, in modules.
RIM, BACK = 2.2, 2.5
# How far outside a wheel marks of its body still lie on it, in radii.
NEAR = 1.05
# Corners of a smooth wheel, and of half a turn of a belt.
ROUND = 72


class Wheel(NamedTuple):
    """A wheel on a body, in its frame."""

    kind: str  # ``GEAR``, ``RING`` with teeth inside, ``BEVEL`` or ``PULLEY``
    body: str  # Its name, or that of the ground
    #: ``center``, ``axis``, ``start``: Shape (3,): Centre of its pitch circle [m], axis, and the
    #: direction of the middle of a tooth.
    center: np.ndarray
    axis: np.ndarray
    start: np.ndarray
    radius: float  # Of the pitch circle [m]
    teeth: int = 0  # Zero where no whole numbers of teeth have the ratio: a smooth wheel
    #: Where the cone of a bevel gear ends, along the axis from the centre on [m].
    apex: float = 0.0

    @property
    def module(self):
        """Return the module of the teeth [m]: the pitch diameter over the number of teeth."""
        return 2.0 * self.radius / (self.teeth or 36)

    @property
    def side(self):
        """Return the direction across axis and start, shape (3,)."""
        return np.cross(self.axis, self.start)


class Rack(NamedTuple):
    """A straight gear on a body, in its frame."""

    body: str
    #: ``place``, ``along``, ``normal``: Shape (3,): The middle of a tooth on the pitch line [m],
    #: directions of that and towards the wheel.
    place: np.ndarray
    along: np.ndarray
    normal: np.ndarray
    pitch: float  # From tooth to tooth [m]
    #: Where it begins and ends along the line from ``place`` on [m] (tuple of 2 floats).
    span: tuple


class Belt(NamedTuple):
    """A belt about two pulleys: its body, their carrier, and its places in that frame [m]."""

    name: str
    body: str
    places: np.ndarray


def profile(wheel):
    """
    Return the outline of a wheel, shape (n, 2), and of its hole, along start and side [m].

    The hole of a ring has as many places as its outline; others have None.
    """
    if not wheel.teeth:
        outer = wheel.radius * _circle(ROUND)
    else:
        sign = -1.0 if wheel.kind == RING else 1.0
        outer = _teeth(wheel, sign)
    if wheel.kind != RING:
        return outer, None
    rim = wheel.radius + (BELOW + RIM) * wheel.module
    return rim * outer / np.linalg.norm(outer, axis=1)[:, None], outer


def rack_profile(rack):
    """Return the outline of a rack, shape (n, 2), along its line and normal from place on [m]."""
    module = rack.pitch / np.pi
    first, last = np.array(rack.span) / rack.pitch
    numbers = np.arange(np.ceil(first), np.floor(last) + 1)
    shape = _tooth(rack.pitch, module, 1.0)
    teeth = (numbers[:, None, None] * [rack.pitch, 0.0] + shape).reshape(-1, 2)
    back = -(BELOW + BACK) * module
    begin, end = teeth[0, 0], teeth[-1, 0]
    return np.vstack([teeth, [[end, back], [begin, back]]])


def on_wheel(wheels, body, places):
    """Return whether places of a body, shape (n, 2 or 3) [m], all lie on one wheel of it."""
    return any(
        np.linalg.norm(places - wheel.center[:places.shape[1]], axis=1).max() < NEAR * wheel.radius
        for wheel in wheels if wheel.body == body)


def _tooth(pitch, module, sign):
    """Return a tooth along a line: places along it, and heights above it, shape (6, 2)."""
    tip, middle, root = WIDTHS
    return np.column_stack([
        pitch * np.array([-root, -middle, -tip, tip, middle, root]),
        sign * module * np.array([-BELOW, 0.0, ABOVE, ABOVE, 0.0, -BELOW])])


def _teeth(wheel, sign):
    pitch = 2.0 * np.pi / wheel.teeth
    shape = _tooth(pitch, wheel.module, sign)
    angles = (pitch * np.arange(wheel.teeth)[:, None] + shape[:, 0]).ravel()
    radii = np.tile(wheel.radius + shape[:, 1], wheel.teeth)
    return radii[:, None] * direction(angles)


def _circle(count):
    angles = 2.0 * np.pi * np.arange(count) / count
    return direction(angles)
