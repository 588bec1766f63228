# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Contact of a named point with a straight line fixed in the world, in space with a plane.

The line goes through ``origin`` at ``angle``; the free side is on its left, looking along it. The
plane goes through ``origin``, its ``normal`` points to the free side. With depth d beyond either,
its rate d', and the sliding rate v along it:

    normal     N = k d^n max(0, 1 + c d')               pushes out, never pulls
    friction   T = mu N s(v)                            against the sliding
    scraping   S = b d s(v)                             against the sliding
    s(v) = v / sqrt(v^2 + v_r^2)                        a smooth sign of v

The normal law is Hunt and Crossley's (1975): the damping grows with the depth, so that the
force neither jumps at touch-down nor ever holds the point back. It stores
k d^(n+1) / (n+1); the rest is dissipated. Below v_r the friction is nearly
viscous: under a load of half its limit the point creeps at 0.58 v_r. When: a tool on its ground,
a foot on the floor, a guide.
"""

from dataclasses import dataclass
from typing import Optional

from .contact_force import contact_force, contact_law, press, sliding
from .effect import Effect
from .element import DISSIPATED, ForceElement, State
from .force_law import BOUNDARY
from ..codegen.vectors import dot, in_space, subtract
from ..mechanism.checks import direction, name, not_negative, number, positive, vector
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import Vector, Vector3
from ..mechanism.rotations import direction as heading


@dataclass(frozen=True)
class Contact(Effect):
    """
    Contact of a named point with a line, or with a plane in space.

    Attributes
    ----------
    point : str
    origin : tuple of 2 floats, or 3 in space
        A place on the line or plane, world axes [m].
    angle : float
        Direction of the line [rad]; 0: along x, free above. Not in space.
    stiffness : float
        k, positive [N/m^n].
    exponent : float
        n, one or more; 1 linear, 1.5 Hertz.
    damping : float
        c, zero or more [s/m].
    friction : float
        mu, zero or more.
    slip_velocity : float
        v_r, positive [m/s].
    scraping : float
        b, zero or more [N/m].
    normal : tuple of 3 floats or None
        Of the plane, world axes, to the free side; of unit length here. In space only.

    """

    CHECKS = {'point': name, 'origin': vector, 'stiffness': positive, 'angle': number,
              'exponent': positive, 'damping': not_negative, 'friction': not_negative,
              'slip_velocity': positive, 'scraping': not_negative, 'normal': direction}
    VECTORS = ('origin',)
    READINGS = ('depth', 'normal_force', 'friction_force', 'scraping_force')

    point: str
    origin: Vector
    stiffness: float
    angle: float = 0.0
    exponent: float = 1.0
    damping: float = 0.0
    friction: float = 0.0
    slip_velocity: float = 0.01
    scraping: float = 0.0
    normal: Optional[Vector3] = None

    def __post_init__(self):
        """Refuse impossible contact parameters."""
        super().__post_init__()
        if self.exponent < 1.0:
            raise FieldError('a number that is one or more', f'{self.exponent:g}',
                             path=('exponent',))

    def fit(self, mechanism):
        """Refuse a plane in the plane, and a line in space."""
        super().fit(mechanism)
        if mechanism.planar and self.normal is not None:
            raise FieldError('no normal for a line in the plane, which has an angle',
                             shown(self.normal), path=('normal',))
        if not mechanism.planar and self.normal is None:
            raise FieldError('the normal [x, y, z] of a plane', 'none', path=('normal',))
        if not mechanism.planar and self.angle != 0.0:
            raise FieldError('no angle for a plane in space, which has a normal',
                             shown(self.angle), path=('angle',))

    def element(self, machine):
        """Return the effect as a row of the table."""
        row, place = machine.point(self.point)
        law = (self.stiffness, self.exponent, self.damping, self.friction, self.slip_velocity,
               self.scraping)
        if machine.mechanism.planar:
            which, values = point_on_line, (
                *place, *self.origin, *heading(self.angle).tolist(), *law)
        else:
            height = sum(n * x for n, x in zip(self.normal, self.origin))
            which, values = point_on_plane, (*place, *self.normal, *law, height)
        return ForceElement(which, bodies=(row,), values=values, states=(State(DISSIPATED),),
                            gap=BOUNDARY)


JUMPS = 'its friction jumps with the sliding, and contacts begin within a step'


@contact_law(engine_only=JUMPS)
def point_on_line(forces):
    (body,), values = forces.bodies, forces.values
    offset = forces.turned(body, values[:2])
    x, y = values[4:6]
    place, velocity = forces.place(body, offset)
    apart = subtract(place, in_space(values[2:4]))
    depth = y * apart[0] - x * apart[1]
    rate = y * velocity[0] - x * velocity[1]
    normal, along = press(
        forces, -depth, rate, x * velocity[0] + y * velocity[1], values[11])
    forces.push(body, offset, (along * x - normal * y, along * y + normal * x, 0.0))


@contact_law(engine_only=JUMPS)
def point_on_plane(forces):
    (body,), values = forces.bodies, forces.values
    offset, out = forces.turned(body, values[:3]), tuple(values[3:6])
    place, velocity = forces.place(body, offset)
    depth, rate = values[12] - dot(out, place), -dot(out, velocity)
    slide, slip = sliding(velocity, rate, out)
    normal, along = press(forces, -depth, rate, slip, values[11])
    forces.push(body, offset, contact_force(out, normal, along, slide, slip))
