# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms of thousands of joints: linear in size, well posed, no dense matrix anywhere."""

from closedloop_dynamics.engine.types import RANK, RANK_REVEALING_COUNT
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.decomposition import decompose
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.simulation.system import build_system
from families import chain, ladder, star
import numpy as np
import pytest

LARGE = [(ladder, 2500), (star, 312), (chain, 10000)]


def held(build, size):
    """Return a system of a member of a family at rest, and its mechanism and position."""
    mechanism, position = build(size)
    return build_system(build_model(validate_mechanism(mechanism))), mechanism, position


@pytest.mark.parametrize('build, size', LARGE)
def test_large_mechanism_is_well_posed(build, size):
    # Its smallest pivot falls with the size; that alone must not bring the dense path in.
    system, mechanism, position = held(build, size)
    q = np.array(position)
    system.tau[:] = np.random.default_rng(2).uniform(-1.0, 1.0, len(q))
    system.native.evaluate(q, np.zeros(len(q)))
    assert system.work.health[RANK] == mechanism.number_of_equations
    assert system.work.health[RANK_REVEALING_COUNT] == 0
    assert np.isfinite(system.qdd).all() and np.isfinite(system.lam).all()
    # All that is left of the closure errors' accelerations, against the joints' own.
    assert np.abs(system.work.closure).max() < 1e-9


def arrays_of(record):
    return [value for value in vars(record).values() if isinstance(value, np.ndarray)]


@pytest.mark.parametrize('build, sizes', [(ladder, (200, 400)), (star, (25, 50)),
                                          (chain, (400, 800))])
def test_memory_is_linear_in_size(build, sizes):
    small, large = (held(build, size) for size in sizes)
    per_joint = [sum(part.nbytes for record in (system.model, system.work)
                     for part in arrays_of(record)) / len(position)
                 for system, _, position in (small, large)]
    assert per_joint[1] == pytest.approx(per_joint[0], rel=0.02)


@pytest.mark.parametrize('size', [1, 7, 40])
def test_star_is_eliminated_with_little_fill(size):
    mechanism, _ = star(size)
    # The arms end to end cost nothing; the eight cuts in the middle all touch one subsystem.
    assert decompose(mechanism).fill <= 8
    assert len(mechanism.joints) == 16 * size + 1
    assert mechanism.number_of_equations == 16 * size
