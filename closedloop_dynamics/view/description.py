# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Description of a mechanism for a page: shapes, joints, colours, names, columns of its rows.

All places are in space: a planar mechanism lies in the plane z = 0 of the world, its links in
layers above it.
"""

from pathlib import Path

import numpy as np

from .effect_shapes import effect_lines, surfaces, wires
from .machine_shapes import BLOCK, BLOCK_WIDTH, joint_axis, MachineShapes
from .meshes import MeshError, MOST_OF_ALL, MOST_TRIANGLES, read_mesh
from .messages import FASTEST, SLOWEST
from ..effects.registry import effect_type
from ..kinematics.modeling import extent
from ..mechanism.decomposition import decompose
from ..mechanism.meanings import documented, unit_in
from ..mechanism.mechanism import BOX, CYLINDER, DISTANCE, GROUND, MESH, SPHERE
from ..mechanism.rotations import in_three, of_quaternion
from ..scene.integrators import INTEGRATORS, STABILISATIONS
from ..visual.appearance import (
    body_colors, CONTACT_COLOR, CUT_COLOR, marked_points, outline, solid)
from ..visual.urdf import depths

# Of links, as shares of the size that they are drawn by: radius of bars, thickness of plates and
# the distance between layers; that size in radii of the smallest wheel, at most.
BAR, THICKNESS, LAYER, SLENDER = 0.022, 0.016, 0.03, 16.0
# Gravity of the weight that forces are compared with [m/s^2].
EARTH = 9.81
# Digits of the places of a mesh's points, below the size of the mesh.
MESH_DIGITS = 4
# What a page can choose while a mechanism moves.
CHOICES = {'integrators': {name: one.kind for name, one in INTEGRATORS.items()},
           'stabilisations': list(STABILISATIONS), 'speeds': [SLOWEST, FASTEST]}


def describe(mechanism, columns, effects=None, **more):
    """
    Describe a mechanism for a page, as JSON can.

    ``columns`` are those of the rows that the page gets; of the effects springs, cables and
    contacts are drawn; ``more`` is further data.
    """
    effects, missing, extras = effects or {}, [], MachineShapes(mechanism, effects or {})
    size = drawn_size(mechanism, extras)
    thick = extras.thickness(size, SLENDER)
    rows = {GROUND: -1, **{body.name: k for k, body in enumerate(mechanism.bodies)}}
    heights = _heights(mechanism, thick)
    colors = body_colors(mechanism)
    outlines = wires(mechanism, effects, rows, heights, LAYER * thick)
    outlined = {wire['body'] for wire in outlines}
    outlines += extras.wires(rows, heights, thick)
    wheels = extras.height(heights, thick)
    tops = {**heights, **{wheel.body: max(wheels, heights[wheel.body])
                          for wheel in extras.wheels}}
    drawn = [mechanism.ground_visual, *(body.visual for body in mechanism.bodies)]
    meshes = sum(visual.kind == MESH for some in drawn for visual in some)
    most = min(MOST_TRIANGLES, MOST_OF_ALL // max(meshes, 1))
    trees = decompose(mechanism).subsystems
    child = {joint.name: joint.child for joint in mechanism.joints}
    subsystem = {child[name]: number for number, tree in enumerate(trees) for name in tree}
    return {
        'name': mechanism.name, 'planar': mechanism.planar, 'size': size,
        'thick': thick,
        'weight': EARTH * sum(body.mass for body in mechanism.bodies),
        'colors': {'cut': CUT_COLOR, 'load': CONTACT_COLOR},
        'subsystems': [colors[child[tree[0]]] for tree in trees],
        'bodies': [{
            'name': body.name, 'color': colors[body.name], 'subsystem': subsystem[body.name],
            'shapes': [
                *(_visuals(body.name, body.visual, thick, heights[body.name], most, missing)
                  or _shapes(mechanism, body.name, thick, heights[body.name], extras,
                             rows[body.name] in outlined)),
                *extras.shapes(body.name, heights, thick)],
            'grabs': grabs(mechanism, body).tolist()} for body in mechanism.bodies],
        'ground': [*_visuals(GROUND, mechanism.ground_visual, thick, 0.0, most, missing),
                   *extras.shapes(GROUND, heights, thick)],
        'joints': [{
            'name': joint.name, 'type': joint.type, 'parent': rows[joint.parent],
            'child': rows[joint.child], 'actuated': joint.actuated,
            'place': in_three(joint.position).tolist(), 'axis': joint_axis(joint),
            'heights': sorted((heights[joint.parent], tops[joint.child]))}
            for joint in mechanism.joints],
        'cuts': [{
            'name': cut.name, 'type': cut.type, 'body_a': rows[cut.body_a],
            'body_b': rows[cut.body_b], 'a': cut.body_a, 'b': cut.body_b,
            'point_a': in_three(cut.point_a).tolist(), 'point_b': in_three(cut.point_b).tolist(),
            'heights': sorted((heights[cut.body_a], heights[cut.body_b]))}
            for cut in mechanism.cut_joints],
        'guides': extras.guides(rows, heights, thick),
        'lines': [*_rods(mechanism, rows, heights),
                  *effect_lines(mechanism, effects, rows, heights, LAYER * thick)],
        'surfaces': surfaces(effects),
        'wires': outlines, 'missing': missing,
        # The path of the first one is seen: those of the ground, which have none, come last.
        'points': [{'name': point.name, 'body': rows[point.body],
                    'place': in_three(point.position).tolist()}
                   for point in sorted(mechanism.points, key=lambda one: one.body == GROUND)],
        'meanings': {effect_type(record): {
            key: {'meaning': meaning, 'unit': unit_in(meaning)}
            for key, (_, meaning) in documented(type(record)).items()}
            for record in effects.values()},
        **columns.layout, **more}


def described_drive(mechanism, name, position, torque, modes):
    """
    Describe the drive of a joint, as JSON can, for ``describe``.

    ``position``, shape (nq,) [rad or m], is the middle of a position's slider, ``torque`` [N m or
    N] the end of a torque's, ``modes`` are those that can be chosen.
    """
    names = mechanism.coordinates
    place = names.index[name]
    slides, middle = bool(names.lengths[place]), float(names.by_freedom(position)[place])
    reach = extent(mechanism) if slides else np.pi
    turns = bool(names.place[place] < 0)
    return {'joint': name, 'slides': slides, 'turns': turns, 'torque': torque,
            'modes': list(modes[:1] if turns else modes),
            'position': [middle - reach, middle + reach], 'speed': 4.0 * reach}


def drawn_size(mechanism, extras):
    """Return the largest extent of a body as it is drawn, or of the joints of the ground [m]."""
    spans = [np.ptp(marked_points(mechanism, name), axis=0).max()
             for name in (GROUND, *(body.name for body in mechanism.bodies))]
    return float(max(extras.size(), *spans)) or extent(mechanism)


def grabs(mechanism, body):
    """
    Return the places by which a Body can be taken hold of, shape (n, 3), in its frame [m].

    They are its joints, cut joints and named points, and its centre of mass.
    """
    places = np.vstack([marked_points(mechanism, body.name), body.center_of_mass])
    places = np.unique(places, axis=0)
    return np.hstack([places, np.zeros((len(places), 3 - places.shape[1]))])


def _heights(mechanism, size):
    """Return the layer of each body above the plane [m]; all zero in space."""
    found = depths(mechanism)
    return {name: LAYER * size * depth * mechanism.planar for name, depth in found.items()}


def _shapes(mechanism, body, size, height, extras, outlined):
    """Return the shapes of a body, in its frame [m]."""
    radius, marks = BAR * size, marked_points(mechanism, body)
    if extras.covers(body, marks):
        return _stem(extras, body, size, height)
    if not mechanism.planar:
        return _bars(marks, radius)
    corners = [[*corner, height] for corner in outline(mechanism, body).tolist()]
    shapes = []
    if len(corners) > 2:
        shapes.append({'kind': 'plate', 'corners': corners, 'thickness': THICKNESS * size})
    if len(corners) > 1:
        ends = [*corners, corners[0]] if len(corners) > 2 else corners
        shapes += [{'kind': 'bar', 'from': start, 'to': end, 'radius': radius,
                    'flat': THICKNESS * size} for start, end in zip(ends, ends[1:])]
    block = extras.block(body)
    if block is not None:
        shapes.append(_block(block, size, height))
    elif len(corners) == 1 and not outlined:
        shapes.append(_block(corners[0], size, height))
    return shapes


def _stem(extras, body, size, height):
    """Return the stem between a follower's roller and its sliding block; none for others."""
    reach = extras.stem(body, size)
    if extras.block(body) is None or not reach:
        return []
    start, end = [0.0, 0.0, height], [reach, 0.0, height]
    return [{'kind': 'bar', 'from': start, 'to': end, 'radius': 0.6 * BAR * size,
             'flat': THICKNESS * size}, _block(end, size, height)]


def _block(place, size, height):
    return {'kind': 'box', 'center': [*place[:2], height],
            'size': [2.0 * BLOCK * size, 2.0 * BLOCK_WIDTH * size, 1.2 * THICKNESS * size]}


def _visuals(name, visuals, size, height, most, missing):
    """Return the shapes that a body is to be drawn as; list the meshes that are missing."""
    shapes = []
    for visual in visuals:
        center = (np.array(visual.center) + (0.0, 0.0, height)).tolist()
        axes = of_quaternion(visual.orientation)
        if visual.kind == BOX:
            shapes.append({'kind': 'box', 'center': center, 'size': list(visual.size),
                           'axes': axes.T.tolist()})
        elif visual.kind == SPHERE:
            shapes.append({'kind': 'ball', 'center': center, 'radius': visual.size[0]})
        elif visual.kind == CYLINDER:
            radius, length = visual.size
            half = 0.5 * length * axes[:, 2]
            # A thin rod is a line, drawn as wide as bars are.
            shapes.append({'kind': 'cylinder', 'from': (center - half).tolist(),
                           'to': (center + half).tolist(), 'radius': radius or BAR * size})
        else:
            try:
                shapes.append(_mesh(visual, axes, center, most))
            except MeshError as error:
                missing.append(f'{name}: {error}')
                continue
        if visual.color is not None:
            shapes[-1]['color'] = '#' + ''.join(f'{round(255 * part):02x}' for part in (
                visual.color))
    return shapes


def _mesh(visual, axes, center, most):
    """Return a mesh in its body's frame."""
    points, triangles = read_mesh(Path(visual.file), most)
    points = (points * visual.size) @ axes.T + center
    if np.prod(visual.size) < 0.0:
        # A mirrored mesh keeps its outside.
        triangles = triangles[:, ::-1]
    size = np.ptp(points, axis=0).max() or 1.0
    digits = max(0, MESH_DIGITS - int(np.floor(np.log10(size))))
    return {'kind': 'mesh', 'points': np.round(points, digits).tolist(),
            'triangles': triangles.tolist()}


def _rods(mechanism, rows, heights):
    """Return the massless rods that keep two points apart."""
    return [{'kind': 'rod', 'name': cut.name, 'ends': [
        [rows[body], [*place, heights[body]][:3]]
        for body, place in ((cut.body_a, cut.point_a), (cut.body_b, cut.point_b))]}
        for cut in mechanism.cut_joints if cut.type == DISTANCE]


def _bars(points, radius):
    """Return the bars of a body in space along the edges of its convex hull, and its faces."""
    edges, faces = solid(points)
    points = points.tolist()
    if not edges:
        return [{'kind': 'ball', 'center': points[0], 'radius': 1.6 * radius}]
    shapes = [{'kind': 'bar', 'from': points[start], 'to': points[end], 'radius': radius}
              for start, end in edges]
    if faces:
        shapes.append({'kind': 'faces', 'triangles': [
            [points[corner] for corner in face] for face in faces]})
    return shapes
