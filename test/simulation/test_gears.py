# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Couplings, rods and pins in slots in the plane: laws of machines, and what is refused."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    AssemblyError, Body, Coupling, CutJoint, Joint, load_scene, Mechanism, MechanismError,
    read_mechanism, Simulation)
from closedloop_dynamics.codegen import space
from closedloop_dynamics.engine.types import CUT_COUPLING, CUT_DISTANCE, CUT_POINT_ON_LINE
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.recording.run import columns, row
import numpy as np
import pytest
import yaml

from ..reference.compare import assert_agree
from ..reference.formulations import dense_dynamics, FORMULATIONS
from ..reference.scenes import scene, simulated

ORIGIN = (0.0, 0.0)


def four_bar(couplings=(), cut='far', base=0.4):
    """Return a four-bar with crank 0.1, coupler 0.4 and rocker 0.2 m, cut at one of its pins."""
    bodies = (Body('crank', 1.0, (0.05, 0.0), 0.001), Body('coupler', 1.5, (0.2, 0.02), 0.02),
              Body('rocker', 0.8, (0.1, 0.0), 0.003))
    pins = {'near': ('crank', (0.1, 0.0), 'coupler'), 'far': ('rocker', (0.2, 0.0), 'coupler')}
    carrier, place, body = pins['near' if cut == 'far' else 'far']
    joints = (Joint('driven', 'revolute', 'ground', 'crank', ORIGIN, actuated=True),
              Joint('hinge', 'revolute', 'ground', 'rocker', (base, 0.0)),
              Joint('near' if cut == 'far' else 'far', 'revolute', carrier, body, place))
    ends = {'near': (0.0, 0.0), 'far': (0.4, 0.0)}
    if cut == 'near':
        # The coupler hangs on the rocker, its frame at that end.
        bodies = (bodies[0], replace(bodies[1], center_of_mass=(-0.2, 0.02)), bodies[2])
        ends = {'near': (-0.4, 0.0), 'far': ORIGIN}
    carrier, place, body = pins[cut]
    return Mechanism('four_bar', bodies, joints, (CutJoint(
        cut, 'revolute', body, carrier, ends[cut], place),), couplings=tuple(couplings))


def test_numbers_of_kinds_of_cut_joints_are_those_of_space():
    assert [space.CUT_TYPES[kind] for kind in (CUT_COUPLING, CUT_DISTANCE, CUT_POINT_ON_LINE)] == [
        'coupling', 'distance', 'point_on_line']


def geared(cut):
    """Return a simulation of a four-bar with a wheel that its far pin turns, however it is cut."""
    machine = four_bar(cut=cut)
    machine = replace(
        machine, bodies=(*machine.bodies, Body('wheel', 0.5, ORIGIN, 0.01)),
        joints=(*machine.joints, Joint('axle', 'revolute', 'ground', 'wheel', (0.0, 1.0))),
        couplings=(Coupling('gear', {'axle': 0.02, 'far': 0.05}, 0.1, radius=0.02),))
    start = {'far': (0.7, 1.2, -0.3, 0.0), 'near': (0.7, 1.2, -0.8, 0.0)}[cut]
    return simulated(machine, start, hold=('driven',), accuracy=1e-9)


def test_a_coupling_of_a_cut_joint_is_that_of_the_joint_in_the_tree():
    one, other = geared('far'), geared('near')
    for simulation in (one, other):
        simulation.step([0.3], duration=0.4)
    for name in ('driven', 'hinge', 'axle'):
        places = [simulation.joint_names.index(name) for simulation in (one, other)]
        for quantity in ('position', 'velocity', 'acceleration'):
            first, second = (getattr(simulation, quantity)[place]
                             for simulation, place in zip((one, other), places))
            assert first == pytest.approx(second, abs=1e-7)
    assert_agree(one.coupling_forces, other.coupling_forces, 1e-7)
    # A wheel alone: its inertia, and the force at its rim.
    alpha = one.acceleration[3]
    assert 0.02 * one.coupling_forces[0] == pytest.approx(0.01 * alpha, rel=1e-12)
    assert one.tooth_forces[0] == pytest.approx(0.01 * alpha / 0.02, rel=1e-12)
    values = dict(zip(columns(one), row(one, one.time)))
    assert values['tooth_force.gear'] == one.tooth_forces[0]
    assert values['coupling.gear'] == one.coupling_forces[0]
    assert abs(one.energy_balance.residual) < 1e-9
    # What the far pin turns, turns the wheel.
    poses = other.body_poses[:, 2]
    turn = poses[1] - poses[2]
    assert 0.02 * poses[3] + 0.05 * turn == pytest.approx(0.1, abs=1e-10)


@pytest.mark.parametrize('method', [
    {'stabilisation': 'independent', 'integrator': 'rk4'}, {'integrator': 'rodas4'}], ids=str)
def test_every_method_knows_couplings(method):
    one, other = (Simulation.from_scene('geared_five_bar', **method), Simulation.from_scene(
        'geared_five_bar', accuracy=1e-9))
    for simulation in (one, other):
        simulation.step(duration=0.1)
    # The tolerance of the default method, within 0.1 s.
    assert_agree(one.position, other.position, 1e-5)
    assert_agree(one.coupling_forces, other.coupling_forces, 1e-4)
    assert one.closure < 1e-9
    for formulation in FORMULATIONS:
        assert_agree(dense_dynamics(one, formulation)[0], one.acceleration, 1e-9)


def test_a_rollout_is_the_run():
    simulation = Simulation.from_scene('geared_five_bar', integrator='rk4')
    found = simulation.rollout(
        [[[0.1]], [[0.2]]], duration=0.05, quantities=('position', 'constraint_forces'))
    simulation.step([0.2], duration=0.05)
    assert_agree(found.position[1, -1], simulation.position, 1e-12)
    assert_agree(found.constraint_forces[1, -1], simulation.constraint_forces, 1e-9)


def test_a_coupling_that_locks_is_reported_with_its_rank():
    machine = four_bar([Coupling('gear', {'driven': 1.0, 'hinge': 2.0}, 3.1)])
    with pytest.warns(RuntimeWarning, match='Nothing can move: 3 of 3 equations .*: gear'):
        locked = Simulation.from_scene(scene(machine, (0.7, 1.2, -0.3)))
    assert locked.data.degrees_of_freedom() == 0
    locked.advance(locked.joint_torques([5.0]), 0)
    # Against the 1400 rad/s^2 of the crank alone.
    assert np.abs(locked.acceleration).max() < 1e-9


def test_couplings_that_contradict_one_another_are_named():
    machine = four_bar([Coupling('one', {'driven': 1.0, 'near': 1.0}, 0.4),
                        Coupling('other', {'driven': 1.0, 'near': 1.0}, 0.5)])
    with pytest.raises(AssemblyError, match='couplings.one open by .*couplings.other open by'):
        simulated(machine, (0.7, 1.2, -0.3))


def test_a_rod_is_the_bar_without_mass():
    # A pendulum's tip on a rod from the wall, against the same with a bar of almost no mass.
    arm = Body('arm', 1.0, (0.3, 0.0), 0.02)
    bar = Body('bar', 1e-9, (0.2, 0.0), 1e-12)
    joints = (Joint('hinge', 'revolute', 'ground', 'slider', ORIGIN),
              Joint('slide', 'prismatic', 'slider', 'arm', ORIGIN))
    slider = Body('slider', 0.5, ORIGIN, 0.01)
    with_rod = Mechanism('rod', (slider, arm), joints, (CutJoint(
        'rod', 'distance', 'arm', 'ground', (0.6, 0.0), (0.9, 0.5), length=0.5),))
    with_bar = Mechanism('bar', (slider, arm, bar), (
        *joints, Joint('pin', 'revolute', 'arm', 'bar', (0.6, 0.0))), (CutJoint(
            'rod', 'revolute', 'bar', 'ground', (0.5, 0.0), (0.9, 0.5)),))
    rod, bar = (simulated(machine, start, gravity=(0.0, -9.81), hold=('hinge',))
                for machine, start in ((with_rod, (0.1, 0.0)), (with_bar, (0.1, 0.0, 0.8))))
    assert_agree(rod.position, bar.position[:2], 1e-9)
    assert_agree(rod.acceleration, bar.acceleration[:2], 1e-6)
    # The rod's force lies along it, and the multiplier is that force.
    x, y, angle = rod.body_poses[1]
    along = np.array([x + 0.6 * math.cos(angle) - 0.9, y + 0.6 * math.sin(angle) - 0.5]) / 0.5
    assert_agree(rod.constraint_forces[0], [0.0, *(rod.multipliers[0] * along)], 1e-12)
    assert rod.multipliers[0] != 0.0


def test_a_pin_in_a_slot_is_a_block_without_mass():
    pendulum = Body('crank', 1.0, (0.1, 0.0), 0.01)
    lever = Body('lever', 2.0, (0.2, 0.0), 0.05)
    joints = (Joint('crank_joint', 'revolute', 'ground', 'crank', (0.0, 0.4), actuated=True),
              Joint('lever_joint', 'revolute', 'ground', 'lever', ORIGIN))
    slot = Mechanism('slot', (pendulum, lever), joints, (CutJoint(
        'slot', 'point_on_line', 'crank', 'lever', (0.15, 0.0), (0.05, 0.0), angle=0.0),))
    block = Body('block', 1e-9, ORIGIN, 1e-12)
    with_block = Mechanism('block', (pendulum, lever, block), (
        *joints, Joint('pin', 'revolute', 'crank', 'block', (0.15, 0.0))), (CutJoint(
            'slot', 'prismatic', 'block', 'lever', ORIGIN, (0.05, 0.0)),))
    one = simulated(slot, (0.3, 1.3), hold=('crank_joint',))
    other = simulated(with_block, (0.3, 1.3, 1.0), hold=('crank_joint',))
    for simulation in (one, other):
        simulation.advance(simulation.joint_torques([0.7]), 0)
    assert_agree(one.position, other.position[:2], 1e-9)
    assert_agree(one.acceleration, other.acceleration[:2], 1e-6)
    assert_agree(one.constraint_forces[0], other.constraint_forces[0], 1e-5)
    # Across the slot, without a moment.
    angle = one.position[1]
    moment, x, y = one.constraint_forces[0]
    assert abs(moment) < 1e-15 and abs(x * math.cos(angle) + y * math.sin(angle)) < 1e-12


@pytest.mark.parametrize('change, said', [
    ({'couplings': (Coupling('gear', {'driven': 1.0, 'pivot': 1.0}),)},
     'couplings.gear.joints.pivot: expected one of the joints'),
    ({'couplings': (Coupling('gear', {}),)}, 'couplings.gear.joints: expected at least one joint'),
    ({'couplings': (Coupling('gear', {'driven': 0.0}),)},
     'couplings.gear.joints.driven: expected a number that is not zero'),
    ({'couplings': (Coupling('gear', {'driven': 1.0}, radius=0.0),)},
     'couplings.gear.radius: expected'),
    ({'couplings': (Coupling('gear', {'far': 1.0, 'driven': -1.0, 'near': -1.0, 'hinge': 1.0}),)},
     'couplings.gear.joints: expected joints whose coordinates change the sum'),
    ({'cut_joints': (CutJoint('far', 'fixed', 'coupler', 'rocker', (0.4, 0.0), (0.2, 0.0)),),
      'couplings': (Coupling('gear', {'far': 1.0}),)},
     'couplings.gear.joints.far: expected a joint of one degree of freedom: .* got a fixed '
     'cut joint'),
    ({'cut_joints': (CutJoint('far', 'distance', 'coupler', 'rocker', ORIGIN, ORIGIN),)},
     'cut_joints.far.length: expected this key of a distance joint'),
    ({'cut_joints': (CutJoint('far', 'revolute', 'coupler', 'rocker', ORIGIN, ORIGIN,
                              length=0.1),)},
     'cut_joints.far.length: expected no such key of a revolute joint'),
    ({'cut_joints': (CutJoint('far', 'distance', 'coupler', 'rocker', ORIGIN, ORIGIN, 0.3,
                              length=0.1),)},
     'cut_joints.far.angle: expected no angle in a distance cut joint'),
], ids=str)
def test_what_cannot_be_is_refused(change, said):
    with pytest.raises(MechanismError, match=said):
        validate_mechanism(replace(four_bar(), **change))


def test_a_rack_has_no_radius():
    bodies = (Body('rack', 1.0, ORIGIN, 0.1), Body('wheel', 1.0, ORIGIN, 0.1))
    machine = Mechanism('rack', bodies, (
        Joint('slide', 'prismatic', 'ground', 'rack', ORIGIN),
        Joint('axle', 'revolute', 'ground', 'wheel', ORIGIN)),
        couplings=(Coupling('mesh', {'slide': 1.0, 'axle': -0.1}, radius=0.1),))
    with pytest.raises(MechanismError, match='couplings.mesh.radius: expected no radius'):
        validate_mechanism(machine)


def test_a_joint_between_bodies_may_be_cut_where_it_is_coupled(tmp_path):
    # The coordinate counts from the same angle, cut or not.
    data = {'name': 'four_bar', 'bodies': {
        name: {'mass': 1.0, 'center_of_mass': [0.1, 0.0], 'inertia': 0.01}
        for name in ('crank', 'coupler', 'rocker', 'wheel')}, 'joints': {
        'driven': {'type': 'revolute', 'between': ['ground', 'crank'],
                   'points': [[0.0, 0.0], [0.0, 0.0]]},
        'near': {'type': 'revolute', 'between': ['crank', 'coupler'],
                 'points': [[0.1, 0.0], [0.0, 0.0]]},
        'far': {'type': 'revolute', 'between': ['coupler', 'rocker'], 'angle': 0.25,
                'points': [[0.4, 0.0], [0.2, 0.0]]},
        'hinge': {'type': 'revolute', 'between': ['ground', 'rocker'],
                  'points': [[0.4, 0.0], [0.0, 0.0]]},
        'axle': {'type': 'revolute', 'between': ['ground', 'wheel'],
                 'points': [[0.0, 1.0], [0.0, 0.0]]}},
        'couplings': {'gear': {'joints': {'axle': 1.0, 'far': 2.0}, 'offset': 0.5}}}
    turns = []
    for cut in ('far', 'hinge'):
        for name in ('near', 'far', 'hinge'):
            data['joints'][name]['cut'] = name == cut
        path = tmp_path / f'{cut}.yaml'
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        machine = read_mechanism(path)
        assert machine.tree.cut == (cut,)
        start = {'driven': 0.7, 'near': -0.4, 'far': 0.6, 'hinge': 1.2, 'axle': 0.0}
        one = simulated(machine, [start[name] for name in machine.joint_names], hold=('driven',))
        poses = dict(zip((body.name for body in machine.bodies), one.body_poses[:, 2]))
        turns.append(poses['wheel'] + 2.0 * (poses['rocker'] - poses['coupler'] - 0.25) - 0.5)
    # Whole turns of a body aside.
    assert [abs(math.sin(0.25 * turn)) < 1e-10 for turn in turns] == [True, True]


def open_four_bar(directory, **effects):
    """Write a four-bar whose joints are all between bodies, and a scene of it; return its path."""
    data = {'name': 'open', 'bodies': {
        name: {'mass': 1.0, 'center_of_mass': [0.1, 0.0], 'inertia': 0.01}
        for name in ('crank', 'coupler', 'rocker')}, 'joints': {
        'driven': {'type': 'revolute', 'between': ['ground', 'crank'],
                   'points': [[0.0, 0.0], [0.0, 0.0]]},
        'near': {'type': 'revolute', 'between': ['crank', 'coupler'],
                 'points': [[0.1, 0.0], [0.0, 0.0]]},
        'far': {'type': 'revolute', 'between': ['coupler', 'rocker'],
                'points': [[0.4, 0.0], [0.2, 0.0]]},
        'hinge': {'type': 'revolute', 'between': ['ground', 'rocker'],
                  'points': [[0.4, 0.0], [0.0, 0.0]]}}}
    (directory / 'open.yaml').write_text(yaml.safe_dump(data, sort_keys=False))
    path = directory / 'scene.yaml'
    path.write_text(yaml.safe_dump({
        'mechanism': 'open.yaml', 'initial': {
            'position': {'driven': 0.7, 'near': -0.4, 'far': 1.6, 'hinge': 1.2},
            'hold': ['driven']},
        'effects': {'gravity': {'type': 'gravity', 'acceleration': [0.0, -9.81]}, **effects}}))
    return path


@pytest.mark.parametrize('joint', ['near', 'far', 'hinge'])
def test_what_acts_in_a_joint_may_act_in_any(tmp_path, joint):
    damper = {'type': 'joint_damping', 'joint': joint, 'coefficient': 0.3}
    one = Simulation.from_scene(open_four_bar(tmp_path, damper=damper), accuracy=1e-8)
    assert joint in one.joint_names and len(one.joint_names) == 3
    start = one.energy
    one.step(duration=0.3)
    # All that is lost goes into the damper, whichever joint is cut.
    assert one.energy_balance.dissipated > 1e-3
    assert start - one.energy == pytest.approx(one.energy_balance.dissipated, abs=1e-7)


def test_joints_that_effects_name_are_cut_where_a_loop_leaves_no_other(tmp_path):
    names = ('near', 'far', 'hinge')
    for keys in ({'type': 'rotor', 'inertia': 0.3}, {'type': 'joint_damping', 'coefficient': 0.3}):
        found = load_scene(open_four_bar(tmp_path, **{
            name: {'joint': name, **keys} for name in names})).mechanism
        assert len(found.cut_joints) == 1 and found.cut_joints[0].name in names
    # Rather that of a damper than that of a rotor.
    found = load_scene(open_four_bar(tmp_path, **{
        name: {'joint': name, 'type': 'rotor', 'inertia': 0.3} if name != 'far' else {
            'joint': name, 'type': 'joint_damping', 'coefficient': 0.3} for name in names}))
    assert found.mechanism.cut_joints[0].name == 'far'
