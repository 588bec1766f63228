# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
WebAssembly writer for traced arithmetic: modules that browsers run, without a compiler.

A module has one memory with all arrays in it. Each routine is a function without parameters that
returns 1 where the branches that were taken are right, else what the routine that does the same
otherwise returns, or 0. Source: WebAssembly Core Specification 1.0, chapter 5 (binary format).
"""

from collections import Counter
import struct

from .expression_graph import (
    ADD, ARCTANGENT, BOTH, CHOOSE, CONDITIONS, COSINE, DIVIDE, EXPONENTIAL, GREATER_EQUAL, LESS,
    LOAD, LOGARITHM, MULTIPLY, NEGATE, POWER, SINE, SQUARE_ROOT, SUBTRACT, with_others)

# Types of values, and the marks of other parts of a module.
I32, F64, FUNCTION = b'\x7f', b'\x7c', b'\x60'
TYPES, IMPORTS, FUNCTIONS, MEMORIES, EXPORTS, CODE = 1, 2, 3, 5, 7, 10
# Instructions.
IF, ELSE, END, CALL, SELECT = b'\x04', b'\x05', b'\x0b', b'\x10', b'\x1b'
GET, SET, LOAD_F64, STORE_F64, CONST_I32, CONST_F64 = (
    b'\x20', b'\x21', b'\x2b', b'\x39', b'\x41', b'\x44')
OPERATIONS = {ADD: b'\xa0', SUBTRACT: b'\xa1', MULTIPLY: b'\xa2', DIVIDE: b'\xa3', NEGATE: b'\x9a',
              SQUARE_ROOT: b'\x9f', LESS: b'\x63', GREATER_EQUAL: b'\x66', BOTH: b'\x71',
              CHOOSE: SELECT}
# Functions of JavaScript's ``Math``, which the module imports: name and number of arguments.
MATH = {SINE: ('sin', 1), COSINE: ('cos', 1), EXPONENTIAL: ('exp', 1), LOGARITHM: ('log', 1),
        ARCTANGENT: ('atan2', 2), POWER: ('pow', 2)}
# Bytes of a number, and of a page of memory.
DOUBLE, PAGE = 8, 65536


def module(routines, sizes):
    """
    Return a module of some routines.

    Parameters
    ----------
    routines : list of Routine
        Each becomes a function of its name; what does the same otherwise has none outside.
    sizes : dict of int to int
        By input or output, how many numbers its array has.

    Returns
    -------
    binary : bytes
        With the functions and ``memory`` as exports.
    addresses : dict of int to int
        By input or output, where its array begins in the memory [bytes].

    """
    addresses, end, functions = {}, 0, with_others(routines)
    for source, size in sizes.items():
        addresses[source], end = end, end + DOUBLE * size
    kinds = sorted({routine.graph.operations[place][0] for routine in functions
                    for place in routine.needed()} & set(MATH))
    # Types of the imported functions of one and of two numbers, and of the routines.
    types = [FUNCTION + _vector([F64] * count) + _vector([F64]) for count in (1, 2)]
    types.append(FUNCTION + _vector([]) + _vector([I32]))
    imports = [_text('math') + _text(MATH[kind][0]) + b'\x00' + _unsigned(MATH[kind][1] - 1)
               for kind in kinds]
    exports = [_text('memory') + b'\x02' + _unsigned(0)]
    # By kinds of operations and routines, whose functions come in this order.
    numbers = {one: _unsigned(number) for number, one in enumerate((*kinds, *functions))}
    exports += [_text(routine.name) + b'\x00' + numbers[routine] for routine in routines]
    calls = {one: CALL + number for one, number in numbers.items()}
    sections = (
        (TYPES, types), (IMPORTS, imports), (FUNCTIONS, [_unsigned(2)] * len(functions)),
        (MEMORIES, [b'\x00' + _unsigned(-(-end // PAGE))]), (EXPORTS, exports),
        (CODE, [_sized(_Function(routine, addresses, calls).body()) for routine in functions]))
    return b'\x00asm\x01\x00\x00\x00' + b''.join(
        bytes([number]) + _sized(_vector(items)) for number, items in sections), addresses


class _Function:
    """
    The code of one routine.

    What is used once stays on the stack of the machine; the rest is in local variables, which are
    taken again when the number in them is not needed any more.
    """

    def __init__(self, routine, addresses, calls):
        self._routine, self._addresses, self._calls = routine, addresses, calls
        self._operations = routine.graph.operations
        # Instructions; of variables a pair: get or set, and the variable: its type and number.
        self._code, self._variables = [], {}
        self._free, self._count = {F64: [], I32: []}, Counter()

    def body(self):
        """Return variables and instructions as bytes."""
        routine, guard = self._routine, self._routine.graph.guard
        needed = sorted(routine.needed())
        self._left = Counter(
            operand for place in needed if self._operations[place][0] != LOAD
            for operand in self._operations[place][1:] if isinstance(operand, int))
        outputs = [(source, place, value.place if hasattr(value, 'place') else float(value))
                   for source, place, value in routine.outputs]
        self._left.update(value for _, _, value in outputs if isinstance(value, int))
        if guard is not None:
            self._left[guard.place] += 1
        for place in [place for place in needed if self._left[place] > 1]:
            self._put(place, True)
            self._set(place)
        for source, place, value in outputs:
            self._code.append(CONST_I32 + b'\x00')
            self._put(value)
            self._code.append(STORE_F64 + self._memory(source, place))
        if guard is None:
            self._code.append(CONST_I32 + b'\x01')
        else:
            self._put(guard.place)
            if routine.otherwise is not None:
                # It stores all results again.
                self._code += [IF + I32, CONST_I32 + b'\x01', ELSE,
                               self._calls[routine.otherwise], END]
        first = {F64: 0, I32: self._count[F64]}
        code = b''.join(one if isinstance(one, bytes) else
                        one[0] + _unsigned(first[one[1][0]] + one[1][1]) for one in self._code)
        return _vector([_unsigned(self._count[kind]) + kind for kind in (F64, I32)]) + code + END

    def _memory(self, source, place):
        """Return alignment and address of a number."""
        return b'\x03' + _unsigned(self._addresses[source] + DOUBLE * place)

    def _put(self, operand, anew=False):
        """Put an operand on the stack: compute it, or get its variable unless ``anew``."""
        waiting = [operand]
        while waiting:
            one = waiting.pop()
            if isinstance(one, bytes):
                self._code.append(one)
            elif isinstance(one, float):
                self._code.append(CONST_F64 + struct.pack('<d', one))
            elif one in self._variables and not anew:
                self._get(one)
            else:
                kind, *operands = self._operations[one]
                if kind == LOAD:
                    self._code += [CONST_I32 + b'\x00', LOAD_F64 + self._memory(*operands)]
                else:
                    if kind == CHOOSE:
                        # The condition comes last.
                        operands = [*operands[1:], operands[0]]
                    waiting += [self._calls.get(kind) or OPERATIONS[kind], *reversed(operands)]
            anew = False

    def _get(self, place):
        variable = self._variables[place]
        self._code.append((GET, variable))
        self._left[place] -= 1
        if not self._left[place]:
            self._free[variable[0]].append(variable)

    def _set(self, place):
        kind = I32 if self._is_condition(place) else F64
        if self._free[kind]:
            self._variables[place] = self._free[kind].pop()
        else:
            self._variables[place] = kind, self._count[kind]
            self._count[kind] += 1
        self._code.append((SET, self._variables[place]))

    def _is_condition(self, place):
        while isinstance(place, int) and self._operations[place][0] == CHOOSE:
            place = self._operations[place][2]
        return isinstance(place, int) and self._operations[place][0] in CONDITIONS


def _unsigned(value):
    """Return a whole number in the variable length that the format has for them."""
    found = []
    while value > 0x7f:
        found.append(value & 0x7f | 0x80)
        value >>= 7
    return bytes([*found, value])


def _vector(items):
    return _unsigned(len(items)) + b''.join(items)


def _sized(code):
    return _unsigned(len(code)) + code


def _text(name):
    return _sized(name.encode())
