# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Driven mechanisms: positions on one branch, where it ends, all assemblies."""

from contextlib import suppress
import math
import warnings

from closedloop_dynamics import AssemblyError, load_scene, Model
from closedloop_dynamics.kinematics.driven import (
    BranchEndError, CHANGE_POINT, driven_mechanism, DrivenKinematics, LIMIT)
from closedloop_dynamics.kinematics.motions import moving
import numpy as np
import pytest

from ..reference.designs import closed, four_bar, three_rpr

TURN = np.linspace(0.0, 2.0 * np.pi, 73)


def wrapped(angle):
    return np.angle(np.exp(1j * np.asarray(angle)))


@pytest.mark.parametrize('elbow', [1.0, -1.0])
def test_a_turn_is_that_of_two_circles_on_either_branch(tmp_path, elbow):
    lengths = (2.0, 7.0, 9.0, 6.0)
    model = Model(four_bar(tmp_path, *lengths, angle=0.3, elbow=elbow))
    states = model.solve({'crank_joint': 0.3 + TURN})
    for angle, (crank, coupler, rocker) in zip(0.3 + TURN, states.q):
        beta, psi = closed(*lengths, angle, elbow)
        np.testing.assert_allclose(crank, angle, atol=1e-13)
        np.testing.assert_allclose(wrapped(crank + coupler - beta), 0.0, atol=1e-12)
        np.testing.assert_allclose(wrapped(rocker - psi), 0.0, atol=1e-12)


def driven(scene, drives=None, points=None):
    """Return the kinematics of a scene, and the driven values of its start."""
    model = Model.from_scene(scene) if isinstance(scene, str) else Model(scene)
    _, mechanism, _ = driven_mechanism(model.mechanism, drives, points)
    kinematics = DrivenKinematics(mechanism, model.assemble().q)
    return kinematics, kinematics.values.copy()


# In the plane; over-constrained; with balls, universal joints and spins of rods; by points; with
# gears; with a pin in a slot; a driven joint that is cut.
@pytest.mark.parametrize('scene, drives, points', [
    ('four_bar', ['crank_joint'], []), ('four_bar', ['cut_1'], []),
    ('scissor_lift', None, []), ('bennett', None, []), ('rssr_four_bar', None, []),
    pytest.param('delta_robot', None, [], marks=pytest.mark.slow),
    ('stewart_platform', None, []), ('geared_five_bar', None, []),
    ('geneva_drive', ['driver_joint', 'wheel_joint'], []),
    ('three_rrr_horizontal', ['theta_6'], ['platform_center'])])
def test_rates_and_accelerations_are_differences_of_positions(scene, drives, points):
    actuated = load_scene(scene).mechanism.actuated_joints
    kinematics, start = driven(scene, dict.fromkeys(drives or actuated, 0.0), dict.fromkeys(
        points, (0.0, 0.0)))
    step, count, size = 1e-3, 21, 0.03
    time = step * np.arange(-2, count)
    rates = size * np.cos(np.arange(len(start)))
    later = time[:, np.newaxis] + 0.0 * start
    values = np.stack([start + rates * later + 0.5 * later ** 2, rates + later,
                       np.ones_like(later)], axis=2)
    motion = kinematics.follow(values)
    assert motion.end is None
    coordinates = kinematics.coordinates
    differences = [np.array([
        coordinates.apart(motion.position[k + n], motion.position[k - n])
        for k in range(2, count)]) / (2.0 * n * step) for n in (1, 2)]
    found = (4.0 * differences[0] - differences[1]) / 3.0
    np.testing.assert_allclose(motion.velocity[2:count], found, atol=1e-8)
    change = [(motion.velocity[2 + n:count + n] - motion.velocity[2 - n:count - n])
              / (2.0 * n * step) for n in (1, 2)]
    np.testing.assert_allclose(
        motion.acceleration[2:count], (4.0 * change[0] - change[1]) / 3.0, atol=1e-7)


# With slides, gears and an equation that repeats others.
@pytest.mark.parametrize('scene', ['slider_crank', 'geared_five_bar', 'bennett'])
def test_linearised_equations_are_differences_of_closures_and_driven_values(scene):
    kinematics, _ = driven(scene, dict.fromkeys(load_scene(scene).mechanism.actuated_joints, 0.0))
    # Where loops are open, too.
    here = kinematics.coordinates.moved(
        kinematics.position, kinematics.unit * np.linspace(0.01, 0.02, len(kinematics.unit)))
    closures, loops_jac, values, values_jac = kinematics.linearised(here)
    assert np.abs(closures).max() > 1e-4 and len(values) == len(values_jac)
    assert len(closures) == len(kinematics.unit) - len(values)
    step = 1e-6
    for k, one in enumerate(step * np.diag(kinematics.unit)):
        (ahead, _, there, _), (behind, _, back, _) = (
            kinematics.linearised(kinematics.coordinates.moved(here, way))
            for way in (one, -one))
        np.testing.assert_allclose((ahead - behind) / (2.0 * step), loops_jac[:, k], atol=1e-8)
        np.testing.assert_allclose((there - back) / (2.0 * step), values_jac[:, k], atol=1e-8)


def test_the_limit_of_a_rocker_is_where_crank_and_coupler_fold(tmp_path):
    model = Model.from_scene('four_bar')
    with pytest.raises(BranchEndError) as found:
        model.solve({'rocker_joint': [1.9, 2.2, 3.0]})
    # Base 0.4, rocker 0.25; the coupler 0.35 less the crank 0.1.
    limit = math.pi - math.acos((0.4 ** 2 + 0.25 ** 2 - 0.25 ** 2) / (2.0 * 0.4 * 0.25))
    end = found.value.end
    assert found.value.reached == 2 and end.kind == LIMIT
    np.testing.assert_allclose(end.values, [limit], atol=1e-11)
    assert 'rocker_joint at rest, crank_joint, coupler_joint can still move' in end.reason


def test_the_end_of_a_coarse_way_is_that_of_a_fine_one(tmp_path):
    scene = four_bar(tmp_path, 5.0, 4.0, 6.0, 7.0, angle=1.0)
    model, ends = Model(scene), []
    for count in (2, 5, 1000):
        with pytest.raises(BranchEndError) as found:
            model.solve({'crank_joint': np.linspace(1.0, 4.0, count)})
        ends.append(found.value.end.values[0])
    # Coupler and rocker are in line.
    limit = math.acos((5.0 ** 2 + 7.0 ** 2 - 10.0 ** 2) / 70.0)
    np.testing.assert_allclose(ends, limit, atol=1e-11)


@pytest.mark.parametrize('lengths', [(1.0, 3.0, 1.0, 3.0), (1.0, 1.0, 3.0, 3.0)])
def test_a_branch_ends_at_a_change_point(tmp_path, lengths):
    # A parallelogram, and a kite, fold into a line where another branch crosses.
    model = Model(four_bar(tmp_path, *lengths, angle=1.0))
    with pytest.raises(BranchEndError) as found:
        model.solve({'crank_joint': np.linspace(1.0, 5.0, 9)})
    assert found.value.end.kind == CHANGE_POINT
    line = math.pi if lengths[0] == lengths[2] else 2.0 * math.pi
    assert found.value.end.values[0] <= line + 1e-9


def test_a_branch_ends_where_equations_vanish_as_a_whole():
    # All bars of a scissor lift stand upright: those of a slot no longer change, by no rate.
    model = Model.from_scene('scissor_lift')
    with pytest.raises(BranchEndError) as found:
        model.solve({'foot': np.radians([60.0, 80.0, 100.0])})
    end = found.value.end
    assert found.value.reached == 2 and end.kind == CHANGE_POINT
    assert 0.0 <= 0.5 * math.pi - end.values[0] < 1e-3


def test_points_go_where_they_are_sent():
    model = Model.from_scene('three_rrr_horizontal')
    start = model.evaluate(model.assemble())
    place, theta = start.points['platform_center'], model.assemble().q[0]
    places = place + 0.05 * np.array([[0.0, 0.0], [1.0, 0.5], [0.2, 1.0], [-1.0, -0.3]])
    states = model.solve({'theta_1': theta}, {'platform_center': places})
    found = model.evaluate(states).points['platform_center']
    np.testing.assert_allclose(found, places, atol=1e-13)
    # Back again, by the joints.
    back = model.solve({name: states.q[:, model.coordinates.index[name]]
                        for name in model.actuated_joints})
    np.testing.assert_allclose(back.q, states.q, atol=1e-11)


def test_the_edge_of_what_a_point_reaches_is_a_type_1_singularity(tmp_path):
    model = Model(four_bar(tmp_path, 2.0, 7.0, 9.0, 6.0, angle=1.0))
    with pytest.raises(BranchEndError) as found:
        model.solve(points={'tool': [(3.0, math.nan), (30.0, math.nan)]})
    assert found.value.end.kind == LIMIT and 'type-1' in str(found.value)
    assert 'tool.x = ' in str(found.value)


# Merlet; the six assemblies are all real.
KNOWN = (((0.0, 0.0), (15.91, 0.0), (0.0, 10.0)), (17.04, 16.54, 20.84), (14.98, 15.38, 12.0))


def test_a_platform_on_three_legs_has_six_assemblies(tmp_path):
    base, sides, legs = KNOWN
    scene = three_rpr(tmp_path, base, sides, legs)
    model = Model(scene)
    found = model.assemblies({f'leg_{k}': leg for k, leg in enumerate(legs, 1)})
    assert str(found) == 'proved: 6 (at most 6)' and len(found.states) == 6
    corners = []
    for q in found.states.q:
        index = model.coordinates.index
        ends = [complex(*start) + leg * np.exp(1j * q[index[f'turn_{k}']])
                for k, (start, leg) in enumerate(zip(base, legs), 1)]
        np.testing.assert_allclose(
            [abs(ends[0] - ends[1]), abs(ends[1] - ends[2]), abs(ends[2] - ends[0])], sides,
            atol=1e-9)
        corners.append(ends)
    apart = np.abs(np.array(corners)[:, np.newaxis] - np.array(corners)).max(axis=2)
    assert (apart + np.eye(6) > 0.1).all()


def test_three_legs_have_eight_working_modes():
    model = Model.from_scene('three_rrr')
    corners = {'corner_1': (0.31, 0.27), 'corner_2': (0.71, 0.27)}
    found = model.assemblies(points=corners)
    assert str(found) == 'proved: 8 (at most 8)'
    points = model.evaluate(found.states).points
    for name, place in corners.items():
        np.testing.assert_allclose(points[name] - place, 0.0, atol=1e-10)
    # Each driven joint has two angles, in all combinations.
    angles = np.array([[found.states.q[k, model.coordinates.index[name]]
                        for name in model.actuated_joints] for k in range(8)])
    assert len({tuple(row) for row in wrapped(angles).round(8)}) == 8
    assert [len(set(column)) for column in wrapped(angles).round(8).T] == [2, 2, 2]
    with pytest.raises(ValueError, match='expected places 0.4 m apart'):
        model.assemblies(points={'corner_1': (0.3, 0.3), 'corner_2': (0.75, 0.3)})


@pytest.mark.parametrize('seed', range(4))
def test_no_start_leads_to_an_assembly_that_was_not_found(tmp_path, seed):
    rng = np.random.default_rng(seed)
    base = tuple(map(tuple, rng.uniform(-1.0, 1.0, (3, 2)).tolist()))
    legs = rng.uniform(1.0, 2.0, 3).tolist()
    scene = three_rpr(tmp_path, base, (1.2, 1.0, 1.4), legs)
    model = Model(scene)
    drives = {f'leg_{k}': leg for k, leg in enumerate(legs, 1)}
    found = model.assemblies(drives)
    assert found.proved and len(found.states) in (2, 4, 6)
    turns = [model.coordinates.index[f'turn_{k}'] for k in (1, 2, 3)]
    reached = 0
    for _ in range(30):
        guess = rng.uniform(-3.0, 3.0, 7)
        guess[[model.coordinates.index[name] for name in drives]] = legs
        with suppress(AssemblyError), warnings.catch_warnings():
            warnings.simplefilter('ignore', RuntimeWarning)
            q = model.assemble(guess, hold=list(drives)).q
            apart = np.abs(wrapped(found.states.q[:, turns] - q[turns])).max(axis=1)
            assert apart.min() < 1e-7
            reached += 1
    assert reached > 3


def test_what_is_out_of_reach_has_no_assembly(tmp_path):
    model = Model.from_scene('four_bar')
    found = model.assemblies({'rocker_joint': 0.0})
    assert found.proved and len(found.states) == 0 and str(found).startswith('proved: 0')


def test_random_starts_are_not_called_all():
    model = Model.from_scene('geared_five_bar')
    start = model.assemble()
    name = model.actuated_joints[0]
    found = model.assemblies({name: start.q[model.coordinates.index[name]]})
    assert not found.proved and str(found).startswith('found so far: ')
    assert np.abs(found.states.q - start.q).max(axis=1).min() < 1e-9


@pytest.mark.parametrize('arguments, message', [
    ({'drives': {'nothing': 1.0}}, "drives: expected joints .*crank_joint.*, got 'nothing'"),
    ({}, 'drives: expected a joint, or a point along a direction, that is driven, got none'),
    ({'drives': {'crank_joint': 'x'}}, "drives: crank_joint: expected numbers, got 'x'"),
    ({'drives': {'crank_joint': [[1.0]]}}, r'crank_joint: expected 0 or 1 axes, got shape'),
    ({'drives': {'crank_joint': []}}, 'expected one pose or more, got none'),
    ({'drives': {'crank_joint': math.nan}}, 'drive crank_joint: expected finite numbers'),
    ({'drives': {'crank_joint': 1.0, 'rocker_joint': 2.0}}, r'\(1\), got 2: .*follow from'),
    ({'points': {'nothing': (0.0, 0.0)}}, 'points: expected named points .*coupler_point'),
    ({'points': {'coupler_point': (0.0, 0.0, 0.0)}}, 'expected 2 coordinates, got 3'),
    ({'points': {'coupler_point': [(0.0, math.nan), (0.0, 0.0)]}}, 'the same coordinates'),
    ({'drives': {'crank_joint': 1.0}, 'branch': 3}, 'state: expected a State')])
def test_arguments_that_make_no_sense_are_refused(arguments, message):
    model = Model.from_scene('four_bar')
    with pytest.raises(ValueError, match=message):
        model.solve(**arguments)


def test_too_few_drives_and_different_counts_are_refused():
    model = Model.from_scene('three_rrr')
    with pytest.raises(ValueError, match=r'degrees of freedom \(3\), got 1: theta_1'):
        model.solve({'theta_1': 1.0})
    for ask in (model.solve, model.assemblies):
        with pytest.raises(ValueError, match='theta_1; theta_3, .* can still move'):
            ask({'theta_1': 1.0})
    # A wheel that turns about its own axle moves no point, and is not driven by the other one.
    for ask in (Model.from_scene('geneva_drive').solve,
                Model.from_scene('geneva_drive').assemblies):
        with pytest.raises(ValueError, match=r'\(2\), got 1: driver_joint; wheel_joint can still'):
            ask({'driver_joint': 0.0})
    # Neither does a rod between balls; it needs no drive.
    assert len(Model.from_scene('rssr_four_bar').assemblies({'crank': 0.1}).states) >= 2
    with pytest.raises(ValueError, match='2 in drives: theta_1, 3 in drives: theta_6'):
        model.solve({'theta_1': [1.0, 1.0], 'theta_6': [1.0, 1.0, 1.0], 'theta_7': 1.0})
    with pytest.raises(ValueError, match='prescribes no motions'):
        Model(moving(load_scene('four_bar'), {'crank_joint': 't'})).solve({'crank_joint': 1.0})
