# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Assembly: loops close, nearest in the metric of mass, held joints stay, notes are right."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    AssemblyError, Body, CutJoint, Joint, load_scene, Mechanism, Model, scene_names, Simulation)
from closedloop_dynamics.codegen.equations import Equations
from closedloop_dynamics.engine.ranks import rank_of
from closedloop_dynamics.kinematics.assembly import angle_notes, Assembler, TOLERANCE
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.kinematics.second_order import find_degrees_of_freedom
import numpy as np
import pytest

from ..reference import cases
from ..reference.linkages import random_linkage
from ..reference.machines import parallelogram

STILL = np.zeros(3)


def assembler(mechanism):
    return Assembler(mechanism, Equations(build_model(mechanism)))


def tangents(one, q):
    """Return the motions that keep the loops closed, a row each."""
    jac = one.jacobian(q)
    _, singular, right = np.linalg.svd(jac)
    return right[int(np.sum(singular > 1e-7 * singular[0])):]


def nearest_by_pseudo_inverses(one, q, free):
    """Close loops slowly: Newton's method, the least change in the metric of the start."""
    root, limit = np.linalg.cholesky(one.inertia(q)[np.ix_(free, free)]), max(1.0, one.extent) / 4
    while np.abs(one.closure(q)).max(initial=0.0) > 0.01 * TOLERANCE * one.extent:
        weighted = np.linalg.solve(root, one.jacobian(q)[:, free].T).T
        change = np.zeros(one.nv)
        change[free] = -np.linalg.solve(root.T, np.linalg.pinv(weighted) @ one.closure(q))
        change *= min(1.0, limit / max(limit, np.abs(change).max()))
        for halvings in range(40):
            trial = one.mechanism.coordinates.moved(q, change * 0.5 ** halvings)
            if np.linalg.norm(one.closure(trial)) < np.linalg.norm(one.closure(q)):
                break
        else:
            return q
        q = trial
    return q


@pytest.mark.parametrize('name', scene_names())
@pytest.mark.parametrize('held', [True, False])
def test_the_engine_closes_loops_as_pseudo_inverses_do(name, held):
    scene, rng = load_scene(name), np.random.default_rng(5)
    mechanism = scene.mechanism
    one = Assembler(mechanism, Geometry(mechanism).equations)
    start, free = np.array(scene.initial.position), np.arange(one.nv)
    if held and scene.initial.hold:
        free = np.array([k for k in free if mechanism.coordinates.names[k] not in (
            scene.initial.hold)], dtype=int)
    guess = mechanism.coordinates.moved(
        start, 0.02 * one.extent * rng.uniform(-1.0, 1.0, one.nv))
    found, psi = one.solve_closure(guess, free)
    # The joints held may leave no closed position so far from the start.
    closed = np.abs(psi).max(initial=0.0) <= TOLERANCE * one.extent
    assert held or closed
    # Where equations repeat others only in closed positions, all have a part on the way there.
    if closed and rank_of(one.dimensionless(found)) == one.nc:
        np.testing.assert_allclose(
            found, nearest_by_pseudo_inverses(one, guess, free), rtol=0.0, atol=1e-9)


# Those in space have tests of their own (``test/mechanism/test_shipped_in_space.py``).
@pytest.mark.parametrize('name', [
    name for name in scene_names() if load_scene(name).mechanism.planar])
def test_shipped_starts_close_with_held_joints_as_given_and_nothing_to_tell(name):
    scene = load_scene(name)
    one, hold = assembler(scene.mechanism), scene.initial.hold
    position, velocity = np.array(scene.initial.position), np.array(scene.initial.velocity)
    q = one.positions(position, hold)
    held = [scene.mechanism.joint_names.index(joint) for joint in hold]
    assert np.abs(one.closure(q)).max(initial=0.0) <= TOLERANCE * one.extent
    assert np.array_equal(q[held], position[held])
    rates = np.zeros(one.nv)
    rates[held] = np.arange(1.0, 1.0 + len(held))
    qd = one.velocities(q, rates, hold)
    assert np.array_equal(qd[held], rates[held])
    assert np.abs(one.jacobian(q) @ qd).max(initial=0.0) <= 1e-12
    assert one.notes(position, velocity, q, one.velocities(q, velocity, hold), hold) == []
    assert one.degrees_of_freedom(q) == len(hold)
    # With the bars of each stage on top of one another the lift is a chain of seven bodies.
    most = 7 if name == 'scissor_lift' else len(hold)
    assert find_degrees_of_freedom(scene.mechanism) == most


@pytest.mark.parametrize('seed', cases.first(3, range(12)))
def test_nearest_state_in_the_metric_of_mass(seed):
    rng = np.random.default_rng(seed)
    mechanism, closed, _ = random_linkage(rng)
    one = assembler(mechanism)
    guess = closed + 1e-5 * rng.normal(size=one.nv)
    q = one.positions(guess)
    assert np.abs(one.closure(q)).max() <= TOLERANCE * one.extent
    # At the nearest point the change is orthogonal to every motion that keeps the loops closed.
    inertia, free = one.inertia(q), tangents(one, q)
    change = inertia @ (q - guess)
    assert np.abs(free @ change).max() <= 1e-3 * np.linalg.norm(change)
    wanted = rng.normal(size=one.nv)
    qd = one.velocities(q, wanted)
    assert np.abs(one.jacobian(q) @ qd).max() <= 1e-9
    change = inertia @ (qd - wanted)
    assert np.abs(free @ change).max() <= 1e-9 * np.linalg.norm(change)


@pytest.mark.parametrize('hold', [(), ('crank_joint',)])
def test_a_closed_state_is_taken_as_it_is(hold):
    scene = load_scene('four_bar')
    one = assembler(scene.mechanism)
    q = one.positions(scene.initial.position, hold)
    qd = one.velocities(q, [2.0, 0.0, 0.0], hold)
    assert np.array_equal(one.positions(q, hold), q)
    assert np.array_equal(one.velocities(q, qd, hold), qd)


def test_the_branch_is_that_of_the_guess_or_it_is_reported():
    scene = load_scene('four_bar')
    one, hold = assembler(scene.mechanism), ('crank_joint',)

    def bend(q):
        # Which way the coupler and the rocker are bent at the pin between them.
        return np.sign(np.sin(q[2] - q[0] - q[1]))

    reported, rng = 0, np.random.default_rng(0)
    start = one.positions(scene.initial.position, hold)
    for _ in range(60):
        guess = start + [0.0, *rng.uniform(-2.5, 2.5, 2)]
        if abs(np.sin(guess[2] - guess[0] - guess[1])) < 0.1:
            continue
        try:
            q = one.positions(guess, hold)
        except AssemblyError:
            continue
        note = ' '.join(one.notes(guess, STILL, q, STILL, hold))
        assert ('mirrored' in note) == (bend(q) != bend(guess))
        assert ('moved from' in note) == (np.abs(q - guess).max() > 0.5)
        reported += 'mirrored' in note
    assert reported > 3
    for guess in start + rng.uniform(-0.3, 0.3, (20, 3)) * [0, 1, 1]:
        assert np.allclose(one.positions(guess, hold), start, atol=1e-9)


def test_refusal_names_the_open_loop_and_a_cure_that_works():
    scene = load_scene('four_bar')
    long = replace(scene.mechanism, joints=tuple(
        replace(joint, position=(3.0, 0.0)) if joint.name == 'rocker_joint' else joint
        for joint in scene.mechanism.joints))
    one, (cut,) = assembler(long), long.cut_joints
    with pytest.raises(AssemblyError, match=f'cut_joints.{cut.name} open by .*check lengths'):
        one.positions(np.array(scene.initial.position))
    assert find_degrees_of_freedom(long) is None

    # A crank-rocker's rocker cannot stand at every angle.
    one, guess = assembler(scene.mechanism), np.array(scene.initial.position)
    guess[2] = 0.2
    with pytest.raises(AssemblyError, match='closes at rocker_joint = ([0-9.-]+): hold') as error:
        one.positions(guess, ('rocker_joint',))
    guess[2] = float(str(error.value).split('rocker_joint = ')[1].split(':')[0])
    one.positions(guess, ('rocker_joint',))


def test_too_many_and_too_few_held_joints_are_counted_by_what_can_move():
    one = assembler(parallelogram(rockers=4))
    assert (one.nv, one.nc) == (6, 8)
    guess = np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    assert one.degrees_of_freedom(one.positions(guess)) == 1
    assert find_degrees_of_freedom(one.mechanism) == 1
    with pytest.raises(AssemblyError, match=(
            r'crank_joint, joint_0 held: expected joints that move independently \(1 degree of '
            r'freedom\), got joint_0, which follows from crank_joint. Leave joint_0 out')):
        one.positions(guess + [0.1, 0, 0, 0, 0, 0], ('crank_joint', 'joint_0'))
    scene = load_scene('three_rrr')
    # One leg alone places the platform.
    leg, guess = ('theta_1', 'theta_2', 'theta_3'), np.array(scene.initial.position)
    guess[0] += 0.1
    with pytest.raises(AssemblyError, match=(
            r'\(3 degrees of freedom\), got theta_4, which follows from theta_1, theta_2, th')):
        assembler(scene.mechanism).positions(guess, (*leg, 'theta_4'))
    with pytest.raises(AssemblyError, match='2 degrees of freedom stay open. Hold 2 more of'):
        assembler(scene.mechanism).positions(scene.initial.position, ('theta_1',))


def test_velocities_that_become_others_are_reported():
    scene = load_scene('four_bar')
    one = assembler(scene.mechanism)
    q = one.positions(scene.initial.position)
    wanted = np.array([0.0, 1.0, 0.0])
    qd = one.velocities(q, wanted)
    assert abs(qd[1] - 1.0) > 0.1
    note, = one.notes(q, wanted, q, qd, ())
    assert note == (f'The velocity 1 wanted of coupler_joint became {qd[1]:.6g}: the nearest '
                    'motion that keeps the loops closed. To have it as given, hold '
                    'coupler_joint.')
    # The cure that is named.
    qd = one.velocities(q, wanted, ('coupler_joint',))
    assert qd[1] == 1.0 and one.notes(q, wanted, q, qd, ('coupler_joint',)) == []


def test_held_velocities_that_contradict_the_loops_are_refused():
    scene = load_scene('four_bar')
    one = assembler(scene.mechanism)
    q = one.positions(scene.initial.position)
    with pytest.raises(AssemblyError, match='crank_joint, rocker_joint contradict the loops'):
        one.velocities(q, [1.0, 0.0, -1.0], ('crank_joint', 'rocker_joint'))


@pytest.mark.parametrize('hold', [(), ('crank_joint',)])
def test_a_change_point_is_named_and_left_by_the_cure_that_is_named(hold):
    one = assembler(parallelogram())
    flat = one.positions(STILL, hold)
    assert one.lost_equations(flat) == 1
    note, = one.notes(STILL, STILL, flat, STILL, hold)
    assert 'change point' in note and '1 of 2 closure equations' in note
    assert 'crank_joint further by 0.01' in note and one.advice_on_opening(flat)
    # The links stay in line to first order whatever their rates; to second order they do so in
    # two ways only: 0.2 w_1^2 + 0.5 w_2^2 = 0.2 w_3^2 and 0.2 w_1 + 0.5 w_2 = 0.2 w_3.
    with pytest.raises(AssemblyError, match='change point .*belong to none of the ways'):
        one.velocities(flat, [1.0, 0.0, 0.0], hold)
    for turn in (0.0, -4.0 / 3.0):
        branch = np.array([1.0, turn - 1.0, 1.0 + 2.5 * turn])
        assert np.array_equal(one.velocities(flat, branch, hold), branch)
    beside = one.positions([0.01, -0.01, 0.01], ('crank_joint',))
    assert one.lost_equations(beside) == 0
    assert np.allclose(one.velocities(beside, [1.0, 0.0, 0.0], ('crank_joint',)), [1.0, -1.0, 1.0])


def test_equations_that_depend_everywhere_are_no_change_point():
    one = assembler(parallelogram(rockers=3))
    q = one.positions([1.0, -1.0, 1.0, 1.0, 1.0])
    rest = np.zeros(one.nv)
    assert one.lost_equations(q) == 0 and one.notes(q, rest, q, rest, ()) == []
    assert one.advice_on_opening(q) == ''
    assert np.allclose(one.velocities(q, [1.0, 0, 0, 0, 0], ('crank_joint',)), [1, -1, 1, 1, 1])


def test_angles_in_degrees_are_reported():
    mechanism = load_scene('four_bar').mechanism
    note, = angle_notes(mechanism, [60.0, -0.5, 6.0])
    assert 'crank_joint = 60.' in note and 'degrees?' in note and 'rocker' not in note
    assert angle_notes(load_scene('slider_crank').mechanism, [0.0, 0.0, 60.0]) == []


@pytest.mark.parametrize('block', [
    Body('block', 0.0, (0.0, 0.0), 0.0, True), Body('block', 1e-9, (0.0, 0.0), 1e-14)],
    ids=['massless', 'light'])
def test_a_held_velocity_is_met_by_links_of_next_to_no_inertia(block):
    # Whitworth's quick-return: the lever turns with the slot that the crank's pin slides in.
    crank, lever = Body('crank', 0.5, (0.04, 0.0), 2.7e-4), Body('lever', 1.2, (0.2, 0.0), 0.016)
    one = assembler(Mechanism('whitworth', (crank, block, lever), (
        Joint('crank_joint', 'revolute', 'ground', 'crank', (0.0, 0.0)),
        Joint('pin', 'revolute', 'crank', 'block', (0.08, 0.0)),
        Joint('lever_joint', 'revolute', 'ground', 'lever', (0.0, -0.2))), (
            CutJoint('slot', 'prismatic', 'block', 'lever', (0.0, 0.0), (0.0, 0.0)),)))
    q = one.positions([0.3, 1.0, 1.3], ('crank_joint',))
    assert one.velocities(q, [5.0, 0.0, 0.0], ('crank_joint',))[0] == 5.0
    pin = 0.08 * np.array([np.cos(0.3), np.sin(0.3)]) + [0.0, 0.2]
    rate = 5.0 * 0.08 * (pin @ [np.cos(0.3), np.sin(0.3)]) / (pin @ pin)
    # With nothing held, too, all three rates belong together.
    for held, guess in ((('crank_joint',), [5.0, 0.0, 0.0]), ((), [5.0, rate - 5.0, rate])):
        np.testing.assert_allclose(
            one.velocities(q, guess, held), [5.0, rate - 5.0, rate], rtol=1e-9)


def test_degrees_are_asked_about_wherever_positions_come_in():
    model = Model.from_scene('four_bar')
    with pytest.warns(RuntimeWarning, match='crank_joint = 90. They are taken as radians; in '
                                            'degrees[?] 90 degrees are 1.5708 rad'):
        model.assemble({'crank_joint': 90.0}, hold=['crank_joint'])
    simulation = Simulation(model)
    simulation.set_state({'crank_joint': 45.0}, hold=['crank_joint'])
    assert any('45 degrees are 0.785398 rad' in note for note in simulation.data.assembly_notes())
    # A crank that has turned 14 times is found all the same.
    simulation.set_state({'crank_joint': 14.0 * 2.0 * math.pi + 1.0}, hold=['crank_joint'])
    assert not any('degrees' in note for note in simulation.data.assembly_notes())
