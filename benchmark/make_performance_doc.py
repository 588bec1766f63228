# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Measure all that doc/performance.md shows, and put it there.

Runs peers.py, operation_count.py, elements.py, size.py, startup.py and, where a folder of models
is given, models.py one after the other, each in a process of its own, then writes
doc/pictures/performance_*.* and fills the passages of the document between ``<!-- begin NAME -->``
and ``<!-- end NAME -->``; the text around them stays.
"""

import argparse
import datetime
import json
from pathlib import Path
import shutil
import subprocess
import sys

import elements
from machine import ROOT
from make_accuracy_doc import filled
import models
import operation_count
import peer_report
import sentences
import size
import startup

PARTS = ('peers', 'operation_count', 'elements', 'size', 'startup', 'models')
# The rows of the table of sizes that the document shows.
SHOWN = 2


def measure(parts, output, quick, peers_python, folder=None):
    """
    Run the benchmarks.

    Parameters
    ----------
    parts : sequence of str
        Of ``PARTS``.
    output : pathlib.Path
        Where they write their results.
    quick : bool
        To see that they run.
    peers_python : str
        Interpreter that has the packages of the extra ``bench``.
    folder : pathlib.Path, optional
        With models, for that part.

    """
    for part in parts:
        python = sys.executable if part in ('elements', 'size', 'startup') else peers_python
        print(f'{part} ...', file=sys.stderr, flush=True)
        subprocess.run(
            [python, str(ROOT / 'benchmark' / f'{part}.py'), '--output', str(output),
             *([str(folder)] if part == 'models' else []), *(['--quick'] if quick else [])],
            check=True, stdout=subprocess.DEVNULL)


def peers_passages(results):
    """Return the passages on the other simulators, of the groups that were measured."""
    texts = {}
    for group, result in results.items():
        name = 'peers' if group == 'plane' else f'peers {group}'
        texts.update({
            f'{name} machine': f'{measured(result, result["date"])}\n{peer_report.busy(result)}',
            f'{name} agreement': peer_report.agreement_table(result),
            f'{name} evaluation': peer_report.evaluation_table(result)})
        if result['cases']:
            uncertain = max(case['uncertainty'] for case in result['cases'])
            texts[f'{name} motions'] = peer_report.motion_table(result)
            texts[f'{name} reference'] = ('The two methods behind the reference differ by '
                                          f'{uncertain:.0e} rad or m at most.')
        for key in ('rollouts', 'short_rollouts'):
            if result[key]:
                texts[f'{name} {key.replace("_", " ")}'] = peer_report.rollout_table(result[key])
    return texts


def operation_passages(result):
    """Return the passages on operations."""
    core = '' if result['quick'] else operation_count.core_text(result)
    return {'operations table': operation_count.table(result), 'operations core': core}


def size_passages(result):
    """Return the passages on size."""
    last = {}
    for row in result['rows']:
        last.setdefault(row['family'], []).append(row)
    rows = [row for family in last.values() for row in family[:1] + family[1::2][-SHOWN:]]
    return {'size growth': size.growth(result),
            'size table': size.table({**result, 'rows': rows})}


def passages(output, parts):
    """Return {name of a passage: its text} from the results of benchmarks."""
    results = {part: json.loads((output / f'{part}.json').read_text()) for part in parts}
    builders = {'peers': peers_passages, 'operation_count': operation_passages,
                'elements': lambda result: {
                    'elements rows': elements.row_table(result),
                    'elements times': elements.time_table(result),
                    'elements rollouts': elements.rollout_table(result)},
                'size': size_passages,
                'startup': lambda result: {'startup table': startup.table(result)},
                'models': lambda result: {
                    'models evaluation': models.evaluation_table(result)}}
    texts = {}
    for part, result in results.items():
        texts.update(builders[part](result))
        if part != 'peers':
            texts[f'{part} machine'] = measured(result, datetime.date.today().isoformat())
    return texts


def measured(result, date):
    """Return when and where something was measured."""
    return f'Measured on {date}: {result["machine"]}.' + (
        ' Quick version: rough numbers.' if result['quick'] else '')


def copy_pictures(output, pictures, parts):
    """Copy pictures and CSV files to the document's."""
    names = {'size': ['size.png'], 'models': ['models.csv']}
    if 'peers' in parts:
        names['peers'] = [name for group, result in json.loads(
            (output / 'peers.json').read_text()).items()
            for name in peer_report.file_names(result, group)]
    for name in (name for part in parts for name in names.get(part, ())):
        shutil.copyfile(output / name, pictures / f'performance_{name}')


def options_of_peers():
    """Return the options that whoever measures other simulators, too, takes."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument('--quick', action='store_true', help='see that it runs: rough numbers')
    parser.add_argument('--peers-python', default=sys.executable, metavar='PYTHON',
                        help='interpreter with the packages of the extra bench '
                        '(default: this one)')
    parser.add_argument('--models', type=Path, metavar='DIR',
                        help='folder of models that others have published, which are left out '
                        'without it')
    return parser


def main(arguments=None):
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, parents=[options_of_peers()])
    parser.add_argument('--only', action='append', choices=PARTS, help='this part alone')
    parser.add_argument('--measured', action='store_true',
                        help='measure nothing, take what lies in the output directory')
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                        metavar='DIR', help='where results go (default: %(default)s)')
    parser.add_argument('--document', type=Path, default=ROOT / 'doc' / 'performance.md')
    options = parser.parse_args(arguments)
    known = options.models or options.measured and (options.output / 'models.json').exists()
    parts = options.only or [part for part in PARTS if part != 'models' or known]
    if 'models' in parts and not (options.models or options.measured):
        parser.error('--only models: expected --models DIR, got none')
    if not options.measured:
        measure(parts, options.output, options.quick, options.peers_python, options.models)
    texts = passages(options.output, parts)
    pictures = options.document.parent / 'pictures'
    pictures.mkdir(exist_ok=True)
    copy_pictures(options.output, pictures, parts)
    if 'peers' in parts:
        texts['space speed'] = sentences.space_speed(pictures)
    options.document.write_text(filled(options.document.read_text(), texts))
    return 0


if __name__ == '__main__':
    sys.exit(main())
