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
What integrators ask of a system: its derivative, its stabilisation, and where steps must end.

A mechanism that is unrolled and has no effects is compiled into the integrators, for the last
nanosecond. Of all other systems they know an address only, behind which one function does what is
asked: it is compiled for each kind of system, the integrators once for all.

"""

import math
from typing import NamedTuple

import numpy as np

from . import breaks, impacts, projection, semi_implicit_euler, stick_slip, system as systems
from .system import Routine, System
from ..core import manifold
from ..core.codegen import function_table as calls
from ..core.codegen.records import (
    addresses_of, array_at, call_with_record, from_python, record_at)
from ..core.compiled import addressed, compiled, inlined, merged
from ..core.types import Workspace

# What can be asked of a routine.
(EVALUATE, DERIVATIVE, STABILISE, NORMALISE, EULER, UNTIL_CORNER, PASS_CORNERS, BEGIN_CONTACTS,
 END_CONTACTS, MAY_TOUCH, UNTIL_CONTACT, UNTIL_REST, STICK, STOP) = range(14)


class Served(NamedTuple):
    """The record of a routine."""

    system: System
    numbers: np.ndarray  # Those of ``Routine``


@addressed
def _serve(address, what, count, first, second):
    """
    Do what is asked of a system.

    Parameters
    ----------
    address : pointer to Served
        Of the system.
    what : int
        One of the above.
    count : int
        Length of a state.
    first, second : pointers to float
        Two states.

    Returns
    -------
    int
        Where it is a question with two answers 1 for yes.

    """
    served = record_at(address)
    system, numbers = served.system, served.numbers
    state, other = array_at(first, count), array_at(second, count)
    answer = True
    if what <= DERIVATIVE:
        # Evaluated in one place only, as that is most of what is compiled.
        if what == DERIVATIVE:
            systems.close_stage(system, state)
        systems.evaluate_state(system, state)
        if what == DERIVATIVE:
            systems.take_derivative(system, state, other)
    elif what == STABILISE:
        answer = projection.stabilise(system, int(numbers[0]), state)
    elif what == NORMALISE:
        manifold.normalise(system.manifold, state, 1)
    elif what == EULER:
        semi_implicit_euler.step(
            system.manifold, state, system.qdd.shape[0], numbers[0], other, other, 1)
    elif what == UNTIL_CORNER:
        numbers[0] = breaks.until_next(system.effects, system, state)
    elif what == PASS_CORNERS:
        breaks.pass_corners(system.effects, system, state)
    elif what == BEGIN_CONTACTS:
        answer = impacts.begin(system.effects)
    elif what == END_CONTACTS:
        impacts.end(system.effects)
    elif what == MAY_TOUCH:
        answer = impacts.may_end_a_step(system.effects, int(numbers[0]))
    elif what == UNTIL_CONTACT:
        numbers[0], numbers[1] = impacts.part(system.effects, numbers[0], int(numbers[1]))
    elif what == UNTIL_REST:
        numbers[0] = stick_slip.part(
            system.effects, system, state, other, numbers[0], numbers[1])
    elif what == STICK:
        answer = stick_slip.stick(system.effects, system, state)
    elif what == STOP:
        stick_slip.stop(system.effects, system, state)
    return 1 if answer else 0


def narrowed(system):
    """
    Return what the integrators see of a system.

    Returns
    -------
    System
        With the same arrays, but only those that steps touch: handed all of them, kernels take
        more than twice as long to compile. It holds addresses: the system itself must be kept.

    """
    bare = system._replace(
        model=None, work=Workspace(*(None for _ in Workspace._fields))._replace(
            closure=system.work.closure, health=system.work.health), lam=None)
    if _is_plain(system):
        return bare
    return System(*(None for _ in System._fields))._replace(
        qdd=system.qdd, routine=_routine_of(system))


def _is_plain(system):
    """Tell whether integrators are compiled for a system's own kind."""
    return system.unrolled is not None and system.partition is None and system.effects is None


def _routine_of(system):
    """Return what does all that can be asked of a system."""
    numbers = np.zeros(3)
    addresses, record = addresses_of(_serve, Served(system, numbers))
    return Routine(addresses, numbers, record)


class Probe:
    """
    Evaluations asked for from Python, one at a time.

    A compiled kernel called from Python spends several times its own time on unpacking the
    system; routines are handed addresses.

    Attributes
    ----------
    q, qd, own : ndarray, shape (nq,), (nv,), (nz,)
        Coordinates, rates and effects' states that are evaluated: views of a state vector.

    """

    def __init__(self, system, state=None):
        """Evaluate a state vector, shape (ns,), wherever it moves, or one of its own."""
        self._system, self._routines = system, {}
        *parts, count = systems.parts_of_state(system)
        self._state = np.zeros(count) if state is None else state
        self.q, self.qd, self.own = (self._state[part] for part in parts)
        self._table = tuple(
            array.ctypes.data for array in (system.table, self.q, self.qd))
        self._bare = system.unrolled is not None and system.effects is None
        if not self._bare:
            self._routine = _routine_of(system)
            self._ask = from_python(self._routine.addresses, EVALUATE, self._state)

    def evaluate(self):
        """Do as ``system.evaluate`` does."""
        if not self._bare:
            self._ask()
            return
        self._call(calls.OUTWARD)
        if not self._call(calls.ACCELERATION):
            self._accelerate_anew()

    def evaluate_only(self):
        """Do the same, but leave nothing else behind where that is quicker."""
        if not self._bare:
            self.evaluate()
        elif not self._call(calls.EVALUATION):
            self._call(calls.OUTWARD)
            self._accelerate_anew()

    def _accelerate_anew(self):
        if not self._call(calls.REFINED_ACCELERATION):
            calls.run(self._system.table, calls.RANK_REVEALING_ACCELERATION, self.q, self.qd)

    def _call(self, which):
        """Call a routine of the table, whose address may have changed since."""
        address = int(self._system.table[which])
        if address not in self._routines:
            self._routines[address] = calls.function(self._system.table, which)
        return self._routines[address](*self._table)


# As in ``system``: numba drops the branches below for what is None.

@merged
def derivative(system, state, out):
    """
    Compute the time derivative of a state.

    Parameters
    ----------
    system : System
        As ``narrowed`` returns it, here and below.
    state : ndarray, shape (ns,)
        As ``System`` tells.
    out : ndarray, shape (ns,)
        Written in place.

    """
    _derive(system.direct, system.routine, system, state, out)


@inlined
def _derive(direct, routine, system, state, out):
    if direct is not None:
        systems.derivative(system, state, out)
    if routine is not None:
        call_with_record(routine.addresses, DERIVATIVE, state, out)


@compiled
def rate_of_change(system, state, out):
    """Do as ``derivative`` does, compiled once: for kernels where it is not most of the work."""
    derivative(system, state, out)


@merged
def stabilise(system, stabilisation, state):
    """
    Correct the state after a step.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    stabilisation : int
        As for ``projection.stabilise``.
    state : ndarray, shape (ns,)
        Corrected in place.

    Returns
    -------
    bool
        Whether the loops are closed where positions were to be corrected.

    """
    return _stabilise(system.direct, system.routine, system, stabilisation, state)


@inlined
def _stabilise(direct, routine, system, stabilisation, state):
    closed = True
    if direct is not None:
        closed = projection.stabilise(system, stabilisation, state)
    if routine is not None:
        routine.numbers[0] = stabilisation
        closed = call_with_record(routine.addresses, STABILISE, state, state) == 1
    return closed


@compiled
def stabilised(system, stabilisation, state):
    """Do as ``stabilise`` does, compiled once: for kernels where it is not most of the work."""
    return stabilise(system, stabilisation, state)


@inlined
def normalise(system, state):
    """Let the quaternions of a state, shape (ns,), have norm 1."""
    _normalise(system.direct, system.routine, system, state)


@inlined
def _normalise(direct, routine, system, state):
    if direct is not None:
        manifold.normalise(system.manifold, state, 1)
    if routine is not None:
        call_with_record(routine.addresses, NORMALISE, state, state)


@inlined
def semi_implicit_step(system, state, size, slope, out):
    """Advance a state by a step of semi-implicit Euler, of a size [s]; shapes (ns,)."""
    _semi_implicit_step(system.direct, system.routine, system, state, size, slope, out)


@inlined
def _semi_implicit_step(direct, routine, system, state, size, slope, out):
    if direct is not None:
        semi_implicit_euler.step(
            system.manifold, state, system.qdd.shape[0], size, slope, out, 1)
    if routine is not None:
        for i in range(state.shape[0]):
            out[i] = slope[i]
        routine.numbers[0] = size
        call_with_record(routine.addresses, EULER, state, out)


@inlined
def until_corner(system, state):
    """
    Return how long it is until a force over time has a corner.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    state : ndarray, shape (ns,)
        Where a step begins.

    Returns
    -------
    float
        [s]; infinity where there is none.

    """
    return _until_corner(system.routine, state)


@inlined
def _until_corner(routine, state):
    wait = math.inf
    if routine is not None:
        call_with_record(routine.addresses, UNTIL_CORNER, state, state)
        wait = routine.numbers[0]
    return wait


@inlined
def pass_corners(system, state):
    """Let what follows a corner begin, after a step that may have ended there; shape (ns,)."""
    _ask(system.routine, PASS_CORNERS, state)


@inlined
def _ask(routine, what, state):
    """Ask what concerns systems with effects alone; return whether the answer is yes."""
    yes = False
    if routine is not None:
        yes = call_with_record(routine.addresses, what, state, state) == 1
    return yes


@inlined
def begin_contacts(system, state):
    """Decide which bodies touch during a step; return whether any begin or cease just here."""
    return _ask(system.routine, BEGIN_CONTACTS, state)


@inlined
def end_contacts(system, state):
    """Let gaps decide again which bodies touch, after a step; shape (ns,)."""
    _ask(system.routine, END_CONTACTS, state)


@inlined
def until_contact(system, out, scratch, size, sought, cuts):
    """
    Return the part of a step on which no contact begins or ends.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    out, scratch : ndarray, shape (ns,)
        State after the step; overwritten.
    size, sought
        As for ``impacts.part``.
    cuts : int
        How often the step has been cut.

    Returns
    -------
    part : float
        [s]
    sought : int
        As of ``impacts.part``.

    """
    found = size, sought
    if _may_touch(system.routine, out, cuts):
        rate_of_change(system, out, scratch)
        found = _until_contact(system.routine, out, size, sought)
    return found


@inlined
def _may_touch(routine, out, cuts):
    may = False
    if routine is not None:
        routine.numbers[0] = cuts
        may = call_with_record(routine.addresses, MAY_TOUCH, out, out) == 1
    return may


@inlined
def _until_contact(routine, out, size, sought):
    found = size, sought
    if routine is not None:
        numbers = routine.numbers
        numbers[0], numbers[1] = size, sought
        call_with_record(routine.addresses, UNTIL_CONTACT, out, out)
        found = numbers[0], int(numbers[1])
    return found


@inlined
def until_rest(system, before, after, size, floor):
    """
    Return the part of a step on which no joint under dry friction turns round.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    before, after, size, floor
        As for ``stick_slip.part``.

    Returns
    -------
    float
        [s]; as of ``stick_slip.part``.

    """
    return _until_rest(system.routine, before, after, size, floor)


@inlined
def _until_rest(routine, before, after, size, floor):
    part = size
    if routine is not None:
        routine.numbers[0], routine.numbers[1] = size, floor
        call_with_record(routine.addresses, UNTIL_REST, before, after)
        part = routine.numbers[0]
    return part


@inlined
def rest(system, state):
    """Let joints stick that have come to rest, and slip that have broken away; shape (ns,)."""
    if _ask(system.routine, STICK, state):
        _ask(system.routine, EVALUATE, state)
        _ask(system.routine, STOP, state)
