# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Linear-quadratic and predictive controllers, on the Jacobians of discrete steps.

Both work in the independent coordinates and rates of a ``Stepper``: with x the difference of a
state to its reference, and u that of the torques, x' = A x + B u over a period, exact to first
order with the loops closed. Costs are sums of x^T Q x + u^T R u.
"""

import numpy as np
from scipy.linalg import solve_discrete_are

from ..kinematics.state import State
from ..mechanism.errors import SimulationError
from ..mechanism.extras import require
from ..mechanism.named_array import reals
from ..simulation.model import Model
from ..simulation.stepper import Stepper

# Rates at the end of a path, against the largest on it, that are what a spline leaves.
AT_REST = 1e-2


class LinearRegulator:
    """
    A linear-quadratic regulator about a pose, or along a path.

    Parameters
    ----------
    model : Model
        All of whose effects have derivatives.
    reference : State
        Single and at rest: a pose. A batch, each state a period after the one before, as
        ``feedforward`` returns them: a path, which ends at rest.
    period : float
        Between two calls, torques held [s].
    state_cost : array_like, shape (2 n,) or (2 n, 2 n)
        Q: of the differences of the independent coordinates, then rates.
    torque_cost : array_like, shape (na,) or (na, na)
        R: of the differences of the torques of the actuated joints.
    torques : array_like, shape (len(path), na), optional
        Of the states of a path [N m or N], and of nothing else: a pose, and the end of the path,
        are held by what ``Reduced.gravity_compensation`` returns.
    independent : sequence of str, optional
        As for ``Stepper``.

    Attributes
    ----------
    gains : ndarray, shape (m, na, 2 n)
        Of each state of the reference; of a path m is one more, for its end at rest.
    cost : ndarray, shape (2 n, 2 n)
        P of the last one: x^T P x is what is still to come.
    independent : tuple of str
        Freedoms that these are of.

    Raises
    ------
    ValueError
        For other shapes, a reference that does not end at rest, or one that torques cannot
        stabilise.
    SimulationError
        As ``Stepper``, and where the actuated joints cannot hold the pose.

    Notes
    -----
    Of a pose P solves the discrete algebraic Riccati equation; along a path its recursion goes
    backward from the pose at the end (Anderson, Moore, Optimal Control (1990), sections 2.4, 3).

    """

    def __init__(self, model, reference, period, state_cost, torque_cost, *, torques=None,
                 independent=None):
        self.model, self.period = _model(model), period
        end, na = _end(model, reference), len(model.actuated_joints)
        hold = model.reduce(end).gravity_compensation()
        self.reference, self.torques = State.stack([end]), hold[np.newaxis]
        if reference.is_batch:
            self.reference = State.stack([*(reference[n] for n in range(len(reference))), end])
            self.torques = np.vstack((_shaped('torques', torques, (len(reference), na)), hold))
        elif torques is not None:
            raise ValueError('torques: expected none with a pose, which is held by its own')
        batch, count = self.reference, len(self.reference)
        stepper = Stepper(model, period, independent=independent, count=count)
        self.independent = stepper.independent
        size = 2 * len(self.independent)
        self.state_cost = _matrix('state_cost', state_cost, size)
        self.torque_cost = _matrix('torque_cost', torque_cost, na)
        stepper.q[:], stepper.qd[:], stepper.tau[:] = batch.q, batch.qd, self.torques
        stepper()
        self.cost = _riccati(
            stepper.A[-1], stepper.B[-1], self.state_cost, self.torque_cost)
        self.gains, after = np.empty((count, na, size)), self.cost
        for n in reversed(range(count)):
            a, b = stepper.A[n], stepper.B[n]
            self.gains[n] = np.linalg.solve(
                self.torque_cost + b.T @ after @ b, b.T @ after @ a)
            after = self.state_cost + a.T @ after @ (a - b @ self.gains[n])
        self._stepper = stepper

    def torque(self, q, qd, step=0):
        """
        Return the torques of a state, shape (na,) [N m or N].

        Parameters
        ----------
        q, qd : array_like, shape (nq,), (nv,)
            The state.
        step : int
            The number of the state of the reference; beyond the end, the end.

        """
        n = min(step, len(self.torques) - 1)
        away = self._stepper.minus(q, qd, self.reference.q[n], self.reference.qd[n])
        return self.torques[n] - self.gains[n] @ away

    def __repr__(self):
        """Show what it regulates."""
        return (f'<LinearRegulator of {self.model.mechanism.name}: {len(self.torques)} states, '
                f'{self.period:g} s, independent: {", ".join(self.independent)}>')


class PredictiveController:
    """
    Nonlinear model-predictive control: torques within limits that are best over a horizon.

    Each call makes one Gauss-Newton iteration from the torques of the last one (real-time
    iteration): the motion under them, its Jacobians, and a quadratic problem in the torques of all
    periods, with their limits. Behind the horizon the cost is that of the ``LinearRegulator``
    about the goal. Needs the library piqp, of the extra ``predictive``.

    Parameters
    ----------
    model : Model
        All of whose effects have derivatives.
    goal : State
        Single and at rest.
    period : float
        Of the prediction, torques held [s]; calls may be more frequent. One step of RK4.
    horizon : int
        How many periods are looked ahead.
    state_cost, torque_cost
        As for ``LinearRegulator``.
    limit : float, or array_like of shape (na,)
        Largest torques [N m or N].
    independent : sequence of str, optional
        As for ``Stepper``.

    Attributes
    ----------
    torques : ndarray, shape (horizon, na)
        Of the last call, which the next one begins with; may be set.
    status : str
        Of the solver in the last call.

    Raises
    ------
    ValueError, SimulationError
        As ``LinearRegulator``.
    MissingLibraryError
        Without piqp.

    Notes
    -----
    Diehl, Bock, Schloeder, SIAM J. Control Optim. 43 (2005), 1714-1736; the quadratic problem is
    condensed: states are eliminated by x_{k+1} = A_k x_k + B_k u_k.

    """

    def __init__(self, model, goal, period, horizon, state_cost, torque_cost, limit, *,
                 independent=None):
        require('piqp')
        import piqp
        if not isinstance(horizon, (int, np.integer)) or horizon < 1:
            raise ValueError(f'horizon: expected a whole number > 0, got {horizon!r}')
        about = LinearRegulator(
            model, goal, period, state_cost, torque_cost, independent=independent)
        na = len(about.torques[0])
        self.limit = np.array(np.broadcast_to(reals('limit', limit), (na,)))
        if not (self.limit > np.abs(about.torques[0])).all():
            raise ValueError(f'limit: expected more than holds the goal, '
                             f'{np.abs(about.torques[0])}, got {self.limit}')
        self.model, self.period, self.goal, self.independent = (
            model, period, goal, about.independent)
        self._hold, self._q, self._r, self._cost = (
            about.torques[0], about.state_cost, about.torque_cost, about.cost)
        self.torques, self.status = np.tile(self._hold, (horizon, 1)), 'not called yet'
        self._stepper = Stepper(model, period, steps=1, independent=self.independent)
        size = 2 * len(self.independent)
        # Changes of the states by those of all torques, one state after the other.
        self._along = np.zeros((horizon + 1, size, horizon * na))
        self._of_torques = np.kron(np.eye(horizon), self._r)
        self._solver = piqp.DenseSolver()
        self._solver.settings.verbose = False
        self._is_set_up = False

    def torque(self, q, qd, goal=None):
        """
        Return the torques of a state, shape (na,) [N m or N].

        Parameters
        ----------
        q, qd : array_like, shape (nq,), (nv,)
            The state, closing the loops.
        goal : tuple of ndarray, shapes (horizon, nq), (horizon, nv), optional
            Where the mechanism is to be after each period; the goal when not given.

        Raises
        ------
        SimulationError
            As a call of ``Stepper``, and where the quadratic problem has no solution.

        """
        stepper, along, count = self._stepper, self._along, len(self.torques)
        na = len(self.limit)
        hessian = self._of_torques.copy()
        slope = ((self.torques - self._hold) @ self._r).ravel()
        stepper.q[:], stepper.qd[:] = q, qd
        for k in range(count):
            stepper.tau[:] = self.torques[k]
            stepper()
            # Later torques have no part in it.
            part = (k + 1) * na
            np.matmul(stepper.A, along[k, :, :part], out=along[k + 1, :, :part])
            along[k + 1, :, part - na:part] = stepper.B
            wanted = (self.goal.q, self.goal.qd) if goal is None else (goal[0][k], goal[1][k])
            away = stepper.minus(stepper.next_q, stepper.next_qd, *wanted)
            weighted = along[k + 1, :, :part].T @ (
                self._cost if k == count - 1 and goal is None else self._q)
            hessian[:part, :part] += weighted @ along[k + 1, :, :part]
            slope[:part] += weighted @ away
            stepper.q[:], stepper.qd[:] = stepper.next_q, stepper.next_qd
        found = self._solved(hessian, slope)
        self.torques = np.clip(self.torques + found.reshape(count, na), -self.limit, self.limit)
        return self.torques[0].copy()

    def _solved(self, hessian, slope):
        """Return the changes of the torques that are best within the limits."""
        low, high = (sign * np.tile(self.limit, len(self.torques)) - self.torques.ravel()
                     for sign in (-1.0, 1.0))
        if self._is_set_up:
            self._solver.update(hessian, slope, x_l=low, x_u=high)
        else:
            self._solver.setup(hessian, slope, None, None, None, None, None, low, high)
            self._is_set_up = True
        self.status = str(self._solver.solve())
        found = np.array(self._solver.result.x)
        if not self.status.endswith('SOLVED') or self.status.endswith('UNSOLVED') or not (
                np.isfinite(found).all()):
            raise SimulationError(f'the quadratic problem has no solution: {self.status}')
        return found

    def __repr__(self):
        """Show what it controls."""
        return (f'<PredictiveController of {self.model.mechanism.name}: {len(self.torques)} '
                f'periods of {self.period:g} s, independent: {", ".join(self.independent)}>')


def _model(model):
    if not isinstance(model, Model):
        raise TypeError(f'model: expected a Model, as Model.from_scene returns it, got {model!r}')
    return model


def _shaped(name, values, shape):
    array = reals(name, values)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f'{name}: expected finite numbers of shape {shape}, got {array!r}')
    return array


def _matrix(name, values, size):
    """Return a symmetric matrix of costs, of its diagonal where that is given."""
    array = reals(name, values)
    matrix = np.diag(array) if array.ndim == 1 else array
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        raise ValueError(f'{name}: expected finite numbers of shape ({size},) or '
                         f'({size}, {size}), got shape {array.shape}')
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix)[0] < 0.0:
        raise ValueError(f'{name}: expected a symmetric matrix without negative eigenvalues')
    return matrix


def _end(model, reference):
    """Return the last state of a reference at rest; refuse one that still moves."""
    last = reference[len(reference) - 1] if reference.is_batch else reference
    fastest = np.abs(reference.qd).max() if reference.is_batch else 0.0
    if np.abs(last.qd).max() > AT_REST * fastest:
        raise ValueError('reference: expected a pose, or a path that ends, at rest, got rates up '
                         f'to {np.abs(last.qd).max():.3g}')
    return model.state(last.q, np.zeros_like(last.qd))


def _riccati(a, b, q, r):
    try:
        return solve_discrete_are(a, b, q, r)
    except np.linalg.LinAlgError as error:
        raise ValueError('reference: expected one that torques and costs stabilise: '
                         f'{error}') from None
