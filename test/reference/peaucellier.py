# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Peaucellier and Lipkin's linkage through the positions in which two of its pins meet.

Where the crank's pin A meets the tracing pin C, the four short links fold: a singular
configuration, from which another branch leads away. Along the branch on which C keeps to its
straight line all places are known in closed form, and so are kinetic and potential energy as
functions of the crank's angle: one equation of motion, which notices no singularity.
"""

from closedloop_dynamics.mechanism.mechanism import Body, CutJoint, Joint, Mechanism, REVOLUTE
import numpy as np
from scipy.integrate import quad, solve_ivp

from . import scenes
from .trees import derivative, turned, unit

# Lengths of the crank, which is also the distance of the two ground pivots, of the long arms and
# of the short links [m]; all are uniform rods of 1 kg/m.
CRANK, ARM, LINK = 0.5, 1.0, 0.4
GRAVITY = 9.81
# A meets C where the crank is at 0.823 rad: before that, and rate there.
START, RATE = 0.95, -10.0


def pins(angle):
    """Return the places of A, B, C and D, for real and for complex angles of the crank."""
    a = np.array([CRANK, 0.0]) + CRANK * unit(angle)
    distance = np.sqrt(a @ a)
    along, inverse = a / distance, (ARM ** 2 - LINK ** 2) / distance
    middle = 0.5 * (distance + inverse) * along
    side = np.sqrt(LINK ** 2 - 0.25 * (inverse - distance) ** 2) * turned(along)
    return a, middle + side, inverse * along, middle - side


def rods(angle):
    """Yield both ends of each body, and its length."""
    a, b, c, d = pins(angle)
    ground = np.zeros(2)
    yield np.array([CRANK, 0.0]), a, CRANK
    yield from ((ground, b, ARM), (ground, d, ARM))
    yield from ((b, a, LINK), (b, c, LINK), (d, c, LINK), (d, a, LINK))


def scene(start=START, rate=RATE):
    """Return the linkage before its singular position, on the way to it."""
    names = ('crank', 'left', 'right', 'left_a', 'left_c', 'right_c', 'right_a')
    lengths = [length for _, _, length in rods(start)]
    bodies = tuple(Body(name, length, (length / 2, 0.0), length ** 3 / 12)
                   for name, length in zip(names, lengths))
    parents = ('ground', 'ground', 'ground', 'left', 'left', 'right', 'right')
    places = ((CRANK, 0.0), (0.0, 0.0), (0.0, 0.0), *[(ARM, 0.0)] * 4)
    joints = tuple(Joint(f'to_{name}', REVOLUTE, parent, name, place, 0.0, name == 'crank')
                   for name, parent, place in zip(names, parents, places))
    cuts = tuple(CutJoint(name, REVOLUTE, first, second, (length, 0.0), (LINK, 0.0))
                 for name, first, second, length in (
                     ('a_left', 'crank', 'left_a', CRANK), ('a_right', 'crank', 'right_a', CRANK),
                     ('c', 'left_c', 'right_c', LINK)))
    turns = [np.arctan2(*(end - first)[::-1]) for first, end, _ in rods(start)]
    position = (start, turns[1], turns[2], *(
        turns[k] - turns[1 if k < 5 else 2] for k in range(3, 7)))
    return scenes.scene(
        Mechanism('peaucellier', bodies, joints, cuts), position, (rate,) + (0.0,) * 6,
        gravity=(0.0, -GRAVITY), hold=('to_crank',))


def inertia(angle):
    """Return twice the kinetic energy at a crank's rate of 1 rad/s [kg m^2]."""
    total = 0.0
    rates = derivative(lambda x: np.array([(*start, *end) for start, end, _ in rods(x[0])]),
                       [angle], [1.0])
    for (_, _, length), (*start, right, up) in zip(rods(angle), rates):
        first, second = np.array(start), np.array([right, up])
        total += length / 3.0 * (first @ first + first @ second + second @ second)
    return total


def slope(angle, reach=5e-3):
    """Return the derivative of the inertia by central differences of eighth order."""
    return sum(share * (inertia(angle + k * reach) - inertia(angle - k * reach)) for k, share in (
        (1, 0.8), (2, -0.2), (3, 4.0 / 105.0), (4, -1.0 / 280.0))) / reach


def weight(angle):
    """Return the derivative of the potential energy [N m]."""
    return derivative(lambda x: height(x[0]), [angle], [1.0])


def height(angle):
    """Return the potential energy [J]."""
    return sum(length * GRAVITY * (start + end)[1] / 2.0 for start, end, length in rods(angle))


def travel_time(start, rate, first, last):
    """
    Return the time that the crank takes from one angle to another [s], to some 1e-15 s.

    It starts as ``scene`` says and does not turn back on the way. By energy alone: neither an
    integration of the motion nor the loops are in it.
    """
    energy = 0.5 * inertia(start) * rate ** 2 + height(start)
    return quad(lambda angle: np.sqrt(inertia(angle) / (2.0 * (energy - height(angle)))),
                first, last, epsabs=1e-16, epsrel=1e-13, limit=200)[0] * np.sign(rate)


def crank_angles(times):
    """Return the angles of the crank at rising times, to some 1e-12 rad."""
    def rates(_, state):
        angle, rate = state
        return rate, -(0.5 * slope(angle) * rate ** 2 + weight(angle)) / inertia(angle)
    return solve_ivp(rates, (0.0, times[-1]), (START, RATE), 'DOP853', times, rtol=1e-12,
                     atol=1e-13).y[0]
