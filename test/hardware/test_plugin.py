# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The plugin of ros2_control: the description that names it, and the headers it is built with."""

import os
from pathlib import Path
from xml.etree import ElementTree

from closedloop_dynamics.cli import main
from closedloop_dynamics.engine import build
from closedloop_dynamics.scene.loading import load_scene
import pytest

from .test_mechanism import eigen, PACKAGE, STRICT

# Folders of headers, beside those of the ROS installation.
INCLUDE = 'ROS2_CONTROL_INCLUDE'
NEEDED = ('hardware_interface/system_interface.hpp', 'pluginlib/class_list_macros.hpp',
          'rclcpp/logging.hpp', 'rclcpp_lifecycle/state.hpp')


@pytest.fixture
def library(tmp_path):
    """Return the path of a file in the place of the compiled C."""
    path = tmp_path / 'mechanism.so'
    path.touch()
    return str(path)


def described(capsys, scene, *options):
    """Return the ``ros2_control`` element that the command writes."""
    assert main(['urdf', scene, *options]) == 0
    return ElementTree.fromstring(capsys.readouterr().out).find('ros2_control')


def test_the_description_names_all_joints_and_commands_of_driven_ones(capsys, library):
    control = described(capsys, 'three_rrr', '--hardware', library)
    scene = load_scene('three_rrr')
    parameters = {one.get('name'): one.text for one in control.findall('hardware/param')}
    assert parameters['model'] == library
    assert float(parameters['step_size']) == scene.method.step_size
    # What the mechanism accepts.
    assert 0.0 < float(parameters['bandwidth']) * scene.method.step_size <= 0.5
    joints = {one.get('name'): one for one in control.findall('joint')}
    assert list(joints) == [joint.name for joint in scene.mechanism.joints]
    for name, joint in joints.items():
        kinds = [one.get('name') for one in joint.findall('command_interface')]
        assert kinds == (['effort', 'position', 'velocity']
                         if name in scene.mechanism.actuated_joints else [])
        assert [one.get('name') for one in joint.findall('state_interface')] == [
            'position', 'velocity', 'acceleration', 'effort']


def test_cut_joints_are_sensors_where_that_is_asked_for(capsys, library):
    assert not described(capsys, 'three_rrr', '--hardware', library).findall('sensor')
    for scene, count in (('three_rrr', 3), ('delta_robot', 6)):
        sensors = described(capsys, scene, '--hardware', library, '--sensors').findall('sensor')
        cuts = load_scene(scene).mechanism.cut_joints
        assert [one.findtext('param') for one in sensors] == [cut.name for cut in cuts]
        assert all(len(one.findall('state_interface')) == count for one in sensors)
    assert main(['urdf', 'three_rrr', '--sensors']) == 2
    assert '--sensors: expected --hardware' in capsys.readouterr().err


def test_joints_of_several_freedoms_are_those_of_the_description(capsys, library):
    assert main(['urdf', 'stewart_platform', '--hardware', library]) == 0
    robot = ElementTree.fromstring(capsys.readouterr().out)
    joints = {one.get('name') for one in robot.findall('joint')}
    named = [one.get('name') for one in robot.findall('ros2_control/joint')]
    # Legs, and the universal joints below them as two; the platform's rotation has no number.
    assert len(named) == 18 and set(named) <= joints


def test_the_plugin_is_called_the_same_everywhere(capsys, library):
    declared = ElementTree.parse(PACKAGE / 'closedloop_hardware.xml').getroot()
    name = declared.find('class').get('name')
    control = described(capsys, 'three_rrr', '--hardware', library)
    assert control.findtext('hardware/plugin') == name
    assert declared.find('class').get('type') == name.replace('/', '::')
    lists = (PACKAGE / 'CMakeLists.txt').read_text()
    assert f'add_library({declared.get("path")} SHARED' in lists
    versions = {ElementTree.parse(path / 'package.xml').getroot().findtext('version')
                for path in (PACKAGE, PACKAGE.parent)}
    assert len(versions) == 1


def test_a_mechanism_has_no_steps_to_make(capsys):
    mechanism = PACKAGE.parent / 'config' / 'mechanisms' / 'three_rrr.yaml'
    assert main(['urdf', str(mechanism), '--hardware', 'a.so']) == 2
    assert f'--hardware: expected a scene, got the mechanism {mechanism}' in (
        capsys.readouterr().err)


def test_a_library_that_is_not_there_is_refused(capsys, tmp_path):
    missing = tmp_path / 'three_rrr.so'
    assert main(['urdf', 'three_rrr', '--hardware', str(missing)]) == 2
    assert f'got no file {missing}' in capsys.readouterr().err


def headers():
    """Return folders of headers; skip where ros2_control is not there."""
    folders = [Path(one) for one in os.environ.get(INCLUDE, '').split(os.pathsep) if one]
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        include = Path(prefix, 'include')
        folders += [include, *(one for one in sorted(include.glob('*')) if one.is_dir())]
    missing = [name for name in NEEDED if not any((one / name).is_file() for one in folders)]
    if missing:
        pytest.skip(f'needs {missing[0]}, of ros2_control or ROS 2, in AMENT_PREFIX_PATH or in '
                    f'the folders that {INCLUDE} lists')
    return folders


def test_the_plugin_compiles_with_the_headers_of_ros2_control():
    if not build.compiler():
        pytest.skip('needs a C++ compiler')
    system = [part for folder in (*headers(), eigen()) for part in ('-isystem', folder)]
    build.run([*build.compiler(), '-std=c++17', '-fsyntax-only', *STRICT, '-I',
               PACKAGE / 'include', *system, PACKAGE / 'src' / 'mechanism_system.cpp'])
