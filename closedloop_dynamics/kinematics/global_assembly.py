# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Positions that close the loops of a mechanism in space, found from far away.

Models of robots are often drawn open, by metres or radians. Here loops are closed by damped least
squares in the mass metric (``engine/loop_solver.hpp``): beside the closure equations, which are
sines of angles, axes that coincide are to point the same way. Where that ends at a place that is
not closed, loops that share joints are searched together, apart from others: the gaps are closed
little by little (a homotopy), and then other starts around the first are tried. What is found is
exact to some 1e-9 only, for Newton's method (``assembly``) to end with.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from .assembly import Assembler
from .modeling import build_model
from ..codegen.equations import ALL_AXES, Equations, Far, Loops, NO_AXIS, ONE_AXIS, THREAD
from ..mechanism.kinematics import body_poses, body_velocities, pose_of, world_points
from ..mechanism.mechanism import (
    CYLINDRICAL, FIXED, GROUND, HELICAL, PLANAR, PRISMATIC, REVOLUTE, UNIVERSAL)
from ..mechanism.rotations import cross, of_quaternion

# Closed means this, relative to the mechanism's size, or sines of angles.
CLOSED = 1e-9
MOST_ITERATIONS = 150
# Largest change of a coordinate in one iteration [rad, or in units of the size].
LARGEST_STEP = 0.5
# Steps of a homotopy, and iterations in each step but the last.
STEPS_OF_HOMOTOPY, FEW_ITERATIONS = 12, 20
# How far around the first start others are [rad, and shares of the size], one after the other.
AMPLITUDES = (0.2, 0.5, 1.0, 1.5, 2.5, 3.1)
STARTS_EACH = 4
# Share of the largest inertia that every coordinate has at least in the metric.
LEAST_INERTIA = 1e-4
# From so many starts a loop is tried alone, to find whether it can be closed at all.
STARTS_ALONE = 12
FROM_THE_START = 'from the start'
# Components of a motion of unit size below this are zero: positions close to the root of rounding.
STILL = 1e-7
# Axes that cut joints keep parallel.
AXES = {REVOLUTE: ONE_AXIS, CYLINDRICAL: ONE_AXIS, PLANAR: ONE_AXIS, PRISMATIC: ALL_AXES,
        FIXED: ALL_AXES, HELICAL: THREAD}


class ClosureResult(NamedTuple):
    """Where the search ended."""

    q: np.ndarray  # Shape (nq,): Coordinates; orientations as unit quaternions x, y, z, w
    #: By joint that closes a loop, and coupling: how far it is open [m, and sines of angles] (dict
    #: of str to float).
    closure_errors: dict
    closed: bool
    how: str  # How it was found


class ClosureProblem:
    """
    The loops of a mechanism in space, or some of them, that are to be closed.

    ``size``, of the mechanism [m], measures lengths; ``limits``: least and largest coordinate of
    joints of one degree of freedom, None where there is none; ``scale``, shape (nv,): unit of each
    rate: the size, or 1 for angles.
    """

    def __init__(self, mechanism, size, limits=None):
        self.mechanism, self.size = mechanism, size
        self.coordinates = mechanism.coordinates
        self.nq, self.nv = self.coordinates.nq, self.coordinates.nv
        self.scale = np.where(self.coordinates.lengths, size, 1.0)
        self._limits, self._closures = limits or {}, mechanism.closures

    @cached_property
    def equations(self):
        """Return all closure equations, those that no motion changes, too."""
        return Equations(build_model(self.mechanism, with_constant=True))

    def part(self, joints, closures):
        """Return the problem of some closures and of the limits of some joints."""
        found = ClosureProblem(self.mechanism, self.size, {
            name: limit for name, limit in self._limits.items() if name in joints})
        found.equations, found._closures = self.equations, closures
        return found

    def free(self, joints, hold=()):
        """Return the places of the rates of some joints, those of joints or freedoms held not."""
        names = self.coordinates
        return np.array([k for k, name in enumerate(names.names) if names.joint_of(name) in joints
                         and not {name, names.joint_of(name)} & set(hold)], dtype=np.int64)

    def start(self, position=None):
        """Return coordinates, shape (nq,), with those of some joints by name, others as drawn."""
        q = self.coordinates.start()
        for name, value in (position or {}).items():
            q[self.coordinates.coordinates[name]] = value
        return q

    def moved(self, q, change):
        """Return coordinates, shape (nq,), after a change, shape (nv,)."""
        return self.coordinates.moved(q, change)

    def frames(self, q):
        """Return where the bodies are, by name: axes in the world, as columns, and origins [m]."""
        poses = body_poses(self.mechanism, q)
        names = [GROUND, *(body.name for body in self.mechanism.bodies)]
        found = {name: pose_of(self.mechanism, poses, name) for name in names}
        return ({name: of_quaternion(pose[3:]) for name, pose in found.items()},
                {name: pose[:3] for name, pose in found.items()})

    def unwound(self, q, start):
        """Return the same position with angles within half a turn of those of a start."""
        q, limited = q.copy(), {self.coordinates.coordinates[name].start for name in self._limits}
        for joint in self.mechanism.joints:
            place = self.coordinates.coordinates[joint.name].start
            count = {REVOLUTE: 1, UNIVERSAL: 2, CYLINDRICAL: 1}.get(joint.type, 0)
            for at in range(place, place + count):
                if at not in limited:
                    q[at] -= 2.0 * np.pi * np.round((q[at] - start[at]) / (2.0 * np.pi))
        return q

    @cached_property
    def _search(self):
        """Return what the engine is to close, but for freedoms and targets."""
        equations, all_closures = self.equations, self.mechanism.closures
        taken = np.array([one in self._closures for one in all_closures], dtype=bool)
        unit = np.where(equations.places, self.size, 1.0)
        coupled = np.repeat([one in self.mechanism.couplings for one in all_closures],
                            equations.counts)
        if coupled.any():
            jac = equations.move(self.start()).jacobian()[coupled]
            unit[coupled] = np.abs(jac * self.scale).max(axis=1)
        places, rates = self.coordinates.coordinates, self.coordinates.rates
        limits = np.array([
            (places[name].start, rates[name].start, -np.inf if lower is None else lower,
             np.inf if upper is None else upper)
            for name, (lower, upper) in self._limits.items()]).reshape(-1, 4)
        return np.flatnonzero(np.repeat(taken, equations.counts)), Far(
            unit, self.scale, np.array([
                AXES.get(getattr(one, 'type', None), NO_AXIS) if use else NO_AXIS
                for one, use in zip(all_closures, taken)], dtype=np.int64), limits, np.zeros(0))

    def residual(self, q):
        """
        Return how far all is from coinciding, and the Jacobian of that, shape (n, nv).

        Shape (n,): errors of the closure equations, lengths in units of the size; for each closure
        what the cosines of angles between axes lack of 1; how far coordinates are beyond limits.
        Those of other closures are zero.
        """
        rows, far = self._search
        values = np.empty(len(far.unit) + len(far.axes) + len(far.limits))
        slopes = np.empty((len(values), self.nv))
        self.equations.solve('loop_residuals', np.array(q, dtype=float), Loops(
            self.equations.places, rows, self.free(())), far, values, slopes)
        return values, slopes

    def nearest(self, q, free, target=None, most=MOST_ITERATIONS):
        """
        Return the coordinates where Levenberg's and Marquardt's method ends.

        ``free``: places of the rates that may change; ``target``: residuals that are wanted.
        """
        (rows, far), found = self._search, np.array(q, dtype=float)
        self.equations.solve(
            'search_loops', found, Loops(
                self.equations.places, rows, free, least=LEAST_INERTIA, limit=LARGEST_STEP),
            far if target is None else far._replace(target=target), 1e-3 * CLOSED, most)
        return found

    def closure_errors(self, q):
        """Return how far each joint that closes a loop is open [m, sines of angles], by name."""
        values, _ = self.residual(q)
        count = len(self.equations.places)
        values[:count][self.equations.places > 0] *= self.size
        each = np.split(values[:count], np.cumsum(self.equations.counts)[:-1])
        return {one.name: float(np.hypot(np.linalg.norm(part), beyond)) for one, part, beyond in
                zip(self.mechanism.closures, each, values[count:])}

    def rank(self, q):
        """Return the largest rank of the equations at a closed position and around it."""
        return self.nv - Assembler(self.mechanism, self.equations).degrees_of_freedom(q)

    def idle(self, q):
        """
        Return the bodies that may turn about themselves while nothing else moves.

        As a rod between two ball joints does, at a position that closes the loops: all points of
        its joints, two at least, stay, and so does what is actuated.
        """
        mechanism = self.mechanism
        motions, poses = self.equations.move(q).free_motions(), body_poses(mechanism, q)
        names = [body.name for body in mechanism.bodies]
        velocity = body_velocities(mechanism, q, motions, names) / self.size
        still = [motions[:, mechanism.coordinates.actuated].T]
        found = []
        for k, body in enumerate(names):
            places = [poses[k, :3], *(world_points(poses[k], place) for place in (
                *(joint.position for joint in mechanism.joints if joint.parent == body),
                *(point for cut in mechanism.cut_joints for of, point in (
                    (cut.body_a, cut.point_a), (cut.body_b, cut.point_b)) if of == body)))]
            if np.ptp(places, axis=0).max() <= CLOSED * self.size:
                continue
            rows = [*still, *((velocity[:, k, :3] + cross(
                velocity[:, k, 3:], place - poses[k, :3])).T for place in places)]
            others = np.delete(velocity, k, axis=1)
            rows.append(others.reshape(len(motions), -1).T)
            if np.linalg.matrix_rank(np.concatenate(rows), tol=STILL) < len(motions):
                found.append(body)
        return found

    def is_closed(self, q):
        """Return whether every loop is closed and every limit respected."""
        return np.abs(self.residual(q)[0]).max(initial=0.0) <= CLOSED

    def openness(self, q):
        """Return the length of the residual."""
        return np.linalg.norm(self.residual(q)[0])


def find_closed(mechanism, size, start, hold=(), limits=None, starts=STARTS_EACH):
    """
    Search a position that closes the loops of a mechanism in space, near a start.

    ``size`` is the mechanism's [m]; ``start``, shape (nq,), has unit quaternions x, y, z, w;
    ``hold``: joints, or freedoms of joints, that stay; ``limits``: least and largest coordinate of
    joints of one degree of freedom; ``starts``: how many others are tried at each distance from
    the first; 0: nothing but the first. Returns the nearest of what was found at the first
    distance where anything was; where nothing was, the least open.
    """
    loops = ClosureProblem(mechanism, size, limits)
    if not starts:
        best = loops.nearest(start, loops.free(mechanism.joint_names, hold))
        how = FROM_THE_START
    else:
        best, ways = np.array(start, dtype=float), {FROM_THE_START: 0.0}
        for joints, closures in _parts(mechanism, limits or {}):
            best, way, amplitude = _search(
                loops.part(joints, closures), best, loops.free(joints, hold), starts)
            ways[way] = amplitude
        how = max(ways, key=ways.get)
    best = loops.unwound(best, start)
    return ClosureResult(best, loops.closure_errors(best), loops.is_closed(best), how)


def _search(loops, start, free, starts):
    """Return where loops that depend on one another close the best, how, and how far that is."""
    best, how, far = loops.nearest(start, free), FROM_THE_START, 0.0
    if not loops.is_closed(best):
        found = _homotopy(loops, start, free)
        if loops.openness(found) < loops.openness(best):
            best, how, far = found, 'closing the gaps little by little', 0.5 * AMPLITUDES[0]
    rng = np.random.default_rng(0)
    for amplitude in AMPLITUDES:
        if loops.is_closed(best):
            break
        found = [loops.nearest(_shaken(loops, start, free, amplitude, rng), free)
                 for _ in range(starts)]
        closed = [q for q in found if loops.is_closed(q)]
        if closed:
            best = min(closed, key=lambda q: np.linalg.norm(q - start))
            how, far = f'from starts up to {amplitude:g} rad away', amplitude
        else:
            best = min([best, *found], key=loops.openness)
    return best, how, far


def _shaken(loops, q, free, amplitude, rng):
    """Return coordinates of which free ones are changed at random."""
    change = np.zeros(loops.nv)
    change[free] = rng.uniform(-amplitude, amplitude, len(free)) * loops.scale[free]
    return loops.moved(q, change)


def never_closed(mechanism, size, q):
    """
    Return the loops that stay open by themselves, whatever the others do, from coordinates q on.

    Each is tried alone, moved by nothing but its own joints, without limits. By joint that closes
    a loop: the least that it is open [m, and sines of angles].
    """
    found, rng, loops = {}, np.random.default_rng(0), ClosureProblem(mechanism, size)
    for cut in mechanism.cut_joints:
        joints = _around(mechanism, cut)
        alone, free, trials = loops.part(joints, (cut,)), loops.free(joints), []
        for number in range(STARTS_ALONE):
            trials.append(alone.nearest(
                _shaken(alone, q, free, np.pi * bool(number), rng), free))
            if alone.is_closed(trials[-1]):
                break
        else:
            found[cut.name] = min(alone.closure_errors(trial)[cut.name] for trial in trials)
    return found


def _around(mechanism, cut):
    """Return the names of the joints of a loop."""
    below = {joint.child: joint for joint in mechanism.joints}
    sides = []
    for body in (cut.body_a, cut.body_b):
        side = set()
        while body != GROUND:
            side.add(below[body].name)
            body = below[body].parent
        sides.append(side)
    return sides[0] ^ sides[1]


def _parts(mechanism, limited):
    """Return joints and closures that share no joints with others: of each part of the loops."""
    held = [(_around(mechanism, cut), [cut]) for cut in mechanism.cut_joints]
    held += [(set(coupling.names), [coupling]) for coupling in mechanism.couplings]
    held += [({name}, []) for name in limited]
    parts = []
    for joints, closures in held:
        for part in [part for part in parts if part[0] & joints]:
            parts.remove(part)
            joints, closures = part[0] | joints, part[1] + closures
        parts.append((joints, closures))
    return parts


def _homotopy(loops, q, free):
    """Return coordinates reached while the gaps of a start are closed in equal parts."""
    first, _ = loops.residual(q)
    for step in range(1, STEPS_OF_HOMOTOPY + 1):
        q = loops.nearest(q, free, (1.0 - step / STEPS_OF_HOMOTOPY) * first,
                          MOST_ITERATIONS if step == STEPS_OF_HOMOTOPY else FEW_ITERATIONS)
    return q
