# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of arithmetic on symbols, as more of it: forward, in one direction."""

from .expression_graph import (
    ADD, ARCTANGENT, CHOOSE, chosen, COSINE, DIVIDE, EXPONENTIAL, LOAD, LOGARITHM, logarithm,
    MULTIPLY, NEGATE, POWER, SINE, SQUARE_ROOT, SUBTRACT, Symbol)


def differentiated(graph, values, seed):
    """
    Return the derivatives of values in one direction, as further operations of their graph.

    Parameters
    ----------
    graph : ExpressionGraph
        More is put into it.
    values : sequence of Symbol or float
        To be differentiated.
    seed : dict of int to number
        What inputs change by, by the places of their symbols.

    Returns
    -------
    list of Symbol or float

    """
    known, operations = dict(seed), graph.operations

    def symbol(operand):
        return Symbol(graph, operand) if isinstance(operand, int) else operand

    def change(operand):
        return known.get(operand, 0.0) if isinstance(operand, int) else 0.0

    last = max((value.place for value in values if isinstance(value, Symbol)), default=-1)
    for place in range(min(seed), last + 1):
        kind, *operands = operations[place]
        if kind == LOAD or not any(
                isinstance(one, int) and one in known for one in operands):
            continue
        changes = [change(one) for one in operands]
        if kind in (ADD, SUBTRACT):
            found = changes[0] + changes[1] if kind == ADD else changes[0] - changes[1]
        elif kind == MULTIPLY:
            found = changes[0] * symbol(operands[1]) + symbol(operands[0]) * changes[1]
        elif kind == DIVIDE:
            found = (changes[0] - Symbol(graph, place) * changes[1]) / symbol(operands[1])
        elif kind == NEGATE:
            found = 0.0 - changes[0]
        elif kind == SINE:
            found = graph.put(COSINE, operands[0]) * changes[0]
        elif kind == COSINE:
            found = 0.0 - graph.put(SINE, operands[0]) * changes[0]
        elif kind == SQUARE_ROOT:
            found = 0.5 * changes[0] / Symbol(graph, place)
        elif kind == EXPONENTIAL:
            found = changes[0] * Symbol(graph, place)
        elif kind == LOGARITHM:
            found = changes[0] / symbol(operands[0])
        elif kind == ARCTANGENT:
            y, x = map(symbol, operands)
            found = (changes[0] * x - changes[1] * y) / (x * x + y * y)
        elif kind == POWER:
            found = _of_power(*map(symbol, operands), *changes)
        elif kind == CHOOSE:
            found = chosen(symbol(operands[0]), *changes[1:])
        else:
            # A comparison jumps, or stays.
            continue
        if isinstance(found, Symbol) or found != 0.0:
            known[place] = found
    return [known.get(value.place, 0.0) if isinstance(value, Symbol) else 0.0 for value in values]


def _of_power(base, exponent, of_base, of_exponent):
    """Return the change of a power by those of base and exponent; a zero has no part in it."""
    found = 0.0
    if isinstance(of_base, Symbol) or of_base != 0.0:
        found = exponent * base ** (exponent - 1.0) * of_base
    if isinstance(of_exponent, Symbol) or of_exponent != 0.0:
        found = found + base ** exponent * logarithm(base) * of_exponent
    return found
