# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Starts that are drawn: places of pins, or poses of bodies, in the place of joint coordinates."""

from math import acos, atan2, degrees, hypot

from closedloop_dynamics import load_scene, scene_names, SceneError, Simulation
from closedloop_dynamics.mechanism.kinematics import body_poses, named_paths, pose_of, world_points
from closedloop_dynamics.mechanism.rotations import angles_of, of_quaternion
from closedloop_dynamics.recording.kinematics import start_position
from closedloop_dynamics.scene.drawn_start import drawn_position
import numpy as np
import pytest

FOUR_BAR = """\
mechanism:
  name: four_bar
  bodies:
    crank: {shape: {rod: {to: [40 mm, 0], radius: 4 mm}}, density: 7800}
    coupler: {shape: {rod: {to: [12 cm, 0], radius: 4 mm}}, density: 7800}
    rocker: {shape: {rod: {to: [80 mm, 0], radius: 4 mm}}, density: 7800}
  joints:
    A: {type: revolute, between: [ground, crank], points: [[0, 0], [0, 0]]}
    B: {type: revolute, between: [crank, coupler], points: [[40 mm, 0], [0, 0]]}
    C: {type: revolute, between: [coupler, rocker], points: [[120 mm, 0], [80 mm, 0]]}
    D: {type: revolute, between: [ground, rocker], points: [[100 mm, 0], [0, 0]]}
initial: {%s}
"""


def four_bar(tmp_path, initial):
    path = tmp_path / 'drawn.yaml'
    path.write_text(FOUR_BAR % initial)
    return load_scene(path)


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_places_choose_the_assembly_of_a_four_bar(tmp_path, side):
    scene = four_bar(tmp_path, f'at: {{B: [0, 40 mm], C: [{113 if side > 0 else 55} mm, '
                     f'{79 if side > 0 else -66} mm]}}')
    simulation = Simulation(scene)
    frames = body_poses(simulation.mechanism, simulation.position)
    found = world_points(pose_of(simulation.mechanism, frames, 'crank'), (0.04, 0.0))
    # Two circles about B and D meet in C.
    gap = np.array([0.1, 0.0]) - found
    apart = hypot(*gap)
    angle = atan2(gap[1], gap[0]) + side * acos(
        (0.12 ** 2 + apart ** 2 - 0.08 ** 2) / (2.0 * 0.12 * apart))
    expected = found + 0.12 * np.array([np.cos(angle), np.sin(angle)])
    tip = world_points(pose_of(simulation.mechanism, frames, 'coupler'), (0.12, 0.0))
    assert np.allclose(tip, expected, atol=1e-10)
    assert simulation.closure < 1e-12


@pytest.mark.parametrize('initial, words', [
    ('at: {E: [0, 0]}', 'initial.at.E: expected a joint or point: '),
    ('at: {B: [0]}', 'initial.at.B: expected a list of 2 finite numbers'),
    ('at: {B: [0, 0.5]}', 'initial.at.B: expected a place that B can have with closed loops'),
    ('poses: {crank: [0, 0]}', 'initial.poses.crank: expected a list of 3 finite numbers'),
    ('poses: {A: [0, 0, 0]}', 'initial.poses.A: expected a body: crank, coupler, rocker'),
    ('poses: {crank: [1, 1, 0]}', 'initial.poses.crank: expected a pose that crank can have'),
    ('hold: []', 'initial.position: expected this required key, or one of at and poses'),
    ('position: {A: 40 mm, B: 0, D: 0}',
     "initial.position.A: expected an angle [rad], got the text '40 mm', a length"),
    ('at: {B: [0, 40 deg]}',
     "initial.at.B[1]: expected a length [m], got the text '40 deg', an angle"),
    ('poses: {crank: [0, 0, 90 mm]}', 'initial.poses.crank[2]: expected an angle [rad]'),
    ('position: {A: 0, B: 0, D: 0}, velocity: {A: 1 m}',
     'initial.velocity.A: expected an angle [rad]')])
def test_a_drawing_that_cannot_be_is_refused(tmp_path, initial, words):
    with pytest.raises(SceneError) as caught:
        four_bar(tmp_path, initial)
    assert words in str(caught.value)


@pytest.mark.parametrize('name', scene_names())
def test_poses_of_bodies_are_a_start(name):
    scene = load_scene(name)
    mechanism = scene.mechanism
    frames = body_poses(mechanism, start_position(scene))
    shifts = {} if mechanism.tree is None else mechanism.tree.shifts
    poses = {}
    for body in mechanism.bodies:
        pose = pose_of(mechanism, frames, body.name)
        size = 2 if mechanism.planar else 3
        place = world_points(pose, -np.array(shifts.get(body.name, np.zeros(size))))
        poses[body.name] = [*place, *(pose[2:] if mechanism.planar
                                      else angles_of(of_quaternion(pose[3:])))]
    found = drawn_position(mechanism, {}, poses, mechanism.coordinates.start())
    assert np.allclose(body_poses(mechanism, found)[:, :size], frames[:, :size], atol=1e-7)


@pytest.mark.parametrize('name', scene_names())
def test_places_of_pins_and_points_are_a_start(name):
    scene = load_scene(name)
    mechanism, q = scene.mechanism, start_position(scene)
    frames = body_poses(mechanism, q)
    places = {joint.name: pose_of(mechanism, frames, joint.child)[:2 if mechanism.planar else 3]
              for joint in mechanism.joints}
    known = named_paths(mechanism, q)
    found = drawn_position(mechanism, {**known, **places}, {}, mechanism.coordinates.start())
    for point, place in named_paths(mechanism, found).items():
        if point not in places:
            assert np.allclose(place, known[point], atol=1e-7), point


def test_units_are_read_wherever_a_number_stands(tmp_path):
    scene = four_bar(tmp_path, 'position: {A: 60 deg, B: -45deg, D: 1.5 rad}')
    bodies = {body.name: body for body in scene.mechanism.bodies}
    assert bodies['coupler'].center_of_mass == (0.06, 0.0)
    assert [degrees(angle) for angle in scene.initial.position[:2]] == pytest.approx([60, -45])
