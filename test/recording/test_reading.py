# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Of a damaged bag, what is before the damage is read, and the damage is reported."""

from itertools import islice
import sqlite3
from test.recording.sample import add, TEXT, text, VALUES, values

from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.reading import Bag
from closedloop_dynamics.recording.writer import BagFiles
from mcap.reader import make_reader
import pytest
import yaml
import zstandard

COUNT, CHUNK = 200, 20


@pytest.fixture
def bag(tmp_path):
    """Return a bag of ten chunks with twenty messages each of two topics."""
    return written(tmp_path / 'bag', 'mcap')


def written(path, storage, compression='none'):
    files = BagFiles(path, storage, compression)
    numbers, words = add(files, '/numbers', VALUES), add(files, '/words', TEXT)
    for index in range(COUNT):
        files.write(numbers, 1000 + index, values(index))
        files.write(words, 1000 + index, text(index))
        if index % CHUNK == CHUNK - 1:
            files.flush()
    files.close()
    return path


def spoil(bag, place):
    """Flip a bit; return the file."""
    path, = (path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    data = bytearray(path.read_bytes())
    data[place(data)] ^= 0x10
    path.write_bytes(data)
    return path


def numbers(bag):
    return [round(3.0 * message.data[0]) for topic, _, message in bag.messages()
            if topic == '/numbers']


@pytest.mark.parametrize('finished', [True, False])
@pytest.mark.parametrize('place', ['message', 'checksum', 'head', 'size'])
def test_what_is_before_a_damaged_chunk_is_read(bag, finished, place):
    """One damaged chunk of ten: in its messages, its checksum, its code, its size."""
    with open(bag / 'bag_0.mcap', 'rb') as file:
        start = make_reader(file).get_summary().chunk_indexes[3].chunk_start_offset
    spoil(bag, lambda data: {'message': data.index(values(67)) + 50, 'checksum': start + 9 + 24,
                             'head': start, 'size': start + 2}[place])
    if not finished:
        (bag / 'metadata.yaml').unlink()
        path = bag / 'bag_0.mcap'
        path.write_bytes(path.read_bytes()[:-1000])
    opened = Bag(bag)
    assert opened.finished == finished
    found = numbers(opened)
    assert opened.damages[0].startswith('bag_0.mcap: ')
    assert 'what follows in this file is left out; `mcap recover`' in opened.damages[0]
    if place == 'head':
        # A record of a kind that nobody knows is passed over, but messages are missed.
        assert '40 messages that its indices name are missing' in opened.damages[0]
        assert found == [index for index in range(COUNT) if index // CHUNK != 3]
    else:
        # A chunk of a wrong size is sound itself, but what follows is not found.
        whole = 4 if place == 'size' else 3
        assert 'a record is cut off or damaged' in opened.damages[0]
        assert found == list(range(whole * CHUNK))
    # Counts of the metadata add to that.
    assert len(opened.damages) == (2 if finished else 1)
    with pytest.warns(UserWarning, match='bag_0.mcap'):
        opened.warn()


def test_a_chunk_cut_off_in_a_killed_recording_is_reported(bag):
    (bag / 'metadata.yaml').unlink()
    path = bag / 'bag_0.mcap'
    data = path.read_bytes()
    path.write_bytes(data[:data.index(values(195)) + 10])
    opened = Bag(bag)
    assert numbers(opened) == list(range(180))
    damage, = opened.damages
    assert 'a record is cut off or damaged' in damage


@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_a_flipped_bit_in_a_database_is_found(tmp_path, compression):
    bag = written(tmp_path / 'bag', 'sqlite3', compression)
    with sqlite3.connect(bag / 'bag_0.db3') as database:
        number, data = database.execute(
            'SELECT id, data FROM messages WHERE topic_id = 1 AND timestamp = 1067').fetchone()
    spoil(bag, lambda content: content.index(data) + len(data) - 20)
    opened = Bag(bag)
    assert numbers(opened) == list(range(67))
    assert f'bag_0.db3: message {number} is damaged' in opened.damages[0]


@pytest.mark.parametrize('begin', range(0, 4096, 256))
def test_a_database_with_a_hole_anywhere_is_reported(tmp_path, begin):
    bag = written(tmp_path / 'bag', 'sqlite3')
    path = bag / 'bag_0.db3'
    data = bytearray(path.read_bytes())
    begin += data.index(values(67)) // 4096 * 4096
    # Numbers of messages that became 0 lead back to the start.
    data[begin:begin + 5000] = bytes(5000)
    path.write_bytes(data)
    found = Bag(bag)
    count = sum(1 for _ in islice(found.serialised(), 2 * COUNT + 1))
    assert 50 < count < 2 * COUNT
    assert found.damages


def test_a_missing_file_and_wrong_counts_are_reported(tmp_path):
    files = BagFiles(tmp_path / 'bag', 'mcap', max_size=20_000)
    channel = add(files, '/numbers', VALUES)
    for index in range(COUNT):
        files.write(channel, 1000 + index, values(index))
        files.flush()
    files.close()
    (tmp_path / 'bag' / 'bag_1.mcap').unlink()
    bag = Bag(tmp_path / 'bag')
    count = sum(1 for _ in bag.serialised())
    missing, counts = bag.damages
    assert 'bag_1.mcap' in missing
    assert f'it counts {COUNT} messages, found {count}' in counts


def compress(bag):
    """Compress the file of a bag as ``ros2 bag record --compression-mode file`` does."""
    path, = (path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    packed = path.with_name(path.name + '.zstd')
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    path.unlink()
    metadata = yaml.safe_load((bag / 'metadata.yaml').read_text())
    information = metadata['rosbag2_bagfile_information']
    information.update(compression_format='zstd', compression_mode='FILE',
                       relative_file_paths=[packed.name])
    information['files'][0]['path'] = packed.name
    (bag / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    return packed


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bags_compressed_by_file_are_read(tmp_path, storage):
    bag = written(tmp_path / 'bag', storage)
    packed = compress(bag)
    opened = Bag(bag)
    assert sum(1 for _ in opened.messages()) == 2 * COUNT
    assert opened.finished and not opened.damages
    packed.write_bytes(packed.read_bytes()[:-1000])
    assert sum(1 for _ in opened.messages()) < 2 * COUNT
    assert opened.damages


def test_the_command_that_recovered_bags_says_what_serves_instead(capsys):
    with pytest.raises(SystemExit, match='2'):
        main(['recover', 'my_bag'])
    error = capsys.readouterr().err
    assert 'recover is no longer a command' in error and '`mcap recover FILE -o NEW`' in error
