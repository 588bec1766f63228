# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What the nodes have in common: parameters, timers, counted complaints, diagnostics."""

from closedloop_dynamics.ros.diagnostics import send
from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.ros.parameters import declare, usage, watch_changes
from closedloop_dynamics.ros.process import run
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node

# Between two rounds of diagnostics [s].
DIAGNOSTIC_PERIOD = 1.0


class ProgramNode(Node):
    """
    A node that is a program of its own, with its parameters declared.

    ``exit_code``: None while the node wants to go on; ``values``: those of ``PARAMETERS``, by
    name. ``FURTHER`` parameters are declared by parts of the node. ``TIMED`` and
    ``LOSES_NOTHING`` are as for ``process.run``.
    """

    NAME, PARAMETERS, FURTHER = '', (), ()
    TIMED = LOSES_NOTHING = False

    def __init__(self, **options):
        super().__init__(self.NAME, **options)
        self.exit_code = None
        watch_changes(self)
        self.values = declare(self, self.PARAMETERS)

    def every(self, period, callback):
        """Return a timer [s] that neither a jump of the system's time nor a /clock can stop."""
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @classmethod
    def main(cls, args=None):
        """Run the node; return the exit code."""
        return run(cls, cls.NAME, usage(cls.NAME, cls, (*cls.PARAMETERS, *cls.FURTHER)), args,
                   cls.TIMED, cls.LOSES_NOTHING)


class CountingNode(ProgramNode):
    """
    A node that counts what comes in, and publishes how it fares with that.

    ``counts``: of messages, by the ``KINDS``; ``reason``: of the latest complaint.
    """

    KINDS = ()

    def __init__(self, **options):
        super().__init__(**options)
        self.counts, self.reason = dict.fromkeys(self.KINDS, 0), ''
        self._before, self._throttles = dict(self.counts), {}
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.every(DIAGNOSTIC_PERIOD, self.publish_diagnostics)

    def complain(self, kind, reason, number=1):
        """Count what is of no use, and log why, each kind once in a while."""
        self.counts[kind] += number
        self.reason = reason
        if self._throttles.setdefault(kind, Throttle()).ready():
            self.get_logger().warning(reason)

    def publish_diagnostics(self):
        """Publish what ``findings`` judges of the counts since the last time."""
        news = {kind: count - self._before[kind] for kind, count in self.counts.items()}
        self._before = dict(self.counts)
        findings = self.findings(news)
        next(iter(findings.values())).values.update(self.counts)
        send(self._diagnostics, self.get_fully_qualified_name(), self.get_clock().now().to_msg(),
             self.simulation.scene.name, findings)

    def close(self):
        """Log a summary."""
        self.get_logger().info(', '.join(
            f'{count} {kind}' for kind, count in self.counts.items()))
