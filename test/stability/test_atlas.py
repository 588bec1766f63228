# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The suite of hard cases: the default method passes, or refuses where that is the answer."""

import math

from hard_cases import ACCURATE, Case, DEGRADED, judge, Outcome, REFUSED, UNSTABLE
import hard_machines as machines
import pytest
import stability

# Some compile for minutes on a busy machine.
pytestmark = pytest.mark.timeout(1200)
# What nobody can assemble.
TO_REFUSE = {'cannot be assembled'}
STIFF = ('spring 1e9 N m/rad', 'damper 1e6 N m s/rad', 'contact 1e9 N/m')
# Too many links to unroll: the default method is compiled again for the kernels' loops, of which
# test_codegen compares evaluations and projections with those that are unrolled.
BY_LOOPS = ('flat, 40 loops', '1000 loops')
BY_NAME = {case.name: case for case in stability.CASES}
DEFAULT = stability.METHODS[stability.DEFAULT]


def check(name, outcome):
    """Assert that the default method does what it should."""
    assert outcome.status == (REFUSED if name in TO_REFUSE else ACCURATE), outcome


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=pytest.mark.slow) if name in BY_LOOPS else name for name in BY_NAME])
def test_default_method_is_accurate_or_refuses(name):
    check(name, judge(BY_NAME[name], DEFAULT, True))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize('name', BY_NAME)
def test_default_method_is_accurate_or_refuses_at_full_length(name):
    check(name, judge(BY_NAME[name], DEFAULT, False))


@pytest.mark.slow
@pytest.mark.parametrize('name', STIFF)
def test_stiff_method_follows_the_slow_motion(name):
    outcome = judge(BY_NAME[name], stability.METHODS['rodas4'], True)
    assert outcome.status == ACCURATE, outcome


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize('method', ['dopri5', 'dop853', 'rodas4'])
@pytest.mark.parametrize('name', ['flat, 1 loop', 'flat, 2 loops', 'start flat',
                                  'start near flat', 'change point', 'folded pantograph',
                                  'type-2 pose', 'massless links', '3-RRR, loops twice',
                                  'cart of 1 mg', '1000 rad/s for 1 s', 'step of 0.1 to 100 rad',
                                  'pendulum, 2000 s', 'A02 to its end', 'slider-crank',
                                  '1 N m s in 0.1 ms', 'stick and slip'])
def test_error_control_with_projection_is_accurate_too(name, method):
    outcome = judge(BY_NAME[name], stability.METHODS[method], True)
    # In 6,000 oscillations at this tolerance dopri5 loses a fifth of the energy.
    damped = (name, method) == ('step of 0.1 to 100 rad', 'dopri5')
    assert outcome.status == (REFUSED if damped else ACCURATE), outcome


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize('method', [name for name in stability.METHODS if name != 'rodas4'])
@pytest.mark.parametrize('name', ['flat, 1 loop', 'start flat', 'start near flat',
                                  'change point', 'folded pantograph', '1e6 N m in a step'])
def test_no_method_is_silently_wrong_at_singular_configurations(name, method):
    outcome = judge(BY_NAME[name], stability.METHODS[method], True)
    assert outcome.status != UNSTABLE, outcome


def case(figure, accurate=1.0, stable=2.0):
    """Return a case that ends with a figure."""
    return Case('case', 'group', 'text', 'figure', accurate, stable, lambda method, quick: figure)


@pytest.mark.parametrize(('figure', 'status'), [
    (0.5, ACCURATE), (1.5, DEGRADED), (3.0, UNSTABLE), (math.nan, UNSTABLE), (math.inf, UNSTABLE)])
def test_figure_is_judged_by_its_bounds(figure, status):
    assert judge(case(figure), DEFAULT, True).status == status


def test_worst_figure_of_a_motion_is_infinite_where_one_is_none():
    simulation = machines.started('four_bar', DEFAULT)
    assert machines.worst_of(simulation, 3, 0.01, lambda one: one.time) == pytest.approx(0.03)
    for figure in (math.nan, 2.0):
        assert machines.worst_of(
            simulation, 1, 5, lambda one: 0.5, lambda one, figure=figure: figure,
            bound=2.0) == math.inf


def test_names_of_cases_are_unique_and_texts_short():
    assert len(BY_NAME) == len(stability.CASES)
    assert all(len(one.text) <= 200 for one in stability.CASES)


def test_picture_has_a_cell_for_each_case_and_method():
    outcomes = [Outcome(ACCURATE, 1e-9), Outcome(DEGRADED, 1e-3), Outcome(REFUSED, math.nan, 'no'),
                Outcome(UNSTABLE, math.inf)]
    atlas = {(one.name, name): outcomes[(row + column) % 4]
             for row, one in enumerate(stability.CASES)
             for column, name in enumerate(stability.METHODS)}
    axes = stability.stability_atlas(atlas).axes[0]
    assert len(axes.patches) == len(atlas)
    assert {text.get_text() for text in axes.texts} >= {'refused', '1.0e-09', 'inf'}
    assert stability.unstable(atlas) == [
        name for (name, method), outcome in atlas.items()
        if method == stability.DEFAULT and outcome.status == UNSTABLE]


def test_command_writes_table_and_picture(tmp_path, capsys):
    arguments = ['--quick', '--case', 'three rockers', '--case', 'welded',
                 '--default-only', '--output', str(tmp_path)]
    assert stability.main(arguments) == 0
    assert 'three rockers' in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        'stability.csv', 'stability_table.md', 'stability_atlas.png'}


def test_command_names_the_cases_where_none_is_meant(capsys):
    with pytest.raises(SystemExit, match='2'):
        stability.main(['--case', 'no such case'])
    assert 'three rockers' in capsys.readouterr().err
