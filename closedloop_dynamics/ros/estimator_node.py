# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The node ``closedloop_estimator``: the state of a machine and its loads, estimated beside it.

What sensors publish goes into an ``Estimator`` by the stamps of the messages; what it makes of
them is published with the stamp that it is for. Nothing that comes in ends the node.
"""

from collections import Counter
from functools import partial

from closedloop_dynamics.estimation.errors import EstimationError
from closedloop_dynamics.estimation.estimator import Estimator
from closedloop_dynamics.estimation.setup_file import COMMAND, EFFORT, read_setup, SetupError
from closedloop_dynamics.estimation.start_finder import StartFinder
from closedloop_dynamics.estimation.streams import (
    MESSAGES, STATES, StreamError, Streams, topics_of)
from closedloop_dynamics.estimation.unknowns import Wrench
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.recording.message_numbers import NANOSECONDS, stamp_of
from closedloop_dynamics.ros.bag import MessageTypes
from closedloop_dynamics.ros.commands import (
    CommandError, SERVICE_QOS, subscribe, TorqueCommand)
from closedloop_dynamics.ros.diagnostics import ERROR, Finding, OK, WARN
from closedloop_dynamics.ros.loading import load_simulation
from closedloop_dynamics.ros.markers import MARKER_PARAMETERS, Markers
from closedloop_dynamics.ros.messages import (
    DEVIATIONS, joint_state, SerializedTemplate, STATE_QOS, StatePublisher, wrench_stamped)
from closedloop_dynamics.ros.node import CountingNode
from closedloop_dynamics.ros.pacing import LOCKSTEP, REALTIME
from closedloop_dynamics.ros.parameters import ALLOW_CODE, declare, Parameter
from closedloop_dynamics.ros.process import leaving_at_once, StartError
from closedloop_dynamics.ros.timeline import Timeline
from closedloop_dynamics.simulation.model import Model
from geometry_msgs.msg import WrenchStamped
import numpy as np
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import MultiArrayDimension
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger

# As many measurements may wait while this process is held up. In lockstep the machine may be
# faster than this node, and does not wait for it.
DEPTH, LOCKSTEP_DEPTH = 1000, 10000
# Without a measurement for longer, estimates go on by the model [s].
SILENCE = 0.05
# Time since the newest stamp that a stamp may be ahead, and behind [s]; stamps far from the others
# that make a jump in time.
AHEAD, BEHIND, SEVERAL = 1.0, 0.2, 5
# A run begins again where so many readings in a row do not fit, of all sensors or of more than one
# (one alone may be wrong), and where more states in a row are lost: torques meanwhile are unknown.
HOPELESS, MOST_LOST = 50, 5
# Links of its markers: how much of them is seen.
PALE = 0.35
# Before the names of sensors, of parameters.
TOPICS = 'topics.'
# Where the components of a load are in the numbers of a wrench, force first.
WRENCH = 'x', 'y', 'z', 'torque_x', 'torque_y', 'torque_z'
PARTS = {**{name: place for place, name in enumerate(WRENCH)}, 'torque': 5}
USED, NOT_USABLE, ODD, LOST, RESTARTS = (
    'messages used', 'not usable', 'stamps far from the others', 'lost on the way', 'starts')

ESTIMATOR_PARAMETERS = (
    Parameter('scene', '', 'The machine as far as it is known: a shipped scene by name, or a file '
              'of a scene or a model. Its initial position is on the branch that is followed.'),
    ALLOW_CODE,
    Parameter('sensors', '', 'File of sensors, unknowns and noise (doc/estimation.md).'),
    Parameter('mode', REALTIME, 'realtime: estimates are published at publish_rate, and go on by '
              'the model while sensors are silent. lockstep: one for each message on '
              'joint_states, the same every time.', choices=(REALTIME, LOCKSTEP)),
    Parameter('publish_rate', 100.0, 'Estimates published per second, in the mode realtime [Hz].',
              (0.1, 2000.0)),
)


def topic_parameters(setup):
    """Return a parameter for each sensor: the topic of its messages."""
    topics = topics_of(setup)
    return tuple(Parameter(
        f'{TOPICS}{one.name}', topics[one.name],
        f"Topic of the messages of the sensor '{one.name}', {MESSAGES[type(one)]}.")
        for one in setup.sensors)


class _Pale:
    """A simulation that markers show, with the forces that are estimated."""

    def __init__(self, simulation):
        self.simulation, self.constraint_forces = simulation, simulation.constraint_forces

    def __getattr__(self, name):
        return getattr(self.simulation, name)


class EstimatorNode(CountingNode):
    """
    Estimate state, joint forces and loads of a machine from what its sensors publish.

    ``exit_code``: None while the node wants to go on; ``estimator``: None until a run has begun;
    ``counts``: of messages, and of starts; ``states``, ``send_unknowns``, ``loads``, ``markers``:
    what publishes estimates, loads by name with their components, places, publisher, message and
    a function that publishes the covariance.
    """

    NAME, PARAMETERS = 'closedloop_estimator', ESTIMATOR_PARAMETERS
    FURTHER = MARKER_PARAMETERS
    KINDS = USED, NOT_USABLE, ODD, LOST, RESTARTS
    LOSES_NOTHING = True

    def __init__(self, **options):
        super().__init__(**options)
        self.estimator, values = None, self.values
        for name in ('scene', 'sensors'):
            if not values[name]:
                raise StartError(f'parameter {name!r}: expected '
                                 f'{"a scene or a model" if name == "scene" else "a file"}, got '
                                 'none')
        self.simulation = simulation = load_simulation(values, self.get_logger())[0]
        try:
            self._setup = setup = read_setup(values['sensors'], simulation.scene)
        except SetupError as error:
            raise StartError(f"parameter 'sensors': {error}") from None
        for name, topic in declare(self, topic_parameters(setup)).items():
            setup.topics[name.removeprefix(TOPICS)] = topic
        try:
            self._streams = Streams(setup, simulation.mechanism)
        except FieldError as error:
            raise StartError(f'parameter {error}') from None
        self._model = Model(simulation.scene)
        self._timeline = Timeline(AHEAD, BEHIND, SEVERAL)
        self.paused, self._fresh, self._heard = False, False, None
        # Everything is compiled before anything comes.
        self._new = self._build()
        self._restart()
        self._create_outputs()
        self._create_inputs()
        if values['mode'] == REALTIME:
            self.every(1.0 / values['publish_rate'], self.tick)
        self.get_logger().info(
            f"estimating '{simulation.scene.name}' from "
            f'{", ".join(sensor.name for sensor in setup.sensors)}; unknown: '
            f'{", ".join(one.name for one in setup.unknowns) or "the motion alone"}')

    def _build(self):
        setup = self._setup
        try:
            with leaving_at_once():
                estimator = Estimator(self._model, setup.sensors, setup.unknowns, setup.noise,
                                      setup.start, setup.method, suspects=setup.suspects,
                                      gate=setup.gate)
                estimator.estimate()
                return estimator
        except (ValueError, EstimationError, SimulationError) as error:
            raise StartError(f'{self.values["sensors"]}: {error}') from None

    def _create_outputs(self):
        """Create publishers, with messages as large as they will be."""
        simulation, mechanism = self.simulation, self.simulation.mechanism
        names, cuts = self._new.estimate().joint_forces.names, {
            cut.name for cut in simulation.mechanism.cut_joints}
        wrenches = [f'{"constraint" if name in cuts else "joint"}_forces/{name}' for name in names]
        self._shown_forces = [
            names.index(cut.name) for cut in mechanism.cut_joints] if names else None
        self.states = StatePublisher(
            self, simulation.coordinates, wrenches, ['world'] * len(wrenches),
            mechanism.cut_coordinates, prefix='estimated_')
        single = simulation.coordinates.single_names
        self._deviations = (self.create_publisher(JointState, DEVIATIONS, STATE_QOS),
                            SerializedTemplate(partial(joint_state, list(single)),
                                               3 * [len(single)]))
        self.loads = {}
        for one in self._setup.unknowns:
            if isinstance(one, Wrench):
                topic = f'estimated_loads/{one.name}'
                places = [PARTS[name.removeprefix(f'{one.name}.')] for name in one.components]
                self.loads[one.name] = (
                    one.components, places, self.create_publisher(WrenchStamped, topic, STATE_QOS),
                    SerializedTemplate(partial(wrench_stamped, one.body if one.axes == 'body' else
                                               'world'), (6,)),
                    self._labelled(f'{topic}/covariance', [
                        f'{row}.{column}' for row in WRENCH for column in WRENCH]))
        self.send_unknowns = self._labelled('estimated_unknowns', [
            column for name in self._new.belief.names for column in (name, f'{name}.deviation')])
        self._pale = _Pale(simulation)
        self.markers = Markers(self, self._pale, self._summary)
        for marker, _ in self.markers.links:
            marker.color.a = PALE

    def _labelled(self, topic, columns):
        """Return a function that publishes a stamp and numbers, whose names are in the message."""
        columns = ['stamp_sec', 'stamp_nanosec', *columns]
        publisher = self.create_publisher(Float64MultiArray, topic, STATE_QOS)
        message = Float64MultiArray()
        message.layout.dim = [MultiArrayDimension(
            label=' '.join(columns), size=len(columns), stride=len(columns))]

        def publish(stamp, values):
            message.data = [*map(float, divmod(stamp, NANOSECONDS)), *values]
            publisher.publish(message)
        return publish

    def _create_inputs(self):
        """Subscribe to what is measured and commanded, and offer the services."""
        types, lockstep = MessageTypes(), self.values['mode'] == LOCKSTEP
        # Best effort takes measurements from publishers of both kinds.
        qos = (QoSProfile(depth=LOCKSTEP_DEPTH, reliability=ReliabilityPolicy.RELIABLE) if lockstep
               else QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT))
        for topic, kind in self._streams.topics.items():
            subscribe(self, types.message_class(kind), topic, partial(self.on_measurement, topic),
                      qos, partial(self.on_lost, topic))
        if self._setup.torques == COMMAND:
            self.create_subscription(
                Float64MultiArray, 'torque_command', self.on_torque_command, qos)
            self.create_subscription(JointState, 'joint_command', self.on_joint_command, qos)
        for kind, service, answer in ((SetBool, '~/pause', self.on_pause),
                                      (Trigger, '~/reset', self.on_reset)):
            self.create_service(kind, service, answer, qos_profile=SERVICE_QOS)

    # What comes in.

    def _restart(self):
        """Forget the run; the next measurements begin another one."""
        simulation = self.simulation
        self.estimator, self._origin, self._newest, self._gated = (
            None, None, None, Counter())
        self._begun = None
        self._start_finder = StartFinder(self._setup, self._model)
        self._streams.begin(zip(simulation.joint_names, simulation.coordinates.by_freedom(
            np.array(simulation.scene.initial.position))))
        self._torque = dict.fromkeys(self._new.commanded, 0.0)
        self.command = TorqueCommand(
            (*simulation.joint_names, *simulation.cut_joint_names), self._new.commanded)

    def on_measurement(self, topic, message):
        """Take what a message measures; count it, or the reason why it is of no use."""
        if self.paused:
            return
        stamp = stamp_of(message)
        # Before anything is changed by it.
        try:
            readings = self._streams.readings(topic, message)
            torques = self._streams.torques(message) if topic == STATES else {}
        except StreamError as error:
            self.complain(NOT_USABLE, f'{topic} not usable: {error}')
            return
        if not readings and not torques and topic in self._streams.sensors:
            # It measures nothing: its stamp is not that of a reading.
            return
        follows = self._timeline.follows(1e-9 * stamp)
        if follows is False:
            self.complain(ODD, f'{topic}: a stamp of {1e-9 * stamp:.3f} s is not used: the '
                               f'newest one is {self._timeline.newest:.3f} s')
            return
        if follows is None:
            self.get_logger().warning(f'time has jumped to {1e-9 * stamp:.3f} s: starting again')
            self._restart()
        found = self._streams.taken(topic, stamp, readings)
        if self._origin is None:
            self._origin = stamp
        time = 1e-9 * (stamp - self._origin)
        newest = time if self._newest is None else self._newest
        if self._setup.torques == EFFORT and torques and time >= newest:
            # What was exerted since the state before.
            self._push(torques, newest)
        if found:
            self._take(time, dict(found))
        # Unless the run was lost with it.
        if topic == STATES and self._origin is not None:
            self._newest = max(time, newest)
            if self.values['mode'] == LOCKSTEP and found:
                self.publish(self._newest)

    def on_lost(self, topic, number):
        """Count messages that were lost."""
        self.complain(LOST, f'{topic}: {number} messages were lost on the way, or came faster '
                            'than they could be taken in', number)
        if topic == STATES and number > MOST_LOST:
            self._restart()

    def on_torque_command(self, message):
        """Have one value per actuated joint, from the newest state on."""
        self._on_command('torque_command', self.command.accept_values, message.data)

    def on_joint_command(self, message):
        """Have efforts by joint name, from the newest state on."""
        self._on_command('joint_command', self.command.accept_named, message.name, message.effort)

    def _on_command(self, topic, accept, *content):
        if self.paused:
            return
        try:
            accept(*content, 0.0)
        except CommandError as error:
            self.complain(NOT_USABLE, f'{topic} not usable: {error}')
            return
        self._push(dict(zip(self.command.actuated_joints, self.command.torque.tolist())),
                   self._newest or 0.0)

    def _push(self, torques, time):
        """Have torques from a time on."""
        before = dict(self._torque)
        self._torque.update({name: value for name, value in torques.items() if name in before})
        if self.estimator is not None and self._torque != before:
            if self._begun is not None:
                time, self._begun = self._begun, None
            time = max(time, self.estimator.time - BEHIND)
            self._guarded(lambda: self.estimator.command(time, self._torque))

    def _take(self, time, readings):
        """Take readings, or begin a run with them."""
        def take():
            if self.estimator is not None:
                found = self.estimator.measure_all(time, readings)
                for one in found:
                    self._gated[one.sensor] += 1
                    if one.accepted:
                        del self._gated[one.sensor]
                hopeless = [name for name, count in self._gated.items() if count >= HOPELESS]
                if len(hopeless) >= min(2, len(self._setup.sensors)):
                    raise EstimationError(
                        f'{", ".join(hopeless)}: the last {HOPELESS} readings do not fit; did the '
                        'machine, or its clock, stand still? Is the scene, or the noise of the '
                        'sensors, wrong?')
                return
            start = self._start_finder.take(time, readings)
            if start is not None:
                self._new.restart(start)
                self.estimator = self._new
                self.estimator.command(start.time, self._torque)
                # A machine that is held begins to move with the first torques, not without any.
                self._begun = None if any(self._torque.values()) else start.time
                self.counts[RESTARTS] += 1
        if self._guarded(take):
            self.counts[USED] += 1
            self._fresh, self._heard = True, (time, self.seconds())

    def _guarded(self, action):
        """Return whether something was done; begin again where the estimator is lost."""
        try:
            action()
            return True
        except ValueError as error:
            self.complain(NOT_USABLE, str(error))
        except (EstimationError, SimulationError, np.linalg.LinAlgError) as error:
            self.complain(NOT_USABLE, f'lost, starting again: {error}')
            self._restart()
        return False

    def on_pause(self, request, response):
        """Pause: measurements are not used; or begin again with the next ones."""
        if self.paused and not request.data:
            self._restart()
        self.paused, response.success = request.data, True
        response.message = 'paused' if self.paused else 'not paused'
        return response

    def on_reset(self, request, response):
        """Begin again with the next measurements."""
        self._restart()
        response.success, response.message = True, 'starting again with the next measurements'
        return response

    # What goes out.

    def seconds(self):
        """Return the time of the node's clock [s]."""
        return 1e-9 * self.get_clock().now().nanoseconds

    def tick(self):
        """Publish what is new, or what the model says while nothing is measured."""
        if self.paused or self.estimator is None or self._heard is None:
            return
        heard, clock = self._heard
        silence = self.seconds() - clock
        if not self._fresh and not SILENCE < silence < AHEAD:
            return
        self.publish(heard if self._fresh else heard + silence)

    def publish(self, time):
        """Publish what is estimated for a time, or for the newest one that is known."""
        estimates = []

        def estimate():
            self.estimator.advance(time)
            estimates.append(self.estimator.estimate())

        if self.estimator is None or not self._guarded(estimate):
            return
        found, = estimates
        self._fresh = False
        simulation, coordinates = self.simulation, self.simulation.coordinates
        stamp = self._origin + round(found.time * NANOSECONDS)
        nq, nv = coordinates.nq, coordinates.nv
        simulation.data.integrated[:nq] = found.state.q
        simulation.data.integrated[nq:nq + nv] = found.state.qd
        effort = np.zeros(nv)
        for name, value in self._torque.items():
            effort[coordinates.index[name]] = value
        forces = found.joint_forces.value
        if self._shown_forces is not None:
            self._pale.constraint_forces = forces[self._shown_forces]
        cuts = (*simulation.data.cut_state, np.zeros(len(simulation.cut_joint_names))) if (
            simulation.cut_joint_names) else ()
        publisher, template = self._deviations
        single = coordinates.single
        publisher.publish(template.filled(
            *divmod(stamp, NANOSECONDS), found.positions.deviation[single],
            found.rates.deviation[single], np.zeros(len(single))))
        self._publish_unknowns(stamp, found.unknowns)
        self.states.publish(stamp, found.state.q, found.state.qd, effort, forces, cuts)
        self.markers.on_state(self.states.stamp)

    def _publish_unknowns(self, stamp, unknowns):
        self.send_unknowns(
            stamp, np.ravel([unknowns.value, unknowns.deviation], order='F').tolist())
        for names, places, publisher, template, publish in self.loads.values():
            own = [unknowns.names.index(name) for name in names]
            wrench, covariance = np.zeros(6), np.zeros((6, 6))
            wrench[places] = unknowns.value[own]
            covariance[np.ix_(places, places)] = unknowns.covariance[np.ix_(own, own)]
            publisher.publish(template.filled(*divmod(stamp, NANOSECONDS), wrench))
            publish(stamp, covariance.ravel().tolist())

    def _summary(self):
        """Return what is unknown, in a few lines for the markers."""
        found = self.estimator.belief.unknowns
        return '\n'.join(f'{name} {value:.4g} +- {2.0 * deviation:.2g}' for name, value, deviation
                         in zip(found.names, found.value, found.deviation))

    def findings(self, news):
        """Judge whether measurements come, and whether the model explains them."""
        found = {'measurements': measurements_finding(
            news, self.reason, 'paused' if self.paused else '' if self.estimator else
            'waiting for measurements')}
        if self.estimator is not None:
            found['sensors'] = sensors_finding(self.estimator.consistency)
            found['model'] = model_finding(self.estimator.alarms, self.estimator.belief.unknowns)
        return found


def measurements_finding(news, reason, standing):
    """Judge what came in the last period: ``news``, counts; ``standing``: why nothing runs."""
    if news[ODD] or news[NOT_USABLE] or news[LOST]:
        return Finding(WARN, reason)
    if news[RESTARTS] and not standing:
        return Finding(WARN, 'a run has begun in the last second')
    if standing or not news[USED]:
        return Finding(WARN, standing or 'no measurements came in the last second')
    return Finding(OK, 'measurements are used')


def sensors_finding(consistency):
    """Judge how the sensors have fared."""
    values = {}
    for name, one in consistency.sensors.items():
        values.update({f'{name}: {key}': getattr(one, key) for key in (
            'accepted', 'gated', 'late', 'refused')})
        values[f'{name}: mean NIS per number'] = one.nis
    wrong = [name for name, one in consistency.sensors.items() if not one.consistent]
    if consistency.silent:
        return Finding(WARN, f'silent: {", ".join(consistency.silent)}', values)
    if wrong:
        return Finding(WARN, f'{", ".join(wrong)}: innovations are not as large as expected (mean '
                             'NIS far from 1): noise, or the model, is another', values)
    return Finding(OK, 'readings are as expected', values)


def model_finding(alarms, unknowns):
    """Judge whether the model explains the measurements, and list what is unknown."""
    values = {}
    for name, value, deviation in zip(unknowns.names, unknowns.value, unknowns.deviation):
        values.update({name: float(value), f'{name}, standard deviation': float(deviation)})
    if alarms:
        return Finding(ERROR, '; '.join(alarm.message for alarm in alarms), values)
    return Finding(OK, 'the model explains the measurements', values)


main = EstimatorNode.main
