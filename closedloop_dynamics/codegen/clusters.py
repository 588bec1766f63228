# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The forward dynamics cluster by cluster: loops are eliminated with their joints, on one body.

A cluster is loops that share joints, and all joints between them and the body that they close on;
a joint in no loop is one of its own, as are those of a free body. With the inertias of what its
bodies carry the joints of a cluster are eliminated as ``arms`` are: the closure equations, in
which nothing of the closing body's motion occurs, give some from the others, and what is left is
an inertia and a force on that body. No multiplier is left to it, and no equation has joints of two
clusters.

All is formed in the axes of ``joint_space.View``, where a planar loop is two equations and its
inertias keep their zeros however the body turns that carries it. Loops are seen from that body as
if it stood still: of one that is open the equations differ from those of the other methods by the
gap times the turning of that body.

``accelerate`` takes the place of that of ``forward_dynamics`` for mechanisms in space.
"""

import math
from typing import NamedTuple

from . import arms, elimination, space
from .forward_dynamics import to_user_order
from .joint_space import turned_inertia
from .spatial import aligned, Recursion, shifted
from .vectors import (
    add, cross, dot, IDENTITY, in_blocks, is_zero, product, scale, subtract, symmetric, times,
    transpose, ZERO)
from ..engine.types import BODY_A, BODY_B, DOF, EVALUATIONS, PARENT, ROW, ROWS


class Cluster(NamedTuple):
    """Joints that are eliminated together."""

    #: The row of the tree that carries them; 0 for the ground.
    closing: int
    #: ``rows``, ``cuts``: Of the tree, and places of cut joints (lists of int).
    rows: list
    cuts: list
    #: How they are eliminated; None for joints in no loop: one, or all of a free body (arms.Plan).
    plan: object


def clusters(recursion, model):
    """
    Return the clusters of a mechanism in space, from the tips to the ground.

    None where the joints of one cannot be eliminated so, and where all axes lie along one of the
    world's: in its axes the other methods keep the zeros of such mechanisms, too.
    """
    parent, loops, found = model.tree[:, PARENT].tolist(), [], []
    if not space.is_spatial(model) or recursion.hinges or any(
            not is_zero(body.rotor) or body.ball and body.armature is not None
            for body in recursion.bodies[1:]) or all(
            _keeps_axis(body, p) for body, p in zip(recursion.bodies[1:], parent[1:])):
        return None
    for a, (cut, one) in enumerate(zip(model.cut, recursion.cuts)):
        if cut[ROWS] == 0:
            continue
        ends = cut[[BODY_A, BODY_B]].tolist()
        if one.coupling is not None:
            ends = [i for i, _ in one.coupling[1]]
        paths = [_carriers(parent, i) for i in ends]
        # A body that carries another one may itself be the closing body, a coupled joint not.
        closing = max(set.intersection(*(
            set(path if one.coupling is None else path[1:]) for path in paths)))
        # Along the world's axes equations have the closing body's motion, too.
        if one.law is not None or one.between or not (
                closing == 0 or one.carried or len(one.along) < 3):
            return None
        rows, cuts = {i for path in paths for i in path if i > closing}, [a]
        for other in [other for other in loops if not rows.isdisjoint(other[1])]:
            loops.remove(other)
            closing, rows, cuts = min(closing, other[0]), rows | other[1], other[2] + cuts
        loops.append((closing, rows, cuts))
    held = {i for _, rows, _ in loops for i in rows}
    if any(recursion.bodies[i].ball for i in held):
        return None
    for closing, rows, cuts in loops:
        plan = arms.Plan(recursion, model, False, closing, cuts, rows)
        if not plan.complete or sum(map(len, plan.unknowns)) > arms.MOST_LEFT:
            return None
        found.append(Cluster(closing, sorted(rows), cuts, plan))
    free = _free_bodies(recursion, parent)
    held.update(i for rows in free for i in rows)
    found += [Cluster(0, rows, [], None) for rows in free]
    found += [Cluster(parent[i], [i], [], None) for i in range(1, len(parent)) if i not in held]
    return sorted(found, key=lambda one: one.rows[0], reverse=True)


def _free_bodies(recursion, parent):
    """Return the rows of bodies that three slides and a spherical joint carry, and no other."""
    found = []
    for last in range(6, len(parent)):
        rows = list(range(last - 5, last + 1))
        bodies = [recursion.bodies[i] for i in rows]
        slides, ball, between = bodies[:3], bodies[3:], bodies[:-1]
        if (parent[rows[0]:last + 1] == [0, *rows[:-1]]
                and all(one.slides and not one.turns and one.turned is None for one in slides)
                and {one.axis for one in slides} == {0, 1, 2} and all(one.ball for one in ball)
                and all(one.armature is None for one in bodies)
                and all(parent.count(i) == 1 for i in rows[:-1]) and is_zero(sum(
                    ((one.mass, *one.moment, *sum(one.inertia, ())) for one in between), ()))):
            found.append(rows)
    return found


def _keeps_axis(body, parent):
    """Return whether a body's axis is its parent's, or on the ground one of the world's."""
    return not body.ball and (body.turned is None or parent == 0 and not any(
        hasattr(value, 'place') for row in body.turned for value in row))


def _carriers(parent, i):
    """Return a row of the tree, those that carry it, and 0."""
    rows = [i]
    while rows[-1] > 0:
        rows.append(parent[rows[-1]])
    return rows


class _Tree:
    """The bodies of a tree while their clusters are eliminated, in the axes of views."""

    def __init__(self, recursion, model, work, tau, baumgarte, errors):
        self.recursion, self.model, self.work, self.errors = recursion, model, work, errors
        self.tau, self.baumgarte = tau, baumgarte
        self.parent = model.tree[:, PARENT].tolist()
        self.views, rows = recursion.views, range(len(self.parent))
        # Spherical joints turn about the axes of their last body, in which their rates are given.
        self.axis = [IDENTITY[body.axis] + ZERO if i > 0 and body.ball else view.motion.axis
                     for i, (body, view) in enumerate(zip(recursion.bodies, self.views))]
        self.rigid = [recursion.rigid_in_view(i) if i > 0 else None for i in rows]
        # What the bodies carry, and the forces that act on it.
        self.inertia, self.force = len(rows) * [6 * (2 * ZERO,)], [
            self._in_view(i, recursion.force[i]) if i > 0 else 2 * ZERO for i in rows]
        self.acceleration, self.smallest, self._undo = {0: 2 * ZERO}, 1.0, []

    def _in_view(self, i, wrench):
        """Return a wrench in world axes in those of a view."""
        axes = transpose(self.views[i].axes)
        return times(axes, wrench[:3]) + times(axes, wrench[3:])

    def eliminate(self, cluster):
        """Eliminate a cluster; add what is left of it to its closing body."""
        if cluster.plan is not None:
            self._eliminate_loops(cluster)
        elif len(cluster.rows) > 1:
            self._eliminate_free_body(cluster.rows)
        else:
            self._eliminate_joint(cluster.rows[0])

    def _on_parent(self, i, inertia, force):
        """Add an inertia and a force of a body to its parent."""
        p, view = self.parent[i], self.views[i]
        if p > 0:
            self.inertia[p] = tuple(map(add, self.inertia[p], shifted(
                _turned(inertia, view.turn), view.motion.offset)))
            self.force[p] = add(self.force[p], view.at_parent(force))

    def _eliminate_joint(self, i):
        """Do the same as ``Recursion.eliminate``."""
        rigid, axis, armature = self.rigid[i], self.axis[i], self.recursion.bodies[i].armature
        inertia = tuple(map(add, rigid.matrix(), self.inertia[i]))
        force, torque = add(rigid.force, self.force[i]), self.tau[self.model.tree[i, DOF]]
        share, alone = times(inertia, axis), None if armature is not None else aligned(axis)
        pivot = dot(axis, share) if armature is None else dot(axis, share) + armature
        # False for a NaN, too.
        bool(pivot > 0.0)
        inverse = 1.0 / pivot
        right, scaled = torque - dot(axis, force), scale(share, inverse)
        self._on_parent(i, symmetric(
            lambda m, n: 0.0 if alone in (m, n) else inertia[m][n] - share[m] * scaled[n],
            size=6), tuple(torque if n == alone else force[n] + scaled[n] * right
                           for n in range(6)))

        def undo(x):
            before = self._before(i)
            change = right * inverse - dot(
                [0.0 if n == alone else one for n, one in enumerate(scaled)], before)
            if alone is None:
                x[i], self.acceleration[i] = change, add(before, scale(axis, change))
            else:
                # What the joint's own coordinate and all before it add up to.
                x[i] = change - before[alone]
                self.acceleration[i] = before[:alone] + (change,) + before[alone + 1:]

        self._undo.append(undo)

    def _eliminate_free_body(self, rows):
        """Find the acceleration of a body that nothing carries, in its own axes."""
        slides, ball, last = rows[:3], rows[3:], rows[-1]
        turn, found, pushed, pulled = self.views[ball[0]].turn, arms.Equations(), ZERO, ZERO
        torque = {i: self.tau[self.model.tree[i, DOF]] for i in rows}
        for i in reversed(slides):
            axis, pushed = self.axis[i][3:], add(pushed, self.force[i][3:])
            pulled = add(pulled, scale(axis, torque[i] - dot(axis, pushed)))
        inertia = map(add, self.rigid[last].matrix(), self.inertia[last])
        force = [*(torque[i] for i in ball), *times(transpose(turn), pulled)]
        for one in self.rigid[last].force, *(self.force[i] for i in ball):
            force = subtract(force, one)
        keys = [(last, n) for n in range(6)]
        for n, row in enumerate(inertia):
            found.add_right(keys[n], force[n])
            for m in range(n + 1):
                found.add(keys[n], keys[m], row[m])
        for some in keys[3:], keys[:3]:
            largest = math.prod(found.entry(key, key) for key in some)
            bool(found.eliminate(some)[-1] > arms.ROUNDING * largest)

        def undo(x):
            found.solution(x)
            moved = self.acceleration[last] = tuple(x[key] for key in keys)
            x.update((i, moved[self.recursion.bodies[i].axis]) for i in ball)
            x.update((i, dot(self.axis[i][3:], times(turn, moved[3:]))) for i in slides)

        self._undo.append(undo)

    def _before(self, i):
        """Return the acceleration of a body but for that of its own joint."""
        one, view = self.acceleration[self.parent[i]], self.views[i]
        back = transpose(view.turn)
        return times(back, one[:3]) + times(back, add(one[3:], cross(one[:3], view.motion.offset)))

    def _eliminate_loops(self, cluster):
        closing, rows, cuts, plan = cluster
        found, seen = arms.Equations(), self._seen_from(closing, rows)
        for i in reversed(rows):
            self._add_body(i, closing, found)
        for a in cuts:
            self._add_loop(a, closing, seen, found)
        self.smallest = arms.least(self.smallest, arms.eliminate(plan, found, {
            i for i in rows if self.recursion.bodies[i].turns}))
        if closing > 0:
            keys = [(closing, n) for n in range(6)]
            more = [[found.entry(one, other) for other in keys] for one in keys]
            self.inertia[closing] = tuple(map(add, self.inertia[closing], more))
            self.force[closing] = tuple(
                value - found.right(key) for value, key in zip(self.force[closing], keys))

        def undo(x):
            x.update(((closing, n), value) for n, value in enumerate(self.acceleration[closing]))
            found.solution(x)
            for i in rows:
                self.acceleration[i] = add(self._before(i), scale(self.axis[i], x[i]))

        self._undo.append(undo)

    def _add_body(self, i, closing, found):
        """Add the equation of motion of a joint; hand the body's inertia to its parent."""
        view, armature = self.views[i], self.recursion.bodies[i].armature
        rigid, p, axis = self.rigid[i], self.parent[i], self.axis[i]
        wrench = add(rigid.wrench(axis), times(self.inertia[i], axis))
        found.add(i, i, dot(axis, wrench) if armature is None else dot(axis, wrench) + armature)
        found.add_right(i, self.tau[self.model.tree[i, DOF]] - dot(
            axis, add(rigid.force, self.force[i])))
        self._on_parent(i, self.inertia[i], self.force[i])
        if p > 0:
            self.rigid[p] = self.rigid[p].plus(view.on_parent(rigid))
        wrench = view.at_parent(wrench)
        while p > closing:
            found.add(i, p, dot(self.axis[p], wrench))
            wrench, p = self.views[p].at_parent(wrench), self.parent[p]
        if p > 0:
            for n, value in enumerate(wrench):
                found.add(i, (p, n), value)

    def _seen_from(self, closing, rows):
        """Return a recursion with the motion of bodies beside a closing body that stands still."""
        recursion, frame = self.recursion, self.views[closing].frame
        seen = Recursion(recursion.bodies, recursion.cuts, ZERO)
        # Angles are counted as in the views.
        seen.motion = {closing: seen.ground if frame is IDENTITY else seen.ground._replace(
            frame=frame, angle=recursion.motion[closing].angle)}
        for i in rows:
            seen.motion[i] = seen.joint_kinematics(
                i, self.parent[i], *recursion.coordinate(i))
        return seen

    def _add_loop(self, a, closing, seen, found):
        """Add the closure equations of a cut joint; ``seen``: from the closing body."""
        cut, one, work = self.model.cut[a], self.recursion.cuts[a], self.work
        ends = cut[[BODY_A, BODY_B]].tolist()
        equations = self.recursion.closures(self.model, a) if one.coupling is not None else (
            one.left(one.equations(*(seen.motion[i] for i in ends))))
        for place, equation in enumerate(equations, start=cut[ROW]):
            work.closure[place], work.closure_rate[place] = equation.value, equation.rate
            row, arrived = (arms.EQUATION, place), {}
            bias = equation.bias if self.errors is None else self.errors[place]
            found.add_right(row, 0.0 - bias - self.baumgarte * (
                2.0 * equation.rate + self.baumgarte * equation.value))
            for i, force in equation.in_joints:
                found.add(row, i, force)
            for body, wrench in zip(ends, (equation.on_a, equation.on_b)):
                arrived[body] = add(arrived.get(body, 2 * ZERO), wrench)
            while max(arrived) > closing:
                i = max(arrived)
                force, wrench = seen.transmit_wrench(i, arrived.pop(i))
                found.add(row, i, force)
                p = self.parent[i]
                arrived[p] = add(arrived.get(p, 2 * ZERO), wrench)

    def accelerations(self):
        """Return all accelerations and negative multipliers by key."""
        x = {}
        for undo in reversed(self._undo):
            undo(x)
        return x


def _turned(inertia, turn):
    """Return an inertia of six rows in the axes that its own are given in."""
    if turn is IDENTITY:
        return inertia
    about, mass = (turned_inertia([row[n:n + 3] for row in inertia[n:n + 3]], turn)
                   for n in (0, 3))
    coupling = product(product(turn, [row[3:] for row in inertia[:3]]), transpose(turn))
    return in_blocks(about, coupling, mass)


def accelerate(recursion, model, work, tau, baumgarte, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    ``recursion`` is a ``JointSpace`` of a mechanism that has ``clusters``, without ``hinges``.
    """
    work.health[EVALUATIONS] += 1.0
    return _solve(recursion, model, work, tau, baumgarte, None, qdd, lam)


def correct(recursion, model, work, error, out):
    """Find a least change, as ``forward_dynamics.correct`` does."""
    return _solve(recursion, model, work, len(out) * [0.0], 0.0, error, out, [*error])


def _solve(recursion, model, work, tau, baumgarte, errors, qdd, lam):
    tree = _Tree(recursion, model, work, tau, baumgarte, errors)
    for cluster in clusters(recursion, model):
        tree.eliminate(cluster)
    elimination.record_pivot(model, work, tree.smallest)
    x = tree.accelerations()
    for i in range(1, len(model.tree)):
        qdd[model.tree[i, DOF]] = x[i]
    for place in range(len(work.right)):
        work.right[place] = 0.0 - x[arms.EQUATION, place]
    to_user_order(model, work.right, lam)
    return True
