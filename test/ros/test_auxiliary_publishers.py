# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of what goes along with the states: descriptions, replay log, markers."""

import math

from builtin_interfaces.msg import Time
from closedloop_dynamics.mechanism.kinematics import world_points
from closedloop_dynamics.ros.auxiliary_publishers import COLUMNS, NO_STATE
from closedloop_dynamics.ros.markers import contact_force
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.scene.text import read_scene_text
from closedloop_dynamics.visual.urdf import urdf
import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray, String
from visualization_msgs.msg import Marker, MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def simulator(make_node):
    """Return a function that creates a simulator whose timer does not tick by itself."""
    def make(**parameters):
        node = make_node(SimulatorNode, wait_for_command=True, **parameters)
        node.timer.cancel()
        return node

    return make


def collect(listener, topic, kind, profile=10):
    messages = []
    listener.node.create_subscription(kind, topic, messages.append, profile)
    return messages


def test_descriptions_are_there_for_whoever_comes_late(simulator, listener):
    node = simulator(scene='slider_crank')
    descriptions = collect(listener, 'robot_description', String, LATCHED)
    scenes = collect(listener, 'scene', String, LATCHED)
    listener.wait(lambda: descriptions and scenes, 'latched messages')
    assert descriptions[0].data == urdf(
        node.simulation.mechanism, '/joint_command', '/joint_states')
    scene, facts = read_scene_text(scenes[0].data)
    shipped = load_scene('slider_crank')
    assert (scene.mechanism, scene.initial, scene.effects, scene.method) == (
        shipped.mechanism, shipped.initial, shipped.effects, shipped.method)
    assert facts == {'after': 0, 'columns': [*COLUMNS, *node.simulation.torque_names]}


def test_scene_is_published_again_when_it_changes(simulator, listener):
    node = simulator(scene='three_rrr')
    scenes = collect(listener, 'scene', String, LATCHED)
    listener.wait(lambda: scenes, 'scene')
    node.live.publish()
    node.set_parameters([Parameter('effects.gravity.acceleration', value=[0.0, -1.62])])
    node.set_parameters([Parameter('effects.gravity.enabled', value=False)])
    node.live.publish()
    listener.wait(lambda: len(scenes) > 1, 'the changed scene')
    node.live.publish()
    scene, facts = read_scene_text(scenes[-1].data)
    assert scene.effects['gravity'].acceleration == (0.0, -1.62)
    # Since the one state that was published before.
    assert (facts['after'], scene.switched_off) == (1, ('gravity',))
    assert len(scenes) == 2


def test_replay_log_tells_times_and_commands(simulator, listener):
    node = simulator(scene='four_bar')
    entries = collect(listener, 'replay_log', Float64MultiArray)
    listener.wait(lambda: node.count_subscribers('replay_log'), 'subscription')
    node.live.publish()
    for torque in (0.5, -0.25):
        node.command.torque[:] = torque
        node.live.advance(7)
        node.live.publish()
    # A command that changes between two states.
    node.live.advance(2)
    node.command.torque[:] = 1.0
    node.live.advance(3)
    node.live.publish()
    node.simulation.reset()
    node.live.publish()
    listener.wait(lambda: len(entries) == 6, 'six entries')
    # Names are published once, in the scene: they would be three quarters of each entry.
    assert not entries[0].layout.dim
    names = [*node.log.columns, *(f'state.{k}' for k in range(len(node.simulation.state)))]
    assert node.log.columns == [*COLUMNS, *node.simulation.joint_names]
    assert entries[-1].data[-len(node.simulation.state):].tolist() == (
        node.simulation.state.tolist())
    table = dict(zip(names, np.array([entry.data for entry in entries]).T))
    assert table['simulated_time'].tolist() == [0.0, 0.007, 0.014, 0.016, 0.019, 0.0]
    assert np.diff(table['index']).tolist() == [1.0] * 5
    assert np.diff(table['jumps']).tolist() == [0.0, 0.0, 0.0, 0.0, 1.0]
    assert table['crank_joint'].tolist()[1:5] == [0.5, -0.25, -0.25, 1.0]
    assert (table['stamp_sec'] == NO_STATE).tolist() == [False, False, False, True, False, False]
    stamp = node.states.stamp
    assert (table['stamp_sec'][-1], table['stamp_nanosec'][-1]) == (stamp.sec, stamp.nanosec)


def by_name(array):
    markers = {}
    for marker in array.markers:
        assert marker.header.frame_id == 'world'
        markers.setdefault(marker.ns, []).append(marker)
    return markers


def xy(points):
    return np.array([(each.x, each.y) for each in points])


def pose_of(marker):
    return np.array([marker.pose.position.x, marker.pose.position.y, 2.0 * math.atan2(
        marker.pose.orientation.z, marker.pose.orientation.w)])


@pytest.mark.parametrize('scene', ['three_rrr', 'carpet_scraper'])
def test_markers_are_where_the_machine_is(simulator, scene):
    node = simulator(scene=scene)
    simulation = node.simulation
    for _ in range(20):
        simulation.step(duration=0.01)
        markers = by_name(node.markers.array(Time(sec=3)))
    strips = [each for each in markers['links'] if each.type == Marker.LINE_STRIP]
    assert len(strips) == len(simulation.mechanism.bodies)
    for marker, pose in zip(strips, simulation.body_poses):
        np.testing.assert_allclose(
            world_points(pose_of(marker), xy(marker.points)),
            world_points(pose, xy(marker.points)), atol=1e-12)
    cuts = xy(markers['cut_joints'][0].points)
    forces = simulation.constraint_forces[:, 1:]
    arrows = markers['constraint_forces']
    assert len(arrows) == len(forces) == len(cuts)
    lengths = []
    for arrow, place, force in zip(arrows, cuts, forces):
        start, end = xy(arrow.points)
        np.testing.assert_allclose(start, place, atol=1e-12)
        lengths.append(np.hypot(*(end - start)))
        np.testing.assert_allclose(
            (end - start) / lengths[-1], force / np.hypot(*force), atol=1e-9)
    np.testing.assert_allclose(
        np.array(lengths) / lengths[0], np.hypot(*forces.T) / np.hypot(*forces[0]), rtol=1e-9)
    point = simulation.mechanism.points[0].name
    trail = xy(markers['path'][0].points)
    assert len(trail) > 3
    assert np.hypot(*(trail[-1] - simulation.point(point))) < 0.01


def test_carpet_and_its_force_are_shown(simulator):
    node = simulator(scene='carpet_scraper_on_carpet')
    simulation = node.simulation
    while simulation.effect_readings('carpet')['depth'] < 1e-3:
        simulation.step({'theta_1': 20.0}, 0.01)
        assert simulation.time < 5.0
    markers = by_name(node.markers.array(Time()))
    line, = markers['contacts']
    assert xy(line.points)[:, 1] == pytest.approx([-0.216, -0.216])
    force, = markers['effects']
    start, end = xy(force.points)
    np.testing.assert_allclose(start, simulation.point('tool'), atol=1e-12)
    readings = simulation.effect_readings('carpet')
    assert end[1] > start[1]
    expected = contact_force(simulation.effects['carpet'], readings)
    assert expected[1] == pytest.approx(readings['normal_force'])
    assert abs(expected[0]) == pytest.approx(
        abs(readings['friction_force'] + readings['scraping_force']))
    # What ends is taken away in the viewer, too.
    simulation.set_effect('carpet', enabled=False)
    first = node.markers.array(Time()).markers[0]
    assert first.action == Marker.DELETEALL


def test_nothing_is_drawn_when_nobody_looks(simulator, listener, context, monkeypatch):
    node = simulator(scene='four_bar', marker_rate=200.0)
    markers = node.markers
    drawn = []
    array = markers.array
    monkeypatch.setattr(markers, 'array', lambda *of: drawn.append(1) or array(*of))
    markers.next_due = 0.0
    node.live.publish()
    assert not drawn
    pictures = collect(listener, 'visualization_marker_array', MarkerArray)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def seen():
        executor.spin_once(timeout_sec=0.0)
        node.live.publish()
        return pictures

    listener.wait(seen, 'markers')
    assert drawn
    executor.shutdown()


def test_markers_can_be_switched_off(simulator):
    node = simulator(scene='four_bar', marker_rate=0.0)
    node.live.publish()
    topics = dict(node.get_publisher_names_and_types_by_node(node.get_name(), '/'))
    assert '/visualization_marker_array' not in topics
    assert '/joint_states' in topics


def test_a_point_that_does_not_exist_is_named(simulator):
    with pytest.raises(StartError, match="'marker_point': expected one of the points"):
        simulator(scene='three_rrr', marker_point='nose')


@pytest.mark.parametrize('scene', [
    'three_rrr', pytest.param('delta_robot', marks=pytest.mark.slow)])
def test_accuracy_is_written_below_the_machine(simulator, scene):
    node = simulator(scene=scene)
    assert 'accuracy' not in by_name(node.markers.array(Time()))
    node.simulation.step(duration=0.2)
    node.publish_diagnostics()
    text, = by_name(node.markers.array(Time()))['accuracy']
    closure, error, energy = text.text.splitlines()
    assert float(closure.split()[1]) == pytest.approx(
        node.simulation.report().closure, rel=0.1, abs=1e-18)
    assert 0.0 < float(error.split()[1]) < 1e-3
    assert abs(float(energy.split()[1])) < 1e-6
    places = node.simulation.body_poses
    down = 1 if node.simulation.mechanism.planar else 2
    assert [text.pose.position.y, text.pose.position.z][down - 1] < places[:, down].min()
