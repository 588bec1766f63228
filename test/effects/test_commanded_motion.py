# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Motions that are commanded while they run: profiles, forces, work, refusals."""

import math

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.effects.registry import Gravity, PrescribedMotion
from closedloop_dynamics.mechanism.errors import MotionError
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.scene.text import read_scene_text, scene_text
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated

JOINT = PrescribedMotion('commanded', joint='slide', ends='moving')


@pytest.fixture
def sliding():
    """Return a block of 2 kg whose slide is commanded, at 0.1 s."""
    simulation = simulated(block(2.0), {'drive': JOINT}, [0.3])
    simulation.step(duration=0.1)
    return simulation


def test_it_rests_until_it_is_commanded(sliding):
    assert sliding.data.commanded_motions == ('slide',)
    assert sliding.position[0] == 0.3
    assert sliding.motion_forces['drive'] == 0.0


@pytest.mark.parametrize('degree', [3, 5])
def test_polynomials_through_points_are_met(sliding, degree):
    # A polynomial of the degree that the points allow is itself the profile.
    rng = np.random.default_rng(degree)
    wanted = np.polynomial.Polynomial(rng.uniform(-1.0, 1.0, degree + 1))
    wanted -= wanted(0.0) - 0.3
    wanted -= np.polynomial.Polynomial([0.0, wanted.deriv()(0.0)])
    if degree == 5:
        wanted -= np.polynomial.Polynomial([0.0, 0.0, 0.5 * wanted.deriv(2)(0.0)])
    since = np.array([0.15, 0.4, 0.7])
    points = [wanted.deriv(k)(since) if k else wanted(since) for k in range((degree + 1) // 2)]
    sliding.command_motion({'slide': (0.1 + since, *points)})
    for _ in range(7):
        time = sliding.time - 0.1
        assert sliding.position[0] == pytest.approx(wanted(time), abs=1e-12)
        assert sliding.velocity[0] == pytest.approx(wanted.deriv()(time), abs=1e-11)
        assert sliding.motion_forces['drive'] == pytest.approx(
            2.0 * wanted.deriv(2)(time), abs=1e-9)
        sliding.step(duration=0.1)
    sliding.step(duration=0.1)
    # Beyond its end it goes on as fast.
    assert sliding.velocity[0] == pytest.approx(wanted.deriv()(0.7), abs=1e-12)
    assert sliding.motion_forces['drive'] == pytest.approx(0.0, abs=1e-9)
    rate = sliding.velocity[0]
    assert sliding.effect_readings('drive')['work'] == pytest.approx(rate ** 2, abs=1e-9)
    assert_balanced(sliding, 1e-9)


def test_another_profile_begins_where_the_one_before_is(sliding):
    sliding.command_motion({'slide': ([0.6], [1.0])})
    sliding.step(duration=0.2)
    before = sliding.position[0], sliding.velocity[0]
    sliding.command_motion({'slide': ([0.5, 0.9], [0.2, 0.6])})
    assert (sliding.position[0], sliding.velocity[0]) == before
    sliding.step(duration=0.2)
    assert sliding.position[0] == pytest.approx(0.2, abs=1e-12)
    sliding.step(duration=0.6)
    assert (sliding.position[0], sliding.velocity[0]) == pytest.approx((0.6, 0.0), abs=1e-12)
    assert_balanced(sliding, 1e-9)
    sliding.reset()
    sliding.step(duration=0.2)
    assert sliding.position[0] == 0.3


@pytest.mark.parametrize('name, profile, match', [
    ('slide', ([0.05], [0.4]), 'from now on, which is 0.1 s'),
    ('slide', ([0.1], [0.4]), 'present position, 0.3, got a jump to 0.4'),
    ('slide', ([0.1, 0.2], [0.3, 0.4], [0.1, 0.0]), 'present rate, 0, got a jump to 0.1'),
    ('slide', ([0.3, 0.2], [0.4, 0.5]), 'grow'),
    ('slide', ([0.3, 0.3], [0.4, 0.5], [0.0, 0.0]), 'growing'),
    ('slide', ([math.nan], [0.4]), 'finite'),
    ('slide', ([0.2], [math.inf]), 'finite'),
    ('slide', ([0.2], [0.4], [math.nan]), 'finite'),
    ('slide', ([0.2], [0.4, 0.5]), 'numbers'),
    ('slide', ([], []), 'numbers'),
    ('slide', ([0.2], [0.4], None, [0.0]), 'only beside rates'),
    ('slide', ([0.2], [1e9]), 'a rate of at most'),
    ('slide', ([0.2], [1e308], [1e308]), 'beyond all bounds|a rate of at most'),
    ('slide', (np.linspace(0.2, 1.0, 201), np.zeros(201)), 'at most 200 points'),
    ('slyde', ([0.2], [0.4]), 'did you mean|one of the joints')])
def test_what_cannot_be_followed_is_refused_and_changes_nothing(sliding, name, profile, match):
    state, effects = sliding.state, sliding.effects
    with pytest.raises(FieldError, match=match):
        sliding.command_motion({name: profile})
    # Not even what could be followed.
    with pytest.raises(FieldError):
        sliding.command_motion({'slide': ([0.2], [0.4]), 'slyde': ([0.2], [0.4])})
    assert np.array_equal(sliding.state, state)
    assert sliding.effects == effects


def test_a_profile_that_must_end_at_rest_does():
    simulation = simulated(block(), {'drive': PrescribedMotion(
        'commanded', joint='slide', room=2)}, [0.0])
    with pytest.raises(FieldError, match='rest at the end'):
        simulation.command_motion({'slide': ([0.2], [0.4], [1.0])})
    with pytest.raises(FieldError, match='at most 2 points'):
        simulation.command_motion({'slide': ([0.2, 0.3, 0.4], [0.4, 0.4, 0.4])})
    simulation.command_motion({'slide': ([0.2, 0.3], [0.4, 0.4])})
    simulation.step(duration=0.5)
    assert simulation.position[0] == pytest.approx(0.4, abs=1e-13)


def test_a_point_is_commanded_by_the_name_of_its_effect():
    # The rail moves along x alone.
    drive = PrescribedMotion('commanded', point='ball', direction=(3.0, 4.0))
    simulation = simulated(flyer(), {'drive': drive, 'gravity': Gravity((0.0, -9.81))},
                           [0.1, 0.0, 0.3])
    assert simulation.data.commanded_motions == ('drive',)
    along = np.array([0.6, 0.8])
    start = along @ simulation.point('ball')
    simulation.command_motion({'drive': ([0.4], [start + 0.2])})
    simulation.step(duration=0.3)
    s = 0.75
    assert along @ simulation.point('ball') == pytest.approx(
        start + 0.2 * s * s * (3.0 - 2.0 * s), abs=1e-12)
    inverse = along @ np.diag([1.0 / 1.5, 1.0 / 1.25]) @ along
    assert simulation.motion_forces['drive'] == pytest.approx(
        (0.2 * (6.0 - 12.0 * s) / 0.16 + 0.8 * 9.81) / inverse, rel=1e-9)
    assert_balanced(simulation, 1e-10)


@pytest.mark.slow
def test_loops_in_space_follow_and_end_where_they_cannot():
    # Beyond what the scene's crank can do, commanded while it runs.
    simulation = Simulation.from_scene('rssr_four_bar', {
        'rocker': PrescribedMotion('commanded', joint='rocker')}, integrator='rk4')
    place = simulation.joint_names.index('rocker')
    start = simulation.position[place]
    simulation.command_motion({'rocker': ([0.5], [start + 0.05])})
    simulation.step(duration=0.5)
    assert simulation.position[place] == pytest.approx(start + 0.05, abs=1e-11)
    assert abs(simulation.energy_balance.residual) < 1e-9
    simulation.command_motion({'rocker': ([1.5], [start + 10.0])})
    with pytest.raises(MotionError, match='leads beyond a limit'):
        simulation.step(duration=1.0)


def test_a_scene_tells_what_was_commanded(sliding):
    sliding.command_motion({'slide': ([0.6], [1.0])})
    scene = load_scene('four_bar')
    again, _ = read_scene_text(scene_text(scene, {
        'drive': PrescribedMotion('commanded', joint='crank_joint', **{
            key: getattr(sliding.effects['drive'], key)
            for key in ('times', 'values', 'rates', 'ends')})}, []))
    assert again.effects['drive'].rates == sliding.effects['drive'].rates
