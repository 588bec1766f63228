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

"""Drivers, which advance the state of a simulation: one class for each way of stepping."""

import numpy as np

from . import adaptive, advance, rosenbrock, switching
from .registry import ADAPTIVE, INTEGRATORS, ROSENBROCK, SCIPY, STABILISATIONS, SWITCHING
from .scipy_solvers import SciPySolver
from .system import number_of_states, parts_of_state, stepped_by_euler
from ..core.manifold import weights


def build_driver(system, method):
    """Build the driver of a scene's method."""
    integrator = INTEGRATORS[method.integrator]
    stabilisation = STABILISATIONS[method.stabilisation]
    if integrator.family == SCIPY:
        return SciPySolver(system, integrator.solver, stabilisation, method.tolerance)
    if integrator.family == SWITCHING:
        return Switching(system, integrator, stabilisation, method.accuracy)
    if integrator.family == ROSENBROCK:
        return Stiff(system, integrator, stabilisation, method.tolerance)
    if integrator.kind == ADAPTIVE:
        return ErrorControlled(system, integrator, stabilisation, method.tolerance)
    return FixedSteps(system, integrator, stabilisation)


class FixedSteps:
    """
    Steps of one size.

    Attributes
    ----------
    moving : Moving
        What kernels see of the system.
    tableau : Tableau
    stabilisation : int
    scratch : ndarray, shape (stages + 3, ns)
        Of ``advance.advance``.

    """

    def __init__(self, system, integrator, stabilisation):
        """Allocate the scratch of the method."""
        self.tableau = integrator.tableau
        self.take(system)
        self.stabilisation = stabilisation
        self.scratch = np.zeros((len(self.tableau.a) + 3, number_of_states(system)))
        # Steps of the latest call, and those of them that the next one need not make again.
        self._made = self._before = 0

    def take(self, system):
        """Step with a system that works on other equations."""
        # The system is kept, as kernels see its addresses alone.
        self._system = system if len(self.tableau.b) else stepped_by_euler(system)
        self.moving = self._system.moving

    def advance(self, state, origin, done, step_size, steps):
        """
        Advance a state by whole steps.

        Parameters
        ----------
        state : ndarray, shape (ns,)
            Advanced in place; on failure the one before the failing step.
        origin : float
            Time of step 0 [s].
        done : int
            Steps made since then.
        step_size : float
            [s].
        steps : int
            How many to make.

        Returns
        -------
        status : int
            Of ``integration.advance``.
        elapsed : float
            Time advanced by [s].

        """
        before, self._before = self._before, 0
        status, made = advance.advance(
            self.moving, self.tableau, self.stabilisation, state, step_size, steps - before,
            self.scratch)
        self._made = before + made
        return status, self._made * step_size

    def go_on(self):
        """Let the next call, which is the same again, go on from where the latest failed."""
        self._before = self._made

    def restart(self, moved=False):
        """Forget the past: torques, or with ``moved`` the state. Fixed steps have none."""

    # Views of what outlasts ``restart``.
    memory = ()

    def rewind(self):
        """Begin as a new driver would."""


class ErrorControlled:
    """
    Steps of an embedded pair, as long as the tolerance allows.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    integrator : Integrator
        Of the registry.
    stabilisation : int
        One of ``projection``.
    tolerance : float
        Local error allowed per step: in each coordinate [rad, m], and in each rate relative
        to 1 rad/s (1 m/s) plus its own size.

    """

    def __init__(self, system, integrator, stabilisation, tolerance):
        """Allocate the scratch of the method."""
        self._tableau = integrator.tableau
        self._stabilisation, self._tolerance = stabilisation, tolerance
        self._system, self._moving = system, system.moving
        self._scale = _error_scale(system, tolerance)
        self._scratch = np.zeros(
            (len(self._tableau.a) + adaptive.FIRST_SLOPE, self._scale.shape[1]))
        self.control = np.zeros(adaptive.CONTROL_COLUMNS)

    def advance(self, state, origin, done, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``FixedSteps.advance``."""
        status = adaptive.advance(
            self._moving, self._tableau, self._stabilisation, state, origin, done, step_size,
            steps, self.control, self._scale, self._scratch)
        if status == advance.DONE:
            return status, steps * step_size
        return status, self.control[adaptive.REACHED] - (origin + done * step_size)

    def take(self, system):
        """Step with a system that works on other equations."""
        self._system, self._moving = system, system.moving

    def go_on(self):
        """Let the next call go on; see ``FixedSteps.go_on``."""
        if self.control[adaptive.STEP_SIZE] == 0.0:
            self.control[adaptive.STEP_SIZE] = adaptive.NOTHING_BETWEEN

    @property
    def memory(self):
        """Return views of what outlasts ``restart``."""
        return (self.control,)

    def restart(self, moved=False):
        """Forget the past: torques, effects, or with ``moved`` the state have changed."""
        self.control[adaptive.STEP_SIZE] = 0.0
        _follow_effects(self._system, self._tolerance, self._scale)

    def rewind(self):
        """Begin as a new driver would."""
        self.control[:] = 0.0


class Switching:
    """
    Error control that changes between an explicit and a stiff method; see ``switching``.

    ``accuracy``: float; global error of coordinates within a second [rad or m].

    Attributes
    ----------
    control : ndarray, shape (switching.COLUMNS,)
        Of the run.
    watch : ndarray, shape (switching.WATCH_COLUMNS,)
        Of its error.

    """

    def __init__(self, system, integrator, stabilisation, accuracy):
        """Allocate the run and its companion."""
        self._system, self._moving = system, system.moving
        self._tableau = integrator.tableau
        self._stabilisation, self._accuracy = stabilisation, accuracy
        self._runs = switching.allocate_runs(
            self._tableau, number_of_states(system), weights(system.manifold, len(system.qdd)))
        self._unit = _error_scale(system, 1.0)
        self.control, self.watch = self._runs.control[switching.RUN], self._runs.watch
        self.rewind()

    def advance(self, state, origin, done, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``FixedSteps.advance``."""
        status = switching.advance(
            self._moving, self._tableau, self._stabilisation, state, origin, done, step_size,
            steps, self._runs)
        if status == advance.DONE:
            return status, steps * step_size
        return status, self.control[adaptive.REACHED] - (origin + done * step_size)

    def take(self, system):
        """Step with a system that works on other equations."""
        self._system, self._moving = system, system.moving

    def go_on(self):
        """Let the next call go on; see ``FixedSteps.go_on``."""
        if self.control[adaptive.STEP_SIZE] == 0.0:
            self.control[adaptive.STEP_SIZE] = adaptive.NOTHING_BETWEEN

    @property
    def memory(self):
        """Return views of what outlasts ``restart``."""
        runs = self._runs
        return (runs.control.ravel(), runs.watch,
                runs.scratch[switching.COMPANION, adaptive.AFTER])

    def restart(self, moved=False):
        """Forget the past: torques, effects, or with ``moved`` the state have changed."""
        self.control[adaptive.STEP_SIZE] = 0.0
        if moved:
            self.control[switching.PATIENCE] = 0.0
        _follow_effects(self._system, 1.0, self._unit)
        for scale, factor in zip(self._runs.scale, (1.0, switching.LOOSER)):
            np.multiply(self._unit, factor * self.watch[switching.TOLERANCE], out=scale)

    def rewind(self):
        """Begin as a new driver would."""
        for array in (self._runs.control, self.watch, self._runs.stiff_scratch):
            array[:] = 0.0
        self.watch[switching.ACCURACY] = self._accuracy
        self.watch[switching.TOLERANCE] = max(
            switching.SHARE * self._accuracy, switching.FLOOR)
        self.restart(moved=True)


class Stiff:
    """Steps of RODAS4: of one size, or error-controlled up to where the state is asked for."""

    def __init__(self, system, integrator, stabilisation, tolerance):
        """Allocate the scratch of the method."""
        self._system, self._moving = system, system.moving
        self._stabilisation, self._tolerance = stabilisation, tolerance
        self._adaptive = integrator.kind == ADAPTIVE
        self._scale = _error_scale(system, tolerance)
        states = self._scale.shape[1]
        self._scratch = np.zeros((rosenbrock.STAGES + rosenbrock.FIRST_SLOPE, states))
        self._matrix, self._pivots = np.zeros((states, states)), np.zeros(states, dtype=np.int64)
        self.control = np.zeros(adaptive.CONTROL_COLUMNS)
        # Of fixed steps as for ``FixedSteps``; of others whether the next call goes on.
        self._made = self._before = 0

    def advance(self, state, origin, done, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``FixedSteps.advance``."""
        before, self._before = self._before, 0
        if not self._adaptive:
            status, made = rosenbrock.advance_fixed(
                self._moving, self._stabilisation, state, step_size, steps - before,
                self._matrix, self._pivots, self._scratch)
            self._made = before + made
            return status, self._made * step_size
        begin, self._made = origin + done * step_size, 1
        if not before:
            self.control[adaptive.REACHED] = begin
        status = rosenbrock.advance_adaptive(
            self._moving, self._stabilisation, state, origin + (done + steps) * step_size,
            self.control, self._scale, self._matrix, self._pivots, self._scratch)
        if status == advance.DONE:
            return status, steps * step_size
        return status, self.control[adaptive.REACHED] - begin

    def take(self, system):
        """Step with a system that works on other equations."""
        self._system, self._moving = system, system.moving

    def go_on(self):
        """Let the next call go on; see ``FixedSteps.go_on``."""
        self._before = self._made

    memory = ()

    def restart(self, moved=False):
        """Forget the step size: torques, effects, or with ``moved`` the state have changed."""
        self.control[adaptive.NEXT_STEP] = 0.0
        _follow_effects(self._system, self._tolerance, self._scale)

    def rewind(self):
        """Begin as a new driver would."""
        self.control[:] = self._scratch[:] = 0.0


def _error_scale(system, tolerance):
    """Return absolute and relative tolerances: of coordinates absolute, of others both."""
    coordinates, *_, states = parts_of_state(system)
    scale = np.full((2, states), tolerance)
    scale[0, coordinates] /= weights(system.manifold, len(system.qdd))
    scale[1, coordinates] = 0.0
    _follow_effects(system, tolerance, scale)
    return scale


def _follow_effects(system, tolerance, scale):
    """Bring the tolerances of the effects' states in line with their present parameters."""
    if system.effects is not None:
        np.multiply(
            system.effects.scale, tolerance, out=scale[0, parts_of_state(system)[2]])
