# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene brought to life: the Python interface that users script with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Callable, Dict, Optional, Sequence, Tuple, Type, Union
import warnings

import numpy as np
from numpy.typing import ArrayLike

from .data import Numbers
from .evaluation import Evaluation
from .evaluator import Evaluator
from .health import Health
from .model import Model
from .monitor import RunReport
from .readings import Readings
from .rollout import Rollout, rollout
from .stepping import Stepping
from ..effects.effect import Effect
from ..effects.energy_balance import Energies
from ..kinematics.motions import moving
from ..kinematics.state import State
from ..mechanism.mechanism import Mechanism
from ..mechanism.named_array import NamedArray
from ..scene.loading import load_scene
from ..scene.records import Method, Scene

# Names of the run; the others that are passed on are those of the readings.
_OF_RUN = ('accuracy', 'judge', 'step_size')


class Simulation:
    """
    A mechanism in motion: a state, and the method that advances it.

    Parameters
    ----------
    model : model.Model or scene_records.Scene
        The system to simulate; the simulation works on data of its own.
    state : state.State, optional
        Where it begins, and where ``reset`` leads back to, to the last bit; one that closes the
        loops, as ``Model.assemble`` returns it. When not given the scene's start, assembled.
    method : str, mapping or Method, optional
        In the place of the scene's: an integrator's name, or what changes by the keys that a
        scene has under ``method``.

    Attributes
    ----------
    data : readings.Readings
        All that follows from the present state; quantities that are documented are attributes of
        the simulation, too: ``acceleration``, ``constraint_forces``, ``energy``, ``health``, ...
    stepping : stepping.Stepping
        The run that advances the state.
    coordinates : mechanism.coordinates.Coordinates
        Names and places of the numbers of positions and velocities.
    joint_names : tuple of str
        In the order of velocities and torques.
    actuated_joints : tuple of str
        In the order of torque sequences.

    Raises
    ------
    AssemblyError
        Where the loops cannot be closed from the scene's initial state, or ``state`` leaves them
        open.
    ValueError
        For a state of another mechanism, or a batch of states, and for an impossible method.

    Notes
    -----
    A simulation serves one thread at a time; where a second one computes with it meanwhile,
    RuntimeError is raised there.

    """

    # Quantities of the readings and of the run.
    acceleration: np.ndarray
    accuracy: float
    body_poses: np.ndarray
    closed: Callable[..., Tuple[np.ndarray, np.ndarray]]
    closure: float
    constraint_forces: np.ndarray
    constraint_jacobian: np.ndarray
    coupling_forces: np.ndarray
    cut_acceleration: np.ndarray
    cut_effort: np.ndarray
    cut_joint_names: Tuple[str, ...]
    cut_position: np.ndarray
    cut_velocity: np.ndarray
    effect_readings: Callable[[str], Dict[str, float]]
    effort: np.ndarray
    energy: float
    evaluation: Callable[[], Evaluation]
    evaluator: Callable[..., Evaluator]
    force: Callable[[str], np.ndarray]
    health: Health
    inertia: np.ndarray
    joint_torques: Callable[[Optional[Numbers]], np.ndarray]
    judge: Callable[[], None]
    measured: Callable[[], Tuple[np.ndarray, np.ndarray]]
    motion_forces: Dict[str, float]
    multipliers: np.ndarray
    point: Callable[[str], np.ndarray]
    step_size: float
    tooth_forces: np.ndarray
    torque_names: Tuple[str, ...]
    windings: Callable[[], Dict[Tuple[str, str], float]]

    def __init__(self, model: Union[Model, Scene], state: Optional[State] = None,
                 method: Union[None, str, Mapping[str, Any], Method] = None) -> None:
        if not isinstance(model, (Model, Scene)):
            raise TypeError(f'Simulation: expected a Model or a Scene, got {model!r}; '
                            'Simulation.from_scene takes names and paths')
        scene = model if isinstance(model, Scene) else model.scene
        self._build(scene if method is None else scene.with_method(method), state)
        if state is not None:
            self.data.require_state(state)
            if state.is_batch:
                raise ValueError(f'state: expected a single one, got a batch of q {state.q.shape}')
        self.reset()

    def __repr__(self) -> str:
        """Show the mechanism, the time and the method."""
        method = self.scene.method
        return (f'<Simulation of {self.scene.name} at t = {self.time:.9g} s: {method.integrator}, '
                f'steps of {self.stepping.step_size:g} s, actuated: '
                f'{", ".join(self.actuated_joints) or "nothing"}>')

    def _build(self, scene: Scene, start: Optional[State]) -> None:
        """Build data and run of a scene."""
        self._start, self.data = start, Readings(scene)
        data = self.data
        self.stepping = stepping = Stepping(data)
        self.coordinates, self.joint_names, self.actuated_joints = (
            data.coordinates, data.joint_names, data.actuated_joints)
        self._q, self._qd, self._effects, self._run = (
            data.q, data.qd, data.effect_set, stepping.run)
        # What is called again and again, without another call in between.
        for name, owner in (('step', stepping), ('advance', stepping),
                            ('forward_dynamics', data), ('inverse_dynamics', data)):
            setattr(self, name, getattr(owner, name))

    def __reduce__(self) -> Tuple[Any, ...]:
        """Pickle as the scene with effects, equations and method as they are, and the state."""
        return _unpickled, (type(self), self.data.scene, self._start, self.stepping.description())

    def __copy__(self) -> 'Simulation':
        """Return another simulation that goes on from here in the same way, to the last bit."""
        made = _unpickled(type(self), self.data.scene, self._start, self.stepping.description())
        made.stepping.take(self.stepping)
        return made

    def __deepcopy__(self, memo: Dict[int, Any]) -> 'Simulation':
        """As ``copy``: copies share nothing that changes."""
        return self.__copy__()

    @classmethod
    def from_scene(
            cls, scene: Union[str, Path, Scene],
            motion: Optional[Mapping[str, Any]] = None, **method: Any) -> 'Simulation':
        """
        Build a simulation from a scene.

        Parameters
        ----------
        scene : str, pathlib.Path or scene.Scene
            A shipped scene's name, a scene file's path, or what was read already.
        motion : mapping of str to str or PrescribedMotion, optional
            Motions that are prescribed beside what the scene does: by joint, an expression in the
            time ``t`` [rad; m], or an effect.
        **method
            Overrides of the scene's method, by the keys a scene has there (``integrator``,
            ``step_size``, ``stabilisation``, ...); None leaves the scene's.

        Returns
        -------
        Simulation

        Raises
        ------
        SceneError, AssemblyError
        ValueError
            For an override that no scene could have there.

        Warns
        -----
        RuntimeWarning
            Where the start that was assembled may not be the one that was meant.

        """
        if not isinstance(scene, Scene):
            scene = load_scene(scene)
        simulation = cls(moving(scene, motion or {}), None, method)
        for note in simulation.data.start_notes():
            warnings.warn(note, RuntimeWarning, stacklevel=2)
        return simulation

    def __getattr__(self, name: str) -> Any:
        """Return a documented quantity of the readings, or of the run."""
        if name not in Simulation.__annotations__:
            raise AttributeError(f'{type(self).__name__!r} object has no attribute {name!r}')
        return getattr(self.stepping if name in _OF_RUN else self.data, name)

    @property
    def scene(self) -> Scene:
        """Return the scene, with the present method."""
        return self.data.scene

    @property
    def mechanism(self) -> Mechanism:
        """Return the mechanism, with the equations of the motions that the scene prescribes."""
        return self.data.mechanism

    @property
    def time(self) -> float:
        """Time since the start or the last reset [s]."""
        return self._run.time()

    @property
    def position(self) -> np.ndarray:
        """Joint coordinates, shape (nq,) [rad or m]: see ``Readings.position``."""
        return self._q.copy()

    @property
    def velocity(self) -> np.ndarray:
        """Joint rates, shape (nv,) [rad/s or m/s]: see ``Readings.velocity``."""
        return self._qd.copy()

    @property
    def points(self) -> np.ndarray:
        """Places of all named points, shape (number of points, 2), in space 3 [m]."""
        return self.data.points

    @property
    def joint_forces(self) -> NamedArray:
        """Wrenches by joint, as of ``Readings``, shape (nv, 3); in space (joints, 6)."""
        return self.data.named('joint_forces', self.data.joint_forces)

    @property
    def state(self) -> np.ndarray:
        """
        Whole state: joint coordinates, joint rates, the effects' own states, the method's memory.

        A run that is started from it by ``restore`` goes on in the same way to the last bit, with
        error control from where a command changes.
        """
        return self._run.whole

    def snapshot(self) -> State:
        """Return the present state; torques and the memory of a method are not part of it."""
        return self.data.snapshot()

    @property
    def energy_balance(self) -> Energies:
        """Energy balance since the last reset, an ``effects.energy_balance.Energies`` [J]."""
        return Energies(**self._run.balance())

    def step(self, torque: Optional[Numbers] = None, duration: Optional[float] = None) -> None:
        """
        Advance by ``duration`` under constant torques.

        Parameters
        ----------
        torque : mapping, sequence or None
            Joint torques [N m or N]: by joint name, or for all actuated joints in their
            order; joints that are not named get none.
        duration : float, optional
            [s]; one step when not given. Covered by whole steps, and one shorter step at the
            end where it is not a multiple of the step size.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.
        ValueError
            For a torque or duration that makes no sense.

        """
        self.stepping.step(torque, duration)

    def advance(self, tau: np.ndarray, steps: int) -> None:
        """
        Advance by whole steps under constant joint torques; the fast path of ``step``.

        Parameters
        ----------
        tau : ndarray, shape (number of actuated joints,) or (number of ``torque_names``,)
            Joint torques [N m or N], finite: of the actuated joints in their order, as for
            ``step``, or, which is faster, of all ``torque_names``.
        steps : int
            Number of steps.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.
        ValueError
            For torques of other shapes, that are not real or not finite, and for steps that are no
            whole number >= 0.

        """
        self.stepping.advance(tau, steps)

    def restore(self, state: ArrayLike, time: float) -> None:
        """
        Restore a state of another run of the same scene, bit for bit; torques stay.

        Parameters
        ----------
        state : sequence
            From ``state``; not assembled.
        time : float
            Of that state [s].

        Raises
        ------
        ValueError
            Where it is not a state of this scene.

        """
        self.stepping.restore(state, time)

    def forward_dynamics(
            self, position: ArrayLike, velocity: ArrayLike,
            torque: Optional[Numbers] = None) -> Tuple[np.ndarray, np.ndarray]:
        """Compute accelerations and multipliers of a state: see ``Readings.forward_dynamics``."""
        return self.data.forward_dynamics(position, velocity, torque)

    def inverse_dynamics(
            self, position: ArrayLike, velocity: ArrayLike,
            acceleration: ArrayLike) -> Tuple[np.ndarray, np.ndarray]:
        """Compute torques and multipliers of a motion: see ``Readings.inverse_dynamics``."""
        return self.data.inverse_dynamics(position, velocity, acceleration)

    def vary(self, scene: Scene) -> bool:
        """As ``Data.vary``: become a simulation of another scene."""
        if not self.data.vary(scene):
            return False
        self.stepping.adopt_effects()
        self.reset()
        return True

    def reset(self) -> None:
        """Return to the initial state, time zero and no torque."""
        self.stepping.reset()
        if self._start is not None:
            self.stepping.begin_at(self._start)
        self.stepping.begin()

    def set_state(
            self, position: Numbers, velocity: Optional[Numbers] = None,
            hold: Optional[Sequence[str]] = None) -> None:
        """
        Move to another state, assembled.

        Parameters
        ----------
        position : mapping, or sequence of shape (nq,)
            Approximate joint coordinates [rad or m]; in a mapping by joint name, those of the
            joints that are not named stay as they are. Of spherical and free joints as a scene
            has them: ``{'ball': {'orientation': {'rpy': (0.0, 0.0, 1.0)}}}``.
        velocity : mapping, or sequence of shape (nv,), optional
            Approximate joint rates [rad/s or m/s], likewise; zero when not given.
        hold : sequence of str, optional
            Joints kept as given; none when not given: the nearest closed state is taken. They must
            be as many as there are degrees of freedom, but for mechanisms with spherical or free
            joints in the tree.

        Raises
        ------
        AssemblyError
            Where no such state closes the loops, or not even a step can be made from it; the
            present state is kept.
        ValueError
            Where it is not a state: other numbers, names, or a quaternion of another norm.

        """
        self.stepping.set_state(position, velocity, hold)

    def report(self) -> RunReport:
        """
        Return cost and estimated error of the run since the start or the last reset.

        Returns
        -------
        monitor.RunReport

        """
        return self.stepping.report()

    def rollout(
            self, torques: Optional[ArrayLike] = None,
            initial_position: Optional[ArrayLike] = None,
            initial_velocity: Optional[ArrayLike] = None, *,
            hold: Optional[Sequence[str]] = None, duration: Optional[float] = None,
            steps: Optional[int] = None, every: int = 1,
            parameters: Optional[Mapping[str, ArrayLike]] = None,
            quantities: Sequence[str] = ('position', 'velocity'),
            threads: Optional[int] = None) -> Rollout:
        """
        Run many simulations of this scene from its start, in parallel.

        The start is the scene's, also where this simulation began in a ``State``; the function
        ``rollout`` of a model begins in states. This simulation stays as it is. Every result is
        the same, bit for bit, as that of a simulation of its own that is advanced by ``step``,
        whatever the number of threads.

        Parameters
        ----------
        torques : array_like, shape (samples, rows, number of actuated joints)
            Torques of the actuated joints [N m or N], one row after the other, each for the
            same number of steps. Without the first axis for all samples; a single row stays
            for the whole run; none when not given.
        initial_position : array_like, shape (samples, nq) or (nq,)
            To start from instead of the scene's start, as for ``set_state``.
        initial_velocity : array_like, shape (samples, nv) or (nv,)
            Likewise.
        hold : sequence of str, optional
            As for ``set_state``; those of the scene where only velocities are given.
        duration, steps : float, int
            Length of a run [s], or in steps; one step a row when neither is given.
        every : int
            Steps from one instant of the results to the next.
        parameters : mapping of str to array_like, shape (samples,)
            Numbers of the scene by key path, such as ``'mechanism.bodies.crank.mass'``,
            ``'effects.gravity.acceleration.1'``, ``'initial.position.crank_joint'``.
        quantities : sequence of str
            Quantities to return: names of the fields of ``rollout.Rollout``.
        threads : int, optional
            As many as there are processors, when not given.

        Returns
        -------
        rollout.Rollout
            A sample that fails is listed in ``failures``; its numbers are NaN from then on.
            One whose energy balance misses more than a thousandth of what moved is listed
            there, too, with its numbers kept.

        Raises
        ------
        ValueError
            For arguments that make no sense, whatever the sample.

        """
        return rollout(
            self, torques, initial_position, initial_velocity, hold=hold, duration=duration,
            steps=steps, every=every, parameters=parameters, quantities=quantities,
            threads=threads)

    @property
    def effects(self) -> Dict[str, Effect]:
        """Return the listed effects, with their present parameters: records by name."""
        return dict(self._effects.records)

    def set_effect(
            self, name: str, enabled: Optional[bool] = None,
            **parameters: Any) -> None:
        """
        Switch an effect on or off, or change its parameters, from the next step on.

        Parameters
        ----------
        name : str
            Of an effect that the scene lists.
        enabled : bool, optional
            As it is, when not given.
        **parameters
            New values by the effect's keys.

        Raises
        ------
        ValueError
            Where a name or value makes no sense; nothing is changed.
        StiffnessError
            Where the steps would be too large for it in the present state; nothing is changed.

        Notes
        -----
        An energy that appears or vanishes with the change (a spring that is switched on
        stretched) is not booked as work: the energy balance goes on from the new energy.

        """
        self.stepping.set_effect(name, enabled, **parameters)

    def command_motion(self, commands: Mapping[str, Tuple[Any, ...]]) -> None:
        """
        Continue commanded motions through other points, from the present state.

        Parameters
        ----------
        commands : mapping of str to tuple
            By name of ``commanded_motions``: times [s], from ``time`` on, and positions
            [rad; m] of the points, optional rates, and beside these optional accelerations.
            Motions that are not named go on as before.

        Raises
        ------
        ValueError
            For what no motion can follow: unknown names, times in the past, numbers that are not
            finite, jumps of position or rate; nothing is changed.

        """
        self.stepping.command_motion(commands)


def _unpickled(made_of: Type[Simulation], scene: Scene, start: Optional[State],
               description: Dict[str, Any]) -> Simulation:
    """Return a simulation of a scene, as ``Stepping.description`` describes it."""
    made = made_of.__new__(made_of)
    made._build(scene, start)
    made.stepping.revive(**description)
    return made
