# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The action FollowJointTrajectory of the torque source, by processes that close the loop.

Where control_msgs is not installed, ``python test/ros/build_interfaces.py`` builds it.
"""

from types import SimpleNamespace

from builtin_interfaces.msg import Duration
import numpy as np
import pytest
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytest.importorskip(
    'control_msgs', reason='needs the package control_msgs, which test/ros/build_interfaces.py '
    'builds from its source')

from action_msgs.msg import GoalStatus  # noqa: E402,I100
from control_msgs.action import FollowJointTrajectory  # noqa: E402
from control_msgs.msg import JointTolerance  # noqa: E402

JOINTS = ['theta_1', 'theta_6', 'theta_7']
RESULT = FollowJointTrajectory.Result


@pytest.fixture
def robot(processes, listener):
    """Return what a client sees of a manipulator under computed torques, in lockstep."""
    processes.start(
        'closedloop_simulator', scene='three_rrr_horizontal', mode='lockstep').wait_until_ready()
    states = listener.listen('joint_states', JointState)
    processes.start(
        'closedloop_torque_source', mode='computed_torque', scene='three_rrr_horizontal',
        kp='[400.0]', kd='[40.0]').wait_until_ready()
    client = ActionClient(
        listener.node, FollowJointTrajectory, 'closedloop_torque_source/follow_joint_trajectory')
    listener.wait(client.server_is_ready, 'the action server')
    listener.wait(lambda: len(states) > 10, 'states under torques')
    feedback = []

    def positions():
        state = dict(zip(states[-1].name, states[-1].position))
        return np.array([state[joint] for joint in JOINTS])

    def send(move, seconds=1, joints=JOINTS, **tolerances):
        goal = FollowJointTrajectory.Goal(trajectory=JointTrajectory(
            joint_names=joints, points=[JointTrajectoryPoint(
                positions=(positions() + move).tolist(),
                time_from_start=Duration(sec=seconds))]), **tolerances)
        sent = client.send_goal_async(goal, feedback_callback=feedback.append)
        listener.wait(sent.done, 'an answer to the goal')
        return sent.result()

    def outcome(goal):
        got = goal.get_result_async()
        listener.wait(got.done, 'the result')
        return got.result().status, got.result().result

    yield SimpleNamespace(send=send, outcome=outcome, positions=positions, feedback=feedback,
                          listener=listener)
    client.destroy()


def tolerance(position):
    return [JointTolerance(name=joint, position=position) for joint in JOINTS]


def test_goal_is_followed_to_its_end(robot):
    begin = robot.positions()
    status, result = robot.outcome(robot.send([0.1, -0.1, 0.05], goal_tolerance=tolerance(0.01)))
    assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, RESULT.SUCCESSFUL)
    # As the tolerance of the goal has it.
    assert robot.positions() - begin == pytest.approx([0.1, -0.1, 0.05], abs=0.01)
    feedback = [each.feedback for each in robot.feedback]
    assert len(feedback) > 10 and list(feedback[0].joint_names) == JOINTS
    for each in feedback:
        np.testing.assert_allclose(
            np.subtract(each.desired.positions, each.actual.positions), each.error.positions,
            atol=1e-15)


def test_goal_that_cannot_be_kept_is_aborted_with_the_error(robot):
    status, result = robot.outcome(robot.send([0.4, 0.4, 0.4], goal_tolerance=tolerance(1e-12)))
    assert (status, result.error_code) == (
        GoalStatus.STATUS_ABORTED, RESULT.GOAL_TOLERANCE_VIOLATED)
    assert 'expected an error of position of at most 1e-12 rad or m, got' in result.error_string
    status, result = robot.outcome(robot.send([-0.4, 0.0, 0.4], path_tolerance=tolerance(1e-12)))
    assert result.error_code == RESULT.PATH_TOLERANCE_VIOLATED


def test_goal_is_cancelled_replaced_or_refused(robot):
    goal = robot.send([0.3, 0.3, 0.3], seconds=1000)
    cancelled = goal.cancel_goal_async()
    robot.listener.wait(cancelled.done, 'the cancelling')
    assert robot.outcome(goal)[0] == GoalStatus.STATUS_CANCELED
    first = robot.send([0.3, 0.3, 0.3], seconds=1000)
    second = robot.send([0.01, 0.0, 0.0])
    assert robot.outcome(first)[0] == GoalStatus.STATUS_ABORTED
    assert robot.outcome(second)[0] == GoalStatus.STATUS_SUCCEEDED
    assert not robot.send([0.0, 0.0, 0.0], joints=['theta_1', 'theta_6', 'nose']).accepted
