# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A state of a mechanism, and all that evaluates it: the arrays that change.

What a scene says stays as it is (``model.Model``); here are the coordinates and rates, the
torques, the effects with their own states, and the engine's system with its scratch, which works
on the closure equations that serve in the present state.
"""

from functools import partial
import math
from typing import Any, Callable, Iterable, Mapping, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike

from .cut_joints import acted_in, coordinate_arrays, CutJoints
from .evaluator import Evaluator, QUANTITIES, request
from .guards import CLOSING
from .inverse_dynamics import InverseDynamics
from .system import (
    build_system, LOOPS, number_of_equations, parts_of_state, refine, System, with_equations)
from ..effects.effect import NameResolver
from ..effects.effect_set import EffectSet
from ..engine import native, types as t
from ..kinematics.assembly import Assembler
from ..kinematics.geometry import Geometry
from ..kinematics.modeling import extent
from ..kinematics.motions import DrivingConstraints, require_actuated, with_motions
from ..kinematics.second_order import find_second_order, SecondOrder
from ..kinematics.state import State
from ..mechanism.coordinates import Coordinates
from ..mechanism.decomposition import decompose
from ..mechanism.errors import AssemblyError, SimulationError
from ..mechanism.fields import at
from ..mechanism.mechanism import Mechanism, Point
from ..mechanism.named_array import reals
from ..scene.integrators import PROJECTION
from ..scene.records import Method, Scene

# Torques, or numbers of a state, by name or in their order.
Numbers = Union[Mapping[str, Any], ArrayLike]


class Data:
    """
    One state of a scene's mechanism, and the system that evaluates it.

    Parameters
    ----------
    scene : scene_records.Scene
        The initial state is assembled: positions and velocities close the loops.

    Attributes
    ----------
    scene : scene_records.Scene
    mechanism : mechanism.mechanism.Mechanism
        With the equations of the motions that the scene prescribes.
    coordinates : mechanism.coordinates.Coordinates
        Names and places of the numbers of positions and velocities.
    acted : tuple of str
        Freedoms of cut joints that a drive or an effect acts along.
    joint_names : tuple of str
        Names of the joints, in the order of velocities and torques. A joint of several degrees of
        freedom has a name for each: ``hip.1``, ``ball.rx``.
    torque_names : tuple of str
        Names of the entries of the torques that ``Simulation.advance`` takes: those of
        ``joint_names``, then ``acted``.
    decomposition : mechanism.decomposition.Decomposition
    system : simulation.system.System
    clock : callable
        Returns the time of the state [s]; of a run its own.
    exchanges : int
        How often the equations that the elimination works on were exchanged.
    loop_model : geometry.Geometry
        The choice of closure equations that the elimination works on, and places of bodies.
    effect_set : effects.effect_set.EffectSet
        The effects as the kernels have them.
    integrated : ndarray, shape (ns,)
        Joint coordinates, rates and the effects' own states; may be written.
    actuated_joints : tuple of str
        In the order of torque sequences; see ``joint_names``.
    actuated : ndarray of int
        Places of the actuated joints among ``torque_names``, in their order.
    cut_joints : tuple of CutJoint
        In the order of the constraint forces.
    cut_joint_names : tuple of str
        Names of the freedoms of cut joints, as in the tree: ``guide.1``, ``ball.rx``; in the
        order of their velocities and efforts. ``Mechanism.cut_coordinates`` has them.
    motion_names : tuple of str
        Names of the effects that prescribe motions, in the scene's order.

    Raises
    ------
    AssemblyError
        Where the loops cannot be closed from the scene's initial state.

    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.mechanism: Mechanism = with_motions(scene)
        self.coordinates: Coordinates = self.mechanism.coordinates
        self.acted: Tuple[str, ...] = acted_in(self.mechanism, scene.effects)
        self.joint_names: Tuple[str, ...] = self.coordinates.names
        self.torque_names = (*self.joint_names, *self.acted)
        self.exchanges = 0
        self.clock: Callable[[], float] = float
        self.decomposition = decompose(self.mechanism)
        self._points = {point.name: point for point in self.mechanism.points}
        self.loop_model = Geometry(self.mechanism, self.decomposition)
        self._prescribe(scene)
        self._choose_equations(scene)
        mechanism = self.mechanism
        self.actuated_joints, self.cut_joints = mechanism.actuated_joints, mechanism.cut_joints
        self.cut_joint_names: Tuple[str, ...] = mechanism.cut_coordinates.names
        self.motion_names = tuple(motion.name for motion in mechanism.motions)
        placements = self.loop_model.placements
        model, self.equations = self.loop_model.model, self.loop_model.equations
        machine = NameResolver(
            self.mechanism, placements, self.motions.rows, self.acted)
        self.effect_set = EffectSet(scene.effects, model, machine, coordinate_arrays(
            self.mechanism, model, placements, self.acted, True)
            if self.acted else None, scene.switched_off)
        self.cuts = CutJoints(self.mechanism, model, placements, self.acted)
        for name, angle in scene.initial.turned.items():
            self.effect_set.begin_angle(name, angle)
        method = scene.method
        baumgarte = 1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0
        self.system: System = build_system(
            model, baumgarte, extent(self.mechanism), method.stabilisation == 'independent',
            self.effect_set.elements, cuts=self.effect_set.cuts,
            joints=self.loop_model.joint_points, opening=self.loop_model.opening)
        self.table = self.effect_set.bind(self.system)
        self.motions.records = self.effect_set.records
        *parts, states = parts_of_state(self.system)
        self.parts, self.integrated = tuple(parts), np.zeros(states)
        self.q, self.qd, self.own = (self.integrated[part] for part in parts)
        self._places = {name: place for place, name in enumerate(self.torque_names)}
        self.actuated = np.array(
            [self._places[name] for name in self.actuated_joints], dtype=int)
        # Those that take a torque: no joints whose motion is prescribed.
        prescribed = {motion.freedom for motion in self.mechanism.motions}
        self._allowed = np.array([
            -1 if name in prescribed else self._places[name] for name in self.actuated_joints],
            dtype=np.int64)
        # The position of the last search for kinematically determined rates, and its result.
        self._determined: Tuple[Any, np.ndarray] = None, np.zeros(0, dtype=bool)
        self._assemble_start()
        self._code = self.system.code
        self.inverse = InverseDynamics(self)
        self._bind()

    def _choose_equations(self, scene: Scene) -> None:
        """Leave out equations that repeat others, and hold what they forbid to second order."""
        position, hold = np.array(scene.initial.position), scene.initial.hold
        leaves_out, chosen = self.may_leave_out(scene.method), self.loop_model
        self.second_order: Optional[SecondOrder] = None
        if not leaves_out and chosen.plainly_independent(position):
            return
        if not leaves_out:
            chosen = Geometry(self.mechanism, self.decomposition)
            self.motions.look_up(chosen.model)
        chosen.leave_out_repeated(position, hold)
        if chosen.unexplained is not None:
            self.second_order = find_second_order(self.mechanism, chosen.unexplained)
        if self.second_order is not None:
            self.mechanism = self.second_order.added_to(self.mechanism)
            self.decomposition = decompose(self.mechanism)
            self.loop_model = Geometry(self.mechanism, self.decomposition)
            self._prescribe(scene)
            if leaves_out:
                self.loop_model.leave_out_repeated(position, hold)
        if not leaves_out:
            self.loop_model.leave_out_unchanging(position)
        self.motions.look_up(self.loop_model.model)

    def _assemble_start(self) -> None:
        """Go to the scene's start, which its masses and forces have a part in."""
        initial = self.scene.initial
        self.assembler = Assembler(self.mechanism, self.equations)
        self.initial = self._assembled(initial.position, initial.velocity, initial.hold)
        self._by_masses = self.assembler.by_masses
        self.motions.require_independent(self.assembler, self.initial[0])
        if self.scene.method.stabilisation == 'independent':
            self.assembler.require_independent(self.initial[0])
        self._begin_at_start()

    def _begin_at_start(self) -> None:
        """Go to the start that was assembled."""
        self._find_determined()
        self.q[:], self.qd[:] = self.initial
        self.own[:] = self.effect_set.initial
        refine(self.system, self.integrated)

    def varies(self, paths: Iterable[Tuple[str, ...]]) -> bool:
        """
        Return whether ``vary`` can take other numbers without building anything.

        Parameters
        ----------
        paths : iterable of tuple of str
            Key paths, as ``key_paths.resolve`` returns them.

        """
        # Frames in space lie along centres of mass; lengths decide which equations are worked on.
        masses = ('mass', 'inertia', *(('center_of_mass',) if self.mechanism.planar else ()))
        return not (self.loop_model.by_masses or self.motions or self.second_order) and all(
            path[0] == 'effects' or (
                path[:2] == ('mechanism', 'bodies') and path[3] in masses) for path in paths)

    def vary(self, scene: Scene) -> bool:
        """
        Go to the start of another scene, as data built of it would be there, to the last bit.

        Parameters
        ----------
        scene : scene_records.Scene
            That differs from the present one in numbers for which ``varies`` holds.

        Returns
        -------
        bool
            False where there is no room for its numbers; nothing has changed then.

        Raises
        ------
        AssemblyError
            Where its loops cannot be closed; the data are of no more use.

        """
        mechanism = scene.mechanism
        others = {body.name for body, present in zip(mechanism.bodies, self.mechanism.bodies)
                  if body is not present}
        if not self.effect_set.vary(mechanism, scene.effects, partial(
                self.loop_model.set_masses, bodies=mechanism.bodies, changed=others)):
            return False
        self.scene, self.mechanism = scene, mechanism
        self.motions.records = self.effect_set.records
        self.system.tau[:] = 0.0
        if others:
            was_light = self.assembler.is_light
            self.assembler.rebind(mechanism)
            if self._by_masses or self.assembler.is_light != was_light:
                self._assemble_start()
                return True
        self._begin_at_start()
        return True

    def _find_determined(self) -> None:
        """Find the joints with friction that loops and motions move, or hold, by themselves."""
        directions = self.effect_set.directions_with_friction
        if not directions:
            return
        names = list({name: None for arms in directions for name, _ in arms})
        in_tree = [name for name in names if name in self.coordinates.index]
        in_cuts = [name for name in names if name not in self.coordinates.index]
        units = np.eye(len(self.joint_names))[[self.coordinates.index[name] for name in in_tree]]
        arms = np.array([[dict(found).get(name, 0.0) for name in in_tree + in_cuts]
                         for found in directions])

        def derivatives(position: np.ndarray) -> np.ndarray:
            moved = self.equations.move(position)
            return arms @ np.concatenate(
                (units, self.cuts.jacobian(moved.model, moved.work, in_cuts)))

        start = self.initial[0].tobytes(), directions
        if self._determined[0] != start:
            self._determined = start, self.assembler.determined(self.initial[0], derivatives)
        self.effect_set.mark_determined(
            found for found, determined in zip(directions, self._determined[1]) if determined)

    def _bind(self) -> None:
        """Bind evaluations of the present state, and of any other."""
        system = self.system
        #: Evaluates the present state under the present torques, unless that was done last.
        self.evaluate: Callable[[], None] = native.bind(
            'evaluate_present', system.native, self.integrated)
        self._elsewhere = np.zeros_like(self.integrated)
        asked = request(system, self.own, self._allowed)
        self._evaluate_given = native.bind('evaluate_given', system.native, asked)
        # Multipliers of all equations, in the present state and in a given one.
        self._lam, self._lam_given = np.zeros(number_of_equations(system)), asked.lam
        self.find_multipliers: Callable[[], None] = native.bind(
            'find_multipliers', system.native, self.integrated, self._lam)
        self.spread = np.zeros(len(system.tau))
        self.spread_torques = native.bind('spread_torques', self.spread, self._allowed)

    def may_leave_out(self, method: Method) -> bool:
        """
        Return whether equations that repeat others may be left out.

        In the plane not where loops drift apart, as these equations drift, too.
        """
        return not self.mechanism.planar or method.stabilisation in CLOSING

    def _prescribe(self, scene: Scene) -> None:
        """Find the equations of prescribed motions, and start their profiles."""
        self.motions = DrivingConstraints(
            scene, self.mechanism, self.loop_model.model, self.place, self._cut_place)
        self.motions.set_time(0.0)

    def _cut_place(self, name: str, position: np.ndarray) -> float:
        """Return the coordinate of a freedom of a cut joint in a position of the joints."""
        equations = self.loop_model.equations
        cuts = CutJoints(
            self.mechanism, equations.model, self.loop_model.placements, ())
        found, _ = cuts.measure(equations.move(position).work.body)
        return float(found[cuts.place(name)])

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return self.clock()

    @property
    def position(self) -> np.ndarray:
        """
        Joint coordinates, shape (nq,) [rad or m].

        nq is nv, the number of joint rates, and one more for each spherical and each free joint:
        orientations are unit quaternions x, y, z, w. ``coordinates.columns`` names them.
        """
        return self.q.copy()

    @property
    def velocity(self) -> np.ndarray:
        """
        Joint rates, shape (nv,) [rad/s or m/s].

        Of an orientation the angular velocity relative to the parent, about the child's axes.
        """
        return self.qd.copy()

    def snapshot(self) -> State:
        """Return the present state; torques and the memory of a method are not part of it."""
        return State(self.time, self.q, self.qd, self.own, self.coordinates)

    def require_state(self, state: State) -> None:
        """
        Refuse anything but a state of this scene, or a batch of such.

        Raises
        ------
        ValueError

        """
        if not isinstance(state, State):
            raise ValueError('state: expected a State, as Model.assemble and Model.state return '
                             f'it, got {state!r}')
        if state.coordinates.names != self.coordinates.names:
            raise ValueError(
                f'state: expected one of {self.mechanism.name}, with the joints '
                f'{", ".join(self.joint_names)}, got one with '
                f'{", ".join(state.coordinates.names)}')
        if state.own.shape[-1] != len(self.own):
            raise ValueError(f'state: expected {len(self.own)} own states of effects, got own of '
                             f'shape {state.own.shape}')

    def require_closed(self, q: np.ndarray, qd: np.ndarray, motions: bool = True) -> None:
        """
        Refuse coordinates and rates that leave the loops open.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            [rad or m].
        qd : ndarray, shape (nv,)
            [rad/s or m/s].
        motions : bool
            Whether they have to follow prescribed motions, too, at the present time.

        Raises
        ------
        AssemblyError
            With the loops and by how much they are open.

        """
        opened = self.assembler.opened(q, qd, self.system.settings.closure_limit, motions)
        if opened:
            raise AssemblyError(
                f'state: expected one that closes the loops, got one that leaves {opened}; '
                'Model.assemble, and Model.state with close=True, return the nearest that does')

    def closed(self, position: ArrayLike, velocity: ArrayLike) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return the nearest state that closes the loops, at the present time.

        For what is measured, or followed by approximations: a few corrections on its branch.

        Parameters
        ----------
        position : sequence, shape (nq,)
            [rad or m].
        velocity : sequence, shape (nv,)
            [rad/s or m/s].

        Returns
        -------
        position, velocity : ndarray

        Raises
        ------
        AssemblyError
            Where a few corrections find none.

        """
        state = self.integrated.copy()
        q, qd = (state[part] for part in self.parts[:2])
        q[:] = self._taken(position)
        qd[:] = vector('velocity', velocity, len(qd))
        if not self.system.native.stabilise(PROJECTION, state):
            opened = self.assembler.opened(q, qd, self.system.settings.closure_limit)
            raise AssemblyError(
                'state: expected one that nearly closes the loops, got one from which corrections '
                f'leave {opened}; give one nearer to a closed one, as Model.assemble returns them')
        return q.copy(), qd.copy()

    def touch(self) -> None:
        """Mark constants or arrays of the system as changed from outside."""
        self.system.native.touch()

    def place(self, name: str, position: np.ndarray) -> np.ndarray:
        """
        Return the place of a named point in another position of the joints.

        Parameters
        ----------
        name : str
            Of the point.
        position : ndarray, shape (nv,)
            Joint coordinates, which need not close the loops [rad or m].

        Returns
        -------
        ndarray, shape (2,), in space (3,)
            [m].

        """
        point = self._named_point(name)
        return self.loop_model.point(position, point.body, point.position)

    def _named_point(self, name: str) -> Point:
        if name not in self._points:
            raise SimulationError(
                f'There is no point {name!r} on {self.mechanism.name}; its points: '
                f'{", ".join(self._points) or "none"}.')
        return self._points[name]

    @property
    def has_redundant_constraints(self) -> bool:
        """Whether equations that repeat others are left out, and watched."""
        return self.loop_model.has_redundant_constraints

    def measure_cut_joints(self, q: np.ndarray, qd: np.ndarray) -> Tuple[np.ndarray, ...]:
        """
        Return coordinates and rates of all cut joints, and their derivatives by the tree's.

        Parameters
        ----------
        q, qd : ndarray, shape (nq,), (nv,)
            [rad or m], and per s.

        Returns
        -------
        position, velocity : ndarray, shape (n,)
            Of ``Mechanism.cut_coordinates``; see ``CutJoints.measure``.
        jacobian : ndarray, shape (n, nv)

        """
        moved = self.equations.move(q, qd)
        return (*self.cuts.measure(moved.work.body),
                self.cuts.jacobian(moved.model, moved.work, self.cuts.names))

    @property
    def takes_closed_states(self) -> bool:
        """Whether any state with closed loops may be a start."""
        return not (self.motions or self.has_redundant_constraints or self.system.is_independent
                    or self.assembler.is_light or self.table.loaded[0])

    @property
    def enabled_effects(self) -> Tuple[str, ...]:
        """Names of the effects that are switched on."""
        return tuple(name for name, enabled in self.effect_set.enabled.items() if enabled)

    @property
    def commanded_motions(self) -> Tuple[str, ...]:
        """
        Names that ``command_motion`` takes: of joints, and of effects that move points.

        Of prescribed motions of the shape ``commanded``, in the scene's order.
        """
        return tuple(self.motions.commanded)

    @property
    def actuated_in_tree(self) -> np.ndarray:
        """Return those among ``joint_names`` alone: of actuated joints that are not cut."""
        return self.actuated[self.actuated < len(self.joint_names)]

    def _assembled(
            self, position: ArrayLike, velocity: Optional[ArrayLike],
            hold: Sequence[str]) -> Tuple[np.ndarray, np.ndarray]:
        nv = self.coordinates.nv
        q = self._taken(position)
        qd = np.zeros(nv) if velocity is None else vector('velocity', velocity, nv)
        self.motions.begin(self.assembler, self.time, q, qd)
        try:
            self._assembly = self._closed(q, qd, hold)
        except AssemblyError:
            if not (self.motions and hold):
                raise
            # What is held may leave the motions no room.
            self._assembly = self._closed(q, qd, ())
        return self._assembly[2:4]

    def _closed(self, q: np.ndarray, qd: np.ndarray, hold: Sequence[str]) -> Tuple[Any, ...]:
        """Return a guess, the state that closes the loops near it, and the joints held."""
        closed = self.assembler.positions(q, hold)
        return q, qd, closed, self.assembler.velocities(closed, qd, hold), hold

    def near(
            self, position: Numbers, velocity: Optional[Numbers],
            hold: Optional[Sequence[str]]) -> Tuple[np.ndarray, np.ndarray]:
        """Return an assembly near a state, with the joints not named held."""
        with np.errstate(all='ignore'):
            return self._assembled(
                self._by_joint('position', position, self.q),
                self._by_joint('velocity', velocity, self.qd), hold or ())

    def _taken(self, position: ArrayLike) -> np.ndarray:
        """Return joint coordinates as an array, quaternions of norm 1."""
        q = vector('position', position, self.coordinates.nq)
        if self.system.manifold is None:
            return q
        with at('position'):
            return self.coordinates.unit(q)

    def _by_joint(self, what: str, values: Any, present: np.ndarray) -> Any:
        """Return a mapping by joint name as an array, anything else as it is."""
        if not hasattr(values, 'items'):
            return values
        with at(what):
            return self.coordinates.filled(what, values, present)

    def begin_loads(self) -> None:
        """Initialise effects with the present rates and reactions of their joints."""
        if self.effect_set.cuts is not None:
            self.evaluate()
            self.effect_set.restart_angles(self.own)
        self.effect_set.initialise_states(self.own, self.effect_set.rates(self.q, self.qd))
        self.effect_set.begin_at_time(self.own, self.time)
        if self.table.loaded[0] > 0:
            self.system.native.begin_loads(self.integrated)
        self.require_finite_laws()

    def require_finite_laws(self) -> None:
        """Refuse laws of users that have no finite value in the present state."""
        if self.effect_set.traced:
            self.evaluate()
            self.effect_set.require_finite()

    def use_equations(self, model: t.Model) -> None:
        """Evaluate with other closure equations from now on, from the same state."""
        # By loops over bodies where they are too many to have code: whether it is there must not
        # decide, as results differ in their last digits.
        self.system.use_equations(
            model, self._code if self.loop_model.has_code(model, self.initial[0]) else LOOPS)
        self.equations = self.loop_model.equations
        self.motions.look_up(model)
        self.effect_set.use_equations(model)
        self.exchanges += 1

    @property
    def exchange_is_cheap(self) -> bool:
        """Whether evaluations take no longer with other closure equations than with these."""
        return not self.system.is_unrolled or len(self.loop_model.choices(self.initial[0])) > 0

    def choose_equations(self, q: np.ndarray) -> None:
        """Work on equations that serve at a position, if the present ones do not."""
        if self.has_redundant_constraints and not self.loop_model.is_valid(q):
            self.use_equations(self.loop_model.choose(q))

    def forget_commands(self) -> None:
        """Let motions be those of the scene again, which a start follows."""
        if self.motions:
            for name, record in self.motions.forget_commands(self.scene.effects).items():
                self.effect_set.put(name, record, True)
            # They may have been changed since.
            initial = self.scene.initial
            self.initial = self._assembled(initial.position, initial.velocity, initial.hold)

    def prepare_exchanges(self) -> None:
        """
        Generate the code for all closure equations that may come to be worked on.

        What runs live calls this before: else a run waits for code where the mechanism moves so
        far that equations which were left out are taken instead of others. Results are the same.
        """
        for kept in self.loop_model.choices(self.initial[0]) if self._code.routines else ():
            with_equations(self.system, self.loop_model.model_of(kept)[0], self._code)

    def joint_torques(self, torque: Optional[Numbers]) -> np.ndarray:
        """
        Return joint torques as an array from any form that ``step`` takes, by ``torque_names``.

        Parameters
        ----------
        torque : mapping, sequence or None
            By joint name, or in the order of the actuated joints.

        Raises
        ------
        ValueError

        """
        if self.spread_torques(torque):
            return self.spread.copy()
        tau = np.zeros(len(self._places))
        named: Any = torque
        if hasattr(named, 'items'):
            require_actuated(self.mechanism, named)
            values = reals('torque', [*named.values()])
            if values.ndim > 1:
                raise ValueError(f'torque: expected a number for each joint, got {torque!r}')
            tau[[self._places[name] for name in named]] = values
        else:
            values = reals('torque', torque)
            if values.shape != (len(self.actuated),):
                raise ValueError(
                    f'torque: expected {len(self.actuated)} values, for '
                    f'{", ".join(self.actuated_joints)}; got shape {values.shape}')
            tau[self.actuated] = values
            if self.mechanism.motions:
                require_actuated(
                    self.mechanism, [self.torque_names[place] for place in np.flatnonzero(tau)])
        if not _are_finite(tau):
            raise ValueError(f'torque: expected finite numbers, got {torque!r}')
        return tau

    def forward_dynamics(
            self, position: ArrayLike, velocity: ArrayLike,
            torque: Optional[Numbers] = None) -> Tuple[np.ndarray, np.ndarray]:
        """
        Compute accelerations and multipliers of a state that closes the loops.

        Parameters
        ----------
        position : sequence, shape (nq,)
            Closing the loops, as ``closed`` returns it.
        velocity : sequence, shape (nv,)
            Keeping them closed.
        torque : mapping, sequence or None
            As for ``step``.

        Returns
        -------
        acceleration : ndarray, shape (nv,)
        multipliers : ndarray, shape (nc,)

        Raises
        ------
        AssemblyError
            Where the state leaves the loops open, with the loop and by how much.
        ValueError

        """
        if self._evaluate_given(position, velocity, torque):
            return self.system.qdd.copy(), self._lam_given.copy()
        nv, system = len(self.joint_names), self.system
        q, qd, own = (self._elsewhere[part] for part in self.parts)
        q[:] = self._taken(position)
        qd[:] = vector('velocity', velocity, nv)
        self.require_closed(q, qd)
        tau, applied = self.joint_torques(torque), system.tau.copy()
        system.tau[:] = tau
        self.table.states[:] = self.own
        self.effect_set.initialise_states(self.table.states, self.effect_set.rates(q, qd))
        own[:] = self.table.states
        system.native.evaluate_with_poses(self._elsewhere)
        lam = system.lam
        if self.has_redundant_constraints:
            lam = self._multipliers_elsewhere(q, qd)
        system.tau[:] = applied
        return system.qdd.copy(), lam.copy()

    def evaluator(self, *quantities: str) -> Evaluator:
        """
        Return an evaluator of ``forward_dynamics``, at the least cost per state.

        Parameters
        ----------
        *quantities : str
            What is wanted: ``'acceleration'``, ``'multipliers'``; both when not given.

        Returns
        -------
        simulation.evaluator.Evaluator
            In the present state without torques; it works on a copy of the mechanism and of the
            effects, as they are now.

        Raises
        ------
        ValueError
            For an unknown quantity.

        Examples
        --------
        >>> evaluate = simulation.evaluator('acceleration')
        >>> evaluate.q[:], evaluate.qd[:], evaluate.tau[:] = q, qd, tau
        >>> evaluate()
        >>> evaluate.acceleration

        """
        model = (self.loop_model.model_of(None)[0] if self.has_redundant_constraints
                 else self.system.model)
        made = Evaluator(
            self.system, model, self.own, self._allowed, quantities or QUANTITIES, self._refuse)
        made.q[:], made.qd[:] = self.q, self.qd
        return made

    def _refuse(self, q: ArrayLike, qd: ArrayLike, torque: ArrayLike) -> None:
        """Raise where a state or torques are impossible, or loops are open."""
        self.require_closed(self._taken(q), vector('velocity', qd, len(self.joint_names)))
        self.joint_torques(torque)

    def _multipliers_elsewhere(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the multipliers of all equations, which are solved where those kept do not do."""
        lam = np.zeros(number_of_equations(self.system))
        if self.system.native.find_all_multipliers(q, qd, lam):
            return lam
        whole = with_equations(self.system, self.loop_model.model_of(None)[0])
        whole.native.evaluate_with_poses(self._elsewhere)
        return whole.lam

    def inverse_dynamics(
            self, position: ArrayLike, velocity: ArrayLike,
            acceleration: ArrayLike) -> Tuple[np.ndarray, np.ndarray]:
        """
        Compute the torques and constraint forces that a motion needs.

        Parameters
        ----------
        position, velocity, acceleration : sequence, shape (nv,)
            Consistent with the loops.

        Returns
        -------
        torque : ndarray, shape (number of actuated joints,)
            The least ones where the mechanism is actuated redundantly [N m or N].
        multipliers : ndarray, shape (nc,)

        Raises
        ------
        SimulationError
            Where the actuated joints cannot produce the motion, or it opens the loops.
        AssemblyError
            Where position or rates leave them open.

        Notes
        -----
        Solves tau + tau_effects + J^T lambda = I qdd + c, tau zero at the joints that are not
        actuated. The torques are those at the joints, after limits and lags of the drives; dry
        friction is that of a steady motion, none where a joint rests. Time and the other states of
        effects are those of the present state, as for ``forward_dynamics``.

        """
        inverse = self.inverse
        if inverse.find(position, velocity, acceleration):
            return inverse.torque.copy(), inverse.lam.copy()
        nv = len(self.joint_names)
        q = self._taken(position)
        qd, qdd = (vector(name, values, nv) for name, values in (
            ('velocity', velocity), ('acceleration', acceleration)))
        self.require_closed(q, qd, motions=False)
        return inverse.solve(q, qd, qdd)

    def tree_torque(self, position: np.ndarray, velocity: np.ndarray,
                    acceleration: np.ndarray) -> np.ndarray:
        """
        Compute the torques of the spanning tree's joints in a motion, the loops open.

        Parameters
        ----------
        position : ndarray, shape (nq,)
            [rad or m].
        velocity, acceleration : ndarray, shape (nv,)
            They need not close the loops.

        Returns
        -------
        ndarray, shape (nv,)
            I qdd + c - tau_effects [N m or N]: torques of drives and J^T lambda add up to it.
            Effects are those of a steady motion, as for ``inverse_dynamics``; friction that
            depends on forces in joints is that of the forces felt in the present state.

        """
        self.table.states[:] = self.own
        return self.inverse.needed(position, velocity, acceleration)


def vector(name: str, values: ArrayLike, length: int) -> np.ndarray:
    """Return so many finite numbers as a new array; ``name`` is for the ValueError."""
    array = reals(name, values)
    if array.shape != (length,) or not _are_finite(array):
        raise ValueError(f'{name}: expected {length} finite numbers, got {values!r}')
    return array


def _are_finite(array: np.ndarray) -> bool:
    """Return whether all numbers are finite."""
    # Their sum is where all are, and quicker to find; it may overflow alone.
    return math.isfinite(array.sum()) or np.isfinite(array).all()
