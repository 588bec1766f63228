# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The node ``closedloop_joint_states``: all joints of a mechanism from those that a robot measures.

A robot with loops measures its drives; RViz and planners want every joint. Positions and rates
that close the loops are found for each message, and published with its stamp.
"""

from closedloop_dynamics.control.controller import per_joint
from closedloop_dynamics.effects.end_stop import stops_of
from closedloop_dynamics.kinematics.passive_joint_solver import (
    PassiveJointError, PassiveJointSolver)
from closedloop_dynamics.recording.message_numbers import stamp_of
from closedloop_dynamics.recording.run import moving_joints
from closedloop_dynamics.ros.diagnostics import ERROR, Finding, OK, WARN
from closedloop_dynamics.ros.loading import load_simulation
from closedloop_dynamics.ros.messages import LATCHED_QOS, StatePublisher
from closedloop_dynamics.ros.node import CountingNode
from closedloop_dynamics.ros.parameters import ALLOW_CODE, Parameter
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.visual.urdf import urdf
import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

# Only the newest measurement is worth an answer.
MEASURED_QOS = QoSProfile(depth=1)
# Sine of the angle to a singular position below which a pose is worth a warning.
SINGULAR = 0.02
COMPLETED, NOT_USABLE, NOT_CLOSED = 'completed', 'not usable', 'not closed'

JOINT_STATES_PARAMETERS = (
    Parameter('scene', '', 'The mechanism: a shipped scene by name, or a file of a scene or a '
              'model. Its initial position is on the branch that is followed.'),
    ALLOW_CODE,
    Parameter('joints', [''], 'Measured joints of the tree. Not given: the actuated ones.'),
    Parameter('deviations', [1.0], 'Standard deviation of each measured position [rad or m]: one '
              'value for all joints, or one per joint. They matter where more joints are measured '
              'than there are degrees of freedom.'),
    Parameter('tolerance', 1e-3, 'Measured joints that are further away from what closes the '
              'loops are reported [rad or m].', (0.0, 10.0)),
    Parameter('forces', False, 'Publish the forces in all joints, from measured efforts and the '
              'model.'),
    Parameter('effort_factors', [1.0], 'Torque or force of a joint per unit of its effort in '
              'joint_states, where that is a current [N m/A or N/A]: torque constant times gear '
              'ratio and efficiency. One value for all joints, or one per joint.'),
)


class JointStatesNode(CountingNode):
    """
    Publish all joints of a mechanism, passive and cut ones included, from measured ones.

    ``exit_code``: None while the node wants to go on; ``counts``: messages completed, not usable,
    and those whose positions close no loops.
    """

    NAME, PARAMETERS = 'closedloop_joint_states', JOINT_STATES_PARAMETERS
    KINDS = COMPLETED, NOT_USABLE, NOT_CLOSED
    LOSES_NOTHING = True

    def __init__(self, **options):
        super().__init__(**options)
        values = self.values
        if not values['scene']:
            raise StartError("parameter 'scene': expected a scene or a model, got none")
        self.simulation = simulation = load_simulation(values, self.get_logger())[0]
        self.completion = self._build_completion()
        self._factors = np.array(per_joint(
            'effort_factors', values['effort_factors'], self.completion.measured))
        self._index = [simulation.joint_names.index(name) for name in self.completion.measured]
        self._names, self._places = None, None
        self._moving = moving_joints(simulation)
        wrenches = [f'constraint_forces/{cut.name}' for cut in simulation.mechanism.cut_joints] + [
            f'joint_forces/{simulation.mechanism.joints[place].name}' for place in self._moving]
        if not values['forces']:
            wrenches = []
        self.states = StatePublisher(
            self, simulation.coordinates, wrenches, ['world'] * len(wrenches),
            simulation.mechanism.cut_coordinates, prefix='complete_')
        self._no_forces = np.zeros((0, 3 if simulation.mechanism.planar else 6))
        self._description = self.create_publisher(String, 'robot_description', LATCHED_QOS)
        self._description.publish(String(data=urdf(
            simulation.mechanism, limits=stops_of(simulation.effects))))
        self.create_subscription(
            JointState, 'joint_states', self.on_joint_states, MEASURED_QOS)
        self.get_logger().info(
            f"completing joint states of '{simulation.scene.name}' measured at "
            f'{", ".join(self.completion.measured)}')

    def _build_completion(self):
        values, simulation = self.values, self.simulation
        joints = values['joints'] or [
            name for name in simulation.actuated_joints if name in simulation.joint_names]
        deviations = values['deviations'] * (
            len(joints) if len(values['deviations']) == 1 else 1)
        try:
            with np.errstate(divide='ignore'):
                weights = 1.0 / np.square(deviations)
            return PassiveJointSolver(simulation.mechanism, joints, simulation.position, weights)
        except ValueError as error:
            raise StartError(str(error)) from None

    def on_joint_states(self, message):
        """Complete a measurement and publish it; or publish nothing and log the reason."""
        problem = self._read(message)
        if problem:
            self.complain(NOT_USABLE, f'joint_states not usable: {problem}')
            return
        places, velocity = self._places, None
        if len(message.velocity):
            velocity = np.array(message.velocity)[places]
        try:
            self.completion.complete(np.array(message.position)[places], velocity)
        except PassiveJointError as error:
            self.complain(NOT_CLOSED, f'joint_states not completed: {error}')
            return
        except ValueError as error:
            self.complain(NOT_USABLE, f'joint_states not usable: {error}')
            return
        self._publish(message)
        self.counts[COMPLETED] += 1
        # Off the way from a measurement to its answer.
        self.completion.get_ready()

    def _read(self, message):
        """Find the measured joints in a message; return the fault in it, or ''."""
        if message.name != self._names:
            missing = [name for name in self.completion.measured if name not in message.name]
            if missing:
                return f"it does not name '{missing[0]}'"
            self._names = list(message.name)
            self._places = [self._names.index(name) for name in self.completion.measured]
        if len(message.position) != len(message.name) or len(message.velocity) not in (
                0, len(message.name)) or len(message.effort) not in (0, len(message.name)):
            return 'it does not give a position, and velocities and efforts or none, for each name'
        if self.values['forces'] and not (len(message.effort) and np.isfinite(
                np.array(message.effort)[self._places]).all()):
            return 'it does not give the efforts that forces (parameter forces) follow from'
        return ''

    def _publish(self, message):
        simulation, completion = self.simulation, self.completion
        nq = len(completion.position)
        simulation.data.integrated[:nq] = completion.position
        simulation.data.integrated[nq:nq + len(completion.velocity)] = completion.velocity
        effort, forces = np.zeros(len(completion.velocity)), self._no_forces
        if len(message.effort):
            effort[self._index] = self._factors * np.array(message.effort)[self._places]
        if self.values['forces']:
            tau = np.zeros(len(simulation.torque_names))
            tau[:len(effort)] = effort
            simulation.advance(tau, 0)
            forces = np.concatenate([
                simulation.constraint_forces, simulation.data.joint_forces[self._moving]])
        cuts = (*simulation.data.cut_state, np.zeros(len(simulation.cut_joint_names))) if (
            simulation.cut_joint_names) else ()
        self.states.publish(stamp_of(message), completion.position, completion.velocity, effort,
                            forces, cuts)

    def findings(self, news):
        """Judge the latest pose and what came since the last time."""
        return {'pose': pose_finding(
            self.completion, self.values['tolerance'], news, self.reason)}


def pose_finding(completion, tolerance, news, reason):
    """
    Judge the latest pose of a ``PassiveJointSolver``.

    ``news`` are the counts of the last period; ``reason`` says why the latest message that was
    not completed was not.
    """
    level, message = OK, 'closed'
    if news[NOT_CLOSED]:
        level, message = ERROR, reason
    elif completion.passed:
        level, message = ERROR, (
            'a singular position was touched or passed: the mechanism may be on another branch '
            'than is published; start again in a position whose branch is known')
    elif news[NOT_USABLE]:
        level, message = WARN, reason
    elif completion.residual > tolerance:
        level, message = WARN, (
            f'sensors contradict one another by {completion.residual:.2g} rad or m')
    elif completion.sine < SINGULAR:
        level, message = WARN, (
            f'near a singular position (sine {completion.sine:.2g}): errors of measurement are '
            f'{1.0 / max(completion.sine, 1e-300):.2g} times as large at other joints')
    elif not news[COMPLETED]:
        level, message = WARN, 'no joint_states came in the last second'
    return Finding(level, message, {
        'residual [rad or m]': completion.residual,
        'sine of the angle to a singular position': completion.sine,
        'singular position passed': completion.passed})


main = JointStatesNode.main
