# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The semantic robot description (SRDF) of a mechanism for MoveIt.

MoveIt plans on the tree. A group of the driven joints alone is what may be planned for where they
are as many as the degrees of freedom; all others are passive: MoveIt commands none of them, takes
their positions from ``joint_states`` (of floating ones from ``/tf``), and never moves them while
it plans.
"""

from xml.etree import ElementTree

import numpy as np

from .urdf import joint_names
from ..formats.writing import numbers, written

GROUP = 'driven'


def srdf(mechanism, states=None):
    """
    Return the SRDF, as text, to the URDF of a mechanism.

    ``states``: coordinates of the mechanism by name, shape (nq,), of which those of the driven
    joints become states of their group [rad or m]. ValueError where no joint of the tree that has
    one number is driven.
    """
    coordinates = mechanism.coordinates
    single = set(coordinates.single)
    driven = [place for place in coordinates.actuated if place in single]
    if not driven:
        raise ValueError(f'{mechanism.name}: expected a driven joint of the tree with one number, '
                         'to plan for, got none')
    names = [coordinates.names[place] for place in driven]
    robot = ElementTree.Element('robot', name=mechanism.name)
    group = ElementTree.SubElement(robot, 'group', name=GROUP)
    for name in names:
        ElementTree.SubElement(group, 'joint', name=name)
    for key, position in (states or {}).items():
        state = ElementTree.SubElement(robot, 'group_state', name=key, group=GROUP)
        for name, value in zip(names, np.asarray(position)[[
                coordinates.place[place] for place in driven]]):
            ElementTree.SubElement(state, 'joint', name=name, value=numbers(value))
    for name in joint_names(mechanism):
        if name not in names:
            ElementTree.SubElement(robot, 'passive_joint', name=name)
    pairs = [(joint.parent, joint.child) for joint in mechanism.joints]
    pairs += [(cut.body_a, cut.body_b) for cut in mechanism.cut_joints]
    for pair in dict.fromkeys(tuple(sorted(pair)) for pair in pairs):
        ElementTree.SubElement(robot, 'disable_collisions', link1=pair[0], link2=pair[1],
                               reason='Adjacent')
    return f'<?xml version="1.0"?>\n{written(robot)}'
