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

"""Outward recursion: poses, velocities, velocity-product accelerations, rigid-body inertias."""

from .codegen.function_table import run_piece
from .codegen.space import ACCELERATION
from .compiled import inlined
from .types import AX, COORDINATE, COS, DOF, MOVE, PARENT, PX, PY, SIN


@inlined
def outward(model, q, qd, work):
    """
    Update every body's motion, its rigid-body inertia and its bias force.

    Parameters
    ----------
    model : Model
        Constant topology and geometry.
    q : ndarray, shape (nq,)
        Joint coordinates [rad, m].
    qd : ndarray, shape (nv,)
        Their rates.
    work : Workspace
        ``work.body`` is written, but for what the later stages write.

    Notes
    -----
    World axes throughout, each body at its own origin: then neither inertias nor forces are
    ever rotated, only shifted. The acceleration is the one that q, qd and gravity leave when
    qdd = 0; a ground that accelerates by -g stands for gravity. The bias force is what a body
    needs for that acceleration. The arithmetic is that of ``codegen.spatial``.

    """
    tree, body, piece = model.tree, work.body, work.piece
    dimensions = model.gravity.shape[0]
    first = AX if dimensions == 2 else ACCELERATION
    for k in range(dimensions):
        body[0, first + k] = -model.gravity[k]
    for i in range(1, tree.shape[0]):
        run_piece(piece[i, MOVE], model.body, i, body, i, body, tree[i, PARENT],
                  q, tree[i, COORDINATE], qd, tree[i, DOF])


@inlined
def point_position(work, i, x, y, out):
    """
    Compute the place of a point of body ``i`` given in its frame.

    Parameters
    ----------
    work : Workspace
        After ``outward``.
    i : int
        Row of the body, 0 for the ground.
    x, y : float
        Place in the body's frame [m].
    out : ndarray, shape (2,)
        Written in place [m].

    """
    body = work.body
    out[0] = body[i, PX] + body[i, COS] * x - body[i, SIN] * y
    out[1] = body[i, PY] + body[i, SIN] * x + body[i, COS] * y
