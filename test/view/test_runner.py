# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What a simulation does that pages take hold of."""

import json
from test.view.rows import places_of, rows_of

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.kinematics.modeling import extent
from closedloop_dynamics.mechanism.kinematics import poses_in_space
from closedloop_dynamics.view.own_motion import own_motion
from closedloop_dynamics.view.runner import RATE, Runner
from closedloop_dynamics.view.thinning import OF_RANGE, OF_SIZE
import numpy as np
import pytest


def controls(shown):
    return json.loads(shown.feed.controls)


def row(shown):
    """Return the columns of the newest frame, by group and name."""
    reported = json.loads(shown.feed.description)
    values = np.frombuffer(shown.feed.frame()[0][16:], dtype=np.float32)
    assert len(values) == reported['columns']['width']
    first = reported['columns']['plots']
    return {(plot['group'], plot['name']): values[first + k]
            for k, plot in enumerate(reported['plots'])}


def test_it_moves_as_without_a_page(shown):
    alone = Simulation.from_scene('three_rrr_vertical')
    shown.ask('command', joint='theta_1', value=2.5)
    shown.ask('play')
    shown.run(40)
    steps = round(shown.simulation.time / alone.step_size)
    assert steps in range(600, 670)
    alone.advance(alone.joint_torques({'theta_1': 2.5}), steps)
    # The spring of the hand, switched off, is one more state in the same sums.
    np.testing.assert_allclose(shown.simulation.position, alone.position, rtol=0.0, atol=1e-9)


def test_frames_show_the_state(shown):
    shown.ask('play')
    shown.run(30)
    shown.ask('pause')
    simulation = shown.simulation
    reported = json.loads(shown.feed.description)
    values = np.frombuffer(shown.feed.frame()[0][16:], dtype=np.float32)
    poses = values[:7 * len(reported['bodies'])].reshape(-1, 7)
    np.testing.assert_array_equal(
        poses, poses_in_space(simulation.body_poses).astype(np.float32))
    found = row(shown)
    for name, value in zip(simulation.joint_names, simulation.position):
        assert found['joint position', name] == np.float32(value)
    forces = np.linalg.norm(simulation.constraint_forces[:, 1:], axis=1)
    for cut, force in zip(simulation.mechanism.cut_joints, forces):
        assert found['force where loops close', cut.name] == pytest.approx(force, rel=1e-6)
    balance = simulation.energy_balance
    assert found['energy', 'kinetic'] == np.float32(balance.kinetic) > 0.0


def test_time_stands_still_steps_and_starts_again(shown):
    shown.run(5)
    assert shown.simulation.time == 0.0
    shown.ask('step', count=7)
    assert shown.simulation.time == pytest.approx(7 * shown.simulation.step_size)
    shown.ask('play')
    shown.run(10)
    shown.ask('pause')
    time = shown.simulation.time
    shown.run(5)
    assert shown.simulation.time == time > 0.1
    start = Simulation.from_scene('three_rrr_vertical').position
    shown.ask('reset')
    assert shown.simulation.time == 0.0
    np.testing.assert_array_equal(shown.simulation.position, start)


@pytest.mark.parametrize('factor', [0.01, 0.3, 10.0])
def test_speed_is_followed(shown, factor):
    shown.ask('speed', factor=factor)
    shown.ask('play')
    shown.run(60)
    # What is due but is not a whole step yet is left.
    assert factor - shown.simulation.time < shown.simulation.step_size + 1e-9


def test_slow_motion_is_even(shown):
    shown.ask('speed', factor=0.01)
    shown.ask('play')
    times = []
    for _ in range(60):
        shown.run(1)
        times.append(np.frombuffer(shown.feed.frame()[0][8:16])[0])
    # A sixth of a step from frame to frame, not six frames alike and then a step.
    np.testing.assert_allclose(np.diff(times)[12:], 0.01 / 60.0, rtol=1e-6)


def test_a_step_that_fails_stops_and_is_reported(shown):
    shown.ask('command', joint='theta_1', value=1e12)
    shown.ask('play')
    shown.run(60)
    reported = controls(shown)
    assert not reported['playing'] and 'kept' in reported['failure']
    assert np.isfinite(shown.simulation.position).all()
    shown.ask('reset')
    assert controls(shown)['failure'] is None
    shown.ask('play')
    shown.run(20)
    assert controls(shown)['playing'] and shown.simulation.time > 0.2


def test_a_failure_is_that_of_its_method(shown):
    before = controls(shown)['method']
    try:
        shown.ask('method', values={'integrator': 'semi_implicit_euler', 'step_size': 0.01})
        shown.ask('step', count=300)
        assert 'semi_implicit_euler' in controls(shown)['failure']
        failed_at = shown.simulation.time
        shown.ask('method', values={'integrator': 'auto'})
        assert controls(shown)['failure'] is None
        shown.ask('step', count=100)
        assert controls(shown)['failure'] is None
        assert shown.simulation.time == pytest.approx(failed_at + 1.0)
    finally:
        shown.ask('method', values={
            key: before[key] for key in ('integrator', 'step_size', 'accuracy')})


def test_a_position_drive_arrives(shown):
    place = shown.simulation.joint_names.index('theta_1')
    goal = shown.simulation.position[place] + 0.3
    for joint in shown.simulation.actuated_joints:
        shown.ask('drive', joint=joint, mode='position')
    shown.ask('command', joint='theta_1', value=goal)
    shown.ask('effect', name='gravity', enabled=False)
    shown.ask('play')
    shown.run(120)
    assert shown.simulation.position[place] == pytest.approx(goal, abs=1e-3)
    assert np.abs(shown.simulation.velocity).max() < 0.02


@pytest.mark.parametrize('mode, value, expected', [
    ('speed', 0.5, lambda start, t: start + 0.5 * t),
    ('speed', -0.25, lambda start, t: start - 0.25 * t),
    # An angle is followed from where it is, whole turns aside.
    ('expression', '{start} + 6*pi + 0.2*sin(3*t)', lambda start, t: start + 0.2 * np.sin(3 * t)),
    ('expression', '{start} + t**2/8', lambda start, t: start + t ** 2 / 8.0)])
def test_a_drive_follows_speeds_and_expressions(shown, mode, value, expected):
    place = shown.simulation.joint_names.index('theta_1')
    start = float(shown.simulation.position[place])
    shown.ask('drive', joint='theta_1', mode=mode)
    shown.ask('command', joint='theta_1', value=value.format(start=start) if (
        mode == 'expression') else value)
    shown.ask('effect', name='gravity', enabled=False)
    shown.ask('play')
    shown.run(45)
    time = shown.simulation.time
    assert time > 0.7 and controls(shown)['drives']['theta_1']['mode'] == mode
    assert shown.simulation.position[place] == pytest.approx(expected(start, time), abs=2e-3)


@pytest.mark.parametrize('mode, value, words', [
    ('expression', 'fly(t)', 'fly'), ('expression', 3.0, 'text'), ('speed', 't', 'number'),
    ('expression', '__import__("os")', 'expression'), ('expression', 'abs(t-1)', 'corners')])
def test_impossible_references_are_refused(shown, mode, value, words):
    shown.ask('drive', joint='theta_1', mode=mode)
    before = controls(shown)['drives']
    shown.ask('command', joint='theta_1', value=value)
    assert controls(shown)['drives'] == before
    assert words in controls(shown)['notes'][-1]['text']


def test_an_expression_without_a_value_stops_the_run_in_words(shown):
    shown.ask('drive', joint='theta_1', mode='expression')
    shown.ask('command', joint='theta_1', value='1 + sqrt(0.1 - t)')
    shown.ask('play')
    shown.run(20)
    reported = controls(shown)
    assert not reported['playing']
    assert 'theta_1 has no finite value at t = 0.1' in reported['failure']
    shown.ask('reset')
    assert controls(shown)['failure'] is None


def test_what_accuracy_costs_is_reported_while_it_runs(shown):
    def run():
        shown.ask('reset')
        shown.ask('command', joint='theta_1', value=5.0)
        shown.ask('play')
        # The estimate and the cost are looked at four times a second.
        shown.run(40)
        reported, row = json.loads(shown.feed.description), shown.runner.rows.row()
        return {(plot['group'], plot['name']): row[reported['columns']['plots'] + k]
                for k, plot in enumerate(reported['plots'])}

    before = controls(shown)['method']
    try:
        shown.ask('method', values={'accuracy': 1e-3})
        rough = run()
        shown.ask('method', values={'accuracy': 1e-9})
        fine = run()
        assert controls(shown)['method']['accuracy'] == 1e-9
    finally:
        shown.ask('method', values={'accuracy': before['accuracy']})
    bound, kept, cost, evaluations = (
        ('estimated error', 'within a second'), ('estimated error', 'accuracy kept'),
        ('cost', 'computing'), ('evaluations', 'in a simulated second'))
    assert 0.0 < fine[bound] < rough[bound]
    assert fine[kept] == np.float32(1e-9) and rough[kept] == np.float32(1e-3)
    assert fine[cost] > 0.0 and rough[cost] > 0.0
    assert fine[evaluations] > 0.0 and rough[evaluations] > 0.0


def test_a_budget_is_set_and_taken_away(shown):
    assert controls(shown)['method']['budget'] is None
    shown.ask('method', values={'budget': 0.25})
    assert shown.simulation.report().budget == controls(shown)['method']['budget'] == 0.25
    shown.ask('speed', factor=0.5)
    assert shown.simulation.stepping.pace == 0.5
    shown.ask('speed', factor=1.0)
    shown.ask('method', values={'budget': None})
    assert controls(shown)['method']['budget'] is None
    assert np.isnan(shown.simulation.report().budget)


def test_gravity_turns_and_is_switched_off(shown):
    shown.ask('effect', name='gravity', values={'acceleration': [9.81, 0.0]})
    shown.ask('play')
    shown.run(6)
    sideways = shown.simulation.velocity.copy()
    shown.ask('reset')
    shown.ask('effect', name='gravity', enabled=False)
    shown.ask('play')
    shown.run(6)
    assert np.abs(sideways).max() > 0.1
    assert np.abs(shown.simulation.velocity).max() < 1e-9


def test_a_hand_pulls_as_a_spring_does(shown):
    simulation = shown.simulation
    shown.ask('effect', name='gravity', enabled=False)
    reported = json.loads(shown.feed.description)
    body = next(k for k, one in enumerate(reported['bodies']) if one['name'] == 'platform')
    start = simulation.body_poses[body][:2]
    place = next(k for k, grab in enumerate(reported['bodies'][body]['grabs']) if not any(grab))
    at = [*(start + [0.03, 0.02]), 0.0]
    shown.ask('play')
    shown.ask('grab', body=body, place=place, at=at)
    shown.run(6)
    moved = simulation.body_poses[body][:2] - start
    assert moved @ [0.03, 0.02] > 0.0
    # All energy is that of the spring: nothing comes from nowhere.
    balance = simulation.energy_balance
    assert abs(balance.residual) < 1e-6 * (balance.kinetic + balance.stored)
    # Another page has no say in it, and what holds lets go when it leaves.
    shown.ask('release', page='another')
    assert 'hand' in simulation.data.enabled_effects
    shown.feed.leave('page')
    shown.run(1)
    assert 'hand' not in simulation.data.enabled_effects


@pytest.mark.parametrize('name', ['four_bar', 'slider_crank'])
def test_a_point_that_is_pulled_beyond_its_reach_comes_to_rest(name):
    now = [0.0]
    runner = Runner(load_scene(name), lambda: now[0])
    for asked in ({'do': 'play'}, {'do': 'grab', 'body': 0, 'place': 0, 'at': [0.0, 0.0, 0.0]},
                  {'do': 'pull', 'at': [1.0, 0.6, 0.0]}):
        runner.feed.accept('page', json.dumps(asked))
    positions = []
    for _ in range(6 * round(RATE)):
        now[0] += 1.0 / RATE
        runner.tick()
        positions.append(runner.simulation.position)
    # In the last second; across the line that it is pulled along nothing but damping holds it.
    assert np.ptp(positions[-round(RATE):], axis=0).max() < 0.02


def test_loops_stay_closed_while_it_is_posed(shown):
    simulation = shown.simulation
    shown.ask('kinematic', on=True)
    place = simulation.joint_names.index('theta_1')
    others = [k for k in simulation.data.actuated if k != place]
    held = simulation.position[others]
    for value in np.linspace(simulation.position[place], simulation.position[place] - 0.4, 8):
        shown.ask('pose', joint='theta_1', value=float(value))
        assert simulation.closure < 1e-9
    assert simulation.position[place] == pytest.approx(value, abs=1e-8)
    np.testing.assert_allclose(simulation.position[others], held, atol=1e-6)
    # By hand: the point follows as far as the legs reach.
    reported = json.loads(shown.feed.description)
    body = next(k for k, one in enumerate(reported['bodies']) if one['name'] == 'platform')
    which = next(k for k, grab in enumerate(reported['bodies'][body]['grabs']) if not any(grab))
    at = [*(simulation.body_poses[body][:2] + [0.02, -0.03]), 0.0]
    shown.ask('grab', body=body, place=which, at=at)
    np.testing.assert_allclose(simulation.body_poses[body][:2], at[:2], atol=1e-6)
    shown.ask('pull', at=[5.0, 5.0, 0.0])
    assert simulation.closure < 1e-9
    # What was posed is the start now.
    posed = simulation.position
    shown.ask('kinematic', on=False)
    shown.ask('play')
    shown.run(10)
    assert np.abs(simulation.position - posed).max() > 1e-3
    shown.ask('reset')
    np.testing.assert_allclose(simulation.position, posed, atol=1e-9)


@pytest.mark.parametrize('asked', [
    {'do': 'command', 'joint': 'theta_2', 'value': 1.0},
    {'do': 'effect', 'name': 'nothing', 'enabled': True},
    {'do': 'effect', 'name': 'hand', 'enabled': True},
    {'do': 'effect', 'name': 'gravity', 'values': {'acceleration': [1.0]}},
    {'do': 'effect', 'name': 'gravity', 'values': {'mass': 1.0}},
    {'do': 'method', 'values': {'integrator': 'guess'}},
    {'do': 'method', 'values': {'step_size': -1.0}},
    {'do': 'grab', 'body': 99, 'place': 0, 'at': [0.0, 0.0, 0.0]},
    {'do': 'grab', 'body': 0, 'place': 0, 'at': [1e300, 0.0, 0.0]},
    {'do': 'pose', 'joint': 'theta_1', 'value': 1.0},
])
def test_what_makes_no_sense_is_refused_and_changes_nothing(shown, asked):
    state, refused = shown.simulation.state, shown.feed.refused
    before = {**controls(shown), 'notes': None, 'refused': None}
    shown.ask(asked.pop('do'), **asked)
    assert shown.feed.refused == refused + 1
    assert {**controls(shown), 'notes': None, 'refused': None} == before
    np.testing.assert_array_equal(shown.simulation.state, state)


def test_lines_between_the_states_that_a_page_gets_miss_none(shown):
    shown.ask('command', joint='theta_1', value=8.0)
    shown.ask('play')
    shown.run(1)
    _, _, sampled = shown.feed.frame()
    begin = shown.simulation.time
    # A page that shows one frame of them all.
    shown.run(60)
    frame, _, _ = shown.feed.frame(sampled)
    reported = shown.runner.described
    times, rows = rows_of(frame, reported['columns']['width'])
    assert np.diff(times).min() > 0.0
    # They are the states of a run that is not shown, and fewer than its steps.
    alone = Simulation(load_scene('three_rrr_vertical'))
    tau = alone.joint_torques({'theta_1': 8.0})
    alone.advance(tau, round(begin / alone.step_size))
    steps = round((times[-1] - begin) / alone.step_size)
    assert steps > 900 and 60 <= len(times) < 0.5 * steps
    every, points, forces = [], [], []
    for _ in range(steps):
        alone.advance(tau, 1)
        every.append(alone.time)
        points.append(alone.points[0])
        forces.append(np.linalg.norm(alone.constraint_forces[:, 1:], axis=1))
    inside = np.array(every) >= times[0]
    first = reported['columns']['plots'] + [plot['group'] for plot in reported['plots']].index(
        'force where loops close')
    for k, force in enumerate(np.transpose(forces)):
        between = np.interp(every, times, rows[:, first + k])
        # Ranges grow at the start of a run, and between frames the tolerance is that of both ends.
        assert np.abs(between - force)[inside].max() < 4.0 * OF_RANGE * np.ptp(forces)
    between = np.transpose([np.interp(every, times, place) for place in (
        places_of(reported['points'][0], rows)[:, :2].T)])
    assert np.abs(between - points)[inside].max() < 4.0 * OF_SIZE * extent(alone.mechanism)
    # A page that has them gets none again, nor those of another run.
    width = reported['columns']['width']
    assert len(shown.feed.frame(shown.feed.frame()[2])[0]) == 16 + 4 * width
    shown.ask('reset')
    assert len(shown.feed.frame(0)[0]) == 16 + 4 * width


@pytest.mark.parametrize('speed', [0.01, 0.3, 10.0])
def test_samples_are_few_and_time_never_goes_back(shown, speed):
    shown.ask('play')
    shown.run(5)
    shown.ask('speed', factor=speed)
    last, sampled = 0.0, shown.feed.frame()[2]
    for _ in range(20):
        shown.run(1)
        frame, _, sampled = shown.feed.frame(sampled)
        times, _ = rows_of(frame, shown.runner.described['columns']['width'])
        assert times[0] >= last and (np.diff(times) > 0.0).all() and len(times) < 60
        last = times[-1]


def test_a_machine_that_is_too_slow_says_how_fast_it_is(shown, monkeypatch):
    shown.ask('play')
    shown.run(60)
    assert controls(shown)['achieved'] == pytest.approx(1.0, abs=0.1)
    advance = shown.simulation.advance

    def slow(tau, steps):
        # Twenty times as long as real time allows.
        shown.now += 20.0 * steps * shown.simulation.step_size
        advance(tau, steps)

    monkeypatch.setattr(shown.simulation, 'advance', slow)
    shown.run(60)
    assert controls(shown)['playing'] and 0.02 < controls(shown)['achieved'] < 0.06
    shown.ask('pause')
    assert controls(shown)['achieved'] is None


def test_a_step_that_takes_long_is_made_in_parts():
    # A clock that says so: a hundredth of a second for each evaluation, as next to parallel rods.
    now = [0.0]
    runner = Runner(load_scene('four_bar'), lambda: now[0])
    simulation, step, advance = runner.simulation, runner.simulation.step, None
    sizes = []

    def slow_step(torque, duration):
        step(torque, duration)
        sizes.append(duration)
        now[0] += duration * 1000.0

    def slow_advance(tau, steps):
        advance(tau, steps)
        sizes.append(steps * simulation.step_size)
        now[0] += steps * simulation.step_size * 1000.0

    advance, simulation.advance, simulation.step = simulation.advance, slow_advance, slow_step
    runner.feed.accept('page', json.dumps({'do': 'play'}))
    for _ in range(40):
        before = now[0]
        now[0] += 1.0 / RATE
        runner.tick()
        # The first one could not be known to take long.
        assert now[0] - before < 0.06 or len(sizes) < 3
    assert min(sizes) < 0.05 * simulation.step_size
    assert simulation.time == pytest.approx(sum(sizes))
    reported = json.loads(runner.feed.controls)
    assert reported['achieved'] < 0.05 and reported['failure'] is None
    runner.feed.accept('page', json.dumps({'do': 'pause'}))
    runner.tick()
    assert not runner.playing


@pytest.mark.parametrize('name', [
    'four_bar', *(pytest.param(name, marks=pytest.mark.slow) for name in (
        'bricard', 'stewart_platform', 'double_wishbone', 'excavator_arm'))])
def test_shipped_machines_do_not_fall(name):
    now = [0.0]
    scene = load_scene(name)
    runner = Runner(scene, lambda: now[0], own_motion)
    assert json.loads(runner.feed.controls)['motion'] == 'own'
    size = np.ptp(runner.simulation.points, axis=0).max()
    away, start = 0.0, runner.simulation.points.copy()
    runner.feed.accept('page', json.dumps({'do': 'play'}))
    for _ in range(240):
        now[0] += 1.0 / RATE
        runner.tick()
        away = max(away, np.abs(runner.simulation.points - start).max())
    assert 0.02 * size < away < 2.0 * size
    assert json.loads(runner.feed.controls)['failure'] is None


def test_a_drive_follows_a_speed_where_the_inertia_it_feels_changes():
    now = [0.0]
    # Its crank feels a tenth of the inertia in another position.
    runner = Runner(load_scene('hoeken_pantograph_leg'), lambda: now[0], own_motion)
    runner.feed.accept('page', json.dumps({'do': 'play'}))
    simulation = runner.simulation
    wanted, off = runner.drives['theta_1'].value, 0.0
    for _ in range(90):
        now[0] += 1.0 / RATE
        runner.tick()
        if simulation.time > 0.3:
            off = max(off, abs(simulation.velocity[0] - wanted))
    assert simulation.time > 1.4 and off < 0.6 * wanted
    # Its weight drives it off, never for long.
    assert simulation.position[0] == pytest.approx(wanted * simulation.time, abs=0.1)


def test_own_motion_held_and_free():
    now = [0.0]
    runner = Runner(load_scene('excavator_arm'), lambda: now[0], own_motion)
    simulation, driven = runner.simulation, runner.simulation.data.actuated_in_tree

    def ask(what, frames=0, **more):
        runner.feed.accept('page', json.dumps({'do': what, **more}))
        for _ in range(max(frames, 1)):
            now[0] += 1.0 / RATE
            runner.tick()
        return json.loads(runner.feed.controls)

    assert ask('play', frames=90)['motion'] == 'own'
    assert ask('motion', which='held')['motion'] == 'held'
    before = simulation.coordinates.by_freedom(simulation.position)[driven]
    ask('seen', frame=0, frames=60)
    after = simulation.coordinates.by_freedom(simulation.position)[driven]
    np.testing.assert_allclose(after, before, rtol=0.0, atol=2e-2)
    assert ask('motion', which='free', frames=12)['motion'] == 'free'
    assert np.abs(simulation.effort[driven]).max() == 0.0
    assert ask('reset')['motion'] == 'own' and simulation.time == 0.0
    refused = ask('command', joint='slew', value=1.0)['notes'][-1]['text']
    assert 'another mode' in refused


def test_no_request_compiles_while_it_runs(shown, wanted):
    at, refused = [0.1, 0.1, 0.0], shown.feed.refused
    wanted.clear()
    for request in (
            ('play', {}), ('command', {'joint': 'theta_1', 'value': 1.0}),
            ('grab', {'body': 3, 'place': 0, 'at': at}), ('pull', {'at': [0.2, 0.1, 0.0]}),
            ('release', {}), ('drive', {'joint': 'theta_1', 'mode': 'position'}),
            ('drive', {'joint': 'theta_1', 'mode': 'expression'}), ('motion', {'which': 'free'}),
            ('effect', {'name': 'gravity', 'enabled': False}),
            ('effect', {'name': 'gravity', 'enabled': True}),
            *(('method', {'values': {'integrator': integrator, 'stabilisation': stabilisation}})
              for integrator, stabilisation in (
                  ('dopri5', 'independent'), ('rodas4', 'baumgarte'), ('auto', 'projection'))),
            ('speed', {'factor': 0.1}), ('pause', {}), ('step', {'count': 3}),
            ('kinematic', {'on': True}), ('pose', {'joint': 'theta_1', 'value': 0.5}),
            ('kinematic', {'on': False}), ('reset', {}), ('play', {})):
        what, more = request
        shown.ask(what, **more)
        shown.run(3)
        assert not wanted and shown.feed.refused == refused, request
