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

from .compiled import compiled
from .types import (
    ARMATURE, COS, DOF, INERTIA, MASS, MASS_X, MASS_Y, OMEGA, PX, PY, SIN, VX, VY)


@compiled
def kinetic_energy(model, work, qd):
    """
    Compute the kinetic energy of all bodies and rotors.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``.
    qd : ndarray, shape (nv,)
        Joint rates, for the rotors.

    Returns
    -------
    float
        [J].

    """
    constant, body = model.body, work.body
    total = 0.0
    for i in range(1, constant.shape[0]):
        hx = -(body[i, SIN] * constant[i, MASS_X] + body[i, COS] * constant[i, MASS_Y])
        hy = body[i, COS] * constant[i, MASS_X] - body[i, SIN] * constant[i, MASS_Y]
        vx, vy, omega = body[i, VX], body[i, VY], body[i, OMEGA]
        rate = qd[model.tree[i, DOF]]
        total += (constant[i, INERTIA] * omega * omega + constant[i, MASS] * (vx * vx + vy * vy)
                  + 2.0 * omega * (hx * vx + hy * vy) + constant[i, ARMATURE] * rate * rate)
    return 0.5 * total


@compiled
def potential_energy(model, work):
    """
    Compute the potential energy in gravity, zero with all masses at the world's origin.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    work : Workspace
        After ``kinematics.outward``.

    Returns
    -------
    float
        [J].

    """
    constant, body, gravity = model.body, work.body, model.gravity
    total = 0.0
    for i in range(1, constant.shape[0]):
        mass = constant[i, MASS]
        x = mass * body[i, PX] + (
            body[i, COS] * constant[i, MASS_X] - body[i, SIN] * constant[i, MASS_Y])
        y = mass * body[i, PY] + (
            body[i, SIN] * constant[i, MASS_X] + body[i, COS] * constant[i, MASS_Y])
        total -= gravity[0] * x + gravity[1] * y
    return total
