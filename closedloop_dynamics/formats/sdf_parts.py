# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models in models of SDF, written there or included from files, as one model.

What is in a model ``arm`` is called ``arm::link`` in the one around it, as references from there
call it, and the model's own frame ``arm``. Files are found in the folder of the one that includes
them and below, beside that folder, and where the environment lists models.
"""

import os
from pathlib import Path

from .visuals import SEARCHED
from .xml_file import Element, read_xml

MODEL, WORLD = '__model__', 'world'
SCOPE = '::'
TRUE, FALSE = ('true', '1'), ('false', '0')
# The version in which axes began to be given in the joint's frame.
OWN_AXES = (1, 5)
MOST_FILES = 100
# Children whose text is the name of a frame, and attributes that are.
_TEXTS = ('parent', 'child', 'gearbox_reference_body', 'drake:ball_constraint_body_A',
          'drake:ball_constraint_body_B', 'drake:parent_frame', 'drake:child_frame',
          # Keys of plugins.
          'parent_link', 'child_link', 'joint', 'mimicJoint')
_ATTRIBUTES = ('attached_to', 'relative_to', 'frame', 'expressed_in', 'joint')


def flattened(model, version, options, opened=()):
    """
    Put the parts of the models in an element model into it, in place.

    ``version`` is that of the file that it is in, ``opened`` are the files that it is included
    from. MechanismError with file, line and element.
    """
    kept = []
    for child in model.children:
        if child.tag not in ('model', 'include'):
            kept.append(child)
            continue
        part, own, files, merged = child, version, opened, False
        if child.tag == 'include':
            merged = child.get('merge') in TRUE
            part, own, files = included(child, options, opened)
        flattened(part, own, options, files)
        kept += _parts(part, own, merged)
    model.children = kept


def version_of(root):
    """Return the version of an element sdf, a tuple of 2 ints."""
    words = root.get('version', '1.12').split('.')
    if len(words) != 2 or not all(word.isdecimal() and len(word) < 4 for word in words):
        raise root.error('a version such as 1.10', repr(root.get('version')))
    return tuple(map(int, words))


def included(element, options, opened=()):
    """
    Read the model that an element include names.

    Returns the model, with the name and the pose that the element gives it, the version of its
    file, and ``opened`` with this file. MechanismError where there is no such file, or it has no
    model.
    """
    uri = element.required('uri')
    path = _found(uri, options)
    if path in opened or len(opened) > MOST_FILES:
        raise uri.error('files that do not include themselves', repr(uri.text))
    root = read_xml(path, ('sdf',))
    model = root.child('model')
    if model is None:
        raise root.error('a child <model>', 'none')
    name = element.child('name')
    if name is not None:
        model.attributes['name'] = name.text
    for tag in ('pose', 'static'):
        given = element.child(tag)
        if given is not None:
            model.children = [child for child in model.children if child.tag != tag]
            model.children.append(given)
    placed = element.child('placement_frame')
    if placed is not None:
        model.attributes['placement_frame'] = placed.text
    return model, version_of(root), (*opened, path)


def _found(uri, options):
    """Return the path of the file that a uri names."""
    folder = Path(uri.source).resolve().parent
    scheme, given, rest = uri.text.partition('://')
    places = [folder / uri.text]
    if given and scheme == 'model':
        listed = [Path(place) for variable in SEARCHED
                  for place in os.environ.get(variable, '').split(os.pathsep) if place]
        places = [place / rest for place in (folder, folder.parent, *listed)]
    elif given:
        places = [Path(rest)] if scheme == 'file' and options.anywhere else []
    for place in places:
        try:
            place = place / 'model.sdf' if place.is_dir() else place
            if place.is_file() and (options.anywhere or given or place.resolve().is_relative_to(
                    folder)):
                return place.resolve()
        except (OSError, ValueError):
            # A name that is too long, or none.
            continue
    raise uri.error('a file that is there, in the folder or below, or a model of its name',
                    repr(uri.text))


def _parts(model, version, merged):
    """Return the links, joints and frames of a model as those of the one around it."""
    name = model.word('name')
    frame, prefix = (f'_merged_{name}', '') if merged else (name, f'{name}{SCOPE}')
    if model.child('placement_frame') is not None or model.get('placement_frame'):
        raise model.error('the pose of the whole model', 'a placement_frame')

    def called(word):
        if word == WORLD:
            return word
        return frame if word == MODEL else prefix + word

    links = [child for child in model.children if child.tag == 'link']
    found = [_frame(model, frame, links, called)]
    for child in model.children:
        if child.tag in ('pose', 'static'):
            continue
        if child.tag in ('link', 'frame', 'joint'):
            child.attributes['name'] = prefix + child.word('name')
        renamed(child, called)
        if child.tag == 'link':
            _place(child, frame)
        elif child.tag == 'frame':
            child.attributes.setdefault('attached_to', frame)
        for axis in child.children if child.tag == 'joint' else ():
            _express(axis, version, frame)
        found.append(child)
    return found


def _frame(model, name, links, called):
    """Return a model's own frame, on its first link."""
    found = Element('frame', {'name': name}, model.source, model.line)
    if links:
        found.attributes['attached_to'] = called(links[0].word('name'))
    pose = model.child('pose')
    if pose is not None:
        found.children.append(pose)
    _place(found, MODEL)
    return found


def _place(element, frame):
    """Give the pose of an element relative to a frame, where it names none."""
    pose = element.child('pose')
    if pose is None:
        pose = Element('pose', {}, element.source, element.line)
        pose.text = ''
        element.children.append(pose)
    if not (pose.get('relative_to') or pose.get('frame')):
        pose.attributes['relative_to'] = frame


def _express(axis, version, frame):
    """Give an axis that is in the model's frame in that frame."""
    if axis.tag not in ('axis', 'axis2') or axis.child('xyz') is None:
        return
    parent, xyz = axis.child('use_parent_model_frame'), axis.child('xyz')
    if not xyz.get('expressed_in') and (
            version < OWN_AXES if parent is None else parent.text in TRUE):
        xyz.attributes['expressed_in'] = frame


def renamed(element, called):
    """Call frames otherwise wherever an element refers to one."""
    for key in _ATTRIBUTES:
        if element.attributes.get(key):
            element.attributes[key] = called(element.attributes[key])
    if element.tag in _TEXTS and element.text:
        element.text = called(element.text)
    for child in element.children:
        if child.tag != 'visual':
            renamed(child, called)
