# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From unrolled arithmetic to LLVM vectors, where branches of a mechanism do the same."""

from .emit import Writer
from .llvm_text import DOUBLE, numbers, vector_of
from .packing import packing_of


class PackedWriter(Writer):
    """Writes one routine, in vectors where operations are the same on other inputs."""

    def write(self):
        """Write the function."""
        self.packing = packing_of(self.routine, self.first_angles())
        if self.packing is None:
            super().write()
            return
        self.vectors, self.gathered = {}, {}
        self.turn_first()
        for members in self.in_order(list(self.packing.ordered())):
            if len(members) == 1:
                self.compute(*members)
            else:
                self._compute(self.packing.operations, members)
        self.finish()

    def turn_back(self, place):
        """Compute an arctangent; what others take may not be computed yet."""
        self.values[place] = self.operation(*self.routine.graph.operations[place])

    def number(self, operand):
        """Return the value of an operand, out of its lane where it is in one."""
        if isinstance(operand, int) and operand not in self.values and (
                self.packing is not None and operand in self.packing.at):
            number, lane = self.packing.at[operand]
            self.values[operand] = self.function.take(self.vectors[number], lane)
        return super().number(operand)

    def _compute(self, operations, members):
        """Compute a bundle."""
        kind = operations[members[0]][0]
        vectors = [self._vector(operands) for operands in zip(
            *(operations[place][1:] for place in members))]
        self.vectors[self.packing.at[members[0]][0]] = self.arithmetic(kind, *vectors)

    def _vector(self, operands):
        """Return operands in lanes; the first one in those beyond them, too."""
        if operands in self.gathered:
            return self.gathered[operands]
        width, padded, number, lanes = self.packing.gathered(operands)
        if not any(isinstance(one, int) for one in operands):
            return numbers([float(one) for one in padded])
        if number is None:
            vector = self.function.gather(
                [self.number(one) for one in operands]
                + (width - len(operands)) * [(DOUBLE, 'undef')])
        else:
            vector = self.vectors[number]
            if vector[0] != vector_of(DOUBLE, width) or (
                    lanes[:len(operands)] != list(range(len(operands)))):
                vector = self.function.shuffle(
                    vector, lanes[:len(operands)] + (width - len(operands)) * ['undef'])
        self.gathered[operands] = vector
        return vector
