# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Regulators by their settings: how well they keep to poses and paths, and what is refused."""

from importlib.util import find_spec

from closedloop_dynamics import Simulation
from closedloop_dynamics.control.controller import closed_loop
from closedloop_dynamics.control.errors import StartError
from closedloop_dynamics.control.files import Controller, read_controller
from closedloop_dynamics.mechanism.config import shipped_path
import numpy as np
import pytest

NAME = 'three_rrr_regulator'
has_solver = find_spec('piqp') is not None
needs_solver = pytest.mark.skipif(not has_solver, reason='the extra predictive is not installed')


def law_of(name, **changes):
    """Return the law of a shipped controller with other settings, and a simulation."""
    values = {**read_controller(shipped_path('controllers', name)), **changes}
    model, machine = (Simulation.from_scene(values['scene']) for _ in range(2))
    return closed_loop(values, model.actuated_joints, model), machine


@pytest.mark.parametrize('name, largest', [
    (NAME, 4e-5),
    pytest.param('stewart_platform_predictive', 4e-4, marks=[needs_solver, pytest.mark.slow])])
def test_the_point_goes_to_its_places_and_round_again(name, largest):
    law, machine = law_of(name)
    values = read_controller(shipped_path('controllers', name))
    start = machine.point(values['path_point'])
    places = start + np.vstack([
        np.reshape(values['path_places'], (-1, len(start))), np.zeros(len(start))])
    for _ in range(2):
        for place, duration in zip(places, values['path_durations']):
            until = machine.time + duration
            while machine.time < until - 1e-9:
                machine.step(
                    law.torque(machine.time, machine.position, machine.velocity), 0.01)
            np.testing.assert_allclose(
                machine.point(values['path_point']), place, atol=largest)


@pytest.mark.parametrize('mode', [
    'linear_regulator', pytest.param('predictive', marks=needs_solver)])
def test_a_pose_is_reached_within_the_limits(mode):
    target = np.array([1.2, np.nan, 5.9])
    law, machine = law_of(NAME, mode=mode, path_point='', target_position=list(target),
                          torque_limit=[150.0])
    driven, asked = machine.data.actuated, []
    target[1] = machine.position[driven[1]]
    for _ in range(200):
        asked.append(law.torque(machine.time, machine.position, machine.velocity))
        machine.step(asked[-1], 0.01)
    np.testing.assert_allclose(machine.position[driven], target, atol=1e-6)
    assert np.abs(asked).max() == pytest.approx(150.0)
    law.tune(np.zeros(3), np.full(3, 20.0))
    machine.reset()
    assert np.abs(law.torque(0.0, machine.position, machine.velocity)).max() == pytest.approx(20.0)


@pytest.mark.parametrize('changes, problem', [
    ({'circle_point': 'platform_center'}, "'circle_point': expected none in mode 'linear_reg"),
    ({'feedforward': [1.0]}, "'feedforward': expected none"),
    ({'state_cost': [1.0]}, 'state_cost: expected 2 values, .* or 6, for those of theta_1'),
    ({'state_cost': [1.0, -1.0]}, 'state_cost: expected .* without negative'),
    ({'torque_cost': [-1.0]}, "'torque_cost': expected no negative"),
    ({'period': 0.07}, 'path_durations: expected a whole number of periods of 0.07 s together'),
    ({'path_places': [5.0, 0.0, 0.0, 0.0]}, 'cannot bring'),
    ({'mode': 'predictive', 'torque_limit': [1.0]}, 'limit: expected more than holds the goal'
     if has_solver else r'piqp: pip install piqp')])
def test_settings_that_make_no_sense_are_refused(changes, problem):
    with pytest.raises(StartError, match=problem):
        law_of(NAME, **changes)


@pytest.mark.parametrize('line, problem', [
    ('horizon: 2.5', 'horizon: expected a whole number, got 2.5'),
    ('horizon: 0', 'horizon: expected 1 to 1000, got 0'),
    ('mode: lqr', 'mode: expected one of .*linear_regulator'),
    ('cost: [1.0]', "expected one of the settings .*, got the text 'cost'")])
def test_files_are_checked_by_key(tmp_path, line, problem):
    path = tmp_path / 'controller.yaml'
    path.write_text(f'closedloop_torque_source:\n  ros__parameters:\n    {line}\n')
    with pytest.raises(StartError, match=f'(?s)controller.yaml.*{problem}'):
        read_controller(path)


def test_a_file_drives_a_simulation():
    values = read_controller(shipped_path('controllers', NAME))
    machine = Simulation.from_scene(values['scene'])
    controller = Controller(NAME, values, machine.scene)
    torques = controller.torques(0.0, machine.position, machine.velocity)
    law, _ = law_of(NAME)
    assert list(torques.values()) == law.torque(
        0.0, machine.position, machine.velocity).tolist()
