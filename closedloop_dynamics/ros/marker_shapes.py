# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Markers of RViz and Foxglove: bodies as their outlines, arrows, lines."""

from closedloop_dynamics.visual.appearance import body_colors, outline, rgb, sliders
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

# Of links, as shares of the mechanism's size.
LINK_WIDTH, SLIDER_SIZE = 0.06, 0.1
SHAFT, HEAD, HEAD_LENGTH = 0.025, 0.06, 0.09


def styled(kind, namespace, number, color, width, strength=1.0):
    """
    Return a marker with a style and nothing in it yet.

    Parameters
    ----------
    kind : int
        Of visualization_msgs/Marker.
    namespace : str
        For switching it off in a viewer.
    number : int
        Unique in the namespace.
    color : str
        ``#RRGGBB``.
    width : float
        Of lines, diameter of spheres [m].
    strength : float
        1: opaque.

    Returns
    -------
    visualization_msgs.msg.Marker

    """
    red, green, blue = rgb(color)
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD,
                    color=ColorRGBA(r=red, g=green, b=blue, a=strength))
    marker.scale.x = marker.scale.y = marker.scale.z = width
    marker.pose.orientation.w = 1.0
    return marker


def point(x, y, z=0.0):
    """Return a geometry_msgs/Point."""
    return Point(x=x, y=y, z=z)


def strip(namespace, number, color, width, points):
    """Return a line through points."""
    marker = styled(Marker.LINE_STRIP, namespace, number, color, width)
    marker.points = points
    return marker


def arrow(namespace, number, color, size, start, along, height):
    """
    Return an arrow.

    Parameters
    ----------
    namespace, number, color
        As for ``styled``.
    size : float
        Of the mechanism [m].
    start, along : sequence of 2 floats
        Its foot, and from there to its head [m].
    height : float
        Above the plane [m].

    Returns
    -------
    visualization_msgs.msg.Marker

    """
    marker = styled(Marker.ARROW, namespace, number, color, 0.0)
    marker.scale.x, marker.scale.y, marker.scale.z = (
        SHAFT * size, HEAD * size, HEAD_LENGTH * size)
    marker.points = [point(*start, height),
                     point(start[0] + along[0], start[1] + along[1], height)]
    return marker


def link_markers(mechanism, size):
    """
    Return the markers of all bodies, in the bodies' own frames.

    Parameters
    ----------
    mechanism : mechanism.mechanism.Mechanism
        Whose bodies they are.
    size : float
        Of the mechanism [m].

    Returns
    -------
    list of (visualization_msgs.msg.Marker, int)
        Each with the index of its body.

    """
    colors, blocks = body_colors(mechanism), sliders(mechanism)
    markers = []

    def add(kind, body, width, strength=1.0):
        name = mechanism.bodies[body].name
        markers.append((styled(kind, 'links', len(markers), colors[name], width, strength), body))
        return markers[-1][0]

    for index, body in enumerate(mechanism.bodies):
        corners = [point(*corner) for corner in outline(mechanism, body.name).tolist()]
        if len(corners) > 1:
            closed = corners[:1] if len(corners) > 2 else []
            add(Marker.LINE_STRIP, index, LINK_WIDTH * size).points = corners + closed
        if len(corners) > 2:
            fan = [corner for second, third in zip(corners[1:], corners[2:])
                   for corner in (corners[0], second, third)]
            add(Marker.TRIANGLE_LIST, index, 1.0, 0.4).points = fan
        if body.name in blocks or len(corners) == 1:
            block = add(Marker.CUBE, index, SLIDER_SIZE * size)
            block.scale.x *= 1.6
            block.scale.z *= 0.4
    return markers
