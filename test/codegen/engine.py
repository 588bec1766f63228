# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The compiled kernels on one mechanism, called one by one; what they write is copied out.

In the plane and in space alike, each with the twin that it is compared with.
"""

from closedloop_dynamics.engine.types import ALPHA, NO_RESPONSES, OMEGA, PX, PY, REDUCED, VX, VY
from closedloop_dynamics.kinematics.modeling import mechanism_arrays
from closedloop_dynamics.mechanism.decomposition import decompose
from closedloop_dynamics.simulation.system import build_system
import numpy as np

from ..reference import dense
from ..reference.numbers import Numbers
from ..reference.spatial_machines import GRAVITY


class PlanarTwin:
    """What a mechanism in the plane does, by body Jacobians and Lagrange's equations."""

    def __init__(self, mechanism, model, gravity):
        self._mechanism, self._gravity = mechanism, gravity

    def closure(self, q, qd):
        """Return psi, J qd, Jdot qd."""
        return (dense.closure(self._mechanism, q), self.jacobian(q) @ qd,
                dense.constraint_bias(self._mechanism, q, qd))

    def jacobian(self, q):
        """Return the constraint Jacobian."""
        return dense.closure_jacobian(self._mechanism, q)

    def generalized_inertia_matrix(self, q):
        """Return the generalized inertia matrix."""
        return dense.generalized_inertia_matrix(self._mechanism, q)

    def bias_force(self, q, qd):
        """Return velocity products and gravity in the joints."""
        return dense.bias_force(self._mechanism, q, qd, self._gravity)

    def energies(self, q, qd):
        """Return (kinetic, potential) energy."""
        return (dense.kinetic_energy(self._mechanism, q, qd),
                dense.potential_energy(self._mechanism, q, self._gravity))


class SpatialTwin:
    """The same of a mechanism in space, by its recursions on numbers."""

    def __init__(self, mechanism, model, gravity):
        self._numbers = Numbers(model)

    def _at(self, q, qd=None):
        self._numbers.move(q, qd)
        return self._numbers

    def closure(self, q, qd):
        """Return psi, J qd, Jdot qd."""
        return self._at(q, qd).closures()

    def jacobian(self, q):
        """Return the constraint Jacobian."""
        return self._at(q).jacobian()

    def generalized_inertia_matrix(self, q):
        """Return the generalized inertia matrix."""
        return self._at(q).inertia()

    def bias_force(self, q, qd):
        """Return velocity products and gravity in the joints."""
        return self._at(q, qd).bias_force()

    def energies(self, q, qd):
        """Return (kinetic, potential) energy."""
        return self._at(q, qd).energies()

    def forward_dynamics(self, q, qd, tau):
        """Return (qdd, lam)."""
        return self._at(q, qd).accelerations(tau, 0.0)[:2]


class Engine:
    """
    A model with its workspace.

    Parameters
    ----------
    mechanism : Mechanism
    gravity : sequence of 2 or 3 floats, optional
        [m/s^2]; along -y, in space along -z when not given.
    baumgarte : float
        Decay rate [1/s].
    unrolled : bool, optional
        As for ``build_system``; in space, where code takes seconds to compile, False.

    """

    def __init__(self, mechanism, gravity=None, baumgarte=0.0, unrolled=None):
        planar = mechanism.planar
        if gravity is None:
            gravity = dense.EARTH if planar else GRAVITY
        self.decomposition = decompose(mechanism) if planar else None
        self.model, placements, _ = mechanism_arrays(
            mechanism, gravity, self.decomposition)
        self.body_row = {name: one.row for name, one in placements.items()}
        self.system = build_system(
            self.model, baumgarte, unrolled=unrolled if planar else bool(unrolled))
        self.work = self.system.work
        self.moved = mechanism.coordinates.moved
        self.nv, self.nc = len(self.model.tree) - 1, len(self.model.column) - 1
        self.twin = (PlanarTwin if planar else SpatialTwin)(mechanism, self.model, gravity)

    def forward_dynamics(self, q, qd, tau):
        """Return (qdd, lam)."""
        self.system.tau[:] = tau
        self.system.native.evaluate(q, qd)
        return self.system.qdd.copy(), self.system.lam.copy()

    def move(self, q, qd=None):
        """Update poses and velocities."""
        self.model.outward(q, np.zeros(self.nv) if qd is None else qd, self.work)

    def pose(self, name):
        """Return x, y, alpha of a body after ``move``."""
        return self.work.body[self.body_row[name], [PX, PY, ALPHA]]

    def point(self, name, position):
        """Return (place, velocity) of a point on a body after ``move``."""
        row, places = self.body_row[name], np.empty((1, 2))
        self.work.place_points(np.array([row]), np.array([position], dtype=float), places)
        place = places[0]
        body = self.work.body[row]
        x, y = place - body[[PX, PY]]
        return place, body[[VX, VY]] + body[OMEGA] * np.array((-y, x))

    def closure(self, q, qd):
        """Return psi, J qd, Jdot qd."""
        self.move(q, qd)
        self.model.update(self.work, NO_RESPONSES)
        return [self.in_user_order(values) for values in (
            self.work.closure, self.work.closure_rate, self.work.bias)]

    def in_user_order(self, values):
        """Return closure-sized values in the order of the mechanism's cut joints."""
        out = np.empty(self.nc)
        self.model.to_user_order(values, out)
        return out

    def jacobian(self, q):
        """Return the constraint Jacobian."""
        self.move(q)
        jac = np.full((self.nc, self.nv), np.nan)
        self.model.constraint_jacobian(self.work, jac)
        return jac

    def generalized_inertia_matrix(self, q):
        """Return the generalized inertia matrix."""
        self.move(q)
        gim = np.full((self.nv, self.nv), np.nan)
        self.model.generalized_inertia_matrix(self.work, gim)
        return gim

    def tree_torque(self, q, qd, qdd):
        """Return I qdd + c."""
        self.move(q, qd)
        out = np.full(self.nv, np.nan)
        self.model.tree_torque(self.work, qdd, out)
        return out

    def energies(self, q, qd):
        """Return (kinetic, potential) energy."""
        self.move(q, qd)
        out = np.empty(2)
        self.model.energies(self.work, qd, out)
        return tuple(out.tolist())

    def constraint_matrix(self, q):
        """Return (J I^-1 J^T as assembled, its factor L D, 1/D), dense, in elimination order."""
        self.move(q)
        self.model.inward(np.zeros(self.nv), self.work, False)
        self.model.update(self.work, REDUCED)
        self.model.assemble(self.work)
        matrix = self.lower_triangle()
        self.model.factorize(self.work)
        return (matrix + np.tril(matrix, -1).T, self.lower_triangle(),
                self.work.pivot_inverse.copy())

    def lower_triangle(self):
        """Return the entries of ``work.factor`` as a dense matrix."""
        matrix = np.zeros((self.nc, self.nc))
        for column in range(self.nc):
            entries = slice(self.model.column[column], self.model.column[column + 1])
            matrix[self.model.row[entries], column] = self.work.factor[entries]
        return matrix
