# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Publishers beside the state: descriptions and a log for replays."""

from array import array

from closedloop_dynamics.effects.end_stop import stops_of
from closedloop_dynamics.ros.messages import LATCHED_QOS
from closedloop_dynamics.scene.text import scene_text
from closedloop_dynamics.visual.urdf import urdf
import numpy as np
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String

LOG_QOS = QoSProfile(depth=1000)
# Names of the columns, before the commands by joint and the state.
COLUMNS = ('stamp_sec', 'stamp_nanosec', 'index', 'jumps', 'simulated_time')
# In place of the stamp, in an entry for a time at which no state was published.
NO_STATE = -1


class Descriptions:
    """
    Latched topics: ``robot_description`` once, ``scene`` whenever it changes.

    ``node`` publishes; a scene holds from an entry of ``log`` on, whose first columns it names.
    """

    def __init__(self, node, simulation, log):
        self._simulation, self._log, self._published = simulation, log, None
        self._robot = node.create_publisher(String, 'robot_description', LATCHED_QOS)
        self._scene = node.create_publisher(String, 'scene', LATCHED_QOS)
        try:
            self._robot.publish(String(data=urdf(
                simulation.mechanism, *map(node.resolve_topic_name, (
                    'joint_command', 'joint_states')), limits=stops_of(simulation.effects))))
        except ValueError as error:
            node.get_logger().warning(f'no robot_description: {error}')
        self.on_state()

    def on_state(self, stamp=None):
        """Publish the scene if it has changed since the state before."""
        simulation = self._simulation
        present = simulation.scene, simulation.effects, simulation.data.enabled_effects
        # Records that were not replaced are found equal without being compared. What changed did
        # so after the last state that was published.
        if present != self._published:
            scene, effects, enabled = self._published = present
            off = [name for name in effects if name not in enabled]
            self._scene.publish(String(data=scene_text(
                scene, effects, off, after=self._log.index, columns=self._log.columns)))


class ReplayLog:
    """
    Publishes one entry for each state, while there are subscribers.

    The stamps of states may follow the system's clock, and the efforts in them are those behind
    drives with limits and lag. What a replay needs is the simulated time, the command
    before the drives, and the whole state (``Simulation.state``), to begin there to the last bit.
    Where the command, or the accuracy that a budget allows, changes between two published states,
    an entry without a stamp says up to when the old one acted. ``index`` counts the entries, so
    that a gap is seen; ``jumps`` counts the resets and the states that were set from outside.
    ``columns``: names of the first numbers of each entry, published once, in ``scene``; the
    others are the state.
    """

    def __init__(self, node, simulation):
        self._simulation = simulation
        self._publisher = node.create_publisher(Float64MultiArray, 'replay_log', LOG_QOS)
        self._message = Float64MultiArray()
        self._values = self._states = self._torque = None
        self.columns = [*COLUMNS, *simulation.torque_names]
        self.index = self._jumps = 0
        self._time, self._accuracy = 0.0, simulation.accuracy

    def jumped(self):
        """Mark the next state as set, not simulated from the last."""
        self._jumps += 1

    def advancing(self, torque):
        """Store the command of the next steps, by ``torque_names`` [N m or N]."""
        if self._torque is None:
            self._torque = torque.copy()
        accuracy = self._simulation.accuracy
        changed = accuracy != self._accuracy and self._simulation.scene.method.by_budget
        if changed or not np.array_equal(torque, self._torque):
            if changed or self._simulation.time > self._time:
                self.write_row(NO_STATE, NO_STATE)
            self._torque[:] = torque
        self._accuracy = accuracy

    def on_state(self, stamp):
        """Publish the entry of the present state."""
        self.write_row(stamp.sec, stamp.nanosec)

    def write_row(self, second, nanosecond):
        time = self._simulation.time
        if time < self._time:
            self._jumps += 1
        self._time = time
        self.index += 1
        if not self._publisher.get_subscription_count():
            return
        state = self._simulation.state
        self._size(len(state))
        self._values[:len(COLUMNS)] = second, nanosecond, self.index, self._jumps, time
        if self._torque is not None:
            self._values[len(COLUMNS):-len(state)] = self._torque
        self._values[-len(state):] = state
        self._publisher.publish(self._message)

    def _size(self, states):
        """Size the message for another method or other effects."""
        if states != self._states:
            self._states = states
            self._message.data = array('d', bytes(8 * (len(self.columns) + states)))
            self._values = np.frombuffer(self._message.data)
