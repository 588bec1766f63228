# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Writer of LLVM's intermediate representation for traced arithmetic."""

from . import arctangent, scheduling, sincos
from .expression_graph import (
    ADD, ARCTANGENT, BOTH, CALL, CHOOSE, COSINE, DIVIDE, EXPONENTIAL, GREATER_EQUAL, LESS, LOAD,
    LOGARITHM, MULTIPLY, needed_for, NEGATE, POWER, Q, QD, SINE, SQUARE_ROOT, SUBTRACT, TAKE,
    with_others)
from .function_table import ENTRIES, LAW_COLUMNS, PRESENT, PRESENT_COLUMNS, TAU
from .llvm_text import BIT, DOUBLE, DOUBLES, Function, integer, number, WORD, WORDS

# Functions of the C library, of laws of force.
_LIBRARY = {EXPONENTIAL: 'exp', LOGARITHM: 'log', POWER: 'pow'}
_MOST_RESULTS = 5
# Instructions after which large routines load inputs again: that takes fewer than keeping them.
_AGAIN = 200
_ARITHMETIC = {ADD: 'fadd', SUBTRACT: 'fsub', MULTIPLY: 'fmul', DIVIDE: 'fdiv'}
_COMPARISONS = {LESS: 'fcmp olt', GREATER_EQUAL: 'fcmp oge'}


class Writer:
    """
    Writes one routine as LLVM's intermediate representation.

    ``declared``: declarations of functions that it calls; more are added.
    """

    ARGUMENTS, ROOT = (WORDS, DOUBLES, DOUBLES), 'llvm.sqrt.f64'
    # Whether it is asked if the results are good.
    ANSWERS = True

    def __init__(self, routine, declared):
        self.routine = routine
        self.function = Function(routine.name, self.ARGUMENTS, declared)
        self.values, self.pointers, self.engine_results = {}, {}, {}
        # What must hold for the results to be right.
        self.conditions = []
        # Whether the order is one that LLVM is to keep.
        self.ordered = False
        # Inputs that are loaded, of large routines since that instruction.
        self.is_large, self._loaded, self._since = False, [], 0

    def number(self, operand):
        """Return the value of an operand."""
        if isinstance(operand, int):
            self.compute(operand)
            return self.values[operand]
        return number(operand)

    def address(self, source, place):
        """Return the address of a number of an input or output."""
        if source not in self.pointers:
            table, q, qd = self.function.arguments
            if source in (Q, QD):
                self.pointers[source] = q if source == Q else qd
            else:
                function = self.function
                self.pointers[source] = function.convert(
                    'inttoptr', function.load(function.address(table, source)), DOUBLES)
        return self.function.address(self.pointers[source], place)

    def is_added(self, _):
        """Whether outputs are added to what is there."""
        return False

    def write(self):
        """Write the function."""
        self.turn_first()
        operations = self.routine.graph.operations
        for place, in self.in_order(operations, [(one,) for one in sorted(self.routine.needed())],
                                    self.values):
            self.forget_inputs()
            self.compute(place)
        self.finish()

    def in_order(self, operations, groups, known):
        """Return groups of operations, each after its operands, in the order to be written."""
        found = scheduling.by_urgency(operations, groups, known)
        self.ordered = found is not None
        self.is_large = self.ordered and len(found) > scheduling.MOST
        return found if self.ordered else groups

    def compute(self, place):
        """Compute an operation, unless that is done, after those that it takes."""
        if place not in self.values:
            kind, *operands = self.routine.graph.operations[place]
            if kind == LOAD:
                self._loaded.append(place)
            if kind in (SINE, COSINE):
                self.turn_later(*operands)
            elif kind == ARCTANGENT:
                self.turn_back(place)
            else:
                self.values[place] = self.operation(kind, *operands)

    def forget_inputs(self):
        """Load inputs again from here on, where they would be kept on the stack."""
        if self.is_large and self.function.count - self._since > _AGAIN:
            for place in self._loaded:
                self.values.pop(place, None)
            self.pointers = {source: self.function.again(pointer)
                             for source, pointer in self.pointers.items()}
            self._loaded, self._since = [], self.function.count

    def turn_first(self):
        """Compute all sines and cosines that depend on no others of these."""
        angles = self.first_angles()
        for place in sorted(needed_for(self.routine.graph.operations, angles)):
            self.compute(place)
        if angles:
            self.turn(angles)

    def first_angles(self):
        """Return the places of the angles of these."""
        operations, behind, found = self.routine.graph.operations, set(), set()
        for place in sorted(self.routine.needed()):
            kind, *operands = operations[place]
            if kind != LOAD and any(isinstance(one, int) and one in behind for one in operands):
                behind.add(place)
            elif kind in (SINE, COSINE):
                behind.add(place)
                found.update(operands)
        return sorted(found)

    def finish(self):
        """Store the outputs, and return whether the traced branches were the right ones."""
        self.add_conditions()
        good = integer(1, BIT)
        for condition in self.conditions:
            good = self.function.binary('and', good, condition)
        self.go_on_if(good)
        # Inputs may be stored over.
        results = [self.number(value.place if hasattr(value, 'place') else float(value))
                   for _, _, value in self.routine.outputs]
        for (source, place, _), result in zip(self.routine.outputs, results):
            address = self.address(source, place)
            if self.is_added(source):
                result = self.function.binary('fadd', self.function.load(address), result)
            self.function.store(result, address)
        self.function.end(self.function.convert('zext', good, WORD))

    def add_conditions(self):
        """Add that of the guard."""
        guard = self.routine.graph.guard
        if guard is not None:
            self.conditions.append(self.number(guard.place))

    def go_on_if(self, good):
        """Leave the rest to the other routine, where there is one, unless a condition holds."""
        if self.routine.otherwise is not None:
            here, other = self.function.blocks('good', 'otherwise')
            self.function.branch_if(good, here, other)
            self.function.begin(other)
            self.function.end_by(self.routine.otherwise.name)
            self.function.begin(here)

    def turn(self, angles):
        """Compute the sines and cosines of angles, at their places, at once, in vectors."""
        (sines,), (cosines,) = sincos.write(self.function, [list(map(self.number, angles))])
        self.keep(angles, *([self.function.take(one, n) for n in range(len(angles))]
                            for one in (sines, cosines)))

    def turn_later(self, angle):
        """
        Compute the sine and cosine of an angle that depends on others of these.

        Without a branch: products before it and sums behind are rounded once, as in lanes. Where
        the angle is too large for that, the results are not to be used.
        """
        if not self.ANSWERS:
            self.turn([angle])
            return
        function = self.function
        packed = function.gather([self.number(angle)])
        self.conditions.append(function.take(sincos.within(function, packed, 1), 0))
        self.keep([angle], *(
            [function.take(one, 0)] for one in sincos.polynomials(function, packed, 1)))

    def keep(self, angles, sines, cosines):
        """Store sines and cosines as the values of their operations."""
        by_angle = {angle: n for n, angle in enumerate(angles)}
        for place, operation in enumerate(self.routine.graph.operations):
            if operation[0] in (SINE, COSINE) and operation[1] in by_angle:
                values = sines if operation[0] == SINE else cosines
                self.values[place] = values[by_angle[operation[1]]]

    def turn_back(self, _):
        """Compute all arctangents that are left and depend on none of these, in one vector."""
        operations = self.routine.graph.operations
        left = {place for place in self.routine.needed()
                if operations[place][0] == ARCTANGENT and place not in self.values}
        ready = sorted(one for one in left if needed_for(operations, [one]) & left == {one})
        for place in sorted(needed_for(operations, ready) - left):
            self.compute(place)
        angles = arctangent.write(self.function, *(self.function.gather(
            [self.number(operations[place][n]) for place in ready]) for n in (1, 2)))
        self.values.update((place, self.function.take(angles, n)) for n, place in enumerate(ready))

    def operation(self, kind, *operands):
        """Return the result of an operation."""
        if kind == LOAD:
            return self.function.load(self.address(*operands))
        if kind == CALL:
            return self.call_engine(*map(int, operands[:3]), *map(self.number, operands[3:]))
        if kind == TAKE:
            call, place = operands
            return self.function.load(self.function.address(
                self.engine_results[self.values[call]], int(place)))
        return self.arithmetic(kind, *(self.number(operand) for operand in operands))

    def call_engine(self, entry, effect, begin, *numbers):
        """Return the result of a function of the engine on entries of an effect."""
        function = self.function
        results = function.room(DOUBLE, _MOST_RESULTS)
        # See ``engine/library.cpp``.
        address = function.load(function.address(function.arguments[0], entry))
        found = function.call_address(address, [
            self.address(ENTRIES, begin), self.address(PRESENT, effect * PRESENT_COLUMNS),
            *numbers, results])
        self.engine_results[found] = results
        return found

    def arithmetic(self, kind, *numbers):
        """Return the result of an operation on values."""
        if kind in _ARITHMETIC:
            return self.function.contracted(_ARITHMETIC[kind], *numbers)
        if kind == NEGATE:
            return self.function.negate(*numbers)
        if kind in _COMPARISONS:
            return self.function.compare(_COMPARISONS[kind], *numbers)
        if kind == BOTH:
            return self.function.binary('and', *numbers)
        if kind == SQUARE_ROOT:
            return self.call(self.ROOT, *numbers)
        if kind == CHOOSE:
            return self.function.select(*numbers)
        if kind == ARCTANGENT:
            return arctangent.write(self.function, *numbers)
        return self.call(_LIBRARY[kind], *numbers)

    def call(self, name, *numbers):
        """Return the result of a function of LLVM or the C library."""
        return self.function.call(name, numbers)


class RowWriter(Writer):
    """Writes a law of force for any row of the table of effects."""

    ANSWERS = False

    def is_added(self, source):
        """Whether outputs are added: forces in joints and on bodies."""
        return source == TAU or source >= LAW_COLUMNS


class KernelWriter(Writer):
    """Writes a joint kernel: a function of the rows that it reads and writes."""

    ARGUMENTS, ANSWERS = 5 * (DOUBLES,), False

    def address(self, source, place):
        """Return the address of a number of a row."""
        return self.function.address(self.function.arguments[source], place)


def intermediate_code(routines, writer):
    """
    Return LLVM's intermediate representation of routines, by a ``Writer``.

    With it whether LLVM is to keep the order in which the routines that were asked for are.
    """
    declared, functions, ordered = {}, [], True
    for routine in with_others(routines):
        written = writer(routine, declared)
        written.write()
        functions.append(written.function.text())
        ordered = ordered and (written.ordered or routine not in routines)
    return '\n'.join((*declared.values(), *functions, '')), ordered
