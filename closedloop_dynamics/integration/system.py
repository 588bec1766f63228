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

from contextlib import contextmanager
from functools import partial
import time
from typing import NamedTuple, Optional, Tuple
import warnings

import numpy as np

from . import stages
from .evaluation import apply_listed, ASIDE, BAUMGARTE_GAIN, FORMULATION
from .left_out import allocate_left_out, LeftOut
from .motion import EVALUATE, Moving
from ..core import codegen, kinematics, rank_revealing
from ..core.codegen import function_table as calls, pieces, records, space
from ..core.equations import Equations, with_all_equations
from ..core.formulations import allocate_dense, DenseWorkspace, SUBSYSTEM
from ..core.independent import allocate_partition, Partition
from ..core.manifold import Manifold, manifold_of
from ..core.types import Model, number_of_coordinates, Workspace
from ..core.workspace import unconnected
from ..effects import dispatch
from ..effects.table import build_table, EffectTable

# Unrolled code grows with the mechanism: beyond this number of bodies it takes too long to
# compile and falls out of the fastest memory; in space, where the loops do more in vain, beyond
# this number of freedoms.
MOST_UNROLLED_BODIES, MOST_UNROLLED_FREEDOMS = 24, 40
# No evaluation takes so long, but compiling does [s].
LONG = 3.0


class System(NamedTuple):
    """
    One mechanism with all that an evaluation of its motion reads and writes.

    Attributes
    ----------
    model : Model
    work : Workspace
    dense : DenseWorkspace
        Of the dense formulations; of no length where none is used.
    partition : Partition
        Of the independent coordinates; of no length where they are not used.
    left_out : LeftOut
        All equations, where some that repeat others are left out.
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
    corrections : ndarray, shape (2, nv)
        Of coordinates and rates, as unrolled routines leave them; of no length where there are no
        such routines.
    manifold : Manifold or None
        Where quaternions are among the coordinates; None where there are none.
    moving : Moving
        What integrators see: the addresses of all that can be asked of the system.
    records : tuple of 2 ndarrays
        What is behind these addresses, and those of the effects' laws.

    Notes
    -----
    A state vector has the coordinates, shape (nq,), the rates, shape (nv,), the effects' own
    states, and, where there are quaternions, the work that torques did on their joints. nq is nv
    where there are none.

    """

    model: Model
    work: Workspace
    dense: DenseWorkspace
    partition: Partition
    left_out: LeftOut
    settings: np.ndarray
    tau: np.ndarray
    qdd: np.ndarray
    lam: np.ndarray
    applied: np.ndarray
    effects: Optional[EffectTable]
    table: np.ndarray
    corrections: np.ndarray
    manifold: Optional[Manifold]
    moving: Moving
    records: Tuple[np.ndarray, np.ndarray]

    @property
    def is_unrolled(self):
        """Whether evaluations are by routines that were unrolled for this mechanism."""
        return self.corrections.size > 0

    @property
    def is_bare(self):
        """Whether one such routine makes a whole evaluation: without effects."""
        return self.is_unrolled and self.effects is None

    @property
    def is_independent(self):
        """Whether independent coordinates are integrated."""
        return self.partition.order.size > 0

    @property
    def leaves_out(self):
        """Whether equations that repeat others are left out."""
        return self.left_out.numbers.size > 0

    def __reduce__(self):
        """Copy and pickle without addresses, which hold for these very arrays."""
        effects = None if self.effects is None else self.effects._replace(laws=None)
        return _relinked, tuple(self._replace(
            effects=effects, table=None, moving=None, records=None))


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
        dense=allocate_dense(model, formulation),
        partition=allocate_partition(model, independent), left_out=None,
        settings=settings, tau=tau, qdd=np.zeros(nv), lam=np.zeros(nc),
        applied=tau if effects is None else effects.applied[:nv], effects=effects, table=None,
        corrections=np.zeros((2, nv if unrolled else 0)), manifold=manifold_of(model),
        moving=None, records=None)
    return _linked(system)


def _linked(system):
    """Return a system with the addresses of its own arrays and routines."""
    model, work, law_record = system.model, system.work, np.zeros(0, dtype=np.int64)
    pieces.connect(model, work.piece, work.cut_piece)
    system = system._replace(left_out=allocate_left_out(model, work, system.left_out))
    if system.effects is not None:
        effects, law_record = dispatch.linked(system.effects, work.body, system.tau)
        # Of a copy, too, what laws write is what routines read.
        system = system._replace(effects=effects, applied=effects.applied[:len(system.qdd)])
    table = calls.connect(
        {calls.BODY: model.body, calls.GRAVITY: model.gravity,
         calls.CUT_POINT: model.cut_point, calls.TAU: system.applied, calls.QDD: system.qdd,
         calls.BAUMGARTE: system.settings[BAUMGARTE_GAIN:],
         calls.LAM: system.lam, calls.HEALTH: work.health, calls.WORK_BODY: work.body,
         calls.CLOSURE: work.closure, calls.CLOSURE_RATE: work.closure_rate,
         calls.CORRECTIONS: system.corrections,
         **({} if system.effects is None else {calls.REACTION: system.effects.reaction})},
        number_of_coordinates(model), _rank_revealing_routines(system),
        partial(codegen.later, model))
    if system.is_unrolled:
        codegen.relink(model, table)
    return _asked(system._replace(table=table, records=(law_record, law_record)))


def _asked(system, by_euler=False):
    """Return a system with the addresses of what integrators ask of it."""
    system, record = stages.linked(system, by_euler)
    return system._replace(records=(record, system.records[1]))


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

    def acceleration(q, qd):
        with _reveal_rank(qdd):
            kinematics.outward(model, q, qd, work)
            if effects is not None:
                apply_listed(manifold, effects, work, q, qd, tau)
            rank_revealing.accelerate(
                model, work, applied, settings[BAUMGARTE_GAIN], settings[ASIDE], manifold, q, qd,
                qdd, lam)
        if kept is not None:
            with _or_nan(system.lam):
                system.lam[:] = kept.move(q).of_kept(lam)

    def correct(level, q, qd):
        with _reveal_rank(qdd):
            kinematics.outward(model, q, qd, work)
            rank_revealing.correct(model, work, level, qdd)

    return {calls.RANK_REVEALING_ACCELERATION: acceleration,
            calls.RANK_REVEALING_POSITION: partial(correct, rank_revealing.POSITION),
            calls.RANK_REVEALING_VELOCITY: partial(correct, rank_revealing.VELOCITY)}


@contextmanager
def _reveal_rank(out):
    """Let kernels of the rank-revealing path fill an array; say so if they had to be compiled."""
    begin = time.perf_counter()
    with _or_nan(out):
        yield
    elapsed = time.perf_counter() - begin
    if elapsed > LONG:
        warnings.warn(
            'A singular configuration, or loops that repeat one another: what deals with them '
            f'had to be compiled first, which took {elapsed:.0f} s. It is kept on disk; the next '
            'time there is no delay.', RuntimeWarning, stacklevel=4)


@contextmanager
def _or_nan(out):
    """Let an array be filled; where that fails it is NaN, which the integrators tell."""
    # No decomposition is found of numbers that are not finite, or nearly so.
    try:
        yield
    except (ValueError, np.linalg.LinAlgError):
        out[:] = np.nan


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
        model=model, work=work, left_out=None, lam=np.zeros(len(work.closure)),
        dense=allocate_dense(model, int(system.settings[FORMULATION])),
        partition=allocate_partition(model, system.is_independent)))


def with_partition(system, used):
    """
    Return a system with another set of independent coordinates, none chosen yet.

    Parameters
    ----------
    system : System
        As it was; all else is shared.
    used : bool
        Whether independent coordinates are used.

    Returns
    -------
    System

    """
    return _asked(system._replace(partition=allocate_partition(system.model, used)))


def stepped_by_euler(system):
    """Return a system that can be asked for steps of semi-implicit Euler; all else is shared."""
    return _asked(system, True)


def on_workspace(system, model, work):
    """
    Return a system whose effects act on the bodies of another workspace.

    Parameters
    ----------
    system : System
        As it was; its state, torques and effects are shared.
    model, work : Model, Workspace
        Of the same mechanism.

    Returns
    -------
    System
        To be evaluated by parts alone: its routines and stages are those of ``system``.

    """
    if system.effects is None:
        return system._replace(model=model, work=work)
    effects, record = dispatch.linked(system.effects, work.body, system.tau)
    return system._replace(
        model=model, work=work, effects=effects, records=(system.records[0], record))


def number_of_states(system):
    """Return ns: the length of the state vector."""
    return parts_of_state(system)[-1]


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
        *parts, count = parts_of_state(system)
        self._state = np.zeros(count) if state is None else state
        self.q, self.qd, self.own = (self._state[part] for part in parts)
        self._table = tuple(
            array.ctypes.data for array in (system.table, self.q, self.qd))
        self._bare = system.is_bare
        if not self._bare:
            self._ask = records.from_python(system.moving.addresses, EVALUATE, self._state)

    def evaluate(self):
        """Do as ``evaluation.evaluate`` does."""
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
