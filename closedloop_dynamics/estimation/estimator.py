# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The state of a mechanism, and what is unknown of it, from measurements as they come.

An error-state extended Kalman filter on the manifold of states that close the loops: errors are
displacements and rates of the independent coordinates, which the others follow, and changes of the
unknown numbers. Between measurements the engine makes the steps, and their Jacobians.
"""

from collections import abc, deque
from dataclasses import dataclass
import math
from typing import Any, Deque, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from .account import Account
from .everything import Everything
from .filtering import Columns, Filter, Now, SAME_TIME
from .measuring import Measuring, View
from .observability import observability
from .plant import Plant, PointsPlant
from .results import Alarm, Belief, Consistency, Estimate, Innovation, Observability
from .sensors import AnySensor, LONGEST_DELAY
from .unknowns import AnyUnknown
from ..kinematics.state import State
from ..mechanism.checks import not_negative, one_of, positive, probability
from ..mechanism.fields import among, at, nearest, normalise
from ..scene.records import Method
from ..simulation.model import Model

EXTENDED, SIGMA_POINTS = 'extended', 'sigma_points'
# Share of good readings that is used.
GATE = 0.9999


@dataclass(frozen=True)
class Noise:
    """
    What the model does not know of the motion: white noise.

    Attributes
    ----------
    acceleration : float
        Density of accelerations of the independent coordinates, zero or more [rad/s^2/sqrt(Hz),
        m/s^2/sqrt(Hz)].
    torque : float
        Density of torques in the joints that take a command, zero or more [N m/sqrt(Hz) or
        N/sqrt(Hz)].

    """

    acceleration: float = 0.0
    torque: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        normalise(self, acceleration=not_negative, torque=not_negative)


@dataclass(frozen=True)
class Start:
    """
    What is thought at the start.

    Attributes
    ----------
    state : State or None
        The scene's start where none is given.
    position, rate : float
        Standard deviations of the independent coordinates [rad or m], and of their rates [rad/s or
        m/s], positive.
    time : float or None
        [s]; that of the state where none is given.

    """

    state: Optional[State] = None
    position: float = 0.02
    rate: float = 0.2
    time: Optional[float] = None

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        normalise(self, position=positive, rate=positive)


class Event(NamedTuple):
    """What came at a time: a command, or readings by sensor."""

    time: float
    command: Optional[np.ndarray]
    readings: Mapping[str, np.ndarray]
    late: bool = False


class Entry(NamedTuple):
    """An event of the past, and what was thought and found after it."""

    event: Event
    after: Now
    found: List[Innovation]
    score: Any  # Of suspects


class Estimator:
    """
    Estimates the state of a mechanism, forces in its joints and what is unknown, as it moves.

    Parameters
    ----------
    model : Model
        As far as the mechanism is known.
    sensors : sequence of sensors.Sensor
    unknowns : sequence of unknowns.Unknown
    noise : Noise
    start : Start, State or Belief, optional
        A belief of an estimator with the same unknowns continues it.
    method : str
        ``'extended'``: by derivatives. ``'sigma_points'``: by states around the mean, for effects
        that jump, such as dry friction, contacts and stops.
    suspects : sequence of unknowns.Unknown
        Changes that alarms may name: what is believed to be as the model has it, and is not
        estimated. Their densities are of no account, and their deviations but with sigma points,
        where changes as large as these are tried.
    gate : float
        Probability with which a good reading is used; others are outliers.
    integrator : str, mapping or Method
        Of the steps, as for ``Stepper``.

    Raises
    ------
    EstimationError, SimulationError
        Where effects have no derivatives, with their names, and the method is ``'extended'``.
    ValueError
        For sensors and unknowns that do not fit the mechanism.

    Examples
    --------
    >>> estimator = Estimator(model, [JointSensor('encoder', joint='crank', deviation=1e-4)],
    ...                       [Payload('tool', body='platform', deviation=1.0)], Noise(0.1))
    >>> estimator.command(0.0, {'crank': 2.0})
    >>> estimator.measure(0.001, 'encoder', 0.302)
    >>> estimator.estimate().joint_forces.of('elbow')

    """

    def __init__(self, model: Model, sensors: Sequence[AnySensor],
                 unknowns: Sequence[AnyUnknown] = (), noise: Noise = Noise(),
                 start: Union[None, Start, State, Belief] = None, method: str = EXTENDED, *,
                 suspects: Sequence[AnyUnknown] = (), gate: float = GATE,
                 integrator: Union[str, Mapping[str, Any], Method] = 'rk4') -> None:
        if not isinstance(model, Model):
            raise TypeError(f'Estimator: expected a Model, as Model.from_scene returns it, got '
                            f'{model!r}')
        self.method = one_of((EXTENDED, SIGMA_POINTS))(method)
        by_points = method == SIGMA_POINTS
        with at('gate'):
            gate = probability(gate)
        self.sensors, self.unknowns, self.noise = tuple(sensors), tuple(unknowns), noise
        columns = Columns(unknowns, suspects)
        self._plant = plant = (PointsPlant if by_points else Plant)(
            model.scene, columns.numbers, integrator)
        self._measuring = Measuring(plant, sensors, columns.errors)
        self.filter = Filter(plant, self._measuring, columns, noise, gate)
        self._columns, self.model = columns, plant.model
        self.restart(start)
        self._everything: Optional[Everything] = None

    def restart(self, start: Union[None, Start, State, Belief] = None) -> None:
        """
        Begin again, with nothing counted and no command.

        Parameters
        ----------
        start : Start, State or Belief, optional
            As at the beginning.

        """
        self._now = self._begun(start)
        # The last while, and what was thought before that.
        self._past: Deque[Entry] = deque()
        self._base = self._now
        self._account = Account(self._measuring, self._columns, self._now.time)

    def _begun(self, start: Any) -> Now:
        """Return what is thought at the start."""
        plant, columns = self._plant, self._columns
        values = np.zeros(columns.count + len(columns.errors))
        values[:columns.count] = plant.start
        command = np.zeros(len(plant.commanded))
        if isinstance(start, Belief):
            if start.names != columns.names:
                raise ValueError(f'start: expected a belief of {among(columns.names) or "nothing"}'
                                 f', got one of {among(start.names) or "nothing"}')
            values[columns.known] = start.values
            plant.put(values[:columns.count])
            plant.take(start.independent)
            return Now(start.time, np.array(start.state.q), np.array(start.state.qd), values,
                       np.array(start.covariance, order='C'), plant.independent,
                       np.array(start.command),
                       np.zeros((len(start.covariance), len(columns.suspected))),
                       np.array(start.state.own))
        if start is None or isinstance(start, State):
            start = Start(start)
        if not isinstance(start, Start):
            raise TypeError(f'start: expected a Start, a State or a Belief, got {start!r}')
        state = plant.model.assemble() if start.state is None else start.state
        plant.require_state(state)
        half = plant.size // 2
        covariance = np.diag(np.square(
            [*half * (start.position,), *half * (start.rate,), *columns.deviations]))
        time = float(state.time) if start.time is None else float(start.time)
        return Now(time, np.array(state.q), np.array(state.qd), values, covariance,
                   plant.independent, command,
                   np.zeros((len(covariance), len(columns.suspected))), plant.own)

    # What comes in.

    def command(self, time: float, torque: Any) -> None:
        """
        Have torques from a time on, until the next command.

        Parameters
        ----------
        time : float
            [s]; up to 0.2 s ago.
        torque : mapping, or sequence in the order of ``commanded``
            [N m or N]; of joints that are not named none.

        Raises
        ------
        ValueError
            For unknown joints, numbers that are not finite, and times longer ago.

        """
        found = self._torques(torque)
        self._require_time('command', time)
        oldest = max(self._base.time, self._now.time - LONGEST_DELAY)
        if time < oldest - SAME_TIME:
            raise ValueError(f'command: expected a time after {oldest:g} s, got {time:g} s')
        self._take(Event(float(time), found, {}))

    def measure(self, time: float, sensor: str, value: Any) -> Innovation:
        """
        Take a reading.

        Parameters
        ----------
        time : float
            When it is handed over [s]; it was true a latency earlier, up to 0.2 s ago.
        sensor : str
            Its name.
        value : float or sequence
            As the sensor has it.

        Returns
        -------
        Innovation
            With what became of it.

        Raises
        ------
        ValueError
            For unknown sensors and other shapes, and numbers that are not finite.

        """
        return self.measure_all(time, {sensor: value})[0]

    def measure_all(self, time: float, values: Mapping[str, Any]) -> List[Innovation]:
        """Take readings of several sensors of one time, as ``measure`` each."""
        groups: Dict[float, Dict[str, np.ndarray]] = {}
        self._require_time('measure', time)
        for name, value in values.items():
            if name not in self._measuring.sensors:
                known = self._measuring.sensors
                raise ValueError(f'measure: expected one of {among(known)}, got {name!r}. '
                                 f'{nearest(name, known)}'.rstrip('. '))
            given = self._measuring.given(name, value)
            if not (math.isfinite(given[0]) if len(given) == 1 else np.isfinite(given).all()):
                self._account.refuse(name)
                raise ValueError(f'measure: {name}: expected finite numbers, got {value!r}')
            latency = self._measuring.sensors[name].latency
            groups.setdefault(float(time) - latency, {})[name] = given
        found: List[Innovation] = []
        for true, readings in groups.items():
            if true < max(self._base.time, self._now.time - LONGEST_DELAY) - SAME_TIME:
                for name, given in readings.items():
                    self._account.refuse(name)
                    found.append(Innovation(true, name, np.full(self._measuring.sizes[name], (
                        math.nan)), np.full(2 * (self._measuring.sizes[name],), math.nan),
                        math.nan, False, 'too late', True))
                continue
            found += self._take(Event(true, None, readings))
        return found

    def advance(self, time: float) -> Belief:
        """Go on to a time without a reading, or stay where that is past; return the belief."""
        self._require_time('advance', time)
        if time > self._now.time:
            self._now = self.filter.predicted(self._now, float(time))
        return self.belief

    def _torques(self, torque: Any) -> np.ndarray:
        names = self._plant.commanded
        if isinstance(torque, abc.Mapping):
            for name in torque:
                if name not in names:
                    raise ValueError(f'command: expected some of {among(names) or "no joint"}, '
                                     f'got {name!r}. {nearest(name, names)}'.rstrip('. '))
            torque = [torque.get(name, 0.0) for name in names]
        found = np.array(torque, dtype=float)
        if found.shape != (len(names),) or not all(map(math.isfinite, found.tolist())):
            raise ValueError(f'command: expected {len(names)} finite numbers, for '
                             f'{among(names) or "no joint"}, got {torque!r}')
        return found

    @staticmethod
    def _require_time(what: str, time: float) -> None:
        if not (isinstance(time, (int, float, np.floating, np.integer)) and math.isfinite(time)):
            raise ValueError(f'{what}: expected a finite time [s], got {time!r}')

    # In order.

    def _take(self, event: Event) -> List[Innovation]:
        """Take an event, after those before it and, again, before those after it."""
        again: List[Event] = []
        while self._past and self._past[-1].event.time > event.time + SAME_TIME:
            entry = self._past.pop()
            again.append(entry.event)
            self._account.forget(entry.found, entry.score)
        now, target = self._now, max(self._now.time, event.time)
        if again or event.time < now.time - SAME_TIME:
            now, event = self._latest_before, event._replace(late=True)
        now, result = self._applied(now, event)
        for one in reversed(again):
            now, _ = self._applied(now, one)
        self._now = self.filter.predicted(now, target) if now.time < target - SAME_TIME else now
        while len(self._past) > 1 and self._past[1].event.time < target - LONGEST_DELAY:
            self._base = self._past.popleft().after
        return result

    @property
    def _latest_before(self) -> Now:
        """Return what was thought after the latest event that is kept."""
        return self._past[-1].after if self._past else self._base

    def _applied(self, now: Now, event: Event) -> Tuple[Now, List[Innovation]]:
        """Return what is thought after an event, and keep it."""
        if event.time > now.time + SAME_TIME:
            now = self.filter.predicted(now, event.time)
        found: List[Innovation] = []
        score = None
        if event.command is not None:
            now = now._replace(command=event.command)
        if event.readings:
            now, found, score = self.filter.updated(now, event.readings, event.late)
        self._past.append(Entry(event, now, found, score))
        self._account.add(found, score)
        return now, found

    def taken(self, now: Now, readings: Mapping[str, np.ndarray]) -> Tuple[Now, List[str]]:
        """Return what is thought after readings of a record, and which were used; count them."""
        found: List[Innovation] = []
        if readings:
            now, found, score = self.filter.updated(now, readings)
            self._account.add(found, score)
        self._now = now
        return now, [one.sensor for one in found if one.accepted]

    # What comes out.

    @property
    def belief_at_work(self) -> Now:
        """Return what is thought now, as it is worked with."""
        return self._now

    @property
    def readable(self) -> Tuple[str, ...]:
        """Return the names of the sensors."""
        return tuple(self._measuring.sensors)

    def reading(self, name: str, value: Any) -> np.ndarray:
        """Return a reading as an array, or refuse it."""
        return self._measuring.given(name, value)

    @property
    def commanded(self) -> Tuple[str, ...]:
        """Return the joints that take a command, in their order."""
        return self._plant.commanded

    @property
    def time(self) -> float:
        """Return the latest time [s]."""
        return self._now.time

    @property
    def belief(self) -> Belief:
        """Return what is thought now."""
        return self.believed(self._now)

    def believed(self, now: Now) -> Belief:
        """Return a belief as it is handed out."""
        state = self._plant.state(now.time, now.q, now.qd, now.own)
        return Belief(now.time, state, now.independent, self._columns.names,
                      now.values[self._columns.known], now.covariance.copy(), now.command.copy())

    @property
    def consistency(self) -> Consistency:
        """Return how the sensors have fared, and whether the model explains them."""
        return self._account.consistency(self._now.time)

    @property
    def alarms(self) -> Tuple[Alarm, ...]:
        """Return what no longer fits, the likeliest first; none where all is well."""
        return self._account.alarms(self._now.time)

    def observability(self, torques: Any = None, duration: float = 1.0,
                      period: float = 0.01) -> Observability:
        """
        Return what the sensors can show of the state and the unknowns along a motion from now on.

        Parameters
        ----------
        torques : array_like, shape (rows, number of ``commanded``), optional
            Each row acts for an equal share of the duration [N m or N]; none when not given.
        duration : float
            [s].
        period : float
            Between readings of all sensors [s].

        Returns
        -------
        Observability

        """
        for name, value in (('duration', duration), ('period', period)):
            with at(name):
                positive(value)
        self._plant.take(self._now.independent)
        rows = np.zeros((1, len(self.commanded))) if torques is None else np.array(
            torques, dtype=float).reshape(-1, len(self.commanded))
        names = (*(f'{what}.{name}' for what in ('position', 'rate')
                   for name in self._plant.independent), *self._columns.names)
        return observability(self.filter, self._now, names, rows, duration, period)

    def estimate(self) -> Estimate:
        """Return all that is estimated now, with standard deviations."""
        return self.estimate_of(self._now)

    def estimate_of(self, now: Now) -> Estimate:
        """Return all that is estimated of a belief at work."""
        plant, columns = self._plant, self._columns
        plant.take(now.independent)
        numbers = now.values[:columns.count]
        plant.put(numbers)
        if self._everything is None:
            self._everything = Everything(plant)
        if plant.by_points:
            return self._everything.estimate_by_points(
                self.filter.points(now)[1], self.believed(now), columns.count)
        basis = plant.basis(now.q, now.qd, numbers)
        known = columns.numbers_known
        size = plant.size + len(known)
        kept = np.concatenate((np.arange(plant.size), plant.size + known))
        view = View(plant, self._everything.code, now.q, now.qd, numbers, now.command, basis)
        return self._everything.estimate(
            view, self.believed(now), now.covariance[:size, :size], kept)
