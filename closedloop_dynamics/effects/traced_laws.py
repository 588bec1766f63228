# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The effects of a scene on symbols, for derivatives and C.

Those whose laws have no jumps, and laws of users without events and states of their own; forces
over time, at an instant. The numbers of a row are loads; those of its entries are constants of the
code.
"""

from .element import DISSIPATED, WORK
from .force_law import MOTION
from .registry import effect_type
from ..codegen.function_table import VALUE_COLUMNS


def refused(effects, instant=False, along=False, driven=False):
    """
    Return which effects have no law here, and why, by the names of those switched on.

    ``instant``: whether the time is held; ``along``: whether derivatives are those of a motion;
    ``driven``: whether prescribed motions are given from outside.
    """
    found = {}
    for name, element in effects.by_name.items():
        if not effects.enabled[name] or driven and element.law.role == MOTION:
            continue
        reason = element.law.refusal(instant, along)
        if reason is not None:
            found[name] = f'{effect_type(effects.records[name])}: {reason}'
    return found


def act(table, forces):
    """
    Apply the effects of a table, or of None, to forces.

    The structure of the table is read; numbers are the forces' symbols, but for those of entries.
    Prescribed motions are in the closure equations.
    """
    if table is None:
        return
    for row in table.enabled_rows:
        if row.law.role == MOTION:
            continue
        forces.turn_to(row, _held(forces, table, row.number) if row.law.follows_time else None)
        row.law.act(forces)


def powers(table, rates):
    """Return the power that effects dissipate, and that they bring in, of rates of states [W]."""
    roles = {} if table is None else {
        row.state + n: state.role for row in table.enabled_rows
        for n, state in enumerate(table.elements[row.number].states)}
    return tuple(sum((rate for state, rate in rates.items() if roles[state] == role), 0.0)
                 for role in (DISSIPATED, WORK))


def _held(forces, table, row):
    """Return what is behind the numbers of all rows for this one: its force, or the time."""
    below, place = divmod(row, VALUE_COLUMNS)
    return forces.numbers(len(table.role) + below)[place]
