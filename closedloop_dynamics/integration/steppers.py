# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Methods with their memory, which the engine has (``engine/stepper.hpp``)."""

from types import SimpleNamespace
from typing import NamedTuple, Optional

import numpy as np

from .registry import AUTO, INTEGRATORS, SCIPY, STABILISATIONS
from .scipy_solvers import SciPySolver
from .tableau import DOPRI5, Tableau
from ..engine import native


class MethodOptions(NamedTuple):
    """What the engine builds a method from."""

    tableau: Optional[Tableau]  # Of explicit methods
    short_tableau: Tableau  # Of the default method: for steps while torques are held for short
    stabilisation: int
    tolerance: float  # Of a step, of the default method the accuracy [rad or m]


def build_stepper(system, method):
    """Build the stepper of a scene's method."""
    integrator = INTEGRATORS[method.integrator]
    options = MethodOptions(
        integrator.tableau, DOPRI5, STABILISATIONS[method.stabilisation],
        method.accuracy if method.integrator == AUTO else method.tolerance)
    if integrator.family == SCIPY:
        return SciPySolver(system, integrator.solver, options.stabilisation, options.tolerance)
    return Stepper(system, integrator.stepper, options)


class Stepper:
    """A method of the engine, with its memory."""

    def __init__(self, system, name, options):
        self.native = native.stepper(system.native, name, options)
        self.rebind(system)

    def rebind(self, system):
        """Step with a system that works on other equations."""
        self._advance, self._restart, self._rewind = (
            native.bind(name, system.native, self.native)
            for name in ('advance', 'restart', 'rewind'))

    def advance(self, state, origin, done, step_size, steps):
        """
        Advance a state by whole steps.

        Parameters
        ----------
        state : ndarray, shape (ns,)
            Advanced in place; on failure the latest good one.
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
        return self._advance(state, origin, done, step_size, steps)

    def go_on(self):
        """Make the next, identical call continue where the latest failed."""
        native.go_on(self.native)

    def restart(self, moved=False):
        """Forget the past: torques, effects, or with ``moved`` the state have changed."""
        self._restart(moved)

    def rewind(self):
        """Begin as a new stepper would."""
        self._rewind()

    @property
    def memory(self):
        """Return the numbers that ``restart`` keeps."""
        found = np.empty(native.memory_length(self.native))
        native.store_memory(self.native, found)
        return found

    @memory.setter
    def memory(self, numbers):
        native.recall_memory(self.native, np.array(numbers))

    @property
    def report(self):
        """Return the numbers of ``StepReport``, by name."""
        return SimpleNamespace(**native.step_report(self.native))

    def clear_report(self):
        """Count steps and errors from here on."""
        native.clear_report(self.native)

    def aim(self, accuracy):
        """Keep another accuracy from the next step on; the run goes on, and a window begins."""
        native.aim(self.native, accuracy)
