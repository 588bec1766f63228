# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
How many floating-point operations an evaluation takes, and how near to its limit one core comes.

The kernels run interpreted on numbers that remember how they came about. Counted are the
operations that the general kernels execute, and those that are needed for this one mechanism:
constants folded (zeros above all), nothing computed twice, nothing that the accelerations and
multipliers do not depend on. The longest chain of dependent operations among these bounds the
time from below, whatever a processor can do side by side. What this core needs for one operation
is measured.

"""

import argparse
from collections import Counter
import json
import math
import os
from pathlib import Path
import subprocess
import sys
import time

from evaluations import evaluate_again
from machine import description, ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.core import forward_dynamics as dynamics  # noqa: E402,I100
from closedloop_dynamics.core.codegen import interpreted  # noqa: E402
from closedloop_dynamics.core.codegen.expression_graph import COSINE, SINE  # noqa: E402
from closedloop_dynamics.core.compiled import compiled  # noqa: E402
from closedloop_dynamics.core.workspace import allocate  # noqa: E402
from closedloop_dynamics.simulation.modeling import build_model  # noqa: E402
from closedloop_dynamics.simulation.scene import (  # noqa: E402
    config_directory, load_scene, scene_names)
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.studies.families import ladder  # noqa: E402
from closedloop_dynamics.studies.formulations import growing_case  # noqa: E402
from closedloop_dynamics.visual.tables import markdown_table, seconds, text_table  # noqa: E402

KINDS = ('add', 'multiply', 'divide', 'sine and cosine')
LADDER = 10
# Additions and multiplications that sine and cosine of one angle take as polynomials.
SINE_AND_COSINE = 58


class Number(float):
    """A float that knows what it was computed from."""

    def __new__(cls, value, tape, operation=None, inputs=()):
        """Make a number; without an operation it is given: a constant or a variable."""
        self = float.__new__(cls, value)
        self.tape, self.operation, self.inputs = tape, operation, inputs
        self.constant = False
        return self

    def __add__(self, other):
        """Add, and remember it."""
        return self.tape.apply('add', float.__add__, self, other)

    def __sub__(self, other):
        """Subtract, and remember it."""
        return self.tape.apply('subtract', float.__sub__, self, other)

    def __rsub__(self, other):
        """Subtract from a plain number."""
        return self.tape.apply('subtract', float.__sub__, other, self)

    def __mul__(self, other):
        """Multiply, and remember it."""
        return self.tape.apply('multiply', float.__mul__, self, other)

    def __truediv__(self, other):
        """Divide, and remember it."""
        return self.tape.apply('divide', float.__truediv__, self, other)

    def __rtruediv__(self, other):
        """Divide a plain number."""
        return self.tape.apply('divide', float.__truediv__, other, self)

    def __neg__(self):
        """Change the sign, which is free."""
        return self.tape.apply('negate', lambda value, _: -value, self, 0.0)

    __radd__, __rmul__ = __add__, __mul__


class Tape:
    """All numbers of one evaluation; equal operations on the same numbers are one."""

    def __init__(self):
        """Begin with nothing executed."""
        self.executed, self._known = Counter(), {}

    def constant(self, value):
        """Return the one number of a constant."""
        key = ('constant', repr(float(value)))
        if key not in self._known:
            self._known[key] = Number(value, self)
            self._known[key].constant = True
        return self._known[key]

    def variable(self, value):
        """Return a number that only the evaluation will know."""
        return Number(value, self)

    def apply(self, operation, function, a, b):
        """Execute an operation, unless its result is known."""
        self.executed['add' if operation == 'subtract' else operation] += 1
        a = a if isinstance(a, Number) else self.constant(a)
        b = b if isinstance(b, Number) else self.constant(b)
        value = function(float(a), float(b))
        known = self._folded(operation, a, b)
        if known is not None:
            return known
        if a.constant and b.constant:
            return self.constant(value)
        ends = (id(a), id(b))
        key = (operation, *(sorted(ends) if operation in ('add', 'multiply') else ends))
        if key not in self._known:
            self._known[key] = Number(value, self, operation, (a, b))
        return self._known[key]

    def _folded(self, operation, a, b):
        """Return the result of an operation with nought or one, None if it is another."""
        if operation == 'add' and (a == 0.0 and a.constant or b == 0.0 and b.constant):
            return b if a == 0.0 and a.constant else a
        if operation == 'subtract' and b.constant and b == 0.0:
            return a
        if operation == 'subtract' and a.constant and a == 0.0:
            return self.apply('negate', lambda value, _: -value, b, 0.0)
        if operation == 'multiply':
            for one, other in ((a, b), (b, a)):
                if one.constant and one == 0.0:
                    return self.constant(0.0)
                if one.constant and one == 1.0:
                    return other
        if operation == 'divide' and (a.constant and a == 0.0 or b.constant and b == 1.0):
            return a
        return None

    def function(self, name):
        """Return a function of one number that is remembered: sine or cosine."""
        def call(angle):
            angle = angle if isinstance(angle, Number) else self.constant(angle)
            self.executed[name] += 1
            value = getattr(math, name)(float(angle))
            if angle.constant:
                return self.constant(value)
            key = (name, id(angle))
            if key not in self._known:
                self._known[key] = Number(value, self, name, (angle,))
            return self._known[key]
        return call

    def objects(self, values):
        """Return an array of constants."""
        result = np.empty(values.shape, dtype=object)
        for place, value in np.ndenumerate(values):
            result[place] = self.constant(value)
        return result


def kinds(counter):
    """Return counts by kind; a sine and cosine of one angle are one."""
    return {'add': counter['add'] + counter['subtract'], 'multiply': counter['multiply'],
            'divide': counter['divide'],
            'sine and cosine': max(counter['sin'], counter['cos'])}


def count(model, q, qd, tau):
    """
    Count the operations of one evaluation.

    Parameters
    ----------
    model : core.types.Model
        Of a mechanism, with gravity.
    q, qd, tau : ndarray, shape (nv,)
        A state that is not singular.

    Returns
    -------
    dict
        ``executed`` by the general kernels; ``needed`` and the longest chain of these, as
        lists of operations.

    """
    tape = Tape()
    work = allocate(model)
    health = work.health
    floats = {name: tape.objects(part) for name, part in model._asdict().items()
              if isinstance(part, np.ndarray) and part.dtype.kind == 'f'}
    work = type(work)(*(tape.objects(part) if isinstance(part, np.ndarray)
                        and part.dtype.kind == 'f' else part for part in work))
    work = work._replace(health=health)
    variables = []
    for values in (q, qd, tau):
        part = np.empty(len(values), dtype=object)
        part[:] = [tape.variable(value) for value in values]
        variables.append(part)
    qdd, lam = (np.zeros(n, dtype=object) for n in (len(q), len(model.column) - 1))
    plain = dict(interpreted.OPERATIONS)
    interpreted.OPERATIONS.update({COSINE: tape.function('cos'), SINE: tape.function('sin')})
    try:
        good = dynamics.forward_dynamics(model._replace(**floats), work, *variables, qdd, lam)
    finally:
        interpreted.OPERATIONS.update(plain)
    if not good:
        raise ValueError('this state is singular: count at another one')
    needed, chain = _needed([*qdd, *lam])
    return {'executed': kinds(tape.executed), 'needed': kinds(needed), 'chain': kinds(chain)}


# Rough latencies in cycles, to find the longest chain.
LATENCY = {'add': 3, 'subtract': 3, 'multiply': 3, 'divide': 13, 'sin': 45, 'cos': 45,
           'negate': 0}


def _needed(results):
    """Return operations that results depend on, and those of the longest chain to any."""
    depth, counter, waiting = {}, Counter(), list(results)
    while waiting:
        number = waiting[-1]
        if id(number) in depth or not isinstance(number, Number):
            waiting.pop()
            continue
        missing = [one for one in number.inputs if id(one) not in depth]
        if missing:
            waiting += missing
            continue
        waiting.pop()
        before = max(number.inputs, key=lambda one: depth[id(one)][0], default=None)
        start = 0 if before is None else depth[id(before)][0]
        depth[id(number)] = (start + LATENCY.get(number.operation, 0), number, before)
        if number.operation:
            counter[number.operation] += 1
    chain, last = Counter(), max(depth.values(), key=lambda entry: entry[0])
    while last[2] is not None:
        chain[last[1].operation] += 1
        last = depth[id(last[2])]
    return counter, chain


def cases():
    """Return {name: (model, q, qd, tau)} of the shipped mechanisms and a ladder."""
    result = {}
    for scene in map(load_scene, scene_names()):
        name = scene.mechanism.name
        shipped = config_directory() / 'mechanisms' / f'{name}.yaml'
        if name in result or not scene.mechanism.planar or not shipped.exists():
            continue
        one = Simulation(scene)
        rng = np.random.default_rng(5)
        one.set_state(one.position, rng.uniform(-1.0, 1.0, len(one.joint_names)))
        model = build_model(scene.mechanism, (0.0, -9.81))
        result[name] = (model, one.position, one.velocity,
                        np.array([5.0 * joint.actuated for joint in scene.mechanism.joints]))
    mechanism, _ = ladder(LADDER)
    case = growing_case('ladder', LADDER)
    result[mechanism.name] = (build_model(mechanism, (0.0, -9.81)), case.q, case.qd, case.tau)
    return result


@compiled
def dependent(kind, x, count):
    """Make a chain of dependent operations of one kind."""
    if kind == 0:
        for _ in range(count):
            x = x + 1e-9
    elif kind == 1:
        for _ in range(count):
            x = x * 0.999999999
    elif kind == 2:
        for _ in range(count):
            x = 1.0 / (x + 1e-9)
    else:
        for _ in range(count):
            x = math.cos(x) + math.sin(x)
    return x


@compiled
def independent(kind, x, count):
    """Make operations of one kind that need not wait for one another; 16 or one in a turn."""
    total = x
    if kind == 0:
        a, b, c, d, e, f, g, h = x, x + 1.0, x + 2.0, x + 3.0, x + 4.0, x + 5.0, x + 6.0, x + 7.0
        for _ in range(count):
            a, b, c, d = a * 0.999 + x, b * 0.999 + x, c * 0.999 + x, d * 0.999 + x
            e, f, g, h = e * 0.999 + x, f * 0.999 + x, g * 0.999 + x, h * 0.999 + x
        total = a + b + c + d + e + f + g + h
    elif kind == 1:
        for k in range(count):
            total += 1.0 / (x + k)
    else:
        for k in range(count):
            angle = x + 1e-3 * k
            total += math.cos(angle) - math.sin(angle)
    return total


def core_speed():
    """Return what single operations take on this core [s]: in a chain, and side by side."""
    def best(function, *arguments, number=20000):
        function(*arguments, 10)
        times = []
        for _ in range(15):
            begin = time.thread_time()
            function(*arguments, number)
            times.append((time.thread_time() - begin) / number)
        return min(times)

    add, pair = best(dependent, 0, 1.0), best(independent, 0, 0.5) / 16.0
    chain = {'add': add, 'multiply': best(dependent, 1, 1.0),
             'divide': best(dependent, 2, 1.0) - add,
             'sine and cosine': best(dependent, 3, 1.0) - add}
    side_by_side = {'add': pair, 'multiply': pair, 'divide': best(independent, 1, 0.5),
                    'sine and cosine': best(independent, 2, 0.5)}
    return {'chain': chain, 'side by side': side_by_side}


def measured_times():
    """Return {mechanism: time of one evaluation inside compiled code} [s]."""
    result = {}
    for scene in map(load_scene, ('three_rrr', 'carpet_scraper', 'four_bar')):
        one = Simulation(scene)
        result[scene.mechanism.name] = _evaluation(one.system, one.position, one.velocity)
    return result


def _evaluation(system, q, qd):
    evaluate_again(system, q, qd, 10)
    times = []
    for _ in range(25):
        begin = time.thread_time()
        evaluate_again(system, q, qd, 2000)
        times.append((time.thread_time() - begin) / 2000)
    return min(times)


def measure(quick=False):
    """
    Count, in an interpreter of its own without compiling, and measure.

    Parameters
    ----------
    quick : bool
        Count alone.

    Returns
    -------
    dict
        As written to the JSON file.

    """
    run = subprocess.run([sys.executable, __file__, '--count'], check=True, text=True,
                         stdout=subprocess.PIPE, env={**os.environ, 'NUMBA_DISABLE_JIT': '1'})
    result = {'machine': description(), 'quick': quick,
              'counts': json.loads(run.stdout.splitlines()[-1])}
    if not quick:
        result.update(core=core_speed(), measured=measured_times())
    return result


def bounds(result, name):
    """
    Return lower bounds on the time of an evaluation [s].

    Parameters
    ----------
    result : dict
        Of ``measure``.
    name : str
        Of the mechanism.

    Returns
    -------
    chain, work : float
        Of the longest chain of dependent operations; of all operations side by side.

    """
    core, counts = result['core'], result['counts'][name]
    side_by_side = {**core['side by side'],
                    'sine and cosine': SINE_AND_COSINE * core['side by side']['multiply']}
    return (sum(core['chain'][kind] * counts['chain'][kind] for kind in KINDS),
            sum(side_by_side[kind] * counts['needed'][kind] for kind in KINDS))


def table(result, make=markdown_table):
    """Return the counts as a table."""
    header = ('mechanism', 'executed by the general kernels', 'needed for this mechanism',
              'longest chain', 'measured', 'chain alone', 'all, side by side')
    rows = []
    for name, counts in result['counts'].items():
        cells = [_counts(counts[part]) for part in ('executed', 'needed', 'chain')]
        times = ['-'] * 3
        if name in result.get('measured', {}):
            times = [seconds(value) for value in (result['measured'][name],
                                                  *bounds(result, name))]
        rows.append((name, *cells, *times))
    return make(header, rows)


def _counts(counts):
    return (f'{sum(counts.values())}: {counts["add"]} +, {counts["multiply"]} *, '
            f'{counts["divide"]} /, {counts["sine and cosine"]} sincos')


def core_text(result):
    """Return what single operations take."""
    names = {'add': 'an addition', 'multiply': 'a multiplication', 'divide': 'a division',
             'sine and cosine': "sine and cosine (the mathematical library's)"}
    return 'On this core, in a chain and side by side: ' + ', '.join(
        f'{name} {1e9 * result["core"]["chain"][kind]:.2f} and '
        f'{1e9 * result["core"]["side by side"][kind]:.2f} ns'
        for kind, name in names.items()) + '.'


def main(arguments=None):
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='count, without measuring')
    parser.add_argument('--count', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--output', type=Path, default=ROOT / 'benchmark_output',
                        metavar='DIR', help='where results go (default: %(default)s)')
    options = parser.parse_args(arguments)
    if options.count:
        print(json.dumps({name: count(*case) for name, case in cases().items()}))
        return 0
    result = measure(options.quick)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / 'operation_count.json').write_text(json.dumps(result, indent=1))
    print(result['machine'], table(result, text_table), sep='\n\n')
    if not options.quick:
        print(f'\n{core_text(result)}')
    print(f'\nwritten: {options.output}/operation_count.json')
    return 0


if __name__ == '__main__':
    sys.exit(main())
