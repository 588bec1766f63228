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
