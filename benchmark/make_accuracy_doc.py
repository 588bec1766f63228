# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Measure all that doc/accuracy.md shows, and put it there.

Measuring writes the pictures and CSV files doc/pictures/accuracy_*.*; the passages of
doc/accuracy.md between ``<!-- begin NAME -->`` and ``<!-- end NAME -->`` are made from these
files, with ``--measured`` without measuring. The text around them stays. doc/accuracy_machines.md
is filled in the same way, by all_machines.py, which needs the packages of the extra ``bench`` for
the other simulators. To be run on a machine that does nothing else.
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path
import re
import shutil
import subprocess
import sys
import time
import warnings

import all_machines_report
import energy_study
import held_torques
from machine import description, ROOT
from peer_report import measured
import sentences
import throughput
from yardsticks import SciPyLine, SOLVERS

from closedloop_dynamics.mechanism.errors import InaccuracyWarning  # noqa: I100
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.scene.records import AUTO
from closedloop_dynamics.studies import accuracy_report
from closedloop_dynamics.studies.accuracy import default_lines, Line, study_accuracy
from closedloop_dynamics.visual.tables import markdown_table, seconds

TARGETS = (1e-3, 1e-6, 1e-9)
BASE_TORQUES = {'theta_1': 5.0, 'theta_6': -3.0, 'theta_7': 2.0}
NOT_REACHED = '-'
# The columns of the tables.
METHODS = ('rk4', 'dopri5', 'dop853', AUTO)


@dataclass(frozen=True)
class Case:
    """One study of the document: its name there, what it is, scene, torques [N m]."""

    name: str
    text: str
    scene: str
    torque: dict = field(default_factory=dict)
    everything: bool = False


CASES = (
    Case('three_rrr', '3-RRR, released from rest', 'three_rrr', everything=True),
    Case('three_rrr_driven', '3-RRR, torques 5, -3, 2 N m', 'three_rrr', BASE_TORQUES),
    Case('carpet_scraper', 'scraper, released from rest', 'carpet_scraper', everything=True),
    Case('carpet_scraper_driven', 'scraper, 2 N m at the crank', 'carpet_scraper',
         {'theta_1': 2.0}),
    Case('carpet_scraper_on_carpet', 'scraper on its carpet, 30 N m', 'carpet_scraper_on_carpet',
         {'theta_1': 30.0}),
    Case('slider_crank_end_stop', 'slider-crank against its end stop', 'slider_crank_end_stop'),
)
HELD = {'three_rrr': '3-RRR', 'carpet_scraper': 'scraper'}
MACHINES, SAMPLES = 'machines', 'samples'
PARTS = (*(case.name for case in CASES), 'held', 'energy', MACHINES, SAMPLES)
PAGES = ('accuracy.md', 'accuracy_methods.md', 'accuracy_machines.md')


@dataclass(frozen=True)
class Setting:
    """A method with its step size or tolerance, what it buys and what it costs."""

    integrator: str
    step_size: float  # [s]; NaN where the tolerance counts
    tolerance: float
    error: float  # Of positions [rad or m]
    evaluations: float  # Per simulated second
    cost: float  # CPU time per simulated second [s], NaN where it was not measured

    def __str__(self):
        """Return method and setting."""
        if self.step_size == self.step_size:
            return f'{self.integrator}, step {seconds(self.step_size)}'
        kind = 'accuracy' if self.integrator == AUTO else 'tolerance'
        return f'{self.integrator}, {kind} {self.tolerance:.0e}'


def lines(case):
    """Return the lines to measure: all of them, or the integrators alone; SciPy's beside them."""
    return [line for line in (*default_lines(), *map(SciPyLine, SOLVERS))
            if case.everything or line == type(line)(line.integrator)]


def settings_of_study(path):
    """Return {integrator: settings, from coarse to fine} of a study's CSV file."""
    found = {}
    for row in sentences.read(path):
        integrator = row['integrator']
        usual = row['stabilisation'] == Line(integrator).stabilisation and (
            row.get('formulation', 'subsystem') == 'subsystem')
        if usual and not row['failure']:
            found.setdefault(integrator, []).append(Setting(
                integrator, *(float(row[name] or 'nan') for name in (
                    'step_size', 'tolerance', 'position_error', 'evaluations_per_second',
                    'cpu_time_per_second'))))
    return found


def settings_of_runs(runs):
    """Return the same of runs of ``held_torques``."""
    found = {}
    for run in runs:
        if not run.failure:
            found.setdefault(run.integrator, []).append(Setting(
                run.integrator, run.step_size, run.tolerance, run.position_error,
                run.evaluations, run.cost))
    return found


def holding(settings, target):
    """Return the settings of one method that hold a target, they and all finer ones."""
    kept = []
    for setting in reversed(settings):
        if not setting.error <= target:
            break
        kept.append(setting)
    return kept[::-1]


def cheapest(settings, target):
    """Return the cheapest setting of one method that holds a target; None: there is none."""
    return min(holding(settings, target), key=lambda setting: setting.cost, default=None)


def free_settings(pictures):
    """Return {what moves: {integrator: settings}} under constant torques."""
    return {case.text: settings_of_study(pictures / f'accuracy_{case.name}.csv')
            for case in CASES}


def held_settings(pictures):
    """Return the same where torques are held."""
    runs = held_torques.read(pictures / 'accuracy_held.csv')
    return {f'{HELD[scene]}, {rate} Hz': settings_of_runs(
        [run for run in runs if (run.scene, run.rate) == (scene, rate)])
        for scene, rate in dict.fromkeys((run.scene, run.rate) for run in runs)}


def table(first, motions):
    """Return a table of what each method costs for each error, the cheapest one named."""
    rows = []
    for text, settings in motions.items():
        for target in TARGETS:
            found = {name: cheapest(settings.get(name, []), target) for name in METHODS}
            best = min(filter(None, found.values()), key=lambda setting: setting.cost,
                       default=None)
            rows.append((text, f'{target:.0e}', str(best) if best else NOT_REACHED,
                         *(_cell(setting, best) for setting in found.values())))
    return markdown_table((first, 'error', 'cheapest', *METHODS), rows)


def _cell(setting, best):
    if setting is None:
        return NOT_REACHED
    text = f'{seconds(setting.cost)} / {setting.evaluations:.0f}'
    return f'**{text}**' if setting is best else text


def passages(pictures):
    """Return {name of a passage: its text}, from the files of the studies."""
    free, held = free_settings(pictures), held_settings(pictures)
    return {'free': table('motion, 1 s', free), 'held': table('torques held', held),
            'short': sentences.accuracy_advice(free, held, pictures, cheapest),
            **all_machines_report.passages(pictures / 'accuracy_machines.csv'),
            'samples': throughput.fidelity_table(
                sentences.read(pictures / 'accuracy_samples.csv'))}


def readme_passages(pictures):
    """Return the passage of README.md on accuracy."""
    settings = settings_of_study(pictures / 'accuracy_three_rrr_driven.csv')
    return {'accuracy': sentences.accuracy_costs(settings, cheapest)}


def measure(pictures, quick, only):
    """Measure, and write pictures and CSV files."""
    # How far off each method is stands in the tables.
    warnings.simplefilter('ignore', InaccuracyWarning)
    for case in CASES:
        if case.name in only:
            study = study_accuracy(load_scene(case.scene), case.torque, 1.0, quick,
                                   list(lines(case)), _progress(case.name))
            accuracy_report.write(study, pictures / f'accuracy_{case.name}.csv',
                                  pictures / f'accuracy_{case.name}.png')
    if 'held' in only:
        held_torques.write(held_torques.study(quick=quick), pictures / 'accuracy_held.csv')
    if 'energy' in only:
        energy_study.write(energy_study.study(quick), pictures / 'accuracy_energy.csv')


def run(python, name, *arguments, quick=False, **how):
    """Run a benchmark in a process of its own."""
    subprocess.run([python, str(ROOT / 'benchmark' / f'{name}.py'), *map(str, arguments),
                    *(['--quick'] if quick else [])], check=True, **how)


def measure_beside_others(pictures, options, only):
    """Measure what needs other simulators: every machine, and many samples at once."""
    if SAMPLES in only:
        few = ['--samples', 4, '--repeats', 1] if options.quick else ['--samples', 64]
        run(options.peers_python, 'throughput', '--fidelity', '--csv',
            pictures / 'accuracy_samples.csv', *few)
    if MACHINES in only:
        run(options.peers_python, 'all_machines', '--output', options.output,
            *(['--models', options.models] if options.models else []), quick=options.quick)
        table = pictures / 'accuracy_machines.csv'
        shutil.copyfile(options.output / 'all_machines.csv', table)
        all_machines_report.picture(table).savefig(table.with_suffix('.png'))


def _progress(name):
    begin = time.perf_counter()

    def progress(done, total):
        print(f'\r{name}: {done} of {total}, {time.perf_counter() - begin:.0f} s ',
              end='\n' if done == total else '', file=sys.stderr, flush=True)

    return progress


def filled(text, parts):
    """
    Return a document with passages replaced.

    Raises
    ------
    KeyError
        Where it has no such passage.

    """
    for name, part in parts.items():
        begin, end = (f'<!-- {word} {re.escape(name)} -->' for word in ('begin', 'end'))
        pattern = re.compile(f'({begin}\n).*?([ ]*{end})', re.DOTALL)
        if not pattern.search(text):
            raise KeyError(f'the document has no passage {name!r}')
        text = pattern.sub(lambda match: f'{match[1]}{part}\n{match[2]}', text)
    return text


def fill_pages(folder, parts):
    """
    Replace each passage on the page that has it.

    Raises
    ------
    KeyError
        Where none has one of them.

    """
    left = dict(parts)
    for page in (folder / name for name in PAGES):
        text = page.read_text()
        here = {name: left.pop(name) for name in parts if f'<!-- begin {name} -->' in text}
        page.write_text(filled(text, here))
    if left:
        raise KeyError(f'no page has the passages {sorted(left)}')


def options_of_peers():
    """Return the options that whoever measures other simulators, too, takes."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument('--quick', action='store_true', help='see that it runs: rough numbers')
    parser.add_argument('--peers-python', default=sys.executable, metavar='PYTHON',
                        help='interpreter with the packages of the extra bench '
                        '(default: this one)')
    parser.add_argument('--models', type=Path, metavar='DIR',
                        help='folder of models that others have published, which are left out '
                        'without it: a clone of example-parallel-robots')
    parser.add_argument('--families', type=Path, metavar='DIR',
                        help='folder of robots with loops of any size, likewise: a clone of '
                        'generalized_rbda')
    return parser


def options_of_page(arguments, text, parts, page):
    """Return the options of a command that makes a page, and its parser, to refuse some."""
    parser = argparse.ArgumentParser(description=text, parents=[options_of_peers()])
    parser.add_argument('--only', action='append', choices=parts, metavar='PART',
                        help='measure this part alone: ' + ', '.join(parts))
    parser.add_argument('--measured', action='store_true',
                        help='measure nothing: make the page from what was measured')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output', metavar='DIR',
                        help='where results go that no page shows (default: %(default)s)')
    parser.add_argument('--document', type=Path, default=ROOT / 'doc' / page)
    options = parser.parse_args(arguments)
    (options.document.parent / 'pictures').mkdir(exist_ok=True)
    return options, parser


def main(arguments=None):
    """Measure and write."""
    options, _ = options_of_page(arguments, __doc__, PARTS, PAGES[0])
    pictures, only, parts = options.document.parent / 'pictures', options.only or PARTS, {}
    if not options.measured:
        # What is written from here on makes the checkout no other one.
        reported = measured({'machine': description(), 'quick': options.quick})
        measure(pictures, options.quick, only)
        measure_beside_others(pictures, options, only)
        if not options.only:
            parts['machine'] = parts['methods machine'] = reported
        if MACHINES in only:
            parts['machines machine'] = reported
    parts.update(passages(pictures))
    fill_pages(options.document.parent, parts)
    return 0


if __name__ == '__main__':
    sys.exit(main())
