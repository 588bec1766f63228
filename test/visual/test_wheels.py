# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Wheels of couplings: they touch, roll without slipping, and their teeth lie in gaps."""

from dataclasses import replace

from closedloop_dynamics.mechanism.kinematics import body_poses, pose_of, poses_in_space
from closedloop_dynamics.mechanism.mechanism import Coupling, Visual
from closedloop_dynamics.mechanism.rotations import of_quaternion
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.visual.transmissions import transmissions
from closedloop_dynamics.visual.wheels import profile, rack_profile
from matplotlib.path import Path
import numpy as np
import pytest


def planetary(sun, ring):
    carrier = 0.25 * sun + 0.75 * ring
    return [sun, ring, carrier, *3 * [-(sun - carrier)]]


POSITIONS = {
    'planetary_gear': [planetary(0.0, 0.0), planetary(1.7, 0.0), planetary(0.4, -2.3)],
    'rack_press': [[0.0, 0.0], [-0.3, -0.006], [0.77, 0.0154]],
    'differential': [[3.0 * c, c, 1.5 * s, c + s, c - s]
                     for c, s in ((0.0, 0.0), (0.31, 0.0), (1.3, -0.57))]}


def placed(mechanism, poses, body, places):
    """Return places of a body in the world, shape (n, 3)."""
    if body == 'ground':
        return places
    pose = poses_in_space(pose_of(mechanism, poses, body))
    return places @ of_quaternion(pose[3:]).T + pose[:3]


def drawn(mechanism, poses, wheel):
    outline, hole = profile(wheel)
    frame = np.array([wheel.start, wheel.side])
    return [placed(mechanism, poses, wheel.body, wheel.center + places @ frame)
            for places in (outline, hole) if places is not None]


def tips(mechanism, poses, wheel):
    """Return the middles of the tips of all teeth, shape (n, 3)."""
    angles = 2.0 * np.pi * np.arange(wheel.teeth) / wheel.teeth
    inwards = -1.0 if wheel.kind == 'ring' else 1.0
    reach = wheel.radius + 0.9 * inwards * wheel.module
    return placed(mechanism, poses, wheel.body, wheel.center + reach * (
        np.cos(angles)[:, None] * wheel.start + np.sin(angles)[:, None] * wheel.side))


@pytest.mark.parametrize('position', POSITIONS['planetary_gear'])
def test_teeth_of_planets_lie_in_the_gaps_of_sun_and_ring(position):
    mechanism = load_scene('planetary_gear').mechanism
    wheels, racks, belts = transmissions(mechanism)
    assert {wheel.body: (wheel.kind, wheel.teeth) for wheel in wheels} == {
        'sun': ('gear', 18), 'ring': ('ring', 54),
        **{f'planet_{k}': ('gear', 18) for k in (1, 2, 3)}}
    assert not racks and not belts
    poses = body_poses(mechanism, np.array(position))
    by_body = {wheel.body: wheel for wheel in wheels}
    sun, = drawn(mechanism, poses, by_body['sun'])
    rim, hole = drawn(mechanism, poses, by_body['ring'])
    for k in (1, 2, 3):
        planet = by_body[f'planet_{k}']
        outline, = drawn(mechanism, poses, planet)
        mine = tips(mechanism, poses, planet)[:, :2]
        assert not Path(sun[:, :2]).contains_points(mine).any()
        assert Path(hole[:, :2]).contains_points(mine).all()
        for other in ('sun', 'ring'):
            theirs = tips(mechanism, poses, by_body[other])[:, :2]
            assert not Path(outline[:, :2]).contains_points(theirs).any()
        # They reach into one another.
        away = np.linalg.norm(mine, axis=1)
        assert away.min() < 0.03 + 0.5 * planet.module
        assert away.max() > 0.09 + 0.5 * planet.module


@pytest.mark.parametrize('position', POSITIONS['rack_press'])
def test_teeth_of_a_pinion_lie_in_the_gaps_of_its_rack(position):
    mechanism = load_scene('rack_press').mechanism
    (pinion,), (rack,), _ = transmissions(mechanism)
    assert (pinion.body, pinion.radius, rack.body) == ('lever', 0.02, 'ram')
    assert rack.pitch * pinion.teeth == pytest.approx(2.0 * np.pi * 0.02)
    poses = body_poses(mechanism, np.array(position))
    places = placed(mechanism, poses, 'ram', rack.place + rack_profile(rack) @ [
        rack.along, rack.normal])
    mine = tips(mechanism, poses, pinion)[:, :2]
    assert not Path(places[:, :2]).contains_points(mine).any()
    outline, = drawn(mechanism, poses, pinion)
    teeth = places[:-2, :2].reshape(-1, 6, 2)[:, 2:4].mean(axis=1)
    assert not Path(outline[:, :2]).contains_points(teeth).any()
    assert np.linalg.norm(teeth, axis=1).min() < 0.02 - 0.5 * pinion.module


@pytest.mark.parametrize('position', POSITIONS['differential'])
def test_cones_of_bevel_gears_touch_and_roll(position):
    mechanism = load_scene('differential').mechanism
    wheels, _, _ = transmissions(mechanism)
    teeth = {wheel.body: wheel.teeth for wheel in wheels}
    assert teeth['carrier'] == 3 * teeth['pinion'] and 2 * teeth['left'] == 3 * teeth['spider']
    poses = body_poses(mechanism, np.array(position))
    by_body = {wheel.body: wheel for wheel in wheels}
    for one, other in (('pinion', 'carrier'), ('left', 'spider'), ('right', 'spider')):
        pair = by_body[one], by_body[other]
        # Both pitch circles lie on a ball about the apex, and have one place in common, which is
        # the middle of a tooth of one and of a gap of the other.
        shares, places = [], []
        for wheel, mate in (pair, pair[::-1]):
            start, side, axis, center = (placed(mechanism, poses, wheel.body, np.array(each))
                                         for each in (wheel.center + wheel.start,
                                                      wheel.center + wheel.side,
                                                      wheel.center + wheel.axis, wheel.center))
            apex = center + wheel.apex * (axis - center)
            np.testing.assert_allclose(apex, 0.0, atol=1e-12)
            towards = placed(mechanism, poses, mate.body, mate.center) - apex
            along = towards - (towards @ (axis - center)) * (axis - center)
            along /= np.linalg.norm(along)
            places.append(center + wheel.radius * along)
            angle = np.arctan2(along @ (side - center), along @ (start - center))
            shares.append(wheel.teeth * angle / (2.0 * np.pi))
        np.testing.assert_allclose(places[0], places[1], atol=1e-12)
        gaps = [abs((shares[0] + sign * shares[1]) % 1.0 - 0.5) for sign in (1, -1)]
        assert min(gaps) < 1e-9


def four_bar(factors, **more):
    mechanism = load_scene('four_bar').mechanism
    return replace(mechanism, couplings=(Coupling('gears', factors, **more),))


def test_radii_follow_from_ratio_and_distance():
    wheels, _, belts = transmissions(four_bar({'crank_joint': 1.0, 'rocker_joint': 3.0}))
    assert [(wheel.kind, wheel.body) for wheel in wheels] == [
        ('gear', 'crank'), ('gear', 'rocker')]
    assert [wheel.radius for wheel in wheels] == pytest.approx([0.1, 0.3])
    assert wheels[1].teeth == 3 * wheels[0].teeth and not belts
    # The same way round: one in a ring.
    wheels, _, _ = transmissions(four_bar({'crank_joint': 1.0, 'rocker_joint': -3.0}))
    assert [(wheel.kind, wheel.radius) for wheel in wheels] == [
        ('gear', pytest.approx(0.2)), ('ring', pytest.approx(0.6))]


def test_odd_numbers_of_teeth_mesh():
    mechanism = four_bar({'crank_joint': 19.0, 'rocker_joint': 25.0})
    (one, other), _, _ = transmissions(mechanism)
    assert one.teeth % 2 == other.teeth % 2 == 1
    for turn in (0.0, 0.31):
        poses = body_poses(mechanism, np.array([25.0 * turn, 0.0, -19.0 * turn]))
        for mine, theirs in ((one, other), (other, one)):
            outline, = drawn(mechanism, poses, theirs)
            points = tips(mechanism, poses, mine)[:, :2]
            assert not Path(outline[:, :2]).contains_points(points).any()
            center = placed(mechanism, poses, theirs.body, theirs.center)[:2]
            assert np.linalg.norm(points - center, axis=1).min() < theirs.radius


def test_wheels_that_are_too_small_to_touch_have_a_belt():
    wheels, _, (belt,) = transmissions(
        four_bar({'crank_joint': 1.0, 'rocker_joint': -2.0}, radius=0.03))
    assert [(wheel.kind, wheel.radius) for wheel in wheels] == [
        ('pulley', 0.03), ('pulley', pytest.approx(0.06))]
    away = [np.linalg.norm(belt.places - [x, 0.0, 0.0], axis=1) for x in (0.0, 0.4)]
    near = np.minimum(away[0] / 0.03, away[1] / 0.06)
    np.testing.assert_allclose(near, 1.0, atol=1e-9)
    # Its straight parts are tangents.
    sides = np.diff(belt.places, axis=0)
    longest = sides[np.argmax(np.linalg.norm(sides, axis=1))]
    assert np.linalg.norm(longest) == pytest.approx(np.sqrt(0.4 ** 2 - 0.03 ** 2))
    # Too large to be anything: nothing is drawn.
    assert transmissions(four_bar({'crank_joint': 1.0, 'rocker_joint': 2.0}, radius=0.3)) == (
        [], [], [])


def test_joints_of_robots_that_mimic_others_have_no_wheels():
    mechanism = four_bar({'crank_joint': 1.0, 'rocker_joint': 3.0})
    crank, *others = mechanism.bodies
    crank = replace(crank, visual=(Visual('sphere', (0.1,)),))
    shaped = replace(mechanism, bodies=(crank, *others))
    assert transmissions(shaped) == ([], [], [])
    gear, = (replace(coupling, radius=0.1) for coupling in mechanism.couplings)
    assert len(transmissions(replace(shaped, couplings=(gear,)))[0]) == 2


def test_numbers_of_teeth_are_whole_or_none():
    wheels, _, _ = transmissions(four_bar({'crank_joint': 1.0, 'rocker_joint': np.sqrt(2.0)}))
    assert [wheel.teeth for wheel in wheels] == [0, 0]
    wheels, _, _ = transmissions(four_bar({'crank_joint': 17.0, 'rocker_joint': 23.0}))
    assert wheels[0].teeth * 23 == wheels[1].teeth * 17 > 0
