# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A circle of a point of a mechanism, as a motion of its joints: smooth, periodic, from rest."""

import math

import numpy as np

from ..mechanism.mechanism import PRISMATIC, REVOLUTE
from ..visual.motion import body_poses, named_point, pose_of, world_points

# Positions around the circle that the joints are solved for; their harmonics are exact to
# rounding for circles that keep away from singular configurations.
POSITIONS = 128
# Newton steps for each of them, and what must be left at most [m or rad].
ITERATIONS, TOLERANCE = 12, 1e-11
DIFFERENCE = 1e-6


class CircleError(ValueError):
    """A circle that the mechanism cannot follow; the message says why."""


def residual(mechanism, position, point, place, angle):
    """
    Return by how much loops are open and a point is away from a place.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Which is placed.
    position : ndarray, shape (..., nv)
        Joint coordinates [rad or m].
    point : mechanism.mechanism.Point
        That is to be in a place.
    place : ndarray, shape (2,)
        World [m].
    angle : float or None
        That its body is to have [rad]; None: any.

    Returns
    -------
    ndarray, shape (..., number of equations)

    """
    poses = body_poses(mechanism, position)
    parts = []
    for cut in mechanism.cut_joints:
        pose_a, pose_b = (pose_of(mechanism, poses, body) for body in (cut.body_a, cut.body_b))
        gap = world_points(pose_a, cut.point_a) - world_points(pose_b, cut.point_b)
        if cut.type == PRISMATIC:
            axis = pose_b[..., 2] + cut.angle
            parts.append(gap[..., 1] * np.cos(axis) - gap[..., 0] * np.sin(axis))
        else:
            parts += [gap[..., 0], gap[..., 1]]
        if cut.type != REVOLUTE:
            parts.append(pose_a[..., 2] - pose_b[..., 2] - cut.angle)
    miss = named_point(mechanism, poses, point.name) - place
    parts += [miss[..., 0], miss[..., 1]]
    if angle is not None:
        parts.append(pose_of(mechanism, poses, point.body)[..., 2] - angle)
    return np.stack(parts, axis=-1)


def solve(mechanism, position, point, place, angle):
    """
    Return the joint positions that close the loops and bring a point to a place.

    Parameters
    ----------
    mechanism, point, place, angle
        As for ``residual``.
    position : ndarray, shape (nv,)
        Nearby [rad or m].

    Returns
    -------
    ndarray, shape (nv,)

    Raises
    ------
    CircleError
        Where there are none nearby, or many.

    """
    position = np.array(position, dtype=float)
    steps = DIFFERENCE * np.eye(len(position))
    for _ in range(ITERATIONS):
        left, *shifted = residual(
            mechanism, np.vstack([position, position + steps, position - steps]), point, place,
            angle)
        if np.abs(left).max() < TOLERANCE:
            return position
        count = len(position)
        jacobian = (np.array(shifted[:count]) - shifted[count:]).T / (2.0 * DIFFERENCE)
        move, _, rank, _ = np.linalg.lstsq(jacobian, -left, rcond=1e-9)
        if rank < count:
            break
        position = position + move
    raise CircleError(
        f"the mechanism cannot bring '{point.name}' to ({place[0]:.4g}, {place[1]:.4g}), or is "
        'singular there')


class Circle:
    """
    Positions, velocities and accelerations of joints while a point goes round.

    It begins at rest in the position given, on the circle, gains its speed within the first
    turn, and keeps the angle of the point's body where the mechanism has the freedom to.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        With two or three degrees of freedom.
    start : ndarray, shape (nv,)
        Where the joints begin, loops closed [rad or m].
    name : str
        Of the point.
    radius : float
        [m].
    frequency : float
        Turns per second [Hz].
    phase : float
        Angle at which it begins, seen from the centre [rad].
    joints : sequence of str
        Whose motion is asked for.

    Raises
    ------
    CircleError
        Where the mechanism cannot follow it.

    """

    def __init__(self, mechanism, start, name, radius, frequency, phase, joints):
        self.frequency = frequency
        freedoms = len(mechanism.joints) - mechanism.number_of_equations
        point = next((point for point in mechanism.points if point.name == name), None)
        if point is None:
            raise CircleError(
                f'expected one of the points of {mechanism.name} '
                f"({', '.join(each.name for each in mechanism.points)}), got '{name}'")
        if freedoms not in (2, 3):
            raise CircleError(
                f'{mechanism.name} has {freedoms} degrees of freedom by its equations; a circle '
                'of a point needs two, or three where the angle of its body is kept, too')
        poses = body_poses(mechanism, np.array(start))
        angle = pose_of(mechanism, poses, point.body)[2] if freedoms == 3 else None
        turn = np.linspace(0.0, 2.0 * math.pi, POSITIONS, endpoint=False)
        ways = radius * np.stack([np.cos(turn + phase), np.sin(turn + phase)], axis=1)
        self.center = named_point(mechanism, poses, name) - ways[0]
        table = [np.array(start, dtype=float)]
        for way in [*ways, ways[0]]:
            table.append(solve(mechanism, table[-1], point, self.center + way, angle))
        if np.abs(table[-1] - table[1]).max() > 1e-6:
            raise CircleError('the joints do not come back to where they began: the circle goes '
                              'round a singular configuration; choose a smaller one')
        chosen = [mechanism.joint_names.index(joint) for joint in joints]
        self._harmonics = np.fft.rfft(np.array(table[1:-1])[:, chosen], axis=0) / POSITIONS
        self._harmonics[1:] *= 2.0
        self._orders = 1j * np.arange(len(self._harmonics))[:, np.newaxis]

    def at(self, time, start=None):
        """
        Return position and velocity at a time; as ``torque_laws.Reference``.

        Parameters
        ----------
        time : float
            Since the beginning [s].
        start : object
            Not looked at: the circle knows where it begins.

        Returns
        -------
        tuple of 2 ndarrays, shape (n,)

        """
        position, slope, _, (turn_rate, _) = self._shape(time)
        return position, slope * turn_rate

    def acceleration(self, time):
        """Return the accelerations at a time [rad/s^2 or m/s^2]."""
        _, slope, curvature, (turn_rate, turn_acceleration) = self._shape(time)
        return curvature * turn_rate ** 2 + slope * turn_acceleration

    def place(self, turn):
        """Return positions at an angle travelled [rad]."""
        return np.real(self._harmonics * np.exp(self._orders * turn)).sum(axis=0)

    def _shape(self, time):
        """Return positions, their derivatives by the angle travelled, and its own by time."""
        turn, *rates = self._turn(max(0.0, time))
        waves = self._harmonics * np.exp(self._orders * turn)
        return (np.real(waves).sum(axis=0), np.real(self._orders * waves).sum(axis=0),
                np.real(self._orders ** 2 * waves).sum(axis=0), rates)

    def _turn(self, time):
        """Return the angle travelled, its rate and its acceleration; at rest in the beginning."""
        speed, ramp = 2.0 * math.pi * self.frequency, 1.0 / self.frequency
        share = time / ramp
        if share >= 1.0:
            return speed * (time - ramp / 2.0), speed, 0.0
        return (speed * ramp * (share ** 3 - share ** 4 / 2.0),
                speed * (3.0 * share ** 2 - 2.0 * share ** 3),
                speed * 6.0 * share * (1.0 - share) / ramp)
