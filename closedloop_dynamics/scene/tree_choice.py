# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Of a mechanism described without a tree the one that takes the fewest operations."""

from ..codegen.routines import operations
from ..kinematics.modeling import build_model
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import MechanismError
from ..mechanism.reader import with_cuts

# Operations that are counted in a search: about a second.
MOST_COUNTED = 40_000
# Trees of more joints are left as they are estimated.
MOST_JOINTS = 40


def count_operations(mechanism):
    """
    Count the operations of one evaluation of a mechanism with a tree, None if it is too large.

    Additions, multiplications, divisions, negations. MechanismError where a loop cannot close.
    """
    if len(mechanism.joints) > MOST_JOINTS:
        return None
    return operations(build_model(mechanism))


def cheapest(mechanism):
    """Exchange joints that are cut for others, one by one, as long as that saves operations."""
    if mechanism.tree is None or len(mechanism.joints) > MOST_JOINTS:
        return mechanism
    best, fewest = mechanism, _counted(mechanism)
    if fewest is None:
        return mechanism
    spent, seen = fewest, {frozenset(mechanism.tree.cut)}
    while True:
        found = best
        for other in _neighbours(best, seen):
            count = _counted(other)
            if count is not None:
                spent += count
                if count < fewest:
                    found, fewest = other, count
            if spent > MOST_COUNTED:
                return found
        if found is best:
            return best
        best = found


def _counted(mechanism):
    """Return how many operations a mechanism takes, None where its loops cannot close."""
    try:
        return count_operations(mechanism)
    except MechanismError:
        return None


def _neighbours(mechanism, seen):
    """Yield the mechanisms with one other joint cut that were not seen yet."""
    cut = mechanism.tree.cut
    for chord in cut:
        for name in mechanism.tree.open:
            members = frozenset(cut) - {chord} | {name}
            if name in cut or chord not in mechanism.tree.open or members in seen:
                continue
            seen.add(members)
            try:
                yield with_cuts(mechanism, members)
            except FieldError:
                # These leave no tree.
                continue
