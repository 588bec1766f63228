# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What is published has passed the energy guard."""

from types import SimpleNamespace

from closedloop_dynamics import Simulation, SimulationError
from closedloop_dynamics.ros.live import LiveSimulation
from closedloop_dynamics.simulation.guards import ENERGY_ERROR
import numpy as np
import pytest


class Taker:
    """Stamps and states of a node, that only note the energy of each state published."""

    def __init__(self, simulation):
        """Begin with nothing published."""
        self._simulation, self.stamp = simulation, None
        self.states, self.residuals, self.energies = [], [], []

    def earlier(self, late, before):
        """Return no stamp."""

    def publish(self, *values):
        """Note the state where it is published, not the stamp."""
        if values:
            balance = self._simulation.energy_balance
            self.states.append(self._simulation.state)
            self.residuals.append(balance.residual)
            self.energies.append(balance.kinetic + abs(balance.stored))


@pytest.mark.parametrize('steps', [1, 3, 10])
def test_no_state_is_published_that_the_energy_guard_refuses(steps):
    # Steps of 1 ms are too long for the contact of the Geneva drive.
    simulation = Simulation.from_scene('geneva_drive', integrator='rk4')
    taker = Taker(simulation)
    command = SimpleNamespace(torque=np.zeros(len(simulation.data.actuated)))
    live = LiveSimulation(simulation, command, taker, taker, None, None)
    live.publish()
    with pytest.raises(SimulationError, match='energy balance'):
        for _ in range(1000):
            live.advance(steps)
            live.publish()
    assert len(taker.states) > 2
    residuals = np.array(taker.residuals) - taker.residuals[0]
    assert (np.abs(residuals) <= ENERGY_ERROR * np.array(taker.energies)).all()
    # What goes on is the latest of them.
    assert (simulation.state == taker.states[-1]).all()
