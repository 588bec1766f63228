# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Poses of a platform on a grid, reached from one another without leaving a branch.

The platform's point is driven along the axes of the world, and its orientation, where the
mechanism has as many degrees of freedom, by coordinates of further points of the same body, which
lie along the axes in the orientation that is held: engine/driven.cpp goes from node to node.
"""

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
import itertools
import math
import os
from queue import SimpleQueue
from typing import NamedTuple

import numpy as np

from .assembly import Assembler
from .driven import BranchEndError, DrivenKinematics
from .geometry import Geometry
from .modeling import extent
from .second_order import scene_as_it_moves
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import DrivingConstraint, GROUND, Point
from ..mechanism.rotations import (
    about, angle_of, angles_of as rpy_of, of_angles, quaternion_of, rotation_vector)

# Parts of the grid along each axis that are computed side by side: at most so many, of so many
# nodes or more.
PARTS, PART_NODES = 8, 20
# The longest turn between two orientations of which one leads to the other [rad].
TURN = math.radians(10.0)
# Nodes that are tried first, from the scene's start; nodes that lead to the next orientation.
NEAREST, LEADING = 60, 24
# Nodes along each axis of the grids on the way to another orientation.
COARSE = 25
# Nodes that are tried from random starts, where no neighbour leads to, and starts of each.
RANDOM_NODES, RANDOM_STARTS = 120, 2
# Orientations that differ less are the same [rad].
SAME_TURN = 1e-6


class Axis(NamedTuple):
    """One axis of a grid."""

    name: str  # ``'x'``, ``'y'`` or ``'z'``
    #: Shape (n,): Of the point's coordinate, evenly spaced; one where it is held [m].
    values: np.ndarray


class Platform:
    """
    A point of a body, and its orientation, to be driven from a scene's start.

    ``start``, shape (nq,): that start, assembled; ``place`` of the point there [m]; ``turned``:
    whether the orientation is driven, too; ``orientation`` of the body in the world there, shape
    (2, 2) or (3, 3); ``actuated``: places of the actuated coordinates among the rates.
    AssemblyError; ValueError for unknown points, and mechanisms whose degrees of freedom are not
    those of a point or a body.
    """

    def __init__(self, scene, point):
        mechanism = scene_as_it_moves(scene).mechanism
        names = [one.name for one in mechanism.points if one.body != GROUND]
        if point not in names:
            raise ValueError(f'point: expected a named point of a body that moves '
                             f'({", ".join(names) or "none"}), got {point!r}')
        if mechanism.motions:
            raise ValueError('expected a scene that prescribes no motions, got '
                             + ', '.join(one.name for one in mechanism.motions))
        self.mechanism, self.point = mechanism, mechanism.point(point)
        geometry = self._geometry = Geometry(mechanism)
        assembler = Assembler(mechanism, geometry.equations)
        self.start = assembler.positions(scene.initial.position, scene.initial.hold)
        self.axes = 2 if mechanism.planar else 3
        freedoms = assembler.degrees_of_freedom(self.start)
        whole = 3 if mechanism.planar else 6
        if freedoms not in (self.axes, whole):
            raise ValueError(
                f'expected {self.axes} degrees of freedom, of a point, or {whole}, of a body, '
                f'got a mechanism of {freedoms}')
        self.turned = freedoms == whole
        self.orientation = self.orientation_at(self.start)
        self.place = geometry.point(self.start, self.point.body, np.array(self.point.position))
        coordinates = mechanism.coordinates
        self.actuated = np.array(coordinates.actuated, dtype=np.int64)
        self.size = extent(mechanism)
        #: What turns are compared with displacements by: mean distance of the body's joints [m].
        self.arm = self._arm()

    def orientation_at(self, position):
        """Return the body's orientation in a position, shape (2, 2) or (3, 3)."""
        origin = self._geometry.point(position, self.point.body, np.zeros(self.axes))
        return np.stack([self._geometry.point(position, self.point.body, one) - origin
                         for one in np.eye(self.axes)], axis=1)

    def _arm(self):
        here = np.array(self.point.position)
        places = [np.zeros(self.axes)]
        places += [np.array(joint.position) for joint in self.mechanism.joints
                   if joint.parent == self.point.body]
        places += [np.array(place) for cut in self.mechanism.cut_joints for body, place in (
            (cut.body_a, cut.point_a), (cut.body_b, cut.point_b)) if body == self.point.body]
        found = float(np.mean([np.linalg.norm(place - here) for place in places]))
        return found if found > 1e-6 * self.size else self.size

    def driven(self, orientation):
        """Return the mechanism with the point, and the orientation, driven."""
        body, here = self.point.body, np.array(self.point.position)
        names = {point.name for point in self.mechanism.points}
        points, drives = [], [(self.point.name, axis) for axis in range(self.axes)]
        if self.turned:
            for axis, others in ((0, (1,)),) if self.axes == 2 else ((0, (1, 2)), (1, (2,))):
                name = f'{self.point.name}_{"xyz"[axis]}'
                while name in names:
                    name += '_'
                away = self.arm * orientation[axis]
                points.append(Point(name, body, tuple((here + away).tolist())))
                drives += [(name, other) for other in others]
        motions = tuple(
            DrivingConstraint(f'drive {name} {axis}', point=name, direction=tuple(
                float(axis == other) for other in range(self.axes)))
            for name, axis in drives)
        return replace(self.mechanism, points=(*self.mechanism.points, *points), motions=motions)

    def values(self, places):
        """Return the driven values of places of the point, shape (n, m) [m]."""
        if not self.turned:
            return places.copy()
        return places[:, [0, 1, 1] if self.axes == 2 else [0, 1, 2, 1, 2, 2]]

    @property
    def twist(self):
        """
        Return driven rates by velocity and, behind it, spin in the world, shape (m, m).

        Spins are multiplied by the arm: all of it is without unit.
        """
        if not self.turned:
            return np.eye(self.axes)
        if self.axes == 2:
            return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
        found = np.zeros((6, 6))
        found[range(6), [0, 1, 2, 1, 2, 2]] = 1.0
        found[[3, 4, 5], [5, 4, 3]] = 1.0, -1.0, 1.0
        return found


class PoseGrid:
    """
    The nodes of a grid that are reached in one orientation of a platform.

    ``axes``: one for each axis of the world, in their order; ``orientation`` of the body in the
    world, shape (2, 2) or (3, 3), that of the start when None, unused where it is not driven;
    ``workers``: threads, as many as there are processors when None.

    ``mechanism`` has its driving equations; ``shape``: nodes along each axis; ``places``, shape
    (n, 2) or (n, 3), of the point in all nodes, the last axis changing first [m]; ``reached``,
    (n,): whether a node was reached; ``position``, (n, nq), joint coordinates where it was;
    ``rates``, (n, number of actuated, m): derivatives of the actuated coordinates by the driven
    values.
    """

    def __init__(self, platform, axes, orientation=None, workers=None):
        self.platform, self.axes = platform, tuple(axes)
        self.orientation = platform.orientation if orientation is None else orientation
        self.shape = tuple(len(axis.values) for axis in self.axes)
        self.places = np.stack(np.meshgrid(
            *(axis.values for axis in self.axes), indexing='ij'), -1).reshape(-1, len(self.axes))
        self._values = np.ascontiguousarray(platform.values(self.places))
        count, drives = self._values.shape
        self.reached = np.zeros(count, dtype=np.int64)
        self.position = np.zeros((count, len(platform.start)))
        self.rates = np.zeros((count, len(platform.actuated), drives))
        self.mechanism = platform.driven(self.orientation)
        self._workers = workers or os.cpu_count() or 1
        self._threads = []

    def start_from(self, position, most=NEAREST):
        """
        Move from any closed position to the nearest node, without leaving a branch.

        ``most`` of the nearest nodes are tried. Returns whether a node was reached, now or before.
        BranchEndError where the position is singular.
        """
        kinematics = self._kinematics_at(position)
        here = kinematics.values[:len(self.axes)]
        order = np.argsort(np.linalg.norm(self.places - here, axis=1), kind='stable')
        for node in order[:most].tolist():
            if self.reached[node]:
                return True
            kinematics.start_at(position)
            try:
                self._take(node, kinematics.go_to(self._values[node]))
            except BranchEndError:
                continue
            return True
        return False

    def lead_from(self, positions):
        """
        Begin at positions of ``leading`` of a grid in a near orientation.

        Returns whether a node was reached.
        """
        for position in positions:
            with suppress(BranchEndError):
                self.start_from(position, 1)
        return bool(self.reached.any())

    @property
    def leading(self):
        """Return positions spread over the reached nodes, shape (LEADING or fewer, nq)."""
        nodes = np.flatnonzero(self.reached)
        if not len(nodes):
            return self.position[:0]
        return self.position[nodes[np.unique(
            np.linspace(0, len(nodes) - 1, LEADING).astype(int))]]

    def _kinematics_at(self, position):
        """Return kinematics that begin at a position; a new one where none could be built."""
        if not self._threads:
            self._threads.append(DrivenKinematics(self.mechanism, position))
        self._threads[0].start_at(position)
        return self._threads[0]

    def go_on(self, reached, position, rates):
        """Adopt nodes that were reached before, given as the attributes of the same names."""
        self.reached[:], self.position[:], self.rates[:] = reached, position, rates
        self._kinematics_at(self.position[np.flatnonzero(self.reached)[0]])

    def _take(self, node, position):
        self.reached[node], self.position[node] = 1, position
        self.rates[node] = self._threads[0].rates_at(position, self.platform.actuated)

    def spread(self, keep_going=lambda: True, show=lambda count: None):
        """
        Reach all nodes that neighbours lead to; return whether the search came to its end.

        ``keep_going``, called between parts, ends the search where it returns False, and the poses
        reached are kept; ``show`` is called with the number of nodes reached.
        """
        known, parts = np.zeros(len(self.reached), dtype=bool), self._parts()
        across = False
        free = self._engines()
        with ThreadPoolExecutor(self._workers) as pool:
            while True:
                fresh = np.flatnonzero(self.reached.astype(bool) & ~known)
                known[fresh] = True
                # Within a part, neighbours of what was reached in it have been tried.
                seeds = self._seeds(fresh, parts, across)
                across = True
                show(int(known.sum()))
                if not seeds:
                    return True
                if not keep_going():
                    return False
                list(pool.map(lambda one: self._part(free, *one), seeds))

    def _engines(self):
        """Return a queue of kinematics, one for each thread."""
        free = SimpleQueue()
        position = self.position[np.flatnonzero(self.reached)[0]]
        while len(self._threads) < self._workers:
            self._threads.append(DrivenKinematics(self.mechanism, position))
        for one in self._threads:
            free.put(one)
        return free

    def _parts(self):
        """Return the number of the part that each node is in, and the parts' first and last."""
        counts = [min(max(count // PART_NODES, 1), PARTS) for count in self.shape]
        edges = [np.linspace(0, count, parts + 1).astype(int)
                 for count, parts in zip(self.shape, counts)]
        number = np.zeros(self.shape, dtype=np.int64)
        boxes = []
        for k, sides in enumerate(itertools.product(*(
                zip(edge[:-1], edge[1:]) for edge in edges))):
            number[tuple(slice(*side) for side in sides)] = k
            boxes.append(np.array(sides, dtype=np.int64).T)
        return number.reshape(-1), boxes

    def _seeds(self, fresh, parts, across):
        """Return pairs of a part and the nodes next to nodes of it that are not reached."""
        number, boxes = parts
        places = np.array(np.unravel_index(fresh, self.shape))
        found = {}
        for step in itertools.product((-1, 0, 1), repeat=len(self.shape)):
            there = places + np.array(step)[:, np.newaxis]
            inside = ((there >= 0) & (there < np.array(self.shape)[:, np.newaxis])).all(axis=0)
            nodes = np.ravel_multi_index(there[:, inside], self.shape)
            left = self.reached[nodes] == 0
            if across:
                left &= number[nodes] != number[fresh[inside]]
            for part in np.unique(number[nodes[left]]).tolist():
                found.setdefault(part, []).append(
                    fresh[inside][left][number[nodes[left]] == part])
        return [(boxes[part], np.unique(np.concatenate(seeds)))
                for part, seeds in sorted(found.items())]

    def _part(self, free, box, seeds):
        kinematics = free.get()
        try:
            kinematics.reach(
                np.array([self.shape, *box], dtype=np.int64), seeds, self._values,
                self.platform.actuated, self.reached, self.position,
                self.rates.reshape(len(self.reached), -1))
        finally:
            free.put(kinematics)

    def search_elsewhere(self, keep_going=lambda: True, show=lambda count: None):
        """
        Search from random starts for parts that are not connected with the reached ones.

        One node at least must have been reached; arguments and result are those of ``spread``.
        """
        left = np.flatnonzero(self.reached == 0)
        if not len(left):
            return True
        rng = np.random.default_rng(0)
        chosen = left[np.unique(np.linspace(0, len(left) - 1, RANDOM_NODES).astype(int))]
        coordinates, kinematics = self.platform.mechanism.coordinates, self._threads[0]
        for node in chosen.tolist():
            for _ in range(RANDOM_STARTS):
                if self.reached[node]:
                    break
                if not keep_going():
                    return False
                change = np.pi * kinematics.unit * rng.uniform(-1.0, 1.0, len(kinematics.unit))
                found = kinematics.closed_from(
                    self._values[node], coordinates.moved(self.platform.start, change))
                # A mirrored orientation gives the points that hold it the same coordinates.
                if found is None or self.platform.turned and turn_between(
                        self.platform.orientation_at(found), self.orientation) > SAME_TURN:
                    continue
                try:
                    kinematics.start_at(found)
                    self._take(node, kinematics.go_to(self._values[node]))
                except (BranchEndError, np.linalg.LinAlgError):
                    continue
                if not self.spread(keep_going, show):
                    return False
        return True


def orientation_of(angles):
    """
    Return the orientation of a body, shape (2, 2) or (3, 3), by its angles [rad].

    One in the plane; in space those about the x, y and z axes of the world, one after the other.
    """
    return of_angles(angles) if len(angles) == 3 else about((0.0, 0.0, 1.0), angles[0])[:2, :2]


def angles_of(orientation):
    """Return the angles of an orientation, as ``orientation_of`` takes them."""
    return rpy_of(orientation) if len(orientation) == 3 else (angle_of(orientation),)


def turn_between(one, other):
    """Return the angle between two orientations [rad]."""
    left = one.T @ other
    return abs(angle_of(left)) if len(left) == 2 else float(np.linalg.norm(
        rotation_vector(np.array(quaternion_of(left)))))


def begun(platform, axes, angles=None, workers=None):
    """
    Return a grid in an orientation, of which one node at least is reached from the scene's start.

    The way there leads through orientations in between, on a coarse grid in each, so that the
    point may move where it must. ``axes`` are those of the world, in their order; ``angles`` as
    for ``orientation_of``, those of the start when not given; ``workers`` as for ``PoseGrid``.
    BranchEndError where the start is singular, AssemblyError where no node is reached.
    """
    wanted = platform.orientation if angles is None or not platform.turned else orientation_of(
        angles)
    grid = PoseGrid(platform, axes, wanted, workers)
    if turn_between(platform.orientation, wanted) < SAME_TURN:
        if not grid.start_from(platform.start):
            raise AssemblyError(
                f'No node of the grid is reached from the start of the scene, '
                f'{platform.point.name} at {_listed(platform.place)} m: expected a grid around '
                'it')
        return grid
    begin = np.array(angles_of(platform.orientation))
    change = (np.array(angles) - begin + math.pi) % (2.0 * math.pi) - math.pi
    # The other way round, too, in the plane.
    ways = [change, change - 2.0 * math.pi * np.sign(change)] if len(change) == 1 else [change]
    coarse = [Axis(name, values if len(values) <= COARSE else np.linspace(
        values[0], values[-1], COARSE)) for name, values in axes]
    for way in ways:
        before = PoseGrid(platform, coarse, None, workers)
        if not before.start_from(platform.start):
            continue
        steps = max(1, math.ceil(np.abs(way).max() / TURN))
        for k in range(1, steps + 1):
            before.spread()
            after = grid if k == steps else PoseGrid(
                platform, coarse, orientation_of(begin + way * (k / steps)), workers)
            if not after.lead_from(before.leading):
                break
            before = after
        else:
            return grid
    degrees = ', '.join(f'{math.degrees(angle):.6g}' for angle in angles)
    raise AssemblyError(f'The orientation {degrees} deg is not reached from the start of the '
                        f'scene, {_listed(np.degrees(begin))} deg, with {platform.point.name} '
                        'anywhere on the grid.')


def _listed(numbers):
    return ', '.join(f'{number:.6g}' for number in numbers)
