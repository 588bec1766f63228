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
``stolen`` is what the host of a virtual machine took from it meanwhile. ``--program`` measures
the C++ node of ``closedloop_hardware`` in the place of the simulator.
"""

import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from closedloop_dynamics.scene.loading import load_scene
from machine import description, parser_of
import numpy as np
from programs import Programs
import rclpy

from test.ros.taker import Taker  # noqa: I100

# Between two looks for messages [s].
POLL = 0.002
# Of the bare loop [s].
FLOOR_DURATION = 3.0


def jiffies(path, *places):
    """Return the sum of numbers in a file of /proc, those behind a name in parentheses [s]."""
    fields = Path(path).read_text().rpartition(')')[2].split()
    return sum(int(fields[place]) for place in places) / os.sysconf('SC_CLK_TCK')


def deviations(moments, rate):
    """Return median, 95th and 99th percentile and maximum of |period - nominal| [ms], columns."""
    off = np.abs(1e-6 * np.diff(moments) - 1e3 / rate)
    return '{:9.3f}{:9.3f}{:9.3f}{:9.2f}'.format(*np.percentile(off, (50, 95, 99)), off.max())


def floor(rate):
    """Return the line of a bare loop that sleeps until each period is over."""
    moments, period, begin = [], 1.0 / rate, time.perf_counter()
    for k in range(1, round(FLOOR_DURATION * rate)):
        time.sleep(max(0.0, begin + k * period - time.perf_counter()))
        moments.append(time.perf_counter_ns())
    return f'{"bare sleeping loop":20}{rate:8.0f}{"":10}{deviations(moments, rate)}'


def exported(scene, directory):
    """Return the parameters by which the node of closedloop_hardware simulates a scene."""
    model = Path(directory) / f'{scene}.c'
    for command in ([sys.executable, '-m', 'closedloop_dynamics.cli', 'export', scene, '--output',
                     model], ['cc', '-std=c99', '-O3', '-ffp-contract=fast', '-march=native',
                              '-fPIC', '-shared', '-o', model.with_suffix('.so'), model, '-lm']):
        subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    cuts = ','.join(cut.name for cut in load_scene(scene).mechanism.cut_joints)
    return {'model': model.with_suffix('.so'), 'forces': f'[{cuts}]'}


def measure(scene, rate, duration, record, parameters, program=None):
    """Return the line of one rate; ProgramError where a node ends."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('node_rate', context=context)
    taken = Taker(node, scene, keep_times=True)

    def take_until(over):
        while not over():
            taken.take()
            programs.check()
            time.sleep(POLL)

    with tempfile.TemporaryDirectory() as folder, Programs(Path(folder)) as programs:
        if record:
            programs.start('closedloop_recorder', output=f'{folder}/bag')
        simulator = programs.start('closedloop_simulator', path=program, publish_rate=rate, **(
            exported(scene, folder) if program else {'scene': scene, **parameters}))

        def used():
            # Of the simulator, of this process, and what a host took of all cores.
            return np.array([jiffies(f'/proc/{simulator.popen.pid}/stat', 11, 12),
                             time.process_time(), jiffies('/proc/stat', 8)])

        take_until(lambda: len(taken.sent) > 3 * rate)
        taken.clear()
        before, begin = used(), time.monotonic()
        take_until(lambda: time.monotonic() - begin > duration)
        elapsed = time.monotonic() - begin
        share, own, stolen = 100.0 * (used() - before) / elapsed
    node.destroy_node()
    rclpy.try_shutdown(context=context)
    return (f'{scene:20}{rate:8.0f}{len(taken.sent) / elapsed:10.1f}'
            f'{deviations(taken.sent, rate)}{share:8.1f}{own:12.1f}{stolen:8.1f}'
            f'{taken.received.total():11}{taken.lost.total():7}')


def main(arguments=None):
    """Print the table; return the exit code."""
    parser = parser_of(__doc__)
    parser.add_argument('--scene', default='carpet_scraper', help='default: %(default)s')
    parser.add_argument('--rates', type=float, nargs='+', default=[1000.0], help='[Hz]')
    parser.add_argument('--duration', type=float, default=10.0, help='of each [s]')
    parser.add_argument('--record', action='store_true', help='with the recorder beside it')
    parser.add_argument('--keep-core-awake', action='store_true',
                        help='with that parameter of the simulator')
    parser.add_argument('--priority', type=int, default=0,
                        help='parameter scheduling_priority of the simulator')
    parser.add_argument('--program', help='measure this node of closedloop_hardware instead')
    options = parser.parse_args(arguments)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(f'{description()}\nperiods: |period - nominal| [ms]; CPU, stolen: share of a core [%]')
    print(f'{"scene":20}{"rate":>8}{"achieved":>10}{"p50":>9}{"p95":>9}{"p99":>9}{"max":>9}'
          f'{"CPU":>8}{"subscriber":>12}{"stolen":>8}{"received":>11}{"lost":>7}')
    parameters = {'keep_core_awake': str(options.keep_core_awake).lower(),
                  'scheduling_priority': options.priority}
    for rate in options.rates:
        print(floor(rate), flush=True)
        print(measure(options.scene, rate, options.duration, options.record, parameters,
                      options.program), flush=True)
        print(floor(rate), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
