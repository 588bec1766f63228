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

"""One evaluation of a system: its accelerations, multipliers, and the rates of effects' states."""

from .motion import BY_LOOPS, CLOSE, FEEL_REACTIONS, HOLD, TELL_MOTIONS
from ..core.codegen import function_table as calls
from ..core.codegen.records import call_at
from ..core.compiled import compiled, inlined, merged
from ..core.manifold import fill_numbers, power_of_turns, rates_begin, rates_of_coordinates
from ..effects import dispatch

# Columns of System.settings: which formulation, Baumgarte's decay rate [1/s] (0: none), the
# closure error [m, rad] that projection leaves and the one at which it gives up.
FORMULATION, BAUMGARTE_GAIN, CLOSURE_TOLERANCE, CLOSURE_LIMIT, ASIDE = range(5)


# What a scene does not use is None in its system, or has no address. Numba drops the branches
# below for an argument that is None, so that it is not even compiled.

@inlined
def apply_effects(effects, manifold, work, q, qd, tau):
    """
    Apply the effects, where a scene lists any.

    Parameters
    ----------
    effects : EffectTable or None
        Of the system.
    manifold : Manifold or None
        Of the system; laws see the coordinate of each rate.
    work : Workspace
        After ``kinematics.outward``.
    q : ndarray, shape (nq,)
        Joint coordinates.
    qd : ndarray, shape (nv,)
        Their rates.
    tau : ndarray, shape (nv + nk,)
        Commanded joint torques; must be those of the system.

    """
    if effects is not None:
        apply_listed(manifold, effects, work, q, qd, tau)


@inlined
def apply_listed(manifold, effects, work, q, qd, tau):
    """Do as ``apply_effects`` does, where a scene lists any."""
    if manifold is None:
        dispatch.apply(effects, q, qd, tau)
    else:
        fill_numbers(manifold, q)
        dispatch.apply(effects, manifold.number, qd, tau)


@inlined
def take_states(effects, state, first):
    """
    Hand the effects' own states over to them, where a scene lists any.

    Parameters
    ----------
    effects : EffectTable or None
        Of the system.
    state : ndarray, shape (ns,)
        Coordinates, rates, and what effects add.
    first : int
        Place of the first of them: nq + nv.

    """
    if effects is not None:
        for k in range(effects.states.shape[0]):
            effects.states[k] = state[first + k]


@inlined
def _give_rates(effects, first, out):
    """Copy the rates of the effects' own states into a derivative."""
    if effects is not None:
        for k in range(effects.rates.shape[0]):
            out[first + k] = effects.rates[k]


@inlined
def _accelerate_anew(table, q, qd):
    """Compute accelerations and multipliers where the elimination alone will not do."""
    if calls.call(table, calls.REFINED_ACCELERATION, q, qd) == 0:
        calls.call(table, calls.RANK_REVEALING_ACCELERATION, q, qd)


@merged
def evaluate_in_parts(system, q, qd):
    """
    Do as ``evaluate`` does, but for what depends on the accelerations.

    Parameters
    ----------
    system, q, qd
        As for ``evaluate``.

    """
    if system.moving.addresses[BY_LOOPS] != 0:
        call_at(system.moving.addresses, BY_LOOPS, 0, q, qd)
    else:
        table = system.table
        calls.call(table, calls.OUTWARD, q, qd)
        apply_effects(system.effects, system.manifold, system.work, q, qd, system.tau)
        if calls.call(table, calls.ACCELERATION, q, qd) == 0:
            _accelerate_anew(table, q, qd)


@inlined
def _evaluate_at_once(effects, addresses, table, q, qd):
    """Evaluate a state where no effect is listed; return whether that is so."""
    if effects is None:
        if addresses[BY_LOOPS] != 0:
            call_at(addresses, BY_LOOPS, 0, q, qd)
        elif calls.call(table, calls.EVALUATION, q, qd) == 0:
            calls.call(table, calls.OUTWARD, q, qd)
            _accelerate_anew(table, q, qd)
        return True
    return False


@inlined
def _complete(effects, addresses, q, qd):
    """Add what depends on the accelerations: friction at rest, forces, reactions in joints."""
    if effects is not None:
        if effects.sticking.rows[0] > 0:
            call_at(addresses, HOLD, 0, q, qd)
        if addresses[TELL_MOTIONS] != 0:
            call_at(addresses, TELL_MOTIONS, 0, q, qd)
        if effects.loaded[0] > 0:
            call_at(addresses, FEEL_REACTIONS, 0, q, qd)


@compiled
def evaluate(system, q, qd):
    """
    Compute the accelerations and multipliers of a state into ``system.qdd`` and ``system.lam``.

    Poses, velocities and closure errors are left in ``system.work``, too.

    Parameters
    ----------
    system : System
        ``effects.states`` must be those of the state.
    q : ndarray, shape (nq,)
        Joint coordinates.
    qd : ndarray, shape (nv,)
        Their rates.

    """
    evaluate_in_parts(system, q, qd)
    _complete(system.effects, system.moving.addresses, q, qd)


@merged
def evaluate_only(system, q, qd):
    """
    Do as ``evaluate`` does, but leave nothing else behind: what integrators need.

    Parameters
    ----------
    system, q, qd
        As for ``evaluate``.

    """
    if not _evaluate_at_once(
            system.effects, system.moving.addresses, system.table, q, qd):
        evaluate_in_parts(system, q, qd)
    _complete(system.effects, system.moving.addresses, q, qd)


@merged
def evaluate_state(system, state):
    """
    Evaluate a state vector, shape (ns,), as ``evaluate_only`` does; its effects' states, too.

    Parameters
    ----------
    system : System
        What moves.
    state : ndarray, shape (ns,)
        As ``System`` tells.

    """
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    take_states(system.effects, state, nq + nv)
    evaluate_only(system, state[:nq], state[nq:nq + nv])


@merged
def derivative(system, state, out):
    """
    Compute the time derivative of a state.

    Parameters
    ----------
    system : System
        What moves.
    state : ndarray, shape (ns,)
        As ``System`` tells.
    out : ndarray, shape (ns,)
        Written in place.

    """
    # Of independent coordinates the others are first guesses only.
    if system.moving.addresses[CLOSE] != 0:
        call_at(system.moving.addresses, CLOSE, 0, state, state)
    evaluate_state(system, state)
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    rates_of_coordinates(system.manifold, state, nv, out, 1)
    for i in range(nv):
        out[nq + i] = system.qdd[i]
    _give_rates(system.effects, nq + nv, out)
    power_of_turns(system.manifold, system.tau, state, nv, out, 1)
