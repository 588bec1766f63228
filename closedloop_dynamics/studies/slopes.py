# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Numbers with derivatives by the variables, and the functions of expressions on them.

Forward mode: every operation carries the derivatives of its operands along, by the chain rule.
With no derivatives (k = 0) the same operations return the values alone.
"""

import operator

import numpy as np

from ..mechanism.expressions import FUNCTIONS, ON_NUMBERS
from ..mechanism.fields import FieldError

# Places between two poses at which the nearest place of a curve is looked for, and corrections.
BETWEEN, CORRECTIONS = 4, 20
# Functions of one number: function, derivative by the operand x and the value f.
_OF_ONE = {
    'sin': (np.sin, lambda x, f: np.cos(x)), 'cos': (np.cos, lambda x, f: -np.sin(x)),
    'tan': (np.tan, lambda x, f: 1.0 + f * f),
    'asin': (np.arcsin, lambda x, f: 1.0 / np.sqrt(1.0 - x * x)),
    'acos': (np.arccos, lambda x, f: -1.0 / np.sqrt(1.0 - x * x)),
    'atan': (np.arctan, lambda x, f: 1.0 / (1.0 + x * x)),
    'sqrt': (np.sqrt, lambda x, f: 0.5 / f), 'exp': (np.exp, lambda x, f: f),
    'log': (np.log, lambda x, f: 1.0 / x),
    'radians': (np.radians, lambda x, f: np.full_like(x, np.pi / 180.0)),
    'degrees': (np.degrees, lambda x, f: np.full_like(x, 180.0 / np.pi)),
    'abs': (np.abs, lambda x, f: np.sign(x))}


class Slope:
    """
    Numbers and their derivatives.

    ``value``, shape S: one number, (), or one at each pose, (n,); ``slope``, shape (*S, k): by k
    numbers that are varied.
    """

    __slots__ = ('value', 'slope')

    def __init__(self, value, slope):
        self.value, self.slope = np.asarray(value, dtype=float), slope

    def part(self, places):
        """Return some of several numbers."""
        return Slope(self.value[places], self.slope[places])

    def _with(self, value, derivative):
        return Slope(value, np.asarray(derivative)[..., np.newaxis] * self.slope)

    def __add__(self, other):
        return _of_two(operator.add, lambda x, y: (np.ones_like(x), np.ones_like(y)), self, other)

    __radd__ = __add__

    def __sub__(self, other):
        return self + -other

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        return _of_two(operator.mul, lambda x, y: (y, x), self, other)

    __rmul__ = __mul__

    def __truediv__(self, other):
        return _of_two(operator.truediv, lambda x, y: (1.0 / y, -x / (y * y)), self, other)

    def __rtruediv__(self, other):
        return _of_two(operator.truediv, lambda x, y: (1.0 / y, -x / (y * y)), other, self)

    def __pow__(self, exponent):
        if isinstance(exponent, Slope):
            return ON_SLOPES['exp'](ON_SLOPES['log'](self) * exponent)
        value = self.value ** exponent
        return self._with(value, exponent * self.value ** (exponent - 1.0) if exponent else (
            np.zeros_like(self.value)))

    def __rpow__(self, base):
        value = base ** self.value
        return self._with(value, value * np.log(base))

    def __neg__(self):
        return Slope(-self.value, -self.slope)

    def __pos__(self):
        return self


class Magnitude(Slope):
    """
    Lengths of vectors, which are not smooth where these are zero, as the components are.

    ``parts``, of shape (n, number of components).
    """

    __slots__ = ('parts',)

    def __init__(self, parts):
        """Find the lengths; the derivative of a zero is zero."""
        size = np.linalg.norm(parts.value, axis=1)
        unit = parts.value / np.where(size > 0.0, size, 1.0)[:, np.newaxis]
        super().__init__(size, np.einsum('ni,nik->nk', unit, parts.slope))
        self.parts = parts

    def part(self, places):
        """Return some of several."""
        if np.ndim(self.value[places]):
            return Magnitude(self.parts.part(places))
        return super().part(places)


class Path:
    """Where a point is at each pose, shape (n, 2), in space (n, 3) [m]; no number."""

    __slots__ = ('places',)

    def __init__(self, places):
        self.places = places


def _of_two(function, derivatives, one, other):
    """Return a function of two, of which one at least has derivatives."""
    (x, dx), (y, dy) = (
        (each.value, each.slope) if isinstance(each, Slope) else (np.asarray(each, dtype=float),
                                                                  None)
        for each in (one, other))
    shape = np.broadcast_shapes(x.shape, y.shape)
    by_x, by_y = (np.broadcast_to(each, shape)[..., np.newaxis] for each in derivatives(x, y))
    slope = sum(by * each for by, each in ((by_x, dx), (by_y, dy)) if each is not None)
    return Slope(function(x, y), slope)


def _called(name, *operands):
    """Return a function of one or two numbers, of which some may have derivatives."""
    for each in operands:
        if isinstance(each, Path):
            raise TypeError
    if not any(isinstance(each, Slope) for each in operands):
        return ON_NUMBERS[name](*operands)
    if name in _OF_ONE:
        function, derivative = _OF_ONE[name]
        value = function(operands[0].value)
        if not operands[0].slope.shape[-1]:
            return Slope(value, operands[0].slope)
        return operands[0]._with(value, derivative(operands[0].value, value))
    return _of_two(*_OF_TWO[name], *operands)


def _of_length(x, y):
    length = np.hypot(x, y)
    # At zero, its least value, any direction would do.
    safe = np.where(length > 0.0, length, 1.0)
    return x / safe, y / safe


_OF_TWO = {
    'atan2': (np.arctan2, lambda y, x: (x / (x * x + y * y), -y / (x * x + y * y))),
    'hypot': (np.hypot, _of_length),
    'min': (np.minimum, lambda x, y: (np.asarray(x <= y, float), np.asarray(x > y, float))),
    'max': (np.maximum, lambda x, y: (np.asarray(x >= y, float), np.asarray(x < y, float)))}


def _several(x, function):
    """Return numbers at poses; raise for anything else."""
    if not isinstance(x, Slope) or x.value.ndim != 1:
        raise FieldError(f'{function} of a quantity over the motion', 'one of a single number or '
                         'a point')
    return x


def largest(x, pick=np.argmax):
    """Return the largest of the values over a motion, or the one picked."""
    x = _several(x, 'max or min')
    return x.part(int(pick(x.value)))


def _least(x):
    return largest(x, np.argmin)


def weights(count):
    """Return the weights of a mean over equally long steps, by the trapezoidal rule."""
    found = np.ones(count)
    found[[0, -1]] = 0.5
    return found / found.sum()


def mean(x):
    """Return the mean over a motion."""
    x = _several(x, 'mean')
    share = weights(len(x.value))
    return Slope(share @ x.value, share @ x.slope)


def length(x):
    """Return the length of a vector of numbers; its derivative at zero is zero."""
    size = np.linalg.norm(x.value)
    return Slope(size, x.value @ x.slope / size if size else np.zeros(x.slope.shape[-1]))


def squared_parts(x):
    """Return numbers whose length is the root of the mean square over a motion."""
    x = _several(x, 'rms')
    parts = x.parts if isinstance(x, Magnitude) else x
    share = np.sqrt(weights(len(x.value)))
    value, slope = (np.einsum('n,n...->n...', share, each)
                    for each in (parts.value, parts.slope))
    return Slope(value.ravel(), slope.reshape(value.size, slope.shape[-1]))


def _path(x, function):
    if not isinstance(x, Path):
        raise FieldError(f'{function} of a point', 'one of a number')
    return x.places


def deviation(path):
    """
    Return the distances of a path from the straight line nearest to it, shape (n,) [m].

    The line goes through the mean of all places along the eigenvector of their covariance with
    the largest eigenvalue; how that turns is known from all eigenvectors and eigenvalues.
    """
    places = _path(path, 'deviation')
    from_mean = places.value - places.value.mean(axis=0)
    moves = places.slope - places.slope.mean(axis=0)
    values, vectors = np.linalg.eigh(from_mean.T @ from_mean)
    along, others = vectors[:, -1], vectors[:, :-1]
    # The derivative of the covariance, times the line's direction.
    turn = np.einsum('nik,n->ik', moves, from_mean @ along) + np.einsum(
        'ni,njk,j->ik', from_mean, moves, along)
    turning = others / (values[-1] - values[:-1]) @ (others.T @ turn)
    across = from_mean @ others
    change = np.einsum('ij,nik->njk', others, moves) - np.einsum(
        'n,ij,ik->njk', from_mean @ along, others, turning)
    size = np.linalg.norm(across, axis=1)
    unit = across / np.where(size > 0.0, size, 1.0)[:, np.newaxis]
    return Slope(size, np.einsum('nj,njk->nk', unit, change))


def misses(path, wanted):
    """
    Return the distances of wanted places from the curve that a point draws, shape (m,) [m].

    Between the poses the curve is a cubic spline through them; places have the shape (m, 2), in
    space (m, 3). In the plane, distances have signs, by which side of the curve a place is on.
    """
    from scipy.interpolate import CubicSpline
    places = _path(path, 'distance')
    count, size = places.value.shape
    if wanted.shape[1] != size:
        raise FieldError(f'places of {size} coordinates', f'some of {wanted.shape[1]}')
    closed = np.abs(places.value[0] - places.value[-1]).max() <= 1e-9 * np.ptp(places.value)
    ends = places.value.copy()
    ends[-1] = ends[0] if closed else ends[-1]
    kind = 'periodic' if closed else 'not-a-knot'
    at = np.arange(count, dtype=float)
    curve = CubicSpline(at, ends, bc_type=kind)
    tries = np.linspace(0.0, count - 1.0, BETWEEN * (count - 1) + 1)
    apart = np.linalg.norm(curve(tries) - wanted[:, np.newaxis], axis=2)
    place = tries[apart.argmin(axis=1)]
    for _ in range(CORRECTIONS):
        gap, way, second = curve(place) - wanted, curve(place, 1), curve(place, 2)
        steep = np.einsum('mi,mi->m', way, way)
        down = steep + np.einsum('mi,mi->m', gap, second)
        # Newton's method where the distance has a minimum nearby, Gauss's elsewhere.
        step = -np.einsum('mi,mi->m', gap, way) / np.where(down > 0.1 * steep, down, np.where(
            steep > 0.0, steep, 1.0))
        moved = place + np.clip(step, -0.5 / BETWEEN, 0.5 / BETWEEN)
        moved = moved % (count - 1.0) if closed else np.clip(moved, 0.0, count - 1.0)
        place, last = moved, place
        if np.abs(place - last).max() < 1e-12:
            break
    gap, way = wanted - curve(place), curve(place, 1)
    size_of = np.linalg.norm(gap, axis=1)
    unit = gap / np.where(size_of > 0.0, size_of, 1.0)[:, np.newaxis]
    if size == 2:
        normal = np.stack([-way[:, 1], way[:, 0]], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, np.newaxis]
        # Beyond an open end the nearest place is not a foot of a perpendicular.
        foot = np.ones(len(place), bool) if closed else (place > 0.0) & (place < count - 1.0)
        size_of = np.where(foot, np.einsum('mi,mi->m', normal, gap), size_of)
        unit = np.where(foot[:, np.newaxis], normal, unit)
    if not places.slope.shape[-1]:
        return Slope(size_of, np.zeros((len(wanted), 0)))
    moves = places.slope.copy()
    moves[-1] = moves[0] if closed else moves[-1]
    # The place moves along the curve, which changes no distance.
    moved = CubicSpline(at, moves, bc_type=kind)(place)
    return Slope(size_of, -np.einsum('mi,mik->mk', unit, moved))


def distance_parts(path, wanted):
    """Return numbers whose length is the root of the mean square of ``misses``."""
    found = misses(path, wanted)
    share = len(wanted) ** -0.5
    return Slope(share * found.value, share * found.slope)


def _max_or(name, pick):
    def called(x, *other):
        return _called(name, x, *other) if other else largest(x, pick)
    return called


ON_SLOPES = {
    **{name: (lambda *operands, name=name: _called(name, *operands)) for name in FUNCTIONS},
    'max': _max_or('max', np.argmax), 'min': _max_or('min', np.argmin),
    'mean': mean, 'rms': lambda x: length(squared_parts(x)), 'deviation': deviation,
    'straightness': lambda path: largest(deviation(path)),
    'distance': lambda path, wanted: length(distance_parts(path, wanted))}
# How many operands they may take; part is that of one motion (quantities.py).
TAKES = {**FUNCTIONS, 'max': (1, 2), 'min': (1, 2), 'mean': (1,), 'rms': (1,), 'deviation': (1,),
         'straightness': (1,), 'distance': (2,), 'part': (3,)}
