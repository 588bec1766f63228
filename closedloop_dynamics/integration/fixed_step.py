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

"""A whole run under a sequence of torques, recorded at even intervals, as one compiled loop."""

from typing import NamedTuple

import numpy as np

from .advance import advance, DONE
from .evaluation import apply_effects, evaluate, take_states
from .system import number_of_states
from ..core import energy, kinematics
from ..core.compiled import compiled, inlined, released
from ..core.joint_wrenches import bias_forces, cut_wrenches, joint_wrenches
from ..core.loop_closure import largest
from ..core.manifold import add_work, rates_begin
from ..core.types import DOF
from ..effects.table import STORED


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
    work: np.ndarray  # Shape (1,): of the torques over the whole run [J]
    since: np.ndarray  # Shape (ns,): state since which it is still to be added


def allocate_buffer(system, instants, evaluated, body, point):
    """
    Allocate the buffer of a run.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    instants : int
        How many there will be.
    evaluated : bool
        Whether more than the state is wanted; of planar mechanisms.
    body : ndarray of int, shape (n,)
        Of the named points.
    point : ndarray, shape (n, 2)
        In that body's frame [m].

    """
    count = instants if evaluated else 0
    effects = 0 if system.effects is None else len(system.effects.kind)
    return RunBuffer(
        state=np.zeros((instants, number_of_states(system))),
        qdd=np.zeros((count, len(system.qdd))), lam=np.zeros((count, len(system.lam))),
        scalars=np.zeros((count, 3)), output=np.zeros((count, effects, 2)),
        wrench=np.zeros((count, len(system.model.cut), 3)), body=body, point=point,
        place=np.zeros((count, len(body), 2)), work=np.zeros(1),
        since=np.zeros(number_of_states(system)))


@compiled
def _take_output(effects, output):
    """Copy what the effects say of themselves."""
    if effects is not None:
        for row in range(output.shape[0]):
            output[row, 0] = effects.output[row, STORED]
            output[row, 1] = effects.output[row, 1]


@inlined
def _copy(values, out):
    """Copy numbers: without numba's runtime no array is assigned as a whole."""
    for k in range(out.shape[0]):
        out[k] = values[k]


@inlined
def _energies(model, work, qd, out):
    """Compute the energies of a state after its evaluation."""
    energy.energies(
        model.tree, model.body, model.gravity, work.piece, work.body, work.equation, qd, out)


@compiled
def _note(system, state, buffer, instant):
    """Write one instant."""
    nv, work = system.qdd.shape[0], system.work
    _copy(state, buffer.state[instant])
    # Of mechanisms in space the states alone are kept.
    if buffer.qdd.shape[0] == 0:
        return
    take_states(system.effects, state, 2 * nv)
    evaluate(system, state[:nv], state[nv:2 * nv])
    _copy(system.qdd, buffer.qdd[instant])
    _copy(system.lam, buffer.lam[instant])
    buffer.scalars[instant, 0] = largest(work.closure)
    _energies(system.model, work, state[nv:2 * nv], buffer.scalars[instant, 1:3])
    _take_output(system.effects, buffer.output[instant])
    cut_wrenches(system.model.cut, system.model.cut_point, work.cut_piece, work.body, system.lam,
                 work.share,
                 buffer.wrench[instant])
    for k in range(buffer.body.shape[0]):
        kinematics.point_position(
            work, buffer.body[k], buffer.point[k, 0], buffer.point[k, 1], buffer.place[instant, k])


@released
def annotate(system, torque, zero_order_hold, decimation, buffer):
    """Fill in a buffer of which only the states are known."""
    for instant in range(buffer.state.shape[0]):
        _copy(torque[max(instant * decimation - 1, 0) // zero_order_hold], system.tau)
        _note(system, buffer.state[instant], buffer, instant)


def joint_forces(system, torque, zero_order_hold, decimation, state, qdd, lam):
    """
    Compute the wrenches in the joints of the trees at instants of a known motion.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism; the workspace is overwritten.
    torque, zero_order_hold, decimation
        As for ``run``.
    state : ndarray, shape (instants, ns)
        Coordinates, rates, and what effects add.
    qdd : ndarray, shape (instants, nv)
        Joint accelerations.
    lam : ndarray, shape (instants, nc)
        Multipliers.

    Returns
    -------
    ndarray, shape (instants, nv, 3 or 6)
        Moment and force that the parent exerts on the child [N m, N].

    """
    out = np.empty((*qdd.shape, system.work.wrench.shape[1]))
    fill_joint_forces(system, torque, zero_order_hold, decimation, state, qdd, lam,
                      np.zeros_like(system.work.force), out)
    return out


@released
def fill_joint_forces(system, torque, zero_order_hold, decimation, state, qdd, lam, scratch, out):
    """
    Fill in what ``joint_forces`` returns.

    Parameters
    ----------
    system, torque, zero_order_hold, decimation, state, qdd, lam
        As for ``joint_forces``.
    scratch : ndarray, shape (nb + 1, 6 or 12)
        Overwritten.
    out : ndarray, shape (instants, nv, 3 or 6)
        Written in place.

    """
    model, work, tree, nv = system.model, system.work, system.model.tree, qdd.shape[1]
    nq = rates_begin(system.manifold, nv)
    for instant in range(state.shape[0]):
        take_states(system.effects, state[instant], nq + nv)
        q, qd = state[instant, :nq], state[instant, nq:nq + nv]
        kinematics.outward(model, q, qd, work)
        row = max(instant * decimation - 1, 0) // zero_order_hold
        _copy(torque[row], system.tau)
        apply_effects(system.effects, system.manifold, work, q, qd, system.tau)
        bias_forces(work, scratch)
        joint_wrenches(model, work, qdd[instant], lam[instant], scratch)
        for i in range(1, tree.shape[0]):
            _copy(scratch[i], out[instant, tree[i, DOF]])


@released
def run(system, moving, tableau, stabilisation, state, step_size, torque, zero_order_hold,
        decimation, steps, scratch, buffer):
    """
    Make a whole run of fixed steps.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism; ``tau`` is set from ``torque``.
    moving : Moving
        What integrators see of it.
    tableau, stabilisation, step_size, scratch
        As for ``advance.advance``.
    state : ndarray, shape (ns,)
        At the start; advanced in place.
    torque : ndarray, shape (rows, nv)
        Joint torques, one row after the other.
    zero_order_hold : int
        Steps that a row acts for.
    decimation : int
        Steps from one instant of the buffer to the next; the first is the start.
    steps : int
        How many; no more than the rows last.
    buffer : RunBuffer
        Written in place.

    Returns
    -------
    status : int
        Of ``integration.advance``.
    done : int
        Steps completed.

    """
    _copy(torque[0], system.tau)
    _copy(state, buffer.since)
    buffer.work[0] = 0.0
    _note(system, state, buffer, 0)
    done = 0
    while done < steps:
        if done % zero_order_hold == 0:
            _work(system.manifold, system.tau, state, buffer)
            _copy(torque[done // zero_order_hold], system.tau)
        portion = min(zero_order_hold - done % zero_order_hold, decimation - done % decimation)
        status, made = advance(
            moving, tableau, stabilisation, state, step_size, min(portion, steps - done), scratch)
        done += made
        if status != DONE:
            return status, done
        if done % decimation == 0:
            _note(system, state, buffer, done // decimation)
    _work(system.manifold, system.tau, state, buffer)
    return DONE, done


@inlined
def _work(manifold, tau, state, buffer):
    """Add the work of the torques held since the last call."""
    add_work(manifold, tau, buffer.since, state, 1, buffer.work)
    _copy(state, buffer.since)


@released
def energies(system, state, out):
    """
    Compute the energies of states.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism; without effects that store energy.
    state : ndarray, shape (n, ns)
        Of one state each row.
    out : ndarray, shape (n, 2)
        Written in place: kinetic energy, potential energy in gravity [J].

    """
    nv = system.qdd.shape[0]
    for k in range(state.shape[0]):
        evaluate(system, state[k, :nv], state[k, nv:2 * nv])
        _energies(system.model, system.work, state[k, nv:2 * nv], out[k])
