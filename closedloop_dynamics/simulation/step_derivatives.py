# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of accelerations, corrections and wrenches of a scene, compiled."""

from functools import cache

import numpy as np

from .stepped_run import LaneRoutines, StepRoutines
from .system import link_evaluation
from .traced_scene import TracedScene
from ..codegen import function_table as calls
from ..codegen.machine_code import LANES, machine_code, PACKED, SCALAR
from ..codegen.routines import topology
from ..codegen.scene_routines import POINT
from ..codegen.sensitivities import (
    ACCELERATION_FORWARD, CLOSURE, CLOSURE_FORWARD, FORWARD, NAMES, SensitivityTrace, WRENCH,
    WRENCH_FORWARD)
from ..engine import native
from ..mechanism.errors import SingularityError


class StepDerivatives:
    """
    The ``routines`` that derivatives of steps are made of, by ``parameters``.

    They are compiled when they are first asked for, unless an earlier process has. The data,
    of a scene that has derivatives, stay as they are; ``scene``: where it was traced before.
    """

    def __init__(self, data, parameters, scene=None):
        self.parameters, self._system = parameters, data.system
        # Derivatives are of multipliers, too.
        link_evaluation(self._system)
        nv, nc = len(self._system.qdd), len(self._system.lam)
        self._scene = scene or TracedScene(data)
        self._nq = len(data.position)
        size = self._nq + 2 * nv + len(parameters.entries)
        qdd, lam = np.zeros(nv), np.zeros(nc)
        rows, self._origins, _ = data.loop_model.joint_places
        self._rows, self._cuts = tuple(rows.tolist()), data.cut_rows
        seed, result = np.zeros(size), np.zeros(
            max(size, nv + nc, 2 * nc, 12 * (len(rows) + len(self._cuts))))
        table = self._scene.table({
            calls.QDD: qdd, calls.LAM: lam, calls.SEED: seed, calls.RESULT: result,
            POINT: self._origins})
        self.routines = StepRoutines(table, qdd, lam, seed, result)

    def need(self, group):
        """
        Have some routines compiled, a group of ``codegen.sensitivities``.

        ``FORWARD``, ``REVERSE``, ``CLOSURE`` or ``WRENCH``.
        """
        table, scene = self.routines.table, self._scene
        if table[group[0]]:
            return
        key = ('sensitivities', group, topology(self.parameters.model), self.parameters.entries,
               self._rows, self._cuts, *scene.key)
        find = machine_code(key, lambda: [
            self._trace(True).routine(one) for one in group], SCALAR)
        for one in group:
            table[one] = find(NAMES[one])

    def _trace(self, with_arms):
        return SensitivityTrace(
            self.parameters.model, self._scene.act, self._scene.values.shape,
            self.parameters.entries, self._rows, self._cuts, with_arms)

    def in_lanes(self, group):
        """Return the ``LaneRoutines`` of a group, compiled."""
        routines, most = self.routines, 0
        tables = np.zeros((2, calls.STEP_COLUMNS), dtype=np.int64)
        for one in group:
            for with_arms, table in zip((True, False), tables):
                *table[2 * one:2 * one + 2], count, by_arms = self._in_lanes(one, with_arms)
                most = max(most, int(count))
                if not by_arms:
                    tables[1, 2 * one:2 * one + 2] = table[2 * one:2 * one + 2]
                    break
        shared = np.zeros(most)
        tables += self._scene.table({
            calls.QDD: routines.qdd, calls.LAM: routines.lam, calls.SHARED: shared})
        return LaneRoutines(
            tables.ravel(), shared, np.zeros(calls.LANES * len(routines.result)))

    def _in_lanes(self, which, with_arms):
        """Return the addresses of both parts of a routine, and what it tells of itself."""
        key = ('sensitivities in lanes', which, with_arms, topology(self.parameters.model),
               self.parameters.entries, *self._scene.key)
        both = cache(lambda: self._trace(with_arms).in_lanes(which))
        first = machine_code(key, lambda: both()[0], PACKED)
        second = machine_code(key, lambda: both()[1], LANES)
        found = np.zeros(2)
        native.call(np.array([first('shared')]), 0, found, found)
        return first('before'), second('beside'), *found

    def _changes(self, which, q, qd, seeds):
        """Return results of a forward routine for many directions, shape (results, directions)."""
        routines = self.routines
        found = np.empty((len(seeds), len(routines.result)))
        for seed, result in zip(seeds, found):
            routines.seed[:] = seed
            if not native.call(routines.table, which, q, qd):
                raise SingularityError(
                    'There are no derivatives here: closure equations depend on one another in '
                    'this position, or nearly. Take a position beside it.')
            result[:] = routines.result
        return found.T

    def by_parameter(self, q, qd, qdd, lam):
        """
        Return derivatives by the parameters, coordinates and rates of a state held.

        Of accelerations and multipliers, shape (nv + nc, np); of closures and of their rates, (nc,
        np).
        """
        self.need(FORWARD)
        self.routines.qdd[:], self.routines.lam[:] = qdd, lam
        seeds = self._seeds_of_parameters()
        found = self._changes(ACCELERATION_FORWARD, q, qd, seeds)[:len(qdd) + len(lam)]
        return found.copy(), *self._of_closures(q, qd, seeds)

    def wrenches(self, q, qd, qdd, lam):
        """
        Return the wrenches in the joints that are not fixed and in cut joints; their derivatives.

        Moment and force of each, in world axes, at the origin of the child, of cut joints at the
        cut point of body A, shape (6 n,); and by joint displacements, rates, torques and
        parameters, (6 n, 3 nv + np). Arguments are those of ``by_parameter``.
        """
        self.need(WRENCH)
        self.routines.qdd[:], self.routines.lam[:] = qdd, lam
        found = self._changes(WRENCH_FORWARD, q, qd, np.vstack((
            self._seeds_of_displacements(q), self._seeds_of_rates_and_torques(),
            self._seeds_of_parameters())))
        count = 6 * (np.count_nonzero(self._rows) + len(self._cuts))
        return found[:count, 0].copy(), found[count:2 * count].copy()

    def closures(self, q, qd):
        """
        Return derivatives of the closure equations, and of their rates.

        By joint displacements, the rates held, both (nc, nv); by parameters, both (nc, np).
        """
        return (*self._of_closures(q, qd, self._seeds_of_displacements(q)),
                *self._of_closures(q, qd, self._seeds_of_parameters()))

    def _of_closures(self, q, qd, seeds):
        self.need(CLOSURE)
        nc = len(self.routines.lam)
        found = self._changes(CLOSURE_FORWARD, q, qd, seeds)
        return found[:nc].copy(), found[nc:2 * nc].copy()

    def _seeds_of_displacements(self, q):
        nv = len(self.routines.qdd)
        seeds = np.zeros((nv, len(self.routines.seed)))
        seeds[:, :self._nq] = turned(self._system.manifold, q, np.eye(nv)).T
        return seeds

    def _seeds_of_rates_and_torques(self):
        return np.eye(2 * len(self.routines.qdd), len(self.routines.seed), self._nq)

    def _seeds_of_parameters(self):
        matrix, seed = self.parameters.matrix, self.routines.seed
        return np.hstack((np.zeros((matrix.shape[1], len(seed) - len(matrix))), matrix.T))


def turned(manifold, q, displacements):
    """
    Return changes of coordinates, (nq, n), for displacements of joints, (nv, n), at coordinates q.

    Quaternions by rotations, of orientations about the axes of the child.
    """
    if manifold is None:
        return displacements
    found = np.zeros((displacements.shape[1], len(q)))
    for change, out in zip(displacements.T, found):
        manifold.rates(np.concatenate((q, change)), out)
    return found.T
