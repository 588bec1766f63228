# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Dry friction in a joint: Coulomb, Stribeck, and a bristle that really holds.

    limit     F(v) = (F_c + mu r R) (1 + (s - 1) exp(-(v / v_s)^2)),   v = qd
    bristle   z' = v, kept within |z| <= F / k after every step (return map)
    torque    tau = -clip(k z + c v, -F, F)

Sliding, the bristle is stretched to its limit and the torque is F(v), exactly. Where the joint
reverses, the bristle lets go; at rest it is an elastic hold k z without any creep
as long as the load stays below F(0) = s F_c. The only regularisation is this elasticity:
the joint gives way by at most F / k each way, and swings on the bristle at sqrt(k / I) [rad/s]
unless c damps it. An explicit method needs steps below some 2.7 sqrt(I / k) while the joint
sticks; a stiff one does not mind. Where a step runs past a reversal, the torque turns over within
F / c of the rate: a generous c, near 2 sqrt(k I), keeps large steps sharp there.

R is the magnitude of the joint's own constraint force (in a prismatic joint: its part across
the axis), r the radius that it rubs at. It depends on the accelerations, and they on
the friction: the loop is broken by a lag, T R' = |reaction| - R, a state that is integrated
with the rest. It costs one more recursion, only where mu > 0.

The power tau v counts as dissipated; what the bristle holds meanwhile, at most F^2 / 2k, is part
of that. When: bearings, seals and guides at low speed, whatever should stay where it stands.

"""

from dataclasses import dataclass
import math

from .machine import require_joint
from .table import DISSIPATED, FIRST, Law, LOAD_TIME, OWN, STATE, State
from ..core.compiled import inlined
from ..mechanism.checks import name, not_negative, positive
from ..mechanism.fields import FieldError, normalise

KIND = 3


@dataclass(frozen=True)
class JointFriction:
    """
    Coulomb and Stribeck friction in a joint.

    Attributes
    ----------
    joint : str
    coulomb : float
        F_c, friction while sliding fast, zero or more [N m; N in a prismatic joint].
    static_ratio : float
        s, friction at rest over that, one or more.
    stribeck_velocity : float
        v_s, where the excess has fallen to 37 %, positive [rad/s; m/s].
    stiffness : float
        k of the bristle, positive [N m/rad; N/m].
    damping : float
        c of the bristle, zero or more [N m s/rad; N s/m].
    friction_coefficient : float
        mu, zero or more; zero: the joint's constraint force does not matter.
    radius : float
        r, at which it rubs, positive [m]; 1 in a prismatic joint.
    load_time : float
        T, positive [s].

    """

    READINGS = ('torque', 'reaction', 'limit')
    # The bristle is brought back within its limit after every step.
    SETTLES = True

    joint: str
    coulomb: float = 0.0
    static_ratio: float = 1.0
    stribeck_velocity: float = 0.01
    stiffness: float = 1e4
    damping: float = 10.0
    friction_coefficient: float = 0.0
    radius: float = 1.0
    load_time: float = 0.002

    def __post_init__(self):
        """Refuse what cannot be friction."""
        normalise(self, joint=name, coulomb=not_negative, static_ratio=positive,
                  stribeck_velocity=positive, stiffness=positive, damping=not_negative,
                  friction_coefficient=not_negative, radius=positive, load_time=positive)
        if self.static_ratio < 1.0:
            raise FieldError('a number that is one or more', f'{self.static_ratio:g}',
                             path=('static_ratio',))

    def fit(self, mechanism):
        """Refuse a joint that the mechanism does not have."""
        require_joint(mechanism, 'joint', self.joint)

    def law(self, machine):
        """Return the effect as a row of the table."""
        # A bristle's force must be right to a thousandth of its limit at the usual tolerances.
        scale = min(1.0, 1e3 * self.coulomb / self.stiffness) or 1.0
        lever = self.friction_coefficient * self.radius
        values = [self.coulomb, self.static_ratio, self.stribeck_velocity, self.stiffness,
                  self.damping, lever]
        values += [0.0] * (LOAD_TIME - len(values)) + [self.load_time]
        return Law(
            KIND, (machine.joint(self.joint), machine.joint_row(self.joint)), tuple(values),
            (State(OWN, scale), State(OWN, 10.0), State(DISSIPATED)), loaded=lever > 0.0)

    def moving(self, rate):
        """Return the bristle's stretch in a steady motion: beyond its limit either way."""
        return math.copysign(math.inf, rate) if rate != 0.0 else 0.0


@inlined
def limit(table, row, rate):
    """Return the largest friction at a rate."""
    values = table.values
    level = values[row, 0] + values[row, 5] * table.states[table.index[row, STATE] + 1]
    excess = values[row, 1] - 1.0
    if excess > 0.0:
        level *= 1.0 + excess * math.exp(-(rate / values[row, 2]) ** 2)
    return level


@inlined
def apply(table, row, qd):
    """Add the torque; see ``dispatch.apply``."""
    values, joint, state = table.values, table.index[row, FIRST], table.index[row, STATE]
    rate = qd[joint]
    most = limit(table, row, rate)
    friction = max(-most, min(most, values[row, 3] * table.states[state]))
    friction = max(-most, min(most, friction + values[row, 4] * rate))
    table.applied[joint] -= friction
    table.rates[state] = rate
    table.rates[state + 2] = friction * rate
    table.output[row, 1] = -friction
    table.output[row, 3] = most


@inlined
def settle(table, row, rate):
    """Return the bristle's stretch, kept within its limit; see ``dispatch.settle``."""
    most = limit(table, row, rate) / table.values[row, 3]
    return max(-most, min(most, table.states[table.index[row, STATE]]))
