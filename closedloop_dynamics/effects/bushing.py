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
from .table import BUSHING, DISSIPATED, ForceElement, SPATIAL_BUSHING, State
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
        """Refuse one with no end or three."""
        super().__post_init__()
        if (self.point_b is None) == (self.anchor is None):
            raise FieldError('either point_b or anchor', 'both' if self.anchor else 'neither',
                             path=('point_b',))
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
        row_a, place_a = machine.point(self.point_a)
        row_b, place_b = machine.point(self.point_b) if self.point_b else (0, self.anchor)
        values, axes = self._in_plane() if planar else self._in_space(machine)
        along, damping = map(machine.vector, (self.stiffness, self.damping))
        return ForceElement(
            BUSHING if planar else SPATIAL_BUSHING, (row_a, row_b), values, (State(DISSIPATED),),
            data=((*place_a, *place_b, *axes, *along, *damping),))

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
        # Of the energy: half the sum of the others' less its own.
        shares = 0.5 * turning.sum() - turning
        return (*shares.tolist(), *loss.tolist()), np.vstack([axes_a.T, axes_b.T]).ravel().tolist()
