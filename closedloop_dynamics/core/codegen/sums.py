# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
In which order the terms of sums are added, so that little waits for the terms that come last.

A sum is traced term by term, and the first terms are often those that take longest. Here the two
that are known first are added first, until one is left. What is added is the same.
"""

from collections import Counter
import heapq

from .expression_graph import (
    ADD, AGAIN, BOTH, CALL, ExpressionGraph, LOAD, MULTIPLY, Routine, SUBTRACT, Symbol)
from .scheduling import latency, MOST

_SUMS = ADD, SUBTRACT
# Cycles from the operands of a product to the sum that it is fused with.
_FUSED = 4


def balanced(routine):
    """
    Return a routine with its sums in another order.

    As it is where functions of the engine are asked, and where so many operations are to do that
    they keep a processor busy in any order.
    """
    graph, places = routine.graph, sorted(routine.needed())
    if len(places) > MOST or any(graph.operations[place][0] == CALL for place in places):
        return routine
    return _Balanced(routine, places).routine()


class _Balanced:
    """
    Operations in a new graph; ``known``: results by old places, ``ready``: cycles by new ones.

    ``inner``: places of sums that are terms of another one alone.
    """

    def __init__(self, routine, places):
        self._routine, self._operations = routine, routine.graph.operations
        self._graph, self._known, self._ready = ExpressionGraph(), {}, {}
        results = [routine.graph.guard, *(value for _, _, value in routine.outputs)]
        self._uses, users = Counter(
            value.place for value in results if isinstance(value, Symbol)), {}
        # A result is no term of a sum.
        self._uses.update(self._uses)
        for place in places:
            for one in self._operands(place):
                self._uses[one] += 1
                users[one] = place
        self._inner = {place for place in places if self._uses[place] == 1 and all(
            map(self._is_free, (place, users[place])))}
        for place in places:
            if place not in self._inner:
                self._known[place] = self._again(place, *self._operations[place])

    def _is_free(self, place):
        """Return whether a sum may be in any order: adding large numbers rounds on purpose."""
        kind, *operands = self._operations[place]
        return kind in _SUMS and not any(isinstance(one, float) for one in operands)

    def _operands(self, place):
        kind, *operands = self._operations[place]
        return [one for one in operands if isinstance(one, int)] if kind != LOAD else []

    def _again(self, place, kind, *operands):
        """Return the result of an operation in the new graph."""
        if kind == LOAD:
            return self._graph.put(kind, *operands)
        if kind in _SUMS:
            return self._sum([*self._terms(place, 1)])
        values = [self._value(one) for one in operands]
        if kind == BOTH:
            return self._graph.put(kind, *(value.place for value in values))
        return self._timed(AGAIN[kind](*values), max(map(self._time, values)) + latency(kind))

    def _value(self, operand):
        return self._known[operand] if isinstance(operand, int) else operand

    def _time(self, value):
        return self._ready.get(value.place, 0) if isinstance(value, Symbol) else 0

    def _timed(self, value, cycles):
        """Return a value, and keep when it is ready."""
        if isinstance(value, Symbol):
            self._ready.setdefault(value.place, cycles)
        return value

    def _terms(self, place, sign):
        """Yield signs and operands of a sum."""
        kind, *operands = self._operations[place]
        for one, own in zip(operands, (sign, -sign if kind == SUBTRACT else sign)):
            if one in self._inner and isinstance(one, int):
                yield from self._terms(one, own)
            else:
                yield own, one

    def _sum(self, terms):
        """Return a sum of terms with signs."""
        left = []
        for number, (sign, operand) in enumerate(terms):
            value, fused = self._value(operand), False
            if isinstance(value, Symbol) and self._uses[operand] == 1:
                kind, *factors = self._graph.operations[value.place]
                fused = kind == MULTIPLY
            ready = max((self._ready.get(one, 0) for one in factors if isinstance(one, int)),
                        default=0) if fused else self._time(value)
            left.append((ready, number, fused, sign, value))
        heapq.heapify(left)
        while len(left) > 1:
            one, other = heapq.heappop(left), heapq.heappop(left)
            # One product is fused with the sum; another one is there before.
            ready = max(other[0], one[0] + latency(MULTIPLY) * (one[2] and other[2])) + (
                _FUSED if one[2] or other[2] else latency(ADD))
            first, second = (one, other) if one[3] >= other[3] else (other, one)
            kind = ADD if first[3] == second[3] else SUBTRACT
            value = self._timed(AGAIN[kind](first[4], second[4]), ready)
            heapq.heappush(left, (ready, len(terms) + len(left), False, first[3], value))
        (_, _, _, sign, value), = left
        return value if sign > 0 else -value

    def routine(self):
        """Return the routine in the new graph."""
        one = self._routine
        if one.graph.guard is not None:
            self._graph.guard = self._known[one.graph.guard.place]
        return Routine(one.name, self._graph, [
            (source, place, self._known[value.place] if isinstance(value, Symbol) else value)
            for source, place, value in one.outputs], one.otherwise)
