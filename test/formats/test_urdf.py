# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""URDF: the same machine in every way of writing its loop, and what is refused."""

from dataclasses import replace
import re
import sys

from closedloop_dynamics import Coupling, load_scene, MechanismError, read_mechanism, SceneError
from closedloop_dynamics.cli import main
from closedloop_dynamics.formats.building import lines
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.formats.yaml_text import mechanism_text
import numpy as np
import pytest

from . import machines
from .machines import (
    four_bar, joint, link, LINKS, LOOPS, MOVING, robot, TIPS, TREE, written)


def read(tmp_path, text, **options):
    return read_model(written(tmp_path, text), **options)


@pytest.mark.parametrize('way', LOOPS)
def test_every_way_of_writing_a_loop_is_the_same_machine(tmp_path, way):
    kind = LOOPS[way][0]
    own = read_mechanism(written(tmp_path, machines.mechanism_text(kind), 'own.yaml'))
    read_here = read(tmp_path, four_bar(way)).mechanism
    cut = replace(read_here.cut_joints[0], name='pin')
    assert replace(read_here, cut_joints=(cut,), points=(), description='') == own


def test_parallel_yaml_closes_loops_between_frames(tmp_path):
    text = robot(LINKS, TREE, TIPS)
    written(tmp_path, 'closed_loop: [[coupler_tip, rocker_tip]]\ntype: [3d]\n'
            'name_mot: [crank_joint]\n', 'robot.yaml')
    mechanism = read(tmp_path, text).mechanism
    own = read_mechanism(written(tmp_path, machines.mechanism_text('spherical'), 'own.yaml'))
    assert replace(mechanism.cut_joints[0], name='pin') == own.cut_joints[0]
    assert mechanism.actuated_joints == ('crank_joint',)
    assert {point.name: (point.body, point.position) for point in mechanism.points} == {
        'base': ('ground', (0.0, 0.0, 0.0)), 'coupler_tip': ('coupler', (0.4, 0.0, 0.0)),
        'rocker_tip': ('rocker', (0.3, 0.0, 0.0))}


def test_parallel_yaml_replaces_joints(tmp_path):
    written(tmp_path, 'closed_loop: [[coupler_tip, rocker_tip]]\ntype: [6d]\n'
            'joint_name: [coupler_joint, rocker_joint]\njoint_type: [SPHERICAL, UJOINT_YZ]\n',
            'robot.yaml')
    mechanism = read(tmp_path, robot(LINKS, TREE, TIPS)).mechanism
    assert [one.type for one in mechanism.joints] == ['revolute', 'spherical', 'universal']
    assert mechanism.joints[2].axis == (0.0, 1.0, 0.0)
    assert mechanism.joints[2].second_axis == (0.0, 0.0, 1.0)
    assert mechanism.cut_joints[0].type == 'fixed'


def test_joints_called_spherical_that_are_not_are_reported(tmp_path):
    written(tmp_path, 'closed_loop: [[coupler_tip, rocker_tip]]\ntype: [6d]\n', 'robot.yaml')
    text = robot(LINKS, TREE, TIPS).replace('rocker_joint', 'spherical_rocker')
    assert read(tmp_path, text).ignored[
        'the names of 1 joint(s), spherical_rocker the first'] == (
            'called spherical, but revolute: no joint_name of robot.yaml has them')


def test_loops_of_a_scene(tmp_path):
    own = read_mechanism(written(tmp_path, machines.mechanism_text('revolute'), 'own.yaml'))
    mechanism = read(tmp_path, robot(LINKS, TREE, TIPS), loops={'pin': {
        'type': 'revolute', 'between': ['coupler_tip', 'rocker'], 'axis': [0, 2, 0],
        'points': [[0, 0, 0], [0.3, 0, 0]]}}).mechanism
    assert mechanism.cut_joints == own.cut_joints


def test_inertias_that_no_body_has_are_refused_or_mended(tmp_path):
    # Of a link that is fixed to another one, too: both together would hide it.
    moments = '<inertia ixx="1e-3" iyy="2e-3" izz="3.3e-3" ixy="0" ixz="0" iyz="0"/>'
    odd = f'<link name="odd"><inertial><mass value="0.1"/>{moments}</inertial></link>'
    text = robot(LINKS, TREE, TIPS, LOOPS['loop'][1], odd,
                 joint('glue', 'fixed', 'coupler', 'odd', '0.1 0 0'))
    with pytest.raises(MechanismError, match=(
            r'robot\.urdf:\d+: <link name=\'odd\'>: expected moments of inertia that a body can '
            r'have: .*, got principal moments 0\.001, 0\.002, 0\.0033 \(mend_inertias: true .*'
            r'takes 0\.0011, 0\.0021, 0\.0032\)')):
        read(tmp_path, text)
    imported = read(tmp_path, text, mend_inertias=True)
    assert imported.ignored['moments 0.001, 0.002, 0.0033 of odd, 0.0011, 0.0021, 0.0032 taken']
    coupler = next(body for body in imported.mechanism.bodies if body.name == 'coupler')
    # About the y axis: both, and 1 kg and 0.1 kg that are 0.1 m apart.
    assert coupler.inertia[1] == pytest.approx(1.49e-2 + 2.1e-3 + 0.1 / 1.1 * 0.01)
    with pytest.raises(MechanismError, match=r'got principal moments -0\.001, [^(]*$'):
        read(tmp_path, text.replace('ixx="1e-3"', 'ixx="-1e-3"'), mend_inertias=True)
    # Rounded digits refuse no file.
    rounded = text.replace('ixx="1e-3" iyy="2e-3" izz="3.3e-3"',
                           'ixx="-4e-22" iyy="0" izz="6e-23"')
    assert 'moments -4e-22, 0, 6e-23 of odd, 2e-23, 2e-23, 4e-23 taken' in ''.join(
        read(tmp_path, rounded).ignored)
    # Nor do they where no other body has any moment.
    alone = '<inertia ixx="-4e-22" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    point = ('<link name="base"/><link name="bob"><inertial><origin xyz="1 0 0"/>'
             f'<mass value="1"/>{alone}</inertial></link>')
    assert read(tmp_path, robot(point, joint('swing', 'continuous', 'base', 'bob')))


def test_what_has_an_inertia_alone_is_refused_or_mended(tmp_path):
    text = robot(LINKS, TREE, LOOPS['loop'][1]).replace('<mass value="1.0"/>', '<mass value="0"/>')
    with pytest.raises(MechanismError, match=(
            r"<link name='coupler'>: expected a positive mass, got 0 with an inertia that is not "
            r'zero \(mend_inertias: true in a scene, or --mend-inertias, takes 8e-13 kg\)')):
        read(tmp_path, text)
    coupler = read(tmp_path, text, mend_inertias=True).mechanism.bodies[1]
    assert (coupler.mass, coupler.inertia[1]) == (8e-13, 1.49e-2)
    # Of what is fixed to a body with a mass it is that body's.
    inertia = '<inertia ixx="1e-3" iyy="2e-3" izz="2e-3" ixy="0" ixz="0" iyz="0"/>'
    tip = f'<link name="fly"><inertial><mass value="0"/>{inertia}</inertial></link>'
    both = robot(LINKS, TREE, LOOPS['loop'][1], tip, joint('glue', 'fixed', 'coupler', 'fly'))
    coupler = read(tmp_path, both).mechanism.bodies[1]
    assert coupler.inertia[1] == pytest.approx(1.49e-2 + 2e-3)


def test_drives_and_mimics_that_move_nothing_are_left_out(tmp_path):
    mimic = '<mimic joint="crank_joint"/>'
    text = robot(LINKS, TREE, TIPS.replace('</joint>', f'{mimic}</joint>', 1), LOOPS['loop'][1],
                 '<transmission name="t"><joint name="none"/></transmission>')
    imported = read(tmp_path, text)
    assert not imported.mechanism.couplings
    assert imported.ignored['what coupler_end mimics'] == 'it is fixed'
    assert imported.ignored['the drive of none'] == 'there is no such joint'


def test_links_fixed_together_are_one_body(tmp_path):
    turn = 'rpy="0.3 -0.2 1.1"'
    text = robot(
        link('base'), link('arm', 2.0, 0.1, (0.01, 0.02, 0.025)),
        link('tool', 1.0, 0.05, (0.001, 0.002, 0.0025), '0.5 0.1 -0.4'),
        joint('turn', 'continuous', 'base', 'arm'),
        joint('held', 'fixed', 'arm', 'tool', '0.3 0 0.1').replace('/><axis', f' {turn}/><axis'))
    arm, = read(tmp_path, text).mechanism.bodies
    # As a cloud of points with the same moments, in two frames.
    rotation = turned(0.3, -0.2, 1.1)
    cloud = [*points(2.0, (0.1, 0, 0), (0.01, 0.02, 0.025), np.eye(3))]
    cloud += [(m, rotation @ p + (0.3, 0, 0.1)) for m, p in points(
        1.0, (0.05, 0, 0), (0.001, 0.002, 0.0025), turned(0.5, 0.1, -0.4))]
    mass = sum(m for m, _ in cloud)
    center = sum(m * p for m, p in cloud) / mass
    about = sum(m * ((p - center) @ (p - center) * np.eye(3) - np.outer(p - center, p - center))
                for m, p in cloud)
    assert arm.mass == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(arm.center_of_mass, center, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(
        arm.inertia, about[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)], rtol=1e-12, atol=1e-15)


def turned(roll, pitch, yaw):
    """Return turns about x, y and z, one after the other."""
    found = np.eye(3)
    for axis, angle in enumerate((roll, pitch, yaw)):
        one, other = [k for k in range(3) if k != axis]
        turn = np.eye(3)
        sign = -1.0 if axis == 1 else 1.0
        turn[one, one] = turn[other, other] = np.cos(angle)
        turn[other, one], turn[one, other] = sign * np.sin(angle), -sign * np.sin(angle)
        found = turn @ found
    return found


def points(mass, center, moments, rotation):
    """Yield six points with a mass, a centre and moments of inertia along turned axes."""
    for axis in range(3):
        # Half the sum of the moments less the one about the axis is sum m x^2 along it.
        spread = np.sqrt((sum(moments) / 2.0 - moments[axis]) * 3.0 / mass)
        for sign in (-1.0, 1.0):
            yield mass / 6.0, center + sign * spread * rotation[:, axis]


def test_dynamics_and_drives_are_read(tmp_path):
    text = robot(
        LINKS, TREE.replace('</joint>', '<dynamics damping="0.25" friction="0.5"/></joint>', 1),
        '<transmission name="t"><joint name="rocker_joint"/></transmission>\n'
        '<ros2_control name="c" type="system"><joint name="coupler_joint">'
        '<command_interface name="effort"/></joint><joint name="crank_joint"/></ros2_control>\n',
        LOOPS['loop'][1])
    imported = read(tmp_path, text)
    assert imported.mechanism.actuated_joints == ('coupler_joint', 'rocker_joint')
    assert imported.effects == {
        'gravity': {'type': 'gravity', 'acceleration': (0.0, 0.0, -9.81)},
        'damping_crank_joint': {
            'type': 'joint_damping', 'joint': 'crank_joint', 'coefficient': 0.25},
        'friction_crank_joint': {
            'type': 'joint_friction', 'joint': 'crank_joint', 'coulomb': 0.5}}


def test_joints_that_mimic_others_and_gears(tmp_path):
    text = robot(LINKS, TREE.replace(
        '</joint>', '<mimic joint="rocker_joint" multiplier="-2" offset="0.5"/></joint>', 1),
        '<coupling name="gear"><predecessor link="coupler"/><successor link="rocker"/>'
        '<ratio value="3"/></coupling>')
    imported = read(tmp_path, text)
    assert imported.mechanism.couplings == (
        Coupling('crank_joint_mimics_rocker_joint', {'crank_joint': 1.0, 'rocker_joint': 2.0},
                 0.5),
        Coupling('gear', {'rocker_joint': 1.0, 'coupler_joint': -3.0, 'crank_joint': -3.0}))
    assert imported.mechanism.actuated_joints == ()


def test_limits_become_end_stops_where_asked_for(tmp_path):
    text = robot(LINKS, TREE.replace(
        'continuous', 'revolute', 1).replace('effort="2"', 'effort="2" lower="-1" upper="2"'),
        LOOPS['loop'][1])
    assert read(tmp_path, text).limits == {'crank_joint': (-1.0, 2.0)}
    assert not any(name.startswith('end') for name in read(tmp_path, text).effects)
    assert read(tmp_path, text, end_stops=1e4).effects['end_stop_crank_joint'] == {
        'type': 'end_stop', 'joint': 'crank_joint', 'stiffness': 1e4, 'lower': -1.0, 'upper': 2.0}


def test_what_is_not_read_is_reported(tmp_path):
    text = four_bar().replace('</robot>', '<sensor name="s"/><colour/><colour/></robot>').replace(
        '<link name="base"/>', '<link name="base"><collision/></link>')
    ignored = read(tmp_path, text).ignored
    assert ignored['collision'] == 'bodies pass through each other'
    assert ignored['sensor'] == 'for sensors'
    assert ignored['2 colour'] == 'not known to this reader'


def test_what_links_are_drawn_as_goes_with_their_bodies(tmp_path):
    box = ('<visual><origin xyz="0.1 0 0"/><geometry><box size="1 2 3"/></geometry>'
           '<material name="red"/></visual>')
    mesh = ('<visual><geometry><mesh filename="package://{}/meshes/tip.stl"/></geometry></visual>'
            '<visual><geometry><mesh filename="other.obj" scale="2 -2 2"/></geometry>'
            '<material><color rgba="0.1 0.2 0.3 1"/></material></visual>')
    (tmp_path / 'meshes').mkdir()
    (tmp_path / 'meshes' / 'tip.stl').touch()
    text = robot(LINKS, TREE, machines.TIPS, LOOPS['loop'][1])
    text = text.replace('</robot>', '<material name="red"><color rgba="1 0 0 1"/></material>'
                        '</robot>')
    for name, inside in (('crank', box), ('coupler_tip', mesh.format(tmp_path.name)),
                         ('base', box)):
        text = text.replace(f'<link name="{name}">', f'<link name="{name}">{inside}').replace(
            f'<link name="{name}"/>', f'<link name="{name}">{inside}</link>')
    mechanism = read(tmp_path, text).mechanism
    bodies = {body.name: body for body in mechanism.bodies}
    drawn, = bodies['crank'].visual
    assert mechanism.ground_visual == (drawn,) and drawn.color == (1.0, 0.0, 0.0)
    assert (drawn.kind, drawn.size, drawn.center) == ('box', (1.0, 2.0, 3.0), (0.1, 0.0, 0.0))
    # The tip is fixed to the coupler, 0.4 m along it.
    tip, other = bodies['coupler'].visual
    assert tip.file == str(tmp_path.resolve() / 'meshes' / 'tip.stl') and tip.size == (1, 1, 1)
    assert other.file == str(tmp_path.resolve() / 'other.obj') and other.size == (2, -2, 2)
    assert tip.center == pytest.approx((0.4, 0.0, 0.0))
    assert (tip.color, other.color) == (None, (0.1, 0.2, 0.3))
    # What cannot be drawn moves nothing.
    imported = read(tmp_path, text.replace('size="1 2 3"', 'size="1 2 0"', 1))
    assert not imported.mechanism.ground_visual
    assert imported.ignored['a visual of base (expected size to be positive, got other numbers)'] \
        == 'not drawn'
    text = text.replace('scale="2 -2 2"', 'scale="2 -2 2 1"')
    assert len(read(tmp_path, text).mechanism.bodies[1].visual) == 1


def test_joints_of_several_freedoms(tmp_path):
    text = robot(
        link('base'), link('a', *machines.BARS['crank']), link('b', *machines.BARS['rocker']),
        joint('drift', 'floating', 'base', 'a'),
        joint('slide', 'planar', 'a', 'b', '0.1 0 0', '1 0 0'))
    free, planar = read(tmp_path, text).mechanism.joints
    assert (free.type, planar.type) == ('free', 'planar')
    # The plane's normal is the z axis of the joint's frame.
    x, y, z, w = planar.orientation
    np.testing.assert_allclose([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
                               [1.0, 0.0, 0.0], atol=1e-15)


def test_names_become_ours(tmp_path):
    text = robot(link('base'), link('2nd link', *machines.BARS['crank']),
                 link('2nd-link', *machines.BARS['crank']),
                 joint('a/b', 'continuous', 'base', '2nd link'),
                 joint('a.b', 'continuous', 'base', '2nd-link'))
    mechanism = read(tmp_path, text).mechanism
    assert [body.name for body in mechanism.bodies] == ['x2nd_link', 'x2nd_link_2']
    assert mechanism.joint_names == ('a_b', 'a_b_2')


def test_yaml_text_is_the_same_mechanism(tmp_path):
    text = four_bar().replace('<origin xyz="0.1 0 0"/>', '<origin xyz="0.1 0 0" rpy="1 2 3"/>')
    mechanism = read(tmp_path, text).mechanism
    path = written(tmp_path, mechanism_text(mechanism, ['a note']), 'again.yaml')
    assert read_mechanism(path) == mechanism


FAULTS = {
    'no_xml': ('<robot', '<robot <', r':1: expected XML, got a syntax error'),
    'doctype': ('<robot', '<!DOCTYPE x [<!ENTITY a "b">]><robot',
                r':1: expected plain elements, got a document type definition'),
    'root': ('robot', 'sdf', r":1: <sdf name='four_bar'>: expected one of the elements <robot>"),
    'link_twice': ('name="crank"', 'name="coupler"', 'expected every name once'),
    'name': ('joint name="crank_joint"', f'joint name="{"a" * 256}"',
             'expected a name of at most 255 characters, got one of 256'),
    'parent': ('parent link="base"', 'parent link="bas"',
               r"<joint name='crank_joint'>: expected the name of a link or frame, got 'bas' "
               r"\(did you mean 'base'\?\)"),
    'loop_end': ('predecessor link="coupler"', 'predecessor link="x"',
                 r"<loop name='pin'>: expected the name of a link or frame, got 'x'"),
    'type': ('type="continuous"', 'type="hinge"',
             r"<joint name='crank_joint'>: expected type to be one of revolute, .* got 'hinge'"),
    'number': ('mass value="0.5"', 'mass value="1,5"',
               r"<mass>: expected value to be 1 finite number, got '1,5'"),
    'nan': ('xyz="0.1 0 0"', 'xyz="0.1 nan 0"',
            r"<origin>: expected xyz to be 3 finite numbers, got '0.1 nan 0'"),
    'mass': ('mass value="0.5"', 'mass value="-1"',
             'expected a mass that is zero or more, got -1'),
    'inertia': ('iyy="0.00055"', 'iyy="-1"',
                r"<link name='crank'>: expected "
                'moments of inertia that a body can have'),
    'axis': ('axis xyz="0 1 0"', 'axis xyz="0 0 0"',
             'expected xyz to be a direction that is not zero'),
    'two_parents': ('child link="rocker"', 'child link="coupler"',
                    r"expected a child that no other joint carries, got 'coupler', which joint "
                    "'coupler_joint' carries"),
    'cycle': ('parent link="base"', 'parent link="coupler"', 'got a cycle'),
    'mimic': ('</joint>', '<mimic joint="rocker"/></joint>',
              r"<mimic>: expected the name of a joint, got 'rocker' \(did you mean 'rocker_jo"),
    'coupled_link': ('</robot>', '<coupling name="c"><predecessor link="x"/><successor '
                     'link="base"/><ratio value="1"/></coupling></robot>',
                     "expected the name of a link or frame, got 'x'"),
}


@pytest.mark.parametrize('fault', FAULTS)
def test_faults_name_file_line_and_element(tmp_path, fault):
    right, wrong, said = FAULTS[fault]
    text = four_bar()
    assert right in text
    path = written(tmp_path, text.replace(right, wrong, None if fault == 'root' else 1)
                   if fault != 'root' else text.replace(right, wrong))
    with pytest.raises(MechanismError, match=said) as caught:
        read_model(path)
    assert re.match(rf'{path}:\d+: ', str(caught.value))


def test_xacro_is_expanded(tmp_path):
    pytest.importorskip('xacro')
    text = four_bar().replace('<robot ', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    text = text.replace('<link name="base"/>', '<link name="base"/>\n'
                        '<xacro:property name="l" value="0.1"/>', 1).replace(
        'origin xyz="0.1 0 0"', 'origin xyz="${l} 0 0"')
    assert '${l}' in text
    mechanism = read_model(written(tmp_path, text, 'robot.urdf.xacro')).mechanism
    plain = read(tmp_path, four_bar()).mechanism
    assert replace(mechanism, description='') == replace(plain, description='')
    with pytest.raises(MechanismError, match='expected what xacro can expand, got: name .k. is'):
        read_model(written(tmp_path, text.replace('${l}', '${k}'), 'robot.xacro'))


def test_xacro_finds_packages_without_ros(tmp_path, monkeypatch):
    pytest.importorskip('xacro')
    for name in ('AMENT_PREFIX_PATH', 'ROS_PACKAGE_PATH'):
        monkeypatch.delenv(name, raising=False)
    other = tmp_path / 'elsewhere'
    text = four_bar().replace(
        '<robot ', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1).replace(
        '<link name="base"/>', '<xacro:include filename="$(find parts)/urdf/base.xacro"/>')
    for place in (tmp_path / 'parts' / 'urdf', other / 'parts' / 'urdf'):
        place.mkdir(parents=True)
        written(place, '<robot><link name="base"/></robot>', 'base.xacro')
    inside = written(tmp_path / 'parts' / 'urdf', text, 'robot.xacro')
    assert len(read_model(inside).mechanism.bodies) == 3
    lonely = tmp_path / 'lonely.xacro'
    lonely.write_text(text.replace('$(find parts)', '$(find spare)'))
    with pytest.raises(MechanismError, match="no folder of the package 'spare' around the file"):
        read_model(lonely)
    (other / 'parts').rename(other / 'spare')
    monkeypatch.setenv('ROS_PACKAGE_PATH', str(other))
    assert len(read_model(lonely).mechanism.bodies) == 3


@pytest.mark.parametrize('name, text, missing', [
    ('robot.xacro', '<robot/>', 'xacro'), ('robot.mjcf', '<mujoco/>', 'mujoco')])
def test_what_is_not_installed_is_named(tmp_path, monkeypatch, name, text, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MechanismError, match=f'{name}: .* needs .*: pip install {missing}'):
        read_model(written(tmp_path, text, name))


def test_too_large_a_file_is_refused(tmp_path):
    path = written(tmp_path, '<robot name="a">' + ' ' * 10_000_001 + '</robot>')
    with pytest.raises(MechanismError, match='expected a file of at most 10000000 bytes'):
        read_model(path)


def test_deep_and_many_elements_are_refused(tmp_path):
    with pytest.raises(MechanismError, match='expected elements at most 100 deep'):
        read(tmp_path, '<robot>' + '<a>' * 200 + '</a>' * 200 + '</robot>')
    with pytest.raises(MechanismError, match='expected at most 200000 elements'):
        read(tmp_path, '<robot>' + '<a/>' * 200_001 + '</robot>')


def test_joints_of_gazebo_close_loops_as_they_are_drawn(tmp_path):
    pin = ('<gazebo><frame name="top" attached_to="rocker"><pose>0.3 0 0 0 0 0</pose></frame>'
           '<joint name="pin" type="revolute">POSE<parent>coupler</parent><child>CHILD</child>'
           '<axis><xyz EXPRESSED>0 1 0</xyz><dynamics><damping>0.2</damping></dynamics></axis>'
           '</joint><plugin name="p"/></gazebo>')
    # Drawn with its loop closed: the coupler's end is where the rocker's is.
    tree = TREE.replace('0.35 0 0', '0.2 0 0')
    for pose, child, expressed in (
            ('<pose>0.3 0 0 0 0 0</pose>', 'rocker', ''), ('', 'top', 'expressed_in="crank"'),
            ('<pose relative_to="coupler">0.4 0 0 0 0 0</pose>', 'rocker', '')):
        text = pin.replace('POSE', pose).replace('CHILD', child).replace('EXPRESSED', expressed)
        imported = read(tmp_path, robot(LINKS, tree, text))
        cut, = imported.mechanism.cut_joints
        # Body A is the child, whose coordinate it is.
        assert (cut.name, cut.type, cut.body_a, cut.body_b) == (
            'pin', 'revolute', 'rocker', 'coupler')
        assert cut.point_a == pytest.approx((0.3, 0.0, 0.0))
        assert cut.point_b == pytest.approx((0.4, 0.0, 0.0))
        assert cut.axis_a == cut.axis_b == (0.0, 1.0, 0.0)
        assert imported.effects['damping_pin']['coefficient'] == 0.2
        assert imported.ignored['plugin'] == 'for a simulator'
    with pytest.raises(MechanismError, match=r"<joint name='pin'>: expected the name of a frame, "
                                             "got 'rockr'"):
        read(tmp_path, robot(LINKS, tree, pin.replace('POSE', '').replace(
            'CHILD', 'rockr').replace('EXPRESSED', '')))


def test_springs_of_gazebo_act_in_joints(tmp_path):
    spring = ('<gazebo reference="crank_joint"><springStiffness>3</springStiffness>'
              '<springReference>0.2</springReference></gazebo>')
    imported = read(tmp_path, robot(LINKS, TREE, LOOPS['loop'][1], spring))
    assert imported.effects['stiffness_crank_joint'] == {
        'type': 'joint_spring', 'joint': 'crank_joint', 'stiffness': 3.0, 'rest': 0.2}
    with pytest.raises(MechanismError, match='expected springStiffness to be zero or more'):
        read(tmp_path, robot(LINKS, TREE, spring.replace('>3<', '>-3<')))


@pytest.mark.parametrize('way', LOOPS)
def test_a_link_called_ground_that_is_not_the_root(tmp_path, way):
    imported = read(tmp_path, four_bar(way).replace('"coupler"', '"ground"'))
    assert [body.name for body in imported.mechanism.bodies] == ['crank', 'ground_link', 'rocker']
    assert imported.ignored['the name ground of a link, ground_link taken'] == (
        'ground is the world')
    expected = read(tmp_path, four_bar(way)).mechanism
    assert mechanism_text(imported.mechanism).replace('ground_link', 'coupler') == (
        mechanism_text(expected))


@pytest.mark.parametrize('inside', ['<gravity>false</gravity>',
                                    '<turnGravityOff>true</turnGravityOff>'])
def test_links_that_gravity_does_not_act_on(tmp_path, inside):
    off = f'<gazebo reference="coupler">{inside}</gazebo>'
    effects = read(tmp_path, robot(LINKS, TREE, LOOPS['loop'][1], off)).effects
    assert effects['lift_coupler_center_of_mass']['force'] == (0.0, 0.0, 9.81)
    on = off.replace('true', 'false') if 'turn' in off else off.replace('false', 'true')
    assert 'lift_coupler_center_of_mass' not in read(
        tmp_path, robot(LINKS, TREE, LOOPS['loop'][1], on)).effects


def test_commands_read_models_as_they_are_asked_to(tmp_path, capsys):
    text = robot(LINKS, TREE, LOOPS['loop'][1]).replace('<mass value="1.0"/>', '<mass value="0"/>')
    path = str(written(tmp_path, text))
    assert main(['check', path]) == 2
    assert '--mend-inertias, takes 8e-13 kg' in capsys.readouterr().err
    assert main(['check', path, '--mend-inertias']) == 0
    assert 'left out, it has an inertia: the mass 0 of coupler' in capsys.readouterr().out
    out = str(tmp_path / 'out.urdf')
    assert main(['export', path, '--output', out, '--mend-inertias']) == 0
    assert main(['check', 'four_bar', '--mend-inertias']) == 2
    assert "--mend-inertias: expected a model in another format, got 'four_bar'; " in (
        capsys.readouterr().err)
    assert main(['check', path, '--argument', 'a:=1']) == 2
    assert 'expected a xacro file, which has arguments' in capsys.readouterr().err
    scene = written(tmp_path, 'mechanism: ./robot.urdf\nmend_inertias: true\n', 's.yaml')
    assert load_scene(scene).mechanism.bodies[1].mass == 8e-13
    scene.write_text('mechanism: ./robot.urdf\nanywhere: 3\n')
    with pytest.raises(SceneError, match='anywhere: expected'):
        load_scene(scene)


def test_what_moves_bodies_and_nobody_reads_is_named_with_its_size(tmp_path):
    text = robot(LINKS, TREE, LOOPS['loop'][1], MOVING).replace(
        '<limit', '<dynamics D="1.5" K="-7" mu="0"/><limit', 1)
    imported = read_model(written(tmp_path, text))
    assert {(one.quantity, one.kind, one.name, one.size) for one in imported.omitted} == {
        ('velocity_decay', 'gazebo', 'crank', 0.5), ('plugin', 'gazebo', 'four_bar', np.inf),
        ('drake:linear_bushing_rpy', 'robot', 'four_bar', 20.0),
        ('D', 'joint', 'crank_joint', 1.5), ('K', 'joint', 'crank_joint', 7.0)}
    assert imported.ignored['dynamics@mu'] == 'not known to this reader'
    assert imported.ignored['plugin'] == 'for a simulator'
    assert ('left out of the motion, not known to this reader: K of joint crank_joint (7); D of '
            'joint crank_joint (1.5)') in lines(imported, 1.0)
