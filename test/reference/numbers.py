# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A mechanism in space on numbers, without any generated code.

Places, Jacobians, energies and forces, by the same recursions that code is generated from, and
motion and least forces from equations that may depend on one another.
"""

from closedloop_dynamics.codegen import space
from closedloop_dynamics.codegen.equations import Equations, with_all_equations
from closedloop_dynamics.codegen.rows import by_column, columns_of, six
from closedloop_dynamics.codegen.spatial import at_parent, Recursion
from closedloop_dynamics.codegen.vectors import (
    add, cross, dot, scale, subtract, times, transpose, ZERO)
from closedloop_dynamics.engine.types import BODY_A, BODY_B, CUT_ROW, DOF, PARENT
import numpy as np

# Singular values of the scaled Jacobian below this times the largest belong to equations that
# repeat others.
DEPENDENT = 1e-9


def equations(recursion, model):
    """
    Yield the equations of a model.

    Parameters
    ----------
    recursion : Recursion
        In a state.
    model : Model
        Constant arrays of the mechanism.

    Yields
    ------
    place : int
        In the mechanism's order.
    a : int
        Cut joint, in the model's order.
    equation : Closure

    """
    for a, first in enumerate(model.cut[:, CUT_ROW]):
        for n, equation in enumerate(recursion.closures(model, a)):
            yield first + n, a, equation


class OnNumbers(Recursion):
    """The recursions, and what follows from them, on numbers."""

    def shares(self, model, wrenches):
        """
        Return the shares in the joints of wrenches on bodies, at the bodies' origins.

        Parameters
        ----------
        model : Model
            Constant arrays of the mechanism.
        wrenches : dict of int to tuple of 6
            By row.

        Returns
        -------
        list, length nv

        """
        found, wrenches = (len(self.bodies) - 1) * [0.0], dict(wrenches)
        for i in range(len(self.bodies) - 1, 0, -1):
            if i in wrenches:
                motion, parent = self.motion[i], model.tree[i, PARENT]
                found[model.tree[i, DOF]] = dot(motion.axis, wrenches[i])
                wrenches[parent] = add(
                    wrenches.get(parent, 2 * ZERO), at_parent(wrenches[i], motion.offset))
        self.about_own(model, found)
        return found

    def row(self, model, a, equation):
        """Return the row of the Jacobian of an equation of a cut joint, length nv."""
        if equation.in_joints:
            found = (len(self.bodies) - 1) * [0.0]
            for i, force in equation.in_joints:
                found[model.tree[i, DOF]] = force
            return found
        return self.shares(model, {model.cut[a, BODY_A]: equation.on_a,
                                   model.cut[a, BODY_B]: equation.on_b})

    def energies(self, model, qd):
        """Return kinetic energy, and potential energy in gravity, zero at the world's origin."""
        kinetic, moments = 0.0, ZERO
        for i, body in enumerate(self.bodies[1:], start=1):
            motion, carrier = self.motion[i], self.motion[model.tree[i, PARENT]]
            rates = motion.spin + motion.velocity
            kinetic = kinetic + 0.5 * dot(rates, times(self.inertia[i], rates))
            moments = add(moments, add(scale(motion.origin, body.mass),
                                       times(motion.frame, body.moment)))
            if body.armature is not None:
                rate = qd[model.tree[i, DOF]]
                kinetic = kinetic + rate * (
                    0.5 * body.armature * rate + dot(self.rotor[i], carrier.spin))
        return kinetic, dot(self.ground.acceleration, moments)

    def joint_wrenches(self, model, qdd, lam=None):
        """
        Return what parents exert on bodies, at the bodies' origins, for accelerations.

        Parameters
        ----------
        model : Model
            Constant arrays of the mechanism.
        qdd : sequence, length nv
            Joint accelerations.
        lam : sequence, optional
            Multipliers of the equations of ``cuts``, in the mechanism's order; without, loops are
            open.

        Returns
        -------
        wrenches : list of tuples of 6
            None for the ground.
        forces : list, length nv
            Of the joints: what these accelerations take beside the multipliers.

        """
        qdd, wrenches = self.about_world(model, qdd), list(self.force)
        accelerations = [2 * ZERO]
        wrenches[0] = 2 * ZERO
        for i in range(1, len(self.bodies)):
            motion, parent, dof = self.motion[i], *model.tree[i, [PARENT, DOF]]
            before = accelerations[parent]
            after = add(before[:3] + add(before[3:], cross(before[:3], motion.offset)),
                        scale(motion.axis, qdd[dof]))
            accelerations.append(after)
            wrenches[i] = add(wrenches[i], times(self.inertia[i], after))
            wrenches[parent] = add(wrenches[parent], scale(self.rotor[i], qdd[dof]) + ZERO)
        for a, cut in enumerate(model.cut if lam is not None else ()):
            for row, equation in enumerate(self.closures(model, a)):
                force = lam[cut[CUT_ROW] + row]
                for body, wrench in ((cut[BODY_A], equation.on_a), (cut[BODY_B], equation.on_b)):
                    wrenches[body] = subtract(wrenches[body], scale(wrench, force))
        forces = (len(self.bodies) - 1) * [0.0]
        for i in range(len(self.bodies) - 1, 0, -1):
            motion, parent, dof = self.motion[i], *model.tree[i, [PARENT, DOF]]
            forces[dof] = dot(motion.axis, wrenches[i])
            if self.bodies[i].armature is not None:
                carried = add(self.motion[parent].spin_rate, accelerations[parent][:3])
                forces[dof] = forces[dof] + self.bodies[i].armature * qdd[dof] + dot(
                    self.rotor[i], carried)
            wrenches[parent] = add(wrenches[parent], at_parent(wrenches[i], motion.offset))
        self.about_own(model, forces)
        return [None, *wrenches[1:]], forces

    def cut_wrench(self, model, a, lam):
        """Return what body B exerts on body A at a cut joint, at the cut point of A."""
        wrench = 2 * ZERO
        for force, equation in zip(lam, self.closures(model, a)):
            wrench = add(wrench, scale(equation.on_a, force))
        if self.cuts[a].coupling is not None:
            return wrench
        arm = times(self.motion[model.cut[a, BODY_A]].frame, self.cuts[a].point_a)
        return subtract(wrench[:3], cross(arm, wrench[3:])) + wrench[3:]


class Numbers:
    """
    The recursions of one model, on numbers.

    Parameters
    ----------
    model : Model
        Constant arrays of a mechanism in space. They are read again for each state. Equations are
        all that do not always hold.

    Attributes
    ----------
    recursion : Recursion
        After ``move``.
    kept : ndarray of bool, shape (nc,)
        Which equations the elimination works on, too.

    """

    def __init__(self, model):
        """Count the equations."""
        self.model, self.recursion = with_all_equations(model), None
        self.kept = Equations(model).kept
        self.nv, self.nc = len(model.tree) - 1, len(self.kept)

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
        self.recursion = OnNumbers(
            space.bodies(model, model.body.astype(object)),
            space.cuts(model, model.cut_point.astype(object)),
            tuple(model.gravity.tolist()))
        rates = [0.0] * self.nv if qd is None else qd.tolist()
        self.recursion.outward(model, q.tolist(), rates, None)

    def write(self, body):
        """Write motion and forces into rows as those of ``Workspace.body``."""
        for row, motion, force in zip(body, self.recursion.motion, self.recursion.force):
            columns = columns_of(motion, space.MOTION)
            if force is not None:
                columns.update(by_column(force, space.FORCES))
            for place, value in columns.items():
                row[place] = value

    def read(self, body):
        """Take the forces from these rows, as effects have left them."""
        self.recursion.force[1:] = [six(row, space.FORCES) for row in body[1:]]

    def closures(self):
        """
        Return psi, J qd and Jdot qd, in the mechanism's order.

        Returns
        -------
        ndarray, shape (3, nc)

        """
        found = np.zeros((3, self.nc))
        for row, _, equation in equations(self.recursion, self.model):
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
        for place, a, equation in equations(self.recursion, self.model):
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
