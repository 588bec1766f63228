# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Torques that keep driven joints at constant rates, to study a machine at its working speed."""

from dataclasses import replace

import numpy as np

from ..simulation.errors import SimulationError
from ..simulation.simulation import Simulation

# How fast an error of the rate is to decay [1/s].
GAIN = 20.0
# Rates of a mechanism that rests [rad/s, m/s], and when it does no more [s].
AT_REST, SOON = 1e-6, 1e-6


class RateControl:
    """
    Computed torque for constant rates.

    The model is the scene without drives, so that their lags and limits show in the result.

    Parameters
    ----------
    scene : Scene
        What is driven.
    rates : dict of str to float
        Wanted rate of every actuated joint [rad/s, m/s].

    Raises
    ------
    ValueError
        Where a joint is not actuated, or an actuated one has no rate.

    """

    def __init__(self, scene, rates):
        """Build the model."""
        effects = {name: effect for name, effect in scene.effects.items()
                   if effect.drive() is None}
        self._model = Simulation(replace(scene, effects=effects))
        # At rest dry friction would hold what the torques are to move.
        self._smooth = Simulation(replace(scene, effects={
            name: effect for name, effect in effects.items() if not effect.ENDS_STEPS}))
        names = self._model.actuated_joints
        if set(rates) != set(names):
            raise ValueError(f'rate: expected one for every actuated joint ({", ".join(names)}), '
                             f'got {", ".join(rates) or "none"}')
        self._joints = [self._model.joint_names.index(name) for name in names]
        self._rates = np.array([rates[name] for name in names])
        self._names = names

    def torque(self, simulation):
        """
        Return the torques for the present state, by joint.

        Raises
        ------
        SimulationError
            Where the torques cannot set the rates.

        """
        q, qd = simulation.position, simulation.velocity
        free, _ = self._smooth.forward_dynamics(q, qd)
        response = np.array([
            self._smooth.forward_dynamics(q, qd, {name: 1.0})[0] - free for name in self._names]).T
        wanted = GAIN * (self._rates - qd[self._joints])
        try:
            torque = np.linalg.solve(response[self._joints], wanted - free[self._joints])
        except np.linalg.LinAlgError:
            raise SimulationError(
                'The driven joints cannot keep these rates here: their torques do not move them '
                'independently. Name fewer rates, or another start.') from None
        acceleration = free + response @ torque
        if np.abs(qd).max(initial=0.0) < AT_REST:
            # Against the friction of the motion that is about to begin.
            qd = qd + SOON * acceleration
        torque, _ = self._model.inverse_dynamics(q, qd, acceleration)
        return dict(zip(self._names, torque.tolist()))
