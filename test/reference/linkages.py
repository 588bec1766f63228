# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Random planar linkages, each with an assembled state.

Trees are drawn first, then coordinates, and only then the cut joints, whose
points and angles are placed where the bodies happen to be: the loops close to
rounding without any assembly.
"""

from dataclasses import replace

from closedloop_dynamics.mechanism.mechanism import (
    Body, Coupling, CUT_JOINT_EQUATIONS, CutJoint, DISTANCE, FIXED, GROUND, Joint, Mechanism,
    POINT_ON_LINE, PRISMATIC, REVOLUTE)
import numpy as np

from .dense import body_frames, closure_jacobian, coordinate, rows, unit
from .states import project, smallest_singular_value

# A linkage nearer to a singularity than this is drawn again, so that the
# conditioning of the solves leaves the comparisons their digits.
WELL_CONDITIONED = 0.1
# A loop moves if some joint in it takes part by this much in a motion of unit rates.
MOVING = 0.1


def local(frame, place):
    """Return a world place in the frame (origin, angle)."""
    origin, angle = frame
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = place - origin
    return float(cos * x + sin * y), float(cos * y - sin * x)


def random_vector(rng, size=1.0):
    """Return a point within a square of half side ``size``."""
    return tuple(float(value) for value in rng.uniform(-size, size, 2))


def random_tree(rng, n_subsystems, max_bodies, prismatic):
    """Return (bodies, joints, subsystems): branching trees on the ground."""
    bodies, joints, subsystems = [], [], []
    for _ in range(n_subsystems):
        members = []
        for _ in range(rng.integers(1, max_bodies + 1)):
            number = len(bodies) + 1
            parent = members[rng.integers(len(members))] if members else GROUND
            bodies.append(Body(f'body_{number}', float(rng.uniform(0.5, 3.0)),
                               random_vector(rng, 0.5), float(rng.uniform(0.05, 0.5))))
            joints.append(Joint(
                f'joint_{number}', PRISMATIC if rng.random() < prismatic else REVOLUTE,
                parent, bodies[-1].name, random_vector(rng, 2.0 if parent == GROUND else 1.0),
                float(rng.uniform(-np.pi, np.pi)), bool(rng.random() < 0.5)))
            members.append(bodies[-1].name)
        subsystems.append(members)
    return bodies, joints, subsystems


def random_pair(rng, subsystems):
    """Return two different bodies: of two subsystems, of one, or one and the ground."""
    kind = rng.random()
    if kind < 0.2:
        members = subsystems[rng.integers(len(subsystems))]
        pair = [GROUND, members[rng.integers(len(members))]]
    elif kind < 0.4:
        members = subsystems[rng.integers(len(subsystems))]
        pair = list(rng.choice(members, 2, replace=False)) if len(members) > 1 else None
    else:
        pair = None
        if len(subsystems) > 1:
            first, second = rng.choice(len(subsystems), 2, replace=False)
            pair = [rng.choice(subsystems[first]), rng.choice(subsystems[second])]
    if pair is None:
        return random_pair(rng, subsystems)
    return [str(name) for name in rng.permutation(pair)]


def closing_cut(rng, name, kind, frames, body_a, body_b):
    """Return a cut joint of the given type between two bodies, closed as they stand."""
    place = 0.5 * (frames[body_a][0] + frames[body_b][0]) + rng.uniform(-0.5, 0.5, 2)
    angle = (0.0 if kind in (REVOLUTE, DISTANCE)
             else float(frames[body_a][1] - frames[body_b][1]))
    place_a, length = place, None
    if kind in (PRISMATIC, POINT_ON_LINE):
        # Anywhere along the axis, which points along body A's x axis turned by nothing.
        place_a = place + rng.uniform(-1.0, 1.0) * unit(frames[body_b][1] + angle)
    if kind == DISTANCE:
        length = float(rng.uniform(0.3, 1.5))
        place_a = place + length * unit(rng.uniform(-np.pi, np.pi))
    return CutJoint(name, kind, body_a, body_b, local(frames[body_a], place_a),
                    local(frames[body_b], place), angle, length=length)


def every_loop_moves(mechanism, q):
    """Return whether no cut joint locks its loop: a locked one would test statics only."""
    jac = closure_jacobian(mechanism, q)
    motions = np.linalg.svd(jac)[2][len(jac):]
    parts = np.abs(jac) * np.linalg.norm(motions, axis=0)
    return all(parts[part].max() > MOVING for part in rows(mechanism).values())


def random_linkage(rng, n_subsystems=3, max_bodies=5, max_cuts=4, prismatic=0.3, shuffle=False,
                   cut_types=(REVOLUTE, PRISMATIC, FIXED)):
    """
    Draw a linkage and a state that closes its loops.

    Parameters
    ----------
    rng : numpy.random.Generator
        Seeded source of everything drawn.
    n_subsystems, max_bodies, max_cuts : int
        Trees, most bodies in each, most cut joints.
    prismatic : float
        Probability of a tree joint being prismatic.
    shuffle : bool
        Whether bodies and joints are listed in random order, children before parents.
    cut_types : tuple of str
        Types of cut joints to draw from.

    Returns
    -------
    mechanism : Mechanism
        Always with a cut joint, no loop locked, and a well-conditioned Jacobian.
    q, qd : ndarray, shape (nv,)
        Coordinates and rates that satisfy the closures to rounding.

    """
    while True:
        bodies, joints, subsystems = random_tree(rng, n_subsystems, max_bodies, prismatic)
        if len(bodies) < 3:
            continue
        if shuffle:
            joints = [joints[index] for index in rng.permutation(len(joints))]
            bodies = [bodies[index] for index in rng.permutation(len(bodies))]
        mechanism = Mechanism('random_linkage', tuple(bodies), tuple(joints))
        q = rng.uniform(-1.5, 1.5, len(joints))
        mechanism = with_random_cuts(rng, mechanism, q, subsystems, max_cuts, cut_types)
        if mechanism.cut_joints:
            return mechanism, q, project(mechanism, q, rng.uniform(-2.0, 2.0, len(q)))


def with_elements(rng, couplings=2):
    """
    Draw a linkage with rods, pins in slots and couplings, cut joints' among them, and a state.

    Parameters
    ----------
    rng : numpy.random.Generator
        Seeded source of everything drawn.
    couplings : int
        Most of them; one at least.

    Returns
    -------
    mechanism, q, qd
        As of ``random_linkage``.

    """
    while True:
        mechanism, q, _ = random_linkage(rng, 3, cut_types=(REVOLUTE, DISTANCE, POINT_ON_LINE))
        frames = body_frames(mechanism, q)
        names = [*mechanism.joint_names, *(
            cut.name for cut in mechanism.cut_joints if cut.type == REVOLUTE)]
        for k in range(4 * couplings):
            if len(mechanism.couplings) == couplings or (
                    len(q) - mechanism.number_of_equations < 2):
                break
            picked = rng.choice(names, min(len(names), rng.integers(1, 4)), replace=False)
            factors = {str(name): float(rng.uniform(0.3, 2.0) * rng.choice([-1.0, 1.0]))
                       for name in picked}
            offset = sum(factor * coordinate(mechanism, q, frames, name)
                         for name, factor in factors.items())
            coupled = replace(mechanism, couplings=(*mechanism.couplings, Coupling(
                f'coupling_{len(mechanism.couplings) + 1}', factors, float(offset))))
            if smallest_singular_value(coupled, q) > WELL_CONDITIONED and (
                    every_loop_moves(coupled, q)):
                mechanism = coupled
        if mechanism.couplings:
            return mechanism, q, project(mechanism, q, rng.uniform(-2.0, 2.0, len(q)))


def with_random_cuts(rng, mechanism, q, subsystems, max_cuts, cut_types):
    """Return the mechanism with as many closing cut joints as a few attempts yield."""
    frames = body_frames(mechanism, q)
    for _ in range(4 * max_cuts):
        kind = str(rng.choice(cut_types))
        left = len(q) - mechanism.number_of_equations - CUT_JOINT_EQUATIONS[kind]
        if left < 1 or len(mechanism.cut_joints) == max_cuts:
            continue
        cut = closing_cut(rng, f'cut_{len(mechanism.cut_joints) + 1}', kind, frames,
                          *random_pair(rng, subsystems))
        closed = replace(mechanism, cut_joints=mechanism.cut_joints + (cut,))
        if smallest_singular_value(closed, q) > WELL_CONDITIONED and every_loop_moves(closed, q):
            mechanism = closed
    return mechanism
