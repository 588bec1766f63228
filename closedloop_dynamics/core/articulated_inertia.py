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

from .compiled import choose, inlined
from .types import (
    ARMATURE, DINV, DOF, DX, DY, DZ, FX, FY, FZ, HX, HY, IZZ, MXX, MXY, MYY, PARENT, PRISMATIC,
    REVOLUTE, RHS, RX, RY, SX, SY, TYPE, UX, UY, UZ)


@inlined
def _inverse(pivot, massless):
    """Return one over a pivot, 0 for none where there may be none."""
    if massless:
        return choose(pivot > 0.0, 1.0 / choose(pivot > 0.0, pivot, 1.0), 0.0)
    return 1.0 / pivot


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
        After ``kinematics.outward``; FZ, FX, FY may have been reduced by applied forces. The
        factors and RHS are written: RHS = D times the joint's own share of I^-1 phi.
    massless : bool
        Whether joints may carry no inertia; DINV is 0 there.

    """
    tree, constant, body = model.tree, model.body, work.body
    for i in range(tree.shape[0] - 1, 0, -1):
        p = tree[i, PARENT]
        rx, ry = body[i, RX], body[i, RY]
        hx, hy = body[i, HX], body[i, HY]
        mxx, mxy, myy = body[i, MXX], body[i, MXY], body[i, MYY]
        fz, fx, fy = body[i, FZ], body[i, FX], body[i, FY]
        torque = tau[tree[i, DOF]]
        kind = tree[i, TYPE]
        if kind == REVOLUTE:
            # The joint takes the whole first row and column: what is left is a 2 x 2 mass.
            inverse = _inverse(body[i, IZZ], massless)
            right = torque - fz
            gx, gy = hx * inverse, hy * inverse
            body[i, DINV] = inverse
            body[i, RHS] = right
            mxx -= hx * gx
            mxy -= hx * gy
            myy -= hy * gy
            fx += gx * right
            fy += gy * right
            hx = rx * mxy - ry * mxx
            hy = rx * myy - ry * mxy
            izz = rx * hy - ry * hx
            fz = torque
        else:
            izz = body[i, IZZ]
            if kind == PRISMATIC:
                sx, sy = body[i, SX], body[i, SY]
                uz = hx * sx + hy * sy
                ux = mxx * sx + mxy * sy
                uy = mxy * sx + myy * sy
                inverse = _inverse(sx * ux + sy * uy + constant[i, ARMATURE], massless)
                right = torque - sx * fx - sy * fy
            else:
                uz, ux, uy = izz, hx, hy
                inverse = _inverse(izz + constant[i, ARMATURE], massless)
                right = torque - fz
            body[i, DINV] = inverse
            body[i, UZ] = uz
            body[i, UX] = ux
            body[i, UY] = uy
            body[i, RHS] = right
            izz -= uz * uz * inverse
            hx -= uz * ux * inverse
            hy -= uz * uy * inverse
            mxx -= ux * ux * inverse
            mxy -= ux * uy * inverse
            myy -= uy * uy * inverse
            share = inverse * right
            fz += uz * share
            fx += ux * share
            fy += uy * share
            # Shift to the parent's origin.
            izz += 2.0 * (rx * hy - ry * hx) + rx * (rx * myy - ry * mxy) - ry * (
                rx * mxy - ry * mxx)
            hx += rx * mxy - ry * mxx
            hy += rx * myy - ry * mxy
        body[p, IZZ] += izz
        body[p, HX] += hx
        body[p, HY] += hy
        body[p, MXX] += mxx
        body[p, MXY] += mxy
        body[p, MYY] += myy
        body[p, FZ] += fz + rx * fy - ry * fx
        body[p, FX] += fx
        body[p, FY] += fy


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
    tree, body = model.tree, work.body
    for i in range(1, tree.shape[0]):
        p = tree[i, PARENT]
        dz = body[p, DZ]
        dx = body[p, DX] - dz * body[i, RY]
        dy = body[p, DY] + dz * body[i, RX]
        kind = tree[i, TYPE]
        if kind == REVOLUTE:
            turn = (body[i, RHS] - body[i, HX] * dx - body[i, HY] * dy) * body[i, DINV]
            qdd[tree[i, DOF]] = turn - dz
            dz = turn
        else:
            acceleration = (body[i, RHS] - body[i, UZ] * dz - body[i, UX] * dx
                            - body[i, UY] * dy) * body[i, DINV]
            qdd[tree[i, DOF]] = acceleration
            if kind == PRISMATIC:
                dx += body[i, SX] * acceleration
                dy += body[i, SY] * acceleration
            else:
                dz += acceleration
        body[i, DZ] = dz
        body[i, DX] = dx
        body[i, DY] = dy
