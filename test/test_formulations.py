# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Families of mechanisms, the package's formulation beside dense ones, SciPy's solvers."""

from pathlib import Path
import sys

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.simulation.system import build_system
from closedloop_dynamics.studies.accuracy import Line, study_accuracy
from closedloop_dynamics.studies.accuracy_report import title, work_precision
from families import chain, ladder
import numpy as np
import pytest

from .reference import maximal
from .reference.compare import assert_agree
from .reference.dense import closure
from .reference.formulations import dense_dynamics, FORMULATIONS

BENCHMARKS = Path(__file__).resolve().parents[1] / 'benchmark'
if not BENCHMARKS.is_dir():
    pytest.skip('not in a source checkout', allow_module_level=True)
sys.path.insert(0, str(BENCHMARKS))

from yardsticks import SciPyLine  # noqa: E402,I100


@pytest.mark.parametrize('build, sizes', [(ladder, (1, 2, 7)), (chain, (3, 10, 31))])
def test_families_are_valid_and_closed_as_built(build, sizes):
    for size in sizes:
        mechanism, position = build(size)
        validate_mechanism(mechanism)
        assert len(position) == len(mechanism.joints)
        assert np.abs(closure(mechanism, np.array(position))).max() < 1e-14


def test_ladder_has_one_degree_of_freedom_and_a_chain_as_many_as_links_less_two():
    assert [len(m.joints) - m.number_of_equations for m in (ladder(5)[0], chain(9)[0])] == [1, 7]


@pytest.mark.parametrize('build, size', [(ladder, 1), (ladder, 4), (chain, 6), (chain, 40)])
def test_families_accelerate_as_their_twins_in_extended_precision(build, size):
    mechanism, position = build(size)
    rng, count = np.random.default_rng(1), len(position)
    # All cranks turn alike: the rates close the loops, too.
    rates = np.tile([1.0, -1.0], size + 1)[:count] if build is ladder else (
        rng.uniform(-1.0, 1.0, count) / count)
    system = build_system(build_model(mechanism))
    system.tau[:] = rng.uniform(-1.0, 1.0, count)
    system.native.evaluate(np.array(position), rates)
    twin = maximal.forward_dynamics(
        mechanism, np.array(position), rates, system.tau, (0.0, 0.0), maximal.extended)
    assert_agree(system.qdd, twin.qdd, 1e-13)
    assert_agree(system.lam, twin.lam, 1e-12)


@pytest.mark.parametrize('name', ['stewart_platform', 'bennett', 'planetary_gear'])
def test_formulations_agree_on_every_class_of_scene(name):
    one = Simulation.from_scene(name)
    one.step(duration=0.3)
    one.data.system.native.evaluate_state(one.data.integrated)
    for formulation in FORMULATIONS:
        acceleration, forces = dense_dynamics(one, formulation)
        assert_agree(acceleration, one.acceleration, 1e-11, smallest=1.0)
        assert_agree(forces, one.data.system.lam, 1e-10, smallest=1.0)


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
