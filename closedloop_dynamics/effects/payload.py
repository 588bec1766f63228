# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A mass added rigidly to a body.

    m += m_p,   m c += m_p r,   I += I_p + m_p r^2        about the body's origin

Its weight and inertia then act like the body's own; nothing is computed in addition. In space
m_p r^2 is the matrix m_p (r . r 1 - r r^T). When: a tool, a part in the gripper, a counterweight.
"""

from dataclasses import dataclass
from typing import Tuple, Union

from .effect import Effect
from ..codegen import space
from ..engine.types import MASS_X, MASS_Y
from ..mechanism.checks import name, not_negative, one_or_several, vector
from ..mechanism.fields import at
from ..mechanism.mechanism import Vector
from ..mechanism.validation import spatial_inertia


@dataclass(frozen=True)
class Payload(Effect):
    """
    A mass added rigidly to a body.

    Attributes
    ----------
    body : str
    mass : float
        Zero or more [kg].
    position : tuple of 2 floats, or 3 in space
        Its centre of mass in the body's frame [m].
    inertia : float, or tuple of 3 or 6 floats in space
        About its own centre of mass, zero or more [kg m^2]; in space in the body's axes: xx, yy,
        zz, xy, xz, yz, the elements of the matrix: xy is minus the integral of x y dm.

    """

    CHECKS = {'body': name, 'mass': not_negative, 'position': vector,
              'inertia': one_or_several(not_negative, spatial_inertia)}
    VECTORS = ('position',)

    body: str
    mass: float
    position: Vector = (0.0, 0.0)
    inertia: Union[float, Tuple[float, ...]] = 0.0

    def fit(self, mechanism):
        """Refuse an inertia of the plane in space, and one of space in the plane."""
        super().fit(mechanism)
        with at('inertia'):
            if mechanism.planar:
                not_negative(self.inertia)
            elif self.inertia != 0.0:
                spatial_inertia(self.inertia)

    def reserve(self, model, machine):
        """Make all constants loads that a mass changes."""
        space.vary(model, machine.body(self.body), (MASS_X, MASS_Y) if machine.mechanism.planar
                   else range(space.MASS, space.PLACE))

    def change(self, model, machine):
        """Add the mass to the model."""
        machine.placement(self.body).set_masses(
            model.body, self.mass, machine.vector(self.position), self.inertia)
