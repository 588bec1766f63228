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

"""
Inward and outward recursions on the articulated-body inertias.

The pivots D and vectors U = IA S are the UDU^T factors of each subsystem's
generalized inertia matrix that the DeNOC formulation gives; they are made once
per evaluation and serve the applied forces and every cut force alike.

"""

from .codegen.function_table import run_piece
from .codegen.space import FRAME
from .compiled import inlined
from .types import ACCELERATE, AXIS, BALL, DOF, ELIMINATE, ELIMINATE_MASSLESS, PARENT, TYPE

Z = 2


@inlined
def turn_spherical(tree, body, values, outward):
    """
    Turn values for spherical joints from the bodies' own axes to the world's, or back.

    Parameters
    ----------
    tree : ndarray
        Of the ``Model``.
    body : ndarray
        Of the ``Workspace``, after ``kinematics.outward``.
    values : ndarray, shape (nv,)
        Rates, accelerations or torques; changed in place.
    outward : bool
        Whether to the world's axes.

    """
    for i in range(1, tree.shape[0]):
        if tree[i, TYPE] == BALL and tree[i, AXIS] == Z:
            k = tree[i, DOF] - 2
            x, y, z = values[k], values[k + 1], values[k + 2]
            for n in range(3):
                row = FRAME + 3 * n if outward else FRAME + n
                step = 1 if outward else 3
                values[k + n] = (body[i, row] * x + body[i, row + step] * y
                                 + body[i, row + 2 * step] * z)


@inlined
def inward(model, tau, work, massless=False):
    """
    Factor the generalized inertia matrices and reduce the applied forces.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    tau : ndarray, shape (nv,)
        Joint torques [N m] and forces [N].
    work : Workspace
        After ``kinematics.outward``; the bias forces may have been reduced by applied forces. The
        factors and RHS are written: RHS = D times the joint's own share of I^-1 phi.
    massless : bool
        Whether joints may carry no inertia; DINV is 0 there.

    """
    tree, body, piece, torque = model.tree, work.body, work.piece, work.torque
    for i in range(tau.shape[0]):
        torque[i] = tau[i]
    turn_spherical(tree, body, torque, True)
    stage = ELIMINATE_MASSLESS if massless else ELIMINATE
    for i in range(tree.shape[0] - 1, 0, -1):
        run_piece(piece[i, stage], model.body, i, body, i, body, tree[i, PARENT],
                  torque, tree[i, DOF], torque, 0)


@inlined
def outward_acceleration(model, work, qdd):
    """
    Complete I^-1: joint accelerations from the reduced right-hand sides.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        RHS as left by ``inward`` and completed by the cut forces.
    qdd : ndarray, shape (nv,)
        Written in place.

    """
    tree, body, piece = model.tree, work.body, work.piece
    for i in range(1, tree.shape[0]):
        run_piece(piece[i, ACCELERATE], model.body, i, body, i, body, tree[i, PARENT],
                  qdd, tree[i, DOF], qdd, 0)
    turn_spherical(tree, body, qdd, False)
