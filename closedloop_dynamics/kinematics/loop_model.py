# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The model of a mechanism, with redundant closure equations left out of the elimination."""

from contextlib import suppress
from copy import deepcopy
from itertools import combinations
import math
from typing import NamedTuple

import numpy as np

from .assembly import Assembler, MOST_EQUATIONS, MOST_OPEN, NEARBY, NEIGHBOURS
from .modeling import mechanism_arrays
from ..codegen import MOST_UNROLLED_OPERATIONS, unrolled_size
from ..codegen.equations import Equations
from ..engine.ranks import rank_of, RANK_TOLERANCE
from ..mechanism.decomposition import decompose
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import FIXED

# Rounding errors of a Jacobian without units, and what closure errors make of entries that are
# zero in a closed position, are below this.
ROUNDING = 1e-10
# Singular values above the first, and above so many times the closure error, without units, cannot
# become zero on the way to where the loops close.
PLAIN, FAR = 1e-3, 10.0
# How often, farther and farther away, a position without flat loops is looked for.
MOST_TRIES = 6
# Equations that repeat others but for the last digits of lengths and axes open as the machine
# moves: by at most so many times as much as they are off, in sizes of the machine. Others are open
# by rounding, the second.
FARTHER, AS_GOOD_AS_CLOSED = 30.0, 1e-9
# Beside a place where a mechanism leaves the branch on which equations repeat others they open by
# the square of their scaled singular values. With smaller ones than this, times the root of the
# opening, they repeat others in all but the last digits: as independent ones they would lock the
# mechanism.
NEAR_BRANCH = 0.09


# Code is made for so many choices of equations at most, as it takes a third of a second each.
MOST_CHOICES = 16


class JointPlaces(NamedTuple):
    """Where the joints are, fixed ones left out: those of the tree, then the cut joints."""

    row: np.ndarray  # Int, shape (number of joints in the tree,): Of the bodies that they carry
    body: np.ndarray  # Int, shape (n, 2): Rows of the two bodies of each
    #: Shape (2 n, 2 or 3): The joint's point on the one body and on the other [m].
    point: np.ndarray


class LoopModel:
    """
    A model, in the plane or in space, and which closure equations the elimination works on.

    Parameters
    ----------
    mechanism : Mechanism
        In the plane or in space.
    decomposition : Decomposition, optional
        Found here when not given.

    Attributes
    ----------
    model : engine.types.Model
    equations : codegen.equations.Equations
        Of ``model``.
    placements : dict of str to tree_rows.Placement
        Where the bodies' frames are in those of their rows.
    rows : dict of str to int
        Row of each body in the model's arrays.
    has_redundant_constraints : bool
        Whether the elimination leaves out equations that repeat others.
    by_masses : bool
        Whether masses had a part in the choice of equations at the start.
    unexplained : ndarray or None
        Closed position, shape (nq,), where equations depend on others that do not imply them.
    opening : float
        Closure errors of equations that are left out, in sizes of the mechanism, up to which they
        count as repeating others.

    """

    def __init__(self, mechanism, decomposition=None):
        self.mechanism = mechanism
        self._decomposition = decomposition or decompose(mechanism)
        self._first, self._known, self.model = None, {}, None
        # Which equations motions change by more than rounding, where some are not of these.
        self._changing, self._has_looked = None, False
        # Where equations were last chosen, and those that have been worked on there.
        self._place, self._tried = b'', set()
        self._choices = self.unexplained = None
        self.opening, self.by_masses = AS_GOOD_AS_CLOSED, False
        self.select(None)

    def model_of(self, kept):
        """
        Return the model of some equations, and these.

        ``kept``, bool of shape (nc,): which the elimination is to work on; all that motions change
        when None. The model shares all that effects change with the others.
        """
        kept = self._changing if kept is None else kept
        key = None if kept is None else kept.tobytes()
        if key not in self._known:
            model, self.placements, _ = mechanism_arrays(
                self.mechanism, decomposition=self._decomposition, kept=kept)
            self.rows = {name: one.row for name, one in self.placements.items()}
            if self.model is not None:
                model = self.model.with_cut(model.cut)
            self._known[key] = model, Equations(model)
        return self._known[key]

    @property
    def joint_points(self):
        """Return where the joints are on their two bodies, fixed ones of the tree left out."""
        joints = [joint for joint in self.mechanism.joints if joint.type != FIXED]
        origin = (0.0, 0.0) if self.mechanism.planar else (0.0, 0.0, 0.0)
        ends = [((joint.parent, joint.position), (joint.child, origin)) for joint in joints]
        ends += [((cut.body_a, cut.point_a), (cut.body_b, cut.point_b))
                 for cut in self.mechanism.cut_joints]
        placed = [self._placed(*end) for pair in ends for end in pair]
        return JointPlaces(
            np.array([self._placed(joint.child, origin)[0] for joint in joints], dtype=np.int64),
            np.array([row for row, _ in placed], dtype=np.int64).reshape(-1, 2),
            np.array([place for _, place in placed], dtype=float).reshape(-1, len(origin)))

    def _placed(self, body, position):
        """Return the row of a body, and a point of the body in the frame of the row."""
        placement = self.placements[body]
        return placement.row, placement.place(position)

    def select(self, kept):
        """Retain some equations in the elimination, as ``model_of``; return the model."""
        self.model, self.equations = self.model_of(kept)
        self.has_redundant_constraints = not self.equations.kept.all()
        return self.model

    def leave_out_repeated(self, q, hold=()):
        """Retain independent equations, near a closed position with some joints held."""
        if self.mechanism.planar and self.equations.nc > MOST_EQUATIONS:
            return
        assembler = Assembler(self.mechanism, self.equations)
        if self.plainly_independent(q):
            return
        with suppress(AssemblyError):
            place = assembler.positions(q, hold)
            self.by_masses = assembler.by_masses
            dependent = rank_of(assembler.dimensionless(place)) < self.equations.nc
            self.choose(place)
            self._first = self.kept
            self.unexplained = place if dependent and (
                self.model is self.model_of(None)[0]) else None

    def leave_out_unchanging(self, q):
        """
        Leave out equations that motions change by rounding alone, near a position.

        They hold as long as the joints of the tree do, wherever the loops drift to.
        """
        if self._has_looked or self.equations.nc > MOST_EQUATIONS:
            return
        self._has_looked = True
        rng, coordinates, most = np.random.default_rng(0), self.mechanism.coordinates, 0.0
        for _ in range(NEIGHBOURS):
            near = coordinates.moved(q, NEARBY * self.equations.units()[1] * rng.uniform(
                -1.0, 1.0, self.equations.nv))
            jac = self.equations.move(near).dimensionless()
            most = np.maximum(most, np.abs(jac).max(axis=1, initial=0.0))
        all_equations = self.model_of(None)[1].kept
        # What is exactly zero the elimination notices by itself: it divides by that.
        changing = all_equations & ((most > RANK_TOLERANCE) | (most == 0.0))
        if not np.array_equal(changing, all_equations):
            self._changing = changing
            self.select(None)

    def plainly_independent(self, q):
        """Return whether equations are so independent that closing the loops cannot change it."""
        if self.equations.nc > self.equations.nv:
            return False
        assembler = Assembler(self.mechanism, self.equations)
        # Not scaled by columns: what an open loop alone moves must not look like what moves it.
        singular = np.linalg.svd(assembler.dimensionless(q), compute_uv=False)
        rows, _ = self.equations.units()
        error = np.abs(self.equations.closures()[0] / rows).max(initial=0.0)
        return singular.min(initial=1.0) > max(PLAIN, FAR * error)

    def choose(self, q):
        """Retain equations in the elimination that are independent at or near a position."""
        self.leave_out_unchanging(q)
        assembler, place = Assembler(self.mechanism, self.equations), q
        for seed in range(MOST_TRIES):
            # Where many loops are flat at once, not all of them may have opened nearby.
            place = assembler.of_largest_rank(place, seed)
            kept, apart = independent(assembler.dimensionless(place), self.equations.groups)
            if kept.all():
                break
            opening = max(AS_GOOD_AS_CLOSED, min(FARTHER * apart, MOST_OPEN))
            if Assembler(self.mechanism, self.equations, kept).implies_all(q, opening):
                self.opening = max(self.opening, opening)
                return self.select(kept)
        return self.select(None)

    def choices(self, q):
        """
        Return the choices of equations that the elimination may come to work on, if they are few.

        Which equations are independent is the same almost everywhere on the way of a mechanism:
        where it is asked first, at the closed start. Empty where no equation repeats others, or
        there are more than ``MOST_CHOICES`` to try, or fewer where the mechanism is large.
        """
        if self._choices is None:
            self._choices = self._independent_choices(q)
        return self._choices

    def _independent_choices(self, q):
        assembler, found, kept = Assembler(self.mechanism, self.equations), [], self.equations.kept
        most = min(MOST_CHOICES, int(MOST_UNROLLED_OPERATIONS // unrolled_size(
            self.model, MOST_UNROLLED_OPERATIONS)))
        if not kept.all() and math.comb(len(kept), int(kept.sum())) > most:
            return found
        jac = assembler.dimensionless(assembler.of_largest_rank(q, 0))
        count = int(independent(jac, self.equations.groups)[0].sum())
        if count == len(jac) or math.comb(len(jac), count) > most:
            return found
        for rows in combinations(range(len(jac)), count):
            kept = np.isin(np.arange(len(jac)), rows)
            if distinctness(jac, self.equations.groups, kept) > RANK_TOLERANCE:
                found.append(kept)
        return found

    def has_code(self, model, q):
        """Return whether a model that was made here is the first, or one of ``choices``."""
        return any(model is self.model_of(kept)[0] for kept in (self._first, *self.choices(q)))

    def _jacobian(self, q):
        """Return J of all equations, without units, at or near a position that is singular."""
        assembler = Assembler(self.mechanism, self.equations)
        jac = assembler.dimensionless(q)
        singular = rank_of(jac, self._digits) < self.equations.kept.sum()
        return assembler.jacobian_of_largest_rank(q) if singular else jac

    @property
    def kept(self):
        """Return the argument of ``select``."""
        return None if self.equations.kept.all() else self.equations.kept

    def is_valid(self, q):
        """Return whether the equations left out repeat others at or near a closed position."""
        jac = scaled(self._jacobian(q), self.equations.groups)
        return rank_of(jac, self._digits) == rank_of(jac[self.equations.kept], self._digits)

    @property
    def _digits(self):
        """Singular value, scaled, up to which an equation repeats others in this machine."""
        return max(RANK_TOLERANCE, NEAR_BRANCH * math.sqrt(self.opening))

    def as_at_first(self):
        """Go back to the equations that were chosen first; return the model."""
        return self.select(self._first)

    def reselected(self, q, better, nearby):
        """
        Choose other equations for the elimination where the present ones are ill-conditioned.

        ``better``: factor by which the smallest singular value must grow; ``nearby``: whether to
        consider positions nearby where this one is singular, which takes long. Returns the model
        of the new choice; None where the present one is as good, there are fewer equations to
        choose here, more of them cannot be met, or they have been worked on here before, so that
        it is not progress.
        """
        if q.tobytes() != self._place:
            self._place, self._tried = q.tobytes(), set()
        self._tried.add(self.equations.kept.tobytes())
        jac = self._jacobian(q) if nearby else Assembler(
            self.mechanism, self.equations).dimensionless(q)
        present = self.equations.kept
        kept, _ = independent(jac, self.equations.groups, self._digits)
        if kept.tobytes() in self._tried:
            return None
        if kept.sum() < present.sum() or kept.sum() == present.sum() and not (
                distinctness(jac, self.equations.groups, kept)
                > better * distinctness(jac, self.equations.groups, present)):
            return None
        if kept.sum() > present.sum() and self.contradiction(q):
            return None
        return self.select(kept)

    def choose_for_run(self, q, wanted, better):
        """
        Choose the equations on which a run goes on; return whether it may.

        Some are left out where none are; else others are chosen after a step that failed.
        ``wanted``: as the run reports it, ``nearby`` as for ``reselected``, and ``or_these``:
        whether the present equations may be kept; ``better`` is as for that, too.
        """
        if not self.has_redundant_constraints:
            self.choose(q)
        elif self.reselected(q, better, wanted.nearby) is None and not (
                wanted.or_these and (not wanted.nearby or self.is_valid(q))):
            if wanted.nearby and self.contradiction(q):
                return False
            # An equation left out may be the one that closes the loop.
            self.select(None)
        return True

    def contradiction(self, q):
        """Return which loops contradict one another near a position, as ``Assembler`` has it."""
        return Assembler(self.mechanism, self.equations).contradiction(q, AS_GOOD_AS_CLOSED)

    @property
    def choice(self):
        """Return the present choice of equations, and what was found on the way to it."""
        return {'kept': self.kept, **{name: deepcopy(getattr(self, name)) for name in (
            'opening', '_changing', '_has_looked', '_place', '_tried', '_first')}}

    def take(self, choice):
        """Choose equations as another one of the same mechanism has them; return the model."""
        vars(self).update({name: value for name, value in choice.items() if name != 'kept'})
        return self.select(choice['kept'])

    @property
    def may_leave_out(self):
        """Whether equations were left out at the start."""
        return self._first is not None


def scaled(jac, groups):
    """
    Scale a Jacobian without units so that levers of coordinates and equations do not decide.

    Shape (nc, nv), of all equations. Rounding errors of entries that are zero are not scaled up.
    ``groups``, shape (nc,): equations of one kind, which are scaled alike: one that hardly changes
    stays small. So do those of a kind that change by the last digits of axes only.
    """
    columns = np.abs(jac).max(axis=0, initial=0.0)
    moves = columns > ROUNDING
    found = np.where(moves, jac / np.where(moves, columns, 1.0), 0.0)
    rows = largest_of_group(np.linalg.norm(found, axis=1), groups)[:, np.newaxis]
    return found / np.where(rows > RANK_TOLERANCE, rows, 1.0)


def largest_of_group(values, groups):
    """Return for each of some values, zero or more, the largest one of its group."""
    largest = np.zeros(groups.max(initial=-1) + 1)
    np.maximum.at(largest, groups, values)
    return largest[groups]


def independent(jac, groups, least=RANK_TOLERANCE):
    """
    Choose rows of a Jacobian without units that do not depend on one another, by pivoting.

    ``groups`` are as for ``scaled``; what is left of a row up to the length ``least`` depends on
    others. Which rows are kept, bool of shape (nc,), and how far the others are from depending on
    these: the length of the longest scaled row.
    """
    kept, left = np.zeros(len(jac), dtype=bool), scaled(jac, groups)
    while not kept.all():
        length = np.where(kept, 0.0, np.linalg.norm(left, axis=1))
        best = int(np.argmax(length))
        if length[best] <= least:
            return kept, length[best]
        kept[best] = True
        direction = left[best] / length[best]
        left = left - np.outer(left @ direction, direction)
    return kept, 0.0


def distinctness(jac, groups, kept):
    """Return the smallest singular value of some equations, scaled."""
    return np.linalg.svd(scaled(jac, groups)[kept], compute_uv=False).min(initial=1.0)
