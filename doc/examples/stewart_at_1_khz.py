# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Bring a Stewart platform home at 1 kHz, with drives that lift half more than its weight.

A linear-quadratic regulator whose torques are clipped, beside predictive controllers of several
horizons, of 5 ms a period: what each costs, how far legs are from home at the end, and CPU time.

    python doc/examples/stewart_at_1_khz.py [STEPS]

600 steps take some seconds. Needs the extra predictive.
"""

import sys
import time

from closedloop_dynamics import LinearRegulator, Model, PredictiveController, Simulation
import numpy as np

PERIOD = 1e-3                   # Of control [s]
PREDICTED = 5e-3                # Of the prediction [s]
ASIDE = 0.03                    # Of each leg, from home where it begins, at most [m]
COSTS = np.r_[np.full(6, 1e4), np.full(6, 10.0)], np.full(6, 1e-5)


def compare(steps, horizons=(3, 5, 8)):
    """Return by name: cost, largest error of a leg [m] and median CPU time of a call [s]."""
    model = Model.from_scene('stewart_platform')
    home, stepper = model.assemble(), model.stepper(PERIOD)
    change = np.r_[ASIDE * np.random.default_rng(1).uniform(-1.0, 1.0, 6), np.zeros(6)]
    start = model.state(*stepper.plus(home.q, home.qd, change))
    regulator = LinearRegulator(model, home, PERIOD, *COSTS)
    limit = 1.5 * np.abs(regulator.torques).max()
    controllers = {'regulator, clipped': regulator} | {
        f'predictive, {one} periods': PredictiveController(
            model, home, PREDICTED, one, *COSTS, limit) for one in horizons}
    return {name: run(model, start, home, one, stepper, limit, steps)
            for name, one in controllers.items()}


def run(model, start, home, controller, stepper, limit, steps):
    """Return the cost, the largest error at the end and the CPU time of a run."""
    simulation, cost, times = Simulation(model, start, 'rk4'), 0.0, []
    for _ in range(steps):
        begun = time.process_time()
        force = controller.torque(simulation.position, simulation.velocity)
        times.append(time.process_time() - begun)
        simulation.step(np.clip(force, -limit, limit), PERIOD)
        away = stepper.minus(simulation.position, simulation.velocity, home.q, home.qd)
        cost += PERIOD * away @ (COSTS[0] * away)
    return cost, np.abs(away[:6]).max(), np.median(times)


if __name__ == '__main__':
    for name, found in compare(int(sys.argv[1]) if len(sys.argv) > 1 else 600).items():
        print('{:24} cost {:.2f}, {:.1e} m from home, {:.0f} us a call'.format(
            name, *found[:2], 1e6 * found[2]))
