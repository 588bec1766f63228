# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Unrolled routines do what the kernels' loops do, for every topology and at any angle."""

import copy
import ctypes
import itertools
import math

from closedloop_dynamics import codegen, load_scene
from closedloop_dynamics.codegen import (
    announced_by, cache, function_table as calls, joint_kernels, relink, routines, scheduling)
from closedloop_dynamics.codegen.expression_graph import (
    arctangent, cosine, ExpressionGraph, LOAD, MULTIPLY, Q, QD, Routine, sine)
from closedloop_dynamics.codegen.machine_code import engines, LANES, machine_code, PACKED, SCALAR
from closedloop_dynamics.codegen.packing import packing_of
from closedloop_dynamics.codegen.routines import operations, unrolled_size
from closedloop_dynamics.engine.types import ALPHA, AY, REVOLUTE_ARMATURE, TYPE
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.scene.integrators import PROJECTION
from closedloop_dynamics.simulation.system import build_system
import numpy as np
import pytest

from ..reference import cases
from ..reference.compare import assert_agree, SOLVE


def systems(mechanism, **options):
    """Return the same system twice: unrolled, and by loops."""
    model = build_model(mechanism, (0.3, -9.81))
    return [build_system(copy.deepcopy(model), unrolled=unrolled, **options)
            for unrolled in (True, False)]


@pytest.mark.parametrize('baumgarte', [0.0, 3.0])
def test_evaluations_agree(drawn, baumgarte):
    rng, mechanism, q, qd = drawn
    tau = rng.normal(size=len(q))
    results = []
    for system in systems(mechanism, baumgarte=baumgarte):
        system.tau[:] = tau
        out = np.zeros(2 * len(q))
        system.native.derivative(np.concatenate([q, qd]), out)
        assert_agree(out[:len(q)], qd, SOLVE)
        # What is asked for from Python leaves poses and closure errors, too.
        system.native.evaluate(q, qd)
        assert_agree(system.qdd, out[len(q):], SOLVE)
        results.append((system.qdd, system.lam, system.work.closure_rate,
                        system.work.body[:, ALPHA:AY + 1], system.work.health[[2]]))
    for one, other in zip(*results):
        assert_agree(one, other, SOLVE, smallest=1.0)


@pytest.mark.parametrize('name', ['carpet_scraper', 'stewart_platform', 'bricard'])
def test_a_step_finds_no_multipliers_and_no_closure_errors(name):
    model = build_model(load_scene(name).mechanism)
    whole, alone = (routines.MechanismTrace(model).routine(which)
                    for which in (calls.EVALUATION, calls.MOTION))
    read = {operation[1] for place, operation in enumerate(alone.graph.operations)
            if operation[0] == LOAD and place in alone.needed()}
    assert calls.BAUMGARTE not in read and calls.BODY in read
    assert {source for source, _, _ in alone.outputs} == {calls.QDD, calls.HEALTH}
    assert routines.count_operations(alone) < 0.95 * routines.count_operations(whole)


def test_corrections_agree(drawn):
    rng, mechanism, q, qd = drawn
    start = np.concatenate([q, qd]) + 1e-4 * rng.normal(size=2 * len(q))
    ends = []
    for system in systems(mechanism):
        state = start.copy()
        assert system.native.stabilise(PROJECTION, state)
        assert np.abs(system.work.closure).max(initial=0.0) < 1e-11
        ends.append(state)
    assert_agree(*ends, 1e-9)
    if mechanism.cut_joints:
        assert np.abs(ends[0] - start).max() > 1e-6


def test_change_of_parameters_is_seen_and_a_rotor_links_again():
    rng, mechanism, q, qd = cases.drawn('three_rrr')
    pair, before = systems(mechanism), None
    for change in range(3):
        for system in pair:
            if change == 1:
                system.model.body[2, :4] *= 1.5
                system.model.gravity[0] = 2.0
            if change == 2:
                system.model.tree[3, TYPE], system.model.body[3, 7] = REVOLUTE_ARMATURE, 0.7
                joint_kernels.connect(system.model)
                if system.is_unrolled:
                    relink(system.model, system.table)
            system.native.evaluate(q, qd)
        if change:
            assert np.abs(pair[0].qdd - before).max() > 1e-3
        assert_agree(pair[0].qdd, pair[1].qdd, SOLVE)
        before = pair[0].qdd.copy()


def test_traced_operations_decide_what_is_unrolled(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, 'directory', lambda: tmp_path)
    monkeypatch.setattr(routines, 'sizes', {})
    model = build_model(cases.drawn('three_rrr')[1])
    counted = operations(model)
    assert unrolled_size(model, counted) == counted
    assert unrolled_size(model, counted // (2 * routines.RECORDED)) == math.inf
    for more, unrolled in ((0, True), (-1, False)):
        monkeypatch.setattr(codegen, 'MOST_UNROLLED_IN_PLANE', counted + more)
        assert build_system(model).is_unrolled is unrolled
    # Counted once: another process reads it.
    monkeypatch.setattr(routines, 'sizes', {})
    monkeypatch.setattr(routines, 'count_operations', None)
    assert unrolled_size(model, counted) == counted


def test_copies_work_on_arrays_of_their_own():
    rng, mechanism, q, qd = cases.drawn('three_rrr')
    system = build_system(build_model(mechanism))
    system.native.evaluate(q, qd)
    expected, other = system.qdd.copy(), copy.deepcopy(system)
    system.qdd[:] = 7.0
    assert other.applied is other.tau
    other.native.evaluate(q, qd)
    assert np.array_equal(other.qdd, expected)
    assert np.all(system.qdd == 7.0)


def branches(seed, number=5, length=150):
    """Return a routine that does the same with the numbers of several branches, and sums up."""
    graph = ExpressionGraph()
    results = []
    for branch in range(number):
        random = np.random.default_rng(seed)
        values = [graph.put(LOAD, Q, 6 * branch + k) for k in range(6)]
        for _ in range(length):
            one, other = (values[k] for k in random.integers(0, len(values), 2))
            kind = random.integers(0, 5)
            values.append((one * other + other, one - other, one * other, -one,
                           one / (other * other + 3.0))[kind])
        results.append(values[-8:])
    total = [sum(column[1:], column[0]) for column in zip(*results)]
    products = [one[0] * other[1] - one[2] * other[3] for one, other in zip(results, results[1:])]
    outputs = [value for part in (*results, total, products) for value in part]
    return Routine('whole', graph, [(0, place, value) for place, value in enumerate(outputs)])


@pytest.mark.parametrize('seed', cases.first(4, range(8)))
def test_vectors_of_branches_and_large_routines_round_as_single_numbers_do(seed, monkeypatch):
    made = branches(seed)
    assert packing_of(made, []) is not None
    random, found = np.random.default_rng(seed), []
    inputs = [random.normal(size=30) for _ in range(20)]
    for form, most in itertools.product((SCALAR, PACKED), (scheduling.MOST, 0)):
        monkeypatch.setattr(scheduling, 'MOST', most)
        address = machine_code(('branches', seed, most), lambda: [branches(seed)], form)('whole')
        run = ctypes.CFUNCTYPE(ctypes.c_int64, *3 * [ctypes.c_void_p])(address)
        out = np.zeros((len(inputs), len(made.outputs)))
        for q, row in zip(inputs, out):
            table = np.array([row.ctypes.data])
            run(table.ctypes.data, q.ctypes.data, q.ctypes.data)
        found.append(out)
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)


def test_machine_code_is_read_back(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, 'directory', lambda: tmp_path)
    made = []

    def halves():
        made.append(True)
        graph = ExpressionGraph()
        value = graph.put(LOAD, Q, 0)
        return [Routine('half', graph, [(QD, 0, value * 0.5)])]

    for _ in range(2):
        half = run(machine_code(('test', 1), halves, SCALAR)('half'), np.array([3.0]), np.zeros(1))
        assert half[0] == 1.5
    assert len(made) == 1
    # A file cut short by a full disk is no code: it is made again, where it is not in memory.
    path, = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:100])
    in_use = engines.pop(path.name.split('.')[1])
    half = run(machine_code(('test', 1), halves, SCALAR)('half'), np.ones(1), np.zeros(1))
    assert half[0] == 0.5
    assert len(made) == 2 and in_use


def test_code_that_takes_long_is_announced_before_it_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, 'directory', lambda: tmp_path)
    events = []

    def one(name, operations=1):
        def made():
            events.append(name)
            graph = ExpressionGraph()
            total = graph.put(LOAD, Q, 0)
            for n in range(operations):
                total = total + float(n + 1)
            return [Routine(name, graph, [(QD, 0, total)])]
        return made

    with announced_by(events.append):
        machine_code(('long', 1), one('short'), SCALAR)
        monkeypatch.setattr('closedloop_dynamics.codegen.machine_code.A_SECOND', 10)
        for _ in range(2):
            machine_code(('long', 2), one('long', 119), SCALAR)
    machine_code(('long', 3), one('unheard', 119), SCALAR)
    short, long, announced, unheard = events
    assert (short, long, unheard) == ('short', 'long', 'unheard')
    assert 'may take 12 s' in announced


def run(address, inputs, outputs):
    """Call a routine that needs no function table."""
    function = ctypes.CFUNCTYPE(ctypes.c_int64, *3 * [ctypes.c_void_p])(address)
    function(None, inputs.ctypes.data, outputs.ctypes.data)
    return outputs


@pytest.fixture(scope='module')
def turned():
    """Return a function to the sines and cosines of seven angles."""
    def waves():
        graph = ExpressionGraph()
        angles = [graph.put(LOAD, Q, k) for k in range(7)]
        return [Routine('waves', graph, [
            (QD, 2 * k + n, (sine, cosine)[n](angle))
            for k, angle in enumerate(angles) for n in range(2)])]

    address = machine_code(('test of sines', 1), waves, SCALAR)('waves')
    return lambda angles: run(address, np.array(angles), np.zeros(14)).reshape(7, 2)


def exact(angles):
    """Return sines and cosines of the C library, which rounds almost always correctly."""
    return np.array([[math.sin(angle), math.cos(angle)] for angle in angles])


@pytest.mark.parametrize('size', [1e-300, 1e-8, 0.1, 1.0, 10.0, 1e3, 1e6])
def test_sines_and_cosines_are_those_of_the_library(turned, size):
    rng = np.random.default_rng(int(-math.log10(size)) % 100)
    for _ in range(2000):
        angles = size * rng.uniform(-1.5, 1.5, 7)
        expected = exact(angles)
        # One unit in the last place; near a zero pi/2's parts left out, times the turns.
        assert np.all(np.abs(turned(angles) - expected)
                      <= 2.3e-16 * np.abs(expected) + 1e-17 + 1e-23 * size)


def test_sines_near_multiples_of_a_quarter_turn(turned):
    for turns in range(-30000, 30000, 7):
        angles = (turns + np.arange(7)) * (math.pi / 2)
        expected = exact(angles)
        assert np.all(np.abs(turned(angles) - expected) <= 2.3e-16 * np.abs(expected) + 1e-17)


@pytest.mark.parametrize('odd', [2e6, -1e9, 1e22, math.inf, -math.inf, math.nan])
def test_angles_beyond_the_vectors_reach_are_left_to_the_library(turned, odd):
    angles = np.array([0.5, odd, 1.0, -2.0, 3.0, 0.0, 1e6])
    found = turned(angles)
    with np.errstate(invalid='ignore'):
        expected = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    assert np.allclose(found, expected, rtol=2.3e-16, atol=0.0, equal_nan=True)


@pytest.fixture(scope='module', params=[SCALAR, PACKED, LANES], ids=lambda form: form[1])
def angles_of(request):
    """Return a function to the angles of 24 points, and half of three of these angles."""
    side_by_side = 8 if request.param == LANES else 1
    each = 24 // side_by_side

    def turns():
        graph = ExpressionGraph()
        points = [[graph.put(LOAD, Q, 2 * k + n) for n in range(2)] for k in range(each)]
        angles = [arctangent(*point) for point in points]
        again = [arctangent(sine(0.5 * angle), cosine(0.5 * angle)) for angle in angles[:3]]
        return [Routine('turns', graph, [
            (QD, place, angle) for place, angle in enumerate(angles + again)])]

    address = machine_code(('test of arctangents', 1), turns, request.param)('turns')

    def angles(points):
        """Take numbers of shape (24, 2), the second of each first."""
        inputs = points.reshape(each, side_by_side, 2).swapaxes(1, 2).ravel()
        found = run(address, inputs, np.zeros((each + 3) * side_by_side))
        return np.split(found, [24])
    return angles


@pytest.mark.parametrize('size', [1e-300, 1e-150, 1e-16, 1e-8, 1e-3, 0.5, 1.0, 1e3, 1e160])
def test_arctangents_are_those_of_the_library_in_all_quadrants(angles_of, size):
    rng = np.random.default_rng(int(-math.log10(size)) % 100)
    for _ in range(300):
        points = rng.uniform(-1.0, 1.0, (24, 2)) * (size, 1.0)
        for y, x in (points.T, points.T[::-1]):
            expected = np.arctan2(y, x)
            found, halves = angles_of(np.stack([y, x], axis=1))
            assert np.all(np.abs(found - expected) <= 2.0 * np.spacing(np.abs(expected)))
            assert np.all(np.abs(halves - 0.5 * expected[:len(halves)]) < 5e-16)


def test_arctangents_of_special_points(angles_of):
    numbers = (0.0, -0.0, 1.0, -1.0, 5e-324, -5e-324, 1e308, math.inf, -math.inf, math.nan)
    points = [(y, x) for y in numbers for x in numbers if not (math.isinf(y) and math.isinf(x))]
    for first in range(0, len(points), 24):
        block = np.resize(points[first:first + 24], (24, 2))
        expected = np.arctan2(*block.T)
        found, _ = angles_of(block)
        np.testing.assert_allclose(found, expected, rtol=4.5e-16, atol=0.0)
        known = ~np.isnan(expected)
        np.testing.assert_array_equal(np.signbit(found)[known], np.signbit(expected)[known])
    assert np.isnan(angles_of(np.full((24, 2), math.inf))[0]).all()


def test_operations_in_order_of_urgency_follow_their_operands():
    graph = ExpressionGraph()
    one, other, third = (graph.put(LOAD, Q, k) for k in range(3))
    many = other
    for _ in range(5):
        many = many * third + one
    last = one / other - many
    groups = [(place,) for place in range(len(graph.operations))]
    found = [place for place, in scheduling.by_urgency(graph.operations, groups, {many.place})]
    # The chain that is known, and loads, are left out; the rest has operands before users.
    chain = [place for place, (kind, *_) in enumerate(graph.operations) if kind != LOAD]
    assert sorted(found) == [place for place in chain if place != many.place]
    for n, place in enumerate(found):
        assert {one for one in graph.operations[place][1:] if one in found} <= set(found[:n])
    # What everything waits for longest comes first.
    found = [place for place, in scheduling.by_urgency(graph.operations, groups, ())]
    assert graph.operations[found[0]][0] == MULTIPLY and found[-1] == last.place


def test_operations_of_large_routines_wait_unless_their_operands_would(monkeypatch):
    monkeypatch.setattr(scheduling, 'MOST', 0)
    graph = ExpressionGraph()
    one, other, third = (graph.put(LOAD, Q, k) for k in range(3))
    ratio = one / other
    # In the place of two numbers that nothing else needs one waits.
    factors = one * third, other - third
    product = factors[0] * factors[1]
    last = product + ratio
    found = scheduling.by_urgency(
        graph.operations, [(place,) for place in range(len(graph.operations))], ())
    assert [place for place, in found] == [
        value.place for value in (*factors, product, ratio, last)]
