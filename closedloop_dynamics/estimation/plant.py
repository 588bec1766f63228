# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The mechanism that is estimated: its steps, moves and unknown numbers, with derivatives."""

from dataclasses import replace
import math
from typing import Any, Dict, List, Mapping, Sequence, Tuple, Union

import numpy as np

from .unknowns import JointTorque, Unknown
from ..codegen import function_table as calls
from ..effects.force_law import FRICTION
from ..kinematics.state import State
from ..mechanism.errors import SimulationError
from ..mechanism.fields import FieldError
from ..scene.key_paths import changed, numbers as numbers_of, resolve
from ..scene.records import Method, Scene
from ..simulation.data import Data
from ..simulation.model import Model
from ..simulation.parameters import parameter_arrays
from ..simulation.simulation import Simulation
from ..simulation.step_derivatives import turned
from ..simulation.stepper import Stepper

# Changes of arrays with an unknown number are straight to this share.
STRAIGHT = 1e-9
# Accelerations with an unknown number set in place, and with a model of it, agree to this share.
AGREE = 1e-9
# Where coordinates would change by so much more, as a root of the sum of squares, than when the
# independent ones were chosen, others are chosen.
MOST_GROWTH = 8.0


class Plant:
    """
    Motion of a scene with unknown numbers.

    Parameters
    ----------
    scene : Scene
        The mechanism as it is thought to be.
    unknowns : sequence of Unknown
    method : str, mapping or Method
        Of the steps, as for ``Stepper``.

    Attributes
    ----------
    model : Model
        With the loads that are unknown.
    stepper : Stepper
    names : tuple of str
        Of the unknown numbers.
    independent : tuple of str
        Names of the independent coordinates; ``size``: twice as many.
    commanded : tuple of str
        Joints that take a command; ``command``: their places among all that take torques.

    """

    #: Whether motions are followed for states around the mean, in the place of derivatives.
    by_points = False

    def __init__(self, scene: Scene, unknowns: Sequence[Unknown],
                 method: Union[str, Mapping[str, Any], Method]) -> None:
        self.unknowns = tuple(unknowns)
        self.names = tuple(name for one in unknowns for name in one.components)
        for name in self.names:
            if self.names.count(name) > 1:
                raise FieldError('each name once among the unknowns', f'{name} twice', '', (name,))
        self.commanded = _freedoms(scene)
        for one in unknowns:
            scene = one.prepared(scene)
        self.scene, self.model = scene, Model(scene)
        self.start = np.array([value for one in unknowns for value in one.start(scene)])
        self._parts: List[Tuple[Unknown, slice, slice]] = []
        first, keys = 0, []
        for one in unknowns:
            own = one.keys(scene)
            for key in own:
                if key in keys:
                    raise FieldError('each number once', f'{key} twice', '', (one.name,))
            self._parts.append((one, slice(first, first + len(one.components)),
                                slice(len(keys), len(keys) + len(own))))
            keys += own
            first += len(one.components)
        self.keys = tuple(keys)
        known = numbers_of(scene)
        self._begin = np.array([known[key] or 0.0 for key in keys])
        self._bind(method)
        self.torques = _freedoms(scene)
        self.command = np.array([self.torques.index(name) for name in self.commanded], dtype=int)
        # Unknown numbers that are torques, and the joints that they act in.
        self._pushing = [(part.start, self.torques.index(one.joint))
                         for one, part, _ in self._parts if isinstance(one, JointTorque)]
        self.independent = self.stepper.independent
        self.size = 2 * len(self.independent)
        self._nv = len(self.simulation.joint_names)
        self._chosen: Tuple[str, ...] = ()
        self._growth = 0.0
        self._adopt()
        self._require_straight()

    def _bind(self, method: Any) -> None:
        """Set up what makes the steps, and what moves states along the manifold."""
        self.stepper = Stepper(self.model, self.scene.method.step_size, method=method,
                               parameters=self.keys)
        self.simulation = self.kinematic = self.stepper.simulation.data
        self.arrays = self.stepper.parameter_arrays

    def _adopt(self) -> None:
        """Take the arrays of the system that the stepper works with now."""
        system = self._system = self.simulation.system
        self._equations = system.model
        arrays = _arrays(system)
        entries, self._written = self.arrays.entries, []
        for source, array in arrays.items():
            rows = [n for n, (one, _) in enumerate(entries) if one == source]
            if rows:
                places = np.array([entries[n][1] for n in rows])
                self._written.append((source, places, array.reshape(-1)[places].copy(),
                                      self.arrays.matrix[rows]))
        self._now = self._begin.copy()

    def put(self, numbers: np.ndarray) -> None:
        """Have other values of the unknown numbers, as many as there are names."""
        if not self.keys:
            return
        if self.simulation.system.model is not self._equations:
            self._adopt()
        values = self._values(numbers)
        if (values == self._now).all():
            return
        self._now = values
        self._write(values - self._begin)

    def _write(self, change: np.ndarray) -> None:
        """Write the arrays' numbers for a change of the values at key paths."""
        for source, places, before, matrix in self._written:
            numbers = before + matrix @ change
            if source != calls.VALUES:
                _arrays(self._system)[source].reshape(-1)[places] = numbers
                continue
            # The engine's own: effects say something else.
            table = self._system.effects
            values = np.array(table.values)
            values.reshape(-1)[places] = numbers
            for row in np.unique(places // values.shape[1]).tolist():
                element = table.elements[row]
                table.put(row, element._replace(
                    values=tuple(values[row, :len(element.values)].tolist())),
                    bool(table.enabled[row]))
        self.simulation.touch()

    def _values(self, numbers: np.ndarray) -> np.ndarray:
        return np.concatenate([
            one.values(self.scene, numbers[part]) for one, part, own in self._parts
            if own.stop > own.start])

    def by_numbers(self, by_key: np.ndarray, by_torque: np.ndarray,
                   numbers: np.ndarray) -> np.ndarray:
        """Return derivatives by the unknown numbers, of those by keys and by torques."""
        found = np.zeros((len(by_key), len(numbers)))
        for one, part, own in self._parts:
            if own.stop > own.start:
                found[:, part] = by_key[:, own] @ one.slopes(self.scene, numbers[part])
        for place, joint in self._pushing:
            found[:, place] = by_torque[:, joint]
        return found

    def torque(self, command: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return the torques of all that take some: the commanded and the unknown ones."""
        found = np.zeros(len(self.torques))
        found[self.command] = command
        for place, joint in self._pushing:
            found[joint] += numbers[place]
        return found

    def _require_straight(self) -> None:
        """Refuse unknown numbers that cannot be set in place, with the name and the reason."""
        deviations = np.array([value for one in self.unknowns for value in one.deviations])
        for one, part, own in self._parts:
            for n, key in enumerate(self.keys[own]):
                place = own.start + n
                size = float(deviations[part].max())
                values = self._begin.copy()
                values[place] += 0.1 * size
                other = Data(changed(self.scene, {resolve(self.scene, key): values[place]}))
                change = values - self._begin
                state = other.position, other.velocity
                arrays = _arrays(other.system)
                for source, places, before, matrix in self._written:
                    array = arrays[source]
                    error = before + matrix @ change - array.reshape(-1)[places]
                    if np.abs(error).max() > STRAIGHT * np.abs(array).max():
                        raise FieldError(
                            'a number that masses and places follow in proportion',
                            'one that they follow by its square or otherwise',
                            'estimate one that they do, such as a mass or a length', (
                                one.name, key))
                self._write(change)
                try:
                    found = self.simulation.forward_dynamics(*state)[0]
                except SimulationError:
                    found = np.full(len(state[1]), np.nan)
                self._write(0.0 * change)
                wanted = other.forward_dynamics(*state)[0]
                if not np.abs(found - wanted).max() <= AGREE * max(np.abs(wanted).max(), 1e-3):
                    raise FieldError(
                        'a number that the code for this mechanism reads',
                        f'one of {self._begin[place]:g}, which its code has as a constant',
                        'give it a value that is neither 0 nor 1', (one.name, key))

    # Coordinates.

    def basis(self, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return changes of all displacements and rates, (2 nv, 2 k + m), with all unknowns."""
        found = self.stepper.basis_at(q, qd)
        count = self.size
        if not len(numbers):
            return found.copy()
        return np.hstack((found[:, :count], self.by_numbers(
            found[:, count:], np.zeros((len(found), len(self.torques))), numbers)))

    def plus(self, q: np.ndarray, qd: np.ndarray, change: np.ndarray,
             numbers: np.ndarray, near: bool = False) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return a state after a change of independent coordinates and rates, and new numbers.

        ``near``: as of ``Stepper.moved``.
        """
        self.put(numbers)
        places, rates = self.stepper.moved(q, qd, change[np.newaxis], near)
        return places[0], rates[0]

    def take(self, independent: Sequence[str]) -> None:
        """Have these independent coordinates."""
        if independent is not self.independent and tuple(independent) != self.independent:
            self.stepper.change_independent(independent)
            self.independent = self.stepper.independent

    def exchanged(self, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Choose independent coordinates anew; return the changes of new ones with all before."""
        before = self.basis(q, qd, numbers)
        self.stepper.q[:], self.stepper.qd[:] = q, qd
        self.stepper.change_independent()
        self.independent = self.stepper.independent
        own = np.array([self.simulation.joint_names.index(name) for name in self.independent])
        return before[np.concatenate((own, len(qd) + own))]

    def outgrown(self, q: np.ndarray, qd: np.ndarray) -> bool:
        """Return whether dependent coordinates change much more than when they were chosen."""
        basis = self._present_basis(q, qd)[:self._nv, :self.size // 2]
        grown = math.sqrt(np.vdot(basis, basis))
        if self._chosen != self.independent:
            self._chosen, self._growth = self.independent, grown
        return grown > MOST_GROWTH * self._growth

    def _present_basis(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the basis of a state, or that of the one before a step, which is there."""
        return self.stepper.basis

    # Steps.

    def step(self, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray, command: np.ndarray,
             duration: float) -> Tuple[np.ndarray, ...]:
        """Return q, qd later, and their derivatives by state, numbers and torques."""
        self.put(numbers)
        stepper = self.stepper
        if duration != stepper.period:
            stepper.period = duration
        stepper.q[:], stepper.qd[:] = q, qd
        if self._pushing or len(command) != len(self.torques):
            stepper.tau[:] = self.torque(command, numbers)
        else:
            stepper.tau[:] = command
        stepper()
        by_number = stepper.by_parameter
        if len(numbers):
            by_number = self.by_numbers(stepper.by_parameter, stepper.B, numbers)
        return stepper.next_q.copy(), stepper.next_qd.copy(), stepper.A, by_number, stepper.B

    def seeds(self, q: np.ndarray, basis: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return inputs of generated code that change along all unknowns, (2 k + m, inputs)."""
        nv, size = len(basis) // 2, basis.shape[1]
        torque = self.by_numbers(np.zeros((len(self.torques), len(self.keys))),
                                 np.eye(len(self.torques)), numbers)
        whole = np.zeros((nv, size))
        names = self.simulation.joint_names
        whole[[names.index(name) for name in self.torques], size - len(numbers):] = torque
        keys = np.zeros((len(self.keys), size))
        for one, part, own in self._parts:
            if own.stop > own.start:
                first = size - len(numbers)
                keys[own, first + part.start:first + part.stop] = one.slopes(
                    self.scene, numbers[part])
        matrix = self.stepper.parameter_arrays.matrix
        return np.ascontiguousarray(np.vstack((
            turned(self._system.manifold, q, basis[:nv]), basis[nv:], whole,
            matrix @ keys[:matrix.shape[1]])).T)

    def require_state(self, state: State) -> None:
        """Refuse a state of another mechanism, or one that leaves the loops open."""
        if not isinstance(state, State) or state.is_batch:
            raise ValueError(f'start: expected a single State, got {state!r}')
        self.simulation.require_state(self.state(state.time, state.q, state.qd, self.own)
                                      if state.coordinates.names == self.simulation.joint_names
                                      else state)
        self.simulation.require_closed(state.q, state.qd)

    @property
    def own(self) -> np.ndarray:
        """Return the effects' own states where they begin."""
        return np.array(self.simulation.snapshot().own)

    def state(self, time: float, q: np.ndarray, qd: np.ndarray, own: np.ndarray) -> State:
        """Return a state of the model."""
        return State(time, q, qd, own, self.simulation.coordinates)


class PointsPlant(Plant):
    """
    Motion of a scene whose effects jump: by the engine, for states around the mean.

    Dry friction, contacts and stops have no derivatives. The loops' are those of the mechanism
    alone, whose lengths are known.
    """

    by_points = True

    def _bind(self, method: Any) -> None:
        lengths = [key for key in self.keys if key.startswith('mechanism.') and not (
            key.split('.')[1] == 'bodies')]
        if lengths:
            raise FieldError('lengths that are known, with sigma points', f'{lengths[0]} unknown')
        bare = replace(self.scene, effects={}, switched_off=())
        self.stepper = Stepper(Model(bare), self.scene.method.step_size, jacobians=False)
        self.kinematic = self.stepper.simulation.data
        self._run = Simulation(self.model, None, self.scene.with_method(method).method)
        self.simulation = self._run.data
        self.arrays = parameter_arrays(self.simulation, self.keys)
        # Whether friction of each joint knows the direction in which it slides.
        self._rubbing = np.zeros(len(self.own), dtype=bool)
        table = self.simulation.system.effects
        for row in [] if table is None else table.rows:
            if row.law.role == FRICTION:
                self._rubbing[row.state] = True
        if self.simulation.effect_set.delays:
            raise FieldError('drives that act at once', 'one with a delay', '', ('effects',))

    def basis(self, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Return changes of all displacements and rates; numbers move nothing at once."""
        found = self.stepper.basis_at(q, qd)
        return np.hstack((found, np.zeros((len(found), len(numbers)))))

    def _present_basis(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return self.stepper.basis_at(q, qd)

    def evaluate(self, time: float, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray,
                 command: np.ndarray) -> np.ndarray:
        """Have a state evaluated under torques, by ``simulation``; return the accelerations."""
        self.put(numbers)
        self._run.stepping.begin_at(self.model.state(q, qd, time=time))
        torque, simulation = self.torque(command, numbers), self.simulation
        found, _ = simulation.forward_dynamics(q, qd, torque)
        simulation.system.tau[:] = 0.0
        simulation.system.tau[simulation.actuated] = torque
        simulation.touch()
        return found

    def after(self, time: float, q: np.ndarray, qd: np.ndarray, numbers: np.ndarray,
              command: np.ndarray, duration: float, own: np.ndarray) -> Tuple[np.ndarray, ...]:
        """Return q, qd and the effects' own states later; friction begins as the rates are."""
        self.put(numbers)
        begun = self.model.state(q, qd, time=time)
        simulation = self._run
        simulation.stepping.begin_at(replace(
            begun, own=np.where(self._rubbing, begun.own, own)))
        simulation.step(self.torque(command, numbers), duration)
        return simulation.position, simulation.velocity, simulation.snapshot().own


def _freedoms(scene: Scene) -> Tuple[str, ...]:
    """Return the names of the freedoms of the tree that take torques."""
    coordinates = scene.mechanism.coordinates
    return tuple(coordinates.names[place] for place in coordinates.actuated)


def _arrays(system: Any) -> Dict[int, np.ndarray]:
    """Return the arrays that generated code reads, by their places in its table."""
    model, effects = system.model, system.effects
    return {calls.BODY: model.body, calls.GRAVITY: model.gravity, calls.CUT_POINT: model.cut_point,
            calls.VALUES: np.zeros(0) if effects is None else effects.values}
