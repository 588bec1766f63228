# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene brought to life: the Python interface that users script with."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
import math
from pathlib import Path
from time import perf_counter_ns, thread_time_ns
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union
import warnings

import numpy as np
from numpy.typing import ArrayLike

from .assembly import angle_notes
from .budget import Budget, INTERVAL
from .cable_guard import CHECK_EVERY as CABLE_CHECK_EVERY, explain, leapt
from .data import Numbers, vector
from .derivative_code import DerivativeCode
from .errors import (
    AssemblyError, ClosureError, MotionError, NumericalError, SimulationError, StiffnessError)
from .guards import (
    CLOSING, CLOSURE_CHECK_EVERY, EnergyGuard, EQUATIONS_CHECK_EVERY, EQUATIONS_FIRST_CHECK,
    LARGEST_MOTION, OPEN, opened_loops, StiffnessGuard, USUAL_TORQUE)
from .model import Model
from .modeling import extent
from .monitor import Monitor, RunReport
from .motions import moving
from .readings import Readings
from .rollout import Rollout, rollout
from .scene import load_scene
from .scene_records import Method, Scene
from .state import State
from .traced_scene import refusals
from ..core import types as t
from ..effects.delay_line import DelayLine
from ..effects.effect import Effect
from ..effects.energy_balance import Energies, EnergyBalance
from ..engine import native
from ..integration import guarded_run
from ..integration.control import (
    CONTACT_PASSED, DONE, INTERRUPTED, MOST_EVALUATIONS, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS,
    RANK_REVEALING_WORK, TOO_MUCH_WORK)
from ..integration.drivers import build_driver
from ..integration.guarded_run import COMMAND
from ..integration.left_out import LENIENT, OPENED
from ..integration.registry import INTEGRATORS, ROSENBROCK, SCIPY
from ..integration.system import (
    AccelerationDerivatives, BAUMGARTE_GAIN, CLOSURE_LIMIT, System, with_derivatives,
    with_equations, with_partition)
from ..mechanism.fields import at, FieldError

# How much further from dependent equations must be to be exchanged for others.
BETTER = 3.0
# Times closer than this share of a step are the same.
SAME_TIME = 1e-9
# Gravity's acceleration, to compare forces with weights [m/s^2].
EARTH = 9.81


class Simulation(Readings):
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

    """

    def __init__(self, model: Union[Model, Scene], state: Optional[State] = None,
                 method: Union[None, str, Mapping[str, Any], Method] = None) -> None:
        self._numbers = np.zeros(guarded_run.NUMBERS)
        self._counts = np.zeros(guarded_run.COUNTS, dtype=np.int64)
        self._set_time(0.0, 0)
        self.pace = 1.0
        self._measured = np.zeros(5)
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
        self._differentiate_steps()
        self._balance = EnergyBalance(self._effects.roles, len(self.system.tau))
        self._bind_balance()
        method = self.scene.method
        self._require_known_steps(method)
        self._driver = Monitor(build_driver(self.system, method), self.system, method,
                               self._numbers, self._counts)
        self._set_guards(StiffnessGuard(self.system, method, self._effects.own), method)
        self._set_run()
        self.exchanges = 0
        self.reset()

    def _differentiate_steps(self) -> None:
        """Generate the Jacobian of the stiff method, where that is the scene's."""
        self._derivatives: Optional[DerivativeCode] = None
        system, method = self.system, self.scene.method
        # The generated code has no forces over time, quaternions or Baumgarte's terms.
        if (INTEGRATORS[method.integrator].family == ROSENBROCK and not refusals(self)
                and system.manifold is None and not self._effects.follows_time
                and method.stabilisation not in ('baumgarte', 'independent')):
            self._derivatives = code = DerivativeCode(
                self, system.qdd, system.lam, len(self._own))
            self.system = with_derivatives(system, AccelerationDerivatives(
                code.table, code.columns, code.found, code.flows))

    def vary(self, scene: Scene) -> bool:
        """As ``Data.vary``: become a simulation of another scene."""
        if not super().vary(scene):
            return False
        if self._derivatives is not None:
            self._derivatives.enable_for(self)
        # By whose weight the guards measure.
        self._numbers[guarded_run.MASS] = self._mass
        self.reset()
        return True

    def _bind_balance(self) -> None:
        """Bind the energy balance to the present system."""
        account, engine = self._balance.account, self.system.native
        self._balance_found = np.empty(5)
        # The work of the torques held up to here.
        self._add_work = native.bind('add_held_work', engine, account, self._state)
        self._draw_balance = native.bind(
            'fill_balance', engine, account, self._state, self._balance_found)

    def _rebind(self, system: System) -> None:
        """Evaluate, and draw the energy balance, by another system."""
        super()._rebind(system)
        self._bind_balance()

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
            ``step_size``, ``stabilisation``, ``formulation``, ...); None leaves the scene's.

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

    @property
    def step_size(self) -> float:
        """Step size [s]."""
        return self.scene.method.step_size

    @property
    def time(self) -> float:
        """Time since the start or the last reset [s]."""
        # Counted, not summed: an hour of steps adds up to an hour.
        return (self._numbers.item(guarded_run.TIME_BASE)
                + self._counts.item(guarded_run.STEPS) * self.scene.method.step_size)

    def _set_time(self, base: float, steps: int) -> None:
        """Set the time to so many steps after another one [s]."""
        self._numbers[guarded_run.TIME_BASE], self._counts[guarded_run.STEPS] = base, steps

    @property
    def state(self) -> np.ndarray:
        """
        Whole state: joint coordinates, joint rates, the effects' own states, the method's memory.

        A run that is started from it by ``restore`` goes on in the same way to the last bit, with
        error control from where a command changes.
        """
        return np.concatenate((self._state, *self._driver.memory))

    @property
    def energy_balance(self) -> Energies:
        """Energy balance since the last reset, an ``effects.energy_balance.Energies`` [J]."""
        self._start_balance()
        self._draw_balance()
        self._fresh = True
        return Energies(*self._balance_found.tolist())

    @property
    def run(self) -> Any:
        """Return the run that the engine advances, a ``guarded_run.GuardedRun``."""
        return self._run

    @property
    def at_start(self) -> bool:
        """Whether nothing has moved or been changed since the start or the last reset."""
        return self._balance.at_start is None and self.time == 0.0

    def _by_freedom(self) -> np.ndarray:
        """Return the coordinate of each freedom, behind them those of ``torque_names``."""
        own, manifold = self._q, self.system.manifold
        if manifold is not None:
            native.fill_numbers(manifold, own)
            own = manifold.number
        if not len(self._cuts.acted):
            return own
        # Nor are these to be believed where only states beside the present one were looked at.
        self._fresh = False
        self._evaluate()
        self._fresh = False
        return np.concatenate((own, self._table.cuts.q[len(own):]))

    def _start_balance(self) -> None:
        """Find the energy at the start, when it is needed for the first time."""
        if self._balance.at_start is not None:
            return
        present = self._state.copy()
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        moved = not np.array_equal(self._state, present)
        self._fresh = self._fresh and not moved
        self._balance.start(*self._energies())
        if moved:
            self._state[:] = present
            self._fresh = False

    def start_notes(self) -> List[str]:
        """
        Return notes of the start: its ``assembly_notes``, angles beyond 2 pi, effects.

        Returns
        -------
        list of str

        """
        weight = EARTH * sum(body.mass for body in self.mechanism.bodies)
        effects = [note for name, record in self.scene.effects.items() for note in
                   record.start_notes(name, partial(self.effect_readings, name), weight)]
        return (angle_notes(self.mechanism, self.scene.initial.position) + self._motions.notes()
                + self.assembly_notes() + effects + self.load_notes())

    def _require_known_steps(self, method: Method) -> None:
        """Refuse solvers and coordinates that the effects leave no room for."""
        if self._motions and method.stabilisation == 'independent':
            raise SimulationError(
                f'The scene prescribes motions ({", ".join(self.motion_names)}): '
                'stabilisation: independent knows none. Take stabilisation: projection.')
        names = self._effects.ending_steps
        if names and INTEGRATORS[method.integrator].family == SCIPY:
            own = [name for name, one in INTEGRATORS.items() if one.family != SCIPY]
            raise SimulationError(
                f'The scene lists dry friction, or forces whose course over time has corners '
                f'({", ".join(names)}): steps must end where a joint comes to rest and at '
                f'corners, and {method.integrator} does not choose where its steps end. Take '
                f'another integrator ({", ".join(own)}), or leave them out.')

    def step(
            self, torque: Optional[Numbers] = None,
            duration: Optional[float] = None) -> None:
        """
        Advance by ``duration`` under constant torques.

        Parameters
        ----------
        torque : mapping, sequence or None
            Joint torques [N m or N]: by joint name, or for all actuated joints in their
            order; joints that are not named get none.
        duration : float, optional
            [s]; one step when not given. Covered by whole steps, and one shorter step at the
            end where it is no multiple of the step size.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.
        ValueError
            For a torque or duration that makes no sense.

        """
        if duration is None:
            tau = self._spread if self._spread_torques(torque) else self.joint_torques(torque)
            return self.advance(tau, 1)
        tau, size = self.joint_torques(torque), self.step_size
        if not (math.isfinite(duration) and duration >= 0.0):
            raise ValueError(f'duration: expected a finite number >= 0 [s], got {duration!r}')
        whole = math.floor(duration / size * (1.0 + 1e-12) + 1e-9)
        left = whole
        if self._budget is not None:
            most = max(1, round(INTERVAL / size))
            for _ in range((whole - 1) // most):
                self.keep_budget()
                self._order(tau, most)
            left -= max(0, (whole - 1) // most) * most
            self.keep_budget()
        rest = duration - whole * size
        self._order(tau, left, rest if rest > SAME_TIME * size else 0.0)
        self._make(size, 0, whole + 1)

    def advance(self, tau: np.ndarray, steps: int) -> None:
        """
        Advance by whole steps under constant joint torques; the fast path of ``step``.

        Parameters
        ----------
        tau : ndarray, shape (number of ``torque_names``,)
            Joint torques [N m or N], finite.
        steps : int
            Number of steps.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.

        """
        if self._budget is not None:
            self.keep_budget()
        if self._effects.attends or self._delay_line.pending:
            self._order(tau, steps)
            self._make(self.step_size, 0, steps)
            return
        self._fresh = False
        pause = self._advance_run(tau, steps)
        if pause == COMMAND:
            self._command(tau)
        if pause:
            self._go_on(pause)

    @property
    def accuracy(self) -> float:
        """Accuracy that ``integrator: auto`` keeps now [rad or m]; NaN of other methods."""
        return self._driver.accuracy

    def keep_budget(self) -> None:
        """
        Choose the accuracy that the method's budget allows from now on, by measurements.

        ``advance`` and ``step`` do so before they make steps; without a budget nothing is done.
        """
        if self._budget is None:
            return
        before = self._measured
        self._measured = self._driver.measured
        simulated, spent, elapsed, *work = (self._measured - before).tolist()
        if not simulated > 0.0:
            # Nothing, or a reset.
            return
        present = self.accuracy
        # As if the error were looked at all the time: the budget holds while it is.
        checked = max(2.0 * work[0] / sum(work) if sum(work) > 0.0 else 1.0, 1.0)
        accuracy = self._budget.choose(
            present, simulated / self.pace, checked * spent, checked * elapsed)
        if accuracy != present:
            self._driver.driver.aim(accuracy)

    def adopt_accuracy(self, state: ArrayLike) -> None:
        """
        Keep the accuracy that another run of ``integrator: auto`` kept from a state on.

        Parameters
        ----------
        state : sequence
            From ``state``; nothing else is taken of it.

        """
        accuracy = self._driver.accuracy_in(np.asarray(state)[len(self._state):])
        if accuracy != self.accuracy:
            self._driver.driver.aim(accuracy)

    def _set_budget(self, method: Method) -> None:
        """Make the accuracy follow the budget of a method, if it has one."""
        self._budget = (
            Budget(method.budget, method.accuracy)
            if method.budget is not None and method.by_budget else None)
        self._measured = self._driver.measured

    def _order(self, tau: np.ndarray, steps: int, rest: float = 0.0) -> None:
        """Advance by whole steps and the rest of one [s]; drives follow with their delays."""
        if self._delay_line.pending or self._effects.delays:
            self._delay_line.order(self.time, tau, self._effects.drives, self.system.tau)
        else:
            self._command(tau)
        while steps > 0:
            # Whole steps up to the one in which a command is due.
            wait = self._commanded()
            whole = math.floor(wait / self.step_size + SAME_TIME) if math.isfinite(wait) else steps
            if whole > 0:
                self._make_all(min(whole, steps))
                steps -= min(whole, steps)
            else:
                base, count = self._numbers[guarded_run.TIME_BASE], self._counts[guarded_run.STEPS]
                self._make_in_parts(self.step_size)
                self._set_time(base, count + 1)
                steps -= 1
        if rest > 0.0:
            self._make_in_parts(rest)
        self._commanded()

    def _commanded(self) -> float:
        """Apply commands that are due; return the time until the next one [s]."""
        line, close = self._delay_line, SAME_TIME * self.step_size
        if line.pending:
            self._command(line.due(self.time, close, self.system.tau))
        return line.wait(self.time)

    def _make_in_parts(self, size: float) -> None:
        """Make a step of at most the usual size [s] in parts that end where commands are due."""
        end = self.time + size
        left = size
        while left > SAME_TIME * self.step_size:
            wait = self._commanded()
            part = wait if wait < left - SAME_TIME * self.step_size else left
            self._make(part, 1)
            left = 0.0 if part == left else end - self.time
        if self._effects.remembers:
            self._sample_sensors()

    def _command(self, tau: np.ndarray) -> None:
        """Apply joint torques from now on."""
        if (tau == self.system.tau).all():
            return
        self.require_bearable(tau)
        self._add_work()
        self._driver.restart()
        self.system.tau[:] = tau
        self._fresh = False

    def _make_all(self, steps: int) -> None:
        """Make whole steps; sensors that remember see every state."""
        if not self._effects.remembers:
            self._make(self.step_size, steps)
            return
        self._sample_sensors()
        for _ in range(steps):
            self._make(self.step_size, 1)
            self._sample_sensors()

    def _sample_sensors(self) -> None:
        """Record the present state in sensors with a memory."""
        self.measured()
        self.measured_cut_joints()

    def _make(self, size: float, steps: int, call: int = 0) -> None:
        """Make steps of one size [s], up to the end of a call where its length is known."""
        counts = self._counts
        counts[guarded_run.DUE] = counts[guarded_run.HANDED] = 0
        counts[guarded_run.LEFT], counts[guarded_run.CALL] = steps, call
        self._numbers[guarded_run.SIZE] = size
        self._go_on(COMMAND)

    def _go_on(self, pause: int) -> None:
        """Handle the engine's pauses, and resume it, until all steps are made."""
        while pause:
            if pause == guarded_run.START_ENERGY:
                self._start_balance()
            elif pause == guarded_run.SAMPLE:
                self._driver.sample(self._state, self.step_size)
            elif pause == guarded_run.FAILURE or pause == guarded_run.HAND_OVER:
                self._make_portion(pause == guarded_run.FAILURE)
            elif pause == guarded_run.CHOICE:
                if self.leave_out_again():
                    self._counts[guarded_run.EQUATIONS_BETWEEN] = min(
                        2 * self._counts[guarded_run.EQUATIONS_BETWEEN], EQUATIONS_CHECK_EVERY)
            elif pause != COMMAND:
                self._report_pause(pause)
            self._fresh = False
            pause = self._resume_run()

    def _report_pause(self, pause: int) -> None:
        """Warn of, or raise, findings of the guards; the latest good state is kept."""
        numbers, guard = self._numbers, self.energy_guard
        if pause == guarded_run.INACCURATE:
            guard.warn()
        elif pause == guarded_run.ENERGY_LOST:
            problem = guard.problem(self)
            self.restore(self._run.kept, *numbers[
                [guarded_run.CHECK_TIME, guarded_run.PRESENT - 1]].tolist())
            raise problem
        elif pause == guarded_run.CABLE_LEAPT:
            before = dict(zip(self._effects.winding_places(), self._run.windings.tolist()))
            place = max(before, key=lambda each: abs(self.windings()[each] - before[each]))
            self.restore(self._run.kept_by_cables, *numbers[
                [guarded_run.CABLE_TIME, guarded_run.CABLE_RESIDUAL]].tolist())
            raise leapt(place, before[place], self.time)
        else:
            raise opened_loops(self)

    def check_energy(self) -> None:
        """
        Check the energy balance now: warn of a small error.

        Raises
        ------
        NumericalError, StiffnessError
            Where it is far off; the latest state that was well is kept.

        """
        self._start_balance()
        pause = self._check_energy()
        if pause:
            self._report_pause(pause)

    def _set_guards(self, stiffness: StiffnessGuard, method: Method) -> None:
        """Set the guards of a run by a method."""
        self._stiffness = stiffness
        self.energy_guard = EnergyGuard(
            method, stiffness.rate, self._numbers, self._counts, stiffness.limit,
            stiffness.among_laws, self._geometry.may_leave_out)
        self._restart_guards()

    def _restart_guards(self) -> None:
        """Restart the guards."""
        self.energy_guard.restart()
        counts = self._counts
        counts[guarded_run.CABLES_CHECKED] = counts[guarded_run.EQUATIONS_SINCE] = 0
        counts[guarded_run.EQUATIONS_BETWEEN] = EQUATIONS_FIRST_CHECK

    def _watch(self) -> Any:
        """Return the numbers by which the engine watches the run."""
        guard, method = self.energy_guard, self.scene.method
        places, size = self._effects.winding_places().values(), extent(self.mechanism)
        drifts = method.stabilisation not in CLOSING
        return guarded_run.Watch(
            guard.first, guard.rarely, guard.call, guard.whole, self._geometry.may_leave_out,
            min(CABLE_CHECK_EVERY if places else guarded_run.NEVER,
                CLOSURE_CHECK_EVERY if drifts else guarded_run.NEVER),
            OPEN * size if drifts else math.inf, method.stabilisation == 'none', size,
            USUAL_TORQUE, method.by_budget, np.array([*places], dtype=np.int64))

    def _set_run(self) -> None:
        """Build the engine's run from the present method, system and guards."""
        before = getattr(self, '_run', None)
        self._numbers[guarded_run.STEP_SIZE] = self.step_size
        self._numbers[guarded_run.MASS] = self._mass
        run = guarded_run.guarded_run(
            self._driver.driver.stepper, self._watch(), self._balance.account, self._state,
            sum(map(np.size, self._driver.memory)), self._numbers, self._counts)
        if before is not None and len(before.kept) == len(run.kept) and (
                np.array_equal(before.watch.windings, run.watch.windings)):
            # Where the guards have seen it.
            run = run._replace(kept=before.kept, kept_by_cables=before.kept_by_cables,
                               windings=before.windings)
        self._run, engine = run, self.system.native
        self._advance_run, self._resume_run, self._check_energy, self.run_samples = (
            native.bind(name, engine, run)
            for name in ('advance_run', 'resume_run', 'check_energy', 'run_samples'))

    def choose_equations(self, status: int) -> bool:
        """
        Choose the equations that the elimination works on again, after a step that failed.

        Parameters
        ----------
        status : int
            Of ``integration.advance``.

        Returns
        -------
        bool
            Whether to go on from the present state; not where no equations are left out, so that
            it failed for another reason.

        """
        if (not self.has_redundant_constraints or self.scene.method.stabilisation not in CLOSING
                or status == CONTACT_PASSED):
            return False
        whole: Any = self.system.whole
        numbers = whole.numbers
        opened = status != POOR_EQUATIONS or numbers[OPENED] == 1.0
        model = self._geometry.reselected(self._q, BETTER, opened)
        if model is None:
            if status == POOR_EQUATIONS and numbers[LENIENT] == 0.0 and not (
                    opened and not self._geometry.is_valid(self._q)):
                numbers[LENIENT] = 1.0
                return True
            # An equation left out may be the one that closes the loop.
            model = self._geometry.select(None)
        self.exchange(model)
        return True

    def leave_out_again(self) -> bool:
        """
        Leave out equations that repeat others, where all were taken again.

        Returns
        -------
        bool
            Whether some are left out from now on that were not.

        """
        if self.has_redundant_constraints or self.scene.method.stabilisation not in CLOSING:
            return False
        model = self._geometry.choose(self._q)
        if not self.has_redundant_constraints:
            return False
        self.exchange(model)
        return True

    def exchange(self, model: t.Model) -> None:
        """Make method and guards work on other closure equations, too."""
        super().exchange(model)
        self._driver.rebind(self.system)
        self._stiffness.move(self.system)
        self._set_run()
        self.exchanges += 1

    @property
    def fastest_rate(self) -> float:
        """Estimate of the fastest rate of the motion in the present state [1/s]."""
        return self._stiffness.rate(self._state)

    def judge(self) -> None:
        """
        Check the energy balance of the run so far, as is done from time to time during a run.

        Raises
        ------
        NumericalError, StiffnessError
            Where the motion is none; the latest state that was well is kept.

        """
        self._start_balance()
        pause = self._check_energy()
        if pause == guarded_run.ENERGY_LOST:
            self._report_pause(pause)

    def _make_portion(self, failed: bool) -> None:
        """Make steps that the engine does not: those of other solvers, or after a failure."""
        numbers, counts, driver = self._numbers, self._counts, self._driver.driver
        size, portion = float(numbers[guarded_run.SIZE]), int(counts[guarded_run.HANDED])
        grid = self.time, 0
        if size == self.step_size:
            grid = float(numbers[guarded_run.TIME_BASE]), int(counts[guarded_run.STEPS])
        status, elapsed = None, 0.0
        if failed:
            status, elapsed = int(counts[guarded_run.STATUS]), float(numbers[guarded_run.ELAPSED])
            driver.made = int(counts[guarded_run.MADE])
        begin, worked = perf_counter_ns(), thread_time_ns()
        try:
            while status != DONE:
                if status == INTERRUPTED:
                    # Another thread was.
                    raise KeyboardInterrupt
                if status is not None:
                    if not self.choose_equations(status):
                        break
                    driver.go_on()
                status, elapsed = driver.advance(self._state, *grid, size, portion)
        except BaseException:
            # Ctrl-C, within steps that count as not made.
            self._state[:] = self._run.before
            self._driver.restart(moved=True)
            raise
        numbers[guarded_run.COST_NANOSECONDS] += perf_counter_ns() - begin
        numbers[guarded_run.COST_CPU_NANOSECONDS] += thread_time_ns() - worked
        if status == DONE:
            return
        self._driver.count(elapsed, size)
        numbers[guarded_run.TIME_BASE] += elapsed
        self._fresh = False
        beyond = self._motions.advice_on_stopping(
            self._assembler, self._q, self.time, self.step_size)
        if beyond:
            raise MotionError(
                f'The motion cannot go on at t = {self.time:.9g} s; the state before is kept. '
                f'{beyond}')
        # What stopped it may be a cable at its limit, or steps that cannot be stable.
        explain(self)
        self._stiffness.check(self._state, size)
        raise self._stopped(status, size)

    def _stopped(self, status: int, size: float) -> SimulationError:
        """Return the error to raise where a step [s] could not be made."""
        if status == NOT_FINITE:
            return NumericalError(
                f'The state left the finite numbers at t = {self.time:.9g} s; the last finite '
                f'state is kept. Take a smaller step than {size:g} s, or smaller torques '
                f'(largest now {np.abs(self.system.tau).max(initial=0.0):g}).')
        if status == OPEN_LOOP:
            error = self.system.work.health[t.CLOSURE]
            advice = self._assembler.advice_on_opening(self._q) or (
                f'Take a smaller step than {size:g} s: the motion in one step is too large.')
            return ClosureError(
                f'The loops could not be closed after the step at t = {self.time:.9g} s (error '
                f'{error:.3g}); the state before it is kept. {advice}')
        if status == TOO_MUCH_WORK:
            return NumericalError(
                f'The motion at t = {self.time:.9g} s takes more than {MOST_EVALUATIONS} '
                f'evaluations for {size:g} s; the last good state is kept. '
                + self._advice_on_work())
        if status == CONTACT_PASSED:
            return NumericalError(
                f'A contact ({self._effects.passed}) was passed within a step of {size:g} s at '
                f't = {self.time:.9g} s, undetected between evaluations; the state before is '
                'kept. Take a smaller step, or a method with error control, such as '
                'integrator: auto.')
        return NumericalError(
            f'No step at t = {self.time:.9g} s is small enough to keep the error that is '
            'allowed; the last good state is kept. The motion is not smooth there: allow '
            'more, or take a fixed step.')

    def _advice_on_work(self) -> str:
        """Return a remedy where a step takes too many evaluations."""
        count = self.system.work.health[t.RANK_REVEALING_COUNT]
        self._present.evaluate()
        if self.system.work.health[t.RANK_REVEALING_COUNT] == count:
            return ('Take smaller torques (largest now '
                    f'{np.abs(self.system.tau).max(initial=0.0):g}), allow a larger error, or '
                    'leave out the effect that is so fast.')
        return ('Closure equations depend on others next to this position, where an evaluation '
                f'counts as {RANK_REVEALING_WORK}. ' + (
                    'No independent coordinates describe the motion through it: take '
                    'stabilisation: projection.'
                    if self.scene.method.stabilisation == 'independent' else
                    'Allow a larger error, or keep away from it by stops or another start.'))

    def require_bearable(self, tau: np.ndarray) -> None:
        """
        Refuse joint torques that no step from the present state can follow.

        Parameters
        ----------
        tau : ndarray, shape (number of ``torque_names``,)
            From ``joint_torques``.

        Raises
        ------
        NumericalError
            Where a joint would move by more than LARGEST_MOTION within a step; nothing is changed.

        """
        largest_torque = np.abs(tau).max(initial=0.0)
        if largest_torque <= USUAL_TORQUE:
            return
        system, before = self.system, self.system.tau.copy()
        system.tau[:] = tau
        self._present.evaluate()
        system.tau[:], self._fresh = before, False
        motion = np.abs(system.qdd).max(initial=0.0) * self.step_size ** 2
        if not (motion <= LARGEST_MOTION and np.isfinite(self._table.rates).all()):
            raise NumericalError(
                f'torque: expected torques that a step of {self.step_size:g} s can follow, got '
                f'up to {largest_torque:.3g} (N m or N), by which a joint would move by '
                f'{motion:.3g} rad or m; at most {LARGEST_MOTION:g} can be followed. The state '
                'and the torques before are kept.')

    def reset(self) -> None:
        """Return to the initial state, time zero and no torque."""
        if self.exchanges:
            self.exchange(self._geometry.as_at_first() if self._may_leave_out(self.scene.method)
                          else self._geometry.select(None))
        self.exchanges = 0
        self._set_time(0.0, 0)
        if self._motions:
            for name, record in self._motions.forget_commands(self.scene.effects).items():
                self._effects.put(name, record, True)
            # They may have been changed since.
            initial = self.scene.initial
            self._initial = self._assembled(initial.position, initial.velocity, initial.hold)
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._driver.rewind()
        self._effects.restart()
        self._delay_line = DelayLine()
        self.system.tau[:] = 0.0
        self._fresh = False
        health = self.system.work.health
        health[:] = 0.0
        health[t.SMALLEST_PIVOT] = health[t.SMALLEST_PIVOT_EVER] = 1.0
        self._begin_loads()
        if self.system.manifold is not None:
            self._state[-1] = 0.0
        self._balance.restart(self._by_freedom())
        self._restart_guards()
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
        whole = self._state.copy()
        for part, values in zip(self._parts, (state.q, state.qd, state.own)):
            whole[part] = values
        self.restore(np.concatenate((whole, *self._driver.memory)), state.time, 0.0)
        if not self.closure <= self.system.settings[CLOSURE_LIMIT]:
            raise AssemblyError(
                f'state: expected one that closes the loops, got one that leaves them '
                f'{self.closure:.3g} m or rad open; Model.assemble returns such as close them')
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
            By the keys that a scene has under ``method``, except ``formulation``.

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
        method = replace(self.scene.method, **changes)
        if method.formulation != self.scene.method.formulation:
            raise ValueError('method: the formulation is chosen when a scene is loaded, and stays')
        self._require_known_steps(method)
        self._require_closable(method.stabilisation)
        before = self.system
        needs_all = self.has_redundant_constraints and not self._may_leave_out(method)
        system = with_equations(before, self._geometry.model_of(None)[0]) if needs_all else before
        system = with_partition(system, method.stabilisation == 'independent')
        guard = StiffnessGuard(system, method, self._effects.own)
        guard.check(self._state, method.step_size)
        driver = build_driver(system, method)
        driver.advance(self._state.copy(), self.time, 0, 1e-9, 1)
        driver.rewind()
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
            self._driver = Monitor(driver, system, method, self._numbers, self._counts)
            self._set_method(method, guard)

        return take_effect

    def _require_closable(self, stabilisation: str) -> None:
        """Refuse a stabilisation that cannot start from the present state."""
        if stabilisation != 'none' and self.closure > self.system.settings[CLOSURE_LIMIT]:
            raise ClosureError(
                f'The loops have drifted apart by {self.closure:.3g} m or rad: more than '
                f'stabilisation: {stabilisation} may close. Reset, or set a state, first.')
        if stabilisation == 'independent':
            self._fresh = False
            self._assembler.require_independent(self._q)

    def _jump(self) -> None:
        """Reset the guards after a discontinuity of the state."""
        self._fresh = False
        self.energy_guard.jump()
        self._counts[guarded_run.CABLES_CHECKED] = 0

    def _set_method(self, method: Method, stiffness: StiffnessGuard) -> None:
        self._set_time(self.time, 0)
        self.scene = replace(self.scene, method=method)
        self._set_guards(stiffness, method)
        self._set_run()
        self._set_budget(method)
        self.system.settings[BAUMGARTE_GAIN] = (
            1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0)
        self._driver.restart()
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
        state = self._near(position, velocity, hold)
        if self.has_redundant_constraints and not self._geometry.is_valid(state[0]):
            self.exchange(self._geometry.choose(state[0]))
        if self.scene.method.stabilisation == 'independent':
            self._assembler.require_independent(state[0])
        self._require_step_from(*state)
        self._add_work()
        self._start_balance()
        before = self.energy
        self._q[:], self._qd[:] = state
        self._effects.reset_states(self._own)
        self._driver.restart(moved=True)
        self._jump()
        self._begin_loads()
        self._jump_balance(self.energy - before)

    def _jump_balance(self, energy: float) -> None:
        """Leave the energy of a change from outside out of the balance."""
        self._balance.jump(self._by_freedom(), energy)

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

    def restore(
            self, state: ArrayLike, time: float,
            residual: Optional[float] = None) -> None:
        """
        Restore a state of another run of the same scene, bit for bit; torques stay.

        Parameters
        ----------
        state : sequence
            From ``state``; not assembled.
        time : float
            Of that state [s].
        residual : float, optional
            Of the energy balance in that state [J]; the present one when not given.

        Raises
        ------
        ValueError
            Where it is no state of this scene.

        """
        state = vector('state', state, len(self.state))
        if residual is None:
            residual = self.energy_balance.residual
        self._start_balance()
        steps = round(time / self.step_size)
        exact = steps * self.step_size == time
        self._set_time(*((0.0, steps) if exact else (time, 0)))
        self._effects.restart()
        self._recall(state)
        self._driver.restart()
        self._jump()
        self._jump_balance(self.energy_balance.residual - residual)

    def _recall(self, state: np.ndarray) -> None:
        """Restore a value of ``state``."""
        self._state[:] = state[:len(self._state)]
        self._driver.recall(state[len(self._state):])

    def _try_step(self, state: np.ndarray, size: float) -> int:
        """Make a step from a copy of a state, leaving all else as it is; return its status."""
        before = self.state
        self._driver.restart(moved=True)
        status, _ = self._driver.driver.advance(state, self.time, 0, size, 1)
        self._recall(before)
        self._driver.restart()
        self._fresh = False
        return DONE if status in (POOR_EQUATIONS, CONTACT_PASSED) else status

    @property
    def monitor(self) -> Monitor:
        """Return the account of cost and local error, a ``monitor.Monitor``."""
        return self._driver

    def report(self) -> RunReport:
        """
        Return cost and estimated error of the run since the start or the last reset.

        Returns
        -------
        monitor.RunReport

        """
        self._start_balance()
        native.record_energy(self.system.native, self._run, self._balance_found)
        balance = Energies(*self._balance_found.tolist())
        return self._driver.report(
            self.closure, self.energy_guard.missed(balance), self.energy_guard,
            tuple(self.load_notes()), self._budget)

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
        self._add_work()
        self._start_balance()
        before = self.energy
        restarted = self._try_effect(name, enabled, parameters)
        self._own[restarted] = self._effects.initial[restarted]
        if self._derivatives is not None:
            self._derivatives.enable_for(self)
        self._set_run()
        self._effects.begin_at_time(self._own, self.time)
        if self.has_redundant_constraints and not self._may_leave_out(self.scene.method):
            self.exchange(self._geometry.select(None))
        self._driver.restart()
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
        effects = self._effects
        effects.checked(name, enabled, parameters)
        was = effects.records[name], effects.enabled[name]
        self._try_effect(name, enabled, parameters)
        effects.put(name, *was)

    def _try_effect(
            self, name: str, enabled: Optional[bool],
            parameters: Dict[str, Any]) -> np.ndarray:
        """Change an effect, unless steps that can be stable now could not be with it."""
        effects = self._effects
        self._motions.require_continued(
            name, effects.checked(name, enabled, parameters), enabled, self.time)
        was = effects.records.get(name), effects.enabled.get(name)
        restarted = effects.change(name, enabled, parameters)
        self._fresh = False
        try:
            self._require_finite_laws()
        except FieldError:
            effects.put(name, *was)
            raise
        if effects.records[name].STIFFENS:
            self._require_stable(name, was)
        return restarted

    def _require_stable(self, name: str, was: Tuple[Any, ...]) -> None:
        try:
            self._stiffness.check(self._state, self.step_size)
        except StiffnessError:
            changed = self._effects.records[name], self._effects.enabled[name]
            self._effects.put(name, *was)
            if self._stiffness.stable(self._state, self.step_size):
                raise
            # It has been too stiff before: a change may be for the better.
            self._effects.put(name, *changed)


def instants(times: Sequence[float]) -> np.ndarray:
    """Return times and some between them [s]."""
    all_times = np.array(times)
    between = [all_times[:-1] + share * np.diff(all_times) for share in (0.0, 0.25, 0.5, 0.75)]
    return np.concatenate([*between, all_times[-1:]])
