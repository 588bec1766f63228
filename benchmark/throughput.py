# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How many steps per second many simulations make: rollouts here and in MuJoCo.

The same work for both: samples of one scene, each from the same start under torques of
its own that change at every step of 1 ms, all states returned. MuJoCo holds the loops by springs,
so its error is measured, too: positions after the last step against a run here with
steps ten times smaller.

    python benchmark/throughput.py                     three_rrr, 256 samples of 1000 steps
    python benchmark/throughput.py --fidelity          which error at how many samples a second:
                                                       torques held at 100 Hz, one second
"""

from dataclasses import replace
from functools import partial
import os
from pathlib import Path
import sys
import time
import warnings

from closedloop_dynamics.mechanism.errors import InaccuracyWarning
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import markdown_table, write_csv
from machine import description, least, parser_of
import numpy as np
from peer_cases import load_scene

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


def with_method(scene, **keys):
    """Return a simulation of a scene by its method with other values of keys."""
    return Simulation(replace(scene, method=replace(
        scene.method, **{'stabilisation': 'projection', **keys})))


def last(simulation, torques, threads=None, **keys):
    """Return the positions at the end of a rollout, shape (samples, nq)."""
    return simulation.rollout(torques, threads=threads, **keys).position[:, -1]


def error_of(scene, final, exact):
    """Return the median of the samples' errors in positions [rad, m]."""
    apart = scene.mechanism.coordinates.apart
    return float(np.median([np.abs(apart(*pair)).max() for pair in zip(final, exact)]))


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


def tasks_of(scene, torques, mujoco):
    """Return {what: function of a number of threads that returns the final positions}."""
    tasks = {f'closedloop_dynamics, {integrator}, {stabilisation}': partial(last, with_method(
        scene, integrator=integrator, stabilisation=stabilisation, step_size=STEP), torques)
        for integrator, stabilisation in METHODS}
    if mujoco:
        import mujoco
        for integrator, frequency in MUJOCO:
            tasks[f'MuJoCo {mujoco.__version__} rollout, {integrator}'] = mujoco_rollout(
                scene, torques, integrator, frequency, STEP, 1)
    return tasks


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
    exact = last(with_method(scene, integrator='rk4', step_size=STEP / 10), torques,
                 steps=10 * torques.shape[1], every=10 * torques.shape[1])
    tasks = tasks_of(scene, torques, mujoco)
    errors = {what: error_of(scene, run(1), exact) for what, run in tasks.items()}
    times = least({(what, count): partial(run, count) for what, run in tasks.items()
                   for count in threads}, repeats, clock)
    return [{'what': what, 'error': errors[what], 'speeds': {
        str(count): torques.shape[0] * torques.shape[1] / times[what, count]
        for count in threads}} for what in tasks]


def settings_of_ours(scene):
    """Yield (method, setting, simulation) of fidelity, from coarse to fine."""
    for integrator, steps in FIXED_STEPS.items():
        for step in steps:
            yield integrator, f'step {1e3 * step:g} ms', with_method(
                scene, integrator=integrator, step_size=step)
    for integrator, key, values in ADAPTIVE:
        for value in values:
            yield integrator, f'{key} {value:.0e}', with_method(
                scene, integrator=integrator, step_size=HELD, **{key: value})


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
    periods, tasks = round(1.0 / HELD), {}
    torques = torques_for(scene, samples, periods)
    for integrator, setting, simulation in settings_of_ours(scene):
        steps = round(1.0 / simulation.scene.method.step_size)
        tasks['closedloop_dynamics', integrator, setting] = partial(
            last, simulation, torques, threads, steps=steps, every=steps)
    for integrator, frequency, steps in MUJOCO_STEPS if mujoco else ():
        for step in steps:
            tasks['MuJoCo', integrator, f'step {1e3 * step:g} ms'] = partial(mujoco_rollout(
                scene, torques, integrator, frequency, step, round(HELD / step)), threads)
    exact = last(with_method(scene, integrator='dop853', step_size=HELD, tolerance=1e-12),
                 torques, every=periods)
    errors = {names: error_of(scene, run(), exact) for names, run in tasks.items()}
    times = least(tasks, repeats, clock)
    return [dict(zip(FIDELITY, (*names, errors[names], samples / times[names])))
            for names in tasks]


def fidelity_table(rows):
    """Return the rows in Markdown, the fastest first; also as a CSV file holds them."""
    rows = sorted(({**row, **{key: float(row[key]) for key in FIDELITY[3:]}} for row in rows),
                  key=lambda row: -row['samples_per_second'])
    return markdown_table(('samples a second', 'error, median [rad, m]', 'method', 'setting'), [
        (f'{row["samples_per_second"]:,.0f}', f'{row["error"]:.1e}',
         f'{row["method"]}' + (' (MuJoCo)' if row['engine'] == 'MuJoCo' else ''), row['setting'])
        for row in rows])


def main(argv=None):
    """Print a table; see the module."""
    parser = parser_of(__doc__)
    parser.add_argument('--scene', default='three_rrr')
    parser.add_argument('--samples', type=int, default=256)
    parser.add_argument('--steps', type=int, default=1000)
    parser.add_argument('--threads', type=int, nargs='+', default=sorted({1, os.cpu_count()}))
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('--without-mujoco', action='store_true')
    parser.add_argument('--csv', type=Path, metavar='FILE', help='of --fidelity, to write, too')
    parser.add_argument('--fidelity', action='store_true',
                        help='nothing but errors against samples a second, of all cores')
    arguments = parser.parse_args(argv)
    scene, threads = load_scene(arguments.scene), arguments.threads
    if arguments.fidelity:
        # How far off each method is stands in the table.
        warnings.simplefilter('ignore', InaccuracyWarning)
        rows = fidelity(scene, arguments.samples, arguments.repeats, max(threads),
                        not arguments.without_mujoco)
        print(f'{description()}\n{arguments.samples} samples of {arguments.scene}, '
              f'{max(threads)} threads\n\n{fidelity_table(rows)}')
        if arguments.csv:
            write_csv(arguments.csv, FIDELITY, [tuple(map(row.get, FIDELITY)) for row in rows])
        return 0
    torques = torques_for(scene, arguments.samples, arguments.steps)
    rows = compared(scene, torques, arguments.repeats, not arguments.without_mujoco, threads)
    print(f'{description()}\n{arguments.samples} samples of {arguments.scene}, '
          f'{arguments.steps} steps of {STEP:g} s\n')
    print(markdown_table(
        ('', *(f'{count} thread{"s" * (count > 1)} [steps/s]' for count in threads),
         'error of positions, median [rad, m]'),
        [(row['what'], *(f'{row["speeds"][str(count)]:,.0f}' for count in threads),
          f'{row["error"]:.1e}') for row in rows]))
    return 0


if __name__ == '__main__':
    sys.exit(main())
