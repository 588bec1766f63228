# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Time and rounding error of one evaluation, of the package and of dense formulations.

The package eliminates multipliers subsystem by subsystem; the system-level and the augmented
formulation, oracles of the tests, solve dense equations of the whole mechanism by LAPACK. Without
scenes: on the 3-RRR and the carpet scraper, on ladders of N four-bar loops and on chains of N
links with one cut joint, errors against extended precision; the dense ones end where one
evaluation would take more than a second. On scenes, in the plane or in space, with their effects,
as they move after 0.3 s without torques: largest relative difference from the median of all.
"""

import argparse
from dataclasses import dataclass
import math
from pathlib import Path
import statistics
import sys
import time

from machine import ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.engine import native  # noqa: E402,I100
from closedloop_dynamics.integration.system import (  # noqa: E402
    build_system, can_be_unrolled)
from closedloop_dynamics.simulation.errors import SimulationError  # noqa: E402
from closedloop_dynamics.simulation.modeling import build_model  # noqa: E402
from closedloop_dynamics.simulation.scene import load_scene  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from families import chain, ladder  # noqa: E402
from formulation_errors import exact_dynamics  # noqa: E402
from test.reference.formulations import Dense, FORMULATIONS as DENSE  # noqa: E402

SIZES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
QUICK_SIZES = (1, 3, 10, 30, 100)
SCENES = ('three_rrr', 'carpet_scraper')
FAMILIES = {'ladder': ladder, 'chain': chain}
SMALLEST = {'ladder': 1, 'chain': 3}
# Time after which scenes are looked at [s].
AFTER = 0.3
# Accelerations and forces of a mechanism that rests [rad/s^2, m/s^2; N, N m].
NOTHING = 1e-9
# An evaluation expected to take longer is not made [s].
LONGEST = 1.0
# Timing: this many turns, each of evaluations that take this long together [s].
TURNS, FEW_TURNS, TURN_TIME = 7, 3, 2e-3
GROWTH = 3.0

# What is compared: the package's method by loops over bodies, dense ones, the method as it runs.
SUBSYSTEM, UNROLLED = 'subsystem', 'unrolled'
VARIANTS = (SUBSYSTEM, *DENSE, UNROLLED)


@dataclass(frozen=True)
class Case:
    """A mechanism in motion."""

    family: str  # ``'ladder'``, ``'chain'``, or a scene's name
    size: int  # Loops of a ladder, links of a chain, joints of a scene's mechanism
    mechanism: object  # Mechanism
    # Shape (nv,)
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class Row:
    """One formulation on one case."""

    # As in ``Case``.
    family: str
    size: int
    joints: int
    equations: int
    formulation: str
    time: float = math.nan  # Of one evaluation [s]; NaN where it was not made
    # Largest error relative to the largest value.
    acceleration_error: float = math.nan
    force_error: float = math.nan
    failure: str = ''  # Why there are no numbers; empty where there are


def growing_case(family, size):
    """Build one member of a family, moving and driven."""
    mechanism, position = FAMILIES[family](size)
    rng = np.random.default_rng(1)
    count = len(position)
    if family == 'ladder':
        # All cranks turn alike: the rates close the loops, too.
        rates = np.tile([1.0, -1.0], size + 1)[:count]
    else:
        rates = rng.uniform(-1.0, 1.0, count) / count
    return Case(family, size, mechanism, np.array(position), rates, rng.uniform(-1.0, 1.0, count))


def scene_case(name):
    """Return the mechanism of a scene as it moves after 0.3 s, without torques."""
    simulation = Simulation.from_scene(name)
    simulation.step(duration=0.3)
    nv = len(simulation.joint_names)
    return Case(name, nv, simulation.mechanism, simulation.position, simulation.velocity,
                np.random.default_rng(nv).uniform(-1.0, 1.0, nv))


def study_formulations(largest=max(SIZES), quick=False, progress=lambda done, total: None):
    """
    Measure time and rounding error of all formulations on growing mechanisms; return the rows.

    ``largest`` limits ladders and chains; ``quick`` takes fewer and smaller ones; ``progress`` is
    called with the numbers of parts done and of all parts.
    """
    cases = [lambda name=name: scene_case(name) for name in SCENES]
    cases += [
        lambda family=family, size=size: growing_case(family, size)
        for family in FAMILIES for size in (QUICK_SIZES if quick else SIZES)
        if SMALLEST[family] <= size <= largest]
    rows, expected = [], {}
    for done, build in enumerate(cases):
        progress(done, len(cases))
        rows += _measured(build(), expected)
    progress(len(cases), len(cases))
    return rows


def _measured(case, expected):
    """Return the rows of a case; ``expected`` holds (size, time) of the last one measured."""
    mechanism = case.mechanism
    sizes = (case.family, case.size, len(mechanism.joints), mechanism.number_of_equations)
    model = build_model(mechanism)
    exact = exact_dynamics(mechanism, case.q, case.qd, case.tau)
    systems, errors, times = {}, {}, {}
    for name in VARIANTS:
        if name == UNROLLED and not can_be_unrolled(model):
            continue
        size, last = expected.get((case.family, name), (case.size, 0.0))
        if last * (case.size / size) ** GROWTH > LONGEST:
            continue
        system = build_system(model, unrolled=name == UNROLLED)
        system.tau[:] = case.tau
        one = _Evaluation(system, name, np.concatenate((case.q, case.qd)))
        errors[name] = [_relative(*pair) for pair in zip(one.results(), exact)]
        systems[name] = one, _repeats(one)
    for turn in range(TURNS):
        for name, (one, repeats) in systems.items():
            if turn >= FEW_TURNS and times[name][0] > 0.1 * LONGEST:
                continue
            times.setdefault(name, []).append(one.time(repeats) / repeats)
    rows = []
    for name in VARIANTS:
        if name not in systems:
            rows.append(Row(*sizes, name))
            continue
        seconds = statistics.median(times[name])
        expected[case.family, name] = case.size, seconds
        rows.append(Row(*sizes, name, seconds, *errors[name]))
    return rows


def _repeats(one):
    """Return how many evaluations make up a turn."""
    return max(1, round(TURN_TIME / max(one.time(1), 1e-7)))


class _Evaluation:
    """Evaluations of a system in a state, shape (ns,), by one of ``VARIANTS``."""

    def __init__(self, system, name, state):
        nv = len(system.qdd)
        nq = nv if system.manifold is None else nv + len(system.manifold.balls)
        self._system, self._state = system, state
        self._at = state[:nq].copy(), state[nq:nq + nv].copy()
        self._dense = Dense(system, name) if name in DENSE else None

    def results(self):
        """Return accelerations and multipliers."""
        native.evaluate_state(self._system.native, self._state)
        return (self._system.qdd.copy(), self._system.lam.copy()) if self._dense is None else (
            self._dense(*self._at))

    def time(self, count):
        """Return the CPU time of some evaluations [s]."""
        begin = time.thread_time()
        if self._dense is None:
            native.evaluate_again(self._system.native, self._state, count)
        else:
            for _ in range(count):
                self._dense(*self._at)
        return time.thread_time() - begin


def _relative(value, reference):
    largest = np.abs(reference).max(initial=0.0)
    return float(np.abs(value - reference).max() / largest) if largest > NOTHING else math.nan


def study_scenes(scenes):
    """
    Measure time and differences of all formulations on scenes, with their effects, as they run.

    Each is evaluated as it moves after ``AFTER`` without torques, or as it starts where it does
    not get there. Errors of the rows returned are the largest differences from the median of all
    formulations, component by component; a formulation that fails is a row with its reason.
    """
    return [row for scene in scenes for row in _of_scene(scene)]


def _of_scene(scene):
    """Return the rows of a scene."""
    moved = Simulation(scene)
    sizes = (scene.name, len(moved.joint_names), len(scene.mechanism.joints),
             scene.mechanism.number_of_equations)
    try:
        moved.step(duration=AFTER)
    except SimulationError:
        moved.reset()
    motion = np.concatenate((moved.position, moved.velocity))
    # As where it is released in this motion: effects with a memory have none of it.
    moved.reset()
    state, system = moved.data.integrated.copy(), moved.data.system
    state[:len(motion)] = motion
    found, failures, timed = {}, {}, {}
    for name in (SUBSYSTEM, *DENSE):
        try:
            one = _Evaluation(system, name, state)
            found[name] = one.results()
        except np.linalg.LinAlgError as error:
            failures[name] = str(error)
            continue
        timed[name] = one, _repeats(one)
    times = {name: [] for name in timed}
    for _ in range(FEW_TURNS if any(count == 1 for _, count in timed.values()) else TURNS):
        for name, (one, count) in timed.items():
            times[name].append(one.time(count) / count)
    middle = [np.median(values, axis=0) for values in zip(*found.values())]
    return [Row(*sizes, name, failure=failures[name]) if name in failures else Row(
        *sizes, name, statistics.median(times[name]),
        *(_relative(value, own) for value, own in zip(found[name], middle)))
        for name in (SUBSYSTEM, *DENSE)]


def exponent(rows):
    """Return the exponent of growth over the largest tenfold of sizes; NaN for fewer than two."""
    rows = [row for row in rows if not math.isnan(row.time)]
    rows = [row for row in rows if row.size >= 0.1 * max(other.size for other in rows)]
    if len(rows) < 2:
        return math.nan
    return float(np.polyfit(np.log([row.size for row in rows]),
                            np.log([row.time for row in rows]), 1)[0])


def main(arguments=None):
    """Measure and print, and write where it is asked for."""
    import formulations_report
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scene', nargs='*', metavar='SCENE', help='scenes to measure on')
    parser.add_argument('--largest', type=int, default=max(SIZES), metavar='N',
                        help='no ladder or chain larger than this (default: %(default)s)')
    parser.add_argument('--quick', action='store_true', help='fewer and smaller ones')
    parser.add_argument('--output', type=Path, metavar='DIR',
                        help='write formulations.csv and formulations.png there')
    options = parser.parse_args(arguments)
    rows = study_scenes(map(load_scene, options.scene)) if options.scene else (
        study_formulations(options.largest, options.quick))
    print(formulations_report.table(rows))
    if not options.scene:
        print(f'\n{formulations_report.growth_text(rows)}')
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        formulations_report.write(rows, *(options.output / f'formulations.{kind}'
                                          for kind in ('csv', 'png')))
    return 0


if __name__ == '__main__':
    sys.exit(main())
