# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Impacts are found in time: a ball that bounces on a spring, against its closed form."""

from dataclasses import replace
import math

from closedloop_dynamics import Body, Joint, load_scene, Mechanism, Point, Simulation
from closedloop_dynamics.effects.registry import BodyContact, Contact, EndStop, Gravity
import numpy as np
import pytest

from ..effects.machines import assert_balanced, simulated

BALL = Mechanism(
    'ball', (Body('ball', 1.0, (0.0, 0.0), 0.1),),
    (Joint('height', 'prismatic', 'ground', 'ball', (0.0, 0.0), math.pi / 2, True),), (),
    (Point('south', 'ball', (0.0, 0.0)), Point('floor', 'ground', (0.0, 0.0))))
G, START = 9.81, 0.5
# A gap that counts as closed [m], as in engine/contact_events.cpp.
CLOSED = 1e-11
EARTH = Gravity((0.0, -G))
FLOORS = {
    'contact': lambda k: Contact('south', (0.0, 0.0), k),
    'end_stop': lambda k: EndStop('height', k, lower=0.0, upper=10.0),
    'body_contact': lambda k: BodyContact('south', 'floor', 'line', k)}


def height(time, stiffness):
    """Return the height of a ball of 1 kg that fell on a spring without damping."""
    w, v = math.sqrt(stiffness), math.sqrt(2.0 * G * START)
    rise, touch = v / G, 2.0 * (math.pi - math.atan(v * w / G)) / w
    if time < rise:
        return START - 0.5 * G * time ** 2
    time = (time - rise) % (2.0 * rise + touch)
    if time < touch:
        return -G / w ** 2 * (1.0 - math.cos(w * time)) - v / w * math.sin(w * time)
    time -= touch
    return v * time - 0.5 * G * time ** 2


@pytest.mark.parametrize('stiffness', [1e4, 1e8])
@pytest.mark.parametrize('kind', FLOORS)
def test_the_default_method_finds_nine_impacts(kind, stiffness):
    simulation = simulated(BALL, {'gravity': EARTH, 'floor': FLOORS[kind](stiffness)}, [START],
                           integrator='auto')
    for _ in range(300):
        simulation.step(duration=0.01)
        # Three hundred times better than what is asked for: no corner within any step.
        assert simulation.position[0] == pytest.approx(
            height(simulation.time, stiffness), abs=3e-9)
    steps = simulation.stepping.run.steps
    # Without finding them it took four to seven times as many.
    assert steps.accepted + steps.rejected < 110
    assert_balanced(simulation, 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize('integrator, tolerance, error', [
    ('dopri5', 1e-9, 2e-7), ('dop853', 1e-8, 2e-8), ('rodas4', 1e-8, 1e-7)])
def test_every_method_with_error_control_finds_them(integrator, tolerance, error):
    simulation = simulated(BALL, {'gravity': EARTH, 'floor': FLOORS['contact'](1e4)}, [START],
                           integrator=integrator, tolerance=tolerance)
    simulation.step(duration=3.0)
    assert simulation.position[0] == pytest.approx(height(3.0, 1e4), abs=error)


def test_steps_end_where_contact_begins_and_ends():
    simulation = simulated(BALL, {'gravity': EARTH, 'floor': FLOORS['contact'](1e4)}, [START],
                           integrator='auto', step_size=2e-5)
    run = simulation.stepping.run
    ends = set()
    for _ in range(18000):
        simulation.step()
        ends.add(run.steps.reached)
    w, v = 100.0, math.sqrt(2.0 * G * START)
    fall, touch = v / G, 2.0 * (math.pi - math.atan(v * w / G)) / w
    for event in (fall, fall + touch):
        assert min(abs(end - event) for end in ends) < 1e-9


def test_a_ball_with_losses_comes_to_rest_and_stays():
    floor = BodyContact('south', 'floor', 'line', 1e5, restitution=0.3, impact_velocity=1.0)
    simulation = simulated(BALL, {'gravity': EARTH, 'floor': floor}, [START], integrator='auto')
    simulation.step(duration=3.0)
    assert simulation.position[0] == pytest.approx(-G / 1e5, abs=1e-6)
    assert np.array_equal(simulation.data.system.effects.contacts.mode, np.zeros(1))
    assert_balanced(simulation, 1e-7)


def test_a_graze_is_not_missed():
    # A ball thrown up against a ceiling that it dents by 0.2 um, within one long step.
    top = START + 2.0 ** 2 / (2.0 * G)
    ceiling = EndStop('height', 1e6, upper=top - 2e-7)
    simulation = simulated(BALL, {'gravity': EARTH, 'ceiling': ceiling}, [START], [2.0],
                           integrator='auto', step_size=0.1)
    simulation.step(duration=0.4)
    # It turns there a little earlier than it would have.
    free = START + 2.0 * 0.4 - 0.5 * G * 0.16
    assert simulation.position[0] < free - 100.0 * CLOSED
    assert_balanced(simulation, 1e-9)


@pytest.mark.parametrize('seed', range(12))
@pytest.mark.parametrize('depth', [-2e-6, 2e-6])
def test_a_corner_that_is_grazed_within_a_step_is_felt(seed, depth):
    """A ball on a level rail over a star, whose highest corner it meets, or just not."""
    rng = np.random.default_rng(seed)
    turns = np.sort(rng.uniform(0.0, 2.0 * np.pi, 7))
    radii = rng.uniform(0.5, 1.0, 7)
    x, y = radii * np.cos(turns), radii * np.sin(turns)
    rail = replace(BALL, joints=(replace(BALL.joints[0], angle=0.0),))
    star = BodyContact('south', 'floor', 'curve', 1e8, friction=0.3, interpolation='linear',
                       x=tuple(x), y=tuple(y - y.max() + depth))
    simulation = simulated(rail, {'star': star}, [-2.0], [1.0], integrator='auto', step_size=0.5)
    simulation.step(duration=4.0)
    assert (simulation.energy_balance.dissipated > 1e-9) == (depth > 0.0)
    assert_balanced(simulation, 1e-7)


def test_the_geneva_drive_indexes_its_wheel_ten_times():
    start = load_scene('geneva_drive')
    heavy = replace(start.mechanism, bodies=tuple(
        replace(body, inertia=1e4 * body.inertia) if body.name == 'driver' else body
        for body in start.mechanism.bodies))
    simulation = Simulation(replace(start, mechanism=heavy))
    for turn in range(1, 11):
        simulation.step(duration=1.0)
        # The slots are 0.02 mm wider on either side.
        assert simulation.position[1] == pytest.approx(
            0.25 * math.pi - 0.5 * math.pi * turn, abs=2e-3)
    assert_balanced(simulation, 1e-5)
