# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Whether a node keeps its periods, and which accuracy, while other programs take the cores.

A real simulator with a budget publishes at a rate; programs that only compute run beside it, more
and more of them, and then none again. For each load one line gives the periods that the node
missed, by the times at which DDS sent its states, and those that a bare loop missed that does
nothing but sleep until the next period, beside the node and for as long. From the node's
diagnostics come the accuracy that it keeps, the bound of the error, and the CPU time that it uses
of its budget.
"""

import argparse
from contextlib import contextmanager
import multiprocessing
import os
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from machine import description
from node_rate import start, Subscriber
import numpy as np


# Programs that compute for no purpose.
BUSY = [sys.executable, '-c', 'while True: pass']
# After a change of the load [s]: the accuracy follows within half a second and more.
SETTLING = 2.0
# What is reported of the method, by a part of its name among the diagnostics.
TOLD = ('accuracy', 'bound in the latest second', 'used of the budget')
HEADER = (f'{"busy":>5}{"node: missed":>14}{"p99 [ms]":>10}{"max [ms]":>10}'
          f'{"loop: missed":>14}{"p99 [ms]":>10}{"max [ms]":>10}{"of":>8}'
          f'{"accuracy":>20}{"bound":>10}{"CPU share":>11}')


@contextmanager
def busy(number):
    """Let programs take the cores."""
    programs = [subprocess.Popen(BUSY) for _ in range(number)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def bare_loop(rate, duration, pipe):
    """Send the moments [ns] at which a loop that sleeps until each period is over was awake."""
    moments, period, begin = [], 1.0 / rate, time.perf_counter()
    for k in range(1, round(duration * rate)):
        time.sleep(max(0.0, begin + k * period - time.perf_counter()))
        moments.append(time.perf_counter_ns())
    pipe.send(moments)


def columns(moments, rate):
    """Return missed periods, and the 99th percentile and maximum of |period - nominal| [ms]."""
    gaps = 1e-9 * np.diff(moments) * rate
    # A period is missed where the next one was due before it was served.
    missed = int(np.maximum(np.floor(gaps + 0.05) - 1.0, 0.0).sum())
    off = 1e3 / rate * np.abs(gaps - 1.0)
    return missed, np.percentile(off, 99), off.max()


class Listener(Subscriber):
    """A subscriber that takes the diagnostics of the method, too."""

    def __init__(self, scene):
        super().__init__(scene)
        self._diagnostics = self.node.create_subscription(
            DiagnosticArray, '/diagnostics', lambda message: None, 100)

    def diagnostics(self):
        """Return what was reported of the method since the last time, a list of {key: float}."""
        found = []
        with self._diagnostics.handle:
            while taken := self._diagnostics.handle.take_message(DiagnosticArray, False):
                for status in taken[0].status:
                    if status.name.endswith('method'):
                        found.append({pair.key: pair.value for pair in status.values})
        return found


def measure(listener, number, rate, duration):
    """Return the line of one load."""
    taken = listener.taken
    with busy(number):
        end = time.monotonic() + SETTLING
        listener.take_until(lambda: time.monotonic() > end)
        taken.clear()
        listener.diagnostics()
        here, there = multiprocessing.Pipe()
        loop = multiprocessing.get_context('fork').Process(
            target=bare_loop, args=(rate, duration, there))
        loop.start()
        listener.take_until(here.poll)
        node, told = columns(taken.sent, rate), listener.diagnostics()
        other = columns(here.recv(), rate)
        loop.join()
    values = [[float(one[key]) for one in told for key in one if key.startswith(part)]
              for part in TOLD]
    accuracy, bound, used = (
        f'{min(each):.0e} .. {max(each):.0e}' if each and part == TOLD[0] else
        f'{np.nanmax(each):.1e}' if each and not np.isnan(each).all() else '-'
        for each, part in zip(values, TOLD))
    return (f'{number:5}{node[0]:14}{node[1]:10.3f}{node[2]:10.2f}{other[0]:14}{other[1]:10.3f}'
            f'{other[2]:10.2f}{len(taken.sent):8}{accuracy:>20}{bound:>10}{used:>11}')


def main(argv=None):
    """Print the table; see the module."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--scene', default='three_rrr', help='default: %(default)s')
    parser.add_argument('--rate', type=float, default=500.0, help='[Hz]')
    parser.add_argument('--budget', type=float, default=0.05)
    parser.add_argument('--duration', type=float, default=10.0, help='of each load [s]')
    cores = os.cpu_count()
    parser.add_argument('--busy', type=int, nargs='+', default=[0, cores, 4 * cores, 0],
                        help='programs beside it, one load after the other')
    parser.add_argument('--priority', type=int, default=0,
                        help='parameter scheduling_priority of the simulator')
    arguments = parser.parse_args(argv)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(f'{description()}\n{arguments.scene}, {arguments.rate:g} Hz, '
          f'budget {arguments.budget:g}\n{HEADER}')
    listener = Listener(arguments.scene)
    simulator = start(
        'simulator', f'scene:={arguments.scene}', f'publish_rate:={arguments.rate}',
        f'budget:={arguments.budget}', f'scheduling_priority:={arguments.priority}')
    try:
        listener.take_until(
            lambda: listener.taken.sent or simulator.poll() is not None)
        for number in arguments.busy:
            print(measure(listener, number, arguments.rate, arguments.duration), flush=True)
    finally:
        simulator.terminate()
        simulator.wait()
        listener.close()
    return 0


if __name__ == '__main__':
    sys.exit(main())
