# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Random mechanisms whose loops close by joints that repeat one another, and their slow twin.

Two or three joints between the same bodies, or a small ring of bodies; on the ground, on one or on
two moving bodies, or between two bodies that the ground carries; in the plane and in space; axes
and places of few digits, or drawn. A description is written from the joints as they lie in the
world at home, where all bodies' frames are the world's; the twin has six coordinates for every
body, knows of no tree, and decides ranks at the closed positions nearby.
"""

from typing import NamedTuple

import numpy as np

from .spatial_maximal import complement, cross, hat

PLANE = ('revolute', 'prismatic', 'fixed', 'point_on_line', 'distance')
SPACE = ('revolute', 'prismatic', 'cylindrical', 'universal', 'spherical', 'helical', 'fixed',
         'point_on_line', 'point_on_plane', 'distance')
# Joints that only close loops.
CLOSING = {True: ('fixed', 'point_on_line', 'distance'),
           False: ('point_on_line', 'point_on_plane', 'distance')}
BASES = 'ground', 'arm', 'two arms', 'bridge'
GRAVITY = np.array([0.7, -9.0, -2.0])
NICE_AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 2, 3), (-2, 0, 1))
# Singular values above this, of bodies of about a metre, are of independent equations.
INDEPENDENT = 1e-7
# How far closed positions nearby are looked for [m, rad], and what counts as closed.
NEARBY, CLOSED = 0.05, 1e-11
Z = np.array([0.0, 0.0, 1.0])


class Link(NamedTuple):
    """A joint of body ``a``, the parent, and body ``b``, as it lies in the world at home."""

    name: str
    kind: str
    a: str
    b: str
    point: np.ndarray
    axis: np.ndarray
    second: np.ndarray     # The other axis of a universal joint; of a rod its end on body b
    lead: float


class Machine(NamedTuple):
    """A mechanism as data of a file, and what the twin knows of it."""

    data: dict
    links: tuple           # Of Link
    names: tuple           # Of the bodies
    masses: np.ndarray     # Shape (nb,)
    centers: np.ndarray    # Shape (nb, 3): at home, in the world
    inertias: np.ndarray   # Shape (nb, 3): principal moments, at home along the world's axes
    planar: bool
    text: str              # What was drawn


class Pose(NamedTuple):
    """Axes (columns), and place of what was the world's origin at home."""

    axes: np.ndarray
    origin: np.ndarray


# Drawing.


class _Draw:

    def __init__(self, rng):
        self.rng = rng
        self.planar, self.nice = bool(rng.random() < 0.5), bool(rng.random() < 0.5)

    def place(self):
        found = (self.rng.integers(-2, 3, 3) / 2.0 if self.nice
                 else self.rng.uniform(-1.0, 1.0, 3))
        return found * (1.0, 1.0, 0.0) if self.planar else found

    def direction(self):
        if self.planar:
            angle = self.rng.integers(0, 4) * np.pi / 2 if self.nice else self.rng.uniform(-3, 3)
            return np.array([np.cos(angle), np.sin(angle), 0.0])
        found = np.array(NICE_AXES[self.rng.integers(len(NICE_AXES))], float) if self.nice else (
            self.rng.normal(size=3))
        return found / np.linalg.norm(found)

    def axis(self, kind):
        return self.direction() if not self.planar or kind in ('prismatic', 'point_on_line') else Z

    def link(self, name, kind, a, b, point=None, axis=None):
        point = self.place() if point is None else point
        axis = self.axis(kind) if axis is None else axis
        second = complement(axis)[0]
        if kind == 'distance':
            second = point + self.direction()
        return Link(name, kind, a, b, point, axis, second, float(self.rng.choice((0.1, -0.3))))

    def beside(self, name, kind, first):
        """Return a joint that lies in one way or another to the first one of the same bodies."""
        how = self.rng.choice(('same', 'parallel', 'meeting', 'drawn'), p=(0.4, 0.35, 0.15, 0.1))
        point, axis = {'same': (first.point, first.axis), 'parallel': (None, first.axis),
                       'meeting': (first.point, None), 'drawn': (None, None)}[how]
        if how == 'same' and self.rng.random() < 0.7:
            along = first.axis if not self.planar or abs(first.axis[2]) < 0.5 else 0.0
            point = point + along * (0.5 if self.nice else self.rng.uniform(-1.0, 1.0))
        if self.planar and axis is not None and (
                (abs(axis[2]) > 0.5) == (kind in ('prismatic', 'point_on_line'))):
            axis = None
        return self.link(name, kind, first.a, first.b, point, axis), how

    def kinds(self, closing=False):
        weights = {'fixed': 0.3, 'distance': 0.5, 'point_on_plane': 0.5, 'helical': 0.5}
        known = [kind for kind in (PLANE if self.planar else SPACE)
                 if closing or kind not in CLOSING[self.planar]]
        share = np.array([weights.get(kind, 1.0) for kind in known])
        return str(self.rng.choice(known, p=share / share.sum()))


def draw(rng):
    """Return a Machine."""
    one = _Draw(rng)
    base, links = str(rng.choice(BASES)), []
    ends = ['ground', 'door']
    carriers = ['revolute', 'prismatic'] if one.planar else [
        'revolute', 'prismatic', 'spherical', 'cylindrical', 'universal']
    for n, name in enumerate({'arm': ['arm'], 'two arms': ['arm', 'forearm']}.get(base, [])):
        links.append(one.link(f'carrier_{n}', str(rng.choice(carriers)), ends[0], name))
        ends[0] = name
    if base == 'bridge':
        for n, name in enumerate(('arm', 'door')):
            links.append(one.link(f'carrier_{n}', str(rng.choice(carriers)), 'ground', name))
        ends[0] = 'arm'
    between = bool(rng.random() < 0.5)
    drawn = rng.random()
    if drawn < 0.15 and base != 'bridge':
        text = _ring(one, links, ends[0])
    else:
        count = 2 if drawn < 0.75 else 3
        first = one.link('joint_0', one.kinds(base == 'bridge' and not between), *ends)
        links.append(first)
        text = first.kind
        for n in range(1, count):
            link, how = one.beside(f'joint_{n}', one.kinds(not between), first)
            links.append(link)
            text += f' + {link.kind} {how}'
    if rng.random() < 0.25:
        links.append(one.link('pendulum', 'revolute', 'door', 'bob'))
    text = (f'{"plane" if one.planar else "space"}, {"nice" if one.nice else "drawn"}, '
            f'{"between" if between else "cut"}, on {base}: {text}')
    return _machine(one, links, between, text)


def _ring(one, links, base):
    """Add a four-bar, or three sliders; return what it is."""
    if one.rng.random() < 0.5:
        axis = Z if one.planar else one.direction()
        ends = (base, 'crank'), ('crank', 'door'), ('door', 'rocker'), (base, 'rocker')
        for n, (a, b) in enumerate(ends):
            point = one.place()
            while any(np.linalg.norm(cross(axis, point - link.point)) < 0.2
                      for link in links[-n:][:n]):
                point = one.place() + one.rng.integers(-1, 2, 3) * (1.0, 1.0, 0.0)
            links.append(one.link(f'joint_{n}', 'revolute', a, b, point, axis))
        return 'four-bar'
    first = one.direction()
    across = cross(Z, first) if one.planar else complement(first)[0]
    directions = first, (first + across) / np.sqrt(2.0), across
    if one.planar:
        # Of a body in the plane all slides are along one axis of its own.
        directions = first, first, first
    ends = (base, 'door'), ('door', 'wedge'), (base, 'wedge')
    for n, ((a, b), axis) in enumerate(zip(ends, directions)):
        links.append(one.link(f'joint_{n}', 'prismatic', a, b, None, axis))
    return 'three sliders'


def _machine(one, links, between, text):
    """Write the data of a scene."""
    rng, planar = one.rng, one.planar
    names = tuple(dict.fromkeys(link.b for link in links))
    masses = rng.uniform(0.5, 2.0, len(names))
    centers = np.array([one.place() for _ in names])
    inertias = rng.uniform(0.1, 0.15, (len(names), 3))
    turned, origin, carried = {'ground': 0.0}, {'ground': np.zeros(3)}, set()
    if planar:
        # What slides lies along the X axis of its body.
        for name in names:
            slides = [link for link in links if name == link.b and link.kind == 'prismatic']
            turned[name] = float(np.arctan2(*slides[0].axis[1::-1])) if slides else 0.0
        kept = []
        for link in links:
            if link.kind == 'prismatic':
                angle = turned[link.b]
                link = link._replace(axis=np.array([np.cos(angle), np.sin(angle), 0.0]))
            kept.append(link)
        links = kept
    joints, cuts = {}, {}
    for link in links:
        if link.b not in carried:
            carried.add(link.b)
            origin[link.b] = np.zeros(3) if between else link.point
            where = 'joints'
        else:
            where = 'joints' if between else 'cuts'
        angle = turned.get(link.b, 0.0) - turned.get(link.a, 0.0)
        at_a, at_b = (_within(planar, point, origin[name], turned.get(name, 0.0))
                      for point, name in ((link.point, link.a), (
                          link.second if link.kind == 'distance' else link.point, link.b)))
        entry = {'type': link.kind}
        if planar and link.kind in ('revolute', 'prismatic', 'fixed'):
            entry['angle'] = angle
        if link.kind == 'helical':
            entry['lead'] = link.lead
        axis = link.axis.tolist()
        if where == 'joints':
            if not planar and link.kind not in ('spherical', 'fixed'):
                entry['axis'] = axis
            if link.kind == 'universal':
                entry['second_axis'] = link.second.tolist()
            if between:
                entry.update(between=[link.a, link.b], points=[at_a, at_b])
            else:
                entry.update(parent=link.a, child=link.b, position=at_a)
            joints[link.name] = entry
            continue
        # Body A is the child, as in the tree; a point of it runs in what is fixed in body B.
        entry.update(body_a=link.b, point_a=at_b, body_b=link.a, point_b=at_a)
        if planar and link.kind == 'point_on_line':
            entry['angle'] = float(np.arctan2(*link.axis[1::-1])) - turned[link.a]
        if not planar:
            if link.kind in ('revolute', 'cylindrical'):
                entry.update(axis_a=axis, axis_b=axis)
            elif link.kind == 'universal':
                entry.update(axis_a=link.second.tolist(), axis_b=axis)
            elif link.kind in ('prismatic', 'helical', 'point_on_line', 'point_on_plane'):
                entry['axis_b'] = axis
        if link.kind == 'distance':
            entry['length'] = float(np.linalg.norm(link.second - link.point))
        cuts[link.name] = entry
    size = 2 if planar else 3
    bodies, points = {}, {}
    for name, mass, center, inertia in zip(names, masses, centers, inertias):
        bodies[name] = {
            'mass': float(mass), 'inertia': float(inertia[2]) if planar else inertia.tolist(),
            'center_of_mass': _within(planar, center, origin[name], turned.get(name, 0.0))}
        for n, point in enumerate(np.vstack([np.zeros(3), np.eye(3)[:size]])):
            points[f'{name}_{n}'] = {'body': name, 'position': _within(
                planar, point, origin[name], turned.get(name, 0.0))}
    mechanism = {'name': 'repeated', 'bodies': bodies, 'joints': joints, 'points': points}
    if cuts:
        mechanism['cut_joints'] = cuts
    return Machine(mechanism, tuple(links), names, masses, centers, inertias, planar, text)


def _within(planar, point, origin, angle):
    """Return a place of the world at home in the frame of a body."""
    apart = point - origin
    if not planar:
        return apart.tolist()
    x, y = np.cos(angle), np.sin(angle)
    return [float(x * apart[0] + y * apart[1]), float(x * apart[1] - y * apart[0])]


# The twin.


def home(machine):
    """Return the poses of the bodies at home, by name, the ground among them."""
    return {name: Pose(np.eye(3), np.zeros(3)) for name in ('ground', *machine.names)}


def moved(machine, poses, twists):
    """Return poses after small turns and displacements, shape (6 nb,): turn, then place."""
    found = dict(poses)
    for name, twist in zip(machine.names, twists.reshape(-1, 6)):
        axes, origin = poses[name]
        found[name] = Pose(_turn(twist[:3]) @ axes, origin + twist[3:])
    return found


def _turn(vector):
    angle = np.linalg.norm(vector)
    if angle < 1e-300:
        return np.eye(3)
    unit = hat(vector / angle)
    return np.eye(3) + np.sin(angle) * unit + (1.0 - np.cos(angle)) * unit @ unit


def equations(machine, poses):
    """Return what the joints hold at zero, and the matrix by the bodies' twists."""
    place = {name: 6 * k for k, name in enumerate(machine.names)}
    values, rows = [], []

    def add(value, parts):
        row = np.zeros(6 * len(place))
        for name, turn, slide in parts:
            if name in place:
                row[place[name]:place[name] + 3] += turn
                row[place[name] + 3:place[name] + 6] += slide
        values.append(value)
        rows.append(row)

    for link in machine.links:
        a, b = poses[link.a], poses[link.b]
        # What lies fixed in a, at a point of b: a point of the child in a line of the parent.
        point_b = link.second if link.kind == 'distance' else link.point
        arm_a, arm_b = a.axes @ link.point, b.axes @ point_b
        apart = b.origin + arm_b - a.origin - arm_a

        def along(n):
            add(n @ apart, ((link.b, cross(arm_b, n), n),
                            (link.a, -cross(arm_b + b.origin - a.origin, n), -n)))

        def across(u, v):
            add(u @ v, ((link.a, cross(u, v), np.zeros(3)), (link.b, -cross(u, v), np.zeros(3))))

        axis = a.axes @ link.axis
        sides = [a.axes @ side for side in complement(link.axis)]
        if link.kind == 'distance':
            length = np.linalg.norm(link.second - link.point)
            n = apart / length
            add(0.5 * (n @ apart - length), ((link.b, cross(arm_b, n), n),
                                             (link.a, -cross(arm_a, n), -n)))
            continue
        if link.kind in ('revolute', 'spherical', 'universal', 'fixed', 'point_on_plane'):
            along(axis)
        if link.kind != 'point_on_plane':
            for side in sides:
                along(side)
        if link.kind in ('revolute', 'cylindrical', 'prismatic', 'helical', 'fixed'):
            for side in sides:
                across(side, b.axes @ link.axis)
        own = [b.axes @ side for side in complement(link.axis)]
        if link.kind in ('prismatic', 'fixed'):
            across(sides[0], own[1])
        if link.kind == 'universal':
            across(axis, b.axes @ link.second)
        if link.kind == 'helical':
            angle = np.arctan2(own[0] @ sides[1], own[0] @ sides[0])
            # Whole turns are out of reach here.
            sign = np.sign(np.linalg.det([*complement(link.axis), link.axis]))
            along(axis)
            values[-1] -= sign * link.lead * angle
            for name, factor in ((link.b, -link.lead), (link.a, link.lead)):
                if name in place:
                    rows[-1][place[name]:place[name] + 3] += factor * axis
    if machine.planar:
        for name in machine.names:
            axes, origin = poses[name]
            for n in range(2):
                across_z = np.eye(3)[n]
                add(axes[:, 2] @ across_z, ((name, cross(axes[:, 2], across_z), np.zeros(3)),))
            add(origin[2], ((name, np.zeros(3), Z),))
    return np.array(values), np.array(rows)


def rank(machine, poses):
    """Return how many equations are independent in one position."""
    singular = np.linalg.svd(equations(machine, poses)[1], compute_uv=False)
    return int((singular > INDEPENDENT * max(1.0, singular[0])).sum())


def closed(machine, poses, count):
    """Return the closed poses next to some, by so many independent equations; None where none."""
    for _ in range(30):
        values, rows = equations(machine, poses)
        if np.abs(values).max() <= CLOSED:
            return poses
        left, singular, right = np.linalg.svd(rows)
        poses = moved(machine, poses, -right[:count].T @ (
            left[:, :count].T @ values / singular[:count]))
    return None


class Mobility(NamedTuple):
    """Degrees of freedom at and near a closed position."""

    freedoms: int
    #: Whether every motion of first order is one: else some are none, and ``freedoms`` too many.
    real: bool


def mobility(machine, poses, seed=0):
    """Return the Mobility at and near a closed position."""
    rng, here = np.random.default_rng(seed), rank(machine, poses)
    ranks, real = [here], True
    free = np.linalg.svd(equations(machine, poses)[1])[2][here:]
    for _ in range(4 if len(free) else 0):
        change = free.T @ rng.normal(size=len(free))
        change *= NEARBY / np.abs(change).max()
        near = closed(machine, moved(machine, poses, change), here)
        if near is None:
            # At a change point a combination of two branches is none.
            real = False
            continue
        ranks.append(rank(machine, near))
    most = max(ranks)
    if most > here:
        # Seen from a regular position nearby.
        return Mobility(len(free) + here - most, True)
    return Mobility(len(free), real)


def accelerations(machine, poses, twists):
    """Return the accelerations of the twists, shape (6 nb,): least squares, ranks as above."""
    def bias(poses, twists):
        rate = 1e-4 / max(np.abs(twists).max(), 1e-300)
        ahead, behind = (equations(machine, moved(
            machine, poses, sign * rate * twists))[1] @ twists for sign in (1.0, -1.0))
        return (ahead - behind) / (2.0 * rate)

    _, rows = equations(machine, poses)
    count = 6 * len(machine.names)
    mass, force = np.zeros((count, count)), np.zeros(count)
    gravity = GRAVITY * (1.0, 1.0, 0.0) if machine.planar else GRAVITY
    for k, (name, m, center, inertia) in enumerate(zip(
            machine.names, machine.masses, machine.centers, machine.inertias)):
        axes, _ = poses[name]
        arm, about = axes @ center, axes @ np.diag(inertia) @ axes.T
        spin = twists[6 * k:6 * k + 3]
        shift = np.eye(6)
        shift[3:, :3] = -hat(arm)
        own = slice(6 * k, 6 * k + 6)
        mass[own, own] = shift.T @ np.block(
            [[about, np.zeros((3, 3))], [np.zeros((3, 3)), m * np.eye(3)]]) @ shift
        force[own] = -shift.T @ np.concatenate([
            cross(spin, about @ spin), m * (cross(spin, cross(spin, arm)) - gravity)])
    # In the null space of the equations: multipliers need not be unique.
    left, singular, right = np.linalg.svd(rows)
    independent = int((singular > INDEPENDENT * max(1.0, singular[0])).sum())
    wanted = -bias(poses, twists) if twists.any() else np.zeros(len(rows))
    strong = right[:independent].T @ (left[:, :independent].T @ wanted / singular[:independent])
    free = right[independent:].T
    return strong + free @ np.linalg.solve(
        free.T @ mass @ free, free.T @ (force - mass @ strong)) if free.size else strong


def energy(machine, poses, twists):
    """Return kinetic energy, and that in gravity [J]."""
    kinetic = stored = 0.0
    for k, (name, m, center, inertia) in enumerate(zip(
            machine.names, machine.masses, machine.centers, machine.inertias)):
        axes, origin = poses[name]
        arm, spin = axes @ center, twists[6 * k:6 * k + 3]
        velocity = twists[6 * k + 3:6 * k + 6] + cross(spin, arm)
        kinetic += 0.5 * (m * velocity @ velocity + spin @ axes @ (inertia * (axes.T @ spin)))
        stored -= m * GRAVITY @ (origin + arm)
    return kinetic, stored
