# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Expressions in the time, as compiled code evaluates them: a list of operations on a stack.

``2*sin(3*t)`` becomes 2, 3, t, *, sin, *. Names, functions and what may be written are those of
``mechanism.expressions``, with ``t`` for the time; parameters of a file have no place here.

"""

import ast

from ..mechanism.expressions import CONSTANTS, FUNCTIONS, parsed
from ..mechanism.fields import among, FieldError, nearest, shown

# Operations: a number, the time, of one number, of two numbers.
NUMBER, TIME = 0, 1
ONE = ('neg', 'abs', 'sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'sqrt', 'exp', 'log', 'radians',
       'degrees')
TWO = ('add', 'sub', 'mul', 'div', 'pow', 'atan2', 'hypot', 'min', 'max')
_CODES = {name: code for code, name in enumerate((*ONE, *TWO), 2)}
(NEG, ABS, SIN, COS, TAN, ASIN, ACOS, ATAN, SQRT, EXP, LOG, RADIANS, DEGREES,
 ADD, SUB, MUL, DIV, POW, ATAN2, HYPOT, MIN, MAX) = range(2, 2 + len(_CODES))
_OPERATORS = {ast.Add: ADD, ast.Sub: SUB, ast.Mult: MUL, ast.Div: DIV, ast.Pow: POW}
# Of functions of one number x.
_DERIVATIVES = {
    'sin': 'cos(x)', 'cos': '-sin(x)', 'tan': '1/cos(x)**2', 'asin': '1/sqrt(1-x**2)',
    'acos': '-1/sqrt(1-x**2)', 'atan': '1/(1+x**2)', 'sqrt': '0.5/sqrt(x)', 'exp': 'exp(x)',
    'log': '1/x', 'radians': 'pi/180', 'degrees': '180/pi'}
MOST_STEPS = 2000
EXPECTED = 'an expression in t of numbers, + - * / **, brackets and functions'


def program(text):
    """
    Return an expression as one entry of the table: number of operations, these, room for a stack.

    Raises
    ------
    FieldError

    """
    root = parsed(text)
    if root is None:
        raise FieldError(EXPECTED, shown(text))
    return _program(root, text)


def programs(text):
    """
    Return an expression, its first and its second derivative, each as ``program`` does.

    Raises
    ------
    FieldError
        Where it is none, or has corners that no derivative tells.

    """
    found, root = [program(text)], parsed(text)
    for _ in range(2):
        root = _derivative(root, text)
        found.append(_program(root, text))
    return tuple(found)


def _program(root, text):
    """Return a tree as one entry of the table."""
    steps = []
    deepest = _translate(root, text, steps)
    if len(steps) > MOST_STEPS:
        raise FieldError(f'an expression whose derivatives take {MOST_STEPS} operations at most',
                         f'{shown(text)}, which takes {len(steps)}')
    return (float(len(steps)), *(float(x) for step in steps for x in step), *((0.0,) * deepest))


def _translate(node, text, steps):
    """Append the operations of a node; return how deep their stack becomes."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        steps.append((NUMBER, node.value))
        return 1
    if isinstance(node, ast.Name):
        if node.id != 't' and node.id not in CONSTANTS:
            known = ('t', *CONSTANTS)
            raise FieldError(EXPECTED, f'{shown(text)} with the unknown name {node.id!r}',
                             nearest(node.id, known) or f'there are {among(known)}')
        steps.append((TIME, 0.0) if node.id == 't' else (NUMBER, CONSTANTS[node.id]))
        return 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.UAdd, ast.USub)):
        depth = _translate(node.operand, text, steps)
        if isinstance(node.op, ast.USub):
            steps.append((NEG, 0.0))
        return depth
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _apply(_OPERATORS[type(node.op)], (node.left, node.right), text, steps)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if name not in FUNCTIONS:
            raise FieldError(EXPECTED, f'{shown(text)} with the unknown function {name!r}',
                             nearest(name, FUNCTIONS) or f'there are {among(FUNCTIONS)}')
        if len(node.args) == FUNCTIONS[name]:
            return _apply(_CODES[name], node.args, text, steps)
    raise FieldError(EXPECTED, shown(text), f'functions: {among(FUNCTIONS)}')


def _apply(code, operands, text, steps):
    """Append operands and the operation on them."""
    deepest = max(place + _translate(one, text, steps) for place, one in enumerate(operands))
    steps.append((code, 0.0))
    return deepest


_ZERO, _ONE = ast.Constant(0.0), ast.Constant(1.0)


def _derivative(node, text):
    """Return the derivative by t of a tree that ``_translate`` takes."""
    if isinstance(node, ast.Name):
        return _ONE if node.id == 't' else _ZERO
    if isinstance(node, ast.UnaryOp):
        inner = _derivative(node.operand, text)
        return _negative(inner) if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.BinOp):
        return _of_operator(node, text)
    if isinstance(node, ast.Call):
        return _of_call(node, text)
    return _ZERO


def _of_operator(node, text):
    """Return the derivative of a sum, a product, a quotient or a power."""
    one, other = node.left, node.right
    of_one, of_other = (_derivative(each, text) for each in (one, other))
    if isinstance(node.op, ast.Add):
        return _sum(of_one, of_other)
    if isinstance(node.op, ast.Sub):
        return _sum(of_one, _negative(of_other))
    if isinstance(node.op, ast.Mult):
        return _sum(_product(of_one, other), _product(one, of_other))
    if isinstance(node.op, ast.Div):
        return _sum(_quotient(of_one, other), _negative(
            _quotient(_product(one, of_other), _product(other, other))))
    found = _ZERO
    if not _is(of_one, 0.0) and not _is(other, 0.0):
        less = (ast.Constant(other.value - 1.0) if isinstance(other, ast.Constant)
                else _sum(other, ast.Constant(-1.0)))
        power = _ONE if _is(less, 0.0) else ast.BinOp(one, ast.Pow(), less)
        found = _product(_product(other, power), of_one)
    if not _is(of_other, 0.0):
        found = _sum(found, _product(_product(node, _called('log', one)), of_other))
    return found


def _of_call(node, text):
    """Return the derivative of a function."""
    name, inner = node.func.id, [_derivative(one, text) for one in node.args]
    if all(_is(one, 0.0) for one in inner):
        return _ZERO
    if name in _DERIVATIVES:
        outer = _Put(node.args[0]).visit(parsed(_DERIVATIVES[name]))
        return _product(outer, inner[0])
    if name not in ('atan2', 'hypot'):
        raise FieldError('an expression without corners', f'{shown(text)} with {name}',
                         'a motion has no jumps of its speed')
    (y, x), (of_y, of_x) = node.args, inner
    if name == 'hypot':
        return _quotient(_sum(_product(y, of_y), _product(x, of_x)), node)
    return _quotient(_sum(_product(x, of_y), _negative(_product(y, of_x))),
                     _sum(_product(x, x), _product(y, y)))


class _Put(ast.NodeTransformer):
    """Puts a tree in the place of x."""

    def __init__(self, tree):
        self._tree = tree

    def visit_Name(self, node):  # noqa: N802
        return self._tree if node.id == 'x' else node


def _is(node, value):
    return isinstance(node, ast.Constant) and node.value == value


def _negative(node):
    return node if _is(node, 0.0) else ast.UnaryOp(ast.USub(), node)


def _sum(one, other):
    if _is(one, 0.0) or _is(other, 0.0):
        return other if _is(one, 0.0) else one
    return ast.BinOp(one, ast.Add(), other)


def _product(one, other):
    if _is(one, 0.0) or _is(other, 0.0):
        return _ZERO
    if _is(one, 1.0) or _is(other, 1.0):
        return other if _is(one, 1.0) else one
    return ast.BinOp(one, ast.Mult(), other)


def _quotient(one, other):
    return one if _is(one, 0.0) else ast.BinOp(one, ast.Div(), other)


def _called(name, argument):
    return ast.Call(ast.Name(name), [argument], [])
