# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Least-norm multipliers where closure equations are dependent or nearly so.

Entered only when the block elimination meets a poor pivot. With
W = J I^-1/2, whose rows are the reduced responses divided by sqrt(D), the
constraint matrix is W W^T; its singular value decomposition tells the rank and
leaves out the directions in which the closure equations hold no motion back.

"""

import numpy as np

from .compiled import compiled
from .types import DINV, RANK, RANK_REVEALING_COUNT, ROW, ROWS, SLOT_A, SLOT_END

# Singular values of W below this times the largest count as zero. HARD_CASES measured
# that crossing flat positions keeps energy to 2e-8 of the initial one or better from 1e-5
# to 1e-4 and worse on either side.
RELATIVE_RANK_TOLERANCE = 3e-5


@compiled
def solve(model, work, right):
    """
    Compute the least-norm solution of Ibar x = ``right``.

    Parameters
    ----------
    model : Model
    work : Workspace
        After ``loop_closure.update``; ``health`` tells the rank.
    right : ndarray, shape (nc,)
        In elimination order; replaced by the solution, NaN where W is not finite.

    """
    cut, slot_body = model.cut, model.slot_body
    rows = right.shape[0]
    weighted = np.zeros((rows, model.tree.shape[0]))
    for a in range(cut.shape[0]):
        for slot in range(cut[a, SLOT_A], cut[a, SLOT_END]):
            i = slot_body[slot]
            root = np.sqrt(work.body[i, DINV])
            for k in range(cut[a, ROWS]):
                weighted[cut[a, ROW] + k, i] = work.response[slot, k] * root
    rank = 0
    if np.isfinite(weighted).all():
        left, singular, _ = np.linalg.svd(weighted, full_matrices=False)
        reduced = left.T @ right
        for k in range(singular.shape[0]):
            if singular[k] > RELATIVE_RANK_TOLERANCE * singular[0]:
                rank += 1
                reduced[k] /= singular[k] * singular[k]
            else:
                reduced[k] = 0.0
        right[:] = left @ reduced
    else:
        right[:] = np.nan
    work.health[RANK] = rank
    work.health[RANK_REVEALING_COUNT] += 1.0
