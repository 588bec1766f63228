# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

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
