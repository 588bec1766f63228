# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Whole positions and rates of a mechanism from those of some of its joints.

A robot measures its drives; the loops decide where all other joints are. Of the positions that
close the loops the nearest to the measured ones is found, in the sense of weighted least squares:
as many measured joints as there are degrees of freedom are met, more of them are balanced.

Several positions may do, on branches that meet in singular positions only. So the way there is
followed from the last one, in pieces in which no joint moves far.
"""

import math

import numpy as np

from .assembly import TOLERANCE
from .errors import SimulationError
from .geometry import Geometry
from .modeling import extent
from ..core.manifold import manifold_of
from ..core.ranks import rank_from, rank_of
from ..engine import native

# Of lengths against the size of the mechanism; angles [rad]. A measured joint moves no further in
# a piece of the way, another one no further in a piece that is taken for sure; how often a piece
# is halved, and how many there are at most.
PIECE, SURE, HALVINGS, MOST_PIECES = 0.1, 0.5, 12, 200
# Corrections shorter than this are rounding; how long one is at most; how many there are at most;
# a correction longer than this share of the one before is no good, and the matrices are computed
# again.
ROUNDING, LONGEST, MOST_CORRECTIONS, POOR = 1e-13, 0.25, 30, 0.1
# Matrices are those of a position no further away than this.
NEAR = 0.02
# Branches meet where the sine is zero: on a way longer than this share of it, it is looked whether
# the other one was come to. Below TOUCHED it may be either.
FOLD, TOUCHED = 0.25, 0.01
# Singular values are at least this: corrections become too long, but stay numbers.
SMALLEST = 1e-150


class PassiveJointError(SimulationError):
    """Measured positions that belong to no position of the mechanism that can be reached."""


class PassiveJointSolver:
    """
    Follows a mechanism by the positions of some of its joints.

    Parameters
    ----------
    mechanism : Mechanism
    measured : sequence of str
        Joints of the tree, or freedoms of them, that are measured.
    position : sequence, shape (nq,)
        Closing the loops; where to begin, and on which branch [rad or m].
    weights : sequence of float, optional
        Of the measured joints, in their order: the inverse of the variance of each
        [1/rad^2 or 1/m^2]; equal ones when not given. They matter where more is measured than
        there are degrees of freedom.

    Attributes
    ----------
    measured : tuple of str
    position : ndarray, shape (nq,)
        Joint coordinates that close the loops to 1e-12 of the mechanism's size [rad or m].
    velocity : ndarray, shape (nv,)
        Joint rates that keep them closed [rad/s or m/s].
    residual : float
        The most that a measured joint is away from its measured position [rad or m].
    sine : float
        Sine of the smallest angle between the motions of the mechanism and those in which no
        measured joint moves. 0: singular, the measured joints do not determine the others.
    passed : bool
        Whether a singular position was touched or passed since the start, so that the mechanism
        may be on another branch now; this one stays on its own. Where the measured joints are not
        as many as the degrees of freedom, by the sine alone.

    Raises
    ------
    ValueError
        For joints that are no single freedoms of the tree, or do not determine all others.

    """

    def __init__(self, mechanism, measured, position, weights=None):
        coordinates = mechanism.coordinates
        self.measured, self._coordinates = tuple(measured), coordinates
        names = [coordinates.names[place] for place in coordinates.single]
        unknown = [name for name in self.measured if name not in names]
        if unknown or len(set(self.measured)) < len(self.measured) or not self.measured:
            raise ValueError(
                f'measured: expected different ones of {", ".join(names)}, the joints of the tree '
                f'that have one number, got {", ".join(self.measured) or "none"}; where another '
                'joint is measured, cut a loop elsewhere')
        self._rates = np.array([coordinates.index[name] for name in self.measured])
        self._places = np.array(coordinates.place)[self._rates]
        self._weights = np.sqrt(_positive(weights, len(self.measured)))
        self._size = extent(mechanism)
        lengths = np.array(coordinates.lengths, dtype=bool)
        self._unit = np.where(lengths, self._size, 1.0)
        self._turns = ~lengths[self._rates]
        geometry = Geometry(mechanism)
        self._equations, self._manifold = geometry.equations, manifold_of(geometry.model)
        self.position = np.array(position, dtype=float)
        self.velocity = np.zeros(coordinates.nv)
        self._values, self.residual, self.passed = self.position[self._places], 0.0, False
        self._basis, self._sign, self._turned, self._known = None, 0.0, False, None
        # Independent closure equations.
        self._rank = rank_of(self._equations.move(self.position).dimensionless())
        self._prepare(self.position)
        motions = self._basis.shape[1]
        # No number holds the idle spin of a rod between two spherical joints.
        if self._known < motions and not coordinates.with_orientation:
            raise ValueError(
                f'measured: {", ".join(self.measured)} leave {motions - self._known} of {motions} '
                'degrees of freedom open; measure as many other joints')

    def complete(self, position, velocity=None):
        """
        Find the whole position and rates of measured ones; into the attributes.

        Parameters
        ----------
        position, velocity : sequence, shape (number of measured joints,)
            Of ``measured`` [rad or m]; [rad/s or m/s], zero when not given. Angles may differ by
            whole turns.

        Raises
        ------
        PassiveJointError
            Where no such position closes the loops, or the way there is not clear: the last one
            is kept.
        ValueError
            For other than finite numbers.

        """
        values, rates = np.array(position, dtype=float), np.zeros(len(self.measured))
        if velocity is not None:
            rates = np.array(velocity, dtype=float)
        if values.shape != rates.shape or not np.isfinite([values, rates]).all():
            raise ValueError(f'expected {len(rates)} finite positions and velocities')
        values[self._turns] -= 2.0 * math.pi * np.round(
            (values - self._values)[self._turns] / (2.0 * math.pi))
        begin, before = self._values, (self.position, self._values)
        change = values - begin
        pieces = max(1, math.ceil(
            np.abs(change / self._unit[self._rates]).max() / PIECE))
        try:
            if pieces > MOST_PIECES:
                raise PassiveJointError(
                    f'{self.measured[int(np.abs(change).argmax())]} moved by '
                    f'{np.abs(change).max():.3g} rad or m at once: the way there is not known')
            for k in range(1, pieces + 1):
                self.get_ready()
                self._follow(begin + change * (k / pieces), HALVINGS)
            found = self._solved(
                self._equations.move(self.position).jacobian(), 0.0, rates, self.velocity)
            if not np.isfinite(found).all():
                raise PassiveJointError('the velocities grow beyond all bounds')
        except PassiveJointError:
            self.position, self._values = before
            self._prepare(self.position)
            raise
        self.velocity = found
        self.residual = float(np.abs(values - self.position[self._places]).max())

    def accelerations(self, acceleration):
        """
        Return the accelerations that keep the loops closed, of measured ones.

        Parameters
        ----------
        acceleration : sequence, shape (number of measured joints,)
            Of ``measured``, in the state that was completed last [rad/s^2 or m/s^2].

        Returns
        -------
        ndarray, shape (nv,)

        """
        wanted = np.array(acceleration, dtype=float)
        equations = self._equations.move(self.position, self.velocity)
        return self._solved(
            equations.jacobian(), equations.closures()[2], wanted, np.zeros_like(self.velocity))

    def get_ready(self):
        """Compute the matrices of the present position ahead, where they are of another one."""
        if self._gone > NEAR:
            self._prepare(self.position)

    def _follow(self, values, halvings):
        """Go on to measured values; by way of the middle where that is too far."""
        found, change = self._corrected(self.position, values)
        if found is not None:
            moved = np.abs(change / self._unit).max()
            if moved <= SURE and self._stays(found, moved):
                self.position, self._values = found, values
                self._gone += moved
                return
        self.get_ready()
        if halvings == 0:
            raise PassiveJointError(
                'no position that closes the loops was found next to the last one: sensors that '
                'contradict one another, a mechanism that is at its limit, or lengths that differ')
        self._follow(0.5 * (self._values + values), halvings - 1)
        self._follow(values, halvings - 1)

    def _stays(self, found, moved):
        """Return whether a position is on the same branch; it may not be far from a fold."""
        if not self._sign or self._gone + moved <= FOLD * self.sine:
            return True
        self._prepare(found)
        if self._turned:
            self.passed = True
            self._prepare(self.position)
            return False
        self._gone = -moved
        return True

    def _corrected(self, q, values):
        """
        Return the nearest position to measured values that closes the loops, and how far it is.

        Both are None where there is none.
        """
        last, whole = math.inf, np.zeros(len(self._unit))
        for _ in range(MOST_CORRECTIONS):
            psi = self._equations.move(q).closures()[0]
            change = self._operator @ np.concatenate([-psi, values - q[self._places]])
            largest = np.abs(change / self._unit).max()
            if not largest < math.inf:
                return None, None
            if largest > LONGEST:
                change *= LONGEST / largest
            q = self._moved(q, change)
            whole += change
            # The next one will be as much shorter as this one is.
            shorter = 1.0 if last == math.inf else min(1.0, largest / last)
            if largest * shorter <= ROUNDING:
                break
            # Where more is measured, the place of the nearest is that of the present matrices.
            if largest > POOR * last or not self._exact:
                self._prepare(q)
            last = largest
        closure = np.abs(self._equations.move(q).closures()[0]).max(initial=0.0)
        return (q, whole) if closure <= TOLERANCE * max(1.0, self._size) else (None, None)

    def _moved(self, q, change):
        """Return coordinates after a change, shape (nv,)."""
        if self._manifold is None:
            return q + change
        q = q.copy()
        native.move(self._manifold, q, change, 1.0)
        return q

    def _solved(self, jac, bias, wanted, near):
        """Return the x with J x = -bias that matches the measured joints."""
        x = near.copy()
        with np.errstate(over='ignore', invalid='ignore'):
            for _ in range(MOST_CORRECTIONS):
                change = self._operator @ np.concatenate(
                    [-jac @ x - bias, wanted - x[self._rates]])
                x += change
                if not np.abs(change).max() > ROUNDING * max(1.0, np.abs(x).max()):
                    break
                if not self._exact:
                    self._prepare(self.position)
        return x

    def _prepare(self, q):
        """
        Compute the matrix that corrects closure errors and misses of measured joints.

        With J = U S V^T its corrections are V S^-1 U^T of the closure errors, and motions in the
        null space of J that bring the measured joints nearest to their values.
        """
        jac = self._equations.move(q).jacobian() * self._unit
        left, singular, right = np.linalg.svd(jac)
        rank = self._rank
        closing = right[:rank].T / np.maximum(singular[:rank], SMALLEST) @ left[:, :rank].T
        basis = right[rank:].T
        if self._basis is not None and self._basis.shape == basis.shape and np.linalg.det(
                self._basis.T @ basis) < 0.0:
            # The same orientation as before, so that a sign means something.
            basis[:, 0] = -basis[:, 0]
        # How far a freedom has moved at most since.
        self._basis, self._gone = basis, 0.0
        seen = basis[self._rates]
        sines = np.linalg.svd(seen, compute_uv=False)
        if self._known is None:
            self._known = rank_from(sines)
        self.sine = float(sines[self._known - 1]) if self._known else 0.0
        self._exact = self._known == len(self.measured)
        if seen.shape[0] == seen.shape[1]:
            sign = np.sign(np.linalg.det(seen))
            self._sign = self._sign or sign
            self._turned = sign * self._sign < 0.0
        self.passed = self.passed or self.sine < TOUCHED
        solve = basis @ (np.linalg.pinv(self._weights[:, np.newaxis] * seen) * self._weights)
        self._operator = self._unit[:, np.newaxis] * np.hstack([
            closing - solve @ closing[self._rates], solve / self._unit[self._rates]])


def _positive(weights, count):
    """Return weights as an array; ones when not given."""
    if weights is None:
        return np.ones(count)
    found = np.array(weights, dtype=float)
    if found.shape != (count,) or not (np.isfinite(found) & (found > 0.0)).all():
        raise ValueError(f'weights: expected {count} positive numbers, got {weights!r}')
    return found
