# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Writer of traced arithmetic on LLVM vectors, with one state in each lane."""

from llvmlite import ir

from . import sincos
from .emit import Writer
from .expression_graph import COSINE, LOAD, SINE
from .function_table import BAUMGARTE, LANES, SHARED

_VECTOR, _INDEX = ir.VectorType(ir.DoubleType(), LANES), ir.IntType(32)
_BITS, _WORD = ir.IntType(LANES), ir.IntType(64)


class LaneWriter(Writer):
    """
    Writes one routine for several states at once.

    It returns 0 where the results of any lane are not to be used.

    Parameters
    ----------
    module : llvmlite.ir.Module
        Where the function goes.
    routine : Routine
        What it computes in every lane.

    """

    ROOT = f'llvm.sqrt.v{LANES}f64'

    def call(self, name, *numbers):
        """Return the result of a function: LLVM's of vectors, others lane by lane."""
        if name == self.ROOT:
            return super().call(name, *numbers)
        builder, found = self.builder, ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            found = builder.insert_element(found, super().call(name, *(
                builder.extract_element(each, _INDEX(lane)) for each in numbers)), _INDEX(lane))
        return found

    def number(self, operand):
        """Return the vector of an operand."""
        if isinstance(operand, int):
            return self.values[operand]
        return ir.Constant(_VECTOR, [operand] * LANES)

    def place(self, source, place):
        """Return the address of a number of all lanes."""
        return self.builder.bitcast(
            self.address(source, LANES * place), _VECTOR.as_pointer())

    def load(self, source, place):
        """Read a number of all lanes, or one that they share."""
        if source not in (BAUMGARTE, SHARED):
            return self.builder.load(self.place(source, place), align=8)
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        first = self.builder.insert_element(
            undefined, self.builder.load(self.address(source, place)), _INDEX(0))
        return self.builder.shuffle_vector(
            first, undefined, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))

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
                    turned[angle] = sincos.polynomials(self.builder, value, _VECTOR)
                    within.append(sincos.within(self.builder, value, _VECTOR))
                self.values[place] = turned[angle][kind == COSINE]
            else:
                self.values[place] = (self.load(*operands) if kind == LOAD
                                      else self.operation(kind, *operands))
        for source, place, value in self.routine.outputs:
            known = value.place if hasattr(value, 'place') else float(value)
            self.builder.store(self.number(known), self.place(source, place), align=8)
        guard = self.routine.graph.guard
        for condition in [] if guard is None else [self.values[guard.place]]:
            within.append(condition)
        good = _BITS(-1)
        for condition in within:
            good = self.builder.and_(good, self.builder.bitcast(condition, _BITS))
        self.builder.ret(self.builder.zext(
            self.builder.icmp_unsigned('==', good, _BITS(-1)), _WORD))
