# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""States that close: assembly and projection by plain least squares."""

import numpy as np

from . import dense


def assemble(mechanism, q, hold=(), tolerance=1e-13, steps=50):
    """Return coordinates near ``q`` that close the loops, those named in ``hold`` kept."""
    q = np.array(q, dtype=float)
    free = np.array([joint.name not in hold for joint in mechanism.joints])
    for _ in range(steps):
        residual = dense.closure(mechanism, q)
        if np.max(np.abs(residual), initial=0.0) < tolerance:
            return q
        jac = dense.closure_jacobian(mechanism, q)[:, free]
        q[free] -= np.linalg.lstsq(jac, residual, rcond=None)[0]
    raise AssertionError(f'{mechanism.name} cannot be assembled: residual {residual}')


def project(mechanism, q, qd):
    """Return the rates nearest to ``qd`` that keep the loops closed."""
    jac = dense.closure_jacobian(mechanism, q)
    # Twice: the second pass removes the rounding the first one leaves.
    for _ in range(2):
        qd = qd - np.linalg.lstsq(jac, jac @ qd, rcond=None)[0]
    return qd


def smallest_singular_value(mechanism, q):
    """Return sigma_min of the closure Jacobian, infinite without cut joints."""
    jac = dense.closure_jacobian(mechanism, q)
    if not len(jac):
        return np.inf
    return np.linalg.svd(jac, compute_uv=False)[len(jac) - 1] if len(jac) <= len(q) else 0.0


def random_state(rng, mechanism, start, spread=0.2):
    """Return (q, qd), closed: ``start`` shaken by ``spread`` and assembled, rates of order one."""
    for _ in range(100):
        try:
            q = assemble(mechanism, start + spread * rng.uniform(-1.0, 1.0, len(start)))
        except AssertionError:
            continue
        return q, project(mechanism, q, rng.uniform(-1.0, 1.0, len(start)))
    raise AssertionError(f'{mechanism.name} assembles nowhere near {start}')
