# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What a start takes: time of importing, building and the first step, and memory.

Each start is a process of its own: of the Python interface, and where ROS 2 is found of the
simulator node. A first start generates the code of the mechanism into an empty cache; a warm one
reads it from there. Bytecode of the modules is there from the beginning, as after an installation.
Times are CPU time of the process, memory is what of it lies in RAM (RSS).
"""

import compileall
import importlib.util
import json
import os
import subprocess
import sys
import tempfile

from closedloop_dynamics.visual.tables import markdown_table, seconds, text_table
from machine import description, parser_of, ROOT, write_result

# Of a kind of start: what is imported, and what makes a simulation.
LIBRARY = ('from closedloop_dynamics import Simulation',
           'simulation = Simulation.from_scene({scene!r})')
NODE = ('import rclpy; from closedloop_dynamics.ros.simulator_node import SimulatorNode',
        "rclpy.init(args=['--ros-args', '-p', 'scene:={scene}', '-p', 'wait_for_command:=true']); "
        'node = SimulatorNode(); simulation = node.simulation')
PROGRAM = """
import json, os, time
marks = []
def mark(name):
    pages = int(open('/proc/self/statm').read().split()[1])
    marks.append((name, time.process_time(), pages * os.sysconf('SC_PAGE_SIZE')))
mark('Python')
{importing}
mark('import')
{building}
mark('scene')
simulation.step()
mark('first step')
simulation.step(duration=1.0)
mark('one second')
print(json.dumps(marks), flush=True)
os._exit(0)
"""
PARTS = ('import', 'scene', 'first step', 'one second')
WARM = 5


def start(kind, scene, cache):
    """
    Start once; return the CPU time of each part [s], and memory after the last [bytes].

    ``kind`` is ``LIBRARY`` or ``NODE``, ``scene`` a shipped one, ``cache`` the directory of
    generated code; None: that of this process.
    """
    importing, building = (part.format(scene=scene) for part in kind)
    places = {} if cache is None else {'CLOSEDLOOP_CACHE_DIR': cache, 'ROS_LOG_DIR': cache}
    environment = {**os.environ, **places,
                   'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PYTHONPATH': os.pathsep.join(
                       filter(None, (str(ROOT), os.environ.get('PYTHONPATH'))))}
    run = subprocess.run(
        [sys.executable, '-c', PROGRAM.format(importing=importing, building=building)], text=True,
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False)
    if run.returncode != 0:
        raise RuntimeError(f'a start of {scene} failed:\n{run.stderr}')
    marks = json.loads(run.stdout.splitlines()[-1])
    times = {name: after - before for (_, before, _), (name, after, _) in zip(marks, marks[1:])}
    memory = {name: size for name, _, size in marks}
    return {**times, 'memory after import': memory['import'], 'memory': memory['one second']}


def measure(quick=False, scene='three_rrr'):
    """
    Measure starts of a shipped scene; the least of each value of some.

    ``quick``: one warm start of the Python interface, with the cache of this process.
    """
    result = {'machine': description(), 'quick': quick, 'scene': scene, 'rows': []}
    compileall.compile_dir(ROOT / 'closedloop_dynamics', quiet=1)
    with tempfile.TemporaryDirectory() as empty:
        def add(text, kind, count, cache=empty):
            starts = [start(kind, scene, cache) for _ in range(count)]
            result['rows'].append({'kind': text, **{
                key: min(one[key] for one in starts) for key in starts[0]}})

        if quick:
            add('Python interface, warm', LIBRARY, 1, None)
        else:
            add('Python interface, first start', LIBRARY, 1)
            add('Python interface, warm', LIBRARY, WARM)
            if importlib.util.find_spec('rclpy'):
                start(NODE, scene, empty)
                add('simulator node, warm', NODE, WARM)
    return result


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
    parser = parser_of(__doc__, 'one warm start alone', output=True)
    parser.add_argument('--scene', default='three_rrr', help='default: %(default)s')
    options = parser.parse_args(arguments)
    result = measure(options.quick, options.scene)
    write_result(options, 'startup', result, table(result, text_table))
    return 0


if __name__ == '__main__':
    sys.exit(main())
