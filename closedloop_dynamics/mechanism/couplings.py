# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Couplings in the coordinates of the spanning tree.

In the plane angles add along a chain of bodies: the coordinate of a revolute cut joint, the angle
of body A in body B less its ``angle``, is a sum of the tree's coordinates and of constant angles.
The coordinates of other cut joints are not: of these a coupling may name one.
"""

import numpy as np

from .mechanism import GROUND, REVOLUTE


def measured(mechanism, coupling):
    """Return the cut joints of a coupling whose coordinates are not sums of those of the tree."""
    return [cut for cut in mechanism.cut_joints if cut.name in coupling.joints
            and not (mechanism.planar and cut.type == REVOLUTE)]


def in_tree(mechanism, coupling):
    """
    Return a coupling's equation in the coordinates of the tree.

    Factors by joint of the tree, none zero; empty where their sum never changes; and the constant
    value of the sum of the coordinates times these. Cut joints that ``measured`` returns are left
    out.
    """
    carrier = {joint.child: joint for joint in mechanism.joints}
    cuts = {cut.name: cut for cut in mechanism.cut_joints}
    factors, offset = {}, coupling.offset
    others = [cut.name for cut in measured(mechanism, coupling)]
    for name, factor in coupling.joints.items():
        if name in others:
            continue
        if name not in cuts:
            factors[name] = factors.get(name, 0.0) + factor
            continue
        offset += factor * cuts[name].angle
        for body, sign in ((cuts[name].body_a, factor), (cuts[name].body_b, -factor)):
            while body != GROUND:
                joint = carrier[body]
                offset -= sign * joint.angle
                if joint.type == REVOLUTE:
                    factors[joint.name] = factors.get(joint.name, 0.0) + sign
                body = joint.parent
    return {name: factor for name, factor in factors.items() if factor != 0.0}, offset


def coupling_scales(mechanism):
    """
    Return the scales of the multipliers of couplings, shape (number of couplings,).

    Those of a cut joint whose coordinate is not a sum of those of the tree are written for that
    coordinate, without its factor.
    """
    found = [measured(mechanism, one) for one in mechanism.couplings]
    return np.array([one.joints[cuts[0].name] if cuts else 1.0
                     for one, cuts in zip(mechanism.couplings, found)])


def relative(mechanism, coupling):
    """
    Return a coupling for the coordinate of a cut joint among ``measured``.

    That cut joint, the factors of joints of the tree, and the constant value of the sum with the
    coordinate of the cut joint.
    """
    cut, = measured(mechanism, coupling)
    factors, offset = in_tree(mechanism, coupling)
    own = coupling.joints[cut.name]
    return cut, {name: factor / own for name, factor in factors.items()}, offset / own
