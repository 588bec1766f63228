# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Allocate the workspace of one evaluation, and bind the code of its mechanism to it."""

import numpy as np

from . import joint_kernels, space
from ..types import (
    BODY_KERNELS, COS, COUPLED_WORK_COLUMNS, HEALTH_COLUMNS, JOINT_COLUMNS, POSSIBLE, READ, ROWS,
    WORK_COLUMNS, Workspace)


def allocate(model):
    work = unconnected(model)
    joint_kernels.connect(model, work.kernel, work.cut_kernel)
    return work


def unconnected(model):
    """Allocate a workspace that the loops cannot be run on."""
    entries, bodies, rows = len(model.path_body), len(model.tree), len(model.column) - 1
    most = max(3, model.cut[:, ROWS].max(initial=0))
    # The code for a cut joint computes all equations that it may have.
    possible = max([3, *(bin(one).count('1') for one in model.cut[:, POSSIBLE].tolist())])
    spatial = space.is_spatial(model)
    columns = COUPLED_WORK_COLUMNS if model.tree[:, READ].any() else WORK_COLUMNS
    body = np.zeros((bodies, space.WORK_COLUMNS if spatial else columns))
    size = 6 if spatial else 3
    # The ground's axes.
    body[0, [space.FRAME, space.FRAME + 4, space.FRAME + 8] if spatial else COS] = 1.0
    return Workspace(
        body=body, response=np.zeros((entries, most)), response_scaled=np.zeros((entries, most)),
        factor=np.zeros(len(model.row)), scale=np.zeros(rows), lever=np.zeros((entries, most)),
        joint=np.zeros((bodies, JOINT_COLUMNS)), change=np.zeros(bodies - 1),
        pivot_inverse=np.zeros(rows), right=np.zeros(rows), scatter=np.zeros(rows),
        closure=np.zeros(rows), closure_rate=np.zeros(rows), bias=np.zeros(rows),
        equation=np.zeros(possible * (3 + 2 * size)), wrench=np.zeros((2, size)),
        share=np.zeros(3 * size), torque=np.zeros(bodies - 1), force=np.zeros((bodies, 2 * size)),
        kernel=np.zeros((bodies, BODY_KERNELS), dtype=np.int64),
        cut_kernel=np.zeros((len(model.cut), 2), dtype=np.int64), health=np.zeros(HEALTH_COLUMNS))
