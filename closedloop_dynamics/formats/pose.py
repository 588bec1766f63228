# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Places and turns of frames."""

from typing import NamedTuple

import numpy as np


class Pose(NamedTuple):
    """
    Where one frame is in another.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Columns: the axes of the frame.
    position : ndarray, shape (3,)
        Of its origin [m].

    """

    rotation: np.ndarray
    position: np.ndarray

    def __matmul__(self, other):
        """Return the pose of a frame that is given in this one."""
        return Pose(self.rotation @ other.rotation, self.place(other.position))

    def place(self, point):
        """Return where a point of this frame is, shape (3,)."""
        return self.rotation @ point + self.position

    @property
    def inverse(self):
        """Return the pose of the other frame in this one."""
        return Pose(self.rotation.T, -(self.rotation.T @ self.position))


IDENTITY = Pose(np.eye(3), np.zeros(3))


def unturned(position):
    """Return the pose of a frame that is at a place, its axes as those of the other."""
    return Pose(np.eye(3), np.array(position))
