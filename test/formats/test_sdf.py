# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""SDF: frames, axes and joints of every type, in loops; and what is refused."""

from closedloop_dynamics import MechanismError, read_mechanism
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.formats.yaml_text import mechanism_text
from closedloop_dynamics.kinematics.global_assembly import ClosureProblem
from closedloop_dynamics.mechanism.rotations import of_quaternion
import numpy as np
import pytest

from . import machines

# The four-bar of the other tests, standing 1 m up in the world, its frames named in many ways.
FOUR_BAR = """\
<sdf version="1.10">
<world name="w"><gravity>0 0 -3.7</gravity>
<model name="four_bar"><pose>0 0 1 0 0 0</pose>
  <link name="crank"><inertial><pose>0.05 0 0 0 0 0</pose><mass>0.5</mass>
    <inertia><ixx>1e-4</ixx><iyy>5.5e-4</iyy><izz>6e-4</izz></inertia></inertial></link>
  <link name="coupler"><pose relative_to="joint">0 0 0 0 0 0</pose>
    <inertial><pose>0.2 0 0 0 0 0</pose><mass>1</mass>
    <inertia><ixx>2e-4</ixx><iyy>1.49e-2</iyy><izz>1.5e-2</izz></inertia></inertial></link>
  <link name="rocker"><pose degrees="true">0.35 0 0 0 90 0</pose><inertial>
    <pose>0 0 0.15 0 -1.5707963267948966 0</pose><mass>0.8</mass>
    <inertia><ixx>1.5e-4</ixx><iyy>6.9e-3</iyy><izz>7e-3</izz></inertia></inertial></link>
  <frame name="joint" attached_to="crank"><pose>0.1 0 0 0 0 0</pose></frame>
  <frame name="tip" attached_to="coupler"><pose>0.4 0 0 0 0 0</pose></frame>
  <joint name="crank_joint" type="revolute"><parent>world</parent><child>crank</child>
    <axis><xyz>0 1 0</xyz><limit><effort>2</effort></limit><dynamics><damping>0.1</damping>
    <spring_stiffness>3</spring_stiffness><spring_reference>0.2</spring_reference></dynamics>
    </axis></joint>
  <joint name="coupler_joint" type="continuous"><parent>joint</parent><child>coupler</child>
    <axis><xyz expressed_in="__model__">0 1 0</xyz></axis></joint>
  <joint name="rocker_joint" type="revolute"><parent>world</parent><child>rocker</child>
    <axis><xyz expressed_in="crank">0 1 0</xyz>
    <limit><lower>-1e16</lower><upper>1e16</upper></limit></axis></joint>
  <joint name="pin" type="ball"><parent>rocker</parent><child>tip</child></joint>
</model></world></sdf>
"""


def written(tmp_path, text, name='model.sdf'):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_the_same_machine_in_frames_of_its_own(tmp_path):
    text = FOUR_BAR.replace('<joint name="pin" type="ball">', '<joint name="pin" type="ball">'
                            '<pose relative_to="tip"/>')
    # The pin is where the coupler ends, which is at the rocker's foot.
    text = text.replace('0.35 0 0 0 90 0', '0.5 0 0 0 90 0')
    imported = read_model(written(tmp_path, text))
    mechanism = imported.mechanism
    assert [(one.name, one.type, one.parent, one.child, one.actuated)
            for one in mechanism.joints] == [
        ('crank_joint', 'revolute', 'ground', 'crank', True),
        ('coupler_joint', 'revolute', 'crank', 'coupler', False),
        ('rocker_joint', 'revolute', 'ground', 'rocker', False)]
    assert [joint.position for joint in mechanism.joints] == [
        (0.0, 0.0, 1.0), (0.1, 0.0, 0.0), (0.5, 0.0, 1.0)]
    assert all(np.allclose(joint.axis, (0.0, 1.0, 0.0)) for joint in mechanism.joints)
    cut, = mechanism.cut_joints
    assert (cut.type, cut.body_a, cut.body_b) == ('spherical', 'rocker', 'coupler')
    assert cut.point_b == pytest.approx((0.4, 0.0, 0.0))
    own = read_mechanism(written(tmp_path, machines.mechanism_text('revolute'), 'own.yaml'))
    for body, other in zip(mechanism.bodies[:2], own.bodies):
        assert body.mass == other.mass
        assert body.center_of_mass == pytest.approx(other.center_of_mass)
        assert body.inertia[:3] == pytest.approx(other.inertia)
    assert imported.effects == {
        'gravity': {'type': 'gravity', 'acceleration': (0.0, 0.0, -3.7)},
        'damping_crank_joint': {
            'type': 'joint_damping', 'joint': 'crank_joint', 'coefficient': 0.1},
        'stiffness_crank_joint': {
            'type': 'joint_spring', 'joint': 'crank_joint', 'stiffness': 3.0, 'rest': 0.2}}
    # Everything is drawn where the file says: all loops are closed there.
    assert max(ClosureProblem(mechanism, 1.0).closure_errors(np.zeros(3)).values()) < 1e-12


@pytest.mark.parametrize('version, given, expected', [
    ('1.10', '<xyz>1 0 0</xyz>', (1.0, 0.0, 0.0)),
    ('1.10', '<xyz expressed_in="__model__">0 0 -1</xyz>', (1.0, 0.0, 0.0)),
    ('1.6', '<xyz>0 0 -1</xyz><use_parent_model_frame>1</use_parent_model_frame>',
     (1.0, 0.0, 0.0)),
    ('1.4', '<xyz>0 0 -1</xyz>', (1.0, 0.0, 0.0)),
])
def test_axes_are_expressed_in_frames(tmp_path, version, given, expected):
    text = (f'<sdf version="{version}"><model name="m"><link name="a">'
            '<pose>0 0 0 0 1.5707963267948966 0</pose></link><joint name="j" type="revolute">'
            f'<parent>world</parent><child>a</child><axis>{given}</axis></joint></model></sdf>')
    joint, = read_model(written(tmp_path, text)).mechanism.joints
    assert joint.axis == pytest.approx(expected)


def test_joints_of_every_type(tmp_path):
    kinds = {'prismatic': 'prismatic', 'ball': 'spherical', 'universal': 'universal',
             'revolute2': 'universal', 'screw': 'helical', 'fixed': None}
    links = ''.join(f'<link name="{kind}"/>' for kind in kinds)
    joints = ''.join(
        f'<joint name="to_{kind}" type="{kind}"><parent>world</parent><child>{kind}</child>'
        '<axis><xyz>0 0 1</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>'
        '<screw_thread_pitch>0.01</screw_thread_pitch></joint>' for kind in kinds)
    found = read_model(written(
        tmp_path, f'<sdf version="1.10"><model name="m">{links}{joints}</model></sdf>')).mechanism
    assert [joint.type for joint in found.joints] == [one for one in kinds.values() if one]
    assert found.joints[-1].lead == pytest.approx(0.01 / (2.0 * np.pi))
    assert found.joints[2].second_axis == (0.0, 1.0, 0.0)


def test_what_nothing_joins_to_the_world_floats_where_it_is_drawn(tmp_path):
    text = FOUR_BAR.replace('<parent>world</parent>', '<parent>base</parent>').replace(
        '<link name="crank">', '<link name="base"><pose>1 2 3 0 0 0</pose></link>'
        '<link name="crank">')
    joint = read_model(written(tmp_path, text)).mechanism.joints[-1]
    assert (joint.type, joint.child, joint.position) == ('free', 'base', (1.0, 2.0, 4.0))


def test_names_that_yaml_reads_otherwise_are_changed(tmp_path):
    text = FOUR_BAR.replace('<model name="four_bar">', '<model name="True">').replace(
        '<link name="rocker">', '<link name="no">').replace('>rocker<', '>no<')
    mechanism = read_model(written(tmp_path, text)).mechanism
    assert (mechanism.name, mechanism.bodies[2].name) == ('xTrue', 'xno')
    assert read_mechanism(written(tmp_path, mechanism_text(mechanism), 'a.yaml')) == mechanism


def test_the_tree_keeps_what_is_driven_and_cuts_what_is_free_the_most(tmp_path):
    # The ball comes first in the file, and is cut nevertheless; the rest is turned about.
    ball = FOUR_BAR[FOUR_BAR.index('  <joint name="pin"'):FOUR_BAR.index('</model>')]
    text = FOUR_BAR.replace(ball, '').replace('  <joint name="crank_joint"',
                                              f'{ball}  <joint name="crank_joint"')
    mechanism = read_model(written(tmp_path, text)).mechanism
    assert [cut.name for cut in mechanism.cut_joints] == ['pin']


FAULTS = {
    'pose': ('<pose>0.1 0 0 0 0 0</pose>', '<pose>0.1 0 0</pose>',
             "<pose>: expected pose to be 6 finite numbers, got '0.1 0 0'"),
    'frame': ('relative_to="joint"', 'relative_to="joints"',
              r"expected the name of a frame, got 'joints' \(did you mean 'joint'\?\)"),
    'cycle': ('attached_to="crank"><pose>', 'attached_to="crank"><pose relative_to="coupler">',
              'expected frames that do not depend on themselves, got'),
    'attached': ('<frame name="tip" attached_to="coupler"><pose>',
                 '<frame name="tip" attached_to="tip"><pose relative_to="coupler">',
                 'expected frames that are not attached to themselves, got tip -> tip'),
    'child': ('<child>crank</child>', '<child>krank</child>',
              r"expected the name of a frame, got 'krank' \(did you mean 'crank'\?\)"),
    'type': ('type="ball"', 'type="rope"', "expected type to be one of .* got 'rope'"),
    'gearbox': ('type="ball"', 'type="gearbox"', 'expected a child <gearbox_reference_body>'),
    'axis': ('<xyz>0 1 0</xyz>', '<xyz>0 0 0</xyz>',
             'expected an axis to be a direction that is not zero'),
    'static': ('<link name="crank">', '<static>true</static><link name="crank">',
               'expected a model that moves, got static ones'),
    'include': ('<link name="crank">', '<include><uri>x</uri></include><link name="crank">',
                "<uri>: expected a file that is there, .* got 'x'"),
    'two': ('<model ', '<model name="other"/><model ',
            r'expected one <model> that moves, got 2: other, four_bar \(--model NAME'),
    'placed': ('<pose>0 0 1 0 0 0</pose>', '<pose relative_to="table">0 0 1 0 0 0</pose>',
               'expected a pose in the world, or relative to a frame or model in it, '
               "got one relative to 'table'"),
    'mass': ('<mass>0.5</mass>', '<mass>heavy</mass>', "got 'heavy'"),
    'world': ('<link name="crank">', '<link name="world"/><link name="crank">',
              "expected any name but 'world'"),
}


@pytest.mark.parametrize('fault', FAULTS)
def test_faults_name_file_line_and_element(tmp_path, fault):
    right, wrong, said = FAULTS[fault]
    assert right in FOUR_BAR
    path = written(tmp_path, FOUR_BAR.replace(right, wrong, 1))
    with pytest.raises(MechanismError, match=rf'model\.sdf:\d+: .*{said}'):
        read_model(path)


def test_what_links_are_drawn_as(tmp_path):
    shapes = (
        '<visual name="v"><pose>0 0 0.1 0 0 0</pose><geometry><cylinder><radius>0.1</radius>'
        '<length>0.2</length></cylinder></geometry><material><diffuse>0.1 0.2 0.3 1</diffuse>'
        '</material></visual><visual name="m"><geometry>'
        '<mesh><uri>model://it/m.obj</uri><scale>1 2 3</scale></mesh></geometry></visual>')
    text = FOUR_BAR.replace('<link name="crank">', f'<link name="crank">{shapes}')
    crank = read_model(written(tmp_path, text)).mechanism.bodies[0]
    pin, mesh = crank.visual
    assert (pin.kind, pin.size, pin.center) == ('cylinder', (0.1, 0.2), (0.0, 0.0, 0.1))
    assert (pin.color, mesh.color) == ((0.1, 0.2, 0.3), None)
    assert mesh.file == str(tmp_path.resolve() / 'it' / 'm.obj') and mesh.size == (1.0, 2.0, 3.0)


def test_a_link_called_ground(tmp_path):
    text = FOUR_BAR.replace('"coupler"', '"ground"').replace('>coupler<', '>ground<')
    imported = read_model(written(tmp_path, text))
    expected = read_model(written(tmp_path, FOUR_BAR)).mechanism
    assert mechanism_text(imported.mechanism).replace('ground_link', 'coupler') == (
        mechanism_text(expected))
    assert 'the name ground of a link, ground_link taken' in imported.ignored


def test_what_acts_about_both_axes_of_a_universal_joint(tmp_path):
    dynamics = ('<dynamics><damping>{}</damping><spring_stiffness>{}</spring_stiffness>'
                '<spring_reference>{}</spring_reference></dynamics>')
    joint = ('<joint name="cross" type="universal"><parent>rocker</parent><child>tip</child>'
             '<axis><xyz>0 1 0</xyz>' + dynamics.format(1, 2, 0.3) + '</axis>'
             '<axis2><xyz>1 0 0</xyz>' + dynamics.format(0, 5, 0) + '</axis2></joint>')
    begin = FOUR_BAR.index('  <joint name="pin"')
    end = FOUR_BAR.index('</model>')
    expected = {
        'damping_cross_1': {'type': 'joint_damping', 'joint': 'cross.1', 'coefficient': 1.0},
        'stiffness_cross_1': {'type': 'joint_spring', 'joint': 'cross.1', 'stiffness': 2.0,
                              'rest': 0.3},
        'stiffness_cross_2': {'type': 'joint_spring', 'joint': 'cross.2', 'stiffness': 5.0,
                              'rest': 0.0}}
    closing = FOUR_BAR[:begin] + joint + FOUR_BAR[end:]
    imported = read_model(written(tmp_path, closing))
    cut, = imported.mechanism.cut_joints
    # As in a tree, body A is the child: its first axis is that of the parent.
    assert (cut.body_a, cut.body_b) == ('coupler', 'rocker')
    assert cut.axis_a == pytest.approx((1.0, 0.0, 0.0))
    assert {name: values for name, values in imported.effects.items() if 'cross' in name} == (
        expected)
    # Turned about, where the tree goes from the child to the parent.
    hung = closing[:closing.index('  <joint name="rocker_joint"')] + joint + FOUR_BAR[end:]
    imported = read_model(written(tmp_path, hung))
    assert imported.mechanism.joints[-1].parent == 'coupler' and not imported.mechanism.cut_joints
    assert {values['joint']: values.get('coefficient', values.get('stiffness'))
            for name, values in imported.effects.items() if 'cross' in name and 'd' in name} == {
        'cross.2': 1.0}


def test_gravity_that_does_not_act_on_a_link_is_compensated(tmp_path):
    text = FOUR_BAR.replace('<link name="coupler">', '<link name="coupler"><gravity>0</gravity>'
                            '<velocity_decay><angular>0.01</angular></velocity_decay>')
    imported = read_model(written(tmp_path, text))
    assert imported.effects['lift_coupler_center_of_mass'] == {
        'type': 'external_force', 'point': 'coupler_center_of_mass', 'force': (0.0, 0.0, 3.7)}
    point, = (one for one in imported.mechanism.points if one.name == 'coupler_center_of_mass')
    assert (point.body, point.position) == ('coupler', (0.2, 0.0, 0.0))
    decay, = imported.omitted
    assert (decay.quantity, decay.name, decay.size) == ('decay of the velocity', 'coupler', 0.01)


def test_links_that_forces_do_not_move_and_starts_are_named(tmp_path):
    text = FOUR_BAR.replace('<link name="coupler">', '<link name="coupler"><kinematic>true'
                            '</kinematic>').replace(
        '<link name="crank">', '<link name="crank"><kinematic>0</kinematic>').replace(
        '<limit><effort>', '<initial_position>0.5</initial_position><limit><effort>').replace(
        '<model ', '<state world_name="w"><sim_time>3 4</sim_time><model name="four_bar"><pose>'
        '1 0 0 0 0 0</pose></model></state><model ', 1)
    imported = read_model(written(tmp_path, text))
    assert [(one.quantity, one.kind, one.name, one.size) for one in imported.omitted] == [
        ('state', 'world', 'w', np.inf),
        ('kinematic', 'link', 'coupler', np.inf),
        ('initial_position', 'joint', 'crank_joint', 0.5)]


def test_one_of_several_models_of_a_world(tmp_path):
    ground = ('<model name="floor"><static>true</static><pose>0 0 1 0 0 0</pose><link name="l">'
              '<visual name="v"><pose>0 0 2 0 0 0</pose><geometry><box><size>1 2 3</size></box>'
              '</geometry></visual></link></model>')
    other = '<model name="other"><link name="l"/><link name="m"/></model>'
    text = FOUR_BAR.replace('<model ', f'{ground}{other}<include><uri>model://sun</uri></include>'
                            '<model ')
    path = written(tmp_path, text)
    imported = read_model(path, model='four_bar')
    expected = read_model(written(tmp_path, FOUR_BAR, 'alone.sdf')).mechanism
    assert imported.mechanism.bodies == expected.bodies
    assert imported.mechanism.joints == expected.joints
    box, = imported.mechanism.ground_visual
    assert (box.size, box.center) == ((1.0, 2.0, 3.0), (0.0, 0.0, 3.0))
    assert [one.name for one in imported.omitted] == ['model://sun']
    assert imported.ignored['the models other'] == 'one is simulated at a time'
    assert [joint.type for joint in read_model(path, model='other').mechanism.joints] == [
        'free', 'free']
    with pytest.raises(MechanismError, match="--model to be one of other, four_bar, got 'floor'"):
        read_model(path, model='floor')


IN_WORLD = """<sdf version="1.11"><world name="w">
  <frame name="corner"><pose>1 2 3 0 0 1.5707963267948966</pose></frame>
  <frame name="above" attached_to="post"><pose>0 0 1 0 0 0</pose></frame>
  <model name="post"><static>true</static><pose relative_to="corner">1 0 0 0 0 0</pose>
    <link name="top"/></model>
  <model name="arm" placement_frame="tip"><pose relative_to="above">0 0 0.5 0 0 0</pose>
    <link name="l"/><frame name="tip"><pose>0.25 0 0 0 0 0</pose></frame></model>
  <model name="loose"><link name="l"/></model>
  JOINTS
</world></sdf>"""
HINGE = ('<joint name="hinge" type="revolute"><parent>{}</parent><child>{}</child>'
         '<axis><xyz>1 0 0</xyz></axis></joint>')


def test_frames_and_joints_of_the_world(tmp_path):
    path = written(tmp_path, IN_WORLD.replace('JOINTS', HINGE.format('post::top', 'arm::l')))
    found = read_model(path, model='arm')
    joint, = found.mechanism.joints
    # The corner and its quarter turn, a metre to the post, one up, half one to the tip, which
    # stands a quarter of one before the link.
    assert joint.position == pytest.approx((1.0, 2.75, 4.5))
    assert (joint.parent, joint.child) == ('ground', 'l')
    assert of_quaternion(joint.orientation) @ joint.axis == pytest.approx([0.0, 1.0, 0.0])
    assert not found.omitted and found.ignored == {
        'the models loose': 'one is simulated at a time'}
    for ends, taken in ((('loose::l', 'arm::l'), 'arm'), (('arm::l', 'post::top'), 'arm'),
                        (('loose::l', 'arm::l'), 'loose')):
        path = written(tmp_path, IN_WORLD.replace('JOINTS', HINGE.format(*ends)))
        found = read_model(path, model=taken)
        assert [joint.type for joint in found.mechanism.joints] == ['free']
        omission, = found.omitted
        assert (omission.quantity, omission.name) == ('the constraint', 'hinge')
    circle = IN_WORLD.replace('JOINTS', '').replace(
        '<pose>1 2 3 0', '<pose relative_to="above">1 2 3 0')
    with pytest.raises(MechanismError, match="relative to 'above'"):
        read_model(written(tmp_path, circle), model='arm')


RAISED = '<pose>1 0 0 0 0 1.5707963267948966</pose>'


def nested(inside):
    """Return a model with another one in it, hinged to the world."""
    return (f'<sdf version="1.10"><model name="m">{inside}<joint name="j" type="revolute">'
            '<parent>world</parent><child>arm::link</child><axis><xyz>0 0 1</xyz></axis></joint>'
            '<joint name="k" type="revolute"><pose relative_to="arm::tip"/><parent>arm</parent>'
            '<child>hand</child><axis><xyz expressed_in="arm">1 0 0</xyz></axis></joint>'
            '<link name="hand"><pose relative_to="arm::tip">0 0 0.5 0 0 0</pose></link></model>'
            '</sdf>')


ARM = ('<model name="arm">POSE<link name="link"><pose>0 0 0.5 0 0 0</pose></link>'
       '<frame name="mark"><pose>0 0 0.7 0 0 0</pose></frame>'
       '<frame name="tip" attached_to="link"><pose>0.2 0 0 0 0 0</pose></frame>'
       '<link name="flap"/><joint name="h" type="revolute"><parent>link</parent>'
       '<child>flap</child><axis><xyz EXPRESSED>1 0 0</xyz></axis></joint></model>')


@pytest.mark.parametrize('way', ['nested', 'include', 'folder', 'model'])
def test_models_in_models(tmp_path, way):
    inside = ARM.replace('EXPRESSED', 'expressed_in="__model__"')
    if way == 'nested':
        text = nested(inside.replace('POSE', RAISED))
    else:
        folder = tmp_path / 'parts'
        folder.mkdir()
        written(folder, f'<sdf version="1.4">{ARM.replace("POSE", "").replace("EXPRESSED", "")}'
                '</sdf>')
        uri = {'include': 'parts/model.sdf', 'folder': 'parts', 'model': 'model://parts'}[way]
        text = nested(f'<include><uri>{uri}</uri><name>arm</name>{RAISED}</include>')
    imported = read_model(written(tmp_path, text, 'whole.sdf'))
    joints = {joint.name: joint for joint in imported.mechanism.joints}
    assert {name: (joint.parent, joint.child) for name, joint in joints.items()} == {
        'arm__h': ('arm__link', 'arm__flap'), 'j': ('ground', 'arm__link'),
        'k': ('arm__link', 'hand')}
    # Of the link, which is the body's frame: the hinge to the world is where the link is.
    assert joints['j'].position == (1.0, 0.0, 0.5)
    assert joints['k'].position == pytest.approx((0.2, 0.0, 0.0))
    assert joints['k'].axis == pytest.approx((1.0, 0.0, 0.0))
    assert joints['arm__h'].position == pytest.approx((0.0, 0.0, -0.5))
    assert joints['arm__h'].axis == pytest.approx((1.0, 0.0, 0.0))
    # A frame on no link is on the first one.
    mark, = (one for one in imported.mechanism.points if one.name == 'arm__mark')
    assert (mark.body, mark.position) == ('arm__link', pytest.approx((0.0, 0.0, 0.2)))
    # Turned with the model by a quarter.
    assert joints['j'].orientation == pytest.approx((0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    assert read_mechanism(written(
        tmp_path, mechanism_text(imported.mechanism), 'a.yaml')) == imported.mechanism


def test_files_that_include_themselves_or_others_from_outside(tmp_path):
    inside = tmp_path / 'a' / 'b'
    inside.mkdir(parents=True)
    written(tmp_path, f'<sdf version="1.10">{ARM.replace("POSE", "")}</sdf>', 'arm.sdf')
    text = nested('<include><uri>../../arm.sdf</uri></include>')
    path = written(inside, text.replace('EXPRESSED', ''))
    with pytest.raises(MechanismError, match='expected a file that is there, in the folder'):
        read_model(path)
    written(tmp_path, f'<sdf version="1.10">{ARM.replace("POSE", "").replace("EXPRESSED", "")}'
            '</sdf>', 'arm.sdf')
    assert len(read_model(path, anywhere=True).mechanism.joints) == 3
    path = written(inside, nested('<include><uri>model.sdf</uri><name>arm</name></include>'))
    with pytest.raises(MechanismError, match='expected files that do not include themselves'):
        read_model(path)


def test_gearboxes_couple_the_turns_about_their_reference(tmp_path):
    hinge = ('<link name="{0}"/><joint name="to_{0}" type="revolute"><parent>{1}</parent>'
             '<child>{2}</child><axis><xyz>0 0 {3}</xyz></axis></joint>')
    gear = ('<joint name="gear" type="gearbox"><parent>a</parent><child>b</child>'
            '<gearbox_reference_body>base</gearbox_reference_body><gearbox_ratio>4</gearbox_ratio>'
            '<axis><xyz>0 0 1</xyz></axis><axis2><xyz>0 0 1</xyz></axis2></joint>')
    for a, b, expected in ((('a', 'base', 'a', 1), ('b', 'base', 'b', 1), (4.0, 1.0)),
                           (('a', 'base', 'a', -1), ('b', 'b', 'base', 1), (-4.0, -1.0))):
        text = ('<sdf version="1.10"><model name="m"><link name="base"/>'
                f'{hinge.format(*a)}{hinge.format(*b)}{gear}</model></sdf>')
        coupling, = read_model(written(tmp_path, text)).mechanism.couplings
        # The turn of b is -4 times that of a.
        assert coupling.joints == {'to_a': expected[0], 'to_b': expected[1]}
