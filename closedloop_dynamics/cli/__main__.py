# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Run ``closedloop`` as ``python -m closedloop_dynamics.cli``."""

import sys

from . import program

sys.exit(program())
