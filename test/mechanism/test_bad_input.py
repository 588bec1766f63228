# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Descriptions in space that cannot be: refused with file, key, what was expected and what got."""

from closedloop_dynamics.cli import main
import pytest

MECHANISM = """\
name: rssr
bodies:
  crank: {mass: 0.5, center_of_mass: [0.05, 0, 0], inertia: [2.5e-5, 4.3e-4, 4.3e-4]}
  rocker: {mass: 1.0, center_of_mass: [0, 0, 0.15], inertia: [7.6e-3, 7.6e-3, 1.1e-4]}
  link: {massless: true}
  rod: {mass: 0.8, center_of_mass: [0.26, 0, 0], inertia: [4.0e-5, 0.018, 0.018]}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0, 0, 0], axis: [0, 0, 1],
                orientation: {quaternion: [0, 0, 0, 1]}, actuated: true}
  rocker_joint: {type: revolute, parent: ground, child: rocker, position: [0.4, 0.3, 0],
                 axis: [1, 0, 0]}
  turn: {type: revolute, parent: crank, child: link, position: [0.1, 0, 0], axis: [0, 0, 1]}
  tilt: {type: revolute, parent: link, child: rod, position: [0, 0, 0], axis: [0, 1, 0]}
cut_joints:
  ball: {type: spherical, body_a: rod, point_a: [0.52, 0, 0], body_b: rocker, point_b: [0, 0, 0.3]}
"""
SCENE = """\
mechanism: ./machine.yaml
initial: {position: {crank_joint: 0.0, rocker_joint: 0.0, turn: 0.8, tilt: -0.6}}
effects:
  motor: {type: actuator, joint: crank_joint, max_torque: 2}
"""
BALL = MECHANISM[MECHANISM.index('  ball:'):]
# What is written in place of what in the mechanism or the scene, and the error.
CASES = {
    'a quaternion that is no unit': (
        'quaternion: [0, 0, 0, 1]', 'quaternion: [0, 0, 1, 1]',
        'machine.yaml:9: joints.crank_joint.orientation.quaternion: expected a unit quaternion '
        '[x, y, z, w], got one of norm 1.41421'),
    'an axis of no length': (
        'axis: [1, 0, 0]', 'axis: [0, 0.0, 0]',
        'machine.yaml:11: joints.rocker_joint.axis: expected a direction [x, y, z] that is not '
        'zero, got [0, 0.0, 0]'),
    'a moment larger than the two others': (
        'inertia: [7.6e-3, 7.6e-3, 1.1e-4]', 'inertia: [7.6e-3, 1.1e-3, 1.1e-4]',
        'machine.yaml:4: bodies.rocker.inertia: expected moments of inertia that a body can have'),
    'an inertia that is left-handed': (
        'inertia: [7.6e-3, 7.6e-3, 1.1e-4]', 'inertia: [7.6e-3, 7.6e-3, -1.1e-4]',
        'machine.yaml:4: bodies.rocker.inertia: expected moments of inertia that a body can have'),
    'products beyond the moments': (
        'inertia: [7.6e-3, 7.6e-3, 1.1e-4]', 'inertia: [7.6e-3, 7.6e-3, 1.1e-4, 9e-3, 0, 0]',
        'machine.yaml:4: bodies.rocker.inertia: expected moments of inertia that a body can have'),
    'a vector of the plane': (
        'center_of_mass: [0.26, 0, 0]', 'center_of_mass: [0.26, 0]',
        'machine.yaml:6: bodies.rod.center_of_mass: expected a list of 3 finite numbers [x, y, '
        'z], got [0.26, 0], of length 2'),
    'a moment of inertia': (
        'inertia: [4.0e-5, 0.018, 0.018]', 'inertia: 0.018',
        'machine.yaml:6: bodies.rod.inertia: expected a list of 3'),
    'no axis': (
        ',\n                 axis: [1, 0, 0]}', '}',
        'machine.yaml:10: joints.rocker_joint.axis: expected this key of a revolute joint, got '
        'none'),
    'an axis too many': (
        '{type: spherical, body_a: rod', '{type: spherical, axis_a: [1, 0, 0], body_a: rod',
        'machine.yaml:15: cut_joints.ball.axis_a: expected no such key of a spherical joint'),
    'an orientation without a name': (
        '{quaternion: [0, 0, 0, 1]}', '[0, 0, 0]',
        'machine.yaml:9: joints.crank_joint.orientation: expected a mapping with rpy'),
    'an orientation of what leaves it free': (
        '{type: spherical, body_a: rod', '{type: distance, length: 0.1, orientation: {rpy: [0, 0, '
        '1]}, body_a: rod', 'machine.yaml:15: cut_joints.ball.orientation: expected no '
        'orientation of a distance joint'),
    'an angle of the plane': (
        'position: [0, 0, 0], axis: [0, 1, 0]', 'position: [0, 0, 0], axis: [0, 1, 0], angle: 0.5',
        'machine.yaml:13: joints.tilt.angle: expected nothing: only a mechanism in the plane has '
        'this key'),
    'a lead': (
        'position: [0, 0, 0], axis: [0, 1, 0]', 'position: [0, 0, 0], axis: [0, 1, 0], lead: 0.1',
        'machine.yaml:13: joints.tilt.lead: expected no such key of a revolute joint, but of '
        'helical'),
    'an unknown type': (
        'tilt: {type: revolute', 'tilt: {type: revolut',
        'machine.yaml:13: joints.tilt.type: expected one of revolute, '),
    'universal axes that are parallel': (
        '{type: revolute, parent: crank, child: link, position: [0.1, 0, 0], axis: [0, 0, 1]',
        '{type: universal, parent: crank, child: link, position: [0.1, 0, 0], '
        'axis: [0, 0, 1], second_axis: [0, 0, -3]',
        'machine.yaml:12: joints.turn.second_axis: expected a second axis across the first, got '
        'one that is parallel to it'),
    'two drives of one coordinate': (
        'motor: {type: actuator', 'gear: {type: actuator, joint: crank_joint}\n  '
        'motor: {type: actuator', 'scene.yaml:5: effects.motor.joint: expected one drive for each '
        "joint, got a second one for 'crank_joint', which 'gear' drives"),
    'a loop that is too short': (
        'point_a: [0.52, 0, 0]', 'point_a: [5.2, 0, 0]',
        'scene.yaml: rssr cannot be assembled from this position: expected loops that close, got '
        'cut_joints.ball open by '),
    'a loop that no motion closes': (
        BALL, BALL + '  pin: {type: revolute, body_a: crank, point_a: [0, 0, 0.1], axis_a: [0, 0, '
        '1], body_b: ground, point_b: [0, 0, 0], axis_b: [0, 0, 1]}\n',
        'scene.yaml: mechanism.cut_joints.pin: expected axes and points that the joints of the '
        'tree can bring together, got an equation that no motion changes and that is not met: 0.1 '
        'instead of 0'),
    'a part of its own': (
        'tilt: {type: revolute, parent: link, child: rod', 'tilt: {type: revolute, parent: rod, '
        'child: rod', 'machine.yaml:13: joints.tilt.parent: expected a chain of parents that '
        "ends at 'ground', got the cycle rod -> rod"),
    'a body that nothing carries': (
        MECHANISM[MECHANISM.index('  tilt:'):MECHANISM.index('cut_joints')], '',
        'machine.yaml:6: bodies.rod: expected a joint that has this body as its child, got none'),
}


@pytest.mark.parametrize('case', CASES)
def test_what_cannot_be_is_refused_by_file_and_key(tmp_path, monkeypatch, capsys, case):
    monkeypatch.chdir(tmp_path)
    old, new, message = CASES[case]
    assert (old in MECHANISM) != (old in SCENE)
    (tmp_path / 'machine.yaml').write_text(MECHANISM.replace(old, new))
    (tmp_path / 'scene.yaml').write_text(SCENE.replace(old, new))
    for command in (['check'], ['simulate', '--duration', '0.1']):
        assert main([*command[:1], 'scene.yaml', *command[1:]]) == 2
        assert message in capsys.readouterr().err
