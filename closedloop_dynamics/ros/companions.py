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

"""
What a simulator publishes beside its state: descriptions, a log for replays, markers.

The node makes one ``Companions``, which hooks itself in. What nobody subscribes to costs next
to nothing.

"""

from closedloop_dynamics.ros.markers import MARKER_PARAMETERS, Markers
from closedloop_dynamics.ros.parameters import declare
from closedloop_dynamics.ros.replay_log import ReplayLog
from closedloop_dynamics.simulation.scene_text import scene_text
from closedloop_dynamics.visual.urdf import urdf
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
COMPANION_PARAMETERS = MARKER_PARAMETERS


class Companions:
    """
    Everything that goes along with the states of a simulator node.

    Parameters
    ----------
    node : simulator_node.SimulatorNode
        Offers ``simulation`` and ``torque``, and calls what is put into its lists.

    """

    def __init__(self, node):
        self._node = node
        values = declare(node, COMPANION_PARAMETERS)
        self._description = node.create_publisher(String, 'robot_description', LATCHED_QOS)
        self._scene = node.create_publisher(String, 'scene', LATCHED_QOS)
        self._log = ReplayLog(node)
        self._markers = Markers(node, values)
        self._simulation = self._told = None
        self._look()
        node.on_published.append(self.follow)
        node.on_advance.append(self.advancing)
        node.on_jump.append(self._log.jumped)

    def follow(self, stamp):
        """
        Go along with a state that was just published.

        Parameters
        ----------
        stamp : builtin_interfaces.msg.Time
            Of the state.

        """
        self._look()
        self._log.follow(stamp, self._simulation)
        self._markers.follow(stamp, self._simulation)

    def advancing(self):
        """Note that the simulation is about to advance under the node's ``torque``."""
        self._log.advancing(self._simulation, self._node.torque)

    def _look(self):
        """Tell the descriptions when they are new: at the start, and after changes."""
        simulation = self._node.simulation
        if simulation is not self._simulation:
            self._simulation = simulation
            self._tell_robot(simulation)
        told = simulation.scene, simulation.effects, simulation.enabled_effects
        # Records that were not replaced are found equal without being compared. What changed did
        # so after the last state that was published.
        if told != self._told:
            scene, effects, enabled = self._told = told
            disabled = [name for name in effects if name not in enabled]
            self._scene.publish(String(data=scene_text(
                scene, effects, disabled, after=self._log.index)))

    def _tell_robot(self, simulation):
        try:
            self._description.publish(String(data=urdf(
                simulation.mechanism, *map(self._node.resolve_topic_name, (
                    'joint_command', 'joint_states')))))
        except ValueError as error:
            self._node.get_logger().warning(f'no robot_description: {error}')
