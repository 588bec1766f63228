# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Tests of the launch files, where ``launch`` is installed (PyPI has none for Jazzy)."""

import importlib.util
from pathlib import Path

from closedloop_dynamics.ros.simulator_parameters import SIMULATOR_PARAMETERS as PARAMETERS
import pytest

LAUNCH_FILE = Path(__file__).resolve().parents[2] / 'launch' / 'simulate.launch.py'

pytest.importorskip('launch_ros', reason='needs ros2 launch, which comes with ROS 2 only')


@pytest.fixture
def launch_file():
    spec = importlib.util.spec_from_file_location('simulate_launch', LAUNCH_FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_arguments_are_the_parameters_of_the_simulator(launch_file):
    told = {name: (kind, default) for name, kind, default, _ in launch_file.PARAMETERS}
    assert told == {
        parameter.name: (type(parameter.default), in_yaml(parameter.default))
        for parameter in PARAMETERS}


def in_yaml(value):
    return str(value).lower() if isinstance(value, bool) else str(value)


def test_one_node_is_started_with_these_arguments(launch_file):
    from launch.actions import DeclareLaunchArgument
    from launch_ros.actions import Node
    entities = launch_file.generate_launch_description().entities
    names = [each.name for each in entities if isinstance(each, DeclareLaunchArgument)]
    assert names == ['namespace', *(name for name, *_ in launch_file.PARAMETERS)]
    node, = (each for each in entities if isinstance(each, Node))
    assert node.node_package == 'closedloop_dynamics'
    assert node.node_executable == 'closedloop_simulator'
