# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Machines written with rounded digits: as mobile as they were meant, or reported.

Random loops that move although they have more equations than joints are written with few digits.
The oracle is the same machine with all digits, and loops that stay closed on their whole way.
"""

import re
from test.test_cli import done

from closedloop_dynamics import (
    AssemblyError, load_scene, MechanismError, read_mechanism, SceneError, Simulation)
from closedloop_dynamics.cli import main
from closedloop_dynamics.formats.yaml_text import mechanism_text
from closedloop_dynamics.kinematics.global_assembly import ClosureProblem, find_closed
from closedloop_dynamics.mechanism.digits import extent, suspicions, with_agreement
from closedloop_dynamics.mechanism.mechanism import TOLERANCE
from closedloop_dynamics.mechanism.rotations import about, of_quaternion, quaternion_of
import numpy as np
import pytest

BODY = {'mass': 1.0, 'center_of_mass': [0.2, 0.05, 0.02], 'inertia': [0.01, 0.012, 0.013]}
GRAVITY = {'gravity': {'type': 'gravity', 'acceleration': [0.0, -9.81, 0.0]}}
# In the plane of the bars, ends of crank, coupler and rocker.
PLACES = np.array([[0.0, 0.0], [0.05, 0.1], [0.4, 0.25], [0.35, 0.0]])
X, Y, Z = np.eye(3)


def turn(rng):
    """Return a random rotation, shape (3, 3)."""
    quaternion = rng.normal(size=4)
    return of_quaternion(quaternion / np.linalg.norm(quaternion))


def loop_of(rng, digits, hinges):
    """
    Return the data of a loop of three bodies on the ground, in frames of their own.

    ``hinges``: type, place and axis in the world of the joints from the ground to the first, the
    second and the third body and back to the ground; the third one is cut. Frames at the joints
    are turned at random, and all numbers have so many digits.
    """
    def rounded(values):
        return [float(np.round(value, digits)) for value in values]

    frames, joints = {'ground': (np.eye(3), np.zeros(3))}, {}
    for name, parent, child, number in (('first', 'ground', 'crank', 0),
                                        ('second', 'crank', 'coupler', 1),
                                        ('fourth', 'ground', 'rocker', 3)):
        kind, place, axis = hinges[number]
        rotation, (above, origin) = turn(rng), frames[parent]
        joints[name] = {
            'type': kind, 'parent': parent, 'child': child,
            'position': rounded(above.T @ (place - origin)),
            'orientation': {'quaternion': rounded(quaternion_of(above.T @ rotation))},
            'axis': rounded(rotation.T @ axis)}
        frames[child] = rotation, place
    kind, place, axis = hinges[2]
    (a, at_a), (b, at_b) = frames['coupler'], frames['rocker']
    cut = {'type': kind, 'body_a': 'coupler', 'body_b': 'rocker',
           'point_a': rounded(a.T @ (place - at_a)), 'point_b': rounded(b.T @ (place - at_b)),
           'axis_b': rounded(b.T @ axis)}
    if kind == 'revolute':
        cut['axis_a'] = rounded(a.T @ axis)
    else:
        cut['orientation'] = {'quaternion': rounded(quaternion_of(b.T @ a))}
    return {'name': 'loop', 'bodies': dict.fromkeys(('crank', 'coupler', 'rocker'), BODY),
            'joints': joints, 'cut_joints': {'third': cut}}


def planar_loop(rng, digits):
    """Return a four-bar in a plane anywhere, its hinges at different heights."""
    world, heights = turn(rng), rng.uniform(-0.1, 0.1, 4)
    return loop_of(rng, digits, [
        ('revolute', world @ [*place, height], world[:, 2])
        for place, height in zip(PLACES, heights)])


def spherical_loop(rng, digits):
    """Return a loop of hinges whose axes meet in one point."""
    world, center = turn(rng), rng.uniform(-0.3, 0.3, 3)
    axes = np.array([[0.0, 0.0, 1.0], [1.0, 0.2, 0.6], [0.9, 1.0, 0.2], [0.1, 1.0, 0.4]])
    axes = axes / np.linalg.norm(axes, axis=1)[:, None] @ world.T
    return loop_of(rng, digits, [('revolute', center + far * axis, axis)
                                 for far, axis in zip(rng.uniform(0.2, 0.5, 4), axes)])


def sliding_loop(rng, digits, cut=False):
    """Return a slider and crank in a plane anywhere; the slide is cut, or in the tree."""
    world = turn(rng)
    slide = 'prismatic', world @ [0.35, 0.0, 0.02], world @ [0.96, 0.28, 0.0]
    hinges = [('revolute', world @ [*place, 0.0], world[:, 2]) for place in PLACES]
    hinges[2 if cut else 3] = slide
    return loop_of(rng, digits, hinges)


def cut_slide(rng, digits):
    return sliding_loop(rng, digits, cut=True)


def thread_loop(rng, digits):
    """Return a nut that turns and slides along an axis anywhere, on a thread that is cut."""
    def rounded(values):
        return np.round(values, digits).tolist()

    def turned(rotation):
        return {'quaternion': rounded(quaternion_of(rotation))}

    (carrier, nut, world), place = (turn(rng) for _ in range(3)), rng.uniform(-0.3, 0.3, 3)
    axis = world[:, 2]
    joints = {
        'first': {'type': 'revolute', 'parent': 'ground', 'child': 'carrier',
                  'position': rounded(place), 'orientation': turned(carrier),
                  'axis': rounded(carrier.T @ axis)},
        'second': {'type': 'prismatic', 'parent': 'carrier', 'child': 'nut',
                   'position': [0.0, 0.0, 0.0], 'orientation': turned(carrier.T @ nut),
                   'axis': rounded(nut.T @ axis)}}
    cut = {'type': 'helical', 'body_a': 'nut', 'body_b': 'ground', 'point_a': [0.0, 0.0, 0.0],
           'point_b': rounded(place), 'axis_b': rounded(axis), 'orientation': turned(nut),
           'lead': 0.05}
    return {'name': 'loop', 'bodies': dict.fromkeys(('carrier', 'nut'), BODY),
            'joints': joints, 'cut_joints': {'third': cut}}


LOOPS = {'planar': planar_loop, 'spherical': spherical_loop, 'sliding': sliding_loop,
         'sliding and cut': cut_slide, 'thread': thread_loop}


def most_open(mechanism, joint='first'):
    """Return the most that a loop stays open on its way [m, sines of angles]."""
    size, worst = extent(mechanism), 0.0
    problem = ClosureProblem(mechanism, size)
    for angle in (0.0, 0.1, -0.15):
        q = mechanism.coordinates.start()
        q[mechanism.coordinates.coordinates[joint]] = angle
        found = find_closed(mechanism, size, q, (joint,), starts=0)
        worst = max(worst, *problem.closure_errors(found.q).values())
    return worst


@pytest.mark.parametrize('digits', [9, 10, 12])
@pytest.mark.parametrize('kind', LOOPS)
@pytest.mark.parametrize('seed', range(5))
def test_loops_of_few_digits_stay_closed_on_their_way(kind, digits, seed):
    meant, written = (read_mechanism(LOOPS[kind](np.random.default_rng(seed), count))
                      for count in (17, digits))
    as_is = read_mechanism({**LOOPS[kind](np.random.default_rng(seed), digits), 'tolerance': 0.0})
    assert not meant.rounded and not as_is.rounded and written.rounded
    # Rounding of lengths of 0.5 m, after the search has ended at a thousandth of 1e-9.
    assert most_open(meant) < 3e-12
    assert most_open(written) < 3e-12
    if digits < 11:
        assert most_open(as_is) > 1e-11
    # Nothing is moved by more than digits are apart.
    for one, other in zip((*written.joints, *written.cut_joints),
                          (*meant.joints, *meant.cut_joints)):
        for key in ('position', 'axis', 'orientation', 'point_a', 'point_b', 'axis_a', 'axis_b'):
            if getattr(one, key, None) is not None:
                assert getattr(one, key) == pytest.approx(
                    getattr(other, key), rel=0.0, abs=10.0 * 10.0 ** -digits)


@pytest.mark.parametrize('kind', LOOPS)
@pytest.mark.parametrize('seed', range(5))
def test_what_agrees_stays_as_it_is(tmp_path, kind, seed):
    path = tmp_path / 'again.yaml'
    # Eight digits agree to the tolerance in part, so that some is changed, the rest reported.
    for digits in (8, 9, 17):
        mechanism = read_mechanism(LOOPS[kind](np.random.default_rng(seed), digits))
        assert with_agreement(mechanism) is mechanism
        path.write_text(mechanism_text(mechanism))
        again = read_mechanism(path)
        assert again == mechanism and not again.rounded


def door(tilt=0.0, offset=0.0, **keys):
    """Return a scene of a door on two hinges, of which one is beside the other's axis."""
    axis = (about(X, tilt) @ Z).tolist()
    upper = {'type': 'revolute', 'body_a': 'door', 'body_b': 'ground', 'axis_a': axis,
             'axis_b': Z.tolist(), 'point_a': [offset, 0.0, 1.0], 'point_b': [offset, 0.0, 1.0]}
    return {'mechanism': {
        'name': 'door', 'bodies': {'door': {**BODY, 'center_of_mass': [0.5, 0.0, 0.5]}},
        'joints': {
            'lower': {'type': 'revolute', 'parent': 'ground', 'child': 'door',
                      'position': [0.0, 0.0, 0.0], 'axis': Z.tolist()}},
        'cut_joints': {'upper': upper}, **keys},
        'initial': {'position': {'lower': 0.3}}, 'effects': GRAVITY}


def swung(scene):
    """Return where a door is after half a second, and the largest force in its hinges [N]."""
    simulation = Simulation(load_scene(scene))
    assert simulation.data.degrees_of_freedom() == 1
    simulation.step(None, 0.5)
    return simulation.position[0], np.abs(simulation.joint_forces).max()


DIGITS = [{'tilt': 1e-12}, {'tilt': 1e-10}, {'tilt': 1e-9}, {'tilt': 9e-9}, {'offset': 1e-12},
          {'offset': 1e-10}, {'offset': 1e-9}, {'offset': 9e-9}, {'tilt': -1e-9, 'offset': 1e-9}]


@pytest.mark.parametrize('digits', DIGITS)
def test_a_door_with_hinges_that_agree_to_digits_swings(digits):
    # With hinges that are locked it stands, or falls with forces of rounding.
    right, force = swung(door())
    position, largest = swung(door(**digits))
    assert position == pytest.approx(right, rel=0.0, abs=1e-8)
    assert largest == pytest.approx(force, rel=1e-6) and largest < 100.0


def test_a_door_is_a_pendulum():
    # A body of mass m with its centre at r swings like a pendulum without a second hinge.
    scene = door()
    del scene['mechanism']['cut_joints']
    alone = Simulation(load_scene(scene))
    alone.step(None, 0.5)
    assert swung(door(tilt=1e-9))[0] == pytest.approx(alone.position[0], rel=0.0, abs=1e-7)


@pytest.mark.parametrize('digits, said', [
    ({'tilt': 1e-9}, 'axes that agree to 1e-09 are taken as parallel: lower, upper (on door)'),
    ({'offset': 1e-9},
     'axes and points that miss by 1e-09 m are taken as meeting: upper, lower (on door); '
     'upper, lower (on ground)')])
def test_what_is_taken_as_agreeing_is_reported(digits, said):
    simulation = Simulation(load_scene(door(**digits)))
    assert set(said.split(': ')[1].split('; ')) <= set(
        simulation.data.start_notes()[0].split(': ')[1].split('; '))
    assert simulation.data.start_notes()[0].startswith(said.split(': ')[0])


@pytest.mark.parametrize('digits', [{'tilt': 1e-7}, {'tilt': 4e-6}, {'offset': 1e-7},
                                    {'offset': 4e-6}])
def test_what_looks_rounded_is_reported_with_a_remedy(digits):
    far = max(map(abs, digits.values()))
    scene = door(**digits)
    mechanism = read_mechanism(scene['mechanism'])
    assert not mechanism.rounded
    note, = suspicions(mechanism)
    wide = 10.0 * far if far == 1e-7 else 1e-5
    assert 'This is how rounded digits look.' in note and f'--geometry-tolerance {wide:.0e}' in (
        note) or far == 1e-7 and '--geometry-tolerance 1e-07' in note
    try:
        notes = Simulation(load_scene(scene)).data.start_notes()
    except AssemblyError as error:
        notes = [str(error)]
    assert any('This is how rounded digits look.' in one for one in notes)
    wider = {**scene, 'mechanism': {**scene['mechanism'], 'tolerance': 1.01 * wide}}
    assert swung(wider)[0] == pytest.approx(swung(door())[0], rel=0.0, abs=1e-4)
    assert Simulation(load_scene(scene, tolerance=1.01 * wide)).data.degrees_of_freedom() == 1


def test_what_differs_by_more_is_neither_changed_nor_suspected():
    for digits in ({'tilt': 1e-4}, {'offset': 1e-4}):
        mechanism = read_mechanism(door(**digits)['mechanism'])
        assert not mechanism.rounded and not suspicions(mechanism)


@pytest.mark.parametrize('given', [-1.0, 'wide', 0.1, float('nan')])
def test_a_tolerance_is_one_of_digits(given):
    with pytest.raises(MechanismError, match='tolerance: expected a '):
        read_mechanism(door(tolerance=given)['mechanism'])
    if not isinstance(given, str):
        with pytest.raises(SceneError, match='expected a number'):
            load_scene(door(), tolerance=given)


def test_slides_and_pins_of_the_plane_agree_too():
    body = {'mass': 1.0, 'center_of_mass': [0.1, 0.0], 'inertia': 0.01}
    sled = {
        'name': 'sled', 'bodies': {'sled': body}, 'joints': {
            'rail': {'type': 'prismatic', 'parent': 'ground', 'child': 'sled', 'position': [0, 0],
                     'angle': 0.5}},
        'cut_joints': {'second': {'type': 'prismatic', 'body_a': 'sled', 'body_b': 'ground',
                                  'point_a': [0.2, 0.3], 'angle': 0.5000000003, 'point_b': [
                                      0.2 * np.cos(0.5) - 0.3 * np.sin(0.5) + 1e-9,
                                      0.2 * np.sin(0.5) + 0.3 * np.cos(0.5)]}}}
    mechanism = read_mechanism(sled)
    # Half a second along an incline of 0.5 rad.
    assert any('orientations that agree to 3e-10' in note for note in mechanism.rounded)
    assert mechanism.cut_joints[0].angle == pytest.approx(0.5, rel=0.0, abs=1e-15)
    cut = mechanism.cut_joints[0]
    normal = np.array([-np.sin(0.5), np.cos(0.5)])
    assert normal @ (about(Z, 0.5)[:2, :2] @ cut.point_a - cut.point_b) == pytest.approx(
        0.0, abs=1e-15)
    pin = {'name': 'pin', 'bodies': {'arm': body}, 'joints': {
        'one': {'type': 'revolute', 'parent': 'ground', 'child': 'arm', 'position': [0.3, 0.4]}},
        'cut_joints': {'two': {'type': 'revolute', 'body_a': 'arm', 'body_b': 'ground',
                               'point_a': [1e-10, -2e-10], 'point_b': [0.3, 0.4]}}}
    assert read_mechanism(pin).cut_joints[0].point_a == pytest.approx((0.0, 0.0), abs=1e-16)


def test_a_thread_agrees_whose_axis_is_rounded_on_one_body_alone():
    off, place, across = 3e-10, [0.1, 0.2, 0.3], about(Y, -0.5 * np.pi)
    data = {
        'name': 'thread', 'bodies': dict.fromkeys(('carrier', 'nut'), BODY), 'joints': {
            'first': {'type': 'revolute', 'parent': 'ground', 'child': 'carrier',
                      'position': place, 'axis': [0.0, 0.0, 1.0]},
            'second': {'type': 'prismatic', 'parent': 'carrier', 'child': 'nut',
                       'position': [0.0, 0.0, 0.0], 'axis': [1.0, 0.0, 0.0],
                       'orientation': {'quaternion': list(quaternion_of(across))}}},
        'cut_joints': {'third': {
            'type': 'helical', 'body_a': 'nut', 'body_b': 'ground', 'point_a': [0.0, 0.0, 0.0],
            'point_b': place, 'axis_b': [np.sin(off), 0.0, np.cos(off)], 'lead': 0.05,
            'orientation': {'quaternion': list(quaternion_of(about(Y, off) @ across))}}}}
    as_is, mechanism = read_mechanism({**data, 'tolerance': 0.0}), read_mechanism(data)
    assert most_open(as_is) > 0.9 * off and most_open(mechanism) < 3e-12
    for key in ('axis_b', 'orientation'):
        before, after = (getattr(one.cut_joints[0], key) for one in (as_is, mechanism))
        np.testing.assert_allclose(after, before, atol=2.0 * off)


FOUR_BAR = """\
<robot name="four_bar">
<link name="base"/>
<link name="crank"><inertial><origin xyz="0.05 0 0"/><mass value="0.5"/>
<inertia ixx="1e-4" iyy="5e-4" izz="5e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="coupler"><inertial><origin xyz="0.2 0 0"/><mass value="1.0"/>
<inertia ixx="2e-4" iyy="0.014" izz="0.014" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="rocker"><inertial><origin xyz="0.15 0 0"/><mass value="0.8"/>
<inertia ixx="2e-4" iyy="0.006" izz="0.006" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="crank_joint" type="continuous"><parent link="base"/><child link="crank"/>
<origin rpy="FIRST 0 0"/><axis xyz="0 0 1"/><limit effort="2" velocity="10"/></joint>
<joint name="coupler_joint" type="continuous"><parent link="crank"/><child link="coupler"/>
<origin xyz="0.1 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="rocker_joint" type="continuous"><parent link="base"/><child link="rocker"/>
<origin xyz="0.35 0 0" rpy="SECOND 0 0"/><axis xyz="0 0 1"/></joint>
<loop name="pin" type="continuous"><predecessor link="coupler"><origin xyz="0.4 0 0"/>
</predecessor><successor link="rocker"><origin xyz="0.3 0 0"/></successor><axis xyz="0 0 1"/>
</loop></robot>
"""


@pytest.mark.parametrize('first, second', [
    ('1.570796327', '1.5707963268'), ('1.5707963268', '1.570796327'),
    ('1.57079633', '1.5707963267948966'), ('1.570796', '1.570796')])
def test_check_and_simulate_decide_alike(tmp_path, capsys, first, second):
    path = tmp_path / 'bars.urdf'
    path.write_text(FOUR_BAR.replace('FIRST', first).replace('SECOND', second))
    shown = done(capsys, 'check', path)
    assert 'degrees of freedom    1 = ' in shown
    assert ('are taken as parallel: crank_joint, rocker_joint (on ground)' in shown) == (
        first != second)
    assert main(['simulate', str(path), '--duration', '0.01']) == 0


def test_everyday_rounding_is_named(tmp_path, capsys):
    path = tmp_path / 'bars.urdf'
    path.write_text(FOUR_BAR.replace('FIRST', '1.5708').replace('SECOND', '1.570796'))
    said = 'axes that agree to 4e-06 are not parallel: crank_joint, rocker_joint (on ground)'
    assert main(['check', str(path)]) == 2
    shown = capsys.readouterr()
    assert said in shown.out and 'degrees of freedom    not known: no position' in shown.out
    assert 'no position was found that closes the loops' in shown.err
    assert main(['simulate', str(path), '--duration', '0.01']) == 1
    assert said in capsys.readouterr().err
    for option in ('--tolerance', '--geometry-tolerance'):
        shown = done(capsys, 'check', path, option, '1e-5')
        assert 'degrees of freedom    1 = 3 joints - 2' in shown
        assert 'axes that agree to 4e-06 are taken as parallel: crank_joint' in shown
    assert main(['simulate', str(path), '--geometry-tolerance', '1e-5', '--duration', '0.01']) == 0
    scene = tmp_path / 'scene.yaml'
    scene.write_text('mechanism: ./bars.urdf\ntolerance: 1e-5\n')
    assert Simulation(load_scene(scene)).data.degrees_of_freedom() == 1


def test_the_tolerance_is_that_of_nine_digits():
    assert read_mechanism(door()['mechanism']).tolerance == TOLERANCE == 1e-8


def bennett(tmp_path, digits):
    """Return the scene of a Bennett linkage, its lengths and angles in so many digits."""
    shipped = load_scene('bennett')
    path = tmp_path / 'digits.yaml'
    path.write_text(re.sub(r'-?\d+\.\d{5,}', lambda number: f'{float(number[0]):.{digits}f}',
                           mechanism_text(shipped.mechanism)))
    return {'mechanism': str(path), 'effects': GRAVITY, 'initial': {
        'position': dict(zip(shipped.mechanism.joint_names, shipped.initial.position)),
        'hold': list(shipped.initial.hold)}}


@pytest.mark.parametrize('digits, near', [(8, 1e-6), (9, 1e-7), (10, 1e-7), (12, 1e-7)])
def test_loops_that_close_to_the_digits_of_lengths_are_closed(tmp_path, digits, near):
    # No axes of a Bennett linkage agree: lengths and angles together let it move.
    meant, found = (Simulation(load_scene(bennett(tmp_path, count))) for count in (17, digits))
    for simulation in (meant, found):
        simulation.step(None, 0.3)
        assert simulation.data.degrees_of_freedom() == 1
        # The energy balance is that of accuracy 1e-6.
        assert abs(simulation.energy_balance.residual) < 1e-8
    np.testing.assert_allclose(found.position, meant.position, rtol=0.0, atol=near)
    reported = [note for note in found.data.start_notes()
                if 'and nowhere better: taken as closed' in note]
    assert len(reported) == (digits < 12)
    assert not any('nowhere better' in note for note in meant.data.start_notes())


def test_loops_that_are_further_open_are_refused_with_a_remedy(tmp_path):
    scene = bennett(tmp_path, 6)
    with pytest.raises(AssemblyError, match='If rounded digits keep them open, '
                                            '--geometry-tolerance 1e-05'):
        Simulation(load_scene(scene))
    simulation = Simulation(load_scene(scene, tolerance=1e-5))
    assert simulation.data.degrees_of_freedom() == 1
    simulation.step(None, 0.3)
    meant = Simulation(load_scene(bennett(tmp_path, 17)))
    meant.step(None, 0.3)
    np.testing.assert_allclose(simulation.position, meant.position, rtol=0.0, atol=1e-3)
