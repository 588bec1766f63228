# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Moving a mechanism by hand along its closed loops, and the inertia felt."""

import numpy as np

# Corrections; how far a joint moves in one at most [rad, m], so that no branch is left; damping of
# directions in which a point can hardly move, as a share of those in which it can best: it fades
# as the goal comes near.
CORRECTIONS, FARTHEST, DAMPING = 20, 0.2, 0.05
DIFFERENCE = 1e-6
# A point that loops hold in one direction feels no heavier in it than so many times as in others.
HEAVIEST = 20.0
# What is missing counts no more below this [m or rad].
NEAR = 1e-9


def felt_inertia(simulation):
    """
    Return the inertia that a drive of each freedom feels in the present position, shape (nv,).

    It is in kg m^2 or kg; infinite where the loops prevent the motion.
    """
    free = _free(simulation)
    if not free.shape[1]:
        return np.full(len(free), np.inf)
    response = np.sum((free @ np.linalg.pinv(
        free.T @ simulation.inertia @ free)) * free, axis=1)
    with np.errstate(divide='ignore'):
        return 1.0 / np.where(response > 0.0, response, 0.0)


def felt_mass(simulation, name):
    """
    Return the effective mass at a named point in the present position, all joints free.

    It is a symmetric matrix of shape (2, 2), in space (3, 3) [kg]; zero where the loops hold the
    point in all directions.
    """
    free = _free(simulation)
    moves = _moves(simulation, name, free)
    mobility = moves @ np.linalg.pinv(free.T @ simulation.inertia @ free) @ moves.T
    values, axes = np.linalg.eigh(mobility)
    if not values[-1] > 0.0:
        return np.zeros_like(mobility)
    return axes / np.maximum(values, values[-1] / HEAVIEST) @ axes.T


def _moves(simulation, name, free):
    """Return how a named point moves with each of some motions, shape (2 or 3, number)."""
    moved, q = simulation.coordinates.moved, simulation.position
    return np.array([(simulation.data.place(name, moved(q, DIFFERENCE * motion))
                      - simulation.data.place(name, moved(q, -DIFFERENCE * motion)))
                     / (2.0 * DIFFERENCE) for motion in free.T]).reshape(
                         -1, len(simulation.point(name))).T


def _free(simulation):
    """Return motions that the loops allow, shape (nv, number of freedoms)."""
    return simulation.data.loop_model.equations.move(simulation.position).free_motions().T


def point_to(simulation, name, place):
    """
    Move to the state, at rest, in which a point is as near to a place as small moves lead.

    ``place`` is in the world, three numbers [m]; in the plane the third one does not count. Raises
    AssemblyError where the loops cannot be closed there; the last state that could be is kept.
    """
    def goal(free):
        start = simulation.point(name)
        return np.array(place)[:len(start)] - start, _moves(simulation, name, free)

    _follow(simulation, goal)


def joint_to(simulation, name, value):
    """
    Move to the state, at rest, in which a joint has a value [rad or m], or is near to it.

    The other driven joints stay as they are; where they and the loops do not let it have that
    value, it is as near as small moves lead.

    Raises AssemblyError as ``point_to`` does.
    """
    names = simulation.coordinates
    joint = names.index[name]
    held = [joint, *(k for k in simulation.data.actuated_in_tree.tolist() if k != joint)]
    wanted = names.by_freedom(simulation.position)[held]
    wanted[0] = value

    def goal(free):
        return wanted - names.by_freedom(simulation.position)[held], free[held]

    _follow(simulation, goal)


def _follow(simulation, goal):
    """Correct the state until the error given by ``goal`` vanishes, or cannot."""
    for _ in range(CORRECTIONS):
        free = _free(simulation)
        if not free.shape[1]:
            return
        missing, moves = goal(free)
        square = moves @ moves.T
        scale = np.trace(square)
        if not (scale > 0.0 and np.abs(missing).max() > NEAR):
            return
        damping = DAMPING * min(1.0, np.abs(missing).max() / FARTHEST)
        damped = square + damping ** 2 * scale * np.eye(len(missing))
        change = free @ (moves.T @ np.linalg.solve(damped, missing))
        change *= min(1.0, FARTHEST / max(np.abs(change).max(), 1e-12))
        if not np.abs(change).max() > NEAR:
            return
        simulation.set_state(simulation.coordinates.moved(simulation.position, change))
