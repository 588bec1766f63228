# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Pieces of the loops where there is no compiler."""

import math
import operator

from .expression_graph import (
    ADD, BOTH, CHOOSE, COSINE, DIVIDE, GREATER_EQUAL, LESS, LOAD, MULTIPLY, NEGATE, SINE,
    SUBTRACT)

OPERATIONS = {
    ADD: operator.add, SUBTRACT: operator.sub, MULTIPLY: operator.mul, NEGATE: operator.neg,
    SINE: math.sin, COSINE: math.cos, LESS: operator.lt, GREATER_EQUAL: operator.ge,
    BOTH: operator.and_, CHOOSE: lambda condition, yes, no: yes if condition else no}


def _divide(a, b):
    # As compiled code does: no exception.
    return a / b if b else math.copysign(math.inf, a) if a else math.nan


OPERATIONS[DIVIDE] = _divide
_all = []


class Interpreted:
    """
    A piece that Python carries out.

    Parameters
    ----------
    routine : expression_graph.Routine
        Its arithmetic.

    Attributes
    ----------
    number : int
        What stands for its address.

    """

    def __init__(self, routine):
        """Keep what is needed."""
        needed = sorted(routine.needed())
        self._operations = [(place, routine.graph.operations[place]) for place in needed]
        self._outputs = [(source, place, getattr(value, 'place', None), value)
                         for source, place, value in routine.outputs]
        self.number = len(_all)
        _all.append(self)

    def __call__(self, rows):
        """Carry it out on rows: pairs of an array of one dimension and a place in it."""
        values = {}
        for place, (kind, *operands) in self._operations:
            if kind == LOAD:
                row, first = rows[operands[0]]
                values[place] = row[first + operands[1]]
            else:
                values[place] = OPERATIONS[kind](*(
                    values[o] if isinstance(o, int) else o for o in operands))
        for source, place, known, value in self._outputs:
            row, first = rows[source]
            row[first + place] = value if known is None else values[known]


def run(piece, *arguments):
    """Do as ``function_table``.run_piece`` does."""
    pairs = zip(arguments[::2], arguments[1::2])
    _all[piece]([(array[place], 0) if array.ndim > 1 else (array, place)
                 for array, place in pairs])
    return 1
