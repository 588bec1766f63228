# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Joint accelerations and multipliers of loops over bodies and of generated routines."""

from dataclasses import replace

from closedloop_dynamics.engine.types import EVALUATIONS
import numpy as np
import pytest

from .engine import Engine
from ..reference import cases, dense, maximal, special
from ..reference.compare import assert_agree, IDENTITY, SOLVE
from ..reference.formulations import Dense, FORMULATIONS


@pytest.mark.parametrize('unrolled', [True, False])
def test_accelerations_and_multipliers_equal_the_twins(drawn, unrolled):
    rng, mechanism, q, qd = drawn
    tau = rng.normal(size=len(q))
    qdd, lam = Engine(mechanism, unrolled=unrolled).forward_dynamics(q, qd, tau)
    reduced, full = (dense.forward_dynamics(mechanism, q, qd, tau),
                     maximal.forward_dynamics(mechanism, q, qd, tau))
    for twin_qdd, twin_lam in (reduced, (full.qdd, full.lam)):
        assert_agree(qdd, twin_qdd, SOLVE)
        assert_agree(lam, twin_lam, SOLVE)


def test_formulations_agree(drawn):
    rng, mechanism, q, qd = drawn
    tau = 10.0 * rng.normal(size=len(q))
    engine = Engine(mechanism)
    qdd, lam = engine.forward_dynamics(q, qd, tau)
    for formulation in FORMULATIONS:
        other_qdd, other_lam = Dense(engine.system, formulation)(q, qd)
        assert_agree(other_qdd, qdd, SOLVE)
        assert_agree(other_lam, lam, SOLVE)


@pytest.mark.parametrize('unrolled', [True, False])
@pytest.mark.parametrize('case', cases.SHIPPED)
def test_repeated_call_on_one_workspace_agrees_bitwise(case, unrolled):
    rng, mechanism, q, qd = cases.drawn(case)
    tau = rng.normal(size=len(q))
    engine = Engine(mechanism, unrolled=unrolled)
    first = engine.forward_dynamics(q, qd, tau)
    # Elsewhere in between, so that nothing of the first evaluation is left.
    engine.forward_dynamics(q + 0.1, qd - 0.3, -tau)
    for before, after in zip(first, engine.forward_dynamics(q, qd, tau)):
        assert np.array_equal(before, after)


def test_one_call_from_state_to_accelerations_does_the_same_and_is_counted(drawn, engine):
    rng, _, q, qd = drawn
    tau = rng.normal(size=len(q))
    expected = engine.forward_dynamics(q, qd, tau)
    before = engine.work.health[EVALUATIONS]
    found = np.empty(engine.nv), np.empty(engine.nc)
    engine.model.forward_dynamics(engine.work, q, qd, tau, *found)
    for one, other in zip(found, expected):
        # Unrolled or not: the same sums, rounded differently where one instruction does both.
        assert_agree(one, other, SOLVE)
    assert engine.work.health[EVALUATIONS] == before + 1.0


@pytest.mark.parametrize('case', cases.IN_SPACE)
def test_accelerations_and_multipliers_in_space_equal_the_twin(case):
    rng, mechanism, q, qd = cases.drawn(case)
    engine, tau = Engine(mechanism), rng.normal(size=len(qd))
    for found, expected in zip(engine.forward_dynamics(q, qd, tau),
                               engine.twin.forward_dynamics(q, qd, tau)):
        # Decompositions on the one side, elimination on the other.
        assert_agree(found, expected, 1e-9)


def test_trees_without_cut_joints_equal_the_twin(drawn):
    rng, mechanism, q, qd = drawn
    trees = replace(mechanism, cut_joints=(), couplings=())
    tau = rng.normal(size=len(q))
    expected = np.linalg.solve(dense.generalized_inertia_matrix(trees, q),
                               tau - dense.bias_force(trees, q, qd))
    for unrolled in (True, False):
        qdd, lam = Engine(trees, unrolled=unrolled).forward_dynamics(q, qd, tau)
        assert_agree(qdd, expected, SOLVE)
        assert lam.shape == (0,)


@pytest.mark.parametrize('gravity', [(0.0, 0.0), (3.0, 2.0)])
def test_gravity_acts_as_given(gravity):
    _, mechanism, q, qd = cases.drawn('three_rrr')
    qdd, lam = Engine(mechanism, gravity).forward_dynamics(q, qd, np.zeros(7))
    twin_qdd, twin_lam = dense.forward_dynamics(mechanism, q, qd, np.zeros(7), gravity)
    assert_agree(qdd, twin_qdd, SOLVE)
    assert_agree(lam, twin_lam, SOLVE)


@pytest.mark.parametrize('unrolled', [True, False])
def test_baumgarte_makes_closure_errors_decay_critically(drawn, unrolled):
    rng, mechanism, q, qd = drawn
    rate = 20.0
    q, qd = q + 1e-3 * rng.normal(size=len(q)), qd + 1e-3 * rng.normal(size=len(q))
    engine = Engine(mechanism, unrolled=unrolled, baumgarte=rate)
    qdd, _ = engine.forward_dynamics(q, qd, rng.normal(size=len(q)))
    jac, psi = dense.closure_jacobian(mechanism, q), dense.closure(mechanism, q)
    terms = np.stack([jac @ qdd, dense.constraint_bias(mechanism, q, qd),
                      2.0 * rate * jac @ qd, rate ** 2 * psi])
    assert_agree(terms.sum(axis=0), np.zeros(len(psi)), SOLVE, smallest=np.abs(terms).max())


def test_listing_cut_joints_in_another_order_only_moves_their_multipliers():
    rng, mechanism, q, qd = cases.drawn('carpet_scraper')
    tau = rng.normal(size=7)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    for order in ((2, 0, 1), (1, 2, 0), (2, 1, 0)):
        listed = replace(mechanism, cut_joints=tuple(mechanism.cut_joints[k] for k in order))
        other_qdd, other_lam = Engine(listed).forward_dynamics(q, qd, tau)
        assert_agree(other_qdd, qdd, SOLVE)
        assert_agree(other_lam.reshape(3, 2), lam.reshape(3, 2)[list(order)], SOLVE)


def test_long_ladder_equals_the_twin():
    mechanism, q, qd = special.ladder(40, tilt=0.5, rate=2.0)
    tau = np.random.default_rng(4).normal(size=len(q))
    result = maximal.forward_dynamics(mechanism, q, qd, tau)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    assert_agree(qdd, result.qdd, SOLVE)
    assert_agree(lam, result.lam, SOLVE)


def test_acceleration_level_of_the_closure_holds(anywhere):
    rng, engine, q, qd = anywhere
    qdd, _ = engine.forward_dynamics(q, qd, rng.normal(size=len(qd)))
    _, _, bias = engine.twin.closure(q, qd)
    terms = engine.twin.jacobian(q) * qdd
    assert_agree(terms.sum(axis=1) + bias, np.zeros(len(bias)), IDENTITY,
                 smallest=max(np.abs(terms).max(), np.abs(bias).max()))
