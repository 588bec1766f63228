# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Joints and couplings that a file leaves to programs of a simulator.

A plugin that names two links holds the second on the first as they are drawn (Gazebo's
DetachableJoint among them, attached at the start); a plugin that names two joints couples these.
Keys are the same whether they are written ``parent_link`` or ``parentLink``.
"""


import numpy as np

from .model import Connection, free_name
from .sdf_parts import SCOPE
from ..mechanism.mechanism import FIXED

# Keys of two links, with the model of each; keys of a joint and of its follower.
_LINKS = (('parentlink', 'childlink', 'parentmodel', 'childmodel'),
          ('link1', 'link2', 'model1', 'model2'), ('linka', 'linkb', 'modela', 'modelb'),
          ('linkname1', 'linkname2', 'modelname1', 'modelname2'))
_JOINTS = (('joint', 'mimicjoint'), ('jointname', 'mimicjoint'), ('jointname', 'mimicjointname'))
# Links that are drawn further apart than this are reported [m].
APART = 1e-6


def add_programs(element, model, poses):
    """
    Add what the plugins in an element join and couple to a model.

    Plugins that are read are taken out of the element; others stay. ``poses`` are those of the
    model's links in the frame of the model, as they are drawn. MechanismError where a plugin names
    a link or joint that is not there.
    """
    left = []
    for plugin in element.children:
        if plugin.tag != 'plugin' or not (
                _join(plugin, model, poses) or _couple(plugin, model)):
            left.append(plugin)
    element.children = left


def _keys(plugin):
    """Return the children of a plugin by key, each key once."""
    return {child.tag.replace('_', '').lower(): child for child in plugin.children}


def _join(plugin, model, poses):
    """Hold two links together as they are drawn; return whether a plugin does."""
    keys = _keys(plugin)
    found = next((pair for pair in _LINKS if pair[0] in keys and pair[1] in keys), None)
    if found is None:
        return False
    ends = [_link(keys[key], keys.get(of), model) for key, of in zip(found[:2], found[2:])]
    if None in ends:
        return False
    (parent, child) = ends
    across = poses[parent].inverse @ poses[child]
    model.add(Connection(free_name(f'{parent}_holds_{child}', model.joints), FIXED, parent, child,
                         plugin.where, in_parent=across))
    distance = float(np.linalg.norm(across.position))
    apart = f', whose frames are {distance:.3g} m apart,' if distance > APART else ''
    model.ignored[f'the time at which {parent} and {child}{apart} are joined'] = (
        'a plugin joins them from the start on, as they are drawn')
    return True


def _link(element, of, model):
    """Return the link that an element names; None where it is one of another model."""
    name, owner = element.text, '' if of is None else of.text
    for known in (name, f'{owner}{SCOPE}{name}'):
        if known in model.links and owner in ('', model.name, *_scopes(known)):
            return known
    if owner in ('', model.name):
        model.frame(name, element.where)
        raise element.error('the name of a link', f'that of a frame, {name!r}')
    return None


def _scopes(link):
    """Return the names of the models that a link is in."""
    parts = link.split(SCOPE)[:-1]
    return [*parts, *(SCOPE.join(parts[:count]) for count in range(2, len(parts) + 1))]


def _couple(plugin, model):
    """Couple a joint with another one; return whether a plugin does."""
    keys = _keys(plugin)
    found = next((pair for pair in _JOINTS if pair[0] in keys and pair[1] in keys), None)
    if found is None:
        return False
    leader, follower = (keys[key].text for key in found)
    factor, offset = (number_in(keys.get(key), default) for key, default in (
        ('multiplier', 1.0), ('offset', 0.0)))
    model.mimic(plugin, follower, leader, factor, offset)
    return True


def number_in(element, default):
    """Return the number that is the text of an element, a default where there is no element."""
    if element is None:
        return default
    return element.values(element.text, 1, element.get('name') or element.tag)[0]


def add_parameters(control, model):
    """
    Add the couplings in an element ros2_control: parameters ``mimic`` of its joints.

    Returns the names of the joints that follow others.
    """
    found = []
    for joint in control.all('joint'):
        values = {one.get('name'): one for one in joint.children if one.tag == 'param'
                  and one.attributes.get('name') in ('mimic', 'multiplier', 'offset')}
        if 'mimic' not in values:
            continue
        joint.children = [one for one in joint.children if one not in values.values()]
        model.mimic(values['mimic'], joint.word('name'), values['mimic'].text, *(
            number_in(values.get(key), default) for key, default in (
                ('multiplier', 1.0), ('offset', 0.0))))
        found.append(joint.get('name'))
    return found
