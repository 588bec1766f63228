# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Delayed commands on their way to the drives."""

from collections import deque
import math

import numpy as np


class DelayLine:
    """Joint torques of which some arrive late."""

    def __init__(self):
        # What is on the way.
        self.pending = deque()

    def order(self, time, tau, delays, present):
        """
        Add a command, joint torques of shape (nv,), given at a time [s].

        ``delays`` [s] are those of every joint that has one; ``present`` are the torques acting so
        far.
        """
        ordered = present.copy()
        for _, joint, value in sorted(self.pending):
            ordered[joint] = value
        for joint in np.flatnonzero(tau != ordered):
            self.pending.append((time + delays.get(int(joint), 0.0), int(joint), tau[joint]))

    def due(self, time, tolerance, present):
        """Return the torques that act from a time on, given those acting so far, shape (nv,)."""
        acting = present.copy()
        for item in sorted(self.pending):
            if item[0] <= time + tolerance:
                acting[item[1]] = item[2]
                self.pending.remove(item)
        return acting

    def wait(self, time):
        """Return how long until a command is due [s]; infinity where none is on the way."""
        return min(self.pending)[0] - time if self.pending else math.inf
