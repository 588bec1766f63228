# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A machine as model formats describe it, before it becomes a mechanism.

Links have frames of their own choice and joints join any two of them, in loops, too. Readers of
formats fill these records; ``building.mechanism_of`` chooses a tree and writes a Mechanism, and
the writers of formats start from them again.
"""

from dataclasses import dataclass, field
import math
from typing import Optional

import numpy as np

from .pose import IDENTITY, Pose
from ..mechanism.coordinates import QUANTITIES
from ..mechanism.fields import among, nearest
from ..mechanism.mechanism import FIXED, GROUND, JOINT_FREEDOMS, MechanismError

# Moments of inertia, as URDF and SDF call them.
MOMENTS = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
# Standard gravity of formats that leave it to the simulator [m/s^2].
GRAVITY = (0.0, 0.0, -9.81)
# Limits of coordinates and drives from here on limit nothing [SI units].
NO_LIMIT = 1e9
# Why geometry for contacts is left out.
NO_CONTACTS = 'bodies pass through each other'
# Units of what acts against joints, and along tendons: of turns and of slides.
UNITS = {'damping': ('N m s/rad', 'N s/m'), 'friction': QUANTITIES['effort'],
         'armature': ('kg m^2', 'kg'), 'stiffness': ('N m/rad', 'N/m')}
# By unit of a moment about an axis: the power of the lever by which it becomes a force.
LEVERS = {'N m': 1, 'N m/rad': 2, 'N m s/rad': 2, 'kg m^2': 2, 'N m/rad^2': 3,
          'N m s^2/rad^2': 3}


def free_name(name, taken):
    """Return a name, with as many underscores behind it as make it none of those taken."""
    while name in taken:
        name += '_'
    return name


@dataclass
class Link:
    """A rigid body as a format has it."""

    name: str
    where: str = ''  # File, line and element, for messages
    mass: float = 0.0  # [kg], zero or more
    #: Shape (3,): Centre of mass in the link's frame [m].
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    #: Shape (3, 3): About the centre of mass, along the axes of the link's frame [kg m^2].
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    #: Shapes that it is drawn as, in the link's frame (list of mechanism.Visual).
    visual: list = field(default_factory=list)
    #: The share of its weight that is compensated; 1 where gravity does not act on it.
    carried: float = 0.0

    def lifted(self, gravity):
        """Return the force at its centre of mass that compensates its weight, shape (3,) [N]."""
        return -self.carried * self.mass * np.array(gravity)


@dataclass
class Connection:
    """A joint between two links, in a tree or closing a loop."""

    name: str
    #: One of ``mechanism.JOINT_FREEDOMS``.
    type: str  # noqa: A003
    #: ``parent``, ``child``: Links, or ``'ground'``.
    parent: str
    child: str
    where: str = ''  # File, line and element, for messages
    #: ``in_parent``, ``in_child``: The joint's frame in the frames of both links; they agree at q
    #: = 0.
    in_parent: Pose = IDENTITY
    in_child: Pose = IDENTITY
    #: Shape (3,), or None: In the joint's frame; of a universal joint the one fixed in the parent,
    #: of a planar joint the plane's normal.
    axis: Optional[np.ndarray] = None
    #: Shape (3,), or None: In the joint's frame in the child, where it differs from ``axis``; the
    #: second axis of a universal joint.
    child_axis: Optional[np.ndarray] = None
    lead: Optional[float] = None  # Of a helical joint [m/rad]
    closes: bool = False  # Whether it must not be a joint of the tree
    actuated: Optional[bool] = None  # None where the format does not give it
    #: ``damping``, ``friction``, ``armature``, ``stiffness``, ``rest``: Zero where there is none;
    #: SI units. One number of a joint of several freedoms is that of each, a tuple has one for
    #: each.
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    #: ``lower``, ``upper``, ``effort``, ``speed``: Limits of the coordinate, of the drive and of
    #: the rate; None where there is none.
    lower: Optional[float] = None
    upper: Optional[float] = None
    effort: Optional[float] = None
    speed: Optional[float] = None
    #: Coordinate that the machine starts from; of a joint with an orientation all of them, zero
    #: where it starts as it is drawn (float or tuple of floats).
    start: object = 0.0


@dataclass
class Relation:
    """A linear equation between coordinates of joints."""

    name: str
    where: str  # File, line and element, for messages
    #: By joint; the sum of coordinates times factors is ``offset`` (dict of str to float).
    factors: dict
    offset: float = 0.0
    follower: Optional[str] = None  # The joint that mimics the other one
    #: What is added to ``offset``: a joint, and the coefficients of a polynomial of its coordinate
    #: from the lowest on (tuple of str and tuple of floats, or None).
    law: Optional[tuple] = None


@dataclass
class Spring:
    """A spring and damper along the line between two places on links."""

    name: str
    ends: tuple  # Links, or ``'ground'``, and poses on them (tuple of 2 tuples (str, Pose))
    #: ``stiffness``, ``damping``, ``rest``: [N/m], [N s/m], free length [m].
    stiffness: float
    damping: float
    rest: float


@dataclass
class Rope:
    """A rope: it pulls along straight lines between places on links when stretched."""

    name: str
    #: Links, or ``'ground'``, and poses on them, two or more (tuple of tuples (str, Pose)).
    ends: tuple
    length: float  # Free of force up to it [m]
    #: [N/m]; None where the length is a limit, of whatever stiffness is asked for.
    stiffness: Optional[float] = None


@dataclass
class Belt:
    """A tendon along a weighted sum of coordinates of joints with one degree of freedom."""

    name: str
    arms: dict  # By joint (dict of str to float)
    #: ``stiffness``, ``damping``: Coefficients of the first, second, ... power of stretch and
    #: rate; SI units (tuple of floats).
    stiffness: tuple = ()
    damping: tuple = ()
    #: Least and largest sum without a force of the spring (tuple of 2 floats).
    rest: tuple = (0.0, 0.0)
    #: Whether the ends of ``rest`` are limits, of whatever stiffness is asked for.
    limit: bool = False
    #: ``friction``, ``inertia``: Dry friction and inertia along the sum; SI units.
    friction: float = 0.0
    inertia: float = 0.0


@dataclass
class Drag:
    """Drag of a fluid at a link's centre of mass, along and about three axes."""

    link: str
    rotation: np.ndarray  # Shape (3, 3): The axes as columns in the link's frame
    #: ``linear``, ``quadratic``, ``turning_linear``, ``turning_quadratic``: As of the effect
    #: ``fluid_drag`` (tuple of 3 floats).
    linear: tuple
    quadratic: tuple
    turning_linear: tuple
    turning_quadratic: tuple
    flow: tuple  # Velocity of the fluid [m/s] (tuple of 3 floats)


@dataclass(frozen=True)
class Omission:
    """Something that moves bodies and is left out."""

    quantity: str  # Such as ``'damping'``
    #: ``kind``, ``name``: Of the element: ``'tendon'`` and its name in the file.
    kind: str
    name: str
    reason: str
    #: How much; the largest of several numbers. Infinite where there is no number.
    size: float = math.inf
    unit: str = ''  # Of the size

    def force(self, lever):
        """Return its force where something moves by 1 m, 1 m/s or 1 m/s^2 at a lever [N]."""
        return self.size / lever ** LEVERS.get(self.unit, 0)


@dataclass(frozen=True)
class ReadOptions:
    """Options of the reader of a file."""

    model: Optional[str] = None  # Which one of several models of a world is simulated
    arguments: dict = field(default_factory=dict)  # Of xacro (dict of str to str)
    anywhere: bool = False  # Whether meshes and parts are read from outside of the file's folder
    ignore: tuple = ()  # Elements that would be refused, and are left out (tuple of str)


@dataclass
class Model:
    """A machine as a format has it."""

    name: str
    path: object  # The file (pathlib.Path)
    links: dict = field(default_factory=dict)  # Without the ground (dict of str to Link)
    joints: dict = field(default_factory=dict)  # In the file's order (dict of str to Connection)
    relations: list = field(default_factory=list)  # List of Relation
    springs: list = field(default_factory=list)  # List of Spring
    ropes: list = field(default_factory=list)  # List of Rope
    belts: list = field(default_factory=list)  # List of Belt
    drags: list = field(default_factory=list)  # List of Drag
    #: Named frames on links, or on ``'ground'`` (dict of str to tuple (str, Pose)).
    frames: dict = field(default_factory=dict)
    #: Shapes drawn beside the links, in the frame of the ground (list of mechanism.Visual).
    ground_visual: list = field(default_factory=list)
    gravity: tuple = GRAVITY  # [m/s^2] (tuple of 3 floats)
    #: Elements that affect the motion and have no counterpart in a mechanism (list of Omission).
    omitted: list = field(default_factory=list)
    #: Other elements of the file, with the reason why they are left out (dict of str to str).
    ignored: dict = field(default_factory=dict)

    def add(self, record):
        """Add a link or a joint; raise MechanismError where another has its name."""
        section = self.links if isinstance(record, Link) else self.joints
        if record.name in section:
            raise MechanismError(
                f'{record.where}: expected every name once, got {record.name!r} again, first '
                f'given at {section[record.name].where}')
        section[record.name] = record

    def mimic(self, element, follower, leader, factor, offset):
        """
        Couple a joint with another one: its coordinate is ``factor`` times that plus ``offset``.

        What the model has already is not added again. MechanismError where ``element``, which asks
        for it, names no joint, the joint itself or another factor than before.
        """
        for name in (follower, leader):
            if name not in self.joints:
                raise element.error('the name of a joint', repr(name),
                                    nearest(name, self.joints))
        if follower == leader:
            raise element.error('another joint', 'the joint itself')
        if factor == 0.0:
            raise element.error('a multiplier that is not zero', '0')
        if self.joints[follower].type == FIXED:
            self.ignored[f'what {follower} mimics'] = 'it is fixed'
            return
        new = Relation(f'{follower}_mimics_{leader}', element.where,
                       {follower: 1.0, leader: -factor}, offset, follower)
        for known in self.relations:
            if known.name == new.name:
                if (known.factors, known.offset) != (new.factors, new.offset):
                    raise element.error(f'the multiplier and offset that {known.where} has',
                                        'others')
                return
        self.relations.append(new)

    @property
    def followers(self):
        """Return the names of the joints that mimic others, a set of str."""
        return {relation.follower for relation in self.relations} - {None}

    def link_name(self, name, names):
        """Return the name of a link among those of the file: not that of the ground."""
        if name != GROUND:
            return name
        new = free_name(f'{GROUND}_link', names)
        self.ignored[f'the name {GROUND} of a link, {new} taken'] = f'{GROUND} is the world'
        return new

    def frame(self, name, where):
        """
        Return the link and the pose on it of a frame, or of a link, by its name.

        Raises MechanismError where there is neither.
        """
        if name in self.frames:
            return self.frames[name]
        if name in self.links or name == GROUND:
            return name, IDENTITY
        known = [*self.links, *self.frames]
        raise MechanismError(
            f'{where}: expected the name of a link or frame, got {name!r}'
            f' ({nearest(name, known) or "there are " + among(known)})')

    def ignore(self, counts, reasons):
        """Count omissions with the reason of their kind."""
        self.ignored.update({
            f'{count} {what}' if count > 1 else what: reasons.get(what, 'not known to this reader')
            for what, count in counts.items()})

    def check(self):
        """Raise MechanismError for joints of links that do not exist, and of unknown types."""
        for joint in self.joints.values():
            for link in (joint.parent, joint.child):
                if link not in self.links and link != GROUND:
                    self.frame(link, joint.where)
                    raise MechanismError(f'{joint.where}: expected the name of a link, got that '
                                         f'of the frame {link!r}')
            if joint.type not in JOINT_FREEDOMS:
                raise MechanismError(f'{joint.where}: expected a joint of a known type, got '
                                     f'{joint.type!r}')
