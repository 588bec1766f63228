# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A sweep as data: every sample's numbers follow from its place in it.

What is varied is written ``KEY=1:5:9``, ``KEY=1,2,5`` or ``KEY=normal:4:0.2``. Evenly spaced and
listed values span a grid; distributions are drawn from, with a generator of its own for each key,
so that one more key changes the draws of none.
"""

from dataclasses import dataclass
from functools import cached_property
import hashlib
import math
from typing import Optional, Tuple
from zlib import crc32

import numpy as np

from ..mechanism.fields import among, at, FieldError, nearest
from ..scene.key_paths import resolve
from ..scene.records import Scene
from ..simulation.rollout_run import checked_quantities, STATE, TimeGrid

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
MOST_GRID_VALUES = 10_000_000


@dataclass(frozen=True)
class Grid:
    """Values that are combined with those of the other grids."""

    key: str  # Key path
    values: Tuple[float, ...]

    random = False


@dataclass(frozen=True)
class Random:
    """A distribution that is drawn from."""

    key: str  # Key path
    distribution: str  # Of ``DISTRIBUTIONS``
    # Its two numbers.
    first: float
    second: float

    random = True

    def draws(self, count, seed):
        """Draw so many numbers, shape (count,)."""
        rng = np.random.default_rng([seed, crc32(self.key.encode())])
        return DISTRIBUTIONS[self.distribution][1](rng, self.first, self.second, count)


def parse(text):
    """Read ``KEY=...``; raise FieldError where that makes no sense."""
    key, equals, what = text.partition('=')
    if not (key and equals):
        raise FieldError(f'KEY=VALUES, where VALUES is one of {FORMS}', repr(text),
                         path=('vary',))
    return variation(key.strip(), what.strip())


def variation(key, what):
    """Return the variation of one key; raise FieldError for a wrong text."""
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
    if count != int(count) or not 1 <= count <= MOST_GRID_VALUES:
        raise FieldError(f'a whole COUNT from 1 to {MOST_GRID_VALUES} in {RANGE}', repr(parts[2]))
    return tuple(np.linspace(first, last, int(count)).tolist())


def _random(key, name, rest):
    """Return a function that draws from a distribution."""
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


TORQUE = 'torque'


@dataclass(frozen=True)
class Plan:
    """All that decides the results of a sweep."""

    scene: Scene  # What the samples have in common
    variations: Tuple = ()  # What they differ in
    draws: int = 1  # From the distributions, at each point of the grid
    seed: int = 0  # Of the draws
    duration: float = 2.0  # [s]
    rate: float = 100.0  # Instants per second [Hz]
    # Shape (rows, na): of the actuated joints [N m or N], for equal parts of the duration;
    # none where None.
    torques: Optional[np.ndarray] = None
    keep: Tuple[str, ...] = STATE  # Of ``rollout_run.QUANTITIES``, at every instant

    def __post_init__(self):
        """Refuse a plan that fails for every sample."""
        object.__setattr__(self, 'keep', checked_quantities(self.keep))
        keys = [variation.key for variation in self.variations]
        for key in keys:
            if keys.count(key) > 1:
                raise FieldError('it varied once', f'it {keys.count(key)} times', path=(key,))
        for name, lowest in (('draws', 1), ('seed', 0)):
            if getattr(self, name) < lowest:
                raise FieldError(f'a whole number, {lowest} or more', repr(getattr(self, name)),
                                 path=('samples' if name == 'draws' else name,))
        if self.draws > 1 and not any(each.random for each in self.variations):
            raise FieldError('a distribution to draw from, such as KEY=uniform:FROM:TO, or 1',
                             str(self.draws), 'a grid alone has one sample at each point',
                             ('samples',))
        self.paths, self.schedule, self._check_torques()

    @cached_property
    def paths(self):
        """Return the keys of each varied key path; a torque's is ('torque', joint)."""
        return tuple(self._path(variation.key) for variation in self.variations)

    def _path(self, key):
        word, _, joint = key.partition('.')
        if word != TORQUE:
            return resolve(self.scene, key)
        joints = self.scene.mechanism.actuated_joints
        if joint not in joints:
            raise FieldError(f'{TORQUE}. and one of the actuated joints {among(joints)}',
                             repr(joint), nearest(joint, joints), (key,))
        if self.torques is not None and self.torques.shape[-2] > 1:
            raise FieldError('constant torques where one is varied', 'sequences of them',
                             path=(key,))
        return TORQUE, joint

    @property
    def shape(self):
        """Return the lengths of the grids."""
        return tuple(len(each.values) for each in self.variations if not each.random)

    @property
    def samples(self):
        """Return how many there are: the points of the grid times the draws."""
        return math.prod(self.shape) * self.draws

    @cached_property
    def _columns(self):
        return [each.draws(self.draws, self.seed) if each.random else np.array(each.values)
                for each in self.variations]

    def values(self, samples):
        """Return the varied numbers of some samples, shape (samples, variations)."""
        samples = np.asarray(samples, dtype=int)
        points = iter(np.unravel_index(samples // self.draws, self.shape) if self.shape else ())
        return np.array([
            column[samples % self.draws if each.random else next(points)]
            for each, column in zip(self.variations, self._columns)],
            dtype=float).reshape(len(self.variations), len(samples)).T

    def torques_of(self, samples):
        """Return the torques of some samples, or those of all, or None."""
        if self.torques is None or self.torques.ndim == 2:
            return self.torques
        return self.torques[np.asarray(samples, dtype=int)]

    @cached_property
    def schedule(self):
        """Return when torques change and instants are kept: a ``rollout_run.TimeGrid``."""
        for name in ('duration', 'rate'):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise FieldError('a finite number > 0', repr(value), path=(name,))
        instants = _whole(self.duration * self.rate)
        if not instants:
            raise FieldError(f'a multiple of the time between two instants, {1 / self.rate:g} s',
                             f'{self.duration:g}', path=('duration',))
        rows = 1 if self.torques is None else self.torques.shape[-2]
        finest, coarsest = max(instants, rows), min(instants, rows)
        if finest % coarsest:
            raise FieldError(
                f'as many rows as there are instants ({instants}), or a multiple or a whole part '
                'of that', str(rows), path=('torques',))
        interval = 1.0 / self.rate if instants >= rows else self.duration / rows
        return TimeGrid(interval, finest, finest // rows, finest // instants)

    @property
    def times(self):
        """Return the times of the instants [s]."""
        return np.arange(self.schedule.instants) / self.rate

    def _check_torques(self):
        if self.torques is None:
            return
        count = len(self.scene.mechanism.actuated_joints)
        shape = self.torques.shape
        if len(shape) not in (2, 3) or shape[-1] != count or (
                len(shape) == 3 and shape[0] != self.samples):
            raise FieldError(
                f'shape (rows, {count}) or ({self.samples} samples, rows, {count}), with the '
                'actuated joints last', str(shape), path=('torques',))
        if not np.isfinite(self.torques).all():
            raise FieldError('finite numbers', 'others among them', path=('torques',))

    def identity(self):
        """Return plain data that identifies a sweep's results."""
        torques = b'' if self.torques is None else np.ascontiguousarray(self.torques).tobytes()
        return {
            'scene': self.scene.name,
            'contents of scene and mechanism': self.scene.digest(),
            'vary': '; '.join(map(repr, self.variations)),
            'samples': str(self.draws), 'seed': str(self.seed),
            'duration': repr(self.duration), 'rate': repr(self.rate),
            'torques': _digest(torques), 'keep': ', '.join(self.keep)}


def combined(torque, torques, scene):
    """
    Return constant torques by actuated joint, or sequences of them, as an array; None: neither.

    Raises FieldError for both, and for joints that are not actuated.
    """
    if torques is not None:
        if torque:
            raise FieldError('either constant torques or sequences', 'both', path=('torques',))
        return np.asarray(torques, dtype=float)
    if not torque:
        return None
    joints = scene.mechanism.actuated_joints
    row = np.zeros((1, len(joints)))
    for joint, value in torque.items():
        with at('torque'):
            if joint not in joints:
                raise FieldError(f'one of the actuated joints {among(joints)}', repr(joint),
                                 nearest(joint, joints))
        row[0, joints.index(joint)] = value
    return row


def _whole(value):
    """Return a whole number that a value is but for rounding, or 0."""
    whole = round(value)
    return whole if abs(whole - value) <= 1e-9 * max(value, 1.0) else 0


def _digest(data):
    return hashlib.sha256(data).hexdigest()[:16] if data else 'none'
