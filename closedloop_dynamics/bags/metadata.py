# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The file ``metadata.yaml`` of a rosbag2 bag, format version 9."""

import json
import os

FORMAT_VERSION = 9
DEFAULT_DISTRIBUTION = 'jazzy'


def distribution():
    """Return the name of the ROS distribution for a bag."""
    return os.environ.get('ROS_DISTRO') or DEFAULT_DISTRIBUTION


def metadata(storage, compression, topics, files):
    """
    Return what is to be known of a bag.

    Parameters
    ----------
    storage : str
        ``'mcap'`` or ``'sqlite3'``.
    compression : str
        Of every single message: ``''`` or ``'zstd'``.
    topics : sequence of (str, str, str, list, int)
        Name, type, digest of the type, offered qualities of service, messages.
    files : sequence of (str, int, int, int)
        Name, first and last time [ns], messages.

    Returns
    -------
    dict

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
                'name': name, 'type': kind, 'serialization_format': 'cdr',
                'offered_qos_profiles': profiles, 'type_description_hash': digest},
            'message_count': count,
        } for name, kind, digest, profiles, count in topics],
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


def as_yaml(value, indent=''):
    """
    Write mappings, lists, text, numbers, truth values and None as YAML.

    Parameters
    ----------
    value : object
        What to write.
    indent : str
        In front of every line.

    Returns
    -------
    str
        Without a final newline.

    """
    deeper = indent + '  '
    if isinstance(value, dict) and value:
        return '\n'.join(f'{indent}{key}:' + _beside(item, deeper) for key, item in value.items())
    if isinstance(value, list) and value:
        return '\n'.join(f'{indent}-' + _beside(item, deeper, first=deeper) for item in value)
    # Scalars and empty collections of JSON are those of YAML.
    return indent + json.dumps(value, ensure_ascii=False)


def _beside(value, indent, first=None):
    """Return a value to be written behind a key or a dash."""
    text = as_yaml(value, indent)
    if not isinstance(value, (dict, list)) or not value:
        return ' ' + text[len(indent):]
    return ' ' + text[len(first):] if first is not None else '\n' + text
