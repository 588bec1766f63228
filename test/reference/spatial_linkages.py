# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Random mechanisms in space with states that close their loops."""

from closedloop_dynamics.mechanism.mechanism import (
    Body, COUPLED, Coupling, CUT_WITH_AXIS_A, CUT_WITH_AXIS_B, CUT_WITH_ORIENTATION, CutJoint,
    DISTANCE, FIXED, FREE, GROUND, HELICAL, Joint, JOINT_FREEDOMS, Mechanism,
    SPATIAL_CUT_JOINT_EQUATIONS, SPHERICAL, UNIVERSAL, WITH_AXIS)
import numpy as np

from . import spatial_maximal as twin


def direction(rng):
    """Return a unit vector; every other time one of the axes."""
    if rng.random() < 0.5:
        return tuple(np.eye(3)[rng.integers(3)])
    vector = rng.normal(size=3)
    return tuple(vector / np.linalg.norm(vector))


def across(rng, axis):
    """Return a unit vector perpendicular to another."""
    vector = np.cross(axis, rng.normal(size=3))
    return tuple(vector / np.linalg.norm(vector))


def quaternion(rng):
    """Return a random unit quaternion."""
    values = rng.normal(size=4)
    return tuple(values / np.linalg.norm(values))


def as_quaternion(rotation):
    """Return the unit quaternion of a rotation."""
    # The eigenvector of the largest eigenvalue of Bar-Itzhack's matrix.
    r = rotation
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
        [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)]])
    return tuple(np.linalg.eigh(k)[1][:, -1])


def random_body(rng, name):
    """Return a body; some are round about an axis of theirs."""
    moments = rng.uniform(0.5, 1.0, 3)
    if rng.random() < 0.3:
        return Body(name, rng.uniform(0.5, 2.0), tuple(rng.normal(size=3) * 0.2),
                    (moments[0], moments[0], moments[2]))
    axes = twin.matrix(quaternion(rng))
    about = axes @ np.diag(moments) @ axes.T
    return Body(name, rng.uniform(0.5, 2.0), tuple(rng.normal(size=3) * 0.2),
                tuple(about[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))


def random_joint(rng, name, kind, parent, child):
    """Return a joint somewhere on its parent."""
    axes = {}
    if kind in WITH_AXIS:
        axes['axis'] = direction(rng)
    if kind == UNIVERSAL:
        axes['second_axis'] = across(rng, axes['axis'])
    if kind == HELICAL:
        axes['lead'] = rng.uniform(0.05, 0.2)
    return Joint(name, kind, parent, child, tuple(rng.normal(size=3) * rng.integers(0, 2, 3)),
                 orientation=quaternion(rng) if rng.random() < 0.5 else (0.0, 0.0, 0.0, 1.0),
                 **axes)


def random_cut(rng, name, kind, first, second, motions):
    """Return a cut joint that a state closes."""
    a, b = motions[first], motions[second]
    point_b = rng.normal(size=3)
    place = b.origin + b.axes @ point_b
    axes = {}
    along = np.array(direction(rng))
    if kind in CUT_WITH_ORIENTATION:
        axes['orientation'] = as_quaternion(b.axes.T @ a.axes)
    if kind == HELICAL:
        # As it is where nothing has slid, or half way round.
        axes['lead'] = rng.uniform(0.05, 0.2)
        turned = rng.integers(0, 2) * np.pi
        place = place + turned * axes['lead'] * along
        axes['orientation'] = as_quaternion(
            b.axes.T @ twin.about(along, turned).T @ a.axes)
    if kind == DISTANCE:
        axes['length'] = rng.uniform(0.5, 1.5)
        place = place + axes['length'] * along
    if kind in CUT_WITH_AXIS_B:
        axes['axis_b'] = tuple(b.axes.T @ along)
    if kind in CUT_WITH_AXIS_A:
        if kind == UNIVERSAL:
            along = np.array(across(rng, along))
        axes['axis_a'] = tuple(a.axes.T @ along)
    return CutJoint(name, kind, first, second, tuple(a.axes.T @ (place - a.origin)),
                    tuple(point_b), **axes)


def random_couplings(rng, joints, q):
    """Return a coupling, or none, of some joints that a state obeys."""
    places = np.cumsum([0] + [twin.coordinates(joint) for joint in joints])
    simple = {joint.name: q[place] for joint, place in zip(joints, places)
              if joint.type in COUPLED}
    if len(simple) < 2 or rng.random() < 0.5:
        return ()
    chosen = rng.permutation(sorted(simple))[:rng.integers(2, 4)]
    factors = {str(name): rng.choice([1.0, rng.normal()]) for name in chosen}
    return (Coupling('coupling', factors,
                     sum(factor * simple[name] for name, factor in factors.items())),)


def random_mechanism(rng, without=(FIXED,)):
    """
    Return a mechanism and a state that closes its loops: (mechanism, q, qd).

    Its cut joints' equations are independent; its tree has no joints of the types left out, but
    for its tips.
    """
    while True:
        bodies, joints = [], []
        for k in range(rng.integers(3, 7)):
            kind = rng.choice(sorted(set(JOINT_FREEDOMS) - set(without))) if k < 5 else FIXED
            parent = GROUND if k == 0 else rng.choice([GROUND] + [one.name for one in bodies])
            bodies.append(random_body(rng, f'body_{k}'))
            joints.append(random_joint(rng, f'joint_{k}', str(kind), str(parent), f'body_{k}'))
        order = rng.permutation(len(joints))
        tree = Mechanism('random', tuple(bodies), tuple(joints[k] for k in order))
        q = np.concatenate([_start(rng, joint) for joint in tree.joints])
        nv = sum(JOINT_FREEDOMS[joint.type] for joint in joints)
        motions = twin.forward(tree, q, np.zeros(nv), np.zeros(nv))[0]
        cuts, names = [], [GROUND] + [body.name for body in bodies]
        for k in range(rng.integers(1, 3)):
            first, second = rng.choice(names, 2, replace=False)
            kind = str(rng.choice(sorted(SPATIAL_CUT_JOINT_EQUATIONS)))
            cuts.append(random_cut(rng, f'cut_{k}', kind, str(first), str(second), motions))
        mechanism = Mechanism('random', tree.bodies, tree.joints, tuple(cuts),
                              couplings=random_couplings(rng, tree.joints, q))
        jac = twin.closure_rates(mechanism, q)
        if len(jac) < nv and np.linalg.svd(jac, compute_uv=False)[-1] > 0.1:
            qd = rng.normal(size=nv)
            for _ in range(2):
                qd = qd - np.linalg.lstsq(jac, jac @ qd, rcond=None)[0]
            return mechanism, q, qd


def _start(rng, joint):
    """Return random coordinates of a joint."""
    values = rng.uniform(-1.0, 1.0, JOINT_FREEDOMS[joint.type])
    if joint.type in (SPHERICAL, FREE):
        return np.concatenate([values[:-3], quaternion(rng)])
    return values
