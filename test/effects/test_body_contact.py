# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Contact between bodies: lift of a cam, impacts, momentum, curves."""

from dataclasses import replace
import math

from closedloop_dynamics import Body, Joint, load_scene, Mechanism, Point, Simulation
from closedloop_dynamics.effects import curve
from closedloop_dynamics.effects.body_contact import damping
from closedloop_dynamics.effects.registry import BodyContact, Contact, Gravity
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from .machines import assert_balanced, block, flyer, momenta, pair, simulated

EARTH = Gravity((0.0, -9.81))


def cam(base=0.04, lift=0.01):
    """Return a cam that turns about the world's origin, and a follower that slides along y."""
    return Mechanism(
        'cam', (Body('cam', 1.0, (0, 0), 0.1), Body('follower', 0.5, (0, 0), 0.1)),
        (Joint('turn', 'revolute', 'ground', 'cam', (0, 0), 0.0, True),
         Joint('slide', 'prismatic', 'ground', 'follower', (0, 0), math.pi / 2)), (),
        (Point('axle', 'cam', (0, 0)), Point('roller', 'follower', (0, 0))))


def two_at(one, other):
    """Return the state of ``pair`` from places and angles of its bodies."""
    return np.array([*one, *other], dtype=float)


def test_on_a_line_of_the_ground_it_is_the_contact_of_a_point():
    ground = flyer()
    machine = Mechanism('flyer', ground.bodies, ground.joints, (), (
        *ground.points, Point('floor', 'ground', (0.3, -0.1))))
    law = {'exponent': 1.5, 'damping': 0.4, 'friction': 0.3, 'slip_velocity': 0.2}
    found = []
    for floor in (Contact('rim', (0.3, -0.1), 2e3, angle=0.2, **law),
                  BodyContact('rim', 'floor', 'line', 2e3, angle=0.2, **law)):
        simulation = simulated(machine, {'gravity': EARTH, 'floor': floor}, [0.0, 0.2, 0.4],
                               [0.5, 0.0, 1.0], step_size=5e-4)
        simulation.step(duration=0.4)
        found.append(np.concatenate((simulation.position, simulation.velocity)))
    assert np.allclose(*found, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize('shape', [
    {'shape': 'line', 'angle': 0.2}, {'shape': 'circle', 'other_radius': 0.15},
    {'shape': 'curve', 'radii': (0.15, 0.2, 0.14, 0.16, 0.15, 0.17), 'friction': 0.4}])
def test_bodies_keep_their_momentum_and_the_balance_closes(shape):
    touch = BodyContact('front', 'rear', radius=0.05, stiffness=2e3, exponent=1.5, damping=0.3,
                        **shape)
    q = two_at((0.0, 0.05, 0.1), (0.72, 0.0, -0.2))
    simulation = simulated(pair(), {'touch': touch}, q, [1.0, 0.0, 0.5, -1.0, 0.1, -0.5],
                           step_size=2e-4)
    before, most = momenta(simulation), 0.0
    for _ in range(40):
        simulation.step(duration=0.01)
        most = max(most, simulation.effect_readings('touch')['normal_force'])
    assert most > 1.0
    assert np.allclose(momenta(simulation), before, atol=1e-9)
    assert_balanced(simulation, 1e-6)


def test_a_disc_in_a_ring_is_pushed_inwards():
    touch = BodyContact('front', 'rear', 'circle', 1e3, radius=0.1, other_radius=0.3, hollow=True)
    # 0.25 m from the ring's centre along x: 0.05 m too far.
    simulation = simulated(pair(), {'touch': touch}, two_at((0.0, 0.0, 0.0), (0.25, 0.0, 0.0)))
    assert simulation.effect_readings('touch')['depth'] == pytest.approx(0.05)
    assert simulation.acceleration[0] == pytest.approx(-50.0)
    assert simulation.acceleration[3] == pytest.approx(50.0)


@pytest.mark.parametrize('restitution', [0.95, 0.6, 0.2])
@pytest.mark.parametrize('exponent', [1.0, 1.5])
def test_restitution_is_what_was_asked_for(restitution, exponent):
    machine = Mechanism('drop', block(1.3, math.pi / 2).bodies, block(1.3, math.pi / 2).joints,
                        (), (Point('ball', 'block', (0, 0)), Point('floor', 'ground', (0, 0))))
    floor = BodyContact('ball', 'floor', 'line', 1e4, exponent=exponent,
                        restitution=restitution, impact_velocity=2.0)
    simulation = simulated(machine, {'floor': floor}, [0.01], [-2.0], step_size=2e-5)
    simulation.step(duration=0.2)
    assert simulation.velocity[0] == pytest.approx(2.0 * restitution, rel=2e-5)
    assert damping(restitution, 4.0) == pytest.approx(0.5 * damping(restitution, 2.0))


def test_an_eccentric_lifts_its_follower_by_its_closed_form():
    # A circle of radius 0.03 about a place 0.01 from the axle, as a curve of 90 points.
    machine, angles = cam(), 2.0 * np.pi * np.arange(90) / 90
    touch = BodyContact('roller', 'axle', 'curve', 1e7, radius=0.008,
                        x=tuple(0.01 + 0.03 * np.cos(angles)), y=tuple(0.03 * np.sin(angles)))
    for turn in np.linspace(0.0, 6.0, 13):
        height = 0.01 * math.sin(turn) + math.sqrt(
            0.038 ** 2 - (0.01 * math.cos(turn)) ** 2)
        simulation = simulated(machine, {'touch': touch}, [turn, height - 1e-5], step_size=1e-4)
        found = simulation.effect_readings('touch')
        tilt = (0.01 * math.cos(turn)) / 0.038
        assert found['depth'] == pytest.approx(1e-5 * math.sqrt(1.0 - tilt ** 2), abs=2e-8)


def flat_faced(turning=False):
    """Return ``cam`` with a face in the place of the roller, which may turn about its middle."""
    machine = cam()
    if not turning:
        return machine
    return replace(machine, bodies=(*machine.bodies, Body('plate', 0.2, (0.005, 0), 1e-4)),
                   joints=(*machine.joints, Joint('tilt', 'revolute', 'follower', 'plate', (0, 0),
                                                  -math.pi / 2)),
                   points=(machine.points[0], Point('roller', 'plate', (0.002, 0.001))))


# The face looks down: its free side is on the left of a line that points to the left. The axes of
# the follower are turned by a quarter.
FACE = {'shape': 'face', 'angle': math.pi / 2}


def test_a_flat_face_rests_on_the_support_function_of_an_ellipse():
    angles = 2.0 * np.pi * np.arange(360) / 360
    touch = BodyContact('roller', 'axle', stiffness=1e7, x=tuple(0.04 * np.cos(angles)),
                        y=tuple(0.03 * np.sin(angles)), **FACE)
    for turn in np.linspace(0.0, 6.0, 13):
        # Height and, by its derivative, the arm at which the face presses: s and s'.
        height = math.hypot(0.04 * math.sin(turn), 0.03 * math.cos(turn))
        arm = (0.04 ** 2 - 0.03 ** 2) * math.sin(turn) * math.cos(turn) / height
        simulation = simulated(flat_faced(), {'touch': touch}, [turn, height - 1e-5],
                               step_size=1e-4)
        assert simulation.effect_readings('touch')['depth'] == pytest.approx(1e-5, abs=2e-10)
        # 100 N lift the follower of 0.5 kg and turn the cam back.
        assert simulation.acceleration == pytest.approx([-100.0 * arm / 0.1, 200.0], rel=3e-5)


@pytest.mark.parametrize('turning', [False, True])
def test_an_eccentric_disc_is_a_roller_to_a_flat_face(turning):
    """Seen from the other side, a roller of the cam touches a line of the follower."""
    machine, angles = flat_faced(turning), 2.0 * np.pi * np.arange(720) / 720
    machine = replace(machine, points=(*machine.points, Point('middle', 'cam', (0.01, 0.002))))
    law = {'stiffness': 1e5, 'exponent': 1.5, 'damping': 0.3, 'friction': 0.2}
    line = math.pi if turning else math.pi / 2
    face = BodyContact('roller', 'middle', 'face', angle=line, x=tuple(0.03 * np.cos(angles)),
                       y=tuple(0.03 * np.sin(angles)), **law)
    disc = BodyContact('middle', 'roller', 'line', radius=0.03, angle=line, **law)
    states = []
    for touch in (face, disc):
        simulation = simulated(
            machine, {'gravity': EARTH, 'touch': touch}, [0.3, 0.045] + [0.05] * turning,
            [8.0, 0.0] + [0.0] * turning, step_size=2e-4)
        most = 0.0
        for _ in range(20):
            simulation.step(duration=0.005)
            most = max(most, simulation.effect_readings('touch')['normal_force'])
        states.append(np.concatenate((simulation.position, simulation.velocity)))
        assert most > 10.0
        assert_balanced(simulation, 1e-6)
    # The spline is within 1e-12 m of the circle: 1e-8 N, which turn the light plate by 1e-7 rad/s.
    assert np.allclose(*states, rtol=0.0, atol=1e-7)


def test_an_eccentric_is_an_expression_in_the_angle():
    # A circle of radius 0.03 about a place 0.01 from the axle.
    outline = '0.01*cos(a) + sqrt(0.03**2 - (0.01*sin(a))**2)'
    touch = BodyContact('roller', 'axle', 'curve', 1e7, radius=0.008, polar=outline)
    turn = 0.7
    height = 0.01 * math.sin(turn) + math.sqrt(0.038 ** 2 - (0.01 * math.cos(turn)) ** 2)
    found = simulated(cam(), {'touch': touch}, [turn, height - 1e-5], step_size=1e-4)
    tilt = (0.01 * math.cos(turn)) / 0.038
    assert found.effect_readings('touch')['depth'] == pytest.approx(
        1e-5 * math.sqrt(1.0 - tilt ** 2), abs=1e-9)


def test_a_roller_rides_on_the_curve_parallel_to_its_path():
    # Roller follower on the pitch curve's parallel: the roller's centre is at 0.05 + s(angle).
    angles = 2.0 * np.pi * np.arange(720) / 720
    radius = 0.05 + 0.005 * (1.0 - np.cos(2.0 * angles))
    slope = 0.01 * np.sin(2.0 * angles)
    x, y = radius * np.cos(angles), radius * np.sin(angles)
    along = np.array([slope * np.cos(angles) - y, slope * np.sin(angles) + x])
    along /= np.hypot(*along)
    # The cam's outline is the roller's radius within the path of its centre.
    touch = BodyContact('roller', 'axle', 'curve', 1e8, radius=0.01,
                        x=tuple(x - 0.01 * along[1]), y=tuple(y + 0.01 * along[0]))
    for turn in np.linspace(0.1, 6.2, 30):
        s = 0.05 + 0.005 * (1.0 - math.cos(2.0 * (math.pi / 2 - turn)))
        # Known by one that is 1 um too low.
        found = simulated(cam(), {'touch': touch}, [turn, s - 1e-6], step_size=1e-5)
        tilt = 0.01 * math.sin(2.0 * (math.pi / 2 - turn)) / s
        assert found.effect_readings('touch')['depth'] == pytest.approx(
            1e-6 / math.hypot(1.0, tilt), abs=2e-9)


def test_corners_of_an_outline_are_rounded_by_the_roller():
    square = BodyContact('front', 'rear', 'curve', 1e3, radius=0.1, interpolation='linear',
                         x=(0.2, -0.2, -0.2, 0.2), y=(0.2, 0.2, -0.2, -0.2))
    shift = 0.05
    place = (-0.2 + 0.2 + shift, 0.2 + shift)
    # The front of body a is 0.3 before its place.
    simulation = simulated(pair(), {'touch': square}, two_at(
        (place[0] - 0.3, place[1], 0.0), (0.0, 0.0, 0.0)))
    assert simulation.effect_readings('touch')['depth'] == pytest.approx(
        0.1 - math.hypot(shift, shift))
    force = 1e3 * (0.1 - math.hypot(shift, shift)) / math.sqrt(2.0)
    assert np.allclose(simulation.acceleration[:2], force, rtol=1e-10)


def test_a_figure_of_eight_is_refused_and_a_slot_is_not():
    t = 2.0 * np.pi * np.arange(40) / 40
    for interpolation in ('linear', 'cubic'):
        with pytest.raises(FieldError, match='does not cross itself'):
            curve.pieces(np.sin(t), np.sin(2.0 * t), True, interpolation, False)
    x, y = (0, 2, 2, 1.1, 1.1, 0.9, 0.9, 0), (0, 0, 2, 2, 1, 1, 2, 2)
    assert len(curve.pieces(x, y, True, 'linear', False)) == 8
    # Each side of a triangle has no others but its neighbours.
    assert len(curve.pieces((0, 1, 0), (0, 0, 1), True, 'linear', False)) == 3
    with pytest.raises(FieldError, match='does not cross itself'):
        curve.pieces((0, 1, 1, 0.5), (0, 0, 1, -1), False, 'linear', False)


def test_an_outline_that_jumps_after_a_turn_is_refused_with_the_jump():
    jump = 0.002 * 2.0 * math.pi
    with pytest.raises(FieldError, match=f'which jumps by {jump:.6g} m there, from '
                                         f'{0.03 + jump:.6g} to 0.03 m'):
        BodyContact('front', 'rear', 'curve', 1.0, polar='0.03 + 0.002*a')
    # Sines of 2 pi are rounded, which is not a jump.
    assert BodyContact('front', 'rear', 'curve', 1.0, polar='0.03 + 0.002*sin(3*a)**3')


def test_a_joint_with_clearance_is_that_of_an_independent_program():
    # The slider-crank of Flores and others (2008) without its wrist pin: a journal in a bearing.
    speed, crank, rod, clearance = 500.0, 0.05, 0.12, 5e-4
    mass, inertia, slider = 0.21, 2.5e-4, 0.14
    stiffness, restitution, impact = 6.61e10, 0.9, 0.5
    rate = -speed * (1.0 + crank / rod)
    scene = load_scene({
        'mechanism': {
            'name': 'clearance', 'bodies': {
                'crank': {'mass': 0.3, 'center_of_mass': [0.025, 0.0], 'inertia': 1e-4},
                'rod': {'mass': mass, 'center_of_mass': [rod / 2, 0.0], 'inertia': inertia},
                'slider': {'mass': slider, 'center_of_mass': [0.0, 0.0], 'inertia': 1e-5}},
            'joints': {
                'a': {'type': 'revolute', 'parent': 'ground', 'child': 'crank',
                      'position': [0.0, 0.0], 'actuated': True},
                'b': {'type': 'revolute', 'parent': 'crank', 'child': 'rod',
                      'position': [crank, 0.0]},
                'c': {'type': 'prismatic', 'parent': 'ground', 'child': 'slider',
                      'position': [0.0, 0.0]}},
            'points': {'journal': {'body': 'rod', 'position': [rod, 0.0]},
                       'bearing': {'body': 'slider', 'position': [0.0, 0.0]}}},
        'initial': {'position': {'a': 0.0, 'b': 0.0, 'c': crank + rod},
                    'velocity': {'a': speed, 'b': rate}, 'hold': ['a', 'b', 'c']},
        'effects': {
            'motor': {'type': 'prescribed_motion', 'joint': 'a', 'shape': 'expression',
                      'expression': f'{speed}*t'},
            'contact': {'type': 'body_contact', 'point': 'journal', 'radius': 0.0095,
                        'other': 'bearing', 'shape': 'circle', 'other_radius': 0.01,
                        'hollow': True, 'stiffness': stiffness, 'exponent': 1.5,
                        'restitution': restitution, 'impact_velocity': impact}}})
    lossy = damping(restitution, impact)

    def rates(time, state):
        """Return rates and accelerations of the rod's angle in the world and of the slider."""
        angle, place, turning, moving = state
        arm = crank * np.array([np.cos(speed * time), np.sin(speed * time)])
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        away = arm + rod * along - [place, 0.0]
        approach = speed * np.array([-arm[1], arm[0]]) + rod * turning * across - [moving, 0.0]
        distance, push = np.hypot(*away), np.zeros(2)
        if distance > clearance:
            push = -stiffness * (distance - clearance) ** 1.5 * max(
                0.0, 1.0 + lossy * (away @ approach) / distance) * away / distance
        moment = rod * across @ push + mass * rod / 2 * speed ** 2 * across @ arm
        return [turning, moving, moment / (inertia + mass * rod ** 2 / 4), -push[0] / slider]

    times = np.linspace(0.0, 0.012, 13)
    expected = solve_ivp(rates, (0.0, times[-1]), [0.0, crank + rod, speed + rate, 0.0],
                         method='DOP853', rtol=1e-11, atol=1e-13, max_step=1e-5,
                         t_eval=times).y[:2, 1:].T
    simulation, found, forces = Simulation.from_scene(scene, accuracy=1e-9), [], []
    for _ in times[1:]:
        simulation.step(duration=1e-3)
        found.append((simulation.position[0] + simulation.position[1], simulation.position[2]))
        forces.append(simulation.effect_readings('contact')['normal_force'])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    # It is lost and found again.
    assert min(forces) == 0.0 and max(forces) > 1000.0
    assert simulation.effect_readings('contact')['dissipated_energy'] > 0.1


def test_another_shape_takes_another_scene():
    """It obeys a law of other code, which is not compiled in a run."""
    simulation = Simulation.from_scene('geneva_drive')
    before = simulation.effects['outline']
    with pytest.raises(FieldError, match='outline.*the kind that it had when the scene was load'):
        simulation.set_effect(
            'outline', shape='line', x=None, y=None, closed=None, interpolation=None)
    assert simulation.effects['outline'] is before
    simulation.step(duration=0.01)
