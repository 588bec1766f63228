# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the simulator node, switched and changed through its parameters."""

from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from geometry_msgs.msg import Vector3
import pytest
from rclpy.parameter import Parameter


def set_values(node, **values):
    """Set parameters of effects together; return the result."""
    return node.set_parameters_atomically([
        Parameter(f'effects.{key.replace("__", ".")}', value=value)
        for key, value in values.items()])


@pytest.fixture
def node(make_node):
    return make_node(SimulatorNode, scene='carpet_scraper_on_carpet')


def test_parameters_tell_the_scene(node):
    assert node.get_parameter('effects.carpet.enabled').value is True
    assert node.get_parameter('effects.carpet.friction').value == 0.4
    assert list(node.get_parameter('effects.gravity.acceleration').value) == [0.0, -9.81]
    assert 'contact' in node.describe_parameter('effects.carpet.friction').description


def test_an_effect_is_switched_and_changed_while_the_node_runs(node):
    assert set_values(node, carpet__enabled=False, gravity__acceleration=[0.0, -1.62]).successful
    assert 'carpet' not in node.simulation.data.enabled_effects
    assert node.simulation.effects['gravity'].acceleration == (0.0, -1.62)
    # A whole number will do.
    assert set_values(node, carpet__enabled=True, carpet__friction=1).successful
    assert node.simulation.effects['carpet'].friction == 1.0


@pytest.mark.parametrize('values, reason', [
    ({'carpet__friction': -0.1}, 'effects.carpet.friction'),
    ({'carpet__stiffness': 'soft'}, 'effects.carpet.stiffness'),
    ({'carpet__point': 'heel'}, 'tool'),
    ({'gravity__acceleration': [1.0]}, 'effects.gravity.acceleration')])
def test_impossible_values_are_refused_with_the_reason(node, values, reason):
    before = node.simulation.effects
    result = set_values(node, carpet__friction=0.9, **values) if (
        'carpet__friction' not in values) else set_values(node, **values)
    assert not result.successful
    assert reason in result.reason
    assert node.simulation.effects == before


def test_a_limit_is_given_and_taken_away(node):
    assert set_values(node, motor__max_speed=5.0).successful
    assert node.simulation.effects['motor'].max_speed == 5.0


def test_values_given_at_the_start_are_followed_or_refused(make_node):
    node = make_node(SimulatorNode, scene='three_rrr',
                     **{'effects.gravity.acceleration': [0.0, -3.7]})
    assert node.simulation.effects['gravity'].acceleration == (0.0, -3.7)
    with pytest.raises(StartError, match='effects.gravity.acceleration'):
        make_node(SimulatorNode, scene='three_rrr', **{'effects.gravity.acceleration': [0.0]})


def test_a_force_follows_its_topic(make_node, tmp_path):
    scene = tmp_path / 'pushed.yaml'
    scene.write_text(
        'mechanism: slider_crank\n'
        'initial:\n'
        '  position: {crank_joint: 1.0472, rod_joint: -1.34, slider_joint: 0.3372}\n'
        '  hold: [crank_joint]\n'
        'effects:\n'
        '  push: {type: external_force, point: wrist_pin}\n')
    node = make_node(SimulatorNode, scene=str(scene))
    node.effect_parameters.on_force('push', Vector3(x=3.0, y=-1.0))
    assert node.simulation.effects['push'].force == (3.0, -1.0)
    node.effect_parameters.on_force('push', Vector3(x=float('nan')))
    assert node.simulation.effects['push'].force == (3.0, -1.0)


def test_numbers_with_names_of_their_own_are_parameters(make_node, tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(
        'mechanism: slider_crank\n'
        'initial:\n'
        '  position: {crank_joint: 1.0472, rod_joint: -1.34, slider_joint: 0.3372}\n'
        '  hold: [crank_joint]\n'
        'effects: {brake: {type: law, joints: {x: crank_joint}, rates: {v: x}, '
        'parameters: {c: 0.5, d: 1.0}, forces: {x: -c*v - d}}}\n')
    node = make_node(SimulatorNode, scene=str(path))
    assert node.get_parameter('effects.brake.parameters.c').value == 0.5
    assert node.get_parameter('effects.brake.forces.x').value == '-c*v - d'
    result = node.set_parameters_atomically([
        Parameter('effects.brake.parameters.c', value=2.0)])
    assert result.successful
    assert node.simulation.effects['brake'].parameters == {'c': 2.0, 'd': 1.0}
    result = node.set_parameters_atomically([
        Parameter('effects.brake.forces.x', value='-c*v - __import__("os")')])
    assert not result.successful and 'effects.brake.forces.x' in result.reason
    assert node.simulation.effects['brake'].forces == {'x': '-c*v - d'}
