# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Expressions in the time, as compiled code evaluates them: a list of operations on a stack.

``2*sin(3*t)`` becomes 2, 3, t, *, sin, *. Names, functions and what may be written are those of
``mechanism.expressions``, with ``t`` for the time; parameters of a file have no place here.
"""

from functools import partial

import numpy as np

from ..engine import native
from ..mechanism.expressions import FUNCTIONS, ON_NUMBERS, value_of
from ..mechanism.fields import FieldError, shown

# Operations: a number, the time, of one number, of two numbers.
NUMBER, TIME = 0, 1
ONE = ('neg', 'abs', 'sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'sqrt', 'exp', 'log', 'radians',
       'degrees')
TWO = ('add', 'sub', 'mul', 'div', 'pow', 'atan2', 'hypot', 'min', 'max')
_CODES = {name: code for code, name in enumerate((*ONE, *TWO), 2)}
(NEG, ABS, SIN, COS, TAN, ASIN, ACOS, ATAN, SQRT, EXP, LOG, RADIANS, DEGREES,
 ADD, SUB, MUL, DIV, POW, ATAN2, HYPOT, MIN, MAX) = range(2, 2 + len(_CODES))
# Derivatives of functions of one number x.
_DERIVATIVES = {
    SIN: 'cos(x)', COS: '-sin(x)', TAN: '1/cos(x)**2', ASIN: '1/sqrt(1-x**2)',
    ACOS: '-1/sqrt(1-x**2)', ATAN: '1/(1+x**2)', SQRT: '0.5/sqrt(x)', EXP: 'exp(x)',
    LOG: '1/x', RADIANS: 'pi/180', DEGREES: '180/pi'}
MOST_STEPS = 2000
EXPECTED = 'an expression in t of numbers, + - * / **, brackets and functions'


class Term:
    """An operation and its operands, terms or numbers; arithmetic on it is another one."""

    __slots__ = ('code', 'operands')

    def __init__(self, code, *operands):
        self.code, self.operands = code, operands

    def __add__(self, other):
        return self if _is(other, 0.0) else Term(ADD, self, other)

    def __radd__(self, other):
        return self if other == 0.0 else Term(ADD, other, self)

    def __sub__(self, other):
        return self if _is(other, 0.0) else Term(SUB, self, other)

    def __rsub__(self, other):
        return -self if other == 0.0 else Term(SUB, other, self)

    def __mul__(self, other):
        """Multiply; a zero or a one decides alone."""
        if _is(other, 0.0) or _is(other, 1.0):
            return self if other else 0.0
        return Term(MUL, self, other)

    def __rmul__(self, other):
        return self * other if other in (0.0, 1.0) else Term(MUL, other, self)

    def __truediv__(self, other):
        if _is(other, 0.0):
            raise ZeroDivisionError('division by zero')
        return Term(DIV, self, other)

    def __rtruediv__(self, other):
        return 0.0 if other == 0.0 else Term(DIV, other, self)

    def __pow__(self, exponent):
        return self if _is(exponent, 1.0) else Term(POW, self, exponent)

    def __rpow__(self, base):
        return Term(POW, base, self)

    def __neg__(self):
        return self.operands[0] if self.code == NEG else Term(NEG, self)

    def __pos__(self):
        return self


def _is(value, number):
    return not isinstance(value, Term) and value == number


def _called(name, *operands):
    """Return a function of terms and numbers."""
    if any(isinstance(one, Term) for one in operands):
        return Term(_CODES[name], *operands)
    return ON_NUMBERS[name](*operands)


_FUNCTIONS = {name: partial(_called, name) for name in FUNCTIONS}


def program(text):
    """
    Return an expression as one entry of the table: number of operations, these, room for a stack.

    FieldError.
    """
    return _program(_term(text), text)


def value_at(entry, time):
    """Return the value of an entry of ``program`` at a time [s]."""
    return native.expression_value(np.array(entry), 0, time)


def programs(text):
    """
    Return an expression, its first and its second derivative, each as ``program`` does.

    FieldError where it is none, or has corners that no derivative describes.
    """
    terms = [_term(text)]
    for _ in range(2):
        terms.append(_derivative(terms[-1], text))
    return tuple(_program(one, text) for one in terms)


def _term(text):
    """Return the value of an expression: a term, or a number where it is one."""
    return value_of(text, {'t': Term(TIME)}, _FUNCTIONS, EXPECTED)


def _program(term, text):
    """Return a term as one entry of the table."""
    steps = []
    deepest = _append(term, steps)
    if len(steps) > MOST_STEPS:
        raise FieldError(f'an expression whose derivatives take {MOST_STEPS} operations at most',
                         f'{shown(text)}, which takes {len(steps)}')
    return (float(len(steps)), *(float(x) for step in steps for x in step), *((0.0,) * deepest))


def _append(term, steps):
    """Append the operations of a term or number; return how deep their stack becomes."""
    if not isinstance(term, Term):
        steps.append((NUMBER, term))
        return 1
    deepest = max((place + _append(one, steps) for place, one in enumerate(term.operands)),
                  default=1)
    steps.append((term.code, 0.0))
    return deepest


def _derivative(term, text):
    if not isinstance(term, Term) or term.code == TIME:
        return float(isinstance(term, Term))
    code, operands = term.code, term.operands
    rates = [_derivative(one, text) for one in operands]
    if all(_is(one, 0.0) for one in rates):
        return 0.0
    if code in _DERIVATIVES:
        return value_of(
            _DERIVATIVES[code], {'x': operands[0]}, _FUNCTIONS, EXPECTED) * rates[0]
    if code == NEG:
        return -rates[0]
    # A length has a corner where it is zero, which a number beside it that is not zero prevents.
    corner = code == HYPOT and all(isinstance(one, Term) or one == 0.0 for one in operands)
    if corner or code not in (ADD, SUB, MUL, DIV, POW, HYPOT, ATAN2):
        raise FieldError('an expression without corners',
                         f'{shown(text)} with {(*ONE, *TWO)[code - 2]}',
                         'a motion has no jumps of its speed' + (
                             '; where the length is never zero, write sqrt(x**2 + y**2)'
                             if corner else ''))
    return _OF_TWO[code](term, *operands, *rates)


def _of_power(term, base, exponent, of_base, of_exponent):
    """Return the derivative of a power; a zero has no part in it."""
    found = 0.0
    if not _is(of_base, 0.0):
        # Beside the power itself, whose base may be zero.
        found = exponent * (1.0 if _is(exponent, 1.0) else base ** (exponent - 1.0)) * of_base
    if not _is(of_exponent, 0.0):
        found = found + term * _called('log', base) * of_exponent
    return found


# Derivative of a term of two operands, from it, these and their derivatives.
_OF_TWO = {
    ADD: lambda term, x, y, dx, dy: dx + dy,
    SUB: lambda term, x, y, dx, dy: dx - dy,
    MUL: lambda term, x, y, dx, dy: dx * y + x * dy,
    DIV: lambda term, x, y, dx, dy: dx / y - x * dy / (y * y),
    POW: _of_power,
    HYPOT: lambda term, x, y, dx, dy: (x * dx + y * dy) / term,
    ATAN2: lambda term, y, x, dy, dx: (x * dy - y * dx) / (x * x + y * y)}
