# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Which states of a motion have to be kept so that straight lines between them show it.

Paths and plots of the kept ones are those of all states: curves bend as they do, and a force that
is large in one state only is there.
"""

import numpy as np

# How far a line may pass by a state: as a share of the range of what is plotted with it, and, of
# places, of the mechanism's size. Ranges are at least this share of the numbers themselves.
OF_RANGE, OF_SIZE, LEAST_RANGE = 1e-3, 5e-4, 1e-3
# States after which the ranges are looked at again; the weight of old ones is halved after so many
# states.
CHECK_EVERY, HALVED = 16, 4096


class Thinning:
    """
    Finds the states that straight lines between their neighbours would miss.

    ``plots``: quantities that are plotted; those drawn by their logarithms decide nothing;
    ``points``: number of the points whose places are before them; ``size``: of the mechanism [m];
    ``coarse``: factor of the tolerances.

    From the last state kept, the line to a new one is allowed where its slopes lie between those
    that pass by all states since within the tolerance (swinging doors; E. H. Bristol, 1990).
    """

    def __init__(self, plots, points, size, coarse=1.0):
        numbers = {}
        self._group = np.array([numbers.setdefault((plot.group, plot.unit), len(numbers))
                                for plot in plots], dtype=int)
        self._silent = np.array([plot.log for plot in plots], dtype=bool)
        self._first = 3 * points
        count = self._first + len(plots)
        self._tolerance = np.zeros(count)
        self._tolerance[:self._first] = coarse * OF_SIZE * size
        self._share = coarse * OF_RANGE
        self._ranges = np.zeros(len(numbers))
        self._low, self._high = np.full(count, np.nan), np.full(count, np.nan)
        self._kept = self._last = None
        self._least, self._most = np.empty(count), np.empty(count)
        self._seen = 0

    def keep(self, time, values):
        """Begin the lines at a state that is kept anyway."""
        self._kept = self._last = time, values
        self._least.fill(-np.inf)
        self._most.fill(np.inf)

    def misses(self, time, values):
        """
        Return whether the state before has to be kept; this one may be the next.

        ``values``, shape (3 points + plots,): places, and what is plotted. Where the time [s] does
        not rise, the lines begin again.
        """
        self._update_ranges(values)
        if self._kept is None or time <= self._last[0]:
            self.keep(time, values)
            return False
        slope, passed = self._slope(time, values)
        missed = bool(((slope < self._least) | (slope > self._most)).any())
        if missed:
            self.keep(*self._last)
            slope, passed = self._slope(time, values)
        # NaN, which is drawn as a gap, decides nothing.
        room = self._tolerance / passed
        np.fmax(self._least, slope - room, out=self._least)
        np.fmin(self._most, slope + room, out=self._most)
        self._last = time, values
        return missed

    def _slope(self, time, values):
        passed = time - self._kept[0]
        return (values - self._kept[1]) / passed, passed

    def _update_ranges(self, values):
        np.fmin(self._low, values, out=self._low)
        np.fmax(self._high, values, out=self._high)
        if self._seen % CHECK_EVERY == 0:
            least = np.nan_to_num(np.abs(values[self._first:]))
            ranges = np.fmax(np.nan_to_num(self._high - self._low)[self._first:],
                             LEAST_RANGE * least)
            self._ranges.fill(0.0)
            np.maximum.at(self._ranges, self._group, ranges)
            self._tolerance[self._first:] = np.where(
                self._silent, np.inf, self._share * self._ranges[self._group])
            # Peaks of long ago do not hide those of today.
            forget = 1.0 - 0.5 ** (CHECK_EVERY / HALVED)
            self._low += forget * (values - self._low)
            self._high += forget * (values - self._high)
        self._seen += 1
