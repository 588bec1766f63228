# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Poses and velocities of bodies and of points on them."""

import numpy as np

from ..reference import maximal
from ..reference.compare import assert_agree, IDENTITY
from ..reference.trees import body_frames, placed


def test_poses_equal_the_twin(drawn, engine):
    _, mechanism, q, qd = drawn
    engine.move(q, qd)
    for name, (origin, angle) in body_frames(mechanism, q).items():
        assert_agree(engine.pose(name), [*origin, angle], IDENTITY, smallest=1.0)


def test_points_equal_the_twin(drawn, engine):
    rng, mechanism, q, qd = drawn
    engine.move(q, qd)
    motions = maximal.body_motions(mechanism, q, qd)
    for body in mechanism.bodies:
        point = rng.normal(size=2)
        place, velocity = engine.point(body.name, point)
        motion = motions[body.name]
        expected = placed(body_frames(mechanism, q)[body.name], point)
        assert_agree(place, expected, IDENTITY, smallest=1.0)
        assert_agree(velocity,
                     motion.velocity + maximal.cross(motion.rate, expected - motion.place),
                     IDENTITY, smallest=1.0)


def test_points_of_the_ground_stay(drawn, engine):
    _, _, q, qd = drawn
    engine.move(q, qd)
    place, velocity = engine.point('ground', (0.3, -0.2))
    assert np.array_equal(place, [0.3, -0.2])
    assert np.array_equal(velocity, [0.0, 0.0])
