# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Diagnostics of a simulator: ``diagnostic_msgs/DiagnosticArray`` on ``/diagnostics``.

Every check takes plain records and returns a ``Finding``; the thresholds stand here, and in
doc/interface.md.
"""

from collections import Counter
from dataclasses import dataclass, field
import math
import time
from typing import Dict

from closedloop_dynamics.effects.registry import effect_type
from closedloop_dynamics.engine.types import SMALLEST_PIVOT
from closedloop_dynamics.ros.external_wrench import WRENCHES_REFUSED
from closedloop_dynamics.ros.motion_command import LOST, REFUSED
from closedloop_dynamics.ros.pacing import COMPUTING_SHARE, REALTIME, Throttle
from closedloop_dynamics.simulation.health import WARN_BELOW
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
# Achieved share of the requested real-time factor.
FACTOR_WARN, FACTOR_ERROR = 0.95, 0.5
# Share of ticks that came so late that the next one was due.
MISSED_WARN = 0.05
# Share of the time left for computing that steps take.
LOAD_WARN = 0.8
# Estimate of the local error of a step [rad or m].
ERROR_WARN, ERROR_ERROR = 1e-4, 1e-2
# Closure error [m or rad].
CLOSURE_WARN, CLOSURE_ERROR = 1e-6, 1e-3
# Error of the energy balance, as a share of what was moved; less than the floor [J] is rounding.
ENERGY_WARN, ENERGY_ERROR, ENERGY_FLOOR = 1e-3, 0.1, 1e-6


@dataclass
class Finding:
    """
    One status of the diagnostics.

    ``level`` is OK, WARN or ERROR; ``values`` are shown as text, numbers with 6 digits.
    """

    level: bytes
    message: str
    values: Dict[str, object] = field(default_factory=dict)


class Diagnostics:
    """
    Checks a simulator on request, and its health after every published state.

    ``node`` publishes; a ``LiveSimulation`` and the mode that advances it are checked.
    ``summary``: closure, error and energy balance of the latest period in a few lines; empty
    before.
    """

    def __init__(self, node, live, mode):
        self._live, self._mode, self._logger = live, mode, node.get_logger()
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._name = node.get_fully_qualified_name()
        self._singular, self._sources, self._graph = Throttle(), (), None
        self._redundant, self.summary = False, ''
        self._mark({})

    def watch_health(self, stamp):
        """Record the smallest pivot of a state, and warn before forces lose their meaning."""
        pivot = self._live.simulation.data.system.work.health[SMALLEST_PIVOT]
        if pivot < self._worst:
            self._worst = pivot
        if near_singular(pivot) and not self._redundant and self._singular.ready():
            health = self._live.simulation.health
            # Redundant closure equations are so for ever: said once.
            self._redundant = not health.unique_forces
            self._logger.warning(str(health).rpartition('\n')[2])

    def publish(self, standing, counts, sources, graph):
        """
        Publish all findings, and begin another period.

        ``standing`` says why time does not run; ``counts`` and ``sources`` are as for
        ``commands_finding``, ``graph`` is a finding about the other nodes.
        """
        # Nodes discover each other one by one: a finding counts when seen twice in a row.
        if graph.level != OK and (graph.message, False) == self._graph:
            self._logger.warning(graph.message)
            self._graph = graph.message, True
        elif self._graph is None or graph.message != self._graph[0]:
            self._graph = graph.message, False
        several = several_sources(sources)
        if several and sources != self._sources:
            self._logger.warning(several)
        self._sources = sources
        simulation = self._live.simulation
        report = simulation.report()
        self.summary = accuracy_summary(report, simulation.energy_balance.residual)
        self.report({
            'time': self._time(standing),
            'method': self._method(report),
            'closure': closure_finding(report.closure),
            'energy': energy_finding(simulation.energy_balance, report.energy_moved),
            'elimination': elimination_finding(
                simulation.health, min(self._worst, simulation.health.smallest_pivot)),
            'commands': commands_finding(
                counts, self._counts, sources, self._live.command.expired),
            'effects': self._effects(),
            'graph': graph})
        self._mark(counts)

    def stall(self, reason):
        """Publish that a step takes long, and nothing that would disturb it."""
        self.report({'time': Finding(WARN, reason)})

    def fail(self, reason):
        """Publish that the simulation has stopped, and why."""
        self.report({'time': Finding(ERROR, f'stopped: {reason}')})

    def _mark(self, counts):
        """Begin another period."""
        mode, pacer = self._mode, self._mode.pacer
        self._begin = (time.monotonic(), pacer.simulated, pacer.dropped, mode.missed_ticks,
                       mode.left_out)
        self._worst, self._counts = math.inf, dict(counts)

    def _time(self, standing):
        mode, pacer = self._mode, self._mode.pacer
        began, simulated, dropped, missed, left_out = self._begin
        elapsed = time.monotonic() - began
        now = {'factor': (pacer.simulated - simulated) / elapsed,
               'dropped': pacer.dropped - dropped, 'missed': mode.missed_ticks - missed,
               'left out': mode.left_out - left_out,
               'ticks': round(elapsed / mode.tick_period)}
        wanted = pacer.real_time_factor if mode.name == REALTIME else None
        finding = time_finding(now, standing, wanted)
        finding.values = {
            'mode': mode.name, 'simulated time [s]': self._live.simulation.time,
            'real-time factor, last second': now['factor'],
            'real-time factor, requested': 'any' if wanted is None else wanted,
            'simulated time dropped, last second [s]': now['dropped'],
            'simulated time dropped [s]': pacer.dropped,
            'missed ticks, last second': now['missed'], 'missed ticks': mode.missed_ticks,
            'states left out, last second': now['left out'], 'states left out': mode.left_out,
            'states published again': mode.repeated,
            'messages published': self._live.states.published}
        return finding

    def _method(self, report):
        load = report.share * self._mode.pacer.real_time_factor / COMPUTING_SHARE if (
            self._mode.name == REALTIME) else math.nan
        finding = method_finding(report, load)
        finding.values['step size [s]'] = self._live.simulation.step_size
        return finding

    def _effects(self):
        simulation = self._live.simulation
        enabled = simulation.data.enabled_effects
        values = {}
        for name, record in simulation.effects.items():
            values[name] = effect_type(record) + ('' if name in enabled else ', switched off')
            if name in enabled:
                values.update({f'{name}.{key}': value for key, value in
                               simulation.effect_readings(name).items()})
        return Finding(OK, ', '.join(enabled) or 'none', values)

    def report(self, findings):
        send(self._publisher, self._name, self._live.stamps.message(),
             self._live.simulation.scene.name, findings)


def send(publisher, node_name, stamp, subject, findings):
    """Publish findings by their names, of a node and of the subject that it deals with."""
    message = DiagnosticArray()
    message.header.stamp = stamp
    message.status = [
        DiagnosticStatus(
            level=finding.level, name=f'{node_name.lstrip("/")}: {name}', message=finding.message,
            hardware_id=subject, values=[
                KeyValue(key=key, value=_text(value)) for key, value in finding.values.items()])
        for name, finding in findings.items()]
    publisher.publish(message)


def _text(value):
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def graded(value, warn, error, good, bad):
    """Return level and message of a value that should be small; NaN is unknown."""
    if value > error:
        return ERROR, bad
    return (WARN, bad) if value > warn else (OK, good)


def time_finding(now, standing, wanted_factor):
    """
    Judge whether simulated time keeps up.

    ``now`` has, of the last period, the ``factor`` achieved, time ``dropped`` [s], ``ticks``,
    ``missed`` ones and ``left out`` ones; ``standing`` says why time does not run, empty where it
    does; ``wanted_factor`` is None where time may run as it likes.
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
    """Judge a ``RunReport``, and the share of the time there is that steps take, or NaN."""
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
        'bound of the error within a second [rad or m]': report.error_bound,
        'bound in the latest second checked [rad or m]': report.present_bound,
        'accuracy [rad or m within a second]': report.accuracy,
        'evaluations per simulated second': report.evaluation_rate,
        'budget [share of real time]': report.budget,
        'used of the budget [share of real time]': report.budget_used})


def accuracy_summary(report, residual):
    """Return closure, error and energy residual [J] of a report, a line each if they are known."""
    share = residual / report.energy_moved if report.energy_moved > 0.0 else math.nan
    return '\n'.join(text.format(value) for text, value in (
        ('closure {:.1e} m or rad', report.closure),
        ('error {:.1e} rad or m within a second', report.error_bound),
        ('energy {:+.1e} of that exchanged', share)) if math.isfinite(value))


def closure_finding(closure):
    """Judge how far the loops are open: the largest error at the cut joints [m or rad]."""
    level, message = graded(
        closure, CLOSURE_WARN, CLOSURE_ERROR, 'closed',
        f'the loops are open by {closure:.2g} m or rad: take stabilisation projection')
    return Finding(level, message, {'closure error [m or rad]': closure})


def energy_finding(balance, moved):
    """Judge the energy balance, ``Energies``, against the energy that was moved so far [J]."""
    lost = abs(balance.residual)
    level, message = graded(
        lost, ENERGY_FLOOR + ENERGY_WARN * moved, ENERGY_FLOOR + ENERGY_ERROR * moved, 'balanced',
        f'the energy balance is off by {lost:.2g} J: take a smaller step_size or another '
        'integrator')
    return Finding(level, message, {
        f'{key} [J]': getattr(balance, key)
        for key in ('kinetic', 'stored', 'dissipated', 'work', 'residual')})


def elimination_finding(health, worst):
    """Judge how well posed the equations were, by ``Health`` and the period's worst pivot."""
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


def commands_finding(counts, before, sources, zero_after_timeout):
    """
    Judge the commands.

    ``counts`` and ``before`` are the counts of commands and states so far, now and a period ago;
    ``sources`` the nodes that publish commands, one entry for each publisher;
    ``zero_after_timeout`` whether torques are zero because commands stopped.
    """
    level, message = OK, f'from {", ".join(sources)}' if sources else 'nobody commands'
    refused, lost = (sum(counts.get(key, 0) - before.get(key, 0) for key in keys) for keys in (
        ('rejected', 'states refused', REFUSED, WRENCHES_REFUSED), ('lost', LOST)))
    if refused:
        level, message = WARN, f'{refused} refused in the last second; the log says why'
    elif lost:
        level, message = WARN, f'{lost} commands lost in the last second'
    elif len(sources) > 1:
        level, message = WARN, several_sources(sources)
    elif zero_after_timeout:
        level, message = WARN, 'torques are zero: no command came in time'
    return Finding(level, message, {**counts, 'sources': ', '.join(sources)})


def several_sources(sources):
    """Return a sentence on the nodes of several publishers of commands; '' for one at most."""
    counts = Counter(sources)
    if len(sources) < 2:
        return ''
    if len(counts) == 1:
        name, = counts
        return (f'{len(sources)} publishers of commands in {name}, one node or several of that '
                'name: the last command counts, whichever of them sent it')
    nodes = ', '.join(f'{name} with {count} publishers' if count > 1 else name
                      for name, count in counts.items())
    return (f'{len(counts)} sources of commands ({nodes}): the last command counts, whichever '
            'node sent it')


def graph_finding(name, namesakes, clocks, waits_for_clock):
    """
    Return a finding on other nodes with this node's names.

    ``namesakes`` is how many nodes have its full ``name``, itself included, ``clocks`` how many
    publish /clock; ``waits_for_clock`` whether it takes the time from there.
    """
    level, message = OK, 'alone of its name'
    if namesakes > 1:
        level, message = WARN, (
            f'{namesakes} nodes are called {name}, and share topics and services: start one in '
            'another namespace (-r __ns:=/other); one that was killed is seen for some seconds')
    elif clocks > 1:
        level, message = WARN, (
            f'{clocks} nodes publish /clock: time will jump; remap that of all but one')
    elif waits_for_clock and not clocks:
        level, message = WARN, (
            'use_sim_time is true, and nobody publishes /clock: stamps stand still; take '
            'publish_clock:=true in one simulator, or use_sim_time:=false')
    return Finding(level, message, {
        'nodes of this name': namesakes, 'publishers of /clock': clocks})


def near_singular(pivot):
    """Return whether a smallest pivot is worth a warning; as ``Health.near_singular``."""
    return not pivot >= WARN_BELOW
