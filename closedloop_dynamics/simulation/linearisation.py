# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linear models of a scene, equilibria and modes, in independent coordinates."""

from dataclasses import dataclass
from importlib import import_module
import math
from typing import Optional, Tuple

import numpy as np

from .derivatives import Differentiator
from .independent import changes_along, choose_independent, dependent_on, places_of
from .readings import readings_of
from .step_derivatives import turned
from ..mechanism.coordinates import QUANTITIES
from ..mechanism.errors import AssemblyError, SimulationError
from ..mechanism.extras import of_an_extra
from ..mechanism.named_array import reals

# What outputs may be.
OUTPUTS = tuple(QUANTITIES)[:3]
# Newton's method for equilibria: steps at most, the longest step [rad, m], and the acceleration
# that is rest, beside what a unit of torque would cause.
MOST_STEPS, LONGEST_STEP, AT_REST = 100, 0.3, 1e-10
# Local error of flows.
FLOW_TOLERANCE = 1e-11
# Rates of modes below this share of those that joints would have alone are zero: what is left of
# their squares is rounding.
ZERO_RATE = 1e-6
# What is left of an asymmetry by rounding.
SYMMETRIC = 1e-7


@dataclass(frozen=True)
class LinearModel:
    """
    Motion near a state, to first order: x' = A x + B u, y = C x + D u.

    x are changes of the independent coordinates and of their rates, u of the torques, y of the
    outputs. Where the state moves, the derivative is that of the deviation from its motion.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, m), (p, n), (p, m).
    states, inputs, outputs : tuple of str
        ``position.crank``, ``velocity.crank``; joints that are actuated; ``position.rocker``.
    state_units, input_units, output_units : tuple of str
        ``rad``, ``m``, ``rad/s``, ``N m``, ...
    period : float or None
        Of a model in discrete time [s]: x is the change a period later.

    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: Tuple[str, ...]
    inputs: Tuple[str, ...]
    outputs: Tuple[str, ...]
    state_units: Tuple[str, ...]
    input_units: Tuple[str, ...]
    output_units: Tuple[str, ...]
    period: Optional[float] = None

    def __repr__(self):
        """Show the names of states, inputs and outputs, and whether small motions die away."""
        largest = np.linalg.eigvals(self.A)
        largest = largest.real.max(initial=-math.inf) if self.period is None else np.abs(
            largest).max(initial=0.0)
        what, time = ('largest real part', 'continuous time') if self.period is None else (
            'largest magnitude', f'period {self.period:g} s')
        return (f'<LinearModel in {time}: states {", ".join(self.states)}; inputs '
                f'{", ".join(self.inputs) or "none"}; {len(self.outputs)} outputs; {what} of the '
                f'eigenvalues {largest:.6g}>')

    def to_control(self):
        """
        Return a ``control.StateSpace`` of the python-control package.

        Names have colons in the place of dots, which it does not allow.

        Raises
        ------
        MissingLibraryError
            Where that is not installed.

        """
        with of_an_extra():
            control = import_module('control')
        states, inputs, outputs = ([name.replace('.', ':') for name in names] for names in (
            self.states, self.inputs, self.outputs))
        return control.ss(
            self.A, self.B, self.C, self.D, 0 if self.period is None else self.period,
            states=states, inputs=inputs, outputs=outputs)


@dataclass(frozen=True)
class Equilibrium:
    """
    A position at rest.

    Attributes
    ----------
    position : ndarray, shape (nq,)
        [rad or m].
    torque : dict of str to float
        Of the actuated joints [N m or N].
    growth : float
        Largest real part of the eigenvalues there [1/s]; -inf without degrees of freedom.
    stable : bool or None
        Whether small motions die away; None where the first order does not decide: some neither
        grow nor die away.

    """

    position: np.ndarray
    torque: dict
    growth: float
    stable: Optional[bool]


@dataclass(frozen=True)
class Mode:
    """
    A natural mode near an equilibrium.

    Attributes
    ----------
    frequency : float
        Of the oscillation [Hz]; 0 where there is none.
    damping : float
        Share of critical damping; NaN where the eigenvalue is zero. Less than 0 where the motion
        grows.
    eigenvalue : complex
        [1/s].
    shape : ndarray, shape (nv,)
        Changes of all joint coordinates, the largest 1; complex where joints move out of step.

    """

    frequency: float
    damping: float
    eigenvalue: complex
    shape: np.ndarray


class Linearisation:
    """
    Linear models, equilibria and modes of a scene.

    Parameters
    ----------
    simulation : Simulation
        Its state stays as it is.
    independent : sequence of str, optional
        Freedoms of the tree to take as coordinates, as many as there are degrees of freedom; where
        not given, in each position those that move most of a set, actuated ones first.

    Raises
    ------
    SimulationError
        Where an effect has no derivative, with its name and the reason.
    ValueError
        For unknown names.

    """

    def __init__(self, simulation, independent=None):
        self._data = data = readings_of(simulation)
        self._names = data.joint_names
        self._asked = places_of(self._names, independent)
        self._differentiate = Differentiator(data)
        self._inputs = [self._names.index(name) for name in data.actuated_joints]
        self._units = {what: np.array(data.coordinates.units(what)) for what in QUANTITIES}

    def __repr__(self):
        """Show the mechanism and the independent coordinates."""
        own = ', '.join(self._names[place] for place in self._asked or ())
        return (f'<Linearisation of {self._data.scene.name}, independent: '
                f'{own or "chosen in each position"}>')

    def linear_model(self, position=None, velocity=None, torque=None, outputs=('position',)):
        """
        Linearise the motion in a state.

        Parameters
        ----------
        position, velocity : sequence, optional
            Closing the loops; the present ones where not given.
        torque : mapping, sequence or None
            As for ``Simulation.step``.
        outputs : sequence of str
            Of all joints: ``'position'``, ``'velocity'``, ``'acceleration'``.

        Returns
        -------
        LinearModel

        Raises
        ------
        SingularityError
            Where closure equations depend on one another.
        ValueError

        """
        q, qd = self._state(position, velocity)
        return self._model(q, qd, torque, outputs, None)[0]

    def _state(self, position, velocity):
        """Return a state given, or the present one."""
        data = self._data
        return (data.position if position is None else reals('position', position),
                data.velocity if velocity is None else reals('velocity', velocity))

    def _model(self, q, qd, torque, outputs, chosen):
        """Return a linear model, the derivatives and the tangents; coordinates may be chosen."""
        for name in outputs:
            if name not in OUTPUTS:
                raise ValueError(
                    f'outputs: expected some of {", ".join(OUTPUTS)}, got {name!r}')
        found = self._differentiate(q, qd, torque)
        nv = len(qd)
        own, along, bent = self._tangents(found, chosen)
        n, m = len(own), len(self._inputs)
        by_position = found.by_position[:nv] @ along + found.by_velocity[:nv] @ bent
        by_velocity, by_torque = found.by_velocity[:nv] @ along, found.by_torque[
            :nv, self._inputs]
        none = np.zeros((nv, m))
        of = {'position': (along, np.zeros((nv, n)), none), 'velocity': (bent, along, none),
              'acceleration': (by_position, by_velocity, by_torque)}
        # Changes of orientations are reported in axes that turn.
        turning = -self._spin(qd) @ along
        a = np.block([[turning[own], np.eye(n)], [by_position[own], by_velocity[own]]])
        b = np.concatenate((np.zeros((n, m)), by_torque[own]))
        c = np.concatenate([np.hstack(of[name][:2]) for name in outputs] or [np.zeros((0, 2 * n))])
        d = np.concatenate([of[name][2] for name in outputs] or [np.zeros((0, m))])
        names, units = np.array(self._names), self._units
        model = LinearModel(
            a, b, c, d, *(tuple(some) for some in (
                [f'{what}.{name}' for what in OUTPUTS[:2] for name in names[own]],
                names[self._inputs].tolist(),
                [f'{what}.{name}' for what in outputs for name in names],
                [unit for what in OUTPUTS[:2] for unit in units[what][own].tolist()],
                units['effort'][self._inputs].tolist(),
                [unit for what in outputs for unit in units[what].tolist()])))
        return model, found, own, along, bent

    def _spin(self, qd):
        """Return the matrix that turns changes of orientations with their axes."""
        matrix, manifold = np.zeros((len(qd), len(qd))), self._data.system.manifold
        for _, first in [] if manifold is None else manifold.balls.tolist():
            x, y, z = qd[first:first + 3]
            matrix[first:first + 3, first:first + 3] = ((0, -z, y), (z, 0, -x), (-y, x, 0))
        return matrix

    def _tangents(self, found, chosen):
        """
        Return the independent coordinates, and the changes of the others with them.

        Returns
        -------
        own : list of int
        along, bent : ndarray, shape (nv, n)
            Changes of all coordinates, and of all rates with the independent ones held, for a unit
            change of each independent coordinate.

        """
        jac = found.jacobian
        own = self._asked if chosen is None else chosen
        if own is None:
            own = choose_independent(jac, self._inputs)
        rest = dependent_on(jac, own, self._names)
        along, bent = changes_along(jac, own, rest, found.closure_rate_by_position)
        return list(own), along, bent

    def tangents(self, position, velocity):
        """
        Return the derivatives without torques in a state, and its independent coordinates.

        Parameters
        ----------
        position, velocity : ndarray, shape (nq,), (nv,)
            Closing the loops.

        Returns
        -------
        derivatives : derivatives.Derivatives
        own : list of int
            Places of the independent coordinates.
        along : ndarray, shape (nv, n)
            Changes of all coordinates with these.

        """
        found = self._differentiate(position, velocity)
        own, along, _ = self._tangents(found, None)
        return found, own, along

    def discrete_model(self, period, position=None, velocity=None, torque=None,
                       outputs=('position',)):
        """
        Differentiate the motion over a period, torques held, by its start and by the torques.

        Parameters
        ----------
        period : float
            [s], positive.
        position, velocity, torque, outputs
            As for ``linear_model``: at the start of the period.

        Returns
        -------
        LinearModel
            In discrete time; the outputs are those at the start.

        Raises
        ------
        SimulationError
            Where a motion cannot be followed over the period.
        SingularityError
        ValueError

        """
        from scipy.integrate import solve_ivp
        if not (math.isfinite(period) and period > 0.0):
            raise ValueError(f'period: expected a finite number > 0 [s], got {period!r}')
        if self._data.effect_set.follows_time:
            raise SimulationError('forces follow the time: their model in discrete time would '
                                  'change from period to period. Switch them off.')
        q, qd = self._state(position, velocity)
        model, _, own, _, _ = self._model(q, qd, torque, outputs, None)
        nq, nv, n, m = len(q), len(qd), len(model.states), len(model.inputs)
        manifold = self._data.system.manifold

        def rates(_, values):
            # Stages of the first long steps leave the loops by more than rounding.
            q, qd = self._data.closed(values[:nq], values[nq:nq + nv])
            flow = values[nq + nv:].reshape(n, n + m)
            now, found, *_ = self._model(q, qd, torque, (), own)
            change = now.A @ flow
            change[:, n:] += now.B
            moving = turned(manifold, q, qd[:, np.newaxis])[:, 0]
            return np.concatenate((moving, found.acceleration, change.ravel()))

        start = np.concatenate((q, qd, np.eye(n, n + m).ravel()))
        run = solve_ivp(rates, (0.0, period), start, method='DOP853', rtol=FLOW_TOLERANCE,
                        atol=FLOW_TOLERANCE)
        if not run.success:
            raise SimulationError(f'The motion cannot be followed over {period:g} s: '
                                  f'{run.message}')
        flow = run.y[nq + nv:, -1].reshape(n, n + m)
        return LinearModel(
            flow[:, :n], flow[:, n:], model.C, model.D, model.states, model.inputs, model.outputs,
            model.state_units, model.input_units, model.output_units, float(period))

    def static_torque(self, position=None):
        """
        Return the torques that hold a position, by actuated joint [N m or N].

        Raises
        ------
        SimulationError
            Where the actuated joints cannot hold it.

        """
        data, (q, _) = self._data, self._state(position, None)
        rest = np.zeros(len(self._names))
        torque, _ = data.inverse_dynamics(q, rest, rest)
        return dict(zip(data.actuated_joints, torque.tolist()))

    def equilibrium(self, torque=None, position=None):
        """
        Find a position near another one that constant torques hold.

        The way leads downhill: to a stable position, but for a start at rest in another one.

        Parameters
        ----------
        torque : mapping, sequence or None
            As for ``Simulation.step``.
        position : sequence, shape (nq,), optional
            Closing the loops, near the one sought; the present one where not given.

        Returns
        -------
        Equilibrium

        Raises
        ------
        SimulationError
            Where none is found from there.
        SingularityError
            Where the way leads through a position with dependent closure equations.

        """
        q, _ = self._state(position, None)
        rest, longest, last = np.zeros(len(self._names)), LONGEST_STEP, None
        for _ in range(MOST_STEPS):
            model, found, own, along, _ = self._model(q, rest, torque, (), None)
            wanting, response = found.acceleration[own], found.by_torque[own][:, own]
            # Beside what a unit of torque or force in these coordinates would cause.
            if np.abs(wanting).max(initial=0.0) <= AT_REST * np.abs(response).max(initial=0.0):
                return self._resting(q, torque, model, _rate(found))
            if last is not None and found.acceleration @ last < 0.0:
                # Gone too far.
                longest *= 0.5
            last = along @ _downhill(model.A[len(own):, :len(own)], response, wanting)
            last = last * min(1.0, longest / max(np.abs(last).max(), 1e-300))
            q, _ = self.deflected(q, last, rest)
        raise SimulationError(
            f'No equilibrium was found near the position given: {MOST_STEPS} steps left '
            f'accelerations of {np.abs(wanting).max():.3g}. Give a position nearer to it, or '
            'torques that hold one.')

    def deflected(self, position, change, rates):
        """
        Return a state near a position, with the loops closed.

        Parameters
        ----------
        position : sequence, shape (nq,)
            Closing the loops.
        change, rates : array_like, shape (nv,)
            Of the coordinates [rad or m], and of the state [rad/s or m/s], as far as the loops
            leave them.

        Returns
        -------
        position, velocity : ndarray, shape (nq,), (nv,)

        Raises
        ------
        SimulationError
            Where the loops cannot be closed there.

        """
        manifold, moved = self._data.system.manifold, np.array(position, dtype=float)
        if manifold is None:
            moved += change
        else:
            manifold.move(moved, np.array(change, dtype=float), 1.0)
        try:
            return self._data.closed(moved, rates)
        except AssemblyError:
            raise SimulationError('The loops cannot be closed that far from the position given: '
                                  'give one nearer to what is sought, or a smaller amplitude.'
                                  ) from None

    def _resting(self, q, torque, model, rate):
        """Return an equilibrium."""
        growth = float(_eigenvalues(model, rate).real.max(initial=-math.inf)) + 0.0
        limit = ZERO_RATE * rate
        data = self._data
        tau = data.joint_torques(torque)
        return Equilibrium(
            q, dict(zip(data.actuated_joints, tau[self._inputs].tolist())), growth,
            None if abs(growth) <= limit else growth < 0.0)

    def modes(self, position=None, torque=None):
        """
        Return the modes of small motions about a position at rest.

        Parameters
        ----------
        position : sequence, shape (nq,), optional
            An equilibrium; the present position where not given.
        torque : mapping, sequence or None
            What holds it; where not given, ``static_torque``.

        Returns
        -------
        list of Mode
            From the slowest to the fastest; of each pair of conjugate eigenvalues the one with a
            positive imaginary part.

        Raises
        ------
        SimulationError
            Where the position is not at rest under these torques.

        """
        q, _ = self._state(position, None)
        torque = self.static_torque(q) if torque is None else torque
        model, found, own, along, _ = self._model(q, np.zeros(len(self._names)), torque, (), None)
        n = len(own)
        response = found.by_torque[own][:, own]
        if np.abs(found.acceleration).max(initial=0.0) > 1e-6 * np.abs(response).max(initial=0.0):
            raise SimulationError(
                'Modes are those of a position at rest; under these torques joints accelerate by '
                f'up to {np.abs(found.acceleration).max():.3g} rad/s^2 or m/s^2. Take the '
                'position of `equilibrium`, or the torques of `static_torque`.')
        if n == 0:
            return []
        rate = _rate(found)
        if _undamped(model, rate):
            values, shapes = _second_order(model.A[n:, :n], response)
        else:
            values, vectors = np.linalg.eig(model.A)
            some = values.imag >= -1e-12 * np.abs(values).max()
            values, shapes = values[some], vectors[:n, some]
        found = [_mode(value if abs(value) > ZERO_RATE * rate else 0.0j, along @ shape)
                 for value, shape in zip(values, shapes.T)]
        return sorted(found, key=lambda one: (abs(one.eigenvalue), one.eigenvalue.real))


def _rate(found):
    """Return the rate [1/s] that joints would have alone, with all loops open."""
    return math.sqrt(np.abs(found.by_position[:len(found.acceleration)]).max(initial=0.0))


def _undamped(model, rate):
    """Return whether nothing depends on the rates."""
    n = len(model.A) // 2
    return np.abs(model.A[n:, n:]).max(initial=0.0) <= 1e-9 * rate


def _eigenvalues(model, rate):
    """Return eigenvalues; without damping as roots of those of the second order."""
    if not _undamped(model, rate):
        return np.linalg.eigvals(model.A)
    n = len(model.A) // 2
    roots = np.sqrt(np.linalg.eigvals(model.A[n:, :n]).astype(complex))
    return np.concatenate((roots, -roots))


def _second_order(stiffness, response):
    """Return eigenvalues and shapes of s'' = stiffness s, of each pair of opposite ones one."""
    from scipy.linalg import eigh
    inertia = np.linalg.inv(0.5 * (response + response.T))
    symmetric = inertia @ stiffness
    if np.abs(symmetric - symmetric.T).max() <= SYMMETRIC * np.abs(symmetric).max():
        squares, shapes = eigh(0.5 * (symmetric + symmetric.T), inertia)
    else:
        # Forces that follow the bodies have no energy.
        squares, shapes = np.linalg.eig(stiffness)
    return np.sqrt(squares.astype(complex)), shapes


def _downhill(stiffness, response, wanting):
    """Return a step of Newton's method, against the stiffness where that drives away."""
    from scipy.linalg import eigh
    inertia = np.linalg.inv(0.5 * (response + response.T))
    symmetric = inertia @ stiffness
    squares, shapes = eigh(0.5 * (symmetric + symmetric.T), inertia)
    squares, force = np.abs(squares), shapes.T @ inertia @ wanting
    # Where nothing drives back there is nothing to go for.
    some = squares > 1e-10 * squares.max()
    return shapes[:, some] @ (force[some] / squares[some])


def _mode(value, shape):
    """Return a mode of an eigenvalue; its shape real where joints move in step."""
    largest = shape[np.argmax(np.abs(shape))]
    shape = shape / largest
    if np.abs(shape.imag).max() < 1e-9:
        shape = shape.real
    size = abs(value)
    # No zero has a sign.
    return Mode(float(abs(value.imag)) / (2.0 * math.pi),
                0.0 - float(value.real) / size if size else math.nan, complex(value), shape)
