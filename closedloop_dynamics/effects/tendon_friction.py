# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Dry friction along a weighted sum of joint coordinates, as of a tendon in its sheath.

    l = sum_j r_j q_j        tau_j = -r_j F sign(l')    on each joint of ``arms``

While l rests the force is what keeps it there, F at the most, as in ``joint_friction``: nothing
creeps, and steps end where the tendon comes to rest or breaks away. When: tendons over several
joints, belts that rub, friction between two links that a parallel mechanism joins.
"""

from dataclasses import dataclass

from .along_joints import AlongJoints
from .dry_friction import direction_of, friction_element
from ..mechanism.checks import not_negative


@dataclass(frozen=True)
class TendonFriction(AlongJoints):
    """
    Coulomb friction along a weighted sum of joint coordinates.

    Attributes
    ----------
    arms : dict of str to float
        r, moment arms by joint, of the tree and with one number [m/rad; 1 of slides].
    coulomb : float
        F, zero or more [N].

    """

    CHECKS = {**AlongJoints.CHECKS, 'coulomb': not_negative}
    READINGS = ('force',)
    ENDS_STEPS = True

    coulomb: float = 0.0

    @property
    def friction_direction(self):
        """Return the arms by freedoms, as a tuple of pairs."""
        return tuple(self.arms.items())

    def element(self, machine):
        """Return the effect as a row of the table."""
        # That of a joint whose limit is F at all rates, and which feels no reaction.
        return friction_element(self, machine, (self.coulomb, 1.0, 1.0, 0.0),
                                data=(self.lengths,), **self.along(machine))

    def direction(self, rate):
        """Return the direction in which the tendon slides at a rate; 0 at rest."""
        return direction_of(rate)
