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
from ..core.forward_dynamics import to_user_order
from ..core.inverse_dynamics import tree_torque
from ..core.joint_wrenches import bias_forces
from ..effects import dispatch, joint_reaction


class InverseDynamics:
    """Solves tau + tau_effects + J^T lambda = I qdd + c, tau zero at joints without a drive."""

    def __init__(self, mechanism, system, effects, table):
        """Find the joints that are actuated."""
        self._mechanism, self._system = mechanism, system
        self._effects, self._table = effects, table
        driven = np.array([joint.actuated for joint in mechanism.joints], dtype=bool)
        self._actuated, self._passive = np.flatnonzero(driven), np.flatnonzero(~driven)

    def solve(self, q, qd, qdd):
        """
        Return torques of the actuated joints and multipliers for a motion.

        Parameters
        ----------
        q, qd, qdd : ndarray, shape (nv,)
            Joint coordinates, rates and accelerations, consistent with the loops.

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
            joint_reaction.load(self._system.model, self._system.work, table, qdd, lam)
            places, values = self._effects.loads()
            change = np.abs(table.states[places] - values).max()
            table.states[places] = values
            if not change > 1e-12 * values.max():
                return torque, lam

    def _jacobian(self, q, qd, qdd):
        """Return the constraint Jacobian, or refuse accelerations that open the loops."""
        model, work = self._system.model, self._system.work
        jac = np.zeros((self._mechanism.number_of_equations, len(q)))
        bias = np.zeros(len(jac))
        kinematics.outward(model, q, qd, work)
        jacobian.constraint_jacobian(model, work, jac)
        loop_closure.update(model, work, loop_closure.NO_RESPONSES)
        to_user_order(model, work.bias, bias)
        part = np.abs(jac @ qdd + bias).max(initial=0.0)
        # Beside its own size, what is left by rounding of the accelerations it is a difference of.
        noise = 1e-12 * np.abs(work.body[:, [t.AX, t.AY]]).max()
        if part > noise + 1e-8 * max(
                np.abs(jac * qdd).max(initial=0.0), np.abs(bias).max(initial=0.0)):
            raise SimulationError(
                f'This acceleration opens the loops: the cut joints would part at {part:.3g} '
                'm/s^2. Give accelerations of all joints that belong together, such as those '
                'that forward_dynamics returns.')
        return jac

    def _needed(self, q, qd, qdd):
        """Return what torques and constraint forces must add up to at the joints."""
        need, table, work = np.zeros(len(q)), self._table, self._system.work
        kinematics.outward(self._system.model, q, qd, work)
        if len(table.kind):
            self._effects.steady(qd)
            dispatch.apply(work.body, table, q, qd, np.zeros(len(q)))
            self._effects.unsteady()
            bias_forces(work.body, table.reaction)
        tree_torque(self._system.model, work, qdd, need)
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
