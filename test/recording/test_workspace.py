# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Maps of what a platform reaches: known answers by hand, and what is written."""

import math

from closedloop_dynamics import Body, CutJoint, Joint, load_scene, Mechanism, Point
from closedloop_dynamics.cli import main
from closedloop_dynamics.cli.workspace import summary
from closedloop_dynamics.kinematics.pose_grid import angles_of, orientation_of
from closedloop_dynamics.kinematics.singular_curves import TYPE_1, TYPE_2
from closedloop_dynamics.mechanism.kinematics import body_poses, pose_of, world_points
from closedloop_dynamics.recording import workspace
from closedloop_dynamics.recording.workspace import (
    AT_LIMIT, COLLIDES, compute, least_distance, links, REACHED, read, Request, WorkspaceFileError)
import numpy as np
import pytest

from ..reference.scenes import scene

CENTER = 'platform_center'
PROXIMAL, DISTAL = 0.4, 0.6
BASE = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, math.sqrt(0.75)]])
CORNERS = np.array([[0.0, 0.0], [0.4, 0.0], [0.2, 0.34641016151377546]]) - [0.2, 0.1155]
LEGS = (('proximal_1', (PROXIMAL, 0.0)), ('proximal_2', (PROXIMAL, 0.0)),
        ('proximal_3', (PROXIMAL, 0.0)))
GRID = {'x': (-0.3, 1.25, 36), 'y': (-0.4, 1.1, 35)}
SMALL = {'x': (0.2, 0.8, 20), 'y': (0.0, 0.6, 20)}
# With a node very near an edge.
FINE = {'x': (-0.3, 1.25, 60), 'y': (-0.4, 1.1, 58)}


@pytest.fixture(scope='module')
def three_rrr():
    return load_scene('three_rrr')


@pytest.fixture(scope='module')
def at_17_degrees(three_rrr):
    return compute(three_rrr, Request(CENTER, GRID, (0.3,)), 2)


def in_annuli(axes, angle):
    """Return where all three corners are within their annuli, and how near to an edge."""
    x, y = (axis.values for axis in axes)
    places = np.stack(np.meshgrid(x, y, indexing='ij'), -1)
    reach = np.stack([
        np.linalg.norm(places + orientation_of((angle,)) @ corner - base, axis=-1)
        for corner, base in zip(CORNERS, BASE)])
    inside = (reach <= PROXIMAL + DISTAL) & (reach >= DISTAL - PROXIMAL)
    return inside.all(axis=0)


def corners_and_elbows(scene, position):
    poses = body_poses(scene.mechanism, position)
    platform = pose_of(scene.mechanism, poses, 'platform')
    corners = np.stack([world_points(platform, corner + [0.2, 0.1155]) for corner in CORNERS], 1)
    elbows = np.stack([world_points(pose_of(scene.mechanism, poses, body), np.array(place))
                       for body, place in LEGS], axis=1)
    return corners, elbows


def test_constant_orientation_is_the_intersection_of_three_annuli(at_17_degrees):
    inside = in_annuli(at_17_degrees.axes, 0.3)
    assert 100 < inside.sum() < inside.size - 100
    np.testing.assert_array_equal(at_17_degrees.status == REACHED, inside)


@pytest.mark.slow
def test_a_node_a_hundredth_of_a_millimetre_within_the_edge(three_rrr):
    found = compute(three_rrr, Request(CENTER, FINE, (-0.4,)))
    inside = in_annuli(found.axes, -0.4)
    x, y = (axis.values for axis in found.axes)
    corner = [x[24], y[47]] + orientation_of((-0.4,)) @ CORNERS[2]
    assert 0.0 < np.linalg.norm(corner - BASE[2]) - (DISTAL - PROXIMAL) < 1e-5
    np.testing.assert_array_equal(found.status == REACHED, inside)


def test_start_orientation_and_pieces_apart(three_rrr):
    """In the orientation of the start the annuli have a part in common that falls into pieces."""
    found = compute(three_rrr, Request(CENTER, GRID))
    np.testing.assert_array_equal(found.status == REACHED,
                                  in_annuli(found.axes, found.angles[0, 0]))


@pytest.mark.slow
def test_range_is_found(three_rrr, monkeypatch):
    monkeypatch.setattr(workspace, 'PLANAR_NODES', 60)
    found = compute(three_rrr, Request(CENTER, angles=(0.3,)))
    reached = found.status == REACHED
    for axis in range(2):
        edge = reached.any(axis=1 - axis)
        assert not edge[0] and not edge[-1] and edge.mean() > 0.7


def test_type_1_curves_are_the_circles_of_stretched_and_folded_legs(three_rrr, at_17_degrees):
    curves = [curve for curve in at_17_degrees.curves if curve.kind == TYPE_1]
    assert len(curves) == 6
    lengths = []
    for curve in curves:
        corners, elbows = corners_and_elbows(three_rrr, curve.position)
        reach = np.linalg.norm(corners - BASE, axis=2)
        off = np.minimum(abs(reach - (PROXIMAL + DISTAL)), abs(reach - (DISTAL - PROXIMAL)))
        # One and the same leg all along.
        leg = int(off.max(axis=0).argmin())
        assert off[:, leg].max() < 1e-12
        lengths.append(reach[0, leg])
        assert np.abs(np.linalg.norm(elbows - BASE, axis=2) - PROXIMAL).max() < 1e-9
    # The three small circles whole; of each large one an arc.
    closed = [curve.closed for curve in curves]
    assert sorted(closed) == [False] * 3 + [True] * 3
    for length, whole in zip(lengths, closed):
        assert length == pytest.approx(DISTAL - PROXIMAL if whole else PROXIMAL + DISTAL)


def test_type_2_curves_where_the_distal_links_meet_in_a_point(three_rrr, at_17_degrees):
    curves = [curve for curve in at_17_degrees.curves if curve.kind == TYPE_2]
    assert len(curves) >= 4
    for curve in curves:
        corners, elbows = corners_and_elbows(three_rrr, curve.position)
        along = (corners - elbows) / DISTAL
        moment = corners[..., 0] * along[..., 1] - corners[..., 1] * along[..., 0]
        lines = np.concatenate([along, moment[..., np.newaxis]], axis=2)
        # Zero where three lines meet in a point, or are parallel.
        assert np.abs(np.linalg.det(lines)).max() < 1e-9
        assert np.ptp(curve.places, axis=0).max() > 0.05
    # Both sides of each curve are on the grid: the determinant changes its sign there.
    worst = np.nanmax(at_17_degrees.quantities['condition'])
    assert worst > 300.0


def textbook_jacobian(scene, position):
    """Return derivatives of the driven angles by x, y and angle, from the distal links' lines."""
    corners, elbows = corners_and_elbows(scene, position[np.newaxis])
    place = corners[0].mean(axis=0)
    found = []
    for corner, elbow, base in zip(corners[0], elbows[0], BASE):
        way, crank = corner - elbow, elbow - base
        arm = corner - place
        turn = way @ [-crank[1], crank[0]]
        found.append([way[0] / turn, way[1] / turn, way @ [-arm[1], arm[0]] / turn])
    return np.array(found)


def test_condition_force_and_stiffness(three_rrr):
    request = Request(CENTER, {'x': (0.4, 0.6, 4), 'y': (0.2, 0.4, 4)}, (0.3,),
                      torque_limit={'theta_1': 2.0, 'theta_6': 3.0},
                      stiffness={'theta_1': 50.0, 'theta_6': 80.0, 'theta_7': 20.0})
    found = compute(three_rrr, request)
    arm = np.linalg.norm(CORNERS, axis=1).mean()
    directions = np.array([[math.cos(a), math.sin(a)] for a in np.linspace(0.0, math.tau, 20001)])
    compared = 0
    for node in np.argwhere(found.status == REACHED):
        inverse = textbook_jacobian(three_rrr, found.position[tuple(node)])
        # The frame of the platform begins at a corner: the centre is 0.03 mm beside the mean.
        values = {name: each[tuple(node)] for name, each in found.quantities.items()}
        assert values['condition'] == pytest.approx(
            np.linalg.cond(inverse / [1.0, 1.0, arm]), rel=2e-3)
        forward = np.linalg.inv(inverse)[:2]
        torque = np.abs(directions @ forward) / [2.0, 3.0, 1.0]
        assert values['force'] == pytest.approx(1.0 / torque.max(), rel=2e-3)
        compliance = forward / [50.0, 80.0, 20.0] @ forward.T
        assert values['stiffness'] == pytest.approx(
            1.0 / np.linalg.eigvalsh(compliance)[-1], rel=2e-3)
        compared += 1
    assert compared >= 8


def test_stewart_platform_legs():
    """Lengths of legs, and their directions, from the places of their ends."""
    scene = load_scene('stewart_platform')
    angles = (0.1, -0.05, 0.2)
    found = compute(scene, Request(CENTER, {
        'x': (-0.1, 0.1, 4), 'y': (-0.1, 0.1, 3), 'z': (0.35, 0.55, 3)}, angles), 2)
    assert (found.status == REACHED).all()

    def on_circle(radius, degrees):
        return np.array([radius * math.cos(math.radians(degrees)),
                         radius * math.sin(math.radians(degrees)), 0.0])

    turn = orientation_of(angles)
    legs = [(on_circle(0.5, base), turn @ on_circle(0.3, top)) for base, top in zip(
        (-10, 10, 110, 130, 230, 250), (-50, 50, 70, 170, 190, 290))]
    places = [scene.mechanism.coordinates.names.index(f'leg_{k}') for k in range(1, 7)]
    condition = found.quantities['condition']
    for node in np.ndindex(found.status.shape):
        place = np.array([axis.values[k] for axis, k in zip(found.axes, node)])
        ways = [place + arm - base for base, arm in legs]
        lengths = np.linalg.norm(ways, axis=1)
        # A cylinder and a piston of 0.4 m each: their ends meet where the joint's coordinate is
        # the length less 0.4 m.
        np.testing.assert_allclose(found.position[node][places], lengths - 0.4, atol=1e-9)
        units = ways / lengths[:, np.newaxis]
        rows = np.array([[*unit, *np.cross(arm, unit) / 0.3]
                         for unit, (_, arm) in zip(units, legs)])
        assert condition[node] == pytest.approx(np.linalg.cond(rows), rel=1e-6)


@pytest.mark.slow
def test_orientations_that_are_reached_are_counted(three_rrr):
    turns = {'z': (0.1, 0.5, 3)}
    axes = {'x': (0.1, 0.9, 9), 'y': (-0.1, 0.7, 9)}
    found = compute(three_rrr, Request(CENTER, axes, turns=turns))
    wanted = sum(in_annuli(found.axes, angle).astype(int) for angle, in found.angles)
    np.testing.assert_array_equal(found.count, wanted)
    assert 0 < found.dexterous.sum() < (found.count > 0).sum()
    assert not found.missed


def test_a_point_of_a_five_bar():
    """The intersection of two annuli, with two degrees of freedom."""
    rods = {'left': 1.0, 'right': 1.0}
    made = scene(Mechanism(
        'five_bar', (Body('a', 1.0, (0.5, 0.0), 0.1), Body('b', 1.0, (0.75, 0.0), 0.2),
                     Body('c', 1.0, (0.5, 0.0), 0.1), Body('d', 1.0, (0.75, 0.0), 0.2)),
        (Joint('left', 'revolute', 'ground', 'a', (0.0, 0.0), actuated=True),
         Joint('knee', 'revolute', 'a', 'b', (rods['left'], 0.0)),
         Joint('right', 'revolute', 'ground', 'c', (1.2, 0.0), actuated=True),
         Joint('other_knee', 'revolute', 'c', 'd', (rods['right'], 0.0))),
        (CutJoint('tip', 'revolute', 'b', 'd', (1.5, 0.0), (1.5, 0.0)),),
        (Point('tool', 'b', (1.5, 0.0)),)), (2.4, -1.4, 0.7, 1.4))
    found = compute(made, Request('tool', {'x': (-2.0, 3.2, 40), 'y': (-2.6, 2.6, 41)}))
    x, y = (axis.values for axis in found.axes)
    reach = [np.hypot(x[:, np.newaxis] - base, y) for base in (0.0, 1.2)]
    inside = np.all([(one <= 2.5) & (one >= 0.5) for one in reach], axis=0)
    np.testing.assert_array_equal(found.status == REACHED, inside)
    assert not found.turned
    curves = [curve for curve in found.curves if curve.kind == TYPE_2]
    # Type 2: both distal links in line.
    assert curves
    for curve in curves:
        poses = body_poses(made.mechanism, curve.position)
        ways = [world_points(pose_of(made.mechanism, poses, body), np.array([1.5, 0.0]))
                - world_points(pose_of(made.mechanism, poses, body), np.zeros(2))
                for body in ('b', 'd')]
        assert np.abs(np.linalg.det(np.stack(ways, axis=1))).max() < 1e-9


@pytest.mark.slow
def test_threads_change_nothing(three_rrr):
    one, two = (compute(three_rrr, Request(CENTER, SMALL, (0.3,)), workers) for workers in (1, 2))
    np.testing.assert_array_equal(one.status, two.status)
    np.testing.assert_array_equal(one.position, two.position)


@pytest.mark.parametrize('request_, asked', [
    (Request(CENTER, SMALL), 1),
    pytest.param(Request(CENTER, {'x': (0.1, 0.9, 15), 'y': (-0.1, 0.7, 15)},
                         turns={'z': (0.0, 0.5, 4)}), 300, marks=pytest.mark.slow)],
    ids=['one', 'several'])
def test_what_was_interrupted_is_gone_on_with(three_rrr, tmp_path, request_, asked):
    file, whole = tmp_path / 'map.nc', tmp_path / 'whole.nc'
    wanted = compute(three_rrr, request_, 2, whole)
    rounds = []

    def few_rounds():
        rounds.append(None)
        return len(rounds) < asked

    part = compute(three_rrr, request_, 2, file, keep_going=few_rounds)
    assert not part.finished
    assert 0 < part.count.sum() < wanted.count.sum()
    # Of nodes reached in all orientations nothing is known before all were looked at.
    text = summary(three_rrr, part)
    assert 'not finished' in text and 'reached in all' not in text
    assert 'not finished' not in summary(three_rrr, wanted)
    again = compute(three_rrr, request_, 2, file, resume=True)
    assert again.finished
    np.testing.assert_array_equal(again.count, wanted.count)
    np.testing.assert_array_equal(again.status, wanted.status)
    one, other = read(file), read(whole)
    assert one.keys() == other.keys()
    np.testing.assert_array_equal(one['status'], other['status'])
    with pytest.raises(WorkspaceFileError, match='expected the map of the same scene'):
        compute(three_rrr, Request(CENTER, GRID, (0.2,)), 2, file, resume=True)


def test_file_that_is_no_map(three_rrr, tmp_path):
    file = tmp_path / 'map.nc'
    file.write_text('no map')
    with pytest.raises(WorkspaceFileError, match='expected a map of an earlier run'):
        compute(three_rrr, Request(CENTER, GRID, (0.3,)), 1, file, resume=True)
    with pytest.raises(WorkspaceFileError):
        read(file)


@pytest.mark.slow
def test_limits_of_joints(three_rrr):
    low, high = 0.2, 1.2
    found = compute(three_rrr, Request(CENTER, SMALL, (0.3,), limits={'theta_1': (low, high)}))
    place = three_rrr.mechanism.coordinates.names.index('theta_1')
    known = found.status > 0
    angle = (found.position[..., place] + math.pi) % math.tau - math.pi
    inside = (angle >= low) & (angle <= high)
    np.testing.assert_array_equal(found.status[known] == REACHED, inside[known])
    assert (found.status == AT_LIMIT).any() and (found.status == REACHED).any()
    assert np.isnan(found.quantities['condition'][found.status == AT_LIMIT]).all()


@pytest.mark.slow
def test_links_that_come_too_near(three_rrr):
    clearance = 0.05
    found = compute(three_rrr, Request(CENTER, GRID, (0.3,), clearance=clearance))
    nodes = np.argwhere(found.status > 0)[::31]
    position = found.position[tuple(nodes.T)]
    least = least_distance(three_rrr.mechanism, position)
    status = found.status[tuple(nodes.T)]
    np.testing.assert_array_equal(status == COLLIDES, least < clearance)
    # Many points of both links instead.
    mechanism = three_rrr.mechanism
    poses, segments = body_poses(mechanism, position), links(mechanism)
    shares = np.linspace(0.0, 1.0, 201)[:, np.newaxis]
    cloud = {body: np.concatenate([np.stack([
        world_points(pose_of(mechanism, poses, body), (1.0 - share) * one + share * other)
        for share in shares], axis=1) for one, other in pairs], axis=1)
        for body, pairs in segments.items()}
    joined = {('proximal_1', 'distal_1'), ('distal_1', 'platform'), ('platform', 'distal_2'),
              ('platform', 'distal_3'), ('distal_2', 'proximal_2'), ('distal_3', 'proximal_3')}
    for k in range(len(position)):
        sampled = min(
            np.linalg.norm(cloud[a][k][:, np.newaxis] - cloud[b][k], axis=2).min()
            for a in cloud for b in cloud
            if a < b and (a, b) not in joined and (b, a) not in joined)
        assert least[k] <= sampled + 1e-12
        assert sampled - least[k] < 3e-3


def test_angles_and_orientations():
    for angles in ((0.4,), (0.1, -0.7, 2.0)):
        np.testing.assert_allclose(angles_of(orientation_of(angles)), angles, atol=1e-12)


@pytest.mark.parametrize('request_, message', [
    (Request(CENTER, torque_limit={'theta_1': -1.0}), 'torque_limit: theta_1: expected a finite'),
    (Request(CENTER, stiffness={'theta_1': 0.0}), 'stiffness: theta_1: expected a finite'),
    (Request(CENTER, {'x': (0.0, 1.0, 10 ** 5), 'y': (0.0, 1.0, 10 ** 5)}), 'grid: expected at'),
    (Request(CENTER, angles=(1e300,)), 'orientation: expected angles up to 1e'),
    (Request('nowhere'), r'point: expected a named point of a body that moves \(platform_center'),
    (Request(CENTER, {'z': (0.0, 1.0, 3)}), 'grid: expected axes x, y, got'),
    (Request(CENTER, {'x': (1.0, 0.0, 3)}), 'grid: x: expected FROM below TO'),
    (Request(CENTER, angles=(0.1, 0.2, 0.3)), 'orientation: expected 1 angles, got 3'),
    (Request(CENTER, angles=(0.1,), turns={'z': (0.0, 1.0, 2)}), 'got both'),
    (Request(CENTER, turns={'x': (0.0, 1.0, 2)}), 'turn: expected axes z, got'),
    (Request(CENTER, torque_limit={'theta_2': 1.0}), 'torque_limit: expected actuated joints'),
    (Request(CENTER, stiffness={'theta_2': 1.0}), 'stiffness: expected actuated joints'),
    (Request(CENTER, limits={'nothing': (0.0, 1.0)}), 'limit: expected joints'),
    (Request(CENTER, limits={'theta_1': (1.0, 0.0)}), 'expected LOW below HIGH'),
    (Request(CENTER, {'x': (8.0, 9.0, 5), 'y': (8.0, 9.0, 5)}), 'No node of the grid is reached'),
])
def test_messages(three_rrr, request_, message):
    with pytest.raises(Exception, match=message) as error:
        compute(three_rrr, request_)
    assert type(error.value).__name__ in ('ValueError', 'AssemblyError')


def test_one_degree_of_freedom_has_no_map():
    with pytest.raises(ValueError, match='of a body, got a mechanism of 1'):
        compute(load_scene('four_bar'), Request('coupler_point'))


def test_command(tmp_path, capsys):
    arguments = ['workspace', 'three_rrr', '--point', CENTER, '--orientation', '20deg',
                 '--grid', 'x=200mm:800mm:20', '--grid', 'y=0:0.6:20',
                 '--output', str(tmp_path / 'map.nc'), '--picture', str(tmp_path / 'map.png')]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert 'platform_center on 20 x 20 nodes, orientation 20 deg' in text
    assert 'type 1 curves' in text
    assert (tmp_path / 'map.png').read_bytes()[:4] == b'\x89PNG'
    found = read(tmp_path / 'map.nc')
    assert found['condition'].shape == (20, 20)
    assert main(arguments) == 2
    assert 'exists' in capsys.readouterr().err
    assert main(['workspace', 'three_rrr', '--point', CENTER, '--resume']) == 2
    assert main(['workspace', 'three_rrr']) == 2
    assert '--point: expected one of' in capsys.readouterr().err
    assert main(['workspace', 'four_bar', '--point', 'coupler_point']) == 2
