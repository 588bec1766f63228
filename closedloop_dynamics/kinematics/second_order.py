# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Motions that closure equations forbid to second order only, and equations that hold them.

A taut bar between parallel guides cannot tilt, but the gradient of its length vanishes in every
position that it can take: a rank counts a freedom that does not exist, and multipliers of that
equation have no effect. To second order the loops close along a direction v of the null space N
of J only where l^T (v^T H v) = 0 for all l with l^T J = 0 (H: second derivatives of the closure
equations). A form that is definite across the directions in which finite steps close again forbids
all others.
Where these are the same linear combinations of coordinates in all positions around, couplings and
points on lines hold them in the place of such equations.

Set-up work, where equations depend on others that do not imply them.
"""

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, Tuple

import numpy as np

from .assembly import Assembler, MOST_EQUATIONS
from .geometry import Geometry
from ..engine.ranks import rank_from, rank_of
from ..mechanism.digits import suspicions
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import COUPLED, Coupling, CutJoint, POINT_ON_LINE
from ..mechanism.rotations import of_quaternion

# Length of the finite steps, and of those for differences [rad, and shares of the size]; closure
# errors where a step ends, in sizes: one that the loops undo ends at the root, 3e-5.
STEP, DIFFERENCE, CLOSED = 1e-2, 1e-4, 1e-9
# Scaled singular values below this, against the largest, belong to equations without effect: where
# positions are exact to that root. What Newton's method changes of such a position is not more.
NO_EFFECT, LARGEST_CORRECTION = 1e-3, 1e-4
# Those above this have an effect: positions around are exact to the root of CLOSED.
SOME_EFFECT = 1e-4
# Steps per direction of the null space; the part of a step that a motion keeps, at least, and that
# is left of one that is undone, at most. Between the two nothing is decided.
STEPS_EACH, KEPT, UNDONE = 3, 0.2, 0.02
# Curvature across the motion, against the largest one, that forbids; along it, that is zero.
DEFINITE, FLAT = 1e-3, 1e-5
# Corrections of a combination of forms until it is definite.
MOST_COMBINATIONS = 200
# Corrections of a position onto where equations have no effect: each squares the error.
MOST_CORRECTIONS = 3
# Entries of linear relations of coordinates that are rounding: positions are exact to 1e-6.
NO_ENTRY = 1e-5
# Scaled singular value from which a relation is independent of the closure equations.
INDEPENDENT = 1e-3
# Decimals of sums of coordinates that are not rounding.
DIGITS = 14
# How many sets of positions around are looked at.
SEEDS = 2
MOST_GUESSES = 10
# Shares of a coordinate or an equation that are named.
NAMED = 0.1


class SecondOrder(NamedTuple):
    """What is forbidden to second order only, and what holds it."""

    #: Cut joints and couplings that forbid it; joints that cannot move as J has it.
    closures: Tuple[str, ...]
    joints: Tuple[str, ...]
    couplings: Tuple[Coupling, ...] = ()
    cut_joints: Tuple[CutJoint, ...] = ()

    def added_to(self, mechanism):
        """Return a mechanism with what holds these directions."""
        return replace(mechanism, couplings=mechanism.couplings + self.couplings,
                       cut_joints=mechanism.cut_joints + self.cut_joints)

    @property
    def count(self):
        """Return the number of directions that are held."""
        return len(self.couplings) + 2 * len(self.cut_joints)

    def notes(self):
        """Return a note of what holds the directions, in a list."""
        held = [*(f'{" + ".join(_term(*one) for one in coupling.joints.items())} = '
                  f'{coupling.offset:.6g} by {coupling.name}' for coupling in self.couplings),
                *(f'turns about one axis by {cut.name}' for cut in self.cut_joints)]
        names = _list(self.closures)
        return [f'{names} {_verb(self.closures, "forbid")} a motion of {_list(self.joints)} to '
                'second order only: the Jacobian of the loops has a freedom there that the machine'
                f' has in no position. The motion goes on without it: {"; ".join(held)}. To hold '
                f'against forces in this direction, {names} would take multipliers without bound: '
                'the part without effect is reported as least, and what holds the direction is '
                'reported in its place.']


class _Place(NamedTuple):
    """The motions at a position, in scaled displacements."""

    position: np.ndarray  # Shape (nq,)
    equations: np.ndarray  # Shape (rank, nv): Of length 1, what the equations hold
    motion: np.ndarray  # Shape (nv, k): Directions of motions
    forbidden: np.ndarray  # Shape (nv, f - k): The rest of the null space
    shares: np.ndarray  # Shape (nc,): Of the equations that forbid


def find_second_order(mechanism, position):
    """
    Find the directions that are free to first order only.

    Parameters
    ----------
    mechanism : Mechanism
        Its prescribed motions are left out.
    position : ndarray, shape (nq,)
        Closing the loops.

    Returns
    -------
    SecondOrder or None
        None where there are none, or they cannot be distinguished from motions.

    Raises
    ------
    AssemblyError
        Where nothing moves at all, or no linear equations hold these directions.

    """
    return _Search(replace(mechanism, motions=()), position).find()


def as_it_moves(mechanism, position, hold=()):
    """
    Return a mechanism with equations that hold what is free to first order only.

    Itself where there is nothing of the kind. ``position``, shape (nq,): nearly closing the loops,
    with the joints in ``hold`` as given. AssemblyError as for ``find_second_order``.
    """
    geometry = Geometry(mechanism)
    geometry.leave_out_repeated(np.array(position, dtype=float), hold)
    if geometry.unexplained is None:
        return mechanism
    found = find_second_order(mechanism, geometry.unexplained)
    return mechanism if found is None else found.added_to(mechanism)


def scene_as_it_moves(scene):
    """Return a scene with the mechanism ``as_it_moves`` from its start."""
    mechanism = as_it_moves(scene.mechanism, scene.initial.position, scene.initial.hold)
    return scene if mechanism is scene.mechanism else replace(scene, mechanism=mechanism)


def count_forbidden(mechanism, position):
    """Return how many freedoms of first order do not exist, near a position, shape (nq,)."""
    geometry = Geometry(mechanism)
    geometry.leave_out_repeated(position)
    if geometry.unexplained is None:
        return 0
    here, *_ = _Search(replace(mechanism, motions=()), geometry.unexplained).here()
    return 0 if here is None else here.forbidden.shape[1]


def find_degrees_of_freedom(mechanism):
    """
    Count the degrees of freedom of a mechanism, in positions that are found by trial.

    The most among the positions: there may be some in which it is locked. None where no guess led
    to one that closes the loops, and for mechanisms too large to try.
    """
    if mechanism.number_of_equations > MOST_EQUATIONS:
        return None
    assembler = Assembler(mechanism, Geometry(mechanism).equations)
    rng, found = np.random.default_rng(0), []
    for _ in range(MOST_GUESSES):
        with suppress(AssemblyError):
            q = assembler.positions(rng.uniform(-2.0, 2.0, assembler.nv))
            found.append(assembler.degrees_of_freedom(q) - count_forbidden(mechanism, q))
    return max(found, default=None)


class _Search:
    """The search around a position that closes the loops."""

    def __init__(self, mechanism, position):
        self.mechanism, self.position = mechanism, position
        self.geometry = Geometry(mechanism)
        self.assembler = Assembler(mechanism, self.geometry.equations)
        self.coordinates = mechanism.coordinates
        self.unit = np.where(self.coordinates.lengths, self.assembler.extent, 1.0)
        self.rng = np.random.default_rng(0)

    def find(self):
        """Find what ``find_second_order`` returns."""
        here, rank, around = self.here()
        if here is None:
            return None
        found = SecondOrder(self.names_of_closures(here.shares),
                            self.names_of_joints(here.forbidden))
        if not here.motion.shape[1]:
            raise AssemblyError(
                f'{self.mechanism.name} cannot move: {_list(found.closures)} '
                f'{_verb(found.closures, "forbid")} to second order what the Jacobian of the '
                f'loops leaves free ({_list(found.joints)}), so that forces in this direction '
                'meet no resistance of first order, and those that hold it are without bound. '
                'Change a length by more than a thousandth, or leave the loop open.'
                + ''.join(f' {note}' for note in suspicions(self.mechanism)))
        relations = self.relations([here, *(place for place in (
            self.place(q, rank) for q in around) if place is not None)])
        if relations is None:
            raise AssemblyError(
                f'{_list(found.closures)} of {self.mechanism.name} '
                f'{_verb(found.closures, "forbid")} a motion of {_list(found.joints)} to second '
                'order only: the Jacobian of the loops has it as a freedom, which it is in no '
                'position, and no linear equation of these joints holds it. Replace one of them '
                'by a joint without that freedom, such as a hinge or a slider.')
        return self.held(found, *relations)

    def here(self):
        """
        Return the motions at the position, or near it if more equations have an effect there.

        And how many have, and positions around. None in the place of the motions where nothing is
        known to be forbidden.
        """
        around = [self.position, *self.closed_around(0)]
        if any(rank_of(self.jacobian(q), SOME_EFFECT) == self.assembler.nc for q in around):
            # All equations have an effect nearby: the position is a change point.
            return None, self.assembler.nc, around[1:]
        around += [near for seed in range(1, SEEDS) for near in self.closed_around(seed)]
        ranks = [rank_of(self.jacobian(q), NO_EFFECT) for q in around]
        rank = max(ranks)
        here = self.place(around[ranks.index(rank)], rank)
        if here is not None and ranks[0] == rank:
            self.position = here.position
        return here, rank, around[1:]

    def closed_around(self, seed):
        """Yield positions around that are so closed that equations without effect show it."""
        for near in self.assembler.neighbours(self.position, seed):
            if np.abs(self.assembler.closure(near)).max(initial=0.0) <= (
                    CLOSED * self.assembler.extent):
                yield near

    def jacobian(self, q):
        """Return J, without units, by scaled displacements."""
        return self.geometry.equations.move(q).dimensionless(self.unit)

    def place(self, q, rank):
        """
        Return the motions at a position; None where nothing is known to be forbidden.

        ``rank``: of the equations that have an effect.
        """
        left, _, right = np.linalg.svd(self.jacobian(q))
        kept = self.steps_kept(q, right[rank:].T)
        if kept is None:
            return None
        vectors, values, _ = np.linalg.svd(kept)
        if ((values > UNDONE) & (values < KEPT)).any():
            return None
        count = int((values >= KEPT).sum())
        for left_over in reversed(range(MOST_CORRECTIONS)):
            null, idle = right[rank:].T, left[:, rank:].T
            combination = self.certificate(self.forms(q, null, idle), vectors, count)
            if combination is None:
                return None
            form, weights = combination
            # Along motions there is none; steps are chords, not as exact as the form.
            values, vectors = np.linalg.eigh(form)
            slope = weights @ idle @ self.jacobian(q) @ null
            change = vectors[:, count:] @ (slope @ vectors[:, count:] / values[count:])
            if not np.abs(change).max() <= LARGEST_CORRECTION:
                return None
            if not left_over:
                return _Place(q, right[:rank], null @ vectors[:, :count],
                              null @ vectors[:, count:], np.abs(weights @ idle))
            q = self.coordinates.moved(q, -self.unit * (null @ change))
            before, (left, _, right) = null, np.linalg.svd(self.jacobian(q))
            vectors = right[rank:] @ before @ vectors
        return None

    def steps_kept(self, q, null):
        """
        Return what is left of random steps along a null space, shape (f, n), of length 1.

        None where the loops do not close beside the position.
        """
        count = null.shape[1]
        if not count:
            return None
        found = []
        for _ in range(STEPS_EACH * count):
            way = self.rng.normal(size=count)
            way /= np.linalg.norm(way)
            near, psi = self.assembler.solve_closure(
                self.coordinates.moved(q, STEP * self.unit * (null @ way)),
                np.arange(self.assembler.nv))
            if np.abs(psi).max(initial=0.0) <= CLOSED * self.assembler.extent:
                found.append(null.T @ (self.coordinates.apart(near, q) / self.unit) / STEP)
        # Together they have length 1 in each direction of a motion.
        return np.array(found).T / np.sqrt(STEPS_EACH) if len(found) > count else None

    def forms(self, q, null, idle):
        """Return the second derivatives of idle equations on a null space, shape (d, f, f)."""
        bends = np.array([
            self.jacobian(self.coordinates.moved(q, step))
            - self.jacobian(self.coordinates.moved(q, -step))
            for step in DIFFERENCE * self.unit * null.T]) / (2.0 * DIFFERENCE)
        found = np.einsum('di,aij,jb->dab', idle, bends, null)
        return 0.5 * (found + np.swapaxes(found, 1, 2))

    def certificate(self, forms, vectors, count):
        """
        Return a combination of forms that is definite across the motions only, and its weights.

        ``vectors``, shape (f, f): the first ``count`` along motions. None where none is found.
        """
        turned = np.einsum('ia,dij,jb->dab', vectors, forms, vectors)
        scale = np.abs(turned).max(initial=0.0)
        across = turned[:, count:, count:]
        if not across.size or not scale > 0.0:
            return None
        # Combinations without part along the motions.
        along = turned[:, :count, :].reshape(len(turned), -1)
        if along.size:
            _, values, rows = np.linalg.svd(along.T)
            free = rows[int((values > FLAT * scale * STEP / DIFFERENCE).sum()):]
        else:
            free = np.eye(len(turned))
        if not len(free):
            return None
        across = np.einsum('cd,dab->cab', free, across)
        weights = np.trace(across, axis1=1, axis2=2)
        for _ in range(MOST_COMBINATIONS):
            length = np.linalg.norm(weights)
            if not length > 0.0:
                return None
            values, ways = np.linalg.eigh(np.einsum('c,cab->ab', weights / length, across))
            if values[0] > DEFINITE * scale:
                weights = weights / length @ free
                return np.einsum('d,dab->ab', weights, forms), weights
            # The direction that is least forbidden is to be more so.
            weights = weights / length + np.einsum(
                'a,cab,b->c', ways[:, 0], across, ways[:, 0]) / scale
        return None

    def relations(self, places):
        """
        Return linear relations of rates that hold the motions everywhere, shape (n, nv), scaled.

        And by joint with an orientation the axis, in its child's frame, about which alone it
        turns. None where these are not all.
        """
        if len({place.motion.shape for place in places}) > 1:
            return None
        motions = np.hstack([place.motion for place in places])
        nv, count = places[0].motion.shape
        joints = {joint.name: joint for joint in self.mechanism.joints}
        single = [index for index, name in enumerate(self.coordinates.names)
                  if name in joints and joints[name].type in COUPLED]
        found = np.zeros((0, nv))
        axes = {}
        for row in _relations_among(motions[single]):
            whole = np.zeros(nv)
            whole[single] = row
            if self.adds(places, found, whole):
                found = np.vstack([found, whole])
        lines = np.zeros((0, nv))
        for name in self.coordinates.with_orientation:
            rates = self.coordinates.rates[name]
            turns = np.arange(rates.stop - 3, rates.stop)
            axis = _axis_among(motions[turns])
            if axis is None:
                continue
            across = np.zeros((2, nv))
            across[:, turns] = np.linalg.svd(axis[np.newaxis])[2][1:]
            if any(self.adds(places, np.vstack([found, lines]), row) for row in across):
                axes[name], lines = axis, np.vstack([lines, across])
        complete = all(
            rank_from(np.linalg.svd(np.vstack([place.equations, found, lines]), compute_uv=False),
                      INDEPENDENT) == nv - count for place in places)
        return (found, axes) if complete else None

    def adds(self, places, found, row):
        """Return whether a relation is independent of the equations and others everywhere."""
        return all(_least(place, np.vstack([found, row])) > INDEPENDENT for place in places)

    def held(self, found, relations, axes):
        """Return what holds the directions, from relations of scaled rates."""
        taken = {one.name for one in (*self.mechanism.joints, *self.mechanism.closures)}
        couplings, cuts = [], []
        for row in relations:
            factors = {name: float(value) for name, value, unit in zip(
                self.coordinates.names, row / self.unit, self.unit) if value != 0.0}
            largest = max(factors.values(), key=abs)
            factors = {name: _rounded(value / largest) for name, value in factors.items()}
            couplings.append(Coupling(
                _free_name(f'held_{"_".join(factors)}', taken), factors,
                round(float(sum(
                    factor * self.position[self.coordinates.coordinates[name]][0]
                    for name, factor in factors.items())), DIGITS) + 0.0))
        for name, axis in axes.items():
            joint = next(one for one in self.mechanism.joints if one.name == name)
            turn = self.position[self.coordinates.coordinates[name]][-4:]
            along = of_quaternion(joint.orientation) @ of_quaternion(turn) @ axis
            cuts.append(CutJoint(
                _free_name(f'held_{name}', taken), POINT_ON_LINE, joint.child, joint.parent,
                tuple(self.assembler.extent * axis), joint.position, axis_b=tuple(along)))
        held = {name: None for coupling in couplings for name in coupling.joints}
        return found._replace(joints=(*held, *axes), couplings=tuple(couplings),
                              cut_joints=tuple(cuts))

    def names_of_closures(self, shares):
        """Return the closures with a share in idle equations."""
        counts = self.geometry.equations.counts
        by_closure = [part.max(initial=0.0)
                      for part in np.split(shares, np.cumsum(counts)[:-1])]
        return tuple(one.name for one, share in zip(self.mechanism.closures, by_closure)
                     if share > NAMED * shares.max())

    def names_of_joints(self, directions):
        """Return the joints that some directions, shape (nv, n), move."""
        shares = np.abs(directions).max(axis=1)
        joint_of = self.coordinates.joint_of
        return tuple(dict.fromkeys(
            joint_of(name) for name, share in zip(self.coordinates.names, shares)
            if share > NAMED * shares.max()))


def _relations_among(motions):
    """Return rows f with f motions = 0, in reduced echelon form, those of few entries first."""
    vectors, values, _ = np.linalg.svd(motions)
    rank = int((values > NO_ENTRY * np.sqrt(motions.shape[1])).sum())
    rows, pivots = vectors[:, rank:].T.copy(), []
    for k in range(len(rows)):
        left = np.abs(rows[k:])
        # The first coordinate whose entries are about the largest: rounding must not choose.
        column = int(np.argmax(left.max(axis=0) > 0.5 * left.max()))
        pivot = k + int(np.argmax(left[:, column]))
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] /= rows[k, column]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, column] * rows[k]
        pivots.append(column)
    rows[np.abs(rows) < NO_ENTRY] = 0.0
    return sorted(rows, key=np.count_nonzero)


def _axis_among(turns):
    """Return the axis that all turns, shape (3, n), have in common; None where there is none."""
    vectors, values, _ = np.linalg.svd(turns)
    if not values[0] > NAMED or values[1] > NO_ENTRY * values[0]:
        return None
    axis = np.where(np.abs(vectors[:, 0]) < NO_ENTRY, 0.0, vectors[:, 0])
    return axis / np.linalg.norm(axis)


def _least(place, rows):
    """Return the least part of unit rows that a place's equations and the others do not have."""
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    left = rows - rows @ place.equations.T @ place.equations
    return np.linalg.svd(left, compute_uv=False)[-1]


def _rounded(value):
    """Return a factor without the rounding of what it was found by."""
    nearest = float(round(value))
    return nearest if abs(value - nearest) < NO_ENTRY else value


def _free_name(name, taken):
    """Return a name that no closure or joint has, and take it."""
    found, number = name, 2
    while found in taken:
        found, number = f'{name}_{number}', number + 1
    taken.add(found)
    return found


def _term(name, factor):
    return name if factor == 1.0 else f'{factor:.6g} {name}'


def _list(names):
    return ', '.join(names)


def _verb(names, verb):
    return verb + 's' * (len(names) == 1)
