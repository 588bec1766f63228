# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop stability``: hard cases with every method, and their results."""

import warnings

from .command import Argument, Command, directory_options, FAILED, free_paths, UsageError
from ..simulation.errors import InaccuracyWarning
from ..studies import stability
from ..visual.progress import parts_bar

FILES = ('stability.csv', 'stability_table.md', 'stability_atlas.png')


def _run(arguments):
    cases = [case for case in stability.CASES
             if not arguments.case or any(word in case.name for word in arguments.case)]
    if not cases:
        names = ', '.join(case.name for case in stability.CASES)
        raise UsageError(f'--case: expected a part of one of: {names}')
    methods = stability.METHODS
    if arguments.default_only:
        methods = {name: methods[name] for name in (stability.DEFAULT, 'rodas4')}
    paths = free_paths(arguments, *FILES)
    # The table has the error of each method.
    warnings.simplefilter('ignore', InaccuracyWarning)
    with parts_bar('cells', 'stability') as progress:
        atlas = stability.study_stability(arguments.quick, cases, methods, progress)
    print(stability.table(atlas, cases, methods))
    if paths:
        arguments.output.mkdir(parents=True, exist_ok=True)
        stability.write_files(atlas, arguments.output, cases, methods)
        stability.stability_atlas(atlas, cases, methods).savefig(paths[2])
        print('\n' + '\n'.join(map(str, paths)))
    failed = stability.unstable(atlas)
    if failed:
        print(f'\nunstable with the default method: {", ".join(failed)}')
    return FAILED if failed else 0


COMMAND = Command(
    name='stability',
    summary='run the hard cases with every method and draw the stability atlas',
    description="""\
Run hard cases (singular configurations, redundant loops, extreme scales,
contradictory input, stiff scenes, long runs) with every method. Each cell is the
worst figure of one case with one method, and what that means: accurate,
degraded but stable, refused with a reason, or unstable: silently wrong.
doc/stability_cases.md lists every case. Exit code 1 where the default method is
unstable.
""",
    epilog="""\
examples:
  closedloop stability --quick
  closedloop stability --output results --default-only
  closedloop stability --quick --case flat --case loops
""",
    arguments=(
        *directory_options(', '.join(FILES)),
        Argument('--quick', action='store_true',
                 help='fewer trials and shorter runs of the default method, too'),
        Argument('--case', action='append', metavar='NAME', default=[],
                 help='only the cases whose name contains this; may be repeated'),
        Argument('--default-only', action='store_true',
                 help='only the default method, and RODAS4 for stiff scenes')),
    run=_run,
    reads_scenes=False)
