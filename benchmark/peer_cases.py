# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What all simulators are given: a mechanism, a start, torques; and the answer they should give.

Everything is read from the shipped scenes, nothing is copied by hand.
"""

from dataclasses import dataclass, replace
import sys
from typing import Callable

from machine import ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.core import types as t  # noqa: E402,I100
from closedloop_dynamics.engine import native  # noqa: E402
from closedloop_dynamics.mechanism.reader import with_cuts  # noqa: E402
from closedloop_dynamics.simulation import scene as scenes  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402

# What computes the answer, and what confirms it: an integrator and its tolerance.
REFERENCES = (('dop853', 1e-13), ('dopri5', 1e-13))
# Trees of a scene: its own, and others that may suit other simulators better, by the joint that is
# cut.
SHIPPED = 'shipped'
OTHER_TREES = {'bricard': {'chain': 'joint_6'}}
# Simulators without a cut hinge hold two points of its axis together, so far apart [m].
HINGE = 1.0


@dataclass(frozen=True)
class Case:
    """
    A motion to be computed.

    Attributes
    ----------
    name : str
    scene : scene.Scene
        With gravity as its only effect.
    tau : ndarray, shape (nv,)
        Constant joint torques and forces [N m, N].
    duration : float
        [s].
    q : ndarray, shape (nq,)
        Start: assembled, the loops closed to rounding. Quaternions are x, y, z, w.
    qd : ndarray, shape (nv,)
        Rates there.
    end : ndarray, shape (nq,)
        Joint coordinates at the end, as exactly as it goes [rad, m].
    uncertainty : float
        What two methods disagree by at the end [rad, m].

    """

    name: str
    scene: object
    tau: np.ndarray
    duration: float
    q: np.ndarray
    qd: np.ndarray
    end: np.ndarray
    uncertainty: float

    def error(self, q):
        """Return how far coordinates are from the end [rad, m]."""
        return float(np.abs(self.scene.mechanism.coordinates.apart(q, self.end)).max())


@dataclass(frozen=True)
class Element:
    """
    A joint of a tree, and the body that it carries, as all simulators in space take them.

    Attributes
    ----------
    name, body : str
        Of both.
    parent : int
        Number of the element that carries it, counted from 1; 0 for the ground.
    type : str
        ``'revolute'``, ``'prismatic'``, ``'universal'`` or ``'spherical'``.
    axes : tuple of str
        Of the first three: ``'x'``, ``'y'`` or ``'z'`` of the element's frame.
    position : tuple of 3 floats
        In the parent's frame [m].
    orientation : tuple of 4 floats
        There: a quaternion x, y, z, w.
    mass : float
        [kg].
    center_of_mass : tuple of 3 floats
        In the element's frame [m].
    inertia : tuple of 3 floats
        About it, along the frame's axes [kg m^2].

    """

    name: str
    body: str
    parent: int
    type: str  # noqa: A003
    axes: tuple
    position: tuple
    orientation: tuple
    mass: float
    center_of_mass: tuple
    inertia: tuple

    def __post_init__(self):
        """Refuse what the others are not told."""
        if self.type not in ('revolute', 'prismatic', 'universal', 'spherical'):
            raise ValueError(f'{self.name}: no joint {self.type} here')


@dataclass(frozen=True)
class Run:
    """
    One way to compute a motion.

    Attributes
    ----------
    engine, line, setting : str
        Simulator; integrator and how it is called; step size or tolerance.
    execute : callable
        Computes the motion from its start, returns the joint coordinates at its end.
    prepare : callable, optional
        Called before each ``execute``, not timed.

    """

    engine: str
    line: str
    setting: str
    execute: Callable
    prepare: Callable = None


def gravity(scene):
    """Return the acceleration of gravity of a scene that has no other effect [m/s^2]."""
    effects = list(scene.effects.values())
    if [type(effect).__name__ for effect in effects] != ['Gravity']:
        raise ValueError(f'{scene.name}: expected gravity alone, got {list(scene.effects)}')
    return effects[0].acceleration


def simulation(scene, integrator, value, duration, adaptive=True):
    """Return a simulation with one method: a tolerance, or a step size [s]."""
    keys = {'step_size': duration, 'tolerance': value} if adaptive else {'step_size': value}
    return Simulation(replace(
        scene, method=replace(scene.method, integrator=integrator, **keys)))


def trees(name):
    """Return the names of the trees of a scene, its own first."""
    return (SHIPPED, *OTHER_TREES.get(name, ()))


def load_scene(name, tree=SHIPPED):
    """
    Return a shipped scene as the others want it: joints depth first, about no negative axes.

    Under gravity alone: the Delta robot's stops are no part of a comparison.

    Parameters
    ----------
    name : str
        Of the scene; with another tree one that starts at rest as drawn.
    tree : str
        Of ``trees``.

    """
    scene = scenes.load_scene(name)
    scene = replace(scene, effects={'gravity': scene.effects['gravity']})
    if tree != SHIPPED:
        start = scene.initial
        if any(start.position) or any(start.velocity):
            raise ValueError(f'{name}: expected a start at rest as drawn, got {start}')
        scene = replace(scene, initial=replace(start, turned={}), mechanism=with_cuts(
            scene.mechanism, (OTHER_TREES[name][tree],)))
    scene = _forward(scene)
    mechanism, children = scene.mechanism, {}
    for joint in mechanism.joints:
        children.setdefault(joint.parent, []).append(joint)

    def branch(body):
        for joint in children.get(body, ()):
            yield joint
            yield from branch(joint.child)

    joints = tuple(branch('ground'))
    if joints == mechanism.joints:
        return scene
    ordered = replace(mechanism, joints=joints)
    before, after = mechanism.coordinates, ordered.coordinates
    start = scene.initial
    return replace(scene, mechanism=ordered, initial=replace(
        start,
        position=tuple(after.filled(
            'position', before.by_name('position', start.position), after.start())),
        velocity=tuple(after.filled(
            'velocity', before.by_name('velocity', start.velocity), np.zeros(after.nv)))))


def _forward(scene):
    """Return a scene whose passive joints about negative axes turn the other way."""
    known, start, joints = scene.mechanism.coordinates, scene.initial, []
    position, velocity = np.array(start.position), np.array(start.velocity)
    for joint in scene.mechanism.joints:
        if joint.axis is not None and sum(joint.axis) < 0.0 and not joint.actuated:
            joint = replace(joint, axis=tuple(0.0 - number for number in joint.axis))
            position[known.coordinates[joint.name]] *= -1.0
            velocity[known.rates[joint.name]] *= -1.0
        joints.append(joint)
    return replace(scene, mechanism=replace(scene.mechanism, joints=tuple(joints)),
                   initial=replace(start, position=tuple(position), velocity=tuple(velocity)))


def elements(mechanism):
    """Return the joints of a mechanism as a list of ``Element``; those of the plane, too."""
    bodies = {body.name: body for body in mechanism.bodies}
    numbers = {'ground': 0}
    found = []
    for number, joint in enumerate(mechanism.joints, start=1):
        numbers[joint.child] = number
        body, orientation = bodies[joint.child], joint.orientation
        if mechanism.planar:
            # Slides move along x of the frame that they turn by ``angle``.
            axes = ('x' if joint.type == 'prismatic' else 'z',)
            orientation = (0.0, 0.0, np.sin(0.5 * joint.angle), np.cos(0.5 * joint.angle))
            inertia = 3 * (body.inertia,)
        else:
            axes = tuple(_letter(axis) for axis in (joint.axis, joint.second_axis) if axis)
            if any(body.inertia[3:]):
                raise ValueError(f'{body.name}: expected the principal axes of its frame')
            inertia = body.inertia[:3]
        found.append(Element(
            joint.name, joint.child, numbers[joint.parent], joint.type, axes,
            _in_space(joint.position), tuple(orientation), body.mass,
            _in_space(body.center_of_mass), inertia))
    return found


def point_pairs(mechanism):
    """
    Return the points that loops hold together.

    Returns
    -------
    list of (int, tuple of 3 floats, int, tuple of 3 floats)
        Numbers of two elements, and a point in the frame of each [m]; of a hinge in space two.

    """
    numbers = {'ground': 0}
    numbers.update((joint.child, k) for k, joint in enumerate(mechanism.joints, start=1))
    found = []
    for cut in mechanism.cut_joints:
        if cut.type not in ('revolute', 'spherical'):
            raise ValueError(f'{cut.name}: no cut joint {cut.type} here')
        points = np.array([_in_space(cut.point_a), _in_space(cut.point_b)])
        along = [np.zeros((2, 3))]
        if cut.type == 'revolute' and not mechanism.planar:
            half = 0.5 * HINGE * np.array([cut.axis_a, cut.axis_b])
            along = [half, -half]
        for step in along:
            a, b = (tuple(point.tolist()) for point in points + step)
            found.append((numbers[cut.body_a], a, numbers[cut.body_b], b))
    return found


def _in_space(vector):
    return (*vector, 0.0)[:3]


def _letter(axis):
    return 'xyz'[[(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)].index(tuple(axis))]


def build_case(name, scene, torque, duration):
    """Return a case with its answer, computed by two methods."""
    gravity(scene)
    ends = []
    for integrator, tolerance in REFERENCES:
        run = simulation(scene, integrator, tolerance, duration)
        start = run.position, run.velocity
        tau = run.joint_torques(torque)
        run.advance(tau, 1)
        ends.append(run.position)
    case = Case(name, scene, tau, duration, *start, ends[0], 0.0)
    return replace(case, uncertainty=case.error(ends[1]))


def random_states(scene, count, seed=1):
    """
    Return assembled states around a scene's start, with random rates and torques.

    Parameters
    ----------
    scene : scene.Scene
        Where the states are near.
    count : int
        How many.
    seed : int
        Of the choice.

    Returns
    -------
    list of (q, qd, tau), of shapes (nq,), (nv,), (nv,)

    """
    rng = np.random.default_rng(seed)
    run = Simulation(scene)
    names = scene.mechanism.coordinates
    nv, start = names.nv, np.array(scene.initial.position)
    states = []
    for _ in range(count):
        guess = names.moved(start, rng.uniform(-0.1, 0.1, nv))
        run.set_state(guess, rng.uniform(-2.0, 2.0, nv))
        states.append((run.position, run.velocity, rng.uniform(-5.0, 5.0, nv)))
    return states


class Referee:
    """Our own view of any simulator's state: closure error, poses, accelerations."""

    def __init__(self, scene):
        """Build the mechanism."""
        self.simulation = Simulation(scene)
        self.mechanism = scene.mechanism

    def acceleration(self, q, qd, tau):
        """Return our joint accelerations, shape (nv,)."""
        system = self.simulation.data.system
        system.tau[:] = tau
        native.evaluate(system.native, q, qd)
        return system.qdd.copy()

    def closure(self, q):
        """Return the largest closure error [m, rad]."""
        state = self.simulation.data.integrated
        state[:] = 0.0
        names = self.mechanism.coordinates
        # Quaternions of norm 1.
        state[:len(q)] = names.moved(q, np.zeros(names.nv))
        self.simulation.data.touch()
        return self.simulation.closure

    def poses(self, q, qd):
        """Return {body: (pose, velocity)} of centres of mass in the plane: x, y, angle each."""
        system = self.simulation.data.system
        native.outward(system.model, q, qd, system.work)
        result, row = {}, 0
        for j in self.simulation.data.decomposition.joint_order:
            row += 1
            name = self.mechanism.joints[j].child
            x, y = next(b.center_of_mass for b in self.mechanism.bodies if b.name == name)
            b = system.work.body[row]
            rx, ry = b[t.COS] * x - b[t.SIN] * y, b[t.SIN] * x + b[t.COS] * y
            result[name] = (
                (b[t.PX] + rx, b[t.PY] + ry, b[t.ALPHA]),
                (b[t.VX] - b[t.OMEGA] * ry, b[t.VY] + b[t.OMEGA] * rx, b[t.OMEGA]))
        return result
