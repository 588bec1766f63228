# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The hard cases of the stability atlas in which a contact is short: grazed, or soon passed."""

from dataclasses import replace
import math

from closedloop_dynamics.effects.body_contact import BodyContact
from closedloop_dynamics.effects.cable import Cable
from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.mechanism.mechanism import (
    Body, Joint, Mechanism, Point, PRISMATIC, REVOLUTE)
from closedloop_dynamics.simulation.simulation import Simulation
from hard_machines import scene, started
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


def shot(speed, half, stiffness, in_space=False, **shape):
    """
    Return a case: a ball flies straight at a solid and back.

    ``half`` is that of the solid's thickness [m], a plate where no ``shape`` is given, of a
    ``stiffness`` [N/m] at which the ball turns round in the nearer half; ``speed`` in m/s,
    ``shape`` keys of the contact.
    """
    def run(method, quick):
        keys = shape or {'shape': 'curve', 'interpolation': 'linear',
                         'x': (-half, half, half, -half), 'y': (-1.0, -1.0, 1.0, 1.0)}
        effect = BodyContact('ball', 'target', stiffness=stiffness, **keys)
        duration, way = 2.0 * abs(START) / speed, abs(START) - half
        touch = math.pi * math.sqrt(MASS / stiffness)
        end = -half - speed * (duration - way / speed - touch)
        simulation = Simulation(scene(
            _ball(in_space), (START,), (speed,), method, {'solid': effect}))
        simulation.step(duration=duration)
        return abs(simulation.position[0] - end) / abs(START)
    return run


def dips(effect, stiffness, depth):
    """
    Return a case: a crank is held up a little once a turn, for a short while.

    By an effect without losses about the angle 0, of a stiffness [N/m]; ``depth`` gives how deep
    it is at an angle [m].
    """
    def run(method, quick):
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
        rates = [math.sqrt(RATE ** 2 - stiffness * depth(end * node) ** 2 / INERTIA)
                 for node in nodes]
        period = (2.0 * math.pi - 2.0 * end) / RATE + end * float(np.sum(weights / rates))
        turns = 3 if quick else 30
        simulation = Simulation(scene(crank, (-math.pi,), (RATE,), method, {'dip': effect}))
        simulation.step(duration=turns * period)
        return abs(simulation.position[0] + math.pi - 2.0 * math.pi * turns)
    return run


def _graze(method, quick):
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


def _indexings(method, quick):
    """Index the wheel of a Geneva drive, its driver ten thousand times as heavy."""
    start = started('geneva_drive', method).scene
    mechanism = replace(start.mechanism, bodies=tuple(
        replace(body, inertia=1e4 * body.inertia) if body.name == 'driver' else body
        for body in start.mechanism.bodies))
    simulation = Simulation(replace(start, mechanism=mechanism))
    turns = 3 if quick else 100
    simulation.step(duration=float(turns))
    return abs(simulation.position[1] - 0.25 * math.pi + 0.5 * math.pi * turns)


_ERROR = 'error of its place, relative'
_PHASE = 'error of the angle [rad]'
_REACH = LENGTH - 1e-3
AT_CONTACTS = (
    ('plate of 20 mm, 1 m/s',
     'A ball of 0.5 kg flies at a plate of 1e6 N/m, and back.', _ERROR, 1e-6, 1e-3,
     shot(1.0, 0.01, 1e6)),
    ('plate of 100 mm, 10 m/s', 'The same, ten times as fast.', _ERROR, 1e-6, 1e-3,
     shot(10.0, 0.05, 1e6)),
    ('plate of 1 mm, 100 m/s', 'The same at a thin plate of 1e12 N/m.', _ERROR, 1e-6, 1e-3,
     shot(100.0, 5e-4, 1e12)),
    ('circle of 50 mm, 10 m/s', 'The same at a circle of 1e8 N/m.', _ERROR, 1e-6, 1e-3,
     shot(10.0, 0.025, 1e8, shape='circle', other_radius=0.025)),
    ('sphere of 50 mm, 10 m/s', 'The same at a sphere, in space.', _ERROR, 1e-6, 1e-3,
     shot(10.0, 0.025, 1e8, True, shape='sphere', other_radius=0.025)),
    ('cylinder of 50 mm, 10 m/s', 'The same across a cylinder, in space.', _ERROR, 1e-6, 1e-3,
     shot(10.0, 0.025, 1e8, True, shape='cylinder', axis=(0.0, 1.0, 0.0), other_radius=0.025)),
    ('tip dips 1 mm',
     'A crank turns freely, but for its tip, which dips 1 mm into a line each turn and comes out '
     'again without losses: 30 turns (else 3) take as long as an integral says.', _PHASE, 1e-5,
     1e-2, dips(Contact('tip', (_REACH, 0.0), 1e5, angle=0.5 * math.pi), 1e5,
                lambda angle: LENGTH * math.cos(angle) - _REACH), '30 turns / 3'),
    ('cable taut for 0.1 mm',
     'The same with a cable that is taut by 0.1 mm each turn.', _PHASE, 1e-5, 1e-2,
     dips(Cable(('post', 'tip'), 1e6, 2.0 * LENGTH - 1e-4), 1e6,
          lambda angle: 2.0 * LENGTH * math.cos(0.5 * angle) - (2.0 * LENGTH - 1e-4)),
     '30 turns / 3'),
    ('stop dented by 0.2 um',
     'A ball on a spring turns round just beyond a stop a million times as stiff, which an error '
     'of 1e-9 m in how far it comes changes by half a percent.', _ERROR, 1e-4, 1e-2, _graze,
     '30 times / 3'),
    ('Geneva drive',
     'The Geneva drive indexes its wheel a hundred times (else three), with a heavy driver: the '
     'wheel rests in its slots.', 'error of the angle of its wheel [rad]', 1e-2, 0.1, _indexings,
     '100 turns / 3'),
)
