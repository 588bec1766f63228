# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Spring and damper along a weighted sum of joint coordinates, as of a tendon over pulleys.

    l = sum_j r_j q_j        tau_j = -r_j T        on each joint of ``arms``
    T = k_1 s + k_2 s^2 + ... + (c_1 + c_2 |l'| + ...) l'

with s what l is above the upper or, less than zero, below the lower end of ``rest``, and zero
between. It stores k_1 s^2 / 2 + k_2 s^3 / 3 + ... and dissipates (c_1 + c_2 |l'| + ...) l'^2.
When: tendons and belts over several joints, springs and dampers of one joint that are not
linear, play.
"""

from dataclasses import dataclass
from numbers import Real
from typing import Tuple, Union

from .along_joints import AlongJoints
from .element import DISSIPATED, ForceElement, State
from .force_law import EVENT, force_law, NO_GAP
from .limits import beyond
from ..mechanism.checks import list_of, number
from ..mechanism.fields import FieldError, shown

# Most coefficients of a spring, and of a damper.
MOST = 8


def _coefficients(value):
    """Return a number as a tuple of one float, a list as one of all."""
    found = list_of(number)((value,) if isinstance(value, Real) else value)
    if len(found) > MOST:
        raise FieldError(f'at most {MOST} coefficients', f'{len(found)}')
    return found


def _range(value):
    """Return two floats that do not fall; a number is both."""
    found = list_of(number)((value, value) if isinstance(value, Real) else value)
    if len(found) != 2 or found[0] > found[1]:
        raise FieldError('a number, or [least, largest]', shown(value))
    return found


@dataclass(frozen=True)
class Tendon(AlongJoints):
    """
    Spring and damper along a weighted sum of joint coordinates.

    Attributes
    ----------
    arms : dict of str to float
        r, moment arms by joint, of the tree and with one number [m/rad; 1 of slides].
    stiffness : float, or tuple of floats
        k_1, k_2 and so on [N/m, N/m^2]; one number is k_1.
    damping : float, or tuple of floats
        c_1, c_2 and so on [N s/m, N s^2/m^2]; one number is c_1.
    rest : float, or tuple of 2 floats
        Least and largest l without a force of the spring [m]; one number is both.

    """

    CHECKS = {**AlongJoints.CHECKS, 'stiffness': _coefficients, 'damping': _coefficients,
              'rest': _range}
    READINGS = ('tension', 'length')

    stiffness: Union[float, Tuple[float, ...]] = 0.0
    damping: Union[float, Tuple[float, ...]] = 0.0
    rest: Union[float, Tuple[float, float]] = 0.0

    def element(self, machine):
        """Return the effect as a row of the table."""
        springs, dampers = (
            (*one, *(MOST - len(one)) * (0.0,)) for one in (self.stiffness, self.damping))
        return ForceElement(
            elastic_tendon, **self.along(machine),
            values=(*self.rest, float(len(self.stiffness)), float(len(self.damping))),
            states=(State(DISSIPATED),), gap=EVENT if self.rest[0] < self.rest[1] else NO_GAP,
            data=(self.lengths, springs, dampers))


@force_law(terms=lambda row: (*row.values[2:4].astype(int).tolist(),
                              bool(row.values[0] < row.values[1])))
def elastic_tendon(forces):
    (least, most), tendon = forces.values[:2], forces.joint
    springs, dampers, plays = forces.terms or (MOST, MOST, True)
    length, rate = tendon.value, tendon.rate
    stretch = length - least
    if plays:
        sign, depth, _ = beyond(forces, length, rate, least, most)
        stretch = sign * depth
    tension, stored, power = 0.0, 0.0, stretch
    for exponent, stiffness in enumerate(forces.entries(0, springs), start=2):
        tension = tension + stiffness * power
        power = power * stretch
        stored = stored + stiffness / exponent * power
    power, viscous = rate, 0.0
    for damping in forces.entries(MOST, dampers):
        viscous = viscous + damping * power
        power = power * abs(rate)
    tendon.push(-(tension + viscous))
    forces.store(stored)
    forces.flow(viscous * rate)
    forces.read(tension + viscous, length)
