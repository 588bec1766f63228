# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Traced routines for several states at once, in the lanes of vector registers.

One evaluation spends most of its time waiting: each operation for the ones before. The same
arithmetic on vectors, with a state in every lane, takes hardly longer. What differs between the
lanes is stored lane by lane: number k of lane n at place ``LANES * k + n``.
"""

import numpy as np

from .function_table import (
    BAUMGARTE, BODY, CLOSURE, CLOSURE_RATE, connect as connect_arrays, CORRECTION, CORRECTIONS,
    CUT_POINT, GRAVITY, HEALTH, LAM, LANES, QDD, TAU)
from .machine_code import LANES as IN_LANES
from .routines import addresses
from ..engine.types import HEALTH_COLUMNS


def connect(model, arrays, which, evaluations=None):
    """
    Return the function table of the routines of a mechanism for several states at once.

    ``model`` is one of the mechanisms, which have its topology; ``arrays``, from the places BODY
    to RATES, lane by lane, but for BAUMGARTE, which all share, must live as long as the table is
    used; ``which``: MOTION, or EVALUATION where closure errors decay; ``evaluations``: addresses
    of those of a scene by place, by default that of the mechanism alone.
    """
    table = connect_arrays(arrays)
    alone = (which, CORRECTION) if evaluations is None else (CORRECTION,)
    for which, address in (addresses(model, alone, IN_LANES) | (evaluations or {})).items():
        table[which] = address
    return table


def spread(arrays):
    """Store an array of each lane, all of one shape, lane by lane: shape (LANES * size,)."""
    return np.stack([np.asarray(array, dtype=float).ravel() for array in arrays], axis=-1).ravel()


def allocate(models, sizes, baumgarte):
    """
    Allocate inputs and outputs of routines for several states at once, for ``connect``.

    ``models`` are of one topology; ``sizes``: joint coordinates, closure equations; ``baumgarte``,
    shape (1,): decay rate of closure errors [1/s].
    """
    nv, nc = sizes
    return {
        BODY: spread([model.body for model in models]),
        GRAVITY: spread([model.gravity for model in models]),
        CUT_POINT: spread([model.cut_point for model in models]),
        TAU: np.zeros(LANES * nv), BAUMGARTE: baumgarte, QDD: np.zeros(LANES * nv),
        LAM: np.zeros(LANES * nc), HEALTH: np.ones(LANES * HEALTH_COLUMNS),
        CLOSURE: np.zeros(LANES * nc), CLOSURE_RATE: np.zeros(LANES * nc),
        CORRECTIONS: np.zeros(LANES * 2 * nv)}
