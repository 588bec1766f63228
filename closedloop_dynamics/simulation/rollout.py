# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Many simulations of one scene at once: ``Simulation.rollout``."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
import os
import threading
from typing import Optional
from weakref import WeakKeyDictionary

import numpy as np

from .rollout_run import (
    checked_quantities, FEWEST, finding_of, fits_simd, InitialState, MOST, nothing, record,
    record_all, SimdRuns, starts_as_given, STATE, TimeGrid)
from ..engine.status import DONE
from ..engine.stop_flag import StopFlag
from ..mechanism.errors import SimulationError
from ..mechanism.named_array import by_shapes, NamedArray, reals
from ..scene.key_paths import changed, resolve
from ..scene.records import require_no_budget

# Runs, or vectors of them, that are made in one call, at most.
MOST_AT_ONCE = 64


@dataclass(frozen=True)
class Rollout:
    """
    Results of many simulations of one scene; NaN where a sample failed, from then on.

    Attributes
    ----------
    time : ndarray, shape (instants,)
        [s]; the first instant is the start.
    position : ndarray, shape (samples, instants, nq)
        Joint coordinates [rad or m].
    velocity : ndarray, shape (samples, instants, nv)
        Joint rates [rad/s or m/s].
    acceleration : ndarray, shape (samples, instants, nv)
        [rad/s^2 or m/s^2], under the torques acting up to the instant.
    effort : ndarray, shape (samples, instants, nv)
        Joint torques, behind the drives [N m or N].
    constraint_forces : ndarray, shape (samples, instants, number of cuts, 3), in space 6
        As ``Simulation.constraint_forces`` [N m, N].
    joint_forces : NamedArray, shape (samples, instants, number of joints, 3), in space 6
        As ``Simulation.joint_forces``, by joint [N m, N].
    points : ndarray, shape (samples, instants, number of points, 2), in space 3
        Places of the named points [m].
    closure : ndarray, shape (samples, instants)
        Largest closure error [m or rad].
    energy : ndarray, shape (samples, instants)
        Kinetic and stored [J].
    failures : dict of int to str
        Why each sample that failed did, and by how much energy balances are off.

    Notes
    -----
    Quantities that were not requested are None.

    """

    time: np.ndarray
    position: Optional[np.ndarray] = None
    velocity: Optional[np.ndarray] = None
    acceleration: Optional[np.ndarray] = None
    effort: Optional[np.ndarray] = None
    constraint_forces: Optional[np.ndarray] = None
    joint_forces: Optional[NamedArray] = None
    points: Optional[np.ndarray] = None
    closure: Optional[np.ndarray] = None
    energy: Optional[np.ndarray] = None
    failures: dict = field(default_factory=dict)

    def __repr__(self):
        """Show the shapes of what was requested, and the failures."""
        asked = [one.name for one in fields(self) if getattr(self, one.name) is not None]
        return by_shapes(self, *asked)


def rollout(simulation, torques=None, initial_position=None, initial_velocity=None, *, hold=None,
            duration=None, steps=None, every=1, parameters=None, quantities=STATE,
            threads=None):
    """
    Run many simulations; see ``Simulation.rollout``.

    Raises
    ------
    ValueError

    """
    require_no_budget(simulation.scene.method, 'a rollout')
    given = RolloutArguments(simulation, torques, initial_position, initial_velocity, parameters)
    schedule = scheduled(simulation.step_size, given.rows, duration, steps, every)
    quantities = checked_quantities(quantities)
    runs = _BatchRunner(simulation, given, schedule, quantities, hold)
    results = {name: np.empty((given.samples, *values.shape))
               for name, values in runs.nothing().items()}
    failures = {}

    def run(samples):
        for sample, (done, failure) in runs.run(samples, results):
            for name, values in done.items():
                if not np.may_share_memory(results[name], values):
                    results[name][sample] = values
            if failure is not None:
                failures[sample] = failure

    threads = checked_threads(threads)
    with runs:
        _each(run, runs.portions(threads), threads)
    time = schedule.interval * (schedule.decimation * np.arange(schedule.instants))
    if 'joint_forces' in results:
        results['joint_forces'] = simulation.data.named('joint_forces', results['joint_forces'])
    return Rollout(time, **results, failures=dict(sorted(failures.items())))


def checked_threads(threads):
    """Return a number of threads, as many as there are processors for None."""
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else (
            os.cpu_count() or 1)
    if int(threads) != threads or threads < 1:
        raise ValueError(f'threads: expected a whole number > 0, got {threads!r}')
    return int(threads)


def _each(run, portions, threads):
    """Call a function with the numbers of some samples at a time, in several threads."""
    if min(threads, len(portions)) == 1:
        for samples in portions:
            run(samples)
        return
    stop = StopFlag()
    pool = ThreadPoolExecutor(threads, initializer=stop.heed)
    try:
        for _ in pool.map(run, portions):
            pass
    except BaseException:
        # Ctrl-C reaches this thread alone.
        stop.set()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


class _CopyPool:
    """Copies of a simulation, for rollouts of it that change no parameter."""

    def __init__(self, simulation):
        self._like = self._traits(simulation)
        # Pairs of a simulation and its batch runner.
        self.spare = []
        # Simulations that take other numbers, for threads whose samples have parameters.
        self.varying = []

    @staticmethod
    def _traits(simulation):
        return (simulation.scene, *simulation.effects.values()), simulation.data.enabled_effects

    def fit(self, simulation):
        """Return whether they still are like it."""
        (records, enabled), (own, own_enabled) = self._like, self._traits(simulation)
        return enabled == own_enabled and len(records) == len(own) and all(
            one is other for one, other in zip(records, own))


_POOLS = WeakKeyDictionary()


class _BatchRunner:
    """Some runs after the others; a thread keeps its simulation where no parameter changes."""

    def __init__(self, simulation, given, schedule, quantities, hold):
        self._type, self._given, self._schedule = type(simulation), given, schedule
        self._quantities, self._hold = quantities, hold
        self._scene = _present_scene(simulation)
        self._again = not given.parameters
        self._fits_simd = fits_simd(simulation, schedule)
        # Whether samples start in states of their own.
        self._moved = any(state is not None and state.ndim > 1
                          for state in (given.position, given.velocity))
        self._own, self._lent, self._lent_varying = threading.local(), [], []
        pool = _POOLS.get(simulation)
        if pool is None or not pool.fit(simulation):
            pool = _POOLS[simulation] = _CopyPool(simulation)
        self._spare, self._varying = pool.spare, pool.varying

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._spare.extend(self._lent)
        self._varying.extend(self._lent_varying)

    def nothing(self):
        """Return the results of a run that did not even begin."""
        return nothing(self._quantities, self._scene.mechanism, self._schedule.instants)

    def portions(self, threads):
        """Return the numbers of all samples, those together that may be run together."""
        count, size = self._given.samples, 1
        if self._again:
            # Two for each thread, as some take longer.
            most = MOST_AT_ONCE * (MOST if self._fits_simd else 1)
            size = max(1, min(most, -(-count // (2 * threads if threads > 1 else 1))))
        if self._fits_simd:
            size = MOST * -(-size // MOST)
        return [range(first, min(first + size, count)) for first in range(0, count, size)]

    def run(self, samples, results):
        """Return for each of some samples its number, results and why it ended early or None."""
        alike = self._in_whole_vectors(samples, results)
        yield from alike.items()
        samples = [sample for sample in samples if sample not in alike]
        starts = self._starts(samples) if self._fits_simd and len(samples) >= FEWEST else {}
        size = MOST if starts else max(1, len(samples))
        groups = [samples[first:first + size] for first in range(0, len(samples), size)]
        # All in lanes before any other, which would move the simulation that they share.
        in_lanes = [self._in_lanes(group, results, {
            sample: starts[sample] for sample in group if sample in starts})
            for group in groups if starts] or len(groups) * [{}]
        for group, done in zip(groups, in_lanes):
            if not done and len(group) > 1 and self._again:
                done = self._in_batch(group)
            for sample in group:
                record = done.get(sample)
                yield sample, self._singly(sample) if record is None else self._result(record)

    def _in_whole_vectors(self, samples, results):
        """Make samples in vectors of as many, straight into the results; findings by number."""
        given, count = self._given, len(samples) // MOST * MOST
        if not (self._fits_simd and self._again and count and set(results) == set(STATE)):
            return {}
        begun = self._states_alike(samples[:count])
        if begun is None or not fits_simd(begun[0], self._schedule):
            return {}
        simulation, states, fine = begun
        part = slice(samples[0], samples[0] + count)
        torques = given.torques[part] if given.torques.ndim == 3 else np.broadcast_to(
            given.torques, (count, *given.torques.shape))
        states, torques, *room = (one.reshape(count // MOST, MOST, *one.shape[1:]) for one in (
            states, torques, *(results[name][part] for name in STATE)))
        groups = np.flatnonzero(np.asarray(fine).reshape(-1, MOST).all(axis=1))
        ended, found = self._together().record_alike(simulation, states, torques, room, groups)
        return {int(samples[place]): ({}, finding_of(simulation, energy))
                for place, energy in zip(np.flatnonzero(ended == DONE), found[ended == DONE])}

    def _in_lanes(self, samples, results, starts):
        """Return records of samples run in the lanes of a vector, by number; none where not."""
        # One simulation may make all of them.
        simulations = {id(start.simulation): start.simulation for start in starts.values()}
        if not starts or not all(
                fits_simd(one, self._schedule) for one in simulations.values()):
            return {}
        if self._again:
            # Readings of the group before have moved it.
            self._simulation(samples[0])
        together = self._together()
        room = None
        if len(starts) == MOST == samples[-1] - samples[0] + 1 and all(
                name in results for name in STATE):
            room = tuple(results[name][samples[0]:samples[-1] + 1] for name in STATE)
        return dict(zip(starts, together.record(list(starts.values()), room) or ()))

    def _in_batch(self, samples):
        """Return records of samples run in one call, by number; those left out run alone."""
        starts = list(self._starts_alike(samples).items())
        if not starts:
            return {}
        numbers = [sample for sample, _ in starts]
        return dict(zip(numbers, record_all(
            starts[0][1].simulation, np.array([start.torques for _, start in starts]),
            self._schedule, self._quantities, np.array([start.state for _, start in starts]))))

    def _starts(self, samples):
        """Return the initial states of those samples that can begin."""
        starts = self._starts_alike(samples) if self._again else {}
        for sample in samples:
            if sample not in starts:
                try:
                    starts[sample] = self._start(sample)
                except (SimulationError, ValueError):
                    # Run alone, it will say why.
                    pass
        return {sample: starts[sample] for sample in samples if sample in starts}

    def _starts_alike(self, samples):
        """Return starts of this thread's simulation that need no assembly, by number."""
        begun = self._states_alike(samples)
        if begun is None:
            return {}
        simulation, states, fine = begun
        return {sample: InitialState(simulation, state, self._given.torques_of(sample))
                for sample, state, good in zip(samples, states, fine) if good}

    def _states_alike(self, samples):
        """Return this thread's simulation, states to start from, and which need no assembly."""
        given = self._given
        if self._moved and (self._hold or given.position is None):
            return None
        try:
            simulation = self._start(samples[0]).simulation if not self._moved else (
                self._simulation(samples[0]))
        except (SimulationError, ValueError):
            # Run alone, they will say why.
            return None
        if not self._moved:
            states = np.tile(simulation.data.integrated, (len(samples), 1))
            return simulation, states, np.ones(len(samples), dtype=bool)
        places = np.array(samples)
        positions, velocities = (
            None if each is None else np.array(np.broadcast_to(each, (len(places), each.size)))
            if each.ndim == 1 else each[places] for each in (given.position, given.velocity))
        if velocities is None:
            velocities = np.zeros((len(samples), simulation.coordinates.nv))
        return simulation, *starts_as_given(simulation, positions, velocities)

    def _result(self, record):
        return record.values, record.failure

    def _singly(self, sample):
        """Return results by quantity, and why the run ended early or None."""
        try:
            start = self._start(sample)
            return self._result(record(start.simulation, start.torques, self._schedule,
                                       self._quantities))
        except (SimulationError, ValueError) as error:
            return self.nothing(), str(error)

    def _start(self, sample):
        """Return the initial state of a run, with its simulation set to it."""
        given = self._given
        simulation = self._simulation(sample)
        position, velocity = given.state_of(sample)
        if position is not None or velocity is not None:
            initial = simulation.scene.initial
            hold = self._hold
            if position is None:
                position, hold = initial.position, hold or initial.hold
            simulation.set_state(position, velocity, hold)
        return InitialState(
            simulation, simulation.data.integrated.copy(), given.torques_of(sample))

    def _twin(self):
        """Return this thread's simulation, and its runner of several runs at a time."""
        if not hasattr(self._own, 'twin'):
            try:
                self._own.twin = self._spare.pop()
            except IndexError:
                self._own.twin = self._built(self._scene), SimdRuns()
            self._lent.append(self._own.twin)
        return self._own.twin

    def _together(self):
        """Return the runner of several runs at a time."""
        together = self._twin()[1] if self._again else SimdRuns()
        together.schedule, together.quantities = self._schedule, self._quantities
        return together

    def _simulation(self, sample):
        """Return a simulation at its start."""
        if not self._again:
            return self._varied(sample)
        simulation, _ = self._twin()
        simulation.reset()
        return simulation

    def _varied(self, sample):
        """Return a simulation with the parameters of a sample, at its start."""
        scene = changed(self._scene, self._given.parameters_of(sample))
        if not hasattr(self._own, 'varying'):
            try:
                self._own.varying = self._varying.pop()
            except IndexError:
                self._own.varying = {}
            self._lent_varying.append(self._own.varying)
        # One for each sample that runs side by side with others.
        place, known = sample % MOST, self._own.varying
        simulation = known.pop(place, None)
        if simulation is None or not simulation.data.varies(self._given.parameters) or (
                not simulation.vary(scene)):
            simulation = self._built(scene)
        if simulation.data.varies(self._given.parameters) and not simulation.data.exchanges:
            known[place] = simulation
        return simulation

    def _built(self, scene):
        simulation = self._type(scene)
        # Nobody asks runs for their local error.
        simulation.stepping.monitor.sampling = False
        return simulation


def _present_scene(simulation):
    """Return the scene of a simulation with its effects as they are now."""
    scene, effects, enabled = simulation.scene, simulation.effects, simulation.data.enabled_effects
    switched_off = tuple(name for name in effects if name not in enabled)
    if switched_off == scene.switched_off and len(effects) == len(scene.effects) and all(
            scene.effects[name] is record for name, record in effects.items()):
        return scene
    return replace(scene, effects=effects, switched_off=switched_off)


class RolloutArguments:
    """
    Arguments that differ between the samples, as arrays of one length.

    Attributes
    ----------
    torques : ndarray, shape (rows, na) or (samples, rows, na)
    position : ndarray, shape (nq,) or (samples, nq); or None
    velocity : ndarray, shape (nv,) or (samples, nv); or None
    parameters : dict of tuple of str to ndarray, shape () or (samples,)
    rows, samples : int

    Raises
    ------
    ValueError

    """

    def __init__(self, simulation, torques, position, velocity, parameters):
        names, na = simulation.coordinates, len(simulation.actuated_joints)
        torques = np.zeros((1, na)) if torques is None else _numbers('torques', torques)
        if torques.ndim == 1:
            torques = torques[np.newaxis]
        self.torques = _shaped('torques', torques, (None, na), 'actuated joints')
        self.position = None if position is None else _shaped(
            'initial_position', _numbers('initial_position', position), (names.nq,),
            'coordinates')
        self.velocity = None if velocity is None else _shaped(
            'initial_velocity', _numbers('initial_velocity', velocity), (names.nv,), 'joints')
        self.parameters = {
            resolve(simulation.scene, key): reals(f'parameters: {key}', values)
            for key, values in (parameters or {}).items()}
        self.rows = self.torques.shape[-2]
        self.samples = self._samples()

    def _samples(self):
        """Return the number of samples that all arguments together give."""
        arrays = {'torques': (self.torques, 2), 'initial_position': (self.position, 1),
                  'initial_velocity': (self.velocity, 1)}
        arrays.update({f'parameters: {".".join(key)}': (values, 0)
                       for key, values in self.parameters.items()})
        found = {}
        for name, (array, ndim) in arrays.items():
            if array is not None and array.ndim > ndim:
                if array.ndim > ndim + 1:
                    raise ValueError(f'{name}: expected one number for each sample, got shape '
                                     f'{array.shape}')
                found.setdefault(len(array), name)
        if len(found) > 1:
            raise ValueError('expected the same number of samples everywhere, got ' + ', '.join(
                f'{count} in {name}' for count, name in found.items()))
        return next(iter(found), 1)

    def torques_of(self, sample):
        """Return the torques of a sample, shape (rows, na)."""
        return _of(self.torques, 2, sample)

    def state_of(self, sample):
        """Return position and velocity of a sample, shape (nv,) or None."""
        return _of(self.position, 1, sample), _of(self.velocity, 1, sample)

    def parameters_of(self, sample):
        return {key: float(_of(values, 0, sample)) for key, values in self.parameters.items()}


def _of(array, ndim, sample):
    """Return a sample's part of an array that all may share."""
    return array if array is None or array.ndim == ndim else array[sample]


def scheduled(step_size, rows, duration, steps, every):
    """
    Return when torques change and instants are kept, in steps.

    Parameters
    ----------
    step_size : float
        [s].
    rows : int
        Of torques.
    duration, steps, every
        As for ``Simulation.rollout``.

    Raises
    ------
    ValueError

    """
    if duration is not None:
        if steps is not None:
            raise ValueError('steps: expected it without duration, got both')
        steps = round(duration / step_size)
        if not abs(steps * step_size - duration) <= 1e-9 * max(step_size, duration):
            raise ValueError(f'duration: expected a multiple of the step size {step_size:g} s, '
                             f'got {duration:g}')
    elif steps is None:
        if rows == 1:
            raise ValueError('steps: expected it, or duration, where torques are constant; got '
                             'neither')
        steps = rows
    for name, value in (('steps', steps), ('every', every)):
        if int(value) != value or value < 1:
            raise ValueError(f'{name}: expected a whole number > 0, got {value!r}')
    if steps % rows or steps % every:
        name, count = ('rows of torques', rows) if steps % rows else ('every', every)
        raise ValueError(f'steps: expected a multiple of {name} ({count}), got {steps}')
    return TimeGrid(step_size, int(steps), int(steps) // rows, int(every))


def _numbers(name, values):
    array = reals(name, values)
    if not np.isfinite(array).all():
        raise ValueError(f'{name}: expected finite numbers, got others among them')
    return array


def _shaped(name, array, shape, what):
    """Return an array of a shape (None: any length but zero), of one or of many samples."""
    tail = array.shape[-len(shape):]
    if array.ndim not in (len(shape), len(shape) + 1) or 0 in array.shape[:-1] or any(
            wanted is not None and wanted != got for wanted, got in zip(shape, tail)):
        inner = ', '.join('rows' if n is None else str(n) for n in shape)
        raise ValueError(f'{name}: expected shape ({inner}) or (samples, {inner}), with the '
                         f'{shape[-1]} {what} last; got {array.shape}')
    return array
