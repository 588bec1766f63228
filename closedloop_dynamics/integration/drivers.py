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

"""What a simulation drives its state with: one object per way of stepping."""

import numpy as np

from . import adaptive, advance
from .registry import ADAPTIVE, INTEGRATORS, STABILISATIONS


def build_driver(system, method):
    """
    Build the driver of a scene's method.

    Parameters
    ----------
    system : System
    method : Method
        With ``integrator``, ``stabilisation``, ``step_size`` and ``tolerance``.

    Returns
    -------
    FixedSteps or ErrorControlled

    """
    integrator = INTEGRATORS[method.integrator]
    stabilisation = STABILISATIONS[method.stabilisation]
    if integrator.kind == ADAPTIVE:
        return ErrorControlled(system, integrator, stabilisation, method.tolerance)
    return FixedSteps(system, integrator, stabilisation)


class FixedSteps:
    """
    Steps of one size.

    Parameters
    ----------
    system : System
    integrator : Integrator
    stabilisation : int

    """

    def __init__(self, system, integrator, stabilisation):
        """Allocate the scratch of the method."""
        self._system, self._tableau = system, integrator.tableau
        self._stabilisation = stabilisation
        self._scratch = np.zeros((len(self._tableau.a) + 2, 2 * len(system.qdd)))

    def advance(self, state, time, step_size, steps):
        """
        Advance a state by whole steps.

        Parameters
        ----------
        state : ndarray, shape (ns,)
            Advanced in place; on failure the one before the failing step.
        time : float
            Of the state [s].
        step_size : float
        steps : int

        Returns
        -------
        status : int
            Of ``integration.advance``.
        elapsed : float
            Time advanced by [s].

        """
        status, done = advance.advance(
            self._system, self._tableau, self._stabilisation, state, step_size, steps,
            self._scratch)
        return status, done * step_size

    def restart(self):
        """Forget the past: torques or the state have changed. Fixed steps have none."""


class ErrorControlled:
    """
    Steps of an embedded pair, as long as the tolerance allows.

    Parameters
    ----------
    system : System
    integrator : Integrator
    stabilisation : int
    tolerance : float
        Local error allowed per step: in each coordinate [rad, m], and in each rate relative
        to 1 rad/s (1 m/s) plus its own size.

    """

    def __init__(self, system, integrator, stabilisation, tolerance):
        """Allocate the scratch of the method."""
        self._system, self._tableau = system, integrator.tableau
        self._stabilisation = stabilisation
        nv = len(system.qdd)
        self._scratch = np.zeros((len(self._tableau.a) + 4, 2 * nv))
        self._scale = np.full((2, 2 * nv), tolerance)
        self._scale[1, :nv] = 0.0
        self.control = np.zeros(adaptive.CONTROL_COLUMNS)

    def advance(self, state, time, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``FixedSteps.advance``."""
        if self.control[adaptive.STEP_SIZE] == 0.0:
            self.control[adaptive.REACHED] = time
        status = adaptive.advance(
            self._system, self._tableau, self._stabilisation, state, time + steps * step_size,
            self.control, self._scale, self._scratch)
        if status == advance.DONE:
            return status, steps * step_size
        return status, self.control[adaptive.REACHED] - time

    def restart(self):
        """Forget the past: torques or the state have changed."""
        self.control[adaptive.STEP_SIZE] = 0.0
