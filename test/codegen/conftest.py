# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What the tests of the kernels share."""

import pytest

from .engine import Engine
from ..reference import cases


@pytest.fixture(scope='module', params=cases.PARAMETERS, ids=str)
def drawn(request):
    """Return (rng, mechanism, q, qd) of each case, the state closed."""
    return cases.drawn(request.param, seed=3)


@pytest.fixture
def engine(drawn):
    """Return a fresh Engine of the case."""
    return Engine(drawn[1])


@pytest.fixture(scope='module', params=[*cases.PARAMETERS, *cases.IN_SPACE], ids=str)
def anywhere(request):
    """Return (rng, engine, q, qd) of each case in the plane and in space, the state closed."""
    rng, mechanism, q, qd = cases.drawn(request.param, seed=3)
    return rng, Engine(mechanism), q, qd
