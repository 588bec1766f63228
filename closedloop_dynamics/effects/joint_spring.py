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
from .element import ForceElement
from .force_law import force_law
from ..codegen.expression_graph import arctangent, chosen, larger, square_root
from ..codegen.vectors import dot, scale, subtract, ZERO
from ..mechanism.checks import freedom, not_negative, number
from ..mechanism.fields import FieldError, shown
from ..mechanism.rotations import of_quaternion

# asin(x) / x in powers of x^2, good to rounding where that is below the limit.
_ARC, _SMALL = (1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152, 63 / 2816), 1e-3


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
                joint_spring, joints=(machine.joint(self.joint),),
                values=(self.stiffness, self.rest))
        joint = machine.description(self.joint)
        parent, child = (machine.placement(body) for body in (joint.parent, joint.child))
        axes = parent.axes @ of_quaternion(joint.orientation)
        return ForceElement(
            orientation_spring, bodies=(parent.row, child.row), values=(self.stiffness,),
            data=((*axes.T.ravel().tolist(), *child.axes.T.ravel().tolist()),))


@force_law()
def joint_spring(forces):
    stiffness, rest = forces.values[:2]
    stretch = forces.joint.value - rest
    torque = -(stiffness * stretch)
    forces.joint.push(torque)
    forces.store(0.5 * (stiffness * (stretch * stretch)))
    forces.read(torque)


@force_law()
def orientation_spring(forces):
    (parent, child), stiffness = forces.bodies, forces.values[0]
    axes, others = ([forces.turned(body, forces.entries(n + 3 * k, 3)) for k in range(3)]
                    for body, n in ((parent, 0), (child, 9)))
    turn = _turn([[dot(axis, other) for other in others] for axis in axes])
    moment = ZERO
    for axis, component in zip(axes, turn):
        moment = subtract(moment, scale(axis, stiffness * component))
    forces.push(child, ZERO, ZERO, moment)
    forces.push(parent, ZERO, ZERO, scale(moment, -1.0))
    square = dot(turn, turn)
    forces.store(0.5 * (stiffness * square))
    forces.read(stiffness * square_root(square))


def _turn(matrix):
    """Return the angle phi of a rotation, 0 to pi, times its axis a."""
    # a sin phi, from the antisymmetric part.
    sines = [0.5 * (matrix[(k + 2) % 3][(k + 1) % 3] - matrix[(k + 1) % 3][(k + 2) % 3])
             for k in range(3)]
    cosine = 0.5 * (matrix[0][0] + matrix[1][1] + matrix[2][2] - 1.0)
    square = dot(sines, sines)
    sine = square_root(square)
    angle, series = arctangent(sine, cosine), 0.0
    # phi / sin phi: where that is small, its series, as the root has no derivative at zero.
    for coefficient in reversed(_ARC):
        series = coefficient + square * series
    near = scale(sines, chosen(square < _SMALL, series, angle / sine))
    # Beyond a right angle: the longest column of a a^T (1 - cos phi), the symmetric part.
    columns = [[0.5 * (matrix[i][k] + matrix[k][i]) - (cosine if i == k else 0.0)
                for i in range(3)] for k in range(3)]
    longest, most = columns[0], columns[0][0]
    for k in (1, 2):
        longer, most = columns[k][k] > most, larger(most, columns[k][k])
        longest = [chosen(longer, one, other) for one, other in zip(columns[k], longest)]
    factor = angle / square_root(dot(longest, longest))
    far = scale(longest, chosen(dot(longest, sines) < 0.0, -factor, factor))
    return [chosen(cosine > 0.0, *one) for one in zip(near, far)]
