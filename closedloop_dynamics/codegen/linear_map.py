# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Arithmetic that is linear in an input, computed again and again with the same coefficients.

An intermediate result is left out where its terms, put in the place of it, save more than the
products of coefficients cost: elimination of vertices of a linear computational graph (Griewank
and Walther, Evaluating Derivatives, 2nd ed. (2008), section 9.2), ended before all are left out.
"""

import heapq

from .differentiation import shares
from .expression_graph import ExpressionGraph, LOAD, needed_for, NEGATE, Q, Symbol

# Products of coefficients, once, that a term which is saved again and again may cost. Measured on
# a Stewart platform of two times LANES weights: with twice or half as many they take longer.
WORTH = 4


class _LinearMap:
    """
    Results as sums of terms, an earlier result times a coefficient, from an input on.

    ``terms``: coefficients by the places of earlier results, by the place of the result;
    ``users``: places of results that have a term with one, by its place.
    """

    def __init__(self, graph, values, source):
        self._stored = {one.place for one in values if isinstance(one, Symbol)}
        self.terms, self.users = {}, {}
        for place in sorted(needed_for(graph.operations, self._stored)):
            kind, *operands = graph.operations[place]
            found = {} if kind == LOAD else shares(graph, place, self.terms)
            if found or kind == LOAD and operands[0] == source:
                self.terms[place], self.users[place] = found, set()
                for one in found:
                    self.users[one].add(place)

    def shorten(self):
        """Leave out the intermediate results that cost more than they save."""
        waiting = []

        def ask(place):
            if self.terms[place] and place not in self._stored:
                heapq.heappush(waiting, (-self._gain(place), place))

        for place in self.terms:
            ask(place)
        while waiting:
            loss, place = heapq.heappop(waiting)
            if place not in self.terms:
                continue
            now = -self._gain(place)
            if now > loss:
                heapq.heappush(waiting, (now, place))
            elif now <= 0:
                for one in self._leave_out(place):
                    ask(one)

    def _gain(self, place):
        """Return what leaving out a result saves, in products of coefficients."""
        terms, users = self.terms[place], self.users[place]
        new = sum(one not in self.terms[user] for user in users for one in terms)
        return WORTH * (len(terms) + len(users) - new) - len(terms) * len(users)

    def _leave_out(self, place):
        """Put the terms of a result in its place; return the places of results beside it."""
        terms, users = self.terms.pop(place), self.users.pop(place)
        for one in terms:
            self.users[one].update(users)
            self.users[one].remove(place)
        for user in users:
            found = self.terms[user]
            share = found.pop(place)
            for one, value in terms.items():
                found[one] = found.get(one, 0.0) + share * value
        return [*terms, *users]


def divided(graph, values, source, shared):
    """
    Compute the share of values that is linear in an input in a graph of its own.

    The input ``source`` is Q in the new graph, which does not ask for the guard of the first one.
    Returns the shares, of the new graph, and their coefficients, results of the first graph, by
    their places in the input ``shared``.
    """
    found, after, known, places = _LinearMap(graph, values, source), ExpressionGraph(), {}, {}
    found.shorten()

    def coefficient(value):
        if not isinstance(value, Symbol):
            return value
        kind, *operands = graph.operations[value.place]
        if kind == NEGATE:
            return -coefficient(Symbol(graph, operands[0]))
        return after.put(LOAD, shared, places.setdefault(value.place, len(places)))

    for place in sorted(found.terms):
        kind, *operands = graph.operations[place]
        known[place] = after.put(LOAD, Q, operands[1]) if kind == LOAD else sum(
            coefficient(value) * known[one] for one, value in found.terms[place].items())
    return [known.get(one.place, 0.0) if isinstance(one, Symbol) else 0.0 for one in values], [
        Symbol(graph, place) for place in places]
