# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A point under the impedance law gives way as springs and dampers do."""

from closedloop_dynamics import Simulation
from closedloop_dynamics.control.impedance import Impedance
from closedloop_dynamics.mechanism.kinematics import wrench_in_joints
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
import numpy as np
import pytest


def law_of(scene, point, stiffness, damping, limit=np.inf):
    model = Simulation.from_scene(scene)
    count = len(model.actuated_joints)
    return Impedance(model, point, np.array(stiffness), np.array(damping), np.zeros(count),
                     np.full(count, limit))


def pushed(scene, point, law, force, duration, period=0.004):
    """Return a simulation after a constant force along x of the world acted on a point."""
    simulation = Simulation.from_scene(scene)
    body, = (each for each in simulation.mechanism.points if each.name == point)
    place = np.array([*body.position, 0.0][:3])
    while simulation.time < duration:
        turn = simulation.body_poses[[each.name for each in simulation.mechanism.bodies].index(
            body.body)]
        along = np.array([np.cos(turn[2]), -np.sin(turn[2]), 0.0]) if (
            simulation.mechanism.planar) else np.array([1.0, 0.0, 0.0])
        tau = simulation.joint_torques(law.torque(
            simulation.time, simulation.position, simulation.velocity))
        tau[:len(simulation.velocity)] += wrench_in_joints(
            simulation.mechanism, simulation.position, body.body, place,
            np.concatenate([force * along, np.zeros(3)]))
        simulation.advance(tau, round(period / simulation.step_size))
    return simulation


@pytest.mark.parametrize('scene, stiffness', [
    ('three_rrr_vertical', [2000.0, 4000.0, 800.0]),
    pytest.param('three_rrr_horizontal', [5000.0, 2000.0, 800.0], marks=pytest.mark.slow)])
def test_constant_force_moves_the_point_by_force_over_stiffness(scene, stiffness):
    law = law_of(scene, 'platform_center', stiffness, [500.0, 500.0, 60.0])
    start = Simulation.from_scene(scene).point('platform_center')
    simulation = pushed(scene, 'platform_center', law, 50.0, 2.5)
    moved = simulation.point('platform_center') - start
    np.testing.assert_allclose(moved, [50.0 / stiffness[0], 0.0], atol=1e-5)
    assert np.abs(simulation.velocity).max() < 1e-3


def test_platform_in_space_is_held_and_gives_way():
    # Its platform never turns: only the springs along the axes matter.
    law = law_of('delta_robot', 'platform_center', [3000.0] * 3 + [0.0] * 3, [150.0] * 6)
    start = Simulation.from_scene('delta_robot').point('platform_center')
    simulation = pushed('delta_robot', 'platform_center', law, 30.0, 0.8)
    np.testing.assert_allclose(
        simulation.point('platform_center') - start, [0.01, 0.0, 0.0], atol=1e-5)


@pytest.mark.parametrize('scene, point', [
    ('three_rrr_vertical', 'platform_center'), ('delta_robot', 'platform_center')])
def test_torques_have_the_power_of_springs_and_dampers(scene, point):
    simulation = Simulation.from_scene(scene)
    size = 3 if simulation.mechanism.planar else 6
    rng = np.random.default_rng(5)
    stiffness, damping = rng.uniform(50.0, 100.0, size), rng.uniform(5.0, 10.0, size)
    law = law_of(scene, point, stiffness, damping)
    held = law_of(scene, point, 0.0 * stiffness, 0.0 * damping)
    simulation.step(rng.normal(size=len(simulation.actuated_joints)), 0.1)
    q, qd = simulation.position, simulation.velocity
    torque = law.torque(0.0, q, qd) - held.torque(0.0, q, qd)
    power = torque @ qd[simulation.data.actuated]
    # By finite differences along the motion, which closes the loops.
    places, instant = [], 1e-6
    for sign in (1.0, -1.0):
        places.append(simulation.coordinates.moved(q, sign * instant * qd))
    energies = []
    for place, turn, _ in map(law.pose, places):
        away = np.concatenate([law.target[0] - place, _turned(law.target[1], turn)])
        energies.append(0.5 * away @ (law.stiffness * away))
    rate = np.concatenate([law.pose(places[0])[0] - law.pose(places[1])[0],
                           _turned(law.pose(places[0])[1], law.pose(places[1])[1])]) / (
                               2.0 * instant)
    expected = -(energies[0] - energies[1]) / (2.0 * instant) - rate @ (law.damping * rate)
    assert abs(expected) > 1e-3
    assert power == pytest.approx(expected, rel=1e-5)


def _turned(turn, other):
    """Return the rotation vector of a unit quaternion x, y, z, w seen from another."""
    x, y, z, w = other
    left = np.array([[w, z, -y, -x], [-z, w, x, -y], [y, -x, w, -z], [x, y, z, w]]) @ turn
    sine = max(np.linalg.norm(left[:3]), 1e-300)
    return 2.0 * np.arctan2(sine, left[3]) / sine * left[:3]


def test_limit_holds():
    law = law_of('three_rrr_vertical', 'platform_center', [1e5] * 3, [0.0] * 3, limit=3.0)
    simulation = Simulation.from_scene('three_rrr_vertical')
    simulation.step(duration=0.2)
    torque = law.torque(0.0, simulation.position, simulation.velocity)
    assert np.abs(torque).max() == 3.0


@pytest.mark.parametrize('parameters, problem', [
    ({'scene': ''}, "mode 'impedance' needs parameter 'scene'"),
    ({'impedance_point': 'nowhere'}, "'impedance_point': expected one of .*platform_center"),
    ({'stiffness': [0.0]}, 'needs a gain: stiffness, damping are all zero'),
    ({'stiffness': [1.0, 2.0]}, "'stiffness': expected 1 value, or 3 in the order x, y, turn"),
    ({'damping': [-1.0]}, "'damping': expected no negative value"),
    ({'joints': ['theta_1']}, 'drives all actuated joints')])
def test_bad_parameters_are_refused(make_node, parameters, problem):
    with pytest.raises(StartError, match=problem):
        make_node(TorqueSourceNode, **{
            'mode': 'impedance', 'scene': 'three_rrr', 'impedance_point': 'platform_center',
            'stiffness': [100.0], **parameters})


def test_stiffness_changes_while_it_runs(make_node):
    node = make_node(TorqueSourceNode, mode='impedance', scene='three_rrr',
                     impedance_point='platform_center', stiffness=[100.0])
    node.apply_parameters([type('Given', (), {'name': 'stiffness', 'value': [1.0, 2.0, 3.0]})])
    assert node.law.stiffness.tolist() == [1.0, 2.0, 0.0, 0.0, 0.0, 3.0]
