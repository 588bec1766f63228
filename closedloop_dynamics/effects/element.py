# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What an effect says of itself, of which the engine makes a row of its table of effects."""

from typing import NamedTuple, Tuple

import numpy as np

from .force_law import ForceLaw, FRICTION, INERTIA, NO_GAP
from ..codegen.function_table import VALUE_COLUMNS

# Place among the values of a law that wants the reaction in its joint: time constant of that [s].
LOAD_TIME = 11
# First column of what laws write: stored energy [J]. The others are the law's readings.
STORED = 0
# What a state of an effect is: a state of its own, energy dissipated, or work done on the
# mechanism from outside (both integrated with the rest).
OWN, DISSIPATED, WORK = range(3)

# Columns of what is known of freedoms of cut joints that effects act in, as numbers and as
# constants: ``engine/effect_table.hpp`` has what they are.
SLIDES, IN_PLANE, ROW_A, ROW_B, FOLLOWED, CUT, RATE_ONLY, ACROSS = range(8)
CUT_INDEX_COLUMNS = 8
POINT_A, POINT_B, AXIS, SIDE_A, SIDE_B, ACROSS_B, SCALE, ZERO = 0, 3, 6, 9, 12, 15, 18, 19
CUT_VALUE_COLUMNS = 20
# Both where nothing acts in cut joints.
NO_CUTS = np.zeros((0, CUT_INDEX_COLUMNS), dtype=np.int64), np.zeros((0, CUT_VALUE_COLUMNS))


class State(NamedTuple):
    """One state that an effect adds to the state vector."""

    role: int  # ``OWN``, ``DISSIPATED`` or ``WORK``
    scale: float = 1.0  # Size to which error control relates its tolerance
    initial: float = 0.0  # Value at the start


class ForceElement(NamedTuple):
    """One effect in a mechanism."""

    law: ForceLaw
    joints: Tuple[int, ...] = ()  # Their places in q, of cut joints behind those of the tree
    bodies: Tuple[int, ...] = ()  # Their rows
    values: Tuple[float, ...] = ()  # Parameters, in the order the law reads them
    states: Tuple[State, ...] = ()  # In the order the law reads and writes them
    # Entries of numbers, such as pieces of a profile or a curve, in the order the law reads them.
    data: Tuple[Tuple[float, ...], ...] = ()
    # Whether the law acts along the sum of its joints, whose arms are the first entry.
    summed: bool = False
    loaded: bool = False  # Whether the law wants the reaction in its joint
    gap: int = NO_GAP  # What opens and closes
    # For a motion: its row of ``Model.cut``, multiplier, column of ``Model.cut_point``.
    equation: Tuple[int, ...] = ()

    @property
    def numbers(self):
        """Return the numbers of the entries, one after the other."""
        return [number for entry in self.data for number in entry]

    @property
    def sticks(self):
        """Whether its force follows from accelerations: at rest, or that of inertia."""
        return self.law.role in (FRICTION, INERTIA)


def states_of(elements, cuts=None):
    """
    Return the states that effects add: their own, then angles of cut joints that are followed.

    ``cuts``: index and values of the freedoms of cut joints that anything acts in; where their
    angles are followed is written.
    """
    states = [state for element in elements for state in element.states]
    for row in () if cuts is None else cuts[0]:
        if row[FOLLOWED] >= 0:
            row[FOLLOWED] = len(states)
            states.append(State(OWN))
    return states


class Row:
    """
    An effect as laws on symbols have it.

    Attributes
    ----------
    law : ForceLaw
    number : int
        Of its row in the engine's table.
    state, states : int
        Place of its first state, and how many they are.
    joints, bodies, equation : list of int
        As of ``ForceElement``.
    summed : int
        How many arms its numbers begin with: that of each joint; 0: none.
    arms, data : ndarray
        These arms, and the numbers behind them.
    begin, count : int
        Where the latter begin among the numbers of all effects, and how many entries they are.
    values : ndarray, shape (VALUE_COLUMNS,)
        Parameters.

    """

    def __init__(self, element, number=0, state=0, begin=0):
        self.law, self.number = element.law, number
        self.state, self.states = state, len(element.states)
        self.joints, self.bodies, self.equation = map(list, (
            element.joints, element.bodies, element.equation))
        self.summed = len(element.joints) if element.summed else 0
        numbers = np.array(element.numbers, dtype=float)
        self.arms, self.data = numbers[:self.summed], numbers[self.summed:]
        self.begin, self.count = begin + self.summed, len(element.data) - bool(element.summed)
        self.values = np.zeros(VALUE_COLUMNS)
        self.values[:len(element.values)] = element.values
