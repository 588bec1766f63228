# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Faults of descriptions, and the messages that name them.

A fault is what is written in place of what; then line, key path, expected, got, and advice if any.
"""

import pytest


def write(directory, text, name):
    """Write a description into a file of a directory, and return its path."""
    path = directory / name
    path.write_text(text, encoding='utf-8')
    return path


def refusal(path, load, error):
    """Return the message with which a loader refuses a file."""
    with pytest.raises(error) as caught:
        load(path)
    return str(caught.value)


def require_named(path, good, fault, load, error):
    """Assert that a loader names a fault in a good description, which is written to a path."""
    old, new, line, key_path, expected, got, advice = fault
    assert old in good
    write(path.parent, good.replace(old, new, 1), path.name)
    advice = f' ({advice})' if advice else ''
    assert refusal(path, load, error) == (
        f'{path}:{line}: {key_path}: expected {expected}, got {got}{advice}')
