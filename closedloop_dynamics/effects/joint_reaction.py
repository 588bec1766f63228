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

"""The reactions in joints, for effects that are driven by them."""

import math

from .cut_coordinates import direction
from .table import (
    ACROSS, AXIS as CUT_AXIS, CUT, FIRST, IN_PLANE, LOAD_TIME, LOADED, ROW_B, SECOND, SLIDES,
    STATE)
from ..core import kinematics
from ..core.codegen.space import FRAME
from ..core.compiled import compiled, inlined
from ..core.joint_wrenches import FORCE_X, FORCE_Y, joint_wrenches, wrenches_of_cut
from ..core.types import AXIS, PRISMATIC, SX, SY, TYPE


@inlined
def load(model, work, table, q, qd, qdd, lam):
    """
    Compute the reactions and let the loaded effects' states follow them.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    work : Workspace
        After ``kinematics.outward``; only poses are read.
    table : EffectTable
        ``reaction`` after ``joint_wrenches.bias_forces``. The rates of the loads and the
        readings are written.
    q, qd : ndarray, shape (nq,), (nv,)
        The state.
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    lam : ndarray, shape (nc,)
        Multipliers.

    """
    if model.gravity.shape[0] == 3:
        # The elimination leaves less behind than is read here.
        kinematics.outward(model, q, qd, work)
    joint_wrenches(model, work, qdd, lam, table.reaction)
    feel(model, work, table, qd, lam)


@inlined
def feel(model, work, table, qd, lam):
    """
    Let the loaded effects' states follow the reactions.

    Parameters
    ----------
    model, work, table, qd, lam
        As for ``load``; ``reaction`` has the forces in the joints of the trees.

    """
    tree, body, reaction = model.tree, work.body, table.reaction
    spatial = model.gravity.shape[0] == 3
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 1 and table.index[row, LOADED] == 1 and (
                table.index[row, FIRST] < qd.shape[0]):
            i = table.index[row, SECOND]
            size = _across(tree, body, reaction, i) if spatial else _in_plane(
                tree, body, reaction, i)
            _feel(table, row, size)
    if table.cuts.index.shape[0] > 0:
        _load_cuts(table, model.cut, model.cut_point, work.cut_piece, body, lam, work.share,
                   qd.shape[0])


@inlined
def _feel(table, row, size):
    """Let the state of a loaded effect follow a reaction [N]."""
    state = table.index[row, STATE] + 1
    table.rates[state] = (size - table.states[state]) / table.values[row, LOAD_TIME]
    table.output[row, 2] = size


@compiled
def _load_cuts(table, cut, cut_point, cut_piece, body, lam, share, nv):
    """Do the same in cut joints; the arguments are arrays of model and workspace."""
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 1 and table.index[row, LOADED] == 1 and (
                table.index[row, FIRST] >= nv):
            _feel(table, row, _of_cut(table.cuts, cut, cut_point, cut_piece, body, lam, share,
                                      table.index[row, FIRST] - nv, table.applied))


@inlined
def _in_plane(tree, body, reaction, i):
    """Return the force in a joint, across the axis of one that slides [N]."""
    fx, fy = reaction[i, FORCE_X], reaction[i, FORCE_Y]
    if tree[i, TYPE] == PRISMATIC:
        return abs(body[i, SX] * fy - body[i, SY] * fx)
    return math.sqrt(fx * fx + fy * fy)


@inlined
def _across(tree, body, reaction, i):
    """Do as ``_in_plane`` does in space."""
    fx, fy, fz = reaction[i, 3], reaction[i, 4], reaction[i, 5]
    square = fx * fx + fy * fy + fz * fz
    if tree[i, TYPE] == PRISMATIC:
        # Z of the row's frame, or the axis that it slides along.
        axis = FRAME + tree[i, AXIS]
        along = body[i, axis] * fx + body[i, axis + 3] * fy + body[i, axis + 6] * fz
        square = max(0.0, square - along * along)
    return math.sqrt(square)


@compiled
def _of_cut(cuts, cut, cut_point, cut_piece, body, lam, share, k, applied):
    """Do as ``_in_plane`` does in a cut joint; the arguments are arrays of model and workspace."""
    wrenches_of_cut(cut, cut_point, cut_piece, body, lam, share, cuts.index[k, CUT])
    planar = cuts.index[k, IN_PLANE] == 1
    fx, fy, fz = share[1], share[2], 0.0
    if not planar:
        fx, fy, fz = share[3], share[4], share[5]
    if cuts.index[k, ACROSS] == 0:
        # What acts along the joint's slides passes through it, too.
        first = applied.shape[0] - cuts.index.shape[0]
        for n in range(cuts.index.shape[0]):
            if cuts.index[n, CUT] == cuts.index[k, CUT] and cuts.index[n, SLIDES] == 1:
                x, y, z = direction(body, cuts.index[n, ROW_B], planar, cuts.values, n, CUT_AXIS)
                fx += applied[first + n] * x
                fy += applied[first + n] * y
                fz += applied[first + n] * z
    square = fx * fx + fy * fy + fz * fz
    if cuts.index[k, ACROSS] == 1:
        x, y, z = direction(body, cuts.index[k, ROW_B], planar, cuts.values, k, CUT_AXIS)
        along = x * fx + y * fy + z * fz
        square = max(0.0, square - along * along)
    return math.sqrt(square)
