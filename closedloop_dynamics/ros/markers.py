# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The topic ``visualization_marker_array``: links, cut joints, forces, path, contacts, accuracy.

In the plane all but the links lies above them; in space where it is, and joints have their axes.
"""

from collections import deque
import math
import time

from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.kinematics.modeling import extent
from closedloop_dynamics.mechanism.kinematics import pose_of, poses_in_space, world_points
from closedloop_dynamics.mechanism.rotations import direction, turned
from closedloop_dynamics.ros.parameters import declare, Parameter
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.visual.appearance import (
    body_colors, CONTACT_COLOR, CUT_COLOR, FORCE_COLOR, joint_axes, marked_points, outline,
    PATH_COLOR, rgb, sliders, solid)
from closedloop_dynamics.visual.trajectory import force_of
from geometry_msgs.msg import Point
import numpy as np
from rclpy.qos import QoSProfile
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

# Points of the path kept, and the distance between two of them as a share of the size.
PATH_POINTS, PATH_STEP = 400, 0.01
# Length of the longest arrow, as a share of the size; the scale forgets a peak with this
# half-life [s].
ARROW_SIZE, HALF_LIFE = 0.5, 2.0
# Above the links [share of the size].
ABOVE = 0.2
# Widths and lengths of links and arrows, as shares of the size.
LINK_WIDTH, SLIDER_SIZE = 0.06, 0.1
BLOCK = (1.6, 1.0, 0.4)
# Arrows: diameter of the shaft, and of the head, and its length.
ARROW = (0.025, 0.06, 0.09)
# In space: width of links, and width and half the length of the lines along axes of joints.
BAR_WIDTH, AXIS_WIDTH, AXIS_LENGTH = 0.04, 0.008, 0.12
AXIS_COLOR = '#333333'
# Height of the letters of the text, and how far it is below the machine, as shares of the size.
TEXT_SIZE, TEXT_BELOW = 0.08, 0.6
MARKER_PARAMETERS = (
    Parameter(
        'marker_rate', 30.0,
        'Markers published per second while somebody subscribes to them [Hz]; 0: never.',
        (0.0, 200.0)),
    Parameter(
        'marker_point', '',
        'Named point whose path the markers show. Not given: the first of the mechanism.'),
    Parameter(
        'marker_force_scale', 0.0,
        'Length of the force arrows [m/N]; 0: the longest is half as long as the longest link.',
        (0.0, 1e6)),
    Parameter('marker_frame', 'world', 'Frame of the markers.'),
)


class Markers:
    """
    Publishes pictures of the state at a rate of their own, while there are subscribers.

    ``node`` publishes and is given ``MARKER_PARAMETERS``; ``summary()`` returns what is to be read
    below the machine. Raises StartError if there is no point of the name given.
    """

    def __init__(self, node, simulation, summary):
        values = declare(node, MARKER_PARAMETERS)
        self._rate, self._publisher = values['marker_rate'], None
        self._frame = values['marker_frame']
        self._scale = values['marker_force_scale']
        self._simulation, self._mechanism = simulation, simulation.mechanism
        self._count = 0
        self.next_due = -math.inf
        self._path = deque(maxlen=PATH_POINTS)
        self._peak = 0.0
        self._size = size = extent(self._mechanism)
        self._height = ABOVE * size if self._mechanism.planar else 0.0
        names = [named.name for named in self._mechanism.points]
        self._point = values['marker_point'] or next(iter(names), None)
        if self._point is not None and self._point not in names:
            raise StartError(f"parameter 'marker_point': expected one of the points of "
                             f"{self._mechanism.name} ({', '.join(names)}), got '{self._point}'")
        self.links = link_markers(self._mechanism, size)
        self._cuts = styled(Marker.SPHERE_LIST, 'cut_joints', 0, CUT_COLOR, 0.09 * size)
        self._trail = styled(Marker.LINE_STRIP, 'path', 0, PATH_COLOR, 0.02 * size)
        self._summary = summary
        self._text = styled(Marker.TEXT_VIEW_FACING, 'accuracy', 0, AXIS_COLOR, TEXT_SIZE * size)
        self._put_text_below()
        self._publisher = self._rate > 0.0 and node.create_publisher(
            MarkerArray, 'visualization_marker_array', QoSProfile(depth=5))

    def _put_text_below(self):
        """Put the text below where the machine begins."""
        places = poses_in_space(self._simulation.body_poses)[:, :3]
        middle, least = places.mean(axis=0), places.min(axis=0)
        down = 1 if self._mechanism.planar else 2
        middle[down] = least[down] - TEXT_BELOW * self._size
        set_pose(self._text.pose, [*middle.tolist(), 0.0, 0.0, 0.0, 1.0])

    def on_state(self, stamp):
        """Publish the markers of the present state if it is time to, and if anybody wants them."""
        if not self._publisher or (now := time.monotonic()) < self.next_due:
            return
        self.next_due = max(self.next_due + 1.0 / self._rate, now)
        if self._publisher.get_subscription_count():
            self._publisher.publish(self.array(stamp))
        else:
            self._path.clear()

    def array(self, stamp):
        """Return the markers of the present state, a MarkerArray."""
        poses = self._simulation.body_poses
        numbers = poses_in_space(poses).tolist()
        for marker, body in self.links:
            set_pose(marker.pose, numbers[body])
        places = [self.cut_place(cut, poses) for cut in self._mechanism.cut_joints]
        self._cuts.points = [self._raised(place) for place in places]
        markers = [marker for marker, _ in self.links] + [self._cuts] * bool(places)
        markers += self._forces(places)
        if self._point is not None:
            markers += self._trace()
        self._text.text = self._summary()
        markers += [self._text] * bool(self._text.text)
        for marker in markers:
            marker.header.frame_id, marker.header.stamp = self._frame, stamp
        if len(markers) < self._count:
            # What is no longer there would stay in the viewer.
            markers.insert(0, Marker(action=Marker.DELETEALL))
        self._count = len(markers)
        return MarkerArray(markers=markers)

    def cut_place(self, cut, poses):
        return world_points(pose_of(self._mechanism, poses, cut.body_a), cut.point_a).tolist()

    def _trace(self):
        """Return the path of the point so far; nothing until it has moved."""
        place = self._simulation.point(self._point).tolist()
        if not self._path or math.dist(place, self._path[-1]) > PATH_STEP * self._size:
            self._path.append(place)
        if len(self._path) < 2:
            return []
        self._trail.points = [self._raised(each) for each in self._path]
        return [self._trail]

    def _forces(self, places):
        """Return arrows for the forces at cut joints and of effects, and lines of contacts."""
        simulation = self._simulation
        wanted = [('constraint_forces', k, FORCE_COLOR, place, force) for k, (place, force) in (
            enumerate(zip(places, force_of(simulation.constraint_forces).tolist())))]
        lines = []
        for k, name in enumerate(simulation.data.enabled_effects):
            record = simulation.effects[name]
            if isinstance(record, Contact):
                lines.append(self._contact_line(k, record))
                force = contact_force(record, simulation.effect_readings(name))
            elif isinstance(record, ExternalForce):
                force = record.force
            else:
                continue
            wanted.append(('effects', k, CONTACT_COLOR, simulation.point(record.point).tolist(),
                           force))
        scale = self._arrow_scale([math.hypot(*force) for *_, force in wanted])
        return lines + [
            arrow(space, k, color, self._size, self._raised(place), self._raised(
                [part + scale * along for part, along in zip(place, force)]))
            for space, k, color, place, force in wanted]

    def _raised(self, place):
        """Return a point where it is seen: in the plane above the links."""
        return point(*place, self._height) if len(place) == 2 else point(*place)

    def _arrow_scale(self, magnitudes):
        """Return the length of arrows per newton."""
        if self._scale:
            return self._scale
        fading = 0.5 ** (1.0 / (HALF_LIFE * self._rate)) if self._rate else 1.0
        self._peak = max([self._peak * fading, *magnitudes])
        return ARROW_SIZE * self._size / self._peak if self._peak > 0.0 else 0.0

    def _contact_line(self, number, contact):
        """Return the line of a contact, as long as its point's surroundings."""
        along = direction(contact.angle)
        place = np.array(contact.origin)
        middle = place + along * np.dot(
            self._simulation.point(contact.point) - place, along)
        ends = [middle - 2.0 * self._size * along, middle + 2.0 * self._size * along]
        return strip('contacts', number, CONTACT_COLOR, 0.03 * self._size,
                     [point(*end, 0.0) for end in np.array(ends).tolist()])


def contact_force(contact, readings):
    """Return the force of a contact on its point, world axes [N]."""
    along = readings['friction_force'] + readings['scraping_force']
    normal = readings['normal_force']
    return turned(contact.angle, np.array([along, normal])).tolist()


def styled(kind, namespace, number, color, scale, strength=1.0):
    """
    Return a marker with a style and nothing in it yet.

    ``kind`` is that of visualization_msgs/Marker; a viewer switches ``namespace`` off; ``scale``,
    one number or three, is the width of lines, or the size [m]; ``strength`` 1 is opaque.
    """
    red, green, blue = rgb(color)
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD,
                    color=ColorRGBA(r=red, g=green, b=blue, a=strength))
    marker.scale.x, marker.scale.y, marker.scale.z = np.broadcast_to(scale, 3).tolist()
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


def arrow(namespace, number, color, size, start, end):
    """Return an arrow between two points."""
    marker = styled(Marker.ARROW, namespace, number, color, size * np.array(ARROW))
    marker.points = [start, end]
    return marker


def set_pose(pose, numbers):
    """Put x, y, z and a quaternion x, y, z, w into a geometry_msgs/Pose."""
    place, turn = pose.position, pose.orientation
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = numbers


def link_markers(mechanism, size):
    """
    Return the markers of all bodies, and in space of the axes that they turn about.

    Each comes with its body's index, in the body's own frame.
    """
    colors, markers = body_colors(mechanism), []
    shapes = _flat_shapes if mechanism.planar else _solid_shapes
    for index, body in enumerate(mechanism.bodies):
        for kind, scale, strength, points in shapes(mechanism, body, size):
            marker = styled(kind, 'links', len(markers), colors[body.name], scale, strength)
            marker.points = [point(*place) for place in points]
            markers.append((marker, index))
    if mechanism.planar:
        return markers
    names = [body.name for body in mechanism.bodies]
    return markers + [
        (strip('joint_axes', number, AXIS_COLOR, AXIS_WIDTH * size, [
            point(*(place + sign * AXIS_LENGTH * size * axis).tolist()) for sign in (-1.0, 1.0)]),
         names.index(body)) for number, (body, place, axis) in enumerate(joint_axes(mechanism))]


def _flat_shapes(mechanism, body, size):
    """Yield kind, scale, strength and points of the drawing of a body in the plane."""
    corners = outline(mechanism, body.name).tolist()
    if len(corners) > 1:
        closed = corners[:1] if len(corners) > 2 else []
        yield Marker.LINE_STRIP, LINK_WIDTH * size, 1.0, corners + closed
    if len(corners) > 2:
        yield Marker.TRIANGLE_LIST, 1.0, 0.4, [
            corner for second, third in zip(corners[1:], corners[2:])
            for corner in (corners[0], second, third)]
    if body.name in sliders(mechanism) or len(corners) == 1:
        yield Marker.CUBE, SLIDER_SIZE * size * np.array(BLOCK), 1.0, ()


def _solid_shapes(mechanism, body, size):
    """Do the same for a body in space."""
    points = marked_points(mechanism, body.name)
    edges, faces = solid(points)
    if edges:
        yield Marker.LINE_LIST, BAR_WIDTH * size, 1.0, points[np.ravel(edges)].tolist()
    elif not body.massless:
        yield Marker.CUBE, SLIDER_SIZE * size, 1.0, ()
    if faces:
        yield Marker.TRIANGLE_LIST, 1.0, 0.4, points[np.ravel(faces)].tolist()
