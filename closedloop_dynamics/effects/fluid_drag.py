# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Drag of a fluid on a body, along the axes of the body and about them.

    F_i = -(b_i + d_i |v_i|) v_i        at ``point``, v: its velocity relative to the fluid
    M_i = -(e_i + f_i |w_i|) w_i        w: angular velocity of the body

F . v and M . w are dissipated; a fluid that flows at u does the work F . u. Of a box with the
edges a, b, c in a fluid of the density rho d_1 is about rho b c / 2. When: bodies that swim or
fly, wind, paddles and stirrers, oil baths.
"""

from dataclasses import dataclass
from typing import Union

import numpy as np

from .effect import Effect
from .element import DISSIPATED, ForceElement, State, WORK
from .force_law import force_law
from ..codegen.expression_graph import square_root
from ..codegen.vectors import add, dot, in_space, scale, subtract, ZERO
from ..mechanism.checks import (
    name, none_negative, not_negative, number, one_or_several, orientation, vector)
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import Quaternion, UNTURNED, Vector, Vector3
from ..mechanism.rotations import direction, of_quaternion

# Numbers of an entry: an axis in the frame of the row, coefficients along and about it.
COLUMNS = 7
# Keys of the coefficients, in the order the law reads them.
ALONG, ABOUT = ('linear', 'quadratic'), ('turning_linear', 'turning_quadratic')


@dataclass(frozen=True)
class FluidDrag(Effect):
    """
    Drag of a fluid on a body, along the axes of the body and about them.

    Attributes
    ----------
    point : str
        A named point, where the force acts.
    linear, quadratic : tuple of 2 floats, or 3 in space
        b and d along the axes, zero or more [N s/m, N s^2/m^2].
    turning_linear, turning_quadratic : float, or tuple of 3 floats in space
        e and f about the axes, zero or more [N m s/rad, N m s^2/rad^2]; one number in space:
        about each axis.
    flow : tuple of 2 floats, or 3 in space
        u, velocity of the fluid in the world [m/s].
    angle : float
        Of the first axis in the frame of the point's body [rad]; in the plane.
    orientation : tuple of 4 floats
        Of the axes in the frame of the point's body; in space.

    """

    CHECKS = {'point': name, **dict.fromkeys(ALONG, none_negative),
              **dict.fromkeys(ABOUT, one_or_several(not_negative, none_negative)),
              'flow': vector, 'angle': number, 'orientation': orientation}
    VECTORS = (*ALONG, 'flow')
    READINGS = ('force', 'torque')

    point: str
    linear: Vector = (0.0, 0.0)
    quadratic: Vector = (0.0, 0.0)
    turning_linear: Union[float, Vector3] = 0.0
    turning_quadratic: Union[float, Vector3] = 0.0
    flow: Vector = (0.0, 0.0)
    angle: float = 0.0
    orientation: Quaternion = UNTURNED

    def fit(self, mechanism):
        """Refuse a mechanism without the point, and keys of space in the plane or the reverse."""
        super().fit(mechanism)
        for key, where in (('angle', True), ('orientation', False)):
            if mechanism.planar != where and getattr(self, key) != getattr(FluidDrag, key):
                raise FieldError(f'no such key in {"space" if where else "the plane"}',
                                 shown(getattr(self, key)), path=(key,))
        for key in ABOUT:
            value = getattr(self, key)
            if isinstance(value, tuple) and (mechanism.planar or len(value) != 3):
                raise FieldError('one number, or three in space', shown(value), path=(key,))

    def element(self, machine):
        """Return the effect as a row of the table."""
        row, place = machine.point(self.point)
        states = (State(DISSIPATED), State(WORK))
        along = [machine.vector(getattr(self, key)) for key in ALONG]
        flow = machine.vector(self.flow)
        if machine.mechanism.planar:
            return ForceElement(drag_in_plane, bodies=(row,), values=(
                *place, *direction(self.angle).tolist(), *along[0], *along[1],
                self.turning_linear, self.turning_quadratic, *flow), states=states)
        axes = machine.placement(machine.carrier(self.point)).axes @ np.array(
            of_quaternion(self.orientation))
        about = [np.broadcast_to(getattr(self, key), 3).tolist() for key in ABOUT]
        return ForceElement(
            drag_in_space, bodies=(row,), values=(*place, *flow), states=states, data=tuple(
                (*axes[:, k].tolist(), along[0][k], along[1][k], about[0][k], about[1][k])
                for k in range(3)))


@force_law()
def drag_in_plane(forces):
    values = forces.values
    axis = tuple(values[2:4])
    force, moment = _drag(forces, values[:2], in_space(values[10:12]), (
        (axis, values[4], values[6], 0.0, 0.0),
        ((-axis[1], axis[0]), values[5], values[7], 0.0, 0.0),
        ((0.0, 0.0, 1.0), 0.0, 0.0, *values[8:10])))
    forces.read(square_root(dot(force, force)), moment[2])


@force_law()
def drag_in_space(forces):
    entries = [forces.entries(COLUMNS * n, COLUMNS) for n in range(3)]
    forces.read(*(square_root(dot(one, one)) for one in _drag(
        forces, forces.values[:3], tuple(forces.values[3:6]),
        [(one[:3], *one[3:]) for one in entries])))


def _drag(forces, point, flow, entries):
    """
    Apply a fluid's drag along axes of a body and about them, with two coefficients of each.

    Returns force and moment.
    """
    body, = forces.bodies
    offset = forces.turned(body, point)
    velocity, spin = subtract(forces.place(body, offset)[1], flow), forces.spin(body)
    force, moment = ZERO, ZERO
    for along_body, *coefficients in entries:
        axis = forces.turned(body, along_body)
        along, about = (
            -((linear + quadratic * abs(speed)) * speed) for linear, quadratic, speed in (
                (*coefficients[:2], dot(axis, velocity)), (*coefficients[2:], dot(axis, spin))))
        force, moment = add(force, scale(axis, along)), add(moment, scale(axis, about))
    forces.push(body, offset, force, moment)
    forces.flow(-dot(force, velocity) - dot(moment, spin), dot(force, flow))
    return force, moment
