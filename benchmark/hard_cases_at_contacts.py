# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The hard cases of the stability atlas in which a contact is short: grazed, or soon passed."""

from dataclasses import replace
import math

from closedloop_dynamics.effects.cable import Cable
from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.mechanism.mechanism import (
    Body, Joint, Mechanism, Point, PRISMATIC, REVOLUTE)
from closedloop_dynamics.simulation.simulation import Simulation
from hard_machines import effect_of, scene, started
import numpy as np

# Mass of a ball [kg], and where it flies from [m].
MASS, START = 0.5, -0.5
# A crank without gravity: its inertia [kg m^2], length [m] and rate [rad/s].
INERTIA, LENGTH, RATE = 0.01, 0.1, 20.0


def _ball(in_space):
    """Return a ball that slides along x."""
    if in_space:
        return Mechanism(
            'shot', (Body('hull', MASS, (0.0, 0.0, 0.0), (1e-3, 1e-3, 1e-3)),),
            (Joint('x', PRISMATIC, 'ground', 'hull', (0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),), (),
            (Point('ball', 'hull', (0.0, 0.0, 0.0)), Point('target', 'ground', (0.0, 0.0, 0.0))))
    return Mechanism(
        'shot', (Body('hull', MASS, (0.0, 0.0), 1e-3),),
        (Joint('x', PRISMATIC, 'ground', 'hull', (0.0, 0.0)),), (),
        (Point('ball', 'hull', (0.0, 0.0)), Point('target', 'ground', (0.0, 0.0))))


def shot(method, quick, speed, half, stiffness, in_space=False, **shape):
    """
    Shoot a ball straight at a solid and back.

    ``half`` is that of the solid's thickness [m], a plate where no ``shape`` is given, of a
    ``stiffness`` [N/m] at which the ball turns round in the nearer half; ``speed`` in m/s,
    ``shape`` keys of the contact.
    """
    keys = shape or {'shape': 'curve', 'interpolation': 'linear',
                     'x': (-half, half, half, -half), 'y': (-1.0, -1.0, 1.0, 1.0)}
    effect = effect_of({'type': 'body_contact', 'point': 'ball', 'other': 'target',
                        'stiffness': stiffness, **keys})
    duration, way = 2.0 * abs(START) / speed, abs(START) - half
    touch = math.pi * math.sqrt(MASS / stiffness)
    end = -half - speed * (duration - way / speed - touch)
    simulation = Simulation(scene(
        _ball(in_space), (START,), (speed,), method, {'solid': effect}))
    simulation.step(duration=duration)
    return abs(simulation.position[0] - end) / abs(START)


def _dips(method, quick, effect, depth):
    """
    Hold a crank up a little once a turn, for a short while.

    By an effect without losses about the angle 0, of a stiffness; ``depth`` gives how deep it is
    at an angle [m].
    """
    crank = Mechanism(
        'crank', (Body('rod', 1.0, (0.0, 0.0), INERTIA),),
        (Joint('hinge', REVOLUTE, 'ground', 'rod', (0.0, 0.0)),), (),
        (Point('tip', 'rod', (LENGTH, 0.0)), Point('post', 'ground', (-LENGTH, 0.0))))
    # A whole turn takes longer than without: by Gauss's rule over the angle of the dip.
    low, high, end = 0.0, 1.0, 0.5
    for _ in range(60):
        low, high = (end, high) if depth(end) > 0.0 else (low, end)
        end = 0.5 * (low + high)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    rates = [math.sqrt(RATE ** 2 - effect.stiffness * depth(end * node) ** 2 / INERTIA)
             for node in nodes]
    period = (2.0 * math.pi - 2.0 * end) / RATE + end * float(np.sum(weights / rates))
    turns = 3 if quick else 30
    simulation = Simulation(scene(crank, (-math.pi,), (RATE,), method, {'dip': effect}))
    simulation.step(duration=turns * period)
    return abs(simulation.position[0] + math.pi - 2.0 * math.pi * turns)


def tip_dips(method, quick):
    """Let the tip of a crank dip 1 mm into a line."""
    reach = LENGTH - 1e-3
    return _dips(method, quick, Contact('tip', (reach, 0.0), 1e5, angle=0.5 * math.pi),
                 lambda angle: LENGTH * math.cos(angle) - reach)


def cable_dips(method, quick):
    """Let a crank pull a cable taut by 0.1 mm."""
    reach = 2.0 * LENGTH - 1e-4
    return _dips(method, quick, Cable(('post', 'tip'), 1e6, reach),
                 lambda angle: 2.0 * LENGTH * math.cos(0.5 * angle) - reach)


def graze(method, quick):
    """Turn a ball on a spring round 0.2 um beyond a stop that is a million times as stiff."""
    reach, short, soft, hard = 0.1, 2e-7, 1e4, 1e10
    slow, fast = math.sqrt(soft / MASS), math.sqrt((soft + hard) / MASS)
    stop = reach - short
    met = slow * math.sqrt(reach ** 2 - stop ** 2)
    period = (2.0 * math.pi - 2.0 * math.acos(stop / reach)) / slow + 2.0 * math.atan2(
        met, fast * stop * soft / (soft + hard)) / fast
    simulation = Simulation(scene(
        _ball(False), (0.0,), (slow * reach,), method,
        {'spring': JointSpring('x', soft, 0.0), 'stop': EndStop('x', hard, upper=stop)}))
    simulation.step(duration=(3 if quick else 30) * period)
    return abs(simulation.position[0]) / reach


def indexings(method, quick):
    """Index the wheel of a Geneva drive, its driver ten thousand times as heavy."""
    start = started('geneva_drive', method).scene
    mechanism = replace(start.mechanism, bodies=tuple(
        replace(body, inertia=1e4 * body.inertia) if body.name == 'driver' else body
        for body in start.mechanism.bodies))
    simulation = Simulation(replace(start, mechanism=mechanism))
    turns = 3 if quick else 100
    simulation.step(duration=float(turns))
    return abs(simulation.position[1] - 0.25 * math.pi + 0.5 * math.pi * turns)
