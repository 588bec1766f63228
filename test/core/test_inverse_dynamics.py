# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Torques that the trees need for a motion."""

import numpy as np

from ..reference import dense
from ..reference.compare import assert_agree, IDENTITY, SOLVE


def test_tree_torque_equals_the_twin(drawn, engine):
    rng, mechanism, q, qd = drawn
    for qdd in (np.zeros(len(q)), rng.normal(size=len(q))):
        expected = (dense.generalized_inertia_matrix(mechanism, q) @ qdd
                    + dense.bias_force(mechanism, q, qd))
        assert_agree(engine.tree_torque(q, qd, qdd), expected, IDENTITY)


def test_inverse_after_forward_returns_the_torques(drawn, engine):
    rng, _, q, qd = drawn
    tau = rng.normal(size=len(q))
    qdd, lam = engine.forward_dynamics(q, qd, tau)
    needed, held = engine.tree_torque(q, qd, qdd), engine.jacobian(q).T @ lam
    assert_agree(needed - held, tau, SOLVE, smallest=np.abs(held).max())


def test_forward_after_inverse_returns_the_accelerations(drawn, engine):
    rng, mechanism, q, qd = drawn
    # Any acceleration that the closures allow, held by any multipliers.
    jac, bias = dense.closure_jacobian(mechanism, q), dense.constraint_bias(mechanism, q, qd)
    qdd = rng.normal(size=len(q))
    qdd -= np.linalg.lstsq(jac, jac @ qdd + bias, rcond=None)[0]
    lam = rng.normal(size=len(jac))
    tau = engine.tree_torque(q, qd, qdd) - jac.T @ lam
    found_qdd, found_lam = engine.forward_dynamics(q, qd, tau)
    assert_agree(found_qdd, qdd, SOLVE)
    assert_agree(found_lam, lam, SOLVE)
