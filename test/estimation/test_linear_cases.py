# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Where a mechanism is linear, estimates are those of textbook filters and smoothers."""

from closedloop_dynamics.estimation.estimator import Estimator, Noise, SIGMA_POINTS, Start
from closedloop_dynamics.estimation.smoothing import fit, smooth
from closedloop_dynamics.estimation.unknowns import Bias, JointTorque
from closedloop_dynamics.simulation.stepper import Stepper
from filterpy.kalman import KalmanFilter
import numpy as np
import pytest

from .cases import encoders, Machine, pendulum, positions_of, spring_chain

PERIOD, COUNT, DEVIATION = 0.01, 60, 1e-3
NOISE = 0.3
# Of results of some 1e-2; both filters invert the same matrices.
EQUAL = 1e-9


def textbook(model, joints, small=1.0):
    """
    Return a Kalman filter of the scene's start at rest, with an unknown torque as its last state.

    The torque acts in the first joint; Jacobians of a step of the method are those of a linear
    machine everywhere.
    """
    stepper = Stepper(model, PERIOD)
    start = model.assemble()
    stepper.q[:], stepper.qd[:], stepper.tau[:] = start.q, start.qd, 0.0
    stepper()
    n = len(start.qd)
    filter_ = KalmanFilter(dim_x=2 * n + 1, dim_z=len(joints), dim_u=1)
    filter_.F = np.block([[stepper.A, stepper.B], [np.zeros((1, 2 * n)), np.ones((1, 1))]])
    filter_.B = np.concatenate((stepper.B, np.zeros((1, 1))))
    filter_.H = np.eye(2 * n + 1)[joints]
    filter_.R = np.eye(len(joints)) * DEVIATION ** 2 * small ** 2
    filter_.P = np.diag([*n * (0.02 ** 2,), *n * (0.2 ** 2,), 0.5 ** 2]) * small ** 2
    filter_.x = np.zeros((2 * n + 1, 1))
    one = NOISE ** 2 * np.array(((PERIOD ** 3 / 3, PERIOD ** 2 / 2), (PERIOD ** 2 / 2, PERIOD)))
    filter_.Q = np.zeros((2 * n + 1, 2 * n + 1))
    filter_.Q[:2 * n, :2 * n] = np.kron(one, np.eye(n))
    filter_.Q[-1, -1] = 0.2 ** 2 * PERIOD
    filter_.Q *= small ** 2
    return filter_


def case(name):
    """Return a model, the joints that are measured, and a scale of all that happens."""
    if name == 'chain':
        return spring_chain(), [1], 1.0
    # So small that the square of the angle, which bends the sine, is below rounding.
    return pendulum(), [0], 1e-7


@pytest.mark.parametrize('method', ['extended', SIGMA_POINTS])
@pytest.mark.parametrize('name', ['chain', 'pendulum'])
def test_estimates_equal_a_kalman_filter_and_its_smoother(name, method):
    model, joints, small = case(name)
    measured = [model.coordinates.names[joint] for joint in joints]
    # Its smoother knows no torques that are commanded.
    moving = model.state(np.full(len(model.assemble().q), 0.02 * small))
    machine = Machine(model, lambda t, q, qd: [0.0], moving)
    record, _ = machine.run(PERIOD * COUNT, PERIOD, positions_of(measured, small * DEVIATION))
    driven = model.actuated_joints[0]
    arguments = (
        model, encoders(measured, small * DEVIATION), record,
        [JointTorque('load', joint=driven, deviation=0.5 * small, density=0.2 * small)],
        Noise(small * NOISE), Start(position=0.02 * small, rate=0.2 * small))
    settings = {'gate': 1.0 - 1e-15, 'method': method}
    found = smooth(*arguments, **settings)
    twin = textbook(model, joints, small)
    means, covariances = [], []
    for k, torque in enumerate(record.torques):
        if k:
            twin.predict()
        twin.update(np.array([record.measurements[one][k] for one in measured]))
        means.append(twin.x.copy())
        covariances.append(twin.P.copy())
    smoothed, spreads, *_ = twin.rts_smoother(np.array(means), np.array(covariances))
    everything = [(found.filtered, means, covariances), (found.beliefs, smoothed, spreads)]
    if method == 'extended':
        fitted = fit(*arguments, **settings)
        # Sparse equations of all instants, of a condition of some 1e6, instead of one by one.
        everything.append((fitted.beliefs, smoothed, spreads))
    for beliefs, mean, spread in everything:
        for belief, x, covariance in zip(beliefs, mean, spread):
            own = np.concatenate((belief.state.q, belief.state.qd, belief.values))
            assert np.abs(own - x.ravel()).max() < EQUAL * small
            assert np.abs(belief.covariance - covariance).max() < EQUAL * small ** 2


def test_bias_of_a_sensor_equals_a_state_of_a_kalman_filter():
    model = spring_chain()
    machine = Machine(model, lambda t, q, qd: [np.sin(8.0 * t)])
    record, _ = machine.run(PERIOD * COUNT, PERIOD, positions_of(
        model.coordinates.names, DEVIATION))
    sensors = encoders(model.coordinates.names, DEVIATION)
    estimator = Estimator(model, sensors, [Bias('offset', sensor='slide_0', deviation=0.5)],
                          Noise(NOISE), gate=1.0 - 1e-15)
    twin = textbook(model, [0, 1])
    # The last state is added to the first reading instead of being a torque.
    twin.F[:-1, -1], twin.Q[-1, -1], twin.H[0, -1] = 0.0, 0.0, 1.0
    for k, torque in enumerate(record.torques):
        if k:
            twin.predict(u=record.torques[k - 1].reshape(1, 1))
        twin.update(np.concatenate([record.measurements[one.name][k] for one in sensors]))
        estimator.command(record.times[k], torque)
        estimator.measure_all(record.times[k], record.rows(k))
    belief = estimator.belief
    own = np.concatenate((belief.state.q, belief.state.qd, belief.values))
    assert np.abs(own - twin.x.ravel()).max() < EQUAL
    assert np.abs(belief.covariance - twin.P).max() < EQUAL
