# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""SciPy's solvers as lines of an accuracy study: well known, interpreted, without projection."""

from dataclasses import dataclass, replace
import math

from closedloop_dynamics.mechanism.errors import NumericalError, SimulationError
from closedloop_dynamics.scene.integrators import STABILISATIONS
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.studies.accuracy import Line
import numpy as np
from scipy import integrate

SOLVERS = {'scipy_dop853': 'DOP853', 'scipy_radau': 'Radau', 'scipy_lsoda': 'LSODA'}
# A solver that needs more evaluations than this to the next output has lost its way.
MOST_EVALUATIONS = 100_000


@dataclass(frozen=True)
class SciPyLine(Line):
    """One of ``SOLVERS``, over tolerances."""

    adaptive = True

    def method(self, method, interval, value):
        """Return the method of the simulation that has the state."""
        return Line('dop853', self.stabilisation).method(method, interval, value)

    def simulation(self, scene, method):
        """Return the motion of a scene."""
        return SciPyMotion(replace(scene, method=method), SOLVERS[self.integrator])


class SciPyMotion:
    """
    A simulation that one of SciPy's solvers advances.

    The solver keeps a state of its own, on which nothing is projected; the stabilisation corrects
    what is handed out. Steps do not end at corners and where joints come to rest.
    """

    def __init__(self, scene, solver):
        self._simulation = Simulation(scene)
        ending = [name for name, effect in scene.effects.items() if effect.ENDS_STEPS]
        if ending:
            raise SimulationError(f'steps must end at corners and rest of {", ".join(ending)}, '
                                  f'and {solver} does not choose where its steps end')
        self._type, self._solver, self._time = getattr(integrate, solver), None, 0.0

    def __getattr__(self, name):
        return getattr(self._simulation, name)

    @property
    def time(self):
        """Return the simulated time [s]."""
        return self._time

    def reset(self):
        """Return to the start."""
        self._simulation.reset()
        self._solver, self._time = None, 0.0

    def advance(self, tau, steps):
        """Advance by steps of the scene under joint torques."""
        simulation, method = self._simulation, self._simulation.scene.method
        if not steps:
            return
        simulation.data.system.tau[:] = tau
        state = simulation.data.integrated
        self._evaluations = 0
        if self._solver is None:
            self._solver = self._type(
                self._slope, 0.0, state.copy(), math.inf, rtol=max(method.tolerance, 3e-14),
                atol=method.tolerance)
        self._time += steps * method.step_size
        while self._solver.t < self._time:
            self._solver.step()
            if self._solver.status == 'failed':
                raise NumericalError('the step size becomes too small')
            self._dense = self._solver.dense_output()
        out = self._dense(self._time)
        if not simulation.data.system.native.stabilise(STABILISATIONS[method.stabilisation], out):
            raise SimulationError('the loops cannot be closed')
        state[:] = out
        simulation.data.touch()

    def _slope(self, time, state):
        out = np.empty(len(state))
        self._simulation.data.system.native.derivative(np.ascontiguousarray(state), out)
        # SciPy's solvers would go on, some of them for ever.
        self._evaluations += 1
        if self._evaluations > MOST_EVALUATIONS or not np.isfinite(out).all():
            raise NumericalError('too many evaluations to the next output, or no numbers')
        return out
