# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Measure every figure of the pages on accuracy, performance and sweeps, from one clean commit.

Runs make_accuracy_doc.py, make_performance_doc.py and throughput.py (for doc/sweep.md) one after
the other, then puts the figures of README.md in; with ``--stability`` it runs the hard cases for
doc/stability_cases.md, too. The commit is reported as it was when this began: the files that are
written along the way do not make it another one. To be run on a machine that does nothing else.
"""

import argparse
import datetime
import os
from pathlib import Path
import runpy
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory

import all_machines_report
from machine import COMMIT, commit, ROOT
import make_accuracy_doc
import make_performance_doc
import sentences


def readme_passages(pictures):
    """Return {name of a passage of README.md: its text}, from the CSV files."""
    by_default = all_machines_report.by_default(pictures / 'accuracy_machines.csv')
    return {'speed': sentences.speed(pictures, by_default),
            **make_accuracy_doc.readme_passages(pictures)}


def write_readme(checkout):
    """Put the figures into README.md."""
    page = checkout / 'README.md'
    page.write_text(make_accuracy_doc.filled(
        page.read_text(), readme_passages(checkout / 'doc' / 'pictures')))


def measure_throughput(checkout, quick, python):
    """Measure many simulations at once, and fill doc/sweep.md."""
    few = ['--samples', '4', '--steps', '20', '--repeats', '1'] if quick else ['--samples', '64']
    done = subprocess.run([python, str(ROOT / 'benchmark' / 'throughput.py'), *few], check=True,
                          stdout=subprocess.PIPE, text=True)
    machine, *lines = done.stdout.splitlines()
    page = checkout / 'doc' / 'sweep.md'
    page.write_text(make_accuracy_doc.filled(page.read_text(), {
        'throughput machine': f'Measured on {datetime.date.today().isoformat()}: {machine}.',
        'throughput': '\n'.join(line for line in lines if line.startswith('|'))}))


def measure_stability(checkout, quick):
    """Run the hard cases with every method, and write doc/stability_cases.md and its picture."""
    with TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, ROOT / 'benchmark' / 'stability.py', '--output', folder,
             *(['--quick'] if quick else [])], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        shutil.copy(Path(folder, 'stability.csv'), checkout / 'doc' / 'pictures')
    runpy.run_path(str(checkout / 'doc' / 'make_stability_cases.py'), run_name='__main__')


def main(arguments=None):
    """Measure and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, parents=[make_accuracy_doc.options_of_peers()])
    parser.add_argument('--measured', action='store_true',
                        help='measure nothing, make the tables and sentences from the files')
    parser.add_argument('--stability', action='store_true',
                        help='run the hard cases, too: a quarter of an hour')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output', metavar='DIR',
                        help='where results go that no page shows (default: %(default)s)')
    parser.add_argument('--checkout', type=Path, default=ROOT, metavar='DIR',
                        help='whose pages to fill (default: this one)')
    options = parser.parse_args(arguments)
    name = commit()
    if name.endswith('-dirty') and not (options.quick or options.measured):
        parser.error(f'expected a clean checkout, got {name}: commit first, so that the figures '
                     'belong to a commit')
    os.environ[COMMIT] = name
    doc = options.checkout / 'doc'
    how = [f'--{name}' for name in ('quick', 'measured') if getattr(options, name)]
    beside = ['--output', str(options.output), '--peers-python', options.peers_python,
              *(part for name in ('models', 'families') if getattr(options, name)
                for part in (f'--{name}', str(getattr(options, name))))]
    make_accuracy_doc.main([*how, *beside, '--document', str(doc / 'accuracy.md')])
    if not options.measured or (options.output / 'peers.json').exists():
        make_performance_doc.main([
            *how, *beside, '--document', str(doc / 'performance.md')])
    if not options.measured:
        measure_throughput(options.checkout, options.quick, options.peers_python)
    write_readme(options.checkout)
    if options.stability:
        measure_stability(options.checkout, options.quick)
    return 0


if __name__ == '__main__':
    sys.exit(main())
