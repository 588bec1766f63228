# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What estimators return: beliefs, estimates, innovations, consistency and alarms."""

from dataclasses import dataclass
from typing import Any, Dict, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from ..kinematics.state import State
from ..mechanism.fields import among, nearest


class Belief(NamedTuple):
    """
    What is thought at a time.

    Attributes
    ----------
    time : float
        [s].
    state : State
        Of the model with the loads that are unknown.
    independent : tuple of str
        Freedoms whose displacements and rates the covariance is of.
    names : tuple of str
        Of the unknown numbers, those of loads and of the scene, then errors of sensors.
    values : ndarray, shape (m,)
        Of the unknown numbers.
    covariance : ndarray, shape (2 k + m, 2 k + m)
        Of displacements and rates of the independent freedoms and of the unknown numbers.
    command : ndarray
        Torques that act from then on [N m or N].

    """

    time: float
    state: State
    independent: Tuple[str, ...]
    names: Tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    command: np.ndarray

    @property
    def unknowns(self) -> 'Estimated':
        """Return the unknown numbers with their standard deviations."""
        count = len(self.names)
        own = self.covariance[len(self.covariance) - count:, len(self.covariance) - count:]
        return Estimated(self.names, self.values, np.sqrt(own.diagonal()), own)


class Estimated(NamedTuple):
    """
    Numbers with standard deviations, by name.

    Attributes
    ----------
    names : tuple of str
    value, deviation : ndarray, shape (n,), or (n, d) where a name has d numbers
    covariance : ndarray or None
        Of all numbers in their order.

    """

    names: Tuple[str, ...]
    value: np.ndarray
    deviation: np.ndarray
    covariance: Optional[np.ndarray] = None

    def of(self, name: str) -> Tuple[Any, Any]:
        """Return value and standard deviation of a name."""
        if name not in self.names:
            raise KeyError(f'expected one of {among(self.names) or "no names"}, got {name!r}. '
                           f'{nearest(name, self.names)}'.rstrip('. '))
        place = self.names.index(name)
        return self.value[place], self.deviation[place]


@dataclass(frozen=True)
class Estimate:
    """
    All that is estimated at a time, with standard deviations.

    Attributes
    ----------
    time : float
    positions, rates, accelerations : Estimated
        Of all freedoms of the tree [rad, m; and per s, s^2]; deviations of orientations are of
        turns about the axes of the child, and their values zero (``state`` has quaternions).
    cut_positions : Estimated
        Of all freedoms of cut joints that have a number.
    points : Estimated
        Of the named points [m].
    joint_forces : Estimated
        Wrenches in joints that are not fixed, and in cut joints, as ``Simulation.force`` [N m,
        N]; without names where forces do not follow from the motion.
    unknowns : Estimated
        Loads, numbers of the scene and errors of sensors.
    state : State

    """

    time: float
    positions: Estimated
    rates: Estimated
    accelerations: Estimated
    cut_positions: Estimated
    points: Estimated
    joint_forces: Estimated
    unknowns: Estimated
    state: State


class Innovation(NamedTuple):
    """
    What a sensor read beside what was expected.

    Attributes
    ----------
    time : float
        When the reading was true [s].
    sensor : str
    value : ndarray, shape (d,)
        Read less expected.
    covariance : ndarray, shape (d, d)
        As expected.
    nis : float
        Normalised innovation squared, of chi-squared distribution with d freedoms.
    accepted : bool
        Whether it was used.
    reason : str
        Why not: ``'gated'``, ``'too late'``, ``'out of reach'`` of the loops; '' where it was.
    late : bool
        Whether later ones had been used before.

    """

    time: float
    sensor: str
    value: np.ndarray
    covariance: np.ndarray
    nis: float
    accepted: bool
    reason: str = ''
    late: bool = False


class SensorAccount(NamedTuple):
    """
    How a sensor has fared.

    Attributes
    ----------
    accepted, gated, late, refused : int
        Readings used; left out as outliers; used, but late; too late or not finite.
    silent : bool
        Whether it has been silent for longer than its rate says.
    nis : float
        Mean of the normalised innovations squared in the present window, by degree of freedom;
        NaN before there are any. 1 is expected.
    bounds : tuple of 2 floats
        Between which that lies but once in a million windows.

    """

    accepted: int
    gated: int
    late: int
    refused: int
    silent: bool
    nis: float
    bounds: Tuple[float, float]

    @property
    def consistent(self) -> bool:
        """Whether the mean lies in its bounds; so far, where there are no readings."""
        return not (self.nis < self.bounds[0] or self.nis > self.bounds[1])


@dataclass(frozen=True)
class Consistency:
    """
    Whether the model explains the measurements.

    Attributes
    ----------
    sensors : dict of str to SensorAccount

    """

    sensors: Mapping[str, SensorAccount]

    @property
    def silent(self) -> Tuple[str, ...]:
        """Return the sensors that have fallen silent."""
        return tuple(name for name, one in self.sensors.items() if one.silent)

    @property
    def consistent(self) -> bool:
        """Return whether all sensors are."""
        return all(one.consistent for one in self.sensors.values())


@dataclass(frozen=True)
class Observability:
    """
    What sensors can show along a motion.

    Attributes
    ----------
    deviations : dict of str to float
        Of each displacement and rate at the start of the motion (``position.crank``,
        ``rate.crank``) and of each unknown: the standard deviation that it is known with at the
        end, by measurements alone; infinite where it is not known by itself.
    combinations : tuple of studies.identification.Combination
        Of which only the sum is known, to first order.
    unseen : tuple of str
        Without any influence on what is measured.

    """

    deviations: Mapping[str, float]
    combinations: Tuple[Any, ...]
    unseen: Tuple[str, ...]

    @property
    def unknown(self) -> Tuple[str, ...]:
        """Return the names of what is not known by itself."""
        return tuple(name for name, one in self.deviations.items() if not np.isfinite(one))


class Alarm(NamedTuple):
    """
    What no longer fits.

    Attributes
    ----------
    kind : str
        ``'sensor'``, ``'length'``, ``'friction'``, ``'load'``, ``'mass'``, ``'gravity'``,
        ``'number'``; ``'model'`` where none of the suspects explains it.
    name : str
        Of the sensor, the unknown or the number that would explain it best.
    value, deviation : float
        How large the change would be, in its unit; NaN where nothing explains it.
    likelihood : float
        Twice the logarithm of how much likelier the measurements are with that change.
    time : float
        [s].
    message : str

    """

    kind: str
    name: str
    value: float
    deviation: float
    likelihood: float
    time: float
    message: str


@dataclass(frozen=True)
class Record:
    """
    A record of a motion: when, under which torques, and what was measured.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Growing [s].
    torques : ndarray, shape (n, number of joints that take a command)
        From each time to the next [N m or N].
    measurements : dict of str to ndarray, shape (n,) or (n, d)
        By sensor; NaN where there is none.

    """

    times: np.ndarray
    torques: np.ndarray
    measurements: Dict[str, np.ndarray]

    def __post_init__(self) -> None:
        """Take arrays, and refuse times that do not grow and other shapes."""
        times = np.array(self.times, dtype=float)
        if times.ndim != 1 or not len(times) or not np.isfinite(times).all():
            raise ValueError(f'times: expected finite numbers, got {self.times!r}')
        wrong = np.flatnonzero(~(np.diff(times) > 0.0))
        if len(wrong):
            k = int(wrong[0])
            raise ValueError(f'times: expected growing ones, got {times[k + 1]:g} s after '
                             f'{times[k]:g} s (row {k + 1})')
        torques = np.array(self.torques, dtype=float).reshape(len(times), -1) if (
            np.size(self.torques)) else np.zeros((len(times), 0))
        if not np.isfinite(torques).all():
            raise ValueError('torques: expected finite numbers, got others among them')
        measured = {}
        for name, values in self.measurements.items():
            array = np.array(values, dtype=float)
            if len(array) != len(times):
                raise ValueError(f'measurements: {name}: expected {len(times)} rows, one for each '
                                 f'time, got {len(array)}')
            measured[name] = array.reshape(len(times), -1)
        for key, value in ('times', times), ('torques', torques), ('measurements', measured):
            object.__setattr__(self, key, value)

    def rows(self, k: int) -> Dict[str, np.ndarray]:
        """Return what was measured at a time, by sensor."""
        return {name: values[k] for name, values in self.measurements.items()
                if not np.isnan(values[k]).any()}


def deviations(matrix: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return standard deviations of numbers that change as a matrix says, (n,)."""
    return np.sqrt(np.maximum(np.einsum('ij,jk,ik->i', matrix, covariance, matrix), 0.0))


def named(names: Sequence[str], value: np.ndarray, matrix: np.ndarray,
          covariance: np.ndarray) -> Estimated:
    """Return numbers with their standard deviations."""
    flat = deviations(matrix.reshape(-1, matrix.shape[-1]), covariance)
    return Estimated(tuple(names), value, flat.reshape(np.shape(value)))
