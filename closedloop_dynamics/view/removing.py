# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Removal of parts of a scene, with the parts that depend on them."""

from dataclasses import fields

from .messages import BODY, EFFECT, JOINT, POINT
from ..mechanism.document import with_value, without_entry
from ..mechanism.fields import FieldError, shown

# Places of the parts of a kind in a file, by the key of the mapping of their names.
SECTIONS = {BODY: ('bodies',), JOINT: ('cut_joints', 'joints'), POINT: ('points',)}


def removable(scene):
    """Return the names of removable parts, by kind, as JSON."""
    mechanism = scene.mechanism
    carriers = {joint.parent for joint in mechanism.joints}
    joints = [cut.name for cut in mechanism.cut_joints]
    if mechanism.tree is not None:
        # Another one is chosen.
        joints += [joint.name for joint in mechanism.joints]
    return {
        BODY: [body.name for body in mechanism.bodies if body.name not in carriers],
        JOINT: joints, POINT: [point.name for point in mechanism.points],
        EFFECT: list(scene.effects)}


def without(scene, text, kind, name):
    """
    Return the text of a scene without a part, and the names of the parts removed with it.

    With a body go its joints and points, and the effects and couplings of these. The text is None
    where it has no place of the part, whose kind is one of ``messages.REMOVALS``. FieldError where
    the part is not in the scene, or others hang on it.
    """
    _require(scene, kind, name)
    parts, joints = [(kind, name)], [name] if kind == JOINT else []
    if kind == BODY:
        found, joints = _with_body(scene, name)
        parts += found
    for what, one in parts:
        text = _less(text, what, one)
        if text is None:
            return None, []
    for joint in joints:
        for key in ('position', 'velocity', 'turned'):
            text = without_entry(text, ('initial', key, joint)) or text
    if kind in (BODY, JOINT) and scene.initial.hold:
        # The degrees of freedom have changed: the rest is closed from its present position.
        text = with_value(text, ('initial', 'hold'), [])
    return text, [one for _, one in parts[1:]]


def _require(scene, kind, name):
    mechanism = scene.mechanism
    if kind == BODY:
        hanging = [joint.child for joint in mechanism.joints if joint.parent == name]
        if hanging:
            raise FieldError('a body that no other hangs on',
                             f'{name}, which carries {", ".join(hanging)}', path=('remove',))
    if kind == JOINT and mechanism.tree is None:
        child = next((joint.child for joint in mechanism.joints if joint.name == name), None)
        if child is not None:
            raise FieldError('a joint that closes a loop', f'{name}, which {child} hangs on',
                             'remove that body', ('remove',))
    known = {BODY: mechanism.bodies, JOINT: (*mechanism.joints, *mechanism.cut_joints),
             POINT: mechanism.points}
    names = scene.effects if kind == EFFECT else [one.name for one in known[kind]]
    if name not in names:
        raise FieldError(f'a {kind} of the machine', shown(name), path=('remove',))


def _with_body(scene, name):
    """Return the parts removed with a body, kinds and names, and its joints."""
    mechanism = scene.mechanism
    joints = [joint.name for joint in mechanism.joints if joint.child == name]
    joints += [cut.name for cut in mechanism.cut_joints if name in (cut.body_a, cut.body_b)]
    points = [point.name for point in mechanism.points if point.body == name]
    gone = {name, *joints, *points}
    found = [*((JOINT, one) for one in joints), *((POINT, one) for one in points)]
    found += [('coupling', coupling.name) for coupling in mechanism.couplings
              if gone & set(coupling.names)]
    return found + [(EFFECT, effect) for effect, record in scene.effects.items()
                    if any(_names(getattr(record, field.name), gone)
                           for field in fields(record))], joints


def _names(value, names):
    """Return whether a value of an effect has one of some names in it."""
    if isinstance(value, str):
        return value in names
    return isinstance(value, (tuple, list, dict, set)) and any(
        _names(one, names) for one in value)


def _less(text, kind, name):
    """Return a text without a part; None where it is not in it."""
    if kind == EFFECT:
        return without_entry(text, ('effects', name))
    for section in SECTIONS.get(kind, ('couplings',)):
        less = without_entry(text, ('mechanism', section, name))
        if less is not None:
            return less
    return None
