# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What a start takes: time of importing, building and the first step, and memory.

Each start is a process of its own: of the Python interface, and where ROS 2 is found of the
simulator node. A first start generates the code of the mechanism into an empty cache; a warm one
reads it from there. Times are CPU time of the process, memory is what of it lies in RAM (RSS).
"""

import argparse
import importlib.util
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile

from machine import description, ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.visual.tables import (  # noqa: E402,I100
    markdown_table, seconds, text_table)

# Rows of the table: a kind of start, and what happens in it in turn.
LIBRARY = """
mark('Python')
from closedloop_dynamics import Simulation
mark('import')
simulation = Simulation.from_scene({scene!r})
mark('scene')
simulation.step()
mark('first step')
simulation.step(duration=1.0)
mark('one second')
"""
NODE = """
mark('Python')
import rclpy
from closedloop_dynamics.ros.simulator_node import SimulatorNode
mark('import')
rclpy.init(args=['--ros-args', '-p', 'scene:={scene}', '-p', 'wait_for_command:=true'])
node = SimulatorNode()
mark('scene')
node.simulation.step()
mark('first step')
node.simulation.step(duration=1.0)
mark('one second')
"""
PROGRAM = """
import json, os, time
marks = []
def mark(name):
    pages = int(open('/proc/self/statm').read().split()[1])
    marks.append((name, time.process_time(), pages * os.sysconf('SC_PAGE_SIZE')))
{body}
print(json.dumps(marks), flush=True)
os._exit(0)
"""
PARTS = ('import', 'scene', 'first step', 'one second')
WARM = 5


def start(body, scene, cache):
    """
    Start once.

    Parameters
    ----------
    body : str
        ``LIBRARY`` or ``NODE``.
    scene : str
        A shipped scene.
    cache : str or None
        Directory of generated code; None: that of this process.

    Returns
    -------
    dict
        CPU time of each part [s], memory after the last [bytes].

    """
    places = {} if cache is None else {'CLOSEDLOOP_CACHE_DIR': cache, 'ROS_LOG_DIR': cache}
    environment = {**os.environ, **places,
                   'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PYTHONPATH': os.pathsep.join(
                       filter(None, (str(ROOT), os.environ.get('PYTHONPATH'))))}
    run = subprocess.run(
        [sys.executable, '-c', PROGRAM.format(body=body.format(scene=scene))], text=True,
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False)
    if run.returncode != 0:
        raise RuntimeError(f'a start of {scene} failed:\n{run.stderr}')
    marks = json.loads(run.stdout.splitlines()[-1])
    times = {name: after - before for (_, before, _), (name, after, _) in zip(marks, marks[1:])}
    memory = {name: size for name, _, size in marks}
    return {**times, 'memory after import': memory['import'], 'memory': memory['one second']}


def measure(quick=False, scene='three_rrr'):
    """
    Measure starts.

    Parameters
    ----------
    quick : bool
        One warm start of the Python interface, with the cache of this process.
    scene : str
        A shipped scene.

    Returns
    -------
    dict
        As written to the JSON file.

    """
    result = {'machine': description(), 'quick': quick, 'scene': scene, 'rows': []}
    with tempfile.TemporaryDirectory() as empty:
        cache = None if quick else empty
        if not quick:
            _add(result, 'Python interface, first start', [start(LIBRARY, scene, cache)])
        _add(result, 'Python interface, warm', [
            start(LIBRARY, scene, cache) for _ in range(1 if quick else WARM)])
        if not quick and importlib.util.find_spec('rclpy'):
            start(NODE, scene, cache)
            _add(result, 'simulator node, warm', [start(NODE, scene, cache)
                                                  for _ in range(WARM)])
    return result


def _add(result, kind, starts):
    """Add the least of each value of some starts."""
    result['rows'].append({'kind': kind, **{
        key: min(one[key] for one in starts) for key in starts[0]}})


def table(result, make=markdown_table):
    """Return the rows as a table."""
    return make(
        ('start of ' + result['scene'], 'importing', 'building, assembling', 'first step',
         'all of these', 'one simulated second', 'memory after import', 'memory'),
        [(row['kind'], *(seconds(row[part]) for part in PARTS[:3]),
          seconds(sum(row[part] for part in PARTS[:3])), seconds(row['one second']),
          f'{row["memory after import"] / 2 ** 20:.0f} MiB', f'{row["memory"] / 2 ** 20:.0f} MiB')
         for row in result['rows']])


def main(arguments=None):
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='one warm start alone')
    parser.add_argument('--scene', default='three_rrr', help='default: %(default)s')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                        metavar='DIR', help='where results go (default: %(default)s)')
    options = parser.parse_args(arguments)
    result = measure(options.quick, options.scene)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / 'startup.json').write_text(json.dumps(result, indent=1))
    print(result['machine'], table(result, text_table), sep='\n\n')
    print(f'\nwritten: {options.output}/startup.json')
    return 0


if __name__ == '__main__':
    sys.exit(main())
