# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The engine on one mechanism in space."""

import ctypes

from closedloop_dynamics.codegen import (
    expression_graph as graph, function_table as calls, routines, space)
from closedloop_dynamics.codegen.emit import Q, QD
from closedloop_dynamics.codegen.spatial import Recursion, Z
from closedloop_dynamics.engine import types as t
from closedloop_dynamics.kinematics.modeling import mechanism_arrays
from closedloop_dynamics.mechanism.mechanism import JOINT_FREEDOMS
from closedloop_dynamics.simulation.system import build_system
import numpy as np

from ..reference import spatial_maximal as twin
from ..reference.spatial_machines import GRAVITY

_ARITHMETIC = {
    graph.ADD: lambda a, b: a + b, graph.SUBTRACT: lambda a, b: a - b,
    graph.MULTIPLY: lambda a, b: a * b, graph.DIVIDE: np.divide,
    graph.NEGATE: lambda a: -a, graph.SINE: np.sin, graph.COSINE: np.cos,
    graph.LESS: lambda a, b: a < b, graph.GREATER_EQUAL: lambda a, b: a >= b,
    graph.CHOOSE: lambda condition, yes, no: yes if condition else no,
    graph.BOTH: lambda a, b: a and b}


def interpret(routine, inputs):
    """
    Run unrolled arithmetic number by number, where compiling it would take longer.

    Parameters
    ----------
    routine : graph.Routine
        What is computed.
    inputs : dict of int to ndarray
        By input.

    Returns
    -------
    outputs : dict of int to dict of int to float
    good : bool

    """
    values, needed = {}, routine.needed()

    def value(operand):
        return values[operand] if isinstance(operand, int) else operand

    # What is chosen among may be infinite, as in compiled code.
    with np.errstate(all='ignore'):
        for place, (kind, *operands) in enumerate(routine.graph.operations):
            if place in needed:
                values[place] = (
                    inputs[operands[0]].flat[operands[1]] if kind == graph.LOAD
                    else _ARITHMETIC[kind](*map(value, operands)))
    outputs = {}
    for source, place, result in routine.outputs:
        known = values[result.place] if hasattr(result, 'place') else float(result)
        outputs.setdefault(source, {})[place] = known
    guard = routine.graph.guard
    return outputs, guard is None or bool(values[guard.place])


def _inputs(model, q, qd, tau):
    """Return what routines read."""
    return {calls.BODY: model.body, calls.GRAVITY: model.gravity,
            calls.CUT_POINT: model.cut_point, calls.TAU: tau, calls.BAUMGARTE: np.zeros(1),
            calls.HEALTH: np.ones(t.HEALTH_COLUMNS), Q: q, QD: qd}


def _array(outputs, source, size):
    """Return one of the outputs, zero where nothing was stored."""
    return np.array([outputs.get(source, {}).get(place, 0.0) for place in range(size)])


def forces_on_bodies(model):
    """Return forces on the rows of a tree; within spherical joints methods turn by other axes."""
    within = (model.tree[:, t.TYPE] == t.BALL) & (model.tree[:, t.AXIS] != Z)
    return np.where(within[:, np.newaxis], 0.0, np.linspace(-0.7, 0.8, 6))


def inputs_with_forces(model, q, qd, tau):
    """Return inputs with forces of effects on the bodies."""
    inputs = _inputs(model, q, qd, tau)
    outputs, _ = interpret(routines.MechanismTrace(model).routine(calls.OUTWARD), inputs)
    body = _array(outputs, calls.WORK_BODY, len(model.tree) * space.WORK_COLUMNS).reshape(
        -1, space.WORK_COLUMNS)
    body[:, list(space.FORCES.values())] += forces_on_bodies(model)
    return {**inputs, calls.WORK_BODY: body.ravel()}


def loop_equations(model, q, qd):
    """Return closure errors, biases and Jacobian of a model's routine, interpreted."""
    nv, nc = len(model.tree) - 1, len(model.column) - 1
    outputs, _ = interpret(routines.MechanismTrace(model).routine(calls.LOOP_EQUATIONS),
                           _inputs(model, q, qd, np.zeros(nv)))
    return (_array(outputs, calls.CLOSURE, nc), _array(outputs, calls.BIAS, nc),
            _array(outputs, calls.JACOBIAN, nc * nv).reshape(nc, nv))


def motion_with_forces(model, q, qd, tau):
    """
    Return the equations of motion with forces on the bodies, and what accelerations go with these.

    Returns
    -------
    matrix, right, qdd, lam : ndarray
        Inertia matrix, joint forces less those of the motion, accelerations and multipliers.

    """
    nv, nc, trace = len(model.tree) - 1, len(model.column) - 1, routines.MechanismTrace
    inputs = inputs_with_forces(model, q, qd, tau)
    inputs[calls.ADDED_FORCE] = forces_on_bodies(model)
    moved, _ = interpret(trace(model).routine(calls.ACCELERATION), inputs)
    found, _ = interpret(trace(model).routine(calls.EQUATIONS_OF_MOTION), inputs)
    return (_array(found, calls.INERTIA_MATRIX, nv * nv).reshape(nv, nv),
            _array(found, calls.JOINT_FORCE, nv), _array(moved, calls.QDD, nv),
            _array(moved, calls.LAM, nc))


class SpatialEngine:
    """
    A model in space and its unrolled evaluation.

    Parameters
    ----------
    mechanism : Mechanism
    compiled : bool
        Whether to compile the routines or to interpret them.

    """

    def __init__(self, mechanism, compiled=False):
        self.mechanism = mechanism
        self.model, self.placements, self.rows = mechanism_arrays(mechanism, GRAVITY)
        self.nv, self.nc = len(self.model.tree) - 1, len(self.model.column) - 1
        self.system = build_system(self.model, unrolled=True) if compiled else None

    def at_zero(self):
        """Return coordinates of all joints at the start of a description."""
        q = np.zeros(t.number_of_coordinates(self.model))
        for row in self.model.tree[1:]:
            if row[t.TYPE] == t.BALL:
                q[row[t.COORDINATE] + 3] = 1.0
        return q

    def efforts(self, by_joint):
        """Return joint forces by joint name as an array; others are 0."""
        tau, first = np.zeros(self.nv), 0
        for joint in self.mechanism.joints:
            if joint.name in by_joint:
                tau[first] = by_joint[joint.name]
            first += JOINT_FREEDOMS[joint.type]
        return tau

    def forward_dynamics(self, q, qd, tau):
        """Return (qdd, lam, whether every pivot was good)."""
        if self.system is not None:
            system = self.system
            system.tau[:] = tau
            evaluation = ctypes.CFUNCTYPE(ctypes.c_int64, *3 * [ctypes.c_void_p])(
                int(system.table[calls.EVALUATION]))
            good = evaluation(system.table.ctypes.data, q.ctypes.data, qd.ctypes.data)
            return system.qdd.copy(), system.lam.copy(), bool(good)
        return self.interpreted(routines.MechanismTrace(self.model), self.model, q, qd, tau)

    @staticmethod
    def interpreted(unrolling, model, q, qd, tau):
        """Return the same of any model, its unrolled arithmetic interpreted."""
        outputs, good = interpret(
            unrolling.routine(calls.EVALUATION), _inputs(model, q, qd, tau))
        return (_array(outputs, calls.QDD, len(model.tree) - 1),
                _array(outputs, calls.LAM, len(model.column) - 1), good)

    def in_parts(self, which, q, qd, tau):
        """Return (qdd, good) of the outward recursion and a routine that goes on from there."""
        inputs = _inputs(self.model, q, qd, tau)
        outputs, _ = interpret(routines.MechanismTrace(self.model).routine(calls.OUTWARD), inputs)
        inputs[calls.WORK_BODY] = _array(
            outputs, calls.WORK_BODY, len(self.model.tree) * space.WORK_COLUMNS)
        outputs, good = interpret(routines.MechanismTrace(self.model).routine(which), inputs)
        return _array(outputs, calls.QDD, self.nv), good

    def corrections(self, which, q, qd):
        """Return least changes of coordinates and of rates that close the loops, (2, nv)."""
        outputs, _ = interpret(routines.MechanismTrace(self.model).routine(which),
                               _inputs(self.model, q, qd, np.zeros(self.nv)))
        return _array(outputs, calls.CORRECTIONS, 2 * self.nv).reshape(2, -1)

    def wrenches(self, q, qd, lam):
        """Return {cut joint: (6,)} on body A at its cut point, moment first, in world axes."""
        recursion = Recursion(
            space.bodies(self.model, self.model.body.astype(object)),
            space.cuts(self.model, self.model.cut_point.astype(object)), GRAVITY)
        recursion.outward(self.model, q, qd, None)
        found = {}
        for a, cut in enumerate(self.model.cut):
            if cut[t.CUT_NUMBER] >= len(self.mechanism.cut_joints):
                continue
            wrench = sum((value * np.array(one.on_a, dtype=float) for value, one in zip(
                lam[cut[t.CUT_ROW]:], recursion.closures(self.model, a))), np.zeros(6))
            motion = recursion.motion[cut[t.BODY_A]]
            arm = np.array(motion.frame, dtype=float) @ self.model.cut_point[a, :3]
            wrench[:3] -= np.cross(arm, wrench[3:])
            found[self.mechanism.cut_joints[cut[t.CUT_NUMBER]].name] = wrench
        return found

    def accelerations(self, q, qd, qdd):
        """Return {body: (6,)} of the bodies' own frames."""
        return twin.forward(self.mechanism, q, qd, qdd)[1]
