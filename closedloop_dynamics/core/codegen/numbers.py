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
A mechanism in space on numbers: what is asked for too rarely to generate code for it.

Places, Jacobians, energies and forces, by the same recursions that code is generated from, and
what stands in where the elimination fails: motion and least forces from equations that may
depend on one another.

"""

import numpy as np

from . import space
from .spatial import Recursion
from .vectors import transpose
from ..types import CUT_NUMBER, CUT_TYPE, DOF, KEPT, PARENT, POSSIBLE

# Singular values of the scaled Jacobian below this times the largest belong to equations that
# repeat others.
DEPENDENT = 1e-9


class Numbers:
    """
    The recursions of one model, on numbers.

    Parameters
    ----------
    model : Model
        Constant arrays of a mechanism in space. They are read anew for each state. Equations are
        all that do not always hold.

    Attributes
    ----------
    recursion : Recursion
        After ``move``.
    counts : list of int
        How many equations each cut joint has, in the mechanism's order.
    kept : ndarray of bool, shape (nc,)
        Which equations the elimination works on, too.
    groups : ndarray of int, shape (nc,)
        Numbers that the places, and the angles, that one cut joint holds have in common.

    """

    def __init__(self, model):
        """Count the equations."""
        self.model, self.recursion = model, None
        cuts = model.cut[np.argsort(model.cut[:, CUT_NUMBER])][:, [POSSIBLE, KEPT]].tolist()
        places = [[n for n in range(6) if possible >> n & 1] for possible, _ in cuts]
        self.counts = [len(some) for some in places]
        self.kept = np.array([kept >> n & 1 for some, (_, kept) in zip(places, cuts)
                              for n in some], dtype=bool)
        kinds = model.cut[np.argsort(model.cut[:, CUT_NUMBER]), CUT_TYPE]
        groups = [(a, space.group_of(kind, n))
                  for a, (kind, some) in enumerate(zip(kinds, places)) for n in some]
        order = {group: number for number, group in enumerate(dict.fromkeys(groups))}
        self.groups = np.array([order[group] for group in groups], dtype=int)
        self.nv, self.nc = len(model.tree) - 1, sum(self.counts)

    def move(self, q, qd=None):
        """
        Take a state.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Coordinates.
        qd : ndarray, shape (nv,), optional
            Rates; none when not given.

        """
        model = self.model
        self._rates = np.zeros(self.nv) if qd is None else qd
        self.recursion = Recursion(
            space.bodies(model, model.body.astype(object)),
            space.cuts(model, model.cut_point.astype(object), POSSIBLE),
            tuple(model.gravity.tolist()))
        rates = [0.0] * self.nv if qd is None else qd.tolist()
        self.recursion.outward(model, q.tolist(), rates, None)

    def closures(self):
        """
        Return psi, J qd and Jdot qd, in the mechanism's order.

        Returns
        -------
        ndarray, shape (3, nc)

        """
        found = np.zeros((3, self.nc))
        for row, _, equation in space.equations(self.recursion, self.model):
            found[:, row] = equation.value, equation.rate, equation.bias
        return found

    def jacobian(self):
        """
        Return J = d psi / d q.

        Returns
        -------
        ndarray, shape (nc, nv)

        """
        jac = np.zeros((self.nc, self.nv))
        for place, a, equation in space.equations(self.recursion, self.model):
            jac[place] = self.recursion.row(self.model, a, equation)
        return jac

    def _own_axes(self, values):
        """Turn rows of values for spherical joints from the world's axes into the bodies'."""
        for frame, places in self.recursion.balls(self.model):
            values[places] = np.array(transpose(frame)) @ values[places]
        return values

    def inertia(self):
        """
        Return the generalized inertia matrix of the spanning tree.

        Returns
        -------
        ndarray, shape (nv, nv)

        """
        model, nv = self.model, self.nv
        tips = np.zeros((len(model.tree), 6, nv))
        force = np.zeros((len(model.tree), 6, nv))
        for i in range(1, len(model.tree)):
            motion, parent = self.recursion.motion[i], tips[model.tree[i, PARENT]]
            tips[i] = parent
            tips[i, 3:] += np.cross(parent[:3], motion.offset, axisa=0, axisc=0)
            tips[i, :, model.tree[i, DOF]] += motion.axis
            force[i] = np.array(self.recursion.inertia[i]) @ tips[i]
        gim = sum(tips[i].T @ force[i] for i in range(1, len(model.tree)))
        for i, body in enumerate(self.recursion.bodies):
            if i > 0 and body.armature is not None:
                dof = model.tree[i, DOF]
                gim[dof, dof] += body.armature
                coupling = self.recursion.rotor[i] @ tips[model.tree[i, PARENT], :3]
                gim[dof] += coupling
                gim[:, dof] += coupling
        return self._own_axes(self._own_axes(gim).T)

    def bias_force(self):
        """
        Return the joint forces that the state takes where nothing accelerates, with gravity.

        Returns
        -------
        ndarray, shape (nv,)

        """
        return np.array(self.recursion.joint_wrenches(self.model, np.zeros(self.nv))[1])

    def energies(self):
        """
        Return kinetic energy, and potential energy in gravity, zero at the world's origin [J].

        Returns
        -------
        tuple of 2 floats

        """
        return tuple(map(float, self.recursion.energies(self.model, self._rates)))

    def point(self, row, place):
        """
        Return the place of a point of a row's frame in the world.

        Parameters
        ----------
        row : int
            Of the tree; 0 is the ground.
        place : sequence of 3 floats
            [m].

        Returns
        -------
        ndarray, shape (3,)

        """
        motion = self.recursion.motion[row]
        return np.array(motion.origin) + np.array(motion.frame) @ np.array(place)

    def of_kept(self, lam):
        """
        Return multipliers of the kept equations that do what those of all do, where they can.

        Parameters
        ----------
        lam : ndarray, shape (nc,)
            Of all equations.

        Returns
        -------
        ndarray

        """
        if self.kept.all():
            return lam
        jac = self.jacobian()
        return np.linalg.lstsq(jac[self.kept].T, jac.T @ lam, rcond=DEPENDENT)[0]

    def accelerations(self, tau, baumgarte):
        """
        Return accelerations and the least multipliers, where equations may be dependent.

        Parameters
        ----------
        tau : ndarray, shape (nv,)
            Joint forces.
        baumgarte : float
            Decay rate of closure errors [1/s].

        Returns
        -------
        qdd : ndarray, shape (nv,)
        lam : ndarray, shape (nc,)
        rank : int
            How many equations are independent.

        """
        psi, rate, bias = self.closures()
        right = -bias - baumgarte * (2.0 * rate + baumgarte * psi)
        return self._solve(right, tau - self.bias_force())

    def correction(self, error):
        """
        Return the least change, in the mass metric, that takes away an error of the equations.

        Parameters
        ----------
        error : ndarray, shape (nc,)
            psi or J qd.

        Returns
        -------
        ndarray, shape (nv,)

        """
        return self._solve(-error, np.zeros(self.nv))[0]

    def _solve(self, right, force):
        """Solve I x = force + J^T lam, J x = right, in the part of J that is independent."""
        jac, factor = self.jacobian(), np.linalg.cholesky(self.inertia())
        # In coordinates in which the inertia is 1.
        weighted = np.linalg.solve(factor, jac.T).T
        left, singular, across = np.linalg.svd(weighted, full_matrices=False)
        rank = int(np.sum(singular > DEPENDENT * singular.max(initial=0.0)))
        left, singular, across = left[:, :rank], singular[:rank], across[:rank]
        free = np.linalg.solve(factor, force)
        impulse = left.T @ right / singular - across @ free
        return (np.linalg.solve(factor.T, free + across.T @ impulse), left @ (impulse / singular),
                rank)
