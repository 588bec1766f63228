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
