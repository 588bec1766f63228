# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of effects: the routine of a scene against single laws, and against their energies."""

from dataclasses import replace

from closedloop_dynamics import load_scene, Point, Simulation
from closedloop_dynamics.effects.element import DISSIPATED, STORED, WORK
from closedloop_dynamics.effects.registry import EFFECTS
from closedloop_dynamics.simulation.system import parts_of_state
import numpy as np
import pytest

# Columns of gaps now, and over a step (``engine/effect_table.hpp``).
GAP, RATE, PLACE = range(3)
FASTEST, SPEED, WRONG = range(3)
CRANK = 'crank_joint'
TIMES, VALUES = (0.0, 0.4, 1.0), (0.2, -0.3, 0.5)
IN_PLANE = {
    'springs': [
        ('joint_spring', {'joint': CRANK, 'stiffness': 1.37, 'rest': 0.2}),
        ('joint_spring', {'joint': 'CUT', 'stiffness': 0.7}),
        ('joint_damping', {'joint': CRANK, 'coefficient': 0.13}),
        ('joint_damping', {'joint': 'CUT', 'coefficient': 0.21}),
        ('point_spring', {'point_a': 'ONE', 'anchor': (0.3, 0.4), 'stiffness': 21.0,
                          'damping': 1.3, 'free_length': 0.1})],
    'bushing and drag': [
        ('bushing', {'point_a': 'ONE', 'anchor': (0.1, 0.2), 'stiffness': (11.0, 17.0),
                     'damping': (0.4, 0.7), 'turning_stiffness': 0.3, 'turning_damping': 0.2,
                     'angle': 0.3}),
        ('fluid_drag', {'point': 'ONE', 'linear': (0.3, 0.4), 'quadratic': (0.5, 0.1),
                        'turning_linear': 0.2, 'turning_quadratic': 0.1, 'flow': (0.4, -0.2)}),
        ('tendon', {'arms': {CRANK: 0.3, 'slider_joint': -0.2}, 'stiffness': (3.0, 2.0),
                    'damping': (0.5, 0.2), 'rest': 0.1})],
    'forces over time': [
        ('external_force', {'point': 'ONE', 'force': (1.0, -2.0), 'torque': 0.3,
                            'axes': 'body'}),
        ('prescribed_force', {'joint': CRANK, 'shape': 'sine', 'amplitude': 0.3,
                              'frequency': 2.0, 'offset': 0.1}),
        ('prescribed_force', {'joint': 'CUT', 'shape': 'expression', 'expression': 'sin(3 * t)'}),
        ('prescribed_force', {'point': 'ONE', 'direction': (0.6, 0.8), 'axes': 'body',
                              'shape': 'table', 'times': TIMES, 'values': VALUES})],
    'force tables': [
        ('force_table', {'joint': CRANK, 'strokes': (-1.0, 0.0, 1.0), 'forces': (3.0, 0.0, -4.0),
                         'damping': 0.3}),
        ('force_table', {'point_a': 'ONE', 'anchor': (0.3, 0.4), 'strokes': (0.0, 0.2, 0.7),
                         'forces': (0.0, 2.0, 9.0), 'damping': 0.2, 'interpolation': 'cubic'})],
    'motion': [
        ('prescribed_motion', {'joint': CRANK, 'shape': 'sine', 'amplitude': 0.2,
                               'frequency': 1.0, 'offset': 0.3})],
    'motion as an expression': [
        ('prescribed_motion', {'joint': CRANK, 'shape': 'expression',
                               'expression': '0.3 + 0.2 * sin(2 * t)'})],
    'stop, friction, drive': [
        ('end_stop', {'joint': CRANK, 'stiffness': 50.0, 'lower': 0.9, 'upper': 1.2,
                      'damping': 0.3}),
        ('joint_friction', {'joint': CRANK, 'coulomb': 0.3, 'static_ratio': 1.5}),
        ('joint_friction', {'joint': 'CUT', 'coulomb': 0.1}),
        ('actuator', {'joint': CRANK, 'max_torque': 1.5, 'max_speed': 20.0, 'lag': 0.02})],
    'friction under a load': [
        ('joint_friction', {'joint': CRANK, 'coulomb': 0.3, 'static_ratio': 1.5}),
        ('external_force', {'point': 'ONE', 'force': (1.0, -2.0), 'torque': 0.3})],
    'two frictions at rest': [
        ('joint_friction', {'joint': CRANK, 'coulomb': 0.3}),
        ('joint_friction', {'joint': 'slider_joint', 'coulomb': 0.2}),
        ('external_force', {'point': 'ONE', 'force': (1.0, -2.0), 'torque': 0.3})],
    'three frictions at rest': [
        ('joint_friction', {'joint': CRANK, 'coulomb': 0.3}),
        ('joint_friction', {'joint': 'slider_joint', 'coulomb': 0.2}),
        ('joint_friction', {'joint': 'rod_joint', 'coulomb': 0.005}),
        ('external_force', {'point': 'ONE', 'force': (1.0, -2.0), 'torque': 0.3})],
    'contacts': [
        ('contact', {'point': 'ONE', 'origin': (0.0, 0.1), 'angle': 0.1, 'stiffness': 300.0,
                     'exponent': 1.5, 'damping': 0.2, 'friction': 0.3, 'scraping': 2.0}),
        ('body_contact', {'point': 'ONE', 'other': 'TWO', 'shape': 'line', 'angle': 0.2,
                          'radius': 0.05, 'stiffness': 200.0, 'friction': 0.2}),
        ('body_contact', {'point': 'ONE', 'other': 'TWO', 'shape': 'circle', 'radius': 0.03,
                          'other_radius': 0.2, 'stiffness': 200.0, 'exponent': 1.3,
                          'damping': 0.1})],
    'laws of users': [
        ('law', {'joints': {'x': CRANK}, 'rates': {'v': 'x'}, 'distances': {
            'd': ('ONE', (0.5, 0.3))}, 'components': {'y': ('ONE', 'y')},
            'parameters': {'k': 1.3, 'c': 0.2}, 'states': {'z': '(v - z)/0.1 + c*t'},
            'forces': {'x': '-c*z*abs(v) + sin(3*y)*cos(x)', 'd': '-k/(d**2 + 0.1)',
                       'y': '-k*atan2(y, d)*exp(-x*x)'}}),
        ('law', {'joints': {'x': CRANK}, 'rates': {'v': 'x'}, 'components': {'y': ('ONE', 'y')},
                 'event': {'below': 'y - 0.1'}, 'dissipation': '0.3*v*v*(1 - below)',
                 'energy': 'x*x + (25*(0.1 - y) + 2)*(0.1 - y)*below',
                 'forces': {'x': '-2*x - 0.3*v*(1 - below)', 'y': '(50*(0.1 - y) + 2)*below'}})],
    'cable': [
        ('cable', {'points': ('ONE', 'TWO', 'THREE'), 'radii': (0.0, -0.02, 0.0),
                   'stiffness': 80.0, 'free_length': 0.4, 'damping': 0.2})]}
IN_SPACE = {
    'springs in space': [
        ('joint_damping', {'joint': 'crank', 'coefficient': 0.13}),
        ('point_spring', {'point_a': 'ONE', 'anchor': (0.3, 0.4, 0.1), 'stiffness': 21.0,
                          'damping': 1.3, 'free_length': 0.1}),
        ('external_force', {'point': 'ONE', 'force': (1.0, -2.0, 0.5),
                            'torque': (0.1, 0.2, 0.3), 'axes': 'body'}),
        ('prescribed_force', {'point': 'ONE', 'direction': (0.6, 0.0, 0.8), 'axes': 'body',
                              'shape': 'sine', 'amplitude': 1.0, 'frequency': 2.0})],
    'bushing and drag in space': [
        ('bushing', {'point_a': 'ONE', 'anchor': (0.1, 0.2, 0.3), 'stiffness': (11.0, 17.0, 5.0),
                     'damping': (0.4, 0.7, 0.1), 'turning_stiffness': (0.3, 0.2, 0.1),
                     'turning_damping': (0.2, 0.1, 0.3)}),
        ('fluid_drag', {'point': 'ONE', 'linear': (0.3, 0.4, 0.2), 'quadratic': (0.5, 0.1, 0.2),
                        'turning_linear': (0.2, 0.1, 0.1), 'turning_quadratic': (0.1, 0.1, 0.2),
                        'flow': (0.4, -0.2, 0.1)})],
    'contact in space': [
        ('contact', {'point': 'ONE', 'origin': (0.0, 0.0, 0.525), 'normal': (0.0, 0.6, 0.8),
                     'stiffness': 300.0, 'exponent': 1.5, 'damping': 0.2, 'friction': 0.3}),
        ('body_contact', {'point': 'ONE', 'other': 'TWO', 'shape': 'sphere', 'radius': 0.03,
                          'other_radius': 0.6, 'stiffness': 200.0, 'damping': 0.1,
                          'friction': 0.2}),
        ('joint_friction', {'joint': 'crank', 'coulomb': 0.3})],
    'law in space': [
        ('law', {'joints': {'x': 'crank'}, 'distances': {'d': ('ONE', (0.5, 0.3, 0.2))},
                 'components': {'u': ('ONE', 'z')}, 'rates': {'v': 'x', 'w': 'd'},
                 'forces': {'x': '-0.2*v*abs(v)', 'd': '-3*sin(d) - w', 'u': '-2*u'},
                 'energy': '-3*cos(d) + u*u', 'dissipation': '0.2*abs(v)**3 + w*w'})],
    'motion in space': [
        ('prescribed_motion', {'joint': 'crank', 'shape': 'constant_speed', 'speed': 2.0})]}
# A cut joint that turns, whose angle is followed, in space.
AT_A_CUT = {'cut joint in space': [
    ('joint_spring', {'joint': 'joint_4', 'stiffness': 1.37, 'rest': 0.2}),
    ('joint_damping', {'joint': 'joint_4', 'coefficient': 0.3})]}
AT_A_BALL = {'spring of an orientation': [
    ('joint_spring', {'joint': 'lower_ball', 'stiffness': 30.0})]}
CASES = {**{name: ('slider_crank', one) for name, one in IN_PLANE.items()},
         **{name: ('rssr_four_bar', one) for name, one in IN_SPACE.items()},
         **{name: ('bennett', one) for name, one in AT_A_CUT.items()},
         **{name: ('double_wishbone', one) for name, one in AT_A_BALL.items()}}


def simulated(name):
    """Return a simulation of a shipped machine under some effects and no others."""
    machine, effects = CASES[name]
    scene = load_scene(machine)
    mechanism = scene.mechanism
    if mechanism.planar:
        mechanism = replace(mechanism, points=(
            Point('on_rod', 'rod', (0.1, 0.02)), *mechanism.points))
    elif mechanism.points[0].body == 'rocker':
        mechanism = replace(mechanism, points=(
            mechanism.points[0], Point('on_crank', 'crank', (0.1, 0.0, 0.0))))
    points = [point.name for point in mechanism.points]
    names = {'ONE': points[0], 'TWO': points[1], 'THREE': points[-1],
             'CUT': mechanism.cut_joints[0].name}

    def known(value):
        if isinstance(value, dict):
            return {known(key): known(one) for key, one in value.items()}
        if isinstance(value, tuple):
            return tuple(map(known, value))
        return names.get(value, value) if isinstance(value, str) else value

    return Simulation(replace(scene, mechanism=mechanism, effects={
        f'{kind}_{number}': EFFECTS[kind](**known(keys))
        for number, (kind, keys) in enumerate(effects)}))


def found(system, state):
    """Return all that steps ask for of an evaluation of a state."""
    contacts = system.effects.contacts
    contacts.trial[:] = 0.0
    system.native.derivative(state, np.zeros(len(state)))
    gaps, trials = contacts.now[contacts.rows], contacts.trial[contacts.rows]
    return [each.copy() for each in (
        system.qdd, system.effects.rates, gaps[:, [GAP, RATE, PLACE, PLACE + 1]],
        trials[:, [FASTEST, SPEED, WRONG]])]


def in_parts(system, state):
    """Return the same where laws act one by one between two routines."""
    fits = system.effects.code.fits
    fits[0] = 0
    expected = found(system, state)
    fits[0] = 1
    return expected


@pytest.mark.parametrize('name', CASES)
def test_one_routine_does_what_the_parts_do(name):
    simulation = simulated(name)
    system, random = simulation.data.system, np.random.default_rng(5)
    assert system.effects.code.fits[0] == 1
    q, qd, own, _ = parts_of_state(system)
    kinds = set()
    for _ in range(12):
        state = simulation.data.integrated.copy()
        # In space the first joints are revolute ones, and quaternions behind.
        moved = state[q] if system.manifold is None else state[q][:2]
        moved += random.normal(scale=0.2, size=moved.shape)
        state[qd] += random.normal(scale=2.0, size=state[qd].shape)
        simulation.data.effect_set.initialise_states(state[own], simulation.data.effect_set.rates(
            state[q], state[qd]))
        before = system.work.health.copy()
        ours, theirs = found(system, state), in_parts(system, state)
        system.work.health[:] = before
        kinds.update((theirs[2][:, 0] < 0.0).tolist())
        for one, other in zip(ours, theirs):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * (
                1.0 + np.abs(other).max(initial=0.0)))
    # Contacts were there and not.
    assert not kinds or len(kinds) == 2


def generalised_forces(system, q, qd):
    """Return what is exerted along the coordinates of the tree at rest [N m; N]."""
    need, effects, work = np.zeros(len(qd)), system.effects, system.work
    system.model.outward(q, qd, work)
    effects.apply_effects(work.body, q, qd, np.zeros(len(system.tau)))
    work.bias_forces(effects.reaction)
    system.model.tree_torque(work, np.zeros(len(qd)), need)
    return effects.applied[:len(qd)] - need


@pytest.mark.parametrize('name', [*IN_PLANE, *IN_SPACE])
def test_forces_do_the_power_that_energies_tell(name):
    """Whatever the mechanism's loops: along any motion of the tree."""
    simulation = simulated(name)
    system, roles, random = simulation.data.system, simulation.data.effect_set.roles, (
        np.random.default_rng(5))
    effects, step, kinds = system.effects, 1e-6, set()
    for _ in range(12):
        state = simulation.data.integrated.copy()
        places, rates, own, _ = parts_of_state(system)
        q, qd = state[places], state[rates]
        # In space the first joints are revolute ones, and quaternions behind.
        count = len(q) if system.manifold is None else 2
        q[:count] += random.normal(scale=0.2, size=count)
        qd[:count] += random.normal(scale=2.0, size=count)
        qd[count:] = 0.0
        simulation.data.effect_set.initialise_states(
            effects.states, simulation.data.effect_set.rates(q, qd))
        stored = []
        for sign in (-1.0, 1.0):
            there = q.copy()
            there[:count] += sign * step * qd[:count]
            generalised_forces(system, there, qd)
            stored.append(effects.output[:, STORED].sum())
        forces = generalised_forces(system, q, qd)
        kinds.update((effects.contacts.now[effects.contacts.rows, GAP] < 0.0).tolist())
        flow = effects.rates[roles == WORK].sum() - effects.rates[roles == DISSIPATED].sum()
        scale = np.abs(effects.rates).max() + np.abs(np.diff(stored))[0] / step
        effects.enabled[:] = 0
        power = qd @ (forces - generalised_forces(system, q, qd))
        effects.enabled[:] = 1
        assert power == pytest.approx(
            flow - np.diff(stored)[0] / (2.0 * step), abs=1e-7 * (1.0 + scale))
    # Contacts were there and not.
    assert not kinds or len(kinds) == 2


def test_what_changes_is_read():
    simulation = simulated('springs')
    system = simulation.data.system
    state = simulation.data.integrated.copy()
    before = found(system, state)[0]
    simulation.set_effect('joint_spring_0', stiffness=200.0)
    assert system.effects.code.fits[0] == 1
    after = found(system, state)[0]
    assert np.abs(after - before).max() > 1.0
    np.testing.assert_allclose(after, in_parts(system, state)[0], rtol=1e-9)


def test_an_effect_that_is_off_does_not_act():
    simulation = simulated('springs')
    state = simulation.data.integrated.copy()
    simulation.set_effect('joint_spring_0', stiffness=200.0, enabled=False)
    off = found(simulation.data.system, state)[0]
    simulation.set_effect('joint_spring_0', stiffness=0.0, enabled=True)
    np.testing.assert_allclose(off, found(simulation.data.system, state)[0], rtol=1e-9)


def test_a_term_that_the_code_does_not_have_acts():
    """Nothing is compiled in a run: what would be another code is evaluated in parts."""
    simulation = simulated('stop, friction, drive')
    system, state = simulation.data.system, simulation.data.integrated.copy()
    state[parts_of_state(system)[1]] = 1e-3
    simulation.set_effect('joint_friction_2', static_ratio=1.4, stribeck_velocity=5.0)
    assert system.effects.code.fits[0] == 0
    changed = found(system, state)[0]
    simulation.set_effect('joint_friction_2', static_ratio=1.0)
    assert system.effects.code.fits[0] == 1
    assert np.abs(changed - found(system, state)[0]).max() > 1e-3


def at_rest(name, **changes):
    """Return the system of a simulation, and its state with all joints at rest."""
    simulation = simulated(name)
    simulation.set_effect('joint_friction_0', **changes)
    state = simulation.data.integrated.copy()
    q, qd, own, _ = parts_of_state(simulation.data.system)
    state[qd] = 0.0
    simulation.data.effect_set.initialise_states(
        state[own], simulation.data.effect_set.rates(state[q], state[qd]))
    return simulation.data.system, state


@pytest.mark.parametrize('coulomb, breaks_away', [(50.0, False), (0.01, True)])
def test_one_routine_holds_a_joint_at_rest(coulomb, breaks_away):
    """Up to the limit: under a larger load the joint sets out."""
    system, state = at_rest('friction under a load', coulomb=coulomb)
    ours = found(system, state)
    # Nobody has asked what responds to it.
    assert system.effects.static_friction.rows[0] == 0
    theirs = in_parts(system, state)
    assert system.effects.static_friction.rows[0] == 1
    assert (np.abs(theirs[0]).max() > 1e-3) == breaks_away
    for one, other in zip(ours, theirs):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * (
            1.0 + np.abs(other).max(initial=0.0)))


@pytest.mark.parametrize('coulomb', [50.0, 0.01])
def test_one_routine_holds_several_joints_at_rest(coulomb):
    """Each up to its limit; whether all stay, or one sets out."""
    system, state = at_rest('three frictions at rest', coulomb=coulomb)
    ours = found(system, state)
    assert system.effects.static_friction.rows[0] == 3
    readings = system.effects.output.copy()
    theirs = in_parts(system, state)
    assert (np.abs(theirs[0]).max() > 1e-3) == (coulomb < 1.0)
    for one, other in zip((*ours, readings[:, 1]), (*theirs, system.effects.output[:, 1])):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * (
            1.0 + np.abs(other).max(initial=0.0)))


@pytest.mark.parametrize('machine, outcomes', [('slider_crank', 3), ('three_rrr', 4)])
def test_one_routine_balances_two_joints_at_rest(machine, outcomes):
    """Those of one freedom one after the other, others together."""
    scene = load_scene(machine)
    rubbing = [one.name for one in scene.mechanism.joints
               if one.type in ('revolute', 'prismatic')][:2]
    simulation = Simulation(replace(scene, effects={
        joint: EFFECTS['joint_friction'](joint, coulomb=1.0) for joint in rubbing}))
    system, state = simulation.data.system, simulation.data.integrated.copy()
    q, qd, own, _ = parts_of_state(system)
    state[qd] = 0.0
    simulation.data.effect_set.initialise_states(
        state[own], simulation.data.effect_set.rates(state[q], state[qd]))
    random, seen = np.random.default_rng(3), set()
    for _ in range(100):
        for joint, coulomb in zip(rubbing, 10.0 ** random.uniform(-2.0, 1.0, size=2)):
            simulation.set_effect(joint, coulomb=coulomb)
        system.tau[:] = random.normal(scale=2.0, size=len(system.tau))
        ours = found(system, state)
        # Nobody has asked what responds to it.
        assert system.effects.static_friction.rows[0] == 0
        theirs = in_parts(system, state)
        assert system.effects.static_friction.rows[0] == 2
        held = np.abs(system.effects.static_friction.share) < 1.0
        seen.add(tuple(held.tolist()))
        for one, other in zip(ours, theirs):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * (
                1.0 + np.abs(other).max(initial=0.0)))
    # Of one freedom the first joint is at its limit before the second.
    assert len(seen) == outcomes


def test_what_has_no_law_in_code_is_evaluated_in_parts():
    simulation = Simulation.from_scene('four_bar')
    scene = replace(simulation.scene, effects={'inertia': EFFECTS['tendon_inertia'](
        arms={simulation.joint_names[0]: 0.3}, inertia=0.5)})
    system = Simulation(scene).data.system
    assert system.effects.code.fits[0] == 0
