# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Curves of bodies: the outline of a cam, the slots of a wheel; and how far from them a point is.

A curve is a chain of pieces (x, y)(u), cubics in 0 <= u <= 1, whose free side is on the left. It
is straight between its points, or a cubic spline.
"""


import numpy as np

from ..mechanism.checks import positive
from ..mechanism.expressions import Parameters
from ..mechanism.fields import FieldError, shown

# Numbers of a piece: x = c0 + u (c1 + u (c2 + u c3)), and y.
COLUMNS = 8
# Points of a curve given by an expression: a spline is within some 1e-9 of it.
POLAR_POINTS = 360
# Radii after a whole turn, beside the first one, that are the same: rounding of sines of 2 pi.
SAME_RADIUS = 1e-9
# Points of a curve, at most; and how finely its splines are looked at for crossings.
MOST_POINTS, FINENESS = 2000, 8
# An area between places in one line, beside the square of how far they are apart.
TOUCHING = 1e-12
# A valley of less than this below an end of a path is no other place than that end [m].
SHALLOW = 1e-9


def pieces(x, y, closed, interpolation, hollow):
    """
    Return the pieces, rows of COLUMNS floats, of a curve through points in the body's frame [m].

    A closed curve ends where it begins; its first point is not repeated. ``interpolation``:
    ``'linear'`` or ``'cubic'``; ``hollow``: whether the inside of a closed curve is free, of an
    open one its right. FieldError.
    """
    points = _checked_points(x, y, closed)
    if closed:
        x, y = points.T
        turns_left = np.dot(x, np.roll(y, -1)) > np.dot(y, np.roll(x, -1))
        backwards = turns_left != hollow
    else:
        backwards = hollow
    if backwards:
        points = points[::-1]
    ends = np.vstack((points, points[:1])) if closed else points
    _require_comparable(ends)
    rows = straight(ends) if interpolation == 'linear' else _spline(ends, closed)
    _require_no_crossing(rows, closed, 1 if interpolation == 'linear' else FINENESS)
    return tuple(tuple(map(float, row)) for row in rows)


def polar(radii):
    """Return the points of a closed curve from its radii at even angles, the first along x."""
    angles = 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    return np.asarray(radii) * np.cos(angles), np.asarray(radii) * np.sin(angles)


def radii_of(text):
    """
    Return the radii at POLAR_POINTS even angles of an expression in the angle ``a`` [rad].

    FieldError where it is none, not positive everywhere, or another one after a whole turn.
    """
    *radii, after = (positive(Parameters({'a': angle}).evaluated(text))
                     for angle in 2.0 * np.pi * np.arange(POLAR_POINTS + 1) / POLAR_POINTS)
    jump = after - radii[0]
    if abs(jump) > SAME_RADIUS * radii[0]:
        raise FieldError(
            'a radius that is the same again after a whole turn of a',
            f'{shown(text)}, which jumps by {jump:.6g} m there, from {after:.6g} to '
            f'{radii[0]:.6g} m', 'a spiral is an open curve of x and y')
    return tuple(radii)


def _checked_points(x, y, closed):
    least = 3 if closed else 2
    if not least <= len(x) <= MOST_POINTS:
        raise FieldError(f'{least} to {MOST_POINTS} points', f'{len(x)}', path=('x',))
    if len(y) != len(x):
        raise FieldError(f'{len(x)} numbers, one for each x', f'{len(y)}', path=('y',))
    points = np.column_stack((x, y)).astype(float)
    following = np.roll(points, -1, axis=0) if closed else points[1:]
    for index, (one, other) in enumerate(zip(points, following)):
        if (one == other).all():
            raise FieldError('points that differ from the ones before them',
                             f'[{one[0]:g}, {one[1]:g}] twice',
                             'the first point of a closed curve is not repeated',
                             path=('x', index))
    return points


def _require_comparable(points):
    """Refuse points some of which coincide beside the length of the curve, as 0.1 and 1e20 do."""
    with np.errstate(over='ignore'):
        length = np.cumsum(np.hypot(*np.diff(points, axis=0).T))
        overflows = not np.isfinite(length[-1] ** 2)
    if overflows or not (np.diff(length, prepend=0.0) > 0.0).all():
        far = points[np.argmax(np.abs(points).max(axis=1))]
        raise FieldError('points of one curve, no further apart than double precision compares',
                         f'[{far[0]:g}, {far[1]:g}] among them', path=('x',))


def straight(ends):
    rows = np.zeros((len(ends) - 1, COLUMNS))
    rows[:, [0, 4]], rows[:, [1, 5]] = ends[:-1], np.diff(ends, axis=0)
    return rows


def _spline(ends, closed):
    """Return the pieces of a spline over the length of the chords, scaled to 0 <= u <= 1."""
    # Not before it is wanted: it takes a third of the time that loading the package would.
    from scipy.interpolate import CubicSpline
    chords = np.hypot(*np.diff(ends, axis=0).T)
    length = np.concatenate(([0.0], np.cumsum(chords)))
    spline = CubicSpline(length, ends, bc_type='periodic' if closed else 'not-a-knot')
    # Coefficients by falling powers, of pieces, of x and y.
    scaled = spline.c[::-1] * chords[:, None] ** np.arange(4)[:, None, None]
    return np.concatenate((scaled[:, :, 0], scaled[:, :, 1])).T


def _require_no_crossing(rows, closed, fineness):
    """Refuse a curve that crosses or touches itself."""
    u = np.arange(fineness)[:, None] / fineness
    x, y = (sum(rows[:, first + k] * u ** k for k in range(4)).T.ravel() for first in (0, 4))
    end = rows[-1, :4].sum(), rows[-1, 4:].sum()
    start = np.column_stack((x, y))
    stop = np.vstack((start[1:], end))
    # In one line, pieces meet where their boxes do; others have to have boxes that do.
    low, high = np.minimum(start, stop), np.maximum(start, stop)
    size, count = np.abs(stop - start).max(axis=1), len(start)
    for k in range(count - 2):
        others = slice(k + 2, count - 1 if closed and k == 0 else count)
        near = ((high[others] >= low[k]) & (low[others] <= high[k])).all(axis=1)
        if near.any() and _crosses(
                start[k], stop[k], start[others][near], stop[others][near],
                TOUCHING * max(size[k], size[others].max()) ** 2).any():
            where = start[k]
            raise FieldError('a curve that does not cross itself',
                             f'one that does near [{where[0]:g}, {where[1]:g}]', path=('x',))


def _crosses(a, b, c, d, least):
    """Return for each piece from c to d whether it crosses that from a to b, boxes that meet."""
    def side(p, q, r):
        area = (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (
            q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
        return np.where(np.abs(area) < least, 0.0, area)

    return (side(a, b, c) * side(a, b, d) <= 0.0) & (side(c, d, a) * side(c, d, b) <= 0.0)
