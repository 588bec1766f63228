# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Torques and constraint forces that a given motion of a simulated mechanism needs."""

import numpy as np

from ..codegen import space
from ..engine import native, types as t
from ..mechanism.errors import SimulationError

# Singular values below this share of the largest are rounding; so are parts of a unit below that.
REPEATS, CLEAR = 1e-12, 1e-9
# Change of reactions, of the largest, at which friction that depends on them is found.
SETTLED = 1e-12


class InverseDynamics:
    """
    Solves tau + tau_effects + J^T lambda = I qdd + c, tau zero at joints without a drive.

    ``find``, of coordinates, rates and accelerations, as for ``solve`` but not checked yet, solves
    at once, where arrays are given and nothing is refused, and returns whether it did; ``torque``
    and ``lam`` are its results, until it is called again.
    """

    def __init__(self, data):
        self._data, mechanism, equations = data, data.mechanism, data.equations
        nv, tree = mechanism.coordinates.nv, data.actuated
        self._actuated = tree[tree < nv]
        known = mechanism.cut_coordinates
        self._driven = [known.names[place] for place in known.actuated]
        self._passive = np.setdiff1d(np.arange(nv), self._actuated)
        count = len(self._actuated)
        found = np.zeros(count + equations.nc)
        self.torque, self.lam = found[:count], found[count:]
        self.find = native.bind(
            'find_torques', data.system.native, self._actuated.astype(np.int64), self._passive,
            equations.nc - len(mechanism.motions), data.own, found)

    def solve(self, q, qd, qdd):
        """
        Return torques of the actuated joints and multipliers for a motion.

        Of coordinates, rates and accelerations that are consistent with the loops;
        SimulationError.
        """
        jac = self._jacobian(q, qd, qdd)
        system, equations, table = self._data.system, self._data.equations, self._data.table
        table.states[:] = self._data.own
        while True:
            torque, lam = self._least_torques(self.needed(q, qd, qdd), jac)
            if table.loaded[0] == 0:
                return torque, lam
            # Friction driven by reactions depends on the result: a fixed point, fast because
            # friction is the smaller part.
            system.native.load_joints(equations.model, equations.work, qd, qdd, lam)
            if system.native.feel_loads(table.states, SETTLED):
                return torque, lam

    def _jacobian(self, q, qd, qdd):
        """Return the constraint Jacobian, or refuse accelerations that open the loops."""
        equations = self._data.equations.move(q, qd)
        jac, (_, _, bias) = equations.jacobian(), equations.closures()
        first, last = (space.ACCELERATION, space.ACCELERATION + 3) if space.is_spatial(
            equations.model) else (t.AX, t.AY + 1)
        largest = np.abs(equations.work.body[:, first:last]).max()
        # The motion that is given may be another one than is prescribed.
        loops = len(jac) - len(self._data.mechanism.motions)
        part = np.abs(jac[:loops] @ qdd + bias[:loops]).max(initial=0.0)
        # Beside its own size, what is left by rounding of the accelerations it is a difference of.
        noise = 1e-12 * largest
        if part > noise + 1e-8 * max(
                np.abs(jac * qdd).max(initial=0.0), np.abs(bias[:loops]).max(initial=0.0)):
            raise SimulationError(
                f'This acceleration opens the loops: the cut joints would separate at {part:.3g} '
                'm/s^2. Give accelerations of all joints that belong together, such as those '
                'that forward_dynamics returns.')
        return jac

    def needed(self, q, qd, qdd):
        """
        Return the required sum of torques and constraint forces at the joints, shape (nv,).

        I qdd + c - tau_effects [N m or N]; q, qd, qdd need not close the loops.
        """
        need, data, table = np.zeros(len(qd)), self._data, self._data.table
        effects, system = data.effect_set, data.system
        system.native.touch()
        system.model.outward(q, qd, system.work)
        if len(table.role):
            effects.steady(q, qd)
            if len(table.cuts.index):
                table.cut_accelerations(system.model, system.work, qdd, True, table.cuts.qdd)
                table.cuts.qdd[:len(qdd)] = qdd
            effects.hold_inertia(table.cuts.qdd if len(table.cuts.index) else qdd)
            table.apply_effects(
                system.work.body, data.coordinates.by_freedom(q), qd, np.zeros(len(system.tau)))
            effects.hold_inertia(None)
            effects.unsteady()
            system.work.bias_forces(table.reaction)
        system.model.tree_torque(system.work, qdd, need)
        return need - table.applied[:len(need)] if len(table.role) else need

    def _least_torques(self, need, jac):
        """Return the least torques of the actuated joints, and multipliers, that add up to it."""
        # In cut joints they act through the tree.
        system = self._data.system
        levers = self._data.cuts.jacobian(
            system.model, system.work, self._driven) if self._driven else (
                np.zeros((0, len(need))))
        unknowns = np.concatenate(
            [np.eye(len(need))[:, self._actuated], levers.T, jac.T], axis=1)
        count = len(self._actuated) + len(self._driven)
        solution = np.linalg.lstsq(unknowns, need, rcond=REPEATS)[0]
        # What may be added: combinations of torques and multipliers that add up to nothing. Of
        # equal torques these are the least multipliers.
        _, sizes, rows = np.linalg.svd(unknowns)
        nothing = rows[(sizes > REPEATS * sizes.max(initial=0.0)).sum():]
        sides, sizes, ways = np.linalg.svd(nothing[:, :count], full_matrices=False)
        some = sizes > CLEAR
        solution -= nothing.T @ (sides[:, some] @ (ways[some] @ solution[:count] / sizes[some]))
        left = np.abs(unknowns @ solution - need)[self._passive].max(initial=0.0)
        if left > 1e-8 * max(np.abs(need).max(), 1e-30):
            raise SimulationError(
                f'The actuated joints ({", ".join(self._data.mechanism.actuated_joints)}) cannot '
                f'produce this motion: {left:.3g} N m is missing at the others. Actuate more '
                'joints, or give an acceleration that the loops allow.')
        return solution[:count], solution[count:]
