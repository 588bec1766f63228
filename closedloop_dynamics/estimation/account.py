# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Account of readings: whether they are as the model says, and what would explain it if not."""

from collections import deque
import math
from typing import Any, Deque, Dict, List, Sequence, Tuple

import numpy as np
from scipy.stats import chi2

from .filtering import Columns
from .measuring import Measuring
from .results import Alarm, Consistency, Innovation, SensorAccount

# Readings in a window of normalised innovations, and how seldom it leaves its bounds.
WINDOW, SELDOM = 200, 1e-6
# A sensor is silent where nothing has come for so many of its periods.
SILENT = 5.0
# Instants that are weighed together for a suspect.
INSTANTS = 1000
# Counts of a sensor.
ACCEPTED, GATED, LATE, REFUSED = range(4)


class Account:
    """What has become of readings, from a time on."""

    def __init__(self, measuring: Measuring, columns: Columns, time: float) -> None:
        self._measuring, self._columns = measuring, columns
        self._counts = {name: 4 * [0] for name in measuring.sensors}
        self._windows: Dict[str, Deque[float]] = {
            name: deque(maxlen=WINDOW) for name in measuring.sensors}
        self._latest = dict.fromkeys(measuring.sensors, time)
        self._scores: Deque[Any] = deque(maxlen=INSTANTS)
        count = len(columns.suspected)
        self._score, self._weight = np.zeros(count), np.zeros(count)

    def add(self, found: Sequence[Innovation], score: Any) -> None:
        """Take the innovations of an instant, and what they say of suspects."""
        for one in found:
            counts = self._counts[one.sensor]
            counts[ACCEPTED if one.accepted else GATED] += 1
            counts[LATE] += one.late
            self._windows[one.sensor].append(one.nis)
            self._latest[one.sensor] = max(self._latest[one.sensor], one.time)
        if score is not None and len(self._score):
            if len(self._scores) == INSTANTS:
                self._weigh(self._scores[0], -1.0)
            self._scores.append(score)
            self._weigh(score, 1.0)

    def forget(self, found: Sequence[Innovation], score: Any) -> None:
        """Take back the last instant, whose readings are used again."""
        for one in found:
            counts = self._counts[one.sensor]
            counts[ACCEPTED if one.accepted else GATED] -= 1
            counts[LATE] -= one.late
            if self._windows[one.sensor]:
                self._windows[one.sensor].pop()
        if score is not None and self._scores:
            self._weigh(self._scores.pop(), -1.0)

    def refuse(self, name: str) -> None:
        """Count a reading that could not be taken."""
        self._counts[name][REFUSED] += 1

    def _weigh(self, score: Any, sign: float) -> None:
        self._score += sign * score[0]
        self._weight += sign * score[1]

    def consistency(self, time: float) -> Consistency:
        """Return how the sensors have fared at a time."""
        found = {}
        for name, window in self._windows.items():
            size, sensor = self._measuring.sizes[name] * len(window), self._measuring.sensors[name]
            bounds = tuple(float(chi2.ppf(share, size)) / size if size else limit
                           for share, limit in ((0.5 * SELDOM, 0.0), (1.0 - 0.5 * SELDOM, (
                               math.inf))))
            silent = sensor.rate is not None and time - self._latest[name] > (
                SILENT / sensor.rate + sensor.latency)
            found[name] = SensorAccount(
                *self._counts[name], silent, sum(window) / size if size else math.nan, bounds)
        return Consistency(found)

    def alarms(self, time: float) -> Tuple[Alarm, ...]:
        """Return what no longer fits at a time, the likeliest first."""
        found: List[Alarm] = []
        if len(self._score):
            weight = np.maximum(self._weight, 0.0)
            seen = weight > 0.0
            likelihood = np.where(seen, self._score ** 2 / np.where(seen, weight, 1.0), 0.0)
            limit = chi2.isf(SELDOM, 1)
            for place in np.argsort(-likelihood):
                if not likelihood[place] > limit:
                    break
                unknown, name = self._columns.suspects[place]
                value, deviation = (self._score[place] / weight[place], weight[place] ** -0.5)
                found.append(Alarm(
                    unknown.KIND, name, float(value), float(deviation), float(likelihood[place]),
                    time, f'{name} ({unknown.KIND}): measurements are explained by a change of '
                    f'{value:.4g} +- {deviation:.2g}'))
        if not found:
            for name, one in self.consistency(time).sensors.items():
                if one.consistent:
                    continue
                larger = one.nis > one.bounds[1]
                found.append(Alarm(
                    'model' if larger else 'sensor', name, math.nan, math.nan, math.nan, time,
                    f'{name}: innovations squared are {one.nis:.3g} of what is expected, between '
                    f'{one.bounds[0]:.3g} and {one.bounds[1]:.3g}: ' + (
                        'the sensor or the model is wrong, or noise is larger than specified'
                        if larger else 'noise is smaller than specified')))
        return tuple(found)
