# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Relative energy error over 10 s of mechanisms without drives and losses, and the cost."""

from math import nan
from statistics import median

from closedloop_dynamics.mechanism.errors import NumericalError
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import write_csv
from machine import in_turn
import numpy as np

SCENES = ('three_rrr', 'carpet_scraper')
DURATION = 10.0
# Instants at which the energy is looked at, per simulated second.
LOOKS = 100
ROUNDS = 3
METHODS = (
    {'integrator': 'semi_implicit_euler', 'step_size': 1e-4},
    {'integrator': 'heun', 'step_size': 1e-3},
    *({'integrator': 'rk4', 'step_size': size} for size in (2e-3, 1e-3, 5e-4, 2.5e-4)),
    {'integrator': 'rk4', 'step_size': 1e-3, 'stabilisation': 'independent'},
    *({'integrator': 'dop853', 'tolerance': tolerance} for tolerance in (1e-6, 1e-8, 1e-10)))
HEADER = ('scene', 'integrator', 'stabilisation', 'step_size', 'tolerance',
          'largest_relative_energy_error', 'relative_energy_error_at_the_end',
          'cpu_time_per_second', 'failure')


def energy_errors(scene, method, duration=DURATION):
    """
    Return the relative energy errors of a run without torques.

    Parameters
    ----------
    scene : str
        Without dissipation.
    method : dict
        What differs from the scene's method.
    duration : float
        [s].

    Returns
    -------
    largest, last : float
        Largest deviation from the energy at the start, and the one at the end, as shares of it.

    """
    simulation = Simulation.from_scene(scene, **method)
    energies = [simulation.energy]
    for _ in range(round(duration * LOOKS)):
        simulation.step(duration=1.0 / LOOKS)
        energies.append(simulation.energy)
    off = np.array(energies) / energies[0] - 1.0
    return float(np.abs(off).max()), float(off[-1])


def cost(scene, method, duration):
    """Return the CPU time of a simulated second [s], the median of some whole runs."""
    simulation = Simulation.from_scene(scene, **method)

    def run():
        simulation.reset()
        simulation.step(duration=duration)

    return median(in_turn({scene: run}, ROUNDS)[scene]) / duration


def study(quick=False):
    """
    Measure all scenes and methods.

    Parameters
    ----------
    quick : bool
        A tenth of the time.

    Returns
    -------
    list of tuple
        By ``HEADER``.

    """
    duration = DURATION / 10.0 if quick else DURATION
    rows = []
    for scene in SCENES:
        for method in METHODS:
            start = (scene, method['integrator'], method.get('stabilisation', 'projection'),
                     method.get('step_size', nan), method.get('tolerance', nan))
            try:
                rows.append((*start, *energy_errors(scene, method, duration),
                             cost(scene, method, duration), ''))
            except NumericalError as error:
                rows.append((*start, nan, nan, nan, str(error)))
    return rows


def write(rows, path):
    """Write the rows of a study as a CSV file."""
    write_csv(path, HEADER, rows)
