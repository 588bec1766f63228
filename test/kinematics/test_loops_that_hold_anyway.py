# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Loops whose equations all hold anyway, on the ground and carried: closed forms, known counts."""

import math

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.engine.ranks import rank_of
import numpy as np
import pytest
from scipy.integrate import solve_ivp
import yaml

G = 9.81
METHODS = {
    'auto': {}, 'dop853': {'integrator': 'dop853', 'tolerance': 1e-9},
    'rodas4': {'integrator': 'rodas4'}, **{
        name: {'integrator': 'rk4', 'step_size': 1e-3, 'stabilisation': name}
        for name in ('none', 'baumgarte', 'velocity_projection', 'independent')}}
# Of runs with an accuracy of 1e-6 rad or m within a second.
NEAR = 1e-6
INERTIA = [0.1, 0.1, 0.1]


def joint(kind, bodies, place, other=None, **more):
    """Return a joint between two bodies, whose place is the same in both unless given."""
    return {'type': kind, 'between': list(bodies), 'points': [place, other or place], **more}


def scene(bodies, joints, position=None, gravity=(0.0, 0.0, -G), **method):
    """Return a scene at rest of bodies of 1 kg, by name with their centres of mass."""
    bodies = {name: {'mass': 1.0, 'center_of_mass': center,
                     'inertia': INERTIA if len(center) == 3 else 0.1}
              for name, center in bodies.items()}
    return load_scene({
        'mechanism': {'name': 'machine', 'bodies': bodies, 'joints': joints},
        'initial': {'position': position}, 'method': method,
        'effects': {'gravity': {'type': 'gravity', 'acceleration': list(gravity)}}})


def door(axis, apart, **method):
    """Return a door on two hinges about an axis, so far apart along it, opened by 0.3 rad."""
    axis = np.array(axis, dtype=float)
    there = (apart * axis).tolist()
    return scene({'door': [0.5, 0.0, 0.0]}, {
        'hinge_1': joint('revolute', ('ground', 'door'), [0, 0, 0], axis=axis.tolist()),
        'hinge_2': joint('revolute', ('ground', 'door'), there, axis=axis.tolist(), cut=True)},
        {'hinge_1': 0.3}, **method)


def angle_of_door(axis, duration):
    """Return where a rigid body on a single axis turns to from rest at 0.3 rad."""
    axis = np.array(axis) / np.linalg.norm(axis)
    center = np.array([0.5, 0.0, 0.0])
    across = center - axis * (axis @ center)
    inertia = 0.1 + across @ across

    def rates(_, state):
        moved = (math.cos(state[0]) * across + math.sin(state[0]) * np.cross(axis, across))
        return state[1], axis @ np.cross(moved, [0.0, 0.0, -G]) / inertia

    return solve_ivp(rates, (0.0, duration), (0.3, 0.0), rtol=1e-11, atol=1e-12).y[0, -1]


@pytest.mark.parametrize('method', METHODS)
def test_a_door_on_two_hinges_falls_as_on_one(method):
    one = Simulation(door((1, 2, 3), 0.1, **METHODS[method]))
    one.step(duration=0.5)
    expected = angle_of_door((1, 2, 3), 0.5)
    assert expected == pytest.approx(1.02356, abs=1e-5)
    assert one.data.degrees_of_freedom() == 1
    assert one.position[0] == pytest.approx(expected, abs=NEAR)


@pytest.mark.parametrize('seed', range(4))
def test_hinges_of_any_axis_and_size_are_one(seed):
    rng = np.random.default_rng(seed)
    axis, apart = rng.normal(size=3), 10.0 ** rng.uniform(-3.0, 3.0)
    one = Simulation(door(axis, apart, integrator='dop853', tolerance=1e-9))
    one.step(duration=0.2)
    assert one.data.degrees_of_freedom() == 1
    assert one.position[0] == pytest.approx(angle_of_door(axis, 0.2), abs=NEAR)
    assert set(one.data.redundancy().shared) == {'hinge_1', 'hinge_2'}
    one.step(duration=0.1)
    # Least forces in two hinges carry the door: statics of all of it.
    assert np.isfinite(one.joint_forces).all()


def sled(angle, apart, **method):
    """Return a sled on two parallel rails of a slope, so far apart."""
    across = [-apart * math.sin(angle), apart * math.cos(angle)]
    return scene({'sled': [0.0, 0.0]}, {
        'rail_1': joint('prismatic', ('ground', 'sled'), [0.0, 0.0], angle=angle),
        'rail_2': joint('prismatic', ('ground', 'sled'), across, [0.0, apart], angle=angle,
                        cut=True)}, {'rail_1': 0.0}, (0.0, -G), **method)


@pytest.mark.parametrize('method', METHODS)
def test_a_sled_on_two_rails_slides_as_on_one(method):
    one = Simulation(sled(-0.5, 0.4, **METHODS[method]))
    one.step(duration=0.5)
    assert one.data.degrees_of_freedom() == 1
    assert one.position[0] == pytest.approx(0.125 * G * math.sin(0.5), abs=NEAR)


@pytest.mark.parametrize('angle', [-0.1, 0.7, 2.3, -1.1])
def test_rails_of_any_slope_and_size_are_one(angle):
    one = Simulation(sled(angle, 10.0 ** (2.0 * angle)))
    one.step(duration=0.2)
    assert one.position[0] == pytest.approx(-0.02 * G * math.sin(angle), abs=NEAR)


# Carried by an arm on the ground: a loop, and the degrees of freedom of the whole.
CARRIED = {
    'two hinges': ([1, 0, 0], {
        'h1': joint('revolute', ('arm', 'door'), [0, 0, 0], axis=[0, 0, 1]),
        'h2': joint('revolute', ('arm', 'door'), [0, 0, 1], axis=[0, 0, 1], cut=True)}, 2),
    'two tilted hinges': ([1, 0, 0], {
        'h1': joint('revolute', ('arm', 'door'), [0, 0, 0], axis=[1, 2, 3]),
        'h2': joint('revolute', ('arm', 'door'), [0.1, 0.2, 0.3], axis=[1, 2, 3], cut=True)}, 2),
    'two rails': ([1, 0, 0], {
        'h1': joint('prismatic', ('arm', 'door'), [0, 0, 0], axis=[0, 0, 1]),
        'h2': joint('prismatic', ('arm', 'door'), [0, 1, 0], axis=[0, 0, 1], cut=True)}, 2),
    'three sliders': ([0, 0, 1], {
        's1': joint('prismatic', ('arm', 'wedge'), [0, 0, 0], axis=[1, 0, 0]),
        's2': joint('prismatic', ('wedge', 'door'), [0, 0, 0], axis=[1, 1, 0]),
        's3': joint('prismatic', ('arm', 'door'), [0, 0, 0], axis=[0, 1, 0], cut=True)}, 2),
    'four-bar': ([0, 0, 1], {
        'a': joint('revolute', ('arm', 'crank'), [0, 0, 0], axis=[0, 1, 0]),
        'b': joint('revolute', ('crank', 'door'), [0, 0, 0.4], axis=[0, 1, 0]),
        'd': joint('revolute', ('arm', 'rocker'), [0.4, 0, 0], axis=[0, 1, 0]),
        'c': joint('revolute', ('door', 'rocker'), [0.4, 0, 0.4], axis=[0, 1, 0])}, 2)}


@pytest.mark.parametrize('case', CARRIED)
def test_a_loop_that_a_body_carries_is_checked_and_runs(case, tmp_path, capsys):
    axis, joints, freedoms = CARRIED[case]
    joints = {'pivot': joint('revolute', ('ground', 'arm'), [0, 0, 0], axis=axis), **joints}
    names = dict.fromkeys(body for one in joints.values() for body in one['between'][1:])
    mechanism = {'name': 'machine', 'joints': joints, 'bodies': {name: {
        'mass': 1.0, 'center_of_mass': [0.1, 0.0, 0.2], 'inertia': INERTIA} for name in names}}
    data = {'mechanism': mechanism, 'initial': {'position': dict.fromkeys(joints, 0.0)},
            'effects': {'gravity': {'type': 'gravity', 'acceleration': [1.0, -2.0, -G]}}}
    for name, one in (('machine', mechanism), ('scene', data)):
        path = tmp_path / f'{name}.yaml'
        path.write_text(yaml.safe_dump(one))
        assert main(['check', str(path)]) == 0
        assert f'degrees of freedom    {freedoms} =' in capsys.readouterr().out
    assert main(['simulate', str(path), '--duration', '0.1']) == 0
    one = Simulation(load_scene(path))
    start = one.energy
    one.step(duration=0.3)
    assert one.data.degrees_of_freedom() == freedoms
    kinetic = one.energy_balance.kinetic
    # Everything that may move does.
    assert np.abs(one.velocity).min() > 0.01
    assert abs(one.energy - start) < 1e-6 * kinetic
    assert one.closure < 1e-9


def test_a_pin_given_twice_on_an_arm_swings_as_one():
    one = Simulation(scene(
        {'arm': [0.0, 0.0], 'rod': [0.1, 0.0]}, {
            'pivot': joint('revolute', ('ground', 'arm'), [0.0, 0.0]),
            'pin_1': joint('revolute', ('arm', 'rod'), [0.0, 0.0]),
            'pin_2': joint('revolute', ('arm', 'rod'), [0.0, 0.0], cut=True)},
        {'pivot': 0.0, 'pin_1': 0.0}, (0.0, -G)))
    one.step(duration=0.5)
    # A pendulum, as nothing turns the arm.
    expected = solve_ivp(
        lambda _, state: (state[1], -0.1 * G * math.cos(state[0]) / 0.11), (0.0, 0.5), (0.0, 0.0),
        rtol=1e-11, atol=1e-12).y[0, -1]
    assert one.data.degrees_of_freedom() == 2
    np.testing.assert_allclose(one.position, [0.0, expected], atol=NEAR)


def test_what_is_fixed_stays():
    one = Simulation(load_scene({
        'mechanism': {'name': 'machine', 'bodies': {'box': {
            'mass': 1.0, 'center_of_mass': [0.5, 0.0, 0.0], 'inertia': INERTIA}}, 'joints': {
                'weld': joint('fixed', ('ground', 'box'), [0, 0, 0]),
                'hinge': joint('revolute', ('ground', 'box'), [0, 0, 1], axis=[0, 0, 1])}},
        'initial': {'position': {}}}))
    one.step(duration=0.1)
    assert one.data.degrees_of_freedom() == 0
    assert one.time == pytest.approx(0.1)


def test_ranks_are_decided_against_what_is_no_rounding():
    assert rank_of(1e-17 * np.ones((2, 2))) == 0
    assert rank_of(np.diag([1.0, 1e-17])) == 1
    assert rank_of(np.zeros((0, 3))) == 0
