# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Which operations are the same in several branches of a mechanism.

The legs of a Stewart platform take the same operations on other numbers. These go into the lanes
of a vector, one leg in each, which makes the code half as long. What is rounded, and where, stays
as it is without: a product and its only sum are one instruction in both, or in neither.
"""

from collections import Counter, defaultdict
import functools
import heapq
import operator

from .expression_graph import (
    ADD, BOTH, CHOOSE, COSINE, DIVIDE, GREATER_EQUAL, LESS, LOAD, MULTIPLY, needed_for, NEGATE,
    SINE, SUBTRACT)
from .function_table import BODY, CUT_POINT

# Operations in lanes: those that all writers have, and those of conditions.
ARITHMETIC, CONDITIONS = (ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATE), (LESS, GREATER_EQUAL, CHOOSE)
# Lanes of a vector at most; how many operations are at least put into one, of which the better is
# chosen; and what must be saved, as a share of all operations.
WIDEST, FEWEST, WORTH = 8, (2, 3), 0.02


def support(operations, use):
    """Return the inputs that each operation depends on, as sets of places in bits."""
    found, numbers = {}, {}
    for place in use:
        kind, *operands = operations[place]
        if kind == LOAD:
            found[place] = 1 << numbers.setdefault(tuple(operands), len(numbers))
        else:
            bits = 0
            for operand in operands:
                if isinstance(operand, int):
                    bits |= found[operand]
            found[place] = bits
    return found


def by_number(seed):
    """Put operations that are the same in more branches first, but for those in too many."""
    return len(seed) if len(seed) <= WIDEST else 0, max(seed)


def alike(operations, use, apart, fewest, branches, packed):
    """
    Find operations that are the same on other inputs.

    Of a graph, those that are needed in their order (``use``), but for places that are to stay
    alone (``apart``), ``fewest`` at least. Returns the same number for operations that are the
    same, at whatever inputs, by place, and lists of places of operations that are the same, each
    of other inputs. Factors and terms whose order does not matter are put in the same one. In
    ``branches``, as of a graph, what is done with values of one name is the same, however these
    are found.
    """
    inputs, kinds, numbers = support(operations, use), {}, {}
    branches, branch, label, level = list(reversed(branches)), None, {}, 0
    # Branches on the way to each operation, in bits; of those of each name, how many are on the
    # way to one, which no other of as many can wait for.
    behind, before, levels = {}, 0, defaultdict(dict)

    def seen(one):
        """Return what an operand is taken for."""
        return numbers.setdefault(
            (level, label[one]), len(numbers)) if one in label else kinds[one]

    found = defaultdict(lambda: defaultdict(list))
    for place in use:
        kind, *operands = operations[place]
        while branches and branches[-1][0] <= place:
            _, branch, name, label = branches.pop()
            before = functools.reduce(operator.or_, (behind.get(one, 0) for one in label), 0)
            level = 1 + max((
                number for bit, number in levels[name].items() if before & bit), default=0)
            if branch is not None:
                bit = 1 << len(branches)
                levels[name][bit] = level
                before |= bit
        if kind == LOAD:
            # A joint of the tree has its place among the bodies' constants.
            key = kind, BODY if operands[0] == CUT_POINT else operands[0]
        else:
            # A sum of two products rounds one of them.
            if kind == MULTIPLY or kind == ADD and any(
                    isinstance(o, float) or operations[o][0] not in (MULTIPLY, NEGATE)
                    for o in operands):
                operands.sort(key=lambda o: seen(o) if isinstance(o, int) else -1)
                operations[place] = kind, *operands
            key = (kind, *(seen(o) if isinstance(o, int) else (o,) for o in operands))
        kinds[place] = numbers.setdefault(key, len(numbers))
        behind[place] = functools.reduce(operator.or_, (
            behind[one] for one in operands if kind != LOAD and isinstance(one, int)),
            0 if branch is None else before)
        if kind in packed and place not in apart:
            found[kinds[place]][inputs[place] if branch is None else branch].append(place)
    groups = []
    for members in found.values():
        # A branch that has operations of its own, such as the one that carries a platform in the
        # tree, is the first one: in the last lane it leaves the others in theirs.
        members = [places for _, places in sorted(members.items(), reverse=True)]
        for number in range(max(map(len, members))):
            group = [places[number] for places in members if len(places) > number]
            if len(group) >= fewest:
                groups.append(group)
    return kinds, groups


class Packing:
    """
    Which operations of a routine go together, but for those that would be rounded otherwise.

    ``angles``: places of what sines and cosines are taken of. ``use``: places of the operations
    that are needed, in their order; ``bundles``: places of operations, by number; ``at``: number
    of the bundle, and the lane, of an operation.
    """

    def __init__(self, routine, angles, fewest, packed):
        self.packed = packed
        self.operations = list(routine.graph.operations)
        self.use = sorted(routine.needed())
        stored = {value.place for _, _, value in routine.outputs if hasattr(value, 'place')}
        if routine.graph.guard is not None:
            stored.add(routine.graph.guard.place)
        self._users = defaultdict(list)
        for place in self.use:
            if self.operations[place][0] in packed:
                for operand in dict.fromkeys(self.operations[place][1:]):
                    if isinstance(operand, int):
                        self._users[operand].append(place)
        self._fused = self._fusions(stored)
        apart, self.turned = needed_for(self.operations, angles), set()
        for branches in routine.graph.branches, ():
            self._choose(branches, apart, stored, fewest)
            # Bundles may wait for one another where branches are in different orders.
            if sum(map(len, self.ordered())) == sum(map(self._is_written, self.use)):
                break

    def _choose(self, branches, apart, stored, fewest):
        """Choose the bundles that save most."""
        kinds, groups = alike(
            self.operations, self.use, apart, min(fewest), branches, self.packed)
        best = {}, {}, WORTH * len(self.use)
        for least in fewest:
            for first in by_number, max:
                self._bundle(kinds, sorted(groups, key=first, reverse=True), set(apart), least)
                saved = len(self.at) - len(self.bundles) - self._moves(stored)
                if saved > best[2]:
                    best = self.bundles, self.at, saved
        self.bundles, self.at, _ = best

    def _fusions(self, stored):
        """Return the only user of each product, or its negative, that may fuse with it."""
        users, twice = {}, set(stored)
        for place in self.use:
            if self.operations[place][0] != LOAD:
                for operand in self.operations[place][1:]:
                    if isinstance(operand, int) and users.setdefault(operand, place) != place:
                        twice.add(operand)
        return {place: user for place, user in users.items()
                if self.operations[place][0] in (MULTIPLY, NEGATE) and place not in twice
                and self.operations[user][0] in (ADD, SUBTRACT, NEGATE)}

    def _bundle(self, kinds, groups, taken, fewest):
        """Choose bundles of ``fewest`` and more: the first groups have the first choice."""
        operations, found = self.operations, []

        def free(one):
            return isinstance(one, int) and one not in taken and operations[one][0] in self.packed

        for group in groups:
            left = [place for place in group if place not in taken]
            for begin in range(0, len(left) - fewest + 1, WIDEST):
                rest = [tuple(left[begin:begin + WIDEST])]
                while rest:
                    # Then their operands, in the same lanes.
                    members = rest.pop()
                    if len(members) >= fewest and len(set(members)) == len(members) and all(
                            map(free, members)) and len({kinds[one] for one in members}) == 1:
                        taken.update(members)
                        found.append(members)
                        rest += zip(*(operations[one][1:] for one in members))
        self._follow(kinds, found, taken, fewest)
        self.bundles = dict(enumerate(found))
        self.at = {place: (number, lane) for number, members in self.bundles.items()
                   for lane, place in enumerate(members)}
        dropped = [0]
        while dropped:
            dropped = list(filter(self._fuses_otherwise, self.bundles))
            for number in dropped:
                for place in self.bundles.pop(number):
                    del self.at[place]

    def _follow(self, kinds, found, taken, fewest):
        """Add what is done next with numbers of a bundle, from the first lane on."""
        operations, at = self.operations, {}
        for number, members in enumerate(found):
            at.update((one, (number, lane)) for lane, one in enumerate(members))

        def shared(first, other, lane):
            """Return how many operands are in a lane what those of another are in the first."""
            if other in taken or kinds[first] != kinds[other]:
                return 0, 0
            pairs = list(zip(operations[first][1:], operations[other][1:]))
            beside = sum(a in at and at.get(b) == (at[a][0], lane) and at[a][1] == 0
                         for a, b in pairs)
            return min(beside, 1), beside + sum(a == b for a, b in pairs)

        # More are found on the way.
        for members in found:
            for first in self._users[members[0]]:
                lanes = [first] if first not in taken else []
                for lane, one in enumerate(members[1:], start=1):
                    best = max(self._users[one], default=first,
                               key=lambda other: shared(first, other, lane))
                    if len(lanes) == lane and best not in lanes and shared(first, best, lane)[0]:
                        lanes.append(best)
                if len(lanes) >= fewest:
                    at.update((one, (len(found), lane)) for lane, one in enumerate(lanes))
                    taken.update(lanes)
                    found.append(tuple(lanes))

    def _moves(self, stored):
        """Count the instructions that move numbers into lanes, between them and out of them."""
        operations, into, out = self.operations, 0, set()
        vectors = {operands for members in self.bundles.values()
                   for operands in zip(*(operations[place][1:] for place in members))}
        for operands in vectors:
            _, _, number, lanes = self.gathered(operands)
            if number is not None:
                into += lanes[:len(operands)] != list(range(len(operands)))
            elif any(isinstance(one, int) for one in operands):
                into += len(set(operands))
                out.update(operands)
        for place in self.use:
            if place not in self.at and operations[place][0] not in (LOAD, BOTH):
                out.update(operations[place][1:])
        return into + sum(self.at[place][1] > 0 for place in out.union(stored)
                          if isinstance(place, int) and place in self.at)

    def turns(self, angles):
        """
        Return groups of angles, so that their sines and cosines are in lanes that bundles take.

        ``angles``: places of all. The vectors of a group's sines and cosines have the numbers
        (SINE, n) and (COSINE, n), n of the group; ``turned`` are the places of them all.
        """
        operations, asked, groups = self.operations, Counter(), []
        for members in self.bundles.values():
            for operands in zip(*(operations[place][1:] for place in members)):
                if all(isinstance(one, int) and operations[one][0] in (SINE, COSINE)
                       for one in operands):
                    asked[tuple(operations[one][1] for one in operands)] += 1
        left = dict.fromkeys(angles)
        for group in sorted(asked, key=lambda one: (-len(one), -asked[one])):
            if len(set(group)) == len(group) and all(one in left for one in group):
                groups.append(list(group))
                for one in group:
                    del left[one]
        for one in left:
            group = min(groups, key=len, default=[*range(WIDEST)])
            if len(group) == WIDEST:
                groups.append([one])
            else:
                group.append(one)
        at = {angle: (n, lane) for n, group in enumerate(groups)
              for lane, angle in enumerate(group)}
        self.turned = {place for place in self.use if operations[place][0] in (SINE, COSINE)
                       and operations[place][1] in at}
        for place in self.turned:
            kind, angle = operations[place]
            n, lane = at[angle]
            self.at[place] = (kind, n), lane
        return groups

    def number(self, place):
        """Return the number of an operation's bundle, None where it is alone."""
        return self.at.get(place, (None,))[0]

    def _fuses_otherwise(self, number):
        """Return whether a fused product and addition would be separated."""
        members, fused = self.bundles[number], self._fused
        users = [fused.get(place) for place in members]
        if users.count(None) < len(users) and not self._in_lanes(users):
            return True
        if self.operations[members[0]][0] == MULTIPLY:
            return False
        return any(any(isinstance(one, int) and one in fused for one in operands)
                   and not self._in_lanes(operands)
                   for operands in zip(*(self.operations[place][1:] for place in members)))

    def _in_lanes(self, places):
        """Return whether operations are all those of a bundle, each in its lane."""
        return self.bundles.get(self.number(places[0])) == tuple(places)

    def conditions(self, guard):
        """
        Return what a guard of a graph asks for: places by the number of their bundle.

        Those of operations that are alone have the number None.
        """
        found, rest = defaultdict(list), [] if guard is None else [guard.place]
        while rest:
            place = rest.pop()
            kind, *operands = self.operations[place]
            if kind == BOTH:
                rest += operands
            else:
                found[self.number(place)].append(place)
        return found

    def _is_written(self, place):
        return self.operations[place][0] != BOTH or LESS not in self.packed

    def ordered(self):
        """
        Yield bundles and single operations, each after its operands.

        But for those that join conditions where these may be in lanes: see ``conditions``.
        """
        operations, nodes = self.operations, {}
        for place in filter(self._is_written, self.use):
            number = None if place in self.turned else self.number(place)
            nodes[place] = (place,) if number is None else self.bundles[number]
        waiting, following, ready = {}, defaultdict(list), []
        for members in set(nodes.values()):
            before = {nodes[o] for place in members if operations[place][0] != LOAD
                      for o in operations[place][1:] if isinstance(o, int)}
            waiting[members] = len(before)
            for other in before:
                following[other].append(members)
            if not before:
                heapq.heappush(ready, members)
        while ready:
            members = heapq.heappop(ready)
            yield members
            for other in following[members]:
                waiting[other] -= 1
                if not waiting[other]:
                    heapq.heappush(ready, other)

    def gathered(self, operands):
        """
        Return where the operands of a bundle, places of operations or numbers, are, lane by lane.

        The width of a vector that they fit in; as many operands, the first one in lanes beyond
        them, too; the number of the bundle that all of them are in, or None; and the lanes of that
        bundle.
        """
        width = next(one for one in (2, 4, WIDEST) if len(operands) <= one)
        padded = operands + (width - len(operands)) * operands[:1]
        at = [self.at.get(one, (None, 0)) if isinstance(one, int) else (None, 0)
              for one in padded]
        numbers = {number for number, _ in at}
        return width, padded, numbers.pop() if len(numbers) == 1 else None, [
            lane for _, lane in at]


def packing_of(routine, angles, fewest=FEWEST, packed=ARITHMETIC + CONDITIONS):
    """
    Return the ``Packing`` of a routine's operations, None where that is not worth it.

    ``angles``: places of what sines and cosines are taken of; ``fewest``: in place of FEWEST;
    ``packed``: kinds of operations that may be in lanes.
    """
    found = Packing(routine, angles, fewest, packed)
    return found if found.bundles else None
