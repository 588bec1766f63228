# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Closure error and its rates."""

import numpy as np

from ..reference.compare import assert_agree, IDENTITY


def test_closure_and_its_rates_equal_the_twin(anywhere):
    rng, engine, q, qd = anywhere
    for place, rates in ((q, qd), (engine.moved(q, rng.normal(size=len(qd))),
                                   rng.normal(size=len(qd)))):
        for found, expected in zip(
                engine.closure(place, rates), engine.twin.closure(place, rates)):
            assert_agree(found, expected, IDENTITY, smallest=1.0)


def test_closed_states_are_closed(anywhere):
    _, engine, q, qd = anywhere
    psi, rate, _ = engine.closure(q, qd)
    assert_agree(psi, np.zeros(len(psi)), IDENTITY, smallest=1.0)
    assert_agree(rate, np.zeros(len(rate)), IDENTITY, smallest=1.0)


def along(engine, q, qd, qdd, time):
    """Return (psi, J qd, Jdot qd + J qdd) on the way with constant accelerations."""
    here, rates = engine.moved(q, time * qd + 0.5 * time ** 2 * qdd), qd + time * qdd
    psi, rate, bias = engine.closure(here, rates)
    return psi, rate, bias + engine.jacobian(here) @ qdd


def test_rates_are_finite_differences_of_the_closure(anywhere):
    rng, engine, q, qd = anywhere
    qd, qdd = qd + 0.3 * rng.normal(size=len(qd)), rng.normal(size=len(qd))
    step = 1e-4
    before, after = along(engine, q, qd, qdd, -step), along(engine, q, qd, qdd, step)
    _, rate, acceleration = along(engine, q, qd, qdd, 0.0)
    # Central differences: step^2 times third derivatives, which grow with the cube of the rates.
    third = max(1.0, np.abs(qd).max(), np.abs(qdd).max()) ** 4
    assert_agree((after[0] - before[0]) / (2.0 * step), rate, 1e-6, smallest=third)
    assert_agree((after[1] - before[1]) / (2.0 * step), acceleration, 1e-6, smallest=third)


def test_forward_dynamics_keeps_the_closure_to_second_order(anywhere):
    rng, engine, q, qd = anywhere
    qdd, _ = engine.forward_dynamics(q, qd, rng.normal(size=len(qd)))
    step = 1e-3 / max(1.0, np.abs(qd).max(), np.sqrt(np.abs(qdd).max()))
    errors = [np.abs(along(engine, q, qd, qdd, time)[0]).max() for time in (step, 2.0 * step)]
    # What is left grows with the third power of time, eightfold, on top of rounding.
    assert errors[0] < 100.0 * 1e-9
    assert errors[1] < 10.0 * errors[0] + 1e-13
