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

"""Outlines of bodies, and what stands still below them: pivots and rails."""

from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon
import numpy as np

from .motion import pose_of
from ..mechanism.mechanism import GROUND, PRISMATIC

INK = '#333333'
# Of a pivot's triangle, and of the block of a slider, as shares of the picture's extent.
PIVOT_SIZE, SLIDER_SIZE = 0.035, 0.04
# Above the positions in the background, below the strong one.
GROUND_LAYER = 24.0
PALEST = 0.18


def mixed(color, strength):
    """Mix a colour with white; opaque, so that overlapping parts do not darken."""
    strength = PALEST + (1.0 - PALEST) * strength if strength < 1.0 else 1.0
    return tuple(strength * part + 1.0 - strength for part in to_rgb(color))


def draw_ground(axes, mechanism, poses, extent):
    """
    Draw what stands still: pivots as hatched triangles, slides as hatched lines.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    mechanism : mechanism.mechanism.Mechanism
        What is drawn.
    poses : ndarray, shape (n, nb, 3)
        All that are drawn: a rail is as long as its slider needs it.
    extent : float
        Of the picture [m].

    """
    for kind, angle, place, body in _on_ground(mechanism):
        if kind == PRISMATIC:
            axis = np.array([np.cos(angle), np.sin(angle)])
            along = (pose_of(mechanism, poses, body)[..., :2] - place) @ axis
            _draw_rail(axes, np.array(place), axis, along, SLIDER_SIZE * extent)
        else:
            _draw_pivot(axes, np.array(place), PIVOT_SIZE * extent)


def _on_ground(mechanism):
    """Yield type, angle and place of every joint and cut joint on the ground, and the body."""
    for joint in mechanism.joints:
        if joint.parent == GROUND:
            yield joint.type, joint.angle, joint.position, joint.child
    for cut in mechanism.cut_joints:
        if cut.body_b == GROUND:
            yield cut.type, cut.angle, cut.point_b, cut.body_a
        elif cut.body_a == GROUND and cut.type != PRISMATIC:
            # The axis of a prismatic cut joint belongs to body B: nothing to draw here.
            yield cut.type, 0.0, cut.point_a, cut.body_b


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
