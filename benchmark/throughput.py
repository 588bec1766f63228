# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How many steps per second many simulations make: rollouts here and in MuJoCo, and sweeps.

The same work for both: samples of one scene, each from the same start under torques of
its own that change at every step of 1 ms, all states returned. MuJoCo holds the loops by springs,
so its error is measured, too: positions after the last step against a run here with
steps ten times smaller.

    python benchmark/throughput.py                     three_rrr, 256 samples of 1000 steps
    python benchmark/throughput.py --sweep             and sweeps with a mass that varies
    python benchmark/throughput.py --fidelity          which error at how many samples a second:
                                                       torques held at 100 Hz, one second
"""

import argparse
from dataclasses import replace
import os
from pathlib import Path
import sys
import tempfile
import time
import warnings

from machine import description, ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from peer_cases import load_scene  # noqa: E402,I100
from closedloop_dynamics.simulation.errors import InaccuracyWarning  # noqa: E402,I100
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.sweep import sweep  # noqa: E402
from closedloop_dynamics.visual.tables import markdown_table, write_csv  # noqa: E402

STEP = 1e-3
# Of fidelity: the time in which torques are held [s]; steps [s] and tolerances, accuracies.
HELD = 1e-2
FIXED_STEPS = {'rk4': (1e-2, 5e-3, 2e-3, 1e-3), 'heun': (2e-3, 1e-3),
               'semi_implicit_euler': (1e-4,)}
ADAPTIVE = (('dopri5', 'tolerance', (1e-6, 1e-8)), ('dop853', 'tolerance', (1e-6, 1e-9)),
            ('auto', 'accuracy', (1e-3, 1e-6, 1e-9)))
FIDELITY = ('engine', 'method', 'setting', 'error', 'samples_per_second')
MUJOCO_STEPS = (('RK4', 0.3, (5e-3, 1e-3, 2e-4)), ('implicitfast', 0.3, (1e-3, 2e-4)))
# MuJoCo's integrator, natural frequency of its loops' springs times the step.
MUJOCO = (('RK4', 1.0), ('implicitfast', 0.3), ('Euler', 0.3))
METHODS = (('rk4', 'projection'), ('heun', 'projection'), ('semi_implicit_euler', 'projection'),
           ('semi_implicit_euler', 'velocity_projection'))


def torques_for(scene, samples, steps, around=None):
    """Return random torques and forces, shape (samples, steps, actuated joints)."""
    names = scene.mechanism.actuated_joints
    center = np.array([(around or {}).get(name, 0.0) for name in names])
    return center + np.random.default_rng(0).normal(0.0, 2.0, (samples, steps, len(names)))


def ours(scene, torques):
    """Yield (what, function of a number of threads, final positions) for each method."""
    for integrator, stabilisation in METHODS:
        simulation = Simulation(replace(scene, method=replace(
            scene.method, integrator=integrator, stabilisation=stabilisation, step_size=STEP)))
        final = simulation.rollout(torques).position[:, -1]
        yield (f'closedloop_dynamics, {integrator}, {stabilisation}',
               lambda count, one=simulation: one.rollout(torques, threads=count), final)


def mujoco_rollout(scene, torques, integrator, frequency, step, held):
    """
    Return a function of a number of threads that makes MuJoCo's rollout.

    Its integrator, the natural frequency of its loops' springs times the step, the step [s], and
    in how many of them each torque is held; the function returns the positions at the end.
    """
    import mujoco
    from mujoco import rollout
    from peer_mujoco import Engine
    engine, start = Engine(scene), Simulation(scene)
    model = engine.build(step, frequency / step, integrator)
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    initial = np.zeros(mujoco.mj_stateSize(model, spec))
    places = 1 + engine.order
    initial[places], initial[1 + model.nq:1 + model.nq + model.nv] = start.position, start.velocity
    initial = np.tile(initial, (len(torques), 1))
    applied = np.zeros((len(torques), held * torques.shape[1], model.nv))
    applied[:, :, list(scene.mechanism.coordinates.actuated)] = np.repeat(torques, held, axis=1)
    # The arrays for the results are made before: only computing is timed.
    state = np.zeros((*applied.shape[:2], initial.shape[1]))
    sensors = np.zeros((*applied.shape[:2], model.nsensordata))

    def run(count):
        rollout.rollout(
            model, [mujoco.MjData(model) for _ in range(count)], initial, applied,
            control_spec=int(mujoco.mjtState.mjSTATE_QFRC_APPLIED), state=state,
            sensordata=sensors, persistent_pool=True)
        return state[:, -1, places]

    return run


def mujocos(scene, torques):
    """Yield the same for MuJoCo."""
    import mujoco
    for integrator, frequency in MUJOCO:
        run = mujoco_rollout(scene, torques, integrator, frequency, STEP, 1)
        yield f'MuJoCo {mujoco.__version__} rollout, {integrator}', run, run(1).copy()


def reference(scene, torques):
    """Return the final positions of steps ten times smaller."""
    simulation = Simulation(replace(scene, method=replace(
        scene.method, integrator='rk4', stabilisation='projection', step_size=STEP / 10)))
    steps = 10 * torques.shape[1]
    return simulation.rollout(torques, steps=steps, every=steps).position[:, -1]


def compared(scene, torques, repeats, mujoco=True, threads=(1,), clock=time.perf_counter):
    """
    Count the steps per second of rollouts, all in turn.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone.
    torques : ndarray, shape (samples, steps, number of actuated joints)
        [N m, N].
    repeats : int
        How often; the shortest time counts.
    mujoco : bool
        Whether MuJoCo does the same.
    threads : sequence of int
        One or more numbers of threads.
    clock : callable
        Time [s].

    Returns
    -------
    list of dict
        What, its steps per second by number of threads, and the median of the samples' errors in
        the last positions [rad, m].

    """
    exact, names = reference(scene, torques), scene.mechanism.coordinates
    tasks = [task for source in (ours, mujocos)[:2 if mujoco else 1]
             for task in source(scene, torques)]
    shortest = {what: dict.fromkeys(threads, np.inf) for what, _, _ in tasks}
    for _ in range(repeats):
        for what, run, _ in tasks:
            for count in threads:
                begin = clock()
                run(count)
                shortest[what][count] = min(shortest[what][count], clock() - begin)
    return [{'what': what,
             'speeds': {str(count): torques.shape[0] * torques.shape[1] / seconds
                        for count, seconds in shortest[what].items()},
             'error': float(np.median([np.abs(names.apart(*pair)).max()
                                       for pair in zip(final, exact)]))}
            for what, _, final in tasks]


def settings_of_ours(scene):
    """Yield (method, setting, simulation) of fidelity, from coarse to fine."""
    for integrator, steps in FIXED_STEPS.items():
        for step in steps:
            yield integrator, f'step {1e3 * step:g} ms', replace(
                scene.method, integrator=integrator, stabilisation='projection', step_size=step)
    for integrator, key, values in ADAPTIVE:
        for value in values:
            yield integrator, f'{key} {value:.0e}', replace(
                scene.method, integrator=integrator, stabilisation='projection', step_size=HELD,
                **{key: value})


def fidelity(scene, samples, repeats, threads, mujoco=True, clock=time.perf_counter):
    """
    Return errors and samples a second: each a second long, torques of its own held at 100 Hz.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone.
    samples, repeats, threads : int
        How many, how often measured (the shortest time counts), on how many threads.
    mujoco : bool
        Whether MuJoCo does the same.
    clock : callable
        Time [s].

    Returns
    -------
    list of dict
        Engine, method, setting, median of the samples' errors in the last positions [rad, m] and
        samples a second.

    """
    periods, tasks = round(1.0 / HELD), []
    torques = torques_for(scene, samples, periods)
    for integrator, setting, method in settings_of_ours(scene):
        simulation = Simulation(replace(scene, method=method))
        steps = round(1.0 / method.step_size)

        def run(count, one=simulation, steps=steps):
            return one.rollout(torques, steps=steps, every=steps, threads=count).position[:, -1]

        tasks.append(('closedloop_dynamics', integrator, setting, run))
    for integrator, frequency, steps in MUJOCO_STEPS if mujoco else ():
        tasks += [('MuJoCo', integrator, f'step {1e3 * step:g} ms', mujoco_rollout(
            scene, torques, integrator, frequency, step, round(HELD / step)))
            for step in steps]
    exact = Simulation(replace(scene, method=replace(
        scene.method, integrator='dop853', stabilisation='projection', step_size=HELD,
        tolerance=1e-12))).rollout(torques, every=periods).position[:, -1]
    rows, names = [], scene.mechanism.coordinates
    for engine, method, setting, run in tasks:
        final = run(threads)
        apart = [np.abs(names.apart(*pair)).max() for pair in zip(final, exact)]
        times = []
        for _ in range(repeats):
            begin = clock()
            run(threads)
            times.append(clock() - begin)
        rows.append({'engine': engine, 'method': method, 'setting': setting,
                     'error': float(np.median(apart)), 'samples_per_second': samples / min(times)})
    return rows


def fidelity_table(rows):
    """Return the rows in Markdown, the fastest first; also as a CSV file holds them."""
    rows = sorted(({**row, **{key: float(row[key]) for key in FIDELITY[3:]}} for row in rows),
                  key=lambda row: -row['samples_per_second'])
    return markdown_table(('samples a second', 'error, median [rad, m]', 'method', 'setting'), [
        (f'{row["samples_per_second"]:,.0f}', f'{row["error"]:.1e}',
         f'{row["method"]}' + (' (MuJoCo)' if row['engine'] == 'MuJoCo' else ''), row['setting'])
        for row in rows])


def sweeps(scene, samples, threads, repeats):
    """Yield (what, {workers: samples per second}): a mass varies, so that models differ."""
    key = f'mechanism.bodies.{scene.mechanism.bodies[0].name}.mass'
    masses = np.linspace(1.0, 5.0, samples)
    simulation = Simulation.from_scene(scene.name)
    steps = round(1.0 / simulation.step_size)

    def best(function, times):
        shortest = np.inf
        for _ in range(times):
            begin = time.perf_counter()
            function()
            shortest = min(shortest, time.perf_counter() - begin)
        return shortest

    def threaded(count):
        simulation.rollout(steps=steps, every=steps, parameters={key: masses}, threads=count)

    def processes(count):
        with tempfile.TemporaryDirectory() as directory:
            sweep(scene, {key: masses}, Path(directory) / 'a.nc', duration=1.0, keep=(),
                  workers=count)

    yield 'rollout with parameters, threads', {
        count: samples / best(lambda: threaded(count), repeats) for count in threads}
    # The start of the workers, a few seconds, belongs to it; more samples hide it.
    yield 'sweep to NetCDF, processes', {
        count: samples / best(lambda: processes(count), 1) for count in threads}


def main(argv=None):
    """Print a table; see the module."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--scene', default='three_rrr')
    parser.add_argument('--samples', type=int, default=256)
    parser.add_argument('--steps', type=int, default=1000)
    parser.add_argument('--threads', type=int, nargs='+', default=sorted({1, os.cpu_count()}))
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('--without-mujoco', action='store_true')
    parser.add_argument('--sweep', action='store_true')
    parser.add_argument('--csv', type=Path, metavar='FILE', help='of --fidelity, to write, too')
    parser.add_argument('--fidelity', action='store_true',
                        help='nothing but errors against samples a second, of all cores')
    arguments = parser.parse_args(argv)
    scene = load_scene(arguments.scene)
    if arguments.fidelity:
        threads = max(arguments.threads)
        # How far off each method is stands in the table.
        warnings.simplefilter('ignore', InaccuracyWarning)
        rows = fidelity(scene, arguments.samples, arguments.repeats, threads,
                        not arguments.without_mujoco)
        print(f'{description()}\n{arguments.samples} samples of {arguments.scene}, {threads} '
              f'threads\n\n{fidelity_table(rows)}')
        if arguments.csv:
            write_csv(arguments.csv, FIDELITY, [tuple(map(row.get, FIDELITY)) for row in rows])
        return 0
    torques = torques_for(scene, arguments.samples, arguments.steps)
    print(f'{description()}\n{arguments.samples} samples of {arguments.scene}, '
          f'{arguments.steps} steps of {STEP:g} s\n')
    threads = arguments.threads
    print('| | ' + ' | '.join(f'{count} thread{"s" * (count > 1)} [steps/s]' for count in threads)
          + ' | error of positions, median [rad, m] |')
    print('|---|' + '---|' * (len(threads) + 1))
    for row in compared(scene, torques, arguments.repeats, not arguments.without_mujoco, threads):
        print(f'| {row["what"]} | ' + ' | '.join(
            f'{row["speeds"][str(count)]:,.0f}' for count in threads)
            + f' | {row["error"]:.1e} |', flush=True)
    if arguments.sweep:
        print('\n| | ' + ' | '.join(f'{count} [samples/s]' for count in threads) + ' |\n|---|'
              + '---|' * len(threads))
        for what, speeds in sweeps(scene, arguments.samples, threads, arguments.repeats):
            print(f'| {what} | ' + ' | '.join(f'{speeds[count]:,.1f}' for count in threads) + ' |',
                  flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
