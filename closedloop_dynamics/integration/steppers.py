# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Methods with their memory, as the engine has them."""

from typing import NamedTuple, Optional

import numpy as np

from .tableau import Tableau

# Rows of all arrays of ``Runs``.
RUN, REFERENCE = range(2)


class Runs(NamedTuple):
    """A run of the default method and its reference run: records, tolerances and scratch."""

    short_tableau: Optional[Tableau]  # Of steps while torques are held for short
    control: np.ndarray  # Shape (2, SWITCHING_COLUMNS)
    scale: np.ndarray  # Shape (2, 2, ns): absolute and relative tolerance of each component
    # Shape (2, rows, ns): of the explicit method; its row AFTER is the state at REACHED.
    scratch: np.ndarray
    stiff_scratch: np.ndarray  # Shape (2, STIFF_ROWS, ns): of the stiff method
    matrix: np.ndarray  # Shape (ns, ns)
    pivots: np.ndarray  # Shape (ns,)
    monitor: np.ndarray  # Shape (MONITOR_COLUMNS,)
    weight: np.ndarray  # Shape (nq,): of a component in the distance of the two


# How a stepper of the engine makes its steps.
FIXED_STEPS, EXPLICIT_STEPS, SWITCHING_STEPS, FIXED_STIFF_STEPS, STIFF_STEPS, HOST_STEPS = range(6)


class Stepper(NamedTuple):
    """A method with its memory, for runs that the engine makes as a whole."""

    kind: int  # ``FIXED_STEPS``, ...
    stabilisation: int
    tableau: Optional[Tableau]
    # Shape (2, ns): tolerances of the default method for a tolerance of 1.
    unit: np.ndarray
    # Of other methods with a row for the run alone; without rows where there is no such memory.
    runs: Runs


def one_run(kind, stabilisation, tableau=None, **memory):
    """Return a stepper of one run, with the memory that its method has."""
    table, page = np.zeros((0, 0)), np.zeros((0, 0, 0))
    runs = Runs(
        None, table, page, page, page, table, np.zeros(0, dtype=np.int64), *2 * [np.zeros(0)])
    return Stepper(kind, stabilisation, tableau, table, runs._replace(
        **{name: values if name in ('matrix', 'pivots') else values[np.newaxis]
           for name, values in memory.items()}))
