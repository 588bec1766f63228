# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models of robots as others have published them, beside Pinocchio and MuJoCo.

Takes a folder of models, which this project does not ship: clones of example-parallel-robots,
mujoco_menagerie and others. Closes the loops of each, compares accelerations in random states with
those of Pinocchio (which reads URDF itself) and MuJoCo (MJCF), iterated or extrapolated until
loops are hard, and measures the time of an evaluation beside theirs, in turn, on one thread.
"""

from dataclasses import replace
import json
from pathlib import Path
import sys
import time
import warnings

import peer_runner  # noqa: I100 (before anything loads a library that has threads of its own)
from machine import description, parser_of  # noqa: I100
import numpy as np
import peer_cases

from closedloop_dynamics.formats.registry import read_model  # noqa: I100
from closedloop_dynamics.kinematics.global_assembly import ClosureProblem
from closedloop_dynamics.kinematics.modeling import extent
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.mechanism.mechanism import MechanismError, REVOLUTE, SPHERICAL
from closedloop_dynamics.scene.model_scene import assembled, scene_of_model
from closedloop_dynamics.scene.records import Initial
from closedloop_dynamics.visual.tables import markdown_table, seconds, write_csv

STATES, QUICK_STATES = 10, 2
ROUNDS, QUICK_ROUNDS = 25, 3
# How far random states are from the closed start [rad or m], their rates and torques.
APART, FAST, TORQUE = 0.05, 1.0, 1.0
# Larger mechanisms are not measured.
LARGEST = 60
# Whose loops are as hard as they are read, by the ending of the file.
READERS = {'.urdf': 'Pinocchio', '.xml': 'MuJoCo', '.mjcf': 'MuJoCo'}
BALLS = 'balls'
# Of each column of times its name in the CSV file, and what is timed there.
TIMES = {'ours': ('', 'evaluation, compiled loop'), 'Pinocchio': ('', 'evaluation, C++ loop'),
         'Pinocchio, balls': (BALLS, 'evaluation, C++ loop'),
         'lcaba': ('', 'evaluation by lcaba, C++ loop'), 'MuJoCo': ('', 'mj_step (Euler), C loop')}
CLOSING = ('name', 'freedoms of joints', 'loops', 'rank', 'equations', 'moved', 'gap', 'closed in',
           'built in')


def measure_model(path, quick, largest=LARGEST):
    """
    Measure a model.

    Parameters
    ----------
    path : pathlib.Path
        Of its file.
    quick : bool
        Few states and rounds.
    largest : int
        Evaluations of models with more freedoms of joints are not measured.

    Returns
    -------
    dict or None
        None for a model without loops.

    """
    imported = read_model(path)
    mechanism = imported.mechanism
    if not (mechanism.cut_joints or mechanism.couplings):
        return None
    row = {'name': peer_cases.name_of(path), 'freedoms of joints': mechanism.coordinates.nv,
           'loops': len(mechanism.cut_joints) + len(mechanism.couplings)}
    begin = time.process_time()
    imported, found, notes = assembled(imported)
    row['closed in'] = time.process_time() - begin
    if not found.closed:
        return {**row, 'failed': ' '.join(notes)}
    # Anchors of loops may have moved.
    mechanism = imported.mechanism
    loops = ClosureProblem(mechanism, extent(mechanism))
    start = loops.start(imported.position)
    row.update({
        'moved': float(np.abs(mechanism.coordinates.apart(found.q, start)).max(initial=0.0)),
        'gap': max(found.closure_errors.values()), 'rank': loops.rank(found.q),
        'equations': mechanism.number_of_equations})
    if loops.nv > largest:
        return {**row, 'why': [f'more than {largest} freedoms of joints']}
    machine = peer_cases.Machine(
        row['name'], peer_cases.under_gravity(scene_of_model(path, imported)), path)
    begin = time.process_time()
    built, _ = peer_runner.engines(machine, [peer_runner.OURS])
    states = peer_cases.random_states(
        machine.scene, QUICK_STATES if quick else STATES, APART, FAST, TORQUE, drives=True)
    row['built in'] = time.process_time() - begin
    others, why = peer_runner.engines(machine, ('peer_pinocchio', 'peer_mujoco'))
    row.update(why=[*map(': '.join, why.items())], errors={})
    for engine in others:
        try:
            first, *by_others = peer_runner.agreement(machine, [engine], states)
        except peer_cases.Disagreement as error:
            row['why'].append(str(error))
            continue
        built.append(engine)
        if READERS.get(path.suffix.lower()) == engine.name:
            row['errors'][engine.name] = first['limit']
        if engine.name == 'Pinocchio':
            row['errors'].update(constraintDynamics=first['error'], lcaba=by_others[0]['error'])
    tasks = [('', engine, states[0]) for engine in built]
    merged = with_balls(mechanism)
    if merged is not mechanism and 'constraintDynamics' in row['errors']:
        # At other coordinates than ours: what an evaluation takes is the same.
        state = merged.coordinates.start(), *np.zeros((2, merged.coordinates.nv))
        scene = replace(machine.scene, mechanism=merged, initial=Initial(*map(tuple, state[:2])))
        (engine,), _ = peer_runner.engines(peer_cases.Machine(row['name'], scene),
                                           ['peer_pinocchio'])
        tasks.append((BALLS, engine, state))
    times = {(of['tree'], of['what']): of for of in peer_runner.evaluation_times(
        tasks, QUICK_ROUNDS if quick else ROUNDS)}
    row['times'] = {name: times[key] for name, key in TIMES.items() if key in times}
    return row


def with_balls(mechanism):
    """
    Return a mechanism whose three hinges through one place, without mass between, are one ball.

    As the authors of some models load them.
    """
    below, massless = {}, {body.name for body in mechanism.bodies if body.massless}
    for joint in mechanism.joints:
        below.setdefault(joint.parent, []).append(joint)
    closed = {body for cut in mechanism.cut_joints for body in (cut.body_a, cut.body_b)}
    joints, gone = {joint.name: joint for joint in mechanism.joints}, set()
    for joint in mechanism.joints:
        chain = [joint]
        while len(chain) < 3 and chain[-1].child in massless - closed and len(
                below.get(chain[-1].child, ())) == 1:
            chain += below[chain[-1].child]
        if len(chain) == 3 and all(one.type == REVOLUTE for one in chain) and not any(
                any(one.position) for one in chain[1:]) and joint.name in joints:
            joints[joint.name] = replace(joint, type=SPHERICAL, axis=None, child=chain[2].child)
            for one, other in zip(chain, chain[1:]):
                del joints[other.name]
                gone.add(one.child)
    return mechanism if not gone else replace(
        mechanism, joints=tuple(joints.values()),
        bodies=tuple(body for body in mechanism.bodies if body.name not in gone))


def evaluation_table(result):
    """Return differences of accelerations, and times of an evaluation."""
    rows = []
    for row in result['models']:
        if 'times' not in row:
            continue
        errors, own = row['errors'], row['times']['ours']['best']
        times = {name: f'{seconds(one["best"])} ({one["best"] / own:.1f})'
                 for name, one in row['times'].items()}
        rows.append((row['name'], next((
            f'{errors[name]:.0e} ({name})' for name in ('Pinocchio', 'MuJoCo') if name in errors),
            '-'), *(f'{errors[name]:.0e}' if name in errors else '-'
                    for name in ('constraintDynamics', 'lcaba')),
            seconds(own), *(times.get(name, '-') for name in list(TIMES)[1:])))
    return markdown_table((
        'model', 'ours differ from', 'constraintDynamics from ours', 'lcaba from ours', 'ours',
        'constraintDynamics in C++ (times ours)', 'the same, three hinges as a ball',
        'lcaba in C++', 'mj_step in C'), rows)


def main(arguments=None):
    """Run the comparison."""
    parser = parser_of(__doc__, 'see that it runs: rough numbers', output=True)
    parser.add_argument('directory', type=Path, metavar='DIR', help='with models, in any depth')
    parser.add_argument('--only', nargs='+', metavar='NAME', help='models by what they are called')
    parser.add_argument('--largest', type=int, default=LARGEST, metavar='N',
                        help='leave out models whose joints have more freedoms '
                        '(default: %(default)s)')
    options = parser.parse_args(arguments)
    result, taken = {'machine': description(), 'quick': options.quick, 'models': []}, []
    warnings.simplefilter('ignore')
    for path in peer_cases.files(options.directory):
        if options.only and peer_cases.name_of(path) not in options.only:
            continue
        try:
            row = measure_model(path, options.quick, options.largest)
        except (MechanismError, SimulationError) as error:
            print(f'{path}: {error}', file=sys.stderr)
            continue
        if row is None:
            continue
        taken.append(row['name'])
        if taken.count(row['name']) > 1:
            row['name'] += f' ({taken.count(row["name"])})'
        print(f'{row["name"]}: ' + row.get('failed', '; '.join(row.get('why', [])) or 'measured'),
              file=sys.stderr, flush=True)
        result['models'].append(row)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / 'models.json').write_text(json.dumps(result, indent=1))
    write_csv(options.output / 'models.csv', (*CLOSING, *(f'{name} [s]' for name in TIMES)), [
        (*(row.get(key, '') for key in CLOSING),
         *(row.get('times', {}).get(name, {}).get('best', '') for name in TIMES))
        for row in result['models']])
    print(f'{result["machine"]}\n\n{evaluation_table(result)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
