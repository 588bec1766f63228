# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The numbers of a scene by their key paths: ``mechanism.bodies.crank.mass``.

A key path is written as the keys stand in the files, with the places in lists as numbers:
``mechanism.joints.elbow.position.0``, ``initial.velocity.theta_1``,
``effects.gravity.acceleration.1``, ``method.step_size``, ``parameters.l``.
"""

from dataclasses import fields, replace
from typing import get_args
from weakref import ref

from .loading import scene_with
from ..mechanism.checks import number
from ..mechanism.fields import among, at, copied, FieldError, nearest
from ..mechanism.validation import KEYS_OF_SPACE, SECTIONS, with_bodies


def numbers(scene):
    """
    Return the numbers that a scene is made of, by key path.

    None for a number that may be given but is not.
    """
    return dict(_leaves(_tree(scene)))


def resolve(scene, key):
    """Return the keys of a key path, or refuse, with FieldError, one that leads to no number."""
    path = tuple(str(key).replace('[', '.').replace(']', '').split('.'))
    here = _tree(scene)
    for depth, word in enumerate(path):
        if not isinstance(here, dict):
            raise FieldError('a key path that ends with a number', 'more below it',
                             f'remove .{".".join(path[depth:])}', (str(key),))
        if word not in here:
            raise FieldError(
                f'one of {among(here) or "no keys"}' + (
                    f' after {".".join(path[:depth])}' if depth else ''),
                repr(word), nearest(word, here), (str(key),))
        here = here[word]
    if isinstance(here, dict):
        raise FieldError('a key path that leads to a number', 'one that leads to several',
                         f'add one of {among(here)}', (str(key),))
    return path


def changed(scene, values):
    """
    Return a scene with other numbers.

    FieldError, MechanismError where a value is impossible at its place, or beside the others.
    """
    changes = {}
    for path, value in values.items():
        with at('.'.join(path)):
            value = number(value)
        here = changes
        for word in path[:-1]:
            here = here.setdefault(word, {})
        here[path[-1]] = value
    if _is_numbers_alone(changes):
        return _with_numbers(scene, changes)
    if 'parameters' in changes:
        # First, so that values given beside them override theirs.
        scene = scene_with(scene, changes.pop('parameters'))
    new = {}
    for section, below in changes.items():
        with at(section):
            new[section] = _SECTIONS[section](scene, below)
    return replace(scene, **new)


def _is_numbers_alone(changes):
    """Return whether changes are such as nothing else in a scene is checked against."""
    return set(changes) <= {'mechanism', 'effects'} and (
        set(changes.get('mechanism', {})) <= {'bodies'})


def _with_numbers(scene, changes):
    """Return a scene with other numbers of bodies and effects; only these are checked."""
    other, mechanism = copied(scene), scene.mechanism
    if 'mechanism' in changes:
        mechanism = with_bodies(mechanism, _put(
            mechanism.bodies, changes['mechanism']['bodies']))
    effects = dict(scene.effects)
    for name, values in changes.get('effects', {}).items():
        with at('effects', name):
            effects[name] = _with(effects[name], values)
            effects[name].fit(mechanism)
    object.__setattr__(other, 'mechanism', mechanism)
    object.__setattr__(other, 'effects', effects)
    return other


# The scene whose numbers were requested last, and these.
_latest = (lambda: None), {}


def _tree(scene):
    """Return the numbers of a scene as nested dicts by their keys; not to be changed."""
    global _latest
    known, tree = _latest
    if known() is not scene:
        tree = _fresh_tree(scene)
        _latest = ref(scene), tree
    return tree


def _fresh_tree(scene):
    """Return the same, collected from its records."""
    mechanism, initial = scene.mechanism, scene.initial
    # Other velocities than those held follow from the loops, whatever is given.
    start = {'position': _by_path(mechanism, 'position', initial.position),
             'velocity': _by_path(mechanism, 'velocity', initial.velocity, initial.hold)}
    whole = {
        'mechanism': {key: {record.name: _of_the_plane(_below(record))
                            for record in getattr(mechanism, key)} for key in SECTIONS},
        'initial': start,
        'effects': {name: _below(record) for name, record in scene.effects.items()},
        'method': _below(scene.method),
        'parameters': {} if scene.source is None else dict(scene.parameters)}
    return _pruned(whole)


def _below(value):
    """Return the numbers below a record or a tuple as nested dicts, a number as it is."""
    if isinstance(value, tuple):
        return {str(index): _below(item) for index, item in enumerate(value)}
    if isinstance(value, float):
        return value
    if isinstance(value, dict):
        return {key: _below(item) for key, item in value.items()}
    try:
        keys = fields(value)
    except TypeError:
        return {}
    return {key.name: None if float in get_args(key.type) and getattr(value, key.name) is None
            else _below(getattr(value, key.name)) for key in keys}


def _of_the_plane(record):
    return {key: value for key, value in record.items() if key not in KEYS_OF_SPACE}


def _pruned(tree):
    """Leave out branches without numbers."""
    if not isinstance(tree, dict):
        return tree
    below = {key: _pruned(value) for key, value in tree.items()}
    return {key: value for key, value in below.items() if value != {}}


def _leaves(tree, path=()):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*path, key))
        else:
            yield '.'.join((*path, key)), value


def _with(value, below):
    """Return a record or tuple with the entries of a nested dict."""
    if isinstance(value, tuple):
        return tuple(_replaced(item, below, str(index)) for index, item in enumerate(value))
    if isinstance(value, dict):
        return {key: _replaced(item, below, key) for key, item in value.items()}
    return replace(value, **{key: _replaced(getattr(value, key), below, key) for key in below})


def _replaced(value, below, key):
    if key not in below:
        return value
    return _with(value, below[key]) if isinstance(below[key], dict) else below[key]


def _mechanism(scene, below):
    mechanism = scene.mechanism
    return replace(mechanism, **{
        key: _put(getattr(mechanism, key), records) for key, records in below.items()})


def _put(records, below):
    """Return the records of a section with the entries of a nested dict."""
    return tuple([_replaced(record, below, record.name) if record.name in below else record
                  for record in records])


def _initial(scene, below):
    new = {}
    for key, joints in below.items():
        places = scene.mechanism.coordinates.paths(key)
        values = list(getattr(scene.initial, key))
        for path, value in _leaves(joints):
            values[places[tuple(path.split('.'))]] = value
        new[key] = tuple(values)
    return replace(scene.initial, **new)


def _by_path(mechanism, key, values, of=()):
    """Return the numbers of joints, or of some of them, as nested dicts by their keys."""
    found = {}
    for path, place in mechanism.coordinates.paths(key).items():
        if of and not {path[0], '.'.join(path)} & set(of):
            continue
        here = found
        for word in path[:-1]:
            here = here.setdefault(word, {})
        here[path[-1]] = values[place]
    return found


def _effects(scene, below):
    new = dict(scene.effects)
    for name, values in below.items():
        with at(name):
            new[name] = _with(new[name], values)
    return new


def _method(scene, below):
    return _with(scene.method, below)


_SECTIONS = {'mechanism': _mechanism, 'initial': _initial, 'effects': _effects, 'method': _method}
