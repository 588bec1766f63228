# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Machine code of routines by the C compiler of the system, where llvmlite is not installed.

A routine is single numbers in C, without vectors. The compiler needs no headers and no library:
the functions of the C library are found in the process.
"""

from concurrent.futures import ThreadPoolExecutor
import ctypes
import functools
import os
from pathlib import Path
import platform
import shlex
import shutil
import subprocess
from tempfile import TemporaryDirectory
import warnings

from .c_writer import SINE_AND_COSINE, Statements
from .expression_graph import CALL, Q, QD, TAKE, with_others
from .function_table import (
    BAUMGARTE, ENTRIES, LANES, LAW_COLUMNS, PLACES, PRESENT, PRESENT_COLUMNS, SHARED, TAU)

FLAGS = ('-O1', '-fPIC', '-shared', '-nostdlib', '-ffp-contract=off', '-fno-math-errno', '-w')
HEAD = f"""\
#include <float.h>
double fabs(double), sqrt(double), exp(double), log(double), sin(double), cos(double);
double atan2(double, double), pow(double, double);
typedef double engine(double *, double *, double, double, double, double, double *);
{SINE_AND_COSINE}"""
OF_TABLE = 'const long long *table, double *q, double *qd'
OF_ROWS = ', '.join(f'double *row{n}' for n in range(5))


class NoCompilerError(OSError):
    """Nothing here makes machine code; the message says what to install."""


class _Arrays(dict):
    """The arrays of a function table in C."""

    def __missing__(self, source):
        return f'((double *)table[{source}])'


class _Scalar(Statements):
    """Statements of a routine on the arrays of its function table."""

    PACKED, PLACES, PARAMETERS = False, _Arrays({Q: 'q', QD: 'qd'}), OF_TABLE

    def _call(self, place, kind, *operands):
        if kind == TAKE:
            return f'r{operands[0]}[{int(operands[1])}]'
        if kind != CALL:
            return super()._call(place, kind, *operands)
        self.lines.append(f'double r{place}[5];')
        entry, effect, begin = map(int, operands[:3])
        arguments = [
            f'{self._places[ENTRIES]} + {begin}',
            f'{self._places[PRESENT]} + {effect * PRESENT_COLUMNS}',
            *map(self._name, operands[3:]), f'r{place}']
        return f'((engine *)table[{entry}])({", ".join(arguments)})'

    @classmethod
    def of(cls, routine):
        """Return the statements of a routine, which calls that which does the same otherwise."""
        other = routine.otherwise
        return cls(routine, cls.PLACES, None if other is None else (
            f'return {other.name}(table, q, qd)'))

    def text(self):
        """Return what computes the routine, and returns whether its results are good."""
        return '\n'.join(self.lines)


class _Row(_Scalar):
    """Statements of a law of force: forces in joints and on bodies are added."""

    def _sign(self, source):
        return '+=' if source == TAU or source >= LAW_COLUMNS else '='


class _Kernel(_Scalar):
    """Statements of a joint kernel on the rows that it is called with."""

    PLACES, PARAMETERS = [f'row{n}' for n in range(5)], OF_ROWS


class _Lanes(_Scalar):
    """Statements of a routine for one state after the other."""

    LANES = LANES

    @classmethod
    def of(cls, routine):
        """Return the statements of what does the same in all lanes."""
        if routine.otherwise is None:
            return cls(routine, cls.PLACES)
        # A lane whose results are not right alone does otherwise.
        found, other = (cls(routine, cls.PLACES, 'goto otherwise'),
                        cls(routine.otherwise, cls.PLACES))
        found.lines = ['{', *found.lines[:-1], 'continue;', '}', 'otherwise: ;', *other.lines]
        return found

    def _element(self, source, place):
        array = self._places[source]
        return f'{array}[{place}]' if self._is_shared(source) else (
            f'{array}[{self.LANES * place} + lane]')

    def _is_shared(self, source):
        return source in (BAUMGARTE, SHARED)

    def text(self):
        """Return a loop over the lanes."""
        *lines, end = self.lines
        good = end.removeprefix('return ')
        return '\n'.join((f'int good = 1;\nfor (int lane = 0; lane < {self.LANES}; ++lane) {{',
                          *lines, f'good &= {good}', '}', 'return good;'))


class _Places(_Lanes):
    """Statements of a routine for several states of one mechanism."""

    LANES = PLACES

    def __init__(self, routine, places, otherwise=None):
        self._outputs = {source for source, _, _ in routine.outputs}
        super().__init__(routine, places, otherwise)

    def _is_shared(self, source):
        return source not in (Q, QD) and source not in self._outputs


WRITERS = {'Writer': _Scalar, 'PackedWriter': _Scalar, 'RowWriter': _Row, 'KernelWriter': _Kernel,
           'LaneWriter': _Lanes, 'PlaceWriter': _Places}


def compiler():
    """Return the command of the C compiler: ``CC``, or that of the system; empty if none."""
    if os.environ.get('CC'):
        return shlex.split(os.environ['CC'])
    return next(([name] for name in ('gcc', 'clang', 'cc') if shutil.which(name)), [])


def host():
    """Return what code depends on beside its routines: code of one architecture is all alike."""
    return platform.system(), platform.machine()


def compiled(routines, form, parts):
    """Return shared libraries with routines, as bytes; NoCompilerError where nothing compiles."""
    if not compiler():
        raise NoCompilerError(
            'no code can be generated for the mechanism: llvmlite is not installed, and there is '
            'no C compiler in its place (CC, gcc, clang, cc). Install one of them: pip install '
            'llvmlite; Debian, Ubuntu: apt install gcc')
    _tell()
    writer = WRITERS[form[1]]
    with TemporaryDirectory() as place, ThreadPoolExecutor(parts) as others:
        return list(others.map(
            lambda part: _library(routines[part::parts], writer, Path(place, f'{part}.c')),
            range(parts)))


@functools.cache
def _tell():
    warnings.warn(
        f'llvmlite is not installed: {compiler()[0]} generates code in its place, which takes '
        'longer for a mechanism that is new, and computes up to twice as long')


def _library(routines, writer, source):
    """Compile routines to one shared library."""
    source.write_text('\n'.join((HEAD, *(
        f'long long {routine.name}({writer.PARAMETERS})\n{{\n{writer.of(routine).text()}\n}}'
        for routine in with_others(routines)))))
    done = subprocess.run(
        [*compiler(), *FLAGS, source, '-o', source.with_suffix('.so')],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise NoCompilerError(f'{shlex.join(compiler())} could not compile generated code: '
                              f'{done.stdout[-1000:]}')
    return source.with_suffix('.so').read_bytes()


def loaded(libraries):
    """Load shared libraries for good; return a function from a routine's name to its address."""
    with TemporaryDirectory() as place:
        handles = []
        for number, library in enumerate(libraries):
            path = Path(place, f'{number}.so')
            path.write_bytes(library)
            handles.append(ctypes.CDLL(path))

    def address(name):
        found = next(handle for handle in handles if hasattr(handle, name))
        return ctypes.cast(getattr(found, name), ctypes.c_void_p).value

    return address
