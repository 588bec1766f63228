# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Positions and velocities that close the loops, found from approximate ones.

The engine closes loops (``engine/loop_solver.hpp``); here is what is done at and near singular
positions, and what is said of them. Coordinates that are held stay as given; where none are held,
or velocities are free, the change is the least one in the mass metric.
"""

from contextlib import suppress
from itertools import chain
import math
from operator import itemgetter

import numpy as np

from .modeling import extent
from ..codegen.equations import BY_ITSELF, Loops, MASSES, NO_METRIC, TURNED
from ..engine.ranks import null_space, rank_of, RANK_TOLERANCE, singular_values
from ..mechanism.digits import EVERYDAY, suspicions
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import (
    CYLINDRICAL, DISTANCE, FIXED, HELICAL, PLANAR, POINT_ON_LINE, POINT_ON_PLANE, PRISMATIC,
    REVOLUTE, UNIVERSAL)

# Parts of a cut joint, as messages name them, in the order of its equations; a pin in the plane
# has the first one only.
POINTS, LINE = 'm between its points', 'm beside its axis'
TURN, TILT = 'rad of its angle', 'rad between its axes'
PARTS = {
    PRISMATIC: (LINE, TURN), CYLINDRICAL: (LINE, TILT), POINT_ON_LINE: (LINE,),
    HELICAL: (LINE, TILT, 'm along its thread'), POINT_ON_PLANE: ('m off its plane',),
    PLANAR: ('m off its plane', TILT), DISTANCE: ('m of its length',), FIXED: (POINTS, TURN),
    REVOLUTE: (POINTS, TILT), UNIVERSAL: (POINTS, 'rad from a right angle of its axes')}
# Closed means this, relative to the mechanism's size (or 1, for a rate or an angle).
TOLERANCE = 1e-12
# No single correction moves a coordinate further [rad, or in units of the size], so that
# the solution found is the one on the branch of the guess.
LARGEST_CORRECTION = 0.25
# Inertia of a motion against the largest: less is none.
NO_INERTIA = 1e-13
# Dense ranks of larger mechanisms would take longer than all the rest of the set-up.
MOST_EQUATIONS = 300
# How far away neighbours of a position are looked for [rad, and shares of the size], how many; and
# how far open they may be, in sizes, where equations repeat others but for the last digits of
# lengths, so that the loops close better only far away, or nowhere.
NEARBY, NEIGHBOURS, MOST_OPEN = 0.1, 3, 5e-6
# Next to a change point: relative singular values above this decide the branch of a position;
# rates are interpolated, with these weights, between places so many steps away [rad, and relative
# to the fastest rate], if both agree so far.
BRANCH_DIGITS, BRANCH_STEP, BRANCH_ERROR = 1e-8, 0.015, 0.05
BRANCH_PLACES = {1: 0.8, -1: 0.8, 2: -0.4, -2: -0.4, 3: 4 / 35, -3: 4 / 35, 4: -1 / 70,
                 -4: -1 / 70}
# How far, relatively, a change of rates may open the loops where a motion continues them.
CONTINUATION_TOLERANCE = 1e-5
# Gaps, against the largest one, that are due to the same contradiction.
OF_ONE_KIND = 0.1
# Larger changes of a guess are reported [rad, and shares of the size; shares of a rate].
LARGE_MOVE, LARGE_CHANGE_OF_RATE = 0.5, 0.1
# With relative singular values below this a guess is too near two branches to belong to one.
UNDECIDED = 1e-3
# Angles beyond a turn that are multiples of this are rarely radians [deg].
DEGREES = 0.5


class Assembler:
    """
    Closes the loops of one mechanism.

    ``equations``: codegen.equations.Equations; those of the mechanism. ``kept``: ndarray of bool,
    shape (nc,), optional; to close some of them only.

    Attributes
    ----------
    is_light : bool
        Whether bodies are so light that motions may be without inertia.
    by_masses : bool
        Whether masses had a part in what was found since this was set False: where closing the
        loops leaves no freedom they have none.

    """

    def __init__(self, mechanism, equations, kept=None):
        self._equations = equations
        self.rebind(mechanism)
        self.extent = extent(mechanism)
        self._limit = LARGEST_CORRECTION * max(1.0, self.extent)
        self._coordinates = mechanism.coordinates
        self._kept = np.arange(equations.nc) if kept is None else np.flatnonzero(kept)
        self.nv, self.nc = equations.nv, len(self._kept)
        # Right-hand sides of the velocities: those of prescribed motions, behind all others.
        self.prescribed_rates = np.zeros(len(mechanism.motions))
        self.by_masses = False

    def rebind(self, mechanism):
        """Go on with a mechanism of other masses, which the equations have already."""
        self.mechanism = mechanism
        self.is_light = any(body.inertia == 0.0 and not (body.mass and any(body.center_of_mass))
                            for body in mechanism.bodies)

    def closure(self, q):
        """Return psi, shape (nc,), in the mechanism's order [m, rad]."""
        return self._equations.move(q).closures()[0][self._kept]

    def jacobian(self, q):
        """Return J = d psi / d q, shape (nc, nv)."""
        return self._equations.move(q).jacobian()[self._kept]

    def dimensionless(self, q):
        """Return J in units of the mechanism, as ``Equations.dimensionless``."""
        return self._equations.move(q).dimensionless()[self._kept]

    def inertia(self, q):
        """Return the generalized inertia matrix of the spanning tree, shape (nv, nv)."""
        return self._equations.move(q).inertia()

    @property
    def groups(self):
        """Numbers that equations of one kind have in common, as ``Equations`` has them."""
        return self._equations.groups[self._kept]

    def positions(self, guess, hold=()):
        """
        Find joint coordinates that close the loops, of approximate ones, shape (nq,).

        AssemblyError where the loops cannot be closed from there, or ``hold`` leaves freedoms
        open.
        """
        free = self._free(hold)
        q, psi = self.solve_closure(guess, free)
        if not (self._is_closed(psi) or self._is_closed_to_digits(guess, psi, hold)):
            self._require_no_surplus(guess, hold)
            raise AssemblyError(self._open_loops(guess, psi, hold))
        if len(hold) > 0:
            self._require_complete(q, free, hold)
        if self.is_light:
            self.by_masses = True
            self._require_inertia(q)
        return q

    def close_states(self, q, qd, hold):
        """
        Close the loops of many states in place, shapes (n, nq) and (n, nv), where that is plain.

        As ``positions`` and ``velocities`` do, without their messages. Returns how, by state:
        ``BY_ITSELF``, ``PLAIN`` or ``TURNED``, shape (n,).
        """
        free = self._free(hold)
        incomplete = len(hold) > 0 and len(free) != self.nc and (
            not self._coordinates.with_orientation)
        how = np.full(len(q), BY_ITSELF, dtype=np.int64)
        if not (self.is_light or self.prescribed_rates.size or incomplete):
            self._equations.solve(
                'close_states', q, qd, self._loops(free), TOLERANCE * self.extent, how)
        return how

    def count_notes(self, position, velocity, q, qd, hold, how):
        """Return how many ``notes`` there are of each of many states that were closed at once."""
        names = self._coordinates
        turned = np.array([how[k] == TURNED and self._mirrored(position[k], q[k], hold)
                           for k in range(len(q))], dtype=bool) if (how == TURNED).any() else False
        most = LARGE_MOVE * np.where(names.lengths, self.extent, 1.0)
        moved = (np.abs(names.apart(q, position)) > most).any(axis=1) | turned
        angles = position[:, names.place[(names.place >= 0) & ~names.lengths]]
        degrees = (np.abs(angles) > 2.0 * math.pi) & _looks_like_degrees(angles)
        changed = np.abs(qd - velocity) > LARGE_CHANGE_OF_RATE * np.abs(velocity)
        return moved + degrees.any(axis=1).astype(int) + (changed & (velocity != 0.0)).sum(axis=1)

    def _is_closed_to_digits(self, guess, psi, hold):
        """Return whether loops stay open by digits alone, whatever is held."""
        # Axes that were made parallel have turned by as much, whatever the size is.
        enough = self.mechanism.tolerance * np.where(
            self._equations.places[self._kept] == 1, self.extent, 1.0)
        if not (np.abs(psi) <= enough).all():
            return False
        if len(hold) == 0:
            return True
        _, left = self.solve_closure(guess, np.arange(self.nv))
        return not self._is_closed(left) and bool((np.abs(left) <= enough).all())

    def solve_closure(self, q, free, enough=TOLERANCE):
        """
        Return the coordinates where Newton's method ended, and psi there.

        ``enough``: float; closure error, in sizes, with which no other method is tried.

        """
        found = np.array(q, dtype=float)
        self._note(self._equations.solve(
            'close_loops', found, self._loops(free), TOLERANCE * self.extent,
            enough * self.extent))
        return found, self.closure(found)

    def _loops(self, free, tolerance=RANK_TOLERANCE):
        """Return what the engine is to close, by some freedoms."""
        # Coordinates without inertia of their own get a little: the change stays finite.
        return Loops(self._equations.places, self._kept, free, tolerance,
                     NO_INERTIA if self.is_light else 0.0, self._limit)

    def _note(self, parts):
        """Note what had a part in closing loops."""
        self.by_masses |= bool(parts & MASSES)
        if parts & NO_METRIC:
            raise AssemblyError(
                f'The masses and lengths of {self.mechanism.name} give an inertia that cannot be '
                'computed with: look for values that are far too large, or next to nothing.')

    def _is_closed(self, psi, enough=TOLERANCE):
        return np.abs(psi).max(initial=0.0) <= enough * self.extent

    def velocities(self, q, guess, hold=()):
        """
        Find joint rates that keep the loops closed, of approximate ones, shape (nv,).

        ``q`` closes the loops; rates of the joints in ``hold`` are kept. AssemblyError where the
        held rates contradict one another, or no motion continues the rates.
        """
        try:
            return self._velocities(q, guess, hold)
        except AssemblyError:
            found = self._velocities_beside(q, guess, hold)
            if found is None:
                raise
            return found

    def _velocities(self, q, guess, hold):
        """Find the same by the equations at the position alone."""
        qd = np.array(guess, dtype=float)
        if not (qd.any() or self.prescribed_rates.any()):
            return qd
        jac = self.jacobian(q)
        wanted = self._wanted_rates()
        if np.abs(jac @ qd - wanted).max(initial=0.0) <= (
                TOLERANCE * self.extent * np.abs(qd).max()):
            # As they are, to the last digit.
            return self._continued(q, qd, hold)
        rate = jac @ qd - wanted
        qd = self._nearest_rates(q, qd, hold)
        left = np.abs(jac @ qd - wanted).max(initial=0.0)
        scale = max(np.abs(qd).max(initial=0.0) * self.extent, np.abs(rate).max(initial=0.0))
        if left > 1e-9 * scale:
            raise AssemblyError(self._rates_apart(q, left, hold))
        return self._continued(q, qd, hold)

    def _wanted_rates(self):
        """Return the right-hand sides of J qd: the rates of prescribed motions, behind zeros."""
        wanted = np.zeros(self.nc)
        wanted[self.nc - len(self.prescribed_rates):] = self.prescribed_rates
        return wanted

    def _nearest_rates(self, q, guess, hold, tolerance=RANK_TOLERANCE):
        """Return the rates nearest to a guess with which independent equations stay closed."""
        found = np.array(guess, dtype=float)
        self._note(self._equations.solve(
            'close_rates', np.array(q, dtype=float), found,
            self._loops(self._free(hold), tolerance), self._wanted_rates()))
        return found

    def _rates_apart(self, q, left, hold):
        """Return why rates open the loops, at ``left`` [m/s]."""
        held = [*hold, *(motion.name for motion in self.mechanism.motions)]
        lost = self.lost_equations(q) if self.nc <= MOST_EQUATIONS else 0
        if lost:
            return (f'{self.mechanism.name} stands at a change point (a singular position), to '
                    f'the digits that its position has: {self._dependence(lost)}, and which way '
                    f'the loops move on is not determined. {self._beside(hold)}')
        what = (f'The velocities held at {", ".join(held)} contradict the loops' if held else
                'No velocities near those given keep the loops closed')
        return (f'{what}: the cut joints would separate at {left:.3g} m/s. Hold fewer joints, or '
                'start at other velocities.')

    def _velocities_beside(self, q, guess, hold):
        """
        Find rates next to a change point: those of the branch on which the position is.

        There rounding of the position, divided by the distance from the change point twice, shows
        in rates: they are interpolated between places farther away. None where the equations are
        as dependent as they are around, or the branch is not determined.
        """
        if self.nc > MOST_EQUATIONS or self.prescribed_rates.size:
            return None
        free, scaled = self._free(hold), self.dimensionless(q)
        for columns in (scaled, scaled[:, free]):
            singular = singular_values(columns)
            weak = singular / singular.max(initial=1.0)
            if ((weak > BRANCH_DIGITS) & (weak <= RANK_TOLERANCE)).any():
                break
        else:
            return None
        ahead = self._nearest_rates(q, guess, hold, BRANCH_DIGITS)
        fastest = np.abs(ahead).max(initial=0.0)
        if not fastest > 0.0:
            return None
        found = np.zeros(self.nv)
        for distance, weight in BRANCH_PLACES.items():
            place, psi = self.solve_closure(
                self._coordinates.moved(q, ahead * (distance * BRANCH_STEP / fastest)), free)
            if not self._is_closed(psi):
                return None
            try:
                found += weight * self._velocities(place, guess, hold)
            except AssemblyError:
                return None
        near = np.abs(found - ahead).max() <= BRANCH_ERROR * fastest
        return found if near else None

    def _continued(self, q, qd, hold):
        """Return rates, unless the position is singular and no motion continues with them."""
        if self.nc > MOST_EQUATIONS or not qd.any():
            return qd
        dependent = null_space(self._equations.move(q).dimensionless()[self._kept].T)
        if not dependent.size:
            return qd
        units = self._equations.units()[0][self._kept]
        fastest = np.abs(qd).max()
        ahead = qd * (1e-4 / fastest)
        bias = (self.jacobian(self._coordinates.moved(q, ahead))
                - self.jacobian(self._coordinates.moved(q, -ahead))) @ qd * (0.5e4 * fastest)
        if np.abs(dependent @ (bias / units)).max() > CONTINUATION_TOLERANCE * fastest ** 2:
            raise AssemblyError(
                f'{self.mechanism.name} stands at a change point (a singular position): '
                f'{self._dependence(len(dependent))}, and the velocities '
                f'{"that follow from those held" if len(hold) > 0 else "nearest to those given"} '
                f'belong to none of the ways in which the loops can move on. '
                f'{self._beside(hold)}')
        return qd

    def degrees_of_freedom(self, q):
        """Return the degrees of freedom at and near a closed position: nv less the rank."""
        return self.nv - self._largest_rank(q)[0]

    def lost_equations(self, q):
        """
        Return how many closure equations are lost at a closed position, and only there.

        Positive at a change point or another singular position; zero where equations depend on one
        another everywhere nearby.
        """
        return self._largest_rank(q)[0] - rank_of(self.dimensionless(q))

    def _largest_rank(self, q, seed=0):
        """Return the largest rank of the Jacobian at a closed position and near it, and where."""
        rank = rank_of(self.dimensionless(q))
        if rank == min(self.nc, self.nv):
            return rank, q
        return max(((rank, q), *((rank_of(self.dimensionless(near)), near)
                                 for near in self.neighbours(q, seed))), key=itemgetter(0))

    def jacobian_of_largest_rank(self, q):
        """Return J, without units, of a closed position, or of one nearby of a larger rank."""
        return self.dimensionless(self.of_largest_rank(q))

    def of_largest_rank(self, q, seed=0):
        """Return a closed position, or one nearby where the Jacobian has a larger rank."""
        return self._largest_rank(q, seed)[1]

    def implies_all(self, q, opening):
        """
        Return whether near a closed position all loops close where the equations that are kept do.

        ``opening`` is what counts as closed, in sizes of the mechanism.
        """
        return any(np.abs(self._equations.move(near).closures()[0]).max() <= (
            opening * self.extent) for near in self.neighbours(q))

    def neighbours(self, q, seed=0):
        """Yield closed positions near a closed one."""
        rng = np.random.default_rng(seed)
        size = np.where(self._coordinates.lengths, self.extent, 1.0)
        for _ in range(NEIGHBOURS):
            with suppress(AssemblyError):
                near, psi = self.solve_closure(
                    self._coordinates.moved(q, NEARBY * size * rng.uniform(-1.0, 1.0, self.nv)),
                    np.arange(self.nv), MOST_OPEN)
                if self._is_closed(psi, MOST_OPEN):
                    yield near

    def determined(self, q, derivatives):
        """
        Return which rates the closure equations determine by themselves, at and near a position.

        ``derivatives`` returns those of the rates by the joints', shape (n, nv), at a position,
        which closes the loops. Returns bool, shape (n,), None where there are too many equations
        for dense ranks.
        """
        most, found = -1, np.zeros(len(derivatives(q)), dtype=bool)
        if not 0 < self.nc <= MOST_EQUATIONS:
            return found
        for near in chain((q,), self.neighbours(q)):
            rows = self._equations.move(near).free_motions()
            rank = self.nv - len(rows)
            free = np.abs(derivatives(near) @ rows.T).max(axis=1, initial=0.0)
            if rank >= most:
                # Where equations are lost, rates seem free; at a dead centre they seem determined.
                found = (free <= RANK_TOLERANCE) & (found | (rank > most))
                most = rank
            if rank == min(self.nc, self.nv) and not found.any():
                break
        return found

    def advice_on_opening(self, q):
        """Return why a step from near a change point did not close, and a remedy; or ''."""
        if not 0 < self.nc <= MOST_EQUATIONS:
            return ''
        rank, _ = self._largest_rank(q)
        away = [singular_values(self.dimensionless(near))[rank - 1]
                for near in self.neighbours(q)]
        if not away or singular_values(self.dimensionless(q))[rank - 1] > 0.1 * max(away):
            return ''
        return ('The mechanism is at a change point (a singular position), where the loops can '
                'move on in more than one way, and forces or velocities push it out of all of '
                f'them. {self._beside(())}')

    def contradiction(self, q, opening):
        """
        Return which loops contradict one another near a position, and a remedy.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Nearly closing the loops.
        opening : float
            What counts as closed, in sizes of the mechanism.

        Returns
        -------
        str
            Empty where all loops can be closed nearby.

        """
        near, psi = self.solve_closure(q, np.arange(self.nv), math.inf)
        if self._is_closed(psi, opening) and (
                np.abs(self._coordinates.apart(near, q)).max() <= NEARBY):
            return ''
        gaps = self._gaps(psi)
        loops = [cut for cut in self.mechanism.closures
                 if gaps[cut.name] > OF_ONE_KIND * max(gaps.values())]
        joints = self._joints_of(loops)
        names = [f'{cut.name} ({cut.body_a} to {cut.body_b})'
                 if cut in self.mechanism.cut_joints else cut.name for cut in loops]
        places = [f'{name} = {q[place]:.4g}' for name, place in zip(
            self._coordinates.names, self._coordinates.place) if place >= 0 and name in joints]
        where = f' ({", ".join(places)})' if places else ''
        return (
            f'{" and ".join(names)} contradict one another: their equations nearly repeat one '
            'another, and so far from where the loops were drawn they cannot all be met, whatever '
            f'the step{where}. Keep these joints nearer to there by end stops (--end-stops makes '
            'them of the limits in a model file), or make the lengths of these loops agree to '
            'more digits.')

    def opened(self, q, qd, limit, motions=True):
        """
        Return which loops a state leaves open, and by how much; '' where all are closed.

        ``limit``: closure error that counts as closed [m or rad], and for rates times the fastest
        one, or times 1 rad/s; ``motions``: whether prescribed motions count, too.
        """
        psi, rate, _ = self._equations.move(q, qd).closures()
        for errors, most, what in (
                (psi, limit, 'open by {:.3g} m or rad'),
                (rate, limit * max(1.0, np.abs(qd).max(initial=0.0)),
                 'separating at {:.3g} m/s or rad/s')):
            gaps = self._gaps(errors)
            found = [f'{self._section(cut)}.{cut.name} {what.format(gaps[cut.name])}'
                     for cut in self.mechanism.closures
                     if not gaps[cut.name] <= most
                     and (motions or cut not in self.mechanism.motions)]
            if found:
                return ', '.join(found)
        return ''

    def _section(self, closure):
        """Return the section of a scene or mechanism that a closure is described in."""
        return ('cut_joints' if closure in self.mechanism.cut_joints else
                'couplings' if closure in self.mechanism.couplings else 'effects')

    def _gaps(self, psi):
        """Return the largest error of each cut joint, coupling and motion, by name."""
        found, first = {}, 0
        for cut, rows in zip(self.mechanism.closures, self._equations.counts):
            found[cut.name] = float(np.abs(psi[first:first + rows]).max(initial=0.0))
            first += rows
        return found

    def _joints_of(self, closures):
        """Return the names of the joints between the bodies that some closures join."""
        joints = {joint.child: joint for joint in self.mechanism.joints}
        found = set()
        for cut in closures:
            if cut not in self.mechanism.cut_joints:
                continue
            paths = []
            for body in (cut.body_a, cut.body_b):
                path = set()
                while body in joints:
                    path.add(joints[body].name)
                    body = joints[body].parent
                paths.append(path)
            found |= paths[0] ^ paths[1]
        return found

    def _dependence(self, count):
        return (f'{count} of {self.nc} closure equations depend{"s" if count == 1 else ""} on the '
                'others there')

    def _beside(self, hold):
        joint = [*hold, *self.mechanism.actuated_joints, *self.mechanism.joint_names][0]
        return (f'Start beside it, on the side it is to move on: with {joint} further by 0.01, '
                'say.')

    def notes(self, position, velocity, q, qd, hold):
        """
        Return notes of changes that an assembly made to its guess, with some joints held.

        Guesses are ``position`` and ``velocity``, assembled ``q`` and ``qd``.
        """
        return [*degree_notes(self.mechanism, position),
                *self._notes_on_position(position, q, hold),
                *self._notes_on_singularity(q, hold), *self._notes_on_lock(q),
                *self._notes_on_digits(q),
                *(f'The velocity {wanted:g} wanted of {name} became {got:.6g}: the nearest motion '
                  f'that keeps the loops closed. To have it as given, hold {name}.'
                  for name, wanted, got in zip(self._coordinates.names, velocity, qd)
                  if abs(got - wanted) > LARGE_CHANGE_OF_RATE * abs(wanted) > 0.0)]

    def _notes_on_digits(self, q):
        """Return a note where loops are closed to the digits of lengths and angles only."""
        psi = self.closure(q)
        if self._is_closed(psi):
            return []
        return [f'The loops close to {np.abs(psi).max():.2g} m or rad and nowhere better: taken '
                'as closed, as digits of the lengths and angles agree to no more.']

    def _notes_on_position(self, guess, q, hold):
        moved, names = [], self._coordinates
        for name, place, length, change in zip(
                names.names, names.place, names.lengths, names.apart(q, guess)):
            if abs(change) > LARGE_MOVE * (self.extent if length else 1.0):
                moved.append(
                    f'{name} moved from {guess[place]:.6g} to {q[place]:.6g} '
                    f'{"m" if length else "rad"}' if place >= 0 else
                    f'{name} turned by {change:.6g} rad')
        where = ('on the other branch than that of the position given, mirrored'
                 if self._mirrored(guess, q, hold) else
                 'far from the position given' if moved else '')
        if not where:
            return []
        return [f'The loops closed {where}{": " * bool(moved)}{", ".join(moved)}. Give a position '
                'nearer to the closed one that is wanted.']

    def _mirrored(self, guess, q, hold):
        """Return whether held joints fix the others, and on another branch than the guess's."""
        free = self._free(hold)
        if len(free) != self.nc or not 0 < self.nc <= MOST_EQUATIONS:
            return False
        before, after = (self.dimensionless(place)[:, free] for place in (guess, q))
        if min(singular[-1] / max(singular[0], 1.0)
               for singular in map(singular_values, (before, after))) < UNDECIDED:
            return False
        return np.linalg.slogdet(before)[0] != np.linalg.slogdet(after)[0]

    def _notes_on_singularity(self, q, hold):
        lost = self.lost_equations(q) if self.nc <= MOST_EQUATIONS else 0
        if not lost:
            return []
        return [f'The start is a change point (a singular position): {self._dependence(lost)}, '
                'and the loops can move on in more than one way. From rest, forces decide which, '
                f'or none can be followed. {self._beside(hold)}']

    def _notes_on_lock(self, q):
        """Return a note where couplings lock the mechanism, which is not an error otherwise."""
        if not self.mechanism.couplings or self.nc > MOST_EQUATIONS:
            return []
        rank, _ = self._largest_rank(q)
        if rank < self.nv:
            return []
        names = ', '.join(coupling.name for coupling in self.mechanism.couplings)
        return [f'Nothing can move: {rank} of {self.nc} equations are independent, as many as '
                f'there are joint coordinates. Look at the couplings: {names}.']

    def require_independent(self, q):
        """
        Refuse a closed configuration with dependent closure equations.

        AssemblyError where a method needs them independent, and they are not.
        """
        kept = self._equations.kept
        rank, count = rank_of(self.dimensionless(q)[kept]), np.count_nonzero(kept)
        if rank < count:
            raise AssemblyError(
                f'{count - rank} of {count} closure equations of {self.mechanism.name} depend '
                'on the others here (redundant cut joints, or a singular configuration), so that '
                'no set of independent coordinates can be chosen by them. Take stabilisation: '
                'projection.')

    def _free(self, hold):
        hold, joint_of = set(hold), self._coordinates.joint_of
        return np.array([k for k, name in enumerate(self._coordinates.names)
                         if not hold & {name, joint_of(name)}], dtype=int)

    def _require_inertia(self, q):
        """Refuse massless bodies that the loops leave free to move."""
        basis = self._equations.move(q).free_motions()
        if not len(basis):
            return
        inertia = basis @ self.inertia(q) @ basis.T
        values, vectors = np.linalg.eigh(inertia)
        if values[0] > NO_INERTIA * values[-1]:
            return
        motion = np.abs(vectors[:, 0] @ basis)
        names = [name for name, part in zip(self._coordinates.names, motion)
                 if part > 0.1 * motion.max()]
        raise AssemblyError(
            f'{self.mechanism.name} has a motion without inertia: {", ".join(names)} can move '
            'while nothing that has mass does, so that forces would accelerate it without limit. '
            'Give the bodies there some mass, or close a loop that guides them.')

    def _require_complete(self, q, free, hold):
        """Refuse held coordinates that leave others undetermined, here and all around."""
        missing = self._missing(q, free)
        if missing == 0:
            return
        # At a singular position even a complete choice leaves freedoms for an instant.
        missing = min([missing, *(self._missing(near, free) for near in self.neighbours(q))])
        if missing:
            raise AssemblyError(
                f'Holding {", ".join(hold)} is not a complete choice: {missing} degree'
                f'{"s" if missing > 1 else ""} of freedom stay{"" if missing > 1 else "s"} open. '
                f'Hold {missing} more of {", ".join(self._coordinates.names[k] for k in free)}'
                ', or hold none to take the nearest closed state.')

    def _require_no_surplus(self, guess, hold):
        """Refuse held joints that follow from those held before them."""
        q, psi = self.solve_closure(guess, np.arange(self.nv))
        if len(hold) == 0 or not self._is_closed(psi):
            return
        jac, held, surplus = self.jacobian_of_largest_rank(q), [], []
        for name in hold:
            before, after = (self._free(names) for names in (held, [*held, name]))
            free = rank_of(jac[:, before]) == rank_of(jac[:, after])
            (held if free else surplus).append(name)
        if surplus:
            count = self.degrees_of_freedom(q)
            raise AssemblyError(
                f'{self.mechanism.name} cannot be assembled with {", ".join(hold)} held: expected '
                f'joints that move independently ({count} degree{"s" * (count != 1)} of freedom), '
                f'got {", ".join(surplus)}, which follow{"s" * (len(surplus) == 1)} from '
                f'{", ".join(held) or "the closure equations"}. Leave {", ".join(surplus)} '
                'out of hold.')

    def _missing(self, q, free):
        """Return how many of some freedoms stay open at a position, where that matters."""
        # No number holds the idle spin of a rod: beside orientations the nearest state will do.
        if self._coordinates.with_orientation:
            return 0
        return len(free) - rank_of(self.dimensionless(q)[:, free])

    def _open_loops(self, guess, psi, hold):
        """Return a description of the loops that do not close."""
        worst, gaps = [], self._gaps(psi)
        for cut in self.mechanism.closures:
            gap = gaps[cut.name]
            if not gap <= TOLERANCE * self.extent:
                worst.append(f'{self._section(cut)}.{cut.name} open by ' + (
                    self._parts(cut, psi) or f'{gap:.3g} (m or rad)'))
        held = f' with {", ".join(hold)} held' if len(hold) > 0 else ''
        return (f'{self.mechanism.name} cannot be assembled from this position{held}: '
                f'expected loops that close, got {", ".join(worst)}. ' + ' '.join(
                    [self._advice_on_assembly(guess, psi, hold),
                     *angle_notes(self.mechanism, guess), *suspicions(self.mechanism)]))

    def _parts(self, cut, psi):
        """Return which parts of a cut joint are open, where it has several or an axis."""
        if cut not in self.mechanism.cut_joints:
            return ''
        counts, groups = self._equations.counts, self._equations.groups
        first = sum(counts[:self.mechanism.closures.index(cut)])
        rows = slice(first, first + counts[self.mechanism.closures.index(cut)])
        gaps = [np.linalg.norm(psi[rows][groups[rows] == group])
                for group in np.unique(groups[rows])]
        words = PARTS.get(cut.type, (POINTS,))
        if words[:len(gaps)] == (POINTS,):
            return ''
        return ' and '.join(f'{gap:.3g} {words}' for words, gap in zip(words, gaps)
                            if not gap <= TOLERANCE * self.extent)

    def closes(self, guess):
        """Return whether the loops close next to a position, shape (nq,), with nothing held."""
        with suppress(AssemblyError):
            _, psi = self.solve_closure(guess, np.arange(self.nv))
            return self._is_closed(psi) or self._is_closed_to_digits(guess, psi, ())
        return False

    def closed_from(self, guess):
        """Return a position that closes the loops, from any, shape (nq,); None where none is."""
        found, psi = self.solve_closure(guess, np.arange(self.nv))
        return found if self._is_closed(psi) else None

    def _advice_on_digits(self, psi):
        """Return what there is to do where loops may be open by rounded digits."""
        if not self._is_closed(psi, EVERYDAY):
            return ''
        wide = 10.0 ** math.ceil(math.log10(np.abs(psi).max() / self.extent))
        return (f' If rounded digits keep them open, --geometry-tolerance {wide:.0e}, or the key '
                'tolerance of the mechanism, takes them as closed.')

    def _advice_on_assembly(self, guess, psi, hold):
        nearer = ('Move the initial position closer to a closed one, or check lengths and cut '
                  'points.')
        if len(hold) == 0:
            return nearer + self._advice_on_digits(psi)
        q, psi = self.solve_closure(guess, np.arange(self.nv))
        if not self._is_closed(psi):
            return f'Nor can it with none held. {nearer}{self._advice_on_digits(psi)}'
        nearest = ', '.join(
            f'{column.partition(".")[2]} = {value:.6g}' for column, value
            in zip(self._coordinates.columns('position'), q) if column.split('.')[1] in hold)
        return f'With none held it closes at {nearest}: hold such values.'


def angle_notes(mechanism, position):
    """
    Return a note of angles beyond a whole turn, which may be degrees.

    ``position``: sequence, shape (nq,); joint coordinates.
    """
    return _angle_notes(mechanism, position, lambda angle: True)


def degree_notes(mechanism, position):
    """Return the same of those that people give in degrees alone: states have turned before."""
    return _angle_notes(mechanism, position, _looks_like_degrees)


def _looks_like_degrees(angle):
    return angle % DEGREES == 0.0


def _angle_notes(mechanism, position, counts):
    names = mechanism.coordinates
    large = {name: position[place] for name, place, length in zip(
                 names.names, names.place, names.lengths)
             if place >= 0 and not length and abs(position[place]) > 2.0 * math.pi
             and counts(position[place])}
    if not large:
        return []
    angles = ', '.join(f'{name} = {angle:g}' for name, angle in large.items())
    first = next(iter(large.values()))
    return [f'The position has angles beyond 2 pi: {angles}. They are taken as radians; in '
            f'degrees? {first:g} degrees are {math.radians(first):.6g} rad.']
