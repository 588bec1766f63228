# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What acts at cut joints of several freedoms acts as in the tree, and is reported the same."""

from dataclasses import replace

from closedloop_dynamics import (
    Body, CutJoint, Joint, Mechanism, MechanismError, Method, read_mechanism)
from closedloop_dynamics.effects.registry import (
    Actuator, EndStop, ForceTable, Gravity, JointDamping, JointFriction, JointSpring,
    PrescribedMotion, Rotor)
from closedloop_dynamics.mechanism.cut_freedoms import cut_freedoms
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.reader import validate_mechanism
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import yaml

from ..reference import cases
from ..reference.scenes import simulated

METHOD = Method(integrator='rk4', step_size=5e-4)
# Three legs between a frame that turns and a plate. Where joints and bodies are as drawn:
PLACES = {'base': (0.0, 0.1, 0.0), 'hip': (0.0, 0.0, 0.1), 'table': (0.6, 0.1, 0.0),
          'ball': (0.2, 0.7, -0.1), 'rod_1': (0.1, 0.2, 0.5), 'rod_2': (0.7, 0.0, 0.6),
          'rod_3': (0.3, 0.5, 0.4)}
# How their frames are turned, and where they are.
BODIES = {'frame': ((0.3, -0.5, 0.2), (0.2, 0.1, 0.0)),
          'thigh': ((-0.4, 0.1, 0.8), (0.1, 0.1, 0.3)),
          'sled': ((0.6, 0.3, -0.7), (0.7, 0.1, 0.3)),
          'swing': ((0.1, -0.9, 0.4), (0.2, 0.6, 0.2)),
          'plate': ((-0.2, 0.5, 0.3), (0.3, 0.3, 0.6))}
JOINTS = {'base': ('ground', 'frame', 'revolute', {'axis': [0.0, 0.6, 0.8]}),
          'hip': ('frame', 'thigh', 'universal',
                  {'axis': [0, 1, 0], 'second_axis': [0.6, 0, 0.8]}),
          'table': ('frame', 'sled', 'planar', {}), 'ball': ('frame', 'swing', 'spherical', {}),
          'rod_1': ('thigh', 'plate', 'cylindrical', {'axis': [0.8, 0.6, 0]}),
          'rod_2': ('sled', 'plate', 'cylindrical', {'axis': [0, 0.28, 0.96]}),
          'rod_3': ('swing', 'plate', 'cylindrical', {'axis': [0, -1, 0]})}
# Ways to cut the two loops.
IN_TREE, CUTS = ('rod_1', 'rod_2'), (('hip', 'table'), ('ball', 'rod_2'))
FREEDOMS = ('base', 'hip.1', 'hip.2', 'table.x', 'table.y', 'table.angle', 'rod_1.1', 'rod_1.2',
            'rod_2.1', 'rod_2.2', 'rod_3.1', 'rod_3.2')
RATES = ('ball.rx', 'ball.ry', 'ball.rz')
TORQUE = {'base': 1.0, 'hip.1': 1.0, 'hip.2': -0.8, 'table.x': 2.0, 'table.y': -3.0,
          'table.angle': 0.3, 'rod_1.1': -0.5, 'rod_1.2': 4.0, 'rod_2.1': 0.1, 'rod_2.2': -2.0,
          'ball.rx': 0.2, 'ball.ry': -0.1, 'ball.rz': 0.3}


def machine(directory, cut):
    """Return a mechanism that is described the same whichever joints are cut."""
    frames = {'ground': Rotation.identity(), **{
        body: Rotation.from_euler('xyz', angles) for body, (angles, _) in BODIES.items()}}
    origins = {'ground': np.zeros(3), **{body: np.array(at) for body, (_, at) in BODIES.items()}}
    data = {'name': 'machine', 'joints': {}, 'bodies': {
        body: {'mass': 1.0, 'center_of_mass': [0.0, 0.0, 0.0],
               'inertia': [0.02, 0.03, 0.04, 0.002, -0.003, 0.001]} for body in BODIES}}
    for name, (first, second, kind, keys) in JOINTS.items():
        data['joints'][name] = {
            'type': kind, 'between': [first, second], 'cut': name in cut,
            'actuated': name != 'rod_3',
            'points': [frames[body].inv().apply(PLACES[name] - origins[body]).tolist()
                       for body in (first, second)],
            'orientation': {'quaternion': (
                frames[first].inv() * frames[second]).as_quat().tolist()}, **keys}
    path = directory / f'{"_".join(cut)}.yaml'
    path.write_text(yaml.safe_dump(data))
    return read_mechanism(path)


EFFECTS = {
    'gravity': Gravity((0.5, -1.0, -9.0)),
    'hip_spring': JointSpring('hip.2', 2.0, 0.1), 'hip_drive': Actuator('hip.1', 0.7, lag=0.01),
    'hip_friction': JointFriction('hip.2', 0.05, 1.2, friction_coefficient=0.02, radius=0.1),
    'table_stop': EndStop('table.x', 500.0, -1.0, 0.001, 5.0),
    'table_damper': JointDamping('table.y', 0.4), 'table_turn': JointSpring('table.angle', 1.5),
    'table_friction': JointFriction('table.y', 0.1, 1.2, friction_coefficient=0.05),
    'rod_table': ForceTable((-1.0, 0.0, 1.0), (2.0, 0.0, -5.0), 'rod_1.2', damping=0.1),
    'rod_damper': JointDamping('rod_2.1', 0.02),
    'rod_friction': JointFriction('rod_2.2', 0.1, 1.2, friction_coefficient=0.05),
    'ball_damper': JointDamping('ball.ry', 0.03), 'ball_friction': JointFriction('ball.rz', 0.02)}


def simulation(mechanism, effects, position=None, turned=None):
    """Return a simulation that starts at rest as drawn."""
    return simulated(mechanism, position, None, effects, turned=turned, method=METHOD)


def readings(sim):
    """Return position (of rotations zero), rate, acceleration and effort by freedom."""
    found = {}
    for known, position, *rates in (
            (sim.coordinates, sim.position, sim.velocity, sim.acceleration, sim.effort),
            (sim.mechanism.cut_coordinates, sim.cut_position, sim.cut_velocity,
             sim.cut_acceleration, sim.cut_effort)):
        values = np.transpose([known.by_freedom(position), *rates])
        found.update(zip(known.names, values))
    return found


def orientation(sim):
    """Return the orientation of the ball."""
    for known, position in ((sim.coordinates, sim.position),
                            (sim.mechanism.cut_coordinates, sim.cut_position)):
        if known.with_orientation:
            return position[known.coordinates['ball']]


@pytest.mark.parametrize('cut', cases.first(1, CUTS[::-1]))
def test_what_acts_at_any_cut_joint_acts_as_in_the_tree(tmp_path, cut):
    tree, sim = (simulation(machine(tmp_path, each), EFFECTS) for each in (IN_TREE, cut))
    assert tree.cut_joint_names == ('rod_1.1', 'rod_1.2', 'rod_2.1', 'rod_2.2')
    assert set(readings(tree)) == set(readings(sim)) == {*FREEDOMS, *RATES}
    for _ in range(4):
        one, other = (readings(each) for each in (tree, sim))
        for name in other:
            np.testing.assert_allclose(other[name][:2], one[name][:2], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(other[name][2:], one[name][2:], rtol=1e-8, atol=1e-7)
        np.testing.assert_allclose(orientation(sim), orientation(tree), rtol=0.0, atol=1e-9)
        for each in (tree, sim):
            each.step(TORQUE, 0.05)
    assert abs(orientation(sim)[:3]).max() > 0.01
    for name in EFFECTS:
        for key, value in sim.effect_readings(name).items():
            assert value == pytest.approx(tree.effect_readings(name)[key], rel=1e-6, abs=1e-7)
    for each in (tree, sim):
        balance = each.energy_balance
        assert abs(balance.work) > 0.05 and balance.dissipated > 0.01
        assert abs(balance.residual) < 1e-7
    for joint in ('hip', 'table', 'ball'):
        np.testing.assert_allclose(sim.force(joint), tree.force(joint), rtol=1e-6, atol=1e-6)
    for each in (tree, sim):
        for name, effect in EFFECTS.items():
            # What remembers does so to the errors of its motion.
            each.set_effect(name, enabled=not isinstance(effect, (Actuator, JointFriction)))
    sim.set_state(*same_state(tree, sim))
    np.testing.assert_allclose(accelerations(sim), accelerations(tree), rtol=1e-12, atol=1e-11)


def same_state(sim, other):
    """Return the state of a simulation as another one, with other joints cut, takes it."""
    state = []
    for quantity, place in (('position', 0), ('velocity', 1)):
        values = {**sim.coordinates.by_name(quantity, getattr(sim, quantity)),
                  **{name: each[place] for name, each in readings(sim).items()}}
        state.append({name: values[name] for name in other.coordinates.keys})
    return state


def accelerations(sim):
    """Return the accelerations of all joints that have a number."""
    found = readings(sim)
    return [found[name][2] for name in (*FREEDOMS, *RATES)]


# A pin of the crank in a slot of the rocker: in the tree a block without mass slides in the slot.
SLOT = {'slide': 'slot.x', 'turn': 'slot.angle', 'crank_joint': 'crank_joint',
        'rocker_joint': 'rocker_joint'}


def pin_in_slot(directory, start, cut, moved=None):
    """Return a simulation of such a machine, the slot or the crank's joint being cut."""
    data = {'name': 'shaper', 'bodies': {
        'crank': {'mass': 0.5, 'center_of_mass': [0.05, 0.01], 'inertia': 1e-3},
        'rocker': {'mass': 0.8, 'center_of_mass': [0.2, 0.0], 'inertia': 0.01}}, 'joints': {
        'crank_joint': {'type': 'revolute', 'between': ['ground', 'crank'],
                        'points': [[0.0, 0.0], [0.0, 0.0]], 'cut': not cut},
        'rocker_joint': {'type': 'revolute', 'between': ['ground', 'rocker'],
                         'points': [[0.0, -0.3], [0.0, 0.0]], 'cut': False}}}
    if cut:
        data['cut_joints'] = {'slot': {
            'type': 'point_on_line', 'body_a': 'crank', 'point_a': [0.1, 0.02],
            'body_b': 'rocker', 'point_b': [0.05, 0.01], 'angle': 0.2, 'actuated': True}}
    else:
        data['bodies']['block'] = {'massless': True}
        data['joints'].update({
            'slide': {'type': 'prismatic', 'between': ['rocker', 'block'], 'angle': 0.2,
                      'points': [[0.05, 0.01], [0.0, 0.0]], 'cut': False, 'actuated': True},
            'turn': {'type': 'revolute', 'between': ['block', 'crank'], 'cut': False,
                     'points': [[0.0, 0.0], [0.1, 0.02]], 'actuated': True}})
    path = directory / f'slot_{cut}.yaml'
    path.write_text(yaml.safe_dump(data))
    effects = {
        'gravity': Gravity((0.0, -9.81)), 'spring': JointSpring('slide', 20.0, 0.25),
        'damper': JointDamping('turn', 0.02), 'drive': Actuator('slide', 3.0, lag=0.01),
        'friction': JointFriction('turn', 0.05, 1.2, friction_coefficient=0.1, radius=0.02),
        'stop': EndStop('slide', 300.0, 0.2, 0.3, 2.0),
        'brake': JointFriction('slide', 0.1, 1.2, friction_coefficient=0.1)}
    if moved:
        effects = {name: effects[name] for name in ('gravity', 'spring', 'damper')}
        effects['motion'] = PrescribedMotion('sine', joint=moved, amplitude=0.03, frequency=1.0)
    if cut:
        effects = {name: replace(effect, joint=SLOT[effect.joint]) if hasattr(effect, 'joint')
                   else effect for name, effect in effects.items()}
    return simulation(read_mechanism(path), effects, start)


def both_slots(directory, moved=None):
    """Return it with the slot cut, and with the crank's joint cut."""
    tree = pin_in_slot(
        directory, {'rocker_joint': 1.2, 'slide': 0.25, 'turn': -0.8}, False, moved)
    start = {name: readings(tree)[name][0] for name in ('crank_joint', 'rocker_joint')}
    return pin_in_slot(directory, start, True, moved), tree


def test_a_pin_in_a_slot_slides_and_turns_as_a_block_does(tmp_path):
    cut, tree = both_slots(tmp_path)
    assert cut.cut_joint_names == cut.actuated_joints == ('slot.x', 'slot.angle')
    for _ in range(6):
        one, other = readings(tree), readings(cut)
        for name, same in SLOT.items():
            np.testing.assert_allclose(other[same][:2], one[name][:2], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(other[same][2:], one[name][2:], rtol=1e-8, atol=1e-7)
        tree.step({'slide': 4.0, 'turn': -0.2}, 0.05)
        cut.step({'slot.x': 4.0, 'slot.angle': -0.2}, 0.05)
    for name in ('spring', 'damper', 'drive', 'friction', 'stop', 'brake'):
        for key, value in cut.effect_readings(name).items():
            assert value == pytest.approx(tree.effect_readings(name)[key], rel=1e-6, abs=1e-7)
    np.testing.assert_allclose(cut.force('slot'), tree.force('turn'), rtol=1e-6, atol=1e-6)
    assert abs(cut.energy_balance.work) > 0.01 and abs(cut.energy_balance.residual) < 1e-6


@pytest.mark.parametrize('moved', ['slide', 'turn'])
def test_a_pin_in_a_slot_is_moved_as_a_block_is(tmp_path, moved):
    cut, tree = both_slots(tmp_path, moved)
    for _ in range(3):
        one, other = readings(tree), readings(cut)
        for name, same in SLOT.items():
            np.testing.assert_allclose(other[same][:2], one[name][:2], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(other[same][2], one[name][2], rtol=1e-8, atol=1e-7)
        assert cut.motion_forces['motion'] == pytest.approx(tree.motion_forces['motion'], abs=1e-7)
        for each in (tree, cut):
            each.step(None, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize('moved', [('hip.1', 'table.x'), ('hip.2', 'table.angle')])
def test_freedoms_in_space_are_moved_as_in_the_tree(tmp_path, moved):
    # From rest: the rates that motions leave free would start differently.
    effects = {'gravity': EFFECTS['gravity'], **{
        name: PrescribedMotion('expression', joint=joint, expression=f'{size}*(1 - cos(9*t))')
        for name, joint, size in zip(('one', 'other'), moved, (0.1, 0.05))}}
    tree, cut = (simulation(machine(tmp_path, each), effects) for each in (IN_TREE, CUTS[0]))
    for _ in range(3):
        one, other = readings(tree), readings(cut)
        for name in FREEDOMS:
            np.testing.assert_allclose(other[name][:2], one[name][:2], rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(other[name][2:], one[name][2:], rtol=1e-8, atol=1e-7)
        assert cut.motion_forces == pytest.approx(tree.motion_forces, abs=1e-7)
        for each in (tree, cut):
            each.step(None, 0.05)


def test_torques_along_freedoms_of_cut_joints_are_found_from_a_motion(tmp_path):
    sim = simulation(machine(tmp_path, CUTS[1]), EFFECTS)
    for name in ('hip_drive', 'hip_friction', 'table_friction', 'rod_friction', 'ball_friction'):
        sim.set_effect(name, enabled=False)
    sim.step(TORQUE, 0.05)
    given = sim.forward_dynamics(sim.position, sim.velocity, TORQUE)[0]
    torque, _ = sim.inverse_dynamics(sim.position, sim.velocity, given)
    # There are more drives than degrees of freedom: the least torques do the same.
    assert np.linalg.norm(torque) < np.linalg.norm(list(TORQUE.values()))
    again, _ = sim.forward_dynamics(sim.position, sim.velocity, torque)
    np.testing.assert_allclose(again, given, rtol=1e-9, atol=1e-9)


def test_turns_of_several_freedoms_are_counted_from_the_start(tmp_path):
    mechanism = machine(tmp_path, CUTS[0])
    assert mechanism.turning_cuts == ('hip.1', 'hip.2', 'table.angle')
    turned = {'hip.1': 7.0, 'table.angle': -6.0}
    sim = simulation(mechanism, EFFECTS, turned=turned)
    found = dict(zip(sim.cut_joint_names, sim.cut_position))
    assert found['hip.1'] == pytest.approx(2.0 * np.pi, abs=1e-9)
    assert found['hip.2'] == pytest.approx(0.0, abs=1e-9)
    assert found['table.angle'] == pytest.approx(-2.0 * np.pi, abs=1e-9)


@pytest.mark.parametrize('effect, said', [
    (JointSpring('ball.rx', 1.0), 'effects.one.joint: expected one of the joints'),
    (JointSpring('hip', 1.0), "effects.one.joint: .*got the text 'hip' .did you mean 'hip.2'"),
    (PrescribedMotion('constant', joint='ball.rz'), 'effects.one.joint: expected one'),
    (Rotor('hip', 1.0), 'effects.one.joint: expected one of the joints')])
def test_what_acts_along_no_such_freedom_is_refused(tmp_path, effect, said):
    with pytest.raises(FieldError, match=said):
        simulation(machine(tmp_path, ('hip', 'ball')), {'one': effect})


def test_an_orientation_of_a_universal_cut_joint_lays_its_axes_across():
    keys = {'axis_a': (1.0, 0.0, 0.0), 'axis_b': (0.0, 0.0, 1.0)}
    body = Body('body', 1.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    free = Joint('free', 'free', 'ground', 'body', (0.0, 0.0, 0.0))

    def cut(**more):
        return validate_mechanism(Mechanism('one', (body,), (free,), (CutJoint(
            'cross', 'universal', 'body', 'ground', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), **keys,
            **more),)))

    first, second = cut_freedoms(cut()).values()
    assert first.turn[2].tolist() == [1.0, 0.0, 0.0] and second.axis.tolist() == [-1.0, 0.0, 0.0]
    with pytest.raises(MechanismError, match='cross.orientation: expected an orientation that '
                       'turns axis_a across axis_b, got one that leaves them parallel'):
        cut(orientation=(0.0, -0.5 ** 0.5, 0.0, 0.5 ** 0.5))
