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

"""A simulated motion as arrays, to be compared with another one."""

from dataclasses import dataclass
import time

import numpy as np

from ..simulation.errors import SimulationError


class TooSlow(SimulationError):
    """A run that was given up because it took too long."""


@dataclass(frozen=True)
class Trajectory:
    """
    A motion at even times.

    Attributes
    ----------
    position, velocity : ndarray, shape (outputs, nv)
        [rad or m], [rad/s or m/s].
    force : ndarray, shape (outputs, nc)
        Multipliers: forces and moments at the cut joints [N, N m].
    closure : float
        Largest closure error of positions at the outputs [m or rad].
    energy_error : float
        Largest residual of the energy balance at the outputs [J].

    """

    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    closure: float
    energy_error: float

    def every(self, stride):
        """Return every ``stride``-th output alone, the first one counted as ``stride``."""
        part = slice(stride - 1, None, stride)
        return Trajectory(self.position[part], self.velocity[part], self.force[part],
                          self.closure, self.energy_error)


@dataclass(frozen=True)
class Difference:
    """Largest differences of two motions: positions, velocities, constraint forces."""

    position: float
    velocity: float
    force: float


def difference(one, other):
    """Compare two motions."""
    return Difference(*(
        float(np.abs(getattr(one, name) - getattr(other, name)).max(initial=0.0))
        for name in ('position', 'velocity', 'force')))


def record(simulation, tau, steps, outputs, patience=float('inf')):
    """
    Advance from the initial state and keep the state at even times.

    Parameters
    ----------
    simulation : Simulation
        Reset here.
    tau : ndarray, shape (nv,)
        Constant joint torques [N m or N].
    steps : int
        Whole steps from one output to the next.
    outputs : int
        How often.
    patience : float
        Give up after this time of computing [s].

    Raises
    ------
    SimulationError
        ``TooSlow`` among them.

    """
    # Compiling, half a minute in a new installation, shall not try anybody's patience.
    simulation.warm_up()
    simulation.reset()
    simulation.advance(tau, 0)
    position, velocity, force, closure, energy_error = [], [], [], 0.0, 0.0
    begin = time.perf_counter()
    for _ in range(outputs):
        simulation.advance(tau, steps)
        position.append(simulation.position)
        velocity.append(simulation.velocity)
        force.append(simulation.multipliers)
        closure = max(closure, simulation.closure)
        energy_error = max(energy_error, abs(simulation.energy_balance.residual))
        if time.perf_counter() - begin > patience:
            raise TooSlow(f'given up at t = {simulation.time:.3g} s after {patience:g} s of '
                          'computing')
    return Trajectory(np.array(position), np.array(velocity), np.array(force), closure,
                      energy_error)
