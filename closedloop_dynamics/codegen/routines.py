# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Traced routines: the evaluation of a state, and the correction of its drift."""

import hashlib
import math

import numpy as np

from . import (
    arms, cache, clusters, embedding, forward_dynamics, joint_forces, joint_space,
    plane, refinement, space)
from .expression_graph import (
    ADD, ARCTANGENT, CALL, DIVIDE, EXPONENTIAL, ExpressionGraph, graph_of, LOAD, LOGARITHM,
    MULTIPLY, NEGATE, POWER, Q, QD, Routine, SQUARE_ROOT, SUBTRACT, TooManyOperations)
from .function_table import (
    ACCELERATION, ADDED_FORCE, BAUMGARTE, BIAS, BODY, CLOSURE, CLOSURE_RATE, CORRECTION,
    CORRECTIONS, CUT_POINT, ENERGIES, EQUATIONS_OF_MOTION, EVALUATION, FACTORS, GRAVITY, HEALTH,
    INERTIA_MATRIX, JACOBIAN, JOINT_FORCE, JOINT_POINT, LAM, LAM_OF_ALL, LEAST_FORCES, LEFT_OUT,
    LOOP_EQUATIONS, MOTION, OUTWARD, QDD, REACTION, REACTIONS, REFINED_ACCELERATION,
    REFINED_CORRECTION, TAU, TORQUE_RESPONSE, WORK_BODY, WRENCH, WRENCHES)
from .linear_map import divided
from .machine_code import machine_code, PACKED
from .rows import by_column, columns_of, matrix, six
from .scheduling import longest_chain
from .vectors import add, in_space, times, transpose
from .workspace import zeros_like_workspace
from ..engine import native
from ..engine.types import (
    CARRIED, CUT_ROW, DOF, NO_RESPONSES, number_of_coordinates, PATH_A, PATH_END, ROW, ROWS,
    TYPE)

NAMES = {EVALUATION: 'evaluation', OUTWARD: 'outward', ACCELERATION: 'acceleration',
         CORRECTION: 'correction', REFINED_ACCELERATION: 'refined_acceleration',
         REFINED_CORRECTION: 'refined_correction', REACTIONS: 'reactions',
         WRENCHES: 'wrenches', LEAST_FORCES: 'least_forces',
         LOOP_EQUATIONS: 'loop_equations', LEFT_OUT: 'left_out', ENERGIES: 'energies',
         TORQUE_RESPONSE: 'torque_response', EQUATIONS_OF_MOTION: 'equations_of_motion',
         MOTION: 'motion'}


def topology(model):
    """
    Return the key of a mechanism's routines: its topology and structural numbers.

    Masses, lengths and gravity may change later.
    """
    spatial = space.is_spatial(model)
    structure = (space if spatial else plane).structure(model)
    tree = model.tree if spatial else model.tree[:, :TYPE + 1]
    arrays = (*structure, tree, model.cut, model.path_body, model.pair, model.block,
              model.column, model.row, model.entry, model.dependency, model.dependency_place)
    return tuple((array.shape, array.tobytes()) for array in arrays)


# Up to so many times as many operations are recorded in a trace as its routine needs.
RECORDED = 2
# Place of the mechanism's size behind Baumgarte's rate among the settings of a system.
_SIZE = 4
_addresses, sizes = {}, {}
# Operations and cycles of the longest chain by topology and method, of which the fastest is taken;
# methods by multipliers; rows of the tree up to which all are traced; arms up to which these are
# traced, too; methods that work on the equations of motion.
costs_by_method, BY_JOINTS, MOST_ROWS, FEW_ARMS = {}, (forward_dynamics, joint_space), 20, 2
IN_JOINTS = arms, clusters, joint_space
# Methods that may step aside.
BY_ARMS = arms, clusters


def addresses(model, which, form=PACKED, joints=None):
    """
    Return the addresses of a mechanism's routines, compiled unless they are stored.

    By places in the function table; ``form`` is that of ``machine_code``; ``joints`` are those of
    which least forces are found.
    """
    key = topology(model), form
    # Addresses of the routines of each mechanism that were requested so far.
    known = _addresses.setdefault(key, {})
    one_by_one = {one: (one, joint_forces.structure(model, joints)) if one == LEAST_FORCES else one
                  for one in which}
    missing = tuple(one for one in which if one_by_one[one] not in known)
    if missing:
        find = machine_code(
            (key, tuple(one_by_one[one] for one in missing)),
            lambda: [MechanismTrace(model, joints).routine(one) for one in missing], form,
            len(missing))
        known.update((one_by_one[one], find(NAMES[one])) for one in missing)
    return {one: known[one_by_one[one]] for one in which}


def with_torque_response(model, form=PACKED):
    """
    Return what the accelerations of a mechanism are, and what torques add to them.

    Returns
    -------
    dict
        By places in the function table: addresses of ACCELERATION, which keeps its factors, and of
        TORQUE_RESPONSE, from torques at q to accelerations and multipliers at qd; how many FACTORS
        are kept. Empty where arms are eliminated: next to singular ones they keep others.

    """
    key = 'torque response', topology(model), form
    if key not in _addresses:
        trace = MechanismTrace(model)
        found = _addresses[key] = {}
        if trace.method() is not arms:
            if trace.by_arms:
                trace = trace.without_arms()
            find = machine_code(key, trace.with_torque_response, form, 2)
            count = np.zeros(1)
            native.call(np.array([find('count')]), 0, count, count)
            found.update({one: find(NAMES[one]) for one in (ACCELERATION, TORQUE_RESPONSE)})
            found[FACTORS] = int(count[0])
    return _addresses[key]


def unrolled_size(model, most):
    """
    Return how many operations an evaluation is, as ``operations``; infinity where more than most.

    It is traced once, and kept on disk as code is; no more than ``most`` operations are recorded.
    """
    key = topology(model), most
    if key not in sizes:
        name = f'size.{hashlib.sha256(repr(key).encode()).hexdigest()[:32]}'
        stored = cache.read(name)
        if stored is None:
            try:
                stored = str(operations(model, RECORDED * most)).encode()
            except TooManyOperations:
                stored = b'inf'
            cache.write(name, stored)
        sizes[key] = float(stored)
    return sizes[key]


def operations(model, most=math.inf):
    """
    Count the operations of an evaluation, before anything is compiled.

    Additions, subtractions, multiplications, divisions and negations; ``most`` are recorded.
    """
    trace = MechanismTrace(model, most=most)
    method = trace.method()
    counted = costs_by_method.get(topology(model), {}).get(method)
    return count_operations(trace.traced(MOTION)) if counted is None else counted[0]


def count_operations(routine):
    """Return the same number of any routine; roots, functions and searches count as one each."""
    kinds = (ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATE, SQUARE_ROOT, EXPONENTIAL, LOGARITHM,
             ARCTANGENT, POWER, CALL)
    return sum(routine.graph.operations[place][0] in kinds for place in routine.needed())


def shorter(model, ways=BY_JOINTS):
    """
    Return the one of several modules by which an evaluation takes the least time.

    The first one of large mechanisms, where tracing takes long, and in the plane: the operations
    are as many, and articulated bodies leave exact zeros.
    """
    if len(ways) == 1 or len(model.tree) > MOST_ROWS or not space.is_spatial(model):
        return ways[0]
    costs = costs_by_method.setdefault(topology(model), {})
    for by in ways:
        if by not in costs:
            routine = MechanismTrace(model, with_arms=by in BY_ARMS, by=by).traced(MOTION)
            costs[by] = count_operations(routine), longest_chain(routine)
    # A cycle of the longest chain takes as long as another operation: measured.
    return min(ways, key=lambda by: sum(costs[by]))


class MechanismTrace:
    """
    One mechanism with symbols in the place of all numbers that may change.

    ``joints``: of which ``least_forces`` are found, and what is ``left_out``; ``with_arms``:
    whether accelerations are found by ``arms`` or ``clusters`` where there are any; ``most``:
    operations that may be recorded; ``by``: the module that finds accelerations, by default that
    of the fewest operations.
    """

    def __init__(self, model, joints=None, with_arms=True, most=math.inf, by=None):
        self.graph, self.joints = ExpressionGraph(most), joints
        self.nv, self.nc = len(model.tree) - 1, len(model.column) - 1
        self.constant = model
        self.model = model.replaced(
            body=self.symbols(BODY, model.body.shape),
            gravity=self.symbols(GRAVITY, model.gravity.shape),
            cut_point=self.cut_points())
        work = zeros_like_workspace(model)
        self.work = work.replaced(health=self.symbols(HEALTH, work.health.shape))
        self.q = self.symbols(Q, (number_of_coordinates(model),))
        self.qd = self.symbols(QD, (self.nv,))
        self.outputs, self.decays = [], True
        # What the arrays hold, of a mechanism in space or in the plane.
        self.arrays = space if space.is_spatial(model) else plane
        self.recursion = self.recursion_of(self.arrays.bodies(model, self.model.body))
        self.plan = arms.Plan.of(self.recursion, model) if with_arms else None
        self.with_arms = self.plan is not None
        self.clusters = clusters.clusters(self.recursion, model) if with_arms else None
        self.by = by

    def recursion_of(self, bodies):
        """Return the recursions of a mechanism of these bodies."""
        cuts, gravity = self.arrays.cuts(self.constant, self.model.cut_point), self.model.gravity
        return joint_space.JointSpace(
            bodies, cuts, (*gravity, *(3 - len(gravity)) * (0.0,)),
            space.hinges(self.constant, bodies, cuts) if self.arrays is space else ())

    def cut_points(self):
        """Return symbols for ``Model.cut_point``."""
        return self.symbols(CUT_POINT, self.constant.cut_point.shape)

    def symbols(self, source, shape):
        """Return an array of numbers to be read from an input."""
        array = np.empty(shape, dtype=object)
        for place in range(array.size):
            array.flat[place] = self.graph.put(LOAD, source, place)
        return array

    def store(self, source, values, first=0):
        """Add an array to an output, except entries that were read from there."""
        for place, value in enumerate(values.flat, start=first):
            if not (hasattr(value, 'place')
                    and self.graph.operations[value.place] == (LOAD, source, place)):
                self.outputs.append((source, place, value))

    def routine(self, which):
        """Return one of the routines; a trace serves for one."""
        found = self.traced(which)
        if self.by_arms:
            found.otherwise = self.without_arms().routine(which)
            found.otherwise.name = f'{NAMES[which]}_next_to_singular_arms'
        return found

    def traced(self, which):
        """Return the same as it is traced, without what does it otherwise."""
        self.by_arms = False
        if which in (EVALUATION, MOTION, ACCELERATION, CORRECTION) and (
                self.method() in IN_JOINTS):
            if self.by_arms and self.arrays is space and not self._has_few_arms():
                # Equal arms are to take equal operations.
                self.recursion = self.recursion_of(
                    space.bodies(self.constant, self.model.body, arms=True))
            self.recursion.hinges = ()
        try:
            getattr(self, NAMES[which])()
        except arms.AlwaysSingularError:
            self.by_arms = False
            return self.without_arms().traced(which)
        return Routine(NAMES[which], self.graph, self.outputs)

    def with_torque_response(self):
        """Return ACCELERATION, TORQUE_RESPONSE, and how many factors it has, at q."""
        acceleration, solution = self.routine(ACCELERATION), zeros(self.nv + self.nc)
        for source, place, value in acceleration.outputs:
            if source in (QDD, LAM):
                solution[place + (self.nv if source == LAM else 0)] = value
        found, factors = divided(self.graph, solution, TAU, FACTORS)
        acceleration.outputs += [(FACTORS, n, value) for n, value in enumerate(factors)]
        return [acceleration, Routine(NAMES[TORQUE_RESPONSE], graph_of(found), [
            (QD, n, value) for n, value in enumerate(found)]), Routine(
                'count', ExpressionGraph(), [(Q, 0, float(len(factors)))])]

    def without_arms(self):
        """Return a trace of the same with all multipliers."""
        return MechanismTrace(self.constant, self.joints, with_arms=False)

    def evaluation(self):
        """Accelerations and multipliers of a state where nothing but gravity and torques acts."""
        self.move()
        self.store_accelerations(*self.accelerate())
        self.store_closures()

    def motion(self):
        """Do so for a step: no multipliers, no closure errors, and none decays."""
        self.decays = False
        self.evaluation()
        self.outputs = [one for one in self.outputs if one[0] not in (LAM, CLOSURE, CLOSURE_RATE)]

    def move(self):
        """
        Run the outward recursion before accelerations, which in space add forces of motion then.

        In the plane their axes are the world's, too, and accelerations those of two parts.
        """
        method = self.method()
        self.recursion.apart = self.arrays is space and method in IN_JOINTS
        if self.recursion.apart and method is arms:
            self.recursion.free = self.plan.free(self.recursion)
        self.recursion.outward(self.model, self.q, self.qd, self.work)

    def outward(self):
        """Poses, velocities and inertial forces, to which effects add."""
        # They are given the axes of all joints.
        self.recursion.hinges = ()
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        self.write()

    def write(self):
        """
        Store motion and forces, in the plane inertias, too, in the rows of the bodies.

        Other columns stay as they are: loops over bodies read none that they have not written.
        """
        one, arrays, width = self.recursion, self.arrays, self.work.body.shape[1]
        for i, (motion, inertia, force) in enumerate(zip(one.motion, one.inertia, one.force)):
            columns = columns_of(motion, arrays.MOTION)
            if force is not None:
                columns.update(by_column(force, arrays.FORCES))
            if arrays is plane and inertia is not None:
                columns.update(by_column(inertia, arrays.INERTIAS))
            for place, value in columns.items():
                if arrays is plane or place < space.OFFSET:
                    self.outputs.append((WORK_BODY, i * width + place, value))

    def read(self):
        """Read the rows of ``write`` back, as effects have changed them."""
        one, arrays, body = self.recursion, self.arrays, self.symbols(
            WORK_BODY, self.work.body.shape)
        if arrays is space:
            # Less is read than is computed again.
            one.outward(self.model, self.q, self.qd, self.work)
            one.force = [None, *(six(row, arrays.FORCES) for row in body[1:])]
            return
        self.read_motion()
        one.inertia = [None, *(matrix(row, arrays.INERTIAS) for row in body[1:])]

    def read_motion(self):
        """Read kinematics and forces back from the rows of ``write``, without inertias."""
        one, arrays, body = self.recursion, self.arrays, self.symbols(
            WORK_BODY, self.work.body.shape)
        one.hinges = ()
        if arrays is space:
            one.outward(self.model, self.q, self.qd, self.work,
                        lambda i, motion: space.with_written(motion, body[i]))
        else:
            one.load_coordinates(self.model, self.q, self.qd)
            one.ground = one.ground._replace(
                acceleration=plane.motion_of(body[0], one.bodies[0], one.ground).acceleration)
            one.motion = [one.ground, *(arrays.motion_of(row, each, one.ground)
                                        for row, each in zip(body[1:], one.bodies[1:]))]
        one.force = [None, *(six(row, arrays.FORCES) for row in body[1:])]

    def acceleration(self, by=None):
        """Accelerations and multipliers after ``outward`` and the effects."""
        self.read()
        self.store_accelerations(*self.accelerate(by))
        self.store_closures()

    def refined_acceleration(self):
        """Accelerations with iterative refinement, joint by joint."""
        self.recursion.hinges = ()
        self.acceleration(refinement)

    def method(self):
        """Return the module whose ``accelerate`` is the cheapest."""
        if self.by is None:
            ways = (arms,) if self.with_arms else ()
            ways += () if self.clusters is None else (clusters,)
            if not self.with_arms or self._has_few_arms():
                ways += self._by_multipliers()
            self.by = shorter(self.constant, ways)
        plans = [one.plan for one in self.clusters if one.plan] if self.by is clusters else [
            self.plan] if self.by is arms else []
        self.by_arms = any(plan.steps_aside for plan in plans)
        return self.by

    def _has_few_arms(self):
        return self.with_arms and len(self.plan.steps) <= FEW_ARMS

    def embeds(self):
        """Return whether loops close on bodies: they are eliminated there."""
        return any(embedding.closing_bodies(self.recursion, self.constant))

    def _by_multipliers(self):
        """Return the modules that apply where multipliers are eliminated one after another."""
        if not self.embeds():
            return BY_JOINTS
        # Where loops have rotors only this one keeps the digits of small pivots.
        rotors = any(body.armature is not None for body in self.recursion.bodies[1:])
        return (embedding,) if rotors else (embedding, joint_space)

    def accelerate(self, by=None, tau=None):
        """
        Trace the forward dynamics.

        Parameters
        ----------
        by : module, optional
            The cheaper one by default.
        tau : ndarray, shape (nv,), optional
            Torques in the joints; an input where not said.

        Returns
        -------
        tuple of 2 ndarrays, shapes (nv,) and (nc,)
            Accelerations and multipliers, to be stored.

        """
        if by is None:
            by = self.method()
        baumgarte = self.symbols(BAUMGARTE, (1,))[0] if self.decays else 0.0
        qdd, lam = zeros(self.nv), zeros(self.nc)
        if tau is None:
            tau = self.symbols(TAU, (self.nv,))
        bool(by.accelerate(self.recursion, self.model, self.work, tau, baumgarte, qdd, lam))
        self.store(HEALTH, self.work.health)
        return qdd, lam

    def store_closures(self):
        """Add how far the loops are open, and how fast they open, to the outputs."""
        self.store(CLOSURE, self.work.closure)
        self.store(CLOSURE_RATE, self.work.closure_rate)

    def store_accelerations(self, qdd, lam):
        """Add accelerations and multipliers to the outputs."""
        self.store(QDD, qdd)
        self.store(LAM, lam)

    def response(self, tau):
        """Return the accelerations and multipliers that torques alone add, at this position."""
        recursion, work = self.at_rest()
        qdd, lam = zeros(self.nv), zeros(self.nc)
        bool(self.method().accelerate(
            recursion, self.model, work, tau, 0.0, qdd, lam))
        return qdd, lam

    def at_rest(self):
        """Return recursions and a workspace of the same position, at rest and without gravity."""
        recursion = joint_space.JointSpace(
            self.recursion.bodies, self.recursion.cuts, (0.0, 0.0, 0.0), self.recursion.hinges)
        recursion.apart, recursion.free = self.recursion.apart, self.recursion.free
        work = zeros_like_workspace(self.constant)
        recursion.outward(self.model, self.q, zeros(self.nv), work)
        return recursion, work

    def reactions(self):
        """Sum up the forces in the joints of the trees, after the accelerations."""
        self.recursion.hinges = ()
        self.read()
        found = joint_forces.wrenches(
            self, self.world_accelerations(), self.symbols(LAM, (self.nc,)),
            joint_forces.closures_of(self, False))
        self.store_wrenches(REACTION, found, first=3)

    def wrenches(self):
        """Sum up the whole wrenches, with the multipliers of all equations."""
        self.read_motion()
        closures = joint_forces.closures_of(self, True)
        lam = self.symbols(LAM if len(closures) == self.nc else LAM_OF_ALL, (len(closures),))
        found = joint_forces.wrenches(self, self.world_accelerations(), lam, closures)
        self.store_wrenches(WRENCH, found)

    def store_wrenches(self, source, found, first=0):
        """Add wrenches in the joints to an output, or their components from one on."""
        width = 2 * len(self.arrays.FORCES)
        for i, wrench in enumerate(found):
            for place, component in enumerate(self.arrays.FORCES):
                if i > 0 and component >= first:
                    self.outputs.append((source, i * width + place, wrench[component]))

    def world_accelerations(self):
        """Return the accelerations, those of spherical joints about the world's axes."""
        qdd = self.symbols(QDD, (self.nv,))
        for frame, turns in self.recursion.balls(self.constant):
            qdd[turns] = times(frame, qdd[turns])
        return qdd

    def least_forces(self):
        """Find the multipliers of all equations, after the accelerations."""
        self.read_motion()
        found = joint_forces.least_forces(
            self, self.world_accelerations(), self.symbols(LAM, (self.nc,)))
        self.outputs += [(LAM_OF_ALL, n, value) for n, value in enumerate(found)]

    def left_out(self):
        """Note whether accelerations fulfil the equations that are left out."""
        self.recursion.hinges = ()
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        joint_forces.require_left_out(self, self.world_accelerations())

    def loop_equations(self):
        """Closure errors, velocity terms dJ/dt qd and Jacobian J, in the user's order."""
        model, work, one = self.model, self.work, self.recursion
        one.hinges = ()
        one.outward(model, self.q, self.qd, work)
        one.update(model, work, CARRIED)
        closure, bias, jac = zeros(self.nc), zeros(self.nc), zeros(self.nc, self.nv)
        for cut in model.cut:
            for k in range(cut[ROWS]):
                place, row = cut[CUT_ROW] + k, jac[cut[CUT_ROW] + k]
                closure[place], bias[place] = work.closure[cut[ROW] + k], work.bias[cut[ROW] + k]
                for entry in range(cut[PATH_A], cut[PATH_END]):
                    row[model.tree[model.path_body[entry], DOF]] = work.response[entry, k]
                for frame, turns in one.balls(model):
                    row[turns] = times(transpose(frame), row[turns])
        for source, values in ((CLOSURE, closure), (BIAS, bias), (JACOBIAN, jac)):
            self.store(source, values)

    def equations_of_motion(self):
        """Inertia matrix of the trees, and what of the forces in joints accelerates them."""
        one, model, columns = self.recursion, self.model, self.arrays.FORCES
        one.hinges, one.apart = (), self.arrays is space
        one.outward(model, self.q, self.qd, self.work)
        places = {component: n for n, component in enumerate(columns)}
        one.force[1:] = [add(force, six(row, places)) for force, row in zip(
            one.force[1:], self.symbols(ADDED_FORCE, (self.nv + 1, len(columns)))[1:])]
        matrix, right = one.equations_of_motion(
            self.constant, one.about_world(self.constant, self.symbols(TAU, (self.nv,))))
        gim, force, dofs = zeros(self.nv, self.nv), zeros(self.nv), model.tree[:, DOF].tolist()
        for (i, k), entry in matrix.items():
            gim[dofs[i], dofs[k]] = gim[dofs[k], dofs[i]] = entry
        for i, value in right.items():
            force[dofs[i]] = value
        for each in (*gim, *gim.T, force):
            one.about_own(self.constant, each)
        self.store(INERTIA_MATRIX, gim)
        self.store(JOINT_FORCE, force)

    @property
    def size(self):
        """Size of the mechanism [m]."""
        return self.graph.put(LOAD, BAUMGARTE, _SIZE)

    def joint_point(self, n):
        """Return a joint's point in the frame of a body's row."""
        point = self.joints.point[n]
        return in_space(tuple(
            self.graph.put(LOAD, JOINT_POINT, n * len(point) + k) if value != 0.0 else 0.0
            for k, value in enumerate(point)))

    def refined_correction(self):
        """Corrections with iterative refinement, for links much lighter than others."""
        self.recursion.hinges = ()
        self.correction(refinement)

    def correction(self, by=None):
        """Least changes of coordinates and of rates that close the loops, one after the other."""
        model, work, by = self.model, self.work, by or self.method()
        if by in IN_JOINTS:
            self.move()
        else:
            self.recursion.outward(model, self.q, self.qd, work)
            by = embedding if by is not refinement and self.embeds() else by
        self.recursion.update(model, work, NO_RESPONSES)
        for n, error in enumerate((work.closure, work.closure_rate)):
            (recursion, other), out = self.at_rest(), zeros(self.nv)
            # The pivots are the same for both.
            bool(by.correct(recursion, model, other.replaced(
                health=work.health if n == 0 else other.health), error, out))
            self.store(CORRECTIONS, out, n * self.nv)
        self.store(CLOSURE, work.closure)
        self.store(CLOSURE_RATE, work.closure_rate)
        self.store(HEALTH, work.health)


def zeros(*shape):
    """Return an array of zeros that may hold symbols."""
    return np.full(shape, 0.0, dtype=object)
