# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models of robots as others have published them, beside Pinocchio and MuJoCo.

Takes a folder of models, which this project does not ship: clones of example-parallel-robots,
mujoco_menagerie and others. Closes the loops of each, compares accelerations in random states with
those that follow from the inertia, bias force and Jacobian of Pinocchio (which reads URDF itself)
or MuJoCo (MJCF), and measures the time of an evaluation beside theirs, in turn, on one thread.
"""

import argparse
from dataclasses import replace
import json
import os
from pathlib import Path
import statistics
import sys
import time
import warnings

# Before anything loads a library that has threads of its own.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'

from evaluations import evaluate_again  # noqa: E402
from machine import description, ROOT  # noqa: E402,I100
import numpy as np  # noqa: E402

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.formats.registry import is_model, read_model  # noqa: E402,I100
from closedloop_dynamics.mechanism.mechanism import MechanismError  # noqa: E402
from closedloop_dynamics.simulation.errors import SimulationError  # noqa: E402
from closedloop_dynamics.simulation.global_assembly import (  # noqa: E402
    ClosureProblem, find_closed)
from closedloop_dynamics.simulation.model_scene import assembled, scene_of_model  # noqa: E402
from closedloop_dynamics.simulation.modeling import extent  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.visual.tables import (  # noqa: E402
    markdown_table, seconds, text_table, write_csv)

STATES, QUICK_STATES = 10, 2
ROUNDS, QUICK_ROUNDS = 25, 3
# How far random states are from the closed start [rad, shares of the size], and rates [rad/s].
FAR, FAST = 0.1, 1.0
# Timing: calls at once take about this long [s].
PORTION = 4e-3
# Larger mechanisms are not measured.
LARGEST = 60


def files(directory):
    """Return the files of models in a folder and below, sorted."""
    return sorted(path for path in Path(directory).rglob('*')
                  if path.is_file() and is_model(path) and path.suffix.lower() != '.xacro')


def name_of(path):
    """Return what a model is called in the tables: its file, or the folder of a plain name."""
    stem = path.stem
    return path.parent.name if stem in ('robot', 'model', 'scene') else stem


def _unique(name, taken):
    """Return a name, numbered where another model has it."""
    number = taken[name] = taken.get(name, 0) + 1
    return name if number == 1 else f'{name} ({number})'


def states_of(mechanism, start, count):
    """Return closed states around a start: coordinates, rates and torques of the drives."""
    rng, size = np.random.default_rng(1), extent(mechanism)
    loops, driven = ClosureProblem(mechanism, size), list(mechanism.coordinates.actuated)
    found = []
    for _ in range(100 * count):
        if len(found) == count:
            break
        near = find_closed(mechanism, size, loops.moved(
            start, FAR * loops.scale * rng.uniform(-1.0, 1.0, loops.nv)), starts=0)
        if not near.closed:
            continue
        jac = loops.residual(near.q)[1]
        left, singular, right = np.linalg.svd(jac, full_matrices=False)
        kept = singular > 1e-7 * singular.max(initial=1e-300)
        rates = FAST * rng.uniform(-1.0, 1.0, loops.nv)
        rates -= right[kept].T @ (right[kept] @ rates)
        tau = np.zeros(loops.nv)
        tau[driven] = rng.uniform(-1.0, 1.0, len(driven))
        found.append((near.q, rates, tau))
    return found


def hard(inertia, force, jac, bias, rank):
    """Return the accelerations of equations of motion whose Jacobian has a rank."""
    left, singular, right = np.linalg.svd(jac, full_matrices=False)
    rows = right[:rank]
    wanted = -(left[:, :rank].T @ bias) / singular[:rank]
    n = len(force)
    whole = np.block([[inertia, rows.T], [rows, np.zeros((rank, rank))]])
    return np.linalg.solve(whole, np.concatenate([force, wanted]))[:n]


def peers(path, mechanism, gravity):
    """Return the other simulators that know a model, by name; and why the rest does not."""
    found, why = {}, []
    try:
        import model_pinocchio
        if path.suffix.lower() == '.urdf':
            found['Pinocchio'] = model_pinocchio.Pinocchio.read(path, mechanism, gravity)
            found['lcaba'] = model_pinocchio.Pinocchio.read(
                path, mechanism, gravity, algorithm='lcaba')
            balls = model_pinocchio.Pinocchio.read(path, mechanism, gravity, balls=True)
            if balls.merged:
                found['Pinocchio, balls'] = balls
    except (ImportError, ValueError) as error:
        why.append(f'Pinocchio: {error}')
    try:
        import model_mujoco
        found['MuJoCo'] = model_mujoco.MuJoCo(path, mechanism, gravity)
    except (ImportError, ValueError, MechanismError) as error:
        why.append(f'MuJoCo: {error}')
    return found, why


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
    row = {'name': name_of(path), 'freedoms of joints': mechanism.coordinates.nv,
           'loops': len(mechanism.cut_joints) + len(mechanism.couplings)}
    begin = time.process_time()
    imported, found, notes = assembled(imported)
    row['closed in'] = time.process_time() - begin
    if not found.closed:
        return {**row, 'failed': ' '.join(notes)}
    # Anchors of loops may have moved.
    mechanism = imported.mechanism
    size = extent(mechanism)
    loops = ClosureProblem(mechanism, size)
    start = loops.start(imported.position)
    row.update({
        'moved': float(np.abs(mechanism.coordinates.apart(found.q, start)).max(initial=0.0)),
        'gap': max(found.closure_errors.values()), 'rank': loops.rank(found.q),
        'equations': mechanism.number_of_equations})
    if loops.nv > largest:
        return {**row, 'why': [f'more than {largest} freedoms of joints']}
    gravity = next((values['acceleration'] for values in imported.effects.values()
                    if values['type'] == 'gravity'), (0.0, 0.0, 0.0))
    scene = scene_of_model(path, imported)
    scene = replace(scene, effects={name: effect for name, effect in scene.effects.items()
                                    if type(effect).__name__ == 'Gravity'})
    others, row['why'] = peers(path, mechanism, gravity)
    begin = time.process_time()
    simulation = Simulation(scene)
    system = simulation.data.system
    states = states_of(mechanism, found.q, QUICK_STATES if quick else STATES)

    def ours(state, count=1):
        position, rates, tau = state
        system.tau[:] = tau
        evaluate_again(system, position.copy(), rates.copy(), count)
        return system.qdd.copy()

    ours(states[0])
    row['built in'] = time.process_time() - begin
    row['errors'] = {}
    for name, other in others.items():
        if getattr(other, 'own', name == 'Pinocchio'):
            row['errors'][name] = max(relative(ours(state), hard(
                *other.equations(*state), row['rank'])) for state in states)
    for name, told in (('Pinocchio', 'constraintDynamics'), ('lcaba', 'lcaba')):
        if name in others:
            row['errors'][told] = max(relative(
                others[name].evaluate(*state), ours(state)) for state in states)
    row['times'] = times_of(ours, others, states[0], QUICK_ROUNDS if quick else ROUNDS)
    return row


def relative(one, other):
    """Return the largest difference of accelerations, relative to the largest."""
    return float(np.abs(one - other).max() / np.abs(other).max())


def times_of(ours, others, state, rounds):
    """Return best and median CPU time of an evaluation, or a step of MuJoCo [s], all in turn."""
    tasks = {'ours': lambda count: ours(state, count)}
    for name, other in others.items():
        if hasattr(other, 'stepper'):
            tasks[name] = other.stepper(*state[:2])
        else:
            tasks[name] = lambda count, one=other: one.evaluate(*state, count)
    counts, measured = {}, {name: [] for name in tasks}
    for name, task in tasks.items():
        timed(task, 10)
        counts[name] = max(10, round(PORTION / (timed(task, 100) / 100)))
    for _ in range(rounds):
        for name, task in tasks.items():
            measured[name].append(timed(task, counts[name]) / counts[name])
    return {name: {'best': min(values), 'median': statistics.median(values)}
            for name, values in measured.items()}


def timed(task, count):
    """Return the CPU time of a task [s]."""
    begin = time.process_time()
    task(count)
    return time.process_time() - begin


def closing_table(result, make=markdown_table):
    """Return what the loops of each model are, and how they were closed."""
    rows = []
    for row in result['models']:
        if 'failed' in row:
            rows.append((row['name'], str(row['freedoms of joints']), str(row['loops']), '-', '-',
                         '-', 'not closed', f'{row["closed in"]:.1f} s'))
            continue
        rows.append((
            row['name'], str(row['freedoms of joints']), str(row['loops']),
            f'{row["rank"]} of {row["equations"]}', str(row['freedoms of joints'] - row['rank']),
            f'{row["moved"]:.2g}', f'{row["gap"]:.0e}', f'{row["closed in"]:.1f} s'))
    return make(('model', 'degrees of freedom of the joints', 'loops', 'independent equations',
                 'degrees of freedom', 'moved by up to [rad, m]', 'open by [m]', 'closed in'),
                rows)


def evaluation_table(result, make=markdown_table):
    """Return differences of accelerations, and times of an evaluation."""
    rows = []
    for row in result['models']:
        if 'times' not in row:
            continue
        errors = row['errors']
        first = next((f'{errors[name]:.0e} ({name})' for name in ('Pinocchio', 'MuJoCo')
                      if name in errors), '-')
        own = row['times']['ours']
        cells = [seconds(own['best'])]
        for name in ('Pinocchio', 'Pinocchio, balls', 'lcaba', 'MuJoCo'):
            one = row['times'].get(name)
            cells.append('-' if one is None else
                         f'{seconds(one["best"])} ({one["best"] / own["best"]:.1f})')
        rows.append((row['name'], first, *(
            f'{errors[name]:.0e}' if name in errors else '-'
            for name in ('constraintDynamics', 'lcaba')), *cells))
    return make(('model', 'ours differ from', 'constraintDynamics from ours', 'lcaba from ours',
                 'ours', 'constraintDynamics in C++ (times ours)',
                 'the same, three hinges as a ball', 'lcaba in C++', 'mj_step in C'), rows)


def write_csv_files(result, directory):
    """Write what was measured as a CSV file."""
    keys = ('name', 'freedoms of joints', 'loops', 'rank', 'equations', 'moved', 'gap',
            'closed in', 'built in')
    names = ('ours', 'Pinocchio', 'Pinocchio, balls', 'lcaba', 'MuJoCo')
    write_csv(directory / 'models.csv', (*keys, *(f'{name} [s]' for name in names)), [
        (*(row.get(key, '') for key in keys),
         *(row.get('times', {}).get(name, {}).get('best', '') for name in names))
        for row in result['models']])


def main(arguments=None):
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('directory', type=Path, metavar='DIR', help='with models, in any depth')
    parser.add_argument('--only', nargs='+', metavar='NAME', help='models by what they are called')
    parser.add_argument('--largest', type=int, default=LARGEST, metavar='N',
                        help='leave out models whose joints have more freedoms '
                        '(default: %(default)s)')
    parser.add_argument('--quick', action='store_true', help='see that it runs: rough numbers')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                        metavar='DIR', help='where results go (default: %(default)s)')
    options = parser.parse_args(arguments)
    result = {'machine': description(), 'quick': options.quick, 'models': []}
    warnings.simplefilter('ignore')
    taken = {}
    for path in files(options.directory):
        if options.only and name_of(path) not in options.only:
            continue
        try:
            row = measure_model(path, options.quick, options.largest)
        except (MechanismError, SimulationError) as error:
            print(f'{path}: {error}', file=sys.stderr)
            continue
        if row is None:
            continue
        row['name'] = _unique(row['name'], taken)
        print(f'{row["name"]}: ' + row.get('failed', '; '.join(row.get('why', [])) or 'measured'),
              file=sys.stderr, flush=True)
        result['models'].append(row)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / 'models.json').write_text(json.dumps(result, indent=1))
    write_csv_files(result, options.output)
    print(f'{result["machine"]}\n\n{closing_table(result, text_table)}\n\n'
          f'{evaluation_table(result, text_table)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
