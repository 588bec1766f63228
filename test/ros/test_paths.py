# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Paths in space: points go where they should, and joints with them."""

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.control.controller import reference
from closedloop_dynamics.control.references import (
    CircularPath, freedoms_of, PathError, PointToPointPath, solve)
from closedloop_dynamics.mechanism.kinematics import body_poses, named_point, pose_of
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.torque_source_node import Orientations
from closedloop_dynamics.ros.torque_source_parameters import TORQUE_SOURCE_PARAMETERS
from geometry_msgs.msg import Transform, Twist
import numpy as np
import pytest
from sensor_msgs.msg import JointState, MultiDOFJointState

CENTER = 'platform_center'


def started(name):
    """Return a mechanism, its closed start and the names of its driven joints."""
    one = Simulation(load_scene(name))
    return one.mechanism, one.position, one.actuated_joints


def placed(mechanism, start, joints, values):
    """Return the coordinates with driven joints as given, the others solved by small steps."""
    places = [mechanism.coordinates.coordinates[joint].start for joint in joints]
    one = Simulation(load_scene(mechanism.name))
    position = np.array(start)
    for share in np.linspace(0.0, 1.0, 9)[1:]:
        guess = position.copy()
        guess[places] = start[places] + share * (values - start[places])
        one.set_state(guess, hold=joints)
        position = one.position
    return position


@pytest.mark.parametrize('name, freedoms', [
    ('bennett', 1), ('four_bar', 1), *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('stewart_platform', 6), ('delta_robot', 3)))])
def test_freedoms_are_counted_where_the_mechanism_is(name, freedoms):
    mechanism, start, _ = started(name)
    assert freedoms_of(mechanism, start) == freedoms


def check_rates(path, times):
    """Compare rates and accelerations with differences."""
    step = 1e-5
    for time in times:
        (before, _), (now, rate), (after, _) = (
            path.at(time + shift) for shift in (-step, 0.0, step))
        np.testing.assert_allclose((after - before) / (2.0 * step), rate, atol=1e-7)
        np.testing.assert_allclose(
            (path.at(time + step)[1] - path.at(time - step)[1]) / (2.0 * step),
            path.acceleration(time), atol=1e-5)


def test_a_platform_goes_round_and_its_axis_round_a_cone():
    mechanism, start, joints = started('stewart_platform')
    circle = CircularPath(mechanism, start, CENTER, 0.08, 0.25, 0.0, joints, 0.12)
    np.testing.assert_allclose(circle.center, (-0.08, 0.0, 0.6), atol=1e-11)
    driven = [mechanism.coordinates.coordinates[joint].start for joint in joints]
    np.testing.assert_allclose(circle.place(0.0), start[driven], atol=1e-10)
    axis = np.array([np.sin(0.12), 0.0, np.cos(0.12)])
    for turn in (0.5 * np.pi, np.pi, 4.0):
        position = placed(mechanism, start, joints, circle.place(turn))
        poses = body_poses(mechanism, position)
        wanted = circle.center + 0.08 * np.array([np.cos(turn), np.sin(turn), 0.0])
        np.testing.assert_allclose(
            named_point(mechanism, poses, CENTER), wanted, atol=1e-9)
        x, y, z, w = pose_of(mechanism, poses, 'platform')[3:]
        # At the start the platform is level, and leans from there: the axis of the cone leans.
        normal = np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x),
                           1.0 - 2.0 * (x * x + y * y)])
        lean = np.array([-np.sin(turn), np.cos(turn), 0.0])
        leaned = np.array([np.cos(turn) * np.sin(0.12), np.sin(turn) * np.sin(0.12),
                           np.cos(0.12)])
        # The vertical, leaned back about y and out about the tangent.
        back = np.array([-axis[0], 0.0, axis[2]])
        expected = (back * np.cos(0.12) + np.cross(lean, back) * np.sin(0.12)
                    + lean * (lean @ back) * (1.0 - np.cos(0.12)))
        np.testing.assert_allclose(normal, expected, atol=1e-9)
        assert np.arccos(normal @ leaned) < 0.25
    check_rates(circle, (0.7, 2.0, 5.3))


@pytest.mark.slow
def test_a_delta_robot_reaches_its_places_at_rest():
    mechanism, start, joints = started('delta_robot')
    places, durations = np.array([[0.0, 0.0, 0.1], [0.2, 0.1, 0.1]]), [0.3, 0.5, 0.4]
    ways = PointToPointPath(mechanism, start, CENTER, places, durations, joints)
    origin = named_point(mechanism, body_poses(mechanism, start), CENTER)
    np.testing.assert_allclose(ways.places - origin, [*places, np.zeros(3)], atol=1e-12)
    assert ways.period == pytest.approx(1.2)
    for time, place in zip((0.0, 0.3, 0.8, 1.2 + 0.3), ways.places[[2, 0, 1, 0]]):
        position, rate = ways.at(time)
        found = placed(mechanism, start, joints, position)
        np.testing.assert_allclose(
            named_point(mechanism, body_poses(mechanism, found), CENTER), place, atol=1e-9)
        np.testing.assert_allclose(rate, 0.0, atol=1e-9)
    # Between places it goes straight.
    found = placed(mechanism, start, joints, ways.at(0.55)[0])
    middle = named_point(mechanism, body_poses(mechanism, found), CENTER)
    np.testing.assert_allclose(middle, 0.5 * (ways.places[0] + ways.places[1]), atol=1e-6)
    check_rates(ways, (0.1, 0.5, 1.0, 1.6))


def test_what_cannot_be_followed_is_said():
    mechanism, start, joints = started('delta_robot')
    for options, problem in (({'radius': 2.0}, 'cannot bring'), ({'tilt': 0.1}, 'cannot lean'),
                             ({'name': 'nose'}, 'expected one of the points')):
        given = {'name': CENTER, 'radius': 0.1, 'frequency': 0.25, 'phase': 0.0, **options}
        with pytest.raises(PathError, match=problem):
            CircularPath(mechanism, start, joints=joints, **given)
    point = mechanism.points[0]
    with pytest.raises(PathError, match='cannot bring'):
        solve(mechanism, start, point, np.array([0.0, 0.0, -3.0]), None)


@pytest.mark.parametrize('given, problem', [
    ({'path_places': [0.0, 0.1]}, 'path_places: expected 3 finite numbers for each'),
    ({'path_durations': [1.0]}, 'path_durations: expected 2 positive numbers'),
    ({'path_durations': [1.0, 0.0]}, 'path_durations: expected 2 positive numbers'),
    ({'circle_point': CENTER}, 'expected one of them, got both')])
def test_parameters_of_a_path_are_checked(given, problem):
    values = {parameter.name: parameter.default for parameter in TORQUE_SOURCE_PARAMETERS}
    values.update(path_point=CENTER, path_places=[0.0, 0.0, 0.1], path_durations=[0.5, 0.5])
    values.update(given)
    one = Simulation(load_scene('delta_robot'))
    with pytest.raises(StartError, match=problem):
        reference(values, one.actuated_joints, one)


@pytest.mark.parametrize('orientations_first', [True, False])
def test_both_parts_of_a_state_make_one(orientations_first):
    one = Simulation(load_scene('delta_robot'))
    names = one.coordinates
    parts = Orientations(one.mechanism)
    state, turned = JointState(), MultiDOFJointState(joint_names=['wrist_11'])
    pose, twist = Transform(), Twist()
    x, y, z, w = one.position[names.coordinates['wrist_11']].tolist()
    pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w = x, y, z, w
    twist.angular.y = 0.5
    turned.transforms, turned.twist = [pose], [twist]
    state.header.stamp.sec = turned.header.stamp.sec = 7
    if orientations_first:
        assert parts.accept(turned) is None
        assert parts.complete(state)
    else:
        assert not parts.complete(state)
        assert parts.accept(turned) is state
        assert parts.complete(state)
    numbers = one.position[names.place[names.single]]
    position, velocity = parts.whole(numbers, np.arange(len(numbers), dtype=float))
    np.testing.assert_array_equal(position, one.position)
    np.testing.assert_array_equal(velocity[names.single], np.arange(len(numbers)))
    np.testing.assert_array_equal(velocity[names.rates['wrist_11']], (0.0, 0.5, 0.0))
    # Those of another state do not serve.
    state.header.stamp.sec = 8
    assert not parts.complete(state)
