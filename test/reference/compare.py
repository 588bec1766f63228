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

"""One way of comparing arrays: the largest error against the largest expected value."""

import numpy as np

# Equations that hold exactly, and results of linear solves.
IDENTITY = 1e-12
SOLVE = 1e-10


def assert_agree(actual, expected, relative, smallest=0.0):
    """Assert that all errors stay below ``relative`` times the largest expected value."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    scale = max(np.max(np.abs(expected), initial=0.0), smallest)
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * scale)
