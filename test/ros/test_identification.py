# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters come out of a bag that the recorder wrote of the simulator."""

from closedloop_dynamics.cli import main
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

SIMULATOR, RECORDER = 'closedloop_simulator', 'closedloop_recorder'
DRIVES = [0, 5, 6]


@pytest.mark.slow
def test_masses_come_out_of_a_bag_of_the_node(processes, listener, tmp_path, capsys):
    recorder = processes.start(RECORDER, output='bag').wait_until_ready()
    # One period for each command: the motion is the same whatever else the machine does.
    simulator = processes.start(SIMULATOR, scene='three_rrr_horizontal', mode='lockstep')
    simulator.wait_until_ready()
    for topic in ('scene', 'joint_states', 'replay_log'):
        recorder.wait_for(f'/{topic}: first message')
    publisher = listener.publisher('torque_command', Float64MultiArray)
    listener.send(publisher, Float64MultiArray(),
                  lambda: 'torque_command rejected' in simulator.output, 'a rejection')
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
    for process in (simulator, recorder):
        assert process.stop() == 0
    body = 'mechanism.bodies.platform'
    assert main(['identify', str(tmp_path / 'bag'), 'three_rrr_horizontal', '--set',
                 f'{body}.mass=4', '--vary', f'{body}.mass', f'{body}.inertia']) == 0
    out = capsys.readouterr().out
    found = {line.split()[0]: float(line.split()[1]) for line in out.splitlines()
             if line.startswith('mechanism.')}
    assert found[f'{body}.mass'] == pytest.approx(8.0, rel=0.01)
    assert found[f'{body}.inertia'] == pytest.approx(0.16, rel=0.05)
    assert out.count(' identified') == 2
