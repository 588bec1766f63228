# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Cut joints: closure error, its rates, and the response of the trees to unit cut forces."""

from .codegen.function_table import run_piece
from .codegen.space import CUT_POINT_COLUMNS as COLUMNS_IN_SPACE
from .codegen.space import JOINT_POSITION, JOINT_RATE
from .compiled import inlined
from .types import (
    BODY_A, BODY_B, COUPLED_PLACE, CUT_COUPLING, CUT_POINT_COLUMNS, CUT_TYPE, EQUATIONS, FACTORS,
    HELD_SUM, LEVER, MOTION_COLUMNS, NO_RESPONSES, PARENT, PATH_A, PATH_B, PATH_COMMON, PATH_END,
    POSITION, PRESCRIBED_JOINT, PRISMATIC, RATE, REDUCE, REDUCE_COUPLED, REDUCED, RHS, ROW, ROWS,
    TYPE)


@inlined
def carry(model, work, stage, first, last, wrench, row):
    """
    Carry a unit force inward along path entries and keep its share at each joint.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        ``response`` and ``response_scaled`` are written.
    stage : int
        ``REDUCE``, ``LEVER`` or ``CARRY``.
    first, last : int
        Path entries.
    wrench : int
        Row of ``work.wrench``: at the origin of the first body, then at that of the last one's
        parent.
    row : int
        Of the cut joint.

    """
    body, piece, share = work.body, work.piece, work.share
    for entry in range(first, last):
        i = model.path_body[entry]
        run_piece(piece[i, stage], model.body, i, body, i, body, i, work.wrench, wrench, share, 0)
        work.response[entry, row] = share[0]
        work.response_scaled[entry, row] = share[1]


@inlined
def respond(model, work, stage, a, row):
    """
    Compute the response to the unit force of one equation of a cut joint.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``measure``; ``response`` and ``response_scaled`` are written.
    stage : int
        ``REDUCE``, ``LEVER`` or ``CARRY``.
    a, row : int
        Cut joint, and its equation.

    """
    cut, wrench, size = model.cut, work.wrench, work.wrench.shape[1]
    if cut[a, CUT_TYPE] == CUT_COUPLING or cut[a, CUT_TYPE] == PRESCRIBED_JOINT:
        _respond_in_joints(model, work, stage, a, row)
        return
    if cut[a, CUT_TYPE] >= COUPLED_PLACE:
        _respond_in_both(model, work, stage, a)
        return
    place = row * (3 + 2 * size) + 3
    for n in range(size):
        wrench[0, n] = work.equation[place + n]
        wrench[1, n] = work.equation[place + size + n]
    middle, common, end = cut[a, PATH_B], cut[a, PATH_COMMON], cut[a, PATH_END]
    carry(model, work, stage, cut[a, PATH_A], middle, 0, row)
    if middle < end:
        carry(model, work, stage, middle, common, 1, row)
        if common < end:
            for n in range(size):
                wrench[0, n] += wrench[1, n]
            carry(model, work, stage, common, end, 0, row)


@inlined
def _respond_in_joints(model, work, stage, a, row):
    """Do as ``respond`` does for a coupling; a path entry's body comes before its parent."""
    cut, arrived, share = model.cut, work.force, work.share
    first, last, planar = cut[a, PATH_A], cut[a, PATH_END], work.wrench.shape[1] == 3
    for entry in range(first, last):
        i = model.path_body[entry]
        for n in range(6):
            arrived[i, n] = arrived[model.tree[i, PARENT], n] = 0.0
    for entry in range(first, last):
        i = model.path_body[entry]
        p, factor = model.tree[i, PARENT], model.cut_point[a, FACTORS + entry - first]
        share[0], share[1] = factor, 0.0
        if stage == REDUCE:
            run_piece(work.piece[i, REDUCE_COUPLED], model.body, i, work.body, i, work.body, i,
                      arrived, i, share, 0)
            for n in range(6):
                arrived[p, n] += arrived[i, n]
        elif stage == LEVER and planar:
            # A joint's angle is its body's less its parent's; what slides turns with its parent.
            if model.tree[i, TYPE] == PRISMATIC:
                arrived[p, 0] += arrived[i, 0]
            else:
                share[0] += arrived[i, 0]
                arrived[p, 0] -= factor
        work.response[entry, row] = share[0]
        work.response_scaled[entry, row] = share[1]


@inlined
def _respond_in_both(model, work, stage, a):
    """Do as ``respond`` does for a place or angle of two bodies that joints are coupled to."""
    cut, arrived, share, equation = model.cut, work.force, work.share, work.equation
    first, last, size = cut[a, PATH_A], cut[a, PATH_END], work.wrench.shape[1]
    before = FACTORS + (CUT_POINT_COLUMNS if size == 3 else COLUMNS_IN_SPACE) - first
    for entry in range(first, last):
        i = model.path_body[entry]
        for n in range(6):
            arrived[i, n] = arrived[model.tree[i, PARENT], n] = 0.0
    for n in range(size):
        arrived[cut[a, BODY_A], n] = equation[3 + n]
    for n in range(size):
        arrived[cut[a, BODY_B], n] += equation[3 + size + n]
    for entry in range(first, last):
        i = model.path_body[entry]
        p, factor = model.tree[i, PARENT], model.cut_point[a, before + entry]
        share[0], share[1] = factor, 0.0
        if stage == REDUCE:
            run_piece(work.piece[i, REDUCE_COUPLED], model.body, i, work.body, i, work.body, i,
                      arrived, i, share, 0)
        else:
            run_piece(work.piece[i, stage], model.body, i, work.body, i, work.body, i,
                      arrived, i, share, 0)
            share[0] += factor
        for n in range(size):
            arrived[p, n] += arrived[i, n]
        if stage == LEVER and size == 3:
            # As above, in a column that no wrench has.
            if model.tree[i, TYPE] == PRISMATIC:
                arrived[p, 3] += arrived[i, 3]
            else:
                share[0] += arrived[i, 3]
                arrived[p, 3] -= factor
        work.response[entry, 0] = share[0]
        work.response_scaled[entry, 0] = share[1]


@inlined
def _sum_of_joints(model, work, a, begin):
    """Return what a coupling makes of the joints of the tree, less what it holds; its rate."""
    cut, body, planar = model.cut, work.body, work.wrench.shape[1] == 3
    position, speed = (POSITION, RATE) if planar else (JOINT_POSITION, JOINT_RATE)
    value, rate = -model.cut_point[a, begin + HELD_SUM], 0.0
    for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
        factor = model.cut_point[a, begin + FACTORS + entry - cut[a, PATH_A]]
        if factor != 0.0:
            value += factor * body[model.path_body[entry], position]
            rate += factor * body[model.path_body[entry], speed]
    return value, rate


@inlined
def measure(model, work, a):
    """
    Compute what the equations of one cut joint say.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``kinematics.outward``. ``equation`` is written: for each equation psi, J qd,
        Jdot qd, and the wrenches of a unit multiplier on bodies A and B.
    a : int
        The cut joint.

    """
    cut, body = model.cut, work.body
    if cut[a, CUT_TYPE] == CUT_COUPLING or cut[a, CUT_TYPE] == PRESCRIBED_JOINT:
        value, rate = _sum_of_joints(model, work, a, 0)
        work.equation[0], work.equation[1], work.equation[2] = value, rate, 0.0
        if cut[a, CUT_TYPE] == PRESCRIBED_JOINT:
            for n in range(MOTION_COLUMNS):
                work.equation[n] -= model.cut_point[
                    a, model.cut_point.shape[1] - MOTION_COLUMNS + n]
        return
    if cut[a, CUT_TYPE] >= COUPLED_PLACE:
        value, rate = _sum_of_joints(
            model, work, a, CUT_POINT_COLUMNS if work.wrench.shape[1] == 3 else COLUMNS_IN_SPACE)
        last = model.cut_point.shape[1] - MOTION_COLUMNS
        model.cut_point[a, last], model.cut_point[a, last + 1] = -value, -rate
        model.cut_point[a, last + 2] = 0.0
    run_piece(work.cut_piece[a, EQUATIONS], model.cut_point, a, body, cut[a, BODY_A],
              body, cut[a, BODY_B], work.equation, 0, work.share, 0)


@inlined
def update(model, work, responses):
    """
    Compute closure, its rates and, if asked, the unit responses of every cut joint.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward`` and, if reduced, ``articulated_inertia.inward``. Writes
        ``closure`` (psi), ``closure_rate`` (J qd), ``bias`` (Jdot qd), and ``response`` (the
        columns of J^T reduced to the joints) with ``response_scaled``, or the levers.
    responses : int
        ``NO_RESPONSES``, ``REDUCED`` or ``LEVERS``.

    Notes
    -----
    psi = p_A - p_B (doc/theory.md section 1). The multiplier acts on body A, its
    opposite on body B.

    """
    cut, equation, size = model.cut, work.equation, 3 + 2 * work.wrench.shape[1]
    for a in range(cut.shape[0]):
        measure(model, work, a)
        for k in range(cut[a, ROWS]):
            row = cut[a, ROW] + k
            work.closure[row] = equation[k * size]
            work.closure_rate[row] = equation[k * size + 1]
            work.bias[row] = equation[k * size + 2]
            if responses != NO_RESPONSES:
                respond(model, work, REDUCE if responses == REDUCED else LEVER, a, k)


@inlined
def largest(values):
    """
    Return the largest absolute value, such as the closure error.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Any numbers.

    Returns
    -------
    float
        NaN if there is one.

    """
    most = 0.0
    for value in values:
        if not abs(value) <= most:
            most = abs(value)
    return most


@inlined
def free_acceleration(model, work, out):
    """
    Compute J I^-1 phi, the acceleration of each closure error without cut forces.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``update``.
    out : ndarray, shape (nc,)
        Written in place, in elimination order.

    """
    body, scaled = work.body, work.response_scaled
    cut, path_body = model.cut, model.path_body
    for a in range(cut.shape[0]):
        for k in range(cut[a, ROWS]):
            total = 0.0
            for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
                total += scaled[entry, k] * body[path_body[entry], RHS]
            out[cut[a, ROW] + k] = total


@inlined
def apply(model, work, lam):
    """
    Add J^T lambda, reduced, to the right-hand sides of the joints.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``update``; RHS is added to.
    lam : ndarray, shape (nc,)
        Multipliers in elimination order.

    """
    body, response = work.body, work.response
    cut, path_body = model.cut, model.path_body
    for a in range(cut.shape[0]):
        for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
            i = path_body[entry]
            total = body[i, RHS]
            for k in range(cut[a, ROWS]):
                total += response[entry, k] * lam[cut[a, ROW] + k]
            body[i, RHS] = total
