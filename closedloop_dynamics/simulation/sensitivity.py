# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories and their derivatives, by the start, the torques and the parameters of a scene."""

from dataclasses import dataclass
from threading import RLock
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike

from .independent import changes_along, choose_independent, dependent_on, following, places_of
from .model import begins, Model
from .parameters import parameter_arrays
from .rollout import RolloutArguments, scheduled
from .rollout_run import all_torques, TimeGrid
from .simulation import Simulation
from .step_derivatives import StepDerivatives, turned
from .stepped_run import allocate_scratch, allocate_tape, RunInputs, SteppedRun
from .traced_scene import require_derivatives
from ..codegen.sensitivities import FORWARD, REVERSE
from ..engine.status import (
    DONE, INTERRUPTED, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, SINGULAR)
from ..kinematics.state import State
from ..mechanism.errors import ClosureError, NumericalError, SimulationError, SingularityError
from ..mechanism.fields import among, FieldError
from ..mechanism.named_array import by_shapes, frozen, reals, sealed
from ..scene.integrators import (
    BAUMGARTE, EXPLICIT, FIXED, INDEPENDENT, INTEGRATORS, STABILISATIONS)
from ..scene.records import Method, require_no_budget

_METHODS = tuple(name for name, each in INTEGRATORS.items()
                 if each.kind == FIXED and each.family == EXPLICIT)
_STABILISATIONS = tuple(name for name, each in STABILISATIONS.items()
                        if each not in (BAUMGARTE, INDEPENDENT))
_ENDS = {
    NOT_FINITE: (NumericalError, 'the numbers grow beyond all bounds', 'a smaller step'),
    OPEN_LOOP: (ClosureError, 'the loops cannot be closed', 'a smaller step'),
    POOR_EQUATIONS: (
        SingularityError, 'other closure equations would have to be worked on, and there is no '
        'derivative through that exchange', 'a shorter trajectory'),
    SINGULAR: (
        SingularityError, 'there is no derivative: closure equations depend on one another there, '
        'or nearly, or points that a spring joins meet', 'a trajectory beside that position')}


class Gradient(NamedTuple):
    """
    Derivatives of a cost by all that a trajectory depends on.

    Attributes
    ----------
    torques : ndarray, shape (rows, number of actuated joints)
        [cost/(N m) or cost/N].
    position : ndarray, shape (n,)
        By the independent coordinates of the start, the others following from the loops, and the
        independent rates held [cost/rad or cost/m].
    velocity : ndarray, shape (n,)
        By the independent rates of the start [cost/(rad/s) or cost/(m/s)].
    parameters : ndarray, shape (np,)
        The independent coordinates and rates of the start held.

    """

    torques: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    parameters: np.ndarray

    def __repr__(self) -> str:
        """Show the shapes."""
        return by_shapes(self, *self._fields)


class Changes(NamedTuple):
    """
    Changes of a trajectory, to first order, in one or more directions.

    Attributes
    ----------
    position : ndarray, shape (instants, nq), or (directions, instants, nq)
        [rad or m].
    velocity : ndarray, shape (instants, nv), or (directions, instants, nv)
        [rad/s or m/s].

    """

    position: np.ndarray
    velocity: np.ndarray

    def __repr__(self) -> str:
        """Show the shapes."""
        return by_shapes(self, *self._fields)


class Sensitivity:
    """
    Makes trajectories of a model by steps of one size, and differentiates them.

    Parameters
    ----------
    model : Model
        It stays as it is.
    method : str, mapping or Method, optional
        As for ``Simulation``: ``semi_implicit_euler``, ``heun`` or ``rk4``, stabilised by
        ``projection``, ``velocity_projection`` or ``none``.
    parameters : sequence of str
        Key paths of numbers of the scene: ``'mechanism.bodies.crank.mass'``, ``'parameters.l'``.
    independent : sequence of str, optional
        Joints whose coordinates and rates are those of the start, as many as there are degrees of
        freedom; where not given, at each start those that move most, actuated ones first.

    Raises
    ------
    SimulationError
        Where an effect has no derivative, or the mechanism is too large, with names and reasons.
    ValueError
        For other methods, with the reason; for names and numbers that do not exist, or that the
        motion does not follow smoothly.

    Notes
    -----
    What is differentiated is the arithmetic of the steps: a step is

        y = s(x, tau, p)    by the method, then    x' = c(y, p)

    with the corrections c that close the loops in the metric of the masses. Forward, changes go
    from step to step, dx' = c_y (s_x dx + s_tau dtau + s_p dp) + c_p dp. In reverse (discrete
    adjoint), weights do: w = (c_y s_x)^T w' + the derivative of the cost by x, and the gradient is
    the sum of (c_y s_tau)^T w' and the like; one pass, however many torques and parameters there
    are. Accelerations and corrections are solutions of linear equations with the factors of an
    evaluation, and are differentiated by these (``codegen.sensitivities``). How often the
    positions are corrected after a step stays as it was.

    Examples
    --------
    >>> sensitivity = Sensitivity(model, {'integrator': 'rk4', 'step_size': 1e-3})
    >>> trajectory = sensitivity.trajectory(state, torques)
    >>> miss = np.zeros_like(trajectory.position)
    >>> miss[-1] = trajectory.position[-1] - goal
    >>> trajectory.gradient(miss).torques

    """

    def __init__(self, model: Model,
                 method: Union[None, str, Mapping[str, Any], Method] = None,
                 parameters: Sequence[str] = (),
                 independent: Optional[Sequence[str]] = None) -> None:
        if not isinstance(model, Model):
            raise TypeError(f'Sensitivity: expected a Model, as Model.from_scene returns it, got '
                            f'{model!r}')
        scene = model.scene if method is None else model.scene.with_method(method)
        require_differentiable(scene.method)
        self.model = model
        self._simulation = simulation = Simulation(model, None, method)
        require_derivatives(simulation.data, along=True)
        self._names, self._asked = simulation.joint_names, places_of(
            simulation.joint_names, independent)
        self._inputs = [self._names.index(name) for name in simulation.actuated_joints]
        self._arrays = parameter_arrays(simulation.data, tuple(parameters))
        self._lock = RLock()
        self._rebind()

    def _rebind(self) -> None:
        """Work with the system that the simulation has now."""
        simulation = self._simulation
        self._system = simulation.data.system
        integrator = INTEGRATORS[simulation.scene.method.integrator]
        self._tableau: Any = integrator.tableau
        self._scratch = allocate_scratch(self._system, self._tableau)
        self._derivatives = StepDerivatives(simulation.data, self._arrays)

    @property
    def parameters(self) -> Tuple[str, ...]:
        """Key paths of the parameters, in their order."""
        return self._arrays.names

    def __repr__(self) -> str:
        """Show the mechanism, the method and the parameters."""
        method = self._simulation.scene.method
        return (f'<Sensitivity of {self.model.mechanism.name}: {method.integrator}, steps of '
                f'{method.step_size:g} s, parameters: {", ".join(self.parameters) or "none"}>')

    def trajectory(self, state: Optional[State] = None, torques: Optional[ArrayLike] = None, *,
                   duration: Optional[float] = None, steps: Optional[int] = None,
                   every: int = 1) -> 'Trajectory':
        """
        Make a trajectory, the same as ``rollout`` makes, step by step.

        Parameters
        ----------
        state : State, optional
            A single one, where it begins; the scene's start when not given. The time of the
            results counts from there.
        torques : array_like, shape (rows, number of actuated joints)
            [N m or N]; each row acts for an equal share of the steps. None when not given.
        duration, steps, every
            As for ``Simulation.rollout``.

        Returns
        -------
        Trajectory

        Raises
        ------
        AssemblyError
            Where the state leaves the loops open.
        NumericalError, ClosureError, SingularityError
            Where it cannot be made, with the time.
        ValueError
            For arguments that make no sense.

        Notes
        -----
        The energy balance, by which ``rollout`` judges its runs, is not drawn here.

        """
        with self._lock:
            state, given, schedule = self._begun(state, torques, duration, steps, every)
            if given.ndim > 2:
                raise ValueError('torques: expected those of one trajectory, shape (rows, '
                                 f'{given.shape[-1]}), got {given.shape}; `trajectories` '
                                 'takes those of many')
            if state.is_batch:
                raise ValueError(f'state: expected a single one, got a batch of {len(state)}; '
                                 '`trajectories` takes it')
            return self._made(state, schedule, all_torques(self._simulation, given))

    def trajectories(self, state: Optional[State] = None, torques: Optional[ArrayLike] = None, *,
                     duration: Optional[float] = None, steps: Optional[int] = None,
                     every: int = 1) -> 'Trajectories':
        """
        Make many trajectories, each as ``trajectory`` does.

        Parameters
        ----------
        state : State, optional
            A batch of where they begin, or one for all; the scene's start when not given.
        torques : array_like, shape (n, rows, number of actuated joints), or without n
            [N m or N]; of each trajectory, or those of all. None when not given.
        duration, steps, every
            As for ``Simulation.rollout``.

        Returns
        -------
        Trajectories
            As many as there are states, or rows of torques. Where no ``independent`` coordinates
            were asked for, they are those of the first one for all.

        Raises
        ------
        AssemblyError, NumericalError, ClosureError, SingularityError
            As of ``trajectory``, for the first that cannot be made, with its number.
        ValueError
            For arguments that make no sense, such as neither states nor torques of many.

        """
        with self._lock:
            state, given, schedule = self._begun(state, torques, duration, steps, every)
            counts = {*([len(state)] if state.is_batch else []), *given.shape[:-2]}
            if len(counts) != 1:
                raise ValueError(
                    'expected a batch of states, or torques with a leading axis, of one length, '
                    f'got {len(state) if state.is_batch else "a single"} state(s), and torques of '
                    f'shape {given.shape}')
            count = counts.pop()
            made: List[Trajectory] = []
            torque = np.broadcast_to(
                all_torques(self._simulation, given),
                (count, given.shape[-2], len(self._simulation.torque_names)))
            for number in range(count):
                try:
                    made.append(self._made(state[number] if state.is_batch else state, schedule,
                                           torque[number].copy(), made[0] if made else None))
                except SimulationError as error:
                    raise type(error)(f'trajectory {number}: {error}') from None
            return Trajectories(made)

    def _begun(self, state: Optional[State], torques: Optional[ArrayLike],
               duration: Optional[float], steps: Optional[int],
               every: int) -> Tuple[State, np.ndarray, TimeGrid]:
        """Return a start, torques and instants, checked but for numbers of trajectories."""
        simulation = self._simulation
        given = RolloutArguments(simulation, torques, None, None, None)
        schedule = scheduled(simulation.step_size, given.rows, duration, steps, every)
        if state is None:
            return self.model.assemble(), given.torques, schedule
        simulation.data.require_state(state)
        if not begins(self.model, state):
            raise ValueError('state: expected one in which the effects begin again, as '
                             'Model.assemble returns it, got one in which they have gone on')
        return state, given.torques, schedule

    def _made(self, state: State, schedule: TimeGrid, torque: np.ndarray,
              like: 'Optional[Trajectory]' = None) -> 'Trajectory':
        """Make a trajectory; ``like``: one whose independent coordinates are those of this."""
        simulation = self._simulation
        # A start is tried by a step, which the torques of the last trajectory have no part in.
        simulation.data.system.tau[:] = 0.0
        simulation.stepping.begin_at(state)
        if simulation.data.system is not self._system:
            self._rebind()
        system = self._system
        stabilisation = STABILISATIONS[simulation.scene.method.stabilisation]
        run = SteppedRun(self._tableau, stabilisation, simulation.step_size,
                         schedule.zero_order_hold, schedule.decimation, torque)
        tape = allocate_tape(system, self._tableau, schedule.intervals)
        tape.state[0] = simulation.data.integrated
        _require_done(system.native.record_steps(run, self._scratch, tape),
                      simulation.step_size)
        nq, nv = simulation.coordinates.nq, simulation.coordinates.nv
        states = tape.state[::schedule.decimation]
        time = schedule.interval * (schedule.decimation * np.arange(schedule.instants))
        return Trajectory(
            sealed(time), frozen(states[:, :nq]), frozen(states[:, nq:nq + nv]),
            _Record(self, system, self._derivatives, run, tape, like))

    def _start_map(self, record: '_Record') -> Tuple[Tuple[str, ...], np.ndarray]:
        """
        Return the independent coordinates, and the derivatives of the start.

        Returns
        -------
        names : tuple of str
        matrix : ndarray, shape (nq + nv, 2 n + np)
            Derivatives of coordinates and rates by the independent coordinates, by the independent
            rates, and by parameters.

        """
        nq, nv = self._simulation.coordinates.nq, self._simulation.coordinates.nv
        q, qd = (part.copy() for part in np.split(record.tape.state[0, :nq + nv], [nq]))
        jac, bending, by_parameter, rate_by_parameter = record.derivatives.closures(q, qd)
        own = self._asked
        if own is None:
            own = choose_independent(jac, self._inputs) if record.like is None else places_of(
                self._names, record.like.independent)
        try:
            rest = dependent_on(jac, own, self._names)
        except ValueError:
            if self._asked is not None:
                raise
            raise SingularityError(
                'At the start there is no derivative: closure equations depend on one another '
                'there, or nearly. Take a start beside it.') from None
        along, bent = changes_along(jac, own, rest, bending)
        moved = following(jac, rest, by_parameter)
        rates = following(jac, rest, bending @ moved + rate_by_parameter)
        manifold = self._system.manifold
        return tuple(self._names[place] for place in own), np.block([
            [turned(manifold, q, along), np.zeros((nq, len(own))), turned(manifold, q, moved)],
            [bent, along, rates]])

    def _gradient(self, record: '_Record', weights: np.ndarray) -> Gradient:
        with self._lock:
            derivatives = record.derivatives
            derivatives.need(REVERSE)
            nx, nv = weights.shape[1], self._simulation.coordinates.nv
            found = RunInputs(np.zeros(nx), np.zeros((len(record.run.torque), nv)),
                              np.zeros(len(self._arrays.entries)))
            _require_done(record.system.native.gradient_of_steps(
                record.run, self._scratch, record.tape, derivatives.routines, weights, found),
                record.run.step_size)
            names, matrix = record.start_map
        n = len(names)
        by_start = found.start @ matrix
        return Gradient(*map(frozen, (
            found.torque[:, self._inputs], by_start[:n], by_start[n:2 * n],
            by_start[2 * n:] + found.parameter @ self._arrays.matrix)))

    def _changes(self, record: '_Record', torques: np.ndarray, start: np.ndarray,
                 parameters: np.ndarray, out: np.ndarray) -> None:
        """Follow directions, one after the other."""
        with self._lock:
            derivatives = record.derivatives
            derivatives.need(FORWARD)
            _, matrix = record.start_map
            for direction in range(len(out)):
                torque = np.zeros((len(record.run.torque), self._simulation.coordinates.nv))
                torque[:, self._inputs] = torques[direction]
                change = RunInputs(
                    matrix @ np.concatenate((start[direction], parameters[direction])), torque,
                    self._arrays.matrix @ parameters[direction])
                _require_done(record.system.native.change_of_steps(
                    record.run, self._scratch, record.tape, derivatives.routines, change,
                    out[direction]), record.run.step_size)


class _Record:
    """Data of a trajectory for its derivatives."""

    def __init__(self, owner: Sensitivity, system: Any, derivatives: StepDerivatives,
                 run: SteppedRun, tape: Any, like: 'Optional[Trajectory]') -> None:
        self.owner, self.system, self.derivatives = owner, system, derivatives
        self.run, self.tape, self.like = run, tape, like
        self._start_map: Optional[Tuple[Tuple[str, ...], np.ndarray]] = None

    @property
    def start_map(self) -> Tuple[Tuple[str, ...], np.ndarray]:
        """Return the result of ``Sensitivity._start_map``, computed once."""
        if self._start_map is None:
            self._start_map = self.owner._start_map(self)
        return self._start_map


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    A motion by steps of one size, with its derivatives; it never changes.

    Attributes
    ----------
    time : ndarray, shape (instants,)
        [s]; the first instant is the start.
    position : ndarray, shape (instants, nq)
        Joint coordinates [rad or m].
    velocity : ndarray, shape (instants, nv)
        Joint rates [rad/s or m/s].

    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    _record: _Record

    def __repr__(self) -> str:
        """Show the shapes."""
        return by_shapes(self, 'time', 'position', 'velocity')

    @property
    def independent(self) -> Tuple[str, ...]:
        """Joints whose coordinates and rates are those of the start, in their order."""
        with self._record.owner._lock:
            return self._record.start_map[0]

    def gradient(self, by_position: Optional[ArrayLike] = None,
                 by_velocity: Optional[ArrayLike] = None) -> Gradient:
        """
        Return the derivatives of a cost by all that the trajectory depends on, in reverse.

        Parameters
        ----------
        by_position : array_like, shape (instants, nq), optional
            Derivatives of the cost by ``position``; none when not given.
        by_velocity : array_like, shape (instants, nv), optional
            By ``velocity``.

        Returns
        -------
        Gradient

        Raises
        ------
        SingularityError
            Where there is no derivative, with the time.
        ValueError
            For other shapes, and numbers that are not finite.

        """
        weights = np.hstack([
            _shaped(name, given, like.shape) for name, given, like in (
                ('by_position', by_position, self.position),
                ('by_velocity', by_velocity, self.velocity))])
        return self._record.owner._gradient(self._record, weights)

    def changes(self, torques: Optional[ArrayLike] = None, position: Optional[ArrayLike] = None,
                velocity: Optional[ArrayLike] = None,
                parameters: Optional[ArrayLike] = None) -> Changes:
        """
        Return the first-order changes of the trajectory in one or more directions.

        Parameters
        ----------
        torques : array_like, shape (rows, number of actuated joints), optional
            Changes of the torques [N m or N]; none where not given, as for the others. For more
            directions each of them has a leading axis.
        position, velocity : array_like, shape (n,), optional
            Of the independent coordinates and rates of the start.
        parameters : array_like, shape (np,), optional
            Of the parameters, the independent coordinates and rates of the start held.

        Returns
        -------
        Changes

        Raises
        ------
        SingularityError
            Where there is no derivative, with the time.
        ValueError
            For other shapes, and numbers that are not finite.

        """
        owner, n = self._record.owner, len(self.independent)
        shapes = {'torques': (len(self._record.run.torque), len(owner._inputs)),
                  'position': (n,), 'velocity': (n,), 'parameters': (len(owner.parameters),)}
        given: Dict[str, Any] = {'torques': torques, 'position': position, 'velocity': velocity,
                                 'parameters': parameters}
        batch = next((np.shape(value)[:1] for name, value in given.items()
                      if np.ndim(value) == len(shapes[name]) + 1), ())
        arrays = {name: _shaped(name, value, (*batch, *shapes[name]))
                  for name, value in given.items()}
        rows = {name: array if batch else array[np.newaxis] for name, array in arrays.items()}
        nq = self.position.shape[1]
        out = np.zeros((batch[0] if batch else 1, len(self.time), nq + self.velocity.shape[1]))
        owner._changes(self._record, rows['torques'],
                       np.hstack((rows['position'], rows['velocity'])), rows['parameters'], out)
        whole = out if batch else out[0]
        return Changes(frozen(whole[..., :nq]), frozen(whole[..., nq:]))


class Trajectories(Sequence[Trajectory]):
    """
    Motions from many starts, or under many torques, with their derivatives; they never change.

    A sequence of them, each a ``Trajectory``.

    Attributes
    ----------
    time : ndarray, shape (instants,)
    position, velocity : ndarray, shape (n, instants, nq), (n, instants, nv)
        As of ``Trajectory``.
    independent : tuple of str
        Joints whose coordinates and rates are those of the starts, in their order.

    """

    def __init__(self, each: Sequence[Trajectory]) -> None:
        self._each = tuple(each)
        self.time = each[0].time
        self.position, self.velocity = (
            frozen(np.stack([getattr(one, name) for one in each]))
            for name in ('position', 'velocity'))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._each)

    def __getitem__(self, number: Any) -> Any:
        """Return one of them, or a tuple for a slice."""
        return self._each[number]

    def __repr__(self) -> str:
        """Show the shapes."""
        return by_shapes(self, 'time', 'position', 'velocity')

    @property
    def independent(self) -> Tuple[str, ...]:
        """Joints whose coordinates and rates are those of the starts, in their order."""
        return self._each[0].independent

    def gradient(self, by_position: Optional[ArrayLike] = None,
                 by_velocity: Optional[ArrayLike] = None) -> Gradient:
        """
        Return the derivatives of a cost of each trajectory, as ``Trajectory.gradient`` does.

        All arguments and results have a leading axis of n.
        """
        return Gradient(*self._of_each(
            'gradient', {'by_position': by_position, 'by_velocity': by_velocity}))

    def changes(self, torques: Optional[ArrayLike] = None, position: Optional[ArrayLike] = None,
                velocity: Optional[ArrayLike] = None,
                parameters: Optional[ArrayLike] = None) -> Changes:
        """
        Return the first-order changes of each trajectory, as ``Trajectory.changes`` does.

        All arguments and results have a leading axis of n, before that of directions.
        """
        return Changes(*self._of_each('changes', {
            'torques': torques, 'position': position, 'velocity': velocity,
            'parameters': parameters}))

    def _of_each(self, name: str, given: Dict[str, Optional[ArrayLike]]) -> Any:
        """Return the results of a method of each, stacked."""
        arrays = {key: reals(key, value) for key, value in given.items() if value is not None}
        for key, array in arrays.items():
            if array.shape[:1] != (len(self),):
                raise ValueError(f'{key}: expected a leading axis of {len(self)} trajectories, '
                                 f'got shape {array.shape}')
        found = [getattr(one, name)(**{key: array[number] for key, array in arrays.items()})
                 for number, one in enumerate(self._each)]
        return (frozen(np.stack(parts)) for parts in zip(*found))


def _shaped(name: str, given: Optional[ArrayLike], shape: Tuple[int, ...]) -> np.ndarray:
    """Return finite numbers of a shape, zeros for none."""
    if given is None:
        return np.zeros(shape)
    array = reals(name, given)
    if array.shape != shape:
        raise ValueError(f'{name}: expected shape {shape}, got {array.shape}')
    if not np.isfinite(array).all():
        raise ValueError(f'{name}: expected finite numbers, got others among them')
    return array


def require_differentiable(method: Method) -> None:
    """Refuse methods whose steps are not smooth functions of the state."""
    require_no_budget(method, 'a trajectory with derivatives')
    integrator = INTEGRATORS[method.integrator]
    if method.integrator not in _METHODS:
        reason = ('its step sizes depend on error estimates, and jump'
                  if integrator.kind != FIXED else
                  'its steps use derivatives, so that second derivatives would be needed')
        raise FieldError(f'{among(_METHODS)}, with derivatives', f'{method.integrator}: {reason}',
                         '', ('method', 'integrator'))
    if method.stabilisation not in _STABILISATIONS:
        reason = ('the coordinates that it integrates are exchanged in a motion'
                  if method.stabilisation == 'independent' else
                  'its correction of the accelerations has no derivative here')
        raise FieldError(f'{among(_STABILISATIONS)}, with derivatives',
                         f'{method.stabilisation}: {reason}', '', ('method', 'stabilisation'))


def _require_done(ended: Tuple[int, int], step_size: float) -> None:
    """Refuse a run that was not computed to its end."""
    status, step = ended
    if status == DONE:
        return
    if status == INTERRUPTED:
        # Another thread was.
        raise KeyboardInterrupt
    kind, what, remedy = _ENDS.get(status, (SimulationError, 'it ended', 'a smaller step'))
    raise kind(f'In the step from {step * step_size:g} s on {what}. Take {remedy}.')
