# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
One way to measure simulators beside each other: first agreement, then times, all in turn.

A simulator is a module ``peer_NAME`` with a class ``Engine`` of a machine, or a reason why not:

* ``name``, ``version``
* ``acceleration(q, qd, tau)``, and ``others``: {algorithm: the same by it}
* ``agreed``: what accelerations may differ by from ours, relative; where they are not exact also
  what they tend to, ``limit(q, qd, tau)``, called ``limit_name``, and its ``limit_agreed``
* ``timings(q, qd, tau)`` and ``derivative_timings``: {what: function of a number of evaluations}
* ``lines(case, plan)``: ways to compute a motion, ``peer_cases.Line``
"""

from dataclasses import dataclass
import importlib
import math
import os
import statistics
import time

# Before anything loads a library that has threads of its own.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'

from closedloop_dynamics.mechanism.errors import SimulationError  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
import numpy as np  # noqa: E402
from peer_cases import CannotExpress, Disagreement, NotAdapted  # noqa: E402

OURS = 'peer_ours'
# Timing of evaluations: calls at once take about this long [s].
PORTION = 4e-3
# Of motions: in each round a motion is run again until so long has passed [s].
ROUND = 2e-3


@dataclass(frozen=True)
class Plan:
    """
    Which settings of motions are tried, and how often they are timed.

    Attributes
    ----------
    tolerances, steps : sequence of float
        From coarse to fine [steps in s].
    springs : sequence of float
        Natural frequencies of soft loops times the step.
    accuracies : sequence of float
        What our default method is asked for; without any our other methods are run.
    targets : sequence of float or None
        Errors for each of which the coarsest setting is found by bisection; all are run without.
    rounds : int
    longest : float
        No setting is tried that is finer than one whose motion takes so long [s].
    enough : float
        A motion that has taken so long in all is not run again [s].

    """

    tolerances: tuple
    steps: tuple
    springs: tuple
    rounds: int
    longest: float
    enough: float
    accuracies: tuple = ()
    targets: tuple = None


def engines(machine, chosen):
    """Return the simulators that know a machine, and {simulator: why not} of the others."""
    found, why = [], {}
    for name in chosen:
        try:
            found.append(importlib.import_module(name).Engine(machine))
        except ImportError as error:
            why[name] = f'not installed: {error}; pip install -e .[bench] installs all'
        except (CannotExpress, NotAdapted) as error:
            why[name] = f'{error.text}: {error}'
    return found, why


def agreement(machine, built, states):
    """
    Compare accelerations with ours.

    Parameters
    ----------
    machine : peer_cases.Machine
        That all were told.
    built : list of engines
        Of simulators.
    states : list of (q, qd, tau)
        Where accelerations are compared.

    Returns
    -------
    list of dict
        Largest relative error of each engine and of its other algorithms; of an engine that is
        not exact also that of its limit.

    Raises
    ------
    Disagreement
        Where an engine was told another machine.

    """
    system, truth, rows = Simulation(machine.scene).data.system, [], []
    for q, qd, tau in states:
        system.tau[:] = tau
        system.native.evaluate(q, qd)
        truth.append(system.qdd.copy())

    def error(function):
        # What is not a number stays so.
        return float(np.max([np.abs(function(*state) - true).max() / np.abs(true).max()
                             for state, true in zip(states, truth)]))

    for engine in built:
        row = {'engine': engine.name, 'version': engine.version,
               'error': error(engine.acceleration)}
        errors = [(row['error'], engine.agreed)]
        if engine.limit is not None:
            row.update(limit=error(engine.limit), limit_name=engine.limit_name)
            errors.append((row['limit'], engine.limit_agreed))
        for apart, most in errors:
            # Not a number is a disagreement, too.
            if not apart <= most:
                raise Disagreement(
                    f'{machine.name} in {engine.name}: accelerations differ from ours by '
                    f'{apart:.2g}, relative; at most {most:g} was expected')
        rows += [row, *({'engine': f'{engine.name}, {name},', 'version': engine.version,
                         'error': error(function)} for name, function in engine.others.items())]
    return rows


def evaluation_times(tasks, rounds, timings='timings'):
    """
    Time evaluations and steps, or derivatives, all in turn.

    Parameters
    ----------
    tasks : sequence of (str, engine, (q, qd, tau))
        Of which tree, what is to be timed, and where.
    rounds : int
        How often.
    timings : str
        Method of the engines, ``'timings'`` or ``'derivative_timings'``.

    Returns
    -------
    list of dict
        Best and median time of one evaluation or step [s].

    """
    functions = [(tree, engine.name, what, function) for tree, engine, state in tasks
                 for what, function in getattr(engine, timings)(*state).items()]
    counts, times = [], [[] for _ in functions]
    for *_, function in functions:
        _timed(function, 10)
        counts.append(max(10, round(PORTION / (_timed(function, 100) / 100))))
    for _ in range(rounds):
        for (*_, function), count, measured in zip(functions, counts, times):
            measured.append(_timed(function, count) / count)
    return [{'tree': tree, 'engine': engine, 'what': what, 'best': min(measured),
             'median': statistics.median(measured)}
            for (tree, engine, what, _), measured in zip(functions, times)]


def _timed(function, *arguments):
    """Return the CPU time of a call [s], all threads counted."""
    getattr(function, 'prepare', lambda: None)()
    begin = time.process_time()
    function(*arguments)
    return time.process_time() - begin


def motions(tasks, plan, progress=lambda: None):
    """
    Compute motions at chosen settings, then time all of them in turn.

    Parameters
    ----------
    tasks : sequence of (str, peer_cases.Case, engine)
        Of which tree, the motion, and what is to compute it.
    plan : Plan
        Which settings, and how often.
    progress : callable
        Called after each round.

    Returns
    -------
    list of dict
        One row a run: its case, error at the end and closure there [rad, m], best and median CPU
        time per simulated second, evaluations per second and what was asked for where known, a
        note where it failed.

    """
    runs, rows = [], []
    for tree, case, engine in tasks:
        for line in engine.lines(case, plan):
            found = {}

            def measure(number, line=line, case=case, found=found):
                found[number] = _first(line, case, number, plan.longest)
                return found[number][0]['error'], found[number][0]['costs'][-1]

            # What asks for an accuracy is run for each.
            targets = None if line.targets else plan.targets
            explored(measure, len(line.settings), targets, plan.longest)
            for _, (row, run) in sorted(found.items()):
                rows.append({'case': case, 'tree': tree, **row})
                runs.append(run)
    for _ in range(plan.rounds):
        for row, run in zip(rows, runs):
            if not row['note'] and sum(row['costs']) < plan.enough:
                row['costs'].append(_cost(run))
        progress()
    for row in rows:
        # The first run warms up, but where it is a long one.
        costs = row.pop('costs')
        costs = [cost / row['case'].duration for cost in costs[1:] or costs]
        row.update(best=min(costs), median=statistics.median(costs))
    return rows


def _first(line, case, number, longest):
    """Return the row of a setting, with its cost alone, and what runs it."""
    row = {'engine': line.engine, 'line': line.name, 'setting': line.settings[number],
           'error': math.nan, 'closure': math.nan, 'evaluations': math.nan, 'note': '',
           'target': line.targets[number] if line.targets else math.nan}
    run = line.run(number)
    try:
        end, cost = _end(run)
        if cost > longest:
            # It may have compiled.
            end, cost = _end(run)
        # Of a method that is its own judge the largest error on the way, which it bounds.
        row['error'], row['evaluations'] = getattr(run, 'judged', lambda: (
            case.error(end), math.nan))()
        row['closure'] = case.closure(end)
    except SimulationError as error:
        # A setting so coarse that it is refused has no error to compare.
        row['note'], cost = str(error), math.nan
    row['costs'] = [cost]
    return row, run


def _end(run):
    """Return the end of a motion, and its CPU time [s]."""
    getattr(run, 'prepare', lambda: None)()
    begin = time.process_time()
    end = run()
    return end, time.process_time() - begin


def _cost(run):
    """Return the least CPU time of as many runs as take ``ROUND`` together."""
    costs = []
    while not costs or sum(costs) < ROUND:
        costs.append(_end(run)[1])
    return min(costs)


def explored(measure, count, targets, longest):
    """
    Measure settings, coarse to fine: those which find the coarsest for each target, or all.

    Parameters
    ----------
    measure : callable
        Takes the number of a setting; returns its error and its CPU time [s].
    count : int
        How many settings there are.
    targets : sequence of float or None
        Errors; without them all settings are measured.
    longest : float
        Nothing finer is measured than what takes longer [s].

    """
    errors, last = {}, count

    def keeps(number, target):
        nonlocal last
        if number not in errors:
            errors[number], cost = measure(number)
            if cost > longest:
                # What is finer takes longer.
                last = min(last, number + 1)
        return errors[number] <= target

    if targets is None:
        for number in range(count):
            if number < last:
                keeps(number, 0.0)
        return
    least = 0
    for target in targets:
        low, high = least - 1, count
        while high - low > 1:
            middle = (low + high) // 2
            # Where it is too fine to be tried, a coarser one may do.
            if middle >= last or keeps(middle, target):
                high = middle
            else:
                low = middle
        least = max(low, 0)
