# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The equations of motion in the joints' coordinates, and the forward dynamics by these.

Composite rigid bodies give the inertia matrix, Newton's and Euler's equations the bias forces, in
axes in which little is turned and constants keep their zeros: those of each body's own frame, or,
where the angles of further bodies are counted from the same frame, of that one, which in the plane
is the world's (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6). With
I = L D L^T, from the leaves to the ground, multipliers are eliminated as by articulated bodies: D
and the reduced unit forces L^-1 J^T are the same numbers, at less cost in chains of few joints.
"""

from typing import NamedTuple

from . import elimination, forward_dynamics
from .expression_graph import with_one_sign
from .spatial import at_parent, BodyKinematics, Recursion, rotation, turned_frame, X, Z
from .vectors import (
    add, cross, dot, IDENTITY, in_blocks, is_number, is_zero, product, scale, skew, symmetric,
    times, transpose, ZERO)
from ..engine.types import (
    BODY_A, BODY_B, CARRIED, COORDINATE, DINV, DOF, EVALUATIONS, PARENT, PATH_A, PATH_END, RHS,
    ROW, ROWS)


class View(NamedTuple):
    """A body in axes of its own."""

    #: These axes in the world's (tuple of 3 tuples).
    axes: tuple
    #: The body's frame in these axes (tuple of 3 tuples).
    frame: tuple
    #: From these axes to those of the parent's view (tuple of 3 tuples).
    turn: tuple
    #: Along these axes, ``offset`` along the parent's; pose and velocity are not used.
    motion: BodyKinematics

    def at_parent(self, wrench):
        """Return a wrench at the parent's origin, in its axes."""
        return at_parent(
            times(self.turn, wrench[:3]) + times(self.turn, wrench[3:]), self.motion.offset)

    def on_parent(self, one):
        """Return a ``_Rigid`` at the parent's origin, in its axes."""
        offset, moment, inertia = (
            self.motion.offset, times(self.turn, one.moment),
            turned_inertia(one.inertia, self.turn))
        after = add(moment, scale(offset, one.mass))
        squares = [offset[n] * (moment[n] + after[n]) for n in range(3)]

        def entry(m, n):
            if m != n:
                return inertia[m][n] - (offset[m] * moment[n] + after[m] * offset[n])
            if m == Z and is_zero((offset[Z], moment[Z])):
                # As in the plane; entries of the matrix have the first product, too.
                return inertia[m][m] + dot(offset, moment) + dot(offset, after)
            return inertia[m][m] + (squares[m - 2] + squares[m - 1])

        return _Rigid(one.mass, after, symmetric(entry), self.at_parent(one.force))


class _Rigid(NamedTuple):
    """Rigid bodies at one origin: mass, first moments, inertia, and the force of their motion."""

    mass: object = 0.0
    moment: tuple = ZERO
    inertia: tuple = 3 * (ZERO,)
    force: tuple = 2 * ZERO

    def plus(self, other):
        return _Rigid(self.mass + other.mass, add(self.moment, other.moment), tuple(
            map(add, self.inertia, other.inertia)), add(self.force, other.force))

    def matrix(self):
        """Return the inertia of six rows."""
        return in_blocks(self.inertia, skew(self.moment), [
            tuple(self.mass if m == n else 0.0 for m in range(3)) for n in range(3)])

    def wrench(self, axis):
        """Return moment and force of a unit acceleration."""
        turn, slide = axis[:3], axis[3:]
        return (add(times(self.inertia, turn), cross(self.moment, slide))
                + add(scale(slide, self.mass), cross(turn, self.moment)))


def turned_inertia(inertia, frame):
    """Return an inertia in the axes that the frame is given in which it is."""
    if frame is IDENTITY:
        return inertia
    columns = product(frame, inertia)
    return symmetric(lambda m, n: dot(columns[m], frame[n]))


def _gyroscopic(spin, inertia):
    """Return the moment that it takes to keep turning."""
    (x, y, z), ((xx, xy, xz), (_, yy, yz), (_, _, zz)) = spin, inertia

    def less(one, other):
        return 0.0 if one is other else one - other

    return (less(zz, yy) * (y * z) + yz * (y * y - z * z) + xz * (x * y) - xy * (x * z),
            less(xx, zz) * (x * z) + xz * (z * z - x * x) + xy * (y * z) - yz * (x * y),
            less(yy, xx) * (x * y) + xy * (x * x - y * y) + yz * (x * z) - xz * (y * z))


class JointSpace(Recursion):
    """
    The same recursions, with the equations of motion; ``views`` are there after ``outward``.

    ``free``: rows of floating bodies, whose whole accelerations are unknown where forces are
    ``apart``: they do not wait for those that carry them. ``started``: what those would give them
    for qdd = 0, by row, after ``outward`` (tuple of 6). ``centers``: from the centres of mass of
    floating bodies to their origins, by row, after ``equations_of_motion``, about which moments on
    them are then (tuple of 3); of those in a plane the origin serves.
    """

    free, started, centers = (), {}, {}

    def outward(self, model, q, qd, work, written=None):
        """As of ``Recursion``."""
        super().outward(model, q, qd, work, written)
        self.views = [View(IDENTITY, IDENTITY, IDENTITY, self.ground)]
        parents = model.tree[:, PARENT].tolist()
        shared = self._shared(parents)
        for i, body in list(enumerate(self.bodies))[1:]:
            p, first, dof = parents[i], model.tree[i, COORDINATE], model.tree[i, DOF]
            self.views.append(
                self._ball(i, p, q[first:first + 4], qd[dof - body.axis:][:3]) if body.ball
                else self._view(i, p, q[first], qd[dof], i in shared))
            if i in self.free:
                self._release(i, parents)

    def _shared(self, parents):
        """Return the bodies in whose ``base`` further angles are counted: they share its axes."""
        rows = range(1, len(parents))
        if self.in_one_frame:
            return set(rows)
        counted, found = {i for i in rows if self.bodies[i].turned is None
                          and not self.bodies[i].ball}, set()
        for i in reversed(rows):
            if i in counted and parents[i] > 0 and (self.bodies[i].turns or i in found):
                found.add(parents[i])
        return found | {i for i in counted if parents[i] in found}

    def load_coordinates(self, model, q, qd):
        """As of ``Recursion``."""
        super().load_coordinates(model, q, qd)
        self.rates = qd

    def _view(self, i, p, coordinate, rate, shared):
        """Return the view of a body on its parent."""
        body, world, parent = self.bodies[i], self.motion[i], self.views[p]
        axes, own = world.base, turned_frame(IDENTITY, world.angle)
        turn = IDENTITY if body.turned is None else product(parent.frame, body.turned)
        if not shared and (body.turns or body.turned is not None):
            axes, own, turn = world.frame, IDENTITY, product(turn, own)
        elif not shared:
            # What only slides does so in the parent's axes.
            axes, own = parent.axes, parent.frame
        view = View(axes, own, turn, parent.motion)
        axis = IDENTITY[Z] if body.turns else transpose(own)[body.axis]
        rolling, slide = scale(axis, body.turns), scale(axis, body.slides)
        before, spinning, sliding = (
            times(transpose(turn), parent.motion.spin), scale(rolling, rate), scale(slide, rate))
        offset = add(times(parent.frame, body.place), scale(times(turn, slide), coordinate))
        return _moved(view, offset, add(before, spinning), cross(before, spinning), scale(
            cross(before, sliding), 2.0), rolling + slide)

    def _ball(self, i, p, quaternion, rates):
        """Return the view of a row of a spherical joint: the first one has all of its motion."""
        body, parent = self.bodies[i], self.views[p]
        last = self.motion[i + Z - body.axis]
        offset, axis = times(parent.frame, body.place), last.frame[body.axis] + ZERO
        if body.axis != X:
            return parent._replace(
                turn=IDENTITY, motion=parent.motion._replace(offset=offset, axis=axis))
        turn = rotation(quaternion, 2.0 / dot(quaternion, quaternion))
        for frame in (body.turned or IDENTITY, parent.frame):
            turn = product(frame, turn)
        before = times(transpose(turn), parent.motion.spin)
        view = View(last.frame, IDENTITY, turn, parent.motion)
        return _moved(view, offset, add(before, rates), cross(before, rates), ZERO, axis)

    def _release(self, i, parents):
        """Leave the whole acceleration of a body to what is unknown."""
        body, view = self.bodies[i], self.views[i]
        motion = view.motion
        first = i - body.axis if body.ball else i
        before = self.views[parents[first]]
        # As of points of other bodies.
        linear = times(view.axes, motion.acceleration) if body.slides else times(
            before.axes, _accelerated(before.motion, self.views[first].motion.offset))
        self.started = {**self.started, i: times(view.axes, motion.spin_rate) + linear}
        self.views[i] = view._replace(motion=motion._replace(spin_rate=ZERO, acceleration=ZERO))

    def equations(self, model, a):
        """As of ``Recursion``; accelerations of points are found in the axes of views."""
        if not self.apart:
            return super().equations(model, a)
        cut, kept, levers = self.cuts[a], self.motion, []
        self.motion = list(kept)
        for body, point in zip(model.cut[a, [BODY_A, BODY_B]], (cut.point_a, cut.point_b)):
            world, view = kept[body], self.views[body]
            lever = times(world.frame, point)
            self.motion[body] = world._replace(
                origin=add(world.origin, lever),
                velocity=add(world.velocity, cross(world.spin, lever)),
                spin_rate=times(view.axes, view.motion.spin_rate),
                acceleration=times(view.axes, _accelerated(
                    view.motion, times(view.frame, point))))
            levers.append(lever)
        self.cuts[a] = cut._replace(point_a=ZERO, point_b=ZERO)
        found = super().equations(model, a)
        self.motion, self.cuts[a] = kept, cut
        return [one._replace(on_a=at_parent(one.on_a, levers[0]),
                             on_b=at_parent(one.on_b, levers[1])) for one in found]

    def equations_of_motion(self, model, tau, floating=(), angles=()):
        """
        Return inertia matrix and right side of the equations of motion without multipliers.

        Parameters
        ----------
        model : Model
            Constant arrays.
        tau : sequence
            In the joints [N m, N]; those of spherical joints about the world's axes.
        floating : dict of int to tuple of int
            Bodies that are roots of their own, and the components of their motion.
        angles : collection of int
            Rows whose unknowns are accelerations of angles in the world, as of ``arms.Plan``.

        Returns
        -------
        matrix, right : dict
            By pairs of keys, and by keys: rows of the tree, and pairs of one that floats and a
            component. Of a pair of rows the outer one comes first.

        """
        parents, matrix, right = model.tree[:, PARENT].tolist(), {}, {}
        self.centers, beyond = {}, {}
        carried, applied = [_Rigid() for _ in parents], list(self.force)
        for i in range(len(parents) - 1, 0, -1):
            p, view, rotor = parents[i], self.views[i], self.bodies[i].rotor
            whole = carried[i].plus(self.rigid_in_view(i))
            armature = self.bodies[i].armature
            matrix[i, i] = 0.0 if armature is None else armature
            right[i] = tau[model.tree[i, DOF]] - dot(self.rotor[i], self.motion[p].spin_rate)
            wrench = 2 * ZERO
            if i in floating:
                self._float(i, floating[i], whole, applied[i], matrix, right)
            else:
                wrench = whole.wrench(view.motion.axis)
                matrix[i, i] = matrix[i, i] + dot(view.motion.axis, wrench)
                right[i] = right[i] - dot(view.motion.axis, whole.force) - dot(
                    self.motion[i].axis, applied[i])
                if i in angles:
                    # To other angles it is a mass in the joint.
                    wrench, applied[i] = ZERO + wrench[3:], ZERO + applied[i][3:]
                    whole = _Rigid(mass=whole.mass, force=ZERO + whole.force[3:])
                if p > 0:
                    carried[p] = carried[p].plus(view.on_parent(whole))
                    applied[p] = add(applied[p], at_parent(applied[i], self.motion[i].offset))
            wrench = add(view.at_parent(wrench), times(self.views[p].frame, rotor) + ZERO)
            while p > 0 and p not in floating:
                matrix[i, p] = dot(self.views[p].motion.axis, wrench)
                if p in angles:
                    wrench = ZERO + wrench[3:]
                wrench, p = self.views[p].at_parent(wrench), parents[p]
            if p > 0:
                beyond[i] = p, self._in_world(p, wrench)
        for i, (p, wrench) in beyond.items():
            wrench = self.about_center(p, wrench)
            matrix.update(((i, (p, n)), wrench[n]) for n in floating[p])
        return matrix, right

    def rigid_in_view(self, i):
        """Return the rigid body itself."""
        body, view = self.bodies[i], self.views[i]
        moment, inertia = times(view.frame, body.moment), turned_inertia(body.inertia, view.frame)
        force, motion = 2 * ZERO, view.motion
        if self.apart:
            force = add(cross(moment, motion.acceleration), add(
                times(inertia, motion.spin_rate), _gyroscopic(motion.spin, inertia))) + add(
                    scale(motion.acceleration, body.mass), motion.convective_acceleration(moment))
        return _Rigid(body.mass, moment, inertia, force)

    def about_center(self, i, wrench):
        """Return a wrench on a floating body, at its origin, about its centre of mass."""
        more = cross(self.centers.get(i, ZERO), wrench[3:])
        return (*map(with_one_sign, wrench[:3], more), *wrench[3:])

    def _in_world(self, i, wrench):
        axes = self.views[i].axes
        return times(axes, wrench[:3]) + times(axes, wrench[3:])

    def _float(self, i, components, whole, applied, matrix, right):
        """Add the entries of a root of its own, in world axes."""
        force = add(self._in_world(i, whole.force), applied)
        axes = self.views[i].axes
        moment, about = times(axes, whole.moment), turned_inertia(whole.inertia, axes)
        if len(components) == 6 and not is_zero(moment) and not is_number(whole.mass, 0.0):
            # The arm that carries the body in the tree is like all others then.
            back = self.centers[i] = scale(moment, 1.0 / (0.0 - whole.mass))
            x, y, z = (a * b for a, b in zip(moment, back))
            squares, turned = (y + z, x + z, x + y), about
            about = symmetric(lambda m, n: turned[m][n] + squares[m] if m == n
                              else turned[m][n] - moment[m] * back[n])
            force, moment = self.about_center(i, force), ZERO
        coupling = skew(moment)
        for n in components:
            right[i, n] = 0.0 - force[n]
            row = about[n] + coupling[n] if n < 3 else 3 * (0.0,) + tuple(
                whole.mass if m + 3 == n else 0.0 for m in range(3))
            matrix.update((((i, n), (i, m)), row[m]) for m in range(n, 6))


def _accelerated(motion, offset):
    """Return the acceleration of a point that is at an offset, fixed in the body."""
    return add(motion.acceleration, motion.convective_acceleration(offset))


def _moved(view, offset, spin, turning, sliding, axis):
    """Return a view with its motion, given that of the parent and what is added to that."""
    parent, back = view.motion, transpose(view.turn)
    return view._replace(motion=parent._replace(
        offset=offset, spin=spin, spin_rate=add(times(back, parent.spin_rate), turning),
        acceleration=add(times(back, _accelerated(parent, offset)), sliding), axis=axis))


def accelerate(recursion, model, work, tau, baumgarte, qdd, lam):
    """
    Compute accelerations and multipliers, as ``forward_dynamics.accelerate`` does.

    ``recursion`` is a ``JointSpace`` without ``hinges``.
    """
    work.health[EVALUATIONS] += 1.0
    recursion.update(model, work, CARRIED)
    return _solve(recursion, model, work, tau, baumgarte, qdd, lam)


def correct(recursion, model, work, error, out):
    """Find a least change, as ``forward_dynamics.correct`` does."""
    recursion.update(model, work, CARRIED)
    work.bias[:] = error
    return _solve(recursion, model, work, len(out) * [0.0], 0.0, out, [*error])


def _solve(recursion, model, work, tau, baumgarte, qdd, lam):
    factors = _factored(recursion, model, tau, work)
    _reduce(recursion, model, work, factors)
    elimination.assemble(model, work)
    if not elimination.factorize_well(model, work):
        return False
    forward_dynamics.solve(model, work, baumgarte)
    for i, row in list(enumerate(model.tree))[1:]:
        qdd[row[DOF]] = work.body[i, RHS] * work.body[i, DINV] - sum(
            (factor * qdd[model.tree[k, DOF]] for k, factor in factors[i].items()), 0.0)
    recursion.about_own(model, qdd)
    forward_dynamics.to_user_order(model, work.right, lam)
    return True


def _factored(recursion, model, tau, work):
    """
    Factor the inertia matrix; return L by columns.

    ``DINV`` and ``RHS`` of ``work.body`` are written: one over D, and L^-1 times the right side.
    """
    matrix, right = recursion.equations_of_motion(model, recursion.about_world(model, tau))
    parents, factors = model.tree[:, PARENT].tolist(), {}
    for i in range(len(parents) - 1, 0, -1):
        inverse, inner, p = 1.0 / matrix[i, i], [], parents[i]
        while p > 0:
            inner.append(p)
            p = parents[p]
        factors[i] = {k: matrix[i, k] * inverse for k in inner}
        for n, k in enumerate(inner):
            right[k] = right[k] - factors[i][k] * right[i]
            for other in inner[n:]:
                matrix[k, other] = matrix[k, other] - factors[i][k] * matrix[i, other]
        work.body[i, DINV], work.body[i, RHS] = inverse, right[i]
    return factors


def _reduce(recursion, model, work, factors):
    """
    Replace the joint forces J^T of unit multipliers by L^-1 times these.

    How fast loops open is J times the rates, but for what prescribed motions ask.
    """
    rates = recursion.about_world(model, recursion.rates)
    for one, cut in zip(recursion.cuts, model.cut):
        entries = range(cut[PATH_A], cut[PATH_END])
        rows = model.path_body[entries].tolist()
        for k in range(cut[ROWS]):
            forces = dict(zip(rows, work.response[entries, k]))
            if one.motion is None:
                work.closure_rate[cut[ROW] + k] = dot(
                    forces.values(), [rates[model.tree[i, DOF]] for i in rows])
            for i in sorted(forces, reverse=True):
                for inner, factor in factors[i].items():
                    forces[inner] = forces[inner] - factor * forces[i]
            for entry, i in zip(entries, rows):
                work.response[entry, k] = forces[i]
                work.response_scaled[entry, k] = forces[i] * work.body[i, DINV]
