# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Jansen's walking leg, and a 4-RRR with one drive more than freedoms."""

from closedloop_dynamics.mechanism.mechanism import (
    Body, CutJoint, GROUND, Joint, Mechanism, REVOLUTE)
import numpy as np

from .scenes import scene
from .trees import unit

# Jansen's eleven numbers [cm] and the height of the crank; m is the crank.
A, B, C, D, E, F, G, H, I, J, K, L, M = (
    38.0, 41.5, 39.3, 40.1, 55.8, 39.4, 36.7, 65.7, 49.0, 50.0, 61.9, 7.8, 15.0)


def meeting(first, second, radius, other, side):
    """Return where two circles meet, on one side of the line from centre to centre."""
    apart = second - first
    distance = np.hypot(*apart)
    along = (radius ** 2 - other ** 2 + distance ** 2) / (2.0 * distance)
    across = np.sqrt(radius ** 2 - along ** 2)
    normal = np.array([-apart[1], apart[0]]) / distance
    return first + along * apart / distance + side * across * normal


def rod(name, length, density=1.0):
    """Return a uniform rod along its own x axis."""
    return Body(name, density * length, (0.5 * length, 0.0), density * length ** 3 / 12.0)


def triangle(name, far, third):
    """Return a body of three equal masses at its pins: the origin, (far, 0) and a third."""
    pins = np.array([[0.0, 0.0], [far, 0.0], third])
    centre = pins.mean(axis=0)
    return Body(name, 3.0, tuple(centre), float(((pins - centre) ** 2).sum()))


def angle(start, end):
    """Return the direction from one place to another [rad]."""
    return float(np.arctan2(*(end - start)[::-1]))


def jansen(crank=0.3):
    """Return the leg released from rest, lengths in decimetres."""
    scale = 0.1
    a, b, c, d, e, f, g, h, i, j, k, low, m = (scale * value for value in (
        A, B, C, D, E, F, G, H, I, J, K, L, M))
    pivot = np.array([-a, -low])
    tip = m * unit(crank)
    upper = meeting(pivot, tip, b, j, 1.0)
    lower = meeting(pivot, tip, c, k, -1.0)
    outer = meeting(pivot, upper, d, e, 1.0)
    knee = meeting(outer, lower, f, g, -1.0)
    third = meeting(np.zeros(2), np.array([b, 0.0]), d, e, 1.0)
    foot = meeting(np.zeros(2), np.array([g, 0.0]), i, h, 1.0)
    bodies = (rod('crank', m), rod('upper_rod', j), rod('lower_rod', k),
              triangle('rocker', b, third), rod('lower_arm', c), rod('outer_rod', f),
              triangle('leg', g, foot))
    places = (('crank', GROUND, (0.0, 0.0), True), ('upper_rod', 'crank', (m, 0.0), False),
              ('lower_rod', 'crank', (m, 0.0), False), ('rocker', GROUND, tuple(pivot), False),
              ('lower_arm', GROUND, tuple(pivot), False),
              ('outer_rod', 'rocker', tuple(third), False), ('leg', 'lower_arm', (c, 0.0), False))
    joints = tuple(
        Joint(f'to_{name}', REVOLUTE, parent, name, tuple(map(float, place)), 0.0, drive)
        for name, parent, place, drive in places)
    cuts = (CutJoint('upper', REVOLUTE, 'upper_rod', 'rocker', (j, 0.0), (b, 0.0)),
            CutJoint('lower', REVOLUTE, 'lower_rod', 'lower_arm', (k, 0.0), (c, 0.0)),
            CutJoint('knee', REVOLUTE, 'outer_rod', 'leg', (f, 0.0), (g, 0.0)))
    turn = {'crank': crank, 'rocker': angle(pivot, upper), 'lower_arm': angle(pivot, lower)}
    position = (crank, angle(tip, upper) - crank, angle(tip, lower) - crank, turn['rocker'],
                turn['lower_arm'], angle(outer, knee) - turn['rocker'],
                angle(lower, knee) - turn['lower_arm'])
    return scene(Mechanism('jansen', bodies, joints, cuts), position, gravity=(0.0, -9.81),
                 hold=('to_crank',))


def four_rrr():
    """Return a square platform on four legs, all driven at the base, released from rest."""
    corners = 0.2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    bases = 3.0 * corners
    bodies, joints, cuts, position = [], [], [], []
    for number, (base, corner) in enumerate(zip(bases, corners), start=1):
        elbow = meeting(base, corner, 0.4, 0.4, 1.0)
        first, second = angle(base, elbow), angle(elbow, corner)
        bodies += [rod(f'proximal_{number}', 0.4, 5.0), rod(f'distal_{number}', 0.4, 5.0)]
        joints += [Joint(f'base_{number}', REVOLUTE, GROUND, f'proximal_{number}',
                         tuple(map(float, base)), 0.0, True),
                   Joint(f'elbow_{number}', REVOLUTE, f'proximal_{number}', f'distal_{number}',
                         (0.4, 0.0))]
        position += [first, second - first]
        if number == 1:
            bodies.append(Body('platform', 4.0, (0.2, 0.2), 0.1))
            joints.append(Joint('wrist', REVOLUTE, 'distal_1', 'platform', (0.4, 0.0)))
            position.append(-second)
        else:
            cuts.append(CutJoint(
                f'cut_{number}', REVOLUTE, f'distal_{number}', 'platform', (0.4, 0.0),
                tuple(float(value) for value in corner - corners[0])))
    return scene(Mechanism('four_rrr', tuple(bodies), tuple(joints), tuple(cuts)), position,
                 gravity=(0.0, -9.81))
