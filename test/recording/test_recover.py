# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Of a damaged bag, everything sound comes back, and what was lost is counted."""

from itertools import islice
import sqlite3
from test.recording.sample import add, QOS, TEXT, text, VALUES, values
from test.ros.bags import read_with_mcap, read_with_rosbags

from closedloop_dynamics.cli import main
from closedloop_dynamics.recording.metadata import dump, load
from closedloop_dynamics.recording.reading import Bag
from closedloop_dynamics.recording.writer import BagFiles
from mcap.reader import make_reader
import pytest
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9
import zstandard

COUNT, CHUNK = 200, 20
LATCHED = [{**QOS[0], 'durability': 'transient_local', 'depth': 1}]


@pytest.fixture
def bag(tmp_path):
    """Return a bag of ten chunks with twenty messages each of two topics."""
    return written(tmp_path / 'bag', 'mcap')


def written(path, storage, compression='none'):
    files = BagFiles(path, storage, compression)
    numbers, words = add(files, '/numbers', VALUES), add(files, '/words', TEXT, LATCHED)
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


def numbers(path):
    return [round(3.0 * message.data[0])
            for _, message in read_with_rosbags(path)['/numbers']]


def without(chunk):
    return [index for index in range(COUNT) if index // CHUNK != chunk]


@pytest.mark.parametrize('finished', [True, False])
@pytest.mark.parametrize('place', ['message', 'checksum', 'head', 'size'])
def test_all_sound_chunks_come_back_in_order(bag, capsys, finished, place):
    """One damaged chunk of ten: in its messages, its checksum, its code, its size."""
    with open(bag / 'bag_0.mcap', 'rb') as file:
        start = make_reader(file).get_summary().chunk_indexes[3].chunk_start_offset
    spoil(bag, lambda data: {'message': data.index(values(67)) + 50, 'checksum': start + 9 + 24,
                             'head': start, 'size': start + 2}[place])
    if not finished:
        (bag / 'metadata.yaml').unlink()
        path = bag / 'bag_0.mcap'
        path.write_bytes(path.read_bytes()[:-1000])
    assert main(['recover', str(bag)]) == 1
    error = capsys.readouterr().err
    # Without its head, the index behind a chunk is not found either.
    known = finished or place in ('message', 'checksum')
    lost = '40 messages' if known else 'an unknown number of messages'
    assert f'{lost} could not be recovered' in error and 'bag_0.mcap, byte ' in error
    whole = bag.with_name('bag_recovered')
    assert numbers(whole) == without(3)
    assert len(read_with_mcap(whole)['/words']) == COUNT - CHUNK


def test_a_chunk_cut_out_of_a_killed_recording_is_lost_and_told(bag, capsys):
    (bag / 'metadata.yaml').unlink()
    path = bag / 'bag_0.mcap'
    data = path.read_bytes()
    path.write_bytes(data[:data.index(values(195)) + 10])
    assert main(['recover', str(bag)]) == 1
    assert 'bytes are no whole chunk' in capsys.readouterr().err
    assert numbers(bag.with_name('bag_recovered')) == list(range(180))


@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_a_flipped_bit_in_a_database_costs_one_message(tmp_path, capsys, compression):
    bag = written(tmp_path / 'bag', 'sqlite3', compression)
    with sqlite3.connect(bag / 'bag_0.db3') as database:
        number, data = database.execute(
            'SELECT id, data FROM messages WHERE topic_id = 1 AND timestamp = 1067').fetchone()
    spoil(bag, lambda content: content.index(data) + len(data) - 20)
    assert main(['recover', str(bag)]) == 1
    error = capsys.readouterr().err
    assert f'bag_0.db3, message {number}: it is damaged; 1 message lost' in error
    assert numbers(bag.with_name('bag_recovered')) == [
        index for index in range(COUNT) if index != 67]


def test_a_lost_page_of_a_database_is_counted(tmp_path, capsys):
    bag = written(tmp_path / 'bag', 'sqlite3')
    path = bag / 'bag_0.db3'
    data = bytearray(path.read_bytes())
    page = data.index(values(67)) // 4096 * 4096
    data[page:page + 4096] = bytes(4096)
    path.write_bytes(data)
    assert main(['recover', str(bag)]) == 1
    found = Bag(bag.with_name('bag_recovered'))
    count = sum(1 for _ in found.serialised())
    assert f'{2 * COUNT - count} messages could not be recovered' in capsys.readouterr().err
    assert 370 < count < 400


@pytest.mark.parametrize('begin', range(0, 4096, 256))
def test_a_database_with_a_hole_anywhere_is_read_to_its_end(tmp_path, begin):
    bag = written(tmp_path / 'bag', 'sqlite3')
    path = bag / 'bag_0.db3'
    data = bytearray(path.read_bytes())
    begin += data.index(values(67)) // 4096 * 4096
    # Numbers of messages that became 0 lead back to the start.
    data[begin:begin + 5000] = bytes(5000)
    path.write_bytes(data)
    found = Bag(bag)
    count = sum(1 for _ in islice(found.serialised(), 2 * COUNT + 1))
    assert 350 < count < 2 * COUNT
    assert found.lost == 2 * COUNT - count


def test_a_missing_file_and_wrong_counts_are_told(tmp_path):
    files = BagFiles(tmp_path / 'bag', 'mcap', max_size=20_000)
    channel = add(files, '/numbers', VALUES)
    for index in range(COUNT):
        files.write(channel, 1000 + index, values(index))
        files.flush()
    files.close()
    (tmp_path / 'bag' / 'bag_1.mcap').unlink()
    bag = Bag(tmp_path / 'bag')
    count = sum(1 for _ in bag.serialised())
    assert bag.lost == COUNT - count > 10
    assert 'bag_1.mcap' in str(bag.damages[0])


def test_qualities_of_service_survive(bag):
    """Transient local topics are so again when the recovered bag is played."""
    (bag / 'metadata.yaml').unlink()
    path = bag / 'bag_0.mcap'
    path.write_bytes(path.read_bytes()[:-1000])
    assert main(['recover', str(bag)]) == 0
    with Reader(bag.with_name('bag_recovered')) as reader:
        profiles = {each.topic: dump_qos_v9(each.ext.offered_qos_profiles)
                    for each in reader.connections}
    assert profiles == {'/numbers': QOS, '/words': LATCHED}


def compress(bag):
    """Compress the file of a bag as ``ros2 bag record --compression-mode file`` does."""
    path, = (path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    packed = path.with_name(path.name + '.zstd')
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    path.unlink()
    metadata = load((bag / 'metadata.yaml').read_text())
    information = metadata['rosbag2_bagfile_information']
    information.update(compression_format='zstd', compression_mode='FILE',
                       relative_file_paths=[packed.name])
    information['files'][0]['path'] = packed.name
    (bag / 'metadata.yaml').write_text(dump(metadata))
    return packed


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bags_compressed_by_file_are_read(tmp_path, storage, capsys):
    bag = written(tmp_path / 'bag', storage)
    packed = compress(bag)
    opened = Bag(bag)
    assert sum(1 for _ in opened.messages()) == 2 * COUNT
    assert opened.finished and not opened.damages
    packed.write_bytes(packed.read_bytes()[:-1000])
    assert main(['recover', str(bag)]) == 1
    assert 'could not be recovered' in capsys.readouterr().err
