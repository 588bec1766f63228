# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""ros2_control.launch.py by launch_testing: a trajectory of a mechanism within ros2_control."""

from tempfile import mkdtemp
from test.launch.launched import described
import unittest

from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
import pytest
import rclpy
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = ['theta_1', 'theta_6', 'theta_7']
GOAL = [1.25, 4.25, 5.95]
PATIENCE = 240.0


@pytest.mark.launch_test
def generate_test_description():
    """Return a manipulator as hardware, whose simulation leads the time."""
    return described('ros2_control', real_time_factor='1.0', folder=mkdtemp())


class TestRunning(unittest.TestCase):
    """While the controllers run."""

    def setUp(self):
        rclpy.init()
        self.node = rclpy.create_node('client')

    def tearDown(self):
        self.node.destroy_node()
        rclpy.shutdown()

    def test_joints_reach_the_goal(self):
        states = []
        self.node.create_subscription(JointState, 'joint_states', states.append, 10)
        client = ActionClient(self.node, FollowJointTrajectory,
                              'joint_trajectory_controller/follow_joint_trajectory')
        self.assertTrue(client.wait_for_server(PATIENCE))
        sent = client.send_goal_async(FollowJointTrajectory.Goal(trajectory=JointTrajectory(
            joint_names=JOINTS, points=[JointTrajectoryPoint(
                positions=GOAL, time_from_start=Duration(sec=1))])))
        rclpy.spin_until_future_complete(self.node, sent, timeout_sec=PATIENCE)
        result = sent.result().get_result_async()
        rclpy.spin_until_future_complete(self.node, result, timeout_sec=PATIENCE)
        self.assertEqual(result.result().result.error_code, 0)
        states.clear()
        while not states:
            rclpy.spin_once(self.node, timeout_sec=1.0)
        found = dict(zip(states[0].name, states[0].position))
        for joint, position in zip(JOINTS, GOAL):
            # A servo without gains: what is left decays within its bandwidth.
            self.assertAlmostEqual(found[joint], position, delta=1e-3)
