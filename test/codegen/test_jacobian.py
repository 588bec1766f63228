# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Constraint Jacobian and generalized inertia matrix."""

import numpy as np
import pytest

from .engine import Engine
from .spatial_engine import loop_equations
from ..reference import appendix, cases
from ..reference.compare import assert_agree, IDENTITY
from ..reference.test_appendix import PAPER


def test_constraint_jacobian_is_the_derivative_of_the_closure(anywhere):
    rng, engine, q, qd = anywhere
    # Off the closed state too, where a slot's axis passes beside the point.
    for place in (q, engine.moved(q, rng.normal(size=len(qd)))):
        assert_agree(engine.jacobian(place), engine.twin.jacobian(place), IDENTITY)


def test_routine_of_the_loop_equations_equals_the_twin(anywhere):
    rng, engine, q, qd = anywhere
    place, rates = engine.moved(q, rng.normal(size=len(qd))), rng.normal(size=len(qd))
    closure, bias, jac = loop_equations(engine.model, place, rates)
    expected, _, accelerating = engine.twin.closure(place, rates)
    assert_agree(closure, expected, IDENTITY, smallest=1.0)
    assert_agree(bias, accelerating, IDENTITY, smallest=1.0)
    assert_agree(jac, engine.twin.jacobian(place), IDENTITY)


@pytest.mark.parametrize('name', PAPER)
def test_constraint_jacobian_equals_the_corrected_appendix(name):
    blocks, lengths, subsystems = PAPER[name]
    rng, mechanism, q, _ = cases.drawn(name)
    engine = Engine(mechanism)
    for theta in (q, *rng.uniform(-np.pi, np.pi, (5, 7))):
        found = blocks(theta, lengths)
        jac = engine.jacobian(theta)
        # 1e-13: element by element, of links below 1 m.
        np.testing.assert_allclose(jac, appendix.assembled(found, subsystems, engine.nc // 2),
                                   rtol=0.0, atol=1e-13)
        # Between a cut and a subsystem that it does not touch, exactly nothing.
        touched = appendix.assembled({key: np.ones(block.shape) for key, block in found.items()},
                                     subsystems, engine.nc // 2)
        assert not jac[touched == 0.0].any()


def test_gim_equals_the_twin(anywhere):
    _, engine, q, _ = anywhere
    assert_agree(engine.generalized_inertia_matrix(q), engine.twin.generalized_inertia_matrix(q),
                 IDENTITY)


def test_gim_equals_kinetic_energy_hessian(anywhere):
    _, engine, q, qd = anywhere
    units = np.eye(len(qd))
    alone = np.array([engine.energies(q, e)[0] for e in units])
    # The energy is quadratic in the rates: these differences are the Hessian, not an estimate.
    hessian = np.array([[engine.energies(q, e + f)[0] for f in units] for e in units])
    hessian -= alone[:, None] + alone[None, :]
    assert_agree(engine.generalized_inertia_matrix(q), hessian, IDENTITY)
