# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The effects of a scene on symbols, for derivatives and C.

Those whose laws have no jumps (``smooth_laws``), and laws of users without events and states of
their own; forces over time, at an instant. The numbers of a row are loads; those of its entries
are constants of the code.
"""

from functools import partial

import numpy as np

from . import force_table, user_laws
from .registry import effect_type
from .smooth_laws import FORCE_TABLES, LAWS, push_along
from .table import (
    ENTRIES, entries_of, FIRST, PRESCRIBED_FORCE, PRESCRIBED_TORQUE, SECOND,
    SPATIAL_PRESCRIBED_FORCE, SPATIAL_TRACED, STATE, TENDON, TRACED, VALUE_COLUMNS)
from ..core.codegen.expression_graph import chosen

# Why other effects have no law here, by the name of their type.
_REASONS = {
    'joint_friction': 'dry friction jumps where a joint comes to rest',
    'tendon_friction': 'dry friction jumps where a tendon comes to rest',
    'tendon_inertia': 'it acts on accelerations',
    'contact': 'its friction jumps with the sliding, and contacts begin within a step',
    'body_contact': 'which parts of the outlines touch is searched for',
    'cable': 'it slackens, and winds round pulleys',
    'actuator': 'its torque has limits and a state of its own',
    'prescribed_motion': 'it follows the time',
    'prescribed_force': 'it follows the time',
    'rotor': 'at a joint that closes a loop it acts on accelerations'}


def _prescribed_torque(forces, joint, _, values, force):
    forces.twist(joint, force)


def _prescribed_force(size):
    return lambda forces, body, _, values, force: push_along(forces, size, body, values, force)


FORCES_OVER_TIME = {
    PRESCRIBED_FORCE: _prescribed_force(2), PRESCRIBED_TORQUE: _prescribed_torque,
    SPATIAL_PRESCRIBED_FORCE: _prescribed_force(3)}


def refused(effects, instant=False, along=False):
    """
    Return which effects have no law here, and why, by the names of those switched on.

    ``instant``: whether the time is held; ``along``: whether derivatives are those of a motion.
    """
    found = {}
    for name, element in effects.by_name.items():
        kind = effect_type(effects.records[name])
        if not effects.enabled[name]:
            continue
        if element.kind in (TRACED, SPATIAL_TRACED):
            law = effects.records[name].traced
            reason = ('its force may jump at its event, within a step' if along and (
                law.gap is not None) else
                      'it follows the time' if law.follows_time and not instant else
                      'it has states of its own' if law.states else None)
            if reason is not None:
                found[name] = f'{kind}: {reason}'
        elif element.kind not in LAWS and not (instant and element.kind in FORCES_OVER_TIME):
            found[name] = f'{kind}: {_REASONS.get(kind, "only the engine has its law")}'
    return found


def act(table, forces, laws=None):
    """
    Apply the effects of a table, or of None, to forces.

    Kinds and indices of the table are read; numbers are the forces' symbols. ``laws``: those of
    users, by rows; where their points are is no input.
    """
    if table is None:
        return
    for row in np.flatnonzero(table.enabled):
        forces.row, forces.first = int(row), int(table.index[row, STATE])
        kind, values, constants = table.kind[row], forces.numbers(row), constants_of(table, row)
        if laws and row in laws:
            user_laws.apply(
                forces, laws[row], user_laws.measured_entries(table, row).tolist(), values,
                _present(forces, table, row) if laws[row].follows_time else None)
            continue
        last = constants
        if kind in FORCE_TABLES:
            last = partial(_look_up, constants)
        elif kind in FORCES_OVER_TIME:
            last = _present(forces, table, row)
        (LAWS | FORCES_OVER_TIME)[kind](
            forces, *table.index[row, [FIRST, SECOND]], values, last)


def _present(forces, table, row):
    """Return what is behind the numbers of all rows for this one: its force, or the time."""
    below, place = divmod(row, VALUE_COLUMNS)
    return forces.numbers(len(table.kind) + below)[place]


def constants_of(table, row):
    """
    Return the numbers of a row's entries, which are constants of the code.

    Of a tendon behind how many joints and coefficients there are, of which kind.
    """
    found = entries_of(table, row).tolist()
    if table.kind[row] != TENDON:
        return found
    return [float(table.index[row, ENTRIES] - 2), *table.values[row, :2].tolist(), *found]


def _look_up(constants, stroke):
    """Return force and energy at a stroke: of the last piece of a table that begins before it."""
    pieces = [constants[n:n + force_table.COLUMNS]
              for n in range(0, len(constants), force_table.COLUMNS)]
    start, a, b, c, d, energy = pieces[0]
    for piece in pieces[1:]:
        begun = stroke >= piece[0]
        start, a, b, c, d, energy = (
            chosen(begun, one, before) if one != before else before
            for one, before in zip(piece, (start, a, b, c, d, energy)))
    u = stroke - start
    return (a + u * (b + u * (c + u * d)),
            energy + u * (a + u * (b / 2.0 + u * (c / 3.0 + u * d / 4.0))))
