# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Topics and messages of rosbag2 bags, and names that their readers and writers share."""

from dataclasses import dataclass

import yaml

METADATA_FILE, ROOT = 'metadata.yaml', 'rosbag2_bagfile_information'
load = yaml.safe_load


@dataclass(frozen=True)
class Topic:
    """
    One topic: name, type, the text of the type's definition, its hash.

    ``profiles``: qualities of service that publishers offered, mappings as bags of format version
    9 have them; written, not read.
    """

    name: str
    type: str  # noqa: A003
    definition: str
    digest: str = ''
    profiles: tuple = ()


@dataclass(frozen=True)
class Serialised:
    """One message of a bag, as it was serialised, with its time of reception [ns]."""

    topic: Topic
    time: int
    data: bytes


def dump(value):
    """Return mappings, lists and scalars as YAML, without a final newline."""
    return yaml.safe_dump(value, default_flow_style=False, sort_keys=False).rstrip('\n')
