# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Independent coordinates: the dependent ones follow from the loop closures by Newton's method."""

from typing import NamedTuple

import numpy as np

# Partition.record: the pivot ratio when the set was chosen (0: none chosen yet), the latest
# one, how often the set was changed.
CHOSEN_RATIO, RATIO, SWITCHES = range(3)


class Partition(NamedTuple):
    """Which coordinates are independent, and the scratch to solve for the others."""

    order: np.ndarray  # Int, shape (nv,): The nc dependent coordinates, then the independent ones
    #: ``jac``, ``scaled``: Shape (nc, nv).
    jac: np.ndarray
    scaled: np.ndarray
    matrix: np.ndarray  # Shape (nc, nc): Factors of the dependent columns
    pivots: np.ndarray  # Int, shape (nc,)
    right: np.ndarray  # Shape (nc,)
    change: np.ndarray  # Shape (nv,): Of the coordinates; zero for the independent ones
    record: np.ndarray  # Shape (3,)


def allocate_partition(model, used=True):
    """Allocate a partition, no set chosen yet; arrays have no length where it is not used."""
    nv, nc = (len(model.tree) - 1, len(model.column) - 1) if used else (0, 0)
    return Partition(
        order=np.arange(nv), jac=np.zeros((nc, nv)), scaled=np.zeros((nc, nv)),
        matrix=np.zeros((nc, nc)), pivots=np.zeros(nc, dtype=np.int64), right=np.zeros(nc),
        change=np.zeros(nv), record=np.zeros(3 if used else 0))


def forget(partition):
    """Make a partition one that has not been chosen yet, in place."""
    partition.order[:] = np.arange(len(partition.order))
    partition.record[:] = 0.0
