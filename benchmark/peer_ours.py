# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""This project's simulator, for the comparison in peers.py."""

from machine import commit
import numpy as np
from peer_cases import Run, simulation

from closedloop_dynamics.engine import native  # noqa: I100
from closedloop_dynamics.simulation.derivative_code import DerivativeCode
from closedloop_dynamics.simulation.errors import SimulationError
from closedloop_dynamics.simulation.simulation import Simulation
from evaluations import evaluate_again

NAME = 'closedloop_dynamics'
# A tenfold of the reference's own, at the least.
TOLERANCES = 1.0, 0.3, *(10.0 ** -k for k in range(1, 13))
QUICK_TOLERANCES = tuple(10.0 ** -k for k in range(3, 13, 3))
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
QUICK_STEPS = (1e-2, 1e-3)
# Of a step that is timed [s].
STEP = 1e-5


class Engine:
    """
    Our simulator of one scene.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone.

    """

    name, version = NAME, commit()
    softness, others = None, {}

    def __init__(self, scene):
        """Build the model."""
        self._scene, self._simulation = scene, Simulation(scene)

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        system = self._simulation.data.system
        system.tau[:] = tau
        evaluate_again(system, q, qd, 1)
        return system.qdd.copy()

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        one = self._simulation
        one.data.system.tau[:] = tau
        torque = tau[list(one.coordinates.actuated)]

        def call(count):
            for _ in range(count):
                one.forward_dynamics(q, qd, torque)

        stepping = simulation(self._scene, 'rk4', STEP, STEP, adaptive=False)

        def steps(count):
            stepping.advance(tau, count)

        def back():
            stepping.set_state(q, qd)
            stepping.stepping.monitor.sampling = False

        steps.prepare = back
        return {'evaluation, compiled loop': lambda count: evaluate_again(
                    one.data.system, q, qd, count),
                'evaluation, from Python': call, 'RK4 step with projection': steps}

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations with all derivatives}."""
        one = self._simulation
        one.data.system.tau[:] = tau
        # Kept: its code writes into arrays of its own.
        self._derivatives = code = DerivativeCode(
            one.data, one.data.system.qdd, one.data.system.lam)
        again = native.bind('call_for_columns', code.table, q, qd, code.columns, code.found)

        def derivatives(count):
            evaluate_again(one.data.system, q, qd, count)
            for _ in range(count):
                again()

        return {'evaluation, compiled loop, and all derivatives, from Python': derivatives}

    def runs(self, case, quick):
        """Return the runs of a case."""
        runs = []
        for value in QUICK_TOLERANCES if quick else TOLERANCES:
            one = simulation(case.scene, 'dop853', value, case.duration)
            runs.append(Run(NAME, 'DOP853', f'tolerance {value:.0e}', _motion(one, case, 1)))
        for value in QUICK_STEPS if quick else STEPS:
            one = simulation(case.scene, 'rk4', value, case.duration, adaptive=False)
            runs.append(Run(NAME, 'RK4', f'step {value:g} s', _motion(
                one, case, round(case.duration / value))))
        return runs


def _motion(one, case, steps):
    """Return a function that computes the motion of a case."""
    def execute():
        one.reset()
        one.stepping.monitor.sampling = False
        try:
            one.advance(case.tau, steps)
        except SimulationError:
            # A setting so coarse that it is refused has no error to compare.
            return np.full_like(one.position, np.inf)
        return one.position
    return execute
