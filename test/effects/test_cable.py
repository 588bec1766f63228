# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Cables over guides and pulleys: Newton by hand, length, slackness, energy."""

from dataclasses import replace
import math

from closedloop_dynamics import (
    Body, Joint, load_scene, Mechanism, NumericalError, Point, Simulation)
from closedloop_dynamics.codegen.spatial import rotation
from closedloop_dynamics.effects.registry import Cable, Gravity
from closedloop_dynamics.mechanism.checks import orientation
import numpy as np
import pytest

from .machines import assert_balanced, flyer, simulated

EARTH = Gravity((0.0, -9.81))
RADIUS, STIFFNESS = 0.1, 1e4


def hoist():
    """
    Return a load on a moving pulley, and a counterweight on the same rope.

    The rope goes from the ceiling down around the load's pulley, up over a pulley at the ceiling,
    and down to the counterweight: 'load' and 'weight' [m], both upwards.
    """
    return Mechanism(
        'hoist', (Body('load', 6.0, (0, 0), 0.1), Body('weight', 2.0, (0, 0), 0.1)),
        (Joint('load', 'prismatic', 'ground', 'load', (0.1, -1.0), math.pi / 2),
         Joint('weight', 'prismatic', 'ground', 'weight', (0.4, -1.0), math.pi / 2)), (),
        (Point('ceiling', 'ground', (0.0, 0.0)), Point('pulley', 'load', (0.0, 0.0)),
         Point('wheel', 'ground', (0.3, 0.0)), Point('hook', 'weight', (0.0, 0.0))))


def rope(stretch, **values):
    """Return the hoist's rope, stretched by so much at the start."""
    length = 1.0 + math.pi * RADIUS + 1.0 + math.pi * RADIUS + 1.0
    return Cable(('ceiling', 'pulley', 'wheel', 'hook'), STIFFNESS, length - stretch,
                 radii=(0.0, RADIUS, -RADIUS, 0.0), **values)


def test_a_hoist_moves_as_newton_says():
    # Bound by the rope, weight = -2 load: T = a_l m_l / 2 + m_l g / 2 = m_w (g + a_w).
    m_l, m_w, g = 6.0, 2.0, 9.81
    up = (2.0 * m_w - m_l) * g / (m_l + 4.0 * m_w)
    tension = m_w * (g - 2.0 * up)
    simulation = simulated(hoist(), {'gravity': EARTH, 'rope': rope(tension / STIFFNESS)},
                           [0.0, 0.0])
    assert simulation.effect_readings('rope')['length'] == pytest.approx(
        3.0 + 2.0 * math.pi * RADIUS, abs=1e-13)
    assert np.allclose(simulation.acceleration, [up, -2.0 * up], rtol=1e-12)
    simulation.step(duration=0.3)
    # Started without a swing of the rope, which stays as long as it is.
    assert np.allclose(simulation.position, [0.5 * up * 0.09, -up * 0.09], atol=1e-9)
    assert simulation.effect_readings('rope')['tension'] == pytest.approx(tension, rel=1e-6)
    assert_balanced(simulation, 1e-7)


def test_a_slack_rope_does_nothing_and_becomes_taut_without_a_jump():
    simulation = simulated(
        hoist(), {'gravity': EARTH, 'rope': rope(-0.05, damping=0.2)}, [0.0, 0.0], step_size=1e-4)
    assert np.allclose(simulation.acceleration, -9.81)
    tensions = []
    for _ in range(200):
        simulation.step(duration=2e-3)
        tensions.append(simulation.effect_readings('rope')['tension'])
    assert min(tensions) == 0.0 < max(tensions)
    assert simulation.energy_balance.dissipated > 0.0
    assert_balanced(simulation, 1e-4)


@pytest.mark.parametrize('radii', [None, (0.0, 0.15, -0.1, 0.0), (0.0, -0.15, 0.1, 0.0)])
def test_the_force_is_the_gradient_of_the_length(radii):
    # The length by its definition, and the force by finite differences of it.
    machine = flyer()
    machine = Mechanism('flyer', machine.bodies, machine.joints, (), (
        Point('start', 'ground', (-1.0, 0.2)), Point('roll', 'hull', (0.2, 0.3)),
        Point('wheel', 'ground', (0.9, -0.6)), Point('end', 'hull', (-0.3, -0.4))))
    cable = Cable(('start', 'roll', 'wheel', 'end'), 100.0, 1.0, radii=radii)
    q = np.array([0.1, -0.2, 0.3])

    def length(q):
        simulation = simulated(machine, {'cable': cable}, q)
        return simulation.effect_readings('cable')['length']

    h = 1e-6
    gradient = np.array([(length(q + h * e) - length(q - h * e)) / (2.0 * h) for e in np.eye(3)])
    simulation = simulated(machine, {'cable': cable}, q)
    tension = simulation.effect_readings('cable')['tension']
    assert tension == pytest.approx(100.0 * (length(q) - 1.0))
    assert np.allclose(simulation.acceleration * [1.5, 1.25, 0.5], -tension * gradient, atol=1e-6)


def test_a_rope_over_one_pulley_is_tangents_and_an_arc():
    fixed = Mechanism('arc', flyer().bodies, flyer().joints, (), (
        Point('a', 'ground', (-0.5, 0.0)), Point('b', 'ground', (0.0, 0.3)),
        Point('c', 'hull', (0.0, 0.0))))
    simulation = simulated(fixed, {'rope': Cable(
        ('a', 'b', 'c'), 10.0, 0.0, radii=(0.0, -0.2, 0.0))}, [0.5, 0.0, 0.0])
    far = math.hypot(0.5, 0.3)
    tangent = math.sqrt(far ** 2 - 0.2 ** 2)
    rise = math.atan2(0.3, 0.5) + math.asin(0.2 / far)
    assert simulation.effect_readings('rope')['length'] == pytest.approx(
        2.0 * tangent + 2.0 * 0.2 * rise, abs=1e-13)


# A frame that the plane of the hoist lies in, in space.
TURN = rotation(orientation({'rpy': [0.4, -0.7, 1.1]}))


def in_space(vector):
    """Return a vector of the plane where that lies in space."""
    return tuple((np.array(TURN) @ (*vector, 0.0)).tolist())


def test_a_hoist_in_space_is_the_one_in_the_plane():
    flat, inertia = hoist(), (0.1, 0.1, 0.1)
    along = in_space((0.0, 1.0))
    machine = Mechanism('hoist', tuple(
        Body(body.name, body.mass, (0.0, 0.0, 0.0), inertia) for body in flat.bodies), tuple(
        Joint(joint.name, 'prismatic', 'ground', joint.child, in_space(joint.position), axis=along)
        for joint in flat.joints), (), tuple(
        Point(point.name, point.body, in_space(point.position)) for point in flat.points))
    line, down = rope(0.003, damping=0.1), Gravity(in_space((0.0, -9.81)))
    one, other = (simulated(mechanism, effects, [0.0, 0.02]) for mechanism, effects in (
        (flat, {'gravity': EARTH, 'rope': line}),
        (machine, {'gravity': down, 'rope': replace(line, axis=tuple(np.array(TURN)[:, 2]))})))
    for _ in range(3):
        np.testing.assert_allclose(other.position, one.position, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(other.acceleration, one.acceleration, rtol=1e-9, atol=1e-9)
        readings = other.effect_readings('rope')
        assert readings.pop('fleet_angle') < 1e-7
        assert readings == pytest.approx(one.effect_readings('rope'), rel=1e-9, abs=1e-9)
        for each in (one, other):
            each.step(duration=0.05)


def free(points, cable, place, turn):
    """Return a free body that a cable holds to another one, which turns about a hinge."""
    bodies = Body('hull', 1.5, (0.0, 0.0, 0.0), (0.2, 0.3, 0.4)), Body(
        'jib', 2.0, (0.0, 0.0, 0.0), (0.5, 0.6, 0.7))
    joints = (Joint('free', 'free', 'ground', 'hull', (0.0, 0.0, 0.0)),
              Joint('tilt', 'spherical', 'ground', 'jib', (0.0, 0.0, 0.0)))
    quaternion = orientation({'rpy': turn})
    return simulated(Mechanism('crane', bodies, joints, (), points), {'rope': cable},
                     (*place, *quaternion, *orientation({'rpy': turn[::-1]})), 9 * [0.0])


def test_the_force_in_space_is_the_gradient_of_the_length():
    # Out of the pulleys' plane, at all angles: the jib carries the axis.
    points = (Point('start', 'ground', (-1.0, 0.2, 0.1)), Point('roll', 'jib', (0.2, 0.9, -0.1)),
              Point('wheel', 'hull', (0.3, 0.2, -0.2)), Point('end', 'ground', (1.5, -1.2, 0.3)))
    cable = Cable(('start', 'roll', 'wheel', 'end'), 100.0, 1.0, radii=(0.0, -0.15, 0.1, 0.0),
                  axis=(0.1, -0.2, 1.0))
    place, turn = np.array([1.0, 0.4, 0.2]), np.array([0.1, -0.2, 0.15])
    simulation = free(points, cable, place, turn)
    readings = simulation.effect_readings('rope')
    assert readings['fleet_angle'] > 0.05
    assert readings['tension'] == pytest.approx(100.0 * (readings['length'] - 1.0))
    known, q, h = simulation.coordinates, simulation.position, 1e-6

    def length(change):
        simulation.set_state(known.moved(q, change), np.zeros(known.nv))
        return simulation.effect_readings('rope')['length']

    gradient = np.array([(length(h * e) - length(-h * e)) / (2.0 * h) for e in np.eye(known.nv)])
    simulation.set_state(q, np.zeros(known.nv))
    force = simulation.inertia @ simulation.acceleration
    np.testing.assert_allclose(force, -readings['tension'] * gradient, atol=2e-6)
    assert abs(gradient).min() > 1e-3
    # And its rate is that of the length, which the damping goes with.
    rates = np.linspace(-0.5, 0.5, known.nv)
    simulation.set_effect('rope', damping=0.2)
    simulation.set_state(q, rates)
    tension = simulation.effect_readings('rope')['tension']
    assert tension == pytest.approx(
        readings['tension'] * (1.0 + 0.2 * float(gradient @ rates)), rel=1e-6)


@pytest.mark.parametrize('integrator', ['auto', 'rk4'])
@pytest.mark.parametrize('speed', [4.0, -4.0])
@pytest.mark.parametrize('free_length', [0.5, 9.0])
def test_a_cable_that_would_leap_by_a_turn_names_itself_and_its_pulley(
        speed, integrator, free_length):
    arm = Mechanism('arm', (Body('arm', 2.0, (0.5, 0.0), 0.2),), (
        Joint('hinge', 'revolute', 'ground', 'arm', (0.0, 0.0)),), (), (
        Point('wall', 'ground', (0.0, -2.0)), Point('wheel', 'ground', (0.0, 0.0)),
        Point('tip', 'arm', (1.0, 0.0))))
    # Taut or slack, the length is that of a cable wound by up to 270 degrees.
    simulation = simulated(arm, {'rope': Cable(
        ('wall', 'wheel', 'tip'), 0.5, free_length, radii=(0.0, 0.1, 0.0))}, [2.0], [speed],
        integrator=integrator)
    (angle,) = simulation.windings().values()
    with pytest.raises(NumericalError, match='The cable rope is wound round the pulley at wheel'):
        simulation.step(duration=3.0)
    (last,) = simulation.windings().values()
    turned = simulation.position[0] - 2.0
    assert last - angle == pytest.approx(turned, abs=0.3)
    assert abs(last - (1.5 if speed > 0.0 else -0.5) * math.pi) < 0.2
    assert abs(simulation.energy_balance.residual) < 1e-6


def test_a_rope_with_a_wrong_sign_is_reported_at_the_start():
    scene = load_scene('rope_hoist')
    assert not Simulation(scene).data.start_notes()
    for radii in ((0.0, -0.1, -0.1, 0.0), (0.0, 0.1, 0.1, 0.0), (0.0, -0.1, 0.1, 0.0)):
        wrong = replace(scene, effects={
            **scene.effects, 'rope': replace(scene.effects['rope'], radii=radii)})
        note, = Simulation(wrong).data.start_notes()
        assert note.startswith('The cable rope starts 3.') and 'signs of radii' in note
    with pytest.warns(RuntimeWarning, match=r'stretched by 0.628 m, and pulls with 1.26e\+05 N'):
        Simulation.from_scene(replace(scene, effects={
            **scene.effects, 'rope': replace(scene.effects['rope'], free_length=3.0)}))
