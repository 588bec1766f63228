# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Runs by steps of one size, and the data of their derivatives; structs of sensitivity.hpp."""

from typing import NamedTuple

import numpy as np

from .system import number_of_states
from .tableau import Tableau

# Rows of the scratch of a run beside one for each stage of its method; see sensitivity.hpp.
SCRATCH_ROWS = 20


class SteppedRun(NamedTuple):
    """How a run is made."""

    tableau: Tableau  # Without weights: semi-implicit Euler
    stabilisation: int  # One of ``registry``: NONE, VELOCITY or PROJECTION
    step_size: float  # [s]
    # Steps that a row of torques acts for, and from one instant to the next.
    zero_order_hold: int
    decimation: int
    torque: np.ndarray  # Shape (rows, nv): in the joints [N m, N]


class Tape(NamedTuple):
    """Data of a run for its derivatives."""

    state: np.ndarray  # Shape (steps + 1, ns)
    # Shape (steps, stages, ns + nv + nc): states evaluated, accelerations, multipliers.
    stage: np.ndarray
    raw: np.ndarray  # Shape (steps, ns): states before they are stabilised
    corrections: np.ndarray  # Of int, shape (steps,): of the positions, each time


class StepRoutines(NamedTuple):
    """Routines of ``core.codegen.sensitivities``, and the arrays that they work on."""

    table: np.ndarray  # Of int: addresses
    qdd: np.ndarray  # Shape (nv,)
    lam: np.ndarray  # Shape (nc,)
    seed: np.ndarray  # Shape (nq + 2 nv + np,)
    result: np.ndarray  # As long, or longer


class RunInputs(NamedTuple):
    """Changes, or weights, of the inputs of a run."""

    start: np.ndarray  # Shape (nq + nv,)
    torque: np.ndarray  # Shape (rows, nv)
    parameter: np.ndarray  # Shape (np,)


def stages_of(tableau):
    """Return how many evaluations a step takes."""
    return len(tableau.b) or 1


def allocate_tape(system, tableau, steps):
    """Allocate the record of a run of so many steps, to be filled in, from the first state on."""
    ns = number_of_states(system)
    return Tape(
        np.zeros((steps + 1, ns)),
        np.zeros((steps, stages_of(tableau), ns + len(system.qdd) + len(system.lam))),
        np.zeros((steps, ns)), np.zeros(steps, dtype=np.int64))


def allocate_scratch(system, tableau):
    """Allocate the scratch that runs and their derivatives work in."""
    return np.zeros((stages_of(tableau) + SCRATCH_ROWS, number_of_states(system)))
