# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Stick-slip state of dry friction, and the direction of sliding."""

import math

# Rates below this are rest while a step is made, as in engine/sticking.hpp [rad/s; m/s].
REST = 1e-6


def direction_of(rate):
    """Return the direction of a rate, 1 or -1; 0 at rest."""
    return math.copysign(1.0, rate) if abs(rate) > REST else 0.0
