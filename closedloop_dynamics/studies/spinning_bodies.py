# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Bodies that turn about all axes, and the closed forms of their motion, in elliptic functions."""

import math

import numpy as np

from .hard_machines import G
from ..effects.gravity import Gravity
from ..mechanism.mechanism import Body, Joint, Mechanism
from ..simulation.scene_records import Initial, Method, Scene
from ..simulation.simulation import Simulation

# Principal moments of the free body [kg m^2].
MOMENTS = np.array([0.02, 0.03, 0.045])
# Of the top: spin [rad/s], how far it leans where it is released [rad], distance of its centre of
# mass [m], mass [kg], moments about its axis and about its point across it [kg m^2].
SPIN, LEAN, LEVER, TOP_MASS = 40.0, 1.0, 0.2, 0.5
ALONG, ACROSS = 0.001, 0.002 + TOP_MASS * LEVER ** 2


def one_body(kind, center, inertia, position=None, velocity=None, strength=G, method=Method()):
    """
    Return a simulation of a body of 0.5 kg on the ground.

    Parameters
    ----------
    kind : str
        Of its joint, which is called ``joint``.
    center, inertia : tuple of 3 floats
        Centre of mass [m], and principal moments about it [kg m^2].
    position, velocity : mapping, optional
        As scenes have them.
    strength : float
        Of gravity, along -z [m/s^2].
    method : Method, optional
        How it is computed.

    """
    mechanism = Mechanism('one_body', (Body('body', TOP_MASS, center, inertia),), (
        Joint('joint', kind, 'ground', 'body', (0.0, 0.0, 0.0)),))
    names = mechanism.coordinates
    q = names.filled('position', position or {}, names.start())
    qd = names.filled('velocity', velocity or {}, np.zeros(names.nv))
    return Simulation(Scene(mechanism.name, None, '', mechanism, Initial(tuple(q), tuple(qd)),
                            {'gravity': Gravity((0.0, 0.0, -strength))}, method))


def norm_error(simulation):
    """Return how far the quaternions of a state are from norm 1, at most."""
    q = simulation.position
    return max(abs(np.linalg.norm(q[first:first + 4]) - 1.0)
               for first, _ in simulation.coordinates.balls)


def free_body(turns=10.0, share=0.9999):
    """
    Return the closed form of a free body that flips (Landau and Lifshitz, section 37).

    Parameters
    ----------
    turns : float
        Angular velocity about the axis of the largest moment at the start [rad/s].
    share : float
        Parameter of the elliptic functions; 1 would never flip.

    Returns
    -------
    callable
        Of time, angular velocity about the body's axes.

    """
    from scipy.special import ellipj
    one, two, three = MOMENTS
    rate = turns * np.sqrt((three - two) * (three - one) / (one * two))
    # Of the first and second component, from Euler's equations.
    first = turns * np.sqrt(share * three * (three - two) / (one * (two - one)))
    second = (three - one) / two * turns * first / rate

    def rates(time):
        sn, cn, dn, _ = ellipj(rate * time, share)
        return np.array([first * cn, second * sn, turns * dn])

    return rates


def top(method):
    """Return a symmetric top that is released leaning and spinning, at rest but for its spin."""
    return one_body(
        'spherical', (0.0, 0.0, LEVER), (0.002, 0.002, ALONG),
        {'joint': {'orientation': {'rpy': (LEAN, 0.0, 0.0)}}},
        {'joint': {'angular_velocity': (0.0, 0.0, SPIN)}}, method=method)


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
