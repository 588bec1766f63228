# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The loops over bodies in space against the recursions on numbers; the plane has other tests."""

from closedloop_dynamics.core.codegen.workspace import allocate
from closedloop_dynamics.core.types import (
    AXIS, BALL, BODY_A, COORDINATE, CUT_NUMBER, NO_RESPONSES, number_of_coordinates, TYPE)
from closedloop_dynamics.engine import native
from closedloop_dynamics.simulation.modeling import build_model
import numpy as np
import pytest

from .spatial_engine import loop_equations
from ..reference import cases, spatial_linkages, spatial_machines
from ..reference.compare import assert_agree, IDENTITY
from ..reference.numbers import equations, Numbers

MACHINES = ('rssr_four_bar', 'stewart_platform', 'delta_robot')


class Loops:
    """A model in space in a random state: on numbers, and in the workspace of the loops."""

    def __init__(self, mechanism, seed=0, state=None):
        self.model = build_model(mechanism, (0.1, -0.3, -9.81))
        self.nv, self.nc = len(self.model.tree) - 1, len(self.model.column) - 1
        self.work, self.numbers = allocate(self.model), Numbers(self.model)
        rng = np.random.default_rng(seed)
        self.q = 0.3 * rng.normal(size=number_of_coordinates(self.model))
        self.qd, self.tau, self.lam = (rng.normal(size=n) for n in (self.nv, self.nv, self.nc))
        for row in self.model.tree[1:]:
            if row[TYPE] == BALL and row[AXIS] == 2:
                quaternion = self.q[row[COORDINATE]:row[COORDINATE] + 4]
                quaternion /= np.linalg.norm(quaternion)
        if state is not None:
            self.q, self.qd = state
        self.numbers.move(self.q, self.qd)

    def outward(self):
        """Leave motion and rigid bodies in the workspace."""
        native.outward(self.model, self.q, self.qd, self.work)
        return self.model, self.work


@pytest.fixture(params=MACHINES)
def loops(request):
    return Loops(getattr(spatial_machines, request.param)()[0])


def check_accelerations(loops):
    qdd, lam = np.empty(loops.nv), np.empty(loops.nc)
    assert native.forward_dynamics(
        loops.model, loops.work, loops.q, loops.qd, loops.tau, qdd, lam)
    expected, forces, _ = loops.numbers.accelerations(loops.tau, 0.0)
    assert_agree(qdd, expected, 1e-9)
    assert_agree(lam, forces, 1e-9)


def test_accelerations_and_multipliers(loops):
    check_accelerations(loops)


@pytest.mark.parametrize('seed', cases.first(2, range(4)))
def test_random_mechanisms(seed):
    mechanism, *state = spatial_linkages.random_mechanism(np.random.default_rng(seed))
    check_accelerations(Loops(mechanism, seed, state))


def test_dense_matrices(loops):
    jac, gim = np.empty((loops.nc, loops.nv)), np.empty((loops.nv, loops.nv))
    native.constraint_jacobian(*loops.outward(), jac)
    assert_agree(jac, loops.numbers.jacobian(), IDENTITY)
    native.generalized_inertia_matrix(*loops.outward(), gim)
    assert_agree(gim, loops.numbers.inertia(), IDENTITY)


def test_routine_of_the_loop_equations(loops):
    closure, bias, jac = loop_equations(loops.model, loops.q, loops.qd)
    model, work = loops.outward()
    native.update(model, work, NO_RESPONSES)
    for found, expected in ((closure, work.closure), (bias, work.bias)):
        in_order = np.empty(loops.nc)
        native.to_user_order(model, expected, in_order)
        assert_agree(found, in_order, IDENTITY, smallest=1.0)
    assert_agree(jac, loops.numbers.jacobian(), IDENTITY)


def test_inverse_dynamics(loops):
    qdd, torque = np.random.default_rng(1).normal(size=loops.nv), np.empty(loops.nv)
    native.tree_torque(*loops.outward(), qdd, torque)
    assert_agree(torque, loops.numbers.bias_force() + loops.numbers.inertia() @ qdd, IDENTITY)


def test_energies(loops):
    found = np.empty(2)
    native.energies(*loops.outward(), loops.qd, found)
    assert_agree(found, loops.numbers.energies(), IDENTITY)


def test_wrenches_at_cut_joints(loops):
    loops.outward()
    model, work, found = loops.model, loops.work, np.empty((len(loops.model.cut), 6))
    native.cut_wrenches(model, work.body, loops.lam, work.share, found)
    recursion, expected = loops.numbers.recursion, np.zeros_like(found)
    for place, a, equation in equations(recursion, model):
        expected[model.cut[a, CUT_NUMBER]] += loops.lam[place] * np.array(equation.on_a)
    for cut, point in zip(model.cut, model.cut_point):
        # From the origin of body A to the cut point.
        lever = np.array(recursion.motion[cut[BODY_A]].frame) @ point[:3]
        wrench = expected[cut[CUT_NUMBER]]
        wrench[:3] -= np.cross(lever, wrench[3:])
    assert_agree(found, expected, IDENTITY)


def test_wrenches_in_joints_hold_the_bodies(loops):
    model, work, size = loops.model, loops.work, len(loops.model.tree)
    qdd, torque = np.random.default_rng(2).normal(size=loops.nv), np.empty(loops.nv)
    native.tree_torque(*loops.outward(), qdd, torque)
    wrench = np.zeros((size, 12))
    native.bias_forces(work, wrench)
    native.joint_wrenches(model, work, qdd, loops.lam, wrench)
    # In its own direction, a joint hands over what drives it: the torque less the cut forces'.
    needed = torque - loops.numbers.jacobian().T @ loops.lam
    axes = [motion.axis for motion in loops.numbers.recursion.motion]
    shares = np.zeros(loops.nv)
    for i in range(1, size):
        shares[model.tree[i, 1]] = np.dot(axes[i], wrench[i, :6])
    assert_agree(loops.numbers._own_axes(shares), needed, IDENTITY)
