# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The study of what the effects of a scene cost and change, and its sub-command."""

from dataclasses import replace

from closedloop_dynamics import load_scene, Method, Simulation, SimulationError
from closedloop_dynamics.cli import main
from closedloop_dynamics.engine.types import EVALUATIONS
from closedloop_dynamics.kinematics.motions import moving
from closedloop_dynamics.studies import effects, effects_report
from closedloop_dynamics.studies.effects import RateControl, Ratio
import numpy as np
import pytest

SPEED = 4.7124


@pytest.fixture(scope='module')
def study():
    """Return the study of a short time on the carpet, in few steps."""
    scene = replace(load_scene('carpet_scraper_on_carpet'), method=Method(step_size=2e-3))
    return effects.study_effects(scene, 1.4, rates={'theta_1': SPEED}, rows=140)


def test_every_type_of_effect_is_found_once(study):
    assert [finding.kind for finding in study.findings] == [
        'gravity', 'actuator', 'rotor', 'contact', 'joint_friction']
    for finding in study.findings:
        for ratio in (finding.alone, finding.without):
            assert 0.0 < ratio.low <= ratio.value <= ratio.high
        assert finding.energy > 0.0


def test_arithmetic_and_motion_are_distinguished(study):
    for finding in study.findings:
        assert finding.time == finding.without.value * finding.motion
    # The evaluations that the same run makes without rows.
    simulation = Simulation(load_scene('slider_crank'))
    run = effects.record(simulation, 0.2, 1)
    alone = Simulation(load_scene('slider_crank'))
    alone.step(None, 0.2)
    made = alone.data.system.work.health[EVALUATIONS] / 0.2
    assert run.evaluations == pytest.approx(made, rel=0.02)


def test_advice_follows_what_matters(study):
    coarse, fine = (effects_report.advice(study, matters) for matters in (10.0, 1e-12))
    assert coarse.count('leave out') == len(study.findings) and 'matters, at 1e-12' in fine
    assert 'tool by' in fine
    assert 'forces at the cut joints by' in fine


def test_the_time_is_split_into_evaluations_and_what_one_takes(study):
    def words(without, motion):
        finding = replace(study.findings[-1], without=Ratio(without, without, without),
                          motion=motion)
        return effects_report.advice(replace(study, findings=(finding,)), 1.0)

    assert 'takes 64 % of the time (40 % of an evaluation, 40 % of the evaluations)' in words(
        0.6, 0.6)
    assert 'takes 40 % of the time (nothing of an evaluation, 40 % of the evaluations)' in words(
        0.995, 0.6)
    assert 'without it the motion takes 20 % more time' in words(1.0, 1.2)


def test_what_changes_little_is_left_out_together(monkeypatch):
    monkeypatch.setattr(effects, 'REPEATS', 2)
    scene = load_scene('three_rrr_payload_friction')
    assert effects.study_effects(scene, 0.1, rows=5).together is None
    study = effects.study_effects(scene, 0.1, rows=5, matters=0.01)
    little = [one for one in study.findings if one.moved <= 0.01]
    assert len(little) > 1 and study.together.names == tuple(
        name for one in little for name in one.names)
    # The run without all of them, and no other.
    names = set(scene.effects) - set(study.together.names)
    alone = effects.record(Simulation(effects.scene_with(scene, names)), 0.1, 5)
    assert np.array_equal(study.together.run.position, alone.position)
    advice = effects_report.advice(study, 0.01)
    assert f'{" and ".join(study.together.names)} together: changes' in advice
    assert len(advice.splitlines()) == len(study.findings) + 1


SCENES = {
    'in space, with orientations': lambda: load_scene('stewart_platform'),
    'in space, with contact': lambda: load_scene('delta_robot'),
    'closure equations that repeat others': lambda: load_scene('bennett'),
    'prescribed motion': lambda: moving(load_scene('four_bar'), {'crank_joint': '1.0472+2*t'})}


@pytest.mark.parametrize('name', SCENES)
def test_every_class_of_scene_is_studied(name, tmp_path, monkeypatch):
    monkeypatch.setattr(effects, 'REPEATS', 2)
    study = effects.study_effects(SCENES[name](), 0.1, rows=10)
    for finding in study.findings:
        assert finding.failure == '' and finding.without.value > 0.0 and finding.motion > 0.0
        assert finding.position > 0.0 and finding.joint in study.simulation.joint_names
    assert all(path.stat().st_size > 200 for path in effects_report.write(study, tmp_path))


def test_changes_of_orientations_are_angles(monkeypatch):
    monkeypatch.setattr(effects, 'REPEATS', 1)
    scene = load_scene('stewart_platform')
    study = effects.study_effects(scene, 0.3, rows=5)
    finding, = study.findings
    coordinates = study.simulation.coordinates
    expected = 0.0
    for q, other in zip(finding.run.position, study.run.position):
        single = coordinates.place[coordinates.place >= 0]
        expected = max(expected, np.abs(q - other)[single].max())
        for first, _ in coordinates.balls:
            one, two = q[first:first + 4], other[first:first + 4]
            expected = max(expected, 2.0 * np.arccos(min(1.0, abs(one @ two))))
    assert finding.position == pytest.approx(expected, rel=1e-6)


def test_a_scene_that_needs_an_effect_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(effects, 'REPEATS', 1)
    built = effects.Simulation

    def refusing(scene):
        if 'gravity' not in scene.effects and scene.effects:
            raise SimulationError('The scene needs its weight. Or so.')
        return built(scene)

    monkeypatch.setattr(effects, 'Simulation', refusing)
    study = effects.study_effects(load_scene('slider_crank_end_stop'), 0.1, rows=5)
    gravity, stop = study.findings
    assert gravity.failure and gravity.run is None and not stop.failure
    assert 'without gravity: The scene needs its weight' in effects_report.table(study)
    assert 'gravity: needed' in effects_report.advice(study, 1e-3)
    effects_report.write(study, tmp_path)


def test_the_noise_of_times_is_reported(study):
    # The same code in turn: whatever the machine is busy with, a median close to 1.
    assert study.again.value == pytest.approx(1.0, abs=0.1)
    assert 'measured once more' in effects_report.summary(study)


def test_ratios_know_their_range():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(400):
        times = 1.3 * rng.lognormal(0.0, 0.1, 60)
        ratio = effects.ratio(times, np.ones(60))
        inside += ratio.low <= 1.3 <= ratio.high
    assert 0.91 < inside / 400 < 0.995


def test_the_crank_keeps_its_rate(study):
    # The lag of the motor, 5 ms, shows where the torque changes fast.
    assert np.abs(study.run.velocity[20:, 0] - SPEED).max() < 0.2 * SPEED
    assert study.run.velocity[20:, 0].mean() == pytest.approx(SPEED, rel=0.02)


def test_the_carpet_asks_for_work(study):
    free = next(f.run for f in study.findings if f.kind == 'contact')
    scraping = study.run.readings['carpet']['scraping_force']
    assert scraping.max() == pytest.approx(25.0, abs=2.0)
    # A stroke of half a metre against friction and scraping of some 24 N each.
    assert study.run.balance[-1, 2] == pytest.approx(25.0, abs=5.0)
    assert study.run.balance[-1, 3] > free.balance[-1, 3] + 20.0
    assert np.abs(study.run.balance[:, 4]).max() < 1e-3


def test_losses_are_reported_by_type(study):
    losses = [effects_report.dissipated(study, finding) for finding in study.findings]
    assert sum(losses) == pytest.approx(study.run.balance[-1, 2], rel=1e-9)
    assert max(losses) == losses[3] > 20.0


def test_table_files_and_pictures(study, tmp_path):
    paths = effects_report.write(study, tmp_path)
    assert [path.name for path in paths] == [
        'carpet_scraper_on_carpet_effects.csv', 'carpet_scraper_on_carpet_effects.md',
        'carpet_scraper_on_carpet_effects.png', 'carpet_scraper_on_carpet_carpet.png']
    assert all(path.stat().st_size > 200 for path in paths)
    assert len(paths[0].read_text().splitlines()) == 6
    assert '| contact |' in paths[1].read_text()
    for finding in study.findings:
        assert finding.kind in effects_report.table(study)


def test_rates_of_all_driven_joints_are_kept():
    scene = load_scene('three_rrr_payload_friction')
    rates = {'theta_1': 0.2, 'theta_6': -0.1, 'theta_7': 0.15}
    simulation, control = Simulation(scene), RateControl(scene, rates)
    for _ in range(300):
        simulation.step(control.torque(simulation))
    for joint, rate in rates.items():
        assert simulation.velocity[simulation.joint_names.index(joint)] == pytest.approx(
            rate, abs=0.05)
    with pytest.raises(ValueError, match='theta_6'):
        RateControl(scene, {'theta_1': 1.0})


@pytest.mark.parametrize('arguments, reason', [
    (['three_rrr_horizontal'], 'lists no effects'),
    (['three_rrr', '--joint-rate', 'theta_1=1'], 'theta_6'),
    (['three_rrr', '--torque', 'theta_2=1'], 'theta_2'),
    (['four_bar', '--torque', 'crank_joint=1', '--joint-rate', 'crank_joint=1'], 'got both')])
def test_impossible_questions_are_refused(arguments, reason, capsys):
    assert main(['effects', *arguments]) == 2
    assert reason in capsys.readouterr().err


def test_the_command_prints_and_writes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(effects, 'REPEATS', 2)
    arguments = ['effects', 'slider_crank_end_stop', '--duration', '0.5', '--output',
                 str(tmp_path / 'new')]
    assert main(arguments) == 0
    output = capsys.readouterr().out
    assert 'end_stop' in output and 'one evaluation' in output
    assert (tmp_path / 'new' / 'slider_crank_end_stop_effects.md').exists()
    assert main(arguments) == 2
    assert '--overwrite' in capsys.readouterr().err
