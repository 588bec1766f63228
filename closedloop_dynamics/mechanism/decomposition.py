# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Subsystems, cut-joint graph and elimination order, found from the description.

Cut at its cut joints, a mechanism falls into trees that stand on the ground,
one per joint to the ground: the subsystems. Two cut joints are neighbours in
the cut-joint graph when they touch a common subsystem; eliminating a cut joint
joins its remaining neighbours, which is the fill that a good order keeps low.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import FrozenSet, NamedTuple, Tuple

import numpy as np

from .mechanism import GROUND

# Up to so many cut joints are ordered here: importing SciPy's sparse matrices takes a fifth of a
# start.
FEW_CUT_JOINTS = 40


@dataclass(frozen=True)
class Decomposition:
    """Topology of a mechanism for the block elimination."""

    subsystems: Tuple[Tuple[str, ...], ...]  # Joint names of each subsystem, parents first
    #: Indices into ``mechanism.joints``, subsystem by subsystem, parents first.
    joint_order: Tuple[int, ...]
    #: Indices of the subsystems that each cut joint touches.
    cut_subsystems: Tuple[Tuple[int, ...], ...]
    #: Names of the cut joints and couplings in the order they are eliminated.
    elimination_order: Tuple[str, ...]
    cut_order: Tuple[int, ...]  # The same as indices into ``mechanism.closures``
    #: For each place in the elimination order, the later places that its block column of the
    #: factor reaches.
    structure: Tuple[FrozenSet[int], ...]
    fill: int  # Blocks of the factor that are zero in the constraint matrix


def decompose(mechanism):
    """Decompose a valid mechanism into tree-type subsystems and order its cut joints."""
    cuts = tuple(_Cut(cut.name, (cut.body_a, cut.body_b)) for cut in mechanism.cut_joints)
    moved = [_Cut(joint.name, (joint.child,)) for joint in mechanism.joints] + list(cuts)
    return _decompose(
        tuple(_Joint(joint.name, joint.parent, joint.child) for joint in mechanism.joints),
        cuts + tuple(
            _Cut(one.name, tuple(body for joint in moved if joint.name in one.names
                                 for body in joint.bodies)) for one in mechanism.couplings)
        + tuple(_Cut(one.name, moved_bodies(mechanism, one)) for one in mechanism.motions))


def moved_bodies(mechanism, motion):
    """Return the names of the bodies with a prescribed motion of their joint or a point."""
    if motion.freedom is None:
        return (mechanism.point(motion.point).body,)
    joint = mechanism.coordinates.joint_of(motion.freedom)
    cut = mechanism.cut_joint(joint)
    if cut is not None:
        return cut.body_a, cut.body_b
    return tuple(each.child for each in mechanism.joints if each.name == joint)


class _Joint(NamedTuple):
    name: str
    parent: str
    child: str


class _Cut(NamedTuple):
    name: str
    bodies: tuple


# Many simulations of one mechanism differ in numbers only.
@lru_cache(maxsize=4)
def _decompose(joints, cut_joints):
    """Decompose a mechanism given by its topology alone."""
    trees = _subsystems(joints)
    subsystem_of = {
        joints[j].child: k for k, tree in enumerate(trees) for j in tree}
    cut_subsystems = tuple(
        tuple(sorted({subsystem_of[body] for body in cut.bodies if body != GROUND}))
        for cut in cut_joints)
    order, structure, fill = _eliminated(_cut_joint_graph(cut_subsystems, len(trees)))
    return Decomposition(
        subsystems=tuple(tuple(joints[j].name for j in tree) for tree in trees),
        joint_order=tuple(j for tree in trees for j in tree),
        cut_subsystems=cut_subsystems,
        elimination_order=tuple(cut_joints[a].name for a in order),
        cut_order=order,
        structure=structure,
        fill=fill)


def structure_of(touched):
    """
    Order cut joints that touch subsystems, and list the blocks that elimination reaches.

    ``touched``: the subsystems that each cut joint touches, numbers of any kind; order and
    structure are as ``Decomposition`` has them.
    """
    numbers = {key: number for number, key in enumerate(sorted(set().union(*touched)))}
    return _eliminated(_cut_joint_graph(
        [[numbers[key] for key in sorted(some)] for some in touched], len(numbers)))[:2]


def _eliminated(neighbours):
    """Return the order of elimination, the structure of each column, and the fill."""
    order = _elimination_order(neighbours)
    return (order, *_fill(neighbours, order))


def _subsystems(joints):
    """Return the joint indices of each tree rooted at the ground, parents first."""
    children = {}
    for index, joint in enumerate(joints):
        children.setdefault(joint.parent, []).append(index)
    trees = []
    for root in children.get(GROUND, []):
        tree, waiting = [], [root]
        while waiting:
            index = waiting.pop()
            tree.append(index)
            waiting.extend(reversed(children.get(joints[index].child, [])))
        trees.append(tuple(tree))
    return tuple(trees)


def _cut_joint_graph(cut_subsystems, count):
    """Return the set of neighbours of each cut joint."""
    touching = [[] for _ in range(count)]
    for cut, subsystems in enumerate(cut_subsystems):
        for k in subsystems:
            touching[k].append(cut)
    return tuple(
        frozenset(b for k in subsystems for b in touching[k]) - {a}
        for a, subsystems in enumerate(cut_subsystems))


def _elimination_order(neighbours):
    """Return a minimum-degree order of the cut joints."""
    n = len(neighbours)
    if n <= FEW_CUT_JOINTS:
        return _small_elimination_order(neighbours)
    # SuperLU's multiple minimum degree.
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu
    rows = [a for a in range(n) for _ in range(len(neighbours[a]) + 1)]
    columns = [b for a in range(n) for b in (a, *sorted(neighbours[a]))]
    # Only the pattern matters; a dominant diagonal keeps the factorization from pivoting.
    values = [float(n) + 1.0 if a == b else 1.0 for a, b in zip(rows, columns)]
    factors = splu(csc_matrix((values, (rows, columns)), shape=(n, n)),
                   permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0,
                   options={'SymmetricMode': True})
    return tuple(int(a) for a in np.argsort(factors.perm_c))


def _small_elimination_order(neighbours):
    """Eliminate a cut joint that has the fewest neighbours left, and join these; again."""
    left = {a: set(others) for a, others in enumerate(neighbours)}
    # Among equals the one that has waited longest, so that later ones need not wait for the last.
    changed = dict.fromkeys(left, -1)
    order = []
    while left:
        a = min(left, key=lambda cut: (len(left[cut]), changed[cut]))
        others = left.pop(a)
        for b in others:
            left[b] |= others
            left[b] -= {a, b}
            changed[b] = len(order)
        order.append(a)
    return tuple(order)


def _fill(neighbours, order):
    """Return the structure of every block column of the factor, and the number of fill blocks."""
    place = {cut: k for k, cut in enumerate(order)}
    reach = [{place[b] for b in neighbours[a] if place[b] > k} for k, a in enumerate(order)]
    blocks = sum(len(later) for later in reach)
    for later in reach:
        if later:
            # Eliminating a column passes its fill-in to the first column it reaches.
            first = min(later)
            reach[first] |= later - {first}
    return tuple(frozenset(later) for later in reach), sum(map(len, reach)) - blocks
