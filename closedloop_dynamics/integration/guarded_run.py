# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A run that the engine makes and checks, call by call, until Python has to act.

The meanings of columns are in ``engine/guarded_run.hpp``; a test compares the places.
"""

from typing import NamedTuple

import numpy as np

from ..effects.energy_balance import EnergyAccount

# Columns of ``GuardedRun.numbers``.
(TIME_BASE, STEP_SIZE, SIZE, ELAPSED, COST_TIME, COST_STEPS, COST_NANOSECONDS,
 COST_CPU_NANOSECONDS, MOVED, WORST, WORST_TIME, WORST_LOST, WORST_MOVED, LOST, MOVING, CHECK_TIME,
 BEGIN) = range(17)
CHECK, PRESENT, CABLE_TIME, CABLE_RESIDUAL, MASS, NUMBERS = 21, 26, 31, 32, 33, 34
# Columns of ``GuardedRun.counts``.
(STEPS, LEFT, CALL, HANDED, STATUS, DUE, TO_SAMPLE, SINCE, BETWEEN, EQUATIONS_SINCE,
 EQUATIONS_BETWEEN, CHECKED, BEGUN, CABLES_CHECKED, WARNED, FAILED, COUNTS) = range(17)
# Values of CHECKED.
NOT, AT_STATE, AT_BALANCE = range(3)
# Why a run pauses.
(NONE, COMMAND, START_ENERGY, SAMPLE, HAND_OVER, FAILURE, CHOICE, INACCURATE, ENERGY_LOST,
 CABLE_LEAPT, NOT_REGULAR, LOOPS_OPEN) = range(12)
# More steps than any run has.
NEVER = 2 ** 62


class Watch(NamedTuple):
    """Times and tolerances of the checks of a run."""

    first: int
    rarely: int
    call: int
    whole: bool
    chooses: bool
    most: int
    closure: float  # [m or rad]
    regular: bool
    extent: float  # [m]
    usual: float  # [N m or N]
    timed: bool
    windings: np.ndarray  # Shape (nw,)


class GuardedRun(NamedTuple):
    """A run with its memory."""

    stepper: object  # The engine's ``Stepper``; None: Python makes the steps
    watch: Watch
    account: EnergyAccount
    state: np.ndarray  # Shape (ns,)
    before: np.ndarray  # Shape (ns,): scratch
    kept: np.ndarray  # Shape (ns and the length of the method's memory,)
    kept_by_cables: np.ndarray  # The same; of no length without windings
    windings: np.ndarray  # Shape (nw,) [rad]
    numbers: np.ndarray  # Shape (NUMBERS,)
    counts: np.ndarray  # Shape (COUNTS,), of int


def guarded_run(stepper, watch, account, state, memory, numbers, counts):
    """Allocate a run; ``memory``: length of what outlasts a restart of the method."""
    count = len(watch.windings)
    return GuardedRun(
        stepper, watch, account, state, np.zeros_like(state), np.zeros(len(state) + memory),
        np.zeros(len(state) + memory if count else 0), np.zeros(count), numbers, counts)
