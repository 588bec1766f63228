# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Balls on planes, spheres and cylinders: forces, rolling, impacts, balance."""

from closedloop_dynamics import Body, Joint, Mechanism, Point
from closedloop_dynamics.effects.registry import BodyContact, Contact, Gravity
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.mechanism import GROUND
import numpy as np
import pytest

from .machines import assert_balanced, flyer, simulated
from .test_space import assert_moves, drawn
from ..reference.compare import assert_agree

EARTH = Gravity((0.0, 0.0, -9.81))
MASS, RADIUS = 0.8, 0.05


def balls(*names):
    """Return solid balls that move freely, with their centres named, and a point of the ground."""
    inertia = 3 * (0.4 * MASS * RADIUS * RADIUS,)
    return Mechanism(
        'balls', tuple(Body(name, MASS, (0.0, 0.0, 0.0), inertia) for name in names),
        tuple(Joint(f'of_{name}', 'free', GROUND, name, (0.0, 0.0, 0.0)) for name in names), (),
        (*(Point(f'in_{name}', name, (0.0, 0.0, 0.0)) for name in names),
         Point('floor', GROUND, (0.3, -0.1, 0.2))))


def at(*places):
    """Return coordinates of bodies that are not turned."""
    return np.concatenate([(*place, 0.0, 0.0, 0.0, 1.0) for place in places])


def nearest(shape, direction, center, other):
    """Return the direction towards a ball's centre, and its distance from an axis or centre."""
    way = center - other
    if shape == 'plane':
        return direction, way @ direction
    if shape == 'cylinder':
        way = way - (way @ direction) * direction
    return way / np.linalg.norm(way), np.linalg.norm(way)


@pytest.mark.parametrize('shape', ['plane', 'sphere', 'cylinder', 'hollow sphere'])
@pytest.mark.parametrize('seed', [301, 302, 303])
def test_bodies_push_each_other_as_in_maximal_coordinates(seed, shape):
    rng, mechanism, q, qd, bodies, points, motions = drawn(seed)
    assert bodies[0] != bodies[1]
    own = rng.normal(size=3)
    own /= np.linalg.norm(own)
    kind, hollow, depth = shape.split()[-1], 'hollow' in shape, 0.02
    (arm_a, a, _), (arm_b, b, _) = points[:2]
    # Where the ball is, is the free side.
    own *= np.sign(motions[bodies[1]].axes @ own @ (a - b))
    normal, distance = nearest(kind, motions[bodies[1]].axes @ own, a, b)
    keys = {'plane': {'normal': tuple(own)}, 'cylinder': {'axis': tuple(own)}}.get(kind, {})
    if kind == 'plane':
        radius = distance + depth
    elif hollow:
        normal, radius = -normal, 0.3
        keys.update(other_radius=distance + radius - depth, hollow=True)
    else:
        radius = 0.5 * distance
        keys['other_radius'] = distance - radius + depth
    place = a - radius * normal
    slide = sum(sign * (motions[body].velocity + np.cross(
        motions[body].spin, place - motions[body].origin))
        for sign, body in ((1.0, bodies[0]), (-1.0, bodies[1])))
    rate = -slide @ normal
    slide = slide + rate * normal
    pressed = 500.0 * depth ** 1.5 * max(0.0, 1.0 + 0.1 * rate)
    speed = np.linalg.norm(slide)
    force = pressed * normal - 0.4 * pressed * slide / np.hypot(speed, 0.2)
    table = assert_moves(mechanism, q, qd, {'touch': BodyContact(
        'p0', 'p1', kind, 500.0, radius=radius, exponent=1.5, damping=0.1, friction=0.4,
        slip_velocity=0.2, **keys)}, [
            (bodies[0], arm_a + place - a, force, 0.0),
            (bodies[1], arm_b + place - b, -force, 0.0)])
    assert_agree(table.output[0, 1:4], [
        depth, pressed, -0.4 * pressed * speed / np.hypot(speed, 0.2)], 1e-9)


def test_on_a_plane_of_the_ground_it_is_the_contact_of_a_point():
    law = {'exponent': 1.5, 'damping': 0.4, 'friction': 0.3, 'slip_velocity': 0.2}
    normal = (0.0, 0.6, 0.8)
    found = []
    for floor in (Contact('in_one', (0.3, -0.1, 0.2), 2e3, normal=normal, **law),
                  BodyContact('in_one', 'floor', 'plane', 2e3, normal=normal, **law)):
        one = simulated(balls('one'), {'gravity': EARTH, 'floor': floor}, at((0.0, 0.0, 0.5)),
                        [0.5, 0.0, 0.0, 1.0, -2.0, 0.5], step_size=5e-4)
        one.step(duration=0.3)
        found.append(np.concatenate((one.position, one.velocity)))
    assert np.allclose(*found, rtol=0.0, atol=1e-11)


def test_a_sliding_ball_comes_to_roll_at_five_sevenths_of_its_speed():
    one = simulated(balls('one'), {'gravity': EARTH, 'floor': BodyContact(
        'in_one', 'floor', 'plane', 1e5, radius=RADIUS, normal=(0.0, 0.0, 1.0), friction=0.3,
        slip_velocity=1e-3)}, at((0.0, 0.0, 0.2 + RADIUS - MASS * 9.81 / 1e5)),
        [2.0, 0.0, 0.0, 0.0, 0.0, 0.0], integrator='auto')
    one.step(duration=0.5)
    assert one.velocity[0] == pytest.approx(2.0 * 5.0 / 7.0, rel=1e-5)
    assert one.effect_readings('floor')['slip'] == pytest.approx(0.0, abs=1e-5)
    assert_balanced(one, 1e-6)


@pytest.mark.parametrize('keys', [
    {'shape': 'sphere', 'other_radius': 0.2},
    {'shape': 'cylinder', 'other_radius': 0.2, 'axis': (0.0, 1.0, 0.0)}])
def test_balls_that_meet_keep_their_momentum_and_the_restitution(keys):
    one = simulated(balls('one', 'two'), {'touch': BodyContact(
        'in_one', 'in_two', stiffness=1e5, radius=RADIUS, restitution=0.6, impact_velocity=3.0,
        **keys)}, at((0.0, 0.0, 0.3), (0.0, 0.0, 0.0)),
        [0.0, 0.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], integrator='auto')
    one.step(duration=0.1)
    upper, lower = one.velocity[2], one.velocity[8]
    assert upper + lower == pytest.approx(-1.0, abs=1e-9)
    assert upper - lower == pytest.approx(0.6 * 3.0, rel=1e-5)
    assert_balanced(one, 1e-7)


def test_a_ball_in_a_bowl_swings_like_a_pendulum():
    bowl, reach = 0.5, 1e-4
    one = simulated(balls('one'), {'gravity': EARTH, 'bowl': BodyContact(
        'in_one', 'floor', 'sphere', 1e7, radius=RADIUS, other_radius=bowl, hollow=True)},
        at((0.3 + reach, -0.1, 0.2 - bowl + RADIUS - MASS * 9.81 / 1e7)), np.zeros(6),
        integrator='auto', tolerance=1e-10)
    # Without friction it slides: a pendulum as long as the centre's way to the bowl's.
    period = 2.0 * np.pi * np.sqrt((bowl - RADIUS) / 9.81)
    one.step(duration=0.5 * period)
    assert one.position[0] - 0.3 == pytest.approx(-reach, rel=1e-3)


def test_shapes_of_the_plane_and_of_space_are_distinguished():
    with pytest.raises(FieldError, match='shape: expected plane or sphere or cylinder in space'):
        BodyContact('in_one', 'in_two', 'line', 1.0).fit(balls('one', 'two'))
    with pytest.raises(FieldError, match='shape: expected line or circle or curve or face in '
                                         'the plane'):
        BodyContact('ball', 'rim', 'sphere', 1.0, other_radius=1.0).fit(flyer())
