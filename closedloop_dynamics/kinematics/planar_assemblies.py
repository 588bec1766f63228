# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
All assemblies of a driven planar mechanism, as solutions of polynomial equations.

Rotations of bodies are complex numbers z of absolute value 1, slides are complex numbers along a
rotation; loops are linear equations of them, and so are their conjugates of the conjugates
(isotropic coordinates: Wampler, 1996). A group of l loops with 2 l unknowns leaves z = X x and
conj(z) = Y y, and |z| = 1 is bilinear in x and y: in P^l x P^l there are binomial(2 l, l)
solutions, 2 of a dyad, 6 of three legs. They are found all at once, as eigenvalues of a matrix
from the null space of Macaulay's, whose dimension says that none is missing. Groups that do not
depend on one another are solved one after the other.
"""

from itertools import combinations_with_replacement
import math
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from ..mechanism.mechanism import DISTANCE, FIXED, GROUND, POINT_ON_LINE, PRISMATIC, REVOLUTE

# Groups of more loops have more than 70 solutions: matrices become too large.
MOST_LOOPS = 4
# Singular values of Macaulay's matrix, relative: smaller ones are zero; between both none may be.
ZERO, NOT_ZERO = 1e-11, 1e-9
# Solutions are at infinity below this; real where z and conj(z) differ by less than REAL and
# complex where by more than COMPLEX; residuals above WRONG belong to none.
INFINITE, REAL, COMPLEX, WRONG = 1e-7, 1e-6, 1e-4, 1e-6


class NotProved(Exception):
    """A mechanism, or a position, whose assemblies this method cannot all find."""


class Rotation(NamedTuple):
    """A rotation: a factor of the unknown of a class, 0 for the ground, which does not turn."""

    kind: int
    factor: complex


class PlanarEquations:
    """
    The equations of a driven planar mechanism in isotropic coordinates.

    Its ``motions`` are the driving equations, of ``values`` [rad or m]. NotProved for couplings,
    and loops that hold an angle twice.
    """

    def __init__(self, mechanism, values):
        if mechanism.couplings:
            raise NotProved('couplings of joints are not polynomial equations of rotations')
        self._mechanism = mechanism
        self._given = {motion.freedom: value for motion, value in zip(mechanism.motions, values)
                       if motion.freedom is not None}
        self._turns: Dict[str, Rotation] = {GROUND: Rotation(0, 1.0)}
        self._same: List[Rotation] = [Rotation(0, 1.0)]
        self._set_rotations(mechanism, values)
        self._places: Dict[str, Dict[Any, complex]] = {GROUND: {}}
        self._lines: Dict[Any, Rotation] = {}
        self._set_places(mechanism)
        self.equations = [*self._loops(mechanism), *self._points(mechanism, values)]

    # Rotations.

    def _root(self, turn):
        """Return a rotation in terms of the representative of its class."""
        while self._same[turn.kind].kind != turn.kind:
            one = self._same[turn.kind]
            turn = Rotation(one.kind, turn.factor * one.factor)
        return turn

    def _new(self):
        self._same.append(Rotation(len(self._same), 1.0))
        return self._same[-1]

    def _turn(self, body):
        return self._root(self._turns[body])

    def _unite(self, one, other):
        """Identify one rotation with another."""
        one, other = self._root(one), self._root(other)
        if one.kind == other.kind:
            raise NotProved('loops hold an angle more than once')
        if one.kind == 0:
            one, other = other, one
        self._same[one.kind] = Rotation(other.kind, other.factor / one.factor)

    def _set_rotations(self, mechanism, values):
        for joint in mechanism.joints:
            turn = self._turns[joint.parent]
            turn = Rotation(turn.kind, turn.factor * _unit(joint.angle))
            if joint.type == REVOLUTE:
                if joint.name in self._given:
                    turn = Rotation(turn.kind, turn.factor * _unit(self._given[joint.name]))
                else:
                    turn = self._new()
            self._turns[joint.child] = turn
        for cut in mechanism.cut_joints:
            held = cut.angle if cut.type in (PRISMATIC, FIXED) else None
            if f'{cut.name}.angle' in self._given:
                raise NotProved('the angle of a pin in a slot is driven')
            if cut.type == REVOLUTE and cut.name in self._given:
                held = cut.angle + self._given[cut.name]
            if held is not None:
                b = self._turn(cut.body_b)
                self._unite(self._turns[cut.body_a], Rotation(b.kind, b.factor * _unit(held)))
        # Two points of a body are its angle.
        first: Dict[str, Any] = {}
        for name, place in _given_points(mechanism, values).items():
            point = mechanism.point(name)
            at = complex(*point.position)
            if place is None or point.body not in first:
                first.setdefault(point.body, (at, place) if place is not None else None)
                continue
            if first[point.body] is None:
                continue
            arm, way = at - first[point.body][0], place - first[point.body][1]
            if not abs(abs(arm) - abs(way)) <= 1e-9 * abs(arm):
                raise ValueError(
                    f'points: expected places {abs(arm):.9g} m apart, as the points of '
                    f'{point.body} are, got {abs(way):.9g} m')
            self._unite(self._turns[point.body], Rotation(0, way / arm / abs(way / arm)))

    # Places.

    def _place(self, body, position):
        """Return a place as factors of the unknowns, the constant by 0."""
        found = dict(self._places[body])
        _add(found, self._turn(body), complex(*position))
        return found

    def _along(self, name, direction, given):
        """Return a way along a direction, given or unknown."""
        if given is not None:
            found: Dict[Any, complex] = {}
            _add(found, direction, given)
            return found
        self._lines[name] = direction
        return {name: 1.0}

    def _set_places(self, mechanism):
        for joint in mechanism.joints:
            place = self._place(joint.parent, joint.position)
            if joint.type == PRISMATIC:
                place = _sum(place, self._along(
                    joint.name, self._turn(joint.child), self._given.get(joint.name)))
            self._places[joint.child] = place

    def _loops(self, mechanism):
        for cut in mechanism.cut_joints:
            gap = _sum(self._place(cut.body_a, cut.point_a),
                       self._place(cut.body_b, cut.point_b), -1.0)
            way: Dict[Any, complex] = {}
            if cut.type == DISTANCE:
                _add(way, self._new(), cut.length)
            elif cut.type in (PRISMATIC, POINT_ON_LINE):
                turn = self._turn(cut.body_b)
                way = self._along(
                    cut.name, Rotation(turn.kind, turn.factor * _unit(cut.angle)),
                    self._given.get(cut.name if cut.type == PRISMATIC else f'{cut.name}.x'))
            yield _sum(gap, way, -1.0)

    def _points(self, mechanism, values):
        done = set()
        for name, place in _given_points(mechanism, values).items():
            point = mechanism.point(name)
            if place is not None:
                if point.body not in done:
                    yield _sum(self._place(point.body, point.position), {0: place}, -1.0)
                done.add(point.body)
                continue
            motion, value = next((motion, value) for motion, value in zip(
                mechanism.motions, values) if motion.point == name)
            along = complex(*motion.direction)
            yield _sum(self._place(point.body, point.position), _sum(
                {0: value * along}, self._along(f'point {name}', Rotation(0, 1j * along), None)),
                -1.0)

    # Solutions.

    def solve(self):
        """Return all real solutions, shape (nq,) each, and how many there can be at most."""
        found, most = [{0: 1.0}], 1
        for unknowns, equations in self._groups():
            count = len(unknowns)
            if count % 2 or count != 2 * len(equations) or count // 2 > MOST_LOOPS:
                raise NotProved(f'{count} unknowns in {len(equations)} loops that belong together')
            most *= math.comb(count, count // 2)
            found = [{**known, **more} for known in found for more in self._solutions(
                unknowns, equations, known)]
        return [self._coordinates(known) for known in found], most

    def _groups(self):
        """Yield unknowns and equations that belong together, each group after those it needs."""
        # Imported here: every simulation imports this file, and that would take 40 % longer.
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

        columns = list(dict.fromkeys(
            key for equation in self.equations for key in self._keys(equation)))
        rows = [equation for equation in self.equations for _ in range(2)]
        if len(rows) != len(columns):
            raise NotProved(f'{len(columns)} unknowns in {len(rows)} equations')
        if not rows:
            return
        place = {key: k for k, key in enumerate(columns)}
        dense = np.zeros((len(rows), len(columns)), dtype=int)
        for k, equation in enumerate(rows):
            dense[k, [place[key] for key in self._keys(equation)]] = 1
        matched = maximum_bipartite_matching(csr_array(dense), perm_type='column')
        if (matched < 0).any():
            raise NotProved('equations that repeat others')
        # Column n depends on the others of the row matched to it.
        needs = np.zeros((len(columns), len(columns)), dtype=int)
        needs[matched] = dense
        count, label = connected_components(csr_array(needs), connection='strong')
        waits = {group: {int(label[other]) for n in np.flatnonzero(label == group)
                         for other in np.flatnonzero(needs[n])} - {group}
                 for group in range(count)}
        while waits:
            group = next(one for one, others in waits.items() if not others)
            del waits[group]
            for others in waits.values():
                others.discard(group)
            members = np.flatnonzero(label == group)
            chosen = [k for k in range(len(rows)) if label[matched[k]] == group]
            yield [columns[n] for n in members], [
                self.equations[k] for k in dict.fromkeys(k // 2 for k in chosen)]

    def _keys(self, equation):
        """Return the unknowns of an equation, directions of its slides included."""
        found = [key for key in equation if key != 0]
        found += [self._root(self._lines[key]).kind for key in found if key in self._lines]
        return [key for key in dict.fromkeys(found) if key != 0]

    def _solutions(self, unknowns, equations, known):
        """Return the real solutions of a group, as numbers by unknown."""
        loops = len(equations)
        matrix = np.zeros((loops, len(unknowns)), dtype=complex)
        right = np.zeros(loops, dtype=complex)
        for row, equation in enumerate(equations):
            for key, factor in equation.items():
                if key in known:
                    right[row] -= factor * known[key]
                else:
                    matrix[row, unknowns.index(key)] = factor
        _, singular, rows = np.linalg.svd(matrix)
        if singular[-1] <= NOT_ZERO * singular[0]:
            raise NotProved('loops that repeat others')
        first = np.linalg.lstsq(matrix, right, rcond=None)[0]
        # Unknowns as linear forms of x, homogeneous; conjugates of y.
        forms = np.column_stack([first, rows[loops:].conj().T])
        bilinear = [self._bilinear(key, unknowns, forms, known) for key in unknowns]
        solutions = []
        for x, y in _bilinear_solutions(np.array(bilinear)):
            z, conjugate = forms @ x, forms.conj() @ y
            size = max(1.0, np.abs(z).max(), np.abs(conjugate).max())
            apart = np.abs(conjugate - z.conj()).max() / size
            if REAL < apart < COMPLEX:
                raise NotProved('two assemblies that nearly, or just, coincide')
            if apart <= REAL:
                values = 0.5 * (z + conjugate.conj())
                solutions.append({key: value / abs(value) if key not in self._lines else value
                                  for key, value in zip(unknowns, values)})
        return solutions

    def _bilinear(self, key, unknowns, forms, known):
        """Return the matrix B of the equation of an unknown: x^T B y = 0."""
        form = forms[unknowns.index(key)]
        size = len(form)
        one = np.zeros(size)
        one[0] = 1.0
        if key not in self._lines:
            found = np.outer(form, form.conj()) - np.outer(one, one)
        else:
            turn = self._root(self._lines[key])
            along = (known[turn.kind] * turn.factor * one if turn.kind in known else
                     turn.factor * forms[unknowns.index(turn.kind)])
            found = np.outer(form, along.conj()) - np.outer(along, form.conj())
        return found / np.abs(found).max()

    def _coordinates(self, known):
        """Return joint coordinates of a solution, shape (nq,)."""
        def turn(body):
            kind, factor = self._turn(body)
            return factor * known[kind]

        q = []
        for joint in self._mechanism.joints:
            if joint.name in self._given:
                q.append(self._given[joint.name])
            elif joint.type == REVOLUTE:
                q.append(np.angle(turn(joint.child) / (
                    turn(joint.parent) * _unit(joint.angle))))
            else:
                q.append((known[joint.name] * np.conj(turn(joint.child))).real)
        return np.array(q)


def _given_points(mechanism, values):
    """Return the places of driven points; None where one direction alone is given."""
    rows: Dict[str, List[Tuple[Any, float]]] = {}
    for motion, value in zip(mechanism.motions, values):
        if motion.point is not None:
            rows.setdefault(motion.point, []).append((motion.direction, value))
    return {name: complex(*np.linalg.solve(*map(np.array, zip(*each)))) if len(each) == 2 else
            None for name, each in rows.items()}


def _unit(angle):
    return complex(math.cos(angle), math.sin(angle))


def _add(place, turn, way):
    """Add a way in a turned frame to a place."""
    place[turn.kind] = place.get(turn.kind, 0.0) + turn.factor * way


def _sum(one, other, sign=1.0):
    found = dict(one)
    for key, value in other.items():
        found[key] = found.get(key, 0.0) + sign * value
    return {key: value for key, value in found.items() if key == 0 or abs(value) > 0.0}


def _bilinear_solutions(matrices):
    """
    Return all finite solutions of bilinear equations x^T B y = 0, given B of each.

    Matrices, shape (2 l, l + 1, l + 1); x and y, shape (l + 1,), with 1 in the first place.
    NotProved where there are infinitely many, or some coincide.
    """
    count, size, _ = matrices.shape
    loops = size - 1
    # In coordinates where no solution is at a special place. From degree l in x on (and 1 in y)
    # as many functions differ at the solutions as there are solutions.
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(size, size)) + 1j * rng.normal(size=(size, size)))[0]
    turned = np.einsum('ac,kab->kcb', turn, matrices)
    low, high = (list(combinations_with_replacement(range(size), degree))
                 for degree in (loops, loops + 1))
    place = {monomial: k for k, monomial in enumerate(high)}
    macaulay = np.zeros((count * len(low), len(high) * size), dtype=complex)
    shift = np.zeros((size, len(low)), dtype=int)
    for row, monomial in enumerate(low):
        for a in range(size):
            column = shift[a, row] = place[tuple(sorted((*monomial, a)))]
            macaulay[row * count:(row + 1) * count, column * size:(column + 1) * size] += (
                turned[:, a])
    _, singular, rows = np.linalg.svd(macaulay)
    whole = np.zeros(macaulay.shape[1])
    whole[:len(singular)] = singular / singular[0]
    expected = math.comb(2 * loops, loops)
    if whole[-expected] > ZERO or (whole[:-expected] < NOT_ZERO).any():
        raise NotProved('infinitely many solutions of the polynomial equations')
    null = rows[-expected:].conj().T.reshape(len(high), size, expected)
    forms = rng.normal(size=(2, size)) + 1j * rng.normal(size=(2, size))
    one, other = (sum(form[a] * null[shift[a]] for a in range(size)).reshape(-1, expected)
                  for form in forms)
    _, vectors = np.linalg.eig(np.linalg.lstsq(other, one, rcond=None)[0])
    found = []
    for vector in vectors.T:
        left, values, right = np.linalg.svd(null @ vector)
        if values[1:].max(initial=0.0) > 1e-5 * values[0]:
            raise NotProved('solutions of the polynomial equations that coincide')
        # All monomials with the power of the largest: x times a number.
        powers = [place[(a,) * (loops + 1)] for a in range(size)]
        best = int(np.argmax(np.abs(left[powers, 0])))
        x = turn @ np.array([left[place[tuple(sorted((*(best,) * loops, a)))], 0]
                             for a in range(size)])
        y = right[0]
        x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
        if np.abs(np.einsum('a,kab,b->k', x, matrices, y)).max() > WRONG:
            raise NotProved('solutions of the polynomial equations that coincide')
        if min(abs(x[0]), abs(y[0])) > INFINITE:
            found.append((x / x[0], y / y[0]))
    return found


def all_planar(mechanism, values) -> Tuple[Optional[List[np.ndarray]], int]:
    """
    Return all assemblies of a planar mechanism whose ``motions`` are driven, as coordinates.

    ``values`` of these [rad or m]. NotProved where this method cannot say that these are all.
    """
    return PlanarEquations(mechanism, values).solve()
