# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The interface reference says of every parameter what the code says."""

from pathlib import Path
import re

from closedloop_dynamics.ros.estimator_node import ESTIMATOR_PARAMETERS
from closedloop_dynamics.ros.frames import FRAME_PARAMETERS
from closedloop_dynamics.ros.joint_states_node import JOINT_STATES_PARAMETERS
from closedloop_dynamics.ros.markers import MARKER_PARAMETERS
from closedloop_dynamics.ros.parameters import in_yaml
from closedloop_dynamics.ros.recorder_node import RECORDER_PARAMETERS
from closedloop_dynamics.ros.simulator_node import SimulatorNode
from closedloop_dynamics.ros.simulator_parameters import SIMULATOR_PARAMETERS
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
from closedloop_dynamics.ros.viewer_node import VIEWER_PARAMETERS
import pytest

DOCUMENT = Path(__file__).resolve().parents[2] / 'doc' / 'interface.md'


def row(parameter):
    """Return the row of the table that describes a parameter."""
    kind = parameter.kind.name.lower()
    allowed = ', '.join(f'`{in_yaml(choice)}`' for choice in parameter.choices)
    if parameter.limits:
        allowed = '{:g} to {:g}'.format(*parameter.limits)
    change = 'no' if parameter.read_only else 'yes'
    return (f'| `{parameter.name}` | {kind.replace("_", " ")} | `{in_yaml(parameter.default)}` | '
            f'{allowed} | {change} | {parameter.description} |')


@pytest.mark.parametrize('row', [
    row(parameter) for parameter in (
        *SIMULATOR_PARAMETERS, *FRAME_PARAMETERS, *MARKER_PARAMETERS,
        *TORQUE_SOURCE_PARAMETERS, *RECORDER_PARAMETERS, *VIEWER_PARAMETERS,
        *JOINT_STATES_PARAMETERS, *ESTIMATOR_PARAMETERS)])
def test_parameter_is_described_as_it_is(row):
    assert row in DOCUMENT.read_text().splitlines()


SCENE = """
mechanism: slider_crank
initial:
  position: {crank_joint: 1.0472, rod_joint: -1.34, slider_joint: 0.3372}
  hold: [crank_joint]
effects:
  push: {type: external_force, point: wrist_pin}
"""


@pytest.mark.parametrize('scene, motion_joints', [
    (SCENE, ['crank_joint']), ('planetary_gear', [''])])
def test_topics_of_the_simulator_are_listed(make_node, tmp_path, scene, motion_joints):
    if scene is SCENE:
        scene = str(tmp_path / 'pushed.yaml')
        Path(scene).write_text(SCENE)
    node = make_node(SimulatorNode, scene=scene, motion_joints=motion_joints, publish_clock=True)
    rows = re.findall(r'^\| `(\S+)` \| `(\S+/msg/\S+)` \| (in|out)\b', simulator_part(), re.M)
    listed = {direction: [(f'/{topic.lstrip("/")}', kind) for topic, kind, found in rows
                          if found == direction] for direction in ('in', 'out')}
    own = node.get_name(), node.get_namespace()
    for direction, found in (('in', node.get_subscriber_names_and_types_by_node(*own)),
                             ('out', node.get_publisher_names_and_types_by_node(*own))):
        for topic, kinds in found:
            if topic in ('/rosout', '/parameter_events'):
                continue
            name = topic.replace(f'/{node.get_name()}/', '/~/')
            assert [kind for form, kind in listed[direction] if re.fullmatch(
                re.sub('[A-Z]{3,}', r'\\w+', form), name)] == kinds, f'{direction}: {topic}'


def test_parameters_in_examples_are_those_of_the_default_scene(make_node):
    node = make_node(SimulatorNode)
    named = re.findall(r'ros2 param set /closedloop_simulator (\S+) ', DOCUMENT.read_text())
    assert named
    assert [name for name in named if not node.has_parameter(name)] == []


def simulator_part():
    """Return the part of the document on the simulator."""
    return DOCUMENT.read_text().split('\n## closedloop_simulator\n')[1].split('\n## ')[0]
