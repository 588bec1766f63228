# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms that are written in other formats and read again move as before."""

from dataclasses import replace
from xml.etree import ElementTree

from closedloop_dynamics import (
    Body, Coupling, CouplingLaw, CutJoint, Joint, Mechanism, MechanismError, Point, read_mechanism)
from closedloop_dynamics.cli import main
from closedloop_dynamics.formats.in_space import in_space
from closedloop_dynamics.formats.mjcf_writing import mjcf
from closedloop_dynamics.formats.model import NO_LIMIT
from closedloop_dynamics.formats.registry import read_model, writer
from closedloop_dynamics.formats.sdf_writing import sdf
from closedloop_dynamics.formats.urdf_loops import FORMS
from closedloop_dynamics.formats.urdf_writing import urdf_with_loops
from closedloop_dynamics.formats.writing import numbers
from closedloop_dynamics.kinematics.global_assembly import ClosureProblem, find_closed
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.config import shipped_path
from closedloop_dynamics.mechanism.validation import validate_mechanism
import numpy as np
import pytest

from ..reference.numbers import Numbers

Z, TURNED = (0.0, 0.0, 1.0), (0.18257418583505536, 0.3651483716701107, 0.5477225575051661,
                              0.7302967433402214)
GRAVITY = {'gravity': {'type': 'gravity', 'acceleration': (0.0, 0.0, -9.81)}}


def tree(*kinds, cuts=(), couplings=()):
    """Return a chain of joints of some types, with cuts from its end."""
    keys = {'universal': {'axis': Z, 'second_axis': (0.0, 1.0, 0.0)}, 'spherical': {}, 'free': {},
            'planar': {}, 'fixed': {}, 'helical': {'axis': (0.6, 0.0, 0.8), 'lead': 0.1}}
    bodies, joints, parent = [], [], 'ground'
    for number, kind in enumerate(kinds):
        kind, massless = kind.rstrip('0'), kind.endswith('0')
        bodies.append(Body(f'b{number}', 0.0, (0.0, 0.0, 0.0), 0.0, massless=True) if massless
                      else Body(f'b{number}', 1.0 + number, (0.1, 0.02 * number, -0.03),
                                (0.02, 0.03, 0.04, 0.001, 0.002, -0.003)))
        joints.append(Joint(f'j{number}', kind, parent, f'b{number}', (0.3, 0.1, -0.2),
                            orientation=TURNED, actuated=number == 0,
                            **keys.get(kind, {'axis': (0.0, 0.6, 0.8)})))
        parent = f'b{number}'
    return validate_mechanism(Mechanism('m', tuple(bodies), tuple(joints), tuple(cuts),
                                        couplings=tuple(couplings)))


def closing(kind, body):
    """Return a cut joint of a type between a body and the ground."""
    keys = {'revolute': {'axis_a': (0.6, 0.0, 0.8), 'axis_b': Z},
            'cylindrical': {'axis_a': (0.6, 0.0, 0.8), 'axis_b': Z},
            'planar': {'axis_a': (0.6, 0.0, 0.8), 'axis_b': Z},
            'universal': {'axis_a': (0.6, 0.0, 0.8), 'axis_b': Z},
            'prismatic': {'axis_b': (0.0, 0.6, 0.8), 'orientation': TURNED},
            'helical': {'axis_b': (0.0, 0.6, 0.8), 'orientation': TURNED, 'lead': 0.2},
            'fixed': {'orientation': TURNED}}
    return CutJoint('cut', kind, body, 'ground', (0.1, 0.2, 0.0), (0.5, 0.2, 0.1),
                    **keys.get(kind, {}))


CHAIN = ('revolute', 'prismatic', 'revolute', 'revolute', 'revolute', 'prismatic', 'revolute',
         'revolute')


def accelerations(mechanism, q, qd):
    """Return what gravity does to a mechanism, by a dense solution of all equations."""
    numbers = Numbers(build_model(mechanism, (0.0, 0.0, -9.81)))
    numbers.move(q, qd)
    jac, bias = numbers.jacobian(), numbers.closures()[2]
    inertia, nc = numbers.inertia(), len(bias)
    whole = np.block([[inertia, jac.T], [jac, np.zeros((nc, nc))]])
    right = np.concatenate([-numbers.bias_force(), -bias])
    return np.linalg.lstsq(whole, right, rcond=1e-12)[0][:len(qd)]


def by_joint(mechanism, q, qd):
    """Return the accelerations of joints of one degree of freedom by name."""
    found, places = accelerations(mechanism, q, qd), mechanism.coordinates.rates
    return {name: found[places[name]][0] for name in mechanism.joint_names
            if len(found[places[name]]) == 1}


def closed_state(mechanism):
    """Return coordinates and rates of a mechanism with its loops closed."""
    loops, rng = ClosureProblem(mechanism, 1.0), np.random.default_rng(3)
    q = loops.moved(loops.start(), 0.3 * rng.normal(size=loops.nv))
    found = find_closed(mechanism, 1.0, q)
    assert found.closed
    jac = loops.residual(found.q)[1]
    qd = rng.normal(size=loops.nv)
    return found, qd - np.linalg.pinv(jac, rcond=1e-9) @ jac @ qd


def same_motion(mechanism, again):
    """Compare two mechanisms of the same coordinates in a closed state."""
    found, qd = closed_state(mechanism)
    assert again.coordinates.nv == mechanism.coordinates.nv
    np.testing.assert_allclose(accelerations(again, found.q, qd),
                               accelerations(mechanism, found.q, qd), rtol=1e-10, atol=1e-10)


def read_again(tmp_path, text, suffix):
    path = tmp_path / f'again{suffix}'
    path.write_text(text)
    return read_model(path).mechanism


@pytest.mark.parametrize('form, kind', [
    (form, kind) for form in ('constraint', 'loop', 'drake') for kind in FORMS[form]])
def test_urdf_with_every_loop(tmp_path, form, kind):
    mechanism = tree(*CHAIN, cuts=[closing(kind, 'b7')])
    text = urdf_with_loops(mechanism, loops=form)
    assert f'<{"drake:ball_constraint" if form == "drake" else form}' in text
    again = read_again(tmp_path, text, '.urdf')
    assert again.actuated_joints == ('j0',)
    if form != 'drake':
        assert [(cut.name, cut.type) for cut in again.cut_joints] == [('cut', kind)]
    same_motion(mechanism, again)


@pytest.mark.parametrize('kinds, kind', [
    *((CHAIN, kind) for kind in FORMS['gazebo'] if kind != 'helical'),
    (('revolute', 'helical', 'cylindrical', 'prismatic', 'revolute', 'revolute', 'revolute',
      'revolute'), 'universal'),
    (('revolute', 'planar', 'universal', 'fixed', 'prismatic', 'revolute'), 'revolute'),
    (('revolute', 'prismatic', 'spherical', 'spherical'), 'spherical')])
def test_urdf_that_is_drawn_with_its_loops_closed(tmp_path, kinds, kind):
    mechanism = tree(*kinds, cuts=[closing(kind, f'b{len(kinds) - 1}')])
    found, qd = closed_state(mechanism)
    expected = by_joint(mechanism, found.q, qd)
    again = read_again(
        tmp_path, urdf_with_loops(mechanism, start=found.q, loops='gazebo'), '.urdf')
    drawn = again.coordinates.start()
    assert max(ClosureProblem(again, 1.0).closure_errors(drawn).values()) < 1e-12
    assert [(cut.name, cut.type) for cut in again.cut_joints] == [('cut', kind)]
    if 'helical' in kinds:
        # A screw turns, and slides with that.
        qd = np.insert(qd, 2, 0.1 * qd[1])
    found = by_joint(again, drawn, qd)
    same = sorted(set(found) & set(expected))
    assert same[0] == 'j0' and len(same) > 1
    np.testing.assert_allclose([found[name] for name in same],
                               [expected[name] for name in same], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('kind', ['spherical', 'revolute', 'fixed'])
def test_mjcf_with_every_loop(tmp_path, kind):
    pytest.importorskip('mujoco')
    mechanism = tree(*CHAIN, cuts=[closing(kind, 'b7')])
    again = read_again(tmp_path, mjcf(mechanism, GRAVITY), '.xml')
    assert again.actuated_joints == ('j0',)
    same_motion(mechanism, again)


def test_mjcf_with_every_joint_and_couplings(tmp_path):
    pytest.importorskip('mujoco')
    mechanism = tree('free', 'revolute0', 'universal', 'fixed', 'cylindrical', 'planar',
                     'spherical', 'prismatic', couplings=[Coupling('c', {'j1': 2.0, 'j7': -1.0},
                                                                   0.3)])
    same_motion(mechanism, read_again(tmp_path, mjcf(mechanism, GRAVITY), '.xml'))


def test_mjcf_with_a_polynomial_between_joints(tmp_path):
    pytest.importorskip('mujoco')
    mechanism = tree('revolute', 'prismatic', 'revolute', couplings=[Coupling(
        'c', {'j1': 2.0}, 0.3, law=CouplingLaw('j0', (0.1, -0.2, 0.3, 0.0, 0.05)))])
    again = read_again(tmp_path, mjcf(mechanism, GRAVITY), '.xml')
    assert again.couplings[0].law.polynomial == pytest.approx((0.2, -0.1, 0.15, 0.0, 0.025))
    same_motion(mechanism, again)


@pytest.mark.parametrize('kinds, loop', [
    (CHAIN, 'spherical'), (CHAIN, 'revolute'), (CHAIN, 'fixed'), (CHAIN, 'universal'),
    (CHAIN, 'prismatic'), (CHAIN, 'helical'), (('revolute', 'universal', 'spherical'), 'revolute'),
    (('spherical', 'helical', 'universal', 'revolute'), 'spherical'),
    (('revolute', 'cylindrical', 'planar', 'fixed', 'prismatic'), 'universal'),
])
def test_sdf_with_every_loop_and_joint(tmp_path, kinds, loop):
    mechanism = tree(*kinds, cuts=[closing(loop, f'b{len(kinds) - 1}')])
    if kinds[0] == 'spherical':
        mechanism = replace(mechanism, joints=tuple(
            replace(joint, actuated=False) for joint in mechanism.joints))
    found, qd = closed_state(mechanism)
    again = read_again(tmp_path, sdf(mechanism, GRAVITY, found.q), '.sdf')
    assert again.coordinates.nv == mechanism.coordinates.nv
    assert again.actuated_joints == mechanism.actuated_joints
    assert [cut.name for cut in again.cut_joints] == ['cut']
    # Drawn with its loops closed, and there are its zeros.
    drawn = again.coordinates.start()
    assert max(ClosureProblem(again, 1.0).closure_errors(drawn).values()) < 1e-12
    np.testing.assert_allclose(accelerations(again, drawn, qd),
                               accelerations(mechanism, found.q, qd), rtol=1e-10, atol=1e-10)
    # And from there both move alike.
    loops = ClosureProblem(mechanism, 1.0)
    moved = find_closed(mechanism, 1.0, loops.moved(found.q, 0.1 * qd))
    coordinates = moved.q - found.q
    if any(kind == 'spherical' for kind in kinds):
        return
    jac = loops.residual(moved.q)[1]
    qd -= np.linalg.pinv(jac, rcond=1e-9) @ jac @ qd
    np.testing.assert_allclose(accelerations(again, coordinates, qd),
                               accelerations(mechanism, moved.q, qd), rtol=1e-10, atol=1e-10)


def test_sdf_with_what_floats_couplings_and_effects(tmp_path):
    mechanism = tree('free', 'revolute', 'prismatic', 'helical', couplings=[
        Coupling('c', {'j1': 2.0, 'j2': -1.0}, 0.3), Coupling('d', {'j2': 1.0, 'j3': -1.0}, 0.1)])
    mechanism = replace(mechanism, joints=tuple(
        replace(joint, actuated=joint.name == 'j3') for joint in mechanism.joints),
        points=(Point('tip', 'b3', (0.1, 0.2, 0.3)), Point('j1', 'b0', (0.0, 0.0, 0.5))))
    found, qd = closed_state(mechanism)
    effects = {**GRAVITY, 'a': {'type': 'joint_damping', 'joint': 'j1', 'coefficient': 0.5},
               'b': {'type': 'joint_spring', 'joint': 'j2', 'stiffness': 3.0, 'rest': 0.2},
               'e': {'type': 'joint_friction', 'joint': 'j3', 'coulomb': 0.7}}
    (tmp_path / 'm.sdf').write_text(sdf(mechanism, effects, found.q))
    imported = read_model(tmp_path / 'm.sdf')
    again = imported.mechanism
    # What floats comes last, named after its body, and is zero where it is drawn.
    assert again.joint_names == ('j1', 'j2', 'j3', 'b0_free')
    assert again.actuated_joints == ('j3',)
    assert {point.name: point.body for point in again.points} == {'tip': 'b3', 'j1_link': 'b0'}
    np.testing.assert_allclose(
        np.roll(accelerations(again, again.coordinates.start(), np.roll(qd, 3)), 6)[6:],
        accelerations(mechanism, found.q, qd)[6:], rtol=1e-10, atol=1e-10)
    assert imported.effects['gravity']['acceleration'] == (0.0, 0.0, -9.81)
    assert imported.effects['damping_j1']['coefficient'] == 0.5
    assert imported.effects['friction_j3']['coulomb'] == 0.7
    spring = imported.effects['stiffness_j2']
    assert spring['stiffness'] == 3.0
    assert spring['rest'] == pytest.approx(0.2 - found.q[mechanism.coordinates.coordinates['j2']])


def test_sdf_with_a_joint_before_the_one_that_its_parent_is_on(tmp_path):
    mechanism = tree('free', 'revolute', 'prismatic')
    mechanism = replace(mechanism, joints=tuple(
        replace(joint, actuated=False) for joint in reversed(mechanism.joints)))
    again = read_again(tmp_path, sdf(mechanism, GRAVITY), '.sdf')
    assert {joint.child: joint.parent for joint in again.joints} == {
        'b0': 'ground', 'b1': 'b0', 'b2': 'b1'}
    # And once more: what it was read as has the joint of what floats behind the others.
    assert again.joint_names[-1] == 'b0_free'
    same_motion(again, read_again(tmp_path, sdf(again, GRAVITY), '.sdf'))


def test_mjcf_has_armature_and_what_acts_in_balls_and_what_floats(tmp_path):
    mujoco = pytest.importorskip('mujoco')
    mechanism = tree('free', 'spherical', 'revolute', 'universal', 'prismatic')
    freedoms = mechanism.coordinates.names
    effects = {**GRAVITY, **{
        f'd{k}': {'type': 'joint_damping', 'joint': name, 'coefficient': 0.5 + k // 6}
        for k, name in enumerate(freedoms[:9])},
        'motor': {'type': 'rotor', 'joint': 'j2', 'inertia': 0.002, 'gear_ratio': 50.0},
        'twist': {'type': 'joint_spring', 'joint': 'j3.2', 'stiffness': 3.0},
        'socket': {'type': 'joint_spring', 'joint': 'j1', 'stiffness': 4.0},
        'buoy': {'type': 'joint_spring', 'joint': 'j0', 'stiffness': 5.0},
        **{f'mooring_{k}': {'type': 'joint_spring', 'joint': name, 'stiffness': 5.0}
           for k, name in enumerate(freedoms[:3])},
        'flywheel': {'type': 'rotor', 'joint': 'j1', 'inertia': 7e-24, 'gear_ratio': 1e12},
        'rub': {'type': 'joint_friction', 'joint': 'j4', 'coulomb': 2.0, 'static_ratio': 1.5},
        'odd': {'type': 'joint_damping', 'joint': 'j4', 'coefficient': 1.0},
        'odder': {'type': 'joint_damping', 'joint': 'j4', 'coefficient': 2.0},
        'pull': {'type': 'external_force', 'point': 'p', 'force': (1.0, 0.0, 0.0)}}
    left_out = {}
    text = mjcf(mechanism, effects, left_out=left_out)
    assert left_out == {'motor': 'beyond its reflected inertia', 'rub': 'beyond its Coulomb part',
                        'odder': '', 'pull': ''}
    model = mujoco.MjModel.from_xml_string(text)
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE and model.njnt == 6
    np.testing.assert_allclose(model.dof_damping, [0.5] * 6 + [1.5] * 3 + [0.0] * 3 + [1.0])
    np.testing.assert_allclose(model.dof_armature[9], 0.002 * 50.0 ** 2)
    assert model.jnt_stiffness.tolist() == [5.0, 4.0, 0.0, 0.0, 3.0, 0.0]
    np.testing.assert_allclose(model.dof_armature[6:9], 7.0)
    (tmp_path / 'm.xml').write_text(text)
    found = read_model(tmp_path / 'm.xml').effects
    assert found['stiffness_j1'] == effects['socket']
    assert found['stiffness_j0'] == effects['buoy']
    assert found['stiffness_j0_y'] == effects['mooring_1']
    assert found['armature_j1'] == effects['flywheel']
    assert model.dof_frictionloss[-1] == 2.0
    # A value that differs between the freedoms of a ball has no word in MJCF.
    effects['d7'] = {**effects['d7'], 'coefficient': 9.0}
    mjcf(mechanism, effects, left_out=left_out)
    assert {'d6', 'd7', 'd8'} <= set(left_out)
    assert '<freejoint ' in mjcf(mechanism)


def test_mjcf_has_tendons_springs_between_points_and_ropes(tmp_path):
    pytest.importorskip('mujoco')
    mechanism = replace(tree('revolute', 'prismatic', 'revolute'), points=(
        Point('tip', 'b2', (0.1, 0.2, 0.3)), Point('hook', 'ground', (0.0, 0.0, 0.5)),
        Point('guide', 'b0', (0.0, 0.1, 0.0))))
    same = {'tendon_belt': {'type': 'tendon', 'arms': {'j0': 0.5, 'j1': -2.0},
                            'stiffness': (3.0, 0.0, 0.0), 'damping': (0.2, 0.0, 0.0),
                            'rest': (-0.1, 0.3)},
            'cable_rope': {'type': 'cable', 'points': ['hook', 'guide', 'tip'],
                           'stiffness': 50.0, 'free_length': 0.4},
            'tendon_friction_sheath': {'type': 'tendon_friction', 'arms': {'j0': 0.5, 'j2': 3.0},
                                       'coulomb': 0.7},
            'tendon_inertia_motor': {'type': 'tendon_inertia', 'arms': {'j0': 1.0, 'j1': 1.0},
                                     'inertia': 0.3}}
    effects = {**GRAVITY, 'belt': same['tendon_belt'], 'rope': same['cable_rope'],
               'sheath': same['tendon_friction_sheath'], 'motor': same['tendon_inertia_motor'],
               'strut': {'type': 'point_spring', 'point_a': 'tip', 'anchor': (0.1, 0.2, 0.7),
                         'stiffness': 5.0, 'damping': 0.5, 'free_length': 0.2},
               'oil': {'type': 'cable', 'points': ['hook', 'tip'], 'stiffness': 5.0,
                       'free_length': 0.1, 'damping': 1.0},
               'bent': {'type': 'tendon', 'arms': {'j0': 1.0}, 'stiffness': (1.0, 1.0, 1.0, 1.0)}}
    left_out = {}
    (tmp_path / 'm.xml').write_text(mjcf(mechanism, effects, left_out=left_out))
    assert left_out == {'oil': '', 'bent': ''}
    found = read_model(tmp_path / 'm.xml')
    assert not found.omitted
    places = {point.name: (point.body, point.position) for point in found.mechanism.points}
    ropes = [places[name] for name in found.effects['cable_rope'].pop('points')]
    assert ropes == [(point.body, point.position) for name in same['cable_rope'].pop('points')
                     for point in mechanism.points if point.name == name]
    assert {key: found.effects[key] for key in same} == same
    strut = found.effects['spring_strut_end_1']
    assert [places[strut.pop(key)] for key in ('point_a', 'point_b')] == [
        ('b2', (0.1, 0.2, 0.3)), ('ground', (0.1, 0.2, 0.7))]
    assert strut == {'type': 'point_spring', 'stiffness': 5.0, 'damping': 0.5, 'free_length': 0.2}


@pytest.mark.parametrize('suffix', ['.xml', '.urdf', '.sdf'])
def test_limits_of_joints_are_written_and_read_again(tmp_path, suffix):
    if suffix == '.xml':
        pytest.importorskip('mujoco')
    mechanism = tree('revolute', 'prismatic', 'revolute', 'prismatic', 'revolute', 'spherical')
    limits = {'j0': (-0.5, 1.5), 'j1': (-0.25, 0.125), 'j2': (None, 0.75), 'j3': (0.0, None)}
    q = mechanism.coordinates.moved(mechanism.coordinates.start(), np.full(8, 0.0625))
    path = tmp_path / f'm{suffix}'
    path.write_text(writer(suffix)(mechanism, {}, q, limits=limits))
    found, drawn = read_model(path).limits, 0.0625 if suffix == '.sdf' else 0.0
    assert found == {name: tuple(one if one is None else one - drawn for one in some)
                     for name, some in limits.items()}


def test_limits_count_from_where_a_robot_is_drawn():
    text = urdf_with_loops(tree('prismatic', 'revolute'), {}, np.array([0.25, 0.5]), limits={
        'j0': (-1.0, None), 'j1': (-0.5, 1.5)}, loops='gazebo')
    ends = [(limit.get('lower'), limit.get('upper'))
            for limit in ElementTree.fromstring(text).iter('limit')]
    assert ends == [('-1.25', numbers(NO_LIMIT)), ('-1', '1')]


def test_limits_of_drives_are_written(tmp_path):
    mujoco = pytest.importorskip('mujoco')
    mechanism = tree('revolute', 'prismatic')
    effects = {'a': {'type': 'actuator', 'joint': 'j0', 'max_torque': 3.0, 'max_speed': 7.0,
                     'lag': 0.0, 'delay': 0.0}}
    late, left_out = {'a': {**effects['a'], 'delay': 0.1}}, {}
    for write, suffix in ((urdf_with_loops, '.urdf'), (sdf, '.sdf')):
        (tmp_path / f'm{suffix}').write_text(write(mechanism, effects, left_out=left_out))
        assert set(left_out) <= {'gravity'}
        assert read_model(tmp_path / f'm{suffix}').drives == {'j0': (3.0, 7.0)}
        write(mechanism, late, left_out=left_out)
        assert left_out.pop('a') == 'beyond its largest torque and speed'
        left_out.clear()
    model = mujoco.MjModel.from_xml_string(mjcf(mechanism, effects, left_out=left_out))
    assert model.actuator_ctrlrange.tolist() == [[-3.0, 3.0]]
    assert left_out == {'a': 'beyond its largest torque'}
    # From one format to another, too.
    assert main(['export', str(tmp_path / 'm.urdf'), '--output', str(tmp_path / 'm.xml')]) == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / 'm.xml'))
    assert model.actuator_ctrlrange.tolist() == [[-3.0, 3.0]]


def test_rotors_of_drives_are_written_for_drake_and_read_again(tmp_path):
    mechanism = tree('revolute', 'prismatic')
    effects = {**GRAVITY, 'a': {'type': 'rotor', 'joint': 'j0', 'inertia': 0.5 / 1e12 ** 2,
                                'gear_ratio': 1e12},
               'b': {'type': 'rotor', 'joint': 'j1', 'inertia': 0.1}}
    left_out = {}
    text = sdf(mechanism, effects, left_out=left_out)
    # Drake has no rotor where there is no drive.
    assert left_out == {'b': ''} and 'xmlns:drake="http://drake.mit.edu"' in text
    (tmp_path / 'm.sdf').write_text(text)
    found = read_model(tmp_path / 'm.sdf').effects
    assert found['armature_j0']['inertia'] * found['armature_j0']['gear_ratio'] ** 2 == (
        pytest.approx(0.5))
    left_out.clear()
    urdf_with_loops(mechanism, {**effects, 'c': {
        'type': 'joint_spring', 'joint': 'j1', 'stiffness': 3.0}}, left_out=left_out)
    assert left_out == {'a': '', 'b': '', 'c': ''}
    left_out.clear()
    urdf_with_loops(mechanism, {'g': {**GRAVITY['gravity'], 'acceleration': (0.0, 0.0, -1.6)}},
                    left_out=left_out)
    assert left_out == {'gravity': 'simulators of URDF take -9.81 m/s^2 along z'}


@pytest.mark.parametrize('kind, count', [('spherical', 1), ('revolute', 2)])
def test_loops_as_ball_constraints_of_drake(tmp_path, kind, count):
    mechanism = tree(*CHAIN, cuts=[closing(kind, 'b7')])
    found, qd = closed_state(mechanism)
    text = sdf(mechanism, GRAVITY, found.q, drake=True)
    assert 'must_be_loop_joint' not in text and text.count('<drake:ball_constraint>') == count
    again = read_again(tmp_path, text, '.sdf')
    assert [cut.type for cut in again.cut_joints] == count * ['spherical']
    np.testing.assert_allclose(accelerations(again, again.coordinates.start(), qd),
                               accelerations(mechanism, found.q, qd), rtol=1e-8, atol=1e-8)
    with pytest.raises(MechanismError, match='expected spherical or revolute for Drake'):
        sdf(tree(*CHAIN, cuts=[closing('prismatic', 'b7')]), drake=True)


@pytest.mark.parametrize('moments', [
    (0.0, 0.0, 0.0), (0.0, 0.02, 0.02), (0.01, 0.02, 0.03), (0.1 + 0.2, 0.6, 0.3)])
def test_mjcf_has_inertias_that_mujoco_compiles(moments):
    """A point, a bar and plates."""
    mujoco = pytest.importorskip('mujoco')
    mechanism = tree('revolute')
    mechanism = replace(mechanism, bodies=(replace(mechanism.bodies[0], inertia=moments),))
    model = mujoco.MjModel.from_xml_string(mjcf(mechanism, GRAVITY))
    np.testing.assert_allclose(np.sort(model.body_inertia[1]), np.sort(moments), atol=1e-13)


def test_mjcf_comes_back_where_it_started(tmp_path):
    pytest.importorskip('mujoco')
    mechanism = tree('free', 'revolute', 'universal', 'spherical', 'prismatic',
                     cuts=[closing('spherical', 'b4')])
    found, _ = closed_state(mechanism)
    (tmp_path / 'm.xml').write_text(mjcf(mechanism, GRAVITY, found.q))
    imported = read_model(tmp_path / 'm.xml')
    loops = ClosureProblem(imported.mechanism, 1.0)
    start = loops.start(imported.position)
    assert max(loops.closure_errors(start).values()) < 1e-9
    np.testing.assert_allclose(start[:7], found.q[:7], atol=1e-12)


@pytest.mark.parametrize('name', [
    'bennett', 'bricard', 'carpet_scraper', 'differential', 'four_bar', 'geared_five_bar',
    'hoeken_pantograph_leg', 'planetary_gear', 'rssr_four_bar', 'stewart_platform', 'three_rrr'])
def test_mujoco_has_the_accelerations_of_machines_that_are_exported(name):
    """Its inertia, bias and equations, solved as hard ones."""
    mujoco = pytest.importorskip('mujoco')
    mechanism = in_space(read_mechanism(shipped_path('mechanisms', name)))
    found, qd = closed_state(mechanism)
    loops, q = ClosureProblem(mechanism, 1.0), found.q
    for _ in range(3):
        # As exactly as equations that repeat others need it.
        values, jac = loops.residual(q)
        q = loops.moved(q, -np.linalg.pinv(jac, rcond=1e-6) @ values)
    jac = loops.residual(q)[1]
    qd -= np.linalg.pinv(jac, rcond=1e-6) @ jac @ qd
    model = mujoco.MjModel.from_xml_string(mjcf(mechanism, GRAVITY, q))
    data, places, order = mujoco.MjData(model), mechanism.coordinates, []
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for number in range(model.njnt):
        joint, part = model.joint(number).name, 1
        if joint not in places.rates:
            joint, part = joint[:-2], int(joint[-1])
        first = places.rates[joint].start + part - 1
        order += range(first, first + {0: 6, 1: 3}.get(int(model.jnt_type[number]), 1))
    data.qvel[:] = qd[order]
    mujoco.mj_forward(model, data)
    inertia, rows = np.zeros((model.nv, model.nv)), data.ne
    for k, axis in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, inertia[k], axis)
    # J qd stays zero: J changes along the motion, by differences of the position.
    jacobians = []
    for step in (0.0, 1e-5, -1e-5):
        there = mujoco.MjData(model)
        there.qpos[:], there.qvel[:] = data.qpos, data.qvel
        mujoco.mj_integratePos(model, there.qpos, data.qvel, step)
        mujoco.mj_forward(model, there)
        jacobians.append(there.efc_J.reshape(-1, model.nv)[:rows].copy())
    bias = (jacobians[1] - jacobians[2]) @ data.qvel / 2e-5
    np.testing.assert_allclose(jacobians[0] @ data.qvel, 0.0, atol=1e-9)
    whole = np.block([[inertia, jacobians[0].T], [jacobians[0], np.zeros((rows, rows))]])
    right = np.concatenate([data.qfrc_passive - data.qfrc_bias, -bias])
    theirs = np.linalg.lstsq(whole, right, rcond=1e-10)[0][:model.nv]
    ours = accelerations(mechanism, q, qd)[order]
    np.testing.assert_allclose(theirs, ours, rtol=1e-7, atol=1e-7 * np.abs(ours).max() + 1e-12)


def test_mjcf_starts_where_the_loops_are_closed(tmp_path):
    mujoco = pytest.importorskip('mujoco')
    for mechanism in (tree(*CHAIN, cuts=[closing('spherical', 'b7')]),
                      tree('free', 'revolute0', 'universal', 'spherical', 'planar', 'helical',
                           cuts=[closing('spherical', 'b5')])):
        found, _ = closed_state(mechanism)
        model = mujoco.MjModel.from_xml_string(mjcf(mechanism, GRAVITY, found.q))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[:data.ne]).max() < 1e-9


def test_urdf_with_joints_of_several_freedoms_and_couplings(tmp_path):
    mechanism = tree('free', 'universal', 'cylindrical', 'fixed', 'prismatic')
    same_motion(mechanism, read_again(tmp_path, urdf_with_loops(mechanism), '.urdf'))
    mechanism = tree('revolute', 'prismatic', couplings=[Coupling('c', {'j0': 2.0, 'j1': 3.0},
                                                                  0.3)])
    again = read_again(tmp_path, urdf_with_loops(mechanism), '.urdf')
    assert again.couplings[0].joints == {'j0': 1.0, 'j1': 1.5}
    assert again.couplings[0].offset == 0.15


def test_screws_become_two_joints(tmp_path):
    mechanism = tree('revolute', 'helical', 'revolute')
    again = read_again(tmp_path, urdf_with_loops(mechanism), '.urdf')
    assert again.joint_names == ('j0', 'j1', 'j1_slide', 'j2')
    rng = np.random.default_rng(4)
    q, qd = rng.normal(size=3), rng.normal(size=3)
    more = [np.array([a, b, 0.1 * b, c]) for a, b, c in (q, qd)]
    np.testing.assert_allclose(accelerations(again, *more)[[0, 1, 3]],
                               accelerations(mechanism, q, qd), rtol=1e-9)


@pytest.mark.parametrize('name', ['three_rrr', 'four_bar', 'slider_crank', 'bricard'])
def test_shipped_mechanisms(tmp_path, name):
    mechanism = in_space(read_mechanism(shipped_path('mechanisms', name)))
    same_motion(mechanism, read_again(tmp_path, urdf_with_loops(mechanism), '.urdf'))


def test_scenes_are_exported_with_what_acts_on_joints(tmp_path, monkeypatch, capsys):
    pytest.importorskip('mujoco')
    monkeypatch.chdir(tmp_path)
    assert main(['export', 'three_rrr', '--output', 'r.urdf']) == 0
    assert 'r.urdf: 7 bodies, 7 joints, 2 that close loops\n' in capsys.readouterr().out
    assert main(['export', 'three_rrr', '--output', 'r.urdf']) == 2
    assert main(['export', 'three_rrr', '--output', 'r.step']) == 2
    assert main(['export', 'three_rrr', '--output', 'd.urdf', '--drake']) == 2
    assert main(['export', 'three_rrr', '--output', 'd.sdf', '--drake']) == 0
    assert main(['export', 'three_rrr', '--output', 'l.sdf', '--loops', 'loop']) == 2
    assert 'expected a name that ends with one of .mjcf, .xml, .urdf' in capsys.readouterr().err
    assert main(['export', 'three_rrr', '--output', 'l.urdf', '--loops', 'gazebo']) == 0
    assert 'drawn where the loops are closed; coordinates count' in capsys.readouterr().out
    problem = ClosureProblem(read_model('l.urdf').mechanism, 1.0)
    assert max(problem.closure_errors(np.zeros(7)).values()) < 1e-10
    assert main(['export', 'rssr_four_bar', '--output', 'r.sdf']) == 0
    # Links whose joints have their names are called otherwise.
    assert [body.name for body in read_model('r.sdf').mechanism.bodies] == [
        'crank_link', 'rocker_link', 'rod']
    assert main(['export', 'geared_five_bar', '--output', 'g.sdf']) == 0
    assert 'coordinates count from there: crank_1_joint 0, ' in capsys.readouterr().out
    again = read_model('g.sdf').mechanism
    assert max(ClosureProblem(again, 1.0).closure_errors(np.zeros(4)).values()) < 1e-10
    effects = {**GRAVITY, 'a': {'type': 'joint_damping', 'joint': 'j0', 'coefficient': 0.5},
               'b': {'type': 'joint_spring', 'joint': 'j1', 'stiffness': 3.0, 'rest': 0.2}}
    (tmp_path / 'm.xml').write_text(mjcf(tree('revolute', 'prismatic'), effects))
    found = read_model('m.xml').effects
    assert found['damping_j0']['coefficient'] == 0.5
    assert (found['stiffness_j1']['stiffness'], found['stiffness_j1']['rest']) == (3.0, 0.2)


def test_what_formats_cannot_say_is_refused():
    for write, mechanism, said in (
            (mjcf, tree(*CHAIN, cuts=[closing('planar', 'b7')]),
             'cut_joints.cut.type: expected spherical, revolute or fixed'),
            (mjcf, tree('revolute', 'revolute0'), 'bodies.b1: expected a mass'),
            (sdf, tree(*CHAIN, cuts=[closing('planar', 'b7')]),
             'cut_joints.cut.type: expected a joint that SDF has'),
            (sdf, tree('spherical'), 'joints.j0.actuated: expected false to write SDF, got true'),
            (urdf_with_loops, tree('revolute', 'prismatic', 'revolute', couplings=[
                Coupling('c', {'j0': 1.0, 'j1': 1.0, 'j2': 1.0})]),
             'couplings.c: expected two joints'),
            (urdf_with_loops, tree('revolute', 'prismatic', couplings=[
                Coupling('c', {'j0': 1.0}, law=CouplingLaw('j1', (0.0, 1.0)))]),
             'couplings.c.law: expected none to write URDF'),
            (mjcf, tree('revolute', 'prismatic', couplings=[
                Coupling('c', {'j0': 1.0}, law=CouplingLaw('j1', expression='sin(x)'))]),
             'couplings.c.law: expected one joint that is a polynomial of 5 coefficients'),
            (urdf_with_loops, tree(*CHAIN, cuts=[closing('helical', 'b7')]),
             "cut_joints.cut.type: expected one of revolute, .* constraint are, got 'helical'")):
        with pytest.raises(MechanismError, match=said):
            write(mechanism)
