# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Gravity: a uniform field acting at every centre of mass.

    F_i = m_i g        at the centre of mass of every body i

It stores the potential energy ``-sum_i m_i g . p_i``.
"""

from dataclasses import dataclass

from .effect import Effect
from ..mechanism.checks import vector
from ..mechanism.mechanism import Vector


@dataclass(frozen=True)
class Gravity(Effect):
    """
    Uniform gravity.

    Attributes
    ----------
    acceleration : tuple of 2 floats, or 3 in space
        The vector g in world axes [m/s^2]; ``(0.0, -9.81)`` pulls down, in space
        ``(0.0, 0.0, -9.81)`` where z points up.

    """

    CHECKS = {'acceleration': vector}
    VECTORS = ('acceleration',)

    acceleration: Vector

    def change(self, model, machine):
        """Add the field to the model, whose recursion starts from it: no force is computed."""
        model.gravity[:] += self.acceleration
