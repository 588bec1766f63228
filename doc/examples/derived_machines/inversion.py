# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Kinematic inversions: the same machine with another link held.

The spanning tree is hung on the new ground: joints between it and the old one change parent and
child. The old ground becomes a link without mass, which the loops have to move.
"""

from dataclasses import replace

from closedloop_dynamics.formats.pose import joint_frame, Pose, poses_at
from closedloop_dynamics.kinematics.assembly import Assembler
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.mechanism.mechanism import (
    Body, CYLINDRICAL, GROUND, HELICAL, MechanismError, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL,
    UNTURNED)
from closedloop_dynamics.mechanism.rotations import angle_of, of_quaternion, quaternion_of
from frames import moved_inertia, moved_place, reframed
import numpy as np
from variant import carried_effects, variant

BASE = 'base'
REVERSIBLE = (REVOLUTE, PRISMATIC, HELICAL, CYLINDRICAL, UNIVERSAL, SPHERICAL)
# A frame whose x axis is reversed, in the plane: what slides back along it goes ahead.
_REVERSED = Pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def inverted(scene, link):
    """
    Return a scene's machine with another link as the ground.

    Parameters
    ----------
    scene : scene_records.Scene
        Of the machine.
    link : str
        The body that is held where it is at the start of the scene.

    Returns
    -------
    variant.Variant
        Effects of weight and in joints are carried over, and springs between points; those in the
        world's axes at points, and in frames of bodies, are left out.

    Raises
    ------
    ValueError
        For the name of no body, joints on the way to it that cannot be reversed, and where no
        loop moves the old ground.
    AssemblyError
        Where the loops of the start cannot be closed.

    """
    mechanism = scene.mechanism
    names = [body.name for body in mechanism.bodies]
    if link not in names:
        raise ValueError(f'ground: expected one of the bodies ({", ".join(names)}), got {link!r}')
    base = BASE
    while base in names:
        base += '_'
    position = Assembler(mechanism, Geometry(mechanism).equations).positions(
        scene.initial.position, scene.initial.hold)
    carrying = {joint.child: joint for joint in mechanism.joints}
    path, body = [], link
    while body != GROUND:
        path.insert(0, carrying[body])
        body = path[0].parent
    # The frames of parents on the way to it are put at their joints.
    frames = {}
    for joint in path:
        if joint.type not in REVERSIBLE:
            raise ValueError(f'ground: joints.{joint.name}: expected a joint that can be '
                             f'reversed ({", ".join(REVERSIBLE)}), got a {joint.type} one')
        frames[joint.parent] = joint_frame(joint)
        if mechanism.planar and joint.type == PRISMATIC:
            frames[joint.parent] @= _REVERSED
    frames[link] = poses_at(mechanism, position)[link].inverse
    try:
        moved, recounted = reframed(mechanism, frames)
    except MechanismError as error:
        raise ValueError(f'ground: {link}: {error}') from None
    signs = _signs(mechanism, path, recounted)
    turned = {joint.name for joint in path}
    called = {GROUND: base, link: GROUND}
    bodies = [one for one in moved.bodies if one.name != link]
    bodies.insert(0, Body(base, 0.0, (0.0,) * (2 if mechanism.planar else 3), 0.0, massless=True,
                          visual=moved.ground_visual))
    held = next(one for one in moved.bodies if one.name == link)
    image = replace(
        moved, name=f'{mechanism.name}_on_{link}', ground_visual=held.visual,
        description=f'{mechanism.description} Inverted: {link} is the ground.'.strip(),
        bodies=tuple(bodies),
        joints=tuple(_reversed(joint, called, frames[joint.child]) if joint.name in turned else
                     replace(joint, parent=called.get(joint.parent, joint.parent),
                             child=called.get(joint.child, joint.child))
                     for joint in moved.joints),
        cut_joints=tuple(replace(cut, body_a=called.get(cut.body_a, cut.body_a),
                                 body_b=called.get(cut.body_b, cut.body_b))
                         for cut in moved.cut_joints),
        points=tuple(replace(point, body=called.get(point.body, point.body))
                     for point in moved.points),
        couplings=tuple(_coupling(coupling, signs) for coupling in moved.couplings))

    if not (mechanism.couplings or _in_a_loop(image, base)):
        raise ValueError(f'ground: {link}: expected a loop through the old ground, which has no '
                         'mass and moves by its loops alone, got none')

    def place(body, values, inertia):
        if body == link:
            return None
        return (moved_place(frames[body], values), moved_inertia(frames[body], inertia)) \
            if body in frames else (values, inertia)

    effects, left_out = carried_effects(scene, signs, None, place, turned)
    left_out.insert(0, f'the mass of {link}, which is held; {base}, the old ground, has none')
    return variant(scene, image, _initial(scene, position, turned, recounted), effects, left_out)


def _in_a_loop(mechanism, body):
    """Return whether a loop moves a body, and not its own joint alone."""
    parents = {joint.child: joint.parent for joint in mechanism.joints}

    def carried(other):
        while other not in (body, GROUND):
            other = parents[other]
        return other == body

    return any(carried(cut.body_a) != carried(cut.body_b) for cut in mechanism.cut_joints)


def _reversed(joint, called, frame):
    """Return a joint of which parent and child have changed places."""
    # It was at the origin of the child, whose frame is another one now.
    place = frame.inverse
    planar = len(joint.position) == 2
    if planar and joint.type == PRISMATIC:
        place @= _REVERSED
    axis, second = (None if each is None else tuple(-value for value in each)
                    for each in (joint.axis, joint.second_axis))
    return replace(
        joint, parent=called.get(joint.child, joint.child),
        child=called.get(joint.parent, joint.parent),
        position=tuple(place.position[:len(joint.position)].tolist()),
        angle=angle_of(place.rotation) if planar else 0.0,
        orientation=UNTURNED if planar else quaternion_of(place.rotation),
        axis=axis if second is None else second, second_axis=None if second is None else axis)


def _signs(mechanism, path, recounted):
    """Return the signs of the coordinates of reversed joints, None where they are others."""
    signs = {}
    for joint in path:
        if joint.type in (REVOLUTE, PRISMATIC, HELICAL, CYLINDRICAL):
            signs[joint.name] = -1 if mechanism.planar and joint.type == REVOLUTE else 1
        else:
            signs.update(dict.fromkeys((joint.name, *(
                name for name in mechanism.coordinates.names
                if mechanism.coordinates.joint_of(name) == joint.name))))
    for name in mechanism.cut_coordinates.names:
        if mechanism.cut_coordinates.joint_of(name) in recounted:
            signs[name] = None
    return signs


def _coupling(coupling, signs):
    if None in [signs.get(name, 1) for name in coupling.joints]:
        raise ValueError(f'ground: couplings.{coupling.name}: expected joints that count as '
                         'before, got a reversed one of several degrees of freedom, or a cut '
                         'joint between bodies whose frames change')
    return replace(coupling, joints={name: signs.get(name, 1) * factor
                                     for name, factor in coupling.joints.items()})


def _initial(scene, position, turned, recounted):
    """Return the start with the coordinates of reversed joints."""
    mechanism, initial = scene.mechanism, scene.initial
    coordinates = mechanism.coordinates
    q, qd, hold = np.array(position), np.array(initial.velocity), list(initial.hold)
    for joint in mechanism.joints:
        if joint.name not in turned:
            continue
        place, rate = coordinates.coordinates[joint.name], coordinates.rates[joint.name]
        if joint.type == SPHERICAL:
            qd[rate] = -of_quaternion(q[place]) @ qd[rate]
            q[place] *= (-1.0, -1.0, -1.0, 1.0)
        elif joint.type == UNIVERSAL:
            q[place], qd[rate] = q[place][::-1].copy(), qd[rate][::-1].copy()
            swapped = {f'{joint.name}.{one}': f'{joint.name}.{other}'
                       for one, other in ((1, 2), (2, 1))}
            hold = [swapped.get(name, name) for name in hold]
        elif mechanism.planar and joint.type == REVOLUTE:
            q[place] *= -1.0
            qd[rate] *= -1.0
    return replace(initial, position=tuple(q.tolist()), velocity=tuple(qd.tolist()),
                   hold=tuple(hold), turned={
                       name: angle for name, angle in initial.turned.items()
                       if mechanism.cut_coordinates.joint_of(name) not in recounted})
