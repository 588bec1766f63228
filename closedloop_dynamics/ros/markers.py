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

"""The topic ``visualization_marker_array``: links, cut joints, forces, tool path, contacts."""

from collections import deque
import math
import time

from closedloop_dynamics.effects.contact import Contact
from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.ros.marker_shapes import arrow, link_markers, point, strip, styled
from closedloop_dynamics.ros.parameters import Parameter
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.simulation.modeling import extent
from closedloop_dynamics.visual.appearance import CONTACT_COLOR, CUT_COLOR, FORCE_COLOR, PATH_COLOR
from closedloop_dynamics.visual.motion import pose_of, world_points
import numpy as np
from rclpy.qos import QoSProfile
from visualization_msgs.msg import Marker
from visualization_msgs.msg import MarkerArray

# Points of the path kept, and the distance between two of them as a share of the size.
PATH_POINTS, PATH_STEP = 400, 0.01
# Length of the longest arrow, as a share of the size; the scale forgets a peak with this
# half-life [s].
ARROW_SIZE, HALF_LIFE = 0.5, 2.0
# Above the links [share of the size].
ABOVE = 0.2
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
    Publishes pictures of the state at a rate of their own, as long as somebody subscribes.

    Parameters
    ----------
    node : rclpy.node.Node
        Publishes.
    values : dict
        Of ``MARKER_PARAMETERS``.

    Raises
    ------
    StartError
        If there is no point of the name given.

    """

    def __init__(self, node, values):
        self._rate = values['marker_rate']
        self._frame = values['marker_frame']
        self._scale = values['marker_force_scale']
        self._name = values['marker_point']
        self._mechanism = None
        self._count = 0
        self._next = -math.inf
        self._prepare(node.simulation.mechanism)
        self._publisher = self._rate > 0.0 and node.create_publisher(
            MarkerArray, 'visualization_marker_array', QoSProfile(depth=5))

    def follow(self, stamp, simulation):
        """
        Publish the markers of a state if it is time to, and if anybody wants them.

        Parameters
        ----------
        stamp : builtin_interfaces.msg.Time
            Of the state.
        simulation : Simulation
            Which is in that state.

        """
        if not self._publisher or (now := time.monotonic()) < self._next:
            return
        self._next = max(self._next + 1.0 / self._rate, now)
        if self._publisher.get_subscription_count():
            self._publisher.publish(self.array(stamp, simulation))
        else:
            self._path.clear()

    def array(self, stamp, simulation):
        """Return the markers of a simulation's present state, a MarkerArray."""
        if simulation.mechanism is not self._mechanism:
            self._prepare(simulation.mechanism)
        poses = simulation.body_poses
        for marker, body in self._links:
            x, y, angle = poses[body].tolist()
            marker.pose.position.x, marker.pose.position.y = x, y
            marker.pose.orientation.z = math.sin(angle / 2.0)
            marker.pose.orientation.w = math.cos(angle / 2.0)
        places = [self._cut_place(cut, poses) for cut in self._mechanism.cut_joints]
        self._cuts.points = [point(*place, self._height) for place in places]
        markers = [marker for marker, _ in self._links] + [self._cuts] * bool(places)
        markers += self._forces(simulation, poses, places)
        if self._point is not None:
            markers += self._trace(simulation)
        for marker in markers:
            marker.header.frame_id, marker.header.stamp = self._frame, stamp
        if len(markers) < self._count:
            # What is no longer there would stay in the viewer.
            markers.insert(0, Marker(action=Marker.DELETEALL))
        self._count = len(markers)
        return MarkerArray(markers=markers)

    def _prepare(self, mechanism):
        self._mechanism = mechanism
        self._size = size = extent(mechanism)
        self._height = ABOVE * size
        names = [named.name for named in mechanism.points]
        if self._name and self._name not in names:
            raise StartError(f"parameter 'marker_point': expected one of the points of "
                             f"{mechanism.name} ({', '.join(names)}), got '{self._name}'")
        self._point = self._name or next(iter(names), None)
        self._path = deque(maxlen=PATH_POINTS)
        self._peak = 0.0
        self._links = link_markers(mechanism, size)
        self._cuts = styled(Marker.SPHERE_LIST, 'cut_joints', 0, CUT_COLOR, 0.09 * size)
        self._trail = styled(Marker.LINE_STRIP, 'path', 0, PATH_COLOR, 0.02 * size)

    def _cut_place(self, cut, poses):
        return world_points(pose_of(self._mechanism, poses, cut.body_a), cut.point_a).tolist()

    def _trace(self, simulation):
        """Return the path of the point so far; nothing until it has moved."""
        place = simulation.point(self._point).tolist()
        if not self._path or math.dist(place, self._path[-1]) > PATH_STEP * self._size:
            self._path.append(place)
        if len(self._path) < 2:
            return []
        self._trail.points = [point(*each, self._height) for each in self._path]
        return [self._trail]

    def _forces(self, simulation, poses, places):
        """Return arrows for the forces at cut joints and of effects, and lines of contacts."""
        wanted = [('constraint_forces', k, FORCE_COLOR, place, force) for k, (place, force) in (
            enumerate(zip(places, simulation.constraint_forces[:, 1:].tolist())))]
        lines = []
        for k, name in enumerate(simulation.enabled_effects):
            record = simulation.effects[name]
            if isinstance(record, Contact):
                lines.append(self._contact_line(k, record, simulation))
                force = contact_force(record, simulation.effect_readings(name))
            elif isinstance(record, ExternalForce):
                force = record.force
            else:
                continue
            wanted.append(('effects', k, CONTACT_COLOR, simulation.point(record.point).tolist(),
                           force))
        scale = self._arrow_scale([math.hypot(*force) for *_, force in wanted])
        return lines + [
            arrow(space, k, color, self._size, place, [scale * part for part in force],
                  self._height)
            for space, k, color, place, force in wanted]

    def _arrow_scale(self, magnitudes):
        """Return the length of arrows per newton."""
        if self._scale:
            return self._scale
        fading = 0.5 ** (1.0 / (HALF_LIFE * self._rate)) if self._rate else 1.0
        self._peak = max([self._peak * fading, *magnitudes])
        return ARROW_SIZE * self._size / self._peak if self._peak > 0.0 else 0.0

    def _contact_line(self, number, contact, simulation):
        """Return the line of a contact, as long as its point's surroundings."""
        along = np.array([math.cos(contact.angle), math.sin(contact.angle)])
        place = np.array(contact.origin)
        middle = place + along * np.dot(simulation.point(contact.point) - place, along)
        ends = [middle - 2.0 * self._size * along, middle + 2.0 * self._size * along]
        return strip('contacts', number, CONTACT_COLOR, 0.03 * self._size,
                     [point(*end, 0.0) for end in np.array(ends).tolist()])


def contact_force(contact, readings):
    """Return the force of a contact on its point, world axes [N]."""
    along = readings['friction_force'] + readings['scraping_force']
    normal = readings['normal_force']
    cosine, sine = math.cos(contact.angle), math.sin(contact.angle)
    return [along * cosine - normal * sine, along * sine + normal * cosine]
