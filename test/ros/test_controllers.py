# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The controllers to start from: how well they track, by themselves and as nodes in lockstep."""

from importlib.util import find_spec
from pathlib import Path

from closedloop_dynamics.control.controller import closed_loop
from closedloop_dynamics.control.files import read_controller
from closedloop_dynamics.mechanism.kinematics import body_poses, named_point
from closedloop_dynamics.recording.message_numbers import stamp_of
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.torque_source_node import TorqueSourceNode
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python
from sensor_msgs.msg import JointState

CONTROLLERS = Path(__file__).resolve().parents[2] / 'config' / 'controllers'
SPEED = 4.71238898038469


def law_of(name):
    """Return the law of a shipped controller and a simulation to drive."""
    messages = parameter_dict_from_yaml_file(
        str(CONTROLLERS / f'{name}.yaml'), target_nodes=[f'/**/{TorqueSourceNode.NAME}'])
    return law_by(**{key: parameter_value_to_python(message.value)
                     for key, message in messages.items()})


def law_by(**changes):
    """Return the law of parameters, and a simulation to drive."""
    values = {parameter.name: parameter.default for parameter in TORQUE_SOURCE_PARAMETERS}
    values.update(changes)
    simulation = Simulation.from_scene(values['scene'])
    return closed_loop(values, simulation.actuated_joints, simulation), Simulation.from_scene(
        values['scene'])


def run_lockstep(law, simulation, period, duration):
    """Return times, joint positions and velocities of a controlled run, state by state."""
    rows = []
    while simulation.time < duration:
        rows.append((simulation.time, simulation.position, simulation.velocity))
        simulation.step(law.torque(*rows[-1]), period)
    return [np.array(column) for column in zip(*rows)]


def misses(mechanism, position, center):
    """Return how far the platform's centre is from the circle [m]."""
    places = named_point(mechanism, body_poses(mechanism, position), 'platform_center')
    return np.abs(np.hypot(*(places - center).T) - 0.12)


def center_of(name):
    law, simulation = law_of(name)
    return law.controller.reference.center, simulation.mechanism


# What doc/look.md states.
@pytest.mark.parametrize('rate, largest', [(100, 2e-5), (1000, 2e-7)])
def test_platform_follows_its_circle(rate, largest):
    center, mechanism = center_of('three_rrr_circle')
    _, position, _ = run_lockstep(*law_of('three_rrr_circle'), 1.0 / rate, 6.0)
    assert misses(mechanism, position, center).max() < largest
    place = named_point(mechanism, body_poses(mechanism, position), 'platform_center')
    assert np.ptp(place[:, 0]) > 0.2


@pytest.mark.parametrize('rate, largest', [(100, 0.16), (500, 0.007)])
def test_crank_keeps_its_speed(rate, largest):
    time, _, velocity = run_lockstep(*law_of('carpet_scraper_speed'), 1.0 / rate, 5.0)
    assert np.abs(velocity[time > 1.5, 0] - SPEED).max() < largest


@pytest.mark.parametrize('move', [0.0, 0.15])
def test_platform_of_the_3_rrr_is_held_and_moved_under_gravity(move):
    law, simulation = law_by(
        mode='pd', scene='three_rrr', kp=[600.0], kd=[50.0], ki=[1000.0], move_amplitude=[move],
        move_phase=[0.0, 2.0944, 4.1888])
    _, position, _ = run_lockstep(law, simulation, 0.01, 8.0)
    base = position[-400:][:, simulation.data.actuated]
    assert np.ptp(base, axis=0) == pytest.approx([2 * move] * 3, abs=0.02)
    middle = (base.max(axis=0) + base.min(axis=0)) / 2
    offset = -move * np.sin([0.0, 2.0944, 4.1888])
    assert middle == pytest.approx(np.array([1.0467, 4.1883, 5.7637]) + offset, abs=0.02)


@pytest.fixture
def run_nodes(run, listener):
    """Return a function that returns what nodes publish in lockstep: stamps [s], positions."""
    def states_of(name, count, **of_source):
        states = listener.listen('joint_states', JointState)
        arguments = ['--params-file', str(CONTROLLERS / f'{name}.yaml')]
        run(SimulatorNode, arguments=arguments, mode='lockstep')
        listener.wait(lambda: states, 'the first state')
        run(TorqueSourceNode, arguments=arguments, **of_source)
        listener.wait(lambda: len(moving(states)) > count, 'states')
        chosen = moving(states)[:count]
        return np.array([1e-9 * stamp_of(each) for each in chosen]), np.array(
            [each.position for each in chosen])

    return states_of


def moving(states):
    """Return the states from the last one at rest on."""
    first = next((k for k, each in enumerate(states)
                  if list(each.position) != list(states[0].position)), len(states))
    return states[max(0, first - 1):]


@pytest.mark.parametrize('mode', ['linear_regulator', pytest.param(
    'predictive', marks=[pytest.mark.slow, pytest.mark.skipif(
        find_spec('piqp') is None, reason='the extra predictive is not installed')])])
def test_node_keeps_the_point_to_its_path(run_nodes, mode):
    name = 'three_rrr_regulator'
    _, position = run_nodes(name, 110, mode=mode)
    values = read_controller(CONTROLLERS / f'{name}.yaml')
    machine = Simulation.from_scene(values['scene'])
    start = machine.point('platform_center')
    # From rest to rest: the point is at the first place, then leaves it.
    index = round(values['path_durations'][0] / 0.01)
    place = start + values['path_places'][:len(start)]
    away = [np.abs(named_point(machine.mechanism, body_poses(machine.mechanism, one),
                               'platform_center') - place).max() for one in position]
    assert away[index] < 4e-4 and away[0] > 0.04 and away[-1] > 1e-3


def test_nodes_lead_the_platform_round(run_nodes):
    center, mechanism = center_of('three_rrr_circle')
    _, position = run_nodes('three_rrr_circle', 450)
    assert misses(mechanism, position, center).max() < 2e-5
    place = named_point(mechanism, body_poses(mechanism, position), 'platform_center')
    assert np.ptp(place[:, 1]) > 0.1


def test_in_lockstep_nodes_do_what_a_loop_in_python_does(run_nodes):
    time, position = run_nodes('carpet_scraper_speed', 150)
    times, positions, _ = run_lockstep(*law_of('carpet_scraper_speed'), 0.01, 1.5)
    assert np.abs(time - times[:150]).max() < 1e-9
    # Times are whole nanoseconds there, which moves the last digits.
    # States have the cut joints behind those of the tree.
    joints = positions.shape[1]
    np.testing.assert_allclose(position[:, :joints], positions[:150], atol=1e-11)
