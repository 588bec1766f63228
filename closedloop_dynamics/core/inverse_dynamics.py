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

"""Joint torques of the trees for a given motion, as if no loop were closed."""

from .compiled import compiled
from .types import (
    ARMATURE, DOF, DX, DY, DZ, FX, FY, FZ, HX, HY, IZZ, MXX, MYY, PARENT, PRISMATIC, RX,
    RY, SX, SY, TYPE)


@compiled
def tree_torque(model, work, qdd, out):
    """
    Compute I qdd + c, the torques that the trees need for the motion q, qd, qdd.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        Right after ``kinematics.outward`` (the inertias must still be the rigid bodies' own);
        FZ, FX, FY, DZ, DX, DY are used up.
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    out : ndarray, shape (nv,)
        Written in place [N m, N].

    Notes
    -----
    With qdd = 0 this is the bias force c of I qdd + c = tau + J^T lambda.

    """
    tree, constant, body = model.tree, model.body, work.body
    for i in range(1, tree.shape[0]):
        p = tree[i, PARENT]
        dz = body[p, DZ]
        dx = body[p, DX] - dz * body[i, RY]
        dy = body[p, DY] + dz * body[i, RX]
        if tree[i, TYPE] == PRISMATIC:
            dx += body[i, SX] * qdd[tree[i, DOF]]
            dy += body[i, SY] * qdd[tree[i, DOF]]
        else:
            dz += qdd[tree[i, DOF]]
        body[i, DZ] = dz
        body[i, DX] = dx
        body[i, DY] = dy
        body[i, FZ] += body[i, IZZ] * dz + body[i, HX] * dx + body[i, HY] * dy
        body[i, FX] += body[i, HX] * dz + body[i, MXX] * dx
        body[i, FY] += body[i, HY] * dz + body[i, MYY] * dy
    for i in range(tree.shape[0] - 1, 0, -1):
        p = tree[i, PARENT]
        fz, fx, fy = body[i, FZ], body[i, FX], body[i, FY]
        if tree[i, TYPE] == PRISMATIC:
            torque = body[i, SX] * fx + body[i, SY] * fy
        else:
            torque = fz
        out[tree[i, DOF]] = torque + constant[i, ARMATURE] * qdd[tree[i, DOF]]
        body[p, FZ] += fz + body[i, RX] * fy - body[i, RY] * fx
        body[p, FX] += fx
        body[p, FY] += fy
