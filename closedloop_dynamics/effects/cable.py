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
import math
from typing import Optional, Tuple

import numpy as np

from .effect import Effect, require_point
from .element import DISSIPATED, ForceElement, State
from .force_law import BOUNDARY, force_law
from ..codegen.expression_graph import arctangent, chosen, larger, square_root
from ..codegen.vectors import add, cross, dot, IDENTITY, scale, subtract, ZERO
from ..mechanism.checks import direction, list_of, name, not_negative, number, positive
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import Vector3

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
        radii = self.radii or (0.0,) * len(self.points)
        bodies, places = zip(*map(machine.point, self.points))
        law, values = cable_in_plane, [self.stiffness, self.free_length, self.damping]
        if self.axis is not None:
            placed = machine.placement(machine.carrier(next(
                point for point, radius in zip(self.points, radii) if radius)))
            law, bodies = cable_across_axis, (*bodies, placed.row)
            values += (placed.axes @ self.axis).tolist()
        # Of each point its place in the frame of its body, the radius of the pulley, and how much
        # cable lies on it at the latest evaluation [m].
        return ForceElement(
            law, bodies=bodies, values=tuple(values), states=(State(DISSIPATED),), gap=BOUNDARY,
            data=tuple((*place, radius, 0.0) for place, radius in zip(places, radii)))


def _signs(row):
    """Return to which side the cable turns at each point."""
    return tuple(np.sign(row.data.reshape(row.count, -1)[:, -2]).tolist())


CABLE = {'terms': _signs, 'in_lanes': False, 'engine_only': 'it slackens, and winds round pulleys'}


@force_law(**CABLE)
def cable_in_plane(forces):
    """Apply a cable whose points and pulleys lie in one plane, or one without pulleys in space."""
    _apply(forces, forces.bodies)


@force_law(**CABLE)
def cable_across_axis(forces):
    *bodies, carrier = forces.bodies
    _apply(forces, bodies, forces.turned(carrier, forces.values[3:6]), carrier)


class _Piece:
    """
    A straight piece between points, or centers of pulleys (doc/theory.md).

    ``way``, ``tangent``: along the piece as seen along the axis, the one of any length; ``force``:
    gradient of the length; ``apart``: from end to end; ``length``, ``rate``; ``fleet``: angle.
    """

    def __init__(self, forces, ends, across, axis, carrier):
        (_, start, slow), (_, end, fast) = ends
        self.apart = apart = subtract(end, start)
        high = 0.0 if carrier is None else dot(apart, axis)
        apart = subtract(apart, scale(axis, high))
        # From center to center the way goes along the tangent, and across by what radii differ.
        between = dot(apart, apart)
        seen = square_root(larger(0.0, between - across * across))
        self.way = add(scale(apart, seen), scale(cross(apart, axis), across))
        self.force = tangent = scale(self.way, 1.0 / chosen(between > 0.0, between, 1.0))
        self.length, self.fleet, turning = seen, 0.0, 0.0
        if carrier is not None:
            self.length = length = square_root(seen * seen + high * high)
            # (a / L - 1) / a without a difference.
            less = high * high / chosen(seen > 0.0, length * seen * (length + seen), 1.0)
            rise = high / chosen(length > 0.0, length, 1.0)
            bent = add(subtract(tangent, scale(apart, less)), scale(axis, rise))
            self.force = tuple(
                chosen(seen > 0.0, *both) for both in zip(bent, tangent))
            self.fleet = arctangent(abs(high), seen)
            turning = dot(forces.spin(carrier), cross(self.apart, self.force))
        self.rate = dot(self.force, subtract(fast, slow)) - turning


def _apply(forces, bodies, axis=IDENTITY[2], carrier=None):
    """Apply a cable whose pulleys lie across an axis, which turns with a body, the carrier."""
    width, (stiffness, free, damping) = forces.size + 2, forces.values[:3]
    numbers = [forces.entries(width * k, width) for k in range(len(bodies))]
    signs = forces.terms or len(bodies) * (None,)
    radii = [0.0 if sign == 0.0 else one[-2] for one, sign in zip(numbers, signs)]
    offsets = [forces.turned(body, one[:-2]) for body, one in zip(bodies, numbers)]
    ends = [(offset, *forces.place(body, offset)) for body, offset in zip(bodies, offsets)]
    pieces = [_Piece(forces, pair, after - before, axis, carrier) for pair, before, after in zip(
        zip(ends, ends[1:]), radii, radii[1:])]
    length, wound = sum(piece.length for piece in pieces), 0.0
    for k, (before, after) in enumerate(zip(pieces, pieces[1:]), 1):
        if signs[k] != 0.0:
            turn = dot(cross(before.way, after.way), axis)
            turn = chosen(radii[k] < 0.0 if signs[k] is None else signs[k] < 0.0, -turn, turn)
            # A quarter turn from -180 to 180 degrees: -90 to 270.
            length = length + abs(radii[k]) * (0.25 * math.tau)
            more = abs(radii[k]) * arctangent(-dot(before.way, after.way), turn)
            wound = wound + more
            forces.keep_entry(width * (k + 1) - 1, abs(radii[k]) * (0.25 * math.tau) + more)
    rate = sum(piece.rate for piece in pieces)
    stretch = forces.pressed(length - free + wound, rate)
    elastic = stiffness * stretch
    tension = elastic * larger(0.0, 1.0 + damping * rate)
    forces.store(0.5 * elastic * stretch)
    forces.flow((tension - elastic) * rate)
    fleet = 0.0
    for k, piece in enumerate(pieces):
        pull = scale(piece.force, tension)
        forces.push(bodies[k], offsets[k], pull)
        forces.push(bodies[k + 1], offsets[k + 1], scale(pull, -1.0))
        if carrier is not None:
            forces.push(carrier, ZERO, ZERO, cross(piece.apart, pull))
            fleet = larger(fleet, piece.fleet)
    forces.read(tension, length + wound, fleet)
