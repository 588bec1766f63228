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
A force on a named point, constant in world axes until it is changed.

    F at ``point``        work done on the mechanism: the integral of F . v

When: a load, a push, what a force sensor elsewhere measures (change ``force`` while it runs,
from Python or from a topic).

"""

from dataclasses import dataclass

from .effect import Effect
from .forces import offset, push
from .table import EXTERNAL_FORCE, FIRST, ForceElement, STATE, State, WORK
from ..core.compiled import inlined
from ..core.types import OMEGA, VX, VY
from ..mechanism.checks import name, vector2
from ..mechanism.mechanism import Vector2


@dataclass(frozen=True)
class ExternalForce(Effect):
    """
    A force on a named point.

    Attributes
    ----------
    point : str
    force : tuple of 2 floats
        World axes [N].

    """

    CHECKS = {'point': name, 'force': vector2}
    # Constant between changes, which may come a thousand times a second.
    STIFFENS = False
    READINGS = ('power',)

    point: str
    force: Vector2 = (0.0, 0.0)

    def element(self, machine):
        """Return the effect as a row of the table."""
        row, place = machine.point(self.point)
        return ForceElement(EXTERNAL_FORCE, (row,), (*place, *self.force), (State(WORK),))


@inlined
def apply(table, row, body):
    """Apply the force; see ``dispatch.apply``."""
    values, i = table.values, table.index[row, FIRST]
    rx, ry = offset(body, i, values[row, 0], values[row, 1])
    fx, fy = values[row, 2], values[row, 3]
    push(body, i, rx, ry, fx, fy)
    power = (fx * (body[i, VX] - body[i, OMEGA] * ry) + fy * (body[i, VY] + body[i, OMEGA] * rx))
    table.rates[table.index[row, STATE]] = power
    table.output[row, 1] = power
