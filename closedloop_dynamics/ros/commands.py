# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Torque commands and states from outside: counted if lost on the way, checked on arrival."""

import inspect
import math

from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.recording.message_numbers import pose_numbers, twist_numbers
import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile

# QoS of services and clients. The answers of a service share one topic: with rclpy's ten, those
# to calls that are not read in time are lost, whichever node called.
SERVICE_QOS = QoSProfile(depth=1000)
NOT_ACTUATED = 'efforts of joints not actuated'


class CommandError(ValueError):
    """A command that is refused; the message gives the reason."""


class TorqueCommand:
    """
    The torques in force, and the counts of the commands that set them.

    A command that is refused changes nothing: the last good one stays. Times are those of a steady
    clock [s]. Torques are in the order of ``actuated_joints``; they fall to zero when no command
    came, or the last one acted, for a ``timeout``; 0: the last one holds for ever.
    ``require_admissible`` raises SimulationError where torques are far too large.

    ``torque``: in force now [N m, or N for prismatic joints]; ``counts``: commands accepted,
    rejected, timed out (how often the torques fell to zero) and lost on the way, counted by the
    receiver; efforts of joints that are not actuated, ignored; ``expired``: whether the torques
    are zero because no command came in time; ``held``: how long the simulation has advanced under
    the last command [s of the clock that time follows], counted by the mode that advances it.
    """

    def __init__(self, joint_names, actuated_joints, timeout=0.0, require_admissible=None):
        self.actuated_joints, self.timeout = tuple(actuated_joints), timeout
        self._require_admissible = require_admissible
        self.torque = np.zeros(len(self.actuated_joints))
        self.counts = dict.fromkeys(('accepted', 'rejected', 'timed out', 'lost', NOT_ACTUATED), 0)
        self.expired, self.held = False, 0.0
        self._joint_names = frozenset(joint_names)
        self._index = {name: i for i, name in enumerate(self.actuated_joints)}
        self._last_arrival = None

    def accept_values(self, values, now):
        """Follow one value per actuated joint that arrived now; raise CommandError if refused."""
        if len(values) != len(self.actuated_joints):
            raise self._refusal(
                f'expected {len(self.actuated_joints)} values '
                f'({", ".join(self.actuated_joints)}), got {len(values)}')
        self._require_finite(self.actuated_joints, values)
        self._accept(np.array(values, dtype=float), now)

    def accept_named(self, names, efforts, now):
        """
        Follow efforts by joint name that arrived now; joints not named keep their value.

        So do those whose effort is NaN, as the hardware interfaces of ros2_control send it for
        joints that no controller has written; a command of nothing else is a sign of life.
        Joints that are not actuated are ignored, and counted: those interfaces name all joints of
        their tag. Efforts are as many as names, or as there are actuated joints among them.
        Raises CommandError if the command is refused.
        """
        if not names:
            raise self._refusal('it names no joint')
        self._require_known(names)
        actuated = [name for name in names if name in self._index]
        if len(efforts) == len(names):
            efforts = [effort for name, effort in zip(names, efforts) if name in self._index]
        if not actuated:
            raise self._refusal(f"'{names[0]}' is not actuated; {self._choice()}")
        if len(efforts) != len(actuated):
            raise self._refusal(
                f'expected one effort per name, got {len(efforts)} for {len(names)} names '
                f'(positions and velocities are not followed)')
        given = {name: effort for name, effort in zip(actuated, efforts)
                 if not math.isnan(effort)}
        self._require_finite(given, given.values())
        self.counts[NOT_ACTUATED] += len(names) - len(actuated)
        torque = self.torque.copy()
        torque[[self._index[name] for name in given]] = list(given.values())
        self._accept(torque, now)

    def expire(self, now):
        """
        Set the torques to zero if no command came, or the last one acted, for too long.

        Returns True once, when they fall.
        """
        if self.timeout <= 0.0 or self._last_arrival is None:
            return False
        if max(now - self._last_arrival, self.held) <= self.timeout:
            return False
        self._last_arrival = None
        self.torque[:] = 0.0
        self.counts['timed out'] += 1
        self.expired = True
        return True

    def forget(self):
        """Set the torques to zero until the next command; the counts stay."""
        self.expired = False
        self._last_arrival = None
        self.torque[:] = 0.0

    def _accept(self, torque, now):
        if self._require_admissible is not None:
            try:
                self._require_admissible(torque)
            except SimulationError as error:
                raise self._refusal(error) from None
        self.torque[:] = torque
        self.counts['accepted'] += 1
        self.expired, self.held = False, 0.0
        self._last_arrival = now

    def _refusal(self, reason):
        self.counts['rejected'] += 1
        return CommandError(reason)

    def _require_finite(self, names, values):
        for name, value in zip(names, values):
            if not math.isfinite(value):
                raise self._refusal(f"the value of '{name}' is {value}, not a finite number")

    def _require_known(self, names):
        for name in names:
            if name not in self._joint_names:
                raise self._refusal(
                    f"'{name}' is not a joint of this mechanism; {self._choice()}")
        if len(set(names)) != len(names):
            raise self._refusal(f'a joint is named twice in {", ".join(names)}')

    def _choice(self):
        return f'the actuated joints are {", ".join(self.actuated_joints)}'


def state_of(message, coordinates, position, measured=()):
    """
    Return the positions, velocities and held joints of a JointState.

    ``coordinates`` are those of the mechanism; joints that the message does not name begin at
    ``position``, shape (nq,) [rad or m], and follow those it names, which are held. None is held
    where all are named. The cut joints in ``measured`` may be named, too, as joint_states has
    them: they follow from the others. Raises CommandError if the message makes no sense.
    """
    joints = [coordinates.names[place] for place in coordinates.single]
    names = _known_joints(message.name, [*joints, *measured])
    _require_one_each(names, 'position', message.position, 'velocity', message.velocity)
    wanted = {'position': np.array(position), 'velocity': np.zeros(coordinates.nv)}
    for key, values in wanted.items():
        for name, value in zip(names, getattr(message, key)):
            if not math.isfinite(value):
                raise CommandError(f"the {key} of '{name}' is {value}, not a finite number")
            if name in measured:
                continue
            place = coordinates.index[name]
            values[coordinates.place[place] if key == 'position' else place] = value
    return *wanted.values(), _held(names, measured, joints, coordinates.nv)


def _held(names, measured, joints, count):
    """Return the joints that are held: those that are named; none where all are."""
    held = tuple(name for name in names if name not in measured)
    if not held:
        raise CommandError('it names no joint but cut ones, which follow from the others; the '
                           f'joints are {", ".join(joints)}')
    return held if len(held) < count else ()


def poses_of(message, coordinates, position, measured=()):
    """
    Return the positions, velocities and held joints of a MultiDOFJointState.

    Of spherical joints the translation must be zero; otherwise as ``state_of``.
    """
    names = _known_joints(message.joint_names, [*coordinates.with_orientation, *measured])
    _require_one_each(names, 'transform', message.transforms, 'twist', message.twist)
    wanted = np.array(position), np.zeros(coordinates.nv)
    given = map(pose_numbers, message.transforms), map(twist_numbers, message.twist)
    for values, places, parts in zip(wanted, (coordinates.pose, coordinates.twist), given):
        for name, part in zip(names, parts):
            if name in measured:
                continue
            numbers = np.array(part)
            where = places[coordinates.with_orientation.index(name)]
            if not np.isfinite(numbers).all():
                raise CommandError(f"the state of '{name}' has a number that is not finite")
            if numbers[where < 0].any():
                raise CommandError(f"'{name}' is a spherical joint, which turns only, got "
                                   f'{list(part[:3])} along its axes')
            values[where[where >= 0]] = numbers[where >= 0]
    return *wanted, _held(names, measured, coordinates.with_orientation, len(coordinates.rates))


def _require_one_each(names, what, values, optional, others):
    """Refuse other than one value a name; optional values may be missing."""
    if len(values) != len(names):
        raise CommandError(f'expected one {what} per name, got {len(values)} for {len(names)} '
                           'names')
    if len(others) not in (0, len(names)):
        raise CommandError(f'expected no {optional}, or one per name, got {len(others)} for '
                           f'{len(names)} names')


def _known_joints(names, joints):
    """Return names that are those of joints, each once; raise CommandError otherwise."""
    names = list(names)
    unknown = [name for name in names if name not in joints]
    if unknown or not names:
        raise CommandError((f"'{unknown[0]}' is not a joint" if unknown else 'it names no joint')
                           + f'; the joints are {", ".join(joints)}')
    if len(set(names)) != len(names):
        raise CommandError(f'a joint is named twice in {", ".join(names)}')
    return names


class SequenceGaps:
    """Counts the messages of a topic that were sent and did not arrive, by their numbers."""

    def __init__(self):
        # Latest number of each publisher, oldest first: messages do not name their sender.
        self._latest = []

    def forget(self):
        """Restart: publishers have come or gone."""
        self._latest.clear()

    def missing(self, number, publishers):
        """
        Return how many messages are missing before one of a number.

        Numbers are consecutive for each publisher; ``publishers()`` returns how many there are,
        and is called where it matters.
        """
        latest = self._latest
        if number - 1 in latest:
            latest.remove(number - 1)
            latest.append(number)
            return 0
        # A publisher that was not heard before, or one of those whose number is lower.
        before = max((one for one in latest if one < number), default=None)
        if before is None or len(latest) < publishers():
            latest.append(number)
            return 0
        latest.remove(before)
        latest.append(number)
        return number - before - 1


def subscribe(node, kind, topic, callback, qos, on_lost):
    """
    Subscribe to a topic, and count messages that were lost on the way.

    ``on_lost`` takes the number of messages that were lost before the present one, before
    ``callback`` takes that. It is never called where the middleware does not number messages.
    """
    gaps = SequenceGaps()

    def received(*arguments):
        # rclpy's events executor hands over message and information as one.
        message, info = arguments if len(arguments) == 2 else arguments[0]
        number = info['publication_sequence_number']
        missing = gaps.missing(number, subscription.get_publisher_count) if number else 0
        if missing:
            on_lost(missing)
        callback(message)

    # rclpy checks this to find out whether the information is wanted.
    received.__signature__ = inspect.signature(lambda message, info: None)
    subscription = node.create_subscription(
        kind, topic, received, qos,
        event_callbacks=SubscriptionEventCallbacks(matched=lambda change: gaps.forget()))
    return subscription
