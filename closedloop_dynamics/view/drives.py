# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Drives of a live simulation: a torque, or a position, speed or expression that is tracked."""

import math

from .messages import EXPRESSION, OWN, POSITION, SPEED, TORQUE
from ..effects.prescribed_motion import PrescribedMotion
from ..mechanism.checks import number, text
from ..mechanism.errors import NumericalError
from ..mechanism.fields import at

# A drive moves its joint towards its reference like a critically damped spring of this rate [1/s].
DRIVE_RATE = 50.0


class Drive:
    """
    Drive of one joint, named by its freedom; ``slides``: whether that is a length.

    ``inertia``: that the drive feels; to be renewed as the machine moves [kg m^2; kg]; ``mode``:
    ``torque``, ``position``, ``speed``, ``expression``, or ``own``: a controller knows; ``value``:
    torque [N m; N], position [rad; m], speed [rad/s; m/s], or expression in the time ``t`` for the
    position; name of the controller.
    """

    def __init__(self, joint, inertia, slides):
        self.joint, self.inertia, self._slides = joint, inertia, slides
        self.set(TORQUE, 0.0, 0.0, 0.0)

    def set(self, mode, value, time, position):  # noqa: A003
        """
        Follow another reference from a time [s] and position [rad; m] on.

        FieldError where the value is neither a number nor an expression.
        """
        with at('value'):
            (text if mode in (EXPRESSION, OWN) else number)(value)
        motion, shift = None, 0.0
        if mode == EXPRESSION:
            motion = PrescribedMotion('expression', joint=self.joint, expression=value)
            begin = float(motion.at(time)[0])
            if not self._slides and math.isfinite(begin):
                # An angle is followed from where it is, whole turns aside.
                shift = 2.0 * math.pi * round((position - begin) / (2.0 * math.pi))
        self.mode, self.value = mode, value
        self._motion, self._shift, self._from = motion, shift, (time, position)

    def reference(self, time):
        """Return position, rate and acceleration that are tracked at a time."""
        if self.mode == POSITION:
            return self.value, 0.0, 0.0
        if self.mode == SPEED:
            begin, position = self._from
            return position + self.value * (time - begin), self.value, 0.0
        position, rate, acceleration = map(float, self._motion.at(time))
        if not math.isfinite(position + rate + acceleration):
            raise NumericalError(
                f'The expression {self.value} of the drive of {self.joint} has no finite value '
                f'at t = {time:.6g} s.')
        return position + self._shift, rate, acceleration

    def torque(self, time, position, velocity):
        """Return the torque or force of the present state [N m; N]."""
        if self.mode == TORQUE:
            return self.value
        wanted, rate, acceleration = self.reference(time)
        return self.inertia * (acceleration + DRIVE_RATE * (
            DRIVE_RATE * (wanted - position) + 2.0 * (rate - velocity)))
