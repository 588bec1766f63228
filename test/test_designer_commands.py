# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that answer a designer: driven motions, reports, comparisons."""

import csv
from dataclasses import replace
import json
import math
from pathlib import Path
import re

from closedloop_dynamics import load_scene, Model
from closedloop_dynamics.mechanism.four_bar import four_bar as four_bar_of
from closedloop_dynamics.recording import cycle, design
from closedloop_dynamics.recording.kinematics import Drive, DrivenRun
from closedloop_dynamics.recording.quantities import by_name
from closedloop_dynamics.recording.transmission import transmission_angle
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
from closedloop_dynamics.scene.loading import scene_of_yaml
import numpy as np
from PIL import Image
import pytest
from scipy.integrate import simpson

from .reference.designs import closed, four_bar
from .test_cli import call, done, read, refused


@pytest.mark.parametrize('scene, size', [
    ('four_bar', 1.0), ('slider_crank', 1.0), ('three_rrr_vertical', 0.05),
    ('geared_five_bar', 0.5), *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('stewart_platform', 0.02), ('delta_robot', 0.1)))])
def test_work_of_the_drives_is_what_the_energy_gains(scene, size):
    model = Model.from_scene(scene)
    start = model.assemble()
    coordinates = model.coordinates
    places = {name: start.q[coordinates.place[coordinates.index[name]]]
              for name in model.actuated_joints}
    run = DrivenRun(load_scene(scene), {
        name: Drive(place, place + size * (1.0 - 0.3 * k))
        for k, (name, place) in enumerate(places.items())}, 101, 2.0)
    column = by_name(run.table())
    power = sum(column[f'motion.{motion.name}.power'] for motion in run.mechanism.motions)
    torques = sum(column[f'effort.{name}'] * column[f'velocity.{name}'] for name in places)
    np.testing.assert_allclose(torques, power, rtol=1e-9, atol=1e-12)
    work = simpson(power, x=run.time)
    if not [effect for effect in run.scene.effects if 'friction' in effect or 'damp' in effect]:
        np.testing.assert_allclose(
            column['energy'][-1] - column['energy'][0], work, atol=1e-6 * np.abs(work) + 1e-9)


def test_torques_of_actuated_joints_move_a_driven_point():
    scene = load_scene('three_rrr_vertical')
    model = Model(scene)
    start = model.assemble()
    x, y = model.evaluate(start).points['platform_center']
    theta = start.q[model.coordinates.index['theta_1']]
    run = DrivenRun(scene, {'platform_center.x': Drive(x, x + 0.04),
                            'platform_center.y': Drive(y, y - 0.02),
                            'theta_1': Drive(theta, theta)}, 41, 0.3)
    column = by_name(run.table())
    np.testing.assert_allclose(column['point.platform_center.x'], run.driven['platform_center.x'],
                               atol=1e-12)
    power = sum(column[f'effort.{name}'] * column[f'velocity.{name}']
                for name in model.actuated_joints)
    np.testing.assert_allclose(column['energy'][-1] - column['energy'][0],
                               simpson(power, x=run.time), rtol=1e-6)


def test_kinematics_writes_what_simulate_writes(capsys, tmp_path):
    ours, theirs = tmp_path / 'turn.csv', tmp_path / 'run.csv'
    picture = tmp_path / 'turn.png'
    text = done(
        capsys, 'kinematics', 'four_bar', '--drive', 'crank_joint=1.0472:3.0472:41', '--speed', 4,
        '--set', 'mechanism.bodies.coupler.mass=1.5', '--output', ours, '--picture', picture)
    assert '41 poses, crank_joint from 60.0001 deg to 174.592 deg in 0.5 s' in text
    assert 'advantage rocker_joint: at least' in text and 'dead centres at none' in text
    assert picture.read_bytes()[:4] == b'\x89PNG'
    scene = json.loads((tmp_path / 'turn.csv.scene.json').read_text())
    assert scene['mechanism']['bodies']['coupler']['mass'] == 1.5
    done(
        capsys, 'simulate', 'four_bar', '--motion', 'crank_joint=1.0472+4*t', '--duration', 0.5,
        '--rate', 80, '--forces', 'all', '--output', theirs, '--set',
        'mechanism.bodies.coupler.mass=1.5')
    found, expected = read(ours), read(theirs)
    for name, values in expected.items():
        if not name.startswith('motion.') and name != 'closure':
            np.testing.assert_allclose(found[name], values, atol=2e-6, err_msg=name)
    done(capsys, 'plot', ours, '--output', tmp_path / 'pictures')


def test_kinematics_tells_where_a_branch_ends(capsys, tmp_path):
    rows = tmp_path / 'rows.csv'
    code, text, errors = call(capsys, 'kinematics', 'four_bar', '--drive',
                              'rocker_joint=100:160deg:61', '--output', rows)
    assert code == 1 and 'pose 44: ' in errors and '(143.13 deg)' in errors
    assert '44 poses' in text and len(read(rows)['time']) == 44
    code, _, errors = call(capsys, 'kinematics', 'four_bar', '--drive', 'rocker_joint=20:30deg:3')
    assert code == 2 and "On the way from the scene's start to the first pose" in errors


def test_assemblies_are_listed_drawn_and_started_on(capsys, tmp_path):
    picture = tmp_path / 'assemblies.png'
    code, text, _ = call(capsys, 'assemblies', 'four_bar', '--drive', 'crank_joint=1rad',
                         '--picture', picture)
    assert code == 0 and 'proved: 2 (at most 2)' in text
    assert np.asarray(Image.open(picture).convert('L')).std() > 5.0
    # Held where the scene starts.
    assert 'proved: 2 (at most 2)' in call(capsys, 'assemblies', 'four_bar')[1]
    drive = ('kinematics', 'four_bar', '--drive', 'crank_joint=1:2:11')
    ends = []
    for branch in (1, 2):
        path = tmp_path / f'{branch}.csv'
        done(capsys, *drive, '--branch', branch, '--output', path)
        column = read(path)
        psi = np.array(column['position.rocker_joint'])
        pin = 0.4 + 0.25 * np.exp(1j * psi) - 0.1 * np.exp(1j * np.linspace(1.0, 2.0, 11))
        np.testing.assert_allclose(np.abs(pin), 0.35, atol=1e-12)
        ends.append(psi[-1])
    assert abs(ends[0] - ends[1]) > 1.0


@pytest.mark.parametrize('options, message', [
    (['--drive', 'crank_joint=0:1'], 'expected NAME=FROM:TO:COUNT with COUNT from 2 to 1000000'),
    (['--drive', 'crank_joint=0:1:1'], 'COUNT from 2 to 1000000'),
    (['--drive', 'crank_joint=0:nan:9'], "got 'crank_joint=0:nan:9'"),
    (['--drive', 'crank_joint=0:1turn:9'], "got 'crank_joint=0:1turn:9'"),
    (['--drive', 'crank_joint=1'], 'expected the same COUNT in all that move, got none that does'),
    (['--drive', 'crank_joint=1:1:5'], 'expected a drive that moves, got crank_joint at rest'),
    (['--drive', 'nothing=0:1:5'], 'nothing: expected a joint (crank_joint, '),
    (['--drive', 'coupler_point.z=0:1:5'], 'coupler_point.x (coupler_point)'),
    (['--drive', 'crank_joint=0:1:5', '--drive', 'crank_joint=0:1:5'], 'expected once'),
    (['--drive', 'crank_joint=0:1:5', '--drive', 'rocker_joint=0:1:4'], 'the same COUNT'),
    (['--drive', 'crank_joint=0:1:5', '--drive', 'rocker_joint=1'], 'degrees of freedom (1)'),
    (['--drive', 'crank_joint=0:1:5', '--speed', '0'], 'expected a finite number > 0'),
    (['--drive', 'crank_joint=0:1:5', '--branch', '0'], 'expected a whole number from 1 on'),
    (['--drive', 'coupler_point.x=0:1deg:5'], 'coupler_point.x: expected mm or cm or m'),
    (['--drive', 'crank_joint=0:1mm:5'], 'crank_joint: expected deg or rad, got mm'),
    (['--drive', 'crank_joint=0:1:5', '--picture', 'p.xyz'], 'ends with .png, .pdf, .svg, got p'),
    (['--drive', 'cut_1=0:1:5', '--drive', 'crank_joint=1'], 'which follow from one another'),
    (['--drive', 'crank_joint=0:1:5', '--branch', '7'], '--branch: expected the number of an'),
    ([], '--drive')])
def test_kinematics_refuses_what_makes_no_sense(capsys, options, message):
    assert message in refused(capsys, 'kinematics', 'four_bar', *options)


def test_units_of_drives(capsys, tmp_path):
    found = []
    for course in ('60:90deg:3', '60deg:90deg:3', f'{math.pi / 3!r}:{math.pi / 2!r}:3',
                   f'60deg:{math.pi / 2!r}rad:3'):
        path = tmp_path / f'{len(found)}.csv'
        done(
            capsys, 'kinematics', 'four_bar', '--drive', f'crank_joint={course}', '--output', path)
        found.append(read(path)['position.crank_joint'])
    np.testing.assert_allclose(found, [found[2]] * 4, atol=1e-14)


def test_duration_is_the_time_that_the_motion_takes(capsys, tmp_path):
    rows, picture = tmp_path / 'rows.csv', tmp_path / 'turn.png'
    done(
        capsys, 'kinematics', 'four_bar', '--drive', 'crank_joint=1:2:11', '--duration', 0.5,
        '--over', 'time', '--output', rows, '--picture', picture)
    column = read(rows)
    np.testing.assert_allclose(column['time'], np.linspace(0.0, 0.5, 11), atol=1e-12)
    np.testing.assert_allclose(column['velocity.crank_joint'], 2.0, atol=1e-12)
    assert picture.stat().st_size > 0
    code, _, errors = call(capsys, 'kinematics', 'four_bar', '--drive', 'crank_joint=1:2:11',
                           '--duration', 0.5, '--speed', 2)
    assert code == 2 and 'not allowed with argument' in errors


@pytest.mark.slow
def test_pictures_show_no_other_machine_than_the_recorded_one(capsys, tmp_path):
    rows, longer = tmp_path / 'rows.csv', 'mechanism.cut_joints.cut_1.point_b.0=0.26'
    done(
        capsys, 'kinematics', 'four_bar', '--drive', 'crank_joint=1:2:11', '--set', longer,
        '--output', rows)
    plot = ('plot', rows, '--output', tmp_path / 'pictures', '--overwrite')
    for command in (plot, (*plot, '--scene', 'four_bar', '--set', longer)):
        done(capsys, *command)
    # The machine of the rows needs no other file where it is named with its numbers.
    (tmp_path / 'rows.csv.scene.json').rename(tmp_path / 'elsewhere.json')
    done(capsys, *plot, '--scene', 'four_bar', '--set', longer)
    code, _, errors = call(capsys, *plot, '--scene', 'four_bar')
    assert code == 2 and 'expected rows of the mechanism of four_bar' in errors
    (tmp_path / 'elsewhere.json').rename(tmp_path / 'rows.csv.scene.json')
    other = ('--scene', 'four_bar', '--set', longer.replace('0.26', '0.27'))
    for command in (plot, ('animate', rows, '--output', tmp_path / 'run.gif')):
        assert 'mechanism.cut_joints.cut_1.point_b' in refused(capsys, *command, *other)
        assert '--set: expected it with --scene' in refused(capsys, *command, '--set', longer)


GEARED = """
mechanism:
  name: geared
  bodies:
    crank: {mass: 1.0, center_of_mass: [0.05, 0.0], inertia: 0.001}
    wheel: {mass: 1.0, center_of_mass: [0.05, 0.0], inertia: 0.001}
  joints:
    leader: {type: revolute, parent: ground, child: crank, position: [0.0, 0.0], actuated: true}
    follower: {type: revolute, parent: ground, child: wheel, position: [0.5, 0.0]}
  couplings:
    gears: {joints: {leader: 1.5, follower: 1.0}, offset: 0.0}
initial: {position: {leader: 0.0, follower: 0.0}, hold: [leader]}
"""


def driven_turn(scene, start=0.0, end=2.0 * math.pi, count=361, speed=1.0):
    run = DrivenRun(scene, {'crank_joint': Drive(start, end)}, count, speed)
    assert run.end is None
    return run


def test_transmission_angles_of_a_textbook(tmp_path, capsys):
    # Norton, Design of Machinery: links of 2, 7, 9 on a base of 6.
    scene = four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0)
    run = driven_turn(scene)
    angle = np.degrees(transmission_angle(run.mechanism, run.position, 'crank_joint'))
    np.testing.assert_allclose(angle[[0, 180]], [25.2088, 58.4119], atol=5e-5)
    assert angle.argmin() in (0, 360) and angle.max() <= 90.0
    text = done(capsys, 'report', tmp_path / 'scene.yaml', '--output', tmp_path / 'page.html')
    assert 'least  angle 25.2088 deg  at 0 deg' in text
    assert 'other extreme  angle 58.4119 deg  at 180 deg' in text
    assert 'four-bar linkage  crank-rocker (Grashof)' in text
    # A zero has no sign.
    assert re.search(r'largest \S+ N m  at .* rms \S+ N m ', text) and '] -0 ' not in text
    page = (tmp_path / 'page.html').read_text()
    for words in ('Transmission angle', '25.2088', 'time ratio', 'Shaking force', 'worst case',
                  'data:image/png;base64,', 'base 6 m, input 2 m, coupler 7 m, output 9 m'):
        assert words in page, words
    # Nothing is loaded from elsewhere.
    assert 'http' not in page and 'src="data:' in page and '<script' not in page


def test_lengths_of_a_slider_crank_are_those_of_crank_and_rod():
    assert design.length_keys(load_scene('slider_crank')) == (
        'mechanism.joints.rod_joint.position.0', 'mechanism.cut_joints.cut_1.point_a.0')


def test_transmission_angles_do_not_depend_on_where_the_loop_is_cut(tmp_path):
    scene = four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0)
    expected = transmission_angle(
        scene.mechanism, driven_turn(scene, count=73).position, 'crank_joint')
    text = (tmp_path / 'machine.yaml').read_text()
    text = text.replace('parent: crank, child: coupler, position: [crank, 0]',
                        'parent: rocker, child: coupler, position: [rocker, 0]')
    text = text.replace('body_a: coupler, point_a: [coupler, 0], body_b: rocker,',
                        'body_a: coupler, point_a: [coupler, 0], body_b: crank,')
    (tmp_path / 'machine.yaml').write_text(text.replace(
        'point_b: [rocker, 0]', 'point_b: [crank, 0]'))
    beta, psi = closed(2.0, 7.0, 9.0, 6.0, 1.0)
    (tmp_path / 'other.yaml').write_text((tmp_path / 'scene.yaml').read_text().replace(
        f'coupler_joint: {beta - 1.0!r}', f'coupler_joint: {beta - psi + math.pi!r}'))
    other = load_scene(tmp_path / 'other.yaml')
    run = driven_turn(other, count=73)
    found = transmission_angle(run.mechanism, run.position, 'crank_joint')
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_transmission_angles_of_linkages_in_others_of_rods_sliders_and_in_space():
    def angles(name, drive):
        scene = load_scene(name)
        model = Model(scene)
        place = float(model.assemble().q[model.coordinates.index[drive]])
        run = DrivenRun(scene, {drive: Drive(place, place + 1.0)}, 21, 1.0)
        evaluated = model.evaluate(model.state(run.position))
        return transmission_angle(run.mechanism, run.position, drive), run, evaluated.points

    # Hoeken's linkage within the leg: by the law of cosines, lengths 0.0625 and 0.0625 on 0.05.
    found, run, _ = angles('hoeken_pantograph_leg', 'theta_1')
    diagonal = np.abs(0.025 * np.exp(1j * run.driven['theta_1']) - 0.05)
    inner = 2.0 * np.arcsin(0.5 * diagonal / 0.0625)
    np.testing.assert_allclose(found, np.minimum(inner, np.pi - inner), atol=1e-12)
    # A massless rod of 0.28 from the crank to the shank, whose pin is 0.0632 from the knee.
    found, run, _ = angles('humanoid_knee', 'motor')
    pin = 0.3j - 0.04 * np.exp(1j * run.driven['motor'])
    arm = math.hypot(0.06, 0.02)
    inner = np.arccos((arm ** 2 + 0.28 ** 2 - np.abs(pin) ** 2) / (2.0 * arm * 0.28))
    np.testing.assert_allclose(found, np.minimum(inner, np.pi - inner), atol=1e-12)
    # A slider along x: the connecting rod's angle from the slide.
    found, run, _ = angles('slider_crank', 'crank_joint')
    lengths = load_scene('slider_crank').mechanism
    crank, rod = (abs(next(x for x in place if x)) for place in (
        next(joint.position for joint in lengths.joints if joint.parent == 'crank'),
        lengths.cut_joints[0].point_a))
    np.testing.assert_allclose(
        found, np.arccos(np.abs(crank * np.sin(run.driven['crank_joint'])) / rod), atol=1e-12)
    # In space: the rocker's end moves across its arm, about x.
    found, run, points = angles('rssr_four_bar', 'crank')
    end, turn = points['rocker_end'], run.driven['crank']
    rod = end - 0.1 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    way = np.cross([1.0, 0.0, 0.0], end - [0.4, 0.3, 0.0])
    shares = (rod * way).sum(axis=1) / np.linalg.norm(rod, axis=1) / np.linalg.norm(way, axis=1)
    np.testing.assert_allclose(found, np.arcsin(np.abs(shares)), atol=1e-12)
    assert angles('geared_five_bar', 'crank_1_joint')[0] is None


def test_hoekens_point_moves_along_a_line(tmp_path):
    scene = four_bar(tmp_path, 1.0, 2.5, 2.5, 2.0, angle=math.pi, point=(5.0, 0.0))
    run = driven_turn(scene, 0.5 * math.pi, 1.5 * math.pi, 721)
    found = design.outputs(run, run.table())
    x, y = (found[f'point.tool.{axis}'] for axis in 'xy')
    np.testing.assert_allclose([x.least.value, x.most.value], [0.0, 4.0], atol=1e-12)
    np.testing.assert_allclose([y.least.value, y.most.value], [4.0, 4.009754], atol=5e-7)


@pytest.mark.parametrize('speed', [1.0, 30.0])
def test_a_balanced_four_bar_shakes_by_its_moment_alone(tmp_path, speed):
    lengths, (m2, m3, m4) = (1.0, 4.0, 3.0, 3.5), (2.0, 1.5, 3.0)
    # Berkof and Lowen (1969): half of the coupler's mass at each of its pins.
    centers = [(-0.5 * m3 / m2 * lengths[0], 0.0), (0.5 * lengths[1], 0.0),
               (-0.5 * m3 / m4 * lengths[2], 0.0)]
    balanced = design.shaking(driven_turn(four_bar(
        tmp_path, *lengths, masses=(m2, m3, m4), centers=centers), speed=speed))
    plain = design.shaking(driven_turn(four_bar(
        tmp_path, *lengths, masses=(m2, m3, m4)), speed=speed))
    size = np.abs(plain[0]).max()
    assert size > 0.5 * speed ** 2
    assert np.abs(balanced[0]).max() < 1e-8 * size
    assert np.abs(balanced[1]).max() > 0.1 * speed ** 2


def test_shaking_is_what_the_joints_exert_on_the_ground(tmp_path):
    run = driven_turn(four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0), speed=3.0)
    column = by_name(run.table())
    force, moment = design.shaking(run)
    for k, axis in enumerate('xy'):
        joints = column[f'force.crank_joint.{axis}'] + column[f'force.rocker_joint.{axis}']
        np.testing.assert_allclose(force[:, k], -joints, atol=1e-7 * np.abs(joints).max())
    about = (column['force.crank_joint.torque'] + column['force.rocker_joint.torque']
             + 6.0 * column['force.rocker_joint.y'])
    np.testing.assert_allclose(moment, -about, atol=1e-7 * np.abs(about).max())


def test_shaking_in_space_is_what_the_joints_exert_on_the_ground():
    scene = replace(load_scene('bennett'), effects={})
    run = DrivenRun(scene, {'joint_1': Drive(0.5, 6.0)}, 61, 20.0)
    column = by_name(run.table())
    force, moment = design.shaking(run)
    pins = {'joint_1': (0.0, 0.0, 0.0), 'joint_4': scene.mechanism.cut_joints[0].point_b}
    joints, about = np.zeros((2, *force.shape))
    for name, place in pins.items():
        pushed = np.stack([column[f'force.{name}.{axis}'] for axis in 'xyz'], axis=1)
        joints += pushed
        about += np.cross(place, pushed) + np.stack(
            [column[f'force.{name}.torque_{axis}'] for axis in 'xyz'], axis=1)
    np.testing.assert_allclose(force, -joints, atol=1e-7 * np.abs(joints).max())
    np.testing.assert_allclose(moment, -about, atol=1e-7 * np.abs(about).max())


@pytest.mark.parametrize('lengths, kind, grashof', [
    ((6.0, 2.0, 7.0, 9.0), 'crank-rocker', 'Grashof'),
    ((6.0, 9.0, 7.0, 2.0), 'rocker-crank', 'Grashof'),
    ((2.0, 6.0, 7.0, 9.0), 'double crank (drag link)', 'Grashof'),
    ((6.0, 7.0, 2.0, 9.0), 'double rocker', 'Grashof'),
    ((7.5, 5.0, 4.0, 6.0), 'triple rocker', 'non-Grashof'),
    ((3.0, 1.0, 3.0, 1.0), 'change-point linkage', 'change point')])
def test_grashof_class_and_limits(tmp_path, lengths, kind, grashof):
    base, crank, coupler, rocker = lengths
    angle = {'double rocker': 1.2, 'rocker-crank': 0.9}.get(kind, 1.0)
    scene = four_bar(tmp_path, crank, coupler, rocker, base, angle=angle)
    found = four_bar_of(scene.mechanism, 'crank_joint')
    np.testing.assert_allclose(found.lengths, lengths)
    assert (found.kind, found.grashof) == (kind, grashof)
    if grashof != 'change point':
        drive, = design.cycle(scene).values()
        turns = kind in ('crank-rocker', 'double crank (drag link)')
        assert turns == (abs(drive.end - drive.start - 2.0 * math.pi) < 1e-12)
        if not turns:
            # From limit to limit, a hundredth of the way short of each.
            short = (drive.end - drive.start) / 98.0
            for limit in (drive.start - short, drive.end + short):
                assert min(abs(abs(np.angle(np.exp(1j * limit))) - abs(one))
                           for one in found.limits) < 1e-9


def test_time_ratio_is_that_of_the_dead_centres(tmp_path):
    crank, coupler, rocker, base = 2.0, 7.0, 9.0, 6.0
    run = driven_turn(four_bar(tmp_path, crank, coupler, rocker, base), count=1441)
    ratio = design.outputs(run, run.table())['rocker_joint'].time_ratio
    # Crank and coupler in line: stretched and folded.
    one, other = (math.acos((reach ** 2 + base ** 2 - rocker ** 2) / (2.0 * reach * base))
                  for reach in (coupler + crank, coupler - crank))
    share = 0.5 + (other - one) / (2.0 * math.pi)
    expected = max(share, 1.0 - share) / min(share, 1.0 - share)
    np.testing.assert_allclose(ratio, expected, rtol=1e-5)


def test_transmission_and_advantage_are_those_of_two_circles(tmp_path):
    crank, coupler, rocker, base = lengths = 2.0, 7.0, 9.0, 6.0
    # Poses that meet none of the places that are sought.
    turn = Drive(0.05, 0.05 + 2.0 * math.pi)
    run = DrivenRun(four_bar(tmp_path, *lengths), {'crank_joint': turn}, 91, 1.0)
    # The angle between coupler and rocker is least where crank and base are in line.
    expected = sorted(
        min(angle, math.pi - angle) for reach in (base - crank, base + crank)
        for angle in [math.acos((coupler ** 2 + rocker ** 2 - reach ** 2)
                                / (2.0 * coupler * rocker))])
    found = cycle.transmission_extremes(run)
    np.testing.assert_allclose([one.value for one in found], expected, atol=1e-12)
    np.testing.assert_allclose(np.sin([one.drive for one in found]), 0.0, atol=1e-6)
    # The rocker stands still where crank and coupler are in line.
    gain = cycle.advantages(run)['rocker_joint']
    lines = [math.acos((reach ** 2 + base ** 2 - rocker ** 2) / (2.0 * reach * base))
             for reach in (coupler + crank, coupler - crank)]
    lines[1] += math.pi
    np.testing.assert_allclose(sorted(np.mod(gain.dead_centres, 2.0 * math.pi)),
                               sorted(np.mod(lines, 2.0 * math.pi)), atol=1e-10)
    # Rates of crank and rocker by the closure of the two circles.
    angles = np.linspace(0.0, 2.0 * math.pi, 20001)
    psi = np.unwrap([closed(*lengths, angle)[1] for angle in angles])
    np.testing.assert_allclose(
        gain.least.value, (1.0 / np.abs(np.gradient(psi, angles)[1:-1])).min(), rtol=1e-6)


def test_a_pin_in_a_slot_pushes_across_it():
    # Of a quick-return drive the slot leads through the pivot of its lever: a right angle always,
    # and the lever turns as fast as the pin crosses it.
    scene = scene_of_yaml("""
mechanism:
  name: quick_return
  bodies:
    crank: {mass: 1.0, center_of_mass: [0.05, 0.0], inertia: 0.001}
    lever: {mass: 1.0, center_of_mass: [0.1, 0.0], inertia: 0.001}
  joints:
    crank_joint: {type: revolute, parent: ground, child: crank, position: [0.0, 0.25],
                  actuated: true}
    lever_joint: {type: revolute, parent: ground, child: lever, position: [0.0, 0.0]}
  cut_joints:
    slot: {type: point_on_line, body_a: crank, point_a: [0.1, 0.0], body_b: lever,
           point_b: [0.0, 0.0], angle: 0.0}
initial: {position: {crank_joint: 0.0, lever_joint: 1.19}, hold: [crank_joint]}
""", Path('quick_return.yaml'))
    run = DrivenRun(scene, {'crank_joint': Drive(0.0, 2.0 * math.pi)}, 181, 1.0)
    assert transmission_angle(run.mechanism, run.position, 'crank_joint') == pytest.approx(
        math.pi / 2.0)
    gain = cycle.advantages(run)['lever_joint']
    # The pin moves across the slot where that touches the crank's circle.
    np.testing.assert_allclose(np.sin(gain.dead_centres), -0.1 / 0.25, atol=1e-10)
    assert gain.least.value == pytest.approx((0.25 - 0.1) / 0.1)
    assert cycle.opened(run) == {}


def test_a_linkage_that_does_not_return_is_reported(tmp_path, capsys):
    # Of two cranks geared three to two a turn of the one is not a turn of the other.
    scene = tmp_path / 'scene.yaml'
    scene.write_text(GEARED)
    page = tmp_path / 'page.html'
    done(capsys, 'report', scene, '--output', page)
    assert 'does not return (follower by 180 deg' in page.read_text()
    assert cycle.opened(driven_turn(load_scene('four_bar'), count=31)) == {}


def test_points_move_as_the_crank_does():
    run = driven_turn(load_scene('slider_crank'), count=61)
    column, length = by_name(run.table()), 0.1
    angle, speed = run.driven['crank_joint'], np.ptp(run.driven['crank_joint']) / run.time[-1]
    for axis, way in (('x', np.cos), ('y', np.sin)):
        turned = way(angle + math.pi / 2.0)
        np.testing.assert_allclose(
            column[f'point_velocity.crank_pin.{axis}'], length * speed * turned, atol=1e-8)
        np.testing.assert_allclose(column[f'point_acceleration.crank_pin.{axis}'],
                                   -length * speed ** 2 * way(angle), atol=1e-8)


def test_tolerances_are_by_kind(tmp_path, capsys):
    scene = four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0)
    assert set(design.tolerated_keys(scene).values()) == {'length'}
    text = Path(scene.path).read_text()
    page = tmp_path / 'page.html'
    for given, reported in ((['--tolerance', '0.2mm'], '(length) 0.0002 m'),
                            (['--tolerance', 'coupler=0.5mm'], 'coupler (length) 0.0005 m')):
        done(
            capsys, 'report', scene.path, '--output', page, '--overwrite', '--drive',
            'crank_joint=0:1:5', *given)
        assert reported in page.read_text(), text
    assert 'expected one of length, lead, angle, ratio' in refused(
        capsys, 'report', scene.path, '--output', page, '--overwrite', '--tolerance', 'nothing=1')


def test_ranges_of_a_load_are_counted():
    pytest.importorskip('rainflow')
    # The example of ASTM E1049-85, figure 6, with ranges as the standard counts them.
    found = cycle.load_spectrum(np.array([-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0]))
    counted = {}
    for size, _, count in found:
        counted[size] = counted.get(size, 0.0) + count
    assert counted == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}


def test_a_report_is_written_as_a_document(tmp_path, capsys):
    pytest.importorskip('fpdf')
    document = tmp_path / 'report.pdf'
    done(capsys, 'report', 'four_bar', '--output', document)
    assert document.read_bytes()[:5] == b'%PDF-' and len(document.read_bytes()) > 50_000


def test_sensitivities_are_those_of_two_circles(tmp_path):
    lengths = np.array([2.0, 7.0, 9.0, 6.0])
    scene = four_bar(tmp_path, *lengths.tolist())
    run = driven_turn(scene, 0.3, 2.3, 21)
    keys = design.length_keys(scene)
    assert set(keys) == {f'parameters.{name}' for name in ('crank', 'coupler', 'rocker', 'base')}
    keys = tuple(f'parameters.{name}' for name in ('crank', 'coupler', 'rocker', 'base'))
    found = design.sensitivity(scene, run, keys)
    place = found.outputs.index('rocker_joint')
    # crank e^(i alpha) + coupler e^(i beta) - rocker e^(i psi) - base = 0, differentiated.
    for pose, angle in enumerate(run.driven['crank_joint']):
        beta, psi = closed(*lengths, angle)
        bars = np.exp(1j * np.array([angle, beta, psi, 0.0]))
        matrix = np.array([1j * lengths[1] * bars[1], -1j * lengths[2] * bars[2]])
        for k, sign in enumerate((1.0, 1.0, -1.0, -1.0)):
            right = -sign * bars[k]
            expected = np.linalg.solve(
                [matrix.real, matrix.imag], [right.real, right.imag])[1]
            np.testing.assert_allclose(found.derivatives[pose, place, k], expected, atol=1e-11)
    derivatives = np.abs(found.derivatives[:, place])
    np.testing.assert_allclose(found.worst(0.01)[place], 0.01 * derivatives.sum(axis=1).max())
    np.testing.assert_allclose(
        found.sigma(0.03)[place], 0.01 * np.sqrt((derivatives ** 2).sum(axis=1)).max())


@pytest.mark.parametrize('name, drives, count', [
    ('slider_crank', {'crank_joint': Drive(0.5, 3.5)}, 2),
    ('rssr_four_bar', {'crank': Drive(0.0, 2.0)}, 7),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('hoeken_pantograph_leg', {'theta_1': Drive(0.5, 3.5)}, 12), ('scissor_lift', None, 8),
        ('stewart_platform', None, 3)))])
def test_sensitivities_are_those_of_other_machines_driven_so(name, drives, count):
    scene = load_scene(name)
    if drives is None:
        model = Model(scene)
        start, coordinates = model.assemble(), model.coordinates
        drives = {one: Drive(float(place), float(place) + 0.02) for one in model.actuated_joints
                  for place in [start.q[coordinates.place[coordinates.index[one]]]]}
    run = DrivenRun(scene, drives, 11, 1.0)
    keys = design.length_keys(scene)[:count]
    found = design.sensitivity(scene, run, keys)
    begun = replace(scene, initial=replace(
        scene.initial, position=tuple(run.position[0].tolist()), hold=()))
    for k, key in enumerate(keys):
        path = resolve(scene, key)
        value = numbers(scene)['.'.join(path)]
        step, ends = 1e-5 * abs(value), []
        for sign in (1.0, -1.0):
            other = DrivenRun(changed(begun, {path: value + sign * step}), drives, 11, 1.0)
            column = by_name(other.table())
            ends.append(np.stack([
                column[what if what.startswith('point.') else f'position.{what}']
                for what in found.outputs], axis=1))
        expected = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(found.derivatives[..., k], expected, rtol=1e-5, atol=2e-6,
                                   err_msg=key)


def test_sensitivity_refuses_lengths_that_close_no_loop():
    scene = load_scene('bennett')
    name, = scene.mechanism.actuated_joints or ('crank_joint',)
    model = Model(scene)
    place = float(model.assemble().q[model.coordinates.index[name]])
    run = DrivenRun(scene, {name: Drive(place, place + 0.3)}, 5, 1.0)
    with pytest.raises(ValueError, match='no position closes the loops at another length'):
        design.sensitivity(scene, run, ['parameters.b'])


def test_a_report_is_no_wider_than_paper(capsys, tmp_path):
    page = tmp_path / 'page.html'
    done(capsys, 'report', 'hoeken_pantograph_leg', '--drive', 'theta_1=0:1:5', '--output', page)
    text = page.read_text()
    rows = text.split('<tr>')[1:]
    assert max(row.count('<th>') + row.count('<td ') for row in rows) <= 8
    for key in design.length_keys(load_scene('hoeken_pantograph_leg')):
        assert f'<th>{key.removeprefix("mechanism.")}</th>' in text, key


def test_report_refuses_what_it_cannot_drive(capsys, tmp_path):
    page = tmp_path / 'page.html'
    code, _, errors = call(capsys, 'report', 'three_rrr', '--output', page)
    assert code == 2 and 'one actuated joint, which turns; got theta_1, theta_6, theta_7' in errors
    code, _, errors = call(capsys, 'report', 'geneva_drive', '--output', page)
    assert code == 2 and 'got 1: driver_joint; wheel_joint can still move' in errors
    code, text, errors = call(capsys, 'report', 'rssr_four_bar', '--output', page)
    assert code == 0 and 'degrees of freedom  2 (1 idle: rods that turn' in text, errors
    page.write_text('mine')
    code, _, errors = call(capsys, 'report', 'four_bar', '--output', page)
    assert code == 2 and 'add --overwrite' in errors and page.read_text() == 'mine'
    code, _, errors = call(capsys, 'report', 'four_bar', '--output', tmp_path, '--overwrite')
    assert code == 2 and 'expected a file' in errors
    code, _, errors = call(capsys, 'report', 'four_bar', '--tolerance', 0, '--output', page)
    assert code == 2 and 'expected a finite number > 0' in errors


def test_compared_machines_differ_as_their_lengths_do(capsys, tmp_path):
    four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0)
    out = tmp_path / 'out'
    text = done(
        capsys, 'compare', tmp_path / 'scene.yaml', '--set', 'parameters.crank=1.5', '--set',
        'parameters.crank=2,parameters.rocker=8', '--drive', 'crank_joint=0:360deg:181',
        '--output', out)
    assert '1: scene, parameters.crank = 1.5\n' in text and 'rocker = 8\n' in text
    with open(out / 'differences.csv', newline='') as file:
        header, *rows = csv.reader(file)
    assert header == ['', 'scene, parameters.crank = 1.5',
                      'scene, parameters.crank = 2, parameters.rocker = 8',
                      'scene, parameters.crank = 2, parameters.rocker = 8 against scene, '
                      'parameters.crank = 1.5']
    table = {row[0]: list(map(float, row[1:])) for row in rows}
    expected = [
        math.degrees(math.acos((49.0 + rocker ** 2 - (6.0 - crank) ** 2) / (14.0 * rocker)))
        for crank, rocker in ((1.5, 9.0), (2.0, 8.0))]
    least = table['least transmission angle [deg]']
    np.testing.assert_allclose(least[:2], expected, rtol=1e-9)
    np.testing.assert_allclose(least[2], (expected[1] - expected[0]) / expected[0])
    for number, (crank, rocker) in enumerate(((1.5, 9.0), (2.0, 8.0)), 1):
        # Each file of rows is that of its own machine.
        scene = json.loads((out / f'{number}.csv.scene.json').read_text())
        joints = scene['mechanism']['joints']
        assert joints['coupler_joint']['position'][0] == crank
        rows = read(out / f'{number}.csv')
        psi = np.array([closed(crank, 7.0, rocker, 6.0, angle)[1]
                        for angle in np.linspace(0.0, 2.0 * math.pi, 181)])
        apart = np.angle(np.exp(1j * (np.array(rows['position.rocker_joint']) - psi)))
        np.testing.assert_allclose(apart, 0.0, atol=1e-9)
        done(capsys, 'plot', out / f'{number}.csv', '--output', out / f'{number}')
    assert all((out / name).read_bytes()[:4] == b'\x89PNG' for name in ('paths.png', 'curves.png'))


def test_one_set_is_compared_with_the_scene_as_it_is(capsys):
    text = done(
        capsys, 'compare', 'four_bar', '--set', 'effects.gravity.acceleration.1=0', '--drive',
        'crank_joint=60:120deg:7')
    assert '1: four_bar\n2: four_bar, effects.gravity.acceleration.1 = 0\n' in text
    assert 'stroke rocker_joint [rad]' in text and '+0 %' in text


def test_compare_tells_which_machine_does_not_get_there(capsys, tmp_path):
    four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0)
    text = done(
        capsys, 'compare', tmp_path / 'scene.yaml', '--set', 'parameters.crank=5', '--drive',
        'crank_joint=1:2:11')
    code, text, errors = call(
        capsys, 'compare', tmp_path / 'scene.yaml', '--set', 'parameters.crank=5', '--drive',
        'crank_joint=1:-1:41')
    # Coupler and rocker fold: 9 - 7 is longer than the way to the pin.
    limit = math.acos((25.0 + 36.0 - 4.0) / 60.0)
    assert code == 1 and f'crank_joint = {limit:.6f}'[:20] in errors
    assert 'compare: scene, parameters.crank = 5: pose ' in errors


@pytest.mark.parametrize('arguments, message', [
    (['four_bar'], 'expected two scenes or more, or one with --set, got one'),
    (['four_bar', 'four_bar'], 'expected different machines, got four_bar twice'),
    (['four_bar', 'slider_crank', '--set', 'method.step_size=1'], 'with one scene, got 2'),
    (['four_bar', '--set', 'x'], "expected KEY=NUMBER[,KEY=NUMBER], got 'x'"),
    (['four_bar', '--set', 'mechanism.nothing=1'], '--set: mechanism.nothing: expected one of'),
    (['four_bar', 'three_rrr'], 'three_rrr: --drive: expected drives')])
def test_compare_refuses_what_makes_no_sense(capsys, arguments, message):
    assert message in refused(capsys, 'compare', *arguments)


def test_view_shows_a_machine_of_other_numbers(capsys, tmp_path):
    done(
        capsys, 'view', 'four_bar', '--set', 'mechanism.joints.rocker_joint.position.0=0.4321',
        '--duration', 0.05, '--save', tmp_path / 'page.html')
    assert '0.4321' in (tmp_path / 'page.html').read_text()
    rows = tmp_path / 'run.csv'
    rows.write_text('')
    code, _, errors = call(capsys, 'view', rows, '--set', 'method.step_size=1')
    assert code == 2 and '--set: expected a scene' in errors


def test_drives_that_no_motion_has_are_refused(capsys, tmp_path):
    assert 'slider_joint: expected mm or cm or m or inch, got deg' in refused(
        capsys, 'kinematics', 'slider_crank', '--drive', 'slider_joint=0.3:20deg:5')
    code, _, errors = call(capsys, 'kinematics', 'rssr_four_bar', '--drive', 'tip.rx=0:1:5')
    assert code == 2 and 'tip.rx: expected a joint (crank, rocker) or' in errors


def test_more_frames_than_a_disk_has_room_for_are_refused(capsys, tmp_path):
    rows = tmp_path / 'rows.csv'
    call(capsys, 'kinematics', 'four_bar', '--drive', 'crank_joint=1:2:3', '--output', rows)
    assert 'expected at most 20000 frames, got 2' in refused(
        capsys, 'animate', rows, '--output', tmp_path / 'a.gif', '--speed', 1e-12)


def test_options_of_a_workspace_are_named_as_they_are_given(capsys):
    for options, message in (
            (['--point', 'nothing'], 'workspace: --point: expected a named point'),
            (['--torque-limit', 'theta_1=-1'], '--torque-limit: theta_1: expected a finite'),
            (['--picture', 'map.xyz'], '--picture: expected a name that ends with .png')):
        assert message in refused(
            capsys, 'workspace', 'three_rrr', '--point', 'platform_center', *options)
    assert 'workspace: expected 2 degrees of freedom' in refused(capsys, 'workspace', 'four_bar')


def test_end_stops_that_are_met_are_named(capsys, tmp_path):
    drive = ('slider_crank_end_stop', '--drive', 'crank_joint=60:420deg:37')
    text = done(capsys, 'kinematics', *drive)
    # The stroke ends at 0.4 m, the rubber begins at 0.38 m.
    assert 'end stop  buffer: slider_joint goes beyond it by at most 0.02 at crank_joint' in text
    code, text, errors = call(capsys, 'report', *drive, '--output', tmp_path / 'page.html')
    assert code == 0 and 'end stop buffer  slider_joint goes beyond it' in text, errors
    code, text, _ = call(capsys, 'kinematics', drive[0], '--drive', 'crank_joint=60:90deg:9')
    assert code == 0 and 'end stop' not in text
