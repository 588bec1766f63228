# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Mirror images of machines.

All frames are mirrored with their bodies: a place r of a body becomes S r, a rotation R becomes
S R S. Angles about a direction a in space stay as they are about -S a. In the plane every body is
mirrored at its x axis, so that slides keep their directions and angles change sign; the ground is
turned besides by half a turn where its x axis is to be reversed.
"""

from dataclasses import replace

from closedloop_dynamics.formats.pose import Pose
from closedloop_dynamics.mechanism.mechanism import (
    CYLINDRICAL, FREE, GROUND, HELICAL, MESH, PLANAR, POINT_ON_LINE, PRISMATIC,
    REVOLUTE, SPHERICAL, UNTURNED)
from frames import reframed
import numpy as np
from variant import carried_effects, variant

AXES = 'xyz'
HALF_A_TURN = Pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
# Where the numbers xy, xz, yz of an inertia have their axes.
_PRODUCTS = ((0, 1), (0, 2), (1, 2))


def mirrored(scene, axis='x'):
    """
    Return the mirror image of a scene's machine, which moves as its mirror image.

    ``axis``: the coordinate that changes its sign: ``'x'``, ``'y'``, in space ``'z'``, else
    ValueError. Effects that are given in the machine's joints, at its points and by weight are
    mirrored; others are left out.
    """
    mechanism = scene.mechanism
    planar, size = mechanism.planar, 2 if mechanism.planar else 3
    if axis not in AXES[:size]:
        raise ValueError(f'axis: expected one of {", ".join(AXES[:size])}, got {axis!r}')
    # Of the bodies, and of the world.
    flip, world = (np.array([-1.0 if name == one else 1.0 for name in AXES])
                   for one in ('y' if planar else axis, axis))
    turned = planar and axis == 'x'
    signs = _signs(mechanism, flip, turned)
    image = replace(
        mechanism, name=f'{mechanism.name}_mirrored',
        description=f'{mechanism.description} Mirrored: {axis} changes its sign.'.strip(),
        bodies=tuple(_body(body, flip) for body in mechanism.bodies),
        joints=tuple(_joint(joint, flip) for joint in mechanism.joints),
        cut_joints=tuple(_cut(cut, flip) for cut in mechanism.cut_joints),
        points=tuple(replace(point, position=_place(point.position, flip))
                     for point in mechanism.points),
        couplings=tuple(replace(coupling, joints={
            name: signs.get(name, 1) * factor for name, factor in coupling.joints.items()})
            for coupling in mechanism.couplings),
        ground_visual=tuple(_visual(visual, flip) for visual in mechanism.ground_visual))
    if turned:
        image, _ = reframed(image, {GROUND: HALF_A_TURN})
    effects, left_out = carried_effects(
        scene, signs, lambda vector: _place(vector, world),
        lambda body, place, inertia: (_place(place, flip), _inertia(inertia, flip)))
    initial = replace(
        scene.initial, position=_state(mechanism, scene.initial.position, flip, 'coordinates'),
        velocity=_state(mechanism, scene.initial.velocity, flip, 'rates'))
    return variant(scene, image, initial, effects, left_out)


def _place(values, flip):
    return tuple((flip[:len(values)] * values).tolist())


def _turn(quaternion, flip):
    """Return the mirrored rotation of a unit quaternion."""
    return quaternion if quaternion == UNTURNED else (
        *(-flip * quaternion[:3]).tolist(), quaternion[3])


def _inertia(inertia, flip):
    if not isinstance(inertia, tuple) or len(inertia) == 3:
        return inertia
    return (*inertia[:3], *(value * float(flip[i] * flip[k])
                            for value, (i, k) in zip(inertia[3:], _PRODUCTS)))


def _visual(visual, flip):
    scale = _place(visual.size, flip) if visual.kind == MESH else visual.size
    return replace(visual, size=scale, center=_place(visual.center, flip),
                   orientation=_turn(visual.orientation, flip))


def _body(body, flip):
    return replace(body, center_of_mass=_place(body.center_of_mass, flip),
                   inertia=_inertia(body.inertia, flip),
                   visual=tuple(_visual(visual, flip) for visual in body.visual))


def _axis(kind, axis, flip):
    """Return the axis of a mirrored joint: of slides as it is seen, of turns the other way."""
    if axis is None:
        return None
    return _place(axis, flip if kind in (PRISMATIC, POINT_ON_LINE) else -flip)


def _joint(joint, flip):
    return replace(
        joint, position=_place(joint.position, flip), angle=-joint.angle,
        orientation=_turn(joint.orientation, flip), axis=_axis(joint.type, joint.axis, flip),
        second_axis=_axis(joint.type, joint.second_axis, flip),
        lead=None if joint.lead is None else -joint.lead)


def _cut(cut, flip):
    return replace(
        cut, point_a=_place(cut.point_a, flip), point_b=_place(cut.point_b, flip),
        angle=-cut.angle, axis_a=_axis(cut.type, cut.axis_a, flip),
        axis_b=_axis(cut.type, cut.axis_b, flip), orientation=_turn(cut.orientation, flip),
        lead=None if cut.lead is None else -cut.lead)


def _signs(mechanism, flip, turned):
    """Return the sign of each joint's and freedom's coordinate, None where it has none."""
    coordinates = mechanism.coordinates
    ones = _state(mechanism, np.ones(coordinates.nv), flip, 'rates')
    signs = {name: int(sign) for name, sign in zip(coordinates.names, ones)}
    signs.update(dict.fromkeys(coordinates.with_orientation, 1))
    signs.update(dict.fromkeys(mechanism.cut_coordinates.names))
    for cut in mechanism.cut_joints:
        if cut.type == PRISMATIC:
            # A line in body B, along the x axis of body A.
            signs[cut.name] = -1 if turned and cut.body_a == GROUND else 1
        elif cut.type in (REVOLUTE, HELICAL):
            signs[cut.name] = -1 if mechanism.planar else 1
    return signs


def _state(mechanism, values, flip, what):
    """Return coordinates or rates of the mirrored machine."""
    found, places = np.array(values, dtype=float), getattr(mechanism.coordinates, what)
    for joint in mechanism.joints:
        part = found[places[joint.name]]
        if mechanism.planar:
            part *= -1.0 if joint.type == REVOLUTE else 1.0
        elif joint.type == CYLINDRICAL:
            # About the reversed axis it turns as before, and slides the other way.
            part[1] *= -1.0
        elif joint.type == PLANAR:
            part *= [flip[0], flip[1], -flip[2]]
        elif joint.type in (SPHERICAL, FREE):
            part[:] = [*(flip * part[:3] if joint.type == FREE else ()),
                       *(-flip * part[-4:-1] if what == 'coordinates' else -flip * part[-3:]),
                       *(part[-1:] if what == 'coordinates' else ())]
    return tuple(found.tolist())
