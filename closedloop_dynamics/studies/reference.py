# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Simulated motions as arrays, and the one that errors are measured against.

The motions that prove the reference share as little as possible with it: another integrator, which
beside singular configurations looks at other places of the branch; and independent coordinates,
where they get through. That accelerations are right is shown by the tests, by dense formulations.
What a small difference at the start becomes shows
how many digits there are to know.
"""

from dataclasses import dataclass, replace
import math
import time

import numpy as np

from ..mechanism.errors import SimulationError
from ..scene.integrators import ADAPTIVE, INTEGRATORS
from ..simulation.simulation import Simulation


@dataclass(frozen=True)
class Trajectory:
    """A motion at even times."""

    # Shape (outputs, nq), (outputs, nv) [rad or m], [rad/s or m/s].
    position: np.ndarray
    velocity: np.ndarray
    # Shape (outputs, nc): multipliers: forces and moments at the cut joints [N, N m].
    force: np.ndarray
    closure: float  # Largest closure error of positions at the outputs [m or rad]
    energy_error: float  # Largest residual of the energy balance at the outputs [J]
    cost: float = math.nan  # CPU time per simulated time
    failure: str = ''  # Why it ended before the last output; empty where it did not

    def every(self, stride):
        """Return every ``stride``-th output alone, the first one counted as ``stride``."""
        return self._part(slice(stride - 1, None, stride))

    def first(self, outputs):
        """Return the first outputs alone."""
        return self._part(slice(outputs))

    def _part(self, part):
        return replace(self, position=self.position[part], velocity=self.velocity[part],
                       force=self.force[part])

    def __len__(self):
        return len(self.position)


@dataclass(frozen=True)
class Difference:
    """Largest differences of two motions: positions, velocities, constraint forces."""

    position: float
    velocity: float
    force: float


def in_angles(coordinates, q, other):
    """
    Return how far coordinates are from others [rad or m], shape (nv,).

    Of two orientations the angle of the rotation between them stands in each of its three places.
    """
    change = coordinates.apart(q, other)
    for _, rate in coordinates.balls:
        change[rate:rate + 3] = np.linalg.norm(change[rate:rate + 3])
    return change


def differences(one, other, coordinates):
    """
    Compare two trajectories, output by output, as far as both go; shape (outputs, 3).

    Largest differences of positions, of orientations the angle of the rotation that leads from one
    to the other [rad or m], of velocities [rad/s or m/s] and of constraint forces [N or N m].
    """
    return np.array([[np.abs(apart).max(initial=0.0) for apart in (
        in_angles(coordinates, one.position[k], other.position[k]),
        one.velocity[k] - other.velocity[k], one.force[k] - other.force[k])]
        for k in range(min(len(one), len(other)))]).reshape(-1, 3)


def difference(one, other, coordinates):
    """Return the largest differences of two motions, a ``Difference``; see ``differences``."""
    return Difference(*differences(one, other, coordinates).max(axis=0, initial=0.0).tolist())


def record(simulation, tau, steps, outputs, patience=float('inf')):
    """
    Advance from the initial state, and keep the state at even times, as a Trajectory.

    Under constant torques ``tau``, shape (number of ``torque_names``,) [N m or N], so many whole
    ``steps`` from one of the ``outputs`` to the next; it ends early, with a ``failure``, where a
    step fails or computing takes longer than ``patience`` [s]. The simulation is reset.
    """
    position, velocity, force, closure, energy_error = [], [], [], 0.0, 0.0
    failure, begun = '', time.thread_time()
    try:
        # Compiling, half a minute in a new installation, does not count as computing time.
        simulation.reset()
        simulation.advance(tau, 0)
        _require_patience(simulation, steps * outputs, patience)
        begin, begun = time.perf_counter(), time.thread_time()
        for _ in range(outputs):
            simulation.advance(tau, steps)
            position.append(simulation.position)
            velocity.append(simulation.velocity)
            force.append(simulation.multipliers)
            closure = max(closure, simulation.closure)
            energy_error = max(energy_error, abs(simulation.energy_balance.residual))
            if time.perf_counter() - begin > patience and len(position) < outputs:
                failure = (f'given up at t = {simulation.time:.3g} s after {patience:g} s of '
                           'computing')
                break
    except SimulationError as error:
        failure = str(error)
    cost = (time.thread_time() - begun) / (simulation.time or math.inf)
    return Trajectory(*(np.array(rows).reshape(len(rows), -1 if rows else 0) for rows in (
        position, velocity, force)), closure, energy_error, cost, failure)


def _require_patience(simulation, steps, patience):
    """Raise ``SimulationError`` where not even a tenth of the steps could be awaited."""
    joints = len(simulation.joint_names)
    if simulation.scene.method.stabilisation == 'independent' and joints > MOST_INDEPENDENT:
        raise SimulationError(f'given up: the choice of independent coordinates among {joints} '
                              'takes too long')
    simulation.data.touch()
    begin = time.perf_counter()
    simulation.multipliers
    taken = time.perf_counter() - begin
    if FEWEST * steps * taken > 10.0 * patience:
        raise SimulationError(
            f'given up: one evaluation of the accelerations takes {taken:.2g} s')


# Evaluations of a step, at least.
FEWEST = 4
# Joints among which independent coordinates are chosen, by dense decompositions in every step.
MOST_INDEPENDENT = 200
# The first that gets furthest is the reference, the next one proves it: an integrator, and its
# tolerance or its share of the time between two outputs as step size.
CANDIDATES = (('dop853', 1e-13), ('dopri5', 1e-13), ('rk4', 1e-3), ('rodas4', 1e-11))
# Distance of the places of a proof beside a singular configuration, against that of
# the reference.
NEARER = 0.7
PATIENCE = 10.0
# Where less is known than this, nothing is compared [rad or m]; less than the first only where
# that would end the comparison before this share of the outputs.
KNOWN_TO, SHARE = (1e-6, 1e-3), 0.1
# Shift of the start that shows how differences grow [rad or m].
SHIFT = 1e-9


@dataclass(frozen=True)
class Reference:
    """The most accurate motion that can be computed."""

    trajectory: Trajectory  # As far as it is known
    # Largest of the differences from the motions that prove it: its own error is of this
    # size.
    error: Difference
    description: str  # What it was computed with, how far and how well it is known, in sentences
    growth: float = math.nan  # Of a small difference at the start; NaN where it is unknown
    cost: float = 0.0  # CPU time per simulated time


def compute_reference(scene, torque, interval, outputs):
    """
    Compute the reference of a scene under constant torques.

    Parameters
    ----------
    scene : Scene
        Its start and its effects; its method is replaced.
    torque : mapping or None
        As for ``Simulation.step``.
    interval : float
        Time between two outputs [s].
    outputs : int
        Instants to compare at. Where the motions that prove it differ by more than ``KNOWN_TO``,
        or end, the reference ends, too.

    Raises
    ------
    SimulationError
        Where no two methods agree on even the first output.

    """
    found, failures = [], []
    for candidate in CANDIDATES:
        name = _named(candidate, interval)
        motion = _motion(scene, torque, interval, outputs, candidate, 'projection',
                         NEARER if found else 1.0)
        if motion.failure:
            failures.append(f'{name}: {motion.failure}')
        if len(motion):
            found.append((candidate, motion))
        if sum(not motion.failure for _, motion in found) == 2:
            break
    found.sort(key=lambda one: -len(one[1]))
    if len(found) < 2:
        raise SimulationError(_nothing(interval * outputs, failures))
    (candidate, reference), (second, proof) = found[:2]
    proofs = {_named(second, interval): proof}
    independent = _motion(
        scene, torque, interval, len(proof), candidate, 'independent', NEARER)
    if len(independent):
        proofs['independent coordinates'] = independent
    if independent.failure:
        failures.append(f'{_named(candidate, interval)}, independent: {independent.failure}')
    coordinates = Simulation(scene).coordinates
    apart = np.zeros((len(proof), 3))
    for one in proofs.values():
        by_output = differences(reference, one, coordinates)
        apart[:len(by_output)] = np.maximum(apart[:len(by_output)], by_output)
    for limit in KNOWN_TO:
        beyond = np.flatnonzero(~(apart[:, 0] <= limit))
        known = int(beyond[0]) if len(beyond) else len(proof)
        if known >= SHARE * outputs:
            break
    if known == 0:
        raise SimulationError(_nothing(interval * outputs, [
            f'{_named(candidate, interval)} and {" and ".join(proofs)} differ by '
            f'{apart[0, 0]:.1e} rad or m at t = {interval:g} s', *failures]))
    own = Difference(*apart[:known].max(axis=0).tolist())
    lines = [
        f'Reference: {_named(candidate, interval)}; proved by {" and ".join(proofs)}: they differ '
        f'by {own.position:.1e} rad or m, {own.velocity:.1e} rad/s or m/s, {own.force:.1e} N or '
        f'N m. Smaller errors cannot be measured.']
    growth = _growth(scene, torque, interval, known, candidate, reference.first(known))
    if not math.isnan(growth):
        lines.append(
            f'A small difference at the start becomes at most {growth:.2g} times as large.')
    if not np.any(reference.velocity):
        lines.append('Nothing moves: every method is exact.')
    if known < outputs:
        why = (f'after it they differ by more than {limit:g} rad or m, and smaller errors mean '
               'nothing' if len(beyond) else 'no two methods go further')
        lines.append(f'The comparison ends at t = {known * interval:.4g} s of '
                     f'{outputs * interval:g} s: {why}.')
    return Reference(reference.first(known), own, '\n'.join([*lines, *failures]), growth,
                     reference.cost)


def _nothing(duration, failures):
    """Return the message where there is no reference."""
    return ('There is nothing to measure errors against: fewer than two methods get through '
            f'{duration:g} s of this scene at tight tolerance and agree. Take a shorter duration '
            'or smaller torques.\n' + '\n'.join(failures))


def _named(candidate, interval):
    """Return the method of a motion, in words."""
    integrator, value = candidate
    how = (f'at tolerance {value:g}' if INTEGRATORS[integrator].kind == ADAPTIVE
           else f'in steps of {value * interval:g} s')
    return f'{integrator} {how}'


def _motion(scene, torque, interval, outputs, candidate, stabilisation, aside):
    """Return the trajectory of one method at its tightest, as far as it goes."""
    integrator, value = candidate
    adaptive = INTEGRATORS[integrator].kind == ADAPTIVE
    steps = 1 if adaptive else round(1.0 / value)
    method = replace(
        scene.method.without_budget, integrator=integrator, step_size=interval / steps,
        tolerance=value if adaptive else scene.method.tolerance, stabilisation=stabilisation,
        baumgarte_time_constant=None)
    try:
        simulation = Simulation(replace(scene, method=method))
    except SimulationError as error:
        nothing = np.zeros((0, 0))
        return Trajectory(nothing, nothing, nothing, math.nan, math.nan, failure=str(error))
    simulation.data.system.settings.aside *= aside
    return record(simulation, simulation.joint_torques(torque), steps, outputs, PATIENCE)


def _growth(scene, torque, interval, outputs, candidate, reference):
    """Return how many times a small difference at the start grows; NaN where it cannot start."""
    start = Simulation(scene)
    coordinates = start.coordinates
    shifted = coordinates.moved(start.position, np.full(coordinates.nv, SHIFT))
    try:
        other = replace(scene, initial=replace(scene.initial, position=tuple(shifted.tolist())))
        before = coordinates.apart(Simulation(other).position, start.position)
    except SimulationError:
        return math.nan
    before = np.abs(before).max(initial=0.0)
    # Where motions are prescribed, nothing may be free to differ.
    if before < 0.01 * SHIFT:
        return math.nan
    motion = _motion(other, torque, interval, outputs, candidate, 'projection', 1.0)
    apart = differences(motion, reference, coordinates)
    return math.nan if motion.failure else float(apart[:, 0].max(initial=0.0) / before)
