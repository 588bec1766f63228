# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Problems A01 to A05 of the IFToMM library of computational benchmark problems, solved.

M. Gonzalez, D. Dopico, U. Lugris, J. Cuadrado, "A benchmarking system for MBS simulation
software", Multibody System Dynamics 16 (2006). The error that the library compares is that of the
energy balance; where a motion is known, so is the error of positions.
"""

from dataclasses import dataclass, replace
import math
from pathlib import Path
import platform
import statistics
import time
from typing import Callable, Mapping, Optional, Tuple

import numpy as np

from ..mechanism.config import config_directory
from ..scene.loading import load_scene
from ..simulation.simulation import Simulation

ACCURACIES = (1e-4, 1e-6, 1e-8)
REPEATS = 5

# The crank's angle and the six others at 0.03 s: F. Mazzia, C. Magherini, "Test Set for Initial
# Value Problem Solvers", release 2.4, University of Bari (2008), problem Andrews. Two integrators
# here agree with each other to 1e-12 rad, and differ from it by up to 1.4e-9 rad.
ANDREWS = {
    'beta': 15.81077119629904, 'theta': -15.75637105984298, 'gamma': 0.04082224013073101,
    'phi': -0.5347301163226948, 'delta': 0.5244099658805304, 'omega': 0.5347301163226948,
    'epsilon': 1.048080741042263}


def pendulum_angle(times):
    """
    Return the angle from the level of a pendulum released there [rad], at times [s].

    sin(phi / 2) = k sn(K(k) - sqrt(g / l) t, k), with phi from the lowest place, k = sin(45 deg).
    """
    # Only here, as in the next function: it takes long to load.
    from scipy.special import ellipj, ellipk
    parameter = 0.5
    sine = ellipj(ellipk(parameter) - math.sqrt(9.81) * times, parameter)[0]
    return {'pin': 2.0 * np.arcsin(math.sqrt(parameter) * sine) - math.pi / 2.0}


def four_bars_angle(times, loops=2, rate=1.0, length=1.0):
    """
    Return the angle of the first rod of square four-bars that turn over [rad], at times [s].

    As all rods stay parallel it is a pendulum's: of uniform rods of equal mass, ``loops + 1`` of
    which turn and ``loops`` are carried, psi'' = -w^2 sin(psi) with psi from the lowest place and
    w^2 = (g / l) ((n + 1) / 2 + n) / ((n + 1) / 3 + n). It begins upright at ``rate`` [rad/s], and
    is psi = 2 am(s t / 2 - K(m), m), s^2 = rate^2 + 4 w^2, m = 4 w^2 / s^2.
    """
    from scipy.special import ellipj, ellipk
    turning, carried = loops + 1, loops
    square = 9.81 / length * (turning / 2.0 + carried) / (turning / 3.0 + carried)
    fastest = math.hypot(rate, 2.0 * math.sqrt(square))
    parameter = 4.0 * square / fastest ** 2
    lowest = 2.0 * ellipj(fastest * times / 2.0 - ellipk(parameter), parameter)[3]
    return {'pin_0': -math.pi / 2.0 - lowest}


def andrews_angles(times):
    """Return the angles of Andrews' squeezer [rad] at times [s], NaN but at 0.03 s."""
    return {name: np.where(np.abs(times - 0.03) < 1e-9, angle, math.nan)
            for name, angle in ANDREWS.items()}


@dataclass(frozen=True)
class Problem:
    """One problem of the library."""

    name: str
    scene: str  # Shipped scene, or a file of config/benchmarks
    duration: float  # [s]
    interval: float  # Between two outputs [s]
    result: str  # Point whose place is asked for, or joint
    # Takes the times of the outputs [s], returns positions of joints by name [rad or m], NaN at
    # times at which they are not known; None where the energy alone is known.
    known: Optional[Callable[[np.ndarray], Mapping[str, np.ndarray]]] = None

    def load(self):
        """Return the scene."""
        file = config_directory() / 'benchmarks' / f'{self.scene}.yaml'
        return load_scene(file if file.exists() else self.scene)


PROBLEMS = (
    Problem('A01', 'pendulum', 10.0, 0.1, 'P1', pendulum_angle),
    Problem('A02', 'four_bars', 10.0, 0.1, 'B0', four_bars_angle),
    Problem('A03', 'andrews', 0.05, 0.001, 'F', andrews_angles),
    Problem('A04', 'bricard', 10.0, 0.1, 'corner'),
    Problem('A05', 'governor', 10.0, 0.1, 'slider_joint'))


@dataclass(frozen=True)
class Solution:
    """What one problem came to at one accuracy."""

    problem: Problem
    accuracy: float  # That was asked for [rad or m]
    energy_error: float  # Largest residual of the energy balance at the outputs [J]
    position_error: float  # Largest of the joints that are known [rad or m]; NaN where none is
    cpu_time: float  # Of the whole run, without start [s], median
    header: Tuple[str, ...]  # Columns of the table
    table: np.ndarray  # Times [s] and places [m], or positions of joints [rad or m]

    def write(self, file):
        """Write the table as text with all digits, as the library collects results."""
        np.savetxt(file, self.table, '%.17g', header=' '.join(self.header))


def solve(problem, accuracy, repeats=REPEATS):
    """Solve a problem with the default method at an accuracy; return a Solution."""
    scene = problem.load()
    simulation = Simulation(replace(scene, method=replace(scene.method, accuracy=accuracy)))
    times = np.arange(round(problem.duration / problem.interval) + 1) * problem.interval
    cpu_times = []
    for _ in range(repeats):
        simulation.reset()
        begun = time.process_time()
        positions, places, residuals = _run(simulation, problem, len(times))
        cpu_times.append(time.process_time() - begun)
    error = math.nan
    if problem.known is not None:
        error = max(
            float(np.nanmax(np.abs(
                positions[:, simulation.joint_names.index(name)] - known)))
            for name, known in problem.known(times).items())
    header = ('t', problem.result) if places.shape[1] == 1 else (
        't', *(f'{problem.result}.{axis}' for axis in 'xyz'[:places.shape[1]]))
    return Solution(problem, accuracy, max(map(abs, residuals)), error,
                    statistics.median(cpu_times), header, np.column_stack([times, places]))


def _run(simulation, problem, outputs):
    """Return positions of joints and the result asked for at outputs, and energy residuals [J]."""
    positions, places, residuals = [], [], []
    for output in range(outputs):
        if output:
            simulation.step(duration=problem.interval)
        positions.append(simulation.position.copy())
        places.append([positions[-1][simulation.joint_names.index(problem.result)]]
                      if problem.result in simulation.joint_names
                      else simulation.data.point(problem.result).copy())
        residuals.append(simulation.energy_balance.residual)
    return np.array(positions), np.array(places), residuals


def processor():
    """Return the name of this machine's processor."""
    try:
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith('model name'):
                return line.partition(':')[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
