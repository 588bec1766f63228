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

"""Dense matrices of the mechanism: constraint Jacobian and generalized inertia matrix."""

from .articulated_inertia import turn_spherical
from .codegen.function_table import run_piece
from .compiled import compiled
from .loop_closure import measure, respond
from .types import CARRY, COMPOSE, CUT_ROW, DOF, PARENT, PATH_A, PATH_END, ROWS


@compiled
def constraint_jacobian(model, work, jac):
    """
    Compute J = d psi / d q, rows in the mechanism's order.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``.
    jac : ndarray, shape (nc, nv)
        Written in place.

    Notes
    -----
    Appendix A.1 and A.2 of the paper print its blocks for two mechanisms; doc/theory.md lists
    their misprints.

    """
    cut = model.cut
    jac[:, :] = 0.0
    for a in range(cut.shape[0]):
        measure(model, work, a)
        for k in range(cut[a, ROWS]):
            respond(model, work, CARRY, a, k)
            for entry in range(cut[a, PATH_A], cut[a, PATH_END]):
                i = model.path_body[entry]
                jac[cut[a, CUT_ROW] + k, model.tree[i, DOF]] = work.response[entry, k]
            turn_spherical(model.tree, work.body, jac[cut[a, CUT_ROW] + k], False)


@compiled
def generalized_inertia_matrix(model, work, gim):
    """
    Compute the generalized inertia matrix of the spanning tree by composite rigid bodies.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        Right after ``kinematics.outward``; the inertia columns are used up.
    gim : ndarray, shape (nv, nv)
        Written in place [kg m^2, kg m, kg].

    """
    tree, body, piece, share = model.tree, work.body, work.piece, work.share
    gim[:, :] = 0.0
    for i in range(tree.shape[0] - 1, 0, -1):
        # Force of the composite body for a unit acceleration of its joint, then inward.
        run_piece(piece[i, COMPOSE], model.body, i, body, i, body, tree[i, PARENT],
                  work.wrench, 0, share, 0)
        row, k = tree[i, DOF], tree[i, PARENT]
        gim[row, row] = share[0]
        while k > 0:
            run_piece(piece[k, CARRY], model.body, k, body, k, body, k, work.wrench, 0, share, 0)
            gim[row, tree[k, DOF]] = share[0]
            gim[tree[k, DOF], row] = share[0]
            k = tree[k, PARENT]
    for i in range(gim.shape[0]):
        turn_spherical(tree, body, gim[i], False)
    for i in range(gim.shape[0]):
        turn_spherical(tree, body, gim[:, i], False)
