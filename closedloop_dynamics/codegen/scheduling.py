# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
In which order operations are written, so that a processor waits for few of them.

A processor looks some hundred instructions ahead. In the order of the recursions what takes
longest, one body after the other, begins late; here that comes first from which the longest chain
leads to the results, as soon as a processor can have its operands (list scheduling).

Routines that are too large for the caches of instructions wait for these, so what counts are
instructions: there most of those that keep values on the stack go, where operations are late.
"""

import heapq

from .expression_graph import (
    ADD, BOTH, CALL, CHOOSE, DIVIDE, GREATER_EQUAL, LESS, LOAD, MULTIPLY, NEGATE, SUBTRACT)

# Cycles until a result is there; of functions it does not matter.
_LATENCY = {ADD: 3, SUBTRACT: 3, MULTIPLY: 3, DIVIDE: 13, LESS: 3, GREATER_EQUAL: 3,
            CHOOSE: 1, BOTH: 1, NEGATE: 1}
_OTHERS = 20
# Until a number is in another lane.
_CROSSING = 3
# Operations that begin in a cycle.
_RATE = 2.5
# Values that may wait in registers, and how many operations are then compared for which of them
# needs least more.
_REGISTERS, _COMPARED = 28, 64
# With more operations than this instructions come from beyond the first caches.
MOST = 2000


def longest_chain(routine):
    """Return the cycles of those operations of a routine that wait for one another longest."""
    operations, until = routine.graph.operations, {}
    for place in sorted(routine.needed()):
        kind, *operands = operations[place]
        until[place] = 0 if kind == LOAD else _LATENCY.get(kind, _OTHERS) + max(
            (until[one] for one in operands if isinstance(one, int)), default=0)
    return max(until.values(), default=0)


def by_urgency(operations, groups, known):
    """
    Order operations.

    Parameters
    ----------
    operations : list
        Of an expression graph.
    groups : list of tuples of int
        Places of those that are done together, each after its operands.
    known : collection of int
        Places of results that are there already.

    Returns
    -------
    list of tuples of int
        The groups that are left, but for loads, which wait until they are needed; None where
        functions of the engine are asked, which remember what they found.

    """
    group_of = {place: group for group in groups for place in group}
    kinds = {group: operations[group[0]][0] for group in groups}
    left = [group for group in groups if kinds[group] != LOAD and group[0] not in known]
    if CALL in kinds.values():
        return None
    before = {group: {group_of[one] for place in group for one in operations[place][1:]
                      if isinstance(one, int)} for group in left}
    after = {group: [] for group in groups}
    for group in left:
        before[group] = {one for one in before[group] if kinds[one] != LOAD}
        for one in before[group]:
            after[one].append(group)
    if len(left) > MOST:
        return _late(left, before, after)
    crossing, cycles, height = {}, {}, {}
    for group in left:
        for column in zip(*(operations[place][1:] for place in group)):
            for one in {group_of[one] for one in column if isinstance(one, int)}:
                if column != one and len(one) + len(group) > 2:
                    crossing[one, group] = _CROSSING
        # A product and its only sum take one cycle more than a sum.
        fused = kinds[group] == MULTIPLY and len(after[group]) == 1 and kinds[
            after[group][0]] in (ADD, SUBTRACT)
        cycles[group] = 1 if fused else _LATENCY.get(kinds[group], _OTHERS)
    for group in reversed(left):
        height[group] = cycles[group] + max(
            (height[one] + crossing.get((group, one), 0) for one in after[group]), default=0)
    return _list_schedule(left, before, after, height, cycles, crossing)


def _late(left, before, after):
    """
    Return what is ``left``, each as late as at most one of its operands waits longer for that.

    Its result then waits for so much less.
    """
    place = {group: n for n, group in enumerate(left)}
    for group in reversed(left):
        first = min((place[one] for one in after[group]), default=place[group])
        longer = sum(all(place[one] < first for one in after[operand] if one != group)
                     for operand in before[group])
        if longer <= 1:
            place[group] = first
    return sorted(left, key=place.get)


def _list_schedule(left, before, after, height, cycles, crossing):
    """
    Return the order of what is ``left``.

    ``height``: cycles from its begin to the end; ``cycles``: of each; ``crossing``: cycles between
    two whose lanes differ.
    """
    users = {group: len(those) for group, those in after.items()}
    place = {group: n for n, group in enumerate(left)}
    ends, missing = {}, {group: sum(one in place for one in before[group]) for group in left}
    # Those that wait for operands by when they may begin, and those that do not by urgency.
    waiting = [(0.0, place[group]) for group in left if not missing[group]]
    ready, found = [], []
    living = sum(users[group] > 0 for group in users if group not in place)

    def more(group):
        """Return how many more values have to be kept after a group."""
        return (users[group] > 0) - sum(users[one] == 1 for one in before[group])

    while len(found) < len(left):
        now = len(found) / _RATE
        while waiting and (waiting[0][0] <= now or not ready):
            _, number = heapq.heappop(waiting)
            heapq.heappush(ready, (-height[left[number]], number))
        beside = [heapq.heappop(ready) for _ in range(
            min(len(ready), _COMPARED) if living >= _REGISTERS else 1)]
        chosen = min(beside, key=lambda one: max(0, more(left[one[1]])))
        for one in beside:
            if one is not chosen:
                heapq.heappush(ready, one)
        group = left[chosen[1]]
        found.append(group)
        living += more(group)
        ends[group] = now + cycles[group]
        for one in before[group]:
            users[one] -= 1
        for one in after[group]:
            missing[one] -= 1
            if not missing[one]:
                heapq.heappush(waiting, (
                    max(ends.get(other, 0.0) + crossing.get((other, one), 0)
                        for other in before[one]), place[one]))
    return found
