# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Gears, racks and belts of couplings: radii and teeth from ratio and place.

Two wheels turn by psi_1 and psi_2 about axes that are fixed in one body, their carrier, and a
coupling says a_1 psi_1 + a_2 psi_2 = constant. Where they roll on one another, their radii are as
|a_1| to |a_2|, and with the distance of the axes that is all: r_1 + r_2 for wheels that turn
against one another, |r_1 - r_2| for one in a ring. Axes that meet have bevel gears. A coupling
whose ``radius`` is too small for its wheels to touch is a belt. Whether teeth fit into gaps does
not change while wheels roll: it is decided once, from ``offset``.
"""

from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from .wheels import (
    Belt, BEVEL, GEAR, profile, PULLEY, Rack, rack_profile, RING, ROUND, Wheel)
from ..mechanism.mechanism import GROUND, PRISMATIC, REVOLUTE
from ..mechanism.rotations import about, direction, in_three, of_quaternion

# Relative error that radii, distances and numbers of teeth may have in a file.
TOLERANCE = 1e-4
# Teeth of the smallest wheel, in this order; of the largest one.
LEAST_TEETH, MOST_TEETH = (*range(18, 41), *range(12, 18)), 500
# How far a rack reaches, in radii of its wheel.
REACH = 4.0
# Wheels that turn the same way with about the same speed are not gears in a ring, which would be
# so many times as large as their distance; the larger pulley of a belt without radii, in
# distances.
LARGEST_RING, BELT_RADIUS = 6.0, 0.15


def transmissions(mechanism):
    """
    Return the wheels, racks and belts of the couplings of a mechanism, three lists.

    Couplings whose wheels would not touch, are on one axis or on skew ones have none; neither have
    those without a ``radius`` between bodies with shapes of their own, as joints of robots that
    mimic others, and those with a law.
    """
    mechanism = replace(mechanism, couplings=tuple(
        coupling for coupling in mechanism.couplings if coupling.law is None))
    if not mechanism.couplings:
        return [], [], []
    train = _Train(mechanism)
    for coupling in mechanism.couplings:
        train.add(coupling)
    train.cut_teeth()
    return train.wheels, [train.rack(*one) for one in train.racks], train.belts


def outlines(mechanism):
    """
    Return the outlines of wheels, racks and belts, in the frames of bodies.

    Of each: name of a body, places of a closed outline, shape (n, 2), in space (n, 3) [m], and
    whether it is filled. That of a ring goes round its hole, too.
    """
    wheels, racks, belts = transmissions(mechanism)
    found = []
    for wheel in wheels:
        outer, hole = profile(wheel)
        if hole is not None:
            outer = np.vstack([outer, outer[:1], hole[:1], hole[::-1]])
        found.append((wheel.body, wheel.center + outer @ [wheel.start, wheel.side], True))
    found += [(rack.body, rack.place + rack_profile(rack) @ [rack.along, rack.normal], True)
              for rack in racks]
    found += [(belt.body, belt.places, False) for belt in belts]
    size = 2 if mechanism.planar else 3
    return [(body, places[:, :size], filled) for body, places, filled in found]


class _Hinge(NamedTuple):
    """A body that turns about an axis; turn: the child's axes in the parent at zero."""

    name: str
    parent: str
    child: str
    at_parent: np.ndarray
    at_child: np.ndarray
    axis: np.ndarray
    turn: np.ndarray


class _Seat(NamedTuple):
    """
    How a body turns in its carrier.

    ``terms``: by joint its factor in the angle psi; place and axis in the carrier, axes of the
    body at psi = 0, and the same place in the body.
    """

    body: str
    terms: dict
    place: np.ndarray
    axis: np.ndarray
    turn: np.ndarray
    center: np.ndarray


class _Mesh(NamedTuple):
    """
    Teeth of wheel ``first`` in gaps of wheel ``other``, by their numbers.

    ``ahead``: angles at one instant from the contact to the directions that ``start`` is counted
    from; ``sense`` 1 where the axes lie so that both turn the same way.
    """

    first: int
    other: int
    ahead: tuple
    sense: int


class _Train:
    """Found parts: wheels, their meshing, and racks before their teeth are cut."""

    def __init__(self, mechanism):
        self.mechanism = mechanism
        self.hinges = {hinge.name: hinge for hinge in _hinges(mechanism)}
        self.slides = {joint.name: joint for joint in mechanism.joints
                       if joint.type == PRISMATIC}
        self.shaped = {body.name for body in mechanism.bodies if body.visual}
        self.values = _values(mechanism.couplings)
        self.wheels, self.meshes, self.racks, self.belts, self._known = [], [], [], [], {}

    def add(self, coupling):
        """Add the wheels of a coupling, if it has any."""
        if coupling.radius is None and any(
                joint.name in coupling.joints and joint.child in self.shaped
                for joint in self.mechanism.joints):
            return
        if all(name in self.hinges for name in coupling.joints):
            carrier, seats, factors = self._rolling(coupling)
            if carrier is not None:
                self._roll(coupling, carrier, seats, factors)
        elif len(coupling.joints) == 2:
            slide = next((name for name in coupling.joints if name in self.slides), None)
            hinge = next((name for name in coupling.joints if name in self.hinges), None)
            if slide and hinge and all(coupling.joints.values()):
                self._push(self.slides[slide], self.hinges[hinge],
                           -coupling.joints[hinge] / coupling.joints[slide])

    def _rolling(self, coupling):
        """Return the carrier in which a coupling is one of angles of bodies; their factors."""
        near = dict.fromkeys(chain([GROUND], *(
            (self.hinges[name].child, self.hinges[name].parent) for name in coupling.joints)))
        for carrier in near:
            seats = [seat for body in near if body != carrier
                     for seat in [self._seat(carrier, body)] if seat is not None]
            names = sorted({*coupling.joints, *chain(*(seat.terms for seat in seats))})
            terms = np.array([[seat.terms.get(name, 0.0) for seat in seats] for name in names])
            wanted = np.array([coupling.joints.get(name, 0.0) for name in names])
            if not seats:
                continue
            factors = np.linalg.lstsq(terms, wanted, rcond=None)[0]
            scale = np.abs(wanted).max()
            some = [k for k, factor in enumerate(factors) if abs(factor) > TOLERANCE * scale]
            if len(some) < 2 or np.abs(terms @ factors - wanted).max() > TOLERANCE * scale:
                continue
            child = self.hinges[next(iter(coupling.joints))].child
            # The first joint's wheel is the one whose radius may be given.
            some.sort(key=lambda k: seats[k].body != child)
            return carrier, [seats[k] for k in some], [factors[k] for k in some]
        return None, (), ()

    def _seat(self, carrier, body):
        for hinge in self.hinges.values():
            if (hinge.parent, hinge.child) == (carrier, body):
                return _upright(_Seat(body, {hinge.name: 1.0}, hinge.at_parent, hinge.axis,
                                      hinge.turn, hinge.at_child))
            if (hinge.child, hinge.parent) == (carrier, body):
                return _upright(_Seat(body, {hinge.name: -1.0}, hinge.at_child,
                                      hinge.turn.T @ hinge.axis, hinge.turn.T, hinge.at_parent))
        for hinge in self.hinges.values():
            for arm in self.hinges.values():
                if (hinge.child, arm.child, hinge.parent) == (body, carrier, arm.parent) and (
                        _on_one_axis(hinge, arm)):
                    same = np.sign(hinge.axis @ arm.axis)
                    return _upright(_Seat(
                        body, {hinge.name: 1.0, arm.name: -same}, arm.at_child,
                        arm.turn.T @ hinge.axis, arm.turn.T @ hinge.turn, hinge.at_child))
        return None

    def _roll(self, coupling, carrier, seats, factors):
        first, *others = seats
        for other, factor in zip(others, factors[1:]):
            turned = np.cross(first.axis, other.axis)
            # Equal wheels, such as planets, share in turning the first one.
            alike = sum(abs(abs(one) - abs(factor)) < TOLERANCE * abs(factor)
                        for one in factors[1:])
            ratio = alike * factor / factors[0]
            if np.linalg.norm(turned) < TOLERANCE:
                self._parallel(coupling, carrier, first, other,
                               ratio * np.sign(first.axis @ other.axis))
            elif coupling.radius:
                self._meeting(coupling.radius, first, other, ratio)

    def _parallel(self, coupling, carrier, first, other, ratio):
        """Put wheels on axes that are parallel; ``ratio`` below zero: they turn the same way."""
        away = other.place - first.place
        away = away - (away @ first.axis) * first.axis
        distance = np.linalg.norm(away)
        if distance < TOLERANCE * (coupling.radius or distance or 1.0) or not distance:
            return
        gap = abs(1.0 + ratio)
        radius = coupling.radius or (distance / gap if gap * LARGEST_RING > 1.0 else 0.0)
        radii = np.array([radius, abs(ratio) * radius])
        between = radii.sum() if ratio > 0.0 else abs(radii[0] - radii[1])
        shift = (first.place - other.place) @ other.axis
        centers = first.center, other.center + shift * (other.turn.T @ other.axis)
        direction = away / distance
        if radius and abs(between - distance) < TOLERANCE * distance:
            inside = np.sign(radii[0] - radii[1]) if ratio < 0.0 else 0.0
            contacts = ((direction, -direction) if ratio > 0.0
                        else (inside * direction, inside * direction))
            self._mesh(first, other, contacts, [
                self._wheel(RING if ratio < 0.0 and size == radii.max() else GEAR,
                            seat, center, size)
                for seat, center, size in zip((first, other), centers, radii)])
        elif not radius or radii.sum() < distance:
            if not radius:
                radii = BELT_RADIUS * distance * np.array([1.0, abs(ratio)]) / max(1.0, abs(ratio))
            for seat, center, size in zip((first, other), centers, radii):
                self._wheel(PULLEY, seat, center, size)
            self.belts.append(Belt(coupling.name, carrier, _belt(
                first.place, direction, np.cross(first.axis, direction), distance, radii,
                crossed=ratio > 0.0)))

    def _meeting(self, radius, first, other, ratio):
        """Put bevel gears on axes that meet."""
        across = np.cross(first.axis, other.axis)
        away = other.place - first.place
        if abs(away @ across) > TOLERANCE * radius:
            return
        reach = np.linalg.det([away, other.axis, across]) / (across @ across)
        apex = first.place + reach * first.axis
        outward, (one, two) = [], (self._side(seat, apex) for seat in (first, other))
        # As they roll on one another, the side of one decides that of the other.
        if one * two * ratio < 0.0:
            two = -two
        outward = [one * first.axis, two * other.axis]
        cosine, sine = outward[0] @ outward[1], np.linalg.norm(across)
        radii = radius, abs(ratio) * radius
        cones = [np.arctan2(sine, radii[1 - k] / radii[k] + cosine) for k in range(2)]
        heights = [size / np.tan(cone) for size, cone in zip(radii, cones)]
        wheels, contacts = [], []
        for k, (seat, height) in enumerate(zip((first, other), heights)):
            center = seat.turn.T @ (apex + height * outward[k] - seat.place) + seat.center
            wheels.append(self._wheel(
                BEVEL, seat, center, radii[k], -height * (outward[k] @ seat.axis)))
            towards = outward[1 - k] - cosine * outward[k]
            contacts.append(towards / np.linalg.norm(towards))
        self._mesh(first, other, contacts, wheels)

    def _side(self, seat, apex):
        """Return on which side of the apex a wheel is, -1 or 1: on that of its body."""
        middle = seat.turn @ (self._middle(seat.body) - seat.center) + seat.place
        for place in (seat.place, middle):
            along = (place - apex) @ seat.axis
            if abs(along) > TOLERANCE * np.linalg.norm(place - apex):
                return np.sign(along)
        return 1.0

    def _middle(self, body):
        places = [point.position for point in self.mechanism.points if point.body == body]
        places += [one.center_of_mass for one in self.mechanism.bodies if one.name == body]
        return in_three(np.mean(places, axis=0)) if places else np.zeros(3)

    def _push(self, slide, hinge, radius):
        """Put a wheel on a hinge and a rack on a slide of the same body, which moves by radius."""
        if slide.parent != hinge.parent:
            return
        turn = _turn(slide)
        along = turn @ ([1.0, 0.0, 0.0] if slide.axis is None else slide.axis)
        if abs(along @ hinge.axis) > TOLERANCE:
            return
        seat = _upright(_Seat(hinge.child, {hinge.name: 1.0}, hinge.at_parent, hinge.axis,
                              hinge.turn, hinge.at_child))
        along = along * np.sign(radius) * np.sign(hinge.axis @ seat.axis)
        normal, size = np.cross(along, seat.axis), abs(radius)
        self.racks.append((
            self._wheel(GEAR, seat, seat.center, size), slide, along, normal,
            seat.place + size * normal, turn, self._ahead(seat, normal)))

    def _wheel(self, kind, seat, center, radius, apex=0.0):
        """Return the number of a wheel, new or found before."""
        key = (kind, seat.body, *np.round(center / radius, 4), f'{radius:.6g}')
        if key not in self._known:
            self._known[key] = len(self.wheels)
            axis = seat.turn.T @ seat.axis
            self.wheels.append(Wheel(kind, seat.body, center, axis, _across(axis), radius,
                                     apex=apex))
        return self._known[key]

    def _ahead(self, seat, contact):
        """Return the angle from the contact to the wheel's start as the couplings have it."""
        zero = seat.turn @ _across(seat.turn.T @ seat.axis)
        angle = np.arctan2(np.cross(contact, zero) @ seat.axis, contact @ zero)
        return angle + sum(factor * self.values.get(name, 0.0)
                           for name, factor in seat.terms.items())

    def _mesh(self, first, other, contacts, wheels):
        moving = [np.cross(seat.axis, contact) for seat, contact in zip((first, other), contacts)]
        self.meshes.append(_Mesh(
            *wheels, tuple(map(self._ahead, (first, other), contacts)),
            int(np.sign(moving[0] @ moving[1]))))

    def cut_teeth(self):
        """Find numbers of teeth with the ratios of the radii, and where the first ones are."""
        left = set(range(len(self.wheels)))
        while left:
            group, reached = [], [min(left)]
            while reached:
                number = reached.pop()
                group.append(number)
                left.discard(number)
                reached += [end for mesh in self.meshes if number in (mesh.first, mesh.other)
                            for end in (mesh.first, mesh.other)
                            if end in left and end not in reached]
            if self.wheels[group[0]].kind != PULLEY:
                self._cut(group)

    def _cut(self, group):
        radii = np.array([self.wheels[number].radius for number in group])
        best = None
        for least in LEAST_TEETH:
            teeth = least * radii / radii.min()
            if np.abs(teeth - teeth.round()).max() > TOLERANCE * least or (
                    teeth.max() > MOST_TEETH):
                continue
            counts = dict(zip(group, teeth.round().astype(int).tolist()))
            starts, misfit = self._starts(group, counts)
            if best is None or misfit < best[0] - TOLERANCE:
                best = misfit, counts, starts
        for number in group if best else ():
            wheel = self.wheels[number]
            angle = best[2][number]
            self.wheels[number] = wheel._replace(
                teeth=best[1][number],
                start=np.cos(angle) * wheel.start + np.sin(angle) * wheel.side)

    def _starts(self, group, teeth):
        """Return, by wheel, the angle of its first tooth, and the largest misfit in pitches."""
        starts, misfit = {group[0]: 0.0}, 0.0
        meshes = [mesh for mesh in self.meshes if mesh.first in teeth]
        while meshes:
            mesh = next(one for one in meshes if one.first in starts or one.other in starts)
            meshes.remove(mesh)
            pitches = [2.0 * np.pi / teeth[end] for end in (mesh.first, mesh.other)]
            if mesh.first in starts and mesh.other in starts:
                place, other = ((mesh.ahead[k] + starts[end]) / pitches[k]
                                for k, end in enumerate((mesh.first, mesh.other)))
                off = place - mesh.sense * other - 0.5
                misfit = max(misfit, abs(off - np.round(off)))
                continue
            known = 0 if mesh.first in starts else 1
            ends = mesh.first, mesh.other
            place = (mesh.ahead[known] + starts[ends[known]]) / pitches[known]
            starts[ends[1 - known]] = (mesh.sense * (place - 0.5) * pitches[1 - known]
                                       - mesh.ahead[1 - known])
        return starts, misfit

    def rack(self, number, slide, along, normal, contact, turn, ahead):
        """Return the rack that a wheel pushes."""
        wheel = self.wheels[number]
        zero = _across(wheel.axis)
        ahead += np.arctan2(np.cross(zero, wheel.start) @ wheel.axis, zero @ wheel.start)
        pitch = 2.0 * np.pi * wheel.radius / (wheel.teeth or 36)
        moved = turn @ ([1.0, 0.0, 0.0] if slide.axis is None else slide.axis)
        place = contact - in_three(slide.position) - (
            self.values.get(slide.name, 0.0) * moved) + (
            wheel.radius * ahead + 0.5 * pitch) * along
        place, along, normal = turn.T @ place, turn.T @ along, turn.T @ normal
        marks = [in_three(point.position) @ along for point in self.mechanism.points
                 if point.body == slide.child]
        middle = turn.T @ (contact - in_three(slide.position)) @ along
        reach = REACH * wheel.radius
        ends = np.array([min([middle - reach, *marks]), max([middle + reach, *marks])])
        return Rack(slide.child, place, along, -normal, pitch,
                    tuple((ends - place @ along).tolist()))


def _turn(joint):
    """Return the axes of a child in its parent at zero, shape (3, 3)."""
    if joint.axis is not None:
        return of_quaternion(joint.orientation)
    return about((0.0, 0.0, 1.0), joint.angle)


def _hinges(mechanism):
    upright = np.array([0.0, 0.0, 1.0])
    for joint in mechanism.joints:
        if joint.type == REVOLUTE:
            turn = _turn(joint)
            axis = upright if joint.axis is None else turn @ joint.axis
            yield _Hinge(joint.name, joint.parent, joint.child, in_three(joint.position),
                         np.zeros(3), axis / np.linalg.norm(axis), turn)
    for cut in mechanism.cut_joints:
        if cut.type == REVOLUTE and mechanism.planar:
            yield _Hinge(cut.name, cut.body_b, cut.body_a, in_three(cut.point_b),
                         in_three(cut.point_a), upright, about((0.0, 0.0, 1.0), cut.angle))


def _values(couplings):
    """Return coordinates that all couplings hold at, by joint [rad or m]."""
    names = sorted({name for coupling in couplings for name in coupling.joints})
    factors = [[coupling.joints.get(name, 0.0) for name in names] for coupling in couplings]
    found = np.linalg.lstsq(np.array(factors), np.array(
        [coupling.offset for coupling in couplings]), rcond=None)[0]
    return dict(zip(names, found.tolist()))


def _on_one_axis(hinge, arm):
    away = hinge.at_parent - arm.at_parent
    size = np.linalg.norm(hinge.at_parent) or 1.0
    return (np.linalg.norm(np.cross(hinge.axis, arm.axis)) < TOLERANCE
            and np.linalg.norm(np.cross(away, arm.axis)) < TOLERANCE * size)


def _upright(seat):
    """Return a seat with the axis, of the two directions, that its body has as positive."""
    axis = seat.turn.T @ seat.axis
    if axis[np.argmax(np.abs(axis))] > 0.0:
        return seat
    return seat._replace(axis=-seat.axis, terms={
        name: -factor for name, factor in seat.terms.items()})


def _across(axis):
    """Return a direction across an axis, shape (3,)."""
    across = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [0.0, 0.0, 1.0], axis)
    return across / np.linalg.norm(across)


def _belt(place, along, side, distance, radii, crossed):
    """Return the places of a closed belt, shape (n, 3)."""
    first, other = radii
    lean = np.arccos(((first + other) if crossed else (first - other)) / distance)
    # Round the first pulley where it is away from the other one, and on.
    back = np.linspace(lean, 2.0 * np.pi - lean, ROUND // 2)
    forth = np.linspace(*((np.pi - lean, lean - np.pi) if crossed else (-lean, lean)), ROUND // 2)
    places = np.vstack([
        first * direction(back),
        other * direction(forth) + [distance, 0.0]])
    return place + np.vstack([places, places[:1]]) @ np.array([along, side])
