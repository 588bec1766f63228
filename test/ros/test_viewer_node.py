# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The viewer shows running simulators through their topics, and asks them through services."""

from test.view.client import Client, plotted
import threading

from closedloop_dynamics.mechanism.kinematics import body_poses, poses_in_space
from closedloop_dynamics.ros.messages import DEVIATIONS, ESTIMATED
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.viewer_node import ViewerNode
import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

# A busy host answers late: less so in simulated time that passes slowly.
SLOWLY = {'real_time_factor': 0.3}


@pytest.fixture
def spinning(context, make_node):
    """Return a function that makes nodes which a thread spins."""
    executor = SingleThreadedExecutor(context=context)
    over = threading.Event()

    def spin():
        while not over.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin)
    nodes = []

    def make(*arguments, **parameters):
        nodes.append(make_node(*arguments, **parameters))
        executor.add_node(nodes[-1])
        if not thread.is_alive():
            thread.start()
        return nodes[-1]

    yield make
    over.set()
    thread.join()
    for node in nodes:
        node.close()


def served(viewer):
    """Return the server's address when the simulators are found."""
    while viewer.server is None:
        assert viewer.exit_code is None
        threading.Event().wait(0.05)
    return viewer.server.url


def test_a_running_simulator_is_shown_and_driven(spinning):
    simulator = spinning(SimulatorNode, scene='three_rrr_vertical')
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'])
    with Client(served(viewer)) as client:
        assert client.scene['title'] == '/closedloop_simulator'
        client.until(lambda client: client.row is not None and np.isfinite(client.row).all())
        # States between frames come, too, as rows.
        client.until(lambda client: client.samples)
        assert client.samples[-1][1].shape == client.row.shape
        client.ask('effect', name='gravity', enabled=False)
        client.until(lambda client: not client.controls['effects']['gravity']['enabled'])
        # Until it drives, a page is no source of commands, of which there should be one.
        assert simulator.count_publishers('joint_command') == 0
        client.ask('command', joint='theta_1', value=7.5)
        client.until(lambda client: client.row is not None and plotted(
            client, 'drive torque or force', 'theta_1') == 7.5)
        client.ask('pause')
        client.until(lambda client: not client.controls['playing'])
        while not simulator.paused:
            threading.Event().wait(0.01)
        expected = np.float32(simulator.simulation.position[0])
        client.until(lambda client: plotted(client, 'joint position', 'theta_1') == expected)
        refused = client.controls['refused']
        for what, more in (('effect', {'name': 'gravity', 'values': {'acceleration': [1.0]}}),
                           ('effect', {'name': 'nothing', 'enabled': True}),
                           ('command', {'joint': 'theta_2', 'value': 1.0}),
                           ('method', {'values': {'integrator': 'guess'}}),
                           # A node is not edited.
                           ('edit', {'on': True}), ('motion', {'which': 'own'}),
                           ('load', {'name': 'a', 'text': ''})):
            client.ask(what, **more)
            refused += 1
            client.until(lambda client: client.controls['refused'] == refused)
        client.ask('reset')
        client.until(lambda client: abs(plotted(client, 'joint position', 'theta_1') - expected)
                     > 1e-4)
    assert simulator.exit_code is None and simulator.paused


def test_a_command_is_repeated_until_a_state_shows_it(listener, spinning):
    """A subscriber that is matched after a page's first command gets the torque, too."""
    spinning(SimulatorNode, scene='four_bar')
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'])
    with Client(served(viewer)) as client:
        client.until(lambda client: client.row is not None)
        client.ask('pause')
        client.until(lambda client: not client.controls['playing'])
        client.ask('command', joint='crank_joint', value=0.5)
        client.until(lambda client: client.controls['drives']['crank_joint']['value'] == 0.5)
        commands = listener.listen('joint_command', JointState)
        listener.wait(lambda: commands, 'command')
        assert list(commands[-1].effort) == [0.5]
        client.ask('play')
        client.until(lambda client: plotted(
            client, 'drive torque or force', 'crank_joint') == 0.5)


def test_estimates_are_shown_beside_the_simulator(context, spinning):
    """The viewer waits for the estimator, and shows values, deviations and poses of it."""
    simulator = spinning(SimulatorNode, scene='three_rrr_vertical')
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'], estimator='twin')
    estimator = rclpy.create_node('twin', context=context)
    for _ in range(8):
        viewer.poll_simulators()
    assert viewer.server is None
    estimates, deviations = (estimator.create_publisher(JointState, topic, 10) for topic in (
        ESTIMATED, DEVIATIONS))
    start = simulator.simulation.scene.initial.position
    with Client(served(viewer)) as client:
        def published(client):
            for publisher, position, velocity in (
                    (estimates, 0.1 + np.array(start), 0.5), (deviations, [0.02] * 7, 0.03)):
                # Names of other joints are ignored.
                publisher.publish(JointState(
                    name=[*simulator.simulation.joint_names, 'other'], effort=[0.0] * 8,
                    position=[*position, 9.0], velocity=[velocity] * 8))
            return client.row is not None and np.isfinite(client.row).all()

        client.until(published)
        columns = client.scene['columns']
        for group, value, deviation in (
                ('joint position', start[0] + 0.1, 0.02), ('joint velocity', 0.5, 0.03)):
            found = plotted(client, group, 'theta_1, estimated')
            plot, = (one for one in client.scene['plots'] if one['group'] == group
                     and one['name'] == 'theta_1, estimated')
            assert found == np.float32(value)
            assert client.row[columns['plots'] + plot['deviation']] == np.float32(deviation)
        poses = body_poses(simulator.simulation.mechanism, 0.1 + np.array(start))
        np.testing.assert_allclose(
            client.row[columns['estimate']:columns['direction']].reshape(-1, 7),
            poses_in_space(poses), atol=1e-6)
    estimator.destroy_node()


def test_a_namesake_is_not_taken_for_the_simulator(domain, spinning):
    """As a node of the same name that has gone, and is listed still."""
    elsewhere = rclpy.Context()
    rclpy.init(context=elsewhere, domain_id=domain)
    namesake = rclpy.create_node('closedloop_simulator', context=elsewhere)
    simulator = spinning(SimulatorNode, scene='three_rrr_vertical')
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'])
    with Client(served(viewer)) as client:
        client.until(lambda client: client.row is not None and np.isfinite(client.row).all())
        assert client.scene['hand']
    namesake.destroy_node()
    rclpy.try_shutdown(context=elsewhere)
    assert simulator.exit_code is None


def test_a_running_simulator_is_stepped_posed_and_held(spinning):
    simulator = spinning(SimulatorNode, scene='three_rrr_vertical', step_size=0.002, **SLOWLY)
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'])
    with Client(served(viewer)) as client:
        client.until(lambda client: client.row is not None)
        client.ask('pause')
        client.until(lambda client: not client.controls['playing'])
        while not simulator.paused:
            threading.Event().wait(0.01)
        # How far it has fallen depends on the host.
        client.ask('reset')
        while simulator.simulation.time:
            threading.Event().wait(0.01)
        start = np.float32(simulator.simulation.position[0])
        client.until(lambda client: plotted(client, 'joint position', 'theta_1') == start)
        time = simulator.simulation.time
        # Loops are closed by a model of the viewer's own, and stay closed in the simulator.
        client.ask('kinematic', on=True)
        client.until(lambda client: client.controls['kinematic'])
        goal = plotted(client, 'joint position', 'theta_1') - 0.2
        client.ask('pose', joint='theta_1', value=float(goal))
        client.until(lambda client: abs(
            plotted(client, 'joint position', 'theta_1') - goal) < 1e-5)
        assert simulator.simulation.closure < 1e-9 and simulator.simulation.time == time
        # By hand, too.
        body = next(k for k, one in enumerate(client.scene['bodies'])
                    if one['name'] == 'platform')
        place = next(k for k, grab in enumerate(client.scene['bodies'][body]['grabs'])
                     if not any(grab))
        at = client.row[7 * body:7 * body + 3] + np.float32([0.01, -0.02, 0.0])
        client.ask('grab', body=body, place=place, at=at.tolist())
        client.until(lambda client: np.abs(client.row[7 * body:7 * body + 3] - at).max() < 1e-5)
        client.ask('release')
        client.ask('kinematic', on=False)
        client.ask('step', count=7)
        client.until(lambda client: client.time > 0.0 and simulator.simulation.time > time)
        assert simulator.simulation.time == pytest.approx(time + 7 * 0.002)
        # Drives hold it against its weight.
        for joint in ('theta_1', 'theta_6', 'theta_7'):
            client.ask('drive', joint=joint, mode='position')
        client.until(lambda client: all(
            drive['mode'] == 'position' for drive in client.controls['drives'].values()))
        wanted = client.controls['drives']['theta_1']['value']
        client.ask('play')
        start = client.time
        # It sags first, as far as its host is slow.
        client.until(lambda client: client.time > start + 0.5 and abs(
            plotted(client, 'joint position', 'theta_1') - wanted) < 0.02)
        assert plotted(client, 'drive torque or force', 'theta_1') != 0.0
        refused = client.controls['refused']
        client.ask('pose', joint='theta_1', value=1.0)
        client.until(lambda client: client.controls['refused'] == refused + 1)


def test_a_point_of_a_running_simulator_is_pulled(spinning):
    simulator = spinning(SimulatorNode, scene='three_rrr', **SLOWLY)
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'])
    wrench = simulator.live.wrench
    with Client(served(viewer)) as client, Client(viewer.server.url) as other:
        assert client.scene['hand']
        client.ask('effect', name='gravity', enabled=False)
        client.ask('reset')
        start = np.float32(simulator.simulation.scene.initial.position[0])
        client.until(lambda client: client.row is not None
                     and not client.controls['effects']['gravity']['enabled']
                     and plotted(client, 'joint position', 'theta_1') == start)
        body = next(k for k, one in enumerate(client.scene['bodies'])
                    if one['name'] == 'platform')
        place = next(k for k, grab in enumerate(client.scene['bodies'][body]['grabs'])
                     if not any(grab))
        corner = client.row[7 * body:7 * body + 3]

        def held():
            return client.controls['grabbed'] == [body, place]

        def hold():
            while not held():
                refused = client.controls['refused']
                client.ask('grab', body=body, place=place,
                           at=client.row[7 * body:7 * body + 3].tolist())
                client.until(lambda client: held() or client.controls['refused'] > refused)

        hold()
        # Who does not hold it moves nothing, and lets nothing go.
        other.ask('pull', at=[9.0, 9.0, 0.0])
        other.ask('release')
        # Near, and then across the machine.
        for away in ((0.02, -0.03, 0.0), (-0.48, -0.23, 0.0)):
            at = corner + np.float32(away)
            near = False
            while not near:
                # A host that stands still for too long has it let go, which may happen again.
                hold()
                client.ask('pull', at=at.tolist())
                begin = client.time
                client.until(lambda client: not held() or client.time > begin + 0.1)
                near = np.abs(client.row[7 * body:7 * body + 3] - at).max() < 5e-3
        assert wrench.counts['wrenches taken'] > 20 and not wrench.counts['wrenches refused']
        refused = client.controls['refused']
        client.ask('pull', at=[1e6, 0.0, 0.0])
        client.until(lambda client: client.controls['refused'] > refused)
    # The page that held it is closed.
    while wrench.torques.any():
        threading.Event().wait(0.01)
    assert simulator.exit_code is None


def test_what_moves_too_far_between_states_is_let_go(spinning):
    simulator = spinning(SimulatorNode, scene='three_rrr', publish_rate=5.0)
    viewer = spinning(ViewerNode, nodes=['/closedloop_simulator'])
    with Client(served(viewer)) as client:
        client.ask('command', joint='theta_1', value=200.0)
        client.until(lambda client: client.row is not None
                     and abs(plotted(client, 'joint velocity', 'theta_1')) > 10.0)
        client.ask('grab', body=0, place=1, at=client.row[:3].tolist())
        client.until(lambda client: client.controls['refused'] == 1)
        client.until(lambda client: client.controls['grabbed'] is None)
    while simulator.live.wrench.torques.any():
        threading.Event().wait(0.01)
    assert simulator.exit_code is None


def test_several_simulators_have_a_page_each(spinning):
    for space, scene in (('left', 'three_rrr'), ('right', 'four_bar')):
        spinning(SimulatorNode, namespace=space, scene=scene)
    viewer = spinning(ViewerNode)
    url = served(viewer)
    for path, name in (('', 'three_rrr'), ('1/', 'four_bar')):
        with Client(url + path) as client:
            assert client.scene['name'] == name
            client.until(lambda client: client.row is not None)
