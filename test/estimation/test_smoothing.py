# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Whole records of machines that bend: smoother, fit and filter beside one another."""

import closedloop_dynamics as cld
from closedloop_dynamics.estimation.estimator import Noise, Start
from closedloop_dynamics.estimation.results import Record
from closedloop_dynamics.estimation.smoothing import fit, smooth
from closedloop_dynamics.estimation.unknowns import Payload
import numpy as np
import pytest

from .cases import encoders, held_path, Machine, positions_of

DRIVEN, DEVIATION = ('theta_1', 'theta_6', 'theta_7'), 1e-4


@pytest.fixture(scope='module')
def case():
    model = cld.Model.from_scene('three_rrr')
    record, states = Machine(model, held_path(model)).run(
        0.24, 4e-3, positions_of(DRIVEN, DEVIATION))
    return record, states, (
        model, encoders(DRIVEN, DEVIATION), record,
        [Payload('tool', body='platform', deviation=1.0, position=(0.2, 0.1155))], Noise(0.05),
        Start(position=0.002, rate=0.02))


def test_fit_and_smoother_agree(case):
    _, _, arguments = case
    smoothed, fitted = smooth(*arguments), fit(*arguments)
    assert 0 < fitted.iterations < 10 and not smoothed.iterations
    # They differ by what the filter's Jacobians, away from the likeliest motion, miss.
    for one, other in zip(smoothed.beliefs, fitted.beliefs):
        assert np.abs(one.state.q - other.state.q).max() < 1e-6
    one, other = (each.beliefs[0].unknowns for each in (smoothed, fitted))
    assert abs(one.value[0] - other.value[0]) < 0.01 * one.deviation[0]


def test_smoother_is_nearer_to_the_truth_and_knows_it(case):
    _, states, arguments = case
    found = smooth(*arguments)
    true = np.array([state.q for state in states])
    errors = [np.sqrt(np.mean(np.square(np.array([one.state.q for one in beliefs]) - true)))
              for beliefs in (found.beliefs, found.filtered)]
    assert errors[0] < 0.7 * errors[1]
    for one, other in zip(found.beliefs[:-1], found.filtered):
        assert np.trace(one.covariance[:3, :3]) < np.trace(other.covariance[:3, :3])
    assert np.array_equal(found.beliefs[-1].covariance, found.filtered[-1].covariance)
    assert found.consistency.consistent and not found.alarms
    middle = found.estimate(30)
    assert middle.time == found.beliefs[30].time
    assert np.abs((middle.positions.value - states[30].q) / middle.positions.deviation).max() < 5.0


def test_progress_is_reported(case):
    _, _, arguments = case
    reported = []
    smooth(*arguments, progress=reported.append)
    assert reported[-1] == 1.0 and sorted(reported) == reported


def test_readings_that_are_missing_are_passed_over(case):
    record, states, arguments = case
    measured = {name: values.copy() for name, values in record.measurements.items()}
    measured['theta_1'][10:30] = np.nan
    gappy = Record(record.times, record.torques, measured)
    found = smooth(arguments[0], arguments[1], gappy, *arguments[3:])
    assert found.consistency.sensors['theta_1'].accepted == len(record.times) - 20
    assert np.abs(found.beliefs[20].state.q - states[20].q).max() < 2e-3


def test_bad_records_are_refused(case):
    record, _, arguments = case
    model, sensors, _, *rest = arguments
    with pytest.raises(ValueError, match='times: expected growing ones, got 0 s after 1 s'):
        Record([0.0, 1.0, 0.0], [], {})
    with pytest.raises(ValueError, match='measurements: a: expected 2 rows'):
        Record([0.0, 1.0], [], {'a': [1.0]})
    with pytest.raises(ValueError, match='expected some of theta_1, theta_6, theta_7, got .elbow'):
        smooth(model, sensors, Record(record.times, record.torques, {
            'elbow': record.measurements['theta_1']}), *rest)
    with pytest.raises(ValueError, match='torques: expected 3 columns'):
        smooth(model, sensors, Record(record.times, record.torques[:, :2], {}), *rest)
    with pytest.raises(ValueError, match='expected the first one at the start'):
        smooth(model, sensors, Record(record.times + 1.0, record.torques, {}), *rest)
    late = encoders(DRIVEN, DEVIATION, latency=0.01)
    with pytest.raises(ValueError, match='theta_1: expected .*without latency'):
        smooth(model, late, record, *rest)
