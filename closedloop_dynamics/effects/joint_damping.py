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
