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
from ..types import BODY_A, BODY_B, CUT_NUMBER, DOF, KEPT, PARENT, POSSIBLE

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

    """

    def __init__(self, model):
        """Count the equations."""
        self.model, self.recursion = model, None
        cuts = model.cut[np.argsort(model.cut[:, CUT_NUMBER])][:, [POSSIBLE, KEPT]].tolist()
        places = [[n for n in range(6) if possible >> n & 1] for possible, _ in cuts]
        self.counts = [len(some) for some in places]
        self.kept = np.array([kept >> n & 1 for some, (_, kept) in zip(places, cuts)
                              for n in some], dtype=bool)
        self._first = np.cumsum([0, *self.counts])
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
        for _, row, equation in self._equations():
            found[:, row] = equation.value, equation.rate, equation.bias
        return found

    def _equations(self):
        """Yield each equation with its cut joint and its place in the mechanism's order."""
        for a, cut in enumerate(self.model.cut):
            for n, equation in enumerate(self.recursion.closures(self.model, a)):
                yield a, self._first[cut[CUT_NUMBER]] + n, equation

    def jacobian(self):
        """
        Return J = d psi / d q.

        Returns
        -------
        ndarray, shape (nc, nv)

        """
        jac = np.zeros((self.nc, self.nv))
        for a, row, equation in self._equations():
            first, second = self.model.cut[a, [BODY_A, BODY_B]]
            if equation.in_joints:
                for i, force in equation.in_joints:
                    jac[row, self.model.tree[i, DOF]] = force
            else:
                jac[row] = self._inward({first: equation.on_a, second: equation.on_b})
        return self._own_axes(jac.T).T

    def _inward(self, wrenches):
        """Return the shares (nv,) in the joints of wrenches on bodies."""
        model, shares = self.model, np.zeros(self.nv)
        total = np.zeros((len(model.tree), 6))
        for body, wrench in wrenches.items():
            total[body] += wrench
        for i in range(len(model.tree) - 1, 0, -1):
            motion = self.recursion.motion[i]
            shares[model.tree[i, DOF]] = np.dot(motion.axis, total[i])
            parent = total[model.tree[i, PARENT]]
            parent += total[i]
            parent[:3] += np.cross(motion.offset, total[i, 3:])
        return shares

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
        for i, (_, parent, armature, rotor) in self._rotors():
            dof = model.tree[i, DOF]
            gim[dof, dof] += armature
            coupling = rotor @ tips[parent, :3]
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
        forces = dict(enumerate(self.recursion.force))
        del forces[0]
        shares = self._own_axes(self._inward(forces))
        for i, (motion, _, _, rotor) in self._rotors():
            shares[self.model.tree[i, DOF]] += rotor @ motion.spin_rate
        return shares

    def _rotors(self):
        """Yield rows of joints with rotors: motion and row of the carrier, armature, momentum."""
        for i, body in enumerate(self.recursion.bodies):
            if i > 0 and body.armature is not None:
                parent = self.model.tree[i, PARENT]
                yield i, (self.recursion.motion[parent], parent, body.armature,
                          np.array(self.recursion.rotor[i]))

    def energies(self):
        """
        Return kinetic energy, and potential energy in gravity, zero at the world's origin [J].

        Returns
        -------
        tuple of 2 floats

        """
        kinetic = potential = 0.0
        for body, motion, inertia in list(zip(
                self.recursion.bodies, self.recursion.motion, self.recursion.inertia))[1:]:
            rates = np.array(motion.spin + motion.velocity)
            kinetic += 0.5 * rates @ np.array(inertia) @ rates
            moment = body.mass * np.array(motion.origin) + np.array(motion.frame) @ body.moment
            potential -= self.model.gravity @ moment
        for i, (motion, _, armature, rotor) in self._rotors():
            rate = self._rates[self.model.tree[i, DOF]]
            kinetic += rate * (0.5 * armature * rate + rotor @ motion.spin)
        return float(kinetic), float(potential)

    def cut_wrenches(self, lam):
        """
        Return what body B exerts on body A at each cut joint, at the cut point of A.

        Parameters
        ----------
        lam : ndarray, shape (nc,)
            Multipliers.

        Returns
        -------
        ndarray, shape (number of cuts, 6)
            Moment, then force, in world axes, in the mechanism's order [N m, N].

        """
        found = np.zeros((len(self.model.cut), 6))
        for a, row, equation in self._equations():
            found[a] += lam[row] * np.array(equation.on_a)
        for wrench, cut, point in zip(found, self.model.cut, self.model.cut_point):
            frame = np.array(self.recursion.motion[cut[BODY_A]].frame)
            wrench[:3] -= np.cross(frame @ point[space.POINT_A:space.POINT_A + 3], wrench[3:])
        return found[np.argsort(self.model.cut[:, CUT_NUMBER])]

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

    def of_all(self, lam):
        """
        Return the least multipliers of all equations that do what those of the kept ones do.

        Parameters
        ----------
        lam : ndarray
            Of the kept equations.

        Returns
        -------
        ndarray, shape (nc,)

        """
        if self.kept.all():
            return lam
        jac = self.jacobian()
        return np.linalg.lstsq(jac.T, jac[self.kept].T @ lam, rcond=DEPENDENT)[0]

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
