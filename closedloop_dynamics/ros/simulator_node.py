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

"""The node ``closedloop_simulator``: a scene simulated live, driven by torque commands."""

import time

from closedloop_dynamics.errors import NumericalError
from closedloop_dynamics.errors import SimulationError
from closedloop_dynamics.ros.commands import CommandError
from closedloop_dynamics.ros.commands import TorqueCommand
from closedloop_dynamics.ros.companions import Companions
from closedloop_dynamics.ros.effect_parameters import EffectParameters
from closedloop_dynamics.ros.loading import load_simulation
from closedloop_dynamics.ros.messages import StateMessages
from closedloop_dynamics.ros.pacing import Pacer
from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.ros.parameters import declare
from closedloop_dynamics.ros.parameters import declare_fact
from closedloop_dynamics.ros.parameters import Parameter
from closedloop_dynamics.ros.process import run
from closedloop_dynamics.ros.process import StartError
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

NAME = 'closedloop_simulator'
# A reliable subscriber that stalls for a second at 1 kHz still gets everything.
STATE_QOS = QoSProfile(depth=1000)
COMMAND_QOS = QoSProfile(depth=10)
# Share of a period that may go into computing; the rest is for messages.
COMPUTING_SHARE = 0.8
# Between two messages of one kind [s].
MESSAGE_PERIOD = 5.0

PARAMETERS = (
    Parameter(
        'scene', 'three_rrr',
        'What to simulate: the name of a shipped scene, or the path of a scene file.'),
    Parameter(
        'publish_rate', 100.0,
        'States and constraint forces published per second [Hz]; a command takes effect '
        'within one period.', (0.1, 2000.0), read_only=False),
    Parameter(
        'step_size', 0.0,
        "Step of the time integration [s]; 0: the scene's own.", (0.0, 0.1)),
    Parameter(
        'real_time_factor', 1.0,
        'Simulated seconds per second of the steady clock [1].', (0.001, 1000.0),
        read_only=False),
    Parameter(
        'command_timeout', 0.0,
        'Torques fall to zero when no command arrived for so long [s of the steady clock]; '
        '0: the last command holds for ever.', (0.0, 3600.0), read_only=False),
    Parameter(
        'wait_for_command', False,
        'Keep the initial state, and publish it, until the first command arrives; otherwise a '
        'machine with weight falls while its controller is starting.'),
)


class SimulatorNode(Node):
    """
    Advance a simulation with the steady clock and publish its state.

    Attributes
    ----------
    exit_code : int or None
        None while the node wants to go on.
    simulation : Simulation
    command : TorqueCommand
    pacer : Pacer
    published : int
        Messages published so far.

    """

    def __init__(self, **options):
        super().__init__(NAME, **options)
        self.exit_code = None
        self.published = 0
        values = declare(self, PARAMETERS)
        self.command_timeout = values['command_timeout']
        self.simulation = simulation = load_simulation(
            values['scene'], self.get_logger(), step_size=values['step_size'] or None)
        declare_fact(self, 'actuated_joints', simulation.actuated_joints,
                     'Order of the values of torque_command; told by the scene.')
        self._effects = EffectParameters(self, simulation)
        self.command = TorqueCommand(simulation.joint_names, simulation.actuated_joints)
        self._actuated = [
            simulation.joint_names.index(name) for name in simulation.actuated_joints]
        self._tau = np.zeros(len(simulation.joint_names))
        self.pacer = Pacer(simulation.step_size, values['real_time_factor'])
        self._overload = _Overload(self.pacer)
        self._rejection = Throttle(MESSAGE_PERIOD)
        self._create_topics()
        self._companions = Companions(self)
        self.add_post_set_parameters_callback(self._on_parameters)
        self._set_rate(values['publish_rate'])
        if not values['wait_for_command']:
            self.pacer.start()
        self.get_logger().info(
            f"simulating '{simulation.scene.name}' in steps of {simulation.step_size:g} s at "
            f"{values['real_time_factor']:g} x real time; torque_command takes "
            f'{", ".join(simulation.actuated_joints) or "no joint"}'
            f'{"" if self.pacer.running else "; waiting for the first command"}')

    def _create_topics(self):
        cut_names = [cut.name for cut in self.simulation.cut_joints]
        self.messages = StateMessages(self.simulation.joint_names, cut_names)
        self._state_publisher = self.create_publisher(JointState, 'joint_states', STATE_QOS)
        try:
            self._force_publishers = [
                self.create_publisher(WrenchStamped, f'constraint_forces/{name}', STATE_QOS)
                for name in cut_names]
        except InvalidTopicNameException:
            raise StartError(
                'the name of a cut joint becomes part of a topic name, so it must be letters, '
                f'digits and underscores, not beginning with a digit; got {cut_names}') from None
        self.create_subscription(
            Float64MultiArray, 'torque_command', self.on_torque_command, COMMAND_QOS)
        self.create_subscription(
            JointState, 'joint_command', self.on_joint_command, COMMAND_QOS)

    def on_torque_command(self, message):
        """Follow or refuse one value per actuated joint."""
        self._follow('torque_command', self.command.accept_values, message.data)

    def on_joint_command(self, message):
        """Follow or refuse efforts by joint name."""
        self._follow('joint_command', self.command.accept_named, message.name, message.effort)

    def _follow(self, topic, accept, *content):
        try:
            accept(*content, time.monotonic())
        except CommandError as error:
            self._warn(self._rejection, f'{topic} rejected: {error}')
            return
        if not self.pacer.running:
            self.pacer.start()

    def tick(self):
        """Advance the simulation to the present and publish it."""
        if self.command.expire(time.monotonic(), self.command_timeout):
            self.get_logger().warning(
                f'no command for {self.command_timeout:g} s: all torques are zero until '
                'the next one')
        self._tau[self._actuated] = self.command.torque
        try:
            dropped = self.pacer.tick(self._advance, self._budget)
            self.publish()
        except SimulationError as error:
            self._timer.cancel()
            self.exit_code = 1
            self.get_logger().error(
                f'simulation stopped at {self.simulation.time:.6g} s: {error}')
            return
        if dropped and self._overload.ready():
            self.get_logger().warning(self._overload.message())

    def publish(self):
        """
        Publish the present state and constraint forces.

        Raises
        ------
        NumericalError
            Instead of publishing forces that are not finite.

        """
        simulation = self.simulation
        forces = simulation.constraint_forces
        if not np.isfinite(forces).all():
            raise NumericalError('the constraint forces are not finite numbers')
        self.messages.fill(
            self.get_clock().now().nanoseconds, *simulation.measured(), simulation.effort,
            forces)
        self._state_publisher.publish(self.messages.joint_state)
        for publisher, message in zip(self._force_publishers, self.messages.wrenches):
            publisher.publish(message)
        self._companions.follow(self.messages.joint_state.header.stamp, self._tau)
        self.published += 1 + len(self._force_publishers)

    def close(self):
        """Say what was done."""
        self._timer.cancel()
        pacer, book = self.pacer, self.command
        self.get_logger().info(
            f'simulated {pacer.simulated:.3f} s in {pacer.elapsed:.3f} s, '
            f'{pacer.achieved:.3f} x real time, {pacer.dropped:.3f} s dropped; '
            f'commands: {book.accepted} accepted, {book.rejected} rejected, '
            f'{book.timed_out} timed out; {self.published} messages published')

    def _advance(self, steps):
        self.simulation.advance(self._tau, steps)

    def _set_rate(self, rate):
        self._budget = COMPUTING_SHARE / rate
        if hasattr(self, '_timer'):
            self.destroy_timer(self._timer)
        # A steady clock: neither a jump of the system's time nor a stopped
        # /clock may stop the simulation.
        self._timer = self.create_timer(
            1.0 / rate, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_parameters(self, parameters):
        for parameter in parameters:
            if parameter.name == 'publish_rate':
                self._set_rate(parameter.value)
            elif parameter.name == 'real_time_factor':
                self.pacer.real_time_factor = parameter.value
            elif parameter.name == 'command_timeout':
                self.command_timeout = parameter.value

    def _warn(self, throttle, message):
        if throttle.ready():
            more = throttle.take_held_back()
            self.get_logger().warning(
                f'{message} ({more} more since the last such message)' if more else message)


class _Overload:
    """The message of a machine that cannot keep up, with the factor since the last one."""

    def __init__(self, pacer):
        self.pacer = pacer
        self._throttle = Throttle(MESSAGE_PERIOD)
        self._simulated = self._elapsed = 0.0

    def ready(self):
        return self._throttle.ready()

    def message(self):
        pacer = self.pacer
        achieved = (pacer.simulated - self._simulated) / (pacer.elapsed - self._elapsed)
        self._simulated, self._elapsed = pacer.simulated, pacer.elapsed
        return (
            f'this machine cannot keep up: {achieved:.3g} x real time instead of '
            f'{pacer.real_time_factor:g}; {pacer.dropped:.3f} s of simulated time dropped so far '
            '(a larger step_size or a smaller real_time_factor helps)')


def main(args=None):
    """Run the node; return the exit code."""
    return run(SimulatorNode, NAME, args)
