# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Runge-Kutta methods as data: one kernel runs them all.

Sources: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed.
(1993), sections II.1, II.5 and II.10.
"""

from typing import NamedTuple

import numpy as np

from . import dop853_coefficients as dop853


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method."""

    # Shape (stages, stages): row i weighs the slopes that stage i starts from. Rows beyond
    # ``steps`` are only for dense output.
    a: np.ndarray
    b: np.ndarray  # Shape (steps,): weights of the result
    # Shape (2, stages): weights of the error estimate and of the coarser one that steadies
    # it (zero if there is none); all zero for a method without error estimate.
    error: np.ndarray
    # Shape (stages, degree): weights of the slopes in the polynomial of dense output, by
    # powers of the share of the step from 1 up.
    dense: np.ndarray
    order: int
    error_order: int  # Order of the error estimate's own method, for step size control


def _tableau(rows, b, order, error=(), dense=(), error_order=0):
    stages = len(rows)
    a = np.zeros((stages, stages))
    for i, row in enumerate(rows):
        a[i, :len(row)] = row
    weights = np.zeros((2, stages))
    for row, values in zip(weights, error):
        row[:len(values)] = values
    polynomial = np.array(dense, dtype=float) if len(dense) else np.zeros((stages, 0))
    return Tableau(a, np.array(b, dtype=float), weights, np.ascontiguousarray(polynomial), order,
                   error_order)


def _heun():
    return _tableau([[], [1.0]], [0.5, 0.5], 2)


def _rk4():
    return _tableau([[], [1 / 2], [0.0, 1 / 2], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6], 4)


def _dopri5():
    """Return Dormand and Prince's pair of order 5(4), section II.5, table 5.2."""
    b = [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]
    rows = [
        [],
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        b]
    embedded = [5179 / 57600, 0.0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40]
    error = np.array([*b, 0.0]) - embedded
    return _tableau(rows, b, 5, [error], _dopri5_dense(np.array([*b, 0.0])), 4)


def _dopri5_dense(b):
    """Return the dense output of order 4, section II.6: Hermite, and one more condition."""
    d = np.array([
        -12715105075 / 11282082432, 0.0, 87487479700 / 32700410799, -10690763975 / 1880347072,
        701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423])
    first, last = np.eye(7)[0], np.eye(7)[6]
    # u(s) = s (b + (1-s) (first - b + s (2b - first - last + (1-s) d))), by powers of s.
    hermite = 2.0 * b - first - last
    return np.stack([
        first, -first + b + hermite + d, -hermite - 2.0 * d, d], axis=1)


def _dop853():
    """Return Dormand and Prince's method of order 8(5,3), section II.10."""
    stages = dop853.A.shape[0]
    rows = [dop853.A[i, :i] for i in range(stages)]
    return _tableau(rows, dop853.B, 8, [dop853.E5, dop853.E3], _dop853_dense(), 7)


def _dop853_dense():
    """Return the dense output of order 7 by powers of the share of the step."""
    stages = dop853.A.shape[0]
    b = np.zeros(stages)
    b[:len(dop853.B)] = dop853.B
    first, last = np.eye(stages)[0], np.eye(stages)[len(dop853.B)]
    nested = [b, first - b, 2.0 * b - first - last, *dop853.D]
    # Nested factors s, 1-s, s, 1-s, ... of the interpolation polynomial.
    polynomial = np.zeros((stages, 8))
    factor = np.polynomial.Polynomial([1.0])
    for k, weights in enumerate(nested):
        factor = factor * np.polynomial.Polynomial([0.0, 1.0] if k % 2 == 0 else [1.0, -1.0])
        coefficients = factor.coef
        polynomial[:, :len(coefficients)] += np.outer(weights, coefficients)
    return polynomial[:, 1:]


HEUN, RK4, DOPRI5, DOP853 = _heun(), _rk4(), _dopri5(), _dop853()
