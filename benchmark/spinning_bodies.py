# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Bodies that turn about all axes, and the closed forms of their motion, in elliptic functions."""

import math

from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism
from closedloop_dynamics.scene.records import Initial, Scene
from closedloop_dynamics.simulation.simulation import Simulation
from hard_machines import G
import numpy as np

# Angular velocity of the free body about the axis of the largest moment at the start [rad/s].
TURNS = 10.0
# Principal moments of the free body [kg m^2].
MOMENTS = np.array([0.02, 0.03, 0.045])
# Of the top: spin [rad/s], how far it leans where it is released [rad], distance of its centre of
# mass [m], mass [kg], moments about its axis and about its point across it [kg m^2].
SPIN, LEAN, LEVER, TOP_MASS = 40.0, 1.0, 0.2, 0.5
ALONG, ACROSS = 0.001, 0.002 + TOP_MASS * LEVER ** 2


def one_body(kind, center, inertia, method, velocity, position=None):
    """
    Return a simulation of a body of 0.5 kg on the ground, under gravity along -z.

    ``kind`` is that of its joint, called ``joint``; ``center`` is the centre of mass [m], and
    ``inertia`` are the principal moments about it [kg m^2], three floats each. Velocity and
    position are mappings as scenes have them.
    """
    mechanism = Mechanism('one_body', (Body('body', TOP_MASS, center, inertia),), (
        Joint('joint', kind, 'ground', 'body', (0.0, 0.0, 0.0)),))
    names = mechanism.coordinates
    q = names.filled('position', position or {}, names.start())
    qd = names.filled('velocity', velocity, np.zeros(names.nv))
    return Simulation(Scene(mechanism.name, None, '', mechanism, Initial(tuple(q), tuple(qd)),
                            {'gravity': Gravity((0.0, 0.0, -G))}, method))


def norm_error(simulation):
    """Return how far the quaternions of a state are from norm 1, at most."""
    q = simulation.position
    return max(abs(np.linalg.norm(q[first:first + 4]) - 1.0)
               for first, _ in simulation.coordinates.balls)


def free_body(share=0.9999):
    """
    Return the angular velocity about its axes of a free body that flips, a function of time.

    It is the closed form of Landau and Lifshitz, section 37; ``share`` is the parameter of the
    elliptic functions, of which 1 would never flip.
    """
    from scipy.special import ellipj
    one, two, three = MOMENTS
    rate = TURNS * np.sqrt((three - two) * (three - one) / (one * two))
    # Of the first and second component, from Euler's equations.
    first = TURNS * np.sqrt(share * three * (three - two) / (one * (two - one)))
    second = (three - one) / two * TURNS * first / rate

    def rates(time):
        sn, cn, dn, _ = ellipj(rate * time, share)
        return np.array([first * cn, second * sn, TURNS * dn])

    return rates


def top(method):
    """Return a symmetric top that is released leaning and spinning, at rest but for its spin."""
    return one_body(
        'spherical', (0.0, 0.0, LEVER), (0.002, 0.002, ALONG), method,
        {'joint': {'angular_velocity': (0.0, 0.0, SPIN)}},
        {'joint': {'orientation': {'rpy': (LEAN, 0.0, 0.0)}}})


def nutation(time):
    """Return the cosine of the top's lean and the rate of its precession (Goldstein, 5.7)."""
    from scipy.special import ellipj
    a, beta, first = ALONG * SPIN / ACROSS, 2.0 * TOP_MASS * G * LEVER / ACROSS, math.cos(LEAN)
    # Released at a cusp: b = a u, alpha = beta u at the start.
    low, high, above = np.sort(np.roots(
        [beta, -(beta * first + a * a), 2.0 * a * a * first - beta,
         beta * first - (a * first) ** 2]).real)
    rate, share = 0.5 * np.sqrt(beta * (above - low)), (high - low) / (above - low)
    _, cn, dn, _ = ellipj(rate * time, share)
    u = low + (high - low) * (cn / dn) ** 2
    return u, a * (first - u) / (1.0 - u * u)
