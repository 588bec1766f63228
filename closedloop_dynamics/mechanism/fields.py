# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Errors in values from outside, with place, expected and found value.

A check is a function that takes a value and returns it normalised (``3`` to
``3.0``, a list to a tuple) or raises :class:`FieldError`; ``checks.py`` has them.
Checks know nothing of files or keys: whoever calls them adds the key path by
:func:`at`, whoever read the file adds its name and line. So the same checks serve
values read from YAML and records built in Python.
"""

from collections.abc import Mapping
from dataclasses import fields, MISSING
from difflib import get_close_matches

LONGEST_SHOWN = 60
MOST_SHOWN = 30


class FieldError(ValueError):
    """
    A value that does not fit its key: what was expected, what was got, and a remedy or ''.

    ``path``: keys and list indices that lead to the value, outermost first.
    """

    def __init__(self, expected, got, note='', path=()):
        super().__init__(expected, got, note, path)
        self.expected = expected
        self.got = got
        self.note = note
        self.path = tuple(path)

    def __str__(self):
        where = key_path(self.path)
        note = f' ({self.note})' if self.note else ''
        return f'{where}: expected {self.expected}, got {self.got}{note}'


class at:  # noqa: N801
    """Put ``keys`` before the path of a FieldError raised in this block."""

    # A class: samples of rollouts enter many such blocks, and a generator takes longer.
    __slots__ = ('_keys',)

    def __init__(self, *keys):
        self._keys = keys

    def __enter__(self):
        """Begin."""

    def __exit__(self, kind, error, trace):
        if isinstance(error, FieldError):
            error.path = self._keys + error.path


def key_path(path):
    """Write a path as users do: ``bodies.crank.center_of_mass[1]``."""
    written = ''.join(f'[{key}]' if type(key) is int else f'.{key}' for key in path)
    return written.lstrip('.') or 'the whole description'


def shown(value):
    """Write a value the way a YAML file has it, cut short, naming its kind."""
    if value is None:
        return 'nothing'
    if isinstance(value, bool):
        return f'the truth value {str(value).lower()}'
    if isinstance(value, Mapping):
        return 'a mapping'
    try:
        text = repr(value)
    except ValueError:
        # Python refuses to write integers of thousands of digits.
        return 'an integer of thousands of digits'
    if len(text) > LONGEST_SHOWN:
        text = text[:LONGEST_SHOWN] + '...'
    if isinstance(value, str):
        return f'the text {text}'
    return text


def among(words):
    """Write the choices, cut short where they are many."""
    words = list(words)
    return ', '.join(words[:MOST_SHOWN]) + ', ...' * (len(words) > MOST_SHOWN)


def nearest(word, known):
    """Return a question that offers the known word most like ``word``, or ''."""
    matches = get_close_matches(str(word), list(known), n=1)
    return f"did you mean '{matches[0]}'?" if matches else ''


def mapping(value, required=(), optional=None):
    """
    Return ``value`` if it is a mapping with the required keys.

    ``optional``: further keys that may be there; None: any key may. FieldError where it is no
    mapping, or a key is unknown or missing.
    """
    if not isinstance(value, Mapping):
        raise FieldError('a mapping (key: value)', shown(value))
    known = None if optional is None else dict.fromkeys((*required, *optional))
    for key in value:
        if known is not None and key not in known:
            free = [word for word in known if word not in value]
            raise FieldError(f'one of the keys {among(known)}', f'the unknown key {key!r}',
                             nearest(key, free), path=(key,))
    for key in required:
        if key not in value:
            raise FieldError('this required key', 'none', path=(key,))
    return value


def keys_of(record_type, leave_out=()):
    """Return the required and the optional keys of a dataclass."""
    keys = [f for f in fields(record_type) if f.init and f.name not in leave_out]
    required = [f.name for f in keys if f.default is MISSING and f.default_factory is MISSING]
    return required, [f.name for f in keys if f.name not in required]


def copied(record):
    """Return a copy of a record, of the same fields, which are not checked again."""
    other = object.__new__(type(record))
    vars(other).update(vars(record))
    return other


def normalise(record, **checks):
    """
    Pass fields of a dataclass through their checks, in place, and return it.

    Meant for ``__post_init__`` of frozen dataclasses (and for fresh copies),
    so that no record with a bad value can exist.
    """
    for key, check in checks.items():
        with at(key):
            object.__setattr__(record, key, check(getattr(record, key)))
    return record
