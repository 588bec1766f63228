# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What is seen of a motion, and its derivatives along given directions, compiled."""

from typing import Any, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ..codegen import function_table as calls
from ..codegen.machine_code import machine_code, SCALAR
from ..codegen.motion_derivatives import AXES, FORCE, MotionTrace, PLACE, POINT_NUMBERS, SPIN
from ..codegen.routines import topology
from ..codegen.scene_routines import POINT
from ..engine import native
from ..mechanism.errors import SingularityError
from ..simulation.traced_scene import TracedScene


class Seen(NamedTuple):
    """
    Numbers of a motion, and what they change by along directions, the last axis of changes.

    Attributes
    ----------
    acceleration : ndarray, shape (nv, n)
        Changes of the joint accelerations.
    place, spin, force : tuple of 2 ndarrays, shape (points, 3) and (points, 3, n)
        Of points: place [m], angular velocity of the body [rad/s], specific force [m/s^2].
    axes : tuple of 2 ndarrays, shape (points, 3, 3) and (points, 3, 3, n)
        Of the body; columns.
    wrench : tuple of 2 ndarrays, shape (joints, 6) and (joints, 6, n)
        Moment and force in world axes [N m, N].

    """

    acceleration: np.ndarray
    place: Tuple[np.ndarray, np.ndarray]
    axes: Tuple[np.ndarray, np.ndarray]
    spin: Tuple[np.ndarray, np.ndarray]
    force: Tuple[np.ndarray, np.ndarray]
    wrench: Tuple[np.ndarray, np.ndarray]


class MotionCode:
    """
    Derivatives of places, spins, specific forces and wrenches of a simulation's motion.

    ``points``: rows of bodies and places in them; ``forces``: whether wrenches are wanted;
    ``arrays``: ``simulation.parameters.ParameterArrays``.
    """

    def __init__(self, simulation: Any, arrays: Any,
                 points: Sequence[Tuple[int, np.ndarray]], forces: bool) -> None:
        system, scene = simulation.system, TracedScene(simulation)
        nv, nc = len(system.qdd), len(system.lam)
        rows, origins, _ = simulation.loop_model.joint_places
        rows, cuts = (tuple(rows.tolist()), simulation.cut_rows) if forces else ((), ())
        bodies = tuple(int(row) for row, _ in points)
        self._points, self._nv = len(bodies), nv
        # Kept: generated code has their addresses.
        self._places = np.ascontiguousarray(np.concatenate(
            [np.reshape([place for _, place in points], (-1, 3)), origins[:len(rows)]]))
        count = self._count = POINT_NUMBERS * len(bodies) + 6 * (
            np.count_nonzero(rows) + len(cuts))
        self._qdd, self._lam = np.zeros(nv), np.zeros(nc)
        self._seed = np.zeros(simulation.coordinates.nq + 2 * nv + len(arrays.entries))
        self._result = np.zeros(nv + 2 * count)
        self._table = scene.table({
            calls.QDD: self._qdd, calls.LAM: self._lam, calls.SEED: self._seed,
            calls.RESULT: self._result, POINT: self._places})
        self._scene = scene
        key = ('motion derivatives', topology(arrays.model), arrays.entries, bodies, rows, cuts,
               *scene.key)
        self._table[0] = machine_code(key, lambda: [MotionTrace(
            arrays.model, scene.act, scene.values.shape, arrays.entries, bodies, rows,
            cuts).motion()], SCALAR)('motion')

    def __call__(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, lam: np.ndarray,
                 seeds: Optional[np.ndarray]) -> Seen:
        """Return what is seen in a state, and its changes along seeds, shape (n, inputs)."""
        if seeds is None:
            seeds = np.zeros((1, len(self._seed)))
        self._qdd[:], self._lam[:] = qdd, lam
        found = np.empty((len(seeds), len(self._result)))
        for seed, result in zip(seeds, found):
            self._seed[:] = seed
            if not native.call(self._table, 0, q, qd):
                raise SingularityError(
                    'There are no derivatives here: closure equations depend on one another in '
                    'this position, or nearly.')
            result[:] = self._result
        nv, count, rest = self._nv, self._count, POINT_NUMBERS * self._points
        values, changes = found[0, nv:nv + count], found[:, nv + count:].T

        def parts(first: int, last: int, *shape: int) -> Tuple[np.ndarray, np.ndarray]:
            pair = (values[:rest].reshape(-1, POINT_NUMBERS)[:, first:last],
                    changes[:rest].reshape(-1, POINT_NUMBERS, len(seeds))[:, first:last])
            return (pair[0].reshape(-1, *shape), pair[1].reshape(-1, *shape, len(seeds)))

        return Seen(
            found[:, :nv].T, parts(PLACE, AXES, 3), parts(AXES, SPIN, 3, 3),
            parts(SPIN, FORCE, 3), parts(FORCE, POINT_NUMBERS, 3),
            (values[rest:].reshape(-1, 6), changes[rest:].reshape(-1, 6, len(seeds))))
