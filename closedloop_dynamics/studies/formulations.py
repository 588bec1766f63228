# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Comparison of the formulations: time and rounding error as mechanisms grow."""

from dataclasses import dataclass, replace
import math
import statistics
import time

import numpy as np

from .families import chain, ladder
from .formulation_errors import exact_dynamics
from ..core.formulations import SUBSYSTEM
from ..engine import native
from ..integration.system import build_system, MOST_UNROLLED_BODIES
from ..simulation.data import FORMULATIONS
from ..simulation.errors import SimulationError
from ..simulation.modeling import build_model
from ..simulation.simulation import Simulation

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

# What is compared: the formulations, all by loops, and the subsystem-level one as it runs.
UNROLLED = 'unrolled'
VARIANTS = {**{name: (formulation, False) for name, formulation in FORMULATIONS.items()},
            UNROLLED: (SUBSYSTEM, True)}


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
    for name, (formulation, unrolled) in VARIANTS.items():
        if unrolled and len(mechanism.joints) > MOST_UNROLLED_BODIES:
            continue
        size, last = expected.get((case.family, name), (case.size, 0.0))
        if last * (case.size / size) ** GROWTH > LONGEST:
            continue
        system = build_system(model, formulation, unrolled=unrolled)
        system.tau[:] = case.tau
        native.evaluate(system.native, case.q, case.qd)
        errors[name] = [_relative(value, reference) for value, reference in zip(
            (system.qdd, system.lam), exact)]
        systems[name] = system, _repeats(system, case)
    for turn in range(TURNS):
        for name, (system, repeats) in systems.items():
            if turn >= FEW_TURNS and times[name][0] > 0.1 * LONGEST:
                continue
            times.setdefault(name, []).append(_time(system, case, repeats) / repeats)
    rows = []
    for name in VARIANTS:
        if name not in systems:
            rows.append(Row(*sizes, name))
            continue
        seconds = statistics.median(times[name])
        expected[case.family, name] = case.size, seconds
        rows.append(Row(*sizes, name, seconds, *errors[name]))
    return rows


def _repeats(system, case):
    """Return how many evaluations make up a turn."""
    return max(1, round(TURN_TIME / max(_time(system, case, 1), 1e-7)))


def _time(system, case, count):
    """Return the CPU time of some evaluations [s]."""
    return _time_in(system, np.concatenate((case.q, case.qd)), count)


def _time_in(system, state, count):
    begin = time.thread_time()
    native.evaluate_again(system.native, state, count)
    return time.thread_time() - begin


def _relative(value, reference):
    largest = np.abs(reference).max(initial=0.0)
    return float(np.abs(value - reference).max() / largest) if largest > NOTHING else math.nan


def study_scenes(scenes, progress=lambda done, total: None):
    """
    Measure time and differences of all formulations on scenes, with their effects, as they run.

    Each is evaluated as it moves after ``AFTER`` without torques, or as it starts where it does
    not get there. Errors of the rows returned are the largest differences from the median of all
    formulations, component by component; a formulation that fails is a row with its reason.
    ``progress`` is called with the number of scenes done and of all.
    """
    rows = []
    for done, scene in enumerate(scenes):
        progress(done, len(scenes))
        rows += _of_scene(scene)
    progress(len(scenes), len(scenes))
    return rows


def _of_scene(scene):
    """Return the rows of a scene."""
    moved = Simulation(scene)
    sizes = (scene.name, len(moved.joint_names), len(scene.mechanism.joints),
             scene.mechanism.number_of_equations)
    try:
        moved.step(duration=AFTER)
    except SimulationError:
        moved.reset()
    q, qd = moved.position, moved.velocity
    found, failures, timed = {}, {}, {}
    for name in FORMULATIONS:
        try:
            simulation = Simulation(replace(scene, method=replace(scene.method, formulation=name)))
            found[name] = simulation.forward_dynamics(q, qd)
        except SimulationError as error:
            failures[name] = str(error)
            continue
        state = simulation.integrated.copy()
        state[:len(q) + len(qd)] = np.concatenate((q, qd))
        count = max(1, round(TURN_TIME / max(_time_in(simulation.system, state, 1), 1e-7)))
        timed[name] = simulation.system, state, count
    times = {name: [] for name in timed}
    for _ in range(FEW_TURNS if any(count == 1 for *_, count in timed.values()) else TURNS):
        for name, (system, state, count) in timed.items():
            times[name].append(_time_in(system, state, count) / count)
    middle = [np.median(values, axis=0) for values in zip(*found.values())]
    return [Row(*sizes, name, failure=failures[name]) if name in failures else Row(
        *sizes, name, statistics.median(times[name]),
        *(_relative(value, own) for value, own in zip(found[name], middle)))
        for name in FORMULATIONS]


def exponent(rows):
    """Return the exponent of growth over the largest tenfold of sizes; NaN for fewer than two."""
    rows = [row for row in rows if not math.isnan(row.time)]
    rows = [row for row in rows if row.size >= 0.1 * max(other.size for other in rows)]
    if len(rows) < 2:
        return math.nan
    return float(np.polyfit(np.log([row.size for row in rows]),
                            np.log([row.time for row in rows]), 1)[0])
