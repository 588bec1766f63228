# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Springs and dampers between points, and external forces: a published benchmark."""

from closedloop_dynamics.effects.registry import ExternalForce, PointSpring
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated, slider_crank
from ..reference import exact


def benchmark(**method):
    """Return the slider-crank benchmark of SUNDIALS."""
    _, rod, *_ = exact.slider_crank_geometry(np.pi / 2.0)
    slider = exact.slider_crank_geometry(np.pi / 2.0)[0]
    return simulated(slider_crank(), {
        'strut': PointSpring('middle_of_crank', 'middle_of_rod', stiffness=1.0, damping=1.0,
                             free_length=1.0),
        'push': ExternalForce('end', (1.0, 0.0))}, [np.pi / 2.0, slider, rod], **method)


@pytest.mark.parametrize('method', [
    {'integrator': 'rk4', 'step_size': 2e-3}, {'integrator': 'dop853', 'tolerance': 1e-11}])
def test_slider_crank_with_strut_and_push_equals_the_exact_motion(method):
    simulation = benchmark(**method)
    simulation.step(duration=10.0)
    expected = exact.slider_crank([10.0])
    for index, name in enumerate(('crank', 'slider', 'rod')):
        assert simulation.position[index] == pytest.approx(expected[name][0], abs=1e-9)
        assert simulation.velocity[index] == pytest.approx(expected[name + '_rate'][0], abs=1e-9)
    assert_balanced(simulation, 1e-9)
    assert simulation.energy_balance.dissipated > 0.1
    assert abs(simulation.energy_balance.work) > 0.1


def test_a_spring_to_the_world_pulls_along_its_line():
    spring = PointSpring('ball', anchor=(3.0, 4.0), stiffness=10.0, free_length=1.0)
    simulation = simulated(flyer(), {'cord': spring}, [0.0, 0.0, 0.0])
    # 40 N along (0.6, 0.8); the rails weigh 0.25 kg each.
    assert np.allclose(simulation.acceleration, [24.0 / 1.5, 32.0 / 1.25, 0.0], atol=1e-12)
    assert simulation.effect_readings('cord') == {
        'stored_energy': pytest.approx(80.0), 'tension': pytest.approx(40.0),
        'length': pytest.approx(5.0), 'dissipated_energy': 0.0, 'dissipated_power': 0.0}


def test_points_that_meet_feel_no_force():
    spring = PointSpring('center', anchor=(0.0, 0.0), stiffness=10.0)
    simulation = simulated(block(), {'cord': spring}, [0.0])
    assert simulation.acceleration[0] == 0.0


def test_a_constant_force_works_by_the_way_it_goes():
    simulation = simulated(flyer(), {'push': ExternalForce('rim', (2.0, -1.0))}, [0.1, 0.0, 0.3])
    start = simulation.point('rim')
    simulation.step(duration=0.7)
    way = simulation.point('rim') - start
    assert simulation.energy_balance.work == pytest.approx(way @ [2.0, -1.0], rel=1e-9)
    assert_balanced(simulation, 1e-9)
