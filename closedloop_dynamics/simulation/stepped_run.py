# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Runs by steps of one size, and the data of their derivatives.

Structs of sensitivity.hpp, chart.hpp and state_steps.hpp.
"""

from typing import NamedTuple

import numpy as np

from .system import number_of_states, parts_of_state
from ..codegen.function_table import LANES
from ..scene.tableau import Tableau

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
    """Routines of ``codegen.sensitivities``, and the arrays that they work on."""

    table: np.ndarray  # Of int: addresses
    qdd: np.ndarray  # Shape (nv,)
    lam: np.ndarray  # Shape (nc,)
    seed: np.ndarray  # Shape (nq + 2 nv + np,)
    result: np.ndarray  # As long, or longer


class LaneRoutines(NamedTuple):
    """The same for LANES directions or weights side by side."""

    # Int: addresses, of two routines each; behind it there may be another table, for positions in
    # which these fail.
    table: np.ndarray
    shared: np.ndarray  # What the first of two hands to the second
    result: np.ndarray  # Shape (LANES (nq + 2 nv + np),), or longer


class RunInputs(NamedTuple):
    """Changes, or weights, of the inputs of a run."""

    start: np.ndarray  # Shape (nq + nv,)
    torque: np.ndarray  # Shape (rows, nv)
    parameter: np.ndarray  # Shape (np,)


class Chart(NamedTuple):
    """Which coordinates are independent, and scratch."""

    independent: np.ndarray  # Of int, shape (k,)
    dependent: np.ndarray  # Of int, shape (nc,)
    parameters: np.ndarray  # Shape (entries, np): derivatives of the numbers that routines read
    closure: np.ndarray  # Shape (nv + np, 2 nc)
    factors: np.ndarray  # Shape (nc, nc)
    pivots: np.ndarray  # Of int, shape (nc,)
    right: np.ndarray  # Shape (nc,)
    several: np.ndarray  # Shape (nc, k + np)
    displacement: np.ndarray  # Shape (nv,)
    place: np.ndarray  # Shape (nq,)
    seed: np.ndarray  # Shape (LANES (nq + 2 nv + entries),)


class StateSteps(NamedTuple):
    """States before and after a period, with Jacobians in the coordinates of a chart."""

    q: np.ndarray  # Shape (n, nq): before
    qd: np.ndarray  # Shape (n, nv)
    torque: np.ndarray  # Shape (n, na): of the actuated joints
    actuated: np.ndarray  # Of int, shape (na,): their places among the joints
    next_q: np.ndarray  # Shape (n, nq): after
    next_qd: np.ndarray  # Shape (n, nv)
    by_state: np.ndarray  # Shape (n, 2 k, 2 k); (0, 2 k, 2 k) where there are none
    by_torque: np.ndarray  # Shape (n, 2 k, na)
    by_parameter: np.ndarray  # Shape (n, 2 k, np)
    basis: np.ndarray  # Shape (n, 2 nv, 2 k + np)
    # Scratch, in as many lanes as there are changes, rounded up to a multiple of LANES.
    wide: np.ndarray  # Shape (stages + 2, lanes (nq + nv))
    weight: np.ndarray  # Shape (lanes (nq + nv),)
    gradient: RunInputs


def allocate_chart(system, independent, dependent, parameters):
    """Allocate a chart of independent and dependent coordinates, by their places."""
    nq, nv, *_ = parts_of_state(system)
    nq, nv, nc = nq.stop, nv.stop - nv.start, len(system.lam)
    return Chart(
        np.array(independent, dtype=np.int64), np.array(dependent, dtype=np.int64), parameters,
        np.zeros((nv + parameters.shape[1], 2 * nc)), np.zeros((nc, nc)),
        np.zeros(nc, dtype=np.int64), np.zeros(nc),
        np.zeros((nc, len(independent) + parameters.shape[1])), np.zeros(nv), np.zeros(nq),
        np.zeros(LANES * (nq + 2 * nv + len(parameters))))


def allocate_steps(chart, tableau, actuated, states, differentiates):
    """Allocate so many states before and after a period, with their Jacobians if wanted."""
    nq, nv, k = len(chart.place), len(chart.displacement), len(chart.independent)
    entries, count = chart.parameters.shape
    # Rows of Jacobians are computed side by side.
    pages, lanes = states if differentiates else 0, -(-2 * k // LANES) * LANES
    wide = lanes * (nq + nv)
    return StateSteps(
        np.zeros((states, nq)), np.zeros((states, nv)), np.zeros((states, len(actuated))),
        np.array(actuated, dtype=np.int64), np.zeros((states, nq)), np.zeros((states, nv)),
        np.zeros((pages, 2 * k, 2 * k)), np.zeros((pages, 2 * k, len(actuated))),
        np.zeros((pages, 2 * k, count)), np.zeros((pages, 2 * nv, 2 * k + count)),
        np.zeros((stages_of(tableau) + 2, wide)), np.zeros(wide),
        RunInputs(np.zeros(wide), np.zeros((1, lanes * nv)), np.zeros(lanes * entries)))


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
