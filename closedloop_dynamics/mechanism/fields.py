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

"""
The checks that values from outside pass, whether read from YAML or built in Python.

A check is a function that takes a value and returns it normalised (``3`` to
``3.0``, a list to a tuple) or raises :class:`FieldError`. Checks know nothing
of files: whoever calls them adds the key path, whoever read the file adds its
name and line.

"""

from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import fields, MISSING
from difflib import get_close_matches
import math
from numbers import Real
import re

# What ROS accepts as one token of a topic or parameter name.
NAME_PATTERN = re.compile(r'[a-zA-Z][a-zA-Z0-9_]*')
LONGEST_SHOWN = 60


class FieldError(ValueError):
    """
    A value that is not what its key asks for.

    Attributes
    ----------
    path : tuple of str and int
        Keys and list indices that lead to the value, outermost first.
    expected, got : str
    note : str
        What to do about it; may be empty.

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


@contextmanager
def at(*keys):
    """Put ``keys`` before the path of a FieldError raised in this block."""
    try:
        yield
    except FieldError as error:
        error.path = keys + error.path
        raise


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
        return f'a mapping of {len(value)} keys'
    text = repr(value)
    if len(text) > LONGEST_SHOWN:
        text = text[:LONGEST_SHOWN] + '...'
    if isinstance(value, str):
        return f'the text {text}'
    return text


def number(value, expected='a finite number'):
    """Return ``value`` as float; refuse what is no finite number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise FieldError(expected, shown(value))
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise FieldError(expected, shown(value))
    return result


def positive(value):
    """Return ``value`` as float; refuse zero and less."""
    result = number(value, 'a positive number')
    if result <= 0.0:
        raise FieldError('a positive number', shown(value))
    return result


def not_negative(value):
    """Return ``value`` as float; refuse less than zero."""
    result = number(value, 'a number that is zero or more')
    if result < 0.0:
        raise FieldError('a number that is zero or more', shown(value))
    return result


def vector2(value):
    """Return ``value`` as a tuple of two floats."""
    expected = 'a list of 2 finite numbers [x, y]'
    items = listed(value, expected)
    if len(items) != 2:
        raise FieldError(expected, f'{shown(value)}, of length {len(items)}')
    return list_of(number)(items)


def listed(value, expected='a list'):
    """Return ``value`` as a tuple; refuse what is no list, tuple or array."""
    if isinstance(value, (str, bytes, Mapping)):
        raise FieldError(expected, shown(value))
    try:
        return tuple(value)
    except TypeError:
        raise FieldError(expected, shown(value)) from None


def list_of(check):
    """Return the check for a list whose items all pass ``check``."""
    def check_list(value):
        result = []
        for index, item in enumerate(listed(value)):
            with at(index):
                result.append(check(item))
        return tuple(result)
    return check_list


def boolean(value):
    """Return ``value`` if it is true or false."""
    if not isinstance(value, bool):
        raise FieldError('true or false', shown(value))
    return value


def text(value):
    """Return ``value`` if it is text."""
    if not isinstance(value, str):
        raise FieldError('text', shown(value))
    return value


def name(value):
    """Return ``value`` if it can stand in a ROS topic or parameter name."""
    if not isinstance(value, str) or not NAME_PATTERN.fullmatch(value):
        raise FieldError(
            'a name of letters, digits and underscores that starts with a letter', shown(value))
    return value


def one_of(choices, kind='one of'):
    """Return the check for a value among ``choices``, which are texts."""
    def check(value):
        if isinstance(value, str) and value in choices:
            return value
        raise FieldError(f'{kind} {", ".join(choices)}', shown(value), nearest(value, choices))
    return check


def nearest(word, known):
    """Return a question that offers the known word most like ``word``, or ''."""
    matches = get_close_matches(str(word), list(known), n=1)
    return f"did you mean '{matches[0]}'?" if matches else ''


def mapping(value, required=(), optional=None):
    """
    Return ``value`` if it is a mapping with the keys asked for.

    Parameters
    ----------
    value : object
        The value to check.
    required : sequence of str
        Keys that must be there.
    optional : sequence of str, optional
        Further keys that may be there; None: any key may.

    Raises
    ------
    FieldError
        Where it is no mapping, or a key is unknown or missing.

    """
    if not isinstance(value, Mapping):
        raise FieldError('a mapping (key: value)', shown(value))
    known = None if optional is None else dict.fromkeys((*required, *optional))
    for key in value:
        if known is not None and key not in known:
            free = [word for word in known if word not in value]
            raise FieldError(f'one of the keys {", ".join(known)}', f'the unknown key {key!r}',
                             nearest(key, free), path=(key,))
    for key in required:
        if key not in value:
            raise FieldError('this key, which is required', 'nothing', path=(key,))
    return value


def keys_of(record_type, leave_out=()):
    """Return the required and the optional keys of a dataclass."""
    keys = [f for f in fields(record_type) if f.init and f.name not in leave_out]
    required = [f.name for f in keys if f.default is MISSING and f.default_factory is MISSING]
    return required, [f.name for f in keys if f.name not in required]


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
