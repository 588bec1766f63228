# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Inertia of a motor's rotor behind a gear.

    reflected inertia  I_r = N^2 J        joint torque for it: I_r qdd

The rotor turns N times as fast as the joint, on the body that carries the motor: the joint's
parent.

In the plane it is taken relative to that body, as usual: the energy J (N qd)^2 / 2 counts as
kinetic, the share from the carrier's own turning is left out, which is exact where the
motor stands on the ground. In space nothing is left out. With the rotor's axis a and the angular
velocity w of the carrier, its energy beyond that of a rotor that is fixed to the carrier is
N^2 J qd^2 / 2 + N J qd a . w, from which follow

    joint torque  N^2 J qdd + N J a . w'        torque on the carrier  N J (qdd a + qd w x a)

the last of them the gyroscopic torque. Mass and inertia of the rotor as if it were fixed are the
carrier's, in its own description or by a payload. When: geared drives, whose rotor often outweighs
the link; flywheels.

At a joint that closes a loop its torque -I_r qdd depends on accelerations that follow from it: it
is found with them, as friction at rest is (``engine/static_friction.hpp``), by one evaluation
more. In space only where the joint's carrier, body B, is the ground, or where its rotation is
negligible.
"""

from dataclasses import dataclass
from typing import Optional

import numpy as np

from .effect import Effect
from .element import ForceElement
from .reflected_inertia import reflected_inertia
from ..codegen import space
from ..engine.types import ARMATURE, DOF, PARENT, REVOLUTE, REVOLUTE_ARMATURE, TYPE
from ..mechanism.checks import direction, freedom, not_negative, number
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import COUPLED, FIXED, GROUND, PRISMATIC, Vector3
from ..mechanism.rotations import of_quaternion

# Gear ratio beyond which the rotation of the carrier is negligible.
ENDLESS = 1e9


@dataclass(frozen=True)
class Rotor(Effect):
    """
    A rotor that a joint turns through a gear.

    Attributes
    ----------
    joint : str
        Of one degree of freedom; with a ``gear_ratio`` beyond 1e9, at which the carrier's rotation
        is negligible, any degree of freedom of the tree, or a spherical or free joint as a whole:
        all axes.
    inertia : float
        J of the rotor about its own axis, zero or more [kg m^2].
    gear_ratio : float
        N, turns of the rotor per turn of the joint, not zero (per metre in a prismatic
        joint: 2 pi / lead [rad/m]).
    axis : tuple of 3 floats or None
        The rotor's axis in the frame of the joint's parent; of unit length here. The joint's
        own axis when not given. In space only.

    """

    ENERGY = 'kinetic_energy'
    CHECKS = {'joint': freedom, 'inertia': not_negative, 'gear_ratio': number, 'axis': direction}

    joint: str
    inertia: float
    gear_ratio: float = 1.0
    axis: Optional[Vector3] = None

    def __post_init__(self):
        """Refuse impossible rotor parameters."""
        super().__post_init__()
        if self.gear_ratio == 0.0:
            raise FieldError('a number that is not zero', '0', path=('gear_ratio',))

    def joints(self, mechanism):
        """
        Return the names that ``joint`` may be: of joints of one degree of freedom.

        Where the rotation of the carrier is negligible, of any freedom with a number in the tree,
        and of balls: about all three axes.
        """
        single = tuple(joint.name for joint in (*mechanism.cut_joints, *mechanism.joints)
                       if joint.type in COUPLED)
        return single if abs(self.gear_ratio) <= ENDLESS else tuple(
            dict.fromkeys(single + mechanism.coordinates.numbers_and_turns))

    def fit(self, mechanism):
        """Refuse an axis in the plane, and in space a cut joint on a body that turns."""
        super().fit(mechanism)
        if mechanism.planar and self.axis is not None:
            raise FieldError('no axis in the plane, which every rotor turns in', shown(self.axis),
                             path=('axis',))
        cut = mechanism.cut_joint(self.joint)
        if cut is not None and not mechanism.planar and abs(self.gear_ratio) <= ENDLESS and (
                _turns(mechanism, cut.body_b)):
            raise FieldError(
                'a joint of the tree, or a cut joint whose body_b does not turn',
                f'{self.joint!r}, which closes a loop on {cut.body_b!r}, whose turning the '
                'rotor feels', 'cut another joint of that loop', ('joint',))

    def reserve(self, model, machine):
        """Make the inertia of a rotor a load, and in space the terms of its spin."""
        for row in self._rows(model, machine):
            if not machine.mechanism.planar:
                space.vary(model, row, [
                    space.ARMATURE,
                    *space.ROTOR + np.flatnonzero(self._spin(model, machine, row))])
            elif model.tree[row, TYPE] == REVOLUTE:
                model.tree[row, TYPE] = REVOLUTE_ARMATURE

    def change(self, model, machine):
        planar = machine.mechanism.planar
        for row in self._rows(model, machine):
            model.body[row, ARMATURE if planar else space.ARMATURE] += (
                self.gear_ratio ** 2 * self.inertia)
            if not planar:
                model.body[row, space.ROTOR:space.ROTOR + 3] += (
                    self.gear_ratio * self.inertia * self._spin(model, machine, row))

    def _rows(self, model, machine):
        """Return the rows of its joint in the tree: each freedom has one of its own."""
        if self.joint in machine.cuts:
            return ()
        coordinates = machine.mechanism.coordinates
        if self.joint in coordinates.with_orientation:
            freedoms = range(coordinates.nv)[coordinates.rates[self.joint]][-3:]
        else:
            freedoms = machine.joint(self.joint),
        # By hand: of so few rows it is faster, and samples of a sweep each ask.
        return [row for row, freedom in enumerate(model.tree[1:, DOF].tolist(), start=1)
                if freedom in freedoms]

    def _spin(self, model, machine, row):
        """Return its axis in the frame of the row that carries it; 0 where that does not turn."""
        if (self.joint in machine.mechanism.coordinates.with_orientation
                or model.tree[row, PARENT] == 0 or abs(self.gear_ratio) > ENDLESS):
            return np.zeros(3)
        joint = machine.description(self.joint)
        axis = self.axis or of_quaternion(joint.orientation) @ joint.axis
        return space.snapped(machine.placement(joint.parent).axes @ axis)

    def element(self, machine):
        """Return the row of the table of a rotor at a cut joint."""
        if self.joint not in machine.cuts:
            return None
        return ForceElement(reflected_inertia, joints=(machine.joint(self.joint),),
                            values=(self.gear_ratio ** 2 * self.inertia,))


def _turns(mechanism, body):
    """Return whether a body may turn: whether any but slides and fixed joints carry it."""
    carrier = {joint.child: joint for joint in mechanism.joints}
    while body != GROUND:
        if carrier[body].type not in (PRISMATIC, FIXED):
            return True
        body = carrier[body].parent
    return False
