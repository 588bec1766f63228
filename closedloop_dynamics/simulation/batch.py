# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Whole runs of several mechanisms of one topology at once, one in every lane of a vector (SIMD).

The steps are those of single runs, number by number; only the routines compute all lanes at
once. A lane in which an effect begins or ceases within a step, or other joints under dry
friction are at rest than in most, makes that step alone (``engine/lane_events.cpp``); one next to
a singular position of an arm has the results of the routine for that, the others their own. What
else a lane alone would do otherwise (the rank-revealing path, a failure) ends the run: its
mechanisms are then run one by one.
"""

from typing import NamedTuple, Optional

import numpy as np

from ..codegen import function_table as calls, lanes
from ..codegen.lanes import LANES
from ..codegen.routines import topology
from ..effects import scene_code
from ..engine.types import Handle
from ..scene.integrators import INDEPENDENT


class Batch(NamedTuple):
    """Mechanisms of one topology in all lanes; arrays are stored lane by lane."""

    table: np.ndarray  # Of their routines
    # Shape (LANES * nv,): joint torques, accelerations.
    tau: np.ndarray
    qdd: np.ndarray
    closure: np.ndarray  # Shape (LANES * nc,): closure errors of the latest correction
    corrections: np.ndarray  # Shape (2, LANES * nv): of coordinates and rates
    # Shape (LANES,): closure error that projection leaves, and the one at which it gives up.
    tolerance: np.ndarray
    limit: np.ndarray
    error: np.ndarray  # Shape (LANES,): largest closure error of each
    manifold: Optional[Handle]  # Of all of them
    rates: np.ndarray  # Shape (LANES * nz,): of the effects' states
    # Gaps of effects, shape (LANES * rows * columns,): as ``Contacts.now``, ``Contacts.trial``.
    gaps: np.ndarray
    trials: np.ndarray
    # Shape (LANES * 3,): what ``find_energies`` finds; of no length without effects.
    energies: np.ndarray
    # Frictions, shape (LANES * nf * (nv + nc),) and (LANES * nf,): ``StaticFriction.response``
    # without its last row, and the limit, zero where the joint slides.
    response: np.ndarray
    friction: np.ndarray
    kept: tuple  # Tuple of ndarrays that only the routines read and write


class Lane(NamedTuple):
    """A run of a lane by itself, by which it is watched."""

    system: object  # ``System.native``
    run: object  # ``Run.native``


def fits(system, stabilisation):
    """
    Return whether a system may take a lane.

    Not where nothing is unrolled, or effects have no code for it.
    """
    return system.is_unrolled and stabilisation != INDEPENDENT and (
        system.effects is None or scene_code.fit_lanes(system.effects))


def build_batch(systems):
    """Allocate a batch; None where the systems cannot go together."""
    systems = filled(systems)
    first = systems[0]
    gain, tolerance, limit = (
        np.array([getattr(system.settings, name) for system in systems])
        for name in ('baumgarte_gain', 'closure_tolerance', 'closure_limit'))
    shape = topology(first.model)
    if (gain != gain[0]).any() or any(
            topology(system.model) != shape for system in systems if system is not first):
        return None
    nv, nc = len(first.qdd), len(first.lam)
    arrays = lanes.allocate([system.model for system in systems], (nv, nc),
                            gain[:1].copy())
    which, evaluations = calls.EVALUATION if gain[0] else calls.MOTION, None
    if first.effects is not None:
        evaluations = scene_code.addresses_in_lanes(first.model, [
            system.effects for system in systems], which)
        if evaluations is None:
            return None
        arrays.update(_arrays_of_effects([system.effects for system in systems]))
        arrays[calls.COMMAND] = arrays[calls.TAU]
    nothing = np.zeros(0)
    return Batch(
        table=lanes.connect(first.model, arrays, which, evaluations), tau=arrays[calls.TAU],
        qdd=arrays[calls.QDD], closure=arrays[calls.CLOSURE],
        corrections=arrays[calls.CORRECTIONS].reshape(2, -1),
        tolerance=tolerance, limit=limit,
        error=np.zeros(LANES), manifold=first.manifold,
        **{name: arrays.get(place, nothing) for name, place in (
            ('rates', calls.RATES), ('gaps', calls.GAPS), ('trials', calls.TRIALS),
            ('energies', calls.ENERGY), ('response', calls.RESPONSE),
            ('friction', calls.LIMIT))},
        kept=tuple(arrays.values()))


def _arrays_of_effects(tables):
    """Return the arrays of effects that a scene's code uses, lane by lane, by place."""
    first = tables[0]
    return {
        calls.VALUES: lanes.spread([table.values for table in tables]),
        calls.ENTRIES: lanes.spread([table.data for table in tables]),
        # Where nothing is decided, the gap decides.
        calls.SIDES: np.zeros(LANES * len(first.role)),
        calls.GAPS: np.zeros(LANES * first.contacts.now.size),
        calls.TRIALS: np.zeros(LANES * first.contacts.trial.size),
        calls.RESPONSE: np.zeros(LANES * first.static_friction.response[:-1].size),
        calls.LIMIT: np.zeros(LANES * first.static_friction.right.size),
        calls.RATES: np.zeros(LANES * len(first.rates)),
        calls.ENERGY: np.zeros(LANES * 3)}


def find_energies(batch, system):
    """
    Have the energies of all lanes found together, which takes code of its own.

    Parameters
    ----------
    batch : Batch
        Of systems with effects, unless nothing is to be done.
    system : System
        One of them.

    """
    if len(batch.energies) and not batch.table[calls.ENERGIES]:
        batch.table[calls.ENERGIES] = scene_code.energies_in_lanes(system.model, system.effects)


def filled(items):
    """Return one item for every lane."""
    return [*items, *[items[-1]] * (LANES - len(items))]
