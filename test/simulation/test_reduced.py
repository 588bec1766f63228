# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanics in independent coordinates: by the whole tree, by differences, by what results."""

import closedloop_dynamics as cld
from closedloop_dynamics.mechanism.kinematics import body_poses, motion_of, poses_in_space
from closedloop_dynamics.mechanism.rotations import composed, CONJUGATE, rotated, rotation_vector
import numpy as np
import pytest

# Driven by as many joints as there are degrees of freedom: in the plane, and in space.
SCENES = 'four_bar', 'three_rrr', 'delta_robot', 'stewart_platform', 'humanoid_ankle'
HELIX = {
    'name': 'screw_and_ball',
    'bodies': {name: {'mass': 1.0, 'center_of_mass': [0.1, 0.2, 0.3],
                      'inertia': [0.1, 0.2, 0.15, 0.01, 0.02, 0.03]}
               for name in ('nut', 'arm', 'hand', 'tip')},
    'joints': {
        'screw': {'type': 'helical', 'parent': 'ground', 'child': 'nut',
                  'position': [0.1, 0.0, 0.0], 'axis': [0.0, 0.6, 0.8], 'lead': 0.2},
        'cross': {'type': 'universal', 'parent': 'nut', 'child': 'arm',
                  'position': [0.3, 0.1, 0.0], 'axis': [1.0, 0.0, 0.0],
                  'second_axis': [0.0, 1.0, 0.0]},
        'guide': {'type': 'cylindrical', 'parent': 'arm', 'child': 'hand',
                  'position': [0.0, 0.4, 0.0], 'axis': [0.0, 0.0, 1.0]},
        'ball': {'type': 'spherical', 'parent': 'hand', 'child': 'tip',
                 'position': [0.2, 0.0, 0.1]}}}


@pytest.fixture(scope='module', params=SCENES)
def case(request):
    """Return a model, a state that moves, its mechanics and a generator of numbers."""
    model, rng = cld.Model.from_scene(request.param), np.random.default_rng(4)
    start = model.assemble()
    stepper = model.stepper(1e-3, jacobians=False)
    q, qd = stepper.plus(start.q, start.qd, 0.05 * rng.normal(size=2 * len(stepper.independent)))
    state = model.state(q, qd)
    return model, state, model.reduce(state, stepper.independent), rng, stepper


def rates(case):
    model, state, one, _, _ = case
    return state.qd[[model.joint_names.index(name) for name in one.independent]]


def test_motion_of_bodies_equals_differences():
    model = cld.Model.from_scene('double_wishbone')
    machines = [model.mechanism, cld.Model.from_scene('rack_press').mechanism,
                cld.read_mechanism(HELIX)]
    place, size = np.array([0.3, -0.2, 0.4]), 1e-3
    for mechanism in machines:
        rng, names = np.random.default_rng(2), mechanism.coordinates
        arm = place * [1.0, 1.0, not mechanism.planar]
        q, qd = names.moved(names.start(), 0.4 * rng.normal(size=names.nv)), rng.normal(
            size=names.nv)

        def at(q, body, mechanism=mechanism, arm=arm):
            pose = poses_in_space(body_poses(mechanism, q, (body,))[0])
            return pose[:3] + rotated(pose[3:], arm), pose[3:]

        for body in mechanism.bodies:
            jacobian, bias = motion_of(mechanism, q, qd, body.name, arm)
            # Differences of fourth order.
            found, change = np.zeros(6), np.zeros(6)
            for count, weight in ((1, 2.0 / 3.0), (2, -1.0 / 12.0)):
                after, before = (names.moved(q, sign * count * size * qd) for sign in (1, -1))
                (one, turn), (other, back) = at(after, body.name), at(before, body.name)
                found += weight / size * np.concatenate([
                    one - other, rotation_vector(composed(turn, back * CONJUGATE))])
                change += weight / size * (
                    motion_of(mechanism, after, qd, body.name, arm)[0]
                    - motion_of(mechanism, before, qd, body.name, arm)[0]) @ qd
            np.testing.assert_allclose(jacobian @ qd, found, rtol=0, atol=1e-8)
            np.testing.assert_allclose(bias, change, rtol=0, atol=1e-8)


def test_inertia_and_basis_are_those_of_the_tree(case):
    model, state, one, _, _ = case
    jac = model.constraint_jacobian(state)
    assert np.abs(jac @ one.basis).max() < 1e-9 * np.abs(jac).max()
    own = [model.joint_names.index(name) for name in one.independent]
    np.testing.assert_array_equal(one.basis[own], np.eye(len(own)))
    np.testing.assert_allclose(one.basis @ rates(case), state.qd, rtol=0, atol=1e-10)
    inertia = one.basis.T @ model.inertia(state) @ one.basis
    np.testing.assert_allclose(one.inertia, inertia, rtol=0, atol=1e-9 * np.abs(inertia).max())
    u = rates(case)
    assert 0.5 * u @ one.inertia @ u == pytest.approx(model.evaluate(state).kinetic_energy)


def test_torques_of_accelerations_have_them(case):
    model, state, one, rng, _ = case
    own = [model.joint_names.index(name) for name in one.independent]
    driven = [model.joint_names.index(name) for name in model.actuated_joints]
    wanted = rng.normal(size=len(own))
    torque = one.inverse(wanted)
    found = model.evaluate(state, torque).acceleration
    np.testing.assert_allclose(found[own], wanted, rtol=0, atol=1e-8)
    np.testing.assert_allclose(one.accelerations(wanted), found, rtol=0, atol=1e-8)
    # The same torques from the accelerations of the drives, and of all joints.
    np.testing.assert_allclose(one.inverse(found[driven], of='actuated'), torque, rtol=0,
                               atol=1e-8 * np.abs(torque).max())
    np.testing.assert_allclose(model.inverse(state, found).torque, torque, rtol=0,
                               atol=1e-8 * np.abs(torque).max())


def test_jacobians_and_accelerations_of_tasks_equal_differences(case):
    model, state, one, rng, stepper = case
    tasks = [*(point.name for point in model.mechanism.points), model.mechanism.bodies[-1].name]
    wanted, size = rng.normal(size=len(one.independent)), 1e-4
    u, n = rates(case), len(one.independent)

    def task_rate(time, task):
        """Return a task's rate where the independent coordinates accelerate as wanted."""
        moved = model.state(*stepper.plus(state.q, state.qd, np.concatenate((
            time * u + 0.5 * time ** 2 * wanted, time * wanted))))
        return model.reduce(moved, one.independent).jacobian(task) @ (u + time * wanted)

    for task in tasks:
        jac = one.jacobian(task)
        if task in model.evaluate(state).points:
            ends = [model.evaluate(model.state(*stepper.plus(
                state.q, state.qd, sign * size * np.eye(2 * n)[:n]))).points[task]
                for sign in (1.0, -1.0)]
            np.testing.assert_allclose(
                jac, (np.asarray(ends[0]) - np.asarray(ends[1])).T / (2.0 * size), rtol=0,
                atol=1e-6)
        change = (task_rate(size, task) - task_rate(-size, task)) / (2.0 * size)
        _, drift = one.motion(task)
        np.testing.assert_allclose(jac @ wanted + drift, change, rtol=0,
                                   atol=1e-6 * max(1.0, np.abs(change).max()))


def test_forces_of_a_task_accelerate_it(case):
    model, state, one, rng, _ = case
    own = [model.joint_names.index(name) for name in one.independent]
    for task in (point.name for point in model.mechanism.points):
        jac, drift = one.motion(task)
        if np.linalg.matrix_rank(jac, 1e-6) < len(jac):
            with pytest.raises(cld.SingularityError, match='cannot move in all its directions'):
                one.operational_space(task)
            continue
        inertia, bias = one.operational_space(task)
        wanted = rng.normal(size=len(jac))
        force = inertia @ wanted + bias
        torque = one.torque_of(task, force)
        found = model.evaluate(state, torque).acceleration[own]
        np.testing.assert_allclose(jac @ found + drift, wanted, rtol=0, atol=1e-7)
        # Virtual work.
        driven = one.drives @ rates(case)
        assert torque @ driven == pytest.approx(force @ (jac @ rates(case)), rel=1e-8, abs=1e-10)
        by_drives = one.jacobian(task, by='actuated')
        np.testing.assert_allclose(by_drives @ driven, jac @ rates(case), rtol=0, atol=1e-9)
        assert one.condition(task) == pytest.approx(np.linalg.cond(by_drives))


def test_gravity_is_compensated(case):
    model, state, one, _, _ = case
    rest = model.state(state.q)
    found = model.evaluate(rest, one.gravity_compensation()).acceleration
    assert np.abs(found).max() < 1e-8


def test_a_computed_torque_makes_errors_decay(case):
    model, state, one, _, stepper = case
    n = len(one.independent)
    change = np.concatenate((np.full(n, 0.01), np.full(n, -0.02)))
    wanted = model.state(*stepper.plus(state.q, state.qd, change))
    own = [model.joint_names.index(name) for name in one.independent]
    torque = one.computed_torque(wanted, 100.0, 20.0 * np.eye(n), np.full(n, 0.3))
    np.testing.assert_allclose(
        model.evaluate(state, torque).acceleration[own], 0.3 + 1.0 - 0.4, rtol=0, atol=1e-8)
    batch = cld.State.stack([state, state])
    for given in (batch, cld.Model.from_scene('slider_crank').assemble()):
        with pytest.raises(ValueError, match='wanted: expected one state'):
            one.computed_torque(given, 1.0, 1.0)
    with pytest.raises(ValueError, match='damping: expected one number'):
        one.computed_torque(wanted, 1.0, np.ones(n + 1))


def test_derivatives_of_torques_equal_differences(case):
    model, state, one, rng, stepper = case
    n = len(one.independent)
    wanted, size = rng.normal(size=n), 1e-5
    found = one.inverse_derivatives(wanted)
    np.testing.assert_allclose(found.torque, one.inverse(wanted), rtol=0, atol=1e-12)

    def torque(change):
        moved = model.state(*stepper.plus(state.q, state.qd, change[:2 * n]))
        return model.reduce(moved, one.independent).inverse(wanted + change[2 * n:])

    slopes = np.array([(torque(size * unit) - torque(-size * unit)) / (2.0 * size)
                       for unit in np.eye(3 * n)]).T
    whole = np.hstack((found.by_position, found.by_velocity, found.by_acceleration))
    np.testing.assert_allclose(whole, slopes, rtol=0, atol=1e-6 * np.abs(slopes).max())


def test_the_drives_feel_the_kinetic_energy(case):
    model, state, one, _, _ = case
    driven = one.drives @ rates(case)
    assert 0.5 * driven @ one.reflected_inertia @ driven == pytest.approx(
        model.evaluate(state).kinetic_energy)


def test_modes_are_those_of_the_linearisation():
    model = cld.Model.from_scene('carpet_scraper')
    state = model.assemble()
    expected = cld.Linearisation(cld.Simulation(model, state)).modes()
    found = model.reduce(model.state(state.q)).modes()
    assert [mode.frequency for mode in found] == pytest.approx(
        [mode.frequency for mode in expected])


def test_feedforward_of_a_trajectory_follows_it():
    model = cld.Model.from_scene('three_rrr')
    start, time = model.assemble(), np.linspace(0.0, 0.5, 251)
    course = 0.1 * (1.0 - np.cos(2.0 * np.pi * time / 0.5))
    drives = {name: start.position[name] + share * course
              for name, share in zip(model.actuated_joints, (1.0, -0.5, 0.7))}
    states, torque = cld.feedforward(model, drives, time, start)
    assert states.time.tolist() == time.tolist() and torque.shape == (251, 3)
    # Each torque held for a step: the run ends where the trajectory does, to the square of it.
    half = 0.5 * (torque[1:] + torque[:-1])
    run = cld.rollout(model, states[0], half[np.newaxis], steps=250, every=250,
                      method={'integrator': 'rk4', 'step_size': 0.002})
    np.testing.assert_allclose(run.position[0, -1], states.q[-1], rtol=0, atol=2e-4)
    with pytest.raises(ValueError, match='time: expected finite numbers that rise'):
        cld.feedforward(model, drives, time[::-1])
    with pytest.raises(ValueError, match='drives: theta_1: expected as many numbers'):
        cld.feedforward(model, drives, time[:7])


def test_what_cannot_be_is_refused():
    model = cld.Model.from_scene('three_rrr')
    state = model.assemble()
    one = model.reduce(state)
    point = model.mechanism.points[0].name
    with pytest.raises(ValueError, match='task: expected actuated, or one of the points'):
        one.jacobian('nothing')
    with pytest.raises(ValueError, match="by: expected 'independent' or 'actuated'"):
        one.jacobian(point, 'all')
    with pytest.raises(ValueError, match='acceleration: expected 3 finite numbers'):
        one.inverse([1.0, np.nan, 0.0])
    with pytest.raises(cld.SingularityError, match='does not determine the motion'):
        one.inverse([0.1, 0.2], of=point)
    with pytest.raises(ValueError, match='wrench: expected shape'):
        one.torque_of(point, [1.0])
    with pytest.raises(ValueError, match='expected one state, got a batch'):
        model.reduce(cld.State.stack([state, state]))
    # The same torques of the same motion by other coordinates.
    passive = model.reduce(state, ['theta_2', 'theta_3', 'theta_4'])
    whole = one.accelerations([0.1, 0.2, 0.3])
    own = [model.joint_names.index(name) for name in passive.independent]
    np.testing.assert_allclose(
        passive.inverse(whole[own]), one.inverse([0.1, 0.2, 0.3]), rtol=0, atol=1e-8)
    # Its rod turns about itself as it likes.
    free = cld.Model.from_scene('rssr_four_bar')
    with pytest.raises(cld.SimulationError, match='cannot produce'):
        free.reduce(free.assemble()).inverse([1.0, 5.0])
