# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Rods without mass, points on lines and planes, threads, gears: against what they stand for."""

from dataclasses import replace
from functools import partial

from closedloop_dynamics import (
    AssemblyError, Body, Coupling, CutJoint, Joint, Mechanism, MechanismError, Method, Point,
    Simulation)
from closedloop_dynamics.effects.registry import Gravity
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.recording.run import columns, row
from closedloop_dynamics.scene.key_paths import changed, numbers
from closedloop_dynamics.scene.text import read_scene_text, scene_text
from closedloop_dynamics.studies.check import describe
import numpy as np
import pytest

from ..reference import scenes, spatial_machines
from ..reference.compare import assert_agree
from ..reference.loop_closure import closure

GRAVITY = {'gravity': Gravity(spatial_machines.GRAVITY)}
TIGHT = Method(integrator='dop853', tolerance=1e-12)
X, Y, Z = (tuple(map(float, axis)) for axis in np.eye(3))
NOWHERE = (0.0, 0.0, 0.0)
MATTER = {'inertia': (0.02, 0.03, 0.04)}


scene = partial(scenes.scene, effects=GRAVITY, method=TIGHT)


def gliding(name, body, place=NOWHERE, turning=True):
    """Return bodies and joints that let a body move in all ways, or without turning."""
    steps = [(f'{name}_{axis}', 'prismatic', along) for axis, along in zip('xyz', (X, Y, Z))]
    steps += [(f'{name}_{kind}', 'revolute', along)
              for kind, along in zip(('yaw', 'pitch', 'roll'), (Z, Y, X))] * turning
    bodies, joints, parent = [], [], 'ground'
    for k, (joint, kind, axis) in enumerate(steps):
        child = body.name if k == len(steps) - 1 else f'{joint}_carrier'
        bodies.append(body if child == body.name else Body(
            child, 0.0, NOWHERE, 0.0, massless=True))
        joints.append(Joint(joint, kind, parent, child, place if k == 0 else NOWHERE, axis=axis))
        parent = child
    return tuple(bodies), tuple(joints)


def with_points(body, points):
    """Return a body with point masses [(mass, place), ...] on it."""
    masses = np.array([body.mass, *(mass for mass, _ in points)])
    places = np.array([body.center_of_mass, *(place for _, place in points)], dtype=float)
    center = masses @ places / masses.sum()
    values = np.zeros(6)
    values[:len(body.inertia)] = body.inertia
    about = values[[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3)
    for mass, arm in zip(masses, places - center):
        about = about + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Body(body.name, masses.sum(), tuple(center),
                tuple(about[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))


@pytest.mark.slow
def test_a_delta_robot_with_distances_is_one_with_rods_of_two_points():
    machine, torques = spatial_machines.delta_robot()
    joints = {joint.name: joint for joint in machine.joints}
    cuts = {cut.name: cut for cut in machine.cut_joints}
    bodies = {body.name: body for body in machine.bodies}
    wrists = {name[-2:]: cut.point_a for name, cut in cuts.items()}
    wrists['11'] = NOWHERE
    # Half a rod's mass at either end.
    ends = {}
    for name in wrists:
        body, place = bodies[f'rod_{name}'], joints[f'elbow_{name}'].position
        along = 2.0 * np.array(body.center_of_mass)
        about = 0.25 * body.mass * (along @ along * np.eye(3) - np.outer(along, along))
        bodies[f'rod_{name}'] = replace(
            body, inertia=tuple(about[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
        ends.setdefault(f'arm_{name[0]}', []).append((0.5 * body.mass, place))
        ends.setdefault('platform', []).append((0.5 * body.mass, wrists[name]))
    center = Point('center', 'platform', bodies['platform'].center_of_mass)
    rods = spatial_machines.with_single_freedoms(
        replace(machine, bodies=tuple(bodies.values()), points=(center,)))

    arms = [with_points(bodies[f'arm_{k}'], ends[f'arm_{k}']) for k in (1, 2, 3)]
    start = np.array(joints['hip_1'].position) + joints['elbow_11'].position + joints[
        'wrist_11'].position
    gliders, glides = gliding('platform', with_points(bodies['platform'], ends['platform']),
                              tuple(start))
    light = Mechanism(
        'light_delta', (*arms, *gliders), (*(joints[f'hip_{k}'] for k in (1, 2, 3)), *glides),
        tuple(CutJoint(f'rod_{name}', 'distance', 'platform', f'arm_{name[0]}', wrist,
                       joints[f'elbow_{name}'].position, length=0.8)
              for name, wrist in wrists.items()), (center,))
    one, other = Simulation(scene(rods)), Simulation(scene(light))
    assert other.data.degrees_of_freedom() == 3 and len(other.multipliers) == 6
    start = other.energy
    for _ in range(3):
        one.step(torques, 0.1)
        other.step(torques, 0.1)
        assert_agree(other.points, one.points, 1e-9)
        assert_agree(other.position[:3], [one.position[one.joint_names.index(f'hip_{k}')]
                                          for k in (1, 2, 3)], 1e-9)
        # A rod pulls or pushes along itself: no moment about its end.
        assert_agree(other.constraint_forces[:, :3], np.zeros((6, 3)), 1e-12, smallest=1.0)
    assert_agree(other.energy - start, np.array([0.5, 0.0, -0.5]) @ other.position[:3], 1e-8)
    assert other.closure < 1e-12
    assert 'force.rod_11.z' in columns(other) and 'force.rod_11.torque_x' not in columns(other)


def test_a_point_at_a_distance_is_a_spherical_pendulum():
    bob = Body('bob', 2.0, NOWHERE, (1e-3, 1e-3, 1e-3))
    bodies, joints = gliding('bob', bob, turning=False)
    rod = CutJoint('rod', 'distance', 'bob', 'ground', NOWHERE, NOWHERE, length=0.5)
    points = (Point('middle', 'bob', NOWHERE),)
    one = Simulation(scene(Mechanism('pendulum', bodies, joints, (rod,), points),
                           [0.3, 0.0, -0.4], [0.0, 1.0, 0.0]))
    # In a plane through its pivot: a conical pendulum, and the tension of the rod.
    force = np.linalg.norm(one.constraint_forces[0, 3:])
    assert_agree(force, 2.0 * (9.81 * 0.8 + 1.0 / 0.5), 1e-12)
    # The multiplier pushes the points apart.
    assert_agree(one.multipliers, [-force], 1e-12)
    arm = Body('arm', 2.0, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    turn = Body('turn', 0.0, NOWHERE, 0.0, massless=True)
    pivot = (Joint('yaw', 'revolute', 'ground', 'turn', NOWHERE, axis=Z),
             Joint('pitch', 'revolute', 'turn', 'arm', NOWHERE, axis=Y))
    other = Simulation(scene(
        Mechanism('arm', (turn, arm), pivot, (), (Point('middle', 'arm', (0.5, 0.0, 0.0)),)),
        [0.0, np.arctan2(0.4, 0.3)], [1.0 / 0.3, 0.0]))
    for _ in range(4):
        one.step(None, 0.3)
        other.step(None, 0.3)
        assert_agree(one.points, other.points, 1e-9)


def test_points_on_a_line_and_on_a_plane_slide_down():
    bodies, joints = gliding('bead', Body('bead', 1.5, NOWHERE, (1e-3, 1e-3, 1e-3)), turning=False)
    down = np.array([0.6, 0.0, -0.8])
    for kind, axis, steep in (('point_on_line', tuple(down), down),
                              ('point_on_plane', (0.8, 0.0, 0.6), down)):
        cut = CutJoint('wire', kind, 'bead', 'ground', NOWHERE, (0.1, 0.2, 0.3), axis_b=axis)
        one = Simulation(scene(Mechanism('bead', bodies, joints, (cut,)), [0.1, 0.2, 0.3]))
        one.step(None, 0.5)
        assert_agree(one.position, np.array([0.1, 0.2, 0.3]) + 0.5 * 9.81 * 0.8 * 0.25 * steep,
                     1e-11)
        normal = one.constraint_forces[0, 3:]
        assert_agree(normal, 1.5 * 9.81 * 0.6 * np.array([0.8, 0.0, 0.6]), 1e-10)


def screw(kind):
    """Return a nut that turns and slides along an oblique axis, held in one of three ways."""
    axis = (0.48, 0.6, 0.64)
    nut = Body('nut', 2.0, NOWHERE, **MATTER)
    if kind == 'tree':
        return Mechanism('screw', (nut,), (
            Joint('nut', 'helical', 'ground', 'nut', NOWHERE, axis=axis, lead=0.02),))
    carrier = Body('carrier', 0.0, NOWHERE, 0.0, massless=True)
    joints = (Joint('turn', 'revolute', 'ground', 'carrier', NOWHERE, axis=axis),
              Joint('slide', 'prismatic', 'carrier', 'nut', NOWHERE, axis=axis))
    if kind == 'coupling':
        return Mechanism('screw', (carrier, nut), joints, couplings=(
            Coupling('thread', {'slide': 1.0, 'turn': -0.02}),))
    return Mechanism('screw', (carrier, nut), joints, (
        CutJoint('thread', 'helical', 'nut', 'ground', NOWHERE, NOWHERE, axis_b=axis, lead=0.02),))


def test_a_thread_is_the_same_as_a_joint_a_coupling_and_a_cut():
    found = []
    for kind in ('tree', 'coupling', 'cut'):
        one = Simulation(scene(screw(kind)))
        one.step(None, 5.0)
        found.append((one.position[0], one.velocity[0], one.acceleration[0]))
    # Many turns.
    assert abs(found[0][0]) > 10.0 * np.pi
    assert_agree(found[1], found[0], 1e-9)
    assert_agree(found[2], found[0], 1e-9)


def wheel_on(machine, cut):
    """Return a machine with a wheel that the coordinate of a cut joint turns."""
    nowhere = (0.0, 0.0) if machine.planar else NOWHERE
    return replace(
        machine, bodies=(*machine.bodies, Body('wheel', 1.0, nowhere, (
            0.01 if machine.planar else MATTER['inertia']))),
        joints=(*machine.joints, Joint('wheel', 'revolute', 'ground', 'wheel', nowhere,
                                       axis=None if machine.planar else X)),
        couplings=(Coupling('gear', {cut: 3.0, 'wheel': 0.5}, 0.2),))


def slider_crank():
    """Return a slider-crank whose block is cut off an oblique guide."""
    names = 'crank', 'rod', 'block'
    return Mechanism(
        'slider_crank', tuple(Body(name, 1.0, (0.05, 0.0), 0.01) for name in names),
        tuple(Joint(name, 'revolute', parent, name, (place, 0.0)) for name, parent, place in zip(
            names, ('ground', *names), (0.0, 0.1, 0.3))),
        (CutJoint('guide', 'prismatic', 'block', 'ground', (0.0, 0.0), (0.05, 0.02), angle=0.4),))


@pytest.mark.parametrize('machine, cut, start', [
    (screw('cut'), 'thread', [0.3, 0.006, -1.4]),
    (slider_crank(), 'guide', [0.9, -0.7, 0.2, -1.5])], ids=['thread', 'slide'])
def test_files_are_closed_where_the_engine_closes_a_coupled_cut_joint(machine, cut, start):
    machine, down = wheel_on(machine, cut), (0.0, -9.81)
    effects = {'gravity': Gravity(down)} if machine.planar else GRAVITY
    one = Simulation(scene(machine, start, effects=effects))
    one.step(None, 0.5)
    assert abs(one.velocity[-1]) > 0.05
    apart = one.position + [[0.0] * len(start), [0.0] * (len(start) - 1) + [0.1]]
    # The wheel's share of the sum alone.
    assert_agree(closure(machine, apart), [0.0, 0.05], 1e-10)


def gears(offset=0.0, factor=-2.0):
    """Return two wheels that turn together, a pinion of which drives a rack."""
    bodies = (Body('a', 1.0, NOWHERE, **MATTER), Body('b', 1.0, NOWHERE, **MATTER),
              Body('rack', 3.0, NOWHERE, **MATTER))
    joints = (
        Joint('a', 'revolute', 'ground', 'a', NOWHERE, axis=Z, actuated=True),
        Joint('b', 'revolute', 'ground', 'b', X, axis=X),
        Joint('rack', 'prismatic', 'ground', 'rack', Y, axis=Y))
    return Mechanism('gears', bodies, joints, couplings=(
        Coupling('mesh', {'a': 1.0, 'b': factor}, offset),
        Coupling('pinion', {'rack': 1.0, 'b': -0.1})))


def test_gears_share_torque_by_their_ratio():
    one = Simulation(scene(gears(), effects={}))
    one.step({'a': 0.5}, 1.0)
    # Of the wheel b, about its x axis, and of the rack 0.1 m from it, seen at a.
    inertia = 0.04 + (0.02 + 3.0 * 0.1 ** 2) / 4.0
    assert_agree(one.acceleration, 0.5 / inertia * np.array([1.0, 0.5, 0.05]), 1e-12)
    assert_agree(one.position, 0.25 / inertia * np.array([1.0, 0.5, 0.05]), 1e-10)
    mesh, pinion = one.coupling_forces
    assert_agree(pinion, 3.0 * one.acceleration[2], 1e-12)
    assert_agree(0.5 + mesh, 0.04 * one.acceleration[0], 1e-12)
    assert_agree(-2.0 * mesh - 0.1 * pinion, 0.02 * one.acceleration[1], 1e-12)
    assert one.constraint_forces.shape == (0, 6)
    values = dict(zip(columns(one), row(one, 1.0)))
    assert (values['coupling.mesh'], values['coupling.pinion']) == (mesh, pinion)
    assert one.data.degrees_of_freedom() == 1 and one.closure < 1e-12


def test_light_wheels_turn_with_heavy_ones():
    # Without inertia of its own; then refinement finds the motion.
    machine = gears()
    bodies = (machine.bodies[0], Body('b', 0.0, NOWHERE, 0.0, massless=True), machine.bodies[2])
    one = Simulation(scene(replace(machine, bodies=bodies), effects={}))
    one.step({'a': 0.5}, 0.5)
    assert_agree(one.acceleration, 0.5 / (0.04 + 0.03 / 4.0) * np.array([1.0, 0.5, 0.05]), 1e-10)


def test_offsets_and_factors_are_numbers_like_others():
    start = scene(gears(0.3), [0.1, -0.1, -0.01])
    assert Simulation(start).closure < 1e-12
    found = numbers(start)
    assert found['mechanism.couplings.mesh.offset'] == 0.3
    other = changed(start, {('mechanism', 'couplings', 'mesh', 'joints', 'b'): -4.0})
    assert other.mechanism.couplings[0].joints == {'a': 1.0, 'b': -4.0}
    again, _ = read_scene_text(scene_text(other))
    assert again.mechanism == other.mechanism
    reported = describe(other)
    assert 'Couplings: 2' in reported and 'a 1, b -4' in reported
    assert 'constraint equations  2' in reported


def test_what_is_no_coupling_or_cut_is_refused():
    machine = gears()

    def refused(words, **changes):
        with pytest.raises(MechanismError, match=words):
            validate_mechanism(replace(machine, **changes))

    refused('couplings.c.joints.d: expected one of the joints a, b, rack',
            couplings=(Coupling('c', {'d': 1.0}),))
    refused('couplings.c.joints.a: expected a number that is not zero',
            couplings=(Coupling('c', {'a': 0.0}),))
    refused('couplings.c.joints: expected at least one joint', couplings=(Coupling('c', {}),))
    refused('couplings.a: expected a name that is not used in joints',
            couplings=(Coupling('a', {'a': 1.0}),))
    ball = replace(machine.joints[1], type='universal', second_axis=Y)
    refused('couplings.mesh.joints.b: expected a joint of one degree of freedom: .* one that is '
            'universal',
            joints=(machine.joints[0], ball, machine.joints[2]))
    for words, keys in (
            ('length: expected this key of a distance joint, got none', {}),
            ('length: expected a positive number, got 0', {'length': 0.0}),
            ('lead: expected no such key of a distance joint', {'length': 1.0, 'lead': 1.0}),
            ('axis_b: expected no such key of a distance', {'length': 1.0, 'axis_b': X})):
        refused(f'cut_joints.cut.{words}', cut_joints=(
            CutJoint('cut', 'distance', 'a', 'b', NOWHERE, NOWHERE, **keys),))
    refused('cut_joints.cut.lead: expected a number that is not zero', cut_joints=(CutJoint(
        'cut', 'helical', 'a', 'b', NOWHERE, NOWHERE, axis_b=X, lead=0.0),))
    plane = Mechanism(
        'plane', (Body('a', 1.0, (0.0, 0.0), 1.0),),
        (Joint('a', 'revolute', 'ground', 'a', (0.0, 0.0)),), cut_joints=(
            CutJoint('c', 'helical', 'a', 'ground', (0.0, 0.0), (1.0, 0.0)),))
    with pytest.raises(MechanismError, match='cut_joints.c.type: expected one of revolute, '):
        validate_mechanism(plane)


def test_a_coupling_that_cannot_hold_is_named():
    machine = gears()
    locked = (*machine.couplings, Coupling('lock', {'rack': 1.0, 'b': -0.1}, 0.5))
    with pytest.raises((AssemblyError, FieldError), match='couplings.(lock|pinion) open by'):
        Simulation(scene(replace(machine, couplings=locked)))
