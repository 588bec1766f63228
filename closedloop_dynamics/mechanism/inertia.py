# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Moments of inertia as users write them, and as a matrix."""

import numpy as np

# Where xx, yy, zz, xy, xz, yz are in the matrix.
_PLACES = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)


def inertia_matrix(inertia):
    """
    Return an inertia as a matrix, shape (3, 3) [kg m^2].

    Given as ``Body`` has it in space: xx, yy, zz, xy, xz, yz, the elements of the matrix; what is
    not given is zero.
    """
    values = np.zeros(6)
    values[:np.size(inertia)] = inertia
    xx, yy, zz, xy, xz, yz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def second_moments(body):
    """
    Return the integral of x x^T dm of a body about its centre of mass, shape (d, d) [kg m^2].

    In space tr(I)/2 1 - I; in the plane, where the sum alone is known, I/2 along both axes.
    """
    if len(body.center_of_mass) == 2:
        return 0.5 * body.inertia * np.eye(2)
    inertia = inertia_matrix(body.inertia)
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def moments_in(matrix):
    """Return xx, yy, zz, xy, xz, yz of a matrix, shape (6,)."""
    return matrix[_PLACES]
