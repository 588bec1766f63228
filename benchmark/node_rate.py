# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How evenly, at what cost, and how completely a simulator publishes at a rate.

Starts a real simulator, subscribes to its states and to the force of every cut joint
(reliably), and prints for each rate: what was achieved, how far the periods between states were
off, by the times at which DDS sent them, the share of a core that the simulator took, and how
many messages were lost on the way, by the numbers that the publisher gives them. With
``--record`` the package's recorder listens, too. Before and after, a bare loop that does nothing
but sleep until the next period shows how evenly this machine wakes a process up at all, and
``stolen`` is what the host of a virtual machine took from it meanwhile. At the end, how long it
takes from a command to the state that shows it. ``--program`` measures the C++ node of
``closedloop_hardware`` in the place of the simulator.
"""

import argparse
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from machine import description, ROOT
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.simulation.scene import load_scene  # noqa: E402,I100
from programs import Program  # noqa: E402

from test.ros.taker import Taker  # noqa: E402,I100

# Between two looks for messages [s].
POLL = 0.002
# Of the bare loop [s].
FLOOR_DURATION = 3.0


class Subscriber:
    """Takes all that a simulator publishes, as a node of its own."""

    def __init__(self, scene):
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node('node_rate', context=self.context)
        self.taken = Taker(self.node, scene, keep_times=True)

    def take_until(self, over):
        """Take messages until it is over."""
        while not over():
            self.taken.take()
            time.sleep(POLL)

    def close(self):
        """Leave the domain."""
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


def cpu_time(process):
    """Return the CPU time of a process [s]."""
    fields = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def start(executable, *parameters, file=None):
    """Start an executable of the package, with parameters of a file and such as NAME:=VALUE."""
    arguments = [each for parameter in parameters for each in ('-p', parameter)]
    if file is not None:
        arguments = ['--params-file', str(file), *arguments]
    return Program(f'closedloop_{executable}', ['--ros-args', '--log-level', 'warn', *arguments],
                   Path('/dev/stderr')).popen


def deviations(moments, rate):
    """Return median, 95th and 99th percentile and maximum of |period - nominal| [ms]."""
    off = np.abs(1e-6 * np.diff(moments) - 1e3 / rate)
    return (*np.percentile(off, (50, 95, 99)), off.max())


def formatted(moments, rate):
    """Return the deviations as columns."""
    return '{:9.3f}{:9.3f}{:9.3f}{:9.2f}'.format(*deviations(moments, rate))


def stolen():
    """Return the time that a host took from this virtual machine so far [s], of all cores."""
    return int(Path('/proc/stat').read_text().split()[8]) / os.sysconf('SC_CLK_TCK')


def floor(rate):
    """Return the line of a bare loop that sleeps until each period is over."""
    moments, period, begin = [], 1.0 / rate, time.perf_counter()
    for k in range(1, round(FLOOR_DURATION * rate)):
        time.sleep(max(0.0, begin + k * period - time.perf_counter()))
        moments.append(time.perf_counter_ns())
    return f'{"bare sleeping loop":20}{rate:8.0f}{"":10}{formatted(moments, rate)}'


def exported(scene, directory):
    """Return the parameters by which the node of closedloop_hardware simulates a scene."""
    model = Path(directory) / f'{scene}.c'
    for command in ([sys.executable, '-m', 'closedloop_dynamics.cli', 'export', scene, '--output',
                     model], ['cc', '-std=c99', '-O3', '-ffp-contract=fast', '-march=native',
                              '-fPIC', '-shared', '-o', model.with_suffix('.so'), model, '-lm']):
        subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    cuts = ','.join(cut.name for cut in load_scene(scene).mechanism.cut_joints)
    return f'model:={model.with_suffix(".so")}', f'forces:=[{cuts}]'


def latencies(node, name, count=300):
    """Return the times from sending an effort of a joint to the state that shows it [ms]."""
    found, wanted = [], [0.0, 0.0]

    def look(message):
        if wanted[1] and message.effort[message.name.index(name)] == wanted[0]:
            found.append(1e3 * (time.perf_counter() - wanted[1]))
            wanted[1] = 0.0

    node.create_subscription(JointState, 'joint_states', look, 1000)
    commands = node.create_publisher(JointState, 'joint_command', 10)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    while len(found) < count:
        if not wanted[1]:
            # At any time within a period.
            time.sleep(np.random.default_rng(len(found)).uniform(0.0, 0.01))
            wanted[:] = 1e-6 * (1 + len(found)), time.perf_counter()
            commands.publish(JointState(name=[name], effort=wanted[:1]))
        executor.spin_once(timeout_sec=0.5)
    executor.shutdown()
    return found


def measure(scene, rate, duration, record, parameters, program=None):
    """Return the lines of one rate."""
    subscriber = Subscriber(scene)
    taken, processes = subscriber.taken, []
    with tempfile.TemporaryDirectory() as directory:
        if record:
            processes.append(start('recorder', f'output:={directory}/bag'))
        if program is None:
            processes.append(start('simulator', f'scene:={scene}', f'publish_rate:={rate}',
                                   *parameters))
        else:
            processes.append(subprocess.Popen([
                program, '--ros-args', '--log-level', 'warn', *(
                    part for each in (f'publish_rate:={rate}', *exported(scene, directory))
                    for part in ('-p', each))]))
        simulator = processes[-1]
        try:
            subscriber.take_until(lambda: len(taken.sent) > 3 * rate)
            taken.clear()
            before, begin = cpu_time(simulator), time.monotonic()
            own, taken_away = time.process_time(), stolen()
            subscriber.take_until(lambda: time.monotonic() - begin > duration)
            elapsed = time.monotonic() - begin
            share = (cpu_time(simulator) - before) / elapsed
            own = (time.process_time() - own) / elapsed
            taken_away = (stolen() - taken_away) / elapsed
            answers = latencies(subscriber.node, load_scene(scene).mechanism.actuated_joints[0])
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait()
    subscriber.close()
    return (f'{scene:20}{rate:8.0f}{len(taken.sent) / elapsed:10.1f}'
            f'{formatted(taken.sent, rate)}{100.0 * share:8.1f}{100.0 * own:12.1f}'
            f'{100.0 * taken_away:8.1f}{taken.received.total():11}{taken.lost.total():7}'
            '\nfrom a command to its state [ms]: '
            '{:.2f} median, {:.2f} 99 %'.format(*np.percentile(answers, (50, 99))))


def main(argv=None):
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--scene', default='carpet_scraper', help='default: %(default)s')
    parser.add_argument('--rates', type=float, nargs='+', default=[1000.0], help='[Hz]')
    parser.add_argument('--duration', type=float, default=10.0, help='of each [s]')
    parser.add_argument('--record', action='store_true', help='with the recorder beside it')
    parser.add_argument('--keep-core-awake', action='store_true',
                        help='with that parameter of the simulator')
    parser.add_argument('--priority', type=int, default=0,
                        help='parameter scheduling_priority of the simulator')
    parser.add_argument('--program', help='measure this node of closedloop_hardware instead')
    arguments = parser.parse_args(argv)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(f'{description()}\nperiods: |period - nominal| [ms]; CPU, stolen: share of a core [%]')
    print(f'{"scene":20}{"rate":>8}{"achieved":>10}{"p50":>9}{"p95":>9}{"p99":>9}{"max":>9}'
          f'{"CPU":>8}{"subscriber":>12}{"stolen":>8}{"received":>11}{"lost":>7}')
    parameters = [f'keep_core_awake:={str(arguments.keep_core_awake).lower()}',
                  f'scheduling_priority:={arguments.priority}']
    for rate in arguments.rates:
        print(floor(rate), flush=True)
        print(measure(arguments.scene, rate, arguments.duration, arguments.record, parameters,
                      arguments.program), flush=True)
        print(floor(rate), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
