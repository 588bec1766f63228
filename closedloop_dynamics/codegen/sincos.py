# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Sines and cosines of several angles at once, as LLVM vectors.

One call of the C library costs as much as thirty additions; a mechanism needs the sine and the
cosine of every body's angle, which are known before all else. Cody and Waite's reduction
by multiples of pi/2 and the minimax polynomials of FreeBSD's msun library (k_sin.c, k_cos.c),
good to one unit in the last place.
"""

import functools
from functools import partial

from .llvm_text import DOUBLE, integer, numbers, repeated, vector_of, WORD

# pi/2 in three parts of 33 bits: their products with integers below 2^20 are exact.
PARTS = (1.57079632673412561417e+00, 6.07710050630396597660e-11, 2.02226624871116645580e-21)
SINE = (1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
        -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01)
COSINE = (-1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
          2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02)
# Added and subtracted, it rounds to an integer, whose last bits are the last of the sum.
ROUNDER = 6755399441055744.0
# Angles beyond are left to the C library: 260,000 turns.
LARGEST = 1.6e6


def write(function, groups):
    """
    Write the code for the sines and cosines of groups of angles [rad], a vector of each group.

    Returns the vectors of sines and those of cosines. The function is left in the block where
    both are known.
    """
    packed = [function.gather(angles) for angles in groups]
    quick, slow, known = function.blocks('quick', 'slow', 'known')
    function.branch_if(functools.reduce(partial(function.binary, 'and'), (
        function.compare('icmp eq', function.convert(
            'bitcast', within(function, one, len(angles)), f'i{len(angles)}'),
            integer(-1, f'i{len(angles)}'))
        for one, angles in zip(packed, groups))), quick, slow)
    function.begin(quick)
    fast = [polynomials(function, one, len(angles)) for one, angles in zip(packed, groups)]
    function.branch(known)
    function.begin(slow)
    exact = [[function.gather([function.call(f'llvm.{name}.f64', [angle]) for angle in angles])
              for name in ('sin', 'cos')] for angles in groups]
    function.branch(known)
    function.begin(known)
    return zip(*([function.joined({quick: one, slow: other}) for one, other in zip(*both)]
                 for both in zip(fast, exact)))


def within(function, angle, count):
    """
    Write the code that decides for which of ``count`` angles [rad] the polynomials hold.

    Returns a vector of bits.
    """
    return function.binary(
        'and', function.compare('fcmp olt', angle, numbers([LARGEST] * count)),
        function.compare('fcmp ogt', angle, numbers([-LARGEST] * count)))


def polynomials(function, angle, count):
    """
    Reduce ``count`` angles ``within`` the limits [rad] to a quarter turn, and sum up both series.

    Returns sine and cosine, vectors.
    """
    def constant(value):
        return numbers([value] * count)

    exact = function.binary
    times, plus, minus = (
        partial(function.contracted, operation) for operation in ('fmul', 'fadd', 'fsub'))

    shifted = exact(
        'fadd', exact('fmul', angle, constant(0.6366197723675814)), constant(ROUNDER))
    quarter = function.convert('bitcast', shifted, vector_of(WORD, count))
    turns = exact('fsub', shifted, constant(ROUNDER))
    # x + tail is the remainder: the products are exact, so are both differences but the last.
    near = minus(angle, times(turns, constant(PARTS[0])))
    part = times(turns, constant(PARTS[1]))
    x = exact('fsub', near, part)
    tail = exact('fsub', exact('fsub', exact('fsub', near, x), part),
                 times(turns, constant(PARTS[2])))
    z = times(x, x)
    zz, xz = times(z, z), times(x, z)

    def series(coefficients):
        """Sum a series up in pairs, which waits for less than one after the other."""
        high, middle, low = (plus(times(constant(first), z), constant(second))
                             for first, second in zip(coefficients[::2], coefficients[1::2]))
        return plus(times(zz, plus(times(zz, high), middle)), low)

    # The tail is of the size of x's rounding, of large angles more: it is multiplied by the
    # derivatives, which are 1 - z / 2 + z^2 / 24 and x - x^3 / 6 but for what it is too small for.
    half = exact('fmul', constant(0.5), z)
    coarse = exact('fsub', constant(1.0), half)
    sine = plus(x, plus(times(xz, series(SINE)), times(
        tail, plus(coarse, times(zz, constant(1.0 / 24.0))))))
    # The rounding of 1 - z / 2 is kept.
    lost = exact('fsub', exact('fsub', constant(1.0), coarse), half)
    cosine = plus(coarse, plus(times(zz, series(COSINE)), minus(lost, times(
        tail, minus(x, times(xz, constant(1.0 / 6.0)))))))
    return _turned(function, quarter, sine, cosine, count)


def _turned(function, quarter, sine, cosine, count):
    """Bring the results back to the quarter turn that the angle is in."""
    def constant(value):
        return repeated(value, WORD, count)

    def sign(number):
        """Return the last but one bit of an integer, as that of a sign."""
        return function.binary(
            'shl', function.binary('and', number, constant(2)), constant(62))

    def signed(value, bits):
        return function.convert('bitcast', function.binary(
            'xor', function.convert('bitcast', value, bits[0]), bits), vector_of(DOUBLE, count))

    odd = function.compare('icmp ne', function.binary('and', quarter, constant(1)), constant(0))
    first = sign(quarter)
    second = sign(function.binary('add', quarter, constant(1)))
    return (signed(function.select(odd, cosine, sine), first),
            signed(function.select(odd, sine, cosine), second))
