# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The forward dynamics with arms eliminated before any multiplier.

An arm is joints that are in few closure equations alone, as many as these are: the leg of a
parallel robot, the links behind a crank. With A the columns of these equations that belong to the
arm, A a + B z = g gives its accelerations a by all others, z. Put into the equations of motion,
they are an apparent inertia B^T A^-T M A^-1 B and a force: what is left to solve has the size of
the mechanism's freedom, however many arms there are, and equal arms take equal operations. Where
an arm has one joint less than equations, as a rod between two balls has, one equation across
its own motion is left.

Where a body is held by arms on all sides its motion is among the unknowns, and the joints that
carry it are an arm like the others.

``accelerate`` takes the place of that of ``forward_dynamics``, but next to singular positions of
an arm, where it returns False.
"""

import functools
import itertools
from typing import NamedTuple

from . import elimination, space
from .expression_graph import branch, chosen, larger
from .forward_dynamics import to_user_order
from .spatial import at_parent, shifted, Z
from .vectors import (
    add, cross, dot, IDENTITY, is_number, is_zero, negate, product, scale, subtract, symmetric,
    times, transpose, ZERO)
from ..engine.types import (
    BODY_A, BODY_B, DOF, EVALUATIONS, NO_RESPONSES, PARENT, ROW, ROWS)

# The squared sine between the directions of an arm, of three their squared volume: rounding grows
# with one over it.
SMALL_SINE = 1e-2
# The square of a lever of an arm against that of the longest one in its equations: the lever is
# the difference of two places, whose rounding it has.
SHORT_LEVER = 1e-3
# A determinant of inertias against its diagonal entries: below nothing but rounding may be left.
ROUNDING = 1e-9
# Components of the motion of a floating body, which as many joints carry.
_IN_PLANE, _IN_SPACE = (2, 3, 4), (0, 1, 2, 3, 4, 5)
# Unknowns that are left at most: of more, recursions through the tree take less.
MOST_LEFT = 8
# Rows of the tree, of which arms are chosen in a second.
MOST_ROWS = 100
# Equations that an arm has at most.
_MOST = 3
# Those of a loop of one freedom whose other equations hold by its shape, as of Bricard's linkage.
_MOST_IN_ONE_LOOP = 4
# Keys of equations begin with this: of a cut joint one has its place in the elimination order
# behind it, of a floating body the row of the tree and a component. Keys of unknowns are rows of
# the tree, and pairs of one that floats and a component.
# A motion that the equations of an arm leave to it has a key of its own, which begins with FREE.
EQUATION, FREE = 'equation', 'free'


def _free(rows):
    """Return the key of the motion that equations leave to an arm."""
    return (FREE, *rows[0][1:])


def _rows(cut):
    return [(EQUATION, row) for row in range(*map(int, (cut[ROW], cut[ROW] + cut[ROWS])))]


class Plan:
    """
    Which joints are eliminated by which equations; follows from the topology alone.

    Parameters
    ----------
    recursion : spatial.Recursion
        Of the bodies.
    model : Model
        Constant arrays.
    floats : bool
        Whether to look for floating bodies.
    root : int
        The row of the tree that carries all joints; 0 for the ground.
    cuts, rows : sequence of int
        Places of the cut joints and rows of the tree that are eliminated; all by default. Of
        chosen ones three joints in two equations are an arm, too, that keeps one motion.

    Attributes
    ----------
    floating : dict of int to tuple of int
        Rows of the tree whose motion is among the unknowns, and its components.
    steps : list of pairs of lists
        Keys of joints and of equations of arms, in the order of elimination.
    unknowns, rest : lists
        Keys of unknowns, up to three that are eliminated together, and of equations, which are
        left.
    complete : bool
        Whether all equations belong to arms, but for what these leave.

    """

    def __init__(self, recursion, model, floats=True, root=0, cuts=None, rows=None):
        self.parent, self.floating, self.root = model.tree[:, PARENT].tolist(), {}, root
        self.angles = _angles(recursion)
        cuts = range(len(model.cut)) if cuts is None else cuts
        eliminated = set(range(1, len(self.parent)) if rows is None else rows)
        if floats:
            self.floating = self._find_floating(recursion, model)
        groups, columns, alone = [], {}, set()
        for body, components in self.floating.items():
            joints = [body, *self.carriers(self.parent[body])]
            turning = len(components) // 2
            # Joints about the body's own origin turn it alone.
            for part, support in (components[:turning], joints), (
                    components[turning:], joints[turning:]):
                rows = [(EQUATION, body, n) for n in part]
                columns.update((row, set(support)) for row in rows)
                alone.update(rows)
                groups.append(rows)
        for cut, one in ((model.cut[a], recursion.cuts[a]) for a in cuts):
            rows, support = _rows(cut), set()
            for body in cut[[BODY_A, BODY_B]].tolist():
                support.update(self.carriers(body))
            if one.coupling is not None:
                support.update(i for i, _ in one.coupling[1])
                support.update(() if one.law is None else one.law[:1])
                alone.update(rows if not one.between else ())
            columns.update((row, set(support)) for row in rows)
            groups.append(rows)
        self._choose(list(filter(None, groups)), columns, alone, {
            i for cut in recursion.cuts for i in cut.rolling if i not in self.floating})
        joints = {joint for joints, _ in self.steps for joint in joints}
        left = sorted(eliminated - joints, reverse=True)
        left += [_free(of) for joints, of in self.steps if len(joints) > len(of)]
        self.unknowns = [left[n:n + _MOST] for n in range(0, len(left), _MOST)]
        for body, components in self.floating.items():
            moving = [(body, n) for n in reversed(components)]
            self.unknowns += [moving[n:n + _MOST] for n in range(0, len(moving), _MOST)]

    @classmethod
    def of(cls, recursion, model):
        """Return the plan for a mechanism, None where there is nothing to gain."""
        if len(model.tree) > MOST_ROWS:
            return None
        for floats in True, False:
            found = cls(recursion, model, floats)
            left = sum(map(len, found.unknowns))
            if found.complete and left <= MOST_LEFT and any(
                    found.angles or len(joints) == len(rows) for joints, rows in found.steps):
                return found
        return None

    @property
    def steps_aside(self):
        """Return whether arms have singular positions where their loops have none."""
        return any(1 < len(rows) >= len(joints) for joints, rows in self.steps)

    def carriers(self, body):
        """Return a row of the tree and those that carry it, up to a floating one."""
        found = []
        while body > self.root and body not in self.floating:
            found.append(body)
            body = self.parent[body]
        return found

    def counted_from(self, row):
        """Return the key of the angle that a joint, by its row, turns from, if any."""
        if row not in self.angles:
            return None
        row = self.parent[row]
        while row > 0 and row not in self.angles:
            row = self.parent[row]
        return (row, Z) if row in self.floating else row or None

    def free(self, recursion):
        """Return the rows of floating bodies; none in one frame, or where rotors stand on any."""
        whole = recursion.in_one_frame or not is_zero(sum(
            (body.rotor for body in recursion.bodies[1:]), ()))
        return () if whole else tuple(self.floating)

    def _find_floating(self, recursion, model):
        """Return the bodies with their full freedom that two cut joints or more hold."""
        flat = all(one.turned is None and (one.axis == Z) == bool(one.turns)
                   for one in recursion.bodies[1:])
        found, components = {}, _IN_PLANE if flat else _IN_SPACE
        for body in range(1, len(self.parent)):
            ends = sum(any(body in (end, self.parent[end]) for end in both)
                       for both in model.cut[:, [BODY_A, BODY_B]].tolist())
            if len(self.carriers(body)) == len(components) and ends >= 2:
                found[body] = components
        return found

    def _choose(self, left, columns, alone, rolling):
        """
        Choose the steps: again and again equations with joints that are in no others.

        ``left``: groups of equations; ``columns``: joints of each; ``alone``: those whose joints
        have levers that never vanish; ``rolling``: rows of spherical joints, by ``Cut.rolling``.
        """
        def own(group):
            """Return the joints that a group of equations can eliminate."""
            others = {joint for other in left if other is not group
                      for row in other for joint in columns[row]}
            joints = sorted({joint for row in group for joint in columns[row]} - others)[::-1]
            if len(group) == 1:
                return joints[:1] if alone.issuperset(group) else []
            if len(group) == 2:
                # Three keep one motion.
                return joints if len(joints) <= 2 else joints[:3]
            if len(group) == _MOST and len(joints) <= _MOST:
                return joints if len(joints) >= 2 else []
            # All but the first ones, which move it, of a loop and of a chain with a rod.
            if len(group) == len(joints) - 1 == _MOST_IN_ONE_LOOP:
                return joints[:-1]
            moving = [joint for joint in joints if joint not in rolling]
            return moving[:_MOST] if len(joints) > len(moving) >= len(group) == _MOST else []

        self.steps, over = [], set()
        while any(map(own, left)):
            group = min(filter(own, left), key=lambda one: len(one) - len(own(one)))
            joints = own(group)
            self.steps.append((joints, group))
            left.remove(group)
            if len(joints) < len(group):
                row = group[-1]
                columns[row] = {
                    joint for one in group for joint in columns[one]}.difference(joints)
                # Two with the same joints may be eliminated together.
                beside = next((one for one in left if len(one) == 1 and over.issuperset(one)
                               and columns[one[0]] == columns[row] != set()), None)
                over.add(row)
                if beside is None:
                    left.append([row])
                else:
                    beside.append(row)
        self.rest = [row for group in left for row in group]
        self.complete = over.issuperset(self.rest)


def _angles(recursion):
    """
    Return the rows of the tree whose unknowns are accelerations of angles in the world.

    Where all axes are parallel, no joint turns but the body that it carries so: levers are those
    of one body each. Sums of joint coordinates, and rotors on the parents, are in joints.
    """
    bodies = recursion.bodies[1:]
    if not (recursion.in_one_frame and all(is_zero(body.rotor) for body in bodies)
            and all(one.coupling is None for one in recursion.cuts)):
        return ()
    return tuple(i for i, body in enumerate(bodies, start=1) if body.turns and not body.slides)


class Equations:
    """
    The symmetric system of accelerations x and negative multipliers m: M x + J^T m = f, J x = g.

    ``matrix``: terms of entries by keys of unknowns and equations, both halves.
    """

    def __init__(self):
        self.matrix, self._right, self._squares, self._undo = {}, {}, {}, []
        self._turned, self._stage, self._exchanged = {}, None, []

    def add(self, a, b, value):
        """Add to the entries of two keys."""
        if not is_number(value, 0.0):
            terms = self.matrix.setdefault(a, {}).setdefault(b, [])
            terms.append((self._stage, value))
            self.matrix.setdefault(b, {})[a] = terms

    def add_right(self, key, value):
        """Add to the right side of a key."""
        self._right.setdefault(key, []).append((self._stage, value))

    def entry(self, a, b):
        """Return the entry of two keys."""
        return _balanced(self.matrix.get(a, {}).get(b, []))

    def right(self, key):
        """Return the right side of a key."""
        return _balanced(self._right.get(key, []))

    def _take(self, keys):
        """Take several out; return the entries among them, those beside, and the right sides."""
        inner = [[self.entry(a, b) for b in keys] for a in keys]
        outer = {}
        for n, key in enumerate(keys):
            for other, terms in self.matrix.pop(key, {}).items():
                if other not in keys:
                    outer.setdefault(other, len(keys) * [0.0])[n] = _balanced(terms)
                    del self.matrix[other][key]
        # In the same order for equal arms, wherever in the tree they are: joints come last.
        outer = {key: outer[key] for key in sorted(
            outer, key=lambda key: 2 if isinstance(key, int) else isinstance(key[0], str))}
        return inner, outer, [_balanced(self._right.pop(key, [])) for key in keys]

    def eliminate(self, keys):
        """Eliminate up to three keys; return their leading minors, the determinant last."""
        inner, outer, right = self._take(keys)
        rows, _, volume, _ = adjugate(inner)
        # Whoever waits for the last ones waits for the division beside the products.
        known, others = scale(times(rows, right), 1.0 / volume), list(outer)
        inverse = [scale(row, 1.0 / volume) for row in rows]
        left = {key: times(inverse, outer[key]) for key in others}
        for n, one in enumerate(others):
            self.add_right(one, 0.0 - dot(outer[one], known))
            for other in others[:n + 1]:
                self.add(one, other, 0.0 - dot(outer[one], left[other]))

        def undo(x):
            for n, key in enumerate(keys):
                x[key] = known[n] - total(left[one][n] * x[one] for one in others)

        self._undo.append(undo)
        minors = [inner[0][0]]
        if len(keys) == _MOST:
            minors.append(inner[0][0] * inner[1][1] - inner[0][1] * inner[1][0])
        return [*minors[:len(keys) - 1], volume]

    def _square(self, key, rows):
        """Return the square of the lever that a key has in equations."""
        values = [self.entry(row, key) for row in rows]
        return total(self._squares.get((row, key), value * value)
                     for row, value in zip(rows, values))

    def turn(self, rows, axes, columns):
        """
        Tell what the columns of joints are in axes in which they have zeros.

        ``rows``: three equations that hold a point along the world's axes; ``axes``: in these;
        ``columns``: along them, by joint.
        """
        self._turned[tuple(rows)] = axes, columns
        for joint, column in columns.items():
            self._squares.update(
                ((row, joint), value * value) for row, value in zip(rows, column))

    def require_levers(self, joints, rows, turning):
        """Require that joints which turn have levers that are not short beside others'."""
        if len(rows) == 1 or len(joints) > len(rows):
            return
        beside = [self._square(key, rows) for key in sorted({
            key for row in rows for key in self.matrix.get(row, ()) if key in turning})]
        longest = functools.reduce(larger, beside, 0.0)
        for joint in turning.intersection(joints):
            bool(self._square(joint, rows) >= SHORT_LEVER * longest)

    def substitute(self, steps):
        """
        Put the motion of later arms into the equations of earlier ones, where that has fewer keys.

        So it is in a chain of loops that one crank moves. Of every arm joints are taken by as many
        equations, or keep one motion.
        """
        arms, known = {}, {}
        for arm in reversed(steps):
            keys = self._beside(*arm)
            inner = [arms[key] for key in keys if key in arms]
            outer = {key for key in keys if key not in arms}
            for joints, rows in inner:
                outer.update(self._beside(joints, rows), len(joints[len(rows):]) * [_free(rows)])
            if len(outer) < len(keys):
                for one in inner:
                    known.update(self._motion(*one))
                for row in arm[1]:
                    self._exchange(row, known)
            arms.update(dict.fromkeys(arm[0], arm))

    def _motion(self, joints, rows):
        """Return the ``_Motion`` of joints by equations."""
        keys = self._beside(joints, rows)
        arm = _Inverse.of(*self._columns(joints, rows), len(keys))
        start = arm.taken([self.right(row) for row in rows])
        moved = arm.moved({key: [self.entry(row, key) for row in rows] for key in keys}, rows)
        return {joint: _Motion(start[n], {key: column[n] for key, column in moved.items()},
                               dict(zip(rows, arm.rows[n]))) for n, joint in enumerate(joints)}

    def _columns(self, joints, rows):
        """Return the columns of joints in equations, and the axes in which they are, if any."""
        axes, own = self._turned.get(tuple(rows), (None, {}))
        return [own[joint] if axes else [self.entry(row, joint) for row in rows]
                for joint in joints], axes

    def _beside(self, joints, rows):
        """Return the keys in equations, but for joints."""
        return list(dict.fromkeys(
            key for row in rows for key in self.matrix.get(row, ()) if key not in joints))

    def _exchange(self, row, known):
        """Put the ``_Motion`` of joints into an equation."""
        for joint in [joint for joint in known if joint in self.matrix.get(row, ())]:
            factor, motion = self.entry(row, joint), known[joint]
            del self.matrix[row][joint], self.matrix[joint][row]
            self.add_right(row, 0.0 - factor * motion.start)
            for key, value in motion.moved.items():
                self.add(row, key, 0.0 - factor * value)
            self._exchanged += [
                (row, other, factor * value) for other, value in motion.by.items()]

    def eliminate_arm(self, joints, rows):
        """
        Eliminate joints by equations; return the squared sine.

        Of an equation more than joints one is left; a joint more than equations leaves a motion
        across these.
        """
        fewer, spare = len(joints) < len(rows), len(joints) > len(rows)
        squares = [self._square(joint, rows) for joint in joints]
        columns, axes = self._columns(joints, rows)
        mass, coupled, force = self._take(joints)
        coupled = {key: column for key, column in coupled.items() if key not in rows}
        _, levers, given = self._take(rows)
        known = [*sum(columns, []), *sum(mass, []), *sum(coupled.values(), []),
                 *sum(levers.values(), []), *force, *given, *sum(axes or (), ()), *squares]
        self._stage = name = len(joints), len(rows), axes is not None
        with branch(name, known) as number:
            arm = _Inverse.of(columns, axes, len(levers))
            # At the tip motions that act there by few numbers do so on its apparent inertia.
            few = {} if spare or _symbols(sum(levers.values(), [])) >= len(joints) * len(
                levers) else {key: one for key, one in levers.items() if key not in coupled}
            moved = arm.moved(
                {key: column for key, column in levers.items() if key not in few}, rows)
            start = arm.taken(given)
            rest, pushed = self._put_in(moved, start, mass, coupled, force)
            if few:
                self._put_in_at_tip(few, transpose(arm.rows), mass, rest, pushed)
            if fewer:
                left, (across,) = rows[-1], arm.across
                square = dot(across, across)
                if axes:
                    across = times(axes, across)
                for key, column in levers.items():
                    self.add(left, key, dot(across, column))
                    self._squares[left, key] = square * dot(column, column)
                self.add_right(left, dot(across, given))

        def undo(x):
            keys = [*levers, *coupled, *(rows[-1:] if fewer else [])]
            with branch(('back', *name), [
                    *known, *(x[key] for key in keys), *start, *rest,
                    *sum(moved.values(), ()), *sum(pushed.values(), ())], number):
                if few:
                    found = times(arm.rows, _less(given, levers, x))
                    loads = _less(_less(force, coupled, x), dict(zip(joints, mass)), dict(
                        zip(joints, found)))
                else:
                    # Neither waits for the other.
                    found = _less(start, moved, x)
                    loads = negate(_less(rest, pushed, x))
                multipliers = times(transpose(arm.rows), loads)
                if fewer:
                    multipliers = add(multipliers, scale(across, x[rows[-1]]))
            x.update(zip(joints, found))
            x.update(zip(rows, multipliers))

        self._undo.append(undo)
        if spare:
            one, two, three = squares
            return arm.volume / (one * two + (one + two) * three)
        if axes and all(sum(not is_number(value, 0.0) for value in one) == 1 for one in columns):
            # Each along an axis of its own.
            return 1.0
        return (arm.volume if fewer else arm.volume * arm.volume) / _product(squares)

    def _put_in(self, moved, start, mass, coupled, force):
        """
        Put ``start`` less the sum of ``moved`` times unknowns in the place of taken ones.

        ``mass``, ``coupled``, ``force``: entries among the taken, beside them, and right sides.
        Returns the right sides that are left, and the loads of a unit of each unknown.
        """
        none, reached = len(start) * (0.0,), list(moved)
        pushed = {key: subtract(times(mass, column), coupled.get(key, none))
                  for key, column in moved.items()}
        rest = subtract(times(mass, start), force)
        for n, one in enumerate(reached):
            self.add_right(one, dot(moved[one], rest))
            for other in reached[:n + 1]:
                self.add(one, other, dot(moved[one], pushed[other]) - dot(
                    coupled.get(one, none), moved[other]))
        for one, column in coupled.items():
            self.add_right(one, 0.0 - dot(column, start))
            if one not in moved:
                pushed[one] = negate(column)
                for other in reached:
                    self.add(one, other, dot(pushed[one], moved[other]))
        return rest, pushed

    def _put_in_at_tip(self, levers, back, mass, rest, pushed):
        """
        Put in ``levers`` times more unknowns, of the taken ones seen at the tip by ``back``.

        ``rest``, ``pushed``: what ``_put_in`` returned, of start and other unknowns.
        """
        pulled = [times(mass, column) for column in back]
        inertia = symmetric(lambda m, n: dot(back[m], pulled[n]), len(back))
        rest, pushed = times(back, rest), {key: times(back, one) for key, one in pushed.items()}
        # What has fewer numbers is multiplied last.
        for one in sorted(levers, key=lambda key: -_symbols(levers[key])):
            pushed[one] = times(inertia, levers[one])
            self.add_right(one, dot(levers[one], rest))
            for other, column in pushed.items():
                self.add(one, other, dot(levers[one], column))

    def solution(self, x):
        """Add all accelerations and negative multipliers by key to those that are known."""
        for undo in reversed(self._undo):
            undo(x)
        for row, other, factor in reversed(self._exchanged):
            x[other] = x[other] - factor * x[row]
        return x


class _Motion(NamedTuple):
    """The acceleration of a joint: ``start``, less the sum of ``moved`` times those of keys."""

    start: object
    moved: dict
    #: What right sides of equations contribute to ``start``, by row.
    by: dict


class _Inverse(NamedTuple):
    """What equations say of the joints of an arm: ``cofactors`` over ``size``, a row for each."""

    cofactors: tuple
    rows: tuple
    #: Across them, where they are fewer or more than the equations.
    across: tuple
    volume: object
    size: object
    #: Whether so much is taken that its entries are divided; else what is taken, at last.
    often: bool

    @classmethod
    def of(cls, columns, axes, count):
        """Return that of columns of joints, in ``axes``; ``count``: of what is taken from it."""
        spare = len(columns) > len(columns[0])
        cofactors, across, volume, size = adjugate(transpose(columns) if spare else columns)
        rows = [scale(row, 1.0 / size) for row in cofactors]
        if axes:
            cofactors, rows = (product(one, transpose(axes)) for one in (cofactors, rows))
        if spare:
            cofactors, rows = transpose(cofactors), transpose(rows)
        return cls(cofactors, rows, across, volume, size, count >= len(columns))

    def taken(self, column):
        """Return the motion of the joints that the right sides of equations ask for."""
        if self.often:
            return times(self.rows, column)
        return scale(times(self.cofactors, column), 1.0 / self.size)

    def moved(self, levers, rows):
        """Return how keys with ``levers`` in equations, and the motion left, move the joints."""
        found = {key: self.taken(column) for key, column in levers.items()}
        if len(self.rows) > len(rows):
            found[_free(rows)] = negate(*self.across)
        return found


class AlwaysSingularError(ValueError):
    """An arm whose joints cannot move what its equations hold, at any position."""


def adjugate(columns):
    """
    Return the inverse of one to four columns times a size, a row across, determinant and size.

    AlwaysSingularError where the determinant is zero whatever the position is.

    Where there is a row more than columns one is across these, and their squared volume takes the
    place of the determinant.
    """
    across, size = (), None
    if len(columns) == len(columns[0]) == 1:
        (volume,), = columns
        rows = (1.0,),
    elif len(columns) == len(columns[0]) == 2:
        (a, c), (b, d) = columns
        volume, rows = a * d - b * c, ((d, 0.0 - b), (0.0 - c, a))
    elif len(columns) == _MOST_IN_ONE_LOOP:
        volume, rows = _cofactors_of_four(columns)
    elif len(columns) == 3:
        a, b, c = columns
        rows = cross(b, c), cross(c, a), cross(a, b)
        volume = dot(a, rows[0])
    elif len(columns) == 1:
        (a, b), = columns
        volume, rows, across = a * a + b * b, ((a, b),), ((0.0 - b, a),)
    else:
        a, b = columns
        across = cross(a, b)
        volume = size = dot(across, across)
        beside = [n for n, value in enumerate(across) if not is_number(value, 0.0)]
        if len(beside) == 1:
            # Both lie in a plane of two axes.
            (n,) = beside
            size, across = across[n], IDENTITY[n]
        rows, across = (cross(b, across), cross(across, a)), (across,)
    if is_number(volume, 0.0):
        raise AlwaysSingularError
    return rows, across, volume, volume if size is None else size


def _cofactors_of_four(columns):
    """Return the determinant of four columns and their cofactors, by areas of halves."""
    pairs = list(itertools.combinations(range(4), 2))
    upper, lower = ({(m, n): columns[m][k] * columns[n][k + 1] - columns[m][k + 1] * columns[n][k]
                     for m, n in pairs} for k in (0, 2))
    areas = [upper[one] * lower[other] for one, other in zip(pairs, reversed(pairs))]
    rows = []
    for n in range(4):
        a, b, c = (m for m in range(4) if m != n)
        found = [columns[a][k] * half[b, c] - columns[b][k] * half[a, c]
                 + columns[c][k] * half[a, b]
                 for k, half in ((1, lower), (0, lower), (3, upper), (2, upper))]
        rows.append(tuple(value if (n + k) % 2 == 0 else 0.0 - value
                          for k, value in enumerate(found)))
    return (areas[0] + areas[5]) - (areas[1] + areas[4]) + (areas[2] + areas[3]), tuple(rows)


def _symbols(values):
    """Count the values that are no numbers."""
    return sum(not isinstance(value, float) for value in values)


def total(values):
    """Return a sum."""
    return sum(values, 0.0)


def _less(values, columns, x):
    """Return values less the sum of columns times unknowns, by key."""
    return tuple(value - total(column[n] * x[key] for key, column in columns.items())
                 for n, value in enumerate(values))


def _assemble(recursion, model, work, tau, baumgarte, plan):
    """Return the equations of motion and of closure; floating bodies are roots of their own."""
    found = Equations()
    # In the plane the world's axes are those of all views.
    add_motion = _add_motion_in_views if space.is_spatial(model) else _add_motion
    tau = recursion.about_world(model, tau)
    add_motion(recursion, model, tau, plan, found)
    for i in plan.angles:
        # What turns by the difference of two angles.
        other, armature = plan.counted_from(i), recursion.bodies[i].armature
        if other is not None:
            found.add_right(other, 0.0 - tau[model.tree[i, DOF]])
        if other is not None and armature is not None:
            found.add(other, other, armature)
            found.add(i, other, 0.0 - armature)
    for body, components in plan.floating.items():
        for n in components:
            row, unit = (EQUATION, body, n), tuple(float(m == n) for m in range(6))
            about = recursion.about_center(body, unit)
            for m in components:
                found.add(row, (body, m), about[m])
            own, wrench = recursion.transmit_wrench(body, negate(unit), body in plan.angles)
            found.add(row, body, own)
            found.add_right(row, recursion.started.get(body, 2 * ZERO)[n])
            _spread(recursion, plan, {plan.parent[body]: wrench}, row, found)
    for a, cut in enumerate(model.cut):
        for row, equation in zip(_rows(cut), recursion.closures(model, a)):
            one, other = cut[[BODY_A, BODY_B]].tolist()
            arrived = {one: equation.on_a}
            arrived[other] = add(arrived.get(other, 2 * ZERO), equation.on_b)
            for i, value in equation.in_joints:
                found.add(row, i, value)
            _spread(recursion, plan, arrived, row, found)
            place = row[1]
            found.add_right(
                row, 0.0 - work.bias[place] - 2.0 * baumgarte * work.closure_rate[place]
                - baumgarte * baumgarte * work.closure[place])
    for joints, rows in plan.steps if space.is_spatial(model) else ():
        _turn(recursion, model, plan, joints, rows, found)
    return found


def _turn(recursion, model, plan, joints, rows, found):
    """Give the columns of an arm whose tip is held along the axes of its last body."""
    body, point, sign = _tip(recursion, model, plan, joints, rows)
    if body is None:
        return
    views, columns = recursion.views, {}
    lever = times(views[body].frame, point)
    wrenches = [scale(cross(lever, axis) + axis, sign) for axis in IDENTITY]
    for i in plan.carriers(body):
        if i in joints:
            columns[i] = [dot(views[i].motion.axis, wrench) for wrench in wrenches]
        wrenches = [views[i].at_parent(ZERO + wrench[3:] if i in plan.angles else wrench)
                    for wrench in wrenches]
    if columns.keys() == set(joints) and _symbols(sum(columns.values(), [])) <= len(joints):
        found.turn(rows, views[body].axes, columns)


def _tip(recursion, model, plan, joints, rows):
    """
    Return the last body of an arm and its point that equations hold along all axes.

    With the sign of a force on it in the equations; the body is None where there is none.
    """
    for one, cut in zip(recursion.cuts, model.cut):
        if len(rows) == len(one.along) == _MOST and rows == _rows(cut) and not one.carried:
            first, other = cut[[BODY_A, BODY_B]].tolist()
            return (first, one.point_a, 1.0) if joints[0] in plan.carriers(first) else (
                other, one.point_b, -1.0)
    body = place = rows[0][1]
    while place in plan.floating and recursion.bodies[body].ball:
        body, point = plan.parent[body], recursion.bodies[body].place
    if body == place or rows != [(EQUATION, place, n) for n in _IN_SPACE[_MOST:]]:
        return None, None, None
    return body, point, -1.0


def _add_motion_in_views(recursion, model, tau, plan, found):
    """Add the equations of motion, formed in axes of the bodies' own."""
    matrix, right = recursion.equations_of_motion(model, tau, plan.floating, plan.angles)
    for pair, value in matrix.items():
        found.add(*pair, value)
    for key, value in right.items():
        found.add_right(key, value)


def _add_motion(recursion, model, tau, plan, found):
    """Add the equations of motion in the plane, formed in the world's axes."""
    inertia, force = list(recursion.inertia), list(recursion.force)
    for i in range(len(plan.parent) - 1, 0, -1):
        p, motion = plan.parent[i], recursion.motion[i]
        armature = recursion.bodies[i].armature
        found.add(i, i, 0.0 if armature is None else armature)
        found.add_right(i, tau[model.tree[i, DOF]])
        if i in plan.floating:
            for n in plan.floating[i]:
                found.add_right((i, n), 0.0 - force[i][n])
                for m in range(n, 6):
                    found.add((i, n), (i, m), inertia[i][n][m])
            continue
        wrench = times(inertia[i], motion.axis)
        found.add(i, i, dot(motion.axis, wrench))
        found.add_right(i, 0.0 - dot(motion.axis, force[i]))
        if i in plan.angles:
            # No angle of another body turns it: to those it is a mass in the joint.
            wrench, force[i] = ZERO + wrench[3:], ZERO + force[i][3:]
            inertia[i] = 3 * (2 * ZERO,) + tuple(ZERO + row[3:] for row in inertia[i][3:])
        if p > 0:
            inertia[p] = tuple(map(add, inertia[p], shifted(inertia[i], motion.offset)))
            force[p] = add(force[p], at_parent(force[i], motion.offset))
        _spread(recursion, plan, {p: at_parent(wrench, motion.offset)}, i, found)


def _spread(recursion, plan, arrived, key, found):
    """Add the shares that joints and floating bodies have in wrenches, which arrive at bodies."""
    while arrived:
        i = max(arrived)
        wrench = arrived.pop(i)
        if i in plan.floating:
            wrench = recursion.about_center(i, wrench)
            for n in plan.floating[i]:
                found.add(key, (i, n), wrench[n])
        elif i > 0:
            force, wrench = recursion.transmit_wrench(i, wrench, i in plan.angles)
            found.add(key, i, force)
            arrived[plan.parent[i]] = add(arrived.get(plan.parent[i], 2 * ZERO), wrench)


def accelerate(recursion, model, work, tau, baumgarte, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    ``recursion`` has no ``hinges``. Returns whether no arm is near a singular position of its own
    and every pivot is good; if not, ``forward_dynamics.accelerate`` must be asked.
    """
    work.health[EVALUATIONS] += 1.0
    recursion.update(model, work, NO_RESPONSES)
    solve(recursion, model, work, tau, baumgarte, qdd, lam)
    return True


def correct(recursion, model, work, error, out):
    """Find a least change, as ``forward_dynamics.correct`` does."""
    recursion.update(model, work, NO_RESPONSES)
    work.bias[:] = error
    solve(recursion, model, work, len(out) * [0.0], 0.0, out, [*error])
    return True


def solve(recursion, model, work, tau, baumgarte, qdd, lam):
    """Do what follows ``update``; the guard of the graph has what must hold."""
    plan = Plan.of(recursion, model)
    found = _assemble(recursion, model, work, tau, baumgarte, plan)
    smallest = eliminate(plan, found, {
        i for i in range(1, len(plan.parent)) if recursion.bodies[i].turns})
    elimination.record_pivot(model, work, smallest)
    x = found.solution({})
    for i in range(1, len(plan.parent)):
        qdd[model.tree[i, DOF]] = x[i] - x.get(plan.counted_from(i), 0.0)
    recursion.about_own(model, qdd)
    for cut in model.cut:
        for row in _rows(cut):
            work.right[row[1]] = 0.0 - x[row]
    to_user_order(model, work.right, lam)


def eliminate(plan, found, turning):
    """
    Eliminate joints and equations of ``Equations`` as planned; return the smallest pivot or sine.

    ``turning``: rows of the tree whose joints turn.
    """
    smallest, spare = 1.0, 1.0
    together = all(len(joints) >= len(rows) for joints, rows in plan.steps)
    if together:
        for joints, rows in plan.steps:
            found.require_levers(joints, rows, turning)
        found.substitute(plan.steps)
    for joints, rows in plan.steps:
        if not together:
            found.require_levers(joints, rows, turning)
        sine = found.eliminate_arm(joints, rows)
        if len(joints) > len(rows):
            # Small only where the loop itself is nearly singular.
            spare = least(spare, sine)
        else:
            smallest = least(smallest, sine)
    scales = {key: found.entry(key, key) for keys in plan.unknowns for key in keys}
    for keys in plan.unknowns:
        # False for a NaN, too.
        bool(found.eliminate(keys)[-1] > ROUNDING * _product([scales[key] for key in keys]))
    bool(smallest >= SMALL_SINE)
    diagonals = [found.entry(row, row) for row in plan.rest]
    for n in range(0, len(plan.rest), _MOST):
        before = 1.0
        for minor, diagonal in zip(found.eliminate(plan.rest[n:n + _MOST]), diagonals[n:]):
            smallest = least(smallest, minor / (before * diagonal))
            before = minor
    bool(smallest >= elimination.SMALL_PIVOT)
    bool(spare >= elimination.POOR_PIVOT)
    return least(smallest, spare)


def _balanced(terms):
    """
    Return a sum, and keep it in the place of its terms, in pairs: it waits for fewer of them.

    ``terms``: pairs of a stage and a value: those of equal arms are added by twos as often as
    their number allows, and to those of others of the same number.
    """
    stages, sums = {}, {}
    for stage, value in terms:
        stages.setdefault(stage, []).append(value)
    for values in reversed(stages.values()):
        while len(values) % 2 == 0:
            values = _in_pairs(values)
        sums[len(values)] = add(sums.get(len(values), len(values) * (0.0,)), values)
    values = []
    for some in sums.values():
        while len(some) > 1:
            some = _in_pairs(some)
        values += some
    while len(values) > 1:
        values = _in_pairs(values)
    terms[:] = [(None, value) for value in values]
    return values[0] if values else 0.0


def _in_pairs(values):
    half = (len(values) + 1) // 2
    return [one + other for one, other in itertools.zip_longest(
        values[:half], values[half:], fillvalue=0.0)]


def _product(values):
    product = 1.0
    for value in values:
        product = product * value
    return product


def least(smallest, sine):
    """Return the smaller of two; what is not a number counts as zero."""
    if is_number(sine, 1.0):
        return smallest
    return chosen(sine >= smallest, smallest, chosen(sine > 0.0, sine, 0.0))
