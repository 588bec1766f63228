# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What ``--vary`` understands, and the samples that follow from it."""

from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.sweep.plan import Grid, parse, Plan, Random, variation
import numpy as np
import pytest

MASS, LENGTH = 'mechanism.bodies.crank.mass', 'mechanism.joints.coupler_joint.position.0'


@pytest.mark.parametrize('text, expected', [
    ('a.b=1:5:3', Grid('a.b', (1.0, 3.0, 5.0))), ('a.b=1:5:1', Grid('a.b', (1.0,))),
    ('a.b=-1e-3,2,.5', Grid('a.b', (-1e-3, 2.0, 0.5))), ('a.b = 7', Grid('a.b', (7.0,))),
    ('a.b=uniform:-1:2', Random('a.b', 'uniform', -1.0, 2.0)),
    ('a.b=normal:4:0', Random('a.b', 'normal', 4.0, 0.0)),
    ('a.b=loguniform:1e-3:1', Random('a.b', 'loguniform', 1e-3, 1.0))])
def test_every_form_is_understood(text, expected):
    assert parse(text) == expected


@pytest.mark.parametrize('text, words', [
    ('a.b', ['KEY=VALUES', "'a.b'"]), ('=3', ['KEY=VALUES']), ('a.b=', ['a.b', 'finite numbers']),
    ('a.b=1:2', ['a.b', 'FROM:TO:COUNT', "'1:2'"]), ('a.b=1:2:0', ['COUNT', "'0'"]),
    ('a.b=1:2:2.5', ['whole COUNT', "'2.5'"]), ('a.b=1:x:3', ["'x'"]),
    ('a.b=1,,2', ["'' in '1,,2'"]), ('a.b=nan', ['finite', 'nan']),
    ('a.b=unifrom:1:2', ["did you mean 'uniform'?"]), ('a.b=normal:1', ['normal:MEAN:DEVIATION']),
    ('a.b=normal:1:-2', ['DEVIATION', '-2']), ('a.b=uniform:2:1', ['FROM no larger than TO']),
    ('a.b=loguniform:0:1', ['larger than zero'])])
def test_wrong_syntax_is_refused_by_name(text, words):
    with pytest.raises(FieldError) as error:
        parse(text)
    for word in words:
        assert word in str(error.value)


def plan(*variations, **options):
    return Plan(load_scene('four_bar'), tuple(variations), **options)


def test_grids_are_combined_and_draws_repeated_at_each_point():
    one = plan(Grid(MASS, (1.0, 2.0)), Random(LENGTH, 'uniform', 0.1, 0.2),
               Grid('torque.crank_joint', (0.0, 5.0, 7.0)), draws=4, seed=3)
    assert one.samples == 24
    values = one.values(range(24))
    assert values.shape == (24, 3)
    np.testing.assert_array_equal(values[::4, 0], [1, 1, 1, 2, 2, 2])
    np.testing.assert_array_equal(values[::4, 2], [0, 5, 7, 0, 5, 7])
    np.testing.assert_array_equal(values[:4, 1], values[20:, 1])
    assert len(set(values[:4, 1])) == 4
    np.testing.assert_array_equal(one.values([17, 3]), values[[17, 3]])


def test_draws_follow_from_seed_and_key_alone():
    mass = Random(MASS, 'normal', 1.0, 0.1)
    alone = plan(mass, draws=50, seed=1).values(range(50))
    beside = plan(Random(LENGTH, 'uniform', 0.1, 0.2), mass, draws=50, seed=1).values(range(50))
    np.testing.assert_array_equal(alone[:, 0], beside[:, 1])
    assert not np.array_equal(alone, plan(mass, draws=50, seed=2).values(range(50)))


@pytest.mark.parametrize('name, first, second, mean, deviation', [
    ('normal', 3.0, 0.5, 3.0, 0.5), ('uniform', 1.0, 5.0, 3.0, 4.0 / 12 ** 0.5)])
def test_distributions_have_their_moments(name, first, second, mean, deviation):
    draws = Random('key', name, first, second).draws(20_000, 0)
    assert abs(draws.mean() - mean) < 0.03 and abs(draws.std() - deviation) < 0.03
    if name == 'uniform':
        assert first <= draws.min() and draws.max() < second


def test_the_logarithm_is_uniform():
    draws = np.log10(Random('key', 'loguniform', 1e-4, 1.0).draws(20_000, 0))
    assert abs(draws.mean() + 2.0) < 0.05 and draws.min() >= -4.0 and draws.max() <= 0.0


@pytest.mark.parametrize('variations, options, words', [
    ([Grid('mechanism.bodies.crnk.mass', (1.0,))], {}, ["did you mean 'crank'?"]),
    ([Grid(MASS, (1.0,)), Grid(MASS, (2.0,))], {}, [MASS, 'once']),
    ([Grid(MASS, (1.0,))], {'draws': 5}, ['samples', 'distribution']),
    ([Grid('torque.crank', (1.0,))], {}, ['torque.crank', "did you mean 'crank_joint'?"]),
    ([], {'duration': 0.015}, ['duration', 'multiple', '0.01']),
    ([], {'rate': 0.0}, ['rate', '> 0']), ([], {'seed': -1}, ['seed']),
    ([], {'keep': ['speed']}, ['quantities[0]', 'speed']),
    ([], {'torques': np.zeros((3, 4, 1))}, ['torques', '(3, 4, 1)']),
    ([], {'torques': np.zeros((7, 1))}, ['torques', 'instants (200)', '7']),
    ([Grid('torque.crank_joint', (1.0,))], {'torques': np.zeros((2, 1))}, ['constant torques'])])
def test_a_plan_that_cannot_be_run_is_refused(variations, options, words):
    with pytest.raises(FieldError) as error:
        plan(*variations, **options)
    for word in words:
        assert word in str(error.value)


def test_torques_may_change_slower_or_faster_than_instants_are_kept():
    slow = plan(duration=0.1, rate=100.0, torques=np.zeros((5, 1))).schedule
    assert (slow.interval, slow.intervals) == (0.01, 10)
    assert (slow.zero_order_hold, slow.decimation) == (2, 1)
    fast = plan(duration=0.1, rate=100.0, torques=np.zeros((50, 1))).schedule
    assert (fast.interval, fast.intervals) == (0.002, 50)
    assert (fast.zero_order_hold, fast.decimation) == (1, 5)


def test_values_are_numbers_of_the_plan_and_nothing_else():
    assert variation('a', [1, 2.5]) == Grid('a', (1.0, 2.5))
    with pytest.raises(FieldError):
        variation('a', [])
