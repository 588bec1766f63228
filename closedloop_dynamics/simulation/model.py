# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The model of a scene: quantities of any state, without a run."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from threading import local, RLock
from typing import (
    Any, Dict, List, NamedTuple, Optional, Sequence, Tuple, TYPE_CHECKING, TypeVar, Union)
import warnings

import numpy as np
from numpy.typing import ArrayLike

from .data import Numbers, vector
from .evaluation import Evaluation
from .evaluator import Evaluator
from .readings import Readings
from .reduced import Reduced
from ..codegen.equations import BY_ITSELF
from ..engine import native
from ..kinematics.assemblies import Assemblies, find_assemblies
from ..kinematics.driven import BranchEndError, driven_mechanism, DrivenKinematics
from ..kinematics.geometry import Geometry
from ..kinematics.state import State
from ..mechanism.errors import AssemblyError, SimulationError
from ..mechanism.fields import at, FieldError
from ..mechanism.named_array import frozen, reals
from ..scene.key_paths import changed, resolve
from ..scene.loading import load_scene
from ..scene.records import Scene

if TYPE_CHECKING:
    from .linearisation import Linearisation, LinearModel
    from .stepper import Step, Stepper

# Warnings of one call, at most.
MOST_NOTES = 3
# Difference of a flow to that of half the steps, 15 times its own error; most steps of a period.
FLOW_ERROR, MOST_FLOW_STEPS = 1e-10, 64
Found = TypeVar('Found')


class InverseDynamicsResult(NamedTuple):
    """
    Torques and forces of a given motion; a batch has a leading axis.

    Attributes
    ----------
    torque : ndarray, shape (number of actuated joints,)
        [N m or N].
    multipliers : ndarray, shape (nc,)
        Lagrange multipliers [N, N m].

    """

    torque: np.ndarray
    multipliers: np.ndarray


class Model:
    """
    A mechanism with its effects, constant: states go in, evaluations come out.

    May be asked by several threads; one after the other is served.

    Parameters
    ----------
    scene : scene_records.Scene
        As ``load_scene`` returns it; ``Model.from_scene`` takes its name, too.

    Attributes
    ----------
    scene : scene_records.Scene
    mechanism : mechanism.mechanism.Mechanism
    coordinates : mechanism.coordinates.Coordinates
    joint_names : tuple of str
        Names of the joints, in the order of rates.
    actuated_joints : tuple of str
        In the order of torques.

    Raises
    ------
    AssemblyError
        Where the loops cannot be closed from the scene's initial state.

    Examples
    --------
    >>> model = Model.from_scene('four_bar')
    >>> state = model.assemble({'crank_joint': 0.3}, hold=['crank_joint'])
    >>> model.evaluate(state, {'crank_joint': 5.0}).points['coupler_point']

    """

    @classmethod
    def from_scene(cls, scene: Union[str, Path, Mapping[str, Any], Scene]) -> 'Model':
        """
        Build the model of a scene.

        Parameters
        ----------
        scene : str, pathlib.Path, mapping or scene_records.Scene
            What ``load_scene`` takes, or what it returns.

        Raises
        ------
        SceneError, AssemblyError

        """
        return cls(scene if isinstance(scene, Scene) else load_scene(scene))

    def __init__(self, scene: Scene) -> None:
        if not isinstance(scene, Scene):
            raise TypeError(
                f'Model: expected a Scene, as load_scene returns it, got {scene!r}')
        self._lock = RLock()
        self._work = work = _ModelData(scene, self._lock)
        self.scene, self.mechanism, self.coordinates = scene, work.mechanism, work.coordinates
        self.joint_names, self.actuated_joints = work.joint_names, work.actuated_joints
        # The readings of each thread.
        self._reading = local()
        # By driven joints and points.
        self._driven: Dict[Any, DrivenKinematics] = {}
        # By independent joints: the model of its equations, and the linearisation.
        self._linear: Dict[Any, Tuple[Any, Any]] = {}
        # By all that they are made of.
        self._steppers: 'Dict[Any, Stepper]' = {}
        # Steps of linear models in discrete time, by independent joints.
        self._flow_steps: Dict[Tuple[str, ...], int] = {}

    def with_parameters(self, values: Mapping[str, float]) -> 'Model':
        """
        Return a model of other numbers.

        Parameters
        ----------
        values : mapping of str to float
            By key path, such as ``'mechanism.bodies.crank.mass'``,
            ``'effects.gravity.acceleration.1'``, ``'parameters.l'``.

        Raises
        ------
        ValueError
            Where there is no such number, or a value is impossible at its place.

        """
        return Model(changed(self.scene, {
            resolve(self.scene, key): value for key, value in values.items()}))

    # States.

    def assemble(self, position: Optional[Numbers] = None, velocity: Optional[Numbers] = None,
                 hold: Sequence[str] = (), time: float = 0.0) -> State:
        """
        Return a state that closes the loops, the effects' own states restarted.

        Parameters
        ----------
        position : mapping, or sequence of shape (nq,) or (n, nq), optional
            Approximate joint coordinates [rad or m]; in a mapping by joint name, the others near
            those of the scene's start. A mapping may have sequences of n numbers, each for one
            state of a batch. The scene's start when not given.
        velocity : mapping, or sequence of shape (nv,) or (n, nv), optional
            Approximate joint rates [rad/s or m/s], likewise; zero where not given, but those of
            the scene where no position is given either.
        hold : sequence of str
            Joints kept as given, as many as there are degrees of freedom; the nearest closed
            state when there are none.
        time : float
            Of the state [s]: where prescribed motions are.

        Raises
        ------
        AssemblyError
            Where no such state closes the loops.
        ValueError
            For unknown names, other shapes, and numbers that are not finite.

        Warns
        -----
        RuntimeWarning
            Where what was assembled may not be what was meant.

        """
        initial = self.scene.initial
        if position is None:
            position, hold = initial.position, hold or initial.hold
            velocity = initial.velocity if velocity is None else velocity
        samples, (positions, velocities) = _batch({'position': position, 'velocity': velocity})
        if samples == 0:
            raise ValueError('states: expected at least one, got none')
        with self._lock:
            if samples is None:
                states = self._work.assembled(positions(0), velocities(0), hold, time)
                notes = self._work.assembly_notes()
            else:
                states, notes = self._work.assembled_batch(
                    samples, (position, velocity), (positions, velocities), hold, time)
        if len(notes) > MOST_NOTES:
            notes[MOST_NOTES:] = [f'and {len(notes) - MOST_NOTES} more notes on these states']
        for note in notes:
            warnings.warn(note, RuntimeWarning, stacklevel=2)
        return states

    def state(self, q: ArrayLike, qd: Optional[ArrayLike] = None, own: Optional[ArrayLike] = None,
              time: ArrayLike = 0.0, *, close: bool = False) -> State:
        """
        Return a state, or a batch, of numbers as they are: nothing is assembled unless asked for.

        Parameters
        ----------
        q : array_like, shape (nq,) or (n, nq)
            Joint coordinates that close the loops [rad or m].
        qd : array_like, shape (nv,) or (n, nv), optional
            Joint rates that keep them closed [rad/s or m/s]; zero when not given.
        own : array_like, shape (nz,) or (n, nz), optional
            The effects' own states; restarted when not given.
        time : float, or array_like of shape (n,)
            [s].
        close : bool
            Whether to take the nearest state that closes the loops, as ``assemble`` finds it.

        Raises
        ------
        AssemblyError
            Where a state leaves the loops open, with the loop and by how much.
        ValueError
            For other shapes, numbers that are not finite, and quaternions whose norm is not 1.

        """
        place = reals('q', q)
        batch = place.shape[:-1]
        rates = np.zeros((*batch, self.coordinates.nv)) if qd is None else qd
        nothing = np.zeros((*batch, self._work.own_states))
        given = State(time, place, rates, nothing if own is None else own, self.coordinates)
        self._work.require_state(given)
        if len(self.coordinates.balls):
            given = State(given.time, self.coordinates.unit(given.q), given.qd, given.own,
                          self.coordinates)

        def taken(one: State) -> State:
            if close:
                found = self.assemble(one.q, one.qd, (), one.time)
                return found if own is None else replace(found, own=one.own)
            self._work.at(one)
            return one if own is not None else self._work.begun(one.time, one.q, one.qd)

        with self._lock:
            if given.is_batch and not close and (
                    own is not None or self._work.begins_alike) and self._work.are_closed(given):
                return given
            each = _of_all(taken, given)
        return each[0] if not given.is_batch else State.stack(each) if each else given

    def solve(self, drives: Optional[Mapping[str, ArrayLike]] = None,
              points: Optional[Mapping[str, ArrayLike]] = None,
              branch: Optional[State] = None) -> State:
        """
        Return the state, at rest, in which driven joints and points have given values.

        From pose to pose the straight line of the driven values is followed on one branch, which
        is never left: forward kinematics of the actuated joints, inverse kinematics of a point.

        Parameters
        ----------
        drives : mapping of str to float, or to array_like of shape (n,), optional
            Values of joints, and of freedoms of cut joints [rad or m].
        points : mapping of str to array_like, shape (2,) or (n, 2), in space 3, optional
            Places of named points [m]; coordinates that are NaN are left to the mechanism. As
            many values as there are degrees of freedom are driven, points and joints together.
        branch : State, optional
            Closing the loops; where the way begins, and on which branch. The scene's start when
            not given.

        Raises
        ------
        BranchEndError
            Where the branch ends before a pose; its ``end`` says where and why.
        ValueError
            For unknown names, other shapes, numbers that are not finite, and more or fewer values
            than there are degrees of freedom.

        """
        count, mechanism, values = driven_mechanism(self.mechanism, drives, points)
        with self._lock:
            start = self._start_of(branch)
            if mechanism.motions not in self._driven:
                self._driven[mechanism.motions] = DrivenKinematics(mechanism, start)
            kinematics = self._driven[mechanism.motions]
            kinematics.start_at(start)
            motion = kinematics.follow(values)
        if motion.end is not None:
            raise BranchEndError(motion.end, len(motion.position), count is not None)
        return self.state(motion.position[0] if count is None else motion.position)

    def assemblies(self, drives: Optional[Mapping[str, float]] = None,
                   points: Optional[Mapping[str, ArrayLike]] = None) -> Assemblies:
        """
        Return all states, at rest, in which driven joints and points have given values.

        In the plane they are proved to be all where joints and cut joints lead to polynomial
        equations that can be solved, and no two of their solutions coincide; otherwise those
        found from random starts are returned, which may not be all.

        Parameters
        ----------
        drives, points
            As for ``solve``, for one pose; here two points of a body may be given whole.

        Raises
        ------
        ValueError
            As ``solve`` does.

        """
        count, mechanism, values = driven_mechanism(self.mechanism, drives, points)
        if count is not None:
            raise ValueError(f'expected one pose, got {count}')
        found = find_assemblies(
            mechanism, Geometry(mechanism).equations, values[0], self._start_of(None))
        nq = self.coordinates.nq
        return Assemblies(self.state(np.array(found.positions).reshape(-1, nq)), *found[1:])

    def _start_of(self, branch: Optional[State]) -> np.ndarray:
        """Return the position that a branch begins with."""
        if branch is None:
            with self._lock:
                return self._work.start().q
        self._work.require_state(branch)
        if branch.is_batch:
            raise ValueError(f'branch: expected one state, got a batch of {len(branch)}')
        with self._lock:
            return self._work.at(branch).position

    # What follows from a state.

    def evaluate(self, state: State, torque: Optional[Numbers] = None) -> Evaluation:
        """
        Return all that follows from a state, or from each of a batch, under torques.

        Parameters
        ----------
        state : State
            Closing the loops.
        torque : mapping, or sequence of shape (na,) or (n, na), optional
            Of the actuated joints [N m or N]: by joint name, those that are not named getting
            none, or for all of them in their order; for a batch one row for each, or one for all.
            Drives have them at once, whatever their delay.

        Raises
        ------
        ValueError
            For a state of another mechanism, and torques of other joints or shapes.

        """
        self._work.require_state(state)
        with self._lock:
            return self._work.evaluated(state, torque)

    def readings(self, state: State, torque: Optional[Numbers] = None) -> Readings:
        """
        Return the readings of a single state, valid until this thread's next call.

        Parameters
        ----------
        state, torque
            As for ``evaluate``.

        """
        self._work.require_state(state)
        if not hasattr(self._reading, 'work'):
            self._reading.work = _ModelData(self.scene, RLock())
        readings = self._reading.work.at(state)
        readings.system.tau[:] = readings.joint_torques(torque)
        return readings

    def inverse(self, state: State, acceleration: ArrayLike) -> InverseDynamicsResult:
        """
        Return the torques and multipliers that a motion needs.

        Parameters
        ----------
        state : State
            Closing the loops.
        acceleration : array_like, shape (nv,), or (n, nv) for a batch
            Consistent with the loops, as ``Evaluation.acceleration`` is [rad/s^2 or m/s^2].

        Returns
        -------
        InverseDynamicsResult
            The least torques where the mechanism is actuated redundantly; as
            ``Simulation.inverse_dynamics``.

        Raises
        ------
        SimulationError
            Where the actuated joints cannot produce the motion, or it opens the loops.
        ValueError
            For a state of another mechanism, and accelerations of another shape.

        """
        self._work.require_state(state)
        wanted = reals('acceleration', acceleration)
        if wanted.shape != state.qd.shape:
            raise ValueError(f'acceleration: expected shape {state.qd.shape}, as the rates of the '
                             f'state, got {wanted.shape}')
        with self._lock:
            if not state.is_batch:
                return self._work.needed(state, wanted)
            rows = iter(wanted)
            found = _of_all(lambda one: self._work.needed(one, next(rows)), state)
        if not found:
            raise ValueError('state: expected at least one, got an empty batch')
        return InverseDynamicsResult(*map(frozen, zip(*found)))

    def linearise(self, state: State, torque: Optional[Numbers] = None, *,
                  period: Optional[float] = None, outputs: Sequence[str] = ('position',),
                  independent: Optional[Sequence[str]] = None) -> 'LinearModel':
        """
        Return the motion near a state, to first order, in independent coordinates.

        Parameters
        ----------
        state : State
            A single one, closing the loops.
        torque : mapping, or sequence of shape (na,), optional
            As for ``evaluate``.
        period : float, optional
            Of a model in discrete time, torques held [s]; in continuous time when not given.
        outputs, independent
            As for ``linearisation.Linearisation``, which has equilibria and modes, too.

        Returns
        -------
        linearisation.LinearModel

        Raises
        ------
        SimulationError
            Where an effect has no derivative, with its name and the reason.
        SingularityError
            Where closure equations depend on one another.
        ValueError
            For a batch, a state of another mechanism, and other arguments that make no sense.

        """
        def linear(one: 'Linearisation') -> 'LinearModel':
            if period is None:
                return one.linear_model(state.q, state.qd, torque, outputs)
            found = self._by_steps(one, state, torque, period, outputs)
            return found or one.discrete_model(period, state.q, state.qd, torque, outputs)

        return self._linearised(state, independent, linear)

    def _by_steps(self, linearisation: 'Linearisation', state: State, torque: Optional[Numbers],
                  period: float, outputs: Sequence[str]) -> 'Optional[LinearModel]':
        """
        Return a model in discrete time by steps with Jacobians; None where these do not do.

        Half the steps show the error, which the fourth power of their length is a measure of.
        """
        if not begins(self, state) or self._work.effect_set.follows_time:
            return None
        model = linearisation.linear_model(state.q, state.qd, torque, outputs)
        names = tuple(
            name.partition('.')[2] for name in model.states[:len(model.states) // 2])
        rows, count = self._work.rows_of_torques(state, torque), self._flow_steps.get(names, 2)
        last = None
        try:
            while count <= MOST_FLOW_STEPS:
                key = names, count
                if key not in self._steppers:
                    self._steppers[key] = self.stepper(period, steps=count, independent=names)
                stepper = self._steppers[key]
                stepper.period = period
                step = stepper.step(state, rows)
                flow = np.hstack((step.A, step.B))
                if last is not None and np.abs(flow - last).max(initial=0.0) <= (
                        FLOW_ERROR * max(1.0, np.abs(flow).max(initial=0.0))):
                    self._flow_steps[names] = count // 2
                    size = len(step.A)
                    return replace(
                        model, A=flow[:, :size], B=flow[:, size:], period=float(period))
                last, count = flow, 2 * count
        except (SimulationError, ValueError):
            # What the steps refuse may have a flow all the same.
            pass
        return None

    def reduce(self, state: State, independent: Optional[Sequence[str]] = None) -> Reduced:
        """
        Return the mechanics of a state in independent coordinates, for controllers.

        Parameters
        ----------
        state : State
            A single one, closing the loops.
        independent : sequence of str, optional
            As for ``linearise``.

        Returns
        -------
        reduced.Reduced
            Inertia, bias, Jacobians of points and bodies, torques of accelerations, modes.

        Raises
        ------
        SimulationError, SingularityError, ValueError
            As ``linearise`` does.

        """
        def modes(torque: Any) -> List[Any]:
            return self._linearised(
                state, independent, lambda one: one.modes(state.q, torque))

        found, own, along = self._linearised(
            state, independent, lambda one: one.tangents(state.q, state.qd))
        return Reduced(self, state, found, own, along, modes)

    def _linearised(self, state: State, independent: Optional[Sequence[str]],
                    asked: 'Callable[[Linearisation], Found]') -> Found:
        """Return what is asked of a linearisation that works in a state."""
        # What it needs of SciPy takes long to load.
        from .linearisation import Linearisation
        self._work.require_state(state)
        if state.is_batch:
            raise ValueError(f'state: expected one state, got a batch of {len(state)}')
        chosen = None if independent is None else tuple(independent)
        with self._lock:
            work = self._work.at(state)
            model, linearisation = self._linear.get(chosen, (None, None))
            if model is not work.system.model:
                linearisation = Linearisation(work, chosen)
                self._linear[chosen] = work.system.model, linearisation
            return asked(linearisation)

    def step(self, state: State, torque: Optional[Numbers], period: float, *,
             method: str = 'rk4', steps: Optional[int] = None, parameters: Sequence[str] = (),
             independent: Optional[Sequence[str]] = None) -> 'Step':
        """
        Return the states a period later, torques held, and the Jacobians of this map.

        ``stepper`` is the same for what is called again and again; ``rollout`` is without
        Jacobians, for all effects.

        Parameters
        ----------
        state : State
            One, or a batch, closing the loops.
        torque : mapping, or sequence of shape (na,) or (n, na), optional
            As for ``evaluate``.
        period, method, steps, parameters, independent
            As for ``Stepper``.

        Returns
        -------
        stepper.Step

        Raises
        ------
        AssemblyError, NumericalError, ClosureError, SingularityError, SimulationError, ValueError
            As ``Stepper`` does; ValueError for states in which effects have gone on, too.

        """
        self._work.require_state(state)
        if not begins(self, state):
            raise ValueError('state: expected one in which the effects begin again, as '
                             'Model.assemble returns it, got one in which they have gone on')
        chosen = None if independent is None else tuple(independent)
        key = float(period), repr(method), steps, tuple(parameters), chosen
        with self._lock:
            if key not in self._steppers:
                self._steppers[key] = self.stepper(
                    period, method=method, steps=steps, parameters=parameters,
                    independent=chosen)
            return self._steppers[key].step(state, self._work.rows_of_torques(state, torque))

    def stepper(self, period: float, **options: Any) -> 'Stepper':
        """
        Return what makes steps of a period with their Jacobians, again and again.

        Parameters
        ----------
        period, **options
            As for ``stepper.Stepper``, as is what is raised.

        """
        from .stepper import Stepper
        return Stepper(self, period, **options)

    def inertia(self, state: State) -> np.ndarray:
        """Return the generalized inertia matrix of the spanning tree, shape (..., nv, nv)."""
        return self._of_each(state, lambda data: data.inertia)

    def constraint_jacobian(self, state: State) -> np.ndarray:
        """Return the derivatives of the closure equations by the coordinates, (..., nc, nv)."""
        return self._of_each(state, lambda data: data.constraint_jacobian)

    def _of_each(self, state: State, asked: 'Callable[[Readings], np.ndarray]') -> np.ndarray:
        """Return an array that follows from a state, or from each of a batch."""
        self._work.require_state(state)
        with self._lock:
            found = _of_all(lambda one: asked(self._work.at(one)), state)
        return np.array(found) if state.is_batch else found[0]

    def evaluator(self, *quantities: str) -> Evaluator:
        """
        Return an evaluator of one state after another, at the least cost, in the scene's start.

        Parameters
        ----------
        *quantities : str
            As for ``Simulation.evaluator``, as is what is returned and raised.

        """
        with self._lock:
            self._work.at(self._work.start())
            return self._work.evaluator(*quantities)

    def __reduce__(self) -> Tuple[Any, ...]:
        """Copy and pickle as the scene, of which the model is rebuilt."""
        return Model, (self.scene,)

    def __repr__(self) -> str:
        """Show the mechanism's name, sizes and effects."""
        effects = f'; effects: {", ".join(self.scene.effects)}' if self.scene.effects else ''
        return (f'<Model of {self.mechanism.name}: {self.coordinates.nv} joint rates, '
                f'{len(self.mechanism.cut_joints)} cut joints, actuated: '
                f'{", ".join(self.actuated_joints) or "nothing"}{effects}>')


class _ModelData(Readings):
    """Data of one state after the other of a model, which holds a lock meanwhile."""

    def __init__(self, scene: Scene, lock: Any) -> None:
        super().__init__(scene)
        self._lock = lock

    def _refuse(self, q: ArrayLike, qd: ArrayLike, torque: ArrayLike) -> None:
        """As ``Data``, for evaluators, which are called without the lock."""
        with self._lock:
            super()._refuse(q, qd, torque)

    def start(self) -> State:
        """Return the scene's start, assembled."""
        return self.begun(0.0, *self.initial)

    @property
    def own_states(self) -> int:
        """How many states the effects have."""
        return len(self.own)

    def begun(self, time: float, q: np.ndarray, qd: np.ndarray) -> State:
        """Return a state in which the effects begin again, as it is."""
        self._put(time, q, qd, self.effect_set.initial)
        self.system.tau[:] = 0.0
        self.begin_loads()
        return self.snapshot()

    def assembled(self, position: Numbers, velocity: Optional[Numbers], hold: Sequence[str],
                  time: float) -> State:
        """Return a state near another one; joints not named are as at the start."""
        q, _ = self.initial
        self._put(vector('time', [time], 1)[0], q, np.zeros(self.coordinates.nv),
                  self.effect_set.initial)
        return self.begun(time, *self.near(position, velocity, hold))

    def assembled_batch(
            self, samples: int, given: Sequence[Optional[Numbers]],
            each: Sequence[Callable[[int], Any]], hold: Sequence[str],
            time: float) -> Tuple[State, List[str]]:
        """
        Return so many states as of ``assembled``, and notes of them.

        ``given`` are positions and velocities, ``each`` functions that give those of one state.
        Notes beyond ``MOST_NOTES`` may be empty.
        """
        present, rest = self.initial[0], np.zeros(self.coordinates.nv)
        vector('time', [time], 1)
        q, qd = (self._rows(what, values, start, samples) for what, values, start in zip(
            ('position', 'velocity'), given, (present, rest)))
        own = np.tile(self.effect_set.initial, (samples, 1))
        if q is None or qd is None or self.motions:
            how = np.zeros(samples, dtype=np.int64)
            q, qd = np.tile(present, (samples, 1)), np.tile(rest, (samples, 1))
        else:
            guesses = q.copy(), qd.copy()
            how = self.assembler.close_states(q, qd, hold)
        found: Dict[int, List[str]] = {}
        for k in np.flatnonzero((how == BY_ITSELF) | (not self.begins_alike)).tolist():
            try:
                with at(f'state {k}'):
                    state = (self.begun(time, q[k], qd[k]) if how[k] != BY_ITSELF else
                             self.assembled(each[0](k), each[1](k), hold, time))
            except AssemblyError as error:
                raise AssemblyError(f'state {k}: {error}') from None
            if how[k] == BY_ITSELF:
                found[k] = self.assembly_notes()
            q[k], qd[k], own[k] = state.q, state.qd, state.own
        notes: List[str] = []
        plain = how != BY_ITSELF
        if plain.any():
            counts = np.where(plain, self.assembler.count_notes(*guesses, q, qd, hold, how), 0)
            for k in np.flatnonzero(counts).tolist():
                found[k] = int(counts[k]) * ['']
        for k in sorted(found):
            if plain[k] and len(notes) < MOST_NOTES:
                found[k] = self.assembler.notes(
                    guesses[0][k], guesses[1][k], q[k], qd[k], hold)
            notes += [f'state {k}: {note}' for note in found[k]]
        return State(time, q, qd, own, self.coordinates), notes

    def _rows(self, what: str, values: Optional[Numbers], present: np.ndarray,
              samples: int) -> Optional[np.ndarray]:
        """Return numbers of many states, None where some are to be looked at one by one."""
        found = np.tile(present, (samples, 1))
        if isinstance(values, Mapping):
            names, single = self.coordinates, what == 'velocity'
            for name, value in values.items():
                rate = names.index.get(name, -1)
                if rate < 0 or rate not in names.single or isinstance(value, (bool, str)):
                    return None
                found[:, rate if single else names.place[rate]] = reals(what, value)
        elif values is not None:
            array = reals(what, values)
            if array.shape[-1:] != present.shape:
                return None
            found[:] = array
        if not np.isfinite(found).all():
            return None
        try:
            return self.coordinates.unit(found) if what == 'position' else found
        except FieldError:
            return None

    @property
    def begins_alike(self) -> bool:
        """Return whether effects begin alike in all states: they have none of their own."""
        effects = self.effect_set
        return not (len(self.own) or effects.traced or self.table.loaded[0]
                    ) and effects.cuts is None

    def are_closed(self, states: State) -> bool:
        """Return whether all of many states certainly close the loops."""
        return not self.motions and len(states) == self.equations.solve(
            'first_open', states.q.copy(), states.qd.copy(),
            float(self.system.settings.closure_limit))

    def _put(self, time: float, q: np.ndarray, qd: np.ndarray, own: np.ndarray) -> None:
        """Move to a state, with closure equations that serve there."""
        self.choose_equations(q)
        time = float(time)
        self.clock = lambda: time
        self.q[:], self.qd[:], self.own[:] = q, qd, own
        if self.motions:
            self.motions.set_time(time)

    def at(self, state: State) -> Readings:
        """Move to a state that closes the loops, without torques; AssemblyError for others."""
        self._put(state.time, state.q, state.qd, state.own)
        self.require_closed(self.q, self.qd)
        self.system.tau[:] = 0.0
        return self

    def evaluated(self, state: State, torque: Optional[Numbers]) -> Evaluation:
        """Return the evaluation of a state, or of a batch, under torques."""
        if not state.is_batch:
            self._put(state.time, state.q, state.qd, state.own)
            self.system.tau[:] = self.joint_torques(torque)
            found = self.evaluation(state)
            limit = float(self.system.settings.closure_limit)
            if not (found.closure <= limit and native.largest(self.system.work.closure_rate) <= (
                    limit * max(1.0, native.largest(self.qd)))):
                self.require_closed(self.q, self.qd)
            return found
        if not len(state):
            raise ValueError('state: expected at least one, got an empty batch')
        rows = self._torques_of_each(state, torque)
        each = iter(rows) if rows is not None and rows.ndim > 1 else repeat(torque)
        return Evaluation.stack(
            _of_all(lambda one: self.evaluated(one, next(each)), state), state)

    def _torques_of_each(self, state: State, torque: Optional[Numbers]) -> Optional[np.ndarray]:
        """Return torques that are given as numbers, checked where each state has its own."""
        rows = None if torque is None or isinstance(torque, Mapping) else reals('torque', torque)
        if rows is not None and rows.ndim > 1 and rows.shape != (
                len(state), len(self.actuated_joints)):
            na = len(self.actuated_joints)
            raise ValueError(f'torque: expected shape ({na},) or {(len(state), na)} for '
                             f'{len(state)} states and {", ".join(self.actuated_joints)}; got '
                             f'shape {rows.shape}')
        return rows

    def rows_of_torques(self, state: State, torque: Optional[Numbers]) -> np.ndarray:
        """Return torques of the actuated joints, shape (na,), or (n, na) for a batch."""
        rows = self._torques_of_each(state, torque) if state.is_batch else None
        if rows is not None and rows.ndim > 1:
            return rows
        places = [self.joint_names.index(name) for name in self.actuated_joints]
        one = self.joint_torques(torque)[places]
        return np.tile(one, (len(state), 1)) if state.is_batch else one

    def needed(self, state: State, acceleration: np.ndarray) -> InverseDynamicsResult:
        """Return the torques and multipliers that a motion needs."""
        self.at(state)
        return InverseDynamicsResult(*map(frozen, self.inverse_dynamics(
            state.q, state.qd, acceleration)))

    def begins(self, state: State) -> bool:
        """Return whether the effects that act on the motion restart in a state."""
        self.at(state)
        places = self.effect_set.own
        return not len(places) or np.array_equal(
            self.begun(0.0, state.q, state.qd).own[places], state.own[places])


def begins(model: Model, state: State) -> bool:
    """Return whether the effects restart in a state of a model, or in all of a batch."""
    work = model._work
    work.require_state(state)
    with model._lock:
        return all(_of_all(work.begins, state))


def _of_all(asked: Callable[[State], Found], states: State) -> List[Found]:
    """Return what is asked of a state, or of each of a batch, whose number errors name."""
    found: List[Found] = []
    for k, one in enumerate(states.each):
        try:
            found.append(asked(one))
        except SimulationError as error:
            if not states.is_batch:
                raise
            raise type(error)(f'state {k}: {error}') from None
    return found


def _batch(given: Mapping[str, Optional[Numbers]]) -> Tuple[
        Optional[int], List[Callable[[int], Any]]]:
    """
    Return the number of states, None for a single one, and a function giving each one.

    Raises
    ------
    ValueError
        Where there are different numbers of them.

    """
    counts: Dict[str, int] = {}
    found: List[Callable[[int], Any]] = []
    for what, values in given.items():
        if isinstance(values, Mapping):
            several = {key: reals(f'{what}: {key}', value) for key, value in values.items()
                       if isinstance(value, (list, tuple, np.ndarray)) and np.ndim(value) > 0}
            for key, numbers in several.items():
                if numbers.ndim > 1:
                    raise ValueError(f'{what}: {key}: expected a number, or n of them, got shape '
                                     f'{numbers.shape}')
                counts[f'{what} of {key}'] = len(numbers)
            found.append(_of_mapping(values, several))
            continue
        rows = None if values is None else reals(what, values)
        if rows is not None and rows.ndim > 1:
            if rows.ndim > 2:
                raise ValueError(f'{what}: expected one or two axes, got shape {rows.shape}')
            counts[what] = len(rows)
        found.append(_of_rows(rows))
    if len(set(counts.values())) > 1:
        raise ValueError('expected the same number of states everywhere, got ' + ', '.join(
            f'{count} in {what}' for what, count in counts.items()))
    return next(iter(counts.values()), None), found


def _of_mapping(values: Mapping[str, Any], several: Dict[str, np.ndarray]) -> Callable[
        [int], Any]:
    """Return a function that gives the numbers of one state by name."""
    return lambda k: {**values, **{key: float(numbers[k]) for key, numbers in several.items()}}


def _of_rows(rows: Optional[np.ndarray]) -> Callable[[int], Any]:
    """Return a function that gives the numbers of one state."""
    return lambda k: rows[k] if rows is not None and rows.ndim > 1 else rows
