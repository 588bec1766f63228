# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Viscous damping in a joint.

    tau = -c qd        on joint ``joint``

Dissipated power: c qd^2. When: bearings with grease or oil, drives with back-EMF, any loss that
grows with the rate and vanishes at rest.
"""

from dataclasses import dataclass

from .effect import Effect
from .element import DISSIPATED, ForceElement, State
from .force_law import force_law
from ..mechanism.checks import freedom, not_negative


@dataclass(frozen=True)
class JointDamping(Effect):
    """
    Viscous damping in a joint.

    Attributes
    ----------
    joint : str
    coefficient : float
        c, zero or more [N m s/rad; N s/m in a prismatic joint].

    """

    CHECKS = {'joint': freedom, 'coefficient': not_negative}
    READINGS = ('torque',)

    joint: str
    coefficient: float

    def joints(self, mechanism):
        """Return the names that ``joint`` may be: of any freedom."""
        return mechanism.coordinates.names + mechanism.cut_coordinates.names

    def element(self, machine):
        """Return the effect as a row of the table."""
        return ForceElement(
            viscous_damping, joints=(machine.joint(self.joint),), values=(self.coefficient,),
            states=(State(DISSIPATED),))


@force_law(in_balls=True)
def viscous_damping(forces):
    joint = forces.joint
    torque = -(forces.values[0] * joint.rate)
    joint.push(torque)
    forces.flow(-(torque * joint.rate))
    forces.read(torque)
