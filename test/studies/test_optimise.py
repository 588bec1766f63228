# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The best numbers of a machine: known answers, derivatives, and what is not a machine."""

import json
import math

from closedloop_dynamics import load_scene, Model
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.kinematics import named_paths
from closedloop_dynamics.recording.kinematics import Drive, DrivenRun
from closedloop_dynamics.scene.edit import write_with_numbers
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
from closedloop_dynamics.studies.objectives import Expression, Requirement
from closedloop_dynamics.studies.optimise import (
    from_start, optimise, Optimum, OptimumFileError, problem_of, solve)
from closedloop_dynamics.studies.quantities import (
    Driven, Infeasible, Quantities, Variable, with_values)
import numpy as np
import pytest

from ..test_cli import call, done, refused

TURN = {'crank_joint': Drive(0.0, 2.0 * math.pi)}
CRANK = 'mechanism.joints.coupler_joint.position.0'
ROCKER = 'mechanism.cut_joints.cut_1.point_b.0'
WEIGHT = 'mechanism.bodies.crank.center_of_mass.0'
TRACER = 'mechanism.points.coupler_point.position.1'
VARIABLES = (Variable(CRANK, 0.05, 0.12), Variable(ROCKER, 0.2, 0.3), Variable(WEIGHT, -0.1, 0.1),
             Variable(TRACER, -0.1, 0.2))
PLACES = {'wanted.csv': np.array([[0.2, 0.1], [0.15, 0.2], [0.1, 0.15]])}


def driven(poses=25, speed=10.0):
    return Driven(TURN, poses, speed)


# Exact but for rounding: the differences they are compared with are not. And differences of
# the sixth order.
@pytest.mark.parametrize('text, tolerance', [
    ('straightness(coupler_point)', 1e-7),
    ('distance(coupler_point, wanted.csv)', 1e-7),
    ('min(transmission_angle) - 40deg', 1e-7),
    ('rms(deviation(part(coupler_point, 90deg, 270deg)))', 1e-7),
    ('max(coupler_point.x) * sqrt(mean(coupler_point.y**2)) / 2mm', 1e-7),
    (f'hypot({ROCKER}, mean(position.rocker_joint)) - atan2(1, {CRANK})', 1e-7),
    ('max(max(position.rocker_joint), mean(exp(sin(position.coupler_joint)))) ** 2', 1e-7),
    ('max(force.cut_1) + 0.1 * max(abs(shaking_moment))', 1e-5),
    ('rms(torque.crank_joint - mean(torque.crank_joint)) + max(power.crank_joint)', 1e-5),
    ('rms(shaking_force) - max(velocity.rocker_joint)', 1e-5)])
def test_derivatives_are_those_of_differences(text, tolerance):
    scene = load_scene('four_bar')
    one = Expression(text, scene, TURN, PLACES)
    found = one.value(Quantities(scene, driven()).by(VARIABLES))
    step, wanted = 1e-5, []
    for variable in VARIABLES:
        value = numbers(scene)[variable.key]
        above, below = (float(one.value(Quantities(with_values(
            scene, [variable], [value + sign * step]), driven())).value) for sign in (1.0, -1.0))
        wanted.append((above - below) / (2.0 * step))
    assert float(found.value) == float(one.value(Quantities(scene, driven())).value)
    np.testing.assert_allclose(found.slope, wanted, atol=tolerance * np.abs(wanted).max())
    assert np.abs(wanted).max() > 0.0


def test_derivatives_in_space_and_of_driven_points():
    manipulator = load_scene('three_rrr_vertical')
    model = Model(manipulator)
    start = model.assemble()
    x, y = model.evaluate(start).points['platform_center']
    theta = start.q[model.coordinates.index['theta_1']]
    for scene, drives, keys, text in (
            (load_scene('rssr_four_bar'), {'crank': Drive(0.0, 2.0 * math.pi)},
             ('mechanism.joints.tip.position.0', 'mechanism.bodies.rocker.mass'),
             'min(transmission_angle) + rms(shaking_moment) + straightness(rocker_end)'),
            (manipulator,
             {'platform_center.x': Drive(x, x + 0.04), 'platform_center.y': Drive(y, y - 0.02),
              'theta_1': Drive(theta, theta)},
             ('mechanism.points.platform_center.position.0',
              'mechanism.joints.theta_2.position.0'),
             'rms(torque.theta_1) * max(position.theta_6)')):
        one, how = Expression(text, scene, drives), Driven(drives, 7, 1.0)
        variables = [Variable(key, *sorted((0.8 * numbers(scene)[key], 1.2 * numbers(scene)[key])))
                     if numbers(scene)[key] else Variable(key, -0.1, 0.1) for key in keys]
        found, wanted = one.value(Quantities(scene, how).by(variables)), []
        for variable in variables:
            values = [numbers(scene)[variable.key] + step for step in (1e-5, -1e-5)]
            above, below = (float(one.value(Quantities(
                with_values(scene, [variable], [value]), how)).value) for value in values)
            wanted.append((above - below) / 2e-5)
        np.testing.assert_allclose(found.slope, wanted, atol=1e-5 * np.abs(wanted).max())


def test_scene_that_holds_other_joints_than_the_driven_one(tmp_path):
    # Whose rocker stands elsewhere with another crank.
    problem = problem_of('rssr_four_bar', {'mechanism.joints.tip.position.0': (0.08, 0.12)},
                         ['straightness(rocker_end)'], poses=13,
                         drives={'crank': Drive(0.0, 2.0 * math.pi)})
    found = from_start(problem, 0, 0)
    assert found.aims[0] < problem.before[0]
    written, _ = write_with_numbers(problem.scene, {
        **dict(zip([problem.variables[0].key], found.values)),
        **{key: value for key, value in numbers(Optimum(problem).scene(found)).items()
           if key.startswith('initial.position.')}}, tmp_path / 'found.yaml')
    Model.from_scene(written[0]).assemble()


def test_poses_are_those_whose_largest_or_mean_square_the_value_is():
    scene = load_scene('four_bar')
    quantities = Quantities(scene, driven())
    for text in ('max(force.cut_1)', '-min(transmission_angle)', 'straightness(coupler_point)'):
        one = Expression(text, scene, TURN)
        parts = one.largest_parts(quantities).value
        assert parts.shape == (25,) and parts.max() == float(one.value(quantities).value)
    for text in ('rms(shaking_force)', 'distance(coupler_point, wanted.csv)'):
        one = Expression(text, scene, TURN, PLACES)
        parts = one.squared_parts(quantities).value
        np.testing.assert_allclose(np.linalg.norm(parts), float(one.value(quantities).value))
    assert Expression('2 * max(force.cut_1)', scene, TURN).largest_parts(quantities) is None


def test_distance_is_that_from_a_curve_drawn_much_finer():
    scene = load_scene('four_bar')
    fine = DrivenRun(scene, TURN, 20001, 1.0)
    curve = named_paths(fine.mechanism, fine.position)['coupler_point']
    apart = np.linalg.norm(curve - PLACES['wanted.csv'][:, np.newaxis], axis=2).min(axis=1)
    found = Expression('distance(coupler_point, wanted.csv)', scene, TURN, PLACES).value(
        Quantities(scene, driven(73)))
    assert float(found.value) == pytest.approx(np.sqrt(np.mean(apart ** 2)), rel=1e-6)


def test_counterweights_balance_a_four_bar():
    # Berkof and Lowen (1969): the coupler's mass, half at each of its pins, is balanced by the
    # crank and the rocker, each about its own pivot.
    scene = load_scene('four_bar')
    bodies = {body.name: body for body in scene.mechanism.bodies}
    optimum = optimise(scene, {
        f'mechanism.bodies.{body}.center_of_mass.{axis}': (-0.5, 0.5)
        for body in ('crank', 'rocker') for axis in (0, 1)}, 'rms(shaking_force)', drives=TURN,
        poses=25, speed=10.0, starts=1, workers=1)
    half = 0.5 * bodies['coupler'].mass
    wanted = [-half * 0.1 / bodies['crank'].mass, 0.0, -half * 0.25 / bodies['rocker'].mass, 0.0]
    np.testing.assert_allclose(optimum.best.values, wanted, atol=1e-7)
    assert optimum.best.aims[0] < 1e-6 * optimum.problem.before[0]


@pytest.mark.slow
def test_four_bar_leads_a_point_through_eight_places():
    # Of the curve of another four-bar, rounded to millimetres.
    places = np.array([[0.098, 0.166], [0.150, 0.260], [0.116, 0.287], [0.044, 0.249],
                       [-0.011, 0.169], [-0.033, 0.091], [-0.019, 0.047], [0.026, 0.067]])
    joints, point = 'mechanism.joints', 'mechanism.points.coupler_point.position'
    problem = problem_of('four_bar', {
        f'{joints}.crank_joint.position.0': (-0.2, 0.2),
        f'{joints}.crank_joint.position.1': (-0.2, 0.2), CRANK: (0.05, 0.2),
        f'{joints}.rocker_joint.position.0': (0.2, 0.6),
        f'{joints}.rocker_joint.position.1': (-0.2, 0.2),
        'mechanism.cut_joints.cut_1.point_a.0': (0.2, 0.5), ROCKER: (0.2, 0.5),
        f'{point}.0': (-0.1, 0.4), f'{point}.1': (-0.3, 0.3)},
        ['distance(coupler_point, eight)'], drives=TURN, poses=25, seed=3,
        paths={'eight': places})
    found = from_start(problem, 0, 1)
    fine = DrivenRun(Optimum(problem).scene(found), TURN, 3601, 1.0)
    curve = named_paths(fine.mechanism, fine.position)['coupler_point']
    apart = np.linalg.norm(curve - places[:, np.newaxis], axis=2).min(axis=1)
    assert apart.mean() < 0.01 * np.ptp(curve, axis=0).max()
    assert found.aims[0] < 0.1 * problem.before[0]


def test_front_of_straightness_and_torque_ripple():
    requirement = 'max(tool.x) - min(tool.x) >= 0.5'
    optimum = optimise(
        'carpet_scraper', {'mechanism.cut_joints.cut_1.point_a.0': (0.03, 0.045),
                           'mechanism.joints.theta_2.position.0': (-0.11, -0.08)},
        ['straightness(part(tool, -75deg, 75deg))', 'max(torque.theta_1) - min(torque.theta_1)'],
        requirement, {'theta_1': Drive(-math.pi, math.pi)}, poses=13, speed=5.0, starts=1,
        front=3, workers=1)
    aims = np.array([one.aims for one in optimum.front])
    assert optimum.finished and len(aims) == 3
    assert (np.diff(aims[:, 0]) > 0.0).all() and (np.diff(aims[:, 1]) < 0.0).all()
    # Smoother and straighter than the machine as it is.
    assert (aims < optimum.problem.before).all(axis=1).any()
    for one in optimum.front:
        run = optimum.problem.driven.run(optimum.scene(one))
        tool = named_paths(run.mechanism, run.position)['tool']
        assert np.ptp(tool[:, 0]) > 0.5 - 1e-6
        # Independent of how the line is found: no line is nearer to all of the path.
        path = tool[np.abs(run.driven['theta_1']) <= math.radians(75.0) + 1e-9]
        slope, offset = np.polyfit(*path.T, 1)
        off = np.abs(path[:, 1] - slope * path[:, 0] - offset) / math.hypot(1.0, slope)
        assert one.aims[0] == pytest.approx(off.max(), rel=1e-2)


def test_longest_crank_that_turns_round_is_that_of_grashof():
    # Crank and base are together as long as coupler and rocker: beyond, no machine turns round.
    optimum = optimise('four_bar', {CRANK: (0.05, 0.4)},
                       'min(position.rocker_joint) - max(position.rocker_joint)', drives=TURN,
                       poses=25, starts=1, workers=1)
    crank, = optimum.best.values
    assert 0.2 - 1e-4 < crank < 0.2
    assert sum(optimum.refused.values()) > 0
    assert all(math.isfinite(aim) for aim in optimum.best.aims)


def test_requirement_that_no_machine_meets_is_reported():
    optimum = optimise('four_bar', {CRANK: (0.09, 0.11)}, 'max(coupler_point.x)',
                       'min(transmission_angle) >= 80deg', TURN, poses=9, starts=1, workers=1)
    assert optimum.best is None and not optimum.starts['aim 1 start 0'].feasible


def test_bound_of_an_angle_is_met_at_its_worst_pose():
    optimum = optimise('four_bar', {CRANK: (0.05, 0.15), ROCKER: (0.2, 0.3)},
                       'min(position.rocker_joint) - max(position.rocker_joint)',
                       'min(transmission_angle) >= 40deg', TURN, poses=73, starts=1, workers=1)
    crank, rocker = optimum.best.values
    # By the law of cosines, where crank and base lie in line.
    angles = [math.acos((0.35 ** 2 + rocker ** 2 - base ** 2) / (0.7 * rocker))
              for base in (0.4 - crank, 0.4 + crank)]
    least = min(min(angle, math.pi - angle) for angle in angles)
    assert least == pytest.approx(math.radians(40.0), abs=1e-5)


VARY = {CRANK: (0.08, 0.12), TRACER: (0.0, 0.2)}


def search(file=None, **options):
    return optimise('four_bar', VARY, 'straightness(coupler_point)', drives=TURN, poses=13,
                    starts=3, seed=5, workers=1, file=file, **options)


def test_search_goes_on_where_it_was_interrupted(tmp_path):
    whole = search(tmp_path / 'whole.jsonl')
    done, file = [], tmp_path / 'parts.jsonl'
    part = search(file, show=lambda count, total: done.append(count),
                  keep_going=lambda: done[-1] < 1)
    assert not part.finished and len(part.starts) < 3
    with file.open('a') as out:
        out.write('["aim 1 start 2", {"valu')
    again = search(file, resume=True)
    assert again.finished and again.starts == whole.starts
    assert file.read_text() == (tmp_path / 'whole.jsonl').read_text()
    assert search(file, resume=True).starts == whole.starts


@pytest.mark.parametrize('text', ['', '{}\n', 'no\n', '{"format": 1, "identity": "other"}\n'])
def test_results_of_another_search_are_refused(tmp_path, text):
    file = tmp_path / 'results.jsonl'
    file.write_text(text)
    with pytest.raises(OptimumFileError):
        search(file, resume=True)
    assert file.read_text() == text


def test_several_workers_find_what_one_finds():
    problem = problem_of('four_bar', VARY, ['straightness(coupler_point)'], drives=TURN, poses=13)
    here, there = (solve(problem, 2, workers=count).starts for count in (1, 2))
    assert list(here) == list(there)
    for one, other in zip(here.values(), there.values()):
        np.testing.assert_allclose(one.values, other.values, rtol=1e-6)


@pytest.mark.parametrize('text, message', [
    ('max(force.pin)', "unknown name 'force.pin'"), ('force.cut_1', 'one number'),
    ('biggest(force.cut_1)', "'biggest'"), ('max(coupler_point)', 'over the motion'),
    ('max(2 * coupler_point)', 'coordinates'), ('straightness(force.cut_1)', 'of a point'),
    ('max(mechanism.bodies.crank.mass)', 'over the motion'), ('max(torque.crank_joint', 'got'),
    ('distance(coupler_point, other.csv)', "'other.csv'"),
    ('rms(part(torque.crank_joint, 10deg, 11deg))', 'three poses'),
    ('__import__("os")', 'got'), ('max(force.cut_1, 3, 4)', 'functions')])
def test_expressions_that_make_no_sense_are_refused(text, message):
    with pytest.raises(FieldError, match='minimise') as caught:
        try:
            problem_of('four_bar', VARY, [text], drives=TURN, poses=13)
        except FieldError as error:
            error.path = ('minimise', *error.path)
            raise
    assert message in str(caught.value)
    assert '__0' not in str(caught.value)


@pytest.mark.parametrize('options', [
    {'vary': {}}, {'vary': {CRANK: (0.2, 0.1)}}, {'vary': {CRANK: (0.1, math.inf)}},
    {'vary': {'mechanism.bodies.crank.colour': (0.0, 1.0)}}, {'minimise': []},
    {'minimise': ['max(force.cut_1)'] * 3}, {'subject_to': ['max(force.cut_1)']},
    {'subject_to': ['1 <= max(force.cut_1) <= 2']}, {'poses': 2},
    {'paths': {'wanted': [[0.0, math.nan]]}}, {'drives': {'crank': Drive(0.0, 1.0)}}])
def test_problems_that_make_no_sense_are_refused(options):
    given = {'vary': VARY, 'minimise': ['max(force.cut_1)'], 'drives': TURN, **options}
    with pytest.raises(ValueError):
        problem = problem_of('four_bar', **given)
        problem.driven.run(problem.scene)


def test_requirement_tells_by_how_much_it_is_missed():
    scene = load_scene('four_bar')
    quantities = Quantities(scene, driven())
    angle = float(quantities['transmission_angle'].value.min())
    one = Requirement('min(transmission_angle) >= 60deg', scene, TURN)
    assert one.missed(quantities) == pytest.approx(1.0 - angle / math.radians(60.0))
    assert one.gaps(quantities).value.min() == pytest.approx(angle - math.radians(60.0))
    assert Requirement('min(transmission_angle) >= 20deg', scene, TURN).missed(quantities) == 0.0


def test_numbers_without_value_are_no_machine():
    scene = load_scene('four_bar')
    with pytest.raises(Infeasible, match='no value'):
        Expression(f'1 / sqrt({CRANK} - 1)', scene, TURN).value(Quantities(scene, driven()))


def test_scene_keeps_the_words_of_its_author(tmp_path):
    scene = load_scene('four_bar')
    files, kept = write_with_numbers(
        scene, {CRANK: 0.11, 'effects.gravity.acceleration.1': -1.62}, tmp_path / 'moon.yaml')
    before, after = (scene.path.read_text().splitlines(), files[0].read_text().splitlines())
    changes = [(one, other) for one, other in zip(before, after) if one != other]
    assert kept and len(files) == 2 and len(before) == len(after) and len(changes) == 2
    assert 'acceleration: [0.0, -1.62]}    # m/s^2' in changes[1][1]
    wanted = changed(scene, {resolve(scene, CRANK): 0.11})
    found = load_scene(files[0])
    assert found.mechanism.joints == wanted.mechanism.joints
    assert found.effects['gravity'].acceleration == (0.0, -1.62)


def test_scene_without_places_for_numbers_is_written_whole(tmp_path):
    key = 'mechanism.joints.coupler_joint.angle'
    scene = load_scene('four_bar')
    files, kept = write_with_numbers(scene, {key: 0.125}, tmp_path / 'turned.yaml')
    assert not kept and files == [tmp_path / 'turned.yaml'] == list(tmp_path.iterdir())
    assert numbers(load_scene(files[0])) == numbers(changed(scene, {resolve(scene, key): 0.125}))


def test_command_writes_the_machine_that_it_found(tmp_path, capsys):
    text = done(
        capsys, 'optimise', 'four_bar', '--vary', f'{CRANK}=80mm:120mm', '--vary',
        f'{TRACER}=0:0.2', '--minimise', 'straightness(coupler_point)', '--subject-to',
        'min(transmission_angle) >= 30deg', '--drive', 'crank_joint=0:360deg:13', '--starts', '1',
        '--workers', '1', '--output', tmp_path / 'out')
    results = [json.loads(line) for line in (
        tmp_path / 'out' / 'results.jsonl').read_text().splitlines()]
    aim, = results[1][1]['aims']
    scene = load_scene(tmp_path / 'out' / 'optimised.yaml')
    value = Expression('straightness(coupler_point)', scene, TURN).value(
        Quantities(scene, driven(13, 1.0)))
    assert float(value.value) == pytest.approx(aim, rel=1e-9)
    assert f'{aim:.6g}' in text and (tmp_path / 'out' / 'paths.png').stat().st_size > 1000
    assert '# Places to look at' in (tmp_path / 'out' / 'optimised_mechanism.yaml').read_text()


@pytest.mark.parametrize('options, message', [
    (('--minimise', 'max(force.pin)'), '--minimise'),
    (('--minimise', '1', '--minimise', '1', '--minimise', '1'), '--minimise'),
    (('--minimise', 'distance(coupler_point, missing.csv)'), 'missing.csv'),
    (('--minimise', 'max(force.cut_1)', '--resume'), '--resume'),
    (('--minimise', 'max(force.cut_1)', '--subject-to', 'no'), '--subject-to')])
def test_command_refuses_what_makes_no_sense(capsys, options, message):
    assert message in refused(
        capsys, 'optimise', 'four_bar', '--vary', f'{CRANK}=0.08:0.12', *options)


def test_command_fails_where_no_machine_is_found(capsys):
    code, text, errors = call(
        capsys, 'optimise', 'four_bar', '--vary', f'{CRANK}=0.21:0.3', '--minimise',
        'max(coupler_point.x)', '--drive', 'crank_joint=0:360deg:9', '--starts', '1',
        '--workers', '1')
    assert code == 1 and 'no machine' in errors
    assert '300 more could not be assembled' in text
