# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What sensors read in a state, and its derivatives by all that is estimated."""

import math
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from .motion_code import MotionCode, Seen
from .plant import Plant
from .sensors import (
    AnySensor, BODY, ForceSensor, ImuSensor, JointSensor, PointSensor, PoseSensor, POSITION, RATE,
    Sensor, TORQUE, WrenchSensor)
from .unknowns import Bias, Scale
from ..mechanism.checks import one_of
from ..mechanism.cut_freedoms import cut_freedoms
from ..mechanism.fields import at, FieldError
from ..mechanism.mechanism import GROUND
from ..mechanism.rotations import composed, of_quaternion, quaternions_of


class Reading(NamedTuple):
    """What sensors are expected to read."""

    value: np.ndarray  # Shape (d,)
    slope: np.ndarray  # Shape (d, n): by state, numbers and errors of sensors


class View:
    """A state that sensors look at, with what they have in common found once."""

    def __init__(self, plant: Plant, code: Any, q: np.ndarray, qd: np.ndarray,
                 numbers: np.ndarray, command: np.ndarray, basis: np.ndarray) -> None:
        self._plant, self._code, self.q, self.qd, self.basis = plant, code, q, qd, basis
        self.numbers, self.command = numbers, command
        self.acceleration: Any = None
        self._seen: Any = None
        self._cut: Any = None

    @property
    def seen(self) -> Any:
        """Return what generated code finds."""
        if self._seen is None:
            plant = self._plant
            torque = plant.torque(self.command, self.numbers)[:len(
                plant.kinematic.actuated_joints)]
            data = plant.kinematic
            self.acceleration, lam = data.forward_dynamics(self.q, self.qd, torque)
            if len(lam) > len(data.system.lam):
                # Multipliers of the equations that are not left out, as for the derivatives.
                lam = data.system.lam.copy()
            self._seen = self._code()(self.q, self.qd, self.acceleration, lam, plant.seeds(
                self.q, self.basis, self.numbers))
        return self._seen

    def show(self, gravity: np.ndarray, wrenches: Sequence[np.ndarray]) -> None:
        """Have accelerations that are known and wrenches, of which nothing is differentiated."""
        place, axes, spin, force = (part[0] for part in self._code()(
            self.q, self.qd, self.acceleration, np.zeros(()), None)[1:5])
        # Its code is of the mechanism alone, without gravity.
        force = force - np.append(gravity, 0.0)[:3]
        whole = np.zeros((len(wrenches), 6))
        if len(wrenches):
            whole[:, [2, 3, 4] if len(wrenches[0]) == 3 else slice(6)] = wrenches
        self._seen = Seen(np.zeros((len(self.qd), 0)), *(
            (part, np.zeros((*part.shape, self.basis.shape[1])))
            for part in (place, axes, spin, force, whole)))

    @property
    def cuts(self) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions and rates of cut joints, and their derivatives by the tree's."""
        if self._cut is None:
            self._cut = self._plant.kinematic.measure_cut_joints(self.q, self.qd)
        return self._cut


class Measuring:
    """
    The sensors of a plant.

    Parameters
    ----------
    plant : Plant
    sensors : sequence of Sensor
    errors : sequence of Bias
        Biases and scales of sensors; each adds a number behind those of the plant.

    """

    def __init__(self, plant: Plant, sensors: Sequence[AnySensor],
                 errors: Sequence[Bias]) -> None:
        self.plant, self.sensors = plant, {one.name: one for one in sensors}
        if len(self.sensors) < len(sensors):
            names = [one.name for one in sensors]
            twice = next(name for name in names if names.count(name) > 1)
            raise FieldError('each name once among the sensors', f'{twice!r} twice')
        mechanism = plant.scene.mechanism
        self.planar = mechanism.planar
        self._bodies = {body.name: body for body in mechanism.bodies}
        self._points: List[Tuple[int, np.ndarray]] = []
        self._readers = {}
        self._code: Optional[MotionCode] = None
        self._code_of: Any = None
        self._forces = any(isinstance(one, ForceSensor) for one in sensors)
        self.sizes = {one.name: len(one.components(self.planar)) for one in sensors}
        self.noise = {one.name: np.square(one.deviations(self.planar)) for one in sensors}
        # Whether readings follow from accelerations; whether they are nonlinear in the state: then
        # updates are iterated.
        self.felt = {one.name: isinstance(one, (ImuSensor, ForceSensor)) for one in sensors}
        self.nonlinear = {one.name: not (
            isinstance(one, JointSensor) and one.joint in plant.simulation.joint_names)
            for one in sensors}
        for one in sensors:
            with at('sensors', one.name):
                self._readers[one.name] = self._reader(one)
        # Plain sensors measure numbers of the tree: their indices in (q, qd), and in the basis.
        self._plain: Dict[str, Tuple[int, int]] = {}
        self._chosen: Dict[Tuple[str, ...], Any] = {}
        for one in sensors:
            if not self.nonlinear[one.name] and one.quantity != TORQUE:
                self._plain[one.name] = self._place_of(one)
        self._errors: Dict[str, List[Tuple[int, int, bool]]] = {}
        for place, error in enumerate(errors):
            with at('unknowns', error.name):
                with at('sensor'):
                    one_of(tuple(self.sensors), 'a sensor among')(error.sensor)
                names = self.sensors[error.sensor].components(self.planar)
                if len(names) > 1 or error.component:
                    with at('component'):
                        one_of(names)(error.component)
            self._errors.setdefault(error.sensor, []).append((
                place, names.index(error.component), isinstance(error, Scale)))
        self._extra = len(errors)

    # One function for each kind of sensor, found when it is bound.

    def _reader(self, sensor: Sensor) -> Any:
        if isinstance(sensor, JointSensor):
            return self._of_joint(sensor)
        if isinstance(sensor, ForceSensor):
            return self._of_wrench(sensor)
        if isinstance(sensor, PointSensor):
            points = {point.name: point for point in self.plant.scene.mechanism.points}
            with at('point'):
                point = points[one_of(tuple(points), 'a point among')(sensor.point)]
                if point.body not in self._bodies:
                    raise FieldError('a point of a body that moves', repr(sensor.point))
            return self._of_point(self._add(point.body, point.position))
        with at('body'):
            body = one_of(tuple(self._bodies), 'a body among')(getattr(sensor, 'body'))
        if isinstance(sensor, PoseSensor):
            return self._of_pose(self._add(body, ()), self._axes_of(body))
        return self._of_imu(sensor, self._add(body, sensor.position), self._axes_of(body))

    def _add(self, body: str, position: Sequence[float]) -> int:
        """Return the number of a point of a body among those that code finds."""
        placement = self.plant.simulation.loop_model.placements[body]
        place = np.zeros(3)
        place[:len(position)] = position
        self._points.append((placement.row, placement.place(place)))
        return len(self._points) - 1

    def _axes_of(self, body: str) -> np.ndarray:
        """Return the axes of a body in the frame of its row, columns."""
        return np.asarray(self.plant.simulation.loop_model.placements[body].axes)

    def code(self) -> MotionCode:
        """Return the generated code, compiled now or before."""
        data = self.plant.kinematic
        if self._code is None or self._code_of is not data.system.model:
            self._code_of = data.system.model
            self._code = MotionCode(
                data, self.plant.stepper.parameter_arrays, self._points,
                self._forces and not self.plant.by_points)
        return self._code

    def felt_view(self, time: float, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray,
                  command: np.ndarray) -> View:
        """Return a state with the accelerations and forces that the engine finds, no slopes."""
        plant, size = self.plant, self.plant.size + len(numbers)
        view = View(plant, self.code, q, qd, numbers, command, np.zeros((2 * len(qd), size)))
        view.acceleration = plant.evaluate(time, q, qd, numbers, command)
        view.show(plant.simulation.system.model.gravity, [
            plant.simulation.force(name) for name in self._force_places()] if (
            self._forces) else [])
        return view

    def _force_places(self) -> Tuple[str, ...]:
        """Return the names of the joints, and of cut joints, with forces that are unique."""
        simulation = self.plant.simulation
        return (*simulation.force_places()[0], *(
            cut.name for cut in self.plant.scene.mechanism.cut_joints if simulation.cut_rows))

    def _of_joint(self, sensor: JointSensor) -> Any:
        plant = self.plant
        names, coordinates = plant.simulation.joint_names, plant.simulation.coordinates
        cuts = plant.simulation.mechanism.cut_coordinates.names
        with at('joint'):
            one_of((*names, *cuts), 'a freedom among')(sensor.joint)
        nv = len(names)
        if sensor.joint not in names:
            return self._of_cut_joint(sensor, cuts.index(sensor.joint), nv)
        place = names.index(sensor.joint)
        if sensor.quantity == RATE:
            return lambda view: (view.qd[place:place + 1],
                                 view.basis[nv + place:nv + place + 1])
        if sensor.quantity == POSITION:
            number = int(coordinates.place[place])
            if number < 0:
                raise FieldError('a joint with a number of its own; of an orientation, a '
                                 'PoseSensor', repr(sensor.joint), '', ('joint',))
            return lambda view: (view.q[number:number + 1], view.basis[place:place + 1])
        with at('joint'):
            one_of(plant.torques, 'a joint that takes a torque, or has an unknown one, among')(
                sensor.joint)
        push = plant.torques.index(sensor.joint)

        def torque(view: View) -> Tuple[np.ndarray, np.ndarray]:
            slope = np.zeros((1, view.basis.shape[1]))
            slope[:, view.basis.shape[1] - len(view.numbers):] = plant.by_numbers(
                np.zeros((1, len(plant.keys))), np.eye(len(plant.torques))[push:push + 1],
                view.numbers)
            return plant.torque(view.command, view.numbers)[push:push + 1], slope
        return torque

    def _of_cut_joint(self, sensor: JointSensor, place: int, nv: int) -> Any:
        """Return the reader of a freedom of a cut joint."""
        if sensor.quantity == POSITION:
            return lambda view: (
                view.cuts[0][place:place + 1], view.cuts[2][place:place + 1] @ view.basis[:nv])
        freedom = cut_freedoms(self.plant.scene.mechanism)[sensor.joint]
        if sensor.quantity == TORQUE or freedom.slides:
            raise FieldError('a position, or the rate of a turn, of a cut joint',
                             f'a {sensor.quantity}', '', ('quantity',))
        a, b = (self._add(body, ()) if body != GROUND else None for body in freedom.bodies)
        axes = np.eye(3) if b is None else self._axes_of(freedom.bodies[1])

        def rate(view: View) -> Tuple[np.ndarray, np.ndarray]:
            # The rate of body A relative to B, along an axis of B.
            axis, turns = axes @ freedom.axis, np.zeros((3, view.basis.shape[1]))
            if b is not None:
                axis, turns = view.seen.axes[0][b] @ axis, np.einsum(
                    'ijn,j->in', view.seen.axes[1][b], axis)
            spin, slope = np.zeros(3), np.zeros_like(turns)
            for number, sign in ((a, 1.0), (b, -1.0)):
                if number is not None:
                    spin = spin + sign * view.seen.spin[0][number]
                    slope = slope + sign * view.seen.spin[1][number]
            return view.cuts[1][place:place + 1], (axis @ slope + spin @ turns)[np.newaxis]
        return rate

    def _place_of(self, sensor: Any) -> Tuple[int, int]:
        """Return where the number of a joint is in (q, qd), and its change in the basis."""
        coordinates = self.plant.simulation.coordinates
        place = coordinates.index[sensor.joint]
        if sensor.quantity == RATE:
            return coordinates.nq + place, coordinates.nv + place
        return int(coordinates.place[place]), place

    def plain(self, names: Tuple[str, ...]) -> Any:
        """
        Return places in (q, qd), in the basis, variances, and whether there are rates.

        None unless all are plain.
        """
        if names not in self._chosen:
            places = [self._plain.get(name) for name in names]
            self._chosen[names] = None if None in places or self._extra else (
                *(np.array(part) for part in zip(*places)),
                np.concatenate([self.noise[name] for name in names]),
                any(self.sensors[name].quantity == RATE for name in names))
        return self._chosen[names]

    def _of_point(self, number: int) -> Any:
        size = 2 if self.planar else 3
        return lambda view: tuple(part[number, :size] for part in view.seen.place)

    def _of_pose(self, number: int, axes: np.ndarray) -> Any:
        planar = self.planar

        def pose(view: View) -> Tuple[np.ndarray, np.ndarray]:
            (place, places), (turned, turns) = ([part[number] for part in pair] for pair in (
                view.seen.place, view.seen.axes))
            # The slope of an orientation is by turns about the world's axes.
            rates = _turns(turned, turns)
            frame = turned @ axes
            if planar:
                angle = math.atan2(frame[1, 0], frame[0, 0])
                return np.array([*place[:2], angle]), np.vstack((places[:2], rates[2:]))
            return (np.concatenate((place, quaternions_of(frame[np.newaxis])[0])),
                    np.vstack((places, rates)))
        return pose

    def _of_imu(self, sensor: ImuSensor, number: int, axes: np.ndarray) -> Any:
        if self.planar:
            with at('mounting'):
                if np.ndim(sensor.mounting):
                    raise FieldError('an angle, in the plane', repr(sensor.mounting))
            c, s = math.cos(sensor.mounting), math.sin(sensor.mounting)
            own = axes @ np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        else:
            own = axes @ (of_quaternion(sensor.mounting) if np.ndim(sensor.mounting)
                          else np.eye(3))
        kept = [2, 3, 4] if self.planar else list(range(6))

        def imu(view: View) -> Tuple[np.ndarray, np.ndarray]:
            turned, turns = (part[number] for part in view.seen.axes)
            found = []
            for pair in (view.seen.spin, view.seen.force):
                value, slope = (part[number] for part in pair)
                found.append((own.T @ turned.T @ value, own.T @ (
                    turned.T @ slope + np.einsum('jin,j->in', turns, value))))
            value, slope = (np.concatenate(parts) for parts in zip(*found))
            return value[kept], slope[kept]
        return imu

    def _of_wrench(self, sensor: ForceSensor) -> Any:
        mechanism, places = self.plant.scene.mechanism, self._force_places()
        if not self.plant.simulation.force_places()[0]:
            raise FieldError(
                'joints whose forces follow from the motion',
                'a mechanism where closure equations repeat others, so that forces are not unique')
        with at('joint'):
            one_of(places, 'a joint that is not fixed among')(sensor.joint)
        place = places.index(sensor.joint)
        carrier = next(one.child if hasattr(one, 'child') else one.body_a
                       for one in (*mechanism.joints, *mechanism.cut_joints)
                       if one.name == sensor.joint)
        number = self._add(carrier, ()) if sensor.axes == BODY else None
        axes = self._axes_of(carrier) if sensor.axes == BODY else None
        whole = isinstance(sensor, WrenchSensor)
        kept = ([2, 3, 4] if whole else [3, 4]) if self.planar else (
            list(range(6)) if whole else [3, 4, 5])

        def wrench(view: View) -> Tuple[np.ndarray, np.ndarray]:
            value, slope = (part[place] for part in view.seen.wrench)
            if number is not None:
                turned, turns = (part[number] for part in view.seen.axes)
                halves = [(axes.T @ turned.T @ value[half], axes.T @ (
                    turned.T @ slope[half] + np.einsum('jin,j->in', turns, value[half])))
                    for half in (slice(0, 3), slice(3, 6))]
                value, slope = (np.concatenate(parts) for parts in zip(*halves))
            return value[kept], slope[kept]
        return wrench

    def read(self, name: str, view: View, errors: np.ndarray) -> Reading:
        """Return what a sensor is expected to read."""
        value, slope = self._readers[name](view)
        if not self._extra:
            return Reading(value, slope)
        whole = np.zeros((len(slope), slope.shape[1] + self._extra))
        whole[:, :slope.shape[1]] = slope
        value = np.array(value)
        bare = value.copy()
        for place, row, scale in self._errors.get(name, ()):
            whole[row, slope.shape[1] + place] = bare[row] if scale else 1.0
            value[row] += errors[place] * (bare[row] if scale else 1.0)
            if scale:
                whole[row, :slope.shape[1]] += errors[place] * slope[row]
        return Reading(value, whole)

    def residuals(self, names: Sequence[str], given: Sequence[np.ndarray],
                  values: Sequence[np.ndarray]) -> np.ndarray:
        """Return what several sensors read less what was expected, in a row."""
        return np.concatenate([self.residual(*one) for one in zip(names, given, values)])

    def residual(self, name: str, given: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Return what was read less what was expected; angles by the shorter way."""
        if not isinstance(self.sensors[name], PoseSensor):
            return given - value
        found = given[:3] - value[:3]
        if self.planar:
            found[2] = (found[2] + math.pi) % (2.0 * math.pi) - math.pi
            return found
        # The turn about the world's axes that leads from the expected to the one read.
        x, y, z, w = composed(given[3:], value[3:] * np.array([-1.0, -1.0, -1.0, 1.0]))
        sine = math.sqrt(x * x + y * y + z * z)
        factor = math.copysign(2.0 * math.atan2(sine, abs(w)) / sine if sine else 2.0, w)
        return np.concatenate((found, factor * np.array([x, y, z])))

    def given(self, name: str, value: Any) -> np.ndarray:
        """Return a reading that was handed over as an array, or refuse it."""
        if isinstance(value, float) and self.sizes[name] == 1:
            return np.array((value,))
        found = np.atleast_1d(np.asarray(value, dtype=float))
        size = self.sizes[name] + (
            not self.planar and isinstance(self.sensors[name], PoseSensor))
        if found.shape != (size,):
            raise FieldError(f'{size} numbers', f'shape {found.shape}', '', (name,))
        return found


def _turns(axes: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Return the turns about the world's axes, (3, n), of changes of axes, (3, 3, n)."""
    spin = np.einsum('ikn,jk->ijn', changes, axes)
    return np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]
                    ) / 2.0
