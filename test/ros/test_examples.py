# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The examples of doc/examples_*.md: what their pages and files promise."""

from pathlib import Path
import re
import socket
import struct
import threading
from xml.etree import ElementTree

from closedloop_dynamics.control.references import solve
from closedloop_dynamics.mechanism.config import config_directory
from closedloop_dynamics.ros.executor import build_executor
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.srdf import srdf
import numpy as np
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def delta():
    return Simulation.from_scene('delta_robot')


def parameters_of(path):
    """Return the parameters in a file for any node, or by the last part of a node's name."""
    return {name.rsplit('/', 1)[-1]: values['ros__parameters'] for name, values in yaml.safe_load(
        path.read_text()).items()}


def test_moveit_is_given_the_whole_mechanism(delta):
    shipped = ElementTree.parse(config_directory() / 'moveit' / 'delta_robot.srdf').getroot()
    written = ElementTree.fromstring(srdf(delta.mechanism))
    for tag in ('group', 'passive_joint', 'disable_collisions'):
        assert [ElementTree.tostring(one).strip() for one in shipped.findall(tag)] == [
            ElementTree.tostring(one).strip() for one in written.findall(tag)]


def test_states_of_the_group_are_the_corners_of_the_path(delta):
    path = config_directory() / 'controllers' / 'delta_robot_pick_and_place.yaml'
    ways = parameters_of(path)['closedloop_torque_source']
    center, = (point for point in delta.mechanism.points if point.name == ways['path_point'])
    corners = np.vstack([np.zeros(3), np.reshape(ways['path_places'], (-1, 3))])
    expected = [solve(delta.mechanism, delta.position, center,
                      delta.point(center.name) + corner, None) for corner in corners]
    angles = [position[delta.coordinates.place[delta.data.actuated]] for position in expected]
    shipped = ElementTree.parse(config_directory() / 'moveit' / 'delta_robot.srdf').getroot()
    states = {state.get('name'): [float(joint.get('value')) for joint in state]
              for state in shipped.findall('group_state')}
    assert sorted(states) == ['above_pick', 'above_place', 'pick', 'place']
    for name, place in (('pick', 0), ('above_pick', 1), ('above_place', 2), ('place', 3)):
        np.testing.assert_allclose(states[name], angles[place], atol=1e-6)
    # The way back leads through the same corners.
    assert all(min(np.abs(angle - state).max() for state in states.values()) < 1e-6
               for angle in angles)


def test_planner_and_controller_lead_the_driven_joints(delta):
    folder = config_directory() / 'moveit'
    group = parameters_of(folder / 'delta_robot_move_group.yaml')['**']
    controllers = parameters_of(folder / 'delta_robot_controllers.yaml')
    joints = list(delta.actuated_joints)
    managed = group['moveit_simple_controller_manager']
    name, = managed['controller_names']
    assert managed[name]['joints'] == joints
    assert controllers[name]['joints'] == joints and list(controllers[name]['gains']) == joints
    assert f'{name}' in controllers['controller_manager']
    assert list(group['robot_description_planning']['joint_limits']) == joints
    # rcl's parser of parameter files knows no aliases.
    for path in folder.glob('*.yaml'):
        assert not re.search(r'[:\[] [&*]\w', path.read_text())


class Device:
    """A controller at the other end of a line: answers measured positions with torques."""

    def __init__(self, late):
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind(('127.0.0.1', 0))
        self.asked, self._late = [], late
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while True:
            data, sender = self.line.recvfrom(56)
            if not data:
                return
            now, *measured = struct.unpack('<7d', data)
            self.asked.append((now, *measured))
            if len(self.asked) == self._late:
                # Lost on the line.
                continue
            torques = [20.0 * (start - q) - 2.0 * rate for start, q, rate in zip(
                self.asked[0][1:4], measured[:3], measured[3:])]
            self.line.sendto(struct.pack('<4d', now, *torques), sender)

    def close(self):
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'', self.line.getsockname())
        self._thread.join()
        self.line.close()


def bridge_of_the_page():
    """Return the class that doc/examples_lockstep.md shows."""
    page = (ROOT / 'doc' / 'examples_lockstep.md').read_text()
    script, = re.findall(r'^```python\n(.*?)^```$', page, flags=re.M | re.S)
    names = {'__name__': 'bridge'}
    exec(compile(script, 'examples_lockstep.md', 'exec'), names)
    return names['Bridge']


def test_machine_waits_for_a_device_and_runs_are_the_same(make_node, context):
    runs = []
    for late in (None, 7):
        device = Device(late)
        bridge = bridge_of_the_page()(device.line.getsockname(), 0.2, context)
        executor = build_executor(context)
        executor.add_node(bridge.node)
        executor.add_node(make_node(
            SimulatorNode, scene='three_rrr', mode='lockstep', publish_clock=True))
        while bridge.answered < 50:
            executor.spin_once(timeout_sec=0.1)
        executor.shutdown()
        bridge.node.destroy_node()
        device.close()
        times = [now for now, *_ in device.asked]
        assert (len(times) > len(set(times))) == (late is not None)
        # What was asked twice is one state.
        runs.append(list(dict.fromkeys(
            tuple(measured) for _, *measured in device.asked))[:50])
    assert runs[0] == runs[1]
    assert len(runs[0]) == 50
