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

from ..core.compiled import inlined, merged
from ..effects.course import end_of_piece, SAME_TIME
from ..effects.table import (
    PRESCRIBED_FORCE, PRESCRIBED_MOTION, PRESCRIBED_TORQUE, SPATIAL_PRESCRIBED_FORCE, STATE)

# Kinds of effects that may follow the time.
OVER_TIME = PRESCRIBED_FORCE, PRESCRIBED_MOTION, PRESCRIBED_TORQUE, SPATIAL_PRESCRIBED_FORCE


@inlined
def _of_time(effects, row):
    """Return whether an effect follows the time."""
    kind = effects.kind[row]
    return effects.enabled[row] == 1 and (
        kind == PRESCRIBED_TORQUE or kind == PRESCRIBED_FORCE
        or kind == SPATIAL_PRESCRIBED_FORCE
        or (kind == PRESCRIBED_MOTION and effects.values[row, 1] == 0.0))


@merged
def until_next(effects, own):
    """
    Return how long it is until the next corner.

    Parameters
    ----------
    effects : EffectTable
        Of the system.
    own : ndarray, shape (nz,)
        The effects' own states where a step begins.

    Returns
    -------
    float
        [s]; infinity where there is none.

    """
    wait = math.inf
    for row in range(effects.kind.shape[0]):
        if _of_time(effects, row):
            state = effects.index[row, STATE]
            piece = int(math.floor(own[state + 1] + 0.5))
            wait = min(wait, end_of_piece(
                effects, row, effects.values[row, 0], piece) - own[state])
    return wait


@merged
def pass_corners(effects, own):
    """
    Let the next pieces begin after a step that has ended at a corner.

    Parameters
    ----------
    effects : EffectTable
        Of the system.
    own : ndarray, shape (nz,)
        The effects' own states after the step; corrected in place.

    """
    for row in range(effects.kind.shape[0]):
        if _of_time(effects, row):
            state = effects.index[row, STATE]
            limit = own[state] + SAME_TIME * max(1.0, abs(own[state]))
            piece = int(math.floor(own[state + 1] + 0.5))
            while end_of_piece(effects, row, effects.values[row, 0], piece) <= limit:
                piece += 1
            own[state + 1] = piece
