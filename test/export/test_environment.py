# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Environments of gymnasium: the physics of simulations, and gymnasium's own checks."""

from pathlib import Path
import runpy

from closedloop_dynamics import Model, Simulation
import numpy as np
import pytest

gymnasium = pytest.importorskip('gymnasium', reason='the extra gymnasium is not installed')
environment = pytest.importorskip('closedloop_dynamics.export.environment')

ROOT = Path(__file__).resolve().parents[2]


def slowness(transition):
    """Return a reward."""
    return -(transition.after.qd ** 2).sum(axis=1)


@pytest.fixture(scope='module')
def model():
    return Model.from_scene('three_rrr')


def settings(model, **others):
    home = model.assemble()
    return {'torque_limits': 4.0, 'reward': slowness, 'steps': 5, 'method': 'rk4', 'start': {
        name: (home.position[name] - 0.2, home.position[name] + 0.2)
        for name in model.actuated_joints}, **others}


def torques(count, seed=0):
    return np.random.default_rng(seed).uniform(-4.0, 4.0, (count, 3)).astype(np.float32)


@pytest.mark.parametrize('observed', (None, ('theta_7', 'theta_1')))
def test_observations_are_named(model, observed):
    single = environment.MechanismEnv(model, **settings(model, observed=observed))
    single.reset(seed=3)
    seen, *_ = single.step(torques(1)[0])
    names = observed or model.joint_names
    by_name = dict(zip(single.observation_names, seen))
    assert len(by_name) == len(seen) == 2 * len(names)
    for name in names:
        assert by_name[f'position.{name}'] == single.state.position[name]
        assert by_name[f'velocity.{name}'] == single.state.velocity[name]


def test_gymnasium_finds_nothing_wrong(model):
    from gymnasium.utils.env_checker import check_env
    gymnasium.register('closedloop/Reach-v0', lambda: environment.MechanismEnv(
        model, **settings(model, horizon=20)))
    try:
        env = gymnasium.make('closedloop/Reach-v0')
        with pytest.warns(UserWarning) as found:
            check_env(env.unwrapped)
    finally:
        del gymnasium.registry['closedloop/Reach-v0']
    # Torques have units, rates no bound.
    assert all(any(known in str(one.message) for known in (
        'normalized space', 'minimum value is -infinity', 'maximum value is infinity'))
        for one in found)


def test_sub_environments_are_the_single_ones_and_simulations(model):
    many = environment.MechanismVectorEnv(model, 5, **settings(model))
    single = environment.MechanismEnv(model, **settings(model))
    seen, _ = many.reset(seed=7)
    assert len({tuple(row) for row in seen}) == 5
    rows = [seen]
    for k in range(6):
        seen, rewards, *_ = many.step(torques(5, k))
        rows.append(seen)
    first, _ = single.reset(seed=10)
    np.testing.assert_array_equal(first, rows[0][3])
    simulation = Simulation(model, single.state, method='rk4')
    for k in range(6):
        now, reward, ended, late, info = single.step(torques(5, k)[3])
        np.testing.assert_array_equal(now, rows[k + 1][3])
        for _ in range(5):
            simulation.step(torques(5, k)[3].astype(float))
        np.testing.assert_allclose(
            now, np.concatenate((simulation.position, simulation.velocity)), rtol=0, atol=1e-12)
        assert (ended, late, info) == (False, False, {})
    assert reward == rewards[3] == -(now[7:] ** 2).sum()
    assert single.state.time == pytest.approx(6 * single.period) and single.period == 0.005
    assert many.observation_space.contains(seen)


def test_resets_close_the_loops_at_rest_where_the_drives_were_drawn(model):
    many = environment.MechanismVectorEnv(model, 40, **settings(model))
    seen, _ = many.reset(seed=1)
    home = model.assemble()
    assert model.evaluate(many.states).closure.max() < 1e-12
    assert not many.states.qd.any()
    for name in model.actuated_joints:
        moved = many.states.position[name] - home.position[name]
        assert np.abs(moved).max() <= 0.2 and moved.min() < -0.1 and moved.max() > 0.1
    again, _ = many.reset(seed=1)
    other, _ = many.reset()
    assert (again == seen).all() and (other != seen).any(axis=1).all()
    by_seeds, _ = many.reset(seed=[1] * 40)
    assert (by_seeds == seen[0]).all()


def test_episodes_end_and_begin_again_with_the_next_step(model):
    home = model.assemble()
    limit = home.position['theta_1'] + 0.1
    many = environment.MechanismVectorEnv(model, 8, **settings(
        model, horizon=4, terminated=lambda one: one.after.position['theta_1'] > limit))
    many.reset(seed=2)
    ends = np.zeros(8, dtype=int)
    was = np.zeros(8, dtype=bool)
    for k in range(12):
        seen, rewards, ended, late, _ = many.step(torques(8, k))
        times = many.states.time
        np.testing.assert_array_equal(times == 0.0, was)
        assert not rewards[was].any() and not (ended | late)[was].any()
        np.testing.assert_array_equal(late, np.isclose(times, 4 * many.period))
        np.testing.assert_array_equal(
            ended, (many.states.position['theta_1'] > limit) & ~was)
        was = ended | late
        ends += was
    assert (ends >= 2).all() and ends.max() > 2


def test_observations_and_readings_are_those_asked_for(model):
    kept = []

    def reward(transition):
        kept.append(transition)
        return transition.readings['energy']

    names = ('theta_6', 'theta_2')
    many = environment.MechanismVectorEnv(model, 4, **settings(
        model, observed=names, quantities=('energy', 'points'), reward=reward))
    many.reset(seed=0)
    seen, rewards, *_ = many.step(torques(4))
    found = model.evaluate(kept[0].after)
    np.testing.assert_allclose(rewards, found.energy, rtol=1e-9)
    np.testing.assert_allclose(kept[0].readings['points'], np.array(found.points), atol=1e-12)
    np.testing.assert_array_equal(seen, np.transpose(
        [many.states.position[name] for name in names]
        + [many.states.velocity[name] for name in names]))
    assert kept[0].torque.dtype == float and kept[0].before.q.shape == (4, 7)


def test_space_and_orientations():
    model = Model.from_scene('stewart_platform')
    many = environment.MechanismVectorEnv(model, 3, torque_limits=300.0, reward=slowness,
                                          method='rk4', steps=2)
    seen, _ = many.reset(seed=0)
    assert seen.shape == (3, model.coordinates.nq + model.coordinates.nv)
    many.step(np.zeros((3, 6), dtype=np.float32))
    assert model.evaluate(many.states).closure.max() < 1e-9


def test_a_failed_simulation_is_truncated_with_its_reason(model):
    # Beyond the torques of any drive.
    many = environment.MechanismVectorEnv(model, 3, **settings(model, torque_limits=1e7))
    seen, _ = many.reset(seed=0)
    strong = np.zeros((3, 3), dtype=np.float32)
    strong[1] = 1e7
    now, rewards, ended, late, infos = many.step(strong)
    assert late.tolist() == [False, True, False] and not ended.any()
    assert infos['_failure'].tolist() == late.tolist() and 'could not be closed' in (
        infos['failure'][1])
    np.testing.assert_array_equal(now[1], seen[1])
    assert rewards[1] == 0.0 and (rewards[[0, 2]] < 0.0).all()
    after, *_, infos = many.step(strong * 0)
    assert many.states.time[1] == 0.0 and (after[1] != seen[1]).any() and infos == {}


@pytest.mark.parametrize('name, reason', [
    ('carpet_scraper_dry', 'states or clocks of their own'),
    ('rack_press', 'states or clocks of their own')])
def test_states_that_do_not_tell_how_it_goes_on_are_refused(name, reason):
    with pytest.raises(ValueError, match=reason):
        environment.MechanismVectorEnv(Model.from_scene(name), 2, torque_limits=1.0,
                                       reward=slowness)


@pytest.mark.parametrize('wrong, message', [
    ({'num_envs': 0}, 'num_envs: expected a whole number > 0, got 0'),
    ({'steps': 2.5}, 'steps: expected a whole number > 0, got 2.5'),
    ({'horizon': True}, 'horizon: expected a whole number'),
    ({'torque_limits': 0.0}, 'torque_limits: expected finite numbers > 0'),
    ({'torque_limits': {'theta_1': 1.0}}, 'torque_limits: expected theta_1, theta_6, theta_7'),
    ({'start': {'theta_1': (2.0, 1.0)}}, 'start: theta_1: expected two finite numbers'),
    ({'start': {'theta_1': (0.0, 1.0)}}, 'expected as many'),
    ({'start': {'theta': (0.0, 1.0)}}, 'theta_1'),
    ({'observed': ['elbow']}, "observed: expected names of theta_1, .*got 'elbow'"),
    ({'quantities': ['force']}, 'quantities'),
])
def test_arguments_that_make_no_sense_are_refused(model, wrong, message):
    given = settings(model, **{'num_envs': 2, **wrong})
    with pytest.raises((ValueError, KeyError), match=message):
        environment.MechanismVectorEnv(model, given.pop('num_envs'), **given)


def test_actions_rewards_and_calls_that_make_no_sense_are_refused(model):
    wanted = {'reward': slowness}
    many = environment.MechanismVectorEnv(model, 2, **settings(
        model, reward=lambda one: wanted['reward'](one)))
    with pytest.raises(gymnasium.error.ResetNeeded):
        many.step(torques(2))
    for seed in ([1], [1, 2, 3]):
        with pytest.raises(ValueError, match='seed: expected 2'):
            many.reset(seed=seed)
    with pytest.raises(ValueError, match='options: expected none, got low'):
        many.reset(options={'low': 0.0})
    many.reset(seed=0)
    for actions, message in (
            (torques(3), 'shape'), (torques(2) * np.nan, 'theta_1, got nan'),
            (torques(2) * 0 + [0, 0, 4.01], 'at most 4 N m or N in theta_7, got 4.01 in sub-')):
        with pytest.raises(ValueError, match=message):
            many.step(actions)
    # Zero to the digits of an action's type.
    many.step(np.full((2, 3), 4.0 + 1e-9))
    for wanted['reward'] in (lambda one: 0.0, lambda one: [np.nan, 0.0], lambda one: ['a', 'b']):
        with pytest.raises(ValueError, match=r'reward: expected finite numbers of shape \(2,\)'):
            many.step(torques(2))
    single = environment.MechanismEnv(model, **settings(model, horizon=1))
    single.reset(seed=0)
    assert single.step(torques(1)[0])[3]
    with pytest.raises(gymnasium.error.ResetNeeded, match='after the end'):
        single.step(torques(1)[0])


def test_the_example_learns():
    learn = runpy.run_path(str(ROOT / 'doc' / 'examples' / 'learn_to_reach.py'))['learn']
    policy, before, after = learn(4)
    assert policy.shape == (3, 7) and after[0] > 0.9 * before[0]
