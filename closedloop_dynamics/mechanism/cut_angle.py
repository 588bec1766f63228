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

"""The angle of a joint in space that closes a loop: what it is counted from."""

import numpy as np

from .mechanism import UNTURNED
from .validation import turned_by

# Sine of the angle between two axes below which they are parallel.
PARALLEL = 1e-12


def frame_at_zero(cut):
    """
    Return how the bodies of a cut joint that turns lie at zero.

    Parameters
    ----------
    cut : CutJoint
        In space, with an axis.

    Returns
    -------
    axis, side, there : ndarray, shape (3,)
        The axis in body B; a direction of body A across its axis, and where that is in body B.

    """
    side = _across(np.array(cut.axis_a))
    return np.array(cut.axis_b), side, _at_zero(cut, side)


def _across(axis):
    """Return a direction across an axis."""
    found = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    return found / np.linalg.norm(found)


def _at_zero(cut, side):
    """Return where a direction of body A, across its axis, is in body B at zero."""
    if cut.orientation != UNTURNED:
        return turned_by(cut.orientation, side)
    # The shortest way from one axis to the other.
    one, other = np.array(cut.axis_a), np.array(cut.axis_b)
    normal = np.cross(one, other)
    sine = np.linalg.norm(normal)
    if sine < PARALLEL:
        # Turned over about the direction itself where they are opposite.
        return side
    normal /= sine
    along, beside = np.cross(one, normal), np.cross(other, normal)
    return (side @ normal) * normal + (side @ along) * beside
