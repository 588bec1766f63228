# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Angles of points in the plane, without a branch, of single numbers or in the lanes of a vector.

A call of the C library saves all that is in registers, and of a vector makes one of each lane.
The angle to the nearest axis is t + t^3 p(t^2) of the quotient t of the lesser coordinate by the
larger one; p is the minimax polynomial (Remez) of (atan(t) / t - 1) / t^2 on 0 to 1, whose error
is 3e-17 of the angle. It is summed up in pairs (Estrin's scheme), which waits least.
"""

from functools import partial
import math

from .llvm_text import DOUBLE, integer, number, numbers, repeated, vector_of, WORD

SERIES = (
    -0.33333333333332055, 0.19999999999776827, -0.14285714272255662, 0.11111110699531122,
    -0.09090901525819538, 0.07692215661612142, -0.06665878577125516, 0.05877396989875422,
    -0.05239561661348087, 0.046748742611576216, -0.04094642726996914, 0.03410139567338015,
    -0.025870159248045706, 0.017020758874126175, -0.00921607713523418, 0.0038728221512947464,
    -0.0011702314319331458, 0.00022440003840546867, -2.0400675298866947e-05)
# What pi/2 is more than its rounding.
REST = 6.123233995736766e-17
# The least positive double, and the bit of the sign.
LEAST, SIGN = 5e-324, -1 << 63
# A square so small changes nothing in the series; its powers are not denormal, which takes long.
SLIGHT = 1e-19


def write(function, y, x):
    """
    Write the code for the angle of (x, y) from -pi to pi [rad], to two units in the last place.

    As the C library's ``atan2``, of double values or vectors of them; the angle of two infinite
    ones is no number.
    """
    kind = y[0]
    count = 0 if kind == DOUBLE else int(kind[1:].split()[0])
    bits = vector_of(WORD, count) if count else WORD

    def constant(value):
        return numbers([value] * count) if count else number(value)

    def word(value):
        return repeated(value, WORD, count) if count else integer(value)

    def masked(operation, value, mask):
        return function.convert('bitcast', function.binary(
            operation, function.convert('bitcast', value, bits), mask), kind)

    def sign(value):
        return function.binary('and', function.convert('bitcast', value, bits), word(SIGN))

    def at_least(value, vector):
        return function.select(
            function.compare('fcmp ogt', constant(value), vector), constant(value), vector)

    exact = function.binary
    plus, times = (partial(function.contracted, operation) for operation in ('fadd', 'fmul'))
    across, along = (masked('and', value, word(~SIGN)) for value in (y, x))
    # Where one is no number, it is in the quotient.
    steep = function.compare('fcmp olt', along, across)
    lesser = function.select(steep, along, across)
    larger = at_least(LEAST, function.select(steep, across, along))
    # What the angle to the axis is added to, or subtracted from.
    behind = function.compare('icmp slt', function.convert('bitcast', x, bits), word(0))
    axis, rest = (function.select(steep, constant(quarter), function.select(
        behind, constant(2.0 * quarter), constant(0.0))) for quarter in (0.5 * math.pi, REST))
    turned = function.binary('xor', sign(x), function.select(steep, word(SIGN), word(0)))
    t = masked('xor', function.binary('fdiv', lesser, larger), turned)
    square = times(t, t)
    power = at_least(SLIGHT, square)
    terms = [constant(coefficient) for coefficient in SERIES]
    while len(terms) > 1:
        pairs = [plus(low, times(power, high)) for low, high in zip(terms[::2], terms[1::2])]
        terms = pairs + terms[2 * len(pairs):]
        power = times(power, power)
    angle = exact('fadd', axis, t)
    rest = plus(rest, exact('fadd', exact('fsub', axis, angle), t))
    cubic = times(times(t, square), terms[0])
    return masked('xor', plus(angle, plus(rest, cubic)), sign(y))
