# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Each fault of a mechanism's description is named by file, line, key path, expected and got."""

from dataclasses import replace
import os
import pickle

from closedloop_dynamics.mechanism import document
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.mechanism import (Body, CutJoint, Joint, Mechanism,
                                                     MechanismError, Point)
from closedloop_dynamics.mechanism.reader import read_mechanism, validate_mechanism
import numpy as np
import pytest

from ..reference import faults

GOOD = """\
name: four_bar
bodies:
  crank: {mass: 0.5, center_of_mass: [0.05, 0.0], inertia: 0.0004}
  coupler: {mass: 1.0, center_of_mass: [0.175, 0.0], inertia: 0.01}
  rocker: {mass: 0.8, center_of_mass: [0.125, 0.0], inertia: 0.004}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0, 0], actuated: true}
  coupler_joint: {type: revolute, parent: crank, child: coupler, position: [0.1, 0]}
  rocker_joint: {type: revolute, parent: ground, child: rocker, position: [0.4, 0], angle: 0.2}
cut_joints:
  cut_1: {type: revolute, body_a: coupler, point_a: [0.35, 0], body_b: rocker, point_b: [0.25, 0]}
points:
  tip: {body: coupler, position: [0.175, 0.1]}
"""
BUILT = Mechanism(
    name='four_bar',
    bodies=(Body('crank', 0.5, (0.05, 0.0), 0.0004), Body('coupler', 1.0, (0.175, 0.0), 0.01),
            Body('rocker', 0.8, (0.125, 0.0), 0.004)),
    joints=(Joint('crank_joint', 'revolute', 'ground', 'crank', (0.0, 0.0), actuated=True),
            Joint('coupler_joint', 'revolute', 'crank', 'coupler', (0.1, 0.0)),
            Joint('rocker_joint', 'revolute', 'ground', 'rocker', (0.4, 0.0), 0.2)),
    cut_joints=(CutJoint('cut_1', 'revolute', 'coupler', 'rocker', (0.35, 0.0), (0.25, 0.0)),),
    points=(Point('tip', 'coupler', (0.175, 0.1)),))

NAME = 'a name of letters, digits and underscores that starts with a letter'
VECTOR = 'a list of 2 finite numbers [x, y]'
BODIES = 'there are crank, coupler, rocker'

FAULTS = {
    'mass_zero': (
        'mass: 0.5', 'mass: 0', 3, 'bodies.crank.mass', 'a positive number', '0',
        'a body without mass on purpose says massless: true'),
    'mass_negative': (
        'mass: 0.5', 'mass: -2.5', 3, 'bodies.crank.mass', 'a positive number', '-2.5', ''),
    'mass_nan': (
        'mass: 0.5', 'mass: .nan', 3, 'bodies.crank.mass', 'a positive number', 'nan', ''),
    'mass_infinite': (
        'mass: 0.5', 'mass: .inf', 3, 'bodies.crank.mass', 'a positive number', 'inf', ''),
    'mass_overflows': (
        'mass: 0.5', f'mass: {"9" * 350}', 3, 'bodies.crank.mass', 'a positive number',
        '9' * 60 + '...', ''),
    'mass_too_long_for_int': (
        'mass: 0.5', f'mass: {"9" * 5000}', 3, 'bodies.crank.mass', 'a positive number', 'inf',
        ''),
    'mass_too_long_in_hexadecimal': (
        'mass: 0.5', f'mass: 0x{"f" * 5000}', 3, 'bodies.crank.mass', 'a positive number', 'inf',
        ''),
    'mass_too_long_in_a_list': (
        'mass: 0.5', f'mass: [{"9" * 399}]', 3, 'bodies.crank.mass', 'a positive number',
        '[' + '9' * 59 + '...', ''),
    'mass_tagged_as_text': (
        'mass: 0.5', 'mass: !!str 0.5', 3, 'bodies.crank.mass', 'a positive number',
        "the text '0.5'", ''),
    'mass_boolean': (
        'mass: 0.5', 'mass: true', 3, 'bodies.crank.mass', 'a positive number',
        'the truth value true', ''),
    'mass_quoted': (
        'mass: 0.5', "mass: '0.5'", 3, 'bodies.crank.mass', 'a positive number',
        "the text '0.5'", ''),
    'mass_with_unit': (
        'mass: 0.5', 'mass: 0.5 kg', 3, 'bodies.crank.mass', 'a positive number',
        "the text '0.5 kg'", ''),
    'mass_empty': (
        'mass: 0.5', 'mass: ', 3, 'bodies.crank.mass', 'a positive number', 'nothing', ''),
    'inertia_negative': (
        'inertia: 0.0004', 'inertia: -0.0004', 3, 'bodies.crank.inertia',
        'a number that is zero or more', '-0.0004', ''),
    'vector_short': (
        '[0.05, 0.0]', '[0.05]', 3, 'bodies.crank.center_of_mass', VECTOR,
        '[0.05], of length 1', ''),
    'vector_long': (
        '[0.05, 0.0]', '[0.05, 0.0, 0.0]', 3, 'bodies.crank.center_of_mass', VECTOR,
        '[0.05, 0.0, 0.0], of length 3', ''),
    'vector_is_number': (
        '[0.05, 0.0]', '0.05', 3, 'bodies.crank.center_of_mass', VECTOR, '0.05', ''),
    'vector_is_mapping': (
        '[0.05, 0.0]', '{x: 0.05}', 3, 'bodies.crank.center_of_mass', VECTOR, 'a mapping', ''),
    'vector_infinite': (
        '[0.05, 0.0]', '[0.05, -.inf]', 3, 'bodies.crank.center_of_mass[1]', 'a finite number',
        '-inf', ''),
    'angle_boolean': (
        'angle: 0.2', 'angle: false', 9, 'joints.rocker_joint.angle', 'a finite number',
        'the truth value false', ''),
    'key_misspelt': (
        'mass: 0.5', 'mas: 0.5', 3, 'bodies.crank.mas',
        'one of the keys mass, center_of_mass, inertia, massless, visual, shape, density',
        "the unknown key 'mas'",
        "did you mean 'mass'?"),
    'key_missing': (
        'mass: 0.5, ', '', 3, 'bodies.crank.mass', 'this required key', 'none', ''),
    'key_twice': (
        'mass: 0.5, ', 'mass: 0.5, mass: 0.6, ', 3, 'bodies.crank.mass', 'every key once',
        'this key again, first given in line 3', 'rename or remove one'),
    'body_twice': (
        '  rocker: {', '  crank: {', 5, 'bodies.crank', 'every key once',
        'this key again, first given in line 3', 'rename or remove one'),
    'section_unknown': (
        'points:', 'point:', 12, 'point',
        'one of the keys name, bodies, joints, cut_joints, points, description, couplings, '
        'parameters, ground_visual, tolerance, cylinders',
        "the unknown key 'point'", "did you mean 'points'?"),
    'name_missing': (
        'name: four_bar\n', '', 1, 'name', 'this required key', 'none', ''),
    'name_not_a_token': (
        'name: four_bar', 'name: four bar', 1, 'name', NAME, "the text 'four bar'", ''),
    'body_name_not_a_token': (
        'tip:', '1st-tip:', 13, 'points.1st-tip', NAME, "the text '1st-tip'", ''),
    'cut_name_not_a_topic': (
        'cut_1:', 'cut/1:', 11, 'cut_joints.cut/1', NAME, "the text 'cut/1'", ''),
    'name_too_long': (
        'tip:', f'{256 * "a"}:', 13, f'points.{256 * "a"}', 'a name of at most 255 characters',
        'one of 256', ''),
    'name_of_ground': (
        'tip:', 'ground:', 13, 'points.ground', "any name but 'ground', which is the world",
        "'ground'", ''),
    'cut_named_as_joint': (
        'cut_1:', 'crank_joint:', 11, 'cut_joints.crank_joint',
        'a name that is not used in joints', "'crank_joint', which joints has too",
        'rename one'),
    'point_named_as_body': (
        'tip:', 'coupler:', 13, 'points.coupler', 'a name that is not used in bodies',
        "'coupler', which bodies has too", 'rename one'),
    'bodies_is_a_list': (
        GOOD[GOOD.index('bodies:'):GOOD.index('joints:')], 'bodies: [crank]\n', 2, 'bodies',
        'a mapping (key: value)', "['crank']", ''),
    'body_is_a_number': (
        '{mass: 0.5, center_of_mass: [0.05, 0.0], inertia: 0.0004}', '0.5', 3, 'bodies.crank',
        'a mapping (key: value)', '0.5', ''),
    'no_bodies': (
        GOOD[GOOD.index('bodies:'):GOOD.index('joints:')], 'bodies: {}\n', 2, 'bodies',
        'at least one entry', 'none', ''),
    'no_joints': (
        GOOD[GOOD.index('joints:'):], 'joints:\n', 6, 'joints', 'at least one entry', 'none', ''),
    'joint_type_unknown': (
        'type: revolute, parent: crank', 'type: revolut, parent: crank', 8,
        'joints.coupler_joint.type', 'one of revolute, prismatic', "the text 'revolut'",
        "did you mean 'revolute'?"),
    'joint_type_of_a_cut': (
        'type: revolute, parent: crank', 'type: fixed, parent: crank', 8,
        'joints.coupler_joint.type', 'one of revolute, prismatic', "the text 'fixed'", ''),
    'cut_type_unknown': (
        'type: revolute, body_a', 'type: pin, body_a', 11, 'cut_joints.cut_1.type',
        'one of revolute, prismatic, fixed, distance, point_on_line', "the text 'pin'", ''),
    'joint_type_gear': (
        'type: revolute, parent: crank', 'type: gear, parent: crank', 8,
        'joints.coupler_joint.type', 'one of revolute, prismatic', "the text 'gear'",
        'write one of the couplings: the sum of joint coordinates, each times its factor'),
    'cut_type_rack_and_pinion': (
        'type: revolute, body_a', 'type: Rack_and_Pinion, body_a', 11, 'cut_joints.cut_1.type',
        'one of revolute, prismatic, fixed, distance, point_on_line', "the text 'Rack_and_Pinion'",
        'write one of the couplings: the sum of joint coordinates, each times its factor'),
    'cut_type_pin_in_slot': (
        'type: revolute, body_a', 'type: pin_in_slot, body_a', 11, 'cut_joints.cut_1.type',
        'one of revolute, prismatic, fixed, distance, point_on_line', "the text 'pin_in_slot'",
        'write one of the cut_joints, of the type point_on_line'),
    'actuated_as_yaml_1_1': (
        'actuated: true', 'actuated: yes', 7, 'joints.crank_joint.actuated', 'true or false',
        "the text 'yes'", ''),
    'parent_unknown': (
        'parent: crank', 'parent: cranc', 8, 'joints.coupler_joint.parent',
        "the name of a body or 'ground'", "the text 'cranc'", "did you mean 'crank'?"),
    'child_unknown': (
        'child: rocker', 'child: x', 9, 'joints.rocker_joint.child', 'the name of a body',
        "the text 'x'", BODIES),
    'child_is_ground': (
        'child: rocker', 'child: ground', 9, 'joints.rocker_joint.child', 'the name of a body',
        "the text 'ground'", BODIES),
    'two_parents': (
        'child: rocker', 'child: coupler', 9, 'joints.rocker_joint.child',
        'a body that no other joint carries',
        "'coupler', which joint 'coupler_joint' carries already",
        'close the loop by a cut joint instead'),
    'body_not_carried': (
        GOOD[GOOD.index('  rocker_joint'):GOOD.index('cut_joints')], '', 5, 'bodies.rocker',
        'a joint that has this body as its child', 'none',
        'add one to joints, or remove the body'),
    'cycle_of_one': (
        'parent: crank', 'parent: coupler', 8, 'joints.coupler_joint.parent',
        "a chain of parents that ends at 'ground'", 'the cycle coupler -> coupler',
        'close the loop by a cut joint instead'),
    'cycle_of_two': (
        'parent: ground, child: crank', 'parent: coupler, child: crank', 7,
        'joints.crank_joint.parent', "a chain of parents that ends at 'ground'",
        'the cycle crank -> coupler -> crank', 'close the loop by a cut joint instead'),
    'cut_within_a_body': (
        'body_b: rocker', 'body_b: coupler', 11, 'cut_joints.cut_1.body_b',
        'two different bodies in body_a and body_b', "'coupler' in both", ''),
    'cut_body_unknown': (
        'body_b: rocker', 'body_b: rockr', 11, 'cut_joints.cut_1.body_b',
        "the name of a body or 'ground'", "the text 'rockr'", "did you mean 'rocker'?"),
    'cut_angle_without_meaning': (
        'type: revolute, body_a', 'type: distance, length: 1, angle: 0.5, body_a', 11,
        'cut_joints.cut_1.angle', 'no angle in a distance cut joint, which leaves it free', '0.5',
        ''),
    'cut_drive_without_coordinate': (
        'type: revolute, body_a', 'type: distance, length: 1, actuated: true, body_a', 11,
        'cut_joints.cut_1.actuated',
        'no drive of a cut joint, but of revolute, prismatic, point_on_line',
        'one that is distance', 'cut another joint of that loop'),
    'point_on_unknown_body': (
        'body: coupler, pos', 'body: couplr, pos', 13, 'points.tip.body',
        "the name of a body or 'ground'", "the text 'couplr'", "did you mean 'coupler'?"),
    'description_number': (
        'bodies:', 'description: 3\nbodies:', 2, 'description', 'text', '3', ''),
    'a_tag': (
        'name: four_bar', 'name: !!python/object/apply:os.getcwd []', 1, 'name', 'plain data',
        'the tag tag:yaml.org,2002:python/object/apply:os.getcwd', 'remove it'),
    'a_tag_of_a_key': (
        'mass: 0.5', '!!binary mass: 0.5', 3, 'bodies.crank', 'plain data',
        'the tag tag:yaml.org,2002:binary', 'remove it'),
    'a_list_as_key': (
        'tip:', '? [tip]\n  :', 12, 'points', 'a key of one word', 'a list or mapping as key', ''),
    'empty_file': (
        GOOD, '', 1, 'the whole description', 'a mapping (key: value)', 'nothing', ''),
    'list_file': (
        GOOD, '- a', 1, 'the whole description', 'a mapping (key: value)', "['a']", ''),
}


def write(directory, text):
    return faults.write(directory, text, 'machine.yaml')


def refusal(path):
    return faults.refusal(path, read_mechanism, MechanismError)


def test_good_file_reads_as_built(tmp_path):
    assert read_mechanism(write(tmp_path, GOOD)) == BUILT
    assert read_mechanism(str(write(tmp_path, GOOD))) == validate_mechanism(BUILT)


@pytest.mark.parametrize('fault', FAULTS)
def test_fault_is_named(tmp_path, fault):
    faults.require_named(
        tmp_path / 'machine.yaml', GOOD, FAULTS[fault], read_mechanism, MechanismError)


@pytest.mark.parametrize('written, value', [
    ('1e-3', 1e-3), ('1E3', 1e3), ('2.e2', 200.0), ('.5', 0.5), ('5', 5.0), ('+5', 5.0),
    ('010', 10.0), ('0x10', 16.0), ('1.5e+2', 150.0)])
def test_numbers_of_yaml_1_2_are_numbers(tmp_path, written, value):
    mechanism = read_mechanism(write(tmp_path, GOOD.replace('mass: 0.5', f'mass: {written}')))
    assert mechanism.bodies[0].mass == value
    assert type(mechanism.bodies[0].mass) is float


@pytest.mark.parametrize('written', ['1_000', '1:30', '1e', 'e3', '1.2.3', '0b1', '--1', 'inf'])
def test_what_yaml_1_2_calls_text_is_no_number(tmp_path, written):
    text = GOOD.replace('mass: 0.5', f'mass: {written}')
    assert f"expected a positive number, got the text '{written}'" in refusal(
        write(tmp_path, text))


@pytest.mark.parametrize('name', ['on', 'no', 'y', 'null_', 'True_'])
def test_names_that_yaml_1_1_takes_for_truth_values(tmp_path, name):
    text = GOOD.replace('tip:', f'{name}:')
    assert read_mechanism(write(tmp_path, text)).points[0].name == name


def test_optional_sections_may_be_empty_or_absent(tmp_path):
    tree = GOOD[:GOOD.index('cut_joints:')]
    empty = read_mechanism(write(tmp_path, tree + 'cut_joints:\npoints:\n'))
    absent = read_mechanism(write(tmp_path, tree))
    assert empty == absent
    assert absent.cut_joints == () and absent.points == ()


def test_point_may_stand_on_the_ground(tmp_path):
    text = GOOD.replace('body: coupler, pos', 'body: ground, pos')
    assert read_mechanism(write(tmp_path, text)).points[0].body == 'ground'


def test_byte_order_mark_and_anchors_are_understood(tmp_path):
    text = '\ufeff' + GOOD.replace('mass: 0.5', 'mass: &heavy 7').replace(
        'mass: 0.8', 'mass: *heavy')
    assert [b.mass for b in read_mechanism(write(tmp_path, text)).bodies] == [7.0, 1.0, 7.0]


@pytest.mark.parametrize('text, line', [
    (GOOD.replace('[0.05, 0.0]', '[0.05, 0.0'), 3),
    (GOOD.replace('bodies:', '\tbodies:'), 2),
    (GOOD.replace('points:', 'points'), 13),
    (GOOD + '---\nname: two\n', 14),
    (GOOD.replace('[0.05, 0.0]', '*nobody'), 3),
    ('name: \x00', 1),
    ('name: "\\ud800"', 1),
])
def test_syntax_error_names_its_line(tmp_path, text, line):
    path = write(tmp_path, text)
    assert refusal(path).startswith(f'{path}:{line}: ')
    assert 'expected a YAML file, got ' in refusal(path)


@pytest.mark.parametrize('text, got', [
    ('a: &a [*a]', 'aliases without end'),
    ('a0: &a0 [x, x]\n' + ''.join(
        f'a{i}: &a{i} [{", ".join([f"*a{i - 1}"] * 10)}]\n' for i in range(1, 10)),
     'expected at most 100000 values, aliases counted as what they stand for, got more'),
    ('a: &a [' + 'x, ' * 1000 + ']\nb: [' + '*a, ' * 1000 + ']', 'expected at most 100000 values'),
    ('a: ' + '[' * 20000, 'expected a nesting of at most 20 levels, got a deeper one'),
    ('# ' + 'x' * 4_000_000, 'expected a file of at most 4000000 bytes, got a larger one')],
    ids=['itself', 'of aliases', 'many', 'deep', 'long'])
def test_what_is_too_large_is_refused_while_reading(tmp_path, text, got):
    assert got in refusal(write(tmp_path, text))


def test_reading_stops_at_the_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(document, 'MOST_VALUES', 1000)
    points = ''.join(f'  p{i}: {{body: ground, position: [{i}, 0]}}\n' for i in range(300))
    # The syntax error behind the limit is never reached.
    path = write(tmp_path, GOOD + points + ']')
    assert 'expected at most 1000 values' in refusal(path)


def test_unreadable_files_are_named(tmp_path):
    missing = tmp_path / 'missing.yaml'
    assert refusal(missing) == (
        f'{missing}: expected a YAML file that can be read, got: No such file or directory')
    assert refusal(tmp_path).startswith(f'{tmp_path}: expected a YAML file that can be read')
    for path, reason in (('no\0path.yaml', 'embedded null byte'),
                         ('\ud800.yaml', 'surrogates not allowed')):
        assert 'expected a YAML file that can be read, got: ' + reason in refusal(path)
        assert refusal(path).isascii() and refusal(path).isprintable()
    pipe = tmp_path / 'pipe.yaml'
    os.mkfifo(pipe)
    assert refusal(pipe) == (
        f'{pipe}: expected a YAML file that can be read, got: a pipe or a device')
    binary = tmp_path / 'binary.yaml'
    binary.write_bytes(b'\xff\xfe\x00')
    assert refusal(binary).startswith(f'{binary}:1: ')
    assert 'expected a YAML file in UTF-8, got' in refusal(binary)


def test_built_mechanism_is_normalised():
    body = Body('crank', 1, np.array([0, 1]), np.float32(0.5))
    joint = Joint('j', 'revolute', 'ground', 'crank', [1, 2])
    given = Mechanism('m', [body], [joint])
    checked = validate_mechanism(given)
    assert checked == Mechanism('m', (Body('crank', 1.0, (0.0, 1.0), 0.5),),
                                (Joint('j', 'revolute', 'ground', 'crank', (1.0, 2.0)),))
    assert type(checked.bodies[0].mass) is float
    assert type(given.bodies) is list and type(body.mass) is int    # given ones stay as they are
    assert validate_mechanism(checked) is checked
    # A copy with other values is no longer what was checked.
    with pytest.raises(MechanismError, match='a chain of parents|a body'):
        validate_mechanism(replace(checked, joints=(replace(joint, parent='crank'),)))


@pytest.mark.parametrize('change, message', [
    ({'bodies': BUILT.bodies[:2] + (replace(BUILT.bodies[2], mass=-1.0),)},
     'bodies.rocker.mass: expected a positive number, got -1.0'),
    ({'bodies': BUILT.bodies[:2] + (replace(BUILT.bodies[2], mass=True),)},
     'bodies.rocker.mass: expected a positive number, got the truth value true'),
    ({'bodies': (*BUILT.bodies, BUILT.bodies[0])},
     "bodies.crank: expected every name once, got 'crank' twice"),
    ({'bodies': None}, 'bodies: expected a list, got nothing'),
    ({'bodies': set(BUILT.bodies)}, 'bodies: expected a list, got '),
    ({'bodies': BUILT.joints}, 'bodies: expected a Body, got Joint('),
    ({'joints': ()}, 'joints: expected at least one entry, got none'),
    ({'joints': BUILT.joints[:2]},
     'bodies.rocker: expected a joint that has this body as its child, got none'),
    ({'joints': (replace(BUILT.joints[0], parent=None), *BUILT.joints[1:])},
     "joints.crank_joint.parent: expected the name of a body or 'ground', got nothing"),
    ({'name': 'four bar'}, f"name: expected {NAME}, got the text 'four bar'"),
])
def test_built_mechanism_obeys_the_same_rules(change, message):
    faulty = replace(BUILT, **change)
    with pytest.raises(MechanismError) as caught:
        validate_mechanism(faulty)
    assert str(caught.value).startswith(f'mechanism {faulty.name!r}: {message}')
    with pytest.raises(MechanismError, match='^generated: '):
        validate_mechanism(faulty, 'generated')


def test_what_is_no_mechanism_is_refused():
    with pytest.raises(MechanismError, match='expected a Mechanism, got a mapping'):
        validate_mechanism({})


def test_long_chain_is_checked_without_recursion(tmp_path):
    n = 3000
    bodies = tuple(Body(f'b{i}', 1.0, (0.5, 0.0), 0.1) for i in range(n))
    joints = tuple(Joint(f'j{i}', 'revolute', f'b{i - 1}' if i else 'ground', f'b{i}', (1.0, 0.0))
                   for i in range(n))
    assert validate_mechanism(Mechanism('chain', bodies, joints[::-1])).joints == joints[::-1]


def test_field_error_survives_pickling():
    error = FieldError('this', 'that', 'advice', ('a', 1, 'b'))
    assert str(pickle.loads(pickle.dumps(error))) == 'a[1].b: expected this, got that (advice)'
