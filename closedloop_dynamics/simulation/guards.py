# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Guards of a run: error of the energy balance, loops that open, steps that cannot be stable.

The engine makes the checks (``engine/run.hpp``), with the constants here; its findings are
reported here, and raised where the motion has become meaningless.

The fastest rate of the motion, the largest eigenvalue of the derivative's
Jacobian J, is estimated by a power iteration on differences of the derivative, J v =
(f(y + e v) - f(y)) / e. It is taken in pairs, J J v, as oscillations have conjugate pairs
of eigenvalues. States of effects take part where the motion depends on them: the lag of a drive
is a rate of its own.
"""

import math

import numpy as np

from .cable_guard import CHECK_EVERY as CABLE_CHECK_EVERY
from .run import GuardLimits, NEVER
from .system import parts_of_state
from ..engine.types import SINGULAR_COUNT
from ..mechanism.errors import ClosureError, NumericalError, SingularityError, StiffnessError
from ..scene.integrators import ADAPTIVE, AUTO, EXPLICIT, FIXED, INTEGRATORS

# Step size times fastest rate at which the explicit methods leave stability, along the
# imaginary axis (springs without damping) or the negative real one (dampers).
STABILITY_LIMITS = {'semi_implicit_euler': 2.0, 'heun': 2.0, 'rk4': 2.78}
# Error-controlled explicit methods stay stable by taking steps as small as it needs; more than
# this many of them for one interval of the output grid is not a simulation but a standstill.
MOST_SMALL_STEPS = 3000.0

# The energy balance is checked after so many steps at first, then half as often each time. With
# methods of order 1 the error of the first steps is as large as the energy exchanged in them.
FIRST_CHECK, FIRST_CHECK_ORDER_1, CHECK_EVERY = 16, 128, 512
# The same with fixed steps among force laws: contacts and stops are left quickly.
CHECK_EVERY_AMONG_LAWS = 100
# After calls of so many steps it is checked in any case: that costs them a twentieth at most.
SEVERAL = 5
# Errors of the energy balance, relative to the energy exchanged, that give a warning and that end
# the run.
ENERGY_WARN, ENERGY_ERROR = 1e-3, 0.1
# Steps between two checks of the closure; and the closure error, against the size of the
# mechanism, at which loops count as open.
CLOSURE_CHECK_EVERY, OPEN = 500, 1e-3
# How often closure equations are exchanged without progress.
MOST_EXCHANGES = 20
# Torques up to this one are not checked for their effect within a step [N m or N].
USUAL_TORQUE = 1e6
# In a step, of a joint [rad, m]: error-controlled methods would divide it for minutes.
LARGEST_MOTION = 1e3
# Stabilisations that keep the loops closed to rounding.
CLOSING = ('projection', 'independent')


def fastest_rate(system, state, own=()):
    """
    Estimate the largest eigenvalue, in magnitude, of the derivative's Jacobian in a state [1/s].

    ``own``: places, among the effects' states, of those that act back on the motion, such as the
    lag of a drive; dissipated energy and work do not.
    """
    return system.native.fastest_rate(state, _direction(system, own))


def _direction(system, own):
    """Return any direction in which the motion may change, shape (ns,)."""
    *_, of_effects, states = parts_of_state(system)
    silent = np.ones(states, dtype=bool)
    silent[:of_effects.start] = False
    silent[of_effects.start + np.array(own, dtype=int)] = False
    direction = np.random.default_rng(0).normal(size=states)
    direction[silent] = 0.0
    return direction


def guard_limits(method, among_laws, chooses, has_cables, size, mass):
    """
    Return the times and limits by which the engine watches a run.

    ``among_laws``: whether fixed steps are taken among effects with force laws; ``chooses``:
    whether equations may be left out, so that calls are checked however few steps they make;
    ``size`` [m] and ``mass`` [kg] of the mechanism.
    """
    integrator = INTEGRATORS[method.integrator]
    first = FIRST_CHECK_ORDER_1 if integrator.order == 1 else FIRST_CHECK
    drifts = method.stabilisation not in CLOSING
    return GuardLimits(
        method.step_size, integrator.order, first,
        CHECK_EVERY_AMONG_LAWS if among_laws else CHECK_EVERY,
        # A contact may throw a body away within a step.
        first if integrator.order == 1 else 1 if chooses or among_laws else SEVERAL,
        # With error control the frequency of checks would show in the last digits.
        integrator.kind == ADAPTIVE, chooses,
        min(CABLE_CHECK_EVERY if has_cables else NEVER, CLOSURE_CHECK_EVERY if drifts else NEVER),
        OPEN * size if drifts else math.inf, method.stabilisation == 'none', size, mass,
        USUAL_TORQUE, method.by_budget)


def energy_finding(method, lost, moved, time):
    """Return in words that an energy balance misses some of what was exchanged until a time."""
    return (f'the energy balance misses {lost:.3g} J of the {moved:.3g} J exchanged until '
            f't = {time:.6g} s: {_setting(method)} does not follow this motion. {_cure(method)}')


class EnergyGuard:
    """
    What the checks of the energy balance have found, in words.

    Of the run of a ``Stepping``.
    """

    def __init__(self, stepping):
        self._stepping = stepping

    def pass_on(self):
        """
        Check before a state is handed to others, however few steps have led to it.

        StiffnessError, NumericalError where the energy balance is far off; the state kept is the
        latest that was passed on.
        """
        stepping = self._stepping
        first_order = INTEGRATORS[stepping.method.integrator].order == 1
        if stepping.run.report.unchecked >= (FIRST_CHECK_ORDER_1 if first_order else 1):
            stepping.check_energy()

    @property
    def finding(self):
        """Return the finding on the energy of the run in words; empty where there is none."""
        report = self._stepping.run.report
        return energy_finding(
            self._stepping.method, report.worst_lost, report.worst_moved, report.worst_time) if (
                report.worst > ENERGY_WARN) else ''

    def problem(self):
        """Return the error to raise where the latest check has ended a run."""
        stepping = self._stepping
        method, report, guard = stepping.method, stepping.run.report, stepping.stiffness
        lost, moving, before = report.lost, report.moving, report.check_time
        # Where the balance is not a number, not even the start of it may be believed.
        worst = report.worst if math.isfinite(lost) else math.inf
        rate, size = stepping.fastest_rate, method.step_size
        kept = f'The state of t = {before:.9g} s is kept.'
        what = (f'The energy balance is off by {lost:.3g} J between t = {before:.9g} and '
                f'{stepping.data.time:.9g} s, where {moving:.3g} J were exchanged')
        if worst > ENERGY_ERROR and not lost > ENERGY_ERROR * moving:
            what = (f'The energy balance misses {report.worst_lost:.3g} J of the '
                    f'{report.worst_moved:.3g} J exchanged until t = {report.worst_time:.6g} s, '
                    f'{worst:.0%}')
        if rate * size > guard.limit:
            return StiffnessError(
                f'{what}: the scene is stiff (fastest rate about {rate:.3g} 1/s, for which '
                f'{method.integrator} is stable with steps up to {guard.limit / rate:.3g} s '
                f'only). {kept} Take integrator: auto or rodas4, or a smaller step.')
        return NumericalError(
            f'{what}: {_setting(method)} does not follow this motion. {kept} {_cure(method)}')


def _setting(method):
    """Return a method and its accuracy setting in words."""
    if method.integrator == AUTO:
        setting = f'accuracy {method.accuracy:g}'
    elif INTEGRATORS[method.integrator].kind == ADAPTIVE:
        setting = f'tolerance {method.tolerance:g}'
    else:
        setting = f'steps of {method.step_size:g} s'
    return f'{method.integrator} with {setting} and stabilisation: {method.stabilisation}'


def _cure(method):
    """Return a remedy where a method does not track a motion."""
    if method.stabilisation not in CLOSING:
        return 'Take stabilisation: projection, and integrator: auto or a smaller step.'
    if method.integrator == AUTO:
        return 'Ask for a smaller accuracy.'
    if INTEGRATORS[method.integrator].kind == ADAPTIVE:
        return 'Take integrator: auto, or a smaller tolerance.'
    return 'Take integrator: auto, which controls its error, or a smaller step.'


def opened_loops(data, limits):
    """Return the error to raise where a method that does not close the loops has lost them."""
    stabilisation, time = data.scene.method.stabilisation, data.time
    if limits.regular and data.system.work.health[SINGULAR_COUNT] > 0.0:
        return SingularityError(
            f'A singular configuration was met up to t = {time:.9g} s: closure '
            'equations vanish there, and with the drift that stabilisation: none allows the '
            'branch on which the mechanism goes on is undetermined. Take stabilisation: '
            'projection.')
    return ClosureError(
        f'The loops have drifted apart by {data.closure:.3g} m (or rad) at t = '
        f'{time:.9g} s: stabilisation: {stabilisation} does not close '
        'them again. Take stabilisation: projection, or a smaller step.')


class StiffnessGuard:
    """
    Refuses explicit steps that cannot be stable, before they are made.

    ``limit``: step size times fastest rate up to which the method is stable; ``among_laws``:
    whether fixed explicit steps are taken among effects with force laws.
    """

    def __init__(self, system, method, own=()):
        integrator = INTEGRATORS[method.integrator]
        self._system, self._name = system, method.integrator
        self._start = _direction(system, own)
        self._fixed = integrator.kind == FIXED
        self.limit = STABILITY_LIMITS.get(
            method.integrator, math.inf if self._fixed else 3.0 * MOST_SMALL_STEPS)
        self._explicit = integrator.family == EXPLICIT and system.effects is not None
        self.among_laws = self._explicit and self._fixed

    def stable(self, state, step_size):
        """Return whether steps of ``step_size`` from ``state`` can be stable."""
        return not self._explicit or self.rate(state) * step_size <= self.limit

    def rate(self, state):
        """Return the fastest rate of the motion in a state [1/s]."""
        return self._system.native.fastest_rate(state, self._start)

    def check(self, state, step_size):
        """Raise StiffnessError where steps of ``step_size`` from ``state`` cannot be stable."""
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
