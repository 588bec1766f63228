# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What is estimated beside the motion: records of loads, numbers of the scene, errors of sensors.

Each has a standard deviation of what is thought at the start, and a density: zero for a constant;
otherwise the number walks at random, by ``density`` sqrt(t) in a time t (its unit per sqrt(s)).
Loads become effects of the scene, and all are numbers that the engine differentiates by.
"""

from dataclasses import dataclass, replace
import math
from typing import Any, ClassVar, Dict, Optional, Tuple, Union

import numpy as np

from .sensors import BODY, WORLD
from ..effects.external_force import ExternalForce
from ..effects.gravity import Gravity
from ..effects.payload import Payload as PayloadEffect
from ..mechanism.checks import (
    freedom, name, not_negative, one_of, positive, text, vector)
from ..mechanism.fields import at, FieldError, normalise
from ..mechanism.mechanism import Point
from ..scene.key_paths import numbers, resolve
from ..scene.records import Scene


def _directions(value: Any) -> str:
    found = text(value)
    if found not in ('', 'x', 'y', 'z', 'xy', 'xz', 'yz', 'xyz'):
        raise FieldError("some of 'xyz', in this order", repr(value))
    return found


@dataclass(frozen=True)
class Unknown:
    """
    What all unknowns have in common; they are its subclasses.

    Attributes
    ----------
    name : str
        Of the unknown; those of several numbers are called ``NAME.x`` and so on.

    """

    #: Its kind, for alarms: ``load``, ``friction``, ``length``, ``sensor``, ...
    KIND: ClassVar[str] = 'number'
    #: The unit of its numbers, for pictures.
    UNIT: ClassVar[str] = 'SI unit'
    #: Checks of the fields of a kind.
    CHECKS: ClassVar[Dict[str, Any]] = {}

    name: str

    @property
    def components(self) -> Tuple[str, ...]:
        """Return the names of the numbers."""
        return (self.name,)

    @property
    def deviations(self) -> Tuple[float, ...]:
        """Return the standard deviations at the start."""
        return len(self.components) * (getattr(self, 'deviation'),)

    @property
    def densities(self) -> Tuple[float, ...]:
        """Return how fast the numbers walk, zero for constants."""
        return len(self.components) * (getattr(self, 'density'),)

    def prepared(self, scene: Scene) -> Scene:
        """Return the scene with what this unknown needs in it."""
        return scene

    def start(self, scene: Scene) -> Tuple[float, ...]:
        """Return the numbers at the start."""
        return len(self.components) * (0.0,)

    def keys(self, scene: Scene) -> Tuple[str, ...]:
        """Return the key paths of the numbers of the prepared scene that follow from it."""
        return ()

    def values(self, scene: Scene, found: np.ndarray) -> np.ndarray:
        """Return the numbers at these key paths."""
        return found

    def slopes(self, scene: Scene, found: np.ndarray) -> np.ndarray:
        """Return the derivatives of the numbers at key paths by those of the unknown."""
        return np.eye(len(found))

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        normalise(self, name=name, density=not_negative)
        with at(self.name):
            normalise(self, deviation=positive)
        normalise(self, **self.CHECKS)


@dataclass(frozen=True)
class Wrench(Unknown):
    """
    Force and torque on a body, at its origin or at a named point.

    Attributes
    ----------
    body : str
        A body, or a point of one.
    deviation : float
        Of each force at the start, positive [N].
    torque : float or None
        Of each torque [N m]; no torques where not given.
    density, torque_density : float
        Of walks [N/sqrt(s)], [N m/sqrt(s)].
    directions : str
        Of the forces: ``'xy'``, or some of ``'xyz'`` in space; '' for a torque alone.
    axes : str
        ``'world'`` or ``'body'``.

    """

    KIND, UNIT = 'load', 'N, N m'
    CHECKS = {'body': name, 'torque_density': not_negative, 'axes': one_of((WORLD, BODY)),
              'directions': _directions,
              'torque': lambda value: None if value is None else positive(value)}

    body: str = ''
    deviation: float = 0.0
    density: float = 0.0
    directions: str = 'xy'
    torque: Optional[float] = None
    torque_density: float = 0.0
    axes: str = WORLD

    @property
    def components(self) -> Tuple[str, ...]:
        """Return the names of the numbers."""
        turns = () if self.torque is None else (
            tuple(f'torque_{axis}' for axis in 'xyz') if 'z' in self.directions else ('torque',))
        return tuple(f'{self.name}.{each}' for each in (*self.directions, *turns))

    @property
    def deviations(self) -> Tuple[float, ...]:
        """Return the standard deviations at the start."""
        return self._each(self.deviation, self.torque or 0.0)

    @property
    def densities(self) -> Tuple[float, ...]:
        """Return how fast the numbers walk."""
        return self._each(self.density, self.torque_density)

    def _each(self, force: float, torque: float) -> Tuple[float, ...]:
        count = len(self.directions)
        return (*count * (force,), *(len(self.components) - count) * (torque,))

    def prepared(self, scene: Scene) -> Scene:
        """Return the scene with a force, and a point at the origin of the body."""
        mechanism, size = scene.mechanism, 2 if scene.mechanism.planar else 3
        if 'z' in self.directions and size == 2:
            raise FieldError('directions among xy, in the plane', repr(self.directions), '',
                             (self.name, 'directions'))
        if size == 3 and self.torque is not None and 'z' not in self.directions:
            raise FieldError("'xyz' beside a torque, in space", repr(self.directions), '',
                             (self.name, 'directions'))
        point = self.body
        if point not in [one.name for one in mechanism.points]:
            one_of([body.name for body in mechanism.bodies], 'a body or a point among')(point)
            point = f'origin_of_{self.name}'
            mechanism = replace(mechanism, points=(
                *mechanism.points, Point(point, self.body, size * (0.0,))))
        torque: Any = 0.0 if size == 2 else (0.0, 0.0, 0.0)
        return _with_effect(replace(scene, mechanism=mechanism), self.name, ExternalForce(
            point, size * (0.0,), torque, self.axes))

    def keys(self, scene: Scene) -> Tuple[str, ...]:
        """Return the key paths of forces and torques."""
        path = f'effects.{self.name}'
        turns = () if self.torque is None else (f'{path}.torque',) if scene.mechanism.planar else (
            tuple(f'{path}.torque.{axis}' for axis in range(3)))
        return (*(f'{path}.force.{"xyz".index(axis)}' for axis in self.directions), *turns)


@dataclass(frozen=True)
class JointTorque(Unknown):
    """
    A torque or force in a joint of the tree, beside what is commanded.

    Attributes
    ----------
    joint : str
    deviation : float
        Positive [N m or N].
    density : float
        [N m/sqrt(s) or N/sqrt(s)].

    """

    KIND, UNIT = 'load', 'N m or N'
    CHECKS = {'joint': freedom}

    joint: str = ''
    deviation: float = 0.0
    density: float = 0.0

    def prepared(self, scene: Scene) -> Scene:
        """Return the scene in which the joint takes torques."""
        mechanism = scene.mechanism
        freedoms = mechanism.coordinates.names
        with at(self.name, 'joint'):
            one_of(freedoms, 'a degree of freedom of the tree among')(self.joint)
        joint = mechanism.coordinates.joint_of(self.joint)
        return replace(scene, mechanism=replace(mechanism, joints=tuple(
            replace(one, actuated=True) if one.name == joint else one
            for one in mechanism.joints)))


@dataclass(frozen=True)
class Payload(Unknown):
    """
    A mass on a body.

    Attributes
    ----------
    body : str
    deviation : float
        Positive [kg].
    position : tuple of 2 floats, or 3 in space
        Its centre in the body's frame [m].
    value : float
        What is thought to be there at the start [kg].
    density : float
        [kg/sqrt(s)].

    """

    KIND, UNIT = 'load', 'kg'
    CHECKS = {'body': name, 'position': vector, 'value': not_negative}

    body: str = ''
    deviation: float = 0.0
    position: Tuple[float, ...] = (0.0, 0.0)
    value: float = 0.0
    density: float = 0.0

    def prepared(self, scene: Scene) -> Scene:
        """Return the scene with a mass, which is not zero: arrays follow it in proportion."""
        return _with_effect(scene, self.name, PayloadEffect(
            self.body, self.value or self.deviation, self.position))

    def start(self, scene: Scene) -> Tuple[float, ...]:
        """Return the mass at the start."""
        return (self.value,)

    def keys(self, scene: Scene) -> Tuple[str, ...]:
        """Return the key path of the mass."""
        return (f'effects.{self.name}.mass',)


@dataclass(frozen=True)
class Number(Unknown):
    """
    A number of the scene: a length, a mass, the coefficient of a friction or of a spring.

    Attributes
    ----------
    key : str
        Its key path: ``'mechanism.joints.elbow.position.0'``, ``'effects.grease.coefficient'``,
        ``'parameters.length'``.
    deviation : float
        At the start, positive, in its unit.
    density : float
        In its unit per sqrt(s).

    """

    CHECKS = {'key': text}

    key: str = ''
    deviation: float = 0.0
    density: float = 0.0

    @property
    def KIND(self) -> str:  # type: ignore[override]  # noqa: N802
        """Return of which kind the number is."""
        words = self.key.split('.')
        if words[0] == 'effects':
            return 'friction' if words[-1] in _OF_FRICTION else 'force'
        return 'mass' if words[-1] == 'mass' or 'inertia' in words or (
            'center_of_mass' in words) else 'length' if words[0] == 'mechanism' else 'number'

    def start(self, scene: Scene) -> Tuple[float, ...]:
        """Return the number of the scene."""
        value = numbers(scene)['.'.join(resolve(scene, self.key))]
        return (0.0 if value is None else value,)

    def keys(self, scene: Scene) -> Tuple[str, ...]:
        """Return the key path."""
        return ('.'.join(resolve(scene, self.key)),)


# Keys of effects that are of friction, for alarms.
_OF_FRICTION = 'coulomb', 'static_ratio', 'friction_coefficient', 'coefficient', 'damping'


@dataclass(frozen=True)
class GravityDirection(Unknown):
    """
    How far gravity is turned from the scene's: about two axes, in the plane about one.

    Attributes
    ----------
    deviation : float
        Of each angle, positive [rad].
    density : float
        [rad/sqrt(s)].
    effect : str
        Name of the gravity in the scene.

    """

    KIND, UNIT = 'gravity', 'rad'

    deviation: float = 0.0
    density: float = 0.0
    effect: str = 'gravity'
    planar: bool = True

    @property
    def components(self) -> Tuple[str, ...]:
        """Return the names of the angles."""
        return (self.name,) if self.planar else (f'{self.name}.1', f'{self.name}.2')

    def prepared(self, scene: Scene) -> Scene:
        """Refuse a scene without gravity, or of other dimensions."""
        if not isinstance(scene.effects.get(self.effect), Gravity):
            raise FieldError(
                'the name of a gravity among the effects', repr(self.effect), '', (self.name,))
        if self.planar != scene.mechanism.planar:
            raise FieldError(f'planar: {scene.mechanism.planar}, as the mechanism is',
                             f'{self.planar}', '', (self.name, 'planar'))
        return scene

    def keys(self, scene: Scene) -> Tuple[str, ...]:
        """Return the key paths of the acceleration."""
        count = len(scene.effects[self.effect].acceleration)
        return tuple(f'effects.{self.effect}.acceleration.{k}' for k in range(count))

    def values(self, scene: Scene, found: np.ndarray) -> np.ndarray:
        """Return the acceleration, turned: g cos|a| + (a x g) sin|a|/|a|, a across g."""
        gravity, across = self._across(scene)
        angle = math.hypot(*found)
        return gravity * math.cos(angle) + np.sinc(angle / math.pi) * (across.T @ found)

    def slopes(self, scene: Scene, found: np.ndarray) -> np.ndarray:
        """Return the derivatives of the acceleration by the angles."""
        gravity, across = self._across(scene)
        angle = math.hypot(*found)
        if angle < 1e-8:
            return across.T - np.outer(gravity, found)
        slope = (math.cos(angle) - np.sinc(angle / math.pi)) / angle
        return np.sinc(angle / math.pi) * across.T + np.outer(
            -math.sin(angle) * gravity + slope * (across.T @ found), found / angle)

    def _across(self, scene: Scene) -> Tuple[np.ndarray, np.ndarray]:
        """Return gravity, and what it changes by with each angle, rows."""
        gravity = np.array(scene.effects[self.effect].acceleration)
        if len(gravity) == 2:
            return gravity, np.array([[-gravity[1], gravity[0]]])
        axes = np.linalg.svd(gravity[np.newaxis])[2][1:]
        return gravity, np.cross(axes, gravity)


@dataclass(frozen=True)
class Bias(Unknown):
    """
    What a sensor adds to each of its numbers.

    Attributes
    ----------
    sensor : str
    deviation : float
        Positive, in the unit of the reading.
    density : float
    component : str
        Of a reading with several numbers, one of their names.

    """

    KIND = 'sensor'

    sensor: str = ''
    deviation: float = 0.0
    density: float = 0.0
    component: str = ''


@dataclass(frozen=True)
class Scale(Bias):
    """By how much the scale of a sensor is greater than 1: y = (1 + s) h + noise."""

    UNIT = '1'


AnyUnknown = Union[Wrench, JointTorque, Payload, Number, GravityDirection, Bias, Scale]


def _with_effect(scene: Scene, called: str, record: Any) -> Scene:
    """Return a scene with one more effect, which fits the mechanism."""
    if called in scene.effects:
        raise FieldError('a name that no effect of the scene has', repr(called), '', (called,))
    with at(called):
        record.fit(scene.mechanism)
    return replace(scene, effects={**scene.effects, called: record})


def loads(unknowns: Tuple[Unknown, ...]) -> Dict[str, Tuple[str, ...]]:
    """Return the components of the unknowns that are loads, by their names."""
    return {one.name: one.components for one in unknowns if one.KIND == 'load'}
