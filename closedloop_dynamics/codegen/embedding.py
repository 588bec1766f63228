# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The forward dynamics with loops eliminated where they close.

The loops in a leg of a walking robot end on bodies that a common one carries. Their multipliers
are eliminated there, before its joint is: what is left of them is an inertia and a force on that
body, as that of all bodies beyond it is. So loops of different legs never meet in one matrix.
Loops that share a joint are eliminated together; those that close on the ground are left to the
end.

A rotor's inertia, seen at its joint, is many times that of the links: it leaves one direction of a
cut point thousands of times less mobile than the other, which is no sign of a singular position.
So where a loop has rotors, the second equation of its cut point is made orthogonal to the first
one joint by joint (modified Gram-Schmidt: its small pivot keeps its digits), and the pivot is
compared with the one that perpendicular levers of all joints would give.

The methods take the places of those of ``forward_dynamics``.
"""

from . import elimination
from .expression_graph import chosen
from .forward_dynamics import to_user_order
from .vectors import add, dot, scale, ZERO
from ..engine.types import (
    BODY_A, BODY_B, CUT_PRISMATIC, CUT_TYPE, DINV, EVALUATIONS, LENGTHS, NO_RESPONSES, PARENT,
    PATH_A, PATH_COMMON, PATH_END, RHS, ROW)


def closing_bodies(recursion, model):
    """Return where the loops are eliminated: a row of the tree by cut joint, 0 for the ground."""
    parent = model.tree[:, PARENT].tolist()
    # Bodies between three hinges have no inertia of their own, and must not get one.
    between = {i for rows in recursion.hinges for i in rows[:2]}
    paths, found = [], []
    for a, cut in enumerate(model.cut):
        path = model.path_body[cut[PATH_A]:cut[PATH_END]].tolist()
        common = model.path_body[cut[PATH_COMMON]:cut[PATH_END]].tolist()
        body = common[0] if common and recursion.cuts[a].coupling is None else 0
        while body in between:
            body = parent[body]
        paths.append(path)
        found.append(body)

    def meet(a, b):
        """Return whether two loops share a joint beyond the bodies that they close on."""
        return not {i for i in paths[a] if i > found[a] and found[a] in above(i)}.isdisjoint(
            i for i in paths[b] if i > found[b] and found[b] in above(i))

    def above(i):
        """Return the bodies that carry a body, and the ground."""
        carriers = [0]
        while i > 0:
            i = parent[i]
            carriers.append(i)
        return carriers

    again = True
    while again:
        again = False
        for a in range(len(found)):
            for b in range(a):
                if found[a] != found[b] and meet(a, b):
                    found[a] = found[b] = min(found[a], found[b])
                    again = True
    return found


class _Loops:
    """
    Loops that are eliminated together on one body, the row ``closing``; 0 for the ground.

    ``rows``: place in the elimination order of each equation, the equation and the bodies that it
    acts on; all else is as for ``accelerate``.
    """

    def __init__(self, recursion, model, work, closing, rows):
        self.recursion, self.model, self.work = recursion, model, work
        self.closing, self.rows = closing, rows
        self.smallest = 1.0

    def _respond(self, equation, body_a, body_b):
        """Return joint forces of a unit multiplier, plain and over D, and the remaining wrench."""
        work, parent = self.work, self.model.tree[:, PARENT]
        arrived, forces, shares = {}, dict(equation.in_joints), {}
        for body, wrench in ((body_a, equation.on_a), (body_b, equation.on_b)):
            arrived[body] = add(arrived.get(body, 2 * ZERO), wrench)
        for i in forces:
            arrived.setdefault(i, 2 * ZERO)
        while max(arrived) > self.closing:
            i = max(arrived)
            force, scaled, wrench = self.recursion.transmit_articulated_wrench(
                i, work.body[i, DINV], arrived.pop(i), forces.get(i, 0.0))
            shares[i] = force, scaled
            arrived[parent[i]] = add(arrived.get(parent[i], 2 * ZERO), wrench)
        return shares, arrived[self.closing]

    def factor(self):
        """Factor the constraint matrix of these loops; return its smallest relative pivot."""
        found = [self._respond(equation, a, b) for _, equation, a, b in self.rows]
        self.shares = [shares for shares, _ in found]
        wrenches, self.wrenches = [wrench for _, wrench in found], []
        count, self.lower, self.inverse = len(found), [], []
        perpendicular = self._make_orthogonal(wrenches)
        left = [[sum((self.shares[k][i][0] * self.shares[n][i][1]
                      for i in self.shares[k] if i in self.shares[n]), 0.0)
                 for n in range(k + 1)] for k in range(count)]
        scales = self._scales([left[k][k] for k in range(count)])
        for first, scale_of_second in perpendicular.items():
            left[first + 1][first], scales[first] = 0.0, left[first][first]
            scales[first + 1] = scale_of_second
        # Columns of L, times D, and what is left of the unit multipliers' wrenches.
        for k in range(count):
            ratio, inverse = elimination.compared(left[k][k], scales[k])
            # Written so that a NaN counts as poor, as in ``elimination``.
            self.smallest = chosen(ratio >= self.smallest, self.smallest,
                                   chosen(ratio > 0.0, ratio, 0.0))
            column = [left[m][k] for m in range(k + 1, count)]
            for m in range(k + 1, count):
                share = left[m][k] * inverse
                for n in range(k + 1, m + 1):
                    left[m][n] = left[m][n] - share * left[n][k]
                if self.closing > 0:
                    wrenches[m] = add(wrenches[m], scale(wrenches[k], 0.0 - share))
            self.lower.append(column)
            self.inverse.append(inverse)
        self.wrenches = wrenches
        return self.smallest

    def _make_orthogonal(self, wrenches):
        """
        Make second equations of cut points orthogonal to the first ones, where there are rotors.

        ``wrenches`` of the equations on the closing body are written. Returns reference values of
        the second ones' pivots by the places of the first ones.
        """
        found, self.taken = {}, {}
        places, bodies = [place for place, _, _, _ in self.rows], self.recursion.bodies
        for cut in self.model.cut:
            first = places.index(cut[ROW]) if cut[ROW] in places else 0
            one, other = (self.shares[first:first + 2] + [{}, {}])[:2]
            if not (cut[ROW] in places and cut[LENGTHS] == 2 and cut[CUT_TYPE] != CUT_PRISMATIC
                    and any(bodies[i].armature is not None for i in one)):
                continue
            own, sizes, products = 0.0, 0.0, 0.0
            for i, (force, scaled) in one.items():
                size = force * scaled + other[i][0] * other[i][1]
                # Without a difference: sizes are of many decades.
                products, sizes = products + size * sizes, sizes + size
                own = own + force * scaled
            found[first] = products / own
            share = sum(other[i][0] * scaled for i, (_, scaled) in one.items()) / own
            self.taken[first] = share
            self.shares[first + 1] = {i: tuple(
                value - share * before for value, before in zip(other[i], one[i])) for i in one}
            wrenches[first + 1] = add(wrenches[first + 1], scale(wrenches[first], 0.0 - share))
        return found

    def _scales(self, diagonal):
        """Return the reference values of the pivots, as in ``elimination.assemble``."""
        scale, places = self.work.scale, [place for place, _, _, _ in self.rows]
        scale[places] = diagonal
        for cut in self.model.cut:
            if cut[ROW] in places:
                elimination.share_scale(cut, scale)
        return scale[places]

    def close(self, right):
        """
        Eliminate the multipliers; add their inertia and force to the closing body.

        Parameters
        ----------
        right : list
            Accelerations of the closure errors, beside those of joints [m/s^2, rad/s^2].

        """
        body, recursion = self.work.body, self.recursion
        right = list(right)
        for first, share in self.taken.items():
            right[first + 1] = right[first + 1] - share * right[first]
        left = [value + sum((scaled * body[i, RHS] for i, (_, scaled) in shares.items()), 0.0)
                for value, shares in zip(right, self.shares)]
        for k, column in enumerate(self.lower):
            share = left[k] * self.inverse[k]
            for m, factor in enumerate(column, start=k + 1):
                left[m] = left[m] - factor * share
        self.left = left
        if self.closing > 0:
            over = [scale(wrench, inverse) for wrench, inverse in zip(self.wrenches, self.inverse)]
            more = [[sum((one[m] * other[n] for one, other in zip(self.wrenches, over)), 0.0)
                     if m <= n else None for n in range(6)] for m in range(6)]
            before = recursion.inertia[self.closing]
            recursion.inertia[self.closing] = tuple(
                tuple(before[m][n] + more[min(m, n)][max(m, n)] for n in range(6))
                for m in range(6))
            force = [sum((wrench[n] * value for wrench, value in zip(over, left)), 0.0)
                     for n in range(6)]
            recursion.force[self.closing] = add(recursion.force[self.closing], force)

    def find_multipliers(self):
        """Find the multipliers from the closing body's acceleration, and apply their forces."""
        body, lam = self.work.body, list(self.left)
        if self.closing > 0:
            after = self.recursion.acceleration[self.closing]
            lam = [value + dot(wrench, after) for value, wrench in zip(lam, self.wrenches)]
        for k in range(len(lam) - 1, -1, -1):
            total = lam[k]
            for m, factor in enumerate(self.lower[k], start=k + 1):
                # Those behind have their sign already.
                total = total + factor * lam[m]
            lam[k] = 0.0 - total * self.inverse[k]
        for value, shares in zip(lam, self.shares):
            for i, (force, _) in shares.items():
                body[i, RHS] = body[i, RHS] + force * value
        for first, share in self.taken.items():
            lam[first] = lam[first] - share * lam[first + 1]
        for value, (place, _, _, _) in zip(lam, self.rows):
            self.work.right[place] = value


def _groups(recursion, model, work):
    """Return the loops that are eliminated together, by the bodies that they close on."""
    rows = {}
    for a, (cut, closing) in enumerate(zip(model.cut, closing_bodies(recursion, model))):
        for row, equation in enumerate(recursion.closures(model, a), start=cut[ROW]):
            rows.setdefault(closing, []).append((row, equation, cut[BODY_A], cut[BODY_B]))
    return {closing: _Loops(recursion, model, work, closing, sorted(those, key=lambda one: one[0]))
            for closing, those in rows.items()}


def _solve(recursion, model, work, tau, right, qdd):
    """
    Solve the equations of motion and closure; return the smallest relative pivot.

    ``right``, shape (nc,), has the accelerations of the closure errors without those of joints, in
    elimination order, and is replaced by the multipliers; all else is as for ``accelerate``.
    """
    groups, smallest = _groups(recursion, model, work), []

    def close(i):
        if i in groups:
            smallest.append(groups[i].factor())
            groups[i].close([right[place] for place, _, _, _ in groups[i].rows])

    def opened(i):
        if i in groups:
            groups[i].find_multipliers()

    recursion.inward(model, tau, work, before=close)
    recursion.outward_acceleration(model, work, qdd, after=opened)
    # Where equations of all loops hold anyway none is left.
    least = smallest[0] if smallest else 1.0
    for one in smallest[1:]:
        least = chosen(one >= least, least, one)
    return least


def accelerate(recursion, model, work, tau, baumgarte, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    Returns whether every pivot was good.
    """
    work.health[EVALUATIONS] += 1.0
    recursion.update(model, work, NO_RESPONSES)
    right = [bias + baumgarte * (2.0 * rate + baumgarte * value) for bias, rate, value in zip(
        work.bias, work.closure_rate, work.closure)]
    smallest = _solve(recursion, model, work, tau, right, qdd)
    fine = elimination.record_good_pivot(model, work, smallest)
    if not fine:
        return False
    to_user_order(model, work.right, lam)
    return True


def correct(recursion, model, work, error, out):
    """Find a least change, as ``forward_dynamics.correct`` does."""
    return elimination.record_good_pivot(model, work, _solve(
        recursion, model, work, len(out) * [0.0], error, out))
