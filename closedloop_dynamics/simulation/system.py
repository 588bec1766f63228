# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The system of equations that is integrated: a mechanism under joint torques."""

from typing import NamedTuple, Optional

import numpy as np

from .. import codegen
from ..codegen import function_table as calls, joint_kernels, space
from ..codegen.equations import with_all_equations
from ..effects import scene_code
from ..effects.effect_table import EffectTable
from ..effects.force_law import FRICTION
from ..engine.manifold import manifold_of
from ..engine.types import Handle, Model, RANK_REVEALING_COUNT
from ..kinematics.loop_model import JointPlaces

# Equations that are left out, up to which multipliers of all are found by a routine.
MOST_LEFT_OUT = 12


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


class System(Handle):
    """
    One mechanism with all that an evaluation of its motion reads and writes.

    Arrays are those of ``engine/data.hpp``, by its names.

    Attributes
    ----------
    model : Model
    work : Handle
        Its workspace.
    effects : EffectTable or None
        Forces on the mechanism beside the commanded torques.
    applied : ndarray, shape (nv,)
        Joint torques of commands and effects; ``tau`` itself where no effect is listed.
    manifold : Handle or None
        Where quaternions are among the coordinates.
    whole : Arrays or None
        Of all equations, where the elimination works on some of them only.
    joints : JointPlaces or None
        For forces that are not unique; None: there are none of these.
    how : tuple
        Size [m] and opening, as ``build_system`` takes them.

    Notes
    -----
    A state vector has the coordinates, shape (nq,), the rates, shape (nv,), the effects' own
    states, and, where there are quaternions, the work that torques did on their joints. nq is nv
    where there are none.

    """

    def __init__(self, native, model, effects, joints, how):
        super().__init__(native, effects=effects, joints=joints, manifold=manifold_of(model),
                         how=how)
        self._work_on(model)

    def _work_on(self, model):
        """Have what belongs to the equations that the elimination works on."""
        self.model, self.work = model, Handle(self.own_workspace())
        self.applied = self.tau if self.effects is None else (
            self.effects.applied[:len(self.qdd)])
        if not len(self.whole.lam):
            self.whole = None

    def _see_again(self, model):
        """See arrays that are others now."""
        joints = self.joints
        del self.joints, self.whole
        self.see()
        self.joints = joints
        self._work_on(model)

    def use_equations(self, model, code=LOOPS):
        """Work on other closure equations from now on, as the system of ``with_equations``."""
        joint_kernels.connect(model)
        self.native.use_equations(model, with_all_equations(model), _addresses(
            model, self.effects, self.joints, code))
        self._see_again(model)

    def use_independent(self, used):
        """Use independent coordinates from now on, none chosen yet, or none."""
        self.native.use_independent(used)
        self._see_again(self.model)

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

    def __deepcopy__(self, memo):
        """Return one with memory of its own, without derivatives."""
        made = self.copy()
        return System(made, Model(made.own_model()), self.effects and self.effects.copied(made),
                      self.joints, self.how)

    def __reduce__(self):
        """Pickle as what it is built from, torques and settings, without derivatives."""
        code = Code(self.routines, scene_code.known_structure(self.table))
        settings = {name: float(number) for name, number in vars(self.settings).items()}
        return _rebuilt, (self.model, self.effects and self.effects.description, self.joints,
                          self.how, self.is_independent, code, self.tau, settings)


def build_system(model, baumgarte=0.0, extent=1.0, independent=False, elements=(), unrolled=None,
                 cuts=None, joints=None, opening=1e-9):
    """
    Allocate a system.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    baumgarte : float
        Decay rate of closure errors [1/s].
    extent : float
        Size of the mechanism [m], to which closure tolerances are relative.
    independent : bool
        Whether to integrate independent coordinates.
    elements : sequence of effects.element.ForceElement
        Of the effects that act.
    unrolled : bool, optional
        Whether to unroll the kernels for this mechanism; where not said, for few
        bodies.
    cuts : tuple of 2 ndarrays, optional
        Of the cut joints that anything acts in, as for ``EffectTable.of``.
    joints : JointPlaces, optional
        Needed where the elimination leaves equations out.
    opening : float
        Closure error of these up to which they repeat others, in sizes of the mechanism.

    """
    if unrolled is None:
        unrolled = codegen.can_be_unrolled(model)
    nv, nc, whole = len(model.tree) - 1, len(model.column) - 1, with_all_equations(model)
    effects = None if len(elements) == 0 and cuts is None else EffectTable.of(
        model, whole, elements, cuts)
    # Friction may come to depend on the reaction in its joint later.
    reactions = effects is not None and FRICTION in effects.role
    responses = effects is not None and scene_code.balances_in_parts(effects)
    code = Code((codegen.EVALUATION if baumgarte else codegen.MOTION, *codegen.ALWAYS,
                 *(codegen.OF_BRANCHES if 0 < nc < nv else ()),
                 *((codegen.REACTIONS,) if reactions else ()),
                 *((codegen.TORQUE_RESPONSE,) if responses else ()),
                 *_routines_of_forces(model, joints)) if unrolled else (), None)
    return _built(
        model, effects, joints, (extent, opening), independent, code, baumgarte)


def _built(model, effects, joints, how, independent, code, baumgarte):
    """Return a system of a table of effects, or none."""
    joint_kernels.connect(model)
    extent, opening = how
    return System(
        model.system(
            with_all_equations(model), effects, *(joints or _NO_PLACES), baumgarte, extent,
            opening, independent, _addresses(model, effects, joints, code)),
        model, effects, joints, how)


def _rebuilt(model, effects, joints, how, independent, code, tau, settings):
    """Return a system as it was pickled."""
    table = effects and EffectTable.described(model, with_all_equations(model), *effects)
    made = _built(model, table, joints, how, independent, code, settings['baumgarte_gain'])
    made.tau[:] = tau
    for name, number in settings.items():
        getattr(made.settings, name)[...] = number
    return made


_NO_PLACES = JointPlaces(
    np.zeros(0, dtype=np.int64), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))


def _addresses(model, effects, joints, code):
    """Return the addresses of routines by their places in the function table."""
    table = np.zeros(calls.TABLE_COLUMNS if code.routines else 0, dtype=np.int64)
    if code.routines and effects is None:
        codegen.link(model, table, code.routines, joints)
    elif code.routines:
        codegen.link(model, table, tuple(
            one for one in code.routines if one not in calls.OF_SCENE), joints)
        scene_code.link(model, effects, table, code.scene)
    return table


def _routines_of_forces(model, joints):
    """Return which routines of forces in joints pay: loops over bodies do the same."""
    left_out = len(with_all_equations(model).column) - len(model.column)
    if left_out and (joints is None or left_out > MOST_LEFT_OUT):
        return ()
    least = (codegen.LEAST_FORCES, codegen.LEFT_OUT) if left_out else ()
    return (codegen.WRENCHES, *least) if left_out or space.is_spatial(model) else ()


def link_evaluation(system):
    """Generate the evaluation with multipliers and closure errors, which is in parts otherwise."""
    if system.is_unrolled and system.effects is None:
        codegen.link(system.model, system.table, (codegen.EVALUATION,))
    elif system.is_unrolled:
        scene_code.link_evaluation(system.model, system.effects, system.table)


def refine(system, state):
    """
    Give a system routines for links much lighter than others, if a state needs them.

    They are taken away where it does not. Without these routines loops over the bodies serve such
    links, in two to three times the time. ``state``, shape (ns,), closes the loops; the system's
    table is written.
    """
    if not system.is_unrolled:
        return
    health, (q, qd, *_) = system.work.health, parts_of_state(system)
    before, system.table[list(codegen.REFINED)] = health.copy(), 0
    system.native.evaluate_state(state)
    if not system.native.is_regular(state[q], state[qd]):
        # Where equations depend on others, which loops over bodies tell, they would fail.
        loops = with_equations(system, system.model)
        loops.work.health[RANK_REVEALING_COUNT] = 0.0
        loops.native.evaluate_state(state)
        if loops.work.health[RANK_REVEALING_COUNT] == 0.0:
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
    joint_kernels.connect(model)
    return System(
        system.with_equations(model, with_all_equations(model), _addresses(
            model, system.effects, system.joints, code)), model, system.effects, system.joints,
        system.how)


def with_partition(system, used):
    """Return a system that shares all but independent coordinates, none chosen yet, or none."""
    return System(system.with_independent(used), system.model, system.effects,
                  system.joints, system.how)


def number_of_equations(system):
    """Return nc: how many equations there are, those that are left out among them."""
    return len(system.lam if system.whole is None else system.whole.lam)


def number_of_states(system):
    """Return ns: the length of the state vector."""
    return parts_of_state(system)[-1]
