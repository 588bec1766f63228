# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Contents of a bag, and damage in it."""

from dataclasses import dataclass
from typing import Optional


@dataclass(frozen=True)
class Topic:
    """One topic: name, type, the text of the type's definition, offered QoS (YAML), type hash."""

    name: str
    type: str  # noqa: A003
    definition: str
    profiles: str = ''
    digest: str = ''


@dataclass(frozen=True)
class Serialised:
    """One message of a bag, as it was serialised, with its time of reception [ns]."""

    topic: Topic
    time: int
    data: bytes


@dataclass
class Damage:
    """A place of a bag that cannot be read as it was written."""

    place: str  # File, and byte or message in it
    what: str  # What is wrong there
    lost: Optional[int] = None  # Messages lost by it; None where that is not known

    def __str__(self):
        """Return it as a line for the user."""
        return f'{self.place}: {self.what}; {messages(self.lost)} lost'


def messages(count):
    """Return a number of messages in words; None: not known."""
    return (f'{"an unknown number of" if count is None else count or "no"} '
            f'message{"s" * (count != 1)}')
