# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
From a described machine to a mechanism: fixed links joined, a tree, cuts.

Joints that are driven stay in the tree; loops are cut, where there is a choice, at the joints
with the most freedoms, which leave the fewest equations.
"""

from dataclasses import dataclass, field, replace
import re
from typing import NamedTuple

import numpy as np

from .model import Connection, free_name, NO_LIMIT, Omission, UNITS
from .pose import IDENTITY, Pose, unturned
from .visuals import placed
from ..mechanism.fields import FieldError
from ..mechanism.inertia import moments_in
from ..mechanism.mechanism import (
    Body, COUPLED, Coupling, CouplingLaw, CUT_WITH_AXIS_A, CUT_WITH_AXIS_B, CUT_WITH_ORIENTATION,
    CutJoint, FIXED, FREE, GROUND, HELICAL, Joint, JOINT_FREEDOMS, Mechanism, MechanismError,
    PLANAR, Point, SPATIAL_CUT_JOINT_EQUATIONS, TOLERANCE, UNIVERSAL, UNTURNED, WITH_AXIS)
from ..mechanism.rotations import quaternion_of
from ..mechanism.validation import checked, moments_text, POSSIBLE, possible

# Entries of rotations this near to 0, 1 and -1 are rounded to these.
ROUNDING = 1e-14
# What is fixed twice may differ by so much [m, or sines of angles].
AGREEMENT = 1e-9
# Moments of inertia that are off by so little of the largest one are those of rounded digits.
DIGITS = 1e-9
# The mass, in parts of the heaviest link's, of one that is given an inertia alone.
LEAST_MASS = 1e-12
MEND = ' (mend_inertias: true in a scene, or --mend-inertias, takes {})'
# Gear ratio of rotors whose carrier's turning does not count.
ENDLESS = 1e12
# What YAML reads as something else than text.
NO_NAMES = ('true', 'false', 'null', 'yes', 'no', 'on', 'off')
# Effect by the attribute of a joint that asks for it, and the key of the number.
JOINT_EFFECTS = {'damping': ('joint_damping', 'coefficient'),
                 'friction': ('joint_friction', 'coulomb'),
                 'armature': ('rotor', 'inertia'),
                 'stiffness': ('joint_spring', 'stiffness')}
# So many elements that something is left out of are named.
MOST_NAMED = 4
# Reasons why elements have no influence on the motion.
FOR_OTHERS = re.compile('for (pictures|sensors|programs|controllers|another)|names |not drawn'
                        f'|{GROUND} is')


@dataclass(frozen=True)
class Imported:
    """A mechanism with the other contents of its file."""

    mechanism: Mechanism
    #: Where joints start that do not start at zero: the coordinate of a joint of one freedom [rad
    #: or m], all of one with an orientation (dict of str to float or tuple of floats).
    position: dict
    #: Keys of the effects as a scene has them, gravity among them (dict of str to dict).
    effects: dict = field(default_factory=dict)
    #: Least and largest coordinate of joints of one degree of freedom, None where there is none
    #: (dict of str to tuple of 2).
    limits: dict = field(default_factory=dict)
    #: Largest torque and speed of driven joints of one freedom, None where there is none (dict of
    #: str to tuple of 2).
    drives: dict = field(default_factory=dict)
    #: Omitted elements that affect the motion (list of model.Omission).
    omitted: list = field(default_factory=list)
    #: Other omitted elements, with the reason (dict of str to str).
    ignored: dict = field(default_factory=dict)


class _Tree(NamedTuple):
    joints: list
    cuts: list


def mechanism_of(model, end_stops=None, mend_inertias=False, tolerance=TOLERANCE):
    """
    Return the mechanism, as ``Imported``, that a model describes as a reader of a format left it.

    Limits of joints become end stops of the stiffness ``end_stops`` [N m/rad or N/m], if given.
    Where ``mend_inertias``, moments of inertia of which one is larger than the sum of the other
    two are changed by as little as makes them possible, not refused. ``tolerance`` as of a
    Mechanism. MechanismError where it is not a mechanism, with the element of the file.
    """
    ignored, omitted = dict(model.ignored), list(model.omitted)
    model.check()
    joints = [_upright(_bounded(joint)) for joint in model.joints.values()]
    groups = _Groups(model, joints)
    moving = groups.moving(joints)
    tree = _spanning_tree(groups, moving)
    if not tree.joints:
        raise MechanismError(f'{model.path}: expected a joint that moves, got none')
    named = _Names(model)
    bodies, frames = _bodies(model, groups, tree, named, mend_inertias, ignored)
    ground = [*model.ground_visual, *(
        placed(one, groups.of[name][1]) for name in groups.links[GROUND] if name in model.links
        for one in model.links[name].visual)]
    mechanism = Mechanism(
        name=word(model.name), bodies=tuple(bodies),
        joints=tuple(_joint(joint, groups, frames, named) for joint in tree.joints),
        cut_joints=tuple(_cut(joint, groups, frames, named, end_stops is not None, omitted)
                         for joint in tree.cuts),
        couplings=tuple(_coupling(relation, tree, named) for relation in model.relations),
        points=tuple(_points(model, groups, frames, named)),
        description=f'From {model.path.name}.', ground_visual=tuple(ground), tolerance=tolerance)
    try:
        mechanism = checked(mechanism)
    except FieldError as error:
        raise MechanismError(_located(error, model, named)) from None
    if named.changed:
        ignored[f'characters of {named.changed} name(s)'] = (
            'names have letters, digits and underscores, each once')
    effects, position = _effects(
        model, groups, frames, mechanism, tree, named, end_stops, omitted, ignored)
    limits = {named.joint(joint.name): (joint.lower, joint.upper) for joint in tree.joints
              if JOINT_FREEDOMS[joint.type] == 1 and (joint.lower, joint.upper) != (None, None)}
    drives = {named.joint(joint.name): (joint.effort or None, joint.speed or None)
              for joint in tree.joints if joint.actuated and JOINT_FREEDOMS[joint.type] == 1
              and (joint.effort or joint.speed)}
    return Imported(mechanism, position, effects, limits, drives, omitted, ignored)


def _upright(joint):
    """Return a planar joint with the plane's normal as the z axis of its frame, others as is."""
    if joint.type != PLANAR or joint.closes:
        return joint
    normal = joint.axis
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    turned = Pose(np.column_stack([np.cross(across, normal), across, normal]), np.zeros(3))
    if abs(normal[2] - 1.0) < ROUNDING:
        turned = IDENTITY
    return replace(joint, in_parent=joint.in_parent @ turned, in_child=joint.in_child @ turned,
                   axis=None)


def _bounded(joint):
    """Return a joint without limits that limit nothing."""
    return replace(joint, **{
        key: None for key in ('lower', 'upper', 'effort', 'speed')
        if getattr(joint, key) is not None and abs(getattr(joint, key)) >= NO_LIMIT})


class _Groups:
    """Links that are fixed together: one body of each group, the ground among them."""

    def __init__(self, model, joints):
        self.of, self.links = {GROUND: (GROUND, IDENTITY)}, {GROUND: [GROUND]}
        neighbours = {}
        fixed = [joint for joint in joints if joint.type == FIXED and not joint.closes]
        for joint in fixed:
            across = joint.in_parent @ joint.in_child.inverse
            neighbours.setdefault(joint.parent, []).append((joint.child, across))
            neighbours.setdefault(joint.child, []).append((joint.parent, across.inverse))
        carried = {joint.child for joint in fixed}
        first = [name for name in model.links if name not in carried]
        for root in [GROUND, *first, *model.links]:
            if root in self.of and root != GROUND:
                continue
            self.of[root] = root, IDENTITY
            self.links[root] = [root]
            waiting = [root]
            while waiting:
                link = waiting.pop()
                for other, pose in neighbours.get(link, ()):
                    if other not in self.of:
                        self.of[other] = root, self.of[link][1] @ pose
                        self.links[root].append(other)
                        waiting.append(other)

    def place(self, link, pose):
        """Return the group of a link, and a pose on it in the group's frame."""
        group, at = self.of[link]
        return group, at @ pose

    def moving(self, joints):
        """Return the joints between different groups; refuse others that cannot be met."""
        found = []
        for joint in joints:
            (a, pose_a), (b, pose_b) = (self.place(joint.parent, joint.in_parent),
                                        self.place(joint.child, joint.in_child))
            if a != b:
                found.append(joint)
            elif joint.type != FIXED:
                raise MechanismError(f'{joint.where}: expected links that can move against each '
                                     f'other, got {joint.parent!r} and {joint.child!r}, which '
                                     'are fixed together')
            elif not all(np.allclose(one, other, rtol=0.0, atol=AGREEMENT)
                         for one, other in zip(pose_a, pose_b)):
                raise MechanismError(f'{joint.where}: expected the same place as that which '
                                     'other fixed joints give, got another')
        return found


def _spanning_tree(groups, joints):
    """Return the joints of a tree on the ground, outwards, and those that close loops."""
    root = {group: group for group in groups.links}

    def find(group):
        while root[group] != group:
            root[group] = root[root[group]]
            group = root[group]
        return group

    chosen, order = set(), sorted(
        (joint for joint in joints if not joint.closes),
        key=lambda joint: (not joint.actuated, JOINT_FREEDOMS[joint.type]))
    for joint in order:
        a, b = find(groups.of[joint.parent][0]), find(groups.of[joint.child][0])
        if a != b:
            root[a] = b
            chosen.add(joint.name)
    free = []
    for group in groups.links:
        if find(group) != find(GROUND):
            root[find(group)] = find(GROUND)
            free.append(_free(group, joints))
    joints = [*free, *joints]
    chosen |= {joint.name for joint in free}
    return _Tree(_outwards([joint for joint in joints if joint.name in chosen], groups),
                 [joint for joint in joints if joint.name not in chosen])


def _free(group, joints):
    """Return the free joint of a machine that nothing joins to the ground."""
    name = free_name(f'{group}_free', [joint.name for joint in joints])
    return Connection(name, FREE, GROUND, group, actuated=False)


def _outwards(joints, groups):
    """Return the joints with their parents on the side of the ground."""
    reached, left, turned = {GROUND}, list(joints), {}
    while left:
        waiting = []
        for joint in left:
            parent, child = groups.of[joint.parent][0], groups.of[joint.child][0]
            if parent in reached:
                reached.add(child)
                turned[joint.name] = joint
            elif child in reached:
                reached.add(parent)
                turned[joint.name] = _reversed(joint)
            else:
                waiting.append(joint)
        left = waiting
    return [turned[joint.name] for joint in joints]


def _reversed(joint):
    """Return a joint with parent and child exchanged, its coordinate the same."""
    axis, other = joint.axis, joint.child_axis
    if joint.type == UNIVERSAL:
        axis, other = other, axis
    acting = {key: getattr(joint, key)[::-1] for key in JOINT_EFFECTS
              if isinstance(getattr(joint, key), tuple)}
    return replace(joint, parent=joint.child, child=joint.parent, in_parent=joint.in_child,
                   in_child=joint.in_parent, axis=None if axis is None else -axis,
                   child_axis=None if other is None else -other, **acting)


def _bodies(model, groups, tree, named, mend, ignored):
    """Return the bodies, and the pose of each body's frame in that of its group."""
    frames, bodies = {GROUND: IDENTITY}, {}
    largest = max((np.abs(link.inertia).max() for link in model.links.values()), default=0.0)
    for joint in tree.joints:
        group, frames_pose = groups.place(joint.child, joint.in_child)
        frames[group] = frames_pose
    for group in groups.links:
        if group == GROUND:
            continue
        mass, moment, about = 0.0, np.zeros(3), np.zeros((3, 3))
        parts, visual = [], []
        for name in groups.links[group]:
            link = model.links[name]
            pose = frames[group].inverse @ groups.of[name][1]
            inertia = _inertia_of(link, largest, mend, ignored)
            center = pose.place(link.center)
            parts.append((link.mass, center, pose.rotation @ inertia @ pose.rotation.T))
            visual += [placed(one, pose) for one in link.visual]
            mass += link.mass
            moment += link.mass * center
        center = moment / mass if mass > 0.0 else moment
        for part, place, inertia in parts:
            offset = place - center
            about += inertia + part * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        if mass == 0.0 and about.any():
            mass = _weighed(groups.links[group], model, mend, ignored)
        bodies[group] = Body(
            named.body(group), mass, _vector(center), _inertia(about) if mass > 0.0 else 0.0,
            massless=mass == 0.0, visual=tuple(visual))
    return [bodies[group] for group in groups.links if group in bodies], frames


def _inertia_of(link, largest, mend, ignored):
    """
    Return the inertia of a link, shape (3, 3); refuse, or mend, one that no body has.

    What is next to nothing beside the ``largest`` moment of all links, or beside what an offset
    by rounded digits makes of the mass, is mended in any case.
    """
    moments, axes = np.linalg.eigh(link.inertia)
    if possible(moments):
        return link.inertia
    listed = moments_text(moments)
    rounding = max(DIGITS * largest, link.mass * AGREEMENT ** 2)
    if moments[0] > -rounding:
        moments = np.maximum(moments, 0.0)
    beyond = moments[2] - moments[0] - moments[1]
    # The least change in the sum of squares; a negative moment is not a matter of rounded digits.
    mended = moments + max(beyond, 0.0) / 3.0 * np.array([1.0, 1.0, -1.0])
    if moments[0] < 0.0 or not (mend or beyond < rounding):
        hint = '' if moments[0] < 0.0 else MEND.format(moments_text(mended))
        raise MechanismError(f'{link.where}: expected {POSSIBLE}, got principal moments '
                             f'{listed}{hint}')
    ignored[f'moments {listed} of {link.name}, {moments_text(mended)} taken'] = (
        'no body has them: one is larger than the sum of the other two')
    return axes @ np.diag(mended) @ axes.T


def _weighed(group, model, mend, ignored):
    """Return the mass of a body that has an inertia and no mass: next to nothing, or an error."""
    mass = LEAST_MASS * (max(link.mass for link in model.links.values()) or 1.0)
    link = next(model.links[name] for name in group if model.links[name].inertia.any())
    if not mend:
        raise MechanismError(f'{link.where}: expected a positive mass, got 0 with an inertia that '
                             f'is not zero{MEND.format(f"{mass:.3g} kg")}')
    ignored[f'the mass 0 of {link.name}, {mass:.3g} kg taken'] = 'it has an inertia'
    return mass


def _joint(joint, groups, frames, named):
    """Return a joint of the tree."""
    parent, pose = groups.place(joint.parent, joint.in_parent)
    pose = frames[parent].inverse @ pose
    child = groups.of[joint.child][0]
    return Joint(
        named.joint(joint.name), joint.type, named.body(parent), named.body(child),
        _vector(pose.position), actuated=bool(joint.actuated),
        orientation=_orientation(pose.rotation),
        axis=_direction(joint.axis) if joint.type in WITH_AXIS else None,
        second_axis=_direction(joint.child_axis) if joint.type == UNIVERSAL else None,
        lead=joint.lead if joint.type == HELICAL else None)


def _cut(joint, groups, frames, named, stops, omitted):
    """Return a joint that closes a loop."""
    if joint.type not in SPATIAL_CUT_JOINT_EQUATIONS:
        raise MechanismError(f'{joint.where}: expected a type that a loop can be closed with, '
                             f'got {joint.type!r}')
    (a, pose_a), (b, pose_b) = (groups.place(joint.parent, joint.in_parent),
                                groups.place(joint.child, joint.in_child))
    pose_a, pose_b = frames[a].inverse @ pose_a, frames[b].inverse @ pose_b
    other = joint.axis if joint.child_axis is None else joint.child_axis
    if joint.type == UNIVERSAL and not joint.closes and abs(joint.axis @ other) > AGREEMENT:
        raise MechanismError(f'{joint.where}: expected two axes at right angles, where the loop '
                             'is closed by a universal joint, got others')
    single = joint.type in COUPLED
    acting = [key for key in JOINT_EFFECTS if np.any(getattr(joint, key))]
    if joint.actuated and not single:
        omitted.append(Omission('the drive', 'joint', joint.name,
                                'it has several degrees of freedom and closes a loop'))
    axis_a, axis_b = joint.axis, other
    held = joint.type in CUT_WITH_ORIENTATION
    if single and (joint.actuated or stops and (joint.lower, joint.upper) != (None, None)) or (
            acting and joint.type in (*COUPLED, UNIVERSAL)):
        # Its coordinate is that of the child, which is body A then, on the parent.
        (a, pose_a, axis_a), (b, pose_b, axis_b) = (b, pose_b, other), (a, pose_a, joint.axis)
        held = True
    return CutJoint(
        named.joint(joint.name), joint.type, named.body(a), named.body(b),
        _vector(pose_a.position), _vector(pose_b.position),
        axis_a=_direction(pose_a.rotation @ axis_a)
        if joint.type in CUT_WITH_AXIS_A else None,
        axis_b=_direction(pose_b.rotation @ axis_b) if joint.type in CUT_WITH_AXIS_B else None,
        orientation=_orientation(pose_b.rotation @ pose_a.rotation.T) if held else UNTURNED,
        lead=joint.lead, actuated=bool(single and joint.actuated))


def _coupling(relation, tree, named):
    """Return a coupling of joints."""
    kinds = {joint.name: joint.type for joint in tree.joints}
    for name in (*relation.factors, *(relation.law or ())[:1]):
        if kinds.get(name) not in COUPLED:
            raise MechanismError(
                f'{relation.where}: expected joints of one degree of freedom that move '
                f'and close no loop, '
                f'got {name!r}')
    return Coupling(named.coupling(relation.name), {
        named.joint(name): factor for name, factor in relation.factors.items()}, relation.offset,
        law=relation.law and CouplingLaw(named.joint(relation.law[0]), relation.law[1]))


def _points(model, groups, frames, named):
    """Yield the frames that a file names, and the links that were merged into others."""
    merged = {name: (name, IDENTITY) for group, links in groups.links.items()
              for name in links if name != group}
    centers = [*_lifted(model, groups), *(model.links[drag.link] for drag in model.drags)]
    lifted = {_center(link): (link.name, unturned(link.center)) for link in centers}
    ends = {_end(spring, number): end for spring in (*model.springs, *model.ropes)
            for number, end in enumerate(spring.ends)}
    for name, (link, pose) in {**merged, **model.frames, **lifted, **ends}.items():
        if name in groups.links:
            continue
        group, pose = groups.place(link, pose)
        yield Point(named.body(name), named.body(group),
                    _vector((frames[group].inverse @ pose).position))


def _lifted(model, groups):
    """Return the links, of those that move, whose weight is compensated."""
    return [link for name, link in model.links.items()
            if groups.of[name][0] != GROUND and link.lifted(model.gravity).any()]


def _center(link):
    return f'{link.name}_center_of_mass'


def _end(spring, number):
    return f'{spring.name}_end_{number + 1}'


def _effects(model, groups, frames, mechanism, tree, named, end_stops, omitted, ignored):
    """Return the effects on the joints, as in a scene, and their start."""
    effects, position = {'gravity': {'type': 'gravity', 'acceleration': model.gravity}}, {}
    if not any(model.gravity):
        effects = {}
    for link in _lifted(model, groups):
        point = named.body(_center(link))
        effects[f'lift_{point}'] = {'type': 'external_force', 'point': point,
                                    'force': _vector(link.lifted(model.gravity))}
    for spring in model.springs:
        point_a, point_b = (named.body(_end(spring, number)) for number in range(2))
        effects[f'spring_{point_a}'] = {
            'type': 'point_spring', 'point_a': point_a, 'point_b': point_b,
            'stiffness': spring.stiffness, 'damping': spring.damping, 'free_length': spring.rest}
    _add_along(model, groups, frames, named, end_stops, effects, ignored)
    limits, drives = [], []
    closing = [joint for joint in tree.cuts if joint.type in mechanism.measured_types]
    for joint in (*tree.joints, *closing):
        name = named.joint(joint.name)
        several = JOINT_FREEDOMS[joint.type] > 1
        for key in JOINT_EFFECTS:
            _act(joint, key, mechanism, name, effects, omitted)
        if joint.lower is not None or joint.upper is not None:
            if end_stops is None or several:
                limits.append(name)
            else:
                effects[f'end_stop_{name}'] = {
                    'type': 'end_stop', 'joint': name, 'stiffness': end_stops,
                    **{key: getattr(joint, key) for key in ('lower', 'upper')
                       if getattr(joint, key) is not None}}
        if joint.actuated and (joint.effort or joint.speed):
            drives.append(name)
        if np.any(joint.start) and joint not in closing:
            position[name] = joint.start
    if limits:
        ignored[f'limits of {len(limits)} joint(s)'] = 'no end stops unless they are asked for'
    if drives:
        ignored[f'limits of {len(drives)} drive(s)'] = 'give them as effects of type actuator'
    return effects, position


def _add_along(model, groups, frames, named, end_stops, effects, ignored):
    """Add ropes, belts and drag; report limits without a stiffness as left out."""
    limits = [one for one in model.ropes if one.stiffness is None] + [
        one for one in model.belts if one.limit]
    if limits and end_stops is None:
        ignored[f'limits of {len(limits)} tendon(s)'] = 'no end stops unless they are asked for'
    for rope in model.ropes:
        stiffness = rope.stiffness or end_stops
        if stiffness is not None:
            effects[free_name(f'cable_{word(rope.name)}', effects)] = {
                'type': 'cable', 'points': [named.body(_end(rope, number))
                                            for number in range(len(rope.ends))],
                'stiffness': stiffness, 'free_length': rope.length}
    for belt in model.belts:
        stiffness = (end_stops,) if belt.limit else belt.stiffness
        arms = {named.joint(joint): arm for joint, arm in belt.arms.items()}
        for key, acts, values in (
                ('tendon', stiffness != (None,) and any((*stiffness, *belt.damping)),
                 {'stiffness': stiffness, 'damping': belt.damping, 'rest': belt.rest}),
                ('tendon_friction', belt.friction, {'coulomb': belt.friction}),
                ('tendon_inertia', belt.inertia, {'inertia': belt.inertia})):
            if acts:
                effects[free_name(f'{key}_{word(belt.name)}', effects)] = {
                    'type': key, 'arms': arms, **values}
    for drag in model.drags:
        group, pose = groups.place(drag.link, Pose(drag.rotation, np.zeros(3)))
        point = named.body(_center(model.links[drag.link]))
        effects[f'drag_{point}'] = {
            'type': 'fluid_drag', 'point': point, 'linear': drag.linear,
            'quadratic': drag.quadratic, 'turning_linear': drag.turning_linear,
            'turning_quadratic': drag.turning_quadratic, 'flow': drag.flow,
            'orientation': {'quaternion': _orientation(
                (frames[group].inverse @ pose).rotation)}}


def _act(joint, key, mechanism, name, effects, omitted):
    """Add effects in a joint's degrees of freedom, of one kind; report others as left out."""
    value, (kind, number) = getattr(joint, key), JOINT_EFFECTS[key]
    if not np.any(value):
        return
    places = (mechanism.coordinates if name in mechanism.coordinates.rates
              else mechanism.cut_coordinates)
    freedoms = list(places.names[places.rates[name]])
    if key == 'armature' and joint.type not in COUPLED and places is not mechanism.coordinates:
        unit = UNITS[key][bool(places.lengths[places.rates[name]][0])]
        omitted.append(Omission(key, 'joint', joint.name, 'no effect has it in joints of several '
                                'degrees of freedom that close loops',
                                float(np.max(np.abs(value))), unit))
        return
    if key in ('stiffness', 'armature') and name in places.with_orientation:
        # They act against the whole turn.
        freedoms[-3:] = [name]
    values, rests = (np.broadcast_to(some, len(freedoms)).tolist()
                     for some in (value, joint.rest))
    for freedom, one, rest in zip(freedoms, values, rests):
        if not one:
            continue
        acting = effects[free_name(f'{key}_{word(freedom)}', effects)] = {
            'type': kind, 'joint': freedom, number: one}
        if key == 'armature':
            # Other programs leave the turning of the carrier out, as one that turns
            # without end does: the product of inertia and ratio is next to nothing.
            acting.update(inertia=one / ENDLESS ** 2, gear_ratio=ENDLESS)
        if key == 'stiffness' and np.any(joint.rest):
            acting['rest'] = rest


class _Names:
    """Valid names for those of a file: of joints, and of bodies and points."""

    def __init__(self, model):
        self._of = {'joint': {}, 'body': {GROUND: GROUND}, 'coupling': {}}
        # Couplings and joints share their names.
        joints = {GROUND}
        self._taken = {'joint': joints, 'body': {GROUND}, 'coupling': joints}
        self.changed = 0
        for name in model.links:
            self.body(name)
        for name in model.joints:
            self.joint(name)

    def joint(self, name):
        return self._name('joint', name)

    def body(self, name):
        return self._name('body', name)

    def coupling(self, name):
        return self._name('coupling', name)

    def original(self, kind, name):
        """Return the name in the file that a name of the mechanism comes from."""
        return next((old for old, new in self._of[kind].items() if new == name), None)

    def _name(self, kind, name):
        known, taken = self._of[kind], self._taken[kind]
        if name not in known:
            found, number = word(name), 1
            while found in taken:
                number += 1
                found = f'{word(name)}_{number}'
            known[name] = found
            taken.add(found)
            self.changed += found != name
        return known[name]


def word(name):
    """Return a name of letters, digits and underscores that starts with a letter."""
    found = re.sub(r'[^A-Za-z0-9_]', '_', name)
    plain = re.match('[A-Za-z]', found) and found.lower() not in NO_NAMES
    return found if plain else f'x{found}'


def _located(error, model, named):
    """Return an error of the mechanism as one of the file's element."""
    section, *rest = [*error.path, None]
    kind = {'bodies': 'body', 'joints': 'joint', 'cut_joints': 'joint'}.get(section)
    name = named.original(kind, rest[0]) if kind else None
    record = (model.links if kind == 'body' else model.joints).get(name)
    return f'{record.where if record else model.path}: {error}'


def lines(imported, lever):
    """
    Return omissions, a line for each reason: those that move bodies first, by size.

    ``lever`` is the machine's size, at which turning and sliding are compared [m].
    """
    groups = {}
    for one in sorted(imported.omitted, key=lambda one: -one.force(lever)):
        groups.setdefault(one.reason, {}).setdefault(
            (one.quantity, one.kind, one.unit), []).append(one)
    moving = [f'left out of the motion, {reason}: ' + '; '.join(
        _together(*key, some) for key, some in parts.items()) for reason, parts in groups.items()]
    ignored = imported.ignored
    return moving + [
        f'left out, {reason}: '
        + ', '.join(what for what, why in ignored.items() if why == reason)
        for reason in sorted(dict.fromkeys(ignored.values()),
                             key=lambda reason: bool(FOR_OTHERS.match(reason)))]


def _together(quantity, kind, unit, omissions):
    """Return the omissions of several elements in words."""
    names = ', '.join(dict.fromkeys(one.name for one in omissions[:MOST_NAMED]))
    if len(omissions) > MOST_NAMED:
        names += f' and {len(omissions) - MOST_NAMED} more'
    size = '' if np.isinf(omissions[0].size) else (
        f' ({"up to " if len(omissions) > 1 else ""}{omissions[0].size:.3g}{unit and " "}{unit})')
    return f'{quantity} of {kind} {names}{size}'


def _vector(values):
    return tuple((np.asarray(values, dtype=float) + 0.0).tolist())


def _direction(axis):
    nearest = np.round(axis)
    axis = np.where(np.abs(axis - nearest) < ROUNDING, nearest, axis) + 0.0
    return _vector(axis / np.linalg.norm(axis))


def _orientation(rotation):
    nearest = np.round(rotation)
    near = np.abs(rotation - nearest) < ROUNDING
    return quaternion_of(np.where(near, nearest, rotation))


def _inertia(about):
    values = _vector(moments_in(about))
    return values if any(values[3:]) else values[:3]
