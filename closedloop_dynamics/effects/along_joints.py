# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects along a weighted sum of joint coordinates, as of a tendon: l = sum_j r_j q_j."""

from dataclasses import dataclass
from typing import Dict

from .effect import Effect
from ..mechanism.checks import freedom, number, one_of
from ..mechanism.fields import at, FieldError, shown


def _arms(value):
    """Return a dict of floats by the names of joints, one or more; refuse anything else."""
    if not isinstance(value, dict) or not value:
        raise FieldError('moment arms by the names of joints', shown(value))
    found = {}
    for key, arm in value.items():
        with at(key):
            found[freedom(key)] = number(arm)
    return found


@dataclass(frozen=True)
class AlongJoints(Effect):
    """
    An effect along a weighted sum of joint coordinates.

    Attributes
    ----------
    arms : dict of str to float
        r, moment arms by joint, of the tree and with one number [m/rad; 1 of slides].

    """

    CHECKS = {'arms': _arms}

    arms: Dict[str, float]

    def fit(self, mechanism):
        """Refuse a mechanism without the joints."""
        super().fit(mechanism)
        for joint in self.arms:
            with at('arms'):
                one_of(mechanism.coordinates.single_names, 'one of the joints of the tree')(joint)

    def along(self, machine):
        """Return what a row of the table has of the sum: joints, their arms first in its data."""
        return {'joints': tuple(map(machine.joint, self.arms)), 'summed': True}

    @property
    def lengths(self):
        """Return the arms, as the first entry of a row's data."""
        return tuple(self.arms.values())
