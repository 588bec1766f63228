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
from ..mechanism.fields import among, nearest
from ..mechanism.mechanism import GROUND, JOINT_FREEDOMS, MechanismError

# Moments of inertia, as URDF and SDF call them.
MOMENTS = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
# Standard gravity of formats that leave it to the simulator [m/s^2].
GRAVITY = (0.0, 0.0, -9.81)
# Limits of coordinates and drives from here on are none [SI units].
NO_LIMIT = 1e9
# Why geometry for contacts is left out.
NO_CONTACTS = 'bodies pass through each other'
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
    """
    A rigid body as a format has it.

    Attributes
    ----------
    name : str
    where : str
        File, line and element, for messages.
    mass : float
        [kg], zero or more.
    center : ndarray, shape (3,)
        Centre of mass in the link's frame [m].
    inertia : ndarray, shape (3, 3)
        About the centre of mass, along the axes of the link's frame [kg m^2].
    visual : list of mechanism.Visual
        Shapes that it is drawn as, in the link's frame.
    carried : float
        The share of its weight that is compensated; 1 where gravity does not act on it.

    """

    name: str
    where: str = ''
    mass: float = 0.0
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    visual: list = field(default_factory=list)
    carried: float = 0.0

    def lifted(self, gravity):
        """Return the force at its centre of mass that compensates its weight, shape (3,) [N]."""
        return -self.carried * self.mass * np.array(gravity)


@dataclass
class Connection:
    """
    A joint between two links, in a tree or closing a loop.

    Attributes
    ----------
    name : str
    type : str
        One of ``mechanism.JOINT_FREEDOMS``.
    parent, child : str
        Links, or ``'ground'``.
    where : str
        File, line and element, for messages.
    in_parent, in_child : Pose
        The joint's frame in the frames of both links; they agree at q = 0.
    axis : ndarray, shape (3,), or None
        In the joint's frame; of a universal joint the one fixed in the parent, of a planar joint
        the plane's normal.
    child_axis : ndarray, shape (3,), or None
        In the joint's frame in the child, where it differs from ``axis``; the second axis of a
        universal joint.
    lead : float or None
        Of a helical joint [m/rad].
    closes : bool
        Whether it must not be a joint of the tree.
    actuated : bool or None
        None where the format does not give it.
    damping, friction, armature, stiffness, rest : float or tuple of floats
        Zero where there is none; SI units. One number of a joint of several freedoms is that of
        each, a tuple has one for each.
    lower, upper, effort, speed : float or None
        Limits of the coordinate, of the drive and of the rate; None where there is none.
    start : float or tuple of floats
        Coordinate that the machine starts from; of a joint with an orientation all of them, zero
        where it starts as it is drawn.

    """

    name: str
    type: str  # noqa: A003
    parent: str
    child: str
    where: str = ''
    in_parent: Pose = IDENTITY
    in_child: Pose = IDENTITY
    axis: Optional[np.ndarray] = None
    child_axis: Optional[np.ndarray] = None
    lead: Optional[float] = None
    closes: bool = False
    actuated: Optional[bool] = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    lower: Optional[float] = None
    upper: Optional[float] = None
    effort: Optional[float] = None
    speed: Optional[float] = None
    start: object = 0.0


@dataclass
class Relation:
    """
    A linear equation between coordinates of joints.

    Attributes
    ----------
    name : str
    where : str
        File, line and element, for messages.
    factors : dict of str to float
        By joint; the sum of coordinates times factors is ``offset``.
    offset : float

    """

    name: str
    where: str
    factors: dict
    offset: float = 0.0


@dataclass
class Spring:
    """
    A spring and damper along the line between two places on links.

    Attributes
    ----------
    name : str
    ends : tuple of 2 tuples (str, Pose)
        Links, or ``'ground'``, and poses on them.
    stiffness, damping, rest : float
        [N/m], [N s/m], free length [m].

    """

    name: str
    ends: tuple
    stiffness: float
    damping: float
    rest: float


@dataclass
class Rope:
    """
    A rope: it pulls along straight lines between places on links when stretched.

    Attributes
    ----------
    name : str
    ends : tuple of tuples (str, Pose)
        Links, or ``'ground'``, and poses on them, two or more.
    length : float
        Free of force up to it [m].
    stiffness : float or None
        [N/m]; None where the length is a limit, of whatever stiffness is asked for.

    """

    name: str
    ends: tuple
    length: float
    stiffness: Optional[float] = None


@dataclass
class Belt:
    """
    A tendon along a weighted sum of coordinates of joints with one degree of freedom.

    Attributes
    ----------
    name : str
    arms : dict of str to float
        By joint.
    stiffness, damping : tuple of floats
        Coefficients of the first, second, ... power of stretch and rate; SI units.
    rest : tuple of 2 floats
        Least and largest sum without a force of the spring.
    limit : bool
        Whether the ends of ``rest`` are limits, of whatever stiffness is asked for.
    friction, inertia : float
        Dry friction and inertia along the sum; SI units.

    """

    name: str
    arms: dict
    stiffness: tuple = ()
    damping: tuple = ()
    rest: tuple = (0.0, 0.0)
    limit: bool = False
    friction: float = 0.0
    inertia: float = 0.0


@dataclass
class Drag:
    """
    Drag of a fluid at a link's centre of mass, along and about three axes.

    Attributes
    ----------
    link : str
    rotation : ndarray, shape (3, 3)
        The axes as columns in the link's frame.
    linear, quadratic, turning_linear, turning_quadratic : tuple of 3 floats
        As of the effect ``fluid_drag``.
    flow : tuple of 3 floats
        Velocity of the fluid [m/s].

    """

    link: str
    rotation: np.ndarray
    linear: tuple
    quadratic: tuple
    turning_linear: tuple
    turning_quadratic: tuple
    flow: tuple


@dataclass(frozen=True)
class Omission:
    """
    Something that moves bodies and is left out.

    Attributes
    ----------
    quantity : str
        Such as ``'damping'``.
    kind, name : str
        Of the element: ``'tendon'`` and its name in the file.
    reason : str
    size : float
        How much; the largest of several numbers. Infinite where there is no number.
    unit : str
        Of the size.

    """

    quantity: str
    kind: str
    name: str
    reason: str
    size: float = math.inf
    unit: str = ''

    def force(self, lever):
        """Return its force where something moves by 1 m, 1 m/s or 1 m/s^2 at a lever [N]."""
        return self.size / lever ** LEVERS.get(self.unit, 0)


@dataclass(frozen=True)
class ReadOptions:
    """
    Options of the reader of a file.

    Attributes
    ----------
    model : str or None
        Which one of several models of a world is simulated.
    arguments : dict of str to str
        Of xacro.
    anywhere : bool
        Whether meshes and parts are read from outside of the file's folder.

    """

    model: Optional[str] = None
    arguments: dict = field(default_factory=dict)
    anywhere: bool = False


@dataclass
class Model:
    """
    A machine as a format has it.

    Attributes
    ----------
    name : str
    path : pathlib.Path
        The file.
    links : dict of str to Link
        Without the ground.
    joints : dict of str to Connection
        In the file's order.
    relations : list of Relation
    springs : list of Spring
    ropes : list of Rope
    belts : list of Belt
    drags : list of Drag
    frames : dict of str to tuple (str, Pose)
        Named frames on links, or on ``'ground'``.
    ground_visual : list of mechanism.Visual
        Shapes drawn beside the links, in the frame of the ground.
    gravity : tuple of 3 floats
        [m/s^2].
    omitted : list of Omission
        Elements that affect the motion and have no counterpart in a mechanism.
    ignored : dict of str to str
        Other elements of the file, with the reason why they are left out.

    """

    name: str
    path: object
    links: dict = field(default_factory=dict)
    joints: dict = field(default_factory=dict)
    relations: list = field(default_factory=list)
    springs: list = field(default_factory=list)
    ropes: list = field(default_factory=list)
    belts: list = field(default_factory=list)
    drags: list = field(default_factory=list)
    frames: dict = field(default_factory=dict)
    ground_visual: list = field(default_factory=list)
    gravity: tuple = GRAVITY
    omitted: list = field(default_factory=list)
    ignored: dict = field(default_factory=dict)

    def add(self, record):
        """Add a link or a joint; raise MechanismError where another has its name."""
        section = self.links if isinstance(record, Link) else self.joints
        if record.name in section:
            raise MechanismError(
                f'{record.where}: expected every name once, got {record.name!r} again, first '
                f'given at {section[record.name].where}')
        section[record.name] = record

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
