# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Bags with flipped, zeroed, doubled and missing bytes: an error, or the damage is reported.

Every case runs the reader and the reader of ``closedloop replay`` in
this process. *Silent* is a case where messages are lost or altered and nothing says so. Of a
recording that was killed, a shorter one is as one that was killed earlier; that it
was cut short is said in both cases.
"""

from collections import Counter
import random
import shutil
from test.recording.sample import QOS, STORE
import warnings

from closedloop_dynamics import load_scene, SceneError, Simulation
from closedloop_dynamics.recording.contents import Topic
from closedloop_dynamics.recording.errors import RecordingError
from closedloop_dynamics.recording.reading import Bag, BagReadError
from closedloop_dynamics.recording.recording import read_recording
from closedloop_dynamics.recording.writer import BagFiles
from closedloop_dynamics.scene.text import scene_text
import numpy as np
import pytest

STATES, CHUNK = 60, 10
VARIANTS = (('mcap', 'none', True), ('mcap', 'zstd', True), ('sqlite3', 'none', True),
            ('mcap', 'none', False), ('mcap', 'lz4', False), ('sqlite3', 'zstd', False))


def record(path, storage, compression, finished):
    """Record a simulation as the nodes do; return the bag as a list of its messages."""
    scene = load_scene('four_bar')
    simulation = Simulation(scene)
    files, channels = BagFiles(path, storage, compression), {}
    names = simulation.joint_names
    columns = ['stamp_sec', 'stamp_nanosec', 'index', 'jumps', 'simulated_time', *names,
               *(f'state.{k}' for k in range(len(simulation.state)))]

    def write(topic, kind, time, **values):
        if topic not in channels:
            definition, _ = STORE.generate_msgdef(kind, ros_version=2)
            channels[topic] = files.add_topic(
                Topic(topic, kind, definition, STORE.hash_rihs01(kind), tuple(QOS)))
        files.write(channels[topic], time, bytes(
            STORE.serialize_cdr(STORE.types[kind](**values), kind)))

    write('/scene', 'std_msgs/msg/String', 1, data=scene_text(scene, scene.effects, [], after=0))
    types = STORE.types
    for k in range(STATES):
        stamp = types['builtin_interfaces/msg/Time'](sec=k // 10, nanosec=k % 10 * 10 ** 8)
        write('/joint_states', 'sensor_msgs/msg/JointState', 10 * k + 2,
              header=types['std_msgs/msg/Header'](stamp=stamp, frame_id=''), name=list(names),
              position=simulation.position, velocity=simulation.velocity,
              effort=simulation.effort)
        label = types['std_msgs/msg/MultiArrayDimension'](
            label=' '.join(columns), size=len(columns), stride=len(columns))
        write('/replay_log', 'std_msgs/msg/Float64MultiArray', 10 * k + 3,
              layout=types['std_msgs/msg/MultiArrayLayout'](dim=[label], data_offset=0),
              data=np.concatenate(([stamp.sec, stamp.nanosec, k + 1, 0, simulation.time],
                                   np.zeros(len(names)), simulation.state)))
        simulation.advance(np.zeros(len(names)), 10)
        if k % CHUNK == CHUNK - 1:
            files.flush()
    files.close()
    if not finished:
        (path / 'metadata.yaml').unlink()
        if storage == 'mcap':
            file, = path.glob('*.mcap')
            with open(file, 'rb') as content:
                data = content.read()
            # Behind the last chunk and its index.
            file.write_bytes(data[:data.rindex(b'\x0c', 0, data.rindex(b'rosbag2_bagfile')
                                               if b'rosbag2_bagfile' in data
                                               else data.rindex(b'serialized_metadata'))])
    return [(message.topic.name, message.time, message.data)
            for message in Bag(path).serialised()]


def spoil(path, chance):
    """Damage one file of a bag; return what was done."""
    file = chance.choice(sorted(each for each in path.iterdir() if each.is_file()))
    data = bytearray(file.read_bytes())
    kind = chance.choice(('flip', 'flips', 'cut', 'zero', 'double', 'remove'))
    place, size = chance.randrange(len(data)), chance.choice((1, 8, 300, 5000))
    if kind == 'flip':
        data[place] ^= 1 << chance.randrange(8)
    elif kind == 'flips':
        for _ in range(8):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    elif kind == 'cut':
        del data[place:]
    elif kind == 'zero':
        data[place:place + size] = bytes(len(data[place:place + size]))
    elif kind == 'double':
        data[place:place] = data[place:place + size]
    else:
        del data[place:place + size]
    file.write_bytes(data)
    return f'{kind} at {place} of {file.name}, {size}'


def outcome(path, original, finished):
    """Read, and read for a replay; return what became of it."""
    try:
        bag = Bag(path)
        found = [(message.topic.name, message.time, message.data)
                 for message in bag.serialised()]
        cut = not bag.finished and found == original[:len(found)]
        reported = bool(bag.damages) or (finished and not bag.finished)
        for _ in Bag(path).messages():
            pass
    except BagReadError:
        return 'error'
    with warnings.catch_warnings(record=True) as complaints:
        warnings.simplefilter('always')
        try:
            read_recording(path)
        except (RecordingError, SceneError, OSError):
            complaints.append('error')
    if found == original:
        return 'accepted'
    if not reported and not cut:
        return 'silent'
    # The replay reports what the reader does.
    return 'reported' if complaints or not bag.damages else 'silent'


@pytest.mark.parametrize('count', [
    2, pytest.param(100, marks=pytest.mark.slow)])
def test_damaged_bags_end_in_an_error_or_are_reported(tmp_path, capsys, count):
    results, worst = Counter(), []
    for number, variant in enumerate(VARIANTS):
        whole = tmp_path / f'whole_{number}'
        original = record(whole, *variant)
        assert len(original) == 2 * STATES + 1
        for case in range(count):
            chance = random.Random(1000 * number + case)
            path = tmp_path / 'bag'
            shutil.copytree(whole, path)
            done = spoil(path, chance)
            try:
                result = outcome(path, original, variant[2])
            except Exception as error:
                result = 'traceback'
                done += f': {type(error).__name__} {error}'
            results[result] += 1
            if result in ('traceback', 'silent'):
                worst.append(f'{variant}, case {case}: {done}: {result}')
            shutil.rmtree(path)
    capsys.readouterr()
    with capsys.disabled():
        print(f'\ndamaged bags: {results.total()} tried, {results["error"]} clean errors, '
              f'{results["accepted"]} accepted unharmed, {results["reported"]} accepted with the '
              f'damage reported, {results["traceback"]} tracebacks, {results["silent"]} silent')
    assert not worst, '\n'.join(worst)
