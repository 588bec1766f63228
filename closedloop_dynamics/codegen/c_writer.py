# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""C99 writer for traced arithmetic."""

import re

from . import sincos
from .expression_graph import (
    ADD, ARCTANGENT, BOTH, CHOOSE, COSINE, DIVIDE, EXPONENTIAL, GREATER_EQUAL, LESS, LOAD,
    LOGARITHM, MULTIPLY, needed_for, NEGATE, POWER, SINE, SQUARE_ROOT, SUBTRACT)
from .function_table import LANES
from .packing import ARITHMETIC, packing_of

_INFIX = {ADD: '+', SUBTRACT: '-', MULTIPLY: '*', DIVIDE: '/', LESS: '<', GREATER_EQUAL: '>=',
          BOTH: '&'}
_FUNCTIONS = {SQUARE_ROOT: 'sqrt', EXPONENTIAL: 'exp', LOGARITHM: 'log', ARCTANGENT: 'atan2',
              POWER: 'pow'}
_CONDITIONS = (LESS, GREATER_EQUAL, BOTH)


def _series(coefficients):
    """Return a polynomial of six coefficients in z, in pairs."""
    high, middle, low = (f'({first!r} * z + {second!r})'
                         for first, second in zip(coefficients[::2], coefficients[1::2]))
    return f'((zz * {high} + {middle}) * zz + {low})'


# As ``sincos`` has it, where the reasons are: a loop without branches, which compilers turn into
# vectors, and the C library for angles beyond. It is written behind ``#include <float.h>``.
SINE_AND_COSINE = f"""\
/* A sum with a large number rounds to whole ones where each sum is rounded to a double: x87 keeps
 * more digits, and -ffast-math drops the large number. There the C library does all angles. */
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD == 0 && !defined(__FAST_MATH__)
#define LARGEST_ANGLE {sincos.LARGEST!r}
#else
#define LARGEST_ANGLE 0.0
#endif
static void sines_and_cosines(int count, const double *angle, double *sine, double *cosine)
{{
  for (int n = 0; n < count && LARGEST_ANGLE > 0.0; ++n) {{
    const double shifted = angle[n] * 0.6366197723675814 + {sincos.ROUNDER!r};
    const double turns = shifted - {sincos.ROUNDER!r};
    /* The last two bits of the nearest whole number of quarter turns. */
    const double by_four = (turns * 0.25 + {sincos.ROUNDER!r}) - {sincos.ROUNDER!r};
    const double quarter = turns - 4.0 * by_four;
    const double near = angle[n] - turns * {sincos.PARTS[0]!r};
    const double part = turns * {sincos.PARTS[1]!r};
    const double x = near - part;
    const double tail = ((near - x) - part) - turns * {sincos.PARTS[2]!r};
    const double z = x * x, zz = z * z, xz = x * z;
    const double coarse = 1.0 - 0.5 * z;
    const double odd = {_series(sincos.SINE)};
    const double s = x + (xz * odd + tail * (coarse + zz * {1.0 / 24.0!r}));
    const double even = {_series(sincos.COSINE)};
    const double lost = (1.0 - coarse) - 0.5 * z;
    const double c = coarse + (zz * even + (lost - tail * (x - xz * {1.0 / 6.0!r})));
    const int swapped = (quarter == 1.0) | (quarter == -1.0);
    sine[n] = (swapped ? c : s) * (((quarter == -1.0) | (quarter * quarter == 4.0)) ? -1.0 : 1.0);
    cosine[n] = (swapped ? s : c) * (((quarter == 1.0) | (quarter * quarter == 4.0)) ? -1.0 : 1.0);
  }}
  for (int n = 0; n < count; ++n) {{
    if (!(fabs(angle[n]) < LARGEST_ANGLE)) {{
      sine[n] = sin(angle[n]);
      cosine[n] = cos(angle[n]);
    }}
  }}
}}
"""

# In single precision all angles are the C library's.
LIBRARY_SINES = """\
static void sines_and_cosines(int count, const double *angle, double *sine, double *cosine)
{
  for (int n = 0; n < count; ++n) {
    sine[n] = sin(angle[n]);
    cosine[n] = cos(angle[n]);
  }
}
"""


# Numbers side by side: as many vectors as it takes of the width that the processor has, or, where
# the compiler knows none, single numbers. Read again for another processor, under other names.
VECTORS = """\
#define four VERSION(four)
#define eight VERSION(eight)
#define part_of_four VERSION(part_of_four)
#define part_of_eight VERSION(part_of_eight)
#undef WIDTH
#undef PARTS_OF_FOUR
#undef PARTS_OF_EIGHT
#undef AT_FOUR
#undef AT_EIGHT
#if !defined(__GNUC__)
#define WIDTH 1
#define PARTS_OF_FOUR(of, a, sign, b) \\
  {{of(a, sign, b, 0), of(a, sign, b, 1), of(a, sign, b, 2), of(a, sign, b, 3)}}
#define PARTS_OF_EIGHT(of, a, sign, b) \\
  {{of(a, sign, b, 0), of(a, sign, b, 1), of(a, sign, b, 2), of(a, sign, b, 3), \\
    of(a, sign, b, 4), of(a, sign, b, 5), of(a, sign, b, 6), of(a, sign, b, 7)}}
typedef double part_of_four, part_of_eight;
#define AT_FOUR(v, place) (v).parts[place]
#define AT_EIGHT(v, place) (v).parts[place]
#else
#if defined(__AVX__)
#define PARTS_OF_FOUR(of, a, sign, b) {{of(a, sign, b, 0)}}
typedef double part_of_four __attribute__((vector_size(4 * sizeof(double))));
#define AT_FOUR(v, place) (v).parts[0][place]
#else
#define PARTS_OF_FOUR(of, a, sign, b) {{of(a, sign, b, 0), of(a, sign, b, 1)}}
typedef double part_of_four __attribute__((vector_size(2 * sizeof(double))));
#define AT_FOUR(v, place) (v).parts[(place) / 2][(place) % 2]
#endif
/* GCC (12 at least) moves numbers between the halves of a vector of eight by vpermilpd, which
 * leaves each pair of numbers where it is. */
#if defined(__AVX512F__) && defined(__clang__)
#define WIDTH 8
#define PARTS_OF_EIGHT(of, a, sign, b) {{of(a, sign, b, 0)}}
#elif defined(__AVX__)
#define WIDTH 4
#define PARTS_OF_EIGHT(of, a, sign, b) {{of(a, sign, b, 0), of(a, sign, b, 1)}}
#else
#define WIDTH 2
#define PARTS_OF_EIGHT(of, a, sign, b) \\
  {{of(a, sign, b, 0), of(a, sign, b, 1), of(a, sign, b, 2), of(a, sign, b, 3)}}
#endif
typedef double part_of_eight __attribute__((vector_size(WIDTH * sizeof(double))));
#define AT_EIGHT(v, place) (v).parts[(place) / WIDTH][(place) % WIDTH]
/* All numbers of a vector are in one pair of braces. */
#pragma GCC diagnostic ignored "-Wmissing-braces"
#endif
typedef struct {part_of_four parts[4 * sizeof(double) / sizeof(part_of_four)];} four;
typedef struct {part_of_eight parts[8 / WIDTH];} eight;
#define PART(a, sign, b, n) (a).parts[n] sign (b).parts[n]
#define PART_NEGATED(a, sign, b, n) -(a).parts[n]
#define FOUR(a, sign, b) PARTS_OF_FOUR(PART, a, sign, b)
#define EIGHT(a, sign, b) PARTS_OF_EIGHT(PART, a, sign, b)
#define NEGATIVE_FOUR(a) PARTS_OF_FOUR(PART_NEGATED, a, , )
#define NEGATIVE_EIGHT(a) PARTS_OF_EIGHT(PART_NEGATED, a, , )
#define ALL_EIGHT(a) {{a, a, a, a, a, a, a, a}}
"""
_TYPES = {4: 'four', 8: 'eight'}


def statements(routine, places, otherwise=None):
    """
    Return the statements of a routine.

    ``places``: by input or output, the array in C: a pointer to doubles. The last statement
    returns 1 where the branches that were taken are right, else 0; ``otherwise``: as of
    ``Statements``.
    """
    return Statements(routine, places, otherwise).lines


class Statements:
    """Statements of one routine, in vectors where operations are the same on other inputs."""

    PACKED = True

    def __init__(self, routine, places, otherwise=None):
        """``otherwise``: the statement in the place of results that are not right, if any."""
        self.lines, self._places = [], places
        self._operations, use = routine.graph.operations, routine.needed()
        # Numbers that have a name, operands of vectors, and how many numbers these have.
        self._named, self._vectors, self._widths = set(), {}, {}
        waves = _waves(self._operations, use)
        self._packing = packing_of(
            routine, [angle for wave in waves for angle in wave], (3,),
            ARITHMETIC) if self.PACKED else None
        for number, angles in enumerate(waves):
            self._turn(number, angles, use)
        for members in ([place] for place in sorted(use)) if self._packing is None else (
                self._packing.ordered()):
            if len(members) == 1:
                self._compute(members[0])
            else:
                self._compute_in_lanes(members)
        guard = routine.graph.guard
        good = 1 if guard is None else self._name(guard.place)
        if otherwise is not None:
            self.lines.append(f'if (!{good}) {otherwise};')
        for source, place, value in routine.outputs:
            known = value.place if hasattr(value, 'place') else float(value)
            self.lines.append(f'{self._element(source, place)} {self._sign(source)} '
                              f'{self._name(known)};')
        self.lines.append(f'return {good};')

    def _element(self, source, place):
        """Return a number of an input or output."""
        return f'{self._places[source]}[{place}]'

    def _sign(self, _):
        """Return how a number is stored in an output."""
        return '='

    def _name(self, operand):
        """Return an operand; one in a vector gets a name of its own."""
        if not isinstance(operand, int):
            return _number(operand)
        if operand not in self._named:
            number, lane = self._packing.at[operand]
            self._define(operand, self._lane(number, lane))
        return f'v{operand}'

    def _lane(self, number, lane):
        return f'AT_{_TYPES[self._widths[number]].upper()}(w{number}, {lane})'

    def _define(self, place, right, kind='double'):
        self.lines.append(f'const {kind} v{place} = {right};')
        self._named.add(place)

    def _turn(self, number, angles, use):
        """Compute sines and cosines of some angles, and the operations they depend on."""
        for place in sorted(needed_for(self._operations, angles)):
            self._compute(place)
        self.lines += [
            f'double s{number}[{len(angles)}], c{number}[{len(angles)}];',
            f'const double a{number}[] = {{{", ".join(map(self._name, angles))}}};',
            f'sines_and_cosines({len(angles)}, a{number}, s{number}, c{number});']
        at = {angle: n for n, angle in enumerate(angles)}
        for place in sorted(use):
            kind, *operands = self._operations[place]
            if kind in (SINE, COSINE) and operands[0] in at:
                array = 's' if kind == SINE else 'c'
                self._define(place, f'{array}{number}[{at[operands[0]]}]')

    def _compute(self, place):
        """Compute one number, unless it is there."""
        kind, *operands = self._operations[place]
        if place in self._named or kind in (SINE, COSINE):
            return
        if kind == LOAD:
            right = self._element(*operands)
        elif kind in _INFIX:
            right = f' {_INFIX[kind]} '.join(map(self._name, operands))
        elif kind == CHOOSE:
            condition, yes, no = map(self._name, operands)
            right = f'{condition} ? {yes} : {no}'
        elif kind == NEGATE:
            right = f'-{self._name(operands[0])}'
        else:
            right = self._call(place, kind, *operands)
        self._define(place, right, 'int' if kind in _CONDITIONS else 'double')

    def _call(self, _, kind, *operands):
        """Return the result of a function."""
        return f'{_FUNCTIONS[kind]}({", ".join(map(self._name, operands))})'

    def _compute_in_lanes(self, members):
        """Compute a bundle."""
        operations = [self._packing.operations[place] for place in members]
        operands = [self._vector(each) for each in zip(*(one[1:] for one in operations))]
        number, width = self._packing.number(members[0]), 4 if len(members) <= 4 else 8
        self._widths[number] = width
        right = _in_vectors(_TYPES[width].upper(), operations[0][0], operands)
        self.lines.append(f'const {_TYPES[width]} w{number} = {right};')

    def _vector(self, operands):
        if operands not in self._vectors:
            width, padded, number, lanes = self._packing.gathered(operands)
            if number is not None and width == self._widths[number] and (
                    lanes[:len(operands)] == list(range(len(operands)))):
                return f'w{number}'
            numbers = map(self._name, padded) if number is None else (
                self._lane(number, lane) for lane in lanes)
            self._vectors[operands] = f'x{len(self._vectors)}'
            self.lines.append(f'const {_TYPES[width]} {self._vectors[operands]} = '
                              f'{{{{{", ".join(numbers)}}}}};')
        return self._vectors[operands]


def statements_in_lanes(routine, places, shared):
    """
    Return the statements of a routine that computes eight times the same side by side.

    It has sums, products and quotients alone. ``places`` are as for ``statements``; number k of
    lane n of an array is at place 8 k + n; all lanes have the input ``shared`` in common.
    """
    lines, constants = [], {}

    def name(operand):
        if isinstance(operand, int):
            return f'v{operand}'
        if operand not in constants:
            constants[operand] = f'k{len(constants)}'
            lines.append(f'const eight {constants[operand]} = ALL_EIGHT({_number(operand)});')
        return constants[operand]

    for place in sorted(routine.needed()):
        kind, *operands = routine.graph.operations[place]
        if kind != LOAD:
            right = _in_vectors('EIGHT', kind, list(map(name, operands)))
            lines.append(f'const eight v{place} = {right};')
        elif operands[0] == shared:
            lines.append(f'const eight v{place} = ALL_EIGHT({places[shared]}[{operands[1]}]);')
        else:
            lines.append(f'eight v{place};')
            lines.append(f'memcpy(&v{place}, {places[operands[0]]} + {LANES * operands[1]}, '
                         f'sizeof v{place});')
    for source, place, value in routine.outputs:
        known = name(value.place if hasattr(value, 'place') else float(value))
        lines.append(f'memcpy({places[source]} + {LANES * place}, &{known}, sizeof {known});')
    return lines


def in_single_precision(text):
    """Return C with numbers of single precision; comments, strings and names stay."""
    def changed(match):
        word = match[0]
        return (f'{word}f' if match['number'] or match['function'] else
                {'double': 'float', 'HUGE_VAL': 'HUGE_VALF'}[word] if match['word'] else word)

    return re.sub(
        r'"(?:\\.|[^"\\])*"|/\*.*?\*/'
        r'|(?<![\w.])(?P<number>\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])'
        fr'|\b(?P<function>fabs|sin|cos|{"|".join(_FUNCTIONS.values())})(?=\()'
        r'|\b(?P<word>double|HUGE_VAL)\b', changed, text, flags=re.DOTALL)


def _in_vectors(width, kind, operands):
    """Return an operation on vectors, as braces."""
    return f'NEGATIVE_{width}({operands[0]})' if kind == NEGATE else (
        f'{width}({operands[0]}, {_INFIX[kind]}, {operands[1]})')


def _waves(operations, use):
    """Return the angles whose sines are needed, each before those that depend on its sine."""
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
