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
What systems are asked for, each compiled for the systems that need it, and called by its address.

Every function has its system, a number, and two states, or coordinates and rates;
the latter seem to be as long as the former. What it is asked is told in ``motion``.

"""

import numpy as np

from . import (
    breaks, evaluation, impacts, left_out, motion, projection, semi_implicit_euler, stick_slip)
from .evaluation import (
    apply_effects, BAUMGARTE_GAIN, CLOSURE_TOLERANCE, evaluate_in_parts, FORMULATION)
from ..core import forward_dynamics, independent, kinematics, refinement
from ..core.codegen import function_table as calls
from ..core.codegen.records import addressed, call_at, link
from ..core.compiled import compiled, inlined
from ..core.formulations import accelerate_dense
from ..core.joint_wrenches import bias_forces
from ..core.manifold import normalise, rates_begin
from ..effects import cut_coordinates, joint_reaction, prescribed_motion, sticking
from ..effects.table import JOINT_FRICTION, PRESCRIBED_MOTION


def linked(system, by_euler=False):
    """
    Return a system with the addresses of all that can be asked of it.

    Parameters
    ----------
    system : System
        With all else.
    by_euler : bool
        Whether it is to make steps of semi-implicit Euler.

    Returns
    -------
    System
        With ``moving``.
    record : ndarray of int
        To be kept as long as the addresses.

    """
    needed = [None] * (motion.PLACES - 1)
    for place, function in _needed(system, by_euler):
        needed[place - 1] = function
    # Stages ask one another: their addresses are part of the system that is behind them.
    addresses = [0] * motion.PLACES
    if calls.available():
        addresses = np.array(addresses)
    system = system._replace(moving=motion.Moving(addresses, np.zeros(3)))
    addresses[:], record = link(system, needed)
    return system, record


def _needed(system, by_euler):
    """Yield places and functions of what a system needs."""
    yield from ((motion.DERIVATIVE, _derivative), (motion.STABILISE, _stabilise))
    if by_euler:
        yield motion.EULER, _euler
    if not system.is_bare:
        yield motion.EVALUATE, _evaluate
    if system.manifold is not None:
        yield motion.NORMALISE, _normalise
    if not system.is_unrolled:
        yield motion.BY_LOOPS, _by_dense_matrices if len(system.dense.gim) else _by_loops
        yield from ((motion.FACTOR, _factor), (motion.CORRECT, _correct))
    if system.is_independent:
        yield motion.CLOSE, _close
    if system.leaves_out:
        yield motion.EQUATIONS_SERVE, _equations_serve
    if system.effects is not None:
        yield from _needed_by_effects(system)


def _needed_by_effects(system):
    """Yield places and functions of what effects need."""
    effects = system.effects
    kinds = set(effects.kind.tolist())
    if kinds & set(breaks.OVER_TIME):
        yield from ((motion.UNTIL_CORNER, _until_corner), (motion.PASS_CORNERS, _pass_corners))
    if PRESCRIBED_MOTION in kinds:
        yield from ((motion.FOLLOW_MOTIONS, _follow_motions), (motion.TELL_MOTIONS, _tell_motions))
    if len(effects.contacts.rows):
        yield from ((motion.BEGIN_CONTACTS, _begin_contacts),
                    (motion.FORGET_CONTACTS, _forget_contacts),
                    (motion.END_CONTACTS, _end_contacts), (motion.UNTIL_CONTACT, _until_contact))
    if JOINT_FRICTION in kinds:
        yield from ((motion.UNTIL_REST, _until_rest), (
            motion.FEEL_REACTIONS, _feel_reactions if system.is_unrolled
            else _feel_reactions_by_loops))
    if len(effects.sticking.right):
        yield motion.HOLD, _hold
        yield from ((motion.STICK, _stick), (motion.STOP, _stop))
    if len(effects.cuts.index):
        yield from ((motion.CUT_RATES, _cut_rates),
                    (motion.CUT_ACCELERATIONS, _cut_accelerations))


@addressed
def _derivative(system, number, state, out):
    evaluation.derivative(system, state, out)
    return 1


@addressed
def _evaluate(system, number, state, same):
    evaluation.evaluate_state(system, state)
    return 1


@inlined
def _move(system, q, qd):
    """Find what accelerations follow from: an elimination uses it up."""
    kinematics.outward(system.model, q, qd, system.work)
    apply_effects(system.effects, system.manifold, system.work, q, qd, system.tau)
    _keep_forces(system.effects, system.work)


@inlined
def _keep_forces(effects, work):
    """Keep the forces that reactions are summed up from."""
    if effects is not None:
        if effects.loaded[0] > 0:
            bias_forces(work, effects.reaction)


@compiled
def _refine_by_loops(system, q, qd):
    """Compute accelerations and multipliers where a formulation alone will not do."""
    _move(system, q, qd)
    if not refinement.accelerate(
            system.model, system.work, system.applied, system.settings[BAUMGARTE_GAIN],
            system.qdd, system.lam):
        calls.call(system.table, calls.RANK_REVEALING_ACCELERATION, q, qd)


@addressed
def _by_loops(system, number, q, rates):
    qd = rates[:system.qdd.shape[0]]
    _move(system, q, qd)
    if not forward_dynamics.accelerate(
            system.model, system.work, system.applied, system.settings[BAUMGARTE_GAIN],
            system.qdd, system.lam):
        _refine_by_loops(system, q, qd)
    return 1


@addressed
def _by_dense_matrices(system, number, q, rates):
    settings = system.settings
    qd = rates[:system.qdd.shape[0]]
    _move(system, q, qd)
    if not accelerate_dense(
            system.model, system.work, system.dense, int(settings[FORMULATION]), system.applied,
            settings[BAUMGARTE_GAIN], system.qdd, system.lam):
        _refine_by_loops(system, q, qd)
    return 1


@addressed
def _hold(system, number, q, rates):
    """Find the friction that holds joints at rest, by the response to that of each."""
    effects, addresses = system.effects, system.moving.addresses
    qd, with_cuts = rates[:system.qdd.shape[0]], addresses[motion.CUT_ACCELERATIONS] != 0
    # Behind the joints of the tree are cut joints that anything acts in.
    qdd = effects.cuts.qdd if with_cuts else system.qdd
    stuck, hold = effects.sticking.rows, effects.sticking.hold
    count = stuck[0]
    if with_cuts:
        call_at(addresses, motion.CUT_ACCELERATIONS, 0, q, rates)
    sticking.keep(effects, qdd, system.lam)
    for place in range(count):
        row = stuck[place + 1]
        hold[row] = effects.output[row, 3]
        evaluate_in_parts(system, q, qd)
        if with_cuts:
            call_at(addresses, motion.CUT_ACCELERATIONS, 0, q, rates)
        sticking.respond(effects, place, qdd, system.lam)
    sticking.balance(effects, qdd, system.lam)
    if with_cuts:
        for i in range(qd.shape[0]):
            system.qdd[i] = qdd[i]
        if effects.loaded[0] > 0:
            # Friction at a cut joint acts on bodies: it is part of what the reactions balance.
            for place in range(count):
                hold[stuck[place + 1]] = effects.output[stuck[place + 1], 1]
            _move(system, q, qd)
            for place in range(count):
                hold[stuck[place + 1]] = 0.0
    return 1


@addressed
def _cut_accelerations(system, number, q, rates):
    """Put the accelerations of cut joints behind those of the tree."""
    cuts = system.effects.cuts
    qd = rates[:system.qdd.shape[0]]
    kinematics.outward(system.model, q, qd, system.work)
    for i in range(qd.shape[0]):
        cuts.qdd[i] = system.qdd[i]
    cut_coordinates.accelerations(
        cuts, system.model, system.work, system.qdd, True, cuts.qdd)
    return 1


@addressed
def _cut_rates(system, number, state, out):
    """Find the rates of all joints in a state, those of cut joints behind."""
    effects = system.effects
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    kinematics.outward(system.model, state[:nq], state[nq:nq + nv], system.work)
    for i in range(nv):
        out[i] = state[nq + i]
    cut_coordinates.measure(
        effects.cuts.index, effects.cuts.values, system.work.body, effects.states, nv,
        effects.cuts.q, out)
    return 1


@addressed
def _tell_motions(system, number, q, rates):
    prescribed_motion.tell(system.effects, system.lam)
    return 1


@addressed
def _follow_motions(system, number, state, same):
    effects, nv = system.effects, system.qdd.shape[0]
    evaluation.take_states(effects, state, rates_begin(system.manifold, nv) + nv)
    prescribed_motion.follow_all(effects)
    return 1


@addressed
def _feel_reactions(system, number, q, rates):
    qd = rates[:system.qdd.shape[0]]
    calls.call(system.table, calls.REACTIONS, q, qd)
    joint_reaction.feel(system.model, system.work, system.effects, qd, system.lam)
    return 1


@addressed
def _feel_reactions_by_loops(system, number, q, rates):
    joint_reaction.load(
        system.model, system.work, system.effects, q, rates[:system.qdd.shape[0]], system.qdd,
        system.lam)
    return 1


@addressed
def _stabilise(system, stabilisation, state, same):
    return projection.stabilise(system, stabilisation, state)


@addressed
def _factor(system, number, q, rates):
    return projection.factor_by_loops(system, q, rates[:system.qdd.shape[0]])


@addressed
def _correct(system, level, q, rates):
    projection.correct_by_loops(system, level)
    return 1


@addressed
def _close(system, after_step, state, same):
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    return independent.close_and_choose(
        system.model, system.work, system.partition, system.manifold, state[:nq],
        state[nq:nq + nv], system.settings[CLOSURE_TOLERANCE], after_step == 1)


@addressed
def _equations_serve(system, stabilisation, state, same):
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    return left_out.serve(system, stabilisation, state[:nq], state[nq:nq + nv])


@addressed
def _normalise(system, number, state, same):
    normalise(system.manifold, state, 1)
    return 1


@addressed
def _euler(system, number, state, out):
    semi_implicit_euler.step(system.manifold, state, system.qdd.shape[0],
                             system.moving.numbers[0], out, out, 1)
    return 1


@addressed
def _until_corner(system, number, state, same):
    system.moving.numbers[0] = breaks.until_next(system.effects, state[_own(system):])
    return 1


@addressed
def _pass_corners(system, number, state, same):
    breaks.pass_corners(system.effects, state[_own(system):])
    return 1


@inlined
def _own(system):
    """Return the place of the first of the effects' own states."""
    nv = system.qdd.shape[0]
    return rates_begin(system.manifold, nv) + nv


@addressed
def _begin_contacts(system, number, state, same):
    return impacts.begin(system.effects)


@addressed
def _forget_contacts(system, number, state, same):
    impacts.forget(system.effects.contacts)
    return 1


@addressed
def _end_contacts(system, number, state, same):
    impacts.end(system.effects.contacts)
    return 1


@addressed
def _until_contact(system, number, state, same):
    effects, numbers, own = system.effects, system.moving.numbers, _own(system)
    nv = system.qdd.shape[0]
    # Gaps want no accelerations.
    evaluation.take_states(effects, state, own)
    kinematics.outward(system.model, state[:own - nv], state[own - nv:own], system.work)
    apply_effects(effects, system.manifold, system.work, state[:own - nv], state[own - nv:own],
                  system.tau)
    numbers[0], numbers[1], numbers[2] = impacts.part(
        effects, numbers[0], int(numbers[1]), numbers[2])
    return 1


@addressed
def _until_rest(system, number, before, after):
    numbers = system.moving.numbers
    numbers[0] = stick_slip.part(system.effects, system, before, after, numbers[0], numbers[1])
    return 1


@addressed
def _stick(system, number, state, same):
    return stick_slip.stick(system.effects, system, state)


@addressed
def _stop(system, number, state, same):
    stick_slip.stop(system.effects, system, state)
    return 1
