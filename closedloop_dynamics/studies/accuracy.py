# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The work-precision study: error and computing time of each method."""

from dataclasses import dataclass, replace
import math
import statistics
import time

from .reference import compute_reference, difference, record, Reference
from ..engine.types import EVALUATIONS
from ..mechanism.errors import SimulationError
from ..scene.integrators import ADAPTIVE, AUTO, INTEGRATORS, STABILISATIONS
from ..simulation.simulation import Simulation

DEFAULT_INTEGRATOR, DEFAULT_STABILISATION = 'rk4', 'projection'

# Shares of the time between two outputs. Where a step covers several, they are compared alone.
STEP_SHARES = (5, 2, 1, 1 / 2, 1 / 5, 1 / 10, 1 / 20, 1 / 50, 1 / 100, 1 / 200, 1 / 500, 1 / 1000,
               1 / 2000)
TOLERANCES = tuple(10.0 ** -k for k in range(2, 14))
QUICK_STEP_SHARES = (2, 1, 1 / 2, 1 / 5, 1 / 10, 1 / 20, 1 / 50, 1 / 100)
QUICK_TOLERANCES = tuple(10.0 ** -k for k in range(3, 13, 2))


@dataclass(frozen=True)
class Line:
    """One line of a work-precision diagram: a method but for its step size or tolerance."""

    integrator: str
    stabilisation: str = DEFAULT_STABILISATION

    @property
    def adaptive(self):
        """Whether the integrator controls its error instead of taking a step size."""
        return INTEGRATORS[self.integrator].kind == ADAPTIVE

    @property
    def key(self):
        """Return the key of a scene's method that is varied along the line."""
        if self.integrator == AUTO:
            return 'accuracy'
        return 'tolerance' if self.adaptive else 'step_size'

    def method(self, method, interval, value):
        """Return a method with a value of what is varied; ``interval`` is that of outputs [s]."""
        keys = {'step_size': interval, self.key: value}
        return replace(
            method.without_budget, integrator=self.integrator, stabilisation=self.stabilisation,
            baumgarte_time_constant=None, **keys)

    def simulation(self, scene, method):
        """Return what runs a scene by a method of this line."""
        return Simulation(replace(scene, method=method))

    def __str__(self):
        """Return the names of the line's integrator and stabilisation."""
        return f'{self.integrator}, {self.stabilisation}'


def default_lines():
    """
    Return the choices of methods, one thing varied at a time.

    That is every integrator with full projection, and RK4 with every stabilisation.
    """
    lines = [Line(integrator) for integrator in INTEGRATORS]
    lines += [Line(DEFAULT_INTEGRATOR, stabilisation=name) for name in STABILISATIONS]
    return list(dict.fromkeys(lines))


@dataclass(frozen=True)
class Setting:
    """A method to be measured."""

    line: Line
    value: float  # Its step size [s], tolerance or accuracy
    # Steps from one compared output to the next, and outputs that lie between these (1: all
    # of them are compared).
    steps: int
    stride: int

    def method(self, scene, interval):
        """Return the scene's method with this setting; ``interval`` is that of outputs [s]."""
        return self.line.method(scene.method, interval, self.value)


def settings(line, interval, quick=False):
    """
    Return the settings of a line, from coarse to fine, with ``quick`` fewer of them.

    ``interval`` is the time between two outputs [s].
    """
    if line.adaptive:
        return [Setting(line, tolerance, 1, 1)
                for tolerance in (QUICK_TOLERANCES if quick else TOLERANCES)]
    return [Setting(line, interval * share, max(1, round(1 / share)), max(1, round(share)))
            for share in (QUICK_STEP_SHARES if quick else STEP_SHARES)]


OUTPUTS = 100
# A line is not refined beyond this cost, in CPU time per simulated time, nor beyond that of the
# reference if it is larger; computing a motion with its outputs is given up after so long [s].
COST_LIMIT, QUICK_COST_LIMIT = 0.1, 0.05
PATIENCE = 10.0
# Timing: rounds over all settings in turn, so that a disturbance meets all; runs shorter
# than the shortest timing are repeated within a round [s].
ROUNDS, QUICK_ROUNDS = 7, 5
# Runs that take longer are measured in the first rounds alone, very long ones once [s].
LONG, LONG_ROUNDS, LONGEST_ROUGH = 0.03, 3, 1.0
SHORTEST_TIMING = 2e-3
DIVERGED = 'diverged'
# Where every digit of an angle is gone [rad, m].
LARGEST_ERROR = 10.0


@dataclass(frozen=True)
class Row:
    """Error and cost of one setting."""

    setting: Setting
    method: object  # Method: as under the key ``method`` of a scene
    failure: str = ''  # Why there are no numbers; empty where there are
    # Largest over the outputs [rad or m], [rad/s or m/s], [N or N m].
    position_error: float = math.nan
    velocity_error: float = math.nan
    force_error: float = math.nan
    closure: float = math.nan  # Largest closure error [m or rad]
    energy_error: float = math.nan  # Largest change of energy less the work done [J]
    evaluations: float = math.nan  # Of the accelerations, per simulated second
    cost: float = math.nan  # CPU time per simulated time: a share of real time
    seconds: float = math.nan  # Simulated for it [s]

    @property
    def line(self):
        """Return the line of the diagram it belongs to."""
        return self.setting.line


@dataclass(frozen=True)
class Study:
    """A finished work-precision study."""

    scene: object  # Scene
    duration: float  # As far as the reference is known [s]
    torque: dict
    reference: Reference
    rows: list  # List of Row: line by line, from coarse to fine

    def lines(self):
        """Return {line: its rows}, in order."""
        result = {}
        for row in self.rows:
            result.setdefault(row.line, []).append(row)
        return result


def study_accuracy(scene, torque=None, duration=1.0, quick=False, lines=None,
                   progress=lambda done, total: None):
    """
    Measure errors and costs of methods on a scene, under constant torques.

    Parameters
    ----------
    scene : Scene
        Its start and its effects; its method is replaced.
    torque : mapping, optional
        As for ``Simulation.step``.
    duration : float
        Simulated time [s].
    quick : bool
        Fewer and coarser settings, fewer repeats.
    lines : list of Line, optional
        ``default_lines`` when not given.
    progress : callable
        Called with the number of parts done and of all parts.

    Raises
    ------
    SimulationError
        Where there is no reference.

    """
    interval = duration / OUTPUTS
    lines = default_lines() if lines is None else lines
    limit = QUICK_COST_LIMIT if quick else COST_LIMIT
    rounds = QUICK_ROUNDS if quick else ROUNDS
    total = 1 + len(lines) + rounds
    progress(0, total)
    reference = compute_reference(scene, torque, interval, OUTPUTS)
    progress(1, total)
    measured = []
    for done, line in enumerate(lines, start=2):
        measured += _line(scene, torque, interval, line, reference, limit, quick)
        progress(done, total)
    rows = _with_costs(measured, torque, rounds,
                       lambda done: progress(total - rounds + done, total))
    return Study(scene, interval * len(reference.trajectory), dict(torque or {}), reference, rows)


def _line(scene, torque, interval, line, reference, limit, quick):
    """Return (row, simulation) of each setting of a line, until it is too costly or exact."""
    measured, exact = [], 0
    for setting in settings(line, interval, quick):
        if setting.stride > len(reference.trajectory):
            continue
        method = setting.method(scene, interval)
        row, simulation = _measure(scene, torque, interval, setting, method, reference)
        if row.failure and measured and row.failure == measured[-1][0].failure:
            # It is not the step size or the tolerance that fails.
            break
        measured.append((row, simulation))
        exact = exact + 1 if row.position_error <= 2.0 * reference.error.position else 0
        if row.cost > max(limit, reference.cost) or exact == 2:
            break
    return measured


def _measure(scene, torque, interval, setting, method, reference):
    """Return the row of a setting with a first, rough cost, and its simulation."""
    outputs = len(reference.trajectory) // setting.stride
    try:
        simulation = setting.line.simulation(scene, method)
    except SimulationError as error:
        return Row(setting, method, failure=str(error)), None
    tau = simulation.joint_torques(torque)
    motion = record(simulation, tau, setting.steps, outputs, PATIENCE)
    if motion.failure:
        return Row(setting, method, failure=motion.failure), None
    wrong = difference(motion, reference.trajectory.every(setting.stride), simulation.coordinates)
    if not wrong.position < LARGEST_ERROR:
        return Row(setting, method, failure=f'{DIVERGED}: off by {wrong.position:.2g}'), None
    try:
        cost = _time_once(simulation, tau, setting.steps * outputs)
        if cost < LONGEST_ROUGH:
            cost = _time_once(simulation, tau, setting.steps * outputs)
    except SimulationError as error:
        return Row(setting, method, failure=str(error)), None
    seconds = interval * setting.stride * outputs
    return Row(
        setting, method, '', wrong.position, wrong.velocity, wrong.force, motion.closure,
        motion.energy_error, simulation.data.system.work.health[EVALUATIONS] / seconds,
        cost / seconds, seconds), simulation


def _time_once(simulation, tau, steps):
    """Return the CPU time of one run without outputs [s]."""
    simulation.reset()
    simulation.stepping.monitor.sampling = False
    begin = time.thread_time()
    simulation.advance(tau, steps)
    return time.thread_time() - begin


def _with_costs(measured, torque, rounds, progress):
    """Return the rows with the median of their costs, measured in turn."""
    costs = [[] for _ in measured]
    for number in range(rounds):
        for (row, simulation), cost in zip(measured, costs):
            taken = row.cost * row.seconds
            if simulation is not None and taken < LONGEST_ROUGH and (
                    number < LONG_ROUNDS or taken < LONG):
                cost.append(_mean_time(row, simulation, torque))
        progress(number + 1)
    return [replace(row, cost=statistics.median(cost)) if cost else row
            for (row, _), cost in zip(measured, costs)]


def _mean_time(row, simulation, torque):
    """Return the CPU time per simulated time of one round."""
    steps = round(row.seconds / simulation.step_size)
    repeats = min(100, math.ceil(SHORTEST_TIMING / max(row.cost * row.seconds, 1e-6)))
    tau = simulation.joint_torques(torque)
    return sum(_time_once(simulation, tau, steps) for _ in range(repeats)) / repeats / row.seconds
