# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Line drawings for CAD, to scale in millimetres: a mechanism in one position, and its curves.

Layers: one of each body, ``joints`` (circles; points in space) and
``path.NAME`` of each named point. What is in space keeps its three coordinates in a DXF file; an
SVG file shows it from the front.
"""

from importlib import import_module
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from .appearance import body_colors, marked_points, outline, PATH_COLOR, rgb
from .views import FRONT, PLANE
from ..mechanism.extras import remedy
from ..mechanism.kinematics import body_poses, named_point, pose_of, world_points

MILLIMETRES = 1e3
# Radius of a joint's circle, and width of a line, as shares of the extent.
RADIUS, WIDTH = 0.012, 0.003
# How near the end of a path is to its beginning where it is closed, of its extent.
CLOSED = 1e-6
INK = '#333333'
KINDS = ('.dxf', '.svg')


class DrawingError(ValueError):
    """A drawing that cannot be written."""


class Line(NamedTuple):
    """A polyline."""

    layer: str
    color: str  # ``#RRGGBB``
    points: np.ndarray  # Shape (n, 2), in space (n, 3): [mm]
    closed: bool  # Whether the last one is joined to the first one


class LineDrawing(NamedTuple):
    """A drawing."""

    title: str
    lines: list  # List of Line
    joints: np.ndarray  # Shape (m, 2), in space (m, 3): Places of the joints [mm]
    extent: float  # Largest width or height [mm]


def line_drawing(motion, title):
    """Return the drawing of a mechanism at the start of a motion, with the paths of all points."""
    mechanism = motion.mechanism
    poses = body_poses(mechanism, motion.position)
    colors, lines = body_colors(mechanism), []

    def placed(body, points):
        return MILLIMETRES * world_points(pose_of(mechanism, poses[0], body), points)

    for body in mechanism.bodies:
        for points in _strokes(mechanism, body.name):
            lines.append(Line(body.name, colors[body.name], placed(body.name, points),
                              len(points) > 2))
    for point in mechanism.points:
        path = MILLIMETRES * named_point(mechanism, poses, point.name)
        size = np.ptp(path, axis=0).max()
        if size > 0.0:
            closed = len(path) > 3 and bool(np.abs(path[-1] - path[0]).max() < CLOSED * size)
            lines.append(Line(f'path.{point.name}', PATH_COLOR,
                              path[:-1] if closed else path, closed))
    joints = [placed(joint.parent, [joint.position]) for joint in mechanism.joints]
    joints += [placed(cut.body_a, [cut.point_a]) for cut in mechanism.cut_joints]
    # Pins that several joints share are drawn once.
    joints = np.unique(np.round(np.concatenate(joints), 9), axis=0)
    everything = np.concatenate([joints, *(line.points for line in lines)])
    return LineDrawing(title, lines, joints, float(np.ptp(everything, axis=0).max()) or 1.0)


def _strokes(mechanism, body):
    """Return a body's strokes in its frame: its outline, in space rods from its joint."""
    if mechanism.planar:
        points = outline(mechanism, body)
        return [points] if len(points) > 1 else []
    ends = marked_points(mechanism, body)
    return [np.array([np.zeros(3), end]) for end in ends if end.any()]


def require_kind(path):
    """Refuse, with DrawingError, a file of unknown kind, or that a library is missing for."""
    if path.suffix.lower() not in KINDS:
        raise DrawingError(f'expected a name that ends with {" or ".join(KINDS)}, got {path}')
    if path.suffix.lower() == '.dxf':
        _ezdxf(path)


def write(drawing, path):
    """
    Write a drawing as DXF or SVG, as the name of the file ends.

    DrawingError for other names, and where ``ezdxf`` is missing; OSError.
    """
    require_kind(path)
    if path.suffix.lower() == '.dxf':
        _write_dxf(drawing, path)
    else:
        _write_svg(drawing, path)


def _ezdxf(path):
    try:
        return import_module('ezdxf')
    except ImportError as error:
        raise DrawingError(f'{path}: DXF files need {remedy("ezdxf", error)}; SVG files need '
                           'nothing') from None


def _write_dxf(drawing, path):
    library = _ezdxf(path)
    document = library.new('R2010', units=library.units.MM)
    space, flat = document.modelspace(), drawing.joints.shape[1] == 2
    for line in drawing.lines:
        if line.layer not in document.layers:
            document.layers.add(line.layer).rgb = tuple(
                round(255.0 * share) for share in rgb(line.color))
        add = space.add_lwpolyline if flat else space.add_polyline3d
        add(line.points.tolist(), close=line.closed, dxfattribs={'layer': line.layer})
    document.layers.add('joints')
    for place in drawing.joints.tolist():
        if flat:
            space.add_circle(place, RADIUS * drawing.extent, dxfattribs={'layer': 'joints'})
        else:
            space.add_point(place, dxfattribs={'layer': 'joints'})
    document.saveas(path)


def _write_svg(drawing, path):
    flat = drawing.joints.shape[1] == 2
    view = PLANE if flat else FRONT
    # Down, as SVG counts.
    lines = [view.project(line.points) * (1.0, -1.0) + 0.0 for line in drawing.lines]
    joints = view.project(drawing.joints) * (1.0, -1.0) + 0.0
    everything, room = np.concatenate([joints, *lines]), 0.05 * drawing.extent
    low = everything.min(axis=0) - room
    width, height = np.ptp(everything, axis=0) + 2.0 * room
    svg = ElementTree.Element('svg', {
        'xmlns': 'http://www.w3.org/2000/svg', 'width': f'{width:.6g}mm',
        'height': f'{height:.6g}mm',
        'viewBox': f'{low[0]:.9g} {low[1]:.9g} {width:.9g} {height:.9g}'})
    ElementTree.SubElement(svg, 'title').text = drawing.title
    stroke = {'fill': 'none', 'stroke-width': f'{WIDTH * drawing.extent:.6g}'}
    layers = {}
    for line, points in zip(drawing.lines, lines):
        if line.layer not in layers:
            layers[line.layer] = ElementTree.SubElement(
                svg, 'g', {'id': line.layer, 'stroke': line.color, **stroke})
        ElementTree.SubElement(layers[line.layer], 'polygon' if line.closed else 'polyline', {
            'points': ' '.join(f'{x:.9g},{y:.9g}' for x, y in points)})
    group = ElementTree.SubElement(svg, 'g', {'id': 'joints', 'stroke': INK, **stroke})
    for x, y in joints:
        ElementTree.SubElement(group, 'circle', {
            'cx': f'{x:.9g}', 'cy': f'{y:.9g}', 'r': f'{RADIUS * drawing.extent:.6g}'})
    ElementTree.indent(svg)
    ElementTree.ElementTree(svg).write(path, encoding='utf-8', xml_declaration=True)
