# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Rollouts of mechanisms in space: the same as single simulations, bit for bit."""

from dataclasses import replace
from test.sweep.files import need, read

from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism, Point
from closedloop_dynamics.simulation.rollout_run import fits_simd, QUANTITIES, TimeGrid
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.sweep import sweep
import numpy as np
import pytest

from .test_rollout import assert_same, one_by_one
from ..reference import spatial_machines
from ..simulation.test_orientations import scene


def linkage(**method):
    """Return the scene of an RSSR four-bar with a driven crank and a ball in its tree."""
    mechanism, _ = spatial_machines.rssr_four_bar()
    return scene(replace(mechanism, points=(Point('middle', 'rod', (0.1, 0.1, 0.1)),)), **method)


def flyer(**method):
    """Return the scene of a free body with a driven ball."""
    body = Body('hull', 1.0, (0.1, 0.0, 0.05), (0.02, 0.03, 0.04))
    mechanism = Mechanism('flyer', (body, replace(body, name='arm')), (
        Joint('hull', 'free', 'ground', 'hull', (0.0, 0.0, 0.0)),
        Joint('ball', 'spherical', 'hull', 'arm', (0.2, 0.0, 0.0), actuated=True)))
    return scene(mechanism, velocity={'hull': {'angular_velocity': (1.0, 2.0, 3.0)}}, **method)


@pytest.mark.parametrize('build, method', [
    (linkage, {'integrator': 'rk4'}),
    (linkage, {'integrator': 'semi_implicit_euler', 'stabilisation': 'velocity_projection',
               'step_size': 1e-6}),
    (flyer, {'integrator': 'rk4'}), (linkage, {})],
    ids=['linkage', 'linkage-euler', 'flyer', 'linkage-auto'])
def test_results_in_space_are_those_of_single_simulations(build, method):
    made = build(**method)
    simulation = Simulation(made)
    schedule = TimeGrid(simulation.step_size, 12, 6, 3)
    # Side by side in a vector, and one that is left over.
    assert fits_simd(simulation, schedule) == bool(method)
    random = np.random.default_rng(4)
    torques = random.normal(0.0, 0.02, (9, 2, len(simulation.actuated_joints)))
    result = simulation.rollout(torques, steps=12, every=3, quantities=QUANTITIES, threads=1)
    assert result.failures == {}
    expected = one_by_one(made, torques, 12, 3)
    assert result.position.shape[-1] == simulation.coordinates.nq
    assert_same(result, expected)


def test_samples_in_space_start_where_they_are_told_to():
    made = linkage(integrator='rk4')
    names, random = made.mechanism.coordinates, np.random.default_rng(5)
    starts = np.array([names.moved(np.array(made.initial.position), 0.1 * change)
                       for change in random.standard_normal((4, names.nv))])
    torques = random.normal(0.0, 0.02, (4, 1, 1))
    result = Simulation(made).rollout(torques, starts, steps=6, quantities=QUANTITIES)
    expected = one_by_one(made, torques, 6, 1, [starts])
    assert_same(result, expected)
    assert result.closure.max() < 1e-12
    starts[1, -4:] *= 2.0
    failed = Simulation(made).rollout(torques, starts, steps=6)
    assert list(failed.failures) == [1] and 'a unit quaternion' in failed.failures[1]
    np.testing.assert_array_equal(failed.position[[0, 2, 3]], result.position[[0, 2, 3]])


def test_parameters_in_space_are_those_of_changed_scenes():
    made, masses = linkage(integrator='rk4'), np.array([0.7, 0.8, 0.9, 1.0])
    result = Simulation(made).rollout(
        [[0.02]], steps=20, every=20, parameters={'mechanism.bodies.rod.mass': masses})
    for sample, mass in enumerate(masses):
        bodies = tuple(replace(body, mass=mass) if body.name == 'rod' else body
                       for body in made.mechanism.bodies)
        one = Simulation(replace(made, mechanism=replace(made.mechanism, bodies=bodies)))
        one.step([0.02], 20 * one.step_size)
        np.testing.assert_array_equal(result.position[sample, -1], one.position)
    assert np.ptp(result.position[:, -1, 0]) > 1e-9


def test_a_sweep_in_space_has_coordinates_and_components(tmp_path):
    need('.nc')
    made, path = linkage(integrator='rk4'), tmp_path / 'results.nc'
    sweep(made, {'mechanism.bodies.rod.mass': [0.7, 0.8, 0.9, 1.0]}, path, duration=0.02,
          torque={'crank': 0.02}, workers=1,
          keep=('position', 'constraint_forces', 'joint_forces', 'points', 'energy'))
    data = read(path)
    assert data['status'].tolist() == 4 * [1]
    assert data['position'].shape == (4, 3, 6)
    assert data['constraint_forces'].shape == (4, 3, 1, 6)
    one = Simulation(made)
    for instant in range(3):
        one.step([0.02], 0.01 if instant else 0.0)
        for name in ('position', 'constraint_forces', 'joint_forces', 'points'):
            np.testing.assert_array_equal(data[name][1, instant], getattr(one, name), name)
    np.testing.assert_array_equal(data['final_velocity'][1], one.velocity)
    assert data['peak_force'][1, 0] >= np.linalg.norm(one.constraint_forces[0, 3:])
