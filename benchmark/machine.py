# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What benchmarks share: what they ran on, their options, times in turn, their results."""

import argparse
import importlib.metadata
import json
import os
from pathlib import Path
import platform
import subprocess
import sys
import time

from closedloop_dynamics.studies.published_benchmarks import processor

ROOT = Path(__file__).resolve().parents[1]
# Names the commit in the environment of benchmarks that a longer measurement runs.
COMMIT = 'BENCHMARK_COMMIT'
LIBRARIES = ('llvmlite', 'numpy', 'scipy')
# Benchmarks that start nodes, or look at pages, take helpers of the tests.
sys.path.insert(0, str(ROOT))


def commit():
    """Return the commit of the checkout, marked where files differ from it."""
    if os.environ.get(COMMIT):
        return os.environ[COMMIT]
    try:
        name = subprocess.run(['git', 'describe', '--always', '--dirty'], cwd=ROOT, check=True,
                              capture_output=True, text=True)
        return name.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return 'unknown'


def description():
    """Return one line on the machine and the versions."""
    versions = ', '.join(f'{name} {importlib.metadata.version(name)}' for name in LIBRARIES)
    return (f'{processor()}, {platform.system()}; Python {platform.python_version()}, {versions}; '
            f'commit {commit()}')


def parser_of(text, quick=None, output=False, scenes=None):
    """
    Return a parser of a benchmark's command line, with the options that many have.

    ``text`` describes it; ``quick`` says what --quick leaves out; ``output`` adds the folder of
    ``write_result``; ``scenes`` are those that are measured where none are named.
    """
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    if scenes is not None:
        parser.add_argument('scenes', nargs='*', default=scenes, metavar='SCENE',
                            help=f'default: {", ".join(scenes)}')
    if quick:
        parser.add_argument('--quick', action='store_true', help=quick)
    if output:
        parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                            metavar='DIR', help='where results go (default: %(default)s)')
    return parser


def write_result(options, name, result, *parts):
    """Write a result as JSON into the folder of ``--output``, and print texts on it."""
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / f'{name}.json'
    path.write_text(json.dumps(result, indent=1))
    print(result['machine'], *parts, f'written: {path}', sep='\n\n')


def in_turn(tasks, rounds, clock=time.process_time):
    """
    Return the times of tasks, lists by their names [s], each task run once in each round.

    In turn, so that what disturbs one disturbs the others: ratios are of one run. ``tasks`` are
    functions by name.
    """
    times = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, run in tasks.items():
            begin = clock()
            run()
            times[name].append(clock() - begin)
    return times


def least(tasks, rounds, clock=time.process_time):
    """Return the least of the times of each task, run ``in_turn`` [s]."""
    return {name: min(times) for name, times in in_turn(tasks, rounds, clock).items()}
