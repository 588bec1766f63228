# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Kinetic and potential energy, and the power of the joint torques."""

import numpy as np
import pytest

from .engine import Engine
from ..reference import cases
from ..reference.compare import assert_agree, IDENTITY, SOLVE


@pytest.mark.parametrize('gravity', [(0.0, -9.81, 0.0), (3.0, 2.0, -1.0)])
@pytest.mark.parametrize('case', [*cases.PARAMETERS, *cases.IN_SPACE], ids=str)
def test_energies_equal_the_twin(case, gravity):
    _, mechanism, q, qd = cases.drawn(case, seed=3)
    engine = Engine(mechanism, gravity[:2 if mechanism.planar else 3])
    weight = sum(10.0 * body.mass for body in mechanism.bodies)
    (kinetic, potential), (wanted, height) = (
        one.energies(q, qd) for one in (engine, engine.twin))
    assert kinetic == pytest.approx(wanted, rel=IDENTITY)
    assert potential == pytest.approx(height, abs=IDENTITY * weight)


def test_power_of_the_torques_is_the_rate_of_energy(anywhere):
    rng, engine, q, qd = anywhere
    tau = rng.normal(size=len(qd))
    qdd, _ = engine.forward_dynamics(q, qd, tau)
    size = max(1.0, np.abs(qd).max(), np.sqrt(np.abs(qdd).max()))
    step = 1e-4 / size
    after, before = (sum(engine.energies(
        engine.moved(q, s * qd + 0.5 * s * s * qdd), qd + s * qdd)) for s in (step, -step))
    here = np.abs(engine.energies(q, qd)).sum() + np.abs(tau * qd).sum()
    # A central difference: 1e-8 from the step, and the rounding of the energy through it.
    assert (after - before) / (2.0 * step) == pytest.approx(tau @ qd, abs=1e-6 * here * size)


def test_multipliers_do_no_work(anywhere):
    rng, engine, q, qd = anywhere
    tau = rng.normal(size=len(qd))
    qdd, lam = engine.forward_dynamics(q, qd, tau)
    needed = engine.tree_torque(q, qd, qdd)
    # All power that the trees take up comes from the torques.
    assert_agree(needed @ qd, tau @ qd, SOLVE, smallest=np.abs(needed * qd).sum())
    assert_agree(lam @ engine.jacobian(q) @ qd, 0.0, IDENTITY,
                 smallest=np.abs(lam).max() * max(1.0, np.abs(qd).max()))
