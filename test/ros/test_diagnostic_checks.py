# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of the levels that diagnostics give to numbers."""

from dataclasses import replace
import math
from pathlib import Path

from closedloop_dynamics.effects.energy_balance import Energies
from closedloop_dynamics.ros import diagnostics as checks
from closedloop_dynamics.ros.diagnostics import ERROR, OK, WARN
from closedloop_dynamics.simulation.health import Health
from closedloop_dynamics.simulation.monitor import RunReport
import pytest

DOCUMENT = Path(__file__).resolve().parents[2] / 'doc' / 'interface.md'
REPORT = RunReport('rk4, projection', 10.0, 10000, 0.1, 1e-10, 1e-13, 1e-9, 40000)
HEALTH = Health(
    smallest_pivot=0.5, smallest_pivot_ever=0.4, condition=3.0, rank=4, equations=4,
    rank_revealing_count=0, singular_count=0, evaluations=40000, projection_iterations=1,
    closure=1e-13)
BOOK = {'accepted': 5, 'rejected': 0, 'timed out': 0, 'states set': 0, 'states refused': 0,
        'lost': 0}


@pytest.mark.parametrize('factor, missed, level', [
    (1.0, 0, OK), (0.96, 0, OK), (0.94, 0, WARN), (0.49, 0, ERROR), (1.0, 4, OK), (1.0, 6, WARN)])
def test_simulated_time_that_lags_behind_is_reported(factor, missed, level):
    now = {'factor': 2.0 * factor, 'dropped': 0.0, 'missed': missed, 'left out': 0,
           'ticks': 100}
    assert checks.time_finding(now, '', 2.0).level == level
    # Nothing is wrong with a pause, or where no factor was asked for.
    assert checks.time_finding(now, 'paused', 2.0).level == OK
    assert checks.time_finding(now, '', None).level == OK


def test_states_left_out_are_reported():
    now = {'factor': 1.0, 'dropped': 0.0, 'missed': 3, 'left out': 1, 'ticks': 1000}
    finding = checks.time_finding(now, '', 1.0)
    assert finding.level == WARN
    assert finding.message.startswith('1 states left out')


@pytest.mark.parametrize('error, load, level', [
    (1e-10, 0.1, OK), (math.nan, math.nan, OK), (2e-4, 0.1, WARN), (0.1, 0.1, ERROR),
    (1e-10, 0.9, WARN)])
def test_large_errors_and_costs_of_steps_are_reported(error, load, level):
    finding = checks.method_finding(replace(REPORT, local_error=error), load)
    assert finding.level == level
    assert finding.values['compute time per step [us]'] == pytest.approx(10.0)


@pytest.mark.parametrize('closure, level', [(1e-13, OK), (1e-5, WARN), (0.01, ERROR)])
def test_open_loops_are_reported(closure, level):
    assert checks.closure_finding(closure).level == level


@pytest.mark.parametrize('residual, level', [
    (0.0, OK), (1e-3, OK), (-0.01, WARN), (5.0, ERROR), (-5.0, ERROR)])
def test_energy_from_nowhere_is_reported(residual, level):
    balance = Energies(1.0, 2.0, 3.0, 4.0, residual)
    assert checks.energy_finding(balance, 8.0).level == level


def test_singular_configurations_are_reported_though_they_are_over():
    assert checks.elimination_finding(HEALTH, 0.5).level == OK
    finding = checks.elimination_finding(HEALTH, 1e-5)
    assert finding.level == WARN
    assert 'near a singular configuration' in finding.message
    dependent = checks.elimination_finding(replace(HEALTH, rank=3), 0.5)
    assert dependent.level == WARN
    assert '1 of 4 closure equations' in dependent.message


@pytest.mark.parametrize('found, level, word', [
    ((1, 0, False), OK, 'alone'), ((1, 1, True), OK, 'alone'), ((2, 1, True), WARN, '2 nodes'),
    ((1, 2, False), WARN, 'time will jump'), ((1, 0, True), WARN, 'nobody publishes /clock')])
def test_names_that_are_shared_and_clocks_that_are_not_there_are_reported(found, level, word):
    finding = checks.graph_finding('/left/simulator', *found)
    assert finding.level == level and word in finding.message


@pytest.mark.parametrize('change, sources, expired, level, word', [
    ({}, ['/a'], False, OK, 'from /a'), ({}, [], False, OK, 'nobody'),
    ({'rejected': 3}, ['/a'], False, WARN, '3 refused'),
    ({'states refused': 1}, ['/a'], False, WARN, '1 refused'),
    ({}, ['/a', '/b'], False, WARN, '2 sources of commands (/a, /b): the last command counts'),
    ({}, ['/a', '/a'], False, WARN, '2 publishers of commands in /a, one node'),
    ({}, ['/a', '/b', '/a'], False, WARN, '2 sources of commands (/a with 2 publishers, /b)'),
    ({'lost': 2}, ['/a'], False, WARN, '2 commands lost'),
    ({}, ['/a'], True, WARN, 'torques are zero')])
def test_commands_that_do_not_arrive_as_they_should_are_reported(
        change, sources, expired, level, word):
    finding = checks.commands_finding({**BOOK, **change}, BOOK, sources, expired)
    assert finding.level == level
    assert word in finding.message


def test_thresholds_are_those_of_the_document():
    text = DOCUMENT.read_text()
    for name in ('FACTOR_WARN', 'FACTOR_ERROR', 'MISSED_WARN', 'LOAD_WARN', 'ERROR_WARN',
                 'ERROR_ERROR', 'CLOSURE_WARN', 'CLOSURE_ERROR', 'ENERGY_WARN', 'ENERGY_ERROR'):
        value = getattr(checks, name)
        shown = f'{100 * value:g} %' if not name.startswith(('ERROR', 'CLOSURE')) else f'{value:g}'
        assert shown in text, (name, shown)


def test_what_a_run_found_is_a_warning():
    found = replace(REPORT, findings=('the energy balance misses 2 J',))
    finding = checks.method_finding(found, 0.1)
    assert finding.level == WARN and 'misses 2 J' in finding.message
