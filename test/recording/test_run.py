# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A run hands over rows at even times, whatever the step size, and keeps its report true."""

import csv

from closedloop_dynamics import load_scene, Simulation, SimulationError
from closedloop_dynamics.cli import main
from closedloop_dynamics.engine.types import EVALUATIONS
from closedloop_dynamics.recording.rows import read_rows
from closedloop_dynamics.recording.run import columns, ErrorEstimate, Report, row, run
import numpy as np
import pytest

SLIDER_IN_A_SLOT = """
name: slot
bodies:
  crank: {mass: 1.0, center_of_mass: [0.05, 0.0], inertia: 0.001}
  rod: {mass: 0.6, center_of_mass: [0.15, 0.0], inertia: 0.0045}
  slider: {mass: 2.0, center_of_mass: [0.0, 0.0], inertia: 0.002}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0.0, 0.0], actuated: true}
  rod_joint: {type: revolute, parent: crank, child: rod, position: [0.1, 0.0]}
  wrist: {type: revolute, parent: rod, child: slider, position: [0.3, 0.0]}
cut_joints:
  slot: {type: prismatic, body_a: slider, point_a: [0.0, 0.0], body_b: ground,
         point_b: [0.0, 0.0]}
"""
SCENE = """
mechanism: mechanism.yaml
initial:
  position: {crank_joint: 1.0, rod_joint: -1.3, wrist: 0.3}
  hold: [crank_joint]
effects:
  gravity: {type: gravity, acceleration: [0.0, -9.81]}
"""


def rows_of(simulation, duration, rate, torque=None, **options):
    """Run and return the rows and the report."""
    rows, report = [], Report()
    run(simulation, duration, rate, torque, report=report, on_row=rows.append, **options)
    return rows, report


@pytest.fixture
def slot(tmp_path):
    """Return a simulation of a slider-crank whose cut joint is the slot."""
    (tmp_path / 'mechanism.yaml').write_text(SLIDER_IN_A_SLOT)
    (tmp_path / 'scene.yaml').write_text(SCENE)
    return Simulation(load_scene(tmp_path / 'scene.yaml'))


def test_a_slot_has_a_torque_column(slot):
    names = columns(slot)
    assert names[-9:] == [
        'force.slot.x', 'force.slot.y', 'force.slot.torque', 'position.slot', 'velocity.slot',
        'acceleration.slot', 'effort.slot', 'closure', 'energy']
    values = dict(zip(names, row(slot, 0.0)))
    moment, force_x, force_y = slot.constraint_forces[0]
    assert values['force.slot.torque'] == moment
    assert (values['force.slot.x'], values['force.slot.y']) == (force_x, force_y)


def test_readings_of_effects_are_columns(tmp_path, slot):
    (tmp_path / 'scene.yaml').write_text(SCENE + """\
  spring: {type: joint_spring, joint: rod_joint, stiffness: 3.0, rest: -1.0}
  grease: {type: joint_damping, joint: wrist, coefficient: 0.2}
  drive: {type: prescribed_motion, joint: crank_joint, shape: constant_speed, speed: 2.0,
          offset: 1.0}
  buffer: {type: end_stop, joint: slot, upper: 1.0, stiffness: 1e4, enabled: false}
""")
    simulation = Simulation(load_scene(tmp_path / 'scene.yaml'))
    rows, _ = rows_of(simulation, 0.2, 50)
    # What is off, and what has columns of its own, is left out.
    names = [name for name in columns(simulation) if name.startswith('effect.')]
    assert names == ['effect.spring.torque', 'effect.grease.torque']
    column = dict(zip(columns(simulation), np.transpose(rows)))
    np.testing.assert_allclose(
        column['effect.spring.torque'], -3.0 * (column['position.rod_joint'] + 1.0), atol=1e-12)
    np.testing.assert_allclose(
        column['effect.grease.torque'], -0.2 * column['velocity.wrist'], atol=1e-12)


@pytest.mark.parametrize('rate, duration, count', [
    (100, 0.1, 11), (30, 0.1, 4), (7, 0.5, 4), (3000, 0.01, 31), (10, 0.25, 3), (0.5, 1.0, 1)])
def test_rows_stand_at_exact_multiples(rate, duration, count):
    simulation = Simulation.from_scene('four_bar')
    rows, report = rows_of(simulation, duration, rate)
    assert [values[0] for values in rows] == [k / rate for k in range(count)]
    assert simulation.time == pytest.approx(duration, abs=1e-12)
    assert report.finished and report.rows == count and report.time == simulation.time


def test_rows_between_steps_belong_to_their_time():
    fine = Simulation.from_scene('four_bar', step_size=1e-4)
    rows, _ = rows_of(Simulation.from_scene('four_bar'), 0.3, 30)
    for values in rows:
        fine.step(duration=values[0] - fine.time)
        # The error of RK4 at 1 ms; a row a step late would be off by some 1e-3.
        np.testing.assert_allclose(values[1:4], fine.position, rtol=0, atol=1e-7)


def test_the_first_row_feels_the_torque():
    simulation = Simulation.from_scene('four_bar')
    rows, _ = rows_of(simulation, 0.01, 100, {'crank_joint': 2.0})
    first = dict(zip(columns(simulation), rows[0]))
    assert first['effort.crank_joint'] == 2.0
    simulation.reset()
    acceleration, _ = simulation.forward_dynamics(
        simulation.position, simulation.velocity, {'crank_joint': 2.0})
    assert first['acceleration.crank_joint'] == acceleration[0]


def test_a_run_ends_early_between_portions():
    simulation = Simulation.from_scene('four_bar')
    asked = []
    rows, report = rows_of(simulation, 100.0, 0.01, keep_going=lambda: len(asked) < 4
                           and not asked.append(None))
    assert not report.finished and len(rows) == 1
    assert report.time == simulation.time == pytest.approx(3.0)


def test_long_runs_count_whole_steps():
    simulation = Simulation.from_scene('four_bar', step_size=0.01)
    rows, _ = rows_of(simulation, 100.0, 10)
    assert len(rows) == 1001 and simulation.time == 10000 * 0.01


def test_the_report_tells_of_a_run_that_fails():
    report = Report()
    with pytest.raises(SimulationError):
        run(Simulation.from_scene('four_bar'), 1.0, 1000, {'crank_joint': 3e6}, report=report,
            on_row=lambda values: None)
    assert not report.finished and 0 < report.rows < 1000
    assert report.time < 1.0


def test_the_report_holds_closure_and_energy():
    rows, report = rows_of(Simulation.from_scene('four_bar'), 0.2, 100)
    assert report.largest_closure == max(values[-2] for values in rows)
    assert (report.first_energy, report.last_energy) == (rows[0][-1], rows[-1][-1])
    assert report.cpu_time > 0.0


def test_costs_are_columns_of_their_own():
    simulation = Simulation.from_scene('stewart_platform')
    estimate, report, rows = ErrorEstimate(simulation), Report(), []
    run(simulation, 0.3, 20.0, report=report, on_row=rows.append, estimate=estimate, costs=True)
    names = columns(simulation, costs=True)
    assert names[:-4] == columns(simulation)
    assert names[-4:] == ['error', 'accuracy', 'evaluation_rate', 'cpu_share']
    error, accuracy, evaluations, share = np.array(rows)[:, -4:].T
    # Global: at every row from the start on, orientations as angles.
    assert error.max() == report.error and error[0] == 0.0
    assert error[-1] == estimate.of(simulation)
    assert set(accuracy) == {1e-6}
    assert np.isnan(evaluations[0]) and (evaluations[1:] > 0.0).all() and (share[1:] > 0.0).all()
    # All evaluations of the steps are in some row, those of reading rows in none.
    alone = Simulation.from_scene('stewart_platform')
    for _ in range(6):
        alone.step(None, 0.05)
    made = alone.data.system.work.health[EVALUATIONS]
    assert evaluations[1:].sum() / 20.0 == pytest.approx(made, rel=0.01)
    assert share[1:].sum() / 20.0 <= report.cpu_time


def test_costs_are_written_on_demand(tmp_path):
    path = tmp_path / 'run.csv'
    assert main(['simulate', 'four_bar', '--duration', '0.1', '--costs', '--output',
                 str(path), '--integrator', 'rk4', '--no-error-estimate']) == 0
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    assert {row['error'] for row in rows} == {row['accuracy'] for row in rows} == {'nan'}
    assert float(rows[1]['evaluation_rate']) >= 4000.0
    motion, _ = read_rows(path)
    assert len(motion.time) == len(rows)
