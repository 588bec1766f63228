# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters come out of a bag that the recorder wrote of the simulator."""

from closedloop_dynamics.cli import main
from closedloop_dynamics.ros.simulator_node import SimulatorNode
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

DRIVES = [0, 5, 6]


def test_masses_come_out_of_a_bag_of_the_node(run, record, listener, tmp_path, capsys):
    recorder = record()
    # One period for each command: the motion is the same whatever else the machine does.
    run(SimulatorNode, scene='three_rrr_horizontal', mode='lockstep')
    recorder.wait_for('scene', 'joint_states', 'replay_log')
    publisher = listener.publisher('torque_command', Float64MultiArray)
    stamps, start = [], []

    def answer(message):
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if stamps and stamp <= stamps[-1]:
            return
        stamps.append(stamp)
        position, velocity = (np.array(each)[DRIVES] for each in (
            message.position, message.velocity))
        start.append(position)
        # Springs and dampers hold it near its start, and drives of other rates move it.
        torque = 20.0 * (start[0] - position) - 2.0 * velocity + 8.0 * np.sin(
            np.array([5.0, 7.0, 9.0]) * stamp)
        publisher.publish(Float64MultiArray(data=torque.tolist()))

    listener.node.create_subscription(JointState, 'joint_states', answer, 10)
    listener.wait(lambda: len(stamps) > 200, '2 s of motion')
    recorder.end()
    body = 'mechanism.bodies.platform'
    assert main(['identify', str(tmp_path / 'bag'), 'three_rrr_horizontal', '--set',
                 f'{body}.mass=4', '--vary', f'{body}.mass', f'{body}.inertia']) == 0
    out = capsys.readouterr().out
    found = {line.split()[0]: float(line.split()[1]) for line in out.splitlines()
             if line.startswith('mechanism.')}
    assert found[f'{body}.mass'] == pytest.approx(8.0, rel=0.01)
    assert found[f'{body}.inertia'] == pytest.approx(0.16, rel=0.05)
    assert out.count(' identified') == 2
