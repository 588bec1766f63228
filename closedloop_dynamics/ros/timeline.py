# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Distinguishes stamps of a run from jumps in time and from stamps that are wrong."""


class Timeline:
    """
    Tells stamps that belong to a run from jumps in time and from stamps that are wrong.

    One stamp far from the others is odd; when several in a row are, and near one another, time has
    jumped: another bag, a simulator that was reset, a pause of the machine. ``newest``: of the
    run [s], or None. A stamp may be ``ahead`` of that one, and ``behind`` [s]; ``several`` odd
    ones make a jump.
    """

    def __init__(self, ahead, behind, several):
        self.newest, self._odd = None, []
        self._ahead, self._behind, self._several = ahead, behind, several

    def follows(self, time):
        """Return whether a stamp belongs to the run; None where a new run begins with it."""
        if self.newest is None or -self._behind <= time - self.newest <= self._ahead:
            self.newest, self._odd = max(time, self.newest or time), []
            return True
        if self._odd and abs(time - self._odd[-1]) > self._ahead:
            self._odd = []
        self._odd.append(time)
        if len(self._odd) < self._several:
            return False
        self.newest, self._odd = time, []
        return None
