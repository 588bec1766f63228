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

"""Draw any planar mechanism from its description; ``appearance`` says what it looks like."""

from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
import matplotlib.patheffects
import numpy as np

from .motion import named_point, pose_of, world_points
from .shapes import draw_ground, INK, mixed, SLIDER_SIZE
from ..appearance import (
    body_colors, CUT_COLOR, FORCE_COLOR, outline, PATH_COLOR, sliders)
from ..mechanism.mechanism import PRISMATIC

# Length of the longest force arrow, as a share of the picture's extent.
ARROW_SIZE = 0.22
LINK_WIDTH = 5.0


class MechanismArtist:
    """
    Draws one mechanism into one pair of axes.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    mechanism : mechanism.mechanism.Mechanism
        What to draw.
    poses : ndarray, shape (n, nb, 3)
        All poses that will be drawn; they fix the extent of the picture.

    Attributes
    ----------
    extent : float
        Largest width or height of all that moves [m].

    """

    def __init__(self, axes, mechanism, poses):
        """Find outlines and extent; draw nothing yet."""
        self.axes = axes
        self.mechanism = mechanism
        self.poses = poses
        self.outlines = {body.name: outline(mechanism, body.name) for body in mechanism.bodies}
        self.color = body_colors(mechanism)
        self.sliders = sliders(mechanism)
        places = np.concatenate([
            world_points(pose_of(mechanism, poses, name), points).reshape(-1, 2)
            for name, points in self.outlines.items()])
        self.extent = float(np.ptp(places, axis=0).max()) or 1.0
        axes.set_aspect('equal')
        axes.set_xlabel('x [m]')
        axes.set_ylabel('y [m]')
        axes.set_axisbelow(True)
        axes.grid(color='0.93')
        # Room around what moves, for pivots and arrows.
        axes.update_datalim([places.min(axis=0) - 0.06 * self.extent,
                             places.max(axis=0) + 0.06 * self.extent])
        axes.autoscale_view()

    def ground(self):
        """Draw what stands still."""
        draw_ground(self.axes, self.mechanism, self.poses, self.extent)

    def bodies(self, index, strength=1.0):
        """
        Draw all bodies with their joints in one pose.

        Parameters
        ----------
        index : int
            Of the pose.
        strength : float
            1: full colours; less: paler, for positions in the background.

        """
        layer = 10.0 + 15.0 * strength
        for body in self.mechanism.bodies:
            self._body(body.name, self.poses[index], strength, layer)
        for joint in self.mechanism.joints:
            if joint.type != PRISMATIC:
                place = pose_of(self.mechanism, self.poses[index], joint.child)[:2]
                face = INK if joint.actuated else 'white'
                self._dot(place, face, INK, 6.5 if joint.actuated else 5.0, strength, layer)
        for cut in self.mechanism.cut_joints:
            place = self._cut_place(cut, self.poses[index])
            self._dot(place, 'white', CUT_COLOR, 7.5, strength, layer, edge_width=2.2)

    def path(self, name):
        """Draw the path of a named point over all poses."""
        places = named_point(self.mechanism, self.poses, name)
        self.axes.plot(*places.T, color=PATH_COLOR, linewidth=1.6, zorder=31)
        return places

    def mark(self, place):
        """Mark where a traced point is."""
        self.axes.plot(*place, marker='D', markersize=5, color=PATH_COLOR, zorder=32,
                       markeredgecolor='white', markeredgewidth=0.8)

    def forces(self, index, forces, largest):
        """
        Draw the constraint forces on body A of every cut joint.

        Parameters
        ----------
        index : int
            Of the pose.
        forces : ndarray, shape (number of cut joints, 3)
            Moment [N m] and force [N].
        largest : float
            The force [N] that gets the longest arrow.

        """
        scale = ARROW_SIZE * self.extent / largest if largest > 0.0 else 0.0
        for cut, (_, *force) in zip(self.mechanism.cut_joints, forces):
            start = self._cut_place(cut, self.poses[index])
            end = start + scale * np.array(force)
            self.axes.annotate('', end, start, zorder=33, arrowprops={
                'arrowstyle': '-|>', 'color': FORCE_COLOR, 'linewidth': 1.8,
                'shrinkA': 4, 'shrinkB': 0, 'mutation_scale': 12})
            self.axes.update_datalim([end])
        self.axes.autoscale_view()

    def cut_names(self, index, forces):
        """Write the names of the cut joints beside them, where the force arrows do not go."""
        written = {}
        for cut, (_, *force) in zip(self.mechanism.cut_joints, forces):
            place = self._cut_place(cut, self.poses[index])
            key = tuple(np.round(place / self.extent, 3))
            names, arrows = written.setdefault(key, ([], []))
            names.append(cut.name)
            arrows.append(np.array(force) / (np.hypot(*force) or 1.0))
        for place, (names, arrows) in written.items():
            right, up = -np.sum(arrows, axis=0)
            self.axes.annotate(
                ', '.join(names), np.array(place) * self.extent, zorder=34,
                xytext=(11 if right >= 0.0 else -11, 9 if up >= 0.0 else -9),
                textcoords='offset points', ha='left' if right >= 0.0 else 'right', va='center',
                color=CUT_COLOR, fontsize=9, fontweight='bold', path_effects=_halo())

    def legend_handles(self, path=None, largest=None):
        """Return what a legend needs to explain the drawing."""
        colors = dict.fromkeys(self.color.values())
        handles = [
            Line2D([], [], color=mixed(color, 0.75), linewidth=LINK_WIDTH,
                   label=f'subsystem {number}')
            for number, color in enumerate(colors, 1)]
        actuated = any(joint.actuated for joint in self.mechanism.joints)
        marker = {'linestyle': 'none', 'marker': 'o'}
        handles += [Line2D([], [], markersize=6.5, color=INK, label='driven joint',
                           **marker)] * actuated
        handles += [Line2D([], [], markersize=7.5, markerfacecolor='white', label='cut joint',
                           markeredgecolor=CUT_COLOR, markeredgewidth=2.2,
                           **marker)] * bool(self.mechanism.cut_joints)
        if path is not None:
            handles.append(Line2D([], [], color=PATH_COLOR, linewidth=1.6, marker='D',
                                  markersize=5, label=f'path of {path}'))
        if largest:
            handles.append(Line2D([], [], color=FORCE_COLOR, linewidth=1.8, marker='>',
                                  markersize=6, label=f'force on body A, longest {largest:.3g} N'))
        return handles

    def _body(self, name, poses, strength, layer):
        pose = pose_of(self.mechanism, poses, name)
        color = self.color[name]
        points = world_points(pose, self.outlines[name])
        if len(points) > 2:
            self.axes.add_patch(Polygon(
                points, facecolor=mixed(color, 0.35 * strength), linewidth=2.2,
                edgecolor=mixed(color, 0.75 * strength), joinstyle='round', zorder=layer))
        elif len(points) == 2:
            self.axes.plot(*points.T, color=mixed(color, 0.75 * strength), linewidth=LINK_WIDTH,
                           solid_capstyle='round', zorder=layer)
        if name in self.sliders or len(points) == 1:
            block = np.array([[-1.0, -0.62], [1.0, -0.62], [1.0, 0.62], [-1.0, 0.62]])
            self.axes.add_patch(Polygon(
                world_points(pose, SLIDER_SIZE * self.extent * block), linewidth=1.5,
                facecolor=mixed(color, 0.35 * strength), joinstyle='round', zorder=layer,
                edgecolor=mixed(color, 0.75 * strength)))

    def _dot(self, place, face, edge, size, strength, layer, edge_width=1.3):
        self.axes.plot(*place, marker='o', markersize=size, zorder=layer + 0.5, linestyle='none',
                       markerfacecolor=mixed(face, strength),
                       markeredgecolor=mixed(edge, strength), markeredgewidth=edge_width)

    def _cut_place(self, cut, poses):
        return world_points(pose_of(self.mechanism, poses, cut.body_a), cut.point_a)


def _halo():
    return [matplotlib.patheffects.withStroke(linewidth=2.5, foreground='white')]
