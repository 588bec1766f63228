# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
What the support of effects costs a scene that lists none.

Three copies of the package are compiled side by side: as it is, the same once more, and one with
every hook of the effects cut out of the source. They simulate the same in turn. The second copy
tells the noise: the same code at other addresses.

"""

import argparse
import ast
import importlib
import os
from pathlib import Path
import random
import shutil
import sys
import tempfile
import time

from machine import description, ROOT

COPIES = ('as_it_is', 'once_more', 'without_hooks')
HOOKED = ('system.py', 'projection.py')
SCENES = ('three_rrr', 'carpet_scraper', 'four_bar')


def copies(directory):
    """
    Import the copies of the package.

    Parameters
    ----------
    directory : pathlib.Path
        They are made here, unless it has them from an earlier run.

    Returns
    -------
    dict of str to module

    """
    if not (directory / 'config').exists():
        for name in COPIES:
            shutil.copytree(ROOT / 'closedloop_dynamics', directory / name,
                            ignore=shutil.ignore_patterns('__pycache__'))
        count = sum(cut_hooks(directory / COPIES[2] / 'integration' / name) for name in HOOKED)
        if count < 5:
            raise RuntimeError(f'only {count} hooks of effects were found to be cut out')
        shutil.copytree(ROOT / 'config', directory / 'config')
    sys.path.insert(0, str(directory))
    return {name: importlib.import_module(name) for name in COPIES}


def cut_hooks(path):
    """
    Empty the functions that do nothing without effects: ``if effects is not None: ...``.

    Parameters
    ----------
    path : pathlib.Path
        Of a source file, written in place.

    Returns
    -------
    int
        How many were found.

    """
    lines = path.read_text().splitlines(keepends=True)
    hooks = [node.body[-1] for node in ast.parse(''.join(lines)).body
             if isinstance(node, ast.FunctionDef) and isinstance(node.body[-1], ast.If)
             and ast.unparse(node.body[-1].test) == 'effects is not None'
             and not node.body[-1].orelse]
    for hook in reversed(hooks):
        lines[hook.lineno - 1:hook.end_lineno] = ['    pass\n']
    path.write_text(''.join(lines))
    return len(hooks)


def measure(packages, scene, steps, repeats):
    """
    Return the times per step of the copies, one a round.

    Parameters
    ----------
    packages : dict of str to module
        The copies.
    scene : str
        Its name.
    steps, repeats : int
        Steps a round, and rounds.

    Returns
    -------
    dict of str to list of float
        [s].

    """
    simulations = {name: package.Simulation.from_scene(scene, integrator='rk4')
                   for name, package in packages.items()}
    for simulation in simulations.values():
        simulation.warm_up()
        simulation.monitor.sampling = False
    tau = next(iter(simulations.values())).joint_torques(None)
    times = {name: [] for name in simulations}
    shuffle = random.Random(0)
    for _ in range(repeats):
        for name in shuffle.sample(COPIES, len(COPIES)):
            simulations[name].reset()
            simulations[name].advance(tau, steps // 10)
            begin = time.process_time()
            simulations[name].advance(tau, steps)
            times[name].append((time.process_time() - begin) / steps)
    return times


def main(arguments=None):
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', default=SCENES, metavar='SCENE',
                        help=f'scenes that list no force law (default: {", ".join(SCENES)})')
    parser.add_argument('--steps', type=int, default=2000, help='steps a round (default: 2000)')
    parser.add_argument('--repeats', type=int, default=100, help='rounds (default: 100)')
    parser.add_argument('--directory', type=Path,
                        help='where to keep the copies and what was compiled, so that a second '
                             'run measures at once (default: nowhere)')
    options = parser.parse_args(arguments)
    print(f'{description()}\n')
    print('RK4 steps; ratios of times with the 95 % range of their medians')
    print(f'{"scene":24}{"step":>10}{"as it is / without hooks":>30}{"the same once more":>26}')
    with tempfile.TemporaryDirectory() as temporary:
        directory = (options.directory or Path(temporary)).resolve()
        os.environ['NUMBA_CACHE_DIR'] = str(directory / 'cache')
        packages = copies(directory)
        ratio = importlib.import_module('as_it_is.studies.effects').ratio
        for scene in options.scenes:
            times = measure(packages, scene, options.steps, options.repeats)
            cells = [ratio(times['as_it_is'], times['without_hooks']),
                     ratio(times['once_more'], times['as_it_is'])]
            texts = [f'{one.value:.3f} ({one.low:.3f} to {one.high:.3f})' for one in cells]
            print(f'{scene:24}{1e6 * min(times["as_it_is"]):>7.2f} us{texts[0]:>30}{texts[1]:>26}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
