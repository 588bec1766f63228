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

"""Torques and constraint forces that a given motion of a simulated mechanism needs."""

import numpy as np

from .errors import SimulationError
from ..core import jacobian, kinematics, loop_closure, types as t
from ..core.codegen import space
from ..core.forward_dynamics import to_user_order
from ..core.joint_wrenches import bias_forces, tree_torque
from ..effects import dispatch, joint_reaction


class InverseDynamics:
    """Solves tau + tau_effects + J^T lambda = I qdd + c, tau zero at joints without a drive."""

    def __init__(self, mechanism, system, effects, table, on_demand=None):
        """Find the freedoms that are actuated; ``on_demand`` answers in space."""
        self._mechanism, self._system, self._on_demand = mechanism, system, on_demand
        self._effects, self._table = effects, table
        self._actuated = np.array(mechanism.coordinates.actuated, dtype=int)
        self._passive = np.setdiff1d(np.arange(mechanism.coordinates.nv), self._actuated)

    def solve(self, q, qd, qdd):
        """
        Return torques of the actuated joints and multipliers for a motion.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Joint coordinates.
        qd, qdd : ndarray, shape (nv,)
            Rates and accelerations, consistent with the loops.

        Returns
        -------
        torque : ndarray, shape (number of actuated joints,)
        lam : ndarray, shape (nc,)

        Raises
        ------
        SimulationError

        """
        jac = self._jacobian(q, qd, qdd)
        table = self._table
        while True:
            torque, lam = self._least_torques(self._needed(q, qd, qdd), jac)
            if table.loaded[0] == 0:
                return torque, lam
            # Friction driven by reactions depends on the result: a fixed point, fast because
            # friction is the smaller part.
            self._feel(q, qd, qdd, lam)
            places, values = self._effects.loads()
            change = np.abs(table.states[places] - values).max()
            table.states[places] = values
            if not change > 1e-12 * values.max():
                return torque, lam

    def _jacobian(self, q, qd, qdd):
        """Return the constraint Jacobian, or refuse accelerations that open the loops."""
        kept = slice(None)
        if self._on_demand is None:
            jac, bias, largest = self._in_plane(q, qd)
        else:
            kept = self._on_demand.kept
            jac, bias, largest = self._in_space(q, qd)
        part = np.abs(jac @ qdd + bias).max(initial=0.0)
        # Beside its own size, what is left by rounding of the accelerations it is a difference of.
        noise = 1e-12 * largest
        if part > noise + 1e-8 * max(
                np.abs(jac * qdd).max(initial=0.0), np.abs(bias).max(initial=0.0)):
            raise SimulationError(
                f'This acceleration opens the loops: the cut joints would separate at {part:.3g} '
                'm/s^2. Give accelerations of all joints that belong together, such as those '
                'that forward_dynamics returns.')
        return jac[kept]

    def _in_plane(self, q, qd):
        """Return Jacobian and bias of the closure equations, and the largest acceleration."""
        model, work = self._system.model, self._system.work
        jac = np.zeros((self._mechanism.number_of_equations, len(q)))
        bias = np.zeros(len(jac))
        kinematics.outward(model, q, qd, work)
        jacobian.constraint_jacobian(model, work, jac)
        loop_closure.update(model, work, t.NO_RESPONSES)
        to_user_order(model, work.bias, bias)
        return jac, bias, np.abs(work.body[:, [t.AX, t.AY]]).max()

    def _in_space(self, q, qd):
        """Do as ``_in_plane`` does, of all equations in space."""
        body = self._on_demand.outward(q, qd)
        bias, jac = self._on_demand.closures(q, qd)[2].copy(), self._on_demand.jacobian(q, qd)
        spin, velocity = (np.abs(body[:, place:place + 3]).max()
                          for place in (space.SPIN, space.VELOCITY))
        return jac.copy(), bias, np.abs(self._system.model.gravity).max() + spin * velocity

    def _feel(self, q, qd, qdd, lam):
        """Tell effects the reactions in their joints."""
        system, table = self._system, self._table
        if self._on_demand is None:
            joint_reaction.load(system.model, system.work, table, qdd, lam)
        else:
            system.qdd[:], system.lam[:] = qdd, lam
            self._on_demand.joint_wrenches(q, qd)
            joint_reaction.load_in_space(system.model, system.work, table)

    def _needed(self, q, qd, qdd):
        """Return what torques and constraint forces must add up to at the joints."""
        need, table, work = np.zeros(len(qd)), self._table, self._system.work
        if self._on_demand is None:
            kinematics.outward(self._system.model, q, qd, work)
        else:
            self._on_demand.outward(q, qd)
        if len(table.kind):
            self._effects.steady(qd)
            dispatch.apply(work.body, table, self._mechanism.coordinates.by_freedom(q), qd,
                           np.zeros(len(qd)))
            self._effects.unsteady()
        if self._on_demand is None:
            if len(table.kind):
                bias_forces(work, table.reaction)
            tree_torque(self._system.model, work, qdd, need)
        else:
            need = self._on_demand.tree_forces(q, qd, qdd)
        return need - table.applied if len(table.kind) else need

    def _least_torques(self, need, jac):
        """Return the least torques of the actuated joints, and multipliers, that add up to it."""
        unknowns = np.concatenate([np.eye(len(need))[:, self._actuated], jac.T], axis=1)
        solution = np.linalg.lstsq(unknowns, need, rcond=1e-12)[0]
        left = np.abs(unknowns @ solution - need)[self._passive].max(initial=0.0)
        if left > 1e-8 * max(np.abs(need).max(), 1e-30):
            raise SimulationError(
                f'The actuated joints ({", ".join(self._mechanism.actuated_joints)}) cannot '
                f'produce this motion: {left:.3g} N m is missing at the others. Actuate more '
                'joints, or give an acceleration that the loops allow.')
        count = len(self._actuated)
        return solution[:count], solution[count:]
