# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Bags stay readable: compressed, split, on a full disk, killed at any byte."""

import errno
import os
import resource
import signal
import subprocess
import sys
from test.recording.sample import add, TEXT, VALUES, values, write
from test.ros.bags import read_with_mcap, read_with_rosbags

from closedloop_dynamics.recording import writer
from closedloop_dynamics.recording.reading import Bag, BagReadError
from closedloop_dynamics.recording.writer import BagFiles, COMPRESSIONS, RESERVE
from mcap.reader import make_reader
import pytest
import yaml

KINDS = [(storage, compression) for storage, kinds in COMPRESSIONS.items()
         for compression in kinds]


def check(messages, count):
    """Check what was read of the first messages."""
    assert [message.data[0] for _, message in messages['/numbers']][:count] == [
        index / 3.0 for index in range(count)]
    assert [message.data for _, message in messages['/words']][:count] == [
        f'gr\u00fcezi {index}' for index in range(count)]
    assert [time for time, _ in messages['/words']][:count] == list(range(1000, 1000 + count))


def collected(bag):
    messages = {}
    for topic, nanoseconds, message in bag.messages():
        messages.setdefault(topic, []).append((nanoseconds, message))
    return messages


@pytest.mark.parametrize('storage, compression', KINDS)
def test_everything_comes_back(tmp_path, storage, compression):
    files = BagFiles(tmp_path / 'bag', storage, compression)
    write(files, 2500)
    files.close()
    assert files.counts == {'/numbers': 2500, '/words': 2500}
    readers = [read_with_rosbags, lambda path: collected(Bag(path))]
    for read in readers + [read_with_mcap] * (storage == 'mcap'):
        messages = read(tmp_path / 'bag')
        assert len(messages['/numbers']) == len(messages['/words']) == 2500
        check(messages, 2500)
    names = {path.name for path in (tmp_path / 'bag').iterdir()}
    assert names == {'metadata.yaml', 'bag_0' + {'mcap': '.mcap', 'sqlite3': '.db3'}[storage]}
    said = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())[
        'rosbag2_bagfile_information']
    assert said['starting_time'] == {'nanoseconds_since_epoch': 1000}
    assert said['duration'] == {'nanoseconds': 2499}


@pytest.mark.parametrize('compression', ['zstd', 'lz4'])
def test_compression_compresses(tmp_path, compression):
    for kind in ('none', compression):
        files = BagFiles(tmp_path / kind, 'mcap', kind)
        write(files, 1000)
        files.close()
    plain, packed = ((tmp_path / kind / f'{kind}_0.mcap').stat().st_size
                     for kind in ('none', compression))
    assert packed < plain / 3


@pytest.mark.parametrize('storage, compression', KINDS)
def test_large_bags_are_split_into_files_that_stand_alone(tmp_path, storage, compression):
    files = BagFiles(tmp_path / 'bag', storage, compression, max_size=60_000)
    write(files, 500)
    files.close()
    suffix = {'mcap': '.mcap', 'sqlite3': '.db3'}[storage]
    parts = sorted((tmp_path / 'bag').glob('*' + suffix))
    assert len(parts) > 1
    messages = read_with_rosbags(tmp_path / 'bag')
    assert len(messages['/numbers']) == len(messages['/words']) == 500
    check(messages, 500)
    if storage == 'mcap':
        whole = 0
        for path in parts:
            with path.open('rb') as file:
                summary = make_reader(file).get_summary()
                assert {channel.topic for channel in summary.channels.values()} == {
                    '/numbers', '/words'}
                whole += summary.statistics.message_count
            if compression == 'none':
                assert path.stat().st_size < 60_000 * 1.2 + 10_000
        assert whole == 1000


def test_an_empty_split_bag_has_one_file(tmp_path):
    files = BagFiles(tmp_path / 'bag', 'mcap', max_size=1.0)
    add(files, '/words', TEXT)
    files.close()
    assert read_with_rosbags(tmp_path / 'bag') == {'/words': []}


def test_a_file_that_ends_anywhere_is_read_up_to_its_last_whole_chunk(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, 'CHUNK_SIZE', 4000)
    files = BagFiles(tmp_path / 'whole', 'mcap', 'zstd')
    write(files, 100)
    files.close()
    data = (tmp_path / 'whole' / 'whole_0.mcap').read_bytes()
    before = 0
    for end in range(0, len(data), 97):
        path = tmp_path / 'cut.mcap'
        path.write_bytes(data[:end])
        messages = collected(Bag(path))
        count = sum(map(len, messages.values()))
        assert count >= before
        before = count
        if len(messages) == 2:
            check(messages, min(map(len, messages.values())))
    # The index is not needed.
    assert before == 200


KILLED = """
import sys
from test.recording.sample import BagFiles, write, add, values, TEXT, VALUES
files = BagFiles(sys.argv[1], *sys.argv[2:4], max_size=float(sys.argv[4]))
write(files, 300)
files.flush()
for index in range(300, 400):
    files.write(1, 1000 + index, values(index))
print('written', flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize('storage, compression, max_size', [
    ('mcap', 'lz4', 60_000), ('sqlite3', 'none', 0),
    pytest.param('mcap', 'none', 0, marks=pytest.mark.slow),
    pytest.param('sqlite3', 'zstd', 20_000, marks=pytest.mark.slow)])
def test_what_was_flushed_survives_a_kill(tmp_path, storage, compression, max_size):
    bag = tmp_path / 'bag'
    process = subprocess.Popen(
        [sys.executable, '-c', KILLED, str(bag), storage, compression, str(max_size)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))})
    assert process.stdout.readline() == 'written\n'
    process.send_signal(signal.SIGKILL)
    process.wait()
    opened = Bag(bag)
    assert not opened.finished
    messages = collected(opened)
    assert 300 <= len(messages['/numbers']) <= 400
    check(messages, 300)
    assert not opened.damages


def limited(size):
    """Return a function for a child process: no file may become larger [bytes]."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


FULL = """
import sys
from test.recording.sample import BagFiles, add, values, VALUES
files = BagFiles(sys.argv[1], sys.argv[2], sys.argv[3])
channel = add(files, '/numbers', VALUES)
try:
    for index in range(20000):
        files.write(channel, 1000 + index, values(index))
        if index % 50 == 49:
            files.flush()
    problem = None
except OSError as error:
    problem = error
try:
    files.close()
except OSError as error:
    problem = error
print(problem, files.counts)
"""


@pytest.mark.parametrize('storage, compression, size', [
    pytest.param('mcap', 'none', 300_000, marks=pytest.mark.slow), ('mcap', 'zstd', 150_001),
    ('sqlite3', 'none', 200_000)])
def test_what_fits_into_a_limited_file_is_readable(tmp_path, storage, compression, size):
    bag = tmp_path / 'bag'
    done = subprocess.run(
        [sys.executable, '-c', FULL, str(bag), storage, compression], capture_output=True,
        text=True, preexec_fn=limited(size), check=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))})
    assert 'None' not in done.stdout, done.stdout
    # No file may grow, so that even the index of an mcap file has no room.
    assert Bag(bag).finished == (storage == 'sqlite3')
    read = read_with_rosbags if storage == 'sqlite3' else (lambda path: collected(Bag(path)))
    messages = read(bag)['/numbers']
    assert len(messages) >= 50
    assert [message.data[0] for _, message in messages] == [
        index / 3.0 for index in range(len(messages))]
    assert not (bag / '.reserve').exists()


def test_a_full_disk_has_room_for_the_end_of_the_bag(tmp_path, monkeypatch):
    """What was kept free takes the last chunk and the index: every reader opens the bag."""
    put = writer.McapFile.put_once

    def put_on_small_disk(file):
        used = sum(path.stat().st_size for path in (tmp_path / 'bag').iterdir())
        if used + len(file.buffer.getbuffer()) > RESERVE + 400_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        put(file)

    monkeypatch.setattr(writer.McapFile, 'put_once', put_on_small_disk)
    files = BagFiles(tmp_path / 'bag', 'mcap')
    channel = add(files, '/numbers', VALUES)
    with pytest.raises(OSError, match='No space'):
        for index in range(20000):
            files.write(channel, 1000 + index, values(index))
            if index % 50 == 49:
                files.flush()
    with pytest.raises(OSError, match='No space'):
        files.close()
    assert Bag(tmp_path / 'bag').finished
    messages = read_with_rosbags(tmp_path / 'bag')['/numbers']
    # The chunk that met the full disk is in the bag, too.
    assert len(messages) == index + 1
    assert read_with_mcap(tmp_path / 'bag')['/numbers'][-1][1].data[0] == index / 3.0


@pytest.mark.parametrize('path', ['nowhere', 'empty'])
def test_what_is_no_bag_is_said_so(tmp_path, path):
    (tmp_path / 'empty').mkdir()
    with pytest.raises(BagReadError, match='expected a rosbag2 bag'):
        Bag(tmp_path / path)


@pytest.mark.parametrize('storage', COMPRESSIONS)
def test_nothing_is_overwritten(tmp_path, storage):
    BagFiles(tmp_path / 'bag', storage).close()
    with pytest.raises(FileExistsError):
        BagFiles(tmp_path / 'bag', storage)
