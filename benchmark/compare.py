# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Compare the speed of two commits by ratio, in one run.

Each commit is checked out into a worktree of its own, where its engine is compiled, and works in a
process of its own with a cache of its own; the tasks are run in turn, one round after the other,
so that what disturbs one disturbs the other. A commit may be any name that git knows, or a dot:
the files as they are. Results are stored as JSON: the times of every round, machine and commits.
"""

from contextlib import contextmanager
import json
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile

from machine import description, parser_of, ROOT

WORKER = Path(__file__).with_name('compare_worker.py')
ROUNDS, QUICK_ROUNDS = 25, 3
# A ratio is called a change when it is beyond this, and all but a quarter of the rounds say so.
NOTICED = 0.05


class Worker:
    """
    A process that runs tasks with the files of one commit.

    Parameters
    ----------
    root : pathlib.Path
        Of these files.
    cache : pathlib.Path
        Of generated code.
    tasks : sequence of str
        That it prepares; all when empty.

    """

    def __init__(self, root, cache, tasks=()):
        """Start the process, and let it generate code."""
        environment = {**os.environ, 'PYTHONPATH': str(root), 'CLOSEDLOOP_CACHE_DIR': str(cache),
                       'OMP_NUM_THREADS': '1'}
        self._process = subprocess.Popen(
            [sys.executable, str(WORKER), *tasks], env=environment, text=True, cwd=root,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.tasks = self._answer()

    def _answer(self):
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f'the worker ended with {self._process.wait()}')
        return json.loads(line)

    def time(self, task):
        """Return the CPU time of one call of a task [s]."""
        self._process.stdin.write(task + '\n')
        self._process.stdin.flush()
        return self._answer()

    def close(self):
        """End the process."""
        self._process.stdin.close()
        self._process.wait()


@contextmanager
def checkout(commit, directory):
    """Give a commit, or ``'.'`` for the files as they are, a directory that may be its own."""
    if commit == '.':
        yield ROOT
        return
    subprocess.run(['git', 'worktree', 'add', '--quiet', '--detach', str(directory), commit],
                   cwd=ROOT, check=True)
    try:
        if (directory / 'scripts' / 'build').exists():
            subprocess.run([str(directory / 'scripts' / 'build')], check=True)
        yield directory
    finally:
        subprocess.run(['git', 'worktree', 'remove', '--force', str(directory)], cwd=ROOT,
                       check=True)


def name_of(commit):
    """Return the abbreviated hash of a commit, or the dot."""
    if commit == '.':
        return '.'
    return subprocess.run(['git', 'rev-parse', '--short', commit], cwd=ROOT, check=True,
                          capture_output=True, text=True).stdout.strip()


def compare(before, after, rounds, tasks=()):
    """
    Time the tasks that both commits know, or these alone, so many rounds.

    Returns what is written to the JSON file.
    """
    names = [name_of(commit) for commit in (before, after)]
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(scratch)
        with checkout(before, scratch / 'before') as first, \
                checkout(after, scratch / 'after') as second:
            workers = [Worker(first, scratch / 'cache_before', tasks),
                       Worker(second, scratch / 'cache_after', tasks)]
            common = [task for task in workers[0].tasks if task in workers[1].tasks]
            times = {task: ([], []) for task in common}
            for number in range(rounds):
                for task in common:
                    # Whoever runs first in one round runs last in the next.
                    for k in ((0, 1), (1, 0))[number % 2]:
                        times[task][k].append(workers[k].time(task))
            for worker in workers:
                worker.close()
    return {'machine': description(), 'commits': names, 'times': times}


def summary(result):
    """Return, for each task, both medians and the ratio with its quartiles over the rounds."""
    rows = {}
    for task, (before, after) in result['times'].items():
        ratios = [b / a for a, b in zip(before, after)]
        low, middle, high = statistics.quantiles(ratios, n=4)
        verdict = ''
        if low > 1.0 and middle > 1.0 + NOTICED:
            verdict = 'slower'
        elif high < 1.0 and middle < 1.0 - NOTICED:
            verdict = 'faster'
        rows[task] = {'before': statistics.median(before), 'after': statistics.median(after),
                      'ratio': middle, 'low': low, 'high': high, 'verdict': verdict}
    return rows


def report(result):
    """Return the summary as text."""
    before, after = result['commits']
    lines = [result['machine'], '',
             f'{"task":34}{before:>12}{after:>12}   ratio (quartiles)']
    for task, row in summary(result).items():
        lines.append(f'{task:34}{1e6 * row["before"]:9.2f} us{1e6 * row["after"]:9.2f} us   '
                     f'{row["ratio"]:.3f} ({row["low"]:.3f} to {row["high"]:.3f}) '
                     f'{row["verdict"]}'.rstrip())
    return '\n'.join(lines)


def main(arguments=None):
    """Run the comparison; the exit code is 1 where anything has become slower."""
    parser = parser_of(__doc__, 'few rounds')
    parser.add_argument('before', help='a commit')
    parser.add_argument('after', nargs='?', default='.',
                        help='another one (default: the files as they are)')
    parser.add_argument('--task', action='append', default=[],
                        help='this task alone; may be repeated')
    parser.add_argument('--output', type=Path, metavar='FILE',
                        help='store the results as JSON')
    options = parser.parse_args(arguments)
    result = compare(options.before, options.after,
                     QUICK_ROUNDS if options.quick else ROUNDS, options.task)
    if options.output:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(json.dumps({**result, 'summary': summary(result)}, indent=1))
    print(report(result))
    return int(any(row['verdict'] == 'slower' for row in summary(result).values()))


if __name__ == '__main__':
    sys.exit(main())
