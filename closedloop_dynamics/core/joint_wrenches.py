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
The wrenches in all joints, those of the trees and those that close the loops; inverse dynamics.

A wrench is ordered moment, force, in world axes: (moment, force x, force y) in the plane, six
numbers in space. In a cut joint it is what body B exerts on body A, at the cut point of A. In a
joint of a tree it is what the parent exerts on the child, at the child's origin: the reaction, and
along the joint's own freedom what its drive, springs, dampers and friction hand over.

"""

from .articulated_inertia import turn_spherical
from .codegen.function_table import run_piece
from .codegen.space import FORCE
from .compiled import compiled, inlined
from .types import (
    BODY_A, BODY_B, CUT_NUMBER, CUT_ROW, DOF, FZ, NEWTON, PARENT, SHIFT, TORQUE, WRENCH)

# Places in a planar wrench.
MOMENT, FORCE_X, FORCE_Y = range(3)


@compiled
def cut_wrenches(cut, cut_point, cut_piece, body, lam, share, out):
    """
    Compute the wrenches at the cut joints.

    Parameters
    ----------
    cut, cut_point : ndarray
        Of the ``Model``. The arrays alone: from Python, unpacking whole records takes longer.
    cut_piece, body, share : ndarray
        Of the ``Workspace``, after an evaluation; only poses are read.
    lam : ndarray, shape (nc,)
        Multipliers.
    out : ndarray, shape (number of cuts, 3 or 6)
        Written in place, in the user's order [N m, N].

    """
    for a in range(out.shape[0]):
        wrenches_of_cut(cut, cut_point, cut_piece, body, lam, share, a)
        for n in range(out.shape[1]):
            out[cut[a, CUT_NUMBER], n] = share[n]


@inlined
def wrenches_of_cut(cut, cut_point, cut_piece, body, lam, share, a):
    """Write the wrenches of a cut joint: at its point, at the origins of bodies A and B."""
    run_piece(cut_piece[a, WRENCH], cut_point, a, body, cut[a, BODY_A], body, cut[a, BODY_B],
              lam, cut[a, CUT_ROW], share, 0)


@inlined
def bias_forces(work, out):
    """
    Keep the bodies' bias forces, which an evaluation overwrites.

    Parameters
    ----------
    work : Workspace
        After ``kinematics.outward``, and after the effects that act on points.
    out : ndarray, shape (nb + 1, 6 or 12)
        The first half of each row is written.

    """
    size = work.wrench.shape[1]
    first = FZ if size == 3 else FORCE
    for i in range(out.shape[0]):
        for n in range(size):
            out[i, n] = work.body[i, first + n]


@inlined
def newton(model, work, qdd, wrench):
    """Add what accelerations take to the bias forces: Newton and Euler, outward."""
    tree, body, piece = model.tree, work.body, work.piece
    for i in range(qdd.shape[0]):
        work.torque[i] = qdd[i]
    turn_spherical(tree, body, work.torque, True)
    for i in range(1, tree.shape[0]):
        run_piece(piece[i, NEWTON], model.body, i, body, i, wrench, tree[i, PARENT], wrench, i,
                  work.torque, tree[i, DOF])


@inlined
def joint_wrenches(model, work, qdd, lam, wrench):
    """
    Compute the wrenches in the joints of the trees: Newton and Euler, from the tips inward.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``; only poses are read.
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    lam : ndarray, shape (nc,)
        Multipliers.
    wrench : ndarray, shape (nb + 1, 6 or 12)
        After ``bias_forces``. The first half of each row becomes the wrench in the body's joint,
        the second its acceleration beyond the velocity-product one.

    """
    tree, cut, body, piece, share = model.tree, model.cut, work.body, work.piece, work.share
    size = work.wrench.shape[1]
    newton(model, work, qdd, wrench)
    for a in range(cut.shape[0]):
        wrenches_of_cut(cut, model.cut_point, work.cut_piece, body, lam, share, a)
        for n in range(size):
            wrench[cut[a, BODY_A], n] -= share[size + n]
            wrench[cut[a, BODY_B], n] -= share[2 * size + n]
    for i in range(tree.shape[0] - 1, 0, -1):
        run_piece(piece[i, SHIFT], model.body, i, body, i, wrench, tree[i, PARENT], wrench, i,
                  share, 0)


@compiled
def tree_torque(model, work, qdd, out):
    """
    Compute I qdd + c, the torques that the trees need for a motion, as if no loop were closed.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``.
    qdd : ndarray, shape (nv,)
        Joint accelerations.
    out : ndarray, shape (nv,)
        Written in place [N m, N].

    Notes
    -----
    With qdd = 0 this is the bias force c of I qdd + c = tau + J^T lambda.

    """
    tree, body, piece, wrench = model.tree, work.body, work.piece, work.force
    bias_forces(work, wrench)
    newton(model, work, qdd, wrench)
    for i in range(tree.shape[0] - 1, 0, -1):
        run_piece(piece[i, TORQUE], model.body, i, body, i, body, i, wrench, i,
                  out, tree[i, DOF])
        run_piece(piece[i, SHIFT], model.body, i, body, i, wrench, tree[i, PARENT], wrench, i,
                  work.share, 0)
    turn_spherical(tree, body, out, False)
