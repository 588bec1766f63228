# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of what is broadcast on ``/tf``: where cut points and links are."""

from types import SimpleNamespace

from closedloop_dynamics.ros import frames
from closedloop_dynamics.ros.messages import SerializedTemplate
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray


@pytest.fixture
def broadcast(make_node, monkeypatch):
    """Return a function that makes a simulator, and what it broadcasts, without the real type."""
    def make(still=frozenset(), **parameters):
        monkeypatch.setattr(frames, 'TFMessage', lambda: SimpleNamespace(transforms=[]))
        monkeypatch.setattr(frames, 'SerializedTemplate', lambda build, sizes: SimpleNamespace(
            filled=build))
        sent = {'/tf': [], '/tf_static': []}
        create = SimulatorNode.create_publisher
        monkeypatch.setattr(
            SimulatorNode, 'create_publisher', lambda node, kind, topic, *more: create(
                node, kind, topic, *more) if topic not in sent else SimpleNamespace(
                publish=sent[topic].append, get_subscription_count=lambda: 1))
        node = make_node(SimulatorNode, wait_for_command=True, **parameters)
        node.timer.cancel()
        for _ in range(20):
            node.simulation.step(duration=0.01)
        node.live.publish()
        moving, = sent['/tf']
        # Once, however many states there are.
        node.live.on_published[0](node.states.stamp)
        assert len(sent['/tf']) == 2 and len(sent['/tf_static']) <= 1
        found = {frame.child_frame_id: frame for frame in moving.transforms}
        assert not still & set(found)
        return node, found | {
            frame.child_frame_id: frame for message in sent['/tf_static']
            for frame in message.transforms}

    return make


def pose(frame):
    """Return x, y and angle of a frame."""
    place, turn = frame.transform.translation, frame.transform.rotation
    assert (place.z, turn.x, turn.y) == (0.0, 0.0, 0.0)
    return np.array([place.x, place.y, 2.0 * np.arctan2(turn.z, turn.w)])


@pytest.mark.parametrize('scene', ['three_rrr', 'slider_crank'])
def test_constraint_forces_refer_to_frames_at_the_cut_points(broadcast, scene):
    node, found = broadcast(scene=scene)
    simulation = node.simulation
    assert list(found) == [
        f'constraint_forces/{cut.name}' for cut in simulation.mechanism.cut_joints]
    rows = {body.name: row for body, row in zip(
        simulation.mechanism.bodies, simulation.body_poses)}
    for name, cut, message in zip(
            found, simulation.mechanism.cut_joints, node.states.templates):
        wrench = deserialize_message(message.filled(0, 0, np.zeros(6)), WrenchStamped)
        assert wrench.header.frame_id == name
        x, y, angle = rows[cut.body_a]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        expected = np.array([x, y]) + turn @ cut.point_a
        np.testing.assert_allclose(pose(found[name]), [*expected, 0.0], atol=1e-12)
        assert found[name].header.frame_id == 'world'
        stamp = found[name].header.stamp
        assert (stamp.sec, stamp.nanosec) == (node.states.stamp.sec, node.states.stamp.nanosec)


def test_links_are_where_they_are_under_a_prefix(broadcast):
    node, found = broadcast(still={'left/ground'}, scene='three_rrr', publish_tf=True,
                            cut_frames=False, frame_prefix='left/')
    mechanism = node.simulation.mechanism
    assert list(found) == [*(f'left/{body.name}' for body in mechanism.bodies), 'left/ground']
    np.testing.assert_array_equal(pose(found['left/ground']), np.zeros(3))
    for frame, expected in zip(found.values(), node.simulation.body_poses):
        assert frame.header.frame_id == 'left/world'
        miss = pose(frame) - expected
        np.testing.assert_allclose(miss[:2], 0.0, atol=1e-12)
        assert np.sin(miss[2] / 2.0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.skipif(frames.TFMessage is not None, reason='tf2_msgs is installed')
def test_without_the_message_type_forces_refer_to_the_world(make_node):
    node = make_node(SimulatorNode, scene='four_bar', wait_for_command=True)
    message, = node.states.templates
    wrench = deserialize_message(message.filled(0, 0, np.zeros(6)), WrenchStamped)
    assert wrench.header.frame_id == 'world'
    with pytest.raises(StartError, match='tf2_msgs/msg/TFMessage is not installed'):
        make_node(SimulatorNode, scene='four_bar', publish_tf=True)


def test_all_headers_of_a_serialised_message_carry_its_stamp():
    def array(sec, nanosec, *poses):
        message = MarkerArray()
        for numbers in poses:
            each = Marker()
            each.header.stamp.sec, each.header.stamp.nanosec = sec, nanosec
            place, turn = each.pose.position, each.pose.orientation
            place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = numbers.tolist()
            message.markers.append(each)
        return message

    message = SerializedTemplate(array, (7, 7))
    assert message.direct
    numbers = np.arange(14.0).reshape(2, 7)
    for stamp in ((3, 4), (5, 6)):
        got = deserialize_message(message.filled(*stamp, *numbers), MarkerArray)
        assert got == array(*stamp, *numbers)
