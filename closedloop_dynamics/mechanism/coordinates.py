# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Names and places of the numbers of a state: coordinates q and rates qd, by joint.

Joints come in the mechanism's order. A joint of one freedom has one coordinate and one rate, both
called by its name. A universal or cylindrical joint has two, called ``JOINT.1`` and ``JOINT.2``, a
planar one ``JOINT.x``, ``JOINT.y`` and ``JOINT.angle``, a pin in a slot, which is not a joint of a
tree, ``JOINT.x`` and ``JOINT.angle``. The orientation of a spherical or free
joint is a unit quaternion x, y, z, w of the child's axes in the joint's frame; its rates are the
angular velocity relative to the parent, about the child's axes. A free joint has its position x,
y, z along the axes of the joint's frame before. So nq = nv + the number of quaternions.
"""

from typing import NamedTuple

import numpy as np

from .checks import number, orientation, UNIT_NORM, vector3
from .fields import at, FieldError, mapping
from .rotations import composed, CONJUGATE, quaternion_of_vector

REVOLUTE = 'revolute'
PRISMATIC = 'prismatic'
FIXED = 'fixed'
HELICAL = 'helical'
CYLINDRICAL = 'cylindrical'
UNIVERSAL = 'universal'
SPHERICAL = 'spherical'
PLANAR = 'planar'
FREE = 'free'
POINT_ON_LINE = 'point_on_line'
# Joints with an orientation in three dimensions.
WITH_ORIENTATION = (SPHERICAL, FREE)

# Numbers of a joint that has several: suffix of the name, and whether it is a length.
_NUMBERS = {
    REVOLUTE: (('', False),), PRISMATIC: (('', True),), HELICAL: (('', False),),
    UNIVERSAL: (('.1', False), ('.2', False)), CYLINDRICAL: (('.1', False), ('.2', True)),
    PLANAR: (('.x', True), ('.y', True), ('.angle', False)),
    POINT_ON_LINE: (('.x', True), ('.angle', False)), FIXED: (), SPHERICAL: (),
    FREE: (('.x', True), ('.y', True), ('.z', True))}
# Freedoms of a rotation, behind the name of its joint.
_TURNS = ('.rx', '.ry', '.rz')
# Units of a state's quantities, of turns and of slides.
QUANTITIES = {'position': ('rad', 'm'), 'velocity': ('rad/s', 'm/s'),
              'acceleration': ('rad/s^2', 'm/s^2'), 'effort': ('N m', 'N')}
# Where it may be one or the other: ``rad or m``.
EITHER = {quantity: ' or '.join(units) for quantity, units in QUANTITIES.items()}
# Their names for a rotation.
OF_ROTATIONS = {'position': 'orientation', 'velocity': 'angular_velocity',
                'acceleration': 'angular_acceleration', 'effort': 'torque'}
# The part of a quantity of a free joint that is not a rotation has the quantity's own name.
_CHECKS = {'position': orientation, 'velocity': vector3}


class Group(NamedTuple):
    """Numbers of a joint that belong together: one number, a place, or an orientation."""

    name: str  # ``crank``, ``hip.1``, ``platform.position``, ``ball.orientation``
    joint: object  # Mechanism.Joint
    #: ``coordinates``, ``rates``: Their places (list of int).
    coordinates: list
    rates: list
    length: bool  # Whether they are lengths

    @property
    def turned(self):
        """Whether this is an orientation."""
        return len(self.coordinates) == 4


class Coordinates:
    """
    Names and places of the coordinates and rates of some joints.

    Parameters
    ----------
    joints : sequence of mechanism.Joint
        In their order.

    Attributes
    ----------
    nq, nv : int
        How many coordinates and rates there are.
    names : tuple of str, length nv
        Of the freedoms: ``crank``, ``hip.1``, ``ball.rx``.
    index : dict of str to int
        Their places among the rates.
    actuated : tuple of int
        Places among the rates of the freedoms of actuated joints.
    lengths : ndarray of bool, shape (nv,)
        Which of them are lengths.
    place : ndarray of int, shape (nv,)
        Where among the coordinates the number of each freedom is; -1 for rotations.
    rates, coordinates : dict of str to slice
        By joint.
    balls : ndarray of int, shape (number of quaternions, 2)
        First coordinate and first rate of each.
    keys : tuple of str
        By which values are given: names of single freedoms, and of joints with an orientation.
    single : ndarray of int
        Places among the rates of the freedoms of all other joints than those with an orientation.
    with_orientation : tuple of str
        Names of the spherical and free joints.
    pose, twist : ndarray of int, shape (number of them, 7), (number of them, 6)
        Where in q their x, y, z and quaternion are, in qd their velocity and angular velocity;
        -1 for entries that a spherical joint does not have.

    """

    def __init__(self, joints):
        self._joints = {joint.name: joint for joint in joints}
        names, keys, actuated, lengths, place, balls = [], [], [], [], [], []
        self.rates, self.coordinates, self.nq = {}, {}, 0
        for joint in joints:
            first, coordinate = len(names), self.nq
            for suffix, length in _NUMBERS[joint.type]:
                names.append(joint.name + suffix)
                lengths.append(length)
                place.append(self.nq)
                self.nq += 1
            if joint.type in WITH_ORIENTATION:
                balls.append((self.nq, len(names)))
                names += [joint.name + suffix for suffix in _TURNS]
                keys.append(joint.name)
                lengths += 3 * [False]
                place += 3 * [-1]
                self.nq += 4
            else:
                keys += names[first:]
            self.rates[joint.name] = slice(first, len(names))
            self.coordinates[joint.name] = slice(coordinate, self.nq)
            if joint.actuated:
                actuated += range(first, len(names))
        self.names, self.keys, self.actuated = tuple(names), tuple(keys), tuple(actuated)
        self.nv, self.index = len(names), {name: k for k, name in enumerate(names)}
        self.lengths, self.place = np.array(lengths, dtype=bool), np.array(place, dtype=int)
        self.balls = np.array(balls, dtype=int).reshape(-1, 2)
        self._numbered = np.flatnonzero(self.place >= 0)
        turned = [joint for joint in joints if joint.type in WITH_ORIENTATION]
        self.with_orientation = tuple(joint.name for joint in turned)
        self.single = np.array([
            place for joint in joints if joint.type not in WITH_ORIENTATION
            for place in range(self.rates[joint.name].start, self.rates[joint.name].stop)],
            dtype=int)
        self.pose, self.twist = (np.array([
            3 * [-1] * (joint.type == SPHERICAL) + list(range(places.start, places.stop))
            for joint, places in ((joint, where[joint.name]) for joint in turned)],
            dtype=int).reshape(-1, count)
            for where, count in ((self.coordinates, 7), (self.rates, 6)))

    @property
    def single_names(self):
        """Return the names of ``single``."""
        return tuple(self.names[place] for place in self.single)

    @property
    def can_be_held(self):
        """Return the names of all joints, and of the numbers of those that have several."""
        return tuple(dict.fromkeys((*self._joints, *self.single_names)))

    @property
    def numbers_and_turns(self):
        """Return the names of freedoms with a number of their own, and of joints that turn."""
        return tuple(self.names[place] for place in self._numbered) + self.with_orientation

    def units(self, quantity):
        """Return the units of one of ``QUANTITIES``, as they are for each rate."""
        return [QUANTITIES[quantity][length] for length in self.lengths.tolist()]

    def joint_of(self, name):
        """Return the name of the joint that a freedom belongs to."""
        return name.partition('.')[0]

    def columns(self, quantity):
        """
        Return the columns' names of a quantity in a table, as ``orientation.ball.x``.

        ``'position'``, nq of them, ``'velocity'``, ``'acceleration'`` or ``'effort'``, nv of them.
        """
        found = []
        for name, joint in self._joints.items():
            found += [f'{quantity}.{name}{suffix}' for suffix, _ in _NUMBERS[joint.type]]
            if joint.type in WITH_ORIENTATION:
                found += [f'{OF_ROTATIONS[quantity]}.{name}.{axis}'
                          for axis in ('xyzw' if quantity == 'position' else 'xyz')]
        return found

    def paths(self, quantity):
        """
        Return the keys, one below the other, of the numbers that can be varied by themselves.

        With their places among the coordinates (``'position'``) or rates (``'velocity'``); those
        of quaternions are left out.
        """
        found = {}
        for name, joint in self._joints.items():
            place = (self.coordinates if quantity == 'position' else self.rates)[name].start
            turned = joint.type in WITH_ORIENTATION
            for k, (suffix, _) in enumerate(_NUMBERS[joint.type]):
                path = (name, quantity, str(k)) if turned else tuple((name + suffix).split('.'))
                found[path] = place + k
            if turned and quantity == 'velocity':
                place += len(_NUMBERS[joint.type])
                found.update(((name, OF_ROTATIONS[quantity], str(k)), place + k)
                             for k in range(3))
        return found

    @property
    def groups(self):
        """Return the numbers of all joints, those together that belong together."""
        found = []
        for name, joint in self._joints.items():
            places = list(range(self.coordinates[name].start, self.coordinates[name].stop))
            rates = list(range(self.rates[name].start, self.rates[name].stop))
            if joint.type not in WITH_ORIENTATION:
                found += [Group(self.names[rate], joint, [place], [rate], self.lengths[rate])
                          for place, rate in zip(places, rates)]
                continue
            if joint.type == FREE:
                found.append(Group(f'{name}.position', joint, places[:3], rates[:3], True))
            found.append(Group(f'{name}.orientation', joint, places[-4:], rates[-3:], False))
        return found

    def start(self):
        """Return the coordinates of joints that are as they are drawn, shape (nq,)."""
        q = np.zeros(self.nq)
        q[self.balls[:, 0] + 3] = 1.0
        return q

    def filled(self, quantity, values, present):
        """
        Put values that are given by name into an array.

        Parameters
        ----------
        quantity : str
            ``'position'`` or ``'velocity'``.
        values : mapping
            Numbers by the names of single freedoms; by the names of joints with an orientation
            mappings of ``orientation`` (rpy or quaternion) and, where they are free, ``position``;
            of ``angular_velocity`` and ``velocity``.
        present : ndarray, shape (nq,) or (nv,)
            Coordinates that are not given keep these values.

        Returns
        -------
        ndarray
            A new one.

        Raises
        ------
        FieldError

        """
        found = present.copy()
        single = self.place if quantity == 'position' else np.arange(self.nv)
        whole = self.coordinates if quantity == 'position' else self.rates
        for key, value in mapping(values, (), self.keys).items():
            with at(key):
                joint = self._joints[self.joint_of(key)]
                if joint.type not in WITH_ORIENTATION:
                    found[single[self.index[key]]] = number(value)
                    continue
                here = found[whole[key]]
                own = (quantity,) if joint.type == FREE else ()
                for part, given in mapping(value, (), (*own, OF_ROTATIONS[quantity])).items():
                    with at(part):
                        if part == quantity:
                            here[:3] = vector3(given)
                        else:
                            here[3 * len(own):] = _CHECKS[quantity](given)
        return found

    def by_name(self, quantity, values):
        """Return values by name, as ``filled`` takes them, of nq positions or nv velocities."""
        found, values = {}, [float(value) for value in values]
        whole = self.coordinates if quantity == 'position' else self.rates
        single = self.place if quantity == 'position' else range(self.nv)
        for key in self.keys:
            joint = self._joints[self.joint_of(key)]
            if joint.type not in WITH_ORIENTATION:
                found[key] = values[single[self.index[key]]]
                continue
            here = values[whole[key]]
            own = 3 if joint.type == FREE else 0
            turn = here[own:]
            found[key] = {OF_ROTATIONS[quantity]: (
                {'quaternion': turn} if quantity == 'position' else turn)}
            if own:
                found[key][quantity] = here[:own]
        return found

    def unit(self, q):
        """
        Return coordinates, shape (nq,) or (n, nq), with quaternions of norm 1.

        FieldError where one is further from that than rounded numbers are.
        """
        q = np.array(q, dtype=float)
        for first, rate in self.balls.tolist():
            turns = q[..., first:first + 4]
            near = np.abs(np.linalg.norm(turns, axis=-1) - 1.0) <= UNIT_NORM
            for place in map(tuple, np.argwhere(~near)):
                with at(self.joint_of(self.names[rate]), 'orientation'):
                    turns[place] = orientation(tuple(turns[place].tolist()))
        return q

    def moved(self, q, change):
        """
        Return coordinates, shape (..., nq), after a change of the rates' kind, shape (..., nv).

        Quaternions are composed with the exponential of their change.
        """
        single = self.place >= 0
        q = q.copy()
        q[..., self.place[single]] += change[..., single]
        for first, rate in self.balls:
            turned = composed(q[..., first:first + 4], quaternion_of_vector(
                change[..., rate:rate + 3]))
            q[..., first:first + 4] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
        return q

    def apart(self, q, other):
        """
        Return the change, shape (..., nv), from other coordinates to some, (..., nq).

        By the shorter turns.
        """
        single = self.place >= 0
        change = np.zeros((*q.shape[:-1], self.nv))
        change[..., single] = (q - other)[..., self.place[single]]
        for first, rate in self.balls:
            turned = composed(other[..., first:first + 4] * CONJUGATE, q[..., first:first + 4])
            axis, cosine = turned[..., :3], turned[..., 3:]
            sine = np.linalg.norm(axis, axis=-1, keepdims=True)
            # The sine of a small turn is half the angle.
            length = np.where(sine > 0.0, 2.0 * np.arctan2(sine, np.abs(cosine)) / np.where(
                sine > 0.0, sine, 1.0), 2.0)
            change[..., rate:rate + 3] = axis * np.copysign(length, cosine)
        return change

    def by_freedom(self, q):
        """Return the number of each freedom, shape (nv,): 0 for those of rotations."""
        if not len(self.balls):
            return q
        found = np.zeros(self.nv)
        found[self._numbered] = q[self.place[self._numbered]]
        return found

    def poses(self, q):
        """
        Return the poses of the joints with an orientation, shape (..., number of them, 7).

        Place [m], zero in a spherical joint, and quaternion x, y, z, w.
        """
        return np.concatenate([q, np.zeros((*q.shape[:-1], 1))], axis=-1)[..., self.pose]

    def twists(self, qd):
        """
        Return rates, or efforts, of the joints with an orientation, shape (..., number, 6).

        Along the axes of the joint, zero in a spherical one; about those of the child.
        """
        return np.concatenate([qd, np.zeros((*qd.shape[:-1], 1))], axis=-1)[..., self.twist]

    def require_lengths(self, position, velocity):
        """Refuse sequences of other lengths than nq and nv; see ``filled``."""
        for key, values, count in (('position', position, self.nq),
                                   ('velocity', velocity, self.nv)):
            if len(values) != count:
                each = 'one for each joint' if self.nq == self.nv == len(self._joints) else (
                    'for ' + ', '.join(self.columns(key)))
                raise FieldError(f'{count} numbers, {each}', f'{len(values)}', path=(key,))


def unit_of(mechanism, quantity, name):
    """Return the unit of one of ``QUANTITIES``, of a coordinate by its name, or of a point."""
    for coordinates in (mechanism.coordinates, mechanism.cut_coordinates):
        if name in coordinates.index:
            return coordinates.units(quantity)[coordinates.index[name]]
    return QUANTITIES[quantity][True]
