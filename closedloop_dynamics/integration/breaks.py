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

"""
The instants at which the course of a force over time has corners.

Every step ends where the next corner is, so that within a step the force is one smooth function
and every method keeps its order.

"""

import math

from ..core.compiled import compiled, inlined
from ..core.manifold import rates_begin
from ..effects.course import end_of_piece, SAME_TIME
from ..effects.table import (
    PRESCRIBED_FORCE, PRESCRIBED_MOTION, PRESCRIBED_TORQUE, SPATIAL_PRESCRIBED_FORCE, STATE)


@inlined
def _own(system):
    """Return the place of the first of the effects' own states."""
    nv = system.qdd.shape[0]
    return rates_begin(system.manifold, nv) + nv


@inlined
def _of_time(effects, row):
    """Return whether an effect follows the time."""
    kind = effects.kind[row]
    return effects.enabled[row] == 1 and (
        kind == PRESCRIBED_TORQUE or kind == PRESCRIBED_FORCE
        or kind == SPATIAL_PRESCRIBED_FORCE
        or (kind == PRESCRIBED_MOTION and effects.values[row, 1] == 0.0))


# As in ``system``: numba drops the branches below for data that are None.

@compiled
def _until_next(data, effects, own):
    """Return how long it is until the next corner; infinity where there is none."""
    wait = math.inf
    if data is not None:
        wait = _least_wait(effects, own)
    return wait


@compiled
def _least_wait(effects, own):
    """Return how long it is until the next corner."""
    wait = math.inf
    for row in range(effects.kind.shape[0]):
        if _of_time(effects, row):
            state = effects.index[row, STATE]
            piece = int(math.floor(own[state + 1] + 0.5))
            wait = min(wait, end_of_piece(
                effects, row, effects.values[row, 0], piece) - own[state])
    return wait


@inlined
def until_next(effects, system, state):
    """
    Return how long it is until the next corner.

    Parameters
    ----------
    effects : EffectTable or None
        Of the system.
    system : System
        Model and workspace of the mechanism.
    state : ndarray, shape (ns,)
        Where a step begins.

    Returns
    -------
    float
        [s]; infinity where there is none.

    """
    if effects is None:
        return math.inf
    return _until_next(effects.data, effects, state[_own(system):])


@compiled
def _pass(data, effects, own):
    """Count the pieces that have been passed, where a scene has machine elements."""
    if data is not None:
        _count_pieces(effects, own)


@compiled
def _count_pieces(effects, own):
    """Count the pieces that have been passed."""
    for row in range(effects.kind.shape[0]):
        if _of_time(effects, row):
            state = effects.index[row, STATE]
            limit = own[state] + SAME_TIME * max(1.0, abs(own[state]))
            piece = int(math.floor(own[state + 1] + 0.5))
            while end_of_piece(effects, row, effects.values[row, 0], piece) <= limit:
                piece += 1
            own[state + 1] = piece


@inlined
def pass_corners(effects, system, state):
    """
    Let the next pieces begin after a step that has ended at a corner.

    Parameters
    ----------
    effects, system
        As for ``until_next``.
    state : ndarray, shape (ns,)
        After the step; corrected in place.

    """
    if effects is not None:
        _pass(effects.data, effects, state[_own(system):])
