# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped mechanisms in space are what they are called, and move as in maximal coordinates."""

from dataclasses import replace

from closedloop_dynamics import load_scene, Method, Simulation
from closedloop_dynamics.mechanism.kinematics import body_poses, named_point, pose_of
import numpy as np
import pytest

from ..reference import cases, spatial_maximal as twin
from ..reference.compare import assert_agree
from ..reference.loop_closure import closure

# Bodies, equations that do not always hold, independent ones, degrees of freedom.
MACHINES = {
    'bennett': (3, 5, 2, 1),
    'bricard': (5, 5, 4, 1),
    'delta_robot': (10, 15, 15, 3),
    'double_wishbone': (8, 6, 6, 5),
    'excavator_arm': (12, 8, 8, 4),
    'rssr_four_bar': (3, 3, 3, 2),
    'stewart_platform': (13, 15, 15, 6),
}
# References are maximal coordinates with quaternions, to twelve digits.
STEWART_FORCES = 28.5 * np.array([1.0, 1.1, 0.95, 1.05, 0.9, 1.0])
DELTA_TORQUES = np.array([0.5, 0.0, -0.5])


# Of several platforms, machines with arms and single loops one each; --all takes the others.
@pytest.fixture(scope='module', params=cases.only(
    ('bennett', 'double_wishbone', 'rssr_four_bar', 'stewart_platform'), MACHINES))
def machine(request):
    """Return a machine's name and its simulation in motion under gravity alone."""
    scene = load_scene(request.param)
    one = Simulation(replace(scene, effects={'gravity': scene.effects['gravity']}))
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
    assert one.data.degrees_of_freedom() == freedoms


def test_accelerations_are_those_of_maximal_coordinates(machine):
    _, one = machine
    torque = np.random.default_rng(1).normal(size=len(one.actuated_joints))
    tau = np.zeros(len(one.velocity))
    tau[list(one.mechanism.coordinates.actuated)] = torque
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


def known(name):
    """Return a machine that is simulated tightly, under gravity alone."""
    scene = load_scene(name)
    return Simulation(replace(
        scene, effects={'gravity': scene.effects['gravity']},
        method=Method(integrator='dop853', tolerance=1e-12)))


def platform(one):
    """Return place of a platform's center and axes of its body."""
    pose = one.body_poses[[body.name for body in one.mechanism.bodies].index('platform')]
    return one.point('platform_center'), twin.matrix(pose[3:])


def test_stewart_platform_starts_and_moves_as_known():
    one = known('stewart_platform')
    place, axes = platform(one)
    assert_agree(place, (0.0, 0.0, 0.6), 1e-12)
    assert_agree(axes, np.eye(3), 1e-12)
    rates = np.zeros_like(one.velocity)
    acceleration, _ = one.forward_dynamics(one.position, rates, STEWART_FORCES)
    found = twin.forward(one.mechanism, one.position, rates, acceleration)[1]['platform']
    center = one.mechanism.bodies[-1].center_of_mass
    assert_agree(found[:3], (0.916001846266, -1.58656173756, 1.422003749095), 1e-10)
    assert_agree(found[3:] + np.cross(found[:3], center),
                 (-0.133940827051, -0.077330772553, 0.111880085879), 1e-10)
    start, strokes = one.energy, one.position[list(one.mechanism.coordinates.place[
        list(one.mechanism.coordinates.actuated)])]
    one.step(STEWART_FORCES, 0.3)
    assert_agree(platform(one)[0], (-0.006612888235, -0.003836627965, 0.605095609325), 1e-9)
    one.step(STEWART_FORCES, 0.3)
    place, axes = platform(one)
    assert_agree(place, (-0.034261768566, -0.020474374083, 0.617628809006), 1e-9)
    assert_agree(axes, [[0.788368044122, -0.577218863246, -0.212824366368],
                        [0.476391160672, 0.791680900711, -0.382482435522],
                        [0.389265062703, 0.200149282690, 0.899117887486]], 1e-9)
    moved = one.position[list(one.mechanism.coordinates.place[
        list(one.mechanism.coordinates.actuated)])] - strokes
    for work in (one.energy - start, STEWART_FORCES @ moved):
        assert_agree(work, 8.148633672, 1e-9)


def test_a_platform_falls_on_where_rounding_opens_its_loops_further_than_they_are_closed():
    """Legs that nothing holds become kilometres long: 1e-12 of the size is less than rounding."""
    one = Simulation.from_scene('stewart_platform', stabilisation='independent')
    other = Simulation.from_scene('stewart_platform')
    for simulation in (one, other):
        simulation.step(duration=25.0)
    assert platform(other)[0][2] < -3000.0
    assert_agree(platform(one)[0], platform(other)[0], 1e-9)
    assert one.closure < 1e-11


def test_delta_robot_starts_and_moves_as_known():
    one = known('delta_robot')
    rates = np.zeros_like(one.velocity)
    acceleration, _ = one.forward_dynamics(one.position, rates, DELTA_TORQUES)
    found = twin.forward(one.mechanism, one.position, rates, acceleration)[1]['platform']
    assert_agree(found, (0.0, 0.0, 0.0, -1.904887309353, -1.099787200831, -11.852912650886), 1e-10)
    start = one.energy
    one.step(DELTA_TORQUES, 0.25)
    assert_agree(platform(one)[0], (-0.047474961513, -0.028554924782, -1.079204205218), 1e-9)
    one.step(DELTA_TORQUES, 0.25)
    place, axes = platform(one)
    assert_agree(place, (0.528637631678, -0.112854291725, -0.681333093596), 1e-9)
    # The platform never turns.
    assert_agree(axes, np.eye(3), 1e-9)
    # Of the first arm, below the horizontal.
    assert_agree(one.position[0], 2.483436197, 1e-9)
    assert_agree(one.energy - start, 0.690703490, 1e-8)


def test_bennetts_linkage_keeps_its_law():
    one = Simulation(load_scene('bennett'))
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
    one = Simulation(load_scene('excavator_arm'))
    arm = dict(zip(one.joint_names, one.position))
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


def test_the_car_stands_on_its_tyre():
    one = Simulation(load_scene('double_wishbone'))
    places = one.mechanism.coordinates
    for _ in range(200):
        state = [values[where[joint]][0] for joint in ('steering', 'lift')
                 for values, where in ((one.position, places.coordinates),
                                       (one.velocity, places.rates))]
        one.step([-2e4 * state[0] - 6e2 * state[1], 5500.0 - 5e5 * state[2] - 2e4 * state[3]],
                 0.01)
    carried = sum(body.mass for body in one.mechanism.bodies if body.name != 'road')
    # It still settles a little.
    assert -one.effect_readings('tyre')['tension'] == pytest.approx(9.81 * carried, rel=5e-3)
    assert abs(one.position[0]) < 0.005
    assert one.closure < 1e-9
