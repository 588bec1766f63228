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

"""Control of a running simulation: reset, pause, step, and states set from outside."""

import math

from closedloop_dynamics.ros.modes import PORTION
from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.ros.process import stop_requested
from closedloop_dynamics.simulation.errors import SimulationError
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger

MESSAGE_PERIOD = 5.0


class Control:
    """
    The services ``~/reset``, ``~/pause``, ``~/step`` and the topic ``~/set_state``.

    Parameters
    ----------
    node : simulator_node.SimulatorNode
        What is controlled.
    waiting : bool
        Whether time waits for the first command, at the start and after each reset.

    Attributes
    ----------
    paused : bool
        By the service.
    waiting : bool
        For a command.
    step_count : int
        Steps that ``~/step`` makes.
    states_set, states_refused : int
        States taken from ``~/set_state``, and those that were not.

    """

    def __init__(self, node, waiting, step_count):
        self._node = node
        self._waits = self.waiting = waiting
        self.paused = False
        self.step_count = step_count
        self.states_set = self.states_refused = 0
        self._refusal = Throttle(MESSAGE_PERIOD)
        node.create_service(Trigger, '~/reset', self.on_reset)
        node.create_service(SetBool, '~/pause', self.on_pause)
        node.create_service(Trigger, '~/step', self.on_step)
        node.create_subscription(JointState, '~/set_state', self.on_set_state, 10)

    @property
    def running(self):
        """Return whether time runs."""
        return not (self.paused or self.waiting)

    def on_command(self):
        """Let time begin that has waited for a command."""
        if self.waiting:
            self.waiting = False
            if not self.paused:
                self._node.mode.start()
                self._node.renew_timer()

    def on_reset(self, request, response):
        """Return to the start: initial state, time zero, no torque."""
        node = self._node
        node.guarded(self._reset)
        response.success = node.exit_code is None
        response.message = (
            f"back at the start of '{node.simulation.scene.name}', time 0"
            f'{self._but()}' if response.success else 'the simulation has stopped')
        node.get_logger().info(f'reset: {response.message}')
        return response

    def _reset(self):
        node = self._node
        node.mode.stop()
        node.simulation.reset()
        node.command.forget()
        self.waiting = self._waits
        if self.running:
            node.mode.start()
        node.renew_timer()
        node.jumped()

    def on_pause(self, request, response):
        """Let time stand still, or go on."""
        node = self._node
        if request.data != self.paused:
            self.paused = request.data
            node.guarded(node.mode.start if self.running else node.mode.stop)
            node.renew_timer()
        response.success = True
        response.message = (
            f'{"paused" if self.paused else "not paused"} at {node.simulation.time:.9g} s'
            f'{self._but() if not self.paused else ""}')
        node.get_logger().info(response.message)
        return response

    def on_step(self, request, response):
        """Advance by ``step_count`` steps while paused."""
        node = self._node
        if not self.paused:
            response.message = 'refused: time runs; call ~/pause with data: true first'
            return response
        node.guarded(self._step)
        response.success = node.exit_code is None
        response.message = f'at {node.simulation.time:.9g} s' if response.success else (
            'the simulation has stopped')
        return response

    def _step(self):
        left = self.step_count
        while left > 0 and not stop_requested():
            portion = min(left, PORTION)
            self._node.advance(portion)
            left -= portion
        self._node.publish()

    def on_set_state(self, message):
        """Move to the nearest state that closes the loops, or refuse."""
        node = self._node
        try:
            position, velocity, hold = self._state(message)
            node.simulation.set_state(position, velocity, hold)
        except (SimulationError, ValueError) as error:
            self.states_refused += 1
            node.warn(self._refusal, f'set_state refused: {error}')
            return
        for note in node.simulation.assembly_notes():
            node.warn(self._refusal, f'set_state: {note}')
        self.states_set += 1
        node.guarded(node.jumped)

    def _state(self, message):
        """Return positions, velocities and held joints of a message; raise ValueError."""
        simulation = self._node.simulation
        joints, names = simulation.joint_names, list(message.name)
        unknown = [name for name in names if name not in joints]
        if unknown or not names:
            raise ValueError((f"'{unknown[0]}' is not a joint" if unknown else 'it names no joint')
                             + f'; the joints are {", ".join(joints)}')
        if len(set(names)) != len(names):
            raise ValueError(f'a joint is named twice in {", ".join(names)}')
        if len(message.position) != len(names):
            raise ValueError(f'expected one position per name, got {len(message.position)} for '
                             f'{len(names)} names')
        if len(message.velocity) not in (0, len(names)):
            raise ValueError(f'expected no velocity, or one per name, got {len(message.velocity)} '
                             f'for {len(names)} names')
        for key in ('position', 'velocity'):
            for name, value in zip(names, getattr(message, key)):
                if not math.isfinite(value):
                    raise ValueError(f"the {key} of '{name}' is {value}, not a finite number")
        position = simulation.position
        velocity = [0.0] * len(joints)
        for name, value in zip(names, message.position):
            position[joints.index(name)] = value
        for name, value in zip(names, message.velocity):
            velocity[joints.index(name)] = value
        # Joints that are not named follow those that are.
        return position, velocity, tuple(names) if len(names) < len(joints) else ()

    @property
    def standing(self):
        """Return what keeps time from running, if anything does."""
        return 'paused' if self.paused else (
            'waiting for the first command' if self.waiting else '')

    def _but(self):
        return f'; {self.standing}' if self.standing else ''
