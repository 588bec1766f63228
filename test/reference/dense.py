# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Reduced-coordinate twin: body Jacobians by tree paths, Lagrange's equations, dense solves.

Derivatives are complex steps, exact to rounding. The order of rows and columns
is the package's: joints in the order of ``mechanism.joints``, equations in the
order of ``mechanism.closures``.
"""

from closedloop_dynamics.mechanism.mechanism import (
    CUT_JOINT_EQUATIONS, DISTANCE, FIXED, POINT_ON_LINE, REVOLUTE)
import numpy as np

from .trees import body_frames, derivative, jacobian, placed, point_jacobian, turned, unit

EARTH = (0.0, -9.81)


def generalized_inertia_matrix(mechanism, q):
    """Return the (nv, nv) sum over the bodies of J^T M J."""
    gim = 0.0
    for body in mechanism.bodies:
        jac = point_jacobian(mechanism, q, body.name, body.center_of_mass)
        gim = gim + jac.T @ np.diag([body.inertia, body.mass, body.mass]) @ jac
    return gim


def kinetic_energy(mechanism, q, qd):
    """Return the kinetic energy [J]."""
    return 0.5 * qd @ generalized_inertia_matrix(mechanism, q) @ qd


def potential_energy(mechanism, q, gravity=EARTH):
    """Return the potential energy [J], zero at the origin of the world."""
    frames = body_frames(mechanism, q)
    return -sum(body.mass * np.dot(gravity, placed(frames[body.name], body.center_of_mass))
                for body in mechanism.bodies)


def bias_force(mechanism, q, qd, gravity=EARTH):
    """Return what stands beside I qdd in Lagrange's equations: velocity products, gravity."""
    gim_rate = derivative(lambda x: generalized_inertia_matrix(mechanism, x), q, qd)
    kinetic = jacobian(lambda x: kinetic_energy(mechanism, x, qd), q)
    potential = jacobian(lambda x: potential_energy(mechanism, x, gravity), q)
    return gim_rate @ qd - kinetic + potential


def rows(mechanism):
    """Return {name of a cut joint or coupling: slice of its rows}."""
    slices, start = {}, 0
    for cut in mechanism.cut_joints:
        slices[cut.name] = slice(start, start + CUT_JOINT_EQUATIONS[cut.type])
        start = slices[cut.name].stop
    for coupling in mechanism.couplings:
        slices[coupling.name] = slice(start, start + 1)
        start += 1
    return slices


def coordinate(mechanism, q, frames, name):
    """Return the coordinate of a joint, or of a cut joint the angle of body A in body B."""
    if name in mechanism.joint_names:
        return q[mechanism.joint_names.index(name)]
    cut, = (cut for cut in mechanism.cut_joints if cut.name == name)
    return frames[cut.body_a][1] - frames[cut.body_b][1]


def coupled(mechanism, q):
    """Return what the couplings' sums miss, each an array of one."""
    frames = body_frames(mechanism, q)
    return [np.array([sum(factor * coordinate(mechanism, q, frames, name)
                          for name, factor in coupling.joints.items()) - coupling.offset])
            for coupling in mechanism.couplings]


def closure(mechanism, q):
    """Return the (nc,) loop-closure residual psi = p_a - p_b."""
    frames = body_frames(mechanism, q)
    residual = [np.zeros(0)]
    for cut in mechanism.cut_joints:
        offset = placed(frames[cut.body_a], cut.point_a) - placed(frames[cut.body_b], cut.point_b)
        axis_angle = frames[cut.body_b][1] + cut.angle
        twist = [frames[cut.body_a][1] - axis_angle]
        if cut.type == REVOLUTE:
            residual.append(offset)
        elif cut.type == FIXED:
            residual += [offset, twist]
        elif cut.type == DISTANCE:
            # Half the difference of the squares, over the length: without a root.
            residual.append([0.5 * (offset @ offset / cut.length - cut.length)])
        else:
            held = [[turned(unit(axis_angle)) @ offset], twist]
            residual += held[:CUT_JOINT_EQUATIONS[cut.type]]
    return np.concatenate(residual + coupled(mechanism, q))


def closure_jacobian(mechanism, q):
    """Return the (nc, nv) derivative of the closure by complex steps."""
    return jacobian(lambda x: closure(mechanism, x), q)


def closure_jacobian_by_paths(mechanism, q):
    """Return the (nc, nv) derivative of the closure from the Jacobians of its bodies."""
    frames = body_frames(mechanism, q)
    jac = [np.zeros((0, len(q)))]
    for cut in mechanism.cut_joints:
        of_a = point_jacobian(mechanism, q, cut.body_a, cut.point_a)
        of_b = point_jacobian(mechanism, q, cut.body_b, cut.point_b)
        offset = placed(frames[cut.body_a], cut.point_a) - placed(frames[cut.body_b], cut.point_b)
        axis = unit(frames[cut.body_b][1] + cut.angle)
        if cut.type == REVOLUTE:
            jac.append(of_a[1:] - of_b[1:])
        elif cut.type == FIXED:
            jac += [of_a[1:] - of_b[1:], of_a[:1] - of_b[:1]]
        elif cut.type == DISTANCE:
            jac.append((offset @ (of_a[1:] - of_b[1:]) / cut.length)[None, :])
        else:
            across = turned(axis) @ (of_a[1:] - of_b[1:]) - (axis @ offset) * of_b[0]
            jac += [across[None, :], of_a[:1] - of_b[:1]][:CUT_JOINT_EQUATIONS[cut.type]]
    constant = [derivative(lambda x: coupled(mechanism, x)[k], q, np.eye(len(q))[j])
                for k in range(len(mechanism.couplings)) for j in range(len(q))]
    return np.concatenate([*jac, np.reshape(constant, (len(mechanism.couplings), len(q)))])


def constraint_bias(mechanism, q, qd):
    """Return the (nc,) product of the closure Jacobian's rate and qd."""
    return derivative(lambda x: closure_jacobian_by_paths(mechanism, x), q, qd) @ qd


def forward_dynamics(mechanism, q, qd, tau, gravity=EARTH):
    """Return (qdd, lam) from the augmented system, solved densely."""
    jac = closure_jacobian(mechanism, q)
    gim = generalized_inertia_matrix(mechanism, q)
    nc, nv = jac.shape
    matrix = np.block([[gim, jac.T], [jac, np.zeros((nc, nc))]])
    right = np.concatenate([tau - bias_force(mechanism, q, qd, gravity),
                            -constraint_bias(mechanism, q, qd)])
    solution = np.linalg.solve(matrix, right)
    return solution[:nv], -solution[nv:]


def inverse_dynamics(mechanism, q, qd, qdd, gravity=EARTH):
    """Return (tau, lam), tau (nv,) zero where no joint is actuated."""
    jac = closure_jacobian(mechanism, q)
    selection = np.diag([float(joint.actuated) for joint in mechanism.joints])
    right = (generalized_inertia_matrix(mechanism, q) @ qdd
             + bias_force(mechanism, q, qd, gravity))
    solution = np.linalg.lstsq(np.hstack([selection, jac.T]), right, rcond=None)[0]
    return solution[:len(q)], solution[len(q):]


def constraint_forces(mechanism, q, lam):
    """Return (number of cuts, 3): torque, x, y of body B's wrench on A at A's cut point."""
    frames = body_frames(mechanism, q)
    forces = np.zeros((len(mechanism.cut_joints), 3))
    for force, cut in zip(forces, mechanism.cut_joints):
        part = lam[rows(mechanism)[cut.name]]
        if cut.type == REVOLUTE:
            force[1:] = part
            # A coupling of its angle acts on body A there.
            force[0] = sum(coupling.joints[cut.name] * lam[rows(mechanism)[coupling.name]][0]
                           for coupling in mechanism.couplings if cut.name in coupling.joints)
        elif cut.type == FIXED:
            force[:] = part[2], part[0], part[1]
        elif cut.type == DISTANCE:
            force[1:] = part[0] / cut.length * (
                placed(frames[cut.body_a], cut.point_a) - placed(frames[cut.body_b], cut.point_b))
        else:
            force[0] = 0.0 if cut.type == POINT_ON_LINE else part[1]
            force[1:] = part[0] * turned(unit(frames[cut.body_b][1] + cut.angle))
    return forces
