# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""End stops of a joint."""

from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism
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


def test_a_step_that_a_stop_cuts_is_not_repeated():
    stop = EndStop('slide', 400.0, lower=-0.1, upper=0.1)
    simulation = simulated(
        block(), {'stop': stop}, [0.0], [1.0], step_size=2e-3, integrator='dop853')
    before, half, worst = simulation.health.evaluations, 0.2 + np.pi / 20.0, 0.0
    for number in range(1, 501):
        simulation.step([1e-13 * number], 2e-3)
        side, time = divmod(2e-3 * number, half)
        exact = time if time < 0.1 else half - time if time > half - 0.1 else (
            0.1 + 0.05 * np.sin(20.0 * (time - 0.1)))
        worst = max(worst, abs(simulation.position[0] - (-1.0) ** side * exact))
    assert worst < 1e-9
    # Five events, each of which takes dense output and guesses of the next step.
    accepted = simulation.stepping.run.steps.accepted
    assert simulation.health.evaluations - before < 12 * (accepted + 6)


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


@pytest.mark.parametrize('speed, apart, method', [
    (0.1, 1.1e-11, {'integrator': 'rodas4', 'tolerance': 1e-8}),
    (0.01, 7e-12, {'integrator': 'dopri5', 'tolerance': 1e-11}),
    (0.001, 7e-12, {'integrator': 'dop853', 'tolerance': 1e-11}),
    (0.001, 7e-12, {'integrator': 'auto'}),
    (0.001, 1.1e-11, {'integrator': 'auto', 'accuracy': 1e-9})])
def test_blocks_that_part_from_their_stops_at_almost_one_instant_go_on(speed, apart, method):
    count = 9
    blocks = Mechanism(
        'blocks', tuple(Body(f'block_{k}', 1.0, (0.0, 0.0), 0.1) for k in range(count)),
        tuple(Joint(f'slide_{k}', 'prismatic', 'ground', f'block_{k}', (0.0, 0.0), 0.0, True)
              for k in range(count)), (), ())
    simulation = simulated(
        blocks, {f'stop_{k}': EndStop(f'slide_{k}', 400.0, upper=0.0) for k in range(count)},
        [-0.02 * speed + apart * k for k in range(count)], [speed] * count, **method)
    # To the stops in 0.02 s, half a period on them, and on for 0.1 s.
    simulation.step(duration=0.02 + np.pi / 20.0 + 0.1)
    assert simulation.velocity == pytest.approx(np.full(count, -speed), abs=1e-7)
    assert simulation.position == pytest.approx(np.full(count, -0.1 * speed), abs=1e-7)
