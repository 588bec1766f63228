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
Inertia of a motor's rotor behind a gear.

    reflected inertia  I_r = N^2 J        joint torque for it: I_r qdd

The rotor turns N times as fast as the joint; its energy J (N qd)^2 / 2 counts as kinetic. It is
taken relative to the body that carries the motor, as usual: the share from that body's own
turning is left out, which is exact where the motor stands on the ground. When: geared
drives, whose rotor often outweighs the link.

"""

from dataclasses import dataclass

from .effect import Effect
from ..core.types import ARMATURE, REVOLUTE, REVOLUTE_ARMATURE, TYPE
from ..mechanism.checks import name, not_negative, number
from ..mechanism.fields import FieldError


@dataclass(frozen=True)
class Rotor(Effect):
    """
    A rotor that a joint turns through a gear.

    Attributes
    ----------
    joint : str
    inertia : float
        J of the rotor about its own axis, zero or more [kg m^2].
    gear_ratio : float
        N, turns of the rotor per turn of the joint, not zero (per metre in a prismatic
        joint: 2 pi / lead [rad/m]).

    """

    CHECKS = {'joint': name, 'inertia': not_negative, 'gear_ratio': number}

    joint: str
    inertia: float
    gear_ratio: float = 1.0

    def __post_init__(self):
        """Refuse what cannot be a rotor."""
        super().__post_init__()
        if self.gear_ratio == 0.0:
            raise FieldError('a number that is not zero', '0', path=('gear_ratio',))

    def change(self, model, machine):
        """Add the reflected inertia to the model."""
        row = machine.joint_row(self.joint)
        model.body[row, ARMATURE] += self.gear_ratio ** 2 * self.inertia
        if model.tree[row, TYPE] == REVOLUTE:
            model.tree[row, TYPE] = REVOLUTE_ARMATURE
