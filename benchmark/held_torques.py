# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What accuracy costs where torques are sampled and held, as by every digital controller.

Each method restarts at every new torque, so that its steps are no longer than the period in
which torques are held. Two costs are measured: evaluations of the accelerations, which do not
depend on the machine, and CPU time of a loop in Python that calls ``Simulation.advance`` once a
period.
"""

from dataclasses import astuple, dataclass
import math
from statistics import median
import time
import warnings

from closedloop_dynamics.engine.types import EVALUATIONS
from closedloop_dynamics.mechanism.errors import InaccuracyWarning, SimulationError
from closedloop_dynamics.scene.integrators import ADAPTIVE, INTEGRATORS
from closedloop_dynamics.scene.records import AUTO
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import write_csv
from machine import in_turn
import numpy as np
from sentences import read as read_rows

# The mean torques [N m]; they swing between nothing and twice that.
MOTIONS = {'three_rrr': {'theta_1': 5.0, 'theta_6': -3.0, 'theta_7': 2.0},
           'carpet_scraper': {'theta_1': 2.0}}
SWING = 2.0  # [Hz]
RATES = (100, 1000)  # [Hz]
DURATION = 1.0  # [s]
LINES = ('rk4', 'dopri5', 'dop853', AUTO)
TOLERANCES = tuple(10.0 ** -k for k in range(2, 13))
# Of ``auto``, which stands in the column of tolerances.
ACCURACIES = tuple(10.0 ** -k for k in range(3, 10))
FINEST = 1e-13
# Steps of fixed size in a period; the shortest step is 0.1 ms.
STEPS, MOST = (1, 2, 5, 10, 20, 50, 100), 10000
ROUNDS, QUICK_ROUNDS = 7, 1
HEADER = ('scene', 'rate', 'integrator', 'step_size', 'tolerance', 'position_error',
          'evaluations_per_second', 'cpu_time_per_second', 'failure')


@dataclass(frozen=True)
class Run:
    """One row of the table; NaN where there is no number."""

    scene: str
    rate: int  # [Hz]
    integrator: str
    step_size: float  # [s]
    tolerance: float
    position_error: float = math.nan  # Largest of any coordinate at any period's end [rad or m]
    evaluations: float = math.nan  # Per simulated second
    cost: float = math.nan  # CPU time per simulated second [s]
    failure: str = ''


def controls_error(integrator):
    """Return whether an integrator takes a tolerance or an accuracy, not a step size."""
    return integrator == AUTO or INTEGRATORS[integrator].kind == ADAPTIVE


def motion(scene, rate, integrator, value, rounds=0):
    """
    Return positions at the ends of all periods, and what a simulated second costs.

    Parameters
    ----------
    scene : str
        Of ``MOTIONS``.
    rate : int
        Torques per second [Hz].
    integrator : str
        Of the registry.
    value : float
        Its tolerance or accuracy, or its steps in a period.
    rounds : int
        How often the motion is repeated to be timed.

    Returns
    -------
    positions : ndarray, shape (periods, nv)
    evaluations, cost : float
        Evaluations and CPU time [s] per simulated second, the median of the rounds; NaN without.

    Raises
    ------
    SimulationError

    """
    adaptive = controls_error(integrator)
    steps = 1 if adaptive else int(value)
    method = {'step_size': 1.0 / rate / steps}
    if adaptive:
        method['accuracy' if integrator == AUTO else 'tolerance'] = value
    simulation = Simulation.from_scene(scene, integrator=integrator, **method)
    simulation.stepping.monitor.sampling = False
    torques = _torques(simulation, scene, rate)
    positions = []
    for torque in torques:
        simulation.advance(torque, steps)
        positions.append(simulation.position.copy())
    evaluations = simulation.data.system.work.health[EVALUATIONS] / DURATION

    def run():
        simulation.reset()
        simulation.stepping.monitor.sampling = False
        for torque in torques:
            simulation.advance(torque, steps)

    costs = in_turn({scene: run}, rounds, time.thread_time)[scene]
    return np.array(positions), evaluations, median(costs) / DURATION if costs else math.nan


def _torques(simulation, scene, rate):
    """Return the torques of all joints in each period, as ``advance`` takes them."""
    torques = []
    for period in range(round(DURATION * rate)):
        swing = 1.0 + math.cos(2.0 * math.pi * SWING * period / rate)
        torques.append(simulation.joint_torques(
            {joint: mean * swing for joint, mean in MOTIONS[scene].items()}))
    return torques


def study(scenes=tuple(MOTIONS), rates=RATES, quick=False):
    """Return the runs of all scenes, rates and methods, from coarse to fine."""
    runs = []
    with warnings.catch_warnings():
        # How far off each run is stands in the table.
        warnings.simplefilter('ignore', InaccuracyWarning)
        for scene in scenes:
            for rate in rates:
                reference, *_ = motion(scene, rate, 'dop853', FINEST)
                runs += [_run(scene, rate, integrator, value, reference,
                              QUICK_ROUNDS if quick else ROUNDS)
                         for integrator in LINES for value in _values(integrator, rate, quick)]
    return runs


def _values(integrator, rate, quick):
    if controls_error(integrator):
        return (ACCURACIES if integrator == AUTO else TOLERANCES)[::3 if quick else 1]
    return [steps for steps in STEPS[:3 if quick else None] if steps * rate <= MOST]


def _run(scene, rate, integrator, value, reference, rounds):
    adaptive = controls_error(integrator)
    start = (scene, rate, integrator, math.nan if adaptive else 1.0 / rate / value,
             value if adaptive else math.nan)
    try:
        positions, evaluations, cost = motion(scene, rate, integrator, value, rounds)
    except SimulationError as error:
        return Run(*start, failure=str(error))
    return Run(*start, float(np.abs(positions - reference).max()), evaluations, cost)


def write(runs, path):
    """Write the runs as a CSV file."""
    write_csv(path, HEADER, map(astuple, runs))


def read(path):
    """Return the runs of a CSV file."""
    return [Run(row['scene'], int(float(row['rate'])), row['integrator'],
                *(float(row[name] or 'nan') for name in HEADER[3:8]), row['failure'])
            for row in read_rows(path)]
