# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What machine elements cost: operations of those that are rows, and measured times of all.

Counted are additions, subtractions, multiplications, divisions and negations of the unrolled
evaluation, before machine code is made of it. Times are those of a step of the Runge-Kutta
method of fourth order, of a scene that lists an element and of the same scene that does not, side
by side: blocks of steps of the one and of the other in turn, so that what else the machine does
meets both. Their ratio is the median of those of neighbouring blocks. The time of building is
printed apart: the first run generates code, which a second one reads. Beside them are steps of
rollouts, whose samples go side by side in the lanes of a vector.
"""

from dataclasses import replace
from pathlib import Path
import sys
from time import process_time

from closedloop_dynamics import Simulation
from closedloop_dynamics.codegen.function_table import AT_REST as ONE_AT_REST, MOTION
from closedloop_dynamics.codegen.live_scene import LiveTrace
from closedloop_dynamics.codegen.routines import count_operations as count, operations
from closedloop_dynamics.effects.registry import EFFECTS
from closedloop_dynamics.effects.scene_code import SceneLaws
from closedloop_dynamics.mechanism.mechanism import DISTANCE, POINT_ON_LINE
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.scene.tree_choice import count_operations
from closedloop_dynamics.visual.tables import markdown_table, text_table
from hard_machines import effect_of
from machine import description, in_turn, least, parser_of, write_result
import numpy as np
import yaml

SCENES = ('planetary_gear', 'rack_press', 'geared_five_bar', 'scissor_lift', 'differential')
MEASURED = yaml.safe_load(Path(__file__).with_suffix('.yaml').read_text(encoding='utf-8'))
# Of those with joints at rest the routine that evaluates them.
AT_REST = {'friction at rest': ONE_AT_REST, 'two joints at rest': ONE_AT_REST}
SAMPLES, TORQUE, EVERY = 64, 1.0, 200
STEP = 1e-4  # Of all that is measured [s]
QUICK = ('force table', 'a spring')


def bare(mechanism):
    """Return a mechanism without couplings, rods and pins in slots."""
    return replace(mechanism, couplings=(), cut_joints=tuple(
        cut for cut in mechanism.cut_joints if cut.type not in (DISTANCE, POINT_ON_LINE)))


def rows():
    """Return name, rows of elements, operations with and without them, and those of each row."""
    found = []
    for name in SCENES:
        mechanism = load_scene(name).mechanism
        without = bare(mechanism)
        elements = mechanism.number_of_equations - without.number_of_equations
        counts = [count_operations(one) for one in (mechanism, without)]
        found.append((name, str(elements), *map(str, counts),
                      f'{(counts[0] - counts[1]) / elements:.0f}'))
    return found


def both(name, element=None):
    """
    Return a scene with an element, and without it.

    ``name`` is that of the scene, ``element`` as elements.yaml has it.
    """
    scene = load_scene(name)
    if element is None:
        mechanism = replace(scene.mechanism, couplings=())
        return scene, replace(scene, mechanism=mechanism, initial=replace(
            scene.initial, hold=()))
    if isinstance(element, str):
        return scene, replace(scene, effects={
            key: one for key, one in scene.effects.items()
            if not isinstance(one, EFFECTS[element])})
    return replace(scene, effects={**scene.effects, 'element': record(scene, element)}), scene


def record(scene, element):
    """Return the effect that keys describe."""
    return effect_of({key: scene.mechanism.cut_joints[0].name if value == 'CUT' else value
                      for key, value in element.items()})


def operations_of(simulation, which=MOTION):
    """Return how many operations the one routine of a scene takes, or one of joints at rest."""
    model, table = simulation.data.system.model, simulation.data.system.effects
    return operations(model) if table is None else count(
        LiveTrace(model, SceneLaws(table, which)).routine(MOTION))


def timed(pair, quick):
    """
    Measure steps of scenes with an element and without it, ``pair``, in turn.

    Returns times of a step [s], the ratio of neighbouring blocks, times of building [s] and
    operations, all but the ratio of both.
    """
    sims, building = [], []
    for scene in pair:
        begin = process_time()
        sims.append(Simulation.from_scene(scene, integrator='rk4', step_size=STEP))
        building.append(process_time() - begin)

    def block(simulation):
        simulation.reset()
        simulation.step(duration=steps * STEP)

    tasks = {number: lambda one=one: block(one) for number, one in enumerate(sims)}
    # Of both the same time is simulated, in blocks of 50 ms and more.
    steps = 1
    while min(in_turn(tasks, 1).values())[0] < (0.001 if quick else 0.05):
        steps *= 2
    found = np.array(list(in_turn(tasks, 3 if quick else 31).values())) / steps
    return (np.median(found, axis=1).tolist(), float(np.median(found[0] / found[1])), building,
            [operations_of(simulation) for simulation in sims])


def rolled_out(elements, quick, which=MOTION):
    """
    Return times of a step of one sample [s] and operations, with effects and without.

    ``elements`` are the keys of the effects, ``which`` is the routine that evaluates a sample,
    ``MOTION`` unless joints are at rest.
    """
    scene, steps = load_scene('four_bar'), 200 if quick else 2000
    scene = replace(scene, method=replace(scene.method, integrator='rk4', step_size=STEP))
    sims = [Simulation(replace(scene, effects={
        f'element_{number}': record(scene, one) for number, one in enumerate(listed)}))
        for listed in (elements, ())]
    torques = np.random.default_rng(0).normal(TORQUE, 0.05, (SAMPLES, 10, 1))
    times = least({number: lambda one=one: one.rollout(
        torques, steps=steps, every=EVERY, threads=1) for number, one in enumerate(sims)},
        3 if quick else 31)
    return ([each / (SAMPLES * steps) for each in times.values()],
            [operations_of(one, which) for one in sims])


def measure(quick=False):
    """Count operations, and measure times; ``quick``: to see that it runs, roughly."""
    found, rollouts = [], []
    for name, (scene, *element) in MEASURED['elements'].items():
        if not quick or name in QUICK:
            times, ratio, building, counts = timed(both(scene, *element), quick)
            found.append({'element': name, 'scene': scene, 'times': times, 'ratio': ratio,
                          'building': building, 'operations': counts})
    for name, effects in MEASURED['rollouts'].items():
        if not quick or name in QUICK:
            times, counts = rolled_out(effects, quick, AT_REST.get(name, MOTION))
            rollouts.append({'effects': name, 'times': times, 'operations': counts})
    return {'machine': description(), 'quick': quick, 'rows': rows(), 'elements': found,
            'rollouts': rollouts}


def row_table(result, make=markdown_table):
    """Return the operations of rows as a table."""
    return make(('mechanism', 'rows', 'operations', 'without', 'for each row'), result['rows'])


def time_table(result, make=markdown_table):
    """Return the times of elements as a table."""
    return make(
        ('element', 'scene', 'operations', 'without', 'listed', 'not listed', 'ratio'),
        [(one['element'], one['scene'], *map(str, one['operations']),
          *(f'{1e6 * value:.2f} us' for value in one['times']),
          f'{one["ratio"]:.2f}') for one in result['elements']])


def rollout_table(result, make=markdown_table):
    """Return times of steps in lanes as a table."""
    rows = []
    for one in result['rollouts']:
        (listed, without), (many, few) = one['times'], one['operations']
        rows.append((one['effects'], str(many), str(few), f'{1e9 * listed:.0f} ns',
                     f'{1e9 * without:.0f} ns', f'{listed / without:.2f}',
                     f'{listed / without * few / many:.2f}'))
    return make(('rollouts with', 'operations', 'without', 'listed', 'not listed', 'ratio',
                 'for each operation'), rows)


def main(arguments=None):
    """Run the benchmark."""
    options = parser_of(
        __doc__, 'one element alone, rough numbers', output=True).parse_args(arguments)
    result = measure(options.quick)
    write_result(
        options, 'elements', result, row_table(result, text_table), time_table(result, text_table),
        rollout_table(result, text_table), 'building, with and without [s]: ' + ', '.join(
            f'{one["element"]} {one["building"][0]:.1f} and {one["building"][1]:.1f}'
            for one in result['elements']))
    return 0


if __name__ == '__main__':
    sys.exit(main())
