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
What the compiled side knows of the effects: flat arrays, one row for each listed effect.

The kind of a row chooses its law in ``dispatch``; which rows there are is data, so that one
compiled code serves every scene.

"""

from typing import NamedTuple, Tuple

import numpy as np

# Columns of EffectTable.index: first own state; joint (its place in q) or the row of the body
# that carries the first point; the row of the second point's body, or of the joint's; whether the
# law wants the reaction in its joint, as its second state.
STATE, FIRST, SECOND, LOADED = range(4)
INDEX_COLUMNS = 4
VALUE_COLUMNS = 12
# Last column of EffectTable.values where a law is LOADED: time constant of the reaction [s].
LOAD_TIME = 11
# First column of EffectTable.output: stored energy [J]. The others are the law's readings.
STORED = 0
OUTPUT_COLUMNS = 5

# What a state of an effect is: a state of its own, energy dissipated, or work done on the
# mechanism from outside (both integrated with the rest).
OWN, DISSIPATED, WORK = range(3)


class State(NamedTuple):
    """
    One state that an effect adds to the state vector.

    Attributes
    ----------
    role : int
        ``OWN``, ``DISSIPATED`` or ``WORK``.
    scale : float
        Size to which error control relates its tolerance.
    initial : float
        Value at the start.

    """

    role: int
    scale: float = 1.0
    initial: float = 0.0


class Law(NamedTuple):
    """
    One effect as a row of the table.

    Attributes
    ----------
    kind : int
        The ``KIND`` of the effect's module.
    index : tuple of int
        FIRST and SECOND, as far as the law reads them.
    values : tuple of float
        Parameters, in the order the law reads them.
    states : tuple of State
        In the order the law reads and writes them.
    loaded : bool
        Whether the law wants the reaction in its joint.

    """

    kind: int
    index: Tuple[int, ...]
    values: Tuple[float, ...]
    states: Tuple[State, ...] = ()
    loaded: bool = False


class EffectTable(NamedTuple):
    """
    The listed effects, as the kernels read them.

    Attributes
    ----------
    kind, enabled : ndarray of int, shape (ne,)
    index : ndarray of int, shape (ne, INDEX_COLUMNS)
    values : ndarray, shape (ne, VALUE_COLUMNS)
    output : ndarray, shape (ne, OUTPUT_COLUMNS)
        Written by the laws.
    states, rates : ndarray, shape (nz,)
        The effects' states and their derivatives, of the latest evaluation.
    scale : ndarray, shape (nz,)
        Sizes for error control.
    loaded : ndarray of int, shape (1,)
        How many effects want the reaction in their joint.
    applied : ndarray, shape (nv,)
        Joint torques: commands and effects. The commands' own array where no effect is listed.
    reaction : ndarray, shape (nb + 1, 5)
        Scratch of ``joint_reaction``; of no length where no effect is listed.

    """

    kind: np.ndarray
    enabled: np.ndarray
    index: np.ndarray
    values: np.ndarray
    output: np.ndarray
    states: np.ndarray
    rates: np.ndarray
    scale: np.ndarray
    loaded: np.ndarray
    applied: np.ndarray
    reaction: np.ndarray


def build_table(laws, tau, bodies):
    """
    Allocate the table of the listed effects.

    Parameters
    ----------
    laws : sequence of Law
        In the order of the scene.
    tau : ndarray, shape (nv,)
        The commanded joint torques.
    bodies : int
        Number of bodies.

    Returns
    -------
    EffectTable

    """
    count = len(laws)
    states = [state for law in laws for state in law.states]
    table = EffectTable(
        kind=np.array([law.kind for law in laws], dtype=np.int64),
        enabled=np.ones(count, dtype=np.int64),
        index=np.zeros((count, INDEX_COLUMNS), dtype=np.int64),
        values=np.zeros((count, VALUE_COLUMNS)),
        output=np.zeros((count, OUTPUT_COLUMNS)),
        states=np.array([state.initial for state in states], dtype=float),
        rates=np.zeros(len(states)),
        scale=np.array([state.scale for state in states], dtype=float),
        loaded=np.zeros(1, dtype=np.int64),
        applied=tau.copy() if count else tau,
        reaction=np.zeros((bodies + 1 if count else 0, 5)))
    first = 0
    for row, law in enumerate(laws):
        table.index[row, STATE] = first
        fill_row(table, row, law)
        first += len(law.states)
    return table


def fill_row(table, row, law):
    """
    Write the parameters of one effect, at the start or while a simulation runs.

    Parameters
    ----------
    table : EffectTable
        Written in place.
    row : int
        Of the effect.
    law : Law
        Of the row's kind.

    """
    table.index[row, 1:1 + len(law.index)] = law.index
    table.values[row] = 0.0
    table.values[row, :len(law.values)] = law.values
    table.index[row, LOADED] = law.loaded
    table.loaded[0] = table.index[:, LOADED].sum()
    first = table.index[row, STATE]
    table.scale[first:first + len(law.states)] = [state.scale for state in law.states]
