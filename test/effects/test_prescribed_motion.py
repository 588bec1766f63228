# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Prescribed motions: closed-form kinematics, drive torques, work, methods, bad input."""

from dataclasses import replace
import math

from closedloop_dynamics import AssemblyError, load_scene, SceneError, Simulation, SimulationError
from closedloop_dynamics.effects.prescribed_motion import SHAPES
from closedloop_dynamics.effects.registry import (
    Actuator, Gravity, PrescribedForce, PrescribedMotion)
from closedloop_dynamics.mechanism.errors import MotionError
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated

EARTH = Gravity((0.0, -9.81))
EXAMPLES = {
    'constant': {'offset': 0.3},
    'constant_speed': {'speed': -1.5, 'offset': 0.1},
    'sine': {'amplitude': 0.7, 'frequency': 0.8, 'phase': 0.4, 'offset': -0.2},
    'trapezoid': {'amplitude': 0.9, 'rise': 0.5, 'ramp': 0.11, 'start': 0.13, 'hold': 0.2,
                  'fall': 0.3, 'offset': 0.1, 'period': 1.3},
    'cycloid': {'amplitude': 0.9, 'rise': 0.5, 'start': 0.13, 'hold': 0.2, 'offset': 0.1},
    'table': {'times': (0.05, 0.4, 0.7, 1.1), 'values': (0.1, 0.9, -0.4, 0.2)},
    'expression': {'expression': 'sin(2*t)**2*exp(-t/3) + t**2.5/(1 + t)'},
    'commanded': {'times': (0.0, 0.4, 1.1), 'values': (0.1, 0.9, -0.4), 'rates': (0.5, -1.0, 0.0),
                  'accelerations': (1.0, 2.0, -3.0)}}


def with_effects(name, **effects):
    """Return a shipped scene with other effects beside gravity."""
    scene = load_scene(name)
    return replace(scene, effects={
        **{key: one for key, one in scene.effects.items() if isinstance(one, Gravity)}, **effects})


def moved(name, integrator='rk4', step_size=0.001, **motions):
    """Return a simulation of a shipped scene whose joints are moved by expressions in t."""
    return Simulation.from_scene(with_effects(name, **{
        f'move_{joint}': PrescribedMotion('expression', joint=joint, expression=text)
        for joint, text in motions.items()}), integrator=integrator, step_size=step_size)


def four_bar_angles(sides, crank):
    """Return the absolute angles of coupler and rocker of a four-bar linkage, open branch."""
    ground, a, b, c = sides
    diagonal = np.array([ground - a * math.cos(crank), -a * math.sin(crank)])
    length, direction = math.hypot(*diagonal), math.atan2(diagonal[1], diagonal[0])
    coupler = direction + math.acos((length ** 2 + b * b - c * c) / (2.0 * length * b))
    tip = a * np.array([math.cos(crank), math.sin(crank)]) + b * np.array(
        [math.cos(coupler), math.sin(coupler)])
    return coupler, math.atan2(tip[1], tip[0] - ground)


@pytest.mark.parametrize('shape', SHAPES)
def test_rates_are_the_derivatives_of_every_shape(shape):
    motion, step = PrescribedMotion(shape, joint='slide', **EXAMPLES[shape]), 1e-5
    for time in np.random.default_rng(1).uniform(0.01, 1.25, 20):
        before, here, after = (motion.at(time + d)[:2] for d in (-step, 0.0, step))
        slope = (after - before) / (2.0 * step)
        assert motion.at(time)[1:] == pytest.approx(slope, abs=2e-3 if shape == 'table' else 1e-4)
        assert here == pytest.approx(0.5 * (before + after), abs=1e-7)


@pytest.mark.parametrize('method', [
    {}, {'integrator': 'auto', 'step_size': 0.01},
    *(pytest.param(method, marks=pytest.mark.slow) for method in (
        {'integrator': 'rodas4', 'tolerance': 1e-9}, {'integrator': 'dopri5', 'tolerance': 1e-11},
        {'stabilisation': 'baumgarte', 'baumgarte_time_constant': 0.02, 'step_size': 1e-4}))])
@pytest.mark.parametrize('shape', [
    'sine', *(pytest.param(shape, marks=pytest.mark.slow)
              for shape in ('trapezoid', 'cycloid', 'table', 'expression'))])
def test_the_force_on_a_block_is_its_mass_times_the_acceleration(shape, method):
    motion = PrescribedMotion(shape, joint='slide', **EXAMPLES[shape])
    start, rate, _ = motion.at(0.0)
    simulation = simulated(block(2.0), {'drive': motion}, [start], [rate], **method)
    for _ in range(5):
        simulation.step(duration=0.2)
        place, rate, acceleration = motion.at(simulation.time)
        assert simulation.position[0] == pytest.approx(place, abs=1e-9)
        assert simulation.velocity[0] == pytest.approx(rate, abs=1e-8)
        assert simulation.motion_forces['drive'] == pytest.approx(2.0 * acceleration, abs=1e-8)
    assert simulation.effect_readings('drive')['work'] == pytest.approx(
        rate ** 2 - motion.at(0.0)[1] ** 2, abs=1e-8)


def test_a_crank_at_constant_speed_moves_a_four_bar_as_in_closed_form():
    crank = PrescribedMotion('constant_speed', joint='crank_joint', speed=4.0)
    simulation = Simulation.from_scene(
        with_effects('four_bar', drive=crank), integrator='rk4', step_size=0.001)
    bodies = {joint.name: joint for joint in simulation.mechanism.joints}
    cut = simulation.mechanism.cut_joints[0]
    sides = (bodies['rocker_joint'].position[0], bodies['coupler_joint'].position[0],
             math.hypot(*cut.point_a), math.hypot(*cut.point_b))
    q = simulation.position
    for _ in range(4):
        simulation.step(duration=0.45)
        angle = q[0] + 4.0 * simulation.time
        coupler, rocker = four_bar_angles(sides, angle)
        found = simulation.position
        assert found[0] == pytest.approx(angle, abs=1e-11)
        for mine, theirs in ((found[0] + found[1], coupler), (found[2], rocker)):
            assert abs(math.remainder(mine - theirs, 2.0 * math.pi)) < 1e-10
        assert simulation.velocity[0] == pytest.approx(4.0, abs=1e-12)
        assert simulation.acceleration[0] == pytest.approx(0.0, abs=1e-9)
    assert_balanced(simulation, 1e-9)


@pytest.mark.parametrize('name, motions', [
    ('four_bar', {'crank_joint': '1.0472 + 4*t'}),
    ('slider_crank', {'crank_joint': '0.4*sin(3*t) + 0.8'}),
    ('carpet_scraper', {'theta_1': '4.7124*t'}),
    ('three_rrr', {'theta_1': '1.0467 + 0.2*sin(3*t)', 'theta_6': '4.1883 - 0.1*t**2',
                   'theta_7': '5.7637 + 0.1*sin(2*t)**2'}),
    pytest.param('delta_robot', {
        'hip_1': 'q0 + 0.1*sin(3*t)', 'hip_2': 'q0 + 0.2*t', 'hip_3': 'q0 + 0.1*t**2'},
                 marks=pytest.mark.slow),
    pytest.param('excavator_arm', {
        'slew': '0.1*t', 'boom_cylinder': 'q0 + 0.02*sin(t)', 'stick_cylinder': 'q0 + 0.03*t',
        'bucket_cylinder': 'q0 + 0.01*t'}, marks=pytest.mark.slow)])
def test_drive_torques_are_those_of_inverse_dynamics(name, motions):
    plain = Simulation.from_scene(with_effects(name))
    names, start = plain.coordinates, plain.position
    simulation = moved(name, **{
        joint: text.replace('q0', repr(float(start[names.place[names.index[joint]]])))
        for joint, text in motions.items()})
    for _ in range(3):
        simulation.step(duration=0.1)
        assert simulation.data.degrees_of_freedom() == 0
        torque, _ = plain.inverse_dynamics(
            simulation.position, simulation.velocity, simulation.acceleration)
        drives = dict(zip(plain.actuated_joints, torque))
        largest = np.abs(torque).max()
        for joint in motions:
            assert simulation.motion_forces[f'move_{joint}'] == pytest.approx(
                drives[joint], abs=1e-9 * largest)
            assert simulation.effort[simulation.joint_names.index(joint)] == (
                simulation.motion_forces[f'move_{joint}'])


@pytest.mark.parametrize('name, motions', [
    ('slider_crank', {'crank_joint': '0.4*sin(3*t) + 0.8'}),
    pytest.param('three_rrr', {'theta_1': '1.0467 + 0.2*sin(3*t)'}, marks=pytest.mark.slow),
    pytest.param('rssr_four_bar', {'crank': '0.5*t'}, marks=pytest.mark.slow)])
def test_work_of_the_drive_is_the_energy_gained(name, motions):
    simulation = moved(name, 'dop853', 0.01, **motions)
    simulation = Simulation.from_scene(simulation.scene, tolerance=1e-12)
    simulation.step(duration=0.5)
    balance = simulation.energy_balance
    assert abs(balance.work) > 1e-3
    assert abs(balance.residual) < 1e-9


def test_the_force_on_a_point_along_a_line_is_that_of_newton():
    # The ball is the centre of mass of a body that moves freely, with carriers.
    motion = PrescribedMotion('expression', point='ball', direction=(3.0, 4.0),
                              expression='0.1*t**2 + 0.02*sin(5*t)')
    simulation = simulated(flyer(), {'drive': motion, 'gravity': EARTH}, [0.0, 0.0, 0.3],
                           [0.06, 0.08, 1.0])
    simulation.step(duration=0.4)
    along = np.array([0.6, 0.8])
    place, rate, acceleration = motion.at(simulation.time)
    assert along @ simulation.point('ball') == pytest.approx(place, abs=1e-12)
    # The rail moves along x alone.
    inverse = along @ np.diag([1.0 / 1.5, 1.0 / 1.25]) @ along
    weight = -9.81 * along[1]
    assert simulation.motion_forces['drive'] == pytest.approx(
        (acceleration - weight) / inverse, rel=1e-9)
    assert simulation.velocity[2] == pytest.approx(1.0, abs=1e-12)
    assert_balanced(simulation, 1e-10)


def test_a_motion_that_starts_elsewhere_is_reported_and_the_loops_close_there():
    with pytest.warns(RuntimeWarning, match='crank_joint starts at 0.8, .* not at 1.0472'):
        simulation = moved('slider_crank', crank_joint='0.8 + 0*t')
    assert simulation.position[0] == pytest.approx(0.8, abs=1e-12)
    assert simulation.closure < 1e-12


def test_a_motion_beyond_a_limit_position_ends_with_time_and_reason():
    # The rocker of a crank-rocker swings through less than a turn.
    simulation = moved('four_bar', rocker_joint='1.727 + 2*t')
    with pytest.raises(MotionError, match=r't = [0-9.]+ s.*leads beyond a limit.*rocker_joint'):
        simulation.step(duration=3.0)
    assert 0.05 < simulation.time < 3.0
    assert np.isfinite(simulation.state).all()
    assert simulation.position[2] == pytest.approx(1.727 + 2.0 * simulation.time, abs=1e-3)


def test_error_control_ends_at_a_limit_position_too():
    simulation = moved('four_bar', integrator='dopri5', rocker_joint='1.727 + 2*t')
    with pytest.raises(MotionError, match=r'leads beyond a limit'):
        simulation.step(duration=3.0)


def test_motions_that_determine_one_another_are_refused():
    crank, _, rocker = Simulation.from_scene('four_bar').position
    with pytest.raises(AssemblyError, match='not free to move as prescribed by'):
        moved('four_bar', crank_joint=f'{float(crank)!r} + 0*t',
              rocker_joint=f'{float(rocker)!r} + 0*t')
    with pytest.raises(AssemblyError, match='effects.move_rocker_joint open by'):
        moved('four_bar', crank_joint=f'{float(crank)!r} + 0*t', rocker_joint='1.9 + 0*t')


def test_a_moved_joint_takes_no_torque():
    simulation = moved('three_rrr', theta_1='1.0467 + t**2')
    assert simulation.actuated_joints == ('theta_6', 'theta_7')
    with pytest.raises(ValueError, match='none of theta_1, whose motion move_theta_1 prescribes'):
        simulation.step({'theta_1': 1.0})
    simulation.step({'theta_6': 1.0, 'theta_7': -1.0})
    assert simulation.effort[simulation.joint_names.index('theta_6')] == 1.0


@pytest.mark.parametrize('integrator', ['auto', 'rk4'])
def test_a_slider_that_ends_at_its_dead_centre_is_reported(integrator):
    # Crank 0.1 m, rod 0.3 m: at 0.4 m both lie in line, and the crank would need any rate.
    profile = PrescribedMotion('table', joint='slider_joint', times=(0.0, 0.5, 1.0),
                               values=(0.337228, 0.37, 0.4))
    simulation = Simulation.from_scene('slider_crank', motion={'slider_joint': profile},
                                       integrator=integrator)
    with pytest.raises(MotionError, match='has led to a limit of the mechanism, such as a dead '
                                          'centre, where slider_joint can go no further'):
        simulation.step(duration=1.5)
    assert 0.99 < simulation.time < 1.01


@pytest.mark.parametrize('other', [
    Actuator('crank_joint'), PrescribedForce('constant', 'crank_joint', amplitude=1.0),
    PrescribedMotion('constant', joint='crank_joint')])
def test_a_joint_has_one_drive(other):
    crank = PrescribedMotion('constant_speed', joint='crank_joint', speed=4.0)
    with pytest.raises(FieldError, match='other'):
        with_effects('four_bar', drive=crank, other=other)


@pytest.mark.parametrize('keys, match', [
    ({'shape': 'constant_speed', 'joint': 'slide'}, 'speed'),
    ({'shape': 'constant_speed', 'joint': 'slide', 'speed': 1.0, 'period': 2.0}, 'period'),
    ({'shape': 'constant'}, 'neither'),
    ({'shape': 'constant', 'joint': 'slide', 'point': 'front', 'direction': (1.0, 0.0)}, 'both'),
    ({'shape': 'constant', 'point': 'front'}, 'direction'),
    ({'shape': 'constant', 'point': 'front', 'direction': (0.0, 0.0)}, 'not zero'),
    ({'shape': 'trapezoid', 'joint': 'slide', 'amplitude': 1.0, 'rise': 0.0}, 'rise'),
    ({'shape': 'trapezoid', 'joint': 'slide', 'amplitude': 1.0, 'rise': 1.0, 'ramp': 0.6}, 'ramp'),
    ({'shape': 'trapezoid', 'joint': 'slide', 'amplitude': 1.0, 'rise': 1.0, 'hold': 0.0,
      'period': 1.5}, 'period'),
    ({'shape': 'table', 'joint': 'slide', 'times': (0.0, 1.0), 'values': (0.0, 1.0),
      'period': 1.0}, 'the first value'),
    ({'shape': 'table', 'joint': 'slide', 'times': (0.0, 1.0, 0.5), 'values': (0.0, 1.0, 2.0)},
     'times that grow'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'abs(t - 1)'}, 'without corners'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'min(t, 1)'}, 'without corners'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'hypot(t - 1, 0)'},
     'without corners.*never zero, write sqrt'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'hypot(sin(t), 2*t)'},
     'without corners'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'x*t'}, 'unknown name'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'sqrt(t)'}, 'finite'),
    ({'shape': 'expression', 'joint': 'slide', 'expression': 'log(t)'}, 'finite')])
def test_what_is_no_motion_is_refused(keys, match):
    with pytest.raises(FieldError, match=match):
        PrescribedMotion(**keys)


def test_a_length_that_is_never_zero_is_a_motion():
    motion = PrescribedMotion('expression', joint='slide', expression='hypot(t - 1, 0.5)')
    for time in (0.0, 1.0, 1.7):
        place, rate, acceleration = motion.at(time)
        length = math.hypot(time - 1.0, 0.5)
        assert place == pytest.approx(length) and rate == pytest.approx((time - 1.0) / length)
        assert acceleration == pytest.approx(0.25 / length ** 3)


def test_independent_coordinates_are_refused():
    with pytest.raises(SimulationError, match='stabilisation: independent knows none'):
        Simulation.from_scene(
            with_effects('four_bar', drive=PrescribedMotion(
                'constant_speed', joint='crank_joint', speed=4.0)), stabilisation='independent')


def test_a_motion_changes_only_where_it_goes_on():
    motion = PrescribedMotion('cycloid', joint='slide', amplitude=1.0, rise=0.5, hold=2.0)
    simulation = simulated(block(), {'drive': motion}, [0.0])
    simulation.step(duration=0.25)
    for change, match in (({'amplitude': 2.0}, 'without a jump of its position'),
                          ({'enabled': False}, 'switched on'), ({'joint': 'slyde'}, 'joint')):
        with pytest.raises(FieldError, match=match):
            simulation.set_effect('drive', **change)
    simulation.step(duration=0.35)
    # At rest on top: it may go back earlier, and slower.
    simulation.set_effect('drive', hold=0.2, fall=0.6)
    simulation.step(duration=0.4)
    assert simulation.position[0] == pytest.approx(0.5, abs=1e-9)
    simulation.reset()
    assert simulation.position[0] == 0.0


def test_a_state_set_while_it_runs_is_where_the_motion_is():
    simulation = moved('four_bar', crank_joint='1.0472 + 4*t')
    simulation.step(duration=0.25)
    before = simulation.position
    simulation.set_state(before + np.array([0.3, -0.1, 0.2]))
    assert simulation.position[0] == pytest.approx(before[0], abs=1e-12)
    assert simulation.velocity[0] == pytest.approx(4.0, abs=1e-12)
    saved, time = simulation.state, simulation.time
    simulation.step(duration=0.1)
    there = simulation.state
    simulation.restore(saved, time)
    simulation.step(duration=0.1)
    assert np.array_equal(simulation.state, there)


SCENE = """
mechanism: four_bar
initial: {position: {crank_joint: 1.0472, coupler_joint: -0.5713, rocker_joint: 1.727}}
effects:
  drive: {type: prescribed_motion, joint: crank_joint, shape: table, file: crank.csv, ends: moving}
"""


def test_a_scene_file_names_a_table(tmp_path):
    times = np.linspace(0.0, 1.0, 11)
    (tmp_path / 'crank.csv').write_text(
        '\n'.join(f'{t},{1.0472 + t + t ** 3}' for t in times) + '\n')
    (tmp_path / 'scene.yaml').write_text(SCENE)
    simulation = Simulation.from_scene(tmp_path / 'scene.yaml')
    simulation.step(duration=0.37)
    # A cubic is its own spline.
    assert simulation.position[0] == pytest.approx(1.0472 + 0.37 + 0.37 ** 3, abs=1e-10)
    (tmp_path / 'scene.yaml').write_text(SCENE.replace('shape: table', 'shape: tables'))
    with pytest.raises(SceneError, match='effects.drive.shape'):
        load_scene(tmp_path / 'scene.yaml')


def test_python_moves_joints_by_expressions():
    simulation = Simulation.from_scene('four_bar', {'crank_joint': '1.0472 + 4*t'})
    simulation.step(duration=0.1)
    assert simulation.velocity[0] == pytest.approx(4.0, abs=1e-12)
    assert set(simulation.motion_forces) == {'motion_crank_joint'}
    with pytest.raises(FieldError, match='motion.crank_joint'):
        Simulation.from_scene('four_bar', {'crank_joint': '4*s'})
    with pytest.raises(FieldError, match='motion.crank'):
        Simulation.from_scene('four_bar', {'crank': '4*t'})
