# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects and drives act at cut joints as in the tree, and their coordinates are measured."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    Body, codegen, CutJoint, Joint, Mechanism, MechanismError, Method, read_mechanism)
from closedloop_dynamics.codegen.spatial import rotation
from closedloop_dynamics.effects.registry import (
    Actuator, EndStop, ForceTable, Gravity, JointDamping, JointFriction, JointSpring,
    PrescribedForce, PrescribedMotion, Rotor, Sensor)
from closedloop_dynamics.formats.mjcf_writing import mjcf
from closedloop_dynamics.formats.sdf_writing import sdf
from closedloop_dynamics.formats.urdf_writing import urdf_with_loops
from closedloop_dynamics.mechanism.checks import orientation
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest
import yaml

from ..reference.scenes import simulated

METHOD = Method(integrator='rk4', step_size=2e-4)
# Joints of the four-bar with both bodies, their places in these, and angles at zero; the slide of
# the slider-crank is along x.
PINS = {'crank_joint': ('ground', 'crank', (0.0, 0.0), (0.0, 0.0), 0.0),
        'near': ('crank', 'coupler', (0.1, 0.0), (-0.175, 0.0), 0.0),
        'far': ('coupler', 'rocker', (0.175, 0.0), (0.25, 0.0), 0.3),
        'rocker_joint': ('ground', 'rocker', (0.4, 0.0), (0.0, 0.0), 0.0)}
GUIDE = {'crank_joint': PINS['crank_joint'], 'near': PINS['near'],
         'far': ('coupler', 'rocker', (0.175, 0.0), (0.02, 0.01), 0.3),
         'slide': ('ground', 'rocker', (0.1, 0.05), (0.0, 0.0), 0.2)}
# The same with the coupler on the rocker.
TURNING = {**PINS, 'far': ('rocker', 'coupler', (0.25, 0.0), (0.175, 0.0), -0.3)}
START = {'crank_joint': 1.0, 'near': -0.5, 'far': 0.9, 'rocker_joint': 1.6, 'slide': 0.3}
# What makes the table of effects of the same kind in all tests: each kind is compiled by itself.
FURNITURE = {'stop': EndStop('crank_joint', 10.0, lower=-100.0),
             'table': ForceTable((0.0, 1.0), (0.0, 0.0), 'crank_joint')}
# The whole world is turned so, where a plane is in space.
TURN = {'rpy': [0.4, -0.7, 1.1]}
BASE = orientation(TURN)


def mechanism(tmp_path, pins, cut, actuated, spatial=False):
    """Return a machine that is described the same whichever of its joints is cut."""
    masses = {'crank': (0.5, 0.05, 4e-4), 'coupler': (1.0, 0.0, 0.01),
              'rocker': (0.8, 0.125, 4e-3)}
    data = {'name': 'machine', 'bodies': {}, 'joints': {}}
    for name, (mass, center, inertia) in masses.items():
        data['bodies'][name] = {'mass': mass, 'center_of_mass': [center, 0.0], 'inertia': inertia}
        if spatial:
            data['bodies'][name]['center_of_mass'].append(0.0)
            data['bodies'][name]['inertia'] = [1e-4, inertia, inertia]
    for name, (first, second, *places, angle) in pins.items():
        keys = {'type': 'prismatic' if name == 'slide' else 'revolute', 'between': [first, second],
                'points': [list(place) for place in places], 'cut': name == cut,
                'actuated': name == actuated}
        if spatial:
            keys['axis'] = [1, 0, 0] if name == 'slide' else [0, 0, 1]
            keys['points'] = [[*place, 0.0] for place in keys['points']]
            keys['orientation'] = {'rpy': [0.0, 0.0, angle]}
            if first == 'ground':
                keys['between'][0] = 'frame'
        else:
            keys['angle'] = angle
        data['joints'][name] = keys
    if spatial:
        data['bodies']['frame'] = {
            'mass': 1.0, 'center_of_mass': [0.0, 0.0, 0.0], 'inertia': [1.0, 1.0, 1.0]}
        data['joints']['base'] = {'type': 'fixed', 'parent': 'ground', 'child': 'frame',
                                  'position': [0.3, -0.2, 0.5], 'orientation': TURN}
    path = tmp_path / f'{cut}_{spatial}.yaml'
    path.write_text(yaml.safe_dump(data))
    return read_mechanism(path)


def simulation(machine, effects, spin=0.0, start=START, turned=None):
    """Return a simulation that starts with the crank held."""
    return simulated(
        machine, {name: start[name] for name in machine.coordinates.names}, {'crank_joint': spin},
        {**FURNITURE, **effects}, hold=('crank_joint',), turned=turned, method=METHOD)


def motion(sim, torque=None, duration=0.5, instants=10):
    """Return positions, velocities, accelerations and efforts of all joints over time, by name."""
    names = [*sim.joint_names, *sim.cut_joint_names]
    order = [names.index(name) for name in START if name in names]
    found = []
    for instant in range(instants + 1):
        if instant:
            sim.step(torque, duration / instants)
        found.append([np.concatenate(pair)[order] for pair in (
            (sim.position, sim.cut_position), (sim.velocity, sim.cut_velocity),
            (sim.acceleration, sim.cut_acceleration), (sim.effort, sim.cut_effort))])
    return np.array(found)


ALL = {'spring': JointSpring('far', 3.0, 1.0),
       'damper': JointDamping('far', 0.05),
       'stop': EndStop('far', 200.0, 0.7, 1.1, 0.1),
       'friction': JointFriction('far', 0.1, 1.2, 0.01, 0.2, 0.02),
       'drive': Actuator('far', 1.5, lag=0.01),
       'force': PrescribedForce('sine', 'far', amplitude=0.5, frequency=2.0),
       'table': ForceTable((0.0, 1.0, 2.0), (0.5, 0.0, -1.0), 'far', damping=0.01)}


@pytest.mark.parametrize('pins, spatial', [
    (PINS, False), (PINS, True), (GUIDE, False), (GUIDE, True)])
def test_what_acts_at_a_cut_joint_acts_as_in_the_tree(tmp_path, pins, spatial):
    joint = list(pins)[-1] if pins is GUIDE else 'far'
    scale = 10.0 if joint == 'slide' else 1.0
    effects = {name: replace(effect, joint=joint) for name, effect in ALL.items()}
    if joint == 'slide':
        effects['stop'] = EndStop('slide', 2000.0, 0.2, 0.32, 0.1)
    # Gravity of the plane, in the frame that is turned.
    effects['gravity'] = Gravity((0.0, -9.81))
    sims = []
    for cut in (joint, 'far' if joint == 'slide' else 'rocker_joint'):
        machine = mechanism(tmp_path, pins, cut, joint, spatial)
        if spatial:
            effects['gravity'] = Gravity(tuple(-9.81 * np.array(rotation(BASE))[:, 1]))
            # Forces across the plane are shared among the pins in no unique way.
            effects['friction'] = replace(effects['friction'], friction_coefficient=0.0)
        sims.append(simulation(machine, effects))
    cut, tree = (motion(sim, {joint: 2.0 * scale}) for sim in sims)
    assert sims[0].cut_joint_names == (joint,)
    np.testing.assert_allclose(cut[:, :2], tree[:, :2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(cut[:, 2], tree[:, 2], rtol=1e-8, atol=1e-7)
    np.testing.assert_allclose(cut[:, 3], tree[:, 3], rtol=0.0, atol=1e-9)
    if not spatial:
        # What the first body exerts on the second, with what acts in the joint.
        np.testing.assert_allclose(*(sim.force(joint) for sim in sims), rtol=1e-7, atol=1e-7)
    for sim in sims:
        balance = sim.energy_balance
        assert abs(balance.work) > 0.01 and balance.dissipated > 0.01
        # What steps that end in no stop miss.
        assert abs(balance.residual) < 1e-5
    for name in effects:
        for key, value in sims[0].effect_readings(name).items():
            assert value == pytest.approx(sims[1].effect_readings(name)[key], rel=1e-6, abs=1e-7)


def largest_difference(directory):
    """Return by how much motions of a few steps differ."""
    sims = [simulation(mechanism(directory, PINS, cut, 'far'), ALL, 2.0)
            for cut in ('far', 'rocker_joint')]
    cut, tree = (motion(sim, {'far': 2.0}, 0.002, 2) for sim in sims)
    return np.abs(cut - tree)[:, :2].max()


@pytest.fixture
def by_loops(monkeypatch):
    """Unroll nothing."""
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_IN_PLANE', 0)
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', 0)


def test_loops_over_bodies_know_cut_joints_too(tmp_path, by_loops):
    assert largest_difference(tmp_path) < 1e-10


def test_a_cut_joint_under_friction_rests_as_in_the_tree(tmp_path):
    effects = {'gravity': Gravity((0.0, -9.81)), 'friction': JointFriction('far', 2.0, 1.2),
               'other': JointFriction('rocker_joint', 0.01),
               'spring': JointSpring('crank_joint', 40.0, 1.0)}
    moved = {}
    for cut in ('far', 'rocker_joint'):
        sim = simulation(mechanism(tmp_path, PINS, cut, 'crank_joint'), effects, spin=3.0)
        found = motion(sim, duration=1.0, instants=20)
        readings = sim.effect_readings('friction')
        moved[cut] = found[:, :3], readings['torque'], sim.force('rocker_joint')
        place = [name for name in START if name in PINS].index('far')
        # It comes to rest and stays there, while the drive's torque is less than friction.
        rest = found[12:, :, place]
        assert np.ptp(rest[:, 0]) < 1e-12 and np.abs(rest[:, 1:3]).max() < 1e-9
        assert 0.1 < abs(readings['torque']) < 2.4
        assert abs(sim.energy_balance.residual) < 1e-7
    one, other = moved['far'], moved['rocker_joint']
    np.testing.assert_allclose(one[0][:, :2], other[0][:, :2], rtol=0.0, atol=1e-9)
    assert one[1] == pytest.approx(other[1], abs=1e-7)
    np.testing.assert_allclose(one[2], other[2], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize('spatial', [False, True])
def test_turns_of_a_cut_joint_are_counted_where_anything_acts(tmp_path, spatial):
    effects = {'spring': JointSpring('near', 0.01, 0.0)}
    machine = mechanism(tmp_path, TURNING, 'near', 'crank_joint', spatial)
    turns = {'near': -4.0 * math.pi - 0.5} if spatial else {}
    sim, bare = (simulation(machine, each, 30.0, {**START, 'far': -0.9}, turns)
                 for each in (effects, {}))
    begun = -4.0 * math.pi if spatial else 0.0
    assert abs(sim.cut_position[0] - begun) <= math.pi
    crank = sim.joint_names.index('crank_joint')
    for _ in range(40):
        sim.step(None, 0.025)
        bare.step(None, 0.025)
    turned = sim.position[crank]
    assert turned > 4.0 * math.pi
    # The coupler only swings: seen from the crank it has turned back.
    assert sim.cut_position[0] + turned == pytest.approx(begun, abs=math.pi)
    assert sim.effect_readings('spring')['stored_energy'] == pytest.approx(
        0.005 * sim.cut_position[0] ** 2, rel=1e-12)
    assert abs(sim.energy_balance.residual) < 1e-6
    # Where nothing acts, in space, only the angle is known.
    assert (abs(bare.cut_position[0]) <= math.pi) == spatial
    before = sim.state
    sim.step(None, 0.1)
    sim.restore(before, 1.0)
    assert sim.cut_position[0] + turned == pytest.approx(begun, abs=math.pi)
    sim.reset()
    assert abs(sim.cut_position[0] - begun) <= math.pi


def geared(directory, pins, joint, cut, spatial, motion=None):
    """
    Return a simulation with a wheel that a joint turns, whichever joint is cut.

    The wheel is on the coupler; the joint moves as prescribed, or not.
    """
    mechanism(directory, pins, cut, 'crank_joint', spatial)
    path = directory / f'{cut}_{spatial}.yaml'
    data = yaml.safe_load(path.read_text())
    flat, moment = [0.0] * spatial, 2e-3
    data['bodies']['wheel'] = {'mass': 0.3, 'center_of_mass': [0.01, 0.02, *flat],
                               'inertia': [1e-3, 1e-3, moment] if spatial else moment}
    data['joints']['wheel_joint'] = {
        'type': 'revolute', 'parent': 'coupler', 'child': 'wheel', 'position': [0.05, 0.1, *flat],
        **({'axis': [0, 0, 1]} if spatial else {})}
    data['couplings'] = {'gear': {
        'joints': {'wheel_joint': -2.0, joint: 1.5}, 'offset': 1.5 * START[joint] - 0.4}}
    path.write_text(yaml.safe_dump(data))
    gravity = -9.81 * np.array(rotation(BASE))[:, 1] if spatial else (0.0, -9.81)
    effects = {'gravity': Gravity(tuple(gravity))}
    if motion:
        effects['drive'] = PrescribedMotion('expression', joint=joint, expression=motion)
    return simulation(read_mechanism(path), effects, 0.0 if motion else 2.0,
                      {**START, 'wheel_joint': 0.2})


def driven(directory, pins, joint, spatial, moved, duration=0.4, instants=5):
    """Return motions and simulations of such a machine, its joint cut and in the tree."""
    profile = '0.29 + 0.02*sin(4*t)' if joint == 'slide' else '0.9 + 0.3*sin(4*t)'
    sims = [geared(directory, pins, joint, cut, spatial, profile if moved else None)
            for cut in (joint, 'far' if joint == 'slide' else 'rocker_joint')]
    return [motion(sim, None if moved else {'crank_joint': 0.5}, duration, instants)
            for sim in sims], sims


@pytest.mark.parametrize('pins, spatial, moved', [
    (GUIDE, False, True), (PINS, True, True), *(
        pytest.param(*case, marks=pytest.mark.slow) for case in (
            (PINS, False, True), (GUIDE, True, True), (GUIDE, False, False), (PINS, True, False),
            (GUIDE, True, False)))])
def test_a_cut_joint_is_moved_and_coupled_as_in_the_tree(tmp_path, pins, spatial, moved):
    joint = list(pins)[-1] if pins is GUIDE else 'far'
    (cut, tree), sims = driven(tmp_path, pins, joint, spatial, moved)
    np.testing.assert_allclose(cut[:, :2], tree[:, :2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(cut[:, 2:], tree[:, 2:], rtol=1e-8, atol=1e-7)
    assert sims[0].coupling_forces == pytest.approx(sims[1].coupling_forces, rel=1e-7)
    assert abs(sims[0].coupling_forces[0]) > 1e-3
    if moved:
        assert sims[0].cut_effort == pytest.approx([sims[0].motion_forces['drive']])
        assert sims[0].effect_readings('drive')['power'] == pytest.approx(
            sims[1].effect_readings('drive')['power'], rel=1e-7)
    if not spatial:
        for name in (*pins, 'wheel_joint'):
            one, other = (sim.force(name) for sim in sims)
            # The other body is the child where the tree was built from the other end.
            if name != joint and not np.allclose(one[1:], other[1:], atol=1e-6):
                other = -other
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7)
    for sim in sims:
        assert abs(sim.energy_balance.work) > 1e-3
        assert abs(sim.energy_balance.residual) < 1e-9


def with_rotor(directory, pins, joint, spatial, duration, instants):
    """Return motions and simulations with a rotor and friction, its joint cut and in the tree."""
    gravity = -9.81 * np.array(rotation(BASE))[:, 1] if spatial else (0.0, -9.81)
    effects = {'gravity': Gravity(tuple(gravity)), 'rotor': Rotor(joint, 2e-3, 3.0),
               'brake': JointFriction('crank_joint', 0.2, 1.2)}
    sims = [simulation(mechanism(directory, pins, cut, 'crank_joint', spatial), effects, 3.0)
            for cut in (joint, 'far' if joint == 'slide' else 'rocker_joint')]
    return [motion(sim, {'crank_joint': 0.3}, duration, instants) for sim in sims], sims


@pytest.mark.parametrize('pins, joint, spatial', [
    (PINS, 'far', False), pytest.param(GUIDE, 'slide', True, marks=pytest.mark.slow)])
def test_a_rotor_at_a_cut_joint_turns_as_in_the_tree(tmp_path, pins, joint, spatial):
    (cut, tree), sims = with_rotor(tmp_path, pins, joint, spatial, 0.5, 10)
    np.testing.assert_allclose(cut[:, :2], tree[:, :2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(cut[:, 2], tree[:, 2], rtol=1e-8, atol=1e-7)
    first, second = (sim.energy_balance for sim in sims)
    assert first.kinetic == pytest.approx(second.kinetic, abs=1e-10)
    assert abs(first.residual) < 1e-7
    rate = sims[0].cut_velocity[0]
    assert sims[0].effect_readings('rotor')['kinetic_energy'] == pytest.approx(
        0.5 * 9.0 * 2e-3 * rate ** 2, rel=1e-12)
    acceleration, _ = sims[0].forward_dynamics(sims[0].position, sims[0].velocity, [4.0])
    torque, _ = sims[0].inverse_dynamics(sims[0].position, sims[0].velocity, acceleration)
    again, _ = sims[1].inverse_dynamics(
        sims[1].position, sims[1].velocity, sims[1].forward_dynamics(
            sims[1].position, sims[1].velocity, [4.0])[0])
    assert torque == pytest.approx(again, abs=1e-7)


def largest_error_of_rotors(directory):
    """Return the largest difference between a rotor's joint cut and not cut, by loops."""
    return max(np.abs(cut - tree)[:, :2].max() for (cut, tree), _ in (
        with_rotor(directory, *case, 0.0004, 1) for case in (
            (PINS, 'far', False), (GUIDE, 'slide', False), (GUIDE, 'slide', True))))


def test_loops_over_bodies_know_rotors_at_cut_joints(tmp_path, by_loops):
    assert largest_error_of_rotors(tmp_path) < 1e-11


def largest_error_of_loops(directory):
    """Return the largest difference between cut and not cut, of all."""
    return max(np.abs(cut - tree)[:, :2].max() for (cut, tree), _ in (
        driven(directory, pins, joint, spatial, moved, 0.0004, 1)
        for pins, joint in ((GUIDE, 'slide'), (PINS, 'far'))
        for spatial in (False, True) for moved in (False, True)))


def test_loops_over_bodies_move_and_couple_cut_joints_too(tmp_path, by_loops):
    assert largest_error_of_loops(tmp_path) < 1e-11


def test_inverse_dynamics_finds_the_torque_of_a_cut_joint(tmp_path):
    machine = mechanism(tmp_path, PINS, 'far', 'far')
    sim = simulation(machine, {'gravity': Gravity((0.0, -9.81)),
                               'damper': JointDamping('far', 0.1)}, spin=2.0)
    assert sim.actuated_joints == ('far',)
    acceleration, multipliers = sim.forward_dynamics(sim.position, sim.velocity, [1.7])
    torque, same = sim.inverse_dynamics(sim.position, sim.velocity, acceleration)
    np.testing.assert_allclose(torque, [1.7], rtol=1e-9)
    np.testing.assert_allclose(same, multipliers, rtol=1e-8, atol=1e-9)


def test_a_screw_that_is_cut_is_a_screw():
    lead, torque = 0.05, 0.3
    body = Body('nut', 2.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.02))
    guide = Joint('guide', 'cylindrical', 'ground', 'nut', (0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    screw = CutJoint('screw', 'helical', 'nut', 'ground', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0),
                     axis_b=(0.0, 0.0, 1.0), lead=lead, actuated=True)
    machine = Mechanism('screw', (body,), (guide,), (screw,))
    sim = simulated(machine, (0.5, 0.5 * lead), None, {
        'stop': EndStop('guide.1', 10.0, lower=-100.0),
        'table': ForceTable((0.0, 1.0), (0.0, 0.0), 'screw')}, method=METHOD)
    for _ in range(4):
        sim.step([torque], 0.25)
    rate = torque / (0.02 + 2.0 * lead ** 2)
    np.testing.assert_allclose(sim.cut_acceleration, [rate], rtol=1e-9)
    np.testing.assert_allclose(sim.cut_velocity, [rate], rtol=1e-9)
    np.testing.assert_allclose(sim.cut_position, [0.5 + 0.5 * rate], rtol=1e-9)
    assert sim.cut_effort.tolist() == [torque]
    assert sim.energy_balance.work == pytest.approx(torque * 0.5 * rate, rel=1e-9)


def test_a_scene_that_names_no_cut_joint_computes_none(tmp_path):
    machine = mechanism(tmp_path, PINS, 'far', 'crank_joint')
    sim = simulation(machine, {'gravity': Gravity((0.0, -9.81))})
    assert len(sim.data.system.effects.cuts.index) == 0 and sim.torque_names == sim.joint_names
    assert len(sim.data.integrated) == 2 * 3 + 2
    assert sim.cut_joint_names == ('far',) and len(sim.cut_position) == 1


def test_sensors_measure_cut_joints_with_noise_of_their_own(tmp_path):
    machine = mechanism(tmp_path, PINS, 'far', 'crank_joint')
    sim = simulation(machine, {'sensor': Sensor(position_noise=0.01, velocity_bias=0.5)})
    tree, (position, velocity) = sim.measured(), sim.data.measured_cut_joints()
    assert 1e-5 < abs(position[0] - sim.cut_position[0]) < 0.05
    assert velocity[0] == sim.cut_velocity[0] + 0.5
    # What is asked of the one does not change the other.
    sim.reset()
    assert all(np.array_equal(*pair) for pair in zip(tree, sim.measured()))


@pytest.mark.parametrize('effect, said', [
    (Actuator('far'), 'effects.one.joint: expected one of the actuated joints crank_joint'),
    (JointSpring('fra', 1.0), "effects.one.joint: .*'fra'.*did you mean 'far'")])
def test_what_cannot_act_at_a_cut_joint_is_refused(tmp_path, effect, said):
    with pytest.raises(FieldError, match=said):
        simulation(mechanism(tmp_path, PINS, 'far', 'crank_joint'), {'one': effect})


def test_a_rotor_in_space_whose_carrier_turns_is_not_cut(tmp_path):
    machine = mechanism(tmp_path, PINS, 'far', 'crank_joint', spatial=True)
    with pytest.raises(FieldError, match='effects.one.joint: .*body_b does not turn, got .*far'):
        simulation(machine, {'one': Rotor('far', 0.1)})
    # As other programs have it, without the turning of the carrier.
    simulation(machine, {'one': Rotor('far', 1e-25, 1e12)})


def test_effects_move_only_to_cut_joints_that_anything_acted_in(tmp_path):
    sim = simulation(mechanism(tmp_path, PINS, 'far', 'crank_joint'), {
        'spring': JointSpring('near', 1.0)})
    with pytest.raises(FieldError, match='effects.spring.joint: .*load a scene where it does'):
        sim.set_effect('spring', joint='far')


@pytest.mark.parametrize('write', [mjcf, sdf, urdf_with_loops])
def test_other_formats_have_no_drive_where_a_loop_is_closed(tmp_path, write):
    with pytest.raises(MechanismError, match='cut_joints.far: expected no drive and no effect'):
        write(mechanism(tmp_path, PINS, 'far', 'far'))
    machine = mechanism(tmp_path, PINS, 'far', 'crank_joint')
    with pytest.raises(MechanismError, match='cut_joints.far: expected no drive and no effect'):
        write(machine, {'spring': {'type': 'joint_spring', 'joint': 'far', 'stiffness': 1.0}})
    assert write(machine).startswith('<')
