# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""All assemblies of a mechanism in which every degree of freedom is driven."""

from typing import List, NamedTuple, Optional

import numpy as np

from .assembly import Assembler, TOLERANCE
from .errors import AssemblyError
from .planar_assemblies import all_planar, NotProved
from .redundancy import geometry_of
from .state import State
from ..core import types as t
from ..mechanism.mechanism import GROUND, PRISMATIC, SPHERICAL

# Random starts, where no method finds all; Newton corrections of each, and the longest.
STARTS, CORRECTIONS, LONGEST = 400, 40, 0.5
# Assemblies whose joints, cut points and named points are nearer are the same [of the size].
SAME = 1e-6
# Legs of variable length between two bodies: at most so many assemblies (Lazard; Ronga and Vust).
STEWART, LEGS = 40, 6


class Assemblies(NamedTuple):
    """
    The assemblies of a mechanism with given driven values.

    Attributes
    ----------
    states : State
        A batch, at rest, one for each assembly.
    proved : bool
        Whether these are all.
    most : int or None
        How many there can be of this kind of mechanism, where that is known.
    reason : str
        Why there may be others, where it is not proved; or how it is.

    """

    states: State
    proved: bool
    most: Optional[int]
    reason: str

    def __str__(self) -> str:
        """Return ``proved: 6``, or ``found so far: 6``."""
        return _in_words(self, len(self.states))


class Assembled(NamedTuple):
    """
    Positions that close the loops with given driven values.

    Attributes
    ----------
    positions : list of ndarray, shape (nq,)
    proved, most, reason
        As ``Assemblies`` has them.

    """

    positions: List[np.ndarray]
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
    Find the assemblies of a driven mechanism.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Its ``motions`` are what is driven.
    equations : core.equations.Equations
        Of it; the driven values are written into its model.
    values : sequence of float
        Driven values [rad or m].
    start : ndarray, shape (nq,)
        A position of the mechanism; those found by random starts begin with it.

    Returns
    -------
    Assembled

    """
    assembler = _driven(mechanism, equations, values)
    reason = 'in space no method here finds all'
    if mechanism.planar:
        try:
            return _proved(mechanism, assembler, values)
        except NotProved as error:
            reason = str(error)
    found = _Distinct(mechanism, assembler.extent)
    rng = np.random.default_rng(0)
    unit = np.where(mechanism.coordinates.lengths, assembler.extent, 1.0)
    for k in range(STARTS):
        change = np.pi * unit * rng.uniform(-1.0, 1.0, assembler.nv) if k else 0.0 * unit
        position = closed_from(
            mechanism, equations, unit, mechanism.coordinates.moved(start, change))
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


def closed_from(mechanism, equations, unit, q):
    """Return a position that closes the loops, from any; None where Newton's method ends."""
    for _ in range(CORRECTIONS):
        moved = equations.move(q)
        psi = moved.closures()[0]
        if np.abs(psi).max() <= TOLERANCE * unit.max():
            return q
        change = np.linalg.lstsq(moved.jacobian() * unit, -psi, rcond=1e-10)[0]
        longest = np.abs(change).max()
        if not longest < np.inf:
            return None
        q = mechanism.coordinates.moved(q, unit * change * (LONGEST / max(longest, LONGEST)))
    return None


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
        """Begin with none."""
        self._mechanism, self._size = mechanism, size
        self._geometry, self._places = geometry_of(mechanism), []
        self.positions = []

    def add(self, position):
        """Add a position unless it is one of them."""
        places = marked_places(self._mechanism, self._geometry, position)
        if all(np.abs(places - other).max() > SAME * self._size for other in self._places):
            self._places.append(places)
            self.positions.append(position)


def marked_places(mechanism, geometry, position):
    """
    Return where joints, cut points and named points of moving bodies are, shape (n, 2 or 3) [m].

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Any.
    geometry : plane.PlanarGeometry or space.SpatialGeometry
        Of it.
    position : ndarray, shape (nq,)
        Joint coordinates.

    """
    points = [(joint.parent, joint.position) for joint in mechanism.joints]
    points += [(joint.child, np.zeros(len(joint.position))) for joint in mechanism.joints]
    points += [(cut.body_a, cut.point_a) for cut in mechanism.cut_joints]
    points += [(cut.body_b, cut.point_b) for cut in mechanism.cut_joints]
    points += [(point.body, point.position) for point in mechanism.points]
    return np.array([geometry.point(position, body, np.array(place))
                     for body, place in points if body != GROUND])


def is_stewart(mechanism):
    """Tell whether six legs, of lengths that are all driven, join one platform to the ground."""
    driven = {motion.freedom for motion in mechanism.motions}
    slides = [joint for joint in mechanism.joints if joint.type == PRISMATIC]
    balls = [cut for cut in mechanism.cut_joints if cut.type == SPHERICAL]
    joined = {body for cut in balls for body in (cut.body_a, cut.body_b)}
    return (not mechanism.planar and len(slides) == len(driven) == LEGS
            and {joint.name for joint in slides} == driven
            and len(balls) in (LEGS - 1, LEGS) and len(joined) <= LEGS + 1)
