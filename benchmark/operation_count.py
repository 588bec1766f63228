# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How many floating-point operations an evaluation takes, and how near to its limit one core comes.

Counted are the operations of the routine that is generated for a mechanism: nothing is computed
twice, and nothing that the results do not depend on. A multiplication whose product only one
addition takes is one operation with it, as in the machine code; among flops it counts as two, as
it does in those of code that CasADi generates for the same mechanism, where that can express it:
a KKT system (peer_generated.py) and C-ABA (peer_clusters.py). The longest chain of dependent
operations bounds the time from below, as do all operations side by side where none are in vectors;
both by the measured times of single operations in generated code.
"""

from collections import Counter
import ctypes
import sys
import time

from evaluations import evaluate_again
from machine import description, least, parser_of, write_result
import numpy as np
import peer_cases

from closedloop_dynamics.codegen.expression_graph import (  # noqa: I100
    ADD, COSINE, DIVIDE, ExpressionGraph, LOAD, MULTIPLY, Q, QD, Routine, SINE, SUBTRACT)
from closedloop_dynamics.codegen.function_table import ACCELERATION, MOTION, OUTWARD
from closedloop_dynamics.codegen.machine_code import machine_code, PACKED, SCALAR
from closedloop_dynamics.codegen.routines import MechanismTrace
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.scene.loading import load_scene, scene_names
from closedloop_dynamics.scene.tree_choice import MOST_JOINTS
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import markdown_table, seconds, text_table
from families import ladder

FUSED = 'multiply and add'
# Signs of the kinds in tables.
KINDS = {'add': '+', 'multiply': '*', FUSED: 'fma', 'divide': '/', 'sine and cosine': 'sincos'}
KIND_OF = {ADD: 'add', SUBTRACT: 'add', MULTIPLY: 'multiply', DIVIDE: 'divide',
           SINE: 'sine and cosine', COSINE: 'sine and cosine'}
# Rough latencies in cycles, to find the longest chain.
LATENCY = {'add': 3, 'multiply': 3, FUSED: 4, 'divide': 13, 'sine and cosine': 38}
# The longest chain in sine and cosine of one angle (codegen/sincos.py).
SINE_AND_COSINE = {'add': 4, 'multiply': 2, FUSED: 5}
BOUNDS = """\
Two bounds of the time: the longest chain of operations that wait for one another, and all
operations side by side, at this core's measured rates. The second is one of code without vectors:
with equal parts side by side in vectors an evaluation takes less. It leaves out sines and cosines,
which always are.

"""
# Solvers that CasADi generates, and what their flops are called.
RIVALS = {'KKT': "a KKT system's", 'C-ABA': "C-ABA's"}
LADDER = 10
MEASURED = ('three_rrr', 'carpet_scraper', 'four_bar', 'stewart_platform', 'delta_robot',
            'bricard')
# Operations in a chain and such chains side by side, to measure single operations; in vectors. All
# are fewer than those of a large routine, which are written in another order (codegen.scheduling).
LENGTH, CHAINS = 120, 8
LENGTH_OF_VECTORS, CHAINS_OF_VECTORS = 100, 64
ROUNDS = 25


def tally(routine):
    """
    Count the operations of a routine, and those of its longest chain.

    Parameters
    ----------
    routine : codegen.expression_graph.Routine
        Unrolled for a mechanism.

    Returns
    -------
    all, chain : dict of str to int
        By kind. Sine and cosine of one angle are one; loading, storing, comparing and changing
        signs do not count.

    """
    graph, needed = routine.graph.operations, sorted(routine.needed())
    operands = {place: [] if graph[place][0] == LOAD else
                [one for one in graph[place][1:] if isinstance(one, int)] for place in needed}
    uses = Counter(one for place in needed for one in operands[place])
    uses.update(value.place for _, _, value in routine.outputs if hasattr(value, 'place'))
    kind = {place: KIND_OF.get(graph[place][0]) for place in needed}
    for place in needed:
        product = next((one for one in operands[place] if kind[one] == 'multiply'
                        and uses[one] == 1), None)
        if kind[place] == 'add' and product is not None:
            kind[place], kind[product] = FUSED, None
    angles = {graph[place][1] for place in needed if kind[place] == 'sine and cosine'}
    counts = Counter(kind.values())
    counts['sine and cosine'] = len(angles)
    # Earlier operations come first: of each the cycles until it is done, and what it waits for.
    cycles, before = {}, {}
    for place in needed:
        before[place] = max(operands[place], key=cycles.get, default=None)
        cycles[place] = cycles.get(before[place], 0) + LATENCY.get(kind[place], 0)
    chain, place = Counter(), max(cycles, key=cycles.get, default=None)
    while place is not None:
        chain[kind[place]] += 1
        place = before[place]
    return tuple({name: count[name] for name in KINDS} for count in (counts, chain))


def count(model):
    """
    Count the operations of an evaluation as steps ask for it: of accelerations alone.

    Parameters
    ----------
    model : engine.types.Model
        Of a mechanism.

    Returns
    -------
    dict
        ``all`` operations and those of the longest ``chain``, by kind, of the one routine where
        no effect is listed; ``in parts``: the number of operations of the two routines that
        there are where effects act between them.

    """
    everything, chain = tally(MechanismTrace(model).routine(MOTION))
    parts = [tally(MechanismTrace(model).routine(which))[0] for which in (OUTWARD, ACCELERATION)]
    return {'all': everything, 'chain': chain,
            'in parts': sum(sum(part.values()) for part in parts)}


def models():
    """
    Return {name: model} of the mechanisms of the shipped scenes and a ladder.

    As they are simulated: without closure equations that repeat others.
    """
    found, rungs = {}, ladder(LADDER)[0]
    for scene in map(load_scene, scene_names()):
        name, joints = scene.mechanism.name, scene.mechanism.joints
        if name not in found and len(joints) <= MOST_JOINTS:
            found[name] = Simulation(scene).data.system.model
    return {**found, rungs.name: build_model(rungs)}


def rivals():
    """Return {mechanism: {solver: flops}} of those that CasADi can express, if it is installed."""
    found = {}
    try:
        from peer_clusters import Clusters
        from peer_generated import operations, System
    except ImportError as error:
        print(f'no code by CasADi: {error}. pip install -e .[bench] installs it.')
        return found
    for name in scene_names():
        machine = peer_cases.Machine(name, peer_cases.load_scene(name))
        mechanism = machine.mechanism
        if mechanism.name not in found and len(mechanism.joints) <= MOST_JOINTS:
            try:
                found[mechanism.name] = {
                    name: sum(operations(machine, system).values())
                    for name, system in zip(RIVALS, (System, Clusters))}
            except (peer_cases.CannotExpress, peer_cases.NotAdapted):
                # A mechanism with parts that its systems do not have.
                continue
    return found


# One more operation on x, by numbers that keep it between bounds.
NEXT = {'add': lambda x, a, b: x + a, 'multiply': lambda x, a, b: x * a,
        FUSED: lambda x, a, b: x * a + b, 'divide': lambda x, a, b: a / x}


def repeated(kind, chains, length, form=SCALAR):
    """Return a function that calls generated code: operations of a kind, in chains."""
    def routine():
        graph = ExpressionGraph()
        a, b = (graph.put(LOAD, QD, place) for place in range(2))
        values = [graph.put(LOAD, Q, place) for place in range(chains)]
        for _ in range(length):
            values = [NEXT[kind](x, a, b) for x in values]
        return [Routine('repeated', graph, [(0, *pair) for pair in enumerate(values)])]

    address = machine_code(('repeated', kind, chains, length), routine, form)('repeated')
    pointer = ctypes.c_void_p
    function = ctypes.CFUNCTYPE(ctypes.c_int64, pointer, pointer, pointer)(address)
    out, x, constants = np.empty(chains), np.full(chains, 0.7), np.array([0.999, 1e-3])
    table = np.array([out.ctypes.data])
    arguments = [one.ctypes.data_as(pointer) for one in (table, x, constants)]

    def call():
        function(*arguments)
    # Written to as long as there are calls.
    call.out = out
    return call


def core_speed():
    """Return what operations take on this core [s]: in a chain, side by side, in vectors."""
    def one(kind, chains, length, form=SCALAR):
        times = [least_of(repeated(kind, chains, number, form), 500) for number in (length, 0)]
        return (times[0] - times[1]) / (chains * length)

    return {**{name: {kind: one(kind, chains, LENGTH) for kind in NEXT}
               for name, chains in (('chain', 1), ('side by side', CHAINS))},
            'in vectors': {FUSED: one(FUSED, CHAINS_OF_VECTORS, LENGTH_OF_VECTORS, PACKED)}}


def least_of(function, number):
    """Return the least CPU time of a call [s]."""
    def calls():
        for _ in range(number):
            function()

    return least({'calls': calls}, ROUNDS, time.thread_time)['calls'] / number


def measured_times():
    """Return {mechanism: time of one evaluation inside compiled code} [s]."""
    result = {}
    for name in MEASURED:
        one = Simulation(peer_cases.load_scene(name))
        result[one.mechanism.name] = least_of(lambda: evaluate_again(
            one.data.system, one.position, one.velocity, 2000), 1) / 2000
    return result


def measure(quick=False):
    """
    Count and measure.

    Parameters
    ----------
    quick : bool
        Count alone.

    Returns
    -------
    dict
        As written to the JSON file.

    """
    result = {'machine': description(), 'quick': quick,
              'counts': {name: count(model) for name, model in models().items()}}
    if not quick:
        result.update(core=core_speed(), measured=measured_times(), rivals=rivals())
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
        Of the longest chain of dependent operations; of all operations side by side, but for
        sines and cosines, which are computed in vectors.

    """
    core, counts = result['core'], result['counts'][name]
    chain = {**core['chain'], 'sine and cosine': sum(
        core['chain'][kind] * number for kind, number in SINE_AND_COSINE.items())}
    return (sum(chain[kind] * counts['chain'][kind] for kind in KINDS),
            sum(core['side by side'][kind] * counts['all'][kind] for kind in NEXT))


def flops(counts):
    """Return the number of additions, multiplications and divisions, an fma as two."""
    return sum(counts[kind] for kind in NEXT) + counts[FUSED]


def table(result, make=markdown_table):
    """Return the counts as a table, with times and shares of the peaks where there are any."""
    header = ('mechanism', 'operations', 'longest chain', 'in two routines, for effects', 'flops',
              *RIVALS.values())
    timed = ('measured', 'chain alone', 'all, side by side', 'of the scalar peak',
             'of the vector peak') if 'core' in result else ()
    rows = []
    for name, counts in result['counts'].items():
        times = ['-'] * len(timed)
        if name in result.get('measured', {}):
            taken = result['measured'][name]
            # Of both peaks: an fma is two flops.
            shares = (0.5 * flops(counts['all']) * result['core'][how][FUSED] / taken
                      for how in ('side by side', 'in vectors'))
            times = [*map(seconds, (taken, *bounds(result, name))),
                     *(f'{100.0 * share:.0f} %' for share in shares)]
        rows.append((name, _counts(counts['all']), _counts(counts['chain']),
                     str(counts['in parts']), str(flops(counts['all'])),
                     *(str(result.get('rivals', {}).get(name, {}).get(rival, '-'))
                       for rival in RIVALS), *times))
    return make(header + timed, rows)


def _counts(counts):
    return f'{sum(counts.values())}: ' + ', '.join(
        f'{counts[kind]} {sign}' for kind, sign in KINDS.items())


def core_text(result):
    """Return what the bounds are, and what single operations take."""
    names = {'add': 'an addition', 'multiply': 'a multiplication', FUSED: 'both fused',
             'divide': 'a division'}
    return BOUNDS + 'On this core, in a chain and side by side: ' + ', '.join(
        f'{name} {1e9 * result["core"]["chain"][kind]:.2f} and '
        f'{1e9 * result["core"]["side by side"][kind]:.2f} ns'
        for kind, name in names.items()) + '; both fused, in vectors, ' + (
            f'{1e9 * result["core"]["in vectors"][FUSED]:.3f} ns for each.')


def main(arguments=None):
    """Run the benchmark."""
    options = parser_of(__doc__, 'count, without measuring', output=True).parse_args(arguments)
    result = measure(options.quick)
    write_result(options, 'operation_count', result, table(result, text_table),
                 *([] if options.quick else [core_text(result)]))
    return 0


if __name__ == '__main__':
    sys.exit(main())
