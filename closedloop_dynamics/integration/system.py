# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The system of equations that is integrated: a mechanism under joint torques."""

from typing import NamedTuple, Optional

import numpy as np

from .left_out import all_equations, AllEquations
from ..core import codegen
from ..core.codegen import function_table as calls, joint_kernels, space
from ..core.codegen.workspace import unconnected
from ..core.equations import with_all_equations
from ..core.formulations import allocate_dense, DenseWorkspace, SUBSYSTEM
from ..core.independent import allocate_partition, Partition
from ..core.manifold import Manifold, manifold_of
from ..core.types import (
    KEPT, Model, number_of_coordinates, POSSIBLE, RANK_REVEALING_COUNT, Workspace)
from ..effects import law_code, scene_code
from ..effects.table import build_table, EffectTable, JOINT_FRICTION
from ..engine import native

# Unrolled code grows with the mechanism: beyond this number of bodies it takes too long to
# compile and falls out of the fastest memory. In space, where the loops do more in vain, it pays
# up to so many operations of an evaluation, by a rule of thumb: they take some twenty seconds to
# compile, once. Of more freedoms than these there is one set of routines: equations that are left
# out are exchanged in a run, which must not wait for others, and those for light links are larger.
MOST_UNROLLED_BODIES, MOST_UNROLLED_OPERATIONS, MOST_IN_VARIANTS = 24, 50_000, 40
# Equations that are left out, up to which multipliers of all are found by a routine.
MOST_LEFT_OUT = 12
# Columns of System.settings: the formulation, Baumgarte's decay rate [1/s] (0: none), the closure
# error [m, rad] that projection leaves and the one at which it gives up, how far beside a state
# the rank-revealing path asks the branch [rad], the size of the mechanism [m], and the closure
# error of equations left out up to which they repeat others.
FORMULATION, BAUMGARTE_GAIN, CLOSURE_TOLERANCE, CLOSURE_LIMIT, ASIDE, SIZE, OPENING = range(7)
# The eighth power of this is the error of the interpolation between such places.
DISTANCE_ASIDE = 0.015


class JointPlaces(NamedTuple):
    """Where the joints are, fixed ones left out: those of the tree, then the cut joints."""

    row: np.ndarray  # Int, shape (number of joints in the tree,): Of the bodies that they carry
    body: np.ndarray  # Int, shape (n, 2): Rows of the two bodies of each
    #: Shape (2 n, 2 or 3): The joint's point on the one body and on the other [m].
    point: np.ndarray


class AccelerationDerivatives(NamedTuple):
    """Generated derivatives of the accelerations, from which the stiff method has its Jacobian."""

    #: Addresses of the routines and of all that they read; place 0 is 0 while they are not those
    #: of the effects (ndarray of int).
    table: np.ndarray
    #: ``columns``, ``found``: Shape (blocks, LANES (nv + nc)): Changes of the residuals, and of
    #: accelerations and multipliers by them.
    columns: np.ndarray
    found: np.ndarray
    flows: np.ndarray  # Shape (2 nv, nz): Changes of the rates of the effects' states


class Code(NamedTuple):
    """Selection of the code that is generated for a mechanism."""

    #: Places in the function table; none: loops over bodies do it all (tuple of int).
    routines: tuple
    #: Structure of the effects (``scene_code.structure``) as they are in the evaluation of the
    #: scene; None: as they are at present.
    scene: Optional[tuple]


LOOPS = Code((), None)


class System(NamedTuple):
    """
    One mechanism with all that an evaluation of its motion reads and writes.

    Notes
    -----
    A state vector has the coordinates, shape (nq,), the rates, shape (nv,), the effects' own
    states, and, where there are quaternions, the work that torques did on their joints. nq is nv
    where there are none.

    """

    model: Model
    work: Workspace
    dense: DenseWorkspace  # Of the dense formulations; of no length where none is used
    partition: Partition  # Of the independent coordinates; of no length where they are not used
    settings: np.ndarray  # Shape (7,)
    #: Shape (nv + nk,): Commanded joint torques [N m] and forces [N], behind them those of the nk
    #: cut joints that anything acts in.
    tau: np.ndarray
    qdd: np.ndarray  # Shape (nv,): Joint accelerations of the latest evaluation
    lam: np.ndarray  # Shape (nc,): Its multipliers
    #: Shape (nv,): Joint torques of commands and effects; ``tau`` itself where no effect is
    #: listed.
    applied: np.ndarray
    effects: Optional[EffectTable]  # Forces on the mechanism beside the commanded torques
    table: np.ndarray  # Of the routines that are generated for this mechanism (ndarray of int)
    #: Shape (2, nv): Of coordinates and rates, as generated routines leave them; of no length
    #: where there are no such routines.
    corrections: np.ndarray
    #: Where quaternions are among the coordinates; None where there are none.
    manifold: Optional[Manifold]
    whole: Optional[AllEquations]  # Where the elimination works on some of them only
    #: Where the joints are, for forces that are not unique; None: there are none of these.
    joints: Optional[JointPlaces]
    derivatives: Optional[AccelerationDerivatives]  # None: the stiff method takes differences
    #: Shape (1 + nq,): Of evaluations from places around a singular position, the largest closure
    #: error of a state between these [m], and its coordinates; 0: none since the last reset.
    passage: np.ndarray
    native: object  # The engine's view of all these

    @property
    def is_unrolled(self):
        """Whether evaluations are by routines that were unrolled for this mechanism."""
        return self.corrections.size > 0

    @property
    def is_independent(self):
        """Whether independent coordinates are integrated."""
        return self.partition.order.size > 0

    @property
    def has_redundant_constraints(self):
        """Whether equations that repeat others are left out."""
        return self.whole is not None

    @property
    def routines(self):
        """Places of its routines in the table."""
        return tuple(np.flatnonzero(self.table[:calls.BODY]).tolist())

    @property
    def code(self):
        """Which code systems on other equations of this mechanism are to have."""
        # Forces in joints are published or plotted, not integrated.
        return Code(tuple(one for one in self.routines if one not in codegen.OF_FORCES),
                    scene_code.known_structure(self.table))

    def __reduce__(self):
        """Copy and pickle without addresses, which hold for these very arrays."""
        return _relinked, (
            self.routines, *self._replace(table=None, derivatives=None, native=None))


def build_system(model, formulation=SUBSYSTEM, baumgarte=0.0, extent=1.0, independent=False,
                 elements=(), unrolled=None, cuts=None, joints=None, opening=1e-9):
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
        Whether to unroll the kernels for this mechanism; where not said, for few
        bodies and the subsystem-level formulation.
    cuts : tuple of 2 ndarrays, optional
        Of the cut joints that anything acts in, as for ``effects.table.build_table``.
    joints : JointPlaces, optional
        Needed where the elimination leaves equations out.
    opening : float
        Closure error of these up to which they repeat others, in sizes of the mechanism.

    """
    nv, nc = len(model.tree) - 1, len(model.column) - 1
    if unrolled is None:
        unrolled = formulation == SUBSYSTEM and _can_be_unrolled(model)
    # Closure errors of 1e-12 of the size are rounding; one of 1e-5 of it is an open loop.
    settings = np.array([
        formulation, baumgarte, 1e-12 * extent, 1e-5 * extent, DISTANCE_ASIDE, extent,
        opening * extent])
    tau = np.zeros(nv + (0 if cuts is None else len(cuts[0])))
    # With room for those that are left out: they may be taken again.
    most = len(with_all_equations(model).column) - 1
    effects = None if len(elements) == 0 and cuts is None else build_table(
        elements, tau, nv, most, space.is_spatial(model), model.cut_point, cuts)
    system = System(
        model=model, work=unconnected(model),
        dense=allocate_dense(model, formulation),
        partition=allocate_partition(model, independent),
        settings=settings, tau=tau, qdd=np.zeros(nv), lam=np.zeros(nc),
        applied=tau if effects is None else effects.applied[:nv], effects=effects, table=None,
        corrections=np.zeros((2, nv if unrolled else 0)), manifold=manifold_of(model),
        whole=None, joints=joints, derivatives=None,
        passage=np.zeros(1 + number_of_coordinates(model)), native=None)
    # Friction may come to depend on the reaction in its joint later.
    reactions = effects is not None and JOINT_FRICTION in effects.kind
    return _linked(system, (*codegen.ALWAYS, *((codegen.LOOP_EQUATIONS,) if 0 < nc < nv else ()),
                            *((codegen.REACTIONS,) if reactions else ()),
                            *_routines_of_forces(model, joints)))


def _routines_of_forces(model, joints):
    """Return which routines of forces in joints pay: loops over bodies do the same."""
    left_out = len(with_all_equations(model).column) - len(model.column)
    if left_out and (joints is None or left_out > MOST_LEFT_OUT):
        return ()
    least = (codegen.LEAST_FORCES, codegen.LEFT_OUT) if left_out else ()
    return (codegen.WRENCHES, *least) if left_out or space.is_spatial(model) else ()


def _can_be_unrolled(model):
    """Return whether routines of a mechanism are of bearable size."""
    freedoms, cut = len(model.tree) - 1, model.cut
    if not space.is_spatial(model):
        return freedoms <= MOST_UNROLLED_BODIES
    if freedoms > MOST_IN_VARIANTS and (cut[:, KEPT] != cut[:, POSSIBLE]).any():
        return False
    return codegen.unrolled_size(model) <= MOST_UNROLLED_OPERATIONS


def _linked(system, routines, scene=None):
    """Return a system with the addresses of its own arrays and of these routines, as ``Code``."""
    model, work, effects = system.model, system.work, system.effects
    joint_kernels.connect(model, work.kernel, work.cut_kernel)
    if effects is not None:
        # In a copy, too, routines read the arrays that laws write.
        system = system._replace(applied=effects.applied[:len(system.qdd)])
        law_code.link(effects)
    whole = all_equations(model, work, system.whole)
    table = calls.connect(
        {calls.BODY: model.body, calls.GRAVITY: model.gravity,
         calls.CUT_POINT: model.cut_point, calls.TAU: system.applied, calls.QDD: system.qdd,
         calls.BAUMGARTE: system.settings[BAUMGARTE_GAIN:],
         calls.LAM: system.lam, calls.HEALTH: work.health, calls.WORK_BODY: work.body,
         calls.CLOSURE: work.closure, calls.CLOSURE_RATE: work.closure_rate,
         calls.CORRECTIONS: system.corrections, calls.WRENCH: work.force,
         **({} if system.joints is None else {calls.JOINT_POINT: system.joints.point}),
         **({} if whole is None else {calls.LAM_OF_ALL: whole.lam}),
         **({} if effects is None else {
             calls.REACTION: effects.reaction, calls.COMMAND: system.tau,
             calls.VALUES: effects.values, calls.ENTRIES: effects.data,
             calls.CUT_VALUES: effects.cuts.values, calls.PRESENT: effects.code.present,
             calls.SIDES: effects.code.sides, calls.GAPS: effects.contacts.now,
             calls.TRIALS: effects.contacts.trial, calls.RATES: effects.rates,
             calls.RESPONSE: effects.sticking.response, calls.LIMIT: effects.sticking.right})})
    if system.is_unrolled and effects is None:
        codegen.link(model, table, routines, system.joints)
    elif system.is_unrolled:
        codegen.link(model, table, tuple(
            one for one in routines if one not in calls.OF_SCENE), system.joints)
        scene_code.link(model, effects, table, scene)
    return _bound(system._replace(table=table, whole=whole))


def _bound(system):
    """Return a system that the engine sees."""
    return system._replace(native=native.system(tuple(system)[:-1]))


def _relinked(routines, *fields):
    """Build a copied or unpickled system."""
    return _linked(System(*fields), routines)


def refine(system, state):
    """
    Give a system routines for links much lighter than others, if a state needs them.

    They are taken away where it does not. Without these routines loops over the bodies serve such
    links, in two to three times the time. ``state``, shape (ns,), closes the loops; the system's
    table is written.
    """
    if not system.is_unrolled or len(system.qdd) > MOST_IN_VARIANTS:
        return
    health, (q, qd, *_) = system.work.health, parts_of_state(system)
    before, system.table[list(codegen.REFINED)] = health.copy(), 0
    native.evaluate_state(system.native, state)
    # Where equations depend on others, these routines would fail.
    if (health[RANK_REVEALING_COUNT] == before[RANK_REVEALING_COUNT]
            and not native.is_regular(system.native, state[q], state[qd])):
        codegen.link(system.model, system.table, codegen.REFINED)
    health[:] = before


def parts_of_state(system):
    """Return the places of q, qd and the effects' own states in a state vector, and its length."""
    nv = len(system.qdd)
    nq = nv if system.manifold is None else nv + len(system.manifold.balls)
    end = nq + nv + (0 if system.effects is None else len(system.effects.states))
    return (slice(nq), slice(nq, nq + nv), slice(nq + nv, end),
            end if system.manifold is None else end + 1)


def with_equations(system, model, code=LOOPS):
    """
    Return a system that works on other closure equations; it shares state, torques and effects.

    ``model`` is of the same mechanism with other equations kept; ``code`` selects code for these:
    by default none, so that nothing is compiled.
    """
    work = unconnected(model)
    work.health[:] = system.work.health
    return _linked(system._replace(
        model=model, work=work, whole=None, derivatives=None, lam=np.zeros(len(work.closure)),
        dense=allocate_dense(model, int(system.settings[FORMULATION])),
        partition=allocate_partition(model, system.is_independent),
        corrections=np.zeros((2, len(system.qdd) if code.routines else 0))), *code)


def with_partition(system, used):
    """
    Return a system with another set of independent coordinates, none chosen yet.

    Parameters
    ----------
    system : System
        As it was; all else is shared.
    used : bool
        Whether independent coordinates are used.

    """
    return _bound(system._replace(partition=allocate_partition(system.model, used)))


def with_derivatives(system, derivatives):
    """
    Return a system, all else shared, whose stiff method takes its Jacobian from generated code.

    ``derivatives`` are for this system's mechanism and effects.
    """
    return _bound(system._replace(derivatives=derivatives))


def number_of_states(system):
    """Return ns: the length of the state vector."""
    return parts_of_state(system)[-1]


class Probe:
    """
    Evaluations from Python, one at a time, with the arguments bound.

    ``q``, ``qd``, ``own``: coordinates, rates and effects' states that are evaluated: views of a
    state vector; ``evaluate``: as ``evaluate_with_poses`` of the engine.
    """

    def __init__(self, system, state=None):
        """Evaluate a state vector, shape (ns,), wherever it moves, or one of its own."""
        *parts, count = parts_of_state(system)
        state = np.zeros(count) if state is None else state
        self.q, self.qd, self.own = (state[part] for part in parts)
        self.evaluate = native.bind('evaluate_with_poses', system.native, state)
