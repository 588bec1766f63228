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

"""Diagnostics of a simulator: ``diagnostic_msgs/DiagnosticArray`` on ``/diagnostics``."""

import math
import time

from closedloop_dynamics.core.types import SMALLEST_PIVOT
from closedloop_dynamics.effects.registry import effect_type
from closedloop_dynamics.ros.diagnostic_checks import (
    closure_finding, commands_finding, elimination_finding, energy_finding, ERROR, Finding,
    method_finding, near_singular, OK, time_finding)
from closedloop_dynamics.ros.modes import COMPUTING_SHARE
from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.ros.simulator_parameters import REALTIME
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from rclpy.clock import Clock
from rclpy.clock import ClockType

PERIOD = 1.0
MESSAGE_PERIOD = 5.0
COMMAND_TOPICS = ('torque_command', 'joint_command')


class Diagnostics:
    """
    Looks at a simulator once a second, and at its health after every state published.

    Parameters
    ----------
    node : simulator_node.SimulatorNode
        What is looked at.

    """

    def __init__(self, node):
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._prefix = node.get_fully_qualified_name().lstrip('/')
        self._singular, self._sources = Throttle(MESSAGE_PERIOD), ()
        self._redundant = False
        self._worst = math.inf
        self._mark()
        node.on_published.append(self.watch_health)
        node.create_timer(PERIOD, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def watch_health(self, stamp):
        """Note the smallest pivot of a state, and warn before forces lose their meaning."""
        pivot = self._node.simulation.system.work.health[SMALLEST_PIVOT]
        if pivot < self._worst:
            self._worst = pivot
        if near_singular(pivot) and not self._redundant and self._singular.ready():
            health = self._node.simulation.health
            # Redundant closure equations are so for ever: said once.
            self._redundant = not health.unique_forces
            self._node.get_logger().warning(str(health).rpartition('\n')[2])

    def publish(self):
        """Publish all findings."""
        self._send(self.findings())
        self._mark()

    def fail(self, reason):
        """
        Publish that the simulation has stopped.

        Parameters
        ----------
        reason : str
            Why.

        """
        self._send({'time': Finding(ERROR, f'stopped: {reason}')})

    def findings(self):
        """Return what there is to say, by the name of the status."""
        simulation = self._node.simulation
        report, balance = simulation.report(), simulation.energy_balance
        return {
            'time': self._time(),
            'method': self._method(report),
            'closure': closure_finding(report.closure),
            'energy': energy_finding(balance, report.energy_moved),
            'elimination': elimination_finding(
                simulation.health, min(self._worst, simulation.health.smallest_pivot)),
            'commands': self._commands(),
            'effects': self._effects(),
        }

    def _mark(self):
        """Begin another period."""
        pacer = self._node.pacer
        mode = self._node.mode
        self._begin = (time.monotonic(), pacer.simulated, pacer.dropped, mode.missed_ticks,
                       mode.left_out)
        self._worst = math.inf
        self._book = self._counts()

    def _time(self):
        node, pacer, mode = self._node, self._node.pacer, self._node.mode
        began, simulated, dropped, missed, left_out = self._begin
        elapsed = time.monotonic() - began
        now = {'factor': (pacer.simulated - simulated) / elapsed,
               'dropped': pacer.dropped - dropped, 'missed': mode.missed_ticks - missed,
               'left out': mode.left_out - left_out,
               'ticks': round(elapsed / mode.tick_period)}
        finding = time_finding(
            now, node.control.standing, pacer.real_time_factor if mode.name == REALTIME else None)
        finding.values = {
            'mode': mode.name, 'simulated time [s]': node.simulation.time,
            'real-time factor, last second': now['factor'],
            'real-time factor, asked for': (
                pacer.real_time_factor if mode.name == REALTIME else 'any'),
            'simulated time dropped, last second [s]': now['dropped'],
            'simulated time dropped [s]': pacer.dropped,
            'missed ticks, last second': now['missed'], 'missed ticks': mode.missed_ticks,
            'states left out, last second': now['left out'], 'states left out': mode.left_out,
            'messages published': node.states.published}
        return finding

    def _method(self, report):
        node = self._node
        load = report.share * node.pacer.real_time_factor / COMPUTING_SHARE if (
            node.mode.name == REALTIME) else math.nan
        finding = method_finding(report, load)
        finding.values['step size [s]'] = node.simulation.step_size
        return finding

    def _counts(self):
        book, control = self._node.command, self._node.control
        return {'accepted': book.accepted, 'rejected': book.rejected,
                'timed out': book.timed_out, 'lost': book.lost,
                'efforts of joints not actuated': book.not_actuated,
                'states set': control.states_set, 'states refused': control.states_refused}

    def _commands(self):
        node = self._node
        sources = tuple(sorted(
            f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for topic in COMMAND_TOPICS for info in node.get_publishers_info_by_topic(topic)))
        if len(sources) > 1 and sources != self._sources:
            node.get_logger().warning(
                f'{len(sources)} sources of commands ({", ".join(sources)}): the last command '
                'counts, whoever sent it')
        self._sources = sources
        return commands_finding(self._counts(), self._book, sources, node.command.expired)

    def _effects(self):
        simulation = self._node.simulation
        enabled = simulation.enabled_effects
        values = {}
        for name, record in simulation.effects.items():
            values[name] = effect_type(record) + ('' if name in enabled else ', switched off')
            if name in enabled:
                values.update({f'{name}.{key}': value for key, value in
                               simulation.effect_readings(name).items()})
        return Finding(OK, ', '.join(enabled) or 'none', values)

    def _send(self, findings):
        node = self._node
        message = DiagnosticArray()
        message.header.stamp = node.stamps.message()
        message.status = [
            DiagnosticStatus(
                level=finding.level, name=f'{self._prefix}: {name}', message=finding.message,
                hardware_id=node.simulation.scene.name,
                values=[KeyValue(key=key, value=_text(value))
                        for key, value in finding.values.items()])
            for name, finding in findings.items()]
        self._publisher.publish(message)


def _text(value):
    return f'{value:.6g}' if isinstance(value, float) else str(value)
