# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Memory of one evaluation, and numbers or symbols of the same shapes."""

import numpy as np

from . import joint_kernels
from ..engine.types import Arrays, Handle


def allocate(model):
    """Return a workspace of the engine for a model, whose bodies have their code then."""
    joint_kernels.connect(model)
    return Handle(model.workspace())


def zeros_like_workspace(model):
    """Return arrays of the shapes that a workspace has, of numbers that may become symbols."""
    shapes = vars(Handle(model.origin.workspace()))
    return Arrays(**{name: np.full(array.shape, 0.0, dtype=object)
                     for name, array in shapes.items() if name != 'native'})
