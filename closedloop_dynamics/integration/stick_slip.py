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
The instants at which dry friction lets joints stick or slip.

Within a step every joint under dry friction slides in one direction, or is held
(``effects.sticking``), so that all methods keep their order. A step on which a sliding joint
would turn round is cut where it comes to rest; there it sticks, or sets out again.

"""

import math

from .motion import CUT_RATES
from ..core.codegen.records import call_at
from ..core.compiled import compiled, inlined, merged
from ..core.manifold import rates_begin
from ..effects import sticking
from ..effects.table import FIRST, JOINT_FRICTION, STATE

# A sliding joint has come to rest where its rate is less than this [rad/s; m/s].
ARRIVED = 1e-9
# A cut joint at rest has rates of rounding [rad/s; m/s].
ROUNDING = 1e-12
# Cuts of one step: beyond, it is taken as it is.
MOST_CUTS = 200
# The least part of a step that is made.
LEAST_PART = 1e-12


@compiled
def _first_rest(effects, grips, before, after, size, floor):
    """Return when the first joint comes to rest, by the secant; ``size`` where none does."""
    shortest = size
    for row in range(effects.kind.shape[0]):
        if effects.kind[row] == JOINT_FRICTION and effects.enabled[row] == 1:
            joint = effects.index[row, FIRST]
            grip = grips[effects.index[row, STATE]]
            start, end = max(0.0, grip * before[joint]), grip * after[joint]
            if end < -ARRIVED:
                shortest = min(shortest, size * start / (start - end))
    return shortest if shortest > floor else size


@inlined
def least(size, cuts):
    """Return the least part of a step worth trying after a number of cuts [s]."""
    return size * (LEAST_PART if cuts < MOST_CUTS else 1.0)


@merged
def part(effects, system, before, after, size, floor):
    """
    Return the part of a step on which no joint turns round.

    Parameters
    ----------
    effects : EffectTable
        Of the system.
    system : System
        Model and workspace of the mechanism.
    before, after : ndarray, shape (ns,)
        States before and after the step.
    size : float
        Of the step [s].
    floor : float
        Parts of no more than this are not worth a step [s].

    Returns
    -------
    float
        [s]; ``size`` where the step may be taken. A smaller one is an estimate, to be tried.

    """
    cuts, addresses = effects.cuts, system.moving.addresses
    nv, found = system.qdd.shape[0], size
    nq = rates_begin(system.manifold, nv)
    grips = before[nq + nv:]
    if addresses[CUT_RATES] == 0:
        found = _first_rest(
            effects, grips, before[nq:nq + nv], after[nq:nq + nv], size, floor)
    elif effects.sticking.response.shape[0] > 1:
        call_at(addresses, CUT_RATES, 0, before, cuts.before)
        call_at(addresses, CUT_RATES, 0, after, cuts.qd)
        found = _first_rest(effects, grips, cuts.before, cuts.qd, size, floor)
    return found


@compiled
def _stick(effects, rates, own):
    """Tell the effects which joints slide or rest; return whether one at rest still moves."""
    slow, first = False, rates.shape[0] - effects.cuts.index.shape[0]
    for row in range(effects.kind.shape[0]):
        if effects.kind[row] == JOINT_FRICTION and effects.enabled[row] == 1:
            joint, place = effects.index[row, FIRST], effects.index[row, STATE]
            rate = rates[joint]
            if abs(rate) > sticking.REST:
                own[place] = math.copysign(1.0, rate)
            elif rate * own[place] <= ARRIVED:
                own[place] = 0.0
                # What rate of a joint of the tree at rest is rounding: none.
                slow = slow or abs(rate) > (0.0 if joint < first else ROUNDING)
    return slow


@merged
def stick(effects, system, state):
    """
    Let joints stick that have come to rest, and slip that have broken away, after a step.

    Parameters
    ----------
    effects : EffectTable
        Of the system.
    system : System
        Model and workspace of the mechanism.
    state : ndarray, shape (ns,)
        Corrected in place.

    Returns
    -------
    bool
        Whether any that stick still move: the state is to be evaluated before ``stop``.

    """
    cuts, addresses, nv = effects.cuts, system.moving.addresses, system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    rates = state[nq:nq + nv]
    if addresses[CUT_RATES] != 0:
        call_at(addresses, CUT_RATES, 0, state, cuts.qd)
        rates = cuts.qd
    return _stick(effects, rates, state[nq + nv:])


@merged
def stop(effects, system, state):
    """Take what is left of their rates from joints that stick; all as for ``stick``."""
    cuts, nv = effects.cuts, system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    if cuts.index.shape[0] == 0:
        sticking.stop(effects, state[nq:nq + nv])
    else:
        sticking.stop(effects, cuts.qd)
        for i in range(nv):
            state[nq + i] = cuts.qd[i]
