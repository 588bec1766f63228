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
Cable that pulls and never pushes, from a point over guides and pulleys to another point.

    T = k s max(0, 1 + c l')       s = l - l0 > 0, else the cable is slack: T = 0

with l its length: straight pieces, tangent to pulleys that have a radius, and what lies on these.
It slides over guides and pulleys without friction, or turns them without inertia: one tension
throughout, "capstan-free". In space it goes over guides without a radius.

It stores k s^2 / 2. The damping grows with the stretch, so that the
tension does not jump where the cable becomes taut.

A pulley is wound by -90 to 270 degrees; one that the cable would leave is not left: it goes on
along the tangents. When: hoists, tackles, cable drives, tendons.

"""

from dataclasses import dataclass
import math
from typing import Optional, Tuple

from .effect import Effect, require_plane, require_point
from .forces import distance_in_space, place, push_at, push_there, velocity
from .table import (
    CABLE, DATA, DISSIPATED, ENTRIES, ForceElement, SPATIAL_CABLE, STATE, State, STORED)
from ..core.compiled import inlined
from ..mechanism.checks import list_of, name, not_negative, number, positive
from ..mechanism.fields import at, FieldError

# Numbers of an entry: row of a point's body, place in its frame [m], radius of the pulley [m];
# in space a place of three numbers and no radius.
COLUMNS = 4


@dataclass(frozen=True)
class Cable(Effect):
    """
    Cable that pulls and never pushes, from a point over guides and pulleys to another point.

    Attributes
    ----------
    points : tuple of str
        Named points, two or more: its ends, and the guides or centres of pulleys between them.
    stiffness : float
        k, positive [N/m].
    free_length : float
        l0, zero or more [m].
    damping : float
        c, zero or more [s/m].
    radii : tuple of floats or None
        One for each point, zero for the ends: of the pulleys [m]; positive where the cable turns
        to the left around them, negative where to the right. Guides without radius when not
        given. In the plane.

    """

    CHECKS = {'points': list_of(name), 'stiffness': positive, 'free_length': not_negative,
              'damping': not_negative, 'radii': list_of(number)}
    READINGS = ('tension', 'length')

    points: Tuple[str, ...]
    stiffness: float
    free_length: float
    damping: float = 0.0
    radii: Optional[Tuple[float, ...]] = None

    def __post_init__(self):
        """Refuse what has no two ends, and pulleys that are too few, too many or at an end."""
        super().__post_init__()
        if len(self.points) < 2:
            raise FieldError('two points or more', f'{len(self.points)}', path=('points',))
        if self.radii is not None:
            if len(self.radii) != len(self.points):
                raise FieldError(f'{len(self.points)} radii, one for each point',
                                 f'{len(self.radii)}', path=('radii',))
            for end in (0, len(self.radii) - 1):
                if self.radii[end] != 0.0:
                    raise FieldError('zero at the ends of the cable', f'{self.radii[end]:g}',
                                     path=('radii', end))

    def fit(self, mechanism):
        """Refuse a mechanism without the points, and pulleys with a radius in space."""
        if self.radii is not None and any(self.radii):
            require_plane(mechanism, 'radii')
        for index, point in enumerate(self.points):
            with at('points'):
                require_point(mechanism, index, point)

    def element(self, machine):
        """Return the effect as a row of the table."""
        entries = []
        for point, radius in zip(self.points, self.radii or (0.0,) * len(self.points)):
            row, spot = machine.point(point)
            entries.append((float(row), *spot, radius)[:COLUMNS])
        kind = CABLE if machine.mechanism.planar else SPATIAL_CABLE
        return ForceElement(kind, (), (self.stiffness, self.free_length, self.damping),
                            (State(DISSIPATED),), data=tuple(entries))


@inlined
def _straight(body, data, at):
    """Return direction, length and its rate of the piece from one point to the next."""
    a, b = int(data[at]), int(data[at + COLUMNS])
    px, py = place(body, a, data[at + 1], data[at + 2])
    x, y = place(body, b, data[at + COLUMNS + 1], data[at + COLUMNS + 2])
    vx, vy = velocity(body, b, x, y)
    ux, uy = velocity(body, a, px, py)
    x -= px
    y -= py
    # From centre to centre the way goes along the tangent, and across by what the radii differ.
    between, across = x * x + y * y, data[at + COLUMNS + 3] - data[at + 3]
    length, rate = math.sqrt(max(0.0, between - across * across)), 0.0
    if between > 0.0:
        x, y = (length * x + across * y) / between, (length * y - across * x) / between
        rate = x * (vx - ux) + y * (vy - uy)
    return x, y, length, rate


@inlined
def _wrapped(radius, x, y, next_x, next_y):
    """Return how much cable lies on a pulley between two directions [m]."""
    turn = math.copysign(1.0, radius) * math.atan2(
        x * next_y - y * next_x, x * next_x + y * next_y)
    if turn < -0.5 * math.pi:
        turn += 2.0 * math.pi
    return abs(radius) * turn


@inlined
def _tension(table, row, length, rate):
    """Return the tension at a length and its rate, and note it."""
    values = table.values
    stretch = length - values[row, 1]
    elastic = values[row, 0] * max(0.0, stretch)
    tension = elastic * max(0.0, 1.0 + values[row, 2] * rate)
    table.rates[table.index[row, STATE]] = (tension - elastic) * rate
    table.output[row, STORED] = 0.5 * elastic * max(0.0, stretch)
    table.output[row, 1] = tension
    table.output[row, 2] = length
    return tension


@inlined
def apply(table, row, body):
    """Apply the forces; see ``dispatch.apply``."""
    data, first = table.data, table.index[row, DATA]
    pieces = table.index[row, ENTRIES] - 1
    length, rate, before_x, before_y = 0.0, 0.0, 0.0, 0.0
    for k in range(pieces):
        at = first + COLUMNS * k
        x, y, part, growth = _straight(body, data, at)
        length += part
        rate += growth
        if k > 0 and data[at + 3] != 0.0:
            length += _wrapped(data[at + 3], before_x, before_y, x, y)
        before_x, before_y = x, y
    tension = _tension(table, row, length, rate)
    if tension > 0.0:
        for k in range(pieces):
            at = first + COLUMNS * k
            x, y, part, growth = _straight(body, data, at)
            for end in range(2):
                point, force = at + COLUMNS * end, tension * (1.0 - 2.0 * end)
                i = int(data[point])
                px, py = place(body, i, data[point + 1], data[point + 2])
                push_at(body, i, px, py, force * x, force * y)


@inlined
def _straight_in_space(body, data, at):
    """Return both ends, direction, length and its rate of a piece in space."""
    a, b = int(data[at]), int(data[at + COLUMNS])
    return distance_in_space(
        body, a, data[at + 1], data[at + 2], data[at + 3],
        b, data[at + COLUMNS + 1], data[at + COLUMNS + 2], data[at + COLUMNS + 3])


@inlined
def apply_in_space(table, row, body):
    """Apply the forces in space; see ``dispatch.apply``."""
    data, first = table.data, table.index[row, DATA]
    pieces = table.index[row, ENTRIES] - 1
    length, rate = 0.0, 0.0
    for k in range(pieces):
        px, py, pz, bx, by, bz, x, y, z, part, growth = _straight_in_space(
            body, data, first + COLUMNS * k)
        length += part
        rate += growth
    tension = _tension(table, row, length, rate)
    if tension > 0.0:
        for k in range(pieces):
            at = first + COLUMNS * k
            px, py, pz, bx, by, bz, x, y, z, part, growth = _straight_in_space(body, data, at)
            push_there(body, int(data[at]), px, py, pz, tension * x, tension * y, tension * z)
            push_there(body, int(data[at + COLUMNS]), bx, by, bz,
                       -tension * x, -tension * y, -tension * z)
