# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Accelerations and multipliers to more digits than the kernels have.

A third way to the same numbers: every body has three coordinates of its own, every
joint two forces; the sparse equations are set up in extended precision and solved by
iterative refinement. Nothing is shared with the kernels.
"""

import sys

import numpy as np
from machine import ROOT
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.mechanism.mechanism import GROUND, REVOLUTE  # noqa: E402,I100

MOST_REFINEMENTS = 60
# A refinement that changes no more than this has brought all the digits there are.
ENOUGH = 1e-18


def exact_dynamics(mechanism, q, qd, tau):
    """
    Compute joint accelerations and multipliers in extended precision [rad/s^2], [N].

    Of coordinates, rates and torques that are taken as exact, shape (nv,). ValueError where the
    mechanism has other joints than revolute ones.
    """
    if any(joint.type != REVOLUTE for joint in (*mechanism.joints, *mechanism.cut_joints)):
        raise ValueError('joints: expected revolute ones only')
    bodies = {body.name: index for index, body in enumerate(mechanism.bodies)}
    angle, rate = _absolute(mechanism, q, qd)
    equations = _Equations(mechanism, bodies, angle, rate)
    right = np.concatenate([_applied(mechanism, bodies, tau), np.array(
        equations.right, dtype=np.longdouble)])
    solution = refined(equations.row, equations.column, np.array(
        equations.value, dtype=np.longdouble), right)
    turning = solution[:3 * len(bodies):3]
    acceleration = [turning[bodies[joint.child]] - (
        0 if joint.parent == GROUND else turning[bodies[joint.parent]])
        for joint in mechanism.joints]
    first = len(solution) - 2 * len(mechanism.cut_joints)
    return np.array(acceleration), -solution[first:]


def refined(row, column, value, right):
    """
    Solve sparse equations by LU factors in double, residuals in extended precision.

    ``row`` and ``column`` are the places of the entries ``value``, longdouble; ``right``,
    longdouble, has shape (n,), as the solution that is returned.
    """
    row, column = np.array(row), np.array(column)
    size = len(right)
    factors = splu(coo_matrix((value.astype(float), (row, column)), (size, size)).tocsc())
    solution = np.zeros(size, dtype=np.longdouble)
    for _ in range(MOST_REFINEMENTS):
        residual = right.copy()
        np.subtract.at(residual, row, value * solution[column])
        correction = factors.solve(residual.astype(float))
        solution += correction
        if np.abs(correction).max() <= ENOUGH * np.abs(solution).max():
            break
    return solution


def _absolute(mechanism, q, qd):
    """Return the absolute angle and rate of each body by name, in extended precision."""
    angle = {GROUND: np.longdouble(0)}
    rate = {GROUND: np.longdouble(0)}
    waiting = list(zip(mechanism.joints, q, qd))
    while waiting:
        left = []
        for joint, position, velocity in waiting:
            if joint.parent in angle:
                angle[joint.child] = angle[joint.parent] + np.longdouble(joint.angle) + position
                rate[joint.child] = rate[joint.parent] + velocity
            else:
                left.append((joint, position, velocity))
        waiting = left
    return angle, rate


def _applied(mechanism, bodies, tau):
    """Return the moments of the joint torques on all bodies: three entries a body."""
    applied = np.zeros(3 * len(bodies), dtype=np.longdouble)
    for joint, torque in zip(mechanism.joints, tau):
        applied[3 * bodies[joint.child]] += torque
        if joint.parent != GROUND:
            applied[3 * bodies[joint.parent]] -= torque
    return applied


class _Equations:
    """
    [M, G^T; G, 0] [a; -f] = [moments; right] by entries, joints before cut joints.

    Angles and rates are those of the bodies by name.
    """

    def __init__(self, mechanism, bodies, angle, rate):
        self.row, self.column, self.value, self.right = [], [], [], []
        self._bodies, self._angle, self._rate = bodies, angle, rate
        self._description = {body.name: body for body in mechanism.bodies}
        for name, index in bodies.items():
            body = self._description[name]
            for part, inertia in enumerate((body.inertia, body.mass, body.mass)):
                self._entry(3 * index + part, 3 * index + part, np.longdouble(inertia))
        pairs = [(joint.child, (0.0, 0.0), joint.parent, joint.position)
                 for joint in mechanism.joints]
        pairs += [(cut.body_a, cut.point_a, cut.body_b, cut.point_b)
                  for cut in mechanism.cut_joints]
        for body_a, point_a, body_b, point_b in pairs:
            self._connect(body_a, point_a, body_b, point_b)

    def _connect(self, body_a, point_a, body_b, point_b):
        """Add the two equations of p_a - p_b = 0, differentiated twice."""
        first = 3 * len(self._bodies) + len(self.right)
        right = np.zeros(2, dtype=np.longdouble)
        for sign, name, point in ((1, body_a, point_a), (-1, body_b, point_b)):
            if name == GROUND:
                continue
            index = 3 * self._bodies[name]
            x, y = self._arm(name, point)
            for part, turning in enumerate((-y, x)):
                for place, value in ((index, sign * turning), (index + 1 + part, sign)):
                    self._entry(first + part, place, np.longdouble(value))
                    self._entry(place, first + part, np.longdouble(value))
            right += sign * self._rate[name] ** 2 * np.array([x, y])
        self.right += list(right)

    def _arm(self, name, point):
        """Return the vector from a body's centre of mass to a point on it, in world axes."""
        x, y = (np.longdouble(p) - np.longdouble(c)
                for p, c in zip(point, self._description[name].center_of_mass))
        cos, sin = np.cos(self._angle[name]), np.sin(self._angle[name])
        return cos * x - sin * y, sin * x + cos * y

    def _entry(self, row, column, value):
        self.row.append(row)
        self.column.append(column)
        self.value.append(value)
