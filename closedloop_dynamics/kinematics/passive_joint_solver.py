# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Whole positions and rates of a mechanism from those of some of its joints.

A robot measures its drives; the loops determine where all other joints are. Of the positions that
close the loops the nearest to the measured ones is found, in the sense of weighted least squares:
as many measured joints as there are degrees of freedom are met, more of them are balanced.

Several positions may do, on branches that meet in singular positions only. So the way there is
followed from the last one, in pieces in which no joint moves far. Each piece is the engine's loop
solver's; here is how far it may be, and on which branch it ends.
"""

import math

import numpy as np

from .assembly import LARGEST_CORRECTION, TOLERANCE
from .geometry import Geometry
from .loop_model import independent
from .modeling import extent
from ..codegen.equations import Loops, NO_METRIC
from ..engine.ranks import rank_from, rank_of
from ..mechanism.errors import SimulationError

# Of lengths against the size of the mechanism; angles [rad]. A measured joint moves no further in
# a piece of the way, another one no further in a piece that is taken for sure; how often a piece
# is halved, and how many there are at most.
PIECE, SURE, HALVINGS, MOST_PIECES = 0.1, 0.5, 12, 200
# The sine is that of a position no further away than this.
NEAR = 0.02
# Weight of the others beside measured joints: it determines which way they move where nothing
# else does, and what is measured is met nevertheless.
LITTLE = 1e-18
# Branches meet where the sine is zero: on a way longer than this share of it, it is looked whether
# the other one was come to. Below TOUCHED it may be either.
FOLD, TOUCHED = 0.25, 0.01


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
        For joints that are not single freedoms of the tree, or do not determine all others.

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
        self._size = extent(mechanism)
        lengths = np.array(coordinates.lengths, dtype=bool)
        self._unit = np.where(lengths, self._size, 1.0)
        self._weight, own = np.full(len(self._unit), LITTLE), _positive(weights, len(self._rates))
        self._weight[self._rates] = own / own.max()
        self._weight /= self._unit ** 2
        self._turns = ~lengths[self._rates]
        self._equations = Geometry(mechanism).equations
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
            found = self._solved(0.0, rates, self.velocity)
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
        bias = self._equations.move(self.position, self.velocity).closures()[2]
        return self._solved(-bias[self._rows], wanted, np.zeros_like(self.velocity))

    def get_ready(self):
        """Look ahead at how near the present position is to a singular one."""
        if self._gone > NEAR:
            self._prepare(self.position)

    def _follow(self, values, halvings):
        """Go on to measured values; by way of the middle where that is too far."""
        found = self.position.copy()
        self._equations.solve('close_loops', found, self._loops(values), 0.0, 0.0)
        if self._equations.move(found).closure_error() <= TOLERANCE * max(1.0, self._size):
            moved = np.abs(self._coordinates.apart(found, self.position) / self._unit).max()
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

    def _loops(self, values):
        """Return what the engine is to close next to measured values, or rates."""
        return Loops(
            self._equations.places, self._rows, np.arange(len(self._unit)),
            limit=LARGEST_CORRECTION * max(1.0, self._size), weight=self._weight,
            measured=self._rates, values=values)

    def _solved(self, wanted, rates, near):
        """Return the x with J x = ``wanted`` that matches the measured joints."""
        found = near.copy()
        wanted = np.broadcast_to(wanted, len(self._rows)).copy()
        parts = self._equations.solve(
            'close_rates', self.position, found, self._loops(rates), wanted)
        return np.full_like(found, math.nan) if parts & NO_METRIC else found

    def _prepare(self, q):
        """Find independent equations at a position, and how near it is to a singular one."""
        dimensionless = self._equations.move(q).dimensionless()
        self._rows = np.arange(len(dimensionless))
        if self._rank < len(dimensionless):
            self._rows = np.flatnonzero(independent(dimensionless, self._equations.groups)[0])
        basis = np.linalg.svd(self._equations.jacobian() * self._unit)[2][self._rank:].T
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
        if seen.shape[0] == seen.shape[1]:
            sign = np.sign(np.linalg.det(seen))
            self._sign = self._sign or sign
            self._turned = sign * self._sign < 0.0
        self.passed = self.passed or self.sine < TOUCHED


def _positive(weights, count):
    """Return weights as an array; ones when not given."""
    if weights is None:
        return np.ones(count)
    found = np.array(weights, dtype=float)
    if found.shape != (count,) or not (np.isfinite(found) & (found > 0.0)).all():
        raise ValueError(f'weights: expected {count} positive numbers, got {weights!r}')
    return found
