# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
LLVM's intermediate representation as text, instruction by instruction.

A mechanism in space is some ten thousand instructions: objects of llvmlite for them take half as
long as LLVM takes to compile them. A value is here a pair of its type and its name, both as LLVM
writes them.
"""

import struct

DOUBLE, WORD, BIT, INDEX = 'double', 'i64', 'i1', 'i32'
DOUBLES, WORDS = 'double*', 'i64*'


def vector_of(kind, count):
    """Return the type of a vector."""
    return f'<{count} x {kind}>'


def integer(value, kind=WORD):
    """Return an integer constant."""
    return kind, str(value)


def number(value):
    """Return a constant of type double."""
    return DOUBLE, _bits(value)


def _bits(value):
    """Return a double number as LLVM reads it without rounding."""
    return f'0x{struct.pack(">d", value).hex()}'


def numbers(values):
    """Return a constant vector of double numbers."""
    listed = ', '.join(f'{DOUBLE} {_bits(one)}' for one in values)
    return vector_of(DOUBLE, len(values)), f'<{listed}>'


def repeated(value, kind, count):
    """Return a constant vector of one integer."""
    return vector_of(kind, count), f'<{", ".join([f"{kind} {value}"] * count)}>'


class Function:
    """
    A function in the making, which returns an integer.

    ``arguments`` are their types; ``declared``: declarations of other functions by their names;
    those that are called are added.
    """

    def __init__(self, name, arguments, declared):
        self.arguments = [(kind, f'%a{n}') for n, kind in enumerate(arguments)]
        listed = ', '.join(' '.join(one) for one in self.arguments)
        # Vectors that wait on the stack are each in one line of the cache.
        self._head = f'define {WORD} @{name}({listed}) alignstack(64) {{'
        self._first, self._lines, self.count, self._declared = [], [], 0, declared

    def text(self):
        """Return the whole function."""
        return '\n'.join((self._head, *self._first, *self._lines, '}'))

    def result(self, kind, instruction):
        """Write an instruction, and return its value, of a given type."""
        self.count += 1
        name = f'%v{self.count}'
        self._lines.append(f'{name} = {instruction}')
        return kind, name

    def binary(self, operation, first, second, flags=''):
        """Write an operation on two values of the same type."""
        kind = first[0]
        return self.result(kind, f'{operation} {flags}{kind} {first[1]}, {second[1]}')

    def contracted(self, operation, first, second):
        """Write an operation: a product and a sum may become one instruction, rounded once."""
        return self.binary(operation, first, second, 'contract ')

    def compare(self, operation, first, second):
        """Write a comparison, of numbers or of vectors lane by lane."""
        kind = first[0]
        return self.result(
            vector_of(BIT, kind[1:].split()[0]) if kind[0] == '<' else BIT,
            f'{operation} {kind} {first[1]}, {second[1]}')

    def negate(self, value):
        """Write a change of sign."""
        return self.result(value[0], f'fneg {value[0]} {value[1]}')

    def select(self, condition, first, second):
        """Write a choice of one of two values."""
        return self.result(
            first[0], f'select {_typed(condition)}, {_typed(first)}, {_typed(second)}')

    def convert(self, operation, value, kind):
        """Write a conversion to another type."""
        return self.result(kind, f'{operation} {_typed(value)} to {kind}')

    def address(self, array, place):
        """Write the address of an entry of an array."""
        kind = array[0]
        return self.result(kind, f'getelementptr {kind[:-1]}, {_typed(array)}, {WORD} {place}')

    def again(self, array):
        """Write an array of its own: what was loaded from the other one is not known here."""
        kind = array[0]
        return self.result(kind, f'call {kind} asm "", "=r,0"({_typed(array)})')

    def load(self, address, options=''):
        """Write the load of a value from an address."""
        kind = address[0][:-1]
        return self.result(kind, f'load {kind}, {_typed(address)}{options}')

    def store(self, value, address, options=''):
        self._lines.append(f'store {_typed(value)}, {_typed(address)}{options}')

    def store_here(self, value, address, options=''):
        """Write the store of a value that is to be in memory from here on, not before."""
        self._lines.append(f'store volatile {_typed(value)}, {_typed(address)}{options}')

    def room(self, kind, count):
        """Write the allocation of an array on the stack, once for the whole function."""
        self.count += 1
        name = f'%v{self.count}'
        self._first.append(f'{name} = alloca {kind}, {INDEX} {count}')
        return f'{kind}*', name

    def take(self, vector, lane):
        """Write the extraction of a lane."""
        return self.result(
            _kind_in(vector), f'extractelement {_typed(vector)}, {INDEX} {lane}')

    def gather(self, values):
        """Write the filling of a vector by single numbers."""
        kind = vector_of(values[0][0], len(values))
        vector = kind, 'undef'
        for lane, one in enumerate(values):
            vector = self.result(
                kind, f'insertelement {_typed(vector)}, {_typed(one)}, {INDEX} {lane}')
        return vector

    def repeat(self, value, count):
        """Write a vector of one number."""
        kind = vector_of(value[0], count)
        first = self.result(kind, f'insertelement {kind} undef, {_typed(value)}, {INDEX} 0')
        return self.shuffle(first, [0] * count)

    def shuffle(self, vector, lanes):
        """Write a vector of lanes of another one."""
        mask = ', '.join(f'{INDEX} {lane}' for lane in lanes)
        return self.result(
            vector_of(_kind_in(vector), len(lanes)),
            f'shufflevector {_typed(vector)}, {vector[0]} undef, '
            f'{vector_of(INDEX, len(lanes))} <{mask}>')

    def call(self, name, values):
        """Write the call of a function of LLVM or the C library, on values of the same type."""
        kind = values[0][0]
        self._declared[name] = f'declare {kind} @{name}({", ".join([kind] * len(values))})'
        return self.result(kind, f'call {kind} @{name}({", ".join(map(_typed, values))})')

    def end_by(self, name):
        """End by calling another function of the same kind, in the place of this one."""
        self.end(self.call_like(name, 'tail '))

    def call_like(self, name, how=''):
        """Write the call of another function of the same kind, with the same arguments."""
        return self.result(
            WORD, f'{how}call {WORD} @{name}({", ".join(map(_typed, self.arguments))})')

    def call_address(self, address, values):
        """Write the call of the function at an address, which returns a double number."""
        kind = f'{DOUBLE} ({", ".join(kind for kind, _ in values)})*'
        _, function = self.convert('inttoptr', address, kind)
        return self.result(DOUBLE, f'call {DOUBLE} {function}({", ".join(map(_typed, values))})')

    def blocks(self, *names):
        """Return names of new blocks."""
        self.count += 1
        return [f'{name}{self.count}' for name in names]

    def begin(self, block):
        self._lines.append(f'{block}:')

    def branch(self, block):
        """End a block, to go on with another one."""
        self._lines.append(f'br label %{block}')

    def branch_if(self, condition, yes, no):
        """End a block, to go on with one of two."""
        self._lines.append(f'br {_typed(condition)}, label %{yes}, label %{no}')

    def joined(self, values):
        """Write the value of the block from which this one was reached, of values by block."""
        kind, _ = next(iter(values.values()))
        return self.result(kind, f'phi {kind} ' + ', '.join(
            f'[{name}, %{block}]' for block, (_, name) in values.items()))

    def end(self, value):
        self._lines.append(f'ret {_typed(value)}')


def _kind_in(vector):
    """Return the type of the lanes of a vector: the last word between the brackets."""
    return vector[0].split()[-1][:-1]


def _typed(value):
    return f'{value[0]} {value[1]}'
