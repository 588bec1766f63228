# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of a simulation: what makes them, watches them and ends them."""

import math
from typing import Any, Callable, List, Optional, Tuple
import warnings

import numpy as np
from numpy.typing import ArrayLike

from . import change_points
from .budget import Budget, INTERVAL
from .cable_guard import explain, leapt
from .data import Numbers, vector
from .derivative_code import DerivativeCode
from .errors import (
    ClosureError, InaccuracyWarning, MotionError, NumericalError, SimulationError)
from .guards import (
    CLOSING, EnergyGuard, EQUATIONS_CHECK_EVERY, LARGEST_MOTION, opened_loops, StiffnessGuard,
    USUAL_TORQUE, watch)
from .modeling import extent
from .monitor import Monitor
from .named_array import reals
from .readings import Readings
from .scene_records import Method, Scene
from .traced_scene import refusals
from ..core import types as t
from ..effects.delay_line import DelayLine
from ..effects.energy_balance import Energies
from ..engine import native
from ..integration.control import (
    CONTACT_PASSED, INTERRUPTED, MOST_EVALUATIONS, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS,
    RANK_REVEALING_WORK, TOO_MUCH_WORK)
from ..integration.registry import INTEGRATORS, ROSENBROCK
from ..integration.run import (
    CABLE_LEAPT, CHOICE, COMMAND, ENERGY_LOST, FAILED, INACCURATE, Run, Watch)
from ..integration.system import AccelerationDerivatives, LENIENT, OPENED, System

# How often equations are exchanged while the motion goes on by less than a share of a step.
MOST_EXCHANGES, LEAST_PROGRESS = 20, 1e-2
# How much further from dependent equations must be to be exchanged for others.
BETTER = 3.0
# Of the closure error at which loops count as open: from here on they may contradict one another.
CONTRADICTION = 0.1
# Times closer than this share of a step are the same.
SAME_TIME = 1e-9
# Contacts that a message names.
MOST_NAMED = 3


class Stepping(Readings):
    """A state that a method advances: steps, commands, the engine's pauses, guards, failures."""

    def __init__(self, scene: Scene) -> None:
        # Zero until there is a run.
        self._clock: Callable[[], float] = float
        self.pace, self._lenient_from = 1.0, b''
        self._measured, self._delay_line = np.zeros(5), DelayLine()
        # What is known of singular positions that were passed, and of which.
        self._passage: Tuple[bytes, List[str]] = b'', []
        super().__init__(scene)
        self._differentiate_steps()
        method = self.scene.method
        self._require_known_steps(method)
        self._stiffness = StiffnessGuard(self.system, method, self._effects.own)
        self._run = self._new_run(self.system, method, self._stiffness)
        self._clock, self._advance_run = self._run.time, self._run.advance_run
        self._monitor = Monitor(method, self._run)
        self._set_guard()
        self.exchanges = 0

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
            native.use_derivatives(system, AccelerationDerivatives(
                code.table, code.columns, code.found, code.flows))

    def _rebind(self, system: System) -> None:
        """Evaluate, and advance the run, by another system."""
        super()._rebind(system)
        self._run.rebind(system)
        self._advance_run = self._run.advance_run

    @property
    def step_size(self) -> float:
        """Step size [s]."""
        return self.scene.method.step_size

    @property
    def time(self) -> float:
        """Time since the start or the last reset [s]."""
        return self._clock()

    @property
    def state(self) -> np.ndarray:
        """
        Whole state: joint coordinates, joint rates, the effects' own states, the method's memory.

        A run that is started from it by ``restore`` goes on in the same way to the last bit, with
        error control from where a command changes.
        """
        return self._run.whole

    @property
    def energy_balance(self) -> Energies:
        """Energy balance since the last reset, an ``effects.energy_balance.Energies`` [J]."""
        found = Energies(**self._run.balance())
        self._fresh = True
        return found

    @property
    def run(self) -> Run:
        """Return the run that the engine advances."""
        return self._run

    @property
    def at_start(self) -> bool:
        """Whether nothing has moved or been changed since the start or the last reset."""
        return self.time == 0.0 and self._run.report.at_start

    def _require_known_steps(self, method: Method) -> None:
        """Refuse coordinates that the effects leave no room for."""
        if self._motions and method.stabilisation == 'independent':
            raise SimulationError(
                f'The scene prescribes motions ({", ".join(self.motion_names)}): '
                'stabilisation: independent knows none. Take stabilisation: projection.')

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
        whole = math.floor(duration / size * (1.0 + 1e-12) + SAME_TIME)
        left = whole
        if self._budget is not None:
            most = max(1, round(INTERVAL / size))
            for _ in range((whole - 1) // most):
                self.keep_budget()
                self._order(tau, most)
            left -= max(0, (whole - 1) // most) * most
            self.keep_budget()
        rest = duration - whole * size
        # However short a step is, it is made.
        self._order(tau, left, rest if rest > (SAME_TIME * size if whole else 0.0) else 0.0)
        self._make(size, 0, whole + 1)

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
        if type(steps) is not int or steps < 0:
            steps = _whole(steps)
        if self._budget is not None:
            self.keep_budget()
        if self._effects.attends or self._delay_line.pending:
            self._order(self._all_torques(tau), steps)
            self._make(self.step_size, 0, steps)
            return
        self._fresh = False
        outcome = self._advance_run(tau, steps)
        if outcome == COMMAND:
            self._command(self._all_torques(tau))
            outcome = self._run.make_steps(self.step_size, steps, steps)
        if outcome:
            self._go_on(outcome)

    def _all_torques(self, tau: ArrayLike) -> np.ndarray:
        """Return joint torques in the order of ``torque_names`` as an array, or refuse them."""
        found = reals('torque', tau)
        if found.shape == (len(self.actuated_joints),) != self.system.tau.shape:
            return self.joint_torques(found)
        if found.shape != self.system.tau.shape:
            raise ValueError(
                f'torque: expected shape {self.system.tau.shape}, for '
                f'{", ".join(self.torque_names)}, or ({len(self.actuated_joints)},), for '
                f'{", ".join(self.actuated_joints) or "none"}; got shape {found.shape}')
        if not np.isfinite(found).all():
            raise ValueError(f'torque: expected finite numbers, got {tau!r}')
        return found

    @property
    def accuracy(self) -> float:
        """Accuracy that ``integrator: auto`` keeps now [rad or m]; NaN of other methods."""
        return self._run.steps.accuracy

    def keep_budget(self) -> None:
        """
        Choose the accuracy that the method's budget allows from now on, by measurements.

        ``advance`` and ``step`` do so before they make steps; without a budget nothing is done.
        """
        if self._budget is None:
            return
        before = self._measured
        self._measured = self._monitor.measured
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
            self._run.aim(accuracy)

    def adopt_accuracy(self, state: ArrayLike) -> None:
        """Keep the accuracy that another run of ``integrator: auto`` kept from a ``state`` on."""
        accuracy = self._run.accuracy_in(np.array(state))
        if accuracy != self.accuracy:
            self._run.aim(accuracy)

    def _set_budget(self, method: Method) -> None:
        """Make the accuracy follow the budget of a method, if it has one."""
        self._budget = (
            Budget(method.budget, method.accuracy)
            if method.budget is not None and method.by_budget else None)
        self._measured = self._monitor.measured

    def _order(self, tau: np.ndarray, steps: int, rest: float = 0.0) -> None:
        """Advance by whole steps and the rest of one [s]; drives follow with their delays."""
        native.require_free(self.system.native)
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
                base, count = self._run.base()
                self._make_in_parts(self.step_size)
                self._run.set_time(base, count + 1)
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
        left, least = size, SAME_TIME * size
        while left > least:
            wait = self._commanded()
            part = wait if wait < left - least else left
            self._make(part, 1)
            left = 0.0 if part == left else end - self.time
        if self._effects.remembers:
            self._sample_sensors()

    def _command(self, tau: np.ndarray) -> None:
        """Apply joint torques from now on."""
        if (tau == self.system.tau).all():
            return
        self.require_bearable(tau)
        self._run.command(tau)
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
        self._fresh = False
        self._go_on(self._run.make_steps(size, steps, call))

    def _go_on(self, outcome: int) -> None:
        """Do what the outcome of a run asks for, and resume it, until all steps are made."""
        run, reached, exchanged = self._run, -math.inf, 0
        while outcome:
            self._fresh = False
            if outcome == FAILED:
                report = run.report
                if report.time + report.advanced > reached + LEAST_PROGRESS * report.size:
                    reached, exchanged = report.time + report.advanced, 0
                exchanged += 1
                self._choose_or_stop(report, exchanged)
            elif outcome == CHOICE:
                if self.leave_out_again():
                    run.choose_more_seldom(EQUATIONS_CHECK_EVERY)
            else:
                self._tell(outcome)
            self._fresh = False
            outcome = run.resume_run()

    def _tell(self, outcome: int) -> None:
        """Warn of, or raise, findings of the guards; the latest good state is kept."""
        run, guard = self._run, self.energy_guard
        if outcome == INACCURATE:
            warnings.warn(guard.finding, InaccuracyWarning, stacklevel=2)
        elif outcome == ENERGY_LOST:
            problem, report = guard.problem(self), run.report
            self.restore(
                run.kept(), report.check_time, report.check_residual)
            raise problem
        elif outcome == CABLE_LEAPT:
            report = run.report
            place = [*self._effects.winding_places()][report.leapt]
            self.restore(run.kept(True), report.cable_time, report.cable_residual)
            raise leapt(place, report.winding, self.time)
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
        outcome = self._run.check_energy()
        if outcome:
            self._tell(outcome)

    def _set_guard(self) -> None:
        """Set the guard of the energy by the present method."""
        stiffness = self._stiffness
        self.energy_guard = EnergyGuard(
            self.scene.method, stiffness.rate, self._run, stiffness.limit)

    def _watch(self, method: Method, stiffness: StiffnessGuard) -> Watch:
        """Return the numbers by which the engine watches a run."""
        return watch(method, stiffness.among_laws, self._geometry.may_leave_out,
                     len(self._windings()) > 0, extent(self.mechanism), self._mass)

    def _windings(self) -> np.ndarray:
        """Return the places of windings of cables among the data of effects."""
        return np.array([*self._effects.winding_places().values()], dtype=np.int64)

    def _new_run(self, system: System, method: Method, stiffness: StiffnessGuard) -> Run:
        """Return a run of the present state by a method."""
        return Run(system, self._state, method, self._watch(method, stiffness),
                   self._effects.roles, self._windings())

    def _set_run(self) -> None:
        """Let the engine's run go on with the limits of the present scene."""
        self._run.set_watch(self.system, self._watch(self.scene.method, self._stiffness),
                            self._windings())

    def choose_equations(self, status: int) -> bool:
        """
        Choose the equations that the elimination works on again, after a step that failed.

        Returns whether to go on from the present state; not where no equations are left out, so
        that the step failed for another reason, by its status of ``integration.advance``.
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
                # Again from the same state: a part of the step was well, and the rest is not.
                again = self._lenient_from == self._q.tobytes()
                numbers[LENIENT] = 2.0 if again else 1.0
                self._lenient_from = self._q.tobytes()
                return True
            if opened and self._geometry.contradiction(self._q):
                return False
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
        self._stiffness.move(self.system)
        self.exchanges += 1

    @property
    def fastest_rate(self) -> float:
        """Estimate of the fastest rate of the motion in the present state [1/s]."""
        return self._stiffness.rate(self._state)

    def judge(self) -> None:
        """As ``check_energy``, without a warning of a small error."""
        outcome = self._run.check_energy()
        if outcome == ENERGY_LOST:
            self._tell(outcome)

    def _choose_or_stop(self, report: Any, exchanged: int) -> None:
        """Choose other equations after a step that failed, or raise what has ended the run."""
        run, status, size = self._run, report.status, report.size
        if status == INTERRUPTED:
            # Another thread was.
            raise KeyboardInterrupt
        goes_on = False
        try:
            goes_on = exchanged <= MOST_EXCHANGES and self.choose_equations(status)
        finally:
            if not goes_on:
                run.give_up()
                self._fresh = False
        if goes_on:
            return
        beyond = self._motions.advice_on_stopping(
            self._assembler, self._q, self.time, self.step_size)
        if beyond:
            raise MotionError(
                f'The motion cannot go on at t = {self.time:.9g} s; the state before is kept. '
                f'{beyond}')
        # What stopped it may be a cable at its limit, or steps that cannot be stable.
        explain(self)
        self._stiffness.check(self._state, size)
        if exchanged > MOST_EXCHANGES:
            raise NumericalError(
                f'The motion does not go on at t = {self.time:.9g} s, whichever closure equations '
                f'are left out as repeating others ({MOST_EXCHANGES} choices were tried); the '
                'last good state is kept. Make lengths and axes of the loops agree to more '
                'digits, or start elsewhere.')
        stopped, undecided = self._stopped(status, size), self._branch_finding()
        raise type(stopped)(' '.join(
            [str(stopped), *(f'Before that, {one}' for one in undecided)]))

    def _stopped(self, status: int, size: float) -> SimulationError:
        """Return the error to raise where a step [s] could not be made."""
        if status == NOT_FINITE:
            return NumericalError(
                f'The state left the finite numbers at t = {self.time:.9g} s; the last finite '
                f'state is kept. Take a smaller step than {size:g} s, or smaller torques '
                f'(largest now {np.abs(self.system.tau).max(initial=0.0):g}).')
        # Loops that are well closed here opened because of the step, or at a change point.
        if status == POOR_EQUATIONS or status == OPEN_LOOP and self.has_redundant_constraints and (
                self.closure > CONTRADICTION * self.system.settings.closure_limit):
            contradiction = self._geometry.contradiction(self._q)
            if contradiction:
                return ClosureError(
                    f'The loops cannot stay closed after t = {self.time:.9g} s; the state before '
                    f'is kept. {contradiction}')
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
                    'leave out the effect that is so fast.' + self._pressing())
        return ('Closure equations depend on others next to this position, where an evaluation '
                f'counts as {RANK_REVEALING_WORK}. ' + (
                    'No independent coordinates describe the motion through it: take '
                    'stabilisation: projection.'
                    if self.scene.method.stabilisation == 'independent' else
                    'Allow a larger error, or keep away from it by stops or another start.'))

    def _pressing(self) -> str:
        """Return the contacts that press, the hardest first, with depths and forces."""
        readings = {name: self.effect_readings(name)
                    for name, acts in self._effects.enabled.items() if acts}
        pressing = sorted(((one['normal_force'], name, one['depth'])
                           for name, one in readings.items()
                           if one.get('normal_force', 0.0) > 0.0), reverse=True)
        found = ', '.join(f'{name} ({depth:.3g} m deep, normal force {force:.3g} N)'
                          for force, name, depth in pressing[:MOST_NAMED])
        return f' In contact: {found}.' if found else ''

    def _branch_finding(self) -> List[str]:
        """Return a finding where a change point was passed that the lengths miss by little."""
        present = self.system.passage.tobytes()
        if self._passage[0] != present:
            self._fresh = False
            self._passage = present, list(change_points.finding(
                self.mechanism, self._equations, self.system.passage))
            self._fresh = False
        return self._passage[1]

    def require_bearable(self, tau: np.ndarray) -> None:
        """
        Refuse joint torques, of ``joint_torques``, that no step from the present state can follow.

        NumericalError where a joint would move by more than LARGEST_MOTION within a step; nothing
        is changed.
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

    def _jump(self) -> None:
        """Reset the guards after a discontinuity of the state."""
        self._fresh = False
        self._run.jump()

    def _jump_balance(self, energy: float) -> None:
        """Leave the energy of a change from outside out of the balance."""
        self._run.jump_balance(energy)
        self._fresh = False

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
        native.require_free(self.system.native)
        state = vector('state', state, self._run.whole_length())
        if residual is None:
            residual = self.energy_balance.residual
        self._run.find_start()
        steps = round(time / self.step_size)
        exact = steps * self.step_size == time
        self._run.set_time(*((0.0, steps) if exact else (time, 0)))
        self._effects.restart()
        self._run.recall(state)
        self._run.restart(False)
        self._jump()
        self._jump_balance(self.energy_balance.residual - residual)

    @property
    def monitor(self) -> Monitor:
        """Return the account of cost and local error, a ``monitor.Monitor``."""
        return self._monitor


def _whole(steps: Any) -> int:
    """Return a number of steps as Python's own, or refuse it."""
    if isinstance(steps, np.integer) and steps >= 0:
        return int(steps)
    raise ValueError(f'steps: expected a whole number >= 0, got {steps!r}')
