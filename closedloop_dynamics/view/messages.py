# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Requests of pages, checked where they arrive, and the replies."""

from dataclasses import fields
import json

from .adding import NEEDED
from ..effects.registry import effect_type
from ..mechanism.checks import boolean, list_of, name, number, one_of, text
from ..mechanism.fields import at, FieldError, mapping, shown

# Where machines come from.
SHIPPED, YOURS = 'shipped', 'yours'
# Kinds of parts that can be removed.
REMOVALS = BODY, JOINT, POINT, EFFECT = 'body', 'joint', 'point', 'effect'
# Seconds of motion per second.
SLOWEST, FASTEST = 0.01, 10.0
MOST_STEPS = 1000
TORQUE, POSITION, SPEED, EXPRESSION = 'torque', 'position', 'speed', 'expression'
# As a controller, or the scene's own motion, has it.
OWN = 'own'
HELD, FREE = 'held', 'free'
# What pages see, and can change, of the method.
METHOD_KEYS = ('integrator', 'accuracy', 'budget', 'tolerance', 'step_size', 'stabilisation')


def _speed(value):
    value = number(value)
    if not SLOWEST <= value <= FASTEST:
        raise FieldError(f'a number from {SLOWEST:g} to {FASTEST:g}', shown(value))
    return value


def _count(value):
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= MOST_STEPS:
        raise FieldError(f'a whole number from 1 to {MOST_STEPS}', shown(value))
    return value


def _word(value):
    """Return a possible name of a joint or of one of its freedoms."""
    if not isinstance(value, str):
        raise FieldError('a name', shown(value))
    return value


def _number_or_text(value):
    """Return a number, or the text of an expression; which of them is checked where it acts."""
    return value if isinstance(value, str) else number(value)


def _index(value):
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise FieldError('a whole number that is zero or more', shown(value))
    return value


def _place(value):
    found = list_of(number)(value)
    if len(found) != 3:
        raise FieldError('a list of 3 finite numbers [x, y, z]', shown(value))
    return found


def _values(value):
    """Return values of an effect or a method by key; their meaning is checked later."""
    found = {}
    for key, item in mapping(value).items():
        with at(key):
            if isinstance(item, list):
                item = list_of(number)(item)
            elif not (item is None or isinstance(item, (bool, str))):
                item = number(item)
            found[key] = item
    return found


# What to do -> its keys, each with its check.
ASKED = {
    'play': {}, 'pause': {}, 'reset': {}, 'release': {},
    'step': {'count': _count},
    'speed': {'factor': _speed},
    'drive': {'joint': _word, 'mode': one_of((TORQUE, POSITION, SPEED, EXPRESSION, OWN))},
    'motion': {'which': one_of((OWN, HELD, FREE))},
    'command': {'joint': _word, 'value': _number_or_text},
    'effect': {'name': name, 'enabled': boolean, 'values': _values},
    'method': {'values': _values},
    'grab': {'body': _index, 'place': _index, 'at': _place},
    'pull': {'at': _place},
    'kinematic': {'on': boolean},
    'pose': {'joint': _word, 'value': number},
    # What is edited.
    'edit': {'on': boolean},
    'set': {'key': text, 'value': number},
    'move': {'kind': _word, 'name': _word, 'at': _place},
    'add': {'what': one_of(tuple(NEEDED)), 'joint': _word, 'body_a': _word, 'a': _place,
            'body_b': _word, 'b': _place},
    'remove': {'kind': one_of(REMOVALS), 'name': _word},
    'assemble': {'number': _index},
    'undo': {}, 'redo': {},
    # Files.
    'open': {'name': name, 'kind': one_of((SHIPPED, YOURS))},
    'load': {'name': name, 'text': text},
    'check': {'number': _index, 'name': name, 'text': text},
    'save': {'name': name},
    # How far the page has got with the frames it was sent.
    'seen': {'frame': _index},
}
OPTIONAL = {'effect': ('enabled', 'values'), 'add': ('joint', 'body_a', 'a', 'body_b', 'b')}


def describe_effects(effects, enabled):
    """Return the description of effects for pages, by name; ``enabled`` states which names act."""
    return {name: {
        'type': effect_type(record), 'enabled': enabled(name),
        'values': {each.name: getattr(record, each.name) for each in fields(record)}}
        for name, record in effects.items()}


def describe_drives(drives):
    """Return mode and value of drives, by joint, as JSON can; ``drives`` begin with the two."""
    return {name: {'mode': mode, 'value': value} for name, (mode, value, *_) in drives.items()}


def drive_of(drives, joint):
    """Return the drive of a joint; raise FieldError where there is none."""
    if joint not in drives:
        raise FieldError(f'one of the driven joints ({", ".join(drives)})', shown(joint),
                         path=('joint',))
    return drives[joint]


def require_one_number(coordinates, joint, mode):
    """Refuse to track a position of a joint whose position is not one number."""
    if mode != TORQUE and coordinates.place[coordinates.index[joint]] < 0:
        raise FieldError('a torque', 'a position', 'an orientation is not one number', ('mode',))


def require_kinematic(kinematic):
    """Refuse to pose a mechanism that moves by forces."""
    if not kinematic:
        raise FieldError('kinematic mode', 'a pose while the mechanism moves by forces')


def read(text):
    """
    Return the request of a page: JSON with the action under ``do``, and its keys.

    Raises FieldError where it makes no sense.
    """
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise FieldError('JSON', shown(text)) from None
    mapping(message, ('do',))
    with at('do'):
        checks = ASKED[one_of(tuple(ASKED))(message['do'])]
    optional = OPTIONAL.get(message['do'], ())
    mapping(message, ('do', *(key for key in checks if key not in optional)), optional)
    for key, check in checks.items():
        if key in message:
            with at(key):
                message[key] = check(message[key])
    return message
