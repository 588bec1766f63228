# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Prediction and update of a belief: an error-state Kalman filter on states that close the loops.

Errors are displacements and rates of the independent coordinates, e = (dq, dqd), followed by those
of the unknown numbers. With the Jacobians of a step, F, and of readings, H:

    P' = F P F^T + Q,    K = P H^T (H P H^T + R)^-1,    P = P' - K H P'

The mean makes the steps of the engine, and is moved along the manifold by corrections, the
dependent coordinates closing the loops. Where readings are nonlinear, the update is iterated
(Gauss and Newton's method; Bell and Cathey 1993).

Suspects are changes f that are not estimated: a signature s is how the error of the estimate
would follow f, s' = F s + D f, and g = H s + H_f what innovations it would leave, s = s' - K g
(generalised likelihood ratio; Willsky and Jones 1976). With the innovations v, of covariance S,
the likeliest f is (sum g^T S^-1 v) / (sum g^T S^-1 g).
"""

import math
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np
from scipy.stats import chi2

from .errors import EstimationError
from .measuring import Measuring, Reading, View
from .plant import Plant
from .results import Innovation
from .unknowns import Bias
from ..engine import native
from ..mechanism.errors import SimulationError

# Longest period that is stepped at once [s]: noise is taken to be even in it.
LONGEST_PERIOD = 0.02
# Instants nearer to one another are the same [s].
SAME_TIME = 1e-9
# Lengths of periods whose noise is kept.
MOST_NOISES = 64
# Updates are iterated so often at most, until changes are below this share of a deviation.
MOST_ITERATIONS, CONVERGED = 8, 1e-3


class Now(NamedTuple):
    """A belief as it is worked with; its arrays are never written again."""

    time: float
    q: np.ndarray
    qd: np.ndarray
    values: np.ndarray  # Of all numbers, estimated and suspected, then of errors of sensors
    covariance: np.ndarray
    independent: Tuple[str, ...]
    command: np.ndarray
    signature: np.ndarray  # Shape (n, suspects)
    own: np.ndarray  # States of the effects


class Prediction(NamedTuple):
    """A belief a period later, and how it follows from the one before."""

    now: Now
    transition: np.ndarray  # Shape (n, n)
    noise: np.ndarray  # Shape (n, n)


class Layout(NamedTuple):
    """How the numbers of sensors stand in a row, and memory to work with."""

    first: np.ndarray  # Where those of each sensor begin, and their end
    gates: np.ndarray  # Largest squares of each sensor that are used
    places: List[slice]
    nonlinear: bool  # Whether any of them depend nonlinearly on the state
    scratch: Tuple[np.ndarray, ...]


class Columns:
    """
    Which columns of derivatives are of what is estimated, and which are of suspects.

    Columns are 2 k of the state, numbers, then errors of sensors; of both the estimated ones come
    first.
    """

    def __init__(self, unknowns: Sequence[Any], suspects: Sequence[Any]) -> None:
        numbers, errors = ([[one for one in group if isinstance(one, Bias) == is_error]
                            for group in (unknowns, suspects)] for is_error in (False, True))
        self.numbers, self.errors = ([*group[0], *group[1]] for group in (numbers, errors))
        counts = [sum(len(one.components) for one in part) for group in (numbers, errors)
                  for part in group]
        starts = np.cumsum([0, *counts])
        parts = [list(range(first, last)) for first, last in zip(starts, starts[1:])]
        #: Places among the values of the estimated ones, and of the suspects.
        self.known, self.suspected = (np.array(parts[n] + parts[n + 2], dtype=int)
                                      for n in (0, 1))
        self.count = int(starts[2])
        own = [one for group in (numbers[0], errors[0]) for one in group]
        self.names = tuple(name for one in own for name in one.components)
        self.deviations = np.array([value for one in own for value in one.deviations])
        self.suspected_deviations = np.array([
            value for group in (numbers[1], errors[1]) for one in group
            for value in one.deviations])
        self.walks = np.square([value for one in own for value in one.densities])
        self.suspects = tuple((one, name) for group in (numbers[1], errors[1]) for one in group
                              for name in one.components)
        self.all = not len(self.suspected)
        #: Those of them that are numbers, not errors of sensors.
        self.numbers_known, self.numbers_suspected = (
            part[part < self.count] for part in (self.known, self.suspected))


class Filter:
    """Predictions and updates of beliefs of a plant with sensors."""

    def __init__(self, plant: Plant, measuring: Measuring, columns: Columns, noise: Any,
                 gate: float) -> None:
        self.plant, self.measuring, self.columns, self.noise = plant, measuring, columns, noise
        self._noises: Dict[float, np.ndarray] = {}
        self._layouts: Dict[Tuple[str, ...], Layout] = {}
        self._gates = {name: chi2.ppf(gate, size) for name, size in measuring.sizes.items()}

    def predicted(self, now: Now, time: float) -> Now:
        """Return what is thought at a later time, by the model alone."""
        return self.steps(now, time)[-1].now

    def steps(self, now: Now, time: float) -> List[Prediction]:
        """Return predictions up to a later time, over periods in which noise is even."""
        parts = max(1, math.ceil((time - now.time) / LONGEST_PERIOD - SAME_TIME))
        start, duration, found = now.time, (time - now.time) / parts, []
        for n in range(1, parts + 1):
            found.append(self.step(now, time if n == parts else start + n * duration))
            now = found[-1].now
        return found

    def step(self, now: Now, time: float) -> Prediction:
        """Return a prediction over one period, with the independent coordinates that serve."""
        plant, columns = self.plant, self.columns
        if plant.by_points:
            return self._step_by_points(now, time)
        plant.take(now.independent)
        # Periods that differ by rounding alone are one.
        period = round(time - now.time, 12)
        q, qd, by_state, by_number, by_torque = plant.step(
            now.q, now.qd, now.values[:columns.count], now.command, period)
        states, n, signature = len(by_state), len(now.covariance), now.signature
        if n == states:
            transition = by_state.copy()
        else:
            transition = np.eye(n)
            transition[:states, :states] = by_state
            known = columns.numbers_known
            transition[:states, states:states + len(known)] = by_number[:, known]
        if not columns.all:
            signature = transition @ signature
            own = columns.numbers_suspected
            signature[:states, :len(own)] += by_number[:, own]
        noise = self._noise_of(period, n, states, by_torque)
        covariance = transition @ now.covariance @ transition.T
        covariance += noise
        return self._in_good_coordinates(Prediction(Now(
            time, q, qd, now.values, covariance, plant.independent, now.command, signature,
            now.own), transition, noise))

    def _in_good_coordinates(self, found: Prediction) -> Prediction:
        """Return a prediction in other independent coordinates, where these serve no more."""
        plant, columns, (now, transition, noise) = self.plant, self.columns, found
        if not plant.outgrown(now.q, now.qd):
            return found
        turned, states, signature = np.eye(len(transition)), plant.size, now.signature
        basis = plant.exchanged(now.q, now.qd, now.values[:columns.count])
        known, own = columns.numbers_known, columns.numbers_suspected
        turned[:states, :states] = basis[:, :states]
        turned[:states, states:states + len(known)] = basis[:, states + known]
        if not columns.all:
            signature = turned @ signature
            signature[:states, :len(own)] += basis[:, states + own]
        return Prediction(now._replace(
            covariance=turned @ now.covariance @ turned.T, independent=plant.independent,
            signature=signature), turned @ transition, turned @ noise @ turned.T)

    def points(self, now: Now) -> Tuple[np.ndarray, List[Now]]:
        """Return changes to states around a mean, in pairs, and these states, the mean first."""
        size = len(now.covariance)
        try:
            root = np.linalg.cholesky(now.covariance).T * math.sqrt(size)
        except np.linalg.LinAlgError:
            raise EstimationError(
                'Sigma points: the covariance is not positive definite; a joint that friction '
                'holds has no noise from torques. Give Noise(acceleration=...), too.') from None
        changes = np.ascontiguousarray(np.concatenate((root, -root)))
        self.plant.take(now.independent)
        return changes, [now, *(self.moved(now, one) for one in changes)]

    def _step_by_points(self, now: Now, time: float) -> Prediction:
        """Return a prediction from motions that begin around the mean (a spherical cubature)."""
        plant, columns = self.plant, self.columns
        period = time - now.time
        changes, points = self.points(now)
        mean, *reached = [self._after(one, period) for one in points]
        apart = np.array([self.apart(one, mean) for one in reached])
        middle = apart.mean(axis=0)
        apart -= middle
        by_torque, signature = np.zeros((plant.size, len(plant.torques))), now.signature
        if self.noise.torque:
            # As large as noise is, held for the period.
            sizes = np.full(len(plant.commanded), self.noise.torque / math.sqrt(period))
            by_torque[:, plant.command] = self._slopes_of(
                lambda one: self.apart(self._after(one, period), mean), sizes, [
                    now._replace(command=now.command + push) for push in np.diag(sizes)]
            )[:plant.size]
        noise = self._noise_of(period, len(middle), plant.size, by_torque)
        transition = np.linalg.solve(now.covariance, changes.T @ apart / len(apart)).T
        if not columns.all:
            signature = transition @ signature + self._slopes_of(
                lambda one: self.apart(self._after(one, period), mean), *self._suspected(now))
        return self._in_good_coordinates(Prediction(self.moved(mean, middle)._replace(
            time=time, covariance=apart.T @ apart / len(apart) + noise, signature=signature),
            transition, noise))

    def _after(self, now: Now, period: float) -> Now:
        """Return where a motion leads by the engine; effects have the states that they had."""
        q, qd, own = self.plant.after(now.time, now.q, now.qd, now.values[:self.columns.count],
                                      now.command, period, now.own)
        return now._replace(q=q, qd=qd, own=own)

    def _suspected(self, now: Now) -> Tuple[np.ndarray, List[Now]]:
        """Return deviations of suspects, and the beliefs in which each is changed by its own."""
        columns, tried = self.columns, []
        for place, size in zip(columns.suspected, columns.suspected_deviations):
            values = now.values.copy()
            values[place] += size
            tried.append(now._replace(values=values))
        return columns.suspected_deviations, tried

    @staticmethod
    def _slopes_of(found: Callable[[Now], np.ndarray], sizes: np.ndarray,
                   tried: Sequence[Now]) -> np.ndarray:
        """Return what changes by each of some sizes lead to, as slopes, shape (n, sizes)."""
        return np.array([found(one) for one in tried]).T / sizes

    def _noise_of(self, period: float, size: int, states: int,
                  by_torque: np.ndarray) -> np.ndarray:
        """Return the covariance of what the noise of a period adds, shape (size, size)."""
        noise, k = self.noise, states // 2
        pushed = bool(noise.torque and by_torque.size)
        # The noise of accelerations and walks is the same in all periods of one length.
        found = None if pushed else self._noises.get(period)
        if found is not None:
            return found
        found = np.zeros((size, size))
        if noise.acceleration:
            # White accelerations, integrated.
            density, flat = noise.acceleration ** 2, found.reshape(-1)
            step = size + 1
            flat[:k * step:step] = density * period ** 3 / 3.0
            flat[k:k * step:step] = flat[k * size:2 * k * size:step] = density * period ** 2 / 2.0
            flat[k * step:2 * k * step:step] = density * period
        if pushed:
            own = by_torque[:, self.plant.command]
            found[:states, :states] += noise.torque ** 2 / period * (own @ own.T)
        if len(self.columns.walks):
            places = np.arange(states, size)
            found[places, places] += self.columns.walks * period
        if not pushed:
            if len(self._noises) >= MOST_NOISES:
                self._noises.clear()
            self._noises[period] = found
        return found

    def linear(self, now: Now, readings: Mapping[str, np.ndarray],
               names: Tuple[str, ...]) -> Tuple[np.ndarray, ...]:
        """Return residuals, slopes by what is estimated and by suspects, variances of readings."""
        measuring, columns = self.measuring, self.columns
        if self._by_points(names):
            expected, middle, *slopes = self._read_by_points(now, names)
            return measuring.residuals(names, [readings[name] for name in names], [
                one.value for one in expected]) - middle, *slopes
        plain = measuring.plain(names)
        if plain is not None:
            places, rows, noise, rates = plain
            numbers = now.values[:columns.count]
            self.plant.put(numbers)
            basis = self.plant.basis(now.q, now.qd, numbers)
            given = np.concatenate([readings[name] for name in names])
            slope = basis[rows]
            state = np.concatenate((now.q, now.qd)) if rates else now.q
            residual = given - state[places]
            if columns.all:
                return residual, slope, slope[:, :0], noise
            return residual, *self._parted(slope), noise
        found = self.read(now, names)
        residual = measuring.residuals(names, [readings[name] for name in names], [
            one.value for one in found])
        slope = np.concatenate([one.slope for one in found])
        noise = np.concatenate([measuring.noise[name] for name in names])
        if columns.all:
            return residual, slope, slope[:, :0], noise
        return residual, *self._parted(slope), noise

    def slopes(self, now: Now, names: Sequence[str]) -> Tuple[np.ndarray, np.ndarray]:
        """Return slopes by what is estimated, and variances, of sensors."""
        if self._by_points(names):
            _, _, slope, _, noise = self._read_by_points(now, names)
            return slope, noise
        slope = np.concatenate([one.slope for one in self.read(now, names)])
        return (self._parted(slope)[0],
                np.concatenate([self.measuring.noise[name] for name in names]))

    def _by_points(self, names: Sequence[str]) -> bool:
        """Return whether readings follow from accelerations that have no derivatives."""
        return self.plant.by_points and any(self.measuring.felt[name] for name in names)

    def _read_by_points(self, now: Now, names: Sequence[str]) -> Tuple[Any, ...]:
        """
        Return readings of the mean, how far they are from the mean reading, slopes, variances.

        Slopes by what is estimated and by suspects; their nonlinearity is added to the noise.
        """
        measuring, (changes, points) = self.measuring, self.points(now)
        expected = self.felt_readings(now, names)
        middle_values = [one.value for one in expected]

        def away(one: Now) -> np.ndarray:
            return measuring.residuals(names, [
                each.value for each in self.felt_readings(one, names)], middle_values)

        apart = np.array([away(one) for one in points[1:]])
        middle = apart.mean(axis=0)
        apart -= middle
        slope = np.ascontiguousarray(np.linalg.solve(
            now.covariance, changes.T @ apart / len(apart)).T)
        bent = np.mean(np.square(apart), axis=0) - np.einsum(
            'ij,jk,ik->i', slope, now.covariance, slope)
        noise = np.concatenate([measuring.noise[name] for name in names])
        suspected = np.zeros((len(noise), 0)) if self.columns.all else np.ascontiguousarray(
            self._slopes_of(away, *self._suspected(now)))
        return expected, middle, slope, suspected, noise + np.maximum(bent, 0.0)

    def felt_readings(self, now: Now, names: Sequence[str]) -> List[Reading]:
        """Return what sensors are expected to read in a state, without slopes."""
        count, measuring = self.columns.count, self.measuring
        view = measuring.felt_view(now.time, now.q, now.qd, now.values[:count], now.command)
        return [measuring.read(name, view, now.values[count:]) for name in names]

    def read(self, now: Now, names: Sequence[str]) -> List[Reading]:
        """Return what sensors are expected to read."""
        plant, measuring, count = self.plant, self.measuring, self.columns.count
        numbers, errors = now.values[:count], now.values[count:]
        plant.put(numbers)
        basis = plant.basis(now.q, now.qd, numbers)
        view = View(plant, measuring.code, now.q, now.qd, numbers, now.command, basis)
        return [measuring.read(name, view, errors) for name in names]

    def _parted(self, slope: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return slopes by what is estimated, and by suspects."""
        states = self.plant.size
        known = np.concatenate((np.arange(states), states + self.columns.known))
        return tuple(np.ascontiguousarray(slope[:, part]) for part in (
            known, states + self.columns.suspected))

    def updated(self, now: Now, readings: Mapping[str, np.ndarray], late: bool = False
                ) -> Tuple[Now, List[Innovation], Any]:
        """
        Return what is thought after readings, and what they were beside what was expected.

        And what that says of suspects, or None: sums of g^T S^-1 v, and of g^T S^-1 g.
        """
        plant, columns = self.plant, self.columns
        plant.take(now.independent)
        used, found = tuple(readings), []
        residual, slope, suspected, noise = self.linear(now, readings, used)
        left = suspected if columns.all else suspected + slope @ now.signature
        layout = self._layout_of(used)
        squares, white, spread, whitened, change, covariance = _corrected(
            now.covariance, slope, residual, noise, layout, left)
        accepted = []
        for name, own, gate, nis in zip(used, layout.places, layout.gates.tolist(),
                                        squares.tolist()):
            good = nis <= gate
            found.append(Innovation(now.time, name, residual[own], spread[own, own], nis, good,
                                    '' if good else 'gated', late))
            if good:
                accepted.append(name)
        if not accepted:
            return now, found, None
        score, signature = None, now.signature
        if not columns.all:
            score = left.T @ white, np.einsum('ij,ij->j', left, left)
            signature = signature - whitened.T @ left
        try:
            point = self.moved(now, change, near=True)
        except SimulationError:
            # Nowhere near: what was read, or thought, is wrong.
            return now, [one._replace(accepted=False, reason=one.reason or 'out of reach')
                         for one in found], None
        if layout.nonlinear:
            scale = CONVERGED * np.sqrt(now.covariance.diagonal())
            used = tuple(accepted)
            layout = self._layout_of(used)
            layout = layout._replace(gates=np.full(len(used), np.inf))
            for _ in range(MOST_ITERATIONS - 1):
                residual, slope, left, noise = self.linear(point, readings, used)
                before = change
                change, covariance = _corrected(
                    now.covariance, slope, residual + slope @ change, noise, layout, left)[-2:]
                point = self.moved(now, change, near=True)
                if (np.abs(change - before) <= scale).all():
                    break
        return point._replace(covariance=covariance, signature=signature), found, score

    def _layout_of(self, names: Tuple[str, ...]) -> Layout:
        """Return how the numbers of sensors stand in a row."""
        if names not in self._layouts:
            first = np.cumsum([0, *(self.measuring.sizes[name] for name in names)])
            places = [slice(*first[n:n + 2].tolist()) for n in range(len(names))]
            size = int(first[-1])
            self._layouts[names] = Layout(
                first, np.array([self._gates[name] for name in names]), places,
                any(self.measuring.nonlinear[name] for name in names),
                (np.empty((size, size)), np.empty(len(names)), np.empty(size)))
        return self._layouts[names]

    def moved(self, now: Now, change: np.ndarray, near: bool = False) -> Now:
        """Return a belief whose mean is changed, the loops closed; ``near``: as of ``Plant``."""
        columns, states = self.columns, 2 * len(now.independent)
        values = now.values
        if len(columns.known):
            values = values.copy()
            values[columns.known] += change[states:]
        q, qd = self.plant.plus(now.q, now.qd, change[:states], values[:columns.count], near)
        return now._replace(q=q, qd=qd, values=values)

    def apart(self, now: Now, other: Now) -> np.ndarray:
        """Return the change that leads from another belief's mean to one's, in its coordinates."""
        self.plant.take(other.independent)
        return np.concatenate((
            self.plant.stepper.minus(now.q, now.qd, other.q, other.qd),
            (now.values - other.values)[self.columns.known]))


def _corrected(covariance: np.ndarray, slope: np.ndarray, residual: np.ndarray,
               noise: np.ndarray, layout: Layout, others: np.ndarray) -> Tuple[np.ndarray, ...]:
    """Return squares, white residuals, spread, whitened slopes, change, covariance (engine)."""
    (m, n), (factors, squares, white) = slope.shape, layout.scratch
    spread, whitened, change, after = (
        np.empty((m, m)), np.empty((m, n)), np.empty(n), np.empty((n, n)))
    if not native.correct_errors(
            covariance, slope, residual, noise, layout.first, layout.gates, spread, factors,
            squares, whitened, white, others, change, after):
        raise EstimationError(
            'The covariance of readings is not positive definite: rounding errors are larger '
            'than the noise. Give the sensors larger deviations, or the start smaller ones.')
    return squares, white, spread, whitened, change, after
