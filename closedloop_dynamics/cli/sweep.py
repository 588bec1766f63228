# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop sweep``: many simulations with different numbers, into one file."""

from argparse import ArgumentTypeError
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .command import (
    Argument, Command, FAILED, Group, interrupted, mapping, OneOf, OVERWRITE, positive,
    require_writable, SCENE, TORQUE, UsageError, whole)
from ..mechanism.fields import FieldError
from ..simulation.rollout_run import QUANTITIES, STATE
from ..simulation.signals import program_watch
from ..sweep import sweep
from ..sweep.plan import FORMS, parse
from ..sweep.storage import StorageError
from ..visual.progress import progress_bar

NOTHING = 'nothing'
MOST_REASONS = 5


def _address(text):
    """Return an address with a port."""
    if not text.rpartition(':')[2].isdecimal():
        raise ArgumentTypeError(
            f'expected an address with a port, such as tcp://192.0.2.1:8786, got {text!r}')
    return text


def _run(arguments):
    require_writable(Path(arguments.output).parent, '--output')
    keep = STATE if arguments.keep is None else tuple(
        dict.fromkeys(name for name in arguments.keep if name != NOTHING))
    with program_watch.noting() as received, _progress(arguments.scene) as show:
        try:
            outcome = sweep(
                arguments.scene, [parse(text) for text in arguments.vary], arguments.output,
                samples=arguments.samples, seed=arguments.seed, duration=arguments.duration,
                rate=arguments.rate, torque=mapping(arguments.torque, '--torque'),
                torques=_sequences(arguments.torques), keep=keep, resume=arguments.resume,
                overwrite=arguments.overwrite, workers=arguments.workers,
                scheduler=arguments.scheduler, on_progress=show,
                keep_going=lambda: not received)
        except FieldError as error:
            option = str(error).partition(':')[0]
            raise UsageError(
                f'--{error}' if option in vars(arguments) else f'--vary: {error}') from None
        except StorageError as error:
            raise UsageError(str(error)) from None
    print(_summary(outcome, arguments))
    if received:
        return interrupted(arguments, received[0], resumable=True)
    return FAILED if outcome.failed == outcome.done > 0 else 0


@contextmanager
def _progress(name):
    """Yield a function that shows how far the sweep is, by its ``Outcome``."""
    with progress_bar(1, 'samples', name) as bar:
        def show(outcome):
            bar.total = outcome.samples
            if outcome.failed:
                bar.set_description(f'{name} ({outcome.failed} failed)', refresh=False)
            bar.update(outcome.before + outcome.done - bar.n)

        yield show


def _sequences(path):
    """Return the array of a file, or None."""
    if path is None:
        return None
    try:
        return np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise UsageError(f'--torques: expected a file of one array, as numpy.save writes it, got '
                         f'{path}: {getattr(error, "strerror", None) or error}') from None


def _summary(outcome, arguments):
    there = outcome.before + outcome.done
    lines = [f'{arguments.output}: {there} of {outcome.samples} samples'
             + (f', {outcome.before} of them from before' if outcome.before else '')]
    if outcome.failed:
        lines.append(f'  failed    {outcome.failed} of {outcome.done}; the file says why of each:')
        lines += [f'  {count:8}  {reason}'
                  for reason, count in outcome.reasons.most_common(MOST_REASONS)]
        rest = len(outcome.reasons) - MOST_REASONS
        lines += [f'            and {rest} other reasons'] if rest > 0 else []
    return '\n'.join(lines)


COMMAND = Command(
    name='sweep',
    summary='run a scene many times with different numbers, into one file',
    description="""\
Simulate a scene many times: with different masses, lengths, effects, starts,
methods or torques, in parallel. Any number of the scene and its mechanism is
varied by its key path, as it stands in the files:

  mechanism.bodies.crank.mass       mechanism.joints.elbow.position.0
  effects.gravity.acceleration.1    initial.velocity.theta_1
  method.step_size                  torque.theta_1 (a constant torque)

Values are FROM:TO:COUNT (evenly spaced, both included) or VALUE,VALUE,...: several
such keys span a grid. Or they are drawn, --samples times at each point of the
grid: uniform:FROM:TO, loguniform:FROM:TO, normal:MEAN:DEVIATION.

A sample that fails is marked so, with its reason, and stops nothing. Ctrl-C
leaves a valid file, which --resume goes on with; the same command gives the same
numbers, however often it was interrupted and wherever it runs. doc/sweep.md states what
is in the file.
""",
    examples=(
        'sweep four_bar --vary mechanism.bodies.crank.mass=0.5:2:4 --output mass.nc',
        'sweep three_rrr --vary mechanism.bodies.platform.mass=normal:8:0.4 '
        '--vary torque.theta_1=0,5 --samples 500 --seed 7 --output monte_carlo.zarr'),
    failure='no sample succeeded',
    arguments=(
        SCENE,
        Argument('--output', required=True, metavar='FILE',
                 help='where the results go: FILE.nc (NetCDF) or FILE.zarr'),
        Group(
            'what is varied',
            Argument('--vary', action='append', default=[], metavar='KEY=VALUES',
                     help=f'a number of the scene or its mechanism by its key path, and {FORMS}; '
                          'may be repeated'),
            Argument('--samples', type=whole(), default=1, metavar='N',
                     help='draws from the distributions, at each point of the grid (default: 1)'),
            Argument('--seed', type=whole(), default=0, metavar='N',
                     help='of the draws; the same seed draws the same (default: 0)')),
        Group(
            'what is run',
            Argument('--duration', type=positive, default=2.0, metavar='SECONDS',
                     help='simulated time of each sample (default: 2)'),
            TORQUE,
            Argument('--torques', metavar='FILE.npy',
                     help='sequences of torques instead: an array of NumPy of shape (rows, '
                          'actuated joints) or (samples, rows, actuated joints); the rows act '
                          'for equal parts of the duration')),
        Group(
            'what is kept',
            Argument('--rate', type=positive, default=100.0, metavar='HZ',
                     help='instants per simulated second that are kept or looked at (default: '
                          '100)'),
            Argument('--keep', action='append', choices=(*QUANTITIES, NOTHING),
                     metavar='QUANTITY',
                     help='of every instant, beside the final values and the peaks, which are '
                          f'always kept: {", ".join(QUANTITIES)}, or {NOTHING}; may be repeated '
                          f'(default: {", ".join(STATE)})'),
            OneOf(
                Argument('--resume', action='store_true',
                         help='go on where the file ends, if there is one'),
                OVERWRITE)),
        Group(
            'where it is computed',
            Argument('--workers', type=whole(), metavar='N',
                     help='processes on this machine (default: one for each processor, as soon '
                          'as there is enough to do)'),
            Argument('--scheduler', type=_address, metavar='ADDRESS',
                     help='scheduler of a Dask cluster to compute on instead, such as '
                          'tcp://192.0.2.1:8786'))),
    run=_run)
