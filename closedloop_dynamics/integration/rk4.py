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

"""The classical Runge-Kutta method: order 4, four evaluations a step."""

from ..core.compiled import compiled
from .system import evaluate

STAGES = 4


@compiled
def step(system, q, qd, step_size, stages):
    """
    Advance a state by one step of the classical Runge-Kutta method.

    Parameters
    ----------
    system : System
    q, qd : ndarray, shape (nv,)
        Advanced in place.
    step_size : float
        [s].
    stages : ndarray, shape (STAGES, nv)
        Scratch: the stage's coordinates and rates, and the weighted sums of both.

    """
    q_stage, qd_stage, rate_sum, acceleration_sum = stages[0], stages[1], stages[2], stages[3]
    qdd = system.qdd
    for i in range(q.shape[0]):
        q_stage[i] = q[i]
        qd_stage[i] = qd[i]
        rate_sum[i] = 0.0
        acceleration_sum[i] = 0.0
    for stage in range(4):
        evaluate(system, q_stage, qd_stage)
        weight = step_size / 6.0 if stage == 0 or stage == 3 else step_size / 3.0
        ahead = step_size if stage == 2 else 0.5 * step_size
        for i in range(q.shape[0]):
            rate = qd_stage[i]
            rate_sum[i] += weight * rate
            acceleration_sum[i] += weight * qdd[i]
            q_stage[i] = q[i] + ahead * rate
            qd_stage[i] = qd[i] + ahead * qdd[i]
    for i in range(q.shape[0]):
        q[i] += rate_sum[i]
        qd[i] += acceleration_sum[i]
