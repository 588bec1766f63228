# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Arms eliminated before multipliers give the motion of dense matrices, or step aside."""

import ctypes

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.codegen import function_table as calls, lanes, routines, space
from closedloop_dynamics.codegen.arms import Plan
from closedloop_dynamics.codegen.packing import packing_of
from closedloop_dynamics.engine import types as t
from closedloop_dynamics.simulation.system import build_system, number_of_states
import numpy as np
import pytest

from .spatial_engine import _array, _inputs, interpret
from ..reference.compare import assert_agree
from ..reference.numbers import Numbers

# Arms of two links, links between others, gears; legs of three joints, rods in parallelograms.
PLANAR = 'three_rrr', 'carpet_scraper', 'excavator_arm', 'planetary_gear', 'geared_five_bar'
SPATIAL = 'stewart_platform', 'delta_robot'
# Loops of more joints than their equations take.
LOOPS = 'bricard', 'rssr_four_bar', 'double_wishbone'
# Rows of the tree that bring an arm to a singular position of its own, and where: a leg stretched
# and folded, a leg and a rod along the first axis of their universal joints.
SINGULAR = [('three_rrr', 2, 0.0), ('three_rrr', 2, np.pi), ('stewart_platform', 2, 0.5 * np.pi),
            ('stewart_platform', 8, 0.5 * np.pi), ('delta_robot', 11, 0.5 * np.pi)]


def trace(model, with_arms=True):
    return routines.MechanismTrace(model, with_arms=with_arms)


def drawn(name, seed=0, spread=0.3):
    """Return the model of a shipped scene, and coordinates (loops open), rates and torques."""
    simulation = Simulation(load_scene(name))
    rng, nv = np.random.default_rng(seed), len(simulation.velocity)
    q = simulation.position + spread * rng.uniform(-1.0, 1.0, len(simulation.position))
    return simulation.data.system.model, q, rng.normal(size=nv), rng.normal(size=nv)


def evaluated(model, q, qd, tau, with_arms=True, kind=float):
    """Return accelerations, multipliers, and whether they are good; interpreted."""
    inputs = {source: np.asarray(array, dtype=kind)
              for source, array in _inputs(model, q, qd, tau).items()}
    outputs, good = interpret(trace(model, with_arms).routine(calls.EVALUATION), inputs)
    return (_array(outputs, calls.QDD, len(qd)), _array(
        outputs, calls.LAM, len(model.column) - 1), good)


@pytest.mark.parametrize('name', SPATIAL)
def test_all_legs_go_side_by_side(name):
    """The leg that carries the platform, and one along X, whose axes have zeros, too."""
    routine = trace(drawn(name)[0]).traced(calls.EVALUATION)
    lanes_of = [len(one) for one in packing_of(routine, []).bundles.values()]
    assert sum(lanes for lanes in lanes_of if lanes == 6) > 0.5 * len(routine.needed())
    # Nor is the hip alone whose arm carries the platform.
    assert name != 'delta_robot' or 3 * lanes_of.count(3) > 0.15 * len(routine.needed())


@pytest.mark.parametrize('name', PLANAR + SPATIAL + LOOPS)
def test_arms_give_the_motion_of_the_elimination_of_multipliers(name):
    for seed in range(3):
        state = drawn(name, seed)
        assert trace(state[0]).with_arms
        qdd, lam, good = evaluated(*state)
        assert good
        # In extended precision.
        expected, forces, _ = evaluated(*state, with_arms=False, kind=np.longdouble)
        assert_agree(qdd, expected, 1e-12)
        assert_agree(lam, forces, 1e-12)


@pytest.mark.parametrize('name', SPATIAL)
@pytest.mark.parametrize('rotors', [False, True])
def test_arms_give_the_motion_of_dense_matrices(name, rotors):
    model, q, qd, tau = drawn(name)
    if rotors:
        plain = model.tree[1:, t.TYPE] != t.BALL
        model.body[1:, space.ARMATURE] = 0.01 * plain
        carried = plain & (model.tree[1:, t.PARENT] > 0)
        model.body[1:, space.ROTOR:space.ROTOR + 3] = np.outer(carried, (1e-3, -2e-3, 3e-3))
    numbers = Numbers(model)
    numbers.move(q, qd)
    expected, forces, _ = numbers.accelerations(tau, 0.0)
    qdd, lam, _ = evaluated(model, q, qd, tau)
    assert_agree(qdd, expected, 1e-11)
    assert_agree(lam, forces, 1e-11)


@pytest.mark.parametrize(('name', 'row', 'where'), SINGULAR)
@pytest.mark.parametrize('which', [calls.EVALUATION, calls.CORRECTION])
def test_next_to_a_singular_arm_results_are_right_or_not_used(which, name, row, where):
    model, q, qd, tau = drawn(name)
    used = []
    made = {with_arms: trace(model, with_arms).routine(which) for with_arms in (True, False)}
    results = ((calls.CORRECTIONS, 2 * len(qd)),) if which == calls.CORRECTION else (
        (calls.QDD, len(qd)), (calls.LAM, len(model.column) - 1))
    for distance in (0.5, *10.0 ** -np.arange(1.0, 13.0), 0.0):
        q[model.tree[row, t.COORDINATE]] = where - distance
        inputs = _inputs(model, q, qd, tau)
        outputs, good = interpret(made[True], inputs)
        used.append(good)
        if good:
            expected, _ = interpret(made[False], {
                source: array.astype(np.longdouble) for source, array in inputs.items()})
            for source, size in results:
                assert_agree(_array(outputs, source, size), _array(expected, source, size), 1e-12)
    assert used[0] and not any(used[2:])


@pytest.mark.parametrize('name', LOOPS)
def test_far_from_where_loops_close_results_are_right_or_not_used(name):
    used = []
    for seed in range(40):
        state = drawn(name, seed, spread=3.0)
        qdd, lam, good = evaluated(*state)
        used.append(good)
        if good:
            expected, forces, _ = evaluated(*state, with_arms=False, kind=np.longdouble)
            assert_agree(qdd, expected, 1e-11)
            assert_agree(lam, forces, 1e-11)
    assert 10 < sum(used) < 40


@pytest.mark.parametrize(('lean', 'used'), [(0.5, True), (0.0, False)])
def test_results_are_not_used_where_what_arms_leave_is_dependent(lean, used):
    """Between upright rods the platform of a Delta robot may turn about the vertical."""
    model, q, qd, tau = drawn('delta_robot', spread=0.0)
    angle = 0.5 * np.pi - lean
    for hip in range(0, 15, 5):
        q[hip:hip + 5] = 0.4, angle - 0.4, 0.0, angle - 0.4, 0.0
    q[15:] = 0.0, -np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle)
    qdd, _, good = evaluated(model, q, qd, tau)
    assert good == used
    if used:
        assert_agree(qdd, evaluated(model, q, qd, tau, with_arms=False)[0], 1e-11)


def rows_of_arms(name):
    """Return the model of a shipped scene and the plan of its arms."""
    model = Simulation(load_scene(name)).data.system.model
    return Plan.of(trace(model).recursion, model)


def test_arms_are_found_by_structure():
    plan = rows_of_arms('stewart_platform')
    # Six legs, and the spherical joint between the first one and the platform.
    assert sorted(sorted(joints) for joints, _ in plan.steps) == [
        [1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12], [13, 14, 15], [16, 17, 18], [19, 20, 21]]
    assert list(plan.floating) == [6] and not plan.rest
    assert not rows_of_arms('three_rrr').rest
    # The parallelograms keep the platform from turning.
    assert len(rows_of_arms('delta_robot').rest) == 3
    # One loop: with parallel axes its links are an arm that keeps a motion, with others the
    # elimination of multipliers takes less.
    assert len(rows_of_arms('four_bar').steps) == 1 and rows_of_arms('bennett') is None
    # All but the first joint of a loop whose shape makes two of its equations superfluous.
    assert [joints for joints, _ in rows_of_arms('bricard').steps] == [[5, 4, 3, 2]]
    # Of the rod's spherical joint not the row about which it turns most.
    assert [joints for joints, _ in rows_of_arms('rssr_four_bar').steps] == [[5, 4, 3]]


@pytest.mark.parametrize('name', ['three_rrr', 'stewart_platform'])
def test_at_a_singular_arm_the_same_call_gives_the_motion(name):
    row, where = next(one[1:] for one in SINGULAR if one[0] == name)
    model, q, qd, tau = drawn(name, spread=0.1)
    system = build_system(model, unrolled=True)
    system.tau[:] = tau
    state = np.zeros(number_of_states(system))
    for angle in (q[model.tree[row, t.COORDINATE]], where):
        q[model.tree[row, t.COORDINATE]] = angle
        state[:len(q) + len(qd)] = np.concatenate([q, qd])
        before = system.work.health[t.EVALUATIONS]
        system.native.evaluate_state(state)
        assert system.work.health[t.EVALUATIONS] == before + 1.0
        assert system.work.health[t.RANK_REVEALING_COUNT] == 0.0
        expected, _, good = evaluated(model, q, qd, tau, with_arms=False, kind=np.longdouble)
        assert good
        assert_agree(system.qdd, expected, 1e-11)


def test_one_state_at_a_singular_arm_does_not_spoil_those_beside_it():
    model, q, qd, tau = drawn('three_rrr', spread=0.1)
    states = np.tile(q, (calls.LANES, 1))
    states[1:, 0] += 0.1 * np.arange(1, calls.LANES)
    sizes = len(qd), len(model.column) - 1
    for singular in (False, True):
        if singular:
            states[2, model.tree[2, t.COORDINATE]] = 0.0
        arrays = lanes.allocate([model] * calls.LANES, sizes, np.zeros(1))
        arrays[calls.TAU][:] = lanes.spread([tau] * calls.LANES)
        table = lanes.connect(model, arrays, calls.EVALUATION)
        run = ctypes.CFUNCTYPE(ctypes.c_int64, *3 * [ctypes.c_void_p])(
            int(table[calls.EVALUATION]))
        positions, rates = lanes.spread(states), lanes.spread([qd] * calls.LANES)
        assert run(table.ctypes.data, positions.ctypes.data, rates.ctypes.data)
        for lane in range(calls.LANES):
            expected, _, _ = evaluated(model, states[lane], qd, tau, with_arms=False)
            assert_agree(arrays[calls.QDD].reshape(-1, calls.LANES)[:, lane], expected, 1e-11)
        assert np.all(arrays[calls.HEALTH].reshape(-1, calls.LANES)[t.EVALUATIONS] == 2.0)
