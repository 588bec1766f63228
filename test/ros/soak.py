# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Let a simulator run under traffic for long, and report memory growth and loss.

    python -m test.ros.soak --duration 3600

A real simulator process publishes states and forces; commands reach it from another process; this
process receives everything reliably, comes and goes with further subscriptions, calls services
and sets parameters. At the end it prints what was received and lost, by the publisher's own
numbering, and how the memory of the simulator has grown since it had settled. Exit code 0: no
loss, no growth.
"""

import argparse
import math
import os
from pathlib import Path
import signal
import sys
import tempfile
from test.ros.domains import reserve_domain
from test.ros.taker import Taker
import time

from closedloop_dynamics.ros.commands import SERVICE_QOS
from closedloop_dynamics.ros.executor import build_executor
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'benchmark'))

from programs import Programs  # noqa: E402,I100

SIMULATOR = 'closedloop_simulator'
# Memory that allocators may take without anything leaking: at once, and per hour [bytes].
GROWTH, GROWTH_PER_HOUR = 4e6, 4e6
# Memory settles while the first messages, services and parameters are used [s].
SETTLING = 20.0
# Between two rounds of disturbances, and two looks at the memory [s].
DISTURBANCE, POLL = 2.0, 1.0
# Between two looks for messages [s].
POLL = 0.005


def memory(process):
    """Return the resident memory of a process [bytes]."""
    pages = int(Path(f'/proc/{process.popen.pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE')


class Traffic:
    """Receives everything, and disturbs."""

    def __init__(self, scene, context):
        self.node = rclpy.create_node('soak', context=context)
        self.executor = build_executor(context)
        self.executor.add_node(self.node)
        self._listener = rclpy.create_node('soak_listener', context=context)
        self.taken = Taker(self._listener, scene)
        self._passing = None
        self._reset, self._parameters = (
            self.node.create_client(kind, f'{SIMULATOR}/{name}', qos_profile=SERVICE_QOS)
            for kind, name in ((Trigger, 'reset'), (SetParameters, 'set_parameters')))
        self.rounds = 0

    def disturb(self):
        """Come or go with a subscription, set parameters, and now and then reset."""
        if self._passing is None:
            self._passing = self.node.create_subscription(
                JointState, 'joint_states', lambda message: None, 1)
        else:
            self.node.destroy_subscription(self._passing)
            self._passing = None
        self._parameters.call_async(SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in (
                ('command_timeout', 1.0 + self.rounds % 7), ('real_time_factor', -1.0))]))
        if self.rounds % 10 == 9:
            self._reset.call_async(Trigger.Request())
        self.rounds += 1

    def run(self, duration, simulator):
        """Run for so long [s]; return the memory of the simulator at each look."""
        begin = time.monotonic()
        looks, next_look, next_disturbance = [], begin, begin

        def over():
            nonlocal next_look, next_disturbance
            now = time.monotonic()
            if now >= next_look:
                assert simulator.popen.poll() is None, simulator.output
                looks.append((now - begin, memory(simulator)))
                next_look = now + POLL
            if now >= next_disturbance:
                self.disturb()
                next_disturbance = now + DISTURBANCE
            return now - begin >= duration

        while not over():
            self.taken.take()
            self.executor.spin_once(timeout_sec=POLL)
        return looks

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self._listener.destroy_node()


def growth(looks, settling):
    """Return how much more memory the last tenth had than the tenth after settling [bytes]."""
    settled = [size for moment, size in looks if moment >= settling]
    tenth = max(1, len(settled) // 10)
    return (sum(settled[-tenth:]) - sum(settled[:tenth])) / tenth


def soak(duration, scene, rate, directory):
    """
    Run the soak.

    Parameters
    ----------
    duration : float
        [s].
    scene : str
        What is simulated.
    rate : float
        Of publishing [Hz].
    directory : pathlib.Path
        For logs.

    Returns
    -------
    report : str
    good : bool
        Whether nothing was lost and no memory has leaked.

    """
    processes = Programs(directory, {'ROS_LOG_DIR': str(directory / 'log')})
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(os.environ['ROS_DOMAIN_ID']))
    try:
        simulator = processes.start(SIMULATOR, scene=scene, publish_rate=rate).wait_until_ready()
        source = processes.start('closedloop_torque_source', mode='sine', amplitude='[0.5]')
        source.wait_until_ready()
        traffic = Traffic(scene, context)
        settling = min(SETTLING, duration / 4.0)
        looks = traffic.run(duration, simulator)
        grown = growth(looks, settling)
        codes = [process.stop(signal.SIGINT) for process in (source, simulator)]
        traffic.close()
    finally:
        processes.kill_all()
        rclpy.try_shutdown(context=context)
    lost, received = traffic.taken.lost.total(), traffic.taken.received.total()
    allowed = GROWTH + GROWTH_PER_HOUR * duration / 3600.0
    wanted = len(traffic.taken.received) * rate * duration
    report = '\n'.join((
        f'{duration:g} s of {scene} at {rate:g} Hz, {traffic.rounds} rounds of disturbances',
        f'received {received} messages ({received / wanted:.1%} of the nominal rate), lost {lost}',
        f'memory  {looks[0][1] / 1e6:.1f} MB at first, {looks[-1][1] / 1e6:.1f} MB at the end; '
        f'growth since {settling:g} s: {grown / 1e6:+.2f} MB ({allowed / 1e6:.1f} allowed)',
        simulator.output.splitlines()[-1]))
    return report, lost == 0 and grown <= allowed and codes == [0, 0]


def main(argv=None):
    """Run the soak in a domain of its own and print the report; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--duration', type=float, default=3600.0, help='[s]; default: an hour')
    parser.add_argument('--scene', default='carpet_scraper', help='default: %(default)s')
    parser.add_argument('--rate', type=float, default=500.0, help='of publishing [Hz]')
    arguments = parser.parse_args(argv)
    if not (math.isfinite(arguments.duration) and arguments.duration > 0.0):
        parser.error('--duration: expected a positive number of seconds')
    with tempfile.TemporaryDirectory() as directory, reserve_domain() as domain:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        report, good = soak(
            arguments.duration, arguments.scene, arguments.rate, Path(directory))
    print(report)
    return 0 if good else 1


if __name__ == '__main__':
    sys.exit(main())
