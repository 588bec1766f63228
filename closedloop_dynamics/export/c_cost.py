# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What exported C costs at most: operations, stack and corrections, counted in its source."""

import re

from ..codegen.expression_graph import COSINE, SINE
from ..codegen.routines import count_operations

# Corrections of positions after a step, at most, each an evaluation of the closure equations.
MOST_CORRECTIONS = 8
# Evaluations in a step of the classical Runge-Kutta method.
STAGES = 4
# Beside its variables, what a function keeps at most: arguments, registers, alignment.
FRAME = 256
# Bytes of the types of variables, beside those of numbers.
_SIZES = {'int': 4, 'long': 8, 'size_t': 8}
_FUNCTION = re.compile(
    r'^[\w ]+? \**(VERSION\(\w+\)|\w+)\(([^;{]*?)\)\n\{\n(.*?)^\}', re.MULTILINE | re.DOTALL)


class Cost:
    """
    What the functions of one source cost at most.

    ``operations`` and ``sines``: by function that is generated, additions, multiplications,
    divisions, roots and the like, and sines or cosines; ``stack``: by public function, bytes of
    all variables and frames of the deepest calls, each variable in memory. ``size``: bytes of a
    number.
    """

    def __init__(self, size):
        self.size, self.operations, self.sines, self.stack = size, {}, {}, {}

    def count(self, head, routine, lanes=1):
        """Count the operations of a routine that becomes a function, in so many lanes."""
        name = re.search(r'(\w+)\)?$', head)[1]
        kinds = [routine.graph.operations[place][0] for place in routine.needed()]
        # At most what does the same otherwise runs, too.
        other = None if routine.otherwise is None else routine.otherwise.name
        self.operations[name] = lanes * count_operations(routine) + self.operations.get(other, 0)
        self.sines[name] = sum(
            kind in (SINE, COSINE) for kind in kinds) + self.sines.get(other, 0)

    def of_step(self, counts):
        """Return the sum of counts over a step with all its corrections."""
        return STAGES * counts['evaluation'] + (1 + MOST_CORRECTIONS) * counts['correction']

    def lines(self):
        """Return sentences that state the cost."""
        operations, sines = self.operations, self.sines
        yield (f'At most, an evaluation takes {operations["evaluation"]} operations and '
               f'{sines["evaluation"]} sines and cosines, a correction '
               f'{operations["correction"]} and {sines["correction"]}, a step {STAGES} '
               f'evaluations and {1 + MOST_CORRECTIONS} corrections: '
               f'{self.of_step(operations)} and {self.of_step(sines)}.')
        yield ('Stack, at most, in bytes, without what the C library takes: ' + ', '.join(
            f'{name} {size}' for name, size in self.stack.items()) + '.')

    def read(self, source, name, constants):
        """Find the stack of public functions in a source; ``constants``: its numbers, by name."""
        sizes = {**_SIZES, 'double': self.size, 'four': 4 * self.size, 'eight': 8 * self.size,
                 f'{name}_state': self.size * (constants['NQ'] + constants['NV']),
                 f'{name}_cost': 7 * self.size}
        # A call of the best version is one of any.
        source = source.replace('BEST(', 'VERSION(').replace(', (', ')(')
        found = [one.groups() for one in _FUNCTION.finditer(source)]
        own = {function: FRAME + _bytes(body, sizes, constants) for function, _, body in found}
        calls = {function: [other for other in own if other != function and re.search(
            rf'(?<![\w(]){re.escape(other)}\(', body)] for function, _, body in found}

        def deepest(function):
            return own[function] + max(map(deepest, calls[function]), default=0)

        self.stack = {function.removeprefix(f'{name}_'): deepest(function)
                      for function, parameters, _ in found
                      if function.startswith(f'{name}_') and 'model' in parameters}


def _bytes(body, sizes, constants):
    """Return how many bytes the variables of a function take, but for those that are static."""
    known, total = dict(constants), 0
    for listed in re.findall(r'enum \{([^}]*)\}', body):
        for one in listed.split(','):
            key, _, value = one.partition('=')
            known[key.strip()] = _number(value, known)
    for kind, text in re.findall(
            rf'(?:^|[;{{(])\s*(?:const )?({"|".join(sizes)}) ([^;]*)', body, re.MULTILINE):
        # Initializers, whose commas separate no variables.
        initialized = re.search(r'=\s*\{+(.*)\}', text, re.DOTALL)
        while '(' in text:
            text = re.sub(r'\([^()]*\)', '', text)
        for one in re.sub(r'=\s*(\{+[^{}]*\}+|[^,]*)', '', text).split(','):
            if one.lstrip().startswith('*'):
                total += _SIZES['size_t']
                continue
            count = 1
            for length in re.findall(r'\[([^]]*)\]', one):
                count *= _number(length, known) if length else 1 + initialized[1].count(',')
            total += count * sizes[kind]
    return total


def _number(text, known):
    """Return the value of a constant expression of C."""
    return int(eval(text.replace('/', '//'), {'__builtins__': {}}, known))
