# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Generated derivatives of the parts of a step, in forward and reverse mode.

Accelerations and multipliers x, and the corrections that close the loops with theirs, solve

    F(x, u) = 0,    u = (q, qd, tau, parameters),    dF/dx = K = (M, -J^T; J, 0)

with K of the factors that an evaluation has. Forward, in a direction, dx = -K^-1 F_u du. In
reverse, the gradient of w^T x is -y^T F_u with K^T y = w: one solution, and one pass through the
residuals for any number of inputs (the adjoint of an implicit function; Griewank and Walther,
Evaluating Derivatives, 2nd ed. (2008), section 15).
"""

from .arms import AlwaysSingularError
from .derivatives import DerivativeTrace, FLOW
from .differentiation import differentiated, gradients
from .expression_graph import ExpressionGraph, graph_of, LOAD, Q, QD, replayed, Routine
from .function_table import behind, LAM, QDD, RESULT, SEED, SHARED
from .linear_map import divided
from .routines import zeros
from .scene_routines import POINT
from .vectors import cross, in_space, subtract, times, ZERO
from ..engine.types import CUT_ROW

# SEED and RESULT are, forward, changes of q, qd, tau and parameters in one direction, and what the
# accelerations, or the corrections, change by, with their multipliers; in reverse, weights of
# these, not of multipliers, and the gradient by all the former.
# In the graph alone: a correction and its multipliers, before they are solved for.
_CORRECTION, _MULTIPLIER = behind(FLOW, 2)
# The routines, by their places in the table: of accelerations, of the corrections of positions and
# of rates, of what corrections are made of, the errors of the closure equations and their rates,
# and of the wrenches in the joints, cut ones behind those of the tree.
(ACCELERATION_FORWARD, ACCELERATION_REVERSE, POSITION_FORWARD, POSITION_REVERSE, RATE_FORWARD,
 RATE_REVERSE, CLOSURE_FORWARD, WRENCH_FORWARD) = range(8)
NAMES = {
    ACCELERATION_FORWARD: 'acceleration_forward', ACCELERATION_REVERSE: 'acceleration_reverse',
    POSITION_FORWARD: 'position_forward', POSITION_REVERSE: 'position_reverse',
    RATE_FORWARD: 'rate_forward', RATE_REVERSE: 'rate_reverse',
    CLOSURE_FORWARD: 'closure_forward', WRENCH_FORWARD: 'wrench_forward'}
FORWARD = ACCELERATION_FORWARD, POSITION_FORWARD, RATE_FORWARD
REVERSE = ACCELERATION_REVERSE, POSITION_REVERSE, RATE_REVERSE
CLOSURE, WRENCH = (CLOSURE_FORWARD,), (WRENCH_FORWARD,)


class SensitivityTrace(DerivativeTrace):
    """
    A mechanism with its effects, as of ``SceneTrace``, traced for the derivatives of steps.

    ``entries``: parameters: arrays, such as BODY, and places in them; ``rows``: of the bodies that
    the joints carry, 0 for those without a wrench; ``cuts``: as for ``cut_wrench``, of the cut
    joints; ``with_arms``: whether to eliminate arms before multipliers where there are any.
    """

    def __init__(self, model, act, values, entries, rows, cuts, with_arms=False):
        """Set the inputs: coordinates, rates and parameters; torques are inputs as they are."""
        super().__init__(model, act, values, with_arms)
        self._given = model, act, values, entries, rows, cuts
        self._rows, self._cuts = rows, cuts
        state = [*self.q, *self.qd]
        self._inputs = [*state, *(self.graph.put(LOAD, *entry) for entry in entries)]
        # Where they are among all that may change.
        self._torque = len(state)
        behind = range(len(state) + self.nv, len(self._inputs) + self.nv)
        self._places = [*range(len(state)), *behind]

    def in_lanes(self, which):
        """
        Return one of the routines for LANES directions, or weights, side by side.

        Returns
        -------
        first : list of Routine
            ``before`` stores what all of them share, at a state; ``shared`` tells how many numbers
            these are, at q, and whether it fails next to singular arms, where that of a trace
            without arms does not.
        second : list of Routine
            ``beside``, to be written in lanes: of seeds at q to results at qd.

        """
        try:
            self._trace(which)
        except AlwaysSingularError:
            return self._without_arms().in_lanes(which)
        found, shared = divided(
            self.graph, [value for _, _, value in self.outputs], SEED, SHARED)
        self.outputs = [(SHARED, n, value) for n, value in enumerate(shared)]
        count = Routine('shared', ExpressionGraph(), [
            (Q, 0, float(len(shared))), (Q, 1, float(self.by_arms))])
        return [self.named('before'), count], [
            Routine('beside', graph_of(found), [(QD, n, value) for n, value in enumerate(found)])]

    def routine(self, which):
        """Return one of the routines; a trace serves for one."""
        try:
            found = self._trace(which)
        except AlwaysSingularError:
            return self._without_arms().routine(which)
        if self.by_arms:
            found.otherwise = self._without_arms().routine(which)
            found.otherwise.name += '_next_to_singular_arms'
        return found

    def _without_arms(self):
        return type(self)(*self._given)

    def _trace(self, which):
        """Return a routine that has no other one beside it."""
        what, way = NAMES[which].split('_')
        if what == 'closure':
            self.recursion.outward(self.model, self.q, self.qd, self.work)
            results = self._changes([*self._errors('value'), *self._errors('rate')])
        elif what == 'wrench':
            results = self._wrenches()
        else:
            results = self._of_solution(what, way)
        return self.returned(NAMES[which], results)

    def returned(self, name, results):
        """Return a routine that stores results in their order."""
        self.outputs = [(RESULT, place, value) for place, value in enumerate(results)]
        return self.named(name)

    def _of_solution(self, what, way):
        """Return the results of a routine of the solved accelerations and multipliers."""
        of = getattr(self, f'_{way}')
        if what == 'acceleration':
            # Those of the state are inputs, with the multipliers.
            residuals = self.residuals()
            self.prepare()
            return of(residuals, True)
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        held = 'value' if what == 'position' else 'rate'
        errors = self._errors(held)
        self.prepare()
        results = of(self.balance(
            self.symbols(_CORRECTION, (self.nv,)), self.symbols(_MULTIPLIER, (self.nc,)),
            [2 * ZERO for _ in self.constant.tree], zeros(self.nv), held), False)
        solution = self.solved([*zeros(self.nv), *errors])
        parts = {_CORRECTION: solution[:self.nv], _MULTIPLIER: solution[self.nv:]}
        return replayed(self.graph, results, lambda source, place: parts[source][
            place] if source in parts else self.graph.put(LOAD, source, place))

    def _wrenches(self):
        """Return the wrenches in joints, in world axes, and their changes."""
        own, wrenches, closed = self._balanced()
        found = self._in_world(wrenches, self.symbols(POINT, (len(self._rows), 3)))
        _, changes = self._changes_in_motion(found, [*own, *closed])
        return [*found, *changes]

    def _in_world(self, wrenches, origins):
        """Return the numbers of the wrenches in joints, at their origins, and in cut joints."""
        found = []
        for row, origin in zip(self._rows, origins):
            if row > 0:
                found += self._at(row, wrenches[row], origin)
        for cut in self._cuts:
            found += self._at(*self.cut_wrench(cut))
        return found

    def _changes_in_motion(self, values, residuals):
        """Return changes of accelerations and multipliers, and of values that follow from them."""
        self.prepare()
        solved = [*self.symbols(QDD, (self.nv,)), *self.symbols(LAM, (self.nc,))]
        changes = self._forward(residuals, True)
        return changes, self._changes(values, {
            one.place: change for one, change in zip(solved, changes)})

    def _at(self, row, wrench, point):
        """Return a wrench on a body about a point of it."""
        moment, force = wrench[:3], wrench[3:]
        lever = times(self.recursion.motion[row].frame, in_space(point))
        return [*subtract(moment, cross(lever, force)), *force]

    def _errors(self, held):
        """Return the errors of all closure equations, in the user's order."""
        found = zeros(self.nc)
        for a, cut in enumerate(self.constant.cut):
            for row, closure in enumerate(
                    self.recursion.closures(self.model, a), start=cut[CUT_ROW]):
                found[row] = getattr(closure, held)
        return found

    def _changes(self, values, more=()):
        """Return the changes of values in the direction that is an input, and by more symbols."""
        return differentiated(self.graph, values, {
            **{one.place: self.graph.put(LOAD, SEED, place)
               for one, place in zip(self._inputs, self._places)}, **dict(more)})

    def _forward(self, residuals, by_torque):
        column = self._changes(residuals)
        if by_torque:
            for joint in range(self.nv):
                column[joint] = column[joint] - self.graph.put(LOAD, SEED, self._torque + joint)
        return self.solved(column)

    def _reverse(self, residuals, by_torque):
        weights = -self.symbols(SEED, (self.nv,))
        adjoint = self.solved([*weights, *zeros(self.nc)])
        found = zeros(len(self._inputs) + self.nv)
        found[self._places] = gradients(
            self.graph, residuals, [*(0.0 - one for one in adjoint[:self.nv]),
                                    *adjoint[self.nv:]], self._inputs)
        if by_torque:
            found[self._torque:self._torque + self.nv] = adjoint[:self.nv]
        return found
