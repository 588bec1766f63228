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
The node ``closedloop_simulator``: a scene simulated live, driven by torque commands.

A composition: ``modes`` decide when to advance, ``control`` has the services, ``stamps`` the
time, ``messages`` what is published of a state, ``run_parameters`` and ``effect_parameters``
what changes while it runs.

"""

from contextlib import contextmanager
from functools import partial
import time

from closedloop_dynamics.ros.awake import Awake, set_priority
from closedloop_dynamics.ros.commands import CommandError, TorqueCommand
from closedloop_dynamics.ros.companions import COMPANION_PARAMETERS, Companions
from closedloop_dynamics.ros.control import Control
from closedloop_dynamics.ros.diagnostics import Diagnostics
from closedloop_dynamics.ros.effect_parameters import EffectParameters
from closedloop_dynamics.ros.frames import FRAME_PARAMETERS, Frames
from closedloop_dynamics.ros.loading import load_simulation
from closedloop_dynamics.ros.messages import StatePublisher
from closedloop_dynamics.ros.modes import MODES
from closedloop_dynamics.ros.pacing import Overload, Pacer, Throttle
from closedloop_dynamics.ros.parameters import accept_whole_numbers, declare, declare_fact, usage
from closedloop_dynamics.ros.preparation import Preparation
from closedloop_dynamics.ros.process import run, StartError
from closedloop_dynamics.ros.reception import subscribe
from closedloop_dynamics.ros.run_parameters import RunParameters
from closedloop_dynamics.ros.simulator_parameters import LOCKSTEP, REALTIME, SIMULATOR_PARAMETERS
from closedloop_dynamics.ros.stamps import Stamps
from closedloop_dynamics.simulation.errors import NumericalError, SimulationError
import numpy as np
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

NAME = 'closedloop_simulator'
# As many commands may wait while this process is held up.
COMMAND_DEPTH = 1000
# Between two messages of one kind [s].
MESSAGE_PERIOD = 5.0
# A state that does not change is published so often in simulated time [s of the steady clock].
REPEAT_PERIOD = 1.0


class SimulatorNode(Node):
    """
    Advance a simulation and publish its state.

    Attributes
    ----------
    exit_code : int or None
        None while the node wants to go on.
    simulation : Simulation
    command : TorqueCommand
    mode : modes.RealTime, modes.AsFastAsPossible or modes.Lockstep
        When to advance.
    pacer : Pacer
        Simulated and elapsed time.
    control : Control
        Paused, waiting, running.
    stamps : Stamps
        The time that messages carry.
    torque : ndarray, shape (nv,)
        Command that acted in the latest steps [N m or N].
    on_published : list of callables
        Optional publishers: each is called with the stamp, a Time message, after a state was
        published.
    on_advance : list of callables
        Called before steps are made under ``torque``.
    on_jump : list of callables
        Called when the next state does not follow from the last by simulating.
    states : StatePublisher
        Joint states and constraint forces.

    """

    def __init__(self, **options):
        super().__init__(NAME, **options)
        self.exit_code = None
        accept_whole_numbers(self)
        self.on_published, self.on_advance, self.on_jump = [], [], []
        values = declare(self, SIMULATOR_PARAMETERS)
        self.command_timeout = values['command_timeout']
        self.keep_core_awake, self._awake = values['keep_core_awake'], Awake()
        self.simulation = simulation = load_simulation(
            values['scene'], self.get_logger(),
            **{key: values[key] or None for key in ('step_size', 'integrator', 'stabilisation')})
        declare_fact(self, 'actuated_joints', simulation.actuated_joints,
                     'Order of the values of torque_command; told by the scene.')
        self._effects = EffectParameters(self, simulation)
        self.command = TorqueCommand(simulation.joint_names, simulation.actuated_joints)
        self._actuated = [
            simulation.joint_names.index(name) for name in simulation.actuated_joints]
        self.torque = np.zeros(len(simulation.joint_names))
        self.stamps = Stamps(self, simulation, values['publish_clock'] or (
            values['mode'] != REALTIME), values['publish_clock'])
        self.pacer = Pacer(simulation.step_size, values['real_time_factor'])
        self._overload = Overload(self.pacer, MESSAGE_PERIOD)
        self._rejection, self._loss = Throttle(MESSAGE_PERIOD), Throttle(MESSAGE_PERIOD)
        self._told_not_actuated = False
        self._published_at = self._published_stamp = None
        self._create_topics(values['mode'] == LOCKSTEP)
        self.mode = self._build_mode(values)
        self.control = Control(
            self, values['wait_for_command'] and self.mode.name != LOCKSTEP, values['step_count'])
        self._run_parameters = RunParameters(self, values['scene'])
        self.diagnostics = Diagnostics(self)
        # Optional publishers hook themselves in.
        self.companions = Companions(self)
        self._preparation = Preparation(self, values['scene'])
        # Time begins when all is there.
        self._timer = self._due = None
        self._beats = False
        if self.control.running:
            self.mode.start()
        self.renew_timer()
        self._take_priority(values['scheduling_priority'])
        self.get_logger().info(
            f"simulating '{simulation.scene.name}' in steps of {simulation.step_size:g} s, "
            f'{self._pace(values)}; torque_command takes '
            f'{", ".join(simulation.actuated_joints) or "no joint"}'
            f'{"; waiting for the first command" if self.control.waiting else ""}')

    def _take_priority(self, priority):
        try:
            set_priority(priority)
        except OSError as error:
            self.get_logger().warning(
                f'scheduling_priority {priority}: not allowed here ({error}); going on without. '
                'A line "@group - rtprio 99" in /etc/security/limits.conf allows a group to')

    def _build_mode(self, values):
        mode = MODES[values['mode']](self, self.pacer)
        try:
            mode.set_rate(values['publish_rate'])
        except ValueError as error:
            raise StartError(str(error)) from None
        return mode

    def _pace(self, values):
        if self.mode.name == REALTIME:
            return f"at {values['real_time_factor']:g} x real time"
        return f'mode {self.mode.name}'

    def _create_topics(self, lockstep):
        self.states = StatePublisher(
            self, self.simulation.joint_names, [cut.name for cut in self.simulation.cut_joints],
            Frames(self).of_cuts)
        # Best effort takes commands from publishers of both kinds; in lockstep a command that is
        # lost would never be made up for.
        qos = QoSProfile(depth=COMMAND_DEPTH, reliability=(
            ReliabilityPolicy.RELIABLE if lockstep else ReliabilityPolicy.BEST_EFFORT))
        for kind, topic, follow in (
                (Float64MultiArray, 'torque_command', self.on_torque_command),
                (JointState, 'joint_command', self.on_joint_command)):
            subscribe(self, kind, topic, follow, qos, partial(self._note_lost, topic))

    def _note_lost(self, topic, number):
        self.command.lost += number
        self.warn(self._loss, f'{topic}: {number} commands were lost on the way, or came faster '
                              'than they could be taken in')

    def on_torque_command(self, message):
        """Follow or refuse one value per actuated joint."""
        self._follow('torque_command', self.command.accept_values, message.data)

    def on_joint_command(self, message):
        """Follow or refuse efforts by joint name."""
        self._follow('joint_command', self.command.accept_named, message.name, message.effort)
        if self.command.not_actuated and not self._told_not_actuated:
            self._told_not_actuated = True
            self.get_logger().info(
                'joint_command names joints that are not actuated; their efforts are ignored')

    def _follow(self, topic, accept, *content):
        try:
            accept(*content, time.monotonic())
        except CommandError as error:
            self.warn(self._rejection, f'{topic} rejected: {error}')
            return
        self.control.on_command()
        self.guarded(self.mode.take_command)

    def tick(self):
        """Let the mode advance the simulation, and what depends on the clock happen."""
        if self.mode.name != LOCKSTEP:
            self._expire()
        dropped = self.pacer.dropped
        self.guarded(self.mode.tick)
        if self.pacer.dropped > dropped and self._overload.ready():
            self.get_logger().warning(self._overload.message())

    def _expire(self):
        if self.command.expire(time.monotonic(), self.command_timeout):
            self.get_logger().warning(
                f'no command for {self.command_timeout:g} s: all torques are zero until '
                'the next one')

    def guarded(self, action):
        """Do something that may fail as simulations do; stop the node if it does."""
        if self.exit_code is not None:
            return
        try:
            action()
        except SimulationError as error:
            self._stop_ticking()
            self.exit_code = 1
            self.diagnostics.fail(str(error))
            self.get_logger().error(
                f'simulation stopped at {self.simulation.time:.6g} s: {error}')

    def advance(self, steps):
        """Make steps under the torques in force."""
        if self.mode.name == REALTIME:
            # A tick that makes up for others must not hold a command longer than they had.
            self._expire()
            self.command.held += steps * self.simulation.step_size / self.pacer.real_time_factor
        self.torque[self._actuated] = self.command.torque
        for note in self.on_advance:
            note()
        self.simulation.advance(self.torque, steps)

    def publish(self, late=0.0):
        """
        Publish the present state and constraint forces.

        Parameters
        ----------
        late : float
            How long ago the state was due [s of the steady clock].

        Raises
        ------
        NumericalError
            Instead of publishing forces that are not finite.

        """
        simulation, stamp = self.simulation, self.stamps.earlier(late, self._published_stamp)
        forces = simulation.constraint_forces
        if not np.isfinite(forces).all():
            raise NumericalError('the constraint forces are not finite numbers')
        # The clock first: who answers the state knows the time.
        self.stamps.publish()
        self.states.publish(stamp, *simulation.measured(), simulation.effort, forces)
        self._published_at, self._published_stamp = time.monotonic(), stamp
        for publish in self.on_published:
            publish(self.states.stamp)

    def is_received(self):
        """Return whether reliable subscribers have received all states."""
        return self.states.is_received()

    def jumped(self):
        """Publish a state that does not follow from the last by simulating."""
        self.mode.restart()
        for note in self.on_jump:
            note()
        self.publish()

    def refresh(self, late=0.0):
        """
        Publish the state if it has a new stamp, or again, for latecomers, after a while.

        Parameters
        ----------
        late : float
            How long ago the state was due [s of the steady clock].

        """
        if (not self.stamps.simulated or self.stamps.now() != self._published_stamp
                or time.monotonic() - self._published_at >= REPEAT_PERIOD):
            self.publish(late)

    def close(self):
        """Say what was done."""
        self._stop_ticking()
        self._preparation.close()
        self._awake.keep(False)
        pacer, book = self.pacer, self.command
        if pacer.simulated > 0.0 and self.exit_code is None:
            for line in str(self.simulation.report()).splitlines():
                self.get_logger().info(line)
        self.get_logger().info(
            f'simulated {pacer.simulated:.3f} s in {pacer.elapsed:.3f} s, '
            f'{pacer.achieved:.3f} x real time, {pacer.dropped:.3f} s dropped; '
            f'commands: {book.accepted} accepted, {book.rejected} rejected, '
            f'{book.timed_out} timed out, {book.lost} lost; '
            f'{self.states.published} messages published'
            + (f', {self.mode.left_out} states left out' if self.mode.left_out else ''))

    @contextmanager
    def standing_still(self):
        """Let no time pass for the simulation while the body runs."""
        if self.control.running:
            self.mode.stop()
        try:
            yield
        finally:
            if self.control.running:
                self.mode.start()

    def renew_timer(self):
        """Tick as often as the mode wants now."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
        self._timer = self._due = None
        if self._beats and self.mode.name == REALTIME and self.control.running:
            self._due = time.monotonic() + self.mode.tick_period
        else:
            # A steady clock: neither a jump of the system's time nor a stopped
            # /clock may stop the simulation.
            self._timer = self.create_timer(
                self.mode.tick_period, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.attend_to_core()

    def _stop_ticking(self):
        self._due = None
        if self._timer is not None:
            self._timer.cancel()

    def take_over(self):
        """Let the process call ``act()`` when it is due, instead of a timer."""
        self._beats = True
        self.renew_timer()

    def due(self):
        """Return when the next tick is due [s of the steady clock]; None: a timer tells."""
        return self._due

    def act(self):
        """Do what is due."""
        if self._due is None:
            return
        late, period = time.monotonic() - self._due, self.mode.tick_period
        # Ticks that were missed are made up for by this one.
        self._due += period * (1 + max(0, int(late / period)))
        self.tick()

    def attend_to_core(self):
        """Keep the core awake while that is wanted and time runs."""
        try:
            self._awake.keep(self.keep_core_awake and self.control.running)
        except OSError as error:
            self.get_logger().warning(f'keep_core_awake: not on this system ({error})')

    def warn(self, throttle, message):
        """
        Log a warning, one per period of a throttle.

        Parameters
        ----------
        throttle : Throttle
            Of messages of this kind.
        message : str
            What to say.

        """
        if throttle.ready():
            more = throttle.take_held_back()
            self.get_logger().warning(
                f'{message} ({more} more since the last such message)' if more else message)


def main(args=None):
    """Run the node; return the exit code."""
    return run(SimulatorNode, NAME, usage(NAME, SimulatorNode, (
        *SIMULATOR_PARAMETERS, *FRAME_PARAMETERS, *COMPANION_PARAMETERS)), args)
