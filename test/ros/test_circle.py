# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The joints lead the point round the circle, and their rates are those of their positions."""

from closedloop_dynamics.control.references import CircularPath, PathError
from closedloop_dynamics.mechanism.kinematics import body_poses, named_point, pose_of
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest

POINT = 'platform_center'


@pytest.fixture(scope='module')
def simulation():
    return Simulation.from_scene('three_rrr')


def circle_of(simulation, radius=0.12, frequency=0.25, phase=-0.2, joints=None, name=POINT):
    return CircularPath(simulation.mechanism, simulation.position, name, radius, frequency, phase,
                        joints or simulation.joint_names)


def test_point_is_on_the_circle_and_the_body_keeps_its_angle(simulation):
    circle = circle_of(simulation)
    mechanism = simulation.mechanism
    angle = pose_of(mechanism, body_poses(mechanism, simulation.position), 'platform')[2]
    # Between the positions that it was solved for, too.
    for turn in np.linspace(0.0, 2.0 * np.pi, 50):
        poses = body_poses(mechanism, circle.place(turn))
        place = named_point(mechanism, poses, POINT)
        expected = circle.center + 0.12 * np.array([np.cos(turn - 0.2), np.sin(turn - 0.2)])
        np.testing.assert_allclose(place, expected, atol=1e-9)
        assert pose_of(mechanism, poses, 'platform')[2] == pytest.approx(angle, abs=1e-9)


def test_it_begins_at_rest_where_the_joints_are(simulation):
    circle = circle_of(simulation)
    position, velocity = circle.at(0.0)
    np.testing.assert_allclose(position, simulation.position, atol=1e-9)
    assert not velocity.any()
    assert not circle.acceleration(0.0).any()
    # Before the beginning it rests.
    assert not circle.at(-1.0)[1].any()


@pytest.mark.parametrize('time', [
    0.3, 3.999, *(pytest.param(time, marks=pytest.mark.slow) for time in (2.0, 4.001, 9.7))])
def test_rates_are_derivatives(simulation, time):
    circle, step = circle_of(simulation), 1e-5
    (before, rate_before), (after, rate_after) = circle.at(time - step), circle.at(time + step)
    np.testing.assert_allclose(circle.at(time)[1], (after - before) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(
        circle.acceleration(time), (rate_after - rate_before) / (2 * step), atol=1e-7)


def test_after_the_first_turn_it_goes_round_at_its_frequency(simulation):
    circle = circle_of(simulation, frequency=0.5)
    np.testing.assert_allclose(circle.at(5.0)[0], circle.at(7.0)[0], atol=1e-9)


def test_joints_are_in_the_order_asked_for(simulation):
    names = ('theta_7', 'theta_1')
    chosen = [simulation.joint_names.index(name) for name in names]
    np.testing.assert_array_equal(
        circle_of(simulation, joints=names).at(3.0)[0], circle_of(simulation).at(3.0)[0][chosen])


@pytest.mark.parametrize('scene, options, problem', [
    ('three_rrr', {'radius': 2.0}, 'cannot bring'),
    ('three_rrr', {'name': 'nose'}, 'expected one of the points'),
    ('carpet_scraper', {'name': 'tool'}, '1 degrees of freedom')])
def test_what_cannot_be_followed_is_said(scene, options, problem):
    with pytest.raises(PathError, match=problem):
        circle_of(Simulation.from_scene(scene), **options)
