# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of users on symbols, within code that is generated for a whole scene.

What ``engine/traced_laws.cpp`` does around the code of a law: it measures the coordinates, and
applies the forces along them.

"""

from functools import partial

from .smooth_laws import line_between, push_apart
from .table import entries_of, FIRST
from .traced_effect import (
    COLUMNS, COMPONENT, FIRST_COORDINATE, JOINT, MEASURED, PARAMETERS, SIDE, STATES, TIME)
from ..core.codegen.expression_graph import chosen, replayed
from ..core.codegen.vectors import dot

# Numbers of an entry that say what is measured: the others are places of points.
STRUCTURE = 3


def measured_entries(table, row):
    """Return the coordinates that a law measures, shape (coordinates, COLUMNS)."""
    return entries_of(table, row).reshape(-1, COLUMNS)[1:1 + table.index[row, FIRST]]


def apply(forces, law, entries, values, time=None, states=()):
    """
    Apply a law.

    Parameters
    ----------
    forces : core.codegen.scene_routines.Forces
        What it does is added there.
    law : traced_effect.Tracing
        Its arithmetic.
    entries : sequence of sequences
        As of ``measured_entries``; places of points may be symbols.
    values : sequence
        Its parameters.
    time : number, optional
        Where it follows the time.
    states : sequence
        Its own states.

    """
    inputs = {PARAMETERS: values, MEASURED: FIRST_COORDINATE * [None], STATES: states}
    measured, pushes = inputs[MEASURED], []
    measured[TIME] = time
    for kind, first, second, *places in entries:
        first, second = int(first), int(second)
        if kind == JOINT:
            measured += [forces.coordinate(first), forces.rate(first)]
            pushes.append(partial(forces.twist, first))
        elif kind == COMPONENT:
            offset = forces.turned(first, places[:3])
            measured += [each[second] for each in forces.place(first, offset)]
            pushes.append(partial(_push_along, forces, second, first, offset))
        else:
            offsets, direction, length, rate = line_between(
                forces, (first, second), (places[:3], places[3:]))
            measured += [length, rate]
            pushes.append(partial(push_apart, forces, (first, second), offsets, direction))

    def found(results):
        return replayed(law.graph, results, lambda source, place: inputs[source][place])

    if law.gap is not None:
        # The gap is the same on both sides of the event.
        measured[SIDE] = chosen(forces.touches(*found(law.results[-2:])), 1.0, 0.0)
    results = found(law.results)
    for push, force in zip(pushes, results):
        push(force)
    # After forces: rates of states, stored energy, dissipated power, where they are given.
    rates = results[len(pushes):len(pushes) + len(states)]
    stored, lost = results[len(pushes) + len(states):][:2]
    forces.store(stored)
    if law.energy is None and law.dissipation is None:
        lost = dot(results[:len(pushes)], measured[FIRST_COORDINATE + 1::2])
    forces.flow(*law.follows_time * (1.0,), *rates, lost)


def _push_along(forces, axis, body, offset, force):
    forces.push(body, offset, tuple(force if k == axis else 0.0 for k in range(3)))
