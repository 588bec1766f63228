# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The spring with which a page pulls at a machine, and the places where it takes hold."""

from dataclasses import replace
import math

from .description import EARTH, grabs
from ..effects.bushing import Bushing
from ..effects.gravity import Gravity
from ..formats.model import free_name
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import Point

# Its stretch under the machine's weight, as a share of its size, and its damping.
GIVE, DAMPING = 0.05, 0.5
# How far away it can pull to, in sizes of the machine.
FARTHEST = 1e3


class Hand:
    """
    The spring that a page pulls with: an effect that is added to a scene, switched off.

    ``scene``: with the spring, the places it can be fixed to, and gravity, switched off, if it has
    none; ``spring`` and ``gravity`` are their names; ``size``: of the mechanism [m].
    """

    def __init__(self, scene, size):
        mechanism = scene.mechanism
        taken = {point.name for point in mechanism.points}
        self._points, added = {}, []
        for k, body in enumerate(mechanism.bodies):
            for n, place in enumerate(grabs(mechanism, body)):
                name = free_name(f'grab_{k}_{n}', taken)
                added.append(Point(name, body.name, tuple(place[:len(body.center_of_mass)])))
                self._points[k, n] = name
        effects = dict(scene.effects)
        down = (0.0, -EARTH) if mechanism.planar else (0.0, 0.0, -EARTH)
        self.gravity = next((name for name, record in effects.items()
                             if isinstance(record, Gravity)), None)
        off = scene.switched_off
        if self.gravity is None:
            self.gravity = free_name('gravity', effects)
            effects[self.gravity] = Gravity(acceleration=down)
            off += (self.gravity,)
        self.spring = free_name('hand', effects)
        mass = sum(body.mass for body in mechanism.bodies) or 1.0
        stiffness = mass * EARTH / (GIVE * size)
        # In all directions: a point that is pulled beyond its reach swings across the line.
        effects[self.spring] = Bushing(
            point_a=next(iter(self._points.values())), anchor=tuple(0.0 for _ in down),
            stiffness=tuple(stiffness for _ in down),
            damping=tuple(DAMPING * math.sqrt(stiffness * mass) for _ in down))
        self.scene = replace(
            scene, effects=effects, switched_off=(*off, self.spring),
            mechanism=replace(mechanism, points=(*mechanism.points, *added)))
        self.dimensions, self.size = len(down), size

    def point(self, body, place):
        """Return the name of the point at a place of a body, by their numbers."""
        if (body, place) not in self._points:
            raise FieldError('the number of a body, and of a place of it',
                             shown([body, place]), path=('grab',))
        return self._points[body, place]

    def require_near(self, at):
        """Refuse a place so far away that the spring would have energy beyond all bounds."""
        if max(map(abs, at)) > FARTHEST * self.size:
            raise FieldError(f'a place within {FARTHEST:g} sizes of the mechanism',
                             shown(list(at)), path=('at',))
