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
A force on a named point and a torque on its body, constant until they are changed.

    F at ``point``, T        work done on the mechanism: the integral of F . v + T . omega

Constant in world axes, or in those of the point's body, which turn with it. When: a load, a push,
a thruster, what a force sensor elsewhere measures (change ``force`` while it runs, from Python or
from a topic).

"""

from dataclasses import dataclass
from typing import Union

from .effect import Effect
from .forces import BODY, offset, push, push_in_space, turned, twist, velocity_in_space, WORLD
from .law import law
from .table import EXTERNAL_FORCE, FIRST, ForceElement, SPATIAL_FORCE, STATE, State, WORK
from ..core.codegen.space import SPIN
from ..core.types import FZ, OMEGA, VX, VY
from ..mechanism.checks import name, number, one_of, one_or_several, vector, vector3
from ..mechanism.fields import at
from ..mechanism.mechanism import Vector, Vector3


@dataclass(frozen=True)
class ExternalForce(Effect):
    """
    A force on a named point and a torque on its body.

    Attributes
    ----------
    point : str
    force : tuple of 2 floats, or 3 in space
        [N].
    torque : float, or tuple of 3 floats in space
        [N m].
    axes : str
        ``'world'``, or ``'body'`` for those of the point's body.

    """

    CHECKS = {'point': name, 'force': vector, 'torque': one_or_several(number, vector3),
              'axes': one_of((WORLD, BODY))}
    VECTORS = ('force',)
    # Constant between changes, which may come a thousand times a second.
    STIFFENS = False
    READINGS = ('power',)

    point: str
    force: Vector = (0.0, 0.0)
    torque: Union[float, Vector3] = 0.0
    axes: str = WORLD

    def fit(self, mechanism):
        """Refuse a torque of the plane in space, and one of space in the plane."""
        super().fit(mechanism)
        with at('torque'):
            if mechanism.planar:
                number(self.torque)
            elif self.torque != 0.0:
                vector3(self.torque)

    def element(self, machine):
        """Return the effect as a row of the table."""
        row, place = machine.point(self.point)
        force, torque, turns = machine.vector(self.force), self.torque, float(self.axes == BODY)
        states = (State(WORK),)
        if machine.mechanism.planar:
            return ForceElement(EXTERNAL_FORCE, (row,), (*place, *force, torque, turns), states)
        torque = torque or (0.0, 0.0, 0.0)
        if turns:
            axes = machine.placement(machine.carrier(self.point)).axes
            force, torque = axes @ force, axes @ torque
        return ForceElement(SPATIAL_FORCE, (row,), (*place, *force, *torque, turns), states)


@law
def apply(table, row, body, q, qd, tau):
    """Apply force and torque; see ``dispatch.apply``."""
    values, i = table.values, table.index[row, FIRST]
    rx, ry = offset(body, i, values[row, 0], values[row, 1])
    fx, fy, torque = values[row, 2], values[row, 3], values[row, 4]
    if values[row, 5] > 0.0:
        fx, fy = offset(body, i, fx, fy)
    push(body, i, rx, ry, fx, fy)
    power = (fx * (body[i, VX] - body[i, OMEGA] * ry) + fy * (body[i, VY] + body[i, OMEGA] * rx))
    if torque != 0.0:
        body[i, FZ] -= torque
        power += torque * body[i, OMEGA]
    table.rates[table.index[row, STATE]] = power
    table.output[row, 1] = power


@law
def apply_in_space(table, row, body, q, qd, tau):
    """Apply force and torque in space; see ``dispatch.apply``."""
    values, i = table.values, table.index[row, FIRST]
    rx, ry, rz = turned(body, i, values[row, 0], values[row, 1], values[row, 2])
    fx, fy, fz = values[row, 3], values[row, 4], values[row, 5]
    tx, ty, tz = values[row, 6], values[row, 7], values[row, 8]
    if values[row, 9] > 0.0:
        fx, fy, fz = turned(body, i, fx, fy, fz)
        tx, ty, tz = turned(body, i, tx, ty, tz)
    push_in_space(body, i, rx, ry, rz, fx, fy, fz)
    twist(body, i, tx, ty, tz)
    vx, vy, vz = velocity_in_space(body, i, rx, ry, rz)
    power = (fx * vx + fy * vy + fz * vz + tx * body[i, SPIN] + ty * body[i, SPIN + 1]
             + tz * body[i, SPIN + 2])
    table.rates[table.index[row, STATE]] = power
    table.output[row, 1] = power
