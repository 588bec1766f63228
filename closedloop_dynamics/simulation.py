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

from .errors import StiffnessError
from .integration.system import Probe
from .inverse_dynamics import InverseDynamics
from .rollout import rollout
from .scene import load_scene
from .scene_records import AUTO
from .simulation_motion import SimulationMotion
from .simulation_state import FORMULATIONS
from .simulation_state import vector as _vector

__all__ = ['FORMULATIONS', 'Simulation']


class Simulation(SimulationMotion):
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
        """Assemble the initial state, ready to move."""
        super().__init__(scene)
        self._inverse = InverseDynamics(
            self.mechanism, self.system, self._effects, self._table)
        self._probe = Probe(self.system)

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

    def rollout(self, torques=None, initial_position=None, initial_velocity=None, *, hold=None,
                duration=None, steps=None, every=1, parameters=None,
                quantities=('position', 'velocity'), threads=None):
        """
        Run many simulations of this scene from its start, in parallel.

        This simulation stays as it is. Every result is the same, bit for bit, as that of a
        simulation of its own that is advanced by ``step``, whatever the number of threads.

        Parameters
        ----------
        torques : array_like, shape (samples, rows, number of actuated joints)
            Torques of the actuated joints [N m or N], one row after the other, each for the
            same number of steps. Without the first axis for all samples; a single row stays
            for the whole run; none when not given.
        initial_position, initial_velocity : array_like, shape (samples, nv) or (nv,)
            To start from instead of the scene's start, as for ``set_state``.
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
            What to return: names of the fields of ``rollout.Rollout``.
        threads : int, optional
            As many as there are processors, when not given.

        Returns
        -------
        rollout.Rollout
            A sample that fails is told of in ``failures``; its numbers are NaN from then on.

        Raises
        ------
        ValueError
            For arguments that make no sense, whatever the sample.

        """
        return rollout(
            self, torques, initial_position, initial_velocity, hold=hold, duration=duration,
            steps=steps, every=every, parameters=parameters, quantities=quantities,
            threads=threads)

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
        StiffnessError
            Where the steps would be too large for it in the present state; nothing is changed.

        Notes
        -----
        An energy that appears or vanishes with the change (a spring that is switched on
        stretched) is not booked as work: the energy balance goes on from the new energy.

        """
        self._accounts.settle(self._q, self.system.tau)
        self._open_accounts()
        before = self.energy
        anew = self._try_effect(name, enabled, parameters)
        self._own[anew] = self._effects.initial[anew]
        self._driver.restart()
        self._fresh, self._look = False, None
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
        ValueError, StiffnessError

        """
        effects = self._effects
        effects.checked(name, enabled, parameters)
        was = effects.records[name], effects.enabled[name]
        self._try_effect(name, enabled, parameters)
        effects.put(name, *was)

    def _try_effect(self, name, enabled, parameters):
        """Change an effect, unless steps that can be stable now could not be with it."""
        effects = self._effects
        was = effects.records.get(name), effects.enabled.get(name)
        anew = effects.change(name, enabled, parameters)
        self._fresh = False
        if getattr(effects.records[name], 'STIFFENS', True):
            self._require_stable(name, was)
        return anew

    def _require_stable(self, name, was):
        try:
            self._guard.check(self._state, self.step_size)
        except StiffnessError:
            changed = self._effects.records[name], self._effects.enabled[name]
            self._effects.put(name, *was)
            if self._guard.stable(self._state, self.step_size):
                raise
            # It has been too stiff before: a change may be for the better.
            self._effects.put(name, *changed)

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
        probe = self._probe
        probe.q[:] = _vector('position', position, nv)
        probe.qd[:] = _vector('velocity', velocity, nv)
        tau, applied = self.joint_torques(torque), system.tau.copy()
        system.tau[:] = tau
        self._table.states[:] = self._own
        probe.evaluate()
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
        nv = len(self.joint_names)
        q, qd, qdd = (_vector(name, values, nv) for name, values in (
            ('position', position), ('velocity', velocity), ('acceleration', acceleration)))
        self._fresh = False
        return self._inverse.solve(q, qd, qdd)
