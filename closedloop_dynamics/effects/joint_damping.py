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
from .table import DISSIPATED, ForceElement, JOINT_DAMPING, State
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
        return ForceElement(JOINT_DAMPING, (machine.joint(self.joint),), (self.coefficient,),
                            (State(DISSIPATED),))
