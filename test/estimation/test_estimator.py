# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Estimators as measurements come: order, outliers, loads that are found, bad input."""

import closedloop_dynamics as cld
from closedloop_dynamics.estimation.estimator import Estimator, Noise, SIGMA_POINTS, Start
from closedloop_dynamics.estimation.sensors import (
    encoder_deviation, ImuSensor, JointSensor, PointSensor, WrenchSensor)
from closedloop_dynamics.estimation.unknowns import Bias, JointTorque, Number, Payload, Wrench
import numpy as np
import pytest

from .cases import (
    drawn_start, encoders, held_path, Machine, pendulum, positions_of, spring_chain, steps_of)

DEVIATION = encoder_deviation(14)
DRIVEN = 'theta_1', 'theta_6', 'theta_7'


@pytest.fixture(scope='module')
def model():
    return cld.Model.from_scene('three_rrr')


def follow(estimator, record, torque_noise=0.0, each=lambda k: None):
    """
    Let an estimator take a record as it comes, and call a function after each instant.

    ``torque_noise``: standard deviation of torques as they are given, as a share of the largest.
    """
    sizes, rng = np.abs(record.torques).max(axis=0), np.random.default_rng(4)
    for k, time in enumerate(record.times):
        estimator.command(time, record.torques[k] + torque_noise * sizes * (
            rng.standard_normal(len(sizes))))
        estimator.measure_all(time, record.rows(k))
        each(k)
    return estimator


def test_late_readings_are_taken_in_order(model):
    record, _ = Machine(model, held_path(model)).run(0.1, 0.01, positions_of(DRIVEN, DEVIATION))
    arguments = model, encoders(DRIVEN, DEVIATION), (), Noise(1.0)
    whole, late = follow(Estimator(*arguments), record), Estimator(*arguments)
    for k, time in enumerate(record.times):
        late.command(time, record.torques[k])
        rows = record.rows(k)
        late.measure(time, DRIVEN[0], rows[DRIVEN[0]])
        if k >= 3:
            before = record.rows(k - 3)
            for name in DRIVEN[1:]:
                found = late.measure(record.times[k - 3], name, before[name])
                assert found.late and found.accepted
    for k in range(len(record.times) - 3, len(record.times)):
        late.measure_all(record.times[k], {
            name: record.rows(k)[name] for name in DRIVEN[1:]})
    # One by one they are the same readings; updates of linear readings are in any order.
    assert np.allclose(late.belief.state.q, whole.belief.state.q, atol=1e-9)
    assert np.allclose(late.belief.covariance, whole.belief.covariance, rtol=1e-6, atol=1e-15)
    counts = late.consistency.sensors[DRIVEN[1]]
    assert counts.accepted == len(record.times) and counts.late >= len(record.times) - 3


def test_latency_is_subtracted():
    model = pendulum()
    machine = Machine(model, lambda t, q, qd: [3.0 * np.cos(5.0 * t)])
    record, states = machine.run(0.5, 0.01, positions_of(['pivot'], 1e-4))
    estimator = Estimator(model, encoders(['pivot'], 1e-4, latency=0.05), (), Noise(0.01))
    for k, time in enumerate(record.times):
        estimator.command(time, record.torques[k])
        if k >= 5:
            estimator.measure(time, 'pivot', record.rows(k - 5)['pivot'])
    assert abs(estimator.belief.state.q[0] - states[-1].q[0]) < 5e-4
    refused = estimator.measure(0.1, 'pivot', 0.0)
    assert not refused.accepted and refused.reason == 'too late'
    assert estimator.consistency.sensors['pivot'].refused == 1


def test_outliers_are_gated_and_silence_is_reported(model):
    sensors = encoders(DRIVEN, DEVIATION, rate=100.0)
    estimator = Estimator(model, sensors, (), Noise(1.0))
    record, _ = Machine(model, held_path(model)).run(0.3, 0.01, positions_of(DRIVEN, DEVIATION))
    follow(estimator, record)
    before = estimator.belief
    found = estimator.measure(record.times[-1], 'theta_6', before.state.position['theta_6'] + 0.1)
    assert (found.accepted, found.reason) == (False, 'gated')
    assert np.array_equal(estimator.belief.state.q, before.state.q)
    assert estimator.consistency.sensors['theta_6'].gated == 1
    assert estimator.consistency.silent == ()
    estimator.command(0.3, record.torques[-1])
    later = estimator.advance(0.4)
    assert set(estimator.consistency.silent) == set(DRIVEN)
    assert (np.diag(later.covariance)[:3] > 4.0 * np.diag(before.covariance)[:3]).all()


def test_estimator_goes_on_from_a_belief(model):
    record, _ = Machine(model, held_path(model)).run(0.2, 0.01, positions_of(DRIVEN, DEVIATION))
    unknowns = [Payload('tool', body='platform', deviation=1.0, position=(0.2, 0.1155))]
    arguments = model, encoders(DRIVEN, DEVIATION), unknowns, Noise(0.1)
    first, whole = Estimator(*arguments), Estimator(*arguments)
    for k in range(len(record.times)):
        if k == 10:
            first = Estimator(*arguments, start=first.belief)
        for one in (first, whole):
            one.command(record.times[k], record.torques[k])
            one.measure_all(record.times[k], record.rows(k))
    assert np.array_equal(first.belief.values, whole.belief.values)
    assert np.array_equal(first.belief.covariance, whole.belief.covariance)
    with pytest.raises(ValueError, match='start: expected a belief of nothing, got one of tool'):
        Estimator(model, encoders(DRIVEN, DEVIATION), (), start=whole.belief)


def test_other_independent_coordinates_are_taken_where_needed():
    # A crank that turns once: no other angle decides it where it turns back.
    model = cld.Model.from_scene('four_bar')
    rocker = 'rocker_joint'
    machine = Machine(model, lambda t, q, qd: 0.2 * (8.0 - qd[:1]))
    record, states = machine.run(1.5, 0.005, positions_of(model.joint_names, 1e-4))
    estimator = Estimator(model, encoders(model.joint_names, 1e-4), (), Noise(1.0))
    estimator.filter.plant.take([rocker])
    start = estimator.belief
    estimator = Estimator(model, encoders(model.joint_names, 1e-4), (), Noise(1.0),
                          start._replace(independent=(rocker,)))
    follow(estimator, record)
    assert estimator.belief.independent != (rocker,)
    assert np.abs(estimator.belief.state.q - states[-1].q).max() < 5e-4


def test_payload_is_found_in_half_a_second(model):
    heavy = cld.Model.from_scene(model.scene).with_parameters(
        {'mechanism.bodies.platform.mass': 8.5})
    record, _ = Machine(heavy, held_path(model)).run(0.5, 1e-3, steps_of(DRIVEN, 14))
    unknowns = [Payload('tool', body='platform', deviation=2.0, position=(0.2, 0.1155))]
    estimator = follow(Estimator(
        model, encoders(DRIVEN, DEVIATION), unknowns, Noise(torque=0.01),
        Start(position=0.001, rate=0.01)), record, torque_noise=0.01)
    value, deviation = estimator.estimate().unknowns.of('tool')
    assert abs(value - 0.5) < 0.05 * 0.5
    assert abs(value - 0.5) < 4.0 * deviation < 0.1


def test_three_encoders_of_seven_give_all_forces_within_two_percent(model):
    record, states = Machine(model, held_path(model)).run(0.5, 1e-3, steps_of(DRIVEN, 14))
    estimator = Estimator(model, encoders(DRIVEN, DEVIATION), (), Noise(torque=0.01))
    errors, peaks = [], []

    def compare(k):
        if record.times[k] < 0.2 or k % 10:
            return
        found = estimator.estimate().joint_forces
        truth = model.evaluate(states[k], record.torques[k])
        true = np.concatenate((truth.joint_forces, truth.constraint_forces))[:, 1:]
        errors.append(found.value[:, 1:] - true)
        peaks.append(np.linalg.norm(true, axis=1))

    follow(estimator, record, torque_noise=0.01, each=compare)
    rms = np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=0))
    assert len(rms) == 9 and (rms < 0.02 * np.max(peaks, axis=0)).all()


@pytest.mark.parametrize('joint', ['theta_2', 'theta_3', 'theta_4', 'theta_5'])
def test_wrong_length_is_named_by_three_encoders_of_seven(model, joint):
    keys = {name: f'mechanism.joints.{name}.position.0'
            for name in ('theta_2', 'theta_3', 'theta_4', 'theta_5')}
    length = next(one for one in model.mechanism.joints if one.name == joint).position[0]
    wrong = model.with_parameters({keys[joint]: 1.01 * length})
    record, _ = Machine(wrong, held_path(model)).run(0.75, 5e-3, steps_of(DRIVEN, 14))
    suspects = [
        *(Number(name, key=key, deviation=0.01) for name, key in keys.items()),
        Number('platform_mass', key='mechanism.bodies.platform.mass', deviation=1.0),
        JointTorque('motor', joint='theta_1', deviation=1.0),
        *(Bias(f'offset_{name}', sensor=name, deviation=1.0) for name in DRIVEN)]
    estimator = follow(Estimator(
        model, encoders(DRIVEN, DEVIATION), (), Noise(torque=0.01),
        Start(position=1e-3, rate=0.01), suspects=suspects), record, 0.01)
    first = estimator.alarms[0]
    assert (first.kind, first.name) == ('length', joint)
    # The change is one of first order; the loops bend.
    assert abs(first.value - 0.01 * length) < 0.3 * 0.01 * length


@pytest.mark.parametrize('scene', ['bennett', 'bricard'])
def test_redundant_machines_are_estimated_but_for_forces_that_are_not_unique(scene):
    model = cld.Model.from_scene(scene)
    joint = model.mechanism.joint_names[0]
    estimator = Estimator(model, [JointSensor('encoder', joint=joint, deviation=1e-3)])
    estimator.advance(0.02)
    found = estimator.estimate()
    assert found.joint_forces.names == ()
    assert np.isfinite(found.accelerations.deviation).all()
    now = model.evaluate(found.state)
    np.testing.assert_allclose(found.accelerations.value, now.acceleration, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize('share, alarmed', [(1.0, False), (1.5, True)])
def test_other_masses_raise_an_alarm(model, share, alarmed):
    other = model.with_parameters({'mechanism.bodies.platform.mass': 8.0 * share})
    record, _ = Machine(other, held_path(model)).run(0.5, 2e-3, positions_of(DRIVEN, DEVIATION))
    suspects = [Number('platform_mass', key='mechanism.bodies.platform.mass', deviation=1.0)]
    estimator = follow(Estimator(model, encoders(DRIVEN, DEVIATION), (), Noise(0.1),
                                 suspects=suspects, gate=1.0 - 1e-12), record)
    assert bool(estimator.alarms) == alarmed
    if alarmed:
        assert (estimator.alarms[0].kind, estimator.alarms[0].name) == ('mass', 'platform_mass')


def test_observability_names_what_cannot_be_distinguished(model):
    unknowns = [
        Payload('tool', body='platform', deviation=1.0, position=(0.2, 0.1155)),
        Number('mass', key='mechanism.bodies.platform.mass', deviation=1.0),
        Wrench('load', body='platform', deviation=1.0)]
    estimator = Estimator(model, encoders(DRIVEN, DEVIATION), unknowns, Noise(1.0))
    found = estimator.observability(10.0 * np.random.default_rng(0).normal(size=(10, 3)), 0.3)
    assert set(found.unknown) == {'tool', 'mass'} and not found.unseen
    combination, = found.combinations
    # The payload is at the centre of mass.
    assert set(combination.terms) == {'tool', 'mass'}
    assert np.allclose(list(combination.terms.values()), 1.0, atol=1e-6)
    # At rest on a table a mass has no influence: nothing is learnt without motion.
    flat = cld.Model.from_scene('three_rrr_horizontal')
    found = Estimator(flat, encoders(DRIVEN, DEVIATION), unknowns[:1], Noise(1.0)).observability()
    assert found.unseen == ('tool',)


@pytest.mark.parametrize('scene, names', [
    ('three_rrr', DRIVEN), ('stewart_platform', [f'leg_{k}' for k in range(1, 7)]),
    ('bennett', None)])
def test_true_state_lies_in_its_region(scene, names):
    model = cld.Model.from_scene(scene)
    names = names or model.joint_names[:1]
    runs, inside, total, dimension = 40, 0, 0.0, 0
    rng = np.random.default_rng(11)
    sensors = encoders(names, 1e-3)
    for _ in range(runs):
        state = drawn_start(model, 0.005, 0.05, rng)
        drive = held_path(model, stiffness=300.0 if scene != 'bennett' else 3.0)
        machine = Machine(model, drive, state, rng.integers(1 << 30))
        record, states = machine.run(0.1, 0.01, positions_of(names, 1e-3))
        estimator = follow(Estimator(model, sensors, (), Noise(1e-3), Start(
            position=0.005, rate=0.05), gate=1.0 - 1e-9), record)
        belief = estimator.belief
        estimator.filter.plant.take(belief.independent)
        error = estimator.filter.plant.stepper.minus(
            states[-1].q, states[-1].qd, belief.state.q, belief.state.qd)
        nees = error @ np.linalg.solve(belief.covariance, error)
        dimension = len(error)
        from scipy.stats import chi2
        inside += nees <= chi2.ppf(0.95, dimension)
        total += nees
    # Of 40 draws at 95 %, 32 or fewer are inside once in 5,000 times (binomial).
    assert inside > 32
    # Nor is the region too wide, or too narrow: all together, once in 5,000 times.
    assert chi2.ppf(1e-4, runs * dimension) < total < chi2.isf(1e-4, runs * dimension)


def test_dry_friction_needs_sigma_points_and_is_found():
    model = cld.Model.from_scene('three_rrr_payload_friction')
    with pytest.raises(cld.SimulationError, match='gear_1 .joint_friction: dry friction jumps'):
        Estimator(model, encoders(DRIVEN, 1e-4))
    other = model.with_parameters({'effects.gear_1.coulomb': 6.0})
    record, _ = Machine(other, held_path(model, 0.2)).run(0.6, 5e-3, positions_of(DRIVEN, 1e-4))
    unknowns = [Number('friction', key='effects.gear_1.coulomb', deviation=1.5)]
    estimator = follow(Estimator(
        model, encoders(DRIVEN, 1e-4), unknowns, Noise(0.05), Start(position=0.001, rate=0.01),
        method=SIGMA_POINTS, gate=1.0 - 1e-9), record)
    value, deviation = estimator.belief.unknowns.of('friction')
    assert abs(value - 6.0) < 0.5
    estimate = estimator.estimate()
    assert np.isfinite(estimate.joint_forces.deviation).all()
    assert estimate.points.names == tuple(one.name for one in model.mechanism.points)


def test_friction_that_has_changed_is_named():
    model = cld.Model.from_scene('three_rrr_payload_friction')
    other = model.with_parameters({'effects.gear_1.coulomb': 6.0})
    suspects = [
        Number('mass', key='mechanism.bodies.platform.mass', deviation=0.1),
        Number('friction', key='effects.gear_1.coulomb', deviation=0.1),
        JointTorque('motor', joint='theta_6', deviation=0.1)]
    for moved, alarmed in (model, False), (other, True):
        record, _ = Machine(moved, held_path(model, 0.2)).run(
            0.3, 5e-3, positions_of(DRIVEN, 1e-4))
        estimator = follow(Estimator(
            model, encoders(DRIVEN, 1e-4), (), Noise(acceleration=0.05, torque=0.05),
            Start(position=0.001, rate=0.01), method=SIGMA_POINTS, suspects=suspects,
            gate=1.0 - 1e-12), record)
        assert bool(estimator.alarms) == alarmed
        if alarmed:
            first = estimator.alarms[0]
            assert (first.kind, first.name) == ('friction', 'friction')
            assert abs(first.value - 2.0) < 4.0 * first.deviation


def test_points_of_sigma_equal_derivatives_where_nothing_jumps(model):
    record, _ = Machine(model, held_path(model)).run(0.05, 0.01, positions_of(DRIVEN, 1e-4))
    arguments = model, encoders(DRIVEN, 1e-4), (), Noise(0.1), Start(position=1e-4, rate=1e-3)
    one, other = (follow(Estimator(*arguments, method=method), record)
                  for method in ('extended', SIGMA_POINTS))
    # They differ by what the motion bends over a deviation of 1e-4.
    assert np.allclose(one.belief.state.q, other.belief.state.q, atol=1e-7)
    assert np.allclose(one.belief.covariance, other.belief.covariance, rtol=1e-3, atol=1e-12)
    for part in ('positions', 'accelerations', 'joint_forces', 'points'):
        first, second = (getattr(each.estimate(), part) for each in (one, other))
        assert first.names == second.names
        assert np.allclose(first.deviation, second.deviation, rtol=2e-2, atol=1e-9), part


def test_instruments_and_suspects_with_points_of_sigma_equal_derivatives(model):
    imu = ImuSensor('imu', body='platform', gyroscope=1e-2, accelerometer=0.1, mounting=0.3)
    force = WrenchSensor('force', joint='theta_4', deviation=1.0, moment=0.1, axes='body')
    suspects = [Number('mass', key='mechanism.bodies.platform.mass', deviation=1e-3),
                Bias('offset', sensor='imu', component='x', deviation=1e-3)]
    record, _ = Machine(model, held_path(model)).run(0.05, 0.01, positions_of(DRIVEN, 1e-4))
    arguments = (model, [*encoders(DRIVEN, 1e-4), imu, force], (), Noise(torque=0.1),
                 Start(position=1e-4, rate=1e-3))
    found = []
    for method in ('extended', SIGMA_POINTS):
        estimator = Estimator(*arguments, method, suspects=suspects, gate=1.0 - 1e-15)
        follow(estimator, record)
        readings = {'imu': [0.0, 0.1, 9.0], 'force': [0.1, 2.0, 30.0]}
        reported = estimator.filter.updated(estimator.belief_at_work, {
            name: np.array(values) for name, values in readings.items()})
        found.append((estimator.belief_at_work, *reported))
    one, other = found
    np.testing.assert_allclose(one[0].signature, other[0].signature, rtol=1e-3, atol=1e-7)
    for first, second in zip(one[2], other[2]):
        np.testing.assert_allclose(first.value, second.value, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-2, atol=1e-4)


BAD = {
    'another joint': (lambda model: Estimator(model, [JointSensor(
        'e', joint='elbow', deviation=1.0)]), 'sensors.e.joint: expected a freedom among'),
    'no such body': (lambda model: Estimator(model, [], [Payload(
        'tool', body='platfrom', deviation=1.0)]), 'platfrom'),
    'no such point': (lambda model: Estimator(model, [PointSensor(
        'camera', point='nowhere', deviation=1.0)]), 'sensors.camera.point: expected a point'),
    'negative deviation': (lambda model: JointSensor('e', joint='theta_1', deviation=-1.0),
                           'deviation: expected a positive number'),
    'too long a latency': (lambda model: JointSensor(
        'e', joint='theta_1', deviation=1.0, latency=0.3), 'latency: expected at most 0.2 s'),
    'sensor twice': (lambda model: Estimator(model, 2 * encoders(['theta_1'], 1.0)), 'twice'),
    'bias of no sensor': (lambda model: Estimator(model, [], [Bias(
        'b', sensor='e', deviation=1.0)]), 'unknowns.b.sensor: expected a sensor among'),
    'number twice': (lambda model: Estimator(model, [], 2 * [Number(
        'm', key='mechanism.bodies.platform.mass', deviation=1.0)]), 'twice'),
    'no such number': (lambda model: Estimator(model, [], [Number(
        'm', key='mechanism.bodies.platform.weight', deviation=1.0)]), 'weight'),
}


@pytest.mark.parametrize('case', BAD)
def test_bad_descriptions_are_refused_by_name(model, case):
    make, words = BAD[case]
    with pytest.raises(ValueError, match=words):
        make(model)


def test_bad_measurements_are_refused(model):
    estimator = Estimator(model, encoders(DRIVEN, DEVIATION), (), Noise(1.0))
    with pytest.raises(ValueError, match='expected one of theta_1, theta_6, theta_7'):
        estimator.measure(0.0, 'theta_2', 1.0)
    with pytest.raises(ValueError, match='theta_1: expected finite numbers'):
        estimator.measure(0.0, 'theta_1', np.nan)
    with pytest.raises(ValueError, match='expected a finite time'):
        estimator.measure(np.nan, 'theta_1', 1.0)
    with pytest.raises(ValueError, match='command: expected some of theta_1'):
        estimator.command(0.0, {'theta_2': 1.0})
    with pytest.raises(ValueError, match='command: expected 3 finite numbers'):
        estimator.command(0.0, [1.0, np.inf, 0.0])
    assert not estimator.measure(-1.0, 'theta_1', 1.0).accepted
    assert estimator.consistency.sensors['theta_1'].refused == 2


def test_springs_are_no_reason_to_refuse():
    estimator = Estimator(spring_chain(), encoders(['slide_0'], 1e-3), [Number(
        'k', key='effects.spring_1.stiffness', deviation=5.0)], Noise(0.1))
    assert estimator.observability([[1.0], [-1.0]], 1.0).deviations['k'] < np.inf
