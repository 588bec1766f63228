# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop estimate``: states, joint forces and loads from a record of sensors."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np

from .command import (
    Argument, Command, complain, OVERWRITE, picture_option, require_free, SET, UsageError,
    with_numbers)
from ..estimation.errors import EstimationError
from ..recording.errors import BagReadError, RecordingError
from ..scene.loading import load_scene
from ..simulation.model import Model
from ..visual.progress import announced, progress_bar
from ..visual.tables import write_csv


def _run(arguments):
    # Only here, as in the functions below: SciPy takes long to load.
    from ..estimation.record_file import begun, read_events, record_of, without_latency
    from ..estimation.setup_file import read_setup, SetupError
    from ..estimation.start_finder import StartFinder
    if arguments.output is not None:
        if arguments.output.suffix != '.csv' and arguments.output.exists():
            raise UsageError(f'--output: {arguments.output} exists; name another bag')
        require_free(arguments, arguments.output)
    scene = with_numbers(load_scene(arguments.scene), arguments)
    try:
        with announced('Reading and compiling ...'):
            setup = read_setup(arguments.sensors, scene)
            events = read_events(
                arguments.recording, setup, scene.mechanism, arguments.namespace)
            setup = without_latency(setup)
            model = Model(scene)
            start, events = begun(events, StartFinder(setup, model))
            record = record_of(events, setup, scene.mechanism, start.time)
        # Forces, points and their deviations take as long as the filter.
        each = arguments.output is not None or arguments.picture is not None
        wanted = range(0 if each else len(record.times) - 1, len(record.times))
        found = (_filtered if arguments.filter else _smoothed)(
            setup, model, record, start, wanted)
        return _report(arguments, scene, setup, events, record, *found)
    except EstimationError as error:
        return complain(arguments, error)
    except (SetupError, RecordingError, BagReadError, ValueError) as error:
        raise UsageError(str(error)) from None


def _smoothed(setup, model, record, start, wanted):
    """Return estimates at some times from the whole record, by index, consistency and alarms."""
    from ..estimation.smoothing import smooth
    with progress_bar(1.0, 'of the record', 'smoothing') as bar:
        found = smooth(model, setup.sensors, record, setup.unknowns, setup.noise, start,
                       method=setup.method, suspects=setup.suspects,
                       gate=setup.gate, progress=lambda done: bar.update(done - bar.n))
    return zip(wanted, map(found.estimate, wanted)), found.consistency, found.alarms


def _filtered(setup, model, record, start, wanted):
    """Return the same from what was measured up to each time, as the node estimates."""
    from ..estimation.estimator import Estimator
    estimator = Estimator(model, setup.sensors, setup.unknowns, setup.noise, start, setup.method,
                          suspects=setup.suspects, gate=setup.gate)
    estimates = []
    with progress_bar(len(record.times), 'instants', 'filtering') as bar:
        for k, time in enumerate(record.times):
            readings = record.rows(k)
            if readings:
                estimator.measure_all(time, readings)
            estimator.advance(time)
            # From now on.
            estimator.command(time, record.torques[k])
            if k in wanted:
                estimates.append((k, estimator.estimate()))
            bar.update()
    return estimates, estimator.consistency, estimator.alarms


def _report(arguments, scene, setup, events, record, estimates, consistency, alarms):
    """Write the files, print the tables; return the exit code."""
    from ..estimation.report import columns, DEVIATION, EstimateBag, sensors_table, unknowns_table
    rows, names, estimate = [], [], None
    to_bag = arguments.output is not None and arguments.output.suffix != '.csv'
    with EstimateBag(arguments.output, scene.mechanism, setup.unknowns) if to_bag else (
            nullcontext()) as bag, progress_bar(len(record.times), 'instants', scene.name) as bar:
        for k, estimate in estimates:
            names, *numbers = columns(estimate, scene.mechanism)
            rows.append(numbers)
            if to_bag:
                bag.write(events.begin + round(1e9 * record.times[k]), estimate)
            bar.update(k + 1 - bar.n)
    if arguments.output is not None and not to_bag:
        write_csv(arguments.output, ['time', *names, *(name + DEVIATION for name in names)], [
            [float(value) for value in (time, *np.ravel(numbers))]
            for time, numbers in zip(record.times, rows)])
    first, last = record.times[[0, -1]]
    print(f'{arguments.recording}: {len(record.times)} instants of {scene.name}, '
          f'{last - first:.6g} s')
    unobservable = []
    if setup.unknowns:
        table, unobservable = unknowns_table(estimate, setup.unknowns)
        print(table)
    print(sensors_table(consistency))
    for alarm in alarms:
        print(f'at {alarm.time:.4g} s: {alarm.message}')
    if arguments.picture is not None:
        _draw(arguments, scene, setup.unknowns, record.times, names, np.array(rows))
        print(f'picture in {arguments.picture}')
    if arguments.output is not None:
        print(f'estimates in {arguments.output}')
    if len(unobservable) == len(estimate.unknowns.names) > 0:
        return complain(arguments, 'nothing of what is unknown can be estimated from this record '
                        f'({", ".join(unobservable)}): does the machine move in it?')
    wrong = [name for name, one in consistency.sensors.items() if not one.consistent]
    if alarms or wrong:
        return complain(arguments, 'the record does not fit the model and its noise: ' + (
            '; '.join(alarm.message for alarm in alarms) or f'mean NIS of {", ".join(wrong)}'))
    print('the record is consistent with the model')
    return 0


def _draw(arguments, scene, unknowns, times, names, rows):
    # Only here, as it takes long to load.
    from ..visual.pictures import bands
    curves = {f'{name} [{one.UNIT}]': [name] for one in unknowns for name in one.components}
    driven = scene.mechanism.actuated_joints
    cuts = tuple(f'force.{cut.name}.' for cut in scene.mechanism.cut_joints)
    curves['rates of the drives [rad/s, m/s]'] = [
        name for name in names if name.removeprefix('velocity.') in driven]
    curves['forces in cut joints [N, N m]'] = [name for name in names if name.startswith(cuts)]
    bands({title: {name: (times, *rows[:, :, names.index(name)].T) for name in some}
           for title, some in curves.items() if some},
          'time [s]', f'{scene.name}: estimates, with two standard deviations').savefig(
        arguments.picture)


COMMAND = Command(
    name='estimate',
    summary='states, joint forces and loads from a record of sensors',
    description="""\
Read what sensors measured, from a bag or a CSV file, and estimate the motion of the whole
mechanism, the forces in its joints and what is unknown (loads, friction, lengths, errors of
sensors), each with a standard deviation. Each instant is estimated from the whole record (a
smoother); with --filter from what was measured up to then, as closedloop_estimator does live.
""",
    examples=(
        'estimate my_bag --scene three_rrr --sensors sensors.yaml --picture estimates.png',
        'estimate run.csv --scene four_bar --sensors sensors.yaml --output estimates.csv'),
    failure='the record does not fit the model and its noise, or does not show an unknown',
    arguments=(
        Argument('recording', metavar='BAG_OR_CSV',
                 help='a bag, or a CSV file with a column for each number'),
        Argument('--scene', metavar='SCENE', required=True,
                 help='the mechanism as far as it is known: a shipped scene by its name, or a '
                      'YAML file'),
        Argument('--sensors', metavar='FILE', type=Path, required=True,
                 help='YAML file of sensors, unknowns and noise (doc/estimation.md)'),
        SET,
        Argument('--filter', action='store_true',
                 help='estimate each instant from what was measured up to then'),
        Argument('--namespace', metavar='NAME', help='of the topics in the bag'),
        picture_option('unknowns, rates and forces with their bands'),
        Argument('--output', metavar='BAG_OR_CSV', type=Path,
                 help='a new bag with the topics of closedloop_estimator, or a file *.csv with '
                      'all numbers and their standard deviations'),
        OVERWRITE),
    run=_run)
