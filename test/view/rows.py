# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What is in the rows that a page has."""

import struct

from closedloop_dynamics.mechanism.rotations import of_quaternion
import numpy as np


def rows_of(frame, width):
    """Return times and rows of a frame's samples and of the frame."""
    _, count, time = struct.unpack('<IId', frame[:16])
    values = np.frombuffer(frame[16:], dtype=np.float32)
    samples = values[width:].reshape(count, width + 1)
    return np.append(time + samples[:, 0], time), np.vstack([samples[:, 1:], values[:width]])


def places_of(point, rows):
    """Return where a point, as described, is in rows, shape (n, 3)."""
    poses = rows[:, 7 * point['body']:][:, :7].astype(float)
    return poses[:, :3] + np.einsum(
        'nij,j->ni', [of_quaternion(turn) for turn in poses[:, 3:]], point['place'])
