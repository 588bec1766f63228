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

"""What a bag of the simulator's topics holds, as numbers."""

from dataclasses import dataclass

from closedloop_dynamics.studies.motion import Motion
import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

NANOSECONDS = 1e-9
# A first command this long after the motion began is not the first [ns].
LATE = 50 * 10 ** 6


@dataclass(frozen=True)
class Recording:
    """
    The messages of one simulator.

    Attributes
    ----------
    motion : studies.motion.Motion
        From the state that the first command answered, with times of the stamps since then.
    arrivals : dict
        Times at which the messages of each topic were received [s], relative as above; those
        before the motion are negative.

    """

    motion: Motion
    arrivals: dict

    @property
    def count(self):
        """Return the number of messages."""
        return sum(map(len, self.arrivals.values()))

    def rate(self, topic):
        """Return the average number of messages per second [Hz]; NaN for fewer than two."""
        times = self.arrivals[topic]
        return (len(times) - 1) / np.ptp(times) if len(times) > 1 else np.nan


def read_recording(path, namespace, mechanism):
    """
    Read a bag.

    Parameters
    ----------
    path : pathlib.Path
        Its directory.
    namespace : str
        Of the simulator.
    mechanism : mechanism.mechanism.Mechanism
        Which it simulated.

    Returns
    -------
    Recording

    Raises
    ------
    ValueError
        Where no states are in it.

    """
    messages = _messages(path, namespace)
    states = messages.get('joint_states', [])
    if not states:
        raise ValueError(f'the bag {path} holds no joint_states')
    stamps = np.array([_stamp(message) for _, message in states])
    position = np.array([message.position for _, message in states])
    origin = _begin(messages, stamps, position)
    forces = np.full((len(states), len(mechanism.cut_joints), 3), np.nan)
    row = {stamp: index for index, stamp in enumerate(stamps.tolist())}
    for k, cut in enumerate(mechanism.cut_joints):
        for _, message in messages.get(f'constraint_forces/{cut.name}', []):
            wrench, index = message.wrench, row.get(_stamp(message))
            if index is not None:
                forces[index, k] = wrench.torque.z, wrench.force.x, wrench.force.y
    moving = stamps >= origin
    motion = Motion(
        mechanism, (stamps[moving] - origin) * NANOSECONDS,
        *(np.array([getattr(message, field) for _, message in states])[moving]
          for field in ('position', 'velocity', 'effort')), forces[moving])
    arrivals = {topic: (np.array([time for time, _ in entries]) - origin) * NANOSECONDS
                for topic, entries in messages.items()}
    return Recording(motion, arrivals)


def _messages(path, namespace):
    """Return (time of reception, message) of every message, by relative topic."""
    store = get_typestore(Stores.ROS2_JAZZY)
    messages = {}
    with Reader(path) as reader:
        for connection, nanoseconds, data in reader.messages():
            topic = connection.topic.removeprefix(f'{namespace}/')
            messages.setdefault(topic, []).append(
                (nanoseconds, store.deserialize_cdr(data, connection.msgtype)))
    return messages


def _stamp(message):
    stamp = message.header.stamp
    return stamp.sec * 10 ** 9 + stamp.nanosec


def _begin(messages, stamps, position):
    """Return the stamp of the state that the motion begins from."""
    commands = messages.get('torque_command') or messages.get('joint_command')
    if not commands:
        return stamps[0]
    answered = max(0, np.searchsorted(stamps, commands[0][0]) - 1)
    last_at_rest = max(0, np.argmax(np.any(position != position[0], axis=1)) - 1)
    # The recorder may find the torque source late, and miss the first commands.
    missed = stamps[answered] - stamps[last_at_rest] > LATE
    return stamps[last_at_rest if missed else answered]
