# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Sines and cosines of several angles at once, as LLVM vectors.

One call of the C library costs as much as thirty additions; a mechanism needs the sine and the
cosine of every body's angle, which are known before all else. Cody and Waite's reduction
by multiples of pi/2 and the minimax polynomials of FreeBSD's msun library (k_sin.c, k_cos.c),
good to one unit in the last place.

"""

from llvmlite import ir

_DOUBLE, _WORD = ir.DoubleType(), ir.IntType(64)
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


def write(builder, angles):
    """
    Write the code for the sines and cosines of some angles.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Left in the block where both are known.
    angles : sequence of double values
        [rad].

    Returns
    -------
    sines, cosines : list of double values

    """
    count = len(angles)
    vector = ir.VectorType(_DOUBLE, count)
    packed = ir.Constant(vector, ir.Undefined)
    for n, angle in enumerate(angles):
        packed = builder.insert_element(packed, angle, ir.IntType(32)(n))
    function = builder.function
    quick, slow, after = (function.append_basic_block() for _ in range(3))
    good = builder.icmp_unsigned(
        '==', builder.bitcast(within(builder, packed, vector), ir.IntType(count)),
        ir.IntType(count)(-1))
    builder.cbranch(good, quick, slow)
    builder.position_at_end(quick)
    quick_sine, quick_cosine = polynomials(builder, packed, vector)
    builder.branch(after)
    builder.position_at_end(slow)
    slow_sine, slow_cosine = (_library(builder, name, angles, vector) for name in ('sin', 'cos'))
    builder.branch(after)
    builder.position_at_end(after)
    results = []
    for fast, exact in ((quick_sine, slow_sine), (quick_cosine, slow_cosine)):
        joined = builder.phi(vector)
        joined.add_incoming(fast, quick)
        joined.add_incoming(exact, slow)
        results.append(joined)
    return [[builder.extract_element(result, ir.IntType(32)(n)) for n in range(count)]
            for result in results]


def _library(builder, name, angles, vector):
    """Ask the C library, one angle after the other."""
    module = builder.module
    function = module.globals.get(f'llvm.{name}.f64') or ir.Function(
        module, ir.FunctionType(_DOUBLE, [_DOUBLE]), f'llvm.{name}.f64')
    packed = ir.Constant(vector, ir.Undefined)
    for n, angle in enumerate(angles):
        packed = builder.insert_element(packed, builder.call(function, [angle]),
                                        ir.IntType(32)(n))
    return packed


def within(builder, angle, vector):
    """
    Write the code that decides for which angles the polynomials hold.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Where it goes.
    angle : vector value
        [rad].
    vector : llvmlite.ir.VectorType
        Its type.

    Returns
    -------
    vector of bits

    """
    largest, least = (ir.Constant(vector, [limit] * vector.count)
                      for limit in (LARGEST, -LARGEST))
    return builder.and_(builder.fcmp_ordered('<', angle, largest),
                        builder.fcmp_ordered('>', angle, least))


def polynomials(builder, angle, vector):
    """
    Reduce angles to a quarter turn around zero, and sum up both series.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Where the code goes.
    angle : vector value
        [rad], ``within`` the limits.
    vector : llvmlite.ir.VectorType
        Its type.

    Returns
    -------
    sine, cosine : vector values

    """
    count = vector.count

    def constant(value):
        return ir.Constant(vector, [value] * count)

    def times(first, second):
        return builder.fmul(first, second, flags=('contract',))

    def plus(first, second):
        return builder.fadd(first, second, flags=('contract',))

    def minus(first, second):
        return builder.fsub(first, second, flags=('contract',))

    shifted = builder.fadd(builder.fmul(angle, constant(0.6366197723675814)), constant(ROUNDER))
    quarter = builder.bitcast(shifted, ir.VectorType(_WORD, count))
    turns = builder.fsub(shifted, constant(ROUNDER))
    # x + tail is what is left: the products are exact, so are both differences but the last.
    near = minus(angle, times(turns, constant(PARTS[0])))
    part = times(turns, constant(PARTS[1]))
    x = builder.fsub(near, part)
    tail = builder.fsub(builder.fsub(builder.fsub(near, x), part),
                        times(turns, constant(PARTS[2])))
    # Both series take the tail to first order only: it must be the rounding of x.
    coarse = x
    x = builder.fadd(coarse, tail)
    tail = builder.fadd(builder.fsub(coarse, x), tail)
    z = times(x, x)
    series = constant(SINE[0])
    for coefficient in SINE[1:-1]:
        series = plus(times(series, z), constant(coefficient))
    # sin(x + tail) = x + (x^3 (S + z series) + tail (1 - z / 2))
    series = plus(constant(SINE[-1]), times(z, series))
    sine = plus(x, plus(times(times(z, x), series),
                        times(tail, minus(constant(1.0), times(constant(0.5), z)))))
    series = constant(COSINE[0])
    for coefficient in COSINE[1:]:
        series = plus(times(series, z), constant(coefficient))
    # cos(x + tail) = 1 - z / 2 + (z^2 series - x tail), the rounding of 1 - z / 2 kept.
    half = builder.fmul(constant(0.5), z)
    coarse = builder.fsub(constant(1.0), half)
    lost = builder.fsub(builder.fsub(constant(1.0), coarse), half)
    cosine = plus(coarse, plus(lost, minus(times(times(z, z), series), times(x, tail))))
    return _turned(builder, quarter, sine, cosine, vector)


def _turned(builder, quarter, sine, cosine, vector):
    """Bring the results back to the quarter turn that the angle is in."""
    words = ir.VectorType(_WORD, vector.count)

    def constant(value):
        return ir.Constant(words, [value] * vector.count)

    odd = builder.icmp_unsigned('!=', builder.and_(quarter, constant(1)), constant(0))
    sign = builder.shl(builder.and_(quarter, constant(2)), constant(62))
    other = builder.shl(
        builder.and_(builder.add(quarter, constant(1)), constant(2)), constant(62))

    def signed(value, bits):
        return builder.bitcast(
            builder.xor(builder.bitcast(value, words), bits), vector)

    return (signed(builder.select(odd, cosine, sine), sign),
            signed(builder.select(odd, sine, cosine), other))
