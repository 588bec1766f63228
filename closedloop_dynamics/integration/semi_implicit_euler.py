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


@compiled
def step(state, nv, step_size, slope, out):
    """
    Advance a state by one step: rates first, then coordinates with the new rates.

    Parameters
    ----------
    state : ndarray, shape (ns,)
        Coordinates, rates, and what effects add.
    nv : int
        Number of joint coordinates.
    step_size : float
        [s].
    slope : ndarray, shape (ns,)
        At ``state``.
    out : ndarray, shape (ns,)
        Written in place.

    """
    for i in range(nv):
        out[nv + i] = state[nv + i] + step_size * slope[nv + i]
        out[i] = state[i] + step_size * out[nv + i]
    for k in range(2 * nv, state.shape[0]):
        out[k] = state[k] + step_size * slope[k]
