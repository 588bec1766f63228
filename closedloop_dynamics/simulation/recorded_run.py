# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The record of a whole run under a sequence of torques, and the forces in its joints."""

from typing import NamedTuple

import numpy as np

from .system import number_of_states


class RunBuffer(NamedTuple):
    """Results of a run at its instants; arrays that are not wanted have no length."""

    state: np.ndarray  # Shape (instants, ns)
    qdd: np.ndarray  # Shape (instants, nv)
    lam: np.ndarray  # Shape (instants, nc)
    # Shape (instants, 3): closure error [m or rad], kinetic energy, potential energy in
    # gravity [J].
    scalars: np.ndarray
    # Shape (instants, ne, 2): stored energy and first reading of every effect with a law.
    output: np.ndarray
    wrench: np.ndarray  # Shape (instants, number of cuts, 3): at the cut joints [N m, N]
    body: np.ndarray  # Shape (n,): of the named points
    point: np.ndarray  # Shape (n, 2): in that body's frame [m]
    place: np.ndarray  # Shape (instants, n, 2): in the world [m]


# Columns of the energy balance of a run.
SHARE, LOST, MOVED, TIME = range(4)


def run_samples(make, start, torque, schedule):
    """
    Make whole runs, one after the other, all from the start of one.

    ``make`` is ``run_samples`` of a run, which is left as it is; ``start``,
    shape (n, ns): the state of each, or one for all; ``torque``, shape (n or 1, rows, nv) [N m or
    N]; ``schedule``: steps that a row acts for, from one instant to the next, and in all.

    Returns states, shape (n, instants, ns), of the instants that were reached; statuses of
    ``engine.status``, shape (n,); and, shape (n, 4), the largest error of the energy balance
    relative to the energy that had moved by then, that error and that energy [J], when it was
    found [s].
    """
    count = max(len(start), len(torque))
    states = np.empty((count, schedule[2] // schedule[1] + 1, start.shape[1]))
    status, found = np.empty(count, dtype=np.int64), np.empty((count, 4))
    make(start, torque, *schedule, states, status, found)
    return states, status, found


def allocate_buffer(system, instants, evaluated, body, point):
    """
    Allocate the buffer of a run of so many instants.

    ``evaluated``: whether more than the state is wanted, of planar mechanisms; ``body``,
    ``point``: of the named points and in its frame [m], shapes (n,) and (n, 2).
    """
    count = instants if evaluated else 0
    effects = 0 if system.effects is None else len(system.effects.role)
    return RunBuffer(
        state=np.zeros((instants, number_of_states(system))),
        qdd=np.zeros((count, len(system.qdd))), lam=np.zeros((count, len(system.lam))),
        scalars=np.zeros((count, 3)), output=np.zeros((count, effects, 2)),
        wrench=np.zeros((count, len(system.model.cut), 3)), body=body, point=point,
        place=np.zeros((count, len(body), 2)))


def joint_forces(system, torque, zero_order_hold, decimation, state, qdd, lam):
    """
    Compute the wrenches in the joints of the trees at instants of a given motion.

    Moment and force that the parent exerts on the child [N m, N], shape (instants, nv, 3 or 6).
    ``torque``, ``zero_order_hold``, ``decimation`` are as for ``run``; ``state``, shape (instants,
    ns), has coordinates, rates and states of effects; accelerations and multipliers have the
    shapes (instants, nv) and (instants, nc). The system's workspace is overwritten.
    """
    out = np.empty((*qdd.shape, system.work.wrench.shape[1]))
    system.native.fill_joint_forces(
        torque, zero_order_hold, decimation, state, qdd, lam, np.zeros_like(system.work.force),
        out)
    return out
