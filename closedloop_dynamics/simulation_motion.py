# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""How a simulation moves on: steps, commands on their way, resets."""

from dataclasses import replace
import math

import numpy as np

from .core import types as t
from .core.independent import allocate_partition
from .drift import DriftGuard
from .effects.commands import Commands
from .errors import ClosureError, NumericalError, SimulationError
from .integration.advance import DONE, NOT_FINITE, OPEN_LOOP
from .integration.drivers import build_driver
from .integration.registry import INTEGRATORS, SCIPY
from .integration.system import BAUMGARTE, CLOSURE_LIMIT
from .modeling import extent
from .monitor import Monitor
from .scene_records import AUTO
from .simulation_state import SimulationState
from .stiffness import Look, LOOK_EVERY, StiffnessGuard


class SimulationMotion(SimulationState):
    """
    A state that is advanced by the scene's method; the base of ``Simulation``.

    Parameters
    ----------
    scene : scene.Scene
        What moves, and by which method.

    """

    def __init__(self, scene):
        """Build the driver, and stand at the start."""
        super().__init__(scene)
        method = self.scene.method
        self._require_settled_steps(method)
        self._driver = Monitor(build_driver(self.system, method), self.system, method)
        self._guard = StiffnessGuard(self.system, method, self._effects.own)
        self._drift = DriftGuard(method, extent(self.mechanism))
        self.reset()

    def _require_settled_steps(self, method):
        """Refuse solvers that keep a state of their own beside effects that correct theirs."""
        names = self._effects.settling
        if names and INTEGRATORS[method.integrator].family == SCIPY:
            own = [name for name, one in INTEGRATORS.items() if one.family != SCIPY]
            raise SimulationError(
                f'The scene lists dry friction ({", ".join(names)}), whose bristle is brought '
                f'back within its limit after every step; {method.integrator} keeps a state of '
                'its own between outputs, where that cannot be done, and friction would not let '
                f'go where it reverses. Take another integrator ({", ".join(own)}), or leave the '
                'friction out.')

    def step(self, torque=None, duration=None):
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
        tau = self.joint_torques(torque)
        size = self.step_size
        if duration is None:
            return self.advance(tau, 1)
        if not (math.isfinite(duration) and duration >= 0.0):
            raise ValueError(f'duration: expected a finite number >= 0 [s], got {duration!r}')
        whole = math.floor(duration / size * (1.0 + 1e-12) + 1e-9)
        self.advance(tau, whole)
        rest = duration - whole * size
        if rest > 1e-9 * size:
            self._advance(rest, 1)

    def advance(self, tau, steps):
        """
        Advance by whole steps under constant joint torques; the fast path of ``step``.

        Parameters
        ----------
        tau : ndarray, shape (nv,)
            Joint torques [N m or N], finite.
        steps : int
            Number of steps.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.

        """
        if not self._delayed():
            self._command(tau)
            self._advance(self.step_size, steps)
            return
        self._commands.order(self.time, tau, self._effects.drives, self.system.tau)
        while True:
            self._command(self._commands.due(
                self.time, 1e-9 * self.step_size, self.system.tau))
            if steps <= 0:
                break
            count = self._commands.steps_until_next(self.time, self.step_size, steps)
            self._advance(self.step_size, count)
            steps -= count

    def _delayed(self):
        """Return whether any command is, or will be, on its way to a drive."""
        return self._commands.pending or any(self._effects.drives.values())

    def _command(self, tau):
        """Let joint torques act from now on."""
        if not np.array_equal(tau, self.system.tau):
            self._accounts.settle(self._q, self.system.tau)
            self._driver.restart()
            self.system.tau[:] = tau
            self._fresh = False

    def _advance(self, size, steps):
        """Advance by steps of one size, and look at what drifts now and then."""
        while steps > 0 and self._drift.active:
            portion = min(steps, self._drift.until_look)
            self._advance_measured(size, portion)
            self._drift.look(self, portion)
            steps -= portion
        if steps > 0:
            self._advance_measured(size, steps)
            self._drift.count(self, steps)

    def _advance_measured(self, size, steps):
        """Advance by steps of one size; on failure keep what was done and raise."""
        if self._effects.remembers:
            self.measured()
            for _ in range(steps):
                self._advance_unseen(size, 1)
                self.measured()
        else:
            self._advance_unseen(size, steps)

    def _advance_unseen(self, size, steps):
        if not self._guard.active:
            self._advance_unguarded(size, steps)
            return
        while steps > 0:
            if self._look is None:
                self._look = Look(self.energy_balance, self._state.copy(), self.time)
            portion = min(steps, LOOK_EVERY - self._look.steps)
            try:
                self._advance_unguarded(size, portion)
            except SimulationError:
                self._guard.check(self._state, size)
                raise
            steps -= portion
            self._look.steps += portion
            if self._look.steps == LOOK_EVERY:
                self._compare(size)

    def _compare(self, size):
        """Refuse to go on where energy has appeared from nowhere since the latest look."""
        look, self._look = self._look, None
        balance = self.energy_balance
        try:
            self._guard.check_energy(look.balance, balance, self._state, size)
        except SimulationError:
            self._state[:], self._fresh = look.state, False
            self._time_base, self._steps = look.time, 0
            self._driver.restart()
            raise
        self._look = Look(balance, self._state.copy(), self.time)

    def _advance_unguarded(self, size, steps):
        self._fresh = False
        status, elapsed = self._driver.advance(self._state, self.time, size, steps)
        if status == DONE and size == self.step_size:
            self._steps += steps
            return
        self._time_base += elapsed
        if status == NOT_FINITE:
            raise NumericalError(
                f'The state left the finite numbers at t = {self.time:.9g} s; the last finite '
                f'state is kept. Take a smaller step than {size:g} s, or smaller torques '
                f'(largest now {np.abs(self.system.tau).max(initial=0.0):g}).')
        if status == OPEN_LOOP:
            raise ClosureError(
                f'The loops could not be closed after the step at t = {self.time:.9g} s (error '
                f'{self.system.work.health[t.CLOSURE]:.3g}); the state before it is kept. Take a '
                f'smaller step than {size:g} s: the motion in one step is too large.')
        if status != DONE:
            raise NumericalError(
                f'No step at t = {self.time:.9g} s is small enough to keep the error below '
                f'the tolerance {self.scene.method.tolerance:g}; the last good state is kept. The '
                'motion is not smooth there: loosen the tolerance, or take a fixed step.')

    def joint_torques(self, torque):
        """
        Return joint torques as an array from any form that ``step`` takes.

        Parameters
        ----------
        torque : mapping, sequence or None
            By joint name, or in the order of the actuated joints.

        Returns
        -------
        ndarray, shape (nv,)

        Raises
        ------
        ValueError

        """
        tau = np.zeros(len(self.joint_names))
        if torque is None:
            return tau
        if hasattr(torque, 'items'):
            for name, value in torque.items():
                if name not in self.actuated_joints:
                    raise ValueError(f'torque: expected actuated joints '
                                     f'({", ".join(self.actuated_joints)}), got {name!r}')
                tau[self.joint_names.index(name)] = value
        else:
            values = np.array(torque, dtype=float)
            if values.shape != (len(self._actuated),):
                raise ValueError(
                    f'torque: expected {len(self._actuated)} values, for '
                    f'{", ".join(self.actuated_joints)}; got shape {values.shape}')
            tau[self._actuated] = values
        # The sum of squares is finite where all are, and quicker to tell; it may overflow alone.
        if not (math.isfinite(tau.dot(tau)) or np.isfinite(tau).all()):
            raise ValueError(f'torque: expected finite numbers, got {torque!r}')
        return tau

    def reset(self):
        """Return to the initial state, time zero and no torque."""
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._driver.rewind()
        self._effects.restart()
        self._commands = Commands()
        self.system.tau[:] = 0.0
        self._time_base, self._steps, self._fresh, self._look = 0.0, 0, False, None
        self.system.work.health[:] = 0.0
        self.system.work.health[[t.SMALLEST_PIVOT, t.SMALLEST_PIVOT_EVER]] = 1.0
        self._feel_loads()
        self._accounts.restart(self._q)
        self._drift.restart()
        self._guard.check(self._state, self.step_size)

    def set_step_size(self, step_size):
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
        self._guard.check(self._state, method.step_size)
        self._take_method(method)

    def prepare_method(self, **changes):
        """
        Check and compile another method, leaving everything as it is.

        Parameters
        ----------
        **changes
            By the keys that a scene has under ``method``, except ``formulation``.

        Returns
        -------
        callable
            Lets the method take effect, from the next step on; time and state go on, the
            account of cost and local error starts anew.

        Raises
        ------
        ValueError
            Where a name or value makes no sense.
        SimulationError
            Where the scene is too stiff for the method, or its closure equations here too
            dependent or its loops too far open.

        """
        method = replace(self.scene.method, **changes)
        if method.integrator == AUTO or method.formulation != self.scene.method.formulation:
            raise ValueError('method: integrator auto and the formulation are chosen when a '
                             'scene is loaded, and stay')
        self._require_settled_steps(method)
        self._require_closable(method.stabilisation)
        system = self.system._replace(partition=allocate_partition(
            self.system.model) if method.stabilisation == 'independent' else None)
        guard = StiffnessGuard(system, method)
        guard.check(self._state, method.step_size)
        driver = build_driver(system, method)
        driver.advance(self._state.copy(), self.time, 1e-9, 1)
        driver.restart()
        self._fresh = False

        def take_effect():
            self.system, self._guard = system, guard
            self._driver = Monitor(driver, system, method)
            self._take_method(method)

        return take_effect

    def _require_closable(self, stabilisation):
        """Refuse a stabilisation that cannot start from the present state."""
        if stabilisation != 'none' and self.closure > self.system.settings[CLOSURE_LIMIT]:
            raise ClosureError(
                f'The loops have drifted apart by {self.closure:.3g} m or rad: more than '
                f'{stabilisation} may be asked to close. Reset, or set a state, first.')
        if stabilisation == 'independent':
            self._fresh = False
            self._assembler.require_independent(self._q)

    def _take_method(self, method):
        self._time_base, self._steps = self.time, 0
        self.scene = replace(self.scene, method=method)
        self._drift = DriftGuard(method, extent(self.mechanism))
        self.system.settings[BAUMGARTE] = (
            1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0)
        self._driver.restart()
        self._fresh, self._look = False, None

    def set_state(self, position, velocity=None, hold=None):
        """
        Move to another state, assembled.

        Parameters
        ----------
        position : sequence, shape (nv,)
            Approximate joint coordinates.
        velocity : sequence, shape (nv,), optional
            Approximate joint rates; zero when not given.
        hold : sequence of str, optional
            Joints kept as given; none when not given: the nearest closed state is taken.

        Raises
        ------
        AssemblyError
            The present state is kept.

        """
        state = self._assembled(position, velocity, hold or ())
        if self.scene.method.stabilisation == 'independent':
            self._assembler.require_independent(state[0])
        self._accounts.settle(self._q, self.system.tau)
        self._open_accounts()
        before = self.energy
        self._q[:], self._qd[:] = state
        self._effects.start_anew(self._own)
        self._driver.restart()
        self._drift.restart()
        self._fresh, self._look = False, None
        self._feel_loads()
        self._accounts.jump(self._q, self.energy - before)

    def warm_up(self):
        """
        Compile all that a run needs, leaving the state as it is.

        Not the rank-revealing path, which takes several times as long as all the rest: that is
        compiled, once for an installation, where a mechanism first needs it.

        """
        self._driver.driver.advance(self._state.copy(), self.time, 1e-9, 1)
        self._driver.restart()
        self._fresh = False
        self.constraint_forces, self.energy, self.closure

    @property
    def monitor(self):
        """Return what keeps account of cost and local error, a ``monitor.Monitor``."""
        return self._driver

    def report(self):
        """
        Tell what the run has cost since the start or the last reset, and how far off it may be.

        Returns
        -------
        monitor.RunReport

        """
        return self._driver.report(self.closure, self.energy_balance.residual)
