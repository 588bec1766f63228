# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What all simulators are given: a machine, a motion of it; and the answer they should give.

Everything is read from the shipped scenes or from models of others, nothing is copied by hand.
"""

from dataclasses import dataclass, replace
import os
from pathlib import Path
import resource
import shlex
import subprocess
import time
from typing import Callable
import warnings

from closedloop_dynamics.formats.in_space import in_space
from closedloop_dynamics.formats.registry import is_model, read_model
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.mechanism.mechanism import GROUND, REVOLUTE, SPHERICAL
from closedloop_dynamics.mechanism.reader import with_cuts
from closedloop_dynamics.scene import loading as scenes
from closedloop_dynamics.scene.model_scene import assembled, scene_of_model
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.studies.reference import in_angles
import numpy as np

# Trees of a scene: its own, and others that may suit other simulators better, by the joint that is
# cut.
SHIPPED = 'shipped'
OTHER_TREES = {'bricard': {'chain': 'joint_6'}}
# Computing a motion is given up after so long [s].
PATIENCE = 8.0
# What moves less than this stands still [rad or m].
STILL = 1e-6


class CannotExpress(ValueError):
    """The simulator has no word for a part of the machine."""

    text = 'cannot express it'


class NotAdapted(ValueError):
    """The simulator might know the machine, but this benchmark does not tell it."""

    text = 'our adapter does not'


class TooLarge(NotAdapted):
    """The code for the machine takes too long to compile."""

    text = 'too large'


class Disagreement(ValueError):
    """The machine that the simulator was told is another one: an error of the benchmark."""


@dataclass(frozen=True)
class Machine:
    """
    A machine that simulators are told.

    Attributes
    ----------
    name : str
    scene : scene.Scene
        With its effects and start.
    path : pathlib.Path or None
        File of a model, which other simulators may read by themselves.

    """

    name: str
    scene: object
    path: Path = None

    @property
    def mechanism(self):
        """Return the mechanism of the scene."""
        return self.scene.mechanism

    @property
    def gravity(self):
        """Return the acceleration of gravity, shape (3,) [m/s^2]."""
        return next(((*effect.acceleration, 0.0)[:3] for effect in self.scene.effects.values()
                     if type(effect).__name__ == 'Gravity'), (0.0, 0.0, 0.0))

    def require_gravity_alone(self):
        """Raise CannotExpress where the scene has other effects."""
        kept = under_gravity(self.scene).effects
        others = [name for name in self.scene.effects if name not in kept]
        if others:
            raise CannotExpress(f'effects ({", ".join(others)})')


def under_gravity(scene):
    """Return a scene with no other effect than gravity."""
    return replace(scene, effects={name: effect for name, effect in scene.effects.items()
                                   if type(effect).__name__ == 'Gravity'})


def trees(name):
    """Return the names of the trees of a scene, its own first."""
    return (SHIPPED, *OTHER_TREES.get(name, ()))


def load_scene(name, tree=SHIPPED):
    """
    Return a shipped scene under gravity alone, its joints depth first, as others number them.

    Parameters
    ----------
    name : str
        Of the scene; with another tree one that starts at rest as drawn.
    tree : str
        Of ``trees``.

    """
    scene = under_gravity(scenes.load_scene(name))
    start = scene.initial
    if tree != SHIPPED:
        if any(start.position) or any(start.velocity):
            raise ValueError(f'{name}: expected a start at rest as drawn, got {start}')
        scene = replace(scene, initial=replace(start, turned={}), mechanism=with_cuts(
            scene.mechanism, (OTHER_TREES[name][tree],)))
        start = scene.initial
    before = scene.mechanism.coordinates
    mechanism = replace(scene.mechanism, joints=tuple(depth_first(scene.mechanism)))
    after = mechanism.coordinates
    return replace(scene, mechanism=mechanism, initial=replace(
        start,
        position=tuple(after.filled(
            'position', before.by_name('position', start.position), after.start())),
        velocity=tuple(after.filled(
            'velocity', before.by_name('velocity', start.velocity), np.zeros(after.nv)))))


def depth_first(mechanism, body=GROUND):
    """Yield the joints that a body carries, each before those that it carries itself."""
    for joint in mechanism.joints:
        if joint.parent == body:
            yield joint
            yield from depth_first(mechanism, joint.child)


def with_balls_at_loops(mechanism, places=(-0.5, 0.5)):
    """
    Return a mechanism in space without hinges that close loops, which other simulators have not.

    Two balls at places on the axis [m] stand for one; in the plane one suffices.
    """
    whole, cuts = in_space(mechanism), []
    for cut in whole.cut_joints:
        for along in () if cut.type != REVOLUTE else (0.0,) if mechanism.planar else places:
            a, b = (tuple((np.array(point) + along * np.array(axis)).tolist()) for point, axis in (
                (cut.point_a, cut.axis_a), (cut.point_b, cut.axis_b)))
            cuts.append(replace(cut, name=f'{cut.name}_at_{along:g}', type=SPHERICAL, point_a=a,
                                point_b=b, axis_a=None, axis_b=None))
        if cut.type != REVOLUTE:
            cuts.append(cut)
    return replace(whole, cut_joints=tuple(cuts))


def files(directory):
    """Return the files of models in a folder and below, sorted."""
    return sorted(path for path in Path(directory).rglob('*')
                  if path.is_file() and is_model(path) and path.suffix.lower() != '.xacro')


def name_of(path):
    """Return what a model is called in the tables: its file, or the folder of a plain name."""
    return path.parent.name if path.stem in ('robot', 'model', 'scene') else path.stem


def published(path):
    """Return the machine of a model as its authors wrote it, moved by gravity alone."""
    imported, found, notes = assembled(read_model(path))
    if not found.closed:
        raise SimulationError(' '.join(notes))
    return Machine(name_of(path), under_gravity(scene_of_model(path, imported)), path)


def driven_away(machine, angle):
    """Return a machine that starts with its drives at an angle [rad], not as it is drawn."""
    scene, names = machine.scene, machine.mechanism.coordinates
    drives = {joint.name for joint in machine.mechanism.joints if joint.actuated}
    position = np.array(scene.initial.position)
    for name in drives:
        position[names.coordinates[name].start] = angle
    held = replace(scene, initial=replace(
        scene.initial, position=tuple(position.tolist()), hold=tuple(sorted(drives))))
    with warnings.catch_warnings():
        # That the other joints move far is wanted.
        warnings.simplefilter('ignore')
        closed = Simulation(held).position
    return replace(machine, scene=replace(held, initial=replace(
        held.initial, position=tuple(closed.tolist()), hold=())))


def random_states(scene, count, apart=0.1, fast=2.0, push=5.0, drives=False):
    """
    Return assembled states around a scene's start, with random rates and torques.

    Parameters
    ----------
    scene : scene.Scene
        Where the states are near.
    count : int
        How many.
    apart, fast, push : float
        Bounds of displacements [rad, m], rates and torques.
    drives : bool
        Whether torques act on drives alone.

    Returns
    -------
    list of (q, qd, tau), of shapes (nq,), (nv,), (nv,)

    """
    rng, run, names = np.random.default_rng(1), Simulation(scene), scene.mechanism.coordinates
    start, acting = run.position, np.ones(names.nv)
    if drives:
        acting[:] = np.isin(np.arange(names.nv), list(names.actuated))
    states = []
    for _ in range(count):
        run.set_state(names.moved(start, rng.uniform(-apart, apart, names.nv)),
                      rng.uniform(-fast, fast, names.nv))
        states.append((run.position, run.velocity,
                       acting * rng.uniform(-push, push, names.nv)))
    return states


def run_compiler(variable, default, arguments, longest=None):
    """
    Run the compiler that a variable of the environment names.

    NotAdapted where it fails, TooLarge where it takes more CPU time than is allowed [s].
    """
    try:
        limit = longest and (longest, longest + 1)
        subprocess.run([*shlex.split(os.environ.get(variable, default)), *map(str, arguments)],
                       check=True, capture_output=True, text=True, preexec_fn=limit and (
                           lambda: resource.setrlimit(resource.RLIMIT_CPU, limit)))
    except (OSError, subprocess.CalledProcessError) as error:
        lines = (getattr(error, 'stderr', '') or str(error)).strip().splitlines()
        # Before it stands where the file was included.
        fault, *_ = (*(line for line in lines if 'error:' in line), *lines, error)
        if 'CPU time limit' in fault:
            raise TooLarge(f'not compiled in {longest} s') from error
        raise NotAdapted(f'not compiled: {fault}') from error


@dataclass(frozen=True)
class Line:
    """
    One way to compute a motion, at settings from coarse to fine.

    Attributes
    ----------
    engine, name : str
        Simulator; integrator and how it is called.
    settings : sequence of str
        Step sizes or tolerances.
    run : callable
        Takes the number of a setting, returns a function that computes the motion from its start
        and returns the joint coordinates at its end; its attribute ``prepare``, if it has one, is
        called before and not timed.
    targets : sequence of float
        What errors the settings ask for, of a method that is asked for one.

    """

    engine: str
    name: str
    settings: tuple
    run: Callable
    targets: tuple = ()


class Case:
    """
    A motion to be computed, and its answer.

    Parameters
    ----------
    name : str
    machine : Machine
    torques : ndarray, shape (n, number of torques of ``advance``)
        Held one after the other [N m, N].
    duration : float
        Of all together [s].
    outputs : int
        Instants at which positions are compared, at even distances.
    references : sequence of (str, float)
        Integrator and tolerance of what computes the answer and of what confirms it: the first
        two that succeed.
    known : sequence of float
        How well the answer must be known [rad or m]: less well only where it is so for less than
        the share ``shortest`` of the motion, which ends where it is not.
    shortest : float

    Attributes
    ----------
    span, step : float
        How long a torque is held; the longest step that ends at outputs and torques [s].
    q, qd : ndarrays, shapes (nq,) and (nv,)
        Start: assembled, the loops closed to rounding. Quaternions are x, y, z, w.
    positions : ndarray, shape (outputs, nq)
        As exactly as it goes [rad, m].
    uncertainty : float
        What two methods disagree by [rad, m].
    still : bool
        Whether nothing moves.

    """

    def __init__(self, name, machine, torques, duration, outputs=1,
                 references=(('dop853', 1e-13), ('dopri5', 1e-13)), known=(np.inf,), shortest=1.0):
        self.name, self.machine, self.torques, self.duration = name, machine, torques, duration
        self.coordinates = machine.mechanism.coordinates
        self.span = duration / len(torques)
        self.step, self._outputs = min(self.span, duration / outputs), outputs
        self._first = first = Simulation(machine.scene)
        self.q, self.qd = first.position.copy(), first.velocity.copy()
        found, why = [], []
        for integrator, tolerance in references:
            try:
                found.append(self.run(integrator=integrator, tolerance=tolerance)[0])
            except SimulationError as error:
                why.append(f'{integrator}: {error}')
            if len(found) == 2:
                break
        else:
            raise SimulationError('; '.join(why) or 'nothing proves the reference')
        apart = np.array([self._apart(*pair) for pair in zip(*found)])
        for most in known:
            beyond = np.flatnonzero(~(apart <= most))
            kept = int(beyond[0]) if len(beyond) else outputs
            if kept >= shortest * outputs:
                break
        else:
            raise SimulationError('two methods do not agree')
        self.positions, self.uncertainty = found[0][:kept], float(apart[:kept].max())
        self.still = float(np.abs(self.positions - self.q).max()) < STILL
        self.torques = torques[:max(1, round(len(torques) * kept / outputs))]
        self.duration, self._outputs = duration * kept / outputs, kept
        self.span = self.duration / len(self.torques)

    def _apart(self, q, other):
        return float(np.abs(in_angles(self.coordinates, q, other)).max(initial=0.0))

    def error(self, q):
        """Return how far coordinates are from the end [rad, m]."""
        return self._apart(q, self.positions[-1])

    def closure(self, q):
        """Return the largest closure error of coordinates [m, rad]."""
        if not np.isfinite(q).all():
            return np.nan
        state = self._first.data.integrated
        # Quaternions of norm 1.
        state[:len(q)] = self.coordinates.moved(q, np.zeros(self.coordinates.nv))
        state[len(q):] = 0.0
        self._first.data.touch()
        return self._first.closure

    def stepped(self, engine, name, steps, run):
        """
        Return a line of fixed steps, of about these sizes [s].

        ``run`` takes the number of steps while a torque is held, and their size.
        """
        counts = sorted({max(1, round(self.span / step)) for step in steps})
        return Line(engine, name, [f'step {self.span / count:.3g} s' for count in counts],
                    lambda number: run(counts[number], self.span / counts[number]))

    def simulation(self, **method):
        """Return a simulation by a method, that of the scene but for some keys."""
        simulation = Simulation(replace(self.machine.scene, method=replace(
            self.machine.scene.method.without_budget, stabilisation='projection',
            baumgarte_time_constant=None, **{'step_size': self.step, **method})))
        simulation.stepping.monitor.sampling = False
        return simulation

    def run(self, **method):
        """Return positions at the outputs, and the simulation at the end."""
        simulation, positions, begin = self.simulation(**method), [], time.thread_time()
        steps = round(self.duration / self.step)
        for number in range(1, steps + 1):
            simulation.advance(self.torques[(number - 1) * len(self.torques) // steps], 1)
            if number * self._outputs % steps == 0:
                positions.append(simulation.position.copy())
                if time.thread_time() - begin > PATIENCE:
                    raise SimulationError(f'{PATIENCE:g} s of computing were not enough')
        return np.array(positions), simulation

    def largest_error(self, **method):
        """Return the largest error of a method at all outputs, and the simulation at the end."""
        positions, simulation = self.run(**method)
        return float(np.max([*map(self._apart, positions, self.positions)])), simulation
