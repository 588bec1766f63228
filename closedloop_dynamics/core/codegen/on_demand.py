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
What is asked of a state in space beside its accelerations, by routines of its own.

They are unrolled from the same recursions as the evaluation, and compiled when they are first
called: what nobody asks for costs nothing.

"""

import numpy as np

from . import function_table as calls, space
from .numbers import DEPENDENT, Numbers


def arrays(model, reaction=None):
    """
    Allocate what the routines read and write, by place in the function table.

    Parameters
    ----------
    model : Model
        Constant arrays of a mechanism in space.
    reaction : ndarray, shape (nb + 1, 6), optional
        Takes the wrenches in the joints of the tree.

    Returns
    -------
    dict of int to ndarray

    """
    nv, equations = len(model.tree) - 1, int(space.first_equations(model)[-1])
    if reaction is None or not len(reaction):
        reaction = np.zeros((nv + 1, 6))
    return {
        calls.ALL_LAM: np.zeros(equations), calls.JOINT_WRENCH: reaction,
        calls.CUT_WRENCH: np.zeros((len(model.cut), 6)), calls.ENERGY: np.zeros(2),
        calls.ALL_CLOSURES: np.zeros((3, equations)),
        calls.ALL_JACOBIAN: np.zeros((equations, nv)), calls.TREE_FORCE: np.zeros(nv)}


class OnDemand:
    """
    Answers about states of one system in space.

    Parameters
    ----------
    system : integration.system.System
        Its routines and arrays are used.

    """

    def __init__(self, system):
        """Look up which equations the elimination works on."""
        self._table, model = system.table, system.model
        self._system = system
        self.kept = Numbers(model).kept
        self._complete = bool(self.kept.all())

    def _call(self, which, result, q, qd):
        """Let a routine write a result, and return that: not a copy."""
        calls.function(self._table, which)(
            self._table.ctypes.data, q.ctypes.data, qd.ctypes.data)
        return calls.array(self._table, result)

    def outward(self, q, qd):
        """Return ``Workspace.body`` in a state, without effects."""
        calls.function(self._table, calls.OUTWARD)(
            self._table.ctypes.data, q.ctypes.data, qd.ctypes.data)
        return self._system.work.body

    def energies(self, q, qd):
        """Return kinetic energy, and potential energy in gravity, of a state [J]."""
        return self._call(calls.ENERGIES, calls.ENERGY, q, qd).tolist()

    def closures(self, q, qd):
        """Return psi, J qd and Jdot qd of all equations, shape (3, nc), of a state."""
        return self._call(calls.CLOSURES, calls.ALL_CLOSURES, q, qd)

    def jacobian(self, q, qd):
        """Return J of all equations, shape (nc, nv), of a state."""
        return self._call(calls.JACOBIAN, calls.ALL_JACOBIAN, q, qd)

    def of_all(self, q, qd, lam):
        """Return the least multipliers of all equations that do what those of the kept ones do."""
        if self._complete:
            return lam
        jac = self.jacobian(q, qd)
        return np.linalg.lstsq(jac.T, jac[self.kept].T @ lam, rcond=DEPENDENT)[0]

    def cut_wrenches(self, q, qd, lam):
        """
        Return what body B exerts on body A at each cut joint: the least that give the motion.

        Parameters
        ----------
        q, qd : ndarray, shape (nq,), (nv,)
            State.
        lam : ndarray
            Multipliers of the equations that the elimination works on.

        Returns
        -------
        ndarray, shape (number of cuts, 6)
            Moment, then force, at the cut point of A, in world axes, in the mechanism's order
            [N m, N].

        """
        calls.array(self._table, calls.ALL_LAM)[:] = self.of_all(q, qd, lam)
        return self._call(calls.CUT_WRENCHES, calls.CUT_WRENCH, q, qd).copy()

    def joint_wrenches(self, q, qd):
        """
        Return what parents exert on bodies, after an evaluation of the same state.

        Returns
        -------
        ndarray, shape (nb + 1, 6)
            Moment, then force, at the origin of each row, in world axes [N m, N].

        """
        return self._call(calls.JOINT_WRENCHES, calls.JOINT_WRENCH, q, qd)

    def tree_forces(self, q, qd, qdd):
        """
        Return the joint forces that accelerations take, loops open.

        Parameters
        ----------
        q, qd, qdd : ndarray, shape (nq,), (nv,), (nv,)
            The forces on the bodies are those that ``Workspace.body`` holds, after the outward
            routine and effects.

        Returns
        -------
        ndarray, shape (nv,)

        """
        self._system.qdd[:] = qdd
        return self._call(calls.TREE_FORCES, calls.TREE_FORCE, q, qd).copy()
