# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The search for the nearest piece of a curve, beside one that looks at all."""

import ctypes

from closedloop_dynamics.codegen.function_table import NEAREST, PRESENT_COLUMNS
from closedloop_dynamics.effects.curve import pieces
from closedloop_dynamics.engine import native
import numpy as np
import pytest

LINE = np.linspace(0.0, 1.0, 2001)
# As generated code calls it.
_POINTER = np.ctypeslib.ndpointer(dtype=float)
SEARCH = ctypes.CFUNCTYPE(
    ctypes.c_double, _POINTER, _POINTER, *[ctypes.c_double] * 4, _POINTER)(
        native.library_function(NEAREST))


def distance_from(rows, closed, memory, x, y):
    """Return the normal to the free side of a curve, and the distance of a point from it."""
    normal = np.zeros(2)
    distance = SEARCH(rows, memory, rows.size, closed, x, y, normal)
    return *normal, distance


def forgotten():
    """Return a memory without anything in it."""
    return np.full(PRESENT_COLUMNS, np.nan)


def curve(random, closed, interpolation):
    """Return the pieces of a wavy curve, shape (number of pieces, 8)."""
    count = int(random.integers(3, 90))
    angles = 2.0 * np.pi * np.arange(count) / count
    radii = 0.05 * (1.0 + 0.3 * np.cos(3.0 * angles + random.uniform(0.0, 6.0))
                    + random.uniform(-0.05, 0.05, count))
    return np.array(pieces(
        radii * np.cos(angles), radii * np.sin(angles), closed, interpolation, False))


def walk(random):
    """Return places that move little, then in leaps, near the curve and far from it."""
    place, found = random.uniform(-0.08, 0.08, 2), []
    for step in np.repeat([1e-5, 1e-3, 0.1, 1e-4, 1.0, 1e-3], 40):
        place = place + random.normal(scale=step, size=2)
        found.append(place.tolist())
    return found


@pytest.mark.parametrize('closed, interpolation', [
    (True, 'linear'), (True, 'cubic'), (False, 'linear'), (False, 'cubic')])
@pytest.mark.parametrize('seed', range(8))
def test_what_is_remembered_changes_nothing(closed, interpolation, seed):
    random = np.random.default_rng(seed)
    rows, memory = curve(random, closed, interpolation), forgotten()
    for x, y in walk(random):
        found = distance_from(rows, closed, memory, x, y)
        assert found == distance_from(rows, closed, forgotten(), x, y)


@pytest.mark.parametrize('interpolation', ['linear', 'cubic'])
@pytest.mark.parametrize('seed', range(4))
def test_what_is_remembered_changes_nothing_along_a_curve(interpolation, seed):
    """As rollers go round, beside, on and in it, and again where they were; at times they leap."""
    random = np.random.default_rng(300 + seed)
    rows, memory = curve(random, True, interpolation), forgotten()
    for first in random.uniform(0.0, 6.0, 3):
        height = random.uniform(0.03, 0.08)
        for angle in np.repeat(first + np.linspace(0.0, 1.0, 300), 2):
            x, y = height * np.cos(angle), height * np.sin(angle)
            found = distance_from(rows, True, memory, x, y)
            assert found == distance_from(rows, True, forgotten(), x, y)


@pytest.mark.parametrize('closed', [True, False])
@pytest.mark.parametrize('seed', range(4))
def test_no_place_of_a_straight_piece_is_nearer(closed, seed):
    random = np.random.default_rng(100 + seed)
    rows, memory = curve(random, closed, 'linear'), forgotten()
    starts, ways = rows[:, [0, 4]], rows[:, [1, 5]]
    for place in walk(random):
        share = np.clip(((place - starts) * ways).sum(axis=1) / (ways ** 2).sum(axis=1), 0.0, 1.0)
        expected = np.hypot(*(place - starts - share[:, None] * ways).T).min()
        *_, distance = distance_from(rows, closed, memory, *place)
        assert abs(distance) == pytest.approx(expected, rel=1e-12, abs=1e-16)


@pytest.mark.parametrize('seed', range(3))
def test_no_place_of_a_smooth_curve_is_nearer(seed):
    """A few millimetres beside, as rollers are; many places of each piece are compared."""
    random = np.random.default_rng(200 + seed)
    angles = 2.0 * np.pi * np.arange(60) / 60
    radii = 0.05 + 0.004 * np.cos(2.0 * angles)
    rows, memory = np.array(pieces(radii * np.cos(angles), radii * np.sin(angles), True, 'cubic',
                                   False)), forgotten()
    powers = LINE[:, None] ** np.arange(4)
    x, y = rows[:, :4] @ powers.T, rows[:, 4:] @ powers.T
    for angle in np.cumsum(random.normal(scale=0.05, size=200)):
        height = 0.058 + random.uniform(0.0, 0.01)
        place = height * np.cos(angle), height * np.sin(angle)
        *_, distance = distance_from(rows, True, memory, *place)
        # Between two of these places the distance falls by less than their own squared.
        assert distance == pytest.approx(
            np.hypot(x - place[0], y - place[1]).min(), abs=1e-9)
