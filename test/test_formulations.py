# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The study of the formulations: its mechanisms, its exact reference, its numbers."""

import csv
import math
from pathlib import Path
import sys

from closedloop_dynamics.engine import native
from closedloop_dynamics.integration.system import build_system
from closedloop_dynamics.mechanism.mechanism import PRISMATIC
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.simulation.modeling import build_model
from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.studies.accuracy import Line, study_accuracy
from closedloop_dynamics.studies.accuracy_report import title, work_precision
from families import chain, ladder
import numpy as np
import pytest

from .reference.dense import closure, forward_dynamics

BENCHMARKS = Path(__file__).resolve().parents[1] / 'benchmark'
if not BENCHMARKS.is_dir():
    pytest.skip('not in a source checkout', allow_module_level=True)
sys.path.insert(0, str(BENCHMARKS))

from formulation_errors import exact_dynamics  # noqa: E402,I100
import formulations  # noqa: E402
from formulations import (  # noqa: E402
    exponent, growing_case, main, Row, scene_case, study_formulations, study_scenes, VARIANTS)
from formulations_report import growth, growth_text, table  # noqa: E402
from yardsticks import SciPyLine  # noqa: E402


@pytest.mark.parametrize('build, sizes', [(ladder, (1, 2, 7)), (chain, (3, 10, 31))])
def test_families_are_valid_and_closed_as_built(build, sizes):
    for size in sizes:
        mechanism, position = build(size)
        validate_mechanism(mechanism)
        assert len(position) == len(mechanism.joints)
        assert np.abs(closure(mechanism, np.array(position))).max() < 1e-14


def test_ladder_has_one_degree_of_freedom_and_a_chain_as_many_as_links_less_two():
    assert [len(m.joints) - m.number_of_equations for m in (ladder(5)[0], chain(9)[0])] == [1, 7]


def cases():
    """Return small members of all families and both mechanisms."""
    return [growing_case('ladder', 1), growing_case('ladder', 4), growing_case('chain', 6),
            scene_case('three_rrr'), scene_case('carpet_scraper')]


def test_exact_dynamics_agree_with_the_dense_twin():
    for case in cases():
        acceleration, multipliers = exact_dynamics(case.mechanism, case.q, case.qd, case.tau)
        expected, forces = forward_dynamics(case.mechanism, case.q, case.qd, case.tau, (0.0, 0.0))
        np.testing.assert_allclose(acceleration.astype(float), expected, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(multipliers.astype(float), forces, rtol=1e-10, atol=1e-10)


def test_exact_dynamics_have_more_digits_than_a_double():
    case = growing_case('chain', 40)
    acceleration, _ = exact_dynamics(case.mechanism, case.q, case.qd, case.tau)
    system = build_system(build_model(case.mechanism))
    system.tau[:] = case.tau
    native.evaluate(system.native, case.q, case.qd)
    error = np.abs(system.qdd - acceleration).max() / np.abs(acceleration).max()
    assert 0.0 < error < 1e-13


def test_exact_dynamics_refuse_other_joints():
    mechanism = load_scene('slider_crank').mechanism
    assert PRISMATIC in {joint.type for joint in mechanism.joints}
    with pytest.raises(ValueError, match='revolute'):
        exact_dynamics(mechanism, np.zeros(3), np.zeros(3), np.zeros(3))


def test_study_measures_every_formulation_of_every_size(tmp_path):
    calls = []
    rows = study_formulations(3, quick=True, progress=lambda *parts: calls.append(parts))
    assert {(row.family, row.size) for row in rows} == {
        ('three_rrr', 7), ('carpet_scraper', 7), ('ladder', 1), ('ladder', 3), ('chain', 3)}
    assert len(rows) == 5 * len(VARIANTS)
    assert calls[0] == (0, 5) and calls[-1] == (5, 5)
    for row in rows:
        assert 0.0 < row.time < 0.1
        assert row.acceleration_error < 1e-12 and row.force_error < 1e-12
    assert 'three_rrr' in table(rows) and table(rows, markdown=True).startswith('| mechanism |')
    growth(rows).savefig(tmp_path / 'growth.png')


def test_formulations_agree_on_every_class_of_scene(capsys, tmp_path):
    scenes = ['stewart_platform', 'bennett', 'carpet_scraper_on_carpet', 'planetary_gear']
    arguments = [*scenes, '--output', str(tmp_path)]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert all(out.count(name + ' ') == 3 for name in scenes)
    with open(tmp_path / 'formulations.csv') as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * len(scenes)
    for row in rows:
        assert float(row['time']) > 0.0 and float(row['acceleration_error']) < 1e-11
        assert float(row['force_error'] or 0.0) < 1e-10
    assert (tmp_path / 'formulations.png').stat().st_size > 10000


def test_a_formulation_that_fails_is_a_row(monkeypatch):
    built = formulations.Dense

    def refusing(system, name):
        if name == 'system':
            raise np.linalg.LinAlgError('Too dense. Take another.')
        return built(system, name)

    monkeypatch.setattr(formulations, 'Dense', refusing)
    rows = study_scenes([load_scene('four_bar')])
    assert [bool(row.failure) for row in rows] == [False, True, False]
    assert 'Too dense' in table(rows)


def test_exponent_is_fitted_over_the_largest_tenfold():
    rows = [Row('ladder', size, 0, 0, 'system', 1e-9 * size ** 3 + 1e-6 * (size < 10))
            for size in (1, 2, 5, 10, 20, 50, 100)]
    assert exponent(rows) == pytest.approx(3.0)
    assert math.isnan(exponent(rows[:1]))
    assert 'ladder, system: time ~ N^3.00' in growth_text(rows)


@pytest.mark.slow
def test_command_writes_table_and_picture(capsys, tmp_path):
    arguments = ['--quick', '--largest', '1', '--output', str(tmp_path / 'out')]
    assert main(arguments) == 0
    assert 'ladder' in capsys.readouterr().out
    with open(tmp_path / 'out' / 'formulations.csv') as file:
        header, *rows = csv.reader(file)
    assert header[0] == 'mechanism' and len(rows) == 3 * len(VARIANTS)
    assert (tmp_path / 'out' / 'formulations.png').stat().st_size > 10000


def test_solvers_of_others_are_lines_of_a_study(tmp_path):
    lines = [SciPyLine('scipy_dop853'), Line('dop853')]
    study = study_accuracy(load_scene('four_bar'), None, 0.2, True, lines)
    for rows in study.lines().values():
        assert not any(row.failure for row in rows)
        assert min(row.position_error for row in rows) < 1e-8
        assert max(row.closure for row in rows) < 1e-12
    work_precision(study, title(study)).savefig(tmp_path / 'picture.png')
    refused = study_accuracy(load_scene('three_rrr_payload_friction'), None, 0.02, True, lines)
    assert all('choose where its steps end' in row.failure for row in refused.lines()[lines[0]])
