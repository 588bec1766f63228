# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Appearance of a mechanism: outlines and colours that pictures, URDF and markers share.

A body is drawn through the points the description gives it: its own joint, the
joints and cut joints it carries, its named points. Colours tell subsystems
apart; all of them can be distinguished by colour-blind readers, too.
"""

import numpy as np

from ..mechanism.decomposition import decompose
from ..mechanism.mechanism import CYLINDRICAL, GROUND, HELICAL, PRISMATIC, REVOLUTE

# Okabe and Ito's palette: subsystems in turn, and what has a colour of its own.
SUBSYSTEM_COLORS = ('#0072B2', '#E69F00', '#009E73', '#56B4E9', '#CC79A7')
CUT_COLOR, FORCE_COLOR, PATH_COLOR = '#D55E00', '#B2182B', '#6A3D9A'
CONTACT_COLOR = '#8C6D31'
# Lines of plots: the palette with its yellow darkened; with the dashes, 21 can be distinguished.
COLORS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#56B4E9', '#B8A200', '#333333')
DASHES = ('-', '--', ':')
DOTS_PER_INCH = 120
# Three points count as on a line where they span less of the outline's own area than this.
FLAT = 1e-9


def marked_points(mechanism, body):
    """
    Return the points that the description gives of a body, shape (m, 2), in space (m, 3).

    They are its own joint, the joints and cut joints it carries, its named points, each once,
    sorted; in the body's frame [m].
    """
    points = [np.zeros(len(mechanism.joints[0].position))]
    points += [joint.position for joint in mechanism.joints if joint.parent == body]
    points += [cut.point_a for cut in mechanism.cut_joints if cut.body_a == body]
    points += [cut.point_b for cut in mechanism.cut_joints if cut.body_b == body]
    points += [point.position for point in mechanism.points if point.body == body]
    return np.unique(np.array(points), axis=0)


def outline(mechanism, body):
    """
    Return the corners of a body as the description suggests them, shape (m, 2), in its frame [m].

    They are one point, the two ends of a bar, or the corners of the convex hull of its marked
    points, counter-clockwise.
    """
    return convex_hull(marked_points(mechanism, body))


def convex_hull(points):
    """Return the convex hull of points in the plane (Andrew's monotone chain)."""
    # Sorted, so that all on one line are in order along it.
    points = np.unique(points, axis=0)
    if len(points) < 3:
        return points
    flat = FLAT * np.ptp(points, axis=0).max() ** 2
    halves = []
    for ordered in (points, points[::-1]):
        half = []
        for point in ordered:
            while len(half) > 1 and _turn(half[-2], half[-1], point) <= flat:
                half.pop()
            half.append(point)
        halves.append(half[:-1])
    return np.array(halves[0] + halves[1])


def _turn(first, second, third):
    """Return twice the area of a triangle, positive counter-clockwise."""
    (x, y), (u, v) = second - first, third - first
    return x * v - y * u


def solid(points):
    """
    Return edges and faces of a body in space, through all its points, shape (m, 3), each once [m].

    Edges are pairs of indices of points, none of a body of less than two. Faces are triangles of
    the convex hull; those of a flat body lie in its plane, a bar has none.
    """
    _, lengths, directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    depth = int(np.sum(lengths > FLAT * lengths.max(initial=0.0)))
    if depth == 0:
        return [], []
    if depth == 3:
        # Takes a tenth of a second, and not all have bodies in space.
        from scipy.spatial import ConvexHull
        faces = [tuple(face) for face in ConvexHull(points).simplices.tolist()]
        pairs = {tuple(sorted(pair)) for a, b, c in faces for pair in ((a, b), (b, c), (c, a))}
        return sorted(pairs), faces
    along = points @ directions[0]
    if depth == 1:
        return [(int(np.argmin(along)), int(np.argmax(along)))], []
    flat = np.column_stack([along, points @ directions[1]])
    corners = [int(np.argmin(np.linalg.norm(flat - corner, axis=1)))
               for corner in convex_hull(flat)]
    return (list(zip(corners, [*corners[1:], corners[0]])),
            [(corners[0], *pair) for pair in zip(corners[1:], corners[2:])])


def joint_axes(mechanism):
    """
    Return the axes that bodies in space turn about.

    They are tuples of a body, and in its frame a place on the axis [m] and its direction, of
    length 1.
    """
    found = [(joint.child, np.zeros(3), joint.axis) for joint in mechanism.joints
             if joint.type in (REVOLUTE, CYLINDRICAL, HELICAL)]
    found += [(cut.body_a, np.array(cut.point_a), cut.axis_a) for cut in mechanism.cut_joints
              if cut.type in (REVOLUTE, CYLINDRICAL) and cut.body_a != GROUND]
    return [(body, place, axis / np.linalg.norm(axis)) for body, place, axis in found]


def body_colors(mechanism):
    """Return the colour of every body, that of its subsystem: ``#RRGGBB`` by the body's name."""
    child = {joint.name: joint.child for joint in mechanism.joints}
    return {child[name]: SUBSYSTEM_COLORS[number % len(SUBSYSTEM_COLORS)]
            for number, tree in enumerate(decompose(mechanism).subsystems) for name in tree}


def sliders(mechanism):
    """Return the names of the bodies that are drawn as blocks on a slide, a set."""
    names = {joint.child for joint in mechanism.joints if joint.type == PRISMATIC}
    names |= {cut.body_a for cut in mechanism.cut_joints if cut.type == PRISMATIC}
    return names - {GROUND}


def rgb(color):
    """Return red, green and blue of ``#RRGGBB``, each 0 to 1."""
    return tuple(int(color[k:k + 2], 16) / 255.0 for k in (1, 3, 5))
