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

"""The system of equations that is integrated: a mechanism under joint torques."""

from contextlib import suppress
import time
from typing import NamedTuple, Optional
import warnings

import numpy as np

from ..core import codegen, forward_dynamics, kinematics, rank_revealing, refinement
from ..core.codegen import function_table as calls, pieces, space
from ..core.compiled import allocating, compiled, inlined, merged
from ..core.equations import Equations, with_all_equations
from ..core.formulations import accelerate_dense, allocate_dense, DenseWorkspace, SUBSYSTEM
from ..core.independent import allocate_partition, close, Partition
from ..core.joint_wrenches import bias_forces
from ..core.manifold import (
    fill_numbers, Manifold, manifold_of, power_of_turns, rates_begin, rates_of_coordinates)
from ..core.types import Model, number_of_coordinates, Workspace
from ..core.workspace import unconnected
from ..effects import (
    cut_coordinates, dispatch, joint_reaction, prescribed_motion, sticking)
from ..effects.table import build_table, EffectTable

# Columns of System.settings: which formulation, Baumgarte's decay rate [1/s] (0: none), the
# closure error [m, rad] that projection leaves and the one at which it gives up.
FORMULATION, BAUMGARTE_GAIN, CLOSURE_TOLERANCE, CLOSURE_LIMIT, ASIDE = range(5)

# Unrolled code grows with the mechanism: beyond this number of bodies it takes too long to
# compile and falls out of the fastest memory; in space, where the loops do more in vain, beyond
# this number of freedoms.
MOST_UNROLLED_BODIES, MOST_UNROLLED_FREEDOMS = 24, 40
# No evaluation takes so long, but compiling does [s].
LONG = 3.0


# What stands for yes where None stands for no.
_YES = np.zeros(0)


class Routine(NamedTuple):
    """What a system does, behind an address; see ``motion``."""

    addresses: np.ndarray  # Of code and record
    numbers: np.ndarray  # Shape (3,): what is handed over and returned
    record: np.ndarray  # What the second address is that of


class System(NamedTuple):
    """
    One mechanism with all that an evaluation of its motion reads and writes.

    Attributes
    ----------
    model : Model
    work : Workspace
    dense : DenseWorkspace or None
        Of the dense formulations.
    partition : Partition or None
        Of the independent coordinates.
    settings : ndarray, shape (5,)
    tau : ndarray, shape (nv + nk,)
        Commanded joint torques [N m] and forces [N], behind them those of the nk cut joints that
        anything acts in.
    qdd : ndarray, shape (nv,)
        Joint accelerations of the latest evaluation.
    lam : ndarray, shape (nc,)
        Its multipliers.
    applied : ndarray, shape (nv,)
        Joint torques of commands and effects; ``tau`` itself where no effect is listed.
    effects : EffectTable or None
        What acts on the mechanism beside the commanded torques.
    table : ndarray of int
        Of the routines that are called by their address: the rank-revealing path, and those
        unrolled for this mechanism.
    unrolled, by_loops : ndarray of no length, or None
        Which way evaluations go; the other one is None, as a branch is dropped only for that.
    corrections : ndarray, shape (2, nv)
        Of coordinates and rates, as unrolled routines leave them.
    manifold : Manifold or None
        Where quaternions are among the coordinates; None where there are none.
    direct : ndarray of no length, or None
        Whether integrators call the functions below; else they ask the routine.
    routine : Routine or None
        Of what integrators see of a system that they are not compiled for.

    Notes
    -----
    A state vector has the coordinates, shape (nq,), the rates, shape (nv,), the effects' own
    states, and, where there are quaternions, the work that torques did on their joints. nq is nv
    where there are none.

    """

    model: Model
    work: Workspace
    dense: Optional[DenseWorkspace]
    partition: Optional[Partition]
    settings: np.ndarray
    tau: np.ndarray
    qdd: np.ndarray
    lam: np.ndarray
    applied: np.ndarray
    effects: Optional[EffectTable]
    table: np.ndarray
    unrolled: Optional[np.ndarray]
    by_loops: Optional[np.ndarray]
    corrections: np.ndarray
    manifold: Optional[Manifold]
    direct: Optional[np.ndarray]
    routine: Optional[Routine]

    def __reduce__(self):
        """Copy and pickle without addresses, which hold for these very arrays."""
        return _relinked, tuple(self._replace(table=None))


def build_system(model, formulation=SUBSYSTEM, baumgarte=0.0, extent=1.0, independent=False,
                 elements=(), unrolled=None, cuts=None):
    """
    Allocate a system.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    formulation : int
        One of ``core.formulations``.
    baumgarte : float
        Decay rate of closure errors [1/s].
    extent : float
        Size of the mechanism [m], to which closure tolerances are relative.
    independent : bool
        Whether to integrate independent coordinates.
    elements : sequence of effects.table.ForceElement
        Of the effects that act.
    unrolled : bool, optional
        Whether to unroll the kernels for this mechanism; where not said, if there is a compiler,
        few bodies, and the subsystem-level formulation.
    cuts : tuple of 2 ndarrays, optional
        Of the cut joints that anything acts in, as for ``effects.table.build_table``.

    """
    nv, nc = len(model.tree) - 1, len(model.column) - 1
    if unrolled is None:
        unrolled = (codegen.available() and formulation == SUBSYSTEM
                    and nv <= (MOST_UNROLLED_FREEDOMS if space.is_spatial(model)
                               else MOST_UNROLLED_BODIES))
    # Closure errors of 1e-12 of the size are rounding; one of 1e-5 of it is an open loop.
    settings = np.array([
        formulation, baumgarte, 1e-12 * extent, 1e-5 * extent, rank_revealing.ASIDE])
    tau = np.zeros(nv + (0 if cuts is None else len(cuts[0])))
    # With room for those that are left out: they may be taken again.
    most = len(with_all_equations(model).column) - 1
    effects = None if len(elements) == 0 and cuts is None else build_table(
        elements, tau, nv, most, space.is_spatial(model), model.cut_point, cuts)
    system = System(
        model=model, work=unconnected(model),
        dense=None if formulation == SUBSYSTEM else allocate_dense(model, formulation),
        partition=allocate_partition(model) if independent else None,
        settings=settings, tau=tau, qdd=np.zeros(nv), lam=np.zeros(nc),
        applied=tau if effects is None else effects.applied[:nv], effects=effects, table=None,
        unrolled=_YES if unrolled else None, by_loops=None if unrolled else _YES,
        corrections=np.zeros((2, nv)), manifold=manifold_of(model), direct=_YES, routine=None)
    return _linked(system)


def _linked(system):
    """Return a system with the addresses of its own arrays and routines."""
    model, work = system.model, system.work
    pieces.connect(model, work.piece, work.cut_piece)
    table = calls.connect(
        {calls.BODY: model.body, calls.GRAVITY: model.gravity,
         calls.CUT_POINT: model.cut_point, calls.TAU: system.applied, calls.QDD: system.qdd,
         calls.BAUMGARTE: system.settings[BAUMGARTE_GAIN:],
         calls.LAM: system.lam, calls.HEALTH: work.health, calls.WORK_BODY: work.body,
         calls.CLOSURE: work.closure, calls.CLOSURE_RATE: work.closure_rate,
         calls.CORRECTIONS: system.corrections},
        number_of_coordinates(model), _rank_revealing_routines(system),
        lambda: codegen.later(model))
    if system.unrolled is not None:
        codegen.relink(model, table)
    return system._replace(table=table)


def _relinked(*fields):
    """Build a copied or unpickled system."""
    return _linked(System(*fields))


def _rank_revealing_routines(system):
    """Return the rank-revealing path as functions of q and qd, compiled when first called."""
    model, work, lam = with_all_equations(system.model), system.work, system.lam
    effects, settings, qdd, manifold = (
        system.effects, system.settings, system.qdd, system.manifold)
    tau, applied, kept = system.tau, system.applied, None
    if model is not system.model:
        work = unconnected(model)._replace(body=work.body, piece=work.piece, health=work.health)
        pieces.connect(model, work.piece, work.cut_piece)
        lam, kept = np.zeros(len(work.closure)), Equations(system.model)

    def leave_to_kept(q):
        system.lam[:] = kept.move(q).of_kept(lam)

    def acceleration(q, qd):
        _reveal_rank(qdd, rank_revealing_acceleration, model, work, effects, settings, tau,
                     applied, manifold, q, qd, qdd, lam)
        if kept is not None:
            _or_nan(system.lam, leave_to_kept, q)

    def position(q, qd):
        _reveal_rank(
            qdd, rank_revealing_correction, model, work, rank_revealing.POSITION, q, qd, qdd)

    def velocity(q, qd):
        _reveal_rank(
            qdd, rank_revealing_correction, model, work, rank_revealing.VELOCITY, q, qd, qdd)

    return {calls.RANK_REVEALING_ACCELERATION: acceleration,
            calls.RANK_REVEALING_POSITION: position,
            calls.RANK_REVEALING_VELOCITY: velocity}


def _reveal_rank(out, kernel, *arguments):
    """Call a kernel of the rank-revealing path, and say so if it had to be compiled."""
    begin = time.perf_counter()
    _or_nan(out, kernel, *arguments)
    elapsed = time.perf_counter() - begin
    if elapsed > LONG:
        warnings.warn(
            'A singular configuration, or loops that repeat one another: what deals with them '
            f'had to be compiled first, which took {elapsed:.0f} s. It is kept on disk; the next '
            'time there is no delay.', RuntimeWarning, stacklevel=2)


def _or_nan(out, kernel, *arguments):
    """Call what fills an array; where it fails there are NaN, which the integrators tell."""
    out[:] = np.nan
    # No decomposition is found of numbers that are not finite, or nearly so.
    with suppress(ValueError, np.linalg.LinAlgError):
        kernel(*arguments)


def parts_of_state(system):
    """
    Return where the parts of a state vector are.

    Parameters
    ----------
    system : System
        Of a mechanism.

    Returns
    -------
    q, qd, own : slice
        Coordinates, rates, the effects' own states.
    ns : int
        Length of the state vector.

    """
    nv = len(system.qdd)
    nq = nv if system.manifold is None else nv + len(system.manifold.balls)
    end = nq + nv + (0 if system.effects is None else len(system.effects.states))
    return (slice(nq), slice(nq, nq + nv), slice(nq + nv, end),
            end if system.manifold is None else end + 1)


def with_equations(system, model):
    """
    Return a system that works on other closure equations.

    Parameters
    ----------
    system : System
        As it was; its state, torques and effects are shared.
    model : Model
        Of the same mechanism with other equations kept; it shares all other arrays.

    Returns
    -------
    System

    """
    work = unconnected(model)
    work.health[:] = system.work.health
    return _linked(system._replace(
        model=model, work=work, lam=np.zeros(len(work.closure)),
        dense=None if system.dense is None else allocate_dense(
            model, int(system.settings[FORMULATION])),
        partition=None if system.partition is None else allocate_partition(model)))


def number_of_states(system):
    """Return ns: the length of the state vector."""
    return parts_of_state(system)[-1]


# What a scene does not use is None in its system. Numba drops the branches below for an argument
# that is None, so that it is not even compiled.

@compiled
def _accelerate_dense(dense, model, work, formulation, tau, baumgarte, qdd, lam):
    """Compute accelerations and multipliers by a dense formulation, where there is one."""
    if dense is not None:
        return accelerate_dense(model, work, dense, formulation, tau, baumgarte, qdd, lam)
    return True


@compiled
def _close(partition, model, work, manifold, q, qd, tolerance):
    """Close the loops by the dependent coordinates, where a scene has such."""
    if partition is not None:
        close(model, work, partition, manifold, q, qd, tolerance)


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
    qd, tau : ndarray, shape (nv,)
        Rates, and commanded torques.

    """
    if effects is not None:
        if manifold is None:
            dispatch.apply(work.body, effects, q, qd, tau)
        else:
            fill_numbers(manifold, q)
            dispatch.apply(work.body, effects, manifold.number, qd, tau)
        if effects.loaded[0] > 0:
            bias_forces(work, effects.reaction)


@inlined
def _feel_reactions(effects, system, q, qd):
    """Tell effects the reactions in their joints, where they ask for them."""
    if effects is not None:
        if effects.loaded[0] > 0:
            joint_reaction.load(
                system.model, system.work, effects, q, qd, system.qdd, system.lam)


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


@allocating
def rank_revealing_acceleration(
        model, work, effects, settings, tau, applied, manifold, q, qd, qdd, lam):
    """
    Compute accelerations and multipliers by the rank-revealing path.

    Parameters
    ----------
    model, work, effects, settings, tau, applied, manifold, qdd, lam
        As a ``System`` has them, with all equations.
    q : ndarray, shape (nq,)
        Joint coordinates.
    qd : ndarray, shape (nv,)
        Their rates.

    """
    kinematics.outward(model, q, qd, work)
    apply_effects(effects, manifold, work, q, qd, tau)
    rank_revealing.accelerate(
        model, work, applied, settings[BAUMGARTE_GAIN], settings[ASIDE], manifold, q, qd, qdd,
        lam)


@allocating
def rank_revealing_correction(model, work, level, q, qd, out):
    """
    Compute the least correction of positions or rates by the rank-revealing path.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        Scratch of the evaluation.
    level : int
        ``rank_revealing.POSITION`` or ``VELOCITY``.
    q : ndarray, shape (nq,)
        Joint coordinates.
    qd : ndarray, shape (nv,)
        Their rates.
    out : ndarray, shape (nv,)
        Written in place.

    """
    kinematics.outward(model, q, qd, work)
    rank_revealing.correct(model, work, level, out)


@compiled
def _evaluate_by_loops(by_loops, system, q, qd):
    """Evaluate a state by the kernels' loops, where nothing is unrolled."""
    if by_loops is not None:
        model, work, formulation = system.model, system.work, int(system.settings[FORMULATION])
        applied, baumgarte, good = system.applied, system.settings[BAUMGARTE_GAIN], False
        for attempt in range(2):
            # An elimination uses up what the outward recursion and the effects leave.
            kinematics.outward(model, q, qd, work)
            apply_effects(system.effects, system.manifold, work, q, qd, system.tau)
            if attempt == 1:
                good = refinement.accelerate(
                    model, work, applied, baumgarte, system.qdd, system.lam)
            elif formulation == SUBSYSTEM:
                good = forward_dynamics.accelerate(
                    model, work, applied, baumgarte, system.qdd, system.lam)
            else:
                good = _accelerate_dense(system.dense, model, work, formulation, applied,
                                         baumgarte, system.qdd, system.lam)
            if good:
                break
        if not good:
            calls.call(system.table, calls.RANK_REVEALING_ACCELERATION, q, qd)


@inlined
def _accelerate_anew(table, q, qd):
    """Compute accelerations and multipliers where the elimination alone will not do."""
    if calls.call(table, calls.REFINED_ACCELERATION, q, qd) == 0:
        calls.call(table, calls.RANK_REVEALING_ACCELERATION, q, qd)


@inlined
def _evaluate_unrolled(unrolled, system, q, qd):
    """Evaluate a state by unrolled routines, where there are any."""
    if unrolled is not None:
        table = system.table
        calls.call(table, calls.OUTWARD, q, qd)
        apply_effects(system.effects, system.manifold, system.work, q, qd, system.tau)
        if calls.call(table, calls.ACCELERATION, q, qd) == 0:
            _accelerate_anew(table, q, qd)


@inlined
def _evaluate_bare(unrolled, table, effects, q, qd):
    """Evaluate a state at once, where routines are unrolled and no effect is listed."""
    if unrolled is not None:
        if effects is None:
            if calls.call(table, calls.EVALUATION, q, qd) == 0:
                calls.call(table, calls.OUTWARD, q, qd)
                _accelerate_anew(table, q, qd)


@inlined
def _evaluate_among_effects(effects, system, q, qd):
    """Evaluate a state in parts, where effects are listed."""
    if effects is not None:
        _evaluate_unrolled(system.unrolled, system, q, qd)


@compiled
def _hold(cuts, effects, system, q, qd):
    """Find the friction that holds joints at rest, where it may be that of cut joints or not."""
    if cuts is None:
        _hold_joints(effects, system, q, qd)
    if cuts is not None:
        _hold_with_cuts(cuts, effects, system, q, qd)


@compiled
def _hold_joints(effects, system, q, qd):
    """Find the friction that holds joints at rest, by the response to that of each."""
    count = effects.sticking.rows[0]
    sticking.keep(effects, system.qdd, system.lam)
    for place in range(count):
        row = effects.sticking.rows[place + 1]
        effects.sticking.hold[row] = effects.output[row, 3]
        _evaluate_unrolled(system.unrolled, system, q, qd)
        _evaluate_by_loops(system.by_loops, system, q, qd)
        sticking.respond(effects, place, system.qdd, system.lam)
    sticking.balance(effects, system.qdd, system.lam)


@compiled
def _take_accelerations(cuts, system, q, qd):
    """Put the accelerations of cut joints behind those of the tree."""
    kinematics.outward(system.model, q, qd, system.work)
    for i in range(qd.shape[0]):
        cuts.qdd[i] = system.qdd[i]
    cut_coordinates.accelerations(
        cuts, system.model, system.work, system.qdd, True, cuts.qdd)


@compiled
def _hold_with_cuts(cuts, effects, system, q, qd):
    """Do as ``_hold_joints`` does where cut joints may be at rest, too."""
    stuck, hold = effects.sticking.rows, effects.sticking.hold
    count = stuck[0]
    _take_accelerations(cuts, system, q, qd)
    sticking.keep(effects, cuts.qdd, system.lam)
    for place in range(count):
        row = stuck[place + 1]
        hold[row] = effects.output[row, 3]
        _evaluate_unrolled(system.unrolled, system, q, qd)
        _evaluate_by_loops(system.by_loops, system, q, qd)
        _take_accelerations(cuts, system, q, qd)
        sticking.respond(effects, place, cuts.qdd, system.lam)
    sticking.balance(effects, cuts.qdd, system.lam)
    for i in range(qd.shape[0]):
        system.qdd[i] = cuts.qdd[i]
    if effects.loaded[0] > 0:
        # Friction at a cut joint acts on bodies: it is part of what the reactions balance.
        for place in range(count):
            hold[stuck[place + 1]] = effects.output[stuck[place + 1], 1]
        kinematics.outward(system.model, q, qd, system.work)
        apply_effects(effects, system.manifold, system.work, q, qd, system.tau)
        for place in range(count):
            hold[stuck[place + 1]] = 0.0


@compiled
def _tell_motions(motions, effects, lam):
    """Tell the forces of prescribed motions, where a scene lists any."""
    if motions is not None:
        if motions.shape[0] > 0:
            prescribed_motion.tell(effects, lam)


@inlined
def follow_motions(effects, state, first):
    """
    Set the right-hand sides of prescribed motions to the time of a state.

    Parameters
    ----------
    effects : EffectTable or None
        Of the system.
    state : ndarray, shape (ns,)
        Coordinates, rates, and what effects add.
    first : int
        Place of the first of these: nq + nv.

    """
    if effects is not None:
        _follow_motions(effects.motions, effects, state, first)


@compiled
def _follow_motions(motions, effects, state, first):
    """Set right-hand sides, where a scene lists prescribed motions."""
    if motions is not None:
        if motions.shape[0] > 0:
            take_states(effects, state, first)
            prescribed_motion.follow_all(effects)


@inlined
def _complete(effects, system, q, qd):
    """Add what depends on the accelerations: friction at rest, forces, reactions in joints."""
    if effects is not None:
        if effects.sticking.rows[0] > 0:
            _hold(effects.cuts, effects, system, q, qd)
        _tell_motions(effects.motions, effects, system.lam)
        _feel_reactions(effects, system, q, qd)


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
    _evaluate_unrolled(system.unrolled, system, q, qd)
    _evaluate_by_loops(system.by_loops, system, q, qd)
    _complete(system.effects, system, q, qd)


@merged
def evaluate_only(system, q, qd):
    """
    Do as ``evaluate`` does, but leave nothing else behind: what integrators need.

    Parameters
    ----------
    system : System
        ``effects.states`` must be those of the state.
    q : ndarray, shape (nq,)
        Joint coordinates.
    qd : ndarray, shape (nv,)
        Their rates.

    """
    _evaluate_bare(system.unrolled, system.table, system.effects, q, qd)
    _evaluate_among_effects(system.effects, system, q, qd)
    _evaluate_by_loops(system.by_loops, system, q, qd)
    _complete(system.effects, system, q, qd)


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
    close_stage(system, state)
    evaluate_state(system, state)
    take_derivative(system, state, out)


@merged
def close_stage(system, state):
    """Close the loops of independent coordinates: the others are first guesses only."""
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    _close(system.partition, system.model, system.work, system.manifold, state[:nq],
           state[nq:nq + nv], system.settings[CLOSURE_TOLERANCE])


@merged
def take_derivative(system, state, out):
    """Put together the derivative of a state that has been evaluated."""
    nv = system.qdd.shape[0]
    nq = rates_begin(system.manifold, nv)
    rates_of_coordinates(system.manifold, state, nv, out, 1)
    for i in range(nv):
        out[nq + i] = system.qdd[i]
    _give_rates(system.effects, nq + nv, out)
    power_of_turns(system.manifold, system.tau, state, nv, out, 1)
