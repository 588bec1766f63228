# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of mechanisms in space: bodies where they are, views that agree with one another."""

from dataclasses import replace

from closedloop_dynamics import Point
from closedloop_dynamics.mechanism import kinematics
from closedloop_dynamics.visual import animation as animations, pictures, trajectory as motions
from closedloop_dynamics.visual.appearance import convex_hull, solid
from closedloop_dynamics.visual.drawing import all_places, MechanismArtist
from closedloop_dynamics.visual.views import FRONT, perspective, SIDE, TOP
from matplotlib.figure import Figure
import numpy as np
import pytest

from .test_drawing import check_picture, drawn, pictures_of
from ..reference import (
    cases, loop_closure as closures, spatial_linkages, spatial_machines, spatial_maximal as twin)

MACHINES = ('bricard', 'delta_robot', 'rssr_four_bar', 'stewart_platform')
LARGE = ('bricard', 'delta_robot', 'stewart_platform')


def at_zero(mechanism):
    """Return the coordinates of the drawn position."""
    return np.concatenate([
        np.eye(4)[3] if joint.type == 'spherical' else np.zeros(twin.coordinates(joint))
        for joint in mechanism.joints])


def waved(name, count=40):
    """Return a made-up motion of a machine, its loops open, with forces of six components."""
    mechanism, _ = getattr(spatial_machines, name)()
    mechanism = spatial_machines.with_single_freedoms(mechanism)
    mechanism = replace(mechanism, points=(
        Point('tip', mechanism.bodies[2].name, mechanism.bodies[2].center_of_mass),))
    rng = np.random.default_rng(3)
    time = np.linspace(0.0, 1.0, count)
    joints = len(mechanism.joints)
    position = 0.2 * np.sin(3.0 * time)[:, np.newaxis] * rng.normal(size=joints)
    return motions.Trajectory(
        mechanism, time, position, *rng.normal(size=(2, count, joints)),
        forces=rng.normal(size=(count, len(mechanism.cut_joints), 6)))


@pytest.mark.parametrize('seed', cases.first(4, range(40)))
def test_bodies_are_placed_and_loops_seen_as_in_maximal_coordinates(seed):
    rng = np.random.default_rng(seed)
    mechanism, q, qd = spatial_linkages.random_mechanism(rng)
    expected = twin.forward(mechanism, q, qd, np.zeros(len(qd)))[0]
    poses = kinematics.body_poses(mechanism, q)
    for body, pose in zip(mechanism.bodies, poses):
        np.testing.assert_allclose(pose[:3], expected[body.name].origin, atol=1e-13)
        np.testing.assert_allclose(twin.matrix(pose[3:]), expected[body.name].axes, atol=1e-13)
    assert closures.closure(mechanism, q[np.newaxis])[0] < 1e-12
    # The errors see whatever the cut joints forbid, and nothing else.
    rows, step = twin.closure_rates(mechanism, q), 1e-6
    moves = [joint for joint in mechanism.joints if joint.type in ('spherical', 'free')]
    if not moves:
        shifted = np.vstack([q + step * np.eye(len(q)), q - step * np.eye(len(q))])
        errors = np.array([
            *closures.closure_errors(mechanism, kinematics.body_poses(mechanism, shifted)),
            *closures.coupling_errors(mechanism, shifted)])
        slopes = (errors[:, :len(q)] - errors[:, len(q):]) / (2.0 * step)
        assert np.linalg.matrix_rank(slopes, 1e-7) == len(rows)
        assert np.linalg.matrix_rank(np.vstack([slopes, rows]), 1e-7) == len(rows)


def test_poses_of_many_positions_are_those_of_each():
    mechanism, _ = spatial_machines.stewart_platform()
    start = at_zero(mechanism)
    positions = start + 0.1 * np.random.default_rng(0).normal(size=(3, 5, len(start)))
    poses = kinematics.body_poses(mechanism, positions)
    assert poses.shape == (3, 5, 13, 7)
    np.testing.assert_array_equal(poses[2, 4], kinematics.body_poses(mechanism, positions[2, 4]))
    ground = kinematics.pose_of(mechanism, poses, 'ground')
    np.testing.assert_array_equal(
        kinematics.world_points(ground, [(1.0, 2.0, 3.0)])[2, 4], [(1.0, 2.0, 3.0)])


def test_views_show_space_from_the_side_that_they_are_named_after():
    places = np.random.default_rng(1).normal(size=(20, 3))
    for view, shown, near in ((FRONT, (0, 2), -places[:, 1]), (SIDE, (1, 2), places[:, 0]),
                              (TOP, (0, 1), places[:, 2])):
        np.testing.assert_array_equal(view.project(places), places[:, shown])
        np.testing.assert_array_equal(view.nearness(places), near)
    view = perspective(places)
    right, up, towards = np.array(view.axes)
    np.testing.assert_allclose(np.cross(right, up), towards, atol=1e-15)
    assert towards[2] > 0.0 and up[2] > 0.0 and right[2] == 0.0
    np.testing.assert_allclose(view.project(np.array(view.center)), 0.0, atol=1e-15)
    # What is nearer looks larger.
    ends = view.center + np.array([right, -right])
    far, middle, near = (
        np.ptp(view.project(ends + along * towards), axis=0)[0] for along in (-1.0, 0.0, 1.0))
    assert far < middle < near
    assert middle == pytest.approx(2.0)


# Rows for dozens of joints take long to draw.
@pytest.mark.parametrize('name', [
    pytest.param(name, marks=pytest.mark.slow) if name in LARGE else name for name in MACHINES])
def test_pictures_are_readable(name):
    for figure in pictures_of(waved(name)):
        check_picture(figure)


def test_positions_are_seen_from_four_sides():
    motion = waved('rssr_four_bar')
    figure = pictures.positions(motion, 'views')
    assert [axes.get_title(loc='left') for axes in figure.axes] == [
        'front', 'side', 'top', 'perspective']
    drawn(figure)
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    path = kinematics.named_point(motion.mechanism, poses, 'tip')
    everything = all_places(motion.mechanism, poses)
    for axes, view in zip(figure.axes, (FRONT, SIDE, TOP, perspective(everything))):
        assert axes.get_aspect() == 1.0
        longest = max(axes.get_lines(), key=lambda line: len(line.get_xdata()))
        np.testing.assert_array_equal(longest.get_xydata(), view.project(path))
        seen = view.project(everything)
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert np.all((seen > (left, low)) & (seen < (right, high)))


def test_force_arrows_are_projected():
    motion = waved('rssr_four_bar')
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    cut, = motion.mechanism.cut_joints
    place = kinematics.world_points(
        kinematics.pose_of(motion.mechanism, poses[3], cut.body_a), cut.point_a)
    for view in (FRONT, SIDE, TOP, perspective(all_places(motion.mechanism, poses))):
        artist = MechanismArtist(Figure().add_subplot(), motion.mechanism, poses, view)
        wrench = np.array([[9.0, 9.0, 9.0, 1.0, 2.0, -2.0]])
        (start, end), = artist.arrow_ends(3, wrench, 3.0)
        np.testing.assert_allclose(start, view.project(place))
        length = 0.22 * artist.extent
        np.testing.assert_allclose(
            end, view.project(place + length * np.array([1.0, 2.0, -2.0]) / 3.0))


def test_nearer_bodies_cover_those_behind():
    motion = waved('delta_robot')
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    artist = MechanismArtist(Figure().add_subplot(), motion.mechanism, poses, FRONT)
    parts = [part for part in artist.bodies(0) if part.layer is not None]
    assert len(parts) == sum(not body.massless for body in motion.mechanism.bodies)
    behind = [artist.world(part)[0, :, 1].mean() for part in parts]
    layers = [part.artist.get_zorder() for part in parts]
    assert np.all(np.diff(np.array(layers)[np.argsort(behind)]) < 1e-12)
    assert np.ptp(layers) > 0.05


def test_forces_and_moments_have_three_components():
    motion = waved('bricard')
    force, moment = pictures.constraint_forces(motion, 'forces').axes
    assert force.get_ylabel() == 'joint_6 [N]' and moment.get_ylabel() == 'moment [N m]'
    for axes, values in ((force, motion.forces[:, 0, 3:]), (moment, motion.forces[:, 0, :3])):
        lines = [line.get_ydata() for line in axes.get_lines()]
        np.testing.assert_array_equal(lines[:3], values.T)
        np.testing.assert_allclose(lines[3], np.linalg.norm(values, axis=1))
    # A ball hands over no moment.
    assert len(pictures.constraint_forces(waved('rssr_four_bar'), 'forces').axes) == 1


def test_animations_show_the_machine_in_perspective():
    motion = waved('stewart_platform')
    animation = animations.Animation(motion, 'test', animations.frame_times(motion, 10.0, 1.0))
    first, second, again = (animation.frame(k).astype(int) for k in (0, 5, 0))
    np.testing.assert_array_equal(first, again)
    changed = np.any(first != second, axis=2)
    assert 0.002 < changed.mean() < 0.3


def test_solids_have_the_edges_and_faces_of_their_points():
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    edges, faces = solid(cube)
    area = sum(0.5 * np.linalg.norm(np.cross(cube[b] - cube[a], cube[c] - cube[a]))
               for a, b, c in faces)
    assert area == pytest.approx(6.0)
    # Of a triangulated hull.
    assert len(cube) - len(edges) + len(faces) == 2
    turn = twin.about(np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), 0.7)
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]]) @ turn.T
    edges, faces = solid(square)
    assert len(edges) == 4 and all(4 not in edge for edge in edges)
    assert sum(0.5 * np.linalg.norm(np.cross(square[b] - square[a], square[c] - square[a]))
               for a, b, c in faces) == pytest.approx(1.0)
    (bar,), nothing = solid(square[[0, 4, 2]])
    assert sorted(bar) == [0, 2] and not nothing
    assert solid(square[:1]) == ([], [])
    assert len(convex_hull(square[:, :2])) == 4
