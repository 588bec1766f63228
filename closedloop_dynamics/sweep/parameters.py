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
What a sweep varies: ``KEY=1:5:9``, ``KEY=1,2,5``, ``KEY=normal:4:0.2``.

Evenly spaced and listed values span a grid; distributions are drawn from, with a generator of
its own for each key, so that one more key changes the draws of none.

"""

from dataclasses import dataclass
import math
from typing import Tuple
from zlib import crc32

import numpy as np

from ..mechanism.fields import at, FieldError, nearest

RANGE = 'FROM:TO:COUNT'
# Distribution -> names of its two numbers, and how to draw with them.
DISTRIBUTIONS = {
    'uniform': ('FROM:TO', lambda rng, a, b, count: rng.uniform(a, b, count)),
    'loguniform': ('FROM:TO', lambda rng, a, b, count: np.exp(
        rng.uniform(math.log(a), math.log(b), count))),
    'normal': ('MEAN:DEVIATION', lambda rng, a, b, count: rng.normal(a, b, count)),
}
FORMS = ', '.join([RANGE, 'VALUE,VALUE,...', *(
    f'{name}:{form}' for name, (form, _) in DISTRIBUTIONS.items())])
MOST_VALUES = 10_000_000


@dataclass(frozen=True)
class Grid:
    """
    Values that are combined with those of the other grids.

    Attributes
    ----------
    key : str
        Key path.
    values : tuple of float

    """

    key: str
    values: Tuple[float, ...]

    random = False


@dataclass(frozen=True)
class Random:
    """
    A distribution that is drawn from.

    Attributes
    ----------
    key : str
        Key path.
    distribution : str
        Of ``DISTRIBUTIONS``.
    first, second : float
        Its two numbers.

    """

    key: str
    distribution: str
    first: float
    second: float

    random = True

    def draws(self, count, seed):
        """
        Draw.

        Returns
        -------
        ndarray, shape (count,)

        """
        rng = np.random.default_rng([seed, crc32(self.key.encode())])
        return DISTRIBUTIONS[self.distribution][1](rng, self.first, self.second, count)


def parse(text):
    """
    Read ``KEY=...``.

    Raises
    ------
    FieldError

    """
    key, equals, what = text.partition('=')
    if not (key and equals):
        raise FieldError(f'KEY=VALUES, where VALUES is one of {FORMS}', repr(text),
                         path=('vary',))
    return variation(key.strip(), what.strip())


def variation(key, what):
    """
    Return what varies one key.

    Raises
    ------
    FieldError

    """
    with at(key):
        if not isinstance(what, str):
            values = np.atleast_1d(np.asarray(what, dtype=float))
            if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
                raise FieldError('finite numbers', repr(what))
            return Grid(key, tuple(values.tolist()))
        word, colon, rest = what.partition(':')
        if word in DISTRIBUTIONS:
            return _random(key, word, rest)
        if not colon:
            return Grid(key, tuple(_number(part, what) for part in what.split(',')))
        if not _is_number(word):
            raise FieldError(FORMS, repr(what), nearest(word, DISTRIBUTIONS))
        return Grid(key, _spaced(what))


def _spaced(what):
    """Return the values of FROM:TO:COUNT."""
    parts = what.split(':')
    if len(parts) != 3:
        raise FieldError(RANGE, repr(what), 'COUNT values from FROM to TO, both included')
    first, last = (_number(part, what) for part in parts[:2])
    count = _number(parts[2], what)
    if count != int(count) or not 1 <= count <= MOST_VALUES:
        raise FieldError(f'a whole COUNT from 1 to {MOST_VALUES} in {RANGE}', repr(parts[2]))
    return tuple(np.linspace(first, last, int(count)).tolist())


def _random(key, name, rest):
    """Return what draws from a distribution."""
    form = f'{name}:{DISTRIBUTIONS[name][0]}'
    parts = rest.split(':')
    if len(parts) != 2:
        raise FieldError(form, repr(f'{name}:{rest}'))
    first, second = (_number(part, f'{name}:{rest}') for part in parts)
    if name == 'normal':
        if second < 0.0:
            raise FieldError(f'a DEVIATION that is zero or more in {form}', repr(parts[1]))
    elif not first <= second:
        raise FieldError(f'FROM no larger than TO in {form}', repr(rest))
    if name == 'loguniform' and not first > 0.0:
        raise FieldError(f'FROM larger than zero in {form}', repr(parts[0]))
    return Random(key, name, first, second)


def _is_number(text):
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _number(text, whole):
    if not _is_number(text):
        raise FieldError('finite numbers', f'{text!r} in {whole!r}', f'the forms are {FORMS}')
    return float(text)
