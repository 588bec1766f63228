# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms of any size, closed as they are built, to study how costs grow."""

import math

from closedloop_dynamics.mechanism.mechanism import (
    Body, Coupling, CutJoint, FREE, GROUND, Joint, Mechanism, REVOLUTE)
from hard_machines import bar


def ladder(loops, angle=0.5):
    """
    Build N + 1 cranks side by side on the ground, N couplers between their tips: N loops.

    Each crank carries the coupler to the next one, where it is cut: the cut joints form a chain
    between subsystems of two bodies. All bars are uniform, 1 m long, of 1 kg. Upright at ``angle``
    pi / 2, flat and singular at 0 [rad]. Returns the mechanism, of 2 N + 1 joints and 2 N
    equations, and coordinates that close the loops.
    """
    bodies, joints, cuts, position = [], [], [], []
    for k in range(loops + 1):
        bodies.append(bar(f'crank_{k}', 1.0, 1.0))
        joints.append(Joint(f'pivot_{k}', REVOLUTE, GROUND, f'crank_{k}', (float(k), 0.0),
                            actuated=k == 0))
        position.append(angle)
        if k < loops:
            bodies.append(bar(f'coupler_{k}', 1.0, 1.0))
            joints.append(Joint(f'tip_{k}', REVOLUTE, f'crank_{k}', f'coupler_{k}', (1.0, 0.0)))
            position.append(-angle)
            cuts.append(CutJoint(f'cut_{k}', REVOLUTE, f'coupler_{k}', f'crank_{k + 1}',
                                 (1.0, 0.0), (1.0, 0.0)))
    return Mechanism(f'ladder_{loops}', tuple(bodies), tuple(joints), tuple(cuts)), tuple(position)


def chain(links):
    """
    Build N >= 3 links in a row, together 1 m long, hung up at both ends along a half circle.

    Returns the mechanism, of N joints and one cut joint: 2 equations, and coordinates that close
    it.
    """
    length, turn = 1.0 / links, math.pi / links
    bodies = tuple(bar(f'link_{k}', length, length) for k in range(links))
    joints = [Joint('joint_0', REVOLUTE, GROUND, 'link_0', (0.0, 0.0), actuated=True)]
    joints += [Joint(f'joint_{k}', REVOLUTE, f'link_{k - 1}', f'link_{k}', (length, 0.0))
               for k in range(1, links)]
    angles = [-math.pi / 2 + (k + 0.5) * turn for k in range(links)]
    end = tuple(length * math.fsum(part(angle) for angle in angles)
                for part in (math.cos, math.sin))
    cut = CutJoint('cut', REVOLUTE, f'link_{links - 1}', GROUND, (length, 0.0), end)
    position = (angles[0], *[turn] * (links - 1))
    return Mechanism(f'chain_{links}', bodies, tuple(joints), (cut,)), position


def star(loops, arms=8, angle=0.5):
    """
    Build so many ladders (arms) of N loops that meet at one crank: a star of subsystems.

    The subsystem in the middle touches as many cut joints as there are arms, every other one two.
    All cranks turn alike [rad], as in a ladder. Returns the mechanism, of 2 arms loops + 1 joints
    and one equation less, and coordinates that close the loops.
    """
    bodies, cuts = [bar('hub', 1.0, 1.0)], []
    joints = [Joint('pivot', REVOLUTE, GROUND, 'hub', (0.0, 0.0), actuated=True)]
    position = [angle]
    for arm in range(arms):
        turn = 2.0 * math.pi * arm / arms
        x, y = math.cos(turn), math.sin(turn)
        before = 'hub'
        for k in range(1, loops + 1):
            crank, coupler = f'crank_{arm}_{k}', f'coupler_{arm}_{k}'
            bodies += [bar(crank, 1.0, 1.0), bar(coupler, 1.0, 1.0)]
            joints += [
                Joint(f'pivot_{arm}_{k}', REVOLUTE, GROUND, crank, (k * x, k * y)),
                Joint(f'tip_{arm}_{k}', REVOLUTE, before, coupler, (1.0, 0.0))]
            position += [angle, turn - angle]
            cuts.append(CutJoint(f'cut_{arm}_{k}', REVOLUTE, coupler, crank, (1.0, 0.0),
                                 (1.0, 0.0)))
            before = crank
    mechanism = Mechanism(f'star_{arms}_{loops}', tuple(bodies), tuple(joints), tuple(cuts))
    return mechanism, tuple(position)


# Of bodies in space: their axis, mass [kg], centre [m] and moments of inertia [kg m^2].
_UPRIGHT, _LINK = (0.0, 0.0, 1.0), (3.0, (0.2, 0.05, 0.0), (0.01, 0.03, 0.04))


def tower(loops, branches=1, angles=(0.8,)):
    """
    Build so many towers of N four-bars in space, each on the crank of the last, on a free body.

    Parallelograms of cranks of 0.5 m and couplers of 1 m: one joint of three is independent.
    ``angles`` of the cranks [rad], from the free body on, over and over again. Returns the
    mechanism, of 6 + 3 N joints a branch and 2 N equations, and coordinates that close the loops.
    """
    bodies, cuts = [Body('base', 5.0, (0.0, 0.0, 0.0), (0.1, 0.2, 0.3))], []
    joints, position = [Joint('float', FREE, GROUND, 'base', (0.0, 0.0, 0.0))], [
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    for branch in range(branches):
        carrier = 'base'
        for k in range(loops):
            crank, other, coupler = (
                f'{name}_{branch}_{k}' for name in ('crank', 'other', 'coupler'))
            bodies += [Body(name, *_LINK) for name in (crank, other, coupler)]
            joints += [Joint(name, REVOLUTE, parent, name, (x, 0.0, 0.0), axis=_UPRIGHT,
                             actuated=name == other)
                       for name, parent, x in ((crank, carrier, 1.0), (other, carrier, 0.0),
                                               (coupler, other, 0.5))]
            cuts.append(CutJoint(
                f'cut_{branch}_{k}', REVOLUTE, crank, coupler, (0.5, 0.0, 0.0), (1.0, 0.0, 0.0),
                axis_a=_UPRIGHT, axis_b=_UPRIGHT))
            angle, carrier = angles[(branch * loops + k) % len(angles)], crank
            position += [angle, angle, -angle]
    return Mechanism(f'tower_{branches}_{loops}', tuple(bodies), tuple(joints), tuple(cuts)), (
        tuple(position))


def geared_arm(links, ratio=6.0):
    """
    Build N links in a row in space on a free body, each with a geared rotor on the one before.

    Axes across one another. Returns the mechanism, of 6 + 2 N joints and N equations, and
    coordinates.
    """
    bodies, joints, gears = [Body('base', 5.0, (0.0, 0.0, 0.0), (0.1, 0.2, 0.3))], [
        Joint('float', FREE, GROUND, 'base', (0.0, 0.0, 0.0))], []
    carrier = 'base'
    for k in range(links):
        link, rotor, axis = f'link_{k}', f'rotor_{k}', _UPRIGHT if k % 2 else (0.0, 1.0, 0.0)
        bodies += [Body(link, *_LINK), Body(rotor, 0.1, (0.0, 0.0, 0.0), (1e-4, 1e-4, 1e-4))]
        joints += [Joint(name, REVOLUTE, carrier, name, (0.5, 0.0, 0.0), axis=axis,
                         actuated=name == rotor) for name in (link, rotor)]
        gears.append(Coupling(f'gear_{k}', {link: ratio, rotor: -1.0}))
        carrier = link
    position = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    for k in range(links):
        position += [0.3 * k, ratio * 0.3 * k]
    return Mechanism(f'geared_arm_{links}', tuple(bodies), tuple(joints),
                     couplings=tuple(gears)), tuple(position)
