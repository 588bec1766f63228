# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Evaluations of one state again and again, inside compiled code."""

from pathlib import Path
import sys

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from closedloop_dynamics.engine import native  # noqa: E402,I100
from closedloop_dynamics.integration.system import number_of_states  # noqa: E402


def evaluate_again(system, q, qd, count):
    """
    Evaluate a state so many times, each evaluation waiting for the one before.

    Parameters
    ----------
    system : integration.system.System
        Model and workspace of the mechanism.
    q, qd : ndarray, shapes (nq,) and (nv,)
        Coordinates and rates.
    count : int
        How often.

    """
    state = np.zeros(number_of_states(system))
    state[:len(q) + len(qd)] = np.concatenate((q, qd))
    native.evaluate_again(system.native, state, count)
