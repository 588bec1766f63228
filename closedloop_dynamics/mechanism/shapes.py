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

"""
Centre of mass and inertia of bodies that are boxes, cylinders, spheres or rods of one material.

A shape is one in space, also of a body in the plane, where its inertia is the moment about z.

"""

from collections.abc import Mapping
import math

import numpy as np

from .checks import direction, not_negative, numbers, orientation, positive, vector2, vector3
from .fields import among, at, FieldError, mapping, shown

# Shape -> required and optional keys.
SHAPES = {
    'box': (('size',), ('center', 'orientation')),
    'cylinder': (('radius', 'length', 'axis'), ('center',)),
    'sphere': (('radius',), ('center',)),
    'rod': (('to',), ('from', 'radius')),
}
# What follows from a shape.
DERIVED = ('center_of_mass', 'inertia')


def with_shape(values, spatial):
    """
    Return the keys of a body with what follows from its shape in the place of the shape.

    Parameters
    ----------
    values : mapping
        Keys of a body, ``shape`` and ``density`` [kg/m^3] among them.
    spatial : bool
        Whether the body is one in space.

    Returns
    -------
    dict
        With ``mass``, ``center_of_mass`` and ``inertia``.

    Raises
    ------
    FieldError

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
        volume, center, inertia = _properties(shape, spatial)
    if density is not None:
        with at('density'):
            density = positive(density)
        if not volume > 0.0:
            raise FieldError('a radius of a rod with density', 'none',
                             path=('shape', 'rod', 'radius'))
        values['mass'] = density * volume
    with at('mass'):
        mass = positive(values['mass'])
    inertia = mass * inertia
    return {**values, 'center_of_mass': tuple(center.tolist()), 'inertia': (
        tuple(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()) if spatial
        else float(inertia[2, 2]))}


def _properties(shape, spatial):
    """Return a shape's volume, its centre, and its inertia about it for a unit of mass."""
    if not isinstance(shape, Mapping) or len(shape) != 1 or not set(shape) <= set(SHAPES):
        raise FieldError(f'a mapping with one of {among(SHAPES)}', shown(shape) if not isinstance(
            shape, Mapping) else f'one with {among(shape) or "nothing"}')
    kind, = shape
    with at(kind):
        given = dict(mapping(shape[kind], *SHAPES[kind]))
        place = vector3 if spatial else vector2
        found = {}
        for key, check in {
                'size': _size, 'radius': not_negative if kind == 'rod' else positive,
                'length': positive, 'axis': direction, 'center': place, 'to': place,
                'from': place, 'orientation': orientation}.items():
            if key in given:
                with at(key):
                    found[key] = check(given[key])
        if kind == 'box':
            return _box(found, spatial)
        if kind == 'sphere':
            radius = found['radius']
            return (4.0 / 3.0 * math.pi * radius ** 3, _center(found, spatial),
                    0.4 * radius ** 2 * np.eye(3))
        if kind == 'cylinder':
            return _cylinder(found['radius'], found['length'], np.array(found['axis']),
                             _center(found, spatial))
        start = np.array(found.get('from', np.zeros(3 if spatial else 2)))
        along = np.array(found['to']) - start
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise FieldError('another place than where the rod begins', shown(given['to']),
                             path=('to',))
        axis = np.zeros(3)
        axis[:len(along)] = along / length
        return _cylinder(found.get('radius', 0.0), length, axis, start + 0.5 * along)


def _size(value):
    """Return three positive lengths."""
    found = numbers(value, 3, 'a list of 3 positive numbers [x, y, z]')
    for index, length in enumerate(found):
        with at(index):
            positive(length)
    return found


def _center(found, spatial):
    """Return a shape's centre, the body's origin unless it is given."""
    return np.array(found.get('center', np.zeros(3 if spatial else 2)))


def _box(found, spatial):
    """Return what ``_properties`` does, of a box."""
    turned = np.eye(3)
    if 'orientation' in found:
        x, y, z, w = found['orientation']
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew
    squares = np.square(found['size'])
    moments = (squares.sum() - squares) / 12.0
    return (math.prod(found['size']), _center(found, spatial),
            turned @ np.diag(moments) @ turned.T)


def _cylinder(radius, length, axis, center):
    """Return what ``_properties`` does, of a solid cylinder."""
    across = (3.0 * radius ** 2 + length ** 2) / 12.0
    along = 0.5 * radius ** 2
    inertia = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    return math.pi * radius ** 2 * length, center, inertia
