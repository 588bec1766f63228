# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What sensors are expected to read is what a simulation has, and its derivatives are right."""

import closedloop_dynamics as cld
from closedloop_dynamics.estimation.estimator import Estimator, Noise, SIGMA_POINTS
from closedloop_dynamics.estimation.sensors import (
    ForceSensor, ImuSensor, JointSensor, PointSensor, PoseSensor, WrenchSensor)
from closedloop_dynamics.estimation.unknowns import (
    Bias, GravityDirection, JointTorque, Number, Payload, Scale, Wrench)
from closedloop_dynamics.mechanism.rotations import of_quaternion
import numpy as np
import pytest

# Central differences of fourth order: rounding and truncation are some 1e-9 of the values.
STEP, SLOPE = 1e-3, 2e-7
# Numbers that are computed in two ways.
SAME = 1e-9
CENTRAL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}


def planar_case():
    """Return an estimator of a 3-RRR with all sensors and unknowns."""
    model = cld.Model.from_scene('three_rrr')
    sensors = [
        JointSensor('angle', joint='theta_2', deviation=1.0),
        JointSensor('rate', joint='theta_3', deviation=1.0, quantity='rate'),
        JointSensor('torque', joint='theta_1', deviation=1.0, quantity='torque'),
        JointSensor('cut', joint='cut_1', deviation=1.0),
        JointSensor('cut_rate', joint='cut_2', deviation=1.0, quantity='rate'),
        ImuSensor('imu', body='platform', gyroscope=1.0, accelerometer=1.0, position=(0.1, 0.2),
                  mounting=0.7),
        PointSensor('camera', point='corner_2', deviation=1.0),
        PoseSensor('tracker', body='distal_2', deviation=1.0, angle=1.0),
        ForceSensor('force', joint='theta_3', deviation=1.0, axes='body'),
        WrenchSensor('wrench', joint='cut_1', deviation=1.0, moment=1.0)]
    unknowns = [
        Wrench('load', body='platform', deviation=1.0, torque=1.0),
        JointTorque('motor', joint='theta_1', deviation=1.0),
        Payload('tool', body='platform', deviation=1.0, position=(0.2, 0.1)),
        Number('length', key='mechanism.joints.theta_2.position.0', deviation=0.01),
        GravityDirection('tilt', deviation=0.1),
        Bias('offset', sensor='imu', component='spin', deviation=1.0),
        Scale('gain', sensor='camera', component='y', deviation=1.0)]
    return model, sensors, unknowns


def spatial_case():
    """Return the same of a Stewart platform."""
    model = cld.Model.from_scene('stewart_platform')
    mechanism = model.mechanism
    point, cut = mechanism.points[0].name, mechanism.cut_joints[0].name
    body = mechanism.joints[-1].child
    sensors = [
        JointSensor('length', joint='leg_2', deviation=1.0),
        JointSensor('rate', joint='leg_3', deviation=1.0, quantity='rate'),
        ImuSensor('imu', body=body, gyroscope=1.0, accelerometer=1.0, position=(0.1, 0.2, 0.0),
                  mounting={'rpy': (0.3, -0.2, 0.5)}),
        PointSensor('camera', point=point, deviation=1.0),
        PoseSensor('tracker', body=body, deviation=1.0, angle=1.0),
        ForceSensor('force', joint='leg_1', deviation=1.0, axes='body'),
        WrenchSensor('wrench', joint=cut, deviation=1.0, moment=1.0)]
    unknowns = [
        Wrench('load', body=body, deviation=1.0, torque=1.0, directions='xyz'),
        Payload('tool', body=body, deviation=1.0, position=(0.1, 0.0, 0.1)),
        GravityDirection('tilt', deviation=0.1, planar=False)]
    return model, sensors, unknowns


def redundant_case():
    """Return those of Bennett's linkage whose readings do not need forces that are not unique."""
    model = cld.Model.from_scene('bennett')
    joint, body = model.mechanism.joint_names[0], model.mechanism.joints[-1].child
    sensors = [
        JointSensor('angle', joint=joint, deviation=1.0),
        ImuSensor('imu', body=body, gyroscope=1.0, accelerometer=1.0, position=(0.1, 0.2, 0.0)),
        PoseSensor('tracker', body=body, deviation=1.0, angle=1.0)]
    return model, sensors, [JointTorque('motor', joint=joint, deviation=1.0)]


def moving(model, sensors, unknowns):
    """Return an estimator in a state that moves, with numbers that are not zero."""
    estimator = Estimator(model, sensors, unknowns, Noise(1.0))
    rng = np.random.default_rng(3)
    estimator.command(0.0, 5.0 * rng.normal(size=len(estimator.commanded)))
    now = estimator.belief_at_work
    change = 0.05 * rng.normal(size=len(now.covariance))
    change[len(now.independent):2 * len(now.independent)] *= 10.0
    lengths = [k for k, name in enumerate(estimator.belief.names) if name == 'length']
    change[[2 * len(now.independent) + k for k in lengths]] = 0.004
    return estimator, estimator.filter.moved(now, change)


@pytest.mark.parametrize('case', [planar_case, spatial_case, redundant_case])
def test_slopes_equal_differences(case):
    estimator, now = moving(*case())
    filter_, names = estimator.filter, list(estimator.readable)
    measuring = filter_.measuring

    def values(state):
        filter_.plant.put(state.values[:filter_.columns.count])
        return filter_.read(state, names)

    slope, _ = filter_.slopes(now, names)
    middle = [one.value for one in values(now)]
    for column, unit in enumerate(np.eye(len(now.covariance))):
        found = sum(weight / STEP * np.concatenate([
            measuring.residual(name, one.value, value) for name, one, value in zip(
                names, values(filter_.moved(now, step * STEP * unit)), middle)])
            for step, weight in CENTRAL.items())
        size = max(1.0, np.abs(slope[:, column]).max())
        assert np.abs(found - slope[:, column]).max() < SLOPE * size


@pytest.mark.parametrize('case', [planar_case, spatial_case])
def test_readings_equal_those_of_a_simulation(case):
    model, sensors, _ = case()
    estimator, now = moving(model, sensors, ())
    found = dict(zip(estimator.readable, (
        one.value for one in estimator.filter.read(now, list(estimator.readable)))))
    simulation = cld.Simulation(model, model.state(now.q, now.qd))
    torque = dict(zip(model.actuated_joints, now.command))
    by_name = {sensor.name: sensor for sensor in sensors}
    planar, index = model.mechanism.planar, model.coordinates.index
    evaluation = model.evaluate(model.state(now.q, now.qd), torque)
    poses = evaluation.body_poses[by_name['tracker'].body]
    assert np.allclose(found['camera'], evaluation.points[by_name['camera'].point], atol=SAME)
    assert np.abs(estimator.filter.measuring.residual(
        'tracker', np.asarray(poses), found['tracker'])).max() < SAME
    assert found['rate'] == now.qd[index[by_name['rate'].joint]]
    wrench = by_name['wrench'].joint
    assert np.allclose(found['wrench'], evaluation.constraint_forces[wrench], atol=1e-7)
    joint = by_name['force'].joint
    names = [one.name for one in model.mechanism.joints]
    whole = np.asarray(evaluation.joint_forces)[names.index(joint)]
    half = whole[1:] if planar else whole[3:]
    assert abs(np.linalg.norm(found['force']) - np.linalg.norm(half)) < 1e-7
    if planar:
        assert np.allclose(found['cut'], simulation.cut_position[0], atol=SAME)
        assert np.allclose(found['cut_rate'], simulation.cut_velocity[1], atol=SAME)
        assert np.allclose(found['torque'], now.command[0], atol=SAME)


@pytest.mark.parametrize('case', [planar_case, spatial_case])
def test_unit_measures_spin_and_specific_force(case):
    model, sensors, _ = case()
    estimator, now = moving(model, sensors, ())
    value = estimator.filter.read(now, ['imu'])[0].value
    imu = next(one for one in sensors if one.name == 'imu')
    step, torque = 1e-4, dict(zip(model.actuated_joints, now.command))

    def pose(time):
        simulation = cld.Simulation(model, model.state(now.q, now.qd),
                                    {'integrator': 'rk4', 'step_size': 1e-5})
        if time > 0.0:
            simulation.step(torque, time)
        names = [body.name for body in model.mechanism.bodies]
        found = simulation.body_poses[names.index(imu.body)]
        if model.mechanism.planar:
            c, s = np.cos(found[2]), np.sin(found[2])
            axes = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
            origin, place = np.append(found[:2], 0.0), np.append(imu.position, 0.0)
        else:
            axes, origin, place = of_quaternion(found[3:]), found[:3], np.array(imu.position)
        return axes, origin + axes @ place

    # Forward, as the simulation does not run backwards: of third order.
    weights = np.array((35 / 12, -26 / 3, 19 / 2, -14 / 3, 11 / 12)) / step ** 2
    frames, places = zip(*(pose(k * step) for k in range(5)))
    gravity = np.array([0.0, -9.81, 0.0] if model.mechanism.planar else [0.0, 0.0, -9.81])
    force = frames[0].T @ (weights @ np.array(places) - gravity)
    if model.mechanism.planar:
        c, s = np.cos(imu.mounting), np.sin(imu.mounting)
        mounting = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        assert np.allclose(value[1:], (mounting.T @ force)[:2], atol=1e-3)
        return
    mounting = of_quaternion(imu.mounting)
    assert np.allclose(value[3:], mounting.T @ force, atol=1e-3)
    slopes = np.array((-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4)) / step
    turned = frames[0].T @ np.einsum('k,kij->ij', slopes, np.array(frames))
    spin = np.array((turned[2, 1], turned[0, 2], turned[1, 0]))
    assert np.allclose(value[:3], mounting.T @ spin, atol=1e-6)


@pytest.mark.parametrize('case', [planar_case, spatial_case])
def test_readings_without_derivatives_are_the_same(case):
    model, sensors, unknowns = case()
    # Lengths are known where there are no derivatives.
    unknowns = [one for one in unknowns if one.name != 'length']
    names, found = [one.name for one in sensors], []
    for method in ('extended', SIGMA_POINTS):
        estimator = Estimator(model, sensors, unknowns, Noise(1.0), method=method)
        now = estimator.belief_at_work
        values = 0.05 + 0.1 * np.arange(len(now.values))
        moved = estimator.filter.moved(now, np.concatenate((
            np.full(estimator.filter.plant.size, 0.02), values)))
        moved = moved._replace(command=3.0 + np.arange(len(estimator.commanded)))
        read = estimator.filter.felt_readings if method == SIGMA_POINTS else estimator.filter.read
        found.append(np.concatenate([one.value for one in read(moved, names)]))
    np.testing.assert_allclose(*found, rtol=SAME, atol=SAME)
