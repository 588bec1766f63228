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
What is asked of a system: its derivative, its stabilisation, and where steps must end.

Integrators know a system by the addresses of what does these (``stages``): they are compiled once
for all systems, and what a scene does not need has no address.

"""

import math
from typing import NamedTuple

import numpy as np

from .registry import PROJECTION
from ..core.codegen.records import call_at
from ..core.compiled import inlined

# Places among Moving.addresses. What integrators ask for.
(DERIVATIVE, STABILISE, NORMALISE, EULER, UNTIL_CORNER, PASS_CORNERS, BEGIN_CONTACTS,
 FORGET_CONTACTS, END_CONTACTS, UNTIL_CONTACT, UNTIL_REST, STICK, STOP,
 # What these ask for: an evaluation, and in it what stands for generated routines, what depends on
 # accelerations, and what follows the time; the same of corrections; closed loops, with 1 after a
 # step; rates and accelerations of cut joints.
 EVALUATE, BY_LOOPS, HOLD, TELL_MOTIONS, FEEL_REACTIONS, FOLLOW_MOTIONS, FACTOR, CORRECT, CLOSE,
 CUT_RATES, CUT_ACCELERATIONS,
 # What steppers ask after a step, where equations that repeat others are left out.
 EQUATIONS_SERVE) = range(1, 26)
PLACES = 26


class Moving(NamedTuple):
    """What integrators see of a system; see ``core.codegen.records``."""

    addresses: np.ndarray  # Shape (PLACES,): that of the system, and of what is asked of it
    numbers: np.ndarray  # Shape (3,): what is handed over and returned


@inlined
def derivative(system, state, out):
    """
    Compute the time derivative of a state.

    Parameters
    ----------
    system : Moving
        Here and below.
    state : ndarray, shape (ns,)
        As ``System`` tells.
    out : ndarray, shape (ns,)
        Written in place.

    """
    call_at(system.addresses, DERIVATIVE, 0, state, out)


@inlined
def stabilise(system, stabilisation, state):
    """
    Correct the state after a step.

    Parameters
    ----------
    system : Moving
        What moves.
    stabilisation : int
        As for ``projection.stabilise``.
    state : ndarray, shape (ns,)
        Corrected in place.

    Returns
    -------
    bool
        Whether the loops are closed where positions were to be corrected.

    """
    return call_at(system.addresses, STABILISE, stabilisation, state, state) == 1


@inlined
def equations_serve(system, stabilisation, state):
    """
    Return whether the kept equations still stand for all, after a step that was stabilised.

    Parameters
    ----------
    system : Moving
        What moves.
    stabilisation : int
        As for ``projection.stabilise``; loops that it lets drift apart are not looked at.
    state : ndarray, shape (ns,)
        After the step.

    Returns
    -------
    bool
        As of ``left_out.serve``; yes where no equations are left out.

    """
    serves = True
    if stabilisation >= PROJECTION and system.addresses[EQUATIONS_SERVE] != 0:
        serves = call_at(
            system.addresses, EQUATIONS_SERVE, stabilisation, state, state) == 1
    return serves


@inlined
def normalise(system, state):
    """Let the quaternions of a state, shape (ns,), have norm 1."""
    _ask(system, NORMALISE, state)


@inlined
def _ask(system, what, state):
    """Ask what not all systems need; return whether the answer is yes."""
    yes = False
    if system.addresses[what] != 0:
        yes = call_at(system.addresses, what, 0, state, state) == 1
    return yes


@inlined
def semi_implicit_step(system, state, size, slope, out):
    """Advance a state by a step of semi-implicit Euler, of a size [s]; shapes (ns,)."""
    for i in range(state.shape[0]):
        out[i] = slope[i]
    system.numbers[0] = size
    call_at(system.addresses, EULER, 0, state, out)


@inlined
def until_corner(system, state):
    """
    Return how long it is until a force over time has a corner.

    Parameters
    ----------
    system : Moving
        What moves.
    state : ndarray, shape (ns,)
        Where a step begins.

    Returns
    -------
    float
        [s]; infinity where there is none.

    """
    return system.numbers[0] if _ask(system, UNTIL_CORNER, state) else math.inf


@inlined
def pass_corners(system, state):
    """Let what follows a corner begin, after a step that may have ended there; shape (ns,)."""
    _ask(system, PASS_CORNERS, state)


@inlined
def begin_contacts(system, state):
    """Decide which bodies touch during a step; return whether any begin or cease just here."""
    return _ask(system, BEGIN_CONTACTS, state)


@inlined
def forget_contacts(system, state):
    """Forget what a trial has shown that fails for other reasons than contacts; shape (ns,)."""
    _ask(system, FORGET_CONTACTS, state)


@inlined
def end_contacts(system, state):
    """Let gaps decide again which bodies touch, after a step; shape (ns,)."""
    _ask(system, END_CONTACTS, state)


@inlined
def until_contact(system, state, size, sought, share):
    """
    Return the part of a step on which no contact begins or ends.

    Parameters
    ----------
    system : Moving
        What moves.
    state : ndarray, shape (ns,)
        At a share of the step.
    size, sought, share
        As for ``impacts.part``.

    Returns
    -------
    part : float
        [s]
    sought : int
    share : float
        As of ``impacts.part``.

    """
    part, wanted = size, -1.0
    if system.addresses[UNTIL_CONTACT] != 0:
        numbers = system.numbers
        numbers[0], numbers[1], numbers[2] = size, sought, share
        call_at(system.addresses, UNTIL_CONTACT, 0, state, state)
        part, sought, wanted = numbers[0], int(numbers[1]), numbers[2]
    return part, sought, wanted


@inlined
def until_rest(system, before, after, size, floor):
    """
    Return the part of a step on which no joint under dry friction turns round.

    Parameters
    ----------
    system : Moving
        What moves.
    before, after, size, floor
        As for ``stick_slip.part``.

    Returns
    -------
    float
        [s]; as of ``stick_slip.part``.

    """
    part = size
    if system.addresses[UNTIL_REST] != 0:
        system.numbers[0], system.numbers[1] = size, floor
        call_at(system.addresses, UNTIL_REST, 0, before, after)
        part = system.numbers[0]
    return part


@inlined
def rest(system, state):
    """Let joints stick that have come to rest, and slip that have broken away; shape (ns,)."""
    if _ask(system, STICK, state):
        _ask(system, EVALUATE, state)
        _ask(system, STOP, state)
