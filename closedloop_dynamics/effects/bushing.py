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
Bushing: springs and dampers along two axes and about the third, between points of two bodies.

    F = -K d - C d'                d: from point a to point b, in axes that turn with body a
    M = -k phi - c omega           phi = alpha_b - alpha_a - rest_angle

act on body b at its point, and the opposite on body a, there, too. They store
d K d / 2 + k phi^2 / 2. When: rubber mounts, flexible couplings, a joint with play in stiffness,
a weld that gives.

"""

from dataclasses import dataclass
import math
from typing import Optional

from .effect import Effect, require_plane
from .forces import place, push_at, velocity
from .table import (
    BUSHING, DATA, DISSIPATED, FIRST, ForceElement, SECOND, STATE, State, STORED)
from ..core.compiled import inlined
from ..core.types import ALPHA, COS, FZ, OMEGA, SIN
from ..mechanism.checks import list_of, name, not_negative, number, numbers, vector2
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import Vector2


def _not_negative2(value):
    """Return two floats of which none is less than zero."""
    return list_of(not_negative)(numbers(value, 2, 'a list of 2 numbers that are zero or more'))


@dataclass(frozen=True)
class Bushing(Effect):
    """
    Springs and dampers along two axes and about the third, between points of two bodies.

    Attributes
    ----------
    point_a : str
        A named point.
    point_b : str or None
        The other one; None where ``anchor`` is given.
    anchor : tuple of 2 floats or None
        In its place a place in the world [m].
    stiffness : tuple of 2 floats
        Along the axes, zero or more [N/m].
    damping : tuple of 2 floats
        Along the axes, zero or more [N s/m].
    turning_stiffness : float
        k, zero or more [N m/rad].
    turning_damping : float
        c, zero or more [N m s/rad].
    angle : float
        Of the first axis in the frame of point a's body [rad].
    rest_angle : float
        Of body b relative to body a where there is no moment [rad].

    """

    CHECKS = {'point_a': name, 'point_b': name, 'anchor': vector2, 'stiffness': _not_negative2,
              'damping': _not_negative2, 'turning_stiffness': not_negative,
              'turning_damping': not_negative, 'angle': number, 'rest_angle': number}
    READINGS = ('force_1', 'force_2', 'moment')

    point_a: str
    point_b: Optional[str] = None
    anchor: Optional[Vector2] = None
    stiffness: Vector2 = (0.0, 0.0)
    damping: Vector2 = (0.0, 0.0)
    turning_stiffness: float = 0.0
    turning_damping: float = 0.0
    angle: float = 0.0
    rest_angle: float = 0.0

    def __post_init__(self):
        """Refuse one with no end or three."""
        super().__post_init__()
        if (self.point_b is None) == (self.anchor is None):
            raise FieldError('either point_b or anchor', 'both' if self.anchor else 'neither',
                             path=('point_b',))

    def fit(self, mechanism):
        """Refuse a mechanism without the points, and one in space."""
        super().fit(mechanism)
        require_plane(mechanism, 'point_a')

    def element(self, machine):
        """Return the effect as a row of the table."""
        row_a, place_a = machine.point(self.point_a)
        row_b, place_b = machine.point(self.point_b) if self.point_b else (0, self.anchor)
        return ForceElement(
            BUSHING, (row_a, row_b), (self.turning_stiffness, self.turning_damping,
                                      self.rest_angle, math.cos(self.angle), math.sin(self.angle)),
            (State(DISSIPATED),), data=((*place_a, *place_b, *self.stiffness, *self.damping),))


@inlined
def apply(table, row, body):
    """Apply the forces; see ``dispatch.apply``."""
    values, data, at = table.values, table.data, table.index[row, DATA]
    a, b = table.index[row, FIRST], table.index[row, SECOND]
    px, py = place(body, a, data[at], data[at + 1])
    x, y = place(body, b, data[at + 2], data[at + 3])
    # The first axis (cx, cy), the second (-cy, cx).
    cx = body[a, COS] * values[row, 3] - body[a, SIN] * values[row, 4]
    cy = body[a, SIN] * values[row, 3] + body[a, COS] * values[row, 4]
    vx, vy = velocity(body, b, x, y)
    # What of body a would be at point b: so the axes' turning is seen.
    ux, uy = velocity(body, a, x, y)
    dx, dy, wx, wy = x - px, y - py, vx - ux, vy - uy
    along, across = cx * dx + cy * dy, cx * dy - cy * dx
    rate_1, rate_2 = cx * wx + cy * wy, cx * wy - cy * wx
    turn = body[b, ALPHA] - body[a, ALPHA] - values[row, 2]
    spin = body[b, OMEGA] - body[a, OMEGA]
    force_1 = -data[at + 4] * along - data[at + 6] * rate_1
    force_2 = -data[at + 5] * across - data[at + 7] * rate_2
    moment = -values[row, 0] * turn - values[row, 1] * spin
    fx, fy = cx * force_1 - cy * force_2, cy * force_1 + cx * force_2
    push_at(body, b, x, y, fx, fy)
    push_at(body, a, x, y, -fx, -fy)
    body[b, FZ] -= moment
    body[a, FZ] += moment
    table.rates[table.index[row, STATE]] = (
        data[at + 6] * rate_1 * rate_1 + data[at + 7] * rate_2 * rate_2
        + values[row, 1] * spin * spin)
    table.output[row, STORED] = 0.5 * (
        data[at + 4] * along * along + data[at + 5] * across * across
        + values[row, 0] * turn * turn)
    table.output[row, 1] = force_1
    table.output[row, 2] = force_2
    table.output[row, 3] = moment
