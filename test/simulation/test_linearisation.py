# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linear models, equilibria and modes: differences of runs, and answers that are known."""

import math

from closedloop_dynamics import (
    Linearisation, load_scene, Model, Simulation, SimulationError, SingularityError)
from closedloop_dynamics.cli import main
from closedloop_dynamics.effects.registry import JointDamping, JointSpring, PointSpring
from closedloop_dynamics.recording.modes import mode_motion
from closedloop_dynamics.recording.rows import read_rows
import numpy as np
import pytest
from scipy.linalg import logm

from .test_derivatives import PARALLELOGRAM, PARALLELOGRAM_SCENE, simulation_of
from ..test_cli import done

ACCURATE = {'integrator': 'dop853', 'tolerance': 1e-12, 'step_size': 1e-3}


def parallelogram(folder, effects=(), points='', **method):
    (folder / 'parallelogram.yaml').write_text(PARALLELOGRAM + points)
    (folder / 'scene.yaml').write_text(PARALLELOGRAM_SCENE)
    return simulation_of(folder / 'scene.yaml', effects, **method)


def flow_differences(simulation, model, command, period, step=1e-3):
    """Return the derivative of the motion over a period by differences of fourth order."""
    n = len(model.states) // 2
    names = [name.split('.', 1)[1] for name in model.states[:n]]
    own = [simulation.joint_names.index(name) for name in names]
    q, qd = simulation.position, simulation.velocity

    def moved(change):
        position, velocity = q.copy(), qd.copy()
        position[own] += change[:n]
        velocity[own] += change[n:2 * n]
        simulation.set_state(position, velocity, hold=names)
        simulation.step({name: command.get(name, 0.0) + more for name, more in zip(
            simulation.actuated_joints, change[2 * n:])}, period)
        return np.concatenate((simulation.position[own], simulation.velocity[own]))

    return np.stack([
        (8.0 * (moved(step * unit) - moved(-step * unit))
         - moved(2.0 * step * unit) + moved(-2.0 * step * unit)) / (12.0 * step)
        for unit in np.eye(2 * n + len(simulation.actuated_joints))], axis=1)


@pytest.mark.parametrize('scene, effects', (
    ('three_rrr_vertical', {}), ('carpet_scraper', {'damper': JointDamping('theta_1', 0.4)}),
    # Of its closure equations some repeat others.
    ('bennett', {})))
def test_discrete_models_are_derivatives_of_runs(scene, effects):
    simulation = simulation_of(scene, effects, **ACCURATE)
    command = dict(zip(simulation.actuated_joints, (1.0, -0.5, 0.3)))
    simulation.step(command, 0.1)
    linearisation = Linearisation(simulation)
    before = simulation.state
    model = linearisation.discrete_model(0.03, torque=command)
    assert np.array_equal(simulation.state, before) and model.period == 0.03
    expected = flow_differences(simulation, model, command, 0.03)
    np.testing.assert_allclose(np.hstack((model.A, model.B)), expected, rtol=0,
                               atol=2e-9 * np.abs(expected).max())


def test_a_linear_model_is_the_logarithm_of_the_flow():
    simulation = simulation_of(
        'carpet_scraper', {'damper': JointDamping('theta_1', 0.4)}, **ACCURATE)
    linearisation = Linearisation(simulation)
    torque, period = linearisation.static_torque(), 0.05
    model = linearisation.linear_model(torque=torque)
    flow = flow_differences(simulation, model, torque, period)
    n = len(model.A)
    found = logm(np.block([[flow], [np.zeros((flow.shape[1] - n, n)), np.eye(
        flow.shape[1] - n)]])) / period
    np.testing.assert_allclose(found[:n], np.hstack((model.A, model.B)), rtol=0,
                               atol=1e-7 * np.abs(model.A).max())


def test_a_linear_model_on_the_way_predicts_the_deviation_of_rates():
    simulation = simulation_of('three_rrr_vertical', **ACCURATE)
    simulation.step({'theta_1': 3.0}, 0.2)
    linearisation = Linearisation(simulation)
    model = linearisation.linear_model(outputs=('position', 'velocity', 'acceleration'))
    q, qd, nv = simulation.position, simulation.velocity, len(simulation.velocity)
    assert model.C.shape == (3 * nv, len(model.states))
    assert model.outputs[nv] == 'velocity.theta_1' and model.output_units[nv] == 'rad/s'
    names = [name.split('.')[1] for name in model.states[:3]]
    own = [simulation.joint_names.index(name) for name in names]

    def outputs(change):
        position, velocity = q.copy(), qd.copy()
        position[own] += change[:3]
        velocity[own] += change[3:]
        simulation.set_state(position, velocity, hold=names)
        return np.concatenate((
            simulation.position, simulation.velocity, simulation.acceleration))

    simulation.step({'theta_1': 0.0}, 0.0)
    step = 1e-3
    expected = np.stack([
        (8.0 * (outputs(step * unit) - outputs(-step * unit)) - outputs(2.0 * step * unit)
         + outputs(-2.0 * step * unit)) / (12.0 * step) for unit in np.eye(6)], axis=1)
    np.testing.assert_allclose(model.C, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    # Accelerations of outputs and of states are the same.
    np.testing.assert_allclose(model.C[2 * nv:][own], model.A[3:], rtol=1e-12)
    np.testing.assert_allclose(model.D[2 * nv:][own], model.B[3:], rtol=1e-12)


def test_a_parallelogram_is_a_pendulum(tmp_path):
    simulation = parallelogram(tmp_path)
    linearisation = Linearisation(simulation)
    found = linearisation.equilibrium()
    # Two cranks of 1 kg whose centres are half way, a bar of 1 kg that only moves along a circle.
    inertia = 2.0 * (0.02 + 0.25 ** 2) + 0.5 ** 2
    stiffness = 9.81 * (2.0 * 0.25 + 0.5)
    assert found.position[0] == pytest.approx(-math.pi / 2.0, abs=1e-9)
    assert found.stable is None and found.torque == {'a': 0.0}
    mode, = linearisation.modes(found.position)
    assert mode.frequency == pytest.approx(
        math.sqrt(stiffness / inertia) / (2.0 * math.pi), rel=1e-12)
    assert mode.damping == 0.0
    np.testing.assert_allclose(mode.shape, (1.0, -1.0, 1.0), atol=1e-12)
    # By virtual work: what holds it.
    held = linearisation.static_torque()
    assert held['a'] == pytest.approx(stiffness * math.cos(0.7), rel=1e-12)
    # Upright it falls.
    upright = linearisation.modes(np.array((math.pi / 2.0, -math.pi / 2.0, math.pi / 2.0)))[0]
    assert upright.frequency == 0.0 and upright.damping == -1.0
    assert upright.eigenvalue.real == pytest.approx(math.sqrt(stiffness / inertia), rel=1e-12)
    standing = linearisation.equilibrium(
        position=np.array((math.pi / 2.0, -math.pi / 2.0, math.pi / 2.0)))
    assert standing.stable is False


def test_damping_is_that_of_one_degree_of_freedom(tmp_path):
    simulation = parallelogram(tmp_path, {'damper': JointDamping('c', 0.3)})
    linearisation = Linearisation(simulation)
    found = linearisation.equilibrium()
    assert found.stable is True and found.growth < 0.0
    mode, = linearisation.modes(found.position)
    inertia, stiffness = 2.0 * (0.02 + 0.25 ** 2) + 0.5 ** 2, 9.81
    assert mode.damping == pytest.approx(0.3 / (2.0 * math.sqrt(stiffness * inertia)), rel=1e-9)
    assert abs(mode.eigenvalue) == pytest.approx(math.sqrt(stiffness / inertia), rel=1e-9)


def test_a_spring_balanced_parallelogram_has_frequency_zero(tmp_path):
    # A spring of no free length from above the pivot: its energy and gravity's add up to a
    # constant. k h r = g (sum of moments).
    height, radius = 0.8, 0.4
    stiffness = 9.81 / (height * radius)
    simulation = parallelogram(
        tmp_path, {'spring': PointSpring('hook', None, (0.0, height), stiffness)},
        f'points: {{hook: {{body: left, position: [{radius}, 0.0]}}}}\n')
    linearisation = Linearisation(simulation)
    assert linearisation.static_torque()['a'] == pytest.approx(0.0, abs=1e-12)
    mode, = linearisation.modes()
    assert mode.frequency == 0.0 and math.isnan(mode.damping)
    assert linearisation.equilibrium().stable is None


@pytest.mark.slow
def test_a_threefold_stewart_platform_has_two_pairs_of_equal_frequencies():
    legs = load_scene('stewart_platform').mechanism.actuated_joints
    simulation = simulation_of(
        'stewart_platform', {f'spring_{leg}': JointSpring(leg, 2e4, 0.0) for leg in legs})
    linearisation = Linearisation(simulation)
    modes = linearisation.modes()
    frequencies = np.array([mode.frequency for mode in modes])
    assert len(modes) == 6 and frequencies.min() > 0.0
    gaps = np.diff(frequencies) / frequencies[1:]
    assert (gaps < 1e-7).sum() == 2 and (gaps > 1e-3).sum() == 3


@pytest.mark.parametrize('scene', ('three_rrr_vertical', 'rssr_four_bar'))
def test_a_model_is_linearised_in_any_state(scene):
    simulation = simulation_of(scene, **ACCURATE)
    model, linearisation = Model.from_scene(scene), Linearisation(simulation)
    torque = dict.fromkeys(simulation.actuated_joints[:1], 0.5)
    for _ in range(2):
        simulation.step(torque, 0.05)
        state = simulation.snapshot()
        for found, expected in (
                (model.linearise(state, torque, outputs=('velocity',)),
                 linearisation.linear_model(torque=torque, outputs=('velocity',))),
                (model.linearise(state, torque, period=0.01),
                 linearisation.discrete_model(0.01, torque=torque))):
            assert (found.states, found.inputs, found.outputs, found.period) == (
                expected.states, expected.inputs, expected.outputs, expected.period)
            for name in 'ABCD':
                exact = getattr(expected, name)
                np.testing.assert_allclose(getattr(found, name), exact, rtol=0, atol=1e-10 * max(
                    1.0, np.abs(exact).max(initial=0.0)))
        # Evaluations are not disturbed.
        np.testing.assert_allclose(model.evaluate(state, torque).acceleration,
                                   simulation.forward_dynamics(state.q, state.qd, torque)[0],
                                   rtol=1e-9, atol=1e-9)


def test_the_flow_of_a_fast_motion_in_space_keeps_its_loops_closed():
    model = Model.from_scene('stewart_platform')
    simulation = Simulation(model, None, 'rk4')
    torque = 100.0 * np.random.default_rng(0).normal(size=6)
    simulation.step(torque, 0.1)
    found = Linearisation(simulation).discrete_model(0.02, torque=torque)
    by_steps = model.linearise(simulation.snapshot(), torque, period=0.02)
    for name in 'AB':
        exact = getattr(by_steps, name)
        np.testing.assert_allclose(getattr(found, name), exact, rtol=0,
                                   atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize('scene, period', [
    ('three_rrr_vertical', 0.02), ('carpet_scraper', 0.05), ('rssr_four_bar', 1e-3)])
def test_models_of_a_period_are_of_the_motion_not_of_few_steps(scene, period, monkeypatch):
    model = Model.from_scene(scene)
    simulation = Simulation(model, None, 'rk4')
    for _ in range(3):
        simulation.step(duration=0.02)
        state = simulation.snapshot()
        expected = Linearisation(simulation).discrete_model(period)
        with monkeypatch.context() as patch:
            # It is made by steps.
            patch.setattr(Linearisation, 'discrete_model', None)
            found = model.linearise(state, period=period)
        for name in 'ABCD':
            exact = getattr(expected, name)
            np.testing.assert_allclose(getattr(found, name), exact, rtol=0, atol=1e-9 * max(
                1.0, np.abs(exact).max(initial=0.0)))
    assert model.linearise(state, period=2.0 * period).period == 2.0 * period
    with pytest.raises(ValueError, match='period: expected a finite number > 0'):
        model.linearise(state, period=-1.0)


def test_batches_and_choices_that_do_not_do_are_refused_by_a_model():
    model = Model.from_scene('four_bar')
    state = model.assemble()
    assert model.linearise(state, independent=('rocker_joint',)).states == (
        'position.rocker_joint', 'velocity.rocker_joint')
    assert model.linearise(state).states[0] == 'position.crank_joint'
    with pytest.raises(ValueError, match='state: expected one state, got a batch of 2'):
        model.linearise(type(state).stack([state, state]))
    with pytest.raises(ValueError, match='independent: expected names of'):
        model.linearise(state, independent=('elbow',))
    with pytest.raises(SimulationError, match='effects.rope'):
        Model.from_scene('rope_hoist').linearise(Model.from_scene('rope_hoist').assemble())


@pytest.mark.parametrize('scene, joint', (
    ('four_bar', 'crank_joint'), ('slider_crank', 'crank_joint')))
def test_linkages_of_one_degree_follow_virtual_power(scene, joint):
    simulation = simulation_of(scene)
    model, linearisation = Model.from_scene(scene), Linearisation(simulation)
    step = 1e-3

    def slopes(place):
        """Return first and second derivative of the potential along the branch."""
        state = model.solve({joint: place + step * np.arange(-3, 4)})
        height = model.evaluate(state).stored_energy
        first = (height[4:] - height[2::-1]) @ np.array((3 / 4, -3 / 20, 1 / 60)) / step
        second = ((height[4:] + height[2::-1] - 2.0 * height[3]) @ np.array(
            (3 / 2, -3 / 20, 1 / 90)) / step ** 2)
        return state[3], first, second

    state, first, _ = slopes(simulation.position[0])
    held = linearisation.static_torque(state.q)
    assert held[joint] == pytest.approx(first, rel=1e-8)
    rest = linearisation.equilibrium()
    state, first, second = slopes(rest.position[0])
    assert abs(first) < 1e-8 * abs(held[joint]) + 1e-9
    # A rate of one: twice the kinetic energy is the inertia about the joint.
    moving = model.assemble(state.q, _rates(model, state, joint), hold=[joint])
    inertia = 2.0 * model.evaluate(moving).kinetic_energy
    mode, = linearisation.modes(rest.position)
    assert mode.frequency == pytest.approx(
        math.sqrt(second / inertia) / (2.0 * math.pi), rel=1e-6)


def _rates(model, state, joint):
    """Return rates that close the loops with a rate of one in a joint."""
    jacobian, own = model.constraint_jacobian(state), model.joint_names.index(joint)
    rest = np.setdiff1d(np.arange(len(state.qd)), own)
    rates = np.ones(len(state.qd))
    rates[rest] = -np.linalg.solve(jacobian[:, rest], jacobian[:, own])
    return rates


def test_independent_coordinates_may_be_chosen(tmp_path):
    simulation = parallelogram(tmp_path)
    model = Linearisation(simulation, ('c',)).linear_model(torque={'a': 1.0})
    assert model.states == ('position.c', 'velocity.c') and model.inputs == ('a',)
    assert model.state_units == ('rad', 'rad/s') and model.input_units == ('N m',)
    with pytest.raises(ValueError, match="independent: expected names of a, b, c, got 'd'"):
        Linearisation(simulation, ('d',))
    with pytest.raises(ValueError, match='independent: expected 1 names'):
        Linearisation(simulation, ('a', 'c')).linear_model()


def test_units_of_slides_are_metres():
    model = Linearisation(simulation_of('slider_crank')).linear_model()
    assert dict(zip(model.outputs, model.output_units)) == {
        'position.crank_joint': 'rad', 'position.rod_joint': 'rad', 'position.slider_joint': 'm'}


def test_what_makes_no_sense_is_refused(tmp_path):
    linearisation = Linearisation(parallelogram(tmp_path))
    with pytest.raises(ValueError, match="outputs: expected some of position, .* got 'force'"):
        linearisation.linear_model(outputs=('force',))
    with pytest.raises(ValueError, match='period: expected a finite number > 0'):
        linearisation.discrete_model(0.0)
    with pytest.raises(SimulationError, match='Modes are those of a position at rest'):
        linearisation.modes(torque={'a': 0.0})
    with pytest.raises(SingularityError):
        linearisation.linear_model(np.zeros(3), np.zeros(3))


def test_python_control_takes_it(tmp_path):
    control = pytest.importorskip('control', reason='needs python-control')
    linearisation = Linearisation(parallelogram(tmp_path))
    model = linearisation.linear_model(torque=linearisation.static_torque())
    system = model.to_control()
    assert isinstance(system, control.StateSpace) and system.isctime()
    assert system.state_labels == ['position:a', 'velocity:a'] and system.input_labels == ['a']
    np.testing.assert_array_equal(system.A, model.A)
    assert linearisation.discrete_model(0.01).to_control().dt == 0.01


def test_the_command_prints_modes(capsys):
    text = done(capsys, 'modes', 'four_bar')
    assert 'equilibrium: not decided' in text and 'frequency [Hz]' in text
    assert main(['modes', 'four_bar', '--hold-start']) == 0
    assert 'crank_joint 0.289637' in capsys.readouterr().out
    assert main(['modes', 'four_bar', '--hold-start', '--torque', 'crank_joint=1']) == 2
    assert 'expected none with --hold-start' in capsys.readouterr().err
    assert main(['modes', 'rope_hoist']) == 1
    assert 'effects.rope' in capsys.readouterr().err


@pytest.mark.parametrize('scene', ('three_rrr_vertical', 'carpet_scraper'))
def test_a_mode_goes_on_by_itself(scene):
    scene = load_scene(scene)
    simulation = Simulation.from_scene(scene)
    linearisation, model = Linearisation(simulation), Model(scene)
    rest = linearisation.equilibrium()
    lowest = model.evaluate(model.state(rest.position)).energy
    for mode in linearisation.modes(rest.position, rest.torque):
        motion = mode_motion(linearisation, mode, rest.position, 1e-3, 2, 20)
        assert motion.time[20] == pytest.approx(1.0 / mode.frequency) and len(motion.time) == 41
        found = model.evaluate(model.state(motion.position, motion.velocity))
        assert found.closure.max() < 1e-9
        energy = found.energy - lowest
        assert np.ptp(energy) < 0.01 * energy.mean()
        # From the largest deflection, at rest, a run follows it.
        run = Simulation(model, model.state(motion.position[0], motion.velocity[0]),
                         {'integrator': 'dop853', 'tolerance': 1e-10})
        run.step(None, motion.time[5])
        np.testing.assert_allclose(run.position, motion.position[5], rtol=0, atol=2e-5)


def test_the_command_draws_modes_and_writes_their_motion(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(['modes', 'four_bar', '--hold-start', '--picture', 'modes.png', '--output',
                 'mode.csv', '--amplitude', '0.1']) == 0
    assert 'mode 1: mode.csv' in capsys.readouterr().out
    assert (tmp_path / 'modes.png').read_bytes().startswith(b'\x89PNG')
    motion, scene = read_rows(tmp_path / 'mode.csv')
    assert np.abs(Model(scene).assemble().q - motion.position[0]).max() < 1e-9
    ends = motion.position[[0, 20]]
    middle = Simulation.from_scene('four_bar').position
    largest = np.abs(ends - middle).max(axis=1)
    np.testing.assert_allclose(largest, 0.1, rtol=0.2)
    assert main(['view', 'mode.csv', '--save', 'mode.html']) == 0
    for arguments, message in (
            (['--mode', '2', '--output', 'two.csv'], '--mode: expected a number from 1 to 1'),
            (['--mode', '1'], '--mode: expected it with --output'),
            (['--amplitude', '1'], '--amplitude: expected it with'),
            (['--output', 'mode.csv'], 'mode.csv exists')):
        capsys.readouterr()
        assert main(['modes', 'four_bar', *arguments]) == 2
        assert message in capsys.readouterr().err
    assert main(['modes', 'four_bar', '--output', 'far.csv', '--amplitude', '3']) == 1
    assert 'The loops cannot be closed that far' in capsys.readouterr().err
    assert not (tmp_path / 'far.csv').exists()
