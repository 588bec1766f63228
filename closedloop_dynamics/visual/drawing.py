# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Draw any mechanism from its description; shapes are in ``appearance``.

A mechanism in space is drawn as it is seen in a view: lines and outlines of projected points.
"""

from dataclasses import dataclass
from typing import Optional

import numpy as np

from .appearance import (
    body_colors, convex_hull, CUT_COLOR, FORCE_COLOR, joint_axes, marked_points, outline,
    PATH_COLOR, sliders)
from .trajectory import force_of
from .transmissions import outlines, transmissions
from .views import PLANE
from .wheels import on_wheel
from ..mechanism.extras import of_an_extra
from ..mechanism.kinematics import named_point, pose_of, world_points
from ..mechanism.mechanism import DISTANCE, GROUND, POINT_ON_LINE, PRISMATIC
from ..mechanism.rotations import direction

with of_an_extra():
    from matplotlib.colors import to_rgb
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon
    import matplotlib.patheffects

# Length of the longest force arrow, as a share of the picture's extent.
ARROW_SIZE = 0.22
# In space the bodies are many, and a slider is thinner than its guide.
# Bodies of one colour that a legend names.
NAMED = 2
LINK_WIDTH, SPATIAL_WIDTH, ROD_WIDTH = 5.0, 4.0, 2.2
# In space: length of the lines along axes of joints, as a share of the picture's extent, and how
# much nearer bodies are drawn above those behind them.
AXIS_LENGTH, DEPTH_LAYERS = 0.09, 0.4
AXIS_DASHES = (0, (8, 2, 1, 2))
# Least half width and height of a view, as a share of the extent.
LEAST_VIEW = 0.2
# The floor in a perspective: lines across the extent, about, and the gap below moving parts.
FLOOR_LINES, FLOOR_ROOM = 6, 0.03
INK = '#333333'
# Style of force arrows: keywords of matplotlib.patches.FancyArrowPatch.
ARROW = {'arrowstyle': '-|>', 'color': FORCE_COLOR, 'linewidth': 1.8, 'shrinkA': 4.0,
         'shrinkB': 0.0, 'mutation_scale': 12.0, 'zorder': 33}
# Sizes of a pivot's triangle, and of the block of a slider, as shares of the picture's extent.
PIVOT_SIZE, SLIDER_SIZE = 0.035, 0.04
# Above the positions in the background, below the strong one.
GROUND_LAYER = 24.0
# In space the ground is not a body: behind all of them.
GROUND_BEHIND = 5.0
PALEST = 0.18
# Cut joints that are nearer than this share of the extent have their names side by side.
APART = 1e-3


@dataclass(frozen=True)
class Part:
    """A line, a polygon or dots that move with bodies."""

    artist: object  # Matplotlib.lines.Line2D or matplotlib.patches.Polygon
    points: tuple  # Names of bodies, and places in their frames, shape (m, 2) or (m, 3) [m]
    solid: bool = False  # Whether a polygon is the outline of all points, which turns with them
    layer: Optional[float] = None  # Where nearer parts cover farther ones

    def place(self, places):
        """Move it to places in the picture, shape (m, 2) [m]."""
        if self.solid:
            self.artist.set_xy(convex_hull(places))
        elif isinstance(self.artist, Polygon):
            self.artist.set_xy(places)
        else:
            self.artist.set_data(*places.T)


class MechanismArtist:
    """
    Draws one mechanism into one pair of axes, seen in a view.

    ``poses``, shape (n, nb, 3), in space (n, nb, 7): all that will be drawn; they fix the
    ``extent`` of the picture, the largest width or height of all that moves [m].
    """

    def __init__(self, axes, mechanism, poses, view=PLANE):
        self.axes = axes
        self.mechanism = mechanism
        self.poses = poses
        self.view = view
        of_body = outline if mechanism.planar else marked_points
        self.outlines = {body.name: of_body(mechanism, body.name) for body in mechanism.bodies}
        self.wheels, (wheels, racks, _) = outlines(mechanism), transmissions(mechanism)
        for name, points in self.outlines.items():
            if on_wheel(wheels, name, points):
                # It is its wheel.
                self.outlines[name] = points[:0]
        self.color = body_colors(mechanism)
        self.sliders = sliders(mechanism) - {rack.body for rack in racks}
        self.massless = {body.name: body.massless for body in mechanism.bodies}
        everything = all_places(mechanism, poses)
        self.extent = float(np.ptp(everything, axis=0).max()) or 1.0
        places = view.project(everything)
        axes.set_aspect('equal')
        if view.labels:
            axes.set_xlabel(view.labels[0])
            axes.set_ylabel(view.labels[1])
            axes.set_axisbelow(True)
            axes.grid(color='0.93')
        else:
            axes.axis('off')
        # Margin around moving parts, for pivots and arrows.
        axes.update_datalim([places.min(axis=0) - 0.06 * self.extent,
                             places.max(axis=0) + 0.06 * self.extent])
        if not mechanism.planar:
            # What is flat is not seen through a slit.
            middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
            axes.update_datalim([middle - LEAST_VIEW * self.extent,
                                 middle + LEAST_VIEW * self.extent])
        axes.autoscale_view()

    def ground(self):
        if self.mechanism.planar:
            draw_ground(self.axes, self.mechanism, self.poses, self.extent)
        else:
            draw_spatial_ground(self)

    def bodies(self, index, strength=1.0):
        """
        Draw all bodies with their joints in one pose.

        ``strength``: float; 1: full colours; less: paler, for positions in the background.
        """
        layer = 10.0 + 15.0 * strength
        gray = {'facecolor': '0.85', 'edgecolor': '0.55'}
        parts = self._wheels(GROUND, gray, layer)
        for body in self.mechanism.bodies:
            parts += self._body(body.name, strength, layer)
        parts += [Part(self.axes.plot([], [], color=mixed(INK, 0.6 * strength), linewidth=1.4,
                                      zorder=layer - 0.3)[0], ((body, places),))
                  for body, places, filled in self.wheels if not filled]
        for driven in (True, False):
            origin = len(self.mechanism.joints[0].position) * (0.0,)
            ends = tuple((joint.child, (origin,)) for joint in self.mechanism.joints
                         if joint.type != PRISMATIC and joint.actuated == driven)
            parts.append(Part(self._dots(INK if driven else 'white', INK, 6.5 if driven else 5.0,
                                         strength, layer), ends))
        if not self.mechanism.planar and strength == 1.0:
            parts += self._axes_of_joints(layer)
        parts += [Part(self.axes.plot([], [], color=mixed(INK, strength), zorder=layer + 0.4,
                                      linewidth=ROD_WIDTH)[0],
                       ((cut.body_a, (cut.point_a,)), (cut.body_b, (cut.point_b,))))
                  for cut in self.mechanism.cut_joints if cut.type == DISTANCE]
        parts.append(Part(
            self._dots('white', CUT_COLOR, 7.5, strength, layer, edge_width=2.2),
            tuple((cut.body_a, (cut.point_a,)) for cut in self.mechanism.cut_joints)))
        for part in parts:
            part.place(self.places(part)[index])
            if part.layer is not None:
                part.artist.set_zorder(self.layers(part)[index])
        return parts

    def places(self, part):
        """Return where a part is seen in each pose, shape (n, m, 2) [m]."""
        return self.view.project(self.world(part))

    def layers(self, part):
        """Return in which layer a part lies in each pose, shape (n,): the nearer, the higher."""
        nearness = self.view.nearness(self.world(part)).mean(axis=1)
        return part.layer + DEPTH_LAYERS * (0.5 + np.arctan(4.0 * nearness / self.extent) / np.pi)

    def world(self, part):
        places = [world_points(pose_of(self.mechanism, self.poses, body), points)
                  for body, points in part.points]
        size = 2 if self.mechanism.planar else 3
        return np.concatenate([np.zeros((len(self.poses), 0, size)), *places], axis=1)

    def path(self, name):
        """Draw the path of a named point over all poses."""
        places = self.view.project(named_point(self.mechanism, self.poses, name))
        self.trace(places)
        return places

    def trace(self, places):
        """Draw the path through places in the picture, shape (m, 2) [m]; return its line."""
        return self.axes.plot(*places.T, color=PATH_COLOR, linewidth=1.6, zorder=31)[0]

    def mark(self, place):
        """Mark where a traced point is; return the mark."""
        return self.axes.plot(*place, marker='D', markersize=5, color=PATH_COLOR, zorder=32,
                              markeredgecolor='white', markeredgewidth=0.8)[0]

    def forces(self, index, forces, largest):
        """
        Draw the constraint forces on body A of every cut joint.

        ``index`` is that of the pose; ``forces`` has shape (number of cut joints, 3), in space
        (number of cut joints, 6), moment [N m] and force [N]; ``largest`` is the force that gets
        the longest arrow.
        """
        for start, end in self.arrow_ends(index, forces, largest):
            self.axes.annotate('', end, start, zorder=ARROW['zorder'], arrowprops=ARROW)
            self.axes.update_datalim([end])
        self.axes.autoscale_view()

    def arrow_ends(self, index, forces, largest):
        """Return where the arrow of each cut joint starts and ends; see ``forces``."""
        scale = ARROW_SIZE * self.extent / largest if largest > 0.0 else 0.0
        starts = [self._cut_place(cut, self.poses[index]) for cut in self.mechanism.cut_joints]
        return [(self.view.project(start), self.view.project(start + scale * force_of(wrench)))
                for start, wrench in zip(starts, forces)]

    def cut_names(self, index, forces):
        """
        Write the names of the cut joints.

        In the plane beside them, where the force arrows do not go; in space, where there is no
        room between the bodies, in a column at the right, with lines to the joints.
        """
        cuts = self.mechanism.cut_joints
        places = [self._cut_place(cut, self.poses[index]) for cut in cuts]
        seen = [self.view.project(place) for place in places]
        style = {'va': 'center', 'zorder': 34, 'color': CUT_COLOR, 'fontsize': 9,
                 'fontweight': 'bold', 'path_effects': _halo()}
        if not self.mechanism.planar:
            line = {'arrowstyle': '-', 'color': CUT_COLOR, 'linewidth': 0.7, 'shrinkB': 5}
            step = min(0.09, 1.0 / len(cuts)) if cuts else 0.0
            for rank, k in enumerate(sorted(range(len(cuts)), key=lambda k: -seen[k][1])):
                self.axes.annotate(
                    cuts[k].name, seen[k], textcoords='axes fraction', ha='left', arrowprops=line,
                    xytext=(1.02, 0.5 + step * (0.5 * (len(cuts) - 1) - rank)), **style)
            return
        written = {}
        for cut, place, start, force in zip(cuts, places, seen, map(force_of, forces)):
            ahead = place + 0.01 * self.extent * force / (np.linalg.norm(force) or 1.0)
            key = tuple(np.round(start / self.extent / APART) * APART)
            names, arrows = written.setdefault(key, ([], []))
            names.append(cut.name)
            arrows.append(self.view.project(ahead) - start)
        for place, (names, arrows) in written.items():
            right, up = -np.sum(arrows, axis=0)
            self.axes.annotate(
                ', '.join(names), np.array(place) * self.extent,
                xytext=(11 if right >= 0.0 else -11, 9 if up >= 0.0 else -9),
                textcoords='offset points', ha='left' if right >= 0.0 else 'right', **style)

    def _named(self, color):
        """Return the names of the bodies of a colour, of many the first ones."""
        names = [name for name, one in self.color.items() if one == color]
        more = f' and {len(names) - NAMED} more' if len(names) > NAMED else ''
        return ', '.join(names[:NAMED]) + more

    def legend_handles(self, path=None, force=None):
        """Return the legend's handles; ``force`` is the label of the arrows."""
        handles = [
            Line2D([], [], color=mixed(color, 0.75), linewidth=LINK_WIDTH,
                   label=self._named(color))
            for color in dict.fromkeys(self.color.values())]
        actuated = any(joint.actuated for joint in self.mechanism.joints)
        marker = {'linestyle': 'none', 'marker': 'o'}
        handles += [Line2D([], [], markersize=6.5, color=INK, label='driven joint',
                           **marker)] * actuated
        handles += [Line2D([], [], markersize=7.5, markerfacecolor='white',
                           label='closes a loop',
                           markeredgecolor=CUT_COLOR, markeredgewidth=2.2,
                           **marker)] * bool(self.mechanism.cut_joints)
        if path is not None:
            handles.append(Line2D([], [], color=PATH_COLOR, linewidth=1.6, marker='D',
                                  markersize=5, label=f'path of {path}'))
        if force:
            handles.append(Line2D([], [], color=FORCE_COLOR, linewidth=1.8, marker='>',
                                  markersize=6, label=force))
        return handles

    def _body(self, name, strength, layer):
        """Return the parts that a body is drawn as."""
        color, points = self.color[name], self.outlines[name]
        style = {'facecolor': mixed(color, 0.35 * strength), 'joinstyle': 'round',
                 'edgecolor': mixed(color, 0.75 * strength), 'zorder': layer}
        parts = []
        if not self.mechanism.planar:
            return self._spatial_body(name, style, layer) + self._wheels(name, style, layer)
        parts += self._wheels(name, style, layer)
        if len(points) > 2:
            parts.append(Part(self.axes.add_patch(Polygon(points, linewidth=2.2, **style)),
                              ((name, points),)))
        elif len(points) == 2:
            line, = self.axes.plot([], [], color=mixed(color, 0.75 * strength), zorder=layer,
                                   linewidth=LINK_WIDTH, solid_capstyle='round')
            parts.append(Part(line, ((name, points),)))
        if name in self.sliders or len(points) == 1:
            block = SLIDER_SIZE * self.extent * np.array(
                [[-1.0, -0.62], [1.0, -0.62], [1.0, 0.62], [-1.0, 0.62]])
            parts.append(Part(self.axes.add_patch(Polygon(block, linewidth=1.5, **style)),
                              ((name, block),)))
        return parts

    def _wheels(self, name, style, layer):
        """Return the wheels and racks of a body, before the rest of it."""
        parts = []
        for body, places, filled in self.wheels:
            if body == name and filled:
                shape = self.axes.add_patch(Polygon(
                    np.zeros((1, 2)), linewidth=0.6, **{**style, 'zorder': layer + 0.2}))
                parts.append(Part(shape, ((name, places),), layer=(
                    None if self.mechanism.planar else layer + 0.2)))
        return parts

    def _spatial_body(self, name, style, layer):
        """Return the outline of a body in space, a line, or a block that shows no turn."""
        points, slides = self.outlines[name], name in self.sliders
        if not len(points):
            return []
        place = ((name, points),)
        if len(points) > 2:
            shape = self.axes.add_patch(Polygon(np.zeros((1, 2)), linewidth=1.6, **style))
            return [Part(shape, place, solid=True, layer=layer)]
        line = {'color': style['edgecolor'], 'zorder': layer}
        if len(points) == 2:
            shape, = self.axes.plot([], [], linewidth=ROD_WIDTH if slides else SPATIAL_WIDTH,
                                    solid_capstyle='round', **line)
        elif self.massless[name]:
            return []
        else:
            shape, = self.axes.plot([], [], marker='s', markersize=7.0, linestyle='none',
                                    **line)
        return [Part(shape, place, layer=layer)]

    def _axes_of_joints(self, layer):
        """Return lines along the axes that bodies turn about."""
        reach = AXIS_LENGTH * self.extent
        parts = []
        for body, place, axis in joint_axes(self.mechanism):
            along = reach * axis
            line, = self.axes.plot([], [], color=INK, linewidth=0.9, linestyle=AXIS_DASHES,
                                   zorder=layer + 0.45)
            parts.append(Part(line, ((body, (place - along, place + along)),)))
        return parts

    def _dots(self, face, edge, size, strength, layer, edge_width=1.3):
        dots, = self.axes.plot([], [], marker='o', markersize=size, zorder=layer + 0.5,
                               linestyle='none', markerfacecolor=mixed(face, strength),
                               markeredgecolor=mixed(edge, strength), markeredgewidth=edge_width)
        return dots

    def _cut_place(self, cut, poses):
        return world_points(pose_of(self.mechanism, poses, cut.body_a), cut.point_a)


def _halo():
    return [matplotlib.patheffects.withStroke(linewidth=2.5, foreground='white')]


def all_places(mechanism, poses):
    """
    Return all places that points of bodies come to, shape (m, 2), in space (m, 3) [m].

    ``poses``: shape (n, nb, 3), in space (n, nb, 7); of the bodies.
    """
    of_body = outline if mechanism.planar else marked_points
    places = [world_points(pose_of(mechanism, poses, body.name), of_body(mechanism, body.name))
              for body in mechanism.bodies]
    places += [world_points(pose_of(mechanism, poses, body), wheel)
               for body, wheel, _ in outlines(mechanism)]
    return np.concatenate([each.reshape(-1, each.shape[-1]) for each in places])


def mixed(color, strength):
    """Mix a colour with white; opaque, so that overlapping parts do not darken."""
    strength = PALEST + (1.0 - PALEST) * strength if strength < 1.0 else 1.0
    return tuple(strength * part + 1.0 - strength for part in to_rgb(color))


def draw_ground(axes, mechanism, poses, extent):
    """
    Draw the ground: pivots as hatched triangles, slides as hatched lines.

    ``poses``, shape (n, nb, 3), are all that are drawn: a rail is as long as its slider needs it.
    ``extent`` is that of the picture [m].
    """
    for kind, angle, place, body, point in _on_ground(mechanism):
        if kind in (PRISMATIC, POINT_ON_LINE):
            axis = direction(angle)
            moving = world_points(pose_of(mechanism, poses, body), point)
            along = (moving - place) @ axis
            _draw_rail(axes, np.array(place), axis, along, SLIDER_SIZE * extent)
        else:
            _draw_pivot(axes, np.array(place), PIVOT_SIZE * extent)


def draw_spatial_ground(artist):
    """
    Draw the ground in space: pivots, and a floor for scale.

    ``artist`` is the MechanismArtist that draws the rest.
    """
    axes, view, mechanism = artist.axes, artist.view, artist.mechanism
    if view.distance is not None:
        _draw_floor(artist)
    feet = [joint.position for joint in mechanism.joints if joint.parent == GROUND]
    feet += [cut.point_a for cut in mechanism.cut_joints if cut.body_a == GROUND]
    feet += [cut.point_b for cut in mechanism.cut_joints if cut.body_b == GROUND]
    feet = convex_hull(view.project(np.array(feet)))
    if len(feet) > 2:
        axes.add_patch(Polygon(feet, facecolor='0.93', edgecolor='0.6', hatch='////',
                               linewidth=1.2, joinstyle='round', zorder=GROUND_BEHIND))
    axes.plot(*feet.T, color='0.6', linewidth=5.0 if len(feet) == 2 else 0.0, marker='s',
              markersize=9.0, zorder=GROUND_BEHIND + 0.1)


def _draw_floor(artist):
    """Draw a grid below a mechanism, with the directions of the world's axes on it."""
    places = all_places(artist.mechanism, artist.poses)
    low, high = places.min(axis=0), places.max(axis=0)
    rough = artist.extent / FLOOR_LINES
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(each for each in (1.0, 2.0, 5.0, 10.0) if each * power >= rough)
    first = np.floor((low[:2] - 0.1 * step) / step) * step
    last = np.ceil((high[:2] + 0.1 * step) / step) * step
    height = low[2] - FLOOR_ROOM * artist.extent
    project = artist.view.project

    def line(start, end, **style):
        seen = project(np.array([start, end]))
        artist.axes.plot(*seen.T, **style)
        artist.axes.update_datalim(seen)

    pale = {'color': '0.88', 'linewidth': 0.8, 'zorder': 1.0}
    for x in np.arange(first[0], last[0] + 0.5 * step, step):
        line((x, first[1], height), (x, last[1], height), **pale)
    for y in np.arange(first[1], last[1] + 0.5 * step, step):
        line((first[0], y, height), (last[0], y, height), **pale)
    corner = np.array([*first, height])
    for along, name in zip(step * np.eye(3), 'xyz'):
        line(corner, corner + along, color='0.35', linewidth=1.4, zorder=1.5)
        artist.axes.text(*project(corner + 1.35 * along), name, color='0.35', fontsize=9,
                         ha='center', va='center')
    artist.axes.text(0.5, -0.02, f'grid: {step:g} m', transform=artist.axes.transAxes,
                     color='0.35', fontsize=9, ha='center', va='top')
    artist.axes.autoscale_view()


def _on_ground(mechanism):
    """Yield type, angle and place of each joint on the ground, the body and its point there."""
    for joint in mechanism.joints:
        if joint.parent == GROUND:
            yield joint.type, joint.angle, joint.position, joint.child, (0.0, 0.0)
    for cut in mechanism.cut_joints:
        if cut.body_b == GROUND:
            # A block slides by its own origin, a pin by the point in the slot.
            point = cut.point_a if cut.type == POINT_ON_LINE else (0.0, 0.0)
            yield cut.type, cut.angle, cut.point_b, cut.body_a, point
        elif cut.body_a == GROUND and cut.type not in (PRISMATIC, POINT_ON_LINE):
            # The axis of a prismatic cut joint belongs to body B: nothing to draw here.
            yield cut.type, 0.0, cut.point_a, cut.body_b, cut.point_b


def _draw_pivot(axes, place, size):
    left, right = place + [-0.7 * size, -size], place + [0.7 * size, -size]
    axes.add_patch(Polygon([place, left, right], facecolor='0.85', edgecolor=INK,
                           linewidth=1.2, joinstyle='round', zorder=GROUND_LAYER))
    wide = np.array([0.45 * size, 0.0])
    _draw_hatched(axes, left - wide, right + wide, np.array([0.0, -0.4 * size]))


def _draw_rail(axes, place, axis, along, size):
    below = np.array([axis[1], -axis[0]]) * size * 0.62
    start, end = (place + axis * reach + below
                  for reach in (along.min() - 1.6 * size, along.max() + 1.6 * size))
    _draw_hatched(axes, start, end, below * 0.55)


def _draw_hatched(axes, start, end, depth):
    axes.add_patch(Polygon([start, end, end + depth, start + depth], facecolor='none',
                           edgecolor='0.55', hatch='//////', linewidth=0.0,
                           zorder=GROUND_LAYER))
    axes.plot(*np.transpose([start, end]), color=INK, linewidth=1.2, zorder=GROUND_LAYER)
