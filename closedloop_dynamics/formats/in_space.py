# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A planar mechanism as one in space."""

from dataclasses import replace

import numpy as np

from ..mechanism.couplings import in_tree, measured
from ..mechanism.mechanism import (
    Body, Coupling, CutJoint, DISTANCE, FIXED, Joint, Point, POINT_ON_LINE, PRISMATIC, REVOLUTE)
from ..mechanism.rotations import about_z, direction, in_three
from ..mechanism.validation import checked

X, Y, Z = (tuple(axis) for axis in np.eye(3).tolist())


def in_space(mechanism):
    """
    Return a planar mechanism as one in space: in the plane z = 0, with flat bodies.

    One in space is returned as it is.
    """
    if not mechanism.planar:
        return mechanism

    bodies = [Body(body.name, body.mass, (*body.center_of_mass, 0.0), 0.0 if body.massless else (
        0.5 * body.inertia, 0.5 * body.inertia, body.inertia), body.massless)
        for body in mechanism.bodies]
    joints = [Joint(joint.name, joint.type, joint.parent, joint.child, (*joint.position, 0.0),
                    actuated=joint.actuated, orientation=tuple(about_z(joint.angle).tolist()),
                    axis=Z if joint.type == REVOLUTE else X) for joint in mechanism.joints]
    points = [Point(point.name, point.body, (*point.position, 0.0)) for point in mechanism.points]
    couplings = []
    for coupling in mechanism.couplings:
        factors, offset = in_tree(mechanism, coupling)
        factors.update((cut.name, coupling.joints[cut.name])
                       for cut in measured(mechanism, coupling))
        couplings.append(Coupling(coupling.name, factors, offset, law=coupling.law))
    return checked(replace(
        mechanism, bodies=tuple(bodies), joints=tuple(joints), cut_joints=cuts_in_space(mechanism),
        points=tuple(points), couplings=tuple(couplings), source=None))


def cuts_in_space(mechanism):
    """Return the cut joints of a mechanism as those in space."""
    if not mechanism.planar:
        return mechanism.cut_joints
    cuts = []
    for cut in mechanism.cut_joints:
        along = {'axis_b': tuple(in_three(direction(cut.angle)).tolist())}
        turned = tuple(about_z(cut.angle).tolist())
        keys = {REVOLUTE: {'axis_a': Z, 'axis_b': Z}, FIXED: {'orientation': turned},
                PRISMATIC: {'orientation': turned, **along}, POINT_ON_LINE: along,
                DISTANCE: {'length': cut.length}}[cut.type]
        cuts.append(CutJoint(cut.name, cut.type, cut.body_a, cut.body_b, (*cut.point_a, 0.0),
                             (*cut.point_b, 0.0), actuated=cut.actuated, **keys))
    return tuple(cuts)
