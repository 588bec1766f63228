# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Discrete steps of states, with their Jacobians, on the manifold of states that close loops."""

import math
from typing import Any, Dict, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike

from .independent import choose_independent, dependent_on, places_of
from .model import Model
from .parameters import parameter_arrays
from .sensitivity import require_differentiable
from .simulation import Simulation
from .step_derivatives import StepDerivatives
from .stepped_run import (
    allocate_chart, allocate_scratch, allocate_steps, allocate_tape, RunInputs, SteppedRun)
from .traced_scene import require_derivatives
from ..codegen.sensitivities import CLOSURE, FORWARD, REVERSE
from ..engine import native
from ..engine.status import (
    DONE, INTERRUPTED, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, SINGULAR)
from ..kinematics.state import State
from ..mechanism.errors import AssemblyError, ClosureError, NumericalError, SingularityError
from ..mechanism.named_array import reals
from ..scene.integrators import INTEGRATORS, STABILISATIONS
from ..scene.records import Method

# Steps of a period at most this share longer than the method's step size are rounding.
ROUNDING = 1e-9
# Periods whose runs are kept.
MOST_PERIODS = 64
# What users call the engine's arrays.
_ARRAYS = {'q': 'q', 'qd': 'qd', 'tau': 'torque', 'next_q': 'next_q', 'next_qd': 'next_qd',
           'A': 'by_state', 'B': 'by_torque', 'by_parameter': 'by_parameter', 'basis': 'basis'}
ENDS = {
    OPEN_LOOP: (ClosureError, 'the loops cannot be closed after the step: take smaller steps'),
    SINGULAR: (SingularityError, 'there is no derivative here: closure equations depend on one '
               'another, or nearly, or the independent coordinates do not determine all others'),
    POOR_EQUATIONS: (SingularityError, 'the closure equations that would have to be worked on '
                     'change within the step: take smaller steps'),
    NOT_FINITE: (NumericalError, 'the numbers grow beyond all bounds: take smaller steps')}


class Step(NamedTuple):
    """
    States a period later, and their Jacobians; a batch has a leading axis.

    Attributes
    ----------
    state : State
        After the period; the effects' own states are as before it.
    A, B, by_parameter : ndarray
        As of ``Stepper``.
    independent : tuple of str
        Freedoms whose displacements and rates these are of.
    basis : ndarray
        As of ``Stepper``.

    """

    state: State
    A: np.ndarray
    B: np.ndarray
    by_parameter: np.ndarray
    independent: Tuple[str, ...]
    basis: np.ndarray


class Stepper:
    """
    The state a period later, torques held, of one state after another, with its Jacobians.

    For estimators and predictive controllers, at the least cost of a call from Python: write
    states and torques into ``q``, ``qd`` and ``tau`` and call the stepper; then ``next_q``,
    ``next_qd``, ``A``, ``B`` and ``by_parameter`` hold the results, until the next call. It works
    on a copy of the mechanism; each thread needs its own.

    Parameters
    ----------
    model : Model
        It stays as it is.
    period : float
        [s].
    method : str, mapping or Method
        As for ``Simulation``: ``semi_implicit_euler``, ``heun`` or ``rk4``, stabilised by
        ``projection``, ``velocity_projection`` or ``none``.
    steps : int, optional
        Steps of the method in a period; where not given, as few as are no longer than the step
        size of the method.
    jacobians : bool
        Whether Jacobians are wanted.
    parameters : sequence of str
        Key paths of numbers of the scene that the step is differentiated by.
    independent : sequence of str, optional
        Freedoms of the tree whose coordinates and rates are independent, as many as there are
        degrees of freedom; where not given, those that move most at the scene's start, actuated
        ones first. ``change_independent`` takes others.
    count : int, optional
        How many states a call advances; where not given, one, and arrays have no leading axis.

    Attributes
    ----------
    q, next_q : ndarray, shape (nq,), or (count, nq)
        Joint coordinates before and after the period [rad or m]; those before close the loops.
    qd, next_qd : ndarray, shape (nv,), or (count, nv)
        Joint rates [rad/s or m/s].
    tau : ndarray, shape (na,), or (count, na)
        Torques of the actuated joints [N m or N].
    A : ndarray, shape (2 n, 2 n), or (count, 2 n, 2 n)
        Derivative of the state after the period by that before it, in independent coordinates: n
        displacements, then n rates. Displacements of orientations are rotations about the axes of
        the child.
    B : ndarray, shape (2 n, na), or (count, 2 n, na)
        By the torques.
    by_parameter : ndarray, shape (2 n, np), or (count, 2 n, np)
        By the parameters, the independent coordinates and rates before the period held.
    basis : ndarray, shape (2 nv, 2 n + np), or (count, 2 nv, 2 n + np)
        Changes of all displacements and rates before the period with the independent ones, and
        with the parameters.

    Raises
    ------
    SimulationError
        Where an effect has no derivative, or the mechanism is too large, with names and reasons.
    ValueError
        For other methods, with the reason; for names and numbers that do not exist, or that the
        motion does not follow smoothly.

    Notes
    -----
    The arithmetic of the steps is differentiated, with the corrections that close the loops, as
    ``Sensitivity`` does: one pass in reverse for each row of the Jacobians.

    Examples
    --------
    >>> stepper = Stepper(model, 0.01)
    >>> stepper.q[:], stepper.qd[:], stepper.tau[:] = state.q, state.qd, torque
    >>> stepper()
    >>> covariance = stepper.A @ covariance @ stepper.A.T + noise

    """

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    next_q: np.ndarray
    next_qd: np.ndarray
    A: np.ndarray
    B: np.ndarray
    by_parameter: np.ndarray
    basis: np.ndarray

    def __init__(self, model: Model, period: float, *,
                 method: Union[str, Mapping[str, Any], Method] = 'rk4',
                 steps: Optional[int] = None, jacobians: bool = True,
                 parameters: Sequence[str] = (), independent: Optional[Sequence[str]] = None,
                 count: Optional[int] = None) -> None:
        if not isinstance(model, Model):
            raise TypeError(f'Stepper: expected a Model, as Model.from_scene returns it, got '
                            f'{model!r}')
        _require_whole('steps', steps)
        scene = model.scene.with_method(method)
        require_differentiable(scene.method)
        self.model, self._given_steps = model, steps
        self._period, self.steps = self._divided(period, scene.method.step_size)
        self._simulation = simulation = Simulation(model, None, scene.method)
        require_derivatives(simulation.data, along=True)
        self._names, self._differentiates = simulation.joint_names, bool(jacobians)
        self._actuated = [self._names.index(name) for name in simulation.actuated_joints]
        self._arrays = parameter_arrays(simulation.data, tuple(parameters))
        self._asked = places_of(self._names, independent)
        self._chart: Any = None
        self._work_on_present_equations()
        self.count = count
        state = simulation.snapshot()
        self.q[:], self.qd[:] = state.q, state.qd

    def _work_on_present_equations(self) -> None:
        """Work on the closure equations that the simulation works on now."""
        simulation = self._simulation
        self._system = simulation.data.system
        self._equations = self._system.model
        self._derivatives = derivatives = StepDerivatives(simulation.data, self._arrays)
        # Whose results give the independent coordinates.
        derivatives.need(CLOSURE)
        self._beside = derivatives.in_lanes(
            (*CLOSURE, *(REVERSE if self._differentiates else ())))
        self._set_run()
        self._choose(simulation.position, simulation.velocity, self._asked if self._chart is None
                     else self._chart.independent)

    def _set_run(self) -> None:
        """Set up the run of a period."""
        simulation, system = self._simulation, self._system
        method = simulation.scene.method
        tableau: Any = INTEGRATORS[method.integrator].tableau
        run = SteppedRun(
            tableau, STABILISATIONS[method.stabilisation], self.period / self.steps, self.steps,
            self.steps, np.zeros((1, len(system.tau))))
        tape = allocate_tape(system, tableau, self.steps)
        tape.state[0] = simulation.data.integrated
        self._run = (run, allocate_scratch(system, tableau), tape, self._derivatives.routines,
                     self._beside)
        self._calls: Dict[float, Any] = {}
        self._call: Any = None

    def _choose(self, q: np.ndarray, qd: np.ndarray, own: Optional[Sequence[int]]) -> None:
        """Take independent coordinates, by their places; those that move most where not given."""
        jac = self._derivatives.closures(q, qd)[0]
        if own is None:
            own = choose_independent(jac, self._actuated)
        rest = dependent_on(jac, own, self._names)
        self._chart = allocate_chart(self._system, own, rest, self._arrays.matrix)
        self._basis = np.zeros((2 * len(qd), 2 * len(own) + len(self.parameters)))
        self._displacement = np.zeros(len(qd))
        self._fill, self._move = (
            native.bind(name, self._system.native, self._beside, self._chart)
            for name in ('fill_basis', 'move_along'))

    @property
    def simulation(self) -> Simulation:
        """Return what it works with; who writes arrays of its ``data`` calls their ``touch``."""
        return self._simulation

    @property
    def parameter_arrays(self) -> Any:
        """Return the ``ParameterArrays``: derivatives of its arrays by the parameters."""
        return self._arrays

    @property
    def period(self) -> float:
        """Of the next calls [s]; the last few that were set are kept ready."""
        return self._period

    @period.setter
    def period(self, period: float) -> None:
        if period == self._period:
            return
        divided = self._divided(period, self._simulation.scene.method.step_size)
        if len(self._calls) >= MOST_PERIODS:
            self._calls.clear()
        self._calls[self._period] = self._run, self.steps, self._call
        self._period, self.steps = divided
        if period in self._calls:
            self._run, self.steps, self._call = self._calls[period]
            return
        calls = self._calls
        self._set_run()
        self._bind()
        self._calls = calls

    def _divided(self, period: float, step_size: float) -> Tuple[float, int]:
        """Return a period, and how many steps it has."""
        if not (isinstance(period, (int, float)) and math.isfinite(period) and period > 0.0):
            raise ValueError(f'period: expected a finite number > 0 [s], got {period!r}')
        return float(period), self._given_steps or math.ceil(
            period / step_size * (1.0 - ROUNDING))

    @property
    def count(self) -> Optional[int]:
        """How many states a call advances; None: one. Where it is set, all arrays are new."""
        return self._count

    @count.setter
    def count(self, count: Optional[int]) -> None:
        _require_whole('count', count)
        self._count = count
        self._reach = allocate_steps(
            self._chart, self._run[0].tableau, self._actuated, count or 1, self._differentiates)
        for name, field in _ARRAYS.items():
            values = getattr(self._reach, field)
            setattr(self, name, values if count or not len(values) else values[0])
        self._bind()

    def _bind(self) -> None:
        """Bind the engine's function to the present arrays."""
        self._calls = {}
        self._call = native.bind(
            'step_states', self._system.native, *self._run, self._chart, self._reach)

    def called_by_address(self) -> Tuple[Any, Sequence[int]]:
        """
        Return what others call by address, and what keeps it alive (callable.hpp).

        Addresses of the steps, and of three functions of rows. Calls use the memory of this
        stepper, which is not to be called any more.
        """
        for group in FORWARD, REVERSE:
            self._derivatives.need(group)
        nq, nv = self._reach.q.shape[1], self._reach.qd.shape[1]
        run, scratch, tape, routines, _ = self._run
        arrays = (self._reach.actuated, np.zeros((2, nq + nv)),
                  RunInputs(np.zeros(nq + nv), np.zeros((1, nv)),
                            np.zeros(len(self._arrays.entries))))
        of = self._system.native.callable_steps(run, scratch, tape, routines, *arrays)
        return (of, self._run, arrays), of.addresses()

    @property
    def parameters(self) -> Tuple[str, ...]:
        """Key paths of the parameters, in their order."""
        return self._arrays.names

    @property
    def independent(self) -> Tuple[str, ...]:
        """Names of the freedoms whose coordinates and rates are independent, in their order."""
        return tuple(self._names[place] for place in self._chart.independent)

    def __call__(self) -> None:
        """
        Advance the states in ``q`` and ``qd`` by a period, under the torques in ``tau``.

        Raises
        ------
        AssemblyError
            Where a state leaves the loops open, with the loop and by how much.
        NumericalError, ClosureError, SingularityError
            Where the step, or its derivative, cannot be made.
        ValueError
            For numbers that are not finite.

        """
        ended = self._call()
        if ended[0] == POOR_EQUATIONS:
            ended = self._exchange(*ended)
        if ended[0] != DONE:
            self._refuse(*ended)

    def step(self, state: State, torque: np.ndarray) -> Step:
        """
        Advance a state, or a batch of states.

        Parameters
        ----------
        state : State
            Of this model; the effects begin again.
        torque : ndarray, shape (na,), or (n, na)
            Of the actuated joints [N m or N].

        Returns
        -------
        Step

        Raises
        ------
        AssemblyError, NumericalError, ClosureError, SingularityError, ValueError
            As a call.

        """
        self.count = len(state) if state.is_batch else None
        self.q[:], self.qd[:], self.tau[:] = state.q, state.qd, torque
        self()
        after = State(np.add(state.time, self.period), self.next_q, self.next_qd, state.own,
                      state.coordinates)
        return Step(after, self.A, self.B, self.by_parameter, self.independent, self.basis)

    def _exchange(self, status: int, number: int) -> Tuple[int, int]:
        """Work on the closure equations that serve in a state, and advance all again."""
        reach, simulation = self._reach, self._simulation
        simulation.stepping.begin_at(self.model.state(reach.q[number], reach.qd[number]))
        if simulation.data.system.model is self._equations:
            return status, number
        self._work_on_present_equations()
        self._bind()
        return self._call()

    def _refuse(self, status: int, number: int) -> None:
        """Raise the error of a state that was not advanced."""
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        which, one = f'state {number}: ' if self._count else '', self._reach
        for name, values in (('q', one.q), ('qd', one.qd), ('tau', one.torque)):
            if not np.isfinite(values[number]).all():
                raise ValueError(f'{which}{name}: expected finite numbers, got {values[number]}')
        try:
            self.model.state(one.q[number], one.qd[number])
        except AssemblyError as error:
            raise AssemblyError(f'{which}{error}') from None
        kind, what = ENDS[status]
        raise kind(f'{which}{what}; independent: {", ".join(self.independent)}')

    def change_independent(self, independent: Optional[Sequence[str]] = None) -> np.ndarray:
        """
        Take other independent coordinates.

        Parameters
        ----------
        independent : sequence of str, optional
            Their names; where not given, those that move most in the (first) state in ``q``,
            actuated ones first.

        Returns
        -------
        ndarray, shape (2 n, 2 n), or (count, 2 n, 2 n)
            Changes of the new independent coordinates and rates with those of the old ones, in
            each state in ``q`` and ``qd``: a covariance P becomes T P T^T.

        Raises
        ------
        SingularityError
            Where the old ones do not determine all others there.
        ValueError
            For unknown names, and names that do not determine all others.

        """
        places, reach, nv = places_of(self._names, independent), self._reach, len(self._names)
        bases = [self.basis_at(*state).copy() for state in zip(reach.q, reach.qd)]
        self._choose(reach.q[0], reach.qd[0], places)
        self._bind()
        own = self._chart.independent
        rows = np.concatenate((own, nv + own))
        found = np.array([basis[rows, :len(rows)] for basis in bases])
        return found if self._count else found[0]

    def basis_at(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the changes of all with the independent ones; overwritten by the next call."""
        if self._fill(q, qd, self._basis) != DONE:
            raise SingularityError(f'{ENDS[SINGULAR][1]}: {", ".join(self.independent)}')
        return self._basis

    def displacements(self) -> np.ndarray:
        """
        Return the changes of all joints after the period, as of ``A``, ``B``, ``by_parameter``.

        Returns
        -------
        ndarray, shape (2 nv, 2 n + na + np), or (count, 2 nv, 2 n + na + np)
            Of all displacements, then of all rates: by the independent ones before the period, by
            torques and by parameters.

        """
        found = []
        reach, n = self._reach, 2 * len(self._chart.independent)
        for number, state in enumerate(zip(reach.next_q, reach.next_qd)):
            basis = self.basis_at(*state)
            whole = basis[:, :n] @ np.hstack((
                reach.by_state[number], reach.by_torque[number], reach.by_parameter[number]))
            if self.parameters:
                whole[:, -len(self.parameters):] += basis[:, n:]
            found.append(whole)
        return np.array(found) if self._count else found[0]

    def plus(self, q: ArrayLike, qd: ArrayLike,
             changes: ArrayLike) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return states that differ from one by changes of the independent coordinates and rates.

        Parameters
        ----------
        q, qd : array_like, shape (nq,), (nv,)
            A state that closes the loops.
        changes : array_like, shape (2 n,), or (m, 2 n)
            Displacements, then changes of rates: sigma points, or an estimator's correction.

        Returns
        -------
        q, qd : ndarray, shape (nq,), (nv,), or (m, nq), (m, nv)
            With the loops closed by the dependent coordinates.

        Raises
        ------
        ClosureError
            Where the loops cannot be closed that far away.
        SingularityError
            Where the independent coordinates do not determine all others.
        ValueError
            For other shapes.

        """
        wanted, start = reals('changes', changes), (reals('q', q), reals('qd', qd))
        n = 2 * len(self._chart.independent)
        if wanted.ndim not in (1, 2) or wanted.shape[-1] != n:
            raise ValueError(f'changes: expected shape ({n},), or (m, {n}), of displacements and '
                             f'rates of {", ".join(self.independent)}, got {wanted.shape}')
        for name, values, size in zip(('q', 'qd'), start, (self._reach.q, self._reach.qd)):
            if values.shape != size.shape[1:]:
                raise ValueError(f'{name}: expected shape {size.shape[1:]}, got {values.shape}')
        places, rates = self.moved(*start, np.atleast_2d(wanted))
        return (places, rates) if wanted.ndim == 2 else (places[0], rates[0])

    def moved(self, q: np.ndarray, qd: np.ndarray, changes: np.ndarray,
              near: bool = False) -> Tuple[np.ndarray, np.ndarray]:
        """
        As ``plus``, of arrays of floats of shapes (nq,), (nv,), (m, 2 n), unchecked.

        ``near``: whether ``basis_at`` was called last for this state, or one near it.
        """
        count = len(changes)
        if not near:
            self.basis_at(q, qd)
        places, rates = np.empty((count, len(q))), np.empty((count, len(qd)))
        status, number = self._move(
            q, qd, self._basis, changes, self._displacement, places, rates)
        if status == OPEN_LOOP:
            raise ClosureError(f'changes, row {number}: the loops cannot be closed that far from '
                               'the state: give smaller ones')
        if status != DONE:
            raise SingularityError(f'{ENDS[SINGULAR][1]}: {", ".join(self.independent)}')
        return places, rates

    def minus(self, q: ArrayLike, qd: ArrayLike, from_q: ArrayLike,
              from_qd: ArrayLike) -> np.ndarray:
        """
        Return the changes of the independent coordinates and rates from a state to others.

        Parameters
        ----------
        q, qd : array_like, shape (nq,), (nv,), or (m, nq), (m, nv)
            The other states.
        from_q, from_qd : array_like, shape (nq,), (nv,)
            The state.

        Returns
        -------
        ndarray, shape (2 n,), or (m, 2 n)
            So that ``plus`` leads from this state to the others; of orientations by the shorter
            turns.

        """
        own, (places, start) = self._chart.independent, (reals('q', q), reals('from_q', from_q))
        coordinates = self._simulation.coordinates
        single = coordinates.place[own]
        if (single >= 0).all():
            # The orientations of all others take most of the time.
            moved = places[..., single] - start[single]
        else:
            moved = np.array([coordinates.apart(one, start)[own]
                              for one in np.atleast_2d(places)])
            moved = moved if places.ndim == 2 else moved[0]
        return np.concatenate((moved, (reals('qd', qd) - from_qd)[..., own]), axis=-1)

    def __repr__(self) -> str:
        """Show the mechanism, the period and the independent coordinates."""
        states = '' if self._count is None else f', {self._count} states a call'
        return (f'<Stepper of {self.model.mechanism.name}: {self.period:g} s in {self.steps} '
                f'steps of {self._simulation.scene.method.integrator}, independent: '
                f'{", ".join(self.independent)}{states}>')


def _require_whole(name: str, number: Any) -> None:
    """Refuse what is neither a whole positive number nor None."""
    if number is not None and not (isinstance(number, (int, np.integer)) and number > 0):
        raise ValueError(f'{name}: expected a whole number > 0, got {number!r}')
