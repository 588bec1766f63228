# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From unrolled arithmetic to LLVM vectors, where branches of a mechanism do the same."""

from . import sincos
from .emit import Writer
from .expression_graph import COSINE, SINE
from .llvm_text import integer, numbers
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
        operations, turned = self.packing.operations, self.packing.turned
        for members in self.in_order(
                operations, list(self.packing.ordered()), {*self.values, *turned}):
            self.forget_inputs()
            if len(members) > 1:
                self._compute(operations, members)
            elif turned.isdisjoint(members):
                self.compute(*members)
        self.finish()

    def turn(self, angles):
        """Compute sines and cosines in the lanes in which most of them are taken."""
        if self.packing is None:
            super().turn(angles)
            return
        groups = self.packing.turns(angles)
        for kind, vectors in zip((SINE, COSINE), sincos.write(
                self.function, [list(map(self.number, group)) for group in groups])):
            self.vectors.update(
                ((kind, n), vector) for n, vector in enumerate(vectors))

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

    def add_conditions(self):
        """Add those of the guard, all lanes of a vector at once."""
        if self.packing is None:
            super().add_conditions()
            return
        function = self.function
        for number, places in self.packing.conditions(self.routine.graph.guard).items():
            if number is None:
                self.conditions += map(self.number, places)
                continue
            vector, mask = self.vectors[number], sum(
                1 << self.packing.at[place][1] for place in set(places))
            bits = f'i{vector[0][1:].split()[0]}'
            self.conditions.append(function.compare('icmp eq', function.binary(
                'and', function.convert('bitcast', vector, bits), integer(mask, bits)),
                integer(mask, bits)))

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
            values = [self.number(one) for one in operands]
            vector = self.function.gather(
                values + (width - len(operands)) * [(values[0][0], 'undef')])
        else:
            vector = self.vectors[number]
            if vector[0].split()[0] != f'<{width}' or (
                    lanes[:len(operands)] != list(range(len(operands)))):
                vector = self.function.shuffle(
                    vector, lanes[:len(operands)] + (width - len(operands)) * ['undef'])
        self.gathered[operands] = vector
        return vector
