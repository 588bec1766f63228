# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
This simulator beside its peers: Pinocchio, MuJoCo, Drake and Exudyn on the same mechanisms.

Builds mechanisms in each of them from the same description, shows that all compute the same
accelerations, then measures in one run, in turn, on one thread: the time of an evaluation or a
step, and error against CPU time of whole motions; in space also how many steps of many simulations
at once a second has. In the plane the 3-RRR and the carpet scraper, in space a Stewart platform, a
Delta robot and Bricard's linkage, which the others are given with a second tree, too. Evaluations
stand beside code that CasADi generates for the same mechanism, too. Needs the packages of the
extra ``bench``; a simulator that is not installed is left out.
"""

import argparse
from dataclasses import dataclass
import datetime
import importlib
import json
import math
import os
from pathlib import Path
import statistics
import sys
import time

# Before anything loads a library that has threads of its own.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'

from machine import description, ROOT  # noqa: E402,I100
import numpy as np  # noqa: E402
import peer_cases  # noqa: E402
from peer_errors import Disagreement, NotAdapted  # noqa: E402
import peer_report  # noqa: E402
import throughput  # noqa: E402
from tqdm import tqdm  # noqa: E402

from closedloop_dynamics.visual.tables import text_table  # noqa: E402,I100

OURS = 'peer_ours'
ENGINES = (OURS, 'peer_pinocchio', 'peer_mujoco', 'peer_drake', 'peer_exudyn')
GENERATED = 'peer_generated'
BASE_TORQUES = {'theta_1': 5.0, 'theta_6': -3.0, 'theta_7': 2.0}
LEG_FORCES = {f'leg_{k}': 28.5 * share for k, share in enumerate(
    (1.0, 1.1, 0.95, 1.05, 0.9, 1.0), start=1)}
ARM_TORQUES = {'hip_1': 0.5, 'hip_3': -0.5}


@dataclass(frozen=True)
class Group:
    """
    Mechanisms of one kind.

    Attributes
    ----------
    scenes : tuple of str
    engines : tuple of str
        Modules of the simulators.
    cases : tuple of (str, str, dict, float)
        Name, scene, constant torques and forces [N m, N], duration [s].
    rollout : tuple of (str, dict) or None
        Scene of many simulations at once, and torques and forces around which theirs are.
    agreed : float
        What accelerations may differ by at most, relative; without that no time is taken.

    """

    scenes: tuple
    engines: tuple
    cases: tuple = ()
    rollout: tuple = None
    agreed: float = math.inf


GROUPS = {
    'plane': Group(('three_rrr', 'carpet_scraper'), ENGINES, (
        ('3-RRR, driven, 1 s', 'three_rrr', BASE_TORQUES, 1.0),
        ('3-RRR, released, 1 s', 'three_rrr', {}, 1.0),
        ('scraper, driven, 1 s', 'carpet_scraper', {'theta_1': 2.0}, 1.0),
        ('3-RRR, driven, 2 s', 'three_rrr', BASE_TORQUES, 2.0),
        ('3-RRR, released, 2 s', 'three_rrr', {}, 2.0),
        ('scraper, released, 1 s', 'carpet_scraper', {}, 1.0))),
    # Models of Exudyn and Drake here are planar.
    'space': Group(('stewart_platform', 'delta_robot', 'bricard'), ENGINES[:3], (
        ('Stewart platform, 0.6 s', 'stewart_platform', LEG_FORCES, 0.6),
        ('Delta robot, 0.5 s', 'delta_robot', ARM_TORQUES, 0.5),
        ("Bricard's linkage, 1 s", 'bricard', {}, 1.0)),
        ('stewart_platform', LEG_FORCES)),
    'generated': Group(
        ('three_rrr', 'carpet_scraper', 'stewart_platform', 'delta_robot', 'bricard'),
        (OURS, GENERATED), agreed=1e-9),
}
# Of which derivatives are compared.
DIFFERENTIATED = ('three_rrr', 'carpet_scraper', 'delta_robot', 'stewart_platform')
QUICK_CASES = 1
STATES, QUICK_STATES = 20, 3
# Rollouts: samples, steps of 1 ms, repeats.
ROLLOUT, QUICK_ROLLOUT, SHORT_ROLLOUT = (256, 500, 3), (8, 20, 1), (8, 10, 30)
ROUNDS, QUICK_ROUNDS = 15, 3
# Timing: calls at once take about this long [s].
PORTION = 4e-3
# Whole motions: rounds over all of them in turn, in each of which a motion is run again until so
# long has passed [s]; those that take longer than LONG [s] are run in the first ones alone.
MOTION_ROUNDS, QUICK_MOTION_ROUNDS = 6, 2
ROUND = 2e-3
LONG, LONG_ROUNDS = 0.08, 1
# The first run of a line that costs more ends it [s].
LONGEST, QUICK_LONGEST = 0.4, 0.2


def engines(scene, chosen):
    """Return the simulators that are installed, holding the mechanism of a scene."""
    result = []
    for name in chosen:
        try:
            result.append(importlib.import_module(name).Engine(scene))
        except ImportError as error:
            print(f'{name} is left out: {error}. pip install -e .[bench] installs all.')
        except NotAdapted as error:
            print(f'{name} is left out: {error}')
    return result


def _with_engines(name, chosen):
    """Return {tree: (scene, simulators)} of a scene; ours take its own tree alone."""
    found = {}
    for tree in peer_cases.trees(name):
        scene = peer_cases.load_scene(name, tree)
        built = engines(
            scene, [one for one in chosen if tree == peer_cases.SHIPPED or one != OURS])
        if built:
            found[tree] = scene, built
    return found


def agreement(scene, built, count):
    """
    Compare accelerations at random assembled states, under random torques.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone.
    built : list of engines
        Ours among them, compared with the referee as well.
    count : int
        States.

    Returns
    -------
    list of dict
        Largest relative error of each engine; for a soft one also what is left of it when
        extrapolated to hard loops.

    """
    referee, rows = peer_cases.Referee(scene), []
    states = peer_cases.random_states(scene, count)
    truth = [referee.acceleration(*state) for state in states]
    for engine in built:
        values = [engine.acceleration(*state) for state in states]
        row = {'engine': engine.name, 'version': engine.version, 'error': _relative(values, truth)}
        if engine.softness:
            softer = [engine.acceleration(*state, softness=2.0 * engine.softness)
                      for state in states]
            row['extrapolated'] = _relative(
                [2.0 * a - b for a, b in zip(values, softer)], truth)
        rows.append(row)
        rows += [{**row, 'engine': f'{engine.name}, {name},', 'error': _relative(
            [function(*state) for state in states], truth)}
            for name, function in engine.others.items()]
    return rows


def _relative(values, truth):
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(values, truth))


def evaluation_times(trees, rounds, timings='timings'):
    """
    Time evaluations and steps, or derivatives, all in turn.

    Parameters
    ----------
    trees : dict of str to (scene.Scene, list of engines)
        By tree: with gravity alone, and what is to be timed.
    rounds : int
        How often.
    timings : str
        Method of the engines, ``'timings'`` or ``'derivative_timings'``.

    Returns
    -------
    list of dict
        Best and median time of one evaluation or step [s].

    """
    tasks = []
    for tree, (scene, built) in trees.items():
        state = peer_cases.random_states(scene, 1)[0]
        tasks += [(tree, engine.name, what, function) for engine in built
                  for what, function in getattr(engine, timings)(*state).items()]
    counts = [_calibrated(function) for *_, function in tasks]
    times = [[] for _ in tasks]
    for _ in range(rounds):
        for (*_, function), count, measured in zip(tasks, counts, times):
            measured.append(_timed(function, count) / count)
    return [{'tree': tree, 'engine': engine, 'what': what, 'best': min(measured),
             'median': statistics.median(measured)}
            for (tree, engine, what, _), measured in zip(tasks, times)]


def _calibrated(function):
    """Return how many calls take about PORTION."""
    _timed(function, 10)
    return max(10, round(PORTION / (_timed(function, 100) / 100)))


def _timed(function, *arguments):
    """Return the CPU time of a call [s], all threads counted."""
    getattr(function, 'prepare', lambda: None)()
    begin = time.process_time()
    function(*arguments)
    return time.process_time() - begin


def motions(trees, quick, progress):
    """
    Compute a motion in every way, then time all of them in turn.

    Parameters
    ----------
    trees : dict of str to (peer_cases.Case, list of engines)
        By tree: the motion, and what is to compute it.
    quick : bool
        Fewer and coarser runs.
    progress : callable
        Called after each round.

    Returns
    -------
    list of dict
        One row a run: error at the end [rad, m], closure there, CPU time per simulated second
        (best and median).

    """
    rows, runs, ended = [], [], {}
    for tree, (case, built) in trees.items():
        referee = peer_cases.Referee(case.scene)
        for run in (run for engine in built for run in engine.runs(case, quick)):
            name = (tree, run.engine, run.line, run.setting.partition(',')[2])
            if ended.get(name):
                continue
            cost, end = _run(run)
            longest = QUICK_LONGEST if quick else LONGEST
            if name not in ended or cost > longest:
                # It may have compiled.
                cost, end = _run(run)
            # A setting so coarse that it is refused says nothing of finer ones.
            ended[name] = cost > longest and math.isfinite(case.error(end))
            row = {'case': case.name, 'tree': tree, 'engine': run.engine, 'line': run.line,
                   'setting': run.setting, 'error': case.error(end), 'closure': math.nan,
                   'cost': [cost]}
            if math.isfinite(row['error']):
                row['closure'] = referee.closure(end)
            rows.append(row)
            runs.append(run)
    for number in range(QUICK_MOTION_ROUNDS if quick else MOTION_ROUNDS):
        for run, row in zip(runs, rows):
            if number < LONG_ROUNDS or row['cost'][0] < LONG:
                row['cost'].append(_run(run, ROUND)[0])
        progress()
    for row in rows:
        # The first run warms up; all trees move as long.
        costs = [cost / case.duration for cost in row.pop('cost')[1:]]
        row.update(best=min(costs), median=statistics.median(costs))
    return rows


def _run(run, least=0.0):
    """Return CPU time, the least of as many runs as take so long together, and the end."""
    costs = []
    while not costs or sum(costs) < least:
        if run.prepare:
            run.prepare()
        begin = time.process_time()
        end = run.execute()
        costs.append(time.process_time() - begin)
    return min(costs), end


def measure(group, quick=False, chosen=(*ENGINES, GENERATED)):
    """
    Measure a group of mechanisms.

    Parameters
    ----------
    group : str
        Of ``GROUPS``.
    quick : bool
        To see that it runs: the numbers are rough.
    chosen : sequence of str
        Modules of the simulators, those of others are left out.

    Returns
    -------
    dict
        As written to the JSON file.

    """
    group = GROUPS[group]
    result = {'machine': description(), 'date': datetime.date.today().isoformat(),
              'load': [os.getloadavg()[0]], 'quick': quick, 'agreement': {}, 'evaluation': {},
              'cases': [], 'motions': [], 'rollouts': [], 'short_rollouts': []}
    built = {name: _with_engines(name, [engine for engine in group.engines if engine in chosen])
             for name in group.scenes}
    for name, trees in built.items():
        result['agreement'][name] = [
            row for pair in trees.values()
            for row in agreement(*pair, QUICK_STATES if quick else STATES)]
        wrong = [row for row in result['agreement'][name] if not row['error'] <= group.agreed]
        if wrong:
            raise Disagreement(f'{name}: accelerations differ from ours: {wrong}')
        result['evaluation'][name] = evaluation_times(
            trees, QUICK_ROUNDS if quick else ROUNDS)
    cases = group.cases[:QUICK_CASES] if quick else group.cases
    rounds = QUICK_MOTION_ROUNDS if quick else MOTION_ROUNDS
    with tqdm(total=len(cases) * rounds, desc='motions', disable=None) as bar:
        for name, scene_name, torques, duration in cases:
            trees = {
                tree: (peer_cases.build_case(name, scene, torques, duration), simulators)
                for tree, (scene, simulators) in built[scene_name].items()}
            result['cases'].append({
                'name': name, 'duration': duration,
                'uncertainty': max(case.uncertainty for case, _ in trees.values())})
            result['motions'] += motions(trees, quick, bar.update)
    if group.rollout is not None:
        name, forces = group.rollout
        scene = peer_cases.load_scene(name)
        for key, size in (('rollouts', QUICK_ROLLOUT if quick else ROLLOUT),
                          ('short_rollouts', SHORT_ROLLOUT)):
            samples, steps, repeats = size
            result[key] = throughput.compared(
                scene, throughput.torques_for(scene, samples, steps, forces), repeats,
                'peer_mujoco' in chosen, clock=time.process_time)
    result['load'].append(os.getloadavg()[0])
    return result


def derivatives(quick=False):
    """Return a table of what all derivatives of accelerations cost, beside ours."""
    rows = []
    for name in DIFFERENTIATED[:2 if quick else None]:
        scene = peer_cases.load_scene(name)
        found = evaluation_times(
            {peer_cases.SHIPPED: (scene, engines(scene, ENGINES[:3]))},
            QUICK_ROUNDS if quick else ROUNDS, 'derivative_timings')
        rows += [[f'`{name}`', row['engine'], row['what'], f'{1e6 * row["best"]:.3g} us',
                  f'{row["best"] / found[0]["best"]:.1f}'] for row in found]
    return text_table(('scene', 'simulator', 'what', 'best', 'beside ours'), rows)


def main(arguments=None):
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='see that it runs: rough numbers')
    parser.add_argument('--only', action='append', choices=GROUPS,
                        help='these mechanisms alone; what the file has of others stays')
    parser.add_argument('--generated', dest='only', action='append_const', const='generated',
                        help='as --only generated: beside code that CasADi generates')
    parser.add_argument('--derivatives', action='store_true',
                        help='only compare derivatives of accelerations by positions, rates and '
                             'torques')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                        metavar='DIR', help='where results go (default: %(default)s)')
    options = parser.parse_args(arguments)
    if options.derivatives:
        print(derivatives(options.quick))
        return 0
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / 'peers.json'
    results = json.loads(path.read_text()) if options.only and path.exists() else {}
    for group in options.only or GROUPS:
        results[group] = measure(group, options.quick)
        path.write_text(json.dumps(results, indent=1))
        for written in peer_report.write_files(results[group], options.output, group):
            print(f'written: {written}')
        print('\n' + peer_report.text(results[group]) + '\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
