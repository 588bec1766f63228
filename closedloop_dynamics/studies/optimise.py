# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Optimal numbers of a machine over a driven motion, under requirements.

From several starts, each one by SciPy: least squares (``least_squares``) where the root of a mean
square alone is minimised, sequential quadratic programming (``SLSQP``) otherwise. Of two aims the
Pareto front is found by bounds of the second one (epsilon constraints).

A machine that cannot be assembled, or not be driven all the way, is no point at all: a step there
is taken back by the optimiser, and a start there is drawn again. What is reported is the best
machine among those that were looked at and meet all requirements.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
import hashlib
import json
import math
from pathlib import Path
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from .objectives import Bound, Expression, read_all, Requirement, TOLERANCE
from .quantities import Driven, Infeasible, Quantities, Variable, with_values
from ..mechanism.errors import SimulationError
from ..mechanism.fields import FieldError, shown
from ..recording import design
from ..recording.kinematics import Drive, DrivenRun, start_position
from ..scene.key_paths import numbers, resolve
from ..scene.loading import load_scene
from ..scene.records import Scene
from ..scene.text import scene_text
from ..sweep.executors import dispatched, engine_for
from ..sweep.runner import without_numbers

STARTS, FRONT, POSES = 8, 9, 73
# Random machines from which a start is chosen, and how many are tried to find as many.
CHOICE, DRAWS = 5, 300
# Relative accuracy and iterations of the optimisers; how often SLSQP goes on where it stopped.
ACCURACY, ITERATIONS, ROUNDS = 1e-9, 100, 4
# Improvement that is worth another round, of the aim; aims that differ by less are the same.
WORTH, SAME = 1e-5, 1e-6
FORMAT = 1


class OptimumFileError(ValueError):
    """A file without results, or with those of another problem."""


@dataclass(frozen=True)
class Problem:
    """Variables, objectives and requirements."""

    scene: Scene  # With the numbers before
    variables: Tuple[Variable, ...]
    aims: Tuple[Expression, ...]  # One or two
    requirements: Tuple[Requirement, ...]
    driven: Driven
    seed: int
    #: Places by the names that ``distance`` has for them.
    paths: Mapping[str, np.ndarray] = field(default_factory=dict)
    #: Aims of the scene as it is; None where it cannot be assembled or driven.
    before: Optional[Tuple[float, ...]] = None
    without: str = ''  # Why there are none

    @property
    def low(self) -> np.ndarray:
        """Return the lower bounds, shape (k,)."""
        return np.array([one.low for one in self.variables])

    @property
    def width(self) -> np.ndarray:
        """Return the ranges, shape (k,)."""
        return np.array([one.high - one.low for one in self.variables])


class Candidate(NamedTuple):
    """A machine that was found."""

    values: Tuple[float, ...]  # Of the variables
    aims: Tuple[float, ...]
    #: By how much requirements are missed, of their size; 0, but for rounding, where they are met.
    missed: float
    #: Joint coordinates from which its loops are closed, as its scene has them.
    position: Tuple[float, ...]
    message: str  # Message of the optimiser
    #: ``evaluations``, ``gradients``: Machines that were driven all the way, and of how many
    #: derivatives were found.
    evaluations: int
    gradients: int
    refused: Dict[str, int]  # How many machines could not be assembled or driven, by reason

    @property
    def feasible(self) -> bool:
        """Return whether it is a machine that meets all requirements."""
        return len(self.values) > 0 and self.missed <= TOLERANCE


@dataclass
class Optimum:
    """Result of an optimisation."""

    problem: Problem
    #: By aim and start, ``'aim 1 start 0'``.
    starts: Dict[str, Candidate] = field(default_factory=dict)
    #: With two aims: candidates that no other surpasses in both, by the first aim.
    front: List[Candidate] = field(default_factory=list)
    finished: bool = False

    @property
    def best(self) -> Optional[Candidate]:
        """Return the best machine for the first aim; None where none meets the requirements."""
        return min((one for one in self.starts.values() if one.feasible),
                   key=lambda one: one.aims[0], default=None)

    @property
    def refused(self) -> Counter:
        """Return how many machines could not be assembled or driven, by reason."""
        return sum((Counter(one.refused) for one in self.starts.values()), Counter())

    def scene(self, found: Candidate) -> Scene:
        """Return the scene of a machine that was found."""
        scene = with_values(self.problem.scene, self.problem.variables, found.values)
        return replace(scene, initial=replace(scene.initial, position=tuple(found.position)))


def problem_of(scene, vary: Mapping[str, Tuple[float, float]], minimise: Sequence[str],
               subject_to: Sequence[str] = (), drives: Optional[Mapping[str, Drive]] = None, *,
               poses: int = POSES, speed: float = 1.0, branch: Optional[int] = None,
               seed: int = 0, paths: Mapping[str, Any] = ()) -> Problem:
    """Return a problem, checked; arguments and errors are those of ``optimise``."""
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    variables = tuple(_variable(scene, key, *ends) for key, ends in vary.items())
    if not variables:
        raise FieldError('a number that is varied', 'none', path=('vary',))
    aims = (minimise,) if isinstance(minimise, str) else tuple(minimise)
    if len(aims) not in (1, 2):
        raise FieldError('one or two expressions', f'{len(aims)}', path=('minimise',))
    driven = Driven(dict(drives) if drives else design.cycle(scene), poses, float(speed), branch)
    if poses < 3:
        raise FieldError('three poses or more', str(poses), path=('poses',))
    try:
        # What is not a drive of this scene is refused; a machine that it does not move may come.
        DrivenRun(driven.start(scene), driven.drives, poses, driven.speed, branch)
    except SimulationError:
        pass
    places = {name: _places(name, values) for name, values in dict(paths).items()}
    aims = read_all(Expression, 'minimise', aims, scene, driven.drives, places)
    requirements = read_all(
        Requirement, 'subject_to', (subject_to,) if isinstance(subject_to, str) else subject_to,
        scene, driven.drives, places)
    problem = Problem(scene, variables, aims, requirements, driven, int(seed), places)
    try:
        before = aims_of(problem, scene)
        quantities = Quantities(scene, driven)
        for one in requirements:
            # Before anything is computed: each is a number.
            one.sizes(quantities)
        return replace(problem, before=before)
    except Infeasible as error:
        return replace(problem, without=str(error))


def _variable(scene, key, low, high):
    with_path = '.'.join(resolve(scene, key))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise FieldError('LOW:HIGH, finite, LOW below HIGH', f'{low:g}:{high:g}', path=(key,))
    if numbers(scene)[with_path] is None:
        raise FieldError('a number that the scene gives', 'one that it does not', path=(key,))
    return Variable(with_path, float(low), float(high))


def _places(name, values):
    found = np.array(values, dtype=float)
    if found.ndim != 2 or found.shape[1] not in (2, 3) or not len(found) or not (
            np.isfinite(found).all()):
        raise FieldError('finite places, shape (m, 2) or (m, 3)', f'shape {found.shape}',
                         path=('paths', name))
    return found


def optimise(scene, vary: Mapping[str, Tuple[float, float]], minimise, subject_to=(),
             drives: Optional[Mapping[str, Drive]] = None, *, poses: int = POSES,
             speed: float = 1.0, branch: Optional[int] = None, starts: int = STARTS,
             front: int = FRONT, seed: int = 0, paths: Mapping[str, Any] = (),
             file: Optional[Path] = None, resume: bool = False, workers: Optional[int] = None,
             show: Callable[[int, int], None] = lambda done, total: None,
             keep_going: Callable[[], bool] = lambda: True) -> Optimum:
    """
    Find the numbers of a machine that minimise an expression, or two.

    Parameters
    ----------
    scene : Scene, str or pathlib.Path
        As ``load_scene`` takes it.
    vary : mapping of str to (float, float)
        Least and largest value of numbers, by key path.
    minimise : str or sequence of str
        One or two expressions of quantities of the driven machine.
    subject_to : str or sequence of str
        Requirements, ``EXPRESSION >= EXPRESSION`` or ``<=``.
    drives : mapping of str to Drive, optional
        As for ``DrivenRun``; one turn of the one actuated joint, or from limit to limit, when not
        given.
    poses : int
        Over the motion.
    speed : float
        Of the first drive that moves [rad/s or m/s].
    branch : int, optional
        As for ``DrivenRun``.
    starts : int
        The first one is the scene as it is, where that lies within the bounds; the others are
        drawn.
    front : int
        Machines on the Pareto front of two aims.
    seed : int
        Of the draws; the same seed finds the same.
    paths : mapping of str to array_like, shape (m, 2), in space (m, 3)
        Places by the names that ``distance`` has for them [m].
    file : pathlib.Path, optional
        Where every result is written as soon as it is known, a line each.
    resume : bool
        Whether to go on with that file, where there is one.
    workers : int, optional
        Processes on this machine; as many as it has processors, where that pays, when not given.
    show : callable
        Called with results that are there, and how many there will be.
    keep_going : callable
        Polled; where it returns False the search ends, with what is there.

    Returns
    -------
    Optimum

    Raises
    ------
    FieldError, SceneError
        For what makes no sense.
    ValueError
        For drives that do not fit.
    OptimumFileError
    EngineError
        For workers that are gone.

    """
    problem = problem_of(
        scene, vary, minimise, subject_to, drives, poses=poses, speed=speed, branch=branch,
        seed=seed, paths=paths)
    for name, value, least in (('starts', starts, 1), ('front', front, 3)):
        if value != int(value) or value < least:
            raise FieldError(f'a whole number >= {least}', shown(value), path=(name,))
    return solve(problem, starts, front, file, resume, workers, show, keep_going)


def solve(problem: Problem, starts: int = STARTS, front: int = FRONT,
          file: Optional[Path] = None, resume: bool = False, workers: Optional[int] = None,
          show: Callable[[int, int], None] = lambda done, total: None,
          keep_going: Callable[[], bool] = lambda: True) -> Optimum:
    """Solve a problem of ``problem_of``; see ``optimise``."""
    optimum = Optimum(problem)
    log = _Log(file, _identity(problem, starts, front), resume)
    two = len(problem.aims) == 2
    tasks = {f'aim {aim + 1} start {start}': partial(from_start, problem, aim, start)
             for start in range(starts) for aim in range(len(problem.aims))}
    total = len(tasks) + (2 * (front - 2) if two else 0)
    done = _run(tasks, log, workers, lambda count: show(count, total), keep_going)
    optimum.starts = done
    if len(done) < len(tasks) or not two:
        optimum.finished = len(done) == len(tasks)
        return optimum
    ends = [min((one for one in done.values() if one.feasible), key=lambda one: one.aims[aim],
                default=None) for aim in (0, 1)]
    if None not in ends:
        low, high = ends[1].aims[1], ends[0].aims[1]
        bounds = np.linspace(low, high, front)[1:-1] if high > low else []
        more = {f'bound {k + 1} from end {end + 1}': partial(
            within_bound, problem, float(bound), ends[end])
            for k, bound in enumerate(bounds) for end in (0, 1)}
        found = _run(more, log, workers, lambda count: show(len(tasks) + count, total),
                     keep_going)
        optimum.starts = {**done, **found}
        if len(found) < len(more):
            return optimum
        optimum.front = undominated(optimum.starts.values())
    optimum.finished = True
    return optimum


def aims_of(problem: Problem, scene: Scene) -> Tuple[float, ...]:
    """Return the aims of another scene, driven as those of a problem; raise Infeasible."""
    quantities = Quantities(scene, problem.driven)
    return tuple(float(one.value(quantities).value) for one in problem.aims)


def undominated(machines):
    """Return the machines that meet all requirements and of which no other is as good in both."""
    found: List[Candidate] = []
    for one in sorted((each for each in machines if each.feasible), key=lambda each: each.aims):
        if found and one.aims[1] >= found[-1].aims[1] - SAME * abs(found[-1].aims[1]):
            continue
        if found and one.aims[0] <= found[-1].aims[0] + SAME * abs(found[-1].aims[0]):
            found.pop()
        found.append(one)
    return found


def from_start(problem: Problem, aim: int, number: int) -> Candidate:
    """Minimise one aim from one of the starts."""
    search = _Search(problem, problem.aims[aim], problem.requirements)
    start = search.drawn(number)
    if start is None:
        return search.result('no machine that can be assembled and driven was drawn')
    return search.minimised(start)


def within_bound(problem: Problem, most: float, start: Candidate) -> Candidate:
    """Minimise the first aim with the second one bounded, from a machine that was found."""
    search = _Search(problem, problem.aims[0],
                     (*problem.requirements, Bound(problem.aims[1], most)))
    search.begin_at(start)
    return search.minimised((np.array(start.values) - problem.low) / problem.width)


class _Stop(Exception):
    """Derivatives were requested where no machine exists."""


class _Search:
    """One minimisation; variables are scaled to 0 ... 1."""

    def __init__(self, problem, aim, requirements):
        self._problem, self._aim, self._requirements = problem, aim, requirements
        self._scene = problem.scene
        self._at, self._plain, self._sloped = None, None, None
        self._best, self._refused = None, Counter()
        self._evaluations = self._gradients = 0

    # Machines

    def begin_at(self, found):
        """Close loops from where those of another machine were closed."""
        self._scene = replace(self._scene, initial=replace(
            self._scene.initial, position=tuple(found.position)))

    def _values(self, z):
        share = np.clip(z, 0.0, 1.0)
        # The ends of a range are met exactly.
        high = np.array([one.high for one in self._problem.variables])
        return (1.0 - share) * self._problem.low + share * high

    def _quantities(self, z, slopes=False):
        """Return the quantities of a machine; the latest ones are kept."""
        if self._at is None or not np.array_equal(self._at, z):
            self._at, self._plain, self._sloped = np.array(z), None, None
            try:
                self._plain = Quantities(
                    with_values(self._scene, self._problem.variables, self._values(z)),
                    self._problem.driven)
                self._consider(z)
                self._evaluations += 1
            except Infeasible as error:
                self._plain = error
                self._refused[without_numbers(str(error).partition(':')[0])] += 1
        if isinstance(self._plain, Infeasible):
            raise self._plain
        if not slopes:
            return self._plain
        if self._sloped is None:
            self._gradients += 1
            self._sloped = self._plain.by(self._problem.variables)
        return self._sloped

    def _consider(self, z):
        """Keep the machine if it is the best one so far: fewer violations, or a better value."""
        missed = max((one.missed(self._plain) for one in self._requirements), default=0.0)
        rank = (missed if missed > TOLERANCE else 0.0,
                float(self._aim.value(self._plain).value))
        if self._best is None or rank < self._best[0]:
            aims = [float(one.value(self._plain).value) for one in self._problem.aims]
            self._best = rank, np.array(z), aims, missed

    def drawn(self, number):
        """Return the start of a number, None where no machine was found."""
        problem = self._problem
        known = numbers(problem.scene)
        here = (np.array([known[one.key] for one in problem.variables]) - problem.low) / (
            problem.width)
        if number == 0 and ((here >= 0.0) & (here <= 1.0)).all():
            try:
                self._quantities(here)
                return self._begun(here)
            except Infeasible:
                pass
        generator = np.random.default_rng([problem.seed, number])
        found = 0
        for _ in range(DRAWS):
            try:
                self._quantities(generator.random(len(here)))
                found += 1
            except Infeasible:
                continue
            if found == CHOICE:
                break
        return self._begun(self._best[1]) if found else None

    def _begun(self, z):
        """Close all further loops from where those of a start are closed, which is near."""
        scene = with_values(self._scene, self._problem.variables, self._values(z))
        self._scene = replace(self._scene, initial=replace(
            self._scene.initial, position=tuple(
                start_position(self._problem.driven.start(scene)).tolist())))
        self._at = None
        return z

    # The optimisers

    def minimised(self, z):
        """Return the best machine that the optimisers find from a start."""
        message = ''
        try:
            self._quantities(z)
            if self._aim.is_squared and not self._requirements:
                message = self._by_least_squares(z)
            else:
                message = self._by_programming(z)
        except (_Stop, Infeasible) as error:
            message = f'stopped where no machine is: {error}'
        return self.result(message)

    def result(self, message):
        """Return the best machine so far."""
        if self._best is None:
            return Candidate((), (), math.inf, (), message, self._evaluations, self._gradients,
                             dict(self._refused))
        _, z, aims, missed = self._best
        values = self._values(z)
        position = start_position(self._problem.driven.start(
            with_values(self._scene, self._problem.variables, values)))
        return Candidate(tuple(values.tolist()), tuple(aims), float(missed),
                         tuple(position.tolist()), message, self._evaluations, self._gradients,
                         dict(self._refused))

    def _by_least_squares(self, z):
        from scipy.optimize import least_squares
        count = len(self._aim.squared_parts(self._quantities(z)).value)

        def parts(at):
            try:
                return self._aim.squared_parts(self._quantities(at)).value
            except Infeasible:
                # It takes such a step back, and makes a shorter one.
                return np.full(count, np.inf)

        def slopes(at):
            return self._slope(self._aim.squared_parts, at)

        found = least_squares(parts, np.clip(z, 0.0, 1.0), slopes, bounds=(0.0, 1.0),
                              xtol=ACCURACY, ftol=ACCURACY, gtol=1e-15, max_nfev=ITERATIONS)
        return found.message

    def _slope(self, function, at):
        """Return derivatives by the scaled variables."""
        try:
            return function(self._quantities(at, slopes=True)).slope * self._problem.width
        except Infeasible as error:
            raise _Stop(str(error)) from None

    def _by_programming(self, z):
        message = ''
        for _ in range(ROUNDS):
            before = self._best[0]
            found = self._one_programme(z)
            message, z = found.message, self._best[1]
            after = self._best[0]
            if found.success or after[0] >= before[0] and (
                    before[1] - after[1] <= WORTH * abs(before[1])):
                break
        return message

    def _one_programme(self, z):
        """Minimise by SLSQP, the largest value over a motion as a bound of all."""
        from scipy.optimize import minimize
        count, quantities = len(z), self._quantities(z)
        start = float(self._aim.value(quantities).value)
        size = abs(start) or 1.0
        spread = self._aim.largest_parts(quantities) is not None
        sizes = [max(map(abs, one.sizes(quantities))) or 1.0 for one in self._requirements]
        last = [None]

        def below(at):
            """Return by how much all poses are below the bound that is minimised."""
            parts = self._aim.largest_parts(self._quantities(at[:count]))
            return at[count] - parts.value / size

        def value(at):
            try:
                found = self._aim.value(self._quantities(at[:count])).value / size
                return float(at[count] if spread else found)
            except Infeasible:
                # Its line search goes back from there.
                return math.inf

        def slope(at):
            if spread:
                return np.eye(count + 1)[count]
            return self._slope(self._aim.value, at[:count]) / size

        def gaps(at):
            try:
                quantities = self._quantities(at[:count])
                last[0] = np.concatenate([
                    *(one.gaps(quantities).value / each for one, each in zip(
                        self._requirements, sizes)), *([below(at)] if spread else [])])
            except Infeasible:
                # The value there is infinite; these decide nothing.
                pass
            return last[0]

        def gap_slopes(at):
            rows = [self._slope(one.gaps, at[:count]) / each for one, each in zip(
                self._requirements, sizes)]
            if not spread:
                return np.concatenate(rows)
            rows = [np.hstack([row, np.zeros((len(row), 1))]) for row in rows]
            parts = self._slope(self._aim.largest_parts, at[:count]) / size
            return np.concatenate([*rows, np.hstack([-parts, np.ones((len(parts), 1))])])

        first = np.append(z, start / size) if spread else np.array(z)
        bounds = [(0.0, 1.0)] * count + ([(None, None)] if spread else [])
        constraints = [{'type': 'ineq', 'fun': gaps, 'jac': gap_slopes}] if (
            self._requirements or spread) else []
        with np.errstate(invalid='ignore'):
            return minimize(value, first, jac=slope, bounds=bounds, constraints=constraints,
                            method='SLSQP', options={'ftol': ACCURACY, 'maxiter': ITERATIONS})


# Results, and where they are kept

class _Log:
    """A file of results, a line each, the first one of the problem."""

    def __init__(self, file, identity, resume):
        self._file, self.known = file, {}
        if file is None:
            return
        if resume and file.exists():
            self._read(identity)
        else:
            file.write_text(json.dumps({'format': FORMAT, 'identity': identity}) + '\n',
                            encoding='utf-8')

    def _read(self, identity):
        whole = ''
        try:
            head, *lines = self._file.read_text(encoding='utf-8').splitlines(keepends=True)
            if json.loads(head) != {'format': FORMAT, 'identity': identity}:
                raise OptimumFileError(
                    f'{self._file}: expected results of the same scene, numbers and options, got '
                    'those of others; name another directory, or begin again with --overwrite')
            whole = head
            for line in lines:
                if line.endswith('\n'):
                    name, values = json.loads(line)
                    self.known[name] = _found(values)
                    whole += line
        except (OSError, ValueError, TypeError, KeyError) as error:
            if isinstance(error, OptimumFileError):
                raise
            raise OptimumFileError(f'{self._file}: expected results of an earlier run, got '
                                   f'a file that cannot be read ({error})') from None
        # Without the line that was being written when it ended.
        self._file.write_text(whole, encoding='utf-8')

    def add(self, name, found):
        """Keep a result."""
        self.known[name] = found
        if self._file is not None:
            with self._file.open('a', encoding='utf-8') as out:
                out.write(json.dumps([name, found._asdict()]) + '\n')


def _found(values):
    return Candidate(**{key: tuple(value) if isinstance(value, list) else value
                        for key, value in values.items()})


def _identity(problem, starts, front):
    """Return a short text that identifies the search."""
    return hashlib.sha256(json.dumps([
        scene_text(problem.scene), repr(problem.variables), repr(problem.driven),
        [one.text for one in problem.aims], [one.text for one in problem.requirements],
        {name: each.tolist() for name, each in problem.paths.items()}, problem.seed, starts,
        front]).encode()).hexdigest()


def _run(tasks, log, workers, show, keep_going):
    """Return the results of tasks by name, those that are there already among them."""
    names = [name for name in tasks if name not in log.known]
    found = {name: log.known[name] for name in tasks if name in log.known}
    show(len(found))
    if not names:
        return found

    def call(places):
        place, = places.tolist()
        return _named, names[place], tasks[names[place]]

    def given_up(places, reason):
        place, = places.tolist()
        return names[place], Candidate((), (), math.inf, (), reason, 0, 0, {})

    with engine_for(len(names), workers) as engine:
        for name, one in dispatched(
                engine, call, given_up, np.arange(len(names))[:, np.newaxis], keep_going):
            if isinstance(one, FieldError):
                raise one
            log.add(name, one)
            found[name] = one
            show(len(found))
    return {name: found[name] for name in tasks if name in found}


def _named(name, task):
    """Return the result of a task, or the error of its problem, with its name."""
    try:
        return name, task()
    except FieldError as error:
        return name, error
