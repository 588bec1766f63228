# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A run from the start under a sequence of torques, and its results.

The engine makes runs as a whole, several in one call that leaves Python's lock alone, and watches
them by the rules of the guards. What needs more between the steps (delays, sensors that remember,
other closure equations), and what a guard might end, is made step by step. Both give the same
numbers, bit for bit.
"""

from dataclasses import dataclass
from typing import Optional

import numpy as np

from .batch import build_batch, filled, find_energies, fits, Lane
from .guards import CLOSING, energy_finding, ENERGY_WARN, LARGEST_MOTION, USUAL_TORQUE
from .recorded_run import (
    allocate_buffer, joint_forces, LOST, MOVED, run_samples, SHARE, TIME)
from ..codegen.lanes import LANES, spread
from ..engine import native
from ..engine.status import DONE, INTERRUPTED, NOT_FINITE
from ..kinematics.assembly import TOLERANCE
from ..mechanism.checks import one_of
from ..mechanism.errors import SimulationError
from ..mechanism.fields import at, FieldError
from ..scene.integrators import EXPLICIT, FIXED, INTEGRATORS, STABILISATIONS

STATE = ('position', 'velocity')
QUANTITIES = (*STATE, 'acceleration', 'effort', 'constraint_forces', 'joint_forces', 'points',
              'closure', 'energy')
# Where energy balances are checked after so many steps or less, lanes have code for them.
OFTEN = 20
# So many runs at least, and at most, are made together in the lanes of a vector.
FEWEST, MOST = 3, LANES
# A time counts as a multiple of the step up to this share of the step.
TIME_ROUNDING = 1e-9


@dataclass(frozen=True)
class TimeGrid:
    """When torques change and when instants are kept, all in multiples of one interval."""

    interval: float  # [s]
    intervals: int  # Length of the run
    zero_order_hold: int  # Intervals that a row of torques acts for
    decimation: int  # Intervals from one instant to the next

    @property
    def instants(self):
        """Return how many instants are kept, the start among them."""
        return self.intervals // self.decimation + 1

    @property
    def rows(self):
        """Return which row of torques acted just before each instant, shape (instants,)."""
        ends = np.arange(self.instants) * self.decimation
        return np.maximum(ends - 1, 0) // self.zero_order_hold

    def in_steps(self, steps):
        """Return hold, decimation and length of the run in steps, so many of them an interval."""
        return self.zero_order_hold * steps, self.decimation * steps, self.intervals * steps

    def steps(self, step_size):
        """Return how many whole steps an interval is; 0 where it is not a whole number of them."""
        steps = round(self.interval / step_size)
        return steps if abs(steps * step_size - self.interval) <= TIME_ROUNDING * step_size else 0


@dataclass
class RunResult:
    """Results of one run; NaN from a failure on."""

    # Dict of str to ndarray: by the names of ``QUANTITIES``, those that were asked for:
    # position (instants, nq), velocity, acceleration, effort (instants, nv), constraint_forces
    # (instants, number of cuts, 3; in space 6), joint_forces (instants, nv, 3; in space number
    # of joints, 6), points (instants, number of points, 2; in space 3), closure, energy
    # (instants,). SI units.
    values: dict
    # Why the run ended early; or, where all values are there, by how much its energy balance
    # is off.
    failure: Optional[str] = None


def shape_of(quantity, mechanism):
    """Return the shape that a quantity has at one instant."""
    names, plane = mechanism.coordinates, mechanism.planar
    shapes = {'constraint_forces': (len(mechanism.cut_joints), 3 if plane else 6),
              'joint_forces': (len(mechanism.joints), 3 if plane else 6),
              'points': (len(mechanism.points), 2 if plane else 3), 'closure': (), 'energy': (),
              'position': (names.nq,)}
    return shapes.get(quantity, (names.nv,))


def nothing(quantities, mechanism, instants):
    """Return the results of a run that could not begin: NaN."""
    return {name: np.full((instants, *shape_of(name, mechanism)), np.nan) for name in quantities}


def checked_quantities(names):
    """Return names of quantities as a tuple, or raise FieldError."""
    for index, name in enumerate(names):
        with at('quantities', index):
            one_of(QUANTITIES)(name)
    return tuple(names)


def is_plain(simulation):
    """
    Return whether a run needs nothing but fixed steps, so that several can share a vector.

    Not for error-controlled and stiff methods, independent coordinates, commands that arrive late,
    sensors that remember, and equations that were left out, which are watched.
    """
    effects = simulation.data.effect_set
    integrator = INTEGRATORS[simulation.scene.method.integrator]
    return ((integrator.family, integrator.kind) == (EXPLICIT, FIXED)
            and not simulation.data.has_redundant_constraints
            and not simulation.data.system.is_independent and not any(effects.drives.values())
            and not effects.remembers)


def runs_whole(simulation):
    """
    Return whether the engine can make runs of a simulation as a whole.

    Not for commands that arrive late, sensors that remember, what acts in cut joints, and
    equations that may be left out but are not, or drift apart.
    """
    effects = simulation.data.effect_set
    watched = simulation.stepping.run.guard_limits.chooses
    return not (
        effects.remembers or any(effects.drives.values()) or effects.cuts is not None
        or simulation.data.exchanges or watched != simulation.data.has_redundant_constraints
        or watched and simulation.scene.method.stabilisation not in CLOSING)


def record(simulation, torques, schedule, quantities=QUANTITIES):
    """
    Run a simulation at time zero, and return the results; ``reset`` it before using it again.

    ``torques``, shape (rows, number of actuated joints) [N m or N], at least one row; the
    ``schedule`` is no longer than these last; ``quantities``, of ``QUANTITIES``, are kept.
    """
    at_start = simulation.stepping.at_start
    done, = record_all(simulation, torques[np.newaxis], schedule, quantities)
    if done is not None:
        return done
    if at_start:
        simulation.reset()
    return run_stepwise(simulation, all_torques(simulation, torques), schedule,
                        schedule.steps(simulation.step_size), quantities)


def starts_as_given(simulation, positions, velocities):
    """
    Return states to start from that need no assembly, as far as there are such.

    Of positions, shape (n, nq), and velocities, (n, nv): states, (n, ns), and whether
    ``set_state`` would take each to the last digit, bool of shape (n,).
    """
    system, names = simulation.data.system, simulation.coordinates
    states = np.tile(simulation.data.integrated, (len(positions), 1))
    if system.manifold is not None:
        positions = [_unit(names, position) for position in positions]
    states[:, :names.nq], states[:, names.nq:names.nq + names.nv] = positions, velocities
    fine = np.zeros(len(states), dtype=np.int64)
    if runs_whole(simulation) and simulation.data.takes_closed_states:
        tolerance = 0.5 * TOLERANCE * simulation.stepping.run.guard_limits.extent
        simulation.stepping.run.check_starts(tolerance, states, fine)
        fine[np.abs(velocities).max(axis=1) * simulation.step_size > LARGEST_MOTION] = 0
    return states, fine == 1


def _unit(coordinates, position):
    """Return joint coordinates with quaternions of norm 1; zero ones unchanged."""
    try:
        return coordinates.unit(position)
    except FieldError:
        return position


def record_all(simulation, torques, schedule, quantities, starts=None):
    """
    Make runs from the present state of a simulation as a whole, as far as possible.

    ``torques`` of each run, shape (n, rows, number of actuated joints) [N m or N]; ``starts``,
    shape (n, ns): initial states, by default the present one; all else as for ``record``. None for
    runs that are to be made step by step: these alone can say how they end.
    """
    steps, records, admissible = (
        schedule.steps(simulation.step_size), [None] * len(torques), range(len(torques)))
    if not np.abs(torques).max(initial=0.0) <= USUAL_TORQUE:
        admissible = np.flatnonzero(np.abs(torques).max(axis=(1, 2)) <= USUAL_TORQUE).tolist()
        torques, starts = torques[admissible], None if starts is None else starts[admissible]
    if not (steps and len(admissible) and runs_whole(simulation)):
        return records
    tau = all_torques(simulation, torques)
    starts = simulation.data.integrated[np.newaxis].copy() if starts is None else starts
    states, status, found = run_samples(
        simulation.stepping.run.run_samples, starts, tau, schedule.in_steps(steps))
    for k in np.flatnonzero(status == DONE).tolist():
        records[admissible[k]] = RunResult(
            _values_of_states(simulation, states[k], tau[k], schedule, steps, quantities),
            finding_of(simulation, found[k]))
    return records


def finding_of(simulation, found):
    """Return the error of a run's energy balance in words; None where it holds."""
    if found[SHARE] <= ENERGY_WARN:
        return None
    return energy_finding(simulation.scene.method, found[LOST], found[MOVED], found[TIME])


def all_torques(simulation, torques):
    """Return torques of actuated joints as those of ``torque_names``, row by row."""
    tau = np.zeros((*torques.shape[:-1], len(simulation.torque_names)))
    tau[..., simulation.data.actuated] = torques
    return tau


def buffer_for(simulation, schedule, quantities):
    """Return a buffer for all that is to be kept of a run; in space for its states."""
    points = simulation.mechanism.points if simulation.mechanism.planar else ()
    rows = simulation.data.loop_model.rows
    return allocate_buffer(
        simulation.data.system, schedule.instants, simulation.mechanism.planar and any(
            name not in STATE for name in quantities),
        np.array([rows[point.body] for point in points], dtype=np.int64),
        np.array([point.position for point in points]).reshape(-1, 2))


def values_of(simulation, buffer, tau, schedule, quantities):
    """Return the results of a run by quantity, from its buffer."""
    nq, nv = simulation.coordinates.nq, simulation.coordinates.nv
    if (simulation.data.acts_in_cuts or simulation.data.has_redundant_constraints
            or not simulation.mechanism.planar):
        return _values_asked_for(simulation, buffer, tau, schedule, quantities)
    take = {
        'position': lambda: buffer.state[:, :nq].copy(),
        'velocity': lambda: buffer.state[:, nq:nq + nv].copy(),
        'acceleration': lambda: buffer.qdd,
        'effort': lambda: _efforts(simulation, buffer, tau, schedule),
        # Behind the cut joints those of couplings, which have none.
        'constraint_forces': lambda: buffer.wrench[:, :len(simulation.mechanism.cut_joints)],
        'joint_forces': lambda: joint_forces(
            simulation.data.system, tau, schedule.zero_order_hold, schedule.decimation,
            buffer.state, buffer.qdd, buffer.lam),
        'points': lambda: buffer.place,
        'closure': lambda: buffer.scalars[:, 0].copy(),
        'energy': lambda: buffer.scalars[:, 1] + (
            buffer.scalars[:, 2] + buffer.output[:, :, 0].sum(axis=1)),
    }
    return {name: take[name]() for name in quantities}


def _values_asked_for(simulation, buffer, tau, schedule, quantities):
    """Return the same from readings of the simulation at every instant."""
    nq, nv = simulation.coordinates.nq, simulation.coordinates.nv
    values = nothing(quantities, simulation.mechanism, schedule.instants)
    for name, columns in (('position', slice(nq)), ('velocity', slice(nq, nq + nv))):
        if name in values:
            values[name][:] = buffer.state[:, columns]
    others = {name: rows for name, rows in values.items() if name not in STATE}
    efforts = tau[schedule.rows]
    for instant in range(schedule.instants if others else 0):
        simulation.data.integrated[:] = buffer.state[instant]
        simulation.data.system.tau[:] = efforts[instant]
        _write_instant(simulation, others, instant)
    return values


def _efforts(simulation, buffer, tau, schedule):
    """Return the joint torques at the instants: those of the step before."""
    efforts = tau[schedule.rows]
    rows, joints = simulation.data.effect_set.drive_rows()
    efforts[:, joints] = buffer.output[:, rows, 1]
    return efforts


def run_stepwise(simulation, tau, schedule, steps, quantities):
    """Return the record of a run made step by step."""
    values = nothing(quantities, simulation.mechanism, schedule.instants)
    failure = None
    actuated = tau[:, simulation.data.actuated]
    try:
        simulation.advance(tau[0], 0)
        _write_instant(simulation, values, 0)
        done = 0
        while done < schedule.intervals:
            row = done // schedule.zero_order_hold
            if steps:
                portion = min(schedule.zero_order_hold - done % schedule.zero_order_hold,
                              schedule.decimation - done % schedule.decimation,
                              schedule.intervals - done)
                simulation.advance(tau[row], portion * steps)
            else:
                portion = 1
                simulation.step(actuated[row], schedule.interval)
            done += portion
            if done % schedule.decimation == 0:
                _write_instant(simulation, values, done // schedule.decimation)
        simulation.judge()
        failure = simulation.stepping.energy_guard.finding or None
    except SimulationError as error:
        failure = str(error)
    return RunResult(values, failure)


def _write_instant(simulation, values, instant):
    for name, rows in values.items():
        rows[instant] = getattr(simulation, name)


@dataclass(frozen=True)
class InitialState:
    """Start of a run."""

    simulation: object  # Simulation: whose mechanism moves; several runs may share it
    state: np.ndarray  # Shape (ns,): where it begins
    torques: np.ndarray  # Shape (rows, number of actuated joints) [N m or N]


def fits_simd(simulation, schedule):
    """Return whether runs of a simulation can share the lanes of a vector at all."""
    return bool(is_plain(simulation) and schedule.steps(simulation.step_size) and fits(
        simulation.data.system, STABILISATIONS[simulation.scene.method.stabilisation]))


class SimdRuns:
    """Several runs at a time in vector lanes, with ``quantities`` of ``QUANTITIES`` as results."""

    def __init__(self, schedule=None, quantities=()):
        self.schedule, self.quantities = schedule, quantities
        self._systems, self._pack = [], None

    def record(self, starts, room=None):
        """
        Make some runs.

        Parameters
        ----------
        starts : sequence of InitialState
            Of simulations that may go together, up to MOST of them.
        room : tuple of 2 ndarrays, shapes (MOST, instants, nq), (MOST, instants, nv), optional
            Where positions and velocities go, so that they need not be copied.

        Returns
        -------
        list of RunResult, or None
            None where they must be made one by one: they differ in their methods, or one of
            them fails or comes to a singular configuration. None in the list for a run that a
            guard may end.

        """
        first, schedule = starts[0].simulation, self.schedule
        if len(starts) < FEWEST or any(
                start.simulation.scene.method != first.scene.method for start in starts[1:]):
            return None
        if len(first.data.effect_set.own) and not all(name in STATE for name in self.quantities):
            # Accelerations depend on states that lanes do not keep.
            return None
        pack = self._pack_of([start.simulation.data.system for start in starts])
        if pack is None:
            return None
        steps = schedule.steps(first.step_size)
        self._prepare(pack, first)
        torques = np.array(filled([start.torques for start in starts]))
        if np.abs(torques).max(initial=0.0) > USUAL_TORQUE:
            return None
        efforts = np.zeros((torques.shape[1], len(first.torque_names), LANES))
        efforts[:, first.data.actuated] = np.moveaxis(torques, 0, -1)
        state = spread(filled([start.state for start in starts]))
        if room is None:
            names = first.coordinates
            room = tuple(np.empty((LANES, schedule.instants, count))
                         for count in (names.nq, names.nv))
        watched = tuple(
            Lane(start.simulation.data.system.native, start.simulation.stepping.run.native)
            for start in starts)
        ended, found = np.empty(len(starts), dtype=np.int64), np.empty((len(starts), 4))
        status = native.run_batch(
            tuple(pack)[:-1], watched, state, efforts.reshape(len(efforts), -1),
            *schedule.in_steps(steps), *room, ended, found)
        if status == INTERRUPTED:
            # Another thread was.
            raise KeyboardInterrupt
        if status != DONE:
            return None
        return [None if how != DONE else RunResult(
            _values_of_motion(start.simulation, one, schedule, steps, self.quantities, *motion),
            finding_of(start.simulation, energy))
            for start, one, how, energy, *motion in zip(starts, torques, ended, found, *room)]

    def record_alike(self, simulation, states, torques, room, some):
        """
        Make runs of one simulation, in whole vectors, of positions and velocities alone.

        Parameters
        ----------
        simulation : Simulation
            With ``fits_simd``.
        states : ndarray, shape (groups, MOST, ns)
            Where they begin.
        torques : ndarray, shape (groups, MOST, rows, number of actuated joints)
            [N m or N].
        room : tuple of 2 ndarrays, shapes (groups, MOST, instants, nq), (..., nv)
            Where positions and velocities go.
        some : ndarray of int
            Groups that are to be made.

        Returns
        -------
        ended : ndarray of int, shape (groups, MOST)
            Statuses; what is not DONE is to be made otherwise.
        found : ndarray, shape (groups, MOST, 4)
            Energy balances.

        """
        data, schedule, groups = simulation.data, self.schedule, len(states)
        ended = np.full((groups, MOST), NOT_FINITE)
        found = np.zeros((groups, MOST, 4))
        pack = self._pack_of([data.system] * MOST)
        if pack is None:
            return ended, found
        self._prepare(pack, simulation)
        efforts = np.zeros((groups, torques.shape[2], len(simulation.torque_names), MOST))
        efforts[:, :, data.actuated] = np.moveaxis(torques, 1, -1)
        begun = np.ascontiguousarray(np.moveaxis(states, 1, -1)).reshape(groups, -1)
        lane = Lane(data.system.native, simulation.stepping.run.native)
        arguments = tuple(pack)[:-1], (lane,) * MOST
        lengths = schedule.in_steps(schedule.steps(simulation.step_size))
        usual = np.abs(torques).max(axis=(1, 2, 3), initial=0.0) <= USUAL_TORQUE
        for number in some[usual[some]]:
            status = native.run_batch(
                *arguments, begun[number], efforts[number].reshape(len(efforts[number]), -1),
                *lengths, *(one[number] for one in room), ended[number], found[number])
            if status == INTERRUPTED:
                # Another thread was.
                raise KeyboardInterrupt
            if status != DONE:
                ended[number] = status
        return ended, found

    def _prepare(self, pack, simulation):
        """Have the energies of all lanes found together where they are asked for often."""
        *calls, _ = self.schedule.in_steps(self.schedule.steps(simulation.step_size))
        if simulation.stepping.run.guard_limits.call <= min(calls) <= OFTEN:
            find_energies(pack, simulation.data.system)

    def _pack_of(self, systems):
        """Return a pack of systems, the last one where they are still the same."""
        if len(systems) != len(self._systems) or any(
                one is not other for one, other in zip(systems, self._systems)):
            self._systems, self._pack = systems, build_batch(systems)
        return self._pack


def _values_of_motion(simulation, torques, schedule, steps, quantities, position, velocity):
    """Return the results of one of the runs."""
    if all(name in STATE for name in quantities):
        both = {'position': position, 'velocity': velocity}
        return {name: both[name] for name in quantities}
    return _values_of_states(simulation, np.hstack((position, velocity)), all_torques(
        simulation, torques), schedule, steps, quantities)


def _values_of_states(simulation, states, tau, schedule, steps, quantities):
    """Return the results of a run from its states."""
    nq, nv = simulation.coordinates.nq, simulation.coordinates.nv
    if all(name in STATE for name in quantities):
        both = {'position': states[:, :nq], 'velocity': states[:, nq:nq + nv]}
        return {name: both[name] for name in quantities}
    buffer = buffer_for(simulation, schedule, quantities)
    buffer.state[:, :states.shape[1]] = states
    if simulation.mechanism.planar:
        simulation.data.system.native.annotate(tau, *schedule.in_steps(steps)[:2], buffer)
    return values_of(simulation, buffer, tau, schedule, quantities)
