# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
End stops of a joint: springs with damping that act only beyond the limits.

    beyond ``upper``:  tau = -k d max(0, 1 + c d')   d = q - upper,  d' = qd
    below ``lower``:   tau = +k d max(0, 1 + c d')   d = lower - q,  d' = -qd

The damping grows with the depth, so that the torque neither jumps at contact nor ever pulls
(Hunt and Crossley 1975). It stores k d^2 / 2. A stop of restitution e at impact
rate v has about c = 3 (1 - e) / (2 v), for e near 1. When: buffers, hard stops, the end of a
cylinder's stroke.
"""

from dataclasses import dataclass
import math
from typing import Optional

from .effect import Effect
from .element import DISSIPATED, ForceElement, State
from .force_law import BOUNDARY, force_law
from .limits import beyond
from ..codegen.expression_graph import larger
from ..mechanism.checks import freedom, not_negative, number, positive
from ..mechanism.fields import FieldError


@dataclass(frozen=True)
class EndStop(Effect):
    """
    End stops of a joint.

    Attributes
    ----------
    joint : str
    lower, upper : float or None
        Where the stops begin [rad; m]; None for no stop on that side.
    stiffness : float
        k, positive [N m/rad; N/m in a prismatic joint].
    damping : float
        c, zero or more [s/rad; s/m].

    """

    CHECKS = {'joint': freedom, 'stiffness': positive, 'damping': not_negative, 'lower': number,
              'upper': number}
    READINGS = ('torque', 'depth')

    joint: str
    stiffness: float
    lower: Optional[float] = None
    upper: Optional[float] = None
    damping: float = 0.0

    def __post_init__(self):
        """Refuse invalid values, and stops with no range between them."""
        super().__post_init__()
        if self.lower is None and self.upper is None:
            raise FieldError('lower, upper or both', 'neither', path=('lower',))
        if None not in (self.lower, self.upper) and not self.lower < self.upper:
            raise FieldError(f'more than lower ({self.lower:g})', f'{self.upper:g}',
                             path=('upper',))

    def element(self, machine):
        """Return the effect as a row of the table."""
        return ForceElement(end_stop, joints=(machine.joint(self.joint),), values=(
            self.stiffness, -math.inf if self.lower is None else self.lower,
            math.inf if self.upper is None else self.upper, self.damping),
            states=(State(DISSIPATED),), gap=BOUNDARY)


@force_law()
def end_stop(forces):
    stiffness, lower, upper, damping = forces.values[:4]
    joint = forces.joint
    sign, depth, rate = beyond(forces, joint.value, joint.rate, lower, upper)
    elastic = stiffness * depth
    push = elastic * larger(1.0 + damping * rate, 0.0)
    joint.push(-(sign * push))
    forces.store(0.5 * elastic * depth)
    forces.flow((push - elastic) * rate)
    forces.read(-(sign * push), depth)


def stops_of(effects):
    """Return lower and upper end of joints [rad; m] that have both, from effects by name."""
    return {effect.joint: (effect.lower, effect.upper) for effect in effects.values()
            if isinstance(effect, EndStop) and None not in (effect.lower, effect.upper)}
