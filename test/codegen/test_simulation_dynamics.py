# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Dynamics as users call them, through ``Simulation``."""

from dataclasses import replace
from functools import partial

from closedloop_dynamics import AssemblyError, Simulation, SimulationError
import numpy as np
import pytest

from .engine import Engine
from ..mechanism.test_between import FOUR_BAR
from ..reference import cases, dense, scenes
from ..reference.compare import assert_agree, IDENTITY, SOLVE


simulated = partial(scenes.simulated, gravity=dense.EARTH)


def torques(rng, mechanism):
    """Return (mapping of actuated joints to torques, the same as an array of nv)."""
    chosen = {name: float(rng.normal()) for name in mechanism.actuated_joints}
    return chosen, np.array([chosen.get(name, 0.0) for name in mechanism.joint_names])


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_forward_dynamics_of_shipped_scenes_equals_the_twin(case):
    rng, mechanism, q, qd = cases.drawn(case)
    by_name, tau = torques(rng, mechanism)
    simulation = Simulation.from_scene(case)
    qdd, lam = dense.forward_dynamics(mechanism, q, qd, tau)
    for torque in (by_name, [by_name[name] for name in simulation.actuated_joints]):
        found_qdd, found_lam = simulation.forward_dynamics(q, qd, torque)
        assert_agree(found_qdd, qdd, SOLVE)
        assert_agree(found_lam, lam, SOLVE)


def test_state_of_a_simulation_equals_the_twin(drawn):
    _, mechanism, q, qd = drawn
    simulation = simulated(mechanism, q, qd)
    # Assembly leaves a state that closes where it is.
    assert_agree(simulation.position, q, SOLVE, smallest=1.0)
    assert_agree(simulation.velocity, qd, SOLVE, smallest=1.0)
    qdd, lam = dense.forward_dynamics(mechanism, q, qd, np.zeros(len(q)))
    assert_agree(simulation.acceleration, qdd, SOLVE)
    assert_agree(simulation.multipliers, lam, SOLVE)
    assert_agree(simulation.constraint_forces, dense.constraint_forces(mechanism, q, lam), SOLVE)
    kinetic, potential = (dense.kinetic_energy(mechanism, q, qd),
                          dense.potential_energy(mechanism, q))
    assert simulation.energy == pytest.approx(
        kinetic + potential, abs=SOLVE * (kinetic + abs(potential)))
    assert simulation.closure < 1e-12 * 10.0


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_inverse_dynamics_returns_torques_and_multipliers(case):
    rng, mechanism, q, qd = cases.drawn(case)
    simulation = Simulation.from_scene(case)
    by_name, _ = torques(rng, mechanism)
    qdd, lam = simulation.forward_dynamics(q, qd, by_name)
    torque, multipliers = simulation.inverse_dynamics(q, qd, qdd)
    # The torques are what is left of the forces that hold the links.
    assert_agree(torque, list(by_name.values()), SOLVE, smallest=np.abs(lam).max())
    assert_agree(multipliers, lam, SOLVE)


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_forward_after_inverse_dynamics_returns_the_accelerations(case):
    rng, mechanism, q, qd = cases.drawn(case)
    simulation = Simulation.from_scene(case)
    jac, bias = dense.closure_jacobian(mechanism, q), dense.constraint_bias(mechanism, q, qd)
    qdd = rng.normal(size=len(q))
    qdd -= np.linalg.lstsq(jac, jac @ qdd + bias, rcond=None)[0]
    torque, lam = simulation.inverse_dynamics(q, qd, qdd)
    found_qdd, found_lam = simulation.forward_dynamics(q, qd, torque)
    # The torques cancel most of what gravity alone would do.
    falling, _ = simulation.forward_dynamics(q, qd)
    assert_agree(found_qdd, qdd, SOLVE, smallest=np.abs(falling).max())
    assert_agree(found_lam, lam, SOLVE)


def test_inverse_dynamics_refuses_what_the_actuated_joints_cannot_do():
    _, mechanism, q, qd = cases.drawn('star')
    mechanism = replace(mechanism, joints=tuple(
        replace(joint, actuated=joint.name == 'hip_0') for joint in mechanism.joints))
    simulation = simulated(mechanism, q, qd)
    # One drive cannot hold three freedoms still.
    bias = dense.constraint_bias(mechanism, q, qd)
    qdd = -np.linalg.lstsq(dense.closure_jacobian(mechanism, q), bias, rcond=None)[0]
    with pytest.raises(SimulationError, match='hip_0'):
        simulation.inverse_dynamics(q, qd, qdd)


def test_inverse_dynamics_refuses_an_acceleration_that_opens_the_loops():
    _, _, q, qd = cases.drawn('four_bar')
    with pytest.raises(SimulationError):
        Simulation.from_scene('four_bar').inverse_dynamics(q, qd, [1.0, 0.0, 0.0])


@pytest.mark.parametrize('case', cases.SHIPPED)
def test_inverse_dynamics_accepts_a_slow_motion(case):
    _, mechanism, q, qd = cases.drawn(case)
    slow = 1e-3 * qd
    bias = dense.constraint_bias(mechanism, q, slow)
    qdd = -np.linalg.lstsq(dense.closure_jacobian(mechanism, q), bias, rcond=None)[0]
    _, lam = Simulation.from_scene(case).inverse_dynamics(q, slow, qdd)
    assert_agree(lam, dense.inverse_dynamics(mechanism, q, slow, qdd)[1], SOLVE)


def test_a_refused_state_leaves_the_present_one_untouched():
    simulation = Simulation.from_scene('four_bar')
    point, energy, closure = (simulation.point('coupler_point'), simulation.energy,
                              simulation.closure)
    with pytest.raises(AssemblyError):
        # The rocker points away from the crank, out of the coupler's reach.
        simulation.set_state([0.0, 0.0, -0.1], hold=('crank_joint', 'rocker_joint'))
    assert np.array_equal(simulation.point('coupler_point'), point)
    assert simulation.energy == energy
    assert simulation.closure == closure


def test_a_state_is_set_by_joint_name():
    simulation, other = (Simulation.from_scene('three_rrr') for _ in range(2))
    simulation.step({'theta_1': 5.0}, 0.05)
    other.set_state(simulation.position, simulation.velocity)
    hold = simulation.actuated_joints
    position, velocity = simulation.position, simulation.velocity
    position[0], velocity[5] = 1.1, 0.3
    other.set_state(position, velocity, hold)
    simulation.set_state({'theta_1': 1.1}, {'theta_6': 0.3}, hold)
    assert np.array_equal(simulation.position, other.position)
    assert np.array_equal(simulation.velocity, other.velocity)
    assert (simulation.position[0], simulation.velocity[5]) == (1.1, 0.3)
    with pytest.raises(ValueError, match='velocity.tetha_1: expected one of the keys theta_1, .*'
                                         'did you mean .theta_1.'):
        simulation.set_state({}, {'tetha_1': 1.0})
    assert np.array_equal(simulation.velocity, other.velocity)


def test_a_closed_state_is_set_bit_for_bit():
    simulation = Simulation.from_scene('three_rrr')
    simulation.step({'theta_1': 5.0}, 0.3)
    position, velocity = simulation.position, simulation.velocity
    simulation.set_state(position, velocity)
    assert np.array_equal(simulation.position, position)
    assert np.array_equal(simulation.velocity, velocity)
    assert simulation.data.assembly_notes() == []


def test_an_unknown_part_of_the_method_is_reported_with_the_known_ones():
    with pytest.raises(ValueError, match='method.step: expected one of the keys integrator, '
                                         "step_size, .* got the unknown key 'step' .did you mean "
                                         "'step_size'"):
        Simulation.from_scene('three_rrr', step=1e-3)
    with pytest.raises(ValueError, match='method.step_size: expected a positive number, got -1'):
        Simulation.from_scene('three_rrr', step_size=-1)


def test_asking_about_other_states_leaves_the_present_one_untouched():
    rng, mechanism, q, qd = cases.drawn('three_rrr')
    simulation = Simulation.from_scene('three_rrr')
    before = (simulation.acceleration, simulation.multipliers, simulation.energy,
              simulation.effort)
    qdd, _ = simulation.forward_dynamics(q, qd, [1.0, 2.0, 3.0])
    simulation.inverse_dynamics(q, qd, qdd)
    after = (simulation.acceleration, simulation.multipliers, simulation.energy,
             simulation.effort)
    for one, other in zip(before, after):
        assert np.array_equal(one, other)


def test_simulation_uses_the_method_by_default():
    simulation = Simulation.from_scene('three_rrr')
    _, _, q, qd = cases.drawn('three_rrr')
    expected = Engine(simulation.mechanism).forward_dynamics(q, qd, np.zeros(7))
    for found, value in zip(simulation.forward_dynamics(q, qd), expected):
        assert_agree(found, value, IDENTITY)


def test_the_tree_that_is_chosen_moves_as_another_one(tmp_path):
    # Without a compiler, too, where no operations are counted.
    (tmp_path / 'scene.yaml').write_text(
        'mechanism: ./machine.yaml\ninitial: {position: {crank_joint: 1.0, coupler_joint: -0.5, '
        'tip: 1.2, rocker_joint: 1.7}, hold: [crank_joint]}\n'
        'effects: {gravity: {type: gravity, acceleration: [0.0, -9.81]}}')
    accelerations = {}
    for text in (FOUR_BAR, FOUR_BAR.replace('[0, 0]]}', '[0, 0]], cut: true}')):
        (tmp_path / 'machine.yaml').write_text(text)
        simulation = Simulation.from_scene(tmp_path / 'scene.yaml')
        accelerations[simulation.mechanism.tree.cut] = simulation.acceleration[0]
    assert set(accelerations) == {('tip',), ('rocker_joint',)}
    assert abs(accelerations['tip',]) > 1.0
    assert_agree(*accelerations.values(), SOLVE)
