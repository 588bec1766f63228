# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Torques that the trees need for a motion."""

import numpy as np

from ..reference.compare import assert_agree, IDENTITY, SOLVE


def test_tree_torque_equals_the_twin(anywhere):
    rng, engine, q, qd = anywhere
    for qdd in (np.zeros(len(qd)), rng.normal(size=len(qd))):
        expected = engine.twin.generalized_inertia_matrix(q) @ qdd + engine.twin.bias_force(q, qd)
        assert_agree(engine.tree_torque(q, qd, qdd), expected, IDENTITY)


def test_inverse_after_forward_returns_the_torques(anywhere):
    rng, engine, q, qd = anywhere
    tau = rng.normal(size=len(qd))
    qdd, lam = engine.forward_dynamics(q, qd, tau)
    needed, held = engine.tree_torque(q, qd, qdd), engine.jacobian(q).T @ lam
    assert_agree(needed - held, tau, SOLVE, smallest=np.abs(held).max())


def test_forward_after_inverse_returns_the_accelerations(anywhere):
    rng, engine, q, qd = anywhere
    # Any acceleration that the closures allow, held by any multipliers.
    jac, (_, _, bias) = engine.twin.jacobian(q), engine.twin.closure(q, qd)
    qdd = rng.normal(size=len(qd))
    qdd -= np.linalg.lstsq(jac, jac @ qdd + bias, rcond=None)[0]
    lam = rng.normal(size=len(jac))
    tau = engine.tree_torque(q, qd, qdd) - jac.T @ lam
    found_qdd, found_lam = engine.forward_dynamics(q, qd, tau)
    assert_agree(found_qdd, qdd, SOLVE)
    assert_agree(found_lam, lam, SOLVE)
