# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The table of effects for the engine: flat arrays, one row for each listed effect.

Each row obeys a law (``force_law``), whose routine it has the address of; which rows there are is
data.
"""

from typing import NamedTuple, Tuple

import numpy as np

from .force_law import ForceLaw, FRICTION, INERTIA, MOTION, NO_GAP
from ..core.codegen.function_table import LAW_COLUMNS, PRESENT_COLUMNS

# Columns of EffectTable.index: first own state; where its places begin among those of all effects:
# of its joints (in q, of cut joints behind those of the tree), then the rows of its bodies, of a
# motion in the place of both its row of ``Model.cut``, its multiplier and its column of
# ``Model.cut_point``; how many joints and how many bodies; whether the law acts along the sum of
# the joints, whose arms are its first numbers; whether it wants the reaction in its joint, as its
# second state; where its numbers begin among those of all effects, and how many entries they are;
# what its gap is (``force_law.NO_GAP`` to ``EVENT``).
STATE, PLACES, JOINTS, BODIES, SUMMED, LOADED, DATA, ENTRIES, GAP_OF = INDEX = range(9)
INDEX_COLUMNS = len(INDEX)
# Values of Contacts.mode: whether a contact is there while a step is made; undecided, its gap
# tells.
UNDECIDED, FREE, TOUCHING = range(3)
# Columns of Contacts.now, .start and .nodes: gap [m; rad], its rate, and the place of the roller
# as the other body sees it [m], three numbers; of nodes alone the error of a cubic through gaps
# and rates, and how far the path departs from its chord [m], both up to the node.
GAP, RATE, PLACE, ERROR, BEND = 0, 1, 2, 5, 6
NODE_COLUMNS = 7
# Columns of Contacts.trial, over all evaluations of a step: the fastest rate of the gap; the
# fastest motion of the roller; the largest gap on the wrong side; the largest gap of any node;
# whether the mode has been changed; dissipated energy at the start [J].
FASTEST, SPEED, WRONG, LARGEST, CHANGED, LOST = range(6)
TRIAL_COLUMNS = 6
# Halvings of a step that is searched for contacts.
LEVELS = 8
# Places in Contacts.search: the longest part of a step known to agree with the modes, and the
# shortest that does not [s]; nodes on the stack; cuts on suspicion, and for the sake of the last
# digits; row of the contact that a step of one size has passed; share and level of each node.
LOW, HIGH, TOP, SUSPECTED, REFINED, PASSED, SHARES = range(7)
NODE_LEVELS = SHARES + LEVELS + 3
SEARCH_LENGTH = NODE_LEVELS + LEVELS + 3
# Columns of SceneCode.present: the number of the piece of a course that it holds, NaN where none
# is known; when the present period and, in it, the piece began [s]; its coefficients c0 to c5, a,
# w and p, of an expression its value and its derivatives. Of a curve: ``engine/curve.hpp``.
NUMBER, PERIOD_START, PIECE_START, COEFFICIENTS = range(4)
VALUE_COLUMNS = 13
# Last column of EffectTable.values where a law is LOADED: time constant of the reaction [s].
LOAD_TIME = 11
# First column of EffectTable.output: stored energy [J]. The others are the law's readings.
STORED = 0
OUTPUT_COLUMNS = 5

# Columns of CutCoordinates.index: whether it slides; whether it is one in the plane; the rows of
# bodies A and B; where among the effects' states its angle is followed, less than zero where it is
# not: in space, angles are found within a turn; its row of ``Model.cut``; whether it has a rate
# alone, whose integral is followed in the place of a coordinate; whether of the force in its joint
# the part across the axis is what friction feels.
SLIDES, IN_PLANE, ROW_A, ROW_B, FOLLOWED, CUT, RATE_ONLY, ACROSS = range(8)
CUT_INDEX_COLUMNS = 8
# Columns of CutCoordinates.values, in the frames of the rows: the cut point in A and in B; the
# axis in B; a direction of A across it, and where that is in B at zero; what follows this in the
# sense of the turn; coordinates per metre of a slide; the angle at zero, in the plane.
POINT_A, POINT_B, AXIS, SIDE_A, SIDE_B, ACROSS_B, SCALE, ZERO = 0, 3, 6, 9, 12, 15, 18, 19
CUT_VALUE_COLUMNS = 20
# Index and values where nothing acts in cut joints.
NO_CUTS = np.zeros((0, CUT_INDEX_COLUMNS), dtype=np.int64), np.zeros((0, CUT_VALUE_COLUMNS))

# What a state of an effect is: a state of its own, energy dissipated, or work done on the
# mechanism from outside (both integrated with the rest).
OWN, DISSIPATED, WORK = range(3)


class State(NamedTuple):
    """One state that an effect adds to the state vector."""

    role: int  # ``OWN``, ``DISSIPATED`` or ``WORK``
    scale: float = 1.0  # Size to which error control relates its tolerance
    initial: float = 0.0  # Value at the start


class ForceElement(NamedTuple):
    """One effect as a row of the table."""

    law: ForceLaw
    joints: Tuple[int, ...] = ()  # Their places in q, of cut joints behind those of the tree
    bodies: Tuple[int, ...] = ()  # Their rows
    values: Tuple[float, ...] = ()  # Parameters, in the order the law reads them
    states: Tuple[State, ...] = ()  # In the order the law reads and writes them
    # Entries of numbers, such as pieces of a course or a curve, in the order the law reads them.
    data: Tuple[Tuple[float, ...], ...] = ()
    # Whether the law acts along the sum of its joints, whose arms are the first entry.
    summed: bool = False
    loaded: bool = False  # Whether the law wants the reaction in its joint
    gap: int = NO_GAP  # What opens and closes
    # Of a motion: its row of ``Model.cut``, multiplier, column of ``Model.cut_point``.
    equation: Tuple[int, ...] = ()

    @property
    def places(self):
        """Return what the row has in ``EffectTable.places``."""
        return (*self.joints, *self.bodies, *self.equation)

    @property
    def sticks(self):
        """Whether its force follows from accelerations: at rest, or that of inertia."""
        return self.law.role in (FRICTION, INERTIA)


class Sticking(NamedTuple):
    """Joints stuck under dry friction in the latest evaluation, their holding forces; inertia."""

    # Shape (nf + 1,): how many joints and tendons stick, and the rows of their effects; nf effects
    # may stick. Reflected inertia always does so: its force, too, follows from accelerations.
    rows: np.ndarray
    # Shape (ne,): friction that ``engine/dispatch.cpp`` gives to a joint that sticks [N m; N]:
    # zero but while responses are computed.
    hold: np.ndarray
    # Shape (nf + 1, nv + nk + nc): what the limit of each friction changes of accelerations, those
    # of cut joints behind, and multipliers; last, these without the friction of any joint at rest.
    response: np.ndarray
    matrix: np.ndarray  # Shape (nf, nf)
    # Shape (nf,)
    right: np.ndarray
    bound: np.ndarray
    move: np.ndarray
    factor: np.ndarray  # Shape (nf, nf)
    free: np.ndarray  # Shape (nf,): of the active set
    share: np.ndarray  # Shape (nf,): friction relative to its limit
    impulse: np.ndarray  # Shape (nf,)


class Contacts(NamedTuple):
    """Gaps of possible contacts, and their modes during a step."""

    rows: np.ndarray  # Shape (nk,): of the effects that are contacts
    mode: np.ndarray  # Shape (ne,): ``UNDECIDED``, ``FREE`` or ``TOUCHING``
    # Shape (ne, NODE_COLUMNS): written by the law; the same at the start of a step.
    now: np.ndarray
    start: np.ndarray
    trial: np.ndarray  # Shape (ne, TRIAL_COLUMNS): written by the law
    # Shape (LEVELS + 3, ne, NODE_COLUMNS): where a step is looked into. The first is the left end
    # of the interval in question, the last on the stack its right end.
    nodes: np.ndarray
    search: np.ndarray  # Shape (SEARCH_LENGTH,)


class CutCoordinates(NamedTuple):
    """Degrees of freedom of cut joints, nk of them, and the joint values that laws read."""

    index: np.ndarray  # Shape (nk, CUT_INDEX_COLUMNS)
    values: np.ndarray  # Shape (nk, CUT_VALUE_COLUMNS)
    # Shape (nv + nk,): coordinates and rates of the tree, then of these joints, in the latest
    # evaluation; rates before a step; accelerations.
    q: np.ndarray
    qd: np.ndarray
    before: np.ndarray
    qdd: np.ndarray
    scratch: np.ndarray  # Shape (nb + 1, 6 or 12): of ``accelerations``


class SceneCode(NamedTuple):
    """Inputs of a scene's code beside the table."""

    # Shape (1,): whether the evaluation that was generated has the laws of all effects, as they
    # are but for numbers that it reads.
    fits: np.ndarray
    present: np.ndarray  # Shape (ne, PRESENT_COLUMNS): pieces of courses that are in force
    sides: np.ndarray  # Shape (ne,): modes of contacts


class EffectTable(NamedTuple):
    """The listed effects, as the kernels read them."""

    laws: list  # Of ForceLaw, of the rows
    # Shape (ne,)
    role: np.ndarray
    routine: np.ndarray  # Addresses of the laws' routines; 0: the engine has the law
    enabled: np.ndarray
    index: np.ndarray  # Shape (ne, INDEX_COLUMNS)
    places: np.ndarray  # Shape (np,): places of all elements
    calls: np.ndarray  # Shape (LAW_COLUMNS + nb,): of a routine; nb bodies at most for one law
    values: np.ndarray  # Shape (ne, VALUE_COLUMNS)
    output: np.ndarray  # Shape (ne, OUTPUT_COLUMNS): written by the laws
    # Shape (nz,): the effects' states and their derivatives, of the latest evaluation.
    states: np.ndarray
    rates: np.ndarray
    scale: np.ndarray  # Shape (nz,): sizes for error control
    loaded: np.ndarray  # Shape (1,): how many effects want the reaction in their joint
    # Shape (nv + nk,): joint torques, of cut joints behind: commands and effects. The commands'
    # own array where no effect is listed.
    applied: np.ndarray
    # Shape (nb + 1, 6 or 12): wrenches in the joints, then scratch; of no length where no effect
    # is listed.
    reaction: np.ndarray
    sticking: Sticking
    data: np.ndarray  # Shape (nd,): entries of all elements
    contacts: Contacts
    # ``Model.cut_point``, whose rows the prescribed motions are set in; of no length where there
    # are none.
    motions: np.ndarray
    cuts: CutCoordinates  # Freedoms of cut joints that anything acts in, nk of them
    code: SceneCode


def _allocate_cuts(index, values, nv, bodies):
    """
    Allocate the joint values that laws read.

    ``index``, ``values`` as ``CutCoordinates`` has them; ``nv`` rates of the tree, ``bodies``
    rows.
    """
    total, planar = nv + len(index), bool(index[:, IN_PLANE].all())
    return CutCoordinates(index, values, *(np.zeros(total) for _ in range(4)),
                          np.zeros((bodies + 1, 6 if planar else 12)))


def build_table(elements, tau, bodies, equations, spatial=False, cut_point=None, cuts=None):
    """
    Allocate the table of the listed effects.

    Parameters
    ----------
    elements : sequence of ForceElement
        In the order of the scene.
    tau : ndarray, shape (nv + nk,)
        The commanded joint torques, those of cut joints behind.
    bodies : int
        Number of bodies.
    equations : int
        Number of closure equations.
    spatial : bool
        Whether the mechanism is one in space.
    cut_point : ndarray, optional
        Of the ``Model``.
    cuts : tuple of 2 ndarrays, optional
        Index and values of ``CutCoordinates``: of the freedoms that anything acts in.

    """
    count, most = len(elements), sum(element.sticks for element in elements)
    states = states_of(elements, cuts)
    cut_count = 0 if cuts is None else len(cuts[0])
    acts = count > 0 or cut_count > 0
    table = EffectTable(
        laws=[element.law for element in elements],
        role=np.array([element.law.role for element in elements], dtype=np.int64),
        routine=np.zeros(count, dtype=np.int64), enabled=np.ones(count, dtype=np.int64),
        index=np.zeros((count, INDEX_COLUMNS), dtype=np.int64),
        places=np.zeros(sum(len(element.places) for element in elements), dtype=np.int64),
        calls=np.zeros(LAW_COLUMNS + max(
            (len(element.bodies) for element in elements), default=0), dtype=np.int64),
        values=np.zeros((count, VALUE_COLUMNS)),
        output=np.zeros((count, OUTPUT_COLUMNS)),
        states=np.array([state.initial for state in states], dtype=float),
        rates=np.zeros(len(states)),
        scale=np.array([state.scale for state in states], dtype=float),
        loaded=np.zeros(1, dtype=np.int64),
        applied=tau.copy() if acts else tau,
        reaction=np.zeros((bodies + 1 if acts else 0, 12 if spatial else 6)),
        sticking=Sticking(
            rows=np.zeros(most + 1, dtype=np.int64), hold=np.zeros(count),
            response=np.zeros((most + 1, len(tau) + equations)), matrix=np.zeros((most, most)),
            right=np.zeros(most), bound=np.zeros(most), move=np.zeros(most),
            factor=np.zeros((most, most)), free=np.zeros(most, dtype=np.int64),
            share=np.zeros(most), impulse=np.zeros(most)),
        data=np.zeros(sum(map(size_of_data, elements))),
        contacts=Contacts(
            rows=np.array([row for row, element in enumerate(elements) if element.gap],
                          dtype=np.int64),
            mode=np.zeros(count, dtype=np.int64), now=np.zeros((count, NODE_COLUMNS)),
            start=np.zeros((count, NODE_COLUMNS)), trial=np.zeros((count, TRIAL_COLUMNS)),
            nodes=np.zeros((LEVELS + 3, count, NODE_COLUMNS)), search=np.zeros(SEARCH_LENGTH)),
        motions=cut_point if any(
            element.law.role == MOTION for element in elements) else np.zeros((0, 0)),
        cuts=_allocate_cuts(*cuts or NO_CUTS, len(tau) - cut_count, bodies),
        code=SceneCode(fits=np.zeros(1, dtype=np.int64),
                       present=np.full((count, PRESENT_COLUMNS), np.nan), sides=np.zeros(count)))
    begun = np.zeros(3, dtype=np.int64)
    for row, element in enumerate(elements):
        table.index[row, [STATE, PLACES, DATA]] = begun
        fill_row(table, row, element)
        begun += len(element.states), len(element.places), size_of_data(element)
    return table


def states_of(elements, cuts=None):
    """
    Return the states that effects add: their own, then angles of cut joints that are followed.

    ``cuts`` are as for ``build_table``; where the angles are followed is written.
    """
    states = [state for element in elements for state in element.states]
    for row in () if cuts is None else cuts[0]:
        if row[FOLLOWED] >= 0:
            row[FOLLOWED] = len(states)
            states.append(State(OWN))
    return states


def size_of_data(element):
    """Return how many numbers the entries of an element are."""
    return sum(map(len, element.data))


class Row:
    """
    A row of the table, as laws on symbols have it.

    Attributes
    ----------
    law : ForceLaw
    number : int
        Of the row.
    state, states : int
        Place of its first state, and how many they are.
    joints, bodies, equation : list of int
        As of ``ForceElement``.
    summed : int
        How many arms its numbers begin with: that of each joint; 0: none.
    data : ndarray
        The numbers behind these: a view.
    begin, count : int
        Where these begin among the numbers of all effects, and how many entries they are.
    values : ndarray
        Parameters: a view.

    """

    def __init__(self, table, number):
        index = table.index[number].tolist()
        begin, joints, bodies = (index[k] for k in (PLACES, JOINTS, BODIES))
        self.law, self.number, self.state = table.laws[number], number, index[STATE]
        followed = int((table.cuts.index[:, FOLLOWED] >= 0).sum())
        self.states = _behind(
            table, number, STATE, len(table.states) - followed) - self.state
        places = table.places[begin:_behind(table, number, PLACES, len(table.places))].tolist()
        self.joints, self.bodies = places[:joints], places[joints:joints + bodies]
        self.equation = places[joints + bodies:]
        self.summed = joints if index[SUMMED] else 0
        self.begin, self.count = index[DATA] + self.summed, index[ENTRIES] - index[SUMMED]
        self.arms = table.data[index[DATA]:self.begin]
        self.data = table.data[self.begin:_behind(table, number, DATA, len(table.data))]
        self.values = table.values[number]


def _behind(table, row, column, length):
    """Return where the part of an array ends that begins, by row, at the places in a column."""
    return int(table.index[row + 1, column]) if row + 1 < len(table.index) else length


def fill_row(table, row, element):
    """Write the parameters of one effect, at the start or while a simulation runs."""
    table.laws[row] = element.law
    begin, places = table.index[row, PLACES], element.places
    table.places[begin:begin + len(places)] = places
    table.index[row, [JOINTS, BODIES, SUMMED, LOADED, ENTRIES, GAP_OF]] = (
        len(element.joints), len(element.bodies), element.summed, element.loaded,
        len(element.data), element.gap)
    table.values[row] = 0.0
    table.values[row, :len(element.values)] = element.values
    begin = table.index[row, DATA]
    table.data[begin:begin + size_of_data(element)] = [
        number for entry in element.data for number in entry]
    table.code.present[row, NUMBER] = np.nan
    table.loaded[0] = table.index[:, LOADED].sum()
    first = table.index[row, STATE]
    table.scale[first:first + len(element.states)] = [state.scale for state in element.states]
