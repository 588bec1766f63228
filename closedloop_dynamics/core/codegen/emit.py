# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Writer of LLVM's intermediate representation for traced arithmetic."""

from llvmlite import ir

from . import sincos
from .expression_graph import (
    ADD, ARCTANGENT, BOTH, CALL, CHOOSE, COSINE, DIVIDE, EXPONENTIAL, GREATER_EQUAL, LESS, LOAD,
    LOGARITHM, MULTIPLY, needed_for, NEGATE, POWER, Q, QD, SINE, SQUARE_ROOT, SUBTRACT, TAKE)
from .function_table import ENTRIES, PRESENT, PRESENT_COLUMNS

_DOUBLE, _WORD = ir.DoubleType(), ir.IntType(64)
_FUNCTION = ir.FunctionType(_WORD, [_WORD.as_pointer()] + 2 * [_DOUBLE.as_pointer()])
# A multiplication and an addition may become one instruction that rounds once.
_FLAGS = ('contract',)
# Functions of the C library, of laws of force.
_LIBRARY = {SINE: 'sin', COSINE: 'cos', EXPONENTIAL: 'exp', LOGARITHM: 'log', ARCTANGENT: 'atan2',
            POWER: 'pow'}
# A function of the engine: see ``engine/library.cpp``.
_ASKED = ir.FunctionType(_DOUBLE, 2 * [_DOUBLE.as_pointer()] + 4 * [_DOUBLE] + [
    _DOUBLE.as_pointer()])
_MOST_RESULTS = 3
_ARITHMETIC = {ADD: 'fadd', SUBTRACT: 'fsub', MULTIPLY: 'fmul', DIVIDE: 'fdiv'}


class Writer:
    """
    Writes one routine as LLVM's intermediate representation.

    Parameters
    ----------
    module : llvmlite.ir.Module
        Where the function goes.
    routine : Routine
        What it computes.

    """

    TYPE, ROOT = _FUNCTION, 'llvm.sqrt.f64'

    def __init__(self, module, routine):
        """Begin the function."""
        self.routine = routine
        self.function = ir.Function(module, self.TYPE, routine.name)
        self.builder = ir.IRBuilder(self.function.append_basic_block())
        self.values, self.pointers, self.asked = {}, {}, {}

    def number(self, operand):
        """Return the value of an operand."""
        if isinstance(operand, int):
            return self.values[operand]
        return ir.Constant(_DOUBLE, operand)

    def address(self, source, place):
        """Return the address of a number of an input or output."""
        if source not in self.pointers:
            table, q, qd = self.function.args
            if source in (Q, QD):
                self.pointers[source] = q if source == Q else qd
            else:
                self.pointers[source] = self.builder.inttoptr(
                    self.builder.load(self.builder.gep(table, [_WORD(source)])),
                    _DOUBLE.as_pointer())
        return self.builder.gep(self.pointers[source], [_WORD(place)])

    def write(self):
        """Write the function."""
        operations, use = self.routine.graph.operations, self.routine.needed()
        angles = sorted({operation[1] for place, operation in enumerate(operations)
                         if place in use and operation[0] in (SINE, COSINE)})
        for place in sorted(needed_for(operations, angles)):
            self.values[place] = self.operation(*operations[place])
        self.turn(operations, angles)
        for place, operation in enumerate(operations):
            if place in use and place not in self.values:
                self.values[place] = self.operation(*operation)
        self.finish()

    def finish(self):
        """Store the outputs, and return whether the traced branches were the right ones."""
        for source, place, value in self.routine.outputs:
            known = value.place if hasattr(value, 'place') else float(value)
            self.builder.store(self.number(known), self.address(source, place))
        guard = self.routine.graph.guard
        good = _WORD(1) if guard is None else self.builder.zext(self.number(guard.place), _WORD)
        self.builder.ret(good)

    def turn(self, operations, angles):
        """Compute all sines and cosines at once, in vectors."""
        if not angles:
            return
        sines, cosines = sincos.write(
            self.builder, [self.values[angle] for angle in angles])
        by_angle = {angle: n for n, angle in enumerate(angles)}
        for place, operation in enumerate(operations):
            if operation[0] in (SINE, COSINE) and operation[1] in by_angle:
                values = sines if operation[0] == SINE else cosines
                self.values[place] = values[by_angle[operation[1]]]

    def operation(self, kind, *operands):
        """Return the result of an operation."""
        builder = self.builder
        if kind == LOAD:
            return builder.load(self.address(*operands))
        if kind == CALL:
            return self.ask(*map(int, operands[:4]), *map(self.number, operands[4:]))
        if kind == TAKE:
            call, number = operands
            return builder.load(builder.gep(
                self.asked[self.values[call]], [_WORD(int(number))]))
        return self.arithmetic(kind, *(self.number(operand) for operand in operands))

    def ask(self, function, effect, begin, length, *numbers):
        """Return the result of a function of the engine on entries of an effect."""
        builder, (table, _, _) = self.builder, self.function.args
        with builder.goto_entry_block():
            results = builder.alloca(_DOUBLE, _MOST_RESULTS)
        address = builder.inttoptr(
            builder.load(builder.gep(table, [_WORD(function)])), _ASKED.as_pointer())
        found = builder.call(address, [
            self.address(ENTRIES, begin), self.address(PRESENT, effect * PRESENT_COLUMNS),
            ir.Constant(_DOUBLE, float(length)), *numbers, results])
        self.asked[found] = results
        return found

    def arithmetic(self, kind, *numbers):
        """Return the result of an operation on values."""
        builder = self.builder
        if kind in _ARITHMETIC:
            return getattr(builder, _ARITHMETIC[kind])(*numbers, flags=_FLAGS)
        if kind == NEGATE:
            return builder.fneg(*numbers)
        if kind == LESS:
            return builder.fcmp_ordered('<', *numbers)
        if kind == GREATER_EQUAL:
            return builder.fcmp_ordered('>=', *numbers)
        if kind == BOTH:
            return builder.and_(*numbers)
        if kind == SQUARE_ROOT:
            return self.call(self.ROOT, *numbers)
        if kind == CHOOSE:
            return builder.select(*numbers)
        return self.call(_LIBRARY[kind], *numbers)

    def call(self, name, *numbers):
        """Return the result of a function of LLVM or the C library."""
        module = self.builder.module
        return self.builder.call(module.globals.get(name) or ir.Function(
            module, ir.FunctionType(numbers[0].type, [one.type for one in numbers]), name),
            numbers)


class PieceWriter(Writer):
    """Writes a joint kernel: a function of the rows that it reads and writes."""

    TYPE = ir.FunctionType(_WORD, 5 * [_DOUBLE.as_pointer()])

    def address(self, source, place):
        """Return the address of a number of a row."""
        return self.builder.gep(self.function.args[source], [_WORD(place)])


class LawWriter(PieceWriter):
    """Writes a law of force; its few sines are computed one by one."""

    def turn(self, operations, angles):
        """Compute sines and cosines one by one, as one may be within another."""


def intermediate_code(routines, writer):
    """
    Return LLVM's intermediate representation of routines.

    Parameters
    ----------
    routines : list of Routine
        What is to be computed.
    writer : type
        ``Writer`` or one derived from it.

    Returns
    -------
    str

    """
    module = ir.Module()
    for routine in routines:
        writer(module, routine).write()
    return str(module)
