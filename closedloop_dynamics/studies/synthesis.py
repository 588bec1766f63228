# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Synthesis of four-bars and slider-cranks by precision positions: path, function and motion.

Places are complex numbers. A linkage is its pins in the first position, A0 and A of the crank, B
of the coupler, B0 of the rocker or the direction of the rail; with the crank turned, B is on the
side of A that it was on, so that no branch is changed. Three pairs of angles are met by
Freudenstein's equation (1955), three poses by the circles through the places of two given pins;
otherwise least squares from many starts find the pins: up to five positions exactly, in general,
further ones as nearly as can be. What takes the positions in another order, on another branch, or
cannot be turned from each to the next, is left out and counted.
"""

from itertools import permutations
from math import inf
from typing import List, NamedTuple, Optional, Tuple

import numpy as np

from ..effects.gravity import Gravity
from ..mechanism.mechanism import (
    Body, CutJoint, GROUND, Joint, Mechanism, Point, PRISMATIC, REVOLUTE)
from ..scene.records import Initial, Method, Scene

FOUR_BAR, SLIDER_CRANK = 'four_bar', 'slider_crank'
# Positions that are met exactly; the error of what is [sizes of the task].
MOST_EXACT, EXACT = 5, 1e-8
STARTS = 150
# Longest link against the shortest one, and the size of the task against the longest.
MOST_RATIO, LARGEST = 20.0, 10.0
# Positions between two, in which the linkage must close.
BETWEEN = 60
# Linear density of the rods [kg/m], mass of a slider [kg].
LINE, SLIDER = 1.0, 0.5
# Share of a length within which two linkages are the same.
SAME = 1e-4


class SynthesisError(ValueError):
    """No linkage was found, or the task makes no sense."""


class Linkage(NamedTuple):
    """A linkage in the first of its positions, places as complex numbers [m]."""

    crank: complex  # A0, the pivot
    pin: complex  # A, of crank and coupler
    end: complex  # B, of coupler and rocker or slider
    #: B0, the pivot of the rocker; None for a slider.
    pivot: Optional[complex]
    rail: complex  # Direction in which the slider goes, of length 1
    traced: complex  # The point of the coupler
    turns: Tuple[float, ...] = ()  # Of the crank from the first position to each [rad]
    error: float = inf  # Largest one in the positions [m or rad]
    transmission: float = 0.0  # Least transmission angle from the first to the last position [rad]

    def at(self, turns):
        """
        Return where A, B and the point are with the crank turned, shape (n,), and what is missing.

        What coupler and rocker lack to meet, against the coupler [m]; 0 where they meet.
        """
        pin = self.crank + (self.pin - self.crank) * np.exp(1j * np.asarray(turns, dtype=float))
        length = abs(self.end - self.pin)
        if self.pivot is None:
            # In axes along the rail.
            side = (pin - self.end) / self.rail
            branch = np.sign(((self.end - self.pin) / self.rail).real) or 1.0
            square = length ** 2 - side.imag ** 2
            end = self.end + self.rail * (side.real + branch * np.sqrt(np.maximum(square, 0.0)))
        else:
            base, rocker = self.pivot - pin, abs(self.end - self.pivot)
            apart = np.maximum(np.abs(base), 1e-300)
            along = (length ** 2 - rocker ** 2 + apart ** 2) / (2.0 * apart)
            branch = np.sign(((self.end - self.pin) / (self.pivot - self.pin)).imag) or 1.0
            square = length ** 2 - along ** 2
            end = pin + base / apart * (along + 1j * branch * np.sqrt(np.maximum(square, 0.0)))
        turned = (end - pin) / (self.end - self.pin)
        missing = np.sqrt(np.maximum(-square, 0.0))
        return pin, end, pin + turned * (self.traced - self.pin), missing

    @property
    def lengths(self):
        """Return the lengths of base, crank, coupler, rocker; of a slider-crank the middle two."""
        links = [abs(self.pin - self.crank), abs(self.end - self.pin)]
        if self.pivot is None:
            return links
        return [abs(self.pivot - self.crank), *links, abs(self.end - self.pivot)]

    def scene(self, name, description=''):
        """Return the linkage as a scene of uniform rods under gravity, ready to simulate."""
        arms = [self.pin - self.crank, self.end - self.pin]
        angles = [np.angle(arms[0]), np.angle(arms[1] / arms[0])]
        crank, coupler = map(abs, arms)
        traced = (self.traced - self.pin) * coupler / arms[1]
        joints = [Joint('input_joint', REVOLUTE, GROUND, 'input', _pair(self.crank),
                        actuated=True),
                  Joint('coupler_joint', REVOLUTE, 'input', 'coupler', (crank, 0.0))]
        if self.pivot is None:
            last = Body('slider', SLIDER, (0.0, 0.0), SLIDER * crank ** 2)
            joints.append(Joint('output_joint', PRISMATIC, GROUND, 'slider', _pair(self.end),
                                angle=float(np.angle(self.rail))))
            at_end, angle = 0.0, 0.0
        else:
            at_end, angle = abs(self.end - self.pivot), np.angle(self.end - self.pivot)
            last = _rod('output', at_end)
            joints.append(Joint('output_joint', REVOLUTE, GROUND, 'output', _pair(self.pivot)))
        mechanism = Mechanism(
            name, (_rod('input', crank), _rod('coupler', coupler), last), tuple(joints),
            (CutJoint('pin', REVOLUTE, 'coupler', last.name, (coupler, 0.0), (at_end, 0.0)),),
            (Point('traced', 'coupler', _pair(traced)),), description)
        angles = tuple(float(one) for one in (*angles, angle))
        initial = Initial(angles, (0.0, 0.0, 0.0), ('input_joint',))
        return Scene(name, None, description, mechanism, initial,
                     {'gravity': Gravity((0.0, -9.81))}, Method())


class Synthesis(NamedTuple):
    """The linkages that were found, the best first, and how many were left out."""

    linkages: List[Linkage]
    defective: int  # Met the positions, but in another order or branch, or locked between them
    found: int  # Met the positions


def path_generation(places, kind=FOUR_BAR, starts=STARTS):
    """
    Return the linkages of which a point of the coupler goes through places.

    Parameters
    ----------
    places : array_like, shape (n, 2)
        In the order in which the crank takes them, 2 at least [m].
    kind : str
        FOUR_BAR or SLIDER_CRANK.
    starts : int
        Of the search.

    Returns
    -------
    Synthesis

    Raises
    ------
    SynthesisError

    """
    places = _complex(places, 2)
    size, count = _size(places), len(places)

    def linkage(x):
        pins = places[0] + size * (x[:6:2] + 1j * x[1:6:2])
        return _linkage(pins, x[6:8], kind, places[0], size)

    def errors(x):
        _, _, traced, missing = linkage(x).at(x[8:])
        return _stacked(traced - places[1:], missing) / size

    def start(rng):
        way = rng.choice((-1.0, 1.0)) * np.sort(rng.uniform(0.0, 2.0 * np.pi, count - 1))
        return np.concatenate([rng.normal(0.0, 1.5, 8), way])

    return _search(start, errors, linkage, lambda x: x[8:], starts, count, size)


def function_generation(inputs, outputs, kind=FOUR_BAR, base=1.0, starts=STARTS):
    """
    Return the linkages that couple angles of the crank with those of the rocker, or with strokes.

    Parameters
    ----------
    inputs : array_like, shape (n,)
        Angles of the crank [rad].
    outputs : array_like, shape (n,)
        Of the rocker [rad]; of a slider, how far it has gone [m].
    kind : str
        FOUR_BAR or SLIDER_CRANK.
    base : float
        Distance of the pivots of a four-bar [m].
    starts : int
        Of the search.

    Returns
    -------
    Synthesis
        Of three pairs in a four-bar angles count from the line of the pivots, otherwise what they
        count from is free.

    Raises
    ------
    SynthesisError

    """
    inputs, outputs = np.array(inputs, dtype=float), np.array(outputs, dtype=float)
    if inputs.shape != outputs.shape or inputs.ndim != 1 or len(inputs) < 3:
        raise SynthesisError('inputs, outputs: expected as many numbers of each, 3 at least')
    turns, wanted, count = inputs[1:] - inputs[0], outputs[1:] - outputs[0], len(inputs)
    slider = kind == SLIDER_CRANK
    size = _size(outputs + 0j) if slider else base

    def errors_of(linkage):
        _, end, _, missing = linkage.at(turns)
        if slider:
            return np.concatenate([(end - linkage.end).real - wanted, missing]) / size
        turned = np.angle((end - linkage.pivot) / (linkage.end - linkage.pivot) * np.exp(
            -1j * wanted))
        return np.concatenate([turned, missing / size])

    def linkage(x):
        pin, end = size * (x[::2] + 1j * x[1::2])
        return Linkage(0j, pin, end, None if slider else base + 0j, 1.0 + 0j, end)

    if count == 3 and not slider:
        one = freudenstein(inputs, outputs, base)
        on_branch = np.abs(errors_of(one)).max() < EXACT
        return _judged([(one, 0.0, turns if on_branch else None)], count, size)
    return _search(lambda rng: rng.normal(0.0, 1.5, 4), lambda x: errors_of(linkage(x)), linkage,
                   lambda x: turns, starts, count, size)


def freudenstein(inputs, outputs, base):
    """
    Return the four-bar of three pairs of angles [rad], from the line of its pivots.

    Freudenstein's equation, K1 cos(out) - K2 cos(in) + K3 = cos(in - out), is linear in the ratios
    of the lengths; a negative length is a link turned by half a turn.
    """
    matrix = np.column_stack([np.cos(outputs), -np.cos(inputs), np.ones(len(inputs))])
    if abs(np.linalg.det(matrix)) < 1e-12:
        raise SynthesisError('inputs, outputs: expected three pairs that are independent')
    first, second, third = np.linalg.solve(matrix, np.cos(inputs - outputs))
    crank, rocker = base / first, base / second
    return Linkage(0j, complex(crank * np.exp(1j * inputs[0])),
                   complex(base + rocker * np.exp(1j * outputs[0])), base + 0j, 1.0 + 0j,
                   complex(base + rocker * np.exp(1j * outputs[0])))


def motion_generation(places, angles, pins=None, kind=FOUR_BAR, starts=STARTS):
    """
    Return the linkages whose coupler goes through poses.

    Parameters
    ----------
    places : array_like, shape (n, 2)
        Of a point of the coupler, 3 at least [m].
    angles : array_like, shape (n,)
        Of the coupler in them [rad].
    pins : array_like, shape (2, 2), optional
        Of a four-bar through three poses: where its moving pins are in the first one [m].
    kind : str
        FOUR_BAR or SLIDER_CRANK.
    starts : int
        Of the search.

    Returns
    -------
    Synthesis
        Up to five poses are met by dyads of Burmester's points.

    Raises
    ------
    SynthesisError

    """
    places = _complex(places, 3)
    turned = np.exp(1j * (np.array(angles, dtype=float) - angles[0]))
    if turned.shape != places.shape:
        raise SynthesisError('angles: expected one for each place')
    size = _size(places)

    def seen(pin):
        """Return where a point of the coupler is in each pose."""
        return places + turned * (pin - places[0])

    cranks = []
    if pins is not None:
        if len(places) != 3 or kind != FOUR_BAR:
            raise SynthesisError('pins: expected them of a four-bar through three poses')
        cranks = [(pin, _center(seen(pin))) for pin in _complex(pins, 2)]
    else:
        cranks = dyads(places, turned, size, starts)
    if kind == SLIDER_CRANK:
        others = [(pin, None, rail) for pin, rail in _slides(places, turned, size, starts)]
        pairs = [(one, other) for one in cranks for other in others]
    else:
        pairs = [(one, (*other, 1.0 + 0j)) for one, other in permutations(cranks, 2)]
    found = []
    for (pin, crank), (end, pivot, rail) in pairs:
        if abs(end - pin) < SAME * size:
            continue
        linkage = Linkage(crank, pin, end, pivot, rail, places[0])
        turns = np.angle((seen(pin) - crank) / (pin - crank))[1:]
        at_pin, at_end, traced, _ = linkage.at(turns)
        off = np.abs((at_end - at_pin) / (end - pin) - turned[1:]) * size
        error = max(np.abs(traced - places[1:]).max(), off.max())
        if len(places) <= MOST_EXACT and error > EXACT * size:
            # It meets some of the poses on its other branch.
            error, turns = 0.0, None
        found.append((linkage, error, turns))
    return _judged(found, len(places), size)


def dyads(places, turned, size, starts=STARTS):
    """
    Return the links that poses allow: pin of the coupler in the first one, and its pivot.

    Of five poses these are Burmester's, four at most; of fewer, some of infinitely many.
    """
    def errors(x):
        pin, pivot = places[0] + size * (x[::2] + 1j * x[1::2])
        away = np.abs(places + turned * (pin - places[0]) - pivot)
        return (away[1:] - away[0]) / size

    found = []
    for x in _solutions(lambda rng: rng.normal(0.0, 1.5, 4), errors, starts, len(places)):
        pin, pivot = places[0] + size * (x[::2] + 1j * x[1::2])
        if SAME * size < abs(pin - pivot) < LARGEST * size and all(
                abs(pin - one) + abs(pivot - other) > SAME * size for one, other in found):
            found.append((complex(pin), complex(pivot)))
    return found


def _slides(places, turned, size, starts):
    """Return points of the coupler that stay on a line, and its direction."""
    def errors(x):
        pin = places[0] + size * (x[0] + 1j * x[1])
        away = places + turned * (pin - places[0]) - pin
        return (away[1:] * np.exp(-1j * x[2])).imag / size

    return [(complex(places[0] + size * (x[0] + 1j * x[1])), complex(np.exp(1j * x[2])))
            for x in _solutions(lambda rng: rng.normal(0.0, 1.5, 3), errors, starts, len(places))]


def _solutions(start, errors, starts, count):
    """Return the solutions of many starts: exact ones where so many positions allow these."""
    from scipy.optimize import least_squares
    rng, found = np.random.default_rng(0), []
    for _ in range(starts):
        result = least_squares(errors, start(rng), method='trf', xtol=1e-14, ftol=1e-14,
                               gtol=1e-14, max_nfev=200)
        found.append((np.abs(result.fun).max(), result.x))
    found.sort(key=lambda one: one[0])
    return [x for error, x in found if count > MOST_EXACT or error < EXACT]


def _search(start, errors, linkage, turns, starts, count, size):
    return _judged([(linkage(x), np.abs(errors(x)).max() * size, turns(x))
                    for x in _solutions(start, errors, starts, count)], count, size)


def _judged(found, count, size):
    """Return linkages without defects, the best first."""
    met = [(one, error, turns) for one, error, turns in found
           if count > MOST_EXACT or error < EXACT * size]
    good, bad = [], []
    for linkage, error, turns in met:
        lengths = linkage.lengths
        if not (max(lengths) < min(MOST_RATIO * min(lengths), LARGEST * size)):
            continue
        if any(_alike(linkage, one) for one in [*good, *bad]):
            continue
        turns = None if turns is None else _in_order(linkage, turns)
        if turns is None:
            bad.append(linkage)
        else:
            good.append(linkage._replace(
                turns=(0.0, *turns), error=float(error),
                transmission=_transmission(linkage, turns[-1])))
    good.sort(key=lambda one: (one.error if count > MOST_EXACT else 0.0, -one.transmission))
    if not good:
        raise SynthesisError(
            f'No linkage was found that takes the {count} positions in their order: '
            f'{len(met)} results of the search meet them, of which {len(bad)} in proportion, all '
            'on several branches or in another order. Take other or fewer positions, or more '
            'starts.')
    return Synthesis(good, len(bad), len(good) + len(bad))


def _alike(one, other):
    """Return whether two linkages are the same."""
    return all(abs(a - b) <= SAME * max(one.lengths) for a, b in zip(one[:5], other[:5])
               if a is not None)


def _in_order(linkage, turns):
    """Return the turns of the crank one after another in one direction; None where none is."""
    for sign in (1.0, -1.0):
        ways = np.mod(sign * np.asarray(turns), 2.0 * np.pi)
        if (np.diff([0.0, *ways]) > 0.0).all() and not linkage.at(
                sign * np.linspace(0.0, ways[-1], BETWEEN * len(ways)))[3].any():
            return tuple((sign * ways).tolist())
    return None


def _transmission(linkage, turn):
    pin, end, _, _ = linkage.at(np.linspace(0.0, turn, BETWEEN))
    other = 1j * linkage.rail if linkage.pivot is None else linkage.pivot - end
    angle = np.abs(np.angle((pin - end) / other))
    return float(np.minimum(angle, np.pi - angle).min())


def _linkage(pins, last, kind, traced, size):
    """Return a linkage of its pins, and of two numbers more: the pivot or the rail."""
    if kind == SLIDER_CRANK:
        rail = complex(*last)
        return Linkage(*pins, None, rail / (abs(rail) or 1.0), traced)
    return Linkage(*pins, traced + size * complex(*last), 1.0 + 0j, traced)


def _center(places):
    """Return the centre of the circle through three places."""
    first, second = places[1] - places[0], places[2] - places[0]
    area = 2.0 * (np.conj(first) * second).imag
    if abs(area) < 1e-12 * abs(first) * abs(second):
        raise SynthesisError('pins: expected pins whose three places are not in line')
    return complex(places[0] + 1j * (
        first * abs(second) ** 2 - second * abs(first) ** 2) / area)


def _stacked(errors, missing):
    return np.concatenate([errors.real, errors.imag, missing])


def _complex(places, least):
    places = np.array(places, dtype=float)
    if places.ndim != 2 or places.shape[1] != 2 or len(places) < least or not np.isfinite(
            places).all():
        raise SynthesisError(f'places: expected pairs of finite numbers, {least} at least')
    return places[:, 0] + 1j * places[:, 1]


def _size(places):
    size = max(abs(one - places[0]) for one in places)
    if not size > 0.0:
        raise SynthesisError('places: expected different ones')
    return float(size)


def _rod(name, length):
    """Return a uniform rod from its frame's origin along x."""
    return Body(name, LINE * length, (0.5 * length, 0.0), LINE * length ** 3 / 12.0)


def _pair(place):
    return float(place.real), float(place.imag)
