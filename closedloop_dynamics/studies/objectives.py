# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Objectives and requirements as expressions of quantities.

``max(force.pin)``, ``rms(torque.crank) + 0.1*max(shaking_force)``,
``min(transmission_angle) >= 40deg``: the arithmetic of ``mechanism.expressions``, with quantities
of the driven machine (``quantities``) and numbers of its scene as names.

Where the largest value over the motion is minimised, or bounded, it is so at every pose: these
values are smooth, the largest of them is not. And where the root of a mean square is minimised,
its parts are known to least squares.
"""

import ast
import re

import numpy as np

from .quantities import Infeasible, quantities_of
from .slopes import (
    deviation, distance_parts, ON_SLOPES, Slope, squared_parts, TAKES)
from ..mechanism.expressions import CONSTANTS, parsed, value_of, without_units
from ..mechanism.fields import among, at, FieldError, nearest, shown
from ..scene.key_paths import numbers

EXPECTED = 'an expression of quantities of the driven machine'
_DISTANCE = re.compile(r'(distance\(\s*[A-Za-z]\w*\s*,)\s*([^,()]+?)\s*\)')
_DOTTED = re.compile(r'[A-Za-z]\w*(?:\.\w+)+')
# In names that replace others in the text that is evaluated.
DOT = '__'
# Relative violation of a constraint that counts as none.
TOLERANCE = 1e-6


def places_named(text):
    """Return the names of the places in the ``distance`` terms of a text."""
    return [match[2] for match in _DISTANCE.finditer(text)]


class Expression:
    """
    An expression of quantities, of a text as users write it; FieldError where it is not one.

    It names quantities and numbers of a scene, driven joints and coordinates of points
    (``drives``), and ``paths``, places [m] by the names that ``distance`` has for them, shape (m,
    2), in space (m, 3).
    """

    def __init__(self, text, scene, drives, paths=()):
        self.text, paths = text, dict(paths)
        self._paths, self._names = {}, {}

        def path(match):
            name = match[2]
            if name not in paths:
                raise FieldError(f'places among {among(paths) or "none"}', shown(name))
            stands = f'places{DOT}{len(self._paths)}'
            self._paths[stands] = paths[name]
            return f'{match[1]} {stands})'

        written = without_units(_DISTANCE.sub(path, text))
        written = _DOTTED.sub(lambda match: match[0].replace('.', DOT), written)
        root = parsed(written)
        if root is None:
            raise FieldError(EXPECTED, shown(text))
        quantities, known = quantities_of(scene.mechanism, drives), numbers(scene)
        for word in _words(root):
            self._name(word, quantities, known)
        self._written = written
        self._sign, self._call, self._inner = _root(root, written.strip())

    def _name(self, word, quantities, known):
        """Add the quantity of a word of the text."""
        name = word.replace(DOT, '.')
        if word in self._paths or word in CONSTANTS or word in TAKES:
            return
        if name in quantities:
            self._names[word] = name
        elif known.get(name) is not None:
            self._names[word] = f'={name}'
        else:
            near = nearest(name, [*quantities, *TAKES, *known])
            raise FieldError(EXPECTED, f'{shown(self.text)} with the unknown name {name!r}',
                             near or f'there are {among(quantities)}')

    def value(self, quantities):
        """
        Return its value, one number with derivatives.

        Infeasible where the machine, or the expression, has none; FieldError where it is not one
        number.
        """
        found = self._of(self._written, quantities)
        if not isinstance(found, Slope) or found.value.ndim:
            if isinstance(found, float):
                return Slope(found, np.zeros(quantities.count))
            raise FieldError('an expression that is one number: max, rms, mean, ... of what '
                             'changes over the motion', shown(self.text))
        return found

    def largest_parts(self, quantities):
        """Return values over the motion the largest of which it is, or None."""
        if (self._sign, self._call) not in ((1, 'max'), (-1, 'min'), (1, 'straightness')):
            return None
        found = self._of(self._inner[0], quantities)
        if self._call == 'straightness':
            return self._checked(deviation, found)
        return found if self._sign > 0 else -found

    def squared_parts(self, quantities):
        """Return numbers the length of which it is, or None."""
        if self._sign < 0 or self._call not in ('rms', 'distance'):
            return None
        found = [self._of(text, quantities) for text in self._inner]
        return self._checked(squared_parts if self._call == 'rms' else distance_parts, *found)

    @property
    def is_squared(self):
        """Return whether it is the root of a mean square."""
        return self._sign > 0 and self._call in ('rms', 'distance')

    def _of(self, text, quantities):
        """Return the value of a part of the text."""
        words = _words(parsed(text))
        known = {word: places for word, places in self._paths.items() if word in words}
        for word, name in self._names.items():
            if word in words:
                known[word] = quantities.number(name[1:]) if name[0] == '=' else quantities[name]
        functions = {**ON_SLOPES, 'part': quantities.part}
        return self._checked(lambda: value_of(text, known, functions, EXPECTED, TAKES))

    def _checked(self, function, *operands):
        """Return a function's result, with errors in the words of the text."""
        try:
            with np.errstate(divide='raise', invalid='raise', over='raise'):
                return function(*operands)
        except ArithmeticError as error:
            raise Infeasible(f'{self.text}: no value: {error}') from None
        except TypeError:
            raise FieldError('arithmetic of numbers (of a point its coordinates, tool.x)',
                             shown(self.text)) from None
        except FieldError as error:
            # What value_of makes of arithmetic that fails; other errors are in the text.
            if isinstance(error.__context__, ArithmeticError):
                raise Infeasible(f'{self.text}: no value: {error.note}') from None
            raise FieldError(error.expected, error.got.replace(DOT, '.'), error.note,
                             error.path) from None


def _words(root):
    """Return the names in the tree of an expression."""
    return list(dict.fromkeys(
        node.id for node in ast.walk(root) if isinstance(node, ast.Name)))


def _root(root, text):
    """Return sign, function and operands' texts of an expression that is one call."""
    sign = 1
    if isinstance(root, ast.UnaryOp) and isinstance(root.op, ast.USub):
        sign, root = -1, root.operand
    if isinstance(root, ast.Call) and isinstance(root.func, ast.Name) and (
            len(root.args) == (2 if root.func.id == 'distance' else 1)):
        return sign, root.func.id, [ast.get_source_segment(text, one) for one in root.args]
    return sign, None, []


class Requirement:
    """``EXPRESSION >= EXPRESSION``, or ``<=``; arguments and errors are as for ``Expression``."""

    def __init__(self, text, scene, drives, paths=()):
        self.text = text
        parts = re.split(r'(>=|<=)', text)
        if len(parts) != 3:
            raise FieldError('EXPRESSION >= EXPRESSION, or <=', shown(text))
        left, relation, right = parts
        smaller, larger = (left, right) if relation == '<=' else (right, left)
        self._smaller, self._larger = (
            Expression(one.strip(), scene, drives, paths) for one in (smaller, larger))
        # The largest value is below where all are; -min(x) <= -c for min(x) >= c.
        self._negated = Expression(f'-{larger.strip()}', scene, drives, paths)

    def sizes(self, quantities):
        """Return both sides."""
        return (float(self._smaller.value(quantities).value),
                float(self._larger.value(quantities).value))

    def gaps(self, quantities):
        """Return numbers that are >= 0 where it is met; of several poses, one each."""
        smaller, larger = (one.largest_parts(quantities) for one in (
            self._smaller, self._negated))
        if smaller is not None:
            return self._larger.value(quantities) - smaller
        if larger is not None:
            return -larger - self._smaller.value(quantities)
        gap = self._larger.value(quantities) - self._smaller.value(quantities)
        return Slope(gap.value[np.newaxis], gap.slope[np.newaxis])

    def missed(self, quantities):
        """Return by how much it is missed, of the size of its sides; 0 where it is met."""
        smaller, larger = self.sizes(quantities)
        return max(0.0, smaller - larger) / (max(abs(smaller), abs(larger)) or 1.0)


class Bound:
    """An upper bound of an expression."""

    def __init__(self, expression, most):
        self._expression, self._most = expression, most
        self.text = f'{expression.text} <= {most:.6g}'

    def sizes(self, quantities):
        """Return both sides."""
        return float(self._expression.value(quantities).value), self._most

    def gaps(self, quantities):
        """Return numbers that are >= 0 where it is met."""
        parts = self._expression.largest_parts(quantities)
        if parts is not None:
            return self._most - parts
        gap = self._most - self._expression.value(quantities)
        return Slope(gap.value[np.newaxis], gap.slope[np.newaxis])

    missed = Requirement.missed


def read_all(kind, option, texts, scene, drives, paths=()):
    """Return expressions or requirements of several texts, with errors headed by the option."""
    with at(option):
        return tuple(kind(text, scene, drives, paths) for text in texts)
