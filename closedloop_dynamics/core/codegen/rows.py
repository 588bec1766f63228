# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
What a row of ``Workspace.body`` says of its body, as the recursions have it.

Which columns hold what is told by ``plane`` and by ``space``; components that a planar row does
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
