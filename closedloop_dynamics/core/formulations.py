# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The augmented and the system-level formulation, to compare the method against.

Both work on dense matrices of the whole mechanism and cost O((n + m)^3) and
O(n^3 + m^3); they see neither subsystems nor the cut-joint graph.
"""

from typing import NamedTuple

import numpy as np

# Which formulation an evaluation uses.
SUBSYSTEM, SYSTEM, AUGMENTED = range(3)


class DenseWorkspace(NamedTuple):
    """Matrices of the dense formulations."""

    gim: np.ndarray  # Shape (nv, nv)
    jac: np.ndarray  # Shape (nc, nv)
    free: np.ndarray  # Shape (nv,): phi, then I^-1 phi
    right: np.ndarray  # Shape (nc,)
    schur: np.ndarray  # Shape (nc, nc): J I^-1 J^T
    kkt: np.ndarray  # Shape (nv + nc, nv + nc)
    pivots: np.ndarray  # Int, shape (nv + nc,): Of its LU factors
    solution: np.ndarray  # Shape (nv + nc,)


def allocate_dense(model, formulation):
    """
    Allocate the arrays of one dense formulation, ``SYSTEM`` or ``AUGMENTED``.

    For ``SUBSYSTEM`` arrays have no length.
    """
    nv, nc = (0, 0) if formulation == SUBSYSTEM else (len(model.tree) - 1, len(model.column) - 1)
    both = nv + nc if formulation == AUGMENTED else 0
    schur = nc if formulation == SYSTEM else 0
    return DenseWorkspace(
        gim=np.zeros((nv, nv)), jac=np.zeros((nc, nv)), free=np.zeros(nv), right=np.zeros(nc),
        schur=np.zeros((schur, schur)), kkt=np.zeros((both, both)),
        pivots=np.zeros(both, dtype=np.int64), solution=np.zeros(both))
