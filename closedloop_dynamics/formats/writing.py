# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Common parts of the writers of MJCF, URDF and SDF.

A joint of several freedoms that a format does not have becomes several of one freedom, with links
without mass between them; they are called ``JOINT_1``, ``JOINT_2``. What a format cannot say
at all is refused.
"""

from dataclasses import replace
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from .in_space import X, Y, Z
from .model import NO_LIMIT
from .pose import Pose, pose_from
from ..mechanism.coordinates import WITH_ORIENTATION
from ..mechanism.couplings import measured
from ..mechanism.kinematics import moved_by
from ..mechanism.mechanism import (
    CYLINDRICAL, FIXED, FREE, HELICAL, JOINT_FREEDOMS, MechanismError, PLANAR, PRISMATIC, REVOLUTE,
    SPHERICAL, UNIVERSAL, UNTURNED)
from ..mechanism.rotations import about, of_quaternion

# Effects on joints that formats have, and the key of the number of each.
JOINT_EFFECTS = {
    'joint_damping': 'coefficient', 'joint_friction': 'coulomb', 'joint_spring': 'stiffness'}
# What formats do not have of others.
BEYOND = {'joint_friction': 'beyond its Coulomb part',
          'rotor': 'beyond its reflected inertia',
          'actuator': ('beyond its largest torque', 'beyond its largest torque and speed')}
# Gear ratio from which the turning of a rotor's carrier does not count.
ENDLESS = 1e9
# Distance of two balls that replace a hinge where a loop is closed [m].
APART = 0.1


class Single(NamedTuple):
    """A joint of a chain that replaces another: one degree of freedom, a ball or fixed."""

    name: str
    type: str  # noqa: A003
    axis: tuple = None


def chain(mechanism, joint, balls):
    """Return the chain of joints equivalent to a joint, with balls where the format has them."""
    slides = [(PRISMATIC, axis) for axis in (X, Y, Z)]
    ball = [(SPHERICAL, None)] if balls else [(REVOLUTE, axis) for axis in (X, Y, Z)]
    kinds = {
        REVOLUTE: [(REVOLUTE, joint.axis)], PRISMATIC: [(PRISMATIC, joint.axis)],
        UNIVERSAL: [(REVOLUTE, joint.axis), (REVOLUTE, joint.second_axis)],
        CYLINDRICAL: [(REVOLUTE, joint.axis), (PRISMATIC, joint.axis)],
        HELICAL: [(REVOLUTE, joint.axis), (PRISMATIC, joint.axis)],
        PLANAR: [*slides[:2], (REVOLUTE, Z)], SPHERICAL: ball,
        FREE: [*slides, *ball] if balls else [(FREE, None)],
        FIXED: [] if balls else [(FIXED, None)]}[joint.type]
    if joint.type == HELICAL:
        names = [joint.name, f'{joint.name}_slide']
    elif len(kinds) == 1:
        names = [joint.name]
    else:
        names = [f'{joint.name}_{number + 1}' for number in range(len(kinds))]
    taken = {other.name for other in mechanism.joints if other is not joint}
    for name in names:
        if name in taken:
            raise MechanismError(f'{mechanism.name}: joints.{name}: expected another name, this '
                                 f'one is needed for a part of {joint.name}')
    return [Single(name, *kind) for name, kind in zip(names, kinds)]


class JointEffects:
    """
    Effects in the one-freedom joints by which a format represents a mechanism's joints.

    A writer takes from it what its format has a word for; the rest is left.

    Parameters
    ----------
    mechanism : Mechanism
        With couplings and effects in joints of its tree alone.
    effects : dict of str to dict or None
        Keys of effects, by name.
    singles : callable
        Returns the single joints of a joint.
    limits : dict of str to tuple of 2, optional
        Least and largest coordinate of joints of one degree of freedom, None where there is none.

    Attributes
    ----------
    freedoms : dict of str to tuple (str, sequence of int, int)
        By the name of a freedom, and of a joint with an orientation, whose turns are meant: the
        single joint that has it, its places there, and of how many.
    left : dict of str to str
        Names of effects that nothing was written for, and of those of which something is not
        written, with what that is.

    Raises
    ------
    MechanismError
        Where something acts at a cut joint, which is not a joint of other formats.

    """

    def __init__(self, mechanism, effects, singles, limits=None):
        _refuse_cuts(mechanism, effects)
        self._limits = limits or {}
        self._at, self.left, self.freedoms = {}, {}, {}
        for joint in mechanism.joints:
            names = list(mechanism.coordinates.names[mechanism.coordinates.rates[joint.name]])
            for single in singles(joint):
                count = JOINT_FREEDOMS[single.type]
                self.freedoms.update((name, (single.name, (place,), count))
                                     for place, name in enumerate(names[:count]))
                if single.type in WITH_ORIENTATION:
                    self.freedoms[single.name] = single.name, range(count - 3, count), count
                names = names[count:]
        for name, values in (effects or {}).items():
            if values['type'] == 'gravity':
                continue
            self.left[name] = ''
            if values.get('joint') in self.freedoms:
                single, places, count = self.freedoms[values['joint']]
                rows = self._at.setdefault(single, {}).setdefault(values['type'], count * [None])
                for place in places:
                    rows[place] = rows[place] or (name, values)

    def limits(self, single):
        """Return least and largest coordinate of a single joint; None where neither is limited."""
        found = self._limits.get(single, (None, None))
        return None if found == (None, None) else tuple(
            end if one is None else one for one, end in zip(found, (-NO_LIMIT, NO_LIMIT)))

    def drive(self, single, speeds):
        """
        Return the largest torque and speed of the drive of a single joint by name, None for none.

        ``speeds``: whether the format has largest speeds.
        """
        pair = self._at.get(single, {}).get('actuator', [None])[0]
        if pair is None:
            return None, None
        name, values = pair
        torque, speed = values.get('max_torque'), values.get('max_speed')
        del self.left[name]
        if values.get('lag') or values.get('delay') or speed is not None and not speeds:
            self.left[name] = BEYOND['actuator'][speeds]
        return torque, speed

    def each(self, single, kind):
        """Return the keys of the effect of a type in each freedom of a single; None for none."""
        found = self._at.get(single, {}).get(kind, ())
        for name, values in filter(None, found):
            self.left.pop(name, None)
            more = {'joint_friction': values.get('friction_coefficient', 0.0) > 0.0
                    or values.get('static_ratio', 1.0) > 1.0,
                    'rotor': abs(values.get('gear_ratio', 1.0)) < ENDLESS}.get(kind)
            if more:
                self.left[name] = BEYOND[kind]
        return [pair and pair[1] for pair in found]

    def same(self, single, kind):
        """Return the keys of the effect of a type that is the same in all freedoms of a single."""
        found = [pair and {key: value for key, value in pair[1].items() if key != 'joint'}
                 for pair in self._at.get(single, {}).get(kind, ())]
        return self.each(single, kind)[0] if found and all(
            one is not None and one == found[0] for one in found) else None


def _refuse_cuts(mechanism, effects):
    for coupling in mechanism.couplings:
        for cut in measured(mechanism, coupling):
            raise MechanismError(
                f'{mechanism.name}: couplings.{coupling.name}: expected joints of the tree, to '
                f'write it in this format, got {cut.name}, which closes a loop; cut another joint '
                'of that loop')
    named = {mechanism.coordinates.joint_of(values['joint'])
             for values in (effects or {}).values() if values.get('joint')}
    for cut in mechanism.cut_joints:
        if cut.actuated or cut.name in named:
            raise MechanismError(
                f'{mechanism.name}: cut_joints.{cut.name}: expected no drive and no effect where '
                'a loop is closed, to write it in this format; cut another joint of that loop')


def reflected(values):
    """Return the inertia that the joint of a rotor sees [kg m^2; kg]."""
    return values['inertia'] * values.get('gear_ratio', 1.0) ** 2


def mimics_of(mechanism, format_name):
    """Return by joint the other one that it mimics, the factor and the offset."""
    found = {}
    for coupling in mechanism.couplings:
        if coupling.law is not None:
            raise MechanismError(
                f'{mechanism.name}: couplings.{coupling.name}.law: expected none to write '
                f'{format_name}, whose couplings are linear')
        names = [name for name in coupling.joints if name not in found]
        if len(coupling.joints) != 2 or not names:
            raise MechanismError(
                f'{mechanism.name}: couplings.{coupling.name}: expected two joints, one of which '
                f'follows from no other coupling, to write {format_name}, got '
                f'{", ".join(coupling.joints)}')
        name = names[0]
        other, = (one for one in coupling.joints if one != name)
        factor = coupling.joints[name]
        found[name] = other, -coupling.joints[other] / factor, coupling.offset / factor
    return found


def gravity_of(effects):
    """Return the acceleration of all gravity among effects, shape (3,) [m/s^2]."""
    total = np.zeros(3)
    for values in (effects or {}).values():
        if values['type'] == 'gravity':
            total[:len(values['acceleration'])] += values['acceleration']
    return total


def drawn(single, joint, q):
    """
    Return where a single joint's frame is in the one before it, and its child in that.

    ``q``: coordinates of the single joint, which stands for a part of ``joint`` [rad or m].
    """
    frame, child, after = np.eye(3), np.eye(3), np.zeros(3)
    if single.type == SPHERICAL:
        frame = of_quaternion(q)
    elif single.type == UNIVERSAL:
        frame, child = about(joint.axis, q[0]), about(joint.second_axis, q[1])
    elif single.type in (REVOLUTE, HELICAL):
        child = about(single.axis, q[0])
        if single.type == HELICAL:
            after = joint.lead * q[0] * np.array(single.axis)
    elif single.type == PRISMATIC:
        after = q[0] * np.array(single.axis)
    return Pose(frame, np.zeros(3)), Pose(child, after)


def moved(joint, q):
    """Return the pose of a joint's child in its frame, at its coordinates [rad or m]."""
    return pose_from(moved_by(np.array((0.0, 0.0, 0.0, *UNTURNED)), joint, np.asarray(q)))


def counted_from(mechanism, start):
    """Return a mechanism with couplings offset by start coordinates, shape (nq,)."""
    places = mechanism.coordinates
    zero = {joint.name: start[places.coordinates[joint.name]][0] for joint in mechanism.joints
            if JOINT_FREEDOMS[joint.type] == 1}
    return replace(mechanism, couplings=tuple(replace(
        one, offset=one.offset - sum(factor * zero[name] for name, factor in one.joints.items()))
        for one in mechanism.couplings))


def moments_of(body):
    """Return the moments of inertia of a body in space, in the order of ``model.MOMENTS``."""
    return (*body.inertia, 0.0, 0.0, 0.0)[:6]


def numbers(*values):
    """Write numbers with all their digits; whole ones without a point."""
    return ' '.join(repr(float(value)).removesuffix('.0') for value in values)


def written(root):
    """Return an element as indented text."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'
