# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A run that the engine makes and checks (``engine/run.hpp``), call by call."""

from types import SimpleNamespace
from typing import NamedTuple, Optional

import numpy as np

from ..engine import native
from ..scene.integrators import AUTO, INTEGRATORS, STABILISATIONS
from ..scene.tableau import DOPRI5, Tableau

# How a call ends.
(DONE, COMMAND, CHOICE, FAILED, INACCURATE, ENERGY_LOST, CABLE_LEAPT, NOT_REGULAR,
 LOOPS_OPEN) = range(9)
# More steps than any run has.
NEVER = 2 ** 62


class MethodOptions(NamedTuple):
    """What the engine builds a method from, beside its name."""

    tableau: Optional[Tableau]  # Of explicit methods
    short_tableau: Tableau  # Of the default method: for steps while torques are held for short
    stabilisation: int
    tolerance: float  # Of a step, of the default method the accuracy [rad or m]


class GuardLimits(NamedTuple):
    """Times and limits of the checks of a run."""

    step_size: float  # [s]
    order: int
    first: int
    rarely: int
    call: int
    whole: bool
    chooses: bool
    most: int
    closure: float  # [m or rad]
    regular: bool
    extent: float  # [m]
    mass: float  # [kg]
    usual: float  # [N m or N]
    timed: bool


class Run(SimpleNamespace):
    """
    A run of the engine by a scene's method, on a state of a system.

    It has the methods of the engine's run, too (``engine/run.hpp``), on its system and state.

    Attributes
    ----------
    native : object
        The engine's run.
    guard_limits : GuardLimits

    """

    def __init__(self, system, state, method, guard_limits, roles, windings):
        integrator = INTEGRATORS[method.integrator]
        options = MethodOptions(
            integrator.tableau, DOPRI5, STABILISATIONS[method.stabilisation],
            method.accuracy if method.integrator == AUTO else method.tolerance)
        self.guard_limits = guard_limits
        self.native = system.native.run(
            state, integrator.stepper, options, guard_limits, roles, windings)
        for name in dir(native.Run):
            if not name.startswith('_') and not hasattr(Run, name):
                setattr(self, name, getattr(self.native, name))

    def set_guard_limits(self, guard_limits, windings):
        """Go on with other limits."""
        self.native.set_guard_limits(guard_limits, windings)
        self.guard_limits = guard_limits

    def take_method(self, other):
        """Go on by the method and with the limits of another run."""
        self.native.take_method(other.native)
        self.guard_limits = other.guard_limits

    def take(self, other):
        """Become a copy of another run, by the same method."""
        self.native.take_run(other.native)

    @property
    def report(self):
        """Return what is known of the run: the numbers of ``RunReport``, by name."""
        return SimpleNamespace(**self.native.run_report())

    @property
    def steps(self):
        """Return what the method knows of its steps: the numbers of ``StepReport``, by name."""
        return SimpleNamespace(**self.native.steps())

    @property
    def whole(self):
        """Return the state with the memory of the method and the choice of coordinates."""
        found = np.empty(self.whole_length())
        self.write_whole(found)
        return found

    def kept(self, of_cables=False):
        """Return the latest whole state that was good at a check, of energy or of cables."""
        found = np.empty(self.whole_length())
        self.native.write_kept(of_cables, found)
        return found
