# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The rules that every planar mechanism obeys, read from a file or built in Python."""

from dataclasses import replace
from numbers import Real
from weakref import WeakValueDictionary

from .checks import boolean, listed, name, not_negative, number, one_of, positive, text, vector2
from .fields import among, at, FieldError, nearest, normalise, shown
from .mechanism import (Body, CUT_JOINT_EQUATIONS, CutJoint, GROUND, Joint, JOINT_TYPES, Mechanism,
                        MechanismError, Point, REVOLUTE)


def _mass(value):
    """Return a positive mass; tell of massless bodies where it is zero."""
    try:
        return positive(value)
    except FieldError as error:
        if not isinstance(value, bool) and isinstance(value, Real) and value == 0.0:
            error.note = 'a body without mass on purpose says massless: true'
        raise


# Section of the file (and field of Mechanism) -> its record and the checks of its fields.
SECTIONS = {
    'bodies': (Body, {
        'massless': boolean, 'mass': _mass, 'center_of_mass': vector2,
        'inertia': not_negative}),
    'joints': (Joint, {
        'type': one_of(JOINT_TYPES), 'position': vector2, 'angle': number, 'actuated': boolean}),
    'cut_joints': (CutJoint, {
        'type': one_of(tuple(CUT_JOINT_EQUATIONS)), 'point_a': vector2, 'point_b': vector2,
        'angle': number}),
    'points': (Point, {'position': vector2}),
}
# Names that would stand for two things in one place: CSV columns and topics, frames.
_SHARED_NAMES = (('joints', 'cut_joints'), ('bodies', 'points'))


def validate_mechanism(mechanism, source=None):
    """
    Check a mechanism that was built in Python by the rules of those read from files.

    Parameters
    ----------
    mechanism : Mechanism
        Built in Python.
    source : str, optional
        What errors call it; its own name by default.

    Returns
    -------
    Mechanism
        An equal one with every number a float and every list a tuple.

    Raises
    ------
    MechanismError
        Where it is no planar mechanism.

    """
    try:
        return checked(mechanism)
    except FieldError as error:
        source = source or f'mechanism {getattr(mechanism, "name", mechanism)!r}'
        raise MechanismError(f'{source}: {error}') from None


def checked(mechanism):
    """Return a normalised copy of a mechanism, itself if it is one, or raise FieldError."""
    if not isinstance(mechanism, Mechanism):
        raise FieldError('a Mechanism', shown(mechanism))
    if mechanism.valid:
        return mechanism
    mechanism = normalise(replace(mechanism), name=name, description=text, **_CHECKS)
    for key in ('bodies', 'joints'):
        if not getattr(mechanism, key):
            raise FieldError('at least one entry', 'none', path=(key,))
    _check_names(mechanism)
    _check_references(mechanism)
    _check_tree(mechanism)
    object.__setattr__(mechanism, 'valid', True)
    return mechanism


def _zero(value):
    """Return zero if that is what ``value`` is."""
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
        if cut.type == REVOLUTE and cut.angle != 0.0:
            raise FieldError('no angle in a revolute cut joint, which leaves it free',
                             shown(cut.angle), path=('cut_joints', cut.name, 'angle'))


def _check_tree(mechanism):
    """Refuse what is no tree on the ground: each body is the child of one joint."""
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
