# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects, each compiled by itself, from the symbols that the code of a scene is made of.

They act where that code does not (``scene_code``). One routine serves all effects of a kind,
whatever terms they have: a change of these compiles nothing.
"""

from .force_law import INERTIA, MOTION, PROFILE
from ..codegen import plane, space
from ..codegen.function_table import VALUE_COLUMNS
from ..codegen.law_routine import addresses_of_laws, RowTrace
from ..engine import native

# What the engine knows of routines, by their addresses.
_known = set()


def routines_of(rows, spatial):
    """Return the addresses of the routines of laws, 0 where the engine has it; see ``Row``."""
    keys = [None if row.law.role == INERTIA else _key(row, spatial) for row in rows]
    found = addresses_of_laws({
        key: (lambda row=row: _trace(row, spatial)) for key, row in zip(keys, rows) if key})
    for key, row in zip(keys, rows):
        if key and found[key] not in _known:
            native.keep_law(found[key], *_needs(row, spatial))
            _known.add(found[key])
    return [found[key] if key else 0 for key in keys]


def _key(row, spatial):
    """Return what the routine of a row's law depends on."""
    return (row.law.name, _coordinates(row), len(row.bodies), bool(row.bodies) and spatial,
            *row.law.parts(row))


def _coordinates(row):
    """Return how many coordinates of joints a law reads."""
    return min(1, row.summed) or len(row.joints)


def _needs(row, spatial):
    """Return what a row that has the routine must have: ``engine/laws.hpp``."""
    law = row.law
    read_one_by_one = 0 if law.listed or law.role in (PROFILE, MOTION) else len(row.data)
    return (_coordinates(row), len(row.bodies), row.states, read_one_by_one, law.listed, spatial)


def _trace(row, spatial):
    """Return the trace of a law for any row of its kind."""
    return RowTrace(space if row.bodies and spatial else plane, VALUE_COLUMNS,
                    _coordinates(row), row)
