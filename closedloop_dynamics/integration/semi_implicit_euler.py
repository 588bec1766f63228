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
from ..core.manifold import move, rates_begin


@compiled
def step(manifold, state, nv, step_size, slope, out, lanes):
    """
    Advance a state by one step: rates first, then coordinates with the new rates.

    Parameters
    ----------
    manifold : Manifold or None
        Of the mechanism; rotations go on by what the new angular velocity turns in a step.
    state : ndarray, shape (lanes * ns,)
        Coordinates, rates, and what effects add.
    nv : int
        Number of rates.
    step_size : float
        [s].
    slope : ndarray, shape (lanes * ns,)
        At ``state``.
    out : ndarray, shape (lanes * ns,)
        Written in place.
    lanes : int
        So many states are stored side by side (``core.manifold``).

    """
    first = lanes * rates_begin(manifold, nv)
    for i in range(first):
        out[i] = state[i]
    for k in range(first, state.shape[0]):
        out[k] = state[k] + step_size * slope[k]
    move(manifold, out[:first], out[first:], step_size, lanes)
