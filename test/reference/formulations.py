# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Accelerations and multipliers by dense matrices of the whole mechanism.

Inertia matrix, Jacobian and right-hand sides are the engine's, of any mechanism with any forces;
the elimination is not: these formulations see neither subsystems nor the graph of the cut joints,
and cost O((n + m)^3) and O(n^3 + m^3). ``dense`` has twins that share nothing with the engine.
"""

from closedloop_dynamics.engine.types import NO_RESPONSES
import numpy as np
from scipy.linalg import lapack


def system_level(gim, jac, free, right):
    """Solve for the multipliers by J I^-1 J^T, then for the accelerations."""
    lower = cholesky(gim)
    scaled = triangular(lower, jac.T)
    moved = triangular(lower, free)
    schur = cholesky(scaled.T @ scaled)
    lam = triangular(schur, triangular(schur, right - scaled.T @ moved), trans=1)
    return triangular(lower, moved + scaled @ lam, trans=1), lam


def augmented(gim, jac, free, right):
    """Solve for accelerations and multipliers at once."""
    nv, nc = len(free), len(right)
    matrix = np.zeros((nv + nc, nv + nc))
    matrix[:nv, :nv], matrix[nv:, :nv], matrix[:nv, nv:] = gim, jac, jac.T
    *_, solution, failed = lapack.dgesv(matrix, np.concatenate((free, right)), overwrite_a=True)
    require(failed)
    return solution[:nv], -solution[nv:]


def cholesky(matrix):
    """Return the lower factor."""
    lower, failed = lapack.dpotrf(matrix, lower=True)
    require(failed)
    return lower


def triangular(lower, right, trans=0):
    """Solve with a lower factor, or its transpose."""
    if not len(right):
        return right
    solution, failed = lapack.dtrtrs(lower, right, lower=True, trans=trans)
    require(failed)
    return solution


def require(failed):
    """Refuse a singular matrix."""
    if failed:
        raise np.linalg.LinAlgError('the matrix is singular')


FORMULATIONS = {'system': system_level, 'augmented': augmented}


class Dense:
    """
    Evaluations of a system.

    Friction at rest and reflected inertia, whose forces follow from accelerations, are left out.

    Parameters
    ----------
    system : simulation.system.System
    formulation : str
        Of ``FORMULATIONS``.

    """

    def __init__(self, system, formulation):
        nv, nc = len(system.qdd), len(system.lam)
        self.system, self._solve = system, FORMULATIONS[formulation]
        self._gim, self._jac = np.empty((nv, nv)), np.empty((nc, nv))
        self._rest, self._bias, self._still = np.empty(nv), np.empty(nc), np.zeros(nv)

    def __call__(self, q, qd):
        """
        Return accelerations and multipliers, shape (nv,) and (nc,), under the present torques.

        Of a state that ``system`` has evaluated, where effects have states, or quaternions are
        among the coordinates.
        """
        system, model, work = self.system, self.system.model, self.system.work
        model.outward(q, qd, work)
        if system.effects is not None:
            system.effects.apply_effects(
                work.body, q if system.manifold is None else system.manifold.number, qd,
                system.tau)
        model.update(work, NO_RESPONSES)
        model.constraint_jacobian(work, self._jac)
        model.to_user_order(work.bias, self._bias)
        model.tree_torque(work, self._still, self._rest)
        model.generalized_inertia_matrix(work, self._gim)
        return self._solve(self._gim, self._jac, system.applied - self._rest, -self._bias)


def dense_dynamics(simulation, formulation):
    """Return accelerations and multipliers of a simulation in its present state."""
    simulation.acceleration
    return Dense(simulation.data.system, formulation)(simulation.position, simulation.velocity)
