# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Maps of a platform's workspace: reach, conditioning and singular curves."""

from collections.abc import Callable
from dataclasses import dataclass, field
import hashlib
import json
import math
import os
from pathlib import Path
import time
from typing import Dict, Mapping, Optional, Tuple

import numpy as np

from .quantities import Quantity
from ..kinematics.driven import DrivenKinematics
from ..kinematics.pose_grid import (
    angles_of, Axis, begun, LEADING, orientation_of, Platform, PoseGrid, TURN, turn_between)
from ..kinematics.singular_curves import all_curves, SingularCurves, TYPE_1, TYPE_2
from ..mechanism.errors import AssemblyError
from ..mechanism.kinematics import body_poses, pose_of, world_points
from ..mechanism.mechanism import GROUND
from ..scene.text import scene_text

FREE, REACHED, AT_LIMIT, COLLIDES = range(4)
MEANINGS = ('not reached', 'reached', 'beyond a limit of a joint', 'links too near')
QUANTITIES = {one.name: one for one in (
    Quantity('condition', '1', None, 'condition number of the Jacobian; turns times the arm'),
    Quantity('force', 'N', None,
             'largest force in every direction that the actuated joints can hold'),
    Quantity('stiffness', 'N/m', None,
             'least stiffness of the point, the body being free to turn'))}
# Nodes along each axis, of a grid that is not given; of the grid that finds its range.
PLANAR_NODES, SPATIAL_NODES, SEARCH_NODES = 200, 40, 33
# Most nodes of a grid; largest angle, beyond which its digits are lost [rad].
MOST_NODES, MOST_TURNED = 100_000_000, 1e6
# Margin around the reachable range, in steps of the grid that finds it.
ROOM = 1.5
# Period of saving an unfinished map [s].
SAVE_EVERY = 30.0
# Nodes whose quantities are computed at once.
CHUNK = 20000
FORMAT = 1


class WorkspaceFileError(ValueError):
    """A file that is not a map, or that of another one."""


@dataclass(frozen=True)
class Request:
    """The settings of a workspace map."""

    point: str  # Of the platform
    #: First, last and number of the point's coordinates by ``'x'``, ``'y'``, ``'z'`` [m]; of those
    #: not given, what is reached is looked for.
    axes: Dict[str, Tuple[float, float, int]] = field(default_factory=dict)
    #: Angles of the held orientation [rad]: one in the plane, in space about x, y and z of the
    #: world, one after the other. That of the scene's start when None.
    angles: Optional[Tuple[float, ...]] = None
    #: Orientations instead: first, last and number of the angles by axis.
    turns: Dict[str, Tuple[float, float, int]] = field(default_factory=dict)
    #: ``torque_limit``, ``stiffness``: Of actuated joints [N m or N], [N m/rad or N/m]; 1 where
    #: not given.
    torque_limit: Dict[str, float] = field(default_factory=dict)
    stiffness: Dict[str, float] = field(default_factory=dict)
    #: Ranges of joint coordinates [rad or m].
    limits: Dict[str, Tuple[float, float]] = field(default_factory=dict)
    #: Least distance of links that no joint joins, each a segment between its joints [m].
    clearance: Optional[float] = None


@dataclass
class WorkspaceMap:
    """A map."""

    request: Request
    axes: Tuple[Axis, ...]
    angles: np.ndarray  # Shape (number of orientations, 1 or 3): [rad]
    #: Int, shape of the grid: A place in ``MEANINGS``; of several orientations, ``REACHED`` where
    #: one is.
    status: np.ndarray
    #: Int, shape of the grid: In how many of the orientations it is reached, within limits and
    #: without collisions.
    count: np.ndarray
    missed: Tuple[int, ...] = ()  # Orientations that no way leads to: they count as not reached
    #: Shape of the grid: NaN where it is not reached; of a single orientation.
    quantities: Mapping[str, np.ndarray] = field(default_factory=dict)
    #: Where two axes have several values, of a single orientation (tuple of
    #: singular_curves.SingularCurve).
    curves: Tuple = ()
    #: Shape (*shape of the grid, nq), or None: Joint coordinates, of a single orientation.
    position: Optional[np.ndarray] = None
    notes: Tuple[str, ...] = ()  # Omissions, and their reasons
    finished: bool = True
    #: Whether the orientation is held: that of a platform, not of a point alone.
    turned: bool = True

    @property
    def node_size(self) -> float:
        """Return the length, area or volume of a node [m, m^2 or m^3]."""
        return math.prod(float(axis.values[1] - axis.values[0]) for axis in self.axes
                         if len(axis.values) > 1)

    @property
    def dexterous(self) -> np.ndarray:
        """Return where all orientations are reached, shape of the grid."""
        return self.count == len(self.angles)


def compute(scene, request: Request, workers: Optional[int] = None,
            file: Optional[Path] = None, resume: bool = False,
            show: Callable[[int, int], None] = lambda done, total: None,
            keep_going: Callable[[], bool] = lambda: True) -> WorkspaceMap:
    """
    Map the workspace of a platform from a scene's start.

    Parameters
    ----------
    scene : scene_records.Scene
        Of as many degrees of freedom as a point or a body has, without prescribed motions.
    request : Request
        The quantities of the map.
    workers : int, optional
        Threads; as many as there are processors when not given.
    file : pathlib.Path, optional
        Of the map; written every half a minute, and at the end.
    resume : bool
        Whether to go on with that file, where there is one.
    show : callable
        Called with the numbers of nodes done and of all nodes.
    keep_going : callable
        Called between parts; False ends the map, which is written and returned as it is.

    Raises
    ------
    AssemblyError, simulation.driven.BranchEndError
        Where the scene's start, or the grid from there, is not reached.
    ValueError
        For unknown names, and impossible numbers.
    WorkspaceFileError

    """
    platform = Platform(scene, request.point)
    _check(scene, platform, request)
    identity = hashlib.sha256(json.dumps(
        [scene_text(scene), repr(request)]).encode()).hexdigest()
    state = None
    if resume and file is not None and file.exists():
        state = _State.read(file, identity)
    if state is None:
        axes = _axes(platform, request, workers)
        angles = _orientations(platform, request)
        state = _State.begun(axes, angles, len(platform.start), len(platform.actuated),
                             len(platform.twist))
    saved = [time.monotonic()]

    def keeps_on():
        if file is not None and time.monotonic() - saved[0] > SAVE_EVERY:
            state.write(file, identity, scene, request)
            saved[0] = time.monotonic()
        return keep_going()

    finished = _reach_all(platform, state, request, workers, show, keeps_on)
    found = _result(scene, platform, state, request, finished)
    if file is not None:
        state.write(file, identity, scene, request, found)
    return found


class _State:
    """State of a map in progress: enough to continue."""

    def __init__(self, axes, angles):
        self.axes, self.angles = axes, angles
        self.shape = tuple(len(axis.values) for axis in axes)

    @classmethod
    def begun(cls, axes, angles, coordinates, actuated, drives):
        """Return the state before anything is done."""
        self = cls(axes, angles)
        nodes, count = math.prod(self.shape), len(angles)
        # 0: not begun, 1: done, 2: no way leads there.
        self.done = np.zeros(count, dtype=np.int32)
        self.leading = np.full((count, LEADING, coordinates), np.nan)
        self.count = np.zeros(nodes, dtype=np.int32)
        self.any_status = np.zeros(nodes, dtype=np.int32)
        single = nodes if count == 1 else 0
        self.reached = np.zeros(single, dtype=np.int32)
        self.position = np.zeros((single, coordinates))
        self.rates = np.zeros((single, actuated, drives))
        return self

    ARRAYS = {'orientation_done': ('done', ('orientation',)),
              'leading_position': ('leading', ('orientation', 'leading', 'coordinate')),
              'count': ('count', ('node',)), 'status': ('any_status', ('node',)),
              'reached': ('reached', ('single',)),
              'position': ('position', ('single', 'coordinate')),
              'joint_rates': ('rates', ('single', 'actuated', 'drive'))}

    def write(self, file, identity, scene, request, found=None):
        """Write a NetCDF file, whole or not at all."""
        from scipy.io import netcdf_file
        partial = file.with_name(f'.{file.name}.part')
        with netcdf_file(partial, 'w', version=2) as out:
            out.title = f'workspace of {request.point} of {scene.name}'
            out.format, out.identity = FORMAT, identity
            out.finished = int(found is not None and found.finished)
            out.scene = scene_text(scene)
            out.status_meanings = ', '.join(
                f'{number}: {text}' for number, text in enumerate(MEANINGS))
            for axis in self.axes:
                out.createDimension(axis.name, len(axis.values))
                one = out.createVariable(axis.name, 'd', (axis.name,))
                one[:], one.units = axis.values, 'm'
            grid = tuple(axis.name for axis in self.axes)
            sizes = {'orientation': len(self.angles), 'angle': self.angles.shape[1]}
            kept = {name: (getattr(self, key), dimensions)
                    for name, (key, dimensions) in self.ARRAYS.items()
                    if len(self.angles) == 1 or 'single' not in dimensions}
            for values, dimensions in kept.values():
                sizes.update(zip(dimensions, values.shape))
            for name, (values, dimensions) in kept.items():
                shape = tuple(n for d in dimensions for n in (
                    grid if d in ('node', 'single') else (d,)))
                _variable(out, name, values, shape, sizes)
            _variable(out, 'orientation', self.angles, ('orientation', 'angle'), sizes)
            out.variables['orientation'].units = 'rad'
            for name, values in ({} if found is None else found.quantities).items():
                _variable(out, name, values, grid, sizes)
                out.variables[name].units = QUANTITIES[name].unit
                out.variables[name].long_name = QUANTITIES[name].meaning
            for k, curve in enumerate(() if found is None else found.curves):
                points = {f'curve_{k}_points': len(curve.places), 'curve_axis': 2}
                _variable(out, f'curve_{k}', curve.places, tuple(points), points)
                out.variables[f'curve_{k}'].units = 'm'
                out.variables[f'curve_{k}'].long_name = f'{curve.kind} singularities'
        os.replace(partial, file)

    @classmethod
    def read(cls, file, identity):
        from scipy.io import netcdf_file
        try:
            with netcdf_file(file, 'r', mmap=False) as found:
                if getattr(found, 'format', None) != FORMAT or found.identity.decode() != identity:
                    raise WorkspaceFileError(
                        f'{file}: expected the map of the same scene, grid and options, got that '
                        'of others; name another file, or begin again with --overwrite')
                variables = {name: np.array(each.data)
                             for name, each in found.variables.items()}
                order = [name for name in found.variables if name in ('x', 'y', 'z')]
        except (OSError, TypeError, ValueError, AttributeError, KeyError) as error:
            if isinstance(error, WorkspaceFileError):
                raise
            raise WorkspaceFileError(f'{file}: expected a map of an earlier run, got a file that '
                                     f'cannot be read ({error})') from None
        variables = {name: values.astype(values.dtype.newbyteorder('='))
                     for name, values in variables.items()}
        self = cls(tuple(Axis(name, variables[name]) for name in order),
                   variables['orientation'])
        nodes = math.prod(self.shape)
        for name, (key, dimensions) in cls.ARRAYS.items():
            if name not in variables:
                setattr(self, key, np.zeros((0, 0, 0)[:len(dimensions)]))
                continue
            values = variables[name]
            flat = 'node' in dimensions or 'single' in dimensions
            setattr(self, key, values.reshape(nodes, *values.shape[len(self.shape):])
                    if flat else values)
        return self


def _variable(out, name, values, dimensions, sizes):
    """Write an array, with the dimensions that it is the first to have."""
    for dimension in dimensions:
        if dimension not in out.dimensions:
            out.createDimension(dimension, sizes[dimension])
    one = out.createVariable(name, 'd' if values.dtype.kind == 'f' else 'i', dimensions)
    one[:] = values.reshape(tuple(out.dimensions[dimension] for dimension in dimensions))


def _check(scene, platform, request):
    """Refuse names that the platform does not have."""
    names = 'xyz'[:platform.axes]
    for axis, (first, last, count) in request.axes.items():
        if axis not in names:
            raise ValueError(f'grid: expected axes {", ".join(names)}, got {axis!r}')
        if not (count == 1 and first == last or count > 1 and first < last):
            raise ValueError(f'grid: {axis}: expected FROM below TO, got {first:g} and {last:g}')
    turning = ('z',) if platform.axes == 2 else ('x', 'y', 'z')
    if (request.angles is not None or request.turns) and not platform.turned:
        raise ValueError('orientation: expected none, as the degrees of freedom are those of a '
                         'point, whose body turns as it must')
    if request.angles is not None and request.turns:
        raise ValueError('orientation: expected one that is held, or several, got both')
    if request.angles is not None and len(request.angles) != len(turning):
        raise ValueError(f'orientation: expected {len(turning)} angles, got '
                         f'{len(request.angles)}')
    for axis in request.turns:
        if axis not in turning:
            raise ValueError(f'turn: expected axes {", ".join(turning)}, got {axis!r}')
    actuated = scene.mechanism.actuated_joints
    nodes = math.prod(count for _, _, count in request.axes.values())
    if nodes > MOST_NODES:
        raise ValueError(f'grid: expected at most {MOST_NODES} nodes, got {nodes}')
    for angle in request.angles or ():
        if not abs(angle) <= MOST_TURNED:
            raise ValueError(f'orientation: expected angles up to {MOST_TURNED:g} rad, got '
                             f'{angle:g}')
    for what, given in (('torque_limit', request.torque_limit), ('stiffness', request.stiffness)):
        for name, value in given.items():
            if not 0.0 < value < math.inf:
                raise ValueError(f'{what}: {name}: expected a finite number > 0, got {value:g}')
            if name not in actuated:
                raise ValueError(f'{what}: expected actuated joints ({", ".join(actuated)}), got '
                                 f'{name!r}')
    single = [scene.mechanism.coordinates.names[k]
              for k in scene.mechanism.coordinates.single]
    for name, (low, high) in request.limits.items():
        if name not in single:
            raise ValueError(f'limit: expected joints ({", ".join(single)}), got {name!r}')
        if not low < high:
            raise ValueError(f'limit: {name}: expected LOW below HIGH, got {low:g} and {high:g}')


def _orientations(platform, request):
    """Return the angles of all orientations, shape (n, 1 or 3), nearest to the start first."""
    start = angles_of(platform.orientation)
    if not request.turns:
        return np.array([request.angles or start])
    names = 'z' if platform.axes == 2 else 'xyz'
    sides = [np.linspace(*request.turns[name]) if name in request.turns else np.array([held])
             for name, held in zip(names, start)]
    found = np.stack(np.meshgrid(*sides, indexing='ij'), -1).reshape(-1, len(names))
    away = [turn_between(platform.orientation, orientation_of(one)) for one in found]
    return found[np.argsort(away, kind='stable')]


def _axes(platform, request, workers):
    """Return the axes of the grid, with ranges that are found where they are not given."""
    count = PLANAR_NODES if platform.axes == 2 else SPATIAL_NODES
    names = 'xyz'[:platform.axes]
    given = {name: np.linspace(*request.axes[name]) for name in request.axes}
    if len(given) < len(names):
        # In all orientations, as far as they are few enough to be looked at.
        first, reach = None, 2.0 * platform.size
        wide = [Axis(name, given[name] if name in given else np.linspace(
            place - reach, place + reach, SEARCH_NODES))
            for name, place in zip(names, platform.place)]
        for _ in range(2):
            angles = None if request.turns else request.angles
            grid = begun(platform, wide, angles, workers)
            grid.spread()
            places = grid.places[grid.reached > 0]
            first = {}
            for axis, low, high in zip(wide, places.min(0), places.max(0)):
                if axis.name not in given:
                    step = axis.values[1] - axis.values[0]
                    # Turned about the start's orientation, the point may reach farther.
                    room = ROOM * step + (2.0 * platform.arm if request.turns else 0.0)
                    first[axis.name] = low - room, high + room
            wide = [axis if axis.name in given else Axis(
                axis.name, np.linspace(*first[axis.name], SEARCH_NODES)) for axis in wide]
        given.update({name: np.linspace(*ends, count) for name, ends in first.items()})
    return tuple(Axis(name, given[name]) for name in names)


def _reach_all(platform, state, request, workers, show, keep_going):
    """Reach nodes in all orientations; return whether that is finished."""
    total = len(state.angles) * math.prod(state.shape)
    orientations = [orientation_of(one) for one in state.angles]
    for k, angles in enumerate(state.angles):
        nodes = math.prod(state.shape)

        def done(count, before=k * nodes):
            show(before + count, total)

        if state.done[k]:
            continue
        grid = PoseGrid(platform, state.axes, orientations[k], workers)
        if len(state.reached) and state.reached.any():
            grid.go_on(state.reached, state.position, state.rates)
        else:
            near = [n for n in np.flatnonzero(state.done == 1).tolist()
                    if turn_between(orientations[n], orientations[k]) <= 1.01 * TURN]
            near.sort(key=lambda n: turn_between(orientations[n], orientations[k]))
            for n in near[:2]:
                leading = state.leading[n]
                if grid.lead_from(leading[np.isfinite(leading[:, 0])]):
                    break
            else:
                try:
                    grid = begun(platform, state.axes, angles, workers)
                except AssemblyError:
                    if len(state.angles) == 1:
                        raise
                    state.done[k] = 2
                    continue
        finished = grid.spread(keep_going, done) and grid.search_elsewhere(keep_going, done)
        if len(state.reached):
            state.reached[:] = grid.reached
            state.position[:], state.rates[:] = grid.position, grid.rates
        if not finished:
            return False
        status = _status(platform, grid.reached, grid.position, request)
        state.count += status == REACHED
        state.any_status = np.where(
            (state.any_status == REACHED) | (status == FREE), state.any_status,
            status).astype(np.int32)
        leading = grid.leading
        state.leading[k, :len(leading)] = leading
        state.done[k] = 1
        if not keep_going() and k + 1 < len(state.angles):
            return False
    return True


def _status(platform, reached, position, request):
    """Return a place in MEANINGS for all nodes."""
    status = np.where(reached > 0, REACHED, FREE)
    nodes = np.flatnonzero(reached)
    coordinates = platform.mechanism.coordinates
    for name, (low, high) in request.limits.items():
        k = coordinates.names.index(name)
        values = position[nodes, coordinates.place[coordinates.index[name]]]
        if not coordinates.lengths[k]:
            # The turn that is nearest to the middle of both limits.
            middle = 0.5 * (low + high)
            values = middle + (values - middle + math.pi) % (2.0 * math.pi) - math.pi
        status[nodes[(values < low) | (values > high)]] = AT_LIMIT
    if request.clearance is not None:
        for first in range(0, len(nodes), CHUNK):
            part = nodes[first:first + CHUNK]
            near = least_distance(platform.mechanism, position[part]) < request.clearance
            status[part[near & (status[part] == REACHED)]] = COLLIDES
    return status


def links(mechanism):
    """Return the segments between the joints of each moving body, by its name, (n, 2, axes)."""
    places = {body.name: [] for body in mechanism.bodies}
    for joint in mechanism.joints:
        places[joint.child].append(np.zeros(len(joint.position)))
        if joint.parent != GROUND:
            places[joint.parent].append(np.array(joint.position))
    for cut in mechanism.cut_joints:
        for body, place in ((cut.body_a, cut.point_a), (cut.body_b, cut.point_b)):
            if body != GROUND:
                places[body].append(np.array(place))
    found = {}
    for body, each in places.items():
        pairs = [(a, b) for k, a in enumerate(each) for b in each[k + 1:]
                 if np.linalg.norm(a - b) > 0.0]
        if pairs:
            found[body] = np.array(pairs)
    return found


def least_distance(mechanism, position):
    """Return the least distance between links that no joint joins, shape (n,) [m]."""
    joined = {frozenset((joint.parent, joint.child)) for joint in mechanism.joints}
    joined |= {frozenset((cut.body_a, cut.body_b)) for cut in mechanism.cut_joints}
    poses = body_poses(mechanism, position)
    segments = {body: np.stack([np.stack([
        world_points(pose_of(mechanism, poses, body), end) for end in pair], axis=1)
        for pair in pairs], axis=1) for body, pairs in links(mechanism).items()}
    least = np.full(len(position), np.inf)
    names = list(segments)
    for k, one in enumerate(names):
        for other in names[k + 1:]:
            if frozenset((one, other)) in joined:
                continue
            for a in range(segments[one].shape[1]):
                for b in range(segments[other].shape[1]):
                    least = np.minimum(least, _between(
                        segments[one][:, a], segments[other][:, b]))
    return least


def _between(one, other):
    """Return the distances of segments, shape (n,), each of shape (n, 2, axes)."""
    start, along = one[:, 0], one[:, 1] - one[:, 0]
    begin, way = other[:, 0], other[:, 1] - other[:, 0]
    apart = start - begin
    aa, bb, ab = (np.einsum('nk,nk->n', u, v) for u, v in (
        (along, along), (way, way), (along, way)))
    ad, bd = (np.einsum('nk,nk->n', u, apart) for u in (along, way))
    found = []
    # The nearest points of both lines, where inside; otherwise an end of one of them is nearest.
    across = aa * bb - ab * ab
    with np.errstate(divide='ignore', invalid='ignore'):
        s, t = (ab * bd - bb * ad) / across, (aa * bd - ab * ad) / across
    inside = (across > 1e-14 * aa * bb) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    s, t = np.where(inside, s, 0.0), np.where(inside, t, 0.0)
    lines = np.linalg.norm(apart + s[:, np.newaxis] * along - t[:, np.newaxis] * way, axis=1)
    found.append(np.where(inside, lines, np.inf))
    for point, (base, direction, square) in (
            (one[:, 0], (begin, way, bb)), (one[:, 1], (begin, way, bb)),
            (other[:, 0], (start, along, aa)), (other[:, 1], (start, along, aa))):
        share = np.clip(np.einsum('nk,nk->n', point - base, direction) / square, 0.0, 1.0)
        found.append(np.linalg.norm(
            point - base - share[:, np.newaxis] * direction, axis=1))
    return np.min(found, axis=0)


def _result(scene, platform, state, request, finished):
    """Return the map of the nodes reached."""
    notes = []
    missed = tuple(np.flatnonzero(state.done == 2).tolist())
    shape = state.shape
    if len(state.angles) > 1:
        notes.append('condition, force, stiffness and singular curves belong to one orientation')
        return WorkspaceMap(
            request, state.axes, state.angles, state.any_status.reshape(shape),
            state.count.reshape(shape), missed, notes=tuple(notes), finished=finished)
    status = state.any_status if state.done.all() else _status(
        platform, state.reached, state.position, request)
    quantities, curves = {}, ()
    if len(platform.actuated) == len(platform.twist) == len(scene.mechanism.actuated_joints):
        jacobian = state.rates @ platform.twist
        quantities = _quantities(scene, platform, state.reached, jacobian, request)
        quantities = {name: np.where(status == REACHED, values, np.nan).reshape(shape)
                      for name, values in quantities.items()}
        if finished and sum(count > 1 for count in shape) == 2:
            curves = _curves(platform, state, jacobian)
        elif finished:
            notes.append('singular curves belong to a grid along two axes')
    else:
        notes.append(
            'condition, force, stiffness and singular curves: expected as many actuated joints '
            f'of the tree as there are degrees of freedom ({len(platform.twist)}), got '
            f'{", ".join(scene.mechanism.actuated_joints) or "none"}')
    return WorkspaceMap(
        request, state.axes, state.angles, status.reshape(shape),
        (status == REACHED).astype(int).reshape(shape), missed, quantities, curves,
        state.position.reshape(*shape, -1), tuple(notes), finished,
        platform.turned)


def _quantities(scene, platform, reached, jacobian, request):
    """Return condition, force and stiffness of all nodes, by name."""
    names, nodes = scene.mechanism.actuated_joints, np.flatnonzero(reached)
    limit = np.array([request.torque_limit.get(name, 1.0) for name in names])
    stiffness = np.array([request.stiffness.get(name, 1.0) for name in names])
    coordinates = scene.mechanism.coordinates
    # What lengths and angles are compared by.
    unit = np.where(coordinates.lengths[platform.actuated], platform.arm, 1.0)
    found = {name: np.full(len(reached), np.nan) for name in QUANTITIES}
    for first in range(0, len(nodes), CHUNK):
        part = nodes[first:first + CHUNK]
        inverse = jacobian[part]
        singular = np.linalg.svd(inverse / unit[:, np.newaxis], compute_uv=False)
        good = singular[:, -1] > 1e-14 * singular[:, 0]
        with np.errstate(divide='ignore'):
            found['condition'][part] = singular[:, 0] / singular[:, -1]
        found['force'][part] = found['stiffness'][part] = 0.0
        # Displacements of the point by those of the actuated joints.
        forward = np.linalg.inv(inverse[good])[:, :platform.axes]
        found['force'][part[good]] = (
            limit / np.maximum(np.linalg.norm(forward, axis=1), 1e-300)).min(axis=1)
        compliance = np.linalg.svd(forward / np.sqrt(stiffness), compute_uv=False)[:, 0]
        found['stiffness'][part[good]] = compliance ** -2.0
    return found


def _curves(platform, state, jacobian):
    """Return the singular curves on a grid along two axes."""
    long = [k for k, count in enumerate(state.shape) if count > 1]
    shape = tuple(state.shape[k] for k in long)
    reached = state.reached.reshape(shape) > 0
    position = state.position.reshape(*shape, -1)
    if not reached.any():
        return ()
    sign = np.where(reached, np.sign(np.linalg.det(jacobian)).reshape(shape), 0.0)
    inner = reached.copy()
    change = np.zeros(shape, dtype=bool)
    for axis in range(2):
        ahead = np.roll(reached, -1, axis), np.roll(sign, -1, axis) * sign < 0.0
        last = tuple(-1 if other == axis else slice(None) for other in range(2))
        ahead[0][last] = True
        ahead[1][last] = False
        behind = np.roll(reached, 1, axis)
        behind[tuple(0 if other == axis else slice(None) for other in range(2))] = True
        inner &= ahead[0] & behind
        change |= ahead[1]
    axes = [state.axes[k].values for k in long]
    box = np.array([[one[0] for one in axes], [one[-1] for one in axes]])
    step = max(float(box[1].min() - box[0].min()), float((box[1] - box[0]).max())) / 150.0
    places = np.zeros((3, platform.axes))
    places[1:, long] = np.eye(2)
    held = np.array([axis.values[0] for axis in state.axes])
    held[long] = 0.0
    values = platform.values(places + held)
    grid = PoseGrid(platform, [Axis(axis.name, axis.values[:1]) for axis in state.axes],
                    orientation_of(state.angles[0]))
    kinematics = DrivenKinematics(grid.mechanism, position[reached][0])
    found = []
    for kind, where in ((TYPE_1, reached & ~inner), (TYPE_2, change)):
        curves = SingularCurves(
            kinematics, (values[1:] - values[0]).T, values[0], kind, platform.actuated,
            platform.mechanism.coordinates, box, step)
        found += all_curves(curves, position[where])
    return tuple(found)


def read(file):
    """Return the arrays of a map's file by name; WorkspaceFileError where it is not a map."""
    from scipy.io import netcdf_file
    try:
        with netcdf_file(file, 'r', mmap=False) as found:
            return {name: np.array(each.data) for name, each in found.variables.items()}
    except (OSError, TypeError, ValueError) as error:
        raise WorkspaceFileError(f'{file}: {error}') from None
