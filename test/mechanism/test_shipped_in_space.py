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

"""The shipped mechanisms in space are what they are called, and move as in maximal coordinates."""

from closedloop_dynamics.core.straight_line import available
from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.motion import body_poses, closure, named_point, pose_of
import numpy as np
import pytest

from ..reference import spatial_maximal as twin
from ..reference.compare import assert_agree

pytestmark = pytest.mark.skipif(not available(), reason='nothing moves in space uncompiled')
# Bodies, equations that do not always hold, independent ones, degrees of freedom.
MACHINES = {
    'bennett': (3, 5, 2, 1),
    'bricard': (5, 5, 4, 1),
    'excavator_arm': (12, 16, 8, 4),
}


@pytest.fixture(scope='module', params=MACHINES)
def machine(request):
    """Return a machine's name, its simulation and a state that closes its loops in motion."""
    one = Simulation(load_scene(request.param, in_space=True))
    rng = np.random.default_rng(7)
    one.step(0.05 * rng.normal(size=len(one.actuated_joints)), 0.05)
    rates = twin.closure_rates(one.mechanism, one.position)
    # Along what the loops allow.
    _, lengths, directions = np.linalg.svd(rates)
    free = directions[np.sum(lengths > 1e-9 * lengths[0]):]
    one.set_state(one.position, free.T @ rng.normal(size=len(free)))
    return request.param, one


def test_sizes_are_those_of_the_machine(machine):
    name, one = machine
    bodies, equations, independent, freedoms = MACHINES[name]
    assert len(one.mechanism.bodies) == bodies
    assert (one.health.equations, one.health.rank) == (equations, independent)
    assert one.degrees_of_freedom() == freedoms


def test_accelerations_are_those_of_maximal_coordinates(machine):
    _, one = machine
    torque = np.random.default_rng(1).normal(size=len(one.actuated_joints))
    tau = np.zeros(len(one.velocity))
    tau[[one.joint_names.index(joint) for joint in one.actuated_joints]] = torque
    gravity = one.scene.effects['gravity'].acceleration
    expected = twin.forward_dynamics(one.mechanism, one.position, one.velocity, tau, gravity)
    acceleration, _ = one.forward_dynamics(one.position, one.velocity, torque)
    found = twin.forward(one.mechanism, one.position, one.velocity, acceleration)[1]
    for body, wanted in expected.accelerations.items():
        assert_agree(found[body], wanted, 1e-8, smallest=1.0)


def test_loops_stay_closed_and_energy_stays(machine):
    _, one = machine
    start, before = one.energy, one.time
    # Kinetic and potential energy that could go astray.
    scale = abs(start) + sum(body.mass for body in one.mechanism.bodies)
    one.step(None, 0.3)
    assert one.time == pytest.approx(before + 0.3)
    assert abs(one.energy - start) < 1e-6 * scale
    # By the description alone.
    assert closure(one.mechanism, one.position[np.newaxis])[0] < 1e-9


def test_bennetts_linkage_keeps_its_law():
    one = Simulation(load_scene('bennett', in_space=True))
    alpha, beta = (one.mechanism.parameters[key] for key in ('alpha', 'beta'))
    law = np.sin(0.5 * (alpha + beta)) / np.sin(0.5 * (beta - alpha))
    for _ in range(15):
        one.step({'joint_1': 0.6}, 0.1)
        crank, coupler, rocker = one.position
        assert np.tan(0.5 * crank) * np.tan(0.5 * coupler) == pytest.approx(law, rel=1e-9)
        # Opposite joints turn alike.
        assert crank + rocker == pytest.approx(0.0, abs=1e-9)
    assert crank > 2.0 * np.pi


def test_the_excavator_turns_as_a_whole():
    one = Simulation(load_scene('excavator_arm', in_space=True))
    arm = {name: value for name, value in zip(one.joint_names, one.position)}
    places = {}
    for turn in (0.0, 0.5 * np.pi, 2.5):
        one.set_state({**arm, 'slew': turn})
        poses = body_poses(one.mechanism, one.position)
        places[turn] = named_point(one.mechanism, poses, 'teeth')
        # Acting forces lift it by the same strokes, whichever way it looks.
        acceleration, _ = one.forward_dynamics(one.position, one.velocity, [0.0, 3e5, 1e5, 5e4])
        places[turn] = np.concatenate([places[turn], acceleration[1:]])
    flat = places[0.0]
    for turn, found in places.items():
        cosine, sine = np.cos(turn), np.sin(turn)
        assert_agree(found[:3], (cosine * flat[0], sine * flat[0], flat[2]), 1e-9)
        assert_agree(found[3:], flat[3:], 1e-8)
    assert pose_of(one.mechanism, poses, 'ground')[6] == 1.0
