# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The engine's update of a covariance, beside the equations of a textbook."""

from closedloop_dynamics.engine import native
import numpy as np
import pytest


def corrected(covariance, slope, residual, noise, first, gates, others):
    """Return whether it was done, and all that is written."""
    m, n = slope.shape
    found = {'spread': np.empty((m, m)), 'factors': np.empty((m, m)),
             'squares': np.empty(len(gates)), 'whitened': np.empty((m, n)), 'white': np.empty(m),
             'others': others.copy(), 'change': np.empty(n), 'after': np.empty((n, n))}
    done = native.correct_errors(covariance, slope, residual, noise, first, gates,
                                 *found.values())
    return done, found


def drawn(left_out=()):
    """Return arguments of ``corrected``: three sensors of one, three and two numbers."""
    rng = np.random.default_rng(3)
    root, slope, others = rng.normal(size=(5, 5)), rng.normal(size=(6, 5)), rng.normal(size=(6, 2))
    return (root @ root.T, slope, rng.normal(size=6), rng.uniform(0.1, 1.0, 6),
            np.array([0, 1, 4, 6]), np.array([0.0 if n in left_out else np.inf for n in range(3)]),
            others)


@pytest.mark.parametrize('left_out', [(), (1,), (0, 2)])
def test_update_equals_the_textbook_without_sensors_that_are_gated(left_out):
    covariance, slope, residual, noise, first, _, others = arguments = drawn(left_out)
    done, found = corrected(*arguments)
    assert done
    spread = slope @ covariance @ slope.T + np.diag(noise)
    np.testing.assert_allclose(found['spread'], spread, rtol=1e-13)
    for n, (begin, end) in enumerate(zip(first, first[1:])):
        own = slice(begin, end)
        np.testing.assert_allclose(found['squares'][n], residual[own] @ np.linalg.solve(
            spread[own, own], residual[own]), rtol=1e-11)
    keep = [k for n in range(3) if n not in left_out for k in range(first[n], first[n + 1])]
    slope, residual, others = slope[keep], residual[keep], others[keep]
    inverse = np.linalg.inv(spread[np.ix_(keep, keep)])
    gain = covariance @ slope.T @ inverse
    # Products of six numbers, and an inverse, round by some 1e-14.
    np.testing.assert_allclose(found['change'], gain @ residual, rtol=1e-10)
    np.testing.assert_allclose(found['after'], covariance - gain @ slope @ covariance, atol=1e-11)
    assert np.array_equal(found['after'], found['after'].T)
    np.testing.assert_allclose(found['others'].T @ found['white'], others.T @ inverse @ residual,
                               rtol=1e-10)
    np.testing.assert_allclose(found['whitened'].T @ found['others'], gain @ others, rtol=1e-10)


def test_covariance_that_is_not_positive_definite_is_reported():
    covariance, slope = -np.eye(2), np.eye(2)
    done, _ = corrected(covariance, slope, np.zeros(2), np.full(2, 0.5), np.arange(3),
                        np.full(2, np.inf), np.zeros((2, 0)))
    assert not done
