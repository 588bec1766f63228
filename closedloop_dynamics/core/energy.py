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

"""Kinetic energy, and potential energy in gravity."""

from .codegen.function_table import run_piece
from .compiled import compiled
from .types import DOF, MEASURE, PARENT


def parts(model, work):
    """
    Return what ``energies`` needs of a model and a workspace.

    A call from Python that hands over all of them takes several times as long as the kernel.

    """
    return model.tree, model.body, model.gravity, work.piece, work.body, work.equation


@compiled
def energies(tree, constant, gravity, piece, body, moment, qd, out):
    """
    Compute the kinetic energy of all bodies and rotors, and the potential energy in gravity.

    Parameters
    ----------
    tree, constant, gravity, piece, body, moment : ndarray
        What ``parts`` returns, after ``kinematics.outward``.
    qd : ndarray, shape (nv,)
        Joint rates, for the rotors.
    out : ndarray, shape (2,)
        Written in place: kinetic, and potential, which is zero with all masses at the world's
        origin [J].

    """
    out[0] = out[1] = 0.0
    for i in range(1, tree.shape[0]):
        run_piece(piece[i, MEASURE], constant, i, body, i, body, tree[i, PARENT], moment, 0, qd,
                  tree[i, DOF])
        out[0] += 0.5 * moment[0]
        for k in range(gravity.shape[0]):
            out[1] -= gravity[k] * moment[1 + k]
