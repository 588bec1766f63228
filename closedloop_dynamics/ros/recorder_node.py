# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The node ``closedloop_recorder``: topics into a rosbag2 bag, where ``ros2 bag`` is not."""

from collections import Counter
from datetime import datetime
from fnmatch import fnmatchcase
import time

from closedloop_dynamics.recording.writer import COMPRESSIONS
from closedloop_dynamics.ros.bag import (
    BagError, BagWriter, CACHE_SIZE, MessageTypes, UnknownTypeError)
from closedloop_dynamics.ros.node import ProgramNode
from closedloop_dynamics.ros.parameters import Parameter
from closedloop_dynamics.ros.process import StartError
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

# Messages of a topic that may wait while this process is held up.
QUEUE_DEPTH = 10000
# Period of the search for topics [s].
DISCOVERY_PERIOD = 0.1
# Between warnings that messages are dropped [s].
WARNING_PERIOD = 10.0
MEGABYTE = 1e6
# For taking in messages that had arrived when the recording was ended [s].
LAST_CALL = 0.5

# Published where joints are spherical or free, and with couplings or prescribed motions: that they
# are missing is not a fault.
RARE = ('multi_dof_joint_states', 'coupling_forces', 'tooth_forces', 'motion_forces',
        'motion_command')

RECORDER_PARAMETERS = (
    Parameter(
        'topics', ['joint_states', 'constraint_forces/*', 'torque_command', 'joint_command',
                   'scene', 'robot_description', 'replay_log', *RARE],
        'Topics to record, relative to the namespace or full names; * and ? stand for any '
        'characters.'),
    Parameter(
        'output', '',
        'Directory of the bag; must not exist. Not given: rosbag2_ and the time, here.'),
    Parameter('storage', 'mcap', 'Format of the bag: mcap or sqlite3.',
              choices=tuple(COMPRESSIONS)),
    Parameter('compression', 'none',
              'Compression: none; zstd; lz4, of mcap only.', choices=COMPRESSIONS['mcap']),
    Parameter('max_size', 0.0, 'A file of the bag that has become larger is followed by another '
              'one [MB]; 0: never.', (0.0, 1e6)),
    Parameter('max_cache_size', CACHE_SIZE / MEGABYTE, 'Memory for messages that wait for the '
              'disk; further ones are dropped, counted and reported [MB].', (0.1, 1e6)),
    Parameter('max_duration', 0.0, 'End the recording after so long [s]; 0: when stopped.',
              (0.0, 1e6)),
)


class RecorderNode(ProgramNode):
    """
    Record every message of the chosen topics, as it came over the wire.

    ``exit_code``: None while the node wants to go on; ``bag``: what is written to; ``received``,
    ``lost``: messages by full topic name; lost: what DDS says could not be delivered.
    """

    NAME, PARAMETERS = 'closedloop_recorder', RECORDER_PARAMETERS

    def __init__(self, **options):
        super().__init__(**options)
        self.received = Counter()
        self.lost = Counter()
        self._patterns = {
            pattern: self._full_pattern(pattern) for pattern in self.values['topics']}
        self._types = MessageTypes()
        self._type_of = {}
        self._subscriptions_by_topic = {}
        self._complained = set()
        self.bag = self._open()
        self._begin = time.monotonic()
        self.every(DISCOVERY_PERIOD, self.poll_topics)
        self.get_logger().info(f"recording {', '.join(self._patterns)} into '{self.bag.path}'")

    def _open(self):
        values = self.values
        storage, compression = values['storage'], values['compression']
        if compression not in COMPRESSIONS[storage]:
            raise StartError(
                f"parameter 'compression': expected one of {', '.join(COMPRESSIONS[storage])} "
                f"with storage {storage}, got '{compression}'")
        try:
            return BagWriter(
                values['output'] or datetime.now().strftime('rosbag2_%Y_%m_%d-%H_%M_%S'),
                storage, self._types.typestore, compression, values['max_size'] * MEGABYTE,
                values['max_cache_size'] * MEGABYTE)
        except BagError as error:
            raise StartError(f'{error}') from None

    def poll_topics(self):
        """Subscribe to topics that have appeared; end when it is time to."""
        for topic, type_names in self.get_topic_names_and_types():
            if any(fnmatchcase(topic, full) for full in self._patterns.values()):
                self._listen_to(topic, type_names)
        if self.bag.dropped:
            self.get_logger().warning(
                'messages come faster than the disk takes them: '
                f'{self.bag.dropped} dropped so far', throttle_duration_sec=WARNING_PERIOD)
        duration = self.values['max_duration']
        if self.bag.error is not None:
            self.exit_code = 1
        elif duration and time.monotonic() - self._begin >= duration:
            self.exit_code = 0

    def close(self):
        """Record the messages that have arrived, close the bag and log its contents."""
        self._drain()
        self.bag.close()
        logger = self.get_logger()
        for topic in sorted(self._subscriptions_by_topic):
            received, written = self.received[topic], self.bag.written[topic]
            dropped = f', {received - written} dropped' if received > written else ''
            lost = f', {self.lost[topic]} lost on the way' if self.lost[topic] else ''
            logger.info(f'{topic}: {received} received, {written} written{dropped}{lost}')
        for pattern, full in self._patterns.items():
            if pattern not in RARE and not any(
                    fnmatchcase(topic, full) for topic in self._subscriptions_by_topic):
                logger.warning(f"topic '{pattern}' never appeared")
        if self.bag.error is not None:
            self.exit_code = 1
            logger.error(f'{self.bag.error}')
        else:
            logger.info(f"{sum(self.bag.written.values())} messages in '{self.bag.path}'")

    def _listen_to(self, topic, type_names):
        """Subscribe to a topic, again if a publisher offers another quality of service."""
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        subscription = self._subscriptions_by_topic.get(topic)
        if subscription is None:
            message_class = self._message_class(topic, type_names)
            if message_class is not None:
                self._subscribe(topic, message_class, _matching_profile(offered))
        elif offered:
            # Once messages came, the profile is only loosened: each new
            # subscription costs some messages, and gets latched ones again.
            profile = _matching_profile(
                offered + [subscription.qos_profile] * bool(self.received[topic]))
            if profile != subscription.qos_profile:
                self.destroy_subscription(subscription)
                self._subscribe(topic, subscription.msg_type, profile)

    def _message_class(self, topic, type_names):
        try:
            if len(type_names) > 1:
                raise UnknownTypeError(f'it has several types, {", ".join(type_names)}')
            self._type_of[topic], = type_names
            return self._types.message_class(type_names[0])
        except UnknownTypeError as error:
            if topic not in self._complained:
                self._complained.add(topic)
                self.get_logger().error(f'{topic} is not recorded: {error}')
            return None

    def _subscribe(self, topic, message_class, profile):
        # Without the message's info, where the middleware gives its arrival: the events executor
        # of some builds fails with it. It runs this at once.
        def on_message(data):
            self._record(topic, data, time.time_ns())

        def on_loss(event):
            self.lost[topic] += event.total_count_change

        self._subscriptions_by_topic[topic] = self.create_subscription(
            message_class, topic, on_message, profile, raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=on_loss))

    def _record(self, topic, data, nanoseconds):
        if not self.received[topic]:
            self.get_logger().info(f'{topic}: first message, {self._type_of[topic]}')
            self.bag.add_topic(topic, self._type_of[topic], [
                publisher.qos_profile
                for publisher in self.get_publishers_info_by_topic(topic)])
        self.received[topic] += 1
        self.bag.write(topic, nanoseconds, data)

    def _drain(self):
        """Run callbacks until nothing more has arrived, at most for ``LAST_CALL``."""
        deadline = time.monotonic() + LAST_CALL
        idle = 0
        while self.executor is not None and idle < 3 and time.monotonic() < deadline:
            before = self.received.total()
            self.executor.spin_once(timeout_sec=0.001)
            idle = 0 if self.received.total() > before else idle + 1

    def _full_pattern(self, pattern):
        """Return the full name of a topic, or of a pattern in the node's namespace."""
        if pattern.startswith('/'):
            return pattern
        if any(character in pattern for character in '*?['):
            return f"{self.get_namespace().rstrip('/')}/{pattern}"
        try:
            return self.resolve_topic_name(pattern)
        except Exception:
            raise StartError(
                f"parameter 'topics': '{pattern}' is not the name of a topic") from None


def _matching_profile(offered):
    """Return the strictest profile compatible with every one of those offered."""
    best_effort = any(
        each.reliability == ReliabilityPolicy.BEST_EFFORT for each in offered)
    latched = offered and all(
        each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return QoSProfile(
        depth=QUEUE_DEPTH,
        reliability=(
            ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE))


main = RecorderNode.main
