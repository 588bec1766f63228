# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Forces in the joints after an evaluation, traced.

Where closure equations repeat others, forces are not unique: those are chosen that are least in
all joints together, as ``engine/least_forces.hpp`` says. There equations are separated by
pivoting; here those that the elimination works on are taken in their order, and the results count
where none of them depends on those before it.
"""

import numpy as np

from . import space
from .expression_graph import hold_nowhere, square_root
from .spatial import at_parent, rigid
from .vectors import add, cross, dot, is_zero, scale, subtract, times, ZERO
from ..engine.types import (
    BODY_A, BODY_B, CUT_NUMBER, DOF, JOINT_X, KEPT, PARENT, PATH_A, PATH_COMMON, PATH_END,
    POSSIBLE, PRISMATIC, TYPE)

# What is left of an equation's levers when those of the equations before it are taken away, as a
# share: less is for pivoting. The same of the forces of a combination that moves nothing.
DISTINCT = 1e-3
# Tolerance of the closure accelerations, relative to their terms.
CLOSED = 1e-6
# Places on a body, and in a row of the model, that differ by less are the same [m].
SAME_PLACE = 1e-12


def structure(model, joints):
    """Return the structural data of code for least forces, beside the topology."""
    return (joints.row.tobytes(), joints.body.tobytes(), (joints.point != 0.0).tobytes(),
            *(_is_at_origin(model, joints, k) for k in range(len(joints.row))))


def _is_at_origin(model, joints, k):
    """Return whether both points of a joint of the tree are the origin of the row it carries."""
    row, first = joints.row[k], space.PLACE if space.is_spatial(model) else JOINT_X
    place = model.body[row, first:first + joints.point.shape[1]]
    return bool(
        model.tree[row, PARENT] == joints.body[k, 0] and model.tree[row, TYPE] != PRISMATIC
        and not joints.point[2 * k + 1].any()
        and np.abs(place - joints.point[2 * k]).max() <= SAME_PLACE)


def closures_of(trace, everything):
    """
    Return the equations of all cut joints, in the mechanism's order, after the outward recursion.

    Which cut joint of the model, whether the elimination works on the equation, and the Closure;
    ``everything``: those, too, that the elimination leaves out.
    """
    found = []
    for a in np.argsort(trace.constant.cut[:, CUT_NUMBER]).tolist():
        cut = trace.constant.cut[a]
        for n, closure in enumerate(trace.recursion.equations(trace.model, a)):
            if cut[POSSIBLE] >> n & 1 and (everything or cut[KEPT] >> n & 1):
                found.append((a, bool(cut[KEPT] >> n & 1), closure))
    return found


def wrenches(trace, qdd, lam, closures):
    """
    Sum up the wrenches in the joints of the trees, by Newton.

    ``trace``: after the outward recursion, with what acts on the bodies; ``qdd``, shape (nv,):
    accelerations, those of spherical joints about the world's axes; ``lam``: multipliers of the
    closures, which are as ``closures_of`` returns them. Wrenches are by rows of the tree, at the
    bodies' origins; what carries the ground counts for nothing.
    """
    one, tree = trace.recursion, trace.constant.tree
    after, found = [2 * ZERO], [2 * ZERO, *one.force[1:]]
    for i in range(1, len(tree)):
        parent, rate = tree[i, PARENT], qdd[tree[i, DOF]]
        after.append(one.propagate_acceleration(i, after[parent], rate))
        inertia, _ = rigid(one.bodies[i], one.motion[i])
        found[i] = add(found[i], times(inertia, after[i]))
        rotor = times(one.motion[parent].frame, one.bodies[i].rotor)
        if not is_zero(rotor):
            found[parent] = add(found[parent], scale(rotor, rate) + ZERO)
    for (a, _, closure), value in zip(closures, lam):
        for body, unit in ((BODY_A, closure.on_a), (BODY_B, closure.on_b)):
            row = trace.constant.cut[a, body]
            found[row] = subtract(found[row], scale(unit, value))
    for i in range(len(tree) - 1, 0, -1):
        parent = tree[i, PARENT]
        found[parent] = add(found[parent], at_parent(found[i], one.motion[i].offset))
    return found


class _Passage:
    """
    Path of the multipliers of one cut joint, or of another equation, through the tree.

    ``joint``: which of the joints it is, cut joints behind those of the tree and others behind
    these.
    """

    def __init__(self, trace, a):
        one, cut = trace.recursion, trace.constant.cut[a]
        self._one, self._tree, self._cut = one, trace.constant.tree, cut
        self._path = trace.constant.path_body[cut[PATH_A]:cut[PATH_END]].tolist()
        # Beyond the bodies that both sides hang on nothing is left of a pair of wrenches.
        self._apart = self._path[:cut[PATH_COMMON] - cut[PATH_A]]
        self.joint = len(trace.joints.row) + int(cut[CUT_NUMBER])
        self._lever = times(
            one.motion[cut[BODY_A]].frame, trace.joint_point(2 * self.joint)) if (
            self.joint < len(trace.joints.body)) else ZERO

    def wrenches(self, on_a, on_b):
        """Return the wrench on each body and its descendants, at its origin, by row."""
        found = {}

        def arrive(i, wrench):
            if i in self._apart and not is_zero(wrench):
                found[i] = add(found.get(i, 2 * ZERO), wrench)

        arrive(self._cut[BODY_A], on_a)
        arrive(self._cut[BODY_B], on_b)
        for i in sorted(self._apart, reverse=True):
            if i in found:
                arrive(self._tree[i, PARENT], at_parent(found[i], self._one.motion[i].offset))
        return found

    def levers(self, closure):
        """Return the share of a unit multiplier in each freedom."""
        own, passing = dict(closure.in_joints), self.wrenches(closure.on_a, closure.on_b)
        return {self._tree[i, DOF]: own.get(i, 0.0) + dot(
                    self._one.motion[i].axis, passing.get(i, 2 * ZERO))
                for i in (self._path if own else self._apart)}

    def in_joints(self, on_a, on_b):
        """Return the wrenches in the joints by row of the tree, in the cut joint by None."""
        return {**{i: subtract(2 * ZERO, wrench)
                   for i, wrench in self.wrenches(on_a, on_b).items()},
                None: at_parent(on_a, subtract(ZERO, self._lever))}


class _Joint:
    """
    Points on the two bodies of a joint at which its wrench is measured.

    ``place``: of one of the tree the row that it carries, of a cut joint its number in a tuple.
    """

    def __init__(self, trace, k):
        """Find the arms from the reference point of the wrench to these points."""
        joints, motion = trace.joints, trace.recursion.motion
        at_a, at_b = (
            add(motion[row].origin, times(motion[row].frame, trace.joint_point(2 * k + n)))
            for n, row in enumerate(joints.body[k]))
        if k >= len(joints.row):
            self.place, self.arms = (k,), (ZERO, subtract(at_a, at_b))
        else:
            self.place = int(joints.row[k])
            reference = motion[self.place].origin
            self.arms = (ZERO,) if _is_at_origin(trace.constant, joints, k) else (
                subtract(reference, at_a), subtract(reference, at_b))

    def product(self, one, other, share):
        """Return the inner product of two wrenches: ``share`` of their moments at each point."""
        total = dot(one[3:], other[3:])
        for arm in self.arms:
            moments = (add(each[:3], cross(arm, each[3:])) for each in (one, other))
            total = total + dot(*moments) * (2.0 / len(self.arms) * share)
        return total


def require_left_out(trace, qdd):
    """Record in the guard whether accelerations fulfil the equations that are left out."""
    closures = closures_of(trace, True)
    _require_closed(closures, _levers(closures, _passages(trace, closures)), qdd)


def least_forces(trace, qdd, lam):
    """
    Return the multipliers of all equations that minimise the forces in all joints.

    Parameters
    ----------
    trace : routines.MechanismTrace
        After the outward recursion, with what acts on the bodies. Its guard notes whether the
        equations that are kept are independent, and whether the accelerations fulfil the others.
    qdd : ndarray, shape (nv,)
        As for ``wrenches``.
    lam : ndarray
        Multipliers of the equations that are kept.

    Returns
    -------
    list
        In the mechanism's order.

    """
    closures, joints = closures_of(trace, True), trace.joints
    passages = _passages(trace, closures)
    levers = _levers(closures, passages)
    kept = [n for n, (_, works, _) in enumerate(closures) if works]
    idle = [n for n, (_, works, _) in enumerate(closures) if not works]
    _require_closed(closures, levers, qdd)
    given = dict(zip(kept, lam))
    present = wrenches(trace, qdd, lam, [closures[n] for n in kept])
    # Unit multipliers of the equations left out, and what of the others undoes their levers.
    columns = [{n: 1.0, **{k: 0.0 - share for k, share in shares.items()}}
               for n, shares in zip(idle, _shares(levers, kept, idle, qdd))]
    felt = [_in_joints(closures, passages, column) for column in columns]
    now = {**{int(row): present[row] for row in joints.row}, **{
        place: wrench for place, wrench in _in_joints(closures, passages, given).items()
        if isinstance(place, tuple)}}
    size = trace.size
    share = 0.5 / (size * size)
    normal = [[0.0 for _ in columns[:n + 1]] for n in range(len(columns))]
    right = [0.0 for _ in columns]
    for k in range(len(joints.body)):
        joint = _Joint(trace, k)
        for n, one in enumerate(felt):
            if joint.place in one:
                right[n] = right[n] - joint.product(
                    one[joint.place], now.get(joint.place, 2 * ZERO), share)
                for m, other in enumerate(felt[:n + 1]):
                    if joint.place in other:
                        normal[n][m] = normal[n][m] + joint.product(
                            one[joint.place], other[joint.place], share)
    # Forces of couplings and prescribed motions count as moments.
    others = [n for n, (a, _, _) in enumerate(closures) if passages[a].joint >= len(joints.body)]
    for n, one in enumerate(columns):
        for place in filter(one.__contains__, others):
            weight = one[place] * (2.0 * share)
            right[n] = right[n] - weight * given.get(place, 0.0)
            for m, other in enumerate(columns[:n + 1]):
                normal[n][m] = normal[n][m] + weight * other.get(place, 0.0)
    found = [given.get(n, 0.0) for n in range(len(closures))]
    for value, column in zip(_solved(normal, right), columns):
        for n, part in column.items():
            found[n] = found[n] + part * value
    return found


def _passages(trace, closures):
    """Return the passages of the multipliers, by cut joint."""
    return {a: _Passage(trace, a) for a, _, _ in closures}


def _levers(closures, passages):
    """Return the share of each unit multiplier in the freedoms."""
    return [passages[a].levers(closure) for a, _, closure in closures]


def _in_joints(closures, passages, multipliers):
    """Return the wrenches that multipliers exert, by ``_Joint.place``."""
    ends = {}
    for n, value in multipliers.items():
        a, _, closure = closures[n]
        on_a, on_b = ends.get(a, (2 * ZERO, 2 * ZERO))
        ends[a] = (add(on_a, scale(closure.on_a, value)), add(on_b, scale(closure.on_b, value)))
    found = {}
    for a, pair in ends.items():
        for row, wrench in passages[a].in_joints(*pair).items():
            place = (passages[a].joint,) if row is None else row
            found[place] = add(found.get(place, 2 * ZERO), wrench)
    return found


def _require_closed(closures, levers, qdd):
    """Record in the guard whether accelerations satisfy the redundant equations."""
    left_out = [(each, closure.bias) for each, (_, works, closure) in zip(levers, closures)
                if not works]
    parts = [lever * qdd[dof] for one in levers for dof, lever in one.items()
             if not is_zero((lever,))]
    parts += [bias for _, bias in left_out]
    left = 0.0
    for each, bias in left_out:
        total = bias + dot(each.values(), [qdd[dof] for dof in each])
        left = left + total * total
    # No more than this share of the largest part.
    bool(left <= dot(parts, parts) * (CLOSED ** 2 / len(parts)))


def _shares(levers_of, kept, idle, qdd):
    """Return each redundant equation as a combination of the retained ones, at accelerations."""
    units, lengths, known = [], [], []
    for n in kept:
        levers, parts = levers_of[n], []
        whole = _product(levers, levers)
        for unit in units:
            part = _product(levers, unit)
            parts.append(part)
            levers = _without(levers, unit, part)
        square = _product(levers, levers)
        if is_zero((square,)):
            hold_nowhere(qdd[0])
            square = 1.0
        bool(square >= (DISTINCT ** 2) * whole)
        length = square_root(square)
        units.append({dof: lever / length for dof, lever in levers.items()})
        lengths.append(length)
        known.append(parts)
    found = []
    for n in idle:
        levers, parts = levers_of[n], []
        for unit in units:
            part = _product(levers, unit)
            parts.append(part)
            levers = _without(levers, unit, part)
        for j in range(len(kept) - 1, -1, -1):
            for later in range(j + 1, len(kept)):
                parts[j] = parts[j] - parts[later] * known[later][j]
            if not is_zero((parts[j],)):
                parts[j] = parts[j] / lengths[j]
        found.append({k: part for k, part in zip(kept, parts) if not is_zero((part,))})
    return found


def _product(one, other):
    """Return the inner product of levers."""
    total = 0.0
    for dof, lever in one.items():
        if dof in other:
            total = total + lever * other[dof]
    return total


def _without(levers, unit, part):
    """Return levers less a part of others."""
    if is_zero((part,)):
        return levers
    return {dof: levers.get(dof, 0.0) - part * unit.get(dof, 0.0) for dof in {**levers, **unit}}


def _solved(matrix, right):
    """Return the solution of a symmetric positive definite system, given the part below."""
    count, right = len(right), list(right)
    lower, inverse = [], []
    for n in range(count):
        row, scaled = [], []
        for m in range(n):
            scaled.append(matrix[n][m] - dot(scaled, lower[m]))
            row.append(scaled[m] * inverse[m])
        pivot = matrix[n][n] - dot(scaled, row)
        bool(pivot >= (DISTINCT ** 2) * matrix[n][n])
        lower.append(row)
        inverse.append(1.0 / pivot)
    for n in range(count):
        right[n] = right[n] - dot(lower[n], right)
    right = [value * factor for value, factor in zip(right, inverse)]
    for n in range(count - 1, -1, -1):
        right[n] = right[n] - dot([lower[m][n] for m in range(n + 1, count)], right[n + 1:])
    return right
