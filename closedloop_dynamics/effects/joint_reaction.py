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

"""The constraint forces in the joints of the trees, for effects that are driven by them."""

import math

from .table import LOAD_TIME, LOADED, SECOND, STATE
from ..core.compiled import compiled
from ..core.types import (
    ALPHA, BODY_A, BODY_B, COS, CUT_ANGLE, CUT_PRISMATIC, CUT_ROW, CUT_TYPE, DOF, FX, FY, MASS,
    MASS_X, MASS_Y, PARENT, PRISMATIC, RX, RY, SIN, SX, SY, TYPE)

# Columns of EffectTable.reaction: bias force, then force in the joint; acceleration beyond the
# velocity-product one.
FORCE_X, FORCE_Y, TURN, ALONG_X, ALONG_Y = range(5)


@compiled
def remember(body, table):
    """
    Keep the bodies' bias forces, which the inward recursion will overwrite.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``dispatch.apply``.
    table : EffectTable
        ``reaction`` is written.

    """
    for i in range(body.shape[0]):
        table.reaction[i, FORCE_X] = body[i, FX]
        table.reaction[i, FORCE_Y] = body[i, FY]


@compiled
def load(model, work, table, qdd, lam):
    """
    Compute the reactions and let the loaded effects' states follow them.

    Parameters
    ----------
    model : Model
        What moves.
    work : Workspace
        After ``kinematics.outward``; only poses are read.
    table : EffectTable
        After ``remember``. The rates of the loads and the readings are written.
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    lam : ndarray, shape (nc,)
        Multipliers.

    """
    tree, constant, body, reaction = model.tree, model.body, work.body, table.reaction
    for i in range(1, tree.shape[0]):
        p = tree[i, PARENT]
        turn = reaction[p, TURN] if p > 0 else 0.0
        x = (reaction[p, ALONG_X] if p > 0 else 0.0) - turn * body[i, RY]
        y = (reaction[p, ALONG_Y] if p > 0 else 0.0) + turn * body[i, RX]
        if tree[i, TYPE] == PRISMATIC:
            x += body[i, SX] * qdd[tree[i, DOF]]
            y += body[i, SY] * qdd[tree[i, DOF]]
        else:
            turn += qdd[tree[i, DOF]]
        reaction[i, TURN] = turn
        reaction[i, ALONG_X] = x
        reaction[i, ALONG_Y] = y
        hx = -(body[i, SIN] * constant[i, MASS_X] + body[i, COS] * constant[i, MASS_Y])
        hy = body[i, COS] * constant[i, MASS_X] - body[i, SIN] * constant[i, MASS_Y]
        reaction[i, FORCE_X] += constant[i, MASS] * x + hx * turn
        reaction[i, FORCE_Y] += constant[i, MASS] * y + hy * turn
    for a in range(model.cut.shape[0]):
        i, j, first = model.cut[a, BODY_A], model.cut[a, BODY_B], model.cut[a, CUT_ROW]
        fx, fy = lam[first], lam[first + 1]
        if model.cut[a, CUT_TYPE] == CUT_PRISMATIC:
            angle = body[j, ALPHA] + model.cut_point[a, CUT_ANGLE]
            fx, fy = -math.sin(angle) * lam[first], math.cos(angle) * lam[first]
        reaction[i, FORCE_X] -= fx
        reaction[i, FORCE_Y] -= fy
        reaction[j, FORCE_X] += fx
        reaction[j, FORCE_Y] += fy
    for i in range(tree.shape[0] - 1, 0, -1):
        p = tree[i, PARENT]
        reaction[p, FORCE_X] += reaction[i, FORCE_X]
        reaction[p, FORCE_Y] += reaction[i, FORCE_Y]
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 1 and table.index[row, LOADED] == 1:
            i, state = table.index[row, SECOND], table.index[row, STATE] + 1
            fx, fy = reaction[i, FORCE_X], reaction[i, FORCE_Y]
            size = math.sqrt(fx * fx + fy * fy)
            if tree[i, TYPE] == PRISMATIC:
                size = abs(body[i, SX] * fy - body[i, SY] * fx)
            table.rates[state] = (size - table.states[state]) / table.values[row, LOAD_TIME]
            table.output[row, 2] = size
