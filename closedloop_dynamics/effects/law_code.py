# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects, each compiled by itself, from the symbols that the code of a scene is made of.

They act where that code does not (``scene_code``). One routine serves all effects of a kind,
whatever terms they have: a change of these compiles nothing.
"""

from .force_law import COURSE, INERTIA, MOTION
from .table import Row, VALUE_COLUMNS
from ..core.codegen import plane, space
from ..core.codegen.law_routine import addresses_of_laws, RowTrace
from ..engine import native

# What the engine knows of routines, by their addresses.
_known = set()


def link(table):
    """Give a table the addresses of the routines of its laws; those missing are compiled."""
    rows = {number: Row(table, number) for number, law in enumerate(table.laws)
            if law.role != INERTIA}
    keys = {number: _key(row, table) for number, row in rows.items()}
    found = addresses_of_laws({
        keys[number]: (lambda row=row: _trace(row, table)) for number, row in rows.items()})
    for number, row in rows.items():
        table.routine[number] = address = found[keys[number]]
        if address not in _known:
            native.keep_law(address, *_needs(row, table))
            _known.add(address)


def _key(row, table):
    """Return what the routine of a row's law depends on."""
    return (row.law.name, _coordinates(row), len(row.bodies),
            bool(row.bodies) and _is_spatial(table), *row.law.parts(row))


def _coordinates(row):
    """Return how many coordinates of joints a law reads."""
    return min(1, row.summed) or len(row.joints)


def _is_spatial(table):
    return table.reaction.shape[1] == 12


def _needs(row, table):
    """Return what a row that has the routine must have: ``engine/laws.hpp``."""
    law = row.law
    read_one_by_one = 0 if law.listed or law.role in (COURSE, MOTION) else len(row.data)
    return (_coordinates(row), len(row.bodies), row.states, read_one_by_one, law.listed,
            _is_spatial(table))


def _trace(row, table):
    """Return the trace of a law for any row of its kind."""
    return RowTrace(space if row.bodies and _is_spatial(table) else plane, VALUE_COLUMNS,
                    _coordinates(row), row)
