# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Drivers, which advance the state of a simulation: one class for each way of stepping."""

import numpy as np

from . import control as columns
from .control import DONE
from .registry import ADAPTIVE, INTEGRATORS, ROSENBROCK, SCIPY, STABILISATIONS, SWITCHING
from .scipy_solvers import SciPySolver
from .steppers import (
    EXPLICIT_STEPS, FIXED_STEPS, FIXED_STIFF_STEPS, one_run, REFERENCE, RUN, Runs, Stepper,
    STIFF_STEPS, SWITCHING_STEPS)
from .system import number_of_states, parts_of_state
from .tableau import DOPRI5
from ..core.manifold import weights
from ..engine import native


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


# Tolerances of the two, by that of the run.
RUN_FACTORS = np.array([1.0, columns.LOOSER]).reshape(2, 1, 1)


def _allocate_runs(tableau, states, weight):
    return Runs(
        DOPRI5, np.zeros((2, columns.SWITCHING_COLUMNS)), np.zeros((2, 2, states)),
        np.zeros((2, len(tableau.a) + columns.FIRST_SLOPE, states)),
        np.zeros((2, columns.STIFF_ROWS, states)), np.zeros((states, states)),
        np.zeros(states, dtype=np.int64), np.zeros(columns.MONITOR_COLUMNS), weight)


class FixedSteps:
    """Steps of one size, by a tableau, with ``scratch`` of shape (stages + 3, ns)."""

    def __init__(self, system, integrator, stabilisation):
        self.tableau, self.stabilisation = integrator.tableau, stabilisation
        self.scratch = np.zeros((len(self.tableau.a) + 3, number_of_states(system)))
        self.rebind(system)
        # Steps of the latest call, and those of them that the next one need not make again.
        self.made = self._before = 0

    @property
    def stepper(self):
        """Return the method with its memory, for the engine."""
        return one_run(FIXED_STEPS, self.stabilisation, self.tableau, scratch=self.scratch)

    def rebind(self, system):
        """Step with a system that works on other equations."""
        self._advance = native.bind(
            'advance_fixed', system.native, self.tableau, self.stabilisation, self.scratch)

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
            Of ``integration.control``.
        elapsed : float
            Time advanced by [s].

        """
        before, self._before = self._before, 0
        status, made = self._advance(state, step_size, steps - before)
        self.made = before + made
        return status, self.made * step_size

    def go_on(self):
        """Make the next, identical call continue where the latest failed."""
        self._before = self.made

    def restart(self, moved=False):
        """Forget the past: torques, or with ``moved`` the state. Fixed steps have none."""

    # Views of data that outlast ``restart``.
    memory = ()

    def rewind(self):
        """Begin as a new driver would."""


class _Adaptive:
    """An error-controlled method whose ``control`` holds the time reached and the step size."""

    def advance(self, state, origin, done, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``FixedSteps.advance``."""
        status = self._advance(state, origin, done, step_size, steps)
        if status == DONE:
            return status, steps * step_size
        return status, self.control[columns.REACHED] - (origin + done * step_size)

    def go_on(self):
        """Make the next call continue; see ``FixedSteps.go_on``."""
        if self.control[columns.STEP_SIZE] == 0.0:
            self.control[columns.STEP_SIZE] = columns.NOTHING_BETWEEN


class ErrorControlled(_Adaptive):
    """
    Steps of an embedded pair, as long as the tolerance allows.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    integrator : Integrator
        Of the registry.
    stabilisation : int
        One of ``registry``.
    tolerance : float
        Local error allowed per step: in each coordinate [rad, m], and in each rate relative
        to 1 rad/s (1 m/s) plus its own size.

    """

    def __init__(self, system, integrator, stabilisation, tolerance):
        self._tableau = integrator.tableau
        self._stabilisation, self._tolerance = stabilisation, tolerance
        self._scale = _error_scale(system, tolerance)
        self._scratch = np.zeros(
            (len(self._tableau.a) + columns.FIRST_SLOPE, self._scale.shape[1]))
        self.control = np.zeros(columns.CONTROL_COLUMNS)
        self.rebind(system)

    @property
    def stepper(self):
        """Return the method with its memory, for the engine."""
        return one_run(EXPLICIT_STEPS, self._stabilisation, self._tableau, control=self.control,
                       scale=self._scale, scratch=self._scratch)

    def rebind(self, system):
        """Step with a system that works on other equations."""
        self._system = system
        self._advance = native.bind(
            'advance_explicit', system.native, self._tableau, self._stabilisation, self.control,
            self._scale, self._scratch)

    @property
    def memory(self):
        """Return views of the data that ``restart`` keeps."""
        return (self.control,)

    def restart(self, moved=False):
        """Forget the past: torques, effects, or with ``moved`` the state have changed."""
        self.control[columns.STEP_SIZE] = 0.0
        _follow_effects(self._system, self._tolerance, self._scale)

    def rewind(self):
        """Begin as a new driver would."""
        self.control[:] = 0.0
        self.restart()


class Switching(_Adaptive):
    """
    Error control that changes between an explicit and a stiff method (``engine/switching.cpp``).

    ``accuracy``: global error of coordinates within a second [rad or m]; ``control``, shape
    (SWITCHING_COLUMNS,): of the run; ``watch``, shape (MONITOR_COLUMNS,): of its error.
    """

    def __init__(self, system, integrator, stabilisation, accuracy):
        self._tableau = integrator.tableau
        self._stabilisation, self._accuracy = stabilisation, accuracy
        self._runs = _allocate_runs(
            self._tableau, number_of_states(system), weights(system.manifold, len(system.qdd)))
        self._unit = _error_scale(system, 1.0)
        self.control, self.watch = self._runs.control[RUN], self._runs.monitor
        self.rebind(system)
        self.rewind()

    @property
    def stepper(self):
        """Return the method with its memory, for the engine."""
        return Stepper(
            SWITCHING_STEPS, self._stabilisation, self._tableau, self._unit, self._runs)

    def rebind(self, system):
        """Step with a system that works on other equations."""
        self._system = system
        self._advance = native.bind(
            'advance_switching', system.native, self._tableau, self._stabilisation, self._runs)

    @property
    def memory(self):
        """Return views of the data that ``restart`` keeps."""
        runs = self._runs
        return (runs.control.ravel(), runs.monitor,
                runs.scratch[REFERENCE, columns.AFTER])

    def restart(self, moved=False):
        """Forget the past: torques, effects, or with ``moved`` the state have changed."""
        self.control[columns.STEP_SIZE] = 0.0
        if moved:
            self.control[columns.STIFF_THRESHOLD] = 0.0
        _follow_effects(self._system, 1.0, self._unit)
        self._scale()

    @property
    def work(self):
        """Return the evaluations in steps of the run and of its reference run."""
        return self._runs.control[:, columns.WORK].tolist()

    def aim(self, accuracy):
        """
        Change the accuracy from the next step on; the run goes on, and a new window begins.

        ``accuracy``: float; as of the class.
        """
        watch, tolerance = self.watch, max(columns.SHARE * accuracy, columns.FLOOR)
        # Steps of order eight that are as good as the present ones.
        self._runs.control[:, columns.NEXT_STEP] *= (
            tolerance / watch[columns.TOLERANCE]) ** (1.0 / 8.0)
        watch[columns.ACCURACY], watch[columns.TOLERANCE] = accuracy, tolerance
        watch[columns.OPEN], watch[columns.PAUSE] = 0.0, columns.WINDOW
        watch[columns.UNTIL] = self.control[columns.REACHED]
        self._scale()

    def _scale(self):
        np.multiply(self._unit, self.watch[columns.TOLERANCE] * RUN_FACTORS, out=self._runs.scale)

    def rewind(self):
        """Begin as a new driver would."""
        for array in (self._runs.control, self.watch, self._runs.stiff_scratch):
            array[:] = 0.0
        self.watch[columns.ACCURACY] = self._accuracy
        self.watch[columns.TOLERANCE] = max(
            columns.SHARE * self._accuracy, columns.FLOOR)
        self.restart()


class Stiff:
    """Steps of RODAS4: of one size, or error-controlled up to the requested time."""

    def __init__(self, system, integrator, stabilisation, tolerance):
        self._stabilisation, self._tolerance = stabilisation, tolerance
        self._adaptive = integrator.kind == ADAPTIVE
        self._scale = _error_scale(system, tolerance)
        states = self._scale.shape[1]
        self._scratch = np.zeros((columns.STIFF_ROWS, states))
        self._matrix, self._pivots = np.zeros((states, states)), np.zeros(states, dtype=np.int64)
        self.control = np.zeros(columns.CONTROL_COLUMNS)
        self.rebind(system)
        # Of fixed steps as for ``FixedSteps``; of others whether the next call goes on.
        self.made = self._before = 0

    @property
    def stepper(self):
        """Return the method with its memory, for the engine."""
        return one_run(
            STIFF_STEPS if self._adaptive else FIXED_STIFF_STEPS, self._stabilisation,
            control=self.control, scale=self._scale, stiff_scratch=self._scratch,
            matrix=self._matrix, pivots=self._pivots)

    def advance(self, state, origin, done, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``FixedSteps.advance``."""
        before, self._before = self._before, 0
        if not self._adaptive:
            status, made = self._advance(state, step_size, steps - before)
            self.made = before + made
            return status, self.made * step_size
        begin = origin + done * step_size
        if not before:
            self.control[columns.REACHED] = begin
        status = self._advance(state, origin, done, step_size, steps)
        if status == DONE:
            return status, steps * step_size
        return status, self.control[columns.REACHED] - begin

    def rebind(self, system):
        """Step with a system that works on other equations."""
        self._system = system
        method = (self._matrix, self._pivots, self._scratch)
        self._advance = native.bind(
            'advance_stiff', system.native, self._stabilisation, self.control, self._scale,
            *method) if self._adaptive else native.bind(
                'advance_stiff_fixed', system.native, self._stabilisation, *method)

    def go_on(self):
        """Make the next call continue; see ``FixedSteps.go_on``."""
        self._before = 1 if self._adaptive else self.made

    memory = ()

    def restart(self, moved=False):
        """Forget the step size: torques, effects, or with ``moved`` the state have changed."""
        self.control[columns.NEXT_STEP] = 0.0
        _follow_effects(self._system, self._tolerance, self._scale)

    def rewind(self):
        """Begin as a new driver would."""
        self.control[:] = self._scratch[:] = 0.0
        self.restart()


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
