# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A run that the engine makes and checks (``engine/run.hpp``), call by call."""

from types import SimpleNamespace
from typing import NamedTuple, Optional

import numpy as np

from .registry import AUTO, INTEGRATORS, STABILISATIONS
from .tableau import DOPRI5, Tableau
from ..engine import native

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


class Watch(NamedTuple):
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


# Functions of the engine by their first arguments.
_OF_STATE = (
    'advance_run', 'make_steps', 'resume_run', 'command', 'add_work', 'begin', 'balance',
    'record_energy', 'check_energy', 'jump_balance', 'write_whole', 'recall')
_OF_SYSTEM = (
    'find_start', 'run_samples', 'check_starts', 'restart', 'rewind', 'whole_length',
    'accuracy_in', 'try_step')
_OF_RUN = (
    'time', 'base', 'set_time', 'clear_cost', 'sample', 'give_up', 'choose_more_seldom',
    'record_loss', 'jump', 'restart_guards', 'aim')


class Run(SimpleNamespace):
    """
    A run of the engine by a scene's method, on a state of a system.

    Its functions are those of the engine, with what they begin with bound: system, run and state,
    system and run, or the run alone.

    Attributes
    ----------
    native : object
        The engine's run.
    watch : Watch

    """

    def __init__(self, system, state, method, watch, roles, windings):
        integrator = INTEGRATORS[method.integrator]
        options = MethodOptions(
            integrator.tableau, DOPRI5, STABILISATIONS[method.stabilisation],
            method.accuracy if method.integrator == AUTO else method.tolerance)
        self.watch, self._system = watch, system
        self.native = native.run(
            system.native, integrator.stepper, options, watch, roles, windings)
        for names, arguments in (
                (_OF_RUN, (self.native,)), (_OF_SYSTEM, (system.native, self.native)),
                (_OF_STATE, (system.native, self.native, state))):
            for name in names:
                setattr(self, name, native.bind(name, *arguments))

    def set_watch(self, watch, windings):
        """Go on with other limits."""
        native.set_watch(self._system.native, self.native, watch, windings)
        self.watch = watch

    def take_method(self, other):
        """Go on by the method and with the limits of another run."""
        native.take_method(self._system.native, self.native, other.native)
        self.watch = other.watch

    def take(self, other):
        """Become a copy of another run, by the same method."""
        native.take_run(self.native, other.native)

    @property
    def report(self):
        """Return what is known of the run: the numbers of ``RunReport``, by name."""
        return SimpleNamespace(**native.run_report(self.native))

    @property
    def steps(self):
        """Return what the method knows of its steps: the numbers of ``StepReport``, by name."""
        return SimpleNamespace(**native.steps(self.native))

    @property
    def whole(self):
        """Return the state with the memory of the method and the choice of coordinates."""
        found = np.empty(self.whole_length())
        self.write_whole(found)
        return found

    def kept(self, of_cables=False):
        """Return the latest whole state that was good at a check, of energy or of cables."""
        found = np.empty(self.whole_length())
        native.write_kept(self.native, of_cables, found)
        return found
