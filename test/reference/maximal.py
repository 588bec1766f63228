# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Maximal-coordinate twin: three coordinates for every body, every joint a constraint.

Newton's and Euler's equations of the single bodies, M a = f + Phi_q^T lam with
Phi_q a = gamma, written out by hand and solved densely: no tree recursion, no
Lagrange, no numerical derivatives. Each constraint's lam acts on body A of its
joint, so that those of the cut joints are the package's multipliers.
"""

from typing import NamedTuple

from closedloop_dynamics.mechanism.mechanism import (
    CutJoint, DISTANCE, FIXED, GROUND, POINT_ON_LINE, REVOLUTE)
import numpy as np


class Motion(NamedTuple):
    """What one body does: place and angle of its centre of mass, and their rates."""

    place: np.ndarray
    angle: float
    velocity: np.ndarray
    rate: float


class Result(NamedTuple):
    """Accelerations and constraint forces of every joint."""

    qdd: np.ndarray
    lam: np.ndarray
    accelerations: dict    # body name -> (x, y, alpha) of its centre of mass
    reactions: dict        # joint name -> forces and torque of its constraint on the child


def rotation(angle):
    """Return the matrix from axes turned by ``angle`` to the world's."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def cross(rate, arm):
    """Return the planar product rate x arm."""
    return rate * np.array([-arm[1], arm[0]])


def moment(arm, force):
    """Return the planar product arm x force."""
    return arm[0] * force[1] - arm[1] * force[0]


def body_motions(mechanism, q, qd):
    """Return {body name: Motion}, by walking outward from the ground."""
    origins = {GROUND: (np.zeros(2), 0.0, np.zeros(2), 0.0)}
    while len(origins) <= len(mechanism.bodies):
        for joint, coordinate, speed in zip(mechanism.joints, q, qd):
            if joint.parent not in origins or joint.child in origins:
                continue
            place, angle, velocity, rate = origins[joint.parent]
            arm = rotation(angle) @ joint.position
            place, velocity = place + arm, velocity + cross(rate, arm)
            angle = angle + joint.angle
            if joint.type == REVOLUTE:
                angle, rate = angle + coordinate, rate + speed
            else:
                axis = rotation(angle)[:, 0]
                place = place + coordinate * axis
                velocity = velocity + speed * axis + cross(rate, coordinate * axis)
            origins[joint.child] = (place, angle, velocity, rate)
    motions = {GROUND: Motion(*origins[GROUND])}
    for body in mechanism.bodies:
        place, angle, velocity, rate = origins[body.name]
        arm = rotation(angle) @ body.center_of_mass
        motions[body.name] = Motion(place + arm, angle, velocity + cross(rate, arm), rate)
    return motions


def as_constraint(joint):
    """Return a tree joint as the cut joint with the same equations, A the child, B the parent."""
    return CutJoint(joint.name, joint.type, joint.child, joint.parent,
                    (0.0, 0.0), joint.position, joint.angle)


class Rows(NamedTuple):
    """Equations of one joint: on_a a_A + on_b a_B = gamma, a = (x, y, alpha) accelerations."""

    on_a: np.ndarray
    on_b: np.ndarray
    gamma: np.ndarray


def arm_of(mechanism, motions, name, point):
    """Return the world vector from a body's centre of mass to a point on it."""
    centers = {body.name: body.center_of_mass for body in mechanism.bodies}
    center = np.array(centers.get(name, (0.0, 0.0)))
    return rotation(motions[name].angle) @ (np.array(point) - center)


def joint_rows(mechanism, motions, cut):
    """Return the acceleration equations of one joint, differentiated twice by hand."""
    a, b = motions[cut.body_a], motions[cut.body_b]
    arm_a = arm_of(mechanism, motions, cut.body_a, cut.point_a)
    arm_b = arm_of(mechanism, motions, cut.body_b, cut.point_b)
    point_a, point_b = (np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]],
                                 np.result_type(arm_a, arm_b)) for arm in (arm_a, arm_b))
    turn = np.array([[0.0, 0.0, 1.0]])
    # The centripetal accelerations of both points, brought to the right.
    gamma = a.rate ** 2 * arm_a - b.rate ** 2 * arm_b
    if cut.type == REVOLUTE:
        return Rows(point_a, -point_b, gamma)
    if cut.type == FIXED:
        return Rows(np.vstack([point_a, turn]), -np.vstack([point_b, turn]), np.append(gamma, 0.0))
    if cut.type == DISTANCE:
        # offset . offset is constant: offset . its acceleration + speed . speed = 0.
        offset = (a.place + arm_a - b.place - arm_b) / cut.length
        speed = a.velocity + cross(a.rate, arm_a) - b.velocity - cross(b.rate, arm_b)
        return Rows((offset @ point_a)[None], -(offset @ point_b)[None],
                    np.array([offset @ gamma - speed @ speed / cut.length]))
    along, across = rotation(b.angle + cut.angle).T
    offset = a.place + arm_a - b.place - arm_b
    speed = a.velocity + cross(a.rate, arm_a) - b.velocity - cross(b.rate, arm_b)
    # across . offset = 0, and across turns with body B: its rate is -rate_b along.
    gamma = across @ gamma + 2.0 * b.rate * along @ speed + b.rate ** 2 * across @ offset
    if cut.type == POINT_ON_LINE:
        return Rows((across @ point_a)[None],
                    -(across @ point_b + along @ offset * turn[0])[None], np.array([gamma]))
    return Rows(np.vstack([across @ point_a, turn]),
                -np.vstack([across @ point_b + along @ offset * turn[0], turn]),
                np.array([gamma, 0.0]))


def applied_forces(mechanism, motions, tau, gravity):
    """Return {body name: (fx, fy, torque about its centre of mass)} of gravity and the drives."""
    kind = np.result_type(tau, *(motion.place for motion in motions.values()))
    applied = {body.name: np.append(body.mass * np.array(gravity), 0.0).astype(kind)
               for body in mechanism.bodies}
    applied[GROUND] = np.zeros(3, kind)
    for joint, effort in zip(mechanism.joints, tau):
        if joint.type == REVOLUTE:
            applied[joint.child][2] += effort
            applied[joint.parent][2] -= effort
            continue
        # The drive pushes at the child's origin, and back on the parent at the same place.
        arm = arm_of(mechanism, motions, joint.child, (0.0, 0.0))
        place = motions[joint.child].place + arm
        force = effort * rotation(motions[joint.child].angle)[:, 0]
        for name, sign in ((joint.child, 1.0), (joint.parent, -1.0)):
            torque = moment(place - motions[name].place, force)
            applied[name] += sign * np.append(force, torque)
    return applied


def joint_acceleration(mechanism, motions, accelerations, joint):
    """Return the relative acceleration of child and parent along a tree joint."""
    child, parent = motions[joint.child], motions[joint.parent]
    of_child, of_parent = accelerations[joint.child], accelerations[joint.parent]
    if joint.type == REVOLUTE:
        return of_child[2] - of_parent[2]
    arm_child = arm_of(mechanism, motions, joint.child, (0.0, 0.0))
    arm_parent = arm_of(mechanism, motions, joint.parent, joint.position)
    offset = child.place + arm_child - parent.place - arm_parent
    speed = (child.velocity + cross(child.rate, arm_child)
             - parent.velocity - cross(parent.rate, arm_parent))
    second = (of_child[:2] + cross(of_child[2], arm_child) - child.rate ** 2 * arm_child
              - of_parent[:2] - cross(of_parent[2], arm_parent) + parent.rate ** 2 * arm_parent)
    along, across = rotation(child.angle).T
    # q = along . offset, differentiated twice; along turns with the child.
    return (along @ second + 2.0 * child.rate * across @ speed
            + of_child[2] * across @ offset - child.rate ** 2 * along @ offset)


def stacked_rows(mechanism, motions, joints):
    """Return (Phi_q, list of each joint's gamma)."""
    start = {body.name: 3 * index for index, body in enumerate(mechanism.bodies)}
    blocks, gammas = [], []
    for joint in joints:
        equations = joint_rows(mechanism, motions, joint)
        # Of complex numbers where a coordinate is: by its steps derivatives are exact.
        block = np.zeros((len(equations.gamma), 3 * len(mechanism.bodies)), equations.on_a.dtype)
        for name, part in ((joint.body_a, equations.on_a), (joint.body_b, equations.on_b)):
            if name != GROUND:
                block[:, start[name]:start[name] + 3] = part
        blocks.append(block)
        gammas.append(equations.gamma)
    for coupling in mechanism.couplings:
        block, gamma = coupling_row(mechanism, motions, coupling)
        blocks.append(block)
        gammas.append(gamma)
    return np.vstack(blocks), gammas


def coupling_row(mechanism, motions, coupling):
    """Return the row of a coupling: what its sum's acceleration is of the bodies'."""
    joints = {joint.name: joint for joint in mechanism.joints}
    cuts = {cut.name: cut for cut in mechanism.cut_joints}

    def second(values):
        accelerations = dict(zip([body.name for body in mechanism.bodies], values.reshape(-1, 3)))
        accelerations[GROUND] = np.zeros(3)
        return sum(factor * (
            joint_acceleration(mechanism, motions, accelerations, joints[name])
            if name in joints else
            accelerations[cuts[name].body_a][2] - accelerations[cuts[name].body_b][2])
            for name, factor in coupling.joints.items())

    count = 3 * len(mechanism.bodies)
    still = second(np.zeros(count))
    # The acceleration of the sum is affine in those of the bodies.
    return (np.array([[second(one) - still for one in np.eye(count)]]), np.array([-still]))


def least_squares(matrix, right):
    """Solve a system of equations that may be dependent."""
    return np.linalg.lstsq(matrix, right, rcond=None)[0]


def extended(matrix, right):
    """Solve by elimination in extended precision, rows and columns scaled: for masses apart."""
    matrix, x = matrix.astype(np.longdouble), right.astype(np.longdouble)
    columns = np.ones(len(x), np.longdouble)
    for _ in range(8):
        row = 1.0 / np.sqrt(np.abs(matrix).max(axis=1))
        matrix, x = matrix * row[:, None], x * row
        column = 1.0 / np.sqrt(np.abs(matrix).max(axis=0))
        matrix, columns = matrix * column, columns * column
    for k in range(len(x)):
        swap = [k, k + int(np.argmax(np.abs(matrix[k:, k])))]
        matrix[swap], x[swap] = matrix[swap[::-1]], x[swap[::-1]]
        share = matrix[k + 1:, k] / matrix[k, k]
        matrix[k + 1:, k:] -= np.outer(share, matrix[k, k:])
        x[k + 1:] -= share * x[k]
    for k in range(len(x) - 1, -1, -1):
        x[k] = (x[k] - matrix[k, k + 1:] @ x[k + 1:]) / matrix[k, k]
    return (x * columns).astype(float)


def forward_dynamics(mechanism, q, qd, tau, gravity=(0.0, -9.81), solve=least_squares):
    """Return the Result for joint coordinates, rates and joint torques, each (nv,)."""
    motions = body_motions(mechanism, q, qd)
    tree = [as_constraint(joint) for joint in mechanism.joints]
    jac, gammas = stacked_rows(mechanism, motions, tree + list(mechanism.cut_joints))
    mass = np.diag([value for body in mechanism.bodies
                    for value in (body.mass, body.mass, body.inertia)])
    applied = applied_forces(mechanism, motions, tau, gravity)
    force = [applied[body.name] for body in mechanism.bodies]
    matrix = np.block([[mass, -jac.T], [jac, np.zeros((len(jac), len(jac)))]])
    solution = solve(matrix, np.concatenate(force + gammas))
    accelerations = dict(zip([body.name for body in mechanism.bodies],
                             solution[:len(mass)].reshape(-1, 3)))
    accelerations[GROUND] = np.zeros(3)
    lam = np.split(solution[len(mass):], np.cumsum([len(gamma) for gamma in gammas])[:-1])
    qdd = [joint_acceleration(mechanism, motions, accelerations, joint)
           for joint in mechanism.joints]
    return Result(np.array(qdd), np.concatenate([np.zeros(0)] + lam[len(tree):]),
                  accelerations, {joint.name: part for joint, part in zip(tree, lam)})
