# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Axes and places that agree to the digits of a file, made to agree exactly.

A loop of hinges moves where their axes are parallel, and is locked where one of them is tilted by
a rounded digit, 1.570796327 beside 1.5707963268: forces of rounding without end, or a loop that
stays open by 1e-10. What agrees on a body, or on bodies that slide on one another and so keep
their orientations, to the mechanism's ``tolerance`` is taken as what it nearly is: axes parallel
or at right angles, axes and points that meet, loops of parallel axes as wide on both sides. What
agrees less well, but to everyday rounding, is reported.
"""

from dataclasses import dataclass, replace
import math
from typing import NamedTuple, Optional

import numpy as np

from .mechanism import (
    CUT_WITH_AXIS_A, CUT_WITH_AXIS_B, CYLINDRICAL, DISTANCE, FIXED, GROUND, HELICAL, PLANAR,
    POINT_ON_PLANE, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL, UNTURNED)
from .rotations import about, angle_of, cross, of_quaternion, quaternion_of

# What agrees this well, as sines of angles and in sizes of the mechanism, does so exactly: this is
# the rounding of numbers that were written with all digits, after a chain of many joints.
EXACT = 1e-13
# Everyday rounding: 1.5708 for a right angle. What agrees to it, but not to the tolerance, is
# reported.
EVERYDAY = 1e-5
MOST_ROUNDS = 10
# So many joints are named.
MOST_NAMED = 4
_HINGES, _SLIDES = (REVOLUTE, HELICAL, CYLINDRICAL), (PRISMATIC, FIXED)
# Cut joints that hold their points together along each direction across their own freedoms.
_HOLDING = (REVOLUTE, SPHERICAL, UNIVERSAL, FIXED, PRISMATIC, PLANAR, POINT_ON_PLANE)
_UNIT = np.eye(3)


def extent(mechanism):
    """
    Return the size that tolerances are relative to: the longest distance on any body [m].

    At least the smallest positive float of any use, never zero.
    """
    places = [joint.position for joint in mechanism.joints]
    places += [p for cut in mechanism.cut_joints for p in (cut.point_a, cut.point_b)]
    longest = max((math.hypot(*place) for place in places), default=0.0)
    return longest or 1.0


def with_agreement(mechanism):
    """
    Return a mechanism whose axes and places that agree to its tolerance agree exactly.

    Itself where all do. Its ``rounded`` says what was changed, and by how much.
    """
    found, notes = mechanism, []
    # What is moved may come near enough to something else.
    for _ in range(MOST_ROUNDS):
        found, more = _agreeing(found, mechanism.tolerance)
        notes += more
        if not more:
            break
    if not notes:
        return mechanism
    said = _words(notes, 'are taken as')
    return replace(found, rounded=tuple(dict.fromkeys((*mechanism.rounded, *said))))


def suspicions(mechanism):
    """Return notes on axes and places that agree to everyday rounding and not better."""
    if mechanism.tolerance >= EVERYDAY:
        return []
    _, notes = _agreeing(mechanism, EVERYDAY)
    if not notes:
        return []
    size = extent(mechanism)
    most = max(one.far / (size if one.unit else 1.0) for one in notes)
    said = '; '.join(_words(notes, 'are not'))
    wide = 10.0 ** math.ceil(math.log10(most))
    return [f'{said}. This is how rounded digits look. They lock loops, keep them open, or cause '
            'large forces without meaning. --geometry-tolerance '
            f'{wide:.0e}, or the key tolerance of the mechanism (of the scene of a model), takes '
            'them as they were meant; or write more digits.']


def digit_notes(mechanism):
    """Return notes on all that was rounded, or looks as if it had been."""
    return [*mechanism.rounded, *suspicions(mechanism)]


def _words(changes, verb):
    """Return changes in words, those of one kind together."""
    kinds = {}
    for one in changes:
        kinds.setdefault((one.what, one.unit, one.outcome), []).append(one)
    return [f'{what} {max(one.far for one in some):.2g}{unit} {verb} {outcome}: '
            + '; '.join(dict.fromkeys(one.names for one in some))
            for (what, unit, outcome), some in kinds.items()]


class _Change(NamedTuple):
    """Something that was made to agree, in words."""

    what: str  # Up to the number: 'axes that agree to'
    far: float  # Sine of an angle, or a distance [m]
    unit: str  # Of it
    outcome: str  # What is taken
    names: str  # Of the joints, and of the body they are on


def _agreeing(mechanism, tolerance):
    """Return a mechanism after all steps, taken once, and what was changed."""
    notes = []
    if mechanism.cut_joints:
        in_space = (_with_axes, _with_places, _with_centers)
        for step in (_with_slides, *((_with_places,) if mechanism.planar else in_space),
                     _with_loops):
            mechanism, said = step(mechanism, tolerance)
            notes += said
    return mechanism, notes


def _turn(record):
    """Return the rotation that a joint, or a cut joint, holds at zero, shape (3, 3)."""
    if record.angle:
        return about(_UNIT[2], record.angle)
    return of_quaternion(record.orientation)


def _names(records, body=''):
    names = list(dict.fromkeys(record.name for record in records))
    more = f' and {len(names) - MOST_NAMED} more' if len(names) > MOST_NAMED else ''
    return f'{", ".join(names[:MOST_NAMED])}{more}{body and f" (on {body})"}'


def _around(cut, carriers):
    """Return the joints of a loop by name; ``carriers`` by body."""
    ways = []
    for body in (cut.body_a, cut.body_b):
        ways.append({})
        while body != GROUND:
            ways[-1][carriers[body].name] = carriers[body]
            body = carriers[body].parent
    return {name: joint for name, joint in {**ways[0], **ways[1]}.items()
            if (name in ways[0]) != (name in ways[1])}


def _in_loops(mechanism):
    """Return the names of all joints of the tree that are in loops."""
    carriers = {joint.child: joint for joint in mechanism.joints}
    return {name for cut in mechanism.cut_joints for name in _around(cut, carriers)}


def _orientations(mechanism):
    """
    Return the frames that always keep their orientations to one another.

    By body: the first body of its group and the rotation of its frame in that body's, shape (3,
    3); slides keep orientations.
    """
    found = {GROUND: (GROUND, _UNIT), **{body.name: (body.name, _UNIT)
                                         for body in mechanism.bodies}}
    links = [(joint.parent, joint.child, _turn(joint)) for joint in mechanism.joints
             if joint.type in _SLIDES]
    links += [(cut.body_b, cut.body_a, _turn(cut)) for cut in mechanism.cut_joints
              if cut.type in _SLIDES]
    for parent, child, turn in links:
        (root, first), (other, second) = found[parent], found[child]
        if root != other:
            across = first @ turn @ second.T
            found.update({body: (root, across @ rotation)
                          for body, (group, rotation) in found.items() if group == other})
    return found


def _with_slides(mechanism, tolerance):
    """Make cut joints hold the orientation that slides hold already, where they agree."""
    found, cuts, notes = _orientations(mechanism), [], []
    for cut in mechanism.cut_joints:
        (root, first), (other, second) = found[cut.body_b], found[cut.body_a]
        if cut.type in _SLIDES and root == other:
            held = first.T @ second
            apart = _turn(cut).T @ held
            # Entries beside the diagonal are sines of the angle times the axis, twice each.
            far = float(np.linalg.norm(apart - apart.T)) / math.sqrt(8.0)
            if EXACT < far <= tolerance and np.trace(apart) > 0.0:
                changed = {'angle': cut.angle + angle_of(apart)} if mechanism.planar else {
                    'orientation': quaternion_of(held)}
                cut = replace(cut, **changed)
                notes.append(_Change('orientations that agree to', far, '', 'the same',
                                     _names([cut])))
        cuts.append(cut)
    return replace(mechanism, cut_joints=tuple(cuts)) if notes else mechanism, notes


class _Axis(NamedTuple):
    """An axis of a joint, or of a cut joint, on one body."""

    name: str
    body: str
    key: tuple  # The record's section and number, and which of its sides
    direction: np.ndarray  # Shape (3,): In the body's frame
    fixed: bool = False  # Whether it cannot be changed


def _axes(mechanism):
    """Return the axes on all bodies of a mechanism in space, of joints in loops."""
    found, looped = [], _in_loops(mechanism)
    for number, joint in enumerate(mechanism.joints):
        if joint.name in looped and joint.type in (*_HINGES, PRISMATIC, UNIVERSAL, PLANAR):
            first = _UNIT[2] if joint.type == PLANAR else np.array(joint.axis)
            second = np.array(joint.second_axis) if joint.type == UNIVERSAL else first
            if joint.type != PRISMATIC:
                found.append(_Axis(joint.name, joint.parent, ('joints', number, 'parent'),
                                   _turn(joint) @ first))
            found.append(_Axis(joint.name, joint.child, ('joints', number, 'child'), second,
                               joint.type == PLANAR))
    for number, cut in enumerate(mechanism.cut_joints):
        if cut.type in CUT_WITH_AXIS_A:
            found.append(_Axis(cut.name, cut.body_a, ('cut_joints', number, 'a'),
                               np.array(cut.axis_a)))
        if cut.type == HELICAL:
            found.append(_Axis(cut.name, cut.body_a, ('cut_joints', number, 'a'),
                               _turn(cut).T @ cut.axis_b))
        if cut.type in CUT_WITH_AXIS_B:
            found.append(_Axis(cut.name, cut.body_b, ('cut_joints', number, 'b'),
                               np.array(cut.axis_b)))
    return found


def _with_axes(mechanism, tolerance):
    """Make axes parallel, or set them at right angles, where they nearly are."""
    found, groups, notes, wanted = _orientations(mechanism), {}, [], {}
    for axis in _axes(mechanism):
        root, rotation = found[axis.body]
        groups.setdefault(root, []).append((axis, rotation @ axis.direction))
    for root, group in groups.items():
        axes, directions = zip(*group)
        means, belongs = _parallel(axes, np.array(directions), tolerance, root, notes)
        _square(means, axes, belongs, tolerance, root, notes)
        for axis, direction, number in zip(axes, directions, belongs):
            mean = means[number] * math.copysign(1.0, means[number] @ direction)
            if np.linalg.norm(mean - direction) > EXACT:
                wanted[axis.key] = found[axis.body][1].T @ mean
    if not wanted:
        return mechanism, []
    return replace(mechanism, joints=tuple(
        _with_axes_of_joint(joint, *(wanted.get(('joints', number, side))
                                     for side in ('parent', 'child')))
        for number, joint in enumerate(mechanism.joints)), cut_joints=tuple(
        _with_axes_of_cut(cut, *(wanted.get(('cut_joints', number, side)) for side in 'ab'))
        for number, cut in enumerate(mechanism.cut_joints))), notes


def _parallel(axes, directions, tolerance, root, notes):
    """Return the directions that differ, shape (n, 3), and which of them each axis has."""
    means, belongs = np.zeros((0, 3)), []
    # Axes that cannot be changed come first.
    for number in sorted(range(len(axes)), key=lambda number: not axes[number].fixed):
        across = np.linalg.norm(cross(means, directions[number]), axis=1)
        nearest = int(np.argmin(across)) if len(across) else 0
        if not len(across) or across[nearest] > tolerance:
            nearest, means = len(means), np.vstack([means, directions[number]])
        belongs.append((number, nearest))
    belongs = [nearest for _, nearest in sorted(belongs)]
    for number in range(len(means)):
        own = [place for place, one in enumerate(belongs) if one == number]
        far = float(np.linalg.norm(cross(means[number], directions[own]), axis=1).max())
        if far > EXACT:
            notes.append(_Change('axes that agree to', far, '', 'parallel',
                                 _names([axes[k] for k in own], root)))
            plain = np.round(means[number])
            if np.abs(means[number] - plain).max() <= tolerance and not any(
                    axes[k].fixed for k in own):
                means[number] = plain
    return means, belongs


def _square(means, axes, belongs, tolerance, root, notes):
    """Set directions, shape (n, 3), at right angles where they nearly are, in place."""
    cosines = np.abs(means @ means.T)
    near = cosines <= tolerance
    done = []
    # Those that are across the most others, such as the hinges of a plane, stay as they are.
    for number in sorted(range(len(means)), key=lambda number: -near[number].sum()):
        others = [other for other in done if near[number, other]]
        far = float(cosines[number, others].max(initial=0.0))
        if far > EXACT and not any(axis.fixed for axis, one in zip(axes, belongs)
                                   if one == number):
            basis = np.linalg.qr(means[others[:2]].T)[0]
            moved = means[number] - basis @ (basis.T @ means[number])
            moved /= np.linalg.norm(moved)
            if np.linalg.norm(moved - means[number]) <= 3.0 * tolerance:
                means[number] = moved
                notes.append(_Change('axes at right angles to', far, '', 'exactly so', _names(
                    [axis for axis, one in zip(axes, belongs) if one in (number, *others)],
                    root)))
        done.append(number)


def _least_turn(one, other):
    """Return the rotation, shape (3, 3), that turns a unit vector to another one near to it."""
    vector, cosine = cross(one, other), one @ other
    x, y, z = vector
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return _UNIT + skew + skew @ skew / (1.0 + cosine)


def _unit(vector):
    """Return a direction as a tuple; what is next to 0, 1 or -1 is that."""
    near = np.round(vector)
    vector = np.where(np.abs(vector - near) < EXACT, near, vector)
    return tuple((vector / np.linalg.norm(vector) + 0.0).tolist())


def _held(rotation):
    """Return the quaternion of a rotation; entries next to 0, 1 and -1 are these."""
    near = np.round(rotation)
    return quaternion_of(np.where(np.abs(rotation - near) < EXACT, near, rotation))


def _with_axes_of_joint(joint, parent, child):
    """Return a joint with other axes in its parent's and child's frames, None as they are."""
    if parent is None and child is None:
        return joint
    turn = _turn(joint)
    if joint.type == PRISMATIC:
        return replace(joint, axis=_unit(child))
    first = _UNIT[2] if joint.type == PLANAR else np.array(joint.axis)
    parent = turn @ first if parent is None else parent
    if joint.type in _HINGES and child is not None:
        first = np.array(_unit(child))
        joint = replace(joint, axis=_unit(child))
    elif joint.type == UNIVERSAL and child is not None:
        joint = replace(joint, second_axis=_unit(child))
    return replace(joint, orientation=_held(_least_turn(turn @ first, parent) @ turn))


def _with_axes_of_cut(cut, a, b):
    """Return a cut joint with other axes in the frames of body A and B, None as they are."""
    if a is None and b is None:
        return cut
    turn = _turn(cut)
    if b is not None:
        cut = replace(cut, axis_b=_unit(b))
    if a is not None and cut.type in CUT_WITH_AXIS_A:
        cut = replace(cut, axis_a=_unit(a))
    if cut.type == HELICAL:
        along = turn.T @ cut.axis_b if a is None else a
    elif cut.type in (REVOLUTE, CYLINDRICAL, PLANAR) and cut.orientation != UNTURNED:
        along = np.array(cut.axis_a)
    else:
        return cut
    return replace(cut, orientation=_held(
        _least_turn(turn @ along, np.array(cut.axis_b)) @ turn))


@dataclass
class _Place:
    """The point of a joint, or of a cut joint, on one body."""

    name: str
    key: Optional[tuple]  # The record's section, number and field; None where it cannot be moved
    point: np.ndarray  # Shape (3,): In the body's frame [m]
    direction: Optional[np.ndarray]  # Shape (3,): Of the axis that it may lie anywhere on


def _lifted(place):
    return np.array([*place, 0.0][:3])


def _places(mechanism):
    """Return the points of joints in loops by body, those at the origin first."""
    looped = _in_loops(mechanism)
    found = {GROUND: [], **{body.name: [] for body in mechanism.bodies}}
    first, second = [], []
    balls = (SPHERICAL, UNIVERSAL)
    for number, joint in enumerate(mechanism.joints):
        if joint.name not in looped or joint.type not in (*_HINGES, *balls):
            continue
        axis = None if joint.type in balls else _UNIT[2] if mechanism.planar else (
            np.array(joint.axis))
        first.append((joint.child, _Place(joint.name, None, np.zeros(3), axis)))
        second.append((joint.parent, _Place(
            joint.name, ('joints', number, 'position'), _lifted(joint.position),
            None if axis is None else _turn(joint) @ axis)))
    for number, cut in enumerate(mechanism.cut_joints):
        if cut.type not in (*_HINGES, *balls, DISTANCE):
            continue
        for side in 'ab':
            axis = _UNIT[2] if mechanism.planar else getattr(cut, f'axis_{side}')
            if cut.type == HELICAL and side == 'a':
                axis = _turn(cut).T @ cut.axis_b
            if cut.type in (*balls, DISTANCE) and not mechanism.planar:
                axis = None
            second.append((getattr(cut, f'body_{side}'), _Place(
                cut.name, ('cut_joints', number, f'point_{side}'),
                _lifted(getattr(cut, f'point_{side}')),
                None if axis is None else np.array(axis))))
    for body, place in (*first, *second):
        found[body].append(place)
    return found


def _with_places(mechanism, tolerance):
    """Move the points of joints to where axes and points meet that nearly do."""
    size, notes, moved = extent(mechanism), [], {}
    for body, places in _places(mechanism).items():
        points = np.array([place.point for place in places]).reshape(-1, 3)
        directions = np.array([np.zeros(3) if place.direction is None else place.direction
                               for place in places]).reshape(-1, 3)
        for number, place in enumerate(places):
            if place.key is None or not number:
                continue
            rows, gaps, others = _meetings(points, directions, number, tolerance * size)
            far = float(np.abs(gaps).max(initial=0.0))
            if far <= EXACT * size:
                continue
            move = np.linalg.lstsq(rows, gaps, rcond=1e-6)[0]
            if np.linalg.norm(move) <= 3.0 * tolerance * size:
                points[number] += move
                moved[place.key] = points[number]
                notes.append(_Change('axes and points that miss by', far, ' m', 'meeting', _names(
                    [place, *(places[k] for k in others)], body)))
    return _with_points(mechanism, moved), notes


def _meetings(points, directions, number, reach):
    """
    Return what has to be met by moving a point by x: ``rows`` @ x = ``gaps``.

    With earlier points, or axes through them, within a reach [m]; and the numbers of these.
    ``directions`` of axes, shape (n, 3), are zero where it matters where a point is.
    """
    own, axes = directions[number], directions[:number]
    apart = points[:number] - points[number]
    normals = cross(axes, own)
    sines = np.linalg.norm(normals, axis=1)
    # Along an axis of the two it does not matter where a point is.
    along = np.where(axes.any(axis=1)[:, None], axes, own)
    far = np.linalg.norm(apart - np.sum(apart * along, axis=1)[:, None] * along, axis=1)
    skew = sines > 10.0 * EXACT
    far[skew] = np.abs(np.sum(apart[skew] * normals[skew], axis=1)) / sines[skew]
    others, rows = np.flatnonzero(far <= reach).tolist(), [np.zeros((0, 3))]
    gaps = [np.zeros(0)]
    for other in others:
        across = _UNIT
        if skew[other]:
            across = normals[other][None] / sines[other]
        elif along[other].any():
            # The projection across the axis, in two rows.
            across = np.linalg.svd(along[other][None])[2][1:]
        rows.append(across)
        gaps.append(across @ apart[other])
    return np.vstack(rows), np.concatenate(gaps), others


def _with_centers(mechanism, tolerance):
    """Put the axes of loops of hinges that meet in one point where each hinge has it once."""
    size, notes, moved = extent(mechanism), [], {}
    carriers = {joint.child: joint for joint in mechanism.joints}
    places = {body: {place.name: place for place in own}
              for body, own in _places(mechanism).items()}
    for cut in mechanism.cut_joints:
        loop = [cut, *_around(cut, carriers).values()]
        if any(one.type != REVOLUTE for one in loop):
            continue
        hinges = {}
        for one in loop:
            for body in _bodies(one):
                hinges.setdefault(body, []).append(one.name)
        centers = {body: _center(*(places[body][name] for name in names), size)
                   for body, names in hinges.items()}
        if any(center is None for center in centers.values()):
            continue
        for one in loop:
            # A point that can be moved, the parent's, comes first.
            first, second = (places[body][one.name] for body in _bodies(one))
            along = [place.direction @ (centers[body] - place.point)
                     for body, place in zip(_bodies(one), (first, second))]
            far = along[0] - along[1]
            if EXACT * size < abs(far) <= tolerance * size:
                first.point = first.point + far * first.direction
                moved[first.key] = first.point
                notes.append(_Change('axes and points that miss by', abs(float(far)), ' m',
                                     'meeting', _names(loop)))
    return _with_points(mechanism, moved), notes


def _bodies(record):
    """Return the two bodies of a joint or cut joint, the parent first."""
    return getattr(record, 'parent', None) or record.body_a, (
        getattr(record, 'child', None) or record.body_b)


def _center(one, other, size):
    """Return where two axes on a body meet, shape (3,); None where they do not in one point."""
    rows = np.column_stack([one.direction, -other.direction])
    if np.linalg.norm(cross(one.direction, other.direction)) <= EVERYDAY:
        return None
    ways = np.linalg.lstsq(rows, other.point - one.point, rcond=None)[0]
    ends = one.point + ways[0] * one.direction, other.point + ways[1] * other.direction
    if np.linalg.norm(ends[0] - ends[1]) > 100.0 * EXACT * size:
        return None
    return ends[0]


def _with_points(mechanism, moved):
    """Return a mechanism with points at other places, by section, number and field."""
    sections = {}
    for (section, number, key), point in moved.items():
        records = sections.setdefault(section, list(getattr(mechanism, section)))
        length = len(getattr(records[number], key))
        records[number] = replace(records[number], **{
            key: tuple((point[:length] + 0.0).tolist())})
    return replace(mechanism, **{key: tuple(one) for key, one in sections.items()})


def _with_loops(mechanism, tolerance):
    """Close loops along directions in which no joint of theirs moves, where they nearly are."""
    size, notes, moved = extent(mechanism), [], {}
    carriers = {joint.child: joint for joint in mechanism.joints}
    frames = {GROUND: (_UNIT, np.zeros(3))}

    def frame(body):
        chain = [body]
        while chain[-1] not in frames:
            chain.append(carriers[chain[-1]].parent)
        for one in chain[-2::-1]:
            joint = carriers[one]
            rotation, origin = frames[joint.parent]
            frames[one] = rotation @ _turn(joint), origin + rotation @ _lifted(joint.position)
        return frames[body]

    for number, cut in enumerate(mechanism.cut_joints):
        if cut.type not in _HOLDING:
            continue
        (a, origin_a), (b, origin_b) = frame(cut.body_a), frame(cut.body_b)
        across = _never_moved(mechanism, cut, carriers, frame)
        gap = origin_a + a @ _lifted(cut.point_a) - origin_b - b @ _lifted(cut.point_b)
        open_by = across.T @ (across @ gap)
        far = float(np.linalg.norm(open_by))
        if EXACT * size < far <= tolerance * size:
            moved['cut_joints', number, 'point_a'] = _lifted(cut.point_a) - a.T @ open_by
            notes.append(_Change('both sides of a loop that differ by', far, ' m', 'equal',
                                 _names([cut])))
    return _with_points(mechanism, moved), notes


def _never_moved(mechanism, cut, carriers, frame):
    """Return unit vectors, shape (n, 3), along which no joint of a loop moves its bodies."""
    turns, slides = [], []
    planar = mechanism.planar
    for joint in _around(cut, carriers).values():
        rotation = frame(joint.child)[0]
        axis = None if joint.axis is None else rotation @ joint.axis
        if planar:
            axis = rotation[:, 2 if joint.type == REVOLUTE else 0]
        if joint.type == REVOLUTE:
            turns.append(axis)
        elif joint.type == PRISMATIC:
            slides.append(axis)
        elif joint.type == PLANAR:
            turns.append(rotation[:, 2])
        elif joint.type != FIXED:
            return np.zeros((0, 3))
    own = frame(cut.body_b)[0] @ (_UNIT[2] if planar else np.zeros(3) if cut.axis_b is None
                                  else np.array(cut.axis_b))
    if cut.type in (PLANAR, POINT_ON_PLANE):
        turns.append(own)
    elif cut.type == PRISMATIC:
        slides.append(frame(cut.body_b)[0] @ about(_UNIT[2], cut.angle)[:, 0] if planar else own)
    if turns:
        parallel = all(np.linalg.norm(cross(turns[0], turn)) <= 10.0 * EXACT
                       for turn in turns)
        across = all(abs(turns[0] @ slide) <= 10.0 * EXACT for slide in slides)
        return turns[0][None] if parallel and across else np.zeros((0, 3))
    if not slides:
        return _UNIT
    _, singular, rows = np.linalg.svd(np.array(slides))
    return rows[int(np.sum(singular > 10.0 * EXACT)):]
