# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Joints between two bodies: any tree gives the same motion, and a good one is chosen."""

from dataclasses import replace

from closedloop_dynamics import Simulation
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.mechanism import MechanismError, Point
from closedloop_dynamics.mechanism.reader import read_mechanism, with_cuts, with_parameters
from closedloop_dynamics.scene.loading import load_scene, load_scene_or_mechanism, SceneError
from closedloop_dynamics.studies.check import describe
import numpy as np
import pytest
import yaml

from ..reference import spatial_linkages, spatial_machines, spatial_maximal as twin
from ..reference.between import described
from ..reference.compare import assert_agree

FOUR_BAR = """\
name: four_bar
parameters: {crank: 0.1}
bodies:
  crank: {mass: 0.5, center_of_mass: [0.05, 0.0], inertia: 0.0004}
  coupler: {mass: 1.0, center_of_mass: [0.0, 0.0], inertia: 0.01}
  rocker: {mass: 0.8, center_of_mass: [0.125, 0.0], inertia: 0.004}
joints:
  crank_joint: {type: revolute, between: [ground, crank], points: [[0, 0], [0, 0]], actuated: true}
  coupler_joint: {type: revolute, between: [crank, coupler], points: [[crank, 0], [-0.175, 0]]}
  tip: {type: revolute, between: [coupler, rocker], points: [[0.175, 0], [0.25, 0]]}
  rocker_joint: {type: revolute, between: [ground, rocker], points: [[0.4, 0], [0, 0]]}
points:
  eye: {body: coupler, position: [0.0, 0.1]}
"""


def read(tmp_path, data):
    path = tmp_path / 'machine.yaml'
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False))
    return read_mechanism(path)


def centers(mechanism, torques):
    """Return what every body does at the start: spin's rate, acceleration of the centre."""
    tau, first = np.zeros(sum(twin.JOINT_FREEDOMS[j.type] for j in mechanism.joints)), 0
    for joint in mechanism.joints:
        tau[first] += torques.get(joint.name, 0.0)
        first += twin.JOINT_FREEDOMS[joint.type]
    q = np.concatenate([[0.0, 0.0, 0.0, 1.0] if joint.type == 'spherical' else np.zeros(
        twin.JOINT_FREEDOMS[joint.type]) for joint in mechanism.joints])
    found = twin.forward_dynamics(mechanism, q, 0.0 * tau, tau).accelerations
    bodies = sorted((body for body in mechanism.bodies if not body.massless), key=str)
    return {body.name: np.concatenate([
        found[body.name][:3],
        found[body.name][3:] + np.cross(found[body.name][:3], body.center_of_mass)])
        for body in bodies}


@pytest.mark.parametrize('name', [
    'rssr_four_bar', 'bricard', pytest.param('delta_robot', marks=pytest.mark.slow)])
def test_any_tree_gives_the_same_motion(tmp_path, name):
    machine, torques = getattr(spatial_machines, name)()
    expected = centers(machine, torques)
    chosen = read(tmp_path, described(machine))
    assert {joint.name for joint in chosen.joints} | set(chosen.tree.cut) == {
        joint.name for joint in (*machine.joints, *machine.cut_joints)}
    tried = 0
    for cut in chosen.tree.cut:
        for other in chosen.tree.open:
            try:
                tree = with_cuts(chosen, set(chosen.tree.cut) - {cut} | {other})
            except FieldError:
                # Universal and spherical joints cannot be turned round; others leave no tree.
                continue
            found = centers(tree, torques)
            for body, values in expected.items():
                assert_agree(found[body], values, 1e-9, smallest=1.0)
            tried += 1
    assert tried > 1


def test_a_joint_turned_round_keeps_its_coordinate(tmp_path):
    rng = np.random.default_rng(1)
    kinds = ['revolute', 'prismatic', 'helical', 'cylindrical'] * 2
    bodies, joints, data = [], [], {}
    for k, kind in enumerate(kinds):
        bodies.append(spatial_linkages.random_body(rng, f'body_{k}'))
        joint = spatial_linkages.random_joint(
            rng, f'joint_{k}', kind, f'body_{k - 1}' if k else 'ground', f'body_{k}')
        joints.append(joint)
        x, y, z, w = joint.orientation
        before = twin.matrix(joint.orientation)
        entry = {'type': kind}
        if joint.lead is not None:
            entry['lead'] = float(joint.lead)
        if k % 2:
            # The same from the other body: it turns the other way about the other's axis.
            entry.update(between=[joint.child, joint.parent],
                         points=[[0.0] * 3, [float(p) for p in joint.position]],
                         orientation={'quaternion': [float(-x), float(-y), float(-z), float(w)]},
                         axis=(-before @ joint.axis).tolist())
        else:
            entry.update(between=[joint.parent, joint.child],
                         points=[[float(p) for p in joint.position], [0.0] * 3],
                         orientation={'quaternion': [float(v) for v in joint.orientation]},
                         axis=[float(a) for a in joint.axis])
        data[joint.name] = entry
    tree = twin.Motion  # What is compared below.
    found = read(tmp_path, {'name': 'chain', 'joints': data, 'bodies': {body.name: {
        'mass': float(body.mass), 'center_of_mass': [float(c) for c in body.center_of_mass],
        'inertia': [float(i) for i in body.inertia]} for body in bodies}})
    assert found.tree.cut == ()
    given = replace(found, joints=tuple(joints))
    count = sum(twin.JOINT_FREEDOMS[joint.type] for joint in joints)
    q, qd = rng.normal(size=(2, count))
    expected, motions = (twin.forward(m, q, qd, 0.0 * qd)[0] for m in (given, found))
    for body in bodies:
        for one, other in zip(tree(*motions[body.name]), expected[body.name]):
            assert_agree(one, other, 1e-12, smallest=1.0)


def test_points_stay_where_they_are(tmp_path):
    machine, torques = spatial_machines.bricard()
    # Frames that lie elsewhere than at a joint.
    data = described(replace(machine, points=(Point('corner', 'rod_3', (0.0, 0.0, 1.0)),)))
    shift = np.array([0.3, -0.2, 0.1])
    for entry in data['joints'].values():
        for body, point in zip(entry['between'], entry['points']):
            if body == 'rod_3':
                point[:] = (point + shift).tolist()
    rod = data['bodies']['rod_3']
    rod['center_of_mass'] = (rod['center_of_mass'] + shift).tolist()
    data['points']['corner']['position'] = [0.3, -0.2, 1.1]
    found = read(tmp_path, data)
    expected = centers(machine, torques)
    for body, values in centers(found, torques).items():
        assert_agree(values, expected[body], 1e-9, smallest=1.0)
    motions = twin.forward(found, np.zeros(5), np.zeros(5), np.zeros(5))[0]
    point, = found.points
    assert_agree(motions['rod_3'].origin + motions['rod_3'].axes @ point.position,
                 (1.0, -1.0, 1.0), 1e-12)


def loaded_arm(directory, above, **load):
    """Return a scene of an arm on a hinge away from its origin, with a mass on it."""
    body = {'mass': 1.0, 'center_of_mass': [0.3, 0.1, *above],
            'inertia': [0.05, 0.05, 0.05] if above else 0.05}
    hinge = {'type': 'revolute', 'between': ['ground', 'arm'],
             'points': [[0.0, 0.0, *above], [0.3, 0.1, *above]]}
    if above:
        hinge['axis'] = [0.0, 0.0, 1.0]
    (directory / 'arm.yaml').write_text(yaml.safe_dump({
        'name': 'arm', 'bodies': {'arm': body}, 'joints': {'hinge': hinge}}))
    path = directory / 'scene.yaml'
    path.write_text(yaml.safe_dump({
        'mechanism': './arm.yaml', 'initial': {'position': {'hinge': 0.0}}, 'effects': {
            'gravity': {'type': 'gravity', 'acceleration': [0.0, -9.81, *above]},
            'load': {'type': 'payload', 'body': 'arm', 'mass': 2.0, **load}}}))
    return path


# Their lever about the hinge, where it is given and where it is left to be the body's origin.
@pytest.mark.parametrize('place, lever, square', [
    ([0.8, 0.2], 0.5, 0.26), (None, -0.3, 0.1)], ids=['given', 'origin'])
@pytest.mark.parametrize('above', [[], [0.0]], ids=['plane', 'space'])
def test_what_acts_on_a_body_stands_where_its_frame_was_described(
        tmp_path, above, place, lever, square):
    load = {} if place is None else {'position': [*place, *above]}
    found = Simulation.from_scene(loaded_arm(tmp_path, above, **load)).acceleration
    assert_agree(found, [-2.0 * 9.81 * lever / (0.05 + 2.0 * square)], 1e-12)


def test_a_place_in_space_is_none_in_the_plane(tmp_path):
    with pytest.raises(SceneError, match='effects.load.position: expected'):
        load_scene(loaded_arm(tmp_path, [], position=[0.8, 0.2, 0.0]))


def test_the_tree_of_fewest_operations_is_chosen_and_reported(tmp_path):
    (tmp_path / 'machine.yaml').write_text(FOUR_BAR)
    (tmp_path / 'scene.yaml').write_text(
        'mechanism: ./machine.yaml\ninitial: {position: {crank_joint: 1.0, coupler_joint: -0.5, '
        'tip: 0.4, rocker_joint: 1.7}}\neffects: {lamp: {type: payload, body: coupler, mass: 1, '
        'position: [0.1, 0.0]}}')
    scene = load_scene(tmp_path / 'scene.yaml')
    mechanism = scene.mechanism
    assert mechanism.tree.cut == ('tip',)
    assert [joint.name for joint in mechanism.joints] == [
        'crank_joint', 'coupler_joint', 'rocker_joint']
    # What is given in the body's frame is where it was, 0.1 m from its middle.
    assert scene.effects['lamp'].position == pytest.approx((0.275, 0.0))
    assert mechanism.points[0].position == pytest.approx((0.175, 0.1))
    assert scene.initial.position == (1.0, -0.5, 1.7)
    path = tmp_path / 'middle.yaml'
    path.write_text((tmp_path / 'scene.yaml').read_text().replace(', position: [0.1, 0.0]', ''))
    assert load_scene(path).effects['lamp'].position == (0.175, 0.0)
    assert load_scene(tmp_path / 'scene.yaml') == scene
    reported = describe(mechanism)
    assert 'Tree, chosen by the program\n  cut          tip\n' in reported
    # An order is obeyed.
    (tmp_path / 'machine.yaml').write_text(FOUR_BAR.replace(
        'points: [[0.4, 0], [0, 0]]', 'points: [[0.4, 0], [0, 0]], cut: true'))
    ordered = load_scene_or_mechanism(tmp_path / 'machine.yaml')
    assert ordered.tree.cut == ('rocker_joint',)
    assert 'saved' not in describe(ordered)
    # Another length changes nothing but numbers.
    other = with_parameters(mechanism, {'crank': 0.12})
    assert other.tree.cut == ('tip',) and other.joints[1].position == (0.12, 0.0)


SLIDES = """\
name: slides
bodies:
  table: {mass: 1.0, center_of_mass: [0, 0], inertia: 0.02}
  tool: {mass: 0.5, center_of_mass: [0, 0], inertia: 0.01}
joints:
  bed: {type: prismatic, between: [ground, table], points: [[0, 0], [0, 0]]}
  rail: {type: prismatic, between: [ground, table], points: [[0, 1], [0, 1]]}
  slope: {type: prismatic, between: [table, tool], points: [[0, 0], [0, 0]]}
  guide: {type: prismatic, between: [ground, tool], points: [[0, 0], [0, 0]]}
"""


@pytest.mark.parametrize('stabilisation', ['projection', 'none'])
@pytest.mark.parametrize('cut', ['', 'cut: true, '])
def test_slides_alone_close_loops_in_which_nothing_turns(tmp_path, cut, stabilisation):
    (tmp_path / 'machine.yaml').write_text(SLIDES.replace('guide: {', 'guide: {' + cut))
    path = tmp_path / 'scene.yaml'
    path.write_text(
        'mechanism: ./machine.yaml\ninitial: {position: {bed: 0.1, rail: 0.1, slope: 0.2, '
        'guide: 0.3}}\n'
        f'method: {{integrator: rk4, stabilisation: {stabilisation}}}\n'
        'effects: {gravity: {type: gravity, acceleration: [2.0, -9.81]}}')
    scene = load_scene(path)
    assert len(scene.mechanism.tree.cut) == 2
    assert not cut or 'guide' in scene.mechanism.tree.cut
    assert '2 = 2 joints - 0 independent equations (4 of 4 repeat others)' in describe(
        scene.mechanism)
    simulation = Simulation(scene)
    simulation.step(duration=0.1)
    assert simulation.acceleration == pytest.approx(
        [2.0 if name != 'slope' else 0.0 for name in simulation.joint_names])
    assert simulation.data.degrees_of_freedom() == 2


@pytest.mark.parametrize('changes, words', [
    ({'between: [crank, coupler]': 'between: [crank, cupler]'},
     ":9: joints.coupler_joint.between.1.: expected the name of a body: .*'cupler'"),
    ({'between: [crank, coupler]': 'between: [crank, crank]'}, '2 different bodies'),
    ({'points: [[0.175, 0], [0.25, 0]]': 'points: [[0.175, 0]]'},
     ':10: joints.tip.points: expected a list of 2 places'),
    ({'points: [[0.175, 0], [0.25, 0]]': 'points: [[0.175, 0], [0.25]]'},
     r':10: joints.tip.points\[1\]: expected a list of 2 finite numbers'),
    ({'type: revolute, between: [coupler': 'type: revolut, between: [coupler'},
     ':10: joints.tip.type: expected one of revolute, prismatic'),
    ({'[0, 0]]}': '[0, 0]], cut: true}', '[0.25, 0]]}': '[0.25, 0]], cut: true}'},
     'bodies.rocker: expected joints that lead to .ground., got none: the mechanism falls into'),
    ({'[0, 0]]}': '[0, 0]], cut: false}', '[0.25, 0]]}': '[0.25, 0]], cut: false}',
      '[-0.175, 0]]}': '[-0.175, 0]], cut: false}'},
     'joints.rocker_joint: expected a loop with a joint that may be cut, got one closed by rock'),
    ({'between: [ground, rocker], points: [[0.4, 0], [0, 0]]':
      'between: [rocker, ground], points: [[0, 0], [0.4, 0]]', '[0.25, 0]]}':
      '[0.25, 0]], cut: true}'}, 'joints.rocker_joint.between: expected joints of several'),
])
def test_what_leaves_no_tree_is_refused(tmp_path, changes, words):
    text = FOUR_BAR
    for old, new in changes.items():
        text = text.replace(old, new)
    with pytest.raises(MechanismError, match=words):
        read(tmp_path, text)


def test_what_is_held_is_not_cut_but_by_order(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text('mechanism: ./machine.yaml\ninitial: {position: {crank_joint: 1.0, tip: 1.1, '
                    'coupler_joint: -0.5, rocker_joint: 1.7}, hold: [tip]}')
    (tmp_path / 'machine.yaml').write_text(FOUR_BAR)
    assert 'tip' in load_scene(path).mechanism.joint_names
    (tmp_path / 'machine.yaml').write_text(
        FOUR_BAR.replace('[0.25, 0]]}', '[0.25, 0]], cut: true}'))
    with pytest.raises(SceneError, match='initial.hold.0.: expected one of the joints'):
        load_scene(path)


@pytest.mark.parametrize('name', ['bricard', 'excavator_arm'])
def test_shapes_stay_on_their_masses_when_frames_are_moved(name):
    for body in load_scene(name).mechanism.bodies:
        if len(body.visual) == 1:
            np.testing.assert_allclose(body.visual[0].center, body.center_of_mass, atol=1e-12)


@pytest.mark.parametrize('kind', ['point_on_line', 'distance'])
def test_what_only_closes_loops_is_sent_to_the_cut_joints(kind):
    with pytest.raises(MechanismError, match=f'got {kind}, which only closes a loop .it belongs '
                       'under cut_joints'):
        read_mechanism({
            'name': 'slotted', 'bodies': {'crank': {
                'mass': 1.0, 'center_of_mass': [0.0, 0.0], 'inertia': 0.1}},
            'joints': {'slot': {'type': kind, 'between': ['ground', 'crank'],
                                'points': [[0.0, 0.0], [0.0, 0.0]]}}})
