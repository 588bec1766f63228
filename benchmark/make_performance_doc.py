# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Measure all that doc/performance.md shows, and put it there.

Runs peers.py, operation_count.py, elements.py, size.py, startup.py and, where a folder of models
is given, models.py one after the other, each in a process of its own, then writes
doc/pictures/performance_*.* and fills the passages of the document between ``<!-- begin NAME -->``
and ``<!-- end NAME -->``; the text around them stays.
"""

import json
import shutil
import subprocess
import sys

import elements
from make_accuracy_doc import filled, options_of_page, run
import models
import operation_count
import peer_report
import sentences
import size
import startup

PARTS = ('peers', 'operation_count', 'elements', 'size', 'startup', 'models')
# The rows of the table of sizes that the document shows.
SHOWN = 2


def measure(parts, output, quick, peers_python, folder=None, families=None):
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
    families : pathlib.Path, optional
        With families of robots, for the peers.

    """
    for part in parts:
        print(f'{part} ...', file=sys.stderr, flush=True)
        run(sys.executable if part in ('elements', 'size', 'startup') else peers_python, part,
            '--output', output, *([folder] if part == 'models' else []),
            *(['--families', families] if part == 'peers' and families else []), quick=quick,
            stdout=subprocess.DEVNULL)


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
    builders = {'peers': peer_report.passages, 'operation_count': operation_passages,
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
            texts[f'{part} machine'] = peer_report.measured(result)
    return texts


def copy_pictures(output, pictures, parts):
    """Copy pictures and CSV files to the document's."""
    names = {'size': ['size.png'], 'models': ['models.csv']}
    if 'peers' in parts:
        names['peers'] = [name for group, result in json.loads(
            (output / 'peers.json').read_text()).items()
            for name in peer_report.file_names(result, group)]
    for name in (name for part in parts for name in names.get(part, ())):
        shutil.copyfile(output / name, pictures / f'performance_{name}')


def main(arguments=None):
    """Measure and write."""
    options, parser = options_of_page(arguments, __doc__, PARTS, 'performance.md')
    known = options.models or options.measured and (options.output / 'models.json').exists()
    parts = options.only or [part for part in PARTS if part != 'models' or known]
    if 'models' in parts and not (options.models or options.measured):
        parser.error('--only models: expected --models DIR, got none')
    if not options.measured:
        measure(parts, options.output, options.quick, options.peers_python, options.models,
                options.families)
    texts, pictures = passages(options.output, parts), options.document.parent / 'pictures'
    copy_pictures(options.output, pictures, parts)
    if 'peers' in parts:
        texts['space speed'] = sentences.space_speed(pictures)
    options.document.write_text(filled(options.document.read_text(), texts))
    return 0


if __name__ == '__main__':
    sys.exit(main())
