# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What a run is expected to cost, from a probe, and ``closedloop simulate --dry-run``."""

import math
from test.test_cli import done

from closedloop_dynamics import Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.recording import cost
from closedloop_dynamics.recording.cost import allowance, Cost, in_windows, probe
from closedloop_dynamics.simulation.stepping import Stepping
import pytest


def counted(monkeypatch, rate, limit, finer=1.0):
    """
    Let simulations cost ``rate(t)`` of CPU time per simulated time; probes end at a limit.

    With a finer accuracy than usual they cost ``finer`` times as much.
    """
    def run(simulation, duration, rows, torque, *, report, on_row, keep_going, estimate):
        report.time = report.cpu_time = 0.0
        factor = finer if simulation.scene.method.accuracy < 1e-6 else 1.0
        while report.time < duration - 1e-9 and keep_going():
            report.cpu_time += factor * rate(report.time) / rows
            clock[0] += factor * rate(report.time) / rows
            report.time += 1.0 / rows

    clock = [0.0]
    monkeypatch.setattr(cost, 'run', run)
    monkeypatch.setattr(cost.time, 'process_time', lambda: clock[0])
    monkeypatch.setattr(cost, 'LONGEST', limit)


def test_what_was_not_probed_costs_what_the_later_half_did(monkeypatch):
    counted(monkeypatch, lambda time: 1.0 if time < 1.0 else 0.1, 1.3)
    found, _ = probe(Simulation.from_scene('four_bar'), 100.0, 100.0)
    # The first second is not what the run goes on like.
    assert found.probed == pytest.approx(4.0, abs=0.05)
    assert found.cpu_time == pytest.approx(1.0 + 0.1 * 99.0, rel=0.01)
    assert found.whole == pytest.approx(found.cpu_time, rel=1e-9)


def test_a_machine_that_stands_still_at_times_is_probed_by_the_longer_probe(monkeypatch):
    # It moves in the first third of each second, in which the probe of the finer run ends.
    def rate(time):
        return 0.3 if time % 1.0 < 1.0 / 3.0 else 1e-4

    counted(monkeypatch, rate, 0.25, finer=3.0)
    coarse, fine = probe(Simulation.from_scene('four_bar'), 30.0, 300.0)
    assert fine.probed < 0.3 and coarse.probed > 2.0
    assert coarse.cpu_time == pytest.approx(3.0, rel=0.25)
    assert fine.cpu_time == pytest.approx(3.0 * coarse.cpu_time, rel=0.02)
    assert fine.whole == pytest.approx(fine.cpu_time, rel=0.02)


def test_a_short_run_is_made_to_its_end(monkeypatch):
    counted(monkeypatch, lambda time: 0.01 + 0.01 * (time > 5.0), 1.0)
    found, _ = probe(Simulation.from_scene('four_bar'), 10.0, 100.0)
    assert found.probed == pytest.approx(10.0) and found.cpu_time == pytest.approx(0.15, rel=0.01)


@pytest.mark.parametrize('method, key, values', [
    ({}, 'accuracy', (1e-6, 1e-9)), ({'integrator': 'dopri5'}, 'tolerance', (1e-6, 1e-9)),
    ({'integrator': 'rk4'}, 'step_size', (1e-3, 5e-4))])
def test_a_finer_method_is_reported_beside_the_first(method, key, values):
    simulation = Simulation.from_scene('stewart_platform', **method)
    found = probe(simulation, 0.1, 100.0)
    assert [(one.key, one.value) for one in found] == [
        (key, pytest.approx(value)) for value in values]
    assert all(0.0 < one.cpu_time < one.whole and not one.failure for one in found)
    assert all(one.probed == pytest.approx(0.1) for one in found)
    assert simulation.time == 0.0 and simulation.stepping.at_start


def test_a_run_that_fails_is_no_cost():
    simulation = Simulation.from_scene('four_bar', integrator='rk4', step_size=0.05)
    found, _ = probe(simulation, 2.0, 100.0, {'crank_joint': 100.0})
    assert 'could not be closed' in found.failure and 'the run fails at t =' in str(found)
    assert 'of CPU' not in str(found)


def test_costs_in_words():
    one = Cost('accuracy', 1e-9, 10.0, 0.512, 0.9, 10.0)
    assert str(one) == 'about 0.51 s of CPU for 10 s at accuracy 1e-09'
    assert math.isclose(one.share, 0.0512)


def test_dry_run_tells_and_writes_nothing(capsys, tmp_path):
    output = tmp_path / 'run.csv'
    out = done(
        capsys, 'simulate', 'four_bar', '--duration', '0.2', '--dry-run', '--output', output)
    assert 's of CPU for 0.2 s at accuracy 1e-06' in out and 'at accuracy 1e-09' in out
    assert 'of real time' in out and not list(tmp_path.iterdir())
    assert main(['simulate', 'four_bar', '--integrator', 'rk4', '--step-size', '0.05',
                 '--torque', 'crank_joint=100', '--dry-run']) == 1


def test_the_companion_costs_in_its_windows_alone():
    assert [in_windows(time) for time in (0.5, 1.0, 2.0, 2.5, 5.0, 6.0, 10.0, 10.5)] == [
        0.5, 1.0, 1.0, 1.5, 2.0, 3.0, 3.0, 3.5]
    # As the engine opens them, up to the steps between.
    simulation = Simulation.from_scene('three_rrr_horizontal')
    simulation.step([0.2, -0.1, 0.1], 12.0)
    own, companion = simulation.stepping.monitor.work
    assert companion / own == pytest.approx(in_windows(12.0) / 12.0, rel=0.25)


def test_a_short_probe_knows_that_windows_end(monkeypatch):
    # Cost by evaluations; the probe ends within the first window, where they are twice as many.
    real = cost.time.process_time
    clock = [0.0]

    def counted(self, tau, steps):
        before = sum(self.monitor.work)
        advance(self, tau, steps)
        clock[0] += 1e-6 * (sum(self.monitor.work) - before)

    advance = Stepping.advance
    monkeypatch.setattr(Stepping, 'advance', counted)
    simulation = Simulation.from_scene('three_rrr')
    monkeypatch.setattr(cost.time, 'process_time', lambda: clock[0])
    found, _ = probe(simulation, 5.0, 100.0, [5.0, -3.0, 2.0], longest=1e-3)
    monkeypatch.setattr(cost.time, 'process_time', real)
    assert found.probed < 1.0
    run = Simulation.from_scene('three_rrr')
    # Beyond, the motion is chaotic: what it costs differs by two with the last digit.
    run.step([5.0, -3.0, 2.0], 5.0)
    assert found.cpu_time == pytest.approx(1e-6 * sum(run.stepping.monitor.work), rel=0.5)


def test_what_a_budget_allows_in_words():
    costs = [Cost('accuracy', value, 10.0, share * 10.0, 1.0, 10.0)
             for value, share in ((1e-6, 0.1), (1e-9, 0.2))]
    assert allowance(0.15, costs) == (
        'a budget of 0.15 of real time allows an accuracy of about 1e-07')
    assert 'takes 0.1: they exclude each other' in allowance(0.09, costs)
    assert 'allows no accuracy: 1e-06 takes 0.1' in allowance(0.001, costs)
    failed = Cost('accuracy', 1e-9, 10.0, math.nan, math.nan, 0.1, 'open')
    assert 'is not known: a probe failed' in allowance(0.1, [costs[0], failed])


def test_dry_run_tells_what_a_budget_allows(capsys):
    assert main(['simulate', 'four_bar', '--duration', '0.2', '--dry-run', '--budget', '10']) == 0
    assert 'a budget of 10 of real time allows an accuracy of about 1e-09' in (
        capsys.readouterr().out)


def test_simulate_by_budget_says_which_accuracy_it_was(capsys):
    out = done(capsys, 'simulate', 'four_bar', '--duration', '0.2', '--budget', '10')
    assert 'with budget 10' in out and 'the best that it allows' in out
    assert 'by a second run with accuracy 3.33e-11' in out
    assert main(['simulate', 'four_bar', '--budget', '1', '--integrator', 'rk4']) == 2
