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

"""Torque commands: checked on arrival, kept until the next one or a timeout."""

import math

import numpy as np


class CommandError(ValueError):
    """A command that is not followed; the message says what is wrong with it."""


class TorqueCommand:
    """
    The torques in force, and the book of the commands that set them.

    A command that is refused changes nothing: the last good one stays.

    Parameters
    ----------
    joint_names : sequence of str
        All joints of the mechanism.
    actuated_joints : sequence of str
        Those that a command drives; their order is the order of ``torque``.

    Attributes
    ----------
    torque : ndarray, shape (number of actuated joints,)
        In force now [N m, or N for prismatic joints].
    accepted, rejected, timed_out : int
        Commands followed, commands refused, and how often the torques fell to
        zero because no command came in time.
    lost : int
        Commands that were sent and never arrived; counted by who receives them.
    not_actuated : int
        Efforts that were ignored because their joints are not actuated.
    expired : bool
        Whether they are zero because of that.
    held : float
        How long the simulation has advanced under the last command [s of the clock that time
        follows]; counted by who advances it.

    """

    def __init__(self, joint_names, actuated_joints):
        self.actuated_joints = tuple(actuated_joints)
        self.torque = np.zeros(len(self.actuated_joints))
        self.accepted = 0
        self.rejected = 0
        self.timed_out = 0
        self.lost = 0
        self.not_actuated = 0
        self.expired, self.held = False, 0.0
        self._joint_names = frozenset(joint_names)
        self._index = {name: i for i, name in enumerate(self.actuated_joints)}
        self._last_arrival = None

    def accept_values(self, values, now):
        """
        Follow a command of one value per actuated joint.

        Parameters
        ----------
        values : sequence of float
            In the order of ``actuated_joints``.
        now : float
            Time of arrival on a steady clock [s].

        Raises
        ------
        CommandError
            If the command is refused.

        """
        if len(values) != len(self.actuated_joints):
            raise self._refusal(
                f'expected {len(self.actuated_joints)} values '
                f'({", ".join(self.actuated_joints)}), got {len(values)}')
        self._require_finite(self.actuated_joints, values)
        self.torque[:] = values
        self._follow(now)

    def accept_named(self, names, efforts, now):
        """
        Follow a command by joint name; joints not named keep their value.

        Parameters
        ----------
        names : sequence of str
            Of joints, in any order. Those that are not actuated are ignored, and counted: the
            hardware interfaces of ros2_control name all joints of their tag.
        efforts : sequence of float
            As many as names, or as there are actuated joints among them.
        now : float
            Time of arrival on a steady clock [s].

        Raises
        ------
        CommandError
            If the command is refused.

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
        self._require_finite(actuated, efforts)
        self.not_actuated += len(names) - len(actuated)
        indices = [self._index[name] for name in actuated]
        self.torque[indices] = efforts
        self._follow(now)

    def expire(self, now, timeout):
        """
        Let the torques fall to zero if no command came, or the last one acted, for too long.

        Parameters
        ----------
        now : float
            On the same clock as the arrivals [s].
        timeout : float
            [s]; 0: hold the last command for ever.

        Returns
        -------
        bool
            True once, when the torques fall.

        """
        if timeout <= 0.0 or self._last_arrival is None:
            return False
        if max(now - self._last_arrival, self.held) <= timeout:
            return False
        self._last_arrival = None
        self.torque[:] = 0.0
        self.timed_out += 1
        self.expired = True
        return True

    def forget(self):
        """Let the torques fall to zero until the next command; the book stays."""
        self.expired = False
        self._last_arrival = None
        self.torque[:] = 0.0

    def _follow(self, now):
        self.accepted += 1
        self.expired, self.held = False, 0.0
        self._last_arrival = now

    def _refusal(self, reason):
        self.rejected += 1
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
