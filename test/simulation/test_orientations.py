# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Joints of several degrees of freedom: known motions, and their states."""

from dataclasses import replace
from functools import partial

from closedloop_dynamics import (
    Body, CutJoint, Initial, Joint, load_scene, Mechanism, Method, Model, Point, Simulation)
from closedloop_dynamics.effects.registry import Actuator, JointDamping, JointSpring, Sensor
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.recording.run import columns, Report, run
from closedloop_dynamics.scene.integrators import FIXED, INTEGRATORS
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
from closedloop_dynamics.scene.text import read_scene_text, scene_text
from closedloop_dynamics.simulation.system import parts_of_state
from closedloop_dynamics.studies.check import describe
from closedloop_dynamics.visual.trajectory import from_rows
import numpy as np
import pytest
from scipy.integrate import quad, simpson
from spinning_bodies import free_body, LEAN, LEVER, MOMENTS, nutation, SPIN

from ..reference import spatial_machines
from ..reference.compare import assert_agree
from ..reference.scenes import scene_in_space as scene, simulated
from ..reference.spatial_maximal import matrix

TIGHT = {'integrator': 'dop853', 'tolerance': 1e-13}
ORDERS = {'semi_implicit_euler': 1, 'heun': 2, 'rk4': 4, 'rodas4_fixed': 4}


simulation = partial(simulated, gravity=spatial_machines.GRAVITY)


def body_on(kind, center=(0.0, 0.0, 0.0), inertia=(0.02, 0.03, 0.04), **keys):
    """Return one body of 0.5 kg on the ground."""
    return Mechanism('one_body', (Body('body', 0.5, center, inertia),), (
        Joint('joint', kind, 'ground', 'body', (0.0, 0.0, 0.0), **keys),),
        points=(Point('center', 'body', center),))


def unit_errors(one):
    """Return how far the quaternions of a simulation are from norm 1."""
    balls = one.coordinates.balls
    return [abs(np.linalg.norm(one.position[first:first + 4]) - 1.0) for first, _ in balls]


def turning(one):
    """Return the orientation and the angular velocity of the last joint."""
    return matrix(one.position[-4:]), one.velocity[-3:]


# A free body, and a heavy symmetric top.

def check_free_body(duration, samples, tolerance):
    """Compare a free body whose frame is not at its center with the closed form."""
    expected = free_body()
    start = expected(0.0)
    center = np.array([0.1, -0.2, 0.05])
    origin = -np.cross(start, center)
    one = simulation(
        body_on('free', tuple(center), tuple(MOMENTS)), velocity={
            'joint': {'velocity': origin, 'angular_velocity': start}}, **TIGHT)
    momentum, energy = MOMENTS * start, one.energy
    flips = 0
    for time in np.linspace(0.0, duration, samples + 1)[1:]:
        before = one.velocity[4]
        one.step(None, time - one.time)
        axes, rates = turning(one)
        assert_agree(rates, expected(time), tolerance)
        assert_agree(axes @ (MOMENTS * rates), momentum, tolerance)
        assert_agree(one.points[0] - center, (0.0, 0.0, -0.5 * 9.81 * time ** 2), tolerance,
                     smallest=1.0)
        assert max(unit_errors(one)) < 1e-15
        flips += before * one.velocity[4] < 0.0
    assert flips > 1
    assert_agree(one.energy, energy, tolerance)
    return one


def test_free_body_flips_as_elliptic_functions_tell():
    check_free_body(4.0, 40, 1e-9)


@pytest.mark.slow
def test_free_body_flips_for_a_thousand_turns():
    # Near the separatrix differences grow with every flip.
    check_free_body(600.0, 600, 1e-5)


def test_free_body_precesses_as_the_quadrature_tells():
    expected = free_body(share=0.7)
    start = expected(0.0)
    one = simulation(body_on('spherical', inertia=tuple(MOMENTS)), gravity=(0.0, 0.0, 0.0),
                     velocity={'joint': {'angular_velocity': start}}, **TIGHT)
    length = np.linalg.norm(MOMENTS * start)

    def precession(time):
        # About the angular momentum, of the body's third axis.
        x, y, _ = MOMENTS * expected(time)
        wx, wy, _ = expected(time)
        return length * (x * wx + y * wy) / (x * x + y * y)

    one.step(None, 1.0)
    axes, _ = turning(one)
    along = MOMENTS * start / length
    # Axes about which the third axis starts at angle zero.
    across = np.array([0.0, 0.0, 1.0]) - along[2] * along
    across /= np.linalg.norm(across)
    angle = np.arctan2(axes[:, 2] @ np.cross(along, across), axes[:, 2] @ across)
    total, _ = quad(precession, 0.0, 1.0, epsabs=1e-13, epsrel=1e-13, limit=200)
    assert_agree((np.cos(angle), np.sin(angle)), (np.cos(total), np.sin(total)), 1e-9)


def top(**method):
    """Return a symmetric top that is released leaning and spinning, at rest but for its spin."""
    return simulation(
        body_on('spherical', (0.0, 0.0, LEVER), (0.002, 0.002, 0.001)),
        {'joint': {'orientation': {'rpy': (LEAN, 0.0, 0.0)}}},
        {'joint': {'angular_velocity': (0.0, 0.0, SPIN)}}, **method)


def check_top(one, duration, samples, tolerance):
    """Compare a top with the closed form."""
    energy, precession = one.energy, 0.0
    for time in np.linspace(0.0, duration, samples + 1)[1:]:
        precession += quad(lambda t: nutation(t)[1], one.time, time, epsabs=1e-13)[0]
        one.step(None, time - one.time)
        axes, rates = turning(one)
        axis = axes[:, 2]
        assert_agree(axis[2], nutation(time)[0], tolerance, smallest=1.0)
        # The third axis starts along -y, leaning by a turn about x.
        sine = np.hypot(axis[0], axis[1])
        assert_agree(axis[:2] / sine, (np.sin(precession), -np.cos(precession)), tolerance)
        assert_agree(rates[2], SPIN, tolerance)
        assert max(unit_errors(one)) < 1e-15
    assert_agree(one.energy, energy, tolerance)


def test_heavy_top_nutates_as_elliptic_functions_tell():
    check_top(top(**TIGHT), 2.0, 20, 1e-9)


@pytest.mark.slow
def test_heavy_top_nutates_for_a_thousand_turns():
    check_top(top(**TIGHT), 160.0, 400, 1e-8)


@pytest.fixture(scope='module')
def reference():
    """Return the orientation of the top after 0.2 s."""
    one = top(**TIGHT)
    one.step(None, 0.2)
    return one.position


@pytest.mark.parametrize('integrator', ORDERS)
def test_error_of_an_orientation_falls_with_the_order(integrator, reference):
    errors = []
    for steps in (50, 100):
        one = top(integrator=integrator, step_size=0.2 / steps)
        one.step(None, 0.2)
        errors.append(np.abs(one.coordinates.apart(one.position, reference)).max())
        assert max(unit_errors(one)) < 1e-15
    assert np.log2(errors[0] / errors[1]) > ORDERS[integrator] - 0.5


@pytest.mark.parametrize('integrator', [
    name for name, method in INTEGRATORS.items() if method.kind != FIXED])
def test_error_control_keeps_orientations(integrator, reference):
    tolerance = {} if integrator == 'auto' else {'tolerance': 1e-8}
    one = top(integrator=integrator, step_size=0.05, **tolerance)
    one.step(None, 0.2)
    # Local errors add up; auto promises 1e-6 within a second.
    assert np.abs(one.coordinates.apart(one.position, reference)).max() < 1e-6
    assert max(unit_errors(one)) < 1e-15


def test_spherical_joint_accelerates_alike_in_every_orientation():
    one = top()
    random = np.random.default_rng(3)
    turns = [*np.eye(4), *-np.eye(4), *random.standard_normal((50, 4))]
    moments = np.array([0.002, 0.002, 0.001]) + 0.5 * LEVER ** 2 * np.array([1.0, 1.0, 0.0])
    for turn in turns:
        turn = turn / np.linalg.norm(turn)
        rates = random.standard_normal(3)
        qdd, _ = one.forward_dynamics(turn, rates)
        weight = matrix(turn).T @ (0.0, 0.0, -0.5 * 9.81)
        # Euler's equations about the fixed point.
        torque = np.cross((0.0, 0.0, LEVER), weight) - np.cross(rates, moments * rates)
        assert_agree(qdd, torque / moments, 1e-12)


# Coordinates and rates.

def arm():
    """Return a chain of all kinds of joints of several degrees of freedom."""
    link = Body('link', 1.0, (0.1, 0.0, 0.05), (0.02, 0.03, 0.04))
    kinds = (('base', 'free', {}), ('hip', 'universal', {
        'axis': (1.0, 0.0, 0.0), 'second_axis': (0.0, 1.0, 0.0)}),
        ('weld', 'fixed', {}), ('knee', 'cylindrical', {'axis': (0.0, 1.0, 0.0)}),
        ('table', 'planar', {}), ('ball', 'spherical', {'actuated': True}),
        ('last', 'revolute', {'axis': (0.0, 0.0, 1.0)}))
    names = ['ground', *(f'{name}_link' for name, *_ in kinds)]
    return Mechanism(
        'arm', tuple(replace(link, name=name) for name in names[1:]),
        tuple(Joint(name, kind, before, after, (0.2, 0.1, 0.0), **keys)
              for (name, kind, keys), before, after in zip(kinds, names, names[1:])))


def test_coordinates_have_names_and_places():
    names = arm().coordinates
    assert (names.nq, names.nv) == (19, 17)
    assert names.columns('position') == [
        *(f'position.base.{axis}' for axis in 'xyz'),
        *(f'orientation.base.{axis}' for axis in 'xyzw'), 'position.hip.1', 'position.hip.2',
        'position.knee.1', 'position.knee.2', 'position.table.x', 'position.table.y',
        'position.table.angle', *(f'orientation.ball.{axis}' for axis in 'xyzw'),
        'position.last']
    assert names.columns('velocity')[:6] == [
        *(f'velocity.base.{axis}' for axis in 'xyz'),
        *(f'angular_velocity.base.{axis}' for axis in 'xyz')]
    assert names.columns('effort')[-4:] == [
        *(f'torque.ball.{axis}' for axis in 'xyz'), 'effort.last']
    assert arm().actuated_joints == ('ball.rx', 'ball.ry', 'ball.rz')


def test_changes_of_coordinates_lead_back():
    names, random = arm().coordinates, np.random.default_rng(1)
    q = names.moved(names.start(), random.standard_normal(names.nv))
    for size in (1e-12, 1e-6, 1.0, 3.1):
        change = random.standard_normal(names.nv)
        for _, rate in names.balls:
            # The shorter way round.
            change[rate:rate + 3] *= size / np.linalg.norm(change[rate:rate + 3])
        moved = names.moved(q, change)
        assert_agree(names.apart(moved, q), change, 1e-14)
        for first, _ in names.balls:
            moved[first:first + 4] *= -1.0
        assert_agree(names.apart(moved, q), change, 1e-14)


@pytest.fixture(scope='module')
def chain():
    """Return a simulation of the chain, moving."""
    mechanism, random = arm(), np.random.default_rng(2)
    names = mechanism.coordinates
    made = scene(mechanism, **TIGHT)
    q = names.moved(names.start(), random.standard_normal(names.nv))
    return Simulation(replace(made, initial=Initial(
        tuple(q), tuple(random.standard_normal(names.nv)))))


def test_rates_of_coordinates_are_what_changes_make_of_them(chain):
    system, names = chain.data.system, chain.coordinates
    q, qd, *_, states = parts_of_state(system)
    state, rates = chain.data.integrated.copy(), np.zeros(states)
    system.native.derivative(state.copy(), rates)
    before, after = state.copy(), state.copy()
    system.manifold.move(before[q], state[qd], -1e-6)
    system.manifold.move(after[q], state[qd], 1e-6)
    assert_agree(rates[q], (after[q] - before[q]) / 2e-6, 1e-9)
    # The engine does what Python does.
    assert_agree(after[q], names.moved(state[q], 1e-6 * state[qd]), 1e-15)


def test_energy_and_work_of_torques_on_every_freedom_balance(chain):
    chain.reset()
    chain.step({'ball.rx': 0.3, 'ball.ry': -0.2, 'ball.rz': 0.5}, 0.2)
    balance = chain.energy_balance
    assert abs(balance.work) > 1e-3
    assert_agree(balance.residual, 0.0, 1e-10, smallest=balance.kinetic)
    assert max(unit_errors(chain)) < 1e-15
    # By hand, of a torque that is held.
    names, state = chain.coordinates, chain.state
    chain.reset()
    power = []
    for _ in range(201):
        power.append(chain.velocity[list(names.actuated)] @ (0.3, -0.2, 0.5))
        chain.step({'ball.rx': 0.3, 'ball.ry': -0.2, 'ball.rz': 0.5})
    assert_agree(balance.work, simpson(power, dx=1e-3), 1e-8)
    chain.restore(state, 0.2)
    assert np.array_equal(chain.data.integrated, state[:len(chain.data.integrated)])
    assert_agree(chain.energy_balance.residual, balance.residual, 1e-10, smallest=1.0)


def test_states_are_given_by_name(chain):
    chain.reset()
    before, rates = chain.position, chain.velocity
    chain.set_state({'hip.2': 0.3, 'ball': {'orientation': {'rpy': (0.0, 0.0, 1.0)}},
                     'base': {'position': (1.0, 2.0, 3.0)}},
                    {'base': {'angular_velocity': (0.1, 0.2, 0.3)}, 'table.angle': 0.4})
    after, names = chain.position, chain.coordinates
    assert after[:3].tolist() == [1.0, 2.0, 3.0]
    assert after[3:8].tolist() == before[3:8].tolist()
    assert after[8] == 0.3
    assert_agree(after[-5:-1], (0.0, 0.0, np.sin(0.5), np.cos(0.5)), 1e-15)
    # What is not named stays.
    assert chain.velocity[names.rates['base']].tolist() == [*rates[:3], 0.1, 0.2, 0.3]
    assert chain.velocity[names.index['table.angle']] == 0.4
    reported = names.by_name('position', after)
    assert np.array_equal(names.filled('position', reported, names.start()), after)
    with pytest.raises(FieldError, match='position.base.angle: .*position, orientation'):
        chain.set_state({'base': {'angle': 1.0}})
    with pytest.raises(FieldError, match=r'position.ball.orientation: .*rpy.* or quaternion'):
        chain.set_state({'ball': {'orientation': [0.0, 0.0, 0.0]}})
    with pytest.raises(FieldError, match='position.*hip.1'):
        chain.set_state({'hip': 0.1})


def test_quaternions_of_another_norm_are_refused(chain):
    chain.reset()
    position = chain.position
    position[-5:-1] *= 1.5
    with pytest.raises(FieldError, match='position.ball.orientation.quaternion: expected a unit '
                                         'quaternion .* got one of norm 1.5'):
        chain.set_state(position)
    with pytest.raises(FieldError, match='initial.position.ball.orientation.quaternion'):
        replace(chain.scene, initial=Initial(tuple(position), tuple(chain.velocity)))
    with pytest.raises(FieldError, match='initial.position: expected 19 numbers.*got 17'):
        replace(chain.scene, initial=Initial(17 * (0.0,), 17 * (0.0,)))
    # Numbers that were rounded are not.
    position = np.round(chain.position, 6)
    chain.set_state(position)
    assert max(unit_errors(chain)) < 1e-15


def test_text_and_description_of_a_scene_tell_orientations(chain):
    made = chain.scene
    assert read_scene_text(scene_text(made))[0] == made
    text = describe(made, chain)
    assert '17 = 17 of the joints - 0 equations' in text
    assert 'orientation [' in text


def test_rows_of_numbers_tell_the_motion_again(chain):
    chain.reset()
    rows, states = [], []
    run(chain, 0.02, 100.0, None, report=Report(),
        on_row=lambda values: (rows.append(values), states.append(chain.state)))
    motion = from_rows(chain.mechanism, columns(chain), [list(map(repr, row)) for row in rows])
    assert motion.position.shape == (3, 19) and motion.velocity.shape == (3, 17)
    for position, velocity, state in zip(motion.position, motion.velocity, states):
        assert np.array_equal(np.concatenate([position, velocity]), state[:36])


# Loops.

def stewart_on_a_free_platform():
    """Return the Stewart platform of which every leg's head is cut, and its leg forces."""
    mechanism, forces = spatial_machines.stewart_platform()
    *joints, head = mechanism.joints
    place = np.sum([joint.position for joint in joints if joint.child in (
        'cylinder_1', 'piston_1')], axis=0)
    free = Joint('base', 'free', 'ground', 'platform', tuple(place))
    cut = CutJoint('head_1', 'spherical', 'platform', 'piston_1', (0.0, 0.0, 0.0), head.position)
    return replace(mechanism, joints=(*joints, free), cut_joints=(
        cut, *mechanism.cut_joints)), forces


def marked(mechanism, body, *places):
    """Return a mechanism with named points on a body."""
    return replace(mechanism, points=tuple(
        Point(f'point_{k}', body, tuple(place)) for k, place in enumerate(places)))


@pytest.mark.slow
def test_stewart_platform_on_a_free_joint_moves_as_known():
    mechanism, forces = stewart_on_a_free_platform()
    center = mechanism.bodies[-1].center_of_mass
    one = simulation(marked(mechanism, 'platform', center, *np.add(center, np.eye(3))),
                     integrator='dop853', tolerance=1e-11)
    start = one.energy
    one.step(forces, 0.3)
    assert_agree(one.points[0], (-0.006612888235, -0.003836627965, 0.605095609325), 1e-9)
    one.step(forces, 0.3)
    assert_agree(one.points[0], (-0.034261768566, -0.020474374083, 0.617628809006), 1e-9)
    assert_agree((one.points[1:] - one.points[0]).T, [
        [0.788368044122, -0.577218863246, -0.212824366368],
        [0.476391160672, 0.791680900711, -0.382482435522],
        [0.389265062703, 0.200149282690, 0.899117887486]], 1e-9)
    assert_agree(one.energy - start, 8.148633672, 1e-9)
    assert one.closure < 1e-12


@pytest.fixture(scope='module')
def rods():
    """Return the RSSR four-bar with a ball in its tree, and with both balls cut."""
    mechanism, torque = spatial_machines.rssr_four_bar()
    mechanism = marked(mechanism, 'rocker', (0.0, 0.0, 0.15))
    *joints, tip = mechanism.joints
    free = replace(mechanism, joints=(*joints, Joint(
        'rod', 'free', 'ground', 'rod', (0.1, 0.0, 0.0))), cut_joints=(
            *mechanism.cut_joints,
            CutJoint('tip', 'spherical', 'rod', 'crank', (0.0, 0.0, 0.0), tip.position)))
    tight = {'integrator': 'dop853', 'tolerance': 1e-11}
    return simulation(mechanism, **tight), simulation(free, **tight), torque


def test_a_ball_moves_alike_in_the_tree_cut_as_hinges_and_as_shipped(rods):
    *both, torque = rods
    shipped = load_scene('rssr_four_bar')
    forms = [*both, simulation(
        spatial_machines.with_single_freedoms(both[0].mechanism), **TIGHT), Simulation(replace(
            shipped, effects={'gravity': shipped.effects['gravity']}, method=Method(**TIGHT)))]
    for one in forms:
        one.reset()
        center = one.mechanism.points[-1].name
        start, _ = one.forward_dynamics(one.position, one.velocity, torque)
        assert_agree(start[1], -0.51208193311, 1e-11)
        for place in ((0.4, 0.313911207995, 0.149353534582),
                      (0.4, 0.269707605674, 0.146909396725)):
            one.step(torque, 0.5)
            assert_agree(one.point(center), place, 1e-9)
        assert_agree((one.position[0], one.velocity[1]), (1.622930658, 1.655614798758), 1e-9)
        assert_agree(one.energy_balance.work, 0.032458613162, 1e-9)
        assert abs(one.energy_balance.residual) < 1e-10
        assert one.closure < 1e-12
        assert max(unit_errors(one), default=0.0) < 1e-15
    one, other = both
    assert_agree(one.body_poses, other.body_poses, 1e-9)
    assert_agree(one.force('end'), other.force('end'), 1e-7)


def test_an_idle_spin_stays(rods):
    one, _, torque = rods
    along = np.array([0.3, 0.3, 0.3]) / np.linalg.norm([0.3, 0.3, 0.3])
    one.reset()
    one.set_state(one.position, {'tip': {'angular_velocity': 1000.0 * along}})
    one.step(torque, 0.1)
    # Of the rod against the world, about its axis: nothing turns a symmetric rod there.
    crank = np.array([0.0, 0.0, one.velocity[0]])
    frame = matrix(one.body_poses[2, 3:])
    spin = along @ (one.velocity[-3:] + frame.T @ crank)
    assert_agree(spin, 1000.0, 1e-9)
    balance = one.energy_balance
    assert_agree(balance.residual, 0.0, 1e-9, smallest=balance.kinetic)
    assert max(unit_errors(one)) < 1e-15
    assert one.closure < 1e-12


def test_a_start_that_is_off_by_a_tenth_in_every_joint_is_closed(rods):
    random = np.random.default_rng(7)
    for one in rods[:2]:
        one.reset()
        names = one.coordinates
        for _ in range(5):
            change = 0.1 * random.choice([-1.0, 1.0], names.nv)
            guess = names.moved(one.position, change)
            one.set_state(guess, random.standard_normal(names.nv))
            assert one.closure < 1e-12
            assert max(unit_errors(one)) < 1e-15
            # The nearest state, not another assembly.
            assert np.abs(names.apart(one.position, guess)).max() < 1.0
            one.reset()
        # As it is where it is closed, to the last digit.
        position = one.position
        one.set_state(position)
        assert np.array_equal(one.position, position)


def test_held_joints_keep_their_orientation(rods):
    one, _, _ = rods
    one.reset()
    turn = one.position[-4:]
    one.set_state({'crank': 0.01, 'rocker': 0.02}, hold=['tip'])
    assert np.array_equal(one.position[-4:], turn)
    assert_agree(one.position[:2], np.zeros(2), 1e-9, smallest=1.0)


def test_numbers_of_joints_are_reached_by_key_paths(chain):
    made = chain.scene
    before = numbers(made)
    found = [key for key in before if key.startswith('initial')]
    assert len(found) == 3 + 8 + 17
    for key in ('initial.position.hip.2', 'initial.position.base.position.1',
                'initial.velocity.ball.angular_velocity.2', 'initial.velocity.last'):
        after = numbers(changed(made, {resolve(made, key): 0.25}))
        assert after.pop(key) == 0.25
        assert after == {other: before[other] for other in before if other != key}


def test_effects_act_on_single_numbers_of_joints_behind_orientations():
    mechanism, held = arm(), ('hip.1', 'last')
    effects = {'spring': JointSpring('last', 3.0, 0.1), 'twist': JointSpring('hip.2', 2.0),
               'oil': JointDamping('knee.2', 0.5), 'drive': Actuator('table.x', max_torque=0.4)}
    joints = tuple(replace(joint, actuated=True) if joint.name == 'table' else joint
                   for joint in mechanism.joints)
    mechanism = replace(mechanism, joints=joints)
    made = scene(mechanism, {'hip.2': 0.3, 'last': 0.5}, {'knee.2': 1.0}, **TIGHT)
    one = Simulation(replace(made, effects={**made.effects, **effects},
                             initial=replace(made.initial, hold=held)))
    assert one.scene.initial.hold == held
    assert one.effect_readings('spring')['stored_energy'] == 0.5 * 3.0 * 0.4 ** 2
    assert one.effect_readings('twist')['torque'] == -2.0 * 0.3
    assert_agree(one.effect_readings('oil')['dissipated_power'], 0.5, 1e-15)
    one.step({'table.x': 1.0, 'ball.rz': 0.2}, 0.1)
    assert one.effort[one.coordinates.index['table.x']] == 0.4
    balance = one.energy_balance
    assert balance.dissipated > 1e-3 and abs(balance.work) > 1e-6
    assert_agree(balance.residual, 0.0, 1e-9, smallest=balance.kinetic)
    for name, effect in (('hip', JointSpring('hip', 1.0)), ('ball', JointSpring('ball.rx', 1.0)),
                         ('table.y', Sensor())):
        with pytest.raises(FieldError):
            Simulation(replace(made, effects={name.partition('.')[0]: effect}))


def test_batches_of_states_have_unit_quaternions_as_single_states_do():
    model = Model.from_scene('rssr_four_bar')
    q = np.tile(model.assemble().q, (3, 1))
    first, _ = model.coordinates.balls[0]
    q[1, first:first + 4] *= 1.0 + 5e-7
    batch = model.state(q)
    for each, place in zip(batch, q):
        np.testing.assert_array_equal(each.q, model.state(place).q)
    assert abs(np.linalg.norm(batch.q[1, first:first + 4]) - 1.0) < 1e-15
    q[2, first:first + 4] *= 1.1
    with pytest.raises(ValueError, match='got one of norm 1.1') as found:
        model.state(q)
    with pytest.raises(ValueError, match='got one of norm 1.1') as alone:
        model.state(q[2])
    assert str(found.value) == str(alone.value)
    assert len(model.state(q[:0])) == 0
