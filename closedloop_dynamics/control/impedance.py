# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The impedance law: a point behaves as if held by springs and dampers.

The joints that are not driven follow by the loops: with J the Jacobian of the closure equations,
rates are ``G qd_driven``, where ``J G = 0`` and the rows of G of driven joints are those of the
identity. A wrench w at the point is Q in the joints of the spanning tree and ``G^T Q`` in the
driven ones (principle of virtual power).
"""

import numpy as np

from .errors import StartError
from ..kinematics.geometry import Geometry
from ..mechanism.kinematics import body_poses, body_velocities, poses_in_space, wrench_in_joints
from ..mechanism.rotations import composed, CONJUGATE, rotated, rotation_vector

# Indices of the components in space that a planar mechanism has: along x and y, about z.
IN_PLANE = [0, 1, 5]


class Impedance:
    """
    Torques of the driven joints that hold a point by springs and dampers where it begins.

    ``tau = G^T Q(k e - d v) + tau_0``: e by how far point and body are away, as places [m] and a
    rotation vector [rad] in world axes, v their velocity, tau_0 what holds the mechanism at rest
    in its present position, against gravity and springs. Inertia is left as it is.

    The point, by name, is to stay where the simulation has it. ``stiffness``, ``damping``, shape
    (3,), in space (6,): along x and y, in space z [N/m; N s/m], then about z, in space about x, y
    and z [N m/rad; N m s/rad]; ``feedforward``, ``limit``, by driven joint: torque added, largest
    magnitude of the torque (infinite: none) [N m]. StartError where there is no such point.
    """

    def __init__(self, simulation, name, stiffness, damping, feedforward, limit):
        self._simulation, self._mechanism = simulation, simulation.mechanism
        points = {point.name: point for point in self._mechanism.points}
        if name not in points:
            raise StartError(f"parameter 'impedance_point': expected one of the points of "
                             f"{self._mechanism.name} ({', '.join(points)}), got '{name}'")
        self._body = points[name].body
        self._place = np.array([*points[name].position, 0.0][:3])
        self._closures = Geometry(self._mechanism).equations
        self._actuated = simulation.data.actuated
        self.target = self.pose(simulation.position)
        self.tune(stiffness, damping, feedforward, limit)

    def tune(self, stiffness, damping, feedforward, limit):
        """Set other gains."""
        self.stiffness, self.damping = np.zeros(6), np.zeros(6)
        used = IN_PLANE if self._mechanism.planar else range(6)
        self.stiffness[used], self.damping[used] = stiffness, damping
        self._feedforward, self._limit = feedforward, limit

    def restart(self):
        """Do nothing: the torques have no memory."""

    def torque(self, time, position, velocity):
        """Return the torques, shape (n,), for a state, shapes (nq,), (nv,)."""
        place, turn, arm = self.pose(position)
        moving = body_velocities(
            self._mechanism, position, velocity[np.newaxis], (self._body,))[0, 0]
        moving[:3] += np.cross(moving[3:], arm)
        away = np.concatenate([self.target[0] - place, rotation_vector(
            composed(self.target[1], turn * CONJUGATE))])
        wrench = self.stiffness * away - self.damping * moving
        # Along the axes of the body.
        inward = turn * CONJUGATE
        in_tree = wrench_in_joints(
            self._mechanism, position, self._body, self._place,
            np.concatenate([rotated(inward, part) for part in (wrench[:3], wrench[3:])]))
        rest = np.zeros(len(velocity))
        torque = self._motions(position).T @ in_tree + self._feedforward
        position, _ = self._simulation.closed(position, rest)
        torque += self._simulation.inverse_dynamics(position, rest, rest)[0]
        return np.clip(torque, -self._limit, self._limit)

    def pose(self, position):
        """Return the place of the point, how its body is turned, and the way to it from there."""
        pose = poses_in_space(body_poses(self._mechanism, position, (self._body,))[0])
        arm = rotated(pose[3:], self._place)
        return pose[:3] + arm, pose[3:], arm

    def _motions(self, position):
        """Return the rates of all joints by those of the driven ones, shape (nv, n)."""
        jac = self._closures.move(position).jacobian()
        count = len(self._actuated)
        chosen = np.eye(jac.shape[1])[self._actuated]
        return np.linalg.lstsq(np.vstack([jac, chosen]), np.vstack([
            np.zeros((len(jac), count)), np.eye(count)]), rcond=None)[0]
