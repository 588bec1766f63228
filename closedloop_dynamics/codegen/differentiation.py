# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of arithmetic on symbols, as more of it: forward in one direction, or reverse."""

from .expression_graph import (
    ADD, ARCTANGENT, BOTH, CHOOSE, chosen, COSINE, DIVIDE, EXPONENTIAL, GREATER_EQUAL, LESS, LOAD,
    LOGARITHM, logarithm, MULTIPLY, NEGATE, POWER, SINE, SQUARE_ROOT, SUBTRACT, Symbol)

# Nothing changes with the operands of these: a comparison jumps, or stays.
NOT_SMOOTH = LOAD, LESS, GREATER_EQUAL, BOTH


def differentiated(graph, values, seed):
    """
    Return the derivatives of values in one direction, as further operations of their graph.

    ``seed``: changes of inputs, by the places of their symbols.
    """
    known, operations = dict(seed), graph.operations
    for place in range(min(seed, default=0), _last(values) + 1):
        kind, *operands = operations[place]
        if kind in NOT_SMOOTH or not any(_is_among(one, known) for one in operands):
            continue
        found = _of_one(graph, place, [
            known[one] if _is_among(one, known) else 0.0 for one in operands])
        if isinstance(found, Symbol) or found != 0.0:
            known[place] = found
    return [known.get(value.place, 0.0) if isinstance(value, Symbol) else 0.0 for value in values]


def gradients(graph, values, weights, inputs):
    """
    Return the derivatives of a weighted sum of values by inputs, by one pass in reverse.

    Weights are constant, inputs symbols that are loaded; more is put into the graph.
    """
    operations, found = graph.operations, {}
    # What does not depend on the inputs has no part in it.
    moves = {one.place for one in inputs}
    for place in range(_last(values) + 1):
        kind, *operands = operations[place]
        if kind not in NOT_SMOOTH and any(_is_among(one, moves) for one in operands):
            moves.add(place)
    for value, weight in zip(values, weights):
        if isinstance(value, Symbol) and value.place in moves:
            found[value.place] = found.get(value.place, 0.0) + weight
    for place in range(_last(values), -1, -1):
        kind, *operands = operations[place]
        if kind == LOAD or place not in found:
            continue
        weight = found.pop(place)
        for number, one in enumerate(operands):
            if _is_among(one, moves):
                share = _of_one(graph, place, [
                    weight if number == n else 0.0 for n in range(len(operands))])
                found[one] = found.get(one, 0.0) + share
    return [found.get(one.place, 0.0) for one in inputs]


def shares(graph, place, among):
    """Return what a result changes by with each of its operands that is among some places."""
    _, *operands = graph.operations[place]
    found = {}
    for number, one in enumerate(operands):
        if _is_among(one, among):
            found[one] = found.get(one, 0.0) + _of_one(graph, place, [
                1.0 if number == n else 0.0 for n in range(len(operands))])
    return found


def _last(values):
    """Return the last place on which values depend."""
    return max((value.place for value in values if isinstance(value, Symbol)), default=-1)


def _is_among(operand, places):
    """Return whether an operand, a place or a number, is one of some places."""
    return isinstance(operand, int) and operand in places


def _of_one(graph, place, changes):
    """
    Return the change of the result of an operation by those of its operands.

    The same number, of one change alone, is what that operand gets of a weight of the result.
    """
    kind, *operands = graph.operations[place]

    def symbol(number):
        operand = operands[number]
        return Symbol(graph, operand) if isinstance(operand, int) else operand

    if kind == ADD:
        return changes[0] + changes[1]
    if kind == SUBTRACT:
        return changes[0] - changes[1]
    if kind == MULTIPLY:
        return changes[0] * symbol(1) + symbol(0) * changes[1]
    if kind == DIVIDE:
        return (changes[0] - Symbol(graph, place) * changes[1]) / symbol(1)
    if kind == NEGATE:
        return 0.0 - changes[0]
    if kind == SINE:
        return graph.put(COSINE, operands[0]) * changes[0]
    if kind == COSINE:
        return 0.0 - graph.put(SINE, operands[0]) * changes[0]
    if kind == SQUARE_ROOT:
        return 0.5 * changes[0] / Symbol(graph, place)
    if kind == EXPONENTIAL:
        return changes[0] * Symbol(graph, place)
    if kind == LOGARITHM:
        return changes[0] / symbol(0)
    if kind == ARCTANGENT:
        y, x = symbol(0), symbol(1)
        return (changes[0] * x - changes[1] * y) / (x * x + y * y)
    if kind == POWER:
        return _of_power(symbol(0), symbol(1), *changes)
    assert kind == CHOOSE
    return chosen(symbol(0), *changes[1:])


def _of_power(base, exponent, of_base, of_exponent):
    """Return the change of a power by those of base and exponent; a zero has no part in it."""
    found = 0.0
    if isinstance(of_base, Symbol) or of_base != 0.0:
        found = exponent * base ** (exponent - 1.0) * of_base
    if isinstance(of_exponent, Symbol) or of_exponent != 0.0:
        found = found + base ** exponent * logarithm(base) * of_exponent
    return found
