# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Loops and couplings that a file leaves to programs, and elements that nobody knows."""

import builtins
from dataclasses import replace

from closedloop_dynamics import Coupling, load_scene, MechanismError, read_mechanism, SceneError
from closedloop_dynamics.cli import main
from closedloop_dynamics.formats.building import lines
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.kinematics.second_order import find_degrees_of_freedom
from closedloop_dynamics.mechanism.document import UNREAD
import numpy as np
import pytest

from . import test_sdf
from .machines import four_bar, joint, LINKS, robot, TREE, written

TIP = ('<link name="stub"><inertial><mass value="0.01"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" '
       'ixy="0" ixz="0" iyz="0"/></inertial></link>')
# Drawn with its loop closed: the coupler's end is where the rocker's is.
CLOSED = TREE.replace('0.35 0 0', '0.2 0 0')
PIN = TIP + joint('pin', 'continuous', 'coupler', 'stub', '0.4 0 0')
PLUGIN = ('<plugin filename="FILE" name="NAME"><parent_link>rocker</parent_link>'
          '<child_model>four_bar</child_model><child_link>stub</child_link></plugin>')
DETACHABLE = PLUGIN.replace('FILE', 'gz-sim-detachable-joint-system').replace(
    'NAME', 'gz::sim::systems::DetachableJoint')
MIMIC = ('<gazebo><plugin name="m" filename="libmimic_joint_plugin.so"><joint>rocker_joint</joint>'
         '<mimicJoint>crank_joint</mimicJoint><multiplier>-2</multiplier><offset>0.5</offset>'
         '</plugin></gazebo>')
PARAMETERS = ('<ros2_control name="c" type="system"><joint name="rocker_joint"><command_interface '
              'name="effort"/></joint><joint name="crank_joint"><param name="mimic">rocker_joint'
              '</param><param name="multiplier">-2</param><param name="offset">0.5</param>'
              '<command_interface name="effort"/></joint></ros2_control>')
LINK = ('<gazebo><link name="rod"><pose>0 0 0.1 0 0 0</pose><inertial><mass>0.1</mass><inertia>'
        '<ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link></gazebo>'
        '<gazebo><joint name="foot" type="revolute"><parent>base</parent><child>rod</child>'
        '<axis><xyz>0 1 0</xyz></axis></joint><joint name="head" type="revolute"><pose>0.1 0 0 0 '
        '0 0</pose><parent>coupler</parent><child>rod</child><axis><xyz>0 1 0</xyz></axis>'
        '</joint></gazebo>')
TWO_FRAMES = """\
<sdf version="1.7"><model name="bars">
<frame name="F1" attached_to="world"><pose>-2 0 0 0 0 0</pose></frame>
<frame name="F2" attached_to="world"><pose>2 0 0 0 0 0</pose></frame>
<link name="short"><pose>-2 0 0 0 0 0</pose></link>
<frame name="S" attached_to="short"><pose relative_to="short">0 0 1 0 0 0</pose></frame>
<link name="long"><pose>0.4 0 1 0 0 0</pose></link>
<frame name="L1" attached_to="long"><pose relative_to="long">-2.4 0 0 0 0 0</pose></frame>
<frame name="L2" attached_to="long"><pose relative_to="long">2.4 0 0 0 0 0</pose></frame>
<link name="side"><pose>2 0 0 0 0 0</pose></link>
<frame name="R" attached_to="side"><pose relative_to="side">0 0 2 0 0 0</pose></frame>
""" + ''.join(
    f'<joint name="{name}" type="revolute"><parent>{ends[0]}</parent><child>{ends[1]}</child>'
    f'<drake:parent_frame>{frames[0]}</drake:parent_frame>'
    f'<drake:child_frame>{frames[1]}</drake:child_frame><axis><xyz>0 -1 0</xyz>'
    f'<limit><effort>{int(name != "j_loop")}</effort></limit></axis></joint>\n'
    for name, ends, frames in (
        ('j_short', ('world', 'short'), ('F1', 'short')),
        ('j_side', ('world', 'side'), ('F2', 'side')),
        ('j_long', ('short', 'long'), ('S', 'L1')),
        ('j_loop', ('long', 'side'), ('L2', 'R')))) + '</model></sdf>'


def read(tmp_path, text, name='robot.urdf', **options):
    return read_model(written(tmp_path, text, name), **options)


def freedoms(imported):
    return find_degrees_of_freedom(imported.mechanism)


def test_a_detachable_joint_holds_two_links_as_they_are_drawn(tmp_path):
    imported = read(tmp_path, robot(LINKS, CLOSED, PIN, f'<gazebo>{DETACHABLE}</gazebo>'))
    # The stub is a part of the rocker, and the pin closes the loop.
    assert [body.name for body in imported.mechanism.bodies] == ['crank', 'coupler', 'rocker']
    assert imported.mechanism.bodies[2].mass == pytest.approx(0.81)
    cut, = imported.mechanism.cut_joints
    assert (cut.name, cut.body_a, cut.body_b) == ('pin', 'coupler', 'rocker')
    assert cut.point_a == pytest.approx((0.4, 0.0, 0.0))
    assert cut.point_b == pytest.approx((0.3, 0.0, 0.0))
    assert freedoms(imported) == 1
    assert any('rocker and stub' in what for what in imported.ignored)
    assert not imported.omitted


def test_a_detachable_joint_of_sdf_is_a_fixed_joint(tmp_path):
    plugin = ('<plugin filename="f" name="gz::sim::systems::DetachableJoint"><parent_link>rocker'
              '</parent_link><child_model>four_bar</child_model><child_link>tip</child_link>'
              '</plugin>')
    fixed = '<joint name="j" type="fixed"><parent>rocker</parent><child>tip</child></joint>'
    text = test_sdf.FOUR_BAR.replace('0.35 0 0 0 90 0', '0.5 0 0 0 90 0')
    pin = ('<link name="tip"><pose relative_to="coupler">0.4 0 0 0 0 0</pose></link>'
           '<joint name="end" type="ball"><parent>coupler</parent><child>tip</child></joint>')
    a = text.index('<frame name="tip"')
    text = text.replace(text[a:text.index('</frame>', a) + 8], '')
    a = text.index('<joint name="pin"')
    text = text.replace(text[a:text.index('</joint>', a) + 8], pin + 'JOINT')
    found, other = (read(tmp_path, text.replace('JOINT', one), 'model.sdf').mechanism
                    for one in (plugin, fixed))
    assert found == other
    assert [cut.name for cut in found.cut_joints] == ['end']


def test_a_detachable_joint_in_a_model_in_a_model(tmp_path):
    plugin = ('<plugin name="gz::sim::systems::DetachableJoint"><parent_link>rocker</parent_link>'
              '<child_model>MODEL</child_model><child_link>crank</child_link></plugin>')
    inner = test_sdf.FOUR_BAR[test_sdf.FOUR_BAR.index('<model'):].replace('</world></sdf>', '')
    inner = inner.replace('</model>', f'{plugin}</model>')
    for model, joined in (('four_bar', True), ('table', False)):
        text = (f'<sdf version="1.10"><model name="whole">{inner.replace("MODEL", model)}'
                '</model></sdf>')
        imported = read(tmp_path, text, 'model.sdf')
        assert (len(imported.mechanism.bodies) == 2) == joined
        assert bool(imported.omitted) != joined
    text = (f'<sdf version="1.10"><model name="whole"><model name="cell">'
            f'{inner.replace("MODEL", "cell::four_bar")}</model></model></sdf>')
    assert len(read(tmp_path, text, 'model.sdf').mechanism.bodies) == 2


@pytest.mark.parametrize('way', [MIMIC, PARAMETERS])
def test_programs_that_mimic_joints_are_couplings(tmp_path, way):
    imported = read(tmp_path, robot(LINKS, TREE, way))
    said = '<mimic joint="rocker_joint" multiplier="-2" offset="0.5"/></joint>'
    plain = read(tmp_path, robot(LINKS, TREE.replace('</joint>', said, 1)))
    assert imported.mechanism.couplings == plain.mechanism.couplings == (Coupling(
        'crank_joint_mimics_rocker_joint', {'crank_joint': 1.0, 'rocker_joint': 2.0}, 0.5),)
    assert 'crank_joint' not in imported.mechanism.actuated_joints
    # Told twice, it is one coupling.
    twice = read(tmp_path, robot(LINKS, TREE.replace('</joint>', said, 1), way))
    assert twice.mechanism.couplings == plain.mechanism.couplings
    with pytest.raises(MechanismError, match='expected the multiplier and offset that .* has, got '
                                             'others'):
        read(tmp_path, robot(LINKS, TREE.replace('</joint>', said.replace('-2', '2'), 1), way))


def test_mimics_of_drake_are_couplings(tmp_path):
    text = test_sdf.FOUR_BAR.replace('</joint>', '<drake:mimic joint="coupler_joint" '
                                     'multiplier="3" offset="0.1"/></joint>', 1)
    assert read(tmp_path, text, 'model.sdf').mechanism.couplings == (Coupling(
        'crank_joint_mimics_coupler_joint', {'crank_joint': 1.0, 'coupler_joint': -3.0}, 0.1),)


@pytest.mark.parametrize('said, driven', [
    ('true', True), ('True', True), ('TRUE', True), ('1', True), ('False', False)])
def test_independent_joints_are_driven_however_it_is_written(tmp_path, said, driven):
    text = four_bar().replace('<joint ', f'<joint independent="{said}" ', 1)
    assert ('crank_joint' in read(tmp_path, text).mechanism.actuated_joints) == driven
    text = four_bar().replace('<loop ', f'<loop independent="{said}" ', 1)
    assert read(tmp_path, text).mechanism.cut_joints[0].actuated == driven


def test_links_of_gazebo_are_links(tmp_path):
    # A rod in the place of the rocker, from the ground to the coupler, as it is drawn.
    imported = read(tmp_path, robot(LINKS, TREE, LINK))
    assert {body.name for body in imported.mechanism.bodies} == {
        'crank', 'coupler', 'rocker', 'rod'}
    joints = {one.name: one for one in imported.mechanism.joints}
    assert len(imported.mechanism.cut_joints) == 1
    foot, = (one for one in (*joints.values(), *imported.mechanism.cut_joints)
             if one.name == 'foot')
    assert (foot.parent, foot.child, foot.position) == ('ground', 'rod', (0.0, 0.0, 0.1))
    # What nothing joins to the rest floats where it is drawn.
    alone = read(tmp_path, robot(LINKS, TREE, LINK[:LINK.index('<gazebo><joint')]))
    free = alone.mechanism.joints[-1] if alone.mechanism.joints[-1].type == 'free' else next(
        one for one in alone.mechanism.joints if one.type == 'free')
    assert (free.child, free.position) == ('rod', (0.0, 0.0, 0.1))


def test_joints_between_two_frames_lie_where_the_frames_are(tmp_path):
    mechanism = read(tmp_path, TWO_FRAMES, 'model.sdf').mechanism
    # Whatever is drawn: a crank of 1 m, a coupler of 4.8 m, a rocker of 2 m on 4 m.
    places = {one.name: np.array(one.position) for one in mechanism.joints}
    cut, = mechanism.cut_joints
    ends = np.array([cut.point_a, cut.point_b])
    assert np.linalg.norm(places['j_side'] - places['j_short']) == pytest.approx(4.0)
    assert np.linalg.norm(places['j_long']) == pytest.approx(1.0)
    assert sorted(np.linalg.norm(ends, axis=1)) == pytest.approx([2.0, 4.8])
    with pytest.raises(MechanismError, match="expected a frame on the parent link 'short', got "
                                             "'R'"):
        read(tmp_path, TWO_FRAMES.replace('parent_frame>S<', 'parent_frame>R<'), 'model.sdf')


FAULTS = {
    'link': ('<child_link>stub<', '<child_link>stubs<',
             r"<child_link>: expected the name of a link or frame, got 'stubs' \(did you mean"),
    'joint': ('<joint>rocker_joint<', '<joint>rockr_joint<',
              r"expected the name of a joint, got 'rockr_joint' \(did you mean 'rocker_joint'"),
    'itself': ('<mimicJoint>crank_joint<', '<mimicJoint>rocker_joint<',
               'expected another joint, got the joint itself'),
    'zero': ('<multiplier>-2<', '<multiplier>0<', 'a multiplier that is not zero, got 0'),
    'number': ('<offset>0.5<', '<offset>half<',
               "expected offset to be 1 finite number, got 'half'"),
    'parameter': ('<param name="multiplier">-2<', '<param name="multiplier">x<',
                  "expected multiplier to be 1 finite number, got 'x'"),
    'leader': ('<param name="mimic">rocker_joint<', '<param name="mimic">x<',
               "expected the name of a joint, got 'x'"),
    'independent': ('<joint name="crank_joint"', '<joint independent="yes" name="crank_joint"',
                    "expected independent to be true or false, got 'yes'"),
}


@pytest.mark.parametrize('fault', FAULTS)
def test_faults_name_file_line_and_element(tmp_path, fault):
    right, wrong, said = FAULTS[fault]
    whole = next(text for text in (
        robot(LINKS, CLOSED, PIN, f'<gazebo>{DETACHABLE}</gazebo>'), robot(LINKS, TREE, MIMIC),
        robot(LINKS, TREE, PARAMETERS)) if right in text)
    with pytest.raises(MechanismError, match=rf'robot\.urdf:\d+: .*{said}'):
        read(tmp_path, whole.replace(right, wrong, 1))


@pytest.mark.parametrize('name, acts', [
    ('gz::sim::systems::DetachableJoint', True), ('libgazebo_ros_link_attacher.so', True),
    ('libgazebo_grasp_fix.so', True), ('libgazebo_ros_vacuum_gripper.so', True),
    ('gz-sim-diff-drive-system', True), ('gz-sim-joint-position-controller-system', True),
    ('libgazebo_ros2_control.so', True), ('libdisable_link_plugin.so', True),
    ('gz-sim-ackermann-steering-system', True), ('gz-sim-trackedvehicle-system', True),
    ('gz-sim-joint-state-publisher-system', False), ('libgazebo_ros_camera.so', False),
    ('gz-sim-pose-publisher-system', False), ('libgazebo_ros_imu_sensor.so', False),
    ('libgazebo_ros_joint_state_publisher.so', False), ('gz-sim-scene-broadcaster-system', False)])
def test_programs_that_join_couple_or_drive_are_reported_as_such(tmp_path, name, acts):
    for text, path in (
            (four_bar().replace('</robot>', f'<gazebo><plugin name="p" filename="{name}"/>'
                                '</gazebo></robot>'), 'robot.urdf'),
            (test_sdf.FOUR_BAR.replace('</model>', f'<plugin name="p" filename="{name}"/>'
                                       '</model>'), 'model.sdf')):
        imported = read(tmp_path, text, path)
        assert ([one.quantity for one in imported.omitted] == ['plugin']) == acts
        assert ('plugin' in imported.ignored) != acts
        assert any('left out of the motion, programs are not run: plugin' in line
                   for line in lines(imported, 1.0)) == acts


def test_a_child_in_another_model_is_reported(tmp_path):
    text = robot(LINKS, CLOSED, PIN, f'<gazebo>{DETACHABLE}</gazebo>').replace(
        '<child_model>four_bar', '<child_model>table')
    imported = read(tmp_path, text)
    assert [(one.quantity, one.reason) for one in imported.omitted] == [
        ('plugin', 'programs are not run')]
    assert freedoms(imported) is not None and not imported.mechanism.cut_joints


def test_what_names_two_links_and_nobody_knows_is_reported(tmp_path):
    for element in ('<rope a="crank" b="rocker"/>',
                    '<rope><a>crank</a><b link="rocker"/></rope>'):
        imported = read(tmp_path, four_bar().replace('</robot>', f'{element}</robot>'))
        assert [(one.quantity, one.reason) for one in imported.omitted] == [
            ('rope', 'not known, though it names links or joints')]
    quiet = '<disable_collisions link1="crank" link2="rocker"/>'
    assert not read(tmp_path, four_bar().replace('</robot>', f'{quiet}</robot>')).omitted


# The start of an element and the element it is in, of both formats.
PLACES = [('robot.urdf', '<inertial>', 'inertial'),
          ('robot.urdf', '<joint name="crank_joint" type="continuous">', 'joint'),
          ('robot.urdf', '<loop name="pin" type="continuous">', 'loop'),
          ('robot.urdf', '<link name="crank">', 'link'),
          ('model.sdf', '<link name="crank">', 'link'), ('model.sdf', '<inertial>', 'inertial'),
          ('model.sdf', '<joint name="crank_joint" type="revolute">', 'joint'),
          ('model.sdf', '<frame name="tip" attached_to="coupler">', 'frame')]


@pytest.mark.parametrize('name, start, parent', PLACES)
def test_what_nobody_knows_in_a_body_or_joint_is_refused(tmp_path, capsys, name, start, parent):
    text = four_bar() if name == 'robot.urdf' else test_sdf.FOUR_BAR
    assert start in text
    path = written(tmp_path, text.replace(start, f'{start}<shift>0.3 0 0</shift>'), name)
    with pytest.raises(MechanismError, match=rf'{name}:\d+: <shift>: expected an element of '
                       rf'<{parent}> that this reader knows, got <shift> \(.* --ignore shift'):
        read_model(path)
    asked = read_model(path, ignore=('shift',))
    plain = read(tmp_path, text, f'plain_{name}')
    assert replace(asked.mechanism, description='') == replace(
        plain.mechanism, description='')
    assert any('shift' in what and why == 'as it was asked for'
               for what, why in asked.ignored.items())
    assert main(['check', str(path)]) == 2
    assert '--ignore shift' in capsys.readouterr().err
    assert main(['check', str(path), '--ignore', 'shift']) == 0
    assert 'left out, as it was asked for: ' in capsys.readouterr().out
    scene = written(tmp_path, f'mechanism: ./{name}\nignore: [shift]\n', 's.yaml')
    assert load_scene(scene).mechanism.bodies == asked.mechanism.bodies


def test_what_is_ignored_must_be_there(tmp_path):
    with pytest.raises(MechanismError, match=(
            r'robot\.urdf: ignore: expected elements of the file '
            r"that are not read, got 'shift' \(not read: none\)")):
        read(tmp_path, four_bar(), ignore=('shift',))
    written(tmp_path, four_bar())
    scene = written(tmp_path, 'mechanism: ./robot.urdf\nignore: 3\n', 's.yaml')
    with pytest.raises(SceneError, match='ignore: expected a list'):
        load_scene(scene)


@pytest.mark.parametrize('inside, parent', [
    ('<sensor name="s"/>', 'crank'), ('<origin xyz="0 0 0"/>', 'crank'),
    ('<gravity>1</gravity>', 'crank'), ('<self_collide/>', 'crank')])
def test_what_moves_nothing_is_left_out(tmp_path, inside, parent):
    parent = f'<link name="{parent}">'
    assert read(tmp_path, four_bar().replace(parent, parent + inside)).mechanism == (
        read(tmp_path, four_bar()).mechanism)
    moved = '<origin xyz="0 0 1"/>'
    with pytest.raises(MechanismError, match='<origin>: expected an element of <link>'):
        read(tmp_path, four_bar().replace(parent, parent + moved))


def test_inertias_that_follow_from_shapes_are_refused(tmp_path):
    text = test_sdf.FOUR_BAR.replace('<inertial>', '<inertial auto="true">', 1)
    with pytest.raises(MechanismError, match=r'<inertial>: expected a mass and an inertia, got '
                                             'one that is to follow from shapes'):
        read(tmp_path, text, 'model.sdf')


@pytest.mark.parametrize('suffix', [*UNREAD, '.OSIM', '.bioMod'])
def test_formats_that_are_not_read_are_named(tmp_path, capsys, suffix):
    path = tmp_path / f'model{suffix}'
    path.write_bytes(b'PXR-USDC\x00\xff')
    said = (f'{path}: expected a YAML file, or a model in URDF, xacro, SDF or MJCF (.urdf, '
            f'.xacro, .sdf, .world, .mjcf, .xml), got {UNREAD[suffix.lower()]}, which is not read')
    assert main(['check', str(path)]) == 2
    assert said in capsys.readouterr().err
    with pytest.raises(SceneError, match='which is not read'):
        load_scene(path)
    with pytest.raises(MechanismError, match='which is not read'):
        read_mechanism(path)
    scene = written(tmp_path, f'mechanism: ./{path.name}\ninitial: {{position: {{}}}}\n', 's.yaml')
    with pytest.raises(SceneError, match='which is not read'):
        load_scene(scene)


@pytest.mark.parametrize('name, text, library', [
    ('robot.xacro', '<robot/>', 'xacro'), ('robot.mjcf', '<mujoco/>', 'mujoco')])
def test_a_broken_installation_is_not_a_missing_one(tmp_path, monkeypatch, name, text, library):
    imported = builtins.__import__

    def broken(module, *rest):
        if module == library:
            raise ImportError('libGL.so.1: cannot open shared object file')
        return imported(module, *rest)

    monkeypatch.setattr(builtins, '__import__', broken)
    with pytest.raises(MechanismError, match=f'{name}: .* needs .*, which is installed, but '
                       'cannot be used: libGL.so.1: cannot open shared object file'):
        read(tmp_path, text, name)


def test_numbers_that_yaml_1_1_leaves_as_text_are_numbers():
    data = {'name': 'p', 'bodies': {'b': {'mass': '1e0', 'center_of_mass': ['1e-1', 0],
                                          'inertia': '.1E-2'}},
            'joints': {'j': {'type': 'revolute', 'parent': 'ground', 'child': 'b',
                             'position': [0, 0], 'angle': '-1.e-1'}}, 'description': '1e6'}
    mechanism = read_mechanism(data)
    body, = mechanism.bodies
    assert (body.mass, body.center_of_mass, body.inertia) == (1.0, (0.1, 0.0), 1e-3)
    assert mechanism.joints[0].angle == -0.1
    assert mechanism.description == '1e6'
    with pytest.raises(MechanismError, match=r'mass: expected a positive number, got the text'):
        read_mechanism({**data, 'bodies': {'b': {**data['bodies']['b'], 'mass': 'heavy'}}})
