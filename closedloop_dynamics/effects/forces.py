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

"""What the laws of forces at points share."""

from ..core.compiled import inlined
from ..core.types import COS, FX, FY, FZ, SIN


@inlined
def offset(body, row, x, y):
    """
    Return the offset of a point from its body's origin, in world axes [m].

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``.
    row : int
        Of the body, 0 for the ground.
    x, y : float
        Place in the body's frame [m].

    """
    return (body[row, COS] * x - body[row, SIN] * y, body[row, SIN] * x + body[row, COS] * y)


@inlined
def push(body, row, rx, ry, fx, fy):
    """
    Apply a force to a body.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        The bias force, columns FZ to FY, is reduced.
    row : int
        Of the body.
    rx, ry : float
        Offset of the point of attack from the body's origin, world axes [m].
    fx, fy : float
        World axes [N].

    """
    body[row, FZ] -= rx * fy - ry * fx
    body[row, FX] -= fx
    body[row, FY] -= fy
