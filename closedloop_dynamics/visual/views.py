# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From where a mechanism is seen: the plane itself, or projections of space onto pictures."""

from dataclasses import dataclass
import math
from typing import Optional, Tuple

import numpy as np

# The perspective: angles about the vertical and above the horizon [rad], and the distance of
# the eye, as a multiple of the extent shown.
AZIMUTH, ELEVATION, DISTANCE = math.radians(-60.0), math.radians(22.0), 3.0


@dataclass(frozen=True)
class View:
    """A projection."""

    name: str  # Title of its picture
    #: Directions in the world of the picture's right, up and towards the eye; None: the picture is
    #: the plane that the mechanism is in.
    axes: Optional[Tuple] = None
    labels: Tuple[str, ...] = ()  # Of the picture's axes; empty where lengths cannot be read off
    center: Tuple[float, ...] = (0.0, 0.0, 0.0)  # Size of the scene [m]; of a perspective
    #: From the centre to the eye [m]; None: parallel lines stay parallel.
    distance: Optional[float] = None

    def project(self, places):
        """Return where places, shape (..., 2) or (..., 3) [m], are seen, shape (..., 2)."""
        if self.axes is None:
            return places
        seen = (places - self.center) @ np.array(self.axes).T
        if self.distance is None:
            return seen[..., :2]
        return seen[..., :2] / (1.0 - seen[..., 2:] / self.distance)

    def nearness(self, places):
        """Return how far places, shape (..., 3), are towards the eye [m], shape (...)."""
        return (places - self.center) @ np.array(self.axes[2])


PLANE = View('', labels=('x [m]', 'y [m]'))
FRONT = View('front', ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)), ('x [m]', 'z [m]'))
SIDE = View('side', ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), ('y [m]', 'z [m]'))
TOP = View('top', ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), ('x [m]', 'y [m]'))


def perspective(places):
    """
    Return the view of places from in front, from the right and from above.

    ``places``: shape (n, 3) [m]; all that will be shown.
    """
    low, high = places.min(axis=0), places.max(axis=0)
    sine, cosine = math.sin(AZIMUTH), math.cos(AZIMUTH)
    up, out = math.sin(ELEVATION), math.cos(ELEVATION)
    axes = ((-sine, cosine, 0.0), (-up * cosine, -up * sine, out),
            (out * cosine, out * sine, up))
    size = float(np.linalg.norm(high - low)) or 1.0
    return View('perspective', axes, (), tuple(0.5 * (low + high)), DISTANCE * size)
