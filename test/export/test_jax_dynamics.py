# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forward dynamics as a function of JAX: values, derivatives, batches, refusals."""

from closedloop_dynamics import Model, SimulationError
import numpy as np
import pytest

jax = pytest.importorskip('jax', reason='the extra jax is not installed')


@pytest.fixture(autouse=True)
def in_64_bits():
    with jax.enable_x64(True):
        yield


def moving(name, seed=0):
    """Return a model, its function, and a state with torques, away from rest."""
    from closedloop_dynamics import Simulation
    from closedloop_dynamics.export.jax_dynamics import jax_dynamics
    model = Model.from_scene(name)
    torque = np.random.default_rng(seed).normal(size=len(model.actuated_joints))
    simulation = Simulation(model, method='rk4')
    simulation.step(torque, 0.1)
    return model, jax_dynamics(model), (simulation.position, simulation.velocity, torque)


@pytest.mark.parametrize('name', ('three_rrr', 'slider_crank', 'rssr_four_bar'))
def test_values_and_derivatives_are_those_of_differences(name):
    model, dynamics, state = moving(name)
    found = model.evaluate(model.state(*state[:2]), state[2])
    for value, expected in zip(dynamics(*state), (found.acceleration, found.multipliers)):
        np.testing.assert_allclose(value, expected, rtol=1e-10, atol=1e-10)
    # Along states that close the loops, as others are refused: by independent coordinates, rates.
    stepper, random = model.stepper(1e-3), np.random.default_rng(1)
    direction, step = random.normal(size=2 * len(stepper.independent)), 1e-3
    by_torque, counts = random.normal(size=len(state[2])), np.array((-3, -2, -1, 1, 2, 3))
    weights = np.array((-1 / 60, 3 / 20, -3 / 4, 3 / 4, -3 / 20, 1 / 60)) / step
    q, qd = stepper.plus(*state[:2], counts[:, np.newaxis] * step * direction)
    torques = state[2] + counts[:, np.newaxis] * step * by_torque
    _, along = jax.jvp(dynamics, state, (weights @ q, weights @ qd, by_torque))
    slope = weights @ [np.concatenate(dynamics(*one)) for one in zip(q, qd, torques)]
    np.testing.assert_allclose(
        np.concatenate(along), slope, rtol=0, atol=1e-7 * max(1.0, np.abs(slope).max()))


@pytest.mark.slow
def test_reverse_is_forward_compiled_and_batched():
    _, dynamics, state = moving('three_rrr')

    def cost(*given):
        acceleration, multipliers = dynamics(*given)
        return (acceleration ** 2).sum() + jax.numpy.sin(multipliers).sum()

    gradient = jax.grad(cost, argnums=(0, 1, 2))(*state)
    compiled = jax.jit(jax.grad(cost, argnums=(0, 1, 2)))(*state)
    for place, one in enumerate(gradient):
        np.testing.assert_allclose(compiled[place], one, rtol=1e-12)
        for k, expected in enumerate(one):
            changes = [np.zeros_like(other) for other in state]
            changes[place][k] = 1.0
            _, found = jax.jvp(cost, state, tuple(changes))
            assert abs(found - expected) <= 1e-12 * np.abs(one).max()
    torques = np.random.default_rng(2).normal(size=(5, 3))
    many, _ = jax.vmap(dynamics, in_axes=(None, None, 0))(*state[:2], torques)
    by_axes, _ = dynamics(*(np.tile(one, (5, 1)) for one in state[:2]), torques)
    np.testing.assert_array_equal(by_axes, many)
    for row, torque in zip(many, torques):
        np.testing.assert_array_equal(row, dynamics(*state[:2], torque)[0])
    gradients = jax.vmap(jax.grad(cost, argnums=2), in_axes=(None, None, 0))(*state[:2], torques)
    for row, torque in zip(gradients, torques):
        np.testing.assert_allclose(
            row, jax.grad(cost, argnums=2)(*state[:2], torque), rtol=1e-12)


def test_what_has_no_derivatives_is_refused():
    from closedloop_dynamics.export.jax_dynamics import jax_dynamics
    with pytest.raises(SimulationError, match='gear_1'):
        jax_dynamics(Model.from_scene('three_rrr_payload_friction'))
    with jax.enable_x64(False), pytest.raises(RuntimeError, match='64 bits'):
        jax_dynamics(Model.from_scene('three_rrr'))
    _, dynamics, state = moving('four_bar')
    for again in (jax.jacfwd, jax.jacrev):
        with pytest.raises((NotImplementedError, ValueError),
                           match='first derivatives alone|closedloop_dynamics_step'):
            again(jax.grad(lambda q: dynamics(q, *state[1:])[0].sum()))(state[0])
    with pytest.raises(ValueError, match='torque: expected shape'):
        dynamics(*state[:2], np.zeros(2))
    with pytest.raises((ValueError, RuntimeError), match='state 1: expected finite numbers'):
        dynamics(*(np.stack([one, one * bad]) for one, bad in zip(state, (1.0, np.nan, 1.0))))
