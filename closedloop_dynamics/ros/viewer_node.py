# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The node ``closedloop_viewer``: running simulators in a browser, through their topics."""

from collections import defaultdict
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
import math
import time

from closedloop_dynamics.effects.actuator import Actuator
from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.kinematics.modeling import extent
from closedloop_dynamics.mechanism.checks import number, one_of
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.mechanism.fields import at, FieldError
from closedloop_dynamics.mechanism.kinematics import body_poses, body_velocities, poses_in_space
from closedloop_dynamics.mechanism.rotations import of_quaternion
from closedloop_dynamics.recording.message_numbers import (
    constraint_force, pose_numbers, stamp_of, twist_numbers)
from closedloop_dynamics.ros.commands import SERVICE_QOS
from closedloop_dynamics.ros.loading import allow_code
from closedloop_dynamics.ros.messages import (
    DEVIATIONS, ESTIMATED, ESTIMATED_TURNS, LATCHED_QOS)
from closedloop_dynamics.ros.node import ProgramNode
from closedloop_dynamics.ros.parameters import ALLOW_CODE, Parameter
from closedloop_dynamics.ros.simulator_parameters import METHOD
from closedloop_dynamics.scene.loading import SceneError
from closedloop_dynamics.scene.text import read_scene_text
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.view.columns import motion_columns, motion_rows, motion_thinning_values
from closedloop_dynamics.view.description import (
    CHOICES, describe, described_drive, EARTH, grabs)
from closedloop_dynamics.view.driving import round_up
from closedloop_dynamics.view.feed import Feed
from closedloop_dynamics.view.hand import Hand
from closedloop_dynamics.view.messages import (
    describe_drives, describe_effects, drive_of, FREE, HELD, POSITION, require_one_number, TORQUE)
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.posing import felt_inertia, felt_mass
from closedloop_dynamics.view.server import Server
from closedloop_dynamics.view.shown import Shown
from closedloop_dynamics.view.stepping import SAMPLING_SHARE
from closedloop_dynamics.visual.trajectory import Trajectory
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, MultiDOFJointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

# Frames per second; time between two looks for simulators; how long one may be silent before it is
# said [s].
RATE, POLL_PERIOD, SILENCE = 60.0, 0.25, 3.0
# Where all simulators are shown: how long to search for more after the first [s].
GATHERING = 2.0
# Placeholder for the topic of wrenches.
WRENCHES = 'wrenches'
SHOWN = 'scene', 'joint_states', 'multi_dof_joint_states'
# The newest state is enough; it must not be lost, for a machine at rest publishes it once.
QOS = QoSProfile(depth=1)
# A position drive moves its joint like a critically damped spring of this rate at most [1/s], of
# less where states come rarely: so many times per second over the states per second. It answers
# states that are a period or two old. What weight takes away, its integral gives back.
DRIVE_RATE, DRIVE_SHARE, INTEGRAL = 50.0, 0.1, 0.3
# Modes of a drive; others would need the time between two states.
MODES = TORQUE, POSITION
# The period is the longest of so many.
PERIODS = 9
# So does the spring that a hand pulls with, for the mass that the point feels, which is updated
# so often in simulated time [s]. In shares of the machine's size: how far it stretches at most,
# and how far the point may move in a period before it is released.
HAND_RATE, HAND_SHARE, FEEL_PERIOD, STRETCH, SWING = 30.0, 0.12, 0.02, 0.2, 0.25
VIEWER_PARAMETERS = (
    Parameter('nodes', [''], 'Full names of the simulators to show. Not given: all that are '
                             'found.'),
    Parameter('estimator', '', 'Full name of a closedloop_estimator whose estimates are shown '
                               'with the simulators, pale, with bands; not given: none.'),
    Parameter('host', '127.0.0.1', 'Address to listen on; any but that of this host needs the '
                                   'token in the address that is printed.'),
    Parameter('port', 0, 'To listen on; 0: any that is free.', (0, 65535)),
    ALLOW_CODE,
)


class RemoteSimulator(Shown):
    """
    One simulator that is shown, by its full name, through subscriptions of ``node``.

    ``topics`` are its topics by their last names: ``scene``, ``joint_states``,
    ``constraint_forces/CUT``, ``multi_dof_joint_states``; ``WRENCHES`` is the one on which it
    takes wrenches, whatever it is called. ``estimator``: topics of an estimator in the same way;
    empty: there is none. ``feed`` is None until the scene is known.
    """

    def __init__(self, node, name, topics, estimator):
        super().__init__()
        self.name, self._estimator = name, estimator
        self._topics, self._logger = topics, node.get_logger()
        self._subscribe, self._publish = node.create_subscription, node.create_publisher
        self._heard = time.monotonic()
        self._time, self._fresh, self._start = 0.0, False, None
        # When a state between frames was sampled, and how long that took [s].
        self._sampled_at, self._sample_time = -math.inf, 0.0
        self._playing, self._speed = True, 1.0
        self._busy = None
        # Target of the held point.
        self._at = None
        self._model, self._passed = None, deque(maxlen=PERIODS)
        self._subscriptions = [
            self._subscribe(String, topics['scene'], self._on_scene, LATCHED_QOS)]
        prefix = name.rstrip('/')
        self._pause, *triggers, self._set = (
            node.create_client(kind, f'{prefix}/{what}', qos_profile=SERVICE_QOS)
            for kind, what in ((SetBool, 'pause'), (Trigger, 'reset'), (Trigger, 'step'),
                               (SetParametersAtomically, 'set_parameters_atomically')))
        self._triggers = dict(zip(('reset', 'step'), triggers))
        # A publisher from the first command on: a page that only looks is no source of commands.
        # What is published before the simulator has found it is lost: commands are repeated until
        # a state shows torques of theirs.
        self._commands, self._commanded_at, self._followed = None, -math.inf, False
        self._wrenches = self._publish(WrenchStamped, topics[WRENCHES], 1) \
            if WRENCHES in topics else None
        self._states = self._publish(JointState, f'{prefix}/set_state', 10)

    def _on_scene(self, message):
        try:
            scene, _ = read_scene_text(message.data)
        except SceneError as error:
            self._logger.error(f'{self.name}: {error}')
            return
        if self.feed is None:
            self._describe(scene)
        self._scene = scene
        self._send_controls()

    def _describe(self, scene):
        """Subscribe to the topics of the scene, and describe it."""
        mechanism = scene.mechanism
        names = self._names = mechanism.coordinates
        self._mechanism = mechanism
        self._position = names.start()
        self._velocity, self._effort = np.zeros(names.nv), np.zeros(names.nv)
        self._forces = np.full((len(mechanism.cut_joints), 3 if mechanism.planar else 6), np.nan)
        # By actuated joint: drive mode, value, and the integral of a position drive.
        # Cut joints are driven by commands: the page shows the joints of the tree.
        self.drives = {name: [TORQUE, 0.0, 0.0] for name in mechanism.actuated_joints
                       if name in names.index}
        # Positions and velocities: of the simulator, then, unknown at first, of the estimator.
        self._estimate = [np.full(names.nq, np.nan), np.full(names.nv, np.nan)]
        self._deviation = [each.copy() for each in self._estimate]
        self._follow(JointState, self._topics, 'joint_states', self._on_state)
        for topics, topic, values in (
                (self._topics, 'multi_dof_joint_states', [self._position, self._velocity]),
                (self._estimator, ESTIMATED_TURNS, self._estimate)):
            self._follow(MultiDOFJointState, topics, topic, partial(self._on_turns, values))
        for topic, values in ((ESTIMATED, self._estimate), (DEVIATIONS, self._deviation)):
            self._follow(JointState, self._estimator, topic, partial(self._take, values))
        for k, cut in enumerate(mechanism.cut_joints):
            topic = self._topics.get(f'constraint_forces/{cut.name}')
            if topic is not None:
                self._subscriptions.append(self._subscribe(
                    WrenchStamped, topic, lambda message, k=k: self._on_force(k, message), QOS))
        place = self._topics['joint_states'].rpartition('/')[0]
        self._command_topic = f'{place}/joint_command'
        # Limits of drives would act on the pull, too.
        if any(isinstance(record, Actuator) for record in scene.effects.values()):
            self._wrenches = None
        gravity = next((name for name, record in scene.effects.items()
                        if isinstance(record, Gravity)), None)
        self._columns = motion_columns(mechanism, bool(self._estimator))
        self._begin_thinning(self._columns.plots, len(mechanism.points), extent(mechanism))
        described = describe(
            mechanism, self._columns, scene.effects, mode='node', title=self.name,
            drives=[self._drive_of(scene, name) for name in self.drives],
            hand=self._wrenches is not None, gravity=gravity, own=False,
            # Orientations have topics of their own.
            poses=not len(names.balls), **CHOICES)
        for text in described['missing']:
            self._logger.warning(f'{self.name}: {text}; drawn as lines')
        self.feed = Feed(described)

    def _drive_of(self, scene, name):
        """Describe a drive: its kind, and the ranges of its sliders."""
        names, mechanism = self._names, self._mechanism
        weight = EARTH * (sum(body.mass for body in mechanism.bodies) or 1.0)
        return described_drive(
            mechanism, name, np.array(scene.initial.position), round_up(weight * (
                2.0 if names.lengths[names.index[name]] else extent(mechanism))), MODES)

    # What the simulator and the estimator publish.

    def _follow(self, kind, topics, topic, take):
        if topic in topics:
            self._subscriptions.append(self._subscribe(kind, topics[topic], take, QOS))

    def _take(self, values, message):
        """Put what a JointState says of joints into arrays, of positions and of velocities."""
        position, velocity, *effort = values
        index = self._names.index
        for k, name in enumerate(message.name):
            if name in index:
                place = index[name]
                position[self._names.place[place]] = message.position[k]
                velocity[place] = message.velocity[k]
                for each in effort:
                    each[place] = message.effort[k]

    def _on_state(self, message):
        self._heard = time.monotonic()
        self._take((self._position, self._velocity, self._effort), message)
        if self._commands is not None and not self._followed:
            # At each state: another source of commands may take over at once.
            torques = self._torques
            self._followed = bool(torques) and all(
                self._effort[self._names.index[name]] == torque
                for name, torque in torques.items())
        stamp = 1e-9 * stamp_of(message)
        if self._start is None or stamp < self._start:
            self._start = stamp
        passed = stamp - self._start - self._time
        self._time, self._fresh = stamp - self._start, True
        self._sample_between()
        if passed > 0.0:
            self._passed.append(passed)
            if any(mode == POSITION for mode, *_ in self.drives.values()):
                self._command(passed)
            if self._pulling:
                self._tug()

    def _on_turns(self, arrays, message):
        known = self._names.with_orientation
        for values, places, given in zip(
                arrays, (self._names.pose, self._names.twist),
                (map(pose_numbers, message.transforms), map(twist_numbers, message.twist))):
            for name, numbers in zip(message.joint_names, given):
                if name in known:
                    where = places[known.index(name)]
                    values[where[where >= 0]] = np.array(numbers)[where >= 0]

    def _on_force(self, k, message):
        self._forces[k] = constraint_force(message.wrench, self._mechanism.planar)

    # What the pages see and ask for.

    def tick(self):
        """Show new states, and handle the requests of the pages."""
        if self.feed is None:
            return
        self._handle_requests()
        self._repeat_command()
        if self._fresh and self.feed.pages:
            self._fresh = False
            row, values = self._row()
            self._thin(self._time, row, values)
            self.feed.show(self._time, row)
            self._thinning.keep(self._time, values)
        self._send_controls()

    def _row(self):
        """Return the row of the present state, and its values for thinning."""
        def motion_of(*values):
            return Trajectory(self._mechanism, np.array([self._time]),
                              *(each[np.newaxis] for each in values))

        motion = motion_of(self._position, self._velocity, self._effort, self._forces)
        rows = motion_rows(motion, (
            motion_of(*self._estimate, self._effort, self._forces),
            *(each[np.newaxis] for each in self._deviation)) if self._estimator else None)
        return rows[0], motion_thinning_values(self._columns, motion, rows)[0]

    def _sample_between(self):
        """Sample a state between frames, within a fixed share of the time."""
        begin = time.monotonic()
        if not self.feed.pages or begin - self._sampled_at < self._sample_time / SAMPLING_SHARE:
            return
        self._thin(self._time, *self._row())
        self._sampled_at, self._sample_time = begin, time.monotonic() - begin

    def _send_controls(self):
        silent = time.monotonic() - self._heard > SILENCE
        self.feed.send_controls(
            playing=self._playing, speed=self._speed, kinematic=self._kinematic, findings=[],
            busy=self._busy, grabbed=self._grabbed,
            failure=f'{self.name} publishes no states.' if silent else None,
            motion=None, drives=describe_drives(self.drives),
            unused=list(self._scene.method.unused),
            method={key: getattr(self._scene.method, key) for key in METHOD},
            effects=describe_effects(
                self._scene.effects, lambda name: name not in self._scene.switched_off))

    def _do_play(self, page):
        self._end_grab()
        self._kinematic, self._playing = False, True
        self._call(self._pause, SetBool.Request(data=False))

    def _do_pause(self, page):
        self._playing = False
        self._call(self._pause, SetBool.Request(data=True))

    def _do_step(self, page, count):
        """Advance by so many steps while paused."""
        if self._playing:
            self._do_pause(None)
        self._change({'step_count': count}, lambda: self._call(
            self._triggers['step'], Trigger.Request()))

    def _do_reset(self, page):
        for drive in self.drives.values():
            drive[:] = TORQUE, 0.0, 0.0
        self._call(self._triggers['reset'], Trigger.Request())

    def _do_speed(self, page, factor):
        self._change({'real_time_factor': factor})
        self._speed = factor

    def _do_method(self, page, values):
        # Without a value the scene's own is meant, or none.
        self._change({key: 0.0 if value is None else value for key, value in values.items()})

    def _do_effect(self, page, name, enabled=None, values=None):
        changes = dict(values or {})
        if enabled is not None:
            changes['enabled'] = enabled
        self._change({f'effects.{name}.{key}': value for key, value in changes.items()})

    # Drives.

    def _do_drive(self, page, joint, mode):
        drive = drive_of(self.drives, joint)
        with at('mode'):
            one_of(MODES)(mode)
        require_one_number(self._names, joint, mode)
        if drive[0] != mode:
            if mode == POSITION:
                self._update_model()
            drive[:] = mode, 0.0 if mode == TORQUE else float(
                self._position[self._names.place[self._names.index[joint]]]), 0.0
            self._command()

    def _do_motion(self, page, which):
        with at('which'):
            one_of((HELD, FREE))(which)
        for joint, drive in self.drives.items():
            if which == HELD and self._names.place[self._names.index[joint]] >= 0:
                self._do_drive(page, joint, POSITION)
            else:
                drive[:] = TORQUE, 0.0, 0.0
        self._command()

    def _do_command(self, page, joint, value):
        with at('value'):
            drive_of(self.drives, joint)[1] = number(value)
        self._command()

    def _update_model(self):
        """Set a model of the machine to its present position; find the inertia at its drives."""
        if self._model is None:
            self._busy = 'preparing a model of the machine'
            self._send_controls()
            self._hand = Hand(self._scene, extent(self._mechanism))
            # Forces do not matter to it.
            self._model = Simulation(
                replace(self._hand.scene, effects={}, switched_off=()))
            self._busy = None
        self._model.set_state(self._position)
        felt = felt_inertia(self._model)[self._model.data.actuated_in_tree]
        self._felt = {name: float(inertia) if np.isfinite(inertia) else 1.0
                      for name, inertia in zip(self.drives, felt)}

    @property
    def _period(self):
        """Time between states [s], the longest recently: a quicker answer would oscillate."""
        # Stamps may be those of the clock, which simulated time outruns.
        return max(1.0, self._speed) * max(self._passed, default=1.0)

    def _command(self, passed=0.0):
        """Publish torques, ``passed`` seconds after the state before; of positions from this."""
        rate = min(DRIVE_RATE, DRIVE_SHARE / self._period)
        efforts = []
        for name, drive in self.drives.items():
            mode, value, integral = drive
            if mode == TORQUE:
                efforts.append(value)
                continue
            place, felt = self._names.index[name], self._felt[name]
            error = value - self._position[self._names.place[place]]
            drive[2] = integral + INTEGRAL * felt * rate ** 3 * error * passed
            efforts.append(drive[2] + felt * rate * (
                rate * error - 2.0 * self._velocity[place]))
        if self._commands is None:
            self._commands = self._publish(JointState, self._command_topic, 1)
        self._commands.publish(JointState(name=list(self.drives), effort=efforts))
        self._commanded_at = time.monotonic()

    @property
    def _torques(self):
        """Return the torques that pages ask for, by joint, but for zeros."""
        return {name: value for name, (mode, value, _) in self.drives.items()
                if mode == TORQUE and value}

    def _repeat_command(self):
        """Publish torques again that no state has shown yet."""
        if self._commands is not None and not self._followed and self._torques and (
                time.monotonic() - self._commanded_at > POLL_PERIOD):
            self._command()

    # Posing: by a model here, whose state the simulator is given.

    def _do_kinematic(self, page, on):
        if on and not self._kinematic:
            self._do_pause(None)
            self._update_model()
        self._end_grab()
        self._kinematic = on

    def _on_posed(self):
        """Have the simulator take over the pose of the model."""
        if not self._states.get_subscription_count():
            raise FieldError('a simulator that takes states', 'none yet', path=('pose',))
        places = self._names.place
        self._states.publish(JointState(
            name=[name for name, place in zip(self._names.names, places) if place >= 0],
            position=self._model.position[places[places >= 0]].tolist()))

    @property
    def _posed(self):
        return self._model

    # What is pulled, by a wrench.

    @property
    def _pulling(self):
        return self._grabbed is not None and not self._kinematic

    def _hand_is_there(self):
        if not self._kinematic:
            if self._wrenches is None:
                raise FieldError('kinematic mode, or a simulator that takes wrenches', 'neither')
            self._update_model()

    def _begin_grab(self, name, place):
        self._mass, self._felt_at = felt_mass(self._model, name), self._time
        self._pull(place)

    def _pull(self, place):
        self._at = place

    def _release(self):
        self._push(np.zeros(3))

    def _tug(self):
        """Pull like a critically damped spring on the mass that the point feels."""
        body, place = self._grabbed
        mechanism = self._mechanism
        names = (mechanism.bodies[body].name,)
        pose = poses_in_space(body_poses(mechanism, self._position, names)[0])
        turn = of_quaternion(pose[3:])
        arm = turn @ grabs(mechanism, mechanism.bodies[body])[place]
        twist = body_velocities(
            mechanism, self._position, self._velocity[np.newaxis], names)[0, 0]
        count = len(self._mass)
        now, velocity = pose[:3] + arm, twist[:3] + np.cross(twist[3:], arm)
        if not 0.0 <= self._time - self._felt_at < FEEL_PERIOD:
            self._felt_at = self._time
            with suppress(SimulationError):
                self._model.set_state(self._position)
                self._mass = felt_mass(self._model, self._hand.point(body, place))
        period, size = self._period, self._hand.size
        between = np.linalg.norm(velocity) * period
        if between > SWING * size:
            self._end_grab()
            self.feed.refuse(
                f'released: the point moves by {between:.2g} m from one state to the next, '
                'too far for a stable pull')
            return
        stretch = np.array(self._at) - now
        stretch *= min(1.0, STRETCH * size / max(np.linalg.norm(stretch), 1e-9))
        rate = min(HAND_RATE, HAND_SHARE / period)
        force = self._mass @ (rate * (rate * stretch - 2.0 * velocity))[:count]
        self._push(turn.T[:, :count] @ force)

    def _push(self, force):
        """Publish a force, along the axes of the body that is held, on its place [N]."""
        body, place = self._grabbed
        body = self._mechanism.bodies[body]
        message = WrenchStamped()
        message.header.frame_id = body.name
        for part, values in (
                (message.wrench.force, force),
                (message.wrench.torque, np.cross(grabs(self._mechanism, body)[place], force))):
            part.x, part.y, part.z = values.tolist()
        self._wrenches.publish(message)

    def _change(self, values, then=None):
        """Set parameters of the simulator; do something if it has taken them."""
        self._call(self._set, SetParametersAtomically.Request(parameters=[
            RosParameter(key, value=list(value) if isinstance(value, tuple) else value)
            .to_parameter_msg() if value is not None else ParameterMessage(name=key)
            for key, value in values.items()]), then)

    def _call(self, client, request, then=None):
        """Call a service, and notify the pages where it refuses or is not there."""
        if not client.service_is_ready():
            raise FieldError(f'the service {client.srv_name}', 'none: is the simulator running?')
        client.call_async(request).add_done_callback(
            lambda future: self._take_answer(future, then))

    def _take_answer(self, future, then):
        answer = future.result()
        answer = getattr(answer, 'result', answer)
        good = getattr(answer, 'successful', getattr(answer, 'success', True))
        if not good:
            self.feed.refuse(getattr(answer, 'reason', '') or getattr(answer, 'message', ''))
            # The request has not taken effect.
            self.feed.version += 1
        elif then is not None:
            then()


def _full_name(endpoint):
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


class ViewerNode(ProgramNode):
    """
    Show running simulators in a browser.

    ``exit_code``: None while the node wants to go on; ``server``: None until the simulators are
    known.
    """

    NAME, PARAMETERS = 'closedloop_viewer', VIEWER_PARAMETERS

    def __init__(self, **options):
        super().__init__(**options)
        self.server = None
        allow_code(self.values[ALLOW_CODE.name])
        self._wanted = list(map(self._full, self.values['nodes']))
        self._estimator = self.values['estimator'] and self._full(self.values['estimator'])
        self._offered, self._shown, self._first = {}, {}, None
        self._timer = self.every(POLL_PERIOD, self.poll_simulators)
        self.every(1.0 / RATE, self.tick)
        self.get_logger().info(
            f'looking for {", ".join(self._wanted) or "simulators"} ...')

    def _full(self, name):
        name = name.strip()
        return name if name.startswith('/') else f'{self.get_namespace().rstrip("/")}/{name}'

    def poll_simulators(self):
        """Search for simulators until all wanted ones are found; then serve pages."""
        before, self._offered = self._offered, self._offers()
        estimator = self._offered.get(self._estimator, {}) if self._estimator else {}
        if self._estimator and not ({ESTIMATED, DEVIATIONS} <= set(estimator)
                                    and estimator == before.get(self._estimator)):
            return
        for name, topics in self._offered.items():
            if name in self._shown or (self._wanted and name not in self._wanted):
                continue
            # Topics of a node are heard of one after the other: until there are no more.
            if {'scene', 'joint_states'} <= set(topics) and topics == before.get(name):
                self._shown[name] = RemoteSimulator(self, name, topics, estimator)
        known = [one for one in self._shown.values() if one.feed is not None]
        if self._wanted:
            ready = len(known) == len(self._wanted)
        else:
            if known and self._first is None:
                self._first = time.monotonic()
            ready = known and len(known) == len(self._shown) and (
                time.monotonic() - self._first > GATHERING)
        if ready:
            self._timer.cancel()
            self._serve(sorted(known, key=lambda one: one.name))

    def _offers(self):
        """
        Return the topics of all nodes, by full name and the last part of the topic's.

        It is the topics that are asked for their nodes: a node that has gone may go on being
        listed, and would then be taken for the one of the same name that runs.
        """
        offers = defaultdict(dict)
        for topic, kinds in self.get_topic_names_and_types():
            *_, parent, last = ('', *topic.split('/'))
            if parent == 'constraint_forces':
                last = f'{parent}/{last}'
            elif last not in (*SHOWN, ESTIMATED, ESTIMATED_TURNS, DEVIATIONS):
                last = None
            if last is not None:
                for one in self.get_publishers_info_by_topic(topic):
                    offers[_full_name(one)][last] = topic
            if 'geometry_msgs/msg/WrenchStamped' in kinds:
                for one in self.get_subscriptions_info_by_topic(topic):
                    offers[_full_name(one)][WRENCHES] = topic
        return offers

    def _serve(self, shown):
        names = [one.name for one in shown]
        pages = [live_page(name, names if len(names) > 1 else ()) for name in names]
        try:
            self.server = Server(pages, [one.feed for one in shown], self.values['host'],
                                 self.values['port'])
        except OSError as error:
            self.get_logger().fatal(f"port {self.values['port']}: {error}")
            self.exit_code = 1
            return
        self.get_logger().info(f'{", ".join(names)} at {self.server.url}')

    def tick(self):
        """Show new states."""
        for one in self._shown.values():
            one.tick()

    def close(self):
        """End the server."""
        if self.server is not None:
            self.server.close()


main = ViewerNode.main
