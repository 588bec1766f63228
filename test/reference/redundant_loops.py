# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Random mechanisms in space of several loops, most of which repeat equations, and states."""

from typing import NamedTuple

from closedloop_dynamics.mechanism.mechanism import (
    Body, CUT_WITH_AXIS_A, CUT_WITH_AXIS_B, CUT_WITH_ORIENTATION, CutJoint, CYLINDRICAL, GROUND,
    Joint, JOINT_FREEDOMS, Mechanism, PLANAR, POINT_ON_LINE, PRISMATIC, REVOLUTE, SPHERICAL,
    UNIVERSAL)
import numpy as np

from . import spatial_maximal as twin
from .spatial_linkages import random_body

# Cut joints that leave loops their motion: in a plane, about a point, without turning.
CLOSING = {'plane': (REVOLUTE, REVOLUTE, CYLINDRICAL, SPHERICAL, POINT_ON_LINE, PLANAR),
           'point': (REVOLUTE, REVOLUTE, UNIVERSAL, CYLINDRICAL),
           'slides': (PRISMATIC, PRISMATIC, CYLINDRICAL)}
# Bodies of the first leg of a loop, at least: fewer would not move.
SHORTEST = {'plane': 3, 'point': 3, 'slides': 3}
# Smallest singular value of the equations that repeat no other, at the start.
REGULAR, DEPENDENT = 0.02, 1e-9
DECADES = 6.0
IDENTITY = (0.0, 0.0, 0.0, 1.0)


class Loops(NamedTuple):
    """A random mechanism and a state that closes its loops."""

    mechanism: Mechanism
    q: np.ndarray     # Shape (nq,)
    qd: np.ndarray    # Shape (nv,)
    repeated: int     # Equations that repeat others


class _Builder:
    """Bodies, joints and cut joints as they are added; all frames are parallel at q = 0."""

    def __init__(self, rng):
        self.rng, self.bodies, self.joints, self.cuts = rng, [], [], []
        # Places of the bodies' frames at q = 0, which closes all loops.
        self.place = {GROUND: np.zeros(3)}

    def body(self, parent, at, kind, axis=None):
        """Add a body by a joint at a place of the world; return its name."""
        name = f'body_{len(self.bodies)}'
        self.bodies.append(random_body(self.rng, name))
        self.joints.append(Joint(
            f'joint_{len(self.joints)}', kind, parent, name, tuple(at - self.place[parent]),
            axis=None if axis is None else tuple(axis), actuated=axis is not None))
        self.place[name] = at
        return name

    def cut(self, kind, first, second, at, axis):
        """Add a cut joint at a place of the world."""
        axes = {}
        if kind in CUT_WITH_AXIS_B:
            axes['axis_b'] = tuple(axis)
        if kind in CUT_WITH_AXIS_A:
            axes['axis_a'] = tuple(_across(self.rng, axis) if kind == UNIVERSAL else axis)
        if kind in CUT_WITH_ORIENTATION:
            axes['orientation'] = (0.0, 0.0, 0.0, 1.0)
        self.cuts.append(CutJoint(
            f'cut_{len(self.cuts)}', kind, first, second, tuple(at - self.place[first]),
            tuple(at - self.place[second]), **axes))


def _across(rng, axis):
    vector = np.cross(axis, rng.normal(size=3))
    return vector / np.linalg.norm(vector)


def _direction(rng):
    vector = rng.normal(size=3) if rng.random() < 0.7 else np.eye(3)[rng.integers(3)]
    return vector / np.linalg.norm(vector)


def _add_loops(builder, kind, count):
    """Add so many loops of a kind, on the ground or on a body that is there."""
    rng = builder.rng
    base = str(rng.choice(list(builder.place)))
    axis, center = _direction(rng), builder.place[base] + 0.3 * rng.normal(size=3)
    members = [base]
    for number in range(count):
        first, last = (base, base) if number == 0 else (
            str(name) for name in rng.choice(members, 2, replace=True))
        least = SHORTEST[kind] if first == last else SHORTEST[kind] - 1
        body = first
        for _ in range(least + int(rng.random() < 0.3)):
            at, along = _place(rng, kind, center, axis)
            body = builder.body(
                body, at, PRISMATIC if kind == 'slides' else REVOLUTE, along)
            members.append(body)
        at, along = _place(rng, kind, center, axis)
        closing = str(rng.choice(CLOSING[kind]))
        if closing == PLANAR:
            # It would leave out what the loop needs; a pin beside it repeats more.
            builder.cut(REVOLUTE, body, last, at, along)
        builder.cut(closing, body, last, at, along)
        if rng.random() < 0.15 and closing in (REVOLUTE, SPHERICAL) and kind == 'plane':
            # The same hinge once more, farther along its axis.
            builder.cut(str(rng.choice((REVOLUTE, SPHERICAL))), body, last, at + 0.2 * along,
                        along)


def _place(rng, kind, center, axis):
    """Return a place of a joint of a loop, and its direction."""
    if kind == 'plane':
        return center + 0.5 * _across(rng, axis) * rng.uniform(0.3, 1.5) + (
            rng.normal() * 0.1 * axis), axis
    along = _direction(rng)
    if kind == 'point':
        return center + along * rng.uniform(-0.5, 0.5), along
    return center + 0.5 * rng.normal(size=3), along


def random_loops(rng, most=10):
    """
    Return a mechanism of two to four loops, most of them redundant, with masses over six decades.

    ``most``: bodies at most.
    """
    while True:
        builder, left = _Builder(rng), int(rng.integers(2, 5))
        if rng.random() < 0.25:
            builder.body(GROUND, rng.normal(size=3) * 0.3, SPHERICAL)
        while left > 0:
            count = int(rng.integers(1, left + 1))
            _add_loops(builder, str(rng.choice(('plane', 'plane', 'point', 'slides'))), count)
            left -= count
        if len(builder.bodies) > most or len(builder.cuts) > 4:
            continue
        factors = 10.0 ** rng.uniform(-DECADES, 0.0, len(builder.bodies))
        bodies = tuple(Body(body.name, body.mass * factor, body.center_of_mass, tuple(
            0.1 * value * factor for value in body.inertia))
            for body, factor in zip(builder.bodies, factors))
        mechanism = Mechanism('loops', bodies, tuple(builder.joints), tuple(builder.cuts))
        nv = sum(JOINT_FREEDOMS[joint.type] for joint in builder.joints)
        q = np.concatenate([IDENTITY if joint.type == SPHERICAL else (0.0,)
                            for joint in builder.joints])
        jac = twin.closure_rates(mechanism, q)
        singular = np.linalg.svd(jac, compute_uv=False)
        rank = int((singular > DEPENDENT * singular[0]).sum())
        if rank == nv or singular[rank - 1] < REGULAR:
            continue
        free = np.linalg.svd(jac)[2][rank:]
        qd = free.T @ rng.normal(size=len(free)) * 10.0 ** rng.uniform(0.0, 1.3)
        return Loops(mechanism, q, qd, len(jac) - rank)
