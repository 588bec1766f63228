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

"""What the integrators integrate: a mechanism under joint torques."""

from typing import NamedTuple

import numpy as np

from ..core import kinematics
from ..core.compiled import compiled
from ..core.formulations import accelerate_dense, allocate_dense, DenseWorkspace, SUBSYSTEM
from ..core.forward_dynamics import accelerate
from ..core.types import allocate, Model, Workspace

# Columns of System.settings: which formulation, Baumgarte's decay rate [1/s] (0: none), the
# closure error [m, rad] that projection leaves and the one at which it gives up.
FORMULATION, BAUMGARTE, CLOSURE_TOLERANCE, CLOSURE_LIMIT = range(4)


class System(NamedTuple):
    """
    One mechanism with all that an evaluation of its motion reads and writes.

    Attributes
    ----------
    model : Model
    work : Workspace
    dense : DenseWorkspace
    settings : ndarray, shape (4,)
    tau : ndarray, shape (nv,)
        Commanded joint torques [N m] and forces [N].
    qdd : ndarray, shape (nv,)
        Joint accelerations of the latest evaluation.
    lam : ndarray, shape (nc,)
        Its multipliers.

    """

    model: Model
    work: Workspace
    dense: DenseWorkspace
    settings: np.ndarray
    tau: np.ndarray
    qdd: np.ndarray
    lam: np.ndarray


def build_system(model, formulation=SUBSYSTEM, baumgarte=0.0, extent=1.0):
    """
    Allocate a system.

    Parameters
    ----------
    model : Model
    formulation : int
        One of ``core.formulations``.
    baumgarte : float
        Decay rate of closure errors [1/s].
    extent : float
        Size of the mechanism [m], to which closure tolerances are relative.

    Returns
    -------
    System

    """
    nv, nc = len(model.tree) - 1, len(model.column) - 1
    # Closure errors of 1e-12 of the size are rounding; one of 1e-5 of it is an open loop.
    settings = np.array([formulation, baumgarte, 1e-12 * extent, 1e-5 * extent])
    return System(
        model=model, work=allocate(model), dense=allocate_dense(model, formulation),
        settings=settings, tau=np.zeros(nv), qdd=np.zeros(nv), lam=np.zeros(nc))


@compiled
def evaluate(system, q, qd):
    """
    Compute the accelerations and multipliers of a state into ``system.qdd`` and ``system.lam``.

    Parameters
    ----------
    system : System
    q, qd : ndarray, shape (nv,)

    """
    model, work, formulation = system.model, system.work, int(system.settings[FORMULATION])
    kinematics.outward(model, q, qd, work)
    if formulation == SUBSYSTEM:
        accelerate(model, work, system.tau, system.settings[BAUMGARTE], system.qdd, system.lam)
    else:
        accelerate_dense(model, work, system.dense, formulation, system.tau,
                         system.settings[BAUMGARTE], system.qdd, system.lam)


@compiled
def derivative(system, state, out):
    """
    Compute the time derivative of a state.

    Parameters
    ----------
    system : System
    state : ndarray, shape (ns,)
        Joint coordinates, then joint rates.
    out : ndarray, shape (ns,)
        Written in place.

    """
    nv = system.qdd.shape[0]
    evaluate(system, state[:nv], state[nv:2 * nv])
    for i in range(nv):
        out[i] = state[nv + i]
        out[nv + i] = system.qdd[i]
