# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The steps of a simulation: what makes them, watches them and ends them."""

from copy import deepcopy
from dataclasses import replace
import math
from typing import Any, Callable, Dict, List, Mapping, NoReturn, Optional, Sequence, Tuple
import warnings

import numpy as np
from numpy.typing import ArrayLike

from .budget import Budget, INTERVAL
from .cable_guard import explain, leapt
from .data import Numbers, vector
from .derivative_code import DerivativeCode
from .failures import failure
from .guards import (
    EnergyGuard, guard_limits, LARGEST_MOTION, opened_loops, StiffnessGuard, USUAL_TORQUE)
from .monitor import Monitor, RunReport
from .readings import Readings
from .run import (
    CABLE_LEAPT, CHOICE, COMMAND, ENERGY_LOST, FAILED, GuardLimits, INACCURATE, Run)
from .system import AccelerationDerivatives, System, with_equations, with_partition
from .traced_scene import refusals
from ..effects.delay_line import DelayLine
from ..engine import types as t
from ..engine.status import (
    CONTACT_PASSED, DONE, INTERRUPTED, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, TOO_MUCH_WORK)
from ..kinematics import change_points
from ..kinematics.modeling import extent
from ..kinematics.state import State
from ..mechanism.errors import (
    AssemblyError, ClosureError, InaccuracyWarning, MotionError, NumericalError, SimulationError,
    StiffnessError)
from ..mechanism.fields import at, FieldError
from ..mechanism.named_array import reals
from ..scene.integrators import INTEGRATORS, ROSENBROCK
from ..scene.records import Method

# Other equations replace those in use where their smallest singular value is larger by the first
# factor; by the second one where code is for those in use alone, as loops over bodies take longer.
BETTER, WORTH_LOOPS = 3.0, 10.0
# Times closer than this share of a step are the same.
SAME_TIME = 1e-9


class Stepping:
    """
    A run: the method that advances data, its guards, and what ends it.

    Attributes
    ----------
    data : readings.Readings
        The state that is advanced.
    run : simulation.run.Run
        The run that the engine advances.
    monitor : monitor.Monitor
        Account of cost and local error.
    energy_guard : guards.EnergyGuard
    stiffness : guards.StiffnessGuard
    pace : float
        Simulated seconds per second of the clock, by which a budget counts; 1 when not set.

    """

    def __init__(self, data: Readings) -> None:
        self.data, self.pace, self._methods = data, 1.0, 0
        self._state, self._q, self._effects = data.integrated, data.q, data.effect_set
        self._measured, self._delay_line = np.zeros(5), DelayLine()
        # What is known of singular positions that were passed, and of which.
        self._passage: Tuple[bytes, List[str]] = b'', []
        self._differentiate_steps()
        self.require_known_steps(self.method)
        self.stiffness = StiffnessGuard(data.system, self.method, self._effects.own)
        self.run = self.new_run(data.system, self.method, self.stiffness)
        data.clock, self._advance_run = self.run.time, self.run.advance_run
        self.monitor, self.energy_guard = Monitor(self.method, self.run), EnergyGuard(self)

    @property
    def method(self) -> Method:
        """Return the method, as the scene of the data has it."""
        return self.data.scene.method

    def _differentiate_steps(self) -> None:
        """Generate the Jacobian of the stiff method, where that is the scene's."""
        self._derivatives: Optional[DerivativeCode] = None
        system, method = self.data.system, self.method
        # The generated code has no forces over time, quaternions or Baumgarte's terms.
        if (INTEGRATORS[method.integrator].family == ROSENBROCK and not refusals(self.data)
                and system.manifold is None and not self._effects.follows_time
                and method.stabilisation not in ('baumgarte', 'independent')):
            self._derivatives = code = DerivativeCode(
                self.data, system.qdd, system.lam, len(self.data.own))
            system.use_derivatives(AccelerationDerivatives(
                code.table, code.columns, code.found, code.flows))

    @property
    def step_size(self) -> float:
        """Step size [s]."""
        return self.method.step_size

    @property
    def at_start(self) -> bool:
        """Whether nothing has moved or been changed since the start or the last reset."""
        return self.data.time == 0.0 and self.run.report.at_start

    def require_known_steps(self, method: Method) -> None:
        """Refuse coordinates that the effects leave no room for."""
        if self.data.motions and method.stabilisation == 'independent':
            raise SimulationError(
                f'The scene prescribes motions ({", ".join(self.data.motion_names)}): '
                'stabilisation: independent knows none. Take stabilisation: projection.')

    def step(
            self, torque: Optional[Numbers] = None,
            duration: Optional[float] = None) -> None:
        """As ``Simulation.step``."""
        if duration is None:
            data = self.data
            return self.advance(
                data.spread if data.spread_torques(torque) else data.joint_torques(torque), 1)
        tau, size = self.data.joint_torques(torque), self.step_size
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
        """As ``Simulation.advance``."""
        if type(steps) is not int or steps < 0:
            steps = _whole(steps)
        if self._budget is not None:
            self.keep_budget()
        if self._effects.attends or self._delay_line.pending:
            self._order(self._all_torques(tau), steps)
            self._make(self.step_size, 0, steps)
            return
        outcome = self._advance_run(tau, steps)
        if outcome == COMMAND:
            self._command(self._all_torques(tau))
            outcome = self.run.make_steps(self.step_size, steps, steps)
        if outcome:
            self._go_on(outcome)

    def _all_torques(self, tau: ArrayLike) -> np.ndarray:
        """Return joint torques in the order of ``torque_names`` as an array, or refuse them."""
        data, found = self.data, reals('torque', tau)
        if found.shape == (len(data.actuated_joints),) != data.system.tau.shape:
            return data.joint_torques(found)
        if found.shape != data.system.tau.shape:
            raise ValueError(
                f'torque: expected shape {data.system.tau.shape}, for '
                f'{", ".join(data.torque_names)}, or ({len(data.actuated_joints)},), for '
                f'{", ".join(data.actuated_joints) or "none"}; got shape {found.shape}')
        if not np.isfinite(found).all():
            raise ValueError(f'torque: expected finite numbers, got {tau!r}')
        return found

    @property
    def accuracy(self) -> float:
        """Accuracy that ``integrator: auto`` keeps now [rad or m]; NaN of other methods."""
        return self.run.steps.accuracy

    def keep_budget(self) -> None:
        """
        Choose the accuracy that the method's budget allows from now on, by measurements.

        ``advance`` and ``step`` do so before they make steps; without a budget nothing is done.
        """
        if self._budget is None:
            return
        before = self._measured
        self._measured = self.monitor.measured
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
            self.run.aim(accuracy)

    def adopt_accuracy(self, state: ArrayLike) -> None:
        """Keep the accuracy that another run of ``integrator: auto`` kept from a ``state`` on."""
        accuracy = self.run.accuracy_in(np.array(state))
        if accuracy != self.accuracy:
            self.run.aim(accuracy)

    def _set_budget(self, method: Method) -> None:
        """Make the accuracy follow the budget of a method, if it has one."""
        self._budget = (
            Budget(method.budget, method.accuracy)
            if method.budget is not None and method.by_budget else None)
        self._measured = self.monitor.measured

    def _order(self, tau: np.ndarray, steps: int, rest: float = 0.0) -> None:
        """Advance by whole steps and the rest of one [s]; drives follow with their delays."""
        self.data.system.native.require_free()
        if self._delay_line.pending or self._effects.delays:
            self._delay_line.order(self.data.time, tau, self._effects.drives, self.data.system.tau)
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
                base, count = self.run.base()
                self._make_in_parts(self.step_size)
                self.run.set_time(base, count + 1)
                steps -= 1
        if rest > 0.0:
            self._make_in_parts(rest)
        self._commanded()

    def _commanded(self) -> float:
        """Apply commands that are due; return the time until the next one [s]."""
        line, close = self._delay_line, SAME_TIME * self.step_size
        if line.pending:
            self._command(line.due(self.data.time, close, self.data.system.tau))
        return line.wait(self.data.time)

    def _make_in_parts(self, size: float) -> None:
        """Make a step of at most the usual size [s] in parts that end where commands are due."""
        end = self.data.time + size
        left, least = size, SAME_TIME * size
        while left > least:
            wait = self._commanded()
            part = wait if wait < left - least else left
            self._make(part, 1)
            left = 0.0 if part == left else end - self.data.time
        if self._effects.remembers:
            self._sample_sensors()

    def _command(self, tau: np.ndarray) -> None:
        """Apply joint torques from now on."""
        if (tau == self.data.system.tau).all():
            return
        self.require_admissible(tau)
        self.run.command(tau)

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
        self.data.measured()
        self.data.measured_cut_joints()

    def _make(self, size: float, steps: int, call: int = 0) -> None:
        """Make steps of one size [s], up to the end of a call where its length is known."""
        self._go_on(self.run.make_steps(size, steps, call))

    def _go_on(self, outcome: int) -> None:
        """Warn of, or raise, the outcome of a run, or choose equations for it; let it go on."""
        while outcome:
            outcome = self.run.resume_run(self._tell(outcome))

    def _tell(self, outcome: int) -> bool:
        """
        Warn of, or raise, an outcome, or choose equations; the latest good state is kept.

        Returns whether the run is to go on.
        """
        run, guard, report = self.run, self.energy_guard, self.run.report
        if outcome == CHOICE:
            return self.choose_equations(report)
        if outcome == FAILED:
            self._raise_failure(report)
        if outcome == INACCURATE:
            warnings.warn(guard.finding, InaccuracyWarning, stacklevel=2)
            return True
        if outcome == ENERGY_LOST:
            problem = guard.problem()
            self.restore(run.kept(), report.check_time, report.check_residual)
            raise problem
        if outcome == CABLE_LEAPT:
            place = [*self._effects.winding_places()][report.leapt]
            self.restore(run.kept(True), report.cable_time, report.cable_residual)
            raise leapt(place, report.winding, self.data.time)
        raise opened_loops(self.data, run.guard_limits)

    def check_energy(self) -> None:
        """
        Check the energy balance now: warn of a small error.

        Raises
        ------
        NumericalError, StiffnessError
            Where it is far off; the latest state that was well is kept.

        """
        outcome = self.run.check_energy()
        if outcome:
            self._tell(outcome)

    def _guard_limits(self, method: Method, stiffness: StiffnessGuard) -> GuardLimits:
        """Return the numbers by which the engine watches a run."""
        return guard_limits(
            method, stiffness.among_laws, self.data.loop_model.may_leave_out,
            len(self._windings()) > 0, extent(self.data.mechanism), self.data.mass)

    def _windings(self) -> np.ndarray:
        """Return the places of windings of cables among the data of effects."""
        return np.array([*self._effects.winding_places().values()], dtype=np.int64)

    def new_run(self, system: System, method: Method, stiffness: StiffnessGuard) -> Run:
        """Return a run of the present state by a method."""
        return Run(system, self._state, method, self._guard_limits(method, stiffness),
                   self._effects.roles, self._windings())

    def reset(self) -> None:
        """Return to the scene's initial state, time zero and no torque."""
        data = self.data
        data.system.native.require_free()
        if data.exchanges:
            data.use_equations(
                data.loop_model.as_at_first() if data.may_leave_out(self.method)
                else data.loop_model.select(None))
        data.exchanges = 0
        self.run.set_time(0.0, 0)
        data.forget_commands()
        data.q[:], data.qd[:] = data.initial
        data.own[:] = self._effects.initial
        self.run.rewind()
        data.system.forget()
        self.monitor.clear()
        self._effects.restart()
        self._delay_line = DelayLine()
        data.system.tau[:] = 0.0
        health = data.system.work.health
        health[:] = 0.0
        health[t.SMALLEST_PIVOT] = health[t.SMALLEST_PIVOT_EVER] = 1.0
        data.system.passage[:] = 0.0
        data.begin_loads()
        if data.system.manifold is not None:
            self._state[-1] = 0.0
        self.run.begin()

    def description(self) -> Dict[str, Any]:
        """Return all beside the scene that a run goes on from; arguments of ``revive``."""
        data, effects = self.data, self._effects
        data.system.native.require_free()
        return {
            'records': dict(effects.records), 'enabled': dict(effects.enabled),
            'choice': data.loop_model.choice, 'exchanges': data.exchanges,
            'initial': data.initial, 'state': self.run.whole, 'base': self.run.base(),
            'residual': self.run.balance()['residual'], 'tau': data.system.tau.copy(),
            'memory': (self._delay_line, effects.sensors, effects.sensors_at_cuts),
            'pace': self.pace, 'sampling': self.monitor.sampling}

    def revive(
            self, records: Dict[str, Any], enabled: Dict[str, bool], choice: Dict[str, Any],
            exchanges: int, initial: Tuple[np.ndarray, np.ndarray], state: np.ndarray,
            base: Tuple[float, int], residual: float, tau: np.ndarray, memory: Tuple[Any, ...],
            pace: float, sampling: bool) -> None:
        """Go on from where ``description`` was called; costs and guards begin again."""
        data, effects = self.data, self._effects
        for name, record in records.items():
            if record != effects.records[name] or enabled[name] != effects.enabled[name]:
                effects.put(name, record, enabled[name])
        self.adopt_effects()
        present, model = data.system.model, data.loop_model.take(choice)
        if model is not present:
            data.use_equations(model)
        data.exchanges, data.initial = exchanges, initial
        self.run.begin()
        self.restore(state, 0.0, residual)
        self.run.set_time(*base)
        data.system.tau[:] = tau
        self._delay_line, effects.sensors, effects.sensors_at_cuts = deepcopy(memory)
        self.pace, self.monitor.sampling = pace, sampling
        self._set_budget(self.method)

    def take(self, other: 'Stepping') -> None:
        """Take over numbers and run of a simulation that this one was revived from."""
        data = self.data
        data.system.native.take_numbers(other.data.system.native)
        self._state[:] = other._state
        self.run.take(other.run)
        self._budget, self._measured = deepcopy(other._budget), other._measured
        self._passage = other._passage

    def begin_at(self, state: State) -> None:
        """Go to a single state of this mechanism, after a reset; AssemblyError."""
        data = self.data
        data.choose_equations(state.q)
        whole = self.run.whole
        for part, values in zip(data.parts, (state.q, state.qd, state.own)):
            whole[part] = values
        self.restore(whole, state.time, 0.0)
        data.require_closed(state.q, state.qd)
        self.require_step_from(state.q, state.qd)

    def begin(self) -> None:
        """Refuse steps that cannot be stable from a start, and begin to count."""
        self.stiffness.check(self._state, self.step_size)
        self._set_budget(self.method)

    def adopt_effects(self) -> None:
        """Go on with the parameters of effects, and the masses, as they are now."""
        if self._derivatives is not None:
            self._derivatives.enable_for(self.data)
        self._set_limits()

    def _set_limits(self) -> None:
        """Let the engine's run go on with the limits of the present scene."""
        self.run.set_guard_limits(
            self._guard_limits(self.method, self.stiffness), self._windings())

    def choose_equations(self, wanted: Any) -> bool:
        """
        Choose the equations that the elimination works on again, where a run asks for that.

        ``wanted``: as of ``LoopModel.choose_for_run``. Returns whether the run is to go on.
        """
        data = self.data
        chosen: Any = data.loop_model
        present, cheap = chosen.equations.kept, wanted.nearby or data.exchange_is_cheap
        goes_on = chosen.choose_for_run(self._q, wanted, BETTER if cheap else WORTH_LOOPS)
        if not np.array_equal(chosen.equations.kept, present):
            data.use_equations(chosen.model)
        return goes_on

    @property
    def fastest_rate(self) -> float:
        """Estimate of the fastest rate of the motion in the present state [1/s]."""
        return self.stiffness.rate(self._state)

    def judge(self) -> None:
        """As ``check_energy``, without a warning of a small error."""
        outcome = self.run.check_energy()
        if outcome == ENERGY_LOST:
            self._tell(outcome)

    def _raise_failure(self, report: Any) -> NoReturn:
        """Raise what has ended the run."""
        data, status, size = self.data, report.status, report.size
        if status == INTERRUPTED:
            # Another thread was.
            raise KeyboardInterrupt
        beyond = data.motions.advice_on_stopping(
            data.assembler, self._q, data.time, self.step_size)
        if beyond:
            raise MotionError(
                f'The motion cannot go on at t = {data.time:.9g} s; the state before is kept. '
                f'{beyond}')
        # What stopped it may be a cable at its limit, or steps that cannot be stable.
        explain(data)
        self.stiffness.check(self._state, size)
        stopped, undecided = failure(data, status, size), self._branch_finding()
        raise type(stopped)(' '.join(
            [str(stopped), *(f'Before that, {one}' for one in undecided)]))

    def _branch_finding(self) -> List[str]:
        """Return a finding where a change point was passed that the lengths miss by little."""
        present = self.data.system.passage.tobytes()
        if self._passage[0] != present:
            self._passage = present, list(change_points.finding(
                self.data.mechanism, self.data.equations, self.data.system.passage))
        return self._passage[1]

    def require_admissible(self, tau: np.ndarray) -> None:
        """
        Refuse joint torques, of ``joint_torques``, that no step from the present state can follow.

        NumericalError where a joint would move by more than LARGEST_MOTION within a step; nothing
        is changed.
        """
        largest_torque = np.abs(tau).max(initial=0.0)
        if largest_torque <= USUAL_TORQUE:
            return
        system, before = self.data.system, self.data.system.tau.copy()
        system.tau[:] = tau
        self.data.evaluate()
        system.tau[:] = before
        motion = np.abs(system.qdd).max(initial=0.0) * self.step_size ** 2
        if not (motion <= LARGEST_MOTION and np.isfinite(self.data.table.rates).all()):
            raise NumericalError(
                f'torque: expected torques that a step of {self.step_size:g} s can follow, got '
                f'up to {largest_torque:.3g} (N m or N), by which a joint would move by '
                f'{motion:.3g} rad or m; at most {LARGEST_MOTION:g} can be followed. The state '
                'and the torques before are kept.')

    def set_state(
            self, position: Numbers, velocity: Optional[Numbers] = None,
            hold: Optional[Sequence[str]] = None) -> None:
        """As ``Simulation.set_state``."""
        data = self.data
        data.system.native.require_free()
        state = data.near(position, velocity, hold)
        data.choose_equations(state[0])
        if self.method.stabilisation == 'independent':
            data.assembler.require_independent(state[0])
        self.require_step_from(*state)
        self.run.add_work()
        self.run.find_start()
        before = data.energy
        data.q[:], data.qd[:] = state
        self._effects.reset_states(data.own)
        self.run.restart(True)
        self.run.jump()
        data.begin_loads()
        self.run.jump_balance(data.energy - before)

    def require_step_from(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Refuse a state from which a step cannot be made."""
        data = self.data
        fastest = np.abs(velocity).max(initial=0.0)
        if not fastest * self.step_size <= LARGEST_MOTION:
            raise AssemblyError(
                f'The largest velocity is {fastest:.3g} rad/s or m/s, so that a joint would move '
                f'by {fastest * self.step_size:.3g} rad or m in a step of {self.step_size:g} s; '
                f'at most {LARGEST_MOTION:g} can be followed.')
        trial, health = self._state.copy(), data.system.work.health.copy()
        places, rates, own = (trial[part] for part in data.parts)
        own[self._effects.own] = self._effects.initial[self._effects.own]
        places[:], rates[:] = position, velocity
        status = NOT_FINITE
        if np.isfinite(trial).all():
            status = self.run.try_step(trial, self.step_size)
        data.system.work.health[:] = health
        if status not in (DONE, POOR_EQUATIONS, CONTACT_PASSED):
            raise AssemblyError(
                f'From this state not even a step of {self.step_size:g} s can be made: '
                + ('the numbers grow beyond all bounds'
                   if status == NOT_FINITE else 'the loops cannot be closed after it'
                   if status == OPEN_LOOP else 'it takes too many evaluations'
                   if status == TOO_MUCH_WORK else 'no part of it keeps the tolerance')
                + f'. Take smaller velocities (largest now {fastest:.3g} rad/s or m/s), or a '
                'smaller step.')

    def set_effect(
            self, name: str, enabled: Optional[bool] = None,
            **parameters: Any) -> None:
        """As ``Simulation.set_effect``."""
        data = self.data
        data.system.native.require_free()
        self.run.find_start()
        before, undo = data.energy, self._effects.trial()
        try:
            restarted = self._try_effect(name, enabled, parameters, undo)
        except Exception:
            undo()
            raise
        self.run.add_work()
        data.own[restarted] = self._effects.initial[restarted]
        self.adopt_effects()
        self._effects.begin_at_time(data.own, data.time)
        if data.has_redundant_constraints and not data.may_leave_out(self.method):
            data.use_equations(data.loop_model.select(None))
        self.run.restart(False)
        self.run.jump()
        if len(restarted):
            data.begin_loads()
        self.run.jump_balance(data.energy - before)
        if self._effects.records[name].depends_on_reactions:
            for note in data.load_notes():
                warnings.warn(note, RuntimeWarning, stacklevel=2)

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
        self.data.system.native.require_free()
        undo = self._effects.trial()
        try:
            self._try_effect(name, enabled, parameters, undo)
        finally:
            undo()

    def _try_effect(
            self, name: str, enabled: Optional[bool],
            parameters: Dict[str, Any], undo: Callable[[], None]) -> np.ndarray:
        """
        Change an effect, unless steps that can be stable now could not be with it.

        ``undo`` leads back to the effects before; where the change is refused, it is to be called.
        """
        data, effects = self.data, self._effects
        data.motions.require_continued(
            name, effects.checked(name, enabled, parameters), enabled, data.time)
        restarted = effects.change(name, enabled, parameters)
        data.require_finite_laws()
        if effects.records[name].STIFFENS:
            try:
                self.stiffness.check(self._state, self.step_size)
            except StiffnessError:
                undo()
                if self.stiffness.stable(self._state, self.step_size):
                    raise
                # It has been too stiff before: a change may be for the better.
                restarted = effects.change(name, enabled, parameters)
        return restarted

    def command_motion(self, commands: Mapping[str, Tuple[Any, ...]]) -> None:
        """As ``Simulation.command_motion``."""
        profiles = self.data.motions.profiles(commands, self.data.time)
        for name, keys in profiles.items():
            record = self._effects.checked(name, None, keys)
            fastest = max(abs(record.at(time)[1]) for time in instants(keys['times']))
            if not fastest * self.step_size <= LARGEST_MOTION:
                with at('effects', name):
                    raise FieldError(
                        f'a rate of at most {LARGEST_MOTION / self.step_size:g} rad/s or m/s',
                        f'{fastest:.3g}', path=('rates',))
        for name, keys in profiles.items():
            self.set_effect(name, **keys)

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
        data = self.data
        data.system.native.require_free()
        method = replace(self.method, **changes)
        self.require_known_steps(method)
        self._require_closable(method.stabilisation)
        before, independent = (data.exchanges, self._methods), (
            method.stabilisation == 'independent')
        needs_all = data.has_redundant_constraints and not data.may_leave_out(method)
        system = with_equations(
            data.system, data.loop_model.model_of(None)[0]) if needs_all else data.system
        system = with_partition(system, independent)
        guard = StiffnessGuard(system, method, self._effects.own)
        guard.check(self._state, method.step_size)
        run = self.new_run(system, method, guard)
        run.try_step(self._state.copy(), 1e-9)

        def take_effect() -> None:
            if (data.exchanges, self._methods) != before:
                # Equations, or the method, have been exchanged since.
                self.prepare_method(**changes)()
                return
            if needs_all:
                data.use_equations(data.loop_model.select(None))
            data.system.use_independent(independent)
            self._methods += 1
            self.run.set_time(data.time, 0)
            self.run.take_method(run)
            self.monitor = Monitor(method, self.run)
            data.scene = replace(data.scene, method=method)
            self.stiffness = StiffnessGuard(data.system, method, self._effects.own)
            self._set_limits()
            self.run.restart_guards()
            self._set_budget(method)
            data.system.settings.baumgarte_gain[...] = (
                1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0)
            self.run.restart(False)
            self.run.jump()

        return take_effect

    def _require_closable(self, stabilisation: str) -> None:
        """Refuse a stabilisation that cannot start from the present state."""
        data = self.data
        if stabilisation != 'none' and data.closure > data.system.settings.closure_limit:
            raise ClosureError(
                f'The loops have drifted apart by {data.closure:.3g} m or rad: more than '
                f'stabilisation: {stabilisation} may close. Reset, or set a state, first.')
        if stabilisation == 'independent':
            data.assembler.require_independent(data.q)

    def report(self) -> RunReport:
        """As ``Simulation.report``."""
        data = self.data
        residual = self.run.record_energy()['residual']
        undecided = self._branch_finding()
        report = self.monitor.report(
            data.system.work.health, data.closure,
            residual - self.run.report.first_residual, self.energy_guard,
            (*data.load_notes(), *undecided), self._budget)
        return report if not undecided else replace(
            report, error_bound=math.nan, present_bound=math.nan, branch_undecided=True)

    def restore(
            self, state: ArrayLike, time: float,
            residual: Optional[float] = None) -> None:
        """As ``Simulation.restore``; ``residual``: of the energy balance in that state [J]."""
        self.data.system.native.require_free()
        state = vector('state', state, self.run.whole_length())
        if residual is None:
            residual = self.run.balance()['residual']
        self.run.find_start()
        steps = round(time / self.step_size)
        exact = steps * self.step_size == time
        self.run.set_time(*((0.0, steps) if exact else (time, 0)))
        self._effects.restart()
        self.run.recall(state)
        self.run.restart(False)
        self.run.jump()
        self.run.jump_balance(self.run.balance()['residual'] - residual)


def _whole(steps: Any) -> int:
    """Return a number of steps as Python's own, or refuse it."""
    if isinstance(steps, np.integer) and steps >= 0:
        return int(steps)
    raise ValueError(f'steps: expected a whole number >= 0, got {steps!r}')


def instants(times: Sequence[float]) -> np.ndarray:
    """Return times and some between them [s]."""
    all_times = np.array(times)
    between = [all_times[:-1] + share * np.diff(all_times) for share in (0.0, 0.25, 0.5, 0.75)]
    return np.concatenate([*between, all_times[-1:]])
