# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
SDF: one model with joints between any links, in loops as well.

Poses are relative to the frames that they name, axes expressed in them. A part of the model that
nothing joins to the world floats. ``<drake:ball_constraint>`` closes a loop, too.
"""

import math
from pathlib import Path

import numpy as np

from .model import (
    Connection, free_name, Link, Model, MOMENTS, NO_CONTACTS, Omission, ReadOptions,
    Relation)
from .pose import IDENTITY, Pose, unturned
from .programs import add_programs
from .sdf_parts import (
    FALSE, flattened, included, MODEL, OWN_AXES, renamed, SCOPE, TRUE, version_of, WORLD)
from .visuals import color_in, placed, visuals
from .xml_file import Element, read_xml
from .xml_omissions import leave_out
from ..mechanism.fields import among, nearest
from ..mechanism.inertia import inertia_matrix
from ..mechanism.mechanism import (
    FIXED, FREE, GROUND, HELICAL, MechanismError, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from ..mechanism.rotations import of_angles, of_quaternion

TYPES = {'revolute': REVOLUTE, 'continuous': REVOLUTE, 'prismatic': PRISMATIC, 'fixed': FIXED,
         'ball': SPHERICAL, 'universal': UNIVERSAL, 'revolute2': UNIVERSAL, 'screw': HELICAL}
GEARBOX = 'gearbox'
# Types whose limit of effort shows whether they are driven.
DRIVEN = (REVOLUTE, PRISMATIC, HELICAL, UNIVERSAL)
# Limits beyond this limit nothing.
ENDLESS = 1e15
# First version of the converters for joints in files of another format.
JOINTS_ALONE = (1, 7)
REASONS = {
    'visual': 'for pictures', 'material': 'for pictures', 'collision': NO_CONTACTS,
    'self_collide': NO_CONTACTS, 'plugin': 'for a simulator', 'sensor': 'for sensors',
    'light': 'for pictures', 'scene': 'for pictures', 'gui': 'for pictures',
    'physics': 'for a simulator',
    'enable_wind': 'for a simulator',
    'allow_auto_disable': 'for a simulator'}


def read_sdf(path, options=ReadOptions()):
    """
    Return the Model in an SDF file: its only model, or one of a world.

    Models that are static are ground; models in it, also of other files, are parts of it.

    Raises MechanismError with file, line and element.
    """
    path = Path(path)
    root = read_xml(path, ('sdf',))
    version = version_of(root)
    world = root.child('world')
    where = root if world is None else world
    where.get('name')
    models, missing = [(model, version) for model in where.all('model')], []
    written = {id(model): model for model, _ in models}
    for element in where.all('include'):
        try:
            models.append(included(element, options)[:2])
            written[id(models[-1][0])] = element
        except MechanismError as error:
            missing.append((element, error))
    element, version, still = _chosen(where, models, missing, options)
    model = Model(element.get('name') or path.stem, path)
    for include, error in missing:
        model.omitted.append(Omission(
            'the model', 'include', include.required('uri').text, 'its file was not found'))
    others = [one for one, _ in models if one is not element and one not in still]
    if others:
        names = ', '.join(one.get('name') for one in others)
        model.ignored[f'the models {names}'] = 'one is simulated at a time'
    if world is not None:
        _join_to_world(element, where, still, model)
        apart = [written[id(one)] for one in others]
        where.children = [child for child in where.children
                          if child.tag != 'joint' and child not in apart]
    around = {one.word('name'): one for one in where.all('frame')}
    around.update((one.get('name'), one) for one, _ in models if not one.get('placement_frame'))
    flattened(element, version, options)
    reader = _Reader(element, model, version, around=around)
    gravity = world and world.child('gravity')
    if gravity:
        model.gravity = tuple(gravity.values(gravity.text, 3, 'gravity'))
    reader.read()
    for one, own in models:
        if one in still:
            flattened(one, own, options)
            model.ground_visual += _Reader(one, model, own, around=around).drawn()
    leave_out(model, root, REASONS, options.ignore)
    return model


def _chosen(where, models, missing, options):
    """Return the model to simulate, its version, and the static models."""
    moving, still = {}, []
    for model, version in models:
        static = model.child('static')
        if static is not None and static.text in TRUE:
            still.append(model)
        else:
            moving[model.word('name')] = model, version
    if options.model is not None and options.model not in moving:
        raise where.error(f'--model to be one of {among(moving)}', repr(options.model),
                          nearest(options.model, moving))
    if not moving:
        if missing:
            raise missing[0][1]
        raise where.error('a model that moves', 'static ones' if still else 'none')
    if options.model is None and len(moving) > 1:
        raise where.error('one <model> that moves', f'{len(moving)}: {among(moving)}',
                          '--model NAME, or model: NAME in a scene, takes one')
    return (*moving[options.model or next(iter(moving))], still)


def _join_to_world(element, where, still, model):
    """Move the joints that fix a model to the world's static parts into the model."""
    prefix = f'{element.get("name")}{SCOPE}'
    fixed = tuple(f'{one.get("name")}{SCOPE}' for one in still)
    for joint in where.all('joint'):
        parent, child = (joint.required(tag) for tag in ('parent', 'child'))
        ends = [end.text for end in (parent, child)]
        if not any(end.startswith(prefix) for end in ends):
            continue
        if child.text.startswith(prefix) and (
                parent.text == WORLD or parent.text.startswith(fixed)):
            parent.text = WORLD
            renamed(joint, lambda frame: frame.removeprefix(prefix))
            element.children.append(joint)
            continue
        model.omitted.append(Omission(
            'the constraint', 'joint', joint.word('name'),
            'joints between models are read where the child moves and the parent stands still'))


def add_parts(elements, model, poses):
    """
    Add the SDF links and joints in elements to a model in another format.

    ``poses`` are those of its links in the frame of the model, as they are drawn. A joint between
    two of these links closes a loop. Returns the poses of the links that were added.
    """
    parts = [part for element in elements for part in element.all('link', 'joint', 'frame')]
    if not parts:
        return {}
    whole = Element('model', {}, parts[0].source, parts[0].line)
    whole.children = parts
    return _Reader(whole, model, JOINTS_ALONE, poses).add_parts()


class _Reader:
    """
    Records from one element model.

    Its frames are found beginning with poses of some in that of the model, those of links of a
    model in another format among them.
    """

    def __init__(self, element, model, version, found=(), around=()):
        """Collect every frame with its given pose; ``around``: those of the world."""
        self.element, self.model, self.version = element, model, version
        self.around = dict(around)
        self.links, self.joints = element.all('link'), element.all('joint')
        # Joints that mimic others: the element, the joint's name, multiplier and offset.
        self.mimics = []
        # By frame: the element with its pose, and the frame of that pose by default.
        self.given, self.found = {}, {MODEL: IDENTITY, **dict(found)}
        for kind, parts in (('link', self.links), ('frame', element.all('frame')),
                            ('joint', self.joints)):
            for part in parts:
                name = part.word('name')
                if name in self.given:
                    raise part.error('every name once', f'{name!r} again')
                before = MODEL
                if kind == 'frame':
                    before = part.get('attached_to') or MODEL
                elif kind == 'joint':
                    before = self._end(part, 'child')
                self.given[name] = part, before

    def _link_name(self, frame):
        """Return the name of a link, or of the world, in the model."""
        if frame == WORLD and frame not in self.model.links:
            return GROUND
        if self.version == JOINTS_ALONE:
            # The other format has given a link of that name another one, unless it is the ground.
            return frame
        return self.model.link_name(frame, self.given)

    def read(self):
        element, model = self.element, self.model
        self._place()
        self._add_links()
        for joint in self.joints:
            if joint.get('type') != GEARBOX:
                model.add(self._joint(joint))
        for number, constraint in enumerate(element.all('drake:ball_constraint'), 1):
            model.add(self._ball_constraint(constraint, f'ball_constraint_{number}'))
        for name, (part, before) in self.given.items():
            if part.tag == 'frame':
                carrier = self._carrier(before)
                link = self._link_name(carrier)
                if link in model.links:
                    model.frames[name] = link, self._in(carrier).inverse @ self._in(name)
        self._couple()
        add_programs(element, model, {
            self._link_name(link.get('name')): self._in(link.get('name')) for link in self.links})
        model.check()
        self._float()
        if not any(joint.actuated for joint in model.joints.values()):
            for joint in model.joints.values():
                joint.actuated = (joint.type in DRIVEN and bool(joint.effort)
                                  and joint.name not in model.followers)

    def _add_links(self):
        """Add the links to the model."""
        for link in self.links:
            name = link.word('name')
            if name == WORLD:
                raise link.error(f'any name but {WORLD!r}', 'this one')
            record = _link(self._link_name(name), link, self._pose)
            self.model.add(record)
            decay = max(_value(link.child('velocity_decay'), tag, 0.0)
                        for tag in ('linear', 'angular'))
            if decay:
                self.model.omitted.append(Omission(
                    'decay of the velocity', 'link', name, 'it depends on the step of a simulator',
                    decay, 'of it in each'))
            record.visual = self._visuals(link)

    def _couple(self):
        """Add the couplings of joints to the model, all of which are there."""
        for joint in self.joints:
            if joint.get('type') == GEARBOX:
                self.model.relations.append(self._gearbox(joint))
        for mimic, follower, *law in self.mimics:
            self.model.mimic(mimic, follower, mimic.word('joint'), *law)

    def _place(self):
        """Store the pose of the world in the frame of the model."""
        element, world, passed = self.element, IDENTITY, []
        frame = element.get('placement_frame') or MODEL
        # Frames of the world are relative to others of them.
        while True:
            pose = element.child('pose')
            world = self._pose(pose) @ world
            name = pose and (pose.get('relative_to') or pose.get('frame')) or (
                element.tag == 'frame' and element.get('attached_to')) or WORLD
            if name == WORLD:
                break
            if name not in self.around or name in passed:
                raise (pose or element).error(
                    'a pose in the world, or relative to a frame or model in it',
                    f'one relative to {name!r}')
            passed.append(name)
            element = self.around[name]
        self.found[WORLD] = self._in(frame) @ world.inverse

    def _visuals(self, link):
        return visuals(
            link, Path(link.source).parent, lambda visual: self._pose(visual.child('pose')),
            _child, _color, self.model.ignored)

    def drawn(self):
        """Return the visuals of a static model's links, in the world."""
        self._place()
        return [placed(visual, self._in(WORLD).inverse @ self._in(link.word('name')))
                for link in self.links for visual in self._visuals(link)]

    def add_parts(self):
        """
        Add links and joints to a model in another format; return the poses of the links.

        The frame of the model is that of the ground.
        """
        model, before = self.model, {GROUND, *self.model.links}
        self.found[WORLD] = IDENTITY
        self._add_links()
        for element in self.joints:
            joint = self._joint(element)
            joint.closes = {joint.parent, joint.child} <= before
            model.add(joint)
        self._couple()
        model.check()
        self._float()
        return {link.get('name'): self._in(link.get('name')) for link in self.links}

    def _carrier(self, name):
        """Return the link that a frame is on, through others that it is attached to."""
        passed = []
        while name in self.given and self.given[name][0].tag == 'frame':
            part, before = self.given[name]
            if name in passed:
                raise part.error('frames that are not attached to themselves',
                                 ' -> '.join([*passed, name]))
            passed.append(name)
            name = before
        return name

    def _end(self, joint, tag):
        """Return the name of a joint's parent or child."""
        end = joint.required(tag)
        name = end.text or end.get('link_name') or ''
        if not name:
            raise end.error('the name of a link', 'nothing')
        return name

    def _pose(self, element):
        """Return the pose of an element ``pose``."""
        if element is None or not element.text:
            return IDENTITY
        if element.get('rotation_format', 'euler_rpy') == 'quat_xyzw':
            values = element.values(element.text, 7, 'pose')
            if not np.linalg.norm(values[3:]) > 1e-6:
                raise element.error('a quaternion that is not zero', repr(element.text))
            return Pose(of_quaternion(values[3:]), np.array(values[:3]))
        values = element.values(element.text, 6, 'pose')
        unit = math.pi / 180.0 if element.get('degrees') in TRUE else 1.0
        return Pose(of_angles([unit * angle for angle in values[3:]]), np.array(values[:3]))

    def _in(self, name, asking=(), where=None):
        """Return the pose of a frame in that of the model."""
        if name in self.found:
            return self.found[name]
        if name not in self.given:
            known = [*self.given, MODEL, WORLD]
            raise MechanismError(
                f'{(where or self.element).where}: expected the name of a frame, got {name!r}'
                f' ({nearest(name, known) or "see the names of links, joints and frames"})')
        part, before = self.given[name]
        if name in asking:
            raise part.error('frames that do not depend on themselves',
                             ' -> '.join([*asking, name]))
        element = part.child('pose')
        if element is not None:
            before = element.get('relative_to') or element.get('frame') or before
        self.found[name] = self._in(before, (*asking, name), part) @ self._pose(element)
        return self.found[name]

    def _joint(self, element):
        kind = TYPES[element.word('type', (*TYPES, GEARBOX))]
        ends = [self._end(element, tag) for tag in ('parent', 'child')]
        place = self._in(element.attributes['name'])
        poses, links = [], []
        for end, tag in zip(ends, ('parent', 'child')):
            link, there = self._carrier(end), place
            frame = element.child(f'drake:{tag}_frame')
            if frame is not None:
                # The joint is at zero where the two frames coincide, wherever it is drawn.
                if self._carrier(frame.text) != link:
                    raise frame.error(f'a frame on the {tag} link {link!r}', repr(frame.text))
                there = self._in(frame.text, where=frame)
            links.append(self._link_name(link))
            poses.append(self._in(link, where=element).inverse @ there)
        joint = Connection(element.attributes['name'], kind, *links, element.where, *poses,
                           closes=_must_close(element))
        first, second = element.child('axis'), element.child('axis2')
        if kind in (FIXED, SPHERICAL):
            return joint
        if first is None:
            raise element.error('a child <axis>', 'none')
        joint.axis = self._axis(first, place)
        if kind == UNIVERSAL:
            if second is None:
                raise element.error('a child <axis2>', 'none')
            joint.child_axis = self._axis(second, place)
            joint.effort = _limits(first)[2]
            acting = [_acting(axis) for axis in (first, second)]
            joint.damping, joint.friction, joint.stiffness, joint.rest = zip(*acting)
            return joint
        if kind == HELICAL:
            joint.lead = _lead(element)
        joint.armature = _value(element, 'drake:rotor_inertia', 0.0) * _value(
            element, 'drake:gear_ratio', 1.0) ** 2
        if joint.armature < 0.0:
            raise element.error('drake:rotor_inertia to be zero or more', 'less')
        self._act(joint, first)
        mimic = element.child('drake:mimic')
        if mimic is not None:
            self.mimics.append((mimic, joint.name, mimic.number('multiplier', 1.0),
                                mimic.number('offset', 0.0)))
        return joint

    def _gearbox(self, element):
        """Return how the turns of two links about a third one depend on each other."""
        reference = element.required('gearbox_reference_body')
        ratio, factors = _value(element, 'gearbox_ratio', 1.0), {}
        body = self._link_name(self._carrier(reference.text))
        place = self._in(element.attributes['name'])
        for tag, axis, factor in (('parent', 'axis', ratio), ('child', 'axis2', 1.0)):
            link = self._link_name(self._carrier(self._end(element, tag)))
            joint = next((one for one in self.model.joints.values() if one.type == REVOLUTE
                          and {one.parent, one.child} == {link, body}), None)
            if joint is None or factor == 0.0:
                raise element.error(
                    f'a hinge between {reference.text} and {link}, and a ratio that is not zero',
                    'none')
            about = place.rotation @ self._axis(element.required(axis), place)
            own = self._in(joint.name).rotation @ joint.axis
            side = 1.0 if joint.child == link else -1.0
            factors[joint.name] = factor * side * math.copysign(1.0, about @ own)
        return Relation(element.attributes['name'], element.where, factors)

    def _ball_constraint(self, element, name):
        """Return a loop as Drake writes it."""
        ends, places = [], []
        for body, point in (('A', 'AP'), ('B', 'BQ')):
            ends.append(self._link_name(
                element.required(f'drake:ball_constraint_body_{body}').text))
            place = element.required(f'drake:ball_constraint_p_{point}')
            places.append(unturned(place.values(place.text, 3, 'a point')))
        return Connection(name, SPHERICAL, *ends, element.where, *places, closes=True)

    def _axis(self, element, place):
        """Return an axis in the joint's frame."""
        xyz = element.child('xyz')
        if xyz is None:
            return np.array([0.0, 0.0, 1.0])
        axis = xyz.unit(np.array(xyz.values(xyz.text, 3, 'an axis')), 'an axis')
        whose = xyz.get('expressed_in')
        parent = element.child('use_parent_model_frame')
        if whose:
            frame = self._in(whose, where=xyz).rotation
        elif (self.version < OWN_AXES if parent is None else parent.text in TRUE):
            frame = np.eye(3)
        else:
            return axis
        return place.rotation.T @ frame @ axis

    def _act(self, joint, element):
        """Store the effects on a joint, its limits and the joint it mimics."""
        mimic = element.child('mimic')
        joint.damping, joint.friction, joint.stiffness, joint.rest = _acting(element)
        joint.lower, joint.upper, joint.effort, joint.speed = _limits(element)
        if mimic is not None:
            if mimic.get('axis', 'axis') != 'axis':
                raise mimic.error("axis to be 'axis'", repr(mimic.get('axis')))
            factor = _value(mimic, 'multiplier', 1.0)
            self.mimics.append((
                mimic, joint.name, factor,
                _value(mimic, 'offset', 0.0) - factor * _value(mimic, 'reference', 0.0)))

    def _float(self):
        """Carry each part that nothing joins to the world by a free joint, where it is drawn."""
        model = self.model
        beside = {name: [] for name in [GROUND, *model.links]}
        for joint in model.joints.values():
            if not joint.closes:
                beside[joint.parent].append(joint.child)
                beside[joint.child].append(joint.parent)
        reached = set()
        drawn = {self._link_name(link.attributes['name']): link.attributes['name']
                 for link in self.links}
        for root in [GROUND, *model.links]:
            if root in reached:
                continue
            waiting = [root]
            while waiting:
                link = waiting.pop()
                if link not in reached:
                    reached.add(link)
                    waiting += beside[link]
            if root != GROUND:
                model.add(Connection(
                    free_name(f'{root}_free', model.joints), FREE, GROUND, root,
                    model.links[root].where,
                    in_parent=self._in(WORLD).inverse @ self._in(drawn[root]),
                    actuated=False))


def _link(name, element, pose_of):
    """Return a link; one without inertial has a mass of 1 kg, as SDF has it."""
    link = Link(name, element.where, 1.0, np.zeros(3), np.eye(3))
    gravity = element.child('gravity')
    link.carried = float(gravity is not None and gravity.text in FALSE)
    inertial = element.child('inertial')
    if inertial is None:
        return link
    if inertial.get('auto') in TRUE:
        raise inertial.error('a mass and an inertia', 'one that is to follow from shapes')
    pose = pose_of(inertial.child('pose'))
    mass, inertia = inertial.child('mass'), inertial.child('inertia')
    if mass is not None:
        link.mass = mass.values(mass.text, 1, 'mass')[0]
        if link.mass < 0.0:
            raise mass.error('a mass that is zero or more', f'{link.mass:g}')

    link.center = pose.position
    link.inertia = pose.rotation @ inertia_matrix([
        _value(inertia, tag, default) for tag, default in zip(MOMENTS, 3 * [1.0] + 3 * [0.0])
    ]) @ pose.rotation.T
    return link


def _value(parent, tag, default=None):
    """Return the number in a child, where there is one."""
    child = None if parent is None else parent.child(tag)
    return default if child is None else child.values(child.text, 1, tag)[0]


def _acting(axis):
    """Return damping, friction, stiffness of the spring and its rest about an axis."""
    dynamics = axis.child('dynamics')
    found = [_value(dynamics, tag, 0.0)
             for tag in ('damping', 'friction', 'spring_stiffness', 'spring_reference')]
    for name, value in zip(('damping', 'friction', 'spring_stiffness'), found):
        if value < 0.0:
            raise dynamics.error(f'{name} to be zero or more', f'{value:g}')
    return found


def _limits(element):
    """Return lower, upper, effort and speed of an axis, None for those without end."""
    found = [_value(element.child('limit'), tag) for tag in ('lower', 'upper', 'effort',
                                                             'velocity')]
    found = [None if one is None or abs(one) > ENDLESS else one for one in found]
    if found[2] is not None and found[2] < 0.0:
        found[2] = None
    return found


def _child(element, key, count):
    """Return numbers, or text, of a child."""
    child = element.child(key)
    if child is None or count is None:
        return child and child.text
    return child.values(child.text, count, key)


def _color(visual):
    material = visual.child('material')
    return material and color_in(_child(material, 'diffuse', None))


def _must_close(element):
    """Return whether a joint is to be cut where there is a choice."""
    for tag in ('physics', 'simbody', 'must_be_loop_joint'):
        element = element and element.child(tag)
    return bool(element) and element.text in TRUE


def _lead(element):
    """Return the lead of a screw joint [m/rad]."""
    pitch = element.child('screw_thread_pitch')
    if pitch is not None:
        return pitch.values(pitch.text, 1, 'a pitch')[0] / (2.0 * math.pi)
    # Turns the other way, and gives radians per metre.
    pitch = element.child('thread_pitch')
    found = -1.0 if pitch is None else pitch.values(pitch.text, 1, 'a pitch')[0]
    if found == 0.0:
        raise pitch.error('a pitch that is not zero', '0')
    return -1.0 / found
