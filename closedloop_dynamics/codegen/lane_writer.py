# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Writer of traced arithmetic on LLVM vectors, with one state in each lane."""

from . import sincos
from .emit import Writer
from .expression_graph import COSINE, LOAD, Q, QD, SINE
from .function_table import BAUMGARTE, LANES, PLACES, SHARED
from .llvm_text import BIT, DOUBLE, integer, numbers, vector_of, WORD

# Arrays begin at any number: a vector is not where its own size divides the address.
_ALIGNED = ', align 8'


class LaneWriter(Writer):
    """
    Writes one routine for several states at once.

    It returns 0 where the results of any lane are not to be used.
    """

    LANES, ROOT = LANES, f'llvm.sqrt.v{LANES}f64'

    def __init__(self, routine, declared):
        super().__init__(routine, declared)
        self._vector, self._bits = vector_of(DOUBLE, self.LANES), f'i{self.LANES}'

    def is_shared(self, source):
        """Whether all lanes have an input in common."""
        return source in (BAUMGARTE, SHARED)

    def call(self, name, *numbers):
        """Return the result of a function: LLVM's of vectors, others lane by lane."""
        if name == self.ROOT:
            return super().call(name, *numbers)
        take = self.function.take
        return self.function.gather([
            self.function.call(name, [take(each, lane) for each in numbers])
            for lane in range(self.LANES)])

    def number(self, operand):
        """Return the vector of an operand."""
        if isinstance(operand, int):
            return self.values[operand]
        return numbers([operand] * self.LANES)

    def place(self, source, place):
        """Return the address of a number of all lanes."""
        return self.function.convert(
            'bitcast', self.address(source, self.LANES * place), f'{self._vector}*')

    def load(self, source, place):
        """Read a number of all lanes, or one that they share."""
        if not self.is_shared(source):
            return self.function.load(self.place(source, place), _ALIGNED)
        return self.function.repeat(self.function.load(self.address(source, place)), self.LANES)

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
                    turned[angle] = sincos.polynomials(self.function, value, self.LANES)
                    within.append(sincos.within(self.function, value, self.LANES))
                self.values[place] = turned[angle][kind == COSINE]
            else:
                self.values[place] = (self.load(*operands) if kind == LOAD
                                      else self.operation(kind, *operands))
        guard = self.routine.graph.guard
        for condition in [] if guard is None else [self.values[guard.place]]:
            within.append(condition)
        lanes = integer(-1, self._bits)
        for condition in within:
            lanes = self.function.binary(
                'and', lanes, self.function.convert('bitcast', condition, self._bits))
        good = self.function.compare('icmp eq', lanes, integer(-1, self._bits))
        self.go_on_if(good, lanes)
        for (source, place, _), result in zip(self.routine.outputs, self.results()):
            self.function.store(result, self.place(source, place), _ALIGNED)
        self.function.end(self.function.convert('zext', good, WORD))

    def results(self):
        """Return the vectors of the outputs."""
        return [self.number(value.place if hasattr(value, 'place') else float(value))
                for _, _, value in self.routine.outputs]

    def go_on_if(self, good, lanes):
        """
        Leave the rest to the other routine, unless all ``lanes`` are good.

        Those that are keep their own results, as each would alone.
        """
        if self.routine.otherwise is None:
            return
        here, other = self.function.blocks('good', 'otherwise')
        self.function.branch_if(good, here, other)
        # What the block below finds the addresses of is not known in the other one.
        known, function = dict(self.pointers), self.function
        function.begin(other)
        # Nothing that is in registers without the call is to go to memory for its sake.
        room = function.room(DOUBLE, self.LANES * len(self.routine.outputs))
        kept = [function.convert(
            'bitcast', function.address(room, self.LANES * n), f'{self._vector}*')
                for n in range(len(self.routine.outputs))]
        for result, address in zip(self.results(), kept):
            function.store_here(result, address, _ALIGNED)
        answer = function.call_like(self.routine.otherwise.name)
        some = function.convert('bitcast', lanes, vector_of(BIT, self.LANES))
        for (source, place, _), own in zip(self.routine.outputs, kept):
            address = self.place(source, place)
            function.store(function.select(
                some, function.load(own, _ALIGNED), function.load(address, _ALIGNED)),
                address, _ALIGNED)
        function.end(answer)
        self.pointers = known
        self.function.begin(here)


class PlaceWriter(LaneWriter):
    """Writes one routine for several states of one mechanism, which share all else."""

    LANES, ROOT = PLACES, f'llvm.sqrt.v{PLACES}f64'

    def is_shared(self, source):
        """Whether all lanes have an input in common."""
        return source not in (Q, QD)
