# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The file ``metadata.yaml`` of a rosbag2 bag, format version 9."""

from io import StringIO
import os

from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
from ruamel.yaml import YAML

METADATA_FILE = 'metadata.yaml'
ROOT = 'rosbag2_bagfile_information'
FORMAT_VERSION = 9
DEFAULT_DISTRIBUTION = 'jazzy'


def distribution():
    """Return the name of the ROS distribution for a bag."""
    return os.environ.get('ROS_DISTRO') or DEFAULT_DISTRIBUTION


def metadata(storage, compression, topics, files):
    """
    Return the metadata of a bag.

    ``storage``: ``'mcap'`` or ``'sqlite3'``; ``compression`` of every single message: ``''`` or
    ``'zstd'``; ``topics`` with the number of their messages; ``files``: name, first and last time
    [ns], messages.
    """
    filled = [file for file in files if file[3]]
    start = min((first for _, first, _, _ in filled), default=0)
    end = max((last for _, _, last, _ in filled), default=0)
    return {
        'version': FORMAT_VERSION,
        'storage_identifier': storage,
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(count for *_, count in files),
        'topics_with_message_count': [{
            'topic_metadata': {
                'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                'offered_qos_profiles': load(topic.profiles) or [],
                'type_description_hash': topic.digest},
            'message_count': count,
        } for topic, count in topics],
        'compression_format': compression,
        'compression_mode': 'message' if compression else '',
        'relative_file_paths': [name for name, *_ in files],
        'files': [{
            'path': name,
            'starting_time': {'nanoseconds_since_epoch': first},
            'duration': {'nanoseconds': last - first},
            'message_count': count,
        } for name, first, last, count in files],
        'custom_data': None,
        'ros_distro': distribution(),
    }


def normalised(profiles):
    """Return offered qualities of service of any format version, YAML, in the present one."""
    try:
        return dump(dump_qos_v9(parse_qos(profiles)))
    except Exception:
        # Whatever garbage makes the parser raise: nothing is known then.
        return ''


def load(text):
    """Return the data of a YAML text."""
    return YAML(typ='safe', pure=True).load(text)


def dump(value):
    """Return mappings, lists and scalars as YAML, without a final newline."""
    yaml, text = YAML(typ='safe', pure=True), StringIO()
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False
    yaml.dump(value, text)
    return text.getvalue().removesuffix('\n').removesuffix('\n...')
