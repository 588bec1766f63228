# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The checks that values pass, whether read from YAML or given in Python."""

from collections.abc import Mapping, Set
import math
from numbers import Real
import re

from .fields import among, at, FieldError, nearest, shown
from .rotations import quaternion_of_angles

# What ROS accepts as one token of a topic or parameter name.
NAME_PATTERN = re.compile(r'[a-zA-Z][a-zA-Z0-9_]*')
# ROS has no longer topics; keys of YAML end at 1024 characters.
LONGEST_NAME = 255


def number(value, expected='a finite number'):
    """Return ``value`` as float; raise unless it is a finite number."""
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


def probability(value):
    """Return ``value`` as float; refuse what is not between 0 and 1."""
    expected = 'a probability between 0 and 1'
    result = number(value, expected)
    if not 0.0 < result < 1.0:
        raise FieldError(expected, shown(value))
    return result


def count(value):
    """Return ``value``; raise unless it is a positive whole number."""
    if type(value) is not int or value < 1:
        raise FieldError('a whole number, one or more', shown(value))
    return value


def listed(value, expected='a list'):
    """Return ``value`` as a tuple; raise unless it is a list, tuple or array."""
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


def numbers(value, count, expected):
    """Return a list of ``count`` finite numbers as a tuple."""
    items = listed(value, expected)
    if len(items) != count:
        raise FieldError(expected, f'{shown(value)}, of length {len(items)}')
    return list_of(number)(items)


def vector3(value):
    """Return ``value`` as a tuple of three floats."""
    return numbers(value, 3, 'a list of 3 finite numbers [x, y, z]')


def one_or_several(one, several):
    """Return a check: ``several`` for values with a length, ``one`` for others."""
    return lambda value: (several if hasattr(value, '__len__') else one)(value)


def vector(value):
    """Return ``value`` as a tuple of two floats, or of three."""
    return (vector3 if hasattr(value, '__len__') and len(value) == 3 else vector2)(value)


def none_negative(value):
    """Return two or three floats; refuse any that is less than zero."""
    return list_of(not_negative)(vector(value))


# Vectors of a norm this near to 1 stay unchanged, so that one checked and written can be read
# again to the last digit.
UNIT_NORM = 1e-15


def direction(value):
    """Return ``value`` as a tuple of three floats; raise where their norm is zero."""
    axis = vector3(value)
    # Squares of less vanish.
    if not max(map(abs, axis)) > 1e-100:
        raise FieldError('a direction [x, y, z] that is not zero', shown(value))
    length = math.hypot(*axis)
    if abs(length - 1.0) <= UNIT_NORM:
        return axis
    return tuple(component / length for component in axis)


# How far from 1 the norm of a quaternion may be: rounding to five digits.
ROUNDED_NORM = 1e-4


def orientation(value):
    """Return a unit quaternion (x, y, z, w) of a mapping, or of a tuple that is one already."""
    expected = 'a mapping with rpy: [r, p, y] in radians, or quaternion: [x, y, z, w]'
    if isinstance(value, tuple):
        value = {'quaternion': value}
    if not isinstance(value, Mapping) or len(value) != 1 or not {'rpy', 'quaternion'} & set(value):
        raise FieldError(expected, shown(value))
    if 'rpy' in value:
        with at('rpy'):
            return quaternion_of_angles(
                *numbers(value['rpy'], 3, 'a list of 3 finite numbers [rad]'))
    with at('quaternion'):
        found = numbers(value['quaternion'], 4, 'a list of 4 finite numbers [x, y, z, w]')
        norm = math.hypot(*found)
        if not abs(norm - 1.0) <= ROUNDED_NORM:
            raise FieldError('a unit quaternion [x, y, z, w]', f'one of norm {norm:.6g}')
        if abs(norm - 1.0) <= UNIT_NORM:
            return found
        return tuple(component / norm for component in found)


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
    """Return ``value`` if it is valid in a ROS topic or parameter name."""
    if not isinstance(value, str) or not NAME_PATTERN.fullmatch(value):
        raise FieldError(
            'a name of letters, digits and underscores that starts with a letter', shown(value))
    if len(value) > LONGEST_NAME:
        raise FieldError(
            f'a name of at most {LONGEST_NAME} characters', f'one of {len(value)}')
    return value


def freedom(value):
    """Return ``value`` if it can name a joint, or one of its freedoms, as ``hip.1``."""
    if not isinstance(value, str):
        return name(value)
    joint, _, own = value.partition('.')
    return value if own.isalnum() and name(joint) else name(value)


def one_of(choices, kind='one of'):
    """Return the check for a value among ``choices``, which are texts."""
    def check(value):
        if isinstance(value, str) and value in choices:
            return value
        raise FieldError(f'{kind} {among(choices)}', shown(value), nearest(value, choices))
    return check
