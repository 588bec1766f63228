# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Linear spring in a joint.

    tau = -k (q - q0)        on joint ``joint``

It stores k (q - q0)^2 / 2. When: torsion springs, flexure hinges, a counterbalance, and (with
a large k) a joint that is meant to stand still.

"""

from dataclasses import dataclass

from .effect import Effect
from .table import ForceElement, JOINT_SPRING
from ..mechanism.checks import freedom, not_negative, number


@dataclass(frozen=True)
class JointSpring(Effect):
    """
    Linear spring in a joint.

    Attributes
    ----------
    joint : str
    stiffness : float
        k, zero or more [N m/rad; N/m in a prismatic joint].
    rest : float
        q0, where it is free of torque [rad; m].

    """

    CHECKS = {'joint': freedom, 'stiffness': not_negative, 'rest': number}
    READINGS = ('torque',)

    joint: str
    stiffness: float
    rest: float = 0.0

    def element(self, machine):
        """Return the effect as a row of the table."""
        return ForceElement(
            JOINT_SPRING, (machine.joint(self.joint),), (self.stiffness, self.rest))
