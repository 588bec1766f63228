# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Limits at both ends of a range, beyond which a force acts, for laws on symbols."""

from ..codegen.expression_graph import chosen


def beyond(forces, value, rate, lower, upper):
    """
    Return how far a value is beyond one of two limits, zero between them.

    Its sign there, the depth and the rate of the depth; where the depth begins and ends there are
    events.
    """
    above, below = value - upper, lower - value
    low = below > above
    sign, depth = chosen(low, -1.0, 1.0), chosen(low, below, above)
    rate = sign * rate
    return sign, chosen(forces.touches(-depth, -rate), depth, 0.0), rate
