# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A recording of one simulator, from a bag or a CSV file of ``closedloop simulate``."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Optional

import numpy as np

from .errors import RecordingError
from .message_numbers import (
    constraint_force, NANOSECONDS, pose_numbers, stamp_of, twist_numbers, wrench_numbers)
from .rosbag2 import open_bag
from .rows import read_rows
from ..mechanism.mechanism import MechanismError
from ..scene.loading import SceneError
from ..scene.text import read_scene_text
from ..visual.trajectory import Trajectory, wrench_parts

STATES, FORCES, LOG, SCENE = 'joint_states', 'constraint_forces/', 'replay_log', 'scene'
# Topics of couplings and prescribed motions.
EFFORTS = ('coupling_forces', 'tooth_forces', 'motion_forces')
# Topic of joints with an orientation.
TURNED = 'multi_dof_joint_states'


@dataclass(frozen=True)
class Log:
    """Entries of ``replay_log``: one for each state, and for each command that changed between."""

    # Shape (n,): number of the entry, and of the resets and states set from outside before
    # it.
    index: np.ndarray
    jumps: np.ndarray
    time: np.ndarray  # Shape (n,): simulated [s]
    # Shape (n, nv), or more: commands that acted from the entry before to this one [N m or N],
    # those of cut joints that anything acts in behind those of the tree.
    torque: np.ndarray
    # Shape (n,): index of the state at that time in the motion; -1 where there is none.
    state: np.ndarray
    # Whole states, as ``Simulation.restore`` takes them; None in bags of earlier versions.
    whole: Optional[list] = None


@dataclass(frozen=True)
class Recording:
    """The states of one simulator."""

    # Its times are simulated ones where the log has them, otherwise those of the stamps
    # since the first; forces that were not recorded are NaN.
    motion: Trajectory
    scene: object = None  # Or None: as it was at the beginning; None where unknown
    # List of (Scene, dict): the scene at the beginning and after every change, with the
    # facts beside it.
    changes: list = field(default_factory=list)
    log: Optional[Log] = None
    finished: bool = True  # Whether the recording came to its end in order
    stamps: Optional[np.ndarray] = None  # Shape (n,): of the states [ns]; None for a CSV file
    # By topic, ``coupling_forces``, ``tooth_forces`` and ``motion_forces``, and by name: arrays of
    # shape (n,), NaN where nothing was recorded; as ``Simulation.equation_forces``.
    efforts: dict = field(default_factory=dict)


def read_recording(path, scene=None, namespace=None):
    """
    Read a bag, one of its files, or the CSV file of a run.

    ``scene`` is needed where the recording does not hold it, ``namespace`` where several
    simulators are in the bag. RecordingError where states or the scene are not in it; OSError.
    """
    path = Path(path)
    if path.suffix == '.csv':
        return Recording(*read_rows(path, scene))
    return _read_bag(path, scene, namespace)


def since_the_last_reset(motion):
    """Return the part of a motion since time last went back, each instant once."""
    steps = np.diff(motion.time)
    backwards = np.flatnonzero(steps < 0.0)
    kept = np.concatenate([[True], steps != 0.0])
    kept[:backwards[-1] + 1 if len(backwards) else 0] = False
    return motion.part(kept)


def _read_bag(path, scene, namespace):
    bag = open_bag(path)
    messages = {}
    for topic, _, message in bag.messages(_of_interest):
        messages.setdefault(topic, []).append(message)
    bag.warn()
    try:
        return _recording(path, messages, scene, namespace, bag.finished)
    except (RecordingError, SceneError, MechanismError):
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise RecordingError(f'{path}: its topics are not those of closedloop_simulator, or '
                             f'damaged ({" ".join(str(error).split())})') from None


def _recording(path, messages, scene, namespace, finished):
    """Make a recording of the messages of a bag."""
    prefix = _prefix(path, messages, namespace)
    states = messages[prefix + STATES]
    changes = [read_scene_text(message.data) for message in messages.get(prefix + SCENE, [])]
    scene = scene or (changes[0][0] if changes else None)
    if scene is None:
        raise RecordingError(
            f"{path}: the topic 'scene' is not in it, which names what was simulated; add --scene")
    stamps = [stamp_of(message) for message in states]
    mechanism, order = scene.mechanism, _order(path, states[0], scene)
    log, rows = _log(messages.get(prefix + LOG, []), [facts for _, facts in changes], mechanism,
                     stamps)
    values = [np.array([getattr(states[row], name) for row in rows])[:, order]
              for name in ('position', 'velocity', 'effort')]
    time = (log.time[log.state >= 0] if log
            else (np.array(stamps) - stamps[0]) * 1e-9)
    stamps = [stamps[row] for row in rows]
    if mechanism.coordinates.with_orientation:
        values = _with_orientations(
            path, messages.get(prefix + TURNED, []), mechanism, stamps, values)
    forces = _forces(messages, prefix + FORCES, mechanism, stamps)
    efforts = {topic: _efforts(messages[prefix + topic], stamps)
               for topic in EFFORTS if prefix + topic in messages}
    return Recording(Trajectory(mechanism, time, *values, forces), scene, changes, log, finished,
                     np.array(stamps), efforts)


def _of_interest(topic):
    *_, parent, name = ('', *topic.split('/'))
    return name in (STATES, TURNED, LOG, SCENE, *EFFORTS) or f'{parent}/' == FORCES


def _prefix(path, messages, namespace):
    """Return the prefix of the simulator's topics."""
    found = sorted(topic.removesuffix(STATES) for topic in messages
                   if topic.endswith(f'/{STATES}'))
    if not found:
        raise RecordingError(f"{path}: there are no messages of '{STATES}' in it")
    if namespace is not None:
        prefix = f'/{namespace.strip("/")}/'.replace('//', '/')
        if prefix not in found:
            raise RecordingError(f"{path}: expected a namespace of {', '.join(found)}; got "
                                 f"'{namespace}'")
        return prefix
    if len(found) > 1:
        raise RecordingError(
            f'{path}: there are several simulators in it; choose one with --namespace: '
            f'{", ".join(found)}')
    return found[0]


def _order(path, state, scene):
    """Return where the joints of the mechanism are in the states."""
    names, coordinates = list(state.name), scene.mechanism.coordinates
    expected = [coordinates.names[place] for place in coordinates.single]
    known = set(scene.mechanism.measured_cuts)
    if sorted(set(names) - known) != sorted(expected) or len(set(names)) != len(names):
        raise RecordingError(
            f'{path}: expected the joints of {scene.mechanism.name} '
            f'({", ".join(expected)}), got {", ".join(names)}')
    return [names.index(name) for name in expected]


def _with_orientations(path, entries, mechanism, stamps, values):
    """Return positions, velocities and efforts of all joints; NaN where none were recorded."""
    coordinates, cut = mechanism.coordinates, mechanism.cut_coordinates.with_orientation
    count, known = len(stamps), coordinates.with_orientation
    whole = [np.full((count, size), np.nan) for size in (
        coordinates.nq, coordinates.nv, coordinates.nv)]
    single = coordinates.single
    for out, given, places in zip(whole, values, (coordinates.place[single], single, single)):
        out[:, places] = given
    for row, entry in _matched(stamps, [stamp_of(message) for message in entries]):
        message = entries[entry]
        names = list(message.joint_names)
        if sorted(set(names) - set(cut)) != sorted(known) or len(set(names)) != len(names):
            raise RecordingError(
                f'{path}: expected the joints {", ".join(known)} in {TURNED}, got '
                f'{", ".join(names)}')
        for out, places, given in zip(
                whole, (coordinates.pose, coordinates.twist, coordinates.twist),
                (map(pose_numbers, message.transforms), map(twist_numbers, message.twist),
                 map(wrench_numbers, message.wrench))):
            for joint, numbers in zip(names, given):
                if joint in known:
                    where = places[known.index(joint)]
                    out[row, where[where >= 0]] = np.array(numbers)[where >= 0]
    return whole


def _columns(entries, facts):
    """Return the names of the first numbers of the log's entries; None where nothing has them."""
    if entries and entries[0].layout.dim:
        # In bags of earlier versions every entry names all.
        return [name for name in entries[0].layout.dim[0].label.split()
                if not name.startswith('state.')]
    return facts[0].get('columns') if entries and facts else None


def _log(entries, facts, mechanism, stamps):
    """Return the log of the states, and which states have an entry; no log: all of them."""
    columns = _columns(entries, facts)
    if columns is None:
        return None, range(len(stamps))
    place = {name: columns.index(name) for name in columns}
    try:
        joints = [place[name] for name in mechanism.coordinates.names]
        joints += [place[name] for name in mechanism.cut_coordinates.names if name in place]
    except KeyError as error:
        raise RecordingError(f'the replay_log is of another mechanism: no joint {error}') from None
    behind = max(joints) + 1
    table = np.array([entry.data[:behind] for entry in entries])
    log_stamps = [int(second) * NANOSECONDS + int(nanosecond) for second, nanosecond in (
        table[:, [place['stamp_sec'], place['stamp_nanosec']]])]
    # In the order of the log: entry and state.
    pairs = list(_matched(log_stamps, stamps))
    if not pairs:
        return None, range(len(stamps))
    state = np.full(len(table), -1)
    chosen, rows = zip(*pairs)
    state[list(chosen)] = np.arange(len(rows))
    return Log(table[:, place['index']].astype(int), table[:, place['jumps']].astype(int),
               table[:, place['simulated_time']], table[:, joints], state,
               [np.array(entry.data[behind:]) for entry in entries]
               if behind < len(entries[0].data) else None), rows


def _forces(messages, prefix, mechanism, stamps):
    parts = wrench_parts(mechanism)
    forces = np.full((len(stamps), len(mechanism.cut_joints), len(parts)), np.nan)
    for k, cut in enumerate(mechanism.cut_joints):
        entries = messages.get(prefix + cut.name, [])
        for row, entry in _matched(stamps, [stamp_of(message) for message in entries]):
            forces[row, k] = constraint_force(entries[entry].wrench, mechanism.planar)
    return forces


def _efforts(entries, stamps):
    """Return the efforts of other topics than the joints', by name."""
    found = {}
    for row, entry in _matched(stamps, [stamp_of(message) for message in entries]):
        for name, effort in zip(entries[entry].name, entries[entry].effort):
            found.setdefault(name, np.full(len(stamps), np.nan))[row] = effort
    return found


def _matched(stamps, others):
    """
    Yield pairs of indices of equal stamps.

    Stamps may come back: in simulated time they stand still in a pause, and begin again after
    a reset. The first of the one belongs to the first of the other then.
    """
    rows_of = {}
    for row, stamp in enumerate(others):
        rows_of.setdefault(stamp, deque()).append(row)
    for row, stamp in enumerate(stamps):
        if rows_of.get(stamp):
            yield row, rows_of[stamp].popleft()
