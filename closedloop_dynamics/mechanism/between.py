# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Joints between two bodies, of which the program chooses those that carry and those that are cut.

A body's frame may lie anywhere in it; the records that come of it have it at the joint that
carries the body, its axes as described.
"""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np

from .checks import boolean, list_of, listed, one_of
from .fields import among, at, FieldError, mapping, normalise, shown
from .mechanism import (
    CUT_JOINT_EQUATIONS, CUT_WITH_AXIS_A, CUT_WITH_AXIS_B, CUT_WITH_ZERO, CutJoint, CYLINDRICAL,
    DISTANCE, FIXED, FREE, GROUND, HELICAL, Joint, JOINT_FREEDOMS, JOINT_TYPES, MEASURED, PLANAR,
    POINT_ON_LINE, POINT_ON_PLANE, PRISMATIC, REVOLUTE, SPATIAL_CUT_JOINT_EQUATIONS,
    SPATIAL_MEASURED, UNIVERSAL)
from .rotations import rotated
from .spanning_tree import choose_tree, Edge
from .validation import check_axes, SECTIONS, SPATIAL_SECTIONS

BETWEEN = 'between'
# What closes loops and never carries a body.
CLOSING = (DISTANCE, POINT_ON_LINE, POINT_ON_PLANE)
# Joints whose coordinates mean the same whichever body carries the other.
REVERSIBLE = (REVOLUTE, PRISMATIC, HELICAL, CYLINDRICAL, FIXED)


@dataclass(frozen=True)
class ChosenTree:
    """The tree that was chosen."""

    cut: tuple  # Joints that were cut (tuple of str)
    listed: tuple  # Joints that would be cut, were the tree built in their order (tuple of str)
    #: Joints that may be cut or not (tuple of str).
    open: tuple  # noqa: A003
    #: Where the frame of each body lies in that of its description [m] (dict of str to tuple).
    shifts: dict = field(default_factory=dict)


def two_bodies(value):
    """Return the names of two different bodies."""
    pair = listed(value, 'a list of the names of 2 bodies')
    if len(pair) != 2 or pair[0] == pair[1]:
        raise FieldError('a list of the names of 2 different bodies', shown(pair))
    return pair


def two_places(value, check):
    """Return two places, each through a check."""
    expected = 'a list of 2 places, in the frames of both bodies'
    places = listed(value, expected)
    if len(places) != 2:
        raise FieldError(expected, shown(places))
    return list_of(check)(places)


def link(name, values, bodies, spatial):
    """
    Read a joint between two bodies from its keys, expressions computed.

    Returns the joint, as if the first body carried the second one, its place in the second body's
    frame [m], and whether it is to be cut, or None. ``bodies`` are the names of all; FieldError.
    """
    optional = ('angle', 'actuated', 'orientation', 'axis', 'second_axis', 'lead', 'cut')
    values = dict(mapping(values, ('type', BETWEEN, 'points'), optional))
    cut, points = values.pop('cut', None), values.pop('points')
    checks = (SPATIAL_SECTIONS if spatial else SECTIONS)['joints'][1]
    with at(BETWEEN):
        pair = two_bodies(values.pop(BETWEEN))
        for index, body in enumerate(pair):
            with at(index):
                one_of((*bodies, GROUND), 'the name of a body:')(body)
    with at('points'):
        places = two_places(points, checks['position'])
    if values['type'] in CLOSING:
        raise FieldError(
            f'a joint that may carry a body: {among(JOINT_FREEDOMS if spatial else JOINT_TYPES)}',
            f'{values["type"]}, which only closes a loop', 'it belongs under cut_joints, with '
            'body_a, point_a, body_b and point_b', ('type',))
    joint = normalise(Joint(name, values.pop('type'), *pair, places[0], **values), **checks)
    if cut is not None:
        with at('cut'):
            cut = boolean(cut)
    known = SPATIAL_MEASURED if spatial else MEASURED
    if cut is True and joint.actuated and joint.type not in known:
        raise FieldError(f'a joint that is not cut where it is actuated, but for {among(known)}',
                         'both', path=('cut',))
    return joint, places[1], cut


def with_tree(mechanism, links, orders=None):
    """
    Choose a tree; return the mechanism with joints and cut joints, and ``tree``.

    Joints of ``mechanism`` have parents and children; those between bodies are not among them.
    ``links``: these, as ``link`` returns them, and other joints as Joint, in order; ``orders``:
    which of them to cut and which not, beside what they say. FieldError.
    """
    spatial = len(mechanism.bodies[0].center_of_mass) == 3
    kept = {joint for coupling in mechanism.couplings for joint in coupling.names}
    edges, found, free = [], [], []
    for name, one in links.items():
        if isinstance(one, Joint):
            joint, point, cut = one, (0.0,) * (3 if spatial else 2), False
        else:
            joint, point, cut = one
            if spatial:
                check_axes(SimpleNamespace(joints=(joint,), cut_joints=()))
            if cut is None and (joint.actuated or name in kept or joint.type == FREE):
                cut = False
            if cut is None:
                free.append(name)
            cut = (orders or {}).get(name, cut)
        found.append((joint, point))
        edges.append(Edge(
            name, joint.parent, joint.child, JOINT_FREEDOMS.get(joint.type, 1),
            (SPATIAL_CUT_JOINT_EQUATIONS if spatial else CUT_JOINT_EQUATIONS).get(joint.type, 0),
            spatial and joint.type in REVERSIBLE and not isinstance(one, Joint), cut))
    equations = SPATIAL_CUT_JOINT_EQUATIONS if spatial else CUT_JOINT_EQUATIONS
    children = {joint.name: joint.child for joint, _ in found}
    closures = [((cut.body_a, cut.body_b), equations[cut.type]) for cut in mechanism.cut_joints]
    closures += [(tuple(children[joint] for joint in coupling.names if joint in children), 1)
                 for coupling in mechanism.couplings]
    chosen, first = choose_tree([body.name for body in mechanism.bodies], edges, closures)
    shifts = {GROUND: np.zeros(3 if spatial else 2)}
    for body, (index, turned) in chosen.carriers.items():
        joint, point = found[index]
        shifts[body] = np.array(joint.position if turned else point)
    carried = dict(chosen.carriers.values())
    joints = [_joint(joint, point, carried[index], shifts)
              for index, (joint, point) in enumerate(found) if index in carried]
    cuts = [_cut(*found[index], shifts, spatial) for index in chosen.cut]
    return replace(
        mechanism, joints=tuple(joints),
        bodies=tuple(_body(body, shifts[body.name]) for body in mechanism.bodies),
        cut_joints=(*cuts, *(replace(
            cut, point_a=_moved(cut.point_a, shifts.get(cut.body_a)),
            point_b=_moved(cut.point_b, shifts.get(cut.body_b)))
            for cut in mechanism.cut_joints)),
        points=tuple(replace(point, position=_moved(point.position, shifts.get(point.body)))
                     for point in mechanism.points),
        tree=ChosenTree(tuple(edges[index].name for index in chosen.cut),
                        tuple(edges[index].name for index in first.cut) if orders is None
                        else (), tuple(free),
                        {body: tuple(shift.tolist()) for body, shift in shifts.items()}))


def _body(body, shift):
    """Return a body in its moved frame."""
    visual = tuple(replace(one, center=_moved(one.center, np.append(shift, 0.0)[:3]))
                   for one in body.visual)
    return replace(body, visual=visual, center_of_mass=body.center_of_mass if body.massless
                   else _moved(body.center_of_mass, shift))


def _moved(place, shift):
    """Return a place in a moved frame; unchanged where the move is unknown."""
    if shift is None or not shift.any() or len(place) != len(shift):
        return place
    return tuple((np.array(place) - shift).tolist())


def _joint(joint, point, turned, shifts):
    """Return a joint of the tree."""
    if not turned:
        return replace(joint, position=_moved(joint.position, shifts[joint.parent]))
    x, y, z, w = joint.orientation
    axis = None if joint.axis is None else tuple((0.0 - _turned(joint)).tolist())
    return replace(
        joint, parent=joint.child, child=joint.parent, axis=axis,
        position=_moved(point, shifts[joint.child]), orientation=(0.0 - x, 0.0 - y, 0.0 - z, w))


def _cut(joint, point, shifts, spatial):
    """Return a joint that is cut: body A is the second one."""
    keys = {}
    if not spatial:
        keys = {'angle': joint.angle}
    else:
        if joint.type in CUT_WITH_AXIS_B:
            keys['axis_b'] = tuple(_turned(joint).tolist())
        if joint.type in CUT_WITH_AXIS_A:
            keys['axis_a'] = {UNIVERSAL: joint.second_axis, PLANAR: (0.0, 0.0, 1.0)}.get(
                joint.type, joint.axis)
        if joint.type in CUT_WITH_ZERO:
            keys['orientation'] = joint.orientation
        if joint.type == HELICAL:
            keys['lead'] = joint.lead
    return CutJoint(joint.name, joint.type, joint.child, joint.parent,
                    _moved(point, shifts[joint.child]),
                    _moved(joint.position, shifts[joint.parent]), actuated=joint.actuated,
                    **keys)


def _turned(joint):
    """Return a joint's axis in the frame of the first body."""
    return rotated(joint.orientation, (0.0, 0.0, 1.0) if joint.type == PLANAR else joint.axis)
