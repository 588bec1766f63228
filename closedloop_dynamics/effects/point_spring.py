# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Spring and damper between two named points, or a named point and a place in the world.

    F = k (l - l0) + c l'        pulls the points together along their connecting line

with l their distance. It stores k (l - l0)^2 / 2 and dissipates c l'^2. Where the points meet
the line has no direction and there is no force. When: tension and gas springs, shock
absorbers, a cord's elasticity.
"""

from dataclasses import dataclass
from typing import Optional

from .effect import Effect
from .element import DISSIPATED, ForceElement, State
from .force_law import force_law
from .points import pull_together, two_places
from ..mechanism.checks import name, not_negative, vector
from ..mechanism.mechanism import Vector


@dataclass(frozen=True)
class PointSpring(Effect):
    """
    Spring and damper along the line between two points.

    Attributes
    ----------
    point_a : str
        A named point.
    point_b : str or None
        The other one; None where ``anchor`` is given.
    anchor : tuple of 2 floats, or 3 in space, or None
        The other end's place in the world [m].
    stiffness : float
        k, zero or more [N/m].
    damping : float
        c, zero or more [N s/m].
    free_length : float
        l0, zero or more [m].

    """

    CHECKS = {'point_a': name, 'stiffness': not_negative, 'damping': not_negative,
              'free_length': not_negative, 'point_b': name, 'anchor': vector}
    VECTORS = ('anchor',)
    READINGS = ('tension', 'length')
    DRAWN_AS_SPRING = True

    point_a: str
    point_b: Optional[str] = None
    anchor: Optional[Vector] = None
    stiffness: float = 0.0
    damping: float = 0.0
    free_length: float = 0.0

    def element(self, machine):
        """Return the effect as a row of the table."""
        bodies, places = machine.two_points(self.point_a, self.point_b, self.anchor)
        return ForceElement(
            point_spring, bodies=bodies, states=(State(DISSIPATED),),
            values=(self.stiffness, self.damping, self.free_length, *places))


@force_law()
def point_spring(forces):
    stiffness, damping, free = forces.values[:3]

    def tension(length, rate):
        stretch = length - free
        return (stiffness * stretch + damping * rate, 0.5 * (stiffness * (stretch * stretch)),
                damping * rate * rate)
    pull_together(forces, two_places(forces, 3), tension)
