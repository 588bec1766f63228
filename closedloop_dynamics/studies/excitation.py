# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Motions from which parameters can be distinguished.

Each measured joint follows a Fourier series of the period T that begins, and ends, at rest in the
scene's start, q0:

    q(t) = q0 + sum_k a_k sin(2 pi k t / T) + b_k (cos(2 pi k t / T) - 1),    sum_k k a_k = 0

Of the series with a given amplitude the one is sought whose regressor, its columns scaled by
parameters of usual sizes, has the least condition number (Swevers et al. 1997): the best of some
at random, then improved by Powell's method, which needs no derivatives.
"""

import math
from typing import Dict, NamedTuple, Tuple

import numpy as np

from .identification import DEPENDENT, IdentificationError, Identifier, measured_joints
from ..mechanism.errors import SimulationError
from ..simulation.data import Data

# Instants at which a motion is looked at, and motions at random to begin with.
INSTANTS, RANDOM = 40, 12
# Logarithm of the condition number that stands for a motion that the mechanism cannot make.
IMPOSSIBLE = 50.0


class Series(NamedTuple):
    """A Fourier series."""

    start: float  # q0 [rad or m]
    #: ``sines``, ``cosines``: a_k and b_k [rad or m].
    sines: Tuple[float, ...]
    cosines: Tuple[float, ...]
    period: float  # T [s]

    def at(self, time):
        """Return position, rate and acceleration, shape (3, n), at times, shape (n,) [s]."""
        found = np.zeros((3, len(time)))
        found[0] = self.start
        for k, (a, b) in enumerate(zip(self.sines, self.cosines), 1):
            rate = 2.0 * math.pi * k / self.period
            sine, cosine = np.sin(rate * time), np.cos(rate * time)
            found += (a * sine + b * (cosine - 1.0), rate * (a * cosine - b * sine),
                      -rate ** 2 * (a * sine + b * cosine))
        return found

    def __str__(self):
        """Return it as an expression in t, as prescribed motions take it."""
        text = repr(self.start)
        for k, (a, b) in enumerate(zip(self.sines, self.cosines), 1):
            rate = repr(2.0 * math.pi * k / self.period)
            text += f' + {a!r}*sin({rate}*t) + {b!r}*(cos({rate}*t) - 1)'
        return text.replace('+ -', '- ')


class Excitation(NamedTuple):
    """
    A motion to identify parameters from.

    Attributes
    ----------
    series : dict of str to Series
        By joint.
    condition : float
        Condition number of the regressor, its columns scaled by parameters of usual sizes.
    first : float
        The same of the first motion at random that the mechanism can make.

    """

    series: Dict[str, Series]
    condition: float
    first: float


def excite(scene, keys, period, amplitude=0.3, harmonics=3, evaluations=150, joints=None, seed=0):
    """
    Find a motion that shows parameters well.

    Parameters
    ----------
    scene, keys
        As for ``identification.identify``.
    period : float
        Of the motion [s].
    amplitude : float
        The most that a joint moves away from its start [rad or m].
    harmonics : int
        Terms of each series, 2 or more.
    evaluations : int
        Motions tried, about.
    joints : sequence of str, optional
        That determine all others; ``identification.measured_joints`` where not given.
    seed : int
        Of the motions at random.

    Returns
    -------
    Excitation

    Raises
    ------
    IdentificationError
        Where the mechanism can make none of the motions tried.
    ValueError
        For numbers and keys that make no sense.

    """
    for name, value in (('period', period), ('amplitude', amplitude)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f'{name}: expected a finite number > 0, got {value!r}')
    if harmonics < 2:
        raise ValueError(f'harmonics: expected 2 or more, got {harmonics!r}')
    joints = tuple(joints or measured_joints(scene))
    data, time = Data(scene), np.linspace(0.0, period, INSTANTS, endpoint=False)
    coordinates, fine = scene.mechanism.coordinates, np.linspace(0.0, period, 20 * harmonics)
    starts = [float(data.position[coordinates.place[coordinates.index[name]]])
              for name in joints]

    shape = len(joints), 2 * harmonics - 1

    def motion(numbers):
        found = {}
        for name, start, own in zip(joints, starts, np.reshape(numbers, shape)):
            cosines, rest = own[:harmonics], own[harmonics:]
            sines = np.array([-np.arange(2, harmonics + 1) @ rest, *rest])
            size = np.abs(Series(0.0, sines, cosines, period).at(fine)[0]).max()
            scale = amplitude / size if size > 0.0 else 0.0
            found[name] = Series(start, tuple((scale * sines).tolist()),
                                 tuple((scale * cosines).tolist()), period)
        return found

    return _best(scene, keys, motion, time, math.prod(shape), evaluations, seed)


def _best(scene, keys, motion, time, size, evaluations, seed):
    """Return the best motion of those tried."""
    from scipy.optimize import minimize
    reasons, rank = [], 0

    def sizes(numbers):
        series = motion(numbers)
        try:
            influence = Identifier(
                scene, keys, {name: one.at(time) for name, one in series.items()}).influence()
        except (IdentificationError, SimulationError) as error:
            reasons.append(str(error))
            return None
        return np.linalg.svd(influence.reshape(-1, influence.shape[2]), compute_uv=False)

    def cost(values):
        # Where fewer sums of parameters are seen than elsewhere, the last one is not.
        if values is None or not values[rank - 1] > 0.0:
            return IMPOSSIBLE
        return math.log(values[0] / values[rank - 1])

    random = np.random.default_rng(seed)
    tried = [(numbers, sizes(numbers)) for numbers in random.normal(size=(RANDOM, size))]
    possible = [(numbers, values) for numbers, values in tried if values is not None]
    if not possible:
        raise IdentificationError(
            f'amplitude: expected a motion that the mechanism can make, got none of {RANDOM}; '
            f'take a smaller one ({reasons[0]})')
    rank = max(int(np.sum(values > DEPENDENT * values[0])) for _, values in possible)
    if rank == 0:
        raise IdentificationError('keys: expected a number with an influence on the motion, got '
                                  'none')
    begin, _ = min(possible, key=lambda pair: cost(pair[1]))
    best = [cost(sizes(begin)), begin]

    def improve(numbers):
        found = cost(sizes(numbers))
        if found < best[0]:
            best[:] = found, numbers.copy()
        return found

    if evaluations > RANDOM:
        minimize(improve, begin, method='Powell', options={'maxfev': evaluations - RANDOM})
    return Excitation(motion(best[1]), math.exp(best[0]), math.exp(cost(possible[0][1])))
