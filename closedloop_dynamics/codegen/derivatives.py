# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Derivatives of accelerations and multipliers, as code that is generated from the graph.

The equations of motion and of the loops are differentiated, with accelerations and multipliers
held, and what that leaves is solved for the derivatives of these by the factors that an
evaluation has, too: of the residuals

    R = M qdd + h - J^T lambda - tau = 0,    C = J qdd + Jdot qd = 0

the derivatives by any x are those of ``K (qdd, lambda) = -(dR/dx, dC/dx)`` with K = (M, -J^T; J,
0). Coordinates are those of the spanning tree, each changed alone, with the loops open: what
changes along the loops is what a closing change of all of them adds up to.
"""

from . import arms, elimination, forward_dynamics
from .differentiation import differentiated
from .expression_graph import ExpressionGraph, graph_of, Q, QD, Routine
from .function_table import behind, CLOSURE, JACOBIAN, JOINT_FORCE, LAM, LANES, QDD, SHARED
from .linear_map import divided
from .routines import zeros
from .scene_routines import PLACE_BIAS, SceneTrace
from .spatial import at_parent, rigid
from .vectors import add, cross, dot, is_zero, scale, subtract, times, transpose, ZERO
from ..engine.manifold import manifold_of
from ..engine.types import (
    BODY_A, BODY_B, COORDINATE, CUT_ROW, DINV, DOF, NO_RESPONSES, PARENT, RHS, ROW, ROWS)

# Outputs beside JACOBIAN, J in rows, and JOINT_FORCE, wrenches in joints: d (J qd) / d (q, qd), in
# columns of nc numbers; changes of the residuals, in columns lane by lane, an input, too; and
# changes of the rates of the effects' states, as those of closure rates.
RATE, COLUMN, FLOW = behind(PLACE_BIAS, 3)
# Half the product of a quaternion x, y, z, w and an axis of the child: place and sign of what each
# component changes by.
_TURN = (((3, 1), (2, 1), (1, -1), (0, -1)), ((2, -1), (3, 1), (0, 1), (1, -1)),
         ((1, 1), (0, -1), (3, 1), (2, -1)))


class DerivativeTrace(SceneTrace):
    """
    A mechanism with its effects, traced for derivatives; arguments are those of ``SceneTrace``.

    Accelerations and multipliers of the state are inputs, as an evaluation leaves them.
    """

    def __init__(self, model, act, values, with_arms=False):
        """Set up the recursion with every joint treated separately."""
        super().__init__(model, act, values, with_arms)
        self.recursion.hinges, self.by_arms = (), False

    def in_lanes(self, states=0):
        """
        Return routines for the derivatives by coordinates, rates and torques, in this order.

        Straight code for all columns of a mechanism in space is longer than caches of
        instructions: what solves for LANES columns side by side is called again and again
        instead.

        Parameters
        ----------
        states : int
            Of the effects, such as energies that are lost, whose rates are differentiated, too:
            for steps of the engine, with contacts on the sides that it has decided on.

        Returns
        -------
        first : list of Routine
            ``residuals`` stores the columns, LANES of them lane by lane, but for zeros, the
            factors to ``SHARED``, and derivatives of closure rates; ``shared`` tells how many
            factors there are, at q.
        second : list of Routine
            ``solve``, to be written in lanes: of columns at q to derivatives at qd.

        """
        self.decided = states > 0
        columns = self._columns(states)
        count = len(columns[0])
        for number, column in enumerate(columns):
            block, lane = divmod(number, LANES)
            self.outputs += [(COLUMN, (block * count + n) * LANES + lane, value)
                             for n, value in enumerate(column) if hasattr(value, 'place') or value]
        found, factors = divided(
            self.graph, self.solved(list(self.symbols(COLUMN, (count,)))), COLUMN, SHARED)
        self.outputs += [(SHARED, n, factor) for n, factor in enumerate(factors)]
        solve = Routine('solve', graph_of(found),
                        [(QD, n, value) for n, value in enumerate(found)])
        shared = Routine('shared', ExpressionGraph(), [(Q, 0, float(len(factors)))])
        return [self.named('residuals'), shared], [solve]

    def _columns(self, states):
        """Return changes of the residuals; store those of other rates, and factorise."""
        residuals = self.residuals()
        flows = [self.flows[place] for place in range(states)]
        self.prepare()
        rates = zeros(self.nc)
        forward_dynamics.to_user_order(self.model, self.work.closure_rate, rates)
        columns, count = [], self.nv + self.nc
        for number, seed in enumerate(self._seeds()):
            found = differentiated(self.graph, [*residuals, *rates, *flows], seed)
            columns.append(found[:count])
            for output, first, size in (RATE, count, self.nc), (FLOW, count + self.nc, states):
                self.outputs += [(output, number * size + n, value)
                                 for n, value in enumerate(found[first:first + size])]
        for joint in range(self.nv):
            # A torque is in one residual alone.
            columns.append([-1.0 if n == joint else 0.0 for n in range(count)])
        return columns

    def closures(self):
        """Store the errors of the closure equations and their Jacobian, in the user's order."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        rates = zeros(self.nc)
        for a, cut in enumerate(self.constant.cut):
            for row, closure in enumerate(
                    self.recursion.closures(self.model, a), start=cut[CUT_ROW]):
                self.outputs.append((CLOSURE, row, closure.value))
                rates[row] = closure.rate
        for joint in range(self.nv):
            column = differentiated(self.graph, list(rates), {self.qd[joint].place: 1.0})
            self.outputs += [(JACOBIAN, row * self.nv + joint, value)
                             for row, value in enumerate(column)]

    def joint_forces(self, rows, origins, axes, cuts, cut_axes):
        """
        Store the wrenches in joints: of the parent on the child, of body B on body A.

        ``rows`` are those of the bodies that the joints carry; ``origins``, shape (number of
        joints, 3), and ``axes``, (number of joints, 3, 3), of the children in the frames of these
        rows; ``cuts`` as for ``cut_wrench``, of the cut joints whose wrenches follow, at the cut
        points of A; ``cut_axes`` of bodies A in the frames of their rows.
        """
        _, wrenches, _ = self._balanced()
        found = []
        for row, origin, turned in zip(rows, origins.tolist(), axes.tolist()):
            found.append((row, wrenches[row], origin, turned))
        for own, turned in zip(cuts, cut_axes.tolist()):
            found.append((*self.cut_wrench(own), turned))
        for n, (row, wrench, origin, turned) in enumerate(found):
            frame = transpose(self.recursion.motion[row].frame)
            moment, force = (times(frame, part) for part in (wrench[:3], wrench[3:]))
            moment = subtract(moment, cross(origin, force))
            for k, value in enumerate(
                    times(transpose(turned), moment) + times(transpose(turned), force)):
                self.outputs.append((JOINT_FORCE, 6 * n + k, value))

    def cut_wrench(self, rows):
        """
        Return the wrench of body B on body A at a cut joint.

        ``rows``: that of the cut joint among those of the model, behind it those of what couples
        its freedoms. Returns the row of body A, the wrench about the origin of that row, in world
        axes, and the cut point in the frame of that row.
        """
        lam, body, wrench = self.symbols(LAM, (self.nc,)), self.constant.cut[rows[0], BODY_A], (
            2 * ZERO)
        for a in rows:
            cut = self.constant.cut[a]
            for row, closure in enumerate(
                    self.recursion.closures(self.model, a), start=cut[CUT_ROW]):
                unit = closure.on_a if cut[BODY_A] == body else closure.on_b
                wrench = add(wrench, scale(unit, lam[row]))
        return body, wrench, self.recursion.cuts[rows[0]].point_a

    def residuals(self):
        """Return R without the torques, and C in the mechanism's order of equations."""
        own, _, closed = self._balanced()
        return [*own, *closed]

    def _balanced(self):
        """Return R without the torques, the wrenches in the joints of the tree, and C."""
        forces = self.moved()
        self.flows = forces.rates
        return self._sums(
            self.symbols(QDD, (self.nv,)), self.symbols(LAM, (self.nc,)), self.recursion.force,
            forces.torque, 'bias')

    def balance(self, qdd, lam, force, torque, held):
        """
        Return M qdd - J^T lambda with forces, less torques; and J qdd with its bias.

        Parameters
        ----------
        qdd : ndarray, shape (nv,)
            Accelerations, or a change of rates.
        lam : ndarray, shape (nc,)
            Their multipliers, in the mechanism's order of equations.
        force : list of tuples of 6
            On the bodies, to be overcome, after the outward recursion.
        torque : ndarray, shape (nv,)
            In the joints.
        held : str
            The term of each closure equation that is added: ``value``, ``rate`` or ``bias``.

        """
        own, _, closed = self._sums(qdd, lam, force, torque, held)
        return [*own, *closed]

    def _sums(self, qdd, lam, force, torque, held):
        """Return both parts of ``balance``, and the wrenches in the joints between them."""
        one, tree = self.recursion, self.constant.tree
        world, own = list(qdd), zeros(self.nv)
        for frame, turns in one.balls(self.constant):
            world[turns] = times(frame, world[turns])
        after, wrench = [2 * ZERO], [2 * ZERO, *force[1:]]
        for i in range(1, len(tree)):
            parent, rate = tree[i, PARENT], world[tree[i, DOF]]
            before = after[parent]
            after.append(one.propagate_acceleration(i, before, rate))
            inertia, _ = rigid(one.bodies[i], one.motion[i])
            wrench[i] = add(wrench[i], times(inertia, after[i]))
            armature, rotor = one.bodies[i].armature, one.rotor[i]
            if armature is not None:
                own[tree[i, DOF]] = armature * rate
            if not is_zero(rotor):
                own[tree[i, DOF]] = own[tree[i, DOF]] + dot(
                    rotor, add(one.motion[parent].spin_rate, before[:3]))
                wrench[parent] = add(wrench[parent], scale(rotor, rate) + ZERO)
        closed = zeros(self.nc)
        for a, cut in enumerate(self.constant.cut):
            for row, closure in enumerate(one.closures(self.model, a), start=cut[CUT_ROW]):
                total = getattr(closure, held)
                for body, unit in ((cut[BODY_A], closure.on_a), (cut[BODY_B], closure.on_b)):
                    wrench[body] = subtract(wrench[body], scale(unit, lam[row]))
                    total = total + dot(unit, after[body])
                for i, factor in closure.in_joints:
                    dof = tree[i, DOF]
                    own[dof] = own[dof] - factor * lam[row]
                    total = total + factor * world[dof]
                closed[row] = total
        for i in range(len(tree) - 1, 0, -1):
            parent, dof = tree[i, PARENT], tree[i, DOF]
            own[dof] = own[dof] + dot(one.motion[i].axis, wrench[i])
            if parent > 0:
                wrench[parent] = add(wrench[parent], at_parent(wrench[i], one.motion[i].offset))
        for frame, turns in one.balls(self.constant):
            own[turns] = times(transpose(frame), own[turns])
        return own - torque, wrench, closed

    def prepare(self):
        """Factorise; the routine returns where that fails."""
        self.by_arms = self.with_arms
        if self.by_arms:
            self.recursion.update(self.model, self.work, NO_RESPONSES)
        else:
            bool(forward_dynamics.prepare(
                self.recursion, self.model, zeros(self.nv), self.work))
        # Changes of the accelerations have no bias of their own.
        self.recursion.motion = [
            motion._replace(spin_rate=ZERO) for motion in self.recursion.motion]

    def _seeds(self):
        """Yield changes of coordinates, then of rates, by the place of their symbols."""
        turns, manifold = {}, manifold_of(self.constant)
        for first, rate in [] if manifold is None else manifold.balls.tolist():
            for axis, changes in enumerate(_TURN):
                turns[rate + axis] = {
                    self.q[first + k].place: (0.5 * sign) * self.q[first + other]
                    for k, (other, sign) in enumerate(changes)}
        by_rate = {row[DOF]: row[COORDINATE] for row in self.constant.tree[1:]}
        for joint in range(self.nv):
            yield turns.get(joint) or {self.q[by_rate[joint]].place: 1.0}
        for joint in range(self.nv):
            yield {self.qd[joint].place: 1.0}

    def solved(self, column):
        """Return the changes of accelerations and multipliers that undo those of residuals."""
        one, tree, work = self.recursion, self.constant.tree, self.work
        tau = [0.0 - value for value in column[:self.nv]]
        one.force = [2 * ZERO for _ in tree]
        qdd, lam = zeros(self.nv), zeros(self.nc)
        if self.by_arms:
            for cut in self.constant.cut:
                for k in range(cut[ROWS]):
                    work.bias[cut[ROW] + k] = column[self.nv + cut[CUT_ROW] + k]
            arms.solve(one, self.model, work, tau, 0.0, qdd, lam)
            return [*qdd, *lam]
        for frame, turns in one.balls(self.constant):
            tau[turns] = times(frame, tau[turns])
        for i in range(len(tree) - 1, 0, -1):
            parent, torque = tree[i, PARENT], tau[tree[i, DOF]]
            right = torque - dot(one.motion[i].axis, one.force[i])
            work.body[i, RHS] = right
            if parent > 0:
                scaled = scale(one.factors[i][0], work.body[i, DINV])
                one.hand_over(i, parent, torque, scaled, right)
        right = zeros(self.nc)
        forward_dynamics.free_acceleration(self.model, work, right)
        for cut in self.constant.cut:
            for k in range(cut[ROWS]):
                place = cut[ROW] + k
                right[place] = 0.0 - right[place] - column[self.nv + cut[CUT_ROW] + k]
        elimination.solve(self.model, work, right)
        forward_dynamics.apply(self.model, work, right)
        one.outward_acceleration(self.model, work, qdd)
        forward_dynamics.to_user_order(self.model, right, lam)
        return [*qdd, *lam]
