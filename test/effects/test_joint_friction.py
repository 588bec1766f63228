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

"""Dry friction in a joint."""

from closedloop_dynamics import Simulation
from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.joint_friction import JointFriction
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.errors import SimulationError
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.mechanism import REVOLUTE
from closedloop_dynamics.scene_records import Initial, Method, Scene
import numpy as np
import pytest

from .machines import assert_balanced, block, pendulum, simulated
from ..reference import cases, maximal


def oscillator(give, step_size):
    """Return the benchmark of dry friction, its bristle giving way by ``give`` [m]."""
    friction = JointFriction('slide', 1.0, stiffness=1.0 / give, damping=1.5 / np.sqrt(give))
    return simulated(block(), {'spring': JointSpring('slide', 100.0), 'friction': friction},
                     [0.105], step_size=step_size)


def test_the_oscillator_sticks_where_it_should_and_stays():
    simulation = oscillator(2e-10, 2e-5)
    simulation.step(duration=1.58)
    assert simulation.position[0] == pytest.approx(-0.005, abs=1e-9)
    stuck = simulation.position[0]
    simulation.step(duration=10.0)
    assert simulation.position[0] == pytest.approx(stuck, abs=1e-14)
    assert_balanced(simulation, 1e-8)


@pytest.mark.slow
def test_the_oscillator_does_not_creep_in_a_hundred_seconds():
    simulation = oscillator(2e-10, 2e-5)
    simulation.step(duration=100.0)
    assert simulation.position[0] == pytest.approx(-0.005, abs=1e-9)


def test_a_soft_bristle_gives_way_by_what_it_says():
    simulation = oscillator(1e-5, 1e-3)
    simulation.step(duration=3.0)
    assert simulation.position[0] == pytest.approx(-0.005, abs=5e-5)
    # Force of the spring against force of the bristle.
    assert simulation.effect_readings('friction')['torque'] == pytest.approx(
        100.0 * simulation.position[0], abs=1e-6)


def test_error_control_finds_the_reversals():
    friction = JointFriction('slide', 1.0, stiffness=1e7, damping=5e3)
    simulation = simulated(block(), {'spring': JointSpring('slide', 100.0), 'friction': friction},
                           [0.105], integrator='dopri5', step_size=0.1, tolerance=1e-8)
    simulation.step(duration=1.5)
    # Reversals are sharp to F / c = 2e-4 m/s, here 1e-4 s. This is the fifth swing, about 0.01.
    assert simulation.position[0] == pytest.approx(
        0.01 + 0.015 * np.cos(10.0 * (1.5 - 0.4 * np.pi)), abs=3e-5)


@pytest.mark.parametrize('solver', ['scipy_dop853', 'scipy_radau', 'scipy_lsoda'])
def test_solvers_that_cannot_keep_the_bristle_within_its_limit_are_refused(solver):
    with pytest.raises(SimulationError, match=f'brake.*{solver}.*dop853, rodas4'):
        simulated(block(), {'brake': JointFriction('slide', 1.0)}, [0.0], integrator=solver)
    simulated(block(), {'spring': JointSpring('slide', 100.0)}, [0.0], integrator=solver)


def test_error_control_follows_a_change_of_the_bristle():
    ends = []
    for first in (1e3, 1e7):
        simulation = simulated(
            block(), {'friction': JointFriction('slide', 1.0, stiffness=first, damping=100.0)},
            [0.0], [1.0], integrator='dopri5', step_size=0.1, tolerance=1e-6)
        simulation.set_effect('friction', stiffness=1e7)
        simulation.step(duration=1.5)
        ends.append((*simulation.position, *simulation.velocity))
    assert ends[0] == ends[1]


def test_sliding_friction_is_exact():
    simulation = simulated(block(2.0), {'friction': JointFriction('slide', 3.0)}, [0.0], [2.0])
    simulation.step(duration=1.0)
    assert simulation.velocity[0] == pytest.approx(0.5, abs=2e-5)
    assert simulation.energy_balance.dissipated == pytest.approx(
        4.0 - simulation.velocity[0] ** 2, rel=1e-9)


def test_stribeck_friction_falls_with_the_rate():
    friction = JointFriction('slide', 2.0, static_ratio=1.5, stribeck_velocity=0.1)
    simulation = simulated(block(), {'friction': friction}, [0.0], [0.1])
    simulation.step(duration=1e-2)
    rate = simulation.velocity[0]
    assert simulation.effect_readings('friction')['torque'] == pytest.approx(
        -2.0 * (1.0 + 0.5 * np.exp(-(rate / 0.1) ** 2)), rel=1e-9)


@pytest.mark.parametrize('force, moves', [(2.6, False), (3.1, True)])
def test_the_static_limit_decides_what_moves(force, moves):
    friction = JointFriction(
        'slide', 2.0, static_ratio=1.5, stribeck_velocity=0.1, damping=200.0)
    simulation = simulated(block(), {'friction': friction}, [0.0])
    simulation.step([force], 1.0)
    assert (simulation.position[0] > 0.1) == moves
    if not moves:
        assert simulation.position[0] == pytest.approx(force / 1e4, rel=1e-6)
        assert abs(simulation.velocity[0]) < 1e-9


@pytest.mark.parametrize('angle', [0.0, 0.3])
def test_a_block_slides_on_its_own_weight(angle):
    friction = JointFriction('slide', friction_coefficient=0.25)
    simulation = simulated(
        block(2.0, angle), {'gravity': Gravity((0.0, -9.81)), 'friction': friction}, [0.0], [4.0])
    simulation.step(duration=0.5)
    pull = 9.81 * (np.sin(angle) + 0.25 * np.cos(angle))
    assert simulation.velocity[0] == pytest.approx(4.0 - 0.5 * pull, abs=1e-4)
    assert simulation.effect_readings('friction')['reaction'] == pytest.approx(
        2.0 * 9.81 * np.cos(angle), rel=1e-9)
    assert_balanced(simulation, 1e-6)


def test_a_hinge_feels_weight_and_centrifugal_force():
    friction = JointFriction('hinge', friction_coefficient=0.1, radius=0.02)
    simulation = simulated(
        pendulum(), {'gravity': Gravity((0.0, -9.81)), 'friction': friction},
        [-np.pi / 2.0], [3.0])
    force = 2.0 * (9.81 + 9.0 * 0.5)
    # The friction's own deceleration adds a little across.
    assert simulation.effect_readings('friction')['reaction'] == pytest.approx(force, rel=1e-4)
    assert simulation.effect_readings('friction')['limit'] == pytest.approx(
        0.002 * force, rel=1e-3)


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_reactions_equal_those_of_maximal_coordinates(case):
    _, mechanism, q, qd = cases.drawn(case)
    # Friction too small to matter: what is looked at are the forces.
    effects = {'gravity': Gravity((0.0, -9.81)), **{
        f'at_{joint.name}': JointFriction(joint.name, friction_coefficient=1e-12)
        for joint in mechanism.joints}}
    simulation = Simulation(Scene('drawn', None, '', mechanism, Initial(tuple(q), tuple(qd)),
                                  effects, Method()))
    expected = maximal.forward_dynamics(mechanism, q, qd, np.zeros(len(q))).reactions
    for joint in mechanism.joints:
        reaction = np.ravel(expected[joint.name])
        size = np.hypot(*reaction[:2]) if joint.type == REVOLUTE else abs(reaction[0])
        assert simulation.effect_readings(f'at_{joint.name}')['reaction'] == pytest.approx(
            size, rel=1e-8)


@pytest.mark.parametrize('values', [
    {'coulomb': -1.0}, {'static_ratio': 0.5}, {'stiffness': 0.0}, {'stribeck_velocity': 0.0},
    {'load_time': 0.0}, {'radius': 0.0}])
def test_impossible_friction_is_refused(values):
    with pytest.raises(FieldError):
        JointFriction('slide', **values)
