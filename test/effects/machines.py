# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Small machines and scenes whose motion under one effect is known in closed form."""

import math

from closedloop_dynamics import Body, CutJoint, Joint, Mechanism, Point
import numpy as np

from ..reference import scenes


def block(mass=1.0, angle=0.0):
    """Return a block that slides along a line; one coordinate, 'slide' [m]."""
    return Mechanism(
        'block', (Body('block', mass, (0.0, 0.0), 0.1),),
        (Joint('slide', 'prismatic', 'ground', 'block', (0.0, 0.0), angle, True),), (),
        (Point('center', 'block', (0.0, 0.0)), Point('front', 'block', (0.3, 0.0))))


def spatial_block():
    """Return the block as a body in space."""
    here = (0.0, 0.0, 0.0)
    return Mechanism(
        'spatial_block', (Body('block', 1.0, here, (0.1, 0.1, 0.1)),),
        (Joint('slide', 'prismatic', 'ground', 'block', here, axis=(1.0, 0.0, 0.0),
               actuated=True),), (),
        (Point('center', 'block', here), Point('front', 'block', (0.3, 0.0, 0.0))))


def flyer():
    """Return a body that moves freely in the plane: 'x', 'y' [m], 'turn' [rad]."""
    feather = (0.25, (0.0, 0.0), 0.0)
    return Mechanism(
        'flyer', (Body('rail', *feather), Body('lift', *feather), Body('hull', 1.0, (0, 0), 0.5)),
        (Joint('x', 'prismatic', 'ground', 'rail', (0, 0), 0.0, True),
         Joint('y', 'prismatic', 'rail', 'lift', (0, 0), 1.5707963267948966, True),
         Joint('turn', 'revolute', 'lift', 'hull', (0, 0), -1.5707963267948966)),
        (), (Point('ball', 'hull', (0.0, 0.0)), Point('rim', 'hull', (0.0, -0.2))))


def pair():
    """Return two bodies that move freely in the plane, of 1 kg and 0.5 kg m^2 each."""
    bodies, joints = [], []
    for side in 'ab':
        bodies += [Body(f'rail_{side}', 0.0, (0, 0), 0.0, True),
                   Body(f'lift_{side}', 0.0, (0, 0), 0.0, True),
                   Body(f'hull_{side}', 1.0, (0, 0), 0.5)]
        joints += [
            Joint(f'x_{side}', 'prismatic', 'ground', f'rail_{side}', (0, 0)),
            Joint(f'y_{side}', 'prismatic', f'rail_{side}', f'lift_{side}', (0, 0), math.pi / 2),
            Joint(f'turn_{side}', 'revolute', f'lift_{side}', f'hull_{side}', (0, 0),
                  -math.pi / 2)]
    return Mechanism('pair', tuple(bodies), tuple(joints), (), (
        Point('front', 'hull_a', (0.3, 0.0)), Point('rear', 'hull_b', (-0.2, 0.0))))


def momenta(simulation):
    """Return the momenta along x and y and about the origin, of ``pair``."""
    x, v = simulation.position, simulation.velocity
    spin = sum(x[k] * v[k + 1] - x[k + 1] * v[k] + 0.5 * v[k + 2] for k in (0, 3))
    return np.array([v[0] + v[3], v[1] + v[4], spin])


def pendulum(mass=2.0, length=0.5):
    """Return a point mass at the end of a rod; one coordinate, 'hinge', 0 along x."""
    return Mechanism(
        'pendulum', (Body('rod', mass, (length, 0.0), 0.0),),
        (Joint('hinge', 'revolute', 'ground', 'rod', (0.0, 0.0), 0.0, True),), (),
        (Point('tip', 'rod', (length, 0.0)),))


def slider_crank():
    """
    Return the slider-crank of the benchmark in ``reference.exact``.

    Its massless slider takes half the rod's mass, which sits at the same pin.
    """
    return Mechanism(
        'benchmark',
        (Body('wheel', 1.0, (0.0, 0.0), 1.0), Body('shoe', 0.5, (0.0, 0.0), 1.0),
         Body('bar', 0.5, (0.0, 0.0), 2.0)),
        (Joint('crank', 'revolute', 'ground', 'wheel', (0.0, 0.0)),
         Joint('slider', 'prismatic', 'ground', 'shoe', (0.0, 0.0)),
         Joint('rod', 'revolute', 'shoe', 'bar', (0.0, 0.0))),
        (CutJoint('pin', 'revolute', 'wheel', 'bar', (0.5, 0.0), (-1.0, 0.0)),),
        (Point('middle_of_crank', 'wheel', (0.25, 0.0)),
         Point('middle_of_rod', 'bar', (-0.5, 0.0)), Point('end', 'bar', (1.0, 0.0))))


def simulated(mechanism, effects, position, velocity=None, **method):
    """Return a Simulation of a mechanism under effects from a state."""
    return scenes.simulated(
        mechanism, position, velocity, effects, **{'integrator': 'rk4', **method})


def assert_balanced(simulation, tolerance):
    """Assert that the energy balance closes, absolutely [J]."""
    balance = simulation.energy_balance
    assert abs(balance.residual) <= tolerance, balance
