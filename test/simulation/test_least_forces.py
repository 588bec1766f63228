# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces that are not unique: those chosen do not depend on which joints are cut."""

from dataclasses import replace
from pathlib import Path

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.codegen.function_table import OF_FORCES, WRENCHES
from closedloop_dynamics.effects.registry import PointSpring, Rotor
from closedloop_dynamics.kinematics.modeling import extent
from closedloop_dynamics.mechanism.rotations import of_angles
import numpy as np
import pytest
import yaml

from ..reference.compare import assert_agree, SOLVE

CONFIG = Path(__file__).resolve().parents[2] / 'config'
DRY = {'type': 'joint_friction', 'friction_coefficient': 0.2, 'radius': 0.02}
pytestmark = pytest.mark.filterwarnings('ignore:.*not unique')


def rod(*to):
    return {'shape': {'rod': {'to': list(to), 'radius': 0.01}}, 'density': 2700}


def pin(*between, points):
    return {'type': 'revolute', 'between': list(between), 'points': points}


# A bar on three cranks of one length.
CRANKS = {
    'name': 'three_cranks',
    'bodies': {'left': rod(0, 0.3), 'middle': rod(0, 0.3), 'right': rod(0, 0.3),
               'bar': rod(1.0, 0)},
    'joints': {
        'left_pin': {**pin('ground', 'left', points=[[0, 0], [0, 0]]), 'actuated': True},
        'middle_pin': pin('ground', 'middle', points=[[0.5, 0], [0, 0]]),
        'right_pin': pin('ground', 'right', points=[[1, 0], [0, 0]]),
        'left_end': pin('left', 'bar', points=[[0, 0.3], [0, 0]]),
        'middle_end': pin('middle', 'bar', points=[[0, 0.3], [0.5, 0]]),
        'right_end': pin('right', 'bar', points=[[0, 0.3], [1, 0]])}}
# A block on two parallel rails, pushed by a connecting rod.
BLOCK = {
    'name': 'block_on_rails',
    'bodies': {'crank': rod(0.1, 0), 'rod': rod(0.3, 0), 'block': rod(0, 0.2)},
    'joints': {
        'crank_pin': {**pin('ground', 'crank', points=[[0, 0], [0, 0]]), 'actuated': True},
        'rod_pin': pin('crank', 'rod', points=[[0.1, 0], [0, 0]]),
        'block_pin': pin('rod', 'block', points=[[0.3, 0], [0, 0]]),
        'low': {'type': 'prismatic', 'between': ['ground', 'block'],
                'points': [[0, 0], [0, 0]], 'angle': 0},
        'high': {'type': 'prismatic', 'between': ['ground', 'block'],
                 'points': [[0.1, 0.2], [0.05, 0.2]], 'angle': 0}}}


def made(folder, mechanism, cuts, initial, gravity, friction_in, **method):
    """Return a simulation with some joints cut, and friction in one that follows its force."""
    mechanism = {**mechanism, 'joints': {
        name: {key: value for key, value in joint.items() if key != 'cut'}
        | ({'cut': True} if name in cuts else {}) for name, joint in mechanism['joints'].items()}}
    (folder / 'machine.yaml').write_text(yaml.safe_dump(mechanism, sort_keys=False))
    position = {name: value for name, value in initial['position'].items() if name not in cuts}
    (folder / 'scene.yaml').write_text(yaml.safe_dump({
        'mechanism': './machine.yaml', 'initial': {**initial, 'position': position},
        'effects': {'gravity': {'type': 'gravity', 'acceleration': gravity},
                    'dry': {**DRY, 'joint': friction_in}}}))
    return Simulation.from_scene(load_scene(folder / 'scene.yaml'), **method)


def sizes(simulation):
    """Return the size of the force in each joint [N], by name."""
    planar = simulation.mechanism.planar
    wrenches = [*simulation.joint_forces.array, *simulation.constraint_forces]
    joints = [*simulation.mechanism.joints, *simulation.mechanism.cut_joints]
    return {joint.name: np.linalg.norm(wrench[1 if planar else 3:])
            for joint, wrench in zip(joints, wrenches)}


def bennett():
    """Return Bennett's linkage as its scene starts, with frames along the world's axes there."""
    lengths, twists = (0.25, 0.25 * 3 ** 0.5) * 2, (np.pi / 6, np.pi / 3) * 2
    turned, place, places, axes = np.eye(3), np.zeros(3), [], []
    for angle, length, twist in zip(
            (*Simulation.from_scene('bennett').position, 0.0), lengths, twists):
        places.append(place)
        axes.append(turned[:, 2].tolist())
        turned = turned @ of_angles((0.0, 0.0, angle))
        place = place + length * turned[:, 0]
        turned = turned @ of_angles((twist, 0.0, 0.0))
    links = [(places[n + 1] - places[n]).tolist() for n in range(3)]
    bodies = dict(zip(('crank', 'coupler', 'rocker'), (rod(*link) for link in links)))
    ring = list(zip(('ground', 'crank', 'coupler'), bodies, ([0, 0, 0], *links)))
    ring.append(('ground', 'rocker', places[3].tolist()))
    return {'name': 'bennett_ring', 'bodies': bodies, 'joints': {
        f'joint_{n}': {**pin(one, other, points=[point, links[2] if n == 4 else [0, 0, 0]]),
                       'axis': axis, 'actuated': n == 1}
        for n, ((one, other, point), axis) in enumerate(zip(ring, axes), 1)}}


BRICARD = yaml.safe_load((CONFIG / 'mechanisms' / 'bricard.yaml').read_text())
CASES = {
    'bennett': (
        bennett(), [(f'joint_{n}',) for n in (1, 2, 3, 4)],
        {'position': {f'joint_{n}': 0.0 for n in range(1, 5)}}, [0.0, 0.0, -9.81], 'joint_2'),
    'bricard': (
        BRICARD, [(f'joint_{n}',) for n in (2, 3, 4, 5, 6)],
        {'position': {f'joint_{n}': 0.0 for n in range(1, 7)}, 'hold': ['joint_1']},
        [0.0, -9.81, 0.0], 'joint_3'),
    'three_cranks': (
        CRANKS, [('middle_end', 'right_end'), ('left_end', 'right_end'),
                 ('left_end', 'middle_end')],
        {'position': {name: 0.6 if name.endswith('pin') else -0.6 for name in CRANKS['joints']},
         'hold': ['left_pin']},
        [0.0, -9.81], 'left_end'),
    'block_on_rails': (
        BLOCK, [('block_pin', 'high'), ('low', 'high'), ('block_pin', 'low')],
        {'position': {'crank_pin': 1.0, 'rod_pin': -1.3, 'block_pin': 0.3, 'low': 0.35,
                      'high': 0.3}, 'hold': ['crank_pin']},
        [0.0, -9.81], 'low')}


@pytest.mark.parametrize('name', [
    pytest.param(name, marks=pytest.mark.slow) if name == 'bricard' else name for name in CASES])
def test_forces_and_friction_do_not_depend_on_the_cut(tmp_path, name):
    mechanism, choices, *how = CASES[name]
    found = []
    for cuts in choices:
        one = made(tmp_path, mechanism, cuts, *how, integrator='rk4', step_size=5e-4)
        assert one.data.has_redundant_constraints
        start = sizes(one)
        one.step({}, 0.1)
        readings = one.effect_readings('dry')
        assert readings['dissipated_energy'] > 1e-6
        end = sizes(one)
        # The friction follows the very force that is given.
        assert readings['reaction'] == pytest.approx(end[how[-1]], rel=1e-3)
        found.append([*(start[joint] for joint in sorted(start)),
                      *(end[joint] for joint in sorted(end)), readings['dissipated_energy']])
    np.testing.assert_allclose(found, np.broadcast_to(found[0], np.shape(found)), rtol=1e-9)


def test_alike_cranks_share_a_load_alike(tmp_path):
    mechanism, choices, initial, gravity, friction = CASES['three_cranks']
    upright = {'position': dict.fromkeys(initial['position'], 0.0), 'hold': ['left_pin']}
    for cuts in choices:
        one = made(tmp_path, mechanism, cuts, upright, gravity, friction, integrator='rk4')
        force = sizes(one)
        weight = 9.81 * next(body.mass for body in one.mechanism.bodies if body.name == 'bar')
        ends = [force[f'{side}_end'] for side in ('left', 'middle', 'right')]
        assert sum(ends) == pytest.approx(weight, rel=1e-9)
        # The load is in the middle, from where the bar does not turn: thirds are the least.
        assert ends == pytest.approx([weight / 3] * 3, rel=1e-9)


# Bricard's linkage as it starts: where its pins are, and their axes.
PINS = {'joint_1': ((0, 0, 0), (0, 1, 0)), 'joint_2': ((1, 0, 0), (0, 0, 1)),
        'joint_3': ((1, -1, 0), (1, 0, 0)), 'joint_4': ((1, -1, 1), (0, 1, 0)),
        'joint_5': ((0, -1, 1), (0, 0, 1)), 'joint_6': ((0, 0, 1), (1, 0, 0))}


def test_forces_are_least_in_all_joints_together(tmp_path):
    mechanism, choices, *how = CASES['bricard']
    one = made(tmp_path, mechanism, ('joint_4',), *how, integrator='rk4')
    # Along the loop each joint hands on what the body before exerts on the next one.
    wrenches = dict(one.joint_forces)
    wrenches |= {name: -wrenches[name] for name in ('joint_5', 'joint_6')}
    assert one.mechanism.cut_joints[0].body_b == 'rod_3'
    wrenches['joint_4'] = one.constraint_forces[0]
    # The wrench that may go round the loop: it does no work at any pin.
    work = [[*axis, *np.cross(place, axis)] for place, axis in PINS.values()]
    _, singular, right = np.linalg.svd(work)
    assert singular[4] > 0.1 and singular[5] < 1e-12
    moment, force = right[5, :3], right[5, 3:]
    # A sum of squares is least where no share of it changes the sum.
    size = extent(one.mechanism)
    terms = [wrenches[name][3:] @ force
             + wrenches[name][:3] @ (moment - np.cross(place, force)) / size ** 2
             for name, (place, _) in PINS.items()]
    assert abs(sum(terms)) < 1e-9 * np.abs(terms).max()


@pytest.mark.parametrize('name, joint', [
    ('bennett', 'joint_2'), ('rssr_four_bar', 'rocker'),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('bricard', 'joint_2'), ('excavator_arm', 'stick_pin'), ('delta_robot', 'hip_1')))])
def test_routines_find_the_forces_that_loops_over_bodies_do(name, joint):
    scene, rng = load_scene(name), np.random.default_rng(3)
    scene = replace(scene, effects={
        **scene.effects, 'rotor': Rotor(joint, 1e-3, 20.0),
        'spring': PointSpring(scene.mechanism.points[0].name, None, (0.1, 0.2, 0.3), 200.0)})
    for one in (Simulation(scene), Simulation(replace(scene, effects={}))):
        own, by_loops = one.position, Simulation(one.scene)
        assert one.data.system.table[WRENCHES]
        by_loops.data.system.table[list(OF_FORCES)] = 0
        for _ in range(3):
            one.set_state(one.coordinates.moved(own, rng.uniform(-0.05, 0.05, one.coordinates.nv)),
                          rng.uniform(-1.0, 1.0, one.coordinates.nv))
            by_loops.set_state(one.position, one.velocity)
            torque = rng.normal(0.0, 1.0, len(one.actuated_joints))
            found, expected = (each.forward_dynamics(one.position, one.velocity, torque)
                               for each in (one, by_loops))
            assert_agree(found[1], expected[1], SOLVE)
            one.step(torque, 0.0)
            by_loops.step(torque, 0.0)
            assert_agree(one.joint_forces, by_loops.joint_forces, SOLVE)
