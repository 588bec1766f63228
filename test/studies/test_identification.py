# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters come out of motions that were made with them, and nothing comes out of nothing."""

from dataclasses import replace

from closedloop_dynamics import identify, load_scene, Simulation
from closedloop_dynamics.effects.registry import (
    JointDamping, JointFriction, PrescribedForce, TendonFriction)
from closedloop_dynamics.kinematics.motions import moving
from closedloop_dynamics.kinematics.passive_joint_solver import PassiveJointError
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
from closedloop_dynamics.studies.excitation import excite
from closedloop_dynamics.studies.identification import (
    IdentificationError, Identifier, measured_joints)
from closedloop_dynamics.studies.inertial_parameters import BodyParameters, pseudo_inertia
import numpy as np
import pytest

COUPLER = 'mechanism.bodies.coupler'


def other(scene, values):
    """Return a scene of other numbers."""
    return changed(scene, {resolve(scene, key): value for key, value in values.items()})


def run(scene, torque, count=60, seed=0):
    """Return motion and efforts of the driven joints under torques at random, and all states."""
    simulation = Simulation.from_scene(scene, accuracy=1e-9)
    random, names = np.random.default_rng(seed), simulation.actuated_joints
    rates = [simulation.joint_names.index(name) for name in names]
    places = simulation.coordinates.place[rates]
    rows, efforts, states = [], [], []
    for _ in range(count):
        simulation.step(torque * random.normal(size=len(names)), 0.01)
        q, qd, qdd = simulation.position, simulation.velocity, simulation.acceleration
        states.append((q, qd, qdd))
        rows.append((q[places], qd[rates], qdd[rates]))
        efforts.append(simulation.effort[rates])
    motion, effort = np.array(rows), np.array(efforts)
    return ({name: motion[:, :, k].T for k, name in enumerate(names)},
            {name: effort[:, k] for k, name in enumerate(names)}, states)


def true_value(scene, name):
    """Return a linear parameter of a scene, from the definition of moments alone."""
    body, kind, *axes = name.split('.')
    record = next(one for one in scene.mechanism.bodies if one.name == body)
    whole = pseudo_inertia(record)
    if kind == 'mass':
        return whole[-1, -1]
    if kind == 'first_moment':
        return whole['xyz'.index(axes[0]), -1]
    second = whole[:-1, :-1]
    if len(second) == 2:
        return np.trace(second)
    about = np.trace(second) * np.eye(3) - second
    return about['xyz'.index(axes[0][0]), 'xyz'.index(axes[0][1])]


@pytest.mark.parametrize('name, torque, least', [
    ('four_bar', 3.0, 8), ('three_rrr_horizontal', 2.0, 12), ('bennett', 0.3, 7)])
def test_sums_of_all_bodies_are_exact(name, torque, least):
    scene = load_scene(name)
    motion, effort, _ = run(scene, torque)
    # Begun far from the true numbers.
    bodies = [body.name for body in scene.mechanism.bodies]
    start = other(scene, {f'mechanism.bodies.{body}.mass': 5.0 for body in bodies})
    found = identify(start, ['mechanism.bodies'], motion, effort)
    assert len(found.combinations) >= least
    for one in found.combinations:
        parts = [factor * true_value(scene, part) for part, factor in one.terms.items()]
        assert one.estimate.value == pytest.approx(
            sum(parts), abs=1e-9 * max(1.0, np.abs(parts).max())), str(one)
    assert max(found.deviations.values()) < 1e-11 * max(
        np.abs(each).max() for each in effort.values())


def test_parameters_that_are_known_alone_are_exact():
    scene = load_scene('four_bar')
    motion, effort, _ = run(scene, 3.0)
    truth = {f'{COUPLER}.mass': 1.0, 'mechanism.bodies.rocker.inertia': 0.8 * 0.25 ** 2 / 12.0}
    start = other(scene, {f'{COUPLER}.mass': 3.0, 'mechanism.bodies.rocker.inertia': 1.0})
    found = identify(start, list(truth), motion, effort)
    for key, value in truth.items():
        assert found.estimates[key].value == pytest.approx(value, rel=1e-9)
        assert found.estimates[key].identified
    assert not (found.unknown or found.unseen or found.combinations or found.impossible)


@pytest.mark.parametrize('names', [
    ('theta_1',), ('theta_1', 'theta_2', 'theta_6', 'theta_7'), ()],
    ids=['fewer', 'more', 'none'])
def test_drives_may_be_fewer_or_more_than_degrees_of_freedom(names):
    scene = load_scene('three_rrr_horizontal')
    mechanism = scene.mechanism
    scene = replace(scene, mechanism=replace(mechanism, joints=tuple(
        replace(joint, actuated=joint.name in names) for joint in mechanism.joints)))
    simulation, random = Simulation.from_scene(scene, accuracy=1e-9), np.random.default_rng(0)
    # Thrown, where nothing drives it.
    simulation.set_state(simulation.position, dict(zip(
        ('theta_1', 'theta_6', 'theta_7'), (0.5, -0.3, 0.4))),
        hold=('theta_1', 'theta_6', 'theta_7'))
    joints = measured_joints(scene)
    assert len(joints) == (4 if len(names) == 4 else 7)
    places, drives = ([simulation.joint_names.index(name) for name in some]
                      for some in (joints, names))
    rows, efforts = [], []
    for _ in range(60):
        simulation.step(2.0 * random.normal(size=len(names)) if names else None, 0.01)
        rows.append([each[places] for each in (
            simulation.position, simulation.velocity, simulation.acceleration)])
        efforts.append(simulation.effort[drives])
    motion = {name: np.array(rows)[:, :, k].T for k, name in enumerate(joints)}
    effort = {name: np.array(efforts)[:, k] for k, name in enumerate(names)}
    key = 'mechanism.bodies.platform.mass'
    start = other(scene, {key: 3.0})
    found = identify(start, [key], motion, effort)
    assert found.estimates[key].value == pytest.approx(8.0, rel=1e-9)
    if not names:
        # Without a torque all masses may be twice as large.
        with pytest.raises(IdentificationError, match='known but for a common factor'):
            identify(start, ['mechanism.bodies'], motion, effort)


def driven(scene, courses, count):
    """Return motion and efforts of joints whose motion is prescribed, by expressions in t."""
    simulation = Simulation(moving(scene, courses))
    places = [simulation.joint_names.index(name) for name in courses]
    rows, efforts = [], []
    for _ in range(count):
        simulation.step(None, 0.02)
        rows.append([each[places] for each in (
            simulation.position[simulation.coordinates.place], simulation.velocity,
            simulation.acceleration)])
        efforts.append(simulation.effort[places])
    motion, efforts = np.array(rows), np.array(efforts)
    return ({name: motion[:, :, k].T for k, name in enumerate(courses)},
            {name: efforts[:, k] for k, name in enumerate(courses)})


@pytest.mark.slow
def test_a_whole_body_in_space_is_exact():
    # All of a platform that moves in all six directions: principal moments and centre of mass.
    scene = load_scene('stewart_platform')
    simulation = Simulation(scene)
    courses = {name: f'{float(simulation.position[place])!r} + 0.02*sin({3 + k}*t)'
               for k, name in enumerate(scene.mechanism.actuated_joints)
               for place in [simulation.coordinates.place[simulation.joint_names.index(name)]]}
    motion, effort = driven(scene, courses, 40)
    body = 'mechanism.bodies.platform'
    truth = {key: value for key, value in numbers(scene).items() if key.startswith(f'{body}.')}
    assert len(truth) == 7
    start = other(scene, {f'{body}.mass': 15.0, f'{body}.center_of_mass.0': 0.0,
                          f'{body}.center_of_mass.2': 0.1})
    found = identify(start, [body, 'mechanism.bodies.piston_1.mass'], motion, effort)
    for key, value in truth.items():
        assert found.estimates[key].value == pytest.approx(value, rel=1e-9, abs=1e-9), key
    assert found.estimates['mechanism.bodies.piston_1.mass'].value == pytest.approx(0.8, rel=1e-9)


@pytest.mark.parametrize('name, torque', [
    ('three_rrr_horizontal', 2.0), pytest.param('bennett', 0.3, marks=pytest.mark.slow)])
def test_torques_of_the_regressor_are_those_of_other_bodies(name, torque):
    scene = load_scene(name)
    motion, _, states = run(scene, torque, 5)
    identifier = Identifier(scene, ['mechanism.bodies'], motion)
    random = np.random.default_rng(3)
    keys = [f'mechanism.bodies.{body.name}.{key}' for body in scene.mechanism.bodies for key in (
        'mass', 'center_of_mass.0', 'center_of_mass.1')]
    heavy = other(scene, {key: random.uniform(0.1, 2.0) for key in keys})
    change = [true_value(heavy, one.name) - true_value(scene, one.name)
              for one in identifier.parameters]
    one, two = (Simulation.from_scene(each) for each in (scene, heavy))
    for state, rows in zip(states, identifier.regressor):
        before, after = (each.inverse_dynamics(*state)[0] for each in (one, two))
        np.testing.assert_allclose(rows @ change, after - before, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize('name, torque', [
    ('four_bar', 3.0), pytest.param('bennett', 0.3, marks=pytest.mark.slow)])
def test_a_change_that_keeps_the_sums_changes_no_torque(name, torque):
    scene = load_scene(name)
    motion, effort, _ = run(scene, torque, 40)
    found = identify(scene, ['mechanism.bodies'], motion, effort)
    names = list(dict.fromkeys(name for one in found.combinations for name in one.terms))
    base = [next(iter(one.terms)) for one in found.combinations]
    values = {name: true_value(scene, name) for name in names}
    dependent = [name for name in names if name not in base]
    assert dependent
    for chosen in dependent:
        moved = dict(values)
        moved[chosen] += 0.1
        for one in found.combinations:
            moved[next(iter(one.terms))] -= 0.1 * one.terms.get(chosen, 0.0)
        # Of any body, possible or not: the torques are linear.
        identifier = Identifier(scene, ['mechanism.bodies'], motion)
        change = np.array([moved.get(one.name, one.value) - values.get(one.name, one.value)
                           for one in identifier.parameters])
        size = np.abs(identifier.regressor * change).max()
        assert size > 0.0
        assert np.abs(identifier.regressor @ change).max() < 1e-6 * size


def test_intervals_of_95_percent_hold_the_truth_as_often():
    scene = load_scene('three_rrr_horizontal')
    motion, effort, _ = run(scene, 2.0, 60)
    keys = ['mechanism.bodies.platform.mass', 'mechanism.bodies.platform.inertia',
            'mechanism.bodies.distal_1.mass']
    truth = np.array([numbers(scene)[key] for key in keys])
    identifier = Identifier(scene, keys, motion)
    # Drives whose sensors differ a hundredfold: without weights the worst would decide.
    sizes = {'theta_1': 0.02, 'theta_6': 0.2, 'theta_7': 2.0}
    random, inside, values = np.random.default_rng(11), [], []
    for _ in range(400):
        found = identifier.solve({name: each + sizes[name] * random.normal(size=len(each))
                                  for name, each in effort.items()})
        estimates = [found.estimates[key] for key in keys]
        inside.append([low <= value <= high for (low, high), value in zip(
            (one.interval for one in estimates), truth)])
        values.append([one.value for one in estimates])
    assert 0.93 <= np.mean(inside) <= 0.97
    assert ((np.mean(inside, axis=0) >= 0.93) & (np.mean(inside, axis=0) <= 0.97)).all()
    # As wide as they have to be.
    reported = [found.estimates[key].deviation for key in keys]
    np.testing.assert_allclose(np.std(values, axis=0), reported, rtol=0.3)
    for name, size in sizes.items():
        assert found.deviations[name] == pytest.approx(size, rel=0.3)


def test_lengths_friction_and_masses_are_exact_together():
    scene = load_scene('four_bar')
    scene = replace(scene, effects={
        **scene.effects, 'grease': JointDamping('rocker_joint', 0.3),
        'dry': JointFriction('coupler_joint', 0.2)})
    motion, effort, _ = run(scene, 3.0, 20)
    length = 'mechanism.cut_joints.cut_1.point_a.0'
    truth = {'effects.grease.coefficient': 0.3, 'effects.dry.coulomb': 0.2,
             f'{COUPLER}.mass': 1.0, length: 0.35}
    start = other(scene, {'effects.grease.coefficient': 0.0, 'effects.dry.coulomb': 0.05,
                          f'{COUPLER}.mass': 2.0, length: 0.36})
    found = identify(start, list(truth), motion, effort)
    for key, value in truth.items():
        assert found.estimates[key].value == pytest.approx(value, rel=1e-9), key


def test_a_centre_of_mass_whose_inertia_is_known_is_exact():
    scene = load_scene('four_bar')
    motion, effort, _ = run(scene, 3.0, 40)
    key = f'{COUPLER}.center_of_mass.0'
    found = identify(other(scene, {key: 0.1}), [key], motion, effort)
    assert found.estimates[key].value == pytest.approx(0.175, rel=1e-9)


def test_numbers_with_the_same_influence_are_named_without_a_value():
    scene = load_scene('four_bar')
    scene = replace(scene, effects={
        **scene.effects, 'one': JointDamping('rocker_joint', 0.3),
        'two': JointDamping('rocker_joint', 0.1)})
    motion, effort, _ = run(scene, 3.0, 30)
    keys = ['effects.one.coefficient', 'effects.two.coefficient', f'{COUPLER}.mass']
    found = identify(scene, keys, motion, effort)
    assert found.unknown == tuple(keys[:2])
    (one,) = found.combinations
    assert one.estimate is None
    assert {name: round(factor, 6) for name, factor in one.terms.items()} == {
        keys[0]: 1.0, keys[1]: 1.0}
    assert found.estimates[keys[2]].value == pytest.approx(1.0, rel=1e-9)


def test_what_does_not_move_is_named():
    scene = load_scene('four_bar')
    motion, effort, _ = run(scene, 3.0, 20)
    # About its bearing in the ground a mass in that bearing does nothing.
    found = identify(scene, ['mechanism.bodies.crank', f'{COUPLER}.mass'], motion, effort)
    assert found.unseen == ('crank.mass',)
    assert 'mechanism.bodies.crank.mass' in found.unknown
    assert 'mechanism.bodies.crank.mass' not in found.estimates
    assert not any('crank.mass' in one.terms for one in found.combinations)


def test_a_drive_with_a_prescribed_motion_has_an_effort():
    scene = load_scene('four_bar')
    course = {'crank_joint': '1.0472 + sin(5*t)'}
    motion, effort = driven(scene, course, 40)
    moved = other(moving(scene, course), {f'{COUPLER}.mass': 2.0})
    assert measured_joints(moved) == ('crank_joint',)
    found = identify(moved, [f'{COUPLER}.mass'], motion, effort)
    assert found.estimates[f'{COUPLER}.mass'].value == pytest.approx(1.0, rel=1e-9)


def test_rotors_payload_and_friction_of_drives_are_exact():
    scene = load_scene('three_rrr_payload_friction')
    motion, effort = driven(scene, {
        'theta_1': '1.0467 + 0.15*sin(3*t)', 'theta_6': '4.1883 + 0.15*sin(4*t) - 0.1*sin(2*t)',
        'theta_7': '5.7637 + 0.12*sin(5*t)'}, 40)
    keys = ['effects.part.mass', 'effects.gear_6.coulomb', 'effects.rotor_1.inertia',
            'effects.grease_2.coefficient']
    truth = {key: numbers(scene)[key] for key in keys}
    found = identify(
        other(scene, {key: 1.5 * value for key, value in truth.items()}), keys, motion, effort)
    for key, value in truth.items():
        assert found.estimates[key].value == pytest.approx(value, rel=1e-9), key


def test_an_impossible_body_is_reported():
    scene = load_scene('four_bar')
    motion, effort, _ = run(scene, 3.0, 30)
    identifier = Identifier(scene, ['mechanism.bodies.rocker.inertia'], motion)
    # Torques of a rocker with an inertia below zero.
    less = identifier.regressor[:, 0, 0] * -0.01
    found = identifier.solve({'crank_joint': effort['crank_joint'] + less})
    assert found.estimates['mechanism.bodies.rocker.inertia'].value < 0.0
    assert list(found.impossible) == ['rocker'] and found.impossible['rocker'] < 0.0


@pytest.mark.parametrize('dry', [
    JointFriction('crank_joint', 0.2), JointFriction('cut_1', 0.2),
    TendonFriction({'crank_joint': 1.0, 'rocker_joint': -0.5}, 0.2)])
def test_samples_in_which_dry_friction_holds_a_joint_are_left_out(dry):
    scene = load_scene('four_bar')
    scene = replace(scene, effects={**scene.effects, 'dry': dry})
    motion, effort, _ = run(scene, 3.0, 30)
    before = Identifier(scene, [f'{COUPLER}.mass'], motion).solve(effort).samples
    motion['crank_joint'][1, 7] = 0.0
    found = identify(scene, [f'{COUPLER}.mass'], motion, effort)
    assert set(before) - set(found.samples) == {7}
    assert found.estimates[f'{COUPLER}.mass'].value == pytest.approx(1.0, rel=1e-9)


def test_keys_of_a_body_come_back_from_its_parameters():
    body = load_scene('bennett').mechanism.bodies[1]
    body = replace(body, center_of_mass=(0.1, -0.2, 0.3), inertia=(1.0, 1.2, 0.9, 0.1, 0.2, 0.05))
    keys = ['mass', *(f'center_of_mass.{n}' for n in range(3)), *(
        f'inertia.{n}' for n in range(6))]
    own = BodyParameters(body, keys)
    assert len(own.parameters) == 10 and not own.nonlinear
    values = own.values({one.name: one.value for one in own.parameters})
    known = [body.mass, *body.center_of_mass, *body.inertia]
    np.testing.assert_allclose([np.real(values[key]) for key in keys], known, rtol=1e-12)


def test_an_excitation_is_better_than_chance_and_within_its_amplitude():
    scene = load_scene('four_bar')
    found = excite(scene, ['mechanism.bodies'], 2.0, 0.8, evaluations=40)
    assert found.condition < 0.9 * found.first
    series = found.series['crank_joint']
    motion = series.at(np.linspace(0.0, 2.0, 1001))
    assert np.abs(motion[0] - 1.0472).max() == pytest.approx(0.8, rel=0.01)
    assert abs(motion[1, 0]) < 1e-12 and motion[0, 0] == pytest.approx(1.0472)
    # Rates and accelerations belong to the positions, and the text to all of them.
    np.testing.assert_allclose(np.gradient(motion[0], 0.002)[5:-5], motion[1, 5:-5], atol=1e-3)
    np.testing.assert_allclose(np.gradient(motion[1], 0.002)[5:-5], motion[2, 5:-5], atol=1e-2)
    simulation = Simulation(moving(scene, {'crank_joint': str(series)}))
    simulation.step(None, 0.5)
    assert simulation.position[0] == pytest.approx(motion[0, 250], abs=1e-6)


def test_a_motion_out_of_reach_is_refused():
    with pytest.raises(IdentificationError, match='amplitude: expected a motion'):
        excite(load_scene('three_rrr_horizontal'), ['mechanism.bodies.platform'], 1.0, 3.0, 2, 12)


def short():
    scene = load_scene('four_bar')
    return scene, *run(scene, 3.0, 10)[:2]


@pytest.mark.parametrize('keys, problem', [
    ([], 'keys: expected a list of key paths'),
    ('mechanism.bodies', 'keys: expected a list of key paths'),
    (['initial.position.crank_joint'], 'begins with mechanism, effects, parameters'),
    (['mechanism.bodies.crank.mas'], "expected one of .*got 'mas'"),
    ([f'{COUPLER}.mass', COUPLER], f'{COUPLER}.mass: expected once, got it twice'),
    (['mechanism.joints.crank_joint.position'], 'leads to several'),
    (['mechanism.bodies', 'effects.gravity.acceleration.1'], 'more equations than the 13')])
def test_keys_that_cannot_be_are_refused(keys, problem):
    scene, motion, effort = short()
    with pytest.raises((IdentificationError, FieldError), match=problem):
        identify(scene, keys, motion, effort)


@pytest.mark.parametrize('effect, problem', [
    (JointFriction('rocker_joint', friction_coefficient=0.1), 'depends on the force in its joint'),
    (PrescribedForce('constant', joint='rocker_joint', amplitude=1.0), 'follows the time')])
def test_effects_that_do_not_follow_from_the_motion_are_refused(effect, problem):
    scene, motion, effort = short()
    scene = replace(scene, effects={**scene.effects, 'what': effect})
    with pytest.raises(IdentificationError, match=f'effects.what: expected .*{problem}'):
        identify(scene, [f'{COUPLER}.mass'], motion, effort)


def test_arrays_that_do_not_fit_are_refused():
    scene, motion, effort = short()
    keys = [f'{COUPLER}.mass']
    crank = motion['crank_joint']
    for given, problem in (
            ((motion, {}), 'effort: expected those of crank_joint, got none'),
            ((motion, {'crank_joint': effort['crank_joint'][1:]}), 'expected 10 values'),
            (({'crank_joint': crank[:2]}, effort), r'expected shape \(3, n\)'),
            (({'crank_joint': crank * np.nan}, effort), 'expected finite numbers'),
            (({}, effort), 'measured: expected different ones of'),
            (({'cut_1': crank}, effort), 'measured: expected different ones of')):
        with pytest.raises(ValueError, match=problem):
            identify(scene, keys, *given)


def test_a_spin_that_nothing_measures_is_refused():
    scene = load_scene('rssr_four_bar')
    motion, _, _ = run(scene, 1.0, 5)
    with pytest.raises(IdentificationError, match='leave 1 of 2 degrees of freedom open'):
        Identifier(scene, ['mechanism.bodies.crank.mass'], motion)


def test_a_common_factor_is_not_known():
    scene = load_scene('four_bar')
    motion, effort, _ = run(scene, 3.0, 30)
    nothing = {'crank_joint': 0.0 * effort['crank_joint']}
    with pytest.raises(IdentificationError, match='known but for a common factor'):
        # As if all that has a mass varied, and no torque acted.
        identify(replace(scene, effects={}), ['mechanism.bodies'], motion, nothing)


def test_another_branch_is_refused():
    # It falls through a singular position of its drives, and they turn back.
    scene = load_scene('three_rrr')
    motion, effort, states = run(scene, 5.0, 60)
    seen = {'theta_2': [q[1] for q, _, _ in states]}
    with pytest.raises((IdentificationError, PassiveJointError), match='singular position'):
        identify(scene, ['mechanism.bodies.platform.mass'], motion, effort, seen)
    before = {name: each[:, :40] for name, each in motion.items()}, {
        name: each[:40] for name, each in effort.items()}
    found = identify(scene, ['mechanism.bodies.platform.mass'], *before,
                     {'theta_2': seen['theta_2'][:40]})
    assert found.estimates['mechanism.bodies.platform.mass'].value == pytest.approx(8.0, rel=1e-9)
