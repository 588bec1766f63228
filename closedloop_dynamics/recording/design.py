# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Key figures of a driven mechanism: the numbers of ``closedloop report``."""

import math
from typing import Dict, NamedTuple, Tuple

import numpy as np

from .kinematics import Drive, DrivenRun
from .quantities import by_name, Extreme, forces, moved, Quantity, torques
from .transmission import transmission_angle
from ..effects.end_stop import EndStop
from ..kinematics.assembly import Assembler
from ..kinematics.geometry import Geometry
from ..kinematics.modeling import extent
from ..kinematics.second_order import as_it_moves
from ..mechanism.coordinates import unit_of
from ..mechanism.differences import derivative, FIRST_6
from ..mechanism.inertia import second_moments
from ..mechanism.kinematics import body_poses, named_point, pose_of, world_points
from ..mechanism.mechanism import REVOLUTE
from ..scene.key_paths import changed, numbers, resolve

TURN = 2.0 * math.pi
# Poses of a cycle, and how near to a limit one that does not turn round comes, of its range.
POSES, SHORT_OF_LIMIT = 361, 0.01
# Share of its stroke within which an output dwells.
DWELL = 0.01
# Step of differences, as a share of a length.
STENCIL_STEP = 1e-2
# Below this share singular values are zero; above the other one closure equations contradict one
# another.
NOTHING, OPENS = 1e-9, 1e-7


# What a number with a tolerance is, by the fields of joints, points and couplings that follow it:
# the first that applies; with its unit and usual tolerance in ``TOLERANCES``.
KINDS = {'length': ('position', 'point_a', 'point_b', 'length'), 'lead': ('lead',),
         'angle': ('angle', 'orientation', 'axis', 'second_axis', 'axis_a', 'axis_b'),
         'ratio': ('joints', 'offset')}
TOLERANCES = {one.name: one for one in (
    Quantity('length', 'm', 1e-4), Quantity('lead', 'm/rad', 1e-6),
    Quantity('angle', 'rad', 1e-3), Quantity('ratio', '1', 0.0))}


class Output(NamedTuple):
    """How a joint, or a coordinate of a point, moves over the drive."""

    #: ``least``, ``most``: [rad or m].
    least: Extreme
    most: Extreme
    #: Longest part of the drive over which it stays within ``DWELL`` of its stroke [rad or m].
    dwell: float
    #: Time of the slower stroke to that of the quicker one, of a whole turn; NaN otherwise.
    time_ratio: float


def cycle(scene):
    """
    Return the drive of a cycle by name: a whole turn, or from limit to limit.

    ValueError for a scene without one degree of freedom and one actuated joint, which turns.
    """
    names = scene.mechanism.actuated_joints
    joints = [joint for joint in scene.mechanism.joints if joint.name in names]
    if len(names) != 1 or len(joints) != 1 or joints[0].type != REVOLUTE:
        raise ValueError(
            'expected drives, as the scene does not have one actuated joint, which turns; got '
            f'{", ".join(names) or "none that is actuated"}')
    name, ends = names[0], []
    assembler = Assembler(scene.mechanism, Geometry(scene.mechanism).equations)
    position = assembler.positions(scene.initial.position, scene.initial.hold)
    coordinates = scene.mechanism.coordinates
    start = float(position[coordinates.place[coordinates.index[name]]])
    for sign in (1.0, -1.0):
        run = DrivenRun(scene, {name: Drive(start, start + sign * TURN)}, 3, 1.0)
        if run.end is None:
            return {name: Drive(0.0, TURN)}
        ends.append(float(run.end.values[0]))
    high, low = ends
    short = SHORT_OF_LIMIT * (high - low)
    return {name: Drive(low + short, high - short)}


def degrees_of_freedom(scene, position):
    """Return the degrees of freedom of a scene's mechanism near a position."""
    mechanism = as_it_moves(scene.mechanism, position)
    return Assembler(mechanism, Geometry(mechanism).equations).degrees_of_freedom(position)


def outputs(run, table) -> Dict[str, Output]:
    """Return how all joints but the drives, and all points, move."""
    drive = run.drive
    return {what: Output(
        one.extreme(drive, np.argmin), one.extreme(drive), _dwell(one.values, drive.values),
        _time_ratio(one.values, drive.values)) for what, one in moved(run, by_name(table)).items()}


def stops_met(run, table) -> Dict[Tuple[str, str], Extreme]:
    """Return how far joints go beyond their end stops, where they do, by stop and joint."""
    column, found = by_name(table), {}
    for name, stop in run.scene.effects.items():
        values = column.get(f'position.{stop.joint}') if isinstance(stop, EndStop) else None
        if values is not None:
            depth = np.maximum(values - (math.inf if stop.upper is None else stop.upper),
                               (-math.inf if stop.lower is None else stop.lower) - values)
            if depth.max() > 0.0:
                found[name, stop.joint] = Quantity(name, '', depth).extreme(run.drive)
    return found


def _dwell(values, drive):
    """Return the longest part of the drive over which values stay within some of their stroke."""
    room, longest, first = DWELL * np.ptp(values), 0.0, 0
    for last in range(len(values)):
        while np.ptp(values[first:last + 1]) > room:
            first += 1
        longest = max(longest, abs(drive[last] - drive[first]))
    return float(longest)


def _time_ratio(values, drive):
    """Return the ratio of the times of both strokes of a whole turn."""
    size = np.ptp(values)
    if abs(abs(drive[-1] - drive[0]) - TURN) > 1e-6 or abs(values[-1] - values[0]) > 1e-6 * size:
        return math.nan
    share = abs(_vertex(values, drive, np.argmax) - _vertex(values, drive, np.argmin)) / TURN
    slow = max(share, 1.0 - share)
    return slow / (1.0 - slow) if slow < 1.0 else math.nan


def _vertex(values, drive, pick):
    """Return the drive at an extreme of a periodic function, by a parabola through its values."""
    inner = values[:-1]
    k, count = int(pick(inner)), len(inner)
    before, here, after = inner[k - 1], inner[k], inner[(k + 1) % count]
    curvature = before - 2.0 * here + after
    share = 0.5 * (before - after) / curvature if curvature else 0.0
    return drive[k] + share * (drive[1] - drive[0])


def shaking(run):
    """
    Return the force and moment of the bodies' inertia on the ground.

    Forces [N], shape (n, 2), in space (n, 3); moments about the origin of the world [N m], shape
    (n,), in space (n, 3).
    """
    mechanism = run.mechanism
    bodies = [(body.name, *_point_masses(body, extent(mechanism))) for body in mechanism.bodies]
    mass = np.concatenate([masses for _, masses, _ in bodies])

    def places_of(position):
        poses = body_poses(mechanism, position)
        return np.concatenate([world_points(pose_of(mechanism, poses, name), points)
                               for name, _, points in bodies], axis=1)

    places, _, acceleration = run.rates(places_of)
    force = -mass[:, np.newaxis] * acceleration
    if not mechanism.planar:
        return force.sum(axis=1), np.cross(places, force).sum(axis=1)
    (x, y), (fx, fy) = (np.moveaxis(each, -1, 0) for each in (places, force))
    return force.sum(axis=1), (x * fy - y * fx).sum(axis=1)


def shaking_sizes(run):
    """Return the magnitudes of ``shaking``; in the plane the moment has its sign."""
    force, moment = shaking(run)
    return (Quantity('force', 'N', np.linalg.norm(force, axis=1)),
            Quantity('moment about the origin', 'N m',
                     moment if moment.ndim == 1 else np.linalg.norm(moment, axis=1)))


def _point_masses(body, size):
    """
    Return masses [kg], shape (n,), and places in the body's frame [m], shape (n, 2 or 3).

    Together they have the mass, the centre of mass and the inertia of the body: pairs at a
    distance on the principal axes, and one mass, which may be negative, at the centre.
    """
    center = np.array(body.center_of_mass)
    moments, axes = np.linalg.eigh(second_moments(body))
    pairs = np.repeat(0.5 * moments / size ** 2, 2)
    ends = size * np.repeat(axes.T, 2, axis=0) * np.tile([1.0, -1.0], len(center))[:, np.newaxis]
    return np.append(pairs, body.mass - pairs.sum()), np.vstack([center + ends, center])


def key_numbers(run, table) -> Dict[str, float]:
    """
    Return the numbers by which machines are compared, by name with their units.

    ``table`` is that of ``run.table``.
    """
    column, found = by_name(table), {}
    for one in moved(run, column).values():
        found[f'stroke {one.label}'] = float(one.values.max()) - float(one.values.min())
    angle = transmission_angle(run.mechanism, run.position, run.drive.name)
    if angle is not None:
        found['least transmission angle [deg]'] = math.degrees(angle.min())
    for torque in torques(run, column).values():
        found[f'largest torque or force {torque.label}'] = float(np.abs(torque.values).max())
        found[f'rms {torque.label}'] = torque.rms
    for force in forces(column).values():
        found[f'largest force {force.label}'] = float(force.values.max())
    for what, one in zip(('force', 'moment'), shaking_sizes(run)):
        found[f'largest shaking {what} [{one.unit}]'] = float(np.abs(one.values).max())
    return found


class Sensitivity(NamedTuple):
    """How outputs change with lengths."""

    keys: Tuple[str, ...]  # Lengths, as key paths of the scene
    outputs: Tuple[str, ...]  # Joints, and coordinates of points
    #: Shape (n, number of outputs, number of keys): At each pose [rad/m or 1].
    derivatives: np.ndarray

    def worst(self, tolerance):
        """
        Return the largest error of each output where every number is off by its tolerance.

        ``tolerance``: of all numbers, or shape (number of keys,).
        """
        return (np.abs(self.derivatives) * tolerance).sum(axis=2).max(axis=0)

    def sigma(self, tolerance):
        """Return the largest standard deviation where those of the numbers are a third of it."""
        return np.linalg.norm(self.derivatives * tolerance / 3.0, axis=2).max(axis=0)


def tolerated_keys(scene) -> Dict[str, str]:
    """
    Return the key paths of the numbers with tolerances, each with its kind of ``KINDS``.

    They are the parameters that change where joints and points are, how they are turned or how
    they are coupled; of a scene without parameters the places of its joints.
    """
    kinds = {key: _kind(scene, key) if scene.parameters else 'length'
             for key in length_keys(scene)}
    return {key: kind for key, kind in kinds.items() if kind is not None}


def _kind(scene, key):
    """Return the kind of a parameter by what it changes; None where that moves nothing."""
    path = resolve(scene, key)
    value = numbers(scene)['.'.join(path)]
    other = changed(scene, {path: value + STENCIL_STEP * max(abs(value), 1e-3)}).mechanism
    fields = {name for section in ('joints', 'cut_joints', 'points', 'couplings')
              for one, new in zip(getattr(scene.mechanism, section), getattr(other, section))
              for name, before in vars(one).items() if before != getattr(new, name)}
    kind = next((kind for kind, names in KINDS.items() if fields & set(names)), None)
    # A screw or a rack couples turns with slides.
    slides = any(len({unit_of(other, 'position', name) for name in new.joints}) > 1
                 for one, new in zip(scene.mechanism.couplings, other.couplings) if one != new)
    return 'lead' if kind == 'ratio' and slides else kind


def length_keys(scene):
    """Return the key paths of a scene's lengths: its parameters, or places of joints."""
    mechanism = scene.mechanism
    if scene.parameters:
        return tuple(f'parameters.{name}' for name in scene.parameters)
    places = [(f'joints.{joint.name}.position', joint.position) for joint in mechanism.joints]
    places += [(f'cut_joints.{cut.name}.{key}', getattr(cut, key))
               for cut in mechanism.cut_joints for key in ('point_a', 'point_b')]
    return tuple(f'mechanism.{key}.{axis}' for key, place in places
                 for axis, value in enumerate(place) if abs(value) > 0.0)


def output_numbers(mechanism, position, driven):
    """
    Return names and values [rad or m], shape (n, number of names), of joints and points.

    ``position`` has the shape (n, nq); the joints ``driven`` are left out.
    """
    coordinates = mechanism.coordinates
    single = [name for name, place in zip(coordinates.names, coordinates.place) if place >= 0]
    names = [name for name in single if name not in driven]
    columns = [position[:, coordinates.place[coordinates.index[name]]] for name in names]
    poses = body_poses(mechanism, position)
    for point in mechanism.points:
        places = named_point(mechanism, poses, point.name)
        for axis, column in zip('xyz', places.T):
            names.append(f'point.{point.name}.{axis}')
            columns.append(column)
    return names, np.stack(columns, axis=1)


def sensitivity(scene, run, keys, numbers_of=output_numbers) -> Sensitivity:
    """
    Return the derivatives of joints and points by lengths, with the driven joints held.

    Closure equations psi(q, length) = 0 hold at other lengths, too: the Jacobian of psi, of which
    each pose needs one decomposition for all lengths, gives the change of q (implicit function
    theorem). How psi and points depend on a length alone is known from formulas, whose
    differences are of the sixth order: exact, but for rounding, for polynomials such as psi.

    Parameters
    ----------
    scene : scene_records.Scene
        Of the run.
    run : DrivenRun
        Of joints.
    keys : sequence of str
        Key paths of numbers.
    numbers_of : callable, optional
        Returns names and values of what is differentiated, smooth in the positions, as
        ``output_numbers``, by default.

    Raises
    ------
    ValueError
        For keys of no number, and where no position closes the loops of a changed mechanism.

    """
    mechanism = scene.mechanism
    coordinates, known = mechanism.coordinates, numbers(scene)
    free = [place for place, name in enumerate(coordinates.names) if name not in run.driven]
    equations = Geometry(mechanism).equations
    inverses, jacobians = [], []
    for position in run.position:
        jacobians.append(equations.move(position).jacobian()[:, free].copy())
        inverses.append(np.linalg.pinv(jacobians[-1], rcond=NOTHING))
    jacobians, inverses = np.array(jacobians), np.array(inverses)
    names, found = numbers_of(mechanism, run.position, run.driven)[0], []
    for key in keys:
        path = resolve(scene, key)
        value = known['.'.join(path)]
        step = STENCIL_STEP * max(abs(value), 1e-3)
        others = [changed(scene, {path: value + k * step}).mechanism for k in FIRST_6]
        # A named point is on no loop.
        psi = np.zeros(jacobians.shape[:2]) if path[:2] == ('mechanism', 'points') else derivative(
            FIRST_6, step, (_closures(other, run.position) for other in others))
        change = np.zeros((len(run.position), coordinates.nv))
        change[:, free] = -np.einsum('nij,nj->ni', inverses, psi)
        left = psi + np.einsum('nij,nj->ni', jacobians, change[:, free])
        if np.abs(left).max(initial=0.0) > OPENS * max(1.0, np.abs(psi).max(initial=0.0)):
            raise ValueError(f'{key}: no position closes the loops at another length')
        found.append(derivative(FIRST_6, step, (numbers_of(
            other, coordinates.moved(run.position, k * step * change), run.driven)[1]
            for k, other in zip(FIRST_6, others))))
    return Sensitivity(tuple(keys), tuple(names), np.stack(found, axis=2))


def _closures(mechanism, positions):
    """Return the errors of the closure equations, shape (n, number of equations)."""
    equations = Geometry(mechanism).equations
    return np.array([equations.move(position).closures()[0].copy() for position in positions])
