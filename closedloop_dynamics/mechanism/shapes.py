# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Shapes of bodies: centre of mass and inertia of one material, and visuals.

A shape is one in space, also of a body in the plane, where its inertia is the moment about z.
"""

from collections.abc import Mapping
import math

import numpy as np

from .checks import (
    direction, not_negative, numbers, orientation, positive, text, vector2, vector3)
from .fields import among, at, FieldError, mapping, shown
from .inertia import moments_in
from .mechanism import BOX, CYLINDER, MESH, SPHERE, UNTURNED, Visual

# Shape -> required and optional keys.
SHAPES = {
    'box': (('size',), ('center', 'orientation')),
    'cylinder': (('radius', 'length', 'axis'), ('center',)),
    'sphere': (('radius',), ('center',)),
    'rod': (('to',), ('from', 'radius')),
}
# The same for drawn shapes.
VISUALS = {kind: (required, (*optional, 'color')) for kind, (required, optional) in {
    **SHAPES, MESH: (('file',), ('scale', 'center', 'orientation'))}.items()}
# What follows from a shape.
DERIVED = ('center_of_mass', 'inertia')


def with_shape(values, spatial):
    """
    Return the keys of a body with its shape replaced by the properties that follow.

    With ``mass``, ``center_of_mass``, ``inertia`` and, unless it is given, ``visual``, from
    ``shape`` and ``density`` [kg/m^3]. FieldError.
    """
    values = dict(values)
    shape = values.pop('shape', None)
    density = values.pop('density', None)
    if shape is None:
        if density is not None:
            raise FieldError('a density only with a shape', shown(density), path=('density',))
        return values
    for key in DERIVED:
        if key in values:
            raise FieldError(f'either shape or {key}, which follows from the shape', 'both',
                             path=(key,))
    if values.get('massless') is True:
        raise FieldError('either massless: true or a shape', 'both', path=('shape',))
    if ('mass' in values) == (density is not None):
        raise FieldError('either mass or density with a shape',
                         'none' if density is None else 'both', path=('mass',))
    with at('shape'):
        kind, found = _read(shape, SHAPES, spatial)
        with at(kind):
            volume, center, inertia = _finite_properties(kind, found)
    values.setdefault('visual', (_visual(kind, found),))
    if density is not None:
        with at('density'):
            density = positive(density)
        if not volume > 0.0:
            raise FieldError('a volume above zero with density', 'none',
                             'a rod needs a radius' * (kind == 'rod'), ('shape', kind))
        values['mass'] = density * volume
    with at('mass'):
        mass = positive(values['mass'])
    with np.errstate(over='ignore'):
        inertia = mass * inertia
    return {**values, 'center_of_mass': tuple(center.tolist()), 'inertia': (
        tuple(moments_in(inertia).tolist()) if spatial
        else float(inertia[2, 2]))}


def visuals(shapes, spatial):
    """Return the visuals of a body, of shapes with one of ``VISUALS`` each; raise FieldError."""
    if not isinstance(shapes, (list, tuple)):
        raise FieldError('a list of shapes', shown(shapes))
    found = []
    for index, shape in enumerate(shapes):
        with at(index):
            kind, values = _read(shape, VISUALS, spatial)
            with at(kind):
                found.append(_visual(kind, values))
    return tuple(found)


def as_data(visual, spatial):
    """Return a Visual as ``visuals`` reads it."""
    size, center = visual.size, list(visual.center[:3 if spatial else 2])
    color = {} if visual.color is None else {'color': list(visual.color)}
    if visual.kind == CYLINDER:
        x, y, z, w = visual.orientation
        axis = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
        if not size[0]:
            ends = [[one + sign * 0.5 * size[1] * along for one, along in zip(center, axis)]
                    for sign in (-1.0, 1.0)]
            return {'rod': {**dict(zip(('from', 'to'), ends)), **color}}
        return {CYLINDER: {'radius': size[0], 'length': size[1], 'axis': axis, 'center': center,
                           **color}}
    found = {BOX: lambda: {'size': list(size)}, SPHERE: lambda: {'radius': size[0]},
             MESH: lambda: {'file': visual.file, 'scale': list(size)}}[visual.kind]()
    found.update(center=center, **color)
    if visual.kind != SPHERE:
        found['orientation'] = {'quaternion': list(visual.orientation)}
    return {visual.kind: found}


def _read(shape, kinds, spatial):
    """Return the kind of a shape, and its numbers, checked."""
    if not isinstance(shape, Mapping) or len(shape) != 1 or not set(shape) <= set(kinds):
        raise FieldError(f'a mapping with one of {among(kinds)}', shown(shape) if not isinstance(
            shape, Mapping) else f'one with {among(shape) or "nothing"}')
    kind, = shape
    with at(kind):
        given = dict(mapping(shape[kind], *kinds[kind]))
        place = vector3 if spatial else vector2
        found = {}
        for key, check in {
                'size': _size, 'radius': not_negative if kind == 'rod' else positive,
                'length': positive, 'axis': direction, 'center': place, 'to': place,
                'from': place, 'orientation': orientation, 'file': text,
                'scale': _scale, 'color': _color}.items():
            if key in given:
                with at(key):
                    found[key] = check(given[key])
        if kind == 'rod':
            found = _rod(found, given['to'], spatial)
        found['center'] = np.array(found.get('center', np.zeros(3 if spatial else 2)))
    return kind, found


def _rod(found, to, spatial):
    """Return the numbers of the cylinder that a rod is."""
    start = np.array(found.get('from', np.zeros(3 if spatial else 2)))
    along = np.array(found['to']) - start
    length = math.hypot(*along)
    if not 0.0 < length < math.inf:
        raise FieldError('another place than where the rod begins, at a finite distance',
                         shown(to), path=('to',))
    axis = np.zeros(3)
    axis[:len(along)] = along / length
    return {'radius': found.get('radius', 0.0), 'length': length, 'axis': axis,
            'center': start + 0.5 * along}


def _finite_properties(kind, found):
    """Return ``_properties``; raise for a size whose powers overflow."""
    with np.errstate(over='ignore', invalid='ignore'):
        try:
            volume, center, inertia = _properties(kind, found)
        except OverflowError:
            volume = math.inf
    if not (volume < math.inf and np.isfinite(inertia).all()):
        raise FieldError('a size whose volume and inertia are finite numbers',
                         'one that is far too large')
    return volume, center, inertia


def _properties(kind, found):
    """Return a shape's volume, its centre, and its inertia about it for a unit of mass."""
    if kind == 'box':
        return _box(found)
    radius, center = found['radius'], found['center']
    if kind == 'sphere':
        return 4.0 / 3.0 * math.pi * radius ** 3, center, 0.4 * radius ** 2 * np.eye(3)
    return _cylinder(radius, found['length'], np.array(found['axis']), center)


def _visual(kind, found):
    center = tuple(found['center'].tolist()) + (0.0,) * (3 - len(found['center']))
    turned, color = found.get('orientation', UNTURNED), found.get('color')
    if kind == 'box':
        return Visual(BOX, found['size'], center, turned, color=color)
    if kind == 'sphere':
        return Visual(SPHERE, (found['radius'],), center, color=color)
    if kind == 'mesh':
        return Visual(MESH, found.get('scale', (1.0, 1.0, 1.0)), center, turned, found['file'],
                      color)
    return Visual(CYLINDER, (float(found['radius']), found['length']), center,
                  _from_z(found['axis']), color=color)


def _from_z(axis):
    """Return the quaternion of the shortest turn that leads from the z axis to another."""
    x, y, z = map(float, axis)
    if z < -1.0 + 1e-12:
        return (1.0, 0.0, 0.0, 0.0)
    w = math.sqrt(0.5 * (1.0 + z))
    return (-0.5 * y / w, 0.5 * x / w, 0.0, w)


def _three(expected, check):
    """Return a check of three numbers, of each by itself."""
    def checked(value):
        found = numbers(value, 3, expected)
        for index, one in enumerate(found):
            with at(index):
                check(one)
        return found
    return checked


def _require_factor(value):
    if value == 0.0:
        raise FieldError('a number that is not zero', shown(value))


def _require_share(value):
    if not 0.0 <= value <= 1.0:
        raise FieldError('a number from 0 to 1', shown(value))


_size = _three('a list of 3 positive numbers [x, y, z]', positive)
# Factors of a mesh; negative ones mirror it.
_scale = _three('a list of 3 numbers [x, y, z] that are not zero', _require_factor)
# Shares of light.
_color = _three('a list of 3 numbers from 0 to 1 [red, green, blue]', _require_share)


def _box(found):
    """Return ``_properties`` of a box."""
    turned = np.eye(3)
    if 'orientation' in found:
        x, y, z, w = found['orientation']
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew
    squares = np.square(found['size'])
    moments = (squares.sum() - squares) / 12.0
    return (math.prod(found['size']), found['center'],
            turned @ np.diag(moments) @ turned.T)


def _cylinder(radius, length, axis, center):
    """Return ``_properties`` of a solid cylinder."""
    across = (3.0 * radius ** 2 + length ** 2) / 12.0
    along = 0.5 * radius ** 2
    inertia = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    return math.pi * radius ** 2 * length, center, inertia
