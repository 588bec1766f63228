# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Plane geometry of a tree, written down directly, for real and for complex coordinates.

Derivatives are complex steps, exact to rounding: every function of ``q`` also
takes complex coordinates. Planar vectors are ordered (angular, x, y).
"""

from closedloop_dynamics.mechanism.mechanism import GROUND, REVOLUTE
import numpy as np

# A complex step subtracts nothing, so that it may be as small as numbers go.
STEP = 1e-40


def unit(angle):
    """Return the unit vector at ``angle``."""
    return np.array([np.cos(angle), np.sin(angle)])


def turned(vector):
    """Return ``vector`` turned by a quarter, counter-clockwise."""
    return np.array([-vector[1], vector[0]])


def placed(frame, point):
    """Return the world place of ``point``, given in the frame (origin, angle)."""
    origin, angle = frame
    along = unit(angle)
    return origin + point[0] * along + point[1] * turned(along)


def derivative(function, q, direction):
    """Return the derivative of ``function`` at ``q`` along ``direction``."""
    return np.imag(function(np.asarray(q) + 1j * STEP * np.asarray(direction))) / STEP


def jacobian(function, q):
    """Return the derivatives of ``function`` by each coordinate, as columns."""
    return np.stack([derivative(function, q, e) for e in np.eye(len(q))], axis=-1)


def body_frames(mechanism, q):
    """Return {body name: (origin, angle)}, the ground included."""
    frames = {GROUND: (np.zeros(2), 0.0)}
    waiting = list(zip(mechanism.joints, q))
    while waiting:
        joint, coordinate = waiting.pop(0)
        if joint.parent not in frames:
            waiting.append((joint, coordinate))
            continue
        origin = placed(frames[joint.parent], joint.position)
        angle = frames[joint.parent][1] + joint.angle
        if joint.type == REVOLUTE:
            frames[joint.child] = (origin, angle + coordinate)
        else:
            frames[joint.child] = (origin + coordinate * unit(angle), angle)
    return frames


def path(mechanism, body):
    """Return the indices of the joints between ``body`` and the ground."""
    by_child = {joint.child: index for index, joint in enumerate(mechanism.joints)}
    indices = []
    while body != GROUND:
        indices.append(by_child[body])
        body = mechanism.joints[indices[-1]].parent
    return indices


def point_jacobian(mechanism, q, body, point):
    """Return the (3, nv) Jacobian, angular, x, y, of a body's angle and of a point on it."""
    frames = body_frames(mechanism, q)
    place = placed(frames[body], point)
    jac = np.zeros((3, len(q)), dtype=np.asarray(q).dtype)
    for index in path(mechanism, body):
        joint = mechanism.joints[index]
        origin, angle = frames[joint.child]
        if joint.type == REVOLUTE:
            jac[0, index] = 1.0
            jac[1:, index] = turned(place - origin)
        else:
            jac[1:, index] = unit(angle)
    return jac
