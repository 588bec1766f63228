# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Rods of variable length: cylinders, linear actuators, telescopic springs, each as one element.

``lift: {between: [ground, boom], points: [[0, 0], [0.3, 0]], mass: 2, length: 0.4}`` of a
mechanism in the plane stands for two uniform bars, ``lift_barrel`` and ``lift_rod``, that slide in
one another by the joint ``lift``, whose coordinate is the distance of both pins, ``lift_foot`` on
the first body and ``lift_head`` on the second. In space, where ``axis`` is needed, too, the foot
is a universal joint, the head a spherical one.
"""

import numpy as np

from .between import BETWEEN, two_bodies, two_places
from .checks import boolean, direction, positive, vector2, vector3
from .fields import at, FieldError, mapping, shown

SECTION = 'cylinders'
# Length of a barrel as it is drawn, in its radii.
THINNESS = 14.0
KEYS = (BETWEEN, 'points', 'mass', 'length'), ('actuated',)


def with_cylinders(data, parameters, spatial):
    """
    Return the data of a mechanism with bodies and joints in the place of its cylinders.

    ``parameters`` are those that its expressions may name, ``spatial`` whether it is in space,
    where each cylinder has an ``axis``; FieldError.
    """
    found = {key: value for key, value in data.items() if key != SECTION}
    for section in ('bodies', 'joints'):
        found[section] = dict(mapping(found.get(section) or {}))
    required, optional = KEYS
    with at(SECTION):
        for name, values in mapping(data[SECTION] or {}).items():
            with at(name):
                bodies, joints = _parts(name, mapping(
                    values, (*required, *('axis',) * spatial), optional), parameters, spatial)
            for section, parts in (('bodies', bodies), ('joints', joints)):
                for part, record in parts.items():
                    if part in found[section]:
                        raise FieldError(f'a name that leaves {part} free in {section}',
                                         shown(name), path=(name,))
                    found[section][part] = record
    return found


def _parts(name, values, parameters, spatial):
    """Return the bodies and the joints of a cylinder by name, as a file would have them."""
    barrel, rod = f'{name}_barrel', f'{name}_rod'
    with at(BETWEEN):
        pair = two_bodies(values[BETWEEN])
    with at('points'):
        places = [list(place) for place in two_places(
            parameters.evaluated(values['points'], 'm'), vector3 if spatial else vector2)]
    numbers = {}
    for key, unit in (('mass', 'kg'), ('length', 'm')):
        with at(key):
            numbers[key] = positive(parameters.evaluated(values[key], unit))
    with at('actuated'):
        actuated = boolean(values.get('actuated', False))
    mass, length = 0.5 * numbers['mass'], numbers['length']
    inertia, along = mass * length ** 2 / 12.0, np.array((1.0, 0.0))
    foot = head = {'type': 'revolute'}
    slide = {'type': 'prismatic'}
    if spatial:
        with at('axis'):
            along = np.array(direction(parameters.evaluated(values['axis'])))
        # Bars without thickness turn about two axes across.
        (xx, xy, xz), (_, yy, yz), (*_, zz) = inertia * (np.eye(3) - np.outer(along, along))
        inertia = [xx, yy, zz, xy, xz, yz]
        across = np.array(direction(np.cross(along, np.eye(3)[np.argmin(np.abs(along))])))
        foot = {'type': 'universal', 'axis': across.tolist(),
                'second_axis': np.cross(along, across).tolist()}
        slide['axis'], head = along.tolist(), {'type': 'spherical'}
    thick, zero = length / THINNESS, [0.0] * len(along)

    def bar(end, radius):
        """Return a body from its frame's origin to a place."""
        return {'mass': mass, 'inertia': inertia, 'center_of_mass': (0.5 * end).tolist(),
                'visual': [{'rod': {'to': end.tolist(), 'radius': radius}}]}

    return {barrel: bar(length * along, thick), rod: bar(-length * along, 0.5 * thick)}, {
        f'{name}_foot': {**foot, 'cut': False, 'between': [pair[0], barrel],
                         'points': [places[0], zero]},
        name: {**slide, 'between': [barrel, rod], 'points': [zero, zero], 'cut': False,
               'actuated': actuated},
        f'{name}_head': {**head, 'between': [pair[1], rod], 'points': [places[1], zero],
                         'cut': True}}
