# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Parameters, and arithmetic in the place of numbers.

``center_of_mass: [l/2, 0]``: numbers, parameters, ``pi``, the operators + - * / ** and functions
of one or two numbers. A number may have a unit of length or angle behind it: ``40 mm``,
``90 deg``; a length is refused where an angle is expected, an angle where a length is, and both
where it is neither. An expression is read by ``ast`` and computed here, node by node: nothing else
can come of it.
"""

import ast
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
import math
import operator
import re
from typing import get_args, get_origin
import warnings

from .checks import NAME_PATTERN, number
from .fields import among, at, FieldError, mapping, nearest, shown
from .meanings import documented, unit_in

LONGEST = 500
CONSTANTS = {'pi': math.pi}
# Units behind numbers, in SI.
LENGTHS = {'mm': 1e-3, 'cm': 1e-2, 'm': 1.0, 'inch': 0.0254}
ANGLES = {'deg': math.pi / 180.0, 'rad': 1.0}
UNITS = {**ANGLES, **LENGTHS}
WITH_UNIT = re.compile(
    r'(?<![\w.])((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?) ?(' + '|'.join(UNITS) + r')\b')
# What an expression is by the units in it; '' for plain numbers, None where none of these.
LENGTH, ANGLE, PLAIN = 'a length', 'an angle', ''
# Units of keys of shapes whose other numbers are lengths.
_OF_SHAPES = {'orientation': 'rad', 'axis': None, 'color': None, 'scale': None}
_QUANTITIES = {LENGTH: '_length', ANGLE: '_angle'}
# Function -> how many numbers it may take.
FUNCTIONS = {**dict.fromkeys(
    ('sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'sqrt', 'exp', 'log', 'radians', 'degrees',
     'abs'), (1,)), **dict.fromkeys(('atan2', 'hypot', 'min', 'max'), (2,))}
ON_NUMBERS = {name: getattr(math, name, None) or {'abs': abs, 'min': min, 'max': max}[name]
              for name in FUNCTIONS}
_OPERATORS = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow, ast.UAdd: operator.pos,
    ast.USub: operator.neg}
_CHARACTERS = re.compile(r'[A-Za-z0-9_ .+\-*/(),]+')
EXPECTED = 'a number, or an expression of numbers and parameters'


class Parameters:
    """
    Named numbers, for expressions of them.

    ``values`` by name, in the order in which they were given; ``used``: names that an expression
    has used; ``quantities``: which of them are lengths or angles by their units.
    """

    def __init__(self, values=()):
        self.values, self.used, self.quantities = dict(values), set(), {}

    @classmethod
    def read(cls, section, given=()):
        """
        Read a section ``parameters`` of a file: numbers by name, or expressions in those above.

        Numbers in ``given`` take the place of those of the section; others are left alone.
        FieldError.
        """
        found, given = cls(), dict(given)
        with at('parameters'):
            for key, value in mapping({} if section is None else section).items():
                with at(key):
                    if not NAME_PATTERN.fullmatch(key) or key in CONSTANTS or key in FUNCTIONS:
                        raise FieldError(
                            'a name of letters, digits and underscores that starts with a letter '
                            'and is not in use', shown(key))
                    found.values[key] = number(given.get(key, found.evaluated(value)))
                    if isinstance(value, str):
                        found.quantities[key] = found.quantity(value)
        return found

    def evaluated(self, value, unit=None):
        """
        Return a value with numbers in the place of expressions, in lists and mappings, too.

        ``unit`` is that of its numbers, such as ``m`` or ``rad; m``, or a tuple with one for each
        item of a list; None where any will do. Other text stays as it is, for the
        checks to refuse. FieldError where an expression has no finite value, an unknown name, or
        units of something else.
        """
        if isinstance(value, str):
            self._require_unit(value, unit)
            return self._number(value)
        if isinstance(value, Mapping):
            found = {}
            for key, item in value.items():
                with at(key):
                    found[key] = self.evaluated(item, _OF_SHAPES.get(key, unit))
            return found
        if isinstance(value, list):
            found = []
            for index, item in enumerate(value):
                with at(index):
                    of_item = dict(enumerate(unit)).get(index) if isinstance(unit, tuple) else unit
                    found.append(self.evaluated(item, of_item))
            return found
        return value

    def record(self, record_type, values):
        """
        Return the keys of a record with numbers in the place of expressions.

        The types of a dataclass state which of its fields are made of numbers, its docstring
        their units; keys that it has not stay as they are. FieldError.
        """
        units = _units(record_type)
        types = {key: field.type for key, field in record_type.__dataclass_fields__.items()}
        found = dict(values)
        for key, value in found.items():
            if key in types and _of_numbers(types[key]):
                with at(key):
                    found[key] = self.evaluated(value, units[key])
        return found

    def quantity(self, text):
        """Return what an expression is by the units in it: LENGTH, ANGLE, PLAIN or None."""
        root = parsed(WITH_UNIT.sub(lambda found: _QUANTITIES[
            LENGTH if found[2] in LENGTHS else ANGLE], text))
        return None if root is None else _quantity(root, {
            **dict.fromkeys(CONSTANTS, PLAIN), **self.quantities,
            **{name: quantity for quantity, name in _QUANTITIES.items()}})

    def _require_unit(self, text, unit):
        if not isinstance(unit, str) or not (self.quantities or WITH_UNIT.search(text)):
            return
        quantity = self.quantity(text)
        parts = [part.partition('/')[0].strip() for part in re.split(r'[;,]| or ', unit)]
        wanted = {LENGTH: 'm', ANGLE: 'rad'}
        if quantity and wanted[quantity] not in parts:
            only = {(one,): kind for kind, one in wanted.items()}.get((unit,), 'a number')
            raise FieldError(f'{only} [{unit}]', f'{shown(text)}, {quantity}')

    def _number(self, text):
        """Return the value of an expression; or the text itself where it is not one."""
        text = without_units(text)
        root = parsed(text)
        names = [node.id for node in ast.walk(root) if isinstance(node, ast.Name)] if root else []
        if root is None or not (names or any(
                isinstance(node, ast.BinOp) for node in ast.walk(root))):
            return text
        if isinstance(root, ast.Name) and not self.values and root.id not in CONSTANTS:
            return text
        value = value_of(text, self.values, ON_NUMBERS, EXPECTED)
        self.used.update(self.values.keys() & set(names))
        return value


def _quantity(node, known):
    """Return what a node of the tree of ``parsed`` is; names that are not known are anything."""
    if isinstance(node, ast.Constant):
        return PLAIN
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.UnaryOp):
        return _quantity(node.operand, known)
    if isinstance(node, ast.Call):
        first = _quantity(node.args[0], known) if node.args else None
        name = getattr(node.func, 'id', None)
        return first if name in ('abs', 'min', 'max', 'hypot') else (
            ANGLE if name in ('asin', 'acos', 'atan', 'atan2', 'radians') else None)
    if not isinstance(node, ast.BinOp):
        return None
    one, other = _quantity(node.left, known), _quantity(node.right, known)
    if isinstance(node.op, (ast.Add, ast.Sub)):
        if one and other and one != other:
            raise FieldError('a sum of lengths or of angles', 'one of both')
        # A plain number is in SI units of what it is added to.
        return one or other
    if isinstance(node.op, ast.Mult) and PLAIN in (one, other):
        return one if other == PLAIN else other
    if isinstance(node.op, ast.Div) and one is not None:
        return one if other == PLAIN else PLAIN if one == other else None
    return None


@lru_cache(maxsize=None)
def _units(record_type):
    """Return the units of the fields of a record, None without one."""
    meanings = documented(record_type)
    return {key: unit_in(meanings[key][1]) or None if key in meanings else None
            for key in record_type.__dataclass_fields__}


def without_units(text):
    """Return an expression with SI numbers in the place of numbers with a unit."""
    return WITH_UNIT.sub(lambda found: f'({float(found[1])!r}*{UNITS[found[2]]!r})', text)


def value_of(text, known, functions, expected, takes=FUNCTIONS):
    """
    Return the value of an expression, of numbers or number-like objects.

    ``known``: values of names, beside CONSTANTS; ``functions``: by the names in ``takes``, which
    says how many operands each may take; ``expected``: the kind of expression, for messages.
    FieldError where it is not one, names something else, or has no finite value.
    """
    root, known = parsed(text), {**known, **CONSTANTS}
    if root is None:
        raise FieldError(expected, shown(text))
    try:
        value = _evaluated(root, text.strip(), known, functions, expected, takes)
    except FieldError:
        raise
    except (ArithmeticError, ValueError, RecursionError) as error:
        raise FieldError(expected, f'{shown(text)}, which has no value', str(error)) from None
    if isinstance(value, float) and not math.isfinite(value):
        raise FieldError(expected, f'{shown(text)}, which is {value}')
    return value


def _evaluated(node, text, known, functions, expected, takes):
    """Return the value of a node of the tree of ``parsed``."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        if '_' not in ast.get_source_segment(text, node):
            return float(node.value)
    elif isinstance(node, ast.Name):
        if node.id in known:
            return known[node.id]
        raise FieldError(expected, f'{shown(text)} with the unknown name {node.id!r}',
                         nearest(node.id, known) or f'there are {among(known)}')
    elif isinstance(node, (ast.BinOp, ast.UnaryOp)) and type(node.op) in _OPERATORS:
        operands = (node.operand,) if isinstance(node, ast.UnaryOp) else (node.left, node.right)
        value = _OPERATORS[type(node.op)](
            *(_evaluated(one, text, known, functions, expected, takes) for one in operands))
        if isinstance(value, complex):
            raise ValueError('a root of a negative number')
        return value
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name, arguments = node.func.id, node.args
        if name not in takes:
            raise FieldError(expected, f'{shown(text)} with the unknown function {name!r}',
                             nearest(name, takes) or f'there are {among(takes)}')
        if len(arguments) in takes[name]:
            return functions[name](
                *(_evaluated(one, text, known, functions, expected, takes) for one in arguments))
    raise FieldError(expected, shown(text), 'numbers, names, + - * / **, brackets and '
                     f'the functions {among(takes)}')


def names_of(text):
    """Return the names that an expression is made of, in order, but for those of constants."""
    root = parsed(without_units(text))
    nodes = [] if root is None else list(ast.walk(root))
    called = [node.func for node in nodes if isinstance(node, ast.Call)]
    names = [node for node in nodes if isinstance(node, ast.Name) and node not in called
             and node.id not in CONSTANTS]
    return [node.id for node in sorted(names, key=lambda node: node.col_offset)]


def parsed(text):
    """Return the root of an expression's tree, None where the text cannot be one."""
    if len(text) > LONGEST or not _CHARACTERS.fullmatch(text):
        return None
    try:
        with warnings.catch_warnings():
            # Python's advice on a spelling it would accept.
            warnings.simplefilter('ignore')
            return ast.parse(text.strip(), mode='eval').body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def put_changes(value, before, after):
    """
    Return a record with the differences of two others of its kind applied.

    It may differ from ``before`` in its own way, but not in its structure. FieldError where it has
    no place for a change.
    """
    if is_dataclass(after) and type(value) is type(before) is type(after):
        found = {}
        for field in fields(after):
            one, other = getattr(before, field.name), getattr(after, field.name)
            if one is not other:
                with at(field.name):
                    found[field.name] = put_changes(getattr(value, field.name), one, other)
        return replace(value, **found)
    if before == after:
        return value
    if isinstance(after, tuple) and len(value) == len(before) == len(after):
        return tuple(map(put_changes, value, before, after))
    if isinstance(after, dict) and set(before) == set(after) <= set(value):
        return {**value, **{key: put_changes(value[key], before[key], after[key])
                            for key in after}}
    if isinstance(after, tuple) and any(map(is_dataclass, after)):
        raise FieldError('the section of the file, whose numbers depend on its parameters',
                         'a section that was changed since')
    return after


def _of_numbers(kind):
    """Return whether a field of this type is made of numbers."""
    parts = get_args(kind)
    if get_origin(kind) is dict:
        return _of_numbers(parts[1])
    return kind is float or str not in parts and any(map(_of_numbers, parts))
