# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A node that is ready waits for no compiler, whatever topics, services and parameters ask."""

from closedloop_dynamics.ros.simulator_node import SimulatorNode
from geometry_msgs.msg import WrenchStamped
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

STABILISATIONS = ('baumgarte', 'velocity_projection', 'independent', 'projection')
INTEGRATORS = ('rk4', 'semi_implicit_euler', 'dopri5', 'rodas4', 'auto')


def set_values(node, **values):
    return [result.successful for result in node.set_parameters([
        Parameter(name.replace('__', '.'), value=value) for name, value in values.items()])]


@pytest.mark.parametrize('scene', [
    'three_rrr_payload_friction', pytest.param('bennett', marks=pytest.mark.slow)])
def test_no_request_compiles(scene, make_node, wanted):
    node = make_node(SimulatorNode, scene=scene, mode='lockstep', publish_rate=200.0)
    simulation = node.simulation
    start = simulation.position.tolist()

    def advance():
        for _ in range(5):
            node.on_torque_command(Float64MultiArray(
                data=[0.1] * len(simulation.actuated_joints)))
        assert not wanted

    wanted.clear()
    advance()
    assert simulation.time > 0.0
    for name in simulation.effects:
        for enabled in (False, True):
            assert set_values(node, **{f'effects__{name}__enabled': enabled}) == [True]
            advance()
    for stabilisation in STABILISATIONS:
        set_values(node, stabilisation=stabilisation)
        for integrator in INTEGRATORS:
            set_values(node, integrator=integrator)
            advance()
            assert node.on_reset(Trigger.Request(), Trigger.Response()).success
    push = WrenchStamped()
    push.header.frame_id = simulation.mechanism.bodies[0].name
    push.wrench.force.x = 0.5
    node.on_external_wrench(push)
    advance()
    node.on_set_state(JointState(name=list(simulation.joint_names), position=start))
    advance()
    assert node.counts['states set'] == 1
    # So far that other equations have to be kept.
    while scene == 'bennett' and simulation.data.exchanges < 3:
        advance()
    assert node.on_reset(Trigger.Request(), Trigger.Response()).success
    advance()


def test_a_commanded_motion_compiles_nothing(make_node, wanted):
    node = make_node(SimulatorNode, scene='four_bar', motion_joints=['crank_joint'],
                     mode='lockstep', publish_rate=200.0)
    wanted.clear()
    for value in (1.2, 1.6):
        point = JointTrajectoryPoint(positions=[value])
        point.time_from_start.sec = 1
        before = node.simulation.position[0]
        node.on_motion_command(JointTrajectory(joint_names=['crank_joint'], points=[point]))
        for _ in range(40):
            node.on_torque_command(Float64MultiArray(
                data=[0.0] * len(node.simulation.actuated_joints)))
        assert node.simulation.position[0] > before
    assert not wanted
