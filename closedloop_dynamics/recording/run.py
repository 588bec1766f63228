# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A simulation run to its end, with a row of numbers at even times: ``closedloop simulate``."""

from dataclasses import dataclass, replace
from itertools import chain
import math
import time

import numpy as np

from ..engine.types import EVALUATIONS
from ..kinematics.redundancy import wrench_names
from ..mechanism.coordinates import QUANTITIES
from ..mechanism.errors import SimulationError
from ..mechanism.mechanism import CUT_WITHOUT_MOMENT, JOINT_FREEDOMS, REVOLUTE
from ..scene.integrators import AUTO, FIXED, INTEGRATORS
from ..simulation.budget import FINEST
from ..simulation.readings import readings_of
from ..simulation.rollout_run import TIME_ROUNDING
from ..visual.trajectory import LEAST, wrench_parts

# What accuracy costs: the error of the row [rad or m], NaN without a second run; the accuracy that
# is kept [rad or m], NaN where none is; evaluations [1/s] and CPU time since the row before, per
# simulated time, NaN in the first row.
COSTS = ('error', 'accuracy', 'evaluation_rate', 'cpu_share')
# Steps between two checks for cancellation; about 10 ms of computing.
LARGEST_PORTION = 1000
# Tolerance of the run that gives the error, against that of the run itself.
FINER = 1.0 / 30.0


@dataclass
class Report:
    """Report of a run, up to date while it goes on."""

    rows: int = 0  # Handed over so far
    time: float = 0.0  # Simulated time [s]
    cpu_time: float = 0.0  # Spent on the simulated time alone, not on rows [s]
    # Largest closure error of positions at the rows' times [m or rad].
    largest_closure: float = 0.0
    # At the first and at the last row [J].
    first_energy: float = math.nan
    last_energy: float = math.nan
    # Largest error of a joint coordinate at the rows' times [rad or m], estimated by a
    # second, finer run; NaN without one.
    error: float = math.nan
    finished: bool = False  # False while it goes on, and where it was ended early


class ErrorEstimate:
    """
    A second, finer run of the same scene, which estimates the error of the first.

    ``simulation`` is the second one, ``method`` says how it differs. With half the step a method
    of order p leaves 2^-p of the error (Richardson); with a tolerance or an accuracy 30 times as
    small what is left does not count.
    """

    def __init__(self, simulation):
        method = simulation.scene.method.without_budget
        if simulation.scene.method.by_budget:
            method = replace(method, accuracy=min(method.accuracy, FINEST))
        integrator = INTEGRATORS[method.integrator]
        self._share, key = 1.0, 'accuracy' if method.integrator == AUTO else 'tolerance'
        if integrator.kind == FIXED:
            self._share, key = 1.0 / (1.0 - 0.5 ** integrator.order), 'step_size'
        value = getattr(method, key) * (0.5 if key == 'step_size' else FINER)
        self.method = f'{key.replace("_", " ")} {value:.3g}'
        self.simulation = type(simulation)(replace(
            simulation.scene, method=replace(method, **{key: value})))

    def of(self, simulation):
        """Return the largest error of a joint coordinate [rad or m]."""
        apart = np.abs(simulation.coordinates.apart(
            simulation.position, self.simulation.position)).max(initial=0.0)
        return float(self._share * apart)


def columns(simulation, all_forces=False, costs=False):
    """Return the names of the columns, in the order of ``row``, with those of costs behind."""
    names = ['time']
    for quantity in QUANTITIES:
        names += simulation.coordinates.columns(quantity)
    for cut in simulation.mechanism.cut_joints:
        names += [f'force.{cut.name}.{part}' for part in _force_parts(simulation, cut)]
    names += [f'coupling.{coupling.name}' for coupling in simulation.mechanism.couplings]
    names += [f'tooth_force.{simulation.mechanism.couplings[k].name}'
              for k in _toothed(simulation)]
    names += [f'motion.{name}.{part}' for name in readings_of(simulation).motion_names
              for part in ('force', 'power')]
    if all_forces:
        parts = _force_parts(simulation)
        names += [f'force.{simulation.mechanism.joints[place].name}.{part}'
                  for place in moving_joints(simulation) for part in parts]
    names += [f'point.{point.name}.{axis}' for point in simulation.mechanism.points
              for axis in 'xyz'[:len(point.position)]]
    for quantity in QUANTITIES:
        names += simulation.mechanism.cut_coordinates.columns(quantity)
    names += [f'effect.{name}.{reading}' for name, reading in _effect_readings(simulation)]
    return [*names, 'closure', 'energy', *COSTS[:len(COSTS) * costs]]


def headings(simulation, all_forces=False, costs=False):
    """
    Return ``columns``, marked where a force is not unique: of those possible the least is given.

    That is found where the simulation is. Of a wrench its components are marked, in world axes;
    of couplings and prescribed motions all that belongs to them.
    """
    redundancy = readings_of(simulation).redundancy()
    parts = dict(zip(wrench_names(simulation.mechanism), wrench_parts(simulation.mechanism)))
    least = {f'force.{name}.{parts[component]}'
             for name, components in redundancy.components.items() for component in components}
    least.update(f'{kind}.{name}{part}' for name in redundancy.shared for kind, part in (
        ('coupling', ''), ('tooth_force', ''), ('motion', '.force'), ('motion', '.power')))
    return [name + LEAST * (name in least) for name in columns(simulation, all_forces, costs)]


def row(simulation, seconds, all_forces=False):
    """
    Return the present state as numbers; ``seconds`` is the time to write.

    ``all_forces``: those in the joints of the trees, too, beside those at the cut joints.
    """
    values = [seconds]
    for quantity in (simulation.position, simulation.velocity, simulation.acceleration,
                     simulation.effort):
        values += quantity.tolist()
    for cut, wrench in zip(simulation.mechanism.cut_joints, simulation.constraint_forces.tolist()):
        values += [wrench[place] for place in _force_parts(simulation, cut).values()]
    values += simulation.coupling_forces.tolist()
    values += simulation.tooth_forces[_toothed(simulation)].tolist()
    for name in readings_of(simulation).motion_names:
        readings = simulation.effect_readings(name)
        values += [readings['force'], readings['power']]
    if all_forces:
        places = list(_force_parts(simulation).values())
        values += simulation.joint_forces[moving_joints(simulation)][:, places].ravel().tolist()
    values += simulation.points.ravel().tolist()
    if simulation.cut_joint_names:
        for quantity in (simulation.cut_position, simulation.cut_velocity,
                         simulation.cut_acceleration, simulation.cut_effort):
            values += quantity.tolist()
    values += [simulation.effect_readings(name)[reading]
               for name, reading in _effect_readings(simulation)]
    return [*values, simulation.closure, simulation.energy]


def _effect_readings(simulation):
    """Return effects that are on, each with its readings, but motions, which have columns."""
    data = readings_of(simulation)
    effects = data.effect_set
    return [(name, reading) for name, record in effects.records.items()
            if effects.enabled[name] and name not in data.motion_names
            for reading in record.READINGS]


def _toothed(simulation):
    """Return the places of the couplings that have a radius."""
    return [k for k, coupling in enumerate(simulation.mechanism.couplings)
            if coupling.radius is not None]


def moving_joints(simulation):
    """Return the places of the joints of the tree that are not fixed."""
    return [place for place, joint in enumerate(simulation.mechanism.joints)
            if JOINT_FREEDOMS[joint.type]]


def _force_parts(simulation, cut=None):
    """
    Return the components of a wrench, moments last, with their places in it.

    Of a cut joint those that can differ from zero; of a joint of the tree all.
    """
    parts = list(enumerate(wrench_parts(simulation.mechanism)))
    moments = len(parts) // 2
    without_torque = cut is not None and (
        cut.type in CUT_WITHOUT_MOMENT
        or simulation.mechanism.planar and cut.type == REVOLUTE)
    shown = parts[moments:] + ([] if without_torque else parts[:moments])
    return {name: place for place, name in shown}


def run(simulation, duration, rate, torque=None, *, report, on_row, keep_going=lambda: True,
        all_forces=False, estimate=None, costs=False, on_step=None):
    """
    Advance a simulation under constant torques, with a row at every multiple of ``1 / rate``.

    The time between two rows is covered by whole steps; where it is not a multiple of the step
    size, the last of them is shorter. The energy balance is looked at once more at the end.

    Parameters
    ----------
    simulation : Simulation
        At time zero.
    duration : float
        [s].
    rate : float
        Rows per simulated second [Hz].
    torque : mapping, sequence or None
        As for ``Simulation.step``.
    report : Report
        Filled while the run goes on, so that it reports a run that fails, too.
    on_row : callable
        Takes the numbers of ``row``.
    keep_going : callable
        Polled; the run ends early where it returns False.
    all_forces : bool
        As for ``row``.
    estimate : ErrorEstimate, optional
        To be run beside it.
    costs : bool
        Whether ``COSTS`` follow in each row.
    on_step : callable, optional
        Called after each step, for observers of all states.

    Raises
    ------
    SimulationError, ValueError

    """
    tau = simulation.joint_torques(torque)
    simulation.advance(tau, 0)
    last = math.floor(duration * rate * (1.0 + 1e-12) + TIME_ROUNDING)
    before = _spent(simulation, report)
    # One by one: a long run has more rows than fit into memory.
    for until in chain((index / rate for index in range(last + 1)), [None]):
        if not _reached(duration if until is None else until, simulation, torque, report,
                        keep_going, on_step):
            return
        if estimate is not None:
            estimate = _estimated(estimate, simulation, torque, report)
        if until is not None:
            spent = _spent(simulation, report) - before
            values = _noted(row(simulation, until, all_forces), report)
            if costs:
                values += [
                    math.nan if estimate is None else estimate.of(simulation), simulation.accuracy,
                    *(spent[1:] / spent[0] if spent[0] > 0.0 else np.full(2, math.nan)).tolist()]
            # Reading a row takes evaluations, too.
            before = _spent(simulation, report)
            on_row(values)
    try:
        simulation.judge()
    finally:
        report.time = simulation.time
    report.finished = True


def _spent(simulation, report):
    """Return simulated time [s], evaluations and CPU time [s] so far, shape (3,)."""
    return np.array([
        simulation.time, simulation.data.system.work.health[EVALUATIONS], report.cpu_time])


def _estimated(estimate, simulation, torque, report):
    """Advance the second run; return it unless it fails."""
    try:
        _reached(simulation.time, estimate.simulation, torque, Report(), lambda: True)
    except SimulationError:
        report.error = math.nan
        return None
    error = estimate.of(simulation)
    report.error = error if math.isnan(report.error) else max(report.error, error)
    return estimate


def _noted(values, report):
    """Enter a row into the report; return the row."""
    report.rows += 1
    *_, closure, report.last_energy = values
    report.largest_closure = max(report.largest_closure, closure)
    if report.rows == 1:
        report.first_energy = report.last_energy
    return values


def _reached(until, simulation, torque, report, keep_going, on_step=None):
    """Advance to a time; return False where the run is to end before."""
    tau, size = simulation.joint_torques(torque), simulation.step_size
    portion = LARGEST_PORTION if on_step is None else 1
    while keep_going():
        left = until - simulation.time
        steps = round(left / size)
        begin = time.process_time()
        try:
            if steps > portion:
                simulation.advance(tau, portion)
            # Counted steps: a difference of two large times would leave crumbs of a step.
            elif abs(steps * size - left) <= TIME_ROUNDING * size + 4e-16 * until:
                simulation.advance(tau, steps)
            elif left > 0.0:
                simulation.step(torque, left)
        finally:
            report.cpu_time += time.process_time() - begin
            report.time = simulation.time
        if on_step is not None:
            on_step()
        if steps <= portion:
            return True
    return False
