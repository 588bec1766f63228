# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The mechanics of a state in independent coordinates: what controllers are made of."""

from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..kinematics.state import State
from ..mechanism.errors import SimulationError, SingularityError
from ..mechanism.kinematics import motion_of
from ..mechanism.named_array import by_shapes, reals, sealed

if TYPE_CHECKING:
    from .model import Model

# Singular values below this share of the largest one are those of a singular position.
RANK_TOLERANCE = 1e-8
# Indices of the components in space that a planar mechanism has: along x and y, about z.
IN_PLANE = [0, 1, 5]
ACTUATED = 'actuated'


class TorqueDerivatives(NamedTuple):
    """
    Torques of the actuated joints, and their derivatives in independent coordinates.

    Attributes
    ----------
    torque : ndarray, shape (na,)
        [N m or N].
    by_position, by_velocity, by_acceleration : ndarray, shape (na, n)
        By independent coordinates, rates and accelerations, each set alone.

    """

    torque: np.ndarray
    by_position: np.ndarray
    by_velocity: np.ndarray
    by_acceleration: np.ndarray

    def __repr__(self) -> str:
        """Show the shapes."""
        return by_shapes(self, *self._fields)


class Reduced:
    """
    Mechanics of a state in independent coordinates; it never changes.

    ``Model.reduce`` makes it. With u the independent rates, ud their accelerations:

        qd = basis u,    qdd = basis ud + drift,    inertia ud + bias = drives^T tau

    Attributes
    ----------
    model : Model
    state : State
        A single one, closing the loops.
    independent : tuple of str
        Freedoms of the tree, n.
    basis : ndarray, shape (nv, n)
        All joint rates by the independent ones.
    drift : ndarray, shape (nv,)
        Accelerations of all joints where the independent rates stay as they are.
    inertia : ndarray, shape (n, n)
        With rotors and reflected inertia.
    bias : ndarray, shape (n,)
        Forces along the independent coordinates that keep their rates: against gravity and
        effects, and of velocities.
    drives : ndarray, shape (na, n)
        Rates of the actuated joints by the independent ones.

    Notes
    -----
    Tasks are named points, of two or three numbers (a velocity), and bodies, of three or six (the
    velocity of the body's origin and the angular velocity, about z in the plane), in world axes;
    ``'actuated'`` are the actuated joints.

    """

    def __init__(self, model: 'Model', state: State, found: Any, own: List[int],
                 along: np.ndarray, modes: Callable[[Any], List[Any]]) -> None:
        self.model, self.state, self._modes = model, state, modes
        names = model.joint_names
        self._own, self._actuated = own, [names.index(name) for name in model.actuated_joints]
        self.independent: Tuple[str, ...] = tuple(names[place] for place in own)
        self.basis, self.drives = sealed(along), sealed(along[self._actuated])
        self.drift = sealed(found.acceleration - along @ found.acceleration[own])
        response = found.by_torque[own][:, own]
        self.inertia = sealed(np.linalg.inv(0.5 * (response + response.T)))
        self.bias = sealed(-self.inertia @ found.acceleration[own])
        self._motions: Dict[str, Tuple[np.ndarray, np.ndarray]] = {}

    def motion(self, task: str) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return how a task moves: its acceleration is jacobian ud + drift.

        Parameters
        ----------
        task : str
            A named point, a body, or ``'actuated'``.

        Returns
        -------
        jacobian : ndarray, shape (task, n)
            By the independent rates.
        drift : ndarray, shape (task,)
            Its acceleration where the independent rates stay as they are.

        Raises
        ------
        ValueError
            For another name.

        """
        if task == ACTUATED:
            return self.drives, self.drift[self._actuated]
        if task not in self._motions:
            mechanism = self.model.mechanism
            points = {point.name: point for point in mechanism.points}
            bodies = [body.name for body in mechanism.bodies]
            if task not in points and task not in bodies:
                raise ValueError(f'task: expected {ACTUATED}, or one of the points and bodies '
                                 f'{", ".join((*points, *bodies))}; got {task!r}')
            if task in points:
                body, place = points[task].body, np.array([*points[task].position, 0.0][:3])
                kept = [0, 1] if mechanism.planar else [0, 1, 2]
            else:
                body, place = task, np.zeros(3)
                kept = IN_PLANE if mechanism.planar else list(range(6))
            jac, bias = (part[kept] for part in motion_of(
                mechanism, self.state.q, self.state.qd, body, place))
            self._motions[task] = jac @ self.basis, jac @ self.drift + bias
        return self._motions[task]

    def jacobian(self, task: str, by: str = 'independent') -> np.ndarray:
        """
        Return the Jacobian of a task.

        Parameters
        ----------
        task : str
            A named point, a body, or ``'actuated'``.
        by : str
            ``'independent'`` or ``'actuated'``: the rates that it is multiplied by.

        Returns
        -------
        ndarray, shape (task, n), or (task, na)

        Raises
        ------
        SingularityError
            By drives, where they do not determine the motion.
        ValueError

        """
        if by not in ('independent', ACTUATED):
            raise ValueError(f"by: expected 'independent' or {ACTUATED!r}, got {by!r}")
        jac, _ = self.motion(task)
        if by == 'independent':
            return jac.copy()
        self._require_regular(self.drives, 'the actuated joints do not determine the motion')
        return jac @ np.linalg.pinv(self.drives)

    def condition(self, task: str) -> float:
        """
        Return the condition number of a task's Jacobian by the drives.

        Parameters
        ----------
        task : str
            As for ``jacobian``. Of a body lengths and angles are mixed, as in m and rad.

        """
        return float(np.linalg.cond(self.jacobian(task, ACTUATED)))

    def accelerations(self, acceleration: ArrayLike, of: str = 'independent') -> np.ndarray:
        """
        Return the accelerations of all joints of the tree, consistent with the loops.

        Parameters
        ----------
        acceleration : array_like
            Of the independent coordinates, or of what is given by ``of``.
        of : str
            ``'independent'``, or a task: ``'actuated'``, a named point, a body.

        Returns
        -------
        ndarray, shape (nv,)

        Raises
        ------
        SimulationError
            Where the task does not determine the motion, or cannot have this acceleration.
        ValueError
            For other shapes.

        """
        return self.basis @ self._independent(acceleration, of) + self.drift

    def _independent(self, acceleration: ArrayLike, of: str) -> np.ndarray:
        """Return accelerations of the independent coordinates."""
        wanted = reals('acceleration', acceleration)
        n = len(self._own)
        jac, bias = (np.eye(n), np.zeros(n)) if of == 'independent' else self.motion(of)
        if wanted.shape != bias.shape or not np.isfinite(wanted).all():
            raise ValueError(f'acceleration: expected {len(bias)} finite numbers of {of}, got '
                             f'{acceleration!r}')
        self._require_regular(jac, f'{of} does not determine the motion')
        found = np.linalg.lstsq(jac, wanted - bias, rcond=None)[0]
        missed = np.abs(jac @ found + bias - wanted).max(initial=0.0)
        if missed > RANK_TOLERANCE * np.abs(wanted - bias).max(initial=1.0):
            raise SimulationError(f'{of} cannot have this acceleration: {missed:.3g} is missed; '
                                  f'the mechanism has {len(self._own)} degrees of freedom')
        return found

    def inverse(self, acceleration: ArrayLike, of: str = 'independent') -> np.ndarray:
        """
        Return the torques of the actuated joints that an acceleration needs.

        Parameters
        ----------
        acceleration, of
            As for ``accelerations``.

        Returns
        -------
        ndarray, shape (na,)
            The least ones where the mechanism is actuated redundantly [N m or N].

        Raises
        ------
        SimulationError
            Where the task does not determine the motion, or cannot have this acceleration, and
            where the actuated joints cannot produce it.
        ValueError
            For other shapes.

        """
        return self._torque(self.inertia @ self._independent(acceleration, of) + self.bias)

    def _torque(self, force: np.ndarray) -> np.ndarray:
        """Return the torques of the actuated joints in the place of forces along u."""
        found = np.linalg.lstsq(self.drives.T, force, rcond=RANK_TOLERANCE)[0]
        missed = np.abs(self.drives.T @ found - force).max(initial=0.0)
        if missed > RANK_TOLERANCE * max(1.0, np.abs(force).max(initial=0.0)):
            raise SimulationError(
                f'The actuated joints cannot produce this motion: {missed:.3g} N m or N are '
                f'missing along {", ".join(self.independent)}')
        return found

    def inverse_derivatives(self, acceleration: ArrayLike,
                            of: str = 'independent') -> TorqueDerivatives:
        """
        Return the torques that accelerations of the independent coordinates need, differentiated.

        Parameters
        ----------
        acceleration, of
            As for ``inverse``; the accelerations of the independent coordinates that follow are
            held.

        Returns
        -------
        TorqueDerivatives

        Raises
        ------
        SimulationError
            As ``inverse``; where there are not as many actuated joints as degrees of freedom.
        ValueError
            For other shapes.

        """
        n, torque = len(self._own), self.inverse(acceleration, of)
        if len(torque) != n:
            raise SimulationError(f'derivatives: expected as many actuated joints as degrees of '
                                  f'freedom, {n}, got {len(torque)}')
        linear = self.model.linearise(self.state, torque, independent=self.independent)
        by_acceleration = np.linalg.inv(linear.B[n:])
        return TorqueDerivatives(
            torque, -by_acceleration @ linear.A[n:, :n], -by_acceleration @ linear.A[n:, n:],
            by_acceleration)

    def torque_of(self, task: str, wrench: ArrayLike) -> np.ndarray:
        """
        Return the torques of the actuated joints that do the work of a force at a task.

        Parameters
        ----------
        task : str
            A named point or a body.
        wrench : array_like, shape (task,)
            Force [N], of a body force and torque [N, N m], in world axes.

        Returns
        -------
        ndarray, shape (na,)
            Virtual work of both is the same; against a load the torques are the opposite ones.

        Raises
        ------
        SimulationError
            Where the actuated joints cannot.
        ValueError
            For other shapes.

        """
        jac, _ = self.motion(task)
        given = reals('wrench', wrench)
        if given.shape != (len(jac),):
            raise ValueError(f'wrench: expected shape ({len(jac)},), got {given.shape}')
        return self._torque(jac.T @ given)

    def operational_space(self, task: str) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return the inertia and the bias of a task: force = inertia acceleration + bias.

        Parameters
        ----------
        task : str
            As for ``jacobian``.

        Returns
        -------
        inertia : ndarray, shape (task, task)
            That ``torque_of`` makes the force of.
        bias : ndarray, shape (task,)
            [N, N m].

        Raises
        ------
        SingularityError
            Where the task cannot move in all its directions.

        """
        jac, drift = self.motion(task)
        self._require_regular(jac.T, f'{task} cannot move in all its directions')
        response = np.linalg.solve(self.inertia, np.column_stack([jac.T, self.bias]))
        inertia = np.linalg.inv(jac @ response[:, :-1])
        inertia = 0.5 * (inertia + inertia.T)
        return inertia, inertia @ (jac @ response[:, -1] - drift)

    def computed_torque(self, wanted: State, stiffness: ArrayLike, damping: ArrayLike,
                        acceleration: Optional[ArrayLike] = None) -> np.ndarray:
        """
        Return the torques of a computed-torque controller.

        Parameters
        ----------
        wanted : State
            Where the mechanism is to be, and its rates.
        stiffness, damping : float, or array_like of shape (n,) or (n, n)
            Acceleration by an error of the independent coordinates [1/s^2] and rates [1/s].
        acceleration : array_like, shape (n,), optional
            Of the independent coordinates, wanted; zero when not given.

        Returns
        -------
        ndarray, shape (na,)
            [N m or N].

        Raises
        ------
        SimulationError
            Where the actuated joints cannot produce the acceleration.
        ValueError
            For a batch, a state of another mechanism and other shapes.

        """
        if wanted.is_batch or wanted.coordinates.names != self.model.joint_names:
            raise ValueError(f'wanted: expected one state of {self.model.mechanism.name}, got '
                             f'{wanted!r}')
        n = len(self._own)
        away = self.model.coordinates.apart(wanted.q, self.state.q)[self._own]
        slower = (wanted.qd - self.state.qd)[self._own]
        total = np.zeros(n) if acceleration is None else reals('acceleration', acceleration)
        for name, given, error in ('stiffness', stiffness, away), ('damping', damping, slower):
            gain = reals(name, given)
            if gain.shape not in ((), (n,), (n, n)):
                raise ValueError(f'{name}: expected one number, or shape ({n},) or ({n}, {n}), '
                                 f'got {gain.shape}')
            total = total + (gain @ error if gain.ndim == 2 else gain * error)
        return self.inverse(total)

    def gravity_compensation(self) -> np.ndarray:
        """
        Return the torques that hold the position at rest, against gravity and springs.

        Returns
        -------
        ndarray, shape (na,)
            [N m or N].

        Raises
        ------
        SimulationError
            Where the actuated joints cannot hold it.

        """
        rest = State(self.state.time, self.state.q, np.zeros_like(self.state.qd), self.state.own,
                     self.state.coordinates)
        return self.model.reduce(rest, self.independent).inverse(np.zeros(len(self._own)))

    @property
    def reflected_inertia(self) -> np.ndarray:
        """Inertia that the actuated joints feel, shape (na, na); SingularityError without it."""
        if len(self.drives) != len(self._own):
            raise SingularityError(
                f'reflected_inertia: expected as many actuated joints as degrees of freedom, '
                f'{len(self._own)}, got {len(self.drives)}')
        self._require_regular(self.drives, 'the actuated joints do not determine the motion')
        inverse = np.linalg.inv(self.drives)
        return inverse.T @ self.inertia @ inverse

    def modes(self, torque: Any = None) -> List[Any]:
        """
        Return the modes of small motions about the position, at rest.

        Parameters
        ----------
        torque : mapping, sequence or None
            What holds it, as for ``Linearisation.modes``, as is what is returned and raised.

        """
        return self._modes(torque)

    def _require_regular(self, matrix: np.ndarray, otherwise: str) -> None:
        """Refuse a matrix whose columns depend on one another."""
        values = np.linalg.svd(matrix, compute_uv=False)
        if len(values) < matrix.shape[1] or not values.min(initial=1.0) > (
                RANK_TOLERANCE * values.max(initial=0.0)):
            raise SingularityError(f'{otherwise} in this position: its Jacobian, of shape '
                                   f'{matrix.shape}, has dependent columns')

    def __repr__(self) -> str:
        """Show the mechanism, the independent coordinates and the drives."""
        return (f'<Reduced {self.model.mechanism.name}: independent '
                f'{", ".join(self.independent)}; drives '
                f'{", ".join(self.model.actuated_joints) or "none"}>')


def feedforward(model: 'Model', drives: Dict[str, ArrayLike], time: ArrayLike,
                start: Optional[State] = None) -> Tuple[State, np.ndarray]:
    """
    Return the torques of a whole trajectory, and its states.

    Parameters
    ----------
    model : Model
        Its effects have derivatives; the actuated joints can produce the motion.
    drives : mapping of str to array_like, shape (m,)
        Values of as many joints as there are degrees of freedom [rad or m].
    time : array_like, shape (m,)
        [s], rising; rates and accelerations are those of the cubic splines through the values.
    start : State, optional
        Closing the loops; on which branch, as ``branch`` of ``Model.solve``.

    Returns
    -------
    states : State
        A batch of m.
    torque : ndarray, shape (m, na)
        Of the actuated joints [N m or N].

    Raises
    ------
    BranchEndError, SimulationError, ValueError
        As ``Model.solve``, ``Model.reduce`` and ``Reduced.inverse``.

    """
    from scipy.interpolate import CubicSpline
    instants = reals('time', time)
    values = {name: reals(f'drives: {name}', given) for name, given in drives.items()}
    for name, given in values.items():
        if given.shape != instants.shape or instants.ndim != 1 or len(instants) < 3:
            raise ValueError(f'drives: {name}: expected as many numbers as times, at least 3, got '
                             f'shape {given.shape} beside {instants.shape}')
    if not (np.isfinite(instants).all() and (np.diff(instants) > 0.0).all()):
        raise ValueError('time: expected finite numbers that rise')
    at_rest = model.solve(values, branch=start)
    path = CubicSpline(instants, np.array(list(values.values())).T)
    rates, accelerations = path(instants, 1), path(instants, 2)
    states, torques = [], []
    for k, one in enumerate(at_rest):
        basis = model.reduce(one, tuple(values)).basis
        state = State(instants[k], one.q, basis @ rates[k], one.own, one.coordinates)
        states.append(state)
        torques.append(model.reduce(state, tuple(values)).inverse(accelerations[k]))
    return State.stack(states), np.array(torques)
