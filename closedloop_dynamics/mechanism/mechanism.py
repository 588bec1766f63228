# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Records of a mechanism: frozen data, no algorithms, no file formats.

Frames. The world is right-handed. Every body has a frame whose origin sits at the body's own
joint (the one that joins it to its parent). The ground is the body named ``'ground'``; its frame
is the world frame.

In the plane (vectors of two numbers) x points to the right, y up, and angles are
counter-clockwise. A joint at ``position`` in the parent's frame, turned by ``angle``, is

* revolute: the child's frame is turned by ``angle + q``, its origin at
  ``position``;
* prismatic: the child's frame is turned by ``angle``, its origin at
  ``position`` plus ``q`` along the child's own x axis.

In space (vectors of three numbers) the child's frame is, at q = 0, turned by ``orientation``
against the parent's, with its origin at ``position``; from there it turns about ``axis``, slides
along it, or both. An axis is given in the frame at q = 0.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Dict, Optional, Tuple, Union

from .coordinates import (
    Coordinates, CYLINDRICAL, FIXED, FREE, HELICAL, PLANAR, POINT_ON_LINE, PRISMATIC, REVOLUTE,
    SPHERICAL, UNIVERSAL)

GROUND = 'ground'
BOX, CYLINDER, SPHERE, MESH = 'box', 'cylinder', 'sphere', 'mesh'
DISTANCE = 'distance'
POINT_ON_PLANE = 'point_on_plane'
# Joints of trees in the plane, and cut joints with their closure equations.
JOINT_TYPES = (REVOLUTE, PRISMATIC)
CUT_JOINT_EQUATIONS = {REVOLUTE: 2, PRISMATIC: 2, FIXED: 3, DISTANCE: 1, POINT_ON_LINE: 1}
# The same in space: joints of trees with their freedoms.
JOINT_FREEDOMS = {REVOLUTE: 1, PRISMATIC: 1, HELICAL: 1, CYLINDRICAL: 2, UNIVERSAL: 2,
                  SPHERICAL: 3, PLANAR: 3, FREE: 6, FIXED: 0}
SPATIAL_CUT_JOINT_EQUATIONS = {REVOLUTE: 5, PRISMATIC: 5, FIXED: 6, CYLINDRICAL: 4, UNIVERSAL: 4,
                               SPHERICAL: 3, PLANAR: 3, HELICAL: 5, DISTANCE: 1,
                               POINT_ON_LINE: 2, POINT_ON_PLANE: 1}
# Joints that an axis belongs to, of trees and where they are cut.
WITH_AXIS = (REVOLUTE, PRISMATIC, HELICAL, CYLINDRICAL, UNIVERSAL)
CUT_WITH_AXIS_A = (REVOLUTE, CYLINDRICAL, UNIVERSAL, PLANAR)
CUT_WITH_AXIS_B = (*CUT_WITH_AXIS_A, PRISMATIC, HELICAL, POINT_ON_LINE, POINT_ON_PLANE)
# Cut joints that keep the orientation of body A in body B, or lead it back there.
CUT_WITH_ORIENTATION = (PRISMATIC, FIXED, HELICAL)
# Cut joints that have coordinates, in the plane and in space.
MEASURED = (REVOLUTE, PRISMATIC, POINT_ON_LINE)
SPATIAL_MEASURED = (REVOLUTE, PRISMATIC, HELICAL, CYLINDRICAL, UNIVERSAL, PLANAR, SPHERICAL)
# Cut joints whose coordinates count from an orientation of body A in body B.
CUT_WITH_ZERO = (FIXED, *SPATIAL_MEASURED)
# Cut joints that exert no moment about their point on body A.
CUT_WITHOUT_MOMENT = (SPHERICAL, DISTANCE, POINT_ON_LINE, POINT_ON_PLANE)
# Joints that can be coupled: they have one coordinate.
COUPLED = (REVOLUTE, PRISMATIC, HELICAL)

Vector2 = Tuple[float, float]
Vector3 = Tuple[float, float, float]
Vector = Union[Vector2, Vector3]
# What numbers with nine digits behind the point make of axes and places that are meant to agree.
TOLERANCE = 1e-8
# A unit quaternion: x, y, z, w.
Quaternion = Tuple[float, float, float, float]
UNTURNED = (0.0, 0.0, 0.0, 1.0)


class MechanismError(ValueError):
    """A mechanism description that no mechanism can have."""


@dataclass(frozen=True)
class Visual:
    """
    Shape that a body is drawn as; without mass.

    Attributes
    ----------
    kind : str
        ``'box'``, ``'cylinder'``, ``'sphere'`` or ``'mesh'``.
    size : tuple of floats
        Of a box its three lengths [m], of a cylinder along its z axis radius and length [m], of
        a sphere its radius [m], of a mesh what its coordinates are multiplied with.
    center : tuple of 3 floats
        In the body's frame [m], of a mesh its origin; in the plane z is zero.
    orientation : tuple of 4 floats
        Of its axes in the body's frame, a unit quaternion.
    file : str or None
        Of a mesh.
    color : tuple of 3 floats or None
        Red, green and blue, 0 to 1; None: that of its body's subsystem.

    """

    kind: str
    size: Tuple[float, ...]
    center: Vector3 = (0.0, 0.0, 0.0)
    orientation: Quaternion = UNTURNED
    file: Optional[str] = None  # noqa: A003
    color: Optional[Vector3] = None


@dataclass(frozen=True)
class Body:
    """
    One rigid body.

    Attributes
    ----------
    name : str
    mass : float
        [kg], positive.
    center_of_mass : tuple of 2 or 3 floats
        In the body frame [m].
    inertia : float, or tuple of 3 or 6 floats
        About the centre of mass [kg m^2], not negative (zero: a point mass). In space the
        principal moments along the body's axes, or xx, yy, zz, xy, xz, yz: the elements of
        the matrix, so xy is minus the integral of x y dm.
    massless : bool
        Mass and inertia are zero on purpose: a link that only guides. The loops must then
        determine its motion.
    visual : tuple of Visual
        Shapes of the drawing; ``shape`` gives them where they are left out, else lines through
        its joints and points.

    """

    name: str
    mass: float
    center_of_mass: Vector
    inertia: Union[float, Tuple[float, ...]]
    massless: bool = False
    visual: Tuple[Visual, ...] = field(default=(), compare=False)


@dataclass(frozen=True)
class Joint:
    """
    A joint of the spanning tree between parent and child; in the plane of one degree of freedom.

    Attributes
    ----------
    name : str
    type : str
        ``'revolute'`` or ``'prismatic'``; in space also ``'helical'``, ``'cylindrical'``,
        ``'universal'``, ``'spherical'``, ``'planar'``, ``'free'`` or ``'fixed'``.
    parent : str
        Name of the parent body, or ``'ground'``.
    child : str
        Name of the child body.
    position : tuple of 2 or 3 floats
        Place of the joint in the parent's frame [m].
    angle : float
        Angle of the child's frame relative to the parent's at q = 0 [rad]; in the plane.
    actuated : bool
        Whether a torque (force, for a prismatic joint) command drives it.
    orientation : tuple of 4 floats
        Of the child's frame in the parent's at q = 0: turns [rad] about the parent's x, y and z,
        one after the other, or a unit quaternion; in space.
    axis : tuple of 3 floats or None
        Along or about which the child moves, in its frame; of a universal joint the one that
        stays in the parent. Of revolute, prismatic, helical, cylindrical and universal joints in
        space.
    second_axis : tuple of 3 floats or None
        Of a universal joint, the one fixed in the child, in its frame.
    lead : float or None
        Of a helical joint [m/rad].

    """

    name: str
    type: str  # noqa: A003
    parent: str
    child: str
    position: Vector
    angle: float = 0.0
    actuated: bool = False
    orientation: Quaternion = UNTURNED
    axis: Optional[Vector3] = None
    second_axis: Optional[Vector3] = None
    lead: Optional[float] = None


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
        ``'distance'``: the points stay ``length`` apart, the ends of a massless rod (1).
        ``'point_on_line'``: a pin in a slot, point a stays on the line through
        point b along the axis at ``angle`` in body b's frame (1).
        In space also ``'cylindrical'``, ``'universal'``, ``'spherical'``, ``'planar'``,
        ``'helical'`` or ``'point_on_plane'``; equations that always hold, such as those out of
        the plane of a planar mechanism, are left out.
    body_a, body_b : str
        Either may be ``'ground'``, not both.
    point_a, point_b : tuple of 2 or 3 floats
        The cut point in the frames of body a and of body b [m].
    angle : float
        Relative angle alpha_a - alpha_b, of a revolute joint where its coordinate is zero, or of
        the line in body b [rad]; unused for ``'distance'``; in the plane.
    axis_a, axis_b : tuple of 3 floats or None
        In space: the joint's axis in both bodies' frames, of a universal joint the axis fixed in
        each, of a planar joint the plane's normal. Prismatic and helical joints have ``axis_b``
        alone, as do a point on a line of body b (its direction) and one on a plane (its normal).
    orientation : tuple of 4 floats
        Of body a in body b, where the joint keeps it: prismatic and fixed ones in space; of a
        helical one where it has not slid; of one that is revolute, cylindrical, universal, planar
        or spherical where its coordinates are zero (not given: as body B, turned from there only
        so far that the axes lie as the joint holds them).
    length : float or None
        Of ``'distance'``: the distance of the two points, the length of a massless rod [m].
    lead : float or None
        Of a helical joint [m/rad].
    actuated : bool
        Whether a torque (force, for a prismatic joint) command drives each of its degrees of
        freedom: of one that is revolute, prismatic, helical, cylindrical, universal, planar or
        spherical, in the plane also of a pin in a slot.

    """

    name: str
    type: str  # noqa: A003
    body_a: str
    body_b: str
    point_a: Vector
    point_b: Vector
    angle: float = 0.0
    axis_a: Optional[Vector3] = None
    axis_b: Optional[Vector3] = None
    orientation: Quaternion = UNTURNED
    length: Optional[float] = None
    lead: Optional[float] = None
    actuated: bool = False


@dataclass(frozen=True)
class CouplingLaw:
    """
    A smooth function f(x) of the coordinate x of a joint, given in one of three ways.

    Attributes
    ----------
    joint : str
        Whose coordinate x is [rad or m]; a joint of the tree of one degree of freedom, without a
        factor.
    polynomial : tuple of floats or None
        c0, c1, c2, ... of c0 + c1 x + c2 x^2 + ..., two or more.
    x : tuple of floats or None
        Of a table, three or more, growing [rad or m].
    values : tuple of floats or None
        At these; a cubic spline leads through them, natural: with period, a periodic one, without
        it goes on straight beyond both ends.
    period : float or None
        After which a table repeats, or a polynomial from 0 on, such as a turn of a cam, positive
        [rad or m].
    expression : str or None
        Of x, without the functions that have corners: ``0.01*(1 - cos(x))``.

    """

    joint: str
    polynomial: Optional[Tuple[float, ...]] = None
    x: Optional[Tuple[float, ...]] = None
    values: Optional[Tuple[float, ...]] = None
    period: Optional[float] = None
    expression: Optional[str] = None


@dataclass(frozen=True)
class Coupling:
    """
    An equation between joint coordinates: gears, a belt, rack and pinion, a mimic joint, a cam.

    Linear but for its law. Its multiplier is the generalized force: times a joint's factor what
    acts in that joint, and in that of the law times -f'(x).

    Attributes
    ----------
    name : str
    joints : dict of str to float
        Factors by joint [rad or m]; joints of one degree of freedom. The sum of the coordinates
        times their factors stays ``offset``. In the plane revolute cut joints, too, whose
        coordinate is alpha_a - alpha_b - ``angle``.
    offset : float
        That sum.
    radius : float or None
        Pitch radius of the wheel that the first joint turns [m], positive. With it the
        force of the teeth or the belt is reported: the torque in this joint over the radius.
    law : CouplingLaw or None
        A function of another joint's coordinate: the sum stays ``offset`` plus its value.

    """

    name: str
    joints: Dict[str, float]
    offset: float = 0.0
    radius: Optional[float] = None
    law: Optional[CouplingLaw] = None

    @property
    def names(self) -> Tuple[str, ...]:
        """Names of all joints between which it is an equation."""
        return (*self.joints, *(() if self.law is None else (self.law.joint,)))


@dataclass(frozen=True)
class DrivingConstraint:
    """
    An equation that makes a degree of freedom, or a point, a function of time.

    An effect of the scene knows that function. The multiplier is the torque or force that it
    takes.

    Attributes
    ----------
    name : str
        Of the effect.
    freedom : str or None
        As ``Coordinates.names`` has it, of a joint or a cut joint.
    point : str or None
        Name of a point, where no freedom is given.
    direction : tuple of 2 or 3 floats or None
        Of length 1, in world axes, along which the point's place is given [m].

    """

    name: str
    freedom: Optional[str] = None
    point: Optional[str] = None
    direction: Optional[Vector] = None


@dataclass(frozen=True)
class Point:
    """
    A named point on a body.

    Attributes
    ----------
    name : str
    body : str
        Its name; ``'ground'`` for a place in the world.
    position : tuple of 2 or 3 floats
        In the body's frame [m].

    """

    name: str
    body: str
    position: Vector


@dataclass(frozen=True, repr=False)
class Mechanism:
    """
    A mechanism: bodies, spanning-tree joints, cut joints, named points.

    The order of ``joints`` is the order of the joint coordinates q (``coordinates``), that of
    ``cut_joints``, then of ``couplings``, then of ``motions``, the order of the Lagrange
    multipliers. No file has ``motions``: a simulation adds those that its scene prescribes.
    ``ground_visual`` is what the ground is drawn as, as ``Body.visual`` of bodies.

    ``parameters`` are the named numbers that a file's expressions were computed with, ``source``
    is what ``reader.with_parameters`` computes them with others from, ``tree`` states which joints
    the program chose to cut (``between.ChosenTree``); none of these makes two mechanisms differ.

    Axes and places that agree to ``tolerance``, sines of angles and shares of the longest distance
    on any body, are taken as parallel, at right angles or meeting; ``rounded`` has notes of those.
    """

    name: str
    bodies: Tuple[Body, ...]
    joints: Tuple[Joint, ...]
    cut_joints: Tuple[CutJoint, ...] = ()
    points: Tuple[Point, ...] = ()
    description: str = ''
    couplings: Tuple[Coupling, ...] = ()
    parameters: dict = field(default_factory=dict, compare=False, repr=False)
    source: Any = field(default=None, compare=False, repr=False)
    tree: Any = field(default=None, compare=False, repr=False)
    motions: Tuple[DrivingConstraint, ...] = ()
    ground_visual: Tuple[Visual, ...] = field(default=(), compare=False)
    tolerance: float = field(default=TOLERANCE, compare=False, repr=False)
    rounded: Tuple[str, ...] = field(default=(), compare=False, repr=False)

    def __repr__(self) -> str:
        """Show the sizes, and which joints are actuated."""
        return (f'<Mechanism {self.name}: {len(self.bodies)} bodies, {len(self.joints)} joints, '
                f'{len(self.cut_joints)} cut joints, actuated: '
                f'{", ".join(self.actuated_joints) or "nothing"}>')

    # Set by validation.checked; a copy with other values has not been checked.
    valid = False

    @cached_property
    def joint_names(self) -> Tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def coordinates(self) -> Coordinates:
        """Names and places of the numbers of a state, a ``coordinates.Coordinates``."""
        return Coordinates(self.joints)

    def point(self, name: str) -> Point:
        """Return the named point of a name that there is."""
        return next(point for point in self.points if point.name == name)

    def cut_joint(self, name: str) -> Optional[CutJoint]:
        """Return the cut joint of a name; None where no cut joint has it."""
        return next((cut for cut in self.cut_joints if cut.name == name), None)

    @cached_property
    def closures(self) -> Tuple[Union[CutJoint, Coupling, DrivingConstraint], ...]:
        """Return cut joints and couplings, in the order of the multipliers."""
        return (*self.cut_joints, *self.couplings, *self.motions)

    @cached_property
    def actuated_joints(self) -> Tuple[str, ...]:
        """
        Names of the actuated joints' freedoms, in the order of qd: ``crank``, ``hip.1``.

        Behind them those of actuated cut joints.
        """
        return (*(self.coordinates.names[place] for place in self.coordinates.actuated),
                *(self.cut_coordinates.names[place] for place in self.cut_coordinates.actuated))

    @cached_property
    def measured_types(self) -> Tuple[str, ...]:
        """Return the types of cut joints that have coordinates."""
        return MEASURED if self.planar else SPATIAL_MEASURED

    @cached_property
    def cut_coordinates(self) -> Coordinates:
        """Names and places of the coordinates of cut joints, as ``coordinates``."""
        return Coordinates([cut for cut in self.cut_joints if cut.type in self.measured_types])

    @cached_property
    def measured_cuts(self) -> Tuple[str, ...]:
        """Names of the freedoms of cut joints that have one number each."""
        return self.cut_coordinates.single_names

    @cached_property
    def turning_cuts(self) -> Tuple[str, ...]:
        """Names of those of them that turn in space, where turns are counted one by one."""
        if self.planar:
            return ()
        threads = [cut.name for cut in self.cut_joints if cut.type == HELICAL]
        known = self.cut_coordinates
        return tuple(known.names[place] for place in known.single
                     if not known.lengths[place] and known.names[place] not in threads)

    @cached_property
    def planar(self) -> bool:
        """Whether this is a mechanism in the plane: vectors of two numbers."""
        return len(self.bodies[0].center_of_mass) == 2

    @property
    def number_of_equations(self) -> int:
        """Return nc, the number of closure equations; in space with those that always hold."""
        equations = CUT_JOINT_EQUATIONS if self.planar else SPATIAL_CUT_JOINT_EQUATIONS
        return (sum(equations[cut.type] for cut in self.cut_joints)
                + len(self.couplings) + len(self.motions))
