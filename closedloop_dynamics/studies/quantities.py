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
from typing import Callable, Dict, NamedTuple, Optional

import numpy as np

from .slopes import Magnitude, ON_SLOPES, Path, Slope
from ..mechanism.differences import derivative, FIRST_6, FORWARD_6, nodes
from ..mechanism.errors import SimulationError
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import MechanismError
from ..recording import design
from ..recording.kinematics import Drive, DrivenRun
from ..recording.quantities import by_name, torques
from ..recording.transmission import transmission_parts
from ..scene.key_paths import changed, numbers, resolve

TRANSMISSION, SHAKING_FORCE, SHAKING_MOMENT = (
    'transmission_angle', 'shaking_force', 'shaking_moment')
# Steps of differences, as shares of a number or, where that is more, of so much of its range.
STEP, OF_RANGE = 1e-2, 0.1
# Where they are tried one after the other: a machine next to its limits has no others around.
TRIED = ((FIRST_6, 1.0), (FORWARD_6, 1.0), (FORWARD_6, -1.0), (FIRST_6, 0.1), (FIRST_6, 0.01))


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


def quantities_of(mechanism, drives) -> Dict[str, Callable[['Quantities'], object]]:
    """
    Return how each quantity of a driven machine is computed, by its name in expressions.

    From ``Quantities``, as a ``Slope``, or the ``Path`` of a point.
    """
    points = [point.name for point in mechanism.points]
    axes = 'xyz'[:2 if mechanism.planar else 3]
    freedoms = [*mechanism.coordinates.names, *mechanism.cut_coordinates.names]
    exerting = drives if set(freedoms).issuperset(drives) else mechanism.actuated_joints

    def exact(name):
        return lambda all_: all_.exact(name)

    def by_differences(group, name):
        return lambda all_: all_.differences(group, name)

    def magnitude(group, name):
        return lambda all_: Magnitude(_stacked([
            all_.differences(group, f'{name}.{axis}') for axis in axes]))

    def path(point):
        return lambda all_: Path(_stacked([all_.exact(f'{point}.{axis}') for axis in axes]))

    found = {point: path(f'point.{point}') for point in points}
    found.update({f'{point}.{axis}': exact(f'point.{point}.{axis}')
                  for point in points for axis in axes})
    found.update({f'position.{name}': (
        (lambda all_, name=name: all_.driven(name)) if name in drives else exact(name)
        if name in mechanism.coordinates.names else by_differences(_loads, f'position.{name}'))
        for name in freedoms})
    found.update({name: by_differences(_loads, name) for name in (
        *(f'{what}.{name}' for what in ('velocity', 'acceleration') for name in freedoms),
        *(f'torque.{name}' for name in exerting))})
    found.update({f'power.{name}': lambda all_, name=name: (
        all_[f'torque.{name}'] * all_[f'velocity.{name}']) for name in exerting})
    found.update({f'force.{joint.name}': magnitude(_loads, f'force.{joint.name}')
                  for joint in (*mechanism.joints, *mechanism.cut_joints)})
    return {**found, TRANSMISSION: Quantities.transmission,
            SHAKING_FORCE: magnitude(_shaking, 'force'),
            SHAKING_MOMENT: by_differences(_shaking, 'moment') if mechanism.planar else (
                magnitude(_shaking, 'moment'))}


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
        self._computed = quantities_of(self.run.mechanism, driven.drives)
        self._known, self._others = {}, {}

    def by(self, variables):
        """Return the same with derivatives."""
        return Quantities(self._scene, self._driven, variables, self.run)

    def __getitem__(self, name):
        """Return a ``Slope``, or the ``Path`` of a point."""
        if name not in self._known:
            self._known[name] = self._computed[name](self)
        return self._known[name]

    @property
    def count(self):
        """Return by how many numbers derivatives are."""
        return len(self._variables)

    def number(self, key):
        """Return a number of the scene, with derivatives by the others that determine it."""
        keys = [one.key for one in self._variables]
        slope = np.zeros(len(keys))
        if key in keys:
            slope[keys.index(key)] = 1.0
        for k, one in enumerate(self._variables if key not in keys else ()):
            # A parameter determines others.
            if one.key.startswith('parameters.'):
                value = numbers(self._scene)[one.key]
                step = STEP * max(abs(value), OF_RANGE * (one.high - one.low))
                slope[k] = derivative(FIRST_6, step, (numbers(with_values(
                    self._scene, [one], [value + offset * step]))[key] for offset in FIRST_6))
        return Slope(numbers(self._scene)[key], slope)

    def part(self, x, low, high):
        """Return the part of a quantity where the first drive that moves is between two values."""
        drive = self.run.drive.values
        places = np.flatnonzero((drive >= low - 1e-9) & (drive <= high + 1e-9))
        if len(places) < 3:
            raise FieldError(f'part of the drive from {drive.min():.6g} to {drive.max():.6g} '
                             f'with three poses or more', f'{low:.6g} to {high:.6g}')
        if isinstance(x, Path):
            return Path(x.places.part(places))
        if not isinstance(x, Slope) or x.value.ndim != 1:
            raise FieldError('part of a quantity over the motion', 'that of a single number')
        return x.part(places)

    def driven(self, name):
        """Return the position of a driven joint, which no number changes."""
        values = self.run.driven[name]
        return Slope(values, np.zeros((len(values), self.count)))

    def exact(self, name):
        """Return a quantity of the positions."""
        if _numbers not in self._known:
            self._known[_numbers] = self._positions()
        return _column(self._known[_numbers], name)

    def transmission(self):
        """Return the least transmission angle of all couplers."""
        names = _numbers(self.run.mechanism, self.run.position, self.run.driven)[0]
        count = sum(name.startswith(TRANSMISSION) for name in names)
        parts = [ON_SLOPES['abs'](self.exact(f'{TRANSMISSION}.{k}')) for k in range(count)]
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
                slopes[..., k] = sum(
                    weight * _numbers(other.mechanism, other.position, other.driven)[1]
                    for weight, other in self._around(k))
        elif moving:
            try:
                slopes[..., moving] = design.sensitivity(
                    self._scene, run, [keys[k] for k in moving], _numbers).derivatives
            except (ValueError, MechanismError) as error:
                raise Infeasible(str(error)) from None
        return names, values, slopes

    def differences(self, group, name):
        """Return a quantity with differences for derivatives."""
        if group not in self._known:
            names, values = _of_all(group, self.run)
            slopes = np.zeros((*values.shape, len(self._variables)))
            for k, one in enumerate(self._variables):
                if not self._is_idle(one.key.split('.')):
                    slopes[..., k] = sum(weight * _of_all(group, other)[1]
                                         for weight, other in self._around(k))
            self._known[group] = names, values, slopes
        return _column(self._known[group], name)

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
        step = STEP * max(abs(value), OF_RANGE * (variable.high - variable.low))
        try:
            return nodes(lambda distance: self._driven.run(with_values(
                self._scene, [variable], [value + distance])), step, TRIED, Infeasible)
        except Infeasible as error:
            raise Infeasible(
                f'{variable.key}: no machines around this one: {error}') from None


def _column(known, name):
    """Return one of several quantities with their names, values and derivatives."""
    names, values, slopes = known
    place = names.index(name)
    return Slope(values[:, place], slopes[:, place])


def _stacked(columns):
    return Slope(np.stack([one.value for one in columns], axis=1),
                 np.stack([one.slope for one in columns], axis=1))


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
    found = {**{f'torque.{name}': one.values for name, one in torques(run, column).items()},
             **{name: each for name, each in column.items() if name.startswith(
                 ('position.', 'velocity.', 'acceleration.', 'force.'))}}
    return list(found), np.stack(list(found.values()), axis=1)


def _shaking(run):
    """Return names and values of the components of the shaking force, and the moment."""
    force, moment = design.shaking(run)
    names = [f'force.{axis}' for axis in 'xyz'[:force.shape[1]]]
    names += ['moment'] if moment.ndim == 1 else [f'moment.{axis}' for axis in 'xyz']
    return names, np.column_stack((force, moment))
