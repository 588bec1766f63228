# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The node ``closedloop_torque_source``: torques for any scene, from a process of their own."""

from array import array
from importlib.util import find_spec
from itertools import chain
from math import isfinite
import time

from closedloop_dynamics.control.controller import closed_loop, gains, open_loop
from closedloop_dynamics.control.references import TrajectoryError
from closedloop_dynamics.control.settings import FEEDBACK_MODES, MODEL_MODES
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.recording.message_numbers import stamp_of
from closedloop_dynamics.ros.commands import CommandError, poses_of, SERVICE_QOS
from closedloop_dynamics.ros.joint_trajectory import points_of
from closedloop_dynamics.ros.loading import load_simulation
from closedloop_dynamics.ros.node import ProgramNode
from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.timeline import Timeline
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
import numpy as np
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport
from sensor_msgs.msg import JointState
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

QUEUE_DEPTH = 10
# Only the newest state is worth an answer: those that waited behind others while this process was
# held up would be answered too late, which can make a control loop unstable. Several may wait all
# the same: one of another publisher, which is not usable, must not take the place of the newest.
STATE_DEPTH = 10
# Each orientation is kept until its state has come.
ORIENTATION_DEPTH = 1
# Period of the search for the simulator [s].
QUESTION_PERIOD = 0.1
# A question without an answer for so long is asked again: the node asked may
# have gone in between [s].
ANSWER_TIMEOUT = 0.5
# States older than the last command are not answered, so many in a row at most: after
# that, the command is taken for lost.
MOST_SKIPPED = 2
# A state with the stamp of the one before is the same again: answered again only if the first
# answer seems to be lost, after so long [s].
LOST = 0.5
# A stamp further ahead than the longest period of a simulator [s], or one from before the last, is
# wrong, or time has jumped: the next one tells.
AHEAD, BEHIND, SEVERAL = 10.0, 0.0, 2


class JointQuestion:
    """
    Request of a simulator's parameter ``actuated_joints``, repeated until it answers.

    ``simulator`` is its name, relative to the namespace of ``node``, which asks. ``answer`` is a
    tuple of names, None as long as there is none.
    """

    def __init__(self, node, simulator):
        self.answer = None
        self._client = node.create_client(
            GetParameters, f'{simulator}/get_parameters', qos_profile=SERVICE_QOS)
        self._pending = None
        self._asked = None

    def ask(self):
        """Send the question if that makes sense now; to be called again and again."""
        now = time.monotonic()
        if self._pending is not None:
            if now - self._asked < ANSWER_TIMEOUT:
                return
            self._client.remove_pending_request(self._pending)
            self._pending = None
        if self._client.service_is_ready():
            self._asked = now
            self._pending = self._client.call_async(
                GetParameters.Request(names=['actuated_joints']))
            self._pending.add_done_callback(self._on_answer)

    def _on_answer(self, future):
        values = future.result().values
        self._pending = None
        # A node without the parameter, or a simulator that is still
        # starting, answers with a value that is not set.
        if values and values[0].type == ParameterType.PARAMETER_STRING_ARRAY:
            self.answer = tuple(values[0].string_array_value)


class Orientations:
    """
    The part of a state that comes in a message of its own: joints with an orientation.

    Both parts have the same stamp, and may come in any order.
    """

    def __init__(self, mechanism):
        self._coordinates = mechanism.coordinates
        self._cut = mechanism.cut_coordinates.with_orientation
        self._stamp = self._state = self._waiting = None

    def accept(self, message):
        """Keep a MultiDOFJointState; return the JointState that waited for it, or None."""
        position, velocity, _ = poses_of(
            message, self._coordinates, self._coordinates.start(), self._cut)
        if not len(message.twist) or not set(message.joint_names).issuperset(
                self._coordinates.with_orientation):
            raise CommandError('expected the twists of all of '
                               + ', '.join(self._coordinates.with_orientation))
        self._state, self._stamp = (position, velocity), message.header.stamp
        waiting, self._waiting = self._waiting, None
        return waiting if waiting is not None and waiting.header.stamp == self._stamp else None

    def complete(self, message):
        """Return whether the orientations of a JointState are there; if not, it waits."""
        if self._stamp == message.header.stamp:
            return True
        self._waiting = message
        return False

    def whole(self, position, velocity):
        """Return coordinates, shape (nq,), and rates, shape (nv,), of numbers by freedom."""
        q, qd = (values.copy() for values in self._state)
        single = self._coordinates.single
        q[self._coordinates.place[single]], qd[single] = position, velocity
        return q, qd


class TorqueSourceNode(ProgramNode):
    """
    Publish torques for the actuated joints of a simulator.

    ``exit_code``: None while the node wants to go on; ``joints``: empty until known;
    ``published``: commands so far; ``odd``: states whose stamps were far from the others;
    ``states``: subscription of modes with feedback.
    """

    NAME, PARAMETERS = 'closedloop_torque_source', TORQUE_SOURCE_PARAMETERS
    LOSES_NOTHING = True

    def __init__(self, **options):
        super().__init__(**options)
        self.published = self.odd = 0
        self._timeline = Timeline(AHEAD, BEHIND, SEVERAL)
        self.joints = ()
        self._complaint = Throttle()
        self._expected = self.values['wait_for_subscribers']
        self._answered = None
        # The last command, when the state that it answers was, and the states skipped since.
        self._sent, self._sent_for, self._skipped = None, None, 0
        self._skipped_at = None
        self._has_acted, self._points, self._action = False, None, None
        self._read_names = self._read_indices = None
        self._timer = self.simulation = self.law = self._orientations = None
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self.apply_parameters)
        joints = tuple(self.values['joints'])
        if self.values['mode'] in MODEL_MODES:
            self.simulation = self._load(joints)
            self._create_command(by_name=False)
            self._begin(self.simulation.actuated_joints)
        elif joints:
            self._create_command(by_name=True)
            self._begin(joints)
        else:
            self._check_without_joints()
            self._create_command(by_name=False)
            self._question = JointQuestion(self, self.values['simulator'])
            self._timer = self.every(QUESTION_PERIOD, self._request_joints)

    def on_waiting_states(self, message):
        """Answer the newest usable one of a state and those that wait behind it."""
        waiting, states = [message], self.states
        with states.handle:
            while taken := states.handle.take_message(states.msg_type, states.raw):
                waiting.append(taken[0])
        for state in reversed(waiting):
            if self.on_joint_states(state):
                return

    def on_joint_states(self, message):
        """Answer a state with a command, when all of it has come; return whether it is usable."""
        problem = self._read(message)
        if problem:
            if self._complaint.ready():
                self.get_logger().warning(f'joint_states not usable: {problem}')
            return False
        if self._orientations is not None and not self._orientations.complete(message):
            return True
        if not self._is_heard() or self._is_answered(message.header.stamp):
            return True
        state = [np.array(values)[self._read_indices]
                 for values in (message.position, message.velocity)]
        if self._orientations is not None:
            state = self._orientations.whole(*state)
        time_of_state, newest = stamp_of(message) * 1e-9, self._timeline.newest
        if not self._is_of_run(time_of_state):
            return False
        if self._is_on_its_way(time_of_state, message.effort):
            return True
        try:
            torque = self.law.torque(time_of_state, *state)
        except SimulationError as error:
            self._timeline.newest = newest
            if self._complaint.ready():
                self.get_logger().warning(f'joint_states not usable: {error}')
            return False
        self._publish(torque, message.header.stamp)
        self._answered = message.header.stamp, time.monotonic()
        self._sent, self._sent_for, self._skipped = torque, time_of_state, 0
        if self._action is not None:
            self._action.on_state(time_of_state, self.law.desired(time_of_state), np.array(
                [message.position, message.velocity])[:, self._driven_indices])
        if self._points is not None:
            self._begin_trajectory(time_of_state, *state)
        return True

    def on_orientations(self, message):
        """Store the orientations of a state; answer it if the rest of it waits for them."""
        try:
            waiting = self._orientations.accept(message)
        except CommandError as error:
            if self._complaint.ready():
                self.get_logger().warning(f'multi_dof_joint_states not usable: {error}')
            return
        if waiting is not None:
            self.on_joint_states(waiting)

    def _is_of_run(self, time_of_state):
        """Return whether a state follows those before, or begins another run."""
        newest, follows = self._timeline.newest, self._timeline.follows(time_of_state)
        if follows is False:
            self.odd += 1
            if self._complaint.ready():
                self.get_logger().warning(
                    f'joint_states: a stamp of {time_of_state:.9g} s is not used: the newest one '
                    f'is {newest:.9g} s')
            return False
        if follows is None:
            self.get_logger().warning(
                f'time has jumped from {newest:.9g} s to {time_of_state:.9g} s: starting again')
            self.law.restart()
            self._sent = None
        return True

    def _is_on_its_way(self, time_of_state, effort):
        """Return whether a state precedes the last command: too early to correct."""
        if self._sent is None or time_of_state <= self._sent_for or not effort:
            return False
        if np.array_equal(np.array(effort)[self._driven_indices], self._sent):
            self._has_acted = True
            return False
        # One that comes again is not followed by another.
        if self._skipped < MOST_SKIPPED and time_of_state != self._skipped_at:
            self._skipped += 1
            self._skipped_at = time_of_state
            return True
        if not self._has_acted:
            # A machine that waits for its first command has not begun to move.
            self.law.restart()
        return False

    def on_trajectory(self, message):
        """Follow a trajectory from the next state on, or refuse it."""
        try:
            self._points = points_of(message, self.joints)
        except TrajectoryError as error:
            self.get_logger().warning(f'joint_trajectory refused: {error}')
            return
        if self._action is not None:
            self._action.replaced()

    def _follow(self, points):
        """Follow points from the next state on."""
        self._points = points

    def _begin_trajectory(self, *state):
        points, self._points = self._points, None
        try:
            self.law.follow(points, *state)
        except TrajectoryError as error:
            self.get_logger().warning(f'joint_trajectory refused: {error}')
            if self._action is not None:
                self._action.refused(str(error))
            return
        if self._action is not None:
            self._action.begun(state[0])
        self.get_logger().info(
            f'following a trajectory of {len(points.times)} points in {points.times[-1]:.6g} s')

    def _is_heard(self):
        """Return whether all that are to hear the commands do."""
        if self._expected:
            count = self.publisher.get_subscription_count()
            if count < self._expected:
                if self._complaint.ready():
                    self.get_logger().info(
                        f'waiting for {self._expected} subscribers of '
                        f"'{self.publisher.topic_name}', there are {count} "
                        '(wait_for_subscribers)')
                return False
            # Once begun, it goes on whichever node leaves.
            self._expected = 0
        return True

    def _is_answered(self, stamp):
        """Return whether a state with this stamp was answered just now."""
        return self._answered is not None and self._answered[0] == stamp and (
            time.monotonic() - self._answered[1] < LOST)

    def close(self):
        """Log a summary."""
        self.get_logger().info(f'{self.published} commands published' + (
            f', {self.odd} stamps far from the others' if self.odd else ''))

    def _request_joints(self):
        """Begin as soon as the simulator has answered with its joints."""
        self._question.ask()
        if self._question.answer is None:
            if self._complaint.ready():
                self.get_logger().info(
                    f"waiting for node '{self.values['simulator']}' to report its joints")
            return
        self._timer.cancel()
        try:
            self._begin(self._question.answer)
        except StartError as error:
            self.get_logger().fatal(str(error))
            self.exit_code = 2

    def _begin(self, joints):
        """Set up the law and send its torques from now on."""
        self.law, self.joints = self._law_for(joints), joints
        if isinstance(self.command, JointState):
            self.command.name = list(joints)
        if self.values['mode'] in FEEDBACK_MODES:
            self._joints_read = joints
            if self.simulation is not None:
                coordinates = self.simulation.coordinates
                self._joints_read = tuple(coordinates.names[k] for k in coordinates.single)
                if len(coordinates.balls):
                    self._orientations = Orientations(self.simulation.mechanism)
                    self.create_subscription(
                        MultiDOFJointState, 'multi_dof_joint_states', self.on_orientations,
                        ORIENTATION_DEPTH)
            self.states = self.create_subscription(
                JointState, 'joint_states', self.on_waiting_states, STATE_DEPTH)
            if self.values['mode'] == 'computed_torque':
                self.create_subscription(
                    JointTrajectory, 'joint_trajectory', self.on_trajectory, QUEUE_DEPTH)
                self._action = self._create_action()
        else:
            self._epoch = None
            if self._timer is not None:
                self.destroy_timer(self._timer)
            self._timer = self.every(1.0 / self.values['rate'], self.on_timer)
        self.get_logger().info(f"mode {self.values['mode']}, driving {', '.join(joints)}")

    def _create_action(self):
        """Offer the action where the package control_msgs is installed."""
        if find_spec('control_msgs') is None:
            return None
        try:
            from closedloop_dynamics.ros.trajectory_action import TrajectoryAction
            return TrajectoryAction(self, self.joints, self._follow)
        except (ImportError, RuntimeError, UnsupportedTypeSupport) as error:
            self.get_logger().warning('the package control_msgs is installed, but does not work: '
                                      + ' '.join(str(error).split()))
            return None

    def _load(self, joints):
        """Return the model of modes that have one."""
        mode = self.values['mode']
        if not self.values['scene']:
            raise StartError(f"mode '{mode}' needs parameter 'scene'")
        if joints:
            raise StartError(f"mode '{mode}' drives all actuated joints of its scene: "
                             "leave parameter 'joints' out")
        simulation = load_simulation(self.values, self.get_logger())[0]
        driven = [cut.name for cut in simulation.mechanism.cut_joints if cut.actuated]
        if driven:
            raise StartError(f"mode '{mode}' leads joints of the tree, and not "
                             f"{driven[0]}, which closes a loop: take mode 'pd', or cut another "
                             'joint of that loop')
        return simulation

    def _create_command(self, by_name):
        if by_name:
            self.command = JointState()
            self.publisher = self.create_publisher(JointState, 'joint_command', QUEUE_DEPTH)
        else:
            self.command = Float64MultiArray()
            self.publisher = self.create_publisher(
                Float64MultiArray, 'torque_command', QUEUE_DEPTH)

    def _law_for(self, joints):
        if self.values['mode'] in FEEDBACK_MODES:
            return closed_loop(self.values, joints, self.simulation)
        return open_loop(self.values, joints)

    def _check_without_joints(self):
        """Refuse now any values that are wrong for every number of joints."""
        self._law_for(self._any_joints(self.values))

    def _any_joints(self, values):
        """Return the joints, or placeholders for as many values as given while unknown."""
        lists = [value for value in values.values() if isinstance(value, (list, array))]
        return self.joints or [f'joint {i + 1}' for i in range(max(map(len, lists)))]

    def _check_change(self, parameters):
        """Refuse values that do not fit the joints."""
        values = {**self.values, **{one.name: one.value for one in parameters}}
        try:
            if self.values['mode'] in FEEDBACK_MODES:
                gains(values, self._any_joints(values), self.simulation)
            else:
                open_loop(values, self._any_joints(values))
        except StartError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply_parameters(self, parameters):
        """Set other gains or torques."""
        self.values.update((one.name, one.value) for one in parameters)
        if self.law is None:
            return
        if self.values['mode'] in FEEDBACK_MODES:
            self.law.tune(*gains(self.values, self.joints, self.simulation))
        else:
            self.law = open_loop(self.values, self.joints)

    def on_timer(self):
        if not self._is_heard():
            return
        now = time.monotonic()
        if self._epoch is None:
            self._epoch = now
        self._publish(self.law(now - self._epoch))

    def _publish(self, torque, stamp=None):
        values = array('d', torque.tobytes())
        if isinstance(self.command, JointState):
            # An answer carries the stamp of the state that it answers.
            self.command.header.stamp = stamp or self.get_clock().now().to_msg()
            self.command.effort = values
        else:
            self.command.data = values
        self.publisher.publish(self.command)
        self.published += 1

    def _read(self, message):
        """Find the joints in a state; return the fault in it, or None."""
        if message.name != self._read_names:
            missing = [name for name in self._joints_read if name not in message.name]
            if missing:
                return f"it does not name '{missing[0]}'"
            self._read_names = list(message.name)
            self._read_indices = [self._read_names.index(name) for name in self._joints_read]
            self._driven_indices = [self._read_names.index(name) for name in self.joints]
        if not len(message.position) == len(message.velocity) == len(message.name):
            return 'it does not give position and velocity of every joint it names'
        if len(message.effort) not in (0, len(message.name)):
            return 'it gives efforts of some of the joints it names'
        if not all(map(isfinite, chain(message.position, message.velocity))):
            return 'a position or velocity is not a finite number'
        return None


main = TorqueSourceNode.main
