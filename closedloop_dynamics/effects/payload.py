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
A mass added rigidly to a body.

    m += m_p,   m c += m_p r,   I += I_p + m_p r^2        about the body's origin

Its weight and inertia then act like the body's own; nothing is computed in addition. When: a
tool, a part in the gripper, a counterweight.

"""

from dataclasses import dataclass

from .effect import Effect
from ..core.types import INERTIA, MASS, MASS_X, MASS_Y
from ..mechanism.checks import name, not_negative, vector2
from ..mechanism.mechanism import Vector2


@dataclass(frozen=True)
class Payload(Effect):
    """
    A mass added rigidly to a body.

    Attributes
    ----------
    body : str
    mass : float
        Zero or more [kg].
    position : tuple of 2 floats
        Its centre of mass in the body's frame [m].
    inertia : float
        About its own centre of mass, zero or more [kg m^2].

    """

    CHECKS = {'body': name, 'mass': not_negative, 'position': vector2, 'inertia': not_negative}

    body: str
    mass: float
    position: Vector2 = (0.0, 0.0)
    inertia: float = 0.0

    def change(self, model, machine):
        """Add the mass to the model."""
        row, (x, y) = machine.body(self.body), self.position
        model.body[row, MASS] += self.mass
        model.body[row, MASS_X] += self.mass * x
        model.body[row, MASS_Y] += self.mass * y
        model.body[row, INERTIA] += self.inertia + self.mass * (x * x + y * y)
