# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From unrolled arithmetic to C99."""

from . import sincos
from .expression_graph import (
    ADD, ARCTANGENT, BOTH, CHOOSE, COSINE, DIVIDE, EXPONENTIAL, GREATER_EQUAL, LESS, LOAD,
    LOGARITHM, MULTIPLY, needed_for, NEGATE, POWER, SINE, SQUARE_ROOT, SUBTRACT)

_INFIX = {ADD: '+', SUBTRACT: '-', MULTIPLY: '*', DIVIDE: '/', LESS: '<', GREATER_EQUAL: '>=',
          BOTH: '&'}
_FUNCTIONS = {SQUARE_ROOT: 'sqrt', EXPONENTIAL: 'exp', LOGARITHM: 'log', ARCTANGENT: 'atan2',
              POWER: 'pow'}
_CONDITIONS = (LESS, GREATER_EQUAL, BOTH)


def _series(coefficients):
    """Return a polynomial in z, Horner's way."""
    text = repr(coefficients[0])
    for coefficient in coefficients[1:]:
        text = f'({text} * z + {coefficient!r})'
    return text


# As ``sincos`` has it, where the reasons are: a loop without branches, which compilers turn into
# vectors, and the C library for angles beyond.
SINE_AND_COSINE = f"""\
static void sines_and_cosines(int count, const double *angle, double *sine, double *cosine)
{{
  for (int n = 0; n < count; ++n) {{
    const double shifted = angle[n] * 0.6366197723675814 + {sincos.ROUNDER!r};
    const double turns = shifted - {sincos.ROUNDER!r};
    /* The last two bits of the nearest whole number of quarter turns. */
    const double by_four = (turns * 0.25 + {sincos.ROUNDER!r}) - {sincos.ROUNDER!r};
    const double quarter = turns - 4.0 * by_four;
    const double near = angle[n] - turns * {sincos.PARTS[0]!r};
    const double part = turns * {sincos.PARTS[1]!r};
    const double first = near - part;
    const double rest = ((near - first) - part) - turns * {sincos.PARTS[2]!r};
    const double x = first + rest;
    const double tail = (first - x) + rest;
    const double z = x * x;
    const double odd = {_series(sincos.SINE)};
    const double s = x + (z * x * odd + tail * (1.0 - 0.5 * z));
    const double even = {_series(sincos.COSINE)};
    const double coarse = 1.0 - 0.5 * z;
    const double c = coarse + (((1.0 - coarse) - 0.5 * z) + (z * z * even - x * tail));
    const int swapped = (quarter == 1.0) | (quarter == -1.0);
    sine[n] = (swapped ? c : s) * ((quarter == -1.0) | (quarter * quarter == 4.0) ? -1.0 : 1.0);
    cosine[n] = (swapped ? s : c) * ((quarter == 1.0) | (quarter * quarter == 4.0) ? -1.0 : 1.0);
  }}
  for (int n = 0; n < count; ++n) {{
    if (!(fabs(angle[n]) < {sincos.LARGEST!r})) {{
      sine[n] = sin(angle[n]);
      cosine[n] = cos(angle[n]);
    }}
  }}
}}
"""


def statements(routine, places):
    """
    Return the statements of a routine.

    Parameters
    ----------
    routine : Routine
        What it computes.
    places : dict of int to str
        By input or output, the array in C: a pointer to doubles.

    Returns
    -------
    list of str
        The last one returns 1 where the branches that were taken are right, else 0.

    """
    operations, use = routine.graph.operations, routine.needed()
    lines, waves = [], _waves(operations, use)
    written = set()

    def name(operand):
        return f'v{operand}' if isinstance(operand, int) else _number(operand)

    def write(some):
        for place in sorted(some - written):
            kind, *operands = operations[place]
            if kind in (SINE, COSINE):
                continue
            if kind == LOAD:
                source, at = operands
                right = f'{places[source]}[{at}]'
            elif kind in _INFIX:
                right = f' {_INFIX[kind]} '.join(map(name, operands))
            elif kind == CHOOSE:
                condition, yes, no = map(name, operands)
                right = f'{condition} ? {yes} : {no}'
            elif kind == NEGATE:
                right = f'-{name(operands[0])}'
            else:
                right = f'{_FUNCTIONS[kind]}({", ".join(map(name, operands))})'
            kind = 'int' if kind in _CONDITIONS else 'double'
            lines.append(f'const {kind} v{place} = {right};')
        written.update(some)

    for number, angles in enumerate(waves):
        write(needed_for(operations, angles))
        lines.append(f'double s{number}[{len(angles)}], c{number}[{len(angles)}];')
        lines.append(f'const double a{number}[] = {{{", ".join(map(name, angles))}}};')
        lines.append(
            f'sines_and_cosines({len(angles)}, a{number}, s{number}, c{number});')
        at = {angle: n for n, angle in enumerate(angles)}
        for place in sorted(use):
            kind, *operands = operations[place]
            if kind in (SINE, COSINE) and operands[0] in at:
                array = 's' if kind == SINE else 'c'
                lines.append(f'const double v{place} = {array}{number}[{at[operands[0]]}];')
                written.add(place)
    write(use)
    for source, place, value in routine.outputs:
        known = value.place if hasattr(value, 'place') else float(value)
        lines.append(f'{places[source]}[{place}] = {name(known)};')
    guard = routine.graph.guard
    lines.append(f'return {1 if guard is None else name(guard.place)};')
    return lines


def _waves(operations, use):
    """Return angles whose sines are needed, those that depend on sines of others after these."""
    depth = {}
    for place in sorted(use):
        kind, *operands = operations[place]
        depth[place] = 0 if kind == LOAD else (kind in (SINE, COSINE)) + max(
            (depth[one] for one in operands if isinstance(one, int)), default=0)
    found = {}
    for place in sorted(use):
        if operations[place][0] in (SINE, COSINE):
            found.setdefault(depth[place], set()).add(operations[place][1])
    return [sorted(found[number]) for number in sorted(found)]


def _number(value):
    """Return a number as C reads it, to the last bit."""
    return f'({value!r})' if value < 0.0 else repr(value)
