# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What is measured, and how well: records of sensors, which name joints, bodies and points.

Noise is white and normally distributed, of a standard deviation in the unit of the reading. A
value that is handed over at a time was true ``latency`` earlier. ``rate``: how often values come;
one that stays silent for longer is reported (``Consistency.silent``). What a sensor adds
to the truth for longer, a bias or a scale, is an unknown (``unknowns``).
"""

from dataclasses import dataclass, KW_ONLY
from typing import Any, ClassVar, Dict, Optional, Tuple, Union

from ..mechanism.checks import (
    freedom, name, not_negative, number, one_of, one_or_several, orientation, positive, vector)
from ..mechanism.fields import FieldError, normalise, shown

POSITION, RATE, TORQUE = 'position', 'rate', 'torque'
WORLD, BODY = 'world', 'body'
# Late measurements are taken in order up to this age [s].
LONGEST_DELAY = 0.2


def _latency(value: Any) -> float:
    found = not_negative(value)
    if found > LONGEST_DELAY:
        raise FieldError(f'at most {LONGEST_DELAY:g} s, as long as the past is kept', shown(value))
    return found


def _optional(check: Any) -> Any:
    return lambda value: None if value is None else check(value)


@dataclass(frozen=True)
class Sensor:
    """
    What all sensors have in common; they are its subclasses.

    Attributes
    ----------
    name : str
        Of the sensor, by which measurements are handed over.
    rate : float or None
        Values in a second, positive [Hz]; None where they come as they like.
    latency : float
        Age of a value when it is handed over, at most 0.2 s [s].

    """

    #: Names of the numbers of a reading in the plane, and in space.
    PLANE: ClassVar[Tuple[str, ...]] = ('',)
    SPACE: ClassVar[Tuple[str, ...]] = ('',)
    #: Checks of the fields of a kind.
    CHECKS: ClassVar[Dict[str, Any]] = {}

    name: str
    _: KW_ONLY
    rate: Optional[float] = None
    latency: float = 0.0

    def components(self, planar: bool) -> Tuple[str, ...]:
        """Return the names of the numbers of a reading; one empty name for a single number."""
        return self.PLANE if planar else self.SPACE

    def deviations(self, planar: bool) -> Tuple[float, ...]:
        """Return the standard deviations of the numbers of a reading."""
        return len(self.components(planar)) * (getattr(self, 'deviation'),)

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        normalise(self, name=name, rate=_optional(positive), latency=_latency, **self.CHECKS)


@dataclass(frozen=True)
class JointSensor(Sensor):
    """
    The position, rate or torque of a joint: an encoder, a tachometer, a motor current.

    Attributes
    ----------
    joint : str
        A freedom of the tree or of a cut joint, as ``hip.1``.
    deviation : float
        Positive [rad, rad/s, N m; m, m/s, N]. Of n bits in a turn, the resolution of an encoder
        is ``encoder_deviation(n)``.
    quantity : str
        ``'position'``, ``'rate'`` or ``'torque'``: of the last, what drives the joint, as
        commanded and as an unknown ``JointTorque`` adds.

    """

    CHECKS = {'joint': freedom, 'deviation': positive,
              'quantity': one_of((POSITION, RATE, TORQUE))}

    joint: str = ''
    deviation: float = 0.0
    quantity: str = POSITION


@dataclass(frozen=True)
class ImuSensor(Sensor):
    """
    An inertial measurement unit on a body: angular velocity and specific force in its own axes.

    Of the plane: about z; along x and y.

    Attributes
    ----------
    body : str
    gyroscope, accelerometer : float
        Standard deviations, positive [rad/s], [m/s^2].
    position : tuple of 2 floats, or 3 in space
        In the body's frame [m].
    mounting : float, or mapping or quaternion in space
        Of the unit's axes in the body's frame: an angle [rad], or an orientation as in scenes.

    """

    PLANE = 'spin', 'x', 'y'
    SPACE = 'spin_x', 'spin_y', 'spin_z', 'x', 'y', 'z'
    CHECKS = {'body': name, 'gyroscope': positive, 'accelerometer': positive, 'position': vector,
              'mounting': one_or_several(number, orientation)}

    body: str = ''
    gyroscope: float = 0.0
    accelerometer: float = 0.0
    position: Tuple[float, ...] = (0.0, 0.0)
    mounting: Any = 0.0

    def deviations(self, planar: bool) -> Tuple[float, ...]:
        """Return the standard deviations of the numbers of a reading."""
        spins, axes = (1, 2) if planar else (3, 3)
        return (*spins * (self.gyroscope,), *axes * (self.accelerometer,))


@dataclass(frozen=True)
class PointSensor(Sensor):
    """
    The place of a point, in world axes: a camera, a tracker.

    Attributes
    ----------
    point : str
        Of the mechanism.
    deviation : float
        Of each coordinate, positive [m].

    """

    PLANE = 'x', 'y'
    SPACE = 'x', 'y', 'z'
    CHECKS = {'point': name, 'deviation': positive}

    point: str = ''
    deviation: float = 0.0


@dataclass(frozen=True)
class PoseSensor(Sensor):
    """
    The pose of a body: x, y and angle, in space x, y, z and a quaternion x, y, z, w.

    Attributes
    ----------
    body : str
    deviation : float
        Of each coordinate, positive [m].
    angle : float
        Standard deviation of the angle, or about each axis, positive [rad].

    """

    PLANE = 'x', 'y', 'angle'
    SPACE = 'x', 'y', 'z', 'turn_x', 'turn_y', 'turn_z'
    CHECKS = {'body': name, 'deviation': positive, 'angle': positive}

    body: str = ''
    deviation: float = 0.0
    angle: float = 0.0

    def deviations(self, planar: bool) -> Tuple[float, ...]:
        """Return the standard deviations of the numbers of a reading."""
        places, angles = (2, 1) if planar else (3, 3)
        return (*places * (self.deviation,), *angles * (self.angle,))


@dataclass(frozen=True)
class ForceSensor(Sensor):
    """
    The force in a joint or cut joint, as ``Simulation.force`` has it: on the child, or on body A.

    Attributes
    ----------
    joint : str
    deviation : float
        Of each component, positive [N].
    axes : str
        ``'world'``, or ``'body'`` for those of the child, of a cut joint those of body A.

    """

    PLANE = 'x', 'y'
    SPACE = 'x', 'y', 'z'
    CHECKS = {'joint': name, 'deviation': positive, 'axes': one_of((WORLD, BODY))}

    joint: str = ''
    deviation: float = 0.0
    axes: str = WORLD


@dataclass(frozen=True)
class WrenchSensor(ForceSensor):
    """
    Moment and force in a joint or cut joint, about the child's origin, or the cut point of A.

    Attributes
    ----------
    moment : float
        Standard deviation of each component of the moment, positive [N m].

    """

    PLANE = 'moment', 'x', 'y'
    SPACE = 'moment_x', 'moment_y', 'moment_z', 'x', 'y', 'z'
    CHECKS = {**ForceSensor.CHECKS, 'moment': positive}

    moment: float = 0.0

    def deviations(self, planar: bool) -> Tuple[float, ...]:
        """Return the standard deviations of the numbers of a reading."""
        moments, axes = (1, 2) if planar else (3, 3)
        return (*moments * (self.moment,), *axes * (self.deviation,))


AnySensor = Union[JointSensor, ImuSensor, PointSensor, PoseSensor, ForceSensor, WrenchSensor]


def encoder_deviation(bits: int) -> float:
    """Return the standard deviation of rounding to 2^bits steps a turn [rad]."""
    # Evenly distributed over a step.
    return 2.0 * 3.141592653589793 / 2 ** bits / 12 ** 0.5
