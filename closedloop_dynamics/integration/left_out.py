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
Whether the closure equations that are kept stand for all, where some that repeat others are not.

Which equations repeat others changes with the position: those that are kept may come to depend on
one another, and part from those that are left out. Looked at after every step that is accepted,
so that a step at which they do not serve can be repeated with others.

"""

from typing import NamedTuple

import numpy as np

from .evaluation import CLOSURE_LIMIT, CLOSURE_TOLERANCE
from .registry import PROJECTION
from ..core import energy, kinematics, loop_closure
from ..core.codegen import pieces
from ..core.compiled import compiled
from ..core.equations import with_all_equations
from ..core.types import Model, NO_RESPONSES, SMALLEST_PIVOT, Workspace
from ..core.workspace import unconnected

# Columns of ``LeftOut.numbers``: the pivot below which other equations are looked for; the most
# kinetic energy so far [J]; whether there are none better, so that all but open loops is accepted;
# whether those left out have opened at the latest step that was refused.
PIVOT, KINETIC, LENIENT, OPENED = range(4)
# Closure errors of equations that follow from others, of the closure tolerance.
IMPLIED = 1e3
# Kinetic energy that the projection may discard after a step, of the most that there was: more is
# no error of the step, but equations that hinder the motion.
DISCARDED = 1e-6
# Pivots that are good enough; how much smaller one must have become; and how fast, from step to
# step, the pivot that this is measured by may grow.
GOOD_PIVOT, SMALLER, GROWTH = 0.02, 0.25, 1.1


class LeftOut(NamedTuple):
    """All equations of a system that works on some; its own arrays where it works on all."""

    model: Model
    work: Workspace
    numbers: np.ndarray  # Shape (4,); of no length where no equations are left out
    energy: np.ndarray  # Shape (2,): scratch


def allocate_left_out(model, work, before=None):
    """
    Allocate what a system needs to look at the equations that it leaves out.

    Parameters
    ----------
    model, work : Model, Workspace
        Of the system.
    before : LeftOut, optional
        Whose numbers are taken over.

    Returns
    -------
    LeftOut

    """
    whole = with_all_equations(model)
    if whole is model:
        return LeftOut(model, work, np.zeros(0), np.zeros(2))
    # The bodies' own code may be exchanged when effects change their inertia.
    own = unconnected(whole)._replace(piece=work.piece)
    pieces.connect(whole, own.piece, own.cut_piece)
    return LeftOut(whole, own, np.zeros(4) if before is None else before.numbers, np.zeros(2))


def forget(left_out):
    """
    Forget the motion so far.

    Parameters
    ----------
    left_out : LeftOut
        Changed in place.

    """
    left_out.numbers[:] = 0.0


@compiled
def _kinetic(left_out, q, qd):
    """Return the kinetic energy of a state [J]."""
    model, work = left_out.model, left_out.work
    kinematics.outward(model, q, qd, work)
    energy.energies(model.tree, model.body, model.gravity, work.piece, work.body, work.equation,
                    qd, left_out.energy)
    return left_out.energy[0]


@compiled
def serve(system, stabilisation, q, qd):
    """
    Return 1 where the equations that are kept serve, after a step that was stabilised.

    They do not where those that are left out have opened, where they have come closer to depending
    on one another, or where the projection has discarded energy.

    Parameters
    ----------
    system : System
        Of which ``qdd`` is what the projection has just changed the rates by.
    stabilisation : int
        One of ``projection``.
    q, qd : ndarray, shape (nq,), (nv,)
        The state.

    Returns
    -------
    int

    """
    left_out, settings = system.left_out, system.settings
    numbers, work = left_out.numbers, left_out.work
    discarded = 0.0
    if stabilisation == PROJECTION:
        discarded = _kinetic(left_out, q, system.qdd)
    numbers[KINETIC] = max(numbers[KINETIC], _kinetic(left_out, q, qd))
    loop_closure.update(left_out.model, work, NO_RESPONSES)
    fastest = 1.0
    for i in range(qd.shape[0]):
        fastest = max(fastest, abs(qd[i]))
    implied, error = IMPLIED * settings[CLOSURE_TOLERANCE], loop_closure.largest(work.closure)
    hold = error <= implied and loop_closure.largest(work.closure_rate) <= implied * fastest
    strict = hold and discarded <= DISCARDED * numbers[KINETIC]
    pivot = system.work.health[SMALLEST_PIVOT]
    worn = pivot < numbers[PIVOT]
    if numbers[LENIENT] == 0.0 and (worn or not strict) or not error <= settings[CLOSURE_LIMIT]:
        numbers[OPENED] = 0.0 if hold else 1.0
        return 0
    if strict:
        numbers[LENIENT] = 0.0
    limit = min(GOOD_PIVOT, SMALLER * pivot)
    if worn or numbers[PIVOT] == 0.0:
        numbers[PIVOT] = limit
    else:
        numbers[PIVOT] = max(numbers[PIVOT], min(limit, GROWTH * numbers[PIVOT]))
    return 1
