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

"""
What a planar mechanism is: frozen data, no algorithms, no file formats.

Frames. The world is right-handed, x to the right, y up, angles
counter-clockwise. Every body has a frame whose origin sits at the body's own
joint (the one that joins it to its parent). A joint at ``position`` in the
parent's frame, turned by ``angle``, is

* revolute: the child's frame is turned by ``angle + q``, its origin at
  ``position``;
* prismatic: the child's frame is turned by ``angle``, its origin at
  ``position`` plus ``q`` along the child's own x axis.

The ground is the body named ``'ground'``; its frame is the world frame.

"""

from dataclasses import dataclass
from functools import cached_property
from typing import Tuple

GROUND = 'ground'
REVOLUTE = 'revolute'
PRISMATIC = 'prismatic'
FIXED = 'fixed'
JOINT_TYPES = (REVOLUTE, PRISMATIC)
# Closure equations of each type of cut joint, in the plane.
CUT_JOINT_EQUATIONS = {REVOLUTE: 2, PRISMATIC: 2, FIXED: 3}

Vector2 = Tuple[float, float]


class MechanismError(ValueError):
    """A mechanism description that no planar mechanism can have."""


@dataclass(frozen=True)
class Body:
    """
    One rigid body.

    Attributes
    ----------
    name : str
    mass : float
        [kg], positive.
    center_of_mass : tuple of 2 floats
        In the body frame [m].
    inertia : float
        About the centre of mass [kg m^2], not negative (zero: a point mass).
    massless : bool
        Mass and inertia are zero on purpose: a link that only guides. The loops must then
        determine its motion.

    """

    name: str
    mass: float
    center_of_mass: Vector2
    inertia: float
    massless: bool = False


@dataclass(frozen=True)
class Joint:
    """
    A joint of the spanning tree: one degree of freedom between parent and child.

    Attributes
    ----------
    name : str
    type : str
        ``'revolute'`` or ``'prismatic'``.
    parent, child : str
        Names of bodies; the parent may be ``'ground'``.
    position : tuple of 2 floats
        Place of the joint in the parent's frame [m].
    angle : float
        Angle of the child's frame relative to the parent's at q = 0 [rad].
    actuated : bool
        Whether a torque (force, for a prismatic joint) command drives it.

    """

    name: str
    type: str  # noqa: A003
    parent: str
    child: str
    position: Vector2
    angle: float = 0.0
    actuated: bool = False


@dataclass(frozen=True)
class CutJoint:
    """
    A joint where a loop is cut open and replaced by a constraint force.

    Attributes
    ----------
    name : str
    type : str
        ``'revolute'``: p_a - p_b = 0 in world axes (2 equations).
        ``'prismatic'``: point a stays on the line through point b along the
        axis at ``angle`` in body b's frame, and the relative angle
        alpha_a - alpha_b stays ``angle`` (2 equations).
        ``'fixed'``: p_a - p_b = 0 and alpha_a - alpha_b = ``angle`` (3).
    body_a, body_b : str
        Either may be ``'ground'``, not both.
    point_a, point_b : tuple of 2 floats
        The cut point in the frames of body a and of body b [m].
    angle : float
        Relative angle alpha_a - alpha_b [rad]; unused for ``'revolute'``.

    """

    name: str
    type: str  # noqa: A003
    body_a: str
    body_b: str
    point_a: Vector2
    point_b: Vector2
    angle: float = 0.0


@dataclass(frozen=True)
class Point:
    """
    A named point on a body.

    Attributes
    ----------
    name : str
    body : str
        Its name; ``'ground'`` for a place in the world.
    position : tuple of 2 floats
        In the body's frame [m].

    """

    name: str
    body: str
    position: Vector2


@dataclass(frozen=True)
class Mechanism:
    """
    A mechanism: bodies, spanning-tree joints, cut joints, named points.

    The order of ``joints`` is the order of the joint coordinates q, that of
    ``cut_joints`` the order of the Lagrange multipliers.

    """

    name: str
    bodies: Tuple[Body, ...]
    joints: Tuple[Joint, ...]
    cut_joints: Tuple[CutJoint, ...] = ()
    points: Tuple[Point, ...] = ()
    description: str = ''

    # Set on what validation.checked returns; a copy with other values has not been checked.
    valid = False

    @cached_property
    def joint_names(self):
        """Names of the joints, in the order of q."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def actuated_joints(self):
        """Names of the actuated joints, in the order of q."""
        return tuple(joint.name for joint in self.joints if joint.actuated)

    @property
    def number_of_equations(self):
        """Return nc, the number of closure equations."""
        return sum(CUT_JOINT_EQUATIONS[cut.type] for cut in self.cut_joints)
