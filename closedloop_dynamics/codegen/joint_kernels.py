# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Kernels for one body, or one cut joint, of each kind, called by the loops over a mechanism.

A kernel is one pass of the recursions (``spatial``) for one body, of which rows of
``Workspace.body`` give the kinematics. Bodies of one kind (joint type, structure of the constants,
whether the parent is the ground) share it, whatever their number, their masses and their lengths.
"""

import numpy as np

from . import coupling_law, plane, space
from .expression_graph import ExpressionGraph, LOAD, Routine
from .machine_code import KERNEL, machine_code
from .rows import by_column, columns_of, matrix, six
from .spatial import at_parent, Body, Recursion, rigid, shifted, Z
from .vectors import add, cross, dot, is_zero, times, ZERO
from ..engine.types import (
    ACCELERATE, AXIS, BODY_KERNELS, CARRY, COMPOSE, COUPLED_WORK_COLUMNS, CUT_TYPE, DINV, DZ,
    ELIMINATE, ELIMINATE_MASSLESS, KEPT, LEVER, MEASURE, MOVE, NEWTON, PARENT, PATH_A, PATH_END,
    POSITION, POSSIBLE, PRESCRIBED_PLACE, RATE, READ, REDUCE, REDUCE_COUPLED, RHS, SHIFT, TORQUE,
    TYPE)

# Rows that a kernel reads and writes: constants, the body, its parent (or body B of a cut joint),
# and two more.
CONSTANT, OWN, OTHER, FIRST, SECOND = range(5)
# Bodies of a recursion of one body: the ground, the parent, the body itself.
_PARENT, _BODY = 1, 2
NO_JOINT = Body(0.0, 0.0, Z, False, None, None, 0.0, None, None, None, None)


def arrays_of(model):
    """Return the module that describes the arrays of a model: ``plane`` or ``space``."""
    return space if space.is_spatial(model) else plane


def connect(model):
    """Give a model, and those that share its bodies, the addresses of their kernels."""
    arrays = arrays_of(model)
    structures = space.structure(model) if arrays is space else (None, None)
    for structure, first, out, make in zip(
            structures, (1, 0), (model.kernel, model.cut_kernel), (_Body, _Cut)):
        for row in range(first, len(out)):
            kind = make.kind(model, row), b'' if structure is None else structure[row].tobytes()
            out[row] = _addresses(arrays, make, kind, model, row)


def structure(model):
    """
    Return the data that the kernels depend on: while it is the same, nothing is linked.

    Effects change masses, rotors and joint types of a model.
    """
    found = space.kinds_of_bodies(model) if space.is_spatial(model) else (
        plane.zeros_of_bodies(model),)
    return b''.join(array.tobytes() for array in (model.tree, *found))


_known = {}


def _addresses(arrays, make, kind, model, row):
    """Return the addresses of the kernels of a kind, given the row of one such body."""
    key = arrays.__name__.rpartition('.')[2], make.__name__, kind
    if key not in _known:
        find = machine_code(key, lambda: make(arrays, model, row).kernels(), KERNEL)
        _known[key] = [find(name) for name in make.NAMES]
    return _known[key]


class _Tracer:
    """Inputs and outputs of one kernel while it is traced."""

    def __init__(self, arrays, constants):
        self.graph, self.arrays, self.outputs = ExpressionGraph(), arrays, []
        columns = space.WORK_COLUMNS if arrays is space else COUPLED_WORK_COLUMNS
        self.constant = self.row(CONSTANT, constants)
        self.own, self.other = self.row(OWN, columns), self.row(OTHER, columns)

    def row(self, source, size):
        found = np.empty(size, dtype=object)
        found[:] = [self.graph.put(LOAD, source, place) for place in range(size)]
        return found

    def store(self, source, by_place):
        self.outputs += [(source, place, value) for place, value in by_place.items()]

    def routine(self, name):
        return Routine(name, self.graph, self.outputs)


class _Body:
    """The kernels of one kind of body, as a row of a model is, in ``plane`` or ``space``."""

    NAMES = tuple(f'kernel_{n}' for n in range(BODY_KERNELS))

    def __init__(self, arrays, model, row):
        self.arrays, self.on_ground = arrays, model.tree[row, PARENT] == 0
        self.model = model.replaced(tree=model.tree[[0, row]], body=model.body[[0, row]])
        if arrays is plane:
            self.model = plane.without_zeros(self.model)
        self.model.tree[1, PARENT] = 0

    @staticmethod
    def kind(model, row):
        """Return the key of the code, beside the structure of the constants."""
        tree = model.tree[row]
        return int(tree[TYPE]), int(tree[AXIS]), bool(tree[PARENT] == 0)

    def kernels(self):
        """Return the kernels, in the order of their entries in the table."""
        return [self._kernel(name, trace) for name, trace in zip(self.NAMES, self._traces())]

    def _traces(self):
        traces = {
            MOVE: self.move, ELIMINATE: self.eliminate,
            ELIMINATE_MASSLESS: lambda tracer, recursion: self.eliminate(tracer, recursion, True),
            ACCELERATE: self.accelerate, REDUCE: self.reduce,
            LEVER: lambda tracer, recursion: self.carry(tracer, recursion, self.arrays is plane),
            CARRY: self.carry, COMPOSE: self.compose, MEASURE: self.measure,
            NEWTON: self.newton, SHIFT: self.shift, TORQUE: self.torque,
            REDUCE_COUPLED: lambda tracer, recursion: self.reduce(tracer, recursion, True)}
        return [traces[trace] for trace in range(BODY_KERNELS)]

    def _kernel(self, name, trace):
        arrays = self.arrays
        tracer = _Tracer(arrays, self.model.body.shape[1])
        constants = np.stack([tracer.constant, tracer.constant])
        body = arrays.bodies(self.model, constants)[1]
        gravity = 3 * (0.0,)
        recursion = Recursion([body, body, body], [], gravity)
        parent = recursion.ground
        if self.on_ground:
            parent = arrays.motion_of(tracer.other, body, parent)
            parent = recursion.ground._replace(acceleration=parent.acceleration)
        else:
            parent = arrays.motion_of(tracer.other, body, parent)
        recursion.motion = [recursion.ground, parent,
                            arrays.motion_of(tracer.own, body, recursion.ground)]
        recursion.inertia = [None, matrix(tracer.other, arrays.INERTIAS),
                             matrix(tracer.own, arrays.INERTIAS)]
        recursion.force = [None, six(tracer.other, arrays.FORCES), six(tracer.own, arrays.FORCES)]
        if not is_zero(body.rotor):
            recursion.rotor[_BODY] = tuple(tracer.own[space.WORK_ROTOR:space.WORK_ROTOR + 3])
        trace(tracer, recursion)
        return tracer.routine(name)

    def move(self, tracer, recursion):
        """Compute motion, inertia and force of the rigid body, of q and qd."""
        body = recursion.bodies[_BODY]
        first, second = tracer.row(FIRST, 4), [
            tracer.graph.put(LOAD, SECOND, place) for place in (-2, -1, 0)]
        recursion.motion[_BODY] = motion = (
            recursion.spherical_kinematics(_BODY, _PARENT, first, second) if body.ball
            else recursion.joint_kinematics(_BODY, _PARENT, first[0], second[2]))
        inertia, force = rigid(body, motion)
        tracer.store(OWN, {**columns_of(motion, self.arrays.MOTION),
                           **by_column(inertia, self.arrays.INERTIAS),
                           **by_column(force, self.arrays.FORCES)})
        if self.arrays is space:
            tracer.store(OWN, {space.JOINT_POSITION: first[0], space.JOINT_RATE: second[2]})
        elif self.model.tree[1, READ]:
            tracer.store(OWN, {POSITION: first[0], RATE: second[2]})
        if not is_zero(body.rotor):
            parent = recursion.motion[_PARENT]
            rotor = times(parent.frame, body.rotor)
            turning = tuple(x * second[2] for x in cross(parent.spin, rotor))
            recursion.force[_PARENT] = add(recursion.force[_PARENT], turning + ZERO)
            tracer.store(OWN, {
                space.ROTOR_BIAS: dot(rotor, parent.spin_rate),
                **dict(enumerate(rotor, start=space.WORK_ROTOR))})
            if not self.on_ground:
                tracer.store(OTHER, by_column(recursion.force[_PARENT], self.arrays.FORCES))

    def eliminate(self, tracer, recursion, massless=False):
        """Compute the joint's factors, and the force and inertia passed to the parent, of tau."""
        torque = tracer.row(FIRST, 1)[0]
        inverse, right = recursion.eliminate(
            _BODY, 0 if self.on_ground else _PARENT, torque, massless)
        share, _ = recursion.factors[_BODY]
        tracer.store(OWN, {DINV: inverse, RHS: right, **by_column(share, self.arrays.SHARES)})
        if not self.on_ground:
            self._add_to_parent(tracer, recursion)

    def _add_to_parent(self, tracer, recursion):
        tracer.store(OTHER, {**by_column(recursion.inertia[_PARENT], self.arrays.INERTIAS),
                             **by_column(recursion.force[_PARENT], self.arrays.FORCES)})

    def _factored(self, tracer, recursion):
        recursion.factors[_BODY] = six(tracer.own, self.arrays.SHARES), recursion.alone(_BODY)

    def accelerate(self, tracer, recursion):
        """Compute accelerations; qdd is written."""
        self._factored(tracer, recursion)
        recursion.acceleration = {_PARENT: self._change_of_parent(tracer)}
        qdd = recursion.accelerate(_BODY, _PARENT, tracer.own[DINV], tracer.own[RHS])
        tracer.store(FIRST, {0: qdd})
        changes = by_column(recursion.acceleration[_BODY], self.arrays.CHANGES)
        tracer.store(OWN, {DZ: qdd, **changes})

    def _change_of_parent(self, tracer):
        return 6 * (0.0,) if self.on_ground else six(tracer.other, self.arrays.CHANGES)

    def _wrench(self, tracer, source):
        """Return a wrench in a row of its own."""
        return six(tracer.row(source, len(self.arrays.FORCES)), self._packed)

    @property
    def _packed(self):
        return {at: n for n, at in enumerate(self.arrays.FORCES)}

    def reduce(self, tracer, recursion, coupled=False):
        """Transmit a wrench through the articulated joint to the parent; store joint forces."""
        self._factored(tracer, recursion)
        own = tracer.row(SECOND, 1)[0] if coupled else 0.0
        force, scaled, wrench = recursion.transmit_articulated_wrench(
            _BODY, tracer.own[DINV], self._wrench(tracer, FIRST), own)
        tracer.store(FIRST, by_column(wrench, self._packed))
        tracer.store(SECOND, {0: force, 1: scaled})

    def carry(self, tracer, recursion, beyond=False):
        """Transmit a wrench to the parent; store its joint force."""
        beyond = beyond and bool(recursion.bodies[_BODY].turns)
        force, wrench = recursion.transmit_wrench(_BODY, self._wrench(tracer, FIRST), beyond)
        tracer.store(FIRST, by_column(wrench, self._packed))
        tracer.store(SECOND, {0: force, 1: 0.0})

    def compose(self, tracer, recursion):
        """
        Compute the composite body's wrench for a unit acceleration, and its share in the joint.

        The wrench, like the inertia, goes to the parent.
        """
        body, inertia = recursion.bodies[_BODY], recursion.inertia[_BODY]
        share, wrench = recursion.transmit_wrench(
            _BODY, times(inertia, recursion.motion[_BODY].axis))
        tracer.store(SECOND, {0: share + (0.0 if body.armature is None else body.armature)})
        tracer.store(FIRST, by_column(add(wrench, recursion.rotor[_BODY] + ZERO), self._packed))
        if not self.on_ground:
            left = shifted(inertia, recursion.motion[_BODY].offset)
            recursion.inertia[_PARENT] = tuple(map(add, recursion.inertia[_PARENT], left))
            tracer.store(OTHER, by_column(recursion.inertia[_PARENT], self.arrays.INERTIAS))

    def measure(self, tracer, recursion):
        """Compute twice the kinetic energy, and the first moments in the world, of qd."""
        body, motion = recursion.bodies[_BODY], recursion.motion[_BODY]
        inertia, _ = rigid(body, motion)
        rates = motion.spin + motion.velocity
        energy = dot(rates, times(inertia, rates))
        rate = tracer.row(SECOND, 1)[0]
        if body.armature is not None:
            energy = energy + body.armature * rate * rate
        if not is_zero(body.rotor):
            # Not as ``move`` left it: unrolled routines do not.
            parent = recursion.motion[_PARENT]
            energy = energy + 2.0 * rate * dot(times(parent.frame, body.rotor), parent.spin)
        moment = tuple(body.mass * x for x in motion.origin)
        moment = add(moment, times(motion.frame, body.moment))
        tracer.store(FIRST, {0: energy, **{1 + n: x for n, x in enumerate(moment)}})

    def newton(self, tracer, recursion):
        """
        Compute accelerations of given qdd, and the force that they take beside the bias force.

        Rows of wrenches, then accelerations, in the place of those of the workspace.
        """
        size, motion = len(self.arrays.FORCES), recursion.motion[_BODY]
        other, first = tracer.row(OTHER, 2 * size), tracer.row(FIRST, 2 * size)
        before = 6 * (0.0,) if self.on_ground else six(other[size:], self._packed)
        qdd = tracer.row(SECOND, 1)[0]
        after = recursion.propagate_acceleration(_BODY, before, qdd)
        inertia, _ = rigid(recursion.bodies[_BODY], motion)
        force = add(six(first, self._packed), times(inertia, after))
        tracer.store(FIRST, {
            **by_column(force, self._packed),
            **{size + n: x for n, x in by_column(after, self._packed).items()}})
        # What the rotors take in the joint, and of their carrier.
        armature, rotor = recursion.bodies[_BODY].armature, recursion.rotor[_BODY]
        taken = 0.0 if armature is None else armature * qdd
        if not is_zero(rotor):
            taken = taken + tracer.own[space.ROTOR_BIAS] + dot(rotor, before[:3])
            tracer.store(OTHER, by_column(
                add(six(other, self._packed), tuple(x * qdd for x in rotor) + ZERO), self._packed))
        tracer.store(OWN, {RHS: taken})

    def shift(self, tracer, recursion):
        """Add a row of wrenches to the parent's."""
        total = add(self._wrench(tracer, OTHER),
                    at_parent(self._wrench(tracer, FIRST), recursion.motion[_BODY].offset))
        tracer.store(OTHER, by_column(total, self._packed))

    def torque(self, tracer, recursion):
        """Project a wrench on the joint's axes and add the rotors' torque, after ``newton``."""
        torque = dot(recursion.motion[_BODY].axis, self._wrench(tracer, FIRST))
        tracer.store(SECOND, {0: torque + tracer.own[RHS]})


class _Cut:
    """The kernels of one kind of cut joint; as for ``_Body``."""

    NAMES = ('equations', 'wrench')

    def __init__(self, arrays, model, row):
        self.arrays, cut = arrays, model.cut[[row]]
        # Which of them are kept is the engine's matter, and may change in a run.
        cut[:, KEPT] = cut[:, POSSIBLE]
        self.model = model.replaced(cut=cut, cut_point=model.cut_point[[row]])
        if arrays is plane:
            self.model = plane.without_zeros(self.model)

    @staticmethod
    def kind(model, row):
        """Return the key of the code, beside the structure of the constants."""
        # Right-hand sides of prescribed motions are the last columns, wherever these are.
        width = [model.cut_point.shape[1]] if model.cut[row, CUT_TYPE] >= PRESCRIBED_PLACE else []
        law = coupling_law.structure(model.replaced(
            cut=model.cut[[row]], cut_point=model.cut_point[[row]]))
        return (*model.cut[row, [CUT_TYPE, POSSIBLE]].tolist(), *width,
                space.is_spatial(model) and space.is_carried(model, model.cut[row]),
                *(int(model.cut[row, PATH_END] - model.cut[row, PATH_A]) for _ in law),
                *(each.tobytes() for each in law))

    def kernels(self):
        """Return the kernels, in the order of their entries in the table."""
        return [self._kernel(name, trace)
                for name, trace in zip(self.NAMES, (self.equations, self.wrench))]

    def _kernel(self, name, trace):
        arrays = self.arrays
        tracer = _Tracer(arrays, self.model.cut_point.shape[1])
        cut, = arrays.cuts(self.model, tracer.constant[np.newaxis])
        recursion = Recursion([], [], 3 * (0.0,))
        recursion.motion = [arrays.motion_of(row, NO_JOINT, recursion.ground)
                            for row in (tracer.own, tracer.other)]
        # Couplings of joints do not depend on the bodies' motion: ``loop_closure`` has them.
        closures = [] if cut.coupling is not None and not cut.between else cut.left(
            cut.equations(*recursion.motion))
        trace(tracer, recursion, cut, closures)
        return tracer.routine(name)

    def equations(self, tracer, recursion, cut, closures):
        """Compute value, rate, bias of each equation, and the wrenches of a unit multiplier."""
        place = 0
        if cut.law is not None:
            # Its part of the sum, of the joint of body A, and its slope.
            position, rate = tracer.own[
                [space.JOINT_POSITION, space.JOINT_RATE] if self.arrays is space else
                [POSITION, RATE]]
            value, slope, curvature = cut.law[1](position)
            found = value, slope * rate, curvature * rate * rate, slope
            tracer.store(FIRST, {n: 0.0 - one for n, one in enumerate(found)})
        for closure in closures:
            values = [closure.value, closure.rate, closure.bias, *(
                wrench[n] for wrench in (closure.on_a, closure.on_b)
                for n in self.arrays.FORCES)]
            tracer.store(FIRST, dict(enumerate(values, start=place)))
            place += len(values)

    def wrench(self, tracer, recursion, cut, closures):
        """Compute wrenches of multipliers: at the cut point of A, at the origins of A and of B."""
        lam = tracer.row(FIRST, len(closures))
        on_a, on_b = 6 * (0.0,), 6 * (0.0,)
        for value, closure in zip(lam, closures):
            on_a = add(on_a, tuple(x * value for x in closure.on_a))
            on_b = add(on_b, tuple(x * value for x in closure.on_b))
        lever = times(recursion.motion[0].frame, cut.point_a)
        at_cut = at_parent(on_a, tuple(0.0 - x for x in lever))
        values = [wrench[n] for wrench in (at_cut, on_a, on_b) for n in self.arrays.FORCES]
        tracer.store(SECOND, dict(enumerate(values)))
