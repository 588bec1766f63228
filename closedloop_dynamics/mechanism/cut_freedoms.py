# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Degrees of freedom of cut joints: their coordinates and zeros.

Names, signs and zeros are those of the same joint in a tree with body A as the child and body B as
the parent. Some axes are fixed in the child: the second one of a universal joint, those of the
rates of a spherical one. Seen from there the parent moves the other way, so the freedom is one of
body B in body A, about the opposite axis.
"""

from typing import NamedTuple

import numpy as np

from .mechanism import (
    CutJoint, CYLINDRICAL, PLANAR, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL, UNTURNED)
from .rotations import CONJUGATE, direction, in_three, perpendicular, rotated

# Sine of the angle between two axes below which they are parallel.
PARALLEL = 1e-12
_X, _Y, _Z = np.eye(3)


class CutFreedom(NamedTuple):
    """One freedom of a cut joint."""

    name: str  # As ``Mechanism.cut_coordinates`` has it
    cut: CutJoint
    #: Whether its coordinate is how far A's point is from B's along the axis; else the angle of A
    #: in B about it.
    slides: bool
    axis: np.ndarray  # Shape (3,): In body B
    #: Shape (3,), or None: Where the axis is in body A; a direction of body A across it, and where
    #: this is in body B at zero. Of angles in space, and not of those that have rates alone.
    turn: tuple = None
    exchanged: bool = False  # Whether A is the cut joint's body B, and B its body A

    @property
    def bodies(self):
        """Return the names of A and B."""
        bodies = self.cut.body_a, self.cut.body_b
        return bodies[::-1] if self.exchanged else bodies

    @property
    def points(self):
        """Return the cut point in A and in B [m]."""
        points = self.cut.point_a, self.cut.point_b
        return points[::-1] if self.exchanged else points


def cut_freedoms(mechanism):
    """
    Return the freedoms of all cut joints that have coordinates, by name.

    In the order of ``Mechanism.cut_coordinates``.
    """
    names, found = mechanism.cut_coordinates, {}
    for cut in mechanism.cut_joints:
        if cut.type in mechanism.measured_types:
            own = names.names[names.rates[cut.name]]
            freedoms = (_in_plane if mechanism.planar else _in_space)(cut)
            found.update((name, CutFreedom(name, cut, *each)) for name, each in zip(own, freedoms))
    return found


def _in_plane(cut):
    """Return the fields after name and cut joint, of a cut joint in the plane."""
    slide = True, in_three(direction(cut.angle))
    return {REVOLUTE: [(False, _Z)], PRISMATIC: [slide]}.get(cut.type, [slide, (False, _Z)])


def _in_space(cut):
    """Do the same for one in space."""
    if cut.type == SPHERICAL:
        return [(False, -axis, None, True) for axis in (_X, _Y, _Z)]
    if cut.type == UNIVERSAL:
        return _universal(cut)
    axis = np.array(cut.axis_b)
    if cut.type not in (REVOLUTE, CYLINDRICAL, PLANAR):
        return [(True, axis)]
    along = np.array(cut.axis_a)
    # The x axis of a plane is that of body A, turned with its z axis to where the normal is.
    side = _least_turn(_Z, along, _X) if cut.type == PLANAR else perpendicular(along)
    there = rotated(cut.orientation, side) if cut.orientation != UNTURNED else (
        _least_turn(along, axis, side))
    turns = False, axis, (along, side, there)
    return {REVOLUTE: [turns], CYLINDRICAL: [turns, (True, axis)],
            PLANAR: [(True, there), (True, np.cross(axis, there)), turns]}[cut.type]


def _universal(cut):
    """Return the same of a universal joint: about the axis of body B, then that of body A."""
    first, second = np.array(cut.axis_b), np.array(cut.axis_a)
    drawn = rotated(cut.orientation, second)
    # At zero the axes are at right angles; they are drawn so, or nearly, or anyhow.
    there = drawn - (drawn @ first) * first
    size = np.linalg.norm(there)
    there = perpendicular(first) if size < PARALLEL else there / size
    back = rotated(cut.orientation * CONJUGATE, _least_turn(there, drawn, first))
    return [(False, first, (back, second, there)),
            (False, -second, (-there, first, back), True)]


def _least_turn(one, other, side):
    """Return where a direction across an axis is after the shortest turn to another axis."""
    normal = np.cross(one, other)
    sine = np.linalg.norm(normal)
    if sine < PARALLEL:
        # Turned over about the direction itself where they are opposite.
        return side
    normal /= sine
    along, beside = np.cross(one, normal), np.cross(other, normal)
    return (side @ normal) * normal + (side @ along) * beside
