# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Ladder, chain, star and parallelogram, each with a state that closes."""

from dataclasses import replace

from closedloop_dynamics.mechanism.mechanism import Body, Joint, Mechanism
import numpy as np

from .dense import body_frames
from .linkages import closing_cut
from .machines import bar, revolute, revolute_cut
from .states import project


def ladder(loops, tilt=0.0, rate=1.0, length=1.0):
    """
    Return N four-bar loops in a row (benchmark A02) with a state of the parallel branch.

    Parameters
    ----------
    loops : int
        N; 2 N + 1 uniform links of 1 kg, N + 1 of them on the ground, 1 m apart.
    tilt, rate : float
        Angle [rad] and rate [rad/s] of the legs, clockwise from upright.
    length : float
        Of the legs [m]; the couplers keep 1 m.

    Returns
    -------
    mechanism : Mechanism
        Subsystem k is leg k with coupler k on its tip; cut k joins it to leg k + 1.
    q, qd : ndarray, shape (2 N + 1,)

    """
    bodies, joints, cuts, q, qd = [], [], [], [], []
    for index in range(loops + 1):
        leg, coupler = f'leg_{index}', f'coupler_{index}'
        bodies.append(bar(leg, 1.0, length, length / 2.0))
        joints.append(revolute(f'hip_{index}', 'ground', leg, (float(index), 0.0), np.pi / 2.0))
        q.append(-tilt)
        qd.append(-rate)
        if index == loops:
            break
        bodies.append(bar(coupler, 1.0, 1.0, 0.5))
        joints.append(revolute(f'knee_{index}', leg, coupler, (length, 0.0), -np.pi / 2.0))
        q.append(tilt)
        qd.append(rate)
        cuts.append(revolute_cut(f'cut_{index}', coupler, (1.0, 0.0),
                                 f'leg_{index + 1}', (length, 0.0)))
    joints[0] = replace(joints[0], actuated=True)
    mechanism = Mechanism('ladder', tuple(bodies), tuple(joints), tuple(cuts))
    return mechanism, np.array(q), np.array(qd)


def parallelogram(tilt=0.4, rate=1.0):
    """Return a four-bar with legs of 0.6 m and a coupler of 1 m, as in ``ladder``."""
    mechanism, q, qd = ladder(1, tilt, rate, length=0.6)
    return replace(mechanism, name='parallelogram'), q, qd


def scissor_lift(stages, tilt=0.6, rate=0.3, size=1.0):
    """
    Return a scissor lift whose lower right foot stands on a sliding block.

    Parameters
    ----------
    stages : int
        Pairs of crossing bars of 1 kg, pinned in their middles.
    tilt, rate : float
        Angle of the bars [rad] and its rate [rad/s].
    size : float
        Length of the bars [m]; the block is a point of 0.5 kg, its slide is actuated.

    Returns
    -------
    mechanism : Mechanism
        The rising bars are a chain from the ground, a falling one on the middle of each.
    q, qd : ndarray, shape (2 stages + 1,)

    """
    bodies = [Body('block', 0.5, (0.0, 0.0), 0.0)]
    q, qd = [size * np.cos(tilt)], [-size * np.sin(tilt) * rate]
    joints = [Joint('slide', 'prismatic', 'ground', 'block', (0.0, 0.0), 0.0, True)]
    cuts, under, foot = [], 'ground', ('block', (0.0, 0.0))
    for index in range(stages):
        rising, falling = f'rising_{index}', f'falling_{index}'
        bodies += [bar(rising, 1.0, size, 0.5 * size), bar(falling, 1.0, size, 0.0)]
        # The upper left end of a falling bar carries the next rising one.
        joints += [revolute(f'foot_{index}', under, rising, (-0.5 * size * (index > 0), 0.0)),
                   revolute(f'middle_{index}', rising, falling, (0.5 * size, 0.0))]
        q += [tilt if index == 0 else 2.0 * tilt, -2.0 * tilt]
        qd += [rate if index == 0 else 2.0 * rate, -2.0 * rate]
        cuts.append(revolute_cut(f'cut_{index}', falling, (0.5 * size, 0.0), *foot))
        under, foot = falling, (rising, (size, 0.0))
    mechanism = Mechanism('scissor_lift', tuple(bodies), tuple(joints), tuple(cuts))
    return mechanism, np.array(q), np.array(qd)


def chain(rng, links):
    """Return a chain of links from the ground to the ground, one cut at its far end."""
    bodies = tuple(bar(f'link_{index}', 1.0, 1.0, 0.5) for index in range(links))
    parents = ('ground',) + tuple(body.name for body in bodies)
    joints = tuple(revolute(f'joint_{index}', parent, body.name, (1.0 * (index > 0), 0.0),
                            actuated=index == 0)
                   for index, (parent, body) in enumerate(zip(parents, bodies)))
    q = rng.uniform(-1.0, 1.0, links)
    mechanism = Mechanism('chain', bodies, joints)
    cut = closing_cut(rng, 'cut', 'revolute', body_frames(mechanism, q), bodies[-1].name, 'ground')
    mechanism = replace(mechanism, cut_joints=(cut,))
    return mechanism, q, project(mechanism, q, rng.uniform(-1.0, 1.0, links))


def star(rng, legs):
    """Return a hub on one two-link leg, cut from the tips of ``legs`` - 1 others."""
    bodies, joints = [], []
    for index in range(legs):
        direction = 2.0 * np.pi * index / legs
        thigh, shank = f'thigh_{index}', f'shank_{index}'
        bodies += [bar(thigh, 2.0, 1.0, 0.5), bar(shank, 1.0, 1.0, 0.5)]
        place = (float(2.0 * np.cos(direction)), float(2.0 * np.sin(direction)))
        joints += [revolute(f'hip_{index}', 'ground', thigh, place, direction + np.pi - 0.7, True),
                   revolute(f'knee_{index}', thigh, shank, (1.0, 0.0), 1.4)]
    bodies.append(bar('hub', 3.0, 0.5, 0.0))
    joints.append(revolute('joint_hub', 'shank_0', 'hub', (1.0, 0.0)))
    mechanism = Mechanism('star', tuple(bodies), tuple(joints))
    q = rng.uniform(-0.3, 0.3, len(joints))
    frames = body_frames(mechanism, q)
    cuts = tuple(closing_cut(rng, f'cut_{index}', 'revolute', frames, 'hub', f'shank_{index}')
                 for index in range(1, legs))
    mechanism = replace(mechanism, cut_joints=cuts)
    return mechanism, q, project(mechanism, q, rng.uniform(-1.0, 1.0, len(q)))
