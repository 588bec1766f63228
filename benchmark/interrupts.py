# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How long Ctrl-C takes to end what takes long: delays of signals at random instants.

Each task runs in a process of its own, again and again; SIGINT arrives at instants drawn at
random. Printed are the median and the largest CPU time of that process, and the largest wall
clock time, between the signal and the KeyboardInterrupt that leaves the task. A task that runs
in several threads or processes adds up the CPU time of its threads. ``compile`` begins each time
with an empty cache: LLVM cannot be interrupted within a function that it compiles.
"""

import argparse
from contextlib import redirect_stderr, redirect_stdout
import json
import os
from pathlib import Path
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import warnings

from machine import description, ROOT

sys.path.insert(0, str(ROOT))

# What is asked for, on a machine that does nothing else [s].
SOON = 0.2
# A task that has not ended by then does not hear signals [s].
UNHEARD = 30.0


def simulation_of(family, size, **method):
    """Return a simulation of a member of a family."""
    from closedloop_dynamics.simulation.scene_records import Initial, Method, Scene
    from closedloop_dynamics.simulation.simulation import Simulation
    import families
    mechanism, position = getattr(families, family)(size)
    return Simulation(Scene(
        family, None, '', mechanism, Initial(tuple(position), (0.0,) * len(position)), {},
        Method(**method)))


def step(scene, **method):
    """Make a step that never ends."""
    def prepare(_):
        from closedloop_dynamics.simulation.simulation import Simulation
        simulation = Simulation.from_scene(scene, **method) if isinstance(
            scene, str) else simulation_of(*scene, **method)
        return lambda: simulation.step(duration=1e6)
    return prepare


def rollout(threads, **method):
    """Make long rollouts."""
    def prepare(_):
        from closedloop_dynamics.simulation.simulation import Simulation
        import numpy as np
        simulation = Simulation.from_scene('three_rrr', **method)
        return lambda: simulation.rollout(
            np.zeros((24, 1, 3)), steps=1_000_000, every=1_000_000, threads=threads)
    return prepare


def command(*arguments):
    """Run a command of ``closedloop``."""
    def prepare(folder):
        from closedloop_dynamics.cli.commands import run
        given = [each.format(folder=folder) for each in arguments]
        return lambda: run(given)
    return prepare


def with_model(scene, use):
    """Use a model of a scene."""
    def prepare(_):
        from closedloop_dynamics.simulation.model import Model
        model = Model.from_scene(scene)
        return lambda: use(model)
    return prepare


def far_poses(model):
    """Assemble poses far from the given ones."""
    rng = random.Random(2)
    while True:
        try:
            model.assemble([3.0 * (rng.random() - 0.5) for _ in range(model.coordinates.nq)])
        except ValueError:
            # AssemblyError: this one is too far.
            pass


def linearise(size):
    """Linearise a large mechanism."""
    def prepare(_):
        from closedloop_dynamics.simulation.linearisation import Linearisation
        simulation = simulation_of('ladder', size)
        return Linearisation(simulation).linear_model
    return prepare


def large_model(folder):
    """Read a large model."""
    from closedloop_dynamics.formats.registry import read_model
    path = Path(folder, 'chain.urdf')
    links = ''.join(
        f'<link name="l{n}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0"'
        ' ixz="0" iyz="0"/></inertial></link>' for n in range(3000))
    joints = ''.join(
        f'<joint name="j{n}" type="continuous"><parent link="l{n}"/><child link="l{n + 1}"/>'
        '<origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint>' for n in range(2999))
    path.write_text(f'<robot name="chain">{links}{joints}</robot>')
    return lambda: read_model(path)


def compile_code(scene):
    """Generate and compile the code of a mechanism."""
    def prepare(folder):
        os.environ['CLOSEDLOOP_CACHE_DIR'] = str(folder)
        import llvmlite.binding  # noqa: F401
        from closedloop_dynamics.simulation.simulation import Simulation
        return lambda: Simulation.from_scene(scene)
    return prepare


# Name: what prepares the task, and whether it can be done once in a process.
TASKS = {
    'step three_rrr rk4': (step('three_rrr', integrator='rk4', step_size=1e-4), False),
    'step three_rrr dop853': (step('three_rrr', integrator='dop853'), False),
    'step carpet_scraper_on_carpet auto': (
        step('carpet_scraper_on_carpet', integrator='auto'), False),
    'step stewart_platform rodas4': (step('stewart_platform', integrator='rodas4'), False),
    'step three_rrr rodas4_fixed': (step('three_rrr', integrator='rodas4_fixed'), False),
    'step scissor_lift auto': (step('scissor_lift', integrator='auto'), False),
    'step ladder of 1000 joints rk4': (step(('ladder', 500), integrator='rk4'), False),
    'step ladder of 200 joints auto': (step(('ladder', 100), integrator='auto'), False),
    'step ladder of 200 joints rodas4_fixed': (
        step(('ladder', 100), integrator='rodas4_fixed'), False),
    'step chain of 400 joints rk4': (step(('chain', 400), integrator='rk4'), False),
    'rollout rk4': (rollout(1, integrator='rk4'), False),
    'rollout rk4, 2 threads': (rollout(2, integrator='rk4'), False),
    'rollout auto, 2 threads': (rollout(2, integrator='auto'), False),
    'sweep, 2 workers': (command(
        'sweep', 'three_rrr', '--output', '{folder}/found.nc', '--overwrite', '--vary',
        'effects.gravity.acceleration.1=-9.81..-1:100000', '--workers', '2'), False),
    'accuracy': (command('accuracy', 'three_rrr'), False),
    'effects': (command('effects', 'carpet_scraper_on_carpet'), False),
    'stability': (command('stability', '--quick'), False),
    'far poses in the plane': (with_model('three_rrr', far_poses), False),
    'far poses in space': (with_model('stewart_platform', far_poses), False),
    'kinematics': (with_model('four_bar', lambda model: model.solve(
        {'crank_joint': [0.01 * n for n in range(300_000)]})), False),
    'assemblies in the plane': (with_model('three_rrr', lambda model: model.assemblies(
        dict.fromkeys(model.mechanism.actuated_joints, 0.0))), False),
    'assemblies in space': (with_model('stewart_platform', lambda model: model.assemblies(
        dict.fromkeys(model.mechanism.actuated_joints, 0.0))), False),
    'linear model of 100 joints': (linearise(50), False),
    'reading 3000 bodies': (large_model, False),
    'compile three_rrr': (compile_code('three_rrr'), True),
    'compile stewart_platform': (compile_code('stewart_platform'), True),
}


def work(name, folder):
    """Do a task until it is interrupted, again and again; say when that was."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    warnings.simplefilter('ignore')
    prepare, once = TASKS[name]
    shown = sys.stdout
    with open(os.devnull, 'w') as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        begin = time.process_time()
        task = prepare(folder)
        while True:
            try:
                print(json.dumps({'ready': time.process_time() - begin}), file=shown, flush=True)
                while True:
                    task()
                    if once:
                        print(json.dumps({'over': True}), file=shown, flush=True)
                        return
            except KeyboardInterrupt:
                heard = {'cpu': time.process_time(), 'time': time.monotonic()}
            except Exception as error:  # noqa: B902
                heard = {'error': f'{type(error).__name__}: {error}'}
            print(json.dumps(heard), file=shown, flush=True)
            if once or 'error' in heard:
                return


def cpu_time(process):
    """Return the CPU time of another process [s]: its clock on Linux has this number."""
    return time.clock_gettime(~process.pid << 3 | 2)


def interrupted(process, longest, rng):
    """Interrupt a process at a random instant; return its delays [s], or why there are none."""
    said = json.loads(process.stdout.readline() or '{}')
    if 'ready' not in said:
        return said.get('error', 'ended')
    time.sleep(rng.uniform(0.02, longest))
    if process.poll() is not None:
        return 'over before the signal'
    before = cpu_time(process), time.monotonic()
    process.send_signal(signal.SIGINT)
    alarm = subprocess.Popen(
        [sys.executable, '-c', f'import os, time; time.sleep({UNHEARD}); '
         f'os.kill({process.pid}, 9)'])
    try:
        said = json.loads(process.stdout.readline() or '{}')
    finally:
        alarm.kill()
        alarm.wait()
    if 'cpu' not in said:
        return said.get('error', 'over' if 'over' in said else 'unheard')
    return said['cpu'] - before[0], said['time'] - before[1]


def measure(name, count, longest, rng):
    """Return the delays of a task, and what else it says."""
    delays, words, process = [], [], None
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            if process is None:
                place = Path(folder, str(number))
                place.mkdir()
                process = subprocess.Popen(
                    [sys.executable, __file__, '--work', name, '--folder', str(place)],
                    stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
            found = interrupted(process, longest, rng)
            if isinstance(found, str):
                words.append(found)
            else:
                delays.append(found)
            if TASKS[name][1] or isinstance(found, str):
                process.kill()
                process.wait()
                process = None
        if process is not None:
            process.kill()
            process.wait()
    return delays, words


def main():
    """Measure as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--task', action='append', metavar='NAME', default=[],
                        help='parts of names of tasks (default: all)')
    parser.add_argument('--count', type=int, default=10, help='signals each (default: 10)')
    parser.add_argument('--longest', type=float, default=2.0, metavar='SECONDS',
                        help='before a signal (default: 2)')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--work', help=argparse.SUPPRESS)
    parser.add_argument('--folder', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work(options.work, options.folder)
        return
    print(description())
    rng, late = random.Random(options.seed), []
    for name in TASKS:
        if options.task and not any(part in name for part in options.task):
            continue
        delays, words = measure(name, options.count, options.longest, rng)
        told = f'; {", ".join(sorted(set(words)))} ({len(words)})' if words else ''
        if delays:
            cpu, wall = zip(*delays)
            late += [name] * (max(cpu) > SOON)
            print(f'{name:40s} CPU {1e3 * statistics.median(cpu):7.1f} ms, at most '
                  f'{1e3 * max(cpu):7.1f} ms; wall clock at most {1e3 * max(wall):7.1f} ms{told}',
                  flush=True)
        else:
            print(f'{name:40s} none{told}', flush=True)
    print(f'Later than {1e3 * SOON:.0f} ms of CPU time: {", ".join(late) or "none"}')


if __name__ == '__main__':
    main()
