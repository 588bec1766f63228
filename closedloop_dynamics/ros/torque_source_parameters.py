# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the torque source: those of its controller and of the node."""

from closedloop_dynamics.control.settings import SETTINGS
from closedloop_dynamics.ros.parameters import ALLOW_CODE, Parameter

TORQUE_SOURCE_PARAMETERS = (*(Parameter(*setting) for setting in SETTINGS), ALLOW_CODE)
