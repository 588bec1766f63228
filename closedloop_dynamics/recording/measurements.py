# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Motion and efforts of measured joints, from a recording, for identification.

A CSV file of ``closedloop simulate`` has accelerations. A bag has none: between two states they
are, on average, the change of rates over the time between, and belong to the state half way, which
is that of a cubic polynomial through positions and rates. The efforts are averages over the same
time: of the commands in ``replay_log`` where it is in the bag and no drive changes them, otherwise
of the efforts at both ends. Noisy positions take splines as smooth as their deviation allows.
"""

from pathlib import Path
from typing import Dict, NamedTuple

import numpy as np

from .errors import RecordingError
from .forces import DEGREE, smooth
from .recording import read_recording
from .rows import read_table

QUANTITIES = ('position', 'velocity', 'acceleration')


class Measurements(NamedTuple):
    """
    Measured motion and efforts of a mechanism.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s].
    motion : dict of str to ndarray, shape (3, n)
        Positions, rates and accelerations by joint [rad or m, and per s and s^2].
    effort : dict of str to ndarray, shape (n,)
        By joint [N m or N].
    others : dict of str to ndarray, shape (n,)
        Positions of joints that are recorded, too [rad or m].

    """

    time: np.ndarray
    motion: Dict[str, np.ndarray]
    effort: Dict[str, np.ndarray]
    others: Dict[str, np.ndarray]


def read_measurements(path, scene, joints, driven, deviation=0.0, namespace=None):
    """
    Read the motion of joints and the efforts of drives from a bag or a CSV file.

    Parameters
    ----------
    path : path-like
        Directory of a bag, one of its files, or a CSV file.
    scene : scene_records.Scene
        Whose joints these are; its numbers may be others than those of the recording.
    joints : sequence of str
        Measured joints of the tree, of one number each.
    driven : sequence of str
        Joints of the tree whose efforts are wanted.
    deviation : float
        Standard deviation of a position: rates and accelerations are those of splines as smooth as
        it allows [rad or m]; 0: recorded ones are taken as they are.
    namespace : str, optional
        Of the simulator, where several are in a bag.

    Returns
    -------
    Measurements

    Raises
    ------
    RecordingError
        Where something is not in it, or too few rows are.
    OSError
        Where it cannot be read.

    """
    path, coordinates = Path(path), scene.mechanism.coordinates
    for name in joints:
        if name not in coordinates.single_names:
            raise RecordingError(
                f'{name}: expected a joint of the tree that has one number, one of '
                f'{", ".join(coordinates.single_names)}')
    if path.suffix == '.csv':
        time, values, effort = _rows(path, coordinates, joints, driven, deviation)
    else:
        time, values, effort = between_states(
            path, read_recording(path, scene, namespace), scene, driven)
    if (deviation > 0.0 or 'acceleration' not in values) and len(time) <= DEGREE + 1:
        raise RecordingError(f'{path}: expected more than {DEGREE + 1} states, got {len(time)}')
    motion = {}
    for name in joints:
        places = values['position'][name]
        length = coordinates.lengths[coordinates.index[name]]
        unwound = places if length else np.unwrap(places)
        if deviation > 0.0:
            motion[name] = smooth(time, unwound[:, np.newaxis], deviation)[:, :, 0]
        else:
            motion[name] = np.array([unwound, *(values[quantity][name]
                                                for quantity in QUANTITIES[1:])])
    others = {name: place for name, place in values['position'].items()
              if name in coordinates.single_names and name not in joints}
    return Measurements(time, motion, effort, others)


def _rows(path, coordinates, joints, driven, deviation):
    """Return times, quantities by name and joint, and efforts, of a CSV file."""
    needed = QUANTITIES[:1] if deviation > 0.0 else QUANTITIES

    def require(names):
        wanted = ['time', *(f'{quantity}.{name}' for name in joints for quantity in needed),
                  *(f'effort.{name}' for name in driven)]
        missing = [name for name in wanted if name not in names]
        if missing:
            raise RecordingError(
                f'{path}: expected the columns {", ".join(wanted)}, as `closedloop simulate '
                f'--output` writes them; {missing[0]} is missing' + (
                    '; with --deviation positions and efforts do'
                    if missing[0].split('.')[0] in QUANTITIES[1:] else ''))

    names, table = read_table(path, require)
    column = dict(zip(names, table.T))
    used = [column[name] for name in names if name.split('.')[0] in (
        'time', 'effort', *needed)]
    if not np.isfinite(used).all():
        raise RecordingError(f'{path}: expected finite numbers in every row')
    if (np.diff(column['time']) <= 0.0).any():
        raise RecordingError(f'{path}: expected a time that increases from row to row')
    values = {quantity: {name: column[f'{quantity}.{name}'] for name in coordinates.single_names
                         if f'{quantity}.{name}' in column} for quantity in QUANTITIES}
    return column['time'], values, {name: column[f'effort.{name}'] for name in driven}


def between_states(path, recording, scene, driven):
    """
    Return measurements half way between the states of a bag.

    Times [s], shape (n,); by quantity and joint values [rad or m, and per s and s^2]; efforts by
    joint [N m or N]. ``path`` is for messages. RecordingError where there are no two states
    between which nothing is missing.
    """
    motion, coordinates = recording.motion, scene.mechanism.coordinates
    step = np.diff(motion.time)
    places = [coordinates.index[name] for name in driven]
    effort = 0.5 * (motion.effort[1:, places] + motion.effort[:-1, places])
    drives = any(record.drive() is not None for record in scene.effects.values())
    whole = step > 0.0
    if recording.log is not None:
        held, whole = _held(recording.log, len(motion.time), step)
        if not drives:
            effort = held[:, places]
    q, qd = motion.position, motion.velocity
    single, at = coordinates.single, coordinates.place[coordinates.single]
    before, after = q[:-1, at], q[1:, at]
    turns = ~coordinates.lengths[single]
    change = after - before
    change[:, turns] = (change[:, turns] + np.pi) % (2.0 * np.pi) - np.pi
    first, last = qd[:-1, single], qd[1:, single]
    with np.errstate(divide='ignore', invalid='ignore'):
        size = step[:, np.newaxis]
        found = (before + 0.5 * change + size * (first - last) / 8.0,
                 1.5 * change / size - 0.25 * (first + last), (last - first) / size)
    whole &= np.isfinite(effort).all(axis=1) & np.isfinite(found).all(axis=(0, 2))
    if not whole.any():
        raise RecordingError(f'{path}: expected states one after the other, got none')
    names = coordinates.single_names
    values = {quantity: {name: each[whole, k] for k, name in enumerate(names)}
              for quantity, each in zip(QUANTITIES, found)}
    return (0.5 * (motion.time[1:] + motion.time[:-1]))[whole], values, {
        name: effort[whole, k] for k, name in enumerate(driven)}


def _held(log, states, step):
    """
    Return the commands on average between states, and between which states nothing is missing.

    Shapes (states - 1, columns) and (states - 1,).
    """
    held, whole = np.full((states - 1, log.torque.shape[1]), np.nan), np.zeros(
        states - 1, dtype=bool)
    entries = np.flatnonzero(log.state >= 0)
    for first, last in zip(entries, entries[1:]):
        k = log.state[first]
        between = slice(first + 1, last + 1)
        durations = np.diff(log.time[first:last + 1])
        whole[k] = (step[k] > 0.0 and log.state[last] == k + 1 and (durations >= 0.0).all()
                    and log.jumps[first] == log.jumps[last]
                    and log.index[last] - log.index[first] == last - first)
        if whole[k]:
            held[k] = durations @ log.torque[between] / step[k]
    return held, whole
