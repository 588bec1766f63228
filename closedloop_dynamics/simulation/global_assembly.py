# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Positions that close the loops of a mechanism in space, found from far away.

Models of robots are often drawn open, by metres or radians. Here loops are closed by damped least
squares in the mass metric: each joint that closes a loop asks that points and directions of two
bodies coincide, so that axes cannot be met the wrong way round, as they can by equations that
are sines of angles. Where that ends at a place that is not closed, loops that share joints are
searched together, apart from others: the gaps are closed little by little (a homotopy), and then
other starts around the first are tried. What is found is exact to some 1e-9 only, for Newton's
method (``assembly``) to end with.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..core.ranks import rank_from, rank_of
from ..mechanism.inertia import inertia_matrix
from ..mechanism.kinematics import steps_of
from ..mechanism.mechanism import (
    CUT_WITH_ORIENTATION, CYLINDRICAL, DISTANCE, FIXED, GROUND, HELICAL, PLANAR,
    POINT_ON_LINE, POINT_ON_PLANE, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import about, cross, of_quaternion, perpendicular

# Closed means this, relative to the mechanism's size, or sines of angles.
CLOSED = 1e-9
MOST_ITERATIONS = 150
# Largest change of a coordinate in one iteration [rad, or in units of the size].
LARGEST_STEP = 0.5
STEPS_OF_HOMOTOPY = 12
# How far around the first start others are [rad, and shares of the size], one after the other.
AMPLITUDES = (0.2, 0.5, 1.0, 1.5, 2.5, 3.1)
STARTS_EACH = 4
# Share of the largest inertia that every coordinate has at least in the metric.
LEAST_INERTIA = 1e-4
# From so many starts a loop is tried alone, to find whether it can be closed at all.
STARTS_ALONE = 12
# How far away neighbours of a position are looked for [rad, and shares of the size], how many.
NEARBY, NEIGHBOURS = 0.1, 2
FROM_THE_START = 'from the start'
_UNIT = np.eye(3)
# Of a motion of unit size, what is none: positions are closed to the root of rounding errors.
STILL = 1e-7


class ClosureResult(NamedTuple):
    """Where the search ended."""

    q: np.ndarray  # Shape (nq,): Coordinates; orientations as unit quaternions x, y, z, w
    #: By joint that closes a loop, and coupling: how far it is open [m, and sines of angles] (dict
    #: of str to float).
    closure_errors: dict
    closed: bool
    how: str  # How it was found


class ClosureProblem:
    """
    The loops of a mechanism in space as points and directions that are to coincide.

    ``size``, of the mechanism [m], measures lengths; ``limits``: least and largest coordinate of
    joints of one degree of freedom, None where there is none; ``scale``, shape (nv,): unit of each
    rate: the size, or 1 for angles.
    """

    def __init__(self, mechanism, size, limits=None):
        """Find the places of the coordinates and put the joints in an order with parents first."""
        self.mechanism, self.size = mechanism, size
        self.coordinates = mechanism.coordinates
        self.nq, self.nv = self.coordinates.nq, self.coordinates.nv
        self._place = {name: some.start for name, some in self.coordinates.coordinates.items()}
        self._rate = {name: some.start for name, some in self.coordinates.rates.items()}
        self._joints = _parents_first(mechanism.joints)
        self._turned = {joint.name: of_quaternion(joint.orientation)
                        for joint in mechanism.joints}
        self._steps = {joint.name: steps_of(joint) for joint in mechanism.joints}
        self._chain = {GROUND: []}
        for joint in self._joints:
            rates = self.coordinates.rates[joint.name]
            self._chain[joint.child] = [*self._chain[joint.parent],
                                        *range(rates.start, rates.stop)]
        self._ends = [_ends(cut) for cut in mechanism.cut_joints]
        self.scale = np.where(self.coordinates.lengths, size, 1.0)
        self._limits = [
            (self._place[name], self._rate[name], lower, upper)
            for name, (lower, upper) in (limits or {}).items()]

    def start(self, position=None):
        """Return coordinates, shape (nq,), with those of some joints by name, others as drawn."""
        q = self.coordinates.start()
        for name, value in (position or {}).items():
            q[self.coordinates.coordinates[name]] = value
        return q

    def moved(self, q, change):
        """Return coordinates, shape (nq,), after a change, shape (nv,)."""
        return self.coordinates.moved(q, change)

    def frames(self, q):
        """Return where the bodies are, by name: axes in the world, as columns, and origins [m]."""
        return self.kinematics(q)[:2]

    def unwound(self, q, start):
        """Return the same position with angles within half a turn of those of a start."""
        q, limited = q.copy(), {place for place, *_ in self._limits}
        for joint in self.mechanism.joints:
            place = self._place[joint.name]
            count = {REVOLUTE: 1, UNIVERSAL: 2, CYLINDRICAL: 1}.get(joint.type, 0)
            for at in range(place, place + count):
                if at not in limited:
                    q[at] -= 2.0 * np.pi * np.round((q[at] - start[at]) / (2.0 * np.pi))
        return q

    def kinematics(self, q):
        """Return frames and origins of the bodies, and the axes of all rates."""
        frames, origins = {GROUND: _UNIT}, {GROUND: np.zeros(3)}
        spins, arms, slides = (np.zeros((self.nv, 3)) for _ in range(3))
        for joint in self._joints:
            frame = frames[joint.parent] @ self._turned[joint.name]
            origin = origins[joint.parent] + frames[joint.parent] @ joint.position
            rate, place = self._rate[joint.name], self._place[joint.name]
            for kind, axis in self._steps[joint.name]:
                if kind == SPHERICAL:
                    frame = frame @ of_quaternion(q[place:place + 4])
                    spins[rate:rate + 3], arms[rate:rate + 3] = frame.T, origin
                    continue
                world, value = frame @ axis, q[place]
                if kind != PRISMATIC:
                    spins[rate], arms[rate] = world, origin
                    frame = frame @ about(axis, value)
                if kind != REVOLUTE:
                    slides[rate] = world * joint.lead if kind == HELICAL else world
                    origin = origin + slides[rate] * value
                rate, place = rate + 1, place + 1
            frames[joint.child], origins[joint.child] = frame, origin
        # Where arms[k] moves with what its joint slides, the slide has no spin.
        return frames, origins, spins, slides - cross(spins, arms)

    def residual(self, q, wanted=True, size=None):
        """
        Return how far everything is from coinciding, and how that changes if that is ``wanted``.

        Numbers, shape (n,): lengths in units of the ``size``, that of the mechanism if not given
        [m], and differences of unit vectors; their Jacobian, shape (n, nv), or None; and how many
        of the numbers each cut joint has, then each coupling; limits follow.
        """
        frames, origins, spins, moments = self.kinematics(q)
        size = size or self.size
        scale = np.where(self.coordinates.lengths, size, 1.0)
        values, rows, counts = [], [], []

        def velocity(body, point):
            jac = np.zeros((3, self.nv))
            chain = self._chain[body]
            jac[:, chain] = (moments[chain] + cross(spins[chain], point)).T
            return jac

        def turn(body, direction):
            jac = np.zeros((3, self.nv))
            chain = self._chain[body]
            jac[:, chain] = cross(spins[chain], direction).T
            return jac

        def spin(body):
            jac = np.zeros((3, self.nv))
            chain = self._chain[body]
            jac[:, chain] = spins[chain].T
            return jac

        for cut, (same, across, right) in zip(self.mechanism.cut_joints, self._ends):
            a, b, before = cut.body_a, cut.body_b, len(values)
            point_a = origins[a] + frames[a] @ cut.point_a
            point_b = origins[b] + frames[b] @ cut.point_b
            gap = (point_a - point_b) / size
            if cut.type == DISTANCE:
                values.append(0.5 * (gap @ gap * size / cut.length
                                     - cut.length / size))
                if wanted:
                    rows.append((gap @ (velocity(a, point_a) - velocity(b, point_b))
                                 / cut.length)[None])
            elif across is None:
                values += gap.tolist()
                if wanted:
                    rows.append((velocity(a, point_a) - velocity(b, point_b)) / size)
            else:
                for normal in across:
                    world = frames[b] @ normal
                    values.append(float(world @ gap))
                    if wanted:
                        rows.append((
                            world @ (velocity(a, point_a) - velocity(b, point_b)) / size
                            + gap @ turn(b, world))[None])
            for one, other in same:
                one, other = frames[a] @ one, frames[b] @ other
                values += (one - other).tolist()
                if wanted:
                    rows.append(turn(a, one) - turn(b, other))
            for one, other in right:
                one, other = frames[a] @ one, frames[b] @ other
                values.append(float(one @ other))
                if wanted:
                    rows.append((other @ turn(a, one) + one @ turn(b, other))[None])
            if cut.type == HELICAL:
                axis = frames[b] @ cut.axis_b
                held = frames[b] @ of_quaternion(cut.orientation) @ frames[a].T
                angle = np.arctan2(-axis @ _vector_of(held), 0.5 * (
                    np.trace(held) - axis @ held @ axis))
                # Whole turns count by the way that the thread has gone.
                slide = float(axis @ gap) * size
                angle += 2.0 * np.pi * np.round((slide / cut.lead - angle) / (2.0 * np.pi))
                values.append((slide - cut.lead * angle) / size)
                if wanted:
                    rows.append(((
                        axis @ (velocity(a, point_a) - velocity(b, point_b))
                        - cut.lead * axis @ (spin(a) - spin(b))) / size
                        + gap @ turn(b, axis))[None])
            counts.append(len(values) - before)
        for coupling in self.mechanism.couplings:
            row = np.zeros((1, self.nv))
            for name, factor in coupling.joints.items():
                row[0, self._rate[name]] = factor
            unit = np.abs(row * scale).max()
            q_here = [q[self._place[name]] for name in coupling.joints]
            held = np.dot(q_here, list(coupling.joints.values()))
            values.append((held - coupling.offset) / unit)
            rows.append(row / unit)
            counts.append(1)
        for place, rate, lower, upper in self._limits:
            beyond = max(0.0, q[place] - upper) if upper is not None else 0.0
            beyond += min(0.0, q[place] - lower) if lower is not None else 0.0
            values.append(beyond / scale[rate])
            if wanted:
                row = np.zeros((1, self.nv))
                row[0, rate] = 1.0 / scale[rate] if beyond else 0.0
                rows.append(row)
        jac = np.concatenate(rows) if rows else np.zeros((0, self.nv))
        return np.array(values), jac if wanted else None, counts

    def metric(self, q):
        """Return the inertia of the tree, shape (nv, nv), in units of its largest entry."""
        frames, origins, spins, moments = self.kinematics(q)
        inertia = np.zeros((self.nv, self.nv))
        for body in self.mechanism.bodies:
            if body.massless:
                continue
            chain = self._chain[body.name]
            center = origins[body.name] + frames[body.name] @ body.center_of_mass
            shift = moments[chain] + cross(spins[chain], center)
            turn = spins[chain] @ frames[body.name]
            inertia[np.ix_(chain, chain)] += (
                body.mass * shift @ shift.T + turn @ inertia_matrix(body.inertia) @ turn.T)
        scaled = inertia * np.outer(self.scale, self.scale)
        largest = np.diag(scaled).max(initial=0.0) or 1.0
        scaled = scaled / largest + LEAST_INERTIA * np.eye(self.nv)
        return scaled / np.outer(self.scale, self.scale)

    def closure_errors(self, q):
        """Return how far each joint that closes a loop is open [m, sines of angles], by name."""
        values, _, counts = self.residual(q, wanted=False, size=1.0)
        found, first = {}, 0
        for cut, count in zip((*self.mechanism.cut_joints, *self.mechanism.couplings), counts):
            found[cut.name] = float(np.linalg.norm(values[first:first + count]))
            first += count
        return found

    def rank(self, q):
        """Return the largest rank of the equations at a closed position and around it."""
        rng, ranks = np.random.default_rng(0), [rank_of(self.residual(q)[1])]
        free = np.arange(self.nv)
        for _ in range(NEIGHBOURS if self._ends or self.mechanism.couplings else 0):
            near = _least_squares(self, self.moved(
                q, NEARBY * self.scale * rng.uniform(-1.0, 1.0, self.nv)), free)
            if self.is_closed(near):
                ranks.append(rank_of(self.residual(near)[1]))
        return max(ranks)

    def idle(self, q):
        """
        Return the bodies that may turn about themselves while nothing else moves.

        As a rod between two ball joints does, at a position that closes the loops: all points of
        its joints, two at least, stay, and so does what is actuated.
        """
        _, singular, right = np.linalg.svd(self.residual(q, size=self.size)[1] * self.scale)
        motions = self.scale[:, None] * right[rank_from(singular):].T
        frames, origins, spins, moments = self.kinematics(q)
        driven = [k for name in self.mechanism.actuated_joints if name in self._rate for k in
                  range(self.nv)[self.coordinates.rates[name]]]
        found = []

        def twist(body, point):
            chain = self._chain[body]
            return (moments[chain] + cross(spins[chain], point)).T @ motions[chain] / self.size

        for body in (one.name for one in self.mechanism.bodies):
            points = [origins[body], *(
                origins[body] + frames[body] @ place for place in (
                    *(joint.position for joint in self._joints if joint.parent == body),
                    *(point for cut in self.mechanism.cut_joints for of, point in (
                        (cut.body_a, cut.point_a), (cut.body_b, cut.point_b)) if of == body)))]
            if np.ptp(points, axis=0).max() <= CLOSED * self.size:
                continue
            still = [motions[driven], *(twist(body, point) for point in points), *(
                rows for other in self._chain if other not in (body, GROUND) for rows in (
                    twist(other, origins[other]),
                    spins[self._chain[other]].T @ motions[self._chain[other]]))]
            if np.linalg.matrix_rank(np.concatenate(still), tol=STILL) < motions.shape[1]:
                found.append(body)
        return found

    def is_closed(self, q):
        """Return whether every loop is closed and every limit respected."""
        return np.abs(self.residual(q, wanted=False)[0]).max(initial=0.0) <= CLOSED


def find_closed(mechanism, size, start, hold=(), limits=None, starts=STARTS_EACH):
    """
    Search a position that closes the loops of a mechanism in space, near a start.

    ``size`` is the mechanism's [m]; ``start``, shape (nq,), has unit quaternions x, y, z, w;
    ``hold``: joints, or freedoms of joints, that stay; ``limits``: least and largest coordinate of
    joints of one degree of freedom; ``starts``: how many others are tried at each distance from
    the first; 0: nothing but the first. Returns the nearest of what was found at the first
    distance where anything was; where nothing was, the least open.
    """
    loops, places = ClosureProblem(mechanism, size, limits), mechanism.coordinates
    held = [k for name in hold for k in (
        [places.index[name]] if name in places.index else range(loops.nv)[places.rates[name]])]
    if not starts:
        best = _least_squares(loops, start, np.setdiff1d(np.arange(loops.nv), held))
        how = FROM_THE_START
    else:
        best, ways = np.array(start, dtype=float), {FROM_THE_START: 0.0}
        for part, own in _parts(mechanism, limits or {}):
            names = part.joint_names
            some = ClosureProblem(part, size, {
                name: limit for name, limit in (limits or {}).items() if name in names})
            q, rates = (np.concatenate([np.arange(loops.nq)[where[name]] for name in names])
                        for where in (places.coordinates, places.rates))
            free = [k for k, rate in enumerate(rates) if rate not in held
                    and some.coordinates.joint_of(some.coordinates.names[k]) in own]
            best[q], way, amplitude = _search(some, best[q], np.array(free, dtype=int), starts)
            ways[way] = amplitude
        how = max(ways, key=ways.get)
    best = loops.unwound(best, start)
    return ClosureResult(best, loops.closure_errors(best), loops.is_closed(best), how)


def _search(loops, start, free, starts):
    """Return where loops that depend on one another close the best, how, and how far that is."""
    best, how, far = _least_squares(loops, start, free), FROM_THE_START, 0.0
    if not loops.is_closed(best):
        found = _homotopy(loops, start, free)
        if _openness(loops, found) < _openness(loops, best):
            best, how, far = found, 'closing the gaps little by little', 0.5 * AMPLITUDES[0]
    rng = np.random.default_rng(0)
    for amplitude in AMPLITUDES:
        if loops.is_closed(best):
            break
        found = []
        for _ in range(starts):
            change = np.zeros(loops.nv)
            change[free] = rng.uniform(-amplitude, amplitude, len(free)) * loops.scale[free]
            found.append(_least_squares(loops, loops.moved(start, change), free))
        closed = [q for q in found if loops.is_closed(q)]
        if closed:
            best = min(closed, key=lambda q: np.linalg.norm(q - start))
            how, far = f'from starts up to {amplitude:g} rad away', amplitude
        else:
            best = min([best, *found], key=lambda q: _openness(loops, q))
    return best, how, far


def never_closed(mechanism, size, q):
    """
    Return the loops that stay open by themselves, whatever the others do, from coordinates q on.

    Each is tried alone, moved by nothing but its own joints, without limits. By joint that closes
    a loop: the least that it is open [m, and sines of angles].
    """
    found, rng = {}, np.random.default_rng(0)
    for cut in mechanism.cut_joints:
        own = _around(mechanism, cut)
        part = _with_joints(mechanism, own, (cut,))
        loops = ClosureProblem(part, size)
        start = np.concatenate([q[mechanism.coordinates.coordinates[name]] for name in own])
        trials, free = [], np.arange(loops.nv)
        for number in range(STARTS_ALONE):
            change = rng.uniform(-np.pi, np.pi, loops.nv) * loops.scale * bool(number)
            trials.append(_least_squares(loops, loops.moved(start, change), free))
            if loops.is_closed(trials[-1]):
                break
        else:
            found[cut.name] = min(loops.closure_errors(trial)[cut.name] for trial in trials)
    return found


def _around(mechanism, cut):
    """Return the joints of a loop, in the mechanism's order."""
    below = {joint.child: joint for joint in mechanism.joints}
    sides = []
    for body in (cut.body_a, cut.body_b):
        side = set()
        while body != GROUND:
            side.add(below[body].name)
            body = below[body].parent
        sides.append(side)
    return [name for name in mechanism.joint_names if name in sides[0] ^ sides[1]]


def _with_joints(mechanism, names, cuts, couplings=()):
    """Return some joints of a mechanism; bodies that they do not carry become the ground."""
    joints = [joint for joint in mechanism.joints if joint.name in names]
    carried = {joint.child for joint in joints}

    def body(name):
        return name if name in carried else GROUND

    return replace(
        mechanism, source=None, tree=None, points=(), couplings=tuple(couplings),
        bodies=tuple(one for one in mechanism.bodies if one.name in carried),
        joints=tuple(replace(joint, parent=body(joint.parent)) for joint in joints),
        cut_joints=tuple(replace(cut, body_a=body(cut.body_a), body_b=body(cut.body_b))
                         for cut in cuts))


def _parts(mechanism, limited):
    """
    Return the mechanism in parts whose loops share no joints.

    With the joints that carry a part's loops, and those of them that the loops move.
    """
    held = [({*_around(mechanism, cut)}, [cut], []) for cut in mechanism.cut_joints]
    held += [(set(coupling.joints), [], [coupling]) for coupling in mechanism.couplings]
    held += [({name}, [], []) for name in limited]
    parts = []
    for joints, cuts, couplings in held:
        for part in [part for part in parts if part[0] & joints]:
            parts.remove(part)
            joints, cuts, couplings = part[0] | joints, part[1] + cuts, part[2] + couplings
        parts.append((joints, cuts, couplings))
    below = {joint.child: joint for joint in mechanism.joints}
    found = []
    for joints, cuts, couplings in parts:
        carrying = set()
        for joint in (one for one in mechanism.joints if one.name in joints):
            while joint is not None and joint.name not in carrying:
                carrying.add(joint.name)
                joint = below.get(joint.parent)
        found.append((_with_joints(mechanism, carrying, cuts, couplings), joints))
    return found


def _openness(loops, q):
    return np.linalg.norm(loops.residual(q, wanted=False)[0])


def _homotopy(loops, q, free):
    """Return coordinates reached while the gaps of a start are closed in equal parts."""
    first = loops.residual(q, wanted=False)[0]
    for step in range(1, STEPS_OF_HOMOTOPY + 1):
        q = _least_squares(loops, q, free, (1.0 - step / STEPS_OF_HOMOTOPY) * first,
                           MOST_ITERATIONS if step == STEPS_OF_HOMOTOPY else 20)
    return q


def _least_squares(loops, q, free, target=0.0, most=MOST_ITERATIONS):
    """Return coordinates where Levenberg's and Marquardt's method ends."""
    metric, damping, growth = None, 1e-2, 2.0
    residual, jac, _ = loops.residual(q)
    residual = residual - target
    for number in range(most):
        if np.abs(residual).max(initial=0.0) <= 1e-3 * CLOSED:
            break
        if number % 10 == 0:
            metric = loops.metric(q)[np.ix_(free, free)]
        some = jac[:, free]
        normal, slope = some.T @ some, some.T @ residual
        change = np.zeros(loops.nv)
        try:
            change[free] = -np.linalg.solve(normal + damping * metric, slope)
        except np.linalg.LinAlgError:
            damping *= 10.0
            continue
        largest = np.abs(change / loops.scale).max(initial=0.0)
        if largest <= 1e-14:
            break
        change *= min(1.0, LARGEST_STEP / largest)
        trial = loops.moved(q, change)
        found = loops.residual(trial, wanted=False)[0] - target
        before, after = residual @ residual, found @ found
        expected = before - np.sum((residual + jac @ change) ** 2)
        gain = (before - after) / expected if expected > 0.0 else -1.0
        if gain > 0.0:
            q = trial
            residual, jac, _ = loops.residual(q)
            residual = residual - target
            damping = max(1e-14, damping * max(1.0 / 10.0, 1.0 - (2.0 * gain - 1.0) ** 3))
            growth = 2.0
            if before - after < 1e-12 * before and before > 1e-6:
                break
        else:
            damping *= growth
            growth *= 2.0
            if damping > 1e12:
                break
    return q


def _ends(cut):
    """Return the closure of a joint: pairs of directions, normals, pairs at right angles."""
    if cut.type in CUT_WITH_ORIENTATION:
        held = of_quaternion(cut.orientation)
        if cut.type == HELICAL:
            axis = np.array(cut.axis_b)
            return [(held.T @ axis, axis)], _across(axis), []
        same = [(held.T @ axis, axis) for axis in _UNIT]
        return same, None if cut.type == FIXED else _across(np.array(cut.axis_b)), []
    if cut.type in (SPHERICAL, DISTANCE):
        return [], None, []
    if cut.type == POINT_ON_LINE:
        return [], _across(np.array(cut.axis_b)), []
    if cut.type == POINT_ON_PLANE:
        return [], (np.array(cut.axis_b),), []
    a, b = np.array(cut.axis_a), np.array(cut.axis_b)
    if cut.type == UNIVERSAL:
        return [], None, [(a, b)]
    across = {REVOLUTE: None, CYLINDRICAL: _across(b), PLANAR: (b,)}
    return [(a, b)], across[cut.type], []


def _across(axis):
    one = perpendicular(axis)
    return one, cross(axis, one)


def _vector_of(matrix):
    """Return half the axial vector of a matrix: a rotation's axis times the sine of its angle."""
    return 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0],
                           matrix[1, 0] - matrix[0, 1]])


def _parents_first(joints):
    """Return joints in an order in which every parent is carried before."""
    known, order, left = {GROUND}, [], list(joints)
    while left:
        waiting = []
        for joint in left:
            if joint.parent in known:
                known.add(joint.child)
                order.append(joint)
            else:
                waiting.append(joint)
        left = waiting
    return order
