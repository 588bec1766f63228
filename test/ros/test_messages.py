# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Tests of closedloop_dynamics.ros.messages."""

from closedloop_dynamics.ros.messages import StateMessages
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState


def test_filled_messages_carry_the_state_and_one_stamp():
    messages = StateMessages(('a', 'b'), ('cut_1', 'cut_2'))
    messages.fill(
        12_345_678_901, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0]),
        np.array([[0.5, 10.0, 20.0], [0.0, 30.0, 40.0]]))
    state = deserialize_message(serialize_message(messages.joint_state), JointState)
    assert state.name == ['a', 'b']
    assert state.position.tolist() == [1.0, 2.0]
    assert state.velocity.tolist() == [3.0, 4.0]
    assert state.effort.tolist() == [5.0, 6.0]
    wrenches = [deserialize_message(serialize_message(each), WrenchStamped)
                for each in messages.wrenches]
    for each in (state, *wrenches):
        assert (each.header.stamp.sec, each.header.stamp.nanosec) == (12, 345_678_901)
    assert [each.header.frame_id for each in wrenches] == ['world', 'world']
    first, second = (each.wrench for each in wrenches)
    assert (first.torque.z, first.force.x, first.force.y) == (0.5, 10.0, 20.0)
    assert (second.torque.z, second.force.x, second.force.y) == (0.0, 30.0, 40.0)
    for each in (first, second):
        assert (each.force.z, each.torque.x, each.torque.y) == (0.0, 0.0, 0.0)


def test_refilling_allocates_no_new_arrays():
    messages = StateMessages(('a',), ('cut_1',))
    arrays = [messages.joint_state.position, messages.joint_state.effort]
    for value in (1.0, 2.0):
        messages.fill(0, [value], [value], [value], np.zeros((1, 3)))
        assert messages.joint_state.position is arrays[0]
        assert messages.joint_state.effort is arrays[1]
        assert messages.joint_state.position[0] == value
