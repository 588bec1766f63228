# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
