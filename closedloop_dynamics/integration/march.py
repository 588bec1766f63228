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
from .system import evaluate, number_of_states, take_states
from ..core.compiled import compiled, inlined, released
from ..core.energy import kinetic_energy, potential_energy
from ..core.loop_closure import largest
from ..core.types import ALPHA
from ..effects.table import STORED


class Tape(NamedTuple):
    """
    What a run leaves at its instants; all but the states of no length where not wanted.

    Attributes
    ----------
    state : ndarray, shape (instants, ns)
    qdd : ndarray, shape (instants, nv)
    lam : ndarray, shape (instants, nc)
    scalars : ndarray, shape (instants, 3)
        Closure error [m or rad], kinetic energy, potential energy in gravity [J].
    output : ndarray, shape (instants, ne, 2)
        Stored energy and first reading of every effect with a law.
    rows : ndarray of int, shape (n,)
        Bodies whose angle is wanted.
    angle : ndarray, shape (instants, n)

    """

    state: np.ndarray
    qdd: np.ndarray
    lam: np.ndarray
    scalars: np.ndarray
    output: np.ndarray
    rows: np.ndarray
    angle: np.ndarray


def allocate_tape(system, instants, evaluated, rows):
    """
    Allocate a tape.

    Parameters
    ----------
    system : System
        What moves.
    instants : int
        How many there will be.
    evaluated : bool
        Whether more than the state is wanted.
    rows : sequence of int
        Bodies whose angle is wanted.

    Returns
    -------
    Tape

    """
    count = instants if evaluated else 0
    effects = 0 if system.effects is None else len(system.effects.kind)
    return Tape(
        state=np.zeros((instants, number_of_states(system))),
        qdd=np.zeros((count, len(system.qdd))), lam=np.zeros((count, len(system.lam))),
        scalars=np.zeros((count, 3)), output=np.zeros((count, effects, 2)),
        rows=np.array(rows, dtype=np.int64), angle=np.zeros((count, len(rows))))


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


@compiled
def _note(system, state, tape, instant):
    """Write one instant."""
    nv, work = system.qdd.shape[0], system.work
    _copy(state, tape.state[instant])
    if tape.qdd.shape[0] == 0:
        return
    take_states(system.effects, state, nv)
    evaluate(system, state[:nv], state[nv:2 * nv])
    _copy(system.qdd, tape.qdd[instant])
    _copy(system.lam, tape.lam[instant])
    tape.scalars[instant, 0] = largest(work.closure)
    tape.scalars[instant, 1] = kinetic_energy(system.model, work, state[nv:2 * nv])
    tape.scalars[instant, 2] = potential_energy(system.model, work)
    _take_output(system.effects, tape.output[instant])
    for k in range(tape.rows.shape[0]):
        tape.angle[instant, k] = work.body[tape.rows[k], ALPHA]


@released
def annotate(system, torque, hold, every, tape):
    """
    Fill in a tape of which only the states are known.

    Parameters
    ----------
    system, torque, hold, every
        As for ``march``.
    tape : Tape
        Written in place, but for ``state``.

    """
    for instant in range(tape.state.shape[0]):
        _copy(torque[max(instant * every - 1, 0) // hold], system.tau)
        _note(system, tape.state[instant], tape, instant)


@released
def march(system, tableau, stabilisation, state, step_size, torque, hold, every, steps, scratch,
          tape):
    """
    Make a whole run of fixed steps.

    Parameters
    ----------
    system : System
        What moves; ``tau`` is set from ``torque``.
    tableau, stabilisation, step_size, scratch
        As for ``advance.advance``.
    state : ndarray, shape (ns,)
        At the start; advanced in place.
    torque : ndarray, shape (rows, nv)
        Joint torques, one row after the other.
    hold : int
        Steps that a row acts for.
    every : int
        Steps from one instant of the tape to the next; the first is the start.
    steps : int
        How many; no more than the rows last.
    tape : Tape
        Written in place.

    Returns
    -------
    status : int
        Of ``integration.advance``.
    done : int
        Steps completed.

    """
    _copy(torque[0], system.tau)
    _note(system, state, tape, 0)
    done = 0
    while done < steps:
        if done % hold == 0:
            _copy(torque[done // hold], system.tau)
        portion = min(hold - done % hold, every - done % every)
        status, made = advance(
            system, tableau, stabilisation, state, step_size, min(portion, steps - done), scratch)
        done += made
        if status != DONE:
            return status, done
        if done % every == 0:
            _note(system, state, tape, done // every)
    return DONE, done
