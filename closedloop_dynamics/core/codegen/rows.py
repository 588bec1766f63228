# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What a row of ``Workspace.body`` says of its body, as the recursions have it.

Columns that ``plane`` and ``space`` fill; components that a planar row does
not have are zero.

"""


def six(row, columns):
    """
    Return a wrench or a motion.

    Parameters
    ----------
    row : sequence
        Numbers or symbols.
    columns : dict of int to int
        Where each component is: ``FORCES``, ``SHARES`` or ``CHANGES``.

    Returns
    -------
    tuple of 6

    """
    return tuple(row[columns[n]] if n in columns else 0.0 for n in range(6))


def matrix(row, columns):
    """
    Return an inertia.

    Parameters
    ----------
    row : sequence
        Numbers or symbols.
    columns : dict of (int, int) to int
        Where each component above the diagonal is: ``INERTIAS``.

    Returns
    -------
    tuple of 6 tuples

    """
    places = [[columns.get((min(m, n), max(m, n))) for n in range(6)] for m in range(6)]
    return tuple(tuple(0.0 if place is None else row[place] for place in places_of_row)
                 for places_of_row in places)


def by_column(values, columns):
    """
    Return components by column.

    Parameters
    ----------
    values : tuple of 6, or of 6 tuples
        A wrench, a motion or an inertia.
    columns : dict
        As for ``six`` or ``matrix``.

    Returns
    -------
    dict of int to number

    """
    return {place: values[at[0]][at[1]] if isinstance(at, tuple) else values[at]
            for at, place in columns.items()}
