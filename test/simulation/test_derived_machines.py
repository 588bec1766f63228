# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Cognates, mirror images and inversions of machines, in doc/examples/derived_machines."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
import runpy

from closedloop_dynamics import load_scene, Model, Simulation, write_scene
from closedloop_dynamics.effects.registry import (
    EndStop, JointSpring, Payload, PointSpring, PrescribedForce, Rotor)
from closedloop_dynamics.mechanism.kinematics import (
    body_poses, named_point, pose_of, poses_in_space)
from closedloop_dynamics.mechanism.rotations import rotated
import numpy as np
import pytest

from ..reference.designs import four_bar
from ..test_cli import done

FOLDER = Path(__file__).resolve().parents[2] / 'doc' / 'examples' / 'derived_machines'


with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(FOLDER)
    cognates = import_module('cognates').cognates
    inverted = import_module('inversion').inverted
    mirrored = import_module('mirror').mirrored


def call_example(capsys, *arguments):
    """Return exit code, standard output and errors of the example's command line."""
    program = runpy.run_path(str(FOLDER))
    try:
        code = program['main']([str(one) for one in arguments])
    except SystemExit as end:
        code = end.code
    return code, *capsys.readouterr()


# Crank, coupler, rocker, base and the point: a crank-rocker, Hoeken's, a drag link, a double
# rocker over the part that it can turn; a point below the coupler, and one on its line.
LINKAGES = {
    'crank-rocker': (1.0, 3.5, 2.5, 4.0, (1.7, 1.1), 2.0 * np.pi),
    'hoeken': (1.0, 2.5, 2.5, 2.0, (5.0, 0.0), 2.0 * np.pi),
    'drag link': (2.5, 2.0, 3.0, 1.0, (-0.7, -0.9), 2.0 * np.pi),
    'double rocker': (3.0, 1.0, 2.8, 3.5, (0.4, 2.0), 0.1)}


@pytest.mark.parametrize('name', LINKAGES)
def test_cognates_trace_the_same_curve(tmp_path, name):
    *lengths, point, course = LINKAGES[name]
    scene = four_bar(tmp_path, *lengths, angle=1.0, point=point, gravity=9.81)
    model = Model(scene)
    turn = model.solve({'crank_joint': np.linspace(1.0, 1.0 + course, 181)})
    tool = model.evaluate(turn).points['tool']
    crank, coupler, rocker = turn.q.T
    first, second = cognates(scene)
    # Links of the first one turn as coupler, crank and rocker do.
    (driven,) = first.scene.mechanism.actuated_joints
    first_drive = {'input_joint': crank + coupler, 'coupler_joint': -coupler}[driven]
    for one, drive, rate in ((first, driven, first_drive), (second, 'input_joint', crank)):
        other = Model(one.scene)
        start = other.assemble().q[other.coordinates.index[drive]]
        found = other.solve({drive: start + rate - rate[0]})
        np.testing.assert_allclose(other.evaluate(found).points['tool'], tool, rtol=0, atol=1e-13)
        assert one.scene.effects == scene.effects
        assert np.ptp(tool[:, 0]) > 0.05


def test_lengths_of_cognates_are_those_of_the_theorem(tmp_path):
    # A triangle of sides 3, 4, 5 on the coupler: ratios of the links are 3/5 and 4/5.
    scene = four_bar(tmp_path, 1.0, 5.0, 4.0, 6.0, point=(1.8, 2.4))
    lengths = [[abs(complex(*cut.point_b)), abs(complex(*cut.point_a)), abs(complex(*joint))]
               for one in cognates(scene) for cut in one.scene.mechanism.cut_joints
               for joint in [one.scene.mechanism.joints[1].position]]
    np.testing.assert_allclose(lengths[0], [2.4, 0.6, 3.0], atol=1e-12)
    np.testing.assert_allclose(lengths[1], [4.0, 3.2, 0.8], atol=1e-12)


@pytest.mark.parametrize('point, message', [
    ('nothing', "expected a point of the coupler, coupler (tool), got 'nothing'"),
    ('tool', 'which traces a circle')])
def test_cognates_refuse_other_points(tmp_path, point, message):
    scene = four_bar(tmp_path, 1.0, 3.5, 2.5, 4.0, point=(3.5, 0.0))
    with pytest.raises(ValueError, match='^point: ') as error:
        cognates(scene, point)
    assert message in str(error.value)
    with pytest.raises(ValueError, match='expected a four-bar linkage'):
        cognates(load_scene('slider_crank'))


def moved(scene, steps=40):
    """Return coordinates and rates after some steps."""
    simulation = Simulation(scene.with_method({'integrator': 'rk4', 'step_size': 1e-3}))
    simulation.step(duration=1e-3 * steps)
    coordinates = scene.mechanism.coordinates
    return np.split(simulation.state[:coordinates.nq + coordinates.nv], [coordinates.nq])


def loaded():
    """Return a four-bar linkage with effects of all kinds that are carried over."""
    scene = load_scene('four_bar')
    return replace(scene, effects={
        **scene.effects, 'spring': JointSpring('rocker_joint', 3.0, 0.4),
        'stop': EndStop('coupler_joint', 400.0, lower=-0.8, upper=-0.55, damping=0.1),
        'push': PrescribedForce('expression', point='coupler_point', direction=(1.0, 2.0),
                                expression='3+t'),
        'torque': PrescribedForce('sine', joint='crank_joint', amplitude=0.2, frequency=2.0),
        'rotor': Rotor('crank_joint', 1e-4, 3.0),
        'load': Payload('coupler', 0.4, (0.1, 0.05), 1e-4),
        'rope': PointSpring('coupler_point', anchor=(0.5, 0.7), stiffness=30.0, free_length=0.1)})


@pytest.mark.parametrize('name, axis', [
    ('loaded', 'x'), ('three_rrr_payload_friction', 'y'), ('planetary_gear', 'x'),
    ('bennett', 'z'),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('double_wishbone', 'y'), ('loaded', 'y'), ('slider_crank', 'x'), ('scissor_lift', 'x'),
        ('geared_five_bar', 'x'), ('stewart_platform', 'x'), ('delta_robot', 'y'),
        ('excavator_arm', 'y')))])
def test_mirror_image_moves_as_the_mirror_image(name, axis):
    scene = loaded() if name == 'loaded' else load_scene(name)
    image = mirrored(scene, axis)
    size = 2 if scene.mechanism.planar else 3
    flip = np.array([-1.0 if one == axis else 1.0 for one in 'xyz'])[:size]
    # What is left out acts in neither.
    kept = replace(scene, effects={
        key: effect for key, effect in scene.effects.items() if key in image.scene.effects})
    (q, rates), (other_q, other_rates) = moved(kept), moved(image.scene)
    poses, others = (body_poses(one.mechanism, position) for one, position in (
        (scene, q), (image.scene, other_q)))
    np.testing.assert_allclose(others[:, :size], flip * poses[:, :size], rtol=0, atol=1e-10)
    for point in scene.mechanism.points:
        np.testing.assert_allclose(
            named_point(image.scene.mechanism, others, point.name),
            flip * named_point(scene.mechanism, poses, point.name), rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.abs(other_rates), np.abs(rates), rtol=1e-8, atol=1e-9)
    assert np.abs(rates).max() > 1e-3


@pytest.mark.parametrize('name', ['loaded', 'scissor_lift', 'stewart_platform', 'double_wishbone'])
def test_mirror_image_of_the_mirror_image_is_the_machine(name):
    scene = loaded() if name == 'loaded' else load_scene(name)
    axis = 'y'
    again = mirrored(mirrored(scene, axis).scene, axis).scene
    for key in ('bodies', 'joints', 'cut_joints', 'points', 'couplings'):
        for one, other in zip(getattr(again.mechanism, key), getattr(scene.mechanism, key)):
            assert one == other
    np.testing.assert_array_equal(again.initial.position, scene.initial.position)


def relative(mechanism, position, link, bodies):
    """Return places and directions of bodies as a link sees them."""
    poses = body_poses(mechanism, position)
    own = poses_in_space(pose_of(mechanism, poses, link))
    seen = []
    for body in bodies:
        pose = poses_in_space(pose_of(mechanism, poses, body))
        back = own[..., 3:] * (-1.0, -1.0, -1.0, 1.0)
        seen.append(rotated(back, pose[..., :3] - own[..., :3]))
        seen += [rotated(back, rotated(pose[..., 3:], axis)) for axis in np.eye(3)]
    return np.array(seen)


@pytest.mark.parametrize('name, link, drive, size', [
    ('four_bar', 'coupler', 'crank_joint', 2.0), ('bennett', 'coupler', None, 0.5),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('four_bar', 'crank', 'crank_joint', 2.0), ('slider_crank', 'slider', 'crank_joint', 2.0),
        ('four_bar', 'rocker', 'crank_joint', 2.0), ('slider_crank', 'rod', 'crank_joint', 2.0),
        ('scissor_lift', 'b_1', None, 0.1), ('hoeken_pantograph_leg', 'link_6', 'theta_1', 2.0),
        ('stewart_platform', 'platform', None, 0.05), ('delta_robot', 'rod_21', None, 0.1)))])
def test_inversion_has_the_same_relative_motion(name, link, drive, size):
    scene = load_scene(name)
    image = inverted(scene, link).scene
    old, new = Model(scene), Model(image)
    starts = [model.assemble() for model in (old, new)]
    names = [drive] if drive else list(old.actuated_joints)
    motions = []
    for model, start in zip((old, new), starts):
        values = {}
        for one in names:
            begin = start.q[model.coordinates.place[model.coordinates.index[one]]]
            reversed_turn = scene.mechanism.planar and begin * starts[0].q[
                old.coordinates.place[old.coordinates.index[one]]] < 0.0
            values[one] = begin + (-1.0 if reversed_turn else 1.0) * np.linspace(0.0, size, 21)
        motions.append(model.solve(values).q)
    # Those that the same joints carry have the same frames.
    carried = {joint.name: joint.child for joint in image.mechanism.joints}
    kept = [joint.child for joint in scene.mechanism.joints
            if joint.child != link and carried[joint.name] == joint.child]
    assert kept
    seen = relative(scene.mechanism, motions[0], link, kept)
    found = relative(image.mechanism, motions[1], 'ground', kept)
    # The link is held where it was.
    poses = body_poses(scene.mechanism, motions[0][0])
    held = poses_in_space(pose_of(scene.mechanism, poses, link))
    there = rotated(held[3:], seen)
    there[::4] += held[:3]
    np.testing.assert_allclose(found, there, rtol=0, atol=1e-9)
    assert np.ptp(there, axis=1).max() > 1e-2


def test_inversion_carries_what_acts_in_joints():
    found = inverted(loaded(), 'rocker')
    effects = found.scene.effects
    assert effects['spring'].rest == -0.4 and effects['stop'].lower == -0.8
    assert set(effects) == {'gravity', 'spring', 'stop', 'torque', 'rotor', 'load'}
    assert [note.split(' ')[0] for note in found.left_out[1:]] == ['effects.push', 'effects.rope']
    assert 'the mass of rocker' in found.left_out[0]
    other = inverted(loaded(), 'coupler').scene.effects
    assert (other['stop'].lower, other['stop'].upper) == (0.55, 0.8)
    assert 'rotor' not in other and 'load' not in other and other['torque'].amplitude == -0.2


def test_inversion_refuses_what_no_loop_moves():
    with pytest.raises(ValueError, match='expected a loop through the old ground'):
        inverted(load_scene('excavator_arm'), 'house')


@pytest.mark.parametrize('command, options, files', [
    ('mirror', ['--axis', 'y', '--output', 'a.yaml'], ['a.yaml']),
    ('invert', ['--ground', 'coupler', '--output', 'a.yaml'], ['a.yaml']),
    ('cognates', ['--output', 'both'], ['both/cognate_1.yaml', 'both/cognate_2.yaml'])])
def test_the_example_writes_scenes_that_check_accepts(
        capsys, tmp_path, monkeypatch, command, options, files):
    monkeypatch.chdir(tmp_path)
    write_scene(loaded(), 'loaded.yaml')
    code, text, errors = call_example(capsys, command, 'loaded.yaml', *options)
    assert code == 0, errors
    assert text.splitlines()[:len(files)] == files
    if command != 'mirror':
        assert 'left out: effects.rope (point_spring)' in errors
    for file in files:
        done(capsys, 'check', file)
    code, _, errors = call_example(capsys, command, 'loaded.yaml', *options)
    assert code == 2 and '--output: expected the name of a new file' in errors


@pytest.mark.parametrize('command, options, message', [
    ('mirror', ['--axis', 'z'], 'axis: expected one of x, y, got'),
    ('invert', ['--ground', 'nothing'], 'ground: expected one of the bodies (crank, coupler, '),
    ('cognates', ['--point', 'nothing'], 'point: expected a point of the coupler')])
def test_the_example_refuses_what_makes_no_sense(capsys, tmp_path, command, options, message):
    place = tmp_path / ('both' if command == 'cognates' else 'a.yaml')
    code, _, errors = call_example(capsys, command, 'four_bar', *options, '--output', place)
    assert code == 2 and message in errors
    assert not place.is_file()
