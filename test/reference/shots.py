# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Shots at solids, drawn by number, and where they go: distances and forces of their own.

A ball of no size or of some flies straight at a solid, is pushed out by k times how deep it is in
it, and flies on. Distances come from polygons of up to 16,000 corners, whatever the package makes
of splines; free flight is marched by distance, so that nothing is missed, and what is in the
solid is integrated by RK4 with a hundredth of the contact's own time.
"""

from dataclasses import dataclass
import math

from closedloop_dynamics import Body, Joint, Mechanism, Point
from closedloop_dynamics.effects.registry import BodyContact, Cable, Contact
import numpy as np
from scipy.interpolate import CubicSpline

IN_PLANE, IN_SPACE = (0.5, 0.4), (0.8, 0.8, 0.8)
PLANAR = Mechanism(
    'shot', (Body('rail', 0.1, (0.0, 0.0), 0.1), Body('hull', 0.4, (0.0, 0.0), 0.1)),
    (Joint('x', 'prismatic', 'ground', 'rail', (0, 0), 0.0, True),
     Joint('y', 'prismatic', 'rail', 'hull', (0, 0), 0.5 * math.pi, True)), (),
    (Point('ball', 'hull', (0.0, 0.0)), Point('target', 'ground', (0.0, 0.0))))
SPATIAL = Mechanism(
    'shot', (Body('hull', IN_SPACE[0], (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3)),),
    (Joint('free', 'free', 'ground', 'hull', (0.0, 0.0, 0.0)),), (),
    (Point('ball', 'hull', (0.0, 0.0, 0.0)), Point('target', 'ground', (0.0, 0.0, 0.0))))
KINDS = ('plate', 'box', 'slot', 'star', 'spline', 'circle', 'half-plane', 'cable', 'sphere',
         'cylinder')
# Steps of the reference, relative to 1 / the contact's own frequency; more than so many: no shot.
FINE, MOST_STEPS = 0.01, 100_000


class Polygon:
    """Distance from a closed polygon, and its direction."""

    def __init__(self, corners):
        """Take the corners, shape (n, 2) [m]."""
        self._start = np.asarray(corners, float)
        self._way = np.roll(self._start, -1, axis=0) - self._start
        self._square = (self._way ** 2).sum(axis=1)

    def __call__(self, place):
        """Return the distance of a place [m], negative inside, and its gradient."""
        share = np.clip(((place - self._start) * self._way).sum(axis=1) / self._square, 0.0, 1.0)
        apart = place - self._start - share[:, None] * self._way
        square = (apart ** 2).sum(axis=1)
        nearest = int(np.argmin(square))
        (x, y), (dx, dy) = self._start.T, self._way.T
        with np.errstate(all='ignore'):
            right = place[0] < x + (place[1] - y) / dy * dx
        sign = -1.0 if np.sum(((y > place[1]) != (y + dy > place[1])) & right) % 2 else 1.0
        distance = math.sqrt(square[nearest])
        gradient = apart[nearest] / distance if distance > 0.0 else np.zeros(2)
        return sign * distance, sign * gradient


class Round:
    """Distance from a circle, sphere or cylinder; ``side`` -1: free inside."""

    def __init__(self, radius, axis=None, side=1.0):
        """Take the radius [m], and the direction of a cylinder's axis."""
        self._radius, self._axis, self._side = radius, axis, side

    def __call__(self, place):
        """Return the distance of a place [m], negative inside, and its gradient."""
        if self._axis is not None:
            place = place - (place @ self._axis) * self._axis
        distance = math.sqrt(place @ place)
        gradient = place / distance if distance > 0.0 else 0.0 * place
        return self._side * (distance - self._radius), self._side * gradient


class Half:
    """Distance from a line through the origin."""

    def __init__(self, normal):
        """Take the normal, to the free side."""
        self.normal = normal

    def __call__(self, place):
        """Return the distance of a place [m], negative inside, and its gradient."""
        return float(place @ self.normal), self.normal


@dataclass(frozen=True)
class Shot:
    """One shot."""

    kind: str
    effect: object
    distance: object
    radius: float  # [m]
    stiffness: float  # [N/m]
    mass: np.ndarray  # Shape (n,): along each axis [kg]
    place: np.ndarray  # [m]
    velocity: np.ndarray  # [m/s]
    duration: float  # [s]

    @property
    def mechanism(self):
        """Return what flies."""
        return PLANAR if len(self.mass) == 2 else SPATIAL

    @property
    def speed(self):
        """Return the speed at the start [m/s]."""
        return math.sqrt(self.velocity @ self.velocity)

    def energy(self, place, velocity):
        """Return the energy of a state [J]."""
        depth = min(0.0, self.distance(place)[0] - self.radius)
        return 0.5 * (self.mass * velocity ** 2).sum() + 0.5 * self.stiffness * depth ** 2

    def end(self, place=None, velocity=None, fine=FINE):
        """
        Return place and velocity at the end.

        Parameters
        ----------
        place, velocity : ndarray, optional
            Others at the start.
        fine : float
            Steps in the solid relative to 1 / the contact's own frequency.

        """
        x = (self.place if place is None else place).astype(float)
        v = (self.velocity if velocity is None else velocity).astype(float)
        time, short = 0.0, math.sqrt(self.mass.min() / self.stiffness)

        def pushed(place):
            distance, gradient = self.distance(place)
            return -self.stiffness * min(0.0, distance - self.radius) * gradient / self.mass

        for _ in range(MOST_STEPS):
            if time >= self.duration * (1.0 - 1e-14):
                return x, v
            gap = self.distance(x)[0] - self.radius
            if gap > 0.0:
                step = min(self.duration - time, max(gap / math.sqrt(v @ v), 1e-5 * short))
                x, time = x + step * v, time + step
                continue
            h = min(fine * short, self.duration - time)
            a = pushed(x)
            b = pushed(x + 0.5 * h * v)
            v_2, v_3 = v + 0.5 * h * a, v + 0.5 * h * b
            c = pushed(x + 0.5 * h * v_2)
            v_4 = v + h * c
            d = pushed(x + h * v_3)
            x = x + h / 6.0 * (v + 2.0 * v_2 + 2.0 * v_3 + v_4)
            v, time = v + h / 6.0 * (a + 2.0 * b + 2.0 * c + d), time + h
        raise OverflowError(f'more than {MOST_STEPS} steps')


def _corners(rng, kind, t, radius):
    """Return the corners of an outline and its size [m]; ``t``: how thick it is."""
    if kind in ('plate', 'box'):
        length = t * (10.0 ** rng.uniform(0.0, 1.5) if kind == 'plate' else rng.uniform(0.5, 1.0))
        return [(-length, -t / 2), (length, -t / 2), (length, t / 2), (-length, t / 2)], max(
            t, length)
    if kind == 'slot':
        w, g = 3.0 * t, max(0.2 * t, 2.2 * radius)
        return [(-w, -w), (w, -w), (w, w), (g / 2, w), (g / 2, t - w), (-g / 2, t - w),
                (-g / 2, w), (-w, w)], w
    if kind == 'star':
        count = 2 * int(rng.integers(4, 8))
        turns = 2.0 * np.pi * np.arange(count) / count
        radii = np.where(np.arange(count) % 2, 0.4 * t, t)
    else:
        turns, lobes = 2.0 * np.pi * np.arange(24) / 24, int(rng.integers(2, 5))
        radii = 0.5 * t * (1.0 + 0.25 * np.cos(lobes * turns + rng.uniform(0.0, 6.0)))
    return np.column_stack((radii * np.cos(turns), radii * np.sin(turns))), t


def _outline(rng, kind, t, stiffness, radius, rotation):
    """Return effect, distance and size of an outline."""
    corners, size = _corners(rng, kind, t, radius)
    corners = np.array(corners) @ rotation.T
    effect = BodyContact(
        'ball', 'target', 'curve', stiffness, radius=radius, x=tuple(corners[:, 0]),
        y=tuple(corners[:, 1]), interpolation='cubic' if kind == 'spline' else 'linear')
    if kind == 'spline':
        ends = np.vstack((corners, corners[:1]))
        length = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ends, axis=0).T))))
        corners = CubicSpline(length, ends, bc_type='periodic')(
            np.linspace(0.0, length[-1], 16001)[:-1])
    return effect, Polygon(corners), size


def draw(number):
    """Return a shot."""
    rng, kind = np.random.default_rng([27, number]), KINDS[number % len(KINDS)]
    t, speed, stiffness = 10.0 ** rng.uniform((-3.0, -1.0, 4.0), (0.0, 2.0, 8.0))
    radius = 0.0 if rng.random() < 0.5 else t * rng.uniform(0.05, 0.5)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    cos, sin = math.cos(angle), math.sin(angle)
    mass, size = np.array(IN_SPACE if kind in ('sphere', 'cylinder') else IN_PLANE), t
    if kind in ('half-plane', 'cable'):
        radius = 0.0
    if kind == 'half-plane':
        effect = Contact('ball', (0.0, 0.0), stiffness, angle=angle)
        distance = Half(np.array([-sin, cos]))
    elif kind == 'cable':
        effect, distance = Cable(('ball', 'target'), stiffness, t), Round(t, side=-1.0)
    elif kind in ('circle', 'sphere', 'cylinder'):
        axis = rng.normal(size=3)
        axis = axis / math.sqrt(axis @ axis) if kind == 'cylinder' else None
        effect = BodyContact('ball', 'target', kind, stiffness, radius=radius,
                             other_radius=t / 2, axis=None if axis is None else tuple(axis))
        distance = Round(t / 2, axis)
    else:
        effect, distance, size = _outline(
            rng, kind, t, stiffness, radius, np.array([[cos, -sin], [sin, cos]]))
    way = rng.normal(size=len(mass))
    way *= (-1.0 if kind == 'half-plane' and way @ distance.normal > 0.0 else 1.0) / math.sqrt(
        way @ way)
    far = size * 10.0 ** rng.uniform(0.3, 1.3)
    place, duration = rng.uniform(-0.7, 0.7, len(mass)) * size, 4.0 * t / speed
    if kind != 'cable':
        place, duration = place - far * way, 2.2 * far / speed
    return Shot(kind, effect, distance, radius, stiffness, mass, place, speed * way, duration)
