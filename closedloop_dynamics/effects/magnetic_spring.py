# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Attraction or repulsion of two magnetic poles, at two named points or a point and a place.

    F = k l / (l^2 + a^2)^(3/2)        pulls the points together along their connecting line

with l their distance and a the size of the poles: far away the force is k / l^2, it is largest at
a / sqrt(2), and where the points meet there is none. It stores -k / sqrt(l^2 + a^2). When: magnets
that hold a door or a workpiece, detents, contactless bearings and springs, mechanisms with two
rest positions.
"""

from dataclasses import dataclass
from typing import Optional

from .effect import Effect
from .element import ForceElement
from .force_law import force_law
from .points import pull_together, two_places
from ..codegen.expression_graph import square_root
from ..mechanism.checks import name, number, positive, vector
from ..mechanism.mechanism import Vector


@dataclass(frozen=True)
class MagneticSpring(Effect):
    """
    Attraction or repulsion of two magnetic poles.

    Attributes
    ----------
    point_a : str
        A named point.
    strength : float
        k, positive where poles attract each other, negative where they repel [N m^2].
    size : float
        a, positive [m].
    point_b : str or None
        The other point; None where ``anchor`` is given.
    anchor : tuple of 2 floats, or 3 in space, or None
        The other pole's place in the world [m].

    """

    CHECKS = {'point_a': name, 'strength': number, 'size': positive, 'point_b': name,
              'anchor': vector}
    VECTORS = ('anchor',)
    READINGS = ('force', 'length')
    DRAWN_AS_SPRING = True

    point_a: str
    strength: float
    size: float
    point_b: Optional[str] = None
    anchor: Optional[Vector] = None

    def element(self, machine):
        """Return the effect as a row of the table."""
        bodies, places = machine.two_points(self.point_a, self.point_b, self.anchor)
        return ForceElement(
            magnetic_attraction, bodies=bodies, values=(self.strength, self.size, *places))


@force_law()
def magnetic_attraction(forces):
    strength, size = forces.values[:2]

    def tension(length, _):
        square = length * length + size * size
        root = square_root(square)
        return strength * length / (square * root), -(strength / root), None
    pull_together(forces, two_places(forces, 2), tension)
