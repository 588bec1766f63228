# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Tests of the launch files: what they start, for which arguments.

PyPI has no ``launch`` for Jazzy. So stand-ins of its classes, which only keep what they are
given, print what would be started; where the real one is installed, it starts the nodes, too.
"""

import importlib.util
import json
from pathlib import Path
import re
import shutil
import subprocess
import sys
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

from ament_index_python.packages import PackageNotFoundError
from closedloop_dynamics.control.settings import FEEDBACK_MODES
from closedloop_dynamics.mechanism.config import shipped_path
from closedloop_dynamics.recording.reading import Bag
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.simulator_parameters import SIMULATOR_PARAMETERS
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
import pytest
import yaml

FOLDER = Path(__file__).resolve().parents[2] / 'launch'
STAND_INS = {
    'launch': ['LaunchDescription'],
    'launch.actions': ['DeclareLaunchArgument', 'EmitEvent', 'ExecuteProcess', 'GroupAction',
                       'IncludeLaunchDescription', 'OpaqueFunction', 'RegisterEventHandler',
                       'Shutdown', 'TimerAction'],
    'launch.event_handlers': ['OnProcessExit', 'OnProcessIO'],
    'launch.events': ['matches_action'], 'launch.events.process': ['SignalProcess'],
    'launch.launch_description_sources': ['PythonLaunchDescriptionSource'],
    'launch.substitutions': ['LaunchConfiguration'],
    'launch_ros': [], 'launch_ros.actions': ['Node'],
}


class StandIn:
    """Keeps what it is given."""

    def __init__(self, *given, **named):
        self.given, self.named = given, named

    def __getattr__(self, name):
        return self.named[name]

    def perform(self, context):
        """Return the value of a launch argument."""
        return context[self.given[0]]


def load(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f'{name}.launch.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def stand_ins(monkeypatch):
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each, type(each, (StandIn,), {}))
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def simulate(stand_ins, monkeypatch):
    """Return a function that returns what simulate.launch.py starts for arguments."""
    module = load('simulate')
    installed = {'rviz2', 'tf2_ros'}

    def prefix(package):
        if package not in installed:
            raise PackageNotFoundError(package)

    monkeypatch.setattr(module, 'get_package_prefix', prefix)
    *declared, opaque = module.generate_launch_description().given[0]
    defaults = {each.given[0]: each.default_value for each in declared}

    def nodes(**arguments):
        assert set(arguments) <= set(defaults)
        return opaque.function({**defaults, **arguments})

    nodes.declared, nodes.installed = declared, installed
    return nodes


def executables(nodes):
    return [node.executable for node in nodes]


def test_every_parameter_of_the_simulator_is_an_argument(simulate):
    described = {each.given[0]: each.description for each in simulate.declared}
    for parameter in SIMULATOR_PARAMETERS:
        assert parameter.description in described[parameter.name]
    assert {'drive', 'record', 'rviz', 'rate', 'namespace', 'scene'} <= set(described)


def test_one_simulator_is_started_without_arguments(simulate):
    node, = simulate()
    assert (node.package, node.executable) == ('closedloop_dynamics', 'closedloop_simulator')
    assert node.parameters == [
        {'scene': 'three_rrr', 'marker_frame': 'world', 'frame_prefix': ''}]


def test_arguments_have_the_types_of_the_parameters(simulate):
    node, = simulate(scene='four_bar', rate='200', wait_for_command='true', step_count='5',
                     step_size='1e-3', namespace='cell', mode='lockstep', motion_joints='[a, b]')
    values = node.parameters[-1]
    assert values == {
        'scene': 'four_bar', 'publish_rate': 200.0, 'wait_for_command': True, 'step_count': 5,
        'step_size': 0.001, 'mode': 'lockstep', 'motion_joints': ['a', 'b'],
        'marker_frame': 'world', 'frame_prefix': ''}
    assert {type(parameter.default) for parameter in SIMULATOR_PARAMETERS} == set(
        map(type, values.values()))
    assert node.namespace == 'cell'


@pytest.mark.parametrize('name, value, problem', [
    ('rate', 'fast', 'publish_rate: expected a number'),
    ('wait_for_command', 'maybe', 'expected true or false'),
    ('motion_joints', 'theta_1', 'expected a list'),
    ('drive', 'nobody', 'three_rrr_circle')])
def test_wrong_arguments_are_named(simulate, name, value, problem):
    with pytest.raises(RuntimeError, match=problem):
        simulate(**{name: value})


@pytest.mark.parametrize('drive', ['three_rrr_circle', 'carpet_scraper_speed'])
def test_a_drive_brings_its_torque_source(simulate, drive):
    simulator, source = simulate(drive=drive)
    assert executables([simulator, source]) == [
        'closedloop_simulator', 'closedloop_torque_source']
    assert Path(simulator.parameters[0]).is_file()
    # The scene is the file's.
    assert 'scene' not in simulator.parameters[-1]
    assert source.parameters[0] == simulator.parameters[0]


def test_recorder_is_started_when_asked_for(simulate):
    simulator, recorder = simulate(record='true', namespace='left')
    # Whose first states and commands it is not to miss.
    assert simulator.parameters[-1]['wait_for_subscribers'] == 1
    driven, source, _ = simulate(record='true', drive='three_rrr_circle')
    # The torque source subscribes to states, too, and the simulator to commands.
    assert driven.parameters[-1]['wait_for_subscribers'] == 2
    assert source.parameters[-1] == {'wait_for_subscribers': 2}
    assert 'wait_for_subscribers' not in simulate()[0].parameters[-1]
    assert (recorder.executable, recorder.namespace) == ('closedloop_recorder', 'left')
    assert recorder.parameters == [{'output': ''}]
    *_, recorder = simulate(record='my_bag')
    assert recorder.parameters == [{'output': 'my_bag'}]


def test_drives_that_look_at_no_states_are_known(simulate, tmp_path):
    modes, = (parameter.choices for parameter in TORQUE_SOURCE_PARAMETERS
              if parameter.name == 'mode')
    for mode in modes:
        path = tmp_path / f'{mode}.yaml'
        path.write_text(f'closedloop_torque_source: {{ros__parameters: {{mode: {mode}}}}}\n')
        simulator, *_ = simulate(record='true', drive=str(path))
        assert simulator.parameters[-1]['wait_for_subscribers'] == 1 + (mode in FEEDBACK_MODES)


def test_viewer_is_given_the_frames_of_the_links(simulate):
    simulator, viewer = simulate(rviz='true', scene='slider_crank')
    assert executables([simulator, viewer]) == ['closedloop_simulator', 'rviz2']
    assert simulator.parameters[-1]['publish_tf'] is True
    assert Path(viewer.arguments[-1]).is_file()


@pytest.mark.parametrize('prefix, missing', [('', 'rviz2'), ('left/', 'rviz2'),
                                             ('left/', 'tf2_ros')])
def test_what_is_not_installed_is_named_before_anything_starts(simulate, prefix, missing):
    simulate.installed.remove(missing)
    with pytest.raises(RuntimeError, match=f"rviz:=true needs the package '{missing}'"):
        simulate(rviz='true', frame_prefix=prefix)


def test_launch_ends_with_any_of_its_nodes_and_fails_with_it(simulate):
    nodes = simulate(drive='three_rrr_circle', record='true')
    assert len(nodes) == 3
    for node in nodes:
        action = node.on_exit(SimpleNamespace(returncode=0), None)
        assert type(action).__name__ == 'Shutdown'
        for code in (1, 2, -9):
            with pytest.raises(
                    RuntimeError, match=f'{node.executable} ended with exit code {code}'):
                node.on_exit(SimpleNamespace(returncode=code), None)


def test_launch_files_need_no_more_than_names_of_the_package():
    imports = [line for path in FOLDER.glob('*.py') for line in path.read_text().splitlines()
               if line.startswith(('from closedloop_dynamics', 'import closedloop_dynamics'))]
    assert imports
    code = '\n'.join([
        'import sys, warnings', 'warnings.simplefilter("error", RuntimeWarning)',
        'sys.modules.update(dict.fromkeys(("closedloop_dynamics.engine.native", "llvmlite", '
        '"scipy", "matplotlib")))', *imports])
    subprocess.run([sys.executable, '-c', code], cwd=FOLDER.parent, check=True)


def test_two_mechanisms_stand_apart(stand_ins, simulate):
    *declared, opaque = load('two_mechanisms').generate_launch_description().given[0]
    # Those of what is included are not shown as its own.
    assert [each.given[0] for each in declared] == ['record', 'rviz', 'mode']
    defaults = {each.given[0]: each.default_value for each in declared}
    assert len(opaque.function(defaults)) == 2
    groups, shown = [], []
    for each in opaque.function({**defaults, 'rviz': 'true', 'record': 'true'}):
        (groups if type(each).__name__ == 'GroupAction' else shown).append(each)
    arguments = [dict(each.given[0][0].launch_arguments) for each in groups]
    assert [each['namespace'] for each in arguments] == ['left', 'right']
    for each in arguments:
        assert each['marker_frame'] == f"{each['frame_prefix']}world"
        nodes = simulate(**each)
        assert executables(nodes) == [
            'closedloop_simulator', 'closedloop_torque_source', 'closedloop_recorder']
        assert nodes[0].parameters[-1]['frame_prefix'] == f"{each['namespace']}/"
        assert nodes[-1].parameters == [{'output': each['namespace']}]
    assert [each.package for each in shown] == ['tf2_ros', 'tf2_ros', 'rviz2']


@pytest.fixture
def example(stand_ins, simulate, monkeypatch, tmp_path):
    """Return a function that returns what a launch file starts: nodes, and others."""
    def started(name, **arguments):
        module = load(name)
        if hasattr(module, 'get_package_prefix'):
            monkeypatch.setattr(module, 'get_package_prefix', lambda package: (
                tmp_path if package in {'closedloop_dynamics', *example.installed}
                else (_ for _ in ()).throw(PackageNotFoundError(package))))
        found, defaults = module.generate_launch_description().given[0], {}
        for each in found:
            if type(each).__name__ == 'DeclareLaunchArgument':
                defaults[each.given[0]] = each.default_value
        assert set(arguments) <= set(defaults)
        return unfolded(found, {**defaults, **arguments})

    def unfolded(entities, values):
        whole = []
        for each in entities:
            kind = type(each).__name__
            if kind == 'OpaqueFunction':
                whole += unfolded(each.function(values), values)
            elif kind == 'GroupAction':
                whole += unfolded(each.given[0], values)
            elif kind == 'IncludeLaunchDescription':
                whole += simulate(**dict(each.launch_arguments))
            elif kind != 'DeclareLaunchArgument':
                whole.append(each)
        return whole

    example = SimpleNamespace(installed=set(), started=started)
    return example


def test_impedance_control_is_its_drive(example):
    simulator, source = example.started('impedance_control')
    assert executables([simulator, source]) == [
        'closedloop_simulator', 'closedloop_torque_source']
    assert Path(source.parameters[0]).stem == 'three_rrr_impedance'


def test_pick_and_place_follows_its_path_or_moveit(example):
    simulator, source = example.started('delta_pick_and_place')
    assert Path(source.parameters[0]).stem == 'delta_robot_pick_and_place'
    with pytest.raises(RuntimeError, match="moveit:=true needs the package 'moveit_ros_move_gr"):
        example.started('delta_pick_and_place', moveit='true')
    example.installed |= {'moveit_ros_move_group', 'controller_manager',
                          'joint_trajectory_controller', 'joint_state_topic_hardware_interface'}
    simulator, manager, spawner, group = example.started('delta_pick_and_place', moveit='true')
    values = simulator.parameters[-1]
    assert values['scene'] == 'delta_robot' and values['publish_tf'] is True
    rates = Path(manager.parameters[0]).read_text()
    assert f"update_rate: {values['publish_rate']:g} " in rates
    assert spawner.arguments[0] == 'joint_trajectory_controller'
    assert Path(group.parameters[0]).is_file()
    assert '<passive_joint' in group.parameters[1]['robot_description_semantic']


CONTROL = {'closedloop_hardware', 'controller_manager', 'joint_state_broadcaster',
           'joint_trajectory_controller', 'robot_state_publisher'}


def test_hardware_of_ros2_control_needs_a_compiler(example, tmp_path, monkeypatch):
    example.installed |= CONTROL
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(RuntimeError, match="needs a C compiler, called 'cc'"):
        example.started('ros2_control', folder=str(tmp_path))


@pytest.mark.skipif(shutil.which('cc') is None, reason='needs a C compiler, called cc')
def test_mechanism_is_hardware_of_ros2_control(example, tmp_path):
    program = tmp_path / 'lib' / 'closedloop_dynamics' / 'closedloop'
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m closedloop_dynamics.cli "$@"\n')
    program.chmod(0o755)
    with pytest.raises(RuntimeError, match="needs the package 'closedloop_hardware'"):
        example.started('ros2_control', folder=str(tmp_path))
    example.installed |= CONTROL
    state, manager, spawner = example.started(
        'ros2_control', folder=str(tmp_path), real_time_factor='2.0', sensors='true')
    robot = ElementTree.fromstring(state.parameters[0]['robot_description'])
    given = {one.get('name'): one.text for one in robot.findall('ros2_control/hardware/param')}
    assert Path(given['model']).is_file() and given['real_time_factor'] == '2.0'
    # The clock goes on by the period of the controller manager.
    controllers = yaml.safe_load(Path(manager.parameters[0]).read_text())
    values = controllers['controller_manager']['ros__parameters']
    assert float(given['period']) * values['update_rate'] == 1.0
    assert state.parameters[1] == manager.parameters[1] == {'use_sim_time': True}
    assert [each.get('name') for each in robot.findall('ros2_control/sensor')] == [
        'cut_1', 'cut_2']
    assert spawner.arguments[:2] == ['joint_state_broadcaster', 'joint_trajectory_controller']
    followed = controllers['joint_trajectory_controller']['ros__parameters']
    assert followed['joints'] == ['theta_1', 'theta_6', 'theta_7']
    with pytest.raises(RuntimeError, match='nowhere'):
        example.started('ros2_control', folder=str(tmp_path), scene='nowhere')


def test_a_machine_has_its_twin_beside_it(example):
    """The estimator knows another scene than the machine, and takes the machine's topics."""
    simulator, source, estimator, viewer = example.started('estimation')
    assert executables([simulator, source, estimator, viewer]) == [
        'closedloop_simulator', 'closedloop_torque_source', 'closedloop_estimator',
        'closedloop_viewer']
    values, = estimator.parameters
    assert values['scene'] == 'three_rrr' and Path(values['sensors']).is_file()
    assert Path(simulator.parameters[-1]['scene']).is_file()
    assert simulator.parameters[-1]['scene'] == source.parameters[-1]['scene']
    assert ('joint_states', '/joint_states') in estimator.remappings
    assert viewer.parameters[0]['estimator'] == f'/{estimator.namespace}/closedloop_estimator'
    with pytest.raises(PackageNotFoundError):
        example.started('estimation', rviz='true')
    example.installed.add('rviz2')
    *_, rviz = example.started('estimation', rviz='true', view='false', mode='lockstep')
    text = Path(rviz.arguments[-1]).read_text()
    for topic in ('visualization_marker_array', 'twin/visualization_marker_array'):
        assert f'Value: {topic}\n' in text


def test_ankle_is_completed_beside_what_stands_for_the_robot(example):
    completion, simulator, source = example.started('humanoid_ankle')
    assert completion.executable == 'closedloop_joint_states'
    assert completion.parameters[0]['joints'] == ['left', 'right']
    assert completion.remappings == [('joint_states', '/robot/joint_states')]
    assert simulator.namespace == source.namespace == 'robot'
    assert executables(example.started('humanoid_ankle', robot='false')) == [
        'closedloop_joint_states']


def test_machine_waits_for_hardware_or_what_stands_for_it(example):
    simulator, = example.started('hardware_in_the_loop')
    values = simulator.parameters[-1]
    assert (values['mode'], values['publish_clock'], values['scene']) == (
        'lockstep', True, 'three_rrr')
    simulator, source = example.started('hardware_in_the_loop', stand_in='true')
    assert source.executable == 'closedloop_torque_source'
    assert simulator.parameters[-1]['mode'] == 'lockstep'


def test_forces_are_found_of_a_bag_or_of_what_is_recorded_first(example, tmp_path):
    forces, = example.started('bag_to_forces', bag='mine', scene='delta_robot', deviation='1e-4')
    assert forces.cmd == [
        str(tmp_path / 'lib' / 'closedloop_dynamics' / 'closedloop'), 'forces', 'mine', '--scene',
        'delta_robot', '--deviation', '1e-4', '--output', 'forces']
    assert type(forces.on_exit(SimpleNamespace(returncode=0), None)).__name__ == 'Shutdown'
    with pytest.raises(RuntimeError, match='closedloop forces ended with exit code 2'):
        forces.on_exit(SimpleNamespace(returncode=2), None)
    simulator, source, recorder, *handlers = example.started('bag_to_forces')
    assert executables([simulator, source, recorder]) == [
        'closedloop_simulator', 'closedloop_torque_source', 'closedloop_recorder']
    # Nobody begins before the recorder listens.
    assert simulator.parameters[1] == {'wait_for_subscribers': 2}
    assert source.parameters[1] == {'wait_for_subscribers': 2}
    spoken, ended = (handler.given[0] for handler in handlers)
    assert spoken.on_stderr(SimpleNamespace(text=b'recording into motion')) is None
    timer = spoken.on_stderr(SimpleNamespace(text=b'... /joint_states: first message\n'))
    assert type(timer).__name__ == 'TimerAction' and timer.period == 5.0
    forces = ended.on_exit(SimpleNamespace(returncode=0), None)
    assert forces.cmd[2] == recorder.parameters[0]['output'] == 'motion'
    with pytest.raises(RuntimeError, match='closedloop_recorder ended with exit code 1'):
        ended.on_exit(SimpleNamespace(returncode=1), None)


def test_shipped_views_look_at_what_is_published():
    folder = shipped_path('scenes', 'x').parents[1]
    for name, prefixes in (('mechanism', ['']), ('two_mechanisms', ['left/', 'right/'])):
        text = (folder / 'rviz' / f'{name}.rviz').read_text()
        for prefix in prefixes:
            for topic in ('robot_description', 'visualization_marker_array'):
                assert f'Value: {prefix}{topic}\n' in text
        assert 'Fixed Frame: world' in text
    layout = json.loads((folder / 'foxglove' / 'mechanism.json').read_text())
    panels = layout['configById']
    assert '/visualization_marker_array' in panels['3D!machine']['topics']

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node['first']) + leaves(node['second'])

    assert sorted(leaves(layout['layout'])) == sorted(panels)
    # All values of an array would become one line that jumps between them.
    assert not any(re.search(r'\[:\](?!{)', path['value']) for panel in panels.values()
                   for path in panel.get('paths', ()))
    assert 'accuracy: true' in (folder / 'rviz' / 'mechanism.rviz').read_text()


def test_shipped_layout_plots_what_diagnostics_have(make_node):
    node = make_node(SimulatorNode, scene='four_bar')
    sent = []
    node.diagnostics._publisher = SimpleNamespace(publish=sent.append)
    node.publish_diagnostics()
    values = {status.name: {value.key for value in status.values} for status in sent[0].status}
    layout = json.loads((
        shipped_path('scenes', 'x').parents[1] / 'foxglove' / 'mechanism.json').read_text())
    found = [re.search(r'name=="(.*?)".*key=="(.*?)"', path['value']).groups()
             for path in layout['configById']['Plot!accuracy']['paths']]
    assert len(found) == 3
    for name, key in found:
        assert key in values[name]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_real_launch_starts_and_ends_all(tmp_path, monkeypatch, domain):
    """Needs ``launch`` and ``launch_ros``, and the package installed where they look."""
    pytest.importorskip('launch_ros', reason='comes with ROS 2 only')
    from ament_index_python.packages import get_package_prefix
    import launch
    from launch.launch_description_sources import PythonLaunchDescriptionSource
    try:
        get_package_prefix('closedloop_dynamics')
    except PackageNotFoundError:
        pytest.skip('the package is not installed with colcon')
    monkeypatch.chdir(tmp_path)
    service = launch.LaunchService()
    watch = SimpleNamespace(left=600)

    def until_recorded(context):
        bags = [Path('left'), Path('right')]
        sizes = [sum(path.stat().st_size for path in bag.glob('*.mcap')) for bag in bags]
        watch.left -= 1
        if min(sizes) > 100_000 or watch.left == 0:
            return [launch.actions.Shutdown(reason='enough was recorded')]
        return [launch.actions.TimerAction(period=0.5, actions=[
            launch.actions.OpaqueFunction(function=until_recorded)])]

    service.include_launch_description(launch.LaunchDescription([
        launch.actions.IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(FOLDER / 'two_mechanisms.launch.py')),
            launch_arguments=[('record', 'true')]),
        launch.actions.OpaqueFunction(function=until_recorded)]))
    assert service.run() == 0
    for name in ('left', 'right'):
        bag = Bag(tmp_path / name)
        assert bag.finished
        assert f'/{name}/joint_states' in {topic for topic, *_ in bag.messages()}
