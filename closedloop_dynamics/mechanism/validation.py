# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The rules that every mechanism obeys, read from a file or built in Python."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from numbers import Real
from weakref import WeakValueDictionary

import numpy as np

from .checks import (
    boolean, direction, listed, name, not_negative, number, numbers, one_of, orientation, positive,
    text, vector2, vector3)
from .coupling_law import checked_law
from .couplings import in_tree, measured
from .digits import with_agreement
from .fields import among, at, copied, FieldError, mapping, nearest, normalise, shown
from .inertia import inertia_matrix
from .mechanism import (
    Body, COUPLED, Coupling, CUT_JOINT_EQUATIONS, CUT_WITH_AXIS_A, CUT_WITH_AXIS_B,
    CUT_WITH_ZERO, CutJoint, CYLINDRICAL, DISTANCE, GROUND, HELICAL, Joint, JOINT_FREEDOMS,
    JOINT_TYPES, Mechanism, MechanismError, PLANAR, Point, PRISMATIC, REVOLUTE,
    SPATIAL_CUT_JOINT_EQUATIONS, UNIVERSAL, UNTURNED, WITH_AXIS)
from .rotations import rotated

# Larger tolerances would change machines.
LARGEST_TOLERANCE = 1e-3
# How far moments of inertia may miss the triangle inequality, against their sum.
ROUNDED_INERTIA = 1e-6
POSSIBLE = ('moments of inertia that a body can have: none negative, none larger than the sum of '
            'the other two')


def _mass(value):
    """Return a positive mass; the error mentions massless bodies where it is zero."""
    try:
        return positive(value)
    except FieldError as error:
        if not isinstance(value, bool) and isinstance(value, Real) and value == 0.0:
            error.note = 'a body without mass on purpose says massless: true'
        raise


def _left_out(standing, where, value):
    """Return the value of a key that must not be given, and refuse any other."""
    if value == standing:
        return standing
    raise FieldError(f'nothing: only a mechanism in {where} has this key', shown(value))


def _given(check, value):
    """Return a checked value, None where there is none."""
    return None if value is None else check(value)


def _not_zero(value):
    """Return a number that is not zero."""
    result = number(value)
    if result == 0.0:
        raise FieldError('a number that is not zero', shown(value))
    return result


def _tolerance(value):
    """Return a tolerance of digits; refuse one that changes more than digits."""
    result = not_negative(value)
    if result > LARGEST_TOLERANCE:
        raise FieldError(f'a number from 0 to {LARGEST_TOLERANCE:g}', shown(value),
                         'a larger difference is not a matter of digits')
    return result


def _factors(value):
    """Return the factors of a coupling by joint."""
    found = {}
    for key, factor in mapping(value).items():
        with at(key):
            found[key] = _not_zero(factor)
    if not found:
        raise FieldError('at least one joint and its factor', 'none')
    return found


def possible(moments):
    """Return whether a body can have principal moments of inertia, the largest one last."""
    slack = ROUNDED_INERTIA * abs(moments).sum()
    # The sum of two is the third and twice the mass's extent along its axis.
    return moments[0] >= -slack and moments[0] + moments[1] >= moments[2] - slack


def moments_text(moments):
    """Return moments of inertia in words."""
    return ', '.join(f'{moment:.4g}' for moment in moments)


def spatial_inertia(value):
    """Return moments of inertia in space, three or six; refuse those that no body has."""
    expected = ('a list of 3 finite numbers [xx, yy, zz] or 6 [xx, yy, zz, xy, xz, yz], about the '
                'centre of mass')
    items = listed(value, expected)
    found = numbers(items, 6 if len(items) == 6 else 3, expected)
    moments = np.linalg.eigvalsh(inertia_matrix(found))
    if not possible(moments):
        raise FieldError(POSSIBLE, f'principal moments {moments_text(moments)}')
    return found


# Names of joint types elsewhere, and the type here.
_COUPLED_JOINTS = 'write one of the couplings: the sum of joint coordinates, each times its factor'
_PIN_IN_SLOT = 'write one of the cut_joints, of the type point_on_line'
_OTHER_NAMES = {
    **dict.fromkeys(('gear', 'gears', 'belt', 'mimic', 'rack', 'rack_and_pinion'),
                    _COUPLED_JOINTS),
    **dict.fromkeys(('pin_in_slot', 'pin_slot', 'slot'), _PIN_IN_SLOT)}


def _type_of(*choices):
    """Return the check for the type of a joint; the error suggests replacements."""
    def check(value):
        try:
            return one_of(choices)(value)
        except FieldError as error:
            error.note = isinstance(value, str) and _OTHER_NAMES.get(value.lower()) or error.note
            raise
    return check


_COUPLING = {'joints': _factors, 'offset': number, 'radius': partial(_given, positive),
             'law': checked_law}
# Section of the file (and field of Mechanism) -> its record and the checks of its fields.
SECTIONS = {
    'bodies': (Body, {
        'massless': boolean, 'mass': _mass, 'center_of_mass': vector2,
        'inertia': not_negative}),
    'joints': (Joint, {
        'type': _type_of(*JOINT_TYPES), 'position': vector2, 'angle': number, 'actuated': boolean,
        **dict.fromkeys(('axis', 'second_axis', 'lead'), partial(_left_out, None, 'space')),
        'orientation': partial(_left_out, UNTURNED, 'space')}),
    'cut_joints': (CutJoint, {
        'type': _type_of(*CUT_JOINT_EQUATIONS), 'point_a': vector2, 'point_b': vector2,
        'angle': number, 'length': partial(_given, positive), 'actuated': boolean,
        **dict.fromkeys(('axis_a', 'axis_b', 'lead'), partial(_left_out, None, 'space')),
        'orientation': partial(_left_out, UNTURNED, 'space')}),
    'points': (Point, {'position': vector2}),
    'couplings': (Coupling, _COUPLING),
}
# The same in space, where vectors have three numbers.
SPATIAL_SECTIONS = {
    'bodies': (Body, {
        'massless': boolean, 'mass': _mass, 'center_of_mass': vector3,
        'inertia': spatial_inertia}),
    'joints': (Joint, {
        'type': _type_of(*JOINT_FREEDOMS), 'position': vector3,
        'angle': partial(_left_out, 0.0, 'the plane'), 'actuated': boolean,
        'orientation': orientation, 'axis': partial(_given, direction),
        'second_axis': partial(_given, direction), 'lead': partial(_given, number)}),
    'cut_joints': (CutJoint, {
        'type': _type_of(*SPATIAL_CUT_JOINT_EQUATIONS), 'point_a': vector3,
        'point_b': vector3, 'angle': partial(_left_out, 0.0, 'the plane'),
        'axis_a': partial(_given, direction), 'axis_b': partial(_given, direction),
        'orientation': orientation, 'length': partial(_given, positive), 'actuated': boolean,
        'lead': partial(_given, _not_zero)}),
    'points': (Point, {'position': vector3}),
    'couplings': (Coupling, _COUPLING),
}
# Which joints have which keys, and must have them.
_KEYS_OF_JOINTS = {
    'joints': {'axis': WITH_AXIS, 'second_axis': (UNIVERSAL,), 'lead': (HELICAL,)},
    'cut_joints': {'axis_a': CUT_WITH_AXIS_A, 'axis_b': CUT_WITH_AXIS_B, 'length': (DISTANCE,),
                   'lead': (HELICAL,)}}
# Keys of joints and cut joints that only mechanisms in space have.
KEYS_OF_SPACE = ('axis', 'second_axis', 'lead', 'axis_a', 'axis_b', 'orientation')
# Cut joints in the plane that have no angle.
_WITHOUT_ANGLE = (DISTANCE,)
# Components of unit vectors along one axis may differ by so much.
AXES_APART = 1e-6
# Cosine of the angle between universal axes from which on they are parallel.
PARALLEL = 0.999
# Names that would be ambiguous in one place: CSV columns and topics, frames.
_SHARED_NAMES = (('joints', 'cut_joints'), ('joints', 'couplings'), ('cut_joints', 'couplings'),
                 ('bodies', 'points'))


def validate_mechanism(mechanism, source=None):
    """
    Check a mechanism that was built in Python by the rules of those read from files.

    Returns an equal one with every number a float and every list a tuple. ``source`` is its name
    in error messages; its own name by default. MechanismError where it is not a mechanism.
    """
    with _of(source or f'mechanism {getattr(mechanism, "name", mechanism)!r}'):
        return checked(mechanism)


@contextmanager
def _of(source):
    """Make MechanismErrors that begin with a source of the FieldErrors raised in this block."""
    try:
        yield
    except FieldError as error:
        raise MechanismError(f'{source}: {error}') from None


def checked(mechanism):
    """Return a normalised copy of a mechanism, itself if it is one, or raise FieldError."""
    if not isinstance(mechanism, Mechanism):
        raise FieldError('a Mechanism', shown(mechanism))
    if mechanism.valid:
        return mechanism
    spatial = is_spatial(mechanism)
    mechanism = normalise(replace(mechanism), name=name, description=text, tolerance=_tolerance,
                          **(_SPATIAL_CHECKS if spatial else _CHECKS))
    for key in ('bodies', 'joints'):
        if not getattr(mechanism, key):
            raise FieldError('at least one entry', 'none', path=(key,))
    _check_names(mechanism)
    _check_references(mechanism)
    check_tree(mechanism)
    _check_couplings(mechanism)
    if spatial:
        check_axes(mechanism)
    mechanism = with_agreement(mechanism)
    object.__setattr__(mechanism, 'valid', True)
    return mechanism


def with_bodies(mechanism, bodies):
    """
    Return a checked mechanism with other numbers of its bodies; only those are checked.

    They have the same names and flags, in the same order. MechanismError.
    """
    _, checks = (SECTIONS if mechanism.planar else SPATIAL_SECTIONS)['bodies']
    other = copied(mechanism)
    with _of(f'mechanism {mechanism.name!r}'), at('bodies'):
        for body, known in zip(bodies, mechanism.bodies):
            if body is not known:
                changed = {key: check for key, check in (
                    {**checks, **_MASSLESS} if body.massless else checks).items()
                    if getattr(body, key) is not getattr(known, key)}
                with at(body.name):
                    normalise(body, **changed)
    object.__setattr__(other, 'bodies', bodies)
    return other


def is_spatial(mechanism):
    """Return whether an unchecked mechanism is meant to be in space, as its first joint is."""
    try:
        return len(mechanism.joints[0].position) == 3
    except (AttributeError, IndexError, KeyError, TypeError):
        return False


def _zero(value):
    """Return zero; raise unless ``value`` is that."""
    result = number(value, 'zero, or nothing, of a massless body')
    if result != 0.0:
        raise FieldError('zero, or nothing, of a massless body', shown(value))
    return result


# What replaces the checks of a body that is meant to be massless.
_MASSLESS = {'mass': _zero, 'inertia': _zero}


def _records_check(record_type, checks):
    """Return the check for a list of records of one type."""
    # By identity: where many mechanisms differ in one record, the others are the same.
    passed = WeakValueDictionary()

    def check(records):
        result = []
        for record in listed(records):
            if passed.get(id(record)) is record:
                result.append(record)
                continue
            if not isinstance(record, record_type):
                raise FieldError(f'a {record_type.__name__}', shown(record))
            with at(record.name):
                name(record.name)
                massless = getattr(record, 'massless', False) is True
                record = normalise(
                    replace(record), **{**checks, **(_MASSLESS if massless else {})})
            passed[id(record)] = record
            result.append(record)
        return tuple(result)
    return check


_CHECKS = {key: _records_check(*section) for key, section in SECTIONS.items()}
_SPATIAL_CHECKS = {key: _records_check(*section) for key, section in SPATIAL_SECTIONS.items()}


def _check_names(mechanism):
    """Refuse a name given twice in a section or in two sections that share names."""
    for key in SECTIONS:
        names = set()
        for record in getattr(mechanism, key):
            if record.name in names:
                raise FieldError('every name once', f'{record.name!r} twice',
                                 path=(key, record.name))
            if record.name == GROUND:
                raise FieldError(f"any name but '{GROUND}', which is the world", f"'{GROUND}'",
                                 path=(key, GROUND))
            names.add(record.name)
    for first, second in _SHARED_NAMES:
        names = {record.name for record in getattr(mechanism, first)}
        for record in getattr(mechanism, second):
            if record.name in names:
                raise FieldError(f'a name that is not used in {first}',
                                 f'{record.name!r}, which {first} has too', 'rename one',
                                 (second, record.name))


def _check_references(mechanism):
    """Refuse names of bodies that do not exist and cut joints within one body."""
    bodies = {body.name: body for body in mechanism.bodies}

    def check(section, record, key, with_ground=True):
        value = getattr(record, key)
        if isinstance(value, str) and (value in bodies or (with_ground and value == GROUND)):
            return
        known = [*bodies, GROUND] if with_ground else bodies
        expected = 'the name of a body' + (f" or '{GROUND}'" if with_ground else '')
        raise FieldError(expected, shown(value),
                         nearest(value, known) or f'there are {among(known)}',
                         (section, record.name, key))

    for joint in mechanism.joints:
        check('joints', joint, 'parent')
        check('joints', joint, 'child', with_ground=False)
    for point in mechanism.points:
        check('points', point, 'body')
    for cut in mechanism.cut_joints:
        check('cut_joints', cut, 'body_a')
        check('cut_joints', cut, 'body_b')
        if cut.body_a == cut.body_b:
            raise FieldError('two different bodies in body_a and body_b',
                             f'{cut.body_a!r} in both', path=('cut_joints', cut.name, 'body_b'))
        _require_key('cut_joints', cut, 'length', (DISTANCE,))
        if cut.type in _WITHOUT_ANGLE and cut.angle != 0.0:
            raise FieldError(f'no angle in a {cut.type} cut joint, which leaves it free',
                             shown(cut.angle), path=('cut_joints', cut.name, 'angle'))
        if cut.actuated and cut.type not in mechanism.measured_types:
            raise FieldError(f'no drive of a cut joint, but of {among(mechanism.measured_types)}',
                             f'one that is {cut.type}', 'cut another joint of that loop',
                             ('cut_joints', cut.name, 'actuated'))


def _check_couplings(mechanism):
    """Refuse couplings of joints of several degrees of freedom, and radii of sliding ones."""
    joints = {joint.name: joint for joint in mechanism.joints}
    cuts, followers = {cut.name: cut for cut in mechanism.cut_joints}, {}
    for coupling in mechanism.couplings:
        for key in coupling.joints:
            with at('couplings', coupling.name, 'joints', key):
                if key in cuts:
                    if cuts[key].type not in COUPLED:
                        raise FieldError(f'a joint of one degree of freedom: {among(COUPLED)}',
                                         f'a {cuts[key].type} cut joint')
                    continue
                one_of(tuple(joints), 'one of the joints')(key)
                if joints[key].type not in COUPLED:
                    raise FieldError(f'a joint of one degree of freedom: {among(COUPLED)}',
                                     f'one that is {joints[key].type}')
        found = [cut.name for cut in measured(mechanism, coupling)]
        if len(found) > 1:
            raise FieldError(
                'one cut joint at most whose coordinate is not a sum of those of the tree',
                f'{", ".join(found)}', 'cut other joints of these loops',
                ('couplings', coupling.name, 'joints'))
        if coupling.law is not None:
            with at('couplings', coupling.name):
                _check_law(coupling, joints, found, followers)
        if not (found or in_tree(mechanism, coupling)[0]):
            raise FieldError('joints whose coordinates change the sum', 'a sum that never changes',
                             path=('couplings', coupling.name, 'joints'))
        first = next(iter(coupling.joints))
        if coupling.radius is not None and {**cuts, **joints}[first].type == PRISMATIC:
            raise FieldError(f'no radius: its first joint, {first}, slides, and its force is that '
                             'of the teeth', shown(coupling.radius),
                             path=('couplings', coupling.name, 'radius'))


def _check_law(coupling, joints, cuts, followers):
    """
    Refuse a law of a joint that has none, or beside another one.

    ``joints``: of the tree by name; ``cuts``: names of cut joints that it couples beside these;
    ``followers``: couplings by the joint that a law gives, which this adds to.
    """
    with at('law', 'joint'):
        law = coupling.law
        one_of(tuple(joints), 'one of the joints of the tree')(law.joint)
        if joints[law.joint].type not in COUPLED:
            raise FieldError(f'a joint of one degree of freedom: {among(COUPLED)}',
                             f'one that is {joints[law.joint].type}')
        if law.joint in coupling.joints:
            raise FieldError('a joint without a factor in this coupling', f'{law.joint!r}',
                             'a factor is a coefficient of x in the law')
    if cuts:
        raise FieldError('joints of the tree in a coupling with a law', among(cuts),
                         'cut other joints of these loops', ('joints',))
    if len(coupling.joints) == 1:
        follower, = coupling.joints
        if followers.setdefault(follower, coupling.name) != coupling.name:
            raise FieldError('a joint that follows from one law',
                             f'{follower!r}, which {followers[follower]!r} gives already',
                             path=('joints', follower))


def check_tree(mechanism):
    """Raise unless the joints are a tree on the ground: each body the child of one."""
    carrier = {}
    for joint in mechanism.joints:
        first = carrier.setdefault(joint.child, joint)
        if first is not joint:
            raise FieldError(
                'a body that no other joint carries',
                f'{joint.child!r}, which joint {first.name!r} carries already',
                'close the loop by a cut joint instead', ('joints', joint.name, 'child'))
    for body in mechanism.bodies:
        if body.name not in carrier:
            raise FieldError('a joint that has this body as its child', 'none',
                             'add one to joints, or remove the body', ('bodies', body.name))
    grounded = {GROUND}
    for joint in mechanism.joints:
        chain = {}
        body = joint.child
        while body not in grounded:
            if body in chain:
                raise FieldError(
                    f"a chain of parents that ends at '{GROUND}'",
                    f'the cycle {" -> ".join([*chain, body])}',
                    'close the loop by a cut joint instead', ('joints', joint.name, 'parent'))
            chain[body] = joint
            body = carrier[body].parent
        grounded.update(chain)


def _require_key(section, joint, key, types):
    """Require a key of joints of some types, and refuse it in others."""
    given = getattr(joint, key) is not None
    if given != (joint.type in types):
        raise FieldError(
            f'this key of a {joint.type} joint' if not given else
            f'no such key of a {joint.type} joint, but of {among(types)}',
            'none' if not given else shown(getattr(joint, key)),
            path=(section, joint.name, key))


def check_axes(mechanism):
    """Refuse axes that a joint in space does not have, and require those that it has."""
    for section, keys in _KEYS_OF_JOINTS.items():
        for joint in getattr(mechanism, section):
            for key, types in keys.items():
                _require_key(section, joint, key, types)
    for joint in mechanism.joints:
        if joint.type == UNIVERSAL and abs(np.dot(joint.axis, joint.second_axis)) > PARALLEL:
            raise FieldError('a second axis across the first', 'one that is parallel to it',
                             path=('joints', joint.name, 'second_axis'))
    for cut in mechanism.cut_joints:
        if cut.type not in CUT_WITH_ZERO and cut.orientation != UNTURNED:
            raise FieldError(f'no orientation of a {cut.type} joint, which leaves it free',
                             shown(cut.orientation),
                             path=('cut_joints', cut.name, 'orientation'))
        if cut.orientation == UNTURNED:
            continue
        if cut.type in (REVOLUTE, CYLINDRICAL, PLANAR):
            apart = np.abs(rotated(cut.orientation, cut.axis_a) - cut.axis_b).max()
            if apart > AXES_APART:
                raise FieldError('an orientation that turns axis_a to where axis_b is',
                                 f'one that leaves them {apart:.3g} apart',
                                 path=('cut_joints', cut.name, 'orientation'))
        if cut.type == UNIVERSAL and abs(np.dot(
                rotated(cut.orientation, cut.axis_a), cut.axis_b)) > PARALLEL:
            raise FieldError('an orientation that turns axis_a across axis_b',
                             'one that leaves them parallel',
                             path=('cut_joints', cut.name, 'orientation'))
