# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Learn to lead the platform of the 3-RRR manipulator to a place and to hold it there.

The policy is linear: torques are a matrix times what is observed. Augmented random search (Mania,
Guy and Recht 2018, arXiv:1803.07055) tries both signs of random changes of the matrix, each in a
sub-environment of its own, and steps along the differences of their returns.

    python doc/examples/learn_to_reach.py [ITERATIONS]

100 iterations take about a minute on two cores. Needs the extra gymnasium.
"""

import sys

from closedloop_dynamics import Model
from closedloop_dynamics.export.environment import MechanismVectorEnv
import numpy as np

ASIDE = (0.03, 0.02)    # Of the goal, from where the platform's centre starts [m]
AROUND = 0.3            # Of the drives, how far from there an episode begins [rad]
LIMIT = 3.0             # Of the torques [N m]
USUAL_RATE = 3.0        # Of the drives [rad/s]
DIRECTIONS, BEST, STEP, NOISE = 32, 16, 0.3, 0.3


class Task:
    """Sub-environments of the manipulator, and how far each is from the goal."""

    def __init__(self, num_envs):
        """Build the environment; what is observed is centred where the platform is to be."""
        model = Model.from_scene('three_rrr_horizontal')
        home, driven = model.assemble(), model.actuated_joints
        self.point = [point.name for point in model.mechanism.points].index('platform_center')
        self.goal = model.evaluate(home).points['platform_center'] + ASIDE
        self.envs = MechanismVectorEnv(
            model, num_envs, torque_limits=LIMIT, reward=self.reward, steps=20, horizon=75,
            start={name: (home.position[name] - AROUND, home.position[name] + AROUND)
                   for name in driven}, observed=driven, quantities=('points',), method='rk4')
        self.centre = np.array([*(home.position[name] for name in driven), 0.0, 0.0, 0.0])
        self.usual = np.repeat([AROUND, USUAL_RATE], 3)

    def reward(self, transition):
        """Return minus the distance to the goal [m], and a little for speed."""
        self.distance = np.linalg.norm(
            transition.readings['points'][:, self.point] - self.goal, axis=1)
        return -self.distance - 0.002 * (transition.after.qd ** 2).sum(axis=1)

    def returns(self, policies, seeds):
        """Return what policies of shape (num_envs, 3, 7) earn in one episode each."""
        seen, _ = self.envs.reset(seed=seeds)
        total, over = np.zeros(len(policies)), np.zeros(len(policies), dtype=bool)
        while not over.all():
            terms = np.c_[(seen - self.centre) / self.usual, np.ones(len(seen))]
            shares = np.clip(np.einsum('kij,kj->ki', policies, terms), -1.0, 1.0)
            seen, rewards, ended, late, _ = self.envs.step((LIMIT * shares).astype(np.float32))
            # A simulation that failed is worse than any that goes on.
            total += np.where(over, -1.0, rewards)
            over |= ended | late
        return total


def learn(iterations, seed=0):
    """Return the policy, its return and distance [m] at the end, and those without torques."""
    random, task = np.random.default_rng(seed), Task(2 * DIRECTIONS)
    policy = np.zeros((3, 7))

    def tried():
        """Return the mean return and distance from starts that were not learned from."""
        earned = task.returns(np.array([policy] * 2 * DIRECTIONS), 10 ** 6)
        return earned.mean(), task.distance.mean()

    before = tried()
    for k in range(iterations):
        changes = random.normal(size=(DIRECTIONS, *policy.shape))
        seeds = list(range(k * DIRECTIONS, (k + 1) * DIRECTIONS)) * 2
        more, less = task.returns(np.concatenate((
            policy + NOISE * changes, policy - NOISE * changes)), seeds).reshape(2, -1)
        best = np.argsort(-np.maximum(more, less))[:BEST]
        spread = np.concatenate((more[best], less[best])).std()
        policy += STEP / (BEST * spread) * np.tensordot(
            (more - less)[best], changes[best], axes=1)
        if k % 10 == 9:
            print(f'{k + 1:4d} iterations: return {tried()[0]:.3f}, '
                  f'{1e3 * task.distance.mean():.1f} mm from the goal at the end')
    return policy, before, tried()


if __name__ == '__main__':
    _, before, after = learn(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
    print(f'without torques {1e3 * before[1]:.1f} mm from the goal, now {1e3 * after[1]:.1f} mm')
