# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""All assemblies of a mechanism in which every degree of freedom is driven."""

from dataclasses import replace
from typing import List, NamedTuple, Optional

import numpy as np

from .assembly import Assembler
from .geometry import Geometry
from .modeling import extent
from .planar_assemblies import all_planar, NotProved
from .state import State
from ..engine import types as t
from ..engine.ranks import null_space
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import GROUND, JOINT_FREEDOMS, PRISMATIC, SPHERICAL

# Random starts, where no method finds all.
STARTS = 400
# Assemblies whose joints, cut points and named points are nearer are the same [of the size].
SAME = 1e-6
# Speeds of points in a motion without effect, against the size, that are rounding.
STILL = 1e-6
# Joints that move by less than this share of the most are not named, and how many are.
MOVES, MOST_NAMES = 0.05, 4
# Names of directions of points.
AXES = {tuple(float(one == k) for one in range(size)): name
        for size in (2, 3) for k, name in enumerate('xyz'[:size])}
# Legs of variable length between two bodies: at most so many assemblies (Lazard; Ronga and Vust).
STEWART, LEGS = 40, 6


class Assemblies(NamedTuple):
    """The assemblies of a mechanism with given driven values."""

    states: State  # A batch, at rest, one for each assembly
    proved: bool  # Whether these are all
    most: Optional[int]  # How many there can be of this kind of mechanism, where that is known
    reason: str  # Why there may be others, where it is not proved; or how it is

    def __str__(self) -> str:
        """Return ``proved: 6``, or ``found so far: 6``."""
        return _in_words(self, len(self.states))


class Assembled(NamedTuple):
    """Positions that close the loops with given driven values."""

    positions: List[np.ndarray]  # Shape (nq,)
    #: ``proved``, ``most``, ``reason``: As ``Assemblies`` has them.
    proved: bool
    most: Optional[int]
    reason: str

    def __str__(self) -> str:
        """Return ``proved: 6``, or ``found so far: 6``."""
        return _in_words(self, len(self.positions))


def _in_words(found, count):
    bound = '' if found.most is None else f' (at most {found.most})'
    return f'{"proved" if found.proved else "found so far"}: {count}{bound}'


def find_assemblies(mechanism, equations, values, start):
    """
    Find the assemblies of a mechanism whose ``motions`` are driven, as ``Assembled``.

    The driven ``values`` [rad or m] are written into the model of its equations; the positions
    found by random starts begin with ``start``, shape (nq,). ValueError where less is driven than
    there are degrees of freedom.
    """
    unit = np.where(mechanism.coordinates.lengths, extent(mechanism), 1.0)
    needed, free, _ = drives_needed(
        mechanism, equations.move(start).dimensionless(unit), unit, start)
    if len(values) < needed:
        raise ValueError(too_few(mechanism, needed, free * unit))
    assembler = _driven(mechanism, equations, values)
    reason = 'in space no method here finds all'
    if mechanism.planar:
        try:
            return _proved(mechanism, assembler, values)
        except NotProved as error:
            reason = str(error)
    found = _Distinct(mechanism, assembler.extent)
    rng = np.random.default_rng(0)
    for k in range(STARTS):
        change = np.pi * unit * rng.uniform(-1.0, 1.0, assembler.nv) if k else 0.0 * unit
        position = assembler.closed_from(mechanism.coordinates.moved(start, change))
        if position is not None:
            found.add(position)
    found = found.positions
    most = STEWART if is_stewart(mechanism) else None
    proved = most == len(found)
    return Assembled(found, proved, most, (
        'as many as there can be' if proved else f'random starts, as {reason}'))


def _driven(mechanism, equations, values):
    """Return an assembler whose driving equations hold the values."""
    model = equations.model
    numbers = model.cut[:, t.CUT_NUMBER].tolist()
    count, column = len(mechanism.motions), model.cut_point.shape[1] - t.MOTION_COLUMNS
    for number, value in enumerate(values, start=len(numbers) - count):
        model.cut_point[numbers.index(number), column:] = value, 0.0, 0.0
    return Assembler(mechanism, equations)


def _proved(mechanism, assembler, values):
    """Return all assemblies, or raise NotProved."""
    solutions, most = all_planar(mechanism, values)
    found = _Distinct(mechanism, assembler.extent)
    for solution in solutions:
        try:
            found.add(assembler.positions(solution))
        except AssemblyError:
            raise NotProved('a solution that does not close the loops') from None
    if len(found.positions) != len(solutions):
        raise NotProved('two assemblies that nearly coincide')
    return Assembled(found.positions, True, most, 'all solutions of the polynomial equations')


class _Distinct:
    """Positions of which no two have all their points at the same places."""

    def __init__(self, mechanism, size):
        self._mechanism, self._size = mechanism, size
        self._geometry, self._places = Geometry(mechanism), []
        self.positions = []

    def add(self, position):
        """Add a position unless it is one of them."""
        places = marked_places(self._mechanism, self._geometry, position)
        if all(np.abs(places - other).max() > SAME * self._size for other in self._places):
            self._places.append(places)
            self.positions.append(position)


def drives_needed(mechanism, jacobian, unit, position):
    """
    Return the number of driven values that determine a mechanism, and free displacements.

    Its ``motions`` are what is driven; ``jacobian``, shape (n, nv), is that of the loops and the
    driving equations at the closed ``position``, shape (nq,), by scaled displacements, whose
    factors are ``unit``, shape (nv,) [rad or m], of errors without units.

    Returns the degrees of freedom at and near the position, without idle ones; scaled
    displacements with the driven values at rest, shape (n, nv), without idle ones; and those that
    only turn rods between ball or universal joints about themselves.
    """
    loops = replace(mechanism, motions=())
    freedoms = Assembler(loops, Geometry(loops).equations).degrees_of_freedom(position)
    null = null_space(jacobian)
    if all(_is_idle(mechanism, position, row * unit) for row in null):
        return freedoms - len(null), null[:0], np.ascontiguousarray(null)
    return freedoms, null, null[:0].copy()


def too_few(mechanism, needed, rates):
    """Return a message naming the undriven motions, from rates of shape (n, nv)."""
    names = driven_names(mechanism)
    return (f'drives: expected as many driven values as there are degrees of freedom ({needed}), '
            f'got {len(names)}: {", ".join(names)}; '
            f'{moving_joints(mechanism.coordinates, np.abs(rates).max(axis=0))} can still move')


def driven_names(mechanism):
    """Return the names of driven joints and points."""
    return tuple(motion.freedom or motion.point + (
        f'.{AXES[motion.direction]}' if motion.direction in AXES else '')
        for motion in mechanism.motions)


def moving_joints(coordinates, rates):
    """Return the names of the joints that move most."""
    sizes = np.abs(rates)
    most = sizes.max(initial=0.0)
    order = [int(k) for k in np.argsort(-sizes, kind='stable')[:MOST_NAMES]
             if sizes[k] > MOVES * most]
    return ', '.join(coordinates.names[k] for k in sorted(order))


def _is_idle(mechanism, position, rates):
    """Return whether only rods between ball or universal joints turn about themselves."""
    coordinates, most = mechanism.coordinates, np.abs(rates).max()
    # A wheel on its axle moves no point of these, either.
    wheels = [coordinates.index[joint.name] for joint in mechanism.joints
              if JOINT_FREEDOMS[joint.type] == 1]
    if np.abs(rates[wheels]).max(initial=0.0) > STILL * most:
        return False
    step, geometry = 1e-6, Geometry(mechanism)
    one, other = (marked_places(mechanism, geometry, coordinates.moved(
        position, sign * step * rates)) for sign in (1.0, -1.0))
    return np.abs(one - other).max(initial=0.0) <= STILL * step * extent(mechanism) * most


def marked_places(mechanism, geometry, position):
    """
    Return where joints, cut points and named points of moving bodies are, shape (n, 2 or 3) [m].

    ``geometry`` is that of the mechanism, ``position`` has the shape (nq,).
    """
    points = [(joint.parent, joint.position) for joint in mechanism.joints]
    points += [(joint.child, np.zeros(len(joint.position))) for joint in mechanism.joints]
    points += [(cut.body_a, cut.point_a) for cut in mechanism.cut_joints]
    points += [(cut.body_b, cut.point_b) for cut in mechanism.cut_joints]
    points += [(point.body, point.position) for point in mechanism.points]
    return np.array([geometry.point(position, body, np.array(place))
                     for body, place in points if body != GROUND])


def is_stewart(mechanism):
    """Return whether six legs, of lengths that are all driven, join one platform to the ground."""
    driven = {motion.freedom for motion in mechanism.motions}
    slides = [joint for joint in mechanism.joints if joint.type == PRISMATIC]
    balls = [cut for cut in mechanism.cut_joints if cut.type == SPHERICAL]
    joined = {body for cut in balls for body in (cut.body_a, cut.body_b)}
    return (not mechanism.planar and len(slides) == len(driven) == LEGS
            and {joint.name for joint in slides} == driven
            and len(balls) in (LEGS - 1, LEGS) and len(joined) <= LEGS + 1)
