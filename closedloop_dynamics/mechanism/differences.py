# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Derivatives by differences: weights of values at whole steps from here.

Divided by the step (its square, of a second derivative), a weighted sum of the values is the
derivative here of the polynomial through them: exact but for rounding where what is differentiated
is a polynomial of no higher order.
"""

FIRST_4 = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
SECOND_4 = {-2: -1 / 12, -1: 16 / 12, 0: -30 / 12, 1: 16 / 12, 2: -1 / 12}
FIRST_6 = {-3: -1 / 60, -2: 3 / 20, -1: -3 / 4, 1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
# On one side alone, at the end of a range.
FORWARD_4 = {0: -25 / 12, 1: 4.0, 2: -3.0, 3: 4 / 3, 4: -1 / 4}
FORWARD_6 = {0: -49 / 20, 1: 6.0, 2: -15 / 2, 3: 20 / 3, 4: -15 / 4, 5: 6 / 5, 6: -1 / 6}


def derivative(stencil, step, values):
    """Return the first derivative of values, numbers or arrays, in the order of the stencil."""
    return sum(weight * value for weight, value in zip(stencil.values(), values)) / step


def nodes(make, step, tried, refused):
    """
    Return pairs of the weights of a derivative, and what a function makes at their distances.

    Parameters
    ----------
    make : callable
        Takes a distance from here.
    step : float
        Of the differences.
    tried : sequence of (dict, float)
        Stencils and shares of the step, of which the first one counts for which all can be made.
    refused : exception or tuple of exceptions
        By which it cannot; raised where that is so of all.

    """
    for stencil, share in tried:
        size = share * step
        try:
            return [(weight / size, make(offset * size)) for offset, weight in stencil.items()]
        except refused as error:
            reason = error
    raise reason
