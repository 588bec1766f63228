# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""End stops of a joint."""

from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest

from .machines import assert_balanced, block, simulated


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_an_elastic_stop_returns_the_block_after_half_a_period(side):
    stop = EndStop('slide', 400.0, lower=-0.1, upper=0.1)
    simulation = simulated(block(), {'stop': stop}, [0.0], [side], step_size=1e-4)
    # 0.1 s to the stop, half a period on it, and back to the middle.
    simulation.step(duration=0.1 + np.pi / 20.0 + 0.1)
    assert simulation.velocity[0] == pytest.approx(-side, abs=1e-7)
    assert simulation.position[0] == pytest.approx(0.0, abs=1e-7)
    assert simulation.energy_balance.dissipated == 0.0
    assert_balanced(simulation, 1e-7)


def test_damping_sets_the_restitution_and_never_pulls():
    restitution = 0.9
    stop = EndStop('slide', 1e4, upper=0.0, damping=1.5 * (1.0 - restitution))
    simulation = simulated(block(), {'stop': stop}, [-0.01], [1.0], step_size=1e-5)
    torques = []
    while simulation.position[0] >= 0.0 or simulation.velocity[0] > 0.0:
        simulation.step()
        torques.append(simulation.effect_readings('stop')['torque'])
    assert max(torques) <= 0.0
    # The rule is the first order in 1 - e.
    assert simulation.velocity[0] == pytest.approx(-restitution, abs=0.01)
    assert simulation.energy_balance.dissipated == pytest.approx(
        0.5 * (1.0 - simulation.velocity[0] ** 2), abs=1e-7)
    assert_balanced(simulation, 1e-7)


def test_a_strong_damper_lets_go_without_pulling():
    stop = EndStop('slide', 100.0, upper=0.0, damping=50.0)
    simulation = simulated(block(), {'stop': stop}, [0.1], [-1.0])
    assert simulation.acceleration[0] == 0.0
    assert simulation.effect_readings('stop') == {
        'stored_energy': pytest.approx(0.5), 'torque': -0.0, 'depth': 0.1,
        'dissipated_energy': 0.0, 'dissipated_power': pytest.approx(10.0)}


@pytest.mark.parametrize('values', [
    {'stiffness': 0.0, 'upper': 1.0}, {'stiffness': 1.0},
    {'stiffness': 1.0, 'lower': 1.0, 'upper': 0.5},
    {'stiffness': 1.0, 'upper': 1.0, 'damping': -1.0}])
def test_impossible_stops_are_refused(values):
    with pytest.raises(FieldError):
        EndStop('slide', **values)
