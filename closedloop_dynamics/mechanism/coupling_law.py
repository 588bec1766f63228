# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions f(x) of a joint's coordinate, by which couplings are not linear.

A polynomial, a cubic spline through a table, or an expression; each is evaluated on arrays here,
and on symbols where code is generated of it.
"""

from dataclasses import fields
import re

import numpy as np

from .checks import list_of, name, number, positive, text
from .expressions import FUNCTIONS, names_of, value_of, without_units
from .fields import at, FieldError, keys_of, mapping, normalise, shown
from .mechanism import CouplingLaw

EXPECTED = 'an expression of x, numbers and parameters'
# Functions of expressions, which have derivatives: not abs, min and max.
SMOOTH = {key: count for key, count in FUNCTIONS.items() if key not in ('abs', 'min', 'max')}
_ELSEWHERE = {'asin': 'arcsin', 'acos': 'arccos', 'atan': 'arctan', 'atan2': 'arctan2'}
ON_ARRAYS = {key: getattr(np, _ELSEWHERE.get(key, key)) for key in SMOOTH}
MOST_POINTS, MOST_COEFFICIENTS = 200, 17
# How far a period's ends may differ, against the largest value or slope.
CLOSED = 1e-9
_CHECKS = {'polynomial': list_of(number), 'x': list_of(number), 'values': list_of(number),
           'period': positive, 'expression': text}
# The keys of each way to give a law, and those that it may have.
_WAYS = {'polynomial': {'polynomial', 'period'}, 'x': {'x', 'values', 'period'},
         'expression': {'expression'}}


def read_law(values, parameters):
    """Return the law of a mapping in a file, with the values of ``parameters``; FieldError."""
    values = dict(mapping(values, *keys_of(CouplingLaw)))
    written = values.pop('expression', None)
    found = parameters.evaluated({key: value for key, value in values.items() if key != 'joint'})
    if isinstance(written, str):
        parameters.used.update(set(names_of(written)) & parameters.values.keys())
        written = re.sub(
            r'(?<![\w.])[A-Za-z]\w*', lambda word: word[0] if word[0] == 'x' else
            f'({parameters.values[word[0]]!r})' if word[0] in parameters.values else word[0],
            without_units(written))
    return CouplingLaw(values['joint'], expression=written, **found)


def law_data(law):
    """Return the mapping that a file has of a law."""
    return {key: value for key, value in vars(law).items() if value is not None}


def checked_law(value):
    """Return a law of a coupling with its numbers checked; None where there is none."""
    if value is None:
        return None
    if not isinstance(value, CouplingLaw):
        raise FieldError('a CouplingLaw', shown(value))
    given = {one.name for one in fields(value) if getattr(value, one.name) is not None}
    law = normalise(CouplingLaw(**vars(value)), joint=name,
                    **{key: check for key, check in _CHECKS.items() if key in given})
    ways = [way for way in _WAYS if way in given]
    if len(ways) != 1:
        raise FieldError('one of polynomial, x with values, and expression',
                         ' and '.join(ways) or 'none')
    for key in sorted(given - {'joint'} - _WAYS[ways[0]]):
        raise FieldError(f'this key not beside {ways[0]}', shown(getattr(law, key)), path=(key,))
    {'polynomial': _check_polynomial, 'x': _check_table, 'expression': _check_expression}[
        ways[0]](law)
    return law


def _check_polynomial(law):
    if not 2 <= len(law.polynomial) <= MOST_COEFFICIENTS:
        raise FieldError(f'2 to {MOST_COEFFICIENTS} coefficients, from c0 on',
                         f'{len(law.polynomial)}', path=('polynomial',))
    if law.period is not None:
        one = np.polynomial.Polynomial(law.polynomial)
        for what, each in ('value', one), ('slope', one.deriv()):
            begin, end = each(0.0), each(law.period)
            if abs(end - begin) > CLOSED * max(abs(each.coef * law.period ** np.arange(
                    len(each.coef)))):
                raise FieldError(
                    f'a polynomial whose {what} is the same at both ends of its period',
                    f'{begin:.9g} at 0 and {end:.9g} at {law.period:.9g}', path=('polynomial',))


def _check_table(law):
    x = law.x
    if not 3 <= len(x) <= MOST_POINTS:
        raise FieldError(f'3 to {MOST_POINTS} points', f'{len(x)}', path=('x',))
    if law.values is None or len(law.values) != len(x):
        raise FieldError(f'{len(x)} values, one for each x',
                         'none' if law.values is None else f'{len(law.values)}',
                         path=('values',))
    for index, (one, other) in enumerate(zip(x, x[1:])):
        if not one < other:
            raise FieldError(f'numbers that grow (more than {one:g})', f'{other:g}',
                             path=('x', index + 1))
    if law.period is not None:
        if abs(x[-1] - x[0] - law.period) > CLOSED * law.period:
            raise FieldError(f'numbers over one period of {law.period:g}',
                             f'{x[0]:g} to {x[-1]:g}', path=('x',))
        if law.values[0] != law.values[-1]:
            raise FieldError(
                f'the first value ({law.values[0]:g}) again at the end of the period',
                f'{law.values[-1]:g}', path=('values', len(x) - 1))


def _check_expression(law):
    with at('expression'):
        law_value(law, np.zeros(1), ON_ARRAYS, np.where)
        if 'x' not in names_of(law.expression):
            raise FieldError(EXPECTED, f'{shown(law.expression)}, which does not name x')


def shifted(coefficients, by):
    """Return the coefficients, from the lowest on, of a polynomial p(x + by)."""
    one = np.polynomial.Polynomial(coefficients)(np.polynomial.Polynomial((by, 1.0)))
    return tuple(map(float, one.coef))


def law_value(law, x, functions=ON_ARRAYS, chosen=np.where):
    """
    Return f(x) of a law.

    ``x``: an array or a symbol; ``functions``, by the names of SMOOTH, and ``chosen(condition,
    yes, no)`` work on that.
    """
    if law.expression is not None:
        with np.errstate(all='ignore'):
            return value_of(law.expression, {'x': x}, functions, EXPECTED, SMOOTH)
    pieces = [(0.0, law.polynomial)] if law.x is None else _spline(law)
    if law.period is not None:
        middle = pieces[0][0] + 0.5 * law.period
        turned = (2.0 * np.pi / law.period) * (x - middle)
        x = middle + (0.5 * law.period / np.pi) * functions['atan2'](
            functions['sin'](turned), functions['cos'](turned))
    start, coefficients = _present(pieces, x, chosen)
    value = 0.0
    for coefficient in reversed(coefficients):
        value = coefficient + (x - start) * value
    return value


def _present(pieces, x, chosen):
    """Return start and coefficients of the piece of a chain in which x is."""
    if len(pieces) == 1:
        return pieces[0]
    half = len(pieces) // 2
    before = x < pieces[half][0]
    (first, low), (second, high) = (
        _present(part, x, chosen) for part in (pieces[:half], pieces[half:]))
    return chosen(before, first, second), [
        chosen(before, *both) for both in zip(low, high)]


def _spline(law):
    """Return start and coefficients of each piece of the spline through a table."""
    # Not before it is wanted: it takes a third of the time that loading the package would.
    from scipy.interpolate import CubicSpline
    spline = CubicSpline(law.x, law.values,
                         bc_type='natural' if law.period is None else 'periodic')
    pieces = [(start, tuple(map(float, column)))
              for start, column in zip(law.x, spline.c[::-1].T)]
    if law.period is None:
        begin, end = ((place, (float(spline(place)), float(spline(place, 1)), 0.0, 0.0))
                      for place in (law.x[0], law.x[-1]))
        # Straight lines before the first point and after the last one.
        pieces = [begin, *pieces, end]
    return pieces
