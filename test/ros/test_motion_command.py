# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Motions that are commanded by a topic, from another process and by callbacks."""

import math

from builtin_interfaces.msg import Duration, Time
from closedloop_dynamics.cli import main
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


def trajectory(names, *points, stamp=0.0):
    """Return a trajectory; each point has its time [s], positions, velocities, accelerations."""
    return JointTrajectory(
        header=Header(stamp=Time(sec=int(stamp), nanosec=round(1e9 * (stamp % 1.0)))),
        joint_names=names, points=[JointTrajectoryPoint(
            time_from_start=Duration(sec=int(time), nanosec=round(1e9 * (time % 1.0))),
            **{key: [float(value) for value in values] for key, values in zip(
                ('positions', 'velocities', 'accelerations', 'effort'), rows)})
            for time, *rows in points])


BAD = [
    trajectory([], (1.0, [])),
    trajectory(['theta_2'], (1.0, [1.0])),
    trajectory(['theta_1', 'theta_1'], (1.0, [1.0, 1.0])),
    trajectory(['theta_1']),
    trajectory(['theta_1'], (1.0, [math.nan])),
    trajectory(['theta_1'], (1.0, [1.0, 2.0])),
    trajectory(['theta_1'], (1.0, [1.0], [math.inf])),
    trajectory(['theta_1'], (1.0, [1.0], [1.0])),
    trajectory(['theta_1'], (1.0, [1.0], [0.0], [0.0], [5.0])),
    trajectory(['theta_1'], (1.0, [1.0]), (0.5, [1.0])),
    trajectory(['theta_1'], (0.0, [2.0]), (0.5, [1.0])),
    trajectory(['theta_1'], (1.0, [1e9])),
    trajectory(['theta_1'], (0.001, [1.0]), stamp=1.0)]


@pytest.fixture
def node(make_node, monkeypatch):
    """Return a simulator whose time goes on with torque commands, which have no values."""
    node = make_node(SimulatorNode, scene='carpet_scraper', motion_joints=['theta_1'],
                     mode='lockstep')
    node.warnings = []
    monkeypatch.setattr(node, 'warn', lambda kind, text: node.warnings.append(text))
    return node


def advance(node, periods):
    """Go on by some periods of 10 ms."""
    for _ in range(periods):
        node.on_torque_command(Float64MultiArray())


def test_a_trajectory_is_followed_and_bad_ones_change_nothing(node):
    simulation = node.simulation
    assert simulation.actuated_joints == ()
    advance(node, 101)
    before = simulation.state, simulation.effects
    for message in BAD:
        node.on_motion_command(message)
    assert np.array_equal(simulation.state, before[0]) and simulation.effects == before[1]
    assert node.motion.counts['motions refused'] == len(BAD) == len(node.warnings)
    assert all(text.startswith('motion_command refused: ') for text in node.warnings)
    node.on_motion_command(trajectory(['theta_1'], (0.5, [1.0])))
    assert simulation.time == pytest.approx(1.01)
    advance(node, 25)
    assert simulation.position[0] == pytest.approx(0.5, abs=1e-11)
    assert simulation.effort[0] == simulation.motion_forces['motion_theta_1'] != 0.0
    # By a stamp, which is of simulated time here: at 1.51 s with the rate that it has, on its way.
    node.on_motion_command(trajectory(
        ['theta_1'], (0.01, [1.2], [0.5]), (0.51, [1.5], [0.0]), stamp=1.5))
    advance(node, 25)
    assert (simulation.position[0], simulation.velocity[0]) == pytest.approx(
        (1.2, 0.5), abs=1e-11)
    advance(node, 60)
    assert (simulation.position[0], simulation.velocity[0]) == pytest.approx(
        (1.5, 0.0), abs=1e-11)
    assert node.motion.counts['motions followed'] == 2
    # Of an accuracy of 1e-6.
    assert abs(simulation.energy_balance.residual) < 1e-8
    node.reset()
    assert simulation.position[0] == pytest.approx(0.0, abs=1e-12)
    assert simulation.effects['motion_theta_1'].times is None


def test_joints_that_cannot_be_moved_are_refused_at_the_start(make_node):
    with pytest.raises(StartError, match='motion.theta_9'):
        make_node(SimulatorNode, scene='carpet_scraper', motion_joints=['theta_9'])


def test_another_node_moves_a_crank_and_its_recording_is_met(
        run, record, listener, tmp_path, capsys):
    recorder = record()
    counts = run(SimulatorNode, scene='carpet_scraper', motion_joints=['theta_1'],
                 wait_for_command=True).motion.counts
    recorder.wait_for('scene', 'joint_states', 'replay_log')
    states = listener.listen('joint_states', JointState)
    commands = listener.publisher('motion_command', JointTrajectory)
    listener.send(commands, trajectory(['theta_1'], (0.4, [1.0]), (0.8, [0.5])),
                  lambda: states and states[-1].position[0] > 0.1, 'crank that moves')
    listener.wait(lambda: abs(states[-1].position[0] - 0.5) < 1e-10
                  and abs(states[-1].velocity[0]) < 1e-10, 'crank at its goal')
    for message in BAD:
        commands.publish(message)
    # After the bad ones, from where it rests.
    commands.publish(trajectory(['theta_1'], (0.3, [0.8])))
    listener.wait(lambda: abs(states[-1].position[0] - 0.8) < 1e-10, 'crank at its last goal')
    assert max(state.position[0] for state in states) < 1.1
    assert any(state.effort[0] for state in states)
    recorder.end()
    assert counts['motions refused'] == len(BAD)
    assert main(['replay', str(tmp_path / 'bag'), '--tolerance', '1e-12']) == 0
    assert 'largest deviation of a position: 0 rad or m' in capsys.readouterr().out
