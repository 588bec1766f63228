# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that answer a designer: driven motions, reports, comparisons."""

import json
import math

from closedloop_dynamics import load_scene
from closedloop_dynamics.recording.kinematics import by_name, Drive, DrivenRun
import numpy as np
import pytest
from scipy.integrate import simpson

from .test_cli import call, read


@pytest.mark.parametrize('scene, size', [
    ('four_bar', 1.0), ('slider_crank', 1.0), ('three_rrr_vertical', 0.05), ('delta_robot', 0.1),
    ('stewart_platform', 0.02), ('geared_five_bar', 0.5)])
def test_work_of_the_drives_is_what_the_energy_gains(scene, size):
    model = load_scene(scene).model()
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
    model = scene.model()
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
    code, text, errors = call(
        capsys, 'kinematics', 'four_bar', '--drive', 'crank_joint=1.0472:3.0472:41', '--speed', 4,
        '--set', 'mechanism.bodies.coupler.mass=1.5', '--output', ours, '--picture', picture)
    assert code == 0, errors
    assert '41 poses, crank_joint from 1.0472 to 3.0472 in 0.5 s' in text
    assert picture.read_bytes()[:4] == b'\x89PNG'
    scene = json.loads((tmp_path / 'turn.csv.scene.json').read_text())
    assert scene['mechanism']['bodies']['coupler']['mass'] == 1.5
    code, _, _ = call(
        capsys, 'simulate', 'four_bar', '--motion', 'crank_joint=1.0472+4*t', '--duration', 0.5,
        '--rate', 80, '--forces', 'all', '--output', theirs, '--set',
        'mechanism.bodies.coupler.mass=1.5')
    assert code == 0
    found, expected = read(ours), read(theirs)
    for name, values in expected.items():
        if not name.startswith('motion.') and name != 'closure':
            np.testing.assert_allclose(found[name], values, atol=2e-6, err_msg=name)
    code, _, errors = call(capsys, 'plot', ours, '--output', tmp_path / 'pictures')
    assert code == 0, errors


def test_kinematics_tells_where_a_branch_ends(capsys, tmp_path):
    rows = tmp_path / 'rows.csv'
    code, text, errors = call(capsys, 'kinematics', 'four_bar', '--drive',
                              'rocker_joint=100:160deg:61', '--output', rows)
    assert code == 1 and 'pose 44: ' in errors and '(143.13 deg)' in errors
    assert '44 poses' in text and len(read(rows)['time']) == 44
    code, _, errors = call(capsys, 'kinematics', 'four_bar', '--drive', 'rocker_joint=20:30deg:3')
    assert code == 2 and "On the way from the scene's start to the first pose" in errors


def test_kinematics_lists_assemblies_and_starts_on_one(capsys, tmp_path):
    drive = ('kinematics', 'four_bar', '--drive', 'crank_joint=1:2:11')
    code, text, _ = call(capsys, *drive, '--assemblies')
    assert code == 0 and 'proved: 2 (at most 2)' in text
    ends = []
    for branch in (1, 2):
        path = tmp_path / f'{branch}.csv'
        code, _, errors = call(capsys, *drive, '--branch', branch, '--output', path)
        assert code == 0, errors
        column = read(path)
        psi = np.array(column['position.rocker_joint'])
        pin = 0.4 + 0.25 * np.exp(1j * psi) - 0.1 * np.exp(1j * np.linspace(1.0, 2.0, 11))
        np.testing.assert_allclose(np.abs(pin), 0.35, atol=1e-12)
        ends.append(psi[-1])
    assert abs(ends[0] - ends[1]) > 1.0


@pytest.mark.parametrize('options, message', [
    (['--drive', 'crank_joint=0:1'], 'NAME=FROM:TO:COUNT with COUNT from 2 on, or NAME=VALUE'),
    (['--drive', 'crank_joint=0:1:1'], 'COUNT from 2 on'),
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
    (['--drive', 'crank_joint=0:1:5', '--branch', '7'], '--branch: expected the number of an'),
    ([], '--drive')])
def test_kinematics_refuses_what_makes_no_sense(capsys, options, message):
    code, _, errors = call(capsys, 'kinematics', 'four_bar', *options)
    assert code == 2 and message in errors, errors


def test_units_of_drives(capsys, tmp_path):
    found = []
    for course in ('60:90deg:3', '60deg:90deg:3', f'{math.pi / 3!r}:{math.pi / 2!r}:3',
                   f'60deg:{math.pi / 2!r}rad:3'):
        path = tmp_path / f'{len(found)}.csv'
        code, _, errors = call(
            capsys, 'kinematics', 'four_bar', '--drive', f'crank_joint={course}', '--output', path)
        assert code == 0, errors
        found.append(read(path)['position.crank_joint'])
    np.testing.assert_allclose(found, [found[2]] * 4, atol=1e-14)
