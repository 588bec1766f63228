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
throughout, "capstan-free".

In space all pulleys lie across one axis n, which is fixed in the body of the first of them. A
straight piece leaves a pulley where it is tangent as seen along the axis. Its angle to the
pulley's plane is the fleet angle. A piece from centre to centre d, which is h along the axis and p
across it with |p|^2 = a^2 + (r_b - r_a)^2, has the length L = sqrt(a^2 + h^2). With the tangent t
as seen along the axis, piece and arcs grow by f . d', where d' is seen from the body of the axis
and

    f = t + (a / L - 1) p / a + (h / L) n

The force T f pulls at both centres, and the moment T sum(d x f) turns the body of the axis. In the
plane of the pulleys f = t, and there is no such moment.

It stores k s^2 / 2. The damping grows with the stretch, so that the
tension does not jump where the cable becomes taut.

A pulley is wound by -90 to 270 degrees; one that the cable would leave is not left: it goes on
along the tangents. When: hoists, tackles, cable drives, tendons.

"""

from dataclasses import dataclass
import math
from typing import Optional, Tuple

from .effect import Effect, require_point
from .forces import (
    cross, distance_in_space, dot, in_contact, place, place_in_space, push_at, push_there, turned,
    twist, velocity, velocity_at)
from .law import law
from .table import (
    CABLE, DATA, DISSIPATED, ENTRIES, ForceElement, SPATIAL_CABLE, STATE, State, STORED)
from ..core.codegen.space import SPIN
from ..core.compiled import compiled, inlined
from ..mechanism.checks import direction, list_of, name, not_negative, number, positive
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import Vector3

# Numbers of an entry: row of a point's body, place in its frame [m], radius of the pulley [m], and
# how much cable lies on it at the latest evaluation [m]; in space one more.
COLUMNS, SPATIAL_COLUMNS = 5, 6
# Columns of EffectTable.values in space: row of the body of the pulleys' axis, less than zero
# where there are guides alone; the axis in the frame of that row.
CARRIER, AXIS = 3, 4
# A start is told where the stretch is a larger share of the free length than wire ropes work at,
# and the tension more than so many times the weight of all bodies.
LARGE_STRETCH, LARGE_TENSION = 0.005, 10.0


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
        given.
    axis : tuple of 3 floats or None
        In space, of pulleys with a radius: about which to the left is counter-clockwise, in the
        frame of the body of the first of them; of unit length here.

    """

    CHECKS = {'points': list_of(name), 'stiffness': positive, 'free_length': not_negative,
              'damping': not_negative, 'radii': list_of(number), 'axis': direction}
    READINGS = ('tension', 'length')

    points: Tuple[str, ...]
    stiffness: float
    free_length: float
    damping: float = 0.0
    radii: Optional[Tuple[float, ...]] = None
    axis: Optional[Vector3] = None

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
        if self.axis is not None:
            if not any(self.radii or ()):
                raise FieldError('no axis of a cable without a pulley that has a radius',
                                 shown(self.axis), path=('axis',))
            object.__setattr__(self, 'READINGS', (*type(self).READINGS, 'fleet_angle'))

    def fit(self, mechanism):
        """Refuse a mechanism without the points, and pulleys without an axis in space."""
        if mechanism.planar and self.axis is not None:
            raise FieldError('no axis in the plane, which every pulley lies in', shown(self.axis),
                             path=('axis',))
        if not mechanism.planar and self.axis is None and any(self.radii or ()):
            raise FieldError('the axis of pulleys that have a radius', 'none', path=('axis',))
        for index, point in enumerate(self.points):
            with at('points'):
                require_point(mechanism, index, point)

    def windings(self, entries):
        """Return the turns round pulleys that have a radius, from -pi/2 to 3 pi/2."""
        return {point: float(entry[-1] / abs(radius)) for point, radius, entry in zip(
            self.points, self.radii or (), entries.reshape(len(self.points), -1)) if radius}

    def start_notes(self, name, readings, weight):
        """Tell of a stretch that few cables bear, by forces that no weight explains."""
        found = readings()
        stretch = found['length'] - self.free_length
        if not (stretch > LARGE_STRETCH * self.free_length
                and found['tension'] > LARGE_TENSION * weight):
            return []
        return [f'The cable {name} starts {found["length"]:.6g} m long, stretched by '
                f'{stretch:.3g} m, and pulls with {found["tension"]:.3g} N; all bodies together '
                f'weigh {weight:.3g} N. Check free_length ({self.free_length:g} m), and the '
                'signs of radii: positive where the cable turns to the left.']

    def element(self, machine):
        """Return the effect as a row of the table."""
        entries, radii = [], self.radii or (0.0,) * len(self.points)
        for point, radius in zip(self.points, radii):
            row, spot = machine.point(point)
            entries.append((float(row), *spot, radius, 0.0))
        values = [self.stiffness, self.free_length, self.damping]
        if machine.mechanism.planar:
            return ForceElement(CABLE, (), tuple(values), (State(DISSIPATED),), touches=True,
                                data=tuple(entries))
        values.append(-1.0)
        if self.axis is not None:
            placed = machine.placement(machine.carrier(next(
                point for point, radius in zip(self.points, radii) if radius)))
            values[CARRIER:] = [float(placed.row), *(placed.axes @ self.axis).tolist()]
        return ForceElement(SPATIAL_CABLE, (), tuple(values), (State(DISSIPATED),), touches=True,
                            data=tuple(entries))


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
    if not in_contact(table.contacts, row, -stretch, -rate):
        stretch = 0.0
    elastic = values[row, 0] * stretch
    tension = elastic * max(0.0, 1.0 + values[row, 2] * rate)
    table.rates[table.index[row, STATE]] = (tension - elastic) * rate
    table.output[row, STORED] = 0.5 * elastic * stretch
    table.output[row, 1] = tension
    table.output[row, 2] = length
    return tension


@law
def apply(table, row, body, q, qd, tau):
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
            data[at + 4] = _wrapped(data[at + 3], before_x, before_y, x, y)
            length += data[at + 4]
        before_x, before_y = x, y
    tension = _tension(table, row, length, rate)
    if tension != 0.0:
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
    b = at + SPATIAL_COLUMNS
    return distance_in_space(
        body, int(data[at]), data[at + 1], data[at + 2], data[at + 3],
        int(data[b]), data[b + 1], data[b + 2], data[b + 3])


@law
def apply_in_space(table, row, body, q, qd, tau):
    """Apply the forces in space; see ``dispatch.apply``."""
    if table.values[row, CARRIER] >= 0.0:
        _apply_over_pulleys(table, row, body)
    else:
        _apply_over_guides(table, row, body)


@inlined
def _apply_over_guides(table, row, body):
    """Apply the forces in space where no pulley has a radius."""
    data, first = table.data, table.index[row, DATA]
    pieces = table.index[row, ENTRIES] - 1
    length, rate = 0.0, 0.0
    for k in range(pieces):
        px, py, pz, bx, by, bz, x, y, z, part, growth = _straight_in_space(
            body, data, first + SPATIAL_COLUMNS * k)
        length += part
        rate += growth
    tension = _tension(table, row, length, rate)
    if tension != 0.0:
        for k in range(pieces):
            at = first + SPATIAL_COLUMNS * k
            px, py, pz, bx, by, bz, x, y, z, part, growth = _straight_in_space(body, data, at)
            push_there(body, int(data[at]), px, py, pz, tension * x, tension * y, tension * z)
            push_there(body, int(data[at + SPATIAL_COLUMNS]), bx, by, bz,
                       -tension * x, -tension * y, -tension * z)


@inlined
def _tangent_in_space(body, data, at, axis):
    """Return both centres, the tangent and f, see above, a, h, and L of a piece."""
    b = at + SPATIAL_COLUMNS
    p = place_in_space(body, int(data[at]), data[at + 1], data[at + 2], data[at + 3])
    q = place_in_space(body, int(data[b]), data[b + 1], data[b + 2], data[b + 3])
    x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    high = dot((x, y, z), axis)
    x, y, z = x - high * axis[0], y - high * axis[1], z - high * axis[2]
    between, across = x * x + y * y + z * z, data[b + 4] - data[at + 4]
    seen = math.sqrt(max(0.0, between - across * across))
    whole = math.sqrt(seen * seen + high * high)
    tangent, force = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if between > 0.0 and seen > 0.0:
        u, v, w = cross((x, y, z), axis)
        tangent = ((seen * x + across * u) / between, (seen * y + across * v) / between,
                   (seen * z + across * w) / between)
        # (a / L - 1) / a without a difference.
        less, up = high * high / (whole * seen * (whole + seen)), high / whole
        force = (tangent[0] - less * x + up * axis[0], tangent[1] - less * y + up * axis[1],
                 tangent[2] - less * z + up * axis[2])
    return p, q, tangent, force, seen, high, whole


@compiled
def _apply_over_pulleys(table, row, body):
    """Apply the forces in space where pulleys have a radius."""
    data, first, values = table.data, table.index[row, DATA], table.values
    pieces, carrier = table.index[row, ENTRIES] - 1, int(values[row, CARRIER])
    axis = turned(body, carrier, values[row, AXIS], values[row, AXIS + 1], values[row, AXIS + 2])
    spin = body[carrier, SPIN], body[carrier, SPIN + 1], body[carrier, SPIN + 2]
    length, rate, fleet, before = 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)
    for k in range(pieces):
        at = first + SPATIAL_COLUMNS * k
        p, q, tangent, force, seen, high, whole = _tangent_in_space(body, data, at, axis)
        ux, uy, uz = velocity_at(body, int(data[at]), p[0], p[1], p[2])
        vx, vy, vz = velocity_at(body, int(data[at + SPATIAL_COLUMNS]), q[0], q[1], q[2])
        length += whole
        rate += dot(force, (vx - ux, vy - uy, vz - uz)) - dot(spin, cross(
            (q[0] - p[0], q[1] - p[1], q[2] - p[2]), force))
        fleet = max(fleet, math.atan2(abs(high), seen))
        if k > 0 and data[at + 4] != 0.0:
            # Seen along the axis: the turn from one tangent to the next.
            data[at + 5] = _wrapped(data[at + 4], 1.0, 0.0, dot(before, tangent),
                                    dot(cross(before, tangent), axis))
            length += data[at + 5]
        before = tangent
    tension = _tension(table, row, length, rate)
    table.output[row, 3] = fleet
    if tension != 0.0:
        for k in range(pieces):
            at = first + SPATIAL_COLUMNS * k
            p, q, tangent, force, seen, high, whole = _tangent_in_space(body, data, at, axis)
            x, y, z = tension * force[0], tension * force[1], tension * force[2]
            push_there(body, int(data[at]), p[0], p[1], p[2], x, y, z)
            push_there(body, int(data[at + SPATIAL_COLUMNS]), q[0], q[1], q[2], -x, -y, -z)
            x, y, z = cross((q[0] - p[0], q[1] - p[1], q[2] - p[2]), (x, y, z))
            twist(body, carrier, x, y, z)
