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

from argparse import ArgumentParser
from dataclasses import replace
import json
from pathlib import Path
import sys
from time import process_time

from machine import description, ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics import Simulation  # noqa: E402,I100
from closedloop_dynamics.core.codegen.function_table import (  # noqa: E402
    AT_REST as ONE_AT_REST, EVALUATION, RESPONSES)
from closedloop_dynamics.core.codegen.live_scene import LiveTrace  # noqa: E402
from closedloop_dynamics.core.codegen.routines import (  # noqa: E402
    count_operations as count, operations)
from closedloop_dynamics.effects.registry import EFFECTS  # noqa: E402
from closedloop_dynamics.effects.scene_code import SceneLaws  # noqa: E402
from closedloop_dynamics.mechanism.mechanism import (  # noqa: E402,I100
    DISTANCE, POINT_ON_LINE)
from closedloop_dynamics.simulation.scene import load_scene  # noqa: E402
from closedloop_dynamics.simulation.tree_choice import count_operations  # noqa: E402
from closedloop_dynamics.visual.tables import (  # noqa: E402
    markdown_table, text_table)
import numpy as np  # noqa: E402

SCENES = ('planetary_gear', 'rack_press', 'geared_five_bar', 'scissor_lift', 'differential')
# What is listed in a scene, or not, by what it is called: the scene, and the effects of it; those
# with a type are added.
TABLE = {'type': 'force_table', 'strokes': (-10.0, 0.0, 10.0), 'forces': (1.0, 0.0, -1.0)}
ELEMENTS = {
    'gears (4 rows)': ('planetary_gear', None),
    'belt (1 row)': ('geared_five_bar', None),
    'prescribed motion': ('four_bar', {
        'type': 'prescribed_motion', 'joint': 'crank_joint', 'shape': 'constant_speed',
        'speed': 4.0}),
    'commanded motion': ('four_bar', {
        'type': 'prescribed_motion', 'joint': 'crank_joint', 'shape': 'commanded'}),
    'motion of a cut joint': ('four_bar', {
        'type': 'prescribed_motion', 'joint': 'CUT', 'shape': 'constant'}),
    'prescribed force': ('four_bar', {
        'type': 'prescribed_force', 'joint': 'crank_joint', 'shape': 'sine', 'amplitude': 0.1,
        'frequency': 2.0}),
    'force table': ('four_bar', {**TABLE, 'joint': 'crank_joint'}),
    'force table, cut joint': ('four_bar', {**TABLE, 'joint': 'CUT'}),
    'spring': ('four_bar', {'type': 'joint_spring', 'joint': 'crank_joint', 'stiffness': 1.0}),
    'law of a user': ('four_bar', {
        'type': 'law', 'joints': {'x': 'crank_joint'}, 'rates': {'v': 'x'},
        'forces': {'x': '-x - 0.1*v*abs(v)'}}),
    'spring, cut joint': ('four_bar', {'type': 'joint_spring', 'joint': 'CUT', 'stiffness': 1.0}),
    'cam with roller': ('cam_follower', 'body_contact'),
    'Geneva drive': ('geneva_drive', 'body_contact'),
    'cable, two pulleys': ('rope_hoist', 'cable'),
    'motion in space': ('rssr_four_bar', {
        'type': 'prescribed_motion', 'joint': 'crank', 'shape': 'constant_speed', 'speed': 2.0})}
# Effects of a rollout of the four-bar; the coupler's point passes the floor in each turn.
SPRING, FRICTION, FLOOR = (
    {'type': 'joint_spring', 'joint': 'crank_joint', 'stiffness': 0.1},
    {'type': 'joint_friction', 'joint': 'crank_joint', 'coulomb': 0.05},
    {'type': 'contact', 'point': 'coupler_point', 'origin': (0.0, 0.05), 'stiffness': 300.0,
     'exponent': 1.5, 'damping': 0.1, 'friction': 0.2})
# Of those with joints at rest the routine that evaluates them.
AT_REST = {'friction at rest': ONE_AT_REST, 'two joints at rest': RESPONSES}
ROLLOUTS = {'a spring': (SPRING,), 'friction': (FRICTION,), 'contact': (FLOOR,),
            'all three': (SPRING, FRICTION, FLOOR),
            'friction at rest': ({**FRICTION, 'coulomb': 5.0},),
            'two joints at rest': ({**FRICTION, 'coulomb': 5.0}, {
                **FRICTION, 'joint': 'rocker_joint', 'coulomb': 5.0})}
SAMPLES, TORQUE, STEPS, EVERY = 64, 1.0, 2000, 200
# Of a step that is measured [s]; blocks of steps, and seconds that each takes at least.
STEP, BLOCKS, SECONDS = 1e-4, 31, 0.05
QUICK, QUICK_BLOCKS, QUICK_SECONDS = ('force table',), 3, 0.001
QUICK_ROLLOUTS, QUICK_STEPS = ('a spring',), 200


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


def both(name, element):
    """
    Return a scene with an element, and without it.

    Parameters
    ----------
    name : str
        Of the scene.
    element : dict, str or None
        Keys of an effect that is added, the type of those that are left out, or None for
        couplings.

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
    return EFFECTS[element['type']](**{
        key: scene.mechanism.cut_joints[0].name if value == 'CUT' else value
        for key, value in element.items() if key != 'type'})


def operations_of(simulation, which=EVALUATION):
    """Return how many operations the one routine of a scene takes, or one of joints at rest."""
    model, table = simulation.data.system.model, simulation.data.system.effects
    return operations(model) if table is None else count(
        LiveTrace(model, SceneLaws(table, which)).routine(EVALUATION))


def timed(pair, blocks, seconds):
    """
    Return times of a step [s], the ratio of neighbouring blocks, times of building, operations.

    Parameters
    ----------
    pair : sequence of 2 Scene
        With the element, and without it.
    blocks : int
        Of steps of each.
    seconds : float
        Of a block, at least.

    Returns
    -------
    times : list of 2 floats
    ratio : float
    building : list of 2 floats
        [s]
    operations : list of 2 ints

    """
    sims, building = [], []
    for scene in pair:
        begin = process_time()
        simulation = Simulation.from_scene(scene, integrator='rk4', step_size=STEP)
        building.append(process_time() - begin)
        sims.append(simulation)
    # Of both the same time is simulated.
    count = max(_steps_within(simulation, seconds) for simulation in sims)
    found = np.array([[_time(simulation, count) for simulation in sims] for _ in range(blocks)])
    return np.median(found, axis=0).tolist(), float(np.median(found[:, 0] / found[:, 1])), (
        building), [operations_of(simulation) for simulation in sims]


def _steps_within(simulation, seconds):
    """Return how many steps take so long."""
    count = 1
    while _time(simulation, count) * count < seconds:
        count *= 2
    return count


def _time(simulation, count):
    """Return the time of one of some steps from the start [s]."""
    simulation.reset()
    begin = process_time()
    simulation.step(duration=count * STEP)
    return (process_time() - begin) / count


def rolled_out(elements, blocks, steps, which=EVALUATION):
    """
    Return times of a step of one sample [s] and operations, with effects and without.

    Parameters
    ----------
    elements : sequence of dict
        Keys of the effects.
    blocks : int
        How often each is made.
    steps : int
        Of each.
    which : int
        The routine that evaluates a sample, ``EVALUATION`` unless joints are at rest.

    Returns
    -------
    times : list of 2 floats
    operations : list of 2 ints

    """
    scene = load_scene('four_bar')
    scene = replace(scene, method=replace(scene.method, integrator='rk4', step_size=STEP))
    sims = [Simulation(replace(scene, effects={
        f'element_{number}': record(scene, one) for number, one in enumerate(listed)}))
        for listed in (elements, ())]
    torques = np.random.default_rng(0).normal(TORQUE, 0.05, (SAMPLES, 10, 1))
    found = []
    for _ in range(blocks):
        for simulation in sims:
            begin = process_time()
            simulation.rollout(torques, steps=steps, every=EVERY, threads=1)
            found.append((process_time() - begin) / (SAMPLES * steps))
    times = np.array(found).reshape(-1, 2).min(axis=0)
    return times.tolist(), [operations_of(one, which) for one in sims]


def measure(quick=False):
    """
    Count operations, and measure times.

    Parameters
    ----------
    quick : bool
        To see that it runs: the numbers are rough.

    Returns
    -------
    dict
        As written to the JSON file.

    """
    found = []
    for name in QUICK if quick else ELEMENTS:
        scene, element = ELEMENTS[name]
        times, ratio, building, counts = timed(both(scene, element), *(
            (QUICK_BLOCKS, QUICK_SECONDS) if quick else (BLOCKS, SECONDS)))
        found.append({'element': name, 'scene': scene, 'times': times, 'ratio': ratio,
                      'building': building, 'operations': counts})
    rollouts = []
    for name in QUICK_ROLLOUTS if quick else ROLLOUTS:
        times, counts = rolled_out(
            ROLLOUTS[name], QUICK_BLOCKS, QUICK_STEPS if quick else STEPS,
            AT_REST.get(name, EVALUATION))
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
    parser = ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='one element alone, rough numbers')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                        metavar='DIR', help='where results go (default: %(default)s)')
    options = parser.parse_args(arguments)
    result = measure(options.quick)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / 'elements.json').write_text(json.dumps(result, indent=1))
    print(result['machine'], row_table(result, text_table), time_table(result, text_table),
          rollout_table(result, text_table),
          'building, with and without [s]: ' + ', '.join(
              f'{one["element"]} {one["building"][0]:.1f} and {one["building"][1]:.1f}'
              for one in result['elements']), sep='\n\n')
    print(f'\nwritten: {options.output}/elements.json')
    return 0


if __name__ == '__main__':
    sys.exit(main())
