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

"""
Guards of a run: error of the energy balance, loops that open, steps that cannot be stable.

Every guard says after how many steps it wants to look again, looks, and raises where the motion
has become meaningless.

The fastest rate of the motion, the largest eigenvalue of the derivative's
Jacobian J, is estimated by a power iteration on differences of the derivative, J v =
(f(y + e v) - f(y)) / e. It is taken in pairs, J J v, as oscillations have conjugate pairs
of eigenvalues. States of effects take part where the motion depends on them: the lag of a drive
is a rate of its own.

"""

from dataclasses import dataclass
import math
import warnings

import numpy as np

from .errors import (
    ClosureError, InaccuracyWarning, NumericalError, SingularityError, StiffnessError)
from ..core.types import SINGULAR_COUNT
from ..engine import native
from ..integration.registry import ADAPTIVE, AUTO, EXPLICIT, FIXED, INTEGRATORS
from ..integration.system import parts_of_state

# Step size times fastest rate at which the explicit methods leave stability, along the
# imaginary axis (springs without damping) or the negative real one (dampers).
STABILITY_LIMITS = {'semi_implicit_euler': 2.0, 'heun': 2.0, 'rk4': 2.78}
# Error-controlled explicit methods stay stable by taking steps as small as it needs; more than
# this many of them for one step of the raster is no simulation but a standstill.
MOST_SMALL_STEPS = 3000.0
PAIRS = 4
DIFFERENCE = 1e-7

# The energy balance is looked at after so many steps at first, then twice as rarely each time.
# With methods of order 1 the first steps miss as much as they move: that says nothing of the rest.
FIRST_LOOK, FIRST_LOOK_ORDER_1, LOOK_EVERY = 16, 128, 512
# The same with fixed steps among force laws: contacts and stops are left quickly.
LOOK_EVERY_AMONG_LAWS = 100
# Errors of the energy balance, relative to the energy that has moved, that are worth a warning and
# that end the run.
ENERGY_WARN, ENERGY_ERROR = 1e-3, 0.1
# Less than this share of the energy there is may be rounding; and between two looks, less than
# this share of all that has moved.
ROUNDING, LITTLE = 1e-9, 1e-6
# Less energy than this share of what the scene's forces would do along its length is none.
NOTHING = 1e-13

# Steps between two looks at the closure; and the closure error, against the size of the mechanism,
# at which loops count as open.
CLOSURE_LOOK_EVERY, OPEN = 500, 1e-3
# Steps between two looks whether equations can be left out again, at first and at most.
EQUATIONS_FIRST_LOOK, EQUATIONS_LOOK_EVERY = 64, 4096
# Torques up to this one are not asked for what they would do within a step [N m or N].
USUAL_TORQUE = 1e6
# What keeps the loops closed to rounding.
CLOSING = ('projection', 'independent')


def fastest_rate(system, state, own=()):
    """
    Estimate the largest eigenvalue, in magnitude, of the derivative's Jacobian.

    Parameters
    ----------
    system : System
        Model and workspace of the mechanism.
    state : ndarray, shape (ns,)
        Where.
    own : sequence of int
        Places, among the effects' states, of those that act back on the motion, such as the
        lag of a drive; dissipated energy and work do not.

    Returns
    -------
    float
        [1/s].

    """
    *_, of_effects, _ = parts_of_state(system)
    silent = np.ones(len(state), dtype=bool)
    silent[:of_effects.start] = False
    silent[of_effects.start + np.array(own, dtype=int)] = False
    slope, moved = np.zeros_like(state), np.zeros_like(state)
    native.derivative(system.native, state.copy(), slope)
    direction = np.random.default_rng(0).normal(size=len(state))
    direction[silent] = 0.0

    def turned(vector):
        size = DIFFERENCE / max(np.abs(vector).max(), 1e-300)
        native.derivative(system.native, state + size * vector, moved)
        result = (moved - slope) / size
        result[silent] = 0.0
        return result

    rate = 0.0
    for _ in range(PAIRS):
        norm = np.linalg.norm(direction)
        if not (math.isfinite(norm) and norm > 0.0):
            return rate
        direction = turned(turned(direction / norm))
        rate = math.sqrt(np.linalg.norm(direction))
    return rate


@dataclass
class Look:
    """Where a simulation stood when the energy guard looked at it."""

    # Effects.energy_balance.Energies; None of the start, until somebody wants to know
    balance: object
    state: np.ndarray  # As ``Simulation.state`` has it
    time: float  # [s]


class EnergyGuard:
    """
    Looks at the energy balance: seldom where it holds, from the first steps on.

    Parameters
    ----------
    method : Method
        Of the scene.
    rate : callable
        Returns the fastest rate of the motion in a state [1/s].
    limit : float
        Step size times rate up to which the method is stable; infinite where it always is.
    among_laws : bool
        Whether fixed steps are taken among effects with force laws.
    every_call : bool
        Whether to look after every call, however few steps it makes.

    Attributes
    ----------
    moved : float
        The most energy that has moved up to any look since the guard began [J].
    among_laws : bool
        As given.
    worst, worst_time : float
        Largest error of the balance relative to what had moved by then, and when [s].
    worst_lost, worst_moved : float
        That error and what had moved by then [J].
    failed : bool
        Whether a look has ended the run.
    first, rarely : int
        Steps before the first look, and the most between two.
    call : int
        Steps that must be made at once so that there is a look after them.
    whole : bool
        Whether there is none before all of these are made.

    """

    def __init__(self, method, rate, limit=math.inf, among_laws=False, every_call=False):
        """Begin with nothing seen."""
        self._method, self._rate, self._limit = method, rate, limit
        self.among_laws = among_laws
        integrator = INTEGRATORS[method.integrator]
        self.first = FIRST_LOOK_ORDER_1 if integrator.order == 1 else FIRST_LOOK
        self._least = FIRST_LOOK_ORDER_1 if integrator.order == 1 else 1
        # Where error control steps, how often it is looked at would show in the last digits.
        self.whole = integrator.kind == ADAPTIVE
        self.rarely = LOOK_EVERY_AMONG_LAWS if among_laws else LOOK_EVERY
        self.call = 1 if every_call and integrator.order > 1 else self.first
        self.restart()

    def restart(self):
        """Forget what has been seen: a run begins."""
        self._since, self._between, self._look, self._start = 0, self.first, None, None
        self.moved, self.worst, self.worst_time, self._warned = 0.0, 0.0, 0.0, False
        self.worst_lost, self.worst_moved, self.failed = 0.0, 0.0, False

    def jump(self):
        """Do not compare with what was before: the state or an effect has been changed."""
        self._look = None

    @property
    def until_look(self):
        """Return the steps left until the next look."""
        return math.inf if self.whole else self._between - self._since

    def begin(self, simulation):
        """See where a run, or what follows a jump, begins."""
        if self._look is None:
            # A short run need not cost a look at the start.
            self._take(simulation, None if simulation.at_start else simulation.energy_balance)

    def look(self, simulation, steps):
        """
        Raise where the energy balance is far off; warn, once, where it is a little.

        Raises
        ------
        StiffnessError, NumericalError
            The state of the latest look that was well is kept.

        """
        self._since += steps
        if self._since < self._between:
            return
        self._between = max(min(2 * self._between, self.rarely), self.first)
        self._look_now(simulation)

    def end(self, simulation, steps):
        """
        Look after a call, unless that would cost more than its few steps.

        Raises
        ------
        StiffnessError, NumericalError
            As for ``look``.

        """
        if self._since > 0 and steps >= self.call:
            self._look_now(simulation)

    def pass_on(self, simulation):
        """
        Look before a state is handed to others, however few steps have led to it.

        Raises
        ------
        StiffnessError, NumericalError
            As for ``look``; the state kept is the latest that was passed on.

        """
        if self._since >= self._least:
            self._look_now(simulation)

    def _look_now(self, simulation):
        self._since = 0
        self.judge(simulation)
        if self.worst > ENERGY_WARN and not self._warned:
            self._warned = True
            warnings.warn(self.finding, InaccuracyWarning, stacklevel=2)

    def judge(self, simulation):
        """
        Look at the balance now.

        Raises
        ------
        StiffnessError, NumericalError
            As for ``look``.

        """
        balance = simulation.energy_balance
        rounding = self.rounding(simulation, balance.kinetic + abs(balance.stored))
        self.note(simulation, balance, rounding)
        before = self._look
        if before is not None:
            moving = (before.balance.kinetic + abs(balance.stored - before.balance.stored)
                      + abs(balance.dissipated - before.balance.dissipated)
                      + abs(balance.work - before.balance.work))
            lost = abs(balance.residual - before.balance.residual)
            allowed = ENERGY_ERROR * moving + LITTLE * self.moved + rounding
            if not lost <= allowed or self.worst > ENERGY_ERROR:
                worst = self.worst if math.isfinite(lost) else math.inf
                problem = self._problem(lost, moving, before, simulation, worst)
                self.failed = True
                simulation.restore(before.state, before.time, before.balance.residual)
                raise problem
        self._take(simulation, balance)

    def _take(self, simulation, balance):
        self._look = Look(balance, simulation.state, simulation.time)
        if self._start is None and balance is not None:
            self._start = balance

    def note(self, simulation, balance, rounding=None):
        """Note how much energy has moved, and the error of the present balance."""
        if rounding is None:
            rounding = self.rounding(simulation, balance.kinetic + abs(balance.stored))
        if self._look is not None and self._look.balance is None:
            self._look.balance = self._start = simulation.energy_at_start
        start = balance if self._start is None else self._start
        self.compare(
            abs(balance.residual - start.residual),
            balance.kinetic + abs(balance.stored - start.stored)
            + abs(balance.dissipated - start.dissipated) + abs(balance.work - start.work),
            rounding, simulation.time)

    @staticmethod
    def rounding(simulation, present):
        """Return how much of an error may be rounding, of the energy that there is [J]."""
        return ROUNDING * present + NOTHING * simulation.energy_scale

    def missed(self, balance):
        """Return what a balance misses since the guard began [J]."""
        return balance.residual - (0.0 if self._start is None else self._start.residual)

    def compare(self, lost, moved, rounding, time):
        """
        Note an error of the energy balance.

        Parameters
        ----------
        lost, moved, rounding : float
            Error of the balance, energy that has moved, what of the error may be rounding [J].
        time : float
            [s].

        """
        self.moved = max(self.moved, moved)
        lost -= rounding
        share = lost / self.moved if lost > 0.0 and self.moved > 0.0 else 0.0
        if not math.isfinite(lost):
            share = math.inf
        if not share <= self.worst:
            self.worst, self.worst_time = share, time
            self.worst_lost, self.worst_moved = lost, self.moved

    @property
    def finding(self):
        """Return in words what is wrong with the energy of the run; empty where nothing is."""
        if not self.worst > ENERGY_WARN:
            return ''
        return (f'the energy balance misses {self.worst_lost:.3g} J of the '
                f'{self.worst_moved:.3g} J that moved until t = {self.worst_time:.6g} s: '
                f'{_setting(self._method)} does not follow this motion. {_cure(self._method)}')

    def _problem(self, lost, moving, before, simulation, worst):
        """Return the error to raise."""
        rate, size = self._rate(simulation.integrated), self._method.step_size
        kept = f'The state of t = {before.time:.9g} s is kept.'
        what = (f'The energy balance is off by {lost:.3g} J between t = {before.time:.9g} and '
                f'{simulation.time:.9g} s, where {moving:.3g} J moved')
        if worst > ENERGY_ERROR and not lost > ENERGY_ERROR * moving:
            what = f'The energy balance misses {worst:.0%} of all energy that moved'
        if rate * size > self._limit:
            return StiffnessError(
                f'{what}: the scene is stiff (fastest rate about {rate:.3g} 1/s, for which '
                f'{self._method.integrator} is stable with steps up to {self._limit / rate:.3g} s '
                f'only). {kept} Take integrator: auto or rodas4, or a smaller step.')
        return NumericalError(
            f'{what}: {_setting(self._method)} does not follow this motion. {kept} '
            f'{_cure(self._method)}')


def _setting(method):
    """Return a method with what its accuracy depends on, in words."""
    if method.integrator == AUTO:
        setting = f'accuracy {method.accuracy:g}'
    elif INTEGRATORS[method.integrator].kind == ADAPTIVE:
        setting = f'tolerance {method.tolerance:g}'
    else:
        setting = f'steps of {method.step_size:g} s'
    return f'{method.integrator} with {setting} and stabilisation: {method.stabilisation}'


def _cure(method):
    """Return what to do where a method does not follow a motion."""
    if method.stabilisation not in CLOSING:
        return 'Take stabilisation: projection, and integrator: auto or a smaller step.'
    if method.integrator == AUTO:
        return 'Ask for a smaller accuracy.'
    if INTEGRATORS[method.integrator].kind == ADAPTIVE:
        return 'Take integrator: auto, or a smaller tolerance.'
    return 'Take integrator: auto, which controls its error, or a smaller step.'


class EquationGuard:
    """Looks whether equations that had to be taken again can be left out again."""

    def __init__(self):
        """Begin."""
        self.restart()

    def restart(self):
        """Count from here."""
        self._since, self._between = 0, EQUATIONS_FIRST_LOOK

    @property
    def until_look(self):
        """Return the steps left until the next look, however many are made at once."""
        return self._between - self._since

    def begin(self, simulation):
        """Do nothing: every look stands by itself."""

    def jump(self):
        """Do nothing, likewise."""

    def look(self, simulation, steps):
        """Let the simulation leave out equations again; ever more seldom, as that may not last."""
        self._since += steps
        if self._since >= self._between:
            self._since = 0
            if simulation.leave_out_again():
                self._between = min(2 * self._between, EQUATIONS_LOOK_EVERY)


class ClosureGuard:
    """
    Looks at the closure where the method alone does not keep the loops closed.

    ``extent``: float; size of the mechanism [m].

    """

    def __init__(self, method, extent):
        """Decide what to look for."""
        self._method, self._extent = method, extent

    # However few steps are made at once, the loops are looked at after them.
    until_look = CLOSURE_LOOK_EVERY

    @property
    def limit(self):
        """Return the closure error at which loops count as open [m or rad]."""
        return OPEN * self._extent

    @property
    def regular(self):
        """Return whether a singular configuration ends the run."""
        return self._method.stabilisation == 'none'

    def restart(self):
        """Do nothing: every look stands by itself."""

    jump = restart

    def begin(self, simulation):
        """Do nothing: every look stands by itself."""

    def look(self, simulation, steps):
        """
        Raise where loops have opened.

        Raises
        ------
        SingularityError
            Where a singular configuration was met without any stabilisation.
        ClosureError
            Where the loops have drifted apart.

        """
        method = self._method
        if self.regular and simulation.system.work.health[SINGULAR_COUNT] > 0.0:
            raise SingularityError(
                f'A singular configuration was met up to t = {simulation.time:.9g} s: closure '
                'equations vanish there, and with the drift that stabilisation: none allows the '
                'branch on which the mechanism goes on cannot be told. Take stabilisation: '
                'projection.')
        closure = simulation.closure
        if not closure <= self.limit:
            raise ClosureError(
                f'The loops have drifted apart by {closure:.3g} m (or rad) at t = '
                f'{simulation.time:.9g} s: stabilisation: {method.stabilisation} does not close '
                'them again. Take stabilisation: projection, or a smaller step.')


class StiffnessGuard:
    """
    Refuses explicit steps that cannot be stable, before they are made.

    Attributes
    ----------
    limit : float
        Step size times fastest rate up to which the method is stable.
    among_laws : bool
        Whether fixed explicit steps are taken among effects with force laws.

    """

    def __init__(self, system, method, own=()):
        """Decide whether to look at all."""
        integrator = INTEGRATORS[method.integrator]
        self._system, self._name, self._own = system, method.integrator, own
        self._fixed = integrator.kind == FIXED
        self.limit = STABILITY_LIMITS.get(
            method.integrator, math.inf if self._fixed else 3.0 * MOST_SMALL_STEPS)
        self._explicit = integrator.family == EXPLICIT and system.effects is not None
        self.among_laws = self._explicit and self._fixed

    def move(self, system):
        """Take a system that works on other equations."""
        self._system = system

    def stable(self, state, step_size):
        """Return whether steps of ``step_size`` from ``state`` can be stable."""
        return not self._explicit or self.rate(state) * step_size <= self.limit

    def rate(self, state):
        """Return the fastest rate of the motion in a state [1/s]."""
        return fastest_rate(self._system, state, self._own)

    def check(self, state, step_size):
        """
        Raise where steps of ``step_size`` from ``state`` cannot be stable.

        Raises
        ------
        StiffnessError

        """
        if self.stable(state, step_size):
            return
        rate = self.rate(state)
        if self._fixed:
            raise StiffnessError(
                f'The scene is stiff: its fastest motion has a rate of about {rate:.3g} 1/s, for '
                f'which {self._name} is stable with steps up to {self.limit / rate:.3g} s only; '
                f'the step is {step_size:g} s. Take integrator: auto or rodas4, a smaller step, '
                'or softer springs, dampers and contacts.')
        raise StiffnessError(
            f'The scene is stiff: its fastest motion has a rate of about {rate:.3g} 1/s, which '
            f'{self._name} follows with steps up to {3.0 / rate:.3g} s only, '
            f'{rate * step_size / 3.0:.2g} of them for each step of {step_size:g} s. Take '
            'integrator: auto or rodas4, or softer springs, dampers and contacts.')
