# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Inertia along a weighted sum of joint coordinates, as of a mass that a tendon carries.

    l = sum_j r_j q_j        tau_j = -r_j m l''    on each joint of ``arms``

The energy m l'^2 / 2 counts as kinetic, and the generalized inertia matrix has m r r^T beside its
own. It is found with the accelerations, by one evaluation more
(``engine/static_friction.hpp``). When: motors and weights that pull a tendon, a motor
whose rotor turns with the sum or difference of two joints (as in a differential drive).
"""

from dataclasses import dataclass

from .along_joints import AlongJoints
from .element import ForceElement
from .reflected_inertia import reflected_inertia
from ..mechanism.checks import not_negative


@dataclass(frozen=True)
class TendonInertia(AlongJoints):
    """
    Inertia along a weighted sum of joint coordinates.

    Attributes
    ----------
    arms : dict of str to float
        r, moment arms by joint, of the tree and with one number [m/rad; 1 of slides].
    inertia : float
        m, zero or more [kg].

    """

    ENERGY = 'kinetic_energy'
    CHECKS = {**AlongJoints.CHECKS, 'inertia': not_negative}
    READINGS = ('force',)

    inertia: float = 0.0

    def element(self, machine):
        """Return the effect as a row of the table."""
        return ForceElement(reflected_inertia, **self.along(machine), values=(self.inertia,),
                            data=(self.lengths,))
