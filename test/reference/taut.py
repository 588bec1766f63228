# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines with closure equations that forbid motions to second order only, and their twins."""

from closedloop_dynamics.mechanism.mechanism import (
    Body, CutJoint, GROUND, Joint, Mechanism, PRISMATIC, REVOLUTE, SPHERICAL)
import numpy as np

from .machines import bar, revolute, revolute_cut


def gantry(tilt=0.0, carriages=(2.0, 2.0), bars=(1.0,), length=1.0, arm=False):
    """
    Return carriages on parallel rails, each joined to the next by a pinned bar across the rails.

    ``tilt``: direction of the rails [rad]; ``carriages``, ``bars``: masses [kg]; ``length``: of
    the bars, and from rail to rail [m]; ``arm``: whether the rails are on an arm that turns.
    """
    across, base = length * np.array([-np.sin(tilt), np.cos(tilt)]), 'arm' if arm else GROUND
    bodies, joints, cuts = [], [], []
    if arm:
        bodies.append(bar('arm', 3.0, 1.0, 0.3))
        joints.append(revolute('shoulder', GROUND, 'arm', (0.0, 0.0), actuated=True))
    for number, mass in enumerate(carriages):
        bodies.append(Body(f'carriage_{number}', mass, (0.0, 0.0), 0.01))
        joints.append(Joint(f'rail_{number}', PRISMATIC, base, f'carriage_{number}',
                            tuple(number * across), tilt, actuated=number == 0))
    for number, mass in enumerate(bars):
        bodies.append(bar(f'bar_{number}', mass, length, 0.5 * length))
        joints.append(revolute(f'low_{number}', f'carriage_{number}', f'bar_{number}', (0.0, 0.0),
                               0.5 * np.pi))
        cuts.append(revolute_cut(f'high_{number}', f'bar_{number}', (length, 0.0),
                                 f'carriage_{number + 1}', (0.0, 0.0)))
    return Mechanism('gantry', tuple(bodies), tuple(joints), tuple(cuts))


def carriage(tilt=0.0, carriages=(2.0, 2.0), bars=(1.0,), length=1.0):
    """Return what ``gantry`` moves as on an arm: one carriage of all masses."""
    parts = [(mass, number * length, 0.01) for number, mass in enumerate(carriages)]
    parts += [(mass, (number + 0.5) * length, mass * length ** 2 / 12.0)
              for number, mass in enumerate(bars)]
    total = sum(mass for mass, _, _ in parts)
    center = sum(mass * place for mass, place, _ in parts) / total
    inertia = sum(own + mass * (place - center) ** 2 for mass, place, own in parts)
    return Mechanism('carriage', (
        bar('arm', 3.0, 1.0, 0.3), Body('carriage', total, (0.0, center), inertia)), (
        revolute('shoulder', GROUND, 'arm', (0.0, 0.0), actuated=True),
        Joint('rail_0', PRISMATIC, 'arm', 'carriage', (0.0, 0.0), tilt, actuated=True)))


def flat_arch(lengths=(1.0, 1.0)):
    """Return two bars stretched between two pins on the ground."""
    first, second = lengths
    return Mechanism('flat_arch', (
        bar('left', 1.0, first, 0.5 * first), bar('right', 1.0, second, 0.5 * second)), (
        revolute('a', GROUND, 'left', (0.0, 0.0), actuated=True),
        revolute('b', 'left', 'right', (first, 0.0))), (
        revolute_cut('c', 'right', (second, 0.0), GROUND, (first + second, 0.0)),))


def box_in_two_hands(upper=(0.3, 0.3), lower=(0.25, 0.25), width=0.6, apart=0.0, ball=SPHERICAL):
    """
    Return two planar arms of two links that hold a box between them by balls.

    ``upper``, ``lower``: lengths of both arms' links; ``apart``: how much farther the right
    shoulder is along x. With ``ball=REVOLUTE`` the left ball is a hinge across the arms: the box
    cannot tilt, which is all that it can do.
    """
    across = {'axis': (0.0, 1.0, 0.0)}

    def link(name, mass, length):
        return Body(name, mass, (0.5 * length, 0.0, 0.0),
                    (0.001, mass * length ** 2 / 12.0, mass * length ** 2 / 12.0, 0.0, 0.0, 0.0))

    bodies, joints = [], []
    for side, y, x, long, short in zip('lr', (0.0, -width), (0.0, apart), upper, lower):
        bodies += [link(f'{side}u', 1.0, long), link(f'{side}f', 0.8, short)]
        joints += [
            Joint(f'{side}s', REVOLUTE, GROUND, f'{side}u', (x, y, 1.0), actuated=True, **across),
            Joint(f'{side}e', REVOLUTE, f'{side}u', f'{side}f', (long, 0.0, 0.0), actuated=True,
                  **across)]
    bodies.append(Body('box', 5.0, (0.02, -0.5 * width, 0.0),
                       (0.12, 0.033, 0.12, 0.0, 0.0, 0.0)))
    joints.append(Joint('ball', ball, 'lf', 'box', (lower[0], 0.0, 0.0),
                        **(across if ball == REVOLUTE else {})))
    return Mechanism('box_in_two_hands', tuple(bodies), tuple(joints), (
        CutJoint('hand', SPHERICAL, 'box', 'rf', (0.0, -width, 0.0), (lower[1], 0.0, 0.0)),))


def hand_angles(reach, length, short, shoulder):
    """Return shoulder and elbow angles with which an arm's hand is at ``reach``, (x, z) [m]."""
    x, z = reach[0] - shoulder, reach[1] - 1.0
    elbow = np.arccos((x * x + z * z - length ** 2 - short ** 2) / (2.0 * length * short))
    # Turns about y lead from x to -z.
    return (np.arctan2(-z, x) - np.arctan2(short * np.sin(elbow), length + short * np.cos(elbow)),
            elbow)
