# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""C that is written for a scene: the same run, its faults, CasADi, and what is refused."""

import ctypes
from dataclasses import replace
import math
from pathlib import Path
import re
import runpy
import shutil
import subprocess

from closedloop_dynamics import (
    c_source, Differentiator, load_scene, Model, Simulation, SimulationError, Stepper)
from closedloop_dynamics.cli import main
from closedloop_dynamics.codegen.c_writer import SINE_AND_COSINE, VECTORS
from closedloop_dynamics.effects.registry import (
    ExternalForce, JointDamping, JointSpring, Law, Payload, PointSpring)
from closedloop_dynamics.export.c_run import error_of_float32, step_cost
from closedloop_dynamics.export.c_source import c_cost
from closedloop_dynamics.mechanism.rotations import of_quaternion
from closedloop_dynamics.simulation.independent import choose_independent
import numpy as np
import pytest

from ..simulation.test_derivatives import (
    BALL, BALL_SCENE, IN_PLANE, IN_SPACE, PARALLELOGRAM, PARALLELOGRAM_SCENE, PRESS, PRESS_SCENE)
from ..test_cli import done

ROOT = Path(__file__).resolve().parents[2]
compiled = pytest.mark.skipif(
    shutil.which('cc') is None, reason='needs a C compiler, called cc, to compile what is written')
STRICT = ('-std=c99', '-O0', '-Wall', '-Wextra', '-Wpedantic', '-Werror')
# Arithmetic of more digits than doubles have, as compilers use by default on old processors.
X87 = ('-std=gnu99', '-mfpmath=387')
# Of a tree with a spring in it, in the plane: no loop, no multiplier.
PENDULUM = """\
name: pendulum
bodies: {rod: {mass: 1.5, center_of_mass: [0.3, 0.0], inertia: 0.02}}
joints: {pin: {type: revolute, parent: ground, child: rod, position: [0.0, 0.0], actuated: true}}
points: {tip: {body: rod, position: [0.6, 0.0]}}
"""
PENDULUM_SCENE = """\
mechanism: ./pendulum.yaml
initial: {position: {pin: 0.4}}
effects: {gravity: {type: gravity, acceleration: [0.0, -9.81]}}
"""
MECHANISMS = {'pendulum': PENDULUM, 'ball': BALL, 'press': PRESS}
SCENES = {'pendulum': PENDULUM_SCENE, 'ball': BALL_SCENE, 'press': PRESS_SCENE}


def simulation_of(scene, effects=()):
    scene = load_scene(scene)
    scene = replace(scene, effects={**scene.effects, **dict(effects)}, method=replace(
        scene.method, integrator='rk4', step_size=1e-3, stabilisation='projection'))
    return Simulation.from_scene(scene)


def build(folder, simulation, *options, name='model', derivatives=False, compiler='gnu',
          command='cc', float32=False):
    source, header = c_source(simulation, name, derivatives, float32)
    if compiler == 'plain':
        # As one that knows no vectors reads it.
        assert 'defined(__GNUC__)' in source
        source = source.replace('defined(__GNUC__)', '0')
    (folder / f'{name}.c').write_text(source)
    (folder / f'{name}.h').write_text(header)
    out = folder / (f'{name}.so' if '-shared' in options else name)
    # The standard of C is not an option of a compiler of C++.
    strict = STRICT[1:] if command == 'c++' else STRICT
    subprocess.run(
        (command, *strict, *options, '-o', out, folder / f'{name}.c', '-lm'), check=True)
    return out


def links(folder, *options, command='cc'):
    """Return whether a program can be made with some options."""
    (folder / 'nothing.c').write_text('#include <math.h>\nint main(void) {return 0;}\n')
    return not subprocess.run(
        (command, *options, '-o', folder / 'nothing', folder / 'nothing.c', '-lm'),
        check=False, capture_output=True).returncode


def run(program, steps, tau, every=50, emulator=()):
    text = subprocess.run(
        (*emulator, program, str(steps), '0.001', str(every), *map(repr, tau.tolist())),
        check=True, capture_output=True, text=True).stdout
    return np.array([line.split() for line in text.splitlines()], dtype=float)


def torques(simulation, size=0.2):
    rng = np.random.default_rng(3)
    return dict(zip(simulation.actuated_joints,
                    size * rng.normal(size=len(simulation.actuated_joints))))


def require_same_run(folder, simulation, steps=200, every=50, growth=1.0):
    """
    Compare coordinates, rates and energy of a run with those of the compiled one.

    ``growth``: of roundings, in the place of that of motions without impacts.
    """
    command, nq = torques(simulation), len(simulation.position)
    rows = run(build(folder, simulation, '-DMODEL_MAIN'), steps,
               simulation.joint_torques(command), every)
    assert len(rows) == steps // every + 1
    start = simulation.position
    for number, row in enumerate(rows):
        if number:
            simulation.step(command, every * 1e-3)
        assert row[0] == pytest.approx(simulation.time, abs=1e-12)
        np.testing.assert_allclose(row[1:1 + nq], simulation.position, rtol=0, atol=2e-13 * growth)
        scale = growth * (1.0 + np.abs(simulation.velocity).max())
        np.testing.assert_allclose(row[1 + nq:-3], simulation.velocity, rtol=0,
                                   atol=2e-12 * scale)
        assert row[-3:].sum() == pytest.approx(simulation.energy, rel=1e-11, abs=1e-11)
    # It has moved.
    assert np.abs(simulation.position - start).max() > 1e-3


@compiled
@pytest.mark.parametrize('scene', (
    'slider_crank', 'bricard',
    *(pytest.param(name, marks=pytest.mark.slow) for name in (
        'carpet_scraper', 'rssr_four_bar',
        'three_rrr_vertical', 'scissor_lift', 'double_wishbone'))))
def test_a_run_is_reproduced(scene, tmp_path):
    require_same_run(tmp_path, simulation_of(scene))


@compiled
@pytest.mark.parametrize('compiler, options, scene', (
    ('plain', (), 'three_rrr_vertical'),
    pytest.param('gnu', ('-O1',), 'stewart_platform', marks=pytest.mark.slow)))
def test_versions_for_all_processors_agree(compiler, options, scene, tmp_path):
    # The former knows no vectors; the latter chooses among three versions as it runs.
    simulation = simulation_of(scene)
    library = ctypes.CDLL(str(build(
        tmp_path, simulation, '-shared', '-fPIC', *options, compiler=compiler)))
    found = [np.zeros_like(simulation.velocity), np.zeros_like(simulation.multipliers)]
    assert library.model_evaluate(
        ctypes.byref(ctypes.c_char.in_dll(library, 'model_default')),
        *(ctypes.c_void_p(one.ctypes.data) for one in (
            simulation.position, simulation.velocity, np.zeros_like(simulation.velocity),
            *found))) == 0
    for one, expected in zip(found, (simulation.acceleration, simulation.multipliers)):
        np.testing.assert_allclose(one, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@compiled
@pytest.mark.parametrize('scene, size, options', (
    ('three_rrr_vertical', (), ()), ('three_rrr_vertical', (), ('-O2',)),
    ('slider_crank', ('-m32',), ()), ('rssr_four_bar', ('-m32',), ('-O2',))))
def test_numbers_of_more_digits_change_nothing(scene, size, options, tmp_path):
    if not links(tmp_path, *X87, *size):
        pytest.skip(f'the C compiler cannot link with {" ".join((*X87, *size))}; for -m32 it '
                    'takes the package gcc-multilib')
    simulation = simulation_of(scene)
    command = torques(simulation)
    rows = run(build(tmp_path, simulation, '-DMODEL_MAIN', *X87, *size, *options), 100,
               simulation.joint_torques(command), 100)
    simulation.step(command, 0.1)
    nq = len(simulation.position)
    np.testing.assert_allclose(rows[-1, 1:1 + nq], simulation.position, rtol=0, atol=2e-13)


# Compilers and emulators of other processors, from Debian: packages gcc-arm-linux-gnueabihf,
# gcc-arm-linux-gnueabi and qemu-user.
ARM_HARD, ARM_SOFT = 'arm-linux-gnueabihf-gcc', 'arm-linux-gnueabi-gcc'


@compiled
@pytest.mark.parametrize('float32', (False, True))
@pytest.mark.parametrize('command, options, emulator', (
    ('cc', (), ()), ('cc', ('-m32',), ()),
    (ARM_HARD, ('-static', '-mfpu=neon-vfpv4'), ('qemu-arm',)),
    (ARM_SOFT, ('-static', '-mfloat-abi=soft'), ('qemu-arm',))))
@pytest.mark.parametrize('scene', (
    'three_rrr_vertical', pytest.param('rssr_four_bar', marks=pytest.mark.slow)))
def test_other_processors_and_single_precision_make_the_same_run(
        scene, command, options, emulator, float32, tmp_path):
    if any(shutil.which(one) is None for one in (command, *emulator)) or not links(
            tmp_path, *options, command=command):
        pytest.skip(f'needs {" ".join((command, *options, *emulator))}')
    simulation = simulation_of(scene)
    tau, nq = torques(simulation), len(simulation.position)
    rows = run(build(tmp_path, simulation, '-DMODEL_MAIN', '-O2', *options, command=command,
                     float32=float32), 100, simulation.joint_torques(tau), 50, emulator)
    for row in rows[1:]:
        simulation.step(tau, 0.05)
        # Of single precision, 100 roundings of coordinates of some radians.
        np.testing.assert_allclose(row[1:1 + nq], simulation.position, rtol=0,
                                   atol=5e-5 if float32 else 2e-13)
    # Read from memory, where x87 has rounded them.
    states = rows[:, 1:1 + nq]
    assert np.array_equal(np.float32(states), states) == float32


@compiled
@pytest.mark.parametrize('float32', (False, True))
@pytest.mark.parametrize('scene', (
    'four_bar', 'three_rrr', pytest.param('rssr_four_bar', marks=pytest.mark.slow)))
def test_cost_bounds_what_a_compiler_takes(scene, float32, tmp_path):
    simulation = simulation_of(scene)
    cost = c_cost(simulation, True, float32)
    for level in ('-O0', '-O1'):
        build(tmp_path, simulation, level, '-shared', '-fPIC', '-fstack-usage',
              '-DMODEL_ONE_VERSION', derivatives=True, float32=float32)
        report, = tmp_path.glob('*.su')
        used = {}
        for line in report.read_text().splitlines():
            place, size, _ = line.split('\t')
            used[re.sub(r'\..*', '', place.split(':')[-1])] = int(size)
        evaluation = 'evaluation', 'evaluation_any', 'evaluation_next_to_singular_arms_any'
        chains = {
            'evaluate': ('model_evaluate', *evaluation),
            'step': ('model_step', 'advance', 'close_loops', 'correction', 'correction_any'),
            'step_cost': (
                'model_step_cost', 'advance', 'slope_at', *evaluation),
            'assemble': ('model_assemble', 'close_around', 'model_closure', 'closures_of'),
            'operational_space': ('model_operational_space', *evaluation),
            'linearise': ('model_linearise', 'derivatives_of', 'columns_of_any')}
        for function, chain in chains.items():
            # What is not listed has become part of its caller.
            taken = sum(used.get(one, 0) for one in chain)
            assert taken <= cost.stack[function]
            # Without optimisation it is not a rough bound: frames are short beside long functions.
            if level == '-O0' and function == 'evaluate' and not float32 and scene != 'four_bar':
                assert taken > 0.7 * cost.stack[function]


def test_cost_counts_the_operations_of_the_source():
    simulation = simulation_of('slider_crank')
    cost, (source, header) = c_cost(simulation), c_source(simulation, 'model')
    # What does the same next to singular positions of arms is among the most.
    bodies = [source.partition(f'VERSION({name})(\n')[2].partition('\n}\n')[0] for name in (
        'evaluation', 'evaluation_next_to_singular_arms')]
    # One operation a line: between operands, a sign, a quotient by name, or a root.
    lines = [line for body in bodies for line in body.splitlines() if re.search(
        r'= (?:\S+ [-+*/] \S+|-v\d+|sqrt\(.*\));', line)]
    assert cost.operations['evaluation'] == len(lines)
    assert cost.of_step(cost.operations) == 4 * len(lines) + 9 * cost.operations['correction']
    assert str(cost.of_step(cost.operations)) in header and 'MOST = 8' in source


def test_commands_tell_what_the_code_costs(tmp_path, capsys):
    checked = done(capsys, 'check', 'four_bar', '--c')
    costs = list(c_cost(Simulation.from_scene('four_bar')).lines())
    assert all(line in checked for line in costs)
    reported = done(capsys, 'export', 'four_bar', '--output', tmp_path / 'four_bar.c')
    assert all(line in reported for line in costs) and 'steps of 0.001 s: in 1 s' in reported
    assert 'single precision' not in reported
    assert main(['export', 'four_bar', '--output', str(tmp_path / 'a.fmu'), '--float32']) == 2
    assert '--float32: expected it with an output that ends with .c' in capsys.readouterr().err
    assert main(['check', 'cam_follower', '--c']) == 1
    assert 'effects.outline' in capsys.readouterr().err


def test_what_a_step_size_costs_falls_with_the_order_of_the_method():
    coarse, fine = (step_cost(Simulation.from_scene(
        'three_rrr_vertical', integrator='rk4', step_size=size)) for size in (4e-3, 2e-3))
    assert fine.duration == 2.0 and coarse.duration == 4.0
    # A fourth-order method: 16 times less, over half the duration.
    assert 0.0 < fine.apart < coarse.apart / 8.0 and 0.0 < fine.energy < coarse.energy / 8.0


@compiled
@pytest.mark.parametrize('scene, size, effects', (
    ('three_rrr', 8e-3, IN_PLANE), ('rssr_four_bar', 2e-3, IN_SPACE), ('ball', 8e-3, {}),
    pytest.param('stewart_platform', 8e-3, {}, marks=pytest.mark.slow)))
# Of the package's own run.
@pytest.mark.filterwarnings('ignore::closedloop_dynamics.mechanism.errors.InaccuracyWarning')
def test_a_step_tells_its_energy_balance_and_what_half_of_it_changes(
        scene, size, effects, tmp_path):
    if scene == 'ball':
        (tmp_path / 'ball.yaml').write_text(BALL)
        scene = tmp_path / 'scene.yaml'
        scene.write_text(BALL_SCENE)
    whole, half = (Simulation(replace(one.scene, method=replace(
        one.scene.method, step_size=share * size))) for one, share in (
            (simulation_of(scene, effects), 1.0), (simulation_of(scene, effects), 0.5)))
    call, _ = library_of(tmp_path, whole)
    # In every joint, whether it is actuated or not.
    assert whole.torque_names == whole.joint_names
    tau = np.random.default_rng(3).normal(size=len(whole.torque_names))
    state = np.concatenate((whole.position, whole.velocity))
    start, cost, sums = whole.energy_balance, np.zeros(7), np.zeros(7)
    for _ in range(30):
        half.restore(whole.state, whole.time)
        whole.advance(tau, 1)
        half.advance(tau, 2)
        assert call('step_cost', state, tau, size, cost) == 0
        sums += cost
        np.testing.assert_allclose(cost[:2], [
            np.abs(whole.coordinates.apart(whole.position, half.position)).max(),
            np.abs(whole.velocity - half.velocity).max()], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(state, [*whole.position, *whole.velocity], rtol=0, atol=1e-9)
    end = whole.energy_balance
    np.testing.assert_allclose(
        [cost[2], *sums[3:]],
        [end.kinetic, end.stored - start.stored, end.dissipated, end.work, end.residual],
        rtol=1e-6, atol=1e-12 * start.stored)
    assert abs(end.residual) > 1e-10 * start.stored and abs(end.work) > 1e-3
    assert not effects or end.dissipated > 1e-3


@compiled
@pytest.mark.parametrize('scene, effects', (
    ('three_rrr_vertical', {}), ('rssr_four_bar', IN_SPACE)))
def test_a_run_in_c_misses_as_much_energy_as_the_package_tells(scene, effects, tmp_path):
    scene = simulation_of(scene, effects).scene
    simulation = Simulation(replace(scene, method=replace(scene.method, step_size=4e-3)))
    call, _ = library_of(tmp_path, simulation)
    state = np.concatenate((simulation.position, simulation.velocity))
    tau, cost, residuals, kinetic = np.zeros(len(simulation.velocity)), np.zeros(7), [], []
    for _ in range(1000):
        assert call('step_cost', state, tau, simulation.step_size, cost) == 0
        residuals.append(cost[-1])
        kinetic.append(cost[2])
    found = np.abs(np.cumsum(residuals)[9::10]).max() / max(kinetic[9::10])
    assert found == pytest.approx(step_cost(simulation).energy, rel=1e-4)


@compiled
def test_the_error_of_single_precision_is_one_of_rounding():
    error = error_of_float32(Simulation.from_scene('four_bar', integrator='rk4', step_size=1e-3))
    # Above one rounding of an angle, below 1,000 that all add up with the motion's growth.
    assert 1e-7 < error < 1e-2


def library_of(folder, simulation, derivatives=False, options=(), command='cc'):
    """Return functions of the compiled library, of arrays and numbers."""
    library = ctypes.CDLL(str(build(
        folder, simulation, '-O1', '-shared', '-fPIC', *options, derivatives=derivatives,
        command=command)))
    model = ctypes.byref(ctypes.c_char.in_dll(library, 'model_default'))

    def call(name, *values):
        return getattr(library, f'model_{name}')(model, *(
            ctypes.c_double(one) if isinstance(one, float) else
            one if isinstance(one, int) else
            ctypes.c_void_p(one.ctypes.data) for one in values))

    names = simulation.joint_names
    places = list(iter(lambda found=iter((ctypes.c_int * 50).in_dll(
        library, 'model_independent')): next(found), -1))
    return call, tuple(names[place] for place in places)


@compiled
@pytest.mark.parametrize('scene', (
    'three_rrr_vertical', 'rssr_four_bar',
    pytest.param('stewart_platform', marks=pytest.mark.slow)))
def test_assembly_keeps_the_independent_coordinates(scene, tmp_path):
    simulation = simulation_of(scene)
    call, independent = library_of(tmp_path, simulation)
    model = Model.from_scene(scene)
    simulation.step(torques(simulation), 0.05)
    start = simulation.snapshot()
    own = [simulation.joint_names.index(name) for name in independent]
    rng = np.random.default_rng(4)
    change = np.zeros(len(start.qd))
    change[own] = 0.02 * rng.normal(size=len(own))
    opened = start.coordinates.moved(start.q, change)
    state = np.concatenate((opened, start.qd))
    assert call('assemble', state) == 0
    q, qd = state[:len(opened)], state[len(opened):]
    # It closes the loops, or this refuses it.
    model.state(q, qd)
    # Around the independent ones, which stay; rotations are coordinates to first order alone.
    turns = model.coordinates.place < 0
    moved = np.abs(start.coordinates.apart(q, opened))[own]
    assert (moved <= np.where(turns[own], 1e-3, 1e-13)).all()
    np.testing.assert_allclose(qd[own], start.qd[own], rtol=1e-14)
    assert np.abs(q - opened).max() > 1e-4
    # What no Newton's method reaches is reported, and left alone.
    state[:len(q)], state[len(q):] = math.nan, 1.0
    assert call('assemble', state) in (1, 2)
    assert (state[len(q):] == 1.0).all()


@compiled
@pytest.mark.parametrize('scene', (
    'three_rrr_vertical', pytest.param('stewart_platform', marks=pytest.mark.slow)))
def test_computed_torque_is_that_of_the_package(scene, tmp_path):
    simulation = simulation_of(scene)
    call, independent = library_of(tmp_path, simulation)
    model, rng = Model.from_scene(scene), np.random.default_rng(4)
    simulation.step(torques(simulation), 0.05)
    state = simulation.snapshot()
    own = [simulation.joint_names.index(name) for name in independent]
    wanted, tau = rng.normal(size=len(own)), np.zeros(len(state.qd))
    assert call('inverse', np.concatenate((state.q, state.qd)), wanted, tau) == 0
    expected = model.reduce(state, independent=independent).inverse(wanted)
    driven = [simulation.joint_names.index(name) for name in simulation.actuated_joints]
    np.testing.assert_allclose(tau[driven], expected, rtol=1e-8, atol=1e-8)
    acceleration = model.evaluate(state, expected).acceleration
    np.testing.assert_allclose(acceleration[own], wanted, rtol=0, atol=1e-7)


def table_of(names, chosen):
    return np.array([*(names.index(name) for name in chosen), -1], dtype=np.intc)


@compiled
@pytest.mark.parametrize('scene, command, options', (
    ('four_bar', 'cc', ()), ('three_rrr_vertical', 'c++', ('-std=c++20', '-x', 'c++')),
    ('stewart_platform', 'cc', ('-O0',))))
def test_control_by_drives_is_that_of_the_package(scene, command, options, tmp_path):
    if shutil.which(command) is None:
        pytest.skip(f'needs a compiler called {command}')
    simulation = simulation_of(scene)
    call, independent = library_of(tmp_path, simulation, options=options, command=command)
    names, n = simulation.joint_names, len(independent)
    model, rng, wanted = Model.from_scene(scene), np.random.default_rng(4), simulation.snapshot()
    simulation.step(torques(simulation), 0.05)
    state = simulation.snapshot()
    both, one = np.concatenate((state.q, state.qd)), model.reduce(state, independent=independent)
    points, (count, size) = model.mechanism.points, simulation.points.shape

    def require_equal(found, expected):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())

    # By the drives, and by other freedoms, of which the drives are functions.
    others = [place for place, name in enumerate(names) if name not in independent]
    others = tuple(names[place] for place in choose_independent(
        simulation.constraint_jacobian, others))
    assert not set(others) & set(independent)
    for chosen, expected in (
            (simulation.actuated_joints,
             [one.jacobian(point.name, 'actuated') for point in points]),
            (others, [model.reduce(state, independent=others).jacobian(point.name)
                      for point in points])):
        found = np.zeros((count, size, n))
        assert call('jacobian', state.q, table_of(names, chosen), found) == 0
        require_equal(found, np.array(expected))
    assert call('jacobian', state.q, table_of(names, names), found) == 1

    accelerations, ud = np.zeros((count, size)), rng.normal(size=n)
    call('accelerations', state.q, state.qd, one.basis @ ud + one.drift, accelerations)
    for place, point in enumerate(points):
        jac, drift = one.motion(point.name)
        require_equal(accelerations[place], jac @ ud + drift)
        inertia, bias = np.full((size, size), math.nan), np.full(size, math.nan)
        status = call('operational_space', both, place, inertia, bias)
        if np.linalg.matrix_rank(jac) < size:
            assert status == 1 and np.isnan(inertia).all() and np.isnan(bias).all()
        else:
            assert status == 0
            for found, expected in zip((inertia, bias), one.operational_space(point.name)):
                require_equal(found, expected)

    driven, tau = list(map(names.index, simulation.actuated_joints)), np.ones(len(names))
    assert call('gravity_compensation', both, tau) == 0
    require_equal(tau[driven], one.gravity_compensation())
    assert np.count_nonzero(tau) == np.count_nonzero(tau[driven])
    stiffness, damping = rng.uniform(10.0, 90.0, (2, n))
    assert call('computed_torque', both, np.concatenate((wanted.q, wanted.qd)), ud, stiffness,
                damping, tau) == 0
    require_equal(tau[driven], one.computed_torque(wanted, stiffness, damping, ud))


@compiled
@pytest.mark.parametrize('angle', (0.0, 1e-10))
def test_drives_that_do_not_determine_the_motion_are_reported(angle, tmp_path):
    # A slider that drives its crank, which it cannot move at a dead centre.
    text = (ROOT / 'config' / 'mechanisms' / 'slider_crank.yaml').read_text()
    text = text.replace(', actuated: true', '').replace(
        'angle: 0.0', 'angle: 0.0, actuated: true')
    (tmp_path / 'pendulum.yaml').write_text(text)
    (tmp_path / 'scene.yaml').write_text(PENDULUM_SCENE.replace(
        '{pin: 0.4}', '{crank_joint: 0.9, rod_joint: -1.2, slider_joint: 0.35}'))
    simulation = simulation_of(tmp_path / 'scene.yaml')
    (call, _), names = library_of(tmp_path, simulation), simulation.joint_names
    assert simulation.actuated_joints == ('slider_joint',)
    state, tau, jac = np.zeros(6), np.ones(3), np.ones((2, 2, 1))
    state[:3] = angle, -angle / 3.0 - angle, 0.4
    for name, *arrays in (
            ('jacobian', table_of(names, ['slider_joint']), jac), ('inverse', np.ones(1), tau),
            ('gravity_compensation', tau),
            ('computed_torque', state + 0.1, *np.ones((3, 1)), tau)):
        assert call(name, state, *arrays) == 1
    assert (tau == 1.0).all() and (jac == 1.0).all()
    # The crank does.
    assert call('jacobian', state, table_of(names, ['crank_joint']), jac) == 0
    np.testing.assert_allclose(jac[:, :, 0], [[0.0, 0.1], [0.0, 0.0]], rtol=0, atol=1e-10)


@compiled
@pytest.mark.parametrize('scene', (
    'four_bar', 'three_rrr_vertical', pytest.param('rssr_four_bar', marks=pytest.mark.slow)))
def test_linearised_steps_are_those_of_the_package_to_the_order_of_the_method(scene, tmp_path):
    simulation = simulation_of(scene)
    call, independent = library_of(tmp_path, simulation, True)
    model, torque = Model.from_scene(scene), torques(simulation)
    simulation.step(torque, 0.1)
    start, n, na = simulation.snapshot(), len(independent), len(torque)
    errors = []
    for period in (8e-3, 4e-3):
        stepper = Stepper(model, period, steps=1, independent=independent)
        stepper.q[:], stepper.qd[:], stepper.tau[:] = start.q, start.qd, list(torque.values())
        stepper()
        a, b = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, na))
        assert call('linearise', np.concatenate((start.q, start.qd)),
                    simulation.joint_torques(torque), period, a, b) == 0
        errors.append(max(np.abs(one - exact).max() / np.abs(exact).max()
                          for one, exact in ((a, stepper.A), (b, stepper.B))))
    assert errors[0] < 1e-4 and errors[1] < errors[0] / 2 ** 3.5


@compiled
def test_a_run_with_orientations_is_reproduced(tmp_path):
    simulation = simulation_of('stewart_platform')
    assert simulation.data.system.manifold is not None
    require_same_run(tmp_path, simulation, 100)


@compiled
def test_effects_are_carried_in_the_plane(tmp_path):
    bodies = [body.name for body in load_scene('three_rrr').mechanism.bodies]
    points = [point.name for point in load_scene('three_rrr').mechanism.points]
    simulation = simulation_of('three_rrr', {
        'spring': JointSpring('theta_1', 3.0, 0.2), 'damper': JointDamping('theta_2', 0.05),
        'strut': PointSpring(points[0], None, (0.1, 0.7), 20.0, 0.3, 0.1),
        'push': ExternalForce(points[1], (0.4, -0.3), 0.05, 'body'),
        'pull': ExternalForce(points[-1], (-0.2, 0.1), 0.01),
        'own': Law({'q': '-k*atan2(q, 2)*exp(-q)', 'd': 'log(d)**k'}, joints={'q': 'theta_3'},
                   distances={'d': (points[0], (3.0, 3.0))}, parameters={'k': 3.0}),
        'tool': Payload(bodies[-1], 0.3, (0.02, 0.01), 1e-4)})
    # Later rounding decides whether an error of 1e-12 is corrected, here or there.
    require_same_run(tmp_path, simulation, 100)
    assert simulation.effect_readings('strut')['stored_energy'] > 0.0


@compiled
def test_effects_are_carried_in_space(tmp_path):
    mechanism = load_scene('rssr_four_bar').mechanism
    names = mechanism.coordinates.names
    simulation = simulation_of('rssr_four_bar', {
        'spring': JointSpring(names[0], 0.3, 0.2), 'damper': JointDamping(names[0], 0.02),
        'strut': PointSpring(mechanism.points[0].name, None, (0.1, 0.2, 0.7), 20.0, 0.3, 0.1)})
    require_same_run(tmp_path, simulation)


@compiled
@pytest.mark.parametrize('scene, effects', (('three_rrr', IN_PLANE), ('rssr_four_bar', IN_SPACE)))
def test_effects_with_corners_and_lists_of_numbers_are_carried(scene, effects, tmp_path):
    require_same_run(tmp_path, simulation_of(scene, effects))


@compiled
def test_a_spring_turns_an_orientation_as_in_the_package(tmp_path):
    (tmp_path / 'ball.yaml').write_text(BALL)
    (tmp_path / 'scene.yaml').write_text(BALL_SCENE)
    require_same_run(tmp_path, simulation_of(
        tmp_path / 'scene.yaml', {'spring': JointSpring('ball', 7.0)}))


@compiled
def test_a_stop_is_met_as_in_the_package(tmp_path):
    # The crank's torque, drawn at random, would hold the slider off the stop.
    simulation = simulation_of('slider_crank_end_stop', {
        'push': ExternalForce('wrist_pin', (5.0, 0.0))})
    # A last digit of the start moves the package's own run by up to 9e-12 at the impacts.
    require_same_run(tmp_path, simulation, 800, 100, growth=50.0)
    assert simulation.effect_readings('buffer')['dissipated_energy'] > 0.01


@compiled
def test_a_tree_without_loops_has_no_multipliers(tmp_path):
    path = tmp_path / 'swing.yaml'
    (tmp_path / 'pendulum.yaml').write_text(PENDULUM)
    path.write_text(PENDULUM_SCENE)
    require_same_run(tmp_path, simulation_of(path))


@compiled
def test_the_library_evaluates_corrects_and_reports_faults(tmp_path):
    simulation = simulation_of('four_bar')
    library = ctypes.CDLL(str(build(tmp_path, simulation, '-shared', '-fPIC')))
    model = ctypes.c_char.in_dll(library, 'model_default')
    nv, nc = len(simulation.joint_names), len(simulation.multipliers)

    def call(function, *arrays):
        return getattr(library, function)(ctypes.byref(model), *(
            ctypes.c_void_p(one.ctypes.data) for one in arrays))

    rng = np.random.default_rng(0)
    q, qd, tau = simulation.position, simulation.velocity, np.zeros(nv)
    tau[0], qdd, lam = 0.7, np.zeros(nv), np.zeros(nc)
    assert call('model_evaluate', q, qd, tau, qdd, lam) == 0
    simulation.data.system.tau[:] = tau
    simulation.data.touch()
    np.testing.assert_allclose(qdd, simulation.acceleration, rtol=1e-12)
    np.testing.assert_allclose(lam, simulation.multipliers, rtol=1e-12)
    # Bound to points by name.
    places = np.zeros_like(simulation.points)
    library.model_points(ctypes.byref(model), ctypes.c_void_p(q.ctypes.data),
                         ctypes.c_void_p(places.ctypes.data))
    np.testing.assert_allclose(places, simulation.points, atol=1e-14)
    # What is open a little is closed, what is far open is reported and left alone.
    state = np.concatenate((q + 1e-3 * rng.normal(size=nv), qd))
    assert call('model_correct', state) == 0
    simulation.set_state(state[:nv], state[nv:], hold=simulation.joint_names[:1])
    np.testing.assert_allclose(state[:nv], simulation.position, atol=1e-9)
    bad = np.full(2 * nv, math.nan)
    assert call('model_correct', bad) == 1
    torn = state.copy()
    torn[nv:] = 1e200
    before = torn.copy()
    tau = np.zeros(nv)
    status = library.model_step(
        ctypes.byref(model), ctypes.c_void_p(torn.ctypes.data), ctypes.c_void_p(tau.ctypes.data),
        ctypes.c_double(1e-3))
    assert status in (1, 2, 3) and np.array_equal(torn, before)


@compiled
@pytest.mark.parametrize('scene, joint, where', (
    ('three_rrr', 1, 0.0), pytest.param(
        'stewart_platform', 1, 0.5 * np.pi, marks=pytest.mark.slow)))
def test_a_singular_arm_is_evaluated_with_all_multipliers(scene, joint, where, tmp_path):
    simulation = simulation_of(scene)
    call, _ = library_of(tmp_path, simulation, True, ('-O0',))
    system, rng, nv = simulation.data.system, np.random.default_rng(0), len(simulation.velocity)
    q, qd, tau = simulation.position, rng.normal(size=nv), rng.normal(size=nv)
    qdd, lam = np.zeros((nv + 1, nv)), np.zeros((nv + 1, len(simulation.multipliers)))
    for angle in (q[joint], where + 1e-3, where):
        q[joint], derivatives = angle, np.zeros((3, nv, nv + lam.shape[1]))
        assert call('differentiate', q, qd, tau, qdd[-1], lam[-1], derivatives) == 0
        assert np.isfinite(derivatives).all()
        # Accelerations and multipliers are linear in torques.
        for more, *results in zip(np.eye(nv), qdd, lam):
            assert call('evaluate', q, qd, tau + more, *results) == 0
        changes = np.hstack((qdd - qdd[-1], lam - lam[-1]))[:-1]
        np.testing.assert_allclose(derivatives[2], changes, rtol=0, atol=1e-11 * np.abs(
            np.hstack((qdd, lam))).max())
        system.tau[:] = tau
        system.native.evaluate(q, qd)
        for found, expected in (qdd[-1], system.qdd), (lam[-1], system.lam):
            np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def table(library, name):
    """Return a table of strings that ends with 0."""
    strings = iter((ctypes.c_char_p * 200).in_dll(library, name))
    return [text.decode() for text in iter(lambda: next(strings), None)]


@compiled
@pytest.mark.parametrize('scene', (
    'three_rrr_vertical', 'slider_crank', 'rssr_four_bar', 'ball', 'press'))
def test_forces_in_joints_are_those_of_the_package(scene, tmp_path):
    if scene in MECHANISMS:
        (tmp_path / f'{scene}.yaml').write_text(MECHANISMS[scene])
        (tmp_path / 'scene.yaml').write_text(SCENES[scene])
    simulation = simulation_of(tmp_path / 'scene.yaml' if scene in MECHANISMS else scene)
    library = ctypes.CDLL(str(build(tmp_path, simulation, '-shared', '-fPIC')))
    simulation.step(torques(simulation), 0.1)
    mechanism = simulation.mechanism
    moving = [n for n, joint in enumerate(mechanism.joints) if joint.type != 'fixed']
    # Name, body in whose axes it is, wrench in world axes: of joints, then of cut joints.
    acting = [(mechanism.joints[n].name, mechanism.joints[n].child, simulation.joint_forces[n])
              for n in moving] + [(cut.name, cut.body_a, wrench) for cut, wrench in zip(
                  mechanism.cut_joints, simulation.constraint_forces)]
    assert table(library, 'model_joint_names') == [name for name, *_ in acting]
    poses = dict(zip([body.name for body in mechanism.bodies], simulation.body_poses))
    poses['ground'] = [0.0, 0.0, 0.0] if mechanism.planar else 6 * [0.0] + [1.0]
    found = np.full((len(acting), 6), math.nan)
    library.model_joint_forces(
        ctypes.byref(ctypes.c_char.in_dll(library, 'model_default')),
        *(ctypes.c_void_p(one.ctypes.data) for one in (
            simulation.position, simulation.velocity, simulation.acceleration,
            simulation.multipliers, found)))
    for wrench, (_, body, expected) in zip(found, acting):
        pose = poses[body]
        if mechanism.planar:
            turned = of_quaternion((0.0, 0.0, math.sin(pose[2] / 2), math.cos(pose[2] / 2)))
            expected = np.array([0.0, 0.0, *expected, 0.0])
        else:
            turned = of_quaternion(pose[3:])
        # World axes, the child's are the columns of its rotation.
        np.testing.assert_allclose(
            wrench, np.concatenate((turned.T @ expected[:3], turned.T @ expected[3:])), rtol=0,
            atol=1e-10 * (1.0 + np.abs(expected).max()))


@compiled
def test_forces_that_are_not_unique_are_left_out(tmp_path):
    simulation = simulation_of('bricard')
    assert simulation.data.has_redundant_constraints
    library = ctypes.CDLL(str(build(tmp_path, simulation, '-shared', '-fPIC')))
    assert not hasattr(library, 'model_joint_forces')
    assert table(library, 'model_velocity_names') == [
        f'velocity.{name}' for name in simulation.joint_names]


@compiled
def test_coordinates_move_along_the_rates(tmp_path):
    (tmp_path / 'ball.yaml').write_text(BALL)
    (tmp_path / 'scene.yaml').write_text(BALL_SCENE)
    simulation = simulation_of(tmp_path / 'scene.yaml')
    library = ctypes.CDLL(str(build(tmp_path, simulation, '-shared', '-fPIC')))
    names = table(library, 'model_position_names')
    assert names == simulation.coordinates.columns('position')
    change = 0.1 * np.random.default_rng(2).normal(size=len(simulation.velocity))
    found, expected = simulation.position, simulation.coordinates.moved(
        simulation.position, change)
    library.model_move(*(ctypes.c_void_p(one.ctypes.data) for one in (found, change)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@compiled
def test_sines_are_right_to_the_last_digits(tmp_path):
    angles = np.concatenate((
        np.random.default_rng(1).uniform(-40.0, 40.0, 5000), np.arange(-20, 21) * math.pi / 4,
        [0.0, 1e-300, 1.5e6, -1.59e6, 1e7, -3e15]))
    program = tmp_path / 'sines.c'
    program.write_text(
        '#include <float.h>\n#include <math.h>\n' + SINE_AND_COSINE + 'void both(int n, '
        'double *a, double *s, double *c) {sines_and_cosines(n, a, s, c);}\n')
    # The last ones: sums of more digits than doubles have, and sums in another order.
    # There GCC takes sines of vectors, which are right to 4 units in the last place.
    for number, (relative, *options) in enumerate((
            (2.3e-16,), (2.3e-16, '-O3', '-ffp-contract=fast'), (8.9e-16, '-O3', '-ffast-math'),
            (2.3e-16, *X87), (2.3e-16, *X87, '-O2'))):
        if X87[-1] in options and not links(tmp_path, *X87):
            continue
        library, code = (tmp_path / f'sines{number}.{ending}' for ending in ('so', 'o'))
        subprocess.run(('cc', *STRICT, *options, '-c', '-fPIC', '-o', code, program), check=True)
        # Without -ffast-math: linked by it, a library rounds numbers of the whole process to zero.
        subprocess.run(('cc', '-shared', '-o', library, code, '-lm'), check=True)
        sine, cosine = np.zeros_like(angles), np.zeros_like(angles)
        ctypes.CDLL(str(library)).both(
            len(angles), *(ctypes.c_void_p(one.ctypes.data) for one in (angles, sine, cosine)))
        for found, exact in ((sine, np.sin(angles)), (cosine, np.cos(angles))):
            # As for the vectors of our own code; near a zero what pi/2's parts leave out.
            assert (np.abs(found - exact) <= relative * np.abs(exact) + 1e-17).all()


@compiled
@pytest.mark.parametrize('options', (('-O2',), ('-O2', '-march=native')))
def test_numbers_of_vectors_are_gathered_in_any_order(options, tmp_path):
    orders = np.random.default_rng(0).integers(0, 8, (200, 4))
    lines = [f'const four x{n} = {{{{{", ".join(f"AT_EIGHT(w, {lane})" for lane in order)}}}}}; '
             f'const four y{n} = FOUR(x{n}, +, x{n}); memcpy(out + {4 * n}, &y{n}, sizeof y{n});'
             for n, order in enumerate(orders)]
    (tmp_path / 'gather.c').write_text('\n'.join((
        '#include <string.h>', '#define VERSION(name) own_##name', VECTORS,
        'void gather(const double *in, double *out)', '{', 'eight v;',
        'memcpy(&v, in, sizeof v);', 'const eight w = EIGHT(v, +, v);', *lines, '}')))
    subprocess.run(('cc', *options, '-shared', '-fPIC', '-o', tmp_path / 'gather.so',
                    tmp_path / 'gather.c'), check=True)
    given, found = np.arange(8.0), np.zeros(orders.shape)
    ctypes.CDLL(str(tmp_path / 'gather.so')).gather(*(
        ctypes.c_void_p(one.ctypes.data) for one in (given, found)))
    assert np.array_equal(found, 4.0 * orders)


@compiled
def test_casadi_calls_it(tmp_path):
    casadi = pytest.importorskip('casadi', reason='needs casadi, from the Python package index')
    simulation = simulation_of('three_rrr_vertical')
    library = build(tmp_path, simulation, '-shared', '-fPIC', name='three_rrr')
    function = casadi.external('three_rrr', str(library))
    assert (function.n_in(), function.n_out()) == (3, 2)
    assert function.name_in() == ['q', 'qd', 'tau'] and function.name_out() == ['qdd', 'lam']
    tau = simulation.joint_torques(torques(simulation))
    simulation.step(torques(simulation), 0.05)
    qd = simulation.velocity
    qdd, lam = function(simulation.position, qd, tau)
    for found, expected in zip((qdd, lam), simulation.forward_dynamics(
            simulation.position, qd, torques(simulation))):
        np.testing.assert_allclose(np.ravel(found), expected, rtol=1e-12, atol=1e-12)


@compiled
@pytest.mark.parametrize('scene', (
    'slider_crank', 'ball', *(pytest.param(name, marks=pytest.mark.slow) for name in (
        'rssr_four_bar', 'pendulum'))))
def test_casadi_gets_jacobians(scene, tmp_path):
    casadi = pytest.importorskip('casadi', reason='needs casadi, from the Python package index')
    if scene in MECHANISMS:
        (tmp_path / f'{scene}.yaml').write_text(MECHANISMS[scene])
        (tmp_path / 'scene.yaml').write_text(SCENES[scene])
    simulation = simulation_of(tmp_path / 'scene.yaml' if scene in MECHANISMS else scene)
    library = build(
        tmp_path, simulation, '-shared', '-fPIC', name='machine', derivatives=True)
    function = casadi.external('machine', str(library))
    command = torques(simulation)
    simulation.step(command, 0.1)
    state = [simulation.position, simulation.velocity, simulation.joint_torques(command)]
    blocks = function.jacobian()(*state, *function(*state))
    for n, values in enumerate(state):
        step = 1e-3
        for place in range(len(values)):

            def at(times):
                moved = [one.copy() for one in state]
                moved[n][place] += times * step
                return [np.array(one).ravel() for one in function(*moved)]

            samples = {times: at(times) for times in (-3, -2, -1, 1, 2, 3)}
            for result in range(2):
                expected = sum(weight * (samples[k][result] - samples[-k][result]) / step
                               for k, weight in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)))
                found = np.array(blocks[3 * result + n])[:, place]
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * max(
                    1.0, np.abs(expected).max(initial=0.0)))


@pytest.mark.slow
@compiled
def test_a_predictive_controller_by_ipopt_reaches_its_goal():
    pytest.importorskip('casadi', reason='needs casadi, from the Python package index')
    example = runpy.run_path(str(ROOT / 'doc' / 'examples' / 'predictive_control.py'))
    away, torques = example['control'](40)
    assert away[0] > 0.2 and away[30:].max() < 0.03
    assert 0.99 * example['LIMIT'] < np.abs(torques).max() <= example['LIMIT'] + 1e-6


@compiled
@pytest.mark.parametrize('scene, compiler, options', (
    ('three_rrr_vertical', 'plain', ()), *(
        pytest.param(scene, 'gnu', ('-O1',), marks=pytest.mark.slow)
        for scene in ('three_rrr_vertical', 'stewart_platform'))))
def test_derivatives_in_c_are_those_of_the_package(scene, compiler, options, tmp_path):
    simulation = simulation_of(scene)
    library = ctypes.CDLL(str(build(tmp_path, simulation, '-shared', '-fPIC', *options,
                                    derivatives=True, compiler=compiler)))
    command = torques(simulation)
    simulation.step(command, 0.1)
    expected = Differentiator(simulation)(simulation.position, simulation.velocity, command)
    nv, nc = len(expected.acceleration), len(expected.multipliers)
    arrays = [simulation.position, simulation.velocity, simulation.joint_torques(command),
              np.zeros(nv), np.zeros(nc), np.zeros((3, nv, nv + nc))]
    assert library.model_differentiate(
        ctypes.byref(ctypes.c_char.in_dll(library, 'model_default')),
        *(ctypes.c_void_p(one.ctypes.data) for one in arrays)) == 0
    for found, exact in zip(arrays[5], (
            expected.by_position, expected.by_velocity, expected.by_torque)):
        np.testing.assert_allclose(found.T, exact, rtol=0, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize('scene, words', (
    ('three_rrr_payload_friction', ('effects.gear_1', 'joint_friction')),
    ('rope_hoist', ('effects.rope', 'cable')),
    ('differential', ('effects.engine', 'prescribed_force'))))
def test_what_has_no_c_is_refused_by_name(scene, words):
    with pytest.raises(SimulationError) as error:
        c_source(simulation_of(scene), 'model')
    for word in words:
        assert word in str(error.value)


def test_a_singular_start_is_refused(tmp_path):
    (tmp_path / 'parallelogram.yaml').write_text(PARALLELOGRAM)
    (tmp_path / 'scene.yaml').write_text(
        PARALLELOGRAM_SCENE.replace('{a: 0.7, b: -0.7, c: 0.7}', '{a: 0.0, b: 0.0, c: 0.0}'))
    with pytest.raises(SimulationError, match='closure equations depend on one another where'):
        c_source(simulation_of(tmp_path / 'scene.yaml'), 'flat')


def test_a_name_that_c_does_not_take_is_refused():
    with pytest.raises(ValueError, match="letters, digits and _, a letter first, got '3 rrr'"):
        c_source(simulation_of('four_bar'), '3 rrr')


def test_the_command_writes_both_files(tmp_path, capsys):
    assert main(['export', 'four_bar', '--output', str(tmp_path / 'bar.c')]) == 0
    assert 'bar.c' in capsys.readouterr().out
    header = (tmp_path / 'bar.h').read_text()
    joints = load_scene('four_bar').mechanism.coordinates.names
    assert all(f'velocity.{name}' in header for name in joints)
    assert not re.search('@[A-Z]+@', header + (tmp_path / 'bar.c').read_text())
    # Neither file is replaced unasked.
    (tmp_path / 'bar.c').unlink()
    assert main(['export', 'four_bar', '--output', str(tmp_path / 'bar.c')]) == 2
    assert 'bar.h exists' in capsys.readouterr().err
    assert main(['export', 'cam_follower', '--output', str(tmp_path / 'cam.c')]) == 1
    assert 'effects.outline' in capsys.readouterr().err
