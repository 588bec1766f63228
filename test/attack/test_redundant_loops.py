# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Attack: random mechanisms in space of redundant loops, with masses over six decades.

Nothing drives them: kinetic and stored energy stay. A run that loses more than a thousandth of
what moved, or comes to another place than one of a much smaller accuracy, and says nothing, is a
silent one.
"""

from collections import Counter
import warnings

from closedloop_dynamics import codegen
from closedloop_dynamics.mechanism.errors import SimulationError
import numpy as np
import pytest

from ..reference.redundant_loops import random_loops
from ..reference.scenes import simulated


SILENT, FARTHER, FINER = 1e-3, 10.0, 1e-3
CALLS, DURATION = 2, 0.25


def run(loops, gravity, accuracy):
    """Return the simulation, its places after each call, and its share of lost energy."""
    simulation = simulated(
        loops.mechanism, loops.q, loops.qd, gravity=gravity, accuracy=accuracy)
    start, places, moved = simulation.energy_balance, [], 0.0
    for _ in range(CALLS):
        simulation.step(None, DURATION)
        now = simulation.energy_balance
        moved = max(moved, now.kinetic + abs(now.stored - start.stored))
        places.append(simulation.position)
    lost = abs(now.kinetic + now.stored - start.kinetic - start.stored)
    return simulation, np.array(places), lost / moved


def attack(rng):
    """Run one mechanism; return what became of it."""
    loops, accuracy = random_loops(rng), 10.0 ** rng.uniform(-9.0, -3.0)
    gravity = (0.0, 0.0, -9.81) if rng.random() < 0.5 else (0.0, 0.0, 0.0)
    try:
        simulation, places, share = run(loops, gravity, accuracy)
    except SimulationError:
        return 'refused'
    report = simulation.report()
    if report.findings:
        return 'warned' if share <= SILENT else 'warned of a loss'
    if share > SILENT:
        return 'silent'
    try:
        _, finer, _ = run(loops, gravity, max(FINER * accuracy, 1e-11))
    except SimulationError:
        return 'accepted'
    apart = np.abs(places - finer).max()
    return 'silent' if apart > FARTHER * max(report.error_bound, accuracy) else 'accepted'


@pytest.mark.parametrize('count', [6, pytest.param(300, marks=[
    pytest.mark.slow, pytest.mark.timeout(7200)])])
def test_no_redundant_loop_loses_energy_in_silence(count, monkeypatch):
    # Loops over bodies are compiled once for all topologies.
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', 0)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = [attack(np.random.default_rng([7, number])) for number in range(count)]
    counts = Counter(found)
    print(f'tried {count}:', dict(counts))
    assert counts['silent'] == 0
    assert counts['refused'] <= 0.01 * count


# What became singular, or lost energy, before equations were looked at after every step.
@pytest.mark.parametrize('number', [25, 28, 36, 208])
def test_equations_that_become_dependent_are_exchanged_in_time(number, monkeypatch):
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', 0)
    assert attack(np.random.default_rng([7, number])) == 'accepted'
