# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Quaternions of rotation matrices, against SciPy's."""

from closedloop_dynamics.mechanism.rotations import quaternions_of
import numpy as np
from scipy.spatial.transform import Rotation


def test_quaternions_are_those_of_the_rotations():
    axes = np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.0, -0.8], [0.0, -0.8, 0.6]]])
    rotations = Rotation.concatenate([
        Rotation.identity(), Rotation.from_quat(np.random.default_rng(7).normal(size=(200, 4))),
        # Half turns, and a little less and more.
        *(Rotation.from_rotvec(angle * axes) for angle in np.pi + np.array([0.0, -1e-9, 1e-9]))])
    matrices, expected = rotations.as_matrix(), rotations.as_quat()
    found = quaternions_of(matrices)
    # A rotation and its twin of the other sign are one; it is w that is not negative.
    expected *= np.sign(np.sum(expected * found, axis=1))[:, np.newaxis]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14)
    assert found[:, 3].min() >= 0.0
    # Each component was once what the others were found from.
    diagonal = matrices.diagonal(axis1=1, axis2=2)
    largest = np.where(diagonal.sum(axis=1) >= 0.0, 3, diagonal.argmax(axis=1))
    assert set(largest) == {0, 1, 2, 3}
