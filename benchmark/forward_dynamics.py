# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What one evaluation, one step and one start cost.

Prints, for each scene: the time of one evaluation of the forward dynamics inside
compiled code, of one called from Python, of one RK4 step in a long run; memory allocated per
step; and, once, the time of the first start (with an empty cache of generated code) and of a
warm one, from the start of Python to the end of the first step.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import tracemalloc

from evaluations import evaluate_again
from machine import description, ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.simulation.scene import scene_names  # noqa: E402,I100
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402

START = """
import json, time
begin = time.perf_counter()
from closedloop_dynamics import Simulation
imported = time.perf_counter()
simulation = Simulation.from_scene({scene!r})
built = time.perf_counter()
simulation.step()
print(json.dumps({{'import': imported - begin, 'build': built - imported,
                   'first step': time.perf_counter() - built}}))
"""


def timed(function, count, repeats):
    """Return best and median time of one of ``count`` calls made at once [s]."""
    times = []
    for _ in range(repeats):
        begin = time.thread_time()
        function(count)
        times.append((time.thread_time() - begin) / count)
    return min(times), statistics.median(times)


def evaluation(simulation, count, repeats):
    """Time one evaluation inside compiled code."""
    q, qd = simulation.position, simulation.velocity
    evaluate_again(simulation.data.system, q, qd, 1)
    return timed(lambda n: evaluate_again(simulation.data.system, q, qd, n), count, repeats)


def python_call(simulation, count, repeats):
    """Time one evaluation called from Python, its arguments checked."""
    q, qd = simulation.position, simulation.velocity

    def call(number):
        for _ in range(number):
            simulation.forward_dynamics(q, qd)

    call(1)
    return timed(call, count, repeats)


def step(simulation, count, repeats):
    """Time one step of a run of ``count`` steps."""
    tau = simulation.joint_torques(None)
    simulation.stepping.monitor.sampling = False

    def run(number):
        simulation.reset()
        simulation.advance(tau, number)

    run(1)
    return timed(run, count, repeats)


def allocation(simulation, count):
    """
    Return the bytes that Python still holds after ``count`` steps, beyond those after one.

    (A call from Python makes some objects itself, for its arguments.)
    """
    tau = simulation.joint_torques(None)
    simulation.advance(tau, 2 * count)
    tracemalloc.start()
    kept = []
    for number in (1, count):
        memory = tracemalloc.get_traced_memory()[0]
        simulation.advance(tau, number)
        kept.append(tracemalloc.get_traced_memory()[0] - memory)
    tracemalloc.stop()
    return kept[1] - kept[0]


def start(scene, cache):
    """Return the times of a start in a process of its own, with its cache [s]."""
    environment = {**os.environ, 'CLOSEDLOOP_CACHE_DIR': cache, 'PYTHONPATH': str(ROOT)}
    begin = time.perf_counter()
    run = subprocess.run([sys.executable, '-c', START.format(scene=scene)], env=environment,
                         capture_output=True, text=True, check=True, cwd=cache)
    return {'whole': time.perf_counter() - begin, **json.loads(run.stdout)}


def starts(scene):
    """Return the times of a first and of a warm start [s]."""
    with tempfile.TemporaryDirectory() as cache:
        return start(scene, cache), start(scene, cache)


def main(arguments=None):
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', default=scene_names(), metavar='SCENE',
                        help='shipped scenes (default: all)')
    parser.add_argument('--count', type=int, default=2000, help='calls at once (default: 2000)')
    parser.add_argument('--repeats', type=int, default=25, help='default: 25')
    parser.add_argument('--without-starts', action='store_true',
                        help='do not measure the first start')
    options = parser.parse_args(arguments)
    print(f'{description()}\n')
    print('best / median CPU time in microseconds')
    print(f'{"scene":28}{"evaluation":>16}{"Python call":>18}{"RK4 step":>18}'
          f'{"bytes kept":>12}  in {options.count} steps')
    for scene in options.scenes:
        simulation = Simulation.from_scene(scene, integrator='rk4')
        times = [evaluation(simulation, options.count, options.repeats),
                 python_call(simulation, max(1, options.count // 10), options.repeats),
                 step(simulation, options.count, options.repeats)]
        kept = allocation(simulation, options.count)
        cells = [f'{1e6 * best:.2f} / {1e6 * median:.2f}' for best, median in times]
        print(f'{scene:28}{cells[0]:>16}{cells[1]:>18}{cells[2]:>18}{kept:>12}')
    if not options.without_starts:
        for name, times in zip(('first start', 'warm start'), starts(options.scenes[0])):
            print(f'\n{name} of {options.scenes[0]} [s]: ' + ', '.join(
                f'{key} {value:.2f}' for key, value in times.items()))
    return 0


if __name__ == '__main__':
    sys.exit(main())
