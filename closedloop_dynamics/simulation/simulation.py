# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene brought to life: the Python interface that users script with."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
import math
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union
import warnings

import numpy as np
from numpy.typing import ArrayLike

from .assembly import angle_notes, degree_notes, MOST_EQUATIONS
from .data import Numbers
from .errors import AssemblyError, ClosureError, StiffnessError
from .guards import LARGEST_MOTION, StiffnessGuard
from .model import Model
from .monitor import Monitor, RunReport
from .motions import moving
from .rollout import Rollout, rollout
from .scene import load_scene
from .scene_records import Method, Scene
from .state import State
from .stepping import Stepping
from ..core import types as t
from ..effects.delay_line import DelayLine
from ..effects.effect import Effect
from ..engine import native
from ..integration.control import (
    CONTACT_PASSED, DONE, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, TOO_MUCH_WORK)
from ..integration.system import with_equations, with_partition
from ..mechanism.digits import suspicions
from ..mechanism.fields import at, FieldError

# Gravity's acceleration, to compare forces with weights [m/s^2].
EARTH = 9.81


class Simulation(Stepping):
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
    scene : scene_records.Scene
        With the present method.
    mechanism : mechanism.mechanism.Mechanism
    decomposition : mechanism.decomposition.Decomposition
    coordinates : mechanism.coordinates.Coordinates
        Names and places of the numbers of positions and velocities.
    acts_in_cuts : bool
        Whether anything acts along the coordinates of cut joints.
    exchanges : int
        How often the equations that the elimination works on were exchanged.
    pace : float
        Simulated seconds per second of the clock, by which a budget counts; 1 when not set.

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
    RuntimeError is raised there. It cannot be copied: another one of the same scene takes over a
    ``state`` by ``restore``.

    """

    def __init__(self, model: Union[Model, Scene], state: Optional[State] = None,
                 method: Union[None, str, Mapping[str, Any], Method] = None) -> None:
        if not isinstance(model, (Model, Scene)):
            raise TypeError(f'Simulation: expected a Model or a Scene, got {model!r}; '
                            'Simulation.from_scene takes names and paths')
        scene = model if isinstance(model, Scene) else model.scene
        super().__init__(scene if method is None else scene.with_method(method))
        self._start = state
        if state is not None:
            self.require_state(state)
            if state.is_batch:
                raise ValueError(f'state: expected a single one, got a batch of q {state.q.shape}')
        self.reset()

    def __repr__(self) -> str:
        """Show the mechanism, the time and the method."""
        method = self.scene.method
        return (f'<Simulation of {self.scene.name} at t = {self.time:.9g} s: {method.integrator}, '
                f'steps of {self.step_size:g} s, actuated: '
                f'{", ".join(self.actuated_joints) or "nothing"}>')

    def vary(self, scene: Scene) -> bool:
        """As ``Data.vary``: become a simulation of another scene."""
        if not super().vary(scene):
            return False
        if self._derivatives is not None:
            self._derivatives.enable_for(self)
        # By whose weight the guards measure.
        self._set_run()
        self.reset()
        return True

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
        for note in simulation.start_notes():
            warnings.warn(note, RuntimeWarning, stacklevel=2)
        return simulation

    def start_notes(self) -> List[str]:
        """
        Return notes of the start: its ``assembly_notes``, digits, angles beyond 2 pi, effects.

        Returns
        -------
        list of str

        """
        weight = EARTH * sum(body.mass for body in self.mechanism.bodies)
        effects = [note for name, record in self.scene.effects.items() for note in
                   record.start_notes(name, partial(self.effect_readings, name), weight)]
        held = self.second_order.notes() if self.second_order is not None else []
        angles = angle_notes(self.mechanism, self.scene.initial.position)
        # Some of those angles are noted where the start was assembled, too.
        known = (*angles, *degree_notes(self.mechanism, self.scene.initial.position))
        return ([*self.mechanism.rounded, *self._suspicions()] + angles + held
                + self._motions.notes()
                + [note for note in self.assembly_notes() if note not in known]
                + effects + self.load_notes())

    def _suspicions(self) -> List[str]:
        """Return notes on rounded digits where equations that repeat others depend on these."""
        found, coordinates = suspicions(self.mechanism), self.mechanism.coordinates
        if found and self._assembler.nc <= MOST_EQUATIONS:
            freedoms = self.degrees_of_freedom()
            if freedoms and coordinates.nv - freedoms == self._assembler.nc:
                return []
        return found

    def reset(self) -> None:
        """Return to the initial state, time zero and no torque."""
        native.require_free(self.system.native)
        if self.exchanges:
            self.exchange(self._geometry.as_at_first() if self._may_leave_out(self.scene.method)
                          else self._geometry.select(None))
        self.exchanges = 0
        self._run.set_time(0.0, 0)
        if self._motions:
            for name, record in self._motions.forget_commands(self.scene.effects).items():
                self._effects.put(name, record, True)
            # They may have been changed since.
            initial = self.scene.initial
            self._initial = self._assembled(initial.position, initial.velocity, initial.hold)
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._run.rewind()
        native.forget(self.system)
        self._monitor.clear()
        self._effects.restart()
        self._delay_line = DelayLine()
        self.system.tau[:] = 0.0
        self._fresh = False
        health = self.system.work.health
        health[:] = 0.0
        health[t.SMALLEST_PIVOT] = health[t.SMALLEST_PIVOT_EVER] = 1.0
        self.system.passage[:] = 0.0
        self._begin_loads()
        if self.system.manifold is not None:
            self._state[-1] = 0.0
        self._run.begin()
        if self._start is not None:
            self.begin_at(self._start)
        self._stiffness.check(self._state, self.step_size)
        self._set_budget(self.scene.method)

    def begin_at(self, state: State) -> None:
        """
        Go to a state that was given, after a reset.

        Parameters
        ----------
        state : State
            A single one, of this mechanism.

        Raises
        ------
        AssemblyError
            Where it leaves the loops open.

        """
        if self.has_redundant_constraints and not self._geometry.is_valid(state.q):
            self.exchange(self._geometry.choose(state.q))
        whole = self.state
        for part, values in zip(self._parts, (state.q, state.qd, state.own)):
            whole[part] = values
        self.restore(whole, state.time, 0.0)
        self.require_closed(state.q, state.qd)
        self._require_step_from(state.q, state.qd)

    def set_step_size(self, step_size: float) -> None:
        """
        Change the step size while running; time and state go on.

        Parameters
        ----------
        step_size : float
            [s], positive.

        Raises
        ------
        ValueError
            Where it is no positive number; the present one stays.
        StiffnessError
            Where the scene is too stiff for it; the present one stays.

        """
        method = replace(self.scene.method, step_size=step_size)
        self._stiffness.check(self._state, method.step_size)
        self._set_method(method, self._stiffness)

    def prepare_method(self, **changes: Any) -> Callable[[], None]:
        """
        Check and prepare another method, leaving everything as it is.

        Parameters
        ----------
        **changes
            By the keys that a scene has under ``method``.

        Returns
        -------
        callable
            Lets the method take effect, from the next step on; time and state go on, the
            account of cost and local error restarts.

        Raises
        ------
        ValueError
            Where a name or value makes no sense.
        SimulationError
            Where the scene is too stiff for the method, or its closure equations here too
            dependent or its loops too far open.

        """
        native.require_free(self.system.native)
        method = replace(self.scene.method, **changes)
        self._require_known_steps(method)
        self._require_closable(method.stabilisation)
        before = self.system
        needs_all = self.has_redundant_constraints and not self._may_leave_out(method)
        system = with_equations(before, self._geometry.model_of(None)[0]) if needs_all else before
        system = with_partition(system, method.stabilisation == 'independent')
        guard = StiffnessGuard(system, method, self._effects.own)
        guard.check(self._state, method.step_size)
        run = self._new_run(system, method, guard)
        run.try_step(self._state.copy(), 1e-9)
        self._fresh = False

        def take_effect() -> None:
            if self.system is not before:
                # Equations, or the method, have been exchanged since.
                self.prepare_method(**changes)()
                return
            if needs_all:
                self._geometry.select(None)
                self._rebind(system)
                self.exchanges += 1
            self.system = system
            self._run.set_time(self.time, 0)
            self._run.take_method(system, run)
            self._advance_run = self._run.advance_run
            self._monitor = Monitor(method, self._run)
            self._set_method(method, guard)

        return take_effect

    def _require_closable(self, stabilisation: str) -> None:
        """Refuse a stabilisation that cannot start from the present state."""
        if stabilisation != 'none' and self.closure > self.system.settings.closure_limit:
            raise ClosureError(
                f'The loops have drifted apart by {self.closure:.3g} m or rad: more than '
                f'stabilisation: {stabilisation} may close. Reset, or set a state, first.')
        if stabilisation == 'independent':
            self._fresh = False
            self._assembler.require_independent(self._q)

    def _set_method(self, method: Method, stiffness: StiffnessGuard) -> None:
        self._run.set_time(self.time, 0)
        self.scene, self._stiffness = replace(self.scene, method=method), stiffness
        self._set_run()
        self._run.restart_guards()
        self._set_guard()
        self._set_budget(method)
        self.system.settings.baumgarte_gain[...] = (
            1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0)
        self._run.restart(False)
        self._jump()

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
            Where it is no state: other numbers, names, or no unit quaternion.

        """
        native.require_free(self.system.native)
        state = self._near(position, velocity, hold)
        if self.has_redundant_constraints and not self._geometry.is_valid(state[0]):
            self.exchange(self._geometry.choose(state[0]))
        if self.scene.method.stabilisation == 'independent':
            self._assembler.require_independent(state[0])
        self._require_step_from(*state)
        self._run.add_work()
        self._run.find_start()
        self._fresh = False
        before = self.energy
        self._q[:], self._qd[:] = state
        self._effects.reset_states(self._own)
        self._run.restart(True)
        self._jump()
        self._begin_loads()
        self._jump_balance(self.energy - before)

    def _require_step_from(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Refuse a state from which a step cannot be made."""
        fastest = np.abs(velocity).max(initial=0.0)
        if not fastest * self.step_size <= LARGEST_MOTION:
            raise AssemblyError(
                f'The largest velocity is {fastest:.3g} rad/s or m/s, so that a joint would move '
                f'by {fastest * self.step_size:.3g} rad or m in a step of {self.step_size:g} s; '
                f'at most {LARGEST_MOTION:g} can be followed.')
        trial, health = self._state.copy(), self.system.work.health.copy()
        places, rates, own = (trial[part] for part in self._parts)
        own[self._effects.own] = self._effects.initial[self._effects.own]
        places[:], rates[:] = position, velocity
        status = NOT_FINITE
        if np.isfinite(trial).all():
            status = self._try_step(trial, self.step_size)
        self.system.work.health[:] = health
        if status != DONE:
            raise AssemblyError(
                f'From this state not even a step of {self.step_size:g} s can be made: '
                + ('the numbers grow beyond all bounds'
                   if status == NOT_FINITE else 'the loops cannot be closed after it'
                   if status == OPEN_LOOP else 'it takes too many evaluations'
                   if status == TOO_MUCH_WORK else 'no part of it keeps the tolerance')
                + f'. Take smaller velocities (largest now {fastest:.3g} rad/s or m/s), or a '
                'smaller step.')

    def _try_step(self, state: np.ndarray, size: float) -> int:
        """Make a step from a copy of a state, leaving all else as it is; return its status."""
        status = self._run.try_step(state, size)
        self._fresh = False
        return DONE if status in (POOR_EQUATIONS, CONTACT_PASSED) else status

    def report(self) -> RunReport:
        """
        Return cost and estimated error of the run since the start or the last reset.

        Returns
        -------
        monitor.RunReport

        """
        residual = self._run.record_energy()['residual']
        self._fresh = False
        undecided = self._branch_finding()
        report = self._monitor.report(
            self.system.work.health, self.closure,
            residual - self._run.report.first_residual, self.energy_guard,
            (*self.load_notes(), *undecided), self._budget)
        return report if not undecided else replace(
            report, error_bound=math.nan, present_bound=math.nan, branch_undecided=True)

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

    @property
    def enabled_effects(self) -> Tuple[str, ...]:
        """Names of the effects that are switched on."""
        return tuple(name for name, enabled in self._effects.enabled.items() if enabled)

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
        native.require_free(self.system.native)
        self._run.find_start()
        self._fresh = False
        before, undo = self.energy, self._effects.trial()
        try:
            restarted = self._try_effect(name, enabled, parameters, undo)
        except Exception:
            undo()
            self._fresh = False
            raise
        self._run.add_work()
        self._fresh = False
        self._own[restarted] = self._effects.initial[restarted]
        if self._derivatives is not None:
            self._derivatives.enable_for(self)
        self._set_run()
        self._effects.begin_at_time(self._own, self.time)
        if self.has_redundant_constraints and not self._may_leave_out(self.scene.method):
            self.exchange(self._geometry.select(None))
        self._run.restart(False)
        self._jump()
        if len(restarted):
            self._begin_loads()
        self._jump_balance(self.energy - before)
        if self._effects.records[name].depends_on_reactions:
            for note in self.load_notes():
                warnings.warn(note, RuntimeWarning, stacklevel=2)

    @property
    def commanded_motions(self) -> Tuple[str, ...]:
        """
        Names that ``command_motion`` takes: of joints, and of effects that move points.

        Of prescribed motions of the shape ``commanded``, in the scene's order.
        """
        return tuple(self._motions.commanded)

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
        courses = self._motions.courses(commands, self.time)
        for name, keys in courses.items():
            record = self._effects.checked(name, None, keys)
            fastest = max(abs(record.at(time)[1]) for time in instants(keys['times']))
            if not fastest * self.step_size <= LARGEST_MOTION:
                with at('effects', name):
                    raise FieldError(
                        f'a rate of at most {LARGEST_MOTION / self.step_size:g} rad/s or m/s',
                        f'{fastest:.3g}', path=('rates',))
        for name, keys in courses.items():
            self.set_effect(name, **keys)

    def check_effect(
            self, name: str, enabled: Optional[bool] = None,
            **parameters: Any) -> None:
        """
        Refuse, as ``set_effect`` would, a change that makes no sense; change nothing.

        Parameters
        ----------
        name, enabled, **parameters
            As for ``set_effect``.

        Raises
        ------
        ValueError, StiffnessError

        """
        native.require_free(self.system.native)
        undo = self._effects.trial()
        try:
            self._try_effect(name, enabled, parameters, undo)
        finally:
            undo()
            self._fresh = False

    def _try_effect(
            self, name: str, enabled: Optional[bool],
            parameters: Dict[str, Any], undo: Callable[[], None]) -> np.ndarray:
        """
        Change an effect, unless steps that can be stable now could not be with it.

        ``undo`` leads back to the effects before; where the change is refused, it is to be called.
        """
        effects = self._effects
        self._motions.require_continued(
            name, effects.checked(name, enabled, parameters), enabled, self.time)
        restarted = effects.change(name, enabled, parameters)
        self._fresh = False
        self._require_finite_laws()
        if effects.records[name].STIFFENS:
            try:
                self._stiffness.check(self._state, self.step_size)
            except StiffnessError:
                undo()
                if self._stiffness.stable(self._state, self.step_size):
                    raise
                # It has been too stiff before: a change may be for the better.
                restarted = effects.change(name, enabled, parameters)
        return restarted


def instants(times: Sequence[float]) -> np.ndarray:
    """Return times and some between them [s]."""
    all_times = np.array(times)
    between = [all_times[:-1] + share * np.diff(all_times) for share in (0.0, 0.25, 0.5, 0.75)]
    return np.concatenate([*between, all_times[-1:]])
