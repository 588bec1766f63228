# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Whole records: the smoother, and the fit of all instants at once that is its twin.

The smoother of Rauch, Tung and Striebel (1965) goes back along the filter: with what is thought
before and after a period, x and x', P and P', and the transition F between them,

    C = P F^T P'^-1,    x_s = x + C (x'_s - x'),    P_s = P + C (P'_s - P') C^T

differences and sums being those of the manifold. The fit looks for the likeliest motion of all,

    min  |x_0 - start|^2 / P_0 + sum |w_k|^2 / Q_k + sum |y_k - h(x_k)|^2 / R_k

with x_k+1 = f(x_k) + w_k, by Gauss and Newton's method: each step is linear, and solved for all
instants by one sparse factorisation, with multipliers Q^-1 w, so that parts without noise, such
as constants, are exact.
"""

from dataclasses import dataclass
from typing import Any, Callable, List, Optional, Sequence, Tuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .errors import EstimationError
from .estimator import Estimator, Noise
from .filtering import Now, Prediction
from .results import Alarm, Belief, Consistency, Estimate, Record
from ..simulation.model import Model

# The fit ends where no change is larger than this share of a deviation, after so many steps at
# most.
CONVERGED, MOST_STEPS = 1e-8, 30


@dataclass(frozen=True, eq=False)
class Smoothed:
    """
    A motion as estimated from the whole of a record.

    Attributes
    ----------
    beliefs : tuple of Belief
        At each time of the record, from all measurements.
    filtered : tuple of Belief
        From those up to then.
    consistency : Consistency
        Of the filter at the end of the record.
    alarms : tuple of Alarm
    iterations : int
        Of ``fit``; 0 of ``smooth``.

    """

    beliefs: Tuple[Belief, ...]
    filtered: Tuple[Belief, ...]
    consistency: Consistency
    alarms: Tuple[Alarm, ...]
    iterations: int
    _estimates: Callable[[int], Estimate]

    def estimate(self, k: int) -> Estimate:
        """Return all that is estimated at a time of the record, by its number."""
        return self._estimates(range(len(self.beliefs))[k])


class _Pass:
    """The filter over a record, with what leads from each instant to the next."""

    def __init__(self, estimator: Estimator, record: Record,
                 progress: Optional[Callable[[float], None]]) -> None:
        self.estimator, self.record = estimator, record
        if len(record.torques.T) != len(estimator.commanded):
            raise ValueError(f'torques: expected {len(estimator.commanded)} columns, for '
                             f'{", ".join(estimator.commanded) or "no joint"}, got '
                             f'{record.torques.shape[1]}')
        for name, values in record.measurements.items():
            if name not in estimator.readable:
                raise ValueError(f'measurements: expected some of '
                                 f'{", ".join(estimator.readable)}, got {name!r}')
        self.readings = [{name: estimator.reading(name, value)
                          for name, value in record.rows(k).items()}
                         for k in range(len(record.times))]
        late = [one.name for one in estimator.sensors if one.latency]
        if late:
            raise ValueError(
                f'{late[0]}: expected measurements at the times when they were true, and sensors '
                'without latency; subtract it from their times')
        if not np.isclose(record.times[0], estimator.time, rtol=0.0, atol=1e-9):
            raise ValueError(f'times: expected the first one at the start, {estimator.time:g} s, '
                             f'got {record.times[0]:g} s')
        #: Of each instant: before its readings, and after them; and how the next one follows.
        self.before: List[Now] = []
        self.after: List[Now] = []
        self.accepted: List[Any] = []
        self.steps: List[List[Prediction]] = []
        now = estimator.belief_at_work
        for k, torque in enumerate(record.torques):
            self.before.append(now)
            now, used = estimator.taken(now._replace(command=torque), self.readings[k])
            self.accepted.append({name: self.readings[k][name] for name in used})
            self.after.append(now)
            if k + 1 < len(record.times):
                steps = estimator.filter.steps(now, float(record.times[k + 1]))
                self.steps.append(steps)
                now = steps[-1].now
            if progress is not None:
                progress((k + 1) / len(record.times))

    def smoothed(self) -> List[Now]:
        """Return what is thought at each instant, from all readings."""
        filter_, found = self.estimator.filter, [self.after[-1]]
        for k in reversed(range(len(self.steps))):
            later = found[-1]
            chain = [self.after[k], *(one.now for one in self.steps[k])]
            for before, step in zip(reversed(chain[:-1]), reversed(self.steps[k])):
                cross = before.covariance @ step.transition.T
                gain = np.linalg.solve(step.now.covariance, cross.T).T
                change = filter_.apart(later, step.now)
                covariance = before.covariance + gain @ (
                    later.covariance - step.now.covariance) @ gain.T
                filter_.plant.take(before.independent)
                later = filter_.moved(before, gain @ change)._replace(
                    covariance=0.5 * (covariance + covariance.T))
            found.append(later)
        return found[::-1]


def smooth(model: Model, sensors: Sequence[Any], record: Record, unknowns: Sequence[Any] = (),
           noise: Noise = Noise(), start: Any = None, *,
           progress: Optional[Callable[[float], None]] = None, **settings: Any) -> Smoothed:
    """
    Estimate a motion from a record: the filter forwards, then Rauch, Tung and Striebel's smoother.

    Parameters
    ----------
    model, sensors, unknowns, noise, start, **settings
        As for ``Estimator``; sensors without latency.
    record : Record
        From the time of the start on.
    progress : callable, optional
        Called with the share that is done.

    Returns
    -------
    Smoothed

    """
    estimator = Estimator(model, sensors, unknowns, noise, start, **settings)
    forward = _Pass(estimator, record, progress)
    return _result(forward, forward.smoothed(), 0)


def fit(model: Model, sensors: Sequence[Any], record: Record, unknowns: Sequence[Any] = (),
        noise: Noise = Noise(), start: Any = None, *,
        progress: Optional[Callable[[float], None]] = None, **settings: Any) -> Smoothed:
    """
    Estimate a motion from a record all at once: the likeliest one, by Gauss and Newton's method.

    Parameters
    ----------
    model, sensors, record, unknowns, noise, start, progress, **settings
        As for ``smooth``. Readings that the filter leaves out are left out.

    Returns
    -------
    Smoothed
        Whose covariances are those of the smoother about the likeliest motion.

    Raises
    ------
    EstimationError
        Where it does not settle.

    """
    estimator = Estimator(model, sensors, unknowns, noise, start, **settings)
    forward = _Pass(estimator, record, progress)
    motion = forward.smoothed()
    for iteration in range(1, MOST_STEPS + 1):
        motion, largest = _Newton(forward, motion).moved()
        if largest <= CONVERGED:
            return _result(forward, motion, iteration)
    raise EstimationError(
        f'fit: the likeliest motion was not found in {MOST_STEPS} steps, of which the last one '
        f'changed it by {largest:.3g} deviations; begin nearer to it, or give the noise that the '
        'model has')


class _Newton:
    """One step of Gauss and Newton's method from a motion."""

    def __init__(self, forward: _Pass, motion: Sequence[Now]) -> None:
        self._forward, self._motion = forward, motion
        self._filter = forward.estimator.filter
        self._size = len(motion[0].covariance)

    def moved(self) -> Tuple[List[Now], float]:
        """Return a likelier motion, and the largest change in deviations."""
        n, motion = self._size, self._motion
        count = len(motion)
        hessian, right = [np.zeros((n, n)) for _ in motion], np.zeros((count, n))
        first = self._forward.before[0]
        inverse = np.linalg.inv(first.covariance)
        hessian[0] += inverse
        right[0] -= inverse @ self._filter.apart(motion[0], first)
        for k, now in enumerate(motion):
            readings = self._forward.accepted[k]
            if not readings:
                continue
            self._filter.plant.take(now.independent)
            residual, slope, _, noise = self._filter.linear(now, readings, tuple(readings))
            hessian[k] += (slope / noise[:, np.newaxis]).T @ slope
            right[k] += slope.T @ (residual / noise)
        transitions, noises, gaps = self._dynamics()
        change = _solved(hessian, right, transitions, noises, gaps)
        largest = max(float(np.abs(one / np.sqrt(now.covariance.diagonal())).max())
                      for one, now in zip(change, motion))
        found = []
        for now, one in zip(motion, change):
            self._filter.plant.take(now.independent)
            found.append(self._filter.moved(now, one))
        return found, largest

    def _dynamics(self) -> Tuple[List[np.ndarray], List[np.ndarray], List[np.ndarray]]:
        """Return transitions, noises and what each instant is beyond where the model leads."""
        found: Tuple[List[np.ndarray], List[np.ndarray], List[np.ndarray]] = ([], [], [])
        for now, later in zip(self._motion, self._motion[1:]):
            noise, transition = np.zeros((self._size, self._size)), np.eye(self._size)
            steps = self._filter.steps(now, later.time)
            for step in steps:
                transition = step.transition @ transition
                noise = step.transition @ noise @ step.transition.T + step.noise
            reached = steps[-1].now
            if reached.independent != later.independent:
                raise EstimationError('fit: independent coordinates change on another way here')
            for part, value in zip(found, (transition, noise, self._filter.apart(later, reached))):
                part.append(value)
        return found


def _solved(hessian: Sequence[np.ndarray], right: np.ndarray, transitions: Sequence[np.ndarray],
            noises: Sequence[np.ndarray], gaps: Sequence[np.ndarray]) -> np.ndarray:
    """Return the changes of all instants, shape (count, n), by one sparse factorisation."""
    count, n = right.shape
    blocks: List[List[Any]] = [[None] * (2 * count - 1) for _ in range(2 * count - 1)]
    for k in range(count):
        blocks[2 * k][2 * k] = hessian[k]
    whole = np.zeros((2 * count - 1, n))
    whole[::2] = right
    for k, (transition, noise, gap) in enumerate(zip(transitions, noises, gaps)):
        # Multipliers stand between the instants that they join.
        row = 2 * k + 1
        blocks[row][row] = -noise
        blocks[row][row - 1], blocks[row - 1][row] = -transition, -transition.T
        blocks[row][row + 1] = blocks[row + 1][row] = np.eye(n)
        whole[row] = -gap
    matrix = sparse.block_array(blocks, format='csc')
    return splu(matrix).solve(whole.ravel()).reshape(-1, n)[::2]


def _result(forward: _Pass, motion: Sequence[Now], iterations: int) -> Smoothed:
    """Return what was found."""
    estimator = forward.estimator
    return Smoothed(
        tuple(map(estimator.believed, motion)), tuple(map(estimator.believed, forward.after)),
        estimator.consistency, estimator.alarms, iterations,
        lambda k: estimator.estimate_of(motion[k]))
