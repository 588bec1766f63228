# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Characteristic shapes of machines: gears, racks, pulleys, cams, and guides of slides.

Places are as a page has them, in the frames of bodies; a profile is an outline that is as deep as
it says, about its origin along ``z``, and where it has a ``hole`` of as many places, a band.
"""

import math

import numpy as np

from .effect_shapes import circle, outline_of
from ..effects.body_contact import BodyContact
from ..mechanism.mechanism import GROUND, POINT_ON_LINE, PRISMATIC
from ..mechanism.rotations import rotated
from ..visual.transmissions import transmissions
from ..visual.wheels import (
    BACK, BELOW, BEVEL, NEAR, on_wheel, profile, PULLEY, rack_profile, RING)

# As shares of the size of links: depth of wheels, and how far below its link a wheel lies.
DEPTH, BEHIND = 0.012, 0.015
# Half the length of a block on a slide, and half its width; half the width of a slot.
BLOCK, BLOCK_WIDTH, SLOT = 0.05, 0.03, 0.024
# Width of a bevel gear in radii; the holes of wheels, as shares of the circle at the roots of
# teeth; how far from its roller a follower has its block, in sizes of links.
BEVEL_WIDTH, HOLE, SHAFT, STEM = 0.4, 0.8, 0.25, 0.6
# The size that links are drawn by at least, as a share of that of the mechanism.
THINNEST = 0.25
# How far outside its outline a cam with a path inside ends, as a share of its size.
COLLAR = 1.25
BELT_COLOR = '#6f7681'
# How near the end of an outline is to its beginning where it is closed, of its extent.
CLOSED = 1e-9


class MachineShapes:
    """
    Characteristic shapes of a mechanism, and of effects whose outlines are filled.

    ``wheels``, ``racks``, ``belts`` are as ``transmissions.transmissions`` has them.
    """

    def __init__(self, mechanism, effects):
        self._mechanism = mechanism
        self.wheels, self.racks, self.belts = transmissions(mechanism)
        self._points = {point.name: point for point in mechanism.points}
        self._outlines = list(self._contacts(effects)) if mechanism.planar else []

    def _contacts(self, effects):
        """Yield body, centre, closed outline of a contact, and whether it is free inside."""
        for record in effects.values():
            if not isinstance(record, BodyContact):
                continue
            if record.shape != 'line':
                places, point = outline_of(record), self._points[record.other]
                if np.abs(places[0] - places[-1]).max() < CLOSED * np.ptp(places):
                    yield point.body, np.array(point.position), places[:-1], bool(record.hollow)
            if record.shape != 'face' and record.radius:
                point = self._points[record.point]
                yield point.body, np.array(point.position), circle(record.radius)[:-1], False

    def size(self):
        """Return the largest extent of a wheel or an outline [m]; zero without any."""
        spans = [2.0 * wheel.radius for wheel in self.wheels]
        spans += [np.ptp(places, axis=0).max() for _, _, places, _ in self._outlines]
        return max(spans, default=0.0)

    def thickness(self, size, share):
        """Return the size that links are drawn by: bars are thinner than wheels, within reason."""
        return max(THINNEST * size, min([size, *(share * wheel.radius for wheel in self.wheels)]))

    def covers(self, body, places):
        """Return whether places of a body, shape (n, 2 or 3), lie on a wheel or outline of it."""
        return on_wheel(self.wheels, body, places) or any(
            np.linalg.norm(places - center, axis=1).max() < NEAR * np.linalg.norm(
                outline, axis=1).max()
            for name, center, outline, _ in self._outlines if name == body)

    def height(self, heights, thick):
        """Return the layer that all wheels and racks are in [m]; zero in space."""
        bodies = {one.body for one in (*self.wheels, *self.racks)}
        if not bodies or not self._mechanism.planar:
            return 0.0
        return max(heights[body] for body in bodies) - BEHIND * thick

    def shapes(self, body, heights, thick):
        """Return the shapes of a body, the ground among them, as JSON can."""
        height = np.array([0.0, 0.0, self.height(heights, thick)])
        found = []
        for wheel in self.wheels:
            if wheel.body == body:
                found += _wheel(wheel, wheel.center + height, DEPTH * thick)
        for rack in self.racks:
            if rack.body == body:
                found.append(_profile(rack_profile(rack), None, rack.place + height, rack.along,
                                      np.cross(rack.along, rack.normal), DEPTH * thick))
        for name, center, places, hollow in self._outlines:
            if name == body:
                found.append(_filled(places, hollow, np.array([*center, heights[body]]),
                                     DEPTH * thick))
        return found

    def wires(self, rows, heights, thick):
        """Return the belts, as closed lines."""
        height = self.height(heights, thick)
        return [{'name': belt.name, 'body': rows[belt.body], 'color': BELT_COLOR,
                 'width': 0.4 * DEPTH * thick, 'places': (
                     belt.places + [0.0, 0.0, height]).tolist()} for belt in self.belts]

    # What slides.

    def block(self, body):
        """Return the place of a sliding block, in its body [m]; None without one."""
        if any(rack.body == body for rack in self.racks):
            return None
        joint = next((joint for joint in self._mechanism.joints
                      if joint.child == body and joint.type == PRISMATIC), None)
        if joint is None:
            cut = next((cut for cut in self._mechanism.cut_joints
                        if cut.body_a == body and cut.type == PRISMATIC), None)
            return None if cut is None else [*cut.point_a, 0.0][:3]
        return [0.0, 0.0, 0.0]

    def stem(self, body, thick):
        """Return how far along its slide a follower has its block from its roller [m], or zero."""
        return STEM * thick if any(name == body for name, *_ in self._outlines) else 0.0

    def guides(self, rows, heights, thick):
        """
        Return the guides of sliding joints, as JSON.

        Each has a body, a place and an axis in it, the mover and its place on it, and ``sides``:
        how far to the left of the line its two edges are [m].
        """
        found = []
        for kind, body, place, axis, mover, at in _slides(self._mechanism):
            sides = self._sides(mover, kind, thick)
            if kind == PRISMATIC and self._mechanism.planar:
                at = [at[0] + self.stem(mover, thick), *at[1:]]
            found.append({
                'kind': 'slot' if kind == POINT_ON_LINE else 'slide', 'body': rows[body],
                'place': [*place, 0.0][:3], 'axis': axis, 'mover': rows[mover],
                'at': [*at, 0.0][:3], 'sides': sides, 'height': heights[mover]})
        return found

    def _sides(self, mover, kind, thick):
        if kind == POINT_ON_LINE:
            return [-SLOT * thick, SLOT * thick]
        for rack in self.racks:
            if rack.body == mover:
                back = (BELOW + BACK) * rack.pitch / math.pi + 0.5 * DEPTH * thick
                left = np.array([-rack.along[1], rack.along[0], 0.0])
                # Along the slide, which is the first axis of its body.
                where = rack.place[1] - back * rack.normal[1]
                return [float(where)] if abs(left @ rack.normal) > 0.5 else []
        return [-BLOCK_WIDTH * thick, BLOCK_WIDTH * thick]


def _slides(mechanism):
    """Yield type, body, place and axis of each slide, the body that moves, and its place."""
    for joint in mechanism.joints:
        if joint.type == PRISMATIC and (mechanism.planar or joint.parent == GROUND):
            yield (PRISMATIC, joint.parent, joint.position, joint_axis(joint), joint.child,
                   (0.0,) * len(joint.position))
    for cut in mechanism.cut_joints:
        if cut.type in (PRISMATIC, POINT_ON_LINE) and (mechanism.planar or cut.body_b == GROUND):
            axis = (list(cut.axis_b) if not mechanism.planar
                    else [math.cos(cut.angle), math.sin(cut.angle), 0.0])
            yield cut.type, cut.body_b, cut.point_b, axis, cut.body_a, cut.point_a


def joint_axis(joint):
    """Return the axis of a joint in its parent's frame, along z in the plane unless it slides."""
    if joint.axis is not None:
        return rotated(np.array(joint.orientation), np.array(joint.axis)).tolist()
    if joint.type == PRISMATIC:
        return [math.cos(joint.angle), math.sin(joint.angle), 0.0]
    return [0.0, 0.0, 1.0]


def _profile(outline, hole, origin, along, axis, depth, taper=1.0):
    def rounded(places):
        digits = 6 - int(np.floor(np.log10(np.abs(outline).max())))
        return np.round(places, digits).tolist()

    return {'kind': 'profile', 'outline': rounded(outline),
            'hole': None if hole is None else rounded(hole), 'origin': origin.tolist(),
            'x': np.round(along, 12).tolist(), 'z': np.round(axis, 12).tolist(),
            'depth': depth, 'taper': taper}


def _wheel(wheel, center, depth):
    """Return a wheel as shapes: its rim, and spokes that show how it turns."""
    if wheel.kind == PULLEY:
        return [{'kind': 'pulley', 'origin': center.tolist(), 'radius': wheel.radius,
                 'depth': depth, 'x': wheel.start.tolist(), 'z': wheel.axis.tolist()}]
    outline, hole = profile(wheel)
    taper = 1.0
    if wheel.kind == BEVEL:
        depth = BEVEL_WIDTH * wheel.radius
        taper = 1.0 - depth / abs(wheel.apex)
        # The wide end is at the centre, the narrow one is nearer to the apex.
        axis = wheel.axis * np.sign(wheel.apex)
        center = center + 0.5 * depth * axis
        share = SHAFT
    else:
        axis, share = wheel.axis, HOLE
    lengths = np.linalg.norm(outline, axis=1)
    if hole is None:
        hole = share * lengths.min() * outline / lengths[:, None]
    along = wheel.start
    if axis @ wheel.axis < 0.0:
        outline, hole = outline * (1.0, -1.0), hole * (1.0, -1.0)
    found = [_profile(outline, hole, center, along, axis, depth, taper)]
    if wheel.kind not in (RING, BEVEL):
        reach = HOLE * lengths.min()
        found += [{'kind': 'spokes', 'origin': center.tolist(), 'x': along.tolist(),
                   'z': axis.tolist(), 'depth': 0.7 * depth, 'radius': reach * 1.02}]
    return found


def _filled(places, hollow, center, depth):
    """Return a closed outline filled, or, where its inside is free, with a collar about it."""
    x, _, z = np.eye(3)
    if not hollow:
        return _profile(places, None, center, x, z, depth)
    lengths = np.linalg.norm(places, axis=1)
    collar = COLLAR * lengths.max() * places / lengths[:, None]
    return _profile(collar, places, center, x, z, depth)
