# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Simulator and torque source, started again and again on a machine that has no time for them."""

from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
import sys

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

CONFIG = Path(__file__).resolve().parents[2] / 'config'
GAINS = {'mode': 'pd', 'kp': '[600.0]', 'kd': '[50.0]', 'ki': '[1000.0]'}
# The pairs of commands in the documents: a file for both nodes, or parameters of each.
PAIRS = {
    'scraper': (None, {'scene': 'carpet_scraper', 'wait_for_command': 'true'}, {
        'mode': 'computed_torque', 'scene': 'carpet_scraper', 'target_velocity': '[4.7124]',
        'kp': '[100.0]', 'kd': '[20.0]', 'torque_limit': '[100.0]'}),
    'platform': (None, {'scene': 'three_rrr', 'wait_for_command': 'true'}, {
        **GAINS, 'torque_limit': '[200.0]'}),
    'circle': (CONFIG / 'controllers' / 'three_rrr_circle.yaml', {}, {}),
    'circle_in_lockstep': (
        CONFIG / 'controllers' / 'three_rrr_circle.yaml', {'mode': 'lockstep'}, {}),
}
# States that a run lasts, at 100 a second.
STATES = 200


@contextmanager
def load():
    """Keep twice as many processes busy as there are cores, while the body runs."""
    busy = [subprocess.Popen([sys.executable, '-S', '-c', 'while True: pass'])
            for _ in range(2 * len(os.sched_getaffinity(0)))]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def attack(pair, starts, processes, listener, enough=STATES):
    """Start a pair so often; return what those said that did not end well."""
    file, simulated, driven = PAIRS[pair]
    arguments = ['--ros-args', '--params-file', str(file)] if file else []
    states, bad = listener.listen('joint_states', JointState), []
    for _ in range(starts):
        states.clear()
        simulator = processes.start('closedloop_simulator', arguments=arguments, **simulated)
        # It begins when this one listens, too, and by then the machine is busy.
        source = processes.start(
            'closedloop_torque_source', arguments=arguments, wait_for_subscribers=2, **driven)
        source.wait_until_ready()
        simulator.wait_until_ready()
        with load():
            ear = listener.node.create_subscription(
                Float64MultiArray, 'torque_command', lambda message: None, 10)
            listener.wait(
                lambda: simulator.popen.poll() is not None or source.popen.poll() is not None
                or sum(any(state.effort) for state in states) > enough, 'a run that ends or lasts')
        codes = simulator.stop(), source.stop()
        listener.node.destroy_subscription(ear)
        if codes != (0, 0) or 'Traceback' in simulator.output + source.output:
            bad.append(simulator.output + source.output)
    print(f'{pair}: {starts} starts, {starts - len(bad)} ended well')
    return bad


@pytest.mark.slow
def test_pair_of_commands_ends_well_on_a_busy_machine(processes, listener):
    assert attack('scraper', 1, processes, listener, STATES // 4) == []


@pytest.mark.slow
@pytest.mark.timeout(14400)
@pytest.mark.parametrize('pair', PAIRS)
def test_every_pair_of_commands_ends_well_however_often(pair, request, processes, listener):
    assert attack(pair, request.config.getoption('--starts'), processes, listener) == []
