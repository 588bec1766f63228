# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Ranks of matrices without units, against 1: the size of what is no rounding in them.

A Jacobian becomes one by ``Equations.dimensionless``. Where equations hold anyway all of it is
rounding, so that its own largest singular value is nothing to compare with.
"""

import numpy as np

# Singular values below this, or below this times the largest, belong to dependent equations: axes
# that were written with six digits are parallel to 1e-6 rad.
RANK_TOLERANCE = 3e-6


def singular_values(matrix):
    """Return the singular values of a matrix, a single 0 of one without entries."""
    return np.linalg.svd(matrix, compute_uv=False) if matrix.size else np.zeros(1)


def rank_of(matrix, tolerance=RANK_TOLERANCE):
    """Return the number of independent rows of a matrix without units, as ``rank_from``."""
    return rank_from(singular_values(matrix), tolerance)


def rank_from(singular, tolerance=RANK_TOLERANCE):
    """Return the rank of a matrix without units by its singular values."""
    return int(np.sum(singular > tolerance * singular.max(initial=1.0)))


def null_space(matrix):
    """Return the orthonormal rows that span what a matrix without units maps to zero."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, singular, right = np.linalg.svd(matrix)
    return right[rank_from(singular):]
