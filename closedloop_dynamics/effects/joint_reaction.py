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

"""The reactions in joints of the trees, for effects that are driven by them."""

import math

from .table import LOAD_TIME, LOADED, SECOND, STATE
from ..core.compiled import compiled
from ..core.joint_wrenches import FORCE_X, FORCE_Y, joint_wrenches
from ..core.types import PRISMATIC, SX, SY, TYPE


@compiled
def load(model, work, table, qdd, lam):
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
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    lam : ndarray, shape (nc,)
        Multipliers.

    """
    tree, body, reaction = model.tree, work.body, table.reaction
    joint_wrenches(model, work, qdd, lam, reaction)
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 1 and table.index[row, LOADED] == 1:
            i, state = table.index[row, SECOND], table.index[row, STATE] + 1
            fx, fy = reaction[i, FORCE_X], reaction[i, FORCE_Y]
            size = math.sqrt(fx * fx + fy * fy)
            if tree[i, TYPE] == PRISMATIC:
                size = abs(body[i, SX] * fy - body[i, SY] * fx)
            table.rates[state] = (size - table.states[state]) / table.values[row, LOAD_TIME]
            table.output[row, 2] = size
