# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How a body moves, and states in which it has a given pose or velocity.

Of the joint coordinates that close the loops and put a body where it is wanted, those are found
that follow from the present ones by least changes (Newton's method with the pseudo-inverse of
closure and body Jacobian). The engine's loop solver has no equations for a pose, and sines of
angles in those of loops: from half a turn away these would close the wrong way round.
"""

import numpy as np

from ..kinematics.geometry import Geometry
from ..mechanism.kinematics import body_poses, body_velocities, poses_in_space
from ..mechanism.rotations import composed, CONJUGATE, rotation_vector

# An error that is left is one of the request, not of rounding, above this [m, rad; of velocities
# relative to the largest one].
REACHED = 1e-9
# Newton's method: longest change of a joint at once [rad, m], most iterations; singular values
# below this share of the largest count as zero.
STRIDE, MOST, SMALLEST = 0.2, 100, 1e-7
# Between the three poses of which a body's acceleration is the second difference: of a joint at
# most [rad, m].
MOVED = 1e-4


class PlacementError(ValueError):
    """A pose or velocity of a body that violates the loop closures."""


class Placement:
    """Velocities, accelerations and inverse kinematics of the bodies of a mechanism."""

    def __init__(self, mechanism):
        self._mechanism = mechanism
        self._closures = Geometry(mechanism).equations

    def velocity(self, position, rates, body):
        """Return velocity of the origin [m/s] and angular velocity [rad/s], world axes, (6,)."""
        return body_velocities(self._mechanism, position, rates[np.newaxis], (body,))[0, 0]

    def acceleration(self, position, rates, accelerations, body):
        """
        Return acceleration of the origin [m/s^2] and angular acceleration [rad/s^2], shape (6,).

        In world axes, from joint coordinates, rates and accelerations, shapes (nq,), (nv,), (nv,);
        by differences, to about 1e-6 of their size.
        """
        fastest = max(np.abs(rates).max(initial=0.0),
                      np.sqrt(np.abs(accelerations).max(initial=0.0)))
        if fastest == 0.0:
            return np.zeros(6)
        instant = MOVED / fastest
        moved = self._mechanism.coordinates.moved
        before, now, after = poses_in_space(body_poses(self._mechanism, np.array([moved(
            position, time * rates + 0.5 * time ** 2 * accelerations)
            for time in (-instant, 0.0, instant)]), (body,))[:, 0])
        turn = sum(rotation_vector(composed(other[3:], now[3:] * CONJUGATE))
                   for other in (before, after))
        return np.concatenate([before[:3] - 2.0 * now[:3] + after[:3], turn]) / instant ** 2

    def position(self, position, body, pose):
        """
        Return joint coordinates in which a body has a pose and the loops are closed, (nq,).

        ``pose`` is its origin [m] and unit quaternion x, y, z, w, shape (7,); ``position`` are the
        coordinates to begin with. Raises PlacementError where there are none nearby.
        """
        moved, found = self._mechanism.coordinates.moved, np.array(position, dtype=float)
        pose = np.asarray(pose, dtype=float)
        for _ in range(MOST):
            errors = self._errors(found, body, pose)
            change = np.linalg.lstsq(self._jacobian(found, body), errors, rcond=SMALLEST)[0]
            largest = np.abs(change).max(initial=0.0)
            if not largest > 1e-14:
                break
            found = moved(found, change * min(1.0, STRIDE / largest))
        left = np.abs(self._errors(found, body, pose)).max(initial=0.0)
        if not left <= REACHED:
            raise PlacementError(
                f'the loops do not let {body} have this pose: the nearest that was found is '
                f'{left:.3g} m or rad away')
        return found

    def rates(self, position, rates, body, velocity):
        """
        Return joint rates under which a body has a velocity and the loops stay closed, (nv,).

        Those next to ``rates``; ``velocity`` as ``velocity`` returns it. Raises PlacementError
        where there are none.
        """
        jac = self._jacobian(position, body)
        wanted = np.concatenate([np.zeros(len(jac) - 6), velocity])
        found = np.array(rates, dtype=float)
        # A second time, to remove rounding errors.
        for _ in range(2):
            found += np.linalg.lstsq(jac, wanted - jac @ found, rcond=SMALLEST)[0]
        left = np.abs(jac @ found - wanted).max(initial=0.0)
        # The Jacobian of a body is one of differences.
        if not left <= 10.0 * REACHED * max(1.0, np.abs(found).max(initial=0.0)):
            raise PlacementError(
                f'the loops do not let {body} have this velocity: the nearest is {left:.3g} m/s '
                'or rad/s away')
        return found

    def _jacobian(self, position, body):
        """Return derivatives of closures, then of pose, by joint displacements, (nc + 6, nv)."""
        count = self._mechanism.coordinates.nv
        return np.vstack([
            self._closures.move(position).jacobian(),
            body_velocities(self._mechanism, position, np.eye(count), (body,))[:, 0].T])

    def _errors(self, position, body, pose):
        """Return the errors of closures and of a pose, shape (nc + 6,)."""
        now = poses_in_space(body_poses(self._mechanism, position, (body,))[0])
        return np.concatenate([
            -self._closures.move(position).closures()[0], pose[:3] - now[:3],
            rotation_vector(composed(pose[3:], now[3:] * CONJUGATE))])
