# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linear-quadratic and predictive controllers as laws of states at times, from settings."""

import numpy as np

from .optimal import LinearRegulator, PredictiveController
from .settings import PREDICTIVE
from ..mechanism.extras import require
from ..simulation.model import Model
from ..simulation.reduced import feedforward

# Share of a period by which durations may miss a whole number of them: rounding.
ROUNDING = 1e-6


class OptimalLaw:
    """
    Torques of a regulator or predictive controller, about a pose or along a path.

    Parameters
    ----------
    simulation : Simulation
        The model; the pose is its state, the driven joints brought to ``target``.
    values : dict
        Of ``settings.SETTINGS``: ``mode``, ``period``, ``horizon``, ``state_cost``.
    target : ndarray, shape (n,)
        Positions of the driven joints [rad or m]; NaN: where the simulation has them.
    torque_cost, limit : ndarray, shape (n,)
        By driven joint: R, and the largest magnitude of the torque (infinite: none) [N m or N].
    path : references.PointToPointPath, optional
        Along which the mechanism goes again and again, in the place of the pose.

    Raises
    ------
    MissingLibraryError, SimulationError, ValueError
        As ``LinearRegulator`` and ``PredictiveController``, and for a path whose durations are
        not whole numbers of periods.

    """

    def __init__(self, simulation, values, target, torque_cost, limit, path=None):
        if values['mode'] == PREDICTIVE:
            require('piqp')
        self._simulation, self._period, self._limit = simulation, values['period'], limit
        self._first, self._path, torques = None, None, None
        model, joints = Model(simulation.scene), simulation.actuated_joints
        wanted = {joint: place for joint, place in zip(joints, target) if not np.isnan(place)}
        at_start = simulation.coordinates.by_freedom(simulation.position)[simulation.data.actuated]
        pose = model.state(simulation.position, np.zeros_like(simulation.velocity))
        if wanted:
            pose = model.assemble({**dict(zip(joints, at_start)), **wanted}, hold=joints)
        independent = model.reduce(pose).independent
        state_cost = _state_cost(values['state_cost'], independent)
        if path is not None:
            self._path, torques = self._states(model, path, pose)
        costs = values['period'], state_cost, torque_cost
        if values['mode'] == PREDICTIVE:
            self.controller = PredictiveController(
                model, pose, costs[0], values['horizon'], *costs[1:], limit,
                independent=independent)
        else:
            self.controller = LinearRegulator(
                model, pose if path is None else self._path, *costs, torques=torques,
                independent=independent)
        self._predicts = values['mode'] == PREDICTIVE

    def _states(self, model, path, start):
        """Return the states of a round, a period apart, and the torques held between them."""
        count = round(path.period / self._period)
        if count < 2 or abs(count * self._period - path.period) > ROUNDING * self._period:
            raise ValueError('path_durations: expected a whole number of periods of '
                             f'{self._period:g} s together, got {path.period:g} s')
        time = np.linspace(0.0, path.period, count + 1)
        places = np.array([path.at(each)[0] for each in time]).T
        states, torques = feedforward(
            model, dict(zip(model.actuated_joints, places)), time, start)
        # Held over a period, as in its middle.
        return states, 0.5 * (torques + np.roll(torques, -1, axis=0))

    def tune(self, feedforward, limit):
        """Set another limit; ``controller.gains`` sees to it that nothing is fed forward."""
        self._limit = limit
        if self._predicts:
            self.controller.limit = limit

    def restart(self):
        """Treat the next state as the first one."""
        self._first = None

    def torque(self, time, position, velocity):
        """Return the torques, shape (n,), for a state, shapes (nq,), (nv,), at a time [s]."""
        position, velocity = self._simulation.closed(position, velocity)
        if self._first is None:
            self._first = time
        step, goal = round((time - self._first) / self._period), None
        if self._predicts:
            if self._path is not None:
                # The last state of a round is the first one of the next.
                ahead = (step + 1 + np.arange(len(self.controller.torques))) % (
                    len(self._path) - 1)
                goal = self._path.q[ahead], self._path.qd[ahead]
            return self.controller.torque(position, velocity, goal)
        if self._path is not None:
            step %= len(self._path) - 1
        return np.clip(self.controller.torque(position, velocity, step), -self._limit, self._limit)


def _state_cost(values, independent):
    """Return the diagonal of Q from one value for coordinates and one for rates, or from all."""
    count = len(independent)
    if len(values) not in (2, 2 * count):
        raise ValueError(f'state_cost: expected 2 values, for coordinates and for rates, or '
                         f'{2 * count}, for those of {", ".join(independent)}; got {len(values)}')
    return np.repeat(values, count) if len(values) == 2 else np.array(values)
