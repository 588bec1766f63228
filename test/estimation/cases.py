# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines, records of them and what is thought of them, for tests of estimators."""

import closedloop_dynamics as cld
from closedloop_dynamics.estimation.estimator import Noise, Start
from closedloop_dynamics.estimation.results import Record
from closedloop_dynamics.estimation.sensors import JointSensor
import numpy as np

RUNGE_KUTTA = {'integrator': 'rk4', 'step_size': 1e-3}


def spring_chain(count=2):
    """Return the model of masses in a row, on springs with dampers, without gravity: linear."""
    bodies, joints, effects = {}, {}, {}
    for n in range(count):
        bodies[f'mass_{n}'] = {'mass': 1.0 + n, 'center_of_mass': [0.0, 0.0], 'inertia': 0.1}
        joints[f'slide_{n}'] = {
            'type': 'prismatic', 'parent': f'mass_{n - 1}' if n else 'ground',
            'child': f'mass_{n}', 'position': [0.0, 0.0], 'actuated': n == 0}
        effects[f'spring_{n}'] = {'type': 'joint_spring', 'joint': f'slide_{n}',
                                  'stiffness': 30.0 + 10.0 * n}
        effects[f'damper_{n}'] = {'type': 'joint_damping', 'joint': f'slide_{n}',
                                  'coefficient': 0.5}
    return cld.Model.from_scene({
        'mechanism': {'name': 'chain', 'bodies': bodies, 'joints': joints},
        'initial': {'position': dict.fromkeys(joints, 0.0), 'hold': list(joints)},
        'effects': effects})


def pendulum():
    """Return the model of a pendulum with a motor."""
    return cld.Model.from_scene({
        'mechanism': {'name': 'pendulum', 'bodies': {
            'bob': {'mass': 1.5, 'center_of_mass': [0.0, -0.4], 'inertia': 0.02}},
            'joints': {'pivot': {'type': 'revolute', 'parent': 'ground', 'child': 'bob',
                                 'position': [0.0, 0.0], 'actuated': True}}},
        'initial': {'position': {'pivot': 0.0}, 'hold': ['pivot']},
        'effects': {'gravity': {'type': 'gravity', 'acceleration': [0.0, -9.81]}}})


def encoders(names, deviation, **more):
    """Return sensors of the positions of joints, with the joints' names."""
    return [JointSensor(name, joint=name, deviation=deviation, **more) for name in names]


class Machine:
    """
    A machine that moves, with readings of its sensors.

    ``drive`` takes the time, positions and rates and returns torques of the actuated joints.
    """

    def __init__(self, model, drive, state=None, seed=0):
        self.simulation = cld.Simulation(model, state, RUNGE_KUTTA)
        self.model, self.drive, self.rng = model, drive, np.random.default_rng(seed)

    def run(self, duration, period, readings):
        """Return a Record and the states; ``readings(simulation)``: what sensors read."""
        simulation, times, torques, states = self.simulation, [], [], []
        measured = {}
        for k in range(round(duration / period) + 1):
            times.append(simulation.time)
            states.append(simulation.snapshot())
            torques.append(self.drive(simulation.time, simulation.position, simulation.velocity))
            for name, value in readings(simulation, self.rng).items():
                measured.setdefault(name, []).append(value)
            simulation.step(dict(zip(self.model.actuated_joints, torques[-1])), period)
        return Record(np.array(times), np.array(torques), {
            name: np.array(values) for name, values in measured.items()}), states


def positions_of(names, deviation):
    """Return a function for the readings of noisy encoders."""
    def read(simulation, rng):
        index = simulation.coordinates
        return {name: simulation.position[index.place[index.index[name]]]
                + deviation * rng.standard_normal() for name in names}
    return read


def steps_of(names, bits):
    """Return a function for the readings of encoders with so many steps a turn."""
    step = 2.0 * np.pi / 2 ** bits

    def read(simulation, rng):
        index = simulation.coordinates
        return {name: step * np.round(
            simulation.position[index.place[index.index[name]]] / step) for name in names}
    return read


def held_path(model, amplitude=0.15, frequency=1.0, stiffness=300.0):
    """Return a drive that holds the actuated joints near a path about the start."""
    start = model.assemble()
    places = [model.coordinates.index[name] for name in model.actuated_joints]
    middle = model.coordinates.by_freedom(start.q)[places]
    phase = np.arange(len(places))

    def drive(time, position, velocity):
        wanted = middle + amplitude * (np.sin(
            2.0 * np.pi * frequency * (1.0 + 0.1 * phase) * time + phase) - np.sin(phase))
        q = model.coordinates.by_freedom(position)
        return stiffness * (wanted - q[places]) - 0.1 * stiffness * velocity[places]
    return drive


def drawn_start(model, position, rate, rng):
    """Return a state drawn about the start as ``Start`` has it."""
    from closedloop_dynamics.simulation.stepper import Stepper
    stepper, start = Stepper(model, 1e-3, jacobians=False), model.assemble()
    n = len(stepper.independent)
    q, qd = stepper.plus(start.q, start.qd, rng.standard_normal(2 * n) * np.repeat(
        (position, rate), n))
    return model.state(q, qd)


__all__ = ['drawn_start', 'encoders', 'held_path', 'Machine', 'Noise', 'pendulum', 'positions_of',
           'spring_chain', 'Start', 'steps_of']
