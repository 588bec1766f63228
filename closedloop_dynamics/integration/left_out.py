# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
All closure equations, where those that repeat others are left out.

Which equations repeat others changes with the position: those that are kept may come to depend on
one another, and part from those that are left out. The engine looks at them after every accepted
step (``engine/left_out.hpp``), so that a step at which they do not serve can be repeated with
others.
"""

from typing import NamedTuple

import numpy as np

from ..core.codegen import joint_kernels
from ..core.codegen.workspace import unconnected
from ..core.equations import Equations, with_all_equations
from ..core.types import Model, Workspace

# Columns of ``AllEquations.numbers``: the pivot below which other equations are looked for; the
# most kinetic energy so far [J]; whether there are none better, so that all but open loops is
# accepted; whether those left out have opened at the latest step that was refused.
PIVOT, KINETIC, LENIENT, OPENED = range(4)


class AllEquations(NamedTuple):
    """All closure equations of a mechanism of which the elimination works on some."""

    model: Model
    work: Workspace  # On the bodies of the system
    lam: np.ndarray  # Shape (nc,)
    kept: np.ndarray  # Shape (nc,), of int: 1 for those that the elimination works on
    own: Workspace  # On bodies of its own
    numbers: np.ndarray  # Shape (4,)
    energy: np.ndarray  # Shape (2,): scratch


def all_equations(model, work, before=None):
    """
    Allocate all equations of a system that works on some; None where it works on all.

    ``model`` and ``work`` are the system's; the numbers of ``before`` are taken over.
    """
    whole = with_all_equations(model)
    if whole is model:
        return None
    shared = unconnected(whole)._replace(body=work.body, kernel=work.kernel, health=work.health)
    joint_kernels.connect(whole, shared.kernel, shared.cut_kernel)
    # The bodies' own code may be exchanged when effects change their inertia.
    own = unconnected(whole)._replace(kernel=work.kernel, cut_kernel=shared.cut_kernel)
    return AllEquations(
        whole, shared, np.zeros(len(shared.closure)), Equations(model).kept.astype(np.int64), own,
        np.zeros(4) if before is None else before.numbers, np.zeros(2))


def forget(system):
    """Forget the motion of a system so far."""
    if system.has_redundant_constraints:
        system.whole.numbers[:] = 0.0
