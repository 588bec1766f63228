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
Positions and velocities that close the loops, found from approximate ones.

Set-up work: dense linear algebra, no compiled loop. Coordinates that are held stay
as given; where none are held, or velocities are free, the change is the least one in
the mass metric.

"""

import numpy as np

from .core import jacobian, kinematics, loop_closure
from .core.forward_dynamics import to_user_order
from .errors import AssemblyError
from .mechanism.mechanism import CUT_JOINT_EQUATIONS

# Closed means this, relative to the mechanism's size (or 1, for a rate or an angle).
TOLERANCE = 1e-12
MOST_ITERATIONS = 200
# No single correction moves a coordinate further [rad, or in units of the size], so that
# the solution found is the one on the branch of the guess.
LARGEST_CORRECTION = 0.25
# Singular values of the Jacobian below this times the largest belong to dependent equations.
RANK_TOLERANCE = 1e-7
# Inertia of a motion against the largest: less is none.
NO_INERTIA = 1e-13


class Assembler:
    """
    Closes the loops of one mechanism.

    Parameters
    ----------
    mechanism : Mechanism
    model : core.types.Model
    work : core.types.Workspace
        Used as scratch.
    extent : float
        Size of the mechanism [m].

    """

    def __init__(self, mechanism, model, work, extent):
        """Allocate what every assembly needs."""
        self.mechanism, self.model, self.work, self.extent = mechanism, model, work, extent
        self.nv = len(mechanism.joints)
        self.nc = mechanism.number_of_equations
        self._still = np.zeros(self.nv)
        self._light = any(body.inertia == 0.0 and not (body.mass and any(body.center_of_mass))
                          for body in mechanism.bodies)

    def closure(self, q):
        """Return psi, shape (nc,), in the mechanism's order [m, rad]."""
        kinematics.outward(self.model, q, self._still, self.work)
        loop_closure.update(self.model, self.work, False)
        psi = np.zeros(self.nc)
        to_user_order(self.model, self.work.closure, psi)
        return psi

    def jacobian(self, q):
        """Return J = d psi / d q, shape (nc, nv)."""
        kinematics.outward(self.model, q, self._still, self.work)
        jac = np.zeros((self.nc, self.nv))
        jacobian.constraint_jacobian(self.model, self.work, jac)
        return jac

    def inertia(self, q):
        """Return the generalized inertia matrix of the spanning tree, shape (nv, nv)."""
        kinematics.outward(self.model, q, self._still, self.work)
        gim = np.zeros((self.nv, self.nv))
        jacobian.generalized_inertia_matrix(self.model, self.work, gim)
        return gim

    def positions(self, guess, hold=()):
        """
        Find joint coordinates that close the loops.

        Parameters
        ----------
        guess : ndarray, shape (nv,)
            Approximate values.
        hold : sequence of str
            Joints whose coordinates are kept.

        Returns
        -------
        ndarray, shape (nv,)

        Raises
        ------
        AssemblyError
            Where the loops cannot be closed from there, or ``hold`` leaves freedoms open.

        """
        q = np.array(guess, dtype=float)
        free, metric = self._free(hold), None
        psi = self.closure(q)
        for _ in range(MOST_ITERATIONS):
            error = np.abs(psi).max(initial=0.0)
            if error <= 0.01 * TOLERANCE * self.extent:
                break
            # Dense, and so for mechanisms of a thousand joints only where there is need.
            metric = self._metric(q, free) if metric is None else metric
            q, psi, better = self._correct(q, psi, free, metric)
            if not better:
                break
        if not np.abs(psi).max(initial=0.0) <= TOLERANCE * self.extent:
            raise AssemblyError(self._open_loops(psi, hold))
        if len(hold) > 0:
            self._require_complete(q, free, hold)
        if self._light:
            self._require_inertia(q)
        return q

    def velocities(self, q, guess, hold=()):
        """
        Find joint rates that keep the loops closed.

        Parameters
        ----------
        q : ndarray, shape (nv,)
            Closing the loops.
        guess : ndarray, shape (nv,)
            Approximate values.
        hold : sequence of str
            Joints whose rates are kept.

        Returns
        -------
        ndarray, shape (nv,)

        Raises
        ------
        AssemblyError
            Where the held rates contradict one another.

        """
        qd = np.array(guess, dtype=float)
        free = self._free(hold)
        if len(hold) > 0:
            qd[free] = 0.0
        if not qd.any():
            return qd
        jac = self.jacobian(q)
        rate = jac @ qd
        qd[free] -= _least_change(jac[:, free], rate, self._metric(q, free))
        left = np.abs(jac @ qd).max(initial=0.0)
        scale = max(np.abs(qd).max(initial=0.0) * self.extent, np.abs(rate).max(initial=0.0))
        if left > 1e-9 * scale:
            raise AssemblyError(
                f'The velocities held at {", ".join(hold)} contradict the loops: the cut joints '
                f'would part at {left:.3g} m/s. Hold fewer joints, or start at other '
                'velocities.')
        return qd

    def require_independent(self, q):
        """
        Refuse a configuration with dependent closure equations.

        Parameters
        ----------
        q : ndarray, shape (nv,)
            Closing the loops.

        Raises
        ------
        AssemblyError
            Where a method needs them independent, and they are not.

        """
        rank = _rank(self.jacobian(q))
        if rank < self.nc:
            raise AssemblyError(
                f'{self.nc - rank} of {self.nc} closure equations of {self.mechanism.name} depend '
                'on the others here (redundant cut joints, or a singular configuration), so that '
                'no set of independent coordinates can be chosen by them. Take stabilisation: '
                'projection.')

    def _free(self, hold):
        hold = set(hold)
        return np.array([k for k, name in enumerate(self.mechanism.joint_names)
                         if name not in hold], dtype=int)

    def _metric(self, q, free):
        """Return the Cholesky factor of the free coordinates' inertia."""
        inertia = self.inertia(q)[np.ix_(free, free)]
        diagonal = np.diag(inertia)
        # Coordinates without inertia of their own get a little: the change stays finite.
        return np.linalg.cholesky(
            inertia + np.diag(NO_INERTIA * diagonal.max(initial=0.0) * (
                np.ones(len(free)) if self._light else np.zeros(len(free)))))

    def _require_inertia(self, q):
        """Refuse massless bodies that the loops leave free to move."""
        jac = self.jacobian(q)
        levers = np.abs(jac).max(axis=0, initial=0.0)
        levers[levers == 0.0] = 1.0
        _, singular, right = np.linalg.svd(jac / levers)
        rank = int(np.sum(singular > RANK_TOLERANCE * singular.max(initial=0.0)))
        basis = right[rank:] / levers
        if not len(basis):
            return
        inertia = basis @ self.inertia(q) @ basis.T
        values, vectors = np.linalg.eigh(inertia)
        if values[0] > NO_INERTIA * values[-1]:
            return
        motion = np.abs(vectors[:, 0] @ basis)
        names = [name for name, part in zip(self.mechanism.joint_names, motion)
                 if part > 0.1 * motion.max()]
        raise AssemblyError(
            f'{self.mechanism.name} has a motion without inertia: {", ".join(names)} can move '
            'while nothing that has mass does, so that forces would accelerate it without limit. '
            'Give the bodies there some mass, or close a loop that guides them.')

    def _correct(self, q, psi, free, metric):
        """Return the state after one damped Newton correction, and whether it helped."""
        change = _least_change(self.jacobian(q)[:, free], psi, metric)
        largest = np.abs(change).max(initial=0.0)
        limit = LARGEST_CORRECTION * max(1.0, self.extent)
        change *= min(1.0, limit / largest) if largest > 0.0 else 0.0
        before = np.linalg.norm(psi)
        for _ in range(30):
            trial = q.copy()
            trial[free] -= change
            trial_psi = self.closure(trial)
            if np.linalg.norm(trial_psi) < before:
                return trial, trial_psi, True
            change *= 0.5
        return q, psi, False

    def _require_complete(self, q, free, hold):
        """Refuse held coordinates that leave others undetermined, here and all around."""
        missing = len(free) - _rank(self.jacobian(q)[:, free])
        # At a singular configuration even a complete choice leaves freedoms for an instant:
        # then look at configurations nearby.
        rng = np.random.default_rng(0)
        for _ in range(3):
            if missing == 0:
                return
            nearby = q + rng.uniform(-0.1, 0.1, self.nv)
            missing = min(missing, len(free) - _rank(self.jacobian(nearby)[:, free]))
        if missing:
            raise AssemblyError(
                f'Holding {", ".join(hold)} is not a complete choice: {missing} degree'
                f'{"s" if missing > 1 else ""} of freedom stay{"" if missing > 1 else "s"} open. '
                f'Hold {missing} more of {", ".join(self.mechanism.joints[k].name for k in free)}'
                ', or hold none to take the nearest closed state.')

    def _open_loops(self, psi, hold):
        """Return what to say of loops that do not close."""
        worst, first = [], 0
        for cut in self.mechanism.cut_joints:
            rows = CUT_JOINT_EQUATIONS[cut.type]
            gap = np.abs(psi[first:first + rows]).max()
            first += rows
            if gap > TOLERANCE * self.extent:
                worst.append(f'{cut.name} stays open by {gap:.3g}')
        held = f' with {", ".join(hold)} held' if len(hold) > 0 else ''
        freedoms = self.nv - self.nc
        advice = ('Move the initial position closer to a closed one, or check lengths and cut '
                  'points.')
        if len(hold) > max(freedoms, 0):
            advice = (f'{len(hold)} joints are held, but this mechanism has only {freedoms} '
                      f'degree{"s" if freedoms != 1 else ""} of freedom: hold fewer.')
        return (f'{self.mechanism.name} cannot be assembled from this position{held}: '
                f'{"; ".join(worst)} (m or rad). {advice}')


def _least_change(jac, error, metric):
    """Return the x with ``jac`` x = ``error`` that is least in the metric L L^T."""
    weighted = np.linalg.solve(metric, jac.T).T
    y = np.linalg.lstsq(weighted, error, rcond=RANK_TOLERANCE)[0]
    return np.linalg.solve(metric.T, y)


def _rank(jac):
    if jac.size == 0:
        return 0
    singular = np.linalg.svd(jac, compute_uv=False)
    return int(np.sum(singular > RANK_TOLERANCE * max(singular[0], 1e-300)))
