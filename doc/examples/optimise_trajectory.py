# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Move manipulators from rest to rest with the least effort, by exact derivatives.

Torques are constant in each of 20 intervals. SciPy's SLSQP finds those of the least mean square
that bring the driven joints to their goal, at rest. Derivatives of where these arrive are those of
the steps, by the adjoint: one pass back over the trajectory for each number of the goal.

    python doc/examples/optimise_trajectory.py
"""

import closedloop_dynamics as cld
import numpy as np
from scipy.optimize import minimize

# What the driven joints move by [rad or m], and the time for it [s].
MOVES = {'three_rrr_horizontal': ((0.4, -0.3, 0.2), 0.5),
         'stewart_platform': ((0.06, 0.02, -0.04, -0.04, 0.02, 0.06), 0.6)}
ROWS, STEPS = 20, 200


def optimise(scene, move, duration):
    """Return the torques [N m or N], their mean square, and the distance from the goal."""
    model = cld.Model.from_scene(scene)
    start, driven = model.assemble(), model.actuated_joints
    sensitivity = cld.Sensitivity(model, {'integrator': 'rk4', 'step_size': duration / STEPS})
    names = [*start.coordinates.columns('position'), *start.coordinates.columns('velocity')]
    ends = [names.index(f'{what}.{name}') for what in ('position', 'velocity') for name in driven]
    goal = np.concatenate(([start.position[name] for name in driven], np.zeros(len(driven))))
    goal[:len(driven)] += move
    # What holds the machine at its start is the first guess.
    holding = model.inverse(start, np.zeros(len(start.qd))).torque
    unit = max(1.0, np.abs(holding).max())

    def arrived(torques):
        return sensitivity.trajectory(
            start, unit * torques.reshape(ROWS, -1), steps=STEPS, every=STEPS)

    def missed(torques):
        end = arrived(torques)
        return np.concatenate((end.position[-1], end.velocity[-1]))[ends] - goal

    def missed_by_torque(torques):
        end, found = arrived(torques), []
        for place in ends:
            weights = np.zeros((2, len(names)))
            weights[-1, place] = 1.0
            found.append(end.gradient(*np.split(weights, [len(start.q)], axis=1)).torques.ravel())
        return unit * np.array(found)

    best = minimize(lambda torques: np.mean(torques ** 2), np.tile(holding / unit, ROWS),
                    jac=lambda torques: 2.0 / torques.size * torques, method='SLSQP',
                    constraints={'type': 'eq', 'fun': missed, 'jac': missed_by_torque},
                    options={'ftol': 1e-10})
    if not best.success:
        raise RuntimeError(f'{scene}: {best.message}')
    return unit * best.x.reshape(ROWS, -1), unit ** 2 * best.fun, np.abs(missed(best.x)).max()


if __name__ == '__main__':
    for scene, (move, duration) in MOVES.items():
        _, effort, distance = optimise(scene, move, duration)
        print(f'{scene}: mean square of the torques {effort:.5g}, {distance:.1g} from the goal')
