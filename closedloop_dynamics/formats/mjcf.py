# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
MJCF, compiled by MuJoCo: bodies, joints, equalities, actuators, fixed tendons in equalities.

MuJoCo itself opens no file: includes are read here, from the folder of the model and below, and
meshes only where a body's mass is to follow from one. Coordinates are MuJoCo's (``ref`` among
them), except for free joints, which are counted from where they are drawn. Equalities, soft there,
hold exactly here.
"""

from collections import Counter
from contextlib import contextmanager
import math
from pathlib import Path
import warnings
from xml.sax.saxutils import quoteattr

import numpy as np

from .mjcf_omissions import disabled, omissions, sides
from .mjcf_pictures import read_pictures
from .model import (
    Belt, Connection, Drag, free_name, Link, Model, NO_CONTACTS, Omission, ReadOptions, Relation,
    Rope, Spring, UNITS)
from .pose import IDENTITY, Pose, unturned
from .xml_file import Element, read_bytes, read_xml
from ..mechanism.coupling_law import shifted
from ..mechanism.extras import remedy
from ..mechanism.mechanism import (
    FIXED, FREE, GROUND, MechanismError, PRISMATIC, REVOLUTE, SPHERICAL)
from ..mechanism.rotations import about, of_quaternion, quaternion_of

MOST_INCLUDES, MOST_MESHES = 100, 2000
# What is left out, and why.
SECTIONS = {
    'asset': 'for pictures and contacts', 'visual': 'for pictures', 'statistic': 'for pictures',
    'contact': NO_CONTACTS, 'sensor': 'for sensors', 'keyframe': 'other states',
    'custom': 'for programs', 'deformable': 'not rigid', 'extension': 'for programs'}
PARTS = {'camera': 'for pictures', 'light': 'for pictures', 'plugin': 'forces of programs'}
# What an actuator acts on.
TRANSMISSION = (
    'name', 'class', 'group', 'joint', 'jointinparent', 'tendon', 'site', 'refsite', 'body',
    'cranksite', 'slidersite', 'cranklength', 'gear')
_SOFT = ('material', 'hfield')
# Elements of pictures, and those that would open files.
DRAWN = ('compiler', 'default', 'asset', 'worldbody')
NOT_DRAWN = (*PARTS, 'attach', 'composite', 'flexcomp', 'hfield', 'model', 'skin', 'texture')
# The key frame of files that this package has written.
START = 'start'
# Names of MuJoCo's types of joints, in its order.
TYPES = (FREE, SPHERICAL, PRISMATIC, REVOLUTE)
CONNECT, WELD, JOINT, TENDON = range(4)
# Place of a weld's torquescale among its numbers.
TORQUE_SCALE = 10


def read_mjcf(path, options=ReadOptions()):
    """
    Return the Model in an MJCF file.

    Raises MechanismError with file, line and element, as far as MuJoCo gives them.
    """
    path = Path(path)
    if options.ignore:
        raise MechanismError(f'{path}: ignore: expected a URDF or SDF file, got one that MuJoCo '
                             'reads, which knows all elements or refuses them')
    root = _included(read_xml(path, ('mujoco',)), path.parent.resolve(), [path.resolve()], options)
    _refuse_infinite(root)
    try:
        import mujoco
    except (ImportError, OSError) as error:
        raise MechanismError(f'{path}: an MJCF file needs '
                             f'{remedy("mujoco", error)}') from None
    model = Model(root.get('model') or path.stem, path)
    _name_bodies(root)
    start = _key_frame(root)
    left_out, parts, assets = Counter(), {}, {}
    folder = path.parent.resolve()
    drawn = ''.join(_text(part, NOT_DRAWN) for part in root.children if part.tag in DRAWN)
    _stripped(root, folder, left_out, options, parts, assets)
    # Shapes that may touch are counted below, with those that masses follow from.
    del left_out['geom']
    model.ignore(left_out, {**SECTIONS, **PARTS})
    with _heard(mujoco, model.ignored):
        try:
            compiled = mujoco.MjSpec.from_string(
                _text(root), include=_contents(parts), assets=_contents(assets)).compile()
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            reason = ' '.join(str(error).split())
            raise MechanismError(f'{path}: expected a model that MuJoCo compiles, got: {reason}'
                                 ) from None
    ellipsoids = _asks(root, 'fluidshape', 'ellipsoid') or any(
        b'"ellipsoid"' in content for _, content in parts.values())
    reader = _Reader(mujoco, compiled, model, ellipsoids)
    links = reader.read()
    reader.start(start)
    # What it warns of was reported above.
    with _heard(mujoco, {}):
        touching = read_pictures(mujoco, f'<mujoco>{drawn}</mujoco>', folder, model, links)
    if touching and not (reader.disabled('CONTACT') or reader.disabled('CONSTRAINT')):
        model.ignored[f'contacts of {touching} shapes'] = NO_CONTACTS
    return model


@contextmanager
def _heard(mujoco, notes):
    """Collect MuJoCo's warnings, which it would write to a file where it runs."""
    before, warned = mujoco.get_mju_user_warning(), []
    mujoco.set_mju_user_warning(warned.append)
    try:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter('always')
            yield
    finally:
        mujoco.set_mju_user_warning(before)
    for text in (*warned, *(str(one.message) for one in found)):
        notes[' '.join(text.split())] = 'a warning of MuJoCo'


def _contents(files):
    return {name: content for name, (_, content) in files.items()}


def _refuse_infinite(element):
    """Refuse numbers that are not finite, on which MuJoCo may compute without an end."""
    for key, value in element.attributes.items():
        for part in value.split():
            try:
                finite = math.isfinite(float(part))
            except ValueError:
                continue
            if not finite:
                raise element.error(f'{key} to be finite', repr(value))
    for child in element.children:
        _refuse_infinite(child)


def _included(element, folder, files, options):
    children = []
    for child in element.children:
        if child.tag != 'include':
            children.append(_included(child, folder, files, options))
            continue
        path = _inside(child, folder / child.word('file'), folder, options, 'a file')
        if path in files:
            raise child.error('files that do not include themselves, each once',
                              f'{path.name!r} again')
        if len(files) > MOST_INCLUDES:
            raise child.error(f'at most {MOST_INCLUDES} files', 'more')
        files.append(path)
        inside = read_xml(path, ('mujoco', 'mujocoinclude'))
        children += _included(inside, folder, files, options).children
    element.children = children
    return element


def _name_bodies(root):
    """Name the bodies that have no name, as both readings of the file are to call them."""
    bodies = []

    def find(element, copied):
        for child in element.children:
            if child.tag == 'body':
                bodies.append((child, copied))
            find(child, copied or child.tag == 'replicate')

    for element in root.children:
        if element.tag == 'worldbody':
            find(element, False)
    taken = {body.attributes.get('name') for body, _ in bodies}
    for number, (body, copied) in enumerate(bodies, 1):
        if not body.attributes.get('name'):
            # Copies have a number behind it.
            body.attributes['name'] = free_name(f'body_{number}{"_" * copied}', taken)
            taken.add(body.attributes['name'])


def _asks(element, key, value):
    """Return whether an element, or one in it, has an attribute of a value."""
    return element.attributes.get(key) == value or any(
        _asks(child, key, value) for child in element.children)


def _key_frame(root):
    """Return the element of the key frame that files of this package start from, or None."""
    for section in root.children:
        for key in section.children if section.tag == 'keyframe' else ():
            if key.attributes.get('name') == START and 'qpos' in key.attributes:
                return key
    return None


def _inside(element, path, folder, options, what):
    """Return the path of a file that an element names; refuse one that is outside of a folder."""
    path = path.resolve()
    if not (options.anywhere or path.is_relative_to(folder)):
        raise element.error(f'{what} in the folder of the model or below', repr(str(path)),
                            '--anywhere, or anywhere: true in a scene, reads others')
    return path


def _stripped(root, folder, left_out, options, parts, assets):
    """
    Remove elements of pictures and contacts only.

    Models that are attached are put into ``parts``, without the same, meshes that masses need into
    ``assets``: by the name in the file, path and content.
    """
    compiler = {}
    for element in root.children:
        if element.tag == 'compiler':
            compiler.update(element.attributes)
            for key in ('meshdir', 'texturedir', 'assetdir', 'discardvisual'):
                element.attributes.pop(key, None)
        elif element.tag == 'actuator':
            _without_plugins(element, left_out)
    geoms = compiler.get('inertiafromgeom', 'auto')
    needed, wrapped = set(), {
        wrap.attributes.get('geom') for section in root.children if section.tag == 'tendon'
        for tendon in section.children for wrap in tendon.children if wrap.tag == 'geom'}
    for element in root.children:
        if element.tag in ('worldbody', 'default'):
            _strip_below(element, geoms, needed, wrapped, left_out)
    found = [part for section in root.children if section.tag == 'asset'
             for part in section.children]
    meshes = {mesh.attributes.get('name') or Path(mesh.attributes.get('file', '')).stem: mesh
              for mesh in found if mesh.tag == 'mesh'}
    kept = []
    for element in root.children:
        if element.tag not in SECTIONS:
            kept.append(element)
            continue
        left_out[element.tag] += 1
    extensions = [element for element in root.children if element.tag == 'extension']
    needs = [meshes[name] for name in sorted(needed & set(meshes))]
    root.children = kept
    for mesh in needs:
        if 'file' in mesh.attributes:
            place = folder / compiler.get('meshdir', compiler.get('assetdir', ''))
            file = _inside(mesh, place / mesh.attributes['file'], folder, options, 'a mesh')
            _put(assets, mesh, file, read_bytes(file), MOST_MESHES)
        mesh.attributes.pop('material', None)
    attached = [part for part in found if part.tag == 'model']
    for part in attached:
        _attach(part, folder, left_out, options, parts, assets)
    if needs or attached:
        root.children.append(_section(root, 'asset', [*needs, *attached]))
    if any(_has(element, 'plugin') for element in root.children):
        root.children += extensions
    # Gains of muscles, which it is for, are left out, and it may not come to an end.
    root.children.append(_section(root, 'compiler', [_section(root, 'lengthrange', mode='none')]))


def _section(root, tag, children=(), **attributes):
    section = Element(tag, attributes, root.source, root.line)
    section.children = list(children)
    return section


def _has(element, tag):
    return element.tag == tag or any(_has(child, tag) for child in element.children)


def _put(files, element, path, content, most):
    """Put a file under the name that an element has for it, which no other one may have."""
    name = element.word('file')
    known, _ = files.setdefault(name, (path, content))
    if known != path:
        raise element.error('another name for another file', f'{name!r} for {known} and {path}')
    if len(files) > most:
        raise element.error(f'at most {most} files', 'more')


def _attach(part, folder, left_out, options, parts, assets):
    """Read a model that is attached to others, with the meshes that its masses need."""
    path = _inside(part, folder / part.word('file'), folder, options, 'a model')
    known = part.word('file') in parts
    _put(parts, part, path, b'', MOST_INCLUDES)
    if known:
        return
    root = _included(read_xml(path, ('mujoco',)), path.parent, [path], options)
    _refuse_infinite(root)
    _name_bodies(root)
    _stripped(root, path.parent, left_out, options, parts, assets)
    parts[part.word('file')] = path, _text(root).encode()


def _without_plugins(section, left_out):
    """Make actuators that programs drive plain ones at the same joint."""
    for drive in section.children:
        if drive.tag == 'plugin':
            left_out['plugin'] += 1
            drive.tag, drive.children = 'general', []
            drive.attributes = {
                key: value for key, value in drive.attributes.items() if key in TRANSMISSION}


def _strip_below(element, geoms, needed, wrapped, left_out):
    """Remove elements without mass, and geometry of bodies whose mass is given."""
    unused = geoms == 'false' or geoms == 'auto' and any(
        child.tag == 'inertial' for child in element.children)
    unused = unused or element.tag == 'worldbody'
    kept = []
    for child in element.children:
        flat = child.tag == 'geom' and element.tag != 'default' and 'hfield' in (
            *child.attributes, child.attributes.get('type'))
        for key in _SOFT:
            child.attributes.pop(key, None)
        # A plugin gives the shape of a geometry; tendons are wrapped around some geometries.
        if flat or child.tag in PARTS and (child.tag, element.tag) != ('plugin', 'geom') or (
                unused and child.tag == 'geom' and child.attributes.get('name') not in wrapped):
            left_out[child.tag] += 1
            continue
        if child.tag == 'geom' and 'mesh' in child.attributes:
            needed.add(child.attributes['mesh'])
        _strip_below(child, geoms, needed, wrapped, left_out)
        kept.append(child)
    element.children = kept


def _text(element, left_out=()):
    """Return an element as XML again, without elements of some names."""
    attributes = ''.join(f' {key}={quoteattr(value)}'
                         for key, value in element.attributes.items())
    inside = ''.join(_text(child, left_out) for child in element.children
                     if child.tag not in left_out)
    return f'<{element.tag}{attributes}>{inside}</{element.tag}>'


class _Reader:
    """Records from a compiled model of MuJoCo."""

    def __init__(self, mujoco, compiled, model, ellipsoids):
        self.compiled, self.model, self.mujoco = compiled, model, mujoco
        self.ellipsoids = ellipsoids
        self.objects = mujoco.mjtObj
        self.joints = {}
        self.named_joints = {self._name(self.objects.mjOBJ_JOINT, joint, '')
                             for joint in range(compiled.njnt)}
        self.bodies = [self._name(self.objects.mjOBJ_BODY, body, f'body_{body}')
                       for body in range(compiled.nbody)]

    def read(self):
        """Fill the model; return its links by the names that MuJoCo has."""
        compiled, model = self.compiled, self.model
        if not self.disabled('GRAVITY'):
            model.gravity = tuple(compiled.opt.gravity.tolist())
        else:
            model.gravity = (0.0, 0.0, 0.0)
        for body in range(1, compiled.nbody):
            self._body(body)
        self._find_drives()
        carried = {key for tendon in range(compiled.ntendon) for key in self._along(tendon)}
        carried.update(key for joint in range(compiled.njnt) for key in self._beyond(joint))
        model.omitted += omissions(
            self.mujoco, compiled, model.name, carried, self._drag() if self._passive() else True)
        if not (self.disabled('EQUALITY') or self.disabled('CONSTRAINT')):
            for equality in range(compiled.neq):
                self._equality(equality)
        elif compiled.neq:
            model.ignored[f'{compiled.neq} equalities'] = 'the flags of the file disable them'
        return {self._name(self.objects.mjOBJ_BODY, body, ''): model.links[self._body_name(body)]
                for body in range(1, compiled.nbody)}

    def start(self, key):
        """Set the start of the joints from a key frame."""
        if key is None:
            return
        compiled = self.compiled
        values = np.array(key.values(key.attributes['qpos'], compiled.nq, 'qpos'))
        for number, name in self.joints.items():
            joint = self.model.joints[name]
            own = values[int(compiled.jnt_qposadr[number]):]
            if joint.type == SPHERICAL:
                joint.start = quaternion_of(_rotation(own[:4]))
            elif joint.type == FREE:
                there = joint.in_parent.inverse @ Pose(_rotation(own[3:7]), own[:3])
                joint.start = (*there.position.tolist(), *quaternion_of(there.rotation))
            else:
                joint.start = float(own[0])

    def disabled(self, what):
        """Return whether the flags of the file disable something."""
        return disabled(self.mujoco, self.compiled, what)

    def _find_drives(self):
        """Find the driven joints, and the damping and armature of drives in them."""
        compiled, model, kinds = self.compiled, self.model, self.mujoco.mjtTrn
        in_joints = [int(getattr(kinds, f'mjTRN_{kind}')) for kind in (
            'JOINT', 'JOINTINPARENT', 'SO3') if hasattr(kinds, f'mjTRN_{kind}')]
        along = int(kinds.mjTRN_TENDON)
        drives, count = set(), getattr(compiled, 'nactuator', compiled.nu)
        outputs = getattr(compiled, 'actuator_outadr', range(count))
        for drive in range(count):
            kind, target = int(compiled.actuator_trntype[drive]), int(
                compiled.actuator_trnid[drive, 0])
            gear = float(compiled.actuator_gear[outputs[drive], 0])
            damping, armature = (
                gear ** 2 * float(getattr(compiled, f'actuator_{key}', np.zeros(count))[drive])
                for key in ('damping', 'armature'))
            damping *= not self.disabled('DAMPER')
            if kind in in_joints:
                joint = model.joints[self.joints[target]]
                drives.add(joint.name)
                joint.armature += armature
                joint.damping += damping
                self._omit_gains(drive, gear, joint)
                continue
            self._leave(self.objects.mjOBJ_ACTUATOR, drive, 'it drives no joint')
            joints = self._tendon(target) if kind == along else None
            if joints is not None:
                self.model.belts.append(Belt(
                    ' '.join(self._called(self.objects.mjOBJ_ACTUATOR, drive)),
                    self._arms(joints), damping=(damping,), inertia=armature))
                continue
            for key, size, unit in (('damping', damping, 'N s/m'), ('armature', armature, 'kg')):
                if size:
                    self._omit(key, self.objects.mjOBJ_ACTUATOR, drive, 'it drives no joint',
                               size, unit)
        for joint in model.joints.values():
            joint.actuated = joint.name in drives and not self.disabled('ACTUATION')
        if count:
            model.ignored['gains and limits of actuators'] = (
                'commands are torques and forces of joints')

    def _omit_gains(self, drive, gear, joint):
        """Report an actuator of position or velocity without a command as left out."""
        compiled = self.compiled
        if self.disabled('ACTUATION') or compiled.actuator_biastype[drive] != int(
                self.mujoco.mjtBias.mjBIAS_AFFINE):
            return
        slides = joint.type == PRISMATIC
        for place, key, unit in ((1, 'position gain', UNITS['stiffness'][slides]),
                                 (2, 'velocity gain', UNITS['damping'][slides])):
            size = abs(gear ** 2 * float(compiled.actuator_biasprm[drive, place]))
            if size:
                self._omit(key, self.objects.mjOBJ_ACTUATOR, drive,
                           'commands are torques and forces of joints', size, unit)

    def _along(self, tendon):
        """Add effects along a tendon; yield the fields and rows that are read."""
        compiled, first = self.compiled, int(self.compiled.tendon_adr[tendon])
        wraps = range(first, first + int(compiled.tendon_num[tendon]))
        name = self._called(self.objects.mjOBJ_TENDON, tendon)[1]
        stiffness, damping = (self._powers('tendon', key, tendon, flag) for key, flag in (
            ('stiffness', 'SPRING'), ('damping', 'DAMPER')))
        rest = tuple(compiled.tendon_lengthspring[tendon].tolist())
        limits = tuple(compiled.tendon_range[tendon].tolist()) if (
            compiled.tendon_limited[tendon] and not self._unlimited()) else None
        joints, plain = self._tendon(tendon), not (any(stiffness[1:]) or any(damping[1:]))
        if joints is not None:
            arms = self._arms(joints)
            rubs = not (self.disabled('FRICTIONLOSS') or self.disabled('CONSTRAINT'))
            # Older versions have no armature of tendons.
            self.model.belts.append(Belt(
                name, arms, stiffness, damping, rest,
                friction=rubs * float(compiled.tendon_frictionloss[tendon]),
                inertia=float(getattr(compiled, 'tendon_armature', {tendon: 0.0})[tendon])))
            if limits:
                self.model.belts.append(Belt(f'{name}_limit', arms, rest=limits, limit=True))
            yield from self._read(
                'tendon', ('stiffness', 'damping', 'frictionloss', 'armature'), tendon)
            return
        if any(compiled.wrap_type[k] != self.mujoco.mjtWrap.mjWRAP_SITE for k in wraps):
            if limits:
                self.model.ignored[f'limits of tendon {name}'] = (
                    'no end stops along tendons around geometry')
            return
        ends = tuple((self._body_name(int(compiled.site_bodyid[site])),
                      unturned(compiled.site_pos[site])) for site in (
                          int(compiled.wrap_objid[k]) for k in wraps))
        if limits:
            self.model.ropes.append(Rope(f'{name}_limit', ends, limits[1]))
            if limits[0] > 0.0:
                self.model.ignored[f'the least length of tendon {name}'] = (
                    'cables pull and never push')
        pulls = bool(stiffness[0]) and rest[0] <= 0.0 < rest[1]
        if pulls and not any(stiffness[1:]):
            self.model.ropes.append(Rope(name, ends, rest[1], stiffness[0]))
            yield from self._read('tendon', ('stiffness',), tendon)
            stiffness = (0.0,)
        elif rest[0] < rest[1] and any(stiffness):
            return
        if len(ends) == 2 and plain:
            if stiffness[0] or damping[0]:
                self.model.springs.append(Spring(name, ends, stiffness[0], damping[0], rest[1]))
            yield from self._read('tendon', ('stiffness', 'damping'), tendon)

    def _beyond(self, joint):
        """Add higher terms of a joint's spring and damper; yield the fields read."""
        compiled, dof = self.compiled, int(self.compiled.jnt_dofadr[joint])
        if TYPES[compiled.jnt_type[joint]] not in (PRISMATIC, REVOLUTE):
            return
        stiffness = (0.0, *self._powers('jnt', 'stiffness', joint, 'SPRING')[1:])
        damping = (0.0, *self._powers('dof', 'damping', dof, 'DAMPER')[1:])
        if any(stiffness) or any(damping):
            name = self.joints[joint]
            rest = float(compiled.qpos_spring[int(compiled.jnt_qposadr[joint])])
            self.model.belts.append(Belt(name, {name: 1.0}, stiffness, damping, (rest, rest)))
        yield from self._read('jnt', ('stiffness',), joint)
        yield from self._read('dof', ('damping',), dof)

    def _powers(self, kind, key, row, flag):
        """Return the coefficients of a spring or damper, from the first power on."""
        if self.disabled(flag):
            return (0.0,)
        first = np.ravel(getattr(self.compiled, f'{kind}_{key}')[row])[:1]
        # Older versions have the first alone.
        more = getattr(self.compiled, f'{kind}_{key}poly', None)
        return tuple(first.tolist()) + (() if more is None else tuple(more[row].tolist()))

    def _read(self, kind, keys, row):
        for key in keys:
            yield f'{kind}_{key}', row
            yield f'{kind}_{key}poly', row

    def _passive(self):
        """Return whether MuJoCo has any forces that no drive and no constraint makes."""
        return not (self.disabled('SPRING') and self.disabled('DAMPER'))

    def _unlimited(self):
        return self.disabled('LIMIT') or self.disabled('CONSTRAINT')

    def _drag(self):
        """Add the drag on boxes of the bodies' inertia; return whether there is no other one."""
        compiled = self.compiled
        density, viscosity = compiled.opt.density, compiled.opt.viscosity
        if self.ellipsoids or not (density or viscosity):
            return not (density or viscosity)
        for body in range(1, compiled.nbody):
            mass = compiled.body_mass[body]
            if mass > 0.0 and compiled.body_weldid[body]:
                box = sides(mass, compiled.body_inertia[body])
                size, others = float(box.mean()), box.prod() / box
                powers = (box ** 4).sum() - box ** 4
                self.model.drags.append(Drag(
                    self._body_name(body), _rotation(compiled.body_iquat[body]),
                    3 * (3.0 * math.pi * size * viscosity,),
                    tuple((0.5 * density * others).tolist()),
                    3 * (math.pi * size ** 3 * viscosity,),
                    tuple((density * box * powers / 64.0).tolist()),
                    tuple(compiled.opt.wind.tolist())))
        return True

    def _name(self, kind, number, default):
        return self.mujoco.mj_id2name(self.compiled, kind, int(number)) or default

    def _free_joint(self, name):
        """Return a name that no joint has, of those that are still to come either."""
        return free_name(name, {*self.model.joints, *self.named_joints})

    def _called(self, kind, number):
        """Return the kind of an element, and its name."""
        return (kind.name.removeprefix('mjOBJ_').lower(),
                self._name(kind, number, f'number {number + 1}'))

    def _leave(self, kind, number, reason):
        self.model.ignored[' '.join(self._called(kind, number))] = reason

    def _omit_equality(self, number, reason):
        self._omit('the constraint', self.objects.mjOBJ_EQUALITY, number, reason)

    def _omit(self, quantity, kind, number, reason, size=math.inf, unit=''):
        self.model.omitted.append(Omission(
            quantity, *self._called(kind, number), reason, size, unit))

    def _body_name(self, body):
        return GROUND if body == 0 else self.model.link_name(self.bodies[body], self.bodies)

    def _body(self, body):
        compiled, name = self.compiled, self._body_name(body)
        where = f'{self.model.path}: <body name={name!r}>'
        axes = _rotation(compiled.body_iquat[body])
        self.model.add(Link(
            name, where, float(compiled.body_mass[body]), compiled.body_ipos[body].copy(),
            axes @ np.diag(compiled.body_inertia[body]) @ axes.T,
            carried=float(compiled.body_gravcomp[body]) if self._passive() else 0.0))
        place = Pose(_rotation(compiled.body_quat[body]), compiled.body_pos[body].copy())
        parent = self._body_name(compiled.body_parentid[body])
        first, count = int(compiled.body_jntadr[body]), int(compiled.body_jntnum[body])
        for number in range(count):
            joint = first + number
            child = name
            if number < count - 1:
                child = free_name(f'{name}_{number + 1}', {*self.model.links, *self.bodies})
                self.model.add(Link(child, where))
            connection = self._joint(joint, name, number, parent, child, place)
            self.model.add(connection)
            self.joints[joint] = connection.name
            parent, place = child, IDENTITY
        if not count:
            self.model.add(Connection(
                self._free_joint(f'{name}_fixed'), FIXED, parent, name, where,
                in_parent=place))

    def _joint(self, joint, body, number, parent, child, place):
        compiled = self.compiled
        kind = TYPES[compiled.jnt_type[joint]]
        name = self._name(self.objects.mjOBJ_JOINT, joint, '') or self._free_joint(
            f'{body}_joint_{number + 1}')
        found = Connection(name, kind, parent, child,
                           f'{self.model.path}: <joint name={name!r}>')
        dof, address = int(compiled.jnt_dofadr[joint]), int(compiled.jnt_qposadr[joint])
        found.armature = float(compiled.dof_armature[dof])
        if not self.disabled('DAMPER'):
            found.damping = float(np.ravel(compiled.dof_damping[dof])[0])
        if not (self.disabled('FRICTIONLOSS') or self.disabled('CONSTRAINT')):
            found.friction = float(compiled.dof_frictionloss[dof])
        if not self.disabled('SPRING'):
            found.stiffness = float(np.ravel(compiled.jnt_stiffness[joint])[0])
        found.in_parent = place
        if kind == FREE:
            if found.friction and not np.array_equal(place.rotation, np.eye(3)):
                # One of several degrees of freedom is a box, not a ball.
                self._omit('friction', self.objects.mjOBJ_JOINT, joint,
                           'it acts along the axes of the world, not of the body as drawn',
                           found.friction, 'N')
                found.friction = 0.0
            return found
        anchor = unturned(compiled.jnt_pos[joint])
        found.in_parent, found.in_child = place @ anchor, anchor
        if kind == SPHERICAL:
            return found
        found.axis = compiled.jnt_axis[joint].copy()
        drawn = float(compiled.qpos0[address])
        found.start, found.rest = drawn, float(compiled.qpos_spring[address])
        if drawn:
            # As it is drawn the coordinate is not zero.
            back = unturned(-drawn * found.axis) if kind == PRISMATIC else Pose(
                about(found.axis, -drawn), np.zeros(3))
            found.in_parent = found.in_parent @ back
        if compiled.jnt_limited[joint] and not self._unlimited():
            found.lower, found.upper = compiled.jnt_range[joint].tolist()
        return found

    def _equality(self, number):
        compiled, model = self.compiled, self.model
        kind, data = int(compiled.eq_type[number]), compiled.eq_data[number]
        name = free_name(self._name(
            self.objects.mjOBJ_EQUALITY, number, f'equality_{number + 1}'), model.joints)
        where = f'{model.path}: <equality>, its element {number + 1}'
        if not compiled.eq_active0[number]:
            self._leave(self.objects.mjOBJ_EQUALITY, number, 'not active')
        elif kind in (CONNECT, WELD):
            self._close(number, name, where, kind, data)
        elif kind in (JOINT, TENDON):
            self._relate(number, name, where, kind, data)
        else:
            self._omit_equality(number, 'a type that is not read')

    def _close(self, number, name, where, kind, data):
        compiled = self.compiled
        ends = int(compiled.eq_obj1id[number]), int(compiled.eq_obj2id[number])
        if compiled.eq_objtype[number] == self.objects.mjOBJ_SITE:
            bodies = [int(compiled.site_bodyid[site]) for site in ends]
            places = [Pose(_rotation(compiled.site_quat[site]), compiled.site_pos[site].copy())
                      for site in ends]
        else:
            bodies = ends
            places = [unturned(data[:3]), unturned(data[3:6])]
            if kind == WELD:
                places = [Pose(_rotation(data[6:10]), data[3:6].copy()), places[0]]
        # A weld whose torques count nothing leaves the turning free.
        fixed = kind == WELD and data[TORQUE_SCALE] != 0.0
        self.model.add(Connection(
            name, FIXED if fixed else SPHERICAL, *map(self._body_name, bodies), where,
            *places, closes=True))

    def _relate(self, number, name, where, kind, data):
        compiled = self.compiled
        ends = int(compiled.eq_obj1id[number]), int(compiled.eq_obj2id[number])
        if data[2:5].any() and ends[1] >= 0:
            self._relate_by_law(number, name, where, kind, data, ends)
            return
        factors, offset = Counter(), float(data[0])
        for end, factor in zip(ends, (1.0, -float(data[1]))):
            if end < 0:
                continue
            for joint, share in ([(end, 1.0)] if kind == JOINT else self._tendon(end) or []):
                factors[self.joints[joint]] += factor * share
                offset += factor * share * float(
                    compiled.qpos0[compiled.jnt_qposadr[joint]])
        factors = {joint: factor for joint, factor in factors.items() if factor}
        if not factors or kind == TENDON and any(
                end >= 0 and self._tendon(end) is None for end in ends):
            self._omit_equality(number, 'only fixed tendons are read')
            return
        self.model.relations.append(Relation(name, where, factors, offset))

    def _relate_by_law(self, number, name, where, kind, data, ends):
        """Relate one joint to the polynomial of another one's coordinate."""
        if kind != JOINT:
            self._omit_equality(number, 'of tendons only linear couplings are read')
            return
        follower, leader = (self.joints[end] for end in ends)
        drawn, counted = (float(self.compiled.qpos0[self.compiled.jnt_qposadr[end]])
                          for end in ends)
        self.model.relations.append(Relation(
            name, where, {follower: 1.0}, drawn, law=(leader, shifted(data[:5], -counted))))

    def _tendon(self, tendon):
        """Return joints and factors of a fixed tendon; None for another."""
        compiled = self.compiled
        first, count = int(compiled.tendon_adr[tendon]), int(compiled.tendon_num[tendon])
        wraps = range(first, first + count)
        if any(compiled.wrap_type[k] != self.mujoco.mjtWrap.mjWRAP_JOINT for k in wraps):
            return None
        return [(int(compiled.wrap_objid[k]), float(compiled.wrap_prm[k])) for k in wraps]

    def _arms(self, joints):
        """Return arms by names of joints, from the result of ``_tendon``."""
        arms = Counter()
        for joint, share in joints:
            arms[self.joints[joint]] += share
        return dict(arms)


def _rotation(quaternion):
    """Return the rotation of a quaternion in MuJoCo's order, w first."""
    w, x, y, z = quaternion
    return of_quaternion((x, y, z, w))
