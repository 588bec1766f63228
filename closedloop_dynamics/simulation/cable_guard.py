# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Cables that would leap by a turn round a pulley."""

import math

from ..mechanism.errors import NumericalError

# Steps between checks, in which no pulley makes a real turn.
CHECK_EVERY = 10
# A winding that changes by more between two checks has jumped by a whole turn [rad].
LEAP = 1.5 * math.pi
# A run that stops with a winding this near to its limits stops for that [rad].
NEAR = 1e-3
LIMITS = -0.5 * math.pi, 1.5 * math.pi


def explain(data):
    """Raise NumericalError where a run has stopped because a winding is at its limit."""
    for place, angle in data.windings().items():
        if min(abs(angle - limit) for limit in LIMITS) < NEAR:
            raise leapt(place, angle, data.time)


def leapt(place, angle, time):
    """Return the error to raise where a cable leaps by a turn of a pulley."""
    cable, pulley = place
    return NumericalError(
        f'The cable {cable} is wound round the pulley at {pulley} by '
        f'{math.degrees(angle):.3g} degrees at t = {time:.9g} s, the state of which is kept, '
        'and goes on beyond -90 or 270 degrees, where its length would leap by a turn. Let it '
        'run over more pulleys, or end the motion before.')
