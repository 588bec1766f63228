# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
This simulator beside its peers: Pinocchio, MuJoCo, Drake and Exudyn on the same mechanisms.

Builds mechanisms in each of them from the same description, shows that all compute the same
accelerations, then measures in one run, in turn, on one thread: the time of an evaluation or a
step, and error against CPU time of whole motions; in space also how many steps of many simulations
at once a second has. In the plane the 3-RRR and the carpet scraper, in space a Stewart platform, a
Delta robot and Bricard's linkage, which the others are given with a second tree, too. Evaluations
stand beside code that CasADi generates for the same mechanism, too; where a user has them, also
those of families of robots with loops. Needs the packages of the extra ``bench``; a simulator that
is not installed is left out.
"""

from dataclasses import dataclass
import datetime
import json
import os
from pathlib import Path
import sys
import time
import warnings

import peer_runner  # noqa: I100 (before anything loads a library that has threads of its own)
from machine import description, parser_of  # noqa: I100
from peer_cases import (
    Case, driven_away, files, load_scene, Machine, name_of, published, random_states, SHIPPED,
    trees)
import peer_report
import throughput
from tqdm import tqdm

from closedloop_dynamics.scene.model_scene import ModelWarning  # noqa: I100
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import text_table

ENGINES = (peer_runner.OURS, 'peer_pinocchio', 'peer_mujoco', 'peer_drake', 'peer_exudyn')
# Code that CasADi generates.
GENERATED = ('peer_clusters', 'peer_generated')
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

    """

    scenes: tuple
    engines: tuple
    cases: tuple = ()
    rollout: tuple = None


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
        (peer_runner.OURS, *GENERATED)),
    # Towers of four-bars on a free body: so many branches, so many in each.
    'families': Group(tuple(f'four_bar_branch_{size}' for size in (
        '1_1', '1_5', '1_10', '2_5', '6_5')), (peer_runner.OURS, *GENERATED)),
}
FAMILIES = 'families'
# Of the drives of families, which are drawn flat, at a singular position [rad].
AWAY = 0.8
# Of which derivatives are compared.
DIFFERENTIATED = ('three_rrr', 'carpet_scraper', 'delta_robot', 'stewart_platform')
QUICK_CASES = 1
STATES, QUICK_STATES = 20, 3
# Rollouts: samples, steps of 1 ms, repeats.
ROLLOUT, QUICK_ROLLOUT, SHORT_ROLLOUT = (256, 500, 3), (8, 20, 1), (8, 10, 30)
ROUNDS, QUICK_ROUNDS = 15, 3
PLAN = peer_runner.Plan(
    tolerances=(1.0, 0.3, *(10.0 ** -k for k in range(1, 14))),
    steps=(1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5), springs=(0.1, 0.3), rounds=6,
    longest=0.4, enough=0.1)
QUICK_PLAN = peer_runner.Plan(
    tolerances=tuple(10.0 ** -k for k in range(3, 13, 3)), steps=(1e-2, 1e-3), springs=(0.1,),
    rounds=2, longest=0.2, enough=0.3)


def machines_of(name):
    """Return {tree: machine} of a scene."""
    return {tree: Machine(name, load_scene(name, tree)) for tree in trees(name)}


def with_engines(machines, chosen):
    """
    Return {tree: (machine, simulators)}; ours take its own tree alone.

    Also {simulator: why it is left out} of those that are installed.
    """
    found, left_out = {}, {}
    for tree, machine in machines.items():
        built, why = peer_runner.engines(machine, [
            one for one in chosen if tree == SHIPPED or one != peer_runner.OURS])
        for engine, reason in why.items():
            print(f'{engine} is left out of {machine.name}: {reason}')
            if engine in sys.modules:
                left_out[sys.modules[engine].Engine.name] = reason
        found[tree] = machine, built
    return found, left_out


def measure(group, quick=False, chosen=(*ENGINES, *GENERATED), folder=None):
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
    folder : pathlib.Path, optional
        With the files of families; those that it has not are left out.

    Returns
    -------
    dict
        As written to the JSON file.

    """
    machines = {
        name: machines_of(name) for name in GROUPS[group].scenes} if group != FAMILIES else {
        name_of(path): {SHIPPED: driven_away(published(path), AWAY)} for path in sorted(
            (path for path in files(folder) if name_of(path) in GROUPS[group].scenes),
            key=lambda path: GROUPS[group].scenes.index(name_of(path)))}
    group = GROUPS[group]
    result = {'machine': description(), 'date': datetime.date.today().isoformat(),
              'load': [os.getloadavg()[0]], 'quick': quick, 'agreement': {}, 'evaluation': {},
              'cases': [], 'motions': [], 'rollouts': [], 'short_rollouts': [], 'left out': {}}
    states, rounds, plan = (QUICK_STATES, QUICK_ROUNDS, QUICK_PLAN) if quick else (
        STATES, ROUNDS, PLAN)
    for name, by_tree in machines.items():
        machines[name], result['left out'][name] = with_engines(
            by_tree, [one for one in group.engines if one in chosen])
    for name, by_tree in machines.items():
        result['agreement'][name] = [row for machine, built in by_tree.values()
                                     for row in peer_runner.agreement(
                                         machine, built, random_states(machine.scene, states))]
        result['evaluation'][name] = peer_runner.evaluation_times(
            [(tree, engine, random_states(machine.scene, 1)[0])
             for tree, (machine, built) in by_tree.items() for engine in built], rounds)
    cases = group.cases[:QUICK_CASES] if quick else group.cases
    with tqdm(total=len(cases) * plan.rounds, desc='motions', disable=None) as bar:
        for name, scene, torques, duration in cases:
            tasks = []
            for tree, (machine, built) in machines[scene].items():
                held = Simulation(machine.scene).joint_torques(torques)[None]
                case = Case(name, machine, held, duration)
                tasks += [(tree, case, engine) for engine in built]
            result['cases'].append({'name': name, 'duration': duration, 'uncertainty': max(
                case.uncertainty for _, case, _ in tasks)})
            result['motions'] += [{**row, 'case': name} for row in peer_runner.motions(
                tasks, plan, bar.update)]
    if group.rollout is not None:
        name, forces = group.rollout
        scene = load_scene(name)
        for key, (samples, steps, repeats) in (
                ('rollouts', QUICK_ROLLOUT if quick else ROLLOUT),
                ('short_rollouts', SHORT_ROLLOUT)):
            result[key] = throughput.compared(
                scene, throughput.torques_for(scene, samples, steps, forces), repeats,
                'peer_mujoco' in chosen, clock=time.process_time)
    result['load'].append(os.getloadavg()[0])
    return result


def derivatives(quick=False):
    """Return a table of what all derivatives of accelerations cost, beside ours."""
    rows = []
    for name in DIFFERENTIATED[:2 if quick else None]:
        machine, built = with_engines(machines_of(name), ENGINES[:3])[0][SHIPPED]
        state = random_states(machine.scene, 1)[0]
        found = peer_runner.evaluation_times(
            [(SHIPPED, engine, state) for engine in built],
            QUICK_ROUNDS if quick else ROUNDS, 'derivative_timings')
        rows += [[f'`{name}`', row['engine'], row['what'], f'{1e6 * row["best"]:.3g} us',
                  f'{row["best"] / found[0]["best"]:.1f}'] for row in found]
    return text_table(('scene', 'simulator', 'what', 'best', 'beside ours'), rows)


def main(arguments=None):
    """Run the comparison."""
    parser = parser_of(__doc__, 'see that it runs: rough numbers', output=True)
    parser.add_argument('--only', action='append',
                        choices=[group for group in GROUPS if group != FAMILIES],
                        help='these mechanisms alone; what the file has of others stays')
    parser.add_argument('--generated', dest='only', action='append_const', const='generated',
                        help='as --only generated: beside code that CasADi generates')
    parser.add_argument('--families', type=Path, metavar='DIR',
                        help='the same of towers of four-bars, too, in a folder of yours: a clone '
                        'of generalized_rbda')
    parser.add_argument('--derivatives', action='store_true',
                        help='only compare derivatives of accelerations by positions, rates and '
                             'torques')
    options = parser.parse_args(arguments)
    if options.derivatives:
        print(derivatives(options.quick))
        return 0
    warnings.simplefilter('ignore', ModelWarning)
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / 'peers.json'
    results = json.loads(path.read_text()) if options.only and path.exists() else {}
    chosen = options.only or [group for group in GROUPS if group != FAMILIES]
    for group in chosen + [FAMILIES] * (options.families is not None):
        results[group] = measure(group, options.quick, folder=options.families)
        path.write_text(json.dumps(results, indent=1))
        peer_report.write_files(results[group], options.output, group)
        print(*peer_report.passages({group: results[group]}).values(), sep='\n\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
