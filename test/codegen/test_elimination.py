# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The constraint matrix, its sparse factor, and closure equations that depend on one another."""

from dataclasses import replace

from closedloop_dynamics.engine.types import RANK, RANK_REVEALING_COUNT, SMALLEST_PIVOT
import numpy as np
import pytest

from .engine import Engine
from ..reference import cases, dense, special
from ..reference.compare import assert_agree, SOLVE


def elimination_order(mechanism, engine):
    """Return the multipliers' indices in elimination order."""
    rows = dense.rows(mechanism)
    names = engine.decomposition.elimination_order
    return np.concatenate([np.arange(engine.nc)[rows[name]] for name in names])


def test_constraint_matrix_equals_the_dense_product(drawn, engine):
    _, mechanism, q, _ = drawn
    jac = dense.closure_jacobian(mechanism, q)[elimination_order(mechanism, engine)]
    gim = dense.generalized_inertia_matrix(mechanism, q)
    matrix, _, _ = engine.constraint_matrix(q)
    assert_agree(matrix, jac @ np.linalg.solve(gim, jac.T), SOLVE)


def test_factor_gives_the_constraint_matrix_back(drawn, engine):
    _, _, q, _ = drawn
    matrix, factor, inverse = engine.constraint_matrix(q)
    assert_agree(inverse * np.diag(factor), np.ones(engine.nc), SOLVE)
    assert_agree(factor @ np.diag(inverse) @ factor.T, matrix, SOLVE)


@pytest.mark.parametrize('loops', [1, 2, 7, 40])
def test_ladder_costs_a_fixed_amount_per_loop(loops):
    mechanism, _, _ = special.ladder(loops)
    engine = Engine(mechanism)
    assert engine.decomposition.fill == 0
    # A chain of 2 x 2 blocks: 3 entries on each diagonal, 4 below all but the last.
    assert len(engine.model.row) == 3 * loops + 4 * (loops - 1)
    # Two links of one leg and one of the next carry each cut force; neighbours meet on one.
    assert len(engine.model.path_body) == 3 * loops
    assert len(engine.model.pair) == loops - 1


def every_loop_twice(mechanism):
    """Return the mechanism with a copy of each cut joint and coupling."""
    return replace(mechanism, **{key: getattr(mechanism, key) + tuple(
        replace(one, name=f'{one.name}_again') for one in getattr(mechanism, key))
        for key in ('cut_joints', 'couplings')})


def check_that_doubled_loops_share_the_force(case, unrolled):
    rng, mechanism, q, qd = cases.drawn(case)
    tau = rng.normal(size=len(q))
    qdd, lam = dense.forward_dynamics(mechanism, q, qd, tau)
    twice = every_loop_twice(mechanism)
    engine = Engine(twice, unrolled=unrolled)
    found, forces = engine.forward_dynamics(q, qd, tau)
    one, other = (np.concatenate([forces[dense.rows(twice)[f'{name}{which}']]
                                  for name in dense.rows(mechanism)]) for which in ('', '_again'))
    # 1e-9: singular values on one side, elimination on the other.
    assert_agree(found, qdd, 1e-9)
    assert_agree(one + other, lam, 1e-9)
    # Least norm: half on each.
    assert_agree(one, other, 1e-9)
    assert engine.work.health[RANK] == len(lam)


@pytest.mark.parametrize('case', cases.PARAMETERS, ids=str)
def test_every_loop_twice_moves_the_same_and_shares_the_force(case):
    check_that_doubled_loops_share_the_force(case, False)


# Tracing so many equations takes a second: the shipped mechanisms, the others with --all.
@pytest.mark.parametrize('case', cases.only(('slider_crank', 'three_rrr'), cases.ALL), ids=str)
def test_every_loop_twice_moves_the_same_unrolled(case):
    check_that_doubled_loops_share_the_force(case, None)


def test_independent_equations_never_take_the_rank_revealing_path(drawn, engine):
    rng, _, q, qd = drawn
    engine.forward_dynamics(q, qd, rng.normal(size=len(q)))
    assert engine.work.health[RANK_REVEALING_COUNT] == 0.0
    assert 0.0 < engine.work.health[SMALLEST_PIVOT] <= 1.0


@pytest.mark.parametrize('loops', [1, 2, 5])
def test_flat_ladder_accelerates_as_the_branch_that_it_is_on(loops):
    # All links on one line: one closure equation of each loop is lost.
    mechanism, q, qd = special.ladder(loops, tilt=0.5 * np.pi, rate=1.0)
    engine = Engine(mechanism)
    qdd, lam = engine.forward_dynamics(q, qd, np.zeros(len(q)))
    assert engine.work.health[RANK] == loops
    # All rockers turn alike: one weight against one inertia. The interpolation between places
    # 0.03 and 0.06 rad ahead and behind is good to the fourth power of that.
    inertia, weight = (loops + 1) / 3.0 + loops, ((loops + 1) / 2.0 + loops) * 9.81
    np.testing.assert_allclose(np.abs(qdd), weight / inertia, rtol=1e-6)
    jac = dense.closure_jacobian(mechanism, q)
    np.testing.assert_allclose(
        jac @ qdd + dense.constraint_bias(mechanism, q, qd), 0.0, atol=1e-5)
    # The forces that keep it there grow without limit towards this place: nothing to compare.
    assert np.isfinite(lam).all()
