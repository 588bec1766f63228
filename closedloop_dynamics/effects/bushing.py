# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Bushing: springs and dampers along two axes and about the third, between points of two bodies.

    F = -K d - C d'                d: from point a to point b, in axes that turn with body a
    M = -k phi - c omega           phi = alpha_b - alpha_a - rest_angle

act on body b at its point, and the opposite on body a, there, too. They store
d K d / 2 + k phi^2 / 2.

In space there are three axes, and a moment for turns about each, k_1 of
the first. It is that of the energy

    E = sum_i c_i (1 - R_ii)     2 c_1 = -k_1 + k_2 + k_3, ...     R: axes of body b in those of a

k phi for small turns, and k sin(phi) for one about an axis.

When: rubber mounts, flexible couplings, a joint with play in stiffness,
a weld that gives.
"""

from dataclasses import dataclass
from typing import Optional, Union

import numpy as np

from .effect import Effect
from .element import DISSIPATED, ForceElement, State
from .force_law import force_law
from ..codegen.expression_graph import square_root
from ..codegen.vectors import add, cross, dot, scale, subtract, ZERO
from ..mechanism.checks import name, none_negative, not_negative, number, orientation, vector
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import GROUND, Quaternion, UNTURNED, Vector, Vector3
from ..mechanism.rotations import direction, of_quaternion

# Where a bushing's numbers in space begin: places in both bodies' frames, the axes as rows in
# those of body a and of body b, stiffness and damping along the axes.
AXES_A, AXES_B, ALONG, LOSS = 6, 15, 24, 27


def _turning(value):
    """Return a float that is not less than zero, or three of them."""
    return none_negative(value) if isinstance(value, (list, tuple)) else not_negative(value)


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
    anchor : tuple of 2 floats, or 3 in space, or None
        In its place a place in the world [m].
    stiffness : tuple of 2 floats, or 3 in space
        Along the axes, zero or more [N/m].
    damping : tuple of 2 floats, or 3 in space
        Along the axes, zero or more [N s/m].
    turning_stiffness : float, or tuple of 3 floats in space
        k, zero or more [N m/rad]; one number in space: about each axis.
    turning_damping : float, or tuple of 3 floats in space
        c, zero or more [N m s/rad].
    angle : float
        Of the first axis in the frame of point a's body [rad]; in the plane.
    rest_angle : float
        Of body b relative to body a where there is no moment [rad]; in the plane.
    orientation : tuple of 4 floats
        Of the axes in the frame of point a's body; in space.
    rest_orientation : tuple of 4 floats
        Of body b in body a where there is no moment; in space.

    """

    CHECKS = {'point_a': name, 'point_b': name, 'anchor': vector, 'stiffness': none_negative,
              'damping': none_negative, 'turning_stiffness': _turning,
              'turning_damping': _turning, 'angle': number, 'rest_angle': number,
              'orientation': orientation, 'rest_orientation': orientation}
    VECTORS = ('anchor', 'stiffness', 'damping')
    READINGS = ('force_1', 'force_2', 'moment')

    point_a: str
    point_b: Optional[str] = None
    anchor: Optional[Vector] = None
    stiffness: Vector = (0.0, 0.0)
    damping: Vector = (0.0, 0.0)
    turning_stiffness: Union[float, Vector3] = 0.0
    turning_damping: Union[float, Vector3] = 0.0
    angle: float = 0.0
    rest_angle: float = 0.0
    orientation: Quaternion = UNTURNED
    rest_orientation: Quaternion = UNTURNED

    def __post_init__(self):
        """Name the readings, of which there are more in space."""
        super().__post_init__()
        if 3 in (len(self.stiffness), len(self.damping), len(self.anchor or ())) or isinstance(
                self.turning_stiffness, tuple):
            object.__setattr__(self, 'READINGS', ('force_1', 'force_2', 'force_3', 'moment'))

    def fit(self, mechanism):
        """Refuse a mechanism without the points, and keys of space in the plane or the reverse."""
        super().fit(mechanism)
        for key, where in (('angle', True), ('rest_angle', True), ('orientation', False),
                           ('rest_orientation', False)):
            if mechanism.planar != where and getattr(self, key) != getattr(Bushing, key):
                raise FieldError(
                    f'no such key in {"space" if where else "the plane"}',
                    shown(getattr(self, key)), path=(key,))
        for key in ('turning_stiffness', 'turning_damping'):
            if mechanism.planar and isinstance(getattr(self, key), tuple):
                raise FieldError('one number in the plane', shown(getattr(self, key)), path=(key,))

    def element(self, machine):
        """Return the effect as a row of the table."""
        planar = machine.mechanism.planar
        bodies, places = machine.two_points(self.point_a, self.point_b, self.anchor)
        values, axes = self._in_plane() if planar else self._in_space(machine)
        along, damping = map(machine.vector, (self.stiffness, self.damping))
        return ForceElement(
            bushing_in_plane if planar else bushing_in_space, bodies=bodies,
            values=values, states=(State(DISSIPATED),),
            data=((*places, *axes, *along, *damping),))

    def _in_plane(self):
        """Return the rotational stiffness and damping, for an angle that counts turns; no axes."""
        return (self.turning_stiffness, self.turning_damping, self.rest_angle,
                *direction(self.angle).tolist()), ()

    def _in_space(self, machine):
        """Return the rotational stiffness and damping, and the axes of both bodies for them."""
        own, rest = (of_quaternion(one) for one in (self.orientation, self.rest_orientation))
        axes_a = machine.placement(machine.carrier(self.point_a)).axes @ own
        axes_b = machine.placement(
            machine.carrier(self.point_b) if self.point_b else GROUND).axes @ rest.T @ own
        turning, loss = (np.broadcast_to(values, 3) for values in (
            self.turning_stiffness, self.turning_damping))
        # Coefficients of the energy: half the sum of the other two less its own.
        shares = 0.5 * turning.sum() - turning
        return (*shares.tolist(), *loss.tolist()), np.vstack([axes_a.T, axes_b.T]).ravel().tolist()


@force_law()
def bushing_in_plane(forces):
    (first, second), (stiffness, damping, rest) = forces.bodies, forces.values[:3]
    axis, constants = tuple(forces.values[3:5]), forces.entries(0, 8)
    stiffness_1, stiffness_2, damping_1, damping_2 = constants[4:]
    turn = forces.angle(second) - forces.angle(first) - rest
    spin = subtract(forces.spin(second), forces.spin(first))[2]
    moment = 0.0, 0.0, -(stiffness * turn + damping * spin)
    forces.store(0.5 * (stiffness * (turn * turn)))
    lost, along = _hold(forces, (constants[:2], constants[2:4]), (
        (forces.turned(first, axis), stiffness_1, damping_1),
        (forces.turned(first, (-axis[1], axis[0])), stiffness_2, damping_2)), moment)
    forces.flow(lost + damping * spin * spin)
    forces.read(*along, moment[2])


@force_law()
def bushing_in_space(forces):
    (first, second), values, constants = forces.bodies, forces.values, forces.entries(0, LOSS + 3)
    turning, axes, moment = subtract(forces.spin(second), forces.spin(first)), [], ZERO
    lost = 0.0
    for k, (share, loss) in enumerate(zip(values[:3], values[3:6])):
        axis, other = (forces.turned(body, constants[n + 3 * k:n + 3 * k + 3])
                       for body, n in ((first, AXES_A), (second, AXES_B)))
        axes.append((axis, constants[ALONG + k], constants[LOSS + k]))
        spin = dot(axis, turning)
        moment = add(moment, subtract(scale(cross(other, axis), share),
                                      scale(axis, loss * spin)))
        lost = lost + loss * spin * spin
        forces.store(share * (1.0 - dot(axis, other)))
    more, along = _hold(forces, (constants[:3], constants[3:6]), axes, moment)
    forces.flow(lost + more)
    forces.read(*along, square_root(dot(moment, moment)))


def _hold(forces, places, axes, moment):
    """
    Join points of two bodies by springs and dampers along axes of the first; and a moment.

    Returns the power dissipated by the dampers [W], and the force along each axis [N].
    """
    bodies = forces.bodies
    start, end = (forces.turned(body, place) for body, place in zip(bodies, places))
    (place_a, _), (place_b, rate_b) = (
        forces.place(body, offset) for body, offset in zip(bodies, (start, end)))
    apart, force = subtract(place_b, place_a), ZERO
    # Relative to the first body's point that coincides with the second point, so as to include
    # the rotation of the axes.
    lever = add(start, apart)
    rate, lost, along = subtract(rate_b, forces.place(bodies[0], lever)[1]), 0.0, []
    for axis, stiffness, damping in axes:
        stretch, speed = dot(axis, apart), dot(axis, rate)
        pull = stiffness * stretch + damping * speed
        along.append(-pull)
        force = subtract(force, scale(axis, pull))
        lost = lost + damping * speed * speed
        forces.store(0.5 * stiffness * (stretch * stretch))
    forces.push(bodies[1], end, force, moment)
    forces.push(bodies[0], lever, scale(force, -1.0), scale(moment, -1.0))
    return lost, along
