# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions f(x) of couplings, as numbers of a row of ``Model.cut_point`` behind the factors.

How long the operations of f are, these, and the numbers that they use. An operation is its code
and its operands: 0 is x, 1, 2, ... are results of operations before it, -1, -2, ... the numbers.
Operations are structure, numbers are loads, so that tuning compiles nothing.
"""

from .differentiation import differentiated
from .expression_graph import (
    ADD, AGAIN, CHOOSE, COSINE, EXPONENTIAL, ExpressionGraph, LOAD, LOGARITHM, NEGATE, Q, replayed,
    SINE, SQUARE_ROOT, Symbol)
from .function_table import CUT_POINT
from ..engine.types import BODY_A, CUT_COUPLING, CUT_TYPE, FACTORS, PATH_A, PATH_END

_OPERANDS = {CHOOSE: 3, **dict.fromkeys(
    (NEGATE, SINE, COSINE, SQUARE_ROOT, EXPONENTIAL, LOGARITHM), 1)}


def numbers_of(function):
    """Return the numbers that a function of a symbol is written as, a list of floats."""
    graph, found, used = ExpressionGraph(), [], []
    value = function(graph.put(LOAD, Q, 0))
    # The last operation is the value.
    graph.put(ADD, value.place if isinstance(value, Symbol) else float(value), 0.0)
    for kind, *operands in graph.operations[1:]:
        for n, one in enumerate(operands):
            if not isinstance(one, int):
                used.append(one)
                operands[n] = -len(used)
        found += [kind, *operands]
    return [float(one) for one in (len(found), *found, *used)]


def with_law(cut):
    """Return whether a row of ``Model.cut`` is a coupling with a function: of body A's joint."""
    return cut[CUT_TYPE] == CUT_COUPLING and cut[BODY_A] > 0


def structure(model):
    """Return where the operations of each function are, and these: a tuple of arrays."""
    return tuple(values[first - 1:first + length]
                 for values, (first, length) in (
                     (values, _place(cut, values))
                     for cut, values in zip(model.cut, model.cut_point) if with_law(cut)))


def _place(cut, values):
    """Return where the operations are in a row, and how long."""
    first = FACTORS + int(cut[PATH_END] - cut[PATH_A]) + 1
    return first, int(values[first - 1])


def law_of(cut, values, symbols):
    """
    Return the row of a joint, and f, f' and f'' as a function of a symbol; None without.

    ``cut``, ``values``: rows of ``Model.cut`` and ``Model.cut_point``; ``symbols``: of the latter.
    """
    if not with_law(cut):
        return None
    first, length = _place(cut, values)
    operations = iter(values[first:first + length].astype(int).tolist())
    graph = ExpressionGraph()
    known = [graph.put(LOAD, Q, 0)]
    for kind in operations:
        operands = [next(operations) for _ in range(_OPERANDS.get(kind, 2))]
        known.append(AGAIN[kind](*(
            known[one] if one >= 0 else graph.put(LOAD, CUT_POINT, first + length - 1 - one)
            for one in operands)))
    found = [known[-1]]
    for _ in range(2):
        found += differentiated(graph, found[-1:], {known[0].place: 1.0})
    return int(cut[BODY_A]), lambda x: replayed(
        graph, found, lambda source, place: x if source == Q else symbols[place])
