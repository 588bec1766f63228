# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Attack: random mechanisms with absurd masses, under held and changing torques, by every method.

The energy balance is drawn up here, from positions, velocities and torques alone; a run that
misses more than a thousandth of what moved, and says nothing, is a silent one.
"""

from dataclasses import replace
import warnings

from closedloop_dynamics import codegen
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.scene.integrators import INTEGRATORS
import numpy as np
import pytest

from ..reference.linkages import random_linkage
from ..reference.scenes import simulated

METHODS = list(INTEGRATORS)
SILENT = 1e-3
STEPS, HOLD = 200, 10
# Less than this share of the energy there is may be rounding, as the guard has it.
ROUNDING = 1e-9
# Variants of one topology: compiling costs more than running.
VARIANTS = 8


def variant(rng, mechanism):
    """Return a mechanism with masses over twelve decades, inertias to match."""
    factors = 10.0 ** rng.uniform(-6.0, 6.0, len(mechanism.bodies))
    return replace(mechanism, bodies=tuple(
        replace(body, mass=body.mass * factor, inertia=body.inertia * factor)
        for body, factor in zip(mechanism.bodies, factors)))


def attack(rng, mechanism, q, qd, integrator):
    """Run one mechanism; return what became of it, and the share of energy that it lost."""
    held = rng.random() < 0.5
    scale = 10.0 ** rng.uniform(-3.0, 4.0)
    tolerance = 10.0 ** rng.uniform(-8.0, -4.0)
    try:
        simulation = simulated(mechanism, q, qd, gravity=(0.0, -9.81), integrator=integrator,
                               tolerance=tolerance)
        start = simulation.energy_balance
        actuated = [simulation.joint_names.index(name) for name in simulation.actuated_joints]
        tau = np.zeros(len(q))
        work = moved = 0.0
        for number in range(STEPS // HOLD):
            if number == 0 or not held:
                tau[actuated] = scale * rng.normal(size=len(actuated))
            before = simulation.position
            simulation.advance(tau, HOLD)
            work += float(tau @ (simulation.position - before))
            now = simulation.energy_balance
            moved = max(moved, now.kinetic + abs(now.stored - start.stored) + abs(work))
        simulation.judge()
    except SimulationError:
        return 'refused', 0.0
    energy = now.kinetic + now.stored
    lost = abs(energy - start.kinetic - start.stored - work) - ROUNDING * (
        now.kinetic + abs(now.stored))
    share = lost / moved if moved > 0.0 else 0.0
    if simulation.report().findings:
        return 'warned', share
    return ('accepted' if share <= SILENT else 'silent'), share


@pytest.mark.parametrize('topologies, unrolled', [
    (2, True), pytest.param(64, False, marks=[pytest.mark.slow, pytest.mark.timeout(7200)])])
def test_no_random_mechanism_loses_energy_in_silence(topologies, unrolled, monkeypatch):
    if not unrolled:
        # Loops over bodies are compiled once for all topologies.
        monkeypatch.setattr(codegen, 'MOST_UNROLLED_IN_PLANE', 0)
    counts = {'refused': 0, 'warned': 0, 'accepted': 0, 'silent': 0}
    silent = []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        for number in range(topologies):
            rng = np.random.default_rng([41, number])
            mechanism, q, qd = random_linkage(
                rng, n_subsystems=1 + number % 3, max_cuts=1 + number % 3)
            for k in range(VARIANTS):
                method = METHODS[(number + k) % len(METHODS)]
                outcome, share = attack(rng, variant(rng, mechanism), q, qd, method)
                counts[outcome] += 1
                if outcome == 'silent':
                    silent.append((number, k, method, share))
    print(f'tried {topologies * VARIANTS}:', counts)
    assert not silent
    assert counts['accepted'] > 0
