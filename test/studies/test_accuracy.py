# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The work-precision study: its reference, its rows, its advice, its command."""

import csv
from dataclasses import replace
import math

from closedloop_dynamics import Initial, load_scene, Method, Simulation, SimulationError
from closedloop_dynamics.cli import main
from closedloop_dynamics.kinematics.motions import moving
from closedloop_dynamics.scene.integrators import INTEGRATORS, STABILISATIONS
from closedloop_dynamics.studies import accuracy, reference
from closedloop_dynamics.studies.accuracy import (
    default_lines, Line, Row, Setting, settings, Study, study_accuracy)
from closedloop_dynamics.studies.accuracy_report import table, title, work_precision
from closedloop_dynamics.studies.advice import for_budget, for_target, yaml_lines
from closedloop_dynamics.studies.reference import Difference, difference, record
from families import ladder
import numpy as np
import pytest
import yaml

from ..formats import machines
from ..reference import peaucellier

LINES = [Line('rk4'), Line('dop853'), Line('rk4', stabilisation='none')]


@pytest.fixture(scope='module')
def study():
    """Return a quick study of the four-bar under a torque."""
    return study_accuracy(load_scene('four_bar'), {'crank_joint': 2.0}, 0.2, True, LINES)


def test_default_method_is_varied_by_its_accuracy():
    scene = load_scene('four_bar')
    methods = [setting.method(scene, 0.01) for setting in settings(Line('auto'), 0.01)]
    assert [method.accuracy for method in methods] == pytest.approx(
        [10.0 ** -k for k in range(2, 14)])


def test_every_method_is_tried_by_default():
    lines = default_lines()
    assert {line.integrator for line in lines} == set(INTEGRATORS)
    assert {line.stabilisation for line in lines} == set(STABILISATIONS)
    assert len(set(lines)) == len(lines)


def test_step_sizes_meet_the_outputs():
    for setting in settings(Line('rk4'), 0.01):
        assert setting.value * setting.steps == pytest.approx(0.01 * setting.stride, rel=1e-12)
        assert setting.steps == 1 or setting.stride == 1
    assert [s.value for s in settings(Line('dop853'), 0.01)] == pytest.approx(
        [10.0 ** -k for k in range(2, 14)])


def test_two_methods_prove_the_reference(study):
    own = study.reference.error
    assert 0.0 < own.position < 1e-10 and own.velocity < 1e-9 and own.force < 1e-7
    assert 'proved by dopri5' in study.reference.description


def test_the_reference_knows_its_error_through_a_singular_position():
    outputs, interval = 15, 0.002
    found = reference.compute_reference(peaucellier.scene(), None, interval, outputs)
    exact = peaucellier.crank_angles(interval * np.arange(1, outputs + 1))
    error = np.abs(found.trajectory.position[:, 0] - exact).max()
    # Interpolation between four places of the branch was off by 1.4e-9 rad, which two integrators
    # shared. The closed form itself is known to 5e-12.
    assert error < 1e-11
    assert error < 3.0 * found.error.position + 5e-12


def test_the_larger_difference_of_two_proofs_is_reported(monkeypatch):
    places = []

    def spoiled(simulation, *arguments):
        motion = record(simulation, *arguments)
        places.append(float(simulation.data.system.settings.aside))
        # The third motion is that of independent coordinates.
        return replace(motion, position=motion.position + 1e-7 * (len(places) == 3))

    monkeypatch.setattr(reference, 'record', spoiled)
    found = reference.compute_reference(load_scene('four_bar'), None, 0.01, 3)
    assert found.error.position == pytest.approx(1e-7, rel=1e-3)
    assert 'proved by dopri5' in found.description
    assert 'and independent coordinates' in found.description
    # Both look at other places beside a singular configuration than the reference.
    assert places[0] not in places[1:3]


def test_reference_moves_as_the_simulation_does(study):
    simulation = Simulation.from_scene('four_bar', step_size=1e-4)
    simulation.step({'crank_joint': 2.0}, 0.2)
    last = study.reference.trajectory.position[-1]
    np.testing.assert_allclose(last, simulation.position, rtol=0, atol=1e-9)


def test_without_a_second_method_there_is_no_reference(monkeypatch):
    monkeypatch.setattr(reference, 'CANDIDATES', (('dop853', 1e-13),))
    with pytest.raises(SimulationError, match='nothing to measure errors against'):
        reference.compute_reference(load_scene('four_bar'), None, 0.01, 3)


def imported(folder):
    """Return the scene of a robot description whose loop is closed far from where it is drawn."""
    path = folder / 'four_bar.urdf'
    path.write_text(machines.four_bar())
    return load_scene(str(path))


CLASSES = {
    'spatial, with orientations': (lambda _: load_scene('stewart_platform'), 0.1, 1e-10),
    'closure equations that repeat others': (lambda _: load_scene('bennett'), 0.1, 1e-10),
    'impact and friction': (lambda _: load_scene('carpet_scraper_on_carpet'), 0.1, 1e-10),
    'prescribed motion': (lambda _: moving(
        load_scene('carpet_scraper'), {'theta_1': '4.7124*t'}), 0.1, 1e-10),
    'imported': (imported, 0.1, 1e-10),
    'eighty joints': (lambda _: large(40), 0.02, 1e-9)}


def large(loops):
    """Return the scene of a ladder of four-bars."""
    mechanism, position = ladder(loops)
    rest = load_scene('four_bar')
    return replace(rest, mechanism=mechanism, initial=Initial(
        position, (0.0,) * len(position), ('pivot_0',)))


@pytest.mark.parametrize('name', CLASSES)
def test_every_class_of_scene_has_a_proved_reference_and_rows(name, tmp_path):
    build, duration, error = CLASSES[name]
    lines = [Line('dop853'), Line('rodas4')]
    if name == 'prescribed motion':
        lines.append(Line('rk4', 'independent'))
    study = study_accuracy(build(tmp_path), None, duration, True, lines)
    assert study.reference.error.position < error
    made = [row for row in study.lines()[lines[0]] if not row.failure]
    assert made and made[-1].position_error < 1e-8
    assert all(row.failure or row.cost > 0.0 for row in study.rows)
    if name == 'prescribed motion':
        refused, = study.lines()[lines[-1]]
        assert 'independent knows none' in refused.failure
        assert refused.failure.split('. ')[0] in table(study)


def test_errors_of_orientations_are_angles():
    coordinates = load_scene('stewart_platform').mechanism.coordinates
    start = coordinates.start()
    turn = np.zeros(coordinates.nv)
    rate = coordinates.balls[0, 1]
    turn[rate:rate + 3] = 0.3, -0.4, 1.2
    moved = coordinates.moved(start, turn)
    nothing = np.zeros((2, 0))
    one, other = (reference.Trajectory(
        np.array(rows), nothing, nothing, 0.0, 0.0) for rows in ((start, start), (start, moved)))
    np.testing.assert_allclose(
        reference.differences(one, other, coordinates)[:, 0], (0.0, 1.3), atol=1e-15)
    # A quaternion and its negative are one orientation.
    first = coordinates.balls[0, 0]
    other.position[1, first:first + 4] *= -1.0
    np.testing.assert_allclose(difference(one, other, coordinates).position, 1.3, atol=1e-15)


def test_the_comparison_ends_where_differences_have_grown():
    found = reference.compute_reference(load_scene('three_rrr'), None, 0.2, 50)
    known = len(found.trajectory)
    assert 10 < known < 50 and found.error.position <= 1e-6
    assert found.growth > 1e5
    assert f'ends at t = {0.2 * known:.4g} s of 10 s' in found.description
    # Nothing to grow: joints whose motion is prescribed.
    still = reference.compute_reference(
        moving(load_scene('carpet_scraper'), {'theta_1': '4.7124*t'}), None, 0.01, 3)
    assert math.isnan(still.growth)


def test_the_comparison_ends_where_no_two_methods_go_on(monkeypatch):
    def stopped(simulation, tau, steps, outputs, patience):
        return record(simulation, tau, steps, min(outputs, 7 if steps == 1 else 9), patience)

    monkeypatch.setattr(reference, 'record', stopped)
    found = reference.compute_reference(load_scene('four_bar'), None, 0.01, 20)
    assert len(found.trajectory) == 7
    assert 'no two methods go further' in found.description


def test_nothing_moves_and_every_method_is_exact(tmp_path):
    study = study_accuracy(load_scene('three_rrr_horizontal'), None, 0.1, True, [Line('dop853')])
    assert 'Nothing moves' in study.reference.description
    work_precision(study, title(study)).savefig(tmp_path / 'picture.png')
    assert for_target(study, 1e-6).row is not None


def test_finer_settings_are_more_accurate_and_cost_more(study):
    for line, rows in study.lines().items():
        assert not any(row.failure for row in rows)
        assert rows[-1].position_error < 1e-3 * rows[0].position_error, line
        assert rows[-1].evaluations > rows[0].evaluations
        assert all(row.cost > 0.0 for row in rows)
        assert all(row.energy_error < 0.1 for row in rows)


def test_rows_know_their_errors_and_evaluations(study):
    row = next(row for row in study.lines()[Line('rk4')] if row.setting.value == 2e-3)
    # Some more, as the energy is looked at.
    assert row.evaluations == pytest.approx(4 / 2e-3, rel=0.02)
    simulation = Simulation(replace(study.scene, method=row.method))
    motion = record(simulation, simulation.joint_torques(study.torque), 1, 100)
    wrong = difference(motion, study.reference.trajectory, simulation.coordinates)
    assert (row.position_error, row.force_error) == (wrong.position, wrong.force)
    assert row.closure < 1e-11


def test_loops_open_without_stabilisation(study):
    kept, left = (study.lines()[line][0] for line in (LINES[0], LINES[2]))
    assert left.closure > 1e4 * kept.closure


def test_failures_are_rows_with_a_reason():
    study = study_accuracy(load_scene('four_bar'), {'crank_joint': 100.0}, 0.2, True,
                           [Line('semi_implicit_euler')])
    failures = [row for row in study.rows if row.failure]
    assert failures and all(math.isnan(row.position_error) for row in failures)
    assert failures[0].failure.split('. ')[0].split('; ')[0] in table(study)


def test_a_scene_may_leave_its_method_open():
    scene = load_scene('four_bar')
    scene = replace(scene, method=Method(integrator='auto', accuracy=1e-4))
    study = study_accuracy(scene, None, 0.1, True, [Line('dop853')])
    assert not any(row.failure for row in study.rows)


def test_runs_that_take_too_long_are_given_up(monkeypatch):
    monkeypatch.setattr(accuracy, 'PATIENCE', 0.0)
    study = study_accuracy(load_scene('four_bar'), None, 0.1, True, [Line('heun')])
    assert all('given up' in row.failure for row in study.rows)


def made_up(points, floor=1e-12):
    """Return a study of two lines with given (error, cost) from coarse to fine."""
    rows = [Row(Setting(line, 0.01, 1, 1), Method(integrator=line.integrator), '', error, error,
                error, 0.0, 0.0, 1.0, cost)
            for line, values in points.items() for error, cost in values]
    own = reference.Reference(None, Difference(floor, floor, floor), 'made up')
    return Study(load_scene('four_bar'), 1.0, {}, own, rows)


def test_advice_takes_the_cheapest_that_holds_the_target_for_good():
    lucky = [(1e-2, 0.001), (1e-7, 0.002), (1e-5, 0.004), (1e-8, 0.02)]
    steady = [(1e-3, 0.005), (5e-7, 0.01), (1e-9, 0.03)]
    study = made_up({Line('rk4'): lucky, Line('heun'): steady})
    advice = for_target(study, 1e-6)
    assert advice.row.cost == 0.01 and 'integrator: heun' in advice.text
    assert '1 % of real time' in advice.text
    assert for_budget(study, 0.02).row.position_error == 1e-8


def test_advice_says_why_nothing_will_do():
    study = made_up({Line('rk4'): [(1e-2, 0.001), (1e-7, 0.002)]})
    assert for_target(study, 1e-9).row is None
    assert '1.0e-07, by rk4' in for_target(study, 1e-9).text
    assert 'cannot be decided' in for_target(study, 1e-13).text
    assert for_budget(study, 1e-4).row is None
    assert '0.1 % of real time' in for_budget(study, 1e-4).text


def test_advice_can_be_pasted_into_a_scene(study, tmp_path):
    advice = for_target(study, 1e-6)
    pasted = yaml.safe_load(advice.text[advice.text.index('method:'):])['method']
    assert Method(**pasted).integrator == advice.row.method.integrator
    simulation = Simulation.from_scene('four_bar', **pasted)
    simulation.step(study.torque, 0.2)
    wrong = simulation.position - study.reference.trajectory.position[-1]
    assert np.abs(wrong).max() <= 1e-6
    assert 'tolerance: 1.0e-07' in yaml_lines(Method(integrator='dop853', tolerance=1e-7))
    assert 'accuracy: 1.0e-05' in yaml_lines(Method(integrator='auto', accuracy=1e-5))


def test_picture_and_title(study, tmp_path):
    assert title(study) == 'four_bar, 0.2 s, driven by crank_joint = 2 N m or N'
    figure = work_precision(study, title(study))
    assert len(figure.axes) == 2
    figure.savefig(tmp_path / 'picture.png')


def test_command_writes_table_picture_and_advice(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(accuracy, 'default_lines', lambda: LINES[:2])
    arguments = ['accuracy', 'four_bar', '--quick', '--duration', '0.2', '--target', '1e-4',
                 '--output', str(tmp_path / 'out')]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert 'proved by' in text and text.count('method:') == 1
    with open(tmp_path / 'out' / 'four_bar_accuracy.csv') as file:
        rows = list(csv.DictReader(file))
    assert {row['integrator'] for row in rows} == {'rk4', 'dop853'}
    assert all(float(row['position_error']) > 0.0 for row in rows)
    assert (tmp_path / 'out' / 'four_bar_accuracy.png').stat().st_size > 10000
    assert main(arguments) == 2
    assert '--overwrite' in capsys.readouterr().err


@pytest.mark.parametrize('option, word', [
    (('--torque', 'coupler_joint=1'), 'coupler_joint'), (('--duration', '0'), '--duration'),
    (('--target', '-1'), '--target')])
def test_command_refuses_at_once(capsys, option, word):
    try:
        code = main(['accuracy', 'four_bar', *option])
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert word in capsys.readouterr().err
