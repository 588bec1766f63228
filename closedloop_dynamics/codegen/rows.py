# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Kinematics, inertia and force of a body in its row of ``Workspace.body``.

Columns that ``plane`` and ``space`` fill; components that a planar row does
not have are zero.
"""


def six(row, columns):
    """
    Return a wrench, or a spatial velocity or acceleration, of a row of numbers or symbols.

    ``columns``, where each component is: ``FORCES``, ``SHARES`` or ``CHANGES``.
    """
    return tuple(row[columns[n]] if n in columns else 0.0 for n in range(6))


def matrix(row, columns):
    """
    Return an inertia, 6 rows of 6, of a row of numbers or symbols.

    ``columns``, where each component above the diagonal is: ``INERTIAS``.
    """
    places = [[columns.get((min(m, n), max(m, n))) for n in range(6)] for m in range(6)]
    return tuple(tuple(0.0 if place is None else row[place] for place in places_of_row)
                 for places_of_row in places)


def by_column(values, columns):
    """Return the components of a wrench, motion or inertia by column, as ``six`` or ``matrix``."""
    return {place: values[at[0]][at[1]] if isinstance(at, tuple) else values[at]
            for at, place in columns.items()}


def motion_of(row, columns, ground):
    """
    Return the kinematics in a row of symbols of ``Workspace.body``.

    ``columns``, where the components of each part are, rows of the frame one after the other:
    ``MOTION``. What the row does not have is as in the ground's; components that are not kept are
    zero.
    """
    found = {}
    for part, places in columns.items():
        values = tuple(0.0 if place is None else row[place] for place in places)
        if part == 'angle':
            found[part], = values
            continue
        size = len(_flat(part, getattr(ground, part)))
        values += (size - len(values)) * (0.0,)
        found[part] = (values[:3], values[3:6], values[6:]) if part == 'frame' else values
    return ground._replace(**found)


def columns_of(motion, columns):
    """Return the parts of a body's kinematics by column, as for ``motion_of``."""
    return {place: value for part, places in columns.items()
            for place, value in zip(places, _flat(part, getattr(motion, part)))
            if place is not None}


def _flat(part, value):
    return (value,) if part == 'angle' else sum(value, ()) if part == 'frame' else value
