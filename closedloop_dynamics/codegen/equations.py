# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Quantities of a state for Python: dense matrices, energies, forces; closed loops."""

from typing import NamedTuple

import numpy as np

from . import joint_kernels
from .workspace import allocate
from ..engine import native
from ..engine.manifold import manifold_of
from ..engine.ranks import null_space, RANK_TOLERANCE
from ..engine.types import (
    CUT_NUMBER, CUT_ROW, CUT_TYPE, KEPT, NO_RESPONSES, number_of_coordinates, POSSIBLE, ROW, ROWS)

# What had a part in closing loops, as bits: the mass metric; equations that depend on others; a
# metric that cannot be computed with, where nothing was found.
MASSES, DEPENDENT, NO_METRIC = 1, 2, 4
# How the loops of one state of many were closed: it is to be looked at by itself; at once; and the
# determinant of the equations, as many as free coordinates, has changed its sign on the way.
BY_ITSELF, PLAIN, TURNED = range(3)
# Axes that a cut joint keeps parallel: none, Z, all, and Z beside X turned by a slide along Z.
NO_AXIS, ONE_AXIS, ALL_AXES, THREAD = range(4)


class Loops(NamedTuple):
    """Which loops are closed, and by what; ``engine/loop_solver.hpp``."""

    places: np.ndarray
    rows: np.ndarray
    free: np.ndarray
    tolerance: float = RANK_TOLERANCE
    least: float = 0.0
    limit: float = 0.0
    weight: np.ndarray = np.zeros(0)
    measured: np.ndarray = np.zeros(0, dtype=np.int64)
    values: np.ndarray = np.zeros(0)


class Far(NamedTuple):
    """What a search from far away asks for beyond; ``engine/loop_solver.hpp``."""

    unit: np.ndarray
    scale: np.ndarray
    axes: np.ndarray
    limits: np.ndarray
    target: np.ndarray


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
    places : ndarray of int, shape (nc,)
        1 for equations that hold places, 0 for those that hold angles.

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
        self.kept, groups = np.ones(self.nc, dtype=bool), []
        group_of = joint_kernels.arrays_of(model).group_of
        for number, (cut, count) in enumerate(zip(model.cut[by_user], self.counts)):
            possible = [n for n in range(6) if cut[POSSIBLE] >> n & 1]
            self.kept[len(groups):len(groups) + count] = [cut[KEPT] >> n & 1 for n in possible]
            groups += [(number, group_of(cut[CUT_TYPE], n)) for n in possible]
        self.places = np.array([kind == 0 for _, kind in groups], dtype=np.int64)
        order = {group: number for number, group in enumerate(dict.fromkeys(groups))}
        self.groups = np.array([order[group] for group in groups], dtype=int)
        nq = number_of_coordinates(model)
        state = np.zeros(nq + self.nv)
        self._q, self._qd = state[:nq], state[nq:]
        self._jacobian = None
        self._move = native.bind('outward', self.model, self._q, self._qd, self.work)
        self._close = native.bind('update', self.model, self.work, NO_RESPONSES)
        self._largest = native.bind('largest', self.work.closure)
        self._manifold = manifold_of(self.model)

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

    def solve(self, name, *arguments):
        """Call a function of ``engine/loop_solver.hpp`` for these equations."""
        self._connect()
        self._jacobian = None
        return getattr(self.model.native, name)(self.work, self._manifold, *arguments)

    def jacobian(self):
        """Return J = d psi / d q, shape (nc, nv)."""
        if self._jacobian is None:
            self._jacobian = np.zeros((self.nc, self.nv))
            self.model.constraint_jacobian(self.work, self._jacobian)
        return self._jacobian

    def units(self):
        """
        Return what closure errors, shape (nc,), and coordinates, (nv,), are counted in.

        Angles in radians, places and slides in sizes of the loops that they belong to [m],
        couplings, which have factors of any size, in what they change by.
        """
        rows, columns = np.empty(self.nc), np.empty(self.nv)
        self.model.loop_units(self.places, self.jacobian(), rows, columns)
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
        self.model.generalized_inertia_matrix(self.work, gim)
        # That has used up the bodies' own inertias.
        self._move()
        return gim

    def energies(self):
        """Return kinetic energy, and that in gravity, zero at the world's origin [J]."""
        found = np.zeros(2)
        self.model.energies(self.work, self._qd, found)
        return float(found[0]), float(found[1])

    def cut_wrenches(self, lam, body):
        """
        Return the wrench of body B on body A at each cut joint, shape (number of cuts, 3 or 6).

        Moment, then force, at the cut point of A, in world axes, in the mechanism's order [N m,
        N], of the multipliers of all equations; of ``body``, as ``Workspace.body``, only poses are
        read.
        """
        found = np.empty((len(self.model.cut), self.work.wrench.shape[1]))
        self.model.cut_wrenches(self.work, body, lam, found)
        return found
