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

"""Torques that the trees need for a motion."""

import numpy as np

from ..reference import dense
from ..reference.compare import assert_agree, IDENTITY, SOLVE


def test_tree_torque_equals_the_twin(drawn, engine):
    rng, mechanism, q, qd = drawn
    for qdd in (np.zeros(len(q)), rng.normal(size=len(q))):
        expected = (dense.generalized_inertia_matrix(mechanism, q) @ qdd
                    + dense.bias_force(mechanism, q, qd))
        assert_agree(engine.tree_torque(q, qd, qdd), expected, IDENTITY)


def test_inverse_after_forward_returns_the_torques(drawn, engine):
    rng, _, q, qd = drawn
    tau = rng.normal(size=len(q))
    qdd, lam = engine.forward_dynamics(q, qd, tau)
    needed, held = engine.tree_torque(q, qd, qdd), engine.jacobian(q).T @ lam
    assert_agree(needed - held, tau, SOLVE, smallest=np.abs(held).max())


def test_forward_after_inverse_returns_the_accelerations(drawn, engine):
    rng, mechanism, q, qd = drawn
    # Any acceleration that the closures allow, held by any multipliers.
    jac, bias = dense.closure_jacobian(mechanism, q), dense.constraint_bias(mechanism, q, qd)
    qdd = rng.normal(size=len(q))
    qdd -= np.linalg.lstsq(jac, jac @ qdd + bias, rcond=None)[0]
    lam = rng.normal(size=len(jac))
    tau = engine.tree_torque(q, qd, qdd) - jac.T @ lam
    found_qdd, found_lam = engine.forward_dynamics(q, qd, tau)
    assert_agree(found_qdd, qdd, SOLVE)
    assert_agree(found_lam, lam, SOLVE)
