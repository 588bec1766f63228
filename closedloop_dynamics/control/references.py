# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Where joints are to be, by time: waves about a motion, trajectories, paths.

Every quantity is an array over the joints driven, in one order. A path is that of a point of a
mechanism, a circle or straight ways from place to place: smooth, periodic, from rest.
"""

from dataclasses import dataclass, replace
import math

import numpy as np

from ..kinematics.assembly import Assembler
from ..kinematics.driven import BranchEndError, DrivenKinematics
from ..kinematics.geometry import Geometry
from ..kinematics.modeling import extent
from ..mechanism.kinematics import body_poses, named_point, pose_of
from ..mechanism.mechanism import DrivingConstraint, Point
from ..mechanism.rotations import about_z, composed, CONJUGATE, of_quaternion, quaternion_about

# Positions around the circle that the joints are solved for; their harmonics are exact to
# rounding for circles that keep away from singular configurations.
POSITIONS = 128
# Points of a straight way between two places, which a spline goes through.
STRETCHES = 24


@dataclass(frozen=True)
class Wave:
    """
    ``amplitude * sin(2 pi frequency t + phase)`` for every joint.

    Arrays of shape (n,): any unit, Hz, rad.
    """

    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray

    def value(self, time):
        """Return the wave at a time [s]."""
        return self.amplitude * np.sin(2 * np.pi * self.frequency * time + self.phase)

    def rate(self, time):
        """Return its derivative with respect to time."""
        pulsation = 2 * np.pi * self.frequency
        return self.amplitude * pulsation * np.cos(pulsation * time + self.phase)

    def acceleration(self, time):
        """Return its second derivative with respect to time."""
        return -(2 * np.pi * self.frequency) ** 2 * self.value(time)


@dataclass(frozen=True)
class Reference:
    """Where a joint should be: a start, a constant velocity and a wave on top."""

    #: ``position``, ``velocity``: Shape (n,): At time 0 [rad or m], NaN: where the joint is then;
    #: [rad/s or m/s].
    position: np.ndarray
    velocity: np.ndarray
    #: [rad or m]; its value at time 0 is taken off, so that the reference begins at ``position``
    #: whatever the phase.
    wave: Wave

    def at(self, time, start):
        """Return position and velocity at a time [s] after the joints were at ``start``."""
        origin = np.where(np.isnan(self.position), start, self.position)
        wave = self.wave.value(time) - self.wave.value(0.0)
        return origin + self.velocity * time + wave, self.velocity + self.wave.rate(time)

    def acceleration(self, time):
        """Return the acceleration at a time [rad/s^2 or m/s^2]."""
        return self.wave.acceleration(time)


class TrajectoryError(ValueError):
    """An infeasible or malformed trajectory; the message gives the reason."""


@dataclass(frozen=True)
class Waypoints:
    """The points of a trajectory."""

    stamp: float  # When its time begins [s]; 0: with the next state
    times: np.ndarray  # Shape (n,): Of the points, from then on [s]; increasing
    #: Shape (n, number of joints): Positions; and velocities; and accelerations: as many as the
    #: points give.
    derivatives: list


class Trajectory:
    """
    The motion from a state through points, and rest at the last one.

    Polynomials of the fifth degree where the points give accelerations, of the third where they
    give velocities; else the cubic spline through their positions. Of the Points those that are
    over are left out. ``time``, at which the joints are in the state [s], is counted as
    ``points.stamp``; the time of the motion is zero then. ``position`` and ``velocity`` have shape
    (number of joints,). Raises TrajectoryError if it is over.
    """

    def __init__(self, points, time, position, velocity):
        # A quarter of a node's start-up time, where no trajectory is requested.
        from scipy.interpolate import BPoly, CubicSpline
        times = points.times + (points.stamp - time if points.stamp else 0.0)
        ahead = times > 0.0
        if not ahead.any():
            raise TrajectoryError(f'it was over {-times[-1]:.3g} s ago')
        knots = np.concatenate(([0.0], times[ahead]))
        state = position, velocity, np.zeros_like(position)
        rows = [np.vstack([first, values[ahead]])
                for first, values in zip(state, points.derivatives)]
        if len(rows) > 1:
            motion = BPoly.from_derivatives(knots, np.stack(rows, axis=1))
        else:
            motion = CubicSpline(knots, rows[0], bc_type=(
                (1, velocity), (1, np.zeros_like(position))))
        self._end, self._rest = knots[-1], rows[0][-1]
        self._motion, self._rate = motion, motion.derivative()
        self._acceleration = self._rate.derivative()

    def at(self, time, start):
        """Return position and velocity at a time [s]; ``start`` is ignored."""
        if time >= self._end:
            return self._rest, np.zeros_like(self._rest)
        return self._motion(time), self._rate(time)

    def acceleration(self, time):
        """Return the acceleration at a time [rad/s^2 or m/s^2]."""
        if time >= self._end:
            return np.zeros_like(self._rest)
        return self._acceleration(time)


class PathError(ValueError):
    """A path that the mechanism cannot follow; the message says why."""


def solve(mechanism, position, point, place, turn):
    """
    Return the joint positions, shape (nq,), that close the loops and bring a point to a place.

    ``position`` closes the loops, on the branch that is wanted [rad or m]; ``place``, shape (2,),
    in space (3,), in the world [m]; ``turn``, the angle [rad] or unit quaternion x, y, z, w that
    the body of the Point is to have; None: any. Raises PathError where there are none on this
    branch, or many.
    """
    return _followed(mechanism, position, point, [place], [turn])[0]


def _followed(mechanism, position, point, places, turns):
    """Return the positions, shape (n, nq), one after the other, of places and turns."""
    motions, points, values = _drives(mechanism, point, places, turns)
    try:
        found = DrivenKinematics(replace(
            mechanism, motions=motions, points=(*mechanism.points, *points)), position).follow(
                values)
        if found.end is None:
            return found.position
        where = places[len(found.position)]
    except (BranchEndError, ValueError):
        where = places[0]
    raise PathError(
        f"the mechanism cannot bring '{point.name}' to "
        f"({', '.join(f'{part:.4g}' for part in where)}), or is singular there")


def _drives(mechanism, point, places, turns):
    """Return what drives a point and, by points on them, its body's axes; points, and values."""
    size, length = len(places[0]), extent(mechanism)
    motions = [DrivingConstraint(f'{point.name} {k}', point=point.name, direction=tuple(one))
               for k, one in enumerate(np.eye(size))]
    if turns[0] is None:
        return tuple(motions), (), np.array(places)
    tips = [Point(f'{point.name} {k}', point.body, tuple(point.position + length * one))
            for k, one in enumerate(np.eye(size)[:size - 1])]
    axes = np.array([_axes(turn) for turn in turns])
    # Across the axes as they are on the average; they lean by less than a right angle from there.
    middle, values = _axes(np.mean(turns, axis=0)), [np.array(places)]
    for along, across in ((0, 1), (0, 2), (1, 2))[:1 if size == 2 else 3]:
        way = middle[:, across]
        motions.append(DrivingConstraint(
            f'{tips[along].name} {across}', point=tips[along].name, direction=tuple(way)))
        values.append((places + length * axes[:, :, along]) @ way[:, np.newaxis])
    return tuple(motions), tuple(tips), np.hstack(values)


def _axes(turn):
    """Return the axes of a body, as columns, from its angle [rad] or quaternion of any length."""
    if np.ndim(turn):
        return of_quaternion(turn / np.linalg.norm(turn))
    return of_quaternion(about_z(turn))[:2, :2]


def freedoms_of(mechanism, position):
    """Return how many degrees of freedom a mechanism has near a closed position, shape (nq,)."""
    loops = replace(mechanism, motions=())
    return Assembler(loops, Geometry(loops).equations).degrees_of_freedom(position)


def _point_and_turn(mechanism, start, name):
    """Return a named point, its place at the start and how its body is turned, if that is free."""
    point = next((point for point in mechanism.points if point.name == name), None)
    if point is None:
        raise PathError(
            f'expected one of the points of {mechanism.name} '
            f"({', '.join(each.name for each in mechanism.points)}), got '{name}'")
    freedoms, size = freedoms_of(mechanism, start), 2 if mechanism.planar else 3
    whole = 3 if mechanism.planar else 6
    if freedoms not in (size, whole):
        raise PathError(
            f'{mechanism.name} has {freedoms} degrees of freedom; the path of a point needs '
            f'{size}, or {whole} where its body keeps how it is turned, too')
    poses = body_poses(mechanism, np.array(start))
    pose = pose_of(mechanism, poses, point.body)
    turn = None if freedoms == size else pose[2] if mechanism.planar else pose[3:]
    return point, named_point(mechanism, poses, name), turn


class CircularPath:
    """
    Positions, velocities and accelerations of joints while a point goes round.

    It begins at rest in the position given, on the circle, gains its speed within the first
    turn, and keeps how the point's body is turned where the mechanism has the freedom to. In
    space the circle is horizontal.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        With two or three degrees of freedom, in space with three or six.
    start : ndarray, shape (nq,)
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
        Joints whose motion is wanted.
    tilt : float
        Angle of the cone that the body's axes go round with the point, from where they begin
        [rad]; in space, with six degrees of freedom.

    Raises
    ------
    PathError
        Where the mechanism cannot follow it.

    """

    def __init__(self, mechanism, start, name, radius, frequency, phase, joints, tilt=0.0):
        self.frequency = frequency
        point, place, turned = _point_and_turn(mechanism, start, name)
        if tilt and (mechanism.planar or turned is None):
            raise PathError(f'{mechanism.name} cannot lean by an angle of its own: that takes six '
                            'degrees of freedom')
        turn = np.linspace(0.0, 2.0 * math.pi, POSITIONS, endpoint=False)
        ways = np.zeros((POSITIONS, len(place)))
        ways[:, :2] = radius * np.stack([np.cos(turn + phase), np.sin(turn + phase)], axis=1)
        self.center = place - ways[0]
        leaning = [_leaning(tilt, angle + phase) for angle in turn] if tilt else None
        turns = [turned if leaning is None else composed(
            composed(leaning[k], leaning[0] * CONJUGATE), turned) for k in range(POSITIONS)]
        table = _followed(mechanism, start, point, self.center + np.vstack([ways, ways[:1]]),
                          [*turns, turns[0]])
        if np.abs(mechanism.coordinates.apart(table[-1], table[0])).max() > 1e-6:
            raise PathError('the joints do not come back to where they began: the circle goes '
                            'round a singular configuration; choose a smaller one')
        chosen = _places(mechanism, joints)
        self.harmonics = np.fft.rfft(table[:-1, chosen], axis=0) / POSITIONS
        self.harmonics[1:] *= 2.0
        self._orders = 1j * np.arange(len(self.harmonics))[:, np.newaxis]

    def at(self, time, start=None):
        """Return position and velocity at a time [s]; ``start`` is ignored."""
        position, slope, _, (turn_rate, _) = self._shape(time)
        return position, slope * turn_rate

    def acceleration(self, time):
        """Return the accelerations at a time [rad/s^2 or m/s^2]."""
        _, slope, curvature, (turn_rate, turn_acceleration) = self._shape(time)
        return curvature * turn_rate ** 2 + slope * turn_acceleration

    def place(self, turn):
        """Return positions at an angle travelled [rad]."""
        return np.real(self.harmonics * np.exp(self._orders * turn)).sum(axis=0)

    def _shape(self, time):
        """Return positions, their derivatives by the angle travelled, and its own by time."""
        turn, *rates = self._turn(max(0.0, time))
        waves = self.harmonics * np.exp(self._orders * turn)
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


def _places(mechanism, joints):
    """Return where in q the coordinates of joints of one degree of freedom are."""
    return [mechanism.coordinates.coordinates[joint].start for joint in joints]


def _leaning(tilt, angle):
    """Return the quaternion of a lean outward at an angle round a circle [rad]."""
    return quaternion_about((-math.sin(angle), math.cos(angle), 0.0), tilt)


class PointToPointPath:
    """
    Positions, velocities and accelerations of joints while a point goes from place to place.

    Straight, from rest to rest, through all of them and back to where it began; again and again.
    The body of the point keeps how it is turned where the mechanism has the freedom to. ``places``
    are seen from where it begins, shape (n, 2), in space (n, 3) [m]; ``durations``, shape (n +
    1,), are of the way to each of them, and back [s]; the rest is as of a ``CircularPath``.

    Attributes
    ----------
    places : ndarray, shape (n + 1, 2), in space (n + 1, 3)
        World [m]; the last one is where it begins.
    period : float
        [s].

    """

    def __init__(self, mechanism, start, name, places, durations, joints):
        point, origin, turned = _point_and_turn(mechanism, start, name)
        from scipy.interpolate import CubicSpline
        self.places = origin + np.vstack([places, np.zeros(len(origin))])
        self._ends = np.cumsum(durations)
        self._durations, self.period = np.array(durations), float(self._ends[-1])
        share = np.linspace(0.0, 1.0, STRETCHES + 1)
        chosen = _places(mechanism, joints)
        position, begin, self._ways = np.array(start, dtype=float), origin, []
        for place in self.places:
            table = _followed(mechanism, position, point, begin + np.outer(share, place - begin),
                              [turned] * len(share))
            position, way = table[-1], CubicSpline(share, table[:, chosen])
            self._ways.append((way, way.derivative(), way.derivative(2)))
            begin = place
        if np.abs(mechanism.coordinates.apart(position, np.array(start))).max() > 1e-6:
            raise PathError('the joints do not come back to where they began: the way goes round '
                            'a singular configuration; choose a shorter one')

    def at(self, time, start=None):
        """Return position and velocity at a time [s]; ``start`` is ignored."""
        (way, slope, _), share, rate, _ = self._stretch(time)
        return way(share), slope(share) * rate

    def acceleration(self, time):
        """Return the accelerations at a time [rad/s^2 or m/s^2]."""
        (_, slope, curvature), share, rate, acceleration = self._stretch(time)
        return curvature(share) * rate ** 2 + slope(share) * acceleration

    def _stretch(self, time):
        """Return the way that it is on, the share of it behind, and that by time, twice."""
        time = max(0.0, time) % self.period
        k = min(int(np.searchsorted(self._ends, time, side='right')), len(self._ways) - 1)
        duration = self._durations[k]
        x = (time - self._ends[k] + duration) / duration
        return (self._ways[k], x ** 3 * (10.0 - 15.0 * x + 6.0 * x * x),
                30.0 * (x * (1.0 - x)) ** 2 / duration,
                60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration ** 2)
