# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

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
from typing import Optional, Tuple

from .effect import Effect, require_point
from .table import CABLE, DISSIPATED, ForceElement, SPATIAL_CABLE, State
from ..mechanism.checks import direction, list_of, name, not_negative, number, positive
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import Vector3

# Numbers of an entry: row of a point's body, place in its frame [m], radius of the pulley [m], and
# how much cable lies on it at the latest evaluation [m]; in space one more.
COLUMNS, SPATIAL_COLUMNS = 5, 6
# Columns of EffectTable.values in space: row of the body of the pulleys' axis, less than zero
# where there are guides alone; the axis in the frame of that row.
CARRIER, AXIS = 3, 4
# A start is reported where the stretch, by the free length, is larger than wire ropes work at,
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
        """Refuse cables without two ends, and pulleys that are too few, too many or at an end."""
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

    def winding_places(self, columns):
        """Return the places, among its entries, of the turns round pulleys with a radius."""
        return {point: columns * (index + 1) - 1 for index, (point, radius) in enumerate(zip(
            self.points, self.radii or ())) if radius}

    def start_notes(self, name, readings, weight):
        """Return a note of a stretch beyond that of ropes, under forces beyond all weight."""
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
