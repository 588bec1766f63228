# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Quantities of a driven machine, by name, with derivatives by numbers of its scene.

Positions, points and the transmission angle have exact derivatives: closure equations give the
change of all joints (``recording.design.sensitivity``). Velocities, torques and forces have
differences of the sixth order, as the engine has no derivatives by lengths and masses: in masses,
moments of inertia and single coordinates of centres of mass, of which torques and forces are
polynomials, these are exact but for rounding.
"""

from dataclasses import dataclass, replace
from functools import reduce
from typing import Dict, NamedTuple, Optional

import numpy as np

from .slopes import Magnitude, ON_SLOPES, Path, Slope
from ..mechanism.fields import among, FieldError, nearest, shown
from ..mechanism.mechanism import MechanismError
from ..recording import design
from ..recording.kinematics import by_name, Drive, DrivenRun, torques
from ..recording.transmission import transmission_parts
from ..simulation.errors import SimulationError
from ..simulation.key_paths import changed, numbers, resolve

TRANSMISSION, SHAKING_FORCE, SHAKING_MOMENT = (
    'transmission_angle', 'shaking_force', 'shaking_moment')
# Steps of differences, as shares of a number or, where that is more, of so much of its range.
STEP, OF_RANGE = 1e-2, 0.1
CENTRAL, FORWARD = tuple(range(-3, 4)), tuple(range(7))
# Where they are tried one after the other: a machine next to its limits has no others around.
TRIED = ((CENTRAL, 1.0), (FORWARD, 1.0), (FORWARD, -1.0), (CENTRAL, 0.1), (CENTRAL, 0.01))


class Infeasible(Exception):
    """A machine that cannot be assembled, or not be driven all the way; the message says why."""


@dataclass(frozen=True)
class Driven:
    """How a machine is driven."""

    drives: Dict[str, Drive]
    poses: int
    speed: float  # Of the first drive that moves [rad/s or m/s]
    branch: Optional[int] = None  # As for ``DrivenRun``

    def start(self, scene):
        """
        Return a scene that holds nothing at its start, unless driven joints alone are held.

        With other lengths, loops need not close where other joints are held; they close in the
        nearest position then.
        """
        if set(scene.initial.hold) <= set(self.drives):
            return scene
        return replace(scene, initial=replace(scene.initial, hold=()))

    def run(self, scene):
        """Drive a machine all the way; raise Infeasible where it cannot be."""
        try:
            run = DrivenRun(
                self.start(scene), self.drives, self.poses, self.speed, self.branch)
        except (SimulationError, ValueError) as error:
            raise Infeasible(str(error)) from None
        if run.end is not None:
            raise Infeasible(run.end.reason)
        return run


class Variable(NamedTuple):
    """A number that is varied."""

    key: str  # Its key path
    low: float
    high: float


def with_values(scene, variables, values):
    """Return a scene with other numbers; raise Infeasible where one is impossible at its place."""
    try:
        return changed(scene, {resolve(scene, one.key): float(value)
                               for one, value in zip(variables, values)})
    except (FieldError, MechanismError) as error:
        raise Infeasible(str(error)) from None


def names_of(scene, drives):
    """Return the names of all quantities of a scene, and of its numbers, by kind."""
    mechanism = scene.mechanism
    joints = [*mechanism.coordinates.names, *mechanism.cut_coordinates.names]
    axes = 'xyz'[:2 if mechanism.planar else 3]
    points = [point.name for point in mechanism.points]
    joint_names = [joint.name for joint in (*mechanism.joints, *mechanism.cut_joints)]
    found = [*points, *(f'{point}.{axis}' for point in points for axis in axes),
             *(f'{what}.{joint}' for what in ('position', 'velocity', 'acceleration')
               for joint in joints),
             *(f'{what}.{drive}' for what in ('torque', 'power') for drive in _exerting(
                 scene, drives)),
             *(f'force.{joint}' for joint in joint_names), TRANSMISSION, SHAKING_FORCE,
             SHAKING_MOMENT]
    return found, numbers(scene)


def _exerting(scene, drives):
    """Return the names of coordinates with torques."""
    freedoms = {*scene.mechanism.coordinates.names, *scene.mechanism.cut_coordinates.names}
    return list(drives) if freedoms.issuperset(drives) else scene.mechanism.actuated_joints


class Quantities:
    """
    Quantities of one machine, each computed at first use.

    ``variables`` are those by which derivatives are asked for; none: values alone; ``run``, a
    DrivenRun of this machine, where it is known. Infeasible, here and whenever a quantity is asked
    for.
    """

    def __init__(self, scene, driven, variables=(), run=None):
        self._scene, self._driven, self._variables = scene, driven, tuple(variables)
        self.run = driven.run(scene) if run is None else run
        self._known, self._others = {}, {}

    def by(self, variables):
        """Return the same with derivatives."""
        return Quantities(self._scene, self._driven, variables, self.run)

    def __getitem__(self, name):
        """Return a ``Slope``, or the ``Path`` of a point."""
        if name not in self._known:
            self._known[name] = self._found(name)
        return self._known[name]

    @property
    def count(self):
        """Return by how many numbers derivatives are."""
        return len(self._variables)

    def number(self, key):
        """Return a number of the scene, with derivatives by the others that decide it."""
        keys = [one.key for one in self._variables]
        slope = np.zeros(len(keys))
        if key in keys:
            slope[keys.index(key)] = 1.0
        for k, one in enumerate(self._variables if key not in keys else ()):
            # A parameter decides others.
            if one.key.startswith('parameters.'):
                value = numbers(self._scene)[one.key]
                step = STEP * max(abs(value), OF_RANGE * (one.high - one.low))
                slope[k] = sum(
                    weight / step * numbers(with_values(
                        self._scene, [one], [value + offset * step]))[key]
                    for weight, offset in zip(_weights(CENTRAL), CENTRAL) if weight)
        return Slope(numbers(self._scene)[key], slope)

    def part(self, x, low, high):
        """Return the part of a quantity where the first drive that moves is between two values."""
        _, drive = design.drive_values(self.run)
        places = np.flatnonzero((drive >= low - 1e-9) & (drive <= high + 1e-9))
        if len(places) < 3:
            raise FieldError(f'part of the drive from {drive.min():.6g} to {drive.max():.6g} '
                             f'with three poses or more', f'{low:.6g} to {high:.6g}')
        if isinstance(x, Path):
            return Path(x.places.part(places))
        if not isinstance(x, Slope) or x.value.ndim != 1:
            raise FieldError('part of a quantity over the motion', 'that of a single number')
        return x.part(places)

    def _found(self, name):
        mechanism = self.run.mechanism
        what, _, rest = name.partition('.')
        points = [point.name for point in mechanism.points]
        axes = 'xyz'[:2 if mechanism.planar else 3]
        if name in points:
            columns = [self._exact(f'point.{name}.{axis}') for axis in axes]
            return Path(Slope(np.stack([one.value for one in columns], axis=1),
                              np.stack([one.slope for one in columns], axis=1)))
        if what in points:
            return self._exact(f'point.{name}')
        if name == TRANSMISSION:
            return self._transmission()
        if what == 'position' and rest in self.run.driven:
            values = self.run.driven[rest]
            return Slope(values, np.zeros((len(values), len(self._variables))))
        if what == 'position' and rest in mechanism.coordinates.names:
            return self._exact(rest)
        if name == SHAKING_FORCE:
            return Magnitude(self._stacked(_shaking, [f'force.{axis}' for axis in axes]))
        if name == SHAKING_MOMENT and mechanism.planar:
            return self._differences(_shaking, 'moment')
        if name == SHAKING_MOMENT:
            return Magnitude(self._stacked(_shaking, [f'moment.{axis}' for axis in axes]))
        if what == 'force':
            return Magnitude(self._stacked(_loads, [f'force.{rest}.{axis}' for axis in axes]))
        if what == 'power':
            return self[f'torque.{rest}'] * self[f'velocity.{rest}']
        return self._differences(_loads, name)

    def _exact(self, name):
        """Return a quantity of the positions."""
        if _numbers not in self._known:
            self._known[_numbers] = self._positions()
        names, values, slopes = self._known[_numbers]
        place = names.index(name)
        return Slope(values[:, place], slopes[:, place])

    def _transmission(self):
        """Return the least transmission angle of all couplers."""
        names = _numbers(self.run.mechanism, self.run.position, self.run.driven)[0]
        count = sum(name.startswith(TRANSMISSION) for name in names)
        parts = [ON_SLOPES['abs'](self._exact(f'{TRANSMISSION}.{k}')) for k in range(count)]
        if not parts:
            raise FieldError('a coupler between the driven link and one on the ground',
                             'another mechanism, without transmission angle')
        return reduce(ON_SLOPES['min'], map(ON_SLOPES['atan2'], parts[::2], parts[1::2]))

    def _positions(self):
        """Return names, values and derivatives of quantities of positions."""
        run, keys = self.run, [one.key for one in self._variables]
        names, values = _numbers(run.mechanism, run.position, run.driven)
        slopes = np.zeros((*values.shape, len(keys)))
        # Masses and forces move nothing that is driven.
        moving = [k for k, key in enumerate(keys) if not key.startswith(
            ('mechanism.bodies.', 'effects.'))]
        if moving and any(name not in run.mechanism.coordinates.names for name in run.driven):
            for k in moving:
                nodes = [(weight, _numbers(other.mechanism, other.position, other.driven)[1])
                         for weight, other in self._around(k)]
                slopes[..., k] = sum(weight * each for weight, each in nodes)
        elif moving:
            try:
                slopes[..., moving] = design.sensitivity(
                    self._scene, run, [keys[k] for k in moving], _numbers).derivatives
            except (ValueError, MechanismError) as error:
                raise Infeasible(str(error)) from None
        return names, values, slopes

    def _stacked(self, group, names):
        columns = [self._differences(group, name) for name in names]
        return Slope(np.stack([one.value for one in columns], axis=1),
                     np.stack([one.slope for one in columns], axis=1))

    def _differences(self, group, name):
        """Return a quantity with differences for derivatives."""
        if group not in self._known:
            names, values = _of_all(group, self.run)
            slopes = np.zeros((*values.shape, len(self._variables)))
            for k, one in enumerate(self._variables):
                if self._is_idle(one.key.split('.')):
                    continue
                slopes[..., k] = sum(weight * _of_all(group, other)[1]
                                     for weight, other in self._around(k) if weight)
            self._known[group] = names, values, slopes
        names, values, slopes = self._known[group]
        if name not in names:
            raise FieldError(f'one of {among(names)}', shown(name), nearest(name, names))
        place = names.index(name)
        return Slope(values[:, place], slopes[:, place])

    def _is_idle(self, keys):
        """Return whether a number is that of a point where nothing acts."""
        return keys[:2] == ['mechanism', 'points'] and not any(
            keys[2] in repr(one) for one in (*self.run.scene.effects.values(), self.run.driven))

    def _around(self, k):
        """Return runs of machines that differ in one number, with the weights of a derivative."""
        if k not in self._others:
            self._others[k] = self._nodes(self._variables[k])
        return self._others[k]

    def _nodes(self, variable):
        value = numbers(self._scene)['.'.join(resolve(self._scene, variable.key))]
        room = OF_RANGE * (variable.high - variable.low)
        reason = None
        for offsets, scale in TRIED:
            step = scale * STEP * max(abs(value), room)
            try:
                return [(weight / step, self._driven.run(with_values(
                    self._scene, [variable], [value + offset * step])))
                    for weight, offset in zip(_weights(offsets), offsets) if offset or weight]
            except Infeasible as error:
                reason = error
        raise Infeasible(f'{variable.key}: no machines around this one: {reason}')


def _weights(offsets):
    """Return the weights of the derivative at 0 of the polynomial through values at offsets."""
    powers = np.vander(np.array(offsets, dtype=float), increasing=True).T
    found = np.linalg.solve(powers, np.eye(len(offsets))[1])
    return [float(weight) if abs(weight) > 1e-12 else 0.0 for weight in found]


def _numbers(mechanism, position, driven):
    """Return names and values of quantities of positions, smooth in them."""
    names, values = design.output_numbers(mechanism, position, driven)
    drive = next(name for name, each in driven.items() if np.ptp(each) > 0.0)
    parts = [part for pair in transmission_parts(mechanism, position, drive) for part in pair]
    return ([*names, *(f'{TRANSMISSION}.{k}' for k in range(len(parts)))],
            np.concatenate((values, *(part[:, np.newaxis] for part in parts)), axis=1))


def _of_all(group, run):
    try:
        return group(run)
    except SimulationError as error:
        raise Infeasible(str(error)) from None


def _loads(run):
    """Return names and values of velocities, torques and components of forces."""
    column = by_name(run.table())
    exerted = torques(run, column)
    found = {**{f'torque.{name}': each for name, each in exerted.items()},
             **{name: each for name, each in column.items() if name.startswith(
                 ('position.', 'velocity.', 'acceleration.', 'force.'))}}
    return list(found), np.stack(list(found.values()), axis=1)


def _shaking(run):
    """Return names and values of the components of the shaking force, and the moment."""
    force, moment = design.shaking(run)
    names = [f'force.{axis}' for axis in 'xyz'[:force.shape[1]]]
    names += ['moment'] if moment.ndim == 1 else [f'moment.{axis}' for axis in 'xyz']
    return names, np.column_stack((force, moment))
