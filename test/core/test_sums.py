# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Sums in another order are the same sums, and wait for less."""

from closedloop_dynamics.core.codegen.expression_graph import (
    ADD, DIVIDE, ExpressionGraph, LOAD, Q, Routine)
from closedloop_dynamics.core.codegen.scheduling import MOST
from closedloop_dynamics.core.codegen.sums import balanced
import numpy as np

from .spatial_engine import interpret

OUT = 0
ROUNDER = 6755399441055744.0


def made(count):
    """Return a graph and loads of so many numbers."""
    graph = ExpressionGraph()
    return graph, [graph.put(LOAD, Q, place) for place in range(count)]


def value(routine, numbers):
    outputs, good = interpret(routine, {Q: np.array(numbers)})
    return outputs[OUT][0], good


def sums_behind(routine, place):
    """Return how many sums in a row follow on an operation, at most."""
    operations, behind = routine.graph.operations, {place: 0}
    for number in range(place + 1, len(operations)):
        kind, *operands = operations[number]
        before = [behind[one] for one in operands if kind != LOAD and one in behind]
        if before:
            behind[number] = max(before) + (kind == ADD)
    return max(behind.values())


def test_what_is_known_last_is_added_last():
    graph, (a, b, c, d, e) = made(5)
    late = 1.0 / (1.0 / a)
    before = Routine('sum', graph, [(OUT, 0, late + b + c + d * e)])
    after = balanced(before)
    assert sums_behind(before, late.place) == 3
    late = max(place for place, operation in enumerate(after.graph.operations)
               if operation[0] == DIVIDE)
    assert sums_behind(after, late) == 1
    assert value(after, [2.0, 3.0, 5.0, 7.0, 11.0]) == (87.0, True)


def test_signs_products_and_guards_are_kept():
    random = np.random.default_rng(3)
    graph, (a, b, c, d, e, f) = made(6)
    shared = a * b - c
    total = -(d - (e * f - (a - shared * b))) - (c * d - (e + (b - f * a))) - shared
    bool(total - a < b + c)
    before = Routine('sum', graph, [(OUT, 0, total), (OUT, 1, shared)])
    after = balanced(before)
    for _ in range(20):
        numbers = random.normal(size=6)
        (expected, good), (found, as_good) = value(before, numbers), value(after, numbers)
        assert good == as_good
        # Of some ten terms near one.
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14 * 10.0 * (
            1.0 + np.abs(numbers).max() ** 3))


def test_numbers_are_rounded_where_that_is_meant():
    graph, (a, b, c) = made(3)
    rounded = a + b + ROUNDER - ROUNDER + c
    after = balanced(Routine('rounded', graph, [(OUT, 0, rounded)]))
    assert value(after, [1.25, 2.5, 0.125])[0] == 4.125


def test_long_routines_are_left_as_they_are():
    graph, numbers = made(MOST + 1)
    long = Routine('sum', graph, [(OUT, 0, sum(numbers, 0.0))])
    assert balanced(long) is long
