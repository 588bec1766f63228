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

"""The checks that values pass, whether read from YAML or given in Python."""

from collections.abc import Mapping, Set
import math
from numbers import Real
import re

from .fields import among, at, FieldError, nearest, shown

# What ROS accepts as one token of a topic or parameter name.
NAME_PATTERN = re.compile(r'[a-zA-Z][a-zA-Z0-9_]*')


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


def listed(value, expected='a list'):
    """Return ``value`` as a tuple; refuse what is no list, tuple or array."""
    if isinstance(value, (str, bytes, Mapping, Set)):
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


def vector2(value):
    """Return ``value`` as a tuple of two floats."""
    expected = 'a list of 2 finite numbers [x, y]'
    items = listed(value, expected)
    if len(items) != 2:
        raise FieldError(expected, f'{shown(value)}, of length {len(items)}')
    return list_of(number)(items)


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
        raise FieldError(f'{kind} {among(choices)}', shown(value), nearest(value, choices))
    return check
