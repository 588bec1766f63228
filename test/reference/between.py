# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms written down without a tree: joints between bodies."""

import numpy as np


def described(mechanism, cut=None):
    """
    Return the data of a mechanism in space with all joints between bodies.

    Parameters
    ----------
    mechanism : Mechanism
        Of which cut joints can be joints of a tree as they are.
    cut : sequence of str, optional
        Joints ordered to be cut, all others to be kept; nothing is ordered when not given.

    Returns
    -------
    dict

    """
    joints = {}
    for joint in mechanism.joints:
        entry = {'type': joint.type, 'between': [joint.parent, joint.child],
                 'points': [list(map(float, joint.position)), [0.0, 0.0, 0.0]],
                 'orientation': {'quaternion': list(map(float, joint.orientation))}}
        if joint.actuated:
            entry['actuated'] = True
        for key in ('axis', 'second_axis'):
            if getattr(joint, key) is not None:
                entry[key] = list(map(float, getattr(joint, key)))
        if joint.lead is not None:
            entry['lead'] = float(joint.lead)
        joints[joint.name] = entry
    for one in mechanism.cut_joints:
        # Body B carries body A where they are not cut.
        entry = {'type': one.type, 'between': [one.body_b, one.body_a],
                 'points': [list(map(float, one.point_b)), list(map(float, one.point_a))]}
        if one.axis_a is not None:
            # Of parallel frames at the start.
            assert np.allclose(one.axis_a, one.axis_b)
            entry['axis'] = list(map(float, one.axis_a))
        joints[one.name] = entry
    if cut is not None:
        for name, entry in joints.items():
            if 'actuated' not in entry:
                entry['cut'] = name in cut
    return {
        'name': mechanism.name,
        'bodies': {body.name: {'massless': True} if body.massless else {
            'mass': float(body.mass), 'center_of_mass': list(map(float, body.center_of_mass)),
            'inertia': list(map(float, body.inertia))} for body in mechanism.bodies},
        'joints': joints,
        'points': {point.name: {'body': point.body, 'position': list(map(float, point.position))}
                   for point in mechanism.points}}
