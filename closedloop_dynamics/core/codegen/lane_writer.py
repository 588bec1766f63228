# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Writer of traced arithmetic on LLVM vectors, with one state in each lane."""

from . import sincos
from .emit import Writer
from .expression_graph import COSINE, LOAD, SINE
from .function_table import BAUMGARTE, LANES, SHARED
from .llvm_text import DOUBLE, integer, numbers, vector_of, WORD

_VECTOR, _BITS = vector_of(DOUBLE, LANES), f'i{LANES}'
# Arrays begin at any number: a vector is not where its own size divides the address.
_ALIGNED = ', align 8'


class LaneWriter(Writer):
    """
    Writes one routine for several states at once.

    It returns 0 where the results of any lane are not to be used.
    """

    ROOT = f'llvm.sqrt.v{LANES}f64'

    def call(self, name, *numbers):
        """Return the result of a function: LLVM's of vectors, others lane by lane."""
        if name == self.ROOT:
            return super().call(name, *numbers)
        take = self.function.take
        return self.function.gather([
            self.function.call(name, [take(each, lane) for each in numbers])
            for lane in range(LANES)])

    def number(self, operand):
        """Return the vector of an operand."""
        if isinstance(operand, int):
            return self.values[operand]
        return numbers([operand] * LANES)

    def place(self, source, place):
        """Return the address of a number of all lanes."""
        return self.function.convert(
            'bitcast', self.address(source, LANES * place), f'{_VECTOR}*')

    def load(self, source, place):
        """Read a number of all lanes, or one that they share."""
        if source not in (BAUMGARTE, SHARED):
            return self.function.load(self.place(source, place), _ALIGNED)
        return self.function.repeat(self.function.load(self.address(source, place)), LANES)

    def write(self):
        """Write the function."""
        operations, use = self.routine.graph.operations, self.routine.needed()
        turned, within = {}, []
        for place, (kind, *operands) in enumerate(operations):
            if place not in use:
                continue
            if kind in (SINE, COSINE):
                angle = operands[0]
                if angle not in turned:
                    value = self.values[angle]
                    turned[angle] = sincos.polynomials(self.function, value, LANES)
                    within.append(sincos.within(self.function, value, LANES))
                self.values[place] = turned[angle][kind == COSINE]
            else:
                self.values[place] = (self.load(*operands) if kind == LOAD
                                      else self.operation(kind, *operands))
        guard = self.routine.graph.guard
        for condition in [] if guard is None else [self.values[guard.place]]:
            within.append(condition)
        good = integer(-1, _BITS)
        for condition in within:
            good = self.function.binary(
                'and', good, self.function.convert('bitcast', condition, _BITS))
        good = self.function.compare('icmp eq', good, integer(-1, _BITS))
        self.go_on_if(good)
        for source, place, value in self.routine.outputs:
            known = value.place if hasattr(value, 'place') else float(value)
            self.function.store(self.number(known), self.place(source, place), _ALIGNED)
        self.function.end(self.function.convert('zext', good, WORD))
