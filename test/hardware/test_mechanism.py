# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The mechanism behind the hardware interface of ros2_control, driven by a small loop.

The loop is a program of C++ (closedloop_hardware/test/loop.cpp) that takes orders; what it answers
is compared with a run of the package.
"""

from dataclasses import replace
import math
from pathlib import Path
import platform
import subprocess
import sys

from closedloop_dynamics import c_source, load_scene, Simulation
from closedloop_dynamics.engine import build
import numpy as np
import pytest

PACKAGE = Path(__file__).resolve().parents[2] / 'closedloop_hardware'
STRICT = ('-Wall', '-Wextra', '-Wpedantic', '-Werror')
STEP, BANDWIDTH = 1e-3, 100.0
DRIVEN = 'theta_1', 'theta_6', 'theta_7'

pytestmark = pytest.mark.skipif(
    not build.compiler() or not sys.platform.startswith('linux'),
    reason='needs a C++ compiler on Linux')


def eigen():
    """Return the folder of Eigen's headers, or skip."""
    try:
        return build.eigen()
    except build.BuildError as error:
        pytest.skip(str(error))


@pytest.fixture(scope='module')
def program(tmp_path_factory):
    """Return the loop, compiled."""
    out = tmp_path_factory.mktemp('loop') / 'loop'
    build.run([*build.compiler(), '-std=c++17', '-O0', *STRICT, '-I', PACKAGE / 'include',
               '-isystem', eigen(), PACKAGE / 'src' / 'mechanism.cpp',
               PACKAGE / 'test' / 'loop.cpp', '-ldl', '-o', out])
    return out


def simulation_of(scene):
    scene = load_scene(scene)
    return Simulation.from_scene(replace(scene, method=replace(
        scene.method, integrator='rk4', step_size=STEP, stabilisation='projection')))


def library(folder, name, source, *files):
    """Compile C to a library, and return where it is."""
    (folder / f'{name}.c').write_text(source)
    out = folder / f'{name}.so'
    build.run([*build.compiler(), '-x', 'c', '-std=c99', '-O0', '-fPIC', '-shared',
               folder / f'{name}.c', *files, '-o', out, '-lm'])
    return out


@pytest.fixture(scope='module')
def model(tmp_path_factory):
    """Return the library of the 3-RRR manipulator, upright."""
    folder = tmp_path_factory.mktemp('model')
    source, header = c_source(simulation_of('three_rrr_vertical'), 'machine')
    (folder / 'machine.h').write_text(header)
    return library(folder, 'machine', source)


@pytest.fixture
def obey(program, model):
    """Return a function that gives orders to the loop and returns its answers."""
    def obey(*orders, step=STEP, bandwidth=BANDWIDTH, model=model, refused=False):
        done = subprocess.run(
            [program, model, str(step), str(bandwidth)], input='\n'.join(orders), text=True,
            capture_output=True, timeout=60)
        assert done.returncode == refused, done.stdout + done.stderr
        return done.stdout if refused else [line.split() for line in done.stdout.splitlines()]
    return obey


def numbers(answer):
    return np.array(answer, dtype=float)


def state_of(answer):
    """Return time, and positions, velocities, accelerations and efforts."""
    found = numbers(answer)
    return found[0], found[1:].reshape(-1, 4).T


def test_a_run_is_that_of_the_package(obey):
    simulation = simulation_of('three_rrr_vertical')
    efforts = dict(zip(DRIVEN, (2.0, -1.0, 0.5)))
    joints = simulation.joint_names
    answers = obey(
        'commands theta_1 effort theta_6 effort theta_7 effort',
        *(f'command {joint} {value}' for joint, value in efforts.items()), 'advance 0.001 100',
        f'state {" ".join(joints)}', *(f'wrench {joint}' for joint in joints),
        *(f'wrench {cut.name}'
          for cut in simulation_of('three_rrr_vertical').mechanism.cut_joints))
    simulation.step(efforts, 0.1)
    time, (position, velocity, acceleration, effort) = state_of(answers[2])
    assert time == pytest.approx(0.1, abs=1e-12)
    assert np.abs(simulation.position - simulation_of('three_rrr_vertical').position).max() > 1e-3
    np.testing.assert_allclose(position, simulation.position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(velocity, simulation.velocity, rtol=0, atol=1e-11)
    scale = np.abs(simulation.acceleration).max()
    np.testing.assert_allclose(acceleration, simulation.acceleration, rtol=0, atol=1e-10 * scale)
    np.testing.assert_array_equal(effort, [efforts.get(joint, 0.0) for joint in joints])
    # From world axes into those of the child, or of body A; torques last.
    bodies = [body.name for body in simulation.mechanism.bodies]
    places = [(joint.name, joint.child) for joint in simulation.mechanism.joints] + [
        (cut.name, cut.body_a) for cut in simulation.mechanism.cut_joints]
    assert len(answers) == 3 + len(places) > 3 + len(joints)
    for (name, body), answer in zip(places, answers[3:]):
        moment, x, y = simulation.force(name)
        angle = simulation.body_poses[bodies.index(body)][2]
        cos, sin = math.cos(angle), math.sin(angle)
        np.testing.assert_allclose(
            numbers(answer), [cos * x + sin * y, cos * y - sin * x, 0.0, 0.0, 0.0, moment],
            rtol=0, atol=1e-9)


def test_a_cycle_is_made_of_equal_steps_none_too_long(obey):
    # 0.9 ms in three steps of 0.3 ms, as nine cycles of 0.1 ms, three of which are one step.
    coarse, fine = (
        state_of(obey(f'advance {period} {count}', 'state theta_1', step=step)[1])
        for period, count, step in ((9e-4, 10, 4e-4), (3e-4, 30, 3e-4)))
    assert coarse[0] == pytest.approx(9e-3, abs=1e-15)
    np.testing.assert_allclose(coarse[1], fine[1], rtol=1e-12)
    # What rounding adds to a period is no step more.
    before = state_of(obey('advance 3e-4 1', 'state theta_1', step=3e-4)[1])
    after = state_of(obey('advance 3.00000000001e-4 1', 'state theta_1', step=3e-4)[1])
    np.testing.assert_allclose(before[1], after[1], rtol=1e-9)
    assert obey('advance 0 1', 'state theta_1')[1][0] == '0'


@pytest.mark.parametrize('kind', ('effort', 'position', 'velocity'))
@pytest.mark.skipif(platform.libc_ver()[0] != 'glibc', reason='counts calls of malloc in glibc')
def test_nothing_is_allocated_in_a_cycle(obey, kind):
    switched, advanced = obey(
        f'commands theta_1 {kind} theta_6 {kind} theta_7 {kind}', 'advance 0.001 100')
    # The count does count: what comes before does allocate.
    assert int(switched[1]) > 0
    assert advanced == ['1', '0']


def test_reset_returns_to_the_start_to_the_last_bit(obey):
    orders = ('commands theta_1 position theta_6 velocity', 'command theta_6 0.3',
              'advance 0.001 50', 'state theta_1 theta_2 theta_6', 'wrench theta_3')
    answers = obey('state theta_2', *orders, 'reset', 'state theta_2', *orders)
    assert answers[:5] == answers[5:] and len(answers) == 10
    # It has moved.
    assert answers[0][1] != answers[3][5]


def test_initial_positions_close_the_loops(obey):
    simulation = simulation_of('three_rrr_vertical')
    start = dict(zip(simulation.joint_names, simulation.position.tolist()))
    given = {joint: start[joint] + change for joint, change in zip(DRIVEN, (0.2, -0.15, 0.1))}
    words = ' '.join(f'{joint} {value!r}' for joint, value in given.items())
    _, (position, *_) = state_of(
        obey(f'start {words}', 'reset', f'state {" ".join(start)}')[0])
    found = dict(zip(start, position))
    assert max(abs(found[joint] - value) for joint, value in given.items()) < 1e-12
    # The package closes them on the same branch, the driven joints held.
    for share in np.linspace(0.0, 1.0, 11):
        simulation.set_state(
            {joint: start[joint] + share * (value - start[joint])
             for joint, value in given.items()}, hold=DRIVEN)
    np.testing.assert_allclose(position, simulation.position, rtol=0, atol=1e-9)


@pytest.mark.parametrize('words, message', (
    ('theta_1 9 theta_6 3 theta_7 9', 'expected positions at which the loops of'),
    # One more than there are degrees of freedom.
    ('theta_1 0.3 theta_2 0 theta_6 3 theta_7 3', 'as many joints as there are degrees of'),
    ('theta_1 nan', 'expected a finite position of theta_1, got nan'),
    ('theta_9 0', "theta_3, theta_4, theta_5, theta_6, theta_7), got 'theta_9'")))
def test_initial_positions_that_cannot_be_are_refused(obey, words, message):
    assert message in obey(f'start {words}', refused=True)


def test_unknown_joints_are_refused(obey):
    for order in ('commands theta_0 effort', 'command platform 1', 'state cut_1', 'wrench cut_9'):
        assert 'expected one of' in obey(order, refused=True)


def test_a_position_is_followed_as_by_a_critically_damped_oscillator(obey):
    start = state_of(obey('state theta_1 theta_6 theta_7')[0])[1][0]
    instants, change = np.arange(1, 11) * 4e-3, np.array([0.1, -0.05, 0.08])
    goals = [f'command {joint} {value!r}'
             for joint, value in zip(DRIVEN, (start + change).tolist())]
    errors = []
    for size in (5e-4, 2.5e-4):
        answers = obey(
            'commands theta_1 position theta_6 position theta_7 position', *goals,
            *10 * ('advance 0.004 1', 'state theta_1 theta_6 theta_7'), step=size)
        found = np.array([state_of(answer)[1][0] for answer in answers[2::2]])
        exact = start + change * (1.0 - np.outer(
            (1.0 + BANDWIDTH * instants) * np.exp(-BANDWIDTH * instants), np.ones(3)))
        errors.append(np.abs(found - exact).max())
    # Torques that are constant in a step: an error of first order.
    assert 1e-6 < errors[1] < 2e-3 and 0.4 < errors[1] / errors[0] < 0.6


def test_a_velocity_is_followed_in_one_joint_and_effort_acts_in_others(obey):
    answers = obey(
        'commands theta_1 velocity theta_6 effort', 'command theta_1 0.2', 'command theta_6 0.4',
        'advance 0.001 100', 'state theta_1 theta_6 theta_7')
    _, (_, velocity, _, effort) = state_of(answers[2])
    # Beside what is left of a first-order lag after ten time constants, that of a step.
    assert velocity[0] == pytest.approx(0.2, abs=0.2 * math.exp(-10.0) + 2e-3)
    assert effort[0] != 0.0 and effort[1:].tolist() == [0.4, 0.0]


def test_a_servo_at_its_limit_exerts_that_and_the_others_allow_for_it(obey):
    states = 'state theta_1 theta_6 theta_7'
    start = state_of(obey(states)[0])[1][0]
    # Far from where it is, for a motor as weak as this.
    far = f'command theta_1 {float(start[0]) + 0.5!r}'
    limited = obey('commands theta_1 position theta_6 position theta_7 position',
                   'limit theta_1 12', far, 'advance 0.001 40', states)
    position, velocity, acceleration, effort = state_of(limited[2])[1]
    assert effort[0] == 12.0 and position[0] > start[0] and np.abs(effort[1:]).max() > 0.1
    # Torques are constant in a step.
    np.testing.assert_allclose(position[1:], start[1:], rtol=0, atol=1e-6)
    # The same as a commanded effort of that size.
    twin = obey('commands theta_1 effort theta_6 position theta_7 position',
                'command theta_1 12', 'advance 0.001 40', states)
    np.testing.assert_allclose(state_of(twin[2])[1], state_of(limited[2])[1], rtol=1e-12)
    # A limit that is not reached changes nothing.
    free, wide = (obey(*limit, 'commands theta_1 position', 'command theta_1 0.01',
                       'advance 0.001 20', states) for limit in ((), ('limit theta_1 1e9',)))
    assert free == wide
    assert 'effort_limit: expected more than 0' in obey('limit theta_1 0', refused=True)


def test_commands_that_depend_on_one_another_are_refused(obey):
    orders = ['commands theta_1 position theta_6 position theta_7 velocity',
              'commands theta_1 position theta_2 position theta_6 position theta_7 velocity']
    # A machine of three degrees of freedom.
    assert [answer[0] for answer in obey(*orders)] == ['1', '0']


def test_a_joint_is_held_from_the_moment_on_it_is_commanded(obey):
    joints = 'theta_1 theta_6 theta_7'
    answers = obey(
        f'state {joints}', 'commands theta_1 position theta_6 position theta_7 position',
        'advance 0.001 200', f'state {joints}')
    before, after = (state_of(answers[n])[1] for n in (0, 3))
    # Against its weight.
    np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-6)
    assert np.abs(after[3]).max() > 0.1


def test_faults_keep_the_state_and_are_reported(obey):
    before = obey('state theta_1 theta_2')
    for orders, fault in (
            (['advance -1 1'], 'expected a period of 0 or more [s]'),
            (['commands theta_1 effort', 'command theta_1 nan', 'advance 0.001 1'],
             'expected finite commands')):
        answers = obey(*orders, 'state theta_1 theta_2')
        assert answers[-2][0] == '0' and ' '.join(answers[-2][2:]) == fault
        assert answers[-1][:3] == before[0][:3]
    *_, advanced = obey('commands theta_1 effort', 'command theta_1 1e9', 'advance 0.1 100',
                        step=0.1, bandwidth=0)
    assert advanced[0] == '0' and len(advanced) > 2


def test_settings_are_checked(obey):
    assert 'step_size: expected a time above 0 [s], got 0' in obey(step=0.0, refused=True)
    message = obey(bandwidth=501.0, refused=True)
    assert 'bandwidth: expected 0 to 500 rad/s (0.5 / step_size), got 501' in message


def test_what_is_no_model_is_refused(obey, tmp_path):
    assert 'got ' in obey(model=tmp_path / 'none.so', refused=True)
    other = library(tmp_path, 'other', 'int other_step(void) {return 0;}')
    assert "model: expected 'other_sparsity_in'" in obey(model=other, refused=True)


def test_forces_that_are_not_unique_are_refused(program, obey, tmp_path):
    simulation = simulation_of('bricard')
    source, header = c_source(simulation, 'libmachine')
    (tmp_path / 'libmachine.h').write_text(header)
    joint = simulation.mechanism.joints[0].name
    # A name that begins as those of libraries do.
    message = obey(f'wrench {joint}', model=library(tmp_path, 'libmachine', source), refused=True)
    assert f"expected none, got '{joint}'" in message
