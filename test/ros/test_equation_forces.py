# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces of couplings and of prescribed motions on topics, in bags and in replays."""

from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.recording import read_recording
from closedloop_dynamics.recording.replay import replay
from closedloop_dynamics.ros.simulator_node import SimulatorNode
import numpy as np
from sensor_msgs.msg import JointState

TOPICS = ('coupling_forces', 'tooth_forces', 'motion_forces')


def test_a_mechanism_without_couplings_and_motions_has_no_topics_of_them(make_node):
    node = make_node(SimulatorNode, scene='four_bar')
    topics = {name for name, _ in node.get_topic_names_and_types()}
    assert topics.isdisjoint(f'/{topic}' for topic in TOPICS)


def test_forces_are_published_recorded_and_met(run, record, listener, tmp_path, capsys):
    recorder = record()
    # Steps of one size remember nothing: a recording that began late is met to the last bit.
    run(SimulatorNode, scene='geared_five_bar', integrator='rk4',
        motion_joints=['crank_2_joint'], publish_clock=True)
    recorder.wait_for(*TOPICS, 'joint_states', 'replay_log', 'scene')
    seen = {topic: listener.listen(topic, JointState) for topic in TOPICS}
    states = listener.listen('joint_states', JointState)
    listener.wait(lambda: len(states) > 30 and all(map(len, seen.values())), '30 states')
    recorder.end()
    recording = read_recording(tmp_path / 'bag')
    assert set(recording.efforts) == set(TOPICS)
    stamps = recording.stamps.tolist()
    for topic, messages in seen.items():
        names = list(recording.efforts[topic])
        for message in messages[-3:]:
            stamp = message.header.stamp
            assert message.name == names and not any(message.position)
            row = stamps.index(stamp.sec * 10 ** 9 + stamp.nanosec)
            assert list(message.effort) == [
                recording.efforts[topic][name][row] for name in names]
    result = replay(recording)
    for topic in TOPICS:
        for name, values in recording.efforts[topic].items():
            assert np.isfinite(values).sum() > 20 and np.abs(values[np.isfinite(values)]).max() > 0
            deviation = result.efforts[topic][name]
            assert np.nanmax(np.abs(deviation)) == 0.0
    assert main(['replay', str(tmp_path / 'bag'), '--tolerance', '1e-12']) == 0
    assert '(coupling)' in capsys.readouterr().out
