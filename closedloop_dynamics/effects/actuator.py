# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A drive between the command and the joint: limits, lag, delay.

    u = command, ``delay`` seconds old, limited to +-``max_torque``
    T x' = u - x,  tau = x              with a ``lag`` T; tau = u without
    tau <= max_torque g(v)              where tau drives: tau v > 0, v = |qd|
    g(v) = 1 below 0.9 max_speed, falling linearly to 0 at max_speed

Braking is not limited by the speed. The lag's state is integrated with the rest; a delayed command
acts from the instant at which it is due, where a step ends. Work of the drive: the integral of
tau qd. When: to model a motor with limits of torque and speed, lag and delay.
"""

from dataclasses import dataclass
import math
from typing import Optional

from .effect import Effect
from .element import ForceElement, OWN, State, WORK
from .force_law import DRIVE, force_law
from ..codegen.expression_graph import chosen, larger, smaller
from ..mechanism.checks import freedom, not_negative, positive

# Share of the speed limit over which the driving torque fades.
FADING = 0.1


@dataclass(frozen=True)
class Actuator(Effect):
    """
    A drive with limits, lag and delay.

    Attributes
    ----------
    joint : str
        An actuated joint.
    max_torque : float or None
        Largest torque, positive [N m; N in a prismatic joint]; None for no limit.
    max_speed : float or None
        Speed at which the driving torque is zero, positive [rad/s; m/s]; None for no limit.
    lag : float
        Time constant T, zero or more [s].
    delay : float
        Age of the command that acts, zero or more [s].

    """

    CHECKS = {'joint': freedom, 'lag': not_negative, 'delay': not_negative, 'max_torque': positive,
              'max_speed': positive}
    READINGS = ('torque',)
    JOINTS = 'one of the actuated joints'

    joint: str
    max_torque: Optional[float] = None
    max_speed: Optional[float] = None
    lag: float = 0.0
    delay: float = 0.0

    def joints(self, mechanism):
        """Return the names that ``joint`` may be: of actuated freedoms, but of balls."""
        single = mechanism.coordinates.single_names + mechanism.measured_cuts
        return tuple(name for name in mechanism.actuated_joints if name in single)

    def element(self, machine):
        """Return the effect as a row of the table."""
        return ForceElement(limited_drive, joints=(machine.joint(self.joint),), values=(
            math.inf if self.max_torque is None else self.max_torque,
            math.inf if self.max_speed is None else self.max_speed, self.lag),
            states=(State(OWN), State(WORK)))

    def drive(self):
        """Return the joint whose command passes through the drive, and its delay [s]."""
        return self.joint, self.delay


@force_law(role=DRIVE, terms=lambda row: (bool(row.values[2] > 0.0),), in_lanes=False,
           engine_only='its torque has limits and a state of its own')
def limited_drive(forces):
    joint, given = forces.joint, forces.command
    limit, fastest, lag = forces.values[:3]

    def limited(torque):
        return larger(-limit, smaller(limit, torque))

    torque = command = limited(given)
    lags, = forces.terms or (lag > 0.0,)
    if lags is not False:
        torque = forces.state(0)
        forces.flow(chosen(lags, (command - torque) / lag, 0.0))
        # A limit may have been lowered since.
        torque = chosen(lags, limited(torque), command)
    speed = abs(joint.rate)
    fading = torque * larger(0.0, 1.0 - speed / fastest) / FADING
    torque = chosen(torque * joint.rate > 0.0, chosen(
        speed > (1.0 - FADING) * fastest, fading, torque), torque)
    joint.push(torque - given)
    forces.flow(torque * joint.rate, first=1)
    forces.read(torque)
