# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Maximal-coordinate twin in space: six coordinates for every body, every joint a constraint.

Newton's and Euler's equations of the single bodies about their centres of mass, with the joints'
constraints differentiated twice by hand, solved densely. Orientations are quaternions, frames
the user's own: no tree recursion on inertias, no joint frames, no code generation.
"""

from typing import NamedTuple

from closedloop_dynamics.mechanism.mechanism import (
    CUT_WITHOUT_MOMENT, CYLINDRICAL, DISTANCE, FIXED, FREE, GROUND, HELICAL, JOINT_FREEDOMS,
    PLANAR, POINT_ON_LINE, POINT_ON_PLANE, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
import numpy as np


class Motion(NamedTuple):
    """A body's frame: axes (columns), origin, angular velocity, velocity of the origin."""

    axes: np.ndarray
    origin: np.ndarray
    spin: np.ndarray
    velocity: np.ndarray


class Result(NamedTuple):
    """Angular and linear accelerations of the bodies' frames, wrenches at the cut joints."""

    accelerations: dict    # body name -> (6,), linear part at the frame's origin
    wrenches: dict         # cut joint -> (6,) on body A at its cut point, moment first
    multipliers: dict      # coupling -> generalized force


def cross(first, second):
    """Return the cross product of two vectors, in a tenth of the time that np.cross takes."""
    (a, b, c), (x, y, z) = first, second
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def matrix(quaternion):
    """Return the rotation of a quaternion x, y, z, w."""
    vector, scalar = np.array(quaternion[:3]), quaternion[3]
    skew = hat(vector)
    return np.eye(3) + 2.0 * scalar * skew + 2.0 * skew @ skew


def hat(vector):
    """Return the matrix of a vector product."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def about(axis, angle):
    """Return the rotation by an angle about a direction."""
    axis = np.array(axis) / np.linalg.norm(axis)
    return matrix([*np.sin(angle / 2.0) * axis, np.cos(angle / 2.0)])


def inertia(body):
    """Return a body's inertia about its centre of mass, in its axes."""
    values = np.zeros(6)
    values[:np.size(body.inertia)] = body.inertia
    xx, yy, zz, xy, xz, yz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def coordinates(joint):
    """Return how many numbers a joint has in q."""
    return JOINT_FREEDOMS[joint.type] + (joint.type in (SPHERICAL, FREE))


def split(mechanism, values, counts):
    """Return the part of each joint of a vector."""
    ends = np.cumsum([counts(joint) for joint in mechanism.joints])
    return dict(zip([joint.name for joint in mechanism.joints], np.split(values, ends)))


def relative(joint, q, qd):
    """
    Return what a joint does to its frame at q = 0.

    That is rotation, displacement, and the columns of turn and of slide for unit rates, all in
    that frame, and the bias of the turning for these rates.
    """
    turn, slide, bias = np.zeros((3, len(qd))), np.zeros((3, len(qd))), np.zeros(3)
    rotation, place = np.eye(3), np.zeros(3)
    if joint.type in (REVOLUTE, HELICAL, CYLINDRICAL):
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        rotation, turn[:, 0] = about(axis, q[0]), axis
        if joint.type == HELICAL:
            place, slide[:, 0] = joint.lead * q[0] * axis, joint.lead * axis
        if joint.type == CYLINDRICAL:
            place, slide[:, 1] = q[1] * axis, axis
    elif joint.type == PRISMATIC:
        slide[:, 0] = np.array(joint.axis) / np.linalg.norm(joint.axis)
        place = q[0] * slide[:, 0]
    elif joint.type == UNIVERSAL:
        first = about(joint.axis, q[0])
        rotation = first @ about(joint.second_axis, q[1])
        turn[:, 0] = np.array(joint.axis) / np.linalg.norm(joint.axis)
        turn[:, 1] = first @ joint.second_axis / np.linalg.norm(joint.second_axis)
        bias = cross(turn[:, 0] * qd[0], turn[:, 1] * qd[1])
    elif joint.type == PLANAR:
        place, rotation = np.array([q[0], q[1], 0.0]), about((0.0, 0.0, 1.0), q[2])
        slide[0, 0] = slide[1, 1] = turn[2, 2] = 1.0
    elif joint.type in (SPHERICAL, FREE):
        rotation = matrix(q[-4:])
        turn[:, -3:] = rotation
        if joint.type == FREE:
            place, slide[:, :3] = np.array(q[:3]), np.eye(3)
    return rotation, place, turn, slide, bias


def forward(mechanism, q, qd, qdd):
    """Return ({body: Motion}, {body: (6,) acceleration}, {joint: (6, freedoms)}) outward."""
    motions = {GROUND: Motion(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))}
    rates, bases = {GROUND: np.zeros(6)}, {}
    q = split(mechanism, q, coordinates)
    qd, qdd = (split(mechanism, values, lambda joint: JOINT_FREEDOMS[joint.type])
               for values in (qd, qdd))
    while len(motions) <= len(mechanism.bodies):
        for joint in mechanism.joints:
            if joint.parent not in motions or joint.child in motions:
                continue
            name = joint.name
            axes, origin, spin, velocity = motions[joint.parent]
            before = axes @ matrix(joint.orientation)
            rotation, place, turn, slide, bias = relative(joint, q[name], qd[name])
            arm = axes @ joint.position + before @ place
            turn, slide = before @ turn, before @ slide
            turning, sliding = turn @ qd[name], slide @ qd[name]
            motions[joint.child] = Motion(
                before @ rotation, origin + arm, spin + turning,
                velocity + cross(spin, arm) + sliding)
            of_parent = rates[joint.parent]
            rates[joint.child] = np.concatenate([
                of_parent[:3] + turn @ qdd[name] + cross(spin, turning) + before @ bias,
                of_parent[3:] + cross(of_parent[:3], arm)
                + cross(spin, cross(spin, arm)) + 2.0 * cross(spin, sliding)
                + slide @ qdd[name]])
            bases[name] = np.vstack([turn, slide])
    return motions, rates, bases


class Equations:
    """Rows on the bodies' accelerations, gathered joint by joint."""

    def __init__(self, mechanism):
        self.place = {body.name: 6 * k for k, body in enumerate(mechanism.bodies)}
        self.rows, self.right = [], []

    def add(self, first, on_first, second, on_second, right):
        """Add a row: on_first . a_first + on_second . a_second = right."""
        self.add_parts(((first, on_first), (second, on_second)), right)

    def add_parts(self, parts, right):
        """Add a row on any bodies, several times on one, too."""
        row = np.zeros(6 * len(self.place))
        for name, part in parts:
            if name != GROUND:
                row[self.place[name]:self.place[name] + 6] += part
        self.rows.append(row)
        self.right.append(right)


def point_row(motion, arm, direction):
    """Return the row of a point's acceleration along a direction, and what spin adds to it."""
    return (np.concatenate([cross(arm, direction), direction]),
            direction @ cross(motion.spin, cross(motion.spin, arm)))


def cut_rows(equations, motions, cut):
    """Add the equations of a cut joint."""
    a, b = motions[cut.body_a], motions[cut.body_b]
    arm_a, arm_b = a.axes @ cut.point_a, b.axes @ cut.point_b
    apart = a.origin + arm_a - b.origin - arm_b
    speed = (a.velocity + cross(a.spin, arm_a) - b.velocity - cross(b.spin, arm_b))

    def turned(n):
        """Return the row and bias of d2/dt2 (n . apart), n fixed in body B."""
        on_a, bias_a = point_row(a, arm_a, n)
        on_b, _ = point_row(b, arm_b + apart, n)
        turning = cross(b.spin, n)
        return on_a, on_b, (bias_a - n @ cross(b.spin, cross(b.spin, arm_b))
                            + 2.0 * turning @ speed + cross(b.spin, turning) @ apart)

    if cut.type in (PRISMATIC, CYLINDRICAL, PLANAR, HELICAL, POINT_ON_LINE, POINT_ON_PLANE):
        along = b.axes @ cut.axis_b
        for n in [along] if cut.type in (PLANAR, POINT_ON_PLANE) else complement(along):
            on_a, on_b, bias = turned(n)
            equations.add(cut.body_a, on_a, cut.body_b, -on_b, -bias)
        if cut.type == HELICAL:
            # What slides is the lead times what turns.
            on_a, on_b, bias = turned(along)
            turn = np.concatenate([cut.lead * along, np.zeros(3)])
            bias -= cut.lead * cross(b.spin, along) @ (a.spin - b.spin)
            equations.add(cut.body_a, on_a - turn, cut.body_b, turn - on_b, -bias)
    elif cut.type == DISTANCE:
        on_a, bias_a = point_row(a, arm_a, apart)
        on_b, bias_b = point_row(b, arm_b, apart)
        equations.add(cut.body_a, on_a, cut.body_b, -on_b, bias_b - bias_a - speed @ speed)
    else:
        for n in np.eye(3):
            on_a, bias_a = point_row(a, arm_a, n)
            on_b, bias_b = point_row(b, arm_b, n)
            equations.add(cut.body_a, on_a, cut.body_b, -on_b, bias_b - bias_a)
    for u, v in perpendicular(cut, a, b):
        lever = cross(u, v)
        u_rate, v_rate = cross(a.spin, u), cross(b.spin, v)
        bias = (cross(a.spin, u_rate) @ v + u @ cross(b.spin, v_rate)
                + 2.0 * u_rate @ v_rate)
        on = np.concatenate([lever, np.zeros(3)])
        equations.add(cut.body_a, on, cut.body_b, -on, -bias)


def complement(axis):
    """Return two directions across an axis, as rows."""
    return np.linalg.svd(np.array(axis)[None])[2][1:]


def perpendicular(cut, a, b):
    """Return pairs of directions, fixed in body A and in body B, that stay perpendicular."""
    if cut.type in CUT_WITHOUT_MOMENT:
        return []
    if cut.type == UNIVERSAL:
        return [(a.axes @ cut.axis_a, b.axes @ cut.axis_b)]
    if cut.type in (FIXED, PRISMATIC):
        held = a.axes @ matrix(cut.orientation).T
        x, y, z = np.eye(3)
        return [(held @ z, b.axes @ x), (held @ z, b.axes @ y), (held @ x, b.axes @ y)]
    along = a.axes @ (matrix(cut.orientation).T @ cut.axis_b if cut.type == HELICAL
                      else cut.axis_a)
    return [(along, across) for across in complement(b.axes @ cut.axis_b)]


def tree_rows(equations, motions, rates, bases, joint):
    """Add the equations of a tree joint: what its freedoms cannot do is as without rates."""
    basis = bases[joint.name]
    left, size, _ = np.linalg.svd(basis) if basis.size else (np.eye(6), [], None)
    arm = motions[joint.child].origin - motions[joint.parent].origin
    parent = np.eye(6)
    parent[3:, :3] = -hat(arm)
    bias = rates[joint.child] - parent @ rates[joint.parent]
    for n in left[:, len(size):].T:
        equations.add(joint.child, n, joint.parent, -n @ parent, n @ bias)


def coupling_row(equations, mechanism, motions, rates, bases, coupling):
    """Add the equation of a coupling: what its joints do beyond what they do without rates."""
    parts, right = [], 0.0
    for joint in mechanism.joints:
        if joint.name in coupling.joints:
            row = coupling.joints[joint.name] * np.linalg.pinv(bases[joint.name])[0]
            parent = np.eye(6)
            parent[3:, :3] = -hat(motions[joint.child].origin - motions[joint.parent].origin)
            parts += [(joint.child, row), (joint.parent, -row @ parent)]
            right += row @ (rates[joint.child] - parent @ rates[joint.parent])
    equations.add_parts(parts, right)


def closure_rates(mechanism, q):
    """Return the matrix that gives the rates of the cut joints' equations from qd."""
    nv = sum(JOINT_FREEDOMS[joint.type] for joint in mechanism.joints)
    columns = []
    for unit in np.eye(nv):
        motions, rates, bases = forward(mechanism, q, unit, np.zeros(nv))
        equations = Equations(mechanism)
        for cut in mechanism.cut_joints:
            cut_rows(equations, motions, cut)
        for coupling in mechanism.couplings:
            coupling_row(equations, mechanism, motions, rates, bases, coupling)
        speeds = np.concatenate([
            [*motions[body.name].spin, *motions[body.name].velocity] for body in mechanism.bodies])
        columns.append(np.array(equations.rows).reshape(-1, len(speeds)) @ speeds)
    return np.array(columns).T


def forward_dynamics(mechanism, q, qd, tau, gravity=(0.0, 0.0, -9.81), wrenches=None):
    """
    Return the Result for coordinates (nq,), rates and joint forces (nv,).

    ``wrenches``: what else acts on bodies, (6,) by name, moment first, at their frames' origins.
    """
    motions, rates, bases = forward(mechanism, q, qd, np.zeros(len(qd)))
    tree, cuts = Equations(mechanism), Equations(mechanism)
    for joint in mechanism.joints:
        tree_rows(tree, motions, rates, bases, joint)
    counts = []
    for cut in mechanism.cut_joints:
        cut_rows(cuts, motions, cut)
        counts.append(len(cuts.rows))
    for coupling in mechanism.couplings:
        coupling_row(cuts, mechanism, motions, rates, bases, coupling)
    size = 6 * len(mechanism.bodies)
    mass, force = np.zeros((size, size)), np.zeros(size)
    for k, body in enumerate(mechanism.bodies):
        axes, _, spin, _ = motions[body.name]
        arm, about_center = axes @ body.center_of_mass, axes @ inertia(body) @ axes.T
        # From the frame's origin to the centre of mass and back.
        shift = np.eye(6)
        shift[3:, :3] = -hat(arm)
        own = slice(6 * k, 6 * k + 6)
        center = np.zeros((6, 6))
        center[:3, :3], center[3:, 3:] = about_center, body.mass * np.eye(3)
        bias = np.concatenate([
            cross(spin, about_center @ spin),
            body.mass * (cross(spin, cross(spin, arm)) - np.array(gravity))])
        mass[own, own] = shift.T @ center @ shift
        force[own] = (wrenches or {}).get(body.name, 0.0) - shift.T @ bias
    efforts = split(mechanism, tau, lambda joint: JOINT_FREEDOMS[joint.type])
    for joint in mechanism.joints:
        wrench = np.linalg.pinv(bases[joint.name]).T @ efforts[joint.name]
        arm = motions[joint.child].origin - motions[joint.parent].origin
        for name, part in ((joint.child, wrench), (joint.parent, -np.concatenate(
                [wrench[:3] + cross(arm, wrench[3:]), wrench[3:]]))):
            if name != GROUND:
                force[tree.place[name]:tree.place[name] + 6] += part
    rows = np.array(tree.rows + cuts.rows).reshape(-1, size)
    system = np.block([[mass, -rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    found = np.linalg.lstsq(
        system, np.concatenate([force, tree.right, cuts.right]), rcond=None)[0]
    accelerations = dict(zip([body.name for body in mechanism.bodies],
                             found[:size].reshape(-1, 6)))
    wrenches, lam = {}, found[size + len(tree.rows):]
    for cut, first, last in zip(mechanism.cut_joints, [0, *counts], counts):
        wrench = np.zeros(6)
        for value, row in zip(lam[first:last], cuts.rows[first:last]):
            name, sign = (cut.body_a, 1.0) if cut.body_a != GROUND else (cut.body_b, -1.0)
            wrench += sign * value * row[cuts.place[name]:cuts.place[name] + 6]
        # From the origin of that body to the cut point of A.
        arm = motions[cut.body_a].origin + motions[cut.body_a].axes @ cut.point_a
        arm = arm - motions[name].origin
        wrenches[cut.name] = np.concatenate(
            [wrench[:3] - cross(arm, wrench[3:]), wrench[3:]])
    return Result(accelerations, wrenches, dict(zip(
        [coupling.name for coupling in mechanism.couplings], lam[[0, *counts][-1]:])))
