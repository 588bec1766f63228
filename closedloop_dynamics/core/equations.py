# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Quantities of a state for Python: dense matrices, energies, forces."""

import numpy as np

from .codegen import joint_kernels
from .codegen.workspace import allocate
from .manifold import manifold_of
from .ranks import null_space
from .types import (
    CUT_COUPLING, CUT_NUMBER, CUT_ROW, CUT_TYPE, DOF, KEPT, NO_RESPONSES, number_of_coordinates,
    PATH_A, PATH_COMMON, POSSIBLE, PRESCRIBED_PLACE, PRESCRIBED_TURN, PRISMATIC, ROW, ROWS, TYPE)
from ..engine import native


def with_all_equations(model):
    """
    Return a model with the equations, too, that the elimination leaves out.

    Itself where nothing is left out.
    """
    if (model.cut[:, KEPT] == model.cut[:, POSSIBLE]).all():
        return model
    if model.whole is None:
        cut = model.cut.copy()
        cut[:, KEPT] = cut[:, POSSIBLE]
        joint_kernels.arrays_of(model).number_equations(cut)
        model.whole = model.with_cut(cut)
    return model.whole


class Equations:
    """
    The equations of motion of a mechanism as matrices, those that repeat others included.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism; they may be changed later.

    Attributes
    ----------
    model : Model
        With all equations.
    work : Workspace
        Of ``model``; poses, velocities and bias forces of the state that ``move`` took.
    nv, nc : int
        Numbers of rates and of all equations.
    counts : list of int
        How many equations each cut joint has, in the mechanism's order.
    kept : ndarray of bool, shape (nc,)
        Which equations the elimination works on, too, in the mechanism's order.
    groups : ndarray of int, shape (nc,)
        Numbers that the places, and the angles, that one cut joint holds have in common.
    places : ndarray of bool, shape (nc,)
        Which equations hold places.

    """

    def __init__(self, model):
        self.model = with_all_equations(model)
        self.work, self._constants = allocate(self.model), self._present_constants()
        self._connected = joint_kernels.structure(self.model)
        self.nv, self.nc = len(model.tree) - 1, len(self.work.closure)
        by_user = np.argsort(model.cut[:, CUT_NUMBER])
        self._order = np.zeros(self.nc, dtype=int)
        for cut in self.model.cut:
            rows = np.arange(cut[ROWS])
            self._order[cut[CUT_ROW] + rows] = cut[ROW] + rows
        self.counts = self.model.cut[by_user, ROWS].tolist()
        self._cut_of = np.repeat(by_user, self.counts)
        self.kept, groups = np.ones(self.nc, dtype=bool), []
        group_of = joint_kernels.arrays_of(model).group_of
        for number, (cut, count) in enumerate(zip(model.cut[by_user], self.counts)):
            possible = [n for n in range(6) if cut[POSSIBLE] >> n & 1]
            self.kept[len(groups):len(groups) + count] = [cut[KEPT] >> n & 1 for n in possible]
            groups += [(number, group_of(cut[CUT_TYPE], n)) for n in possible]
        self.places = np.array([kind == 0 for _, kind in groups], dtype=bool)
        order = {group: number for number, group in enumerate(dict.fromkeys(groups))}
        self.groups = np.array([order[group] for group in groups], dtype=int)
        nq = number_of_coordinates(model)
        state = np.zeros(nq + self.nv)
        self._q, self._qd = state[:nq], state[nq:]
        self._jacobian = None
        self._move = native.bind('outward', self.model, self._q, self._qd, self.work)
        self._close = native.bind('update', self.model, self.work, NO_RESPONSES)
        self._largest = native.bind('largest', self.work.closure)
        self._sizes = np.zeros(len(model.cut))
        self._measure_loops = native.bind('loop_sizes', self.model, self._sizes)
        self._closed = np.zeros(nq)
        self._close_loops = native.bind(
            'close_loops', self.model, self.work, manifold_of(self.model),
            np.zeros((self.nc, self.nv)), np.zeros((self.nv, self.nv)), self._closed)

    def _present_constants(self):
        """Return the constants that may decide which code serves which body."""
        return self.model.tree.tobytes(), self.model.body.tobytes()

    def _connect(self):
        """Find the code for the bodies as they are, where it may be another."""
        present = self._present_constants()
        if self._constants == present:
            return
        self._constants, structure = present, joint_kernels.structure(self.model)
        if self._connected != structure:
            joint_kernels.connect(self.model)
            self._connected = structure

    def move(self, q, qd=None):
        """Set the state, coordinates and rates, zero when not given; return itself."""
        self._connect()
        self._q[:], self._qd[:] = q, 0.0 if qd is None else qd
        self._move()
        self._jacobian = None
        return self

    def closures(self):
        """Return psi, J qd and Jdot qd, in the mechanism's order, shape (3, nc)."""
        self._close()
        return np.array([self.work.closure, self.work.closure_rate, self.work.bias])[
            :, self._order]

    def closure_error(self):
        """Return the largest closure error of positions [m or rad]."""
        self._close()
        return self._largest()

    def closed(self, q, free, error, limit):
        """
        Return coordinates that close the loops, given some that nearly do, where that is plain.

        ``free``: freedoms that may change, by the least in the mass metric; ``error``: closure
        error that counts as closed; ``limit``: the most that one correction changes a coordinate
        [m or rad]. None where they do not close, or equations may depend on one another on the
        way.
        """
        self._connect()
        self._closed[:], self._jacobian = q, None
        if not self._close_loops(free, error, limit):
            return None
        return self._closed.copy()

    def jacobian(self):
        """Return J = d psi / d q, shape (nc, nv)."""
        if self._jacobian is None:
            self._jacobian = np.zeros((self.nc, self.nv))
            native.constraint_jacobian(self.model, self.work, self._jacobian)
        return self._jacobian

    def units(self):
        """
        Return what closure errors, shape (nc,), and coordinates, (nv,), are counted in.

        Angles in radians, places and slides in sizes of the loops that they belong to [m],
        couplings, which have factors of any size, in what they change by.
        """
        model = self.model
        self._measure_loops()
        columns = np.ones(self.nv)
        slides = model.tree[1:, TYPE] == PRISMATIC
        columns[model.tree[1:, DOF][slides]] = 0.0
        for cut, size in zip(model.cut, self._sizes):
            own = model.path_body[cut[PATH_A]:cut[PATH_COMMON]]
            moved = model.tree[own[model.tree[own, TYPE] == PRISMATIC], DOF]
            columns[moved] = np.maximum(columns[moved], size)
        columns[columns == 0.0] = self._sizes.max(initial=0.0) or 1.0
        rows = np.where(self.places, self._sizes[self._cut_of], 1.0)
        kind = model.cut[self._cut_of, CUT_TYPE]
        coupled = (kind >= CUT_COUPLING) & (kind != PRESCRIBED_PLACE) & (kind != PRESCRIBED_TURN)
        if coupled.any():
            changes = np.abs(self.jacobian()[coupled] * columns).max(axis=1, initial=0.0)
            rows[coupled] = np.where(changes > 0.0, changes, 1.0)
        return rows, columns

    def dimensionless(self, columns=None):
        """
        Return J in ``units``, shape (nc, nv): what ranks are decided on.

        Entries are about 1 where a joint moves an equation at all, rounding is far below.
        ``columns``, shape (nv,): units of the coordinates that are others.
        """
        rows, own = self.units()
        return self.jacobian() * (own if columns is None else columns) / rows[:, np.newaxis]

    def free_motions(self):
        """Return rates that keep all equations, rows that are orthonormal in ``units``."""
        return null_space(self.dimensionless()) * self.units()[1]

    def inertia(self):
        """Return the generalized inertia matrix of the spanning tree, shape (nv, nv)."""
        gim = np.zeros((self.nv, self.nv))
        native.generalized_inertia_matrix(self.model, self.work, gim)
        # That has used up the bodies' own inertias.
        self._move()
        return gim

    def energies(self):
        """Return kinetic energy, and that in gravity, zero at the world's origin [J]."""
        found = np.zeros(2)
        native.energies(self.model, self.work, self._qd, found)
        return float(found[0]), float(found[1])

    def cut_wrenches(self, lam, body):
        """
        Return the wrench of body B on body A at each cut joint, shape (number of cuts, 3 or 6).

        Moment, then force, at the cut point of A, in world axes, in the mechanism's order [N m,
        N], of the multipliers of all equations; of ``body``, as ``Workspace.body``, only poses are
        read.
        """
        model, work = self.model, self.work
        found = np.empty((len(model.cut), work.wrench.shape[1]))
        native.cut_wrenches(model, body, lam, work.share, found)
        return found
