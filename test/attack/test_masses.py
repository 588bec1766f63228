# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Random linkages with masses over many decades, against a twin in extended precision."""

from collections import Counter
from dataclasses import replace

from closedloop_dynamics.engine.types import RANK_REVEALING_COUNT
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.simulation.system import build_system
import numpy as np
import pytest

from ..reference import linkages, maximal
from ..reference.dense import EARTH

# Decades of mass: largest error, of the largest acceleration and of the largest multiplier. A
# force rounded to 1e-16 accelerates what is 1e-8 as heavy by 1e-8 of the rest.
ERRORS = {8: 1e-8, 12: 1e-6}


def error(found, expected):
    """Return the largest error relative to the largest number."""
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize('count', [6, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize('decades', ERRORS)
def test_masses_over_many_decades(decades, count):
    counts, worst = Counter(), 0.0
    for seed in range(count):
        rng = np.random.default_rng([decades, seed])
        mechanism, q, qd = linkages.random_linkage(rng)
        factors = 10.0 ** rng.uniform(-decades, 0.0, len(q))
        mechanism = replace(mechanism, bodies=tuple(
            replace(body, mass=body.mass * factor, inertia=body.inertia * factor)
            for body, factor in zip(mechanism.bodies, factors)))
        system = build_system(build_model(mechanism, EARTH), unrolled=False)
        system.tau[:] = rng.normal(size=len(q)) * 10.0 ** rng.uniform(-decades, 0.0, len(q))
        system.native.evaluate(q, qd)
        expected = maximal.forward_dynamics(
            mechanism, q, qd, system.tau, EARTH, maximal.extended)
        wrong = max(error(system.qdd, expected.qdd), error(system.lam, expected.lam))
        worst = max(worst, wrong)
        counts['tried'] += 1
        counts['rank-revealing'] += int(system.work.health[RANK_REVEALING_COUNT])
        counts['silently wrong'] += not wrong < ERRORS[decades]
    print(f'masses over {decades} decades: {dict(counts)}, worst error {worst:.1e}')
    assert counts == {'tried': count, 'rank-revealing': 0, 'silently wrong': 0}
