# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Measurements and torques from a bag, or from a CSV file with a column for each number."""

from dataclasses import replace
from pathlib import Path
from typing import List, NamedTuple, Tuple
import warnings

import numpy as np

from .results import Record
from .setup_file import COMMAND, EFFORT
from .streams import columns, STATES, StreamError, Streams
from ..mechanism.fields import among
from ..recording.errors import RecordingError
from ..recording.message_numbers import stamp_of
from ..recording.rosbag2 import open_bag
from ..recording.rows import read_table

COMMANDS = 'torque_command'
# Time that goes back by more begins another run [s].
BACK = 1.0


class Events(NamedTuple):
    """
    What was measured and commanded, in the order of time.

    Attributes
    ----------
    begin : int
        Stamp of time zero [ns].
    measurements : list of tuples (time, sensor, value)
        When it was true, by the latency of the sensor [s]; names; tuples of float.
    commands : list of tuples (time, torques)
        From when on [s]; by actuated joint [N m or N].

    """

    begin: int
    measurements: List[Tuple[float, str, tuple]]
    commands: List[Tuple[float, dict]]


def read_events(path, setup, mechanism, namespace=None):
    """
    Read what sensors measured, and the torques meanwhile.

    Parameters
    ----------
    path : path-like
        Directory of a bag, one of its files, or a CSV file.
    setup : setup_file.Setup
        Its sensors are looked for.
    mechanism : mechanism.mechanism.Mechanism
        Whose joints these are.
    namespace : str, optional
        Of the topics in a bag.

    Returns
    -------
    Events

    Raises
    ------
    RecordingError
        Where nothing of it can be used.
    OSError
        Where it cannot be read.

    """
    path, streams = Path(path), Streams(setup, mechanism)
    if path.suffix == '.csv':
        events = _of_rows(path, setup, mechanism, streams)
    else:
        events = _of_bag(path, setup, mechanism, streams, namespace)
    latency = {sensor.name: sensor.latency for sensor in setup.sensors}
    events = events._replace(measurements=sorted(
        ((time - latency[name], name, values) for time, name, values in events.measurements),
        key=lambda one: one[0]))
    silent = set(latency) - {name for _, name, _ in events.measurements}
    if not events.measurements:
        raise RecordingError(f'{path}: no sensor has measured anything in it')
    for name in sorted(silent):
        warnings.warn(f'{path}: the sensor {name} has measured nothing')
    return events


def without_latency(setup):
    """Return a setup whose sensors hand over at once, as those of ``Events`` do."""
    return setup._replace(sensors=tuple(replace(one, latency=0.0) for one in setup.sensors))


def begun(events, start_finder):
    """Return the start that a ``StartFinder`` finds in events, and the events from it on."""
    readings, before = {}, None
    for time, name, values in events.measurements:
        if time != before and readings:
            start = start_finder.take(before, readings)
            if start is not None:
                return start, events._replace(
                    measurements=[one for one in events.measurements if one[0] >= time],
                    commands=events.commands)
            readings = {}
        readings[name], before = values, time
    raise RecordingError('expected readings at more instants, got too few to begin with')


def record_of(events, setup, mechanism, begin):
    """
    Return the ``Record`` of events.

    Its instants are where a run begins [s], and all later ones at which something was measured or
    commanded.
    """
    coordinates = mechanism.coordinates
    commanded = [coordinates.names[place] for place in coordinates.actuated]
    times = np.unique([begin, *(
        time for time, *_ in (*events.measurements, *events.commands) if time > begin)])
    given = np.full((len(times), len(commanded)), np.nan)
    for time, torques in events.commands:
        row = np.searchsorted(times, time)
        for name, value in torques.items():
            if name in commanded:
                given[row, commanded.index(name)] = value
    # Each holds until the next one, the first one before it, too.
    known = np.isfinite(given)
    rows = np.where(known, np.arange(len(times))[:, np.newaxis], known.argmax(axis=0))
    torques = np.nan_to_num(np.take_along_axis(
        given, np.maximum.accumulate(rows, axis=0), axis=0))
    measured = {}
    for sensor in setup.sensors:
        found = [(time, values) for time, name, values in events.measurements
                 if name == sensor.name]
        if found:
            table = measured[sensor.name] = np.full((len(times), len(found[0][1])), np.nan)
            table[np.searchsorted(times, [time for time, _ in found])] = [
                values for _, values in found]
    return Record(times, torques, measured)


def _of_bag(path, setup, mechanism, streams, namespace):
    prefix = f'/{(namespace or "").strip("/")}/'.replace('//', '/')
    topics = {prefix + topic if not topic.startswith('/') else topic: topic
              for topic in (*streams.topics, COMMANDS)}
    bag = open_bag(path)
    measurements, commands, newest, seen, refused, reason = [], [], None, set(), 0, ''
    for full, _, message in bag.messages(lambda topic: seen.add(topic) or topic in topics):
        topic = topics[full]
        try:
            if topic == COMMANDS:
                if setup.torques == COMMAND and newest is not None:
                    commands.append((newest, _torques(message.data, mechanism)))
                continue
            stamp = stamp_of(message)
            if newest is not None and stamp < newest - BACK * 1e9:
                back = (newest - stamp) * 1e-9
                warnings.warn(f'{path}: {full}: time goes back by {back:.3g} s; what was before '
                              'is left out')
                measurements, commands, newest = [], [], None
                streams.begin({})
            found = streams.measurements(topic, message)
            torques = streams.torques(message) if topic == STATES else {}
        except StreamError as error:
            refused, reason = refused + 1, f'{full}: {error}'
            continue
        measurements += [(stamp, name, values) for name, values in found]
        if torques and setup.torques == EFFORT:
            # What was exerted since the state before.
            commands.append((stamp if newest is None else min(newest, stamp), torques))
        if topic == STATES:
            newest = stamp if newest is None else max(newest, stamp)
    bag.warn()
    if refused:
        warnings.warn(f'{path}: {refused} messages are not used, the last one of {reason}')
    if not measurements:
        raise RecordingError(
            f'{path}: expected measurements on {", ".join(topics)}; the topics in it are '
            f'{among(sorted(seen)) or "none"}' + (f'; {reason}' if refused else ''))
    begin = min(time for time, *_ in measurements)
    return Events(
        begin, [((time - begin) * 1e-9, *rest) for time, *rest in measurements],
        sorted((((time - begin) * 1e-9, torques) for time, torques in commands),
               key=lambda one: one[0]))


def _torques(values, mechanism):
    names = mechanism.actuated_joints
    if len(values) != len(names) or not np.isfinite(values).all():
        raise StreamError(f'expected {len(names)} finite torques ({", ".join(names)}), got '
                          f'{list(values)}')
    return dict(zip(names, map(float, values)))


def _of_rows(path, setup, mechanism, streams):
    needed = {sensor.name: columns(sensor, mechanism.planar) for sensor in setup.sensors}
    # Names in the file are those of messages.
    others = {joint: name for name, joint in setup.names.items()}
    efforts = {f'effort.{others.get(name, name)}': name for name in mechanism.actuated_joints}

    def require(names):
        if 'time' not in names or not any(set(some) <= set(names) for some in needed.values()):
            raise RecordingError(
                f'{path}: expected the columns time and '
                f'{among([name for some in needed.values() for name in some])}, got '
                f'{among(names) or "none"}')

    names, table = read_table(path, require)
    column = dict(zip(names, table.T))
    for name, joint in setup.names.items():
        column.update({f'{kind}.{joint}': column[f'{kind}.{name}']
                       for kind in ('position', 'velocity', 'effort')
                       if f'{kind}.{name}' in column})
    times = column['time']
    if not np.isfinite(times).all() or (np.diff(times) <= 0.0).any():
        raise RecordingError(f'{path}: expected a time that increases from row to row')
    measurements = []
    for sensor in setup.sensors:
        if not set(needed[sensor.name]) <= set(column):
            continue
        for time, values in zip(times, np.transpose(
                [column[name] for name in needed[sensor.name]]).tolist()):
            if np.isinf(values).any():
                raise RecordingError(f'{path}: {sensor.name}: expected finite numbers, or nan '
                                     f'where nothing is measured, got {values} at t = {time:g} s')
            if not np.isnan(values).any():
                measurements.append((float(time - times[0]), sensor.name, (
                    streams.unwound(sensor, *values) if len(values) == 1 else tuple(values))))
    given = {name: joint for name, joint in efforts.items() if name in column}
    commands = [(float(times[max(k - 1, 0)] - times[0]), {
        joint: float(column[name][k]) for name, joint in given.items()
        if np.isfinite(column[name][k])}) for k in range(len(times))] if given else []
    return Events(round(times[0] * 1e9), measurements, commands)
