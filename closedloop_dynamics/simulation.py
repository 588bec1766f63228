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

"""A scene brought to life: the Python interface that users script with."""

from dataclasses import replace
import math

import numpy as np

from .assembly import Assembler
from .core import energy, jacobian, kinematics, loop_closure
from .core import types as t
from .core.formulations import AUGMENTED, SUBSYSTEM, SYSTEM
from .core.forward_dynamics import to_user_order
from .core.inverse_dynamics import tree_torque
from .effects import dispatch, joint_reaction
from .effects.accounts import Accounts
from .effects.commands import Commands
from .effects.composition import Composition
from .effects.machine import Machine
from .errors import ClosureError, NumericalError, SimulationError
from .health import health_of
from .integration.advance import DONE, NOT_FINITE, OPEN_LOOP
from .integration.drivers import build_driver
from .integration.projection import largest
from .integration.system import BAUMGARTE, build_system, evaluate, number_of_states
from .mechanism.decomposition import decompose
from .mechanism.mechanism import CUT_JOINT_EQUATIONS, PRISMATIC, REVOLUTE
from .method_choice import resolved
from .modeling import body_rows, build_model, extent
from .monitor import Monitor
from .scene import load_scene
from .scene_records import AUTO
from .stiffness import Look, LOOK_EVERY, StiffnessGuard

FORMULATIONS = {'subsystem': SUBSYSTEM, 'system': SYSTEM, 'augmented': AUGMENTED}


class Simulation:
    """
    One mechanism, its state, and the method that advances it.

    Parameters
    ----------
    scene : scene.Scene
        The initial state is assembled: positions and velocities close the loops.

    Attributes
    ----------
    scene : scene.Scene
    mechanism : mechanism.mechanism.Mechanism
    decomposition : mechanism.decomposition.Decomposition
    method_report : str
        What ``integrator: auto`` chose, and what that costs; empty where the scene chose itself.

    Raises
    ------
    AssemblyError
        Where the loops cannot be closed from the scene's initial state.

    """

    def __init__(self, scene):
        """Build the model, assemble the initial state."""
        scene, self.method_report = resolved(scene, type(self))
        self.scene = scene
        self.mechanism = scene.mechanism
        self.decomposition = decompose(self.mechanism)
        self._rows = body_rows(self.mechanism, self.decomposition)
        model = build_model(self.mechanism, decomposition=self.decomposition)
        self._effects = Composition(scene.effects, model, Machine(self.mechanism, self._rows))
        method = scene.method
        baumgarte = 1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0
        size = extent(self.mechanism)
        self.system = build_system(
            model, FORMULATIONS[method.formulation], baumgarte, size,
            method.stabilisation == 'independent', self._effects.laws)
        self._table = self._effects.bind(self.system)
        self._accounts = Accounts(self._effects)
        self._driver = Monitor(build_driver(self.system, method), self.system, method)
        self._guard = StiffnessGuard(self.system, method)
        nv = len(self.mechanism.joints)
        self._state = np.zeros(number_of_states(self.system))
        self._q, self._qd = self._state[:nv], self._state[nv:2 * nv]
        self._own = self._state[2 * nv:]
        self._assembler = Assembler(self.mechanism, model, self.system.work, size)
        self._actuated = np.array([k for k, joint in enumerate(self.mechanism.joints)
                                   if joint.actuated], dtype=int)
        self._points = {point.name: point for point in self.mechanism.points}
        self._initial = self._assembled(
            scene.initial.position, scene.initial.velocity, scene.initial.hold)
        if method.stabilisation == 'independent':
            self._assembler.require_independent(self._initial[0])
        self.reset()

    @classmethod
    def from_scene(cls, name_or_path, **method):
        """
        Build a simulation from a scene.

        Parameters
        ----------
        name_or_path : str or pathlib.Path
            A shipped scene's name or a scene file's path.
        **method
            Overrides of the scene's method, by the keys a scene has there (``integrator``,
            ``step_size``, ``stabilisation``, ``formulation``, ...); None leaves the scene's.

        Returns
        -------
        Simulation

        Raises
        ------
        SceneError, AssemblyError

        """
        scene = load_scene(name_or_path)
        overrides = {key: value for key, value in method.items() if value is not None}
        if overrides.get('integrator', AUTO) != AUTO:
            overrides.setdefault('accuracy', None)
        return cls(replace(scene, method=replace(scene.method, **overrides)))

    # Names and sizes.

    @property
    def joint_names(self):
        """Names of the joints, in the order of positions and velocities."""
        return self.mechanism.joint_names

    @property
    def actuated_joints(self):
        """Names of the actuated joints, in the order of torque sequences."""
        return self.mechanism.actuated_joints

    @property
    def cut_joints(self):
        """Return the cut joints, in the order of the constraint forces."""
        return self.mechanism.cut_joints

    @property
    def step_size(self):
        """Step size [s]."""
        return self.scene.method.step_size

    # The state.

    @property
    def time(self):
        """Time since the start or the last reset [s]."""
        # Counted, not summed: an hour of steps adds up to an hour.
        return self._time_base + self._steps * self.step_size

    @property
    def position(self):
        """Joint coordinates, shape (nv,) [rad or m]."""
        return self._q.copy()

    @property
    def velocity(self):
        """Joint rates, shape (nv,) [rad/s or m/s]."""
        return self._qd.copy()

    @property
    def effort(self):
        """Joint torques applied last, behind the drives, shape (nv,) [N m or N]."""
        tau = self.system.tau.copy()
        if self._effects.drives:
            self._evaluate()
            self._effects.efforts(tau)
        return tau

    @property
    def acceleration(self):
        """Joint accelerations of the present state under the last torques, shape (nv,)."""
        self._evaluate()
        return self.system.qdd.copy()

    @property
    def multipliers(self):
        """Lagrange multipliers of the present state, shape (nc,) [N, N m]."""
        self._evaluate()
        return self.system.lam.copy()

    @property
    def constraint_forces(self):
        """
        Wrenches at the cut joints, shape (number of cuts, 3): moment, force x, force y.

        What body B exerts on body A, in world axes, at body A's cut point [N m, N].

        """
        self._evaluate()
        out = np.zeros((len(self.cut_joints), 3))
        first = 0
        for wrench, cut in zip(out, self.cut_joints):
            lam = self.system.lam[first:first + CUT_JOINT_EQUATIONS[cut.type]]
            first += len(lam)
            if cut.type == PRISMATIC:
                angle = self.system.work.body[self._rows[cut.body_b], t.ALPHA] + cut.angle
                wrench[:] = lam[1], -math.sin(angle) * lam[0], math.cos(angle) * lam[0]
            else:
                wrench[1:] = lam[:2]
                wrench[0] = 0.0 if cut.type == REVOLUTE else lam[2]
        return out

    @property
    def closure(self):
        """Largest closure error of positions [m or rad]."""
        self._evaluate()
        return float(largest(self.system.work.closure))

    @property
    def energy(self):
        """Kinetic energy and energy stored in gravity and effects [J]."""
        return sum(self._energies())

    @property
    def energy_balance(self):
        """Energy balance since the last reset, an ``effects.accounts.EnergyBalance`` [J]."""
        self._open_accounts()
        self._accounts.settle(self._q, self.system.tau)
        return self._accounts.balance(self._own, *self._energies())

    def _open_accounts(self):
        """Find the energy at the start, when it is needed for the first time."""
        if self._accounts.started:
            return
        present = self._state.copy()
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._fresh = False
        self._accounts.start(self.energy)
        self._state[:] = present
        self._fresh = False

    def _feel_loads(self):
        """Let effects that are driven by the reaction in a joint start with what it is."""
        if self._table.loaded[0] > 0:
            # A fixed point: friction changes the reactions a little.
            for _ in range(20):
                self._fresh = False
                self._evaluate()
                places, values = self._effects.loads()
                self._own[places] = values
            self._fresh = False

    def _energies(self):
        """Return kinetic and stored energy of the present state."""
        self._evaluate()
        model, work = self.system.model, self.system.work
        return (energy.kinetic_energy(model, work, self._qd),
                energy.potential_energy(model, work) + self._effects.stored())

    @property
    def body_poses(self):
        """Poses of the bodies, shape (nb, 3): x, y [m], angle [rad], in the bodies' order."""
        self._evaluate()
        rows = [self._rows[body.name] for body in self.mechanism.bodies]
        return self.system.work.body[np.ix_(rows, (t.PX, t.PY, t.ALPHA))]

    def point(self, name):
        """Return the world place of a named point, shape (2,) [m]."""
        point = self._named_point(name)
        self._evaluate()
        out = np.zeros(2)
        kinematics.point_position(self.system.work, self._rows[point.body], *point.position, out)
        return out

    def _named_point(self, name):
        if name not in self._points:
            raise SimulationError(
                f'There is no point {name!r} on {self.mechanism.name}; its points: '
                f'{", ".join(self._points) or "none"}.')
        return self._points[name]

    # Motion.

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
        try:
            self._guard.check_energy(look.balance, self.energy_balance, self._state, size)
        except SimulationError:
            self._state[:], self._fresh = look.state, False
            self._time_base, self._steps = look.time, 0
            self._driver.restart()
            raise

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
            values = np.asarray(torque, dtype=float)
            if values.shape != (len(self._actuated),):
                raise ValueError(
                    f'torque: expected {len(self._actuated)} values, for '
                    f'{", ".join(self.actuated_joints)}; got shape {values.shape}')
            tau[self._actuated] = values
        if not np.isfinite(tau).all():
            raise ValueError(f'torque: expected finite numbers, got {torque!r}')
        return tau

    def reset(self):
        """Return to the initial state, time zero and no torque."""
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._driver.restart()
        self._driver.clear()
        self._effects.restart()
        self._commands = Commands()
        self.system.tau[:] = 0.0
        self._time_base, self._steps, self._fresh, self._look = 0.0, 0, False, None
        self.system.work.health[:] = 0.0
        self.system.work.health[[t.SMALLEST_PIVOT, t.SMALLEST_PIVOT_EVER]] = 1.0
        self._feel_loads()
        self._accounts.restart(self._q)
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
        self._time_base, self._steps = self.time, 0
        self.scene = replace(self.scene, method=method)
        if method.stabilisation == 'baumgarte':
            self.system.settings[BAUMGARTE] = 1.0 / method.time_constant
        self._driver.restart()
        self._fresh, self._look = False, None

    @property
    def health(self):
        """How well posed the equations of motion are in the present state: a ``Health``."""
        self._evaluate()
        return health_of(self.system.work, self.mechanism.number_of_equations)

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
        self._accounts.settle(self._q, self.system.tau)
        self._open_accounts()
        before = self.energy
        self._q[:], self._qd[:] = state
        self._effects.start_anew(self._own)
        self._driver.restart()
        self._fresh = False
        self._feel_loads()
        self._accounts.jump(self._q, self.energy - before)

    def _assembled(self, position, velocity, hold):
        nv = len(self.joint_names)
        q = _vector('position', position, nv)
        qd = np.zeros(nv) if velocity is None else _vector('velocity', velocity, nv)
        # The assembler works in the same workspace, whether it succeeds or not.
        self._fresh = False
        q = self._assembler.positions(q, hold)
        return q, self._assembler.velocities(q, qd, hold)

    # Effects.

    @property
    def effects(self):
        """Return the listed effects, with their present parameters: records by name."""
        return dict(self._effects.records)

    @property
    def enabled_effects(self):
        """Names of the effects that are switched on."""
        return tuple(name for name, enabled in self._effects.enabled.items() if enabled)

    def set_effect(self, name, enabled=None, **parameters):
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

        Notes
        -----
        An energy that appears or vanishes with the change (a spring that is switched on
        stretched) is not booked as work: the energy balance goes on from the new energy.

        """
        self._accounts.settle(self._q, self.system.tau)
        self._open_accounts()
        before = self.energy
        anew = self._effects.change(name, enabled, parameters)
        self._own[anew] = self._effects.initial[anew]
        self._driver.restart()
        self._fresh = False
        if len(anew):
            self._feel_loads()
        self._accounts.jump(self._q, self.energy - before)

    def check_effect(self, name, enabled=None, **parameters):
        """
        Refuse, as ``set_effect`` would, a change that makes no sense; change nothing.

        Parameters
        ----------
        name, enabled, **parameters
            As for ``set_effect``.

        Raises
        ------
        ValueError

        """
        self._effects.checked(name, enabled, parameters)

    def measured(self):
        """
        Return what the scene's sensors show of the present state; the true one without any.

        Returns
        -------
        position, velocity : ndarray, shape (nv,)

        """
        position, velocity = self._effects.measure(self.time, self._q, self._qd)
        return position.copy(), velocity.copy()

    def effect_readings(self, name):
        """
        Return what an effect says of itself in the present state.

        Parameters
        ----------
        name : str
            Of an effect that the scene lists.

        Returns
        -------
        dict of str to float
            Stored energy [J] and the effect's own readings, such as forces; SI units.

        """
        self._evaluate()
        return self._effects.readings(name)

    def warm_up(self):
        """Compile all that a run needs, leaving the state as it is."""
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

    # Dynamics of any state.

    def forward_dynamics(self, position, velocity, torque=None):
        """
        Compute accelerations and multipliers of a state that closes the loops.

        Parameters
        ----------
        position, velocity : sequence, shape (nv,)
            State, closing the loops.
        torque : mapping, sequence or None
            As for ``step``.

        Returns
        -------
        acceleration : ndarray, shape (nv,)
        multipliers : ndarray, shape (nc,)

        """
        nv, system = len(self.joint_names), self.system
        q, qd = _vector('position', position, nv), _vector('velocity', velocity, nv)
        applied = system.tau.copy()
        system.tau[:] = self.joint_torques(torque)
        self._table.states[:] = self._own
        evaluate(system, q, qd)
        system.tau[:] = applied
        self._fresh = False
        return system.qdd.copy(), system.lam.copy()

    def inverse_dynamics(self, position, velocity, acceleration):
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

        Notes
        -----
        Solves tau + tau_effects + J^T lambda = I qdd + c, tau zero at the joints that are not
        actuated. The torques are those at the joints, after limits and lags of the drives; dry
        friction is that of a steady motion, none where a joint rests.

        """
        nv, model, work = len(self.joint_names), self.system.model, self.system.work
        q, qd, qdd = (_vector(name, values, nv) for name, values in (
            ('position', position), ('velocity', velocity), ('acceleration', acceleration)))
        self._fresh = False
        jac = np.zeros((self.mechanism.number_of_equations, nv))
        bias = np.zeros(len(jac))
        kinematics.outward(model, q, qd, work)
        jacobian.constraint_jacobian(model, work, jac)
        loop_closure.update(model, work, False)
        to_user_order(model, work.bias, bias)
        part = np.abs(jac @ qdd + bias).max(initial=0.0)
        # Beside its own size, what is left by rounding of the accelerations it is a difference of.
        noise = 1e-12 * np.abs(work.body[:, [t.AX, t.AY]]).max()
        if part > noise + 1e-8 * max(
                np.abs(jac * qdd).max(initial=0.0), np.abs(bias).max(initial=0.0)):
            raise SimulationError(
                f'This acceleration opens the loops: the cut joints would part at {part:.3g} '
                'm/s^2. Give accelerations of all joints that belong together, such as those '
                'that forward_dynamics returns.')
        table = self._table
        while True:
            need = self._needed(q, qd, qdd)
            torque, lam = self._least_torques(need, jac)
            if table.loaded[0] == 0:
                return torque, lam
            # Friction driven by reactions depends on the result: a fixed point, fast because
            # friction is the smaller part.
            joint_reaction.load(model, work, table, qdd, lam)
            places, values = self._effects.loads()
            change = np.abs(table.states[places] - values).max()
            table.states[places] = values
            if not change > 1e-12 * values.max():
                return torque, lam

    def _needed(self, q, qd, qdd):
        """Return what torques and constraint forces must add up to at the joints."""
        need, table, work = np.zeros(len(q)), self._table, self.system.work
        kinematics.outward(self.system.model, q, qd, work)
        if len(table.kind):
            self._effects.steady(qd)
            dispatch.apply(work.body, table, q, qd, np.zeros(len(q)))
            self._effects.unsteady()
            joint_reaction.remember(work.body, table)
        tree_torque(self.system.model, work, qdd, need)
        return need - table.applied if len(table.kind) else need

    def _least_torques(self, need, jac):
        """Return the least torques of the actuated joints, and multipliers, that add up to it."""
        passive = np.setdiff1d(np.arange(len(need)), self._actuated)
        unknowns = np.concatenate([np.eye(len(need))[:, self._actuated], jac.T], axis=1)
        solution = np.linalg.lstsq(unknowns, need, rcond=1e-12)[0]
        left = np.abs(unknowns @ solution - need)[passive].max(initial=0.0)
        if left > 1e-8 * max(np.abs(need).max(), 1e-30):
            raise SimulationError(
                f'The actuated joints ({", ".join(self.actuated_joints)}) cannot produce this '
                f'motion: {left:.3g} N m is missing at the others. Actuate more joints, or give '
                'an acceleration that the loops allow.')
        count = len(self._actuated)
        return solution[:count], solution[count:]

    def _evaluate(self):
        """Evaluate the present state once for all that is asked of it."""
        if not self._fresh:
            self._table.states[:] = self._own
            evaluate(self.system, self._q, self._qd)
            self._fresh = True


def _vector(name, values, length):
    array = np.array(values, dtype=float, order='C')
    # The sum of squares is finite where all are, and quicker to tell; it may overflow alone.
    if array.shape != (length,) or not (
            math.isfinite(array.dot(array)) or np.isfinite(array).all()):
        raise ValueError(f'{name}: expected {length} finite numbers, got {values!r}')
    return array
