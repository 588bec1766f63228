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
What the diagnostics of a simulator say of its numbers: levels, messages, values.

Every check takes plain records and returns a ``Finding``; the thresholds stand here, and in
doc/interface.md.

"""

from dataclasses import dataclass, field
from typing import Dict

from closedloop_dynamics.simulation.health import WARN_BELOW
from diagnostic_msgs.msg import DiagnosticStatus

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
# Share of the real-time factor asked for that is achieved.
FACTOR_WARN, FACTOR_ERROR = 0.95, 0.5
# Share of ticks that came so late that the next one was due.
MISSED_WARN = 0.05
# Share of the time left for computing that steps take.
LOAD_WARN = 0.8
# Estimate of the local error of a step [rad or m].
ERROR_WARN, ERROR_ERROR = 1e-4, 1e-2
# Closure error [m or rad].
CLOSURE_WARN, CLOSURE_ERROR = 1e-6, 1e-3
# Energy from nowhere, as a share of what was moved; less than the floor [J] is rounding.
ENERGY_WARN, ENERGY_ERROR, ENERGY_FLOOR = 1e-3, 0.1, 1e-6


@dataclass
class Finding:
    """
    One status of the diagnostics.

    Attributes
    ----------
    level : bytes
        OK, WARN or ERROR.
    message : str
    values : dict of str to object
        Shown as text, numbers with 6 digits.

    """

    level: bytes
    message: str
    values: Dict[str, object] = field(default_factory=dict)


def graded(value, warn, error, good, bad):
    """
    Return level and message of a value that should be small.

    Parameters
    ----------
    value : float
        NaN is small: it is not known.
    warn, error : float
        Values above these are warned of, or errors.
    good, bad : str
        What to say of it.

    Returns
    -------
    level : bytes
    message : str

    """
    if value > error:
        return ERROR, bad
    return (WARN, bad) if value > warn else (OK, good)


def time_finding(now, standing, wanted_factor):
    """
    Judge whether simulated time keeps up.

    Parameters
    ----------
    now : dict
        Of the last period: ``factor`` achieved, ``dropped`` [s], ``ticks``, ``missed`` ones and
        ``left out`` ones.
    standing : str
        Why time does not run; empty where it does.
    wanted_factor : float or None
        None: as it comes.

    Returns
    -------
    Finding

    """
    if standing:
        return Finding(OK, standing)
    if wanted_factor is None:
        return Finding(OK, f'{now["factor"]:.3g} x real time')
    share = now['factor'] / wanted_factor
    if share < FACTOR_WARN:
        return Finding(
            ERROR if share < FACTOR_ERROR else WARN,
            f'cannot keep up: {now["factor"]:.3g} x real time instead of {wanted_factor:g}')
    if now['left out']:
        return Finding(WARN, f'{now["left out"]} states left out: the machine was busy, or '
                             'publish_rate is too high for it')
    if now['missed'] > MISSED_WARN * max(now['ticks'], 1):
        return Finding(WARN, f'{now["missed"]} of {now["ticks"]} ticks missed: the machine is '
                             'busy, or publish_rate too high for it')
    return Finding(OK, f'{now["factor"]:.3g} x real time')


def method_finding(report, load):
    """
    Judge cost and error.

    Parameters
    ----------
    report : monitor.RunReport
        Of the simulation.
    load : float
        Share of the time there is that steps take; NaN where there is no limit.

    Returns
    -------
    Finding

    """
    level, message = graded(
        report.local_error, ERROR_WARN, ERROR_ERROR, report.method,
        f'a step may be off by {report.local_error:.2g} rad or m: take a smaller step_size or '
        'another integrator')
    if level == OK and report.findings:
        level, message = WARN, '; '.join(report.findings)
    if level == OK and load > LOAD_WARN:
        level, message = WARN, (f'computing takes {100.0 * load:.0f} % of the time there is: '
                                'a larger step_size or a smaller real_time_factor helps')
    return Finding(level, message, {
        'method': report.method, 'steps': report.steps, 'evaluations': report.evaluations,
        'compute time per step [us]': 1e6 * report.time_per_step,
        'share of real time [%]': 100.0 * report.share,
        'local error [rad or m]': report.local_error,
        'bound of the error within a second [rad or m]': report.error_bound})


def closure_finding(closure):
    """
    Judge how far the loops are open [m or rad].

    Parameters
    ----------
    closure : float
        Largest error of a position at the cut joints.

    Returns
    -------
    Finding

    """
    level, message = graded(
        closure, CLOSURE_WARN, CLOSURE_ERROR, 'closed',
        f'the loops are open by {closure:.2g} m or rad: take stabilisation projection')
    return Finding(level, message, {'closure error [m or rad]': closure})


def energy_finding(balance, moved):
    """
    Judge the energy balance.

    Parameters
    ----------
    balance : effects.energy_balance.Energies
        Of the simulation.
    moved : float
        Energy that was moved so far [J].

    Returns
    -------
    Finding

    """
    lost = abs(balance.residual)
    level, message = graded(
        lost, ENERGY_FLOOR + ENERGY_WARN * moved, ENERGY_FLOOR + ENERGY_ERROR * moved, 'balanced',
        f'{lost:.2g} J came from nowhere or went there: take a smaller step_size or another '
        'integrator')
    return Finding(level, message, {
        f'{key} [J]': getattr(balance, key)
        for key in ('kinetic', 'stored', 'dissipated', 'work', 'residual')})


def elimination_finding(health, worst):
    """
    Judge how well posed the equations were.

    Parameters
    ----------
    health : health.Health
        Of the present state.
    worst : float
        Smallest pivot of the last period.

    Returns
    -------
    Finding

    """
    level, message = OK, 'well posed'
    if not health.unique_forces:
        level, message = WARN, (
            f'{health.equations - health.rank} of {health.equations} closure equations depend on '
            'the others: the constraint forces are not unique, the least ones are shown')
    elif near_singular(worst):
        level, message = WARN, (
            f'near a singular configuration (smallest pivot {worst:.2g}): constraint forces may '
            'be very large and mean little')
    return Finding(level, message, {
        'smallest pivot, now': health.smallest_pivot, 'smallest pivot, last second': worst,
        'smallest pivot, ever': health.smallest_pivot_ever,
        'closure equations': health.equations, 'independent ones': health.rank,
        'rank-revealing evaluations': health.rank_revealing_count,
        'projection iterations': health.projection_iterations,
        'sine of the angle to a parallel singularity': health.drive_sine})


def commands_finding(book, before, sources, zero_after_timeout):
    """
    Judge the commands.

    Parameters
    ----------
    book : dict of str to int
        Counts so far; ``rejected``, ``states refused`` and ``lost`` among them.
    before : dict of str to int
        The same a period ago.
    sources : sequence of str
        Nodes that publish commands, one entry for each publisher.
    zero_after_timeout : bool
        Whether torques are zero because commands stopped.

    Returns
    -------
    Finding

    """
    level, message = OK, f'from {", ".join(sources)}' if sources else 'nobody commands'
    refused = sum(book[key] - before.get(key, 0) for key in ('rejected', 'states refused'))
    lost = book['lost'] - before.get('lost', 0)
    if refused:
        level, message = WARN, f'{refused} refused in the last second; the log says why'
    elif lost:
        level, message = WARN, f'{lost} commands lost in the last second'
    elif len(sources) > 1:
        level, message = WARN, (f'{len(sources)} sources of commands ({", ".join(sources)}): the '
                                'last command counts, whoever sent it')
    elif zero_after_timeout:
        level, message = WARN, 'torques are zero: no command came in time'
    return Finding(level, message, {**book, 'sources': ', '.join(sources)})


def near_singular(pivot):
    """Return whether a smallest pivot is worth a warning; as ``Health.near_singular``."""
    return not pivot >= WARN_BELOW
