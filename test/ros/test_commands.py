# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of closedloop_dynamics.ros.commands."""

from array import array
import math

from closedloop_dynamics import load_scene
from closedloop_dynamics.ros.commands import CommandError, NOT_ACTUATED, poses_of, TorqueCommand
from geometry_msgs.msg import Transform
import pytest
from sensor_msgs.msg import MultiDOFJointState

JOINTS = ('a', 'b', 'c', 'd')
ACTUATED = ('a', 'c')


@pytest.fixture
def command():
    command = TorqueCommand(JOINTS, ACTUATED, timeout=0.5)
    command.accept_values([1.0, 2.0], now=0.0)
    return command


def counted(command):
    return command.counts['accepted'], command.counts['rejected']


def test_torque_is_zero_before_any_command():
    assert TorqueCommand(JOINTS, ACTUATED).torque.tolist() == [0.0, 0.0]


@pytest.mark.parametrize('values', [
    [3.0, -4.0], (3.0, -4.0), array('d', [3.0, -4.0]), array('f', [3.0, -4.0])])
def test_values_are_followed_in_the_order_of_the_actuated_joints(command, values):
    command.accept_values(values, now=1.0)
    assert command.torque.tolist() == [3.0, -4.0]
    assert counted(command) == (2, 0)


def test_named_efforts_leave_other_joints_alone(command):
    command.accept_named(['c'], array('d', [7.0]), now=1.0)
    assert command.torque.tolist() == [1.0, 7.0]
    command.accept_named(['c', 'a'], array('d', [8.0, 9.0]), now=1.0)
    assert command.torque.tolist() == [9.0, 8.0]
    assert counted(command) == (3, 0)


@pytest.mark.parametrize('values, problem', [
    ([], 'expected 2 values \\(a, c\\), got 0'),
    ([1.0], 'got 1'),
    ([1.0, 2.0, 3.0], 'got 3'),
    ([math.nan, 2.0], "'a' is nan"),
    ([5.0, math.inf], "'c' is inf"),
    ([5.0, -math.inf], "'c' is -inf"),
])
def test_bad_values_are_refused_and_change_nothing(command, values, problem):
    with pytest.raises(CommandError, match=problem):
        command.accept_values(values, now=1.0)
    assert command.torque.tolist() == [1.0, 2.0]
    assert counted(command) == (1, 1)


@pytest.mark.parametrize('names, efforts, problem', [
    ([], [], 'names no joint'),
    ([], [1.0], 'names no joint'),
    (['a'], [], 'one effort per name, got 0 for 1'),
    (['a', 'c'], [1.0], 'got 1 for 2'),
    (['a'], [1.0, 2.0], 'got 2 for 1'),
    (['x'], [1.0], "'x' is not a joint of this mechanism; the actuated joints are a, c"),
    (['b'], [1.0], "'b' is not actuated"),
    (['a', 'b', 'x'], [5.0, 1.0, 2.0], "'x' is not a joint"),
    (['a', 'b', 'b'], [5.0, 1.0, 2.0], 'named twice'),
    (['a', 'b', 'c'], [5.0], 'got 1 for 3'),
    (['a', 'a'], [5.0, 6.0], 'named twice'),
    (['a', 'c'], [math.nan, -math.inf], "'c' is -inf"),
    (['c', 'a'], [5.0, math.inf], "'a' is inf"),
])
def test_bad_named_efforts_are_refused_and_change_nothing(command, names, efforts, problem):
    with pytest.raises(CommandError, match=problem):
        command.accept_named(names, efforts, now=1.0)
    assert command.torque.tolist() == [1.0, 2.0]
    assert counted(command) == (1, 1)


def test_joints_that_no_controller_has_written_are_not_named(command):
    command.accept_named(['a', 'c'], [5.0, math.nan], now=0.4)
    assert command.torque.tolist() == [5.0, 2.0]
    # Nothing new, but the sender lives.
    command.accept_named(['a', 'c'], [math.nan, math.nan], now=0.8)
    assert command.torque.tolist() == [5.0, 2.0]
    assert counted(command) == (3, 0)
    assert not command.expire(now=1.2)


@pytest.mark.parametrize('efforts', [[5.0, math.nan, 6.0], [5.0, 6.0]])
def test_joints_that_are_not_actuated_are_ignored_and_counted(command, efforts):
    # Of all joints, or of the actuated ones alone.
    command.accept_named(['c', 'b', 'a'], efforts, now=1.0)
    assert command.torque.tolist() == [6.0, 5.0]
    assert (*counted(command), command.counts[NOT_ACTUATED]) == (2, 0, 1)


def test_torques_fall_to_zero_once_when_no_command_comes(command):
    assert not command.expire(now=0.5)
    assert command.torque.tolist() == [1.0, 2.0]
    assert command.expire(now=0.51)
    assert command.torque.tolist() == [0.0, 0.0]
    assert not command.expire(now=2.0)
    assert command.counts['timed out'] == 1
    command.accept_named(['c'], [4.0], now=3.0)
    assert command.torque.tolist() == [0.0, 4.0]
    assert command.expire(now=4.0)
    assert command.counts['timed out'] == 2


def test_refused_command_does_not_put_off_the_timeout(command):
    with pytest.raises(CommandError):
        command.accept_values([1.0], now=0.4)
    assert command.expire(now=0.6)


def test_command_that_acted_for_too_long_is_over(command):
    command.held = 0.6
    assert command.expire(now=0.0)
    command.accept_values([1.0, 2.0], now=0.1)
    assert not command.expire(now=0.2)


def test_no_timeout_holds_for_ever(command):
    command.timeout = 0.0
    assert not command.expire(now=1e9)
    assert command.torque.tolist() == [1.0, 2.0]


def test_orientations_of_cut_joints_follow_from_the_others():
    mechanism = load_scene('stewart_platform').mechanism
    known, cut = mechanism.coordinates, mechanism.cut_coordinates.with_orientation
    joint, = known.with_orientation
    turned = Transform()
    turned.rotation.x, turned.rotation.w = 0.6, 0.8
    message = MultiDOFJointState(joint_names=[joint, *cut], transforms=[
        turned, *(Transform() for _ in cut)])
    position, velocity, held = poses_of(message, known, known.start(), cut)
    assert position[known.coordinates[joint]].tolist() == [0.6, 0.0, 0.0, 0.8]
    assert len(cut) == 5 and held == (joint,) and not velocity.any()
    with pytest.raises(CommandError, match='names no joint but cut ones'):
        poses_of(MultiDOFJointState(joint_names=list(cut), transforms=message.transforms[1:]),
                 known, known.start(), cut)
    with pytest.raises(CommandError, match='is not a joint'):
        poses_of(message, known, known.start())
