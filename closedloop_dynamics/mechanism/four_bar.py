# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Recognise four-bar linkages among planar mechanisms, and classify them."""

import math
from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from .mechanism import GROUND, REVOLUTE

# Rounding, as a share of the largest.
NOTHING = 1e-9


class FourBar(NamedTuple):
    """A loop of four revolute joints."""

    lengths: Tuple[float, float, float, float]  # Of base, input link, coupler and output link [m]
    kind: str  # ``'crank-rocker'``, ...
    grashof: str  # ``'Grashof'``, ``'non-Grashof'`` or ``'change point'``
    #: Angles between input link and base at which coupler and output link are in line [rad].
    limits: Tuple[float, ...]
    output: str  # The joint of the output link on the ground


def four_bar(mechanism, drive) -> Optional[FourBar]:
    """
    Return the links and class of a planar loop of four revolute joints, None for other mechanisms.

    ``drive`` is the driven joint, on the ground.
    """
    chain = bars(mechanism, drive)
    if chain is None:
        return None
    lengths = tuple(math.dist(start, end) for _, start, end, _ in chain)
    return FourBar(lengths, *_kind(lengths), chain[-1][-1])


def bars(mechanism, drive):
    """
    Return the links of a four-bar linkage, from the base on in the order of the loop, or None.

    Name of the body, places of the pin it begins with and of the pin it ends with in its frame,
    and the name of that pin, of base, input link, coupler and output link.
    """
    if not mechanism.planar or len(mechanism.joints) != 3 or len(mechanism.cut_joints) != 1 or any(
            one.type != REVOLUTE for one in (*mechanism.joints, *mechanism.cut_joints)):
        return None
    # Pins on each body; every body of the loop has two.
    pins: Dict[str, List[Tuple[str, np.ndarray]]] = {}
    for joint in mechanism.joints:
        pins.setdefault(joint.parent, []).append((joint.name, np.array(joint.position)))
        pins.setdefault(joint.child, []).append((joint.name, np.zeros(2)))
    for cut in mechanism.cut_joints:
        pins.setdefault(cut.body_a, []).append((cut.name, np.array(cut.point_a)))
        pins.setdefault(cut.body_b, []).append((cut.name, np.array(cut.point_b)))
    grounded = [name for name, _ in pins.get(GROUND, [])]
    if any(len(each) != 2 for each in pins.values()) or drive not in grounded:
        return None
    chain, body, pin = [], GROUND, next(name for name in grounded if name != drive)
    for _ in range(4):
        (start,) = (place for name, place in pins[body] if name == pin)
        pin, end = next((name, place) for name, place in pins[body] if name != pin)
        chain.append((body, start, end, pin))
        body = next(other for other, each in pins.items()
                    if other != body and pin in [name for name, _ in each])
    return chain


def _kind(lengths):
    """Return kind, Grashof class and limits of the input of a four-bar linkage."""
    base, crank, coupler, rocker = lengths
    short, *middle, long = sorted(lengths)
    excess = short + long - sum(middle)
    limits = [(base ** 2 + crank ** 2 - reach ** 2) / (2.0 * base * crank)
              for reach in (coupler + rocker, coupler - rocker)]
    limits = tuple(math.acos(limit) for limit in limits if -1.0 < limit < 1.0)
    if abs(excess) <= NOTHING * long:
        return 'change-point linkage', 'change point', limits
    if excess > 0.0:
        return 'triple rocker', 'non-Grashof', limits
    kinds = {base: 'double crank (drag link)', crank: 'crank-rocker',
             rocker: 'rocker-crank', coupler: 'double rocker'}
    return kinds[short], 'Grashof', limits
