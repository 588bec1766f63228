# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What accuracy costs on every shipped scene, and on ten robots that others have published.

Each machine moves freely from its start, and under torques that swing and are held at 100 Hz and
at 1 kHz. The default method is asked for an accuracy of 1e-3, 1e-6 and 1e-9; beside it stand
Pinocchio (constraintDynamics and lcaba, RK4 and Runge-Kutta-Fehlberg 7(8) in C++) and MuJoCo (RK4
and implicitfast, its loops as stiff as the step allows) wherever they can be told the machine with
all its effects: the cheapest of their settings that keeps the error, found by bisection on four
settings a decade. No time is taken before accelerations agree with ours; where they do not, the
benchmark is wrong and ends.

The motion that errors are measured against is that of dop853 with a tolerance of 1e-13; dopri5
with another integrator shows how far and how well it is known. CPU time of one thread; of held
torques that of a loop in Python that makes a call for each of them. Robots are found by name in a
folder with a clone of example-parallel-robots and left out without it.
"""

import csv
import json
import math
from pathlib import Path
import sys
import time
import warnings

import peer_runner  # noqa: I100 (before anything loads a library that has threads of its own)
from machine import commit, description, parser_of  # noqa: I100
import numpy as np
import peer_cases

from closedloop_dynamics.mechanism.errors import SimulationError  # noqa: I100
from closedloop_dynamics.mechanism.mechanism import MechanismError
from closedloop_dynamics.scene.loading import load_scene, scene_names
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import write_csv

SOURCE = 'https://github.com/Gepetto/example-parallel-robots'
ROBOTS = ('5bar_linkage', '5bar_linkage_iso3d', 'battobot_6d', 'cassie_like', 'digit_like',
          'digit_like_2legs', 'disney_like', 'robot_delta', 'talos_like', 'wl16_like')
TARGETS = (1e-3, 1e-6, 1e-9)
# Torques a second; 0: none, the machine is let go.
RATES = (0, 100, 1000)  # [Hz]
DURATION = 1.0  # [s]
OUTPUTS = 100
# What the torques would alone accelerate a drive by, on average, and how they swing.
PUSH, SWING = 2.0, 2.0  # [rad/s^2 or m/s^2], [Hz]
# The reference and what proves it: integrator, tolerance.
REFERENCES = (('dop853', 1e-13), ('dopri5', 1e-12), ('rodas4', 1e-10))
# How well the reference must be known [rad or m]; less well only where it would be known for less
# than so much of the motion.
KNOWN, SHORTEST = (3e-10, 3e-7, 3e-4), 0.1
ROUNDS, QUICK_ROUNDS = 5, 2
OURS = 'default'
PEERS = {'peer_pinocchio': 'Pinocchio', 'peer_mujoco': 'MuJoCo'}
# Tolerances and steps [s] of the others: the coarsest, and how many, four a decade.
TOLERANCES = tuple(0.1 * 10.0 ** (-0.25 * number) for number in range(49))
STEPS = tuple(0.1 * 10.0 ** (-0.25 * number) for number in range(17))
# Where accelerations are compared: states, how far from the start [rad or m], their rates and
# torques.
STATES, APART, FAST, TORQUE = 3, 0.05, 1.0, 1.0
HEADER = ('machine', 'kind', 'rate', 'engine', 'setting', 'target', 'error',
          'cpu_time_per_second', 'evaluations_per_second', 'known_to', 'duration', 'note')


def plan(rounds):
    """Return what is tried on each motion."""
    return peer_runner.Plan(TOLERANCES, STEPS, springs=(0.3,), rounds=rounds, longest=0.6,
                            enough=0.3, accuracies=TARGETS, targets=TARGETS)


def torques(simulation, rate):
    """Return torques that are held one after the other, as ``advance`` takes them."""
    if not rate:
        return simulation.joint_torques(None)[np.newaxis]
    mean, state = {}, (simulation.position, simulation.velocity)
    still = simulation.forward_dynamics(*state)[0]
    rates = simulation.mechanism.coordinates.rates
    for joint in simulation.actuated_joints:
        if joint in rates and rates[joint].stop == rates[joint].start + 1:
            moved = simulation.forward_dynamics(*state, {joint: 1.0})[0] - still
            response = abs(float(moved[rates[joint].start]))
            if response > 1e-9:
                mean[joint] = PUSH / response
    if not mean:
        raise SimulationError('no drives')
    swing = 1.0 + np.cos(2.0 * np.pi * SWING * np.arange(round(DURATION * rate)) / rate)
    whole = simulation.joint_torques(mean)
    return swing[:, np.newaxis] * whole


def measured(machine, rounds):
    """Return the rows of a machine: the default method's, and those of others that know it."""
    cases, rows = [], []
    for rate in RATES:
        try:
            cases.append(peer_cases.Case(
                rate, machine, torques(Simulation(machine.scene), rate), DURATION, OUTPUTS,
                REFERENCES, KNOWN, SHORTEST))
        except SimulationError as error:
            rows.append({'rate': rate, 'engine': OURS, 'note': str(error)})
    (ours,), _ = peer_runner.engines(machine, [peer_runner.OURS])
    built, why = peer_runner.engines(machine, PEERS)
    rows += [{'rate': 0, 'engine': PEERS[name], 'note': reason} for name, reason in why.items()]
    tasks = [('', case, engine) for engine in (ours, *built) for case in cases
             if engine is ours or not case.still]
    states = peer_cases.random_states(machine.scene, STATES, APART, FAST, TORQUE, drives=True)
    for engine in built:
        for one in peer_runner.agreement(machine, [engine], states)[1:]:
            name = one['engine'].partition(', ')[2][:-1]
            if not one['error'] <= engine.agreed:
                # It was told the machine that another algorithm of the library knows.
                engine.others.pop(name)
                rows.append({'rate': 0, 'engine': engine.name, 'setting': name, 'note': (
                    f'wrong by this algorithm: {machine.name} in {engine.name}, {name}: '
                    f'accelerations differ from ours by {one["error"]:.2g}, relative; at most '
                    f'{engine.agreed:g} was expected')})
    for row in peer_runner.motions(tasks, plan(rounds)):
        case = row['case']
        rows.append({
            'rate': case.name, 'engine': row['engine'],
            'setting': ', '.join(filter(None, (row['line'], row['setting']))),
            'target': row['target'], 'error': row['error'], 'cpu_time_per_second': row['best'],
            'evaluations_per_second': row['evaluations'], 'known_to': case.uncertainty,
            'duration': case.duration,
            'note': row['note'] or ('stands still' if case.still else '')})
    return rows


def robots(directory):
    """Return {name: file} of the robots that are found in a folder."""
    found = {}
    for path in peer_cases.files(directory) if directory else ():
        # Not those that its authors have put aside.
        if 'old' not in path.parts:
            found.setdefault(peer_cases.name_of(path), path)
    return {name: found[name] for name in ROBOTS if name in found}


def write(rows, path):
    """Write all rows as a CSV file."""
    write_csv(path, HEADER, [tuple(each.get(key, '') for key in HEADER) for each in rows])


def read(path):
    """Return the rows of a CSV file, numbers as numbers."""
    with open(path, newline='', encoding='utf-8') as file:
        return [{key: value if key in ('machine', 'kind', 'engine', 'setting', 'note')
                 else float(value or math.nan) for key, value in each.items()}
                for each in csv.DictReader(file)]


def main(arguments=None):
    """Measure and write; see the module."""
    parser = parser_of(__doc__, 'fewer rounds', output=True)
    parser.add_argument('machines', nargs='*', help='default: all; of those that were measured '
                        'into the same directory at this commit none again')
    parser.add_argument('--models', type=Path, metavar='DIR',
                        help=f'with a clone of {SOURCE}; without it no robots')
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    kept = options.output / 'all_machines.json'
    result = json.loads(kept.read_text()) if kept.exists() else {}
    if (result.get('commit'), result.get('quick')) != (commit(), options.quick):
        result = {'commit': commit(), 'quick': options.quick, 'machine': description(),
                  'machines': {}}
    # How far off runs are stands in the table, and robots are read as models.py tells.
    warnings.simplefilter('ignore')
    paths = {**dict.fromkeys(sorted(scene_names())), **robots(options.models)}
    for name, path in paths.items():
        if name in result['machines'] or options.machines and name not in options.machines:
            continue
        begin = time.process_time()
        try:
            machine = peer_cases.published(path) if path else peer_cases.Machine(
                name, load_scene(name))
            rows = measured(machine, QUICK_ROUNDS if options.quick else ROUNDS)
        except (SimulationError, MechanismError) as error:
            rows = [{'rate': 0, 'engine': OURS, 'note': str(error)}]
        result['machines'][name] = [
            {'machine': name, 'kind': 'robot' if path else 'scene', **row} for row in rows]
        kept.write_text(json.dumps(result, indent=1))
        print(f'{name}: {time.process_time() - begin:.1f} s', file=sys.stderr, flush=True)
    write([each for rows in result['machines'].values() for each in rows],
          options.output / 'all_machines.csv')
    return 0


if __name__ == '__main__':
    sys.exit(main())
