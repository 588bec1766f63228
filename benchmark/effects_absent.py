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
import numpy as np

COPIES = ('as_it_is', 'once_more', 'without_hooks')
HOOKED = ('evaluation.py',)
SCENES = ('three_rrr', 'carpet_scraper', 'four_bar')


def copies(directory, names=COPIES, cut=None):
    """
    Import the copies of the package.

    Parameters
    ----------
    directory : pathlib.Path
        They are made here, unless it has them from an earlier run.
    names : sequence of str
        Of the copies; the last one is cut.
    cut : callable, optional
        Takes the directory of the last copy and cuts something out of it; the hooks of the
        effects when not given.

    Returns
    -------
    dict of str to module

    """
    if not (directory / 'config').exists():
        for name in names:
            shutil.copytree(ROOT / 'closedloop_dynamics', directory / name,
                            ignore=shutil.ignore_patterns('__pycache__'))
        (cut or cut_all_hooks)(directory / names[-1])
        shutil.copytree(ROOT / 'config', directory / 'config')
    sys.path.insert(0, str(directory))
    return {name: importlib.import_module(name) for name in names}


def cut_all_hooks(directory):
    """Cut the hooks of the effects out of a copy of the package."""
    count = sum(cut_hooks(directory / 'integration' / name) for name in HOOKED)
    if count < 4:
        raise RuntimeError(f'only {count} hooks of effects were found to be cut out')


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
    dict of str to ndarray, shape (repeats,)
        [s].

    """
    simulations = {name: package.Simulation.from_scene(scene, integrator='rk4')
                   for name, package in packages.items()}
    for simulation in simulations.values():
        simulation.monitor.sampling = False
    tau = next(iter(simulations.values())).joint_torques(None)
    times = {name: [] for name in simulations}
    shuffle = random.Random(0)
    for _ in range(repeats):
        for name in shuffle.sample(list(simulations), len(simulations)):
            simulations[name].reset()
            simulations[name].advance(tau, steps // 10)
            moments = [time.process_time()]
            for count in (1, steps + 1):
                simulations[name].advance(tau, count)
                moments.append(time.process_time())
            times[name].append(np.diff(moments))
    # A call takes 0.01 ms, and in all copies but the first 0.3 ms or more, until numba has
    # recognised what is handed over: no part of a step.
    return {name: (np.array(values)[:, 1] - np.min(values, axis=0)[0]) / steps
            for name, values in times.items()}


def arguments_of(arguments, description):
    """
    Read the command line of a comparison of copies.

    Parameters
    ----------
    arguments : sequence of str or None
        None: those of the process.
    description : str
        What is compared.

    Returns
    -------
    argparse.Namespace

    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('scenes', nargs='*', default=SCENES, metavar='SCENE',
                        help=f'scenes that list no force law (default: {", ".join(SCENES)})')
    parser.add_argument('--steps', type=int, default=2000, help='steps a round (default: 2000)')
    parser.add_argument('--repeats', type=int, default=100, help='rounds (default: 100)')
    parser.add_argument('--directory', type=Path,
                        help='where to keep the copies and what was compiled, so that a second '
                             'run measures at once (default: nowhere)')
    return parser.parse_args(arguments)


def compare(options, names, cut=None):
    """
    Print times of a step, and their ratios among three copies.

    Parameters
    ----------
    options : argparse.Namespace
        Of ``arguments_of``.
    names : sequence of str
        The package as it is, once more, and cut.
    cut : callable, optional
        As for ``copies``.

    """
    print(f'{description()}\n')
    print('RK4 steps, best of the rounds: as it is [us], and ratios')
    print(f'{"scene":24}{"step":>10}{"as it is / " + names[-1].replace("_", " "):>28}'
          f'{"once more / as it is":>24}')
    with tempfile.TemporaryDirectory() as temporary:
        directory = (options.directory or Path(temporary)).resolve()
        os.environ['NUMBA_CACHE_DIR'] = str(directory / 'cache')
        packages = copies(directory, names, cut)
        for scene in options.scenes:
            times = measure(packages, scene, options.steps, options.repeats)
            first, again, without = (min(times[name]) for name in names)
            print(f'{scene:24}{1e6 * first:>10.3f}{first / without:>28.3f}{again / first:>24.3f}')


def main(arguments=None):
    """Run the benchmark."""
    compare(arguments_of(arguments, __doc__), COPIES)
    return 0


if __name__ == '__main__':
    sys.exit(main())
