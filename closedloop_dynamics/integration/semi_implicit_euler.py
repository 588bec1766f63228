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

"""Semi-implicit (symplectic) Euler: order 1, one evaluation a step."""

from ..core.compiled import compiled
from .system import evaluate

STAGES = 0


@compiled
def step(system, q, qd, step_size, stages):
    """
    Advance a state by one step: rates first, then coordinates with the new rates.

    Parameters
    ----------
    system : System
    q, qd : ndarray, shape (nv,)
        Advanced in place.
    step_size : float
        [s].
    stages : ndarray, shape (STAGES, nv)
        Scratch.

    """
    evaluate(system, q, qd)
    for i in range(q.shape[0]):
        qd[i] += step_size * system.qdd[i]
        q[i] += step_size * qd[i]
