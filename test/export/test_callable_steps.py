# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Steps that are called by address: by themselves, from JAX and from PyTorch."""

import ctypes

from closedloop_dynamics import ClosureError, Model, Sensitivity, SimulationError
from closedloop_dynamics.export.callable_steps import CallableSteps, failure
import numpy as np
import pytest

PERIOD, STEPS = 2e-3, 20
ROWS = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)


def called(of, address, given, lengths):
    found = [np.full((len(given[0]), length), np.nan) for length in lengths]
    given = [np.ascontiguousarray(one) for one in given]
    pointers = [(ctypes.c_void_p * len(some))(*(one.ctypes.data for one in some))
                for some in (given, found)]
    return ROWS(address)(of.address, len(given[0]), *pointers), found


def case(name):
    """Return a model, a state, and torques."""
    model = Model.from_scene(name)
    return model, model.assemble(), np.random.default_rng(5).normal(
        size=len(model.actuated_joints))


def of_trajectory(model, state, torque):
    """Return a cost of the states after some steps, and its gradient by constant torques."""
    sensitivity = Sensitivity(model, {'integrator': 'rk4', 'step_size': PERIOD,
                                      'stabilisation': 'projection'})
    trajectory = sensitivity.trajectory(state, torque[np.newaxis], steps=STEPS)
    weights = np.zeros_like(trajectory.position), np.zeros_like(trajectory.velocity)
    weights[0][-1], weights[1][-1] = trajectory.position[-1], trajectory.velocity[-1]
    value = ((trajectory.position[-1] ** 2).sum() + (trajectory.velocity[-1] ** 2).sum()) / 2
    return value, trajectory.gradient(*weights).torques[0]


@pytest.mark.parametrize('name', ('three_rrr', 'rssr_four_bar'))
def test_rows_are_steps_and_both_derivatives_agree(name):
    model, state, _ = case(name)
    of, rng = CallableSteps(model, PERIOD), np.random.default_rng(1)
    stepper = model.stepper(PERIOD, jacobians=False)
    given = [np.tile(state.q, (4, 1)), np.tile(state.qd, (4, 1)),
             rng.normal(size=(4, of.shapes.torque))]
    code, (q, qd) = called(of, of.step, given, of.shapes[:2])
    assert code == 0
    expected = stepper.step(model.state(*given[:2]), given[2]).state
    np.testing.assert_array_equal(q, expected.q)
    np.testing.assert_array_equal(qd, expected.qd)
    changes = [rng.normal(size=one.shape) for one in given]
    weights = [rng.normal(size=one.shape) for one in (q, qd)]
    code, changed = called(of, of.change, given + changes, of.shapes[:2])
    assert code == 0
    code, weighed = called(of, of.weight, given + weights, of.shapes)
    assert code == 0
    # The adjoint of the same linear map, state by state.
    for n in range(4):
        assert sum(one[n] @ other[n] for one, other in zip(weights, changed)) == pytest.approx(
            sum(one[n] @ other[n] for one, other in zip(weighed, changes)), rel=1e-11)
    # By torques, whose changes leave the loops closed.
    step = 1e-4
    along = [np.zeros_like(one) for one in given[:2]] + [changes[2]]
    _, changed = called(of, of.change, given + along, of.shapes[:2])
    both = [called(of, of.step, [*given[:2], given[2] + k * step * changes[2]], of.shapes[:2])[1]
            for k in (1, -1)]
    for one, up, down in zip(changed, *both):
        np.testing.assert_allclose(one, (up - down) / (2 * step), rtol=0, atol=1e-8)
    # What fails is named by its number.
    given[0][2] += 0.1
    code, _ = called(of, of.step, given, of.shapes[:2])
    error = failure(code)
    assert isinstance(error, ClosureError) and 'state 2: it leaves the loops open' in str(error)


def test_what_has_no_derivatives_is_refused():
    with pytest.raises(SimulationError, match='gear_1'):
        CallableSteps(Model.from_scene('three_rrr_payload_friction'), PERIOD)


@pytest.mark.parametrize('name', ('three_rrr', pytest.param(
    'stewart_platform', marks=pytest.mark.slow)))
def test_jax_steps_natively(name):
    jax = pytest.importorskip('jax', reason='the extra jax is not installed')
    from closedloop_dynamics.export.jax_step import jax_step
    model, state, torque = case(name)
    with jax.enable_x64(False), pytest.raises(RuntimeError, match='64 bits'):
        jax_step(model, PERIOD, steps=1)
    with jax.enable_x64(True):
        step = jax_step(model, PERIOD, steps=1)

        def cost(torque):
            def body(at, _):
                return step(*at, torque), None

            q, qd = jax.lax.scan(
                body, tuple(map(jax.numpy.asarray, (state.q, state.qd))), None, length=STEPS)[0]
            return ((q ** 2).sum() + (qd ** 2).sum()) / 2

        value, gradient = of_trajectory(model, state, torque)
        assert float(jax.jit(cost)(torque)) == pytest.approx(value, rel=1e-12)
        scale = np.abs(gradient).max()
        for found in (jax.grad(cost)(torque), jax.jit(jax.grad(cost))(torque),
                      jax.jacfwd(cost)(torque)):
            np.testing.assert_allclose(found, gradient, rtol=0, atol=1e-10 * scale)
        many = np.stack([torque, 0.5 * torque, -torque])
        found = jax.jit(jax.vmap(jax.grad(cost)))(many)
        for row, one in zip(found, many):
            np.testing.assert_allclose(
                row, of_trajectory(model, state, one)[1], rtol=0, atol=1e-10 * scale)
        # Batches by leading axes are those of vmap.
        rows = jax.numpy.stack([state.q] * 3), jax.numpy.stack([state.qd] * 3), many
        for one, other in zip(step(*rows), jax.vmap(step, in_axes=(None, None, 0))(
                state.q, state.qd, many)):
            np.testing.assert_array_equal(one, other)
        for again in (jax.jacfwd, jax.jacrev):
            with pytest.raises((NotImplementedError, ValueError),
                               match='first derivatives alone|closedloop_dynamics_step'):
                again(jax.grad(cost))(torque)
        with pytest.raises(ValueError, match='torque: expected shape'):
            step(state.q, state.qd, torque[1:])
        # JAX has two types for it.
        with pytest.raises((ValueError, RuntimeError),
                           match='state 0: it leaves the loops open.*: cut_joints.* open by'):
            step(state.q + 0.1, state.qd, torque)


def test_pytorch_steps_natively():
    torch = pytest.importorskip('torch', reason='the extra torch is not installed')
    from closedloop_dynamics.export.torch_step import torch_step
    model, state, torque = case('three_rrr')
    step = torch_step(model, PERIOD, steps=1)
    start = [torch.tensor(np.array(one)) for one in (state.q, state.qd)]

    def cost(torque):
        at = start
        for _ in range(STEPS):
            at = step(*at, torque)
        return sum((one ** 2).sum() for one in at) / 2

    value, gradient = of_trajectory(model, state, torque)
    scale, given = np.abs(gradient).max(), torch.tensor(torque, requires_grad=True)
    found = cost(given)
    assert found.item() == pytest.approx(value, rel=1e-12)
    found.backward()
    np.testing.assert_allclose(given.grad, gradient, rtol=0, atol=1e-10 * scale)
    many = torch.tensor(np.stack([torque, 0.5 * torque, -torque]))
    for row, one in zip(torch.func.vmap(torch.func.grad(cost))(many), many.numpy()):
        np.testing.assert_allclose(
            row, of_trajectory(model, state, one)[1], rtol=0, atol=1e-10 * scale)
    first, = torch.autograd.grad(cost(given), given, create_graph=True)
    with pytest.raises(NotImplementedError, match='three_rrr.* has first derivatives alone'):
        first.sum().backward()
    with pytest.raises(ValueError, match='torque: expected float64 of shape'):
        step(*start, given.detach().float())
    with pytest.raises(ClosureError, match='state 0: it leaves the loops open'):
        step(start[0] + 0.1, start[1], given)
