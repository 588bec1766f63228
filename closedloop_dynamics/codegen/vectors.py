# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Vectors and matrices of three numbers, each a float or a symbol.

Plain functions on tuples: numbers that are exactly 0 or 1 vanish from the expression graph, so
that what is written for space costs nothing in the plane. A wrench or a motion is a tuple of six
numbers, the angular part first.
"""

ZERO = (0.0, 0.0, 0.0)
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def in_space(vector):
    """Return a vector in space, with zeros for the components that the plane lacks."""
    return (*vector, *(3 - len(vector)) * (0.0,))


def add(a, b):
    return tuple(x + y for x, y in zip(a, b))


def subtract(a, b):
    return tuple(x - y for x, y in zip(a, b))


def scale(a, factor):
    """Return a times a number."""
    return tuple(x * factor for x in a)


def negate(a):
    """Return -a, zeros without a sign."""
    return tuple(0.0 - x for x in a)


def dot(a, b):
    """Return the inner product."""
    total = 0.0
    for x, y in zip(a, b):
        total = total + x * y
    return total


def cross(a, b):
    """Return the vector product of two vectors of three numbers."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def times(matrix, vector):
    return tuple(dot(row, vector) for row in matrix)


def transpose(matrix):
    return tuple(zip(*matrix))


def product(a, b):
    """Return the product of two matrices."""
    columns = transpose(b)
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def symmetric(entry, size=3):
    """Return a symmetric matrix of ``entry(i, j)``, called for i <= j only."""
    upper = {(i, j): entry(i, j) for i in range(size) for j in range(i, size)}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in range(size)) for i in range(size))


def skew(a):
    """Return the matrix of the vector product with a vector from the left."""
    x, y, z = a
    return ((0.0, 0.0 - z, y), (z, 0.0, 0.0 - x), (0.0 - y, x, 0.0))


def in_blocks(one, beside, other):
    """Return a symmetric matrix of six rows of its blocks; ``beside``: the one at the right."""
    return tuple(tuple(a) + tuple(b) for a, b in (
        *zip(one, beside), *zip(transpose(beside), other)))


def is_number(value, number):
    """Return whether a value is a given number whatever the inputs."""
    return isinstance(value, float) and value == number


def is_zero(values):
    """Return whether all values are zero whatever the inputs."""
    return all(is_number(value, 0.0) for value in values)
