# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Which joints carry the bodies, and which are cut, where a description leaves that open.

The joints of a mechanism are the edges of a graph whose nodes are its bodies and the ground. Any
spanning tree will do; they differ in the number of operations that an evaluation takes. What a
tree takes is estimated from the graph, and trees are exchanged for better ones edge by edge. The
search draws nothing by lot and looks at no clock: the same description gets the same tree.
"""

from typing import NamedTuple, Optional

from .decomposition import structure_of
from .fields import among, FieldError
from .mechanism import GROUND

# Operations, fitted to spatial machines: of a row of the tree, and of an equation carried across
# one, on the ground and elsewhere; of two equations that meet there; of a tree that would turn a
# joint round that cannot be.
ON_GROUND, ROW = 30.0, 150.0
CARRIED_TO_GROUND, CARRIED, MEETING, TURNED = 37.0, 68.0, 0.6, 1e9
# Trees that are looked at: about a second.
MOST_TREES = 3000


class Edge(NamedTuple):
    """A joint as an edge."""

    name: str
    #: ``first``, ``second``: The bodies it is between; the first one carries the second.
    first: str
    second: str
    freedoms: int  # Rows of the tree that it takes
    equations: int  # That hold it where it is cut
    reversible: bool  # Whether the second body may carry the first, too
    cut: Optional[bool]  # Whether it is to be cut, or is not to be; None leaves that open


class Tree(NamedTuple):
    """A spanning tree."""

    #: By body: the edge that carries it, and whether it is turned round (dict of str to (int,
    #: bool)).
    carriers: dict
    cut: tuple  # The other edges (tuple of int)
    operations: float  # Estimated, of one evaluation


def choose_tree(bodies, edges, closures):
    """
    Choose the spanning tree that takes the fewest operations, as far as they can be counted.

    ``bodies`` are without the ground, ``edges`` the joints, ``closures`` other constraints: bodies
    and the number of equations. Returns the tree chosen, and the first that the order of the
    joints gives. FieldError where no tree reaches all bodies, or joints that are not to be cut
    close a loop.
    """
    graph = _Graph(bodies, edges, closures)
    listed = best = graph.tree(graph.first())
    looked_at = 0
    while looked_at < MOST_TREES:
        found = best
        for members in graph.neighbours(best):
            looked_at += 1
            other = graph.tree(members)
            if other.operations < found.operations * (1.0 - 1e-9):
                found = other
            if looked_at >= MOST_TREES:
                break
        if found is best:
            break
        best = found
    if best.operations >= TURNED:
        wrong = [edges[index].name for index, turned in best.carriers.values()
                 if turned and not edges[index].reversible]
        raise FieldError(
            'joints of several degrees of freedom, and all joints in the plane, between the body '
            'that carries and the one that is carried', f'none of the ways to the ground for '
            f'{among(wrong)}', 'exchange the bodies in between, with all that is given for them',
            ('joints', wrong[0], 'between'))
    return best, listed


class _Graph:
    """The graph of bodies and joints, and the cost of its trees."""

    def __init__(self, bodies, edges, closures):
        self.bodies, self.edges, self.closures = bodies, edges, closures
        self.at = {body: [] for body in (GROUND, *bodies)}
        for index, edge in enumerate(edges):
            self.at[edge.first].append(index)
            self.at[edge.second].append(index)

    def first(self):
        """Return the first spanning tree in the order of the joints, a set of edges."""
        group = {body: body for body in self.at}

        def root(body):
            while group[body] != body:
                body = group[body]
            return body

        members = set()
        kept = [index for index, edge in enumerate(self.edges) if edge.cut is False]
        free = [index for index, edge in enumerate(self.edges) if edge.cut is None]
        for index in kept + free:
            one, other = root(self.edges[index].first), root(self.edges[index].second)
            if one != other:
                group[one] = other
                members.add(index)
            elif self.edges[index].cut is False:
                raise FieldError(
                    'a loop with a joint that may be cut',
                    f'one closed by {self.edges[index].name}',
                    'joints that are actuated or coupled, have parent and child, say cut: '
                    "false, or are named by a scene's effects or held by its start, are kept",
                    ('joints', self.edges[index].name))
        apart = [body for body in self.bodies if root(body) != root(GROUND)]
        if apart:
            raise FieldError(
                f"joints that lead to '{GROUND}'", 'none: the mechanism falls into parts, one of '
                f'them of {among(apart)}', 'join them, or cut other joints', ('bodies', apart[0]))
        return frozenset(members)

    def tree(self, members):
        """Return the tree that a set of edges is."""
        carriers, order, wrong = {}, [GROUND], 0
        for body in order:
            for index in self.at[body]:
                if index not in members:
                    continue
                edge = self.edges[index]
                other = edge.second if edge.first == body else edge.first
                if other == GROUND or other in carriers or (
                        body in carriers and carriers[body][0] == index):
                    continue
                turned = edge.second == body
                wrong += turned and not edge.reversible
                carriers[other] = index, turned
                order.append(other)
        cut = tuple(index for index in range(len(self.edges)) if index not in members)
        return Tree(carriers, cut, TURNED * wrong + self._operations(carriers, cut))

    def neighbours(self, tree):
        """Yield the trees that differ in one edge."""
        members = frozenset(index for index, _ in tree.carriers.values())
        for chord in tree.cut:
            edge = self.edges[chord]
            if edge.cut is True:
                continue
            ways = [self._way(tree.carriers, body) for body in (edge.first, edge.second)]
            for index in sorted(set(ways[0]) ^ set(ways[1])):
                if self.edges[index].cut is None:
                    yield members - {index} | {chord}

    def _way(self, carriers, body):
        """Return the edges from a body to the ground."""
        way = []
        while body != GROUND:
            index, turned = carriers[body]
            way.append(index)
            body = self.edges[index].second if turned else self.edges[index].first
        return way

    def _operations(self, carriers, cut):
        """Estimate the operations of an evaluation."""
        ways = {body: self._way(carriers, body) for body in self.bodies}
        ways[GROUND] = []
        held = [((self.edges[index].first, self.edges[index].second), self.edges[index].equations)
                for index in cut] + list(self.closures)
        standing = {way[-1] for way in ways.values() if way}
        total, passing = 0.0, {}
        for index, _ in carriers.values():
            freedoms = self.edges[index].freedoms
            total += ROW * freedoms - (ROW - ON_GROUND) * (index in standing and freedoms > 0)
        for bodies, equations in held:
            for index in set().union(*(ways[body] for body in bodies)):
                passing[index] = passing.get(index, 0) + equations
        for index, equations in passing.items():
            freedoms = self.edges[index].freedoms
            total += freedoms * equations * (CARRIED + MEETING * equations)
            if index in standing and freedoms > 0:
                total -= equations * (CARRIED - CARRIED_TO_GROUND)
        roots = [frozenset(ways[body][-1] for body in bodies if body != GROUND)
                 for bodies, _ in held]
        order, structure = structure_of(roots)
        for place, later in enumerate(structure):
            own = held[order[place]][1]
            below = sum(held[order[k]][1] for k in later)
            total += sum((below + own - k) ** 2 for k in range(own))
        return total
