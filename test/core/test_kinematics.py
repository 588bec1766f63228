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
