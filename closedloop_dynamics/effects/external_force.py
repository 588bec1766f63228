# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A force on a named point and a torque on its body, constant until they are changed.

    F at ``point``, T        work done on the mechanism: the integral of F . v + T . omega

Constant in world axes, or in those of the point's body, which turn with it. When: a load, a push,
a thruster, what a force sensor elsewhere measures (change ``force`` while it runs, from Python or
from a topic).
"""

from dataclasses import dataclass
from typing import Union

from .effect import BODY, Effect, WORLD
from .element import ForceElement, State, WORK
from .force_law import force_law
from .points import of_body_or_world
from ..codegen.vectors import add, dot, ZERO
from ..mechanism.checks import name, number, one_of, one_or_several, vector, vector3
from ..mechanism.fields import at
from ..mechanism.mechanism import Vector, Vector3


@dataclass(frozen=True)
class ExternalForce(Effect):
    """
    A force on a named point and a torque on its body.

    Attributes
    ----------
    point : str
    force : tuple of 2 floats, or 3 in space
        [N].
    torque : float, or tuple of 3 floats in space
        [N m].
    axes : str
        ``'world'``, or ``'body'`` for those of the point's body.

    """

    CHECKS = {'point': name, 'force': vector, 'torque': one_or_several(number, vector3),
              'axes': one_of((WORLD, BODY))}
    VECTORS = ('force',)
    # Constant between changes, which may come a thousand times a second.
    STIFFENS = False
    READINGS = ('power',)

    point: str
    force: Vector = (0.0, 0.0)
    torque: Union[float, Vector3] = 0.0
    axes: str = WORLD

    def fit(self, mechanism):
        """Refuse a torque of the plane in space, and one of space in the plane."""
        super().fit(mechanism)
        with at('torque'):
            if mechanism.planar:
                number(self.torque)
            elif self.torque != 0.0:
                vector3(self.torque)

    def element(self, machine):
        """Return the effect as a row of the table."""
        row, place = machine.point(self.point)
        force, torque, turns = machine.vector(self.force), self.torque, float(self.axes == BODY)
        states = (State(WORK),)
        if machine.mechanism.planar:
            torque = (torque,)
        else:
            torque = torque or (0.0, 0.0, 0.0)
        if turns and not machine.mechanism.planar:
            axes = machine.placement(machine.carrier(self.point)).axes
            force, torque = axes @ force, axes @ torque
        return ForceElement(external_force, bodies=(row,), values=(
            *place, *force, *torque, turns), states=states)


@force_law()
def external_force(forces):
    (body,), size, values = forces.bodies, forces.size, forces.values
    offset = forces.turned(body, values[:size])
    moment, turns = ((0.0, 0.0, values[4]), values[5]) if size == 2 else (values[6:9], values[9])
    force, moment = (of_body_or_world(forces, body, vector, turns)
                     for vector in (values[size:2 * size], moment))
    moment = add(moment, ZERO)
    forces.push(body, offset, force, moment)
    power = dot(force, forces.place(body, offset)[1]) + dot(moment, forces.spin(body))
    forces.flow(power)
    forces.read(power)
