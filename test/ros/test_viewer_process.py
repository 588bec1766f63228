# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The viewer as a process of its own: a page drives a simulator, which is killed meanwhile."""

import re
import signal
from test.view.client import Client

from sensor_msgs.msg import JointState

from .test_faults import applied


def test_a_page_drives_a_simulator_of_another_process(processes, listener):
    """A simulator that is killed is reported on the page; the viewer ends well on a signal."""
    simulator = processes.start('closedloop_simulator', scene='four_bar').wait_until_ready()
    viewer = processes.start(
        'closedloop_viewer', nodes='[/closedloop_simulator]').wait_until_ready()
    states = listener.listen('joint_states', JointState)
    with Client(re.search(r'http\S+', viewer.output)[0]) as client:
        client.until(lambda client: client.row is not None)
        client.ask('command', joint='crank_joint', value=0.5)
        listener.wait(lambda: applied(states, [0.5]), 'state with the torque')
        simulator.stop(signal.SIGKILL)
        client.until(lambda client: client.controls.get('failure'))
        assert 'publishes no states' in client.controls['failure']
    assert viewer.stop() == 0
    assert 'Traceback' not in viewer.output
