# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Wrenches from a topic act on bodies as forces do that a scene lists."""

from dataclasses import replace

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.effects.registry import ExternalForce
from closedloop_dynamics.ros.external_wrench import TIMEOUT
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def wrench(frame, force=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0)):
    message = WrenchStamped()
    message.header.frame_id = frame
    for part, values in ((message.wrench.force, force), (message.wrench.torque, torque)):
        part.x, part.y, part.z = map(float, values)
    return message


@pytest.fixture
def make(make_node, monkeypatch):
    """Return a function that makes a simulator whose time goes on with commands."""

    def make(scene):
        # A period is a step: the torques of the joints are as new as those of an effect.
        node = make_node(SimulatorNode, scene=scene, mode='lockstep', publish_rate=1000.0,
                         step_size=0.001)
        node.warnings = []
        monkeypatch.setattr(node, 'warn', lambda kind, text: node.warnings.append(text))
        return node

    return make


def advance(node, periods):
    for _ in range(periods):
        node.on_torque_command(Float64MultiArray(
            data=[0.0] * len(node.simulation.actuated_joints)))


@pytest.mark.parametrize('scene, point, force, torque', [
    ('three_rrr', 'corner_2', (3.0, -2.0, 0.0), (0.0, 0.0, 0.4)),
    # In space one that is unrolled soon; a platform with --all.
    ('rssr_four_bar', 'rocker_end', (5.0, -3.0, 4.0), (0.5, 0.2, -0.1)),
    pytest.param('stewart_platform', 'platform_center', (5.0, -3.0, 40.0), (0.5, 2.0, -1.0),
                 marks=pytest.mark.slow)])
def test_a_wrench_moves_the_mechanism_as_the_effect_does(make, scene, point, force, torque):
    node = make(scene)
    simulation, read = node.simulation, load_scene(scene)
    planar = read.mechanism.planar
    reference = Simulation.from_scene(replace(read, effects={**read.effects, 'push': ExternalForce(
        point=point, force=force[:2] if planar else force, torque=torque[2] if planar else torque,
        axes='body')}), step_size=0.001)
    node.live.wrench.accept(wrench(point, force, torque))
    start, idle = simulation.position, Simulation.from_scene(
        read, step_size=0.001)
    for _ in range(20):
        advance(node, 1)
        reference.step()
        idle.step()
    # Between two steps the axes of the body turn, but not the torques of the joints.
    moved = np.abs(reference.position - idle.position).max()
    assert moved > 1e-4 and np.abs(start - simulation.position).max() > 1e-4
    np.testing.assert_allclose(simulation.position, reference.position, rtol=0, atol=1e-2 * moved)
    # The drives do nothing, and are not said to.
    assert simulation.effort.any()
    np.testing.assert_array_equal(node.live.wrench.without(simulation.effort), 0.0)
    assert simulation.energy_balance.work == pytest.approx(
        reference.energy_balance.work, rel=2e-2)


def test_the_first_step_under_a_wrench_is_that_under_the_effect(make):
    node, read = make('three_rrr'), load_scene('three_rrr')
    effect = ExternalForce(point='corner_2', force=(3.0, -2.0), torque=0.4, axes='body')
    reference = Simulation.from_scene(replace(read, effects={**read.effects, 'push': effect}))
    node.live.wrench.accept(wrench('corner_2', (3.0, -2.0, 0.0), (0.0, 0.0, 0.4)))
    tau = np.zeros(len(node.simulation.torque_names))
    node.live.wrench.act(tau)
    simulation = node.simulation
    simulation.advance(tau, 0)
    np.testing.assert_allclose(simulation.acceleration, reference.acceleration, rtol=1e-7)
    np.testing.assert_allclose(
        simulation.constraint_forces, reference.constraint_forces, rtol=1e-7, atol=1e-9)


def test_a_wrench_ends_and_nothing_is_left_of_it(make):
    node = make('three_rrr')
    periods = round(1000 * TIMEOUT)
    node.on_external_wrench(wrench('platform', (0.1, 0.0, 0.0)))
    advance(node, periods)
    assert node.live.wrench.torques.any()
    advance(node, 1)
    assert not node.live.wrench.torques.any() and not node.simulation.effort.any()
    # None ends it at once, and so does a reset.
    for end in (lambda: node.on_external_wrench(wrench('platform')), node.reset):
        node.on_external_wrench(wrench('platform', (0.1, 0.0, 0.0)))
        advance(node, 1)
        assert node.live.wrench.torques.any()
        end()
        advance(node, 1)
        assert not node.live.wrench.torques.any()
    assert node.live.wrench.counts == {'wrenches taken': 4, 'wrenches refused': 0}


def test_bad_wrenches_are_refused_counted_and_reported(make):
    node = make('three_rrr')
    bad = {'frame_id': wrench('platfrom', (1.0, 0.0, 0.0)),
           'finite': wrench('platform', (float('nan'), 0.0, 0.0)),
           'torque z': wrench('platform', (0.0, 0.0, 1.0)),
           'can follow': wrench('platform', (1e308, 0.0, 0.0))}
    for part, message in bad.items():
        node.on_external_wrench(message)
        assert node.warnings[-1].startswith('external_wrench refused: ')
        assert part in node.warnings[-1]
    advance(node, 1)
    assert not node.simulation.effort.any()
    assert node.live.wrench.counts == {'wrenches taken': 0, 'wrenches refused': 4}


def test_a_scene_with_limited_drives_takes_none(make):
    node = make('carpet_scraper_on_carpet')
    node.on_external_wrench(wrench('tool', (1.0, 0.0, 0.0)))
    assert 'actuator' in node.warnings[0]


def test_a_wrench_from_another_node_acts(run, listener):
    node = run(SimulatorNode, scene='three_rrr')
    states = listener.listen('joint_states', JointState)
    wrenches = listener.publisher('external_wrench', WrenchStamped)
    listener.wait(lambda: states, 'a state')
    listener.send(wrenches, wrench('platform_center', (2.0, 0.0, 0.0)), lambda: np.abs(
        np.array(states[-1].position) - states[0].position).max() > 0.01, 'motion')
    assert not np.any(states[-1].effort)
    assert not node.live.wrench.counts['wrenches refused']
