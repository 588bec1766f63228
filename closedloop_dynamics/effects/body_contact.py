# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Contact of a point or roller of one body with a line, a circle or a curve of another.

In the place of a roller a body may have a flat face, an endless line, on which a curve rests. The
roller is a circle of radius r about a named point (0: the point itself), in space a ball,
which touches a plane, a sphere or a cylinder of the other body. With depth d, by
which it reaches beyond the line or curve, its rate d', and the sliding rate v:

    normal     N = k d^n max(0, 1 + c d')               pushes apart, never pulls
    friction   T = mu N s(v),  s(v) = v / sqrt(v^2 + v_r^2)

act on both bodies where the roller reaches furthest beyond the line or curve: as in ``contact``,
with bodies that both move. It stores k d^(n+1) / (n+1). Friction turns a
roller that is a body of its own. The damping follows from a coefficient of restitution e at an
impact rate w, exactly for a free impact:

    x - ln(1 + x) + e x + ln(1 - e x) = 0,    x = c w

In space friction acts against the sliding velocity, v being its size.

When: cams with followers, Geneva drives, ratchets, rollers, grippers.
"""

from dataclasses import dataclass
import math
from typing import Optional, Tuple

import numpy as np

from . import curve
from .contact_force import contact_force, contact_law, press, sliding
from .effect import Effect, require_point
from .element import DISSIPATED, ForceElement, State
from .force_law import BOUNDARY, OUTLINE, ROUND
from ..codegen import function_table as calls
from ..codegen.expression_graph import chosen, square_root
from ..codegen.vectors import add, dot, scale, subtract
from ..mechanism.checks import (
    boolean, direction, list_of, name, not_negative, number, one_of, positive, text)
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import Vector3
from ..mechanism.rotations import direction as heading

# Shape -> the keys that it needs, and those that it may have.
IN_PLANE = {'line': ((), ('angle',)), 'circle': (('other_radius',), ('hollow',)),
            'curve': ((), ('x', 'y', 'radii', 'polar', 'closed', 'interpolation', 'hollow')),
            'face': ((), ('angle', 'x', 'y', 'radii', 'polar', 'interpolation'))}
IN_SPACE = {'plane': (('normal',), ()), 'sphere': (('other_radius',), ('hollow',)),
            'cylinder': (('other_radius', 'axis'), ('hollow',))}
SHAPES = {**IN_PLANE, **IN_SPACE}
# Entries of one in space: both places, normal or axis, 1 for a plane, 1 for a cylinder.
PLACE_B, DIRECTION, FLAT, OF_CYLINDER = 3, 6, 9, 10
IN_SPACE_NUMBERS = 11
SEARCHED = 'which parts of the outlines touch is searched for'


def damping(restitution, rate):
    """
    Return the damping c with which an impact at a rate has a coefficient of restitution.

    It is more than 0, at most 1; the rate in m/s.
    """
    if restitution == 1.0:
        return 0.0
    # 1 - e x must be positive; the sum falls from x = 0 on, after it has risen.
    low, high = 0.0, 1.0 / restitution
    for _ in range(200):
        x = 0.5 * (low + high)
        if x == low or x == high:
            break
        if x - math.log1p(x) + restitution * x + math.log1p(-restitution * x) > 0.0:
            low = x
        else:
            high = x
    return low / rate


@dataclass(frozen=True)
class BodyContact(Effect):
    """
    Contact of a point or roller of one body with a line, a circle or a curve of another.

    Attributes
    ----------
    point : str
        A named point: the centre of the roller, or on the flat face.
    other : str
        A named point of the other body: on the line or plane, the centre of the circle or
        sphere, on a cylinder's axis, or where the curve's coordinates begin; its axes are those
        of its body.
    shape : str
        ``line``, ``circle`` or ``curve``, or ``face`` for a curve that the flat face of the
        point's body touches; in space ``plane``, ``sphere`` or ``cylinder``.
    stiffness : float
        k, positive [N/m^n].
    radius : float
        r of the roller, zero or more [m]; a face has none.
    angle : float or None
        Of a line, in the other body's axes, or of a face, in those of the point's body [rad];
        free on its left; 0 when not given.
    normal : tuple of 3 floats or None
        Of a plane, towards its free side, in the other body's axes.
    axis : tuple of 3 floats or None
        Of a cylinder, which has no ends, in the other body's axes.
    other_radius : float or None
        Of a circle, sphere or cylinder, positive [m].
    x, y : tuple of floats or None
        Points of a curve [m]; the first one of a closed curve is not repeated.
    radii : tuple of floats or None
        Or its distances from ``other`` at even angles, the first along x [m].
    polar : str or None
        Or an expression for them in the angle ``a`` [rad], such as ``0.04 + 0.01*cos(a)``.
    closed : bool or None
        Whether a curve closes, which it does when not given; an open one is free on its left.
    interpolation : str or None
        Of a curve: ``cubic`` (a spline, when not given) or ``linear``.
    hollow : bool or None
        Whether a circle, sphere, cylinder or closed curve is free inside; an open curve, on its
        right.
    exponent : float
        n, one or more; 1 linear, 1.5 Hertz.
    damping : float or None
        c, zero or more [s/m]; 0 when not given.
    restitution : float or None
        e in the place of damping, more than 0 and at most 1, at
    impact_velocity : float or None
        this rate of impact, positive [m/s].
    friction : float
        mu, zero or more.
    slip_velocity : float
        v_r, positive [m/s].

    """

    CHECKS = {
        'point': name, 'other': name, 'shape': one_of(tuple(SHAPES)), 'stiffness': positive,
        'radius': not_negative, 'angle': number, 'normal': direction,
        'axis': direction, 'other_radius': positive, 'x': list_of(number),
        'y': list_of(number), 'radii': list_of(positive), 'polar': text, 'closed': boolean,
        'interpolation': one_of(('cubic', 'linear')), 'hollow': boolean, 'exponent': positive,
        'damping': not_negative, 'restitution': positive, 'impact_velocity': positive,
        'friction': not_negative, 'slip_velocity': positive}
    FILES = {'file': ('x', 'y')}
    READINGS = ('depth', 'normal_force', 'friction_force', 'slip')

    point: str
    other: str
    shape: str
    stiffness: float
    radius: float = 0.0
    angle: Optional[float] = None
    normal: Optional[Vector3] = None
    axis: Optional[Vector3] = None
    other_radius: Optional[float] = None
    x: Optional[Tuple[float, ...]] = None
    y: Optional[Tuple[float, ...]] = None
    radii: Optional[Tuple[float, ...]] = None
    polar: Optional[str] = None
    closed: Optional[bool] = None
    interpolation: Optional[str] = None
    hollow: Optional[bool] = None
    exponent: float = 1.0
    damping: Optional[float] = None
    restitution: Optional[float] = None
    impact_velocity: Optional[float] = None
    friction: float = 0.0
    slip_velocity: float = 0.01

    def __post_init__(self):
        """Refuse impossible contact parameters, and curves that cross themselves."""
        super().__post_init__()
        if self.exponent < 1.0:
            raise FieldError('a number that is one or more', f'{self.exponent:g}',
                             path=('exponent',))
        if (self.restitution is None) != (self.impact_velocity is None):
            raise FieldError('both restitution and impact_velocity, or neither', 'one of them',
                             path=('restitution',))
        if self.restitution is not None and self.restitution > 1.0:
            raise FieldError('a number that is at most one', f'{self.restitution:g}',
                             path=('restitution',))
        if self.restitution is not None and self.damping is not None:
            raise FieldError('this key or restitution', 'both', path=('damping',))
        self._require_keys()
        if self.shape == 'face' and self.radius:
            raise FieldError('none of a face', f'{self.radius:g}', path=('radius',))
        if self.hollow and self.other_radius and self.radius >= self.other_radius:
            raise FieldError(f'less than the radius around it ({self.other_radius:g})',
                             f'{self.radius:g}', path=('radius',))
        object.__setattr__(self, '_pieces',
                           self._curve() if self.shape in ('curve', 'face') else ())

    @property
    def pieces(self):
        """Pieces of the curve, a tuple of tuples of ``curve.COLUMNS`` floats; of others empty."""
        return self._pieces

    def _require_keys(self):
        """Refuse keys that the shape does not have, and miss those that it needs."""
        required, optional = SHAPES[self.shape]
        for key in required:
            if getattr(self, key) is None:
                raise FieldError(f'this required key of shape: {self.shape}', 'none', path=(key,))
        for key in sorted({key for keys in SHAPES.values() for key in keys[0] + keys[1]}):
            if key not in required + optional and getattr(self, key) is not None:
                raise FieldError(
                    f'this key only with shape: {" or ".join(_shapes_with(key))}',
                    shown(getattr(self, key)), f'remove it, as the shape is {self.shape}', (key,))

    def _curve(self):
        """Return the pieces of the curve."""
        if (self.x is None) != (self.y is None):
            raise FieldError('both x and y', 'one of them', path=('x',))
        given = sum(one is not None for one in (self.x, self.radii, self.polar))
        if given != 1:
            raise FieldError('x and y, or radii, or polar',
                             f'{given} of them' if given else 'none', path=('x',))
        if self.closed is False and self.x is None:
            raise FieldError('true for a curve about a point', 'false', path=('closed',))
        radii = self.radii
        if self.polar is not None:
            with at('polar'):
                radii = curve.radii_of(self.polar)
        x, y = (self.x, self.y) if radii is None else curve.polar(radii)
        return curve.pieces(x, y, self.closed is not False, self.interpolation or 'cubic',
                            bool(self.hollow))

    def fit(self, mechanism):
        """Refuse a mechanism without the points, other shapes than its, and points of one body."""
        super().fit(mechanism)
        shapes = IN_PLANE if mechanism.planar else IN_SPACE
        if self.shape not in shapes:
            raise FieldError(
                f'{" or ".join(shapes)} in {"the plane" if mechanism.planar else "space"}',
                repr(self.shape), path=('shape',))
        require_point(mechanism, 'other', self.other)
        bodies = {point.name: point.body for point in mechanism.points}
        if bodies[self.point] == bodies[self.other]:
            raise FieldError(f'a point of another body than {bodies[self.point]!r}',
                             repr(self.other), path=('other',))

    def element(self, machine):
        """Return the effect as a row of the table."""
        (a, place_a), (b, place_b) = machine.point(self.point), machine.point(self.other)
        loss = self.damping or 0.0
        if self.restitution is not None:
            loss = damping(self.restitution, self.impact_velocity)
        line, side = heading(self.angle or 0.0).tolist(), -1.0 if self.hollow else 1.0
        law, one, other = {
            'line': (roller_on_line, *line), 'face': (face_on_curve, *line),
            'circle': (roller_on_circle, self.other_radius, side),
            'curve': (roller_on_curve, float(self.closed is not False), 0.0),
        }[self.shape] if machine.mechanism.planar else (
            roller_in_space, self.other_radius or 0.0, side)
        places, data = (*place_a, *place_b), self._pieces
        if not machine.mechanism.planar:
            # A sphere has no axis.
            along = machine.placement(machine.carrier(self.other)).axes @ np.array(
                self.normal or self.axis or (0.0, 0.0, 0.0))
            places, data = 4 * (0.0,), ((
                *places, *along.tolist(), float(self.shape == 'plane'),
                float(self.shape == 'cylinder')),)
        gap = OUTLINE if self.shape == 'curve' else (
            ROUND if self.shape in ('circle', 'sphere', 'cylinder') and not self.hollow
            else BOUNDARY)
        return ForceElement(law, bodies=(a, b), values=(
            *places, self.radius, one, self.stiffness, self.exponent, loss, self.friction,
            self.slip_velocity, other), states=(State(DISSIPATED),), gap=gap, data=data)


def _shapes_with(key):
    return [shape for shape, keys in SHAPES.items() if key in keys[0] + keys[1]]


def _velocity(forces, place):
    """Return the velocity of one body at a place in the world as seen from another."""
    return subtract(*(forces.place(body, subtract(place, forces.origin(body)))[1]
                      for body in forces.bodies))


def _push_both(forces, place, force):
    for body, push in zip(forces.bodies, (force, scale(force, -1.0))):
        forces.push(body, subtract(place, forces.origin(body)), push)


def _press_in_plane(forces, center, out, distance):
    """
    Press two bodies apart, in the plane.

    ``center``: of the roller; ``out``: the normal, towards that; ``distance``: of the center from
    the line or curve, less than zero beyond it [m].
    """
    radius = forces.values[4]
    place = subtract(center, scale(out, radius))
    velocity = _velocity(forces, place)
    rate, slip = -dot(out, velocity), out[1] * velocity[0] - out[0] * velocity[1]
    normal, along = press(forces, distance - radius, rate, slip)
    _push_both(forces, place, (
        normal * out[0] + along * out[1], normal * out[1] - along * out[0], 0.0))


def _centers(forces):
    """Return the center of the roller, and from the named point of the other body to it."""
    (a, b), values = forces.bodies, forces.values
    center, _ = forces.place(a, forces.turned(a, values[:2]))
    return center, subtract(center, forces.place(b, forces.turned(b, values[2:4]))[0])


@contact_law(engine_only=SEARCHED)
def roller_on_line(forces):
    center, apart = _centers(forces)
    line = forces.turned(forces.bodies[1], (forces.values[5], forces.values[11]))
    _press_in_plane(forces, center, (-line[1], line[0], 0.0),
                    line[0] * apart[1] - line[1] * apart[0])


def _speed_apart(forces, center):
    velocity = _velocity(forces, center)
    return square_root(dot(velocity, velocity))


@contact_law(engine_only=SEARCHED)
def roller_on_circle(forces):
    center, apart = _centers(forces)
    between, radius, side = square_root(dot(apart, apart)), forces.values[5], forces.values[11]
    forces.pass_by(apart, _speed_apart(forces, center))
    # Where the centers meet there is no direction, and no force.
    out = scale(apart, side / chosen(between > 0.0, between, 1.0))
    _press_in_plane(forces, center, out, side * (between - radius))


def _seen_from(forces, body, vector):
    """Return a vector of the plane in the axes of a body."""
    cosine, sine, _ = forces.turned(body, (1.0, 0.0))
    return cosine * vector[0] + sine * vector[1], cosine * vector[1] - sine * vector[0]


@contact_law(listed=curve.COLUMNS, in_lanes=False, engine_only=SEARCHED)
def roller_on_curve(forces):
    b = forces.bodies[1]
    center, apart = _centers(forces)
    in_body = _seen_from(forces, b, apart)
    forces.pass_by((*in_body, 0.0), _speed_apart(forces, center))
    distance, x, y = forces.call_engine(
        calls.NEAREST, curve.COLUMNS, forces.values[5], *in_body, results=2)
    _press_in_plane(forces, center, forces.turned(b, (x, y)), distance)


@contact_law(listed=curve.COLUMNS, in_lanes=False, engine_only=SEARCHED)
def face_on_curve(forces):
    (a, b), values = forces.bodies, forces.values
    # The face is a line of the first body; its normal points away from that.
    line = forces.turned(a, (values[5], values[11]))
    out = -line[1], line[0], 0.0
    deepest = forces.call_engine(calls.FURTHEST, curve.COLUMNS, 0.0, *(
        -one for one in _seen_from(forces, b, out)), results=1)
    other, _ = forces.place(b, forces.turned(b, values[2:4]))
    place = add(other, forces.turned(b, deepest))
    roller, _ = forces.place(a, forces.turned(a, values[:2]))
    _press_in_plane(forces, place, scale(out, -1.0), dot(out, subtract(place, roller)))


@contact_law(engine_only=SEARCHED)
def roller_in_space(forces):
    (a, b), values = forces.bodies, forces.values
    data = forces.entries(0, IN_SPACE_NUMBERS)
    center, _ = forces.place(a, forces.turned(a, data[:3]))
    direction = forces.turned(b, data[DIRECTION:DIRECTION + 3])
    apart = subtract(center, forces.place(b, forces.turned(b, data[PLACE_B:PLACE_B + 3]))[0])
    height = dot(direction, apart)
    # What lies along a cylinder's axis does not count.
    apart = subtract(apart, scale(direction, data[OF_CYLINDER] * height))
    between, flat, side = square_root(dot(apart, apart)), data[FLAT] > 0.5, values[11]
    unit = scale(apart, side / chosen(between > 0.0, between, 1.0))
    out = tuple(chosen(flat, along, one) for along, one in zip(direction, unit))
    distance = chosen(flat, height, side * (between - values[5]))
    forces.pass_by(apart, _speed_apart(forces, center))
    place = subtract(center, scale(out, values[4]))
    velocity = _velocity(forces, place)
    rate = -dot(out, velocity)
    slide, slip = sliding(velocity, rate, out)
    normal, along = press(forces, distance - values[4], rate, slip)
    _push_both(forces, place, contact_force(out, normal, along, slide, slip))
