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
The instants at which bodies begin to touch and part again.

Within a step a contact is there or not, whatever the sign of the gap, so that the motion is
smooth and what a step finds of the gap is right to its last digits. A step on which a gap changes
its sign is cut there: by a cubic through gap and rate at both ends, then by Newton's method. The
next step begins at once with the size that suits the new motion.

"""

import math

from ..core.compiled import inlined, merged
from ..effects.table import FREE, TOUCHING, UNDECIDED

# Gaps of less than this are none [m]: a contact begins or ends there.
CLOSED = 1e-11
# The least part of a step that is looked for.
LEAST_PART = 1e-6
# Halvings of the interval in which it is.
HALVINGS = 50


@merged
def begin(contacts, enabled):
    """
    Decide, after the evaluation at which a step begins, which bodies touch during it.

    Parameters
    ----------
    contacts : Contacts
        Of the table of effects.
    enabled : ndarray of int, shape (ne,)
        Which effects are switched on.

    Returns
    -------
    bool
        Whether any begin or cease to touch just here.

    """
    changed = False
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        if enabled[row] == 1:
            gap, rate = contacts.gap[row, 0], contacts.gap[row, 1]
            touches = gap < 0.0
            if abs(gap) <= 2.0 * CLOSED:
                changed = True
                touches = rate < 0.0
            contacts.mode[row] = TOUCHING if touches else FREE
            contacts.gap[row, 2] = gap
            contacts.gap[row, 3] = rate
    return changed


@merged
def end(contacts):
    """Let gaps decide again which bodies touch, after a step; ``contacts`` as for ``begin``."""
    for k in range(contacts.rows.shape[0]):
        contacts.mode[contacts.rows[k]] = UNDECIDED


@inlined
def _cubic(start, slope, bend, twist, share):
    """Return the gap at a share of a step."""
    return start + share * (slope + share * (bend + share * twist))


@inlined
def _crossing(gap, row, sign, size):
    """
    Return the share of a step at which a gap first has the sign that ends it; 1 if none.

    By the cubic that has the gaps and rates of both ends, between its turning points.

    """
    start, slope = sign * gap[row, 2], sign * size * gap[row, 3]
    rise, last = sign * gap[row, 0] - start, sign * size * gap[row, 1]
    bend, twist = 3.0 * rise - 2.0 * slope - last, slope + last - 2.0 * rise
    # Its turning points, where slope + 2 bend x + 3 twist x^2 = 0.
    one, other = 1.0, 1.0
    root = bend * bend - 3.0 * twist * slope
    if root >= 0.0:
        sum_of_two = -(bend + math.copysign(math.sqrt(root), bend))
        one = slope / sum_of_two if sum_of_two != 0.0 else 1.0
        other = sum_of_two / (3.0 * twist) if twist != 0.0 else 1.0
    before = 0.0
    for k in range(3):
        after = min(one, other) if k == 0 else max(one, other) if k == 1 else 1.0
        if before < after <= 1.0:
            if _cubic(start, slope, bend, twist, after) > CLOSED:
                for _ in range(HALVINGS):
                    middle = 0.5 * (before + after)
                    if _cubic(start, slope, bend, twist, middle) > 0.0:
                        after = middle
                    else:
                        before = middle
                return after
            before = after
    return 1.0


@merged
def part(contacts, enabled, size, sought):
    """
    Return the part of a step on which no contact begins or ends.

    Parameters
    ----------
    contacts, enabled
        As for ``begin``, after the evaluation of the state after the step.
    size : float
        Of the step [s].
    sought : int
        Row of the contact at whose change the step is to end; less than zero where none is.

    Returns
    -------
    part : float
        [s]; ``size`` where the step may be taken. Another one is to be tried; twice the size:
        the same once more.
    sought : int
        As given, or found now.

    """
    least, first = 1.0, -1
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        if row != sought and enabled[row] == 1 and contacts.mode[row] != UNDECIDED:
            sign = 1.0 if contacts.mode[row] == TOUCHING else -1.0
            share = _crossing(contacts.gap, row, sign, size)
            if share < least:
                least, first = share, row
    if first >= 0:
        if least > LEAST_PART:
            return least * size, first
        # It bounces too fast to be followed: once more, with the gap deciding.
        contacts.mode[first] = UNDECIDED
        return 2.0 * size, -2
    if sought >= 0:
        gap, rate = contacts.gap[sought, 0], contacts.gap[sought, 1]
        if abs(gap) > CLOSED and abs(gap) < 0.5 * size * abs(rate):
            return size - gap / rate, sought
    return size, sought
