# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What an estimator costs, and whether its bands hold what they say.

A cycle is a prediction of 1 ms, under new torques, and an update by the encoders of all driven
joints.

``--coverage``: runs from states drawn about the start, under torques with noise, of six machines:
how often the true state lies in its 95 % region, how often alarms come where the masses are as
given, and where one is 1.5 times that. They are drawn again the same for a seed.
"""

from dataclasses import replace

import closedloop_dynamics as cld
from closedloop_dynamics.estimation.estimator import Estimator, Noise, Start
from closedloop_dynamics.estimation.sensors import JointSensor
from closedloop_dynamics.estimation.unknowns import JointTorque, Number
from closedloop_dynamics.simulation.stepper import Stepper
from closedloop_dynamics.visual.progress import parts_bar
from machine import least, parser_of
import numpy as np
from scipy.stats import chi2

PERIOD = 1e-3  # [s]
DEVIATION = 1e-4  # [rad or m]
POSITION, RATE = 0.005, 0.05  # Deviations of the start [rad or m], [rad/s or m/s]
# Of machines by scene: the body whose mass is another one, and how long a run is [s]. The crank of
# the carpet scraper turns by 0.2 rad in 0.3 s, and within that a mass of the coupler is nearly an
# unknown torque on the crank: 1.5 times the mass is known by 4.9 standard deviations, as large as
# what alarms come from. In 1.2 s it turns by 2 rad, and these are 26.
MACHINES = {'three_rrr': ('platform', 0.3), 'four_bar': ('coupler', 0.3),
            'stewart_platform': ('platform', 0.3), 'delta_robot': ('platform', 0.3),
            'bennett': ('rocker', 0.3), 'carpet_scraper': ('coupler', 1.2)}
CONFIDENCE = 0.95
WRONG = 1.5
START = Start(position=POSITION, rate=RATE)


def model_of(scene):
    """Return the model of a scene without stops, which are out of reach here."""
    found = cld.load_scene(scene)
    return cld.Model(replace(found, effects={
        name: one for name, one in found.effects.items() if type(one).__name__ == 'Gravity'}))


def holding(model):
    """Return the torques that hold the start, and their size."""
    start = model.assemble()
    torque = model.inverse(start, np.zeros(len(start.qd))).torque
    return torque, max(np.abs(torque).max(), 0.1)


class Case:
    """A machine whose driven joints swing about the start, and its sensors."""

    def __init__(self, scene, seed=0):
        # Machines do not share draws.
        self.model, self.rng = model_of(scene), np.random.default_rng((seed, *scene.encode()))
        self.driven = self.model.actuated_joints
        self.sensors = [JointSensor(name, joint=name, deviation=DEVIATION)
                        for name in self.driven]
        self.hold, self.size = holding(self.model)
        coordinates = self.model.coordinates
        self.places = np.array([coordinates.place[coordinates.index[name]]
                                for name in self.driven])
        self.simulation = cld.Simulation(
            self.model, None, {'integrator': 'rk4', 'step_size': PERIOD})
        self.density = 0.01 * self.size
        self.stepper = Stepper(self.model, PERIOD, jacobians=False)

    def torque(self, time):
        """Return torques that swing."""
        phase = np.arange(len(self.hold))
        return self.hold + 0.2 * self.size * np.sin((9.0 + phase) * time + phase)

    def readings(self, simulation):
        """Return what encoders read."""
        noise = DEVIATION * self.rng.standard_normal(len(self.places))
        return dict(zip(self.driven, (simulation.position[self.places] + noise).tolist()))

    def drawn(self):
        """Return a state drawn about the start."""
        start, n = self.model.assemble(), len(self.stepper.independent)
        q, qd = self.stepper.plus(start.q, start.qd, self.rng.standard_normal(2 * n) * np.repeat(
            (POSITION, RATE), n))
        return self.model.state(q, qd)


def cycles(scene, steps, repetitions):
    """Print what a cycle costs, and the error of the rates at the end."""
    case = Case(scene)
    torques, readings = [], []
    for k in range(steps):
        torques.append(case.torque(k * PERIOD))
        case.simulation.step(dict(zip(case.driven, torques[-1])), PERIOD)
        readings.append(case.readings(case.simulation))
    estimator = Estimator(case.model, case.sensors, (), Noise(1.0), START)

    def run():
        estimator.restart(START)
        for k in range(steps):
            estimator.command(k * PERIOD, torques[k])
            estimator.measure_all((k + 1) * PERIOD, readings[k])

    cycle = least({scene: run}, repetitions)[scene] / steps
    error = np.abs(estimator.belief.state.qd - case.simulation.velocity).max()
    print(f'{scene}: a cycle {1e6 * cycle:.1f} us, largest error of rates {error:.2e}', flush=True)


def coverage(scene, runs, seed):
    """Print how often bands hold the truth, and how often alarms come."""
    case = Case(scene, seed)
    unknowns = [JointTorque('load', joint=case.driven[0], deviation=0.1 * case.size)] if (
        scene == 'carpet_scraper') else []
    body, length = MACHINES[scene]
    suspects = [Number('mass', key=f'mechanism.bodies.{body}.mass', deviation=1.0)]
    estimator = Estimator(case.model, case.sensors, unknowns, Noise(torque=case.density), START,
                          suspects=suspects, gate=1.0 - 1e-12)
    mass = next(one.mass for one in case.model.mechanism.bodies if one.name == body)
    other = case.model.with_parameters({f'mechanism.bodies.{body}.mass': WRONG * mass})
    simulations = {True: case.simulation, False: cld.Simulation(
        other, None, {'integrator': 'rk4', 'step_size': PERIOD})}
    inside, alarms, period = {True: 0, False: 0}, {True: 0, False: 0}, 5e-3
    with parts_bar('runs', scene) as progress:
        for run in range(runs):
            for right, simulation in simulations.items():
                simulation.stepping.begin_at(case.drawn())
                load = np.zeros(len(case.driven))
                if unknowns:
                    load[0] = 0.1 * case.size * case.rng.standard_normal()
                estimator.restart(START)
                for k in range(round(length / period)):
                    torque = case.torque(k * period)
                    estimator.command(k * period, torque)
                    noise = case.density / period ** 0.5 * case.rng.standard_normal(len(load))
                    simulation.step(dict(zip(case.driven, torque + load + noise)), period)
                    estimator.measure_all((k + 1) * period, case.readings(simulation))
                belief = estimator.belief
                error = estimator.filter.plant.stepper.minus(
                    simulation.position, simulation.velocity, belief.state.q, belief.state.qd)
                error = np.concatenate((error, load[:len(belief.names)] - belief.values))
                nees = error @ np.linalg.solve(belief.covariance, error)
                inside[right] += nees <= chi2.ppf(CONFIDENCE, len(error))
                alarms[right] += bool(estimator.alarms)
            progress(run + 1, runs)
    shares = [100.0 * count / runs for count in (inside[True], alarms[True], alarms[False])]
    print('{}: {:.1f} % in the 95 % region; alarms {:.1f} % as given, {:.1f} % with {} {} times '
          'as heavy'.format(scene, *shares, body, WRONG), flush=True)


def main(arguments=None):
    """Run what is asked for."""
    parser = parser_of(__doc__)
    parser.add_argument('--coverage', nargs='?', type=int, const=1000, metavar='RUNS',
                        help='runs of each of six machines, 1,000 where not given')
    parser.add_argument('--machines', nargs='+', choices=MACHINES, default=list(MACHINES))
    parser.add_argument('--steps', type=int, default=200)
    parser.add_argument('--repetitions', type=int, default=10)
    parser.add_argument('--seed', type=int, default=1)
    given = parser.parse_args(arguments)
    for scene in given.machines:
        if given.coverage:
            coverage(scene, given.coverage, given.seed)
        elif scene in ('three_rrr', 'stewart_platform'):
            cycles(scene, given.steps, given.repetitions)


if __name__ == '__main__':
    main()
