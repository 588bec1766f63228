# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The interface reference says of every parameter what the code says."""

from pathlib import Path

from closedloop_dynamics.ros.frames import FRAME_PARAMETERS
from closedloop_dynamics.ros.joint_states_node import JOINT_STATES_PARAMETERS
from closedloop_dynamics.ros.markers import MARKER_PARAMETERS
from closedloop_dynamics.ros.parameters import in_yaml
from closedloop_dynamics.ros.recorder_node import PARAMETERS as RECORDER_PARAMETERS
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
        *JOINT_STATES_PARAMETERS)])
def test_parameter_is_described_as_it_is(row):
    assert row in DOCUMENT.read_text().splitlines()
