# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The setup of an estimator, from a YAML file: sensors, unknowns, noise, and where they come from.

    sensors:
      encoder_1: {type: joint, joint: theta_1, deviation: 1.0e-4, latency: 0.004}
      hand: {type: imu, body: platform, gyroscope: 0.01, accelerometer: 0.1}
    unknowns:
      part: {type: payload, body: platform, position: [0.2, 0.1155], deviation: 10.0}
    suspects:
      link: {type: number, key: mechanism.joints.theta_2.position.0, deviation: 0.01}
    noise: {torque: 0.5}
    start: {position: 0.001, rate: 0.1}
    topics: {hand: /hand/imu}
    names: {motor_1: theta_1}
    torques: effort
    gate: 0.9999

Every error names file, line, key, what was expected and what was got.
"""

from contextlib import contextmanager
from pathlib import Path
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Tuple, Type, Union

from .estimator import EXTENDED, GATE, Noise, SIGMA_POINTS, Start
from .sensors import (
    AnySensor, ForceSensor, ImuSensor, JointSensor, PointSensor, PoseSensor, Sensor, WrenchSensor)
from .unknowns import (
    AnyUnknown, Bias, GravityDirection, JointTorque, Number, Payload, Scale, Unknown, Wrench)
from ..effects.effect import require_body, require_point
from ..mechanism.checks import one_of, probability, text
from ..mechanism.document import Document, plain
from ..mechanism.fields import at, FieldError, keys_of, mapping, shown
from ..mechanism.mechanism import MechanismError
from ..scene.records import Scene

SENSORS: Dict[str, Type[Sensor]] = {
    'joint': JointSensor, 'imu': ImuSensor, 'point': PointSensor, 'pose': PoseSensor,
    'force': ForceSensor, 'wrench': WrenchSensor}
UNKNOWNS: Dict[str, Type[Unknown]] = {
    'wrench': Wrench, 'joint_torque': JointTorque, 'payload': Payload, 'number': Number,
    'gravity': GravityDirection, 'bias': Bias, 'scale': Scale}
# Where torques come from: efforts in joint_states, or commands.
EFFORT, COMMAND = 'effort', 'command'
METHODS = EXTENDED, SIGMA_POINTS
SECTIONS = 'unknowns', 'suspects', 'noise', 'start', 'topics', 'names', 'torques', 'method', 'gate'


class SetupError(ValueError):
    """A file of sensors that cannot be used; the message names file, line and key."""


class Setup(NamedTuple):
    """
    The setup of an estimator.

    Attributes
    ----------
    sensors : tuple of sensors.Sensor
    unknowns, suspects : tuple of unknowns.Unknown
        What is estimated, and what alarms may name.
    noise : estimator.Noise
    start : estimator.Start
        Standard deviations at the start.
    topics : dict of str to str
        Of sensors, where they are others than the sensors' names, of joints ``joint_states``.
    names : dict of str to str
        Joints by their names in messages, where these are others.
    torques : str
        ``EFFORT``: what drives the joints are efforts in ``joint_states``; ``COMMAND``: commands.
    method : str
    gate : float
        Probability with which a good reading is used; others are outliers.

    """

    sensors: Tuple[AnySensor, ...]
    unknowns: Tuple[AnyUnknown, ...]
    suspects: Tuple[AnyUnknown, ...]
    noise: Noise
    start: Start
    topics: Dict[str, str]
    names: Dict[str, str]
    torques: str
    method: str
    gate: float


def read_setup(source: Union[str, Path, Mapping[str, Any]], scene: Scene) -> Setup:
    """
    Read the setup of an estimator of a scene.

    Parameters
    ----------
    source : path-like or mapping
        The file, or its keys and values.
    scene : simulation.scene_records.Scene
        The machine as far as it is known.

    Raises
    ------
    SetupError
        Where the file cannot be read, or does not fit the scene.

    """
    if isinstance(source, Mapping):
        try:
            return _setup(plain(source), scene)
        except FieldError as error:
            raise SetupError(str(error)) from None
    document = Document(source, SetupError)
    with document.errors():
        return _setup(document.data, scene)


def _setup(data: Any, scene: Scene) -> Setup:
    given = mapping(data, ('sensors',), SECTIONS)
    sensors = _records(given, 'sensors', SENSORS, scene)
    unknowns, suspects = (
        _records(given, section, UNKNOWNS, scene) for section in ('unknowns', 'suspects'))
    known = [one.name for one in sensors]
    for one in sensors:
        with at('sensors', one.name):
            _require_place(one, scene)
    for section, one in (*(('unknowns', one) for one in unknowns),
                         *(('suspects', one) for one in suspects)):
        with _of_record(section, one.name, data):
            if isinstance(one, Bias):
                with at('sensor'):
                    one_of(known, 'one of the sensors')(one.sensor)
            scene = one.prepared(scene)
            one.keys(scene)
    with at('topics'):
        topics = {key: _topic(key, value) for key, value in mapping(
            given.get('topics', {}), (), known).items()}
    freedoms = (*scene.mechanism.coordinates.single_names, *scene.mechanism.measured_cuts)
    names = {}
    for key, value in mapping(given.get('names', {})).items():
        with at('names', key):
            names[key] = one_of(freedoms, 'one of the joints')(value)
            if list(names.values()).count(value) > 1:
                raise FieldError('a joint that has no other name yet', repr(value))
    with at('torques'):
        torques = one_of((EFFORT, COMMAND))(given.get('torques', EFFORT))
    with at('method'):
        method = one_of(METHODS)(given.get('method', METHODS[0]))
    noise, start = (_numbers(given, section, kind) for section, kind in (
        ('noise', Noise), ('start', Start)))
    with at('gate'):
        gate = probability(given.get('gate', GATE))
    return Setup(
        sensors, unknowns, suspects, noise, start, topics, names, torques, method, gate)


def _numbers(given: Any, section: str, kind: Any) -> Any:
    """Return a record of numbers alone; state and time of a start are the run's."""
    with at(section):
        _, optional = keys_of(kind, ('state', 'time'))
        return kind(**mapping(given.get(section, {}), (), optional))


def _topic(key: str, value: Any) -> str:
    with at(key):
        found = text(value)
        if not found.strip('/'):
            raise FieldError('the name of a topic', repr(value))
        return found


@contextmanager
def _of_record(section: str, called: str, data: Any) -> Iterator[None]:
    """Lead errors to a record of the file; what is wrong and not there is missing."""
    try:
        yield
    except (FieldError, MechanismError) as error:
        if isinstance(error, MechanismError):
            raise FieldError('what the mechanism can have', str(error),
                             path=(section, called)) from None
        path = error.path[1:] if error.path[:1] in ((called,), ('name',)) else error.path
        if path and path[0] not in data[section][called]:
            raise FieldError('this required key', 'none', error.note or f'{error.expected}',
                             (section, called, path[0])) from None
        raise FieldError(error.expected, error.got, error.note,
                         (section, called, *path)) from None


def _records(data: Any, section: str, kinds: Mapping[str, Any], scene: Scene) -> Any:
    """Return the records of a section, in their order."""
    found = []
    with at(section):
        entries = mapping(data.get(section, {}))
    for called, entry in entries.items():
        with at(section, called):
            mapping(entry, ('type',))
            with at('type'):
                kind = kinds[one_of(tuple(kinds))(entry['type'])]
            # The mechanism says whether it is planar.
            required, optional = keys_of(kind, ('name', 'planar'))
            mapping(entry, ('type', *required), optional)
        with _of_record(section, called, data):
            values = {key: value for key, value in entry.items() if key != 'type'}
            if not scene.mechanism.planar and 'position' in optional:
                values.setdefault('position', (0.0, 0.0, 0.0))
            if kind is GravityDirection:
                values['planar'] = scene.mechanism.planar
            found.append(kind(called, **values))
    if section == 'sensors' and not found:
        raise FieldError('one sensor at least', 'none', path=(section,))
    return tuple(found)


def _require_place(sensor: Sensor, scene: Scene) -> None:
    """Refuse a joint, body or point that the mechanism does not have."""
    mechanism = scene.mechanism
    if isinstance(sensor, JointSensor):
        choices = (*mechanism.coordinates.single_names, *mechanism.measured_cuts)
        with at('joint'):
            one_of(choices, 'one of the joints')(sensor.joint)
    elif isinstance(sensor, ForceSensor):
        with at('joint'):
            one_of([joint.name for joint in (*mechanism.joints, *mechanism.cut_joints)],
                   'one of the joints')(sensor.joint)
    elif isinstance(sensor, PointSensor):
        require_point(mechanism, 'point', sensor.point)
    else:
        require_body(mechanism, 'body', getattr(sensor, 'body'))
        size = 2 if mechanism.planar else 3
        if len(getattr(sensor, 'position', size * (0.0,))) != size:
            with at('position'):
                raise FieldError(f'{size} numbers', shown(list(getattr(sensor, 'position'))))
