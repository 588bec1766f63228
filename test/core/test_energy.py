# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Kinetic and potential energy, and the power of the joint torques."""

import numpy as np
import pytest

from .engine import Engine
from ..reference import dense
from ..reference.compare import assert_agree, IDENTITY, SOLVE


@pytest.mark.parametrize('gravity', [dense.EARTH, (3.0, 2.0)])
def test_energies_equal_the_twin(drawn, gravity):
    _, mechanism, q, qd = drawn
    kinetic, potential = Engine(mechanism, gravity).energies(q, qd)
    assert kinetic == pytest.approx(dense.kinetic_energy(mechanism, q, qd), rel=IDENTITY)
    weight = sum(10.0 * body.mass for body in mechanism.bodies)
    assert potential == pytest.approx(dense.potential_energy(mechanism, q, gravity),
                                      abs=IDENTITY * weight)


def test_power_of_the_torques_is_the_rate_of_energy(drawn, engine):
    rng, _, q, qd = drawn
    tau = rng.normal(size=len(q))
    qdd, _ = engine.forward_dynamics(q, qd, tau)
    size = max(1.0, np.abs(qd).max(), np.sqrt(np.abs(qdd).max()))
    step = 1e-4 / size
    after, before = (sum(engine.energies(q + s * qd + 0.5 * s * s * qdd, qd + s * qdd))
                     for s in (step, -step))
    here = np.abs(engine.energies(q, qd)).sum() + np.abs(tau * qd).sum()
    # A central difference: 1e-8 from the step, and the rounding of the energy through it.
    assert (after - before) / (2.0 * step) == pytest.approx(tau @ qd, abs=1e-6 * here * size)


def test_multipliers_do_no_work(drawn, engine):
    rng, _, q, qd = drawn
    tau = rng.normal(size=len(q))
    qdd, lam = engine.forward_dynamics(q, qd, tau)
    needed = engine.tree_torque(q, qd, qdd)
    # All power that the trees take up comes from the torques.
    assert_agree(needed @ qd, tau @ qd, SOLVE, smallest=np.abs(needed * qd).sum())
    assert_agree(lam @ engine.jacobian(q) @ qd, 0.0, IDENTITY,
                 smallest=np.abs(lam).max() * max(1.0, np.abs(qd).max()))
