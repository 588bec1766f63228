# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The node ``closedloop_simulator``: a scene simulated live, driven by torque commands.

The node has the topics, services and timers. It checks what comes in, and has a mode of
``pacing`` advance a ``live.LiveSimulation``, which publishes its states. None of these knows the
node.
"""

from collections import deque
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
import math
import time

from closedloop_dynamics.codegen import announced_by
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.ros.auxiliary_publishers import Descriptions, ReplayLog
from closedloop_dynamics.ros.background import IdleStateInhibitor, set_priority
from closedloop_dynamics.ros.commands import (
    CommandError, NOT_ACTUATED, poses_of, SERVICE_QOS, state_of, subscribe, TorqueCommand)
from closedloop_dynamics.ros.diagnostics import Diagnostics, graph_finding
from closedloop_dynamics.ros.effect_parameters import EffectParameters
from closedloop_dynamics.ros.frames import FRAME_PARAMETERS, Frames
from closedloop_dynamics.ros.live import LiveSimulation
from closedloop_dynamics.ros.loading import load_simulation, log_cost
from closedloop_dynamics.ros.markers import MARKER_PARAMETERS, Markers
from closedloop_dynamics.ros.messages import Stamps, StatePublisher
from closedloop_dynamics.ros.motion_command import LOST, MotionCommand
from closedloop_dynamics.ros.node import DIAGNOSTIC_PERIOD, ProgramNode
from closedloop_dynamics.ros.pacing import (
    LOCKSTEP, MODES, period_steps, PORTION, REALTIME, Throttle)
from closedloop_dynamics.ros.parameters import declare_fact
from closedloop_dynamics.ros.process import leaving_at_once, StartError, stop_requested
from closedloop_dynamics.ros.simulator_parameters import (
    CHANGEABLE, METHOD, method_changes, SIMULATOR_PARAMETERS)
from closedloop_dynamics.simulation.pacer import Pacer
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport
from sensor_msgs.msg import JointState
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

# As many commands may wait while this process is held up.
COMMAND_DEPTH = 1000
# Wrenches on different bodies that come together.
WRENCH_DEPTH = 10


class SimulatorNode(ProgramNode):
    """
    Advance a simulation and publish its state.

    ``exit_code``: None while the node wants to go on; ``live``: the ``simulation`` under the
    ``command``, with its publishers (``states``); ``pacer``: simulated and elapsed time; ``mode``:
    when to advance; ``paused``, ``waiting``: by the service ``~/pause``; for a command;
    ``counts``: states taken from ``~/set_state``, and those that were not; ``stepped``: time
    simulated by single steps in pauses [s].
    """

    NAME, PARAMETERS = 'closedloop_simulator', SIMULATOR_PARAMETERS
    FURTHER = *FRAME_PARAMETERS, *MARKER_PARAMETERS
    TIMED = LOSES_NOTHING = True

    def __init__(self, **options):
        super().__init__(**options)
        values = self.values
        lockstep = values['mode'] == LOCKSTEP
        with announced_by(self.get_logger().info):
            self.simulation, self._own_method = load_simulation(
                values, self.get_logger(), values['motion_joints'],
                **{key: values[key] or None for key in METHOD})
        try:
            method_changes(values, self._own_method, self.simulation.scene.method)
        except ValueError as error:
            raise StartError(str(error)) from None
        log_cost(
            self.simulation, values['real_time_factor'] if values['mode'] == REALTIME else 1.0,
            self.get_logger())
        self.throttles = {key: Throttle() for key in (
            'rejected', 'motion', 'wrench', 'lost', 'refused', 'repeated', 'overload', 'busy')}
        self._warned_not_actuated, self._method_prepared = False, None
        self.paused, self.waiting = False, values['wait_for_command'] and not lockstep
        self._expected = values['wait_for_subscribers']
        self.counts, self.stepped = {'states set': 0, 'states refused': 0}, 0.0
        declare_fact(self, 'actuated_joints', self.simulation.actuated_joints,
                     'Order of the values of torque_command; given by the scene.')
        self.effect_parameters = EffectParameters(self, self.simulation)
        self._create_simulation()
        self._create_observers()
        self._create_inputs(lockstep)
        self._standard = self._create_standard_interfaces()
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self._change)
        self.idle_states = IdleStateInhibitor()
        self.every(DIAGNOSTIC_PERIOD, self.publish_diagnostics)
        # Time begins when all is there.
        self.timer = self._due = None
        # Where the process lets this node act: what it is to do beside ticks, and since when it
        # has been busy.
        self._beats, self._pending, self._busy_since = False, deque(), None
        if self.running:
            self.mode.start()
        self._renew_timer()
        self._take_priority(values['scheduling_priority'])
        pace = (f"at {values['real_time_factor']:g} x real time" if self.mode.name == REALTIME
                else f'mode {self.mode.name}')
        self.get_logger().info(
            f"simulating '{self.simulation.scene.name}' in steps of "
            f'{self.simulation.step_size:g} s, {pace}; torque_command takes '
            f'{", ".join(self.simulation.actuated_joints) or "no joint"}'
            + (f'; motion_command moves {", ".join(self.simulation.data.commanded_motions)}'
               if self.simulation.data.commanded_motions else '')
            + self._but())

    def _create_simulation(self):
        """Create the parts that advance and publish the simulation."""
        values, simulation = self.values, self.simulation
        self._frames = Frames(self, simulation)
        self.states = StatePublisher(
            self, simulation.coordinates,
            [f'constraint_forces/{cut.name}' for cut in simulation.mechanism.cut_joints],
            self._frames.of_cuts, simulation.mechanism.cut_coordinates,
            {topic: list(forces) for topic, forces in simulation.data.equation_forces().items()})
        self.command = TorqueCommand(
            (*simulation.joint_names, *simulation.cut_joint_names), simulation.actuated_joints,
            values['command_timeout'],
            lambda torque: simulation.stepping.require_admissible(
                simulation.joint_torques(torque)))
        self.pacer = Pacer(simulation.step_size, values['real_time_factor'])
        real_time = values['mode'] == REALTIME
        if real_time:
            simulation.stepping.pace = values['real_time_factor']
        stamps = Stamps(self, simulation, values['publish_clock'] or not real_time,
                        values['publish_clock'], 1.0 / values['publish_rate'])
        self.live = LiveSimulation(simulation, self.command, stamps, self.states,
                                   self.pacer if real_time else None, self.get_logger())
        self.motion = MotionCommand(simulation, stamps, self.pacer)
        self.mode = MODES[values['mode']](self.live, self.pacer)
        try:
            self.mode.set_rate(values['publish_rate'])
        except ValueError as error:
            raise StartError(str(error)) from None

    def _create_observers(self):
        """Create the observers of each published state."""
        self.diagnostics = Diagnostics(self, self.live, self.mode)
        self.log = ReplayLog(self, self.simulation)
        descriptions = Descriptions(self, self.simulation, self.log)
        self.markers = Markers(self, self.simulation, lambda: self.diagnostics.summary)
        self.live.on_published += [self._frames.on_state] * self._frames.any + [
            self.diagnostics.watch_health, descriptions.on_state, self.log.on_state,
            self.markers.on_state]
        self.live.on_advance.append(self.log.advancing)
        self.live.on_jump.append(self.log.jumped)

    def _create_inputs(self, lockstep):
        """Create the topics and services that drive the simulation."""
        # Best effort takes commands from publishers of both kinds; in lockstep a command that is
        # lost would never be made up for.
        qos = QoSProfile(depth=COMMAND_DEPTH, reliability=(
            ReliabilityPolicy.RELIABLE if lockstep else ReliabilityPolicy.BEST_EFFORT))
        for kind, topic, follow in (
                (Float64MultiArray, 'torque_command', self.on_torque_command),
                (JointState, 'joint_command', self.on_joint_command)):
            subscribe(self, kind, topic, follow, qos, partial(self._count_lost, topic))
        if self.simulation.data.commanded_motions:
            subscribe(self, JointTrajectory, 'motion_command', self.on_motion_command,
                      QoSProfile(depth=COMMAND_DEPTH), self._count_lost_motion)
        # The newest counts: a late one is of no use.
        self.create_subscription(
            WrenchStamped, 'external_wrench', self.on_external_wrench,
            QoSProfile(depth=WRENCH_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT))
        self.create_subscription(
            JointState, '~/set_state', self.on_set_state, COMMAND_DEPTH)
        if self.simulation.coordinates.with_orientation:
            self.create_subscription(
                MultiDOFJointState, '~/set_multi_dof_state', self.on_set_multi_dof_state,
                COMMAND_DEPTH)
        for kind, service, answer in (
                (Trigger, '~/reset', self.on_reset), (SetBool, '~/pause', self.on_pause),
                (Trigger, '~/step', self.on_step)):
            self.create_service(kind, service, answer, qos_profile=SERVICE_QOS)

    def _create_standard_interfaces(self):
        """Offer the services of ``simulation_interfaces`` where these messages are installed."""
        if find_spec('simulation_interfaces') is None:
            return None
        try:
            from closedloop_dynamics.ros.standard_interfaces import RunControl, StandardInterfaces
            return StandardInterfaces(self, self.live, RunControl(
                lambda: self.paused, lambda: self.standing, self._problem, self.pause,
                self.restart, self.restart_time, self.make_steps, self.move_to, self._end,
                lambda: self.executor.create_task(lambda: None)))
        except (ImportError, RuntimeError, UnsupportedTypeSupport) as error:
            self.get_logger().warning(
                'the package simulation_interfaces is installed, but does not work: '
                + ' '.join(str(error).split()))
            return None

    def _problem(self):
        """Return why requests cannot be answered now, or ''."""
        return self.busy or ('' if self.exit_code is None else 'the simulation has stopped')

    def _end(self):
        self.get_logger().info('ended by set_simulation_state')
        self.exit_code = 0

    def _take_priority(self, priority):
        try:
            set_priority(priority)
        except OSError as error:
            self.get_logger().warning(
                f'scheduling_priority {priority}: not allowed here ({error}); going on without. '
                'A line "@group - rtprio 99" in /etc/security/limits.conf allows a group to')

    # Commands and time.

    @property
    def running(self):
        """Return whether time runs."""
        return not self.standing

    @property
    def standing(self):
        """Return the reason why time does not run, if there is one."""
        if self.paused:
            return 'paused'
        if self._expected:
            return (f'waiting for {self._expected} subscribers of joint_states, there are '
                    f'{self.states.subscribers} (wait_for_subscribers)')
        return 'waiting for the first command' if self.waiting else ''

    def on_torque_command(self, message):
        """Follow or refuse one value per actuated joint."""
        self.do(partial(
            self._accept, 'torque_command', self.command.accept_values, message.data,
            time.monotonic()))

    def on_joint_command(self, message):
        """Follow or refuse efforts by joint name."""
        self.do(partial(
            self._accept, 'joint_command', self.command.accept_named, message.name, message.effort,
            time.monotonic()))
        if self.command.counts[NOT_ACTUATED] and not self._warned_not_actuated:
            self._warned_not_actuated = True
            self.get_logger().info(
                'joint_command names joints that are not actuated; their efforts are ignored')

    def _accept(self, topic, accept, *content):
        try:
            accept(*content)
        except CommandError as error:
            self.warn('rejected', f'{topic} rejected: {error}')
            return
        self._end_waiting()
        self._guarded(self.mode.on_command)

    def do(self, action):
        """
        Do something with the simulation: at once, or when the node acts next.

        What makes steps is done outside the executor, where the node may act there, and all else
        is while steps are made: the present thread may be another one then.
        """
        if self._beats and (self.mode.name != REALTIME or self._busy_since is not None):
            self._pending.append(action)
        else:
            action()

    def on_motion_command(self, message):
        """Make commanded motions follow a trajectory, or refuse it."""
        self.do(partial(self._accept_motion, message))

    def _accept_motion(self, message):
        try:
            self.motion.accept(message)
        except CommandError as error:
            self.warn('motion', f'motion_command refused: {error}')
            return
        self._end_waiting()

    def on_external_wrench(self, message):
        """Apply a wrench to a body for a while, or refuse it."""
        self.do(partial(self._accept_wrench, message))

    def _accept_wrench(self, message):
        try:
            self.live.wrench.accept(message)
        except CommandError as error:
            self.warn('wrench', f'external_wrench refused: {error}')

    def _end_waiting(self):
        """Start time if it has waited for a command."""
        if self.waiting:
            self.waiting = False
            self._go_on()

    def _go_on(self):
        """Start time if nothing prevents it any more."""
        if self.running:
            self._guarded(self.mode.start)
            self._renew_timer()

    def _count_lost(self, topic, number):
        self.command.counts['lost'] += number
        self.warn('lost', f'{topic}: {number} commands were lost on the way, or came faster '
                          'than they could be taken in')

    def _count_lost_motion(self, number):
        self.motion.counts[LOST] += number
        self.warn('lost', f'motion_command: {number} trajectories were lost on the way')

    def _on_timer(self):
        if not self._pending:
            self.do(self.tick)

    def tick(self):
        """Advance the simulation by its mode, and do the work that depends on the clock."""
        if self._expected and self.states.subscribers >= self._expected:
            # Once begun, it goes on whichever node leaves.
            self._expected = 0
            self._go_on()
        if self.mode.name != LOCKSTEP:
            self.live.expire()
        if not self.paused and (self.waiting or self.mode.unanswered) and self.live.is_stale:
            # Controllers may wait for time to pass before they command.
            self.live.stamps.let_period_pass()
        dropped, repeated = self.pacer.dropped, self.mode.repeated
        self._guarded(self.mode.tick)
        if self.mode.repeated > repeated:
            self.warn('repeated', f'no command answers the state at {self.simulation.time:.9g} s: '
                                  'it is published again')
        if self.pacer.dropped > dropped and self.throttles['overload'].ready():
            self.get_logger().warning(self.pacer.overload())

    def _guarded(self, action):
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

    def publish_diagnostics(self):
        busy = self.busy
        if busy:
            self.diagnostics.stall(busy)
            self.warn('busy', busy)
            return
        self.diagnostics.publish(
            self.standing, {**self.command.counts, **self.counts, **self._motion_counts,
                            **self.live.wrench.counts},
            tuple(sorted(
                f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                for topic in ('torque_command', 'joint_command')
                for info in self.get_publishers_info_by_topic(topic))), self._graph_finding())

    def _graph_finding(self):
        """Return the finding on the other nodes."""
        own = self.get_name(), self.get_namespace()
        return graph_finding(
            self.get_fully_qualified_name(),
            sum(found == own for found in self.get_node_names_and_namespaces()),
            self.count_publishers(self.resolve_topic_name('/clock')),
            self.get_clock().ros_time_is_active and not self.live.stamps.simulated)

    @property
    def _motion_counts(self):
        """Return the counts of trajectories, where any may be followed."""
        return self.motion.counts if self.simulation.data.commanded_motions else {}

    # Services.

    @property
    def busy(self):
        """Return the answer to requests while a step is computed in another thread, or ''."""
        since = self._busy_since
        return '' if since is None else (
            f'busy: a step at t = {self.simulation.time:.9g} s has been computing for '
            f'{time.monotonic() - since:.1f} s; ask again')

    def on_reset(self, request, response):
        """Return to the start: initial state, time zero, no torque."""
        response.message = self.busy
        if response.message:
            return response
        self.restart()
        response.success = self.exit_code is None
        response.message = (
            f"back at the start of '{self.simulation.scene.name}', time 0{self._but()}"
            if response.success else 'the simulation has stopped')
        self.get_logger().info(f'reset: {response.message}')
        return response

    def restart(self):
        """Go back to the start, without torques; a pause stays."""
        self._guarded(self.reset)

    def restart_time(self):
        """Set simulated time to zero in the present state, which may raise SimulationError."""
        self.simulation.stepping.begin_at(replace(self.simulation.snapshot(), time=0.0))
        self._guarded(self.jump)

    def reset(self):
        self.mode.stop()
        self.simulation.reset()
        self.command.forget()
        self.live.wrench.forget()
        self.waiting = self.values['wait_for_command'] and self.mode.name != LOCKSTEP
        if self.running:
            self.mode.start()
        self._renew_timer()
        self.jump()

    def jump(self):
        self.mode.restart()
        self.live.jump()

    def on_pause(self, request, response):
        """Pause or resume, on request of a service."""
        response.message = self.busy
        if response.message:
            return response
        self.pause(request.data)
        response.success = True
        response.message = (
            f'{"paused" if self.paused else "not paused"} at {self.simulation.time:.9g} s'
            f'{self._but() if not self.paused else ""}')
        self.get_logger().info(response.message)
        return response

    def pause(self, paused):
        """Pause or resume."""
        if paused != self.paused:
            self.paused = paused
            self._guarded(self.mode.start if self.running else self.mode.stop)
            self._renew_timer()

    def on_step(self, request, response):
        """Advance by ``step_count`` steps while paused."""
        busy = self.busy
        if busy or not self.paused:
            response.message = busy or 'refused: time runs; call ~/pause with data: true first'
            return response
        self.make_steps(self.values['step_count'])
        response.success = self.exit_code is None
        response.message = f'at {self.simulation.time:.9g} s' if response.success else (
            'the simulation has stopped')
        return response

    def make_steps(self, count):
        """Advance by steps of the time integration, and publish."""
        self._guarded(partial(self._make_steps, count))

    def _make_steps(self, left):
        while left > 0 and not stop_requested():
            portion = min(left, PORTION)
            self.live.advance(portion)
            self.stepped += portion * self.simulation.step_size
            left -= portion
        self.live.publish()

    def on_set_state(self, message):
        """Move to the nearest state that closes the loops, or refuse."""
        self.do(partial(self._set_state, partial(
            state_of, measured=self.simulation.mechanism.measured_cuts), message))

    def on_set_multi_dof_state(self, message):
        """Do the same for joints with an orientation."""
        cut = self.simulation.mechanism.cut_coordinates
        self.do(partial(
            self._set_state, partial(poses_of, measured=cut.with_orientation), message))

    def _set_state(self, read, message):
        simulation = self.simulation
        try:
            self.move_to(*read(message, simulation.coordinates, simulation.position))
        except (SimulationError, ValueError) as error:
            self.counts['states refused'] += 1
            self.warn('refused', f'set_state refused: {error}')

    def move_to(self, position, velocity, hold=None):
        """Go to a state, as ``Simulation.set_state`` does, which may refuse; and publish it."""
        simulation = self.simulation
        simulation.set_state(position, velocity, hold)
        for note in simulation.data.assembly_notes():
            self.warn('refused', f'set_state: {note}')
        self.counts['states set'] += 1
        self._guarded(self.jump)

    def _but(self):
        return f'; {self.standing}' if self.standing else ''

    # Parameters that change while time runs.

    def _check_change(self, parameters):
        """Refuse impossible values; prepare a method that is not in use yet."""
        busy = self.busy
        if busy:
            return SetParametersResult(successful=False, reason=busy)
        self._method_prepared = None
        values = self._changeable(parameters)
        try:
            for name, value in values.items():
                CHANGEABLE[name].require_choice(value)
            changes = method_changes(
                {**self.values, **values}, self._own_method, self.simulation.scene.method)
            if self.mode.name != REALTIME and (
                    'publish_rate' in values or 'step_size' in changes):
                period_steps(values.get('publish_rate', self.values['publish_rate']),
                             changes.get('step_size', self.simulation.step_size))
            if changes:
                self.get_logger().info(
                    'taking another method: ' + ', '.join(f'{k} {v}' for k, v in changes.items()))
                with self._standing_still(), leaving_at_once():
                    self._method_prepared = self.simulation.stepping.prepare_method(**changes)
        except (ValueError, SimulationError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _changeable(self, parameters):
        return {parameter.name: parameter.value for parameter in parameters
                if parameter.name in CHANGEABLE}

    def _change(self, parameters):
        """Apply checked changes together."""
        values = self._changeable(parameters)
        self.values.update(values)
        if self._method_prepared is not None and set(values) & set(METHOD):
            take_effect, self._method_prepared = self._method_prepared, None
            with self._standing_still():
                take_effect()
            self.pacer.step_size = self.simulation.step_size
        if 'real_time_factor' in values:
            self.pacer.real_time_factor = values['real_time_factor']
            if self.mode.name == REALTIME:
                self.simulation.stepping.pace = values['real_time_factor']
        self.command.timeout = self.values['command_timeout']
        if 'keep_core_awake' in values:
            self._attend_to_core()
        if {'publish_rate', 'step_size'} & set(values):
            self.mode.set_rate(self.values['publish_rate'])
            self._renew_timer()

    @contextmanager
    def _standing_still(self):
        """Pause simulated time while the body runs."""
        if self.running:
            self.mode.stop()
        try:
            yield
        finally:
            if self.running:
                self.mode.start()

    # Ticks: by a timer, or by the process that spins this node.

    def _renew_timer(self):
        """Tick as often as the mode wants now."""
        if self.timer is not None:
            self.destroy_timer(self.timer)
        self.timer = self._due = None
        if self._beats and self.mode.name == REALTIME and self.running:
            self._due = time.monotonic() + self.mode.tick_period
        else:
            self.timer = self.every(self.mode.tick_period, self._on_timer)
        self._attend_to_core()

    def _stop_ticking(self):
        self._due = None
        if self.timer is not None:
            self.timer.cancel()

    def take_over(self):
        """Have the process call ``act()`` when it is due, instead of a timer."""
        self._beats = True
        self._renew_timer()

    def due(self):
        """Return the time of the next action [s of the steady clock]; None: a timer acts."""
        return -math.inf if self._pending else self._due

    def act(self):
        """Perform the actions that are due."""
        self._busy_since = time.monotonic()
        try:
            while self._pending:
                self._pending.popleft()()
            self._tick_if_due()
        finally:
            self._busy_since = None

    def _tick_if_due(self):
        if self._due is None or time.monotonic() < self._due:
            return
        late, period = time.monotonic() - self._due, self.mode.tick_period
        # Ticks that were missed are made up for by this one.
        self._due += period * (1 + max(0, int(late / period)))
        self.tick()

    def _attend_to_core(self):
        """Keep the core awake while that is wanted and time runs."""
        try:
            self.idle_states.keep(self.values['keep_core_awake'] and self.running)
        except OSError as error:
            self.get_logger().warning(f'keep_core_awake: not on this system ({error})')

    def close(self):
        """Log a summary."""
        self._stop_ticking()
        self.idle_states.keep(False)
        pacer, counts = self.pacer, self.command.counts
        simulated = pacer.simulated + self.stepped
        if simulated > 0.0 and self.exit_code is None:
            for line in str(self.simulation.report()).splitlines():
                self.get_logger().info(line)
        self.get_logger().info(
            f'simulated {simulated:.3f} s in {pacer.elapsed:.3f} s, '
            f'{pacer.achieved:.3f} x real time, {pacer.dropped:.3f} s dropped'
            + (f', {self.stepped:.3f} s by steps in pauses' if self.stepped else '')
            + '; commands: '
            + ', '.join(f'{counts[key]} {key}' for key in (
                'accepted', 'rejected', 'timed out', 'lost'))
            + ''.join(f', {number} {key}' for key, number in self._motion_counts.items())
            + f'; {self.states.published} messages published'
            + (f', {self.mode.left_out} states left out' if self.mode.left_out else '')
            + (f', {self.mode.repeated} states published again' if self.mode.repeated else ''))

    def warn(self, kind, message):
        """
        Log a warning, one of each kind per ``pacing.MESSAGE_PERIOD``.

        Kinds are ``'rejected'``, ``'motion'``, ``'wrench'``, ``'lost'``, ``'refused'``,
        ``'repeated'`` and ``'busy'``.
        """
        throttle = self.throttles[kind]
        if throttle.ready():
            more = throttle.take_held_back()
            self.get_logger().warning(
                f'{message} ({more} more since the last such message)' if more else message)


main = SimulatorNode.main
