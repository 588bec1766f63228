# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Linear spring in a joint.

    tau = -k (q - q0)        on joint ``joint``

It stores k (q - q0)^2 / 2. In a spherical or free joint, named as a whole, it acts against turns:

    tau = -k phi a        on the child, and the opposite on the parent

where the child is turned by the angle phi, 0 to pi, about the axis a from the joint's frame; it
stores k phi^2 / 2. The axis, and so the torque, jumps where phi is pi.
When: torsion springs, flexure hinges, a counterbalance, and (with
a large k) a joint that is meant to stand still.
"""

from dataclasses import dataclass

from .effect import Effect
from .table import ForceElement, JOINT_SPRING, ORIENTATION_SPRING
from ..mechanism.checks import freedom, not_negative, number
from ..mechanism.fields import FieldError, shown
from ..mechanism.rotations import of_quaternion


@dataclass(frozen=True)
class JointSpring(Effect):
    """
    Linear spring in a joint.

    Attributes
    ----------
    joint : str
    stiffness : float
        k, zero or more [N m/rad; N/m in a prismatic joint].
    rest : float
        q0, where it is free of torque [rad; m]; 0 in a spherical or free joint.

    """

    CHECKS = {'joint': freedom, 'stiffness': not_negative, 'rest': number}
    READINGS = ('torque',)

    joint: str
    stiffness: float
    rest: float = 0.0

    def joints(self, mechanism):
        """Return the names that ``joint`` may be: of any freedom with a number, and of balls."""
        return mechanism.coordinates.numbers_and_turns + mechanism.measured_cuts

    def fit(self, mechanism):
        """Refuse a mechanism without the joint, and a ball that is at rest where it is turned."""
        super().fit(mechanism)
        if self.rest and self.joint in mechanism.coordinates.with_orientation:
            raise FieldError('0 in a joint with an orientation', shown(self.rest), path=('rest',))

    def element(self, machine):
        """Return the effect as a row of the table."""
        if self.joint not in machine.mechanism.coordinates.with_orientation:
            return ForceElement(
                JOINT_SPRING, (machine.joint(self.joint),), (self.stiffness, self.rest))
        joint = machine.description(self.joint)
        parent, child = (machine.placement(body) for body in (joint.parent, joint.child))
        axes = parent.axes @ of_quaternion(joint.orientation)
        return ForceElement(
            ORIENTATION_SPRING, (parent.row, child.row), (self.stiffness,),
            data=((*axes.T.ravel().tolist(), *child.axes.T.ravel().tolist()),))
