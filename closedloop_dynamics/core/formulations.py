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
    """
    Matrices of the dense formulations.

    Attributes
    ----------
    gim : ndarray, shape (nv, nv)
    jac : ndarray, shape (nc, nv)
    free : ndarray, shape (nv,)
        phi, then I^-1 phi.
    right : ndarray, shape (nc,)
    schur : ndarray, shape (nc, nc)
        J I^-1 J^T.
    kkt : ndarray, shape (nv + nc, nv + nc)
    pivots : ndarray of int, shape (nv + nc,)
        Of its LU factors.
    solution : ndarray, shape (nv + nc,)

    """

    gim: np.ndarray
    jac: np.ndarray
    free: np.ndarray
    right: np.ndarray
    schur: np.ndarray
    kkt: np.ndarray
    pivots: np.ndarray
    solution: np.ndarray


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
