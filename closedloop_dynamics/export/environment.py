# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Environments of gymnasium, for reinforcement learning: many runs of one model side by side."""

from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np

from ..kinematics.driven import BranchEndError
from ..kinematics.state import State
from ..mechanism.extras import of_an_extra
from ..simulation.rollout_run import checked_quantities, STATE
from ..simulation.simulation import Simulation

with of_an_extra():
    from gymnasium import Env
    from gymnasium.error import ResetNeeded
    from gymnasium.spaces import Box
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

# Positions that are drawn for one reset, at most.
MOST_DRAWS = 100


class Transition(NamedTuple):
    """
    The result of one action, in n sub-environments at once.

    Attributes
    ----------
    before, after : State
        Batches of n; their times count from the reset.
    torque : ndarray, shape (n, number of actuated joints)
        [N m or N].
    readings : dict of str to ndarray, shape (n, ...)
        Quantities that were asked for, after it.

    """

    before: State
    torque: np.ndarray
    after: State
    readings: dict


class MechanismVectorEnv(VectorEnv):
    """
    Sub-environments that are runs of one model, all advanced by one rollout.

    Observations are joint coordinates, then rates, of dtype float64; actions are torques of the
    actuated joints, in their order, of dtype float32, each held for some steps. A sub-environment
    whose episode has ended is reset by the next step, whose action it ignores (the mode
    ``NEXT_STEP`` of gymnasium). One whose simulation fails, or misses its energy balance, is
    truncated, and ``infos['failure']`` says why; if it failed, it stays where it was, without a
    reward.

    Parameters
    ----------
    model : Model
        Of effects without states, clocks or delays of their own.
    num_envs : int
        How many there are.
    torque_limits : float, or mapping of str to float
        Largest torque or force of the actuated joints, of all or of each [N m or N].
    reward : callable
        Returns the rewards of a ``Transition``, shape (n,).
    terminated : callable, optional
        Likewise, whether the task has come to its end; never, when not given.
    start : mapping of str to (float, float), optional
        Between what a reset draws the coordinates of joints [rad or m], as many as there are
        degrees of freedom; the others follow from the loops on the branch of the scene's start,
        all at rest. The scene's start, when not given.
    steps : int
        Steps of the method for one action.
    horizon : int, optional
        Actions after which an episode is truncated.
    observed : sequence of str, optional
        Joints that are observed; all when not given.
    quantities : sequence of str
        Further fields of ``rollout.Rollout`` for ``Transition.readings``, such as ``'points'``.
    method : str, mapping or Method, optional
        As for ``Simulation``.
    threads : int, optional
        As for ``rollout``.

    Raises
    ------
    ValueError
        For arguments that make no sense, and where a state is more than positions and rates.

    Notes
    -----
    Sub-environment k with the seed s is the ``MechanismEnv`` with the seed s + k, bit for bit.

    """

    metadata = {'render_modes': [], 'autoreset_mode': AutoresetMode.NEXT_STEP}

    def __init__(self, model, num_envs, *, torque_limits, reward, terminated=None, start=None,
                 steps=10, horizon=None, observed=None, quantities=(), method=None, threads=None):
        super().__init__()
        self.num_envs = _count('num_envs', num_envs)
        self._model, self._simulation = model, Simulation(model, None, method)
        _require_plain(self._simulation)
        self._reward, self._terminated = reward, terminated
        self._steps = _count('steps', steps)
        self._horizon = math.inf if horizon is None else _count('horizon', horizon)
        self._period = self._steps * self._simulation.step_size
        self._quantities, self._threads = checked_quantities(quantities), threads
        self._start = None if start is None else _ranges(start)
        self._home = model.assemble()
        self._generators = None
        # Also refuses starts of other joints, or too few of them.
        self._states = State.stack([self._drawn(np_random(0)[0])] * self.num_envs)
        limits = _limits(torque_limits, model.actuated_joints)
        self._places = _observed(model.coordinates, observed)
        size = len(self._observations(self._home))
        self.single_action_space = Box(-limits, limits, dtype=np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._acted = np.zeros(self.num_envs, dtype=int)
        self._ended = np.zeros(self.num_envs, dtype=bool)

    @property
    def period(self):
        """Time from one action to the next [s]."""
        return self._period

    @property
    def observation_names(self):
        """Return what the columns of observations are, by joint: tuple of str."""
        names = self._model.coordinates
        return tuple(columns[place] for kind, places in zip(
            ('position', 'velocity'), self._places)
            for columns in [names.columns(kind)] for place in places)

    @property
    def states(self):
        """Where all sub-environments are, a ``State``."""
        return self._states

    def reset(self, *, seed=None, options=None):
        """
        Begin an episode in every sub-environment.

        Parameters
        ----------
        seed : int, or sequence of int or None, optional
            Of the first, with one more for each that follows, or of each. Where not given,
            positions are drawn on from where the generators are.
        options : dict, optional
            There are none.

        Returns
        -------
        observations : ndarray, shape (num_envs, size)
        infos : dict

        Raises
        ------
        ValueError
            For other seeds and options.
        AssemblyError
            Where no position that was drawn can be reached.

        """
        if options:
            raise ValueError(f'options: expected none, got {", ".join(map(str, options))}')
        n = self.num_envs
        seeds = [seed] * n if seed is None else (
            list(range(seed, seed + n)) if isinstance(seed, (int, np.integer)) else list(seed))
        if len(seeds) != n:
            raise ValueError(f'seed: expected {n} of them, got {len(seeds)}')
        if self._generators is None:
            self._generators = [None] * n
        self._generators = [
            np_random(None if one is None else int(one))[0] if was is None or one is not None
            else was for was, one in zip(self._generators, seeds)]
        self._begin(np.ones(n, dtype=bool))
        return self._observations(self._states), {}

    def step(self, actions):
        """
        Apply torques in every sub-environment.

        Parameters
        ----------
        actions : array_like, shape (num_envs, number of actuated joints)
            [N m or N], within their limits.

        Returns
        -------
        observations : ndarray, shape (num_envs, size)
        rewards : ndarray, shape (num_envs,)
        terminations, truncations : ndarray of bool, shape (num_envs,)
        infos : dict

        Raises
        ------
        ResetNeeded
            Before the first ``reset``.
        ValueError
            For actions beyond the limits, and rewards of another shape or that are not finite.

        """
        if self._generators is None:
            raise ResetNeeded('step: expected reset to be called before')
        torques = self._torques(actions)
        rewards, infos = np.zeros(self.num_envs), {}
        terminations, truncations = np.zeros((2, self.num_envs), dtype=bool)
        going = ~self._ended
        if self._ended.any():
            self._begin(self._ended)
        if going.any():
            moved, transition, failures = self._moved(np.flatnonzero(going), torques)
            if len(moved):
                rewards[moved] = _of_each('reward', self._reward, transition, 'fiu')
                if self._terminated is not None:
                    terminations[moved] = _of_each(
                        'terminated', self._terminated, transition, 'b')
                self._put(moved, transition.after)
            self._acted[going] += 1
            truncations[going] = self._acted[going] >= self._horizon
            for k, reason in failures.items():
                truncations[k] = True
                infos = self._add_info(infos, {'failure': reason}, k)
        self._ended = terminations | truncations
        return self._observations(self._states), rewards, terminations, truncations, infos

    def _torques(self, actions):
        """Return actions as torques, or refuse them."""
        torques = np.asarray(actions)
        space = self.action_space
        if torques.shape != space.shape or torques.dtype.kind not in 'fiu':
            raise ValueError(f'actions: expected numbers of shape {space.shape}, got shape '
                             f'{torques.shape} of {torques.dtype}')
        # A limit is the number of the space.
        beyond = ~(np.abs(torques.astype(np.float32)) <= space.high)
        if beyond.any():
            k, joint = np.argwhere(beyond)[0]
            raise ValueError(
                f'actions: expected at most {space.high[k, joint]:g} N m or N in '
                f'{self._model.actuated_joints[joint]}, got {torques[k, joint]:g} in '
                f'sub-environment {k}')
        return torques.astype(float)

    def _moved(self, going, torques):
        """Return which of some sub-environments moved, how, and why others failed, by number."""
        before, torque = self._states[going], torques[going]
        done = self._simulation.rollout(
            torque[:, np.newaxis], before.q, before.qd, steps=self._steps, every=self._steps,
            quantities=(*STATE, *self._quantities), threads=self._threads)
        q, qd = done.position[:, -1], done.velocity[:, -1]
        fine = np.isfinite(q).all(axis=1)
        before = before[fine]
        after = State(before.time + self._period, q[fine], qd[fine], before.own,
                      before.coordinates)
        return going[fine], Transition(before, torque[fine], after, {
            name: getattr(done, name)[fine, -1] for name in self._quantities}), {
                int(going[place]): reason for place, reason in done.failures.items()}

    def _begin(self, some):
        """Put some sub-environments where an episode begins."""
        self._put(some, State.stack([
            self._drawn(self._generators[k]) for k in np.flatnonzero(some)]))
        self._acted[some], self._ended[some] = 0, False

    def _put(self, some, states):
        """Put some sub-environments into states."""
        arrays = [np.array(getattr(self._states, name)) for name in ('time', 'q', 'qd', 'own')]
        for array, name in zip(arrays, ('time', 'q', 'qd', 'own')):
            array[some] = getattr(states, name)
        self._states = State(*arrays, states.coordinates)

    def _drawn(self, generator):
        """Return a state to begin in."""
        if self._start is None:
            return self._home
        for draw in range(MOST_DRAWS):
            place = {name: generator.uniform(*ends) for name, ends in self._start.items()}
            try:
                return self._model.solve(place, branch=self._home)
            except BranchEndError:
                if draw == MOST_DRAWS - 1:
                    raise

    def _observations(self, states):
        of_q, of_qd = self._places
        return np.concatenate((states.q[..., of_q], states.qd[..., of_qd]), axis=-1)


class MechanismEnv(Env):
    """
    A run of a model as an environment: ``MechanismVectorEnv`` of one, without its axis.

    Parameters
    ----------
    model : Model
        As for ``MechanismVectorEnv``, as are the others.
    **settings
        ``torque_limits``, ``reward``, ...; functions get transitions of a batch of one.

    """

    metadata = {'render_modes': []}

    def __init__(self, model, **settings):
        self._one = MechanismVectorEnv(model, 1, **settings)
        self.action_space = self._one.single_action_space
        self.observation_space = self._one.single_observation_space

    @property
    def period(self):
        """Time from one action to the next [s]."""
        return self._one.period

    @property
    def observation_names(self):
        """Return what the numbers of observations are, by joint: tuple of str."""
        return self._one.observation_names

    @property
    def state(self):
        """Where the run is, a ``State``."""
        return self._one.states[0]

    def reset(self, *, seed=None, options=None):
        """Begin an episode; as ``gymnasium.Env.reset``."""
        super().reset(seed=seed)
        self._one._generators = [self.np_random]
        observations, infos = self._one.reset(options=options)
        return observations[0], infos

    def step(self, action):
        """
        Apply torques; as ``gymnasium.Env.step``.

        Raises
        ------
        ResetNeeded
            Before the first ``reset``, and after the end of an episode.
        ValueError
            As ``MechanismVectorEnv.step`` does.

        """
        if self._one._ended[0]:
            raise ResetNeeded('step: expected reset to be called after the end of an episode')
        observations, rewards, terminations, truncations, infos = self._one.step(
            np.asarray(action)[np.newaxis])
        return (observations[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]),
                {name: infos[name][0] for name in infos if not name.startswith('_')})


def _require_plain(simulation):
    """Refuse scenes of which positions and rates alone do not show how they go on."""
    effects = simulation.data.effect_set
    reasons = [reason for there, reason in (
        (len(effects.own), 'effects with states or clocks of their own'),
        (effects.delays, 'commands that arrive late'),
        (simulation.mechanism.motions, 'prescribed motions')) if there]
    if reasons:
        raise ValueError(f'model: expected one whose positions and rates show how it goes on, got '
                         f'one with {", ".join(reasons)}; effects: '
                         f'{", ".join(simulation.effects)}')


def _count(name, value):
    """Return a whole number above zero."""
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < 1:
        raise ValueError(f'{name}: expected a whole number > 0, got {value!r}')
    return int(value)


def _ranges(start):
    """Return the ranges from which coordinates are drawn."""
    found = {}
    for name, ends in start.items():
        low, high = np.array(ends, dtype=float) if np.shape(ends) == (2,) else (1.0, 0.0)
        if not (np.isfinite([low, high]).all() and low <= high):
            raise ValueError(f'start: {name}: expected two finite numbers, the lower one first, '
                             f'got {ends!r}')
        found[name] = float(low), float(high)
    return found


def _limits(given, joints):
    """Return the largest torques of the actuated joints."""
    if not joints:
        raise ValueError('model: expected actuated joints, got none')
    if not isinstance(given, Mapping):
        given = dict.fromkeys(joints, given)
    if set(given) != set(joints):
        raise ValueError(f'torque_limits: expected {", ".join(joints)}, got {", ".join(given)}')
    limits = np.array([given[name] for name in joints], dtype=np.float32)
    if not (np.isfinite(limits) & (limits > 0.0)).all():
        raise ValueError(f'torque_limits: expected finite numbers > 0, got {dict(given)}')
    return limits


def _observed(coordinates, names):
    """Return the places of the observations, among coordinates and among rates."""
    if names is None:
        return np.arange(coordinates.nq), np.arange(coordinates.nv)
    for name in names:
        if name not in coordinates.rates:
            raise ValueError(f'observed: expected names of {", ".join(coordinates.rates)}, got '
                             f'{name!r}')
    return tuple(np.concatenate([np.arange(size)[places[name]] for name in names] or [[]]).astype(
        int) for size, places in ((coordinates.nq, coordinates.coordinates),
                                  (coordinates.nv, coordinates.rates)))


def _of_each(name, function, transition, kinds):
    """Return the values of a user's function for each sub-environment."""
    n, found = len(transition.torque), np.asarray(function(transition))
    if found.shape != (n,) or found.dtype.kind not in kinds or not np.isfinite(found).all():
        what = 'truth values' if kinds == 'b' else 'finite numbers'
        raise ValueError(f'{name}: expected {what} of shape ({n},), got {found!r}')
    return found
