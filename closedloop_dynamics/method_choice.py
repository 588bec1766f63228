# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""``integrator: auto``: the cheapest method that keeps a wanted accuracy on a scene."""

from dataclasses import dataclass, replace
import statistics
import time

import numpy as np

from .errors import SimulationError
from .integration.registry import ADAPTIVE, INTEGRATORS, ROSENBROCK, SCIPY
from .scene_records import AUTO, Method

# Simulated time that the choice looks at [s]; shorter where computing that takes too long.
HORIZONS = (1.0, 0.1, 0.01)
OUTPUTS = 20
# Computing time of one run at most, and of all [s].
PATIENCE, TOTAL_PATIENCE = 0.3, 1.5
# The error is wanted by this margin smaller: the next motion is not the one looked at.
MARGIN = 0.5
# The reference is computed with tolerances smaller than the accuracy by this.
FINER, FINEST = 1e-5, 1e-13
STEP_SIZES = tuple(digit * 10.0 ** power for power in range(-2, -6, -1) for digit in (1, 0.5, 0.2))
REPEATS = 5
# Methods for stiff scenes are tried only where the others take more of real time than this.
EXPENSIVE = 0.05


@dataclass(frozen=True)
class Choice:
    """
    A method that was chosen.

    Attributes
    ----------
    method : Method
        To be used instead of ``auto``.
    report : str
        What was chosen, what it was measured to buy and to cost.

    """

    method: Method
    report: str


_choices = {}


def choose_method(scene, build):
    """
    Choose the method of a scene that says ``integrator: auto``.

    Parameters
    ----------
    scene : Scene
        With ``accuracy`` among its method.
    build : callable
        Makes a simulation of a scene.

    Returns
    -------
    Choice
        The same for the same scene within a process.

    Raises
    ------
    SimulationError
        Where no method gets through the shortest horizon.

    """
    key = repr(scene)
    if key not in _choices:
        _choices[key] = _Search(scene, build).result()
    return _choices[key]


class _Search:
    """A short study of a scene without torques."""

    def __init__(self, scene, build):
        self._scene, self._build = scene, build
        self._accuracy = scene.method.accuracy
        self._spent = 0.0
        # (method, simulation, error) of every integrator's coarsest setting that will do.
        self._found = []
        self._cheapest = float('inf')
        self._horizon, self._reference, self._tight = self._proven()

    def result(self):
        """Return the choice."""
        explicit = [name for name, integrator in INTEGRATORS.items()
                    if integrator.family not in (ROSENBROCK, SCIPY)]
        # The most promising first: what costs more than the best so far is given up early.
        for name in reversed(explicit):
            self._try(name)
        if self._cheapest > EXPENSIVE * self._horizon:
            for name, integrator in INTEGRATORS.items():
                if integrator.family == ROSENBROCK:
                    self._try(name)
        if not self._found:
            self._found.append((self._tight, self._simulation(self._tight), 0.0))
        costs = self._costs()
        best = min(range(len(costs)), key=costs.__getitem__)
        method, _, error = self._found[best]
        return Choice(method, self._report(method, error, costs[best] / self._horizon))

    def _proven(self):
        """Return a horizon, the motion over it, and the method that computed it."""
        tolerance = max(FINER * self._accuracy, FINEST)
        failures = []
        for horizon in HORIZONS:
            for name in ('dop853', 'rodas4'):
                method = self._method(name, tolerance)
                try:
                    return horizon, self._motion(self._simulation(method), horizon), method
                except SimulationError as error:
                    failures.append(f'{name}: {error}')
        raise SimulationError('No method can be chosen, for none gets through '
                              f'{HORIZONS[-1]:g} s of this scene: ' + '; '.join(failures))

    def _try(self, name):
        """Find the coarsest setting of an integrator that will do, unless others are cheaper."""
        adaptive = INTEGRATORS[name].kind == ADAPTIVE
        values = [self._accuracy * 10.0 ** -k for k in range(5)] if adaptive else STEP_SIZES
        for value in values:
            if value > self._horizon / OUTPUTS and not adaptive:
                continue
            if self._spent > TOTAL_PATIENCE and self._found:
                return
            method = self._method(name, value)
            try:
                simulation = self._simulation(method)
                motion = self._motion(simulation, self._horizon)
                cost = min(self._time(simulation), self._time(simulation))
            except SimulationError:
                continue
            if cost > 1.5 * self._cheapest:
                return
            error = float(np.abs(motion - self._reference).max())
            if error <= MARGIN * self._accuracy:
                self._found.append((method, simulation, error))
                self._cheapest = min(self._cheapest, cost)
                return

    def _method(self, name, value):
        """Return the scene's method with one integrator, its tolerance or step size."""
        key = 'tolerance' if INTEGRATORS[name].kind == ADAPTIVE else 'step_size'
        return replace(self._scene.method, integrator=name, accuracy=None, **{key: value})

    def _simulation(self, method):
        return self._build(replace(self._scene, method=method))

    def _motion(self, simulation, horizon):
        """Return the positions at even times."""
        simulation.warm_up()
        # Compiling, which happens once in the life of an installation, is not counted.
        begin = time.perf_counter()
        positions = []
        try:
            for number in range(1, OUTPUTS + 1):
                simulation.step(duration=horizon * number / OUTPUTS - simulation.time)
                positions.append(simulation.position)
                if time.perf_counter() - begin > PATIENCE:
                    raise SimulationError(f'{horizon:g} s of it take too long')
        finally:
            self._spent += time.perf_counter() - begin
        return np.array(positions)

    def _time(self, simulation):
        """Return the CPU time of one run [s]."""
        simulation.reset()
        simulation.monitor.sampling = False
        begin = time.thread_time()
        simulation.step(duration=self._horizon)
        return time.thread_time() - begin

    def _costs(self):
        """Return the CPU time of each setting found, all measured in turn [s]."""
        rounds = [[self._time(simulation) for _, simulation, _ in self._found]
                  for _ in range(REPEATS)]
        return [statistics.median(times) for times in zip(*rounds)]

    def _report(self, method, error, share):
        adaptive = INTEGRATORS[method.integrator].kind == ADAPTIVE
        setting = f'tolerance {method.tolerance:g}' if adaptive else (
            f'step size {method.step_size:g} s')
        bought = (f'error {error:.1e} rad or m' if error else
                  'nothing coarser holds it, its own error is not known')
        return (
            f'integrator auto: {method.integrator}, {setting}, {method.stabilisation}. '
            f'Measured over {self._horizon:g} s from the start without torques: {bought} '
            f'({self._accuracy:g} wanted), {1e3 * share:.3g} ms of CPU time per simulated second '
            f'({100.0 * share:.2g} % of real time).')


def resolved(scene, build):
    """
    Replace ``auto`` in a scene by the method chosen for it.

    Parameters
    ----------
    scene : Scene
        Any.
    build : callable
        Makes a simulation of a scene.

    Returns
    -------
    scene : Scene
        Without ``auto``.
    report : str
        What was chosen; empty where the scene said it itself.

    """
    if scene.method.integrator != AUTO:
        return scene, ''
    choice = choose_method(scene, build)
    return replace(scene, method=choice.method), choice.report
