# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms in space, simulated: known motions, and clear words on what cannot be had yet."""

import ctypes
from dataclasses import replace

from closedloop_dynamics import (
    Body, codegen, CutJoint, Joint, load_scene, Mechanism, Method, Point, Simulation)
from closedloop_dynamics.codegen import function_table as calls
from closedloop_dynamics.effects.registry import Gravity, JointDamping, Payload
from closedloop_dynamics.engine.types import RANK_REVEALING_COUNT
from closedloop_dynamics.kinematics.loop_model import independent
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.kinematics import body_poses
from closedloop_dynamics.recording.run import columns, Report, row, run
from closedloop_dynamics.scene.integrators import PROJECTION
from closedloop_dynamics.scene.text import read_scene_text, scene_text
from closedloop_dynamics.studies.check import describe
import numpy as np
import pytest

from ..reference import spatial_machines, spatial_maximal as twin
from ..reference.compare import assert_agree
from ..reference.formulations import dense_dynamics, FORMULATIONS
from ..reference.scenes import scene_in_space as scene

# Of a quaternion; about no axis of the world.
TURN = tuple(np.array([0.1, 0.2, 0.3, 0.9]) / np.linalg.norm([0.1, 0.2, 0.3, 0.9]))
TIGHT = {'integrator': 'dop853', 'tolerance': 1e-12}


def machine(name, *points):
    """Return a machine with joints of one degree of freedom in its tree, and its forces."""
    mechanism, forces = getattr(spatial_machines, name)()
    mechanism = spatial_machines.with_single_freedoms(mechanism)
    return replace(mechanism, points=tuple(
        Point(f'point_{k}', body, tuple(place)) for k, (body, place) in enumerate(points))), forces


@pytest.fixture(scope='module')
def linkage():
    """Return an RSSR four-bar with the middle of its rocker, and the crank's torque."""
    return machine('rssr_four_bar', ('rocker', (0.0, 0.0, 0.15)))


def test_bricards_linkage_moves_though_an_equation_repeats_the_others():
    mechanism, _ = machine('bricard', ('rod_3', (0.0, 0.0, 1.0)))
    one = Simulation(scene(mechanism, gravity=(0.0, -9.81, 0.0), **TIGHT))
    assert one.data.degrees_of_freedom() == 1
    one.step(None, 1.0)
    assert_agree(one.points[0], (0.5105014612, -1.6491675994, 0.1401231146), 1e-9)
    assert_agree(one.energy, -29.43, 1e-10)
    # The equation that was left out holds, and the others were enough.
    assert len(one.data.system.lam) == 4
    assert one.closure < 1e-10
    assert one.data.system.work.health[RANK_REVEALING_COUNT] == 0.0
    # Nearly periodic.
    one.step(None, 9.0)
    assert one.closure < 1e-10
    assert_agree(one.energy, -29.43, 1e-9)


def tilted_four_bar(turn):
    """Return a four-bar with pins of five equations in a plane that is turned, and its parts."""
    planar = load_scene('four_bar')
    axes = twin.matrix(turn)
    bodies = tuple(
        Body(body.name, body.mass, (*body.center_of_mass, 0.0),
             (0.5 * body.inertia, 0.5 * body.inertia, body.inertia))
        for body in planar.mechanism.bodies)
    joints = tuple(
        Joint(joint.name, 'revolute', joint.parent, joint.child,
              tuple(axes @ (*joint.position, 0.0)) if joint.parent == 'ground' else (
                  *joint.position, 0.0),
              actuated=joint.actuated, axis=(0.0, 0.0, 1.0),
              orientation=turn if joint.parent == 'ground' else (0.0, 0.0, 0.0, 1.0))
        for joint in planar.mechanism.joints)
    cuts = tuple(
        CutJoint(cut.name, 'revolute', cut.body_a, cut.body_b, (*cut.point_a, 0.0),
                 (*cut.point_b, 0.0), axis_a=(0.0, 0.0, 1.0), axis_b=(0.0, 0.0, 1.0))
        for cut in planar.mechanism.cut_joints)
    return planar, Mechanism('tilted', bodies, joints, cuts), axes


def test_a_tilted_four_bar_moves_as_the_planar_one():
    # A plane along no axis: three of the pin's five equations repeat others, unseen by structure.
    planar, tilted, axes = tilted_four_bar(TURN)
    gravity = (0.3, -9.81)
    method = Method(**TIGHT)
    flat = Simulation(replace(planar, effects={'gravity': Gravity(gravity)}, method=method))
    one = Simulation(replace(
        scene(tilted, gravity=axes @ (*gravity, 0.0), method=method), initial=planar.initial))
    assert len(one.data.system.lam) == 2
    for _ in range(3):
        flat.step(None, 0.2)
        one.step(None, 0.2)
        assert_agree(one.position, flat.position, 1e-9)
        # The least forces that give the motion lie in the plane, without moments.
        moment, *force = flat.constraint_forces[0]
        assert_agree(one.constraint_forces[0, 3:], axes @ (*force, 0.0), 1e-7)
        assert_agree(one.constraint_forces[0, :3], np.zeros(3), 1e-7, smallest=1.0)


def test_rounding_errors_of_a_jacobian_are_no_equations():
    rng = np.random.default_rng(0)
    jac = rng.normal(size=(3, 5))
    # Another unit of a coordinate and of an equation, an equation that repeats two others.
    jac *= 10.0 ** np.array([0.0, -3.0, 3.0, 0.0, 2.0])
    whole = np.array([jac[0], 1e-3 * jac[1], jac[0] - jac[1], jac[2], np.zeros(5)])
    whole[:, 3] = 0.0
    noise = 1e-16 * rng.normal(size=whole.shape) * np.abs(whole).max(axis=0)
    noise[:, 3] = 1e-17
    for error in (0.0, noise, -noise):
        kept, _ = independent(whole + error, np.arange(5))
        assert kept.sum() == 3 and kept[3] and not kept[4]


def without_success(table, place):
    """Replace a routine by one that does the same and calls it bad; return it, to be kept."""
    routine = ctypes.CFUNCTYPE(ctypes.c_int64, *3 * [ctypes.c_void_p])
    address = int(table[place])
    bad = routine(lambda *arguments: (routine(address)(*arguments) if address else 0) * 0)
    table[place] = ctypes.cast(bad, ctypes.c_void_p).value
    return bad


def test_what_stands_in_for_the_elimination_gives_the_same(linkage):
    mechanism, torque = linkage
    one = Simulation(scene(mechanism))
    one.step(torque, 0.2)
    expected, forces, system = one.acceleration, one.multipliers, one.data.system
    q, qd = one.position, one.velocity
    opened = np.concatenate([q + 1e-6, qd + 1e-3])
    closed = opened.copy()
    assert system.native.stabilise(PROJECTION, closed)
    kept = [without_success(system.table, place) for place in (
        calls.EVALUATION, calls.ACCELERATION, calls.REFINED_ACCELERATION,
        calls.CORRECTION, calls.REFINED_CORRECTION)]
    before = system.work.health[RANK_REVEALING_COUNT]
    system.native.evaluate(q, qd)
    assert system.work.health[RANK_REVEALING_COUNT] == before + 1
    assert_agree(system.qdd, expected, 1e-10)
    assert_agree(system.lam, forces, 1e-10)
    # Corrections take away what opens the loops.
    assert system.native.stabilise(PROJECTION, opened)
    assert_agree(opened, closed, 1e-9)
    assert len(kept) == 5


def test_steps_of_fixed_size_and_of_the_default_method_agree(linkage):
    mechanism, torque = linkage
    ends = []
    for method in ({'integrator': 'rk4', 'step_size': 5e-4}, {}):
        one = Simulation(scene(mechanism, **method))
        one.step(torque, 0.3)
        assert one.closure < 1e-12
        ends.append(one.position)
    # Both keep an error of 1e-6.
    assert_agree(*ends, 1e-6)


@pytest.mark.parametrize('name', ['rssr_four_bar', 'bricard', 'tilted'])
def test_poses_of_bodies_are_where_their_points_are(name):
    mechanism = tilted_four_bar(TURN)[1] if name == 'tilted' else machine(name)[0]
    start = load_scene('four_bar').initial if name == 'tilted' else None
    marks = [(0.0, 0.0, 0.0), *np.eye(3).tolist()]
    mechanism = replace(mechanism, points=tuple(
        Point(f'{body.name}_{k}', body.name, tuple(place))
        for body in mechanism.bodies for k, place in enumerate(marks)))
    made = scene(mechanism, gravity=(0.0, -9.81, 0.0))
    one = Simulation(replace(made, initial=start or made.initial))
    one.step(None, 0.3)
    assert one.body_poses.shape == (len(mechanism.bodies), 7)
    assert_agree(body_poses(mechanism, one.position)[:, :3], one.body_poses[:, :3], 1e-13)
    places = one.points.reshape(-1, 4, 3)
    for pose, (origin, *ends) in zip(one.body_poses, places):
        assert_agree(pose[:3], origin, 1e-14)
        assert_agree(twin.matrix(pose[3:]), (np.array(ends) - origin).T, 1e-14)
        assert_agree(np.linalg.norm(pose[3:]), 1.0, 1e-15)


def test_health_in_space_is_that_in_the_plane():
    planar, lifted, _ = tilted_four_bar((0.0, 0.0, 0.0, 1.0))
    gravity = (0.3, -9.81)
    flat = Simulation(replace(planar, effects={'gravity': Gravity(gravity)}))
    one = Simulation(replace(scene(lifted, gravity=(*gravity, 0.0)), initial=planar.initial))
    for each in (flat, one):
        each.step(None, 0.2)
    assert one.health.unique_forces and not one.health.near_singular
    for key in ('smallest_pivot', 'condition'):
        assert_agree(getattr(one.health, key), getattr(flat.health, key), 1e-6)
    assert (one.health.rank, one.health.equations) == (2, 2)
    # In space the joints' angles count, in the plane the bodies'.
    assert 0.2 < one.health.drive_sine / flat.health.drive_sine < 5.0


def test_health_tells_of_equations_that_repeat_others():
    mechanism, _ = machine('bricard')
    one = Simulation(scene(mechanism, gravity=(0.0, -9.81, 0.0)))
    one.step(None, 0.1)
    health = one.health
    assert (health.rank, health.equations) == (4, 5)
    assert not health.unique_forces
    assert 'forces are not unique: 1 of 5' in str(health)


def test_text_of_a_scene_in_space_tells_all_of_it_to_the_last_digit():
    random = np.random.default_rng(5)
    for _ in range(50):
        turn = random.standard_normal(4)
        mechanism = tilted_four_bar(tuple(turn / np.linalg.norm(turn)))[1]
        mechanism = replace(mechanism, joints=tuple(
            replace(joint, axis=tuple(random.standard_normal(3))) for joint in mechanism.joints))
        one = scene(mechanism)
        assert read_scene_text(scene_text(one))[0] == one


def test_loops_are_closed_at_the_start(linkage):
    mechanism, _ = linkage
    one = Simulation(scene(mechanism))
    one.set_state({'crank': 0.3}, {'crank': 1.0})
    assert one.closure < 1e-12
    assert np.abs(one.velocity[1:]).max() > 0.01
    before = one.position
    one.step(None, 1e-3)
    # Joint rates are those of the coordinates.
    assert_agree((one.position - before) / 1e-3, one.velocity, 1e-2)


def test_damping_dissipates_what_is_missing(linkage):
    mechanism, torque = linkage
    effects = {'grease': JointDamping('rocker', 0.01)}
    one = Simulation(scene(mechanism, effects=effects, **TIGHT))
    start = one.energy
    one.step(torque, 1.0)
    lost = one.effect_readings('grease')['dissipated_energy']
    assert lost > 1e-3
    assert_agree(one.energy - start, 0.02 * one.position[0] - lost, 1e-7)


def test_forces_at_cut_joints_hold_what_they_carry(linkage):
    mechanism, torque = linkage
    one = Simulation(scene(mechanism))
    assert one.constraint_forces.shape == (1, 6)
    # A spherical joint hands over no moment.
    assert_agree(one.constraint_forces[0, :3], np.zeros(3), 1e-12, smallest=1.0)
    # The rocker's angular momentum about its axis: gravity has no lever there.
    force = -one.force('end')[3:]
    inertia = mechanism.bodies[1].inertia[0] + 1.0 * 0.15 ** 2
    assert_agree(-0.3 * force[1], inertia * one.acceleration[1], 1e-10)


def test_rows_of_numbers_have_three_components(linkage):
    mechanism, torque = linkage
    one, rows = Simulation(scene(mechanism)), []
    names = columns(one)
    assert [name for name in names if name.startswith(('force', 'point'))] == [
        *(f'force.end.{axis}' for axis in 'xyz'), *(f'point.point_0.{axis}' for axis in 'xyz')]
    run(one, 0.02, 100.0, torque, report=Report(), on_row=rows.append)
    assert [len(values) for values in rows] == 3 * [len(names)]
    assert row(one, one.time)[names.index('point.point_0.z')] == one.points[0, 2]


def test_check_tells_axes_and_equations(linkage):
    mechanism, _ = linkage
    text = describe(scene(mechanism), Simulation(scene(mechanism)))
    assert 'degrees of freedom    2 = 5 joints - 3 equations' in text
    assert '[1, 0, 0]' in text
    # Of the tree's joints any type is understood.
    assert 'spherical' in describe(spatial_machines.rssr_four_bar()[0])


@pytest.mark.parametrize('name', ['rssr_four_bar', 'stewart_platform'])
def test_dense_formulations_and_independent_coordinates_move_the_same(name):
    ones = [Simulation.from_scene(name, integrator='rk4', step_size=1e-3, **more)
            for more in ({}, {'stabilisation': 'independent'})]
    for one in ones:
        one.step(None, 0.1)
        for formulation in FORMULATIONS:
            # One of the machines is at rest: of accelerations of gravity's size.
            assert_agree(dense_dynamics(one, formulation)[0], one.acceleration, 1e-9, smallest=1.0)
    assert_agree(ones[1].position, ones[0].position, 1e-9)
    assert_agree(ones[1].constraint_forces, ones[0].constraint_forces, 1e-7)


@pytest.mark.slow
def test_a_falling_delta_robot_keeps_its_energy_where_its_rods_are_parallel():
    # At 0.3035 s all rods are vertical: the platform may turn about them for an instant.
    start = load_scene('delta_robot')
    one = Simulation.from_scene(
        replace(start, effects={'gravity': start.effects['gravity']}), integrator='rk4',
        step_size=1e-4)
    one.step(None, 0.32)
    assert one.data.system.work.health[RANK_REVEALING_COUNT] > 0.0
    assert abs(one.energy_balance.residual) < 1e-9
    hips = one.position[[0, 5, 10]]
    assert_agree(hips, [hips[0]] * 3, 1e-9)


def test_the_loops_over_bodies_move_what_is_too_large_to_be_unrolled(monkeypatch):
    ones = [Simulation.from_scene('stewart_platform')]
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', 0)
    ones.append(Simulation.from_scene('stewart_platform'))
    assert ones[0].data.system.is_unrolled and not ones[1].data.system.is_unrolled
    for one in ones:
        one.step(None, 0.1)
    assert_agree(ones[1].position, ones[0].position, 1e-9)


def test_effects_with_vectors_of_the_plane_are_refused(linkage):
    mechanism, _ = linkage
    with pytest.raises(FieldError, match='effects.gravity.acceleration: .*3 finite numbers'):
        scene(mechanism, gravity=(0.0, -9.81))
    with pytest.raises(FieldError, match='effects.load.position: .*3 finite numbers'):
        scene(mechanism, effects={'load': Payload('rod', 1.0, (0.1, 0.0))})
