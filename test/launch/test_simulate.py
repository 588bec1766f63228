# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""simulate.launch.py by launch_testing: the nodes run, publish, and end in order."""

from test.launch.launched import described
import unittest

from geometry_msgs.msg import WrenchStamped
from launch_testing import post_shutdown_test
from launch_testing.asserts import assertExitCodes
from launch_testing_ros import WaitForTopics
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

PATIENCE = 240.0


@pytest.mark.launch_test
def generate_test_description():
    """Return a driven machine in a namespace."""
    return described('simulate', drive='three_rrr_circle', namespace='cell')


class TestRunning(unittest.TestCase):
    """While the nodes run."""

    def test_states_forces_and_commands_are_published(self):
        topics = [('/cell/joint_states', JointState), ('/cell/torque_command', Float64MultiArray),
                  ('/cell/constraint_forces/cut_1', WrenchStamped)]
        with WaitForTopics(topics, timeout=PATIENCE):
            pass


@post_shutdown_test()
class TestEnded(unittest.TestCase):
    """After they were asked to end."""

    def test_all_ended_in_order(self, proc_info):
        assertExitCodes(proc_info)
        self.assertEqual(len(proc_info.process_names()), 2)
