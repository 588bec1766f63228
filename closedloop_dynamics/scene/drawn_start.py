# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A start given as it is drawn: by places of pins and points, or poses of bodies, in the world.

Joint coordinates follow: those of each joint from what is on the body that it carries, then all of
them together, with the loops closed, as near to the drawing as they can be.
"""

import math

import numpy as np

from ..kinematics.geometry import Geometry
from ..kinematics.modeling import extent
from ..mechanism.fields import among, FieldError, nearest
from ..mechanism.kinematics import body_poses, pose_of, world_points
from ..mechanism.mechanism import (
    CYLINDRICAL, DISTANCE, FIXED, FREE, GROUND, HELICAL, PLANAR, PRISMATIC, REVOLUTE)
from ..mechanism.rotations import composed, CONJUGATE, quaternion_of_angles

# A drawing is approximate: what lies farther from its place is an error [of the extent].
FARTHEST = 0.25
# How much more an open loop counts than a place that is missed.
CLOSED = 1e3
# How much a change of a coordinate counts beside a place that is missed: its square, by which the
# place is missed then, is rounding.
STILL = 1e-5
# Starts of a search, which ends where all is reached so far [of the extent].
STARTS, REACHED = 8, 1e-6
# Joints that carry a body along: their place is that of the body alone.
_SLIDING = (PRISMATIC, CYLINDRICAL, HELICAL, PLANAR, FREE)


def drawn_position(mechanism, places, poses, start):
    """
    Return joint coordinates that bring what is drawn to where it is drawn, shape (nq,).

    Parameters
    ----------
    mechanism : Mechanism
        Its tolerance of digits has nothing to do with that of a drawing.
    places : mapping of str to sequence of 2 or 3 floats
        Of joints, cut joints and points, in the world [m]; of a joint that slides, where the body
        that it carries has its joint.
    poses : mapping of str to sequence of 3 or 6 floats
        Of frames of bodies as they are described: x, y [m] and angle [rad], in space x, y, z [m]
        and turns about the axes x, y and z of the world, one after the other [rad].
    start : ndarray, shape (nq,)
        Where joints are that nothing of the drawing is about [rad or m].

    Raises
    ------
    FieldError
        For a name of nothing that has a place, and a place that is missed by more than FARTHEST.

    """
    drawn, size = _Drawing(mechanism, places, poses), extent(mechanism)
    q, coordinates = np.array(start, dtype=float), mechanism.coordinates
    # Half a turn either way, of joints that nothing of the drawing is about.
    loose = np.where(coordinates.lengths, 0.0, math.pi)
    for joint in _parents_first(mechanism):
        if drawn.about(joint):
            q, own = _carried(mechanism, drawn, joint, q, size)
            loose[own] = 0.0

    equations = Geometry(mechanism).equations

    def errors(position, closed=CLOSED):
        bodies = body_poses(mechanism, position)
        return np.array([*drawn.errors(bodies, size),
                         *closed * equations.move(position).closures()[0]])

    def missed(position):
        return np.abs(errors(position, 1.0)).max(initial=0.0) / size

    rng, found = np.random.default_rng(0), []
    for k in range(STARTS if loose.any() else 1):
        change = loose * rng.uniform(-1.0, 1.0, coordinates.nv) * (k > 0)
        begun = _with_whole_turns(mechanism, coordinates.moved(q, change))
        found.append(_least(mechanism, size, errors, begun, np.arange(coordinates.nv)))
        if missed(found[-1]) < REACHED:
            break
    # The first of those that are as good, from where the start says.
    q = min(found, key=lambda one: round(missed(one) / REACHED))
    drawn.require_near(body_poses(mechanism, q), size)
    return q


class _Drawing:
    """What is drawn: points of bodies at places in the world, and poses of bodies."""

    def __init__(self, mechanism, places, poses):
        self._mechanism, self._marks, self._poses = mechanism, [], {}
        known = {}
        origin = (0.0,) * (2 if mechanism.planar else 3)
        for point in mechanism.points:
            known[point.name] = [(point.body, point.position)]
        for cut in mechanism.cut_joints:
            if cut.type != DISTANCE:
                known[cut.name] = [(cut.body_a, cut.point_a)]
                if cut.type in (REVOLUTE, FIXED) or not (
                        mechanism.planar or cut.type in _SLIDING):
                    known[cut.name].append((cut.body_b, cut.point_b))
        for joint in mechanism.joints:
            known[joint.name] = [(joint.child, origin)]
            if joint.type not in _SLIDING:
                known[joint.name].append((joint.parent, joint.position))
        for name, place in places.items():
            if name not in known:
                raise FieldError(f'a joint or point: {among(known)}', repr(name),
                                 nearest(name, known), ('at', name))
            self._marks += [(name, body, local, np.array(place)) for body, local in known[name]]
        shifts = {} if mechanism.tree is None else mechanism.tree.shifts
        names = [body.name for body in mechanism.bodies]
        for name, pose in poses.items():
            if name not in names:
                raise FieldError(f'a body: {among(names)}', repr(name), nearest(name, names),
                                 ('poses', name))
            pose = np.array(pose)
            turn = pose[2:] if mechanism.planar else np.array(quaternion_of_angles(*pose[3:]))
            pose = np.concatenate([pose[:len(origin)], turn])
            pose[:len(origin)] = world_points(pose, shifts.get(name, origin))
            self._poses[name] = pose

    def about(self, joint):
        """Return whether a coordinate of a joint follows from what is drawn on its body."""
        return joint.child in self._poses or any(
            body == joint.child and (np.any(local) or joint.type in _SLIDING)
            for _, body, local, _ in self._marks)

    def errors(self, bodies, size, only=None):
        """Return how far all, or what is on one body, is from where it is drawn [m]."""
        found = []
        for _, body, local, place in self._marks:
            if only in (None, body):
                found += list(world_points(pose_of(self._mechanism, bodies, body), local) - place)
        for body, wanted in self._poses.items():
            if only in (None, body):
                pose = pose_of(self._mechanism, bodies, body)
                axes = 2 if self._mechanism.planar else 3
                turn = (np.sin(0.5 * (pose[2:] - wanted[2:])) if axes == 2 else
                        composed(CONJUGATE * wanted[3:], pose[3:])[:3])
                found += [*(pose[:axes] - wanted[:axes]), *(size * turn)]
        return found

    def require_near(self, bodies, size):
        """Raise FieldError where something is far from where it is drawn."""
        for name, body, local, place in self._marks:
            found = world_points(pose_of(self._mechanism, bodies, body), local)
            if math.dist(found, place) > FARTHEST * size:
                raise FieldError(
                    f'a place that {name} can have with closed loops, within '
                    f'{FARTHEST * size:.3g} m', f'{place.tolist()}, the nearest to which is '
                    f'[{", ".join(f"{x:.6g}" for x in found)}]',
                    'the lengths of the bodies are others than drawn', ('at', name))
        for body in self._poses:
            missed = np.abs(self.errors(bodies, size, body)).max()
            if missed > FARTHEST * size:
                raise FieldError(f'a pose that {body} can have with closed loops, within '
                                 f'{FARTHEST * size:.3g} m', f'one missed by {missed:.3g} m',
                                 path=('poses', body))


def _parents_first(mechanism):
    carrier, found = {joint.child: joint for joint in mechanism.joints}, {}

    def visit(joint):
        if joint.parent != GROUND:
            visit(carrier[joint.parent])
        found[joint.name] = joint

    for joint in mechanism.joints:
        visit(joint)
    return found.values()


def _carried(mechanism, drawn, joint, q, size):
    """Return a position in which a joint brings its body to where it is drawn, by which rates."""
    carrier = {one.child: one for one in mechanism.joints}
    chain, coordinates = [joint], mechanism.coordinates
    # With bodies before it on which nothing is drawn, as cylinders before their rods.
    while chain[-1].parent != GROUND and not drawn.about(carrier[chain[-1].parent]):
        chain.append(carrier[chain[-1].parent])
    own = np.concatenate([np.arange(coordinates.nv)[coordinates.rates[one.name]]
                          for one in chain])
    if not len(own):
        return q, own
    turning = np.zeros(coordinates.nv)
    turning[own] = np.where(coordinates.lengths[own], 0.0, math.pi)
    rng = np.random.default_rng(0)

    def errors(position):
        return np.array(drawn.errors(body_poses(mechanism, position), size, joint.child))

    def cost(position):
        # Of two ways to the same place, prefer that on which rods come out of their cylinders.
        slid = position[coordinates.place[own]][coordinates.lengths[own]]
        missed = np.abs(errors(position)).max() / size
        return missed * (missed > REACHED), np.count_nonzero(slid < 0.0)

    best = None
    for k in range(STARTS * len(own) if turning.any() else 1):
        change = turning * rng.uniform(-1.0, 1.0, coordinates.nv) * (k > 0)
        found = _least(mechanism, size, errors, coordinates.moved(q, change), own)
        if best is None or cost(found) < cost(best):
            best = found
        if cost(best) == (0.0, 0):
            break
    for one in reversed(chain):
        if mechanism.planar and one.type == REVOLUTE:
            # Angles of bodies are within half a turn.
            angle = pose_of(mechanism, body_poses(mechanism, best), one.child)[2]
            best[coordinates.coordinates[one.name]] -= (
                2.0 * math.pi * math.ceil(angle / (2.0 * math.pi) - 0.5))
    return best, own


def _with_whole_turns(mechanism, q):
    """Return a position of a planar mechanism whose sliding cut joints are not a turn open."""
    if not mechanism.planar:
        return q
    carrier = {joint.child: joint for joint in mechanism.joints}

    def chain(body):
        while body != GROUND:
            if carrier[body].type == REVOLUTE:
                yield carrier[body].name
            body = carrier[body].parent

    for cut in mechanism.cut_joints:
        if cut.type in (PRISMATIC, FIXED):
            bodies = body_poses(mechanism, q)
            turns = round(float(pose_of(mechanism, bodies, cut.body_a)[2] - pose_of(
                mechanism, bodies, cut.body_b)[2] - cut.angle) / (2.0 * math.pi))
            for body, other, sign in ((cut.body_a, cut.body_b, -1.0),
                                      (cut.body_b, cut.body_a, 1.0)):
                name = next((one for one in chain(body) if one not in set(chain(other))), None)
                if name is not None:
                    q[mechanism.coordinates.coordinates[name]] += sign * 2.0 * math.pi * turns
                    break
    return q


def _least(mechanism, size, errors, start, own):
    """Return the position with the least errors that some freedoms lead to from a start."""
    # Here, as most scenes start from joint coordinates.
    from scipy.optimize import least_squares
    moved, nv = mechanism.coordinates.moved, mechanism.coordinates.nv

    def position(change):
        whole = np.zeros(nv)
        whole[own] = change
        return moved(start, whole)

    # What nothing of the drawing is about stays.
    return position(least_squares(
        lambda change: np.concatenate([errors(position(change)), STILL * size * change]),
        np.zeros(len(own)), xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
