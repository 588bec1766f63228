# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Curves of points while a machine is driven round: exact at every place of them."""

from dataclasses import replace
import math

import numpy as np

from ..kinematics.driven import DrivenKinematics
from ..kinematics.modeling import extent
from ..mechanism.errors import SimulationError
from ..mechanism.kinematics import body_poses, named_point
from ..mechanism.mechanism import DrivingConstraint

# Poses in a turn, points with curves at most, digits of places [m].
POSES, MOST_CURVES, DIGITS = 240, 8, 7


def curves(mechanism, position, points):
    """
    Return the curves of points over the whole range of the first driven joint.

    Of each, name and places [m], one after the other, in space. ``position``, shape (nq,), closes
    the loops; the other driven joints stay, and there is one curve, of the first point. Where the
    joints that are driven do not determine the motion, there are none.
    """
    names = mechanism.coordinates
    driven = [names.names[k] for k in names.actuated if names.place[k] >= 0]
    if not driven or not points or mechanism.motions:
        return []
    try:
        moved = DrivenKinematics(replace(mechanism, motions=tuple(
            DrivingConstraint(joint, freedom=joint) for joint in driven)), position)
        slides = bool(names.lengths[names.index[driven[0]]])
        reach = extent(mechanism) if slides else 2.0 * math.pi
        start, origin = moved.values.copy(), np.array(position)
        way = np.linspace(0.0, reach, POSES + 1)[1:]
        forth, end = _follow(moved, start, way)
        parts = [origin[np.newaxis], forth]
        if end is not None:
            moved.start_at(origin)
            parts.insert(0, _follow(moved, start, -way)[0][::-1])
    except (ValueError, SimulationError):
        return []
    poses = body_poses(mechanism, np.vstack(parts))
    found = []
    for point in points[:MOST_CURVES if len(driven) == 1 else 1]:
        places = named_point(mechanism, poses, point.name)
        places = np.hstack([places, np.zeros((len(places), 3 - places.shape[1]))])
        found.append({'name': point.name, 'places': np.round(places, DIGITS).ravel().tolist()})
    return found


def _follow(moved, start, way):
    values = np.tile(start, (len(way), 1))
    values[:, 0] += way
    motion = moved.follow(values)
    return motion.position, motion.end
